"""The vector field, or the map from sample to sample, as formulas that a person reads: text and LaTeX.

In physical units. The functions of the dictionary are expanded into sums of products: polynomials, exponentials and waves lose the scaling of
the channels in it. What cannot be written so, functions of a distance for example, gets a line of its own, in scaled channels, and these another.
"""

import re

import numpy as np

import tras
from tras import symbols
from tras.expansion import Expansion
from tras.export import map_of

_GREEK = (
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi omega "
    "Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega"
).split()


def formulas(model, recording=None, *, tolerance=1e-3, latex=False):
    """The vector field, or the map from sample to sample, of a model, in physical units, with the names of its channels.

    Parameters
    ----------
    model : KoopmanModel
        With the predictor ``vector_field`` or ``one_step``.
    recording : Recording, optional
        Where terms are weighed, for example what the model was fitted to. Without it at random points in the box around the training data
        along their principal axes (`tras.hull.Hull`); if the model has none, in the ranges of the channels.
    tolerance : float
        How much terms that are left out and digits that are not written may change a row together, as a fraction of its root mean square; of the
        change in a sample with ``one_step``. 0 leaves nothing out and writes 17 digits.
    latex : bool
        An ``aligned`` block instead of text. The text is Python's: with ``from math import *`` and values for the channels it runs.

    Returns
    -------
    str
        Comments first: what the names mean, and how many terms are left out at which error. Terms in the order of their root mean square.

    Raises
    ------
    ValueError
        If the model is not fitted or ``lifted_linear``, or its dictionary does what has no formula.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> x, u = np.zeros((20, 101, 1)), rng.uniform(-1, 1, (20, 101, 1))
    >>> for k in range(100):  # x' = -x + u, sampled at 0.1 s
    ...     x[:, k + 1] = np.exp(-0.1) * x[:, k] + (1 - np.exp(-0.1)) * u[:, k]
    >>> model = tras.KoopmanModel(tras.Monomials(2)).fit(tras.Recording(x, u, 0.1, state_names=["speed"], input_names=["force"]))
    >>> print(formulas(model).splitlines()[-1])
    dspeed_dt = force - speed
    """
    model.require_fitted()
    if model.predictor == "lifted_linear":
        raise ValueError("predictor is 'lifted_linear', which steps in the lifted space and has no map of the states alone; use to_statespace().")
    if not (isinstance(tolerance, (int, float)) and 0 <= tolerance < 1):
        raise ValueError(f"tolerance is {tolerance!r}; give the error to allow as a fraction, from 0 to below 1, for example 0.001.")
    points, where = _points(model, recording)
    expansion = Expansion(model, points)
    rows = expansion.rows(map_of(model).matrix)
    kept, digits = _shortest(expansion, rows, points, tolerance, of_change=model.predictor == "one_step")
    expansion.digits = digits
    lines = [(name, {m: row[m] for m in keep}) for name, row, (keep, _) in zip(expansion.left, rows, kept)]
    size = f"root mean square of the {'change in a sample' if model.predictor == 'one_step' else 'rate'}"
    notes = _notes(model, expansion, where, digits)
    notes += [
        f"{name}: {len(row) - len(keep)} of {len(row)} terms left out; that and the rounding change it by {error:.2g} of the {size}."
        for name, row, (keep, error) in zip(expansion.left, rows, kept)
    ]
    return _latex(expansion, lines, notes) if latex else _text(expansion, lines, notes)


def _points(model, recording):
    """Where terms are weighed, (n' + m, points) in physical units, and a word on it."""
    if recording is not None:
        recording = model.channels_.matched(recording)
        x, u = (np.concatenate(part) for part in zip(*recording.delayed(model.delays, inputs=model.channels_.delayed_inputs)))
        chosen = np.linspace(0, len(x) - 1, min(len(x), 2000)).astype(int)
        return np.hstack([x, u])[chosen].T, "the recording"
    rng, channels = np.random.default_rng(0), len(model.channels_.z_scale) + len(model.input_names_)
    z = rng.uniform(-1, 1, (channels, 2000))
    if model.hull_ is not None:
        low, high = model.hull_.low, model.hull_.high
        z = model.hull_.centre + model.hull_.axes @ ((low + high) / 2 + z * (high - low) / 2)
    own = model.channels_
    offsets, scales = np.concatenate([own.z_offset, own.u_offset]), np.concatenate([own.z_scale, own.u_scale])
    return z * scales[:, None] + offsets[:, None], "random points in the box around the training data"


def _shortest(expansion, rows, points, tolerance, of_change):
    """The terms of each row that must stay, largest first, the error of the rest, and the fewest digits that do.

    Half of the tolerance is for terms, the rest for digits.
    """
    exact, kept = [], []
    for i, row in enumerate(rows):
        terms = expansion.values(row)
        whole = terms.sum(axis=0)
        size = _rms(whole - points[i] if of_change else whole)
        order = np.argsort([-_rms(term) for term in terms], kind="stable")
        left_out, drop = np.zeros(points.shape[1]), set()
        for k in order[::-1] if tolerance else ():  # the smallest first; one that does not fit may be followed by one that does
            if _rms(left_out + terms[k]) <= tolerance / 2 * size:
                left_out += terms[k]
                drop.add(k)
        monomials = list(row)
        kept.append([monomials[k] for k in order if k not in drop])
        exact.append((whole, size))
    for digits in range(3 if tolerance else 17, 18):
        expansion.digits = digits
        errors = []
        for row, keep, (whole, size) in zip(rows, kept, exact):
            error = _rms(expansion.values({m: row[m] for m in keep}).sum(axis=0) - whole)
            errors.append(error / size if size else 0.0)
        if max(errors) <= tolerance:
            break
    return list(zip(kept, errors)), digits


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def _notes(model, expansion, where, digits):
    """What a reader must know."""
    what = "Rates (per s)" if model.predictor == "vector_field" else f"States one sample ({model.dt_!r} s) later,"
    notes = [f"{what} by tras {tras.__version__}; dictionary {model.dictionary_!r}, N = {len(model.names_)}; physical units.", _meanings(expansion)]
    if model.hull_ is not None:
        notes.append("Holds for the training data; beyond them the model goes on linearly, which is not written here.")
    notes.append(f"Terms in the order of their size over {where}; numbers with {digits} digits.")
    return [" ".join(note.split()) for note in notes if note]


def _meanings(expansion):
    """Names that had to be changed."""
    changed = [f"{name} is {channel!r}" for name, channel in zip(expansion.names, expansion.channels) if name != channel]
    return f"Names: {', '.join(changed)}." if changed else ""


def _definitions(expansion, lines):
    """Scaled channels and functions that the lines need, as (name, node or channel's number)."""
    used = {factor for _, row in lines for monomial in row for factor, _ in monomial}
    own = [node for k, node in enumerate(expansion.atoms) if id(node) in expansion.own and k + len(expansion.names) in used]
    channels = sorted({i for node in own for i in symbols.channels_in(node)})
    return [(expansion.scaled[i], i) for i in channels], [(expansion.own[id(node)], node) for node in own]


# ----------------------------------------------------------------------------------------------------------------------- text


class _Text:
    """How a formula is written in Python, and nearly everywhere else."""

    times, equals = "*", " = "
    number = staticmethod(lambda value: repr(value).removesuffix(".0"))
    name = staticmethod(lambda name: name)
    power = staticmethod(lambda base, k: f"{base}**{k}")
    function = staticmethod(lambda name, argument: f"{name}({argument})")
    fraction = staticmethod(lambda a, b: f"{a}/{b}")
    brackets = staticmethod(lambda inside: f"({inside})")


class _Latex(_Text):
    times, equals = r" \, ", " &= "
    power = staticmethod(lambda base, k: f"{{{base}}}^{{{k}}}")
    function = staticmethod(lambda name, argument: rf"\{name}\left({argument}\right)")
    fraction = staticmethod(lambda a, b: rf"\frac{{{a}}}{{{b}}}")
    brackets = staticmethod(lambda inside: rf"\left({inside}\right)")

    @staticmethod
    def number(value):
        mantissa, _, exponent = _Text.number(value).partition("e")
        return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa

    @staticmethod
    def name(name):
        """``phidot`` as a dotted phi, ``u_phi`` with an index; Greek letters are Greek."""
        letter, _, index = name.partition("_")
        dotted = letter.endswith("dot") and len(letter) > 3
        letter = letter.removesuffix("dot") if dotted else letter
        letter = _symbol(letter)
        letter = rf"\dot{{{letter}}}" if dotted else letter
        return f"{letter}_{{{', '.join(map(_symbol, index.split('_')))}}}" if index else letter


def _symbol(word):
    split = re.fullmatch(r"([A-Za-z]+)(\d+)", word)
    if split:
        return f"{_symbol(split[1])}_{{{split[2]}}}" if split[1] in _GREEK or len(split[1]) == 1 else rf"\mathrm{{{word}}}"
    return f"\\{word}" if word in _GREEK else word if len(word) < 2 or word.isdigit() else rf"\mathrm{{{word}}}"


def _written(expansion, row, style):
    """The sum of a row."""
    terms = []
    for monomial, value in row.items():
        value = expansion.round(value)
        factors = [_power(_factor(expansion, factor, style), power, style) for factor, power in monomial]
        if abs(value) != 1 or not factors:
            factors.insert(0, style.number(abs(value)))
        terms.append(("-" if value < 0 else "+", style.times.join(factors)))
    text = " ".join(f"{sign} {term}" for sign, term in terms) or style.number(0.0)
    return text.removeprefix("+ ") if not text.startswith("- ") else f"-{text[2:]}"


def _power(base, k, style):
    return base if k == 1 else style.power(base, k)


def _factor(expansion, factor, style):
    if factor < len(expansion.names):
        return style.name(expansion.names[factor])
    node = expansion.atoms[factor - len(expansion.names)]
    if id(node) in expansion.own:
        return style.name(expansion.own[id(node)])
    return style.function(node.kind, _written(expansion, expansion.sum(node.parts[0]), style))


def _tree(expansion, node, style):
    """A node as it stands, in scaled channels."""
    write = lambda part: _tree(expansion, part, style)  # noqa: E731
    inside = lambda part, least: style.brackets(write(part)) if symbols.rank(part) < least else write(part)  # noqa: E731
    if node.kind == "number":
        value = expansion.round(node.parts[0])
        return style.number(value) if value >= 0 else f"-{style.number(-value)}"
    if node.kind == "z":
        return style.name(expansion.scaled[node.parts[0]])
    if node.kind in symbols.FUNCTIONS:
        linear = expansion.expands(node)
        return style.function(node.kind, _written(expansion, expansion.sum(node.parts[0]), style) if linear else write(node.parts[0]))
    if node.kind == "negative":
        return f"-{inside(node.parts[0], 2)}"
    a, b = node.parts
    if node.kind in "+-":
        return f"{write(a)} {node.kind} {inside(b, 2)}"
    if node.kind == "/":
        return style.fraction(inside(a, 2) if style is _Text else write(a), inside(b, 3) if style is _Text else write(b))
    return style.power(inside(a, 3), 2) if a is b else f"{inside(a, 2)}{style.times}{inside(b, 3)}"


def _all_lines(expansion, lines, style):
    scaled, own = _definitions(expansion, lines)
    found = []
    for name, i in scaled:
        offset, scale = expansion.round(expansion.offsets[i]), expansion.round(expansion.scales[i])
        moved = f"{style.name(expansion.names[i])} {'-' if offset >= 0 else '+'} {style.number(abs(offset))}"
        found.append((style.name(name), style.fraction(style.brackets(moved) if style is _Text else moved, style.number(scale))))
    return found + [(style.name(name), _tree(expansion, node, style)) for name, node in own]


def _text(expansion, lines, notes):
    found = _all_lines(expansion, lines, _Text) + [(name, _written(expansion, row, _Text)) for name, row in lines]
    return "\n".join([*(f"# {note}" for note in notes), *(f"{name} = {formula}" for name, formula in found)])


def _latex(expansion, lines, notes):
    field = expansion.model.predictor == "vector_field"
    left = [_Latex.name(name) for name, _ in zip(expansion.names, lines)]
    left = [rf"\frac{{d {name}}}{{d t}}" if field else rf"{name}(t + {_Latex.number(expansion.model.dt_)})" for name in left]
    found = _all_lines(expansion, lines, _Latex) + [(name, _written(expansion, row, _Latex)) for name, (_, row) in zip(left, lines)]
    rows = " \\\\\n".join(f"{name} &= {formula}" for name, formula in found)
    return "\n".join([*(f"% {note}" for note in notes), r"\begin{aligned}", rows, r"\end{aligned}"])
