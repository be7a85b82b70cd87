"""A dictionary for mechanical systems whose inertia and gravity depend on a few positions only."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from tras.dictionaries.base import MARGIN, MOST_DEGREE, Dictionary
from tras.workflow import arguments

# With actuators: how much lower than the dictionary's the degree of the shape is that multiplies something.
_SPEED, _INPUT, _VELOCITY, _POSITION, _BENT = 2, 3, 2, 3, 3  # the last: force with the sign of the speed, w|w|
_FORCES = {2: 4, 3: 4, 4: 5, 5: 6}  # the same by the power of a speed
# The highest such degree of what is small, or depends little on the shape.
_OWN = 2  # velocities of the shape, and their squares
_SPRING = 5  # a spring that is not as stiff on both sides
_GYRATION = 3  # an actuator's speed times a velocity
_INFLOW, _OWN_INFLOW = 4, 1  # the square of that speed times a velocity, and times one of the shape
_REACTION = {2: 1, 3: 2}  # the reaction to a command, by its power in the static curve, and with its sign
_SIGNED_REACTION = 2
_DRAG = 9  # highest power of an actuator's own drag
_COMMAND = 7  # highest power of an input in its static curve
_WIDE = 0.5  # margin of the hull along positions and actuators, in half-ranges
_INSIDE = 0.8  # a zero farther out than this, in half-ranges, is as good as an end of the range
_SIGNED, _SIZE = 0, -1  # of a bend, where others are the degree of a polynomial: z|z| and |z| from the channel's zero


class Mechanical(Dictionary):
    """Functions of the shape times {1, inputs, velocities, other positions, products of two velocities}.

    The accelerations of a mechanical system are ``M(s)^-1 (u - C(s) qdot qdot - D qdot - K q - g(s))``: with respect to
    inputs, velocities and the positions that do not change the inertia they are polynomials of degree one or two, and
    only the dependence on the *shape* s, the positions that M and gravity depend on, is of any kind. So the shape gets
    polynomials up to a high degree (Chebyshev, well conditioned on [-1, 1]) and everything else no more than mechanics
    allows. For the twin rotor (shape: pitch) N = 81.

    With *actuators*, states such as the speeds w of rotors, the forces are functions of these: polynomials of degree
    five and ``w|w|``, times functions of the shape; speeds and their squares times velocities (gyroscopic torques,
    inflow). An actuator follows its command with dynamics of its own, ``dw/dt = f(u) - h(w)``: both curves get
    polynomials by themselves, and ``u|u|``. An input acts on the body too, as the reaction to ``dw/dt``: the first
    powers of its curve times functions of the shape. A position that is no shape may have a spring that is not as stiff
    on both sides. What is small gets functions of the shape of lower degrees, so that N stays small. For the twin
    rotor with its rotors N = 196.

    Parameters
    ----------
    degree : int
        Highest total degree of the Chebyshev polynomials of the shape.
    positions, velocities : sequence of int, optional
        Which states are positions and which their velocities, in the same order. Default: they alternate, position
        first; actuators are passed over.
    shape : sequence of int, optional
        The positions that inertia and gravity depend on. Default: the first position.
    actuators : sequence of int, optional
        Which states drive the body and follow the inputs. Default: none, the inputs are the forces.

    Attributes
    ----------
    origin_ : (n + m,) ndarray
        With actuators: where the channels' zeros lie in their scaled values. ``w|w|`` bends there.

    Raises
    ------
    ValueError
        On ``fit``, if the states cannot be told apart or ``shape`` holds something that is no position.

    Examples
    --------
    >>> import numpy as np
    >>> psi = Mechanical(2)
    >>> psi(np.zeros((501, 2)), np.zeros((501, 1))).shape
    (501, 12)
    >>> psi.feature_names(["q", "v", "u"])[4:]
    ['T2(q)', 'T1(q) u', 'T2(q) u', 'T1(q) v', 'T2(q) v', 'v v', 'T1(q) v v', 'T2(q) v v']
    >>> rotor = Mechanical(1, actuators=[2]).fit(np.zeros((501, 3)), np.zeros((501, 1)))
    >>> rotor.feature_names(["q", "v", "w", "u"])[8:14]
    ['T2(w)', 'T3(w)', 'T4(w)', 'T5(w)', 'w|w|', 'T6(w)']
    """

    def __init__(
        self,
        degree: int = 8,
        positions: Sequence[int] | None = None,
        velocities: Sequence[int] | None = None,
        shape: Sequence[int] | None = None,
        actuators: Sequence[int] | None = None,
    ):
        self.degree = degree
        self.positions = positions
        self.velocities = velocities
        self.shape = shape
        self.actuators = actuators

    def words(self, channels: Sequence[str]) -> str:
        name = lambda i: channels[i] if i < len(channels) else str(i)  # noqa: E731
        driven = f", driven by {', '.join(map(name, self.actuators))}" if self.actuators else ""
        return f"mechanical, degree {self.degree} in {', '.join(map(name, self.shape or [0]))}{driven}"

    def _learn(self, z):
        if self.actuators:
            self.origin_ = self._origin

    def _count(self):
        arguments.whole_number("degree", self.degree, 1, MOST_DEGREE)
        channels = len(self._roles()[2])
        total = 0
        for word, degree, bend in self._groups():
            # The head already holds the constant, every channel, and T1 of the shape.
            inside = 0 if bend or len(word) > 1 else 1 if word else 1 + channels
            total += math.comb(channels + degree, channels) - inside
        return total

    def _build(self):
        arguments.whole_number("degree", self.degree, 1, MOST_DEGREE)
        groups = self._groups()
        self._shape = self._roles()[2]
        shapes = {degree: _powers(len(self._shape), degree) for degree in {degree for _, degree, _ in groups}}
        terms = [(k, w, bend) for w, d, bend in groups for k in shapes[d] if bend or sum(k) + len(w) > 1]
        self._words, self._bends = ([*dict.fromkeys(column)] for column in list(zip(*groups))[::2])
        self._powers = np.array([k for k, _, _ in terms])
        self._word = np.array([self._words.index(w) for _, w, _ in terms])
        self._bend = np.array([self._bends.index(bend) for _, _, bend in terms])
        # A word has at most two letters: its product is one of two rows of (1, z), 0 standing for the 1.
        self._letters = np.array([[1 + i for i in w] + [0] * (2 - len(w)) for w in self._words]).T
        # For the slopes: the functions of each word, each factor of it, and what that leaves.
        rows = [np.flatnonzero(self._word == j) for j in range(len(self._words))]
        self._factors = [(rows[j], i, w[:k] + w[k + 1 :]) for j, w in enumerate(self._words) for k, i in enumerate(w)]
        return len(terms)

    def _groups(self):
        """(word, highest degree of the shape, bend): products of channels that each shape multiplies, and a function of
        one more channel (channel, kind), or None."""
        positions, velocities, shape, actuators = self._roles()
        n, m, D = self.n_states_, self.n_inputs_, self.degree
        inputs, others = range(n, n + m), [p for p in positions if p not in shape]
        pairs = list(itertools.combinations_with_replacement(velocities, 2))
        if not actuators:
            words = [(), *((j,) for j in inputs), *((v,) for v in velocities), *((p,) for p in others), *pairs]
            return [(word, D, None) for word in words]
        groups = [((), D, None)]
        own = {velocity for position, velocity in zip(positions, velocities) if position in shape}
        for word in [*((v,) for v in velocities), *pairs]:
            groups.append((word, min(D, _OWN) if set(word) <= own else max(0, D - _VELOCITY), None))
        groups += [((p,), max(0, D - _POSITION), None) for p in others]
        groups += [((j,), max(0, D - _INPUT), None) for j in inputs]
        for a in actuators:
            signed = [(a, _SIGNED)] * self._bent(a)
            groups.append(((a,), max(0, D - _SPEED), None))
            groups += [((), max(0, D - less), (a, power)) for power, less in _FORCES.items()]
            groups += [((), max(0, D - _BENT), bend) for bend in signed]
            groups += [((), 0, (a, power)) for power in range(max(_FORCES) + 1, _DRAG + 1)]
            for v in velocities:
                inflow = min(D, _OWN_INFLOW if v in own else _INFLOW)
                groups += [((a, v), min(D, _GYRATION), None), *(((v,), inflow, bend) for bend in [(a, 2), *signed])]
        for j in inputs:
            groups += [((), min(D, _REACTION.get(power, 0)), (j, power)) for power in range(2, _COMMAND + 1)]
            groups += [((), min(D, _SIGNED_REACTION), (j, _SIGNED))] * self._bent(j)
        return groups + [((), min(D, _SPRING), (p, _SIZE)) for p in others if self._bent(p)]

    def _bent(self, channel):
        """Whether there are data on both sides of a channel's zero: elsewhere z|z| is a polynomial."""
        return not hasattr(self, "origin_") or bool(abs(self.origin_[channel]) < _INSIDE)  # before learning: at most

    @property
    def confined(self) -> list[int] | None:
        """The positions: inputs and velocities enter at most quadratically, as mechanics has it everywhere.

        With actuators also these and the inputs, whose curves are of any kind.
        """
        positions, _, _, actuators = self._roles()
        n = self.n_states_
        return positions + actuators + list(range(n, n + self.n_inputs_)) if actuators else positions

    @property
    def margin(self) -> float | np.ndarray:
        """With actuators wider along positions and their speeds, where all is smooth; curves of inputs are not."""
        if not self.actuators:
            return MARGIN
        margins = np.full(self.n_states_ + self.n_inputs_, MARGIN)
        margins[[*self._roles()[0], *self.actuators]] = _WIDE
        return margins

    def _roles(self):
        n, actuators = self.n_states_, list(self.actuators or ())
        if len(set(actuators)) < len(actuators) or not set(actuators) <= set(range(n)):
            raise ValueError(f"actuators {actuators} must name states, 0 to {n - 1}, each once.")
        body = [i for i in range(n) if i not in actuators]
        positions = body[::2] if self.positions is None else list(self.positions)
        velocities = body[1::2] if self.velocities is None else list(self.velocities)
        shape = positions[:1] if self.shape is None else list(self.shape)
        if sorted(positions + velocities) != body or len(positions) != len(velocities):
            beside = f" that are no actuators {actuators}" if actuators else ""
            raise ValueError(
                f"positions {positions} and velocities {velocities} do not pair the {len(body)} states{beside}; "
                "say which state is which, for example "
                "positions=[0, 2], velocities=[1, 3]."
            )
        if not shape or not set(shape) <= set(positions) or len(set(shape)) < len(shape):
            raise ValueError(f"shape {shape} must name positions, which are {positions}, each once.")
        return positions, velocities, shape, actuators

    def _fill(self, psi, z):
        tail = psi[1 + len(z) :]
        polynomials = self._polynomials([_chebyshev(z[i], self.degree) for i in self._shape])
        np.multiply(polynomials, self._products(psi, z).take(self._word, axis=0), out=tail)
        for j, bend in enumerate(self._bends):
            if bend:
                tail[self._bend == j] *= self._bent_values(*bend, z)

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        tables = [_chebyshev(z[i], self.degree) for i in self._shape]
        products = self._products(psi, z)[self._word]
        straight = products
        bent = [(np.flatnonzero(self._bend == j), bend) for j, bend in enumerate(self._bends) if bend]
        if bent:
            products = products.copy()
            for rows, bend in bent:
                products[rows] *= self._bent_values(*bend, z)
        for c, i in enumerate(self._shape):
            derived = [_chebyshev_derivatives(z[i], self.degree) if d == c else table for d, table in enumerate(tables)]
            slopes[head:, i] += self._polynomials(derived) * products
        polynomials = self._polynomials(tables)
        for rows, (i, kind) in bent:
            if i < slopes.shape[1]:
                slopes[head + rows, i] += polynomials[rows] * straight[rows] * self._bent_slopes(i, kind, z)
            polynomials[rows] *= self._bent_values(i, kind, z)
        for rows, i, rest in self._factors:
            if i < slopes.shape[1]:
                slopes[head + rows, i] += polynomials[rows] * (z[rest[0]] if rest else 1.0)

    def _bent_values(self, i, kind, z):
        """A function of one channel (points,): a Chebyshev polynomial, or what bends at the channel's zero."""
        if kind > 0:
            return _chebyshev(z[i], kind)[kind]
        away = z[i] - self.origin_[i]
        return abs(away) * away if kind == _SIGNED else abs(away)

    def _bent_slopes(self, i, kind, z):
        """Its derivative."""
        if kind > 0:
            return _chebyshev_derivatives(z[i], kind)[kind]
        away = z[i] - self.origin_[i]
        return 2 * abs(away) if kind == _SIGNED else np.sign(away)

    def _products(self, psi, z):
        """The words' values (words, points), from the head of ``psi``, which is (1, z)."""
        first, second = self._letters
        return psi.take(first, axis=0) * psi.take(second, axis=0)

    def _polynomials(self, tables):
        """Products over the shape of polynomials: tables (degree + 1, points) -> (functions, points)."""
        product = tables[0].take(self._powers[:, 0], axis=0)
        for c in range(1, len(tables)):
            product = product * tables[c].take(self._powers[:, c], axis=0)
        return product

    def _tail_names(self, channels):
        names = []
        for powers, word, bend in zip(self._powers, self._word, self._bend):
            factors = [f"T{k}({channels[i]})" for k, i in zip(powers, self._shape) if k]
            if self._bends[bend]:
                i, kind = self._bends[bend]
                size = f"|{channels[i]}|"
                factors.append(f"T{kind}({channels[i]})" if kind > 0 else channels[i] * (kind == _SIGNED) + size)
            names.append(" ".join(factors + [channels[i] for i in self._words[word]]))
        return names


def _powers(channels, degree):
    """Exponents of total degree at most ``degree``, in lexicographic order; others are never made."""
    if channels == 0:
        return [()]
    return [(first, *rest) for first in range(degree + 1) for rest in _powers(channels - 1, degree - first)]


def _chebyshev(s, degree):
    """T_0 ... T_degree at s (points,): (degree + 1, points)."""
    T = np.empty((degree + 1, len(s)), dtype=np.result_type(s, float))
    before, last, *others = T
    before[:], last[:] = 1, s
    twice = 2 * s
    for row in others:
        np.multiply(twice, last, row)
        np.subtract(row, before, row)
        before, last = last, row
    return T


def _chebyshev_derivatives(s, degree):
    """``T_k' = k U_(k-1)``: (degree + 1, points)."""
    U = np.zeros((degree + 1, len(s)))  # U[k] holds U_(k-1)
    U[1] = 1
    for k in range(2, degree + 1):
        U[k] = 2 * s * U[k - 1] - U[k - 2]
    return U * np.arange(degree + 1)[:, None]
