"""A choice of the explorer as a parameter file: `make all PROFILE=NAME` then runs every stage with it.

Stage 09 takes the choice whole. The others have what they know of it: the experiment (01), the paper's dictionary and the way to the field (02), the
windows (03), the reading (06). The studies 05 and 07 need data enough for what they vary; on another recording than the paper's they run at the
small size of params/smoke.yaml.
"""

import math
import re
from pathlib import Path

from tras.choice import Choice
from tras.files import project_root, replacing
from tras.grid import FREQUENCY
from tras.parameters import parse_yaml
from tras.readings import Readings

FIRST_LINE = "# Written by the explorer (notebooks/explore.ipynb)"
KEPT = ("paper", "smoke")  # profiles of the project itself
_READ = {("gaussian", 2): "gaussian", ("gaussian", 28): "gaussian28", ("monomials", 2): "monomials2", ("monomials", 3): "monomials3"}


class ProfileError(ValueError):
    """A name that cannot be a profile's."""


def sections(choice, small=None):
    """What the choice means for each notebook.

    Parameters
    ----------
    choice : Choice
    small : dict, optional
        Parameters of the studies 05 and 07 for recordings other than the paper's, notebook -> parameters.

    Returns
    -------
    dict
        Notebook -> {parameter: value}; what is left out stays as the notebook has it.
    """
    paper, factor = Choice(), FREQUENCY[choice.frequency_unit]
    found = {
        "01_data_generation": {
            "duration": choice.duration, "sampling_time": choice.sampling_time, "train_seed": choice.seed,
            "validation_seeds": [choice.seed + k for k in (1, 2, 3, 4)],
            "pitch_max_frequency": 0.2 * factor, "yaw_max_frequency": 0.8 * factor,
            "short_duration": min(120.0, choice.duration),
        },
        "02_identification": {"field": choice.field},
        "03_validation": {"window": choice.horizon, "free_run": choice.duration},
        "06_readings": {
            "default": reading(choice).model_dump(), "duration": choice.duration, "sampling_time": choice.sampling_time, "window": choice.horizon,
        },
        "09_pictures": {"choice": choice.as_dict()},
    }  # fmt: skip
    if choice.dictionary == "gaussian":
        found["02_identification"] |= {"rbf_centres": choice.size, "rbf_width": choice.width, "rbf_seed": choice.seed - 1}
    experiment = ("duration", "sampling_time", "frequency_unit")
    if any(getattr(choice, name) != getattr(paper, name) for name in experiment):
        for name, section in (small or {}).items():
            found[name] = section | found.get(name, {})
    return found


def reading(choice):
    """The reading of the text (`tras.readings`) that is nearest to a choice: what it has no name for is as by default."""
    dictionary = choice.dictionary if choice.dictionary in ("linear", "exponentials") else _READ.get((choice.dictionary, choice.size))
    return Readings(
        input=choice.input, frequency_unit=choice.frequency_unit, nrmse_range=choice.nrmse_range,
        state="delayed_angles" if (choice.state, choice.delays) == ("angles", 1) else "four_states",
        **({"dictionary": dictionary} if dictionary else {}),
    )


def text(choice, name, small=None):
    """The file: YAML that `tras.parameters` reads."""
    lines = [f"{FIRST_LINE}: make all PROFILE={name} runs it.", ""]
    for notebook, section in sorted(sections(choice, small).items()):
        lines.append(f"{notebook}:")
        for parameter, value in section.items():
            if isinstance(value, dict):
                lines += [f"  {parameter}:", *(f"    {key}: {_literal(item)}" for key, item in value.items())]
            else:
                lines.append(f"  {parameter}: {_literal(value)}")
    return "\n".join(lines) + "\n"


def write(choice, name, folder=None):
    """Write ``params/NAME.yaml``.

    Parameters
    ----------
    choice : Choice
    name : str
        Letters, digits, ``-`` and ``_``.
    folder : str or Path, optional
        By default ``params/`` of the project.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    ProfileError
        (a ValueError) If the name is none, is one of the project's own, or belongs to a file that the explorer has not written.
    """
    folder = Path(folder or project_root() / "params")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise ProfileError(f"NAME is {name!r}: give letters, digits, - and _, beginning with a letter or digit.")
    path = folder / f"{name}.yaml"
    if name in KEPT or (path.exists() and not path.read_text(encoding="utf-8").startswith(FIRST_LINE)):
        raise ProfileError(f"NAME is {name!r}, and {path.name} is not the explorer's: choose another name.")
    smoke = project_root() / "params" / "smoke.yaml"
    small = parse_yaml(smoke.read_text(encoding="utf-8"), smoke)
    with replacing(path) as temporary:
        temporary.write_text(text(choice, name, {study: small[study] for study in ("05_robustness", "06_readings", "07_comparison")}), encoding="utf-8")
    return path


def _literal(value):
    """A value as YAML reads it back: text in quotes, floats with point and sign.

    >>> _literal(1e-06), _literal(500.0), _literal("rad/s"), _literal([1, 2.5])
    ('1.0e-06', '500.0', '"rad/s"', '[1, 2.5]')
    """
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return f"[{', '.join(map(_literal, value))}]"
    if isinstance(value, float) and math.isfinite(value):
        mantissa, exponent, power = repr(value).partition("e")
        return (mantissa if "." in mantissa else f"{mantissa}.0") + exponent + power
    return str(value)
