"""The conclusions of 05, 07 and 11 with the paper's tables: every point can be decided, and follows the tables."""

import json

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import ROOT

from tras.paper import control, lookups, operators, plans

REFERENCE = ROOT / "reference" / "data"
PARAMS = yaml.safe_load((ROOT / "params" / "paper.yaml").read_text(encoding="utf-8"))
NOTEBOOKS = {"05_robustness": 5, "07_comparison": 5, "11_control": 2}  # -> cells with conclusions, at least


def table(name):
    return pd.read_csv(REFERENCE / f"{name}.csv")


def names_of(notebook):
    """What the cells before the conclusions have made, from the reference instead."""
    names = PARAMS[notebook] | {"pd": pd, "lookups": lookups, "Markdown": str}
    if notebook == "05_robustness":
        names |= {"length": table("robustness_length"), "parameters": table("parameters")}
        pairs = table("residuals")
        best = pairs[(pairs["model"] == "free, monomials5") & (pairs["frequency"] >= 0) & ~operators.trivial(pairs)]
        names |= {"best": best.sort_values("relative"), "rates": operators.linearised_rates()}
    if notebook == "11_control":
        names |= {"runs": table("control"), "control": control, "plans": plans, "spread": np.full(4, 0.5)}
    return names


def conclusions(notebook, data=REFERENCE):
    """What the cells that call `conclude` say."""
    names = names_of(notebook) | {"data": data, "out": ROOT / "figures"}
    cells = json.loads((ROOT / "notebooks" / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    texts = []
    for source in ("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"):
        before, call, after = source.partition("conclude(")
        if call and before.endswith("def "):
            exec(source, names)
        elif call:
            exec(f"{before}said = conclude({after}", names)
            texts.append(names["said"])
    return texts


@pytest.mark.parametrize("notebook", NOTEBOOKS)
def test_the_papers_tables_decide_every_point(notebook):
    texts = conclusions(notebook)
    assert len(texts) >= NOTEBOOKS[notebook]
    for text in texts:
        assert "Nothing to conclude" not in text and "{{" not in text and "{%" not in text and "nan" not in text
        assert all(line.startswith("* ") for line in text.splitlines())


def test_numbers_are_those_of_the_tables():
    noise = table("robustness_noise")
    median = noise[(noise["method"] == "refined") & (noise["noise"] == 5)].groupby("angle")["nrmse"].median()
    text = "\n".join(conclusions("05_robustness"))
    assert f"% smoothed and {median['yaw']:#.2g} / {median['pitch']:#.2g} % refined" in text
    scores = pd.read_csv(ROOT / "figures" / "comparison_horizon.csv")
    scores = scores[(scores["input"] == "torque") & (scores["horizon"] == 6) & (scores["angle"] == "yaw")]
    errors = scores.set_index("method")["nrmse"].drop("grey box")
    ratio = errors.drop("Koopman, mechanical").min() / errors["Koopman, mechanical"]
    assert f"by factors of {ratio:.0f} (yaw)" in "\n".join(conclusions("07_comparison"))


def test_a_verdict_follows_its_numbers(tmp_path):
    for path in REFERENCE.glob("*.csv"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert "not the logarithm that fails first" in conclusions("05_robustness")[2]
    length = table("robustness_length")
    swapped = length.rename(columns={"dependent": "no_logarithm", "no_logarithm": "dependent"})
    swapped.to_csv(tmp_path / "robustness_length.csv", index=False)
    assert "Without noise the logarithm fails first" in conclusions("05_robustness", tmp_path)[2]
