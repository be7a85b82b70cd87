"""One way of fitting in its own process: ``python child.py ADAPTER FOLDER``, then one request per line of stdin.

An adapter is a module beside this file that runs in the environment of the package it calls:

``load(problem) -> data``
    The data in the form the package takes them; not timed.
``fit(problem, data) -> model``
    Timed.
``features(problem, model, z) -> (points, features)``
    The package's own regressors at ``z`` (points, n + m), in its order.
``matrix(problem, model) -> (features, targets)``
    ``targets = features @ matrix`` one sample later; target j is feature j. None if its functions are others.
``roll_out(problem, model) -> (runs, samples, n)``
    Timed; None if there is none. From ``problem.x0`` under ``problem.u``, beginning with ``x0``. If the package
    needs another fit for it: ``prepare_roll_out(problem, data, model) -> model``, not timed.

``NOTE`` says what was timed, ``HOW`` how it rolls out. Requests and replies are JSON; stderr has what a package prints.
"""

import copy
import gc
import importlib
import json
import os
import sys
import time
import traceback

import numpy as np
import problem as problems


def resident(kind):
    """Bytes of resident memory: now (VmRSS) or at most (VmHWM); without /proc the most so far."""
    try:
        with open("/proc/self/status") as file:
            return next(1024 * int(line.split()[1]) for line in file if line.startswith(kind + ":"))
    except FileNotFoundError:
        import resource

        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most if sys.platform == "darwin" else 1024 * most


def forget_peak():
    try:
        with open("/proc/self/clear_refs", "w") as file:
            file.write("5")
    except OSError:
        pass  # the peak then counts from the start of the process


def timed(action):
    """The action's result, CPU and wall-clock seconds, and peak memory."""
    gc.collect()
    forget_peak()
    wall, cpu = time.perf_counter(), time.process_time()
    result = action()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return result, {"cpu": cpu, "wall": wall, "peak": resident("VmHWM")}


class Session:
    """What a process keeps from one request to the next."""

    def __init__(self, adapter, folder, variant):
        self.adapter = importlib.import_module(adapter)
        self.problem = problems.read(folder)
        self.problem.variant = variant
        warm_up(self.adapter, self.problem)
        self.data = self.adapter.load(self.problem)
        self.model = self.simulated = None
        self.base = resident("VmRSS")

    def ready(self):
        version = getattr(self.adapter, "VERSION", "")
        return {
            "version": version,
            "note": note(self.adapter, "NOTE", self.problem),
            "how": note(self.adapter, "HOW", self.problem),
        }

    def fit(self):
        self.model = None
        self.model, numbers = timed(lambda: self.adapter.fit(self.problem, self.data))
        return self.beyond(numbers)

    def beyond(self, numbers):
        """Peak memory beyond what was held before the first fit."""
        return numbers | {"peak": max(0, numbers["peak"] - self.base)}

    def coefficients(self, path):
        """The states' columns of K, rows in the problem's order, to ``path``."""
        K = self.adapter.matrix(self.problem, self.model)
        if K is None:
            return {"none": True}
        order, K = (
            problems.match(self.adapter.features(self.problem, self.model, self.problem.points), self.problem.values),
            np.asarray(K),
        )
        np.save(path, K[order][:, order[1 : 1 + self.problem.n]])
        return {"targets": K.shape[1]}

    def roll_out(self, path):
        if self.simulated is None:
            prepare = getattr(self.adapter, "prepare_roll_out", lambda problem, data, model: model)
            self.simulated = prepare(self.problem, self.data, self.model)
        states, numbers = timed(lambda: self.adapter.roll_out(self.problem, self.simulated))
        if states is None:
            return {"none": True}
        np.save(path, np.asarray(states, dtype=float))
        return self.beyond(numbers)


def warm_up(adapter, problem):
    """A small fit of the same kind: imports and compilation on first use then count neither as time nor as memory."""
    small = copy.copy(problem)
    small.states, small.inputs = problem.states[:2], problem.inputs[:2]
    if problem.kind == "monomials":
        small.degree, small.exponents = 1, problem.exponents[problem.exponents.sum(axis=1) <= 1]
        small.functions = len(small.exponents)
    else:
        small.centres = problem.centres[:3]
        small.functions = 1 + problem.n + problem.m + len(small.centres)
    adapter.fit(small, adapter.load(small))


def note(adapter, name, problem):
    text = getattr(adapter, name, "")
    return text(problem) if callable(text) else text


def main(adapter, folder, variant=""):
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a package prints

    def answer(action, *arguments):
        try:
            reply = action(*arguments)
        except MemoryError:
            reply = {"failed": "out of memory"}
        except Exception as error:
            traceback.print_exc()
            reply = {"failed": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}
        print(json.dumps(reply), file=replies, flush=True)

    if hasattr(os, "sched_setaffinity") and variant != "all_processors":
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # one processor for everybody
    session = None

    def begin():
        nonlocal session
        session = Session(adapter, folder, variant)
        return session.ready()

    answer(begin)
    for line in sys.stdin:
        request = json.loads(line)
        answer(getattr(session, request.pop("do")), *request.values())


if __name__ == "__main__":
    main(*sys.argv[1:])
