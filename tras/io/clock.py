"""From a column to the time in seconds: which one it is, its unit, and the even grid that its stamps stand on."""

import numpy as np

from tras.io import words

_UNEVEN_STEPS = 0.01  # of the steps of a column without a name of time
_EPOCHS = {"ns": 1e18, "us": 1e15, "ms": 1e12, "s": 1e9}  # 2001; up to five times as much, 2128: stamps since 1970
_STEPS = ((1e6, "ns"), (1e3, "us"), (2, "ms"))  # whole numbers that rise by at least as much
_LOOKED_AT = 100_000  # samples
_LONG = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds", "s": "seconds"}


def seconds(name: str, unit: str | None) -> tuple[int, int] | None:
    """(numerator, denominator) that convert the column of time ``name`` with ``unit`` to s; None for an unknown unit.

    >>> seconds("t", "ms"), seconds("Time_us", ""), seconds("t", "rpm")
    ((1, 1000), (1, 1000000), None)
    """
    unit = (unit or words.unit_in(name) or "s").strip().lower()
    return words.UNITS_OF_TIME.get(unit)


def guess_unit(values: np.ndarray) -> tuple[str, str]:
    """The unit of whole-numbered stamps and the reason, or ("", "") for seconds without a word.

    >>> guess_unit(np.arange(5) * 10_000_000)
    ('ns', 'it steps by 10 000 000: nanoseconds')
    >>> guess_unit(np.arange(5) * 20.0)
    ('ms', 'it steps by 20: milliseconds')
    >>> guess_unit(np.arange(5) * 0.02), guess_unit(np.arange(5))
    (('', ''), ('', ''))
    >>> guess_unit(1_700_000_000_000_000 + np.arange(5) * 20.0)
    ('us', 'its stamps, since 1970, have 16 digits: microseconds')
    """
    values = values[:_LOOKED_AT]
    values = values[np.isfinite(values)]
    steps = np.diff(values)
    steps = steps[steps > 0]
    whole = np.abs(values[:1000] - np.round(values[:1000])) < 1e-6
    if not steps.size or not whole.all():
        return "", ""
    step = float(np.median(steps))
    unit = next((unit for unit, size in _EPOCHS.items() if size <= values.min() <= values.max() < 5 * size), None)
    unit = None if unit == "s" and step >= 1000 else unit  # microseconds since a quarter of an hour ago
    why = f"its stamps, since 1970, have {len(str(int(values.max())))} digits"
    if unit is None:
        unit = next((unit for size, unit in _STEPS if step >= size), None)
        why = f"it steps by {step:,.0f}".replace(",", " ")
    return (unit, f"{why}: {_LONG[unit]}") if unit else ("", "")


def rises(values: np.ndarray) -> bool:
    """Whether a column rises, apart from repeated stamps and from trials that begin anew; or falls, as if sorted.

    >>> rises(np.array([0, 1, 1, 2, 0, 1, 2])), rises(np.array([0.0, 3, 1, 4, 1, 5]))
    (True, False)
    """
    values = values[:_LOOKED_AT]
    steps = np.diff(values[np.isfinite(values)])
    if not steps.any():
        return True  # it stands still: time, but a broken one
    share = np.mean(steps >= 0)
    return bool((share >= 0.6 and np.any(steps > 0) and _mostly_equal(steps, 0.5)) or np.all(steps < 0))


def rises_evenly(values: np.ndarray) -> bool:
    """Whether nearly all steps of a column are the same and positive: whatever it is called, it is the time.

    >>> rises_evenly(np.arange(9) * 0.02), rises_evenly(np.array([0.0, 1, 3, 4, 5]))
    (True, False)
    """
    steps = np.diff(values)
    return bool(len(steps) > 2 and np.isfinite(values).all() and _mostly_equal(steps, 1 - _UNEVEN_STEPS))


def is_counter(values: np.ndarray) -> bool:
    """Whether a column only counts the rows: 0, 1, 2 ..."""
    return bool(values[0] in (0, 1)) and bool((np.diff(values) == 1).all())


def _mostly_equal(steps, share):
    forward = steps[steps > 0]
    if not forward.size:
        return False
    middle = np.median(forward)
    return np.mean(np.abs(steps - middle) <= 0.25 * middle) >= share or np.mean(steps >= 0) >= 0.98 > share


def grid(times: list) -> tuple[float, float, float]:
    """The step of the even grid that rising stamps stand on, their largest distance from it, and their rounding.

    The step is that of straight lines through all stamps, one line per trajectory, least squares; made a number of few
    digits where such a one explains the stamps as well.

    Parameters
    ----------
    times : list of (samples,) arrays
        In s, one per trajectory.

    Returns
    -------
    step, deviation, quantum : float
        In s. The quantum is that of stamps that are all rounded to a decimal place, else 0.

    Examples
    --------
    >>> step, deviation, quantum = grid([np.round(np.arange(400) * 0.005, 2)])
    >>> step, quantum
    (0.005, 0.01)
    """
    stretches = [(np.arange(float(len(t))), t - t[0]) for t in times if len(t) > 1]
    moments = [(k @ t - t.sum() * (len(k) - 1) / 2, len(k) * (len(k) ** 2 - 1) / 12) for k, t in stretches]
    step = float(sum(product for product, _ in moments) / sum(power for _, power in moments))

    def worst(step):
        rests = [np.subtract(t, line, out=line) for k, t in stretches for line in [k * step]]
        return max(float(rest.max() - rest.min()) / 2 for rest in rests)

    grain = 4 * np.spacing(max(max(abs(float(t[0])), abs(float(t[-1]))) for t in times))  # of doubles
    deviation = worst(step)
    limit = 1.2 * deviation + grain
    reach = max((len(k) - 1) / 2 for k, _ in stretches)  # samples from the middle, where another step is off most
    for plain in (float(f"{step:.{digits}e}") for digits in range(15)):
        if abs(plain - step) * reach <= limit + deviation and (rest := worst(plain)) <= limit:
            step, deviation = plain, rest
            break
    return step, float(deviation), _quantum([t for t in times if len(t) > 1])


def is_rounded(steps: np.ndarray, step: float, deviation: float, quantum: float) -> bool:
    """Whether rounding alone explains steps that are not equal: two neighbouring numbers of quanta, both often.

    One step that is longer than all others is a lost sample.

    >>> steps = np.diff(np.round(np.arange(400) * 0.005, 2))
    >>> is_rounded(steps, 0.005, 0.0025, 0.01), is_rounded(np.r_[np.ones(50), 2.0], 1.02, 0.5, 1.0)
    (True, False)
    """
    if not quantum or deviation > 0.65 * quantum + 1e-9 * step:
        return False
    quanta = np.round(steps / quantum)
    low = np.floor(step / quantum + 1e-9)
    share = np.mean(quanta == low)
    return bool(np.all((quanta == low) | (quanta == low + 1)) and 0.1 <= share <= 0.9)


def _quantum(times):
    """The decimal place to which all stamps are rounded, or 0."""
    sample = np.concatenate([t[:2000] for t in times[:50]])
    for digits in range(10):
        scaled = sample * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) < 1e-6 + 1e-9 * np.abs(scaled)):
            return 10.0**-digits
    return 0.0
