"""Figures of an identification, for any channels: each takes a table and returns a `Figure`."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tras.display.plots import MOST, with_units
from tras.identification.scores import CONSTANT, HELD
from tras.plotting import LINEAR, MODEL, TRUTH, new_figure, plain, require, styled

_BAND = {"color": "#0072B2", "alpha": 0.25, "linewidth": 0}
_POINTS = 1500  # of a curve, about


@styled()
def spectra_figure(table: pd.DataFrame, states: list[str], inputs: list[str]) -> Figure:
    """Where in frequency inputs and states move: share of variance per Hz.

    The table has ``frequency`` (Hz) and one column per channel.
    """
    require(table, "table", ["frequency", *states, *inputs])
    groups = [(title, names) for title, names in (("inputs", inputs[:MOST]), ("states", states[:MOST])) if names]
    figure, axes = new_figure(height=1.35 * len(groups) + 0.4, rows=len(groups), squeeze=False)
    for panel, (title, names) in zip(axes[:, 0], groups):
        for name in names:
            panel.loglog(table["frequency"], np.maximum(table[name], 1e-12), label=plain(name), linewidth=0.9)
        top = table[names].to_numpy().max()
        panel.set_ylim(max(1e-8 * top, 1e-12), 3 * top)
        panel.set_title(title, fontsize=8, pad=2)
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.6)
    axes[-1, 0].set_xlabel("frequency (Hz)")
    figure.supylabel("share of variance (1/Hz)", fontsize=8)
    return figure


@styled()
def prediction_figure(table: pd.DataFrame, states: list[str], units: list[str]) -> Figure:
    """The measured states, the model and the linear model over two test windows, with the band of the bootstrap.

    The table has ``window, time`` (s) and, per state, ``STATE: true, model, linear model, lower, upper``. At most six
    states are shown.
    """
    kinds = ("true", "model", "linear model", "lower", "upper")
    require(table, "table", ["window", "time", *(f"{state}: {kind}" for state in states for kind in kinds)])
    states, windows = states[:MOST], list(dict.fromkeys(table["window"]))
    size = {"height": 1.0 * len(states) + 0.75, "rows": len(states), "columns": len(windows)}
    figure, axes = new_figure(**size, sharey="row", sharex="col", squeeze=False)
    for row, state, label in zip(axes, states, with_units(states, units)):
        for panel, name in zip(row, windows):
            part = table[table["window"] == name]
            time, (true, model, linear, low, high) = part["time"], [part[f"{state}: {kind}"] for kind in kinds]
            reach = 1.5 * max(true.max() - true.min(), 1e-300)
            inside = (true.min() - reach, true.max() + reach)
            if low.notna().any():
                panel.fill_between(time, low.clip(*inside), high.clip(*inside), **_BAND, label="90 % of a bootstrap")
            panel.plot(time, true, **TRUTH, label="measured", zorder=3)
            panel.plot(time, model.where(model.between(*inside)), **MODEL, label="model")
            panel.plot(time, linear.where(linear.between(*inside)), **LINEAR, label="linear model")
        row[0].set_ylabel(label)
    for panel, name in zip(axes[0], windows):
        panel.set_title(f"{name} window", fontsize=8, pad=3)
    for panel in axes[-1]:
        panel.set_xlabel("time (s)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def growth_figure(table: pd.DataFrame) -> Figure:
    """Error against the time ahead, over all states and test windows.

    The table has ``time`` (s) and one column per prediction, in percent of the range.
    """
    require(table, "table", ["time"])
    figure, panel = new_figure(height=2.3)
    every = max(1, len(table) // _POINTS)
    styles = {
        "model": MODEL, "linear model": LINEAR, "model, started as measured": {"color": "#009E73", "linestyle": "-."},
        HELD: {"color": "0.45", "linestyle": "--", "linewidth": 0.8},
        CONSTANT: {"color": "0.65", "linestyle": "-", "linewidth": 0.8},
    }  # fmt: skip
    for name in table.columns[1:]:
        if table[name].notna().any():
            panel.semilogy(table["time"][::every], np.maximum(table[name][::every], 1e-9), label=name, **styles[name])
    panel.set(xlabel="time ahead (s)", ylabel="error (% of range)")
    panel.yaxis.set_major_formatter("{x:g}")
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure
