"""Text from a file is data: one list of hostile texts (`conftest.HOSTILE`) through everything that writes text."""

import ast
import re
import shlex
import shutil
import subprocess
import unicodedata
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import yaml
from conftest import HOSTILE, LONE_SURROGATES
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.io import loadmat

import tras
from tras.explorer.choice import Choice, parameter_text
from tras.identification import command, folder
from tras.io import question
from tras.io.roles import Question, RecordingError, Roles, named
from tras.workflow import page
from tras.workflow.arguments import in_code, one_line, short, visible

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
NAMES = list(dict.fromkeys(text.replace("/", "|") for text in HOSTILE))  # no channel's name has a "/"
STANDARDS = (["-std=c99"], ["-std=c11"], ["-std=gnu99"], ["-std=c99", "-trigraphs"], ["-std=gnu11", "-trigraphs"])


def is_seen(letter):
    return letter in "\n\t" or unicodedata.category(letter) not in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


def each(function):
    """A property of texts: for the whole list, and for whatever hypothesis thinks of."""
    for text in HOSTILE + LONE_SURROGATES:
        function = example(text)(function)
    return given(st.text())(function)


@each
def test_text_is_seen(text):
    assert all(map(is_seen, visible(text))) and visible(visible(text)) == visible(text)
    assert one_line(text).splitlines() in ([], [one_line(text)]) and len(short(text)) <= 40
    assert visible(text) == text or not text.isprintable() or re.search("[\u3164\uffa0\u115f\ufe00-\U000e01ef]", text)


@each
def test_text_in_code_is_of_the_safe_alphabet(text):
    safe = in_code(text)
    assert all(map(is_seen, safe)) and safe.splitlines() in ([], [safe]) and in_code(safe) == safe
    assert not any(sign in safe for sign in ("\\", "*/", "/*", "??", "\t"))


def test_what_people_write_stays():
    for text in ("phi (°)", "µ°Ω m/s²", "שלום", "角度", "a\u00a0%"):
        assert visible(text) == text
    assert in_code("Winkel φ (°/s)") == "Winkel φ (°/s)"


# --- exports ---


def model_of(names, units, predictor):
    """A small model of one input and of states of these names."""
    rng = np.random.default_rng(0)
    u, x0 = rng.uniform(-1, 1, (200, 10, 1)), rng.uniform(-1, 1, (200, 1, len(names) - 1))
    x = x0 * 0.9 ** np.arange(10)[:, None]
    labels = {"state_names": names[1:], "input_names": names[:1], "state_units": units[1:], "input_units": units[:1]}
    return tras.KoopmanModel(tras.Monomials(1), predictor, strength=0.1).fit(tras.Recording(x, u, 0.1, **labels))


@pytest.fixture(scope="module", params=["vector_field", "one_step", "lifted_linear"])
def hostile(request):
    units = (HOSTILE[::-1] * 2)[: len(NAMES)]
    return model_of(NAMES, units, request.param)


@pytest.fixture(scope="module")
def harmless(hostile):
    names = [f"name{i}" for i in range(len(NAMES))]
    return model_of(names, names, hostile.predictor)


def bare_c(text):
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def of_model(model, path):
    return tras.export.to_c(model, path, slopes=True)


def of_controller(model, path):
    observer = tras.Observer(model, measured=model.state_names_[:3])
    return tras.export.controller_to_c(tras.LQR(model, observer=observer), path)


@pytest.mark.parametrize("export", [of_model, of_controller])
def test_c_is_the_code_of_a_model_with_harmless_names(export, hostile, harmless, tmp_path):
    (tmp_path / "plain").mkdir()
    files = export(hostile, tmp_path / "rig.c")
    for file, plain in zip(files, export(harmless, tmp_path / "plain" / "rig.c")):
        text = file.read_text(encoding="utf-8")
        assert bare_c(text) == bare_c(plain.read_text(encoding="utf-8"))
        assert "PWNED" in text or export is of_controller and file.suffix == ".c"
        assert all(map(is_seen, text)) and "\\" not in text and "??" not in text
    if CC is None:
        pytest.skip("no C compiler (cc, gcc, clang) is installed, so the generated C cannot be compiled here")
    for standard in STANDARDS:
        flags = [*standard, "-Wall", "-Wextra", "-pedantic", "-Werror", "-c", "rig.c", "-o", "rig.o"]
        done = subprocess.run([CC, *flags], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0 and not done.stderr, done.stderr[:3000]


def test_matlab_is_the_code_of_a_model_with_harmless_names(hostile, harmless, tmp_path):
    (tmp_path / "plain").mkdir()
    data, *files = tras.export.to_matlab(hostile, tmp_path / "rig.mat")
    code = lambda text: [line for line in text.splitlines() if not line.startswith("% ")]  # noqa: E731
    for file, plain in zip(files, tras.export.to_matlab(harmless, tmp_path / "plain" / "rig.mat")[1:]):
        text = file.read_text(encoding="utf-8")
        assert code(text) == code(plain.read_text(encoding="utf-8"))
        assert all(map(is_seen, text)) and ("PWNED" in text or file.stem.endswith("read"))
    cells = loadmat(data, simplify_cells=True)["state_names"]
    assert [str(name) for name in cells] == list(hostile.state_names_)  # data stay what they are
    if OCTAVE and hostile.predictor != "lifted_linear":
        call = f"x = rig_step(zeros({len(NAMES) - 1}, 1), 0); assert(all(isfinite(x)))"
        done = subprocess.run([OCTAVE, "--eval", call], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0 and "PWNED" not in done.stdout + done.stderr


def test_formulas_are_formulas(hostile):
    if hostile.predictor == "lifted_linear":
        with pytest.raises(ValueError, match="steps in the lifted space"):
            tras.export.formulas(hostile)
        return
    text = tras.export.formulas(hostile, tolerance=0.01)
    assert all(map(is_seen, text)) and "PWNED" in text
    lines = [line for line in text.splitlines() if not line.startswith("# ")]
    assert len(lines) == len(NAMES) - 1 and all(isinstance(each, ast.Assign) for each in ast.parse(text).body)
    assert not any(isinstance(node, (ast.Call, ast.Attribute, ast.Constant)) and "PWNED" in ast.unparse(node)
                   for node in ast.walk(ast.parse(text)))  # fmt: skip
    notes, _, block = tras.export.formulas(hostile, tolerance=0.01, latex=True).partition(r"\begin{aligned}")
    assert all(line.startswith("% ") for line in notes.splitlines()) and "PWNED" in notes
    commands = set(re.findall(r"\\([A-Za-z]+|.)", block))
    assert commands <= {*"\\ , end frac left right cdot mathrm dot pi".split()}
    assert not set("%#$~") & set(block) and "^^" not in block and block.count(r"\end") == 1


@pytest.mark.parametrize("name", [*HOSTILE, *LONE_SURROGATES])
def test_files_of_hostile_names_are_safe_or_refused(name, tmp_path):
    """The generated files name each other."""
    name = name.replace("/", "|").replace("\0", "")[:60]
    model = model_of(["u", "x"], ["", ""], "one_step")
    for export, suffix in ((tras.export.to_c, ".c"), (tras.export.to_matlab, ".mat"), (of_controller, ".c")):
        path = tmp_path / f"{name}{suffix}"
        if path.name != in_code(path.name) or set("\"'") & set(name):
            with pytest.raises(ValueError, match="which the generated files cannot hold; give one without"):
                export(model, path)
            continue
        files = export(model, path)
        if suffix == ".c" and CC:
            flags = [
                *STANDARDS[-1],
                "-Wall",
                "-Wextra",
                "-pedantic",
                "-Werror",
                "-c",
                "-o",
                str(tmp_path / "a.o"),
                "--",
            ]
            done = subprocess.run([CC, *flags[:-1], str(files[1])], capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
    assert not [each for each in tmp_path.rglob("*PWNED*") if each.suffix == ""]


# --- pages ---


def is_harmless(html):
    """The page is XML without scripts, handlers or links that lead out, all its text is seen."""
    tree = ElementTree.fromstring(html.removeprefix("<!DOCTYPE html>\n"))
    tags = {element.tag.rpartition("}")[2] for element in tree.iter()}
    attributes = {(name, value) for element in tree.iter() for name, value in element.items()}
    # An anchor, or a file of the page's own folder.
    inside = re.compile(r"#.*|data:.*|(?!.*\.\.)[\w.-]+(/[\w.-]*)*", re.ASCII | re.DOTALL)
    outside = [v for name, v in attributes if name in ("href", "src") and not inside.fullmatch(v)]
    return (
        not tags & {"script", "iframe", "object", "form"}
        and not outside
        and not any(name.startswith("on") for name, _ in attributes)
        and all(map(is_seen, "".join(tree.itertext()) + "".join(value for _, value in attributes)))
    )


def test_a_page_of_hostile_texts():
    contents, cells = [], [page.escape(text) for text in HOSTILE]
    convert = page.converter(None, contents)
    parts = [convert(f"# {folder_title(text)}") + convert(f"## {folder_title(text)}") for text in HOSTILE]
    parts.append(page.table(cells, [cells], page.escape("".join(HOSTILE))))
    html = page.frame(HOSTILE[0], "".join(parts), contents)
    assert is_harmless(html) and len(contents) == len(HOSTILE)


def folder_title(text):
    from tras.identification.page import _plain

    return f"Identification of {_plain(text)}"


@pytest.fixture(scope="module")
def identification():
    """Two states and an input, each with a hostile name and unit, and the recording."""
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, (8, 60, 1))
    x = np.zeros((8, 60, 2))
    for k in range(59):
        x[:, k + 1] = x[:, k] @ [[0.9, -0.1], [0.1, 0.9]] + u[:, k] * [0.1, 0.2]
    x += 0.001 * rng.normal(size=x.shape)
    names = ["*\\\n| #error PWNED", "<script>PWNED<|script>\u202e", "\\input{PWNED}\u2028#error"]
    units = ["*\\\n/ #error PWNED", "`touch PWNED`\x1b[2J", "*??/\n/\n#error PWNED"]
    log = tras.Recording(
        x, u, 0.1, state_names=names[:2], input_names=names[2:], state_units=units[:2], input_units=units[2:],
        attributes={"guessed": HOSTILE, "noticed": HOSTILE, "source": HOSTILE[0]},
    )  # fmt: skip
    return tras.identify(log, predictor="one_step", delays=[0], smoothing=False, draws=2), log


@pytest.mark.filterwarnings("ignore:Glyph .* missing")
def test_the_folder_of_an_identification(identification, tmp_path):
    result, log = identification
    folder.write(result, log, "\n# <script>PWNED</script>\u202e.csv", tmp_path / "out")
    assert is_harmless((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    for text in (result.model.report(log), repr(result), repr(log), repr(result.advice)):
        assert all(map(is_seen, text))
    for html in (result._repr_html_(), log._repr_html_(), result.model._repr_html_(), result.advice._repr_html_()):
        assert is_harmless(f"<div>{html}</div>")
    if CC:
        flags = [
            "-std=c99",
            "-trigraphs",
            "-Wall",
            "-Wextra",
            "-pedantic",
            "-Werror",
            "-c",
            "model.c",
            "-o",
            "../../a.o",
        ]
        done = subprocess.run([CC, *flags], cwd=tmp_path / "out" / "export", capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[:3000]
    assert not list(tmp_path.rglob("PWNED*"))


def test_yaml_of_the_explorer():
    text = parameter_text(Choice(), "\nPWNED: 1")
    assert "PWNED" in text.splitlines()[0] and "PWNED" not in yaml.safe_load(text)


# --- questions, commands, messages ---


def hint(names, path):
    """The text of a question about columns of these names, in which the command calls each of them."""
    table = [(str(i), name, name, "0 to 1", "state?") for i, name in enumerate(names, 1)]
    answer = Roles(names[0], list(names[1:-1]), [names[-1]], None, None, {})
    return str(RecordingError(question.screen(Question(["why"], table, answer), [path])))


def test_the_command_of_a_question_runs_nothing_but_itself(tmp_path):
    """Pasted into a shell, it calls `make identify` with arguments that name the columns."""
    names = list(dict.fromkeys(HOSTILE))
    text = hint(names, "$(touch PWNED) `touch PWNED` it's.csv")
    assert all(map(is_seen, text)) and len(text.splitlines()) == 28 + 5
    line = next(line for line in text.splitlines() if line.startswith("  make identify "))
    script = f"make() {{ printf '%s\\0' \"$@\"; }}\n{line}"
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True)
    words = dict(word.partition("=")[::2] for word in done.stdout.split("\0")[1:-1])
    assert done.returncode == 0 and not done.stderr and not list(tmp_path.iterdir())
    assert words.keys() == {"RECORDING", "TIME", "STATES", "INPUTS"}
    assert words["RECORDING"] == "$(touch PWNED) `touch PWNED` it's.csv"
    columns = [name for role in ("TIME", "STATES", "INPUTS") for name in command._names(words[role])]
    assert [named(column, names) for column in columns] == names
    roles = ast.literal_eval(text.splitlines()[-1].removeprefix("In Python, roles="))
    assert [named(column, names) for column in (roles["time"], *roles["states"], *roles["inputs"])] == names
    assert shlex.split(line)[:2] == ["make", "identify"]


def test_messages_about_a_file_are_seen(tmp_path):
    names = [text.replace("\0", "") for text in dict.fromkeys(HOSTILE)]
    path = tmp_path / "log.parquet"
    pd = pytest.importorskip("pandas")
    pd.DataFrame(np.random.default_rng(0).normal(size=(30, len(names))), columns=names).to_parquet(path)
    for roles in (None, {"states": ["PWNED"]}, {"states": [names[0], names[0]]}, {"PWNED\u202e": 1}, {"dt": "\u202e"}):
        with pytest.raises(tras.RecordingError) as caught:
            tras.Recording.read(path, roles)
        assert all(map(is_seen, str(caught.value)))


@pytest.mark.parametrize("text", LONE_SURROGATES)
def test_lone_surrogates_are_refused_where_they_enter(text, tmp_path, capsys):
    data = {"states": np.zeros((1, 3, 1)), "inputs": np.zeros((1, 3, 1)), "dt": 0.1}
    for labels in (
        {"state_names": [text]}, {"input_names": [text]}, {"state_units": [text]}, {"input_units": [text]},
        {"attributes": {text: 1}}, {"attributes": {"a": text}}, {"attributes": {"a": [{"b": text}]}},
        {"attributes": {"a": {text: 1}}},
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"holds '.*\\ud.*\(a lone surrogate\); rename it"):
            tras.Recording(**data, **labels)
    with pytest.raises(tras.RecordingError, match="lone surrogate"):
        tras.Recording.read(tmp_path / f"{text}.csv")
    assert command.main([str(tmp_path / f"{text}.csv")]) == 2
    assert "RECORDING holds" in capsys.readouterr().err
