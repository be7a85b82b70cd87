"""One HTML page that needs no network: Markdown, formulas as MathML, tables, figures as data URIs, and their frame.

Everything that comes from outside is escaped here. The page is well-formed XML too, which is what the tests check.
"""

import base64
import html
import re
import struct
from pathlib import Path

import latex2mathml.converter
import mistune
import yaml
from mistune.plugins.math import math

from tras.workflow.arguments import visible

_LARGEST_SVG = 400_000  # bytes; a picture of many points is smaller as PNG
_NUMBER = ' class="number"'

STYLE = """\
:root { color: #1a1a1a; background: #fff; font: 1.05rem/1.6 Georgia, "DejaVu Serif", serif; }
* { box-sizing: border-box; }
body { max-width: 64rem; margin: 0 auto; padding: 1rem 1rem 4rem; overflow-wrap: break-word; }
main > *, main > article { max-width: 44rem; margin-left: auto; margin-right: auto; }
main > .scroll { width: fit-content; min-width: min(44rem, 100%); max-width: 100%; }
main > figure { width: fit-content; }
h1, h2, h3, nav, table, .verdict { font-family: system-ui, "DejaVu Sans", sans-serif; }
h1, h2, h3 { line-height: 1.25; }
h1 { font-size: 1.9rem; }
h2 { font-size: 1.45rem; margin-top: 3rem; border-bottom: 1px solid #bbb; padding-bottom: .2rem; }
h3 { font-size: 1.15rem; margin-top: 2rem; } article h3 { font-size: 1rem; margin: 0 0 .4rem; }
a { color: #0b4a8f; } a:focus-visible, .scroll:focus-visible, .equation:focus-visible { outline: 2px solid #0b4a8f; }
code { font-size: .88em; background: #f3f3f3; padding: 0 .2em; }
pre { background: #f3f3f3; padding: .7rem; white-space: pre-wrap; overflow-wrap: anywhere; }
nav { border: 1px solid #ccc; padding: .5rem 1.2rem 1rem; font-size: .95rem; }
nav h2 { margin: .5rem 0; border: 0; font-size: 1.05rem; } nav > ul { columns: 18rem 2; }
nav > ul > li { break-inside: avoid; }
nav ul { margin: .3rem 0; padding-left: 1.2rem; }
figure { margin: 1.8rem auto; } figure img { display: block; width: 100%; max-width: 36rem; height: auto; }
figcaption, caption { font: .92rem/1.45 Georgia, "DejaVu Serif", serif; text-align: left; color: #333; }
figcaption { max-width: 36rem; margin-top: .6rem; } caption { padding-bottom: .5rem; }
caption > span { display: block; position: sticky; left: 0; max-width: min(42rem, calc(100vw - 2.2rem)); }
.scroll { overflow-x: auto; margin: 1.5rem auto; }
.equation { display: flex; align-items: center; gap: 1rem; overflow-x: auto; margin: 1rem auto; padding: .2rem 0; }
.equation math { flex: 1 0 auto; }
math { font-family: "Latin Modern Math", "STIX Two Math", "Cambria Math", "Libertinus Math", "DejaVu Math TeX Gyre",
math; font-size: 1.08em; }
table { border-collapse: collapse; font-size: .85rem; line-height: 1.4; }
th, td { text-align: left; vertical-align: top; padding: .3rem .6rem; border-bottom: 1px solid #ddd; }
thead th { border-bottom: 2px solid #555; vertical-align: bottom; } tbody th { font-weight: 600; }
.numbers td { white-space: nowrap; } .numbers .number { text-align: right; font-variant-numeric: tabular-nums; }
.numbers th[scope="row"] { min-width: 5.5rem; }
.verdict { display: inline-block; font-weight: bold; font-size: .88rem; line-height: 1.3; padding: .1rem .5rem;
border: 2px solid; background: #fff; }
.reproduced { color: #0a5c36; } .named { color: #6b4a00; border-style: dashed; }
.not { color: #8c1515; border-style: double; border-width: 4px; }
.uncheckable { color: #444; border-style: dotted; }
article { border-left: 3px solid #bbb; padding: .1rem 0 .1rem 1rem; margin: 1.6rem auto; }
article p { margin: .35rem 0; }
@media print {
  * { box-sizing: border-box; }
:root { font-size: 10pt; } body { max-width: none; padding: 0; } .scroll, .equation { overflow: visible; }
  th[scope="row"] { min-width: 0 !important; }
  table { font-size: 7pt; } th, td { padding: .15rem .3rem; white-space: normal !important; }
  figure img { max-width: 28rem; } nav { display: none; }
  figure, article, tr { break-inside: avoid; } h2, h3, caption { break-after: avoid; } a { color: inherit; }
}
"""


def escape(text) -> str:
    """Text for an element or an attribute, without what nobody sees and no XML may hold (`arguments.visible`)."""
    return html.escape(visible(text))


def formula(tex: str, *, display: bool = False) -> str:
    r"""A formula as MathML; ``\tag{7}`` at the end of a displayed one puts the number to its right.

    >>> formula("x^2").partition(">")[2]
    '<mrow><msup><mi>x</mi><mn>2</mn></msup></mrow></math>'
    """
    tex, tag = re.fullmatch(r"(?s)\s*(.*?)\s*(?:\\tag\{([^}]*)\})?\s*", tex).groups()
    mathml = latex2mathml.converter.convert(tex, display="block" if display else "inline")
    if not display:
        return mathml
    number = f"<span>({escape(tag)})</span>" if tag else ""
    return f'<div class="equation" tabindex="0">{mathml}{number}</div>\n'


def table(head: list, rows: list, caption: str, *, keys: int = 1, kind: str = "numbers") -> str:
    """A table whose first ``keys`` columns name the row; cells are HTML already, the caption too.

    ``kind`` is "numbers" (columns of numbers stand to the right, no cell is broken), or "short" for text.
    """
    styles = [""] * len(head)
    if kind == "numbers" and rows:
        styles[keys:] = [_NUMBER if all(map(_is_number, column)) else "" for column in list(zip(*rows))[keys:]]
    titles = "".join(f'<th scope="col"{style}>{name}</th>' for name, style in zip(head, styles))
    body = []
    for row in rows:
        cells = [f'<th scope="row">{cell}</th>' for cell in row[:keys]]
        cells += [f"<td{style}>{cell}</td>" for cell, style in zip(row[keys:], styles[keys:])]
        body.append(f"<tr>{''.join(cells)}</tr>")
    label = escape(_plain(caption))
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{label}"><table class="{kind}">'
        f"<caption><span>{caption}</span></caption>\n<thead><tr>{titles}</tr></thead>\n<tbody>\n"
        + "\n".join(body)
        + "\n</tbody></table></div>\n"
    )


def figure(path: Path, alt: str, caption: str, identity: str) -> str:
    """A figure from a file ``path`` (.svg or .png), inside the page; ``caption`` is HTML, the others are text.

    A ValueError if the file is no picture of its kind.
    """
    content = path.read_bytes()
    width, height = _size(path, content)
    kind = {".svg": "svg+xml", ".png": "png"}[path.suffix]
    data = base64.b64encode(content).decode()
    size = f'width="{width:.0f}" height="{height:.0f}"'
    image = f'<img src="data:image/{kind};base64,{data}" {size} alt="{escape(alt)}" />'
    return f'<figure id="{escape(identity)}">{image}\n<figcaption>{caption}</figcaption></figure>\n'


def picture(folder: Path, name: str) -> Path | None:
    """The file that shows the figure ``name`` best: its SVG, or its PNG where the SVG is missing or large; or None."""
    svg, png = folder / f"{name}.svg", folder / f"{name}.png"
    if svg.is_file() and (svg.stat().st_size <= _LARGEST_SVG or not png.is_file()):
        return svg
    return png if png.is_file() else None


def converter(block, contents: list):
    """A function from Markdown to HTML.

    ``block`` turns the kind of a fenced block and a dictionary, from the YAML in it, to HTML. Headings of levels 2 and
    3 are appended to the list ``contents``: (level, identity, HTML).
    """

    class Renderer(mistune.HTMLRenderer):
        def text(self, text):
            return escape(text)

        def heading(self, text, level, **_):
            identities = [identity for _, identity, _ in contents]
            plain = _plain(text).lower().replace("'", "")
            base = identity = re.sub(r"[^a-z0-9]+", "-", plain).strip("-") or "part"
            while identity in identities:
                identity = f"{base}-{sum(name.startswith(base) for name in identities) + 1}"
            if level in (2, 3):
                contents.append((level, identity, text))
            return f'<h{level} id="{identity}">{text}</h{level}>\n'

        def inline_math(self, text):
            return formula(text)

        def block_math(self, text):
            return formula(text, display=True)

        def block_code(self, code, info=None):
            return block(info.strip(), yaml.safe_load(code) or {}) if info else super().block_code(code)

    return mistune.Markdown(Renderer(escape=True), plugins=[math])


def inline(convert, text) -> str:
    """Markdown of one line, without the paragraph round it."""
    return re.sub(r"^<p>(.*)</p>\s*$", r"\1", convert(" ".join(str(text).split())), flags=re.DOTALL)


def frame(title: str, body: str, contents: list) -> str:
    """The whole page: ``title`` is text, ``body`` HTML with an h2 somewhere, ``contents`` as from `converter`."""
    first, rest = re.split("(?=<h2)", body, maxsplit=1)
    chapters = []
    for level, identity, text in contents:
        link = f'<a href="#{identity}">{text}</a>'
        if level == 2 or not chapters:
            chapters.append((link, []))
        else:
            chapters[-1][1].append(f"<li>{link}</li>")
    lists = [(link, f"<ul>{''.join(parts)}</ul>" if parts else "") for link, parts in chapters]
    items = "\n".join(f"<li>{link}{parts}</li>" for link, parts in lists)
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    return (
        '<!DOCTYPE html>\n<html xmlns="http://www.w3.org/1999/xhtml" lang="en">\n<head>\n<meta charset="utf-8" />\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1" />\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}" />\n'
        f'<title>{escape(title)}</title>\n<link rel="icon" href="data:," />\n<style>\n{STYLE}</style>\n'
        f'</head>\n<body>\n<main>\n{first}<nav aria-label="Contents">\n<h2>Contents</h2>\n<ul>\n{items}\n</ul>\n'
        f"</nav>\n{rest}</main>\n</body>\n</html>\n"
    )


def _plain(markup):
    """The text of HTML without its tags."""
    return html.unescape(re.sub("<[^>]*>", "", markup))


def _is_number(cell):
    return bool(re.fullmatch(r"[-+−]?[\d.]+(e[-+]?\d+)?( ?%)?|–|", cell))


def _size(path, content):
    """Width and height in pixels of the page."""
    if path.suffix == ".png" and content[:8] == b"\x89PNG\r\n\x1a\n" and len(content) > 24:
        return struct.unpack(">II", content[16:24])
    box = re.search(rb'viewBox="[-\d.]+ [-\d.]+ ([\d.]+) ([\d.]+)"', content[:5000]) if path.suffix == ".svg" else None
    if not box:
        raise ValueError(f"{path} is no {path.suffix[1:].upper()} file: delete it, and make all makes it anew.")
    return tuple(float(number) * 4 / 3 for number in box.groups())  # points to pixels
