"""Several files as one recording: trials with the same columns, signals merged by time, files for the test."""

import os

import numpy as np

from tras.io import clock
from tras.io.limits import Source
from tras.io.roles import RecordingError, Roles, guess_role, named, unknown_column


def joined(paths: list, sources: list) -> Source:
    """One `Source` of several files: their trials one after the other, or their signals beside each other."""
    first = sources[0]
    if all(set(source.names) == set(first.names) for source in sources):
        return _trials(paths, sources)
    wide = [other for other in sources if len(other.names) > 2]
    twice = [name for name in first.names if guess_role(name) != "time" and any(name in s.names for s in wide[1:])]
    if twice or any(source.header for source in sources):
        raise RecordingError(f"{_differing(paths, sources)}; give files of the same columns, or of one signal each.")
    return _signals(paths, sources)


def with_test(paths: list, source: Source, test_paths: list, tests: list) -> Source:
    """The `Source` with the trials of ``tests`` behind its own, marked as the test set."""
    for path, test in zip(test_paths, tests):
        if not set(source.names) <= set(test.names):
            raise RecordingError(f"{_differing([paths[0], path], [source, test])}; the test needs the same columns.")
    own, others = _count(source), _trials(test_paths, tests)

    def locate(table, row):
        return source.locate(table, row) if table < own else others.locate(table - own, row)

    return source._replace(
        read=lambda roles: [*source.read(roles), *others.read(roles)],
        locate=locate,
        test=[*source.test, *range(own, own + sum(map(_count, tests)))],
        remarks=[*source.remarks, f"the test is {', '.join(path.name for path in test_paths)}"],
    )


def side_by_side(source: Source, spec: dict) -> tuple[Source, dict]:
    """The `Source` and roles in which a channel "z1;z2;z3" is one whose trials are these columns.

    Channels without a semicolon are the same in all trials.
    """
    columns = {}
    for label in (*spec.get("states", ()), *spec.get("inputs", ())):
        if ";" in label and label not in source.names:
            columns[label] = [named(part.strip(), source.names) for part in label.split(";") if part.strip()]
    if not columns:
        return source, spec
    counts = {label: len(parts) for label, parts in columns.items()}
    if len(set(counts.values())) > 1 or min(counts.values()) < 2:
        listing = ", ".join(f"{label} {count}" for label, count in counts.items())
        raise RecordingError(f"roles: experiments side by side need as many columns in each channel: {listing}.")
    for name in (part for parts in columns.values() for part in parts):
        if name not in source.names:
            raise unknown_column(name, source.names)
    count, labels = next(iter(counts.values())), {}
    for label, parts in columns.items():
        stem = os.path.commonprefix(parts).rstrip("0123456789_. ") or parts[0]
        labels[label] = stem if stem not in (*source.names, *labels.values()) else parts[0]
    parts = {labels[label]: names for label, names in columns.items()}

    def read(roles):
        tables = []
        for k in range(count):
            actual = {name: names[k] for name, names in parts.items()}
            renamed = [[actual.get(name, name) for name in names] for names in (roles.states, roles.inputs)]
            asked = roles._replace(states=renamed[0], inputs=renamed[1], time=actual.get(roles.time, roles.time))
            for table in source.read(asked):
                tables.append({**table, **{name: table[column] for name, column in actual.items() if column in table}})
        return tables

    others = [name for name in source.names if not any(name in names for names in parts.values())]
    units = source.units | {name: source.units.get(names[0], "") for name, names in parts.items()}
    own = len(read(Roles(None, list(parts)[:1], [], None, None, {}))) // count
    new = source._replace(
        names=[*others, *parts], units=units, read=read, header=None, test=(), roles={},
        locate=lambda table, row: f"{source.locate(table % own, row)}, experiment {table // own + 1}",
        remarks=[*source.remarks, f"{count} experiments stand side by side"],
    )  # fmt: skip
    return new, spec | {
        key: [labels.get(name, name) for name in spec[key]] for key in ("states", "inputs") if key in spec
    }


def _trials(paths, sources):
    first = sources[0]
    for path, source in zip(paths, sources):
        for label in ("units", "dt"):
            if getattr(source, label) != getattr(first, label):
                raise RecordingError(f"{path.name} has other {label} than {paths[0].name}; make them alike.")
    remarks = [f"{path.name}: {remark}" for path, source in zip(paths, sources) for remark in source.remarks]
    return first._replace(
        read=lambda roles: [table for path, source in zip(paths, sources) for table in _read(path, source, roles)],
        locate=_locator(paths, sources), remarks=[f"{len(paths)} files are trials of one recording", *remarks], test=(),
    )  # fmt: skip


def _read(path, source, roles):
    """The tables of a file; an error names it."""
    try:
        return source.read(roles)
    except RecordingError as error:
        raise RecordingError(f"{path.name}, {error}") from error


def _locator(paths, sources):
    """(table, row) -> place with the name of the file."""
    owners = []

    def locate(table, row):
        if not owners:
            owners.extend((path, source, k) for path, source in zip(paths, sources) for k in range(_count(source)))
        path, source, number = owners[table]
        return f"{path.name}, {source.locate(number, row)}"

    return locate


def _count(source):
    """The number of a file's trials."""
    return len(source.read(Roles(source.names[0], [], [], None, None, {})))


def _differing(paths, sources):
    lists = [f"{path.name} has {', '.join(source.names[:8])}" for path, source in zip(paths, sources)]
    return "the files have different columns: " + "; ".join(lists[:4])


def _signals(paths, sources):
    """Files with a time and signals of their own, merged by time."""
    times, signals, units = [], {}, {"time": "s"}
    for number, (path, source) in enumerate(zip(paths, sources)):
        time = _time_of(source)
        if time is None:
            what = f"{_differing(paths, sources)}; files of one signal each need a column of time, {path.name} has none"
            raise RecordingError(f"{what}. Give files of the same columns, or add one.")
        tables = source.read(Roles(time, [], [], None, None, {}))
        if len(tables) > 1:
            raise RecordingError(f"{path.name} holds {len(tables)} trials; signals of several files need one each.")
        times.append(_seconds(source, time, tables[0][time], path))
        others = [name for name in source.names if name != time]
        for name in others:
            plain = name not in signals and not any(name in other.names for other in sources if other is not source)
            label = name if plain else path.stem if len(others) == 1 else f"{path.stem}.{name}"
            signals[label] = (number, name)
            units |= {label: source.units[name]} if name in source.units else {}
    remarks = [f"{len(paths)} files hold signals of one recording, merged by time"]

    def read(roles):
        wanted = [name for name in (*roles.states, *roles.inputs, roles.time) if name in signals]
        start, end = max(t[0] for t in times), min(t[-1] for t in times)
        base = times[signals[wanted[0]][0] if wanted else 0]
        slack = 1e-6 * np.median(np.diff(base))
        base = base[(base >= start - slack) & (base <= end + slack)]
        if len(base) < 2:
            raise RecordingError(
                "the files have no time in common; see whether their clocks begin at the same instant."
            )
        table = {"time": base}
        for name in wanted:
            number, column = signals[name]
            values = sources[number].read(Roles(None, [column], [], None, None, {}))[0][column]
            table[name] = _at(base, times[number], values, held=name in roles.inputs)
        return [table]

    return Source(["time", *signals], units, read, lambda _, row: f"row {row + 1} of the merged table", remarks=remarks)


def _at(instants, time, values, *, held):
    """A signal at other instants: the last value for inputs, linear between samples for states."""
    if len(time) == len(instants) and np.array_equal(time, instants):
        return values
    if held:
        slack = 1e-6 * np.median(np.diff(time))
        return values[np.clip(np.searchsorted(time, instants + slack, side="right") - 1, 0, None)]
    return np.interp(instants, time, values)


def _time_of(source):
    """The column of time of a file with few columns: by name, else the first that rises evenly."""
    named = [name for name in source.names if guess_role(name) == "time"]
    for name in named or source.names:
        try:
            values = source.read(Roles(name, [], [], None, None, {}))[0][name]
        except RecordingError:
            continue
        if named or clock.rises_evenly(values):
            return name
    return None


def _seconds(source, time, values, path):
    unit = source.units.get(time) or clock.guess_unit(values)[0]
    factor = clock.seconds(time, unit)
    if factor is None or not (np.diff(values) > 0).all():
        raise RecordingError(f"the time of {path.name}, column {time!r}, does not rise at every row; repair it.")
    return values * factor[0] / factor[1]
