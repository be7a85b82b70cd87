"""Where jobs run: in this process, in local processes (`tras.workflow.processes`), or on the workers of Dask.

A job whose worker is killed is given to another one; one that kills every worker is `Lost`, and the others go on. What
all jobs share travels to a worker of Dask once.
"""

import contextlib
import functools
import logging
import queue
import sys
from concurrent import futures

from tras.workflow.arguments import extra, whole_number
from tras.workflow.processes import Lost, run_locally
from tras.workflow.provenance import versions

_ATTEMPTS = 3  # a job whose worker dies more often than that is given up
_PATIENCE = 5.0  # seconds to wait for a scheduler, and for its first worker
_LOOK = 10.0  # seconds without a result after which one looks whether there are workers still
_LARGE = {"distributed.admin.large-graph-warning-threshold": "1 GiB"}  # recordings in memory are sent knowingly


class SchedulerError(ValueError):
    """The scheduler cannot be reached, its workers do not fit, or they lose a job for good."""


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
        None: one job after the other in this process. "processes": local processes. An address such as
        "tcp://host:8786": the workers of that Dask scheduler.
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
        If the scheduler does not answer or goes away, or a worker is not ``alike``. What ``work`` raises is raised too.
    """
    require_scheduler(scheduler)
    if processes is not None:
        whole_number("processes", processes, give="a whole number, 1 or more, or None for one per core")
    jobs = list(jobs)
    if scheduler is None:
        done = ((k, functools.partial(work, *shared, *job)) for k, job in enumerate(jobs))
    elif scheduler == "processes":
        done = run_locally(work, jobs, shared, processes)
    else:
        done = _dask(work, jobs, shared, scheduler, alike)
    with contextlib.closing(done):  # at once, whatever keeps the traceback
        for k, result in _in_turn(done) if ordered else done:
            yield k, result()


def require_scheduler(scheduler) -> None:
    """A ValueError unless it is one that `run` knows."""
    if scheduler not in (None, "processes") and not (isinstance(scheduler, str) and "://" in scheduler):
        remedy = "give None, 'processes', or an address such as 'tcp://host:8786'"
        raise ValueError(f"scheduler is {scheduler!r}; {remedy}.")


def _in_turn(done):
    early, turn = {}, 0
    for k, result in done:
        early[k] = result
        while turn in early:
            yield turn, early.pop(turn)
            turn += 1


def _dask(work, jobs, shared, address, alike):
    """As `run_locally`; the scheduler gives the jobs of a lost worker to another one."""
    with extra("cluster", "a scheduler"):
        import dask
        from distributed import Client

    _require_answer(address)
    with _hushed(), dask.config.set(_LARGE), Client(address, timeout=_PATIENCE, set_as_default=False) as client:
        required = alike()
        _require_alike(client, address, alike, required)
        # As a task: what was scattered would be lost with the one worker that holds it, a task is done again.
        together = client.submit(tuple, shared, pure=False)
        finished, waiting, suspects = queue.SimpleQueue(), {}, []

        def submit(k):
            future = client.submit(_task, work, together, jobs[k], alike, required, pure=False, retries=_ATTEMPTS)
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
            problem = f"scheduler {address!r} cannot be reached within {_PATIENCE:g} s"
            raise SchedulerError(f"{problem}; start one (docs/scale.md), or give another address.") from error


@contextlib.contextmanager
def _hushed():
    """A client that loses its scheduler logs a traceback; here one sentence says it."""
    logger = logging.getLogger("distributed.client")
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = False


def _task(work, shared, job, alike, required):
    """What a worker of Dask does. It may have come after all were compared."""
    from distributed import get_worker

    _compare(get_worker().address, alike(), required)
    return work(*shared, *job)


def _next(finished, client, address):
    """Key of the next future that is done."""
    silent = True
    while True:
        try:
            return finished.get(timeout=_LOOK)
        except queue.Empty:
            if silent and not client.scheduler_info().get("workers"):
                silent = False
                sentence = f"scheduler {address!r} has no worker any more: waiting for one (docs/scale.md)."
                print(sentence, file=sys.stderr)


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
        remedy = "start it again (docs/scale.md), and then this"
        raise SchedulerError(f"scheduler {address!r} went away; {remedy}.") from error


def _require_alike(client, address, alike, required):
    """A worker at all, and on each of them what is ``required``."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except (OSError, TimeoutError) as error:
        raise SchedulerError(f"scheduler {address!r} has no worker; start some (docs/scale.md).") from error
    for worker, theirs in client.run(alike, on_error="return").items():
        if not isinstance(theirs, dict):
            problem = f"worker {worker} cannot import tras ({theirs})"
            raise SchedulerError(f"{problem}; install environment.txt and this package there.")
        _compare(worker, theirs, required)


def _compare(worker, theirs, required):
    for name, value in required.items():
        if theirs.get(name) != value:
            problem = f"worker {worker} has {name} {theirs.get(name)} but {value} is needed"
            raise SchedulerError(f"{problem}; install environment.txt there.")
