"""Measuring: a method and a reference in turn, each in its own child, so that ratios are of the same minutes."""

import functools
import hashlib
import json
import statistics
import sys
from collections import namedtuple
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path

import numpy as np

from benchmarks.bench import data, exact
from benchmarks.bench.children import Child, Failed
from tras.workflow import files

ROOT = Path(__file__).resolve().parent.parent.parent
THREADS = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
BEYOND = 1e3  # half-ranges: a roll-out that leaves them is counted as diverged
FITTED_ONLY = ("koopman_matrix", "all_processors", "states_alone", "floor")
ROLLED_ONLY = ("one_step", "lifted_linear")  # their fits differ little from the others
ROLLED_OUT = ("one_step", "vector_field", "lifted_linear")
HOPELESS = ("out of memory", "over the time limit")

Method = namedtuple("Method", "name adapter variant environment", defaults=("", None))
OURS = Method("tras", "with_tras", "koopman_matrix")
GRAM = Method("plain Gram", "with_numpy", "gram")
METHODS = [
    OURS,
    *(
        Method(f"tras, {variant.replace('_', ' ')}", "with_tras", variant)
        for variant in ("all_processors", "states_alone", "one_step", "vector_field", "lifted_linear", "default")
    ),
    GRAM,
    Method("floor", "with_numpy", "floor"),
    *(
        Method(name, f"with_{name}", "", name)
        for name in ("pykoop", "pykoopman", "deeptime", "kooplearn", "datafold", "pydmd")
    ),
]

Limits = namedtuple("Limits", "memory seconds budget rounds", defaults=(6 * 2**30, 120.0, 60.0, 5))
# Bytes of resident memory; CPU seconds of one run, of all runs of a measurement; runs at most.


def rounds(first, budget, most):
    """How many runs, the first of which took so many CPU seconds, its reference's included."""
    return most if first * most <= budget else max(1, int(budget / first))


def fingerprint(lock=None):
    """Of all code that a measurement depends on, and of the peer's lock file."""
    parts = [*sorted(ROOT.glob("tras/**/*.py")), *sorted(ROOT.glob("benchmarks/peers/*.py")), ROOT / "environment.txt"]
    parts += [Path(__file__).parent / name for name in ("children.py", "data.py", "exact.py", "measure.py")] + (
        [lock] if lock else []
    )
    return hashlib.sha256(b"".join(hashlib.sha256(path.read_bytes()).digest() for path in parts)).hexdigest()[:12]


class Bench:
    """Where things are, what may be spent, and the children that wait as references."""

    def __init__(self, folder, limits, pythons, missing):
        self.folder, self.limits = Path(folder), limits
        self.pythons, self.missing = pythons, missing  # by peer: its interpreter, or why it has none
        self._stack, self._references = ExitStack(), {}

    def child(self, method, problem, limits=None):
        limits = limits or self.limits
        python = self.pythons.get(method.environment, sys.executable)
        command = [str(python), str(ROOT / "benchmarks/peers/child.py"), method.adapter, str(problem), method.variant]
        return Child(command, self.folder / "logs" / f"{method.name}.log", limits.memory, limits.seconds, THREADS)

    def reference(self, method, problem):
        """A child of the method for this problem, until another problem comes. It is fitted once, for roll-outs."""
        if self._references.get(method.name, (None,))[0] != problem:
            child = self._stack.enter_context(
                self.child(method, problem, self.limits._replace(seconds=10 * self.limits.seconds))
            )
            child.ask()
            self._references[method.name] = problem, child
        return self._references[method.name][1]

    def forget_references(self):
        self._stack.close()
        self._references = {}

    def cached(self, key, measure):
        """The rows of this key if they were measured before, else measured and kept."""
        path = self.folder / "measured" / f"{key}.json"
        if path.is_file():
            return json.loads(path.read_text())
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        rows = {what: row | {"measured": now} for what, row in measure().items()}
        with files.replacing(path) as temporary:
            temporary.write_text(json.dumps(rows))
        return rows


def measured(bench, method, problem, with_exact=False, rolled=False, compared=True, fits=None):
    """Rows of a fit and, if ``rolled`` and if the method has one, of a roll-out: ``{"fit": row, "roll-out": row}``.

    Parameters
    ----------
    problem : pathlib.Path
        A folder, see `benchmarks/peers/problem.py`.
    with_exact : bool
        Compare the coefficients with extended precision.
    compared : bool
        In turn with ours (fit) and with the plain NumPy loop (roll-out), as ratios.
    fits : int, optional
        At most so many, where only the roll-out counts.
    """
    rows = {}
    try:
        with bench.child(method, problem) as child:
            ready = child.ask()
            rows["fit"] = {"version": ready["version"], "timed": ready["note"]}
            reference = (
                (lambda: bench.reference(OURS, problem).ask({"do": "fit"})) if compared and method != OURS else None
            )
            rows["fit"] |= in_turn(bench, lambda: child.ask({"do": "fit"}), reference, fits)
            if not rows["fit"]["outcome"]:
                rows["fit"] |= accuracy(bench, child, problem, with_exact)
                if rolled:
                    path = bench.folder / "rolled.npy"
                    reference = (lambda: loop(bench, problem)) if compared and method != GRAM else None
                    row = in_turn(bench, lambda: child.ask({"do": "roll_out", "path": str(path)}), reference)
                    rows["roll-out"] = (
                        {"version": ready["version"], "timed": ready["how"]}
                        | row
                        | ({} if row["outcome"] else fate(path))
                    )
    except Failed as failure:
        rows.setdefault("fit", {"runs": 0})["outcome"] = str(failure)
    return rows


def in_turn(bench, run, reference, most=None):
    """Run and reference in turn, as often as the budget allows; medians, and in ``outcome`` why there are none."""
    runs, references, count = [], [], 1
    try:
        while len(runs) < count:
            runs.append(run())
            references.append(_asked(reference) if reference else runs[-1])
            if len(runs) == 1:
                count = rounds(
                    runs[0]["cpu"] + (references[0]["cpu"] if reference else 0),
                    bench.limits.budget,
                    most or bench.limits.rounds,
                )
    except Failed as failure:
        return {"outcome": str(failure)} | summary(runs[: len(references)], references)
    return {"outcome": ""} | summary(runs, references)


def _asked(reference):
    """A run of the reference, whose failure must not pass for the method's."""
    try:
        return reference()
    except Failed as failure:
        raise Failed(f"no ratio, the reference failed: {failure}") from failure


def accuracy(bench, child, problem, with_exact):
    """Number of targets and error of the coefficients of what the child has fitted, as far as they can be had."""
    path = bench.folder / "found.npy"
    try:
        reply = child.ask({"do": "coefficients", "path": str(path)})
        if with_exact and "targets" in reply:
            reply["error"] = exact.error(np.load(path), exact.coefficients(problem, bench.folder / "exact"))
    except (Failed, RuntimeError) as failure:
        return {"remark": str(failure)}
    return {key: value for key, value in reply.items() if key != "none"}


def fate(path):
    """How many trajectories a roll-out has, and how many of them leave the data's range a thousandfold."""
    states = np.load(path)
    with np.errstate(invalid="ignore"):
        return {"trajectories": len(states), "diverged": int((~(np.abs(states) <= BEYOND)).any(axis=(1, 2)).sum())}


def loop(bench, problem):
    """A run of the plain NumPy loop."""
    fresh = GRAM.name not in bench._references or bench._references[GRAM.name][0] != problem
    child = bench.reference(GRAM, problem)
    if fresh:
        child.ask({"do": "fit"})
    return child.ask({"do": "roll_out", "path": str(bench.folder / "reference.npy")})


def summary(runs, references):
    """Medians over the runs, of times and of the ratios of each run to its reference."""
    medians = {"runs": len(runs)}
    if not runs:
        return medians
    for kind in ("cpu", "wall"):
        medians[f"{kind}_s"] = statistics.median(run[kind] for run in runs)
        ratios = [run[kind] / other[kind] for run, other in zip(runs, references) if other[kind] > 0]
        medians[f"{kind}_ratio"] = statistics.median(ratios) if ratios else None
    medians["cpu_least_s"], medians["cpu_most_s"] = min(run["cpu"] for run in runs), max(run["cpu"] for run in runs)
    medians["peak_mib"] = max(run["peak"] for run in runs) / 2**20
    return medians


def hopeless(rows, method, pairs, functions):
    """Why this needs no trial: a smaller problem of the same method was too large. None if there is no such."""
    for row in rows:
        if (
            (row["what"], row["method"]) == ("fit", method.name)
            and row["pairs"] <= pairs
            and row["functions"] <= functions
            and row["outcome"] in HOPELESS
        ):
            return f"{row['outcome']} at {row['pairs']} pairs, {row['functions']} functions: not tried"
    return None


def compare(bench, methods, cells, rolled, say, exact_up_to=50_000 * 1006):
    """Rows per cell (pairs, functions) and method: its fit, and its roll-out where ``rolled`` holds the functions.

    Parameters
    ----------
    say : callable
        Told what begins, once for each cell and method.
    exact_up_to : int
        Pairs times functions beyond which there is no extended precision: it takes minutes there.
    """
    rows, smallest = [], min(pairs for pairs, _ in cells)
    for pairs, functions in sorted(cells):
        problem = functools.cache(
            functools.partial(data.write, bench.folder / "problems", pairs, functions)
        )  # only if something is measured
        for method in methods:
            say(f"{method.name}, {pairs} pairs, {functions} functions")
            rolls = pairs == smallest and functions in rolled and method.variant not in FITTED_ONLY
            if method.variant in ROLLED_ONLY and not rolls:
                continue
            reason = bench.missing.get(method.environment) or hopeless(rows, method, pairs, functions)
            measurement = {"fit": {"outcome": reason, "runs": 0}}
            if not reason:
                options = {"with_exact": pairs * functions <= exact_up_to, "rolled": rolls}
                lock = ROOT / f"benchmarks/peers/{method.environment}.txt" if method.environment else None
                slug = method.name.replace(", ", "-").replace(" ", "-")
                key = f"{slug}-{pairs}-{functions}-{fingerprint(lock)}-{digest(bench.limits, options)}"
                measurement = bench.cached(
                    key,
                    lambda method=method, options=options, problem=problem: measured(
                        bench, method, problem(), **options
                    ),
                )
            rows += [
                {"what": what, "method": method.name, "pairs": pairs, "functions": functions} | row
                for what, row in measurement.items()
            ]
        bench.forget_references()
    return rows


def digest(*values):
    return hashlib.sha256(repr(values).encode()).hexdigest()[:6]


GROWTH = {
    "pairs": [(pairs, 84, 100) for pairs in (12_500 * 2**k for k in range(10))],
    "functions": [(50_000, functions, 100) for functions in (27, 57, 107, 207, 407, 807, 1607)],
    "trajectories": [(50_000, 84, runs) for runs in (1, 4, 16, 64, 256, 512, 1024, 2048, 4096)],
}
NARROW = 0.5  # width of the Gaussians here: 1600 wide ones are dependent to working precision


def grow(bench, say, against=GROWTH):
    """Rows of our own cost against pairs, functions and trajectories."""
    rows = []
    variants = {method.variant: method for method in METHODS if method.adapter == "with_tras"}
    for variable, cells in against.items():
        for pairs, functions, runs in cells:
            say(f"our cost against {variable}: {pairs} pairs, {functions} functions, {runs} trajectories")
            problem = None
            for variant in ROLLED_OUT if variable == "trajectories" else ("koopman_matrix",):
                key = f"growth-{variable}-{variant}-{pairs}-{functions}-{runs}-{fingerprint()}-{digest(bench.limits)}"

                def measure(variant=variant, variable=variable, cell=(pairs, functions, runs)):
                    nonlocal problem
                    problem = problem or data.write(bench.folder / "problems", *cell, width=NARROW)
                    rolled = variable == "trajectories"
                    return measured(
                        bench, variants[variant], problem, rolled=rolled, compared=False, fits=1 if rolled else None
                    )

                measurement = bench.cached(key, measure)
                row = measurement.get("roll-out" if variable == "trajectories" else "fit", measurement["fit"])
                rows.append(
                    {"against": variable, "variant": variant}
                    | row
                    | {"pairs": pairs, "functions": functions, "trajectories": runs}
                )
    return rows
