"""Many fits: every point of a grid, on local processes or a Dask cluster, each result kept as soon as it is there."""

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from tras.dictionaries.kinds import KINDS
from tras.io.formats import checksum
from tras.model import KoopmanModel
from tras.recording import Recording
from tras.sweeps import point as sweep_point
from tras.sweeps.grid import points as points_of
from tras.sweeps.point import Data, File
from tras.workflow import arguments, executors
from tras.workflow import cache as results_cache
from tras.workflow.provenance import versions
from tras.workflow.study import compute

_RESULTS = {"functions": "Int64", "pairs": "Int64", "condition": float, "strength_used": float, "error": float}
# Files are read by the workers.
Recorded = Recording | str | Path | Sequence[Recording | str | Path]
_COUNTS = {"windows": "Int64", "diverged": "Int64"}


def sweep(
    recording: Recorded, grid: dict | KoopmanModel | Sequence[dict | KoopmanModel], *,
    held_out: Recorded | None = None, window: float | None = None, train_fraction: float = 0.8,
    states: list[str] | None = None, inputs: list[str] | None = None, scheduler: str | None = "processes",
    processes: int | None = None, cache: str | Path | None = None, progress: bool | None = None,
) -> pd.DataFrame:  # fmt: skip
    """Fit every model of a grid, and judge each by roll-outs of windows that none was fitted to.

    Parameters
    ----------
    recording : Recording, path, or a list of these
        Files are read by the workers, which need to see them under the same path; recordings are sent.
    grid : dict, KoopmanModel, or a list of these
        Option -> value or list of values; every combination is a fit. Options are the parameters of `KoopmanModel` and

        - ``seconds``: length of the training data, the beginning of all (default None: all);
        - ``every``: keep every so many samples, 2 halves the rate; inputs are averaged between them (default 1);
        - ``split_seed``: which windows are held out (default 0), without ``held_out``.
    held_out : like ``recording``, optional
        What to judge by. The recording is then not cut, and NetCDF files larger than memory are read in pieces.
        Default: the recording is cut into windows, and those not in ``train_fraction`` are held out.
    window : float, optional
        Length of a roll-out in s; default 500 samples.
    train_fraction : float
    states, inputs : list of str, optional
        Channels to use; default all.
    scheduler : {None, "processes"} or str
        Where it runs: this process, local processes, or the workers of the Dask scheduler at an address such as
        "tcp://host:8786". The table is the same, to the last bit if processor and libraries are.
    processes : int, optional
        Number of local processes; default one per core.
    cache : path, optional
        Folder, of one sweep at a time, that keeps each result under the hash of its options, the data and the code.
        What is there is not computed again.
    progress : bool, optional
        Show a progress bar. Default: in a terminal.

    Returns
    -------
    pandas.DataFrame
        One row per fit, in the order of the grid: the options; ``functions`` (N), ``pairs, condition, strength_used``;
        ``error`` (root mean square of the roll-outs in half-ranges of the states, a sample counts 10 at most);
        ``nrmse_STATE`` in percent over the windows that did not diverge; ``windows, diverged`` (counts); ``outcome``
        ("model", or why there is none); ``best`` (True for the least error); ``model`` (`KoopmanModel`, unfitted).

    Raises
    ------
    ValueError
        If the grid or the data are not as above, or a worker cannot read a file; as
        `tras.workflow.executors.SchedulerError` if the scheduler cannot be reached or a worker has other versions or
        other code. What was computed until then is in the cache.

    Examples
    --------
    >>> import tras
    >>> log = tras.simulate_closed_loop(tras.multisine(40, 0.01, [1.0, 2.0], [0.8, 2.0], 0), 0.01)
    >>> grid = {"dictionary": [tras.Monomials(1), tras.Mechanical(4)], "strength": [0.0], "seconds": [10, 30]}
    >>> table = sweep(log, grid, inputs=["u_phi", "u_psi"], window=2.0, scheduler=None)
    >>> table[["dictionary", "seconds", "functions", "best"]]
                 dictionary  seconds  functions   best
    0   Monomials(degree=1)       10          7  False
    1   Monomials(degree=1)       30          7  False
    2  Mechanical(degree=4)       10         45  False
    3  Mechanical(degree=4)       30         45   True
    """
    executors.require_scheduler(scheduler)
    points = points_of(grid)
    if held_out is not None and any(point.split_seed for point in points):
        raise ValueError("grid varies split_seed, but held_out is given, so nothing is split; leave one of them out.")
    data, names = _data(recording, held_out, states, inputs, window, train_fraction, points)
    latest = max(point.model.delays for point in points)
    keys = None if cache is None else _keys(points, data, latest)
    try:
        values, _ = compute(
            sweep_point.evaluate, points, (data, latest), keys=keys, folder=cache, kind="fit",
            code=results_cache.code_digest("tras.sweeps.point"), keep=_is_lasting,
            if_lost=lambda reason: {"outcome": f"no result: {reason}"}, title="sweep", unit=" fits", progress=progress,
            scheduler=scheduler, processes=processes, alike=same_code,
        )  # fmt: skip
    finally:
        sweep_point.forget()
    return _table(points, values, names)


def same_code() -> dict:
    """What has to be the same on each worker: versions, and the code of this package."""
    return versions() | {"the code of tras in the state": results_cache.code_digest("tras.sweeps.point")}


def _data(recording, held_out, states, inputs, window, fraction, points):
    """The `Data`, tried out for all points, and the names of the states."""
    sources, judged_by = _sources("recording", recording), None if held_out is None else _sources("held_out", held_out)
    if judged_by is None:
        arguments.number("train_fraction", fraction, 0, 1, ends=False)
    if window is None:
        window = 500 * sweep_point.opened(sources[0]).dt
    arguments.number("window", window, 0, ends=False, give="the length of a roll-out in s")
    channels = (None if names is None else tuple(names) for names in (states, inputs))
    data = Data(sources, judged_by, *channels, window, fraction)
    for options in dict.fromkeys((point.seconds, point.every, point.split_seed) for point in points):
        _, judged = sweep_point.prepared(data, *options)
    longest = max(point.model.delays for point in points)
    if judged.states.shape[1] < longest + 2:
        fault = f"has {judged.states.shape[1]} samples, too few for {longest} delays"
        raise ValueError(f"window = {data.window:g} s {fault}; make it longer.")
    return data, judged.state_names


def _sources(name, sources):
    items = sources if isinstance(sources, (list, tuple)) else [sources]
    wrong = [f"holds {type(item).__name__}" for item in items if not isinstance(item, (Recording, str, Path))]
    if wrong or not items:
        fault = wrong[0] if wrong else "is empty"
        raise ValueError(f"{name} {fault}; give a tras.Recording, the path of a file, or a list of these.")
    return tuple(item if isinstance(item, Recording) else sweep_point.file(item) for item in items)


def _keys(points, data, latest):
    """All that each result depends on beside the code, as JSON holds it."""
    foreign = [kind for point in points for kind in _kinds(point.model.dictionary) if kind not in KINDS.values()]
    if foreign:
        fault = f"{foreign[0].__name__} is no dictionary of this package, so a change of its code would go unnoticed"
        raise ValueError(f"cache: {fault}; leave cache out.")
    contents = {name: [_content(item) for item in getattr(data, name) or ()] for name in ("train", "held_out")}
    content = results_cache.plain(data._asdict() | contents)
    return [{"point": point.identity(), "data": content, "latest": latest} for point in points]


def _is_lasting(value):
    """Whether a value is kept: what another worker, or more memory, may do is not."""
    return not value["outcome"].startswith("no result")


def _kinds(dictionary):
    return [type(dictionary), *(kind for part in getattr(dictionary, "parts", ()) for kind in _kinds(part))]


def _content(item):
    if isinstance(item, File):
        return item.digest
    return checksum({"dt": item.dt, "states": item.state_names, "inputs": item.input_names}, item)


def _table(points, values, names):
    errors = [math.inf if value.get("error") is None else value["error"] for value in values]
    least = errors.index(min(errors)) if not math.isinf(min(errors)) else None
    errors_of = [f"nrmse_{name}" for name in names]
    rows, kinds = [], _RESULTS | dict.fromkeys(errors_of, float) | _COUNTS
    for k, (point, value) in enumerate(zip(points, values)):
        nrmse = dict(zip(errors_of, value.get("nrmse") or [None] * len(names)))
        row = point.options() | {name: (value | nrmse).get(name) for name in kinds}
        rows.append({**row, "outcome": value["outcome"], "best": k == least, "model": point.model})
    return pd.DataFrame(rows).astype(kinds)
