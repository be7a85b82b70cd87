"""Quadratic programs: the optimality conditions, soft rows, what cannot be solved."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tras.control.qp import Program


@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 12), rows=st.integers(0, 10), soft=st.booleans())
def test_the_optimality_conditions_hold(seed, size, rows, soft):
    """Karush, Kuhn, Tucker: stationary, feasible, multipliers of the right sign and only where something is active."""
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(size + 2, size))
    H, f, G = M.T @ M + 0.01 * np.eye(size), 3 * rng.normal(size=size), rng.normal(size=(rows, size))
    low, high = -rng.uniform(0.1, 1, size), rng.uniform(0.1, 1, size)
    lower, upper = -rng.uniform(0.1, 1, rows), rng.uniform(0.1, 1, rows)
    program = Program(linear=1e3)
    for shift in (0.0, 0.3):  # the second one starts at the working set of the first
        g = f + shift
        solution = program.solve(H, g, low, high, G, lower, upper, np.full(rows, soft))
        v, multipliers = solution.v, solution.multipliers
        assert solution.status == "solved"
        A, bottom, top = np.vstack([np.eye(size), G]), np.r_[low, lower], np.r_[high, upper]
        assert np.abs(H @ v + g + A.T @ multipliers).max() < 1e-6 * max(1, np.abs(multipliers).max())
        values = A @ v
        assert np.all(values <= top + 1e-8) and np.all(values >= bottom - 1e-8)
        assert np.all(multipliers[values < top - 1e-6] <= 1e-9) and np.all(multipliers[values > bottom + 1e-6] >= -1e-9)


def test_a_soft_row_gives_way_at_its_price():
    """min v^2/2 - 5 v + 2 e + e^2/2, v <= 1 + e: from v - 5 + 2 + e = 0 with e = v - 1 follows v = 2."""
    program = Program(linear=2.0, quadratic=1.0)
    one = np.ones((1, 1))
    solution = program.solve(one, np.array([-5.0]), [-9.0], [9.0], one, [-np.inf], [1.0], np.array([True]))
    assert solution.v == pytest.approx([2.0], abs=1e-8)
    dear = Program(linear=4.5, quadratic=1.0)  # above the multiplier of the hard row, which is 4
    assert dear.solve(one, np.array([-5.0]), [-9.0], [9.0], one, [-np.inf], [1.0], np.array([True])).v == pytest.approx(
        [1.0], abs=1e-8
    )


def test_what_cannot_be_solved_is_said_and_forgotten():
    program, one = Program(), np.eye(2)
    G = np.array([[1.0, 1.0]])
    infeasible = program.solve(one, np.zeros(2), [-1, -1], [1, 1], G, [3.0], [4.0])
    assert infeasible.v is None and infeasible.status == "infeasible"
    assert program.solve(one, np.zeros(2), [-1, -1], [1, 1], G, [1.0], [4.0]).v == pytest.approx([0.5, 0.5])
    few = Program(iterations=1)
    assert few.solve(np.eye(9), -9 * np.ones(9), -np.ones(9), np.ones(9)).status == "iteration limit"


def test_without_the_solver_the_extra_is_named(monkeypatch):
    import sys

    from tras.workflow.arguments import MissingExtraError

    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(MissingExtraError, match=r"needs daqp.*pip install 'tras-koopman\[control\]'"):
        Program()
