"""From the variables of a MATLAB workspace to tables: which axis is time, whose time it is, what is the test set."""

import collections
import hashlib
import re
from typing import NamedTuple

import numpy as np

from tras.io import roles
from tras.io.iddata import is_iddata
from tras.io.limits import check_size
from tras.io.roles import RecordingError

_TIME = "time"
# uEst, y_train, id.u | uVal, y_test, validation; after a letter that stands for a signal also utrain, yval.
_FIT = r"train(?:ing)?|est(?:im(?:ation)?)?|id(?:ent(?:ification)?)?|learn(?:ing)?"
_TEST = r"val(?:id(?:ation)?)?|test(?:ing)?|verif(?:ication)?"
_PART = re.compile(
    rf"(?:|(?P<stem1>.*?)_|(?P<stem2>[uyxzt]\d?)|(?P<stem3>.*[a-z0-9])(?=[A-Z]))(?P<word1>(?i:{_FIT}|{_TEST}))"
    rf"|(?P<word2>(?i:{_FIT}|{_TEST}))(?:_(?P<stem4>.+)|(?P<stem5>[A-Z].*))"
)
_LONGEST_NAME = 1000  # letters
_AGREE = 0.01  # of the shortest step: how far two stamps of the same instant may be apart


def parts(content: dict) -> tuple[list, list[str]]:
    """The content for the fit and that for the test, each as (dict, is it the test), and remarks.

    They are told apart by the names of variables, when each kind has the same: ``train``, ``val``; ``uEst, yEst, uVal,
    yVal``; ``y_train, y_test``. The other variables belong to both.

    Examples
    --------
    >>> parts({"uEst": 1, "uVal": 2, "note": 3})[0]
    [({'note': 3, 'u': 1}, False), ({'note': 3, 'u': 2}, True)]
    >>> parts({"u": 1, "interval": 2})[0]
    [({'u': 1, 'interval': 2}, False)]
    """
    split = {False: {}, True: {}}
    for key, value in content.items():
        match = _PART.fullmatch(key)
        if match:
            stem = next((match[group] for group in match.groupdict() if group[:4] == "stem" and match[group]), "")
            word = match["word1"] or match["word2"]
            split[bool(re.fullmatch(_TEST, word, re.IGNORECASE))].setdefault(stem, (key, value))
    sides = list(split.values())
    if not sides[0] or set(sides[0]) != set(sides[1]):
        return [(content, False)], []
    taken = {key for side in sides for key, _ in side.values()}
    shared = {key: value for key, value in content.items() if key not in taken}
    new = []
    for is_test, side in split.items():
        part = dict(shared)
        for stem, (_, value) in side.items():
            if not stem and isinstance(value, dict) and not is_iddata(value):
                part |= value
            else:
                part[stem or "data"] = value
        new.append((part, is_test))
    listing = [", ".join(key for key, _ in side.values()) for side in sides]
    return new, [f"{listing[0]} are for the fit, {listing[1]} are the test set"]


class Table(NamedTuple):
    """A trial: name -> (number of its time, column), and the times; the column ``time`` has the number None."""

    channels: dict
    times: list
    owners: list  # of the times: the variable that has it
    rows: int

    @property
    def names(self):
        return ([_TIME] if self.times else []) + list(self.channels)

    def read(self, wanted: "roles.Roles", remarks: list) -> dict:
        """Name -> column of those with a role; of several times the instants that all of these columns have."""
        names = [name for name in (*wanted.states, *wanted.inputs, wanted.trial, wanted.time) if name in self.channels]
        if not self.times:
            return {name: self.channels[name][1] for name in names}
        needed = sorted({self.channels[name][0] for name in names}) or [0]
        rows = {number: slice(None) for number in needed}
        if len(needed) > 1:
            rows = self._common(needed, remarks)
        table = {_TIME: self.times[needed[0]][rows[needed[0]]]}
        return table | {name: self.channels[name][1][rows[self.channels[name][0]]] for name in names}

    def _common(self, needed, remarks):
        """Number of a time -> the rows of the instants that all have."""
        times = [self.times[number] for number in needed]
        steps = [np.diff(time) for time in times]
        for number, step in zip(needed, steps):
            if not (step > 0).all():
                raise RecordingError(f"the time of {self.owners[number]!r} does not rise at every row; repair it.")
        limit = _AGREE * min(step.min(initial=np.inf) for step in steps)
        rows = np.arange(len(times[0]))
        for time in times[1:]:
            nearest = _nearest(time, times[0][rows])
            rows = rows[np.abs(time[nearest] - times[0][rows]) <= limit]
        owners = [self.owners[number] for number in needed]
        if 2 * len(rows) < min(map(len, times)):
            raise RecordingError(
                f"{', '.join(map(repr, owners))} have other times than each other: {len(rows)} instants are common; "
                "resample them to the same times, or choose columns of one of them."
            )
        counts = [
            f"{len(time) - len(rows)} of {owner!r}" for owner, time in zip(owners, times) if len(time) > len(rows)
        ]
        dropped = f"; rows left out: {', '.join(counts)}" if counts else ""
        remark = f"signals with times of their own are joined at the {len(rows)} instants that all have{dropped}"
        remarks += [] if remark in remarks else [remark]  # tables are read more than once
        return {number: _nearest(time, times[0][rows]) for number, time in zip(needed, times)}


def _nearest(time, instants):
    """Rows of a rising ``time`` that are nearest to the instants."""
    after = np.clip(np.searchsorted(time, instants), 1, max(len(time) - 1, 1))
    if len(time) == 1:
        return np.zeros(len(instants), dtype=int)
    return np.where(instants - time[after - 1] <= time[after] - instants, after - 1, after)


def tables(trials: list[dict], remarks: list) -> list[Table]:
    """One `Table` per trial, all turned as the first one; ``remarks`` gets what was left out."""
    tables, odd, widths = [], {}, {}
    for trial in trials:
        entries = []
        _collect(trial, "", None, "", entries)
        table, widths = _table(_short(entries, odd), widths, odd)
        tables.append(table)
    remarks += [f"left out: {name}, {why}" for name, why in sorted(odd.items())]
    return tables


def _table(entries, widths, odd):
    """The table of arrays with a name, a time or None, and its owner; and name -> channels of each matrix."""
    times, owners, numbers = [], [], {}
    own = {id(time): time for _, _, time, _ in entries if time is not None}
    own = {key: _digest(time) for key, time in own.items()}  # each once, however many arrays have it
    for _, _, time, owner in entries:
        if time is not None and numbers.setdefault(own[id(time)], len(times)) == len(times):
            times.append(time)
            owners.append(owner)
    by_size = {time.size: number for number, time in reversed(list(enumerate(times)))}
    count = None if times else _samples({name: array for name, array, *_ in entries if array.ndim == 2}, widths)
    channels, widths, rows = {}, dict(widths), count or 0
    for name, array, time, _ in entries:
        if len(name) > _LONGEST_NAME:
            raise RecordingError(f"a signal has a name of {len(name)} letters; up to {_LONGEST_NAME} are read.")
        if times and time is None and array.size in array.shape and roles.guess_role(name) == "time":
            if _digest(array.ravel()) not in numbers:
                odd[name] = "signals beside it have times of their own"
            continue
        if times:
            of_size = (by_size[size] for size in array.shape if size in by_size)
            number = next(of_size, None) if time is None else numbers[own[id(time)]]
            count = None if number is None else times[number].size
            rows = max(rows, count or 0)
        else:
            number = None
        matrix = _matrix(array, count) if count else None
        if matrix is None:
            size = " x ".join(map(str, array.shape))
            flat = array.ndim == 2
            odd[name] = "of another length than the rest" if flat else f"of the size {size}: save a matrix per trial"
            continue
        check_size(len(matrix), matrix.shape[1])
        widths.setdefault(name, matrix.shape[1])
        mark = "_" if name[-1:].isdigit() else ""
        keys = [name] if matrix.shape[1] == 1 else [f"{name}{mark}{i + 1}" for i in range(matrix.shape[1])]
        for key, column in zip(keys, matrix.T):
            if key in channels or (times and key == _TIME):  # "time" is the column that the times are joined in
                raise RecordingError(f"two signals would be called {key!r}; rename one.")
            channels[key] = (number, column)
    return Table(channels, times, owners, rows), widths


def _matrix(array, count):
    """(count, channels), or None: an array with samples along its last axis, as Simulink logs, has them there."""
    if array.ndim == 2:
        return array if array.shape[0] == count else array.T if array.shape[1] == count else None
    return array.reshape(-1, count, order="F").T if array.shape[-1] == count else None


def _samples(arrays, widths):
    """How many samples matrices have: the length of the time, or the length that most of the numbers share.

    Small matrices beside the signals (gains, covariances) must not decide, and a single vector is no recording.
    """
    sizes, totals = {}, {}
    for name, array in arrays.items():
        width = widths.get(name)
        if width is not None and width in array.shape:
            return array.shape[0] if array.shape[1] == width else array.shape[1]  # as in the first trial
        length, width = max(array.shape), min(array.shape)
        if length > 1:
            sizes[length] = sizes.get(length, 0) + width
            totals[length] = totals.get(length, 0) + array.size
    for name, array in arrays.items():
        if array.size in sizes and roles.guess_role(name.rpartition(".")[2]) == "time" and sizes[array.size] > 1:
            return array.size
    several = [length for length, channels in sizes.items() if channels > 1] or list(sizes)
    return max(several, key=lambda length: (totals[length], length), default=None)


def is_signal(value) -> bool:
    """Whether a dict is one signal with its time."""
    return isinstance(value, dict) and {"time", "data"} <= {key.lower() for key in value}


def is_logged(value) -> bool:
    """Whether a dict is Simulink's "structure with time"."""
    return isinstance(value, dict) and "time" in value and isinstance(value.get("signals"), (list, dict))


def _collect(content, prefix, time, owner, entries):
    """Add (name, array, its time or None, whose time it is) of all arrays in a dict and the dicts within."""
    own = _own_time(content, prefix)
    if own is not None:
        time, owner = content[own].ravel(), prefix.rstrip(".") or own
    for key, inner in content.items():
        if key == own:
            continue
        if is_signal(inner):
            fields = {name.lower(): each for name, each in inner.items()}
            instants = _array(fields["time"], key).ravel()
            entries.append((f"{prefix}{key}", _array(fields["data"], key), instants, f"{prefix}{key}"))
        elif key == "signals" and is_logged(content):
            for i, signal in enumerate([inner] if isinstance(inner, dict) else inner):
                label = signal.get("label") if isinstance(signal, dict) else None
                values = _array(signal.get("values") if isinstance(signal, dict) else None, key)
                label = label.strip() if isinstance(label, str) else ""
                entries.append((_Label(prefix, label, i + 1), values, time, owner))
        elif isinstance(inner, dict) and not is_iddata(inner):
            _collect(inner, f"{prefix}{key}.", time, owner, entries)
        elif isinstance(inner, np.ndarray) and inner.size > 1:
            entries.append((f"{prefix}{key}", inner, time, owner))


class _Label(NamedTuple):
    """The name of a signal in one of Simulink's scopes: the scope's prefix, its label or "", and its number."""

    prefix: str
    label: str
    number: int


def _short(entries, odd):
    """The entries with names: a label as it is if one signal has it, else with its scope; the same signal once."""
    plain = {name for name, *_ in entries if not isinstance(name, _Label)}
    whole, cut, kept = {}, {}, []
    for name, array, time, owner in entries:
        if isinstance(name, _Label):
            full, *ends = _prints(name.label, array, time)
            other = whole.get(full) or cut.get(full) or next((whole[end] for end in ends if end in whole), None)
            if other:
                odd[_long(name)[:_LONGEST_NAME]] = f"the same as {_long(other)[:_LONGEST_NAME]}"
                continue
            whole[full] = name
            cut |= dict.fromkeys(ends, name)
        kept.append((name, array, time, owner))
    counts = collections.Counter(name.label for name, *_ in kept if isinstance(name, _Label))
    for i, (name, *signal) in enumerate(kept):
        if isinstance(name, _Label):
            is_alone = name.label and counts[name.label] == 1 and name.label not in plain
            kept[i] = (name.label if is_alone else _long(name), *signal)
    return kept


def _prints(label, array, time):
    """Digests of a logged signal: as it is, without its first and without its last sample, which scopes may lack."""
    if time is None or array.ndim != 2 or len(array) != len(time):
        return (_digest(array, label),)
    ends = (slice(None), slice(1, None), slice(None, -1))
    return tuple(_digest(np.column_stack([time[rows], array[rows]]), label) for rows in ends)


def _digest(array, label=""):
    total = hashlib.blake2b(f"{array.shape}{label}".encode("utf-8", "replace"))
    total.update(np.ascontiguousarray(array))
    return total.digest()


def _long(name):
    return f"{name.prefix}{name.label or f'signals{name.number}'}"


def _own_time(content, prefix):
    """The key of the time of a struct's arrays: a scope's, or the only field that is called so."""
    vectors = [key for key, value in content.items() if isinstance(value, np.ndarray) and value.size > 1]
    vectors = [key for key in vectors if max(content[key].shape) == content[key].size]
    if is_logged(content):
        return _TIME if _TIME in vectors else None
    if not prefix:
        return None
    names = [key for key in vectors if roles.guess_role(key) == "time"]
    return names[0] if len(names) == 1 else None


def _array(value, owner):
    if not isinstance(value, np.ndarray):
        raise RecordingError(f"{owner!r} should hold numbers but holds {type(value).__name__}.")
    return value
