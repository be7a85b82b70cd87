"""What the rates are worth: MPC of the twin rotor by noisy angles alone, beside the same with noisy rates.

.venv/bin/python benchmarks/angles_alone.py [--factors 1 0.1 0.03 0.01]

Noise is 1 % of each state's range in the paper's recording, the true equations are the model, the rest is as in
`notebooks/11_control.ipynb`. The observer of the study takes a tenth of each torque's half-range to act for one sample,
and a hundredth of that as the drift of a disturbance; ``factors`` scale both. *bound* is the standard deviation of the
stationary Kalman filter's estimate at rest, a solution of the Riccati equation, in rad: where such torques do act, no
controller follows a reference more closely. *calm* and *gusts* are flights under fast multisines with preview, root
mean square errors in rad: in calm air, and under torques with Dryden's spectrum of a tenth of the half-range. Each has
yaw / pitch with rates, with angles alone, and the ratio.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np  # noqa: E402

import tras  # noqa: E402
from tras.control.predictors import plant  # noqa: E402
from tras.paper import control  # noqa: E402

STUDY, RIG = control.Study(), tras.PlantParameters()
DT, NAMES = STUDY.sampling_time, control.STATE_NAMES
MEASURED = (NAMES, ("phi", "psi"))


def observer(model, measured, noise, factor):
    expected = {name: noise[NAMES.index(name)] for name in measured}
    process = factor * tras.Observer(model, measured).process
    return tras.Observer(model, measured, noise=expected, process=process)


def bound(model, measured, noise, factor):
    """Standard deviations (pitch, yaw) of the estimate, once they have settled, at rest."""
    filters, rest = observer(model, measured, noise, factor), tras.rest_point(RIG)
    before = np.inf
    for k in range(100_000):
        filters.update(rest, np.zeros(2))
        now = np.sqrt(filters.covariance.diagonal()[[0, 2]])
        if k % 500 == 499:
            if np.allclose(now, before, rtol=1e-4):
                break
            before = now
    return now * model.channels.x_scale[[0, 2]]


def flight(model, measured, noise, factor, path, disturbances):
    mpc = tras.MPC(model, horizon=STUDY.horizon, weights={"phi": 1.0, "psi": 1.0}, rate_weights=STUDY.rate_weight,
                   limits=RIG.input_limits, observer=observer(model, measured, noise, factor))  # fmt: skip
    log = tras.simulate_closed_loop(path, DT, RIG, controllers=mpc, preview=True, noise=noise, seed=STUDY.noise_seed,
                                    disturbances=disturbances)  # fmt: skip
    errors = (log.states[0][:, [0, 2]] - path)[STUDY.samples(STUDY.skip) - 1 : -STUDY.horizon]
    return np.sqrt((errors**2).mean(axis=0))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--factors", type=float, nargs="+", default=[1.0, 0.1, 0.03, 0.01])
    options = parser.parse_args()
    paper = tras.multisine(500, DT, [0.2, 0.8], [1.22173, np.pi], 1)
    noise = STUDY.noise / 100 * np.ptp(tras.simulate_closed_loop(paper, DT, RIG).states[0], axis=0)
    path, model = control.references(STUDY, paper)["fast"], plant(RIG, DT)
    gusts = tras.gusts((len(path) - 1) * DT, DT, tuple(0.1 * STUDY.halves), STUDY.gust_time, STUDY.gust_seed)
    print("noise of " + ", ".join(f"{name} {size:.2g}" for name, size in zip(NAMES, noise)))
    print(f"{'factor':>7}  {'':6}{'with rates':>20}{'angles alone':>20}{'ratio':>14}")
    for factor in options.factors:
        for what in ("bound", "calm", "gusts"):
            if what == "bound":
                pairs = [bound(model, measured, noise, factor) for measured in MEASURED]
            else:
                outside = gusts if what == "gusts" else None
                pairs = [flight(model, measured, noise, factor, path, outside) for measured in MEASURED]
            both, alone = (f"{yaw:.2g} / {pitch:.2g}" for pitch, yaw in pairs)
            pitch, yaw = pairs[1] / pairs[0]
            print(f"{factor:7g}  {what:6}{both:>20}{alone:>20}{f'{yaw:.2f} / {pitch:.2f}':>14}", flush=True)


if __name__ == "__main__":
    main()
