"""What the paper's text leaves open, as named options with a default; a `Readings` holds one choice per option.

`tras.paper.grid` studies all combinations, but ``gains`` and ``plant`` one at a time round the nearest readings.
"""

from pathlib import Path
from typing import Literal

import pandas as pd
import pydantic

from tras.twin_rotor.plant import LUMPED
from tras.workflow import yaml_file
from tras.workflow.arguments import did_you_mean
from tras.workflow.files import markdown_table

PAPER_NRMSE = {"yaw": 4.0589, "pitch": 5.5889}  # percent, by the words of Sec. III
PAPER_FIT = {"field": "least_squares", "regularization": None, "extrapolation": "functions"}  # of `tras.KoopmanModel`
# option -> (the paper's own words, {choice: what it means}); the default is the first choice.
OPTIONS = {
    "input": (
        "In our study, we incorporate two controlled inputs: yaw input  $(u_1)$  and pitch input  $(u_2)$ , both "
        "measured in radians.",
        {
            "reference": "the reference angles in rad, as the sentence says; "
            "with the PID inside the loop the four states are then not closed",
            "torque": "the torques in N m that act on the plant, whose motion they determine exactly",
        },
    ),
    "frequency_unit": (
        "The maximum frequency of  $u_1$  and  $u_2$  are 0.8 and 0.2 rad/cycle respectively while minimum frequency "
        "is 0 rad/cycle.",
        {
            "rad/s": "63 lines in yaw and 15 in pitch over 500 s, no saturation",
            "Hz": "2 pi times higher: 400 and 100 lines, yaw often saturated",
        },
    ),
    "dictionary": (
        'This involved employing a "Gauss radial basis function (RBF)" of maximum degree  $w = 2$  in conjunction '
        "with the training data gathered.",
        {
            "gaussian": "two Gaussians of width 1 at random centres beside constant, states and inputs, N = 9, "
            "as in the public code of the method",
            "gaussian28": "28 Gaussians, as many as there are monomials of degree 2",
            "monomials2": "the 28 monomials of degree 2 in 4 states and 2 inputs, by which the text counts",
            "monomials3": "the 84 monomials of degree 3",
            "exponentials": "one growing and one falling exponential per channel, N = 19; "
            'the text names "exponentials" too',
            "linear": "constant, states and inputs alone, N = 7: the measure of what the other functions add",
        },
    ),
    "state": (
        "However, for our analysis, we selectively extract the yaw and pitch angles as the outputs of interest.",
        {
            "four_states": "angles and rates are the model's state, the two angles are compared",
            "delayed_angles": "the model knows the two angles alone, now and one sample earlier",
        },
    ),
    "horizon": (
        "Under identical initial conditions and control inputs, the Koopman-based model's projected position (blue) "
        "is superimposed on the measured  $\\phi$  and  $\\psi$  angles of the TRAS during a 6-second time window "
        "(black, dotted).",
        {
            "window": "6 s, each window from its own true initial state",
            "trajectory": "5 s, the trajectories as cut for the fit",
            "free_run": "500 s, one prediction of the whole recording",
        },
    ),
    "nrmse_range": (
        "NRMSE = \\frac{RMSE}{y_{max} - y_{min}} \\times 100\\%",
        {
            "validation_set": "largest minus smallest value of the whole validation recording",
            "trajectory": "that of each window by itself, then the root mean square over the windows",
        },
    ),
    "velocity_term": (
        "\\ddot{\\psi} = (u_{\\phi} - J\\frac{\\psi^2}{2}\\sin(2\\phi) - C_{\\phi}\\dot{\\phi} - K_g g)/J_{\\phi}",
        {
            "corrected": "the square of the yaw RATE, as mechanics demands",
            "as_printed": "the square of the yaw ANGLE, which creates energy",
        },
    ),
    "start": (
        "For data collection of TRAS, we consider the SIMULINK model of TRAS.",
        {
            "on_reference": "at rest on the first reference with balanced integrators, so that nothing has to settle; "
            "the paper does not say from which state it starts",
            "hanging": "at the rest point, integrators empty: the beam first swings up to its reference",
            "zero": "all states zero, as a Simulink model starts when nobody sets it, integrators empty",
        },
    ),
    "gains": (
        "The TRAS is highly nonlinear model, so I designed PID controller for TRAS to obtain the appropriate data for "
        "TRAS.",
        {
            "default": "poles at 4 rad/s with damping 0.9, from the inertias of the plant; the paper prints no gain",
            "half_frequency": "poles at 2 rad/s, damping 0.9",
            "twice_frequency": "poles at 8 rad/s, damping 0.9",
            "less_damping": "poles at 4 rad/s, damping 0.5",
        },
    ),
    "plant": (
        "For comprehensive parameter values, reference [11] provides detailed information.",
        {
            "TRAS-A": "the set of this repository; reference [11] was not to be had",
            "K_psi_half": "the cable's spring, good to a factor of two, half as stiff",
            "K_psi_double": "the spring twice as stiff",
            "K_psi_zero": "no spring at all",
            **{
                f"{name}_{word}": f"{name} 20 % {change}"
                for name in LUMPED
                for word, change in (("less", "smaller"), ("more", "larger"))
            },
        },
    ),
    "angle_names": (
        "Additionally, we focus on two outputs: yaw angle  $(\\phi)$  and pitch angle  $(\\psi)$ , measured in "
        "radians.",
        {
            "words": "4.0589 % belongs to yaw, 5.5889 % to pitch, as the words say",
            "symbols": "4.0589 % belongs to phi and 5.5889 % to psi; in the equations phi is pitch, psi yaw",
        },
    ),
}


SINGLE = ("gains", "plant")  # what acts on the rig and its controller alone: varied one at a time, not in the product


class ReadingError(ValueError):
    """An option or a choice that the readings do not have."""


def choices(option: str) -> tuple[str, ...]:
    """The choices of an option, the default first."""
    if option not in OPTIONS:
        raise ReadingError(f"there is no reading {option!r}{did_you_mean(option, OPTIONS)}")
    return tuple(OPTIONS[option][1])


class _Frozen(pydantic.BaseModel):
    """Frozen, strict about names, with errors of one sentence."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid")

    def __init__(self, **values):
        try:
            super().__init__(**values)
        except pydantic.ValidationError as error:
            raise ReadingError(_sentence(error.errors()[0], values)) from None

    def __setattr__(self, option, choice):
        raise ReadingError(f"{option} cannot be changed in place: readings.replaced({option}=...) gives a copy.")

    def replaced(self, **changes):
        """A copy with other choices, checked."""
        return type(self)(**{**self.model_dump(), **changes})


_FIELDS = {option: (Literal[choices(option)], choices(option)[0]) for option in OPTIONS}
Readings = pydantic.create_model("Readings", __base__=_Frozen, __module__=__name__, **_FIELDS)
Readings.__doc__ = """One choice for every open point of the text, frozen and checked; the defaults are this project's.

Parameters
----------
input, frequency_unit, dictionary, state, horizon, nrmse_range, velocity_term, start, gains, plant, angle_names : str
    See `OPTIONS`, or print `table()`.

Raises
------
ReadingError
    (a ValueError) For an unknown option or choice; the message suggests the nearest name.

Examples
--------
>>> Readings(input="torque").input
'torque'
>>> Readings(dictionary="monomial2")
Traceback (most recent call last):
    ...
tras.paper.readings.ReadingError: dictionary is 'monomial2': did you mean 'monomials2'?
"""


def table() -> pd.DataFrame:
    """All options and choices, one row per choice.

    Returns
    -------
    pandas.DataFrame
        Columns ``option, choice, default`` (True for one choice per option), ``meaning``, and ``paper``: the sentence
        that the option reads.
    """
    rows = [
        (option, choice, choice == choices(option)[0], meaning, sentence)
        for option, (sentence, meanings) in OPTIONS.items()
        for choice, meaning in meanings.items()
    ]
    return pd.DataFrame(rows, columns=["option", "choice", "default", "meaning", "paper"])


def markdown() -> str:
    """The same for docs and notebooks: one row per option. Formulas stand in ``$...$``."""
    lines = [("option", "the paper", "choices, the default first")]
    for option, (sentence, meanings) in OPTIONS.items():
        formula = sentence.startswith("\\") or "\\frac" in sentence
        quoted = f"${sentence}$" if formula else f"“{' '.join(sentence.split())}”"
        listed = "; ".join(f"`{choice}`: {meaning}" for choice, meaning in meanings.items())
        lines.append((f"`{option}`", quoted, listed))
    return markdown_table(lines)


def read_yaml(path: str | Path, *sections: str) -> Readings:
    """Readings from a YAML file: a mapping of options to choices, or a section of one.

    Parameters
    ----------
    path : str or Path
    *sections : str
        Keys that lead to it, for example ``"06_readings", "default"``. Options left out take their default.

    Raises
    ------
    ReadingError
        If the file cannot be read, is no mapping, or names an unknown option or choice; the message names the file.
    """
    content = yaml_file.read_yaml(path, ReadingError)
    for section in sections:
        known = content if isinstance(content, dict) else {}
        if section not in known:
            raise ReadingError(f"{path} has no section {section!r}{did_you_mean(section, known)}")
        content = known[section]
    content = content or {}
    if not isinstance(content, dict):
        raise ReadingError(f"{path} holds a {type(content).__name__}: write one `option: choice` per line.")
    try:
        return Readings(**{str(name): choice for name, choice in content.items()})
    except ReadingError as error:
        raise ReadingError(f"{path}: {error}") from None


def _sentence(problem, values):
    """pydantic's first complaint as one sentence for the person who made the mistake."""
    option = str(problem["loc"][0])
    if problem["type"] == "extra_forbidden":
        return f"there is no reading {option!r}{did_you_mean(option, OPTIONS)}"
    return f"{option} is {values[option]!r}{did_you_mean(values[option], choices(option))}"
