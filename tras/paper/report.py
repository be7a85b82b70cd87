"""The whole replication as one page that opens without network: `make report`.

The story is docs/report.md. `tras.paper.lookups` puts the tables' numbers into it; a fenced block (a key of `_BLOCKS`)
with YAML in it stands for what is made here. A section whose files are missing says so in one sentence.

``python -m tras.paper.report build/paper/report.html --data data --figures figures --build build/paper``
"""

import argparse
import re
import sys
from pathlib import Path

from tras.paper import claims, errata, lookups, readings, tables
from tras.paper.lookups import Lacking, Sources, number
from tras.twin_rotor.plant import PlantParameters
from tras.workflow import files, page
from tras.workflow.page import escape

_MARKS = (("✓", "reproduced"), ("◐", "named"), ("✗", "not"), ("?", "uncheckable"), ("◑", "named"))
_SIGNS = dict(zip(claims.VERDICTS, _MARKS))
_LIMITS = {name: limit for name, limit in vars(claims).items() if name.isupper()}  # `claims.NAME` in the story
_ANEW = "delete it, and make all makes it anew."


def report(story: str, sources: Sources) -> tuple[str, list[str]]:
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
        One sentence for each part that could not be shown.

    Raises
    ------
    ValueError
        If a block or lookup of the story is not understood, or a file of the sources is damaged.
    """
    contents, lacking, bodies = [], [], []
    convert = page.converter(lambda kind, spec: _block(kind, spec, sources, convert), contents)
    for section in re.split(r"^(?=#{1,3} )", story, flags=re.MULTILINE):
        heading, _, text = section.partition("\n")
        bodies.append(convert(heading))
        try:
            bodies.append(convert(lookups.render(text, sources, claims=_LIMITS)))
        except Lacking as lack:
            lacking.append(str(lack))
            bodies.append(f'<p class="lacking">{page.inline(convert, f"This part is not shown: {lack}")}</p>\n')
    body = "".join(bodies)

    def checked(link):  # one to a figure of a section that is not shown leads nowhere
        return link[0] if f'id="{link[1]}"' in body else link[2]

    linked = re.sub(r'<a href="#(fig-[^"]*)">(.*?)</a>', checked, body)
    return page.frame(story.partition("\n")[0].lstrip("# "), linked, contents), lacking


# --- blocks -----------------------------------------------------------------------------------------------------------


def _block(kind, spec, sources, convert):
    if kind not in _BLOCKS:
        raise ValueError(f"the story has a block of the kind {kind!r}: there are {', '.join(_BLOCKS)}.")
    return _BLOCKS[kind](spec, sources, lambda text: page.inline(convert, text))


def _figure(spec, sources, inline):
    path = page.picture(sources.figures, spec["name"])
    if path is None:
        raise Lacking(f"figures/{spec['name']}.svg is not there: {sources.command} makes it.")
    alt, caption = " ".join(spec["alt"].split()), inline(spec["caption"])
    return page.figure(path, alt, caption, f"fig-{spec['name']}", wide=spec.get("wide", False))


def _table(spec, sources, inline):
    head, rows, keys = lookups.table(spec, sources)
    head, *rows = (list(map(escape, row)) for row in (head, *rows))
    return page.table(head, rows, inline(spec["caption"]), keys=keys)


def _from_markdown(text, caption, inline, *, kind):
    """A Markdown table of another module as one of this page."""
    head, _, *rows = ([inline(cell) for cell in line[2:-2].split(" | ")] for line in text.splitlines())
    return page.table(head, rows, inline(caption), kind=kind)


def _compare(spec, sources, inline):
    path = sources.path("figures/table.csv")
    try:
        text = tables.markdown(tables.read(path))
    except (KeyError, TypeError, ValueError, IndexError):
        raise ValueError(f"{path} is not the table paper against ours: {_ANEW}") from None
    html = _from_markdown(text, spec["caption"], inline, kind="numbers")
    return re.sub(r"(<td[^>]*>\S+) \(", r"\1 <br />(", html)  # the range below the median: seven columns are wide


def _errors(spec, _, inline):
    return _from_markdown(errata.markdown(), spec["caption"], inline, kind="prose")


def _readings(spec, _, inline):
    return _from_markdown(readings.markdown(), spec["caption"], inline, kind="prose")


def _plant(spec, _, inline):
    values, rows = PlantParameters().as_dict(), []
    for name, (symbol, unit) in spec["symbols"].items():
        rows.append([inline(symbol), number(values[name], ".6g"), escape(unit)])
    return page.table(["symbol", "value", "unit"], rows, inline(spec["caption"]))


def _verdict(row):
    sign, kind = _SIGNS.get(row["verdict"], ("?", "uncheckable"))
    return f'<span class="verdict {kind}"><span aria-hidden="true">{sign}</span> {escape(row["verdict"])}</span>'


def _claims(spec, sources, inline):
    """All claims: in short with ``table: true``, each with its evidence without."""
    path = sources.path("data/claims.csv")
    rows = tables.read(path)
    try:
        rows = [{name: row[name].strip() for name in claims.COLUMNS} for row in rows]
        rows = [row | {name: float(row[name] or "nan") for name in ("value", "low", "high")} for row in rows]
    except (KeyError, AttributeError, ValueError):
        raise ValueError(f"{path} is not the table of claims: {_ANEW}") from None
    if spec.get("table"):
        links = [f'<a href="#claim-{escape(row["claim"])}">{escape(row["claim"])}</a>' for row in rows]
        cells = [[link, escape(row["statement"]), _verdict(row)] for link, row in zip(links, rows)]
        return page.table(["claim", "the paper says", "verdict"], cells, inline(spec["caption"]), kind="short")
    return "".join(_claim(row) for row in rows)


def _claim(row):
    text = {name: escape(row[name]) for name in claims.COLUMNS}
    value, low, high = (number(row[name], ".4g") for name in ("value", "low", "high"))
    value += f" ({low} to {high})" if "–" not in (low, high) and low != high else ""
    parts = [f"<h3>{text['claim']}: {text['statement']}</h3>", f"<p>{_verdict(row)}</p>"]
    if row["reading"]:
        parts.append(f"<p>Reading: {text['reading']}.</p>")
    if row["quantity"]:
        parts.append(f"<p>{_sentence(text['quantity'])}: <strong>{escape(value)}</strong>.</p>")
    parts.append(f"<p>{_sentence(text['evidence'])}.</p>")
    if row["figure"]:
        link = f'<a href="#fig-{escape(Path(row["figure"]).stem)}">{text["figure"]}</a>'
        parts.append(f'<p class="details">Figure: {link}.</p>')
    parts.append(f'<p class="details">Made by <code>{text["command"]}</code>.</p>')
    return f'<article id="claim-{text["claim"]}">\n' + "\n".join(parts) + "\n</article>\n"


def _sentence(text):
    return text[:1].upper() + text[1:]


def _provenance(spec, sources, inline):
    """The records that `tras.workflow.runner` leaves beside executed notebooks; what several share is there once."""
    paths = [path for path in sorted(sources.build.glob("[0-9]*.json")) if path.with_suffix(".ipynb").is_file()]
    if not paths:
        raise Lacking(f"no stage has left a record beside its executed notebook: {sources.command} runs them.")
    rows, facts = [], {}
    for stage, record in ((path.stem, lookups.record(path)) for path in paths):
        git = record.get("git") or {}
        revision = (git.get("revision") or "unknown")[:12] + (", with changes" if git.get("dirty") else "")
        started, seconds = record.get("started", "–"), number(record.get("seconds"), ".1f")
        rows.append([escape(stage), f"<code>{escape(revision)}</code>", escape(started), escape(seconds)])
        for name, value in _environment(record).items():
            facts.setdefault(name, {}).setdefault(str(value), []).append(stage)
    cells = []
    for name, stages in facts.items():
        differing = "; ".join(f"{value} ({', '.join(names)})" for value, names in stages.items())
        cells.append([escape(name), escape(differing if len(stages) > 1 else next(iter(stages)))])
    stages = page.table(["stage", "git revision", "started", "seconds"], rows, inline(spec["stages"]))
    return stages + page.table(["what", "version or value"], cells, inline(spec["environment"]), kind="prose")


def _environment(record):
    """What a stage ran with, as far as its record says: name -> value."""
    facts = {name: record[name] for name in ("python", "platform", "processor") if name in record}
    facts |= {"vector instructions": ", ".join(record["instructions"])} if record.get("instructions") else {}
    facts |= {"SHA-256 of environment.txt": record["environment"]} if record.get("environment") else {}
    return facts | record.get("variables", {}) | record.get("packages", {})


_BLOCKS = {
    "figure": _figure, "table": _table, "compare": _compare, "errors": _errors, "readings": _readings, "plant": _plant,
    "claims": _claims, "provenance": _provenance,
}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit status: 0, 1 (a damaged file, or no room to write), 2 (the call was wrong)."""
    parser = argparse.ArgumentParser(
        prog="python -m tras.paper.report", description="Write the whole replication as one page that needs no network."
    )
    story = Path(__file__).parents[2] / "docs" / "report.md"
    parser.add_argument("report", type=Path, help="where the page goes, for example build/paper/report.html")
    for name, default, what in [
        ("data", Path("data"), "folder of the tables (default: data)"),
        ("figures", Path("figures"), "folder of the figures (default: figures)"),
        ("build", Path("build/paper"), "folder of the executed notebooks (default: build/paper)"),
        ("story", story, "the text (default: docs/report.md)"),
    ]:
        parser.add_argument(f"--{name}", type=Path, default=default, help=what)
    options = parser.parse_args(arguments)
    sources = Sources(options.data, options.figures, options.build)
    for path in (options.story, *sources):
        if not (path.is_file() if path is options.story else path.is_dir()):
            advice = "`make all` makes the data, the figures and the executed notebooks"
            print(f"{path} does not exist; {advice}.", file=sys.stderr)
            return 2
    try:
        text, lacking = report(options.story.read_text(encoding="utf-8"), sources)
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
