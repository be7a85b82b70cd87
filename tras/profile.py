"""A choice of the explorer as a parameter file: `make all PROFILE=NAME` then runs every stage with it.

Stage 09 takes the whole choice. The others take the part that concerns them: the experiment (01), the paper's
dictionary and the way to the field (02), the windows (03), the reading (06). The studies 05 and 07 vary the data and
need enough of them; on a recording other than the paper's they run at the small size of params/smoke.yaml.
"""

import math
import re
from pathlib import Path

from tras.choice import Choice
from tras.files import project_root, replacing
from tras.grid import FREQUENCY
from tras.parameters import parse_yaml

FIRST_LINE = "# Written by the explorer (notebooks/explore.ipynb)"
RESERVED = ("paper", "smoke")  # profiles of the project itself


class ProfileError(ValueError):
    """A name that no profile can have."""


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
        Notebook -> {parameter: value}; the notebook's own value holds for what is left out.
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
    experiment = ("duration", "sampling_time", "frequency_unit")
    if any(getattr(choice, name) != getattr(paper, name) for name in experiment):
        for name, section in (small or {}).items():
            notebooks[name] = section | notebooks.get(name, {})
    return notebooks


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
        (a ValueError) If the name has other characters, is one of the project's own, or belongs to a file that the
        explorer has not written.
    """
    folder = Path(folder or project_root() / "params")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise ProfileError(f"NAME is {name!r}: give letters, digits, - and _, beginning with a letter or digit.")
    path = folder / f"{name}.yaml"
    if name in RESERVED or (path.exists() and not path.read_text(encoding="utf-8").startswith(FIRST_LINE)):
        raise ProfileError(f"NAME is {name!r}, and {path.name} is not the explorer's: choose another name.")
    smoke = project_root() / "params" / "smoke.yaml"
    parameters = parse_yaml(smoke.read_text(encoding="utf-8"), smoke)
    small = {study: parameters[study] for study in ("05_robustness", "06_readings", "07_comparison")}
    with replacing(path) as temporary:
        temporary.write_text(text(choice, name, small), encoding="utf-8")
    return path


def _literal(value):
    """A value in the form that YAML reads back: text in quotes, floats with point and sign.

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
