"""Random combinations of options on small recordings: none may run away, warn from our lines or show a traceback.

    python -m benchmarks.options [--count 1000] [--seed 0] [--only NUMBER]

Each combination of recording, dictionary and options of `tras.KoopmanModel` has a process of its own with 60 s of
processor time. It fits, reports, predicts, scores, linearises and saves. What may come out is a model, or a ValueError
of one sentence; after such a refusal another combination is drawn, 20 times at most. Everything else is a fault and is
printed with its number; ``--only`` repeats one of them here. Some recordings are hard on purpose: outliers of 1e300,
steps of 1e-300 s, channels that hardly move or move together.
"""

import argparse
import collections
import json
import os
import resource
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np

import tras
from tras import estimator, fitting, model, model_file, rollout, summary  # noqa: F401  loaded before the first fork

SECONDS, MEMORY = 60, 2**30  # of processor time, and bytes
PACKAGE = str(Path(tras.__file__).parent)


def recording(rng):
    """A few thousand samples of a random system, some of them damaged."""
    n, m = int(rng.choice([1, 2, 2, 3, 4, 6, 12, 18])), int(rng.choice([0, 1, 2, 4]))
    lengths = rng.integers(2, int(rng.choice([20, 200, 1500])), size=int(rng.choice([1, 3, 10])))
    A = rng.normal(0, 0.3 / np.sqrt(n), (n, n)) + np.diag(rng.uniform(0.3, 1.005, n))
    B, bend = rng.normal(0, 0.2, (m, n)), rng.choice([0.0, 0.2])
    states, inputs = [], []
    for length in lengths:
        u = rng.choice([0.0, 1.0]) * np.repeat(rng.uniform(-1, 1, (length // 7 + 1, m)), 7, axis=0)[:length]
        u = u + rng.normal(0, 0.1, u.shape)
        x = np.empty((length, n))
        x[0] = rng.normal(0, 1, n)
        for k in range(length - 1):
            x[k + 1] = np.clip(x[k] @ A.T + u[k] @ B + bend * np.sin(3 * x[k]), -5, 5)
        states.append(x + rng.choice([0.0, 0.0, 0.01, 0.1]) * rng.normal(size=x.shape))
        inputs.append(u)
    damage = str(rng.choice(["none"] * 6 + ["outlier", "glitch", "tiny", "huge", "constant", "copy", "offset"]))
    x, column = states[0], int(rng.integers(n))
    if damage == "outlier":
        x[int(rng.integers(len(x))), column] = rng.choice([-1, 1]) * 10.0 ** rng.choice([10, 100, 150, 200, 300, 307])
    elif damage == "glitch" and m:
        inputs[0][int(rng.integers(len(x))), 0] = 10.0 ** rng.choice([3, 30, 300])
    elif damage in ("tiny", "huge", "offset"):
        scale, offset = {"tiny": (1e-200, 0), "huge": (1e200, 0), "offset": (1e-9, 1e3)}[damage]
        states = [x * scale + offset for x in states]
    elif damage == "constant":
        states = [np.where(np.arange(n) == column, 3.0, x) for x in states]
    elif damage == "copy":
        states = [np.where(np.arange(n) == column, x[:, [0]], x) for x in states]
    dt = float(rng.choice([0.01, 0.01, 0.01, 1.0, 1e-300, 1e300, 1e-12, 1e9]))
    return tras.Recording(states, inputs if m else None, dt), {"n": n, "m": m, "damage": damage, "dt": dt}


def dictionary(rng, depth=0):
    kinds = ["Monomials", "Monomials", "GaussianRBF", "ThinPlate", "Exponentials", "Fourier", "Mechanical"]
    kind = rng.choice(kinds + ["Union", "Product"] * (depth == 0))
    if kind == "Monomials":
        return tras.Monomials(int(rng.integers(1, 7)))
    if kind in ("GaussianRBF", "ThinPlate"):
        count = int(10 ** rng.uniform(0, 3.2))
        width = rng.choice(["auto", "number"])
        width = width if width == "auto" else float(10 ** rng.uniform(-3, 3))
        options = {"seed": int(rng.integers(9)), "centres": str(rng.choice(["uniform", "data", "kmeans"]))}
        return getattr(tras, kind)(count, width, **options)
    if kind == "Exponentials":
        return tras.Exponentials(int(rng.integers(1, 5)), float(10 ** rng.uniform(-2, 2)))
    if kind == "Fourier":
        return tras.Fourier(int(rng.integers(1, 5)), float(10 ** rng.uniform(-1, 2)))
    if kind == "Mechanical":
        return tras.Mechanical(int(rng.choice([1, 2, 5, 8, 20])))
    return getattr(tras, kind)(dictionary(rng, 1), dictionary(rng, 1))


def options(rng):
    predictor = str(rng.choice(["vector_field", "one_step", "lifted_linear"]))
    drawn = {
        "predictor": predictor, "delays": int(rng.choice([0, 0, 0, 1, 3, 8, 30])), "lead": int(rng.choice([0, 0, 1])),
        "field": str(rng.choice(["coordinates", "coordinates", "coordinates", "least_squares"])),
        "regularization": rng.choice(["shrink", "tikhonov", "truncated", "sparse", "sparse", None]),
        "strength": "auto" if rng.random() < 0.6 else float(10 ** rng.uniform(-9, 1)),
        "extrapolation": str(rng.choice(["linear", "linear", "functions"])),
    }  # fmt: skip
    if predictor == "lifted_linear" and rng.random() < 0.6:
        drawn["stable"] = [True, 0.999, 0.9, 1][int(rng.integers(4))]
    if predictor == "one_step" and rng.random() < 0.3:
        drawn["columns"] = "states"
    if predictor == "one_step" and rng.random() < 0.3:
        drawn["horizon"] = int(rng.choice([2, 10, 100]))
    return drawn


def attempt(seed):
    """What came of the first combination that is not refused, and how many were before it (at most 20)."""
    rng, refusals = np.random.default_rng(seed), 0
    while True:
        outcome = once(rng)
        if outcome["warnings"] or outcome["fault"] or "functions" in outcome or refusals == 20:
            return outcome | {"refusals": refusals}
        refusals += 1


def once(rng):
    """What was drawn, what came of it, and which of our lines warned."""
    log, what = recording(rng)
    lift, drawn = dictionary(rng), options(rng)
    what |= {"dictionary": repr(lift), **drawn}
    outcome = {"what": what, "warnings": [], "fault": ""}

    def warned(message, category, filename, line, *_):
        if filename.startswith(PACKAGE):
            outcome["warnings"].append(f"{Path(filename).relative_to(PACKAGE)}:{line}: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = warned
        try:
            fitted = tras.KoopmanModel(lift, **drawn).fit(log, threads=1, progress=False)
            outcome["functions"] = len(fitted.names_)
            report = fitted.report(log) if log.lengths.min() > fitted.delays else fitted.report()
            if "nan" in report.lower().replace("dominan", "") or "inf" in report.lower().split():
                outcome["fault"] = "nan in the report: " + report[-300:]
            if log.lengths.min() > fitted.delays:
                fitted.score(log)
            fitted.save(Path(tempfile.mkdtemp()) / "model.npz")
            fitted.linearize()
        except ValueError as error:
            outcome["refusal"] = str(error)
            if "\n" in str(error) or not str(error).endswith("."):
                outcome["fault"] = f"no sentence: {error}"
                outcome["trace"] = traceback.format_exc()
        except Exception:
            outcome["fault"] = "traceback: " + traceback.format_exc()
    return outcome


def child(seed):
    """`attempt` in a process of its own: its outcome, with the seconds and bytes that it took."""
    reading, writing = os.pipe()
    start = time.monotonic()
    number = os.fork()
    if not number:
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (4 * MEMORY, 4 * MEMORY))
        with os.fdopen(writing, "w") as pipe:
            json.dump(attempt(seed), pipe)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    _, status, usage = os.wait4(number, 0)
    outcome = json.loads(text) if text else {"what": {}, "warnings": [], "fault": f"ended by signal {status}"}
    spent = {"seconds": usage.ru_utime + usage.ru_stime, "bytes": usage.ru_maxrss * 1024}
    return outcome | spent | {"wall": time.monotonic() - start}


def main():
    parser = argparse.ArgumentParser("python -m benchmarks.options", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="the number of one combination")
    given = parser.parse_args()
    if given.only is not None:
        print(json.dumps(attempt([given.seed, given.only]), indent=1))
        return 0
    counts, slowest, largest = collections.Counter(), 0.0, 0
    for number in range(given.count):
        outcome = child([given.seed, number])
        slowest, largest = max(slowest, outcome["seconds"]), max(largest, outcome["bytes"])
        faults = {
            "beyond 60 s or 1 GiB": outcome["seconds"] >= SECONDS or outcome["bytes"] > MEMORY,
            "warnings of our lines": outcome["warnings"], "tracebacks and others": outcome["fault"],
        }  # fmt: skip
        counts["refusals before"] += outcome.get("refusals", 0)
        counts["models" if "functions" in outcome else "refusals"] += 1
        for kind, fault in faults.items():
            counts[kind] += bool(fault)
        if number % 100 == 99:
            print(f"{number + 1} done", file=sys.stderr, flush=True)
        if any(faults.values()):
            print(number, json.dumps(outcome), flush=True)
    most = f"at most {slowest:.0f} s of processor time and {largest / 2**20:.0f} MiB"
    print(f"{given.count} combinations, seed {given.seed}: {dict(counts)}; {most}")
    return int(any(counts[kind] for kind in faults))


if __name__ == "__main__":
    sys.exit(main())
