"""The whole replication as one page that opens without network: `make report`.

The story is docs/report.md. In it ``{{ FILE: WHAT where COLUMN=VALUE | FORMAT }}`` stands for a number of a table, a fenced block (``figure``,
``table``, ``compare``, ``claims``, ``errors``, ``readings``, ``plant``, ``provenance``) for what is made here. A section whose files are
missing says so in one sentence. ``python -m tras.report build/paper/report.html --data data --figures figures --build build/paper``
"""

import argparse
import functools
import json
import math
import re
import sys
from pathlib import Path
from typing import NamedTuple

from tras import claims, files, page

_SIGNS = {claims.REPRODUCED: ("✓", "reproduced"), claims.NAMED: ("◐", "named"), claims.NOT: ("✗", "not"), claims.UNCHECKABLE: ("?", "uncheckable")}
_LOOKUP = re.compile(r"(?P<file>[^:]+): (?P<what>.+?)(?: where (?P<where>.+?))?(?: \| (?P<format>\S+))?")


class Lacking(ValueError):
    """Something that a section needs is not there; the sentence says what, and which command makes it."""


class Sources(NamedTuple):
    """Where the page's numbers and figures come from."""

    data: Path
    figures: Path
    build: Path

    def path(self, name):
        """``data/x.csv`` or ``figures/x.csv`` as a file that exists."""
        folder, _, rest = name.partition("/")
        path = {"data": self.data, "figures": self.figures, "build": self.build}[folder] / rest
        if not path.is_file():
            raise Lacking(f"{name} is not there: `make all` makes it.")
        return path


def report(story, sources):
    """The page.

    Parameters
    ----------
    story : str
        Markdown with lookups and blocks.
    sources : Sources

    Returns
    -------
    html : str
    lacking : list of str
        What could not be shown, a sentence each.

    Raises
    ------
    ValueError
        If a block or lookup of the story is not understood, or a file of the sources is damaged.
    """
    contents, lacking, bodies = [], [], []
    sources = sources._replace(**{name: Path(path) for name, path in sources._asdict().items()})
    convert = page.converter(lambda text: look_up(text, sources), lambda kind, spec: _block(kind, spec, sources, convert), contents)
    for section in re.split(r"^(?=#{1,3} )", story, flags=re.MULTILINE):
        heading, _, text = section.partition("\n")
        bodies.append(convert(heading))
        try:
            bodies.append(convert(text))
        except Lacking as lack:
            lacking.append(str(lack))
            bodies.append(f'<p class="lacking">{page.inline(convert, f"This part is not shown: {lack}")}</p>\n')
    body = "".join(bodies)
    # A link to a figure of a section that is not shown leads nowhere.
    body = re.sub(r'<a href="#(fig-[^"]*)">(.*?)</a>', lambda link: link[0] if f'id="{link[1]}"' in body else link[2], body)
    return page.frame(story.partition("\n")[0].lstrip("# "), body, contents), lacking


# --- numbers of tables ---------------------------------------------------------------------------------------------------------


def look_up(text, sources):
    """``data/metrics.csv: max(nrmse) where angle=yaw, kind=window | .3g`` -> the number as text.

    ``WHAT`` is a column, of which just one row must be chosen, or min, max, median, mean, sum, count of one; ``STAGE: NAME`` is a parameter
    that this stage ran with.
    """
    match = _LOOKUP.fullmatch(text)
    if not match:
        raise ValueError(f"the story's {{{{ {text} }}}} is not understood: write FILE: WHAT where COLUMN=VALUE | FORMAT.")
    where = dict(pair.split("=", 1) for pair in (match["where"] or "").split(", ") if pair)
    if "/" not in match["file"]:
        recorded = json.loads(sources.path(f"build/{match['file']}.json").read_text(encoding="utf-8"))["parameters"]
        if match["what"] not in recorded:
            raise Lacking(f"{match['file']} has no parameter `{match['what']}`.")
        return number(recorded[match["what"]], match["format"] or "g")
    return number(_total(_chosen(_frame(match["file"], sources), where, match["file"]), match["what"], match["file"]), match["format"] or "g")


def number(value, spec="g"):
    """A value of a table as text: formatted when it is a number, ``–`` when there is none."""
    if isinstance(value, str):
        return value
    if value is None or math.isnan(value):
        return "–"
    return format(int(value), "d") if spec == "d" else format(value, spec)


@functools.lru_cache(maxsize=64)
def _read(path, _changed):
    import pandas as pd

    try:
        return pd.read_csv(path)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is no table ({error}): delete it, and make all makes it anew.") from None


def _frame(name, sources):
    path = sources.path(name)
    return _read(path, path.stat().st_mtime_ns)


def _chosen(frame, where, name):
    """The rows that hold these values; numbers compare as numbers."""
    for column, value in where.items():
        own = _column(frame, column, name)
        frame = frame[own == float(value) if own.dtype.kind in "if" else own.astype(str) == str(value)]
    return frame


def _column(frame, column, name):
    if column not in frame:
        raise Lacking(f"{name} has no column `{column}`.")
    return frame[column]


def _total(frame, what, name):
    """A column's only value, or ``median(column)`` and the like."""
    total, column = re.fullmatch(r"(?:(\w+)\()?([^()]+)\)?", what).groups()
    values = _column(frame, column, name)
    if total == "count":
        return int(values.count())
    if not len(values) or not total and len(values) > 1:
        raise Lacking(f"{name} has {len(values)} rows for one number, `{what}`: was it made with other parameters?")
    return values.agg(total) if total else values.iloc[0]


# --- blocks --------------------------------------------------------------------------------------------------------------------


def _block(kind, spec, sources, convert):
    if kind not in _BLOCKS:
        raise ValueError(f"the story has a block of the kind {kind!r}: there are {', '.join(_BLOCKS)}.")
    return _BLOCKS[kind](spec, sources, lambda text: page.inline(convert, text))


def _figure(spec, sources, inline):
    path = page.picture(sources.figures, spec["name"])
    if path is None:
        raise Lacking(f"figures/{spec['name']}.svg is not there: `make all` makes it.")
    return page.figure(path, " ".join(spec["alt"].split()), inline(spec["caption"]), f"fig-{spec['name']}")


def _table(spec, sources, inline):
    """``file, where`` choose; then ``columns`` (name: heading) lists them, ``first`` many, or ``rows, across, value`` summarise them."""
    name = spec["file"]
    frame, formats = _chosen(_frame(name, sources), spec.get("where", {}), name), spec.get("format", "g")
    if "rows" in spec:
        columns, rows = spec["rows"], _summarised(frame, spec, name)
        head = [*columns.values(), *(spec.get("heading", "{}").format(f"{value:g}" if isinstance(value, float) else value) for value in rows[0])]
        cells, keys = [[*map(number, key), *(number(value, formats) for value in values)] for key, values in rows[1:]], len(columns)
    else:
        head, keys = list(spec["columns"].values()), spec.get("keys", 1)
        listed = zip(*(_column(frame, column, name) for column in spec["columns"]))
        formats = [formats.get(column, "g") if isinstance(formats, dict) else formats for column in spec["columns"]]
        cells = [[number(value, one) for value, one in zip(row, formats)] for row, _ in zip(listed, range(spec.get("first", len(frame))))]
    return page.table(list(map(page.escape, head)), [list(map(page.escape, row)) for row in cells], inline(spec["caption"]), keys=keys)


def _summarised(frame, spec, name):
    """What stands across, then for each group of ``rows`` its key and a number under each of these."""
    rows = list(spec["rows"])
    for column in (*rows, *([spec["across"]] if "across" in spec else [])):
        _column(frame, column, name)
    groups = list(frame.groupby(rows, sort=False))
    if "across" not in spec:
        return [list(spec["values"]), *((key, [_total(part, what, name) for what in spec["values"].values()]) for key, part in groups)]
    across = list(dict.fromkeys(frame[spec["across"]]))
    parts = [(key, [part[part[spec["across"]] == value] for value in across]) for key, part in groups]
    return [across, *((key, [_total(cell, spec["value"], name) if len(cell) else None for cell in cells]) for key, cells in parts)]


def _from_markdown(text, caption, inline, *, prose):
    """A Markdown table of another module as one of this page."""
    head, _, *rows = ([inline(cell) for cell in line[2:-2].split(" | ")] for line in text.splitlines())
    return page.table(head, rows, inline(caption), prose=prose)


def _compare(spec, sources, inline):
    from tras import tables

    return _from_markdown(tables.markdown(tables.read(sources.path("figures/table.csv"))), spec["caption"], inline, prose=False)


def _errors(spec, _, inline):
    from tras import errata

    return _from_markdown(errata.markdown(errata.table()), spec["caption"], inline, prose=True)


def _readings(spec, _, inline):
    from tras import readings

    return _from_markdown(readings.markdown(), spec["caption"], inline, prose=True)


def _plant(spec, _, inline):
    from tras.plant import PlantParameters

    values = PlantParameters().as_dict()
    rows = [[inline(symbol), number(values[name], ".6g"), page.escape(unit)] for name, (symbol, unit) in spec["symbols"].items()]
    return page.table(["symbol", "value", "unit"], rows, inline(spec["caption"]))


def _verdict(row):
    sign, kind = _SIGNS.get(row["verdict"], ("?", "uncheckable"))
    return f'<span class="verdict {kind}"><span aria-hidden="true">{sign}</span> {page.escape(row["verdict"])}</span>'


def _claims(spec, sources, inline):
    """All claims: in short with ``table: true``, each with its evidence without."""
    path = sources.path("data/claims.csv")
    rows = claims.read(path)
    if not rows or set(claims.COLUMNS) - set(rows[0]):
        raise ValueError(f"{path} has not the columns {', '.join(claims.COLUMNS)}: delete it, and make all makes it anew.")
    e = page.escape
    if spec.get("table"):
        cells = [[f'<a href="#claim-{e(row["claim"])}">{e(row["claim"])}</a>', e(row["statement"]), _verdict(row)] for row in rows]
        return page.table(["claim", "the paper says", "verdict"], cells, inline(spec["caption"]), prose=True)
    return "".join(_claim(row) for row in rows)


def _claim(row):
    e, figure = page.escape, Path(row["figure"]).stem
    value, low, high = (number(float(row[name] or "nan"), ".4g") for name in ("value", "low", "high"))
    span = f" ({low} to {high})" if "–" not in (low, high) and low != high else ""
    parts = [
        f'<h4>{e(row["claim"])}: {e(row["statement"])}</h4>',
        f"<p>{_verdict(row)}</p>",
        f"<p>Reading: {e(row['reading'])}.</p>" if row["reading"] else "",
        f"<p>{e(row['quantity'])}: <strong>{e(value + span)}</strong>.</p>" if row["quantity"] else "",
        f"<p>{e(row['evidence'][:1].upper() + row['evidence'][1:])}.</p>",
        f'<p class="details">Figure: <a href="#fig-{e(figure)}">{e(row["figure"])}</a>.</p>' if figure else "",
        f'<p class="details">Made by <code>{e(row["command"])}</code>.</p>',
    ]
    return f'<article id="claim-{e(row["claim"])}">\n' + "\n".join(filter(None, parts)) + "\n</article>\n"


def _provenance(spec, sources, inline):
    """What `tras.runner` recorded beside the executed notebooks: when and from which revision, then everything else, once where it is the same."""
    records = {path.stem: _record(path) for path in sorted(sources.build.glob("[0-9]*.json")) if path.with_suffix(".ipynb").is_file()}
    if not records:
        raise Lacking("no stage has left a record beside its executed notebook: `make all` runs them.")
    e, rows, facts = page.escape, [], {}
    for stage, record in records.items():
        git = record.get("git") or {}
        revision = (git.get("revision") or "unknown")[:12] + (", with changes" if git.get("dirty") else "")
        rows.append([e(stage), f"<code>{e(revision)}</code>", e(record.get("started", "–")), e(number(record.get("seconds"), ".1f"))])
        packages = record.get("packages", {}) | {name: record.get(name) for name in ("python", "platform", "processor")} | (record.get("threads") or {})
        for name, value in packages.items():
            facts.setdefault(name, {}).setdefault(str(value), []).append(stage)
    listed = [[e(name), e(next(iter(found)) if len(found) == 1 else "; ".join(f"{v} ({', '.join(by)})" for v, by in found.items()))] for name, found in facts.items()]
    stages = page.table(["stage", "git revision", "started", "seconds"], rows, inline(spec["stages"]))
    return stages + page.table(["what", "version or value"], listed, inline(spec["environment"]), prose=True)


def _record(path):
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError):
        raise ValueError(f"{path} is no record of a run: delete it, and make all runs the stage anew.") from None


_BLOCKS = {
    "figure": _figure, "table": _table, "compare": _compare, "errors": _errors, "readings": _readings, "plant": _plant, "claims": _claims,
    "provenance": _provenance,
}  # fmt: skip


def main(arguments=None):
    """Command line; returns the exit status: 0, 1 (a damaged file, or no room to write), 2 (the call was wrong)."""
    parser = argparse.ArgumentParser(prog="python -m tras.report", description="Write the whole replication as one page that needs no network.")
    parser.add_argument("report", type=Path, help="where the page goes, for example build/paper/report.html")
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder of the tables (default: data)")
    parser.add_argument("--figures", type=Path, default=Path("figures"), help="folder of the figures (default: figures)")
    parser.add_argument("--build", type=Path, default=Path("build/paper"), help="folder of the executed notebooks (default: build/paper)")
    parser.add_argument("--story", type=Path, default=Path(__file__).parent.parent / "docs" / "report.md", help="the text (default: docs/report.md)")
    options = parser.parse_args(arguments)
    for path, exists in [(options.story, Path.is_file), (options.data, Path.is_dir), (options.figures, Path.is_dir), (options.build, Path.is_dir)]:
        if not exists(path):
            print(f"{path} does not exist; `make all` makes the data, the figures and the executed notebooks.", file=sys.stderr)
            return 2
    try:
        text, lacking = report(options.story.read_text(encoding="utf-8"), Sources(options.data, options.figures, options.build))
        with files.replacing(options.report) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    for sentence in dict.fromkeys(lacking):
        print(f"not shown: {sentence}", file=sys.stderr)
    print(f"{options.report}  {options.report.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
