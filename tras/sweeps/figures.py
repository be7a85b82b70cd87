"""The figure of a sweep (`tras.sweep`); see `tras.plotting`."""

import numpy as np
from matplotlib.ticker import LogLocator

from tras.plotting import new_figure, require, styled

COLUMNS = ("dictionary", "functions", "error", "diverged")
_STYLES = (
    ("o", "#0072B2", "-"),
    ("s", "#D55E00", "--"),
    ("^", "black", "-."),
    ("D", "#009E73", ":"),
    ("v", "#CC79A7", "-"),
    ("P", "0.4", "--"),
)


@styled()
def sweep_figure(table):
    """Error against the number of functions: a line through the best fit at each number, by kind of dictionary; every other fit a small mark.

    Hollow marks are fits of which a window diverged; fits without a model are not shown.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``dictionary`` (text that begins with the kind), ``functions, error`` (half-ranges), ``diverged`` (windows).

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If there is no model to show.
    """
    require(table, "table", list(COLUMNS))
    table = table[np.isfinite(table["error"].astype(float)) & (table["error"].astype(float) > 0)]
    if table.empty:
        raise ValueError("table has no model, so there is no error to show.")
    table = table.astype({"functions": float, "error": float, "diverged": float})
    figure, axes = new_figure(height=2.6)
    kinds = table["dictionary"].str.partition("(")[0]
    for k, (kind, rows) in enumerate(table.groupby(kinds, sort=False)):
        marker, colour, dashes = _STYLES[k % len(_STYLES)]
        best = rows.loc[rows.groupby("functions")["error"].idxmin()]
        axes.plot(best["functions"], best["error"], color=colour, linestyle=dashes)
        axes.plot([], [], color=colour, linestyle=dashes, marker=marker, label=kind)  # the legend shows both
        for chosen, size in ((rows.drop(best.index), 2), (best, 4)):
            for hollow in (False, True):
                shown = chosen[(chosen["diverged"] > 0) == hollow]
                style = {
                    "color": colour,
                    "markersize": size,
                    "markeredgewidth": 0.7,
                    "markerfacecolor": "white" if hollow else colour,
                }
                axes.plot(shown["functions"], shown["error"], marker=marker, linestyle="none", **style)
    if (table["diverged"] > 0).any():
        axes.plot(
            [],
            [],
            marker="o",
            linestyle="none",
            color="0.4",
            markerfacecolor="white",
            markeredgewidth=0.7,
            label="a window diverged",
        )
    axes.set(xscale="log", yscale="log", xlabel="number of functions N", ylabel="error of roll-outs (half-ranges)")
    axes.set_xlim(table["functions"].min() / 1.3, table["functions"].max() * 1.3)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure
