"""The paper's numbers beside ours, as tables for the README, the notebooks and a terminal; none of them is typed.

`tras.paper.pages` prints them and writes them into the pages.
"""

import csv
import itertools
import math
import operator
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
