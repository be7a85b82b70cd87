"""The one question to those who know the rig: all columns, a guess for each, and the command that answers it."""

import csv
import io
import shlex

from tras.io.roles import Question, Roles
from tras.workflow.arguments import one_line, short, visible

_LINES = 28  # of columns; the rest fits on a screen


def screen(question: Question, paths: list) -> str:
    """The text of a question about these files.

    Examples
    --------
    >>> roles = Roles("t", ["y"], ["u, V"], None, None, {})
    >>> lines = [("1", "t", "s", "0 to 8", "time"), ("2", "y", "", "-1 to 1", "state?")]
    >>> lines += [("3", "u, V", "", "0 to 1", "input?")]
    >>> print(screen(Question(["no column is plainly an input"], lines, roles), ["log 1.csv"]))
    no column is plainly an input. Which are states and inputs? A guess:
      1  t [s]  0 to 8   time
      2  y      -1 to 1  state?
      3  u, V   0 to 1   input?
    If it is right, else with other columns (by name or number; INPUTS=none for a free motion):
      make identify RECORDING='log 1.csv' TIME=t STATES=y INPUTS='"u, V"'
    In Python, roles={'time': 't', 'states': ['y'], 'inputs': ['u, V']}
    """
    rows = [
        (number, f"{short(name)} [{short(unit)}]" if unit else short(name), span, role)
        for number, name, unit, span, role in question.table
    ]
    hidden = len(rows) - _LINES
    if hidden > 0:  # those with a role stay
        order = sorted(range(len(rows)), key=lambda k: (rows[k][3].startswith("left out"), "?" in rows[k][3], k))
        chosen = order[:_LINES]
        rows = [rows[k] for k in sorted(chosen)]
    widths = [max(len(row[i]) for row in rows) for i in range(3)] if rows else []
    lines = ["  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths)) + f"  {row[3]}" for row in rows]
    lines += [f"  ... and {hidden} more"] if hidden > 0 else []
    answer = _called(question.answer, question.table)
    sampling = "" if answer.time or question.args[0].find("no sampling time") < 0 else (
        f"There is no column of time: {'DT=1' if paths else 'dt'} counts samples, put your sampling time in s in its "
        "place.\n"
    )  # fmt: skip
    table = f"{question}. Which are states and inputs? A guess:\n" + "\n".join(lines) + "\n" + sampling
    if not paths:  # an open table
        return f"{table}If it is right, else with other columns:\n  roles={_dictionary(answer)}"
    return (
        table
        + "If it is right, else with other columns (by name or number; INPUTS=none for a free motion):\n"
        + f"  {command(paths, answer)}\nIn Python, roles={_dictionary(answer)}"
    )  # fmt: skip


def command(paths: list, roles: Roles) -> str:
    """The command line of `make identify` that reads these files with these roles."""
    recording = str(paths[0]) if len(paths) == 1 else " ".join(str(path).replace(" ", "\\ ") for path in paths)
    recording = recording.replace("\n", " ")  # such a path is shown on the line, but cannot be pasted
    words = {"RECORDING": recording, "TIME": _listed([roles.time]) if roles.time else "none"}
    words |= {"STATES": _listed(roles.states), "INPUTS": _listed(roles.inputs) or "none"}
    words |= {"TRIAL": _listed([roles.trial])} if roles.trial else {}
    words |= {"DT": f"{roles.dt:g}"} if roles.dt else {}
    return "make identify " + " ".join(f"{name}={shlex.quote(visible(word))}" for name, word in words.items())


def _called(roles, table):
    """The roles, columns by number where the name on a screen is not the name: control signs, ends of lines."""
    numbers = {name: number for number, name, *_ in table if name != one_line(name)}
    columns = {role: numbers.get(getattr(roles, role), getattr(roles, role)) for role in ("time", "trial")}
    columns |= {role: [numbers.get(name, name) for name in getattr(roles, role)] for role in ("states", "inputs")}
    return roles._replace(**columns)


def _listed(names):
    """Names with commas between, as CSV has them."""
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(names)
    return text.getvalue()


def _dictionary(roles):
    content = {"time": roles.time, "states": roles.states, "inputs": roles.inputs}
    content |= {"trial": roles.trial} if roles.trial else {}
    return content | ({"dt": roles.dt} if roles.dt else {})
