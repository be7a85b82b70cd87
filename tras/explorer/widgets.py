"""The explorer in Jupyter: a control for every field of a `Choice`, and its outcome, from `tras.explorer.explore`.

A slider acts on release, a menu at once. A choice that gives no model greys out the last picture and says why.
"""

import time

import ipywidgets
from IPython.display import Javascript, display

from tras.explorer.choice import EXAMPLES, OPTIONS, SIZES, Choice, ChoiceError, write_parameters
from tras.explorer.explore import explore, numbers
from tras.explorer.figures import outcome_figure
from tras.explorer.further import FURTHER
from tras.plotting import png
from tras.workflow import page

_LABELS = {
    "frequency_unit": "frequencies in", "sampling_time": "sampling (s)", "duration": "duration (s)",
    "noise": "noise (%)", "horizon": "horizon (s)", "nrmse_range": "range in (21)", "extrapolation": "beyond data",
    "regularization": "regularize", "field": "F from",
}  # fmt: skip
_WORDS = {
    "least_squares": "equation (18)", "coordinates": "columns of A", "four_states": "all four",
    "delayed_angles": "two angles", "vector_field": "vector field", "one_step": "one step",
    "lifted_linear": "lifted linear", "validation_set": "whole recording", "trajectory": "each window",
    "functions": "trust functions",
}  # fmt: skip
_GROUPS = {
    "Experiment": ("input", "frequency_unit", "duration", "sampling_time", "noise", "seed"),
    "Model": "dictionary size width state delays predictor field regularization strength extrapolation".split(),
    "Judged over": ("horizon", "nrmse_range"),
}
_SAMPLING_TIMES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
# field -> kind of slider, lowest, highest (exponents for a log slider), steps and digits
_SLIDERS = {
    "duration": (ipywidgets.FloatSlider, 20, 1000, {"step": 20, "readout_format": ".0f"}),
    "noise": (ipywidgets.FloatSlider, 0, 10, {"step": 0.1, "readout_format": ".1f"}),
    "size": (ipywidgets.IntSlider, 1, 200, {}),
    "width": (ipywidgets.FloatLogSlider, -1, 1, {"step": 0.1, "readout_format": ".2f"}),
    "delays": (ipywidgets.IntSlider, 0, 10, {}),
    "strength": (ipywidgets.FloatLogSlider, -6, 0, {"step": 0.5, "readout_format": ".0e"}),
    "horizon": (ipywidgets.FloatSlider, 1, 60, {"step": 1, "readout_format": ".0f"}),
}
_STYLE = {"description_width": "92px"}
_WIDE = {"width": "300px"}
STALE = "tras-stale"  # class of what belongs to an earlier choice
_STYLE_SHEET = f"<style>.{STALE} {{ opacity: 0.35; filter: grayscale(1) }}</style>"


class Explorer:
    """The panel of the explorer; as the last line of a cell it shows itself and comes into view.

    Parameters
    ----------
    choice : Choice, optional
        The first choice; the paper's by default.
    folder : str or Path, optional
        Folder for parameter files; ``params/`` of the project by default.

    Attributes
    ----------
    controls : dict of str to ipywidgets.Widget
        One per field of `Choice`.
    outcome : tras.explorer.explore.Outcome
        Outcome of the last choice that gave a model.
    view : ipywidgets.Widget
    """

    def __init__(self, choice=None, folder=None):
        choice = choice or Choice()
        self.folder, self.outcome, self._quiet = folder, None, False
        self.controls = {name: _control(name, value) for name, value in choice.as_dict().items()}
        self.picture = ipywidgets.Image(format="png", layout={"width": "100%"})
        self.table, self.message, self.answer = ipywidgets.HTML(), ipywidgets.HTML(), ipywidgets.HTML()
        self.example = ipywidgets.Dropdown(options=[("an example ...", None), *EXAMPLES.items()], layout=_WIDE)
        self.name = ipywidgets.Text("mine", description="name", style=_STYLE, layout=_WIDE)
        self.button = ipywidgets.Button(layout=_WIDE)
        self.further = {label: ipywidgets.Button(description=label) for label in FURTHER}
        more = ipywidgets.HBox(list(self.further.values()), layout={"flex_flow": "row wrap"})
        self.extra = ipywidgets.VBox()
        self.result = ipywidgets.VBox([self.picture, self.table, more, self.extra])
        for control in self.controls.values():
            control.observe(self._changed, names="value")
        self.example.observe(self._take_example, names="value")
        self.name.observe(self._name_button, names="value")
        self.button.on_click(self._write)
        for button in self.further.values():
            button.on_click(self._show_further)
        self.view = self._arranged()
        self._fit_size()
        self._name_button()
        self.redraw()

    def _ipython_display_(self):
        # *Run All* leaves the page where the code of the last cell is, with the panel out of sight below it.
        into_view = "setTimeout(() => element.closest('.jp-OutputArea, body').scrollIntoView(), 300)"
        display(self.view, Javascript(into_view))

    @property
    def choice(self) -> Choice:
        """The `Choice` that the controls hold; raises a `ChoiceError` if they are wrong."""
        return Choice(**{name: control.value for name, control in self.controls.items()})

    def set(self, choice: Choice) -> None:
        """Put a choice into the controls and show its outcome."""
        self._quiet = True
        try:
            times = self.controls["sampling_time"]
            times.options = sorted({*times.options, choice.sampling_time})
            self.controls["dictionary"].value = choice.dictionary
            self._fit_size()
            for name, value in choice.as_dict().items():
                self.controls[name].value = value
        finally:
            self._quiet = False
        self.redraw()

    def redraw(self) -> None:
        """Fit, predict, judge and show; or say why there is nothing to show."""
        start = time.perf_counter()
        self._enable()
        try:
            outcome = explore(self.choice)
        except ChoiceError as error:
            stale = "The grey picture and numbers are those of the last choice that gave a model."
            self.message.value = _note(f"{error} {stale}", "#b00020")
            self._mark_stale(True)
            return
        self.picture.value = png(outcome_figure(outcome.overlay, outcome.growth, outcome.spectrum))
        self.table.value = numbers(outcome).to_html(border=0)
        self.extra.children = ()  # of another choice
        self._mark_stale(False)
        self.outcome, seconds = outcome, time.perf_counter() - start
        size = f"N = {len(outcome.model.names_)} functions, {outcome.model.pairs_} snapshot pairs"
        facts = f"{size}; fitted, judged and drawn in {seconds:.2f} s."
        self.message.value = _note(" ".join([facts, *outcome.remarks]))

    def _changed(self, change):
        if self._quiet:
            return
        if change["owner"] is self.controls["dictionary"]:
            self._quiet = True
            self._fit_size(usual=True)
            self._quiet = False
        self.redraw()

    def _take_example(self, change):
        if change["new"] is not None:
            self.set(change["new"])

    def _fit_size(self, usual=False):
        """Give the size the range of the dictionary."""
        low, high, common, meaning = SIZES[self.controls["dictionary"].value]
        size = self.controls["size"]
        value = common if usual else min(max(size.value, low), high)
        # The value stays inside the range at every moment: a correction by the browser would come back as a choice.
        for name, new in (("value", value), ("max", high)) if value <= size.max else (("max", high), ("value", value)):
            setattr(size, name, new)
        size.tooltip = meaning

    def _enable(self):
        """Grey the controls that have no effect on the present choice."""
        values = {name: control.value for name, control in self.controls.items()}
        nonlinear = values["dictionary"] != "linear"
        effective = {
            "size": nonlinear, "width": values["dictionary"] == "gaussian",
            "field": values["predictor"] == "vector_field", "strength": values["regularization"] != "none",
            "extrapolation": nonlinear and values["predictor"] != "lifted_linear",
        }  # fmt: skip
        for name, enabled in effective.items():
            self.controls[name].disabled = not enabled

    def _mark_stale(self, stale):
        (self.result.add_class if stale else self.result.remove_class)(STALE)
        for button in self.further.values():
            button.disabled = stale

    def _show_further(self, button):
        self.extra.children = [ipywidgets.HTML(_note("A few seconds ..."))]
        try:
            self.extra.children = [FURTHER[button.description](self.outcome)]
        except ValueError as error:
            self.extra.children = [ipywidgets.HTML(_note(str(error), "#b00020"))]

    def _name_button(self, _=None):
        self.button.description = f"save as params/{self.name.value}.yaml"

    def _write(self, _):
        try:
            path = write_parameters(self.choice, self.name.value, self.folder)
            self.answer.value = _note(f"{path.name} is written: make all PROFILE={path.stem}")
        except (ValueError, OSError) as error:
            self.answer.value = _note(str(error), "#b00020")

    def _arranged(self):
        column = [self.example]
        for title, names in _GROUPS.items():
            column += [ipywidgets.HTML(f"<b>{title}</b>"), *(self.controls[name] for name in names)]
        column += [ipywidgets.HTML("<b>Keep it</b>"), self.name, self.button, self.answer]
        left = ipywidgets.VBox(column, layout={"flex": "0 0 310px"})
        wide = {"flex": "1 1 420px", "min_width": "0"}
        right = ipywidgets.VBox([ipywidgets.HTML(_STYLE_SHEET), self.message, self.result], layout=wide)
        return ipywidgets.HBox([left, right])


def _control(name, value):
    """The widget of one field with its value."""
    look = {"description": _LABELS.get(name, name.replace("_", " ")), "style": _STYLE, "layout": _WIDE}
    late = look | {"continuous_update": False}
    if name in OPTIONS:
        meanings = "; ".join(f"{choice}: {meaning}" for choice, meaning in OPTIONS[name].items())
        options = [(_WORDS.get(choice, choice), choice) for choice in OPTIONS[name]]
        return ipywidgets.Dropdown(options=options, value=value, tooltip=meanings, **look)
    if name == "sampling_time":
        return ipywidgets.SelectionSlider(options=sorted({*_SAMPLING_TIMES, value}), value=value, **late)
    if name == "seed":
        return ipywidgets.BoundedIntText(value, min=1, max=10_000, **look)
    kind, low, high, steps = _SLIDERS[name]
    return kind(value, min=low, max=high, **steps, **late)


def _note(text, colour="#404040"):
    return f'<div role="status" style="color:{colour}; line-height:1.35; white-space:normal">{page.escape(text)}</div>'
