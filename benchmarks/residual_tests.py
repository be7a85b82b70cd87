"""False alarms and power of the residual tests (`tras/analysis/residuals.py`), by simulation with fixed seeds.

    .venv/bin/python benchmarks/residual_tests.py [--cases 10000] [--only alarms|power]

False alarms: residuals that are white and independent of the input (for several steps: a moving average), so every
alarm is false; at 1 % each. Power: first-order systems with one term that the fitted model lacks and noise in the
equation, 20 dB below the state's variance; the share of cases in which the tests together raise an alarm.
Some minutes for 10 000 cases.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
from scipy.signal import lfilter  # noqa: E402
from tqdm import tqdm  # noqa: E402

import tras  # noqa: E402
from tras.analysis.residuals import Series, correlation_tests  # noqa: E402

LAGS, LEVEL = 25, 0.01
NOISES = {
    "Gaussian": lambda rng, size: rng.normal(size=size),
    "Laplace": lambda rng, size: rng.laplace(size=size),
    "uniform": lambda rng, size: rng.uniform(-1, 1, size),
}
# (samples, trajectories, distribution, steps)
CASES = [
    (100, 1, "Gaussian", 1), (200, 1, "Gaussian", 1), (500, 1, "Gaussian", 1), (500, 5, "Gaussian", 1),
    (2000, 1, "Gaussian", 1), (500, 1, "Laplace", 1), (500, 1, "uniform", 1), (500, 1, "Gaussian", 5),
    (2000, 1, "Gaussian", 5), (2000, 1, "Gaussian", 20),
]  # fmt: skip
# What the system does beside 0.9 x + 0.3 u: a function of state, input, and the inputs one and two samples earlier.
TERMS = {
    "cubic in the state": lambda x, u, u1, u2: -0.05 * x**3,
    "friction": lambda x, u, u1, u2: -0.3 * np.sign(x),
    "absolute value of the state": lambda x, u, u1, u2: 0.05 * np.abs(x),
    "earlier input": lambda x, u, u1, u2: 0.2 * u2,
    "input squared": lambda x, u, u1, u2: 0.2 * u**2,
    "product of state and input": lambda x, u, u1, u2: 0.1 * x * u,
}


def alarms(cases, samples, trajectories, noise, steps, seed=0):
    """Share of false alarms in percent: of whiteness, of independence of the input, of both together."""
    rng, furthest, length = np.random.default_rng(seed), LAGS + steps - 1, samples // trajectories
    p = []
    for _ in range(cases):
        errors, inputs = [], []
        for _ in range(trajectories):
            white = NOISES[noise](rng, length + steps - 1)
            errors.append(np.convolve(white, 0.9 ** np.arange(steps), mode="valid")[:, None])
            inputs.append(lfilter([1], [1, -0.9], rng.normal(size=length + steps))[:, None])
        series = Series.of(errors, inputs, [steps] * trajectories, furthest)
        p.append([test["p"] for test, _ in correlation_tests(series, 0, ["u"], steps, LAGS, LEVEL)])
    p = np.array(p)
    return 100 * np.array([*(p < LEVEL).mean(axis=0), (p.min(axis=1) < LEVEL / 2).mean()])


def system(term, rng, trajectories, samples=1000, held=5):
    """A recording of x+ = 0.9 x + 0.3 u + term + noise; the input is drawn anew every so many samples."""
    u = np.repeat(rng.normal(size=(samples // held + 1, trajectories)), held, axis=0)[:samples]
    earlier = [np.vstack([np.zeros((k, trajectories)), u[:-k]]) for k in (1, 2)]
    white = rng.normal(size=u.shape)
    noise = 0.0
    for _ in range(2):  # without noise first, to know how large the state is
        x = np.zeros_like(u)
        for k in range(samples - 1):
            x[k + 1] = 0.9 * x[k] + 0.3 * u[k] + term(x[k], u[k], earlier[0][k], earlier[1][k]) + noise * white[k]
        noise = 0.1 * x.std()
    return tras.Recording(x.T[..., None], u.T[..., None], 0.1), noise


def power(cases, term, seed=0):
    """Share of cases in percent in which a linear model of half of the data is found wanting on the other half.

    Also how much of its errors is not the noise: the power of what the model lacks over that of the noise, in dB.
    """
    recording, noise = system(term, np.random.default_rng(seed), 2 * cases)
    count, energy = 0, 0.0
    for i in range(cases):
        model = tras.KoopmanModel(tras.Monomials(1), "one_step", regularization=None).fit(recording[[2 * i]])
        result = model.residuals(recording[[2 * i + 1]])
        count += not result.white
        energy += np.mean(result.errors[0] ** 2) / cases
    return 100 * count / cases, 10 * np.log10(max(energy / noise**2 - 1, 1e-9))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--only", choices=["alarms", "power"])
    wishes = parser.parse_args()
    if wishes.only != "power":
        rows = [[*case, *alarms(wishes.cases, *case)] for case in tqdm(CASES, disable=None)]
        heads = "samples trajectories noise steps whiteness input together".split()
        print(pd.DataFrame(rows, columns=heads).to_string(index=False, float_format="%.2f"))
    if wishes.only != "alarms":
        terms = {"none": lambda x, u, u1, u2: 0.0} | TERMS
        for name, term in tqdm(terms.items(), disable=None):
            share, size = power(max(wishes.cases // 50, 20), term)
            print(f"{name}: alarms in {share:.1f} % of cases; what is lacking is {size:.0f} dB above the noise")


if __name__ == "__main__":
    main()
