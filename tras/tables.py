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

from tras.files import replacing

# No pandas at the top: printing the table is all that `make all` does when nothing has changed.

PAPER_NRMSE = {"yaw": 4.0589, "pitch": 5.5889}  # percent, paper, Sec. III
COLUMNS = [("reference", "gaussian"), ("reference", "linear"), ("torque", "gaussian"), ("torque", "linear")]
HEADINGS = ["paper", "ours, input = reference", "linear, reference", "ours, input = torque", "linear, torque"]
_MISSING = "not given"
BEGIN, END = "<!-- table: written by `make readme` -->", "<!-- end of table -->"
_METRICS = {"nrmse": "NRMSE (%)", "enr": "Enr", "bfr": "BFR (%)", "condition": "condition number of the liftings"}


def comparison(metrics, identification, window, free_run):
    """The numbers of the table: the metrics of both angles over the independent multisine recordings, and the conditioning.

    Parameters
    ----------
    metrics : pandas.DataFrame
        As `tras.validation.score` gives it, with the columns ``input, model`` beside.
    identification : pandas.DataFrame
        Columns ``input, model, condition``.
    window, free_run : float
        The two horizons in s.

    Returns
    -------
    pandas.DataFrame
        Columns ``horizon, metric, angle, input, model, median, lowest, highest`` (over the recordings), ``windows, diverged``. The paper's
        own numbers have the input ``paper``, the condition number of the liftings the horizon 0.
    """
    import pandas as pd

    chosen = metrics[metrics["recording"].str.startswith("multisine")].set_index(["input", "model", "horizon", "angle"]).sort_index()
    condition = identification.set_index(["input", "model"])["condition"]
    rows = []
    for horizon, name in [(window, "nrmse"), (window, "enr"), (window, "bfr"), (free_run, "nrmse")]:
        for angle in ("yaw", "pitch"):
            if name == "nrmse" and horizon == window:
                value = PAPER_NRMSE[angle]
                rows.append((horizon, name, angle, "paper", "paper", value, value, value, 0, 0))
            for source in COLUMNS:
                here = chosen.loc[[(*source, horizon, angle)]]
                v = here[name]
                rows.append((horizon, name, angle, *source, v.median(), v.min(), v.max(), here["windows"].sum(), here["diverged"].sum()))
    for source in COLUMNS:
        value = condition[source]
        rows.append((0, "condition", "", *source, value, value, value, 0, 0))
    columns = ["horizon", "metric", "angle", "input", "model", "median", "lowest", "highest", "windows", "diverged"]
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
    if readme.count(BEGIN) != 1 or readme.count(END) != 1:
        raise ValueError(f"the README must hold {BEGIN!r} and {END!r} once each, around the place for the table; put them back.")
    before, rest = readme.split(BEGIN)
    return f"{before}{BEGIN}\n{markdown(rows)}\n{END}{rest.split(END)[1]}"


def _cells(rows):
    """Rows of strings, the heading first."""
    cells = [["", *HEADINGS]]
    longest = max(row["horizon"] for row in rows)
    for (horizon, metric, angle), group in itertools.groupby(rows, key=lambda row: (row["horizon"], row["metric"], row["angle"])):
        kind = "free run" if horizon == longest else "windows"
        label = f"{_METRICS[metric]}, {angle}, {horizon:g} s {kind}" if horizon else _METRICS[metric]
        by_source = {(row["input"], row["model"]): row for row in group}
        cells.append([label, *(_number(by_source.get(source)) for source in [("paper", "paper"), *COLUMNS])])
    for horizon in sorted({row["horizon"] for row in rows} - {0}):
        counts = {(row["input"], row["model"]): f"{row['diverged']} of {row['windows']}" for row in rows if row["horizon"] == horizon}
        cells.append([f"diverged, {horizon:g} s", _MISSING, *(counts[source] for source in COLUMNS)])
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
    digits = 3 if row["highest"] < 1 else 2 if row["highest"] < 10 else 1
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
