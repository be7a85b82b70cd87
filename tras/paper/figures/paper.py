"""The paper's figures of data, and ours of the same models: tables in, `Figure` out. The drawings are in `drawings`."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tras.plotting import LINEAR, MECHANICAL, MODEL, TRUTH, new_figure, require, styled

MODEL_NAMES = {
    "linear": "linear",
    "gaussian": "Gaussian RBF, 2 centres",
    "gaussian28": "Gaussian RBF, many centres",
    "monomials2": "monomials, degree 2",
    "mechanical": "mechanical (ours)",
}
_SPECTRUM_MARKERS = [
    {"marker": "o", "markerfacecolor": "none", "color": "#0072B2", "markersize": 5},
    {"marker": "x", "color": "#D55E00", "markersize": 4},
    {"marker": "s", "markerfacecolor": "none", "color": "black", "markersize": 6},
    {"marker": "+", "color": "#009E73", "markersize": 6},
]
PITCH_COLOUR, YAW_COLOUR = "#0072B2", "#B04A00"


@styled()
def excitation_figure(table: pd.DataFrame) -> Figure:
    """The experiment: references and response of both angles, and the torques that the controller gave.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``time`` in s; ``phi_ref, phi, psi_ref, psi`` in rad; ``u_phi, u_psi`` in N m.
    """
    require(table, "table", ["time", "phi_ref", "phi", "psi_ref", "psi", "u_phi", "u_psi"])
    figure, (pitch, yaw, torque) = new_figure(height=3.6, rows=3)
    for axes, angle, colour, label in (
        (pitch, "phi", PITCH_COLOUR, r"pitch $\phi$ (rad)"),
        (yaw, "psi", YAW_COLOUR, r"yaw $\psi$ (rad)"),
    ):
        axes.plot(table["time"], table[angle], color=colour, linestyle="-", label="response")
        axes.plot(table["time"], table[f"{angle}_ref"], **TRUTH, label="reference")
        axes.set_ylabel(label)
    torque.plot(table["time"], table["u_phi"], color=PITCH_COLOUR, linestyle="-", label="pitch")
    torque.plot(table["time"], table["u_psi"], color=YAW_COLOUR, linestyle="--", label="yaw")
    torque.set(xlabel="time (s)", ylabel="torque (N m)", xlim=(table["time"].min(), table["time"].max()))
    for axes in (pitch, yaw, torque):  # over the panel, where no curve runs
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.96), ncols=2, columnspacing=1.2, borderaxespad=0)
    return figure


_DRAWN = {  # column of the overlay -> its look
    "true": TRUTH | {"label": "truth", "zorder": 3},
    "koopman": MODEL | {"label": "Koopman, the paper's"},
    "linear": LINEAR | {"label": "linear model"},
    "mechanical": MECHANICAL | {"label": "Koopman, mechanical", "zorder": 1.5},
}
_NARROW = 0.25  # of the recording's range: an axis that shows less says so


@styled()
def overlay_figure(table: pd.DataFrame) -> Figure:
    """Fig. 3: truth and prediction over one window, from the same initial state under the same inputs.

    A panel that shows less than a quarter of what the angle does in the recording notes the recording's range.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``input``, ``time`` in s, and in rad ``phi_true, phi_koopman, phi_linear`` and the same of ``psi``. One
        column of panels per input. ``phi_mechanical, psi_mechanical`` are drawn where they are; of ``phi_low,
        phi_high`` and the same of ``psi``, the recording's range, the first row counts.
    """
    curves = [f"{angle}_{who}" for angle in ("psi", "phi") for who in ("true", "koopman", "linear")]
    require(table, "table", ["input", "time", *curves])
    inputs = list(dict.fromkeys(table["input"]))
    figure, axes = new_figure(height=3.3, rows=2, columns=len(inputs), squeeze=False)
    labels = {}
    for column, name in zip(axes.T, inputs):
        window = table[table["input"] == name]
        column[0].set_title(f"input: {name}")
        for panel, angle in zip(column, ("psi", "phi")):
            for who, look in _DRAWN.items():
                if f"{angle}_{who}" in window and window[f"{angle}_{who}"].notna().any():
                    (labels[who],) = panel.plot(window["time"], window[f"{angle}_{who}"], **look)
            _note_range(panel, window, angle)
        column[-1].set(xlabel="time (s)", xlim=(window["time"].min(), window["time"].max()))
    for panel, label in zip(axes[:, 0], (r"yaw $\psi$ (rad)", r"pitch $\phi$ (rad)")):
        panel.set_ylabel(label)
    figure.legend(handles=[labels[who] for who in _DRAWN if who in labels], loc="outside upper center", ncols=2)
    return figure


def _note_range(panel, window, angle):
    low, high = (window.get(f"{angle}_{end}", pd.Series([np.nan])).iloc[0] for end in ("low", "high"))
    if np.ptp(panel.get_ylim()) < _NARROW * (high - low):
        text = f"whole recording: {low:.1f} to {high:.1f} rad".replace("-", "\N{MINUS SIGN}")
        panel.set_title(text, fontsize=7, loc="right", style="italic")  # above the panel, where no curve runs


@styled()
def spectrum_figure(table: pd.DataFrame) -> Figure:
    """Eigenvalues of the Koopman matrix with the unit circle, and of its generator in the complex plane.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``input, model``; ``real, imag`` of the eigenvalues of K; ``rate_real, rate_imag`` in 1/s of those of A.
    """
    require(table, "table", ["input", "model", "real", "imag", "rate_real", "rate_imag"])
    figure, (discrete, continuous) = new_figure(height=2.5, columns=2, sharex=False)
    reach = 1.25 * max(table["imag"].abs().max(), 1e-3)
    angle = np.linspace(-2 * reach, 2 * reach, 400)
    discrete.plot(np.cos(angle), np.sin(angle), color="0.6", linestyle="-", linewidth=0.7)
    continuous.axvline(0, color="0.6", linestyle="-", linewidth=0.7)
    for (name, group), style in zip(table.groupby(["input", "model"], sort=False), _SPECTRUM_MARKERS):
        label = f"{name[0]}, {'linear' if name[1] == 'linear' else 'Gaussian RBF'}"
        discrete.plot(group["real"], group["imag"], linestyle="none", label=label, **style)
        continuous.plot(group["rate_real"], group["rate_imag"], linestyle="none", **style)
    low = min(table["real"].min(), 1) - reach / 4
    discrete.set(xlabel="real part", ylabel="imaginary part", ylim=(-reach, reach))
    discrete.set_xlim(low, table["real"].max() + reach / 4)
    discrete.set_title("$K$, and the unit circle", fontsize=8.6)
    continuous.set(xlabel="real part (1/s)", ylabel="imaginary part (1/s)")
    continuous.margins(0.1)
    figure.get_layout_engine().set(wspace=0.08)
    continuous.set_title(r"$A = \log(K)/T_s$", fontsize=8.6)  # so that the index, 0.7 of it, still reaches 6 points
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.0, handletextpad=0.1)
    return figure


@styled()
def horizon_figure(table: pd.DataFrame) -> Figure:
    """Error against how far ahead is predicted, on independent validation data, for both angles and both inputs.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``input, model, angle`` ("yaw" or "pitch"), ``time`` in s, ``nrmse`` in % (root mean square over the
        windows of the error at that time, over the range of the truth).
    """
    require(table, "table", ["input", "model", "angle", "time", "nrmse"])
    figure, axes = new_figure(height=3.1, rows=2, columns=2, sharey=True)
    for row, angle in zip(axes, ("yaw", "pitch")):
        for panel, name in zip(row, dict.fromkeys(table["input"])):
            rows = table[(table["angle"] == angle) & (table["input"] == name)]
            for model, line in rows.groupby("model", sort=False):
                panel.semilogy(line["time"], line["nrmse"], label=MODEL_NAMES.get(model, model))
            panel.set_title(f"{angle}, input: {name}")
    for panel in axes[-1]:
        panel.set_xlabel("time ahead (s)")
    axes[0, 0].yaxis.set_major_formatter("{x:g}")  # 0.1, not a power with an index too small to read
    # Below 3e-5 the first instants of a good model would squeeze the rest.
    axes[0, 0].set_ylim(bottom=max(table["nrmse"].min(), 3e-5))
    figure.supylabel("root mean square error (% of range)", fontsize=8)
    fullest = max(axes.flat, key=lambda panel: len(panel.lines))
    figure.legend(*fullest.get_legend_handles_labels(), loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure
