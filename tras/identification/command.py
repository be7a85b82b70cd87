"""From a recording to a model: ``make identify RECORDING=path``, or where the package is installed ``tras identify``.

    python -m tras.identification.command log.csv [--out FOLDER] [--roles roles.yaml] [--delays 0,2,4] ...
    python -m tras.identification.command "run1.csv run2.csv" --test run3.csv

Runs ``identify.ipynb``, which is a link to ``notebooks/`` and a file of the installed package, on the recording and
writes to ``build/identify/NAME`` below the checkout or else the working folder, NAME being the recording's name:
``report.html``, the executed notebook, the model, its exports, tables and figures. If the recording cannot be used, it
prints one sentence, exits with status 2 and leaves the folder as it was. So it does if the folder holds files of others
or the results of another recording.
"""

import argparse
import csv
import glob
import json
import os
import re
import shlex
import shutil
import sys
import tempfile
from pathlib import Path

from tras.io.formats import FORMATS
from tras.workflow.arguments import MissingExtraError, percent, visible, well_formed
from tras.workflow.files import require_writable, working_folder
from tras.workflow.parameters import ParameterError, check_parameters, notebook_defaults
from tras.workflow.results import require_own_folder
from tras.workflow.runner import Interrupted, RunError, interruptible, run_notebook

# Errors that are a sentence about the recording or the call, not a fault of the program.
_SENTENCES = ("RecordingError", "ValueError", "LogarithmError", "FileNotFoundError", "MissingExtraError")
MODULE = "python -m tras.identification.command"  # what make runs
NOTEBOOK = Path(__file__).with_name("identify.ipynb")


def main(arguments: list[str] | None = None, program: str = MODULE) -> int:
    """Command line; returns 0, 1 (the run failed), 2 (the recording or the call is wrong), 130 or 143 (interrupted)."""
    options = _parser(program).parse_args(arguments)
    root = working_folder()
    try:
        typed = {"RECORDING": options.recording, "TEST": options.test}
        options.recording, options.test = (_files(name, text) for name, text in typed.items())
        more = f"_and_{len(options.recording) - 1}_more" if len(options.recording) > 1 else ""
        out = options.out or root / "build" / "identify" / (options.recording[0].stem + more)
        parameters = _parameters(options, out, root)
        with interruptible():
            seconds, errors = _run(out, parameters, root)
    except (ParameterError, MissingExtraError) as error:
        print(visible(error), file=sys.stderr)
        return 2
    except RunError as error:
        plain = error.name in _SENTENCES
        print(visible(_advised(error.words, options, typed, program) if plain else error), file=sys.stderr)
        return 2 if plain else 1
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}" if error.filename else error.strerror or error
        print(visible(reason), file=sys.stderr)
        return 1
    except Interrupted as interrupt:
        print("identify was interrupted; no results were written.", file=sys.stderr)
        return 128 + interrupt.args[0]
    print(visible(f"{_inside(out, Path.cwd())}/report.html  {seconds:.0f} s  {errors}"))
    return 0


def _numbers_of_test(out):
    """The errors of the model in the test, per state, in a few words."""
    with open(out / "tables" / "metrics.csv", newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["prediction"] == "model"]
    numbers = [f"{row['state']} {percent(row['nrmse'])} ({percent(row['free'])})" for row in rows[:4]]
    more = f" and {len(rows) - 4} more" if len(rows) > 4 else ""
    return f"NRMSE in the test (free run): {', '.join(numbers)}{more}"


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        """Print one sentence instead of the whole usage."""
        self.exit(2, f"{message}; see {self.prog} --help.\n")


def _advised(words, options, typed, program):
    """The sentence, with the variables of make that it asks for, and in its command all that was given before."""
    lines = []
    for line in words.split("\n"):
        if line.startswith("  make identify RECORDING="):
            others = dict(typed, RECORDING="") | dict(_others(options))
            recording = f"RECORDING={shlex.quote(typed['RECORDING'])}"
            line = f"  make identify {recording}{line[line.index(' TIME=') :]}"
            line += "".join(f" {name}={shlex.quote(text)}" for name, text in others.items() if text)
            line = line if program == MODULE else _without_make(line, program)
        lines.append(line)
    hint = (
        " With make: RESAMPLE=, for example RESAMPLE=0.01. With tras: --resample 0.01." if "resample=" in words else ""
    )
    return "\n".join(lines) + hint


def _without_make(line, program):
    """The line for make as one of ``program``, which takes the same options."""
    recording, *others = (word.partition("=")[::2] for word in shlex.split(line)[2:])
    options = [f"--{name.lower()} {shlex.quote(text)}" for name, text in others]
    return " ".join([f"  {program}", shlex.quote(recording[1]), *options])


def _others(options):
    """(variable of make, text) of the options that are no roles or files, where they are not the defaults."""
    defaults = vars(_parser("").parse_args(["-"]))
    roles = ("recording", "test", "roles", "states", "inputs", "time", "trial", "dt")
    names = {"start": "FROM", "end": "TO"}
    for name, value in vars(options).items():
        if name not in roles and value != defaults[name] and value not in ([], None):
            yield names.get(name, name.upper()), ",".join(map(str, value)) if isinstance(value, list) else str(value)


def _parser(program):
    parser = _Parser(prog=program, description="Identify a system from a recording.")
    add = parser.add_argument
    add("recording", help="a file, several with blanks between, or a pattern such as 'run*.csv'")
    add("--test", default="", help="more files, or numbers of trials, that are the test")
    add("--out", type=_path, help="folder of the results (default: build/identify/NAME)")
    add("--roles", type=_path, help="YAML file that says which columns are time, states, inputs, trial")
    add("--states", type=_names, default=[], help="columns that are states or outputs, separated by commas")
    add("--inputs", type=_names, default=[], help="columns that are inputs, separated by commas; none: a free motion")
    add("--time", default="", help="the column of time, or none")
    add("--trial", default="", help="the column that tells trials apart")
    add("--dt", type=float, default=0.0, help="sampling time in s, whatever the file says")
    add("--from", dest="start", type=float, default=0.0, help="leave out what is earlier, in s since the first sample")
    add("--to", dest="end", type=float, default=0.0, help="leave out what is later")
    add("--decimate", type=int, default=1, help="keep the first of every so many samples")
    add("--resample", type=float, default=0.0, help="new sampling time in s, for uneven times")
    predictors = ["", "vector_field", "one_step", "lifted_linear"]
    add("--predictor", default="", choices=predictors, help="the only predictor to try")
    add("--delays", type=_numbers, default=[], help="the only numbers of delays to try, separated by commas")
    smoothing = "smooth the states before the fit (default: both are tried if they are noisy)"
    add("--smoothing", default="", choices=["", "yes", "no"], help=smoothing)
    add("--lead", default="", choices=["", "0", "1"], help="the input acts after (0) or before (1) its sample")
    actuators = "states that follow the inputs and drive the body, or none (default: found by their numbers)"
    add("--actuators", type=_names, default=[], help=actuators)
    add("--every", type=int, default=0, help="the only length of the model's step to try, in samples")
    add("--horizon", type=float, default=0.0, help="how far ahead the model is to predict, in s")
    add("--draws", type=int, default=30, help="members of the bootstrap, 0 for no band")
    return parser


def _path(text):
    return Path(text).expanduser()


def _names(text):
    """Names with commas between; those with a comma in them stand in quotation marks."""
    return [name.strip() for name in next(csv.reader([text], skipinitialspace=True), []) if name.strip()]


def _files(what, text):
    """The files that one path, several ones or patterns name; of TEST also numbers of trials."""
    if not text or Path(text).expanduser().exists():
        return [Path(text).expanduser()] if text else []
    try:
        words = shlex.split(text.replace(",", " ") if re.fullmatch(r"[\d, ]+", text) else text)
    except ValueError:  # a quotation mark in the one path that is not there
        words = [text]
    files = []
    for word in words:
        matches = sorted(glob.glob(os.path.expanduser(word))) if set(word) & set("*?[") else [word]
        if not matches:
            raise ParameterError(f"{what}: no file matches {word}.")
        is_trial = what == "TEST" and word.isdigit() and not Path(word).exists()
        files += [word] if is_trial else [Path(match).expanduser() for match in matches]
    return files


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
    files = [("RECORDING", path) for path in options.recording]
    files += [("TEST", path) for path in options.test if isinstance(path, Path)]
    for what, path in [*files, ("OUT", out), ("ROLES", options.roles), ("the working folder", root)]:
        well_formed(what, str(path), ParameterError)
    for what, path in [*files, *([("ROLES", options.roles)] if options.roles else [])]:
        if not path.is_file():
            fault = "is a folder" if path.is_dir() else "does not exist"
            raise ParameterError(f"{what}: {path} {fault}; give the path of a file.")
    for what, path in files:
        if path.suffix.lower() not in FORMATS:
            raise ParameterError(f"{what}: {path} ends in {path.suffix!r}; recordings are {', '.join(FORMATS)} files.")
    paths = {"out_dir": out, "roles": options.roles}
    parameters = vars(options) | {name: _inside(path, root) if path else "" for name, path in paths.items()}
    parameters["recording"] = [_inside(path, root) for path in options.recording]
    parameters["test"] = [_inside(each, root) if isinstance(each, Path) else each for each in options.test]
    del parameters["out"]
    _check_folder(out, parameters["recording"])
    return check_parameters(parameters, notebook_defaults(NOTEBOOK), "the command line")


def _check_folder(out, recording):
    """Refuse a folder that holds anything but an earlier identification of one of these recordings."""
    require_own_folder(out, "report.html", ParameterError)
    try:
        before = json.loads((out / "identify.json").read_text(encoding="utf-8"))["parameters"]["recording"]
    except (OSError, ValueError, KeyError, TypeError):  # of a run that was killed, or of an earlier release
        return
    if not set(before) & set(recording):
        other = out.with_name("_".join([*Path(recording[0]).parent.parts[-1:], out.name]).strip("/"))
        raise ParameterError(
            f"OUT: {out} holds the results of {', '.join(before)}; give another folder, such as OUT={other}, or remove "
            "that one."
        )


def _inside(path, root):
    """The path relative to a folder if it lies inside, else the absolute one."""
    path = path.resolve()
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else str(path)


def _run(out, parameters, root):
    """Run the notebook beside ``out``, move the executed one there at the very end: seconds, and the test in words."""
    for folder in [out.parent, *(each for each in (out, *out.rglob("*")) if each.is_dir())]:
        require_writable(folder)
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
    return seconds, _numbers_of_test(out)


if __name__ == "__main__":
    sys.exit(main())
