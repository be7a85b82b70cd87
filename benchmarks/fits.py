"""Fits per second in the grid of readings (`tras.paper.grid`): log K and equation (18) from 40 000 snapshot pairs.

    .venv/bin/python benchmarks/fits.py [--rounds 5]

CPU times of one core, the best of several rounds; "two cores" is twice as many. OPENBLAS_NUM_THREADS=1, as make has it:
with more threads the waiting ones count as CPU time.
"""

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tras.dictionaries.base import Dictionary  # noqa: E402
from tras.paper import grid, readings  # noqa: E402


def best_times(study, recording, name, rounds):
    """Smallest CPU time of a fit, and of what of it is lifting."""
    point = {"input": "torque", "state": "four_states", "dictionary": name, "draw": 0}
    train, times = grid.training(study, recording, point), []
    for _ in range(rounds):
        lifting.clear()
        start = time.process_time()
        model, outcome = grid.fit(point, train)
        times.append((time.process_time() - start, sum(lifting)))
    return len(model.names_), *min(times)


def timed(method):
    """The method, its CPU time added to ``lifting``."""

    def call(*arguments):
        start = time.process_time()
        try:
            return method(*arguments)
        finally:
            lifting.append(time.process_time() - start)

    return call


lifting = []
for method in ("__call__", "lift_with_slopes"):
    setattr(Dictionary, method, timed(getattr(Dictionary, method)))

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Fits per second in the grid of readings.")
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    study = grid.Study()
    start = time.process_time()
    recording = grid.simulate(study, readings.Readings().model_dump(), 1)
    simulation = time.process_time() - start
    total = bare = fits = 0
    for name in readings.choices("dictionary"):
        N, whole, lifted = best_times(study, recording, name, rounds)
        share = len(study.centre_draws) if name in grid.DRAWN else 1  # how often the grid has it
        total, bare, fits = total + share * whole, bare + share * (whole - lifted), fits + share
        print(f"{name:12s} N = {N:2d}: {1e3 * whole:5.0f} ms per fit, {1e3 * lifted:4.0f} ms of it lifting")
    points = grid.points(study)
    simulations = 4 * (len(study.train_seeds) + len(study.validation_seeds)) * simulation
    print(
        f"the grid's mix, two cores: {2 * fits / bare:.0f} fits/s alone, {2 * fits / total:.0f} with lifting, ",
        end="",
    )
    seconds = len(points) * total / fits + simulations
    print(f"{2 * len(points) / seconds:.0f} with lifting and simulations ({simulation:.2f} s each)")
