"""The layers of the house: which room of `tras/` may import which. CONTRIBUTING.md has the map."""

import graphlib

import pytest
from conftest import ROOT

from tras.workflow import staleness

FLAT_FILES = 15  # at most; what a stranger reads in an hour
EVERYWHERE = "workflow.arguments workflow.yaml_file"  # checks of numbers and names, parameters in files
METHOD = "flat analysis dictionaries solver io large display"
LEAVES = "workflow.files workflow.provenance"  # files moved into place, versions
BELOW_PAPER = f"{METHOD} twin_rotor identification control export sweeps workflow"
# Room (a folder of tras/; "flat" for the files beside them) -> the rooms or modules that it may import besides itself.
# `large` stands between `fitting` and `model`: a model reads through it what is larger than memory.
MAY_IMPORT = {
    "workflow": "",
    "dictionaries": "",
    "solver": "",
    "io": "workflow.files",
    "analysis": "display.plots predictors",
    "flat": f"analysis dictionaries solver io large display {LEAVES}",
    "display": "plotting metrics dictionaries.base workflow.page",
    "twin_rotor": f"recording {LEAVES}",
    "large": f"{METHOD} workflow",
    # The C of a controller is written by `export`; the command of `control` writes a controller, its page and its C.
    "export": f"{METHOD} control {LEAVES}",
    "control": f"{METHOD} twin_rotor export workflow",
    "identification": f"{METHOD} twin_rotor.excitation export control.command workflow",
    "sweeps": f"{METHOD} twin_rotor identification.search workflow",
    "paper": BELOW_PAPER,
    "explorer": f"{BELOW_PAPER} paper",
}


def imports(folder):
    """Module -> the modules that it imports, anywhere; without `tras.` and without the folders' docstrings."""
    package = staleness.Package(folder)
    modules = {module for module, path in package.paths.items() if path.name != "__init__.py"}
    short = {module: module.removeprefix(f"{package.name}.") for module in modules}
    return {short[m]: {short[other] for other in package.needs(package.tree(m), m) & modules - {m}} for m in modules}


def problems(graph):
    """A sentence for each import that the table forbids, for a circle, and for too many flat files."""
    sentences = []
    for module, others in sorted(graph.items()):
        room = module.split(".")[0] if "." in module else "flat"
        if room not in MAY_IMPORT:
            sentences.append(f"{module} is in no known room: add {room} to MAY_IMPORT")
            continue
        allowed = {room, *MAY_IMPORT[room].split(), *EVERYWHERE.split()}
        for other in sorted(others):
            if not {other, other.split(".")[0] if "." in other else "flat"} & allowed:
                sentences.append(f"{module} imports {other}")
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        sentences.append("circle: " + " <- ".join(error.args[1]))
    flat = [module for module in graph if "." not in module]
    if len(flat) > FLAT_FILES - 1:  # and __init__.py
        sentences.append(f"{len(flat) + 1} flat files, at most {FLAT_FILES}")
    return sentences


def test_every_import_goes_down():
    assert problems(imports(ROOT / "tras")) == []


# Files of a small package, and the sentences about it.
TREES = {
    "downwards": (
        {"model": "from tras.solver import basis", "solver/basis": "", "paper/grid": "import tras\ntras.fit"}, []),
    "upwards": ({"model": "from tras.paper import grid", "paper/grid": ""}, ["model imports paper.grid"]),
    "upwards, inside a function": (
        {"model": "", "solver/basis": "def f():\n    from tras.model import fit"}, ["solver.basis imports model"]),
    "upwards, by a public name": (
        {"model": "", "solver/basis": "import tras\ndef f():\n    tras.fit"}, ["solver.basis imports model"]),
    "upwards, relatively": ({"model": "", "io/text": "from ..model import fit"}, ["io.text imports model"]),
    "one module of a room": (
        {"io/text": "from tras.workflow import files, cache", "workflow/files": "", "workflow/cache": ""},
        ["io.text imports workflow.cache"]),
    "only for types": ({"model": "", "solver/basis": "if TYPE_CHECKING:\n    from tras.model import fit"}, []),
    "a circle": (
        {"model": "import tras.fitting", "fitting": "def f():\n    import tras.model"},
        ["circle: fitting <- model <- fitting"]),
    "an unknown room": ({"attic/box": ""}, ["attic.box is in no known room: add attic to MAY_IMPORT"]),
    "a full corridor": ({f"file{n}": "" for n in range(15)}, ["16 flat files, at most 15"]),
}  # fmt: skip


@pytest.mark.parametrize("what", TREES)
def test_the_checker_sees(what, tmp_path):
    files, expected = TREES[what]
    files = {"__init__": '_ROOMS = {"fit": "model"}'} | files
    for name, source in files.items():
        path = tmp_path / "tras" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source)
        (path.parent / "__init__.py").touch()
    assert [circle_from_first(sentence) for sentence in problems(imports(tmp_path / "tras"))] == expected


def circle_from_first(sentence):
    """The same circle, told from its first name in the alphabet."""
    if not sentence.startswith("circle: "):
        return sentence
    names = sentence.removeprefix("circle: ").split(" <- ")[1:]
    first = names.index(min(names))
    return "circle: " + " <- ".join([*names[first:], *names[: first + 1]])
