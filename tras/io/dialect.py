"""How a text table is laid out: separator, decimal sign, preamble, names, units, first row; found in its first lines.

Loggers, oscilloscopes and spreadsheets write these in their own ways. `csv.Sniffer` decides by letters alone, and takes
a decimal comma for a separator; here the separator is the one that makes most cells numbers.
"""

import collections
import csv
import datetime
import itertools
import re
from typing import NamedTuple

from tras.io.roles import RecordingError
from tras.io.words import guess_role

WINDOW, _TYPICAL = 200, 60  # lines that are looked at; that tell the separator
MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"}
SEPARATORS = (";", "\t", "|", ",", None)  # None: blanks
WORDS = {";": "';'", "\t": "tabs", "|": "'|'", ",": "','", None: "blanks"}
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*|,\d+)?|[.,]\d+)([eEdD][+-]?\d{1,3})?|[+-]?inf(inity)?", re.IGNORECASE)
_IN_BRACKETS = re.compile(r"(.*?\S)\s*[\[(]([^\[\]()]*)[\])]\s*")
_UNITS = set(
    "s sec second seconds ms us µs ns min h hz khz rpm v volt volts mv a ma ampere rad deg ° degrees rad/s deg/s °/s "
    "1/s m mm cm um m/s mm/s m/s^2 m/s² g n nm n*m n·m mnm w k c °c bar pa kpa kg l/min % - counts".split()
) | {"n m"}
_PADDED = re.compile(r"_*([^,]*?)_*,_*(.*?)_*")  # X-Plane: `Vtrue,_ktas`
_GERMAN = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})([ T].*)?")  # a date with points begins with its day
_MINUTES = re.compile(r"\d{1,3}:\d\d[.,]\d+")
_CLOCK = re.compile(r"(\d{1,3}):(\d\d):(\d\d([.,]\d+)?)")


class Layout(NamedTuple):
    """Where the rows begin (a line, from 0), what separates cells and decimals, and what stands above the rows."""

    separator: str | None
    decimal: str
    start: int
    width: int
    names: list
    named: bool  # or else they are 1, 2, 3 ...
    units: dict
    preamble: list  # rows of cells above the names
    sentence: str
    brackets: bool  # whether rows stand in [ ; ], as MATLAB prints a matrix
    has_blanks: bool  # beside separators


def find(lines: list[str]) -> Layout:
    """The layout of a table that begins with these lines.

    Raises
    ------
    RecordingError
        If there are no rows of numbers, or what stands above them does not fit them.

    Examples
    --------
    >>> layout = find(["Rig 3", "t [s];phi [deg]", "0,00;1,5", "0,01;1,6"])
    >>> layout.separator, layout.decimal, layout.start, layout.names, layout.units
    (';', ',', 2, ['t', 'phi'], {'t': 's', 'phi': 'deg'})
    """
    if not any(line.strip() for line in lines):
        raise RecordingError("it has no rows.")
    hint = next((k for k, line in enumerate(lines[:5]) if re.fullmatch(r"sep=.", line.strip())), None)
    offset = 0 if hint is None else hint + 1  # Excel's own hint stands above the names
    separator = _separator(lines[offset:]) if hint is None else lines[hint].strip()[-1]
    brackets = separator is None and any(line.lstrip().startswith("[") for line in lines)
    rows = cells(lines[offset:], separator, brackets)
    rows = [(offset + line, row) for line, row in rows]
    width, first = _block(rows, separator)
    numbers = [row for _, row in rows[first:] if not is_comment(row)]
    names, units, preamble, named = _above(lines, rows[:first], numbers, width, separator, brackets)
    start = rows[first - 1][0] + 1 if first else offset
    decimal = _decimal(numbers)
    sentence = _sentence(separator, decimal, preamble, named)
    beside = separator is not None and any(f"{separator} " in line or f" {separator}" in line for line in lines[start:])
    return Layout(separator, decimal, start, width, names, named, units, preamble, sentence, brackets, beside)


def cells(lines, separator, brackets=False) -> list:
    """(number of the last line, stripped cells) of every row that is not blank."""
    if separator is None:
        if brackets:
            lines = [re.sub(r"[\[\];]", " ", line) for line in lines]
        return [(k, line.split()) for k, line in enumerate(lines) if line.strip()]
    reader, rows = csv.reader((line + "\n" for line in lines), delimiter=separator), []
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                rows.append((reader.line_num - 1, [cell.strip() for cell in row]))
    except csv.Error:  # a quotation mark that is not closed: the reading of the whole table says where
        pass
    return rows


def is_number(cell: str) -> bool:
    """Whether a stripped cell is a number, with a point or a comma."""
    return _NUMBER.fullmatch(cell) is not None


def is_date(cell: str) -> bool:
    """Whether a stripped cell is an instant: 2026-02-28 12:00:00.010, 28.02.2026 12:00:00, a clock's 12:00:00.010."""
    try:
        return bool(instant(cell))
    except ValueError:
        return False


def instant(cell: str) -> datetime.datetime:
    """The instant in a stripped cell, for a clock on the first day of the year 1; a ValueError if it is none."""
    if german := _GERMAN.fullmatch(cell):
        cell = f"{german[3]}-{german[2]:0>2}-{german[1]:0>2}{(german[4] or '').replace(',', '.')}"
    if _MINUTES.fullmatch(cell):
        cell = f"0:{cell}"
    if clock := _CLOCK.fullmatch(cell):
        seconds = float((clock[3] or "0").replace(",", "."))
        return datetime.datetime.min + datetime.timedelta(hours=int(clock[1]), minutes=int(clock[2]), seconds=seconds)
    return datetime.datetime.fromisoformat(cell)


def is_comment(row) -> bool:
    return row[0][:1] in ("#", "%")


def _separator(lines):
    """The separator that makes the most cells numbers, in rows of equal width."""
    scores = {}
    for separator in SEPARATORS:
        rows = [
            row for _, row in cells(lines[-_TYPICAL:], separator) if not is_comment(row) and any(map(is_number, row))
        ]
        width = _mode(map(len, rows))
        counts = [(sum(map(is_number, row)), sum(map(bool, row))) for row in rows if len(row) == width]
        scores[separator] = sum(number * number / filled for number, filled in counts) if width > 1 else 0
    best = max(SEPARATORS, key=lambda separator: scores[separator])  # of equals the first
    if scores[best]:
        return best
    most = max(SEPARATORS[:-1], key=lines[0].count if lines else len)
    return most if lines and most in lines[0] else ","


def _mode(values):
    return max(collections.Counter(values).items(), key=lambda item: item[1], default=(0, 0))[0]


def _block(rows, separator):
    """(width of the rows of numbers, index of the first): the last stretch of them, of which nothing stands above."""
    kinds = [_kind(row) for _, row in rows]
    width = _mode(len(row) for (_, row), kind in zip(rows, kinds) if kind == "numbers")
    columns = _columns_of_numbers([row for (_, row), kind in zip(rows, kinds) if kind == "numbers"], width)
    if not columns:
        names = next((row for _, row in rows if len(row) > 1), None)
        raise RecordingError(
            "it has a header but no row below it." if names and len(rows) == 1 else "it has no rows of numbers."
        )
    kinds = [
        "comment" if is_comment(row) else _kind([row[i] for i in columns if i < len(row)] or [""]) for _, row in rows
    ]
    last = max(k for k, kind in enumerate(kinds) if kind == "numbers")
    first = last
    while first and kinds[first - 1] in ("numbers", "comment", "empty"):
        first -= 1
    while kinds[first] != "numbers":
        first += 1
    above = [k for k in range(first) if kinds[k] == "numbers" and len(rows[k][1]) == width]
    whole = [k for k in above if all(map(_is_cell_of_numbers, rows[k][1]))]
    if len(whole) > 1:
        line, row = next(rows[k] for k in range(whole[1], first) if kinds[k] == "text")
        what = (separator or " ").join(row)[:60]
        raise RecordingError(f"line {line + 1}: {what!r} stands between rows of numbers; repair it, or cut the file.")
    return width, first


def _kind(row):
    """What a row mostly holds: "numbers", "text", or "empty"."""
    numbers = sum(is_number(cell) or is_date(cell) for cell in row)
    text = sum(not _is_cell_of_numbers(cell) for cell in row)
    return "numbers" if numbers and numbers >= text + (text > 0) else "text" if text or numbers else "empty"


def _is_cell_of_numbers(cell):
    return cell.lower() in MISSING or is_number(cell) or is_date(cell)


def _columns_of_numbers(rows, width):
    """The columns that hold numbers or dates, or nothing, in most rows of that width; all if a single one does not."""
    later = [row for row in rows if len(row) == width][len(rows) // 2 :] or rows
    return [
        i for i in range(width) if sum(_is_cell_of_numbers(row[i]) for row in later if i < len(row)) * 2 > len(later)
    ]


def _above(lines, rows, numbers, width, separator, brackets):
    """Names and units from the rows above the numbers, the rest of these rows, and where the names stood."""
    filled = min(width, max((i + 1 for row in numbers for i, cell in enumerate(row) if cell), default=width))
    header, k = [], len(rows)
    while k and len(header) < 3:
        line, row = rows[k - 1]
        labels = _labels(lines[line], row, width, filled, separator, brackets)
        if labels is None:
            break
        header.insert(0, labels)
        k -= 1
        if is_comment(row):
            break
    if not header and k and not is_comment(rows[k - 1][1]) and len([c for c in rows[k - 1][1] if c]) > 2:
        _refuse_width(rows[k - 1][1], numbers[0], lines, separator, rows)
    preamble = [row for _, row in rows[:k]]
    first = numbers[0]
    if not header and len(numbers) > 2 and _counts(first) and not _counts(numbers[1]):
        raise RecordingError(
            f"its first row is {', '.join(first[:6])}: these are numbers of columns; delete it, or write names there."
        )
    if not header:
        return [str(i + 1) for i in range(width)], {}, preamble, False
    units = {}
    if len(header) > 1 and _is_units(header[-1], header[-2]):
        units = {i: cell.strip("[]() ") for i, cell in enumerate(header.pop()) if cell.strip("[]() -")}
    labels = header.pop()
    if header:  # a name may stand in the row of groups alone
        labels = [label or group for label, group in zip(labels, header[-1])]
    names, bracketed = names_and_units(labels, separator)
    if header and len(set(names)) < len(names):  # the row above groups them
        groups = itertools.accumulate(header.pop(), lambda last, group: group or last)
        names = [f"{group} {name}".strip() for group, name in zip(groups, names)]
    preamble += header
    return names, bracketed | {names[i]: unit for i, unit in units.items() if i < len(names)}, preamble, True


def _labels(line, row, width, filled, separator, brackets):
    """The cells of a line as labels of the columns, or None if they do not fit in number."""
    text = line.strip().lstrip("#%").strip() if is_comment(row) else line
    candidates = [row]
    if is_comment(row):
        candidates = [labels for _, labels in cells([text], separator)] or [[]]
    if separator is None or is_comment(row):
        plain = re.sub(r"[\[\];]", " ", text) if brackets else text
        candidates += [re.split(r"\s{2,}|\t", plain.strip()), text.split()]
        candidates += [re.split(r"\s*[,;\t|]\s*", text.strip())]
    for labels in candidates:
        labels = [label.strip() for label in labels]
        while len(labels) > filled and not labels[-1]:
            labels.pop()
        if filled <= len(labels) <= width and any(labels) and (width > 1 or not is_comment(row)):
            return labels + [""] * (width - len(labels))
    return None


def _refuse_width(row, first, lines, separator, rows):
    """An error if the line of names has not as many cells as the rows."""
    advice = "repair the line, or see whether the file is whole"
    if separator == "," and len(first) >= 2 * len(row) - 1:
        advice = "is the comma the decimal sign too? Export with ';' between cells"
    line = rows[-1][0] + 2
    raise RecordingError(f"line {line}: it has {len(first)} cells but the header has {len(row)}; {advice}.")


def _counts(row):
    """Whether cells are 0, 1, 2 ... or 1, 2, 3 ..."""
    numbers = [int(cell) if cell.isascii() and cell.isdigit() else -9 for cell in row if cell]
    return len(numbers) > 1 and numbers[0] in (0, 1) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def _is_units(row, above):
    """Whether a row of words below another one holds units and not the names."""
    words = [cell.strip("[]() ") for cell in row if cell]
    if not words or any(map(is_number, words)) or not any(cell and not is_number(cell) for cell in above):
        return False
    if all(word.lower() in _UNITS or not word for word in words):
        return True
    roles, roles_above = (sum(bool(guess_role(cell)) for cell in cells) for cells in (row, above))
    return roles_above >= roles and len(set(above)) == len(above)


def names_and_units(labels: list[str], separator: str | None = None) -> tuple[list, dict]:
    """Names, and units from brackets after them (or after a comma, between bars): label -> name, name -> unit."""
    pairs = []
    for label in labels:
        match = _IN_BRACKETS.fullmatch(label)
        if separator == "|" and "," in label and (padded := _PADDED.fullmatch(label)):
            is_time = padded[2] == "time"  # `_real,_time`: the second word is no unit
            pairs.append((f"{padded[1]} time", None) if is_time else (padded[1], padded[2]))
        elif match and not match[2].strip().isdigit():
            pairs.append((match[1].strip(), match[2].strip()))
        else:
            pairs.append((label, None))
    bare, names, units = [name for name, _ in pairs], [], {}
    for i, (label, (name, unit)) in enumerate(zip(labels, pairs)):
        if bare.count(name) > 1:
            name = label if separator != "|" else f"{name} {unit}".strip()
        elif unit is not None:
            units[name] = unit
        names.append(name or f"column {i + 1}")
    return names, units


def _decimal(rows):
    """The decimal sign of these rows: a comma that is none of thousands, "?" if that is open, "." or "" if none."""
    numbers = [cell for row in rows for cell in row if is_number(cell)]
    with_comma = [cell for cell in numbers if "," in cell]
    if not with_comma:
        return "." if any("." in cell for cell in numbers) else ""
    if any(not re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", cell) for cell in with_comma):
        return ","
    return "." if any("." in cell for cell in numbers) else "?"


def _sentence(separator, decimal, preamble, named):
    """What was found, or "" for a plain table of commas and names."""
    parts = [f"{WORDS[separator]} between cells" if separator != "," else ""]
    parts += ["a decimal comma" if decimal == "," else ""]
    parts += [f"{len(preamble)} line{'s' * (len(preamble) > 1)} above the names or rows" if preamble else ""]
    parts += ["no names: columns are 1, 2, 3" if not named else ""]
    return f"a table with {', '.join(filter(None, parts))}" if any(parts) else ""
