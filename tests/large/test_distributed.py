"""One fit by several workers: the same bits whoever does the work, workers killed on the way, mistakes."""

import os
import signal

import numpy as np
import pytest
from distributed import Client

import tras
from tras.large import distributed
from tras.workflow import executors
from tras.workflow.executors import SchedulerError

CHUNK = 2000
LABELS = {"state_names": ["phi", "phidot"], "input_names": ["u"]}


def pendulum(samples, seed):
    """A damped pendulum under held random torque."""
    rng = np.random.default_rng(seed)
    x, u = np.zeros((samples, 2)), np.repeat(rng.uniform(-2, 2, (samples // 20 + 1, 1)), 20, axis=0)[:samples]
    for k in range(samples - 1):
        rate = x[k, 1] + 0.1 * np.sin(x[k, 1]), -np.sin(x[k, 0]) - 0.3 * x[k, 1] + u[k, 0]
        x[k + 1] = x[k] + 0.02 * np.array(rate)
    return tras.Recording([x], [u], 0.02, **LABELS)


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings")
    for k, samples in enumerate([9001, 7000, 3, 12_345]):
        pendulum(samples, k).write(folder / f"{k}.nc")
    return sorted(folder.glob("*.nc"))


def model(**options):
    return tras.KoopmanModel(tras.Monomials(3), **({"strength": 0.0} | options))


def same(a, b):
    names = "koopman_matrix", "W_", "outward_", "x_scale_", "strength_", "pairs_"
    return (
        all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)
        and np.array_equal(a.hull_.low, b.hull_.low)
        and np.array_equal(a.hull_.axes, b.hull_.axes)
    )


def test_none_and_several_workers_agree_to_the_bit(paths, cluster):
    """... for the same parts. Another partition, or none, adds the same rows in another order."""
    alone = model().fit(paths, chunk=CHUNK, parts=5)
    assert alone.pairs_ == sum(tras.open_recording(path).pairs for path in paths)
    assert same(alone, model().fit(paths, chunk=CHUNK, parts=5, scheduler=cluster.scheduler_address))
    for other in (model().fit(paths, chunk=CHUNK), model().fit(paths, chunk=CHUNK, parts=2)):
        assert np.abs(other.koopman_matrix - alone.koopman_matrix).max() <= 1e-12 and other.strength_ == alone.strength_
        assert np.array_equal(other.hull_.low, alone.hull_.low)


def test_the_strength_is_chosen_on_the_same_windows(paths):
    """Held out by whatever part they lie in: the choice is that of a fit without parts."""
    plain, spread = (
        model(strength="auto").fit(paths, chunk=CHUNK),
        model(strength="auto").fit(paths, chunk=CHUNK, parts=3),
    )
    assert spread.strength_ == plain.strength_ and spread.pairs_ == plain.pairs_
    assert [spread.errors_[s] for s in spread.errors_] == pytest.approx(
        [plain.errors_[s] for s in plain.errors_], rel=1e-6
    )


def test_recordings_in_memory_and_other_predictors(paths):
    recordings = [tras.Recording.read(path) for path in paths]
    for predictor, delays, chosen in (("lifted_linear", 0, slice(None)), ("one_step", 1, [0, 1, 3])):
        parts = [recordings[k] for k in np.arange(4)[chosen]]
        options = {"predictor": predictor, "delays": delays, "strength": 1e-6}
        whole = tras.KoopmanModel(tras.Monomials(2), **options).fit(parts)
        spread = tras.KoopmanModel(tras.Monomials(2), **options).fit(parts, chunk=CHUNK, parts=3)
        assert spread.pairs_ == whole.pairs_
        assert np.abs(spread.koopman_matrix - whole.koopman_matrix).max() <= 1e-15 * whole.condition_number


def killing(marker, absorb_part=distributed.absorb_part):
    """`absorb_part` in a worker that is killed the first time it comes to the second part."""

    def absorb(model, stream, held, length, groups):
        if groups[0][0] > 0 and not marker.exists():
            marker.write_text("killed")
            os.kill(os.getpid(), signal.SIGKILL)
        return absorb_part(model, stream, held, length, groups)

    return absorb


def test_a_worker_killed_on_the_way_costs_time_only(paths, cluster, tmp_path, monkeypatch):
    alone = model().fit(paths, chunk=CHUNK, parts=4)
    monkeypatch.setattr(distributed, "absorb_part", killing(tmp_path / "marker"))
    assert same(alone, model().fit(paths, chunk=CHUNK, parts=4, scheduler=cluster.scheduler_address))
    assert (tmp_path / "marker").exists()


@pytest.mark.slow
def test_one_local_process_has_the_same_bits(paths, monkeypatch):
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")
    assert same(
        model().fit(paths, chunk=CHUNK, parts=4), model().fit(paths, chunk=CHUNK, parts=4, scheduler="processes")
    )


def test_a_part_that_kills_every_worker_is_named(paths, monkeypatch):
    monkeypatch.setattr(
        executors,
        "run_locally",
        lambda work, jobs, *_: ((k, lambda: executors.Lost("its process was killed")) for k in range(len(jobs))),
    )
    with pytest.raises(SchedulerError, match="part 0 of 3 was lost: its process was killed; use a smaller chunk"):
        model().fit(paths, chunk=CHUNK, parts=3, scheduler="processes")


def test_workers_with_other_versions_are_named(paths, cluster):
    def pretend(version):
        import numpy

        # A worker that was just restarted would look at numpy's version while it imports.
        import tras.large.distributed  # noqa: F401

        was, numpy.__version__ = numpy.__version__, version
        return was

    with Client(cluster.scheduler_address, set_as_default=False) as client:
        was = next(iter(client.run(pretend, "1.0").values()))
        try:
            with pytest.raises(
                SchedulerError, match=r"worker tcp://.* has numpy 1.0 but .* is needed; install environment.txt there"
            ):
                model().fit(paths, chunk=CHUNK, scheduler=cluster.scheduler_address)
        finally:
            client.run(pretend, was)


def test_a_part_that_fails_says_why(paths, cluster, tmp_path):
    """A file that changed after the first reading."""
    copy = tmp_path / "copy.nc"
    copy.write_bytes(paths[0].read_bytes())
    file = tras.open_recording(copy)
    pendulum(9001, 7).select(inputs=[]).write(copy)
    with pytest.raises(ValueError, match="copy.nc: channel 'u' of trajectory 0 cannot be read"):
        model().fit(
            [file],
            chunk=CHUNK,
            parts=2,
            scheduler=cluster.scheduler_address,
            ranges={"phi": (-3, 3), "phidot": (-3, 3), "u": (-2, 2)},
        )


@pytest.mark.parametrize(
    "options, words",
    [
        ({"scheduler": "tcp://127.0.0.1:9"}, "scheduler 'tcp://127.0.0.1:9' cannot be reached within 0.5 s; start one"),
        ({"scheduler": "nonsense://there"}, "scheduler 'nonsense://there' cannot be reached"),
        ({"scheduler": "cluster"}, "scheduler is 'cluster'; give None, 'processes', or an address"),
        ({"parts": 0}, "parts = 0; give the number of parts"),
        ({"parts": 2, "checkpoint": "a.npz"}, "checkpoint is for a fit by one process"),
    ],
)
def test_mistakes_are_named(paths, monkeypatch, options, words):
    monkeypatch.setattr(executors, "_PATIENCE", 0.5)
    with pytest.raises(ValueError, match=words):
        model().fit(paths, chunk=CHUNK, **options)
    with pytest.raises(ValueError, match="recording is an iterator or a callable, which workers cannot share"):
        model().fit(iter([]), parts=2)
