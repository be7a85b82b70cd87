"""Which columns of a table are time, states, inputs and the number of the trial: as given, or guessed from plain names and said."""

import difflib
import re
from pathlib import Path
from typing import NamedTuple

from tras import arguments

_KEYS = ("time", "states", "inputs", "trial", "dt", "units")
_TIME = {"t", "time", "times", "timestamp", "zeit", "tout", "seconds", "elapsed", "datetime"}
_TRIAL = {"trial", "run", "episode", "trajectory", "traj", "experiment", "repetition", "segment", "sequence", "session"}
_INPUT = {"u", "in", "input", "inputs", "torque", "torques", "tau", "force", "voltage", "cmd", "command", "control", "ctrl", "action", "actuator",
          "pwm", "throttle", "duty", "current", "moment"}  # fmt: skip
_STATE = {"q", "x", "y", "z", "angle", "angles", "theta", "phi", "psi", "alpha", "beta", "gamma", "pitch", "yaw", "roll", "azimuth", "elevation", "heading",
          "pos", "position", "vel", "velocity", "speed", "omega", "rate", "state", "states", "output", "outputs", "out", "displacement", "height", "level"}  # fmt: skip
_UNITS_OF_TIME = {"s": (1, 1), "sec": (1, 1), "seconds": (1, 1), "ms": (1, 1000), "us": (1, 10**6), "µs": (1, 10**6), "μs": (1, 10**6),
                  "ns": (1, 10**9), "min": (60, 1), "h": (3600, 1)}  # fmt: skip


class RecordingError(ValueError):
    """A file that is no recording, or does not say enough to be one: one sentence with its path, and where in it."""


class Roles(NamedTuple):
    """Names of columns: one or None for ``time`` and ``trial``, lists for ``states`` and ``inputs``; ``units`` of some, ``dt`` in s or None."""

    time: str | None
    states: list
    inputs: list
    trial: str | None
    dt: float | None
    units: dict


def assign(names, given, units, dt=None):
    """The roles of the columns ``names``: those ``given``, the others guessed.

    Parameters
    ----------
    names : list of str
        Columns of the file.
    given : dict, path of a YAML file, or None
        ``time`` and ``trial``: a name or null (none). ``states`` (or ``outputs``) and ``inputs``: a list of names. ``units``: name ->
        unit. ``dt``: sampling time in s, when there is no column of time.
    units : dict
        Name -> unit, as the file has them.
    dt : float, optional
        A sampling time that the file has, in s.

    Returns
    -------
    roles : Roles
    guessed : list of str
        A sentence for each role that was guessed.

    Raises
    ------
    RecordingError
        When a key or a column is unknown, a column has two roles, or nothing is plain.

    Examples
    --------
    >>> roles, guessed = assign(["t", "phi", "phidot", "u1", "comment"], None, {})
    >>> roles.states, roles.inputs
    (['phi', 'phidot'], ['u1'])
    >>> print("; ".join(guessed))
    time is column t; states are phi, phidot; inputs are u1; left out: comment
    """
    given = _read(given)
    if "time" not in given and given.get("trial") and guess_role(given["trial"]) == "time":
        given["time"] = given["trial"]
    free = [name for name in names if name not in _taken(names, given)]
    guess = {"time": [], "trial": [], "states": [], "inputs": []}
    for name in free:
        role = guess_role(name)
        if role:
            guess[role].append(name)
    chosen, guessed = dict(given), []
    for role, words in (("time", "time is column"), ("trial", "a new trial begins when this column changes:")):
        if role not in given:
            chosen[role] = guess[role][0] if len(guess[role]) == 1 else None
            if chosen[role]:
                guessed.append(f"{words} {chosen[role]}")
            elif len(guess[role]) > 1:
                raise RecordingError(f"{' and '.join(guess[role])} could each be the column of {role}; {_help(names)}")
    for role in ("states", "inputs"):
        if role not in given:
            chosen[role] = guess[role]
            guessed.append(f"{role} are {', '.join(guess[role]) or 'none'}")
    if not chosen["states"]:
        raise RecordingError(f"no column is plainly a state or an output; {_help(names)}")
    chosen.setdefault("dt", dt)
    roles = Roles(**{**chosen, "units": {**units, **given.get("units", {})}})
    if roles.time is None and roles.dt is None:
        raise RecordingError(f"no column is plainly time, and no sampling time is given: give dt (in s), or {_help(names)}")
    used = {roles.time, roles.trial, *roles.states, *roles.inputs}
    rest = [name for name in names if name not in used]
    return roles, guessed + ([f"left out: {', '.join(rest)}"] if rest and guessed else [])


def guess_role(name):
    """"time", "trial", "states" or "inputs" if ``name`` says so plainly, else None.

    Examples
    --------
    >>> [guess_role(name) for name in ("Time_ms", "run", "theta_dot", "dq2", "motorTorque", "u", "reference", "torque_angle")]
    ['time', 'trial', 'states', 'states', 'inputs', 'inputs', None, None]
    """
    words = [word.lower() for word in re.findall(r"[A-Z]?[^\W\d_A-Z]+|[A-Z]+", name)]
    if words and words[0] in _TIME and all(word in _UNITS_OF_TIME or word == "stamp" for word in words[1:]):
        return "time"
    if words and words[0] in _TRIAL and all(word in ("id", "no", "nr", "num", "number", "index") for word in words[1:]):
        return "trial"
    found = {role for role, known in (("states", _STATE), ("inputs", _INPUT)) if any(_core(word, known) for word in words)}
    unclear = {"ref", "reference", "setpoint", "target", "desired", "goal", "time", "error"} & set(words)
    if words and words[0] in ("u", "tau", "input", "cmd"):
        found = {"inputs"}  # u_phi: the input that moves phi
    return found.pop() if len(found) == 1 and not unclear else None


def seconds(name, unit):
    """(numerator, denominator) that turn the column of time ``name`` with ``unit`` into s.

    Raises
    ------
    RecordingError
        If the unit is none of time.
    """
    if not unit:
        unit = re.split(r"[_ ]", name.lower())[-1]
        return _UNITS_OF_TIME.get(unit, (1, 1)) if unit != name.lower() else (1, 1)
    if unit.lower() not in _UNITS_OF_TIME:
        raise RecordingError(f"the column of time {name!r} has the unit {unit!r}; give one of {', '.join(_UNITS_OF_TIME)} under units.")
    return _UNITS_OF_TIME[unit.lower()]


def _core(word, known):
    """Whether a word is a known one, or the derivative of one: dq, qd, qdot, thetadot."""
    stripped = (word, word.removeprefix("d"), word.removesuffix("dot"), word.removesuffix("ddot"), word.removesuffix("d"))
    return any(each in known for each in stripped)


def _read(given):
    """The mapping, whole and with its own kinds of values, from a dict or a YAML file."""
    if given is None:
        return {}
    if not hasattr(given, "items"):
        given = _yaml(Path(given))
    given = dict(given)
    if "outputs" in given:
        given["states"] = [*_list("states", given.get("states")), *_list("outputs", given.pop("outputs"))]
    for key, value in given.items():
        if key not in _KEYS:
            raise RecordingError(f"roles has the key {key!r}; it knows {', '.join(_KEYS)} and outputs.")
        if key in ("states", "inputs"):
            given[key] = _list(key, value)
        elif key in ("time", "trial") and not (value is None or isinstance(value, str)):
            raise RecordingError(f"roles: {key} is {value!r}; give the name of one column.")
        elif key == "units" and not (isinstance(value, dict) and all(isinstance(text, str) for pair in value.items() for text in pair)):
            raise RecordingError(f"roles: units is {value!r}; give name: unit for each.")
        elif key == "dt":
            arguments.number("roles: dt", value, 0, ends=False, give="the sampling time in s, a positive number", error=RecordingError)
    return given


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


def _taken(names, given):
    """The columns that have been given a role, all of them there and each once (time may also tell the trials apart)."""
    taken = [given.get("time"), *given.get("states", []), *given.get("inputs", [])]
    if given.get("trial") is not None and given["trial"] != given.get("time"):
        taken.append(given["trial"])
    taken = [name for name in taken if name is not None]
    for name in [*taken, *given.get("units", {})]:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            raise RecordingError(f"roles: there is no column {name!r}{f' (did you mean {near[0]!r}?)' if near else ''}; {_listed(names)}.")
    for name in taken:
        if taken.count(name) > 1:
            raise RecordingError(f"roles: column {name!r} has two roles; give it one.")
    return taken


def _help(names):
    """What to write, with the file's own names where they can serve."""
    shown = [*names[:6], "...", "...", "..."]
    return (
        f"{_listed(names)}; say what they are in a YAML file (or a dict) given as roles, for example\n"
        f"    time: {shown[0]}\n    states: [{shown[1]}]\n    inputs: [{shown[2]}]\n    trial: null"
    )


def _listed(names):
    more = f" and {len(names) - 30} more" if len(names) > 30 else ""
    return f"the file has the columns {', '.join(name[:60] for name in names[:30])}{more}" if names else "the file has no columns"
