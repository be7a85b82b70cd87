"""Checks of arguments: a wrong number, seed or name is refused in one sentence that says what to give instead.

The name of the project on a package index stands here too, for the sentence about a library that only an extra brings.
"""

import contextlib
import difflib
import math
import numbers

DISTRIBUTION = "tras-koopman"  # `tras` is another project there


def number(name: str, value, low=-math.inf, high=math.inf, *, ends=True, give="", error=ValueError) -> None:
    """Refuse what is not a finite number from ``low`` to ``high``, or between them with ``ends=False``; True is none.

    The sentence says to ``give`` that instead, by default a number in this range; ``error`` is a kind of ValueError.

    >>> number("level", 1.5, 0, 1, ends=False)
    Traceback (most recent call last):
        ...
    ValueError: level is 1.5; give a number between 0 and 1.
    """
    sound = isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
    if not (sound and (low <= value <= high if ends else low < value < high)):
        raise error(f"{name} is {short(repr(value), 60)}; give {give or 'a ' + _range('number', low, high, ends)}.")


def whole_number(name: str, value, low=1, high=math.inf, *, give="", error=ValueError) -> None:
    """Refuse what is not a whole number from ``low`` to ``high``; see `number`.

    >>> whole_number("draws", True, 2)
    Traceback (most recent call last):
        ...
    ValueError: draws is True; give a whole number, 2 or more.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or not low <= value <= high:
        raise error(
            f"{name} is {short(repr(value), 60)}; give {give or 'a ' + _range('whole number', low, high, True)}."
        )


def seed(name: str, value, purpose: str) -> None:
    """Refuse what is neither a numpy.random.Generator nor a seed; ``purpose`` says what can then be had again."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) and not hasattr(value, "bit_generator"):
        remedy = f"give a numpy.random.Generator or a seed, so that {purpose} can be had again"
        raise ValueError(f"{name} is {value!r}; {remedy}.")


def short(text: str, most: int = 40) -> str:
    """A name from a file for people to read: on one line, cut where it is long, without unprintable characters.

    >>> short("pitch" + chr(10) + "angle" + chr(7)), short("a" * 50, 10)
    ('pitch angle�', 'aaaaaaaaa…')
    """
    line = "".join(letter if letter.isprintable() else "\ufffd" for letter in " ".join(str(text).split()))
    return line if len(line) <= most else f"{line[: most - 1]}…"


def did_you_mean(name, known) -> str:
    """The end of a sentence about a name that is not among those that are known.

    >>> did_you_mean("sed", ["seed", "duration"]), did_you_mean("x", ["seed", "duration"])
    (": did you mean 'seed'?", ': choose one of seed, duration.')
    """
    known = list(map(str, known))
    close = difflib.get_close_matches(str(name), known, 1)
    return f": did you mean {close[0]!r}?" if close else f": choose one of {', '.join(known) or 'none'}."


class MissingExtraError(ImportError):
    """A library is not installed that only an extra of the package brings."""


@contextlib.contextmanager
def extra(name: str, purpose: str):
    """Round imports of libraries that the extra ``name`` brings: one that is missing is named, and how to get it.

    >>> with extra("cluster", "a scheduler"):
    ...     import no_such_library
    Traceback (most recent call last):
        ...
    tras.workflow.arguments.MissingExtraError: a scheduler needs no_such_library, which is not installed: ...
    """
    try:
        yield
    except ModuleNotFoundError as error:
        remedy = f"pip install '{DISTRIBUTION}[{name}]'"
        raise MissingExtraError(f"{purpose} needs {error.name}, which is not installed: {remedy}.") from None


def _range(kind, low, high, ends):
    if high < math.inf:
        return f"{kind} from {low:g} to {high:g}" if ends else f"{kind} between {low:g} and {high:g}"
    return kind if low == -math.inf else f"{kind}, {low:g} or more" if ends else f"{kind} above {low:g}"
