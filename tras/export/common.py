"""Models for other programs: what MATLAB, C and formulas share (names, origin, the map), and python-control.

No file contains the time of writing: the same model gives the same bytes.
"""

import itertools
import keyword
import re
from pathlib import Path
from typing import Any

import numpy as np

import tras
from tras.analysis.linearization import acting, for_control
from tras.model import KoopmanModel
from tras.workflow.arguments import in_code

# Names that no function or variable may have in Python, C99, MATLAB or Octave.
_RESERVED_WORDS = {
    *keyword.kwlist,
    *"auto break case char const continue default do double else enum extern float for goto if inline int long".split(),
    *"register restrict return short signed sizeof static struct switch typedef union unsigned void volatile".split(),
    *"while main catch classdef elseif end endfunction endif function global otherwise parfor persistent".split(),
    *"spmd until exp log sin cos tan sinh cosh tanh sqrt abs fabs pi e i j".split(),
}


def map_of(model):
    """(matrix, arrays of the hull or {}) of the rates of all states, or of the n next states with ``one_step``."""
    matrix, _, hull, outward = model.map()
    rows = slice(len(model.state_names_) if model.predictor == "one_step" else None)
    if hull is None:
        return matrix[rows], {}
    box = {"centre": hull.centre[:, 0], "axes": hull.axes, "low": hull.lower[:, 0], "high": hull.upper[:, 0]}
    return matrix[rows], box | {"outward": outward[rows]}


def identifier(name: str, avoid=()) -> str:
    """``name`` as a variable of C, MATLAB and Python, and none to ``avoid``: ``"3 phi[-1]"`` becomes ``"x3_phi_1"``.

    Examples
    --------
    >>> identifier("phi[-1]"), identifier("while"), identifier("phi", avoid={"phi"})
    ('phi_1', 'while_', 'phi_2')
    """
    word = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:40] or "x"
    word = f"x{word}" if word[0].isdigit() else word
    word = f"{word}_" if word in _RESERVED_WORDS else word
    candidates = itertools.chain([word], (f"{word}_{k}" for k in itertools.count(2)))
    return next(candidate for candidate in candidates if candidate not in avoid)


def identifiers(names, avoid=()):
    """An `identifier` for each name, all different and none to ``avoid``."""
    words = []
    for name in names:
        words.append(identifier(name, {*words, *avoid}))
    return words


def file_and_name(path, suffix):
    """The path, and the name that the functions in the file begin with.

    The generated files name each other, so the file's name must be text that is safe in them.
    """
    path = Path(path)
    if path.name != in_code(path.name) or set(path.name) & set("\"'"):
        allowed = "without quotation marks, backslashes, '??' and characters that are not seen"
        raise ValueError(f"path has the name {path.name!r}, which the generated files cannot hold; give one {allowed}.")
    if path.suffix != suffix:
        raise ValueError(f"path {path} ends in {path.suffix!r}; give one that ends in {suffix}, such as model{suffix}.")
    return path, identifier(path.stem)


def origin(model, path, name):
    """Lines of text, safe in a comment: where a file comes from, and what its numbers mean."""
    units = [unit or "unit unknown" for unit in (*model.state_units_, *model.input_units_)]
    channels = [f"{channel} ({unit})" for channel, unit in zip((*model.state_names_, *model.input_names_), units)]
    n = len(model.state_names_)
    lines = [
        f"A model identified by extended dynamic mode decomposition; written by tras {tras.__version__}.",
        f"predictor {model.predictor}, dictionary {model.dictionary_!r}, N = {len(model.names_)}",
        f"sampling time {model.dt_!r} s, delays {model.delays}, "
        f"regularization {model.regularization} of strength {model.strength_!r}",
        f"states: {', '.join(channels[:n])}",
        f"inputs: {', '.join(channels[n:]) or 'none'}",
    ]
    if model.channels_.lead:
        lines.append(
            "u is the input at the end of a sample: of the instant that is predicted, not of the one before it."
        )
    if path.stem != name:
        lines.append(f"Functions are called {name}_..., because {path.stem!r} is no name in the language.")
    return [in_code(line) for line in lines]


def vectors(model):
    """What the vectors x (the newest sample, then the delayed ones) and u hold, one text per entry: two lists.

    The texts are safe in a comment.
    """
    units = [*model.state_units_ * (model.delays + 1), *model.input_units_ * model.delays]
    labels = (zip(model.channels_.z_names, units), zip(model.input_names_, model.input_units_))
    return [[in_code(f"{name} ({unit})" if unit else name) for name, unit in pairs] for pairs in labels]


def to_statespace(model: KoopmanModel) -> Any:
    """A ``lifted_linear`` model as ``z[k+1] = A z[k] + B u[k]``, ``x[k] = C z[k] + D u[k]``.

    The states z are the liftings of scaled channels; u and x are in physical units. The constant function is the first
    state: its eigenvalue is one, and its column holds the offsets of the channels. So a run starts at
    ``model.lift(x0)``, never at zero. With delays, x0 is the delayed state (newest sample first), x the newest sample.
    With ``lead=1`` x depends on the input of its own instant: D is not zero, and a run starts at
    ``model.lift(x0) - model.B_ / model.u_scale_ @ u[0]``.

    Returns
    -------
    control.StateSpace or StateSpace
        With python-control the former, with the names of the channels; otherwise, and for a model without inputs, a
        named tuple ``(A, B, C, D, dt)``.

    Raises
    ------
    ValueError
        If the model is not fitted, or not ``lifted_linear``.

    Examples
    --------
    >>> import numpy as np
    >>> x, u = np.random.default_rng(0).uniform(-1, 1, (2, 5, 20, 1))
    >>> model = tras.KoopmanModel(tras.Monomials(2), "lifted_linear").fit(tras.Recording(x, u, 0.1))
    >>> system = to_statespace(model)
    >>> system.A.shape, system.B.shape, system.C.shape, system.dt
    ((3, 3), (3, 1), (1, 3), 0.1)
    """
    model.require_fitted()
    if model.predictor != "lifted_linear":
        raise ValueError(f"predictor is {model.predictor!r}, no linear system; fit with predictor='lifted_linear'.")
    n = len(model.state_names_)
    A, B = model.koopman_matrix.T.copy(), model.B_ / model.u_scale_
    A[:, 0] -= B @ model.u_offset_  # the first function is the constant
    C = np.zeros((n, len(A)))
    C[:, 0] = model.x_offset_
    C[np.arange(n), model.dictionary_.coordinates[:n]] = model.x_scale_
    system = acting(model.channels_.lead, A, B, C, float(model.dt_))
    names = identifiers((*model.state_names_, *model.input_names_))
    return for_control(system, inputs=names[n:], outputs=names[:n], states=[f"z{i}" for i in range(len(A))])
