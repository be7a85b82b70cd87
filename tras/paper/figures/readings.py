"""Figures of the study of readings: what each option does to the error, and where all readings lie beside the paper."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tras.paper.effects import target
from tras.plotting import MODEL, new_figure, require, styled

_WORDS = {  # (option, choice) -> the label of what differs from the default
    ("input", "torque"): "input: torques",
    ("frequency_unit", "Hz"): "frequencies: Hz",
    ("dictionary", "gaussian28"): "functions: 28 Gaussians",
    ("dictionary", "monomials2"): "functions: degree 2",
    ("dictionary", "monomials3"): "functions: degree 3",
    ("dictionary", "exponentials"): "functions: exponentials",
    ("dictionary", "linear"): "functions: linear ones alone",
    ("state", "delayed_angles"): "state: angles and a delay",
    ("horizon", "trajectory"): "horizon: one trajectory",
    ("horizon", "free_run"): "horizon: whole recording",
    ("nrmse_range", "trajectory"): "range: each window",
    ("velocity_term", "as_printed"): "velocity term: as printed",
    ("start", "on_reference"): "start: on the reference",
    ("start", "hanging"): "start: hanging at rest",
    ("start", "zero"): "start: both angles zero",
}
_SMALL = 1.05  # a median ratio of a plant up to this, or down to its inverse, is not drawn
_MARKERS = {  # (input, frequency unit) -> how its readings are drawn
    ("reference", "rad/s"): ("o", "#0072B2"), ("reference", "Hz"): ("s", "#009E73"),
    ("torque", "rad/s"): ("^", "#D55E00"), ("torque", "Hz"): ("x", "black"),
}  # fmt: skip


@styled()
def effects_figure(table: pd.DataFrame) -> Figure:
    """Ratio of NRMSE to that of the default choice, all else equal: median, middle half, middle nine tenths.

    Plants that hardly change the median of either angle are counted in place of being drawn.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tras.paper.effects.effects`.
    """
    require(table, "table", ["option", "choice", "angle", "pairs", "median", "q05", "q25", "q75", "q95"])
    labels = list(dict.fromkeys(zip(table["option"], table["choice"])))
    change = np.exp(np.log(table["median"]).abs().groupby([table["option"], table["choice"]]).max())
    alike = [label for label in labels if label[0] == "plant" and change[label] <= _SMALL]
    labels = [label for label in labels if label not in alike]
    table = table[[label in labels for label in zip(table["option"], table["choice"])]]
    figure, axes = new_figure(height=0.75 + 0.2 * len(labels), columns=2, sharey=True)
    heights = {label: len(labels) - i for i, label in enumerate(labels)}
    for panel, angle in zip(axes, ("yaw", "pitch")):
        panel.axvline(1, color="0.6", linestyle="-", linewidth=0.7)
        for row in table[(table["angle"] == angle) & (table["pairs"] > 0)].itertuples():
            y = heights[row.option, row.choice]
            panel.plot([row.q05, row.q95], [y, y], **(MODEL | {"linewidth": 0.8}))
            panel.plot([row.q25, row.q75], [y, y], **(MODEL | {"linewidth": 3.0}), solid_capstyle="butt")
            panel.plot(row.median, y, marker="o", color="black", markersize=3.2, linestyle="none", zorder=3)
        panel.set_xscale("log")
        panel.xaxis.set_major_formatter("{x:g}")
        panel.set_title(angle)
        panel.margins(y=0.03)
    axes[0].set_yticks(list(heights.values()), [_label(*row) for row in heights])
    about = f"\n{len(alike)} other plants: median within {_SMALL - 1:.0%}" if alike else ""
    figure.supxlabel(f"NRMSE, ratio to that of the default choice{about}", fontsize=8)
    return figure


def _label(option, choice):
    return _WORDS.get((option, choice), f"{option}: {choice}".replace("_", " "))


@styled()
def nearest_figure(table: pd.DataFrame, within: float) -> Figure:
    """Every reading's NRMSE of pitch against that of yaw, with the paper's pair under both namings of the angles.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tras.paper.effects.nearest`; every reading is drawn once.
    within : float
        Radius of the dotted lines round the paper's pairs, a distance as in `tras.paper.effects.distance`.
    """
    require(table, "table", ["input", "frequency_unit", "angle_names", "yaw", "pitch"])
    figure, axes = new_figure(height=3.4)
    once = table[table["angle_names"] == "words"]
    hollow = {"linestyle": "none", "markerfacecolor": "none", "markeredgewidth": 0.7}
    for (channel, unit), (marker, colour) in _MARKERS.items():
        group = once[(once["input"] == channel) & (once["frequency_unit"] == unit)]
        axes.plot(group["yaw"], group["pitch"], label=f"{channel}, {unit}", marker=marker, color=colour, **hollow)
    star = {"marker": "*", "markersize": 9, "markeredgecolor": "black", "linestyle": "none", "zorder": 4}
    reach = np.sqrt(2) * within  # the distance is a mean over two angles
    angle = np.linspace(0, 2 * np.pi, 200)
    around = np.exp(reach * np.cos(angle)), np.exp(reach * np.sin(angle))
    for names, fill in (("words", "black"), ("symbols", "white")):
        yaw, pitch = target(names)
        axes.plot(yaw * around[0], pitch * around[1], color="0.4", linestyle=":", linewidth=0.8)
        axes.plot(yaw, pitch, label=f"the paper, angles by its {names}", markerfacecolor=fill, **star)
    axes.set(xscale="log", yscale="log", xlabel="NRMSE of yaw (%)", ylabel="NRMSE of pitch (%)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2, handletextpad=0.2)
    return figure
