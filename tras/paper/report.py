"""The whole replication as one page that opens without network: `make report`.

The story is docs/report.md. `tras.paper.lookups` puts the tables' numbers into it; a fenced block (``figure``, ``table``,
``compare``, ``claims``, ``errors``, ``readings``, ``plant``, ``provenance``) with YAML in it stands for what is made
here. A section whose files are missing says so in one sentence.

``python -m tras.paper.report build/paper/report.html --data data --figures figures --build build/paper``
"""

import argparse
import re
import sys
from pathlib import Path

from tras.paper import claims, lookups, tables
from tras.paper.lookups import Lacking, Sources, number
from tras.workflow import files, page

_SIGNS = dict(zip(claims.VERDICTS, (("✓", "reproduced"), ("◐", "named"), ("✗", "not"), ("?", "uncheckable"))))


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
        One sentence for each part that could not be shown.

    Raises
    ------
    ValueError
        If a block or lookup of the story is not understood, or a file of the sources is damaged.
    """
    contents, lacking, bodies = [], [], []
    sources = sources._replace(**{name: Path(path) for name, path in sources._asdict().items()})
    convert = page.converter(lambda kind, spec: _block(kind, spec, sources, convert), contents)
    for section in re.split(r"^(?=#{1,3} )", story, flags=re.MULTILINE):
        heading, _, text = section.partition("\n")
        bodies.append(convert(heading))
        try:
            bodies.append(convert(lookups.render(text, sources)))
        except Lacking as lack:
            lacking.append(str(lack))
            bodies.append(f'<p class="lacking">{page.inline(convert, f"This part is not shown: {lack}")}</p>\n')
    body = "".join(bodies)
    # A link to a figure of a section that is not shown leads nowhere.
    body = re.sub(
        r'<a href="#(fig-[^"]*)">(.*?)</a>', lambda link: link[0] if f'id="{link[1]}"' in body else link[2], body
    )
    return page.frame(story.partition("\n")[0].lstrip("# "), body, contents), lacking


# --- blocks -----------------------------------------------------------------------------------------------------------


def _block(kind, spec, sources, convert):
    if kind not in _BLOCKS:
        raise ValueError(f"the story has a block of the kind {kind!r}: there are {', '.join(_BLOCKS)}.")
    return _BLOCKS[kind](spec, sources, lambda text: page.inline(convert, text))


def _figure(spec, sources, inline):
    path = page.picture(sources.figures, spec["name"])
    if path is None:
        raise Lacking(f"figures/{spec['name']}.svg is not there: {sources.command} makes it.")
    return page.figure(path, " ".join(spec["alt"].split()), inline(spec["caption"]), f"fig-{spec['name']}")


def _table(spec, sources, inline):
    head, rows, keys = lookups.table(spec, sources)
    return page.table(
        list(map(page.escape, head)), [list(map(page.escape, row)) for row in rows], inline(spec["caption"]), keys=keys
    )


def _from_markdown(text, caption, inline, *, kind):
    """A Markdown table of another module as one of this page."""
    head, _, *rows = ([inline(cell) for cell in line[2:-2].split(" | ")] for line in text.splitlines())
    return page.table(head, rows, inline(caption), kind=kind)


def _compare(spec, sources, inline):
    path = sources.path("figures/table.csv")
    try:
        text = tables.markdown(tables.read(path))
    except (KeyError, TypeError, ValueError, IndexError, StopIteration):
        raise ValueError(
            f"{path} is not the table paper against ours: delete it, and make all makes it anew."
        ) from None
    html = _from_markdown(text, spec["caption"], inline, kind="numbers")
    return re.sub(r"(<td[^>]*>\S+) \(", r"\1 <br />(", html)  # the range below the median: seven columns are wide


def _errors(spec, _, inline):
    from tras.paper import errata

    return _from_markdown(errata.markdown(errata.table()), spec["caption"], inline, kind="prose")


def _readings(spec, _, inline):
    from tras.paper import readings

    return _from_markdown(readings.markdown(), spec["caption"], inline, kind="prose")


def _plant(spec, _, inline):
    from tras.twin_rotor.plant import PlantParameters

    values = PlantParameters().as_dict()
    rows = [
        [inline(symbol), number(values[name], ".6g"), page.escape(unit)]
        for name, (symbol, unit) in spec["symbols"].items()
    ]
    return page.table(["symbol", "value", "unit"], rows, inline(spec["caption"]))


def _verdict(row):
    sign, kind = _SIGNS.get(row["verdict"], ("?", "uncheckable"))
    return f'<span class="verdict {kind}"><span aria-hidden="true">{sign}</span> {page.escape(row["verdict"])}</span>'


def _claims(spec, sources, inline):
    """All claims: in short with ``table: true``, each with its evidence without."""
    path, e = sources.path("data/claims.csv"), page.escape
    rows = tables.read(path)
    try:
        rows = [{name: row[name].strip() for name in claims.COLUMNS} for row in rows]
        rows = [row | {name: float(row[name] or "nan") for name in ("value", "low", "high")} for row in rows]
    except (KeyError, AttributeError, ValueError):
        raise ValueError(f"{path} is not the table of claims: delete it, and make all makes it anew.") from None
    if spec.get("table"):
        cells = [
            [f'<a href="#claim-{e(row["claim"])}">{e(row["claim"])}</a>', e(row["statement"]), _verdict(row)]
            for row in rows
        ]
        return page.table(["claim", "the paper says", "verdict"], cells, inline(spec["caption"]), kind="short")
    return "".join(_claim(row) for row in rows)


def _claim(row):
    e, figure = page.escape, Path(row["figure"]).stem
    value, low, high = (number(row[name], ".4g") for name in ("value", "low", "high"))
    span = f" ({low} to {high})" if "–" not in (low, high) and low != high else ""
    parts = [
        f"<h3>{e(row['claim'])}: {e(row['statement'])}</h3>",
        f"<p>{_verdict(row)}</p>",
        f"<p>Reading: {e(row['reading'])}.</p>" if row["reading"] else "",
        f"<p>{e(_sentence(row['quantity']))}: <strong>{e(value + span)}</strong>.</p>" if row["quantity"] else "",
        f"<p>{e(_sentence(row['evidence']))}.</p>",
        f'<p class="details">Figure: <a href="#fig-{e(figure)}">{e(row["figure"])}</a>.</p>' if figure else "",
        f'<p class="details">Made by <code>{e(row["command"])}</code>.</p>',
    ]
    return f'<article id="claim-{e(row["claim"])}">\n' + "\n".join(filter(None, parts)) + "\n</article>\n"


def _sentence(text):
    return text[:1].upper() + text[1:]


def _provenance(spec, sources, inline):
    """The records that `tras.workflow.runner` leaves beside executed notebooks; what several share stands there once."""
    records = {
        path.stem: lookups.record(path)
        for path in sorted(sources.build.glob("[0-9]*.json"))
        if path.with_suffix(".ipynb").is_file()
    }
    if not records:
        raise Lacking(f"no stage has left a record beside its executed notebook: {sources.command} runs them.")
    e, rows, facts = page.escape, [], {}
    for stage, record in records.items():
        git = record.get("git") or {}
        revision = (git.get("revision") or "unknown")[:12] + (", with changes" if git.get("dirty") else "")
        rows.append(
            [
                e(stage),
                f"<code>{e(revision)}</code>",
                e(record.get("started", "–")),
                e(number(record.get("seconds"), ".1f")),
            ]
        )
        for name, value in _environment(record).items():
            facts.setdefault(name, {}).setdefault(value, []).append(stage)
    several = {
        name: "; ".join(f"{value} ({', '.join(by)})" for value, by in values.items()) for name, values in facts.items()
    }
    cells = [[e(name), e(next(iter(values)) if len(values) == 1 else several[name])] for name, values in facts.items()]
    stages = page.table(["stage", "git revision", "started", "seconds"], rows, inline(spec["stages"]))
    return stages + page.table(["what", "version or value"], cells, inline(spec["environment"]), kind="prose")


def _environment(record):
    """What a stage ran with, as far as its record says: name -> text."""
    facts = {name: record[name] for name in ("python", "platform", "processor") if name in record}
    facts |= {"vector instructions": ", ".join(record["instructions"])} if record.get("instructions") else {}
    facts |= {"SHA-256 of environment.txt": record["environment"]} if record.get("environment") else {}
    return {
        name: str(value) for name, value in (facts | record.get("variables", {}) | record.get("packages", {})).items()
    }


_BLOCKS = {
    "figure": _figure, "table": _table, "compare": _compare, "errors": _errors, "readings": _readings, "plant": _plant, "claims": _claims,
    "provenance": _provenance,
}  # fmt: skip


def main(arguments=None):
    """Command line; returns the exit status: 0, 1 (a damaged file, or no room to write), 2 (the call was wrong)."""
    parser = argparse.ArgumentParser(
        prog="python -m tras.paper.report", description="Write the whole replication as one page that needs no network."
    )
    parser.add_argument("report", type=Path, help="where the page goes, for example build/paper/report.html")
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder of the tables (default: data)")
    parser.add_argument(
        "--figures", type=Path, default=Path("figures"), help="folder of the figures (default: figures)"
    )
    parser.add_argument(
        "--build",
        type=Path,
        default=Path("build/paper"),
        help="folder of the executed notebooks (default: build/paper)",
    )
    parser.add_argument(
        "--story",
        type=Path,
        default=Path(__file__).parents[2] / "docs" / "report.md",
        help="the text (default: docs/report.md)",
    )
    options = parser.parse_args(arguments)
    for path, exists in [
        (options.story, Path.is_file),
        (options.data, Path.is_dir),
        (options.figures, Path.is_dir),
        (options.build, Path.is_dir),
    ]:
        if not exists(path):
            print(
                f"{path} does not exist; `make all` makes the data, the figures and the executed notebooks.",
                file=sys.stderr,
            )
            return 2
    try:
        text, lacking = report(
            options.story.read_text(encoding="utf-8"), Sources(options.data, options.figures, options.build)
        )
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
