"""Recordings as NetCDF-4 files (.nc) and as xarray datasets."""

import json

import h5py
import numpy as np

from tras.io.limits import FORMAT, MAX_VALUES, check_heaps
from tras.io.roles import RecordingError


def to_xarray(recording, attributes):
    """See `tras.Recording.to_xarray`; ``attributes`` are the recording's, in the types of JSON."""
    import xarray

    frame = recording.to_frame()
    variables = {
        "time": ("sample", frame["time"].to_numpy(), {"units": "s", "long_name": "time since the trajectory's start"}),
        "row_size": (
            "trajectory",
            recording.lengths,
            {"sample_dimension": "sample", "long_name": "samples of each trajectory"},
        ),
    }
    roles = (
        ("state", recording.state_names, recording.state_units),
        ("input", recording.input_names, recording.input_units),
    )
    for role, names, units in roles:
        for position, (name, unit) in enumerate(zip(names, units)):
            variables[name] = ("sample", frame[name].to_numpy(), {"units": unit, "role": role, "position": position})
    attributes_of_format = {
        "Conventions": "CF-1.11",
        "featureType": "trajectory",
        "format": FORMAT,
        "sampling_time": recording.dt,
        "attributes": json.dumps(attributes),
    }
    plain = {key: value for key, value in attributes.items() if _is_plain(key, value)}
    plain |= {key: int(value) for key, value in plain.items() if isinstance(value, bool)}
    return xarray.Dataset(variables, attrs={**plain, **attributes_of_format})


def content(path):
    """The arguments of the `tras.Recording` that ``path`` holds, and its checksum or None.

    Raises
    ------
    RecordingError
        If it is not a NetCDF-4 file or not a recording.
    """
    import xarray

    check_heaps(path)
    _check_size(path)  # before xarray, which reads the coordinates as it opens a file
    with xarray.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
        return _content(dataset.load())


def _check_size(path):
    """Refuse a file that declares more values than are read: HDF5 does not store values that were never written."""
    values = []
    with h5py.File(path, "r") as file:
        file.visititems(lambda _, item: values.append(item.size or 0) if isinstance(item, h5py.Dataset) else None)
    if sum(values) > MAX_VALUES:
        raise RecordingError(f"it has {sum(values)} values; up to {MAX_VALUES} are read")


def _content(dataset):
    if dataset.attrs.get("format") != FORMAT:
        raise RecordingError(f"its attribute 'format' is {dataset.attrs.get('format')!r}, not {FORMAT!r}")
    ends = np.cumsum(dataset["row_size"].to_numpy())
    if ends[-1] != dataset.sizes["sample"]:
        raise RecordingError(f"row_size sums to {ends[-1]} but there are {dataset.sizes['sample']} samples")
    parts = {}
    for role in ("state", "input"):
        names = [name for name, variable in dataset.data_vars.items() if variable.attrs.get("role") == role]
        names.sort(key=lambda name: dataset[name].attrs["position"])
        columns = [dataset[name].to_numpy() for name in names]
        table = np.column_stack(columns) if columns else np.empty((ends[-1], 0))
        parts[f"{role}s"] = np.split(table, ends[:-1])
        parts[f"{role}_names"] = names
        parts[f"{role}_units"] = [dataset[name].attrs["units"] for name in names]
    content = {
        **parts,
        "dt": float(dataset.attrs["sampling_time"]),
        "attributes": json.loads(dataset.attrs["attributes"]),
    }
    return content, dataset.attrs.get("checksum")  # files of earlier releases have none


def _is_plain(key, value):
    """Whether a NetCDF attribute can hold the value in a way that every reader understands."""
    if isinstance(value, str):
        return key.isidentifier() and value.isprintable() and value.isascii() and value != ""
    return key.isidentifier() and (isinstance(value, float) or (isinstance(value, int) and abs(value) < 2**63))
