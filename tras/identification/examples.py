"""Recordings of other systems, as a logger would write them: something to try `make identify` on.

    python -m tras.identification.examples duffing build/example/duffing.csv

The systems are integrated so exactly that all errors are the model's. Their sensors have noise and an encoder's steps.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from tras import rollout
from tras.recording import Recording
from tras.twin_rotor.excitation import multisine
from tras.workflow.files import replacing

_SUBSTEPS = 20  # per sample: only rounding errors are left


def duffing(point: np.ndarray) -> np.ndarray:
    """A mass on a hardening spring, ``q'' = force - 0.4 q' - q - 2 q^3``; rows q (m), q' (m/s), force (N)."""
    q, v, force = point
    return np.stack([v, force - 0.4 * v - q - 2 * q**3])


def cart_pole(point: np.ndarray) -> np.ndarray:
    """A pole hanging from a cart on a spring; rows s (m), s' (m/s), theta (rad, 0 hanging), theta' (rad/s), force (N).

    Cart 1 kg with 0.8 N s/m and 4 N/m, pole 0.3 kg at 0.5 m with 0.02 N m s/rad, gravity 9.81 m/s^2.
    """
    s, v, theta, omega, force = point
    sine, cosine = np.sin(theta), np.cos(theta)
    pushed = force - 0.8 * v - 4 * s + 0.15 * omega**2 * sine
    turned = -0.02 * omega / 0.15 - 9.81 * sine
    acceleration = (pushed - 0.3 * cosine * turned) / (1 + 0.3 * sine**2)
    return np.stack([v, acceleration, omega, (turned - acceleration * cosine) / 0.5])


_CART_POLE = {"position": "m", "velocity": "m/s", "theta": "rad", "thetadot": "rad/s"}
# Vector field, units of the states, noise, sampling time (s), highest frequency (rad/s) and peak (N) of the force.
SYSTEMS = {
    "duffing": (duffing, {"q": "m", "qdot": "m/s"}, (0.001, 0.004), 0.05, 3.0, 2.5),
    "cart_pole": (cart_pole, _CART_POLE, (0.001, 0.01, 0.002, 0.02), 0.02, 6.0, 5.0),
}


def example(name: str, trials: int = 8, duration: float = 25.0, *, seed: int = 0, noise: float = 1.0) -> Recording:
    """A recording of one of `SYSTEMS` under multisines, from rest, its states as sensors see them.

    Parameters
    ----------
    name : {"duffing", "cart_pole"}
    trials : int
        Each has its own multisine.
    duration : float
        Of a trial, in s.
    seed : int
    noise : float
        Factor of the sensors' noise, 0 for exact states. With noise the first state also has an encoder's steps, half
        its noise.

    Raises
    ------
    ValueError
        If there is no such system, or the duration is not a whole number of samples.

    Examples
    --------
    >>> example("duffing", trials=2, duration=5)
    Recording: 2 trajectories of 101 samples at 0.05 s; states q, qdot; inputs force
    """
    if name not in SYSTEMS:
        raise ValueError(f"name is {name!r}; choose one of {', '.join(SYSTEMS)}.")
    field, units, deviations, dt, fastest, peak = SYSTEMS[name]
    rng = np.random.default_rng(seed)
    u = np.stack([multisine(duration, dt, [fastest], [peak], rng, draws=20) for _ in range(trials)])
    starts, inputs = np.zeros((len(units), trials)), u.transpose(1, 2, 0)
    x = rollout.roll_out(lambda z, v: rollout.runge_kutta(field, z, v, dt, _SUBSTEPS), starts, inputs)
    x = x.transpose(2, 0, 1)
    if noise:
        x = x + noise * np.array(deviations) * rng.standard_normal(x.shape)
        step = noise * deviations[0] / 2
        x[..., 0] = np.round(x[..., 0] / step) * step
    return Recording(
        x, u, dt, state_names=list(units), state_units=list(units.values()), input_names=["force"], input_units=["N"],
        attributes={"system": name, "seed": seed},
    )  # fmt: skip


def write_log(recording: Recording, path: Path) -> None:
    """Write a CSV as a logger would: names with units in brackets, a column that counts the trials, six digits."""
    names = ("time", *recording.state_names, *recording.input_names)
    units = ("s", *recording.state_units, *recording.input_units)
    labels = {name: f"{name} [{unit}]" for name, unit in zip(names, units) if unit}
    table = recording.to_frame().rename(columns={"trajectory": "trial"} | labels)
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6g", lineterminator="\n")


def main(arguments: list[str] | None = None, program: str = "python -m tras.identification.examples") -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(program, description="Write an example.")
    parser.add_argument("system", choices=sorted(SYSTEMS), nargs="?", default="duffing", help="default: %(default)s")
    parser.add_argument("path", type=Path, nargs="?", help="where the CSV goes (default: SYSTEM.csv here)")
    options = parser.parse_args(arguments)
    path = options.path or Path(f"{options.system}.csv")
    try:
        write_log(example(options.system), path)
    except OSError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
