"""What a recording holds, checked: arrays of numbers, names and units of channels, attributes."""

import math

import numpy as np

from tras.workflow.arguments import well_formed

_RESERVED = ("trajectory", "time", "sample", "row_size")  # columns and dimensions of the table and the file
_ONE_TOO_FEW = "{} has shape {}; give (trajectories, samples, channels), for one trajectory a list of it."


def float_arrays(name, values):
    """A list of float arrays (samples_i, channels), our own and read-only."""
    if hasattr(values, "iloc"):
        raise ValueError(
            f"{name} is a {type(values).__name__}; give a list of arrays (samples, channels), "
            "for one table [table.to_numpy()]."
        )
    if isinstance(values, np.ndarray) and values.ndim == 2:
        raise ValueError(_ONE_TOO_FEW.format(name, values.shape))
    try:
        values = list(values)
        arrays = [_own(value) for value in values]
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name} cannot be read as numbers ({error}); give real numbers in arrays of shape (samples, channels)."
        ) from error
    if arrays and all(array.ndim == 1 for array in arrays):
        raise ValueError(_ONE_TOO_FEW.format(name, f"({len(arrays)}, {len(arrays[0])})"))
    for i, (array, value) in enumerate(zip(arrays, values)):
        if array.ndim != 2:
            raise ValueError(f"{name}: trajectory {i} has shape {array.shape}; give (samples, channels).")
        if len(array) == 0:
            raise ValueError(f"{name}: trajectory {i} has no samples; leave it out.")
        if array.shape[1] != arrays[0].shape[1]:
            raise ValueError(
                f"{name}: trajectory {i} has {array.shape[1]} channels but the first has {arrays[0].shape[1]}."
            )
        if np.ma.is_masked(value):
            sample, channel = np.argwhere(np.ma.getmaskarray(value))[0]
            raise ValueError(
                f"{name}: trajectory {i} is missing (masked) at sample {sample} in column {channel}; "
                "repair it or cut the trajectory there."
            )
    return arrays


def _own(value):
    array = np.asarray(value)
    if array.dtype.kind not in "biufO":
        raise TypeError(f"they are {array.dtype.name}")
    array = np.array(array, dtype=float)
    array.setflags(write=False)
    return array


def require_finite(names, trajectories):
    for i, array in enumerate(trajectories):
        if not np.isfinite(array).all():
            sample, channel = np.argwhere(~np.isfinite(array))[0]
            raise ValueError(
                f"channel {names[channel]!r} is {array[sample, channel]} in trajectory {i} at sample {sample}; "
                "repair it or cut the trajectory there."
            )


def names_and_units(role, letter, trajectories, names, units):
    count = trajectories[0].shape[1]
    for kind, labels in (("names", names), ("units", units)):
        if isinstance(labels, str):
            raise ValueError(f"{role}_{kind} is the string {labels!r}; give a list of strings, one per channel.")
    names = tuple(names) if names is not None else tuple(f"{letter}{i + 1}" for i in range(count))
    units = tuple(units) if units is not None else ("",) * count
    for kind, labels in (("names", names), ("units", units)):
        if len(labels) != count:
            raise ValueError(f"{role}_{kind} has {len(labels)} entries {labels} but there are {count} {role} channels.")
        for label in labels:
            if not isinstance(label, str):
                raise ValueError(f"{role}_{kind} holds {label!r}; give strings.")
            well_formed(f"{role}_{kind}", label)
    for name in names:
        if not _is_name(name):
            raise ValueError(
                f"{role}_names holds {name!r}; give names that are not empty, have no '/' "
                f"and are none of {', '.join(_RESERVED)}."
            )
    if len(set(names)) != count:
        raise ValueError(f"{role}_names {names} repeat a name; every channel needs its own.")
    return names, units


def with_names(content):
    """What a reader returns, channels with names that a recording can have: a topic of ROS, `/imu/x`, is `imu.x`."""
    labels = {role: content[f"{role}_names"] for role in ("state", "input")}
    taken, new = {name for names in labels.values() for name in names if _is_name(name)}, {}
    for name in (name for names in labels.values() for name in names if not _is_name(name)):
        plain = name.replace("\0", "").strip("/.").replace("/", ".") or "channel"
        while plain in taken or not _is_name(plain):
            plain += "_"
        taken.add(plain)
        new[name] = plain
    if new:
        content |= {f"{role}_names": [new.get(name, name) for name in names] for role, names in labels.items()}
        attributes = content["attributes"]
        attributes["noticed"] = [
            *attributes.get("noticed", []),
            *(f"{old!r} is called {name}" for old, name in new.items()),
        ]
        if "intersample" in attributes:
            attributes["intersample"] = {new.get(key, key): word for key, word in attributes["intersample"].items()}
    return content


def _is_name(name):
    return bool(name) and "/" not in name and "\0" not in name and name != "." and name not in _RESERVED


def json_attributes(attributes):
    """A copy of ``attributes`` as JSON holds them."""
    if not hasattr(attributes, "items"):
        raise ValueError(f"attributes is {attributes!r}; give a dict of name -> value.")
    for key in attributes:
        if not isinstance(key, str):
            raise ValueError(f"attributes has the key {key!r}; give strings as keys.")
        well_formed("attributes", key)
    return {key: _as_json(key, value) for key, value in attributes.items()}


def _as_json(key, value):
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_as_json(key, item) for item in value]
    if isinstance(value, dict) and all(isinstance(name, str) for name in value):
        return {_as_json(key, name): _as_json(key, item) for name, item in value.items()}
    if isinstance(value, str):
        well_formed(f"attribute {key!r}", value)
    if value is None or isinstance(value, (bool, str, int)) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise ValueError(
        f"attribute {key!r} holds {value!r} ({type(value).__name__}), which JSON cannot hold; "
        "give None, true or false, finite numbers, strings, or lists and dicts of them."
    )
