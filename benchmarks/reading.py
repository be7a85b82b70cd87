"""Reading a text table of a million rows, beside pandas: CPU time of one core as a multiple of `pandas.read_csv`.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/reading.py [--rows 1000000] [--rounds 9]

Both read the same file in turns; the ratio is the median of the rounds. `Recording.read` also finds layout, roles and
sampling time, checks every number and makes the recording. The table has time, two states and an input.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402

import tras  # noqa: E402


def cpu_time(call):
    """CPU seconds of a call."""
    start = time.process_time()
    call()
    return time.process_time() - start


def table(rows):
    """Time at 1 kHz, two states and an input."""
    rng = np.random.default_rng(0)
    q = np.cumsum(rng.normal(size=rows)) / 100
    columns = {"time": np.arange(rows) / 1000, "q": q, "qdot": np.gradient(q, 1e-3), "force": rng.normal(size=rows)}
    return pd.DataFrame(columns)


def ratios(path, rounds):
    """The ratio of each round."""
    pandas_times, our_times = [], []
    for _ in range(rounds + 1):  # the first warms caches up
        pandas_times.append(cpu_time(lambda: pd.read_csv(path)))
        our_times.append(cpu_time(lambda: tras.Recording.read(path)))
    return np.array(our_times[1:]) / pandas_times[1:], float(np.median(pandas_times[1:]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Reading text tables, beside pandas.")
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for label, digits in (("17 digits", None), ("6 decimals", 6)):
            path, frame = Path(folder) / "log.csv", table(options.rows)
            (frame if digits is None else frame.round(digits)).to_csv(path, index=False)
            ratio, base = ratios(path, options.rounds)
            spread = f"{ratio.min():.2f} to {ratio.max():.2f}"
            print(f"{label:10}  pandas {base:.3f} s, ours {np.median(ratio):.2f} times ({spread})")
