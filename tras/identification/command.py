"""From a recording to a model: ``make identify RECORDING=path``, or where the package is installed ``tras identify``.

    python -m tras.identification.command log.csv [--out FOLDER] [--roles roles.yaml] [--delays 0,2,4] ...

Runs ``identify.ipynb``, which is a link to ``notebooks/`` and a file of the installed package, on the recording and
writes to ``build/identify/NAME`` below the checkout or else the working folder, NAME being the recording's name:
``report.html``, the executed notebook, the model, its exports, tables and figures. If the recording cannot be used, it
prints one sentence, exits with status 2 and leaves the folder as it was.
"""

import argparse
import os
import shutil
import sys
import tempfile
from pathlib import Path

from tras.io.formats import FORMATS
from tras.workflow.arguments import MissingExtraError
from tras.workflow.files import working_folder
from tras.workflow.parameters import ParameterError, check_parameters, notebook_defaults
from tras.workflow.runner import Interrupted, RunError, interruptible, run_notebook

# Errors that are a sentence about the recording or the call, not a fault of the program.
_SENTENCES = ("RecordingError", "ValueError", "LogarithmError", "FileNotFoundError", "MissingExtraError")
NOTEBOOK = Path(__file__).with_name("identify.ipynb")


def main(arguments: list[str] | None = None, program: str = "python -m tras.identification.command") -> int:
    """Command line; returns 0, 1 (the run failed), 2 (the recording or the call is wrong), 130 or 143 (interrupted)."""
    options = _parser(program).parse_args(arguments)
    root = working_folder()
    out = options.out or root / "build" / "identify" / options.recording.stem
    try:
        parameters = _parameters(options, out, root)
        with interruptible():
            seconds = _run(out, parameters, root)
    except (ParameterError, MissingExtraError) as error:
        print(error, file=sys.stderr)
        return 2
    except RunError as error:
        plain = error.name in _SENTENCES
        print(error.words + _hint(error.words) if plain else error, file=sys.stderr)
        return 2 if plain else 1
    except OSError as error:
        print(f"{error.filename}: {error.strerror}" if error.filename else error, file=sys.stderr)
        return 1
    except Interrupted as interrupt:
        print("identify was interrupted; no results were written.", file=sys.stderr)
        return 128 + interrupt.args[0]
    print(f"{_inside(out, Path.cwd())}/report.html  {seconds:.0f} s")
    return 0


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        """Print one sentence instead of the whole usage."""
        self.exit(2, f"{message}; see {self.prog} --help.\n")


def _hint(words):
    """The options that the sentence asks for."""
    if "resample=" in words:
        return " With make: RESAMPLE=, for example RESAMPLE=0.01. With tras: --resample 0.01."
    if "given as roles" in words:
        by_make = "With make: ROLES=roles.yaml, or by name: TIME=t STATES=a,b INPUTS=c TRIAL=run."
        return f"\n{by_make}\nWith tras: --roles roles.yaml, or --time t --states a,b --inputs c --trial run."
    return ""


def _parser(program):
    parser = _Parser(prog=program, description="Identify a system from a recording.")
    add = parser.add_argument
    add("recording", type=_path, help="a .csv, .parquet, .mat or .nc file")
    add("--out", type=_path, help="folder of the results (default: build/identify/NAME)")
    add("--roles", type=_path, help="YAML file that says which columns are time, states, inputs, trial")
    add("--states", type=_names, default=[], help="columns that are states or outputs, separated by commas")
    add("--inputs", type=_names, default=[], help="columns that are inputs, separated by commas")
    add("--time", default="", help="the column of time")
    add("--trial", default="", help="the column that tells trials apart")
    add("--dt", type=float, default=0.0, help="sampling time in s, without a column of time")
    add("--resample", type=float, default=0.0, help="new sampling time in s, for uneven times")
    predictors = ["", "vector_field", "one_step", "lifted_linear"]
    add("--predictor", default="", choices=predictors, help="the only predictor to try")
    add("--delays", type=_numbers, default=[], help="the only numbers of delays to try, separated by commas")
    smoothing = "smooth the states before the fit (default: both are tried if they are noisy)"
    add("--smoothing", default="", choices=["", "yes", "no"], help=smoothing)
    add("--draws", type=int, default=30, help="members of the bootstrap, 0 for no band")
    return parser


def _path(text):
    return Path(text).expanduser()


def _names(text):
    return [name.strip() for name in text.split(",") if name.strip()]


def _numbers(text):
    try:
        numbers = [int(part) for part in text.replace(",", " ").split()]
    except ValueError:
        numbers = [-1]
    if min(numbers, default=0) < 0:
        raise argparse.ArgumentTypeError(f"{text!r} holds no whole numbers of 0 or more; write them as 0,2,4")
    return numbers


def _parameters(options, out, root):
    """The notebook's parameters; obvious mistakes are reported before a kernel starts."""
    for path, what in ((options.recording, "RECORDING"), (options.roles, "ROLES")):
        if path is not None and not path.is_file():
            fault = "is a folder" if path.is_dir() else "does not exist"
            raise ParameterError(f"{what}: {path} {fault}; give the path of a file.")
    if options.recording.suffix not in FORMATS:
        fault = f"{options.recording} ends in {options.recording.suffix!r}"
        raise ParameterError(f"RECORDING: {fault}; recordings are {', '.join(FORMATS)} files.")
    if out.exists() and not out.is_dir():
        raise ParameterError(f"OUT: {out} is a file; give a folder.")
    paths = {"recording": options.recording, "out_dir": out, "roles": options.roles}
    parameters = vars(options) | {name: _inside(path, root) if path else "" for name, path in paths.items()}
    del parameters["out"]
    return check_parameters(parameters, notebook_defaults(NOTEBOOK), "the command line")


def _inside(path, root):
    """The path relative to a folder if it lies inside, else the absolute one."""
    path = path.resolve()
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else str(path)


def _run(out, parameters, root):
    """Run the notebook in a folder beside ``out``, and move the executed notebook into ``out`` at the very end."""
    out.parent.mkdir(parents=True, exist_ok=True)
    aside = Path(tempfile.mkdtemp(prefix=f".{out.name}.run.", dir=out.parent))
    try:
        seconds = run_notebook(NOTEBOOK, aside / "identify.ipynb", parameters, cwd=root)
        for name in ("identify.json", "identify.ipynb"):
            os.replace(aside / name, out / name)
    except RunError as error:
        failed = aside / "identify.failed.ipynb"
        if failed.exists() and error.name not in _SENTENCES:  # a fault of the program: leave the notebook that shows it
            report = out.parent / f"{out.name}.failed.ipynb"
            os.replace(failed, report)
            error.args = (str(error).replace(str(failed), str(report)),)
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return seconds


if __name__ == "__main__":
    sys.exit(main())
