"""The solver of quadratic programs that generated controllers carry along: against conditions, and against DAQP."""

import ctypes
import functools
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tras.export.program import solver

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
pytestmark = pytest.mark.skipif(
    CC is None, reason="no C compiler (cc, gcc, clang) is installed, so the generated C cannot be compiled here"
)
SOLVED, INFEASIBLE, TOO_MANY_ITERATIONS, NOT_CONVEX = range(4)
CALL = """
static program p;
void reset(void) { forget(&p); }
int call(const double *H, const double *f, const double *low, const double *high, const double *G, const int *soft,
         double *v, double *multipliers)
{
    for (int i = 0; i < VARIABLES; i++) {
        p.f[i] = f[i];
        for (int j = 0; j < VARIABLES; j++) p.H[i][j] = H[i * VARIABLES + j];
    }
    for (int i = 0; i < BOUNDED; i++) p.low[i] = low[i], p.high[i] = high[i];
    for (int i = 0; i < GENERAL; i++) {
        p.soft[i] = soft[i];
        for (int j = 0; j < VARIABLES; j++) p.G[i][j] = G[i * VARIABLES + j];
    }
    int status = solve_program(&p);
    for (int i = 0; i < VARIABLES; i++) v[i] = p.v[i];
    for (int i = 0; i < BOUNDED; i++) multipliers[i] = 0.0;
    for (int i = 0; i < p.working; i++) multipliers[p.row[i]] = p.multiplier[i];
    return status;
}
int iterations(void) { return p.iterations; }
"""


@functools.cache
def library(variables, general, **options):
    folder = Path(tempfile.mkdtemp())
    source = "#include <math.h>\n" + solver(variables, general, **options) + CALL
    (folder / "qp.c").write_text(source)
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    done = subprocess.run([CC, *flags, "qp.c", "-o", "qp.so", "-lm"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    compiled = ctypes.CDLL(str(folder / "qp.so"))
    shutil.rmtree(folder)
    return compiled


def solve(H, f, low, high, G=None, soft=None, *, warm=False, **options):
    """(status, v, multipliers, iterations); ``soft`` names rows of G."""
    G = np.empty((0, len(f))) if G is None else np.asarray(G, dtype=float)
    soft = np.zeros(len(G), dtype=np.int32) if soft is None else np.asarray(soft, dtype=np.int32)
    compiled = library(len(f), len(G), soft=int(soft.sum()), **options)
    if not warm:
        compiled.reset()
    arrays = [np.ascontiguousarray(a, dtype=float) for a in (H, f, low, high, G)]
    v, multipliers = np.empty(len(f)), np.empty(len(f) + len(G))
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (*arrays, soft, v, multipliers)]
    return compiled.call(*pointers), v, multipliers, compiled.iterations()


def slack(multipliers, linear=1e3, quadratic=1e3):
    """How far soft rows with these multipliers are violated."""
    return np.sign(multipliers) * np.maximum(np.abs(multipliers) - linear, 0) / quadratic


def assert_optimal(H, f, low, high, G, soft, v, multipliers):
    """The conditions of Karush, Kuhn and Tucker, which decide, the program being convex."""
    rows = np.vstack([np.eye(len(f)), G])
    size = max(1.0, np.abs(H).max(), np.abs(f).max(), np.abs(multipliers).max())
    assert np.abs(H @ v + f + rows.T @ multipliers).max() <= 1e-9 * size
    values = rows @ v
    values[len(f) :] -= np.where(soft, slack(multipliers[len(f) :]), 0)
    reach = 1e-9 * max(1.0, np.abs(v).max())
    assert (values <= high + reach).all() and (values >= low - reach).all()
    up, down = multipliers > 0, multipliers < 0
    assert np.abs(values - high)[up].max(initial=0) <= reach and np.abs(values - low)[down].max(initial=0) <= reach


def random_program(seed, variables, general, *, degenerate=False, loose=1.0):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(variables, variables)) * np.logspace(0, -rng.uniform(0, 2), variables)
    H, f = root.T @ root + 1e-3 * np.eye(variables), 3 * rng.normal(size=variables)
    G = rng.normal(size=(general, variables)) * (rng.random((general, variables)) < 0.6)
    if degenerate and general:  # rows that are the same, opposite, sums of others, zero, or a bound over again
        G[rng.integers(general)] = G[rng.integers(general)]
        G[rng.integers(general)] = -G[rng.integers(general)]
        G[rng.integers(general)] = G[rng.integers(general)] + G[rng.integers(general)]
        G[rng.integers(general)] = 0
        G[rng.integers(general)] = np.eye(variables)[rng.integers(variables)]
    inside = rng.uniform(-0.5, 0.5, variables)
    rows = np.vstack([np.eye(variables), G])
    width = loose * rng.uniform(0, 1, (2, len(rows))) * (rng.random((2, len(rows))) < (0.7 if degenerate else 1))
    low, high = rows @ inside - width[0], rows @ inside + width[1]
    low[rng.random(len(rows)) < 0.2], high[rng.random(len(rows)) < 0.2] = -np.inf, np.inf
    return H, f, low, high, G


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([(1, 0), (3, 0), (4, 3), (6, 12), (12, 5)]), st.booleans())
def test_a_solution_meets_the_conditions(seed, size, degenerate):
    H, f, low, high, G = random_program(seed, *size, degenerate=degenerate)
    status, v, multipliers, _ = solve(H, f, low, high, G)
    assert status == SOLVED
    assert_optimal(H, f, low, high, G, np.zeros(len(G), bool), v, multipliers)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([(2, 6), (4, 3), (6, 12)]), st.booleans())
def test_soft_rows_that_cannot_be_kept_are_violated_at_their_price(seed, size, degenerate):
    H, f, low, high, G = random_program(seed, *size, degenerate=degenerate)
    H, f = 100 * H, 100 * f  # multipliers on both sides of the linear price
    shift = np.random.default_rng(seed).normal(size=len(G)) * 3
    low[len(f) :] += shift
    high[len(f) :] += shift
    soft = np.ones(len(G), dtype=bool)
    status, v, multipliers, _ = solve(H, f, low, high, G, soft)
    assert status == SOLVED
    assert_optimal(H, f, low, high, G, soft, v, multipliers)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32), st.booleans())
def test_a_warm_start_ends_where_a_cold_one_ends(seed, degenerate):
    """After another program of the same size, perhaps with other rows and limits at infinity."""
    first, second = (random_program(seed + k, 6, 12, degenerate=degenerate) for k in (0, 1))
    cold = solve(*second)
    solve(*first)
    warm = solve(*second, warm=True)
    assert warm[0] == cold[0] == SOLVED and np.allclose(warm[1], cold[1], rtol=0, atol=1e-8)
    assert_optimal(*second, np.zeros(12, bool), *warm[1:3])
    again = solve(*second, warm=True)
    assert np.allclose(again[1], cold[1], rtol=0, atol=1e-8) and (degenerate or again[3] <= 2)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32))
def test_the_infeasible_is_called_so(seed):
    H, f, low, high, G = random_program(seed, 4, 3)
    G[0] = np.random.default_rng(seed).normal(size=4)
    G[1] = 2 * G[0]
    low[4:6], high[4:6] = [1, -np.inf], [np.inf, 1.8]  # above 1 and below 0.9
    assert solve(H, f, low, high, G)[0] == INFEASIBLE
    free = np.full(4, np.inf)
    status, v, multipliers, _ = solve(H, f, np.r_[-free, low[4:]], np.r_[free, high[4:]], G, [1, 1, 1])
    assert status == SOLVED and 0 <= slack(-multipliers[4]) and 0 <= slack(multipliers[5])
    low[0], high[0] = 2.0, 1.0
    assert solve(H, f, low, high, G)[0] == INFEASIBLE


def test_the_cap_on_iterations_and_what_is_not_convex():
    H, f, low, high, G = random_program(0, 12, 5, loose=0.1)
    assert solve(H, f, low, high, G)[3] > 5
    assert solve(H, f, low, high, G, iterations=3)[0] == TOO_MANY_ITERATIONS
    for bad in (-np.eye(12), np.zeros((12, 12)), np.full((12, 12), np.nan), np.diag([np.inf] * 12)):
        assert solve(bad, f, low, high, G)[0] == NOT_CONVEX
    assert solve(H, np.zeros(12), np.full(17, -1.0), np.full(17, 1.0), G)[1].tolist() == [0.0] * 12


def test_it_solves_what_daqp_solves():
    """Programs of a controller's size: inputs within bounds, their changes limited, soft rows that look ahead."""
    qp = pytest.importorskip("tras.control.qp")
    pytest.importorskip("daqp")
    rng, V = np.random.default_rng(0), 40
    changes = np.eye(V) - np.eye(V, k=-2)
    for _ in range(20):
        ahead = np.tril(rng.normal(size=(20, V)) / 3)
        G, soft = np.vstack([changes, ahead]), np.repeat([False, True], [V, 20])
        H = ahead.T @ ahead + 1e-3 * changes.T @ changes + 1e-3 * np.eye(V)
        f = rng.normal(size=V)
        limits = np.concatenate([np.full(V, 1.0), np.full(V, 0.3), rng.uniform(-0.1, 1, 20)])
        low = np.concatenate([-limits[: 2 * V], np.full(20, -np.inf)])
        status, v, multipliers, _ = solve(H, f, low, limits, G, soft)
        expected = qp.Program().solve(H, f, low[:V], limits[:V], G, low[V:], limits[V:], soft)
        assert status == SOLVED and expected.status == "solved"
        assert_optimal(H, f, low, limits, G, soft, v, multipliers)
        assert np.allclose(v, expected.v, rtol=0, atol=1e-7)
