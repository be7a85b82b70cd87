"""xarray's datasets, with chunks of Dask or without: read in slices, with the bits of the file, by any worker."""

import pickle
import tracemalloc

import numpy as np
import pytest
import xarray

import tras
from tras.large.slices import RecordingDataset, UnreadableError

CHUNK = 2000
OPENED = [{}, {"chunks": {}}, {"chunks": {"sample": 700}}]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Trajectories of unequal lengths; the input's name is before those of the two states in the alphabet."""
    rng = np.random.default_rng(4)
    lengths = [4001, 2, 2600]
    x = [np.cumsum(rng.normal(size=(n, 2)), axis=0) * 0.01 for n in lengths]
    u = [rng.uniform(-1, 1, (n, 1)) for n in lengths]
    path = tmp_path_factory.mktemp("datasets") / "log.nc"
    tras.Recording(x, u, 0.1, state_names=["q", "p"], input_names=["force"], state_units=["s", ""]).write(path)
    return path


@pytest.fixture(params=OPENED, ids=["lazy", "whole chunk", "chunks"])
def dataset(request, path):
    with xarray.open_dataset(path, engine="h5netcdf", **request.param) as dataset:
        yield dataset


def model(**options):
    return tras.KoopmanModel(tras.Monomials(2), "one_step", **({"strength": 0.01} | options))


def same(a, b):
    return (
        np.array_equal(a.koopman_matrix, b.koopman_matrix)
        and np.array_equal(a.x_scale_, b.x_scale_)
        and a.names_ == b.names_
        and a.pairs_ == b.pairs_
    )


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"chunk": CHUNK}, {}, {"chunk": CHUNK, "parts": 3}])
def test_the_fit_has_the_bits_of_the_file(path, dataset, options):
    assert same(model().fit(dataset, **options), model().fit(path, **options))
    assert same(model().fit([dataset, path], **options), model().fit([path, path], **options))


@pytest.mark.parametrize("opened", OPENED[::2], ids=["lazy", "chunks"])
@pytest.mark.slow
def test_workers_are_sent_a_name_or_a_graph(path, cluster, opened):
    with xarray.open_dataset(path, engine="h5netcdf", **opened) as dataset:
        spread = model().fit(dataset, chunk=CHUNK, parts=3, scheduler=cluster.scheduler_address)
        assert same(spread, model().fit(path, chunk=CHUNK, parts=3))
        assert len(pickle.dumps(RecordingDataset(dataset))) < 20_000 < path.stat().st_size / 5


def test_a_checkpoint_of_the_file_serves_the_dataset(path, dataset, tmp_path):
    first = model().fit(path, chunk=CHUNK, checkpoint=tmp_path / "a.npz")
    assert same(first, model().fit(dataset, chunk=CHUNK, checkpoint=tmp_path / "a.npz"))


def test_datasets_in_memory_and_of_parts_of_the_channels(path):
    recording = tras.Recording.read(path)
    assert same(model().fit(recording.to_xarray(), chunk=CHUNK), model().fit(path, chunk=CHUNK))
    shuffled = recording.to_xarray()[["force", "p", "row_size", "q"]]
    assert same(model().fit(shuffled, chunk=CHUNK), model().fit(path, chunk=CHUNK))
    part = RecordingDataset(recording.to_xarray()).select(states=["p", "q"], inputs=[])
    assert [piece.pairs for piece in part.pieces(3000)] == [3000, 1000, 1, 2599]
    assert all(
        np.array_equal(piece.x, x) for piece, (x, _) in zip(part.pieces(10_000), recording.select(states=["p", "q"]))
    )
    single = recording.to_xarray()
    assert model().fit(single.assign(q=single["q"].astype("float32")), chunk=CHUNK).pairs_ == recording.pairs


@pytest.mark.parametrize("opened", OPENED[::2], ids=["lazy", "chunks"])
def test_only_slices_are_in_memory(tmp_path, opened):
    rng = np.random.default_rng(0)
    tras.Recording(rng.normal(size=(1, 400_000, 2)), None, 0.1).write(tmp_path / "long.nc")
    with xarray.open_dataset(
        tmp_path / "long.nc", engine="h5netcdf", **(opened and {"chunks": {"sample": 20_000}})
    ) as dataset:
        source = RecordingDataset(dataset)
        tracemalloc.start()
        for piece in source.pieces(20_000):
            del piece
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 400_000 * 8 / 2  # half a channel


def test_a_bad_number_in_the_middle_is_named_and_the_checkpoint_kept(path, tmp_path):
    recording, checkpoint = tras.Recording.read(path), tmp_path / "a.npz"
    good, bad = recording.to_xarray(), recording.to_xarray().copy(deep=True)
    bad["p"][4003 + 1900] = np.nan
    readings = iter([good, bad, good])

    class Damaged:
        def __iter__(self):
            yield next(readings)

    with pytest.raises(
        UnreadableError,
        match="the dataset: channel 'p' is nan in trajectory 2 at sample 1900; repair .*is kept in .*a.npz",
    ):
        model().fit(source := Damaged(), chunk=CHUNK, checkpoint=checkpoint)
    assert same(model().fit(source, chunk=CHUNK, checkpoint=checkpoint), model().fit(good, chunk=CHUNK))


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda d: xarray.Dataset({"a": ("sample", [1.0])}), "its attribute 'format' is None, not 'tras recording 2'"),
        (lambda d: d.isel(sample=slice(10)), "row_size sums to 6603 but there are 10 samples"),
        (lambda d: d.drop_vars("row_size"), "'row_size'"),
        (
            lambda d: d.assign(q=d["q"].astype("timedelta64[ns]")),
            "'q' is timedelta64.ns. along sample, not numbers along sample",
        ),
        (
            lambda d: d.assign(q=("trajectory", [1.0, 2.0, 3.0], d["q"].attrs)),
            "'q' is float64 along trajectory, not numbers along sample",
        ),
    ],
)
def test_other_datasets_are_refused(path, change, words):
    with pytest.raises(
        ValueError,
        match=f"the dataset cannot be read as a recording .*{words}.*; open a file that Recording.write has written",
    ):
        model().fit(change(tras.Recording.read(path).to_xarray()), chunk=CHUNK)
