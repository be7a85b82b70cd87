"""From a model to a controller: ``make control MODEL=path``, or where the package is installed ``tras control``.

    python -m tras.control.command build/identify/log/model.npz [--settings mine.yaml] [--out FOLDER]

Writes to ``build/control/NAME`` below the checkout or else the working folder, NAME being that of the model's folder:
``control.html`` with the predicted closed loop, its margins and what to mind, all settings as ``settings.yaml``, the
controller as C99, and the run as CSV. If the model or the settings cannot be used, it prints one sentence, exits with
status 2 and leaves the folder as it was.
"""

import argparse
import sys
from pathlib import Path

import yaml

from tras.control.design import design
from tras.control.page import draw_run, warnings, write_page
from tras.export.controller import controller_to_c
from tras.model import KoopmanModel, load_model
from tras.plotting import save_figure
from tras.workflow import page
from tras.workflow.arguments import MissingExtraError, visible, well_formed
from tras.workflow.files import working_folder
from tras.workflow.results import require_own_folder, written_together
from tras.workflow.yaml_file import read_yaml

MODULE = "python -m tras.control.command"  # what make runs
PAGE = "control.html"


def main(arguments: list[str] | None = None, program: str = MODULE) -> int:
    """Command line; returns 0, 1 (the folder cannot be written) or 2 (the model, the settings or the call is wrong)."""
    options = _parser(program).parse_args(arguments)
    try:
        for what, path in (("MODEL", options.model), ("SETTINGS", options.settings), ("OUT", options.out)):
            well_formed(what, str(path))
        model = _model(options.model)
        settings = read_yaml(options.settings) if options.settings else None
        stem = options.model.resolve().parent.name if options.model.stem == "model" else options.model.stem
        out = options.out or working_folder() / "build" / "control" / (stem or "model")
        require_own_folder(out, PAGE)
        sentences = write(model, settings, stem, out)
    except (ValueError, MissingExtraError) as error:
        print(visible(error), file=sys.stderr)
        return 2
    except OSError as error:
        print(visible(f"{error.filename}: {error.strerror}" if error.filename else error), file=sys.stderr)
        return 1
    for sentence in sentences:
        print(visible(sentence))
    here = out.resolve()
    shown = here.relative_to(Path.cwd()) if here.is_relative_to(Path.cwd()) else here
    print(visible(f"{shown.as_posix()}/{PAGE}"))
    return 0


def write(model: KoopmanModel, settings, name: str, folder: str | Path) -> list[str]:
    """Design a controller, predict its run, and write the whole folder or nothing; returns what to mind.

    Raises
    ------
    ValueError
        As `tras.control.design.design`.
    OSError
        If the folder cannot be written.
    """
    made = design(model, settings)
    with written_together(folder) as stage:
        text = yaml.safe_dump(made.settings, sort_keys=False, allow_unicode=True)
        if yaml.safe_load(text) != made.settings:  # names that no plain text can hold
            text = yaml.safe_dump(made.settings, sort_keys=False)
        (stage / "settings.yaml").write_text(text, encoding="utf-8")
        files = [
            (PAGE, "this page"),
            ("settings.yaml", "all settings with their values"),
            ("run.csv", "the predicted run, and as run.pdf, run.svg and run.png"),
        ]
        failure = ""
        try:
            controller_to_c(made.controller, stage / "controller.c")
            files.append(("controller.c", "the controller in C99 without dependencies (docs/export.md)"))
            files.append(("controller.h", "its two functions and what their vectors hold"))
        except ValueError as error:
            failure = f"The controller in C: {error}"
        save_figure(*draw_run(made), stage / "run")
        html = write_page(made, name, page.picture(stage, "run"), files, text, failure)
        (stage / PAGE).write_text(html, encoding="utf-8")
    return warnings(made)


def _model(path):
    if not path.is_file():
        fault = "is a folder" if path.is_dir() else "does not exist"
        hint = "make identify RECORDING=log.csv writes one, build/identify/log/model.npz"
        raise ValueError(f"MODEL: {path} {fault}; give the path of a model ({hint}).")
    model = load_model(path)
    if not isinstance(model, KoopmanModel):
        raise ValueError(f"MODEL: {path} holds a {type(model).__name__}; give a tras.KoopmanModel.")
    return model


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        """Print one sentence instead of the whole usage."""
        self.exit(2, f"{message}; see {self.prog} --help.\n")


def _parser(program):
    parser = _Parser(prog=program, description="Make a controller from an identified model.")
    parser.add_argument("model", type=_path, help="a model that tras.KoopmanModel.save or tras identify wrote (.npz)")
    parser.add_argument("--settings", type=_path, help="YAML file of weights, limits and so on (docs/control.md)")
    parser.add_argument("--out", type=_path, help="folder of the results (default: build/control/NAME)")
    return parser


def _path(text):
    return Path(text).expanduser()


if __name__ == "__main__":
    sys.exit(main())
