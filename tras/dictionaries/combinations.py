"""Dictionaries of dictionaries: the union of several, the product of two."""

import math
from collections.abc import Sequence

import numpy as np
from sklearn.base import clone

from tras.dictionaries.base import Dictionary


class _Combination(Dictionary):
    """Several dictionaries of the same channels, made one."""

    def __init__(self, *dictionaries: Dictionary, parts: Sequence[Dictionary] = ()):
        if len(dictionaries) == 1 and isinstance(dictionaries[0], (list, tuple)):
            (dictionaries,) = dictionaries
        self.parts = list(dictionaries) if dictionaries else parts

    @classmethod
    def _get_param_names(cls):
        return ["parts"]  # scikit-learn wants every parameter named

    def _learn(self, z):
        if not self.parts or not all(isinstance(part, Dictionary) for part in self.parts):
            raise ValueError(
                f"parts is {self.parts!r}; give dictionaries, for example Union(Monomials(2), GaussianRBF(10))."
            )
        x, u = z[: self.n_states_].T, z[self.n_states_ :].T
        self.parts_ = [clone(part).fit(x, u, self._origin) for part in self.parts]
        # Functions that two parts share must not come twice: they are recognised by their values at random points.
        points = np.random.default_rng(0).uniform(-1, 1, (len(z), 7))
        fingerprints, indices = set(), []
        for j, values in enumerate(self._all(points)):
            fingerprint = tuple(np.round(values, 10) + 0.0)
            if fingerprint not in fingerprints:
                fingerprints.add(fingerprint)
                indices.append(j)
        self.kept_ = np.array(indices)

    def _count(self):
        if hasattr(self, "kept_"):
            return len(self.kept_) - 1 - self.n_states_ - self.n_inputs_
        # So many are made, though those that come twice are dropped.
        sizes = [part.count_of(self.n_states_, self.n_inputs_) for part in self.parts if isinstance(part, Dictionary)]
        return self._together(sizes) - 1 - self.n_states_ - self.n_inputs_

    def _build(self):
        for part in self.parts_:
            part.restore()
        return len(self.kept_) - 1 - self.n_states_ - self.n_inputs_

    def _fill(self, psi, z):
        head = 1 + len(z)
        psi[head:] = self._all(z)[self.kept_[head:]]

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        slopes[head:] = self._all_slopes(z, slopes.shape[1] > self.n_states_)[self.kept_[head:]]

    def _tail_names(self, channels):
        names = self._all_names(channels)
        return [names[j] for j in self.kept_[1 + len(channels) :]]


class Union(_Combination):
    """The functions of several dictionaries, each once: ``Union(Monomials(2), GaussianRBF(10))``.

    Examples
    --------
    >>> import numpy as np
    >>> from tras import Monomials
    >>> Union(Monomials(2), Monomials(3))(np.zeros(2)).shape == Monomials(3)(np.zeros(2)).shape
    True
    """

    _together = staticmethod(sum)

    def _all(self, z):
        return np.concatenate([part.lift(z) for part in self.parts_])

    def _all_slopes(self, z, inputs):
        return np.concatenate([part.lift_with_slopes(z, inputs=inputs)[1] for part in self.parts_])

    def _all_names(self, channels):
        return [name for part in self.parts_ for name in part.feature_names(channels)]


class Product(_Combination):
    """Every function of one dictionary times every function of another, each product once.

    All dictionaries hold the constant, so their own functions are among the products.

    Examples
    --------
    >>> import numpy as np
    >>> from tras import Monomials
    >>> Product(Monomials(1), Monomials(1))(np.zeros(2)).shape == Monomials(2)(np.zeros(2)).shape
    True
    """

    def _learn(self, z):
        if len(self.parts) != 2:
            raise ValueError(f"parts holds {len(self.parts)} dictionaries; a Product is of two, nest it for more.")
        super()._learn(z)

    _together = staticmethod(math.prod)

    def _all(self, z):
        a, b = (part.lift(z) for part in self.parts_)
        return (b[:, None] * a[None]).reshape(-1, z.shape[1])  # the constant of b first: the head of a leads

    def _all_slopes(self, z, inputs):
        (a, da), (b, db) = (part.lift_with_slopes(z, inputs=inputs) for part in self.parts_)
        slopes = db[:, None] * a[None, :, None] + b[:, None, None] * da[None]
        return slopes.reshape(-1, *slopes.shape[2:])

    def _all_names(self, channels):
        a, b = (part.feature_names(channels) for part in self.parts_)
        return [f if g == "1" else g if f == "1" else f"{f} {g}" for g in b for f in a]
