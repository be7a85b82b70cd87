"""The folder of an identification: report, model, exports, figures and tables, all of them or none."""

import os
import shutil
import tempfile
from pathlib import Path, PurePosixPath

import numpy as np
import pandas as pd

from tras import figures_identify, page
from tras.examples import example
from tras.export import identifier
from tras.figures import save_figure
from tras.files import umask
from tras.identify_page import write_page
from tras.recording import Recording

LISTING = "contents.csv"
_CURVE = 3000  # samples of the recording that the figure shows
_SHOWN = 300  # functions up to which formulas are written


def open_log(path="", *, roles=None, states=None, inputs=None, time="", trial="", dt=None, resample=None):
    """A recording as `Recording.read` reads it, roles by name or by a YAML file; without a path the example of `tras.examples`.

    A .nc knows its roles: ``states`` and ``inputs`` then choose among them.

    Raises
    ------
    ValueError
        As `Recording.read`.
    """
    if not path:
        return example("duffing")
    if Path(path).suffix == ".nc":
        return Recording.read(path, roles or None, dt=dt or None, resample=resample or None).select(states=states or None, inputs=inputs or None)
    given = {"states": states, "inputs": inputs, "time": time, "trial": trial}
    given = {key: value for key, value in given.items() if value}
    if roles and given:
        raise ValueError(f"roles are given by {roles} and by name ({', '.join(given)}); give them in one way.")
    return Recording.read(path, roles or given or None, dt=dt or None, resample=resample or None)


def write(found, log, name, folder):
    """Write everything that an identification has found.

    Parameters
    ----------
    found : tras.identification.Identification
    log : Recording
        As read.
    name : str
        Of the recording, for titles.
    folder : str or Path
        Files of an earlier run there are replaced, those that are no longer made removed; others are left alone.

    Returns
    -------
    pandas.DataFrame
        ``file`` and ``what`` it is.

    Raises
    ------
    OSError
        If the folder cannot be written; it is then as it was, or, at worst, some files are new and others old.
    """
    folder = Path(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        listed = _all(found, log, name, stage)
        _move(stage, folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return listed


def _all(found, log, name, stage):
    (stage / "tables").mkdir()
    (stage / "figures").mkdir()
    pictures = _figures(found, stage / "figures")
    for table, key in _tables(found):
        table.to_csv(stage / "tables" / f"{key}.csv", index=key == "correlation", float_format="%.10g", lineterminator="\n")
    found.model.save(stage / "model.npz")
    exports, failures = _exports(found, stage)
    listed = [
        ("report.html", "this page"), ("identify.ipynb", "the notebook that made it all, executed"), ("model.npz", "the model, for tras.load_model"), *exports,
        *((f"tables/{key}.csv", what) for key, what in _TABLES.items()), ("figures/", "every figure as PDF, SVG and PNG, and its numbers as CSV"),
    ]  # fmt: skip
    text = stage / "export" / "formulas.txt"
    formulas = text.read_text(encoding="utf-8") if text.exists() else ""
    (stage / "report.html").write_text(write_page(found, log, name, pictures, listed, failures, formulas), encoding="utf-8")
    listed = pd.DataFrame(listed, columns=["file", "what"])
    files = sorted(path.relative_to(stage).as_posix() for path in stage.rglob("*") if path.is_file())
    pd.DataFrame({"file": [*files, LISTING]}).to_csv(stage / LISTING, index=False, lineterminator="\n")
    return listed


_TABLES = {
    "channels": "ranges, limits, steps and noise of every channel",
    "correlation": "correlation between inputs",
    "spectra": "spectra of every channel",
    "search": "every candidate with its error",
    "metrics": "the test",
    "growth": "error against time ahead",
    "predictions": "measured and predicted states over two test windows, with the band",
    "eigenvalues": "of the Koopman matrices",
    "advice": "the warnings of this page",
}


def _tables(found):
    yield found.checks.channels, "channels"
    yield found.checks.correlation, "correlation"
    yield found.checks.spectrum, "spectra"
    yield found.search.drop(columns=["model"]), "search"
    yield found.metrics, "metrics"
    yield found.growth, "growth"
    yield found.overlay, "predictions"
    yield found.eigenvalues, "eigenvalues"
    yield pd.DataFrame(found.advice, columns=["weight", "about", "text"]), "advice"


def _figures(found, folder):
    """Key -> the picture of it that a page shows best."""
    used, model = found.recording, found.model
    states = max(figures_identify.MOST // 2, figures_identify.MOST - used.m)  # so that inputs are seen too
    names, units = ([*of_states[:states], *of_inputs] for of_states, of_inputs in ((used.state_names, used.input_names), (used.state_units, used.input_units)))
    drawn = {"data": (figures_identify.data_figure, (_curves(used), names, units))}
    if len(found.checks.spectrum):
        drawn["spectra"] = (figures_identify.spectra_figure, (found.checks.spectrum, list(used.state_names), list(used.input_names)))
    drawn |= {
        "predictions": (figures_identify.prediction_figure, (found.overlay, list(model.state_names_), list(model.state_units_))),
        "growth": (figures_identify.growth_figure, (found.growth,)),
        "spectrum": (figures_identify.eigenvalue_figure, (found.eigenvalues,)),
    }
    pictures = {}
    for key, (draw, arguments) in drawn.items():
        save_figure(draw(*arguments), arguments[0], folder / key)
        pictures[key] = page.picture(folder, key)
    return pictures


def _curves(recording):
    """The recording as one table: ``trajectory, time`` from its beginning, channels; every so many samples if it is long."""
    table = recording.to_frame()
    starts = np.concatenate([[0.0], np.cumsum(recording.lengths[:-1] * recording.dt)])
    table["time"] += np.repeat(starts, recording.lengths)
    return table.iloc[:: max(1, len(table) // _CURVE)].reset_index(drop=True)


def _exports(found, stage):
    """(file, what it is) of each export, and a sentence for each that could not be made."""
    folder, model = stage / "export", found.model
    folder.mkdir()
    name, done, failures = identifier("model"), [], []

    def attempt(what, export):
        try:
            done.extend((path.relative_to(stage).as_posix(), what) for path in export())
        except (ValueError, NotImplementedError) as error:
            failures.append(f"{what}: {error}")

    def formulas():
        if len(model.names_) > _SHOWN:
            raise ValueError(f"{len(model.names_)} functions are too many to read; model.formulas() writes them all the same.")
        paths = [folder / "formulas.txt", folder / "formulas.tex"]
        for path, latex in zip(paths, (False, True)):
            path.write_text(model.formulas(found.train, tolerance=0.01, latex=latex) + "\n", encoding="utf-8")
        return paths

    def state_space():
        system = model.to_statespace()
        path = folder / "statespace.npz"
        np.savez(path, A=system.A, B=system.B, C=system.C, D=system.D, dt=system.dt)
        return [path]

    attempt("the model for MATLAB and GNU Octave (docs/export.md)", lambda: model.export_mat(folder / f"{name}.mat"))
    attempt("the one-step predictor in C99", lambda: model.export_c(folder / f"{name}.c"))
    if model.predictor == "lifted_linear":
        attempt("matrices A, B, C, D for python-control: model.to_statespace()", state_space)
    else:
        attempt("formulas, as text and as LaTeX; terms that change a row by less than 1 % are left out", formulas)
    return done, failures


def _move(stage, folder):
    """Everything of ``stage`` into ``folder``; what an earlier run listed there and this one does not make goes."""
    new = {path.relative_to(stage) for path in stage.rglob("*") if path.is_file()}
    if not folder.exists():
        stage.chmod(0o777 & ~umask())  # mkdtemp is private; a result is not
        os.replace(stage, folder)
        return
    old = _listed(folder)
    for path in sorted(new - {Path(LISTING)}):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        os.replace(stage / path, folder / path)
    for path in old - new:
        (folder / path).unlink(missing_ok=True)
    os.replace(stage / LISTING, folder / LISTING)


def _listed(folder):
    """What an earlier run says that it has written; nothing outside the folder, whatever stands there."""
    try:
        names = pd.read_csv(folder / LISTING)["file"].astype(str)
    except (OSError, ValueError, KeyError):
        return set()
    paths = {PurePosixPath(name) for name in names}
    return {Path(path) for path in paths if not path.is_absolute() and ".." not in path.parts and str(path) != LISTING}
