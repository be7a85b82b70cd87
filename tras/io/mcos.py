"""The numbers of MATLAB's newer objects (timetable, table, timeseries), from the part of a file that holds them all.

An object's variable holds its number only. Its properties stand in one cell array, and a table of whole numbers says
which cell is which property of which object. That is data: no class is looked up and nothing of one is executed. The
layout is not published; this follows the description in the docs of the Python package mat-io. What does not fit it
stays `Unread`.
"""

from dataclasses import replace

import numpy as np

from tras.io.limits import MAX_DEPTH, MAX_PARTS, MAX_VALUES
from tras.io.workspace import Instance, Unread

_OBJECT = 0xDD000000  # the first number of a reference to objects
_TAIL = {2: 1, 3: 2, 4: 3}  # version -> cells behind the properties, which describe the classes
_READ = ("timetable", "table", "timeseries")


class LayoutError(ValueError):
    """The numbers of an object do not stand where they should."""


_DAMAGE = (LayoutError, KeyError, IndexError, TypeError, AttributeError, ValueError, OverflowError)


def resolved(variables: dict, store) -> dict:
    """``variables`` with structs of numbers in place of the objects that can be read.

    ``store`` are the cells of the file's part for objects, or None.
    """
    try:
        objects = _Objects(store)
    except _DAMAGE:
        return variables
    return _resolved(variables, objects)


def _resolved(value, objects):
    if isinstance(value, dict):
        fields = {key: _resolved(inner, objects) for key, inner in value.items()}
        return Instance(value.kind, fields) if isinstance(value, Instance) else fields
    if isinstance(value, list):
        return [_resolved(inner, objects) for inner in value]
    if not isinstance(value, Unread):
        return value
    if value.kind in _READ and value.content is not None:
        try:
            return objects.numbers(value.content)
        except _DAMAGE:
            pass
    return replace(value, content=None)


class _Objects:
    """The properties of all objects of a file, each read once."""

    def __init__(self, store):
        if not (isinstance(store, list) and store and isinstance(store[0], np.ndarray)):
            raise LayoutError
        content = store[0].astype(np.uint8).tobytes(order="F")
        words = np.frombuffer(content[: len(content) // 4 * 4], "<u4")
        self.version, starts = int(words[0]), [int(start) for start in words[2:8]]
        if self.version not in _TAIL or starts != sorted(starts) or starts[-1] > len(content) or starts[0] < 40:
            raise LayoutError
        self.names = content[40 : starts[0]].decode("ascii").split("\0")[: int(words[1])]
        regions = [words[start // 4 : end // 4] for start, end in zip(starts, starts[1:])]
        self.classes, self.saved, self.records, self.plain = regions[0], regions[1], regions[2], regions[3]
        self.properties = store[2 : -_TAIL[self.version]]
        self.instances, self.tables, self.rows = {}, {}, 0
        self.starts = {id(region): [0] for region in (self.saved, self.plain)}

    def numbers(self, reference):
        """The struct of numbers of the object that a reference means."""
        instance = self.referred(reference, 0)
        if id(instance) not in self.tables:
            self.tables[id(instance)] = _numbers(instance)
            self.rows += max(np.size(value) for value in self.tables[id(instance)].values())
            if self.rows > MAX_VALUES:
                raise LayoutError
        return self.tables[id(instance)]

    def name(self, number):
        if not 1 <= number <= len(self.names):
            raise LayoutError
        return self.names[number - 1]

    def referred(self, reference, depth):
        """The object that a reference means, an `Instance`."""
        numbers = [int(number) for number in reference.ravel()[:64]]
        dimensions = numbers[1]
        if (
            not 2 <= dimensions <= 32
            or numbers[0] != _OBJECT
            or numbers[2 : 2 + dimensions] != [1] * dimensions
            or depth > MAX_DEPTH
        ):
            raise LayoutError
        number = numbers[2 + dimensions]
        if number in self.instances:
            if self.instances[number] is None:
                raise LayoutError  # it holds itself
            return self.instances[number]
        self.instances[number] = None
        if len(self.instances) > MAX_PARTS:
            raise LayoutError
        kind, _, _, saved, plain, _ = (int(word) for word in self.records[6 * number : 6 * number + 6])
        if number < 1 or kind != numbers[3 + dimensions]:
            raise LayoutError
        region, record = (self.saved, saved) if saved else (self.plain, plain)
        namespace, title = (int(word) for word in self.classes[4 * kind : 4 * kind + 2])
        title = f"{self.name(namespace)}.{self.name(title)}" if namespace else self.name(title)
        fields = {}
        for name, form, value in self.entries(region, record):
            if form == 1:
                fields[self.name(name)] = self.value(self.properties[value], depth + 1)
        self.instances[number] = Instance(title, fields)
        return self.instances[number]

    def entries(self, region, record):
        """The (name, form, value) of the properties of one record: a count, that many triples, an even length."""
        starts = self.starts[id(region)]
        while len(starts) <= record:
            start = starts[-1] + 1 + 3 * int(region[starts[-1]])
            starts.append(start + start % 2)
        start = starts[record]
        count = int(region[start])
        triples = region[start + 1 : start + 1 + 3 * count]
        if len(triples) != 3 * count:
            raise LayoutError
        return triples.reshape(count, 3).tolist()

    def value(self, value, depth):
        """A property, the objects that it refers to in their places."""
        if isinstance(value, dict):
            return {key: self.value(inner, depth) for key, inner in value.items()}
        if isinstance(value, list):
            return [self.value(inner, depth) for inner in value]
        if isinstance(value, Unread) and isinstance(value.content, np.ndarray):
            value = value.content
        is_reference = isinstance(value, np.ndarray) and value.size >= 6 and value.ravel()[0] == _OBJECT
        return self.referred(value, depth) if is_reference and value.shape == (value.size, 1) else value


def _numbers(instance):
    """A struct of plain numbers: name -> array, with ``time`` in s; of a timeseries ``time`` and ``data``."""
    if instance.kind == "timeseries":
        return _timeseries(instance)
    if instance.kind == "table":
        return _variables(instance["data"], instance["varnames"])
    content = instance["any"]
    original = content["varNamesOrig"] if np.any(content.get("useVarNamesOrig", 0)) else content["varNames"]
    rows = int(content["numRows"].item())
    if {len(value) for value in content["data"] if isinstance(value, np.ndarray)} != {rows}:
        raise LayoutError  # before room is made for so many times
    time = _seconds(content["rowTimes"], rows)
    if time.size != rows:
        raise LayoutError
    return {"time": time.reshape(-1, 1), **_variables(content["data"], original)}


def _variables(data, names):
    if len(data) != len(names) or not all(isinstance(name, str) for name in names):
        raise LayoutError
    return {name: value if isinstance(value, np.ndarray) else _unread(value) for name, value in zip(names, data)}


def _unread(value):
    kind = value.kind if isinstance(value, Instance) else ""
    return Unread(f"an object ({kind})" if kind else "no numbers", kind)


def _seconds(times, rows):
    """Times of rows in s: of dates, of durations, or of a first one and a step or rate."""
    if not isinstance(times, Instance):
        origin = times["origin"]
        first = 0.0 if origin.kind == "datetime" else _seconds(origin, 1).item()
        if np.any(times["specifiedAsRate"]):
            if not times["sampleRate"].item() > 0:
                raise LayoutError
            return first + np.arange(rows) / times["sampleRate"].item()
        return first + np.arange(rows) * _seconds(times["stepSize"], 1).item()
    if times.kind == "duration":
        return times["millis"].ravel() / 1000
    if times.kind != "datetime":
        raise LayoutError
    date = times["data"].ravel()  # in ms since 1970, its imaginary part what a float cannot hold beside it
    with np.errstate(invalid="ignore"):
        return ((date.real - date.real[0]) + (date.imag - date.imag[0])) / 1000


def _timeseries(fields):
    """Its data and its time, which newer releases hold as start and step if it is even."""
    arrays = [fields.get(key) for key in ("Data_", "Data")]
    data = next((array for array in arrays if isinstance(array, np.ndarray) and array.size), np.empty(0))
    info = fields.get("TimeInfo", {})
    times = (place.get(key) for place in (fields, info) for key in ("Time_", "Time"))
    time = next((time for time in times if isinstance(time, np.ndarray) and time.size), None)
    if time is None:
        start, step, count = (info[key].item() for key in ("Start", "Increment", "Length"))
        if not (np.isfinite(start) and step > 0 and count in data.shape):
            raise LayoutError
        time = start + step * np.arange(int(count))
    if time.size not in data.shape:
        raise LayoutError
    return {"Time": time.reshape(-1, 1), "Data": data}
