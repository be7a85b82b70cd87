"""Verification: what counts as the same, what as a difference, and what is said about it."""

import hashlib
import lzma
import re
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from conftest import ROOT
from PIL import Image

import tras
from tras.paper import artefacts, verification

FILES = [
    *map(Path, ("data/table.csv", "data/long.csv", "data/run.nc", "data/model.npz")),
    *map(Path, ("figures/plot.png", "figures/plot.pdf", "figures/film.gif", "figures/plot.csv")),
]
TABLE = "name,count,value\nfirst,3,1.5\nsecond,4,\nthird,5,-2e-05\n"
rng = np.random.default_rng(0)
RUN = rng.normal(size=(900, 3))
LONG = rng.normal(size=(5000, 3))
SQUARE = np.arange(400.0).reshape(20, 20)


@pytest.fixture(scope="module")
def blessed(tmp_path_factory):
    """A folder with one blessed artefact of each kind."""
    folder = tmp_path_factory.mktemp("blessed")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in ("data", "figures"):
            Path(name).mkdir()
        Path("data/table.csv").write_text(TABLE)
        write_long(LONG)
        write_run(RUN)
        write_model()
        write_picture(0)
        write_film()
        Path("figures/plot.pdf").write_bytes(b"%PDF")
        Path("figures/plot.csv").write_text(TABLE)
        commit("figures/plot.png", "figures/plot.csv", "figures/film.gif")
        assert verification.bless(FILES, Path("reference")) == 0
    return folder


@pytest.fixture
def project(blessed, tmp_path, monkeypatch):
    """A copy of it to spoil, as the working folder."""
    shutil.copytree(blessed, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def commit(*paths):
    """Commit files to the repository of the working folder, which is made if there is none."""
    identity = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    for command in (("init", "-q"), ("add", *paths), (*identity, "commit", "-q", "-m", "Figures")):
        subprocess.run(["git", *command], check=True)


def write_long(values):
    pd.DataFrame(values, columns=["a", "b", "c"]).to_csv("data/long.csv", index=False, float_format="%.12g")


def write_run(values, dt=0.01):
    tras.Recording([values[:400, :2], values[400:, :2]], [values[:400, 2:], values[400:, 2:]], dt).write("data/run.nc")


def write_model(header='{"kind": "K", "strength": 0.1, "versions": {"numpy": "1"}}', **changes):
    arrays = {"K": SQUARE, "noise": np.array([1e-15, 3e-16]), "rank": np.array(3), "poles": np.array([1 + 2j])}
    np.savez("data/model.npz", header=np.array(header), **(arrays | changes))


def write_picture(place, size=200):
    picture = np.ones((size, 240, 3))
    picture[place + 40 : place + 44, 20:220] = 0
    matplotlib.image.imsave("figures/plot.png", picture)


def write_film(last=40):
    """Nine frames with a bar; ``last`` is where it stands in the last one."""
    frames = [np.full((80, 60), 255, dtype=np.uint8) for _ in range(9)]
    for k, frame in enumerate(frames):
        frame[last if k == 8 else 5 * k :][:12] = 0
    first, *others = map(Image.fromarray, frames)
    first.save("figures/film.gif", save_all=True, append_images=others, duration=100, loop=0)


def change(path, old, new):
    text = Path(path).read_text()
    assert old in text
    Path(path).write_text(text.replace(old, new))


def nudged(values, row, by):
    """A copy with one number changed, by a share of itself."""
    values = np.array(values)
    values[row, 0] *= 1 + by
    return values


def verdicts(capsys, paths=FILES, *, whole=False):
    """Exit status, and for each artefact the line about it; if they are the whole, all of them but one in --paper."""
    capsys.readouterr()
    paths = list(map(str, paths))
    status = verification.main(["--paper", *paths[:-1], "--studies", paths[-1]] if whole else paths)
    lines = capsys.readouterr().out.splitlines()
    lines = lines[lines.index("") + 1 :] if whole else lines
    return status, {line[15:].split()[0]: line for line in lines[: lines.index("")]}


def test_equal_bytes(project, capsys):
    status, lines = verdicts(capsys)
    assert status == 0 and list(lines) == list(map(str, FILES))
    assert all(line == f"same bytes       {name}" for name, line in lines.items())


def test_the_manifest_is_what_sha256sum_reads(project):
    subprocess.run(["sha256sum", "--check", "--strict", "--quiet", "reference/SHA256SUMS"], check=True)


def edit(old, new):
    change("data/table.csv", old, new)


def spoil(name, content=b"junk"):
    Path(name).write_bytes(content)


def append(name):
    Path(name).open("ab").write(b" ")


OTHER_VERSION = '{"kind": "K", "strength": 0.1, "versions": {"numpy": "2"}}'
# Artefact -> what is done to it, and the line about it.
CHANGES = {
    "data/table.csv": {
        "inside": (lambda: edit("1.5", "1.5000000001"), "numbers agree .*1.5000000001 for 1.5"),
        "outside": (
            lambda: edit("1.5", "1.50001"),
            r"DIFFERS .*\(value, row 1: 1.50001 for 1.5, .* times what is allowed",
        ),
        "small beside the column's largest": (lambda: edit("-2e-05", "-2.0001e-05"), "DIFFERS .*value, row 3"),
        "the sign": (lambda: edit("-2e-05", "2e-05"), "DIFFERS .*value, row 3: 2e-05 for -2e-05"),
        "a whole number by one": (lambda: edit("4", "5"), r"DIFFERS .*\(count, row 2: 5 for 4\)"),
        "text": (lambda: edit("second", "Second"), "DIFFERS .*name, row 2: Second for second"),
        "a number for none": (lambda: edit("4,", "4,0"), "DIFFERS .*value, row 2: 0 for nan"),
        "infinity": (lambda: edit("1.5", "inf"), "DIFFERS .*inf for 1.5"),
        "a row less": (lambda: edit("third,5,-2e-05\n", ""), "DIFFERS .*name has 2 rows, the reference 3"),
        "another column": (lambda: edit("count", "number"), "DIFFERS .*column count is only in the reference"),
        "a line cut": (lambda: Path("data/table.csv").write_text(TABLE[:-8]), "UNREADABLE .*do not all have 3 fields"),
        "empty": (lambda: spoil("data/table.csv", b""), "UNREADABLE .*it is empty"),
    },
    "data/long.csv": {
        "inside": (lambda: write_long(nudged(LONG, 0, 1e-10)), "numbers agree .*a, row 1"),
        "outside": (lambda: write_long(nudged(LONG, 4999, 1e-4)), "DIFFERS .*a, row 5000"),
        "everywhere": (lambda: write_long(LONG * [1, 1.001, 1]), "DIFFERS .*b, row .* and 4999 more in this column"),
        "a row less": (lambda: write_long(LONG[:-1]), "DIFFERS .*a has 4999 rows, the reference 5000"),
    },
    "data/run.nc": {
        "inside": (lambda: write_run(RUN * (1 + 1e-11)), "numbers agree"),
        "outside": (lambda: write_run(nudged(RUN, 0, 1e-6)), "DIFFERS .*x1, row 1:"),
        "other time": (lambda: write_run(RUN, 0.02), "DIFFERS .*time, row "),
        "damaged": (lambda: spoil("data/run.nc"), "UNREADABLE .*run.nc cannot be read"),
        "missing": (lambda: Path("data/run.nc").unlink(), "MISSING .*it is not there: make all"),
    },
    "data/model.npz": {
        "other versions": (lambda: write_model(OTHER_VERSION), "numbers agree .*all equal"),
        "other kind": (lambda: write_model('{"kind": "L", "strength": 0.1}'), "DIFFERS .*header.kind, row 1: L for K"),
        "inside": (lambda: write_model(K=SQUARE * (1 + 1e-9)), "numbers agree .*K, row"),
        "outside": (lambda: write_model(K=SQUARE + 0.01), "DIFFERS .*K, row"),
        "transposed": (lambda: write_model(K=SQUARE.T), "DIFFERS .*K, row"),
        "reshaped": (lambda: write_model(K=np.arange(400.0)), "DIFFERS .*K.shape, row 1"),
        "rounding only": (lambda: write_model(noise=np.array([0, 9e-16])), "numbers agree"),
        "a rank": (lambda: write_model(rank=np.array(4)), "DIFFERS .*rank, row 1: 4 for 3"),
        "a pole": (lambda: write_model(poles=np.array([1 - 2j])), "DIFFERS .*poles.imag, row 1: -2 for 2"),
        "damaged": (lambda: spoil("data/model.npz", b"PK"), "UNREADABLE .*model.npz cannot be read"),
        "with code in it": (lambda: write_model(poles=np.array([{}], dtype=object)), "UNREADABLE"),
    },
    "figures/plot.png": {
        "other bytes": (lambda: append("figures/plot.png"), "looks the same .*RMS 0.00"),
        "moved": (lambda: write_picture(60), "looks different .*RMS [2-9]"),
        "of another size": (lambda: write_picture(0, 300), "looks different .*240x300 pixels for 240x200"),
        "damaged": (lambda: spoil("figures/plot.png"), "UNREADABLE .*plot.png cannot be read"),
    },
    "figures/film.gif": {
        "other bytes": (lambda: append("figures/film.gif"), "looks the same .*RMS 0.00"),
        "its last frame": (lambda: write_film(0), "looks different .*RMS [0-9]+"),
        "damaged": (lambda: spoil("figures/film.gif"), "UNREADABLE .*film.gif cannot be read"),
    },
    "figures/plot.pdf": {
        "other bytes": (lambda: spoil("figures/plot.pdf", b"%PDF-2"), "other bytes .*see plot.png and plot.csv"),
        "empty": (lambda: spoil("figures/plot.pdf", b""), "UNREADABLE .*it is empty"),
    },
    "figures/plot.csv": {
        "inside": (lambda: change("figures/plot.csv", "1.5", "1.5000000001"), "numbers agree .*1.5000000001 for 1.5"),
        "outside": (
            lambda: change("figures/plot.csv", "1.5", "1.50001"),
            r"DIFFERS .*\(value, row 1: 1.50001 for 1.5,",
        ),
    },
}


@pytest.mark.parametrize("name, what", [(name, what) for name, changes in CHANGES.items() for what in changes])
def test_one_change(project, name, what, capsys):
    make, pattern = CHANGES[name][what]
    make()
    status, lines = verdicts(capsys)
    assert re.match(pattern, lines[name]), lines[name]
    assert status == pattern.startswith(verification.FAILURES)
    assert all(line.startswith("same bytes") for other, line in lines.items() if other != name)


# What is done to the reference while the table's bytes differ from it.
COPY = Path("reference/data/table.csv")
LOST = {
    "no copy": (COPY.unlink, r"MISSING .*lost reference/data/table.csv: git checkout"),
    "a damaged copy": (lambda: COPY.write_text('"'), r"UNREADABLE .*reference/data/table.csv is not what .*SHA256SUMS"),
    "a digit changed in the copy": (
        lambda: change(COPY, "1.5", "1.5000000001"),
        r"UNREADABLE .*reference/data/table.csv is not what reference/SHA256SUMS names: git checkout",
    ),
    "no line in the manifest": (
        lambda: change("reference/SHA256SUMS", "data/table.csv", "data/other.csv"),
        "MISSING .*reference has no reference for it",
    ),
}


@pytest.mark.parametrize("what", LOST)
def test_a_damaged_reference(project, what, capsys):
    change("data/table.csv", "1.5", "1.5000000001")
    make, pattern = LOST[what]
    make()
    status, lines = verdicts(capsys)
    assert status == 1
    assert re.search(pattern, lines["data/table.csv"]), lines["data/table.csv"]


# What is done to the repository, whose files stand for the figures, and what is said of one with other bytes.
NO_HEAD = ["git", "update-ref", "-d", "HEAD"]
UNCOMMITTED = {
    "no repository": (lambda: shutil.rmtree(".git"), "no {} to compare with: clone the repository, or commit the file"),
    "not committed": (lambda: subprocess.run(NO_HEAD, check=True), "no {} to compare with"),
    "regenerated": (lambda: commit("figures"), "another {} than the reference names: commit it together"),
}


@pytest.mark.parametrize("what", UNCOMMITTED)
def test_a_figure_that_git_does_not_have_is_named(project, what, capsys):
    make, pattern = UNCOMMITTED[what]
    write_picture(1)
    change("figures/plot.csv", "1.5", "1.5000000001")
    make()
    status, lines = verdicts(capsys)
    assert status == 1
    for name in ("figures/plot.png", "figures/plot.csv"):
        assert re.search(f"MISSING .*git has {pattern.format(name)}", lines[name]), lines[name]
    others = [line for name, line in lines.items() if name not in ("figures/plot.png", "figures/plot.csv")]
    assert all(line.startswith("same bytes") for line in others)


def test_equal_bytes_need_no_git(project, capsys):
    shutil.rmtree(".git")
    assert verdicts(capsys)[0] == 0


def test_git_has_the_figures_that_the_reference_names():
    """Otherwise another machine has nothing to compare them with."""
    command = ["git", "ls-tree", "-r", "--name-only", "HEAD", "figures", "reference"]
    tree = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if tree.returncode:
        pytest.skip("this is no git repository")

    def content(name):
        return subprocess.run(["git", "show", f"HEAD:./{name}"], cwd=ROOT, capture_output=True).stdout

    names = set(tree.stdout.split())
    sums = {name: hashlib.sha256(content(name)).hexdigest() for name in names if name.startswith("figures/")}
    manifest = content("reference/SHA256SUMS").decode().splitlines()
    expected = dict(reversed(line.split("  ")) for line in manifest if "  figures/" in line)
    assert sums == {name: value for name, value in expected.items() if not name.endswith(artefacts.DRAWINGS)}
    assert not [name for name in names if name.startswith("reference/figures")]


def test_what_make_no_longer_builds_and_what_has_no_reference(project, capsys):
    status, lines = verdicts(capsys, FILES[1:], whole=True)
    assert status == 1 and re.match("MISSING .*no longer builds it", lines["data/table.csv"])
    status, lines = verdicts(capsys, FILES[1:2])
    assert status == 0 and list(lines) == ["data/long.csv"]
    Path("data/new.csv").write_text(TABLE)
    status, lines = verdicts(capsys, [*FILES, "data/new.csv"])
    assert status == 1 and "has no reference for it: make bless" in lines["data/new.csv"]


@pytest.mark.parametrize("content", [None, "no manifest\n", b"\xff\xfe", "0" * 64 + "  data/table.csv\n"])
def test_without_a_manifest_one_sentence(project, content, capsys):
    manifest = Path("reference/SHA256SUMS")
    manifest.unlink()
    if content:
        manifest.write_bytes(content if isinstance(content, bytes) else content.encode())
    capsys.readouterr()
    assert verification.main(["data/table.csv"]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and len(printed.err.splitlines()) == 1
    assert "git checkout reference, or make bless" in printed.err


def test_bless_replaces_what_changed_and_removes_what_went(project, capsys):
    Path("reference/README.md").write_text("kept")
    change("data/table.csv", "1.5", "2.5")
    capsys.readouterr()
    assert verification.main(["--bless", *map(str, FILES[:2])]) == 0
    assert "7 new or changed: data/model.npz, data/run.nc, data/table.csv" in capsys.readouterr().out
    assert sorted(path.name for path in Path("reference").rglob("*.*")) == ["README.md", "long.csv.xz", "table.csv"]
    assert verdicts(capsys, FILES[:2])[0] == 0


def test_bless_without_an_artefact_changes_nothing(project, capsys):
    before = {path: path.read_bytes() for path in Path("reference").rglob("*") if path.is_file()}
    Path("data/table.csv").unlink()
    write_long(-LONG)
    assert verification.main(["--bless", *map(str, FILES)]) == 1
    assert "data/table.csv missing: make all first" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in Path("reference").rglob("*") if path.is_file()}


def test_two_blesses_write_the_same_bytes(project):
    before = {path: path.read_bytes() for path in Path("reference").rglob("*") if path.is_file()}
    assert verification.bless(FILES, Path("reference")) == 0
    assert before == {path: path.read_bytes() for path in Path("reference").rglob("*") if path.is_file()}


def test_long_tables_are_compressed_and_whole(project):
    packed = Path("reference/data/long.csv.xz")
    assert lzma.decompress(packed.read_bytes()) == Path("data/long.csv").read_bytes()
    rows, values = artefacts.read_copy(packed)["a"]
    assert rows is None and np.allclose(values, LONG[:, 0], rtol=1e-11)
    artefacts.write_packed(Path("reference/data/long.csv"), b"short")
    assert not packed.exists() and Path("reference/data/long.csv").read_bytes() == b"short"


def test_copies_of_models_are_thinned_and_keep_both_ends(project):
    arrays = artefacts.read_copy(Path("reference/data/model.npz.csv"))
    assert len(arrays["K"][0]) == artefacts.ROWS and arrays["K"][0][-1] == 399 and arrays["noise"][0] == [0, 1]


def test_a_line_moved_by_its_width_looks_different(tmp_path, monkeypatch):
    """What `LOOKS` is for, at the size of the project's own figures."""
    monkeypatch.chdir(tmp_path)
    Path("figures").mkdir()
    picture = []
    for place in (0, 4):
        write_picture(place, 700)
        picture.append(artefacts.picture(Path("figures/plot.png")))
    assert ((picture[0] - picture[1]) ** 2).mean() ** 0.5 > verification.LOOKS


def test_equal_bytes_need_no_numpy():
    code = "import sys, tras.paper.verification; sys.exit('numpy' in sys.modules or 'matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
