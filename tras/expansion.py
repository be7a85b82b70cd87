"""Functions of a dictionary as sums of products in physical units: what `tras.formulas` selects from and writes."""

import numpy as np

from tras import symbols
from tras.export import identifiers


class Expansion:
    """Functions of the dictionary as sums ``{monomial: coefficient}`` in physical channels.

    A monomial is a sorted tuple of (factor, power). Factors are numbered: the channels, then ``atoms``, symbols that are no polynomials.
    """

    def __init__(self, model, points):
        self.model, self.points, self.digits = model, points, 17
        self.offsets = np.concatenate([model.channels_.z_offset, model.u_offset_])
        self.scales = np.concatenate([model.channels_.z_scale, model.u_scale_])
        self.channels = [*model.channels_.z_names, *model.input_names_]
        self.names = identifiers(self.channels)
        states = self.names[: len(model.channels_.z_scale) if model.predictor == "vector_field" else len(model.state_names_)]
        self.left = identifiers([f"d{name}_dt" if model.predictor == "vector_field" else f"{name}_next" for name in states], self.names)
        self.scaled = identifiers([f"{name}_s" for name in self.names], [*self.names, *self.left])
        self.atoms, self.own, self._sums, self._answers = [], {}, {}, {}

    def rows(self, matrix):
        """The sum of each row of the map, in physical units."""
        self.nodes = nodes = symbols.functions(self.model.dictionary_)  # kept, since sums are remembered by identity
        taken = [*self.names, *self.left, *self.scaled]
        sums = []
        for node, name in zip(nodes, self.model.names_):
            if not self.expands(node):
                self.own[id(node)] = identifiers([name], taken)[0]
                taken.append(self.own[id(node)])
                sums.append({((self._factor(node), 1),): 1.0})
            else:
                sums.append(self.sum(node))
        rows = []
        for i, weights in enumerate(matrix):
            row = {} if self.model.predictor == "vector_field" else {(): self.offsets[i]}
            for weight, terms in zip(weights, sums):
                for monomial, value in terms.items() if weight else ():
                    row[monomial] = row.get(monomial, 0.0) + weight * self.scales[i] * value
            rows.append({monomial: value for monomial, value in row.items() if value})
        return rows

    def expands(self, node):
        """Whether the node is a sum of products of channels and functions of linear combinations of them."""
        if id(node) not in self._answers:
            self._answers[id(node)] = self._expands(node)
        return self._answers[id(node)]

    def _expands(self, node):
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

    def sum(self, node):
        """{monomial: coefficient} of a node that expands."""
        if id(node) not in self._sums:
            self._sums[id(node)] = self._sum(node)
        return self._sums[id(node)]

    def _sum(self, node):
        if node.kind == "number":
            return {(): node.parts[0]}
        if node.kind == "z":
            (i,) = node.parts
            return {((i, 1),): 1 / self.scales[i], (): -self.offsets[i] / self.scales[i]}
        if node.kind in symbols.FUNCTIONS:
            return {((self._factor(node), 1),): 1.0}
        first = self.sum(node.parts[0])
        if node.kind == "negative":
            return {m: -v for m, v in first.items()}
        second = self.sum(node.parts[1])
        if node.kind == "/":
            return {m: v / node.parts[1].parts[0] for m, v in first.items()}
        found = dict(first) if node.kind in "+-" else {}
        if node.kind in "+-":
            for m, v in second.items():
                found[m] = found.get(m, 0.0) + (v if node.kind == "+" else -v)
            return found
        for a, v in first.items():
            for b, w in second.items():
                m = _product(a, b)
                found[m] = found.get(m, 0.0) + v * w
        return found

    def round(self, value):
        """A number as it is written."""
        return float(f"{value:.{self.digits}g}")

    def values(self, row):
        """Each term of a row at the points, with all numbers as they are written: (terms, points)."""
        known = {}
        factors = [*self.points, *(self._value(atom, known) for atom in self.atoms)]
        terms = np.empty((len(row), self.points.shape[1]))
        for term, (monomial, value) in zip(terms, row.items()):
            term[:] = self.round(value)
            for factor, power in monomial:
                term *= factors[factor] ** power
        return terms

    def _value(self, node, known):
        """A node at the points."""
        if id(node) not in known:
            known[id(node)] = self._compute(node, known)
        return known[id(node)]

    def _compute(self, node, known):
        if node.kind == "number":
            return self.round(node.parts[0])
        if node.kind == "z":
            (i,) = node.parts
            return (self.points[i] - self.round(self.offsets[i])) / self.round(self.scales[i])
        if node.kind in symbols.FUNCTIONS and id(node) not in self.own and self.expands(node):
            argument = sum(self.round(v) * (self.points[m[0][0]] if m else 1.0) for m, v in self.sum(node.parts[0]).items())
            return getattr(np, node.kind)(argument)
        parts = [self._value(part, known) for part in node.parts]
        if node.kind in symbols.FUNCTIONS:
            return getattr(np, node.kind)(parts[0])
        return {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "negative": np.negative}[node.kind](*parts)


def _product(a, b):
    powers = dict(a)
    for factor, power in b:
        powers[factor] = powers.get(factor, 0) + power
    return tuple(sorted(powers.items()))
