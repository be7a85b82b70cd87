"""The folder of an identification: report, model, exports, figures and tables, written together or not at all."""

from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from tras.display import plots
from tras.export.c import to_c
from tras.export.common import to_statespace
from tras.export.equations import formulas
from tras.export.matlab import to_matlab
from tras.identification import diagnosis, figures
from tras.identification.examples import example
from tras.identification.identification import Identification
from tras.identification.page import write_page
from tras.plotting import save_figure
from tras.recording import Recording
from tras.rollout import predict_coarsely
from tras.workflow import page
from tras.workflow.results import written_together
from tras.workflow.study import terminal

_READABLE = 300  # functions; of more no formulas are written


def open_log(
    paths=(), *, roles=None, states=None, inputs=None, time="", trial="", dt=None, resample=None, start=None, end=None,
    decimate=1, test=(), actuators=(),
) -> Recording:  # fmt: skip
    """Read a recording of one path or several, its roles by name or by a YAML file; of none the `example` "duffing".

    "none" as a role says that there is none; ``test`` holds paths, or numbers of trials as text. A .nc file knows its
    roles: ``states`` and ``inputs`` then choose among them. ``actuators`` becomes the recording's attribute.

    Raises
    ------
    ValueError
        As `Recording.read`.
    """
    if not paths:
        return _with_actuators(example("duffing"), actuators)
    paths = [paths] if isinstance(paths, (str, Path)) else list(paths)
    samples = {"dt": dt or None, "resample": resample or None, "start": start or None, "end": end or None}
    samples |= {"decimate": decimate, "test": [int(each) if str(each).isdigit() else each for each in test] or None}
    if Path(paths[0]).suffix == ".nc":
        log = Recording.read(paths, roles or None, **samples).select(states=states or None, inputs=inputs or None)
        return _with_actuators(log, actuators)
    by_name = {"states": states, "inputs": inputs, "time": time, "trial": trial}
    by_name = {role: columns for role, columns in by_name.items() if columns}
    if roles and by_name:
        raise ValueError(f"roles are given by {roles} and by name ({', '.join(by_name)}); give them in one way.")
    none = {"states": [], "inputs": [], "time": None, "trial": None}
    by_name = {role: none[role] if columns in ("none", ["none"]) else columns for role, columns in by_name.items()}
    return _with_actuators(Recording.read(paths, roles or by_name or None, **samples), actuators)


def _with_actuators(log, names):
    if names:
        log.attributes["actuators"] = [] if list(names) == ["none"] else list(names)
    return log


def write(identification: Identification, log: Recording, name: str, folder: str | Path) -> pd.DataFrame:
    """Write the whole folder of an identification, or nothing.

    Parameters
    ----------
    identification : Identification
    log : Recording
        As read.
    name : str
        Of the recording, for titles.
    folder : str or Path
        Files of an earlier run in it are replaced, and removed if they are no longer made; other files stay.

    Returns
    -------
    pandas.DataFrame
        One row per file: ``file`` and ``what`` it is.

    Raises
    ------
    OSError
        If the folder cannot be written; it is then as it was, or, at worst, some files are new and others old.
    """
    with written_together(folder) as stage:
        return _write_all(identification, log, name, stage)


def _write_all(identification, log, name, stage):
    """Write everything into an empty folder; the table of what it holds."""
    (stage / "tables").mkdir()
    (stage / "figures").mkdir()
    diagnosed = diagnosis.diagnose(identification)
    pictures = _figures(identification, diagnosed, stage / "figures")
    tables = _tables(identification, diagnosed)
    for key, (_, table) in tables.items():
        path = stage / "tables" / f"{key}.csv"
        table.to_csv(path, index=key == "correlation", float_format="%.10g", lineterminator="\n")
    identification.delivered.save(stage / "model.npz")
    exports, failures = _exports(identification, stage)
    contents = [
        ("report.html", "this page"),
        ("identify.ipynb", "the notebook that made it all, executed"),
        ("model.npz", "the model, fitted to all of the recording, for tras.load_model"),
        ("linear.npz", "the best linear model, tested beside it"),
        *exports,
        *((f"tables/{key}.csv", what) for key, (what, _) in tables.items()),
        ("figures/", "every figure as PDF, SVG and PNG, and its numbers as CSV"),
    ]
    identification.linear.save(stage / "linear.npz")
    text = stage / "export" / "formulas.txt"
    equations = text.read_text(encoding="utf-8") if text.exists() else ""
    html = write_page(identification, diagnosed, log, name, pictures, contents, failures, equations)
    (stage / "report.html").write_text(html, encoding="utf-8")
    return pd.DataFrame(contents, columns=["file", "what"])


def _tables(identification, diagnosed):
    """Table -> (what it holds, the table)."""
    checks = identification.checks
    tests = [each.table.assign(steps=each.steps) for each in diagnosed.tests.values() if not isinstance(each, str)]
    advice = pd.DataFrame(identification.advice, columns=["weight", "about", "text"])
    return {
        "channels": ("ranges, limits, steps and noise of every channel", checks.channels),
        "correlation": ("correlation between inputs", checks.correlation),
        "spectra": ("spectra of every channel", checks.spectrum),
        "search": ("every candidate with its error", identification.search.drop(columns=["model"])),
        "metrics": ("the test", identification.metrics),
        "residuals": ("tests of the residuals", pd.concat(tests, ignore_index=True) if tests else pd.DataFrame()),
        "growth": ("error against time ahead", identification.growth),
        "predictions": ("measured and predicted states over two test windows, with the band", identification.overlay),
        "eigenvalues": ("of the Koopman matrices", identification.eigenvalues),
        "advice": ("the warnings of this page", advice),
    }


def _figures(identification, diagnosed, folder):
    """Draw and save every figure: its name -> its picture for the page."""
    recording, model = identification.recording, identification.model
    names, units, inputs = list(recording.state_names), list(recording.state_units), list(recording.input_names)
    states = max(plots.MOST // 2, plots.MOST - recording.m)  # leaves room for inputs
    channels = [*names[:states], *inputs], [*units[:states], *recording.input_units]
    of_model = identification.overlay, list(model.state_names_), list(model.state_units_)
    drawings = {
        "data": (plots.data_figure, plots.curves(recording), *channels),
        "spectra": (figures.spectra_figure, identification.checks.spectrum, names, inputs),
        "predictions": (figures.prediction_figure, *of_model),
        "growth": (figures.growth_figure, identification.growth),
        "spectrum": (plots.eigenvalue_figure, identification.eigenvalues),
    }
    for key, tests in diagnosed.tests.items():
        if not isinstance(tests, str):
            shown = tests.correlations  # all of them are in the figure's table
            drawings[key] = (_few_correlations, shown, [*names[:4]], ["itself", *inputs[: figures.SHOWN]])
    if diagnosed.responses:
        few = dict(list(diagnosis.outputs(identification).items())[:4])
        of_inputs = dict(list(zip(inputs, recording.input_units))[: figures.SHOWN])
        drawings["step"] = (figures.step_figure, diagnosed.responses.step, few, of_inputs)
        few = dict(list(few.items())[: figures.SHOWN])
        for number, source in enumerate(of_inputs.items()):
            key = f"bode_{number + 1}" if number else "bode"
            drawings[key] = (figures.bode_figure, diagnosed.responses.bode, few, source)
    pictures = {}
    run, table = _free_run(identification)
    save_figure(run, table, folder / "free_run", layouts=1)
    pictures["free_run"] = page.picture(folder, "free_run")
    with terminal() as stream:
        for key, (draw, table, *arguments) in tqdm(
            drawings.items(), desc="figures", leave=False, disable=None, file=stream
        ):
            if len(table):  # no spectra of a short recording
                save_figure(draw(table, *arguments), table, folder / key, layouts=1)
                pictures[key] = page.picture(folder, key)
    return pictures


def _few_correlations(table, states, others):
    return plots.residual_figure(table[table["state"].isin(states) & table["against"].isin(others)])


def _free_run(identification):
    """The longest trajectory of the test, measured and simulated: the figure and its table."""
    whole, models = identification.whole_test, {"model": identification.model, "linear model": identification.linear}
    if identification.model is identification.linear:
        del models["linear model"]
    longest = int(np.argmax(whole.lengths))
    part = whole[[longest]]
    runs = {name: np.asarray(predict_coarsely(model, part)[0]) for name, model in models.items()}
    which = f", trajectory {longest} of {len(whole)}" if len(whole) > 1 else ""
    late = max(model.delays for model in models.values())
    figure = plots.run_figure(part, models.values(), [run[late:] for run in runs.values()], list(models), which=which)
    table = {"time": np.arange(whole.lengths[longest]) * whole.dt}
    for i, state in enumerate(whole.state_names):
        table |= {f"{state}: {name}": run[:, i] for name, run in {"true": part.states[0], **runs}.items()}
    return figure, pd.DataFrame(table)


def _exports(identification, stage):
    """Write the exports: (file, what it is) of each, and one sentence for each that could not be made."""
    folder, model = stage / "export", identification.delivered
    folder.mkdir()
    exports, failures = [], []

    def attempt(what, export):
        try:
            exports.extend((path.relative_to(stage).as_posix(), what) for path in export())
        except (ValueError, NotImplementedError) as error:
            failures.append(f"{what}: {error}")

    def text_and_latex():
        if len(model.names_) > _READABLE:
            many = f"{len(model.names_)} functions are too many to read"
            raise ValueError(f"{many}; tras.export.formulas(model) writes them all the same.")
        paths = [folder / "formulas.txt", folder / "formulas.tex"]
        for path, latex in zip(paths, (False, True)):
            path.write_text(formulas(model, identification.train, tolerance=0.01, latex=latex) + "\n", encoding="utf-8")
        return paths

    def state_space():
        system, path = to_statespace(model), folder / "statespace.npz"
        np.savez(path, A=system.A, B=system.B, C=system.C, D=system.D, dt=system.dt)
        return [path]

    attempt("the model for MATLAB and GNU Octave (docs/export.md)", lambda: to_matlab(model, folder / "model.mat"))
    attempt("the one-step predictor in C99", lambda: to_c(model, folder / "model.c"))
    if model.predictor == "lifted_linear":
        attempt("matrices A, B, C, D for python-control: tras.export.to_statespace(model)", state_space)
    else:
        attempt("formulas, as text and as LaTeX; terms that change a row by less than 1 % are left out", text_and_latex)
    return exports, failures
