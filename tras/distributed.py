"""One fit by many workers: each absorbs a part of the data, and what they found is merged in the order of the parts.

The parts do not depend on the workers, and all of them begin with one basis, which is made here of the first pairs. So one worker, four, and none
give the same bits for the same number of parts, as long as the machines do (processor, libraries; BLAS is held to one thread). Another number of parts, or a fit
without parts, adds the same rows in another order, and differs by rounding.

What travels: to a worker the model without rows (dictionary and scales, some kilobytes), names of files or the recordings themselves; back from it
the solver's state, about four matrices of the size of K.
"""

import copy
import itertools

import numpy as np
from threadpoolctl import threadpool_limits

from tras import koopman
from tras.leastsquares import StreamingLeastSquares
from tras.pieces import without
from tras.recording import versions

_PARTS = 16
_ATTEMPTS = 3  # a part whose worker dies more often than that is given up
_PATIENCE = 5.0  # seconds to wait for a scheduler


class SchedulerError(ValueError):
    """The scheduler cannot be reached, its workers do not fit, or lose every part."""


def absorb(model, stream, held, length, chunk, scheduler=None, parts=None, bar=None):
    """What `tras.streaming` does for one process, by several: the model's solver and hull hold all pairs but the held-out ones afterwards.

    Parameters
    ----------
    scheduler : None, "processes" or str
        None: one part after the other in this process. "processes": local processes, one a core. An address such as "tcp://host:8786": the
        workers of that Dask scheduler, which must see the files under the same paths.
    parts : int, optional
        Parts of the data; default 16, or the number of chunks if there are fewer.

    Raises
    ------
    SchedulerError
        With one sentence, if the scheduler does not answer or a worker has other versions.
    """
    stream = stream.opened()
    groups = _chunks(stream, chunk)
    parts = min(parts or _PARTS, len(groups))
    _prepare(model, stream, groups[0], held, length)
    borders = [k * len(groups) // parts for k in range(parts + 1)]
    empty = copy.deepcopy(model)  # tasks begin with it while what they found is merged here
    tasks = [(empty, stream, groups[a:b], held, length) for a, b in itertools.pairwise(borders)]
    run = {None: _here, "processes": _processes}.get(scheduler) or (lambda tasks: _dask(tasks, scheduler))
    for (_, _, mine, *_), (state, edges) in zip(tasks, run(tasks)):
        if state is not None:
            with _one_thread():
                model._solver.merge(StreamingLeastSquares.from_state(state))
        if edges is not None:
            model.hull_.low, model.hull_.high = np.minimum(model.hull_.low, edges[0]), np.maximum(model.hull_.high, edges[1])
            model.hull_.settle()
        if bar is not None:
            bar.update(sum(pairs for _, _, pairs in mine))


def absorb_part(model, stream, groups, held, length):
    """What one worker does: (state of the solver or None, edges of the hull or None) of some chunks."""
    model = copy.deepcopy(model)
    with _one_thread():
        for first, last, _ in groups:
            model._absorb(_scaled(model, stream, first, last, held, length), threads=1)
        model._solver._work_off(max(model._solver.rows, 1))  # rows that wait would travel
    edges = (model.hull_.low, model.hull_.high) if hasattr(model, "hull_") else None
    return (model._solver.state() if model._solver.rows else None), edges


def _scaled(model, stream, first, last, held, length):
    """Scaled trajectories of some pieces, without what is held out."""
    for number, piece in enumerate(stream.pieces(first, last), start=first):
        left = without(piece, held.get(number, ()), length, stream.shared)
        if left:
            yield from model._scaled(stream.recording(left))


def _chunks(stream, chunk):
    """(first piece, last piece + 1, pairs) of each chunk, as `tras.streaming` makes them; nothing is read."""
    groups, first, pairs, number = [], 0, 0, -1
    for number, count in enumerate(stream.counts()):
        pairs += count
        if pairs >= chunk:
            groups.append((first, number + 1, pairs))
            first, pairs = number + 1, 0
    return groups + ([(first, number + 1, pairs)] if number + 1 > first else [])


def _prepare(model, stream, group, held, length):
    """The basis, and the hull's axes, of the first block of pairs as one process would take it."""
    scaled = _scaled(model, stream, *group[:2], held, length)
    with _one_thread():
        model._absorb(scaled, threads=1, most=1)
        model._solver = model._solver.emptied()


def _one_thread():
    """Sums depend on the number of BLAS threads, and workers have one."""
    return threadpool_limits(1, user_api="blas")


# --------------------------------------------------------------------------------------------------------------- where it runs


def _here(tasks):
    return (absorb_part(*task) for task in tasks)


def _processes(tasks):
    """Local processes. A killed one breaks the pool: what is missing is done by a new one."""
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    done = 0
    for _ in range(_ATTEMPTS):
        try:
            parallel = joblib.Parallel(n_jobs=-1, return_as="generator", pre_dispatch="n_jobs", batch_size=1)
            for result in parallel(joblib.delayed(absorb_part)(*task) for task in tasks[done:]):
                done += 1
                yield result
            return
        except TerminatedWorkerError:
            continue
    raise SchedulerError(f"the local processes were killed {_ATTEMPTS} times (out of memory?); use a smaller chunk, or scheduler=None.")


def _dask(tasks, address):
    """Workers of a Dask scheduler, which gives the tasks of a lost worker to another one."""
    from distributed import Client
    from distributed.scheduler import KilledWorker

    try:
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        raise SchedulerError(f"scheduler {address!r} cannot be reached within {_PATIENCE:g} s; start one (docs/scale.md), or give another address.") from error
    with client:
        _require_same_versions(client, address)
        futures = [client.submit(absorb_part, *task, pure=False, retries=_ATTEMPTS) for task in tasks]
        try:
            for k, future in enumerate(futures):
                yield future.result()
                futures[k] = None  # the scheduler may forget it
        except KilledWorker as error:
            raise SchedulerError(f"scheduler {address!r} lost every worker that was given one part (out of memory?); use a smaller chunk.") from error
        finally:
            client.cancel([future for future in futures if future is not None])


def _require_same_versions(client, address):
    """The same package, NumPy and SciPy on each worker, and a worker at all."""
    mine, found = versions(), {}
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except (OSError, TimeoutError) as error:
        raise SchedulerError(f"scheduler {address!r} has no worker; start some (docs/scale.md).") from error
    found = client.run(_versions_here, on_error="return")
    for worker, theirs in found.items():
        if not isinstance(theirs, dict):
            raise SchedulerError(f"worker {worker} cannot import tras ({theirs}); install environment.txt and this package there.")
        for name, version in mine.items():
            if theirs.get(name) != version:
                raise SchedulerError(f"worker {worker} has {name} {theirs.get(name)} but {version} is needed; install environment.txt there.")


def _versions_here():
    from tras import recording

    return recording.versions()
