"""What all figures share: style, size, saving. A figure is a function of the table that it shows, without analysis.

To add one, write ``@styled()`` over a function of one or more tables, start with `new_figure`, and save it with
`save_figure`, the table beside it. No pyplot: figures need no display and do not disturb one another.
"""

import io
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Literal

import matplotlib.style
import pandas as pd
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tras.workflow.arguments import short
from tras.workflow.files import replacing

STYLE = Path(__file__).with_name("tras.mplstyle")
WIDTH = 3.5  # one journal column, inches

# Roles that recur from figure to figure look the same in all of them.
TRUTH = {"color": "black", "linestyle": ":", "linewidth": 1.3}
MODEL = {"color": "#0072B2", "linestyle": "-", "linewidth": 1.1}
LINEAR = {"color": "#D55E00", "linestyle": (0, (4, 3)), "linewidth": 1.1}
MECHANICAL = {"color": "#6CC4A4", "linestyle": "-", "linewidth": 2.8}  # wide and light: seen where the truth lies on it


@contextmanager
def styled(**settings):
    """The project's style, in a ``with`` block or as ``@styled()`` over a function, whatever the user's settings.

    ``settings`` are matplotlib's own, on top of the style.
    """
    with matplotlib.style.context([STYLE, settings], after_reset=True):
        yield


def plain_decades(axis: Axis) -> None:
    """Numbers of a logarithmic axis as text: 0.01, not ten to a power; 2 and 5 too where few decades are seen."""

    def between(value, _):
        low, high = axis.get_view_interval()
        few = 0 < high <= 50 * low and f"{value:e}"[0] in "25"
        return f"{value:g}" if few else ""

    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(between)


class _Shown(Figure):
    """A figure that a notebook shows by itself, whether or not pyplot was ever imported."""

    def _repr_png_(self):
        content = io.BytesIO()
        with styled():
            self.savefig(content, format="png", dpi=self.dpi)
        return content.getvalue()


def plain(text: str) -> str:
    """Text from outside, such as a channel's name, for a figure: no formula, and no sign that hides it from a legend.

    >>> plain("$\\\\frac"), plain("_hidden")
    ('\\\\$\\\\frac', ' _hidden')
    """
    line = short(text).replace("$", r"\$")
    return f" {line}" if line.startswith("_") else line


def new_figure(
    height: float = 2.4,
    rows: int = 1,
    columns: int = 1,
    sharex: bool | Literal["none", "all", "row", "col"] = True,
    *,
    formulas: bool = True,
    **subplot_options,
) -> tuple[Figure, Any]:
    """An empty figure one column wide, and its axes: one, or an array of them.

    Parameters
    ----------
    height : float
        In inches.
    rows, columns : int
        Panels.
    formulas : bool
        Numbers at axes are formulas, as in the paper. As text they take a quarter of the time less: for pages made
        while somebody waits.
    sharex, **subplot_options
        As for `matplotlib.figure.Figure.subplots`.
    """
    with styled(**{"axes.formatter.use_mathtext": formulas}):
        figure = _Shown(figsize=(WIDTH, height), layout="constrained")
        axes = figure.subplots(rows, columns, sharex=sharex, **subplot_options)
        figure.align_ylabels()
    return figure, axes


@styled()
def png(figure: Figure, dpi: float = 130) -> bytes:
    """A figure as the bytes of a PNG, for a notebook or a widget; ``dpi`` are its dots per inch."""
    target = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(target, format="png", dpi=dpi, metadata={"Software": None})
    return target.getvalue()


def save_figure(figure: Figure, table: pd.DataFrame, stem: str | Path, *, layouts: int = 2) -> list[Path]:
    """Write a figure and the numbers behind it: ``stem``.pdf, .svg, .png and .csv; returns these paths.

    The same figure and table give the same bytes on the same machine: no file holds a date or a version. All four are
    prepared before the first one is moved into place, so that a full disk or a killed run leaves the older set.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    table : pandas.DataFrame
        The numbers that the figure shows. Its index is not written.
    stem : str or path
        Path without suffix; missing folders are made.
    layouts : int
        How often the panels are laid out. Once will do for a new figure, on a page made while somebody waits; of one
        that was shown before, the bytes then depend on that.

    Raises
    ------
    TypeError
        If `figure` or `table` is something else.
    """
    if not isinstance(figure, Figure):
        raise TypeError(f"figure must be a matplotlib Figure, not {type(figure).__name__}.")
    if not isinstance(table, pd.DataFrame):
        raise TypeError(f"table must be a pandas DataFrame, the figure's numbers, not {type(table).__name__}.")
    stem = Path(stem)
    # The suffix is appended by hand: Path.with_suffix would cut a stem such as "error_0.5s".
    finals = [stem.with_name(f"{stem.name}.{suffix}") for suffix in ("pdf", "svg", "png", "csv")]
    with ExitStack() as stack:
        _write(figure, table, layouts, *[stack.enter_context(replacing(path)) for path in finals])
    return finals


@styled()
def _write(figure, table, layouts, pdf, svg, png, csv):
    if (engine := figure.get_layout_engine()) is not None:
        # Every layout begins where the last one left off: once settled, the bytes stay the same. To draw, which lays
        # out too, would take twice the time, and so would an engine that is still there when a file is written.
        FigureCanvasAgg(figure)
        for _ in range(layouts):
            engine.execute(figure)
        figure.set_layout_engine(None)
    # None leaves an entry out: dates change from run to run and versions from machine to machine. The style must hold
    # here as well, because dpi, fonts and the hash salt of SVG are looked up when a figure is written.
    figure.savefig(pdf, format="pdf", metadata={"Creator": None, "Producer": None, "CreationDate": None})
    figure.savefig(svg, format="svg", metadata={"Creator": None, "Date": None})
    figure.savefig(png, format="png", metadata={"Software": None})
    # Ten digits: more than a figure shows or `make verify` compares, and few enough to drop the last bits of a fit,
    # which change with the processor and the number of BLAS threads (1e-16, grown by the condition number).
    table.to_csv(csv, index=False, float_format="%.10g", lineterminator="\n", encoding="utf-8")


def require(table: pd.DataFrame, name: str, columns: list[str]) -> None:
    """Raise a clear error unless `table` is a DataFrame with these columns; `name` is the argument's name."""
    if not isinstance(table, pd.DataFrame):
        raise TypeError(f"{name} must be a pandas DataFrame, not {type(table).__name__}.")
    missing = [column for column in columns if column not in table]
    if missing:
        raise ValueError(f"{name} lacks the columns {', '.join(missing)}; it has {', '.join(map(str, table.columns))}.")
