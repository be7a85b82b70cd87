"""The state of a fit: what is absorbed in parts, stored and merged is what is absorbed at once."""

import copy

import numpy as np
import pytest

import tras
from tras.fitting import Fit, hold_out


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
