"""The rig with its rotors, six states and motor commands in place of torques: the second part of 11_control.

All predictive controllers have the same horizon, weights and limits, and know nothing of the gusts.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from tras.control.mpc import MPC
from tras.control.predictors import plant
from tras.dictionaries.mechanical import Mechanical
from tras.dictionaries.monomials import Monomials
from tras.model import KoopmanModel
from tras.paper.control import BOUND, OURS, RUNAWAY, TRUE
from tras.twin_rotor.closed_loop import simulate_closed_loop
from tras.twin_rotor.excitation import multisine
from tras.twin_rotor.gusts import gusts
from tras.twin_rotor.motor_loop import simulate_motor_loop
from tras.twin_rotor.rotor_parameters import RotorParameters
from tras.twin_rotor.rotors import rest_point
from tras.workflow.study import each

DICTIONARIES = {"linear": Monomials(1), "cubic": Monomials(3), "mechanical": Mechanical(actuators=[4, 5])}
CONTROLLERS = ("PID", *(f"MPC, {model}" for model in (*DICTIONARIES, TRUE)))


@dataclass(frozen=True)
class Motors:
    """Times in s, frequencies in rad/s, angles in rad, gusts in N m (root mean square, both axes).

    The recording has the PID in the loop and a test signal on the commands. ``take_off`` are seconds before a flight,
    in which the reference leaves the rest point: a rig at rest whose reference is elsewhere would begin with its
    commands at their limits, where no model was excited, and what it does there depends on the last bit.
    """

    sampling_time: float = 0.05
    recording: float = 300.0
    frequencies: tuple[float, float] = (0.8, 0.8)
    peaks: tuple[float, float] = (0.4, 1.0)
    test_frequencies: tuple[float, float] = (10.0, 10.0)
    test_peaks: tuple[float, float] = (0.15, 0.15)
    trajectory: int = 101
    flight: float = 20.0
    flight_frequencies: tuple[float, float] = (1.5, 1.5)
    flight_peaks: tuple[float, float] = (0.35, 0.8)
    gusts: tuple[float, ...] = (0.0, 0.01)
    gust_time: float = 1.0
    take_off: float = 4.0
    horizon: int = 30
    rate_weight: float = 1e-3


def identify(motors: Motors) -> dict[str, KoopmanModel]:
    """Models of a recording of motor commands, by the names of `DICTIONARIES`, with the predictor ``one_step``."""
    dt, T = motors.sampling_time, motors.recording
    reference = multisine(T, dt, motors.frequencies, motors.peaks, 1)
    test = multisine(T, dt, motors.test_frequencies, motors.test_peaks, 2)
    log = simulate_motor_loop(reference, dt, RotorParameters.maker(), test_signal=test)
    train = log.select(inputs=["u_m", "u_t"]).cut(motors.trajectory)
    return {name: KoopmanModel(dictionary, "one_step").fit(train) for name, dictionary in DICTIONARIES.items()}


def fly(motors: Motors, models: dict[str, KoopmanModel], *, processes: int = 1) -> pd.DataFrame:
    """Every controller under each gust, with preview where it has one, on the true plant.

    Returns
    -------
    pandas.DataFrame
        Columns ``controller, gust`` (N m), ``yaw, pitch`` (rad, root mean squares), ``failures, diverged``.
    """
    jobs = [(name, level) for level in motors.gusts for name in CONTROLLERS]
    return pd.DataFrame(each(_flight, jobs, (motors, models), cost=lambda name, _: name == BOUND, processes=processes))


def _flight(motors, models, name, level):
    dt, rig = motors.sampling_time, RotorParameters.maker()
    path, start = _path(motors, rig), round(motors.take_off / dt)
    wind = gusts((len(path) - 1) * dt, dt, (level, level), motors.gust_time, 3)
    if name == "PID":
        log, failures = simulate_motor_loop(path, dt, rig, gusts=wind), 0
    else:
        which = name.removeprefix("MPC, ")
        options = {"horizon": motors.horizon, "rate_weights": motors.rate_weight, "limits": [(-1.0, 1.0)] * 2}
        model = plant(rig, dt) if which == TRUE else models[which]
        control = MPC(model, weights={"phi": 1.0, "psi": 1.0}, **options)
        log = simulate_closed_loop(path, dt, rig, controllers=control, preview=True, disturbances=wind)
        failures = control.failures
    errors = (log.states[0][:, [0, 2]] - path)[start : -motors.horizon]
    pitch, yaw = np.sqrt((errors**2).mean(axis=0))
    lost = bool(np.abs(errors).max() > RUNAWAY)
    return {"controller": name, "gust": level, "yaw": yaw, "pitch": pitch, "failures": failures, "diverged": lost}


def _path(motors, rig):
    """The reference (samples, 2) of a flight, with the take-off before it and a horizon behind it."""
    dt, rest = motors.sampling_time, rest_point(rig)[[0, 2]]
    period = multisine(motors.flight, dt, motors.flight_frequencies, motors.flight_peaks, 0)
    times = np.arange(-round(motors.take_off / dt), len(period) + motors.horizon)
    s = np.clip(1 + times * dt / motors.take_off, 0, 1)[:, None]
    return rest + s**3 * (10 - 15 * s + 6 * s**2) * (period[times % (len(period) - 1)] - rest)


def of_pid(flights: pd.DataFrame) -> float:
    """Our error over the PID's under gusts, the worst gust and angle; NaN without gusts."""
    gusty = flights[flights["gust"] > 0].set_index("gust")
    ours, pid = (gusty.loc[gusty["controller"] == name, ["yaw", "pitch"]] for name in (OURS, "PID"))
    return float((ours / pid).max(axis=None)) if len(ours) and len(pid) else float("nan")
