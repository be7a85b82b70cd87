"""Tables in memory: a pandas DataFrame as the `Source` of a recording."""

import datetime

import numpy as np

from tras.io.limits import Source, check_size, one_line
from tras.io.roles import RecordingError


def is_frame(value) -> bool:
    """Whether a value is an open table, not the path of one: of pandas, polars or pyarrow."""
    return hasattr(value, "iloc") or hasattr(value, "to_pandas")


def open_table(frame) -> Source:
    """The `Source` of a DataFrame; an index of times, or one with a name, is a column, too.

    Raises
    ------
    RecordingError
        If it is no DataFrame, or two columns have the same name.
    """
    import pandas

    if not isinstance(frame, pandas.DataFrame):
        advice = "; of this table give table.to_pandas()" if hasattr(frame, "to_pandas") else ""
        raise RecordingError(f"dataframe is a {type(frame).__name__}; give a pandas.DataFrame{advice}.")
    columns = {}
    index = frame.index
    is_time = isinstance(index, (pandas.DatetimeIndex, pandas.TimedeltaIndex))
    if (is_time or index.name is not None) and not isinstance(index, pandas.MultiIndex):
        columns[str(index.name) if index.name is not None else "time"] = index.to_series()
    for i, label in enumerate(frame.columns):
        name = ".".join(map(str, label)) if isinstance(label, tuple) else str(label)
        if name in columns:
            raise RecordingError(f"two columns of dataframe are called {name!r}; rename one.")
        columns[name] = frame.iloc[:, i]
    check_size(len(frame), len(columns))
    units = frame.attrs.get("units", {})
    units = units if isinstance(units, dict) else {}
    units = {name: unit for name, unit in units.items() if name in columns and isinstance(unit, str)}
    units |= {name: "s" for name, column in columns.items() if _is_instant(column)}  # read in s since the first

    def read(roles):
        names = [name for name in columns if name in (roles.time, roles.trial, *roles.states, *roles.inputs)]
        return [{name: _column(columns[name], name, roles) for name in names}]

    return Source(list(columns), units, read, lambda _, row: f"row {row} ({str(index[row])[:40]})")


def _is_instant(column):
    """Whether a column holds dates, times of day or durations, as pandas or as texts have them."""
    import pandas

    types = pandas.api.types
    if types.is_datetime64_any_dtype(column) or types.is_timedelta64_dtype(column):
        return True
    first = next((value for value in column.iloc[:1000] if isinstance(value, str)), None)
    if types.is_numeric_dtype(column) or first is None:
        return False
    try:
        return datetime.datetime.fromisoformat(first.strip()) is not None
    except ValueError:
        return False


def _column(column, name, roles):
    """A column as floats; times in seconds since the first, labels of trials as text."""
    import pandas

    if name == roles.trial and name != roles.time:
        codes, labels = pandas.factorize(column)  # -1 where the label is missing
        return np.array([*map(str, labels), ""], dtype=object)[codes]
    types = pandas.api.types
    is_instant = types.is_datetime64_any_dtype(column) or types.is_timedelta64_dtype(column)
    if not is_instant:
        try:
            numbers = pandas.to_numeric(column)
            if numbers.dtype.kind not in "biuf":
                raise TypeError("no real numbers")
            return numbers.to_numpy(dtype=float, na_value=np.nan)
        except (ValueError, TypeError, OverflowError) as error:
            if name != roles.time:
                raise RecordingError(
                    f"column {name!r} holds {column.dtype}, not numbers ({one_line(error)}); leave it out of the roles."
                ) from error
    elif name != roles.time:
        raise RecordingError(f"column {name!r} holds {column.dtype}, not numbers; leave it out of the roles.")
    try:
        times = column if is_instant else pandas.to_datetime(column, format="ISO8601")
        return (times - times.dropna().iloc[0]).dt.total_seconds().to_numpy(dtype=float)
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise RecordingError(f"column {name!r} holds {column.dtype}, which is no time; make it seconds.") from error
