"""Text tables (.csv): separators, decimal commas, units and times as loggers and spreadsheets write them.

pandas writes them. It does not read them, because it does not say on which line of the file a wrong cell stands.
"""

import contextlib
import csv
import datetime
import io
import itertools
import json
import re
from pathlib import Path

import numpy as np

from tras.io.limits import FORMAT, MAX_TEXT, Source, check_size
from tras.io.roles import RecordingError

_MARK = f"# {FORMAT}: "  # our own files: one line of JSON above the header
_MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"}
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_IN_BRACKETS = re.compile(r"(.*?\S)\s*[\[(]([^\[\]()]*)[\])]\s*")


def open_table(path: Path) -> Source:
    """The `Source` of a text table. Numbers are read once the roles are known, so columns of comments do no harm."""
    if (size := path.stat().st_size) > MAX_TEXT:
        raise RecordingError(f"it has {size} bytes, text is read up to {MAX_TEXT}; write .parquet instead, or cut it.")
    text = _decode(path.read_bytes())
    header, names, separator, start = _header(text)
    rows, lines = _rows(text, separator, start)
    if header and not text.endswith("\n"):
        raise RecordingError("its last line is not whole; the file was cut off.")
    if rows and not names:
        names = rows.pop(0)
        del lines[0]
    if not rows:
        raise RecordingError("it has a header but no row below it.")
    rows, lines = _even(rows, lines, names, separator)
    check_size(len(rows), len(names))
    names, units = (names, {}) if header else _names_and_units(names, rows, lines)
    columns = dict(zip(names, zip(*rows)))

    def read(roles):
        channels = [*roles.states, *roles.inputs]
        comma = _decimal_comma([columns[name] for name in (*channels, roles.time) if name is not None], separator)
        table = {name: _numbers(name, columns[name], lines, comma) for name in channels}
        if roles.trial is not None and roles.trial != roles.time:
            table[roles.trial] = np.array([cell.strip() for cell in columns[roles.trial]])
        if roles.time is not None:
            table[roles.time] = _times(roles.time, columns[roles.time], lines, comma)
        return [table]

    return Source(names, units, read, lambda _, row: f"line {lines[row]}", header)


def write_recording(recording, header: dict, path: Path) -> None:
    """Write a recording as CSV that reads back to the last bit, below ``header`` (a dict) in a comment."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        file.write(f"{_MARK}{json.dumps(header)}\n")
        recording.to_frame().to_csv(file, index=False, lineterminator="\n")  # as many digits as it takes


def _decode(content):
    """The text without the byte order mark that Excel writes."""
    marks = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
    encoding = next((encoding for mark, encoding in marks.items() if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8" or b"\0" in content:
            why = f"byte {error.start} is not {encoding}"
            raise RecordingError(f"it is no text ({why}); export it as CSV, UTF-8.") from error
        text = content.decode("cp1252", errors="replace")  # spreadsheets in western Europe: a degree sign, a Greek mu
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise RecordingError(f"it is no text: there is a zero byte near line {line}; export it as CSV.")
    return text


def _header(text):
    """(own header or None, names or [] when they are the first row, separator, line where the rows begin)."""
    first, _, rest = text.partition("\n")
    if first.startswith(_MARK):
        try:
            header = json.loads(first.removeprefix(_MARK))
        except (ValueError, RecursionError) as error:
            raise RecordingError(
                f"line 1: its JSON is damaged ({error}); delete the line to read the table."
            ) from error
        if not isinstance(header, dict):
            raise RecordingError("line 1: its JSON is no mapping; delete the line to read the table.")
        return header, [], ",", 1
    lines = text.split("\n", 400)[:400]
    comment, start = "", 0
    while start < len(lines) and (not lines[start].strip() or lines[start].lstrip()[0] in "#%"):
        comment = lines[start].strip().lstrip("#% ") or comment
        start += 1
    if start < len(lines) and re.fullmatch(r"sep=.", lines[start].strip()):  # Excel's own hint
        return None, [], lines[start].strip()[-1], start + 1
    if start == len(lines):
        raise RecordingError("it has no rows.")
    separator = _separator([line for line in lines[start : start + 50] if line.strip()])
    cells, names = _cells(lines[start], separator), []
    if cells and all(map(_is_number, cells)):  # numpy.savetxt puts the names into a comment
        names = [cell.strip() for cell in _cells(comment, separator)]
        if len(names) != len(cells):
            raise RecordingError(
                f"line {start + 1}: there are numbers but no names above them; write a line of {len(cells)} names."
            )
    return None, names, separator, start


def _separator(lines):
    """The separator that gives all lines the same number of cells, more than one; None for blanks."""
    for candidate in (";", "\t", ",", "|", None):
        counts = {len(_cells(line, candidate)) for line in lines}
        if len(counts) == 1 and counts.pop() > 1:
            return candidate
    most = max((";", "\t", ",", "|"), key=lines[0].count)
    return most if most in lines[0] else ","


def _cells(line, separator):
    if separator is None:
        return line.split()
    try:
        return next(csv.reader([line.rstrip("\r")], delimiter=separator), [])
    except csv.Error:
        return []


def _rows(text, separator, start):
    """Rows that are neither blank nor comments, and the line on which each one ends."""
    lines = itertools.islice(io.StringIO(text, newline=""), start, None)
    rows, numbers = [], []
    style = {"delimiter": separator, "strict": True} if separator else {"delimiter": " ", "skipinitialspace": True}
    reader = csv.reader(lines, **style)
    try:
        for row in reader:
            if any(row) and not (row[0].lstrip()[:1] in ("#", "%") and rows):
                rows.append([cell for cell in row if cell] if separator is None else row)
                numbers.append(start + reader.line_num)
    except csv.Error as error:
        cure = "look for a quotation mark that is not closed, or a line without end"
        raise RecordingError(f"line {start + reader.line_num}: {error}; {cure}.") from error
    return rows, numbers


def _even(rows, lines, names, separator):
    """Rows with as many cells as the header; a separator at the end of a line is allowed."""
    width, even = len(names), []
    for row, line in zip(rows, lines):
        if len(row) > width and not any(cell.strip() for cell in row[width:]):
            row = row[:width]
        if len(row) != width:
            advice = "repair the line, or see whether the file is whole"
            if separator == "," and len(row) >= 2 * width - 1:
                advice = "is the comma the decimal sign too? Export with ';' between cells"
            raise RecordingError(f"line {line}: it has {len(row)} cells but the header has {width}; {advice}.")
        even.append(row)
    return even, lines


def _names_and_units(cells, rows, lines):
    """Names, and units from brackets after them or from a separate row below them."""
    names, units = [], {}
    cells = [cell.strip() for cell in cells]
    matches = [_IN_BRACKETS.fullmatch(cell) for cell in cells]
    bare = [
        match[1].strip() if match and not match[2].strip().isdigit() else cell for cell, match in zip(cells, matches)
    ]
    for i, (cell, name, match) in enumerate(zip(cells, bare, matches)):
        if bare.count(name) > 1:
            name = cell
        elif name != cell:
            units[name] = match[2].strip()
        names.append(name or f"column {i + 1}")
    for name in names:
        if names.count(name) > 1:
            raise RecordingError(f"the header has the name {name!r} twice; rename one.")
    below = [cell.strip() for cell in rows[0]] if len(rows) > 1 else []
    missing = _MISSING - {"", "-", "--"}
    if any(below) and not any(_is_number(cell) or _is_date(cell) or cell.lower() in missing for cell in below):
        if sum(map(_is_number, map(str.strip, rows[1]))) * 2 >= len(names):  # else it is a table of text
            units |= {name: cell.strip("[]() ") for name, cell in zip(names, below) if cell.strip("[]() -")}
            del rows[0], lines[0]
    return names, units


def _is_number(cell):
    try:
        float(cell.strip().replace(",", ".", 1))
    except ValueError:
        return False
    return cell.strip().lower() != "nan"


def _is_date(cell):
    try:
        return bool(datetime.datetime.fromisoformat(cell.strip()))
    except ValueError:
        return False


def _decimal_comma(columns, separator):
    """Whether cells read 0,5. Between commas, cells are quoted and 1,000 could be a thousand: only 0,5 is clear."""
    cells = (cell.strip() for column in columns for cell in column)
    if separator == ",":
        return any(_DECIMAL_COMMA.fullmatch(cell) and re.match(r"[+-]?0?,", cell) for cell in cells if "," in cell)
    return any(_DECIMAL_COMMA.fullmatch(cell) for cell in cells if "," in cell)


def _numbers(name, cells, lines, comma):
    joined = "".join(cells)
    if not comma and "_" not in joined and joined.isascii():  # float() reads 1_000 and digits of all scripts
        with contextlib.suppress(ValueError):
            return np.array(list(map(float, cells)))
    return np.array([_cell(name, cell.strip(), line, comma) for cell, line in zip(cells, lines)])


def _cell(name, cell, line, comma):
    if cell.lower() in _MISSING:
        return np.nan
    try:
        if "_" in cell or not cell.isascii() or (comma and "." in cell):
            raise ValueError
        return float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        what = "no number where others have a decimal comma" if comma and "." in cell else "no number"
        cure = "repair it, leave it empty, or leave the column out by roles"
        raise RecordingError(f"line {line}, column {name!r}: {cell[:40]!r} is {what}; {cure}.") from None


def _times(name, cells, lines, comma):
    """Numbers, or seconds since the first of dates such as 2026-02-28 12:00:00.010."""
    first = next((cell for cell in cells if cell.strip().lower() not in _MISSING), "")
    if _is_number(first) or not _is_date(first):
        return _numbers(name, cells, lines, comma)
    origin, times = datetime.datetime.fromisoformat(first.strip()), []
    for cell, line in zip(cells, lines):
        try:
            if cell.strip().lower() in _MISSING:
                times.append(np.nan)
            else:
                times.append((datetime.datetime.fromisoformat(cell.strip()) - origin).total_seconds())
        except (ValueError, TypeError):
            what = f"{cell[:40]!r} is no time as {first!r} is"
            raise RecordingError(f"line {line}, column {name!r}: {what}; repair it.") from None
    return np.array(times)
