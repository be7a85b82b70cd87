"""Pictures of one model: those of the explorer, and the vector field beside the true one. See `tras.plotting`."""

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from tras.plotting import LINEAR, MODEL, TRUTH, new_figure, require, styled

BOX_COLOUR = "#0072B2"
_ANGLES = {"pitch": "phi", "yaw": "psi"}
_ROLES = {"koopman": MODEL | {"label": "Koopman"}, "linear": LINEAR | {"label": "linear model"}}


@styled()
def outcome_figure(overlay: pd.DataFrame, growth: pd.DataFrame, spectrum: pd.DataFrame) -> Figure:
    """One model in four panels: prediction of both angles, error against horizon, spectrum of K with the unit circle.

    Parameters
    ----------
    overlay : pandas.DataFrame
        ``time`` (s) and in rad ``phi_true, phi_koopman, phi_linear`` and the same for ``psi``; columns of NaN are not
        drawn.
    growth : pandas.DataFrame
        ``model`` ("Koopman" or "linear"), ``angle, time`` (s), ``nrmse`` (%).
    spectrum : pandas.DataFrame
        ``model, real, imag`` of the eigenvalues of K.

    Returns
    -------
    matplotlib.figure.Figure
        Two columns wide, for the screen.
    """
    series = ("true", "koopman", "linear")
    require(overlay, "overlay", ["time", *(f"{angle}_{name}" for angle in ("psi", "phi") for name in series)])
    require(growth, "growth", ["model", "angle", "time", "nrmse"])
    require(spectrum, "spectrum", ["model", "real", "imag"])
    figure = Figure(figsize=(7.2, 3.9))
    layout = {"left": 0.08, "right": 0.985, "bottom": 0.115, "top": 0.9, "hspace": 0.54, "wspace": 0.24}
    (yaw, error), (pitch, plane) = figure.subplots(2, 2, gridspec_kw=layout)  # to compute it takes longer than the fit
    _overlay_panel(yaw, overlay, "psi", r"yaw $\psi$ (rad)")
    _overlay_panel(pitch, overlay, "phi", r"pitch $\phi$ (rad)")
    _error_panel(error, growth)
    _spectrum_panel(plane, spectrum)
    figure.legend(*yaw.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.07, 0.995), ncols=3)
    return figure


def _overlay_panel(panel, overlay, angle, label):
    true = overlay[f"{angle}_true"]
    panel.plot(overlay["time"], true, **TRUTH, label="truth", zorder=3)
    for name, style in _ROLES.items():
        if overlay[f"{angle}_{name}"].notna().any():
            panel.plot(overlay["time"], overlay[f"{angle}_{name}"], **style)
    margin = 0.6 * max(np.ptp(true), 0.05)  # a prediction that diverges must not squeeze the truth to a line
    low, high = panel.get_ylim()
    panel.set_ylim(max(low, true.min() - margin), min(high, true.max() + margin))
    panel.set(xlabel="time (s)", ylabel=label, xlim=(overlay["time"].min(), overlay["time"].max()))


def _error_panel(panel, growth):
    for (name, angle), line in growth.groupby(["model", "angle"], sort=False):
        panel.plot(line["time"], line["nrmse"], **_ROLES[name.lower()] | {"linewidth": 1.6 if angle == "yaw" else 0.8})
    early = growth[growth["nrmse"] > 0].groupby(["model", "angle"])["nrmse"].quantile(0.1)
    if len(early):
        panel.set_yscale("log")
        panel.set_ylim(bottom=max(0.5 * early.min(), 1e-6))  # the first instants of a good model would squeeze the rest
        panel.yaxis.set_major_formatter("{x:g}")
        panel.yaxis.set_minor_formatter("")
    panel.set_title("all windows (thick: yaw, thin: pitch)", fontsize=8.6)
    panel.set(xlabel="time ahead (s)", ylabel="error (% of range)", xlim=(0, growth["time"].max()))


def _spectrum_panel(panel, spectrum):
    circle = np.linspace(0, 2 * np.pi, 2001)
    panel.plot(np.cos(circle), np.sin(circle), color="0.6", linestyle="-", linewidth=0.7)
    circles, crosses = {"marker": "o", "markerfacecolor": "none", "markersize": 5}, {"marker": "x", "markersize": 4}
    for name, group in spectrum.groupby("model", sort=False):
        look = {"color": _ROLES[name.lower()]["color"], **(crosses if name == "linear" else circles)}
        panel.plot(group["real"], group["imag"], linestyle="none", **look)
    left, right = min(spectrum["real"].min(), 1), max(spectrum["real"].max(), 1)
    reach = max(1.25 * spectrum["imag"].abs().max(), 0.6 * (right - left), 1e-3)
    side = 0.08 * (right - left) + 0.25 * reach
    panel.set(xlabel="real part", ylabel="imaginary part", xlim=(left - side, right + side), ylim=(-reach, reach))
    for axis in (panel.xaxis, panel.yaxis):  # without a power above the axis, which would push the title upwards
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        axis.set_major_formatter("{x:.4g}")
    panel.set_title("eigenvalues of $K$, and the unit circle", fontsize=8.6)


@styled()
def portrait_figure(table: pd.DataFrame) -> Figure:
    """The true and the identified vector fields, one row per plane; the colour is the error of the acceleration.

    The dashed box holds the training data. ``table`` is from `tras.explorer.portraits.portrait`.
    """
    box = ["angle_low", "angle_high", "rate_low", "rate_high"]
    require(table, "table", ["model", "plane", "angle", "rate", "d_angle", "d_rate", "error", *box])
    names = list(dict.fromkeys(table["model"]))
    labels = {plane: (rf"{plane} $\{angle}$ (rad)", rf"$\dot\{angle}$ (rad/s)") for plane, angle in _ANGLES.items()}
    figure, axes = new_figure(height=3.8, rows=2, columns=len(names), squeeze=False, sharex="row", sharey="row")
    errors = table["error"][table["model"] != "true"]
    norm = LogNorm(max(errors.quantile(0.02), 1e-6), max(errors.max(), 2e-6)) if len(errors) else None
    mesh = None
    for row, (plane, (across, up)) in zip(axes, labels.items()):
        for panel, name in zip(row, names):
            cells = table[(table["model"] == name) & (table["plane"] == plane)]
            mesh = _portrait_panel(panel, cells, norm if name != "true" else None) or mesh
            left, right, low, high = cells[box].iloc[0]
            look = {"fill": False, "edgecolor": BOX_COLOUR, "linestyle": (0, (3, 1.5)), "linewidth": 1.2, "zorder": 4}
            panel.add_patch(Rectangle((left, low), right - left, high - low, **look))
            panel.set_xlabel(across)
        row[0].set_ylabel(up)
    for panel, name in zip(axes[0], names):
        panel.set_title(name)
    if mesh:
        look = {"location": "bottom", "shrink": 0.9, "aspect": 35, "format": "{x:g}"}  # exponents would be illegible
        bar = figure.colorbar(mesh, ax=axes.ravel().tolist(), label="error of the acceleration (rad/s²)", **look)
        bar.ax.minorticks_off()
    line = {"color": BOX_COLOUR, "linestyle": (0, (3, 1.5)), "linewidth": 1.2}
    figure.legend(handles=[Line2D([], [], **line, label="box of the training data")], loc="outside upper center")
    return figure


def _portrait_panel(panel, cells, norm):
    first, second = (np.unique(cells[name]) for name in ("angle", "rate"))
    fields = {name: cells[name].to_numpy().reshape(len(second), len(first)) for name in ("d_angle", "d_rate", "error")}
    mesh = None
    if norm:
        look = {"norm": norm, "cmap": "YlOrRd", "shading": "gouraud", "rasterized": True}
        mesh = panel.pcolormesh(first, second, np.maximum(fields["error"], norm.vmin), **look)
    # streamplot requires steps that are equal to the last bit.
    even = [np.linspace(values[0], values[-1], len(values)) for values in (first, second)]
    look = {"density": 0.55, "color": "0.15", "linewidth": 0.6, "arrowsize": 0.5}
    panel.streamplot(*even, fields["d_angle"], fields["d_rate"], **look)
    panel.set(xlim=(first[0], first[-1]), ylim=(second[0], second[-1]))
    return mesh
