"""Weights for the twin rotor, and a small nonlinear system."""

import numpy as np

from tras.control.predictors import Equations

WEIGHTS = {"phi": 1.0, "psi": 1.0}
RATE_WEIGHTS = {"u_phi": 0.03, "u_psi": 0.03}


def pendulum(dt=0.1):
    """Angle and rate of a damped pendulum under a torque of at most 1.5, by one midpoint step."""

    def field(x, u):
        return np.stack([x[1], -2 * np.sin(x[0]) - 0.3 * x[1] + u[0]])

    def advance(x, u):
        return x + dt * field(x + dt / 2 * field(x, u), u)

    return Equations(advance, dt, [[-1.5, 1.5]], ["q", "v"], ["f"])
