"""When two numbers count as the same: the class of every row that `make verify` compares.

*Exact on any processor* (`EXACT`): within a tolerance that was measured with other kernels of BLAS and NumPy.
*Sensitive* (`SENSITIVE`): training, choices or roll-outs that turn a rounding unit of the data into a visible change.
What a row does over perturbations of one rounding unit, which `make bless` recomputes (`tras.paper.sensitivity`), is
then its own measure.
"""

import fnmatch
from pathlib import Path
from typing import NamedTuple

from tras.paper import artefacts as copies

# No NumPy at the top: with equal bytes there is nothing to calculate.


class Exact(NamedTuple):
    """|ours - reference| <= rtol |reference| + atol (largest |reference| in a column) + FLOOR."""

    pattern: str
    rtol: float
    atol: float
    why: str


class Sensitive(NamedTuple):
    """Rows of a table that differ from processor to processor.

    ``values`` are the columns that hold results; the others are keys, which say which row is which. ``rows``: a row is
    sensitive if it fits one of these dicts, key column -> values. ``choice``: columns that say which row of a case is
    chosen, by which score, and which key tells the rows of a case apart.
    """

    table: str
    values: tuple[str, ...]
    rows: tuple[dict, ...]
    why: str
    choice: tuple[str, str, str] | None = None


# The first pattern that fits. Measured with other kernels of BLAS, two threads, NumPy without AVX-512 (docs/verify.md).
EXACT = [
    Exact("*.nc", 1e-9, 1e-12, "a stable closed loop forgets rounding: 4e-15 of a channel's largest value"),
    Exact(
        "*.npz", 1e-6, 1e-10,
        "rounding times a condition number: 7e-13 of a matrix's largest entry, 1e-3 of its smallest",
    ),
    Exact("*/parameters.csv", 1e-5, 0, "errors of 1e-4 % in a parameter, differences of nearly equal numbers: 1.1e-6"),
    Exact(
        "*/portrait.csv", 1e-8, 1e-11,
        "sums of terms as large as the field: 3.3e-10 of a number, 2.7e-12 of a column's largest where they cancel",
    ),
    Exact("*.csv", 1e-6, 1e-12, "errors of models: 5.5e-7 of a number, 2.1e-8 in the paper's part"),
]  # fmt: skip
FLOOR = 1e-12  # smaller numbers are rounding in every unit used here: residuals that would be zero in exact arithmetic
WIDER = 2.0  # a sensitive number may lie outside its interval by so many times the interval's width (docs/verify.md)
LOST = "diverged"  # this count may also be one further, and then the row is compared by it alone

# Cases of the comparison that one rounding unit of the data moves by more than 1e-7.
RIVALS = (
    {"method": ("neural network",)},
    {"method": ("Hammerstein-Wiener", "NARX", "EDMD (pykoop)"), "noise": (0,)},
    {"method": ("Hammerstein-Wiener", "NARX"), "smoothed": (True,)},
)
_WHOLE = ({"method": ("neural network", "Hammerstein-Wiener", "NARX", "EDMD (pykoop)")},)  # without noise, on all data
_TRAINED = "a trained network; with little data polynomials whose roll-outs just diverge; fits that end by a tolerance"
_READINGS = ({"dictionary": ("monomials3",), "state": ("delayed_angles",)},)
_DIVERGES = "delayed angles with monomials of degree 3: roll-outs that just diverge, or not"
_SCORES = ("enr", "bfr", "nrmse", "windows", "diverged", "parameters", "failure")
_MEDIANS = ("nrmse", "low", "high", "windows", "diverged", "parameters")
_PAIR = tuple(f"{angle}{end}" for angle in ("yaw", "pitch") for end in ("", "_lowest", "_highest"))
_DISTANCES = ("distance", "distance_lowest", "distance_highest")
SENSITIVE = [
    Sensitive("data/comparison.csv", _SCORES, _WHOLE, _TRAINED),
    Sensitive("data/comparison_data.csv", _SCORES, RIVALS, _TRAINED),
    Sensitive(
        "data/comparison_tuning.csv", ("error", "chosen", "failure"), RIVALS, _TRAINED, ("chosen", "error", "setting"),
    ),
    Sensitive("figures/comparison_horizon.csv", _MEDIANS, _WHOLE, _TRAINED),
    Sensitive("figures/comparison_window.csv", _MEDIANS, _WHOLE, _TRAINED),
    Sensitive("figures/comparison_data.csv", _MEDIANS, RIVALS, _TRAINED),
    Sensitive(
        "data/readings.csv", ("nrmse", "windows", "diverged", "outcome", "N", "condition"),
        _READINGS, _DIVERGES,
    ),
    Sensitive(
        "figures/readings_nearest.csv",
        (*_PAIR, "runs", "without_model", "windows", "diverged", "complete", *_DISTANCES),
        _READINGS, _DIVERGES,
    ),
    Sensitive(
        "figures/readings_effects.csv", ("pairs", "lost", "median", "q05", "q25", "q75", "q95"), ({},),
        "quantiles over readings, some of which just diverge",
    ),
]  # fmt: skip


def exact(artefact: Path) -> Exact:
    """The tolerance of an artefact."""
    return next(rule for rule in EXACT if fnmatch.fnmatch(str(artefact), rule.pattern))


def sensitive(artefact: Path) -> Sensitive | None:
    """The class of an artefact's sensitive rows, if it has any."""
    return next((rule for rule in SENSITIVE if rule.table == artefact.as_posix()), None)


def compare_columns(ours: dict, theirs: dict, rule: Exact, numbers=None) -> tuple[float, str]:
    """The largest deviation as a share of what is allowed, and a sentence on it.

    Parameters
    ----------
    ours : dict of str to ndarray
        As from `tras.paper.artefacts.read_columns`.
    theirs : dict of str to (rows, ndarray)
        Values in the reference, and the rows of ours that they stand for; ``None`` for all rows.
    rule : Exact
    numbers : (rows,) int ndarray, optional
        Which rows of a table these are.

    Returns
    -------
    share : float
        Above 1 outside tolerance; infinite for another shape, text, whole number, NaN or infinity.
    detail : str
        The column, row and both values; empty if nothing differs.
    """
    if set(ours) != set(theirs):
        name = min(set(ours) ^ set(theirs))
        return float("inf"), f"column {name} is only in {'ours' if name in ours else 'the reference'}"
    worst, detail = 0.0, ""
    for name, (rows, reference) in theirs.items():
        length = len(reference) if rows is None else rows[-1] + 1
        if len(ours[name]) != length:
            return float("inf"), f"{name} has {len(ours[name])} rows, the reference {length}"
        if not length:
            continue
        values = ours[name] if rows is None else ours[name][rows]
        shares = _shares(values, reference, rule)
        i, outside = int(shares.argmax()), int((shares > 1).sum())
        if shares[i] > worst:
            row = i if rows is None else int(rows[i])
            row = row if numbers is None else int(numbers[row])
            worst, detail = float(shares[i]), f"{name}, row {row + 1}: {_apart(values[i].item(), reference[i].item())}"
            detail += f", and {outside - 1} more in this column" if outside > 1 else ""
    return worst, detail


def compare_table(ours: dict, theirs: dict, intervals: dict, rule: Exact, sensitive: Sensitive) -> tuple[float, str]:
    """The same for a table with sensitive rows, which are found by their keys and compared with their intervals.

    Parameters
    ----------
    ours, theirs : dict of str to ndarray
    intervals : dict of str to ndarray
        As `tras.paper.sensitivity.interval` describes them.
    """
    import numpy as np

    if set(ours) != set(theirs):
        name = min(set(ours) ^ set(theirs))
        return float("inf"), f"column {name} is only in {'ours' if name in ours else 'the reference'}"
    wrong = _wrong_choice(ours, sensitive) if sensitive.choice else ""
    if wrong:
        return float("inf"), wrong
    mine, others = selected(ours, sensitive), selected(theirs, sensitive)
    numbers = np.flatnonzero(~mine)
    worst = compare_columns(
        {name: column[~mine] for name, column in ours.items()},
        {name: (None, column[~others]) for name, column in theirs.items()}, rule, numbers,
    )  # fmt: skip
    numbers = np.flatnonzero(mine)
    ours = {name: column[mine] for name, column in ours.items()}
    keys = [name for name in theirs if name not in sensitive.values]
    places = {key: place for place, key in enumerate(_keys(ours, keys))}
    rows = [places.pop(key, None) for key in _keys(intervals, keys)]
    if places:
        return float("inf"), f"no such row in the reference: {', '.join(min(places))}"
    there = np.array([row is not None for row in rows])
    lost = ~there & (intervals["tables"] == intervals["tables"].max())
    if lost.any():
        return float("inf"), f"a row is missing: {', '.join(_keys(intervals, keys)[int(lost.argmax())])}"
    rows = np.array([row for row in rows if row is not None], dtype=int)
    if len(rows) < len(numbers):
        return float("inf"), "a row is there twice"
    counted = _by_count(ours, rows, intervals, there)
    for name in (name for name in theirs if name in sensitive.values and name not in (sensitive.choice or ())[:1]):
        values = ours[name][rows]
        part = {end: intervals[f"{name}{end}"][there] for end in ("", *_ENDS) if f"{name}{end}" in intervals}
        if ".low" in part:
            shares = _interval_shares(values, part, rule, whole=1.0 if name == LOST else 0.0)
            shares = np.where(counted & (values.dtype.kind == "f"), 0.0, shares)
        else:
            shares = _text_shares(values, part[""])
        i, outside = int(shares.argmax()), int((shares > 1).sum())
        if shares[i] > worst[0]:
            ends = [part[end][i].item() for end in (("",) if "" in part else (".low", ".high"))]
            span = " to ".join(map(copies.text, ends))
            detail = f"{name}, row {numbers[rows[i]] + 1}: {copies.text(values[i].item())}, {span} by perturbation"
            worst = float(shares[i]), detail + (f", and {outside - 1} more in this column" if outside > 1 else "")
    return worst


def _by_count(ours, rows, intervals, there):
    """Which rows are compared by their lost windows alone.

    Those that lose so many as no perturbed copy does, whose errors are of other windows, and those that lose half of
    all or more, whose errors are of the few that happen to survive.
    """
    if LOST not in ours:
        return False
    low, high = (intervals[f"{LOST}{end}"][there] for end in (".low", ".high"))
    lost = ours[LOST][rows]
    return (lost < low) | (lost > high) | (2 * high >= ours["windows"][rows])


def _wrong_choice(columns, rule):
    """A sentence on the first case whose chosen row is not the one with the least score, if there is one."""
    chosen, score, setting = rule.choice
    cases = {}
    keys = [name for name in columns if name not in (*rule.values, setting)]
    for row, case in enumerate(_keys(columns, keys)):
        cases.setdefault(case, []).append(row)
    for case, rows in cases.items():
        best = [row for row in rows if columns[chosen][row].item() == "True"]
        scores = columns[score][rows].astype(float)
        if len(best) != 1 or not columns[score][best[0]] <= scores.min() * (1 + 1e-9):
            return f"{chosen} is not the row with the least {score}: {', '.join(case)}"
    return ""


_ENDS = (".low", ".high", ".lost")


def selected(columns: dict, rule: Sensitive):
    """Which rows of a table, columns of arrays, are sensitive: (rows,) bool."""
    import numpy as np

    anyone = np.zeros(len(next(iter(columns.values()))), dtype=bool)
    for one in rule.rows:
        mask = np.ones(len(anyone), dtype=bool)
        for name, values in one.items():
            texts = set(map(copies.text, values))
            mask &= np.array([copies.text(value) in texts for value in columns[name].tolist()], dtype=bool)
        anyone |= mask
    return anyone


def _keys(columns, names):
    """The keys of each row as text."""
    return list(zip(*[[copies.text(value) for value in columns[name].tolist()] for name in names]))


def _interval_shares(values, part, rule, whole=0.0):
    """How far outside their intervals numbers are, as shares of what is allowed; a count may be ``whole`` further."""
    import numpy as np

    if values.dtype.kind not in "iubf":  # text where there were numbers
        return np.full(len(values), np.inf)
    counts = values.dtype.kind in "iub" and all(part[end].dtype.kind in "iub" for end in (".low", ".high"))
    low, high, lost = (part[end].astype(float) for end in _ENDS)
    values = values.astype(float)
    with np.errstate(invalid="ignore"):
        outside = np.maximum(np.maximum(low - values, values - high), 0.0)
        slack = whole if counts else rule.rtol * np.maximum(np.abs(low), np.abs(high)) + FLOOR
        allowed = WIDER * (high - low) + slack
        shares = np.where(outside > 0, outside / np.where(allowed > 0, allowed, np.nan), 0.0)
    shares = np.where(np.isnan(shares), np.inf, shares)
    return np.where(np.isfinite(values), shares, np.where(lost > 0, 0.0, np.inf))


def _text_shares(values, seen):
    import numpy as np

    seen = [_label(choices).split("|") for choices in seen.tolist()]
    return np.array([0.0 if _label(value) in choices else np.inf for value, choices in zip(values.tolist(), seen)])


def _label(value):
    """The text of a field; a column of empty fields was read as one of NaN."""
    return "" if value != value else str(value)


def _apart(value, reference):
    ours, theirs = copies.text(value), copies.text(reference)
    return f"{ours} for {theirs}" if ours != theirs else f"{theirs}, off by {abs(value - reference):.1e}"


def _shares(values, reference, rule):
    """|values - reference| as shares of what is allowed, elementwise."""
    import numpy as np

    kinds = {values.dtype.kind, reference.dtype.kind}
    if not kinds <= set("iub") and kinds <= set("iubf"):
        values, reference = values.astype(float), reference.astype(float)
        finite = np.isfinite(reference)
        allowed = rule.rtol * np.abs(reference) + rule.atol * np.abs(reference[finite]).max(initial=0) + FLOOR
        with np.errstate(invalid="ignore"):
            shares = np.where(finite & np.isfinite(values), np.abs(values - reference) / allowed, np.inf)
        return np.where((values == reference) | (np.isnan(values) & np.isnan(reference)), 0.0, shares)
    if not kinds <= set("iub"):
        values, reference = values.astype(str), reference.astype(str)
    return np.where(values == reference, 0.0, np.inf)
