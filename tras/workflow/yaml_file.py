"""YAML that people exchange, roles, parameters and sweeps: plain values of limited size, or one sentence.

No anchors and aliases, with which a few lines stand for gigabytes; no file, depth or number larger than parameters
need; no NaN or infinity, which no parameter of ours may be.
"""

import math
from pathlib import Path

from tras.workflow.arguments import short

MAX_BYTES = 2**18
MAX_DEPTH = 20
MAX_PARTS = 20_000  # mappings, lists and values
_BITS = 64  # of whole numbers
_DIGITS = 400  # of any number: Python reads no more than 4300
# What PyYAML's constructors raise when a text is not of the kind that it is tagged or looks like: 2001-99-99, !!bool x.
_NO_VALUE = (ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError, RecursionError)


class _RefusedError(Exception):
    """What is wrong, to be told with the file's name."""


def read_yaml(path: str | Path, error: type[ValueError] = ValueError):
    """The content of a YAML file in UTF-8, with or without a byte order mark; see `parse_yaml`.

    Raises
    ------
    ValueError
        Of the type ``error``, one sentence that begins with the path: if the file cannot be read or is too large, is
        no UTF-8, or as for `parse_yaml`.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as problem:
        raise error(f"{path} cannot be read ({problem.strerror}): check the path.") from None
    if len(content) > MAX_BYTES:
        raise error(f"{path} has more than {MAX_BYTES} bytes, too many for YAML of parameters: check the path.")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        place = f"line {content[: problem.start].count(10) + 1}"
        raise error(f"{path} is not UTF-8 ({place}): save it with the encoding UTF-8.") from None
    return parse_yaml(text, path, error)


def parse_yaml(text: str, where, error: type[ValueError] = ValueError):
    """YAML of plain values, with an error instead of silence when a key stands twice.

    Parameters
    ----------
    text : str
    where : str or Path
        Where it comes from; the sentence of an error begins with it.
    error : type
        Of the error: ValueError or a kind of it.

    Raises
    ------
    ValueError
        Of the type ``error``: if it is no YAML, has an anchor or alias, a key twice, a number that is not finite or has
        more than 64 bits, or more than 20 levels or 20 000 parts.

    Examples
    --------
    >>> parse_yaml("seed: 3", "mine.yaml")
    {'seed': 3}
    >>> parse_yaml("a: &x [1]", "mine.yaml")
    Traceback (most recent call last):
        ...
    ValueError: mine.yaml: line 1 has an anchor or alias (& or *), which are not read: write the value out, ...
    """
    import yaml

    def refuse(node, problem):
        raise _RefusedError(f"line {node.start_mark.line + 1} {problem}.")

    class Loader(yaml.SafeLoader):
        depth = parts = 0

        def compose_node(self, parent, index):
            event = self.peek_event()
            if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
                problem = "has an anchor or alias (& or *), which are not read"
                refuse(event, f"{problem}: write the value out, or put it in quotes")
            self.depth, self.parts = self.depth + 1, self.parts + 1
            if self.depth > MAX_DEPTH:
                refuse(event, f"is nested more than {MAX_DEPTH} deep: make it flatter")
            if self.parts > MAX_PARTS:
                refuse(event, f"exceeds {MAX_PARTS} parts, too many for parameters: check the file")
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

        def construct_object(self, node, deep=False):
            word = short(node.value) if isinstance(node, yaml.ScalarNode) else node.id
            try:
                if node.tag.endswith((":int", ":float")) and len(node.value) > _DIGITS:
                    raise ValueError
                value = super().construct_object(node, deep)
            except _NO_VALUE:
                refuse(node, f"holds {word}, which is no value that can be read: correct it, or put it in quotes")
            if isinstance(value, float) and not math.isfinite(value):
                refuse(node, f"holds {word}, which is no finite number: write one")
            if isinstance(value, int) and value.bit_length() > _BITS:
                refuse(node, f"holds {word}, a whole number of more than {_BITS} bits: write a smaller one")
            return value

        def construct_mapping(self, node, deep=False):
            keys = set()
            for key_node, _ in node.value if isinstance(node, yaml.MappingNode) else ():
                key = self.construct_object(key_node, deep=True)
                if isinstance(key, (list, dict, set)):
                    refuse(key_node, f"has a {type(key).__name__} in place of a name: write a text")
                if key in keys:
                    raise _RefusedError(f"`{short(key)}` stands twice (line {node.start_mark.line + 1} on): keep one.")
                keys.add(key)
            return super().construct_mapping(node, deep)

    try:
        return yaml.load(text, Loader)  # a SafeLoader: plain values only
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        line = f" at line {mark.line + 1}" if mark else ""
        reason = short(getattr(problem, "problem", None) or problem, 100)
        raise error(f"{where} is not valid YAML{line} ({reason}): correct it.") from None
    except _RefusedError as problem:
        raise error(f"{where}: {problem}") from None
