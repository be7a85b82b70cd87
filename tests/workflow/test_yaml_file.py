"""YAML from others: hostile and damaged files are refused in one sentence, in no time."""

import pytest

from tras.sweeps.grid import points
from tras.workflow.parameters import ParameterError, check_parameters
from tras.workflow.yaml_file import MAX_BYTES, parse_yaml, read_yaml


class MineError(ValueError):
    pass


BOMB = "a0: &a0 [x, x]\n" + "".join(f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]\n" for k in range(1, 40))
REFUSED = {
    "a bomb of aliases": (BOMB, "line 1 has an anchor or alias .* write the value out"),
    "an alias": ("a: *b", "line 1 has an anchor or alias"),
    "an anchor of a mapping": ("a:\n  &b {c: 1}", "line 2 has an anchor or alias"),
    "lists in lists": ("a: " + "[" * 5000, "line 1 is nested more than 20 deep"),
    "mappings in mappings": ("{a: " * 5000, "line 1 is nested more than 20 deep"),
    "blocks in blocks": ("a:\n" + "- " * 300 + "b", "nested more than 20 deep"),
    "too many parts": ("[" + "1," * 25_000 + "]", "exceeds 20000 parts"),
    "a whole number of 5 000 digits": ("seed: " + "7" * 5000, "holds 7777.*no value that can be read"),
    "a whole number in hexadecimal": ("seed: 0x1" + "0" * 16, "whole number of more than 64 bits"),
    "a negative one": ("seed: -36893488147419103232", "whole number of more than 64 bits"),
    "sixties": ("seed: " + "1:" * 300 + "1", "no value that can be read"),
    "no number": ("duration: .nan", "holds .nan, which is no finite number"),
    "infinity": ("a: [1.0, -.inf]", "holds -.inf, which is no finite number"),
    "an overflow": ("seed: 1.0e+400", "holds 1.0e.400, which is no finite number"),
    "a date that is none": ("a: 2001-99-99", "holds 2001-99-99, which is no value that can be read"),
    "tags that lie": ("a: !!bool x", "holds x, which is no value"),
    "an empty float": ("a: !!float ''", "no value that can be read"),
    "a date without a date": ("a: !!timestamp x", "no value that can be read"),
    "a digit too few": ("a: 0b_", "holds 0b_, which is no value"),
    "a list for a name": ("? [a]\n: 1", "has a list in place of a name"),
    "a mapping for a name": ("? {a: 1}\n: 1", "has a dict in place of a name"),
    "a key twice": ("a: 1\nb: 2\na: 3", "`a` stands twice .line 1 on.: keep one"),
    "code": ("!!python/object/apply:os.system [ls]", "not valid YAML at line 1 .could not determine a constructor"),
    "a control character": ("a: \x07", "not valid YAML"),
    "half of it": ("a: [", "not valid YAML at line 1"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_hostile_text_is_refused_in_one_sentence(what):
    text, words = REFUSED[what]
    with pytest.raises(MineError, match=words) as caught:
        parse_yaml(text, "mine.yaml", MineError)
    sentence = str(caught.value)
    assert sentence.startswith("mine.yaml") and "\n" not in sentence and len(sentence) < 250


@pytest.mark.parametrize(
    "content, words",
    [
        (b"a: 1\nname: M\xfcller", "is not UTF-8 .line 2.: save it with the encoding UTF-8"),
        ("a: 1".encode("utf-16"), "is not UTF-8"),
        (b"a: 1\n" + b"#" * MAX_BYTES, f"has more than {MAX_BYTES} bytes"),
    ],
)
def test_hostile_files_are_refused_in_one_sentence(content, words, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes(content)
    with pytest.raises(MineError, match=f"mine.yaml {words}"):
        read_yaml(path, MineError)


@pytest.mark.parametrize("name", ["none.yaml", "."])
def test_what_is_no_file_is_named(name, tmp_path):
    with pytest.raises(ValueError, match="cannot be read .*: check the path"):
        read_yaml(tmp_path / name)


def test_plain_values_are_read(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes(b'\xef\xbb\xbfa: [1, 2.5, yes, null, text]\nb: {c: "&x *y", 3: 18446744073709551615}\n')
    assert read_yaml(path) == {"a": [1, 2.5, True, None, "text"], "b": {"c": "&x *y", 3: 2**64 - 1}}


@pytest.mark.parametrize("name, value", [("x" * 5000, 1), ("duration", "9" * 5000), ("seed", "9" * 5000)])
def test_long_names_and_values_are_cut_in_the_sentence(name, value):
    with pytest.raises(ParameterError) as caught:
        check_parameters({name: value}, {"duration": 1.0, "seed": 1}, "mine.yaml")
    assert len(str(caught.value)) < 300


def test_a_long_option_of_a_sweep_is_cut_in_the_sentence():
    for option in ({"delays": "9" * 5000}, {"strength": "9" * 5000}, {"dictionary": "9" * 5000}, {"9" * 5000: 1}):
        with pytest.raises(ValueError, match="^grid: ") as caught:
            points({"dictionary": "Monomials"} | option)
        assert len(str(caught.value)) < 300
