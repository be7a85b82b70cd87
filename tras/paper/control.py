"""From identified models to controllers, each tried on the true plant: the paper's future work, second half.

All controllers of one kind have the same horizon, weights, limits and observer; only the model in them differs. A run
is one closed loop of the plant; `run` makes all of them, `TRUE` is the same controller with the plant's own equations.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from tras.control.lqr import LQR
from tras.control.mpc import MPC
from tras.control.observer import Observer
from tras.control.predictors import plant
from tras.twin_rotor.closed_loop import PID, simulate_closed_loop
from tras.twin_rotor.excitation import multisine
from tras.twin_rotor.gusts import gusts
from tras.twin_rotor.plant import LUMPED, STATE_NAMES, PlantParameters
from tras.workflow import cache
from tras.workflow.study import compute, require_known

ANGLES = {"yaw": 2, "pitch": 0}  # their places among the states; references hold pitch, then yaw
MODELS = ("linear", "lifted linear", "the paper's", "cubic", "mechanical")
TRUE = "true plant"
CONTROLLERS = {  # name -> the controller (None: the PID), and the model in it
    "PID": (None, ""), "LQR, mechanical": (LQR, "mechanical"),
    **{f"MPC, {model}": (MPC, model) for model in (*MODELS, TRUE)},
}  # fmt: skip
# A rounding unit changes the errors of these runs by percents, so that they are in no file of results.
CHAOTIC = ({"controller": "MPC, cubic"}, {"controller": "MPC, the paper's", "reference": "paper", "preview": False})
OURS, BOUND = "MPC, mechanical", f"MPC, {TRUE}"
REFERENCES = ("paper", "fast", "steps", "eight")
RIVALS = tuple(f"MPC, {model}" for model in MODELS if model != "mechanical")
OUTSIDE = ("PID", "MPC, linear", OURS, BOUND)  # those that meet disturbances
CHANGED = ("PID", OURS)  # those on rigs with other parameters
STEP_TIME, TOLERANCE = 1.0, 0.05  # s; of the step, within which an angle counts as settled
LAST = 1.0  # s at the end of a run, where its steady error is measured
RUNAWAY = 3.0  # rad: a larger error counts as divergence
SCORES = (
    "pitch", "yaw", "pitch_whole", "yaw_whole", "settling_pitch", "settling_yaw", "steady", "outside", "failures",
    "diverged",
)  # fmt: skip


@dataclass(frozen=True)
class Study:
    """What is tried; times in s, angles in rad, torques in N m.

    ``skip`` are seconds at the start that errors leave out, but for those of whole runs: the rig starts at rest, and
    most references do not. ``slower`` are factors of the weight on the changes of the torques with which the rivals are
    tried too. ``changed`` are the parameters that are changed one at a time by ``change`` (%) either way; ``rigs`` have
    all of them drawn within it. Gusts, the constant torque and the noise are in percent: of half the range of each
    torque, and of each state's range in the training data.
    """

    sampling_time: float = 0.01
    duration: float = 10.0
    paper_duration: float = 20.0
    skip: float = 1.0
    horizon: int = 40
    rate_weight: float = 0.03
    slower: tuple[float, ...] = (10.0, 1000.0)
    input_weight: float = 0.3
    fast_frequencies: tuple[float, float] = (3.0, 2.0)
    fast_peaks: tuple[float, float] = (0.6, 1.5)
    fast_seed: int = 0
    step: tuple[float, float] = (0.3, 1.0)
    eight: tuple[float, float] = (0.4, 0.8)
    eight_period: float = 5.0
    gust_levels: tuple[float, ...] = (5.0, 10.0, 20.0)
    gust_period: float = 4.0
    gust_time: float = 1.0
    gust_seed: int = 1
    torque: float = 10.0
    noise: float = 1.0
    noise_seed: int = 2
    change: float = 20.0
    changed: tuple[str, ...] = LUMPED
    rigs: int = 40
    rig_seed: int = 3
    rig_duration: float = 4.0
    controllers: tuple[str, ...] = tuple(CONTROLLERS)

    def __post_init__(self):
        require_known(self, controllers=CONTROLLERS, changed=LUMPED)
        if not self.sampling_time < self.skip <= min(self.duration, self.rig_duration) / 2:
            raise ValueError(f"skip is {self.skip} s; give more than a sample and at most half of each run.")

    @property
    def halves(self) -> np.ndarray:
        """Half the range of each torque (2,): what percents of torques mean."""
        limits = PlantParameters()
        return np.array([np.ptp(limits.u_phi_limits), np.ptp(limits.u_psi_limits)]) / 2

    def samples(self, duration):
        return round(duration / self.sampling_time) + 1


def references(study: Study, paper: np.ndarray) -> dict[str, np.ndarray]:
    """The references (samples, 2), pitch and yaw in rad, of `REFERENCES`; ``paper`` are those of a recording.

    Each goes on for a horizon behind its duration, which no error counts: a plan should not end with the run.
    """
    samples = study.samples(study.duration) + study.horizon
    t = study.sampling_time * np.arange(samples)
    turn = 2 * np.pi * t / study.eight_period
    fast = multisine(study.duration, study.sampling_time, study.fast_frequencies, study.fast_peaks, study.fast_seed)
    return {
        "paper": paper[: study.samples(study.paper_duration) + study.horizon],
        "fast": fast[np.arange(samples) % (len(fast) - 1)],
        "steps": np.where(t[:, None] >= STEP_TIME - 1e-9, study.step, 0.0),
        "eight": np.column_stack([study.eight[0] * np.sin(2 * turn), study.eight[1] * np.sin(turn)]),
    }


def points(study: Study) -> list[dict]:
    """All runs: dicts of ``controller, preview, reference, condition, level, changed``.

    In calm air every controller meets every reference, with preview and without. All else is one thing at a time.
    """

    def runs(names, reference, condition, level=0.0, *, preview=True, changed=""):
        about = {"reference": reference, "condition": condition, "level": level, "changed": changed}
        names = [name for name in names if name in study.controllers]
        return [{"controller": name, "preview": preview and is_mpc(name), **about} for name in names]

    mpc = [name for name in CONTROLLERS if is_mpc(name)]
    result = []
    for reference in REFERENCES:
        result += runs(CONTROLLERS, reference, "calm") + runs(mpc, reference, "calm", preview=False)
    result += runs(mpc, "fast", "no disturbance model")
    for factor in study.slower:
        result += runs(RIVALS, "fast", "slower", factor)
    for condition in ("square gusts", "Dryden gusts"):
        for level in study.gust_levels:
            result += runs(OUTSIDE, "fast", condition, level)
    result += runs(OUTSIDE, "steps", "constant torque", study.torque, preview=False)
    result += runs(OUTSIDE, "fast", "noise", study.noise)
    result += runs([OURS, BOUND], "fast", "noise, angles only", study.noise)
    for name in study.changed:
        for level in (-study.change, study.change):
            result += runs(CHANGED, "fast", "parameter", level, changed=name)
    for number in range(study.rigs):
        result += runs(CHANGED, "fast", "rig", study.change, changed=str(number))
    return result


def is_mpc(name: str) -> bool:
    """Whether this controller plans ahead, so that a preview is of use to it."""
    return CONTROLLERS[name][0] is MPC


def controller(study: Study, models: dict, name: str, *, condition: str = "calm", slower: float = 1.0, noise=None):
    """A controller of `CONTROLLERS` for the usual rig; ``noise`` (4,) is what its observer expects of the states."""
    kind, which = CONTROLLERS[name]
    rig = PlantParameters()
    if kind is None:
        return PID.defaults(rig)
    model = plant(rig, study.sampling_time) if which == TRUE else models[which]
    common = {"weights": {"phi": 1.0, "psi": 1.0}, "limits": [rig.u_phi_limits, rig.u_psi_limits]}
    if condition == "no disturbance model":
        common["offset_free"] = False
    else:
        measured = ("phi", "psi") if condition == "noise, angles only" else STATE_NAMES
        expected = noise if noise is None else {name: noise[STATE_NAMES.index(name)] for name in measured}
        common["observer"] = Observer(model, measured, noise=expected)
    if kind is LQR:
        return LQR(model, input_weights=study.input_weight, **common)
    return MPC(model, horizon=study.horizon, rate_weights=slower * study.rate_weight, **common)


def loop(study: Study, models: dict, reference: np.ndarray, spread: np.ndarray, point: dict):
    """The recording of one run of `points`, and its controller. ``spread`` (4,) is each state's range in the data."""
    condition, level = point["condition"], point["level"]
    options, samples = {}, len(reference)
    if condition == "square gusts":
        half = np.floor(study.sampling_time * np.arange(samples) / (study.gust_period / 2) + 1e-9)
        options["disturbances"] = np.where(half % 2, 1.0, -1.0)[:, None] * level / 100 * study.halves
    elif condition == "Dryden gusts":
        duration = (samples - 1) * study.sampling_time
        rms = tuple(level / 100 * study.halves)
        options["disturbances"] = gusts(duration, study.sampling_time, rms, study.gust_time, study.gust_seed)
    elif condition == "constant torque":
        options["disturbances"] = level / 100 * study.halves
    noise = level / 100 * spread if condition.startswith("noise") else None
    if noise is not None:
        options |= {"noise": noise, "seed": study.noise_seed}
    slower = level if condition == "slower" else 1.0
    control = controller(study, models, point["controller"], condition=condition, slower=slower, noise=noise)
    rig = a_rig(study, point)
    log = simulate_closed_loop(
        reference, study.sampling_time, rig, controllers=control, preview=point["preview"], **options
    )
    return log, control


def a_rig(study: Study, point: dict) -> PlantParameters:
    """The plant of a run: the nominal one, with one parameter changed, or with all of them drawn."""
    usual = {name: getattr(PlantParameters(), name) for name in LUMPED}
    if point["condition"] == "parameter":
        usual[point["changed"]] *= 1 + point["level"] / 100
    elif point["condition"] == "rig":
        rng = np.random.default_rng([study.rig_seed, int(point["changed"])])
        factors = 1 + point["level"] / 100 * rng.uniform(-1, 1, len(LUMPED))
        usual = {name: value * factor for (name, value), factor in zip(usual.items(), factors)}
    return PlantParameters(**usual)


def run_point(study: Study, models: dict, paths: dict, spread: np.ndarray, point: dict) -> dict:
    """The scores of one run: `SCORES`, of which the errors are root mean squares in rad."""
    reference = paths[point["reference"]]
    if point["condition"] in ("parameter", "rig"):
        reference = reference[: study.samples(study.rig_duration) + study.horizon]
    log, control = loop(study, models, reference, spread, point)
    return score(study, log, reference, point["reference"]) | {"failures": int(getattr(control, "failures", 0))}


def score(study: Study, log, reference: np.ndarray, name: str) -> dict:
    """Errors, settling times (s), and how far a torque was beyond its limits (N m), of one recording."""
    errors = (log.states[0][:, [0, 2]] - reference)[: -study.horizon]
    torques, rig = log.select(inputs=["u_phi", "u_psi"]).inputs[0], PlantParameters()
    low, high = np.array([rig.u_phi_limits, rig.u_psi_limits]).T
    rms, whole = (np.sqrt((errors[k:] ** 2).mean(axis=0)) for k in (study.samples(study.skip) - 1, 0))
    settling, steady = (np.nan, np.nan), np.nan
    if name == "steps":
        first = study.samples(STEP_TIME) - 1
        settling = [_settling(error, size, first) * study.sampling_time for error, size in zip(errors.T, study.step)]
        steady = np.abs(errors[-study.samples(LAST) :]).max()
    return {
        "pitch": rms[0], "yaw": rms[1], "pitch_whole": whole[0], "yaw_whole": whole[1],
        "settling_pitch": settling[0], "settling_yaw": settling[1], "steady": steady,
        "outside": np.maximum(torques - high, low - torques).max().clip(0),
        "diverged": bool(np.abs(errors).max() > RUNAWAY),
    }  # fmt: skip


def _settling(error, size, first):
    """Samples from the step until the error stays within `TOLERANCE`; NaN if it does not."""
    outside = np.flatnonzero(np.abs(error[first:]) > TOLERANCE * abs(size))
    samples = outside[-1] + 1 if len(outside) else 0
    return samples if samples < len(error) - first else np.nan


def run(
    study: Study, models: dict, about: dict, paper: np.ndarray, spread: np.ndarray, folder: Path, *,
    processes: int = 2, progress=None,
) -> pd.DataFrame:  # fmt: skip
    """All runs of `points` as a table, one row each; what is in the cache is not computed again.

    Parameters
    ----------
    study : Study
    models : dict of str to KoopmanModel
        By the names of `CONTROLLERS`, with torques as inputs.
    about : dict
        What the models are made of, as JSON holds it: part of the keys of the cache.
    paper : (samples, 2) ndarray
        References of a recording that no model has seen.
    spread : (4,) ndarray
        Range of each state in the training data.
    folder : Path
        Of the cache.
    """
    cases, paths = points(study), references(study, paper)
    options = {name: value for name, value in vars(study).items() if name not in ("controllers", "changed", "rigs")}
    common = cache.plain({"study": options, **about})
    values, _ = compute(
        run_point, cases, (study, models, paths, spread), keys=[{**common, **case} for case in cases], folder=folder,
        kind="control", code=cache.code_digest("tras.paper.control"), cost=_cost, title="control", unit=" runs",
        progress=progress or False, processes=processes,
    )  # fmt: skip
    scores = [{name: np.nan if value[name] is None else value[name] for name in SCORES} for value in values]
    return pd.DataFrame([{**case, **score} for case, score in zip(cases, scores)])


def repeatable(runs: pd.DataFrame) -> pd.DataFrame:
    """The rows of a table of runs that are the same on every processor, without those of `CHAOTIC`."""
    for case in CHAOTIC:
        if set(case) <= set(runs.columns):
            runs = runs[(runs[list(case)] != pd.Series(case)).any(axis=1)]
    return runs


def _cost(point):
    """Which runs to begin with: the dearest, so that no process is left with a long one at the end."""
    dear = {"PID": 0.1, "LQR, mechanical": 3.0, "MPC, linear": 1.2, "MPC, lifted linear": 0.6, OURS: 3.0}
    short = 0.5 if point["condition"] in ("parameter", "rig") else 2.0 if point["reference"] == "paper" else 1.0
    return dear.get(point["controller"], 2.0) * short


class Timed:
    """A controller that notes how long each of its steps takes, in seconds of the wall clock."""

    def __init__(self, controller):
        self.controller, self.horizon, self.seconds = controller, controller.horizon, []

    def reset(self):
        self.controller.reset()

    def __call__(self, x, reference):
        begin = time.perf_counter()
        u = self.controller(x, reference)
        self.seconds.append(time.perf_counter() - begin)
        return u


def solve_times(study: Study, models: dict, reference: np.ndarray) -> pd.DataFrame:
    """Wall-clock time of each step of each MPC, one process, with preview: never the same twice.

    Returns
    -------
    pandas.DataFrame
        Columns ``controller, step, seconds``.
    """
    parts = []
    for name in study.controllers:
        if is_mpc(name):
            timed = Timed(controller(study, models, name))
            simulate_closed_loop(reference, study.sampling_time, controllers=timed, preview=True)
            parts.append(pd.DataFrame({"controller": name, "step": range(len(reference)), "seconds": timed.seconds}))
    return pd.concat(parts, ignore_index=True)


def tracks(study: Study, models: dict, reference: np.ndarray, names: tuple[str, ...]) -> pd.DataFrame:
    """Angles and torques of some controllers under one reference, in calm air, with preview where they have one.

    Returns
    -------
    pandas.DataFrame
        Columns ``controller, time`` (s), states, torques (N m), references (rad), and the limits of the torques.
    """
    rig, parts = PlantParameters(), []
    limits = {"u_phi": rig.u_phi_limits, "u_psi": rig.u_psi_limits}
    limits = {f"{name}_{end}": pair[i] for name, pair in limits.items() for i, end in enumerate(("low", "high"))}
    for name in names:
        control = controller(study, models, name)
        log = simulate_closed_loop(reference, study.sampling_time, rig, controllers=control, preview=is_mpc(name))
        frame = log.to_frame().rename(columns={"phi_ref": "phi_reference", "psi_ref": "psi_reference"})
        parts.append(frame.assign(controller=name, **limits))
    return pd.concat(parts, ignore_index=True)
