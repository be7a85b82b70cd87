"""One fit by many workers: each absorbs a part of the data, and their states are merged in the order of the parts.

The parts do not depend on the workers, and all begin with one basis, which is made here of the first pairs. So one
worker, four, and none give the same bits for the same number of parts, as long as the machines do (processor,
libraries; BLAS is held to one thread). Another number of parts, or none, adds the same rows in another order: it
differs by rounding.

What travels: to a worker, once, the fit without rows (some kilobytes), names of files, datasets as xarray pickles them,
or the recordings themselves; back from it, for each part, the solver's state, about four matrices of the size of K.
"""

import copy
import itertools

from tras.large.slices import without
from tras.solver.least_squares import panels_of_a_basis
from tras.solver.threads import one_blas_thread
from tras.workflow import executors
from tras.workflow.executors import SchedulerError

_PARTS = 16


def absorb(fit, stream, held, length, chunk, scheduler, parts, bar):
    """What `tras.large.streaming` does for one process, by several: the fit then holds all pairs not held out.

    Parameters
    ----------
    scheduler : None, "processes" or str
        None: one part after the other in this process. "processes": local processes, one per core. An address such as
        "tcp://host:8786": the workers of that Dask scheduler, which must see the files under the same paths.
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
    empty = _prepare(fit, stream, groups[0], held, length)
    vars(fit).update(vars(copy.copy(empty)))
    borders = [k * len(groups) // parts for k in range(parts + 1)]
    shares = [groups[a:b] for a, b in itertools.pairwise(borders)]
    jobs, shared = [(share,) for share in shares], (empty, stream, held, length)
    for k, result in executors.run(absorb_part, jobs, shared, scheduler=scheduler, ordered=True):
        if isinstance(result, executors.Lost):
            raise SchedulerError(f"part {k} of {parts} was lost: {result.reason}; use a smaller chunk.")
        with one_blas_thread():
            fit.merge(result)
        bar.update(sum(pairs for _, _, pairs in shares[k]))


def absorb_part(fit, stream, held, length, groups):
    """What one worker does for some chunks: the state of a fit of them."""
    fit = copy.copy(fit)
    with one_blas_thread():
        for first, last, _ in groups:
            fit.absorb(_scaled(fit, stream, first, last, held, length), threads=1)
        fit.solver.work_off()  # rows that wait would travel
    return fit.state()


def _scaled(fit, stream, first, last, held, length):
    """Scaled trajectories of some pieces, without what is held out."""
    pieces = enumerate(stream.pieces(first, last), start=first)
    rest = (part for number, piece in pieces for part in without(piece, held.get(number, ()), length, stream.shared))
    return stream.scaled(rest, fit.channels)


def _chunks(stream, chunk):
    """(first piece, last piece + 1, pairs) of each chunk, as `tras.large.streaming` makes them; nothing is read."""
    groups, first, pairs, number = [], 0, 0, -1
    for number, count in enumerate(stream.counts()):
        pairs += count
        if pairs >= chunk:
            groups.append((first, number + 1, pairs))
            first, pairs = number + 1, 0
    return groups + ([(first, number + 1, pairs)] if number + 1 > first else [])


def _prepare(fit, stream, group, held, length):
    """A fit without rows, with the basis and the hull's axes that one process would make of the first blocks."""
    scaled, first = _scaled(fit, stream, *group[:2], held, length), copy.copy(fit)
    with one_blas_thread():
        first.absorb(scaled, threads=1, most=panels_of_a_basis(len(fit.names)))
        return first.emptied()
