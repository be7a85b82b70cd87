"""Parquet files (.parquet)."""

import contextlib
import json
from pathlib import Path

import numpy as np

from tras.io.limits import MAX_COLUMNS, Source, check_size, one_line
from tras.io.roles import RecordingError
from tras.workflow.arguments import extra

_KEY = b"tras"  # of the file's metadata
# Our columns are numbered from here on; the numbers are stored apart from the metadata, so they show when it is lost.
_ID, _FIRST = b"PARQUET:field_id", int.from_bytes(b"tras", "big")


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
    numbers = [int(entry[_ID]) for entry in metadata.values() if entry.get(_ID, b"").isdigit()]
    if header is None and any(0 <= number - _FIRST < MAX_COLUMNS for number in numbers):
        raise RecordingError("it is a tras recording that has lost its own description: it is damaged; write it again.")

    def read(roles):
        columns = [name for name in names if name in (roles.time, roles.trial, *roles.states, *roles.inputs)]
        with _damage():
            table = file.read(columns=columns, use_threads=False)
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


def _column(column, name, roles):
    """A column as floats; times in seconds since the first, labels of trials as text."""
    import pyarrow
    from pyarrow import types

    kind = column.type
    if name == roles.trial and name != roles.time:
        if types.is_nested(kind):
            raise RecordingError(f"column {name!r} holds {kind}; number the trials, or give each one a text.")
        return np.array(["" if value is None else str(value) for value in column.to_pylist()])
    if types.is_timestamp(kind) and name == roles.time:
        numbers = column.cast(pyarrow.int64())
        ticks = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[kind.unit]
        valid = np.array(numbers.is_valid(), dtype=bool)
        values = np.array(numbers.fill_null(0), dtype=np.int64)
        first = values[valid][0] if valid.any() else 0
        return np.where(valid, (values - first) / ticks, np.nan)
    numeric = (types.is_integer, types.is_floating, types.is_decimal, types.is_boolean, types.is_null)
    if not any(is_kind(kind) for is_kind in numeric):
        raise RecordingError(f"column {name!r} holds {kind}, not numbers; leave it out of the roles.")
    if types.is_boolean(kind):
        column = column.cast(pyarrow.int8())
    return np.array(column.cast(pyarrow.float64(), safe=False).to_numpy(), dtype=float)
