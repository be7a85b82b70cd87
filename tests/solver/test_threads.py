"""Threads of BLAS: one for small matrices."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import tras
from tras.solver import threads


def blas_threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture
def two():
    with threadpool_limits(2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.skip("BLAS here has one thread")
        yield


def test_small_matrices_have_one_thread_and_large_ones_all(two):
    with threads.few_blas_threads(500):
        assert blas_threads() == {1}
        with threads.few_blas_threads(501):
            assert blas_threads() == {1}
    assert blas_threads() == {2}
    with threads.few_blas_threads(501):
        assert blas_threads() == {2}


class Watched(tras.Monomials):
    """Notes how many threads there are while points are lifted."""

    seen: set = set()

    def _fill(self, psi, z):
        self.seen.update(blas_threads())
        super()._fill(psi, z)


def test_fits_and_roll_outs_of_small_models_have_one_thread(two):
    x = np.random.default_rng(0).uniform(-1, 1, (10, 30, 1))
    log = tras.Recording(x, dt=0.1)
    model = tras.KoopmanModel(Watched(2), "one_step", strength="auto").fit(log)
    Watched.seen.clear()
    model.predict(log)
    assert Watched.seen == {1} and blas_threads() == {2}


def test_refined_fields_of_small_models_have_one_thread_too(two):
    t, x = 0.1 * np.arange(40)[:, None], np.random.default_rng(0).uniform(-1, 1, (4, 1, 1))
    log = tras.Recording(x * np.exp(-t), dt=0.1)
    model = tras.KoopmanModel(Watched(2), strength=0.0).fit(log)
    Watched.seen.clear()
    tras.refine(model, log, iterations=1)
    assert Watched.seen == {1} and blas_threads() == {2}


def test_single_points_of_small_models_have_one_thread_too(two):
    x = np.random.default_rng(0).uniform(-1, 1, (10, 30, 1))
    model = tras.KoopmanModel(Watched(2), "one_step", strength=0.0).fit(tras.Recording(x, dt=0.1))
    Watched.seen.clear()
    model.simulate([0.2], np.empty((5, 0)))
    assert Watched.seen == {1} and blas_threads() == {2}
