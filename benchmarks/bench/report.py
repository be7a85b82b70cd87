"""Tables and figures of the measurements: ``benchmarks/results/``, and the tables in ``benchmarks/README.md``."""

import platform
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from tras.workflow import files

RESULTS = Path(__file__).resolve().parent.parent / "results"
ALL_PROCESSORS = "tras, all processors"  # what it gains, the clock tells
BEGIN, END = "<!-- bench: written by `make bench` -->", "<!-- end of bench -->"
COMPARED, GROWN, EXPONENTS = "peers.csv", "growth.csv", "growth_exponents.csv"
THEORY = {  # quantity -> what it grows with -> exponent
    "fit time": {"pairs": 1, "functions": 2},
    "memory": {"pairs": 0, "functions": 2},
    "roll-out time": {"trajectories": 1},
}
LAST = 10.0  # exponents are of the points in the last decade: below, what does not grow counts too
FIRST_COLUMNS = ["what", "against", "variant", "method", "version", "pairs", "functions", "trajectories"]


def exponent(x, y, level=0.95):
    """Exponent p of ``y ~ x^p`` in the last decade of x, by regression of the logarithms, with its interval.

    Returns
    -------
    dict
        ``exponent``, ``low``, ``high`` (of the two-sided interval by Student's t; NaN for two points), ``points``.

    Raises
    ------
    ValueError
        If fewer than two different x are there, or a value is not positive.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if not ((x > 0).all() and (y > 0).all()):
        raise ValueError("x and y must be positive: an exponent is a slope of logarithms.")
    large = x >= x.max() / LAST * (1 - 1e-9) if len(x) else np.zeros(0, dtype=bool)
    if len(np.unique(x[large])) < 2:
        raise ValueError(f"{large.sum()} points in the last decade of x; give at least two different ones.")
    u, v, points = np.log(x[large]), np.log(y[large]), int(large.sum())
    u, v = u - u.mean(), v - v.mean()
    slope = u @ v / (u @ u)
    deviation = np.sqrt(np.sum((v - slope * u) ** 2) / (points - 2) / (u @ u)) if points > 2 else np.nan
    half = stdtrit(points - 2, 0.5 + level / 2) * deviation if points > 2 else np.nan
    return {"exponent": slope, "low": slope - half, "high": slope + half, "points": points}


def exponents(grown):
    """Table of fitted exponents beside the theory; one row per quantity, abscissa and variant that has two points."""
    rows = []
    good = grown[grown["outcome"].fillna("") == ""]
    for (against, variant), part in good.groupby(["against", "variant"], sort=False):
        column = part[against]
        quantities = (
            {"roll-out time": "cpu_s"} if against == "trajectories" else {"fit time": "cpu_s", "memory": "peak_mib"}
        )
        for quantity, name in quantities.items():
            if column.nunique() > 1:
                rows.append(
                    {"quantity": quantity, "against": against, "variant": variant, "theory": THEORY[quantity][against]}
                    | exponent(column, part[name])
                )
    return pd.DataFrame(rows, columns=["quantity", "against", "variant", "theory", "exponent", "low", "high", "points"])


def processor():
    """Name of the processor, from the system."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def write(folder, compared, grown):
    """The tables as CSV in the folder, each row with its date and the processor; None leaves what is there."""
    for name, table in ((COMPARED, compared), (GROWN, grown)):
        if table is None or table.empty:
            continue
        table = table.assign(processor=processor())
        first = [column for column in FIRST_COLUMNS if column in table]
        with files.replacing(Path(folder) / name) as temporary:
            table[first + [column for column in table if column not in first]].to_csv(temporary, index=False)
        if name == GROWN:
            with files.replacing(Path(folder) / EXPONENTS) as temporary:
                exponents(table).to_csv(temporary, index=False)


def read(folder, name):
    """A table that `write` wrote, or None."""
    path = Path(folder) / name
    return pd.read_csv(path, keep_default_na=True) if path.is_file() else None


def text(folder):
    """All tables of a folder as Markdown."""
    compared, grown = read(folder, COMPARED), read(folder, EXPONENTS)
    parts = [] if compared is None else comparison(compared)
    if grown is not None and len(grown):
        parts.append(
            "**How our cost grows**: exponents in the last decade, with 95 % intervals, beside the theory.\n\n"
            + growth_table(grown)
        )
    return "\n\n".join(parts)


def comparison(table):
    """Markdown of the comparison: fits at each number of pairs, memory, accuracy, roll-outs, what was timed."""
    table = table.assign(outcome=table["outcome"].fillna(""))
    fits, rolls = table[table["what"] == "fit"], table[table["what"] == "roll-out"]
    dates = sorted(table["measured"].dropna()) if "measured" in table else []
    parts = [f"Measured {_period(dates)} on {table['processor'].iloc[0]}, one thread."]
    for pairs, part in fits.groupby("pairs"):
        parts.append(
            f"**Fit, {_thousands(pairs)} pairs**: CPU seconds of ours, all others as multiples of it.\n\n"
            + _grid(part, _ratio)
            + _over_the_floor(part)
        )
    for pairs, part in fits.groupby("pairs"):
        extent = "MiB at the peak, beyond what interpreter, libraries and the data take"
        head = f"**Memory of a fit, {_thousands(pairs)} pairs**: {extent}."
        parts.append(f"{head}\n\n{_grid(part, _memory)}")
    for pairs, part in fits[fits["error"].notna()].groupby("pairs") if "error" in fits else []:
        scale = "largest, over the largest of its column, against extended precision"
        head = f"**Error of the coefficients, {_thousands(pairs)} pairs**: {scale}."
        parts.append(f"{head}\n\n{_grid(part, _error)}")
    if len(rolls):
        parts.append(
            "**Roll-out**, 600 steps of 100 trajectories: CPU time as a multiple of the plain NumPy loop's.\n\n"
            + _roll_outs(rolls)
        )
    failed = fits[[_failed(row) == "failed" for _, row in fits.iterrows()]]
    failures = [
        f"* {row['method']}, {_thousands(row['pairs'])} pairs, N = {row['functions']}: {row['outcome']}"
        for _, row in failed.iterrows()
    ]
    parts += ["**What failed**\n\n" + "\n".join(failures)] if failures else []
    notes = table[table["what"] == "fit"].drop_duplicates("method")
    rows = [
        [row["method"], row["version"], row["timed"]]
        for _, row in notes.iterrows()
        if isinstance(row.get("timed"), str)
    ]
    if rows:
        parts.append("**What was timed**\n\n" + _markdown(["method", "version", "timed"], rows))
    return parts


def growth_table(table):
    """Markdown of the exponents."""
    rows = []
    for _, row in table.iterrows():
        interval = "-" if np.isnan(row["low"]) else f"{row['low']:.2f} to {row['high']:.2f}"
        names = row["quantity"], row["against"], row["variant"].replace("_", " ")
        rows.append([*names, f"{row['theory']:g}", f"{row['exponent']:.2f}", interval, int(row["points"])])
    return _markdown(["quantity", "against", "method", "theory", "fitted", "interval", "points"], rows)


def publish(folder, page):
    """The tables into the page, between its markers."""
    files.write_between(page, BEGIN, END, text(folder))


def draw(folder):
    """The figures beside the tables."""
    from benchmarks.bench import figures
    from tras.plotting import save_figure

    compared, grown, fitted = (read(folder, name) for name in (COMPARED, GROWN, EXPONENTS))
    if compared is not None:
        save_figure(figures.peers_figure(compared), compared, Path(folder) / "peers")
    if grown is not None and len(fitted):
        save_figure(figures.growth_figure(grown, fitted), grown, Path(folder) / "growth")


def _period(dates):
    if not dates:
        return "at an unknown time"
    first, last = dates[0][:10], dates[-1][:10]
    return f"on {first}" if first == last else f"from {first} to {last}"


def _thousands(count):
    return f"{count:,}".replace(",", " ")


def _grid(part, cell):
    counts = sorted(part["functions"].unique())
    rows = []
    for method in part["method"].unique():
        by_count = part[part["method"] == method].set_index("functions")
        cells = [cell(by_count.loc[count]) if count in by_count.index else "" for count in counts]
        if any(cells):
            rows.append([method, *cells])
    return _markdown(["method", *(f"N = {count}" for count in counts)], rows)


def _failed(row):
    """Short words for a cell without a number."""
    outcome = row["outcome"]
    if outcome == "not measured":
        return "-"
    for word in ("out of memory", "over the time limit"):
        if outcome.startswith(word):
            return word.removeprefix("over the ")
    return "failed" if outcome else ""


def _ratio(row):
    if _failed(row):
        return _failed(row)
    if row["method"] == ALL_PROCESSORS:
        return f"{row['wall_ratio']:.3g}x by the clock"
    few = f" ({int(row['runs'])} run{'' if row['runs'] == 1 else 's'})" if row["runs"] < 5 else ""
    return (f"{row['cpu_s']:.3g} s" if row["method"] == "tras" else f"{row['cpu_ratio']:.3g}x") + few


def _over_the_floor(part):
    floor = (
        part[(part["method"] == "floor") & (part["outcome"] == "")].sort_values("functions")
        if "cpu_ratio" in part
        else part[:0]
    )
    ratios = [f"{1 / row['cpu_ratio']:.2f} at N = {row['functions']}" for _, row in floor.iterrows()]
    return f"\n\nOurs over the floor: {', '.join(ratios)}." if ratios else ""


def _memory(row):
    return _failed(row) or ("" if row["method"] == "floor" else f"{row['peak_mib']:.0f}")


def _error(row):
    return "" if np.isnan(row["error"]) else f"{row['error']:.0e}"


def _roll_outs(rolls):
    rows = []
    for _, row in rolls.iterrows():
        diverged = (
            ""
            if row["outcome"] or not row["diverged"]
            else f", {int(row['diverged'])} of {int(row['trajectories'])} diverge"
        )
        time = [_failed(row), ""] if row["outcome"] else [f"{row['cpu_s']:.3g} s", f"{row['cpu_ratio']:.3g}x"]
        how = row["timed"] if isinstance(row["timed"], str) else ""
        because = f", {row['outcome']}" if _failed(row) == "failed" else ""
        rows.append([row["method"], str(row["functions"]), *time, how + because + diverged])
    return _markdown(["method", "N", "CPU", "ratio", "how"], rows)


def _markdown(heads, rows):
    return "\n".join(
        "| " + " | ".join(line) + " |" for line in [heads, ["---"] * len(heads), *[list(map(str, row)) for row in rows]]
    )
