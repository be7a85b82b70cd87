"""Figures of the closed loops: what follows what, what a disturbance costs, and how long a step takes."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tras.plotting import LINEAR, MECHANICAL, MODEL, TRUTH, new_figure, require, styled

LOOKS = {  # controller -> how its line looks
    "PID": {"color": "0.45", "linestyle": "-.", "linewidth": 1.0},
    "MPC, linear": LINEAR,
    "MPC, mechanical": MECHANICAL,
    "MPC, true plant": MODEL,
}
MARKERS = {"PID": "v", "MPC, linear": "o", "MPC, mechanical": "D", "MPC, true plant": "."}
PANELS = [  # channel, name, reference or limits
    ("phi", r"pitch $\phi$ (rad)", ["phi_reference"]),
    ("psi", r"yaw $\psi$ (rad)", ["psi_reference"]),
    ("u_phi", r"$u_\phi$ (N m)", ["u_phi_low", "u_phi_high"]),
    ("u_psi", r"$u_\psi$ (N m)", ["u_psi_low", "u_psi_high"]),
]
LEAST = 1e-6  # s: what no step is shorter than, so that a logarithm exists


@styled()
def tracking_figure(table: pd.DataFrame) -> Figure:
    """Angles under a reference, and the torques within their limits, of several controllers over time.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``controller, time`` (s), ``phi, psi, phi_reference, psi_reference`` (rad), ``u_phi, u_psi`` and their
        limits ``u_phi_low``, ``u_phi_high``, ``u_psi_low``, ``u_psi_high`` (N m).
    """
    require(table, "table", ["controller", "time", *(name for panel in PANELS for name in (panel[0], *panel[2]))])
    figure, axes = new_figure(height=4.6, rows=len(PANELS))
    for panel, (channel, label, bounds) in zip(axes, PANELS):
        for name, rows in table.groupby("controller", sort=False):
            panel.plot(rows["time"], rows[channel], **LOOKS.get(name, MODEL), label=name)
        first = table[table["controller"] == table["controller"].iloc[0]]
        for bound in bounds:
            if channel.startswith("u_"):
                panel.plot(first["time"], first[bound], color="0.3", linestyle=":", linewidth=0.8)
            else:
                panel.plot(first["time"], first[bound], **TRUTH, label="reference", zorder=4)
        panel.set_ylabel(label)
    axes[-1].set_xlabel("time (s); dotted: limits of the torques")
    axes[-1].set_xlim(table["time"].min(), table["time"].max())
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def disturbance_figure(table: pd.DataFrame) -> Figure:
    """Error against the size of a disturbance, one column per kind of gust and one row per angle.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``controller, condition, level`` (%), ``pitch, yaw`` (rad, root mean squares).
    """
    require(table, "table", ["controller", "condition", "level", "pitch", "yaw"])
    kinds = list(dict.fromkeys(table["condition"]))
    figure, axes = new_figure(height=3.2, rows=2, columns=len(kinds), squeeze=False, sharey="row")
    for row, angle in zip(axes, ("pitch", "yaw")):
        for panel, kind in zip(row, kinds):
            for name, rows in table[table["condition"] == kind].groupby("controller", sort=False):
                rows = rows.sort_values("level")
                look = LOOKS.get(name, MODEL)
                panel.semilogy(rows["level"], rows[angle], **look, marker=MARKERS.get(name, "o"), label=name)
            panel.set_title(f"{angle}, {kind}")
            panel.set_xticks(sorted(table["level"].unique()))
            panel.xaxis.set_major_formatter("{x:g}")
            panel.yaxis.set_minor_formatter("")
            panel.grid(axis="y")
    figure.supxlabel("torque of the gusts (% of half the range of each torque)", fontsize=8)
    figure.supylabel("root mean square error (rad)", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def times_figure(table: pd.DataFrame, sampling_time: float) -> Figure:
    """How long the steps of each controller took, a histogram on a logarithmic axis, beside the sampling time.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``controller, seconds``, as from `tras.paper.control.solve_times`.
    sampling_time : float
        In s: a vertical line.
    """
    require(table, "table", ["controller", "seconds"])
    names = list(dict.fromkeys(table["controller"]))
    figure, axes = new_figure(height=0.7 + 0.42 * len(names), rows=len(names), squeeze=False)
    seconds = table["seconds"].clip(lower=LEAST)
    edges = np.geomspace(1e3 * seconds.min() / 1.1, 1e3 * max(seconds.max(), sampling_time) * 1.3, 60)
    for panel, name in zip(axes[:, 0], names):
        panel.hist(1e3 * seconds[table["controller"] == name], bins=edges, color=MODEL["color"])
        panel.axvline(1e3 * sampling_time, color=LINEAR["color"], linestyle="-", linewidth=1.0)
        panel.set_xscale("log")
        panel.set_yticks([])
        panel.set_ylabel(name.removeprefix("MPC, "), rotation=0, ha="right", va="center")
    axes[-1, 0].xaxis.set_major_formatter("{x:g}")
    axes[-1, 0].set_xlabel("time of a step of the MPC (ms); vertical line: the sampling time")
    return figure
