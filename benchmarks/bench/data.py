"""The data of the comparison: the paper's experiment, driven by torques, several seeds; as a folder of plain arrays.

The folder's form is told in `benchmarks/peers/problem.py`, which every environment reads it with.
"""

import itertools
import json
import sys
from pathlib import Path

import numpy as np

import tras
from tras.workflow import files

sys.path.append(str(Path(__file__).resolve().parent.parent / "peers"))
import problem as problems  # noqa: E402

DEGREES = {7: 1, 28: 2, 84: 3, 210: 4, 462: 5, 924: 6}  # N of all monomials of four states and two inputs
CHANNELS = 6
HEAD = 1 + CHANNELS  # constant, states, inputs
WIDTH = 1.0  # of the Gaussians, half the range of a channel
SAMPLES = 501  # of a trajectory
PAIRS = 50_000  # of an experiment, 500 s
DIFFERENT = 16
LATER = 1000  # seeds from here on are rolled out, not fitted


def experiment(seed, samples=SAMPLES):
    """States (trajectories, samples, 4) and torques (trajectories, samples, 2) of 500 s in closed loop."""
    reference = tras.multisine(500, 0.01, [0.2, 0.8], [1.22173, np.pi], np.random.default_rng(seed))
    recording = (
        tras.simulate_closed_loop(reference, 0.01, tras.PlantParameters())
        .select(inputs=["u_phi", "u_psi"])
        .cut(samples)
    )
    return recording.states, recording.inputs


def trajectories(count, samples=SAMPLES, first=1):
    """That many trajectories; after `DIFFERENT` of them the same ones come again, which costs no simulation."""
    parts, total = [], 0
    while total < count:
        parts.append(parts[-DIFFERENT] if len(parts) >= DIFFERENT else experiment(first + len(parts), samples))
        total += len(parts[-1][0])
    return tuple(np.concatenate(part)[:count] for part in zip(*parts))


def functions(count, width=WIDTH):
    """What ``problem.json`` says of N functions, and their arrays: monomials where N fits a degree, else Gaussians."""
    if count in DEGREES:
        words = [
            w for k in range(DEGREES[count] + 1) for w in itertools.combinations_with_replacement(range(CHANNELS), k)
        ]
        exponents = np.array([[word.count(i) for i in range(CHANNELS)] for word in words])
        return {"kind": "monomials", "degree": DEGREES[count]}, {"exponents": exponents}
    if count <= HEAD:
        raise ValueError(
            f"functions is {count}; give one of {', '.join(map(str, DEGREES))} (monomials) or above {HEAD} (Gaussians)."
        )
    centres = np.random.default_rng(0).uniform(-1, 1, (count - HEAD, CHANNELS))
    return {"kind": "gaussians", "width": width}, {"centres": centres}


def write(folder, pairs, count, runs=100, samples=600, width=WIDTH):
    """The problem of ``pairs`` snapshot pairs and ``count`` functions; returns its folder.

    Raises
    ------
    ValueError
        If the pairs are no whole number of trajectories, or there are no such functions.
    """
    each = SAMPLES - 1
    if pairs < each or pairs % each:
        raise ValueError(f"pairs is {pairs}; give a multiple of {each}, whole trajectories.")
    about, arrays = functions(count, width)
    folder = Path(folder) / f"{pairs}-{count}-{runs}-{width:g}"
    folder.mkdir(parents=True, exist_ok=True)
    states, inputs = trajectories(pairs // each)
    x0, u = trajectories(min(runs, 100), samples, LATER)
    middle, half = zip(*(((v.max((0, 1)) + v.min((0, 1))) / 2, np.ptp(v, axis=(0, 1)) / 2) for v in (states, inputs)))
    arrays |= {"states": (states - middle[0]) / half[0], "inputs": (inputs - middle[1]) / half[1]}
    repeat = -(-runs // len(x0))
    arrays |= {
        "x0": np.tile((x0[:, 0] - middle[0]) / half[0], (repeat, 1))[:runs],
        "u": np.tile((u - middle[1]) / half[1], (repeat, 1, 1))[:runs],
    }
    arrays["points"] = np.random.default_rng(1).uniform(-1, 1, (50, CHANNELS))
    about |= {"functions": count, "states": str(folder / "states.npy"), "inputs": str(folder / "inputs.npy")}
    for name, array in arrays.items():
        save(folder / f"{name}.npy", array)
    with files.replacing(folder / "problem.json") as temporary:
        temporary.write_text(json.dumps(about))
    save(folder / "values.npy", problems.lift(problems.read(folder), arrays["points"]))
    return folder


def save(path, array):
    with files.replacing(path) as temporary, open(temporary, "wb") as file:
        np.save(file, array)
