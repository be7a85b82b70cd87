"""Ranges of channels, which become [-1, 1]."""

import numpy as np


def ranges_of(recording):
    """Channel -> (lowest, highest) over a recording."""
    x, u = (np.concatenate(part) for part in zip(*recording))
    both = zip((*recording.state_names, *recording.input_names), (*x.T, *u.T))
    return {name: (values.min(), values.max()) for name, values in both}


def checked(ranges, recording):
    """``ranges`` as somebody gave them, in the order of the recording's channels; None stays None.

    Raises
    ------
    ValueError
        If a channel has none, or one that is no range.
    """
    if ranges is None:
        return None
    chosen = {}
    for name in (*recording.state_names, *recording.input_names):
        try:
            low, high = map(float, ranges[name])
        except (KeyError, TypeError, ValueError):
            raise ValueError(f"ranges holds no pair (lowest, highest) for the channel {name!r}; give one for each channel.") from None
        if not (np.isfinite([low, high]).all() and low < high):
            raise ValueError(f"ranges has ({low:g}, {high:g}) for the channel {name!r}; give two finite numbers, the lower one first.")
        chosen[name] = low, high
    return chosen


def middle_and_half(ranges, names):
    """Middle and half-range of the named channels, two arrays.

    Raises
    ------
    ValueError
        If a channel is constant.
    """
    low, high = np.array([ranges[name] for name in names], dtype=float).reshape(-1, 2).T
    half = (high - low) / 2
    constant = half <= 1e-12 * np.maximum(np.abs(low), np.abs(high))
    if constant.any():
        i = int(np.argmax(constant))
        raise ValueError(
            f"channel {names[i]!r} is constant ({low[i]:g}) over the whole recording: nothing can be learnt about it; leave it out "
            "with recording.select(...)."
        )
    return (high + low) / 2, half
