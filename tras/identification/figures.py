"""Figures of an identification, for any channels: each takes a table and returns a `Figure`."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tras.identification.scores import CONSTANT, HELD
from tras.plotting import LINEAR, MODEL, TRUTH, new_figure, require, styled

MOST = 6  # panels; other channels are in the tables only
_BAND = {"color": "#0072B2", "alpha": 0.25, "linewidth": 0}
_POINTS = 1500  # of a curve, about


def _with_units(names, units):
    return [f"{name} ({unit})" if unit else name for name, unit in zip(names, units)]


@styled()
def data_figure(table: pd.DataFrame, names: list[str], units: list[str]) -> Figure:
    """The recording: every channel over time, trajectories one after the other, their beginnings marked.

    The table has ``trajectory, time`` (s, from the recording's beginning) and one column per channel; at most six
    channels are shown.
    """
    require(table, "table", ["trajectory", "time", *names])
    names, units = names[:MOST], units[:MOST]
    figure, axes = new_figure(height=0.75 * len(names) + 0.55, rows=len(names), squeeze=False)
    begins = table["time"][table["trajectory"].diff() > 0]
    for panel, name, label in zip(axes[:, 0], names, _with_units(names, units)):
        panel.plot(table["time"], table[name], color="black", linestyle="-", linewidth=0.6)
        panel.set_title(label, fontsize=8, pad=2)
        for time in begins if len(begins) <= 40 else ():
            panel.axvline(time, color="0.8", linewidth=0.4, linestyle="-", zorder=0)
    axes[-1, 0].set_xlabel("time (s)")
    return figure


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
            panel.loglog(table["frequency"], np.maximum(table[name], 1e-12), label=name, linewidth=0.9)
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
    for row, state, label in zip(axes, states, _with_units(states, units)):
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


@styled()
def eigenvalue_figure(table: pd.DataFrame) -> Figure:
    """Eigenvalues of the Koopman matrices of both models with the unit circle, whole and near one.

    The table has ``model`` ("model" or "linear model"), ``real, imag``.
    """
    require(table, "table", ["model", "real", "imag"])
    figure, (whole, near) = new_figure(height=2.35, columns=2, sharex=False)
    angle = np.linspace(0, 2 * np.pi, 721)
    markers = {"model": {"marker": "o", "markerfacecolor": "none", "color": "#0072B2", "markersize": 4},
               "linear model": {"marker": "x", "color": "#D55E00", "markersize": 4.5}}  # fmt: skip
    for panel in (whole, near):
        panel.plot(np.cos(angle), np.sin(angle), color="0.6", linestyle="-", linewidth=0.7)
        for name, group in table.groupby("model", sort=False):
            panel.plot(group["real"], group["imag"], linestyle="none", label=name, **markers[name])
        panel.set(xlabel="real part")
    reach = 1.15 * max(1.0, table[["real", "imag"]].abs().to_numpy().max())
    whole.set(ylabel="imaginary part", xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    distance = np.hypot(table["real"] - 1, table["imag"]).to_numpy()
    distance = distance[distance > 1e-6]
    zoom = float(np.clip(1.3 * np.quantile(distance, 0.5), 1e-4, 1.0)) if len(distance) else 0.1
    near.set(xlim=(1 - zoom, 1 + zoom), ylim=(-zoom, zoom), aspect="equal")
    whole.set_title("all", fontsize=8, pad=3)
    near.set_title("near one", fontsize=8, pad=3)
    near.locator_params(nbins=4)
    near.ticklabel_format(useOffset=False)
    figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
