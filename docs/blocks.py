"""What the site takes from tables and figures: a Sphinx extension.

`tras.paper.lookups` puts the tables' numbers into the text. A directive of `_BLOCKS`, with YAML in it, stands for what
is made here. A section or block whose files are missing says so in one sentence. Whatever comes from a file becomes a
node of text, which Sphinx escapes; a caption is Markdown, in which the lookups escape.
"""

import json
import re
from pathlib import Path

import yaml
from docutils import nodes
from sphinx import addnodes
from sphinx.errors import SphinxError
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from tras.paper import claims, lookups, plans, tables
from tras.paper.lookups import Lacking, Sources, number
from tras.twin_rotor.plant import PlantParameters
from tras.workflow import page

_LOG = logging.getLogger(__name__)
_MARKS = (("✓", "reproduced"), ("◐", "named"), ("✗", "not"), ("?", "uncheckable"), ("◑", "named"))
_SIGNS = dict(zip(claims.VERDICTS, _MARKS)) | dict(zip(claims.FUTURE, (_MARKS[0], _MARKS[4], _MARKS[2])))
_LIMITS = {  # `claims.NAME` in a page
    module.__name__.rpartition(".")[2]: {name: limit for name, limit in vars(module).items() if name.isupper()}
    for module in (claims, plans)
}
_ANEW = "delete it, and make all makes it anew."
_FIGURE = re.compile(r"^```\{tras-figure\}\n(.*?)^```", re.MULTILINE | re.DOTALL)


def setup(app):
    for field in Sources._fields:
        app.add_config_value(f"tras_{field}", None, "env", str)
    app.add_config_value("tras_pages", [], "env", list)
    app.connect("source-read", _read)
    app.connect("autodoc-skip-member", _not_ours)
    for name, kind in _BLOCKS.items():
        app.add_directive(f"tras-{name}", kind)
    app.add_html_math_renderer("mathml", (_inline_formula, None), (_formula, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def _sources(config):
    return Sources(*(Path(config[f"tras_{field}"]) for field in Sources._fields))


def _not_ours(app, what, name, member, skip, options):
    """Leave out what scikit-learn brings to every estimator."""
    return skip or str(getattr(member, "__module__", "")).startswith("sklearn")


# --- text -------------------------------------------------------------------------------------------------------------


def _read(app, name, source):
    """Links as they are in the repository lead to the same pages here, and lookups become numbers."""
    source[0] = source[0].replace("](../docs/", "](../") if "/" in name else source[0].replace("](../", "](")
    if app.env.doc2path(name).suffix == ".ipynb":
        source[0] = _folded(source[0])
    if name in app.config.tras_pages:
        source[0] = render(source[0], _sources(app.config))


def _folded(notebook):
    """Fold the cells that write conclusions: what they write stands below them, with its numbers."""
    content = json.loads(notebook)
    for cell in content["cells"]:
        if cell["cell_type"] == "code" and re.search(r"^conclude\(", "".join(cell["source"]), re.M):
            cell["metadata"].setdefault("tags", []).append("hide-input")
    return json.dumps(content)


def render(text: str, sources: Sources) -> str:
    """A page with its numbers; a section whose numbers are missing is a note that says which.

    Raises
    ------
    sphinx.errors.SphinxError
        If a lookup is not understood, or a table is damaged.
    """
    parts = []
    for section in re.split(r"^(?=#{1,3} )", text, flags=re.MULTILINE):
        try:
            parts.append(lookups.render(section, sources, **_LIMITS, profile=sources.build.name))
        except Lacking as lack:
            heading = re.match(r"(#{1,3} [^\n]*\n)?", section)[0]
            parts.append(f"{heading}\n```{{note}}\n{_missing(lack)}\n```\n\n")
        except ValueError as error:
            raise SphinxError(str(error)) from None
    return "".join(parts)


def _missing(lack):
    print(f"not shown: {lack}")
    return f"This part is not shown: {lack}"


# --- formulas as MathML, which every browser draws by itself ----------------------------------------------------------


def _inline_formula(translator, node):
    translator.body.append(_checked(node.astext(), page.formula(node.astext())))
    raise nodes.SkipNode


def _formula(translator, node):
    translator.body.append(_checked(node.astext(), page.formula(node.astext(), display=True)))
    raise nodes.SkipNode


def _checked(tex, mathml):
    if "\\" in mathml:
        _LOG.warning("this formula holds a command that latex2mathml does not know: %s", tex)
    return mathml


# --- blocks -----------------------------------------------------------------------------------------------------------


class Block(SphinxDirective):
    """A directive that makes nodes of its YAML and of the sources."""

    has_content = True

    def run(self):
        try:
            return self.make(yaml.safe_load("\n".join(self.content)) or {}, _sources(self.config))
        except Lacking as lack:
            return [nodes.note("", nodes.paragraph("", "", *self.inline(_missing(lack))))]
        except KeyError as error:
            raise self.error(f"this block is not understood: {error} is missing.") from None
        except yaml.YAMLError as error:
            raise self.error(f"this block is not understood: {error}") from None
        except ValueError as error:
            raise self.error(str(error)) from None

    def inline(self, text):
        """Markdown of one line as nodes."""
        return self.parse_inline(" ".join(str(text).split()))[0]

    def table(self, head, rows, caption, *, keys=1, kind="numbers"):
        """A table whose first ``keys`` columns name the row. A cell is text or a list of nodes."""
        group = nodes.tgroup("", cols=len(head))
        group += [nodes.colspec(colwidth=1, stub=int(i < keys)) for i in range(len(head))]
        numeric = [i >= keys and all(_is_number(row[i]) for row in rows) for i in range(len(head))]
        for part, lines in ((nodes.thead(), [head]), (nodes.tbody(), rows)):
            for line in lines:
                row = nodes.row()
                for cell, right in zip(line, numeric):
                    content = [nodes.Text(cell)] if isinstance(cell, str) else cell
                    entry = nodes.entry("", nodes.paragraph("", "", *content))
                    entry["classes"] += ["number"] if right and kind == "numbers" else []
                    row += entry
                part += row
            group += part
        title = nodes.title("", "", *self.inline(caption))
        return nodes.table("", title, group, classes=[kind])

    def figures(self, sources):
        """The figures that the pages show, as far as their files are there: name -> words that say what is seen."""
        pages = [Path(self.env.srcdir, f"{name}.md").read_text(encoding="utf-8") for name in self.config.tras_pages]
        blocks = [yaml.safe_load(block) for text in pages for block in _FIGURE.findall(text)]
        return {block["name"]: block["alt"] for block in blocks if _picture(sources, block["name"])}

    def label(self, identity, title):
        """A label that links of any page can lead to."""
        self.env.domains["std"].note_hyperlink_target(identity.lower(), self.env.docname, identity, title)

    def link(self, identity, text):
        """A link to a label."""
        options = {"refdomain": "std", "reftype": "ref", "refexplicit": True, "refwarn": True}
        inside = nodes.inline("", text)
        return addnodes.pending_xref("", inside, reftarget=identity.lower(), refdoc=self.env.docname, **options)


def _picture(sources, name):
    """The file that shows a figure best, or None."""
    film = sources.figures / f"{name}.gif"
    return film if film.is_file() else page.picture(sources.figures, name)


class Figure(Block):
    """``name, alt, caption``, and ``wide: true`` for one of two columns; its label is ``fig-NAME``."""

    def make(self, spec, sources):
        path = _picture(sources, spec["name"]) or sources.path(f"figures/{spec['name']}.png")
        identity = f"fig-{spec['name']}"
        image = nodes.image(uri=f"/figures/{path.name}", alt=" ".join(spec["alt"].split()))
        figure = nodes.figure("", image, nodes.caption("", "", *self.inline(spec["caption"])), ids=[identity])
        figure["classes"] += ["wide"] if spec.get("wide") else []
        self.label(identity, spec["name"])
        self.env.note_dependency(path)
        return [figure]


class Gallery(Block):
    """Every figure of the pages, small, with a link to the place that explains it."""

    def make(self, spec, sources):
        items = nodes.container(classes=["gallery"])
        for name, alt in self.figures(sources).items():
            image = nodes.image(uri=f"/figures/{_picture(sources, name).name}", alt="")
            title = " ".join(alt.split()).partition(". ")[0].rstrip(".") + "."
            items += nodes.figure("", image, nodes.caption("", "", self.link(f"fig-{name}", title)))
        return [items]


class Table(Block):
    """A table of a table: see `tras.paper.lookups.table`."""

    def make(self, spec, sources):
        head, rows, keys = lookups.table(spec, sources)
        return [self.table(head, rows, spec["caption"], keys=keys)]


class Compare(Block):
    """Paper against ours."""

    def make(self, spec, sources):
        path = sources.path("figures/table.csv")
        try:
            lines = tables.markdown(tables.read(path)).splitlines()
        except (KeyError, TypeError, ValueError, IndexError):
            raise ValueError(f"{path} is not the table paper against ours: {_ANEW}") from None
        head, _, *rows = ([cell.strip() for cell in line[1:-1].split("|")] for line in lines)
        return [self.table(head, rows, spec["caption"])]


class Plant(Block):
    """``symbols``: name of a parameter -> its symbol and unit."""

    def make(self, spec, _):
        values = PlantParameters().as_dict()
        rows = [[self.inline(s), number(values[name], ".6g"), unit] for name, (s, unit) in spec["symbols"].items()]
        return [self.table(["symbol", "value", "unit"], rows, spec["caption"])]


class Claims(Block):
    """All claims: in short with ``table: true``, each with its evidence without."""

    def make(self, spec, sources):
        path = sources.path("data/claims.csv")
        self.env.note_dependency(path)
        rows = tables.read(path)
        try:
            rows = [{name: row[name].strip() for name in claims.COLUMNS} for row in rows]
            rows = [row | {name: float(row[name] or "nan") for name in ("value", "low", "high")} for row in rows]
        except (KeyError, AttributeError, ValueError):
            raise ValueError(f"{path} is not the table of claims: {_ANEW}") from None
        if spec.get("table"):
            cells = [[[self.link(f"claim-{r['claim']}", r["claim"])], r["statement"], [_verdict(r)]] for r in rows]
            return [self.table(["claim", "the paper says", "verdict"], cells, spec["caption"], kind="short")]
        return [self.claim(row, sources) for row in rows]

    def claim(self, row, sources):
        value, low, high = (number(row[name], ".4g") for name in ("value", "low", "high"))
        value += f" ({low} to {high})" if "–" not in (low, high) and low != high else ""
        title = f"{row['claim']}: {row['statement']}"
        section = nodes.section("", nodes.title("", title), ids=[f"claim-{row['claim']}"], names=[title.lower()])
        section += nodes.paragraph("", "", _verdict(row))
        if row["reading"]:
            word = "" if row["verdict"] in claims.FUTURE else "Reading: "
            section += nodes.paragraph("", _sentence(f"{word}{row['reading']}."))
        if row["quantity"]:
            section += nodes.paragraph("", f"{_sentence(row['quantity'])}: ", nodes.strong("", value), nodes.Text("."))
        section += nodes.paragraph("", f"{_sentence(row['evidence'])}.")
        made = nodes.paragraph("", "Made by ", nodes.literal("", row["command"]), nodes.Text("."), classes=["details"])
        figure = Path(row["figure"]).stem
        if figure in self.figures(sources):
            made += [nodes.Text(" Figure: "), self.link(f"fig-{figure}", figure), nodes.Text(".")]
        section += made
        self.label(f"claim-{row['claim']}", title)
        return section


class Provenance(Block):
    """The records that `tras.workflow.runner` leaves beside executed notebooks; what several share is there once."""

    def make(self, spec, sources):
        paths = [path for path in sorted(sources.build.glob("[0-9]*.json")) if path.with_suffix(".ipynb").is_file()]
        if not paths:
            raise Lacking(f"no stage has left a record beside its executed notebook: {sources.command} runs them.")
        rows, facts = [], {}
        for stage, record in ((path.stem, lookups.record(path)) for path in paths):
            git = record.get("git") or {}
            revision = (git.get("revision") or "unknown")[:12] + (", with changes" if git.get("dirty") else "")
            started, seconds = record.get("started", "–"), number(record.get("seconds"), ".1f")
            rows.append([stage, [nodes.literal("", revision)], started, seconds])
            for name, value in _environment(record).items():
                facts.setdefault(name, {}).setdefault(str(value), []).append(stage)
        cells = []
        for name, stages in facts.items():
            differing = "; ".join(f"{value} ({', '.join(names)})" for value, names in stages.items())
            cells.append([name, differing if len(stages) > 1 else next(iter(stages))])
        stages = self.table(["stage", "git revision", "started", "seconds"], rows, spec["stages"])
        return [stages, self.table(["what", "version or value"], cells, spec["environment"], kind="prose")]


_BLOCKS = {
    "figure": Figure, "gallery": Gallery, "table": Table, "compare": Compare, "plant": Plant, "claims": Claims,
    "provenance": Provenance,
}  # fmt: skip


def _environment(record):
    """What a stage ran with, as far as its record says: name -> value."""
    facts = {name: record[name] for name in ("python", "platform", "processor") if name in record}
    facts |= {"vector instructions": ", ".join(record["instructions"])} if record.get("instructions") else {}
    facts |= {"SHA-256 of environment.txt": record["environment"]} if record.get("environment") else {}
    return facts | record.get("variables", {}) | record.get("packages", {})


def _verdict(row):
    sign, kind = _SIGNS.get(row["verdict"], ("?", "uncheckable"))
    return nodes.inline("", f"{sign} {row['verdict']}", classes=["verdict", kind])


def _sentence(text):
    return text[:1].upper() + text[1:]


def _is_number(cell):
    return isinstance(cell, str) and bool(re.fullmatch(r"[-+−]?[\d.]+(e[-+]?\d+)?( ?%)?|–|", cell))
