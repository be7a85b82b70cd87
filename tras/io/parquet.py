"""Parquet files (.parquet)."""

import contextlib
import json
from pathlib import Path

import numpy as np

from tras.io.limits import MAX_COLUMNS, MAX_TEXT, MAX_VALUES, Source, check_size, one_line
from tras.io.roles import RecordingError
from tras.workflow.arguments import extra

_KEY = b"tras"  # of the file's metadata
# Our columns are numbered from here on; the numbers are stored apart from the metadata, so they show when it is lost.
_ID, _FIRST = b"PARQUET:field_id", int.from_bytes(b"tras", "big")
_LONGEST_LABEL = 1000  # bytes of a trial's name


def write_recording(recording, header: dict, path: Path) -> None:
    """Write a recording as a table with ``header`` (a dict) in its metadata and checksums of its pages."""
    with extra("parquet", "a .parquet file"):
        import pyarrow.parquet

    table = pyarrow.Table.from_pandas(recording.to_frame(), preserve_index=False)
    fields = [field.with_metadata({_ID: str(_FIRST + i)}) for i, field in enumerate(table.schema)]
    table = table.cast(pyarrow.schema(fields, metadata={_KEY: json.dumps(header)}))
    pyarrow.parquet.write_table(table, path, write_page_checksum=True)


def open_table(path: Path) -> Source:
    """The `Source` of a Parquet file: only the columns that have a role are read."""
    with extra("parquet", "a .parquet file"):
        import pyarrow.parquet
        from pyarrow import types

    with _damage():
        file = pyarrow.parquet.ParquetFile(path, page_checksum_verification=True, pre_buffer=False)
        schema, rows = file.schema_arrow, file.metadata.num_rows
    check_size(rows, len(schema.names))
    names = [name for name in schema.names if not name.startswith("__index_level_")]
    if len(set(names)) != len(names):
        raise RecordingError("two columns have the same name; rename one.")
    with _damage():
        header = json.loads((schema.metadata or {}).get(_KEY, b"null"))
        metadata = {name: schema.field(name).metadata or {} for name in names}
        units = {name: entry.get(b"units", entry.get(b"unit", b"")).decode("utf-8") for name, entry in metadata.items()}
        units |= {
            name: "s" for name in names if types.is_timestamp(schema.field(name).type)
        }  # read in s since the first
    numbers = [int(entry[_ID]) for entry in metadata.values() if entry.get(_ID, b"").isdigit()]
    if header is None and any(0 <= number - _FIRST < MAX_COLUMNS for number in numbers):
        raise RecordingError("it is a tras recording that has lost its own description: it is damaged; write it again.")

    def read(roles):
        columns = [name for name in names if name in (roles.time, roles.trial, *roles.states, *roles.inputs)]
        for name in columns:
            _check_kind(schema.field(name).type, name, roles)
        with _damage():
            reader = _reader(path, file, schema, roles)
            table = reader.read(columns=columns, use_threads=False)
            table.validate(full=True)
        if table.column_names != columns or table.num_rows != rows:
            raise RecordingError("its columns are not those of its description; it is damaged.")
        return [{name: _column(table.column(name), name, roles) for name in columns}]

    return Source(names, units, read, lambda _, row: f"row {row + 1}", header)


@contextlib.contextmanager
def _damage():
    """Turn the library's errors into one sentence."""
    import pyarrow

    try:
        yield
    except (OSError, ValueError, TypeError, KeyError, RuntimeError, MemoryError, pyarrow.ArrowException) as error:
        raise RecordingError(f"it is damaged, or of a kind that is not read ({one_line(error)}).") from error


def _is_text(kind):
    from pyarrow import types

    is_any = (types.is_string, types.is_large_string, types.is_binary, types.is_large_binary)
    return any(is_kind(kind) for is_kind in is_any)


def _check_kind(kind, name, roles):
    """Refuse a column before it is read: a single row of a list may hold all of the memory."""
    from pyarrow import types

    numeric = (types.is_integer, types.is_floating, types.is_decimal, types.is_boolean, types.is_null)
    if name == roles.trial and name != roles.time:
        if types.is_nested(kind):
            raise RecordingError(f"column {name!r} holds {kind}; number the trials, or give each one a text.")
    elif not any(is_kind(kind) for is_kind in numeric) and not (types.is_timestamp(kind) and name == roles.time):
        raise RecordingError(f"column {name!r} holds {kind}, not numbers; leave it out of the roles.")


def _reader(path, file, schema, roles):
    """The open file, or one that reads a trial's names as a dictionary: a text that 1e6 rows share is there once."""
    import pyarrow.parquet

    if roles.trial is None or not _is_text(schema.field(roles.trial).type):
        return file
    # Of the whole groups: a damaged description of a single column ends the process, in the library (pyarrow 26).
    size = sum(file.metadata.row_group(i).total_byte_size for i in range(file.metadata.num_row_groups))
    if size > MAX_TEXT + 8 * MAX_VALUES:
        raise RecordingError(
            f"it has {size} bytes, with trials by text in column {roles.trial!r}; number the trials instead."
        )
    options = {"page_checksum_verification": True, "pre_buffer": False, "read_dictionary": [roles.trial]}
    return pyarrow.parquet.ParquetFile(path, **options)


def _labels(column, name):
    """The trials' names as texts, each text once in memory."""
    import pyarrow.compute
    from pyarrow import types

    if not types.is_dictionary(column.type):
        column = column.dictionary_encode()
    parts = [np.empty(0, dtype=object)]
    for chunk in column.chunks:
        known = chunk.dictionary
        if _is_text(known.type):
            longest = pyarrow.compute.max(pyarrow.compute.binary_length(known)).as_py() or 0
            if longest > _LONGEST_LABEL:
                raise RecordingError(
                    f"column {name!r} has a trial's name of {longest} bytes; up to {_LONGEST_LABEL} are read."
                )
        texts = np.array(["" if value is None else str(value) for value in known.to_pylist()] + [""], dtype=object)
        parts.append(texts[np.array(chunk.indices.fill_null(len(known)), dtype=np.int64)])
    return np.concatenate(parts)


def _column(column, name, roles):
    """A column as floats; times in seconds since the first, labels of trials as text."""
    import pyarrow
    from pyarrow import types

    kind = column.type
    if name == roles.trial and name != roles.time:
        return _labels(column, name)
    if types.is_timestamp(kind) and name == roles.time:
        numbers = column.cast(pyarrow.int64())
        ticks = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[kind.unit]
        valid = np.array(numbers.is_valid(), dtype=bool)
        values = np.array(numbers.fill_null(0), dtype=np.int64)
        first = values[valid][0] if valid.any() else 0
        return np.where(valid, (values - first) / ticks, np.nan)
    if types.is_boolean(kind):
        column = column.cast(pyarrow.int8())
    return np.array(column.cast(pyarrow.float64(), safe=False).to_numpy(), dtype=float)
