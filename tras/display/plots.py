"""Plots of recordings and models: channels over time, measured against simulated, eigenvalues.

Each function draws a figure one column wide, or into axes of the caller's own, and returns the figure. Truth and
predictions differ by their dashes, not by colour alone; names of channels are text, whatever they hold.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.textpath import TextPath

from tras import metrics
from tras.dictionaries.base import label
from tras.plotting import LINEAR, MODEL, TRUTH, WIDTH, new_figure, plain, require, styled
from tras.workflow.arguments import short

if TYPE_CHECKING:
    from tras.estimator import Estimator
    from tras.model import KoopmanModel
    from tras.recording import Recording

MOST = 6  # panels; others on request
CURVE = 3000  # samples of a curve, about
_NAME = 22  # letters of a model in a legend, at most
_MODELS = [
    MODEL,
    LINEAR,
    {"color": "#009E73", "linestyle": "-.", "linewidth": 1.1},
    {"color": "#CC79A7", "linestyle": (0, (6, 1.5, 1, 1.5, 1, 1.5)), "linewidth": 1.1},
    {"color": "0.5", "linestyle": (0, (9, 2)), "linewidth": 1.1},
]
_MARKERS = [
    {"marker": "o", "markerfacecolor": "none", "color": "#0072B2", "markersize": 4},
    {"marker": "x", "color": "#D55E00", "markersize": 4.5},
]


def with_units(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """Labels of axes: names with their units in brackets, ready to be drawn."""
    return [plain(f"{name} ({unit})" if unit else name) for name, unit in zip(names, units)]


def curves(recording: "Recording") -> pd.DataFrame:
    """The recording as one table: ``trajectory``, ``time`` from its beginning, channels; about `CURVE` rows."""
    table = recording.to_frame()
    starts = np.concatenate([[0.0], np.cumsum(recording.lengths[:-1] * recording.dt)])
    table["time"] += np.repeat(starts, recording.lengths)
    return table.iloc[:: max(1, len(table) // CURVE)].reset_index(drop=True)


@styled()
def data_figure(table: pd.DataFrame, names: list[str], units: list[str], ax=None) -> Figure:
    """The recording: every channel over time, trajectories one after the other, their beginnings marked.

    The table has ``trajectory, time`` (s, from the recording's beginning) and one column per channel; at most six
    channels are shown.
    """
    require(table, "table", ["trajectory", "time", *names])
    names, units = names[:MOST], units[:MOST]
    panels = _panels(ax, len(names), height=0.75 * len(names) + 0.55)
    first = np.flatnonzero(table["trajectory"].diff() > 0)
    begins, time = table["time"].iloc[first], np.insert(np.asarray(table["time"]), first, np.nan)
    for panel, name, title in zip(panels, names, with_units(names, units)):
        values = np.insert(
            np.asarray(table[name], dtype=float), first, np.nan
        )  # no line from one trajectory to the next
        panel.plot(time, values, color="black", linestyle="-", linewidth=0.6)
        panel.set_title(title, fontsize=8, pad=2)
        for begin in begins if len(begins) <= 40 else ():
            panel.axvline(begin, color="0.8", linewidth=0.4, linestyle="-", zorder=0)
    panels[-1].set_xlabel("time (s)")
    return panels[0].figure


def recording_figure(recording: "Recording", channels: Sequence[str] | None = None, ax=None) -> Figure:
    """See `tras.Recording.plot`."""
    units = dict(zip(recording.state_names, recording.state_units)) | dict(
        zip(recording.input_names, recording.input_units)
    )
    if channels is None:
        states = max(MOST // 2, MOST - recording.m)  # leaves room for inputs
        channels = [*recording.state_names[:states], *recording.input_names][:MOST]
    channels = _chosen("channels", channels, list(units))
    return data_figure(curves(recording), channels, [units[name] for name in channels], ax)


class Comparison(NamedTuple):
    """What `compare` returns: ``table, figure = tras.compare(recording, model)``. A notebook shows both."""

    table: pd.DataFrame
    figure: Figure

    def __repr__(self):
        return self.table.round(3).to_string(index=False)

    def _repr_html_(self):
        from tras.display import html

        return html.comparison_html(self)


def compare(
    recording: "Recording",
    *models: "Estimator",
    names: Sequence[str] | None = None,
    states: Sequence[str] | None = None,
    trajectory: int = 0,
    ax: "Axes | Sequence[Axes] | None" = None,
) -> Comparison:
    """Measured states against those that models simulate from the first samples under the recording's inputs.

    The fit is 100 % times one minus the norm of the error over that of the measured state's distance from its mean, 0 %
    where it is no better than that mean (`tras.metrics.bfr`). All models begin to predict at the same sample, after the
    longest delays. A prediction that runs away is drawn up to the edge of the frame, with a triangle there.

    Parameters
    ----------
    recording : Recording
        Best one that no model was fitted to.
    *models : KoopmanModel
        Fitted, at most five.
    names : sequence of str, optional
        One per model. Default: what their dictionaries are called.
    states : sequence of str, optional
        At most six to draw. Default: the first six that the models predict.
    trajectory : int
        The one to draw.
    ax : matplotlib Axes or sequence of them, optional
        Where to draw, one per state. Default: a new figure.

    Returns
    -------
    table : pandas.DataFrame
        Of all trajectories that are long enough, a row per state and model: ``state, model, fit`` (percent), ``nrmse``
        (percent of the range), ``trajectories`` and ``diverged``, how many of them were lost; these are left out of fit
        and nrmse, which are NaN if all are.
    figure : matplotlib.figure.Figure
        Of one trajectory, the fit of each state to it in the legend.

    Raises
    ------
    ValueError
        If there is no model, one is not fitted or has other channels, or there is no such state or trajectory, or it is
        too short.

    Examples
    --------
    >>> import numpy as np, tras
    >>> x = np.exp(-0.1 * np.arange(50))[:, None] * [[1.0, -2.0]]
    >>> recording = tras.Recording([x[:, :1], x[:, 1:]], dt=0.1)
    >>> model = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(recording)
    >>> table, figure = tras.compare(recording, model, names=["decay"])
    >>> table[["state", "model", "fit"]].round(3)
      state  model    fit
    0    x1  decay  100.0
    >>> [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    ['measured', 'decay: 100 %']
    """
    _check_models(recording, models, names, trajectory)
    names = _names(models) if names is None else [str(name) for name in names]
    latest = max(model.delays for model in models)
    shown = recording[int(trajectory)]
    long = recording.lengths >= latest + 2
    long[int(trajectory)] = True  # or its error says what is wrong
    judged = [_judged(model, recording[long], latest) for model in models]
    rows = []
    for name, model, (_, scores) in zip(names, models, judged):
        lost = {"trajectories": scores.windows, "diverged": scores.diverged}
        for state, fit, error in zip(model.state_names_, scores.bfr, scores.nrmse):
            rows.append({"state": state, "model": name, "fit": fit, "nrmse": error} | lost)
    rows.sort(key=lambda row: recording.state_names.index(row["state"]))
    at = int(np.sum(long[: range(len(recording))[int(trajectory)]]))
    runs = [runs[at] for runs, _ in judged]
    which = f", trajectory {trajectory} of {len(recording)}" if len(recording) > 1 else ""
    return Comparison(pd.DataFrame(rows), run_figure(shown, models, runs, names, states, which, ax))


def one_run(recording: "Recording", model: "Estimator", trajectory: int = 0, ax=None) -> Figure:
    """See `tras.KoopmanModel.plot`: the figure of `compare`, without predicting the other trajectories."""
    _check_models(recording, [model], None, trajectory)
    shown = recording[int(trajectory)]
    which = f", trajectory {trajectory} of {len(recording)}" if len(recording) > 1 else ""
    return run_figure(shown, [model], [_judged(model, shown, model.delays)[0][0]], _names([model]), which=which, ax=ax)


@styled()
def run_figure(shown: "Recording", models, runs, names, states=None, which: str = "", ax=None) -> Figure:
    """The one trajectory of ``shown`` and what models make of it; a run (samples, n) ends where the trajectory does."""
    predicted = [name for name in shown.state_names if any(name in model.state_names_ for model in models)]
    states = _chosen("states", predicted[:MOST] if states is None else states, predicted)
    names = [plain(short(str(name), _NAME)) for name in names]
    rows, columns = _grid(["measured", *(f"{name}: 99.9 %" for name in names)])
    panels = _panels(ax, len(states), height=(0.72 + 0.14 * rows) * len(states) + 0.35)
    samples = len(shown.states[0])
    time = np.arange(samples) * shown.dt
    units = dict(zip(shown.state_names, shown.state_units))
    scored = [_fits(model, run, shown) for model, run in zip(models, runs)]
    for panel, state in zip(panels, states):
        true = shown.select(states=[state]).states[0][:, 0]
        lines, legend = panel.plot(time, true, **TRUTH, zorder=3), ["measured"]
        curves = [(name, fits[state], style) for name, fits, style in zip(names, scored, _MODELS) if state in fits]
        frame = frame_of(true, *(values for _, (values, _), _ in curves))
        for name, (values, fit), style in curves:
            lines.append(draw_in_frame(panel, time[samples - len(values) :], values, frame, **style))
            legend.append(f"{name}: {fit}")
        panel.set_ylabel(with_units([state], [units[state]])[0])
        panel.legend(lines, legend, loc="lower left", bbox_to_anchor=(0, 1), ncols=columns, columnspacing=1.0)
    panels[-1].set_xlabel(f"time (s){which}")
    return panels[0].figure


@styled()
def eigenvalue_figure(table: pd.DataFrame, ax=None) -> Figure:
    """Eigenvalues of Koopman matrices with the unit circle, whole and near one; whole alone in axes of one's own.

    The table has ``model`` (one name or two), ``real, imag``.
    """
    require(table, "table", ["model", "real", "imag"])
    if ax is None:
        figure, (whole, near) = new_figure(formulas=False, height=2.35, columns=2, sharex=False)
    else:
        (whole,), near = _panels(ax, 1), None
        figure = whole.figure
    angle = np.linspace(0, 2 * np.pi, 721)
    for panel in (whole, near) if near is not None else (whole,):
        panel.plot(np.cos(angle), np.sin(angle), color="0.6", linestyle="-", linewidth=0.7)
        for (name, group), marker in zip(table.groupby("model", sort=False), _MARKERS):
            panel.plot(group["real"], group["imag"], linestyle="none", label=plain(str(name)), **marker)
        panel.set(xlabel="real part")
    reach = 1.15 * max(1.0, np.abs(np.asarray(table[["real", "imag"]])).max())
    whole.set(ylabel="imaginary part", xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    if near is None:
        return figure
    distance = np.asarray(np.hypot(table["real"] - 1, table["imag"]))
    distance = distance[distance > 1e-6]
    zoom = float(np.clip(1.3 * np.quantile(distance, 0.5), 1e-4, 1.0)) if len(distance) else 0.1
    near.set(xlim=(1 - zoom, 1 + zoom), ylim=(-zoom, zoom), aspect="equal")
    whole.set_title("all", fontsize=8, pad=3)
    near.set_title("near one", fontsize=8, pad=3)
    near.locator_params(nbins=4)
    near.ticklabel_format(useOffset=False)
    if len(set(table["model"])) > 1:
        figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


@styled()
def residual_figure(table: pd.DataFrame, significance: float = 0.01) -> Figure:
    """Correlations of residuals over the lags: a row per state, a column for itself and each input, at most six each.

    The table has ``state, against, lag, correlation, bound, tested``. Lags that are not tested are grey; the band holds
    all but ``significance`` of what a single lag shows by chance.
    """
    require(table, "table", ["state", "against", "lag", "correlation", "bound", "tested"])
    states, others = list(dict.fromkeys(table["state"]))[:MOST], list(dict.fromkeys(table["against"]))[:MOST]
    table = table.loc[table["state"].isin(states) & table["against"].isin(others)]
    rows, columns = len(states), len(others)
    figure, panels = new_figure(
        0.8 * rows + 0.75, rows, columns, formulas=False, sharex="col", sharey=True, squeeze=False
    )
    figure.set_figwidth(WIDTH * max(1, columns / 3))
    judged = table.loc[table["tested"]]
    correlation, bound = (np.asarray(judged[key], dtype=float) for key in ("correlation", "bound"))
    reach = 1.15 * np.nanmax(np.concatenate([np.abs(correlation), 1.5 * bound, [1e-3]]))
    panels[0, 0].set_ylim(-reach, reach)  # lags that are not tested may leave the frame
    for state, row in zip(states, panels):
        for other, panel in zip(others, row):
            part = table[(table["state"] == state) & (table["against"] == other)]
            lag, bound = np.asarray(part["lag"]), np.asarray(part["bound"])
            panel.fill_between(lag, -bound, bound, color="0.88", linewidth=0, zorder=0)
            for tested, colour in ((False, "0.6"), (True, MODEL["color"])):
                some = part[part["tested"] == tested]
                panel.vlines(some["lag"], 0, some["correlation"], color=colour, linewidth=0.9, linestyle="-")
                out = some[np.abs(some["correlation"]) > some["bound"]]
                filled = {"color": colour, "linestyle": "none", "marker": "o", "markersize": 2.2}
                panel.plot(out["lag"], out["correlation"], **filled)
            panel.axhline(0, color="black", linewidth=0.5, linestyle="-")
            if state == states[0]:
                title = "with itself" if other == "itself" else f"with {plain(short(str(other), _NAME))}"
                panel.set_title(title, fontsize=8, pad=3)
        row[0].set_ylabel(plain(short(str(state), _NAME)))
    figure.supxlabel(f"lag (samples); band: {100 * (1 - significance):g} % of one lag\ndots: outside; grey: not tested")
    return figure


def spectrum_figure(model: "KoopmanModel", ax=None) -> Figure:
    """See `tras.KoopmanModel.plot_spectrum`."""
    values = model.eigenvalues
    return eigenvalue_figure(pd.DataFrame({"model": "model", "real": np.real(values), "imag": np.imag(values)}), ax)


def frame_of(true: np.ndarray, *curves: np.ndarray) -> tuple[float, float]:
    """Limits that show the truth whole, and other curves up to three quarters of its range above and below it."""
    low, high = float(np.min(true)), float(np.max(true))
    reach = 0.75 * (high - low) or abs(high) or 1.0
    values = np.concatenate([[low, high], *(curve[np.isfinite(curve)] for curve in curves)])
    values = values.clip(low - reach, high + reach)
    margin = 0.04 * (np.ptp(values) or 1.0)
    return float(values.min() - margin), float(values.max() + margin)


def draw_in_frame(panel: Axes, time: np.ndarray, values: np.ndarray, frame: tuple[float, float], **style):
    """Draw a curve up to the frame's edge; where it first leaves, and goes on unseen, a triangle stands at the edge.

    A curve that ends in NaN has run away, in the direction of its last step. Returns the line.
    """
    low, high = frame
    far = high - low
    values = np.array(values, dtype=float)
    seen = np.isfinite(values)
    for k in np.flatnonzero(seen[:-1] & np.isnan(values[1:])):
        up = values[k] >= (values[k - 1] if k and seen[k - 1] else (low + high) / 2)
        values[k + 1] = np.inf if up else -np.inf
    values = np.clip(values, low - far, high + far)
    (line,) = panel.plot(time, values, **style)
    panel.set_ylim(low, high)
    outside = np.flatnonzero((values < low) | (values > high))
    if len(outside):
        k = outside[0]
        edge, mark = (high, "^") if values[k] > high else (low, "v")
        at = time[k]
        if k and seen[k - 1]:
            at = time[k - 1] + (time[k] - time[k - 1]) * (edge - values[k - 1]) / (values[k] - values[k - 1])
        look = {"color": line.get_color(), "markersize": 4, "linestyle": "none", "clip_on": False, "zorder": 5}
        panel.plot([at], [edge], marker=mark, label="_leaves", **look)
    return line


def _panels(ax, count, **size):
    """Axes of a new figure, one below the other, or those of the caller, if they are ``count``."""
    if ax is None:
        _, axes = new_figure(formulas=False, rows=count, squeeze=False, **size)
        return list(axes[:, 0])
    panels = list(np.asarray(ax, dtype=object).ravel())
    if len(panels) != count or not all(isinstance(panel, Axes) for panel in panels):
        raise ValueError(f"ax is {_kind(panels)}; give {count} matplotlib Axes, one per panel, or leave it out.")
    return panels


def _kind(panels):
    kinds = {type(panel).__name__ for panel in panels}
    return f"{len(panels)} of {', '.join(sorted(kinds))}" if panels else "empty"


def _chosen(argument, names, known):
    """``names`` as a list, if all of them are known and they are not too many."""
    names = list(names) if not isinstance(names, str) else [names]
    for name in names:
        if name not in known:
            raise ValueError(f"{argument}: there is no {name!r}; there are {', '.join(known) or 'none'}.")
    if not 1 <= len(names) <= MOST:
        raise ValueError(f"{argument} has {len(names)} names; give 1 to {MOST}.")
    return names


def _check_models(recording, models, names, trajectory):
    """A ValueError unless all of them are fitted models, with as many names, and there is such a trajectory."""
    if not 1 <= len(models) <= len(_MODELS):
        raise ValueError(f"there are {len(models)} models; give 1 to {len(_MODELS)}.")
    for model in models:
        if not hasattr(model, "require_fitted"):
            raise ValueError(f"models holds a {type(model).__name__}; give fitted models such as tras.KoopmanModel.")
        model.require_fitted()
    if names is not None and (isinstance(names, str) or len(names) != len(models)):
        raise ValueError(f"names is {names!r}; give a list of {len(models)}, one per model.")
    if (
        isinstance(trajectory, bool)
        or not isinstance(trajectory, (int, np.integer))
        or trajectory not in range(-len(recording), len(recording))
    ):
        raise ValueError(f"trajectory is {trajectory!r}; give a whole number from 0 to {len(recording) - 1}.")


def _judged(model, recording, latest):
    """Roll-outs from the sample ``latest`` on, a list of (samples_i - latest, n), and their scores."""
    selected, start = recording.select(states=model.state_names_, inputs=model.input_names_), latest - model.delays
    if recording.lengths.min() < latest + 2:
        short = "the trajectory" if len(recording) == 1 else "the shortest trajectory"
        raise ValueError(f"{short} has {recording.lengths.min()} samples; {latest} delays need {latest + 2} or more.")
    states, inputs = (list(part) for part in zip(*selected))
    # All models begin to predict at the same sample.
    later = selected.with_data([x[start:] for x in states], [u[start:] for u in inputs])
    runs = [np.asarray(run)[model.delays :] for run in model.predict(later)]
    with np.errstate(all="ignore"):
        return runs, metrics.judge([x[latest:] for x in states], runs)


def _fits(model, run, shown):
    """State -> (its roll-out, the fit in words), for the one trajectory of ``shown``."""
    true = shown.select(states=model.state_names_).states[0][-len(run) :]
    with np.errstate(all="ignore"):
        scores = metrics.judge(true[None], run[None])
    lost = "diverged" if scores.diverged else "no fit: constant"
    fits = [f"{fit:.3g} %" if np.isfinite(fit) else lost for fit in scores.bfr]
    return {name: (run[:, i], fit) for i, (name, fit) in enumerate(zip(model.state_names_, fits))}


def _names(models):
    """What to call models: by their dictionaries, with options where needed, with a number where those are alike."""
    dictionaries = [getattr(model, "dictionary", None) for model in models]
    kinds = [type(model if d is None else d).__name__ for model, d in zip(models, dictionaries)]
    full = [name if d is None else label(d) for name, d in zip(kinds, dictionaries)]
    names = []
    for i, (name, words) in enumerate(zip(kinds, full)):
        if kinds.count(name) > 1:
            name = words if full.count(words) == 1 and len(words) <= _NAME else f"{name} [{i + 1}]"
        names.append(name)
    return names


def _grid(entries):
    """Rows and columns of a legend, which fills them column by column, as wide as a panel at most."""
    size = rcParams["legend.fontsize"]
    widths = [0.46 + TextPath((0, 0), entry, size=size).get_extents().width / 72 for entry in entries]  # inches
    for columns in range(len(entries), 0, -1):
        rows = -(-len(entries) // columns)
        if sum(max(widths[k : k + rows]) for k in range(0, len(entries), rows)) <= 3.0:
            break
    return rows, columns
