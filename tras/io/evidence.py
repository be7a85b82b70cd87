"""What the values of a column tell: held in steps like an input, limited like an actuator, following a reference."""

import numpy as np

_MOST, _FEWEST = 200_000, 20  # samples that are looked at, and that tell anything


def moves(values: np.ndarray) -> bool:
    """Whether the finite values differ.

    >>> moves(np.array([1.0, np.nan, 1.0])), moves(np.array([1.0, 2.0]))
    (False, True)
    """
    for part in (values[:1000], values):  # the first is enough for most
        finite = part[np.isfinite(part)]
        if finite.size and (finite != finite[0]).any():
            return True
    return False


def is_held(values: np.ndarray) -> bool:
    """Whether a column stays and then jumps by a good part of its range: steps, a square wave, a random binary signal.

    Coarsely measured states also stay, but then they move by the smallest step there is.

    >>> is_held(np.repeat([0.0, 1.0, 0.3, 0.9], 20)), is_held(np.round(np.sin(np.arange(80) / 9), 1))
    (True, False)
    """
    values = values[:_MOST]
    jumps = np.abs(np.diff(values))
    jumps = jumps[jumps > 0]
    if len(values) < _FEWEST or not 0 < jumps.size <= 0.25 * len(values):
        return False
    return bool(np.median(jumps) > 0.08 * (np.nanmax(values) - np.nanmin(values)))


def is_limited(values: np.ndarray) -> bool:
    """Whether a column stays at its lowest and its highest value far more often than next to them: it saturates.

    >>> is_limited(np.clip(2 * np.sin(np.arange(300) / 9), -1, 1)), is_limited(np.round(np.sin(np.arange(300) / 9), 2))
    (True, False)
    """
    _, counts = np.unique(values[:_MOST][np.isfinite(values[:_MOST])], return_counts=True)
    return len(counts) > 3 and bool(
        min(counts[0] - 4 * counts[1], counts[-1] - 4 * counts[-2], counts[0] - 9, counts[-1] - 9) > 0
    )


def roughness(values: np.ndarray) -> float:
    """Root mean square of the steps from sample to sample, as a part of the standard deviation."""
    values = values[:_MOST][np.isfinite(values[:_MOST])]
    return float(np.sqrt(np.mean(np.diff(values) ** 2)) / values.std()) if len(values) > 2 and values.std() else 0.0


def follows(state: np.ndarray, reference: np.ndarray) -> bool:
    """Whether a state comes near a reference in its own units: most samples within a tenth of its range.

    >>> r = np.repeat([0.0, 1.0, 0.0, 1.0], 50)
    >>> y = 1 - np.exp(-np.arange(50) / 5)
    >>> follows(np.r_[0 * y, y, 1 - y, y], r), follows(5 * r, r)
    (True, False)
    """
    state, reference = state[:_MOST], reference[:_MOST]
    span = np.nanmax(reference) - np.nanmin(reference)
    return bool(span > 0 and np.nanmedian(np.abs(state - reference)) < 0.1 * span and _alike(state, reference))


def are_apart(states: list, inputs: list) -> bool:
    """Whether each state is predicted by itself and its own input, and no better with the others' help.

    Linear, two samples back, least squares; better is a tenth of the residual's power. Inputs that are multiples of
    each other are repetitions: as inputs of one system they would tell nothing.

    >>> rng = np.random.default_rng(0)
    >>> u, v = rng.normal(size=(2, 300))
    >>> y, z = (np.convolve(part, 0.9 ** np.arange(300))[:300] for part in (u, v))
    >>> are_apart([y, z], [u, v]), are_apart([y, z + np.roll(y, 3)], [u, v])
    (True, False)
    """
    columns = np.array([*states, *inputs])[:, :_MOST]
    columns = columns[:, np.isfinite(columns).all(axis=0)]
    if columns.shape[1] < max(50, 10 * len(columns)):
        return False
    columns = columns - columns.mean(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        if np.abs(np.corrcoef(columns[len(states) :])).min() > 0.9999:
            return True
    past = [np.stack([column[1:-1], column[:-2]]) for column in columns]
    for i in range(len(states)):
        own, target = np.vstack([past[i], past[i + len(states)]]), columns[i, 2:]
        alone, together = (
            np.sum((target - np.linalg.lstsq(rows.T, target, rcond=None)[0] @ rows) ** 2)
            for rows in (own, np.vstack(past))
        )
        if together < 0.9 * alone:
            return False
    return True


def _alike(a, b):
    finite = np.isfinite(a) & np.isfinite(b)
    a, b = a[finite] - a[finite].mean(), b[finite] - b[finite].mean()
    return len(a) > 2 and a @ b > 0.5 * np.sqrt((a @ a) * (b @ b))


def guesses(columns: dict, references: set, states: list, *, has_inputs: bool) -> dict:
    """A guess for each of some columns of which no role is plain: name -> ("state", "input" or "reference", why).

    Parameters
    ----------
    columns : dict
        Name -> (rows,) floats.
    references : set of str
        Those that are references by name.
    states : list of (rows,) arrays
        What is known to be a state.
    has_inputs : bool
        Whether an input is known.

    Examples
    --------
    >>> u = np.repeat([0.0, 1.0, 0.0, 1.0], 50)
    >>> y = np.convolve(u, np.exp(-np.arange(200) / 20) / 20)[:200]
    >>> guesses({"1": u, "2": y}, set(), [], has_inputs=False)
    {'1': ('input', 'held in steps'), '2': ('state', '')}
    """
    table = {}
    for name, column in columns.items():
        if name in references:
            table[name] = ("reference", "name")
        elif is_held(column):
            table[name] = ("input", "held in steps")
        elif is_limited(column):
            table[name] = ("input", "between limits")
        else:
            table[name] = ("state", "")
    free = [name for name, (guess, _) in table.items() if guess == "state"]
    if not states and not free and table:
        smoothest = min(table, key=lambda name: roughness(columns[name]))
        table[smoothest] = ("state", "the smoothest")
        free = [smoothest]
    responses = [*states, *(columns[name] for name in free)]
    for name, (guess, _) in table.items():
        if guess == "input" and any(follows(response, columns[name]) for response in responses):
            if has_inputs or any(table[other][0] == "input" for other in table if other != name) or len(free) > 1:
                table[name] = ("reference", "followed by a state")
    if not has_inputs and not any(guess == "input" for guess, _ in table.values()):
        table |= _inputs_of_need(table, columns, free, bool(states))
    return table


def _inputs_of_need(table, columns, free, has_states):
    """Where nothing looks like an input: the roughest of the columns, else the references."""
    if len(free) > (0 if has_states else 1):
        rough = {name: roughness(columns[name]) for name in free}
        top = max(rough.values())
        chosen = [name for name in free if rough[name] >= 0.3 * top]
        if len(chosen) == len(free) and not has_states:
            chosen = [max(rough, key=rough.get)]
        return dict.fromkeys(chosen, ("input", "the roughest"))
    return {name: ("input", "a reference") for name, (guess, _) in table.items() if guess == "reference"}
