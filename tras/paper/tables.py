"""The tables of the README: the paper's numbers beside ours, and the methods that were compared; none of them is typed.

`tras.paper.pages` prints them and writes them into the pages.
"""

import csv
import itertools
import math
import operator
import statistics
from numbers import Integral

from tras.workflow.files import markdown_table

# No pandas at the top: printing one table is all that `make all` does when nothing has changed.

COLUMNS = {  # (input, model) -> heading
    ("paper", "paper"): "paper",
    ("reference", "gaussian"): "input = reference, paper's dictionary",
    ("reference", "linear"): "reference, linear",
    ("torque", "gaussian"): "input = torque, paper's dictionary",
    ("torque", "linear"): "torque, linear",
    ("torque", "mechanical"): "torque, mechanical",
}
_MISSING = "not given"
_FIRST = [
    ("window", "nrmse", "yaw"),
    ("window", "nrmse", "pitch"),
    ("window", "bfr", "yaw"),
    ("window", "bfr", "pitch"),
]
_FIRST += [("free run", "nrmse", "pitch")]  # the rows that tell most, for the README
_BOUND = "grey box"  # knows the equations: it stands in a sentence below the table of methods
_METHOD_COLUMNS = (("reference", "window"), ("torque", "window"), ("torque", "free run"))
_METRICS = {"nrmse": "NRMSE (%)", "enr": "Enr", "bfr": "BFR (%)", "condition": "condition number of the liftings"}


def comparison(metrics, identification):
    """The numbers of the table: metrics of both angles over the independent multisines, and the conditioning.

    Parameters
    ----------
    metrics : pandas.DataFrame
        As `tras.paper.validation.score` gives it, with the columns ``kind`` ("window" or "free run"), ``input, model``
        beside.
    identification : pandas.DataFrame
        Columns ``input, model, condition``.

    Returns
    -------
    pandas.DataFrame
        Columns ``kind, horizon, metric, angle, input, model, median, lowest, highest`` (over the recordings),
        ``windows, diverged``. The paper's own numbers have the input ``paper``; the condition number of the liftings
        the kind ``fit``.
    """
    import pandas as pd

    from tras.paper.readings import PAPER_NRMSE

    multisines = metrics[metrics["recording"].str.startswith("multisine")]
    multisines = multisines.set_index(["kind", "input", "model", "angle"]).sort_index()
    condition = identification.set_index(["input", "model"])["condition"]
    sources = [source for source in COLUMNS if source[0] != "paper"]
    rows = []
    for kind, name in [("window", "nrmse"), ("window", "enr"), ("window", "bfr"), ("free run", "nrmse")]:
        for angle in ("yaw", "pitch"):
            for source in sources:
                group = multisines.loc[[(kind, *source, angle)]]
                horizon, counts = group["horizon"].iloc[0], group[["windows", "diverged"]].sum()
                rows.append((kind, horizon, name, angle, *source, *group[name].agg(["median", "min", "max"]), *counts))
            if kind == "window" and name == "nrmse":
                rows.append((kind, horizon, name, angle, "paper", "paper", *[PAPER_NRMSE[angle]] * 3, 0, 0))
    rows += [("fit", 0, "condition", "", *source, *[condition[source]] * 3, 0, 0) for source in sources]
    columns = "kind horizon metric angle input model median lowest highest windows diverged"
    return pd.DataFrame(rows, columns=columns.split())


def read(path) -> list[dict[str, str]]:
    """Rows of a CSV file as dictionaries of text."""
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def shown(table, spec: str = ".3g"):
    """A DataFrame of numbers as text for a notebook: a dash where there is none, counts and words as they are.

    Examples
    --------
    >>> import pandas as pd
    >>> shown(pd.DataFrame({"error": [0.12345, None], "windows": [1412, 83]})).to_numpy().tolist()
    [['0.123', '1412'], ['–', '83']]
    """
    import pandas as pd

    def text(value):
        if pd.isna(value):
            return "–"
        return str(value) if isinstance(value, str | Integral) else format(value, spec)

    return table.map(text)


def markdown(rows: list[dict]) -> str:
    """The table paper against ours: one row per metric and angle, one column per source."""
    return markdown_table(_cells(rows))


def first_markdown(rows: list[dict]) -> str:
    """The five rows of it that tell most."""
    return markdown_table(_cells([row for row in rows if (row["kind"], row["metric"], row["angle"]) in _FIRST], False))


def text(rows: list[dict]) -> str:
    """The same for a terminal."""
    cells = _cells(rows)
    widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in cells)


def _cells(rows, divergence=True):
    """Rows of strings, the heading first."""
    numbers = ("horizon", "median", "lowest", "highest")
    rows = [row | {name: float(row[name] or "nan") for name in numbers} for row in rows]
    cells = [["", *COLUMNS.values()]]
    kinds = {"window": "s windows", "free run": "s free run"}
    for (kind, metric, angle), group in itertools.groupby(rows, operator.itemgetter("kind", "metric", "angle")):
        group = list(group)
        label = _METRICS[metric]
        if kind in kinds:
            label += f", {angle}, {group[0]['horizon']:g} {kinds[kind]}"
        by_source = {(row["input"], row["model"]): _number(row) for row in group}
        cells.append([label, *(by_source.get(source, _MISSING) for source in COLUMNS)])
    for kind, words in kinds.items() if divergence else ():
        ours = [row for row in rows if row["kind"] == kind and row["input"] != "paper"]
        counts = {(row["input"], row["model"]): f"{row['diverged']} of {row['windows']}" for row in ours}
        label = f"diverged, {ours[0]['horizon']:g} {words}"
        cells.append([label, *(counts.get(source, _MISSING) for source in COLUMNS)])
    return cells


def _number(row):
    if math.isnan(row["median"]):
        return "all diverged"
    if row["metric"] == "condition":
        return f"{row['median']:.1e}"
    if row["lowest"] == row["highest"]:
        return f"{row['median']:.5g}"
    digits = max(1, 2 - math.floor(math.log10(row["highest"])))  # three significant ones in the largest
    return "{median:.{digits}f} ({lowest:.{digits}f} to {highest:.{digits}f})".format(**row, digits=digits)


# --- methods beside ours ----------------------------------------------------------------------------------------------


def methods(rows: list[dict]) -> tuple[dict, list[float]]:
    """Errors of each method over the multisines of ``comparison.csv``, from its rows.

    Returns
    -------
    entries : dict
        Method -> {"parameters": {input: count}, (input, kind, angle): [errors, diverged, windows]}.
    horizons : list of float
    """
    rows = [row for row in rows if row["recording"].startswith("multisine")]
    if not rows:
        raise ValueError("the comparison holds no multisine recording; make it again with make all.")
    horizons = sorted({float(row["horizon"]) for row in rows})
    if len(horizons) < 2:
        raise ValueError(f"the comparison holds the horizons {horizons}; at least a window and a free run are needed.")
    kinds = {horizons[-2]: "window", horizons[-1]: "free run"}
    entries = {}
    for row in rows:
        entry = entries.setdefault(row["method"], {"parameters": {}})
        entry["parameters"][row["input"]] = row["parameters"]
        if float(row["horizon"]) in kinds:
            values = entry.setdefault((row["input"], kinds[float(row["horizon"])], row["angle"]), [[], 0, 0])
            values[0].append(float(row["nrmse"] or "nan"))
            values[1] += int(row["diverged"])
            values[2] += int(row["windows"])
    return entries, horizons


def methods_markdown(rows: list[dict]) -> str:
    """The table of methods, and a sentence on the grey box."""
    entries, horizons = methods(rows)
    bound = entries.pop(_BOUND, None)
    spans = dict(zip(("window", "free run"), (f"{horizon:g} s" for horizon in horizons[-2:])))
    lines = [["method", "parameters", *(f"{name}, {spans[kind]}: yaw / pitch" for name, kind in _METHOD_COLUMNS)]]
    for method, entry in entries.items():
        counts = dict.fromkeys(str(int(float(count))) for count in entry["parameters"].values() if count)
        lines.append([method, "; ".join(counts), *(_yaw_pitch(entry, *column) for column in _METHOD_COLUMNS)])
    text = markdown_table(lines)
    if bound is None:
        return text
    errors = f"{_yaw_pitch(bound, 'torque', 'window')} % over {spans['window']}"
    about = f"The {_BOUND}, the plant's own equations with eight parameters from the same data"
    return f"{text}\n\n{about}, has {errors}: the bound."


def _yaw_pitch(entry, *column):
    cells, divergence = [], ""
    for angle in ("yaw", "pitch"):
        errors, diverged, windows = entry.get((*column, angle), ([], 0, 0))
        errors = [error for error in errors if not math.isnan(error)]
        cells.append(f"{statistics.median(errors):.3g}" if errors else "-")
        divergence = f" ({diverged} of {windows} diverged)" if diverged else ""
    return " / ".join(cells) + divergence if entry.get((*column, "yaw")) else "-"
