"""Figures of the comparison: all methods over one horizon, four of them over all, and all with few or noisy data."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tras.plotting import LINEAR, MECHANICAL, MODEL, new_figure, require, styled

REFERENCE = "DMDc"
# Over all horizons: a linear model, a method of the field, the paper's model and ours. (marker, look of the line)
FOUR = {
    REFERENCE: ("o", LINEAR),
    "NARX": ("v", {"color": "black", "linestyle": ":", "linewidth": 1.1}),
    "Koopman, the paper's": ("s", MODEL),
    "Koopman, mechanical": ("D", MECHANICAL),
}
ANGLE_LOOKS = {"yaw": ("o", "black"), "pitch": ("D", "#0072B2")}
ROW = 0.155  # inches per method
BEYOND = 1e-4  # of the panel's median: what is smaller would squeeze the rest, and is said in words


@styled()
def window_figure(table: pd.DataFrame) -> Figure:
    """NRMSE of every method over one horizon, one column per input and angle; the best with the last input on top.

    A hollow point has lost windows: its error is that of the others.

    Parameters
    ----------
    table : pandas.DataFrame
        From `horizon_table`, the rows of one horizon.
    """
    require(table, "table", ["method", "input", "angle", "nrmse", "diverged"])
    order = _best_first(table[table["input"] == table["input"].iloc[-1]], table)
    columns = list(dict.fromkeys(zip(table["input"], table["angle"])))
    figure, panels = _dot_panels(order, len(columns))
    for panel, (name, angle) in zip(panels, columns):
        rows = table[table["input"] == name]
        _dots(panel, rows[rows["angle"] == angle], order, _limits(rows["nrmse"]))
        panel.set_title(f"{name},\n{angle}")
        linear = rows[(rows["method"] == REFERENCE) & (rows["angle"] == angle)]["nrmse"]
        panel.axvline(*linear.head(1), color="0.5", linestyle="-", linewidth=0.7, zorder=0.9)
    figure.supxlabel(f"NRMSE (%); vertical line: {REFERENCE}" + _hollow(table), fontsize=8)
    return figure


@styled()
def horizon_figure(table: pd.DataFrame) -> Figure:
    """Median NRMSE of four methods against the horizon, over that of DMDc; one column per input, one row per angle.

    A hollow point has lost windows: its error is that of the others.

    Parameters
    ----------
    table : pandas.DataFrame
        From `horizon_table`. Methods other than the four are not drawn.
    """
    require(table, "table", ["method", "input", "angle", "horizon", "nrmse", "diverged"])
    horizons, inputs = sorted(table["horizon"].unique()), list(dict.fromkeys(table["input"]))
    linear = table[table["method"] == REFERENCE].set_index(["input", "angle", "horizon"])["nrmse"]
    if linear.empty:
        raise ValueError(f"table has no method {REFERENCE!r}, to which the others are related; compare it too.")
    methods = {name: look for name, look in FOUR.items() if name in set(table["method"])}
    figure, axes = new_figure(height=3.3, rows=2, columns=len(inputs), sharey=True, squeeze=False)
    for row, angle in zip(axes, ANGLE_LOOKS):
        for panel, name in zip(row, inputs):
            part = table[(table["input"] == name) & (table["angle"] == angle)]
            for method, (marker, look) in methods.items():
                rows = part[part["method"] == method].sort_values("horizon")
                ratio = rows["nrmse"].to_numpy() / [linear[name, angle, h] for h in rows["horizon"]]
                at, lost = [horizons.index(h) for h in rows["horizon"]], (rows["diverged"] > 0).to_numpy()
                panel.semilogy(at, ratio, **look, label=method)
                _points(panel, np.array(at), ratio, lost, marker, look["color"])
            panel.set_title(f"{angle}, input: {name}")
            panel.grid(axis="y")
            panel.set_xticks(range(len(horizons)), [f"{h:g} s" for h in horizons])
            panel.margins(x=0.06)
    axes[0, 0].yaxis.set_major_formatter("{x:g}")
    figure.supylabel(f"NRMSE over that of {REFERENCE}", fontsize=8)
    figure.supxlabel("time ahead" + _hollow(table[table["method"].isin(methods)]), fontsize=8)
    handles = [Line2D([], [], **look, marker=marker, label=name) for name, (marker, look) in methods.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def data_figure(table: pd.DataFrame) -> Figure:
    """NRMSE of every method with few and with noisy data, one column per case, all on one axis; for one input.

    A hollow point has lost windows: its error is that of the others.

    Parameters
    ----------
    table : pandas.DataFrame
        From `data_table`. Of several inputs the first one with noise is drawn.
    """
    require(table, "table", ["method", "input", "angle", "noise", "smoothed", "fraction", "nrmse", "diverged"])
    noisy = table[table["noise"] > 0]
    table = table[table["input"] == (table if noisy.empty else noisy)["input"].iloc[0]]
    whole = table["fraction"].max()
    cases = sorted(dict.fromkeys(zip(table["noise"], table["smoothed"], table["fraction"])))
    order = _best_first(table[(table["noise"] == 0) & (table["fraction"] == whole)], table)
    figure, panels = _dot_panels(order, len(cases), extra=0.2)
    limits = _limits(table["nrmse"])
    for panel, (noise, smoothed, fraction) in zip(panels, cases):
        chosen = (table["noise"] == noise) & (table["smoothed"] == smoothed) & (table["fraction"] == fraction)
        _dots(panel, table[chosen], order, limits)
        share = "all data" if fraction == whole else f"{100 * fraction:g} %\nof data"
        panel.set_title(f"{noise:g} % noise" + ("\nsmoothed" if smoothed else "") if noise else share, fontsize=7.2)
    handles = [
        Line2D([], [], marker=marker, color=colour, linestyle="none", label=angle)
        for angle, (marker, colour) in ANGLE_LOOKS.items()
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=2, columnspacing=1.2)
    figure.supxlabel("NRMSE (%)" + _hollow(table), fontsize=8)
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


def _best_first(rows, table):
    """Methods by the geometric mean of their errors in these rows; those without an error come last.

    Means within about 0.01 % are a tie and keep the table's order: NARX and pykoop's EDMD differ by 5e-10, and the last
    bit would decide which is drawn above the other.
    """
    errors = rows["nrmse"].where(rows["nrmse"] > 0)
    means = np.log(errors).groupby(rows["method"]).mean().round(4).reindex(table["method"].unique())
    return list(means.sort_values(kind="stable", na_position="last").index)


def _dot_panels(order, columns, extra=0.0):
    """A figure with one row per method, the first on top, and its panels."""
    figure, panels = new_figure(0.72 + extra + ROW * len(order), 1, columns, sharex=False, sharey=True, squeeze=False)
    figure.get_layout_engine().set(w_pad=0.015, wspace=0.0)
    panels = panels[0]
    panels[0].set_yticks(range(len(order)), order)
    panels[0].set_ylim(len(order) - 0.4, -0.6)
    for panel in panels:
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        panel.grid()
        panel.set_xscale("log")
        panel.tick_params(axis="x", labelsize=6.5, which="both")
    return figure, panels


def _limits(errors):
    """Limits of the axis, and the smallest error that is drawn to scale."""
    errors = errors[np.isfinite(errors) & (errors > 0)]
    if errors.empty:
        return 0.1, 10.0
    to_scale = errors[errors > BEYOND * errors.median()]
    low, high = to_scale.min(), to_scale.max()
    room = max((high / low) ** 0.1, 1.3)
    return low / room ** (2.5 if len(to_scale) < len(errors) else 1), high * room


def _dots(panel, rows, order, limits):
    low, high = limits
    panel.set_xlim(low, high)
    panel.set_xticks(_ticks(low, high))
    panel.set_xticks([], minor=True)
    panel.xaxis.set_major_formatter("{x:g}")
    angles = list(dict.fromkeys(rows["angle"]))
    for angle, part in rows.groupby("angle", sort=False):
        at = np.array([order.index(name) for name in part["method"]])
        error, lost = part["nrmse"].to_numpy(), (part["diverged"] > 0).to_numpy()
        to_scale, aside = error > low, 0.3 * (angles.index(angle) - (len(angles) - 1) / 2)
        _points(panel, error[to_scale], at[to_scale] + aside, lost[to_scale], *ANGLE_LOOKS[angle])
        if angle == angles[0]:  # one word is enough
            for y, value in zip(at[~to_scale], error[~to_scale]):
                word = f"\N{LEFTWARDS ARROW} {value:.0e}".replace("e-0", "e-") if np.isfinite(value) else "all lost"
                panel.text(0.03, y, word, transform=panel.get_yaxis_transform(), va="center", fontsize=6.2)


def _ticks(low, high):
    """Two or three round numbers between these."""
    exponents = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    every = [digit * 10.0**k for k in exponents for digit in (1, 3) if low < digit * 10.0**k < high]
    decades = [10.0**k for k in exponents if low < 10.0**k < high]
    if len(decades) < 3:
        return every[:: max(1, len(every) // 2)]
    return decades[1:-1:2] if len(decades) > 4 else decades[::2]  # none at an edge, where its neighbour's label begins


def _hollow(table):
    return "; hollow: some windows lost" if (table["diverged"] > 0).any() else ""


def _points(panel, x, y, lost, marker, colour):
    look = {"marker": marker, "color": colour, "linestyle": "none", "markersize": 3.6, "markeredgewidth": 0.8}
    for some, face in ((~lost, colour), (lost, "white")):
        panel.plot(x[some], y[some], markerfacecolor=face, zorder=3, **look)
