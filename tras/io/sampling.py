"""From columns to trajectories: trials, the sampling time, missing values, resampling when asked."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tras.io.roles import RecordingError, seconds
from tras.workflow import arguments

TOLERANCE = 0.01  # of the sampling time: how far a step may be from it


@np.errstate(over="ignore", invalid="ignore")  # damaged times may overflow; the result is refused
def trajectories(tables, roles, locate, *, resample=None, missing="cut", tolerance=TOLERANCE):
    """States, inputs and sampling time of a recording, and remarks on changes and constant channels.

    Parameters
    ----------
    tables : list of dict
        One per trial of the file: name -> (rows,) floats; the column of trials may hold text.
    roles : tras.io.roles.Roles
    locate : callable
        (table, row) -> where that is in the file, as text.
    resample, missing, tolerance
        See `tras.Recording.read`.

    Returns
    -------
    states, inputs : list of (samples, n) and (samples, m) arrays
    dt : float
        In s.
    remarks : list of str
    numbers : list of int
        Of each trajectory, the table that it comes from.

    Raises
    ------
    RecordingError
        When time goes backwards, stands still or is uneven, when a trial begins twice, or when nothing is left.
    """
    if missing not in ("cut", "refuse"):
        raise RecordingError(f"missing is {missing!r}; give 'cut' or 'refuse'.")
    for name, value in (("resample", resample), ("tolerance", tolerance)):
        if value is not None:
            arguments.number(name, value, 0, ends=False, give="a positive number", error=RecordingError)
    numerator, denominator = (1, 1) if roles.time is None else seconds(roles.time, roles.units.get(roles.time))
    pieces, remarks = [], []
    for number, table in enumerate(tables):
        for start, end in _trials(table, roles, functools.partial(locate, number)):
            rows = slice(start, end)
            x = np.column_stack([table[name][rows] for name in roles.states])
            u = np.column_stack([table[name][rows] for name in roles.inputs] or [np.empty((end - start, 0))])
            t = None if roles.time is None else table[roles.time][rows] * numerator / denominator
            pieces.append((t, x, u, _Place(locate, number, start)))
    pieces = _cut(pieces, roles, missing, remarks)
    if roles.time is None:
        if resample is not None:
            raise RecordingError("resample needs a column of time; there is none.")
        dt = float(roles.dt)
    else:
        for t, _, _, where in pieces:
            _check_order(t, where, roles)
        dt = float(resample) if resample is not None else _sampling_time(pieces, roles, tolerance)
        if resample is not None:
            pieces = _resampled(pieces, dt, remarks)
    _, states, inputs, places = zip(*pieces)
    remarks += _constant(states, roles.states) + _constant(inputs, roles.inputs)
    return list(states), list(inputs), dt, remarks, [place.table for place in places]


class _Place(NamedTuple):
    """Where a piece begins: row ``start`` of a table of the file; called with a row of the piece, it says where."""

    locate: Callable
    table: int
    start: int

    def __call__(self, row):
        return self.locate(self.table, self.start + row)

    def after(self, rows):
        return self._replace(start=self.start + rows)


def _trials(table, roles, where):
    """(first row, end) of every trial: where its column changes or, if that is the column of time, decreases."""
    rows = len(table[roles.states[0]])
    if rows == 0:
        return []
    if roles.trial is None:
        return [(0, rows)]
    label = np.asarray(table[roles.trial])
    if roles.trial == roles.time:
        starts = np.flatnonzero(np.diff(label) < 0) + 1
    else:
        unknown = np.flatnonzero(label != label) if label.dtype.kind == "f" else np.flatnonzero(label == "")
        if unknown.size:
            raise RecordingError(f"{where(unknown[0])}: the trial's column {roles.trial!r} is empty; fill every row.")
        starts = np.flatnonzero(label[1:] != label[:-1]) + 1
        begins = np.array([0, *starts])
        again = np.setdiff1d(begins, begins[np.unique(label[begins], return_index=True)[1]])
        if again.size:
            raise RecordingError(
                f"{where(again[0])}: trial {label[again[0]]} of column {roles.trial!r} begins a second time; "
                "sort the rows by trial and time."
            )
    return list(zip([0, *starts.tolist()], [*starts.tolist(), rows]))


def _cut(pieces, roles, missing, remarks):
    """The pieces between rows in which a value is missing."""
    complete, places, count, short = [], [], 0, 0
    names = [*roles.states, *roles.inputs, roles.time]
    for t, x, u, where in pieces:
        table = np.hstack([x, u]) if t is None else np.hstack([x, u, t[:, None]])
        bad = ~np.isfinite(table)
        gaps = np.flatnonzero(bad.any(axis=1))
        if not gaps.size:
            complete.append((t, x, u, where))
            continue
        count += len(gaps)
        places += [f"{names[np.argmax(bad[row])]} at {where(row)}" for row in gaps[:3]]
        for start, end in zip([0, *(gaps + 1)], [*gaps, len(x)]):
            if end - start >= 2:
                t_piece = None if t is None else t[start:end]
                complete.append((t_piece, x[start:end], u[start:end], where.after(int(start))))
            elif end > start:
                short += 1
    if places:
        report = f"values are missing (empty, NaN or infinite) in {count} rows, the first: {'; '.join(places[:3])}"
        if missing == "refuse":
            raise RecordingError(f"{report}; repair them, or read with missing='cut'.")
        single = f", and left out {short} single samples between" if short else ""
        remarks.append(f"{report}; cut the trajectories there: {len(complete)} are left{single}")
    if not complete:
        why = "no two rows in succession are complete; nothing is left" if places else "it has no rows of numbers"
        raise RecordingError(f"{why}.")
    return complete


def _check_order(t, where, roles):
    steps = np.diff(t)
    if np.any(steps < 0):
        row = int(np.argmax(steps < 0)) + 1
        raise RecordingError(
            f"{where(row)}: time goes backwards in column {roles.time!r}, from {t[row - 1]:g} to {t[row]:g} s; "
            f"sort the rows, name the trial's column, or give `trial: {roles.time}` if a new trial begins there."
        )
    if np.any(steps == 0):
        row = int(np.argmax(steps == 0)) + 1
        raise RecordingError(
            f"{where(row)}: the time {t[row]:g} s in column {roles.time!r} stands there twice "
            f"({np.sum(steps == 0)} rows repeat one); keep one row of each."
        )


def _sampling_time(pieces, roles, tolerance):
    """The step that all samples share within the tolerance."""
    steps = np.concatenate([np.diff(t) for t, *_ in pieces])
    if not steps.size:
        if roles.dt is None:
            raise RecordingError("every trajectory has one sample, so there is no sampling time; give dt, in s.")
        return float(roles.dt)
    longest = max((t for t, *_ in pieces), key=len)
    dt = float(roles.dt) if roles.dt is not None else float(np.median(steps))
    if not 0 < dt < np.inf:
        raise RecordingError(f"the median step of column {roles.time!r} is {dt} s, which is no sampling time.")
    grain = 4 * np.spacing(max(np.abs(t).max() for t, *_ in pieces))  # far from zero, the time stamps are rounded
    limit = tolerance * dt + grain
    uneven = np.abs(steps - dt) > limit
    if uneven.any():
        first = next(
            where(row + 1) for t, *_, where in pieces for row in np.flatnonzero(np.abs(np.diff(t) - dt) > limit)
        )
        reference = "the given dt" if roles.dt is not None else "the median"
        raise RecordingError(
            f"time is uneven in column {roles.time!r}: {uneven.sum()} of {len(steps)} steps differ from {reference}, "
            f"{dt:.6g} s, by more than {100 * tolerance:g} %, the first at {first}; "
            f"they are between {steps.min():.6g} and {steps.max():.6g} s. "
            f"Read with resample={_round(float(np.median(steps)), 3):g} (linear for states, held for inputs), "
            "or a larger tolerance."
        )
    return dt if roles.dt is not None else _plain_step(longest)


def _plain_step(t):
    """The step with the fewest digits that explains even times: 0.01 where they say 0.0099999999."""
    k, mean = np.arange(len(t)), (t[-1] - t[0]) / (len(t) - 1)

    def worst(step):
        return np.abs(t - t[0] - k * step).max()

    limit = 1.5 * worst(mean) + 4 * np.spacing(np.abs(t).max())
    rounded = [_round(mean, digits) for digits in range(1, 16)]
    return float(next((step for step in rounded if worst(step) <= limit), mean))


def _round(value, digits):
    return float(f"{value:.{digits - 1}e}")


def _resampled(pieces, dt, remarks):
    """Every piece on an even grid of its own: linear for states, the last value held for inputs."""
    new, widest = [], 0.0
    for t, x, u, where in pieces:
        since = t - t[0]
        count = since[-1] / dt
        if not count < 1e8:
            raise RecordingError(f"resample={dt:g} makes more than 1e8 samples; give a longer step.")
        grid = np.arange(int(np.floor(count * (1 + 1e-12) + 1e-9)) + 1) * dt
        before = np.clip(np.searchsorted(since, grid * (1 + 1e-12), side="right") - 1, 0, None)
        states = np.column_stack([np.interp(grid, since, column) for column in x.T])
        new.append((grid, states, u[before], where))
        widest = max(widest, float(np.diff(t).max(initial=0.0)))
    remarks.append(
        f"resampled at {dt:g} s: linear for states, the last value held for inputs; "
        f"the widest gap bridged is {widest:.4g} s"
    )
    return new


def _constant(arrays, names):
    table = np.concatenate(arrays)
    constant = (table == table[0]).all(axis=0) & (len(table) > 1)
    return [f"{name} is constant ({table[0, i]:g})" for i, name in enumerate(names) if constant[i]]
