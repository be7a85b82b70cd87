"""The paper's method beside others: each tuned by the same rule on the same trajectories, scored on the same untouched recordings by the same code.

Every method brings `TRIES` settings. `tras.choose` compares them by multi-step error on training trajectories held out for it, and fits the winner to all training
trajectories; validation recordings are seen by nobody before that. The rule is applied anew to each input, amount of data and level of noise.
"""

import math
import time
import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd

from tras.dictionaries.mechanical import Mechanical
from tras.dictionaries.monomials import Monomials
from tras.dictionaries.radial import GaussianRBF
from tras.identification.noise import add_noise
from tras.identification.search import choose
from tras.identification.smoothing import smooth
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
from tras.recording import Recording
from tras.twin_rotor.closed_loop import INPUTS
from tras.twin_rotor.plant import STATE_PAIRS
from tras.workflow import cache
from tras.workflow.study import compute

TRIES = 6
METHODS = {
    "DMDc": [DMDc(0.0), DMDc(1e-8), DMDc(1e-6), DMDc(1e-4), DMDc(rank=5), DMDc(rank=4)],
    "N4SID": [N4SID(4, 2, 1e-5), N4SID(4, 3, 1e-2), N4SID(4, 4, 1e-2), N4SID(4, 4, 1e-4), N4SID(4, 10, 1e-2), N4SID(6, 10, 1e-3)],
    "Hammerstein-Wiener": [HammersteinWiener(*degrees) for degrees in ((3, 1), (5, 1), (1, 3), (3, 3), (5, 3), (5, 5))],
    "NARX": [
        PolynomialNARX(2), PolynomialNARX(3), PolynomialNARX(3, terms=20), PolynomialNARX(4, terms=40), PolynomialNARX(1, lags=2), PolynomialNARX(2, lags=2, terms=30),
    ],
    "neural network": [
        NeuralNARX((32,)), NeuralNARX((64,)), NeuralNARX((32, 32)), NeuralNARX((32,), iterations=100), NeuralNARX((32, 32), alpha=1e-3), NeuralNARX((32,), lags=2),
    ],
    "SINDy": [SINDy(2, 0.02), SINDy(2, 0.1), SINDy(3, 0.01), SINDy(3, 0.05), SINDy(3, 0.05, differentiation="forward"), SINDy(4, 0.1)],
    "EDMD (pykoop)": [PykoopEdmd(2), PykoopEdmd(3), PykoopEdmd(4), PykoopEdmd(3, alpha=1.0), PykoopEdmd(2, relift=False), PykoopEdmd(3, relift=False)],
    "Koopman, the paper's": [KoopmanModel(GaussianRBF(2, 1.0, seed), **PAPER_FIT) for seed in range(6)],
    "Koopman, monomials": [KoopmanModel(Monomials(degree), predictor) for degree in (2, 3, 4) for predictor in ("vector_field", "one_step")],
    "Koopman, mechanical": [KoopmanModel(Mechanical(degree), predictor) for degree in (4, 6, 8) for predictor in ("vector_field", "one_step")],
    "grey box": [GreyBox(0.5), GreyBox(1.0), GreyBox(2.5), GreyBox(5.0), GreyBox(1.0, "soft_l1"), GreyBox(5.0, "soft_l1")],
}  # fmt: skip
OURS = ("Koopman, the paper's", "Koopman, monomials", "Koopman, mechanical")
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


def jobs(study):
    """All cases of the study: dicts of ``method, input, noise, smoothed, fraction``, the dearest first."""
    unknown = [name for name in study.methods if name not in METHODS]
    if unknown:
        raise ValueError(f"methods holds {unknown[0]!r}; choose among {', '.join(METHODS)}.")
    unknown = [name for name in study.data_inputs if name not in INPUTS]
    if unknown:
        raise ValueError(f"data_inputs holds {unknown[0]!r}; choose among {', '.join(INPUTS)}.")
    conditions = [{"input": name, "noise": 0.0, "smoothed": False, "fraction": 1.0} for name in INPUTS]
    for name in study.data_inputs:
        conditions += [
            {"input": name, "noise": study.noise, "smoothed": smoothed, "fraction": 1.0} for smoothed in (False, True)
        ]
        conditions += [
            {"input": name, "noise": 0.0, "smoothed": False, "fraction": fraction} for fraction in study.fractions
        ]
    found = [{"method": method, **condition} for condition in conditions for method in study.methods]
    return [job for job in found if job["input"] == "torque" or job["method"] not in NEEDS_TORQUES]


def run(study, train, validation, folder, *, processes=2, progress=None):
    """The whole study, what is found in the cache not computed again.

    Parameters
    ----------
    study : Study
    train : Recording
        One long trajectory with references and torques.
    validation : dict of str to Recording
        Name -> recording of one trajectory, none of it seen in ``train``.
    folder : str or Path
        Of the cache.
    processes : int
    progress : text stream, optional

    Returns
    -------
    dict of str to pandas.DataFrame
        ``scores``: one row a method, input, recording, horizon (s; the length of a free run) and angle, with ``enr`` (fraction), ``bfr, nrmse`` (percent), ``windows,
        diverged, parameters``. ``data``: NRMSE over windows for each noise and fraction. ``tuning``: every setting tried, its error, the chosen one.
        ``times``: CPU seconds of tuning, of the last fit and of its predictions; they are no two times the same.
    """
    wanted = jobs(study)
    about = {"study": _plain(study), "libraries": _versions(), "data": _digest(train, validation)}

    def shared(missing):
        needed = any(job["smoothed"] for job in missing)
        smoothed = prepare(study, {"noise": study.noise, "smoothed": True}, train) if needed else None
        return study, train, validation, smoothed

    values, _ = compute(
        _case_of, wanted, shared, keys=[{**about, **job} for job in wanted], folder=folder, kind="comparison",
        code=cache.code_digest("tras.paper.comparison"), cost=_cost, title="compare", unit=" cases",
        progress=progress or False, processes=processes,
    )  # fmt: skip
    return _tables(wanted, values)


def case(study, job, train, validation, prepared=None):
    """One method under one condition: dict of ``scores, tuning, times, parameters, failure``. ``prepared``: as in `training`."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of libraries, on ill-conditioned candidates: their errors say it
        return _case(study, job, training(study, job, train, prepared), validation)


def _case(study, job, data, validation):
    began = time.process_time()
    try:
        model, tried = choose(data, METHODS[job["method"]])
    except ValueError as reason:
        return {"scores": [], "tuning": [], "times": {}, "parameters": None, "failure": str(reason)}
    tuned = time.process_time()
    model.fit(data)
    fitted = time.process_time()
    fresh = {name: recording.select(inputs=INPUTS[job["input"]]) for name, recording in validation.items()}
    scores = score(study, model, fresh, everything=_is_main(job))
    times = {"tune": tuned - began, "fit": fitted - tuned, "simulate": time.process_time() - fitted}
    rows = [
        {"setting": _text(row.model), "error": row.error, "chosen": bool(row.chosen), "failure": row.failure}
        for row in tried.itertuples()
    ]
    return {"scores": scores, "tuning": rows, "times": times, "parameters": n_parameters(model), "failure": ""}


def prepare(study, job, train):
    """The whole training recording with the job's noise, smoothed if it says so: before any cut, whose shared samples then stay one."""
    recording = add_noise(train, job["noise"] / 100, study.noise_seed) if job["noise"] else train
    return smooth(recording, STATE_PAIRS) if job["smoothed"] else recording


def training(study, job, train, prepared=None):
    """The trajectories that a job may see; ``prepared`` is what `prepare` gives, if it is at hand."""
    recording = (prepare(study, job, train) if prepared is None else prepared).select(inputs=INPUTS[job["input"]])
    pieces, _ = recording.cut(round(study.trajectory / recording.dt) + 1).split(study.train_fraction, study.split_seed)
    order = np.random.default_rng(study.split_seed).permutation(len(pieces))
    return pieces[np.sort(order[: max(1, round(job["fraction"] * len(pieces)))])]


def score(study, model, recordings, *, everything=True):
    """Errors at one sample, a second and the window's length, all within the same windows, and over the free run.

    Returns
    -------
    list of dict
        ``recording, horizon, angle, enr, bfr, nrmse, windows, diverged``; metrics are over the windows that did not diverge, NaN if all did.
    """
    rows = []
    for name, recording in recordings.items():
        if not everything and not name.startswith("multisine"):
            continue
        windows = recording.cut(round(study.window / recording.dt) + 1)
        predicted, dt = model.predict(windows), recording.dt
        spans = [
            (dt, 1, 2),
            (study.middle, 0, round(study.middle / dt) + 1),
            (study.window, 0, windows.states.shape[1]),
        ]
        for horizon, first, last in spans if everything else spans[-1:]:
            judged = judge(windows, predicted, samples=slice(first, last))
            rows += [{"recording": name, "horizon": horizon, **row} for row in judged]
    if everything:
        long = {name: recording for name, recording in recordings.items() if name.startswith("multisine")}
        joined = Recording(
            [r.states[0] for r in long.values()], [r.inputs[0] for r in long.values()], dt,
            state_names=recording.state_names, input_names=recording.input_names,
        )  # fmt: skip
        for (name, recording), prediction in zip(long.items(), model.predict(joined)):
            horizon = (len(prediction) - 1) * dt
            rows += [{"recording": name, "horizon": horizon, **row} for row in judge(recording, prediction[None])]
    return rows


def n_parameters(model):
    """Numbers found from data that a prediction needs; scales of the channels are not counted, for no method."""
    if hasattr(model, "n_parameters_"):
        return int(model.n_parameters_)
    rows = len(model.state_names_)
    return int(model.W_.size) if model.predictor == "vector_field" else rows * len(model.koopman_matrix)


# ------------------------------------------------------------------------------------------------------------------------- parts


def _case_of(study, train, validation, smoothed, job):
    return case(study, job, train, validation, smoothed if job["smoothed"] else None)


def _is_main(job):
    return job["noise"] == 0 and job["fraction"] == 1


def _cost(job):
    """Which jobs to begin with, so that no process is left with a long one at the end."""
    dear = {"neural network": 8, "Koopman, monomials": 4, "Koopman, mechanical": 3, "SINDy": 3}.get(job["method"], 1)
    return dear * job["fraction"] * (2 if _is_main(job) else 1)


def _text(model):
    return " ".join(str(model).split())


def _plain(study):
    """The study as JSON holds it, without the list of methods: a job names its own, and its settings."""
    values = {
        name: value
        for name, value in vars(study).items()
        if name not in ("methods", "fractions", "data_inputs", "noise")
    }
    return values


def _versions():
    from importlib.metadata import version

    return {name: version(name) for name in ("scikit-learn", "pysindy", "pykoop")}


def _digest(train, validation):
    import hashlib

    digest = hashlib.sha256()
    for name, recording in [("train", train), *validation.items()]:
        digest.update(name.encode())
        for x, u in recording:
            digest.update(np.ascontiguousarray(x).tobytes() + np.ascontiguousarray(u).tobytes())
    return digest.hexdigest()[:16]


def _tables(wanted, found):
    """The four tables from all jobs and their results, in the order of the jobs."""
    scores, data, tuning, times = [], [], [], []
    for job, value in zip(wanted, found):
        labels = {name: job[name] for name in ("method", "input", "noise", "smoothed", "fraction")}
        rows = [{name: math.nan if item is None else item for name, item in row.items()} for row in value["scores"]]
        window = max((row["horizon"] for row in rows if row["windows"] > 1), default=None)
        short = [row for row in rows if row["horizon"] == window and row["recording"].startswith("multisine")]
        about = {"parameters": value["parameters"], "failure": value["failure"]}
        data += [
            {**labels, **{name: row[name] for name in ("recording", "angle", "nrmse", "windows", "diverged")}, **about}
            for row in short
        ]
        if not rows:
            data += [
                {**labels, "recording": "", "angle": angle, "nrmse": math.nan, "windows": 0, "diverged": 0, **about}
                for angle in ANGLES
            ]
        if _is_main(job):
            scores += [
                {"method": job["method"], "input": job["input"], **row, "parameters": value["parameters"]}
                for row in rows
            ]
        tuning += [
            {**labels, **row, "error": math.inf if row["error"] is None else row["error"]} for row in value["tuning"]
        ]
        times.append({**labels, **value["times"]})
    return {
        "scores": pd.DataFrame(scores),
        "data": pd.DataFrame(data),
        "tuning": pd.DataFrame(tuning),
        "times": pd.DataFrame(times),
    }
