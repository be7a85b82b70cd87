"""The state of a fit: what is absorbed in parts, stored and merged is what is absorbed at once."""

import copy

import numpy as np
import pytest
from sklearn.base import clone
from threadpoolctl import threadpool_limits

import tras
from tras import regularization
from tras.dictionaries.kinds import KINDS
from tras.fitting import Fit, hold_out
from tras.solver import stability


@pytest.fixture(scope="module")
def log(experiment):
    return experiment.select(inputs=["u_phi", "u_psi"])


def begun(log, **options):
    fit = Fit.begin(tras.KoopmanModel(tras.Monomials(2), **options), log)
    return fit, fit.channels.scaled(log)


def same(one, other):
    """Whether two fits know the same of the rows, bit for bit."""
    a, b = one.state(), other.state()
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize("predictor", ["vector_field", "one_step", "lifted_linear"])
def test_a_restored_state_goes_on_with_the_same_bits(log, predictor):
    fit, scaled = begun(log, predictor=predictor)
    fit.absorb(scaled[:3])
    again, _ = begun(log, predictor=predictor)
    again.restore(fit.state())
    assert same(fit, again)
    for one in (fit, again):
        one.absorb(scaled[3:])
    assert same(fit, again) and (fit.hull is None) == (predictor == "lifted_linear")


def test_merged_parts_are_the_whole(log):
    """One half absorbed here and one elsewhere, from the same basis: the same solution to rounding, the same hull."""
    whole, scaled = begun(log)
    whole.absorb(scaled)
    parts = copy.copy(whole).emptied()
    other = copy.copy(parts)
    parts.absorb(scaled[:4])
    other.absorb(scaled[4:])
    parts.merge(other.state())
    assert parts.solver.rows == whole.solver.rows == log.pairs
    assert all(np.array_equal(parts.hull.arrays()[name], whole.hull.arrays()[name]) for name in ("low", "high", "axes"))
    (_, together), (_, at_once) = parts.solve(None, 0.0), whole.solve(None, 0.0)
    assert np.abs(together - at_once).max() <= 1e-10 * np.abs(at_once).max()


def test_a_copy_is_not_changed_by_what_the_original_absorbs(log):
    fit, scaled = begun(log)
    fit.absorb(scaled[:2])
    before, state = copy.copy(fit), fit.state()
    fit.absorb(scaled[2:])
    assert not same(before, fit)
    assert all(np.array_equal(before.state()[name], value) for name, value in state.items())


def test_hold_out_keeps_every_pair_in_one_of_the_two(log):
    rest, windows = hold_out(log)
    assert rest.pairs + windows.pairs == log.pairs and len(set(windows.lengths)) == 1
    few, nothing = hold_out(log[:1].cut(12)[:1])
    assert nothing is None and few.pairs == 11


def test_no_pairs_is_a_sentence():
    single = tras.Recording([[[1.0]]], [[[2.0]]], 0.1)
    with pytest.raises(ValueError, match="no trajectory has two samples"):
        Fit.begin(tras.KoopmanModel(tras.Monomials(1)), single)


# ------------------------------------------------------------------------------------------------- too many functions

TOO_MANY = [
    (tras.Monomials(6), {}, "Monomials.degree=6. has 134596 functions"),
    (tras.Monomials(900), {}, "has more than 1e12 functions of these channels, .* more memory than there is"),
    (tras.Monomials(10**6), {}, "degree is 1000000; give a whole number from 1 to 1000"),
    (tras.Monomials(2), {"delays": 30, "predictor": "one_step"}, "156520 functions .* fewer than 30 delays"),
    (tras.Monomials(1), {"delays": 60}, "has 1099 functions .*, or allow it: .*max_functions=1099"),
    (tras.GaussianRBF(10**8), {}, "has 100000019 functions"),
    (tras.GaussianRBF(10**8, centres="kmeans"), {}, "has 100000019 functions"),
    (tras.Exponentials(900), {}, "more than 1e12 functions"),
    (tras.Fourier(900), {}, "more than 1e12 functions"),
    (tras.Mechanical(900, shape=[0, 2, 4, 6, 8, 10]), {}, "more than 1e12 functions"),
    (tras.Product(tras.Monomials(4), tras.Monomials(4)), {}, "has 53509225 functions"),
    (tras.Union(tras.Monomials(1), tras.Product(tras.Monomials(3), tras.Fourier(9))), {}, "has [0-9]+ functions"),
    (tras.Monomials(2), {"field": "least_squares", "max_functions": 500}, "solves for 18 x 190 coefficients at once"),
    (
        tras.Monomials(2),
        {"regularization": "sparse"},
        "more than max_functions=1000 / 6, the limit .* max_functions=1140",
    ),
    (
        tras.Monomials(2),
        {"stable": True, "predictor": "lifted_linear", "max_functions": 300},
        "=300 / 2, the limit with",
    ),
    (tras.Monomials(2), {"max_functions": 100}, "has 190 functions .*, more than max_functions=100; .* memory"),
]


@pytest.mark.parametrize("dictionary, options, words", TOO_MANY)
def test_too_many_functions_are_a_number_before_anything_is_lifted(dictionary, options, words, monkeypatch):
    def never(*arguments):
        raise AssertionError("something was built")

    for kind in set(KINDS.values()):
        monkeypatch.setattr(kind, "_build", never)
        monkeypatch.setattr(kind, "_learn", never)
    monkeypatch.setattr(tras.Recording, "delayed", never)
    recording = tras.Recording(np.random.default_rng(0).normal(size=(2, 100, 18)), dt=0.1)
    with pytest.raises(ValueError, match=words) as caught:
        tras.KoopmanModel(dictionary, **options).fit(recording)
    assert str(caught.value).endswith(".") and "\n" not in str(caught.value)


@pytest.mark.parametrize("dictionary", [
    tras.Monomials(3), tras.GaussianRBF(7), tras.GaussianRBF(5, centres="kmeans"), tras.Exponentials(2),
    tras.ThinPlate(centres=np.eye(3)), tras.Fourier(3), tras.Mechanical(4),
])  # fmt: skip
def test_functions_are_counted_as_they_are_built(dictionary):
    x, u = np.random.default_rng(0).uniform(-1, 1, (20, 2)), np.random.default_rng(1).uniform(-1, 1, (20, 1))
    assert dictionary.count_of(2, 1) == clone(dictionary).fit(x, u).size
    both = tras.Union(dictionary, tras.Monomials(2))
    assert both.count_of(2, 1) >= both.fit(x, u).size
    assert not hasattr(dictionary, "n_states_")  # counting learns nothing


def test_a_dictionary_that_cannot_count_is_refused_once_it_is_built():
    class Uncounted(tras.Monomials):
        def _count(self):
            return 0

    recording = tras.Recording(np.random.default_rng(0).normal(size=(2, 100, 4)), dt=0.1)
    with pytest.raises(ValueError, match="has 15 functions of these channels, more than max_functions=14"):
        tras.KoopmanModel(Uncounted(2), max_functions=14).fit(recording)
    assert len(tras.KoopmanModel(Uncounted(2), "one_step", max_functions=15).fit(recording).names_) == 15


def test_the_limit_is_no_part_of_a_model_file(tmp_path):
    recording = tras.Recording(np.random.default_rng(0).normal(size=(2, 100, 2)), dt=0.1)
    for name, limit in (("a.npz", 1000), ("b.npz", 6)):
        tras.KoopmanModel(tras.Monomials(2), "one_step", max_functions=limit).fit(recording).save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


# ---------------------------------------------------------------------------------- what no number can hold

OVERFLOWS = [
    (lambda x: x + 1e300 * (np.arange(len(x)) == 7)[:, None], 0.1, "'x1' reaches from .* to 1e.300, .* an outlier"),
    (lambda x: x * 1e-200, 0.1, "'x1' moves by .*e-200 in all, .* another unit"),
    (lambda x: x * 1e307, 0.1, "'x1' reaches from -.*e.307 to .*, whose squares no number can hold"),
    (lambda x: x, 1e300, "dt, the sampling time in s, is 1e.300; give a number from 1e-100 to 1e.100"),
    (lambda x: x, 1e-300, "dt, the sampling time in s, is 1e-300"),
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("damage, dt, words", OVERFLOWS)
def test_what_overflows_is_named(damage, dt, words):
    recording = tras.Recording([damage(np.random.default_rng(0).normal(size=(50, 2)))], dt=dt)
    with pytest.raises(ValueError, match=words):
        tras.KoopmanModel(tras.Monomials(2), "one_step").fit(recording)


@pytest.mark.filterwarnings("error")
def test_a_report_says_what_it_has_no_number_for():
    recording = tras.Recording(np.random.default_rng(0).normal(size=(3, 50, 1)), dt=0.1)
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", extrapolation="functions").fit(recording)
    model.koopman_matrix = 1e6 * model.koopman_matrix
    text = model.report(recording)
    assert "nan" not in text and "none, for all ran away or nothing moves" in text
    huge = tras.Recording(1e200 * recording.states, dt=0.1)
    assert "nan" not in model.report(huge)


@pytest.mark.filterwarnings("error")
def test_a_single_pair_and_a_field_that_runs_away_warn_of_nothing():
    """Found by `benchmarks.options`: covariances of one point, and exponentials far away in the choice of the step."""
    one = tras.Recording([[[0.0], [1.0]]], dt=0.1)
    with pytest.raises(ValueError, match="snapshot pairs cannot determine|linearly dependent"):
        tras.KoopmanModel(tras.Monomials(2), "one_step", strength=0.1).fit(one)
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, (200, 1))
    u[50] = 1e30
    wild = tras.Recording([rng.normal(size=(200, 2)).cumsum(axis=0) * 0.01], [u], 0.1)
    model = tras.KoopmanModel(
        tras.Exponentials(2, 20.0), field="least_squares", extrapolation="functions", strength=1e-4
    )
    try:
        model.fit(wild).vector_field([1e3, 1e3], [1e3])
        model.linearize([5.0, 5.0], [5.0])
    except ValueError as error:
        assert str(error).endswith(".")


def test_functions_that_depend_on_each_other_are_said_in_words(log):
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", strength=0.1).fit(log)
    model.condition_number = np.inf
    assert "condition number of the liftings infinite\n" in model.report()


def test_linear_algebra_that_fails_is_a_sentence(monkeypatch):
    def fail(*arguments):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(Fit, "solve", fail)
    recording = tras.Recording(np.random.default_rng(0).normal(size=(2, 50, 1)), dt=0.1)
    with pytest.raises(
        ValueError, match="linear algebra of this fit failed .SVD did not converge.; a smaller dictionary"
    ):
        tras.KoopmanModel(tras.Monomials(2), "one_step", strength=0.1).fit(recording)


# ---------------------------------------------------------------------------------- searches that end by their count


def test_a_sparse_fit_that_runs_out_of_rounds_says_so(monkeypatch):
    rng = np.random.default_rng(0)
    recording = tras.Recording(rng.uniform(-1, 1, (5, 200, 2)), rng.uniform(-1, 1, (5, 200, 1)), 0.1)
    options = {"regularization": "sparse", "strength": 0.05}
    settled = tras.KoopmanModel(tras.Monomials(3), "one_step", **options).fit(recording)
    assert settled.unsettled_ == [] and "ended after" not in settled.report()
    monkeypatch.setattr(regularization._sequential_thresholding, "__defaults__", (1,))
    hurried = tras.KoopmanModel(tras.Monomials(3), "one_step", **options).fit(recording)
    assert (
        len(hurried.unsettled_) == 1 and "sequential thresholding ended after 10 rounds, with terms" in hurried.report()
    )


def test_a_stable_fit_that_runs_out_of_iterations_says_so(monkeypatch):
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.normal(size=(5, 200, 3)), axis=1) * np.exp(0.01 * np.arange(200))[:, None]
    model = tras.KoopmanModel(tras.Monomials(2), "lifted_linear", stable=0.9, strength=0.0)
    monkeypatch.setattr(stability, "_ITERATIONS", 20)
    model.fit(tras.Recording(x, dt=0.1))
    assert "the search of a stable matrix ended after 20 iterations that still gained" in model.report()
    monkeypatch.setattr(stability, "_ITERATIONS", 4000)
    assert model.fit(tras.Recording(x, dt=0.1)).unsettled_ == []


# ---------------------------------------------------------------------------------- threads of the caller


def test_a_fit_has_the_same_bits_whatever_threads_its_caller_has(log):
    """From 81 functions on they differed: the singular values behind a regularization were not held to one thread."""
    bits = {}
    for predictor, stable in (("vector_field", False), ("one_step", False), ("lifted_linear", 0.95)):
        for threads in (1, 2, 3):
            with threadpool_limits(threads, user_api="blas"):
                model = tras.KoopmanModel(tras.GaussianRBF(120, "auto"), predictor, stable=stable, strength=1e-3)
                bits.setdefault(predictor, set()).add(model.fit(log).koopman_matrix.tobytes())
    assert {predictor: len(found) for predictor, found in bits.items()} == dict.fromkeys(bits, 1)
