"""The motor of M. Korda and I. Mezic, Automatica 93 (2018) 149, Sec. 8.2, in closed loop on its true equations.

.venv/bin/python benchmarks/motor.py [--trajectories 200] [--seconds 6]

A bilinear DC motor, of which the speed alone is measured, scaled to about [-1, 1]. As in the paper: 0.01 s a sample,
200 trajectories of 1000 samples from random states under random inputs, one delay, 100 thin plates at random centres, a
horizon of 1 s, an input within +-1 and a speed within +-0.4, which a reference of 0.5 cos(2 pi t / 3) asks it to leave.
Beside it the same controller with the motor linearised at its first state, which knows both states, and with the true
equations. Printed are how far the speed leaves its limits, the error against the reference where the limits allow it,
and the CPU time of a step.
"""

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np  # noqa: E402

import tras  # noqa: E402
from tras.control.predictors import Equations  # noqa: E402

DT, HIGHEST = 0.01, 0.4
LIMITS = [(-1.0, 1.0)]
# R, L, k, J, B, load torque and armature voltage of the paper; current in 10 A, speed in 100 rad/s, input in 4 A.
L_a, R_a, K_m, INERTIA, FRICTION, LOAD, VOLTAGE = 0.314, 12.345, 0.253, 0.00441, 0.00732, 1.47, 60.0
CURRENT, SPEED, FIELD = 10.0, 100.0, 4.0
START = np.array([-0.1, 0.1])


def field(x, u):
    current, speed = x
    return np.stack([
        VOLTAGE / L_a / CURRENT - R_a / L_a * current - K_m / L_a * SPEED / CURRENT * FIELD * speed * u,
        -LOAD / INERTIA / SPEED - FRICTION / INERTIA * speed + K_m / INERTIA * CURRENT / SPEED * FIELD * current * u,
    ])  # fmt: skip


def advance(x, u):
    """One sample by a classical Runge-Kutta step, (2, points) and (1, points)."""
    k1 = field(x, u[0])
    k2 = field(x + DT / 2 * k1, u[0])
    k3 = field(x + DT / 2 * k2, u[0])
    return x + DT / 6 * (k1 + 2 * (k2 + k3) + field(x + DT * k3, u[0]))


def recording(trajectories, samples=1000, seed=0):
    rng = np.random.default_rng(seed)
    x, u = np.empty((samples, 2, trajectories)), rng.uniform(-1, 1, (samples, 1, trajectories))
    x[0] = rng.uniform(-1, 1, (2, trajectories))
    for k in range(samples - 1):
        x[k + 1] = advance(x[k], u[k])
    return tras.Recording(x[:, 1:].transpose(2, 0, 1), u.transpose(2, 0, 1), DT, state_names=["speed"],
                          input_names=["field"])  # fmt: skip


def linearised(at):
    """The motor linearised at a state, the input in the middle, as the paper's comparison has it."""
    true = Equations(advance, DT, LIMITS, ["current", "speed"], ["field"])
    later, slopes = true.advance_with_slopes(at[:, None], np.zeros((1, 1)))
    A, B = slopes[0, :, :2], slopes[0, :, 2:]
    return Equations(lambda x, u: later + A @ (x - at[:, None]) + B @ u, DT, LIMITS, ["current", "speed"], ["field"])


def loop(controller, reference, sees):
    """Speeds, inputs, and CPU milliseconds of every step."""
    x, speeds, inputs, times = START, [], [], []
    for k in range(len(reference)):
        speeds.append(x[1])
        start = time.process_time()
        u = controller(x[sees], reference[k : k + controller.horizon + 1])
        times.append(1e3 * (time.process_time() - start))
        inputs.append(u[0])
        x = advance(x[:, None], u[:, None])[:, 0]
    return np.array(speeds), np.array(inputs), np.array(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trajectories", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=6.0)
    options = parser.parse_args()
    data = recording(options.trajectories)
    plates = tras.ThinPlate(100, width=1.0, centres="uniform")
    models = {
        "thin plates": (tras.KoopmanModel(plates, "lifted_linear", 1, regularization=None).fit(data), [1]),
        "linear, one delay": (tras.KoopmanModel(tras.Monomials(1), "lifted_linear", 1).fit(data), [1]),
        "bilinear, one delay": (tras.KoopmanModel(tras.Monomials(2), "one_step", 1).fit(data), [1]),
        "linearised at the start": (linearised(START), [0, 1]),
        "true equations": (Equations(advance, DT, LIMITS, ["current", "speed"], ["field"]), [0, 1]),
    }
    t = np.arange(round(options.seconds / DT) + 1) * DT
    reference = 0.5 * np.cos(2 * np.pi * t / 3)[:, None]
    allowed = np.clip(reference[:, 0], -HIGHEST, HIGHEST)
    print(f"{'model':26}{'offset free':>12}{'beyond 0.4':>12}{'RMS error':>11}{'failures':>10}{'p99 / ms':>10}")
    for name, (model, sees) in models.items():
        for offset_free in (False, True):
            controller = tras.MPC(model, horizon=100, weights={"speed": 1.0}, rate_weights=0.01, limits=LIMITS,
                                  states={"speed": (-HIGHEST, HIGHEST)}, offset_free=offset_free)  # fmt: skip
            speeds, inputs, times = loop(controller, reference, sees)
            assert np.abs(inputs).max() <= 1 + 1e-9
            beyond = max(0.0, np.abs(speeds).max() - HIGHEST)
            settled = t > 0.5
            rms = np.sqrt(np.mean((speeds - allowed)[settled] ** 2))
            numbers = f"{beyond:12.5f}{rms:11.4f}{controller.failures:10}{np.percentile(times, 99):10.2f}"
            print(f"{name:26}{'yes' if offset_free else 'no':>12}{numbers}", flush=True)


if __name__ == "__main__":
    main()
