"""Closed loops together (`tras.simulate_closed_loops`) and one by one: 6 s of the experiment, CPU seconds of one core.

.venv/bin/python benchmarks/closed_loops.py [--runs 1 10 100 1000] [--rounds 5]
"""

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np  # noqa: E402

from tras.twin_rotor import closed_loop  # noqa: E402

SAMPLES = 601


def references(runs):
    rng = np.random.default_rng(0)
    time, phases = np.arange(SAMPLES)[:, None] * 0.01, rng.uniform(0, 6, (runs, 1, 2))
    return np.sin([0.9, 0.7] * time + phases) * rng.uniform(0.2, 1.2, (runs, 1, 2))


def seconds(signals, together):
    closed_loop.BATCH = 1 if together else len(signals) + 1
    start = time.process_time()
    closed_loop.simulate_closed_loops(signals, 0.01)
    return time.process_time() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, nargs="+", default=[1, 10, 40, 100, 1000])
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    print(f"{'runs':>6}{'one by one / s':>16}{'together / s':>14}{'ratio':>8}")
    for runs in options.runs:
        times = np.array(
            [[seconds(references(runs), together) for together in (False, True)] for _ in range(options.rounds)]
        )
        alone, together = np.median(times, axis=0)
        print(f"{runs:6}{alone:16.3f}{together:14.3f}{np.median(times[:, 0] / times[:, 1]):8.2f}", flush=True)


if __name__ == "__main__":
    main()
