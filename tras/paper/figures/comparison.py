"""Figures of the comparison: error against horizon, against data and noise, and against the number of parameters."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from tras.plotting import require, styled

LINEAR = "DMDc"
FAR = 4.0  # a method so many times worse than the median one does not stretch the axis; nor does the grey box below it
WIDE = 7.0  # inches, two columns: eleven methods need their names beside them
STYLES = {
    "DMDc": ("o", "#000000", "-"),
    "N4SID": ("s", "#666666", "--"),
    "Hammerstein-Wiener": ("D", "#009E73", "-."),
    "NARX": ("v", "#B04A00", ":"),
    "neural network": ("^", "#CC79A7", "-"),
    "SINDy": ("<", "#B04A00", "--"),
    "EDMD (pykoop)": (">", "#009E73", ":"),
    "Koopman, the paper's": ("X", "#0072B2", "--"),
    "Koopman, monomials": ("P", "#0072B2", "-."),
    "Koopman, mechanical": ("*", "#0072B2", "-"),
    "grey box": ("h", "#000000", ":"),
}
_UNKNOWN = ("o", "#000000", "-")


@styled()
def horizon_figure(table: pd.DataFrame) -> Figure:
    """Median NRMSE over the multisines against the horizon, divided by that of DMDc; one panel per input and angle.

    Parameters
    ----------
    table : pandas.DataFrame
        From `horizon_table`.
    """
    require(table, "table", ["method", "input", "angle", "horizon", "nrmse", "diverged"])
    horizons = sorted(table["horizon"].unique())
    ticks = ["1 sample", *[f"{h:g} s" for h in horizons[1:]]]
    figure, panels = _panels(["reference", "torque"], "NRMSE over that of DMDc")
    linear = table[table["method"] == LINEAR].set_index(["input", "angle", "horizon"])["nrmse"]
    if linear.empty:
        raise ValueError(f"table has no method {LINEAR!r}, to which the others are related; compare it too.")
    for (column, row), axes in panels.items():
        part = table[(table["input"] == column) & (table["angle"] == row)]
        part = part.assign(nrmse=part["nrmse"] / [linear.get((column, row, h), np.nan) for h in part["horizon"]])
        _lines(axes, part.assign(at=part["horizon"].map(horizons.index)), ticks)
    return figure


@styled()
def data_figure(table: pd.DataFrame) -> Figure:
    """Median NRMSE over the multisines against the share of the data, and against noise without and with smoothing.

    Parameters
    ----------
    table : pandas.DataFrame
        From `data_table`.
    """
    require(table, "table", ["method", "input", "angle", "noise", "smoothed", "fraction", "nrmse", "diverged"])
    noisy = table[table["noise"] > 0]
    table = table[table["input"] == (table if noisy.empty else noisy)["input"].iloc[0]]
    clean, whole = table[table["noise"] == 0], table[table["fraction"] == table["fraction"].max()]
    figure, panels = _panels(["share of the training data", "noise in the training data"])
    for (column, row), axes in panels.items():
        part = clean if column.startswith("share") else whole
        part = part[part["angle"] == row]
        if column.startswith("share"):
            values = sorted(part["fraction"].unique())
            at, ticks = part["fraction"].map(values.index), [f"{100 * value:g} %" for value in values]
        else:
            pairs = list(zip(part["noise"], part["smoothed"]))
            cases = sorted(set(pairs))
            at = [cases.index(pair) for pair in pairs]
            ticks = [
                f"{level:g} %" + (", smoothed" if smoothed else "") if level else "none" for level, smoothed in cases
            ]
        _lines(axes, part.assign(at=np.asarray(at)).sort_values("at", kind="stable"), ticks)
    return figure


@styled()
def pareto_figure(table: pd.DataFrame) -> Figure:
    """NRMSE against the number of parameters, one panel per input and angle.

    Parameters
    ----------
    table : pandas.DataFrame
        From `horizon_table`, the rows of one horizon.
    """
    require(table, "table", ["method", "input", "angle", "nrmse", "parameters"])
    figure, panels = _panels(["reference", "torque"])
    for (column, row), axes in panels.items():
        part = table[(table["input"] == column) & (table["angle"] == row) & np.isfinite(table["nrmse"])]
        ends = []
        for name, count, error in zip(part["method"], part["parameters"], part["nrmse"]):
            marker, colour, _ = STYLES.get(name, _UNKNOWN)
            axes.plot(count, error, marker=marker, color=colour, linestyle="none", markersize=5)
            ends.append((name, count, error))
        axes.set(xscale="log", yscale="log")
        axes.set_xlim(part["parameters"].min() / 1.5, part["parameters"].max() * 1.3)
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
        _limit(axes, {name: [error] for name, _, error in ends})
        _label(axes, ends)
    figure.supxlabel("number of parameters", fontsize=8)
    return figure


def horizon_table(scores: pd.DataFrame) -> pd.DataFrame:
    """Median, lowest, highest NRMSE over the multisines, and all that diverged, by method, input, horizon, angle."""
    return _over_realisations(scores, ["method", "input", "horizon", "angle"])


def data_table(data: pd.DataFrame) -> pd.DataFrame:
    """The same per noise and share of the data."""
    return _over_realisations(data, ["method", "input", "noise", "smoothed", "fraction", "angle"])


def _over_realisations(table, by):
    table = table[table["recording"].str.startswith("multisine") | (table["recording"] == "")]
    groups = table.groupby(by, sort=False)
    counts = {"windows": ("windows", "sum"), "diverged": ("diverged", "sum"), "parameters": ("parameters", "first")}
    return groups.agg(nrmse=("nrmse", "median"), low=("nrmse", "min"), high=("nrmse", "max"), **counts).reset_index()


def _panels(columns, label="NRMSE (%)"):
    """A wide figure: {(column, angle): axes}, one row per angle."""
    figure = Figure(figsize=(WIDE, 5.6), layout="constrained")
    axes = figure.subplots(2, len(columns), sharex="col")
    panels = {
        (column, angle): panel for angle, row in zip(("yaw", "pitch"), axes) for column, panel in zip(columns, row)
    }
    for (column, angle), panel in panels.items():
        panel.set_title(f"{column}, {angle}")
        panel.set_ylabel(label)
    return figure, panels


def _lines(axes, table, ticks):
    """One line per method over ``at``, hollow where some predictions diverged, its name at its end."""
    ends, errors = [], {}
    for name, rows in table.groupby("method", sort=False):
        marker, colour, dashes = STYLES.get(name, _UNKNOWN)
        x, y, lost = (rows[column].to_numpy() for column in ("at", "nrmse", "diverged"))
        x, errors[name] = x.astype(float), y
        there = np.isfinite(y) & (y > 0)
        if not there.any():
            continue
        axes.plot(x[there], y[there], color=colour, linestyle=dashes, linewidth=0.8)
        look = {"marker": marker, "color": colour, "linestyle": "none", "markersize": 4.5, "markeredgewidth": 0.7}
        for some, face in ((there & (lost == 0), colour), (there & (lost > 0), "white")):
            axes.plot(x[some], y[some], markerfacecolor=face, **look)
        ends.append((name, x[there][-1], y[there][-1]))
    axes.set_yscale("log")
    axes.set_xticks(range(len(ticks)), ticks)
    axes.set_xlim(-0.1, len(ticks) - 1 + 0.1)
    _limit(axes, errors)
    _label(axes, ends)


def _limit(axes, values):
    """Axis over all methods but the grey box and those far above the rest."""
    some = np.concatenate([y for name, y in values.items() if name != "grey box"] or [[1.0]])
    some = some[np.isfinite(some) & (some > 0)]
    if len(some):
        axes.set_ylim(some.min() / 1.5, min(some.max(), FAR * np.median(some)) * 1.5)
        low, high = axes.get_ylim()
        if high / low < 50:
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter("")


def _label(axes, ends):
    """Names right of the panel, spread, in the order of the errors: a line to the point, or its value if beyond."""
    if not ends:
        return
    low, high = (np.log10(edge) for edge in axes.get_ylim())
    order = sorted(ends, key=lambda end: end[2])
    heights = np.array([(np.log10(y) - low) / (high - low) for _, _, y in order])
    levels, gap = np.clip(heights, 0.0, 1.0), 0.085
    for k in range(1, len(levels)):
        levels[k] = max(levels[k], levels[k - 1] + gap)
    levels[-1] = min(levels[-1], 1.0)
    for k in range(len(levels) - 2, -1, -1):
        levels[k] = min(levels[k], levels[k + 1] - gap)
    for (name, x, y), level, height in zip(order, levels, heights):
        colour = STYLES.get(name, _UNKNOWN)[1]
        options = {"fontsize": 6.5, "color": colour, "va": "center", "annotation_clip": False}
        if not 0 <= height <= 1:
            axes.annotate(f"{name} ({y:.1g})", (1.04, level), xycoords="axes fraction", **options)
            continue
        line = {"arrowstyle": "-", "color": colour, "linewidth": 0.4, "shrinkA": 0, "shrinkB": 2, "relpos": (0, 0.5)}
        axes.annotate(name, (x, y), (1.08, level), textcoords="axes fraction", arrowprops=line, **options)
