"""Hammerstein-Wiener: a linear system between a static curve of each input and a static curve of each output."""

import numpy as np
from scipy import optimize

from tras import rollout
from tras.paper.baselines.base import Baseline, check, pairs

_REACH, _POINTS = 2.0, 2001  # half-ranges over which the output curves are inverted


class HammersteinWiener(Baseline):
    """``v+ = A v + B f(u) + c, x_i = g_i(v_i)``, f and g curves of one channel each.

    E. W. Bai, Automatica 34, 1998, p. 333. Each output curve is found by its inverse ``v = h(x) = x + h2 x^2 + ...``,
    increasing, which makes the rest linear: A, B, f and c follow from h by least squares, and h by Gauss-Newton steps
    on what is left (variable projection), divided by h' so that it counts in units of x. No maintained package has it.

    Parameters
    ----------
    input_degree, output_degree : int
        Of f and h; 1 is a straight line.
    points : int
        Snapshot pairs, evenly spread over the data, on which h is found; the linear part is then fitted to all.
    """

    def __init__(self, input_degree=3, output_degree=3, points=5000):
        self.input_degree = input_degree
        self.output_degree = output_degree
        self.points = points

    def _check_options(self):
        for name in ("input_degree", "output_degree", "points"):
            check(name, getattr(self, name), getattr(self, name) >= 1, "a whole number, 1 or more")

    def _learn(self, trajectories):
        x, u, y = pairs(trajectories)
        n = x.shape[1]
        if len(x) <= n + u.shape[1] * self.input_degree + 1:
            raise ValueError(f"there are {len(x)} snapshot pairs, too few; record more.")
        some = np.linspace(0, len(x) - 1, min(len(x), self.points)).astype(int)
        a, b, c = x[some], u[some], y[some]
        self.curve_ = np.zeros((n, self.output_degree - 1))
        if self.output_degree > 1:
            start = self.curve_.ravel()
            solution = optimize.least_squares(lambda h: self._residual(h.reshape(n, -1), a, b, c), start, max_nfev=30)
            self.curve_ = solution.x.reshape(n, -1)
        self._solve(x, u, y)
        self.grid_ = grid = np.linspace(-_REACH, _REACH, _POINTS)
        values = _curve(np.repeat(grid[:, None], n, axis=1), self.curve_)
        # Beyond where the curve turns it is continued by a small slope, so that it has an inverse.
        steps = np.maximum(np.diff(values, axis=0), 0.05 * (grid[1] - grid[0]))
        values = np.concatenate([np.zeros((1, n)), np.cumsum(steps, axis=0)])
        self.table_ = values - values[_POINTS // 2]
        self.n_parameters_ = self.linear_.size + self.curve_.size

    def _regressors(self, v, u):
        return np.hstack([v, *[u**k for k in range(1, self.input_degree + 1)], np.ones((len(v), 1))])

    def _solve(self, x, u, y, curve=None):
        v, later = (_curve(part, self.curve_ if curve is None else curve) for part in (x, y))
        features = self._regressors(v, u)
        self.linear_ = np.linalg.lstsq(features, later - v, rcond=1e-13)[0]
        return later - v - features @ self.linear_

    def _residual(self, curve, x, u, y):
        left = self._solve(x, u, y, curve)
        slope = np.maximum(_slope(y, curve), 0.05)
        # Falling curves are no curves: a penalty keeps them increasing over the data.
        fall = np.minimum(_slope(np.linspace(-1, 1, 21)[:, None] * np.ones(y.shape[1]), curve) - 0.1, 0)
        return np.concatenate([(left / slope).ravel() / np.std(y - x), 10 * fall.ravel()])

    def _roll_out(self, x, u):
        n = len(x)

        def advance(v, now):
            powers = [now**k for k in range(1, self.input_degree + 1)]
            return v + self.linear_.T @ np.concatenate([v, *powers, np.ones((1, v.shape[1]))])

        def read(v):
            return np.stack([_line(v[i], self.table_[:, i], self.grid_) for i in range(n)])

        start = np.stack([_line(x[i], self.grid_, self.table_[:, i]) for i in range(n)])
        return rollout.roll_out(advance, start, u, read)


def _curve(x, curve):
    """``h(x) = x + h2 x^2 + ...`` of each channel: (points, n), (n, degree - 1) -> (points, n)."""
    return x + sum(curve[:, k] * x ** (k + 2) for k in range(curve.shape[1]))


def _slope(x, curve):
    return 1 + sum((k + 2) * curve[:, k] * x ** (k + 1) for k in range(curve.shape[1]))


def _line(at, x, y):
    """Interpolation, straight on beyond the ends."""
    inside = np.interp(at, x, y)
    low, high = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    return inside + low * np.minimum(at - x[0], 0) + high * np.maximum(at - x[-1], 0)
