"""Figures of the robustness studies; see `tras.plotting`."""

import itertools

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tras.plotting import MODEL, new_figure, require, styled

# The names that differ from those in the tables.
METHOD_NAMES = {"plain": "least squares", "default": "regularized (default)", "refined": "smoothed and refined"}
_METHOD_MARKERS = ("o", "s", "^", "D")
DICTIONARY_NAMES = {"monomials2": "monomials, degree 2", "monomials3": "monomials, degree 3"}


@styled()
def noise_figure(table: pd.DataFrame) -> Figure:
    """Error against measurement noise, one panel per angle: the median over the seeds, from lowest to highest.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``noise`` (% of the range), ``seed, method, angle`` ("yaw" or "pitch"), ``nrmse`` (%).
    """
    require(table, "table", ["noise", "seed", "method", "angle", "nrmse"])
    figure, axes = new_figure(height=2.6, columns=2, sharey=True)
    levels = sorted(table["noise"].unique())
    for panel, angle in zip(axes, ("yaw", "pitch")):
        rows = table[table["angle"] == angle]
        for (method, group), marker in zip(rows.groupby("method", sort=False), _METHOD_MARKERS):
            # A gap where no run gave a model.
            errors = group.groupby("noise")["nrmse"].agg(["min", "median", "max"]).reindex(levels)
            at = range(len(levels))
            (line,) = panel.semilogy(at, errors["median"], marker=marker, label=METHOD_NAMES.get(method, method))
            panel.vlines(at, errors["min"], errors["max"], color=line.get_color(), linewidth=0.8)
        panel.set_xticks(range(len(levels)), [f"{level:g}" for level in levels])
        panel.set(title=angle, xlabel="noise (% of range)", xlim=(-0.3, len(levels) - 0.7))
    axes[0].set_ylabel("NRMSE over 6 s (%)")
    axes[0].yaxis.set_major_formatter("{x:g}")
    axes[0].yaxis.set_minor_formatter("")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def length_figure(table: pd.DataFrame) -> Figure:
    """Share of the data stretches that give no model, against their length: one column per noise, one row per fit.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``fit`` ("plain" or "default"), ``dictionary, functions`` (their number), ``noise`` (%), ``ratio``
        (snapshot pairs per function), ``failed`` (0 to 1).
    """
    require(table, "table", ["fit", "dictionary", "functions", "noise", "ratio", "failed"])
    fits, levels = list(dict.fromkeys(table["fit"])), sorted(table["noise"].unique())
    figure, axes = new_figure(0.9 + 1.25 * len(fits), len(fits), len(levels), squeeze=False, sharey=True)
    names = table.drop_duplicates("dictionary").set_index("dictionary")["functions"]
    for row, fit in zip(axes, fits):
        for panel, level in zip(row, levels):
            rows = table[(table["fit"] == fit) & (table["noise"] == level)]
            for (name, count), marker in zip(names.items(), itertools.cycle(_METHOD_MARKERS)):
                line, label = rows[rows["dictionary"] == name], f"{DICTIONARY_NAMES.get(name, name)} ({count:g})"
                panel.plot(line["ratio"], 100 * line["failed"], marker=marker, label=label)
            noise = f"{level:g} % noise" if level else "no noise"
            panel.set_title(f"{METHOD_NAMES.get(fit, fit).split(' (')[0]}, {noise}")
            panel.set(xscale="log", xlim=(0.8 * table["ratio"].min(), 1.25 * table["ratio"].max()), ylim=(-5, 105))
            panel.xaxis.set_major_formatter("{x:g}")
            panel.xaxis.set_minor_formatter("")
    figure.supxlabel("snapshot pairs per function (number of functions in brackets above)", fontsize=8)
    figure.supylabel("stretches without a model (%)", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def eigenfunctions_figure(table: pd.DataFrame) -> Figure:
    """Real parts of Koopman eigenfunctions over pitch and yaw, rates zero, scaled to one at the upper right corner.

    Lines are dashed where it is negative and thick where it is zero.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``rank``; ``rate`` (1/s) and ``frequency`` (rad/s) of the eigenvalue; ``phi, psi`` (rad) on a grid;
        ``real``.
    """
    require(table, "table", ["rank", "rate", "frequency", "phi", "psi", "real"])
    groups = list(table.groupby("rank"))
    figure, axes = new_figure(height=2.1, columns=len(groups), squeeze=False, sharey=True)
    steps = 2 * np.ceil(table["real"].abs().max() / 0.3)
    levels = 0.15 * np.arange(-steps, steps + 1)
    for panel, (_, group) in zip(axes[0], groups):
        grid = group.pivot(index="psi", columns="phi", values="real")
        filled = panel.contourf(grid.columns, grid.index, grid, levels=levels, cmap="RdBu_r")
        lines = panel.contour(grid.columns, grid.index, grid, levels=levels, colors="0.2", linewidths=0.5)
        lines.set_linewidth(np.where(levels == 0, 1.4, 0.5))
        rate, frequency = group[["rate", "frequency"]].iloc[0]
        panel.set_title(f"{rate:.3f} ± {frequency:.3f} i (1/s)".replace("-", "\N{MINUS SIGN}"))
        panel.set_xlabel(r"pitch $\phi$ (rad)")
    axes[0, 0].set_ylabel(r"yaw $\psi$ (rad)")
    figure.colorbar(filled, ax=axes[0].tolist(), shrink=0.9, label="real part", ticks=levels[::2], format="{x:.1f}")
    return figure


@styled()
def parameters_figure(table: pd.DataFrame) -> Figure:
    """Errors of the plant's parameters with their 95 % intervals, one panel per level of noise.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``noise`` (%), ``parameter, true, value, low, high``.
    """
    require(table, "table", ["noise", "parameter", "true", "value", "low", "high"])
    levels = sorted(table["noise"].unique())
    figure, axes = new_figure(height=2.4, columns=len(levels), squeeze=False, sharex=False, sharey=True)
    for panel, level in zip(axes[0], levels):
        shown = table[table["noise"] == level]
        value, low, high = (100 * (shown[name] / shown["true"] - 1) for name in ("value", "low", "high"))
        rows = np.arange(len(shown))
        panel.axvline(0, color="0.6", linestyle="-", linewidth=0.7)
        panel.hlines(rows, low, high, color=MODEL["color"], linewidth=1.6)
        panel.plot(value, rows, color="black", marker="o", linestyle="none")
        panel.set_yticks(rows, [_symbol(name) for name in shown["parameter"]], fontsize=8.6)  # an index is 0.7 of it
        panel.set(title=f"{level:g} % noise", xlabel="error (%)", ylim=(len(rows) - 0.5, -0.5))
        panel.margins(x=0.08)
    return figure


def _symbol(name):
    """J_psi0 -> $J_{\\psi 0}$"""
    letter, _, index = name.partition("_")
    for greek in ("phi", "psi"):
        index = index.replace(greek, f"\\{greek} ")
    return f"${letter}_{{{index.strip()}}}$" if index else f"${letter}$"
