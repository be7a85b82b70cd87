"""The vector field, or the map from sample to sample, as formulas for a reader, in physical units: text and LaTeX.

The functions of the dictionary are expanded into sums of products, which removes the scaling from polynomials,
exponentials and waves. A function without such an expansion gets a line of its own in scaled channels.
"""

import re

import numpy as np

import tras
from tras.export import symbols
from tras.export.common import map_of
from tras.export.expansion import Expansion
from tras.model import KoopmanModel
from tras.recording import Recording
from tras.workflow.arguments import in_code

_GREEK = (
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi "
    "omega Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega"
).split()


def formulas(
    model: KoopmanModel, recording: Recording | None = None, *, tolerance: float = 1e-3, latex: bool = False
) -> str:
    """The vector field of a model, or its map from sample to sample, in physical units and with the channels' names.

    Parameters
    ----------
    model
        With the predictor ``vector_field`` or ``one_step``.
    recording
        Where terms are weighed, for example the training data. The default is random points in the box around the
        training data, along their principal axes (`tras.hull.Hull`); without a hull, in the ranges of the channels.
    tolerance
        How much omitted terms and rounded digits may change a row together, as a fraction of its root mean square, or
        with ``one_step`` of that of the change per sample. 0 omits nothing and writes 17 digits.
    latex
        Write an ``aligned`` block instead of text. The text is Python: it runs after ``from math import *``, given
        values for the channels.

    Returns
    -------
    str
        First comments: what the names mean, and how many terms are left out at which error. Then the formulas; terms
        stand in the order of their root mean square.

    Raises
    ------
    ValueError
        If the model is not fitted or ``lifted_linear``, or its dictionary cannot be written as formulas.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> x, u = np.zeros((20, 101, 1)), rng.uniform(-1, 1, (20, 101, 1))
    >>> for k in range(100):  # x' = -x + u, sampled at 0.1 s
    ...     x[:, k + 1] = np.exp(-0.1) * x[:, k] + (1 - np.exp(-0.1)) * u[:, k]
    >>> recording = tras.Recording(x, u, 0.1, state_names=["speed"], input_names=["force"])
    >>> model = tras.KoopmanModel(tras.Monomials(2)).fit(recording)
    >>> print(formulas(model).splitlines()[-1])
    dspeed_dt = force - speed
    """
    model.require_fitted()
    if model.predictor == "lifted_linear":
        raise ValueError("predictor is 'lifted_linear', which steps in the lifted space; use to_statespace().")
    if not (isinstance(tolerance, (int, float)) and 0 <= tolerance < 1):
        raise ValueError(f"tolerance is {tolerance!r}; give the error to allow as a fraction, from 0 to below 1.")
    expansion = Expansion(model)
    expansion.points, where = _points(expansion, recording)
    rows = expansion.rows(map_of(model)[0])
    selections, errors = _shortest(expansion, rows, tolerance, of_change=model.predictor == "one_step")
    lines = list(zip(expansion.left, selections))
    size = f"root mean square of the {'change in a sample' if model.predictor == 'one_step' else 'rate'}"
    notes = _notes(model, expansion, where)
    notes += [
        f"{name}: {len(row) - len(terms)} of {len(row)} terms left out; "
        f"that and the rounding change it by {error:.2g} of the {size}."
        for (name, terms), row, error in zip(lines, rows, errors)
    ]
    if latex:
        return _latex(expansion, lines, notes)
    text = [f"{name} = {formula}" for name, formula in _all_lines(expansion, lines, _Text)]
    return "\n".join([*(f"# {note}" for note in notes), *text])


def _points(expansion, recording):
    """Where terms are weighed, (n' + m, points) in physical units, and what these points are."""
    model = expansion.model
    if recording is not None:
        recording = model.channels_.matched(recording)
        recording = recording.delayed(model.delays, inputs=model.channels_.delayed_inputs)
        points = np.concatenate([np.hstack(pair) for pair in recording])
        samples = np.linspace(0, len(points) - 1, min(len(points), 2000)).astype(int)
        return points[samples].T, "the recording"
    z = np.random.default_rng(0).uniform(-1, 1, (len(expansion.names), 2000))
    if model.hull_ is not None:
        low, high = model.hull_.low, model.hull_.high
        z = model.hull_.centre + model.hull_.axes @ ((low + high) / 2 + z * (high - low) / 2)
    points = z * expansion.scales[:, None] + expansion.offsets[:, None]
    return points, "random points in the box around the training data"


def _shortest(expansion, rows, tolerance, of_change):
    """The terms that each row needs, largest first, and the error of the others; sets the fewest digits that serve."""
    wholes, sizes, selections = [], [], []
    for row, point in zip(rows, expansion.points):
        terms = expansion.values(row)
        whole = terms.sum(axis=0)
        size = _rms(whole - point if of_change else whole)
        order = np.argsort([-_rms(term) for term in terms], kind="stable")
        omitted, drop = np.zeros(len(whole)), set()
        for k in order[::-1] if tolerance else ():  # smallest first; after one that does not fit another may
            if _rms(omitted + terms[k]) <= tolerance / 2 * size:  # the other half is for digits
                omitted += terms[k]
                drop.add(k)
        monomials = list(row)
        selections.append({monomials[k]: row[monomials[k]] for k in order if k not in drop})
        wholes.append(whole)
        sizes.append(size)
    for digits in range(3 if tolerance else 17, 18):
        expansion.digits = digits
        changes = [_rms(expansion.values(terms).sum(axis=0) - whole) for terms, whole in zip(selections, wholes)]
        errors = [change / size if size else 0.0 for change, size in zip(changes, sizes)]
        if max(errors) <= tolerance:
            break
    return selections, errors


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def _notes(model, expansion, where):
    """What a reader must know: comments at the top."""
    what = "Rates (per s)" if model.predictor == "vector_field" else f"States one sample ({model.dt_!r} s) later,"
    dictionary = f"dictionary {model.dictionary_!r}, N = {len(model.names_)}"
    notes = [f"{what} by tras {tras.__version__}; {dictionary}; physical units."]
    pairs = zip(expansion.names, expansion.channels)
    meanings = ", ".join(f"{name} is '{channel}'" for name, channel in pairs if name != channel)
    notes += [f"Names: {meanings}."] * bool(meanings)
    if model.hull_ is not None:
        notes.append("Holds for the training data; beyond them the model goes on linearly, which is not written here.")
    notes.append(f"Terms in the order of their size over {where}; numbers with {expansion.digits} digits.")
    return [in_code(note) for note in notes]


class _Text:
    """How Python, and nearly every language, writes a formula."""

    times = "*"
    number = staticmethod(lambda value: repr(value).removesuffix(".0"))
    name = staticmethod(lambda name: name)
    power = staticmethod(lambda base, k: f"{base}**{k}")
    function = staticmethod(lambda name, argument: f"{name}({argument})")
    fraction = staticmethod(lambda a, b: f"{a}/{b}")
    brackets = staticmethod(lambda inside: f"({inside})")


class _Latex(_Text):
    times = r" \, "
    power = staticmethod(lambda base, k: f"{{{base}}}^{{{k}}}")
    function = staticmethod(
        lambda name, argument: rf"\left|{argument}\right|" if name == "abs" else rf"\{name}\left({argument}\right)"
    )
    fraction = staticmethod(lambda a, b: rf"\frac{{{a}}}{{{b}}}")
    brackets = staticmethod(lambda inside: rf"\left({inside}\right)")

    @staticmethod
    def number(value):
        mantissa, _, exponent = _Text.number(value).partition("e")
        return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa

    @staticmethod
    def name(name):
        """``phidot`` as a dotted phi, ``u_phi`` with an index; names of Greek letters as these letters."""
        letter, _, index = name.partition("_")
        dotted = letter.endswith("dot") and len(letter) > 3
        letter = _symbol(letter.removesuffix("dot") if dotted else letter)
        letter = rf"\dot{{{letter}}}" if dotted else f"{{{letter}}}" if index and "_" in letter else letter
        return f"{letter}_{{{', '.join(map(_symbol, index.split('_')))}}}" if index else letter


def _symbol(word):
    """A word, perhaps with a number behind it, in LaTeX."""
    match = re.fullmatch(r"([A-Za-z]+)(\d+)", word)
    if match and (match[1] in _GREEK or len(match[1]) == 1):
        return f"{_symbol(match[1])}_{{{match[2]}}}"
    return f"\\{word}" if word in _GREEK else word if len(word) < 2 or word.isdigit() else rf"\mathrm{{{word}}}"


def _sum(expansion, row, style):
    """The sum of a row's terms."""
    terms = []
    for monomial, value in row.items():
        value = expansion.round(value)
        bases = [(_factor(expansion, factor, style), power) for factor, power in monomial]
        factors = [base if power == 1 else style.power(base, power) for base, power in bases]
        if abs(value) != 1 or not factors:
            factors.insert(0, style.number(abs(value)))
        terms.append(("-" if value < 0 else "+", style.times.join(factors)))
    text = " ".join(f"{sign} {term}" for sign, term in terms) or style.number(0.0)
    return text.removeprefix("+ ") if not text.startswith("- ") else f"-{text[2:]}"


def _factor(expansion, factor, style):
    if factor < len(expansion.names):
        return style.name(expansion.names[factor])
    node = expansion.atoms[factor - len(expansion.names)]
    if node in expansion.definitions:
        return style.name(expansion.definitions[node])
    return style.function(node.kind, _sum(expansion, expansion.sum(node.parts[0]), style))


def _tree(expansion, node, style):
    """A node without expansion, in scaled channels."""
    write = lambda part: _tree(expansion, part, style)  # noqa: E731

    def inside(part, least):
        return style.brackets(write(part)) if symbols.rank(part) < least else write(part)

    if node.kind == "number":
        value = expansion.round(node.parts[0])
        return style.number(value) if value >= 0 else f"-{style.number(-value)}"
    if node.kind == "z":
        return style.name(expansion.scaled[node.parts[0]])
    if node.kind in symbols.FUNCTIONS:
        part = node.parts[0]
        argument = _sum(expansion, expansion.sum(part), style) if expansion.expands(node) else write(part)
        return style.function(node.kind, argument)
    if node.kind == "negative":
        return f"-{inside(node.parts[0], 2)}"
    a, b = node.parts
    if node.kind in "+-":
        return f"{write(a)} {node.kind} {inside(b, 2)}"
    if node.kind == "/":
        return style.fraction(inside(a, 2), inside(b, 3)) if style is _Text else style.fraction(write(a), write(b))
    return style.power(inside(a, 3), 2) if a is b else f"{inside(a, 2)}{style.times}{inside(b, 3)}"


def _all_lines(expansion, lines, style):
    """(name, formula) of each line, after the definitions that the lines need."""
    factors = {factor for _, row in lines for monomial in row for factor, _ in monomial}
    atoms = [node for k, node in enumerate(expansion.atoms, len(expansion.names)) if k in factors]
    nodes, formulas = [node for node in atoms if node in expansion.definitions], []
    for i in sorted(node.parts[0] for node in symbols.ordered(nodes)[0] if node.kind == "z"):
        offset, scale = expansion.round(expansion.offsets[i]), expansion.round(expansion.scales[i])
        shift = f"{style.name(expansion.names[i])} {'-' if offset >= 0 else '+'} {style.number(abs(offset))}"
        shift = style.brackets(shift) if style is _Text else shift
        formulas.append((style.name(expansion.scaled[i]), style.fraction(shift, style.number(scale))))
    formulas += [(style.name(expansion.definitions[node]), _tree(expansion, node, style)) for node in nodes]
    return formulas + [(name, _sum(expansion, row, style)) for name, row in lines]


def _latex(expansion, lines, notes):
    pattern = r"\frac{{d {}}}{{d t}}"
    if expansion.model.predictor == "one_step":
        pattern = f"{{}}(t + {_Latex.number(expansion.model.dt_)})"
    left = [pattern.format(_Latex.name(name)) for name in expansion.names]
    formulas = _all_lines(expansion, [(name, row) for name, (_, row) in zip(left, lines)], _Latex)
    rows = " \\\\\n".join(f"{name} &= {formula}" for name, formula in formulas)
    return "\n".join([*(f"% {note}" for note in notes), r"\begin{aligned}", rows, r"\end{aligned}"])
