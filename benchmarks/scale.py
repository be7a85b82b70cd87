"""Memory and time of a fit of data that are made as they are needed, one piece after the other.

    .venv/bin/python benchmarks/scale.py [--pairs 2e6] [--degree 3] [--checkpoint PATH]

Two million pairs take some ten seconds, ``--pairs 5e7`` some minutes. See README.md in this folder.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: one core
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np  # noqa: E402

import tras  # noqa: E402
from tras.large import streaming  # noqa: E402, F401 - counted among the libraries

NAMES = {"state_names": ["phi", "phidot", "psi", "psidot"], "input_names": ["u_phi", "u_psi"]}


def resident(kind="VmRSS"):
    """MiB of resident memory: now, or at most so far (VmHWM)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(kind + ":"):
            return int(line.split()[1]) / 1024
    raise RuntimeError(f"no {kind} in /proc/self/status")


def laboratory(pairs, samples=100_001, seed=0):
    """A callable that makes so many pairs, in recordings of ``samples``: four noisy states that follow two held inputs.

    Cheap to make: the response of a linear oscillator, shifted in time, bent and perturbed anew for every recording.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(2 * samples) * 0.001
    turns, phases = 2 * np.pi * np.array([0.13, 0.31, 0.57, 0.83, 1.3, 1.9]), rng.uniform(0, 2 * np.pi, 6)
    block = np.sin(np.outer(t, turns) + phases) + 0.3 * np.sin(2.7 * np.outer(t, turns) + phases[::-1])

    def recordings():
        noise = np.random.default_rng(seed + 1)
        left = pairs
        while left > 0:
            count = min(samples, left + 1)
            first = noise.integers(samples)
            z = block[first : first + count] * noise.uniform(0.5, 1.0, 6)
            z += 0.02 * noise.standard_normal((count, 6), dtype=np.float32)
            z[:, :4] += 0.1 * z[:, [1, 2, 3, 0]] * z[:, [4, 5, 4, 5]]
            yield tras.Recording([z[:, :4]], [z[:, 4:]], 0.001, **NAMES)
            left -= count - 1

    return recordings


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=float, default=2e6)
    parser.add_argument("--degree", type=int, default=3, help="of the monomials; 3 is N = 84")
    parser.add_argument("--checkpoint", help="an .npz file")
    options = parser.parse_args()
    source = laboratory(round(options.pairs))
    # What interpreter, libraries and BLAS take by themselves: everything is used once.
    tras.KoopmanModel(tras.Monomials(options.degree)).fit(next(laboratory(5000)()))
    start = time.perf_counter()
    produced = sum(recording.pairs for recording in source())
    making = time.perf_counter() - start
    before, start = resident(), time.perf_counter()
    model = tras.KoopmanModel(tras.Monomials(options.degree)).fit(source, progress=True, checkpoint=options.checkpoint)
    seconds = time.perf_counter() - start
    print(
        f"{produced} pairs, N = {len(model.names_)}, strength {model.strength_:g}, "
        f"condition number {model.condition_number:.1e}"
    )
    print(
        f"resident memory: {before:.0f} MiB before, at most {resident('VmHWM'):.0f} MiB, "
        f"the fit's own {resident('VmHWM') - before:.0f} MiB"
    )
    print(f"fit {seconds:.1f} s, {produced / seconds:.3g} pairs/s; of this making the data twice {2 * making:.1f} s")


if __name__ == "__main__":
    main()
