"""One choice of experiment, model and judgement: what the explorer's controls and a parameter file hold.

What the paper leaves open has the words of `tras.paper.readings`; the rest comes on top. The defaults are the paper's.

`write_parameters` writes a choice as ``params/NAME.yaml``, with which `make all PROFILE=NAME` runs every stage. Stage
09 takes the whole choice, the others the part that concerns them. The studies 05 and 07 vary the data and need enough
of them; on a recording other than the paper's they run at the small size of params/smoke.yaml.
"""

import re
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from tras.paper import readings
from tras.paper.grid import FREQUENCY
from tras.workflow.arguments import in_code, number, whole_number
from tras.workflow.files import project_root, replacing
from tras.workflow.yaml_file import read_yaml

FIRST_LINE = "# Written by the explorer (notebooks/explore.ipynb)"
RESERVED = ("paper", "smoke")  # profiles of the project itself
SHARED = ("input", "frequency_unit", "state", "nrmse_range")  # fields whose choices are those of a reading
# field -> choices, the default first, each with what it means
OPTIONS = {name: readings.OPTIONS[name][1] for name in SHARED} | {
    "state": {
        "four_states": "the model knows angles and rates",
        "delayed_angles": "the model knows the two angles alone, now and `delays` samples earlier",
    },
    "dictionary": {
        "gaussian": "Gaussians at random centres beside constant, states and inputs",
        "linear": "constant, states and inputs alone",
        "monomials": "products of states and inputs",
        "exponentials": "growing and falling exponentials of all channels",
        "fourier": "cosines and sines of all channels",
        "mechanical": "what the equations of motion of a mechanical system allow",
    },
    "predictor": {
        "vector_field": "integrate F, as the paper does",
        "one_step": "apply K and lift again at each sample",
        "lifted_linear": "lift once, then one matrix from sample to sample",
    },
    "field": {
        "least_squares": "F by equation (18), as the paper does",
        "coordinates": "F from the states' own columns of A",
    },
    "regularization": {
        "none": "plain least squares, as the paper does",
        "shrink": "draws the coefficients towards the linear model",
        "tikhonov": "draws all coefficients towards no change",
        "truncated": "leaves out the smallest singular values",
        "sparse": "leaves out the functions that contribute least",
    },
    "extrapolation": {
        "functions": "the model trusts the functions beyond the data",
        "linear": "beyond the data the model goes on linearly",
    },
}
# field -> (lowest, highest, unit)
RANGES = {
    "duration": (1.0, 2000.0, "s"),
    "sampling_time": (0.005, 0.5, "s"),
    "seed": (1, 10_000, ""),
    "noise": (0.0, 20.0, "% of each state's range"),
    "width": (0.05, 20.0, "in scaled channels"),
    "delays": (0, 10, "samples"),
    "strength": (0.0, 1.0, ""),
    "horizon": (0.05, 100.0, "s"),
}
# dictionary -> (lowest, highest and usual size, what the size is)
SIZES = {
    "gaussian": (1, 200, 2, "the number of centres"),
    "linear": (1, 200, 1, "without meaning"),
    "monomials": (1, 5, 2, "the degree"),
    "exponentials": (1, 2, 1, "the order"),
    "fourier": (1, 2, 1, "the order"),
    "mechanical": (1, 12, 8, "the degree in pitch"),
}


class ChoiceError(ValueError):
    """A choice that cannot be made, gives no model, or has no name for its file."""


@dataclass(frozen=True)
class Choice:
    """Everything that the explorer offers, checked.

    Parameters
    ----------
    input, frequency_unit, dictionary, state, predictor, field, regularization, extrapolation, nrmse_range : str
        See `OPTIONS`.
    duration, sampling_time : float
        Of the training recording, in s.
    seed : int
        Of the excitation, the noise and the random centres; validation takes the next one.
    noise : float
        On the states of the training recording, in percent of each one's range.
    size : int
        Centres, degree or order; see `SIZES`.
    width : float
        Of the Gaussians, in channels scaled to [-1, 1].
    delays : int
        Earlier samples that count as states.
    strength : float
        Of the regularization; see `tras.regularization`.
    horizon : float
        Length of the validation windows, in s.

    Raises
    ------
    ChoiceError
        (a ValueError) For a value that is not allowed, in one sentence.

    Examples
    --------
    >>> Choice(dictionary="monomials", size=9)
    Traceback (most recent call last):
        ...
    tras.explorer.choice.ChoiceError: size is 9; give 1 to 5: with dictionary = monomials it is the degree.
    """

    input: str = "reference"
    frequency_unit: str = "rad/s"
    duration: float = 500.0
    sampling_time: float = 0.01
    seed: int = 1
    noise: float = 0.0
    dictionary: str = "gaussian"
    size: int = 2
    width: float = 1.0
    state: str = "four_states"
    delays: int = 0
    predictor: str = "vector_field"
    field: str = "least_squares"
    regularization: str = "none"
    strength: float = 0.01
    extrapolation: str = "functions"
    horizon: float = 6.0
    nrmse_range: str = "validation_set"

    def __post_init__(self):
        for name, meanings in OPTIONS.items():
            if getattr(self, name) not in meanings:
                raise ChoiceError(f"{name} is {getattr(self, name)!r}: choose one of {', '.join(meanings)}.")
        for name, (low, high, unit) in RANGES.items():
            whole = isinstance(getattr(type(self), name), int)
            check, kind = (whole_number, "whole number") if whole else (number, "number")
            allowed = f"a {kind} from {low:g} to {high:g} {unit}".rstrip()
            check(name, getattr(self, name), low, high, give=allowed, error=ChoiceError)
        low, high, _, meaning = SIZES[self.dictionary]
        allowed = f"{low} to {high}: with dictionary = {self.dictionary} it is {meaning}"
        whole_number("size", self.size, low, high, give=allowed, error=ChoiceError)

    def replaced(self, **changes) -> "Choice":
        """A copy with other values, checked."""
        return replace(self, **changes)

    def as_dict(self) -> dict:
        """Name -> value, in order."""
        return asdict(self)

    def reading(self) -> readings.Readings:
        """The `Readings` nearest to the choice: the default where the paper's text has no name for what is chosen."""
        names = (f"{self.dictionary}{self.size}", self.dictionary)  # gaussian28, monomials2; gaussian, linear
        dictionary = next((name for name in names if name in readings.choices("dictionary")), "gaussian")
        return readings.Readings(dictionary=dictionary, **{name: getattr(self, name) for name in SHARED})


def choice_of(values: dict) -> Choice:
    """A `Choice` from a mapping, such as a section of a parameter file; what is left out has its default."""
    names = [field.name for field in fields(Choice)]
    for name in values:
        if name not in names:
            raise ChoiceError(f"there is no {name!r} to choose: there are {', '.join(names)}.")
    if values.get("state") == "angles":  # files of the explorer before it took the word of the readings
        values = {**values, "state": "delayed_angles"}
    return Choice(**values)


_CUBIC = {"input": "torque", "dictionary": "monomials", "size": 3, "field": "coordinates"}
_MECHANICAL = {"input": "torque", "dictionary": "mechanical", "size": 8}

# Choices worth a look, in the order of explore.ipynb
EXAMPLES = {
    "the paper's text": Choice(),
    "nearest with one change": Choice(nrmse_range="trajectory"),
    "torques as input": Choice(input="torque"),
    "torques, cubic terms": Choice(**_CUBIC),
    "torques, functions for mechanics": Choice(**_MECHANICAL, field="coordinates", extrapolation="linear"),
    "the same, F by equation (18)": Choice(**_MECHANICAL),
    "cubic terms, 100 s of data": Choice(**_CUBIC, duration=100.0),
    "the same, linear beyond the data": Choice(**_CUBIC, duration=100.0, extrapolation="linear"),
    "two angles and one delay": Choice(state="delayed_angles", delays=1),
    "functions for mechanics, 1 % noise": Choice(**_MECHANICAL, noise=1.0),
}


def parameter_sections(choice: Choice, small: dict | None = None) -> dict[str, dict]:
    """What the choice means for each notebook: notebook -> {parameter: value}, without those that keep their defaults.

    ``small`` has the same form: the parameters of the studies 05 and 07 for recordings other than the paper's.
    """
    paper, factor = Choice(), FREQUENCY[choice.frequency_unit]
    notebooks = {
        "01_data_generation": {
            "duration": choice.duration, "sampling_time": choice.sampling_time, "train_seed": choice.seed,
            "validation_seeds": [choice.seed + k for k in (1, 2, 3, 4)],
            "pitch_max_frequency": 0.2 * factor, "yaw_max_frequency": 0.8 * factor,
            "short_duration": min(120.0, choice.duration),
        },
        "02_identification": {"field": choice.field},
        "03_validation": {"window": choice.horizon, "free_run": choice.duration},
        "06_readings": {
            "default": choice.reading().model_dump(), "duration": choice.duration,
            "sampling_time": choice.sampling_time, "window": choice.horizon,
        },
        "09_pictures": {"choice": choice.as_dict()},
    }  # fmt: skip
    if choice.dictionary == "gaussian":
        gaussians = {"rbf_centres": choice.size, "rbf_width": choice.width, "rbf_seed": choice.seed - 1}
        notebooks["02_identification"] |= gaussians
    if any(getattr(choice, name) != getattr(paper, name) for name in ("duration", "sampling_time", "frequency_unit")):
        notebooks |= {name: section | notebooks.get(name, {}) for name, section in (small or {}).items()}
    return dict(sorted(notebooks.items()))


def parameter_text(choice: Choice, name: str, small: dict | None = None) -> str:
    """The file: YAML that `tras.workflow.parameters` reads."""
    import yaml

    body = yaml.safe_dump(parameter_sections(choice, small), sort_keys=False, allow_unicode=True)
    return f"{FIRST_LINE}: make all PROFILE={in_code(name)} runs it.\n\n{body}"


def write_parameters(choice: Choice, name: str, folder: str | Path | None = None) -> Path:
    """Write ``NAME.yaml`` into a folder, by default ``params/`` of the project, and return its path.

    Raises
    ------
    ChoiceError
        (a ValueError) If the name has other characters than letters, digits, ``-`` and ``_``, is one of the project's
        own, or belongs to a file that the explorer has not written.
    """
    folder = Path(folder or project_root() / "params")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise ChoiceError(f"NAME is {name!r}: give letters, digits, - and _, beginning with a letter or digit.")
    path = folder / f"{name}.yaml"
    if name in RESERVED or (path.exists() and not path.read_text(encoding="utf-8").startswith(FIRST_LINE)):
        raise ChoiceError(f"NAME is {name!r}, and {path.name} is not the explorer's: choose another name.")
    smoke = project_root() / "params" / "smoke.yaml"
    parameters = read_yaml(smoke)
    small = {study: parameters[study] for study in ("05_robustness", "06_readings", "07_comparison")}
    with replacing(path) as temporary:
        temporary.write_text(parameter_text(choice, name, small), encoding="utf-8")
    return path
