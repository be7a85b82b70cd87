"""Nonlinear autoregressive models with inputs: the next state from the last samples, by a polynomial or a network."""

import warnings

import numpy as np

from tras import rollout
from tras.paper.baselines.base import Baseline, Monomial, check, exponents


class _NARX(Baseline):
    """The change over a sample from the last ``lags`` samples of states and inputs.

    A roll-out starts from one state, so a model of several lags brings the shorter ones for the first steps. A subclass
    supplies ``_fit_map(z, change)``: an object whose call takes (channels, batch) to (n, batch), with ``n_parameters``.
    """

    def _check_options(self):
        check("lags", self.lags, self.lags >= 1, "a whole number, 1 or more")

    def _learn(self, trajectories):
        self.maps_ = [self._fit_map(*_regressors(trajectories, lags)) for lags in range(1, self.lags + 1)]
        self.n_parameters_ = sum(each.n_parameters for each in self.maps_)

    def _roll_out(self, x, u):
        n, past = len(x), self.lags - 1
        nothing = np.zeros((past * (n + u.shape[1]), x.shape[1]))
        maps = iter([*self.maps_[:-1], *[self.maps_[-1]] * len(u)])
        known = iter(range(len(u)))

        def advance(state, now):
            lags = min(next(known), past) + 1
            here, states, inputs = state[:n], state[n : n * self.lags], state[n * self.lags :]
            z = np.concatenate([here, states[: n * (lags - 1)], now, inputs[: len(now) * (lags - 1)]])
            later = here + next(maps)(z)
            return later if not past else np.concatenate([later, here, states[:-n], now, inputs[: -len(now) or None]])

        return rollout.roll_out(advance, np.concatenate([x, nothing]), u, lambda state: state[:n])


def _regressors(trajectories, lags):
    """Last states, newest first, then inputs: (channels, points), and the change over the next sample, (n, points)."""
    parts = [], []
    for x, u in trajectories:
        if len(x) <= lags:
            continue
        last = [[part[lags - 1 - k : len(part) - 1 - k] for k in range(lags)] for part in (x, u)]
        parts[0].append(np.hstack([*last[0], *last[1]]))
        parts[1].append(np.diff(x[lags - 1 :], axis=0))
    if not parts[0]:
        raise ValueError(
            f"no trajectory has more than {lags} samples, which {lags} lags need; record more or use fewer."
        )
    return tuple(np.concatenate(part).T for part in parts)


class PolynomialNARX(_NARX):
    """Polynomial NARX, its terms chosen by forward orthogonal least squares.

    Each step takes the term that explains most of what is left, for each state by itself (S. Chen, S. A. Billings,
    W. Luo, Int. J. Control 50, 1989, p. 1873). SysIdentPy would take one trajectory only (its thread 50).

    Parameters
    ----------
    degree : int
    lags : int
    terms : int, optional
        Terms per state, at most; None: all, plain least squares.
    """

    def __init__(self, degree=2, lags=1, terms=None):
        self.degree = degree
        self.lags = lags
        self.terms = terms

    def _check_options(self):
        super()._check_options()
        check("degree", self.degree, self.degree >= 1, "a whole number, 1 or more")
        check("terms", self.terms, self.terms is None or self.terms >= 1, "None or a whole number, 1 or more")

    def _fit_map(self, z, change):
        return _Polynomial(z, change, exponents(len(z), self.degree), self.terms)


class _Polynomial:
    def __init__(self, z, change, powers, terms):
        if z.shape[1] < len(powers):
            counts = f"{z.shape[1]} snapshot pairs for {len(powers)} terms"
            raise ValueError(f"there are {counts}; record more or choose a smaller degree.")
        features = Monomial(powers)(z)
        whole = np.linalg.qr(np.vstack([features, change]).T, mode="r")
        R, targets = whole[:, : len(powers)], whole[:, len(powers) :]
        self.coefficients = np.zeros((len(change), len(powers)))
        for i, target in enumerate(targets.T):
            columns = np.arange(len(powers)) if terms is None else forward_selection(R, target, terms)
            self.coefficients[i, columns] = np.linalg.lstsq(R[:, columns], target, rcond=1e-13)[0]
        used = self.coefficients.any(axis=0)
        self.coefficients, self.lift = self.coefficients[:, used], Monomial(powers[used])
        self.n_parameters = int(np.count_nonzero(self.coefficients))

    def __call__(self, z):
        return self.coefficients @ self.lift(z)


def forward_selection(R, target, terms):
    """Columns of R by their error reduction ratio, at most ``terms``, without those that depend on earlier ones."""
    left, rest, columns = R.copy(), target.copy(), []
    whole = np.sum(R**2, axis=0)
    for _ in range(min(terms, R.shape[1])):
        norms = np.sum(left**2, axis=0)
        gains = np.where(norms > 1e-12 * whole, (left.T @ rest) ** 2 / np.where(norms > 0, norms, 1), 0)
        gains[columns] = 0
        best = int(np.argmax(gains))
        if gains[best] <= 0:
            break
        columns.append(best)
        direction = left[:, best] / np.sqrt(norms[best])
        rest = rest - direction * (direction @ rest)
        left = left - np.outer(direction, direction @ left)
    return np.array(columns, dtype=int)


class NeuralNARX(_NARX):
    """Neural network NARX: scikit-learn's ``MLPRegressor`` for the change over a sample, scaled to unit deviation.

    Trained on single steps, by L-BFGS; in a roll-out it runs on its own predictions.

    Parameters
    ----------
    hidden : tuple of int
        Neurons (tanh) of each hidden layer.
    lags : int
    alpha : float
        Weight decay, as scikit-learn has it.
    iterations : int
        At most.
    points : int
        Snapshot pairs, evenly spread over the data, that it is trained on: L-BFGS takes all of them at each iteration.
    seed : int
        Of the initial weights.
    """

    def __init__(self, hidden=(16,), lags=1, alpha=1e-6, iterations=600, points=8000, seed=0):
        self.hidden = hidden
        self.lags = lags
        self.alpha = alpha
        self.iterations = iterations
        self.points = points
        self.seed = seed

    def _check_options(self):
        super()._check_options()
        sound = len(self.hidden) >= 1 and all(width >= 1 for width in self.hidden)
        check("hidden", self.hidden, sound, "a tuple of whole numbers, for example (16,)")
        check("iterations", self.iterations, self.iterations >= 1, "a whole number, 1 or more")

    def _fit_map(self, z, change):
        some = np.linspace(0, z.shape[1] - 1, min(z.shape[1], self.points)).astype(int)
        return _Network(z[:, some], change[:, some], self)


class _Network:
    def __init__(self, z, change, options):
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor

        self.scale = change.std(axis=1, keepdims=True)
        self.scale[self.scale == 0] = 1.0
        network = MLPRegressor(
            hidden_layer_sizes=options.hidden, activation="tanh", solver="lbfgs", alpha=options.alpha, tol=1e-9,
            max_iter=options.iterations, max_fun=2 * options.iterations, random_state=options.seed,
        )  # fmt: skip
        target = (change / self.scale).T
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # a number of iterations is one of the settings
            network.fit(z.T, target[:, 0] if len(change) == 1 else target)
        self.weights = [(w.T.copy(), b[:, None].copy()) for w, b in zip(network.coefs_, network.intercepts_)]
        self.n_parameters = sum(w.size + b.size for w, b in self.weights)

    def __call__(self, z):
        for w, b in self.weights[:-1]:
            z = np.tanh(w @ z + b)
        w, b = self.weights[-1]
        return self.scale * (w @ z + b)
