"""Numbers for a text, looked up in the tables: Jinja expressions between ``{{`` and ``}}``, with blanks inside.

``value(FILE, WHAT, COLUMN=VALUE, ...)`` looks into ``data/NAME.csv`` or ``figures/NAME.csv``. ``WHAT`` is a column, of
which the choices must leave one row, or the min, max, median, mean, sum, count or largest (in size) of one, like
``median(nrmse)``; ``method at min(nrmse)`` is the method of the row that has the smallest. A value may be ``">0.5"``,
``"<0.5"``, or a list of which any counts. ``parameter(STAGE, NAME)`` is a parameter that this stage ran with;
``| number(FORMAT)`` formats any of them as Python does, and ``{% if ... %}`` lets the tables decide what is said.

The site, the conclusions of the notebooks and the test of the prose (`tests/paper/test_prose.py`) all use this.
"""

import functools
import json
import math
import re
from pathlib import Path
from typing import NamedTuple

import jinja2
from jinja2.sandbox import SandboxedEnvironment


class Lacking(ValueError):
    """Something that a section needs is not there; the sentence says what, and which command makes it."""


class Sources(NamedTuple):
    """Where the page's numbers and figures come from."""

    data: Path
    figures: Path
    build: Path = Path("build/paper")

    @property
    def command(self):
        """The command that makes everything of this profile, whose name is that of the folder ``build``."""
        return "`make all`" if self.build.name == "paper" else f"`make all PROFILE={self.build.name}`"

    def path(self, name):
        """``data/x.csv`` or ``figures/x.csv`` as a file that exists."""
        folder, _, rest = name.partition("/")
        path = {"data": self.data, "figures": self.figures, "build": self.build}[folder] / rest
        if not path.is_file():
            raise Lacking(f"{name} is not there: {self.command} makes it.")
        return path


def render(text: str, sources: Sources, **names) -> str:
    """``text`` with every lookup replaced by its number, which no Markdown in a table can break out of.

    Parameters
    ----------
    text : str
        For example ``{{ value("data/metrics.csv", "max(nrmse)", angle="yaw", kind="window") | number(".3g") }} %``.
    sources : Sources
    **names
        What else the text may name, such as a notebook's parameters.

    Raises
    ------
    Lacking
        If the file, the column, the row or the parameter is not there.
    ValueError
        If a lookup is not understood, or the file is damaged.
    """

    value = functools.partial(_value, sources)

    def parameter(stage, name):
        parameters = record(sources.path(f"build/{stage}.json")).get("parameters", {})
        if name not in parameters:
            raise Lacking(f"{stage} has no parameter `{name}`.")
        return parameters[name]

    try:
        return _ENVIRONMENT.from_string(text).render(names, value=value, parameter=parameter)
    except (jinja2.TemplateError, TypeError, ZeroDivisionError) as error:
        usage = "{{ value(FILE, WHAT, COLUMN=VALUE) | number(FORMAT) }}"
        raise ValueError(f"a lookup is not understood ({error}): write {usage}.") from None


def conclusions(text: str, sources: Sources, tables: dict[str, str], **names) -> str:
    """The points of a list, each with its numbers; of one whose numbers these tables lack, what is lacking.

    Parameters
    ----------
    text : str
        Markdown: points that begin with ``* `` at the margin.
    sources : Sources
    tables : dict of str to str
        Name in the text -> file: with ``{"noise": "data/noise.csv"}``, ``noise(WHAT, COLUMN=VALUE)`` is short for
        ``value("data/noise.csv", WHAT, COLUMN=VALUE)``, and ``noise.pair(WHAT, COLUMN=VALUE)`` for yaw / pitch, the
        same with ``angle="yaw"`` and with ``angle="pitch"``.
    **names
        As in `render`.

    Raises
    ------
    ValueError
        As `render`, but for what is lacking.

    Examples
    --------
    >>> text = "* {% if error < 5 %}Good{% else %}Poor{% endif %}: {{ error | number('.1f') }} %."
    >>> conclusions(text, Sources(Path("data"), Path("figures")), {}, error=4.06)
    '* Good: 4.1 %.'
    """
    names |= {name: Table(sources, file) for name, file in tables.items()}
    points = []
    for point in re.split(r"^(?=\* )", text.strip(), flags=re.MULTILINE):
        try:
            points.append(" ".join(render(point, sources, **names).split()))
        except Lacking as lack:
            points.append(f"* *Nothing to conclude here:* {lack}")
    return "\n".join(dict.fromkeys(filter(None, points)))  # what is lacking is said once


def number(value, spec: str = "g") -> str:
    """A value of a table as text: formatted when it is a number, ``–`` when there is none.

    Examples
    --------
    >>> number(5.9, "#.3g"), number(float("nan")), number("yaw"), number(9.0, "d")
    ('5.90', '–', 'yaw', '9')
    """
    if isinstance(value, str):
        return value
    if value is None or math.isnan(value):
        return "–"
    return format(int(value), "d") if spec == "d" else format(value, spec).rstrip(".")


# LaTeX writes `{{` too, but no blank behind it; a text holds neither statements nor comments.
_ENVIRONMENT = SandboxedEnvironment(
    variable_start_string="{{ ",
    variable_end_string=" }}",
    undefined=jinja2.StrictUndefined,
    finalize=lambda value: re.sub(r"([\\`*_{}\[\]<>#$|~])", r"\\\1", number(value)),
    keep_trailing_newline=True,
)
_ENVIRONMENT.filters["number"] = number


def record(path: Path) -> dict:
    """What `tras.workflow.runner` wrote beside an executed notebook, as a dictionary."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError):
        raise ValueError(f"{path} is no record of a run: delete it, and make all runs the stage anew.") from None


def frame(name: str, sources: Sources):
    """A table of the sources as a pandas.DataFrame; the same object for the same file."""
    path = sources.path(name)
    return _read(path, path.stat().st_mtime_ns)


def table(spec: dict, sources: Sources) -> tuple[list[str], list[list[str]], int]:
    """A table of a table: some of its columns and rows, or a summary.

    Parameters
    ----------
    spec : dict
        ``file``; ``where`` (column: value) chooses rows. Then either ``columns`` (column: heading), the first ``keys``
        of which name the row, and ``first`` many rows; or ``rows`` (column: heading) for the groups, and ``across`` (a
        column) with ``value`` or ``values`` (heading: value) for the numbers, a value being like ``median(nrmse)``.
        ``format`` is one for all or, with ``columns``, column: format.
    sources : Sources

    Returns
    -------
    head : list of str
    rows : list of list of str
    keys : int
        How many columns name the row.
    """
    name, formats = spec["file"], spec.get("format", "g")
    rows = _selected(frame(name, sources), spec.get("where", {}), name)
    if "rows" in spec:
        across, cells = _summary(rows, spec, name)
        head = [*spec["rows"].values(), *(spec.get("heading", "{}").format(number(value)) for value in across)]
        cells = [[*map(number, key), *(number(value, formats) for value in values)] for key, values in cells]
        return head, cells, len(spec["rows"])
    rows = rows.head(spec.get("first", len(rows)))
    formats = [formats.get(column, "g") if isinstance(formats, dict) else formats for column in spec["columns"]]
    cells = zip(*(_column(rows, column, name) for column in spec["columns"]))
    return list(spec["columns"].values()), [[*map(number, row, formats)] for row in cells], spec.get("keys", 1)


# --- parts ------------------------------------------------------------------------------------------------------------


class Table(NamedTuple):
    """A table of the sources as a function of a text."""

    sources: Sources
    file: str

    def __call__(self, what, **where):
        return _value(self.sources, self.file, what, **where)

    def pair(self, what, spec="#.2g", **where):
        """Yaw / pitch, formatted."""
        return " / ".join(number(self(what, angle=angle, **where), spec) for angle in ("yaw", "pitch"))


def _value(sources, name, what, **where):
    return _total(_selected(frame(name, sources), where, name), what, name)


def _summary(rows, spec, name):
    """What stands across, and for each group of rows its key and the numbers below that."""
    for column in (*spec["rows"], *([spec["across"]] if "across" in spec else [])):
        _column(rows, column, name)
    groups = rows.groupby(list(spec["rows"]), sort=False)
    if "across" not in spec:
        totals = spec["values"]
        return list(totals), [(key, [_total(part, what, name) for what in totals.values()]) for key, part in groups]
    across, cells = list(dict.fromkeys(rows[spec["across"]])), []
    for key, part in groups:
        parts = [part[part[spec["across"]] == value] for value in across]
        cells.append((key, [_total(cell, spec["value"], name) if len(cell) else None for cell in parts]))
    return across, cells


@functools.lru_cache(maxsize=64)
def _read(path, _changed):
    import pandas as pd

    try:
        return pd.read_csv(path)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is no table ({error}): delete it, and make all makes it anew.") from None


def _selected(rows, where, name):
    """The rows that hold these values; numbers compare as numbers, and ``>0.5`` as a value means larger ones."""
    for column, value in where.items():
        cells = _column(rows, column, name)
        if isinstance(value, str) and value[:1] in ("<", ">"):
            limit = float(value[1:])
            rows = rows[cells > limit if value[0] == ">" else cells < limit]
        else:
            kind = float if cells.dtype.kind in "if" else str
            rows = rows[cells.astype(kind).isin([kind(v) for v in (value if isinstance(value, list) else [value])])]
    return rows


def _column(rows, column, name):
    if column not in rows:
        raise Lacking(f"{name} has no column `{column}`.")
    return rows[column]


def _total(rows, what, name):
    """A column's only value, ``median(column)`` and the like, or ``other at min(column)``."""
    other, total, column = re.fullmatch(r"(?:(\w+) at )?(?:(\w+)\()?([^()]+)\)?", what).groups()
    values = _column(rows, column, name)
    if total == "count":
        return int(values.count())
    if not (values.count() if other else len(values)) or not total and len(values) > 1:
        raise Lacking(f"{name} has {len(values)} rows for one number, `{what}`: was it made with other parameters?")
    if other:
        return _column(rows, other, name)[values.idxmin() if total == "min" else values.idxmax()]
    if total == "largest":
        return values.abs().max()
    return values.agg(total) if total else values.iloc[0]
