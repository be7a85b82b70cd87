"""Parameters of notebooks, read and checked before anything runs.

The one cell of a notebook tagged `parameters` assigns each parameter its default, which also gives its type. A file of
parameters has one section per notebook (`01_data_generation: {duration: 500.0}`). A name or a type that the cell does
not know is an error here, where papermill alone would warn and go on with the default.

The checks of types are ours: with pydantic they took as many lines, and 0.2 s of imports per stage.
"""

import ast
import json
import re
from pathlib import Path

from tras.workflow.arguments import did_you_mean, short
from tras.workflow.yaml_file import parse_yaml, read_yaml


class ParameterError(ValueError):
    """A parameter, or a file that should hold parameters, is not what the notebook needs."""


def notebook_defaults(notebook: str | Path) -> dict:
    """Parameters of a notebook, from its one cell tagged `parameters`: a dict, name -> default."""
    notebook = Path(notebook)
    cells = _read_notebook(notebook)["cells"]
    tagged = [cell for cell in cells if "parameters" in cell.get("metadata", {}).get("tags", [])]
    if len(tagged) != 1:
        count = "no cell" if not tagged else f"{len(tagged)} cells"
        raise ParameterError(f"{notebook} has {count} tagged `parameters`: tag just the code cell with the defaults.")
    source = "".join(tagged[0]["source"])
    try:
        body = ast.parse(source).body
    except SyntaxError as error:
        problem = f"is not Python (line {error.lineno}: {error.msg})"
        raise ParameterError(f"the `parameters` cell of {notebook} {problem}.") from None
    defaults = {}
    for node in body:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            continue  # a line of text
        try:
            (target,) = node.targets if isinstance(node, ast.Assign) else [node.target]
            if not isinstance(target, ast.Name) or isinstance(node, ast.AugAssign):
                raise ValueError
            defaults[target.id] = ast.literal_eval(node.value)
            if not isinstance(defaults[target.id], (type(None), bool, int, float, str, list, dict)):
                raise ValueError
        except (ValueError, TypeError, AttributeError):
            raise ParameterError(
                f"the `parameters` cell of {notebook} holds `{ast.get_source_segment(source, node)}`: only assignments "
                "`name = literal` (number, text, True, None, list, dict) may stand there; compute in the next cell."
            ) from None
    return defaults


def _read_notebook(notebook):
    try:
        content = json.loads(notebook.read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"the notebook {notebook} cannot be read ({error.strerror}): check the path.") from None
    except ValueError:
        content = None
    if not isinstance(content, dict) or "cells" not in content:
        raise ParameterError(f"{notebook} is not a notebook (nbformat 4): restore it from git.")
    return content


def read_params(path: str | Path, notebook: str | Path) -> dict:
    """One notebook's section of a parameter file.

    Parameters
    ----------
    path : str or Path
        YAML file: a mapping of notebook names (without `.ipynb`) to mappings of parameters.
    notebook : str or Path
        The notebook; the files beside it are the names that sections may have.

    Returns
    -------
    dict
        Name -> value; empty when the file has no section for the notebook.
    """
    path, notebook = Path(path), Path(notebook)
    content = read_yaml(path, ParameterError)
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ParameterError(f"{path} holds a {_kind(content)}: it must be a mapping, one section per notebook.")
    notebooks = sorted(other.stem for other in notebook.parent.glob("*.ipynb"))
    for name, section in content.items():
        if name not in notebooks:
            problem = f"{notebook.parent} has no such notebook{did_you_mean(name, notebooks)}"
            raise ParameterError(f"{path} has a section `{short(name)}`, but {problem}")
        if section is not None and not isinstance(section, dict):
            remedy = "write one `parameter: value` per line, indented"
            raise ParameterError(f"section `{name}` of {path} is a {_kind(section)}: {remedy}.")
    return content.get(notebook.stem) or {}


def parse_settings(settings: list[str]) -> dict:
    """`name=value` arguments of the command line as a dictionary, the values read as YAML.

    >>> parse_settings(["seed=3", "data_dir=build/data", "lags=[1, 2]"])
    {'seed': 3, 'data_dir': 'build/data', 'lags': [1, 2]}
    """
    values = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or not name.isidentifier():
            remedy = "write --set name=value, without blanks around '='"
            raise ParameterError(f"--set {setting} is not understood: {remedy}.")
        values[name] = parse_yaml(value, f"--set {short(setting)}", ParameterError)
    return values


def check_parameters(values: dict, defaults: dict, where: str) -> dict:
    """The values (name -> value) with the types of the defaults: a whole number in place of a float is a float.

    A name or a type that the defaults do not have, or a negative seed, is a ParameterError, which says ``where`` the
    values come from.
    """
    for name in values:
        if name not in defaults:
            raise ParameterError(f"{where}: there is no parameter `{short(name)}`{did_you_mean(name, defaults)}")
    checked = {name: _check(value, defaults[name], f"{where}: parameter `{name}`") for name, value in values.items()}
    for name, value in checked.items():
        if "seed" in name:
            for seed in value if isinstance(value, list) else [value]:
                if isinstance(seed, int) and seed < 0:
                    found = f"`{name}` is {short(repr(value), 60)}: a seed must be 0 or more"
                    raise ParameterError(f"{where}: parameter {found}; correct the value.")
    return checked


def _check(value, default, name):
    if default is None or (type(value) is type(default) and not isinstance(value, (list, dict))):
        return value
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if type(value) is not type(default):
        problem = f"{name} must be a {_kind(default)} (its default is {default!r})"
        raise ParameterError(f"{problem}, {_remedy(value, default)}")
    if isinstance(value, list):
        return [_check_like_one_of(item, default, f"{name}[{n}]") for n, item in enumerate(value)]
    examples = {key: [default[key]] if key in default else list(default.values()) for key in value}
    return {key: _check_like_one_of(item, examples[key], f"{name}[{key}]") for key, item in value.items()}


def _check_like_one_of(value, examples, name):
    """An element is right when it could stand for any element of the default; an empty default takes all."""
    problem = None
    for example in sorted(examples, key=lambda example: type(example) is not type(value)):
        try:
            return _check(value, example, name)
        except ParameterError as error:
            problem = problem or error
    if problem:
        raise problem
    return value


def _kind(value):
    names = {bool: "true or false", int: "whole number", float: "number", str: "text", list: "list", dict: "mapping"}
    return names.get(type(value), type(value).__name__)


def _remedy(value, default):
    problem = f"found {short(repr(value), 60)} ({_kind(value)})"
    if isinstance(value, str) and type(default) in (int, float) and _as_yaml_number(value):
        return f"{problem}: YAML takes {short(value)} for text, write {short(_as_yaml_number(value))} without quotes."
    if isinstance(default, str):
        return f"{problem}: put it in quotes."
    if isinstance(default, bool):
        return f"{problem}: write true or false, without quotes."
    return f"{problem}: correct the value."


def _as_yaml_number(text):
    """The spelling that YAML reads as a number: it wants a point in the mantissa and a sign in the exponent.

    >>> _as_yaml_number("1e-6"), _as_yaml_number("1.5e3"), _as_yaml_number("12"), _as_yaml_number("a")
    ('1.0e-6', '1.5e+3', '12', None)
    """
    try:
        float(text)
    except ValueError:
        return None
    match = re.fullmatch(r"([-+]?\d*)(\.\d*)?[eE]([-+]?)(\d+)", text.strip())
    return f"{match[1]}{match[2] or '.0'}e{match[3] or '+'}{match[4]}" if match else text.strip()
