"""Where jobs run: in this process, in local processes, or on the workers of a Dask scheduler.

A job whose worker is killed is given to another one; one that kills every worker is `Lost`, and the others go on. What all jobs share travels to a
worker of Dask once.
"""

import contextlib
import functools
import logging
import queue
import sys
from collections import deque
from concurrent import futures
from typing import NamedTuple

from tras.provenance import versions

_ATTEMPTS = 3  # a job whose worker dies more often than that is given up
_PATIENCE = 5.0  # seconds to wait for a scheduler, and for its first worker
_LOOK = 10.0  # seconds without a result after which one looks whether there are workers still
_LARGE = {"distributed.admin.large-graph-warning-threshold": "1 GiB"}  # recordings in memory are sent knowingly
_IDLE = 60  # seconds after which a local process that has nothing to do ends
_POOLS = {}  # number of processes -> pool, kept for the next call


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
        Number of local processes; default one a core.
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
        raise ValueError(f"scheduler is {scheduler!r}; give None, 'processes', or an address such as 'tcp://host:8786'.")


def _in_turn(done):
    early, turn = {}, 0
    for k, result in done:
        early[k] = result
        while turn in early:
            yield turn, early.pop(turn)
            turn += 1


# ---------------------------------------------------------------------------------------------------------------- local processes


def _processes(work, jobs, shared, count):
    """(number, function that returns the result) of each job. A killed process breaks the pool, and nobody knows by which job: those that were running
    are done one by one, each alone, so that the guilty one is found and has all memory to itself."""
    import joblib
    from joblib.externals.loky import BrokenProcessPool

    count = count or joblib.cpu_count()
    waiting, running = deque(enumerate(jobs)), {}
    try:
        while waiting or running:
            try:
                pool = _pool(count)
                while waiting and len(running) < count:
                    k, job = waiting[0]
                    running[pool.submit(work, *shared, *job)] = k
                    waiting.popleft()
            except BrokenProcessPool:  # killed while it had nothing to do, or a moment ago
                pass
            finished, _ = futures.wait(running, return_when=futures.FIRST_COMPLETED)
            if any(isinstance(future.exception(), BrokenProcessPool) for future in finished):
                finished, _ = futures.wait(running)
            for future in sorted(finished, key=running.get):
                k = running.pop(future)
                broken = isinstance(future.exception(), BrokenProcessPool)
                yield k, (_alone(work, (*shared, *jobs[k])) if broken else future.result)
    except BaseException:  # also when interrupted, or when nobody asks for more
        if running:
            pool.shutdown(wait=False, kill_workers=True)
        raise


def _alone(work, arguments):
    """Function that returns the result, or `Lost`."""
    from joblib.externals.loky import BrokenProcessPool

    for _ in range(_ATTEMPTS - 1):
        future = _pool(1).submit(work, *arguments)
        if not isinstance(future.exception(), BrokenProcessPool):
            return future.result
    return lambda: Lost(f"its process was killed {_ATTEMPTS} times (out of memory?)")


def _pool(count):
    """The pool of so many processes, a new one if the last was broken or ended. They import what they need when a job asks for it, not the caller's script.

    Not the one pool that joblib shares with everybody: its own ``Parallel`` cannot go on with a pool that others made.
    """
    from joblib.externals.loky import ProcessPoolExecutor

    pool = _POOLS.get(count)
    if pool is None or pool._flags.broken is not None or pool._flags.shutdown:
        pool = _POOLS[count] = ProcessPoolExecutor(max_workers=count, timeout=_IDLE)
    return pool


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
                print(f"scheduler {address!r} has no worker any more: waiting for one (docs/scale.md).", file=sys.stderr)


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
        raise SchedulerError(f"scheduler {address!r} went away; start it again (docs/scale.md), and then this.") from error


def _require_alike(client, address, alike, wanted):
    """A worker at all, and on each of them what is ``wanted``."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except (OSError, TimeoutError) as error:
        raise SchedulerError(f"scheduler {address!r} has no worker; start some (docs/scale.md).") from error
    for worker, theirs in client.run(alike, on_error="return").items():
        if not isinstance(theirs, dict):
            raise SchedulerError(f"worker {worker} cannot import tras ({theirs}); install environment.txt and this package there.")
        _compare(worker, theirs, wanted)


def _compare(worker, theirs, wanted):
    for name, value in wanted.items():
        if theirs.get(name) != value:
            raise SchedulerError(f"worker {worker} has {name} {theirs.get(name)} but {value} is needed; install environment.txt there.")
