"""Figures of the benchmarks: ours beside the peers, and how our cost grows."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter

from tras.plotting import require, styled

STYLES = {  # marker, colour, line; ours are blue and solid, references black, peers the rest
    "tras": ("o", "#0072B2", "-"),
    "plain Gram": ("s", "#000000", "--"),
    "floor": ("", "#000000", ":"),
    "pykoop": (">", "#009E73", ":"),
    "pykoopman": ("D", "#B04A00", "-."),
    "deeptime": ("v", "#E69F00", "--"),
    "kooplearn": ("^", "#CC79A7", "-"),
    "datafold": ("X", "#56B4E9", "--"),
    "pydmd": ("P", "#666666", "-."),
}
VARIANTS = {
    "koopman_matrix": ("o", "#0072B2", "-"),
    "one_step": ("o", "#0072B2", "-"),
    "vector_field": ("s", "#D55E00", "--"),
    "lifted_linear": ("^", "#009E73", "-."),
}


@styled()
def peers_figure(table):
    """Time and memory of a fit against the number of functions, one column per number of pairs; below, the errors.

    Parameters
    ----------
    table : pandas.DataFrame
        ``peers.csv``.

    Returns
    -------
    matplotlib.figure.Figure
    """
    require(table, "table", ["what", "method", "pairs", "functions", "cpu_s", "peak_mib", "outcome"])
    fits = table[(table["what"] == "fit") & table["outcome"].isna() & table["method"].isin(list(STYLES))]
    sizes = sorted(fits["pairs"].unique())
    figure = Figure(figsize=(7.0, 5.6), layout="constrained")
    axes = figure.subplots(2, 3)
    for column, pairs in enumerate(sizes[:2]):
        part = fits[fits["pairs"] == pairs]
        title = f"{pairs:,} pairs".replace(",", " ")
        _lines(axes[0, column], part, "cpu_s", "fit, CPU time [s]", title)
        _lines(axes[1, column], part[part["method"] != "floor"], "peak_mib", "memory of a fit [MiB]", title)
    for row in range(2):
        low, high = zip(*(axes[row, column].get_ylim() for column in range(len(sizes[:2]))))
        for column in range(len(sizes[:2])):
            axes[row, column].set_ylim(min(low), max(high))
    if "error" in fits and fits["error"].notna().any():
        some = fits[fits["error"].notna() & (fits["pairs"] == sizes[0])]
        _lines(axes[0, 2], some, "error", "error of coefficients, relative", f"{sizes[0]:,} pairs".replace(",", " "))
    _bars(axes[1, 2], table[(table["what"] == "roll-out") & table["outcome"].isna()])
    for empty in axes[:, len(sizes[:2]) : 2].ravel():
        empty.set_visible(False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5)
    figure.supxlabel(_origin(table), fontsize=6.5)
    return figure


@styled()
def growth_figure(table, fitted):
    """Our cost against pairs, functions and trajectories on logarithmic axes, the slope of the theory beside it.

    Parameters
    ----------
    table, fitted : pandas.DataFrame
        ``growth.csv`` and ``growth_exponents.csv``.

    Returns
    -------
    matplotlib.figure.Figure
    """
    require(table, "table", ["against", "variant", "cpu_s", "peak_mib", "outcome"])
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.subplots(2, 2)
    panels = [
        (axes[0, 0], "pairs", "cpu_s", "fit time", "fit, CPU time [s]", "snapshot pairs M"),
        (axes[0, 1], "functions", "cpu_s", "fit time", "fit, CPU time [s]", "functions N"),
        (axes[1, 0], "pairs", "peak_mib", "memory", "memory of a fit [MiB]", "snapshot pairs M"),
        (axes[1, 1], "trajectories", "cpu_s", "roll-out time", "600 steps, CPU time [s]", "trajectories"),
    ]
    good = table[table["outcome"].isna()]
    for panel, against, column, quantity, label, name in panels:
        part = good[good["against"] == against]
        for variant, rows in part.groupby("variant", sort=False):
            marker, colour, line = VARIANTS[variant]
            slope = fitted[
                (fitted["quantity"] == quantity) & (fitted["against"] == against) & (fitted["variant"] == variant)
            ]
            text = variant.replace("_", " ")
            if len(slope):
                exponent = slope.iloc[0]
                half = (exponent["high"] - exponent["low"]) / 2
                text += f": exponent {exponent['exponent']:.2f}" + ("" if np.isnan(half) else f" ± {half:.2f}")
            panel.plot(rows[against], rows[column], marker=marker, color=colour, linestyle=line, label=text)
        if len(part):
            _theory(
                panel, part, against, column, fitted[(fitted["quantity"] == quantity) & (fitted["against"] == against)]
            )
        panel.set(xscale="log", yscale="log", xlabel=name, ylabel=label)
        panel.legend(loc="best")
        _plain(panel)
    low, high = axes[1, 0].get_ylim()
    axes[1, 0].set_ylim(min(low, 1.0), max(high, 100.0))  # not to blow up what is constant
    figure.supxlabel(_origin(table), fontsize=6.5)
    return figure


def _theory(panel, part, against, column, fitted):
    """A line of the theory's slope through the last point of the first variant, moved a little down."""
    if not len(fitted):
        return
    rows = part[part["variant"] == part["variant"].iloc[0]].sort_values(against)
    x = np.array([rows[against].max() / 10, rows[against].max()], dtype=float)
    power = float(fitted["theory"].iloc[0])
    y = rows[column].iloc[-1] * 0.6 * (x / x[-1]) ** power
    panel.plot(x, y, color="0.4", linewidth=0.8, linestyle=(0, (1, 1)), label=f"theory: exponent {power:g}")


def _lines(panel, part, column, label, title):
    for method, (marker, colour, line) in STYLES.items():
        rows = part[part["method"] == method].sort_values("functions")
        if len(rows):
            panel.plot(rows["functions"], rows[column], marker=marker, color=colour, linestyle=line, label=method)
    counts = sorted(part["functions"].unique())
    panel.set(xscale="log", yscale="log", xlabel="functions N", ylabel=label, title=title)
    panel.xaxis.set_major_locator(FixedLocator(counts))
    panel.set_xticks(counts, [str(count) for count in counts])
    panel.xaxis.set_minor_locator(FixedLocator([]))
    _plain(panel)


def _bars(panel, rows):
    rows = rows[rows["functions"] == rows["functions"].min()].sort_values("cpu_s", ascending=False)
    colours = [
        STYLES.get(name, STYLES["tras"])[1] if not name.startswith("tras") else STYLES["tras"][1]
        for name in rows["method"]
    ]
    panel.barh(range(len(rows)), rows["cpu_s"], color=colours, height=0.6)
    panel.set_yticks(range(len(rows)), rows["method"], fontsize=6.5)
    count = f", N = {rows['functions'].iloc[0]}" if len(rows) else ""
    panel.set(xscale="log", xlabel="600 steps × 100 runs, CPU time [s]", title=f"roll-out{count}")
    _plain(panel)


def _plain(panel):
    """Numbers at whole decades only, and markers that are not cut off at the ends."""
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_minor_formatter(NullFormatter())
    panel.margins(x=0.05)


def _origin(table):
    dates = sorted(table["measured"].dropna()) if "measured" in table else []
    return f"{dates[-1][:10] if dates else ''}, {table['processor'].iloc[0]}, one thread"
