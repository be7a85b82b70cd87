"""Least squares over a stream of rows: accuracy against extended precision, rank, streaming, memory."""

import copy
import io
import tracemalloc
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg
from threadpoolctl import threadpool_info, threadpool_limits

import tras
from tras import koopman
from tras.regularization import regularized
from tras.solver.basis import Sketch, powers_of_two
from tras.solver.least_squares import StreamingLeastSquares, least_squares, panels_of_a_basis
from tras.solver.threads import one_blas_thread

# ------------------------------------------------------------------------------ the reference: double-double arithmetic


def two_sum(a, b):
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def add(x, y):
    """Sum of two pairs (high, low)."""
    high, error = two_sum(x[0], y[0])
    error = error + x[1] + y[1]
    top = high + error
    return top, error - (top - high)


def slices(A, axis, bits, count):
    """A as a sum of arrays whose entries along ``axis`` are multiples of one unit, below 2^bits units."""
    parts, rest = [], A.copy()
    for _ in range(count):
        top = np.abs(rest).max(axis=axis, keepdims=True)
        shift = np.ldexp(1.5, np.frexp(np.where(top > 0, top, 1.0))[1] - bits + 52)
        part = (rest + shift) - shift
        rest = rest - part
        parts.append(part)
        if not rest.any():
            break
    return parts


def product(A, x):
    """A @ (high, low), every product of slices exact (K. Ozaki et al., Numer. Algorithms 59, 2012, 95): 100 bits."""
    bits = int((53 - np.ceil(np.log2(max(A.shape[1], 2)))) // 2)
    high = slices(x[0], 0, bits, 5)
    parts = [(depth, part) for depth, part in enumerate(high)] + [
        (3 + k, part) for k, part in enumerate(slices(x[1], 0, bits, 3))
    ]
    total = (np.zeros((len(A), x[0].shape[1])),) * 2
    for i, a in enumerate(slices(A, 1, bits, 5)):
        for depth, part in parts:
            if (i + depth) * bits <= 106:
                total = add(total, (a @ part, 0.0))
    return total


def extended(X, Y, R, chunk=4096, most=25):
    """``min |X Z - Y|``, good to double precision and better: refinement with residuals in double-double.

    ``R`` is any triangular factor of X; it decides how fast, not how accurately, the refinement ends.
    """
    scale = np.ldexp(1.0, -np.frexp(np.linalg.norm(X, axis=0))[1])  # powers of two: exact
    R = R * scale
    Z = (np.zeros((X.shape[1], Y.shape[1])),) * 2
    for _ in range(most):
        gradient = (np.zeros_like(Z[0]),) * 2
        for k in range(0, len(X), chunk):
            block = X[k : k + chunk] * scale
            residual = add((Y[k : k + chunk], 0.0), tuple(-part for part in product(block, Z)))
            gradient = add(gradient, product(np.ascontiguousarray(block.T), residual))
        step = linalg.solve_triangular(R, linalg.solve_triangular(R, gradient[0], trans="T"))
        Z = add(Z, (step, 0.0))
        if np.all(np.abs(step).max(axis=0) <= 1e-13 * np.abs(Z[0]).max(axis=0)):
            return Z[0] * scale[:, None], Z[1] * scale[:, None]
    raise AssertionError("the reference did not converge")


def columnwise(K, exact):
    return (np.abs(K - exact).max(axis=0) / np.abs(exact).max(axis=0)).max()


def rounding_error(fit):
    """How far rounding of the regressors' last bits alone moves the coefficients, relative to the largest.

    First-order perturbation of least squares (P.-A. Wedin, BIT 13, 1973, 217) under independent errors of the entries:
    the standard deviation of the worst coefficient. No algorithm is better than that.
    """
    norms = np.linalg.norm(fit.R, axis=0)
    inverse = np.linalg.inv(fit.R / norms)
    rough = np.linalg.norm(inverse, axis=1)[:, None]
    along = rough * np.linalg.norm(fit.coefficients * norms[:, None], axis=0) / fit.rows**0.5
    across = np.linalg.norm(inverse @ inverse.T, axis=1)[:, None] * fit.residual
    error = np.finfo(float).eps / 12**0.5 * np.hypot(along, across) / norms[:, None]
    return (error.max(axis=0) / np.abs(fit.coefficients).max(axis=0)).max()


def exact_solution(X, Y):
    """Normal equations in rational arithmetic."""
    X = [[Fraction(v) for v in row] for row in X.tolist()]
    Y = [[Fraction(v) for v in row] for row in Y.tolist()]
    p, q = len(X[0]), len(Y[0])
    A = [
        [sum(r[i] * r[j] for r in X) for j in range(p)] + [sum(r[i] * y[k] for r, y in zip(X, Y)) for k in range(q)]
        for i in range(p)
    ]
    for i in range(p):
        A[i] = [value / A[i][i] for value in A[i]]
        for k in range(p):
            if k != i:
                A[k] = [a - A[k][i] * b for a, b in zip(A[k], A[i])]
    return [row[p:] for row in A]


def test_the_reference_itself_against_rational_numbers():
    """Vandermonde, condition 4e8, in 60 rows: double-double is right beyond the last bit, ours to 1e-10."""
    rng = np.random.default_rng(5)
    X = np.vander(rng.uniform(0.5, 1, 60), 9, increasing=True)
    Y = np.exp(X[:, 1:3]) + 1e-3 * rng.normal(size=(60, 2))
    assert np.linalg.cond(X) > 1e8
    high, low = extended(X, Y, np.linalg.qr(X)[1])
    exact = exact_solution(X, Y)
    for k in range(2):
        largest = max(abs(row[k]) for row in exact)
        wrong = max(abs(Fraction(high[j, k]) + Fraction(low[j, k]) - row[k]) for j, row in enumerate(exact))
        assert wrong <= Fraction(1, 10**19) * largest
    assert columnwise(least_squares([(X, Y)]).coefficients, high) <= 1e-10


# ------------------------------------------------------------------------------------------------------------- accuracy


@pytest.fixture(scope="module")
def closed_loop():
    """The paper's experiment: 500 s, references as inputs, cut into 5 s."""
    reference = tras.multisine(500, 0.01, [0.2, 0.8], [1.22173, np.pi], np.random.default_rng(1))
    recording = tras.simulate_closed_loop(reference, 0.01, tras.PlantParameters())
    return recording.select(inputs=["phi_ref", "psi_ref"]).cut(501)


@pytest.mark.slow
def test_degree_4_on_reference_driven_data_within_1e_8_of_extended_precision(closed_loop):
    """K of the model as users fit it, 50 000 pairs, condition 5e8: plain Gram is off by 500 %, LAPACK's QR by 4e-8."""
    model = tras.KoopmanModel(tras.Monomials(4), "one_step", regularization=None).fit(closed_loop)
    assert len(model.names_) == model.rank_ == 210 and model.condition_number > 1e8
    x, u, y = (
        np.concatenate(part) for part in zip(*koopman.snapshot_pairs(model.channels_.scaled(closed_loop), 10**6))
    )
    assert len(x) == 50000
    X, D = koopman.rows(model.dictionary_, x, u, y)
    some = [1, 2, 3, 4, 9, 100, 150]  # the states, and functions of degree 2 to 4
    solver = StreamingLeastSquares().update(X, D)
    columns = [j for j in some if D[:, j].any()]
    exact = extended(X, np.ascontiguousarray(D[:, columns]), solver.solve().R)[0]
    assert columns[:4] == [1, 2, 3, 4] and len(columns) >= 6
    change = (model.koopman_matrix - np.eye(210))[:, columns]
    assert columnwise(change, exact) <= 1e-8
    assert columnwise(solver.solve().coefficients[:, columns], exact) <= 1e-8
    # ... and K, which is what the issue asks for, with room to spare:
    identity = np.eye(210)[:, columns]
    assert columnwise(change + identity, exact + identity) <= 1e-9
    # Functions of the inputs alone do not change, exactly.
    still = ~D.any(axis=0)
    assert still.sum() == 15 and np.array_equal(model.koopman_matrix[:, still], np.eye(210)[:, still])


def test_scales_of_columns_do_not_matter():
    """Columns between 1e-8 and 1e8, condition 1e16: each has the relative accuracy of the unscaled problem."""
    rng = np.random.default_rng(0)
    X, factors = rng.normal(size=(20000, 40)) + 1.0, 10.0 ** rng.uniform(-8, 8, 40)
    Y = np.sin(X[:, :3])
    plain, scaled = least_squares([(X, Y)]), least_squares([(X * factors, Y)])
    assert scaled.condition_number > 1e12 and scaled.scaled_condition_number == pytest.approx(
        plain.scaled_condition_number, rel=1e-8
    )
    assert columnwise(scaled.coefficients * factors[:, None], plain.coefficients) <= 1e-12
    assert scaled.rank == plain.rank == 40 and max(rounding_error(plain), rounding_error(scaled)) < 1e-14


@pytest.mark.parametrize("size", [1e-6, 1e-9])
def test_nearly_dependent_columns(size):
    """Two columns apart by ``size``: against extended precision, and within a few of the rounding error."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(10000, 12))
    X[:, 7] = X[:, 3] + size * X[:, 7]
    Y = X @ rng.normal(size=(12, 2)) + rng.normal(size=(10000, 2))
    fit = least_squares((X[k::5], Y[k::5]) for k in range(5))
    error = columnwise(fit.coefficients, extended(X, Y, fit.R)[0])
    assert fit.rank == 12 and error <= 1e-15 / size and error <= 10 * rounding_error(fit)


def test_condition_number_and_triangular_factor_against_numpy():
    rng = np.random.default_rng(0)
    for decades in (0, 3, 6):
        X = rng.normal(size=(5000, 20)) @ np.diag(10.0 ** rng.uniform(0, decades, 20)) @ rng.normal(size=(20, 20))
        fit = least_squares([(X, X[:, :1])])
        assert fit.condition_number == pytest.approx(np.linalg.cond(X), rel=1e-7)
        assert fit.scaled_condition_number == pytest.approx(np.linalg.cond(X / np.linalg.norm(X, axis=0)), rel=1e-7)
        R = np.linalg.qr(X)[1]
        signs = np.sign(np.diag(R))[:, None]
        assert np.allclose(fit.R * np.sign(np.diag(fit.R))[:, None], R * signs, rtol=1e-8, atol=1e-10 * np.abs(R).max())


# ----------------------------------------------------------------------------------------------------------------- rank


def dependent(kind):
    """300 rows whose columns depend on each other as ``kind`` says: (regressors, names that may be accused)."""
    rng = np.random.default_rng(1)
    X = rng.normal(size=(300, 8))
    if kind == "duplicate":
        X[:, 5] = X[:, 2]
        return X, {"f2", "f5"}
    if kind in ("zero", "without squares", "hardly a number"):
        X[:, 4] *= {"zero": 0, "without squares": 1e-200, "hardly a number": 1e-310}[kind]
        return X, {"f4"}
    if kind == "constant":
        X[:, 0], X[:, 6] = 1, 0.3
        return X, {"f0", "f6"}
    if kind == "many":
        X[:, 7] = X[:, :7] @ [1, -2, 3, 1, 1, -1, 2]
        return X, {f"f{j}" for j in range(8)}
    return X[:5], set()


@pytest.mark.parametrize("units", [1.0, 1e-7])
@pytest.mark.parametrize("kind", ["duplicate", "zero", "without squares", "hardly a number", "constant", "many"])
def test_dependent_columns_are_found_and_named(kind, units):
    X, involved = dependent(kind)
    X = X * np.geomspace(1, units, 8)
    Y = X @ np.ones((8, 1))
    fit = StreamingLeastSquares().update(X, Y).solve([f"f{j}" for j in range(8)])
    assert fit.rank == 7
    with pytest.raises(
        ValueError,
        match="8 functions are linearly dependent on this data .numerical rank 7; .*truncated or regularized",
    ) as caught:
        _ = fit.coefficients
    names = set(str(caught.value).split("rank 7; ")[1].split(" take part")[0].split(", "))
    assert names and names <= involved
    if len(involved) <= 3:
        assert names == involved
    # A solution still exists, and it predicts as well as any.
    shortest = regularized("truncated", fit.R, fit.rotated, 1)(1e-10)
    assert np.abs(X @ shortest - Y).max() <= 1e-12 * np.abs(Y).max()


def test_fewer_rows_than_columns():
    X, _ = dependent("few")
    fit = StreamingLeastSquares().update(X, X[:, :1]).solve()
    assert fit.rank == 5
    with pytest.raises(
        ValueError,
        match="5 snapshot pairs cannot determine 8 functions; record at least 8 pairs or use a smaller dictionary",
    ):
        _ = fit.coefficients


def test_the_model_names_functions_by_their_channels(experiment):
    x = experiment.states
    doubled = tras.Recording(x, experiment.inputs[..., [2]], experiment.dt, input_names=["u"])

    class Twice(tras.Monomials):
        def _fill(self, psi, z):
            super()._fill(psi, z)
            psi[7] = psi[8]

    with pytest.raises(ValueError, match="rank 20; x1 x2, x1 x3 take part"):
        tras.KoopmanModel(Twice(2), "one_step", regularization=None).fit(doubled)


# ------------------------------------------------------------------------------------------------------------ streaming


@pytest.fixture(scope="module")
def rows():
    rng = np.random.default_rng(3)
    X = rng.normal(size=(9000, 15)) @ rng.normal(size=(15, 15))
    return X, np.tanh(X[:, :4])


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), blocks=st.integers(1, 60), panel=st.sampled_from([None, 40, 500]))
def test_order_and_size_of_blocks_do_not_matter(rows, seed, blocks, panel):
    X, Y = rows
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(X))
    solver = StreamingLeastSquares(panel)
    for k, part in enumerate(np.split(order, np.sort(rng.integers(0, len(X), blocks)))):
        solver.update(X[part], Y[part])
        if k == blocks // 2:  # a look in the middle, then stored and read again
            solver.solve()
            file = io.BytesIO()
            np.savez(file, **solver.state())
            file.seek(0)
            solver = StreamingLeastSquares.from_state(np.load(file), panel)
    fit = solver.solve()
    whole = least_squares([(X, Y)])
    assert fit.rows == len(X)
    assert columnwise(fit.coefficients, whole.coefficients) <= 1e-12
    assert np.allclose(fit.residual, whole.residual, rtol=1e-11)
    assert np.allclose(fit.R.T @ fit.R, whole.R.T @ whole.R, rtol=1e-11, atol=1e-11 * len(X))


@pytest.mark.parametrize("stored_after", [1, 2, 7, 12])
def test_a_store_between_changes_no_bit(rows, stored_after):
    """Blocks smaller than a panel, so that rows wait at the store, after the first block without any basis yet."""
    X, Y = rows
    straight, stored = StreamingLeastSquares(), StreamingLeastSquares()
    for k in range(15):
        for solver in (straight, stored):
            solver.update(X[600 * k : 600 * (k + 1)], Y[600 * k : 600 * (k + 1)])
        if k + 1 == stored_after:
            stored = StreamingLeastSquares.from_state(stored.state())
            assert len(stored.state()["waiting_regressors"]) == 600 * ((k + 1) % 7)
    assert np.array_equal(straight.solve().coefficients, stored.solve().coefficients)
    assert np.array_equal(straight.solve().R, stored.solve().R)


@pytest.mark.parametrize("common", [False, True])
@pytest.mark.parametrize("kind", ["alike", "scales", "directions", "degenerate"])
def test_merged_solvers_are_as_good_as_one(kind, common):
    """Four solvers of rows of one kind or of different ones, against extended precision; condition 1e7 and more."""
    rng = np.random.default_rng(2)
    X = np.vander(rng.uniform(0.2, 1, 24_000), 10, increasing=True)
    parts = np.array_split(np.arange(len(X)), 4)
    if kind == "scales":
        for k, part in enumerate(parts):
            X[part] *= 10.0 ** (3 * k - 4)
    elif kind == "directions":
        X[parts[0], 9], X[parts[1], 9], X[parts[2], 3] = X[parts[0], 8], 0.0, X[parts[2], 4] * (1 + 1e-9)
    elif kind == "degenerate":
        X[parts[0]] = X[0]
        X[parts[1], :9] = 0.0
    Y = np.sin(X[:, 1:3]) + 0.1 * rng.normal(size=(len(X), 2))
    solvers = [StreamingLeastSquares().update(X[part[:5000]], Y[part[:5000]]) for part in parts]
    for solver, part in zip(solvers, parts):
        if common:
            solver.__dict__.update(solvers[0].emptied().update(X[part[:5000]], Y[part[:5000]]).__dict__)
        solver.update(X[part[5000:]], Y[part[5000:]])  # these wait: fewer than a panel
    before = {key: value.copy() for key, value in solvers[1].state().items()}
    merged = StreamingLeastSquares()
    for solver in solvers:
        merged.merge(solver)
    assert all(np.array_equal(value, before[key]) for key, value in solvers[1].state().items())
    fit, straight = merged.solve(), least_squares([(X, Y)])
    exact = extended(X, Y, straight.R)[0]
    assert fit.rows == len(X) and fit.rank == 10
    # Where rows are of very different kinds one solver, too, is worse than rounding of the regressors alone would make
    # it.
    assert columnwise(fit.coefficients, exact) <= 10 * max(
        rounding_error(straight), columnwise(straight.coefficients, exact)
    )
    assert np.allclose(fit.residual, straight.residual, rtol=1e-10)
    # ... and more rows may follow.
    assert merged.update(X[:6000], Y[:6000]).solve().rows == 30_000


def test_a_copy_keeps_its_rows_when_the_original_goes_on(rows):
    """Rows that were multiplied, and rows that wait."""
    X, Y = rows
    solver = StreamingLeastSquares().update(X[:5000], Y[:5000]).update(X[5000:5600], Y[5000:5600])
    other = copy.copy(solver)
    before = {key: value.copy() for key, value in other.state().items()}
    solver.update(X[5600:6000], Y[5600:6000]).update(X, Y).update(X[:10], Y[:10])
    assert all(np.array_equal(value, before[key]) for key, value in other.state().items())
    assert other.rows == 5600 and np.array_equal(
        other.solve().R, StreamingLeastSquares().update(X[:5000], Y[:5000]).update(X[5000:5600], Y[5000:5600]).solve().R
    )


def test_merging_nothing_and_what_does_not_fit(rows):
    X, Y = rows
    solver = StreamingLeastSquares().update(X, Y)
    assert solver.merge(StreamingLeastSquares()) is solver and solver.rows == len(X)
    copy = StreamingLeastSquares().merge(solver)
    assert np.array_equal(copy.solve().coefficients, solver.solve().coefficients)
    with pytest.raises(ValueError, match=r"other has .regressors, targets. \(14, 4\), these rows \(15, 4\)"):
        solver.merge(StreamingLeastSquares().update(X[:, 1:], Y))


def test_partial_updates_equal_the_solution_of_what_came_so_far(rows):
    X, Y = rows
    solver = StreamingLeastSquares()
    for end in range(900, 9001, 900):
        solver.update(X[end - 900 : end], Y[end - 900 : end])
        assert columnwise(solver.solve().coefficients, np.linalg.lstsq(X[:end], Y[:end], rcond=None)[0]) <= 1e-12


def test_the_callers_arrays_may_be_used_again(rows):
    X, Y = rows
    buffer, solver = np.empty((100, 15)), StreamingLeastSquares()
    for k in range(0, 1000, 100):
        buffer[:] = X[k : k + 100]
        solver.update(buffer, Y[k : k + 100])
    assert np.allclose(
        solver.solve().coefficients, least_squares([(X[:1000], Y[:1000])]).coefficients, rtol=1e-11, atol=1e-13
    )


def test_directions_that_only_late_rows_contain():
    """First one point repeated, then columns that differ by 1e-9, at last 20 rows that tell them apart."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(30000, 20))
    X[:6000] = X[0]
    X[:, 7] = X[:, 8] + 1e-9 * X[:, 7]
    X[-20:, 7] += 1e3 * rng.normal(size=20)
    exact = rng.normal(size=(20, 3))
    fit = least_squares((X[k : k + 2500], X[k : k + 2500] @ exact) for k in range(0, 30000, 2500))
    assert np.allclose(fit.coefficients, exact, atol=1e-11)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
@pytest.mark.parametrize("where", ["regressors", "targets"])
def test_nan_and_infinity_are_refused(bad, where):
    arrays = {"regressors": np.random.default_rng(0).normal(size=(300, 3)), "targets": np.ones((300, 1))}
    arrays[where][150, 0] = bad
    with (
        np.errstate(over="ignore"),
        pytest.raises(ValueError, match="NaN, infinity or values too large to square; repair them"),
    ):
        StreamingLeastSquares(panel=64).update(*arrays.values()).solve()


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda s: s.solve(), "no rows; call update"),
        (lambda s: s.state(), "no rows; call update"),
        (lambda s: s.update(np.ones((5, 2)), np.ones((6, 1))), "regressors has 5 rows but targets has 6"),
        (lambda s: s.update(np.ones(5), np.ones((5, 1))), r"regressors has shape \(5,\); give .rows, columns."),
        (
            lambda s: s.update(np.ones((5, 2)), np.ones((5, 1))).update(np.ones((5, 3)), np.ones((5, 1))),
            "earlier ones .2, 1.; they must be alike",
        ),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call(StreamingLeastSquares())


def test_memory_does_not_grow_with_the_rows():
    def peak(rows):
        rng = np.random.default_rng(0)
        tracemalloc.start()
        solver = StreamingLeastSquares()
        for _ in range(rows // 5000):
            x = rng.standard_normal((5000, 30))
            solver.update(x, x[:, :10])
        _ = solver.solve().coefficients
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top

    peak(5000)  # what is imported or cached on first use does not count
    assert peak(200_000) <= 1.1 * peak(20_000)


# ----------------------------------------------------------------------------------------------------------- by threads


@pytest.fixture(scope="module")
def strange_blocks():
    """Blocks of one panel's size, smaller ones between them, and a direction that only later ones contain."""
    rng = np.random.default_rng(5)
    blocks = []
    for k, rows in enumerate([4096, 4500, 8191, 4100, 4097, 5000, 100, 9000, 4096, 4200, 30, 4200]):
        x = rng.normal(size=(rows, 12))
        x[:, 11] = x[:, 10] * (1 + 1e-7 * rng.normal(size=rows)) if k < 3 else x[:, 11]
        x[:, 9] *= 1e-9 if k < 8 else 1.0
        blocks.append((np.asfortranarray(x), np.sin(np.asfortranarray(x)[:, :3])))
    return blocks


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_blocks_by_threads_have_the_bits_of_blocks_one_after_the_other(strange_blocks, threads):
    renewed, straight, lifted = [], StreamingLeastSquares(), StreamingLeastSquares()
    lifted._renew_basis = lambda *arguments: (renewed.append(1), StreamingLeastSquares._renew_basis(lifted, *arguments))
    for x, y in strange_blocks:
        straight.update(x, y)
    lifted.update_lifted(strange_blocks, lambda block: tuple(part.copy(order="F") for part in block), threads)
    assert renewed and lifted.rows == straight.rows
    for name, value in straight.state().items():
        assert np.array_equal(lifted.state()[name], value), name


@pytest.mark.parametrize("threads", [1, 3])
def test_mistakes_in_a_thread_reach_the_caller(strange_blocks, threads):
    def lift(block):
        if len(block[0]) == 5000:
            raise ZeroDivisionError("in a thread")
        return block[0].copy(), block[1]

    with pytest.raises(ZeroDivisionError, match="in a thread"):
        StreamingLeastSquares().update_lifted(strange_blocks, lift, threads)
    spoilt = [(x.copy(), y) for x, y in strange_blocks]
    spoilt[3][0][17, 2] = np.nan
    with pytest.raises(ValueError, match="regressors or targets hold NaN"):
        StreamingLeastSquares().update_lifted(spoilt, lambda block: (block[0].copy(), block[1]), threads)


def test_leading_bits_are_multiplied_exactly_only_where_terms_cancel():
    """One product where it is good to ten digits, which the solution against extended precision shows; two beyond."""
    rng = np.random.default_rng(0)
    outcome = {}
    for size in (1e-4, 1e-9):
        X = rng.normal(size=(9000, 6))
        X[:, 4] = X[:, 1] + size * X[:, 4]
        Y = np.sin(X[:, :2])
        solver = StreamingLeastSquares().update(X, Y)
        fit = solver.solve()
        outcome[size] = solver.basis.exact, columnwise(fit.coefficients, extended(X, Y, fit.R)[0])
    assert outcome[1e-4] == (6, pytest.approx(0, abs=1e-11)) and outcome[1e-9] == (4, pytest.approx(0, abs=1e-6))


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("first", [0, 3, 29])
def test_rows_in_the_basis_against_extended_precision(first, overwrite):
    """Columns that are dependent to 1e-10 from ``first`` on: errors in B are a thousandth of a plain product's."""
    rng = np.random.default_rng(7)
    X = rng.normal(size=(500, 30))
    X[:, first:] = X[:, :1] + 1e-10 * X[:, first:] if first else X[:, 29:] + 1e-10 * X
    basis = Sketch(30).add(X).basis()
    assert basis.exact == max(first, 1)
    exact = sum(product(X / basis.scale, (basis.T, np.zeros_like(basis.T))))
    rows = np.asfortranarray(X.copy())
    length = np.linalg.norm(exact, axis=0)
    errors = np.linalg.norm(basis.whiten(rows, overwrite) - exact, axis=0) / length
    assert overwrite or np.array_equal(rows, X)
    cancelled = np.linalg.norm(X / basis.scale, axis=0) @ np.abs(basis.T) / length
    plain = np.linalg.norm((X / basis.scale) @ basis.T - exact, axis=0) / length
    assert errors.max() <= np.finfo(float).eps * cancelled.max() * 2.0**-basis.bits and plain.max() > 1e3 * errors.max()


# ------------------------------------------------------------------------------------------------------ the first basis


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    p=st.integers(1, 40),
    rows=st.integers(1, 3000),
    decades=st.floats(0, 9),
    blocks=st.integers(1, 4),
)
def test_a_basis_of_a_sketch_serves_all_its_rows(seed, p, rows, decades, blocks):
    """In it the rows have a condition number of some tens at most, whatever that of their functions."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(rows, p)) @ np.diag(np.geomspace(1, 10**-decades, p)) @ rng.normal(size=(p, p))
    sketch = Sketch(p)
    for part in np.array_split(X, blocks):
        sketch.add(part)
    assert sketch.rows == rows
    B = sketch.basis().whiten(X)
    if rows >= p and np.linalg.cond(X / np.linalg.norm(X, axis=0)) < 1e10:
        singular = np.linalg.svd(B, compute_uv=False)
        assert singular[0] <= 60 * singular[-1] and 0.05 <= singular[-1] and singular[0] <= 20
    assert np.linalg.norm(B) ** 2 <= 9 * min(rows, p) + 1


def test_a_basis_of_a_sketch_has_the_lengths_of_the_rows():
    """Random sums keep lengths: singular values of 3000 rows in a basis of 432 sums are those of a random matrix."""
    X = np.random.default_rng(0).normal(size=(3000, 200))
    singular = np.linalg.svd(Sketch(200).add(X).basis().whiten(X), compute_uv=False)
    ratio = (200 / 432) ** 0.5
    assert 0.85 / (1 + ratio) <= singular[-1] and singular[0] <= 1.15 / (1 - ratio)


def test_scales_are_those_of_all_rows_of_a_sketch():
    X = np.random.default_rng(0).normal(size=(2000, 5))
    X[:1000, 2] *= 1e6
    assert np.array_equal(Sketch(5).add(X[:1000]).add(X[1000:]).basis().scale, powers_of_two(X))


def test_a_basis_is_judged_when_its_sample_is_in_and_renewed_when_rows_leave_its_span():
    """Two columns are nearly alike in the first of two blocks: no reason for another basis, but a new direction is."""
    rng = np.random.default_rng(3)
    X = rng.normal(size=(6 * 4100, 300))
    X[:4100, 7] = X[:4100, 8] + 1e-5 * X[:4100, 7]
    X[: 4 * 4100, 20] = X[: 4 * 4100, 21] + 1e-9 * X[: 4 * 4100, 20]
    blocks = [(X[k : k + 4100], X[k : k + 4100] @ np.ones((300, 1))) for k in range(0, len(X), 4100)]
    lift = lambda block: (block[0].copy(order="F"), block[1])  # noqa: E731
    solver = StreamingLeastSquares().update_lifted(blocks[:4], lift)
    basis = solver.basis
    assert basis.same_as(Sketch(300).add(X[:4100]).add(X[4100:8200]).basis())
    assert solver.emptied().update_lifted(blocks[:1], lift).basis is basis
    for other in (solver.emptied(), solver):
        assert other.update_lifted(blocks[4:], lift).basis is not basis
        assert np.allclose(other.solve().coefficients, 1, rtol=0, atol=1e-9)


def narrow_functions(rows, p=300):
    """Blocks of one panel, in each of which functions are nearly dependent: the last 200 columns live in few rows."""
    rng = np.random.default_rng(11)
    X = rng.normal(size=(rows, p))
    X[:, 100:] = (
        np.exp(-((rng.uniform(-1, 1, (rows, 1)) - np.linspace(-1, 1, p - 100)) ** 2) / 0.02**2) + 0.1 * X[:, :1]
    )
    Y = np.tanh(X[:, :3] + X[:, 150:153])
    return X, Y, [(X[k : k + 4100], Y[k : k + 4100]) for k in range(0, rows, 4100)]


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.slow
def test_more_blocks_make_the_first_basis_where_one_is_few_rows(alone):
    """Two of 4100 rows for 300 functions; the same bits by any number of threads, as good as QR, emptied or not."""
    X, Y, blocks = narrow_functions(5 * 4100)
    calls = []
    lift = lambda block: tuple(part.copy(order="F") for part in block)  # noqa: E731
    regressors = (lambda block: (calls.append(1), block[0])[1]) if alone else None
    solvers = [StreamingLeastSquares().update_lifted(blocks, lift, threads, regressors) for threads in (1, 2, 5)]
    assert len(calls) == 3 * alone
    assert panels_of_a_basis(300) == 2 and panels_of_a_basis(256) == 1 and panels_of_a_basis(2000) == 4
    for solver in solvers[1:]:
        assert all(np.array_equal(value, solvers[0].state()[key]) for key, value in solver.state().items())
    expected = Sketch(300).add(X[:4100]).add(X[4100:8200]).basis()
    assert expected.same_as(solvers[0].basis)
    fit = solvers[0].solve()
    exact = extended(X, Y, fit.R)[0]
    QR = linalg.lstsq(X, Y)[0]
    assert fit.rows == len(X) and columnwise(fit.coefficients, exact) <= 3 * columnwise(QR, exact)
    again = solvers[0].emptied().update_lifted(blocks[2:], lift)
    assert again.basis is solvers[0].basis and again.rows == 3 * 4100


def test_a_first_block_that_is_all_there_is():
    X, Y, blocks = narrow_functions(4100)
    lifted = StreamingLeastSquares().update_lifted(blocks, lambda block: (block[0].copy(order="F"), block[1]))
    with one_blas_thread():
        assert np.array_equal(lifted.solve().coefficients, least_squares([(X, Y)]).coefficients)
    assert StreamingLeastSquares().update_lifted([], None).rows == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_in_the_rows_that_the_basis_is_made_of(bad):
    X, Y, blocks = narrow_functions(2 * 4100)
    X[17, 3] = bad
    with np.errstate(invalid="ignore"), pytest.raises(ValueError, match="regressors or targets hold NaN, infinity"):
        StreamingLeastSquares().update_lifted(blocks, lambda block: (block[0].copy(order="F"), block[1]))


def test_rank_is_that_of_the_singular_values_on_either_side_of_the_shortcut():
    """The bound that spares the decomposition says nothing near the limit, which columns apart by 10^-k cross."""
    rng = np.random.default_rng(0)
    ranks = []
    for k in range(8, 17):
        X = rng.normal(size=(5000, 6))
        X[:, 5] = X[:, 2] + 10.0**-k * X[:, 5]
        fit = StreamingLeastSquares().update(X, X[:, :1]).solve()
        singular = np.linalg.svd(fit.R / np.linalg.norm(X, axis=0), compute_uv=False)
        assert fit.rank == np.sum(singular > singular[0] * np.finfo(float).eps * 5000**0.5)
        ranks.append(fit.rank)
    assert ranks[0] == 6 and ranks[-1] == 5 and ranks == sorted(ranks, reverse=True)


def test_users_of_one_blas_thread_that_overlap_restore_what_was_there_first():
    def threads():
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        first, second = one_blas_thread(), one_blas_thread()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert set(threads()) == {1}
        second.__exit__(None, None, None)
        assert threads() == before and max(before) == 2
