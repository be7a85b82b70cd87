"""What the panel shows on demand, because it takes seconds: the rig in motion, the vector field, eigenfunctions, words.

Each function takes an `Outcome` and returns a widget. `FURTHER` lists them by the labels of their buttons.
"""

import ipywidgets

from tras.dictionaries.monomials import Monomials
from tras.explorer import portraits
from tras.explorer.explore import Outcome
from tras.explorer.figures import portrait_figure
from tras.model import KoopmanModel
from tras.paper import operators
from tras.paper.figures import animation
from tras.paper.figures.robustness import eigenfunctions_figure
from tras.plotting import png
from tras.workflow import page

RATE = 8.0  # frames per second of the film
REACH = [0.6, 0.9, 1.2, 0.9]  # half-widths of the free swings at their release: rad, rad/s, rad, rad/s


def rig_in_motion(outcome: Outcome) -> ipywidgets.Widget:
    """The panel's window as a film: the truth solid, the model as a ghost."""
    frames = animation.film(outcome.overlay, rate=RATE)
    return ipywidgets.Image(value=animation.gif_bytes(frames, rate=RATE), format="gif", layout={"width": "440px"})


def vector_fields(outcome: Outcome) -> ipywidgets.Widget:
    """The true field and the identified ones."""
    return _picture(portrait_figure(portraits.portrait(portraits.compared(outcome))))


def eigenfunctions(_: Outcome) -> ipywidgets.Widget:
    """Of free swings of the rig, whatever the choice; above it the rates of the linearised plant."""
    swung, judged = [operators.free_swings(200, 10.0, 0.05, REACH, seed) for seed in (0, 1)]
    model = KoopmanModel(Monomials(5), regularization=None).fit(swung)
    picture = _picture(eigenfunctions_figure(operators.eigenfunction_table(model, judged, [REACH[0], REACH[2]])))
    rates = ", ".join(f"{rate:.3f}".replace("j", "i") for rate in operators.linearised_rates())
    return ipywidgets.VBox([ipywidgets.HTML(f"the plant, linearised at rest (1/s): {page.escape(rates)}"), picture])


def in_words(outcome: Outcome) -> ipywidgets.Widget:
    """The model's own report."""
    return ipywidgets.HTML(f'<pre style="line-height:1.35">{page.escape(str(outcome.model.report()))}</pre>')


FURTHER = {
    "the rig in motion": rig_in_motion,
    "the vector field": vector_fields,
    "eigenfunctions": eigenfunctions,
    "the model in words": in_words,
}


def _picture(figure):
    return ipywidgets.Image(value=png(figure, dpi=200), format="png", layout={"width": "600px"})
