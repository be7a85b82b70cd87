"""Local processes that do jobs and wait for the next ones.

They are the standard library's, not a pool of joblib or of `concurrent.futures`: such a pool breaks as a whole when
one process is killed, and does not say which job it had. Functions travel by cloudpickle: a notebook may hold them.
"""

import contextlib
import functools
import multiprocessing
import pickle
import signal
import sys
import traceback
import types
from collections import Counter, deque
from multiprocessing import connection
from typing import NamedTuple

_ATTEMPTS = 3  # a job whose process dies more often than that is given up
_IDLE = 60  # seconds after which a process that has nothing to do ends
_PROCESSES = []  # those that wait for the next call, with the pipes to them
_PACKAGE = f"{__name__.partition('.')[0]}."
# A fork server has imported the package already; a new interpreter for each process would import it again and again.
_METHODS = multiprocessing.get_all_start_methods()
_START = multiprocessing.get_context("forkserver" if "forkserver" in _METHODS else "spawn")


class Lost(NamedTuple):
    """In place of a result: every worker that was given the job died."""

    reason: str


def run_locally(work, jobs, shared, count=None):
    """(number, function that returns the result) of each job, with ``count`` processes, by default one per core.

    A job whose process was killed is done again after all others: alone, with all memory to itself.
    """
    import cloudpickle
    from joblib import cpu_count  # which scikit-learn brings: knows the limits of a container

    together = cloudpickle.dumps((work, shared))  # functions of a notebook by value
    waiting, suspects, running, deaths = deque(range(len(jobs))), deque(), {}, Counter()
    try:
        while waiting or suspects or running:
            while len(running) < (count or cpu_count()) and (waiting or (suspects and not running)):
                k = (waiting or suspects).popleft()
                process, pipe = _idle_process()
                running[pipe] = k, process
                with contextlib.suppress(OSError):  # the process is gone, which is seen when its answer is read
                    pipe.send((together, cloudpickle.dumps(jobs[k])))
            for pipe in connection.wait(running):
                k, process = running.pop(pipe)
                try:
                    result, error = pickle.loads(pipe.recv_bytes())
                except (EOFError, OSError):  # killed
                    deaths[k] += 1
                    if deaths[k] < _ATTEMPTS:
                        suspects.append(k)
                    else:
                        yield k, functools.partial(Lost, f"its process was killed {_ATTEMPTS} times (out of memory?)")
                else:
                    _PROCESSES.append((process, pipe))
                    yield k, functools.partial(_give, result, error)
    finally:
        if running:  # interrupted, or nobody asks for more
            for _, process in running.values():
                process.kill()
            while _PROCESSES:
                _PROCESSES.pop()[0].kill()


def _give(result, error):
    if error is not None:
        raise error
    return result


def _idle_process():
    """A process and the pipe to it, idle or new. It does not import the caller's script, which may lack a guard."""
    while _PROCESSES:
        process, pipe = _PROCESSES.pop()
        if process.is_alive():
            return process, pipe
    pipe, theirs = _START.Pipe()
    process = _START.Process(target=_serve, args=(theirs,), daemon=True)
    _START.set_forkserver_preload(sorted(name for name in sys.modules if name.startswith(_PACKAGE)))
    script, sys.modules["__main__"] = sys.modules["__main__"], types.ModuleType("__main__")
    try:
        process.start()
    finally:
        sys.modules["__main__"] = script
    theirs.close()
    return process, pipe


def _serve(pipe):
    """What a local process does, until no job has come for a while, or the caller is gone."""
    import cloudpickle

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the caller ends its own
    with contextlib.suppress(EOFError, OSError):
        while pipe.poll(_IDLE):
            message = pipe.recv()
            try:
                (work, shared), job = map(pickle.loads, message)
                answer = cloudpickle.dumps((work(*shared, *job), None))
            except BaseException as error:
                error.add_note(f"In a local process:\n{traceback.format_exc()}")
                answer = cloudpickle.dumps((None, error))
            pipe.send_bytes(answer)
