"""Weights, limits and noise as users give them, by channel: one number for all, a sequence, or a mapping from names."""

from collections.abc import Mapping, Sequence

import numpy as np

from tras.workflow.arguments import did_you_mean, number

Numbers = float | Sequence[float] | Mapping[str, float]
Pairs = Sequence[Sequence[float]] | Mapping[str, Sequence[float]]


def per_channel(name, values, channels, default, *, missing=None) -> np.ndarray:
    """Numbers, 0 or more, one per channel: from one for all, a sequence, or a mapping from names."""
    if values is None:
        return np.array(default, dtype=float)
    if isinstance(values, Mapping):
        default = np.full(len(channels), missing) if missing is not None else np.array(default, dtype=float)
        for key in values:
            require_known(name, key, channels)
            default[channels.index(key)] = _number(f"{name}[{key!r}]", values[key])
        return default
    values = np.asarray(values)
    if values.ndim == 0:
        return np.full(len(channels), _number(name, values.item()))
    if values.shape != (len(channels),):
        raise ValueError(f"{name} has shape {values.shape}; give {len(channels)} numbers: {', '.join(channels)}.")
    return np.array([_number(f"{name}[{i}]", value) for i, value in enumerate(values.tolist())])


def pairs(name, values, channels, default) -> np.ndarray:
    """(channels, 2) of lowest and highest: from a sequence of pairs, or a mapping from names; infinity is no limit."""
    if values is None:
        return np.array(default, dtype=float)
    limits = np.array(default, dtype=float)
    if not isinstance(values, Mapping):
        if len(values) != len(channels):
            raise ValueError(f"{name} holds {len(values)} pairs; give one for each of {', '.join(channels)}.")
        values = dict(zip(channels, values))
    for key, pair in values.items():
        require_known(name, key, channels)
        try:
            low, high = map(float, pair)
        except (TypeError, ValueError):
            low = high = np.nan
        if not low < high:
            raise ValueError(f"{name}[{key!r}] is {pair!r}; give (lowest, highest).")
        limits[channels.index(key)] = low, high
    return limits


def _number(name, value):
    number(name, value, 0, give="a finite number, 0 or more")
    return float(value)


def require_known(name, key, channels):
    if key not in channels:
        raise ValueError(f"{name} names {key!r}, which the model does not have{did_you_mean(key, channels)}")
