"""No number in prose that no test knows: README, docs and the text of the notebooks against `prose.yaml` and tables.

A number is what is no result (`PATTERNS`, `parameters`, `sizes`), or it stands in a sentence of `prose.yaml`, which
says where it comes from. Tables between the markers of `tras.paper.pages`, lookups and the outputs of notebooks are
computed.
"""

import importlib
import json
import math
import re

import pandas as pd
import pytest
import yaml
from conftest import ROOT

from tras.paper import claims, lookups
from tras.twin_rotor.closed_loop import PID
from tras.twin_rotor.plant import PlantParameters

# Not yet in: these pages have results in their prose that no table holds.
OPEN = {"docs/verify.md"}
PAGES = [ROOT / "README.md", ROOT / "data" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES = [str(path.relative_to(ROOT)) for path in [*PAGES, *sorted((ROOT / "notebooks").glob("*.ipynb"))]]
LISTED = yaml.safe_load((ROOT / "tests" / "paper" / "prose.yaml").read_text(encoding="utf-8"))
ENTRIES = [(page, entry) for page, entries in LISTED.items() for entry in entries]
PARAMS = yaml.safe_load((ROOT / "params" / "paper.yaml").read_text(encoding="utf-8"))
TABLES = lookups.Sources(ROOT / "reference" / "data", ROOT / "figures")
MEASURED = lookups.Sources(ROOT / "benchmarks" / "results", ROOT / "figures")

_PARTS = "half|thirds?|quarters?|fifths?|tenths?|hundredths?|thousandths?|millionths?|billionths?"
_COUNTS = "two|three|four|five|six|seven|eight|nine|ten|a hundred|a thousand|a million"
NUMBER = re.compile(
    rf"(?<![\w.])[-−]?\d+(?:[.,]\d+)*(?:e[-+]?\d+)?|\b(?:{_PARTS})\b"
    rf"|\b(?:{_COUNTS})\b(?= (?:to (?:{_COUNTS}) )?(?:times|orders))|(?<=factor of )(?:about )?(?:{_COUNTS})\b",
    re.IGNORECASE,
)
PATTERNS = [  # what is no result, and why
    (r"\(\d+\)(?: (?:to|and) \(\d+\))*|equation \d+|\(15 to 18\)", "the paper's equations"),
    (r"Figs?\. \d(?: to \d)?|Algorithm 1|Step \d(?: and \d)?", "the paper's figures and steps"),
    ("|".join(path.stem for path in ROOT.glob("notebooks/*.ipynb")), "notebooks"),
    (r"studies 05 to 07|\[\d [a-z ]+", "notebooks"),
    (r"Debian 12|Python 3\.11\+|make 4\.3\+|NetCDF-4|exit status \d", "versions and codes"),
    (r"Townsend 2024|Brunton et al\. 2016|\d{4}-\d\d-\d\d", "years and days"),
    (r"degrees? \d|monomials of degree \d", "names of dictionaries"),
    (r"\b\d (?:states|inputs|references|torques)\b", "channels of the rig"),
    (r"\b1/s\b|half-ranges?", "units"),
    (r"eigenvalue 1\b|lie near 1\b|rate 0\b|without \"1 −\"", "identities"),
    (r"(?:\d+ )?\b[NMncq](?:\^\d| [NMncq]\b)(?: ?[NMncq](?:\^\d)?)*(?!\w)", "orders of growth: 2 N^2 M"),
    (r"noise of 1 %|[Nn]oise \(?\d % of each|1 % noise", "a level of noise among the parameters"),
    (r"middle half|95 % intervals", "what a figure shows"),
]


# --- a page's text and its numbers ------------------------------------------------------------------------------------


def prose(page: str, text: str) -> str:
    """The running text of a page on one line, without code, displayed formulas, lookups and generated tables."""
    if page.endswith(".ipynb"):
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    else:
        text = re.sub(r"(?<=\n\n)(?: {4}.*\n)+", "\n", text)
    text = re.sub(r"<!-- (\w+): written by .*?<!-- end of \1 -->", " ", text, flags=re.DOTALL)
    text = re.sub(r"^( *)```.*?^\1```", _captions, text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\{[{%] .*? [%}]\}|\$\$.*?\$\$", " ", text, flags=re.DOTALL)
    text = re.sub(r"`[^`\n]*`", " ", text)
    text = re.sub(r"\]\([^)\s]*\)", "]", text)
    text = re.sub(r"^\s*(?:#+ )?\d+\. ", " ", text, flags=re.MULTILINE)  # numbered points and headings
    text = re.sub(r"\$[^$\n]*\$", lambda formula: formula[0] if _VALUE.search(formula[0]) else " ", text)
    return " ".join(text.split())


_VALUE = re.compile(r"(?:=|\\times|\\approx|\^\{-|[<>])\s*-?\d")  # a formula that gives a value


def _captions(block):
    return " ".join(re.findall(r"^(?:caption|alt): (?:>-\s+)?(.*)$", block[0], flags=re.MULTILINE))


def plain(sentence: str) -> str:
    """A sentence of the list as it stands in `prose`."""
    return " ".join(re.sub(r"\]\([^)\s]*\)", "]", re.sub(r"`[^`]*`", " ", sentence)).split())


def unknown(page: str, text: str) -> list[str]:
    """The numbers of a text that nothing knows, each with what stands around it."""
    known = [re.escape(plain(rendered(entry))) for entry in LISTED.get(page, [])]
    known += [pattern for pattern, _ in PATTERNS] + parameters() + sizes()
    spans = [match.span() for pattern in known for match in re.finditer(pattern, text)]
    numbers = [number for number in NUMBER.finditer(text) if not _within(number.span(), spans)]
    return [f"{number[0]} in …{text[max(0, number.start() - 60) : number.end() + 30]}…" for number in numbers]


def _within(span, spans):
    return any(start <= span[0] and span[1] <= end for start, end in spans)


def parameters():
    """Durations, frequencies and angles of params/paper.yaml with the unit that their comment names."""
    lines = (ROOT / "params" / "paper.yaml").read_text(encoding="utf-8").splitlines()
    found = [re.search(r": ([\d., \[\]]+)  # (s|rad/s|rad)\b", line) for line in lines]
    pairs = {(float(number), match[2]) for match in found if match for number in re.findall(r"[\d.]+", match[1])}
    return [rf"(?<![\w.]){re.escape(f'{number:g}')} {unit}\b" for number, unit in sorted(pairs)]


def sizes():
    """N = 9: the sizes of the dictionaries, and of a trajectory."""
    counts = {*pd.read_csv(TABLES.data / "identification.csv")["N"]}
    counts |= {*pd.read_csv(TABLES.data / "robustness_length.csv")["functions"]}
    return [*(rf"N = {count:d}\b" for count in sorted(counts)), rf"\b{NAMES['piece']} samples"]


# --- the list ---------------------------------------------------------------------------------------------------------


def _samples(seconds):
    return round(seconds / PARAMS["01_data_generation"]["sampling_time"]) + 1


_DATA, _FIT = PARAMS["01_data_generation"], PARAMS["02_identification"]
_PRINTED = lookups.Table(TABLES, "figures/table.csv")
NAMES = {
    "params": PARAMS,
    "claims": {name: limit for name, limit in vars(claims).items() if name.isupper()},
    "plant": PlantParameters(),
    "gains": PID.defaults(PlantParameters()),
    "pid": PID.pole_placement.__func__.__kwdefaults__,
    "paper": {a: _PRINTED("median", metric="nrmse", kind="window", angle=a, input="paper") for a in ("yaw", "pitch")},
    "growth": lookups.Table(MEASURED, "data/growth.csv"),
    "rivals": [name for name in PARAMS["07_comparison"]["methods"] if name != "grey box"],
    "tenth_of_the_data": round(0.1 * _FIT["train_fraction"] * _DATA["duration"]),
    "samples": _samples(_DATA["duration"]),
    "piece": _samples(_FIT["trajectory"]),
    "pieces": round(_DATA["duration"] / _FIT["trajectory"]),
    "comb": math.comb,
    "cos": math.cos,
    "thousands": lambda count: f"{count:,}".replace(",", " "),
    "constant": lambda module, name: getattr(importlib.import_module(module), name),
}


def rendered(entry):
    """A sentence of the list with the numbers of today's tables; it keeps its Markdown."""
    text = lookups.render(entry["text"], TABLES, **NAMES)
    return " ".join(text.split())


def each_entry():
    return pytest.mark.parametrize("page, entry", ENTRIES, ids=[f"{page}: {e['text'][:40]}" for page, e in ENTRIES])


# --- tests ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", [page for page in PAGES if page not in OPEN])
def test_every_number_is_known(page):
    numbers = unknown(page, prose(page, (ROOT / page).read_text(encoding="utf-8")))
    advice = "let a lookup write it, or list its sentence in tests/paper/prose.yaml with where it comes from"
    assert not numbers, f"{page}: {advice}:\n" + "\n".join(numbers)


@each_entry()
def test_the_list_says_what_the_pages_say(page, entry):
    text = prose(page, (ROOT / page).read_text(encoding="utf-8"))
    assert plain(rendered(entry)) in text, f"{page} says something else, or no longer says this"


@each_entry()
def test_every_entry_has_evidence(page, entry):
    looked_up = "{{ " in entry["text"]
    assert entry.keys() <= {"text", "holds", "in", "measured"} and (looked_up or len(entry) > 1)
    if "holds" in entry:
        assert lookups.render(f"{{% if {entry['holds']} %}}holds{{% endif %}}", TABLES, **NAMES), entry["holds"]
    for file, line in entry.get("in", {}).items():
        assert line in (ROOT / file).read_text(encoding="utf-8"), f"{file} no longer has {line!r}"
    if "measured" in entry:
        raw = " ".join((ROOT / page).read_text(encoding="utf-8").split())
        assert f"`{entry['measured']}`" in raw, f"{page}: say that {entry['measured']} measured it"


def test_open_pages_are_pages():
    assert OPEN < set(PAGES) and set(LISTED) <= set(PAGES)


@pytest.mark.parametrize(
    "page, right, wrong",
    [
        ("README.md", "4.06 %", "4.07 %"),
        ("README.md", "12 of 332 windows run away", "13 of 332 windows run away"),
        ("README.md", "by a few percent of the error", "by 3 percent of the error"),
        ("README.md", "several times smaller than", "four times smaller than"),
        ("docs/paper.md", "more than 50 times", "more than 60 times"),
        ("docs/scale.md", "so 17 min on one", "so 19 min on one"),
        ("notebooks/08_claims.ipynb", "at most 0.1,", "at most 0.2,"),
        ("notebooks/01_data_generation.ipynb", "50001 samples", "50002 samples"),
        ("notebooks/04_figures.ipynb", "is far better", "is a thousand times better"),
        ("notebooks/04_figures.ipynb", "is far better", "is better by a factor of about a thousand"),
    ],
)
def test_a_changed_number_is_noticed(page, right, wrong):
    text = prose(page, (ROOT / page).read_text(encoding="utf-8"))
    if right not in text:
        pytest.skip(f"{page} does not say {right!r}")
    assert unknown(page, text.replace(right, wrong, 1))
