"""Time of a step of the model predictive controller (`tras.MPC`) on the twin rotor, one processor, by kind of model.

.venv/bin/python benchmarks/control_step.py [--horizon 40] [--seconds 20]

Every step counts, the first one too: median, 99th percentile, the longest, in milliseconds of CPU time, and what
of it the quadratic program takes. The reference is a multisine up to 3 rad/s in pitch, which holds torques at their
limits for a part of the time.
"""

import argparse
import os
import time

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402

import tras  # noqa: E402
from tras.control.predictors import plant  # noqa: E402

WEIGHTS, RATE_WEIGHTS = {"phi": 1.0, "psi": 1.0}, {"u_phi": 0.03, "u_psi": 0.03}


def models(rig):
    reference = tras.multisine(500, 0.01, [0.2, 0.8], [1.22173, np.pi], 1)
    recording = tras.simulate_closed_loop(reference, 0.01, rig).select(inputs=["u_phi", "u_psi"]).cut(501)
    yield "linear", tras.KoopmanModel(tras.Monomials(1), regularization=None).fit(recording)
    yield "mechanical", tras.KoopmanModel(tras.Mechanical(), regularization=None).fit(recording)
    yield "mechanical, angles alone", tras.KoopmanModel(tras.Mechanical(), regularization=None).fit(recording)
    yield "lifted linear, cubic", tras.KoopmanModel(tras.Monomials(3), "lifted_linear").fit(recording)
    yield "true plant", plant(rig, 0.01)


def times(controller, reference, rig):
    """Milliseconds of every step and of its program, over a closed loop."""
    steps, programs = [], []
    solve = controller.program.solve

    def timed(*arguments):
        start = time.process_time()
        solution = solve(*arguments)
        programs[-1] += 1e3 * (time.process_time() - start)
        return solution

    def step(x, ahead):
        programs.append(0.0)
        start = time.process_time()
        u = controller(x, ahead)
        steps.append(1e3 * (time.process_time() - start))
        return u

    step.horizon, controller.program.solve = controller.horizon, timed
    run = tras.simulate_closed_loop(reference, 0.01, rig, controllers=step, preview=True)
    torques, (low, high) = run.inputs[0][:, 2:], np.transpose(rig.input_limits)
    return np.array(steps), np.array(programs), ((torques <= low) | (torques >= high)).any(axis=1).mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--horizon", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    rig = tras.PlantParameters()
    reference = tras.multisine(options.seconds, 0.01, [3.0, 2.0], [0.6, 1.2], 5)
    print(f"{'model':26}{'N':>5}{'median':>9}{'p99':>9}{'longest':>9}{'program p99':>13}{'at a limit':>12}")
    for name, model in models(rig):
        observer = tras.Observer(model, measured=["phi", "psi"]) if "angles" in name else None
        controller = tras.MPC(model, horizon=options.horizon, weights=WEIGHTS, rate_weights=RATE_WEIGHTS,
                              limits=rig.input_limits, observer=observer)  # fmt: skip
        steps, programs, share = times(controller, reference, rig)
        size = len(model.names_) if hasattr(model, "names_") else 0
        row = (np.median(steps), np.percentile(steps, 99), steps.max(), np.percentile(programs, 99))
        print(f"{name:26}{size or '':>5}{row[0]:9.2f}{row[1]:9.2f}{row[2]:9.2f}{row[3]:13.2f}{share:12.1%}", flush=True)


if __name__ == "__main__":
    main()
