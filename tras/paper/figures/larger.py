"""Figures of the larger rig: error against the number of functions, effects one by one, a gust with its estimate."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tras.plotting import LINEAR, MECHANICAL, MODEL, TRUTH, new_figure, require, styled

# Family -> (how its models' names begin, marker, look).
FAMILIES = {
    "monomials": ("monomials", "o", MODEL),
    "Gaussians": ("", "^", LINEAR),
    "mechanical with actuators": ("mechanical", "D", MECHANICAL | {"color": "#1B7A57", "linewidth": 1.1}),
}
MODELS = {
    "linear": ("o", LINEAR["color"]), "monomials, degree 3": ("s", MODEL["color"]),
    "mechanical with actuators": ("D", "#1B7A57"),
}  # fmt: skip


@styled()
def accuracy_figure(table: pd.DataFrame) -> Figure:
    """NRMSE against the number of functions, one column per rig, one row per angle; hollow where windows were lost.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``rig, model, N, angle, nrmse, diverged``.
    """
    require(table, "table", ["rig", "model", "N", "angle", "nrmse", "diverged"])
    rigs = list(dict.fromkeys(table["rig"]))
    figure, axes = new_figure(3.3, 2, len(rigs), sharey=True, squeeze=False)
    for row, angle in zip(axes, ("yaw", "pitch")):
        for panel, rig in zip(row, rigs):
            part = table[(table["rig"] == rig) & (table["angle"] == angle)]
            for family, (_, marker, look) in FAMILIES.items():
                rows = part[part["model"].map(_family) == family].sort_values("N")
                panel.loglog(rows["N"], rows["nrmse"], **look)
                for _, point in rows.iterrows():
                    fill = "white" if point["diverged"] else look["color"]
                    panel.plot(point["N"], point["nrmse"], marker, color=look["color"], markerfacecolor=fill)
            panel.set_title(f"{angle}, {rig}")
            panel.grid(axis="y")
            panel.margins(x=0.08)
    for panel in axes[-1]:
        panel.set_xticks([10, 30, 100, 300], ["10", "30", "100", "300"], minor=False)
        panel.set_xticks([], minor=True)
    axes[0, 0].yaxis.set_major_formatter("{x:g}")
    figure.supylabel("NRMSE over windows (%)", fontsize=8)
    figure.supxlabel("number of functions N", fontsize=8)
    handles = [Line2D([], [], **look, marker=marker, label=name) for name, (_, marker, look) in FAMILIES.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


def _family(model):
    """A model's family, by its name: "100 Gaussians", "monomials, degree 3"."""
    return next((name for name, (start, *_) in FAMILIES.items() if start and model.startswith(start)), "Gaussians")


@styled()
def effects_figure(table: pd.DataFrame) -> Figure:
    """NRMSE with one effect at a time, one column per angle and a mark per model; hollow where windows were lost.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``condition, model, angle, nrmse, diverged``; conditions from top to bottom.
    """
    require(table, "table", ["condition", "model", "angle", "nrmse", "diverged"])
    conditions = list(dict.fromkeys(table["condition"]))
    figure, axes = new_figure(0.9 + 0.2 * len(conditions), 1, 2, sharey=True)  # both panels have one axis of errors
    for panel, angle in zip(axes, ("yaw", "pitch")):
        part = table[table["angle"] == angle]
        for model, (marker, colour) in MODELS.items():
            for _, point in part[part["model"] == model].iterrows():
                fill = "white" if point["diverged"] else colour
                at = conditions.index(point["condition"])
                panel.plot(point["nrmse"], at, marker, color=colour, markerfacecolor=fill, zorder=3)
        panel.set_xscale("log")
        panel.xaxis.set_major_formatter("{x:g}")
        panel.grid(axis="both")
        panel.margins(x=0.08)
        panel.set_title(angle)
    axes[0].set_yticks(range(len(conditions)), conditions)
    axes[0].invert_yaxis()
    figure.supxlabel("NRMSE over windows (%)", fontsize=8)
    handles = [
        Line2D([], [], marker=marker, color=colour, linestyle="none", label=model)
        for model, (marker, colour) in MODELS.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def gusts_figure(table: pd.DataFrame) -> Figure:
    """A gust over time and its estimate, one panel per angle.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``time`` (s), ``angle``, ``true, estimate`` (N m).
    """
    require(table, "table", ["time", "angle", "true", "estimate"])
    figure, axes = new_figure(2.4, 2)
    for panel, angle in zip(axes, ("yaw", "pitch")):
        part = table[table["angle"] == angle]
        panel.plot(part["time"], 1e3 * np.asarray(part["estimate"]), **MECHANICAL, label="estimate")
        panel.plot(part["time"], 1e3 * np.asarray(part["true"]), **TRUTH, label="gust")
        panel.set_ylabel(f"{angle} (mN m)")
    axes[-1].set_xlabel("time (s)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
