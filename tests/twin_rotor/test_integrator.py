"""The written-out method against its tableau."""

import numpy as np
import pytest

from tras.twin_rotor.integrator import butcher

TABLEAU = np.array([
    [0, 0, 0, 0, 0, 0], [1 / 3, 0, 0, 0, 0, 0], [0, 2 / 3, 0, 0, 0, 0], [1 / 12, 1 / 3, -1 / 12, 0, 0, 0],
    [-1 / 16, 9 / 8, -3 / 16, -3 / 8, 0, 0], [0, 9 / 8, -3 / 8, -3 / 4, 1 / 2, 0],
    [9 / 44, -9 / 11, 63 / 44, 18 / 11, 0, -16 / 11],
])  # fmt: skip
WEIGHTS = np.array([11, 0, 81, 81, -32, -32, 11]) / 120


@pytest.mark.parametrize("axes, others, inputs", [(2, 0, 2), (1, 2, 1), (0, 3, 0), (2, 2, 4)])
def test_one_step(axes, others, inputs):
    rng = np.random.default_rng(0)
    n = 2 * axes + others
    M, x, u, h = rng.normal(size=(axes + others, n + inputs)), rng.normal(size=n), rng.normal(size=inputs), 0.3

    def rates(*values):
        return tuple(np.sin(M @ np.array(values)))

    def field(y):
        derivative, given = np.empty(n), rates(*y, *u)
        derivative[: 2 * axes : 2], derivative[1 : 2 * axes : 2] = y[1 : 2 * axes : 2], given[:axes]
        derivative[2 * axes :] = given[axes:]
        return derivative

    stages = []
    for row in TABLEAU:
        stages.append(field(x + h * sum((a * k for a, k in zip(row, stages)), np.zeros(n))))
    expected = x + h * sum(w * k for w, k in zip(WEIGHTS, stages))
    step = butcher(axes, others, inputs)(rates, tuple(x), tuple(u), rates(*x, *u), h)
    assert np.allclose(step, expected, rtol=1e-13, atol=1e-13)
    # Conditions of order 1 to 6 for quadrature.
    nodes = TABLEAU.sum(axis=1)
    assert np.allclose([WEIGHTS @ nodes**k for k in range(6)], 1 / np.arange(1, 7), atol=1e-14)
