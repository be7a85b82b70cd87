"""Figures of the study of readings: what each option does to the error, and where all readings lie beside the paper's two numbers."""

import numpy as np

from tras.paper.effects import target
from tras.plotting import MODEL, new_figure, require, styled

_CHOICES = {"frequency_unit": "frequencies", "nrmse_range": "range", "velocity_term": "velocity term"}
_MARKERS = {  # (input, frequency unit) -> how its readings are drawn
    ("reference", "rad/s"): {"marker": "o", "color": "#0072B2"},
    ("reference", "Hz"): {"marker": "s", "color": "#009E73"},
    ("torque", "rad/s"): {"marker": "^", "color": "#D55E00"},
    ("torque", "Hz"): {"marker": "x", "color": "black"},
}


@styled()
def effects_figure(table):
    """Ratio of NRMSE to that under the default choice, all else equal: median, middle half and middle nine tenths of all pairs.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tras.paper.effects.effects`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    require(table, "table", ["option", "choice", "angle", "pairs", "median", "q05", "q25", "q75", "q95"])
    labels = list(dict.fromkeys(zip(table["option"], table["choice"])))
    figure, axes = new_figure(height=0.75 + 0.2 * len(labels), columns=2, sharey=True)
    places = {label: len(labels) - i for i, label in enumerate(labels)}
    for panel, angle in zip(axes, ("yaw", "pitch")):
        panel.axvline(1, color="0.6", linestyle="-", linewidth=0.7)
        for row in table[(table["angle"] == angle) & (table["pairs"] > 0)].itertuples():
            y = places[row.option, row.choice]
            panel.plot([row.q05, row.q95], [y, y], **(MODEL | {"linewidth": 0.8}))
            panel.plot([row.q25, row.q75], [y, y], **(MODEL | {"linewidth": 3.0}), solid_capstyle="butt")
            panel.plot(row.median, y, marker="o", color="black", markersize=3.2, linestyle="none", zorder=3)
        panel.set_xscale("log")
        panel.xaxis.set_major_formatter("{x:g}")
        panel.set_title(angle)
        panel.margins(y=0.03)
    axes[0].set_yticks(list(places.values()), [f"{_CHOICES.get(o, o)}: {c.replace('_', ' ')}" for o, c in places])
    figure.supxlabel("NRMSE, ratio to that of the default choice", fontsize=8)
    return figure


@styled()
def nearest_figure(table, within):
    """Every reading's NRMSE of pitch against that of yaw, with the paper's pair under both namings of the angles.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tras.paper.effects.nearest`; every reading is drawn once.
    within : float
        Radius of the dotted lines round the paper's pairs, a distance as in `tras.paper.effects.distance`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    require(table, "table", ["input", "frequency_unit", "angle_names", "yaw", "pitch"])
    figure, axes = new_figure(height=3.4)
    once = table[table["angle_names"] == "words"]
    for key, style in _MARKERS.items():
        group = once[(once["input"] == key[0]) & (once["frequency_unit"] == key[1])]
        axes.plot(
            group["yaw"],
            group["pitch"],
            linestyle="none",
            label=f"{key[0]}, {key[1]}",
            markerfacecolor="none",
            markeredgewidth=0.7,
            **style,
        )
    angle = np.linspace(0, 2 * np.pi, 200)
    for names, fill in (("words", "black"), ("symbols", "white")):
        yaw, pitch = target(names)
        reach = np.sqrt(2) * within  # the distance is a mean over two angles
        axes.plot(
            yaw * np.exp(reach * np.cos(angle)),
            pitch * np.exp(reach * np.sin(angle)),
            color="0.4",
            linestyle=":",
            linewidth=0.8,
        )
        star = {
            "marker": "*",
            "markersize": 9,
            "markerfacecolor": fill,
            "markeredgecolor": "black",
            "linestyle": "none",
            "zorder": 4,
        }
        axes.plot(yaw, pitch, label=f"the paper, angles by its {names}", **star)
    axes.set(xscale="log", yscale="log", xlabel="NRMSE of yaw (%)", ylabel="NRMSE of pitch (%)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2, handletextpad=0.2)
    return figure
