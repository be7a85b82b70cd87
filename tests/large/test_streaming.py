"""Fits of data that are read in pieces: the model of a fit in memory, no pair lost or invented, interruptions."""

import itertools
import json
import tracemalloc

import h5py
import numpy as np
import pytest
from conftest import at
from hypothesis import given, settings
from hypothesis import strategies as st

import tras
from tras import fitting, koopman
from tras.large import streaming
from tras.large.checkpoint import CheckpointError, Log
from tras.large.slices import Piece, RecordingFile, Stream, UnreadableError, without
from tras.solver.least_squares import StreamingLeastSquares

CHUNK = 5000  # more than a panel of the solver
LENGTHS = [7001, 2500, 9000, 3, 1801, 6200]  # samples
LABELS = ["phi", "phidot", "psi", "psidot", "u_phi", "u_psi"]


@pytest.fixture(scope="module")
def long_recording(parameters):
    """Trajectories of unequal lengths, one of them longer than a chunk; torques as inputs."""
    reference = tras.multisine(sum(LENGTHS) * 0.01, 0.01, [0.5, 1.2], [1.0, 2.5], np.random.default_rng(1))
    log = tras.simulate_closed_loop(reference, 0.01, parameters).select(inputs=["u_phi", "u_psi"])
    ends = np.cumsum(LENGTHS)
    x, u = (
        np.ascontiguousarray(v[0, : ends[-1]]) for v in (log.states, log.inputs)
    )  # as they come from a file: sums depend on the layout
    labels = {name: getattr(log, name) for name in ("state_names", "input_names", "state_units", "input_units")}
    return tras.Recording(np.split(x, ends[:-1]), np.split(u, ends[:-1]), 0.01, **labels)


@pytest.fixture(scope="module")
def path(long_recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "long.nc"
    long_recording.write(path)
    return path


def plain(predictor="one_step", delays=0, **options):
    return tras.KoopmanModel(tras.Monomials(2), predictor, delays, **({"strength": 1e-3} | options))


# --------------------------------------------------------------------------------------------------------------- pieces


@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 30), min_size=1, max_size=5), size=st.integers(1, 12), delays=st.integers(0, 3),
    length=st.integers(1, 4), data=st.data(),
)  # fmt: skip
def test_pieces_hold_every_pair_once_in_order(lengths, size, delays, length, data):
    """Samples are numbered, so a pair that crosses from one trajectory into the next, or is lost, would be seen."""
    lengths = [delays + n for n in lengths]
    marks = [1000.0 * i + np.arange(n) for i, n in enumerate(lengths)]
    recording = tras.Recording([m[:, None] for m in marks], [-m[:, None] for m in marks], 1.0)
    wanted = [tuple(m[k : k + delays + 2]) for m in marks for k in range(len(m) - delays - 1)]
    stream = Stream(recording, size, delays + 1)
    pieces = list(stream.pieces())
    assert max(piece.pairs for piece in pieces) <= size
    assert [pair for piece in pieces for pair in pairs_of(piece, delays)] == wanted
    # The same, when some windows are taken out of each piece: apart and together they are what there was.
    apart, left = [], []
    for piece in pieces:
        starts = (
            data.draw(st.lists(st.integers(0, max(0, piece.pairs // length - 1)), unique=True))
            if piece.pairs >= length
            else []
        )
        starts = sorted(length * k for k in starts)
        apart += [tuple(piece.x[s + k : s + k + delays + 2, 0]) for s in starts for k in range(length)]
        left += [pair for part in without(piece, starts, length, delays + 1) for pair in pairs_of(part, delays)]
    assert sorted(apart + left) == wanted


def pairs_of(piece, delays):
    assert np.array_equal(piece.x, -piece.u) and len(piece.x) == piece.pairs + delays + 1
    return [tuple(piece.x[k : k + delays + 2, 0]) for k in range(piece.pairs)]


def test_a_file_in_pieces_is_what_was_written(long_recording, path):
    file = tras.open_recording(path)
    assert (len(file), file.pairs, file.dt) == (len(LENGTHS), long_recording.pairs, 0.01) and "phi, phidot" in repr(
        file
    )
    assert (file.state_units, file.input_units) == (long_recording.state_units, long_recording.input_units)
    for source in (file, file.select(states=["psi", "phi"], inputs=["u_psi"])):
        memory = long_recording.select(states=source.state_names, inputs=source.input_names)
        pieces = list(source.pieces(1000))
        assert len(pieces) == sum(-(-(n - 1) // 1000) for n in LENGTHS)
        for piece, same in zip(pieces, Stream(memory, 1000, 1).pieces(), strict=True):
            assert np.array_equal(piece.x, same.x) and np.array_equal(piece.u, same.u)


@pytest.mark.parametrize("counts", [[500] * 300, [50_000_000], [100, 7000, 3, 501, 90_000]])
def test_the_sample_is_spread_evenly_and_bounded(counts):
    windows = streaming._Windows(500, 1)
    numbers = np.arange(90_001.0)[:, None]
    seen = 0
    for number, count in enumerate(
        pairs for total in counts for pairs in [90_000] * (total // 90_000) + [total % 90_000]
    ):
        windows.look(number, Piece(seen + numbers[: count + 1], -numbers[: count + 1], count))
        seen += count
    starts = np.array([piece.x[0, 0] for _, _, piece in windows.windows.values()])
    assert windows.seen == sum(counts) and 1 <= len(starts) <= 200 and (seen < 10**6 or len(starts) >= 100)
    assert 500 * len(starts) <= seen / 5 + 500 and np.all(np.diff(starts) >= 500)
    if len(counts) != 5:
        assert np.diff(starts).max() <= 1.5 * np.median(np.diff(starts)) and seen - starts[-1] <= 2 * np.median(
            np.diff(starts)
        )
    assert all(len(piece.x) == 501 for _, _, piece in windows.windows.values())


# ------------------------------------------------------------------------------------------------------- the same model


@pytest.mark.parametrize(
    "predictor, delays, dictionary",
    [
        ("vector_field", 0, tras.Monomials(3)),
        ("one_step", 1, tras.Monomials(1)),
        ("lifted_linear", 0, tras.Monomials(2)),
        ("one_step", 0, tras.Fourier(1)),
    ],
)
@pytest.mark.slow
def test_streamed_and_in_memory_agree_to_the_bit(long_recording, path, monkeypatch, predictor, delays, dictionary):
    """Chunks end at the same pairs as the stretches dealt out in memory; with a given strength nothing is held out."""
    monkeypatch.setattr(koopman, "DEALT", CHUNK)
    recording = long_recording[[0, 1, 2, 4, 5]] if delays else long_recording
    source = recording if delays else path
    memory = tras.KoopmanModel(dictionary, predictor, delays, strength=0.01).fit(recording)
    for given_source in (source, lambda: (recording[i] for i in range(len(recording)))):
        streamed = tras.KoopmanModel(dictionary, predictor, delays, strength=0.01).fit(given_source, chunk=CHUNK)
        assert np.array_equal(streamed.koopman_matrix, memory.koopman_matrix)
        assert streamed.pairs_ == memory.pairs_ == recording.pairs - delays * len(recording)
        assert streamed.condition_number == memory.condition_number
        if memory.hull_ is not None:
            assert np.array_equal(streamed.hull_.low, memory.hull_.low) and np.array_equal(
                streamed.outward_, memory.outward_
            )
        if predictor == "vector_field":
            assert np.array_equal(streamed.W_, memory.W_) and streamed.substeps_ == memory.substeps_
        assert streamed.score(recording[1]) == memory.score(recording[1])


@pytest.mark.parametrize("chunk", [300, 4000, 20_000])
@pytest.mark.slow
def test_other_chunks_agree_but_for_rounding(long_recording, path, chunk):
    """The order of the rows is another one, so sums are rounded otherwise."""
    memory, streamed = plain().fit(long_recording), plain().fit(path, chunk=chunk)
    assert np.abs(streamed.koopman_matrix - memory.koopman_matrix).max() <= 1e-12
    assert streamed.pairs_ == memory.pairs_


@pytest.mark.slow
def test_what_is_smaller_than_a_chunk_is_fitted_in_memory(long_recording, path):
    """... also with its own hold-out and strength: the same bits, whatever kind of data it was."""
    memory = plain(strength="auto").fit(long_recording)
    for source in (path, str(path), tras.open_recording(path), iter([long_recording[:2], long_recording[2:]]), [path]):
        again = plain(strength="auto").fit(source)
        assert np.array_equal(again.koopman_matrix, memory.koopman_matrix) and again.errors_ == memory.errors_


def test_the_strength_is_chosen_on_windows_that_are_not_fitted(long_recording, path, monkeypatch):
    """Rows of the solver at the choice and held-out windows add up to all pairs; the choice is that in memory."""
    seen = {}

    def spy(self, scaled, held):
        seen.update(rows=self._fit.solver.rows, held=held.pairs, lengths=set(held.lengths))
        return choose(self, scaled, held)

    choose = tras.KoopmanModel._choose_strength
    monkeypatch.setattr(tras.KoopmanModel, "_choose_strength", spy)
    streamed = plain("vector_field", strength="auto").fit(path, chunk=CHUNK)
    assert seen["rows"] + seen["held"] == streamed.pairs_ == long_recording.pairs
    assert len(seen["lengths"]) == 1 and 0.05 < seen["held"] / long_recording.pairs <= 0.21
    assert streamed.errors_[streamed.strength_] == min(streamed.errors_.values())
    memory = plain("vector_field", strength=streamed.strength_).fit(long_recording)
    assert np.abs(streamed.koopman_matrix - memory.koopman_matrix).max() <= 1e-12


def test_several_files_and_recordings_are_one_stream(long_recording, path, tmp_path, monkeypatch):
    monkeypatch.setattr(koopman, "DEALT", CHUNK)
    long_recording[3:].write(tmp_path / "b.nc")
    whole = plain().fit(path, chunk=CHUNK)
    parts = plain().fit([long_recording[:2], long_recording[2], tmp_path / "b.nc"], chunk=CHUNK)
    assert np.array_equal(parts.koopman_matrix, whole.koopman_matrix)


def test_one_huge_trajectory(long_recording):
    longest = long_recording[2]
    assert plain().fit(longest, chunk=700).pairs_ == longest.pairs == 8999


def test_ranges_instead_of_a_first_reading(long_recording):
    readings = []

    def source():
        readings.append(1)
        yield from (long_recording[i] for i in range(len(long_recording)))

    plain().fit(source, chunk=CHUNK)
    assert len(readings) == 2
    low, high = (np.array([f(x, axis=0) for x, _ in long_recording]) for f in (np.min, np.max))
    ranges = dict(zip(long_recording.state_names, zip(low.min(axis=0), high.max(axis=0)))) | {
        "u_phi": (-2, 1),
        "u_psi": (-1, 3),
    }
    model = plain().fit(source, ranges=ranges, chunk=CHUNK)
    assert np.array_equal(model.u_scale_, [1.5, 2]) and np.array_equal(model.u_offset_, [-0.5, 1])
    # In physical units the model is the same, whatever the scales.
    memory = plain(strength=0).fit(long_recording)
    given_ranges = plain(strength=0).fit(source, ranges=ranges, chunk=CHUNK)
    assert len(readings) == 4
    assert np.allclose(given_ranges.predict(long_recording[1]), memory.predict(long_recording[1]), atol=1e-8)
    assert np.array_equal(plain().fit(long_recording, ranges=ranges).x_scale_, given_ranges.x_scale_)


def test_an_iterator_is_read_once_and_its_first_chunk_decides_the_scales(long_recording):
    first = long_recording[0]
    model = plain().fit((long_recording[i] for i in range(len(long_recording))), chunk=CHUNK)
    assert np.array_equal(model.x_scale_, np.ptp(first.states[0][: CHUNK + 1], axis=0) / 2)
    assert model.pairs_ == long_recording.pairs


# -------------------------------------------------------------------------------------------- interrupted, gone on with


class Cut:
    """A re-iterable source that fails in its recording ``at`` for the reading number ``when``."""

    def __init__(self, recording, at, failure, when=2):
        self.recording, self.at, self.failure, self.when, self.readings = recording, at, failure, when, 0

    def __iter__(self):
        self.readings += 1
        parts = self.recording.cut_all(801)
        for k in range(len(parts)):
            if k == self.at and self.readings == self.when:
                raise self.failure
            yield parts[k]


@pytest.mark.parametrize("strength", ["auto", 0.01])
@pytest.mark.parametrize("failure", [KeyboardInterrupt(), UnreadableError("log.nc: gone.")])
@pytest.mark.slow
def test_interrupted_and_resumed_has_the_same_bits(long_recording, tmp_path, failure, strength):
    model = plain("vector_field" if strength == "auto" else "one_step", strength=strength)
    source = Cut(long_recording, 28, failure)
    undisturbed = plain("vector_field" if strength == "auto" else "one_step", strength=strength).fit(
        Cut(long_recording, None, None), chunk=2000
    )
    checkpoint = tmp_path / "fit.npz"
    with pytest.raises(type(failure)):
        model.fit(source, chunk=2000, checkpoint=checkpoint)
    with np.load(checkpoint) as file:
        header = json.loads(str(file["header"]))
        assert 0 < header["done"] < 28 and not header["finished"]
    for _ in range(2):  # gone on with, then once more from the finished one
        again = plain("vector_field" if strength == "auto" else "one_step", strength=strength).fit(
            source, chunk=2000, checkpoint=checkpoint
        )
        for name in ("koopman_matrix", "outward_", "condition_number", "strength_", "pairs_"):
            assert np.array_equal(getattr(again, name), getattr(undisturbed, name)), name
    assert source.readings == 4  # survey, fit, and one each time it went on
    assert [p.name for p in tmp_path.iterdir()] == ["fit.npz"]


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), MemoryError("no room.")])
@pytest.mark.parametrize("at", [2, 4, 5])
def test_interrupted_in_the_middle_of_a_chunk_goes_on_from_its_beginning(
    long_recording, tmp_path, monkeypatch, failure, at
):
    """Two panels a chunk; the first chunk that is half absorbed is not counted, and none is lost that was."""
    undisturbed = plain(strength=0.01).fit(lambda: long_recording.cut_all(801), chunk=9000)
    calls = []

    def add(self, products, rows, original=StreamingLeastSquares._add):
        original(self, products, rows)
        calls.append(1)
        if len(calls) == at:
            raise failure

    monkeypatch.setattr(StreamingLeastSquares, "_add", add)
    checkpoint = tmp_path / "fit.npz"
    with pytest.raises(type(failure)):
        plain(strength=0.01).fit(lambda: long_recording.cut_all(801), chunk=9000, checkpoint=checkpoint)
    monkeypatch.undo()
    assert checkpoint.exists() == (at > 2)
    if at > 2:
        with np.load(checkpoint) as file:
            done = json.loads(str(file["header"]))["done"]
            assert done > 0 and file["solver.rows"] == sum(
                len(x) - 1 for x, _ in itertools.islice(long_recording.cut_all(801), done)
            )
    again = plain(strength=0.01).fit(lambda: long_recording.cut_all(801), chunk=9000, checkpoint=checkpoint)
    for name in ("koopman_matrix", "outward_", "condition_number", "pairs_"):
        assert np.array_equal(getattr(again, name), getattr(undisturbed, name)), name
    for edge in ("low", "high", "centre", "axes"):
        assert np.array_equal(getattr(again.hull_, edge), getattr(undisturbed.hull_, edge)), edge


@pytest.mark.slow
def test_checkpoints_on_the_way_change_no_bit(long_recording, path, tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(Log, "write", lambda log, write=Log.write: (written.append(1), write(log)))
    often = plain(strength="auto").fit(path, chunk=4100, checkpoint=tmp_path / "a.npz", every=0)
    assert len(written) >= 6
    seldom = plain(strength="auto").fit(path, chunk=4100, checkpoint=tmp_path / "b.npz", every=1e9)
    assert np.array_equal(often.koopman_matrix, seldom.koopman_matrix)


def test_a_failure_after_the_pass_loses_nothing(path, tmp_path, monkeypatch):
    """Another strength, or another method of regularization, goes on from the finished checkpoint."""
    plain(strength=1.0).fit(path, chunk=CHUNK, checkpoint=tmp_path / "a.npz")
    absorbed = []
    monkeypatch.setattr(fitting.Fit, "absorb", lambda self, rows, threads=None: absorbed.extend(rows))
    model = plain(strength=0.0, regularization=None).fit(path, chunk=CHUNK, checkpoint=tmp_path / "a.npz")
    monkeypatch.undo()
    assert not absorbed
    assert np.array_equal(
        model.koopman_matrix, plain(strength=0.0, regularization=None).fit(path, chunk=CHUNK).koopman_matrix
    )


@pytest.fixture
def checkpoint(long_recording, tmp_path):
    path = tmp_path / "fit.npz"
    with pytest.raises(KeyboardInterrupt):
        plain().fit(Cut(long_recording, 25, KeyboardInterrupt()), chunk=CHUNK, checkpoint=path)
    return path


def shifted(recording):
    return tras.Recording(
        [x + 1e-9 for x, _ in recording], [u for _, u in recording], 0.01,
        state_names=recording.state_names, input_names=recording.input_names,
    )  # fmt: skip


@pytest.mark.parametrize(
    "change, words",
    [
        (
            lambda r: (tras.KoopmanModel(tras.Monomials(3), "one_step", strength=1), r, CHUNK),
            "another model: its dictionary is 'Monomials.degree=2.', here it is 'Monomials.degree=3.'",
        ),
        (lambda r: (plain(delays=1), r, CHUNK), "another model: its delays is 0, here it is 1"),
        (lambda r: (plain("lifted_linear"), r, CHUNK), "another model: its predictor"),
        (lambda r: (plain(strength="auto"), r, CHUNK), "another model: its strength is 'given', here it is 'auto'"),
        (lambda r: (plain(), r, 6000), "a fit with another option: its chunk is 5000, here it is 6000"),
        (lambda r: (plain(), r.select(inputs=["u_phi"]), CHUNK), "other data .sampling time and channels were"),
        (lambda r: (plain(), shifted(r), CHUNK), "other data .numbers have changed"),
        (lambda r: (plain(), r[:1], CHUNK), "other data .there are fewer of them now"),
    ],
)  # fmt: skip
def test_a_checkpoint_of_something_else_is_refused(long_recording, checkpoint, change, words):
    before = checkpoint.read_bytes()
    model, recording, chunk = change(long_recording)
    with pytest.raises(CheckpointError, match=f"checkpoint .*fit.npz belongs to {words}.*or delete it to begin anew"):
        model.fit(Cut(recording, None, None), chunk=chunk, checkpoint=checkpoint)
    assert checkpoint.read_bytes() == before


def test_more_data_behind_a_finished_checkpoint_are_refused(long_recording, tmp_path):
    plain().fit(Cut(long_recording[:3], None, None), chunk=CHUNK, checkpoint=tmp_path / "a.npz")
    with pytest.raises(CheckpointError, match="other data .there are more of them now"):
        plain().fit(Cut(long_recording, None, None), chunk=CHUNK, checkpoint=tmp_path / "a.npz")


@pytest.mark.parametrize("content", [b"", b"hello", "half"])
def test_a_damaged_checkpoint_is_refused(long_recording, checkpoint, content):
    checkpoint.write_bytes(checkpoint.read_bytes()[:2000] if content == "half" else content)
    with pytest.raises(CheckpointError, match="checkpoint .*fit.npz cannot be read .*; delete it to begin anew"):
        plain().fit(Cut(long_recording, None, None), chunk=CHUNK, checkpoint=checkpoint)


# ------------------------------------------------------------------------------------------------------------- bad data


@pytest.mark.slow
def test_a_corrupt_piece_is_named_and_nothing_is_lost(long_recording, path, tmp_path):
    """One compressed chunk of a channel is damaged after the first reading; repaired, the fit has the same bits."""
    packed, checkpoint = tmp_path / "packed.nc", tmp_path / "fit.npz"
    repack(path, packed)
    good = packed.read_bytes()
    with h5py.File(packed) as file:
        chunk = file["psi"].id.get_chunk_info_by_coord((18_000,))
        assert chunk.chunk_offset <= (18_000,)
    bad = bytearray(good)
    bad[chunk.byte_offset + 20 : chunk.byte_offset + 60] = bytes(40)

    class Damaged:
        readings = 0

        def __iter__(self):
            Damaged.readings += 1
            packed.write_bytes(bad if Damaged.readings == 2 else good)
            yield packed

    where = "packed.nc: channel 'psi' of trajectory 2 cannot be read between its samples 5000 and 8999"
    words = f"{where} .*What was fitted so far is kept in .*fit.npz"
    with pytest.raises(UnreadableError, match=words):
        plain().fit(Damaged(), chunk=CHUNK, checkpoint=checkpoint)
    resumed = plain().fit(Damaged(), chunk=CHUNK, checkpoint=checkpoint)
    assert np.array_equal(resumed.koopman_matrix, plain().fit(path, chunk=CHUNK).koopman_matrix)
    packed.write_bytes(bad)
    with pytest.raises(UnreadableError, match="trajectory 2 cannot be read"):
        plain().fit(packed, chunk=CHUNK)


def repack(source, target):
    """A copy with compressed channels."""
    import xarray

    with xarray.open_dataset(source, engine="h5netcdf", decode_times=False) as data:
        data.to_netcdf(
            target,
            engine="h5netcdf",
            encoding={name: {"zlib": True, "chunksizes": (1000,)} for name in ("psi", "u_psi")},
        )


def test_nan_in_a_file_is_named(path, tmp_path):
    bad = tmp_path / "bad.nc"
    bad.write_bytes(path.read_bytes())
    with h5py.File(bad, "r+") as file:
        file["psidot"][7001 + 2500 + 5600] = np.nan
    for chunk in (10**6, CHUNK):
        with pytest.raises(
            ValueError, match="bad.nc: channel 'psidot' is nan in trajectory 2 at sample 5600; repair it or cut"
        ):
            plain().fit(bad, chunk=chunk)


def one_of(recording, k):
    return iter([recording[:k], recording[k:]])


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda r, p: plain().fit("nowhere.nc"), "nowhere.nc does not exist"),
        (lambda r, p: plain().fit(p.with_suffix(".txt")), "ends in '.txt'"),
        (lambda r, p: plain().fit(iter([])), "recording is empty"),
        (lambda r, p: plain().fit(iter([r, 3])), "recording 1 is int; give a tras.Recording, the path of a file"),
        (lambda r, p: plain().fit([p, r.select(inputs=["u_phi"])]), "recording 1 has input_names"),
        (lambda r, p: plain().fit(r, chunk=0), "chunk = 0; give the number"),
        (lambda r, p: plain().fit(p, chunk=CHUNK, ranges={"phi": (0, 1)}), "holds no pair .* for the channel 'phidot'"),
        (lambda r, p: plain().fit(p, ranges=dict.fromkeys(LABELS, (1, 0))), r"has \(1, 0\) for the channel 'phi'"),
        (lambda r, p: plain("vector_field", field="least_squares").fit(p, chunk=CHUNK), "which needs all data"),
        (lambda r, p: plain().fit(p, chunk=CHUNK, checkpoint="a.txt"), "checkpoint a.txt ends in '.txt'; use"),
        (lambda r, p: plain(delays=3).fit(p, chunk=CHUNK), "trajectory 3 has 3 samples, too few for 3 delays"),
        (lambda r, p: RecordingFile(p.parent / "none.nc"), "none.nc does not exist"),
    ],
)  # fmt: skip
def test_mistakes_are_named(long_recording, path, call, words):
    with pytest.raises((ValueError, FileNotFoundError), match=words):
        call(long_recording, path)


def test_no_recording_at_all(tmp_path):
    (tmp_path / "text.nc").write_text("hello")
    with pytest.raises(ValueError, match="text.nc cannot be read as a recording"):
        tras.open_recording(tmp_path / "text.nc")
    import xarray

    xarray.Dataset({"a": ("b", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match="its attribute 'format' is None"):
        tras.open_recording(tmp_path / "other.nc")


def test_a_source_that_gives_other_data_the_second_time(long_recording):
    class Forgetful:
        left = len(LENGTHS) + 1

        def __iter__(self):
            Forgetful.left -= 1
            return iter([long_recording[:5], long_recording[0]][: 1 + (Forgetful.left > 5)])

    with pytest.raises(ValueError, match="recording gave .* snapshot pairs when it was read first, and .* now"):
        plain().fit(Forgetful(), chunk=CHUNK)


# --------------------------------------------------------------------------------------------------------------- memory


@pytest.mark.slow
def test_memory_does_not_grow_with_the_data():
    rng = np.random.default_rng(0)
    block = rng.uniform(-1, 1, (2001, 3))

    def peak(count):
        def source():
            for k in range(count):
                yield tras.Recording([block[:, :2] * (1 + k % 7)], [block[:, 2:]], 0.1)

        tracemalloc.start()
        model = tras.KoopmanModel(tras.Monomials(3), "one_step").fit(source, chunk=10_000)
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert model.pairs_ == 2000 * count
        return top

    peak(10)  # what is imported or cached on first use does not count
    assert peak(480) <= 1.1 * peak(240)  # up to 200 windows of a sample in both


# ------------------------------------------------------------------------------------------- checkpoints that were made


def altered(key, change):
    def alter(header, arrays):
        where = header if key in header else arrays
        where[key] = change(where.get(key))

    return alter


MADE = {
    "NaN in the products": (altered("solver.gram", at(0, np.nan)), "its gram holds a number that is not finite"),
    "other products": (altered("solver.gram", lambda a: a[1:]), "its gram has the shape"),
    "a negative square": (altered("solver.gram", at(0, -9.0)), "its gram does not hold products of rows"),
    "another basis": (altered("solver.T", lambda a: a * 0), "its T is no basis"),
    "a scale of zero": (altered("solver.scale", at(0, 0.0)), "its scale holds a number"),
    "bits without end": (altered("solver.bits", lambda a: np.array(10**9)), "its bits is 1000000000, not a whole"),
    "no rows": (altered("solver.rows", lambda a: np.array(0)), "its rows holds a number"),
    "rows that are none": (altered("solver.rows", lambda a: np.array(1.5)), "its rows is 1.5, not a whole number"),
    "waiting rows": (altered("solver.waiting_targets", lambda a: np.zeros((1, 1))), "its waiting_targets has the"),
    "more than rows": (altered("solver.os", lambda a: np.ones(1)), "it holds arrays that are no part of a fit"),
    "more": (altered("os", lambda a: np.ones(1)), "it holds arrays that are no part of a fit"),
    "a hull": (altered("hull.low", at(0, np.nan)), "its hull.low holds a number"),
    "half a hull": (altered("hull.axes", lambda a: a[:1]), "its hull.axes has the shape"),
    "ranges": (altered("survey.ranges", lambda a: a[:, ::-1]), "its survey.ranges is not .lowest, highest."),
    "NaN in the sample": (altered("survey.states", at(0, np.nan)), "its survey.states holds a number"),
    "windows": (altered("survey.where", lambda a: a.astype(float)), "its windows are not those of a survey"),
    "long windows": (altered("survey.length", lambda a: np.array(10**12)), "its windows are not those of a survey"),
    "the survey": (altered("survey.os", lambda a: np.ones(1)), "it lacks arrays of the survey, or has more"),
    "the count": (altered("done", lambda a: -1), "its done is -1; give a whole number"),
    "the sum": (altered("crc", lambda a: 2**40), "its crc is 1099511627776"),
    "the total": (altered("total", lambda a: "all"), "its total is 'all'"),
    "the labels": (altered("labels", lambda a: [0.01, "x"]), "its labels are no sampling time and names"),
    "the end": (altered("finished", lambda a: 3), "its header is of another kind"),
    "the model": (altered("model", lambda a: []), "its header is of another kind"),
}  # fmt: skip


@pytest.mark.parametrize("what", MADE)
def test_checkpoints_out_of_range_are_refused(what, long_recording, checkpoint):
    alter, words = MADE[what]
    with np.load(checkpoint) as file:
        arrays = dict(file)
    header = json.loads(str(arrays.pop("header")))
    alter(header, arrays)
    np.savez(checkpoint, header=np.array(json.dumps(header)), **arrays)
    with pytest.raises(CheckpointError, match=f"checkpoint .*fit.npz cannot be read .{words}") as caught:
        plain().fit(Cut(long_recording, None, None), chunk=CHUNK, checkpoint=checkpoint)
    assert "\n" not in str(caught.value)


def test_a_checkpoint_of_other_rows_is_refused(long_recording, checkpoint, tmp_path):
    """Sound, of the same name for the model, but with the rows of another one."""
    other = tmp_path / "other.npz"
    with pytest.raises(KeyboardInterrupt):
        linear = tras.KoopmanModel(tras.Monomials(1), "one_step", strength=1e-3)
        linear.fit(Cut(long_recording, 25, KeyboardInterrupt()), chunk=CHUNK, checkpoint=other)
    with np.load(checkpoint) as mine, np.load(other) as theirs:
        arrays = dict(theirs) | {"header": mine["header"]}
    np.savez(checkpoint, **arrays)
    with pytest.raises(CheckpointError, match="its rows are not those of this model"):
        plain().fit(Cut(long_recording, None, None), chunk=CHUNK, checkpoint=checkpoint)


def test_a_checkpoint_that_promises_other_data(long_recording, checkpoint):
    with np.load(checkpoint) as file:
        arrays = dict(file)
    header = json.loads(str(arrays.pop("header"))) | {"total": 10**12}
    np.savez(checkpoint, header=np.array(json.dumps(header)), **arrays)
    with pytest.raises(CheckpointError, match="other data .there were 1000000000000 snapshot pairs, now there are"):
        plain().fit(Cut(long_recording, None, None), chunk=CHUNK, checkpoint=checkpoint)
