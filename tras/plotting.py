"""Figures: tables in, `Figure` out.

No analysis happens here. A figure function takes the table of numbers that it shows, and that table is saved beside the
picture, so that every figure can be checked, compared and redrawn. Figures are built without pyplot's global state: they
need no display, leak no open windows and do not disturb one another.

To add a figure, write ``@styled()`` over a function that takes one or more tables, start with `new_figure`, and save with
`save_figure`.
"""

from contextlib import ExitStack, contextmanager
from pathlib import Path

import matplotlib.style
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tras.workflow.files import replacing

STYLE = Path(__file__).with_name("tras.mplstyle")
WIDTH = 3.5  # one journal column, inches

# Roles that recur from figure to figure look the same in all of them.
TRUTH = {"color": "black", "linestyle": ":", "linewidth": 1.3}
MODEL = {"color": "#0072B2", "linestyle": "-", "linewidth": 1.1}
LINEAR = {"color": "#D55E00", "linestyle": (0, (4, 3)), "linewidth": 1.1}
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


@contextmanager
def styled():
    """Apply the project's style inside a ``with`` block or, as ``@styled()``, to a function.

    The style starts from matplotlib's own defaults: a user's settings do not change the figures.
    """
    with matplotlib.style.context(STYLE, after_reset=True):
        yield


@styled()
def new_figure(height=2.4, rows=1, columns=1, sharex=True, **subplot_options):
    """Make an empty figure one column wide.

    Parameters
    ----------
    height : float
        In inches.
    rows, columns : int
        Panels; those of one column share their x axis if `sharex`.
    sharex : bool or str
        As in `matplotlib.figure.Figure.subplots`.
    **subplot_options
        More options of that function, such as ``height_ratios``.

    Returns
    -------
    figure : matplotlib.figure.Figure
    axes : matplotlib.axes.Axes, or ndarray of them when there is more than one panel
    """
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=sharex, **subplot_options)
    figure.align_ylabels()
    return figure, axes


def save_figure(figure, table, stem):
    """Write a figure and the numbers behind it: ``stem``.pdf, .svg, .png and .csv.

    The same figure and table give the same bytes on the same machine: no file holds a date or a version. Each file is
    complete when it appears under its name; all four are prepared before the first one is moved into place, so that a full
    disk or a killed run leaves the older set standing.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    table : pandas.DataFrame
        The numbers that the figure shows. Its index is not written.
    stem : str or path
        Path without suffix; missing folders are made.

    Returns
    -------
    list of pathlib.Path
        The four files, in the order above.

    Raises
    ------
    TypeError
        If `figure` or `table` is something else.
    """
    if not isinstance(figure, Figure):
        raise TypeError(f"figure must be a matplotlib Figure, not {type(figure).__name__}.")
    if not isinstance(table, pd.DataFrame):
        raise TypeError(
            f"table must be a pandas DataFrame with the numbers behind the figure, not {type(table).__name__}."
        )
    stem = Path(stem)
    # The suffix is appended by hand: Path.with_suffix would cut a stem such as "error_0.5s".
    finals = [stem.with_name(f"{stem.name}.{suffix}") for suffix in ("pdf", "svg", "png", "csv")]
    with ExitStack() as stack:
        _write(figure, table, *[stack.enter_context(replacing(path)) for path in finals])
    return finals


@styled()
def _write(figure, table, pdf, svg, png, csv):
    if figure.get_layout_engine() is not None:
        # Every draw lays out anew, from where the last one left off: settled once, the same figure gives the same bytes again.
        figure.draw_without_rendering()
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    # None leaves an entry out: dates change from run to run and versions from machine to machine. The style must hold here
    # as well, because dpi, fonts and the hash salt of SVG are looked up when a figure is written.
    figure.savefig(pdf, format="pdf", metadata={"Creator": None, "Producer": None, "CreationDate": None})
    figure.savefig(svg, format="svg", metadata={"Creator": None, "Date": None})
    figure.savefig(png, format="png", metadata={"Software": None})
    # Ten digits: far more than a figure shows or `make verify` compares, and few enough to drop the last bits of a fit,
    # which change with the processor and the number of BLAS threads (1e-16, grown by the condition number).
    table.to_csv(csv, index=False, float_format="%.10g", lineterminator="\n", encoding="utf-8")


# ------------------------------------------------------------------------------------------------ figures of the data


@styled()
def excitation_figure(table):
    """The experiment: references and response of both angles, and the torques that the controller gave.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``time`` in s; ``phi_ref, phi, psi_ref, psi`` in rad; ``u_phi, u_psi`` in N m.

    Returns
    -------
    matplotlib.figure.Figure
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
    for axes in (pitch, yaw, torque):
        _legend_above(axes)
    return figure


@styled()
def overlay_figure(table):
    """Fig. 3: truth and prediction over one window, from the same initial state under the same inputs.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``input``, ``time`` in s, and in rad ``phi_true, phi_koopman, phi_linear`` and the same of ``psi``; a column of
        panels for each input.

    Returns
    -------
    matplotlib.figure.Figure
    """
    require(
        table,
        "table",
        ["input", "time", *(f"{q}_{who}" for q in ("psi", "phi") for who in ("true", "koopman", "linear"))],
    )
    inputs = list(dict.fromkeys(table["input"]))
    figure, axes = new_figure(height=2.9, rows=2, columns=len(inputs), squeeze=False)
    for column, name in zip(axes.T, inputs):
        window = table[table["input"] == name]
        for panel, angle in zip(column, ("psi", "phi")):
            panel.plot(window["time"], window[f"{angle}_true"], **TRUTH, label="truth", zorder=3)
            panel.plot(window["time"], window[f"{angle}_koopman"], **MODEL, label="Koopman")
            panel.plot(window["time"], window[f"{angle}_linear"], **LINEAR, label="linear model")
        column[0].set_title(f"input: {name}")
        column[-1].set(xlabel="time (s)", xlim=(window["time"].min(), window["time"].max()))
    for panel, label in zip(axes[:, 0], (r"yaw $\psi$ (rad)", r"pitch $\phi$ (rad)")):
        panel.set_ylabel(label)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@styled()
def spectrum_figure(table):
    """Eigenvalues of the Koopman matrix with the unit circle, and of its generator in the complex plane.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``input, model``; ``real, imag`` of the eigenvalues of K; ``rate_real, rate_imag`` in 1/s of those of A.

    Returns
    -------
    matplotlib.figure.Figure
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
    discrete.set(
        xlabel="real part", ylabel="imaginary part", ylim=(-reach, reach), xlim=(low, table["real"].max() + reach / 4)
    )
    discrete.set_title("$K$, and the unit circle", fontsize=8.6)
    continuous.set(xlabel="real part (1/s)", ylabel="imaginary part (1/s)")
    continuous.margins(0.1)
    figure.get_layout_engine().set(wspace=0.08)
    continuous.set_title(r"$A = \log(K)/T_s$", fontsize=8.6)  # so that the index, 0.7 of it, still reaches 6 points
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.0, handletextpad=0.1)
    return figure


@styled()
def horizon_figure(table):
    """Error against how far ahead is predicted, on independent validation data, for both angles and both inputs.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``input, model, angle`` ("yaw" or "pitch"), ``time`` in s, ``nrmse`` in % (root mean square over the windows
        of the error at that time, over the range of the truth).

    Returns
    -------
    matplotlib.figure.Figure
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
    axes[0, 0].set_ylim(
        bottom=max(table["nrmse"].min(), 3e-5)
    )  # the first instants of a good model would squeeze the rest
    figure.supylabel("root mean square error (% of range)", fontsize=8)
    fullest = max(axes.flat, key=lambda panel: len(panel.lines))
    figure.legend(*fullest.get_legend_handles_labels(), loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure


def _legend_above(axes):
    """The legend over the panel, where no curve runs."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.96), ncols=2, columnspacing=1.2, borderaxespad=0)


def require(table, name, columns):
    """Raise a clear error unless `table` is a DataFrame with these columns; `name` is the argument's name."""
    if not isinstance(table, pd.DataFrame):
        raise TypeError(f"{name} must be a pandas DataFrame, not {type(table).__name__}.")
    missing = [column for column in columns if column not in table]
    if missing:
        raise ValueError(f"{name} lacks the columns {', '.join(missing)}; it has {', '.join(map(str, table.columns))}.")
