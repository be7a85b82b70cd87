"""Where jobs run: in this process, in local processes, or on the workers of a Dask scheduler.

A job whose worker is killed is given to another one; one that kills every worker is `Lost`, and the others go on. What all jobs share travels to a
worker of Dask once.

Local processes are the standard library's, not a pool of joblib or of `concurrent.futures`: such a pool breaks as a
whole when one process is killed, and does not say which job it had. Functions travel by cloudpickle, so a notebook may
hold them.
"""

import contextlib
import functools
import logging
import multiprocessing
import pickle
import queue
import signal
import sys
import traceback
import types
from collections import Counter, deque
from concurrent import futures
from multiprocessing import connection
from typing import NamedTuple

from tras.workflow.provenance import versions

_ATTEMPTS = 3  # a job whose worker dies more often than that is given up
_PATIENCE = 5.0  # seconds to wait for a scheduler, and for its first worker
_LOOK = 10.0  # seconds without a result after which one looks whether there are workers still
_LARGE = {"distributed.admin.large-graph-warning-threshold": "1 GiB"}  # recordings in memory are sent knowingly
_IDLE = 60  # seconds after which a local process that has nothing to do ends
_PROCESSES = []  # local processes that wait for the next call, with the pipes to them
_PACKAGE = f"{__name__.partition('.')[0]}."
# A fork server has imported the package already; a new interpreter for each process would import it again and again.
_METHODS = multiprocessing.get_all_start_methods()
_START = multiprocessing.get_context("forkserver" if "forkserver" in _METHODS else "spawn")


class SchedulerError(ValueError):
    """The scheduler cannot be reached, its workers do not fit, or they lose a job for good."""


class Lost(NamedTuple):
    """In place of a result: every worker that was given the job died."""

    reason: str


def run(work, jobs, shared=(), *, scheduler=None, processes=None, ordered=False, alike=versions):
    """Do all jobs, and give each result when it is there.

    Parameters
    ----------
    work : callable
        A function of a module; ``work(*shared, *job)`` is the result of a job.
    jobs : sequence of tuple
    shared : tuple
        Arguments that all jobs have in common.
    scheduler : None, "processes" or str
        None: one job after the other in this process. "processes": local processes. An address such as "tcp://host:8786": the workers of that
        Dask scheduler.
    processes : int, optional
        Number of local processes; default one per core.
    ordered : bool
        Give the results in the order of the jobs. Until it is their turn they stay on the workers of Dask.
    alike : callable
        Returns a dict of what must be equal here and on each worker, name -> text.

    Yields
    ------
    (int, object)
        Number of the job; its result, or `Lost`.

    Raises
    ------
    SchedulerError
        With one sentence, if the scheduler does not answer or goes away, or a worker is not ``alike``. What ``work`` raises is raised here.
    """
    require_scheduler(scheduler)
    if processes is not None and (isinstance(processes, bool) or not isinstance(processes, int) or processes < 1):
        raise ValueError(f"processes is {processes!r}; give a whole number, 1 or more, or None for one per core.")
    jobs = list(jobs)
    if scheduler is None:
        done = ((k, functools.partial(work, *shared, *job)) for k, job in enumerate(jobs))
    elif scheduler == "processes":
        done = _processes(work, jobs, shared, processes)
    else:
        done = _dask(work, jobs, shared, scheduler, alike)
    with contextlib.closing(done):  # at once, whatever keeps the traceback
        for k, result in _in_turn(done) if ordered else done:
            yield k, result()


def require_scheduler(scheduler):
    """A ValueError unless it is one that `run` knows."""
    if scheduler not in (None, "processes") and not (isinstance(scheduler, str) and "://" in scheduler):
        raise ValueError(
            f"scheduler is {scheduler!r}; give None, 'processes', or an address such as 'tcp://host:8786'."
        )


def _in_turn(done):
    early, turn = {}, 0
    for k, result in done:
        early[k] = result
        while turn in early:
            yield turn, early.pop(turn)
            turn += 1


# ---------------------------------------------------------------------------------------------------------------- local processes


def _processes(work, jobs, shared, count):
    """(number, function that returns the result) of each job.

    A job whose process was killed is done again after all others: alone, with all memory to itself.
    """
    import cloudpickle
    from dask.system import cpu_count

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
    """A process and the pipe to it, of an earlier job or new.

    A process imports what its jobs need, not the caller's script, which may have no guard against being imported.
    """
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


# --------------------------------------------------------------------------------------------------------------------------- Dask


def _dask(work, jobs, shared, address, alike):
    """(number, function that returns the result) of each job, as they are done; the scheduler gives the jobs of a lost worker to another one."""
    import dask
    from distributed import Client

    _require_answer(address)
    with _hushed(), dask.config.set(_LARGE), Client(address, timeout=_PATIENCE, set_as_default=False) as client:
        wanted = alike()
        _require_alike(client, address, alike, wanted)
        # As a task: what was scattered would be lost with the one worker that holds it, a task is done again.
        together = client.submit(_together, shared, pure=False)
        finished, waiting, suspects = queue.SimpleQueue(), {}, []

        def submit(k):
            future = client.submit(_task, work, together, jobs[k], alike, wanted, pure=False, retries=_ATTEMPTS)
            waiting[future.key] = k, future
            future.add_done_callback(lambda future: finished.put(future.key))

        for k in range(len(jobs)):
            submit(k)
        try:
            while waiting:
                k, future = waiting.pop(_next(finished, client, address))
                if _killed(future):
                    suspects.append(k)
                else:
                    yield k, functools.partial(_result, future, address)
                del future  # the scheduler may forget it
            for k in suspects:  # or they only waited on the worker that another one killed: each alone once more
                submit(k)
                _, future = waiting.pop(_next(finished, client, address))
                yield k, functools.partial(_result, future, address)
        finally:
            client.cancel([together, *(future for _, future in waiting.values())])


def _require_answer(address):
    """A scheduler is there. A client alone would wait for ever for the answer of another kind of server."""
    import asyncio

    from distributed import rpc

    async def ask():
        async with rpc(address, timeout=_PATIENCE) as scheduler:
            await asyncio.wait_for(scheduler.identity(), _PATIENCE)

    with futures.ThreadPoolExecutor(1) as thread:  # a notebook has a loop of its own in this one
        try:
            thread.submit(asyncio.run, ask()).result()
        except Exception as error:  # another server's answer is read as anything
            raise SchedulerError(
                f"scheduler {address!r} cannot be reached within {_PATIENCE:g} s; start one (docs/scale.md), or give another address."
            ) from error


@contextlib.contextmanager
def _hushed():
    """A client that loses its scheduler logs a traceback; here one sentence says it."""
    logger = logging.getLogger("distributed.client")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)


def _together(shared):
    return shared


def _task(work, shared, job, alike, wanted):
    """What a worker of Dask does. It may have come after all were compared."""
    from distributed import get_worker

    _compare(get_worker().address, alike(), wanted)
    return work(*shared, *job)


def _next(finished, client, address):
    """Key of the next future that is done."""
    said = False
    while True:
        try:
            return finished.get(timeout=_LOOK)
        except queue.Empty:
            if not (said or client.scheduler_info().get("workers")):
                said = True
                print(
                    f"scheduler {address!r} has no worker any more: waiting for one (docs/scale.md).", file=sys.stderr
                )


def _killed(future):
    from distributed.scheduler import KilledWorker

    return future.status == "error" and isinstance(future.exception(), KilledWorker)


def _result(future, address):
    from distributed.client import FutureCancelledError
    from distributed.comm import CommClosedError

    if _killed(future):
        return Lost("every worker that was given it died (out of memory?)")
    try:
        return future.result()
    except (FutureCancelledError, CommClosedError) as error:
        raise SchedulerError(
            f"scheduler {address!r} went away; start it again (docs/scale.md), and then this."
        ) from error


def _require_alike(client, address, alike, wanted):
    """A worker at all, and on each of them what is ``wanted``."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except (OSError, TimeoutError) as error:
        raise SchedulerError(f"scheduler {address!r} has no worker; start some (docs/scale.md).") from error
    for worker, theirs in client.run(alike, on_error="return").items():
        if not isinstance(theirs, dict):
            raise SchedulerError(
                f"worker {worker} cannot import tras ({theirs}); install environment.txt and this package there."
            )
        _compare(worker, theirs, wanted)


def _compare(worker, theirs, wanted):
    for name, value in wanted.items():
        if theirs.get(name) != value:
            raise SchedulerError(
                f"worker {worker} has {name} {theirs.get(name)} but {value} is needed; install environment.txt there."
            )
