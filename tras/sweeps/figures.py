"""The figure of a sweep (`tras.sweep`); see `tras.plotting`."""

import itertools

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from tras.plotting import new_figure, require, styled

COLUMNS = ("dictionary", "functions", "error", "diverged")
_MARKERS, _COLOURS = "os^DvP", ("#0072B2", "#D55E00", "black", "#009E73", "#CC79A7", "0.4")
_DASHES = ("-", "--", "-.", ":", "-", "--")


@styled()
def sweep_figure(table: pd.DataFrame) -> Figure:
    """Error against the number of functions: by kind of dictionary a line through the best fit at each number.

    Every other fit is a small mark. Hollow marks are fits of which a window diverged; fits without a model are not
    shown.

    Parameters
    ----------
    table : pandas.DataFrame
        ``dictionary`` (text that begins with the kind), ``functions, error`` (half-ranges), ``diverged`` (windows).

    Raises
    ------
    ValueError
        If there is no model to show.
    """
    require(table, "table", list(COLUMNS))
    table = table.astype({"functions": float, "error": float, "diverged": float})
    table = table[np.isfinite(table["error"]) & (table["error"] > 0)]
    if table.empty:
        raise ValueError("table has no model, so there is no error to show.")
    figure, axes = new_figure(height=2.6)
    kinds = table["dictionary"].str.partition("(")[0]
    styles = itertools.cycle(zip(_MARKERS, _COLOURS, _DASHES))
    mark = {"linestyle": "none", "markeredgewidth": 0.7}
    for (kind, rows), (marker, colour, dashes) in zip(table.groupby(kinds, sort=False), styles):
        best = rows.loc[rows.groupby("functions")["error"].idxmin()]
        axes.plot(best["functions"], best["error"], color=colour, linestyle=dashes)
        axes.plot([], [], color=colour, linestyle=dashes, marker=marker, label=kind)  # the legend shows both
        for fits, size in ((rows.drop(best.index), 2), (best, 4)):
            for hollow in (False, True):
                shown = fits[(fits["diverged"] > 0) == hollow]
                style = mark | {"marker": marker, "color": colour, "markersize": size}
                style["markerfacecolor"] = "white" if hollow else colour
                axes.plot(shown["functions"], shown["error"], **style)
    if (table["diverged"] > 0).any():
        axes.plot([], [], **mark, marker="o", color="0.4", markerfacecolor="white", label="a window diverged")
    axes.set(xscale="log", yscale="log", xlabel="number of functions N", ylabel="error of roll-outs (half-ranges)")
    axes.set_xlim(table["functions"].min() / 1.3, table["functions"].max() * 1.3)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure
