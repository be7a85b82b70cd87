"""The table paper against ours: made from the metrics, printed by `make all`, written into the README by `make readme`.

``python -m tras.tables figures/table.csv`` prints it; with ``--readme README.md`` writes it there; with ``--check README.md`` says whether
the README holds it.
"""

import argparse
import csv
import itertools
import math
import sys
from pathlib import Path

from tras.files import between, replacing

# No pandas at the top: printing the table is all that `make all` does when nothing has changed.

COLUMNS = {  # (input, model) -> heading
    ("paper", "paper"): "paper",
    ("reference", "gaussian"): "input = reference, paper's dictionary",
    ("reference", "linear"): "reference, linear",
    ("torque", "gaussian"): "input = torque, paper's dictionary",
    ("torque", "linear"): "torque, linear",
    ("torque", "mechanical"): "torque, mechanical",
}
_MISSING = "not given"
BEGIN, END = "<!-- table: written by `make readme` -->", "<!-- end of table -->"
_METRICS = {"nrmse": "NRMSE (%)", "enr": "Enr", "bfr": "BFR (%)", "condition": "condition number of the liftings"}


def comparison(metrics, identification):
    """The numbers of the table: the metrics of both angles over the independent multisine recordings, and the conditioning.

    Parameters
    ----------
    metrics : pandas.DataFrame
        As `tras.validation.score` gives it, with the columns ``kind`` ("window" or "free run"), ``input, model`` beside.
    identification : pandas.DataFrame
        Columns ``input, model, condition``.

    Returns
    -------
    pandas.DataFrame
        Columns ``kind, horizon, metric, angle, input, model, median, lowest, highest`` (over the recordings), ``windows, diverged``. The
        paper's own numbers have the input ``paper``; the condition number of the liftings the kind ``fit``.
    """
    import pandas as pd

    from tras.readings import PAPER_NRMSE

    chosen = metrics[metrics["recording"].str.startswith("multisine")].set_index(["kind", "input", "model", "angle"]).sort_index()
    condition = identification.set_index(["input", "model"])["condition"]
    sources = [source for source in COLUMNS if source[0] != "paper"]
    rows = []
    for kind, name in [("window", "nrmse"), ("window", "enr"), ("window", "bfr"), ("free run", "nrmse")]:
        for angle in ("yaw", "pitch"):
            for source in sources:
                here = chosen.loc[[(kind, *source, angle)]]
                v, horizon = here[name], here["horizon"].iloc[0]
                rows.append((kind, horizon, name, angle, *source, v.median(), v.min(), v.max(), here["windows"].sum(), here["diverged"].sum()))
            if kind == "window" and name == "nrmse":
                value = PAPER_NRMSE[angle]
                rows.append((kind, horizon, name, angle, "paper", "paper", value, value, value, 0, 0))
    for source in sources:
        value = condition[source]
        rows.append(("fit", 0, "condition", "", *source, value, value, value, 0, 0))
    columns = ["kind", "horizon", "metric", "angle", "input", "model", "median", "lowest", "highest", "windows", "diverged"]
    return pd.DataFrame(rows, columns=columns)


def read(path):
    """Rows of ``table.csv`` as dictionaries, numbers as numbers."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        for name in ("horizon", "median", "lowest", "highest"):
            row[name] = float(row[name] or "nan")
    return rows


def markdown(rows):
    """The table as Markdown: one row a metric and angle, one column a source; ``median (lowest to highest)``."""
    head, *body = _cells(rows)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [head, ["---"] * len(head), *body])


def text(rows):
    """The table for a terminal."""
    cells = _cells(rows)
    widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in cells)


def into_readme(readme, rows):
    """``readme`` (its text) with the part between the two markers replaced by the table.

    Raises
    ------
    ValueError
        If a marker is missing.
    """
    return between(readme, BEGIN, END, markdown(rows), "the README")


def _cells(rows):
    """Rows of strings, the heading first."""
    cells = [["", *COLUMNS.values()]]
    kinds = {"window": "s windows", "free run": "s free run"}
    for (kind, metric, angle), group in itertools.groupby(rows, key=lambda row: (row["kind"], row["metric"], row["angle"])):
        by_source = {(row["input"], row["model"]): row for row in group}
        horizon = next(iter(by_source.values()))["horizon"]
        label = f"{_METRICS[metric]}, {angle}, {horizon:g} {kinds[kind]}" if kind in kinds else _METRICS[metric]
        cells.append([label, *(_number(by_source.get(source)) for source in COLUMNS)])
    for kind in kinds:
        here = [row for row in rows if row["kind"] == kind]
        counts = {(row["input"], row["model"]): f"{row['diverged']} of {row['windows']}" for row in here if row["input"] != "paper"}
        cells.append([f"diverged, {here[0]['horizon']:g} {kinds[kind]}", *(counts.get(source, _MISSING) for source in COLUMNS)])
    return cells


def _number(row):
    if row is None:
        return _MISSING
    if math.isnan(row["median"]):
        return "all diverged"
    if row["metric"] == "condition":
        return f"{row['median']:.1e}"
    if row["lowest"] == row["highest"]:
        return f"{row['median']:.5g}"
    digits = max(1, 2 - math.floor(math.log10(row["highest"])))  # three significant ones in the largest
    return "{median:.{digits}f} ({lowest:.{digits}f} to {highest:.{digits}f})".format(**row, digits=digits)


def main(arguments=None):
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tras.tables", description="Print the table paper against ours, or write it into the README.")
    parser.add_argument("table", type=Path, help="figures/table.csv, made by the notebook 04_figures")
    parser.add_argument("--readme", type=Path, help="write the table into this file, between its markers")
    parser.add_argument("--check", type=Path, help="only say whether this file holds the table as it is now")
    options = parser.parse_args(arguments)
    for path in filter(None, (options.table, options.readme, options.check)):
        if not path.is_file():
            print(f"{path} does not exist; `make all` makes the table.", file=sys.stderr)
            return 2
    table = read(options.table)
    if options.readme:
        new = into_readme(options.readme.read_text(encoding="utf-8"), table)
        with replacing(options.readme) as temporary:
            temporary.write_text(new, encoding="utf-8")
    else:
        print(text(table))
    if options.check and markdown(table) not in options.check.read_text(encoding="utf-8"):
        print(f"\n{options.check} holds another table; `make readme` writes this one into it.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
