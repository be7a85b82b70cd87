"""The command ``tras`` of an installed package: ``tras identify log.csv``, ``tras control model.npz`` and so on.

Each is the command line of its module, which ``make identify``, ``make control`` and ``make example`` call as well.
"""

import sys

from tras.control import command as control
from tras.identification import command, examples
from tras.workflow.arguments import did_you_mean
from tras.workflow.provenance import versions

_HELP = """\
usage: tras COMMAND ...

  tras example             write duffing.csv here, a recording of a simulated system to try it on
  tras identify log.csv    find a model of a recording: report, model and exports in build/identify/log/
  tras control model.npz   a controller for it: predicted run, margins and C in build/control/log/
  tras version             say which versions these are

tras COMMAND --help says what each one takes. In Python: import tras; help(tras).
"""


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    name, *rest = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in ("-h", "--help", "help"):
        print(_HELP, end="")
        return 0
    if name in ("version", "--version"):
        print(", ".join(f"{library} {number}" for library, number in versions().items()))
        return 0
    commands = {"identify": command.main, "control": control.main, "example": examples.main}
    if name not in commands:
        print(f"tras has no command {name!r}{did_you_mean(name, [*commands, 'version'])}", file=sys.stderr)
        return 2
    return commands[name](rest, f"tras {name}")


if __name__ == "__main__":
    sys.exit(main())
