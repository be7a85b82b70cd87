"""What the readers of MATLAB's files make of values that are not plain, and what becomes of these."""

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Unread:
    """It stands where a file has a value that is not read: ``what`` it is, and of an object the class ``kind``.

    ``content`` is what stands in its place in the file: complex numbers, the number of an object.
    """

    what: str
    kind: str = ""
    content: object = None


class Instance(dict):
    """The fields of an object of the class ``kind``, as a struct has them: nothing of the class is executed."""

    def __init__(self, kind: str, fields: dict):
        super().__init__(fields)
        self.kind = kind


# Class -> the lines of MATLAB that save its numbers plainly; {0} is the variable.
_PLAIN = {
    "timeseries": ("time = {0}.Time; data = squeeze({0}.Data);", "save('plain.mat', 'time', 'data', '-v7')"),
    "timetable": ("rows = timetable2table({0}); rows.(1) = seconds(rows.(1) - rows.(1)(1));",
                  "writetable(rows, 'plain.csv')"),
    "table": ("writetable({0}, 'plain.csv')",),
    "tscollection": ("time = {0}.Time; names = gettimeseriesnames({0}); data = {0}.(names{{1}}).Data;",
                     "save('plain.mat', 'time', 'data', '-v7')"),
    "Simulink.SimulationData.Dataset": ("signal = {0}{{1}}.Values; time = signal.Time; data = squeeze(signal.Data);",
                                        "save('plain.mat', 'time', 'data', '-v7')"),
    "Simulink.SimulationOutput": (
        "signal = {0}.yout{{1}}.Values; time = signal.Time; data = squeeze(signal.Data);",
        "save('plain.mat', 'time', 'data', '-v7')",
    ),
    "iddata": ("u = {0}.InputData; y = {0}.OutputData; Ts = {0}.Ts;", "save('plain.mat', 'u', 'y', 'Ts', '-v7')"),
    "idfrd": ("% {0} is a frequency response: save the recording that it was made from.",),
}  # fmt: skip
_PLAIN["Simulink.Timeseries"] = _PLAIN["timeseries"]
_ADVICE = {"complex numbers": "save real and imaginary part", "a sparse matrix": "save full(...)"}
_MOST = 5  # values that a sentence lists


def readable(value, path: str, unread: list):
    """The dict or list ``value`` without what is `Unread`, which goes to ``unread`` as pairs (path, Unread).

    A cell array with such a cell is left out as a whole, so that trials stay side by side.
    """
    if isinstance(value, Instance) and value.kind != "iddata" and not {"time", "data"} <= set(map(str.lower, value)):
        unread.append((path, Unread(f"an object ({value.kind[:60]})", value.kind[:60])))
        return None
    if isinstance(value, dict):
        fields = {}
        for key, inner in value.items():
            place = f"{path}.{key}" if path else key
            if isinstance(inner, (dict, list, Unread)):
                inner = readable(inner, place, unread)
            if inner is not None:
                fields[key] = inner
        return Instance(value.kind, fields) if isinstance(value, Instance) else fields
    if isinstance(value, list):
        for i, inner in enumerate(value):
            if isinstance(inner, Unread):
                unread.append((f"{path}{{{i + 1}}}", inner))
                return None
        cells = [
            readable(inner, f"{path}{{{i + 1}}}", unread) if isinstance(inner, (dict, list)) else inner
            for i, inner in enumerate(value)
        ]
        return None if any(cell is None for cell in cells) else cells
    unread.append((path, value))
    return None


def left_out(unread: list) -> list[str]:
    """One remark on all values that were not read, or none."""
    if not unread:
        return []
    items = [f"{path[:100]} ({value.what})" for path, value in unread[:_MOST]]
    more = f" and {len(unread) - _MOST} more" if len(unread) > _MOST else ""
    advice = sorted({_ADVICE[value.what] for _, value in unread if value.what in _ADVICE})
    return [f"left out: {', '.join(items)}{more}" + (f"; to have them, {' and '.join(advice)}" if advice else "")]


def how_to_save(unread: list) -> str:
    """Lines of MATLAB that save the numbers of the first object plainly; "" where nothing is known."""
    for path, value in unread:
        if value.kind in _PLAIN:
            name = path if re.fullmatch(r"[A-Za-z]\w{0,62}(\.[A-Za-z]\w{0,62}){0,3}", path, re.ASCII) else "x"
            lines = (line.format(name) for line in _PLAIN[value.kind])
            return "".join(["\nIn MATLAB, for example:", *(f"\n    {line}" for line in lines)])
    return ""
