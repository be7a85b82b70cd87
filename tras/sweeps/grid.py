"""What a sweep (`tras.sweep`) varies: grids of options, and the points that they stand for."""

import inspect
import itertools
import math
from typing import NamedTuple

from sklearn.base import clone

from tras.dictionaries.base import Dictionary, label, spelled
from tras.dictionaries.kinds import KINDS
from tras.model import KoopmanModel
from tras.workflow import arguments
from tras.workflow.arguments import did_you_mean, short

MODEL = {name: parameter.default for name, parameter in inspect.signature(KoopmanModel).parameters.items()}
MAX_POINTS = 20_000  # of a sweep; so many take seconds to list and days to fit
DATA = {"seconds": None, "every": 1, "split_seed": 0}


class Point(NamedTuple):
    """One fit: an unfitted model, and what it is fitted to."""

    model: KoopmanModel
    seconds: float | None
    every: int
    split_seed: int

    def options(self) -> dict:
        """All options as a dict, the dictionary in a line of text."""
        model = {name: getattr(self.model, name) for name in MODEL}
        return {**model, "dictionary": label(self.model.dictionary), **{name: getattr(self, name) for name in DATA}}

    def identity(self) -> dict:
        """All that its result depends on beside the data, as JSON holds it."""
        return {"model": spelled(self.model), **{name: getattr(self, name) for name in DATA}}


def points(grid) -> list[Point]:
    """Every combination of a grid, or of several, once and in order.

    Parameters
    ----------
    grid : dict, KoopmanModel, or a list of these
        Option -> value or list of values. Options are the parameters of `KoopmanModel`, and ``seconds``, ``every`` and
        ``split_seed`` of `tras.sweep`. Dictionaries are objects, or as YAML has them: ``"Mechanical"``, ``{"Monomials":
        {"degree": [1, 2]}}`` (lists are values to combine; a parameter that is itself a list stands in another one) or
        ``{"Union": [..., ...]}``.

    Raises
    ------
    ValueError
        On an unknown option, dictionary or parameter, a value that is none, or more than 20 000 points.
    """
    every = {}
    for part in grid if isinstance(grid, (list, tuple)) else [grid]:
        if isinstance(part, KoopmanModel):
            part = part.get_params(deep=False)
        if not isinstance(part, dict):
            remedy = "give a dict option -> list of values, a KoopmanModel, or a list of these"
            raise ValueError(f"grid holds {short(repr(part), 60)}; {remedy}.")
        for point in _combinations(part):
            every.setdefault(str(point.identity()), point)
            _require_few(len(every))
    if not every:
        raise ValueError("grid is empty; give at least {'dictionary': [...]}.")
    return list(every.values())


def _combinations(part):
    for option in part:
        if option not in MODEL | DATA:
            raise ValueError(f"grid: there is no option {short(repr(option), 60)}{did_you_mean(option, MODEL | DATA)}")
    values = {option: _values(option, value) for option, value in part.items()}
    if "dictionary" not in values:
        raise ValueError("grid names no dictionary; give for example {'dictionary': [tras.Monomials(2)]}.")
    values["dictionary"] = [dictionary for spec in values["dictionary"] for dictionary in dictionaries(spec)]
    _require_few(math.prod(map(len, values.values())))
    for combination in itertools.product(*values.values()):
        options = dict(zip(values, combination))
        data = {name: options.pop(name, default) for name, default in DATA.items()}
        if data["seconds"] is not None:
            length = "the length of the training data in s, or None for all"
            arguments.number("grid: seconds", data["seconds"], 0, ends=False, give=length)
        arguments.whole_number("grid: every", data["every"])
        arguments.whole_number("grid: split_seed", data["split_seed"], 0)
        model = KoopmanModel(**options | {"dictionary": clone(options["dictionary"])})
        try:
            model.check_options()
        except ValueError as error:
            raise ValueError(f"grid: {error}") from None
        yield Point(model, **data)


def dictionaries(spec) -> list[Dictionary]:
    """Dictionaries that an object, a name, or a mapping of a name to parameters stands for; see `points`."""
    if isinstance(spec, Dictionary):
        return [spec]
    if isinstance(spec, str):
        spec = {spec: {}}
    if not isinstance(spec, dict) or len(spec) != 1:
        remedy = "give one such as tras.Monomials(2), in YAML {Monomials: {degree: 2}}"
        raise ValueError(f"grid: dictionary is {short(repr(spec), 60)}; {remedy}.")
    ((name, parameters),) = spec.items()
    if name not in KINDS:
        raise ValueError(f"grid: there is no dictionary {short(repr(name), 60)}{did_you_mean(name, KINDS)}")
    if name in ("Union", "Product"):
        if not isinstance(parameters, list) or not parameters:
            raise ValueError(f"grid: {name} has {short(repr(parameters), 60)}; give a list of dictionaries.")
        choices = [dictionaries(part) for part in parameters]
        _require_few(math.prod(map(len, choices)))
        return [KINDS[name](*map(clone, parts)) for parts in itertools.product(*choices)]
    parameters = parameters or {}
    if not isinstance(parameters, dict):
        raise ValueError(
            f"grid: {name} has {short(repr(parameters), 60)}; give its parameters by name: {{{name}: {{...}}}}."
        )
    known = KINDS[name]().get_params(deep=False)
    for parameter in parameters:
        if parameter not in known:
            raise ValueError(
                f"grid: {name} has no parameter {short(repr(parameter), 60)}{did_you_mean(parameter, known)}"
            )
    values = {parameter: _values(f"{name}: {parameter}", value) for parameter, value in parameters.items()}
    _require_few(math.prod(map(len, values.values())))
    return [KINDS[name](**dict(zip(values, combination))) for combination in itertools.product(*values.values())]


def _require_few(count):
    """Refuse a grid by the number of its points, before they are made."""
    if count > MAX_POINTS:
        number = f"{count}" if count < 1e12 else "more than 1e12"
        remedy = "give fewer values, or several smaller grids"
        raise ValueError(f"grid: {number} points or more, up to {MAX_POINTS} are fitted; {remedy}.")


def _values(option, value):
    values = list(value) if isinstance(value, (list, tuple)) else [value]
    if not values:
        raise ValueError(f"grid: {option} has no value; give one or more.")
    return values
