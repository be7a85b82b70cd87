"""Functions of a dictionary as sums of products in physical units, from which `tras.export.equations` selects terms."""

from collections import Counter
from functools import cache

import numpy as np

from tras.export import symbols
from tras.export.common import identifier, identifiers

_UFUNCS = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "negative": np.negative}
_UFUNCS |= {name: getattr(np, name) for name in symbols.FUNCTIONS}


class Expansion:
    """Functions of the dictionary as sums ``{monomial: coefficient}`` in physical channels.

    A monomial is a sorted tuple of (factor, power). Factors are numbered: the channels, then ``atoms``, nodes that are
    not polynomials. Atoms that have no expansion get a line of their own, named in ``definitions``.
    """

    def __init__(self, model):
        self.model, self.points, self.digits = model, None, 17  # points: (channels, points), where `values` computes
        self.offsets = np.concatenate([model.channels_.z_offset, model.u_offset_])
        self.scales = np.concatenate([model.channels_.z_scale, model.u_scale_])
        self.channels = [*model.channels_.z_names, *model.input_names_]
        self.names = identifiers(self.channels)
        is_field = model.predictor == "vector_field"
        states = self.names[: len(model.channels_.z_scale) if is_field else len(model.state_names_)]
        self.left = identifiers([f"d{name}_dt" if is_field else f"{name}_next" for name in states], self.names)
        self.scaled = identifiers([f"{name}_s" for name in self.names], [*self.names, *self.left])
        self.atoms, self.definitions = [], {}
        self.expands, self.sum = cache(self._expands), cache(self._sum)

    def rows(self, matrix):
        """The sum of each row of the map, in physical units."""
        nodes = symbols.functions(self.model.dictionary_)
        sums = []
        for node, name in zip(nodes, self.model.names_):
            if self.expands(node):
                sums.append(self.sum(node))
            else:
                names = (*self.names, *self.left, *self.scaled, *self.definitions.values())
                self.definitions[node] = identifier(name, names)
                sums.append({((self._factor(node), 1),): 1.0})
        rows = []
        for i, weights in enumerate(matrix):
            row = {} if self.model.predictor == "vector_field" else {(): self.offsets[i]}
            for weight, terms in zip(weights, sums):
                for monomial, value in terms.items() if weight else ():
                    row[monomial] = row.get(monomial, 0.0) + weight * self.scales[i] * value
            rows.append({monomial: value for monomial, value in row.items() if value})
        return rows

    def _expands(self, node):
        """Whether the node is a sum of products of channels and functions of linear combinations of them."""
        if node.kind in ("z", "number"):
            return True
        if node.kind == "/" and node.parts[1].kind != "number" or not all(self.expands(part) for part in node.parts):
            return False
        return node.kind not in symbols.FUNCTIONS or self.linear(node.parts[0])

    def linear(self, node):
        """Whether the sum of a node is linear in the channels."""
        return all(sum(power for _, power in m) <= 1 and all(f < len(self.names) for f, _ in m) for m in self.sum(node))

    def _factor(self, node):
        if node not in self.atoms:
            self.atoms.append(node)
        return len(self.names) + self.atoms.index(node)

    def _sum(self, node):
        """{monomial: coefficient} of a node that has an expansion."""
        if node.kind == "number":
            return {(): node.parts[0]}
        if node.kind == "z":
            (i,) = node.parts
            return {((i, 1),): 1 / self.scales[i], (): -self.offsets[i] / self.scales[i]}
        if node.kind in symbols.FUNCTIONS:
            return {((self._factor(node), 1),): 1.0}
        first = self.sum(node.parts[0])
        if node.kind == "negative":
            return {monomial: -value for monomial, value in first.items()}
        if node.kind == "/":
            return {monomial: value / node.parts[1].parts[0] for monomial, value in first.items()}
        total, second = {}, self.sum(node.parts[1])
        if node.kind in "+-":
            total = dict(first)
            for monomial, value in second.items():
                total[monomial] = total.get(monomial, 0.0) + (value if node.kind == "+" else -value)
            return total
        for one, value in first.items():
            for other, factor in second.items():
                monomial = tuple(sorted((Counter(dict(one)) + Counter(dict(other))).items()))
                total[monomial] = total.get(monomial, 0.0) + value * factor
        return total

    def round(self, value):
        """A number with the digits that are written."""
        return float(f"{value:.{self.digits}g}")

    def values(self, row):
        """Each term of a row at the points, with the digits that are written: (terms, points)."""
        value_of = cache(lambda node: self._value(node, value_of))
        factors = [*self.points, *map(value_of, self.atoms)]
        terms = np.empty((len(row), self.points.shape[1]))
        for term, (monomial, value) in zip(terms, row.items()):
            term[:] = self.round(value)
            for factor, power in monomial:
                term *= factors[factor] ** power
        return terms

    def _value(self, node, value_of):
        """A node at the points; ``value_of`` gives its parts."""
        if node.kind == "number":
            return self.round(node.parts[0])
        if node.kind == "z":
            (i,) = node.parts
            return (self.points[i] - self.round(self.offsets[i])) / self.round(self.scales[i])
        if node.kind in symbols.FUNCTIONS and node not in self.definitions and self.expands(node):
            terms = self.sum(node.parts[0]).items()
            return _UFUNCS[node.kind](sum(self.round(v) * (self.points[m[0][0]] if m else 1.0) for m, v in terms))
        return _UFUNCS[node.kind](*map(value_of, node.parts))
