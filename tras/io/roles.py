"""Which columns of a table are time, states, inputs and trial numbers: specified, or guessed from plain names."""

import difflib
import re
from pathlib import Path
from typing import NamedTuple

from tras.workflow import arguments

_KEYS = ("time", "states", "inputs", "trial", "dt", "units")
_TIME = set("t time times timestamp zeit tout seconds elapsed datetime".split())
_TRIAL = set("trial run episode trajectory traj experiment repetition segment sequence session".split())
_INPUT = set(
    "u in input inputs torque torques tau force voltage cmd command control ctrl action actuator pwm throttle duty "
    "current moment".split()
)
_STATE = set(
    "q x y z angle angles theta phi psi alpha beta gamma pitch yaw roll azimuth elevation heading pos position vel "
    "velocity speed omega rate state states output outputs out displacement height level".split()
)
_UNITS_OF_TIME = {"s": (1, 1), "sec": (1, 1), "seconds": (1, 1), "ms": (1, 1000), "us": (1, 10**6), "µs": (1, 10**6)}
_UNITS_OF_TIME |= {"μs": (1, 10**6), "ns": (1, 10**9), "min": (60, 1), "h": (3600, 1)}


class RecordingError(ValueError):
    """A file is not a recording, or lacks something that one needs: one sentence with its path and the place in it.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import tras
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "log.csv")
    ...     _ = path.write_text("a note\\nno numbers here\\n")
    ...     try:
    ...         tras.Recording.read(path)
    ...     except tras.RecordingError as error:
    ...         print(str(error).replace(folder, "")[1:9])
    log.csv:
    """


class Roles(NamedTuple):
    """Names of columns (None: there is none), name -> unit of some, and the sampling time ``dt`` in s or None."""

    time: str | None
    states: list
    inputs: list
    trial: str | None
    dt: float | None
    units: dict


def assign(names: list, roles, units: dict, dt: float | None = None) -> tuple[Roles, list]:
    """The roles of the columns ``names``: as ``roles`` specifies, the others guessed.

    Parameters
    ----------
    names : list of str
        Columns of the file.
    roles : dict, path of a YAML file, or None
        ``time`` and ``trial``: a name or null (none). ``states`` (or ``outputs``) and ``inputs``: a list of names.
        ``units``: name -> unit. ``dt``: sampling time in s, when there is no column of time.
    units : dict
        Name -> unit, from the file.
    dt : float, optional
        The sampling time from the file, in s.

    Returns
    -------
    roles : Roles
    guesses : list of str
        One sentence per guess.

    Raises
    ------
    RecordingError
        When a key or a column is unknown, when a column has two roles, or when the names leave a role open.

    Examples
    --------
    >>> roles, guesses = assign(["t", "phi", "phidot", "u1", "comment"], None, {})
    >>> roles.states, roles.inputs
    (['phi', 'phidot'], ['u1'])
    >>> print("; ".join(guesses))
    time is column t; states are phi, phidot; inputs are u1; left out: comment
    """
    spec = mapping(roles)
    if "time" not in spec and spec.get("trial") and guess_role(spec["trial"]) == "time":
        spec["time"] = spec["trial"]
    columns = _columns_with_a_role(names, spec)
    candidates = {"time": [], "trial": [], "states": [], "inputs": []}
    for name in names:
        role = guess_role(name)
        if role and name not in columns:
            candidates[role].append(name)
    assignment, guesses = dict(spec), []
    for role, words in (("time", "time is column"), ("trial", "a new trial begins when this column changes:")):
        if role not in spec:
            assignment[role] = candidates[role][0] if len(candidates[role]) == 1 else None
            if assignment[role]:
                guesses.append(f"{words} {assignment[role]}")
            elif len(candidates[role]) > 1:
                listing = " and ".join(candidates[role])
                raise RecordingError(f"{listing} could each be the column of {role}; {_help(names)}")
    for role in ("states", "inputs"):
        if role not in spec:
            assignment[role] = candidates[role]
            guesses.append(f"{role} are {', '.join(candidates[role]) or 'none'}")
    if not assignment["states"]:
        raise RecordingError(f"no column is plainly a state or an output; {_help(names)}")
    assignment.setdefault("dt", dt)
    roles = Roles(**{**assignment, "units": {**units, **spec.get("units", {})}})
    if roles.time is None and roles.dt is None:
        raise RecordingError(
            f"no column is plainly time, and no sampling time is given: give dt (in s), or {_help(names)}"
        )
    rest = [name for name in names if name not in (roles.time, roles.trial, *roles.states, *roles.inputs)]
    return roles, guesses + ([f"left out: {', '.join(rest)}"] if rest and guesses else [])


def guess_role(name: str) -> str | None:
    """Return "time", "trial", "states" or "inputs" if ``name`` says so plainly, else None.

    Examples
    --------
    >>> names = ("Time_ms", "run", "theta_dot", "dq2", "motorTorque", "u", "reference", "torque_angle")
    >>> [guess_role(name) for name in names]
    ['time', 'trial', 'states', 'states', 'inputs', 'inputs', None, None]
    """
    words = [word.lower() for word in re.findall(r"[A-Z]?[^\W\d_A-Z]+|[A-Z]+", name)]
    if words and words[0] in _TIME and all(word in _UNITS_OF_TIME or word == "stamp" for word in words[1:]):
        return "time"
    if words and words[0] in _TRIAL and all(word in ("id", "no", "nr", "num", "number", "index") for word in words[1:]):
        return "trial"
    vocabularies = (("states", _STATE), ("inputs", _INPUT))
    roles = {role for role, vocabulary in vocabularies if any(_is_in(vocabulary, word) for word in words)}
    unclear = {"ref", "reference", "setpoint", "target", "desired", "goal", "time", "error"} & set(words)
    if words and words[0] in ("u", "tau", "input", "cmd"):
        roles = {"inputs"}  # u_phi: the input that moves phi
    return roles.pop() if len(roles) == 1 and not unclear else None


def seconds(name: str, unit: str | None) -> tuple[int, int]:
    """(numerator, denominator) that convert the column of time ``name`` with ``unit`` to s.

    Raises
    ------
    RecordingError
        If the unit is not one of time.
    """
    if not unit:
        unit = re.split(r"[_ ]", name.lower())[-1]
        return _UNITS_OF_TIME.get(unit, (1, 1)) if unit != name.lower() else (1, 1)
    if unit.lower() not in _UNITS_OF_TIME:
        raise RecordingError(
            f"the column of time {name!r} has the unit {unit!r}; give one of {', '.join(_UNITS_OF_TIME)} under units."
        )
    return _UNITS_OF_TIME[unit.lower()]


def _is_in(vocabulary, word):
    """Whether a word or what it is the derivative of is in the vocabulary: dq, qd, qdot, thetadot."""
    roots = (word, word.removeprefix("d"), *(word.removesuffix(suffix) for suffix in ("dot", "ddot", "d")))
    return not vocabulary.isdisjoint(roots)


def mapping(roles) -> dict:
    """Roles, a dict or the path of a YAML file, as a new dict, its keys and the types of its values checked."""
    if roles is None:
        return {}
    spec = dict(roles if hasattr(roles, "items") else _yaml(Path(roles)))
    if "outputs" in spec:
        spec["states"] = [*_list("states", spec.get("states")), *_list("outputs", spec.pop("outputs"))]
    for key, value in spec.items():
        if key not in _KEYS:
            raise RecordingError(f"roles has the key {key!r}; it knows {', '.join(_KEYS)} and outputs.")
        if key in ("states", "inputs"):
            spec[key] = _list(key, value)
        elif key in ("time", "trial") and not (value is None or isinstance(value, str)):
            raise RecordingError(f"roles: {key} is {value!r}; give the name of one column.")
        elif key == "units" and not (
            isinstance(value, dict) and all(isinstance(word, str) for word in (*value, *value.values()))
        ):
            raise RecordingError(f"roles: units is {value!r}; give name: unit for each.")
        elif key == "dt":
            give = "the sampling time in s, a positive number"
            arguments.number("roles: dt", value, 0, ends=False, give=give, error=RecordingError)
    return spec


def _yaml(path):
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RecordingError(f"roles: {path} cannot be opened ({error.strerror}).") from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise RecordingError(f"roles: {path} is no YAML ({' '.join(str(error).split())}).") from error
    if not isinstance(content, dict):
        raise RecordingError(f"roles: {path} holds no mapping; write lines such as `states: [phi, phidot]`.")
    return content


def _list(key, value):
    value = [value] if isinstance(value, str) else [] if value is None else value
    if not isinstance(value, (list, tuple)) or not all(isinstance(name, str) for name in value):
        raise RecordingError(f"roles: {key} is {value!r}; give a list of names.")
    return list(value)


def _columns_with_a_role(names, spec):
    """The columns that ``spec`` names: they must exist and have one role (time may also tell the trials apart)."""
    columns = [spec.get("time"), *spec.get("states", []), *spec.get("inputs", [])]
    if spec.get("trial") is not None and spec["trial"] != spec.get("time"):
        columns.append(spec["trial"])
    columns = [name for name in columns if name is not None]
    for name in [*columns, *spec.get("units", {})]:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise RecordingError(f"roles: there is no column {name!r}{hint}; {_listing(names)}.")
    for name in columns:
        if columns.count(name) > 1:
            raise RecordingError(f"roles: column {name!r} has two roles; give it one.")
    return columns


def _help(names):
    """What to write, with the file's own names as examples."""
    examples = [*names[:3], "...", "...", "..."]
    return (
        f"{_listing(names)}; say what they are in a YAML file (or a dict) given as roles, for example\n"
        f"    time: {examples[0]}\n    states: [{examples[1]}]\n    inputs: [{examples[2]}]\n    trial: null"
    )


def _listing(names):
    more = f" and {len(names) - 30} more" if len(names) > 30 else ""
    columns = ", ".join(name[:60] for name in names[:30])
    return f"the file has the columns {columns}{more}" if names else "the file has no columns"
