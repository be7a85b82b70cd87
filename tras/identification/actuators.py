"""Which states are actuators: they follow an input with a lag, and they drive an acceleration."""

from collections.abc import Sequence

import numpy as np

from tras.dictionaries.mechanical import Mechanical
from tras.recording import Recording

_FOLLOWS = 0.5  # share of an actuator's changes, at least, that its own value and the inputs explain
_DRIVES = 0.1  # share of what else leaves open of a velocity's changes, at least, that the actuator explains
_POINTS = 20_000  # changes that are looked at, at most
_SPANS = (1, 3, 10)  # samples of a change: few for a fast actuator, many against noise


def find_actuators(recording: Recording, pairs: Sequence[tuple[str, str]]) -> list[str]:
    """The states that drive a body and follow the inputs, by their numbers, in the recording's order.

    A state in no pair of a position and its velocity is an actuator if (a) its changes are explained by polynomials of
    its own value and of the inputs, and it returns by itself, and (b) changes of a velocity are explained better with
    it than without. If a state is left that is neither, there are none: `tras.Mechanical` needs every state. The
    recording's attribute ``actuators``, a list of names, decides instead if it is there.

    Parameters
    ----------
    recording : Recording
        With inputs.
    pairs : sequence of (str, str)
        Names of the positions and their velocities.

    Returns
    -------
    list of str
        Their names, empty if there are none or there is no pair.

    Raises
    ------
    ValueError
        If the attribute names something that is no state, or one in a pair.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> u, x = np.repeat(rng.uniform(-1, 1, (100, 1)), 20, axis=0), np.zeros((2000, 3))
    >>> for k in range(1999):  # position, velocity, and the speed of a motor that drives them
    ...     q, v, w = x[k]
    ...     x[k + 1] = q + 0.01 * v, v + 0.01 * (w**3 - q - 0.5 * v), w + 0.05 * (u[k, 0] - w)
    >>> log = Recording([x], [u], 0.01, state_names=["q", "v", "w"], input_names=["u"])
    >>> find_actuators(log, [("q", "v")])
    ['w']
    """
    names, named = list(recording.state_names), recording.attributes.get("actuators")
    if named is not None:
        free = [name for name in names if not any(name in pair for pair in pairs)]
        for name in named:
            if name not in free:
                among = ", ".join(free) or "none, for every state is a position or a velocity"
                raise ValueError(f"actuators: {name!r} is no state that can be one; these can: {among}.")
        return [name for name in names if name in named]
    paired = [names.index(name) for pair in pairs for name in pair]
    rest = [i for i in range(recording.n) if i not in paired]
    velocities = [names.index(velocity) for _, velocity in pairs]
    if not rest or not velocities or not recording.m:
        return []
    for span in _SPANS:
        rates = _rates(recording, span)
        if rates is not None and all(_follows(rates, i) and _drives(rates, i, velocities, rest) for i in rest):
            return [names[i] for i in rest]
    return []


def _rates(recording, span):
    """(changes, states, inputs) in half-ranges: over ``span`` samples, and the means meanwhile; None if too few."""
    every = max(1, int(recording.lengths.sum()) // _POINTS)
    parts = [_over(x, u, span, every) for x, u in recording if len(x) > span + 1]
    if not parts:
        return None
    changes, states, inputs = (np.concatenate(part) for part in zip(*parts))
    if len(changes) < 20 * (recording.n + recording.m):
        return None
    return changes - changes.mean(axis=0), _scaled(states), _scaled(inputs)


def _over(x, u, span, every):
    changes = (x[span:] - x[:-span])[::every]
    # The mean of an input over the samples from which it acts; of a state by the trapezoid.
    sums = [np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)]) for values in ((x[1:] + x[:-1]) / 2, u)]
    states, inputs = ((total[span:] - total[:-span])[::every] / span for total in sums)
    count = min(map(len, (changes, states, inputs)))
    return changes[:count], states[:count], inputs[:count]


def _scaled(values):
    low, high = values.min(axis=0), values.max(axis=0)
    return (values - (low + high) / 2) / np.where(high > low, (high - low) / 2, 1.0)


def _follows(rates, i):
    """Whether its own value and the inputs explain a state's changes, and the more of it, the slower it grows."""
    changes, states, inputs = rates
    own = _powers(states[:, [i]])
    target = changes[:, i]
    left, weights = _unexplained(np.hstack([own, _powers(inputs)]), target)
    alone, _ = _unexplained(own, target)
    at_ends = np.polynomial.polynomial.polyval([-1.0, 1.0], [0.0, *weights[: own.shape[1]]])
    return left <= 1 - _FOLLOWS and left <= 0.5 * alone and at_ends[1] < at_ends[0]


def _drives(rates, i, velocities, rest):
    """Whether a state explains what all else leaves open of a velocity's changes."""
    changes, states, inputs = rates
    others = [j for j in range(states.shape[1]) if j != i]
    body = [j for j in others if j not in rest]
    products = [states[:, j] * states[:, k] for n, j in enumerate(body) for k in body[n:]]
    known = np.column_stack([_powers(states[:, others]), inputs, *products])
    own = _powers(states[:, [i]])
    with_it = np.hstack([known, own, *(own[:, [0]] * states[:, [j]] for j in body)])
    for velocity in velocities:
        before, _ = _unexplained(known, changes[:, velocity])
        after, _ = _unexplained(with_it, changes[:, velocity])
        if before > 1e-9 and after <= (1 - _DRIVES) * before:
            return True
    return False


def _powers(values):
    """First to third powers of columns, those of a column together."""
    return np.stack([values**k for k in (1, 2, 3)], axis=2).reshape(len(values), -1)


def _unexplained(columns, target):
    """The share of a target's mean square that a least-squares fit leaves, and the fit's weights."""
    total = target @ target
    columns = np.column_stack([columns, np.ones(len(columns))])
    weights = np.linalg.lstsq(columns, target, rcond=1e-10)[0]
    rest = target - columns @ weights
    return (rest @ rest / total if total > 0 else 1.0), weights


def driven(
    recording: Recording,
    pairs: Sequence[tuple[str, str]],
    actuators: Sequence[str],
    degree: int,
    shape: str | None = None,
) -> Mechanical | None:
    """`tras.Mechanical` of a recording's positions, velocities and actuators; None if a state is neither.

    ``shape`` is the name of the position that inertia and gravity depend on; by default the first one.
    """
    if not pairs or recording.n != 2 * len(pairs) + len(actuators):
        return None
    number = recording.state_names.index
    positions, velocities = ([number(name) for name in column] for column in zip(*pairs))
    shape = [number(shape or pairs[0][0])]
    return Mechanical(degree, positions, velocities, shape, [number(name) for name in actuators] or None)
