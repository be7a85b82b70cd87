"""``make bench``: this package beside the field's, with the same data and functions (``benchmarks/README.md``).

make bench                                                                whole, an hour, more on a busy machine
make bench BENCH="--peers deeptime --pairs 50000 --functions 84"          a part: printed, not published
make bench BENCH="--lock pykoop"                                          resolve a peer's lock file anew
"""

import argparse
import shutil
import signal
import sys

import pandas as pd
from tqdm import tqdm

from benchmarks.bench import environments, measure, report

ROOT = measure.ROOT
FOLDER = ROOT / "build" / "bench"
PEERS = [method.name for method in measure.METHODS if method.environment]
PAIRS, FUNCTIONS = [50_000, 500_000], [28, 84, 210, 506, 1006]


def parser():
    p = argparse.ArgumentParser(
        prog="make bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("--peers", nargs="*", metavar="PEER", help=f"of {', '.join(PEERS)}; none without names")
    p.add_argument(
        "--pairs", nargs="+", type=int, metavar="M", help=f"snapshot pairs, default {' '.join(map(str, PAIRS))}"
    )
    p.add_argument("--functions", nargs="+", type=int, metavar="N", help=f"default {' '.join(map(str, FUNCTIONS))}")
    p.add_argument(
        "--rolled",
        nargs="*",
        type=int,
        default=[84],
        metavar="N",
        help="functions with which to roll out, default 84; none without numbers",
    )
    p.add_argument(
        "--memory", type=float, default=6, metavar="GIB", help="limit of a child's resident memory, default 6"
    )
    p.add_argument("--seconds", type=float, default=120, help="limit of a run, CPU seconds, default 120")
    p.add_argument(
        "--budget",
        type=float,
        default=40,
        help="CPU seconds for all runs of a measurement, default 40; at least one run",
    )
    p.add_argument("--runs", type=int, default=5, help="at most, default 5")
    p.add_argument("--growth", action="store_true", help="only our own cost against pairs, functions and trajectories")
    p.add_argument("--anew", action="store_true", help="forget what was measured before")
    p.add_argument("--kept", action="store_true", help="measure nothing more: publish what was measured so far")
    p.add_argument(
        "--report", action="store_true", help="measure nothing: figures and tables from benchmarks/results/ again"
    )
    p.add_argument("--lock", nargs="+", metavar="PEER", help="resolve these peers' lock files anew (needs uv) and end")
    return p


def checked(p, options):
    """Sentences instead of tracebacks for what cannot be."""
    for name in [*(options.peers or []), *(options.lock or [])]:
        if name not in PEERS:
            p.error(f"there is no peer {name!r}; choose from {', '.join(PEERS)}.")
    for pairs in options.pairs or []:
        if pairs < 1000 or pairs % 500:
            p.error(f"--pairs {pairs}: give multiples of 500 (whole trajectories), 1000 or more.")
    for functions in options.functions or []:
        if functions not in measure.data.DEGREES and functions <= measure.data.HEAD + 3:
            p.error(
                f"--functions {functions}: give {', '.join(map(str, measure.data.DEGREES))} (monomials) "
                "or more than 10 (Gaussians)."
            )
    for name in ("memory", "seconds", "budget", "runs"):
        if not getattr(options, name) > 0:
            p.error(f"--{name} {getattr(options, name):g}: give a positive number.")
    return options


def prepared(peers, bar):
    """Interpreters of the peers, and why one has none."""
    pythons, missing = {}, {}
    for name in peers:
        bar.set_description(f"environment of {name}")
        try:
            pythons[name] = environments.interpreter(name, FOLDER / "venvs")
        except RuntimeError as error:
            missing[name] = str(error)
            bar.write(f"{name} is left out: {error}")
    return pythons, missing


class Kept(measure.Bench):
    """Only what was measured before."""

    def cached(self, key, measure):
        known = (self.folder / "measured" / f"{key}.json").is_file()
        return super().cached(key, measure) if known else {"fit": {"outcome": "not measured", "runs": 0}}


def run(options):
    """Measure what the options ask for; tables of comparison and growth, one of them None if not asked for."""
    peers = PEERS if options.peers is None else options.peers
    methods = [method for method in measure.METHODS if method.environment in (None, *peers)]
    cells = [(pairs, functions) for pairs in options.pairs or PAIRS for functions in options.functions or FUNCTIONS]
    part = any(value is not None for value in (options.peers, options.pairs, options.functions))
    limits = measure.Limits(options.memory * 2**30, options.seconds, options.budget, options.runs)
    steps = (0 if options.growth else len(cells) * len(methods)) + (
        0 if part else sum(map(len, measure.GROWTH.values()))
    )
    with tqdm(total=steps, unit="", dynamic_ncols=True) as bar:

        def say(text):
            bar.set_description(text)
            bar.update()

        pythons, missing = prepared([] if options.growth or options.kept else peers, bar)
        bench = (Kept if options.kept else measure.Bench)(FOLDER, limits, pythons, missing)
        try:
            compared = (
                None if options.growth else pd.DataFrame(measure.compare(bench, methods, cells, options.rolled, say))
            )
            grown = None if part else pd.DataFrame(measure.grow(bench, say))
        finally:
            bench.forget_references()
    return compared, grown, part or options.growth


def interrupt(*_):
    """Ended from outside is interrupted too: no child must be left without its limits."""
    raise KeyboardInterrupt


def main(arguments=None):
    """Command line; returns the exit status."""
    p = parser()
    options = checked(p, p.parse_args(arguments))
    try:
        if options.lock:
            for name in options.lock:
                environments.lock(name)
            return 0
        if options.anew:
            for path in (FOLDER / "measured").glob("*.json"):
                path.unlink()
        if not options.report:
            compared, grown, part = run(options)
            folder = FOLDER / "results" if part else report.RESULTS
            if part:  # of this part alone
                shutil.rmtree(folder, ignore_errors=True)
            report.write(folder, compared, grown)
            print(report.text(folder))
            if part:
                print(f"A part: written below {folder.relative_to(ROOT)}, not into benchmarks/.")
                return 0
        report.draw(report.RESULTS)
        report.publish(report.RESULTS, ROOT / "benchmarks" / "README.md")
    except KeyboardInterrupt:
        print(
            "\nInterrupted; what was measured is kept in build/bench, make bench goes on from there.", file=sys.stderr
        )
        return 130
    except (OSError, ValueError, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # also where a shell's background job ignores the first
        signal.signal(number, interrupt)
    sys.exit(main())
