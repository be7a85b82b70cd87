"""The report: nothing from the network, formulas as MathML, numbers from tables, text escaped; and in a browser."""

import itertools
import json
import re
import shutil
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tras.paper import claims, errata, lookups, report, tables
from tras.paper.lookups import Lacking, Sources
from tras.workflow import files, page

STORY = (files.project_root() / "docs" / "report.md").read_text(encoding="utf-8")
DRAWN = re.findall(r"^name: (\w+)$", STORY, re.MULTILINE)
SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="252pt" height="144pt" viewBox="0 0 252 144">'
    '<rect width="200" height="100" fill="#06c" /></svg>'
)
HOSTILE = '<script>alert(1)</script> & "quotes" \x07 $x$ {{ data/claims.csv: claim }} **bold**'
SHOWN_HOSTILE = HOSTILE.replace("\x07", "\ufffd")
NS = "{http://www.w3.org/1999/xhtml}"
MATH = "{http://www.w3.org/1998/Math/MathML}"


def write(path, columns, rows):
    pd.DataFrame(rows, columns=columns.split()).to_csv(path, index=False, float_format="%.10g", lineterminator="\n")


def paper_tables(root, rng):
    """What 02 to 04 write, as far as the report reads it; returns the metrics."""
    models, rows = [source for source in tables.COLUMNS if source[0] != "paper"], []
    for kind, horizon in (("window", 6), ("free run", 500)):
        for source, recording, angle in itertools.product(models, ("multisine 2", "multisine 3"), ("yaw", "pitch")):
            scores = (rng.uniform(0, 0.1), rng.uniform(90, 99), rng.uniform(1, 9))
            rows.append((kind, horizon, *source, recording, angle, 83, 0, *scores))
    columns = "kind horizon input model recording angle windows diverged enr bfr nrmse"
    metrics = pd.DataFrame(rows, columns=columns.split())
    columns = "input model N pairs condition spectral_radius disagreement_phidot"
    rows = [(*model, 7 + n, 40000, 50.4 + n, 1 + n / 1000, 0.01 + n) for n, model in enumerate(models)]
    write(root / "data" / "identification.csv", columns, rows)
    identification = pd.read_csv(root / "data" / "identification.csv")
    tables.comparison(metrics, identification).to_csv(root / "figures" / "table.csv", index=False)
    return metrics


def study_tables(root, rng):
    """What the studies write, small."""
    data, figures = root / "data", root / "figures"
    cases = list(itertools.product((0.0, 1.0), (1, 2), ("plain", "refined")))
    cases = [case for case in cases if case[0] or case[2] == "plain"]
    rows = [(*case, angle, rng.uniform(), 0, "") for case in cases for angle in ("yaw", "pitch")]
    rows[-1] = (*rows[-1][:4], np.nan, 0, "logarithm")
    write(data / "robustness_noise.csv", "noise seed method angle nrmse diverged failure", rows)
    rows = [(t, "mechanical", "vector_field", "yaw", t) for t in (0.01, 0.2)]
    write(data / "robustness_sampling.csv", "sampling_time dictionary predictor angle nrmse", rows)
    rows = [("plain", "linear", 7, noise, r, 1 / r, 0.25, noise) for noise in (0, 1) for r in (1.05, 200.0)]
    write(data / "robustness_length.csv", "fit dictionary functions noise ratio failed no_logarithm dependent", rows)
    rows = [("linear", 0.1, 1, False), ("linear", 0.4, 1, True), ("linear", 0, 0, False)]
    write(data / "residuals.csv", "model relative residual spurious", rows)
    rows = [("J", noise, 1, 1, 0.9, 1.1, error) for noise, error in [(0, 0.5), (0, -0.75), (1, 2.0)]]
    write(data / "parameters.csv", "parameter noise true value low high error", rows)
    rows = [("Lorenz", 1, "lifting", 20, 300, 1 / 30, 3.3)]
    write(data / "benchmark_systems.csv", "system noise method functions pairs sampling_time coefficient_error", rows)
    options = "input frequency_unit dictionary state horizon nrmse_range velocity_term angle_names"
    rows = [(*["x"] * 7, names, 4.0, 5.0, 0.123) for names in ("words", "symbols")]
    write(figures / "readings_nearest.csv", f"{options} yaw pitch distance", rows)
    cases = list(itertools.product(("DMDc", "Koopman, the paper's"), ("reference", "torque"), ("yaw", "pitch")))
    rows = [(*case, 6, 1 + i / 8) for i, case in enumerate(cases)]
    write(figures / "comparison_pareto.csv", "method input angle horizon nrmse", rows)
    rows = [("true", "pitch", 0), ("Gaussian RBF", "pitch", 0.25), ("Gaussian RBF", "pitch", 0.75)]
    write(figures / "portrait.csv", "model plane error", rows)


def claim_rows():
    """One claim of each verdict; the last is hostile."""
    row = {
        "statement": "it is so", "quantity": "an error (%)", "value": 1.2345678, "low": 1, "high": 2,
        "reading": "default", "evidence": "5 of 7", "figure": "figures/horizon.png", "command": "make all",
    }  # fmt: skip
    rows = [row | {"claim": f"C{i}", "verdict": verdict} for i, verdict in enumerate(claims.VERDICTS, 1)]
    rows[-1] |= dict.fromkeys(("statement", "evidence"), HOSTILE)
    rows[-1] |= dict.fromkeys(("quantity", "value", "low", "high", "figure", "reading"), "")
    return rows


def stage(root, name, **parameters):
    record = {
        "parameters": parameters, "git": {"revision": "a" * 40, "dirty": False}, "python": "3.11.2",
        "packages": {"numpy": "2.4.6"}, "platform": "Linux <x>", "processor": "a processor",
        "instructions": ["avx", "fma"], "environment": "b" * 64, "variables": {"OMP_NUM_THREADS": "1"},
        "started": "2026-01-02T03:04:05+00:00", "seconds": 1.25,
    }  # fmt: skip
    (root / "paper" / f"{name}.json").write_text(json.dumps(record))
    (root / "paper" / f"{name}.ipynb").touch()


@pytest.fixture(autouse=True, scope="module")
def few_errors():
    """The cheap ones; tests/test_errata.py computes them all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(errata, "ERRORS", tuple(errata.ERRORS[i] for i in (5, 9, 10, 11)))
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with everything that the report can show, and the metrics behind its table."""
    root, rng = tmp_path_factory.mktemp("whole"), np.random.default_rng(0)
    for name in ("data", "figures", "paper"):
        (root / name).mkdir()
    metrics = paper_tables(root, rng)
    study_tables(root, rng)
    write(root / "data" / "claims.csv", " ".join(claims.COLUMNS), claim_rows())
    for name in DRAWN:
        (root / "figures" / f"{name}.svg").write_text(SVG)
    signals = {"pitch_max_frequency": 0.2, "pitch_peak": 1.22173, "yaw_max_frequency": 0.8, "yaw_peak": 3.14159}
    stage(root, "01_data_generation", duration=500.0, sampling_time=0.01, **signals)
    stage(root, "02_identification")
    return root, metrics


@pytest.fixture
def copy(whole, tmp_path):
    return Path(shutil.copytree(whole[0], tmp_path / "copy"))


def sources(root):
    return Sources(root / "data", root / "figures", root / "paper")


@pytest.fixture(scope="module")
def shown(whole):
    text, lacking = report.report(STORY, sources(whole[0]))
    assert lacking == []
    return text


@pytest.fixture(scope="module")
def tree(shown):
    return parsed(shown)


def parsed(text):
    """The page as XML."""
    return ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>\n"))


def run(root, *more):
    folders = [f"--{option}={root / name}" for option, name in zip(sources(root)._fields, ("data", "figures", "paper"))]
    return report.main([str(root / "report.html"), *folders, *more]), root / "report.html"


def text_of(element):
    return " ".join("".join(element.itertext()).split())


def by_id(tree, identity):
    return next(element for element in tree.iter() if element.get("id") == identity)


def after(tree, identity, tag):
    """The first element of a kind after the heading with this id."""
    body = list(tree.iter())
    return next(element for element in body[body.index(by_id(tree, identity)) :] if element.tag == NS + tag)


def cells(table):
    return [[text_of(cell) for cell in row] for row in table.iter(NS + "tr")]


# --- the page ---------------------------------------------------------------------------------------------------------


def test_nothing_is_loaded_from_elsewhere(shown):
    links = []

    class Parser(HTMLParser):
        def handle_starttag(self, tag, attributes):
            assert tag not in ("script", "iframe", "object", "embed", "base")
            for name, value in attributes:
                assert not name.startswith("on"), name
                if name in ("src", "href", "srcset", "data", "poster"):
                    links.append((tag, name, value))

    Parser().feed(shown)
    assert sum(tag == "img" for tag, _, _ in links) == len(DRAWN)
    for tag, name, value in links:
        assert value.startswith("data:") or tag == "a" and value.startswith(("#", "https://")), (tag, name, value[:60])
    assert not re.search(r"url\(|@import", page.STYLE)


def test_formulas_are_mathml(shown, tree):
    """Browsers draw an element with a wrong number of parts as an error, or in a row."""
    formulas = list(tree.iter(MATH + "math"))
    inline, displayed = re.subn(r"\$\$[^$]+\$\$", "", STORY)
    assert len(formulas) >= displayed + len(re.findall(r"\$[^$\n]+\$", inline)) > 40
    parts = dict.fromkeys(("msup", "msub", "mover", "munder", "mfrac", "mroot"), 2)
    parts |= dict.fromkeys(("msubsup", "munderover"), 3)
    for formula in formulas:
        for element in formula.iter():
            number = parts.get(element.tag.removeprefix(MATH), len(element))
            assert len(element) == number, ElementTree.tostring(formula, "unicode")
    left = text_of(tree.find(f"{NS}body/{NS}main")).replace(SHOWN_HOSTILE, "")  # what a file holds is shown as it is
    assert "$" not in left and not re.search(r"\\[a-zA-Z]|\{\{|\}\}", left)
    for number in ("(7)", "(14)", "(15)", "(18)", "(19)", "(20)", "(21)"):
        assert f"<span>{number}</span>" in shown


def test_every_claim_stands_there_with_its_verdict_in_words(tree):
    overview = cells(after(tree, "verdicts", "table"))
    for row, line in zip(claim_rows(), overview[1:], strict=True):
        article = by_id(tree, f"claim-{row['claim']}")
        expected = row["statement"] if row["statement"] != HOSTILE else SHOWN_HOSTILE
        for text in (text_of(article), " ".join(line)):
            assert expected in text and re.search(rf"[✓◐✗?◑] {row['verdict']}", text), text
    assert "1.235 (1 to 2)" in text_of(by_id(tree, "claim-C1")) and "5 of 7" in text_of(by_id(tree, "claim-C1"))
    counts = "reproduced 1, reproduced only under a named reading of the text 1, holding in part 1, not reproduced 1"
    assert f"Of 5: {counts}, not checkable 1." in text_of(after(tree, "verdicts", "caption"))


def test_the_table_paper_against_ours_is_that_of_tables(whole, tree):
    lines = tables.markdown(tables.read(whole[0] / "figures" / "table.csv")).splitlines()
    expected = [line[2:-2].split(" | ") for line in lines if "---" not in line]
    assert cells(after(tree, "paper-against-ours", "table")) == expected


def test_numbers_in_sentences_are_those_of_the_metrics(whole, tree):
    """Medians computed here a second time from what `tables.comparison` was given."""
    medians = whole[1][whole[1]["kind"] == "window"].groupby(["input", "model", "angle"])["nrmse"].median()
    points = [text_of(point) for point in after(tree, "in-short", "ul")]
    pairs = [(source, model) for source in ("reference", "torque") for model in ("gaussian", "linear")]
    pairs = (pairs[:2], pairs[2:], [("torque", "mechanical")])
    for point, models, digits in zip(points, pairs, (3, 3, 2), strict=True):
        expected = [medians[*model, angle] for model in models for angle in ("yaw", "pitch")]
        assert re.findall(r"([\d.]+) %", point) == [f"{value:#.{digits}g}" for value in expected]
    assert "4.0589 % for yaw and 5.5889 % for pitch" in text_of(tree)
    assert "0.2 rad/s and 1.222 rad in pitch, 0.8 rad/s and 3.142 rad in yaw" in text_of(tree)


def test_summaries_of_studies(whole, tree):
    noise = pd.read_csv(whole[0] / "data" / "robustness_noise.csv")
    head, *rows = cells(after(tree, "measurement-noise", "table"))
    assert head == ["angle", "fit", "noise 0 %", "noise 1 %"]
    for angle, method, *values in rows:
        for level, value in zip((0, 1), values, strict=True):
            same = (noise["angle"] == angle) & (noise["method"] == method) & (noise["noise"] == level)
            median = noise[same]["nrmse"].median()
            assert value == ("–" if np.isnan(median) else f"{median:#.3g}")
    assert len(rows) == 4
    assert cells(after(tree, "length-of-the-data", "table"))[1] == ["0", "linear", "7", "95%", "0%"]
    assert "0.75 %, with noise of 1 % 2 %" in text_of(after(tree, "the-rigs-parameters", "p"))
    assert "without noise 25% of the stretches" in text_of(after(tree, "length-of-the-data", "p"))
    assert cells(after(tree, "eigenpairs", "table"))[1] == ["linear", "2", "1", "0.25"]
    methods = cells(after(tree, "other-methods", "table"))
    assert methods[0] == ["method", "angle", "reference", "torque"] and methods[1] == ["DMDc", "yaw", "1", "1.25"]
    said = text_of(after(tree, "other-methods", "p"))
    assert "input DMDc has the smallest error in yaw and DMDc in pitch, with the references DMDc and" in said
    assert "Over 6 s the paper's" in said
    assert "1.75 / 1.88 % (yaw / pitch, torques), the linear DMDc 1.25 / 1.38 %" in said
    assert cells(after(tree, "one-model-seen", "table"))[1:] == [["pitch", "Gaussian RBF", "0.5", "0.75"]]
    nearest = cells(after(tree, "the-readings-nearest-to-the-paper", "table"))[1]
    assert nearest[-4:] == ["words", "4.00", "5.00", "0.123"]


def test_provenance_is_that_of_the_records(tree):
    row = cells(after(tree, "where-the-numbers-come-from", "table"))[1]
    assert row == ["01_data_generation", "a" * 12, "2026-01-02T03:04:05+00:00", "1.2"]
    assert "Linux <x>" in text_of(tree) and "avx, fma" in text_of(tree)


def test_a_record_without_its_notebook_is_no_run(copy):
    (copy / "paper" / "02_identification.ipynb").unlink()
    tree = parsed(report.report(STORY, sources(copy))[0])
    assert len(cells(after(tree, "where-the-numbers-come-from", "table"))) == 2


def test_headings_that_are_alike_have_names_of_their_own():
    contents = []
    text = page.converter(None, contents)("# A\n\n## It's so\n\n## It's so\n\n### *It* is\n")
    assert contents == [(2, "its-so", "It&#x27;s so"), (2, "its-so-2", "It&#x27;s so"), (3, "it-is", "<em>It</em> is")]
    assert '<h2 id="its-so-2">' in text


def test_the_page_can_be_walked_and_read_aloud(tree):
    identities = [element.get("id") for element in tree.iter() if element.get("id")]
    assert len(identities) == len(set(identities))
    links = [a.get("href") for a in tree.iter(NS + "a")]
    assert {link[1:] for link in links if link.startswith("#")} <= set(identities)
    headings = [int(element.tag[-1]) for element in tree.iter() if re.fullmatch(NS + "h[1-6]", element.tag)]
    assert headings.count(1) == 1 and headings[0] == 1 and all(b - a <= 1 for a, b in zip(headings, headings[1:]))
    assert len(tree.findall(f".//{NS}nav//{NS}li")) == len(re.findall("^##", STORY, re.MULTILINE))
    assert tree.get("lang") == "en"
    for image in tree.iter(NS + "img"):
        assert len(image.get("alt")) > 30 and int(image.get("width")) == 336 and int(image.get("height")) == 192
    for table in tree.iter(NS + "table"):
        assert text_of(table.find(NS + "caption"))
        head = list(table.find(f"{NS}thead/{NS}tr"))
        assert all(cell.get("scope") == ("col" if cell in head else "row") for cell in table.iter(NS + "th"))


# --- what can be wrong ------------------------------------------------------------------------------------------------


def test_what_comes_from_files_is_text(shown, tree):
    assert "<script" not in shown and "<b>" not in shown
    text = text_of(by_id(tree, "claim-C5"))
    assert text.count("<script>alert(1)</script>") == 2
    assert "**bold**" in text and "{{ data/claims.csv: claim }}" in text


@given(st.text())
def test_escaped_text_is_what_it_was(text):
    element = ElementTree.fromstring(f'<a b="{page.escape(text)}">{page.escape(text)}</a>'.encode("utf-8", "replace"))
    expected = re.sub("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]", "\ufffd", text).encode("utf-8", "replace").decode()
    assert (element.text or "") == expected.replace("\r\n", "\n").replace("\r", "\n")


@pytest.mark.parametrize("name, heading", [
    ("data/claims.csv", "Verdicts"),
    ("figures/table.csv", "In short"),
    ("figures/robustness_noise.svg", "Measurement noise"),
    ("data/robustness_sampling.csv", "Sampling time"),
    ("data/parameters.csv", "The rig's parameters"),
    ("figures/horizon.svg", "How the error grows"),
    ("build/01_data_generation.json", "The experiment"),
])  # fmt: skip
@pytest.mark.slow
def test_a_missing_file_is_one_sentence(copy, capsys, name, heading):
    (copy / name.replace("build/", "paper/")).unlink()
    code, written = run(copy)
    output = capsys.readouterr()
    assert code == 0 and "Traceback" not in output.err
    assert f"not shown: {name} is not there: `make all` makes it." in output.err
    text = written.read_text(encoding="utf-8")
    section = text.split(f">{page.escape(heading)}</h")[-1].split("<h2")[0].split("<h3")[0]
    sentence = text_of(ElementTree.fromstring(re.search('<p class="lacking">.*?</p>', section)[0]))
    assert sentence == f"This part is not shown: {name} is not there: make all makes it."
    assert "The logarithm" in text and "figcaption" in text
    tree = parsed(text)
    assert {a.get("href")[1:] for a in tree.iter(NS + "a")} <= {element.get("id") for element in tree.iter()}


DAMAGED = [
    ("data/claims.csv", "claim\nC1\n", "is not the table of claims: delete it"),
    ("data/identification.csv", "\0\0", "identification.csv"),
    ("figures/table.csv", "kind\nwindow\n", "table.csv is not the table paper against ours: delete it"),
    ("figures/fig1_rig.svg", "no picture", "fig1_rig.svg is no SVG file: delete it"),
    ("paper/02_identification.json", "{", "02_identification.json is no record of a run: delete it"),
]


@pytest.mark.parametrize("name, content, message", DAMAGED, ids=[name for name, _, _ in DAMAGED])
def test_a_damaged_file_is_named(copy, capsys, name, content, message):
    (copy / "report.html").write_text("the page before")
    (copy / name).write_text(content)
    code, written = run(copy)
    error = capsys.readouterr().err
    assert message in error and "Traceback" not in error
    if code:
        assert code == 1 and len(error.splitlines()) == 1
        assert written.read_text() == "the page before" and not list(copy.glob(".report*"))


def test_missing_folders_and_places_to_write(copy, capsys):
    shutil.rmtree(copy / "data")
    assert run(copy)[0] == 2
    assert "data does not exist; `make all` makes" in capsys.readouterr().err
    assert run(copy, f"--data={copy / 'figures'}", f"--story={copy / 'none.md'}")[0] == 2
    (copy / "report.html").mkdir()
    assert run(copy, f"--data={copy / 'figures'}")[0] == 1
    assert "report.html could not be written" in capsys.readouterr().err and not list(copy.glob(".report*"))


def test_the_same_inputs_give_the_same_bytes(whole, shown, capsys):
    code, written = run(whole[0])
    assert code == 0 and written.read_text(encoding="utf-8") == shown
    assert str(written) in capsys.readouterr().out


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
    stage(tmp_path, "01_stage", duration=500.0)
    return sources(tmp_path)


@pytest.mark.parametrize("text, expected", LOOKUPS)
def test_lookups(small, text, expected):
    assert lookups.render(f"a {{{{ {text} }}}} b\n", small, claims=report._LIMITS) == f"a {expected} b\n"


@pytest.mark.parametrize("text, error, message", REFUSED)
def test_lookups_that_find_nothing(small, text, error, message):
    with pytest.raises(error) as caught:
        lookups.render(f"{{{{ {text} }}}}", small, claims=report._LIMITS)
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


def test_large_drawings_are_shown_as_png(tmp_path):
    (tmp_path / "a.svg").write_text(SVG)
    (tmp_path / "a.png").touch()
    assert page.picture(tmp_path, "a").suffix == ".svg"
    (tmp_path / "a.svg").write_text(SVG + " " * 500_000)
    assert page.picture(tmp_path, "a").suffix == ".png"
    (tmp_path / "a.svg").unlink()
    assert page.picture(tmp_path, "a").suffix == ".png" and page.picture(tmp_path, "b") is None


def test_the_command_names_the_profile(small):
    with pytest.raises(Lacking, match="`make all PROFILE=smoke` makes it"):
        lookups.render('{{ value("data/y.csv", "v") }}', small._replace(build=Path("build/smoke")))


def test_what_is_looked_up_is_text_and_formulas_stay(small):
    write(small.data / "z.csv", "k", [("**a** <b> `c` $d$ {{ e }}",)])
    html = page.converter(None, [])(lookups.render('$\\frac{{a}}{{b}}$ {{ value("data/z.csv", "k") }}', small))
    assert text_of(ElementTree.fromstring(html)).endswith("**a** <b> `c` $d$ {{ e }}")
    assert html.count("<math") == 1 and "<mfrac>" in html


# --- in a browser -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [390, 1200])
def test_in_a_browser_without_network(browser, whole, shown, width):
    written = whole[0] / "browser.html"
    written.write_text(shown, encoding="utf-8")
    context = browser.new_context(viewport={"width": width, "height": 844}, offline=True)
    opened, requested, complaints = context.new_page(), [], []
    opened.on("request", lambda request: requested.append(request.url))
    opened.on("console", lambda message: complaints.append(message.text))
    opened.on("pageerror", lambda error: complaints.append(str(error)))
    opened.goto(written.as_uri())
    assert [url for url in requested if not url.startswith("data:")] == [written.as_uri()] and complaints == []
    assert opened.evaluate("[...document.images].filter(i => !(i.complete && i.naturalWidth > 0)).length") == 0
    drawn = opened.evaluate("[...document.images].map(i => i.getBoundingClientRect().width)")
    # Wider than they are, as wide as there is room.
    assert len(drawn) == len(DRAWN) and all(340 < size <= width for size in drawn)
    heights = opened.evaluate("[...document.querySelectorAll('math')].map(m => m.getBoundingClientRect().height)")
    assert len(heights) > 40 and min(heights) > 5
    fraction, part = (
        opened.evaluate(f"document.querySelector('{element}').getBoundingClientRect().height")
        for element in ("mfrac", "mfrac mi, mfrac mn")
    )
    assert fraction > 1.5 * part  # drawn one above the other, not in a row
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    context.close()
