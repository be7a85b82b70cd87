"""Lookups: numbers from tables, text that Markdown cannot break out of, and what is missing said in a sentence."""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pandas as pd
import pytest

from tras.paper import claims, lookups
from tras.paper.lookups import Lacking, Sources
from tras.workflow import page

CLAIMS = {"HIGH_BFR": claims.HIGH_BFR}


def write(path, columns, rows):
    pd.DataFrame(rows, columns=columns.split()).to_csv(path, index=False, float_format="%.10g", lineterminator="\n")


LOOKUPS = [
    ('value("data/x.csv", "v", k="a") | number(".2f")', "1.50"),
    ('value("data/x.csv", "v", n=2) | number(".3g")', "2.5"),
    ('value("data/x.csv", "max(v)")', "4"),
    ('value("data/x.csv", "median(v)", t="two words", k="b") | number("#.3g")', "3.25"),
    ('value("data/x.csv", "count(v)", k="none")', "0"),
    ('value("data/x.csv", "sum(v)") | number("d")', "8"),
    ('value("data/x.csv", "largest(s)")', "3"),
    ('value("data/x.csv", "count(v)", n=">1")', "2"),
    ('value("data/x.csv", "k", n=3)', "b"),
    ('value("data/x.csv", "e", n=1)', "–"),
    ('value("data/x.csv", "max(v)", n="<3")', "2.5"),
    ('value("data/x.csv", "sum(v)", n=[1, 3])', "5.5"),
    ('value("data/x.csv", "count(v)", t=["one", "none"])', "1"),
    ('value("data/x.csv", "t at min(s)")', "two words"),
    ('value("data/x.csv", "n at max(v)", k="b") | number("d")', "3"),
    ('(value("data/x.csv", "max(v)") / value("data/x.csv", "min(s)", n=2)) | number(".2f")', "-1.33"),
    ('parameter("01_stage", "duration") | number("g")', "500"),
    ('claims.HIGH_BFR | number("g")', "90"),
]
REFUSED = [
    ('value("data/x.csv", "v", k="b")', Lacking, "data/x.csv has 2 rows for one number, `v`"),
    ('value("data/x.csv", "v", k="c")', Lacking, "has 0 rows"),
    ('value("data/x.csv", "w")', Lacking, "no column `w`"),
    ('value("data/x.csv", "v", w=1)', Lacking, "no column `w`"),
    ('value("data/y.csv", "v")', Lacking, "data/y.csv is not there: `make all` makes it"),
    ('parameter("01_stage", "durration")', Lacking, "01_stage has no parameter `durration`"),
    ('value("data/x.csv", "k at min(e)")', Lacking, "data/x.csv has 3 rows for one number, `k at min(e)`"),
    ('1 / value("data/x.csv", "count(e)")', ValueError, "a lookup is not understood (division by zero)"),
    ("nonsense", ValueError, "a lookup is not understood ('nonsense' is undefined)"),
    ("claims.HIGH_BFT", ValueError, "no attribute 'HIGH_BFT'"),
    ("value(", ValueError, "a lookup is not understood"),
    ("value()", ValueError, "a lookup is not understood"),
    ('value("data/x.csv", "v", n=2) | number("z!")', ValueError, "Unknown format code"),
]


@pytest.fixture
def small(tmp_path):
    for name in ("data", "figures", "paper"):
        (tmp_path / name).mkdir()
    rows = [("a", 1, "one", 1.5, None, 2), ("b", 2, "two words", 2.5, None, -3), ("b", 3, "two words", 4, None, 1)]
    write(tmp_path / "data" / "x.csv", "k n t v e s", rows)
    (tmp_path / "paper" / "01_stage.json").write_text(json.dumps({"parameters": {"duration": 500.0}}))
    return Sources(tmp_path / "data", tmp_path / "figures", tmp_path / "paper")


@pytest.mark.parametrize("text, expected", LOOKUPS)
def test_lookups(small, text, expected):
    assert lookups.render(f"a {{{{ {text} }}}} b\n", small, claims=CLAIMS) == f"a {expected} b\n"


@pytest.mark.parametrize("text, error, message", REFUSED)
def test_lookups_that_find_nothing(small, text, error, message):
    with pytest.raises(error) as caught:
        lookups.render(f"{{{{ {text} }}}}", small, claims=CLAIMS)
    assert message in str(caught.value)


CONCLUSIONS = """
* **Larger.** {% if x("max(v)") > limit %}It is {{ x("max(v)") }}{% else %}It is not{% endif %},
  over {{ x("count(v)") | number("d") }} rows.
* Both: {{ angles.pair("e", spec=".1f") }} %.
* Lacking: {{ x("v", k="c") }}.
"""


def test_conclusions_follow_the_tables(small):
    write(small.data / "angles.csv", "angle e", [("yaw", 1), ("pitch", 0.25)])
    tables = {"x": "data/x.csv", "angles": "data/angles.csv"}
    first, *rest = lookups.conclusions(CONCLUSIONS, small, tables, limit=3).splitlines()
    assert first == "* **Larger.** It is 4, over 3 rows."
    assert rest == [
        "* Both: 1.0 / 0.2 %.",
        "* *Nothing to conclude here:* data/x.csv has 0 rows for one number, `v`: was it made with other parameters?",
    ]
    assert lookups.conclusions(CONCLUSIONS, small, tables, limit=4).startswith("* **Larger.** It is not, over")
    with pytest.raises(ValueError, match="'limit' is undefined"):
        lookups.conclusions(CONCLUSIONS, small, tables)


def test_the_command_names_the_profile(small):
    with pytest.raises(Lacking, match="`make all PROFILE=smoke` makes it"):
        lookups.render('{{ value("data/y.csv", "v") }}', small._replace(build=Path("build/smoke")))


def test_what_is_looked_up_is_text_and_formulas_stay(small):
    write(small.data / "z.csv", "k", [("**a** <b> `c` $d$ {{ e }}",)])
    html = page.converter(None, [])(lookups.render('$\\frac{{a}}{{b}}$ {{ value("data/z.csv", "k") }}', small))
    assert "".join(ElementTree.fromstring(html).itertext()).rstrip().endswith("**a** <b> `c` $d$ {{ e }}")
    assert html.count("<math") == 1 and "<mfrac>" in html
