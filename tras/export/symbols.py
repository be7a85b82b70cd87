"""A dictionary's functions as expressions, and as code in C and MATLAB.

`Dictionary.lift` is arithmetic on arrays; with symbols in place of numbers it returns expressions. So ``_fill``
describes a dictionary once for all languages. SymPy would take 100 times as long (docs/export.md).
"""

from typing import NamedTuple

import numpy as np

# The same in C, MATLAB, Python; but C calls the absolute value of a floating-point number fabs.
FUNCTIONS = ("exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt", "abs")


class Symbol:
    """A scaled channel, a number, or an operation on symbols; in one table, equal expressions are one object."""

    __slots__ = ("kind", "parts", "table")

    def __init__(self, kind, parts, table):
        self.kind, self.parts, self.table = kind, parts, table

    def _of(self, kind, *parts):
        key = (kind, *parts)
        if key not in self.table:
            self.table[key] = Symbol(kind, parts, self.table)
        return self.table[key]

    def number(self, value):
        """``value`` as a symbol in the table of this one."""
        return value if isinstance(value, Symbol) else self._of("number", float(value))

    def _with(self, kind, a, b):
        if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
            return NotImplemented  # NumPy goes through the elements
        a, b = self.number(a), self.number(b)
        simpler = _simpler(kind, a, b)
        return self._of(kind, a, b) if simpler is None else simpler

    def __pow__(self, power):
        if power != int(power) or power < 1:
            raise TypeError(f"the power {power} is not a whole number of at least one")
        return self if power == 1 else self ** (power - 1) * self

    def __neg__(self):
        if self.kind == "negative":
            return self.parts[0]
        return self.number(-self.parts[0]) if self.kind == "number" else self._of("negative", self)

    def __abs__(self):
        return self._of("abs", self)

    def __bool__(self):
        raise TypeError("a symbol is neither true nor false")


for _kind, _name in (("+", "add"), ("-", "sub"), ("*", "mul"), ("/", "truediv")):
    setattr(Symbol, f"__{_name}__", lambda self, other, kind=_kind: self._with(kind, self, other))
    setattr(Symbol, f"__r{_name}__", lambda self, other, kind=_kind: self._with(kind, other, self))
for _name in FUNCTIONS[:-1]:  # NumPy calls an object's method of the same name
    setattr(Symbol, _name, lambda self, name=_name: self._of(name, self))


def _simpler(kind, a, b):
    """The result, where numbers, 0 or 1 simplify the operation; None otherwise."""
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
    """The N functions of a fitted dictionary as expressions in the scaled channels.

    Raises
    ------
    ValueError
        If its ``_fill`` uses an operation that symbols do not have.

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
        psi = dictionary.lift(np.array(channels, dtype=object)[:, None])[:, 0]
    except (TypeError, AttributeError) as error:
        raise ValueError(
            f"dictionary {type(dictionary).__name__!r} cannot be written as formulas ({error}); its _fill may use "
            f"+, -, *, /, whole powers and {', '.join(FUNCTIONS)}."
        ) from error
    return [channels[0].number(function) for function in psi]


class Language(NamedTuple):
    """How a language writes channels and functions (numbered from ``first``), intermediate results and operations."""

    channel: str
    function: str
    declaration: str
    first: int
    times: str
    over: str
    absolute: str = "abs"


C = Language("z[{}]", "psi[{}]", "const double ", 0, "*", "/", "fabs")
MATLAB = Language("z({},:)", "psi({},:)", "", 1, ".*", "./")


def slopes(nodes, channels):
    """The derivatives of expressions by the scaled channels that are not zero everywhere.

    Returns
    -------
    list of (int, int, Symbol)
        Number of the expression, number of the channel, and the derivative; in the order of the expressions.

    Examples
    --------
    >>> import tras
    >>> psi = functions(tras.Monomials(2).fit(np.zeros((1, 2))))
    >>> [(row, column, text(slope, C)) for row, column, slope in slopes(psi, 2)][2:5]
    [(3, 0, 'z[0] + z[0]'), (4, 0, 'z[1]'), (4, 1, 'z[0]')]
    """
    tables = [{} for _ in range(channels)]
    every = [(k, i, _derivative(node, i, tables[i])) for k, node in enumerate(nodes) for i in range(channels)]
    return [(k, i, slope) for k, i, slope in every if not (slope.kind == "number" and slope.parts[0] == 0)]


def _derivative(node, channel, known):
    """By the rules of calculus; ``known`` holds the derivatives of nodes by this channel."""
    if node in known:
        return known[node]
    if node.kind in ("number", "z"):
        result = node.number(node.kind == "z" and node.parts[0] == channel)
    else:
        moves = [_derivative(part, channel, known) for part in node.parts]
        if node.kind in "+-":
            result = moves[0] + moves[1] if node.kind == "+" else moves[0] - moves[1]
        elif node.kind == "*":
            result = moves[0] * node.parts[1] + node.parts[0] * moves[1]
        elif node.kind == "/" and node.parts[1].kind == "number":
            result = moves[0] * (1 / node.parts[1].parts[0])
        elif node.kind == "/":
            result = (moves[0] - node * moves[1]) / node.parts[1]
        elif node.kind == "negative":
            result = -moves[0]
        else:
            result = _SLOPES[node.kind](node.parts[0], node) * moves[0]
    known[node] = result
    return result


# Of a function at ``a``, where its value is ``f``.
_SLOPES = {
    "exp": lambda a, f: f,
    "log": lambda a, f: 1 / a,
    "sin": lambda a, f: a.cos(),
    "cos": lambda a, f: -a.sin(),
    "tan": lambda a, f: 1 + f * f,
    "sinh": lambda a, f: a.cosh(),
    "cosh": lambda a, f: a.sinh(),
    "tanh": lambda a, f: 1 - f * f,
    "sqrt": lambda a, f: 0.5 / f,
    "abs": lambda a, f: a._of("sign", a),
}


def literal(value):
    """A floating-point number with the fewest digits that read back the same bits, 17 at most."""
    return repr(float(value))


def text(node, language, names=None):
    """The expression in a language; ``names`` maps nodes that are computed already to their variables."""
    if names and node in names:
        return names[node]

    def write(part, least=0):
        inside = text(part, language, names)
        return f"({inside})" if rank(part, names) < least else inside

    if node.kind == "number":
        return literal(node.parts[0])
    if node.kind == "z":
        return language.channel.format(node.parts[0] + language.first)
    if node.kind in FUNCTIONS:
        return f"{language.absolute if node.kind == 'abs' else node.kind}({write(node.parts[0])})"
    if node.kind == "sign":  # of slopes, in C
        a = write(node.parts[0], 3)
        return f"(({a} > 0.0) - ({a} < 0.0))"
    if node.kind == "negative":
        return f"-{write(node.parts[0], 2)}"
    a, b = node.parts
    if node.kind in "+-":
        return f"{write(a)} {node.kind} {write(b, 2)}"
    # Brackets keep the order in which the dictionary computes.
    return write(a, 2) + (language.times if node.kind == "*" else language.over) + write(b, 3)


def rank(node, names=None):
    """1 for what needs brackets in a product, 2 for products, 3 for what never needs brackets."""
    if names and node in names:
        return 3
    if node.kind in ("+", "-", "negative") or node.kind == "number" and node.parts[0] < 0:
        return 1
    return 2 if node.kind in ("*", "/") else 3


def ordered(nodes):
    """All nodes within ``nodes``, parts before wholes, and how often each is used."""
    uses, order = {}, []

    def visit(node):
        uses[node] = uses.get(node, 0) + 1
        if uses[node] == 1:
            for part in node.parts:
                if isinstance(part, Symbol):
                    visit(part)
            order.append(node)

    for node in nodes:
        visit(node)
    return order, uses


def code(nodes, language, more=(), of_more=""):
    """Statements that compute all ``nodes``, each common part once: list of str.

    Behind the functions also ``more`` nodes, into the variables ``of_more``, which holds ``{}`` for the number.
    """
    functions = [language.function.format(k + language.first) for k in range(len(nodes))]
    functions += [of_more.format(k + language.first) for k in range(len(more))]
    nodes = [*nodes, *more]
    order, uses = ordered(nodes)
    results = dict(zip(nodes[::-1], functions[::-1]))  # the first of equal nodes
    names, lines, temporaries = {}, [], 0
    for node in order:
        leaf = node.kind in ("number", "z")
        if node not in results and (leaf or uses[node] == 1):
            continue
        if node in results:
            name, declaration = results[node], ""
        else:
            temporaries += 1
            name, declaration = f"t{temporaries}", language.declaration
        lines.append(f"{declaration}{name} = {text(node, language, names)};")
        if not leaf:
            names[node] = name
    return lines + [f"{f} = {results[node]};" for node, f in zip(nodes, functions) if results[node] != f]
