"""One HTML page: names of headings, text from elsewhere escaped, drawings in the smaller format."""

import re
import xml.etree.ElementTree as ElementTree

from hypothesis import given
from hypothesis import strategies as st

from tras.workflow import page

SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="252pt" height="144pt" viewBox="0 0 252 144">'
    '<rect width="200" height="100" fill="#06c" /></svg>'
)


def test_headings_that_are_alike_have_names_of_their_own():
    contents = []
    text = page.converter(None, contents)("# A\n\n## It's so\n\n## It's so\n\n### *It* is\n")
    assert contents == [(2, "its-so", "It&#x27;s so"), (2, "its-so-2", "It&#x27;s so"), (3, "it-is", "<em>It</em> is")]
    assert '<h2 id="its-so-2">' in text


@given(st.text())
def test_escaped_text_is_what_it_was(text):
    element = ElementTree.fromstring(f'<a b="{page.escape(text)}">{page.escape(text)}</a>')
    shown = re.sub(r"<U\+([0-9A-F]{4,6})>", lambda match: chr(int(match[1], 16)), element.text or "")
    assert shown == text


def test_large_drawings_are_shown_as_png(tmp_path):
    (tmp_path / "a.svg").write_text(SVG)
    (tmp_path / "a.png").touch()
    assert page.picture(tmp_path, "a").suffix == ".svg"
    (tmp_path / "a.svg").write_text(SVG + " " * 500_000)
    assert page.picture(tmp_path, "a").suffix == ".png"
    (tmp_path / "a.svg").unlink()
    assert page.picture(tmp_path, "a").suffix == ".png" and page.picture(tmp_path, "b") is None
