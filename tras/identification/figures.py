"""Figures of an identification, for any channels: each takes a table and returns a `Figure`."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tras.display.plots import MOST, draw_in_frame, frame_of, with_units
from tras.identification.scores import CONSTANT, HELD
from tras.plotting import LINEAR, MODEL, TRUTH, new_figure, plain, plain_decades, require, styled
from tras.workflow.arguments import short

BAND = "90 % of a bootstrap"
SHOWN = 2  # outputs and inputs of a response, side by side, at most
_NAME = 12  # letters of a name in one of two columns
_SIMULATED = {"color": "#009E73", "linestyle": "-.", "linewidth": 1.0}
_MEASURED = {"color": "black", "linestyle": "none", "marker": "o", "markersize": 2.0}
_DOUBTED = {"color": "0.6", "linestyle": "none", "marker": "o", "markersize": 1.8, "markerfacecolor": "none"}
_BAND = {"color": "#0072B2", "alpha": 0.25, "linewidth": 0}
_POINTS = 1500  # of a curve, about


@styled()
def spectra_figure(table: pd.DataFrame, states: list[str], inputs: list[str]) -> Figure:
    """Where in frequency inputs and states move: share of variance per Hz.

    The table has ``frequency`` (Hz) and one column per channel.
    """
    require(table, "table", ["frequency", *states, *inputs])
    groups = [(title, names) for title, names in (("inputs", inputs[:MOST]), ("states", states[:MOST])) if names]
    figure, axes = new_figure(formulas=False, height=1.35 * len(groups) + 0.4, rows=len(groups), squeeze=False)
    for panel, (title, names) in zip(axes[:, 0], groups):
        for name in names:
            panel.loglog(table["frequency"], np.maximum(table[name], 1e-12), label=plain(name), linewidth=0.9)
        top = table[names].to_numpy().max()
        panel.set_ylim(max(1e-8 * top, 1e-12), 3 * top)
        panel.set_title(title, fontsize=8, pad=2)
        plain_decades(panel.xaxis)
        plain_decades(panel.yaxis)
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
    figure, axes = new_figure(formulas=False, **size, sharey="row", sharex="col", squeeze=False)
    for row, state, label in zip(axes, states, with_units(states, units)):
        whole = [table[f"{state}: {kind}"].to_numpy() for kind in kinds]
        frame = frame_of(*whole)
        for panel, name in zip(row, windows):
            some = (table["window"] == name).to_numpy()
            time, (true, model, linear, low, high) = table["time"].to_numpy()[some], [each[some] for each in whole]
            if np.isfinite(low).any():
                reach = np.clip([low, high], *frame)  # at the edge a band that goes on looks the same
                panel.fill_between(time, *reach, **_BAND, label=BAND)
            panel.plot(time, true, **TRUTH, label="measured", zorder=3)
            draw_in_frame(panel, time, model, frame, **MODEL, label="model")
            draw_in_frame(panel, time, linear, frame, **LINEAR, label="linear model")
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
    figure, panel = new_figure(formulas=False, height=2.3)
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
    plain_decades(panel.yaxis)
    figure.legend(loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def step_figure(table: pd.DataFrame, states: dict[str, str], inputs: dict[str, str]) -> Figure:
    """Responses to a step of one unit of each input: a row per state, a column per input, with the bootstrap's band.

    The table has ``time`` (s), ``input, state, response, lower, upper``; ``states`` and ``inputs`` map names to units.
    """
    require(table, "table", ["time", "input", "state", "response", "lower", "upper"])
    size = {"height": 0.85 * len(states) + 0.75, "rows": len(states), "columns": len(inputs)}
    figure, axes = new_figure(formulas=False, **size, sharey="row", sharex="col", squeeze=False)
    rows = {name: table[table["state"] == name] for name in states}
    for row, (state, part) in zip(axes, rows.items()):
        part = part[part["input"].isin(list(inputs))]
        values = [part[name].to_numpy() for name in ("response", "lower", "upper")]
        whole = values[0][np.isfinite(values[0])]
        frame = frame_of(np.append(whole, 0.0), *values[1:])
        for panel, name in zip(row, inputs):
            each = part[part["input"] == name]
            time, (response, low, high) = (
                each["time"].to_numpy(),
                (each[k].to_numpy() for k in ("response", "lower", "upper")),
            )
            if not np.isnan(low).all():
                panel.fill_between(time, *np.clip([low, high], *frame), **_BAND, label=BAND)
            panel.axhline(0, color="0.6", linewidth=0.4, linestyle="-")
            draw_in_frame(panel, time, response, frame, **MODEL, label="linearised model")
        row[0].set_ylabel(_labels({state: states[state]})[0])
    for panel, title in zip(axes[0], _labels(inputs)):
        panel.set_title(f"step of one in {title}", fontsize=8, pad=3)
    for panel in axes[-1]:
        panel.set_xlabel("time (s)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure


@styled()
def bode_figure(table: pd.DataFrame, states: dict[str, str], source: tuple[str, str]) -> Figure:
    """Bode plot from one input: a column per state; gain, phase and coherence below each other.

    The table is that of `tras.identification.diagnosis.of_responses`; ``states`` maps names to units, ``source`` is the
    input's name and unit. Points of the recording that cannot be trusted are small and hollow.
    """
    require(table, "table", ["kind", "input", "state", "frequency", "gain", "phase", "lower", "upper"])
    table = table[(table["input"] == source[0]) & table["state"].isin(list(states))]
    measured = (table["kind"] == "recording").any()
    rows = 3 if measured else 2
    figure, axes = new_figure(
        0.5 + 1.0 * rows, rows, len(states), formulas=False, squeeze=False, height_ratios=[3, 3, 2][:rows]
    )
    for column, state, title in zip(axes.T, states, _labels(states)):
        parts = dict(list(table[table["state"] == state].groupby("kind")))
        _bode_column(column, parts)
        column[0].set_title(title, fontsize=8, pad=3)
        column[-1].set_xlabel("frequency (Hz)")
    axes[0, 0].set_ylabel(f"gain per {_labels(dict([source]))[0]}")
    axes[1, 0].set_ylabel("phase (degrees)")
    if measured:
        axes[2, 0].set_ylabel("coherence")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, columnspacing=1.2)
    return figure


def _bode_column(column, parts):
    model = parts["linearised"]
    frequency, gain, phase = (model[name].to_numpy() for name in ("frequency", "gain", "phase"))
    others = [part for kind, part in parts.items() if kind != "linearised"]
    known = [part[part["trusted"].astype(bool)] for part in others]
    for panel, name, band in zip(column, ("gain", "phase"), (("lower", "upper"), ("phase_lower", "phase_upper"))):
        low, high = (model[each].to_numpy() for each in band)
        seen = [part[name].to_numpy() for part in known]
        main = np.concatenate([model[name].to_numpy(), *seen])
        main = main[np.isfinite(main) & (main > 0)] if name == "gain" else main[np.isfinite(main)]
        if not len(main):
            main = np.ones(1)
        if name == "gain":
            # What a model says a hundred times below all that is known of the rig matters to nobody.
            least = min((each.min() for each in seen if len(each)), default=main.max()) / 100
            frame = (max(main.min(), least) / 2, main.max() * 2)
            panel.set_xscale("log")
            panel.set_yscale("log")
            plain_decades(panel.yaxis)
        else:
            frame = (main.min() - 30, main.max() + 30)
            panel.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 1.5, 3, 4.5, 9, 10]))
        if not np.isnan(low).all():
            panel.fill_between(frequency, *np.clip([low, high], *frame), **_BAND, label=BAND)
        panel.plot(frequency, gain if name == "gain" else phase, **MODEL, label="linearised model")
        if "simulated" in parts:
            part = parts["simulated"]
            part = part[part["trusted"].astype(bool)]
            panel.plot(part["frequency"], part[name], **_SIMULATED, label="model simulated")
        if "recording" in parts:
            _points(panel, parts["recording"], name)
        panel.set_ylim(*frame)
    if "recording" in parts:
        _points(column[2], parts["recording"], "coherence")
        column[2].set_ylim(0, 1.05)
    plain_decades(column[-1].xaxis)


def _points(panel, part, name):
    trusted = part["trusted"].astype(bool)
    panel.plot(part["frequency"][trusted], part[name][trusted], **_MEASURED, label="recording")
    panel.plot(part["frequency"][~trusted], part[name][~trusted], **_DOUBTED, label="recording, not to be trusted")


def _labels(units):
    """Names with their units, short enough for one of two columns."""
    return with_units([short(name, _NAME) for name in units], [short(unit, _NAME) for unit in units.values()])
