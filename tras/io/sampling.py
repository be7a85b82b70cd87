"""From columns to trajectories: trials, the sampling time, missing values, resampling when asked."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tras.io import clock
from tras.io.roles import RecordingError
from tras.workflow import arguments

TOLERANCE = 0.2  # of the sampling time: how far a stamp may be from the even grid
_STRICT, _FEW = 0.01, 10  # the same for fewer stamps than that, which show no grid
_SAID = 0.001  # of the sampling time: from here on the distance is said


class Wishes(NamedTuple):
    """What a user may ask of the samples; see `tras.Recording.read`."""

    resample: float | None = None
    missing: str = "cut"
    tolerance: float = TOLERANCE
    start: float | None = None
    end: float | None = None
    decimate: int = 1

    def check(self):
        if self.missing not in ("cut", "refuse"):
            raise RecordingError(f"missing is {self.missing!r}; give 'cut' or 'refuse'.")
        for name in ("resample", "tolerance", "end"):
            if getattr(self, name) is not None:
                give = "a positive number"
                arguments.number(name, getattr(self, name), 0, ends=False, give=give, error=RecordingError)
        if self.start is not None:
            arguments.number("start", self.start, 0, give="a number of seconds, 0 or more", error=RecordingError)
            if self.end is not None and self.end <= self.start:
                raise RecordingError(f"end is {self.end:g} s but start is {self.start:g} s; give a later end.")
        arguments.whole_number("decimate", self.decimate, error=RecordingError)


AS_IT_IS = Wishes()


class _Place(NamedTuple):
    """Where a piece begins: row ``start`` of a table of the file; called with a row of the piece, it says where."""

    locate: Callable
    table: int
    start: int
    trial: int

    def __call__(self, row):
        return self.locate(self.table, self.start + int(row))

    def after(self, rows):
        return self._replace(start=self.start + int(rows))


@np.errstate(over="ignore", invalid="ignore")  # damaged times may overflow; the result is refused
def trajectories(tables, roles, locate, *, wishes=AS_IT_IS):
    """States, inputs and sampling time of a recording, and remarks on changes and constant channels.

    Parameters
    ----------
    tables : list of dict
        One per trial of the file: name -> (rows,) floats; the column of trials may hold text.
    roles : tras.io.roles.Roles
        Its ``dt``, if there is one, is the sampling time, whatever the stamps say. Stamps must agree with ``stated``.
    locate : callable
        (table, row) -> where that is in the file, as text.
    wishes : Wishes

    Returns
    -------
    states, inputs : list of (samples, n) and (samples, m) arrays
    dt : float
        In s.
    remarks : list of str
    numbers : list of (int, int)
        Of each trajectory, the table and the trial that it comes from, from 0.

    Raises
    ------
    RecordingError
        When time goes backwards, stands still or is uneven, when a trial begins twice, or when nothing is left.
    """
    wishes.check()
    pieces, remarks = _pieces(tables, roles, locate, wishes), []
    pieces = _cut(pieces, roles, wishes.missing, remarks)
    if roles.time is None:
        if wishes.resample is not None:
            raise RecordingError("resample needs a column of time; there is none.")
        step = float(roles.dt)
    else:
        for t, _, _, where in pieces:
            _check_order(t, where, roles)
        step = wishes.resample or _sampling_time(pieces, roles, wishes.tolerance, remarks)
        if wishes.resample is not None:
            pieces = _resampled(pieces, step, remarks)
    if wishes.decimate > 1:
        pieces, step = _decimated(pieces, wishes.decimate, remarks), step * wishes.decimate
    _, states, inputs, places = zip(*pieces)
    remarks += _constant(states, roles.states) + _constant(inputs, roles.inputs) + _odd_ends(pieces, roles, step)
    return list(states), list(inputs), float(step), remarks, [(place.table, place.trial) for place in places]


def _pieces(tables, roles, locate, wishes):
    """(time in s or None, states, inputs, place) of every trial, from ``start`` to ``end``."""
    numerator, denominator = (1, 1) if roles.time is None else clock.seconds(roles.time, roles.units.get(roles.time))
    pieces = []
    for number, table in enumerate(tables):
        for first, end in _trials(table, roles, functools.partial(locate, number)):
            rows = slice(first, end)
            x = np.column_stack([table[name][rows] for name in roles.states])
            u = np.column_stack([table[name][rows] for name in roles.inputs] or [np.empty((end - first, 0))])
            t = None if roles.time is None else table[roles.time][rows] * numerator / denominator
            place = _Place(locate, number, first, len(pieces))
            pieces.append(_between(t, x, u, place, roles.dt, wishes))
    if wishes.start is None and wishes.end is None:
        return pieces
    if not any(len(x) for _, x, _, _ in pieces):
        raise RecordingError("nothing lies between start and end, in s since the first sample of each trial.")
    return [piece for piece in pieces if len(piece[1])]


def _between(t, x, u, place, dt, wishes):
    """The part of a trial from ``start`` to ``end``, in s since its first sample."""
    if wishes.start is None and wishes.end is None:
        return t, x, u, place
    since = np.arange(len(x)) * dt if t is None else t - (t[0] if len(t) else 0)
    slack = 1e-9 * max(wishes.start or 0, wishes.end or 0)
    low, high = (wishes.start or 0) - slack, np.inf if wishes.end is None else wishes.end + slack
    rows = np.flatnonzero((since >= low) & (since <= high))
    part = slice(rows[0], rows[-1] + 1) if rows.size else slice(0, 0)
    return None if t is None else t[part], x[part], u[part], place.after(rows[0] if rows.size else 0)


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
        if all(part is None or np.isfinite(part).all() for part in (t, x, u)):
            complete.append((t, x, u, where))
            continue
        table = np.hstack([x, u]) if t is None else np.hstack([x, u, t[:, None]])
        bad = ~np.isfinite(table)
        gaps = np.flatnonzero(bad.any(axis=1))
        count += len(gaps)
        places += [f"{names[np.argmax(bad[row])]} at {where(row)}" for row in gaps[:3]]
        for start, end in zip([0, *(gaps + 1)], [*gaps, len(x)]):
            if end - start >= 2:
                stamps = None if t is None else t[start:end]
                complete.append((stamps, x[start:end], u[start:end], where.after(start)))
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


def _sampling_time(pieces, roles, tolerance, remarks):
    """The step of the even grid on which the stamps stand within the tolerance, or the one that was given."""
    times = [t for t, *_ in pieces]
    count = sum(len(t) - 1 for t in times)
    if not count:
        if roles.dt is None and roles.stated is None:
            raise RecordingError("every trajectory has one sample, so there is no sampling time; give dt, in s.")
        return float(roles.dt or roles.stated)
    step, deviation, quantum = clock.grid(times)
    if roles.dt is not None:
        if not abs(step - roles.dt) <= _STRICT * roles.dt:
            remarks.append(f"the sampling time is {roles.dt:g} s, as given; column {roles.time} says {step:.6g} s")
        return float(roles.dt)
    if not 0 < step < np.inf:
        raise RecordingError(f"the mean step of column {roles.time!r} is {step} s, which is no sampling time.")
    if roles.stated is not None and abs(step - roles.stated) > _STRICT * roles.stated:
        raise RecordingError(
            f"the file states a sampling time of {roles.stated:g} s, but column {roles.time!r} says {step:.6g} s; "
            "give dt."
        )
    grain = 4 * np.spacing(max(max(abs(t[0]), abs(t[-1])) for t in times))  # far from zero, stamps are rounded
    limit = (tolerance if count >= _FEW else min(tolerance, _STRICT)) * step + grain
    rounded = False
    if deviation > limit:
        steps = np.concatenate([np.diff(t) for t in times])
        rounded = count >= _FEW and clock.is_rounded(steps, step, deviation, quantum)
        if not rounded:
            _check_repeats(pieces, roles)
            raise RecordingError(_uneven(pieces, roles, steps, deviation, limit))
    elif 2 * deviation >= step:
        _check_repeats(pieces, roles)
    if deviation > _SAID * step + grain:
        rounded = rounded or clock.is_rounded(np.concatenate([np.diff(t) for t in times]), step, deviation, quantum)
        why = f", because they are rounded to {quantum:g} s" if rounded else ""
        remarks.append(
            f"the stamps of {roles.time} lie up to {deviation:.3g} s ({100 * deviation / step:.3g} %) off an even grid "
            f"of {step:.6g} s{why}; taken as even"
        )
    return step


def _check_repeats(pieces, roles):
    for t, _, _, where in pieces:
        steps = np.diff(t)
        if np.any(steps == 0):
            row = int(np.argmax(steps == 0)) + 1
            raise RecordingError(
                f"{where(row)}: the time {t[row]:g} s in column {roles.time!r} stands there twice "
                f"({np.sum(steps == 0)} rows repeat one); keep one row of each."
            )


def _uneven(pieces, roles, steps, deviation, limit):
    """The sentence about stamps that lie off the grid."""
    median = float(np.median(steps))
    far = np.abs(steps - median) > limit
    cure = (
        f"Read with resample={float(f'{median:.2e}'):g} (linear for states, held for inputs), with dt if the stamps "
        "are wrong, or with a larger tolerance."
    )
    if not far.any():
        return (
            f"time is uneven in column {roles.time!r}: its stamps lie up to {deviation:.3g} s off an even grid, the "
            f"limit is {limit:.3g} s. {cure}"
        )
    first = next(
        where(row + 1) for t, *_, where in pieces for row in np.flatnonzero(np.abs(np.diff(t) - median) > limit)
    )
    return (
        f"time is uneven in column {roles.time!r}: {far.sum()} of {len(steps)} steps differ from the median, "
        f"{median:.6g} s, by more than {100 * limit / median:.3g} %, the first at {first}; "
        f"they are between {steps.min():.6g} and {steps.max():.6g} s. {cure}"
    )


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
    first = arrays[0][0]
    moving = np.zeros(len(names), dtype=bool)
    for array in arrays:
        moving |= (array[:100] != first).any(axis=0)  # enough for most
        for i in np.flatnonzero(~moving):
            moving[i] = (array[:, i] != first[i]).any()
    alone = sum(map(len, arrays)) < 2
    return [f"{name} is constant ({first[i]:g})" for i, name in enumerate(names) if not moving[i] and not alone]


def _decimated(pieces, factor, remarks):
    """Every ``factor``-th sample; of inputs the mean over the samples that are left out, which does the same work."""
    new = []
    for t, x, u, where in pieces:
        count = len(x) // factor
        if count:
            held = u[: count * factor].reshape(count, factor, -1).mean(axis=1)
            new.append((None if t is None else t[: count * factor : factor], x[: count * factor : factor], held, where))
    if not new:
        raise RecordingError(f"decimate is {factor}, more than a trajectory has samples; give less.")
    remarks.append(f"of every {factor} samples of the states the first is kept, of the inputs the mean")
    return new


def _odd_ends(pieces, roles, dt):
    """Sentences on a first sample far from the others, and on rests in which nothing moves."""
    remarks, names = [], [*roles.states, *roles.inputs]
    for _, x, u, where in pieces[:20]:
        if len(x) < 20:
            continue
        table = np.hstack([x[:200], u[:200]])
        steps = np.abs(np.diff(table, axis=0))
        far = steps[0] > np.maximum(10 * steps[1:].max(axis=0), np.ptp(table[1:], axis=0))
        remarks += [
            f"the first sample of {names[i]}, {table[0, i]:g} at {where(0)}, lies far from the next, {table[1, i]:g}"
            for i in np.flatnonzero(far)
        ]
        for moment, ordered in (("first", (x, u)), ("last", (x[::-1], u[::-1]))):
            count = _at_rest(*ordered)
            if max(10, len(x) // 20) <= count < len(x):
                cure = "start= or end= leave it out"
                remarks.append(f"nothing moves in the {moment} {count * dt:.3g} s ({count} samples; {cure})")
    return remarks[:6]


def _at_rest(x, u):
    """The number of rows at the beginning that are the same."""
    length = 64
    while True:
        moves = (x[:length] != x[0]).any(axis=1) | (u[:length] != u[0]).any(axis=1)
        if moves.any():
            return int(np.argmax(moves))
        if length >= len(x):
            return len(x)
        length *= 8
