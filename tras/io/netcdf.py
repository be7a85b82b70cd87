"""Recordings as NetCDF-4 files (.nc) and as xarray datasets."""

import json
from pathlib import Path

import h5py
import numpy as np

from tras.io.limits import FORMAT, MAX_VALUES, Source, check_heaps
from tras.io.roles import RecordingError
from tras.workflow.arguments import extra

_TIME = {"units": "s", "long_name": "time since the trajectory's start"}
_ROW_SIZE = {"sample_dimension": "sample", "long_name": "samples of each trajectory"}


def to_xarray(recording, attributes: dict):
    """See `tras.Recording.to_xarray`; ``attributes`` are the recording's, in the types of JSON."""
    with extra("netcdf", "a .nc file"):
        import xarray

    frame = recording.to_frame()
    variables = {
        "time": ("sample", frame["time"].to_numpy(), _TIME),
        "row_size": ("trajectory", recording.lengths, _ROW_SIZE),
    }
    for role in ("state", "input"):
        labels = zip(getattr(recording, f"{role}_names"), getattr(recording, f"{role}_units"))
        for position, (name, unit) in enumerate(labels):
            variables[name] = ("sample", frame[name].to_numpy(), {"units": unit, "role": role, "position": position})
    attributes_of_format = {
        "Conventions": "CF-1.11", "featureType": "trajectory", "format": FORMAT, "sampling_time": recording.dt,
        "attributes": json.dumps(attributes),
    }  # fmt: skip
    plain = {key: value for key, value in attributes.items() if _is_plain(key, value)}
    plain |= {key: int(value) for key, value in plain.items() if isinstance(value, bool)}
    return xarray.Dataset(variables, attrs={**plain, **attributes_of_format})


def write_recording(recording, header: dict, path: Path) -> None:
    """Write the dataset of `to_xarray` with the checksum of ``header``."""
    dataset = to_xarray(recording, header["attributes"]).assign_attrs(checksum=header["checksum"])
    path.write_bytes(dataset.to_netcdf(engine="h5netcdf"))  # in memory: on a full disk HDF5 cannot close a file


def open_table(path: Path) -> Source:
    """The `Source` of a NetCDF-4 file that `write_recording` has written."""
    with extra("netcdf", "a .nc file"):
        import xarray

    check_heaps(path)
    _check_size(path)  # before xarray, which reads the coordinates as it opens a file
    with xarray.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
        return _source(dataset.load())


def _check_size(path):
    """Refuse a file that declares more values than are read: HDF5 does not store values that were never written."""
    values = []
    with h5py.File(path, "r") as file:
        file.visititems(lambda _, item: values.append(item.size or 0) if isinstance(item, h5py.Dataset) else None)
    if sum(values) > MAX_VALUES:
        raise RecordingError(f"it has {sum(values)} values; up to {MAX_VALUES} are read")


def _source(dataset):
    if dataset.attrs.get("format") != FORMAT:
        raise RecordingError(f"its attribute 'format' is {dataset.attrs.get('format')!r}, not {FORMAT!r}")
    ends = np.cumsum(dataset["row_size"].to_numpy())
    if ends[-1] != dataset.sizes["sample"]:
        raise RecordingError(f"row_size sums to {ends[-1]} but there are {dataset.sizes['sample']} samples")
    header = {"format": FORMAT, "dt": float(dataset.attrs["sampling_time"])}
    for role in ("state", "input"):
        names = [name for name, variable in dataset.data_vars.items() if variable.attrs.get("role") == role]
        header[f"{role}s"] = sorted(names, key=lambda name: dataset[name].attrs["position"])
        header[f"{role}_units"] = [dataset[name].attrs["units"] for name in header[f"{role}s"]]
    header["attributes"] = json.loads(dataset.attrs["attributes"])
    if "checksum" in dataset.attrs:  # files of earlier releases have none
        header["checksum"] = dataset.attrs["checksum"]
    names = [*header["states"], *header["inputs"]]
    units = dict(zip(names, [*header["state_units"], *header["input_units"]]))
    columns = [np.split(dataset[name].to_numpy(), ends[:-1]) for name in names]
    tables = [dict(zip(names, pieces)) for pieces in zip(*columns)]
    locate = lambda trajectory, row: f"trajectory {trajectory}, sample {row}"  # noqa: E731
    return Source(names, units, lambda _: tables, locate, header, header["dt"])


def _is_plain(key, value):
    """Whether a NetCDF attribute can hold the value in a way that every reader understands."""
    if isinstance(value, str):
        return key.isidentifier() and value.isprintable() and value.isascii() and value != ""
    return key.isidentifier() and (isinstance(value, float) or (isinstance(value, int) and abs(value) < 2**63))
