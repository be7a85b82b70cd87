"""Every point of a grid, once: read from a folder or computed, here or in processes, and stored as soon as it is there.

Killed or interrupted, the same call of `compute` goes on where it was. `each` does jobs of which nothing is stored.
"""

import contextlib
import os
import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

from tras.workflow import cache, executors


def compute(
    work, points, shared=(), *, keys=None, folder=None, kind="point", code="", cost=None, keep=None, if_lost=None,
    title="compute", unit=" points", progress=None, processes=None, **where,
):  # fmt: skip
    """The values of all points.

    Parameters
    ----------
    work : callable
        ``work(*shared, point)`` is the value of a point: anything that JSON holds, and NaN, which becomes None.
    points : list
        Options of each point, or a group of them that is computed together.
    shared : tuple or callable
        Arguments that all points have in common; a callable makes them from the list of missing points, if any.
    keys : list of dict, optional
        All that each value depends on beside the code, as JSON holds it; default ``points``.
    folder : path, optional
        Where values are stored, in files ``kind-HASH.json``, by one run of a ``kind`` at a time; default: nowhere.
    kind, code : str
        What the values are, and the digest of the code that computes them (`tras.workflow.cache.code_digest`).
    cost : callable, optional
        Of a point: the dearest are begun first, so that no process is left with a long one at the end.
    keep : callable, optional
        Of a value: whether it goes into the folder; default: yes.
    if_lost : callable, optional
        Of the reason: the value of a point whose every worker died; without it an error.
    title, unit : str
        What is done, a verb, and to what, for the progress bar and for the message when interrupted.
    progress : bool or text stream, optional
        Where a progress bar goes; False: nowhere; default: to a terminal.
    processes : int, optional
        Number of local processes, 1 being this process; default one per core.
    **where
        In place of local processes: ``scheduler`` and ``alike`` of `tras.workflow.executors.run`.

    Returns
    -------
    values : list
        In the order of the points.
    counts : dict
        ``computed, cached``: how many points were computed now, and how many an earlier run had kept.

    Raises
    ------
    tras.workflow.executors.SchedulerError
        If a point is lost, or as `tras.workflow.executors.run`. What ``work`` raises is raised here. What was computed
        until then is stored.
    KeyboardInterrupt
        With a sentence that says how much is done.
    """
    keys = points if keys is None else keys
    if folder is None:
        values = [None] * len(points)
    else:
        cache.clear_temporaries(folder, kind)
        paths = [cache.path_for(folder, kind, key, code) for key in keys]
        values = [cache.read(path, key) for path, key in zip(paths, keys)]
    missing = [k for k, value in enumerate(values) if value is None]
    if cost is not None:
        missing.sort(key=lambda k: cost(points[k]), reverse=True)
    if missing and callable(shared):
        shared = shared([points[k] for k in missing])
    counts = {"computed": len(missing), "cached": len(points) - len(missing)}
    ready = counts["cached"]
    try:
        with _bar(progress, bool(missing), total=len(points), initial=ready, desc=title, unit=unit) as bar:
            jobs = [(points[k],) for k in missing]
            for number, value in _results(work, jobs, shared, title, processes, if_lost, **where):
                k = missing[number]
                storable = folder is not None and (keep is None or keep(value))
                values[k] = cache.write(paths[k], keys[k], value) if storable else cache.plain(value)
                ready += 1
                bar.update()
    except KeyboardInterrupt:
        fate = f"kept in {folder}: {title} again to go on" if folder is not None else "lost: give a cache to keep them"
        raise KeyboardInterrupt(f"interrupted; {ready} of {len(points)}{unit} are done and {fate}.") from None
    return values, counts


def each(work, jobs, shared=(), *, cost=None, title=None, processes=1, progress=None):
    """``work(*shared, *job)`` for each job: a list, in order. Nothing is kept in a folder.

    ``cost(*job)`` and the rest as for `compute`. Without a title there is no bar.
    """
    jobs = list(jobs)
    results, order = [None] * len(jobs), range(len(jobs))
    if cost is not None:
        order = sorted(order, key=lambda k: cost(*jobs[k]), reverse=True)
    with _bar(progress, title is not None, total=len(jobs), desc=title, leave=False) as bar:
        for number, result in _results(work, [jobs[k] for k in order], shared, title or work.__name__, processes):
            results[order[number]] = result
            bar.update()
    return results


def require_known(study: Any, **choices: Iterable[str]) -> None:
    """A ValueError unless each option of a study, a sequence of names, holds none but these.

    >>> from types import SimpleNamespace
    >>> require_known(SimpleNamespace(methods=["DMDc", "magic"]), methods=["DMDc", "NARX"])
    Traceback (most recent call last):
    ValueError: methods holds 'magic'; choose among DMDc, NARX.
    """
    for option, known in choices.items():
        for name in getattr(study, option):
            if name not in known:
                raise ValueError(f"{option} holds {name!r}; choose among {', '.join(known)}.")


def terminal():
    """A context with the terminal behind a notebook's kernel, for a bar outside the notebook, or with None."""
    number = getattr(sys.stderr, "_original_stdstream_copy", None)  # where ipykernel keeps it
    if number is not None and os.isatty(number):
        return os.fdopen(os.dup(number), "w")
    return contextlib.nullcontext(sys.stderr if sys.stderr.isatty() else None)


def _results(work, jobs, shared, title, processes, if_lost=None, **where):
    """(number, result) of each job, as they are done."""
    where = {"scheduler": None if processes == 1 else "processes"} | where
    with contextlib.closing(executors.run(work, jobs, shared, processes=processes, **where)) as results:
        for number, result in results:
            if isinstance(result, executors.Lost):
                if if_lost is None:
                    raise executors.SchedulerError(
                        f"a job of {title!r} was lost: {result.reason}; use fewer processes."
                    )
                result = if_lost(result.reason)
            yield number, result


def _bar(progress, needed, **options):
    stream = progress if hasattr(progress, "write") else None
    disable = True if progress is False or not needed else None if progress is None else False
    return tqdm(file=stream, disable=disable, **options)
