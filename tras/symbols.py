"""Dictionaries as formulas: their functions computed with symbols in place of numbers, and written as code.

`Dictionary.lift` is arithmetic on arrays, and NumPy computes with arrays of any objects. Handed symbols it returns its functions as
expressions, so a dictionary is described once, by its own ``_fill``, and C, MATLAB and printed formulas follow from that.
"""

from typing import NamedTuple

import numpy as np

FUNCTIONS = ("exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt")  # called the same in C, MATLAB and Python


class Symbol:
    """A channel of scaled points, a number, or an operation on symbols; within a table the same expression is the same object."""

    __slots__ = ("kind", "parts", "table")

    def __init__(self, kind, parts, table):
        self.kind, self.parts, self.table = kind, parts, table

    def _of(self, kind, *parts):
        key = (kind, *(id(part) if isinstance(part, Symbol) else part for part in parts))
        if key not in self.table:
            self.table[key] = Symbol(kind, parts, self.table)
        return self.table[key]

    def number(self, value):
        """``value`` as a symbol of this one's table."""
        return value if isinstance(value, Symbol) else self._of("number", float(value))

    def _with(self, kind, a, b):
        if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
            return NotImplemented  # NumPy takes them one by one
        a, b = self.number(a), self.number(b)
        simpler = _simpler(kind, a, b)
        return self._of(kind, a, b) if simpler is None else simpler

    def __add__(self, other):
        return self._with("+", self, other)

    def __radd__(self, other):
        return self._with("+", other, self)

    def __sub__(self, other):
        return self._with("-", self, other)

    def __rsub__(self, other):
        return self._with("-", other, self)

    def __mul__(self, other):
        return self._with("*", self, other)

    def __rmul__(self, other):
        return self._with("*", other, self)

    def __truediv__(self, other):
        return self._with("/", self, other)

    def __rtruediv__(self, other):
        return self._with("/", other, self)

    def __pow__(self, power):
        if power != int(power) or power < 1:
            raise TypeError(f"the power {power} is no whole number of at least one")
        return self if power == 1 else self ** (power - 1) * self

    def __neg__(self):
        if self.kind == "negative":
            return self.parts[0]
        return self.number(-self.parts[0]) if self.kind == "number" else self._of("negative", self)

    def __bool__(self):
        raise TypeError("a symbol is neither true nor false")


def _function(name):
    return lambda self: self._of(name, self)


for _name in FUNCTIONS:  # NumPy's exp of an object is that object's method of the same name
    setattr(Symbol, _name, _function(_name))


def _simpler(kind, a, b):
    """What the operation comes to without computing, for numbers, 0 and 1; None otherwise."""
    if a.kind == b.kind == "number" and not (kind == "/" and b.parts[0] == 0):
        x, y = a.parts[0], b.parts[0]
        return a.number({"+": x + y, "-": x - y, "*": x * y}[kind] if kind != "/" else x / y)
    zero, one = a.number(0), a.number(1)
    if kind in "+-" and b is zero or kind in "*/" and b is one:
        return a
    if kind == "+" and a is zero or kind == "*" and a is one:
        return b
    if kind == "*" and (a is zero or b is zero):
        return zero
    if kind == "-" and a is zero:
        return -b
    return a + -b if kind == "-" and b.kind == "number" and b.parts[0] < 0 else None


def functions(dictionary):
    """The N functions of a fitted dictionary as symbols of the scaled channels.

    Raises
    ------
    ValueError
        If its ``_fill`` does what has no formula here.

    Examples
    --------
    >>> import tras
    >>> psi = tras.Monomials(2).fit(np.zeros((1, 2)))
    >>> [text(function, C) for function in functions(psi)]
    ['1.0', 'z[0]', 'z[1]', 'z[0]*z[0]', 'z[1]*z[0]', 'z[1]*z[1]']
    """
    table = {}
    channels = [Symbol("z", (i,), table) for i in range(dictionary.n_states_ + dictionary.n_inputs_)]
    try:
        return [channels[0].number(function) for function in dictionary.lift(np.array(channels, dtype=object)[:, None])[:, 0]]
    except (TypeError, AttributeError) as error:
        raise ValueError(
            f"dictionary {type(dictionary).__name__!r} cannot be written as formulas ({error}); its _fill may use +, -, *, /, whole powers and "
            f"{', '.join(FUNCTIONS)}."
        ) from error


class Language(NamedTuple):
    """How a language writes channels, functions of the dictionary and intermediate results, counted from ``first``, and operations."""

    channel: str
    function: str
    declaration: str
    first: int
    times: str
    over: str


C = Language("z[{}]", "psi[{}]", "const double ", 0, "*", "/")
MATLAB = Language("z({},:)", "psi({},:)", "", 1, ".*", "./")


def literal(value):
    """A number with as many digits as it takes to read the same bits back, 17 at most, and always a floating-point one."""
    return repr(float(value))


def text(node, language, named=None):
    """The expression in a language; ``named`` holds names of nodes that are computed already, by id."""
    if named and id(node) in named:
        return named[id(node)]
    write = lambda part: text(part, language, named)  # noqa: E731
    if node.kind == "number":
        return literal(node.parts[0])
    if node.kind == "z":
        return language.channel.format(node.parts[0] + language.first)
    if node.kind in FUNCTIONS:
        return f"{node.kind}({write(node.parts[0])})"
    sums = [rank(part, named) == 1 for part in node.parts]
    if node.kind == "negative":
        return f"-({write(node.parts[0])})" if sums[0] else f"-{write(node.parts[0])}"
    left, right = map(write, node.parts)
    if node.kind in "+-":
        right = f"({right})" if sums[1] else right
        return f"{left} {node.kind} {right}".replace(" + -", " - ") if node.kind == "+" else f"{left} - {right}"
    # Brackets keep the order in which the dictionary itself computes.
    left = f"({left})" if sums[0] else left
    right = f"({right})" if rank(node.parts[1], named) < 3 else right
    return left + (language.times if node.kind == "*" else language.over) + right


def rank(node, named=None):
    """1 for what needs brackets in a product, 2 for products, 3 for what never needs any."""
    if named and id(node) in named:
        return 3
    if node.kind in ("+", "-", "negative") or node.kind == "number" and node.parts[0] < 0:
        return 1
    return 2 if node.kind in ("*", "/") else 3


def ordered(nodes):
    """Every node that ``nodes`` are made of, parts before what is made of them, and how many use each, by id."""
    uses, order = {}, []

    def visit(node):
        uses[id(node)] = uses.get(id(node), 0) + 1
        if uses[id(node)] == 1:
            for part in node.parts:
                if isinstance(part, Symbol):
                    visit(part)
            order.append(node)

    for node in nodes:
        visit(node)
    return order, uses


def channels_in(node):
    """The channels that an expression depends on."""
    return {part.parts[0] for part in ordered([node])[0] if part.kind == "z"}


def code(nodes, language):
    """Statements that compute all ``nodes``, what several of them need once: list of str."""
    order, uses = ordered(nodes)
    own = {}
    for k, node in enumerate(nodes):
        own.setdefault(id(node), k)
    named, lines, temporaries = {}, [], 0
    for node in order:
        if id(node) in own:
            name = language.function.format(own[id(node)] + language.first)
            lines.append(f"{name} = {text(node, language, named)};")
        elif uses[id(node)] > 1 and node.kind not in ("number", "z"):
            temporaries += 1
            name = f"t{temporaries}"
            lines.append(f"{language.declaration}{name} = {text(node, language, named)};")
        else:
            continue
        if node.kind not in ("number", "z"):
            named[id(node)] = name
    copies = [(k, own[id(node)]) for k, node in enumerate(nodes) if own[id(node)] != k]
    return lines + [f"{language.function.format(k + language.first)} = {language.function.format(j + language.first)};" for k, j in copies]
