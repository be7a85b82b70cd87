"""Checks of arguments: a wrong number, seed or name is refused in one sentence that says what to give instead.

Text from outside, such as the name of a channel, is data: `visible`, `one_line` and `short` make it fit to be read,
`in_code` fit for a generated file.

The name of the project on a package index stands here too, for the sentence about a library that only an extra brings.
"""

import contextlib
import difflib
import math
import numbers
import re
import unicodedata

DISTRIBUTION = "tras-koopman"  # `tras` is another project there
# Letters and marks that nobody sees, although Unicode counts them among what prints: fillers, joiners, selectors.
_UNSEEN = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef]"
)
_IN_CODE = re.compile(r"(?<=\*)(?=/)|(?<=/)(?=\*)|(?<=\?)(?=\?)")  # where comments of C end or begin, and trigraphs


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


def well_formed(name: str, text: str, error=ValueError) -> None:
    """Refuse text with a lone surrogate, which no file can hold: ``text`` is what ``name`` holds.

    >>> well_formed("state_names", "q" + chr(0xD800))
    Traceback (most recent call last):
        ...
    ValueError: state_names holds 'q\\ud800', whose character number 2 is no character (a lone surrogate); rename it.
    """
    try:
        text.encode()
    except UnicodeEncodeError as fault:
        what = f"whose character number {fault.start + 1} is no character (a lone surrogate)"
        raise error(f"{name} holds {text!r}, {what}; rename it.") from None


def visible(text) -> str:
    """Text from outside for people to read: what nobody sees, or what turns the order of letters, as its number.

    Lines, tabs and blanks stay.

    >>> visible("a" + chr(0x202E) + "b" + chr(7))
    'a<U+202E>b<U+0007>'
    """
    text = str(text)
    if not text.isprintable():
        text = "".join(map(_seen, text))
    return _UNSEEN.sub(_number, text)


def one_line(text) -> str:
    """`visible` text on one line, with single blanks between its words.

    >>> one_line("pitch" + chr(10) + "  angle" + chr(7))
    'pitch angle<U+0007>'
    """
    return visible(" ".join(str(text).split()))


def short(text: str, most: int = 40) -> str:
    """`one_line` of text, cut where it is long.

    >>> short("a" * 50, 10)
    'aaaaaaaaa…'
    """
    line = one_line(text)
    return line if len(line) <= most else f"{line[: most - 1]}…"


def percent(value) -> str:
    """A number of percent with two digits, large ones as whole numbers.

    >>> percent(0.0666), percent(131.4), percent("inf")
    ('0.067 %', '131 %', 'lost')
    """
    value = float(value)
    if not math.isfinite(value):
        return "lost"
    return f"{value:.0f} %" if abs(value) >= 99.5 else f"{value:.2g} %"


def in_code(text) -> str:
    """`one_line` of text for a comment of a generated file, which it can neither leave nor open.

    It holds no backslash (before the end of a line it would join the next line to this one), no ``*/`` or ``/*``, and
    no ``??``, which begins the backslash of old compilers.

    >>> in_code("*" + chr(92) + chr(10) + "/ #error"), in_code("*/ call(); /*" + "?" * 2 + "/")
    ('*<U+005C> / #error', '* / call(); / *? ?/')
    """
    return _IN_CODE.sub(" ", one_line(text).replace("\\", "<U+005C>"))


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


def _seen(letter):
    is_seen = letter.isprintable() or letter in "\n\t" or unicodedata.category(letter) == "Zs"
    return letter if is_seen else _number(letter)


def _number(match):
    """<U+202E> for that character, or for that match of one."""
    return f"<U+{ord(match[0]):04X}>"


def _range(kind, low, high, ends):
    if high < math.inf:
        return f"{kind} from {low:g} to {high:g}" if ends else f"{kind} between {low:g} and {high:g}"
    return kind if low == -math.inf else f"{kind}, {low:g} or more" if ends else f"{kind} above {low:g}"
