"""MATLAB's files of version 7.3 (HDF5): their variables as arrays, texts, lists (cells) and dicts (structs)."""

from pathlib import Path

import h5py
import numpy as np

from tras.io import mcos
from tras.io.limits import MAX_DEPTH, MAX_PARTS, MAX_VALUES, TOO_NESTED, check_heaps, one_line
from tras.io.roles import RecordingError
from tras.io.workspace import Instance, Unread

_NUMERIC = ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "logical")
# What HDF5 raises where a file is damaged.
_DAMAGE = (OSError, KeyError, RuntimeError, TypeError, ValueError, AttributeError, OverflowError, MemoryError)


def read_variables(path: Path) -> dict:
    """Name -> value of every variable, `Unread` for what `tras.io.matfile5` passes over, too.

    Links and numbers in other files are refused.
    """
    check_heaps(path)
    budget = {"parts": 0, "values": 0}
    try:
        with h5py.File(path, "r") as file:
            variables = {name: _value(_member(file, name), name, 0, budget) for name in file if name[:1] != "#"}
            store = file
            for name in ("#subsystem#", "MCOS"):
                store = _member(store, name) if isinstance(store, h5py.Group) and name in store else None
            is_store = isinstance(store, h5py.Dataset) and h5py.check_ref_dtype(store.dtype)
            return mcos.resolved(variables, _cells(store, "objects", 0, budget)) if is_store else variables
    except RecordingError:
        raise
    except _DAMAGE as error:
        raise RecordingError(f"it is damaged ({one_line(error)}).") from error


def _member(group, name):
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise RecordingError(f"variable {name!r} is a link to somewhere else, which is not followed; save the numbers.")
    return group[name]


def _value(item, name, depth, budget):
    budget["parts"] += 1
    if depth > MAX_DEPTH or budget["parts"] > MAX_PARTS:
        raise RecordingError(TOO_NESTED)
    kind = _text(item.attrs.get("MATLAB_class", b""))
    if "MATLAB_sparse" in item.attrs:
        return Unread("a sparse matrix")
    if kind == "function_handle":
        return Unread("a function handle")
    if "MATLAB_object_decode" in item.attrs:  # of the old kind (2), such as an iddata, a struct; others are opaque
        if isinstance(item, h5py.Group) and item.attrs["MATLAB_object_decode"] == 2:
            return Instance(kind, _fields(item, name, depth, budget))
        content = _dataset(item, "", name, depth, budget) if isinstance(item, h5py.Dataset) else None
        return Unread(f"an object ({kind[:60]})", kind[:60], content)
    if isinstance(item, h5py.Group):
        return _struct(item, name, depth, budget)
    return _dataset(item, kind, name, depth, budget)


def _struct(group, name, depth, budget):
    """A dict, or a list of dicts for an array of structs: its fields are arrays of references without a class."""
    members = {key: _member(group, key) for key in group}
    if members and all(map(_is_array_of_structs, members.values())):
        fields = {key: _cells(item, f"{name}.{key}", depth, budget) for key, item in members.items()}
        if len({len(values) for values in fields.values()}) != 1:
            raise RecordingError(f"the fields of {name!r} have different numbers of entries; the file is damaged.")
        return [dict(zip(fields, values)) for values in zip(*fields.values())]
    return _fields(group, name, depth, budget)


def _fields(group, name, depth, budget):
    return {key: _value(_member(group, key), f"{name}.{key}", depth + 1, budget) for key in group}


def _is_array_of_structs(item):
    return isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) and "MATLAB_class" not in item.attrs


def _dataset(item, kind, name, depth, budget):
    if item.is_virtual or item.external:
        raise RecordingError(f"the numbers of {name!r} lie in another file; save them in this one.")
    if item.attrs.get("MATLAB_empty", 0):
        return [] if kind == "cell" else "" if kind == "char" else np.empty((0, 0))
    if h5py.check_ref_dtype(item.dtype):
        return _cells(item, name, depth, budget)
    if item.dtype.names:
        if set(item.dtype.names) != {"real", "imag"}:
            return Unread("compound values")
        parts = None
        budget["values"] += 2 * item.size
        if budget["values"] <= MAX_VALUES:
            parts = np.asarray(item[()]).T
            parts = parts["real"].astype(float) + 1j * parts["imag"].astype(float)
        return Unread("complex numbers", content=parts)
    if item.dtype.kind not in "biuf" or (kind and kind not in (*_NUMERIC, "char")):
        return Unread(f"of class {str(kind or item.dtype)[:60]}")
    budget["values"] += item.size
    if budget["values"] > MAX_VALUES:
        raise RecordingError(f"it has more than {MAX_VALUES} values.")
    array = item[()]
    if kind == "char":
        return np.asarray(array).T.astype("<u2").tobytes(order="F").decode("utf-16-le", errors="replace")
    array = np.asarray(array, dtype=float).T
    return array if array.ndim >= 2 else array.reshape(-1, 1)


def _cells(item, name, depth, budget):
    if item.is_virtual or item.external or item.size > MAX_PARTS:
        raise RecordingError(f"the cell array {name!r} lies in another file or has more than {MAX_PARTS} cells.")
    return [_value(item.file[ref], f"{name}{{{i + 1}}}", depth + 1, budget) for i, ref in enumerate(item[()].ravel())]


def _text(value):
    return value.decode("ascii", errors="replace") if isinstance(value, bytes) else str(value)
