"""The page of a designed controller: one file of HTML that needs no network."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tras.control.design import Design
from tras.control.margins import Margins, gain_and_phase
from tras.display.plots import MOST, with_units
from tras.plotting import MODEL, TRUTH, new_figure, plain, require, styled
from tras.workflow import page

_FEW = 0.02  # half-ranges: an error that counts as none
_CAUTION = (
    "A loop of a controller with its own model is a prediction and proves nothing about the system: what the model "
    "misses, the loop below does not show. Begin on the rig with small steps and narrow limits."
)


@styled()
def run_figure(table: pd.DataFrame, states: list[str], inputs: list[str], labels: list[str], limits, ends) -> Figure:
    """States with their references, and inputs with their limits, over the predicted run.

    Parameters
    ----------
    table
        ``time`` (s), every state and input, ``STATE: reference`` of those that follow one.
    states, inputs
        That are shown, one panel each.
    labels
        Of all panels.
    limits : dict of str to (float, float)
        Channel -> lowest and highest.
    ends : sequence of float
        Times at which a part of the run ends.
    """
    require(table, "table", ["time", *states, *inputs])
    names = [*states, *inputs]
    figure, axes = new_figure(height=0.75 * len(names) + 0.5, rows=len(names), squeeze=False)
    for panel, name, label in zip(axes[:, 0], names, labels):
        if f"{name}: reference" in table:
            panel.step(table["time"], table[f"{name}: reference"], where="post", **TRUTH, label="reference")
        draw = panel.step if name in inputs else panel.plot
        draw(table["time"], table[name], **MODEL, **({"where": "post"} if name in inputs else {}), label="predicted")
        bottom, top = panel.get_ylim()
        for limit in limits.get(name, ()):
            panel.axhline(limit, color="0.5", linewidth=0.8, linestyle="--")
        for end in ends:
            panel.axvline(end, color="0.85", linewidth=0.8, zorder=0)
        near = [limit for limit in limits.get(name, ()) if bottom - (top - bottom) < limit < top + (top - bottom)]
        panel.set_ylim(min([bottom, *near]), max([top, *near]))
        panel.set_ylabel(label)
    axes[-1, 0].set_xlabel("time (s)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def draw_run(design: Design) -> tuple[Figure, pd.DataFrame]:
    """The figure of the predicted run, of six channels at most, and its table."""
    c, controller = design.controller.channels, design.controller
    order = sorted(c.state_names, key=lambda name: name not in controller.followed)
    states = order[: max(MOST // 2, MOST - len(c.input_names))]
    inputs = list(c.input_names)[: MOST - len(states)]
    units = dict(zip((*c.state_names, *c.input_names), (*c.state_units, *c.input_units)))
    labels = with_units([*states, *inputs], [units[name] for name in (*states, *inputs)])
    limits = {row["channel"]: [v for v in (row["limit from"], row["limit to"]) if np.isfinite(v)]
              for _, row in design.outside.iterrows()}  # fmt: skip
    ends = [end * c.dt for _, _, end in design.parts[:-1]]
    return run_figure(design.run, states, inputs, labels, limits, ends), design.run


def write_page(design: Design, name: str, picture, files: list[tuple[str, str]], settings: str, failure: str) -> str:
    """The page as text.

    Parameters
    ----------
    design
    name
        Of the model.
    picture : Path
        The figure of the run.
    files
        Files of the folder, and what they are.
    settings
        All settings as YAML.
    failure
        Why there is no C, or "".
    """
    contents, parts = [], []
    convert = page.converter(lambda kind, spec: "", contents)

    def put(heading, *html):
        parts.extend([convert(heading), *html])

    def text(sentence):
        return f"<p>{page.escape(sentence)}</p>\n"

    caption = (
        "The predicted run: the controller with its own model, without preview. Grey lines: a new reference, or the "
        "disturbance, begins. Dashed: limits."
    )
    figure = page.figure(picture, "References, states and inputs over time", page.escape(caption), "run")
    put(f"# Control of {_plain(name)}")
    put("## In short", text(_short(design)), _list(warnings(design)), text(_CAUTION), figure, _errors(design))
    put("## Margins", text(_margins_text()), _margins(design))
    put("## Where the model was excited", text(_excited_text(design)), _outside(design))
    put("## Files", _files(files), _list([failure] if failure else []), _use(design))
    put("## Settings", text("All of them, in settings.yaml: edit a copy and hand it in."), _pre(settings))
    return page.frame(f"Control of {name}", "".join(parts), contents)


def warnings(design: Design) -> list[str]:
    """What to mind, one sentence each; also for the command line."""
    sentences, controller = [], design.controller
    beyond = design.outside[design.outside["beyond"] > 0]
    if design.beyond_hull > 0:
        sentences.append(
            f"In {_percent(design.beyond_hull)} of the samples the run is where the model was never excited, and the "
            "prediction there is extrapolation; identify from a recording that goes there, or stay inside."
        )
    if len(beyond):
        channels = ", ".join(f"{row['channel']} ({_percent(row['beyond'])})" for _, row in beyond.iterrows())
        sentences.append(f"Beyond the range of the data, share of the samples: {channels}.")
    wide = [row["channel"] for _, row in design.outside.iterrows() if _is_wide(row)]
    if wide:
        sentences.append(f"The limits of {', '.join(wide)} lie beyond the range of the data.")
    failures = int((~design.run["solved"]).sum())
    if failures:
        sentences.append(f"In {failures} samples the program was not solved, and the last plan went on.")
    if controller.observer is not None and controller.observer.restarts:
        sentences.append(f"The observer began anew {controller.observer.restarts} times: the model ran away from it.")
    for (what, _, _), result in zip(design.parts, design.margins):
        if isinstance(result, str):
            sentences.append(f"No margins at the end of {what}: {result}.")
        elif result.radius >= 1:
            sentences.append(f"The linearised loop is unstable at the end of {what} (radius {result.radius:.3f}).")
        elif result.disk_of_all < 0.4:
            low, high, phase = gain_and_phase(result.disk_of_all)
            sentences.append(
                f"Small margins at the end of {what}: gains from {low:.2f} to {high:.2f}, {phase:.0f} degrees of phase."
            )
    for name in controller.followed:
        if _last_error(design, name) > _FEW * _half_range(design, name):
            sentences.append(f"{name} does not reach its reference by the end of the run.")
    return sentences


def _short(design):
    controller = design.controller
    kind = type(controller).__name__
    what = "Model predictive control" if kind == "MPC" else "A linear quadratic regulator"
    ahead = f" over {controller.horizon} samples" if kind == "MPC" else ""
    observer = controller.observer
    estimate = f"; a Kalman filter estimates from {', '.join(observer.measured)}" if observer else ""
    rest = "disturbances are estimated, so that no error stays" if observer else "disturbances are not estimated"
    followed = " and ".join([", ".join(controller.followed[:-1]), controller.followed[-1]]).removeprefix(" and ")
    verb = "follows its reference" if len(controller.followed) == 1 else "follow their references"
    return f"{what}{ahead}: {followed} {verb}{estimate}; {rest}."


def _errors(design):
    rows = []
    units = dict(zip(design.outside["channel"], design.outside["unit"]))
    for what, start, end in design.parts:
        for name in design.controller.followed:
            part = design.run.iloc[start:end]
            error = (part[f"{name}: reference"] - part[name]).to_numpy()
            label = page.escape(f"{name} ({units[name]})" if units[name] else name)
            near = np.flatnonzero(np.abs(error) > _FEW * _half_range(design, name))
            dt = design.controller.channels.dt
            settled = f"{(near[-1] + 1) * dt if len(near) else 0.0:.3g}"
            settled = "–" if len(near) and near[-1] == len(error) - 1 else settled
            rms, last = (f"{value:.3g}" for value in (np.sqrt(np.mean(error**2)), abs(error[-1])))
            rows.append([page.escape(what), label, rms, last, settled])
    head = ["part", "state", "RMS error", "error at its end", "settled after (s)"]
    caption = "Errors of the predicted run. Settled: within 2 % of the data's half-range from then on."
    return page.table(head, rows, caption, keys=2)


def _margins_text():
    return (
        "Of the loop linearised where it rests at the end of each part, observer included, at the inputs: every factor "
        "between the two gains, or that lag of phase, leaves it stable (disk margins; Seiler, Packard, Gahinet 2020). "
        "All at once: every input may change in its own way. Delay: samples of further dead time in all inputs that it "
        "bears."
    )


def _margins(design):
    rows = []
    inputs = design.controller.channels.input_names
    for (what, _, _), result in zip(design.parts, design.margins):
        if not isinstance(result, Margins):
            rows.append([page.escape(what), page.escape(result), "–", "–", "–", "–", "–"])
            continue
        disks = [*zip(inputs, result.disk), *([("all at once", result.disk_of_all)] if len(inputs) > 1 else [])]
        for label, disk in disks:
            low, high, phase = gain_and_phase(float(disk))
            numbers = [f"{low:.2f}", f"{high:.2f}" if np.isfinite(high) else "∞", f"{phase:.0f}"]
            is_stable = result.radius < 1
            delay = f"{result.delay}" if result.delay < 50 else "50 or more"
            numbers = [*numbers, delay] if is_stable else ["unstable", "–", "–", "–"]
            rows.append([page.escape(what), page.escape(label), *numbers, f"{result.radius:.4f}"])
    head = ["part", "input", "gain from", "gain to", "phase (degrees)", "delay (samples)", "spectral radius"]
    return page.table(head, rows, "Margins of the linearised loop.", keys=2)


def _excited_text(design):
    share = design.beyond_hull
    return (
        f"{_percent(share) if share else 'No'} samples of the run lie beyond the box around the training data, where a "
        "model is extended by guess. A controller that goes there relies on what nobody measured."
    ).replace("No samples of the run lie", "No sample of the run lies")


def _outside(design):
    rows = []
    for _, row in design.outside.iterrows():
        label = f"{row['channel']} ({row['unit']})" if row["unit"] else row["channel"]
        pairs = [(row["data from"], row["to"]), (row["run from"], row["run to"]), (row["limit from"], row["limit to"])]
        cells = [" to ".join(f"{v:.4g}" for v in pair) if np.isfinite(pair).any() else "–" for pair in pairs]
        rows.append([page.escape(label), *cells, _percent(row["beyond"])])
    head = ["channel", "data", "run", "limits", "samples beyond the data"]
    return page.table(head, rows, "Ranges of the data that the model was fitted to, of the run, and limits.")


def _files(files):
    rows = [[f'<a href="{page.escape(file)}">{page.escape(file)}</a>', page.escape(what)] for file, what in files]
    return page.table(["file", "what"], rows, "What this folder holds.", kind="short")


def _use(design):
    code = [
        "import tras, yaml",
        "from tras.control.design import design",
        'model = tras.load_model("model.npz")',
        'controller = design(model, yaml.safe_load(open("settings.yaml"))).controller',
        "controller.reset()",
        f"u = controller(x, reference)  # once per sample, {design.controller.channels.dt!r} s",
    ]
    return _pre("\n".join(code))


def _pre(text):
    return f"<pre>{page.escape(text)}</pre>\n"


def _list(sentences):
    items = "".join(f"<li>{page.escape(sentence)}</li>\n" for sentence in sentences)
    return f"<ul>\n{items}</ul>\n" if items else ""


def _is_wide(row):
    low, high = row["data from"], row["to"]
    room = 1e-9 * (high - low)
    return any(
        np.isfinite(limit) and not low - room <= limit <= high + room for limit in row[["limit from", "limit to"]]
    )


def _half_range(design, name):
    row = design.outside[design.outside["channel"] == name].iloc[0]
    return (row["to"] - row["data from"]) / 2


def _last_error(design, name):
    last = design.run.iloc[-1]
    return abs(last[f"{name}: reference"] - last[name])


def _percent(share):
    return f"{100 * share:.2g} %"


def _plain(name):
    """A model's name on one line, escaped for Markdown."""
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]<>()#+-.!|$" else letter for letter in plain(name))
