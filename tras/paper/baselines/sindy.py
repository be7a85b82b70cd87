"""Sparse identification of nonlinear dynamics with control (SINDy), by pysindy."""

import warnings

import numpy as np

from tras import rollout
from tras.paper.baselines.base import Baseline, Monomial, check

DIFFERENTIATION = ("central", "smoothed", "forward")


class SINDy(Baseline):
    """``dx/dt = Xi theta(x, u)``, sparse by sequentially thresholded least squares.

    S. L. Brunton, J. L. Proctor, J. N. Kutz, IFAC-PapersOnLine 49-18, 2016, p. 710. pysindy finds the coefficients;
    Runge-Kutta steps integrate them here, all trajectories at once, where pysindy integrates one at a time.

    Parameters
    ----------
    degree : int
        Of the polynomial library in states and inputs.
    threshold : float
        Coefficients below it, in scaled channels and 1/s, are set to zero.
    alpha : float
        Ridge of each least-squares step.
    differentiation : {"central", "smoothed", "forward"}
        Central differences; the same after Savitzky-Golay smoothing; forward differences, as the input is held.
    """

    def __init__(self, degree=2, threshold=0.02, alpha=1e-6, differentiation="central"):
        self.degree = degree
        self.threshold = threshold
        self.alpha = alpha
        self.differentiation = differentiation

    def _check_options(self):
        check("degree", self.degree, self.degree >= 1, "a whole number, 1 or more")
        method = self.differentiation
        check("differentiation", method, method in DIFFERENTIATION, f"one of {', '.join(DIFFERENTIATION)}")
        check("threshold", self.threshold, self.threshold >= 0, "a number that is not negative")

    def _learn(self, trajectories):
        import pysindy

        methods = {
            "central": pysindy.FiniteDifference(),
            "smoothed": pysindy.SmoothedFiniteDifference(),
            "forward": pysindy.FiniteDifference(order=1, d=1),
        }
        if min(len(x) for x, _ in trajectories) < 12:
            raise ValueError("a trajectory has fewer than 12 samples, too few to differentiate; leave it out.")
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=self.threshold, alpha=self.alpha, max_iter=20),
            feature_library=pysindy.PolynomialLibrary(degree=self.degree),
            differentiation_method=methods[self.differentiation],
        )
        states, inputs = (list(part) for part in zip(*trajectories))
        if self.differentiation == "forward":  # the last sample has no later one
            rates = [np.diff(x, axis=0) / self.dt_ for x in states]
            data = {"x": [x[:-1] for x in states], "x_dot": rates, "u": [u[:-1] for u in inputs]}
        else:
            data = {"x": states, "u": inputs}
        if not len(self.input_names_):
            data.pop("u")
        with (
            warnings.catch_warnings()
        ):  # a threshold removes everything, a matrix is ill-conditioned: errors will say it
            warnings.simplefilter("ignore")
            model.fit(t=self.dt_, **data)
        coefficients = np.asarray(model.coefficients())
        used = coefficients.any(axis=0)
        if not used.any():
            raise ValueError(f"threshold is {self.threshold!r}, above every coefficient; choose a smaller one.")
        self.coefficients_, self.powers_ = coefficients[:, used], np.asarray(model.feature_library.powers_)[used]
        self.lift_ = Monomial(self.powers_)
        self.n_parameters_ = int(np.count_nonzero(self.coefficients_))
        x, u = (np.concatenate(part) for part in (states, inputs))
        some = np.linspace(0, len(x) - 1, min(len(x), 2000)).astype(int)
        with np.errstate(over="ignore", invalid="ignore"):
            points = x[some].T, u[some].T
            self.substeps_ = rollout.enough_substeps(self._field, *points, self.dt_, tolerance=1e-6, most=8).count

    def _field(self, point):
        return self.coefficients_ @ self.lift_(point)

    def _advance(self, z, u):
        return rollout.runge_kutta(self._field, z, u, self.dt_, self.substeps_)
