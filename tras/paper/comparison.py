"""The paper's method beside others: each tuned by the same rule and scored on the same untouched recordings.

Every method brings `TRIES` settings. `tras.choose` compares them by multi-step error on training trajectories held out
for it, and fits the winner to all of them. The rule is applied anew to each input, amount of data and level of noise.
"""

import math
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from tras.dictionaries.mechanical import Mechanical
from tras.dictionaries.monomials import Monomials
from tras.dictionaries.radial import GaussianRBF
from tras.identification.noise import add_noise
from tras.identification.search import choose
from tras.identification.smoothing import smooth
from tras.io import formats
from tras.model import KoopmanModel
from tras.paper.baselines.edmd import PykoopEdmd
from tras.paper.baselines.greybox import GreyBox
from tras.paper.baselines.hammerstein import HammersteinWiener
from tras.paper.baselines.linear import DMDc
from tras.paper.baselines.narx import NeuralNARX, PolynomialNARX
from tras.paper.baselines.sindy import SINDy
from tras.paper.baselines.subspace import N4SID
from tras.paper.readings import PAPER_FIT
from tras.paper.validation import ANGLES, judge
from tras.recording import Recording, join
from tras.solver.threads import one_blas_thread
from tras.twin_rotor.closed_loop import INPUTS
from tras.twin_rotor.plant import STATE_PAIRS
from tras.workflow import cache, provenance
from tras.workflow.study import compute, require_known

TRIES = 6
METHODS = {
    "DMDc": [DMDc(0.0), DMDc(1e-8), DMDc(1e-6), DMDc(1e-4), DMDc(rank=5), DMDc(rank=4)],
    "N4SID": [
        N4SID(4, 2, 1e-5), N4SID(4, 3, 1e-2), N4SID(4, 4, 1e-2), N4SID(4, 4, 1e-4), N4SID(4, 10, 1e-2),
        N4SID(6, 10, 1e-3),
    ],
    "Hammerstein-Wiener": [HammersteinWiener(*degrees) for degrees in ((3, 1), (5, 1), (1, 3), (3, 3), (5, 3), (5, 5))],
    "NARX": [
        PolynomialNARX(2), PolynomialNARX(3), PolynomialNARX(3, terms=20), PolynomialNARX(4, terms=40),
        PolynomialNARX(1, lags=2), PolynomialNARX(2, lags=2, terms=30),
    ],
    "neural network": [
        NeuralNARX((32,)), NeuralNARX((64,)), NeuralNARX((32, 32)), NeuralNARX((32,), iterations=100),
        NeuralNARX((32, 32), alpha=1e-3), NeuralNARX((32,), lags=2),
    ],
    "SINDy": [
        SINDy(2, 0.02), SINDy(2, 0.1), SINDy(3, 0.01), SINDy(3, 0.05), SINDy(3, 0.05, differentiation="forward"),
        SINDy(4, 0.1),
    ],
    "EDMD (pykoop)": [
        PykoopEdmd(2), PykoopEdmd(3), PykoopEdmd(4), PykoopEdmd(3, alpha=1.0), PykoopEdmd(2, relift=False),
        PykoopEdmd(3, relift=False),
    ],
    "Koopman, the paper's": [KoopmanModel(GaussianRBF(2, 1.0, seed), **PAPER_FIT) for seed in range(6)],
    "Koopman, monomials": [KoopmanModel(Monomials(n), p) for n in (2, 3, 4) for p in ("vector_field", "one_step")],
    "Koopman, mechanical": [KoopmanModel(Mechanical(n), p) for n in (4, 6, 8) for p in ("vector_field", "one_step")],
    "grey box": [
        GreyBox(0.5), GreyBox(1.0), GreyBox(2.5), GreyBox(5.0), GreyBox(1.0, "soft_l1"), GreyBox(5.0, "soft_l1"),
    ],
}  # fmt: skip
NEEDS_TORQUES = ("grey box",)


@dataclass(frozen=True)
class Study:
    """What is compared; times in s, noise in percent of each state's range, fractions of the training trajectories.

    ``data_inputs`` are those for which noise and amount of data are varied.
    """

    trajectory: float = 5.0
    window: float = 6.0
    middle: float = 1.0
    train_fraction: float = 0.8
    split_seed: int = 0
    noise: float = 1.0
    noise_seed: int = 1
    fractions: tuple[float, ...] = (0.01, 0.1)
    data_inputs: tuple[str, ...] = ("torque",)
    methods: tuple[str, ...] = tuple(METHODS)


def jobs(study: Study, only: list[dict] | None = None) -> list[dict]:
    """All cases of the study: dicts of ``method, input, noise, smoothed, fraction``.

    ``only``: those that fit one of some dicts option -> choices, for example ``[{"method": ("NARX",)}]``.
    """
    require_known(study, methods=METHODS, data_inputs=INPUTS)
    plain = {"noise": 0.0, "smoothed": False, "fraction": 1.0}
    conditions = [{"input": name, **plain} for name in INPUTS]
    for name in study.data_inputs:
        changes = [{"noise": study.noise, "smoothed": smoothed} for smoothed in (False, True)]
        changes += [{"fraction": fraction} for fraction in study.fractions]
        conditions += [{"input": name, **plain, **change} for change in changes]
    cases = [{"method": method, **condition} for condition in conditions for method in study.methods]
    cases = [job for job in cases if job["input"] == "torque" or job["method"] not in NEEDS_TORQUES]
    some = [{}] if only is None else only
    return [job for job in cases if any(all(job[name] in choices for name, choices in one.items()) for one in some)]


def recordings(data: Path) -> tuple[Recording, dict[str, Recording]]:
    """Training and validation recordings of the study, as 01_data_generation leaves them in a folder."""
    train, multisines = (Recording.read(data / f"{name}.nc") for name in ("train", "validation_multisine"))
    fresh = {f"multisine {seed}": multisines[i] for i, seed in enumerate(multisines.attributes["seed"])}
    return train, fresh | {name: Recording.read(data / f"validation_{name}.nc") for name in ("steps", "chirp")}


def run(
    study: Study, train: Recording, validation: dict[str, Recording], folder, *, only: list[dict] | None = None,
    processes: int = 2, progress=None,
) -> dict[str, pd.DataFrame]:  # fmt: skip
    """The whole study; what is in the cache is not computed again.

    Parameters
    ----------
    study : Study
    train : Recording
        One long trajectory with references and torques.
    validation : dict of str to Recording
        Name -> recording of one trajectory, none of it seen in ``train``.
    folder : str or Path
        Of the cache.
    only : list of dict, optional
        As in `jobs`.
    processes : int
    progress : text stream, optional

    Returns
    -------
    dict of str to pandas.DataFrame
        ``scores``: one row per method, input, recording, horizon (s; the length of a free run) and angle, with ``enr``
        (fraction), ``bfr, nrmse`` (percent), ``windows, diverged, parameters``. ``data``: NRMSE over windows for each
        noise and fraction. ``tuning``: every setting that was tried, its error, the best one. ``times``: CPU seconds of
        tuning, of the last fit and of its predictions, never the same twice.
    """
    cases, packages = jobs(study, only), provenance.packages()
    in_jobs = ("methods", "fractions", "data_inputs", "noise")
    options = {name: value for name, value in vars(study).items() if name not in in_jobs}
    recordings = {"train": train, **validation}
    about = {
        "study": options,
        "libraries": {name: packages[name] for name in ("scikit-learn", "pysindy", "pykoop")},
        "data": formats.checksum({"names": [*recordings]}, (pair for r in recordings.values() for pair in r)),
    }

    def shared(missing):
        needed = any(job["smoothed"] for job in missing)
        smoothed = prepare(study, {"noise": study.noise, "smoothed": True}, train) if needed else None
        return study, train, validation, smoothed

    values, _ = compute(
        case, cases, shared, keys=[{**about, **job} for job in cases], folder=folder, kind="comparison",
        code=cache.code_digest("tras.paper.comparison"), cost=_cost, title="compare", unit=" cases",
        progress=progress or False, processes=processes,
    )  # fmt: skip
    return _tables(cases, values)


def case(study: Study, train: Recording, validation: dict[str, Recording], smoothed, job: dict) -> dict:
    """One method under one condition: dict of ``scores, tuning, times, parameters, failure``; see `training`."""
    # The libraries multiply small matrices: threads of BLAS would wait for each other, and change last bits.
    with one_blas_thread(), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of libraries, on ill-conditioned candidates: their errors say it
        data = training(study, job, train, smoothed)
        clock = [time.process_time()]
        try:
            model, tried = choose(data, METHODS[job["method"]])
        except ValueError as reason:
            return {"scores": [], "tuning": [], "times": {}, "parameters": None, "failure": str(reason)}
        clock.append(time.process_time())
        model.fit(data)
        clock.append(time.process_time())
        fresh = {name: recording.select(inputs=INPUTS[job["input"]]) for name, recording in validation.items()}
        scores = score(study, model, fresh, everything=_is_main(job))
        clock.append(time.process_time())
    times = dict(zip(("tune", "fit", "simulate"), np.diff(clock).tolist()))
    tuning = [
        {"setting": " ".join(str(setting).split()), "error": error, "chosen": bool(best), "failure": failure}
        for setting, error, best, failure in tried[["model", "error", "chosen", "failure"]].itertuples(index=False)
    ]
    return {"scores": scores, "tuning": tuning, "times": times, "parameters": n_parameters(model), "failure": ""}


def prepare(study: Study, job: dict, train: Recording) -> Recording:
    """The recording with the job's noise, smoothed if it says so; before any cut, so that shared samples stay one."""
    recording = add_noise(train, job["noise"] / 100, study.noise_seed) if job["noise"] else train
    return smooth(recording, STATE_PAIRS) if job["smoothed"] else recording


def training(study: Study, job: dict, train: Recording, smoothed: Recording | None = None) -> Recording:
    """The trajectories that a job may see; ``smoothed``: what `prepare` gives for a smoothed job, if it is at hand."""
    recording = smoothed if job["smoothed"] and smoothed is not None else prepare(study, job, train)
    windows = recording.select(inputs=INPUTS[job["input"]]).cut(round(study.trajectory / recording.dt) + 1)
    pieces, _ = windows.split(study.train_fraction, study.split_seed)
    order = np.random.default_rng(study.split_seed).permutation(len(pieces))
    return pieces[np.sort(order[: max(1, round(job["fraction"] * len(pieces)))])]


def score(study: Study, model, recordings: dict[str, Recording], *, everything: bool = True) -> list[dict]:
    """Errors at one sample, at ``middle`` and over the window, within the same windows, and over the free run.

    Without ``everything``: over the window alone, and on the multisines alone.

    Returns
    -------
    list of dict
        ``recording, horizon, angle, enr, bfr, nrmse, windows, diverged``; metrics are over the windows that did not
        diverge, NaN if all did.
    """
    rows = []
    multisines = {name: recording for name, recording in recordings.items() if name.startswith("multisine")}
    for name, recording in (recordings if everything else multisines).items():
        windows, dt = recording.cut(round(study.window / recording.dt) + 1), recording.dt
        predicted = model.predict(windows)
        spans = [(dt, slice(1, 2)), (study.middle, slice(round(study.middle / dt) + 1)), (study.window, slice(None))]
        for horizon, samples in spans if everything else spans[-1:]:
            scores = judge(windows, predicted, samples=samples)
            rows += [{"recording": name, "horizon": horizon, **row} for row in scores]
    if everything:
        for (name, recording), prediction in zip(multisines.items(), model.predict(join(multisines.values()))):
            horizon = (len(prediction) - 1) * recording.dt
            rows += [{"recording": name, "horizon": horizon, **row} for row in judge(recording, prediction[None])]
    return rows


def n_parameters(model) -> int:
    """Numbers found from data that a prediction needs; scales of the channels are not counted, for no method."""
    if hasattr(model, "n_parameters_"):
        return int(model.n_parameters_)
    rows = len(model.state_names_)
    return int(model.W_.size) if model.predictor == "vector_field" else rows * len(model.koopman_matrix)


# --- parts ------------------------------------------------------------------------------------------------------------


def _is_main(job):
    return job["noise"] == 0 and job["fraction"] == 1


def _cost(job):
    """Which jobs to begin with, so that no process is left with a long one at the end."""
    dear = {"neural network": 8, "Koopman, monomials": 4, "Koopman, mechanical": 3, "SINDy": 3}.get(job["method"], 1)
    return dear * job["fraction"] * (2 if _is_main(job) else 1)


def _tables(cases, values):
    """The four tables, in the order of the jobs."""
    tables = {name: [] for name in ("scores", "data", "tuning", "times")}
    columns = ("recording", "angle", "nrmse", "windows", "diverged")
    for job, value in zip(cases, values):
        parameters, failure = value["parameters"], value["failure"]
        rows = [{name: math.nan if item is None else item for name, item in row.items()} for row in value["scores"]]
        window = max((row["horizon"] for row in rows if row["windows"] > 1), default=None)
        short = [row for row in rows if row["horizon"] == window and row["recording"].startswith("multisine")]
        short = [[row[name] for name in columns] for row in short]
        for row in short if rows else [("", angle, math.nan, 0, 0) for angle in ANGLES]:
            tables["data"].append({**job, **dict(zip(columns, row)), "parameters": parameters, "failure": failure})
        if _is_main(job):
            about = {"method": job["method"], "input": job["input"]}
            tables["scores"] += [{**about, **row, "parameters": parameters} for row in rows]
        for row in value["tuning"]:
            tables["tuning"].append({**job, **row, "error": math.inf if row["error"] is None else row["error"]})
        tables["times"].append({**job, **value["times"]})
    return {name: pd.DataFrame(rows) for name, rows in tables.items()}
