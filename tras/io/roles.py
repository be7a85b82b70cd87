"""Which columns of a table are time, states, inputs and trial numbers: specified, or guessed from names and values.

Names come first, then what the values tell (`tras.io.evidence`, `tras.io.clock`). What neither says plainly is one
question: all columns with a guess for each, and the command that answers it.
"""

import difflib
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tras.io import clock, evidence
from tras.io.words import UNITS_OF_TIME, guess_role, says_nothing, step_of, unit_in
from tras.workflow import arguments
from tras.workflow.yaml_file import read_yaml

_KEYS = ("time", "states", "inputs", "trial", "dt", "units")


class RecordingError(ValueError):
    """A file is not a recording, or lacks something that one needs: one sentence with its path and the place in it.

    Characters of the file that nobody sees, or that turn the order of letters, stand in it as their numbers.

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

    def __init__(self, message: str = ""):
        super().__init__(arguments.visible(message))


class Question(RecordingError):
    """Roles that are not plain: why, (column, range, guess) of each column, and `Roles` that would answer it."""

    def __init__(self, why: list, table: list, answer: "Roles"):
        super().__init__(arguments.one_line("; ".join(why)))
        self.table, self.answer = table, answer


class Roles(NamedTuple):
    """Names of columns (None: there is none), name -> unit of some, and the sampling time ``dt`` in s or None."""

    time: str | None
    states: list
    inputs: list
    trial: str | None
    dt: float | None
    units: dict
    stated: float | None = None  # the sampling time that the file states


def assign(
    names: list, roles, units: dict, dt: float | None = None, values: Callable = lambda name: None
) -> tuple[Roles, list]:
    """The roles of the columns ``names``: as ``roles`` specifies, the others guessed.

    Parameters
    ----------
    names : list of str
        Columns of the file.
    roles : dict, path of a YAML file, or None
        ``time`` and ``trial``: a name or null (none). ``states`` (or ``outputs``) and ``inputs``: a list of names.
        ``units``: name -> unit. ``dt``: sampling time in s. A column may be called by its number, from 1.
    units : dict
        Name -> unit, from the file.
    dt : float, optional
        The sampling time from the file, in s.
    values : callable, optional
        Name -> (rows,) floats of the first trial, or None where there are no numbers.

    Returns
    -------
    roles : Roles
        Its ``dt`` is what ``roles`` specifies; the file's where there is no column of time.
    guesses : list of str
        One sentence per guess.

    Raises
    ------
    RecordingError
        When a key or a column is unknown or a column has two roles; a `Question` when a role is not plain.

    Examples
    --------
    >>> roles, guesses = assign(["t", "phi", "phidot", "u1", "comment"], None, {})
    >>> roles.states, roles.inputs
    (['phi', 'phidot'], ['u1'])
    >>> print("; ".join(guesses))
    time is column t; states are phi, phidot; inputs are u1; left out: comment
    """
    return _Assignment(names, mapping(roles), units, dt, values).result()


class _Assignment:
    """The roles of one table, in the order time, trial, states and inputs; `why` are the reasons to ask."""

    def __init__(self, names, spec, units, dt, values):
        self.names, self.spec, self.dt, self.why, self.guesses, self.reasons = names, spec, dt, [], [], {}
        self.cache, self._values = {}, values
        self.by_number()
        if "time" not in spec and spec.get("trial") and guess_role(spec["trial"]) == "time":
            spec["time"] = spec["trial"]
        self.taken = _columns_with_a_role(names, spec)
        self.units = {**units, **spec.get("units", {})}
        self.kinds = {name: None if name in self.taken else guess_role(name, names) for name in names}

    def values(self, name):
        """The numbers of a column, or None."""
        if name not in self.cache:
            self.cache[name] = self._values(name)
        return self.cache[name]

    def by_number(self):
        """Numbers of columns in the specification as names."""

        for key, value in self.spec.items():
            if key in ("time", "trial"):
                self.spec[key] = named(value, self.names)
            elif key in ("states", "inputs"):
                self.spec[key] = [named(label, self.names) for label in value]

    def result(self):
        steps = self.step_columns()
        time = self.spec["time"] if "time" in self.spec else self.time()
        unit = self.unit_of_time(time)
        trial = self.spec["trial"] if "trial" in self.spec else self.trial(time)
        rest = [name for name in self.names if name not in (*self.taken, time, trial, *steps)]
        states, inputs, open_columns = self.channels(rest)
        dt = self.spec.get("dt", self.dt if time is None else None)
        roles = Roles(time, states, inputs, trial, dt, self.units | unit, self.dt)
        experiments = [] if time or {"states", "inputs"} & set(self.spec) else self.experiments(states, inputs)
        if time is None and dt is None:
            self.why.append("no column is plainly time, and no sampling time is given")
        if self.why:
            table, answer = self.answer(roles, open_columns)
            if experiments:
                answer = answer._replace(states=[";".join(experiments[0])], inputs=[";".join(experiments[1])])
            raise Question(self.why, table, answer)
        left = [name for name in self.names if name not in (time, trial, *states, *inputs, *steps)]
        guesses = self.guesses + ([f"left out: {', '.join(left)}"] if left and self.guesses else [])
        return roles, list(map(arguments.one_line, guesses))

    # time and trials

    def step_columns(self):
        """Columns that state the sampling time by one value: Ts, fs; the time they state becomes the file's."""
        steps = []
        for name in self.names:
            if self.kinds[name] not in ("step", "time") or (column := self.values(name)) is None:
                continue
            if len(column) < 2 or evidence.moves(column) or not np.isfinite(column).any():
                continue
            if step := step_of(name, column[np.isfinite(column)][0]):
                if self.dt is not None and abs(step - self.dt) > 1e-6 * step:
                    raise RecordingError(f"the sampling times in it are {self.dt:g} and {step:g} s; give dt, in s.")
                self.dt = step
                self.guesses.append(f"the sampling time is {step:g} s, by column {name}")
                steps.append(name)
                self.kinds[name] = "step"
        return steps

    def time(self):
        """The column of time: by its name or unit, else the one that rises evenly."""
        named = [name for name in self.names if self.kinds[name] == "time"]
        named += [
            name for name in self.names
            if name not in (*named, *self.taken) and self.units.get(name, "").lower() in UNITS_OF_TIME
            if self.kinds[name] not in ("step", "trial")
        ]  # fmt: skip
        columns = {name: self.values(name) for name in named}
        rising = [name for name, column in columns.items() if column is None or clock.rises(column)]
        if len(rising) > 1:
            strictly = [name for name in rising if columns[name] is None or (np.diff(columns[name]) > 0).all()]
            rising = strictly or rising
        why = ""
        if not rising:
            rising, why = self.even_columns(), ", because it rises evenly"
        if len(rising) > 1:
            self.why.append(f"{' and '.join(rising)} could each be the column of time")
        if len(rising) != 1:
            return None
        self.guesses.append(f"time is column {rising[0]}{why}")
        self.reasons[rising[0]] = "time" + (" (rises evenly)" if why else "")
        return rising[0]

    def even_columns(self):
        """The columns without a name of input or trial that rise evenly and do more than to count the rows."""
        even = []
        for name in self.names:
            if name in self.taken or self.kinds[name] in ("inputs", "trial"):
                continue
            column = self.values(name)
            if column is not None and clock.rises_evenly(column):
                if clock.is_counter(column):
                    self.reasons[name] = "left out: counts the rows"
                else:
                    even.append(name)
        return even

    def unit_of_time(self, time):
        """{time: unit} where name and file leave it open and the values tell it."""
        if time is None:
            return {}
        unit = self.units.get(time)
        if clock.seconds(time, unit) is None:
            known = ", ".join(UNITS_OF_TIME)
            raise RecordingError(f"the column of time {time!r} has the unit {unit!r}; give one of {known} under units.")
        if unit or unit_in(time) or (column := self.values(time)) is None:
            return {}
        unit, why = clock.guess_unit(column)
        if unit:
            self.guesses.append(f"{time} is in {unit}, because {why}")
            self.reasons[time] = f"time in {unit} ({why})"
        return {time: unit} if unit else {}

    def trial(self, time):
        named = [name for name in self.names if self.kinds[name] == "trial" and name != time]
        if len(named) > 1:
            self.why.append(f"{' and '.join(named)} could each be the column of trial")
        if len(named) != 1:
            return None
        self.guesses.append(f"a new trial begins when this column changes: {named[0]}")
        self.reasons[named[0]] = "trial"
        return named[0]

    # states and inputs

    def channels(self, rest):
        """(states, inputs, columns that are open: they move and no role is plain)."""
        by_name = {role: [name for name in rest if self.kinds[name] == role] for role in ("states", "inputs")}
        for role, columns in by_name.items():
            self.reasons |= dict.fromkeys(columns, f"{role[:-1]} (name)")
        states, inputs = (self.spec.get(role, columns) for role, columns in by_name.items())
        doubtful = [] if "states" in self.spec else self.doubtful(states)
        if not inputs and not {"states", "inputs"} & set(self.spec):
            beside = _beside_y(states)
            if beside:
                self.why.append(f"{', '.join(beside)} may be the input, as there is y and no u")
            doubtful, held = [*doubtful, *(name for name in beside if name not in doubtful)], doubtful
        else:
            held = doubtful
        open_columns = [name for name in rest if name not in (*states, *inputs) and self.is_open(name)]
        for role, columns in (("states", states), ("inputs", inputs)):
            if role not in self.spec:
                self.guesses.append(f"{role} are {', '.join(columns) or 'none'}")
        nameless = [name for name in open_columns if says_nothing(name)]
        if not states:
            self.why.append("no column is plainly a state or an output")
        elif nameless and "states" not in self.spec:
            self.why.append(f"{', '.join(nameless[:6])} move and nothing says what they are")
        if held:
            self.why.append(f"{', '.join(held)} would be a state by name, but jumps and stays like an input")
        if not inputs and "inputs" not in self.spec and open_columns:
            self.why.append("no column is plainly an input")
        return states, inputs, open_columns + doubtful

    def experiments(self, states, inputs):
        """(states, inputs) if z1 with u1, z2 with u2 ... seem to be experiments side by side, else []."""
        numbered = [[re.fullmatch(r"(.*?)(\d+)", name) for name in names] for names in (states, inputs)]
        if len(states) < 2 or not all(all(matches) and len({m[1] for m in matches}) == 1 for matches in numbered):
            return []
        if [m[2] for m in numbered[0]] != [m[2] for m in numbered[1]]:
            return []
        columns = [[self.values(name) for name in names] for names in (states, inputs)]
        if any(column is None for part in columns for column in part) or not evidence.are_apart(*columns):
            return []
        pairs = ", ".join(f"{state} with {inp}" for state, inp in zip(states, inputs))
        self.why.append(
            f"{pairs} may be experiments side by side: nothing of one shows in another, or their inputs are alike"
        )
        return states, inputs

    def doubtful(self, states):
        """States by name whose values are held in steps while those of others are not."""
        held = [name for name in states if (column := self.values(name)) is not None and evidence.is_held(column)]
        return held if len(held) < len(states) else []

    def is_open(self, name):
        if self.kinds[name] == "beside" or self.reasons.get(name, "").startswith("left"):
            return False
        column = self.values(name)
        if column is not None and len(column) > 2 and clock.is_counter(column):
            self.reasons[name] = "left out: counts the rows"
            return False
        return column is not None and evidence.moves(column)

    def answer(self, roles, open_columns):
        """(lines of the question, roles with a guess for every open column)."""
        columns = {name: self.values(name) for name in open_columns}
        states = [name for name in roles.states if name not in open_columns]
        still = [name for name in states if (column := self.values(name)) is not None and not evidence.moves(column)]
        if "states" not in self.spec and len(still) < len(states):
            states = [name for name in states if name not in still]
            self.reasons |= dict.fromkeys(still, "left out (constant)")
        guesses = evidence.guesses(
            {name: column for name, column in columns.items() if column is not None},
            {name for name in open_columns if self.kinds[name] == "reference"},
            [column for name in states if (column := self.values(name)) is not None],
            has_inputs=bool(roles.inputs),
        )
        inputs = list(roles.inputs)
        if not inputs and "inputs" not in self.spec:
            inputs = [name for name, (guess, _) in guesses.items() if guess == "input"]
        if "states" not in self.spec:
            of_values = [name for name, (guess, _) in guesses.items() if guess == "state"]
            states += of_values if not states else [name for name in of_values if says_nothing(name)]
        for name, (_, why) in guesses.items():
            role = "state" if name in states else "input" if name in inputs else "left out"
            self.reasons[name] = f"{role}? {f'({why})' if why else ''}".strip()
        dt = roles.dt or self.dt or (None if roles.time else 1.0)
        answer = roles._replace(states=self.ordered(states), inputs=self.ordered(inputs), dt=dt)
        return [self.line(number, name) for number, name in enumerate(self.names, 1)], answer

    def ordered(self, names):
        return [name for name in self.names if name in names]

    def line(self, number, name):
        """(number and name, unit, range, guess) of a column, as text."""
        column, unit = self.values(name), self.units.get(name, "")
        finite = column[np.isfinite(column)] if column is not None else np.empty(0)
        low, high = (finite.min(), finite.max()) if finite.size else (np.nan, np.nan)
        span = f"{low:.5g} to {high:.5g}" if low < high else f"always {low:.5g}" if finite.size else "no numbers"
        return str(number), name, unit, span, self.reasons.get(name, "left out")


def named(label, names: list):
    """The column that a label calls by its number, from 1; any other label as it is."""
    is_number = isinstance(label, str) and label.isascii() and label.isdigit() and label not in names
    return names[int(label) - 1] if is_number and 0 < int(label) <= len(names) else label


def unknown_column(name, names: list) -> RecordingError:
    """The error about a column that is not there."""
    near = difflib.get_close_matches(name, names, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return RecordingError(f"roles: there is no column {name!r}{hint}; {_listing(names)}.")


def _beside_y(names):
    """The columns x, x1, X2 of a table that has besides them but y, y1, Y2: in learning, x goes in and y comes out."""
    xs = [name for name in names if re.fullmatch(r"[xX]_?\d*", name)]
    ys = [name for name in names if re.fullmatch(r"[yY]_?\d*", name)]
    return xs if ys and len(xs) + len(ys) == len(names) else []


def mapping(roles) -> dict:
    """Roles, a dict or the path of a YAML file, as a new dict, its keys and the types of its values checked."""
    if roles is None:
        return {}
    spec = dict(roles if hasattr(roles, "items") else _yaml(Path(roles)))
    if "outputs" in spec:
        spec["states"] = [*_list("states", spec.get("states")), *_list("outputs", spec.pop("outputs"))]
    for key, value in spec.items():
        if key not in _KEYS:
            raise RecordingError(
                f"roles has the key {arguments.short(repr(key), 60)}; it knows {', '.join(_KEYS)} and outputs."
            )
        if key in ("states", "inputs"):
            spec[key] = _list(key, value)
        elif key in ("time", "trial") and not (value is None or isinstance(value, str)):
            raise RecordingError(f"roles: {key} is {arguments.short(repr(value), 60)}; give the name of one column.")
        elif key == "units" and not (
            isinstance(value, dict) and all(isinstance(word, str) for word in (*value, *value.values()))
        ):
            raise RecordingError(f"roles: units is {arguments.short(repr(value), 60)}; give name: unit for each.")
        elif key == "dt":
            give = "the sampling time in s, a positive number"
            arguments.number("roles: dt", value, 0, ends=False, give=give, error=RecordingError)
    return spec


def _yaml(path):
    try:
        content = read_yaml(path, RecordingError)
    except RecordingError as error:
        raise RecordingError(f"roles: {error}") from None
    if not isinstance(content, dict):
        raise RecordingError(f"roles: {path} holds no mapping; write lines such as `states: [phi, phidot]`.")
    return content


def _list(key, value):
    value = [value] if isinstance(value, str) else [] if value is None else value
    if not isinstance(value, (list, tuple)) or not all(isinstance(name, str) for name in value):
        raise RecordingError(f"roles: {key} is {arguments.short(repr(value), 60)}; give a list of names.")
    return list(value)


def _columns_with_a_role(names, spec):
    """The columns that ``spec`` names: they must exist and have one role (time may also tell the trials apart)."""
    columns = [spec.get("time"), *spec.get("states", []), *spec.get("inputs", [])]
    if spec.get("trial") is not None and spec["trial"] != spec.get("time"):
        columns.append(spec["trial"])
    columns = [name for name in columns if name is not None]
    for name in [*columns, *spec.get("units", {})]:
        if name not in names:
            raise unknown_column(name, names)
    for name in columns:
        if columns.count(name) > 1:
            raise RecordingError(f"roles: column {name!r} has two roles; give it one.")
    return columns


def _listing(names):
    more = f" and {len(names) - 30} more" if len(names) > 30 else ""
    columns = ", ".join(arguments.short(name, 60) for name in names[:30])
    return f"the file has the columns {columns}{more}" if names else "the file has no columns"
