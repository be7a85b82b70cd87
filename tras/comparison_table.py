"""The comparison as one short table, and into the README: ``python -m tras.comparison_table data/comparison.csv [--readme README.md]``."""

import argparse
import csv
import math
import statistics
import sys
from pathlib import Path

from tras import files

BEGIN, END = "<!-- comparison: written by `make readme` -->", "<!-- end of comparison -->"
LEFT_OUT = ("grey box",)  # knows the equations; it stands in the sentence below
COLUMNS = (("reference", "window"), ("torque", "window"), ("torque", "free run"))


def summary(rows):
    """Rows of the table: method -> {"parameters": {input: int}, (input, kind, angle): (median, diverged, windows)}.

    Parameters
    ----------
    rows : sequence of dict
        Of ``comparison.csv``; only its multisines count.
    """
    rows = [row for row in rows if row["recording"].startswith("multisine")]
    if not rows:
        raise ValueError("the comparison holds no multisine recording; make it again with make all.")
    horizons = sorted({float(row["horizon"]) for row in rows})
    if len(horizons) < 2:
        raise ValueError(f"the comparison holds the horizons {horizons}; at least a window and a free run are needed.")
    kinds = {horizons[-2]: "window", horizons[-1]: "free run"}
    found = {}
    for row in rows:
        entry = found.setdefault(row["method"], {"parameters": {}})
        entry["parameters"][row["input"]] = row["parameters"]
        if float(row["horizon"]) in kinds:
            values = entry.setdefault((row["input"], kinds[float(row["horizon"])], row["angle"]), [[], 0, 0])
            values[0].append(float(row["nrmse"] or "nan"))
            values[1] += int(row["diverged"])
            values[2] += int(row["windows"])
    return found, horizons


def markdown(rows):
    """The table as Markdown, at most ten methods, and a sentence on the grey box."""
    found, horizons = summary(rows)
    window, free = (f"{h:g} s" for h in horizons[-2:])
    heads = [f"{name}, {window if kind == 'window' else free}: yaw / pitch" for name, kind in COLUMNS]
    lines = [["method", "parameters", *heads], ["---"] * (len(heads) + 2)]
    for method, entry in found.items():
        if method in LEFT_OUT:
            continue
        counts = "; ".join(dict.fromkeys(str(int(float(count))) for count in entry["parameters"].values() if count not in ("", None)))
        lines.append([method, counts, *[_cell(entry, *column) for column in COLUMNS]])
    text = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    for method in LEFT_OUT:
        if method in found:
            text += f"\n\nThe {method}, the plant's own equations with eight parameters from the same data, has {_cell(found[method], 'torque', 'window')} % over {window}: the bound."
    return text


def _cell(entry, *column):
    cells, lost = [], ""
    for angle in ("yaw", "pitch"):
        errors, diverged, windows = entry.get((*column, angle), ([], 0, 0))
        kept = [error for error in errors if not math.isnan(error)]
        cells.append(f"{statistics.median(kept):.3g}" if kept else "-")
        lost = f" ({diverged} of {windows} diverged)" if diverged else ""
    return " / ".join(cells) + lost if entry.get((*column, "yaw")) else "-"


def main(arguments=None):
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tras.comparison_table", description="Print the comparison of methods, or write it into the README.")
    parser.add_argument("comparison", type=Path, help="data/comparison.csv, made by the notebook 07_comparison")
    parser.add_argument("--readme", type=Path, help="write the table into this file, between its markers")
    options = parser.parse_args(arguments)
    for path in filter(None, (options.comparison, options.readme)):
        if not path.is_file():
            print(f"{path} does not exist; `make all` makes the comparison.", file=sys.stderr)
            return 2
    try:
        with open(options.comparison, newline="", encoding="utf-8") as file:
            table = markdown(list(csv.DictReader(file)))
        if not options.readme:
            print(table)
            return 0
        files.write_between(options.readme, BEGIN, END, table)
    except (OSError, ValueError, KeyError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
