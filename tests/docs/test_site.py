"""The site: no warning, links that lead somewhere, numbers from tables, text escaped; and in a browser."""

import doctest
import io
import itertools
import json
import re
import shutil
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bs4 import BeautifulSoup
from conftest import ROOT
from PIL import Image
from sphinx.application import Sphinx
from sphinx.util.docutils import docutils_namespace, patch_docutils

import tras
from tras.paper import claims, tables
from tras.paper.lookups import Sources

sys.path.insert(0, str(ROOT / "docs"))
import blocks  # noqa: E402
import make_site  # noqa: E402

PAGES = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")}
DRAWN = re.findall(r"^name: (\w+)$", "".join(PAGES.values()), re.MULTILINE)
SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="252pt" height="144pt" viewBox="0 0 252 144">'
    '<rect width="200" height="100" fill="#06c" /></svg>'
)
HOSTILE = '<script>alert(1)</script> & "quotes" $x$ {{ data/claims.csv: claim }} **bold** `code`'
MATH = "{http://www.w3.org/1998/Math/MathML}"


def write(path, columns, rows):
    pd.DataFrame(rows, columns=columns.split()).to_csv(path, index=False, float_format="%.10g", lineterminator="\n")


def paper_tables(root, rng):
    """What 02 to 04 write, as far as the site reads it; returns the metrics."""
    models, rows = [source for source in tables.COLUMNS if source[0] != "paper"], []
    for kind, horizon in (("window", 6), ("free run", 500)):
        for source, recording, angle in itertools.product(models, ("multisine 2", "multisine 3"), ("yaw", "pitch")):
            scores = (rng.uniform(0, 0.1), rng.uniform(90, 99), rng.uniform(1, 9))
            rows.append((kind, horizon, *source, recording, angle, 83, 0, *scores))
    columns = "kind horizon input model recording angle windows diverged enr bfr nrmse"
    metrics = pd.DataFrame(rows, columns=columns.split())
    metrics.to_csv(root / "data" / "metrics.csv", index=False)
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
    write(figures / "comparison_window.csv", "method input angle horizon nrmse", rows)
    rows = [("true", "pitch", 0), ("Gaussian RBF", "pitch", 0.25), ("Gaussian RBF", "pitch", 0.75)]
    write(figures / "portrait.csv", "model plane error", rows)
    controllers = ("PID", "MPC, linear", "MPC, the paper's", "MPC, mechanical", "MPC, true plant")
    rows = [(name, name != "PID", "fast", "calm", 0.01 * i, 0.02) for i, name in enumerate(controllers)]
    write(data / "control.csv", "controller preview reference condition yaw pitch", rows)
    rows = [(name, gust, 0.1, 0.2) for name in controllers for gust in (0.0, 0.01)]
    write(data / "control_motors.csv", "controller gust yaw pitch", rows)
    models = ("mechanical with actuators", "monomials, degree 3")
    rows = [
        ("accuracy", rig, model, angle, 0.02)
        for rig in ("maker", "Rotondo et al.")
        for model in models
        for angle in ("yaw", "pitch")
    ]
    write(data / "larger.csv", "part rig model angle nrmse", rows)


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
    shutil.copy(ROOT / "notebooks" / f"{name}.ipynb", root / "paper")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with everything that the site shows, notebooks as they are before a run; and the metrics behind it."""
    root, rng = tmp_path_factory.mktemp("whole"), np.random.default_rng(0)
    for name in ("data", "figures", "paper"):
        (root / name).mkdir()
    metrics = paper_tables(root, rng)
    study_tables(root, rng)
    write(root / "data" / "claims.csv", " ".join(claims.COLUMNS), claim_rows())
    for name in DRAWN:
        (root / "figures" / f"{name}.svg").write_text(SVG)
    for name in ("animation", "control_film"):
        (root / "figures" / f"{name}.svg").unlink()
        Image.new("RGB", (4, 3)).save(root / "figures" / f"{name}.gif")
    signals = {"pitch_max_frequency": 0.2, "pitch_peak": 1.22173, "yaw_max_frequency": 0.8, "yaw_peak": 3.14159}
    for path in sorted((ROOT / "notebooks").glob("[0-9]*.ipynb")):
        stage(root, path.stem, **({"duration": 500.0, "sampling_time": 0.01, **signals} if "01" in path.stem else {}))
    return root, metrics


def sources(root):
    return Sources(root / "data", root / "figures", root / "paper")


def run(root):
    folders = [f"--{option}={path}" for option, path in sources(root)._asdict().items()]
    return make_site.main([str(root / "site"), *folders])


@pytest.fixture(scope="module")
def site(whole):
    """The whole site, made by its command: no warning, no link that leads nowhere."""
    root, _ = whole
    assert run(root) == 0
    assert not list(root.glob(".docs-*"))
    return root / "site"


def page_of(site, name):
    return BeautifulSoup((site / f"{name}.html").read_text(encoding="utf-8"), "html.parser").find("article")


def text_of(element):
    return " ".join(element.get_text().replace("\N{PILCROW SIGN}", "").split())


def section(article, identity):
    return article.find(id=identity)


def cells(table):
    return [[text_of(cell) for cell in row.find_all(["th", "td"])] for row in table.find_all("tr")]


@pytest.fixture
def small(whole, tmp_path):
    """What a page of this text becomes, and what Sphinx says about it, from a copy of the sources."""
    root = Path(shutil.copytree(whole[0], tmp_path / "copy", ignore=shutil.ignore_patterns("site", "*.ipynb")))
    (root / "pages").mkdir()
    (root / "pages" / "figures").symlink_to(root / "figures")

    def make(text):
        (root / "pages" / "index.md").write_text(text, encoding="utf-8")
        words = io.StringIO()
        options = {f"tras_{name}": str(path) for name, path in sources(root)._asdict().items()}
        options |= {"tras_pages": ["index"], "autosummary_generate": False}
        folders = (root / "pages", ROOT / "docs", root / "html", root / "trees")
        with docutils_namespace(), patch_docutils(ROOT / "docs"):
            Sphinx(*folders, "html", options, status=None, warning=words, freshenv=True).build()
        return page_of(root / "html", "index"), words.getvalue()

    return root, make


# --- the site ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_public_name_has_a_page_with_an_example(site):
    for name in sorted({*tras.__all__} - {"__version__"}):
        assert ">>>" in getattr(tras, name).__doc__, name  # the doctests of tras/ run it
        assert ">>>" in page_of(site, f"api/tras.{name}").get_text(), name
    assert "tras.__version__" in text_of(page_of(site, "api"))


@pytest.mark.slow
def test_an_example_can_be_copied_from_its_page(capsys):
    """The doctests see what their module imports; a reader begins with what the page of the reference says."""
    begin = {}
    exec("from tras import *", begin)
    for name in sorted({*tras.__all__} - {"__version__"}):
        example = doctest.DocTestParser().get_doctest(getattr(tras, name).__doc__, dict(begin), name, None, 0)
        doctest.DocTestRunner(verbose=False, optionflags=doctest.ELLIPSIS).run(example)
    assert "NameError" not in capsys.readouterr().out


@pytest.mark.slow
def test_every_notebook_page_and_figure_is_there(site):
    for name in [*PAGES, *(f"notebooks/{path.stem}" for path in (ROOT / "notebooks").glob("[0-9]*.ipynb"))]:
        assert (site / f"{name}.html").is_file(), name
    assert {path.stem for path in (ROOT / "figures").glob("*.[pg][ni][gf]")} == {*DRAWN}
    links = [link.get("href") for link in page_of(site, "gallery").find_all("a")]
    assert {f"replication.html#fig-{name}" for name in DRAWN} <= {*links}


@pytest.mark.slow
def test_cells_that_write_conclusions_are_folded(site):
    article = page_of(site, "notebooks/05_robustness")
    folded = [element.get_text() for element in article.find_all("details")]
    assert folded and all("conclude(" in text for text in folded)
    assert "conclude(\n" not in "".join(cell.get_text() for cell in article.select("div.cell:not(.tag_hide-input)"))


@pytest.mark.slow
def test_formulas_are_mathml(site):
    """Browsers draw an element with a wrong number of parts as an error, or in a row."""
    parts = dict.fromkeys(("msup", "msub", "mover", "munder", "mfrac", "mroot"), 2)
    parts |= dict.fromkeys(("msubsup", "munderover"), 3)
    count = 0
    for path in site.rglob("*.html"):
        for formula in re.findall(r"<math.*?</math>", path.read_text(encoding="utf-8"), re.DOTALL):
            count += 1
            for element in ElementTree.fromstring(formula).iter():
                number = parts.get(element.tag.removeprefix(MATH), len(element))
                assert len(element) == number, (path.name, formula)
    assert count > 150
    for path in {*site.rglob("*.html")} - {site / "index.html", site / "claims.html"}:  # which show what a file holds
        if article := page_of(site, path.relative_to(site).with_suffix("")):
            for element in article(["pre", "code", "math"]):
                element.clear()
            assert not re.search(r"\$|\\[a-zA-Z]|\{\{|\}\}", text_of(article)), path.name
    replication = text_of(page_of(site, "replication"))
    for number in (7, 14, 15, 18, 19, 20, 21):
        assert f"({number})" in replication


@pytest.mark.slow
def test_every_claim_stands_there_with_its_verdict_in_words(site):
    overview, evidence = section(page_of(site, "index"), "verdicts"), page_of(site, "claims")
    for row, line in zip(claim_rows(), cells(overview.find("table"))[1:], strict=True):
        for text in (text_of(section(evidence, f"claim-{row['claim']}")), " ".join(line)):
            assert row["statement"] in text and re.search(rf"[✓◐✗?◑] {row['verdict']}", text), text
    first = section(evidence, "claim-C1")
    assert "1.235 (1 to 2)" in text_of(first) and "5 of 7" in text_of(first)
    assert "replication.html#fig-horizon" in [link["href"] for link in first.find_all("a")]
    counts = "reproduced 1, reproduced only under a named reading of the text 1, holding in part 1, not reproduced 1"
    assert f"Of 5: {counts}, not checkable 1." in text_of(overview.find("caption"))


@pytest.mark.slow
def test_the_table_paper_against_ours_is_that_of_tables(whole, site):
    lines = tables.markdown(tables.read(whole[0] / "figures" / "table.csv")).splitlines()
    expected = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines if "---" not in line]
    assert cells(section(page_of(site, "replication"), "paper-against-ours").find("table")) == expected


@pytest.mark.slow
def test_numbers_in_sentences_are_those_of_the_metrics(whole, site):
    """Medians computed here a second time from what `tables.comparison` was given."""
    medians = whole[1][whole[1]["kind"] == "window"].groupby(["input", "model", "angle"])["nrmse"].median()
    short = section(page_of(site, "index"), "in-short")
    points = [text_of(point) for point in short.find("ul").find_all("li")]
    pairs = [(source, model) for source in ("reference", "torque") for model in ("gaussian", "linear")]
    pairs = (pairs[:2], pairs[2:], [("torque", "mechanical")])
    for point, models, digits in zip(points, pairs, (3, 3, 2), strict=True):
        expected = [medians[*model, angle] for model in models for angle in ("yaw", "pitch")]
        assert re.findall(r"([\d.]+) %", point) == [f"{value:#.{digits}g}" for value in expected]
    assert "4.0589 % for yaw and 5.5889 % for pitch" in text_of(short)
    experiment = text_of(section(page_of(site, "replication"), "the-experiment"))
    assert "0.2 rad/s and 1.222 rad in pitch, 0.8 rad/s and 3.142 rad in yaw" in experiment


@pytest.mark.slow
def test_summaries_of_studies(whole, site):
    article = page_of(site, "replication")

    def table(identity):
        return cells(section(article, identity).find("table"))

    noise = pd.read_csv(whole[0] / "data" / "robustness_noise.csv")
    head, *rows = table("measurement-noise")
    assert head == ["angle", "fit", "noise 0 %", "noise 1 %"]
    for angle, method, *values in rows:
        for level, value in zip((0, 1), values, strict=True):
            same = (noise["angle"] == angle) & (noise["method"] == method) & (noise["noise"] == level)
            median = noise[same]["nrmse"].median()
            assert value == ("–" if np.isnan(median) else f"{median:#.3g}")
    assert len(rows) == 4
    assert table("length-of-the-data")[1] == ["0", "linear", "7", "95%", "0%"]
    assert "0.75 %, with noise of 1 % 2 %" in text_of(section(article, "the-rig-s-parameters"))
    assert "without noise 25% of the stretches" in text_of(section(article, "length-of-the-data"))
    assert table("eigenpairs")[1] == ["linear", "2", "1", "0.25"]
    methods = table("other-methods")
    assert methods[0] == ["method", "angle", "reference", "torque"] and methods[1] == ["DMDc", "yaw", "1", "1.25"]
    assert "1.75 / 1.88 % (yaw / pitch, torques), the linear DMDc 1.25" in text_of(section(article, "other-methods"))
    assert table("one-model-seen")[1:] == [["pitch", "Gaussian RBF", "0.5", "0.75"]]
    assert table("the-readings-nearest-to-the-paper")[1][-4:] == ["words", "4.00", "5.00", "0.123"]
    models = [row[0] for row in cells(section(page_of(site, "dictionaries"), "what-it-makes-of-the-twin-rotor").table)]
    assert models == ["dictionary", "gaussian", "linear", "mechanical"]


@pytest.mark.slow
def test_provenance_is_that_of_the_records(site):
    where = section(page_of(site, "replication"), "where-the-numbers-come-from")
    assert cells(where.find("table"))[1] == ["01_data_generation", "a" * 12, "2026-01-02T03:04:05+00:00", "1.2"]
    assert "Linux <x>" in text_of(where) and "avx, fma" in text_of(where)


@pytest.mark.slow
def test_what_comes_from_files_is_text(site):
    for name in ("index", "claims"):
        article = page_of(site, name)
        assert article.find("script") is None and article.get_text().count("<script>alert(1)</script>") in (1, 2)
        assert "**bold** `code`" in article.get_text() and "{{ data/claims.csv: claim }}" in article.get_text()


# --- what can be wrong ------------------------------------------------------------------------------------------------


LOOKUP = '{{ value("data/parameters.csv", "max(error)", noise=1) }}'
MISSING = [
    ("data/claims.csv", "```{tras-claims}\n```"),
    ("figures/table.csv", "```{tras-compare}\ncaption: c\n```"),
    ("figures/horizon.png", "```{tras-figure}\nname: horizon\nalt: a\ncaption: c\n```"),
    ("data/parameters.csv", f"It is {LOOKUP}."),
    ("data/residuals.csv", "```{tras-table}\nfile: data/residuals.csv\ncolumns: {model: m}\ncaption: c\n```"),
]


@pytest.mark.parametrize("name, text", MISSING, ids=[name for name, _ in MISSING])
def test_a_missing_file_is_one_sentence(small, name, text):
    root, make = small
    (root / name).with_suffix(".svg" if name.endswith("png") else ".csv").unlink()
    article, words = make(f"# Title\n\n## Lacking\n\n{text}\n\n## There\n\nNumber {{{{ 1 }}}}.\n")
    note = text_of(section(article, "lacking").find(class_="note"))
    assert note == f"Note This part is not shown: {name} is not there: make all makes it." and words == ""
    assert "Number 1." in text_of(section(article, "there"))


def test_a_record_without_its_notebook_is_no_run(small):
    root, make = small
    article, _ = make("# T\n\n```{tras-provenance}\nstages: s\nenvironment: e\n```\n")
    assert "no stage has left a record beside its executed notebook: make all runs them." in text_of(article)
    (root / "paper" / "02_identification.ipynb").touch()
    article, _ = make("# T\n\n```{tras-provenance}\nstages: s\nenvironment: e\n```\n")
    assert len(cells(article.find("table"))) == 2


DAMAGED = [
    ("data/claims.csv", "claim\nC1\n", "```{tras-claims}\n```", "is not the table of claims: delete it"),
    ("figures/table.csv", "kind\nwindow\n", "```{tras-compare}\ncaption: c\n```", "paper against ours: delete it"),
    ("data/residuals.csv", '"', MISSING[-1][1], "is no table"),
    ("paper/02_identification.json", "{", "```{tras-provenance}\n```", "is no record of a run: delete it"),
]


@pytest.mark.parametrize("name, content, text, message", DAMAGED, ids=[name for name, *_ in DAMAGED])
def test_a_damaged_file_is_named(small, name, content, text, message):
    """A warning, which the command makes an error."""
    root, make = small
    (root / "paper" / "02_identification.ipynb").touch()
    (root / name).write_text(content)
    _, words = make(f"# Title\n\n{text}\n")
    assert message in words and Path(name).name in words and "Traceback" not in words


def test_a_wrong_lookup_and_a_wrong_block_are_named(small):
    _, make = small
    with pytest.raises(blocks.SphinxError, match=r"a lookup is not understood \('nonsense' is undefined\)"):
        make("# T\n\n{{ nonsense }}\n")
    assert "tras-nonsense" in make("# T\n\n```{tras-nonsense}\n```\n")[1]
    assert "is not understood: 'caption' is missing" in make("# T\n\n```{tras-compare}\n```\n")[1]
    assert "is not understood" in make("# T\n\n```{tras-claims}\na: [\n```\n")[1]


def test_a_formula_that_cannot_be_drawn_is_named(small):
    _, make = small
    article, words = make("# T\n\n$\\frac{1}{2}$ and\n\n$$\nx \\tag{7}\n$$\n")
    assert words == "" and len(article.find_all("math")) == 2 and "(7)" in text_of(article)
    assert r"\nonsense" in make("# T\n\n$\\nonsense{x}$\n")[1]


def test_another_profile_is_said(small, tmp_path):
    root, make = small
    front = PAGES["index"].partition("## In short")[0].partition("\n")[2]
    front = "# T\n\n" + re.sub(r"\]\([^)]*\)", "]", front)
    assert make(front)[0].find(class_="warning") is None
    assert "PROFILE=smoke" in blocks.render(front, sources(root)._replace(build=Path("build/smoke")))


LINKS = [
    ('<a href="b.html">', []),
    ('<a href="b.html#here">', []),
    ('<a href="https://example.org/">', []),
    ('<img src="data:,">', []),
    ('<a href="b.html#there">', ["a.html links to b.html#there, but that page has no such place"]),
    ('<a href="c.html">', ["a.html links to c.html, which is not there"]),
    ('<a href="#top">', ["a.html links to #top, but that page has no such place"]),
    ('<img src="c.png">', ["a.html links to c.png, which is not there"]),
    ('<a href="../x.html">', ["a.html links to ../x.html, which is not there"]),
    ('<script src="https://example.org/x.js"></script>', ["a.html loads https://example.org/x.js from elsewhere"]),
    ('<link rel="stylesheet" href="//example.org/x.css">', ["a.html loads //example.org/x.css from elsewhere"]),
]


@pytest.mark.parametrize("text, sentences", LINKS)
def test_the_checker_of_links_sees(tmp_path, text, sentences):
    folder = tmp_path / "site"
    folder.mkdir()
    (tmp_path / "x.html").touch()
    (folder / "b.html").write_text('<p id="here">')
    (folder / "a.html").write_text(text)
    assert make_site.problems(folder) == sentences


def test_what_is_not_built_is_said(tmp_path, capsys):
    assert make_site.main([str(tmp_path / "site"), f"--data={tmp_path / 'none'}"]) == 2
    assert f"{tmp_path / 'none'} does not exist; `make all` makes it." in capsys.readouterr().err


# --- in a browser -----------------------------------------------------------------------------------------------------

SHOWN = "index replication claims paper gallery dictionaries genindex notebooks/02_identification api/tras.KoopmanModel"
# What reaches beyond the window and does not lie in something that scrolls. (The theme cuts the rest: no page scrolls.)
BEYOND = """[...document.querySelectorAll('article *')].filter(element => {
  if (element.getBoundingClientRect().right <= innerWidth + 1) return false;
  for (let outer = element.parentElement; outer.tagName != 'ARTICLE'; outer = outer.parentElement)
    if (['auto', 'scroll'].includes(getComputedStyle(outer).overflowX)) return false;
  return true;
}).map(element => element.tagName + ': ' + element.textContent.trim().slice(0, 50))"""


@pytest.mark.parametrize("width", [390, 1280])
def test_in_a_browser_without_network(browser, site, width):
    context = browser.new_context(viewport={"width": width, "height": 844}, offline=True)
    opened, requested, complaints = context.new_page(), [], []
    opened.on("request", lambda request: requested.append(request.url))
    opened.on("console", lambda message: complaints.append(message.text))
    opened.on("pageerror", lambda error: complaints.append(str(error)))
    for name in SHOWN.split():
        opened.goto((site / f"{name}.html").as_uri())
        assert opened.evaluate("document.documentElement.scrollWidth") <= width, name
        assert opened.evaluate(BEYOND) == [], name
        assert opened.evaluate("[...document.images].filter(i => !(i.complete && i.naturalWidth > 0)).length") == 0
        heights = opened.evaluate("[...document.querySelectorAll('math')].map(m => m.getBoundingClientRect().height)")
        assert min(heights, default=10) > 5
    opened.goto((site / "replication.html").as_uri())
    fraction, part = (
        opened.evaluate(f"document.querySelector('{element}').getBoundingClientRect().height")
        for element in ("mfrac", "mfrac mi, mfrac mn")
    )
    assert fraction > 1.5 * part  # drawn one above the other, not in a row
    assert complaints == [] and all(url.startswith(("file:", "data:")) for url in requested)
    context.close()


def test_the_search_works_from_a_disk(browser, site):
    context = browser.new_context(viewport={"width": 1280, "height": 844}, offline=True)
    opened = context.new_page()
    opened.goto((site / "index.html").as_uri())
    opened.locator("input[name=q]").first.fill("logarithm")
    opened.keyboard.press("Enter")
    found = opened.locator("#search-results a", has_text="Glossary")
    found.first.click()
    assert opened.url.startswith((site / "glossary.html").as_uri())
    context.close()
