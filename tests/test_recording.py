"""Recordings: shapes, cutting, splitting, the file."""

import hashlib
from pathlib import Path

import numpy as np
import pandas
import pytest
import xarray
from conftest import FINITE, matrices
from hypothesis import given, settings
from hypothesis import strategies as st

import tras

R = tras.Recording
ZEROS = np.zeros((2, 5, 3))


def ragged(lengths=(5, 3, 9), n=2, m=1):
    rng = np.random.default_rng(0)
    return tras.Recording([rng.normal(size=(k, n)) for k in lengths], [rng.normal(size=(k, m)) for k in lengths], 0.1)


def same(a, b):
    return all(np.array_equal(x, y) and np.array_equal(u, v) for (x, u), (y, v) in zip(a, b, strict=True)) and (
        a.dt,
        a.state_names,
        a.input_names,
        a.state_units,
        a.input_units,
    ) == (b.dt, b.state_names, b.input_names, b.state_units, b.input_units)


@settings(max_examples=30, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=4),
    n=st.integers(1, 3),
    m=st.integers(0, 2),
    data=st.data(),
)
def test_file_round_trip_is_exact(lengths, n, m, data, tmp_path_factory):
    recording = tras.Recording(
        *([data.draw(matrices(k, columns)) for k in lengths] for columns in (n, m)), data.draw(st.floats(1e-6, 1e6)),
        state_names=[f"q{i}" for i in range(n)], state_units=["rad"] * n,
        attributes={"seed": 3, "who": "me", "limits": (1.0, 2.0)},
    )  # fmt: skip
    path = tmp_path_factory.mktemp("nc") / "a.nc"
    recording.write(path)
    again = tras.Recording.read(path)
    assert same(recording, again)
    assert again.attributes == {"seed": 3, "who": "me", "limits": [1.0, 2.0]}


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | FINITE | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(attributes=st.dictionaries(st.text(), VALUES, max_size=5))
def test_attributes_come_back_exactly(attributes, tmp_path_factory):
    path = tmp_path_factory.mktemp("nc") / "a.nc"
    R(ZEROS, dt=1, attributes=attributes).write(path)
    assert repr(R.read(path).attributes) == repr(attributes)  # repr tells True from 1 and 1 from 1.0


def test_attributes_of_every_kind(tmp_path):
    attributes = {"nothing": None, "yes": True, "one": [3], "nested": [[1, 2.5], ["a", []]], "seed": 7, "who": "me",
             "rate": 0.1, "format": "mine", "long": "x" * 200_000, "units": {"phi": "rad"}, "numpy": np.float32(0.5),
             "array": np.arange(3), "pair": (1, 2)}  # fmt: skip
    recording = R(ZEROS, dt=1, attributes=attributes)
    recording.write(tmp_path / "a.nc")
    expected = {**attributes, "numpy": 0.5, "array": [0, 1, 2], "pair": [1, 2]}
    assert repr(R.read(tmp_path / "a.nc").attributes) == repr(recording.attributes) == repr(expected)
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as dataset:
        assert (dataset.attrs["seed"], dataset.attrs["who"], dataset.attrs["rate"], dataset.attrs["yes"]) == (
            7,
            "me",
            0.1,
            1,
        )
    recording.attributes["later"] = {1, 2}
    with pytest.raises(ValueError, match="attribute 'later' holds .1, 2. .set."):
        recording.write(tmp_path / "b.nc")
    assert not (tmp_path / "b.nc").exists()


def test_the_numbers_are_our_own():
    states, inputs = np.zeros((2, 5, 3)), [np.zeros((5, 1)), np.zeros((5, 1))]
    recording = R(states, inputs, 1)
    states[:], inputs[0][:] = 7, 7
    assert not recording.states.any() and not recording.inputs.any()
    for part in (recording, recording.cut(3), recording[0], ragged().cut_all(2)):
        for x, u in part:
            assert not x.flags.writeable and not u.flags.writeable
    x, _ = next(iter(recording))
    with pytest.raises(ValueError, match="read-only"):
        x[0] = 1
    assert all(np.shares_memory(x, next(iter(recording))[0]) for x, _ in recording[0].cut(3))  # views, no copies


def test_a_single_sample_is_a_recording_without_pairs():
    assert R(np.zeros((2, 1, 3)), dt=1).pairs == 0


def test_whole_floats_count():
    assert len(R(np.zeros((1, 1001, 1)), dt=1).cut(501.0)) == 2


def test_same_content_same_bytes_and_nothing_else_left(tmp_path):
    digests = set()
    for name in ("a.nc", "b.nc"):
        ragged().write(tmp_path / name)
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.nc", "b.nc"]


def test_any_netcdf_reader_finds_names_and_units(tmp_path, experiment):
    experiment.write(tmp_path / "a.nc")
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as dataset:
        assert dataset["phidot"].attrs["units"] == "rad/s" and dataset["u_psi"].attrs["units"] == "N m"
        assert dataset["row_size"].sum() == dataset.sizes["sample"] == len(experiment) * 501
        assert np.array_equal(dataset["phi"][:501], experiment.states[0, :, 0])


def test_failed_write_leaves_nothing(tmp_path, monkeypatch):
    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="a.nc could not be written .No space left on device."):
        ragged().write(tmp_path / "a.nc")
    assert list(tmp_path.iterdir()) == []


@given(samples=st.integers(2, 60), piece=st.integers(2, 60))
def test_cut_shares_end_points_and_keeps_every_pair_it_can(samples, piece):
    recording = tras.Recording(np.arange(samples, dtype=float).reshape(1, -1, 1), dt=1.0)
    if piece > samples:
        with pytest.raises(ValueError, match="samples = "):
            recording.cut(piece)
        return
    pieces = recording.cut(piece)
    assert len(pieces) == (samples - 1) // (piece - 1)
    joined = np.concatenate([x[:-1, 0] for x, _ in pieces])
    assert np.array_equal(joined, np.arange(len(joined)))
    assert pieces.pairs == len(joined)


def test_split_is_a_partition_by_seed(experiment):
    first, second = experiment.split(0.8, seed=0)
    assert (len(first), len(second)) == (16, 4)
    starts = sorted([*first.states[:, 0, 0], *second.states[:, 0, 0]])
    assert np.array_equal(starts, np.sort(experiment.states[:, 0, 0]))
    assert same(first, experiment.split(0.8, seed=0)[0]) and not same(first, experiment.split(0.8, seed=1)[0])


def test_indexing_and_shapes():
    recording = ragged()
    assert isinstance(recording.states, list) and [len(x) for x in recording.states] == [5, 3, 9]
    assert recording.pairs == 14 and len(recording) == 3
    assert recording[1].states.shape == (1, 3, 2) and len(recording[[0, 2]]) == 2 and len(recording[-1:]) == 1
    assert np.array_equal(recording[-1].states[0], recording.states[2])
    assert not hasattr(recording, "shape")  # scikit-learn would index it as a matrix


def test_select_reorders_channels(experiment):
    part = experiment.select(states=["psi", "phi"], inputs=["u_psi"])
    assert part.state_names == ("psi", "phi") and part.input_units == ("N m",)
    assert np.array_equal(part.states, experiment.states[..., [2, 0]])


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: R(ZEROS), "dt is None"),
        (lambda: R(ZEROS, dt=-1), "dt is -1"),
        (lambda: R(np.zeros((5, 3)), dt=1), "give .trajectories, samples, channels."),
        (lambda: R([], dt=1), "no trajectory"),
        (lambda: R([np.zeros((0, 3))], dt=1), "trajectory 0 has no samples"),
        (lambda: R([np.zeros((4, 3)), np.zeros((4, 2))], dt=1), "trajectory 1 has 2 channels but the first has 3"),
        (lambda: R(ZEROS, np.zeros((1, 5, 1)), 1), "inputs has 1 trajectories but states has 2"),
        (lambda: R(ZEROS, np.zeros((2, 4, 1)), 1), "trajectory 0 has 5 samples of states but 4 of inputs"),
        (lambda: R([[["a"]]], dt=1), "cannot be read as numbers"),
        (lambda: R(ZEROS, dt=1, state_names=["a", "b"]), "state_names has 2 entries"),
        (lambda: R(ZEROS, dt=1, state_names=["a", "b", "a"]), "repeat a name"),
        (
            lambda: R(ZEROS, np.zeros((2, 5, 1)), 1, state_names=list("abc"), input_names=["c"]),
            "'c' stands for a state and for an input",
        ),
        (lambda: R(ZEROS, dt="0.01"), "dt is '0.01'"),
        (lambda: R(ZEROS, dt=True), "dt is True"),
        (lambda: R(ZEROS, dt=1, state_names="abc"), "state_names is the string 'abc'"),
        (lambda: R(ZEROS, dt=1, state_names=["a", 2, "c"]), "state_names holds 2; give strings"),
        (lambda: R(ZEROS, dt=1, state_units=["a", None, "c"]), "state_units holds None; give strings"),
        (lambda: R(ZEROS, dt=1, state_names=["a", "", "c"]), "state_names holds ''; give names that are not empty"),
        (lambda: R(ZEROS, dt=1, state_names=["a", "rad/s", "c"]), "state_names holds 'rad/s'; .* no '/'"),
        (
            lambda: R(ZEROS, ZEROS[..., :1], 1, input_names=["time"]),
            "input_names holds 'time'; .* none of trajectory, time, sample, row_size",
        ),
        (lambda: R(pandas.DataFrame({"phi": [1.0]}), dt=1), "states is a DataFrame; give a list of arrays"),
        (lambda: R([[1.0, 2.0], [3.0, 4.0]], dt=1), "states has shape .2, 2.; give .trajectories, samples, channels."),
        (
            lambda: R(np.ma.masked_equal(np.arange(10.0).reshape(1, 5, 2), 7), dt=1),
            "trajectory 0 is missing .masked. at sample 3 in column 1",
        ),
        (
            lambda: R([np.ma.masked_equal(np.arange(10.0).reshape(5, 2), 7)], dt=1),
            "trajectory 0 is missing .masked. at sample 3 in column 1",
        ),
        (lambda: R(ZEROS + 1j, dt=1), "states cannot be read as numbers .they are complex128."),
        (lambda: R(None, dt=1), "states cannot be read as numbers"),
        (
            lambda: R(ZEROS, dt=1, attributes={"when": np.datetime64("2020-01-01")}),
            "attribute 'when' holds .*, which JSON cannot hold",
        ),
        (lambda: R(ZEROS, dt=1, attributes={"gap": [1.0, np.nan]}), "attribute 'gap' holds nan"),
        (lambda: R(ZEROS, dt=1, attributes={3: 1}), "the key 3"),
        (lambda: R(ZEROS, dt=1, attributes=[1]), "attributes is .1."),
        (lambda: R(np.full((1, 5, 1), np.nan), dt=1), "channel 'x1' is nan in trajectory 0 at sample 0"),
        (lambda: R(ZEROS, dt=1).select(states=["theta"]), "no channel 'theta'"),
        (lambda: R(ZEROS, dt=1).split(0.1, 0), "leaves one side empty"),
        (lambda: R(ZEROS, dt=1).split(float("nan"), 0), "fraction = nan of 2"),
        (lambda: R(ZEROS, dt=1).split("half", 0), "fraction = half"),
        (lambda: R(ZEROS, dt=1).cut(1), "samples = 1"),
        (lambda: R(ZEROS, dt=1).cut(2.5), "samples = 2.5; give a whole number"),
        (lambda: R(ZEROS, dt=1).cut_all(float("nan")), "samples = nan"),
        (lambda: R(ZEROS, dt=1).delayed(-1), "delays = -1"),
        (lambda: R(ZEROS, dt=1).write("a.xlsx"), "ends in '.xlsx'"),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_bad_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="missing.nc does not exist"):
        R.read(tmp_path / "missing.nc")
    (tmp_path / "text.nc").write_text("not a recording")
    with pytest.raises(ValueError, match="text.nc cannot be read as a recording"):
        R.read(tmp_path / "text.nc")
    ragged().write(tmp_path / "whole.nc")
    whole = (tmp_path / "whole.nc").read_bytes()
    (tmp_path / "half.nc").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="half.nc cannot be read as a recording"):
        R.read(tmp_path / "half.nc")
    xarray.Dataset({"a": ("b", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match="attribute 'format' is None"):
        R.read(tmp_path / "other.nc")


@pytest.mark.parametrize("every", [1, 2, 3, 7])
@pytest.mark.parametrize("lead", [0, 1])
def test_means_of_inputs_do_the_work_of_the_inputs(every, lead):
    """What sums its input up is the same system at the longer step, for any input."""
    u = np.random.default_rng(0).normal(size=(50, 2))
    x = np.zeros((50, 2))
    for k in range(49):
        x[k + 1] = x[k] + u[k + lead]
    log = tras.Recording([x, x[:9]], [u, u[:9]], 0.1, attributes={"test_trajectories": [1]})
    fewer = log.decimated(every, lead)
    assert fewer.dt == pytest.approx(0.1 * every) and fewer.held_back() == [1]
    for (states, inputs), (full, _) in zip(fewer, log):
        assert np.array_equal(states, full[::every]) and inputs.shape == states.shape
        assert np.allclose(np.diff(states, axis=0), every * inputs[lead : len(inputs) - 1 + lead])


@pytest.mark.parametrize("options", [{"every": 0}, {"every": 2, "lead": 2}, {"every": 1.5}])
def test_steps_that_are_none_are_refused(options, experiment):
    with pytest.raises(ValueError, match="every"):
        experiment.decimated(**options)
