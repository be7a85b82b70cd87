"""Time and accuracy of the least-squares solver beside the plain Gram matrix and Householder QR.

    .venv/bin/python benchmarks/solver.py [--csv PATH] [--rounds 3] [--skip-accuracy]

Takes some minutes. See README.md in this folder.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: times of one core
ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "solver")]

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
from scipy import linalg  # noqa: E402
from tqdm import tqdm  # noqa: E402

import tras  # noqa: E402
from tras import koopman  # noqa: E402
from tras.solver.least_squares import least_squares  # noqa: E402

DICTIONARIES = [tras.Monomials(3), tras.Monomials(4), tras.GaussianRBF(499, 1.0)]  # N = 84, 210, 506


def scaled_recording(inputs):
    """The paper's experiment, 50 000 pairs, channels in [-1, 1]."""
    reference = tras.multisine(500, 0.01, [0.2, 0.8], [1.22173, np.pi], np.random.default_rng(1))
    recording = tras.simulate_closed_loop(reference, 0.01, tras.PlantParameters()).select(inputs=inputs).cut(501)
    x, u = (
        (v - (v.max((0, 1)) + v.min((0, 1))) / 2) / (np.ptp(v, axis=(0, 1)) / 2)
        for v in (recording.states, recording.inputs)
    )
    return tras.Recording(x, u, 0.01)


def blocks(dictionary, recording):
    for x, u, y in koopman.snapshot_pairs(recording, koopman.block_size(dictionary), deal=1):
        yield koopman.rows(dictionary, x, u, y)


def ours(parts):
    return least_squares(parts).coefficients


def gram(parts):
    G = C = 0.0
    for x, y in parts:
        G, C = G + x.T @ x, C + x.T @ y
    return linalg.solve(G, C, assume_a="sym", check_finite=False)


def householder(parts):
    X, Y = map(np.vstack, zip(*parts))
    Q, R = linalg.qr(X, mode="economic", overwrite_a=True, check_finite=False)
    return linalg.solve_triangular(R, Q.T @ Y, check_finite=False)


METHODS = {"gram": gram, "ours": ours, "householder": householder}


def times(recording, rounds):
    """CPU time over that of the plain Gram in the same round, median over the rounds."""
    import warnings

    warnings.simplefilter("ignore", linalg.LinAlgWarning)  # the Gram matrix is singular to working precision
    table = []
    for dictionary in DICTIONARIES:
        dictionary.fit(recording.states, recording.inputs)
        stored = [tuple(map(np.asfortranarray, part)) for part in blocks(dictionary, recording)]
        for lifting in (True, False):
            spent = {name: [] for name in METHODS}
            for _ in range(rounds):
                for name, method in METHODS.items():
                    start = time.process_time()
                    method(blocks(dictionary, recording) if lifting else stored)
                    spent[name].append(time.process_time() - start)
            base = np.array(spent["gram"])
            for name, seconds in spent.items():
                ratio = float(np.median(np.array(seconds) / base))
                table.append(
                    {
                        "N": len(dictionary.names),
                        "lifting": lifting,
                        "method": name,
                        "seconds": np.median(seconds),
                        "ratio": ratio,
                    }
                )
    return pd.DataFrame(table)


PROBLEMS = [  # of rising size; inputs, dictionary
    (["phi_ref", "psi_ref"], tras.Monomials(4)),
    (["u_phi", "u_psi"], tras.Monomials(4)),
    (["u_phi", "u_psi"], tras.GaussianRBF(499, width=1.5)),
    (["u_phi", "u_psi"], tras.GaussianRBF(499, width=1.0)),
    (["u_phi", "u_psi"], tras.GaussianRBF(999, width=0.5)),
    (["u_phi", "u_psi"], tras.GaussianRBF(999, width=1.0)),
]


def accuracy():
    """Largest error of a coefficient over the largest one of its column, some columns, against double-double."""
    from test_least_squares import columnwise, extended

    table = []
    for inputs, dictionary in tqdm(PROBLEMS, desc="accuracy"):
        recording = scaled_recording(inputs)
        dictionary.fit(recording.states, recording.inputs)
        parts = list(blocks(dictionary, recording))
        X, Y = map(np.vstack, zip(*parts))
        columns = [j for j in (1, 2, 3, 4, 9, 100, 150) if Y[:, j].any()]
        fit = koopman.koopman_matrix(dictionary, recording)[1]
        exact = extended(X, np.ascontiguousarray(Y[:, columns]), fit.R)[0]
        about = {
            "dictionary": str(dictionary),
            "inputs": inputs[0],
            "N": X.shape[1],
            "condition": fit.scaled_condition_number,
        }
        for name, method in METHODS.items():
            coefficients = fit.coefficients if name == "ours" else method(parts)
            table.append(about | {"method": name, "error": columnwise(coefficients[:, columns], exact)})
    return pd.DataFrame(table)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", type=Path, help="also write both tables there")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--skip-accuracy", action="store_true")
    options = parser.parse_args()
    speed = times(scaled_recording(["u_phi", "u_psi"]), options.rounds)
    print("CPU time over that of the plain Gram, 50 000 pairs, torque inputs")
    wide = speed.pivot_table(index=["N", "lifting"], columns="method", values="ratio", sort=False)
    wide.insert(0, "gram / s", speed[speed["method"] == "gram"].set_index(["N", "lifting"])["seconds"])
    print(wide.round(2).to_string())
    tables = [speed]
    if not options.skip_accuracy:
        errors = accuracy()
        print("\nError of the coefficients; condition number of the lifted rows, columns scaled")
        index = ["dictionary", "inputs", "N", "condition"]
        print(
            errors.pivot_table(index=index, columns="method", values="error", sort=False)
            .map("{:.1e}".format)
            .to_string()
        )
        tables.append(errors)
    if options.csv:
        pd.concat(tables, ignore_index=True).to_csv(options.csv, index=False)


if __name__ == "__main__":
    main()
