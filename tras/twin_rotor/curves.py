"""Static curves of a rotor: its thrust, and the command that holds its speed, as functions of the speed."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import polynomial

from tras.workflow import arguments


@dataclass(frozen=True)
class Curve:
    """``sum a_k s^k + |s| sum b_k s^k`` of ``s = speed / scale``.

    Polynomials fit measured curves; ``s |s|`` with another factor on each side is what most published models have. The
    same formula takes floats, arrays and sympy's symbols.

    Parameters
    ----------
    polynomial, sided : sequence of float
        The coefficients a and b, constant first.
    scale : float
        Speed in rad/s at which ``s`` is 1.

    Raises
    ------
    ValueError
        If a coefficient is not finite, there is none, or the scale is not positive.

    Examples
    --------
    >>> thrust = Curve.sides(2.0, 3.0)  # 2 w^2 forwards, -3 w^2 backwards
    >>> thrust(1.0), thrust(-1.0)
    (2.0, -3.0)
    """

    polynomial: tuple[float, ...] = (0.0,)
    sided: tuple[float, ...] = ()
    scale: float = 1.0

    def __post_init__(self):
        for name in ("polynomial", "sided"):
            coefficients = tuple(getattr(self, name))
            for value in coefficients:
                arguments.number(name, value, give="finite coefficients, constant first")
            object.__setattr__(self, name, tuple(map(float, coefficients)))
        if not self.polynomial:
            raise ValueError("polynomial is empty; give at least the constant.")
        arguments.number("scale", self.scale, 0, ends=False, give="a positive speed in rad/s")

    @classmethod
    def sides(cls, forwards: float, backwards: float, linear: float = 0.0) -> "Curve":
        """``linear w + forwards w^2`` for positive speeds, ``linear w - backwards w^2`` for negative ones."""
        return cls((0.0, linear, (forwards - backwards) / 2), (0.0, (forwards + backwards) / 2))

    def __call__(self, speed):
        s = speed / self.scale
        value = _horner(self.polynomial, s)
        return value + abs(s) * _horner(self.sided, s) if self.sided else value

    def times(self, factor: float) -> "Curve":
        """The curve with every value multiplied by ``factor``."""
        return Curve(tuple(factor * a for a in self.polynomial), tuple(factor * b for b in self.sided), self.scale)

    def slope(self, speed):
        """Derivative with respect to the speed; at 0 that of the polynomial."""
        s = np.asarray(speed, dtype=float) / self.scale
        sided = self.sided or (0.0,)
        signed = np.sign(s) * _horner(sided, s) + np.abs(s) * polynomial.polyval(s, polynomial.polyder(sided))
        return (polynomial.polyval(s, polynomial.polyder(self.polynomial)) + signed) / self.scale

    def speed(self, value: float) -> float:
        """The speed nearest to rest at which the curve has this value; NaN where it never has."""
        side = math.copysign(1.0, value - self.polynomial[0])
        coefficients = polynomial.polyadd(self.polynomial, side * np.array([0.0, *self.sided]))
        roots = polynomial.polyroots(polynomial.polysub(coefficients, [value])) if len(self) > 1 else np.empty(0)
        roots = roots.real[np.abs(roots.imag) <= 1e-9 * np.abs(roots)]
        roots = roots[side * roots >= 0]
        return float(side * np.abs(roots).min() * self.scale) if roots.size else math.nan

    def __len__(self) -> int:
        """Number of coefficients of one side."""
        return max(len(self.polynomial), len(self.sided) + 1)

    def as_dict(self) -> dict:
        """Coefficients and scale, for provenance."""
        return {"polynomial": list(self.polynomial), "sided": list(self.sided), "scale": self.scale}


def beyond(value: Any, width: Any) -> Any:
    """What of ``value`` lies outside -width ... width, 0 inside: a dead zone, or a cable that is slack up to there."""
    return value - clipped(value, width)


def clipped(value: Any, width: Any) -> Any:
    """``value`` limited to -width ... width, written so that floats, arrays and symbols can be given."""
    return (abs(value + width) - abs(value - width)) / 2


def _horner(coefficients, s):
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * s + coefficient
    return value
