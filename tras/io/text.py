"""Text tables (.csv, .txt, .dat ...): what loggers, oscilloscopes and spreadsheets write, as columns of numbers.

One pass for all of them: bytes, UTF-8, layout (`tras.io.dialect`), columns (pandas). pandas does not say on which line
of the file a wrong cell stands; only for such a sentence the rows are counted again.
"""

import contextlib
import csv
import functools
import io
import json
import re
import warnings
from pathlib import Path

import numpy as np

from tras.io import dialect
from tras.io.limits import FORMAT, MAX_TEXT, MAX_VALUES, Source, check_size, one_line
from tras.io.roles import RecordingError
from tras.io.words import guess_role, step_of

_MARK = f"# {FORMAT}: "  # our own files: one line of JSON above the header
_HEAD, _CHUNK = 2**22, 2**16  # bytes in which the layout is looked for, and that are read at once
_MISSING = sorted({form for word in dialect.MISSING for form in (word, word.upper(), word.title())} | {"NaN", "#N/A"})
_DECIMAL_COMMA = re.compile(rb"(?<![\d.,])[+-]?0?,\d|\d,\d{1,2}(?![\d,])|,\d{4}|\d{4},\d")  # none of thousands
_FORTRAN = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")  # 1.5D+02
_FEW = 0.02  # of the rows: what is filled in fewer is no column of the recording, but notes beside it


def open_table(path: Path) -> Source:
    """The `Source` of a text table. Columns of text do no harm, as long as they have no role."""
    if (size := path.stat().st_size) > MAX_TEXT:
        raise RecordingError(f"it has {size} bytes, text is read up to {MAX_TEXT}; write .parquet instead, or cut it.")
    text = _Text(path)
    header, start = _own_header(text.head)
    lines = text.head[start:].split(b"\n", dialect.WINDOW)
    if len(lines) > dialect.WINDOW or text.is_longer:
        lines.pop()
    lines = [line.decode("utf-8", errors="replace") for line in lines]
    if header is None:
        layout = dialect.find([line.rstrip("\r") for line in lines])
    elif not text.tail.endswith(b"\n"):
        raise RecordingError("its last line is not whole; the file was cut off.")
    else:
        names = next(csv.reader(lines[:1]), [])
        layout = dialect.Layout(",", ".", 1, len(names), names, True, {}, [], "", False, False)
    table = _Table(text, start, layout)
    remarks = [text for text in (layout.sentence, *table.remarks) if text]
    remarks += [f"its letters are {text.encoding}"] if text.encoding != "UTF-8" else []
    units = {name: unit for name, unit in layout.units.items() if name in table.columns} | table.dates()
    steps = [step for row in layout.preamble if len(row) > 1 if (step := step_of(row[0], row[1]))]
    return Source(list(table.columns), units, table.read, table.locate, header, steps[0] if steps else None, remarks)


def write_recording(recording, header: dict, path: Path) -> None:
    """Write a recording as CSV that reads back to the last bit, below ``header`` (a dict) in a comment."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        file.write(f"{_MARK}{json.dumps(header)}\n")
        recording.to_frame().to_csv(file, index=False, lineterminator="\n")  # as many digits as it takes


class _Text:
    """A file as UTF-8 with line feeds: its first and last bytes, and all of them where these are needed.

    A file of ASCII is left to pandas, which reads it from the disk: a copy in memory would take a third of its time.
    """

    def __init__(self, path):
        self.path, self.encoding, self.size = path, "UTF-8", path.stat().st_size
        self.head, self.tail, self.is_plain = _scanned(path)
        if not self.is_plain:
            self.content, self.encoding = _utf8(path.read_bytes())
            self.head, self.tail, self.size = self.content[:_HEAD], self.content[-_CHUNK:], len(self.content)

    @functools.cached_property
    def content(self):
        return self.path.read_bytes()

    @property
    def is_longer(self):
        """Whether there is more than the head."""
        return self.size > len(self.head)


def _scanned(path):
    """(first bytes, last bytes, whether all are ASCII with line feeds and without zeros) of a file."""
    head, tail, is_plain = [], b"", True
    with open(path, "rb", buffering=0) as file:
        while chunk := file.read(_CHUNK):
            is_plain = is_plain and chunk.isascii() and b"\0" not in chunk
            if len(head) * _CHUNK < _HEAD:
                head.append(chunk)
            tail = tail[-_CHUNK:] + chunk if len(chunk) < _CHUNK else chunk
    head = b"".join(head)
    return head, tail, is_plain and b"\n" in head


def _utf8(content):
    """(the bytes in UTF-8, without a byte order mark and with line feeds; the encoding that they had)."""
    marks = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
    encoding = next((encoding for mark, encoding in marks.items() if content.startswith(mark)), "utf-8")
    if encoding == "utf-8" and len(content) > 3 and not any(content[1:200:2]):
        encoding = "utf-16-le"
    try:
        if encoding != "utf-8" or not content.isascii():
            text = content.decode(encoding)
            content = text.encode() if encoding != "utf-8" else content
    except UnicodeError as error:
        if encoding != "utf-8" or b"\0" in content:
            why = f"{one_line(error)}" if not isinstance(error, UnicodeDecodeError) else f"byte {error.start}"
            raise RecordingError(f"it is no text ({why} is not {encoding}); export it as CSV, UTF-8.") from error
        content = content.decode("cp1252", errors="replace").encode()  # western Europe: a degree sign, a Greek mu
        encoding = "Windows-1252"
    if b"\0" in content:
        line = content.count(b"\n", 0, content.index(b"\0")) + 1
        raise RecordingError(f"it is no text: there is a zero byte near line {line}; export it as CSV.")
    if b"\n" not in content[:_HEAD]:
        content = content.replace(b"\r", b"\n")
    return content, encoding.upper().removesuffix("-SIG")


def _own_header(content):
    """(header or None, where the table begins) of a file of `write_recording`."""
    first, end, _ = content[:_HEAD].partition(b"\n")
    if not first.startswith(_MARK.encode()):
        return None, 0
    try:
        header = json.loads(first.removeprefix(_MARK.encode()))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"line 1: its JSON is damaged ({error}); delete the line to read the table.") from error
    if not isinstance(header, dict):
        raise RecordingError("line 1: its JSON is no mapping; delete the line to read the table.")
    return header, len(first + end)


class _Table:
    """The columns of a text table, name -> pandas.Series of numbers or text, and what was left out of it."""

    def __init__(self, text, start, layout):
        self.layout, self.remarks = layout, []
        for _ in range(layout.start):
            start = text.head.find(b"\n", start) + 1 or len(text.head)
        self.before = text.head.count(b"\n", 0, start)
        self._text, self._start, self._content = text, start, None  # the rows' bytes, where they are not the file's
        check_size(text.content.count(b"\n") if text.size > MAX_VALUES else 0, layout.width)
        if layout.brackets:
            self._content = self.content.translate(bytes.maketrans(b"[];", b"   "))
        self._drop_unfinished_line()
        self.decimal = self._decimal_sign()
        frame = self._frame()
        frame = frame[frame.notna().any(axis=1)] if frame.iloc[:, -1].hasnans else frame
        if frame.empty:
            raise RecordingError("it has a header but no row below it.")
        self.columns = self._columns(frame)
        self._check_width(frame)

    @property
    def content(self):
        """The bytes from the first row on."""
        if self._content is None:
            self._content = self._text.content[self._start :]
        return self._content

    def read(self, roles):
        """The columns with a role, as numbers; labels of trials as text."""
        table = {name: self._numbers(name) for name in (*roles.states, *roles.inputs)}
        if roles.trial is not None and roles.trial != roles.time:
            labels = self.columns[roles.trial]
            table[roles.trial] = (
                labels.to_numpy(dtype=float)
                if _holds_numbers(labels)
                else np.array([label.strip() if isinstance(label, str) else "" for label in labels])
            )
        if roles.time is not None:
            table[roles.time] = self._times(roles.time)
        return [table]

    def locate(self, _, row):
        """Where a row stands: "line 7"."""
        return f"line {self._line(int(self._index[row]))}"

    def dates(self):
        """Name -> "s" of the columns of dates, which are read as seconds since the first."""
        texts = {name: column for name, column in self.columns.items() if not _holds_numbers(column)}
        return {name: "s" for name, column in texts.items() if dialect.is_date(_first(column))}

    def _drop_unfinished_line(self):
        """Leave out a last line that breaks off: a logger lost its power, or a file was cut."""
        rest = self._text.tail[self._text.tail.rfind(b"\n") + 1 :]
        if not rest or b'"' in self._text.tail:
            return
        cells = dialect.cells([rest.decode("utf-8", errors="replace")], self.layout.separator)
        filled = [name for name in self.layout.names if name]
        if cells and len(cells[0][1]) < len(filled) and self.content.count(b"\n") > 2 and not self.layout.brackets:
            line = self.before + self.content.count(b"\n") + 1
            self.remarks.append(f"left out: line {line}, the last, which breaks off after {len(cells[0][1])} cells")
            self._content = self.content[: -len(rest)]

    def _decimal_sign(self):
        """The layout's decimal sign, or what the whole file says if its first lines do not."""
        layout = self.layout
        if layout.decimal in (".", ",") or layout.separator == ",":
            return layout.decimal if layout.decimal == "," else "."
        if b"," not in self.content:
            return "."
        if _DECIMAL_COMMA.search(self.content):
            return ","
        cell = re.search(rb"[\d.]*\d,\d+", self.content)
        if cell is None:
            return "."
        raise RecordingError(
            f"cells such as {cell[0].decode()!r} could be thousands or have a decimal comma; write the numbers without "
            "separators of thousands."
        )

    def _frame(self):
        """All cells as pandas reads them: numbers where a column holds nothing else."""
        try:
            frame = self._parsed()
            if all(map(_holds_numbers, frame.dtypes)):
                return frame
        except RecordingError as error:
            frame, cause = None, error
        if b"#" in self.content or b"%" in self.content:
            without = re.sub(rb"(?m)^[ \t]*[#%].*$", b"", self.content)  # comments between the rows
            if without != self.content:
                self._content = without
                return self._frame()
        if frame is None:
            rows = self._rows(
                self.layout.width
            )  # says what is wrong; or some rows end with a separator and some do not
            text = io.StringIO()
            csv.writer(text, delimiter=self.layout.separator or " ", lineterminator="\n").writerows(rows)
            if text.getvalue().encode() == self.content:
                raise cause
            self._content = text.getvalue().encode()
            return self._parsed()
        return frame

    def _parsed(self):
        import pandas as pd

        style = {"sep": self.layout.separator or r"\s+", "decimal": self.decimal, "na_values": _MISSING}
        style |= {"header": None, "names": list(range(self.layout.width)), "keep_default_na": False, "engine": "c"}
        style |= {"skipinitialspace": self.layout.has_blanks}
        try:
            with warnings.catch_warnings(), self._opened() as file:
                warnings.simplefilter("ignore")  # of columns with numbers and text, which are text here
                frame = pd.read_csv(file, **style)
        except pd.errors.EmptyDataError as error:
            raise RecordingError("it has a header but no row below it.") from error
        except (pd.errors.ParserError, ValueError, OverflowError) as error:
            raise RecordingError(f"it is no table ({one_line(error)}).") from error
        if not isinstance(frame.index, pd.RangeIndex):
            raise RecordingError("it is no table (its rows have different numbers of cells).")
        return frame

    def _opened(self):
        """A file of the rows."""
        if self._content is not None or not self._text.is_plain:
            return io.BytesIO(self.content)
        file = open(self._text.path, "rb")  # noqa: SIM115
        file.seek(self._start)
        return file

    def _columns(self, frame):
        """Name -> column, without those that are (nearly) empty or there twice, and without a rest of text below."""
        frame = self._without_rest(frame)
        self._index, columns, few = frame.index, {}, []
        for i, name in enumerate(self.layout.names):
            column = frame[i]
            if not _holds_numbers(column) and dialect.is_number(_first(column)):  # exponents with D, a rest cut off
                numbers, wrong = _converted(column, self.decimal)
                column = column if wrong else type(column)(numbers, column.index)
            count = int(column.count()) if column.hasnans else len(column)
            if count <= _FEW * len(column) and not guess_role(name):
                few += [name if name != str(i + 1) and not name.startswith("column ") else str(i + 1)] if count else []
                continue
            if name in columns and not columns[name].equals(column):
                raise RecordingError(f"the header has the name {name!r} twice; rename one.")
            if name in columns:
                self.remarks.append(f"left out: the second column {name}, the same as the first")
            columns.setdefault(name, column)
        if few:
            self.remarks.append(f"left out: {', '.join(few)}, nearly empty")
        if not columns:
            raise RecordingError("it has no rows of numbers.")
        return columns

    def _without_rest(self, frame):
        """The rows without those at the end that hold no number, such as the last words of a logger."""
        end = len(frame)
        while end > 1 and not any(map(_is_number, frame.iloc[end - 1])):
            end -= 1
        if end == len(frame):
            return frame
        rest = " ".join(str(cell) for cell in frame.iloc[end] if cell == cell)
        lines = f"line {self._line(int(frame.index[end]))}"
        lines += f" and {len(frame) - end - 1} below it" if end + 1 < len(frame) else ""
        self.remarks.append(f"left out: {lines}, no numbers: {rest[:40]!r}")
        return frame.iloc[:end]

    def _check_width(self, frame):
        """An error if a row has too few cells: pandas fills it with missing values."""
        last = max(i for i, name in enumerate(self.layout.names) if name in self.columns)
        column = frame[last]
        if column.hasnans:
            self._rows(last + 1)

    def _rows(self, needed):
        """The rows as lists of cells, cut to the table's width; an error at the first that is too short or too long."""
        rows, width = [], self.layout.width
        above = "header has" if self.layout.named else "rows above have"
        for line, row in self._numbered():
            if len(row) > width and not any(cell.strip() for cell in row[width:]):
                row = row[:width]
            if not needed <= len(row) <= width and any(map(_is_number, row)):
                advice = "repair the line, or see whether the file is whole"
                if self.layout.separator == "," and len(row) >= 2 * width - 1:
                    advice = "is the comma the decimal sign too? Export with ';' between cells"
                raise RecordingError(f"line {line}: it has {len(row)} cells but the {above} {width}; {advice}.")
            rows.append(row)
        return rows

    def _numbered(self):
        """(line of the file, cells) of every row that is not blank."""
        lines = io.StringIO(self.content.decode("utf-8", errors="replace"), newline="")
        if self.layout.separator is None:
            yield from ((self.before + k, line.split()) for k, line in enumerate(lines, 1) if line.strip())
            return
        reader = csv.reader(lines, delimiter=self.layout.separator, strict=True)
        try:
            for row in reader:
                if len(row) > 1 or (row and row[0].strip()):
                    yield self.before + reader.line_num, row
        except csv.Error as error:
            cure = "look for a quotation mark that is not closed, or a line without end"
            raise RecordingError(f"line {self.before + reader.line_num}: {error}; {cure}.") from error

    def _line(self, row):
        """The line of the file on which a row ends, both counted as pandas does."""
        with contextlib.suppress(RecordingError):
            for k, (line, _) in enumerate(self._numbered()):
                if k == row:
                    return line
        return self.before + row + 1

    def _numbers(self, name):
        column = self.columns[name]
        if _holds_numbers(column):
            return column.to_numpy(dtype=float)
        numbers, wrong = _converted(column, self.decimal)
        if wrong:
            line, cell = self.locate(0, wrong[0]), wrong[1]
            what, cure = "no number", "repair it, leave it empty, or leave the column out by roles"
            if re.search(r"\d[/:]\d", cell):
                cure = "an instant is written as 2026-02-28 12:00:00.010"
            if self.decimal == "," and "." in cell:
                what = "no number where others have a decimal comma"
            elif re.fullmatch(r"[+-]?\d{1,3}([,.' ]\d{3})+([.,]\d*)?", cell):
                cure = "write it without separators of thousands"
            raise RecordingError(f"{line}, column {name!r}: {cell[:40]!r} is {what}; {cure}.")
        return numbers

    def _times(self, name):
        """Numbers, or seconds since the first of dates such as 2026-02-28 12:00:00.010."""
        column = self.columns[name]
        if _holds_numbers(column):
            if column.dtype.kind in "iu" and len(column):  # nanoseconds since 1970: doubles would round them
                return (column - column.iloc[0] if abs(int(column.iloc[0])) > 2**53 else column).to_numpy(dtype=float)
            return column.to_numpy(dtype=float)
        if not dialect.is_date(first := _first(column)):
            return self._numbers(name)
        times, start = np.full(len(column), np.nan), dialect.instant(first)
        for k, cell in enumerate(column):
            if isinstance(cell, str) and cell.strip().lower() not in dialect.MISSING:
                try:
                    times[k] = (dialect.instant(cell.strip()) - start).total_seconds()
                except (ValueError, TypeError):
                    what = f"{cell[:40]!r} is no time as {first!r} is"
                    raise RecordingError(f"{self.locate(0, k)}, column {name!r}: {what}; repair it.") from None
        return times


def _holds_numbers(column):
    """Whether a column, or one of this type, holds numbers."""
    return getattr(column, "dtype", column).kind in "iufb"


def _first(column):
    """The first cell with text in it, stripped."""
    return next((cell.strip() for cell in column if isinstance(cell, str) and cell.strip()), "")


def _is_number(cell):
    """Whether a cell of a frame or of a file holds a number."""
    return dialect.is_number(cell.strip()) if isinstance(cell, str) else cell == cell


def _converted(column, decimal):
    """(the numbers of a column of text, None), or (None, (row, cell)) of the first that is neither one nor missing."""
    numbers = np.empty(len(column))
    for row, cell in enumerate(column):
        text = "" if cell != cell else str(cell).strip()
        numbers[row] = _number(text, decimal)
        if numbers[row] != numbers[row] and text.lower() not in dialect.MISSING:
            return None, (row, text)
    return numbers, None


def _number(cell, decimal):
    """A stripped cell as a float, NaN if it is none."""
    if not cell.isascii() or "_" in cell or (decimal == "," and "." in cell):  # float reads 1_000 and other digits
        return np.nan
    plain = _FORTRAN.sub("e", cell)
    try:
        return float(plain.replace(",", ".") if decimal == "," else plain)
    except ValueError:
        return np.nan
