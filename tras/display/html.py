"""What a notebook shows of a recording and of a model: HTML in which all text from outside is escaped."""

import base64
from typing import TYPE_CHECKING

import numpy as np

from tras.plotting import png
from tras.workflow import page
from tras.workflow.arguments import short

if TYPE_CHECKING:
    from tras.display.plots import Comparison
    from tras.model import KoopmanModel
    from tras.recording import Recording

_CHANNELS = 30  # rows of a table
_WIDTH, _HEIGHT = 120, 22  # of a sparkline, in pixels


def recording_html(recording: "Recording") -> str:
    """Channels with role, unit, range and a sparkline over all trajectories."""
    columns = [(name, "state", unit) for name, unit in zip(recording.state_names, recording.state_units)]
    columns += [(name, "input", unit) for name, unit in zip(recording.input_names, recording.input_units)]
    rows = []
    for i, (name, role, unit) in enumerate(columns[:_CHANNELS]):
        parts = [x[:, i] if role == "state" else u[:, i - recording.n] for x, u in recording]
        values = np.concatenate(parts)
        cells = [short(name), role, short(unit) or "–", f"{values.min():.4g}", f"{values.max():.4g}"]
        rows.append([*map(page.escape, cells), sparkline(values)])
    more = len(columns) - len(rows)
    caption = f"{size(recording)}{f'; {more} more channels' if more > 0 else ''}"
    head = ["channel", "role", "unit", "lowest", "highest", "over time"]
    return in_notebook(page.table(head, rows, page.escape(caption)))


def model_html(model: "KoopmanModel") -> str:
    """The report of a fitted model."""
    return in_notebook(f"<pre>{page.escape(model.report())}</pre>\n")


def comparison_html(comparison: "Comparison") -> str:
    """The table of `tras.compare` above its figure."""
    columns = {"fit": ".4g", "nrmse": ".3g"}
    rows = []
    for row in comparison.table.to_dict("records"):
        numbers = [format(row[name], digits) if np.isfinite(row[name]) else "–" for name, digits in columns.items()]
        lost = f"{row['diverged']} of {row['trajectories']}"
        rows.append([page.escape(short(str(row["state"]))), page.escape(short(str(row["model"]))), *numbers, lost])
    head = ["state", "model", "fit (%)", "NRMSE (%)", "diverged"]
    table = page.table(head, rows, "Measured against simulated, over all trajectories.", keys=2)
    picture = base64.b64encode(png(comparison.figure)).decode()
    return in_notebook(f'{table}<img src="data:image/png;base64,{picture}" alt="Measured and simulated states" />\n')


def in_notebook(html: str) -> str:
    """HTML for a notebook, which takes dollar signs for formulas unless it is told not to."""
    return f'<div class="tex2jax_ignore mathjax_ignore">{html}</div>\n'


def size(recording: "Recording") -> str:
    """How many trajectories of how many samples at which sampling time.

    >>> import tras
    >>> size(tras.Recording([[[0.0], [1.0]]], dt=0.1))
    '1 trajectory of 2 samples at 0.1 s'
    """
    count, lengths = len(recording), recording.lengths
    samples = " to ".join(f"{n}" for n in dict.fromkeys((lengths.min(), lengths.max())))
    return f"{count} trajector{'y' if count == 1 else 'ies'} of {samples} samples at {recording.dt:g} s"


def sparkline(values: np.ndarray) -> str:
    """A curve as SVG, the lowest and the highest value of each stretch: peaks stay, however many samples there are."""
    edges = np.linspace(0, len(values), min(len(values), _WIDTH) + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)
    bottom, span = low.min(), float(high.max() - low.min()) or 1.0
    x = np.linspace(1, _WIDTH - 1, len(edges))
    points = []
    for at, *ends in zip(x, low, high):
        points += [f"{at:.1f},{_HEIGHT - 2 - (_HEIGHT - 4) * (end - bottom) / span:.1f}" for end in dict.fromkeys(ends)]
    line = f'<polyline points="{" ".join(points)}" fill="none" stroke="currentColor" stroke-width="1"/>'
    return f'<svg width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img">{line}</svg>'
