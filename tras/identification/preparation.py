"""A recording of a rig made ready for its identification, each step once.

`prepare` leaves idle channels out, holds a test back and chooses the length of the pieces; `Treatments` holds one part of
the recording as measured and smoothed. Each step that leaves something out returns sentences that say so.
"""

from typing import NamedTuple

import numpy as np

from tras.identification.noise import noise_level
from tras.identification.smoothing import smooth
from tras.recording import Recording, join

LONGEST, SHORTEST = 501, 26  # samples of a piece, both ends included
_FEWEST_TRIALS = 5  # from which on whole trials are held back for the test
_CHUNK = 2001  # samples that are smoothed at once
_FINE = 2e-4  # noise, as a fraction of the range, that is not worth smoothing away


class Prepared(NamedTuple):
    """A recording made ready; see `prepare`."""

    recording: Recording  # without idle channels
    train: Recording  # uncut, as is the test
    test: Recording
    pairs: list  # (position, velocity), names
    memory: int  # samples
    samples: int  # of a piece
    remarks: dict  # "idle", "partition", "pairs" -> sentences


def prepare(recording):
    """Everything that is decided about a recording before any model.

    Raises
    ------
    ValueError
        If no state moves, or there is too little for a test.
    """
    recording, idle = without_idle_channels(recording)
    train, test, partition_remark = partition(recording)
    lag = memory(train)
    samples, length_remark = piece_length(train, lag)
    pairs = velocity_pairs(train, lag)
    pair_remarks = [f"the velocity of {position} is {velocity}, by their numbers" for position, velocity in pairs]
    remarks = {"idle": idle, "partition": [partition_remark, length_remark], "pairs": pair_remarks}
    return Prepared(recording, train, test, pairs, lag, samples, remarks)


class Treatments:
    """Chunks of a recording "as measured" and "smoothed", made once, when they are first used.

    Parameters
    ----------
    recording : Recording
        Uncut.
    pairs : list of (str, str)
        Names of positions and their velocities, for the smoother.
    most : int
        Snapshot pairs, about; of a longer recording some chunks are taken, spread evenly.
    """

    def __init__(self, recording, pairs, most):
        self.recording, self.pairs = recording, pairs
        self._chunks = {"as measured": thinned(recording.cut_all(_CHUNK), most)}

    def at_most(self, most):
        """These treatments, or new ones of fewer chunks."""
        return self if self._chunks["as measured"].pairs <= most else Treatments(self.recording, self.pairs, most)

    def pieces(self, name, samples, fewest, most=np.inf):
        """Pieces under one treatment, cut as by `in_pieces` and `thinned`: the same ones under each treatment."""
        if name not in self._chunks:
            self._chunks[name] = smoothed(self._chunks["as measured"], self.pairs)
        return thinned(in_pieces(self._chunks[name], samples, fewest), most)


def without_idle_channels(recording):
    """The recording without channels that are constant, or linear combinations of those before them.

    Returns
    -------
    recording : Recording
    remarks : list of str

    Raises
    ------
    ValueError
        If no state moves.
    """
    recording = join(recording)
    x, u = (np.concatenate(part) for part in zip(*recording))
    names, table = (*recording.state_names, *recording.input_names), np.hstack([x, u])
    active, remarks, basis = [], [], np.ones((len(table), 1)) / np.sqrt(len(table))
    for name, column in zip(names, table.T):
        size = np.abs(column).max()
        rest = column - column.mean()
        spread = np.linalg.norm(rest)
        if np.ptp(column) <= 1e-12 * size or spread == 0:
            remarks.append(f"{name} is constant ({column[0]:.6g}) and was left out")
            continue
        for _ in range(2):  # twice is enough (Kahan and Parlett)
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) <= 1e-7 * spread:
            remarks.append(f"{name} is a linear combination of {_and(active)} at every sample and was left out")
            continue
        active.append(name)
        if basis.shape[1] <= 200:
            basis = np.hstack([basis, (rest / np.linalg.norm(rest))[:, None]])
    states = [name for name in recording.state_names if name in active]
    if not states:
        raise ValueError(
            f"no state moves: {'; '.join(remarks)}. Give others as states, or record while something happens."
        )
    return recording.select(states=states, inputs=[name for name in recording.input_names if name in active]), remarks


def velocity_pairs(recording, lag):
    """Pairs (position, velocity) of states' names, by their numbers: the one is the other's integral.

    Over a third of the `memory` the slope must be one within 5 %, so the velocity's unit is the position's per second.
    """
    # Long against noise, short against the motion.
    span = int(np.clip(lag // 3, 10, max(10, int(recording.lengths.max()) // 4)))
    stretches = [x for x, _ in recording if len(x) > span + 1]
    if not stretches or recording.n < 2:
        return []
    every = max(1, sum(map(len, stretches)) // 50_000)
    changes, integrals = [], []
    for x in stretches:
        area = np.cumsum((x[1:] + x[:-1]) / 2, axis=0) * recording.dt
        area = np.vstack([np.zeros(x.shape[1]), area])
        changes.append((x[span:] - x[:-span])[::every])
        integrals.append((area[span:] - area[:-span])[::every])
    changes, integrals = np.concatenate(changes), np.concatenate(integrals)
    changes, integrals = changes - changes.mean(axis=0), integrals - integrals.mean(axis=0)
    power = np.sum(integrals**2, axis=0)
    scores = []
    for i in range(recording.n):
        for j in range(recording.n):
            product = changes[:, i] @ integrals[:, j]
            if i != j and power[j] > 0 and np.sum(changes[:, i] ** 2) > 0:
                explained = product**2 / power[j] / np.sum(changes[:, i] ** 2)
                scores.append((explained, abs(product / power[j] - 1), i, j))
    pairs, taken = [], set()
    for explained, off, i, j in sorted(scores, reverse=True):
        if explained > 0.9 and off < 0.05 and not {i, j} & taken:
            pairs.append((i, j))
            taken |= {i, j}
    return [(recording.state_names[i], recording.state_names[j]) for i, j in sorted(pairs)]


def memory(recording):
    """The samples over which the states remember: the lag at which the slowest one's autocorrelation falls below 1/e.

    At most half of the longest trajectory.
    """
    longest = sorted((x for x, _ in recording), key=len)[-20:]
    slowest = 1
    for x in longest:
        if len(x) < 4:
            continue
        centred = x - x.mean(axis=0)
        power = np.abs(np.fft.rfft(centred, 2 * len(x), axis=0)) ** 2
        correlation = np.fft.irfft(power, axis=0)[: len(x) // 2 + 1]
        below = correlation < np.exp(-1) * correlation[0]
        lags = np.where(below.any(axis=0), below.argmax(axis=0), len(x) // 2)
        slowest = max(slowest, int(lags[centred.any(axis=0)].max(initial=1)))
    return slowest


def piece_length(recording, lag):
    """The samples of a piece, and the sentence that says why.

    Five times the states' `memory`, so that a piece shows the system forgetting where it began; between 26 and 501
    samples, and short enough for thirty pieces if each still has 26 samples.
    """
    wanted = int(np.clip(5 * lag, SHORTEST - 1, LONGEST - 1))
    longest = int(recording.lengths.max())
    most = max(recording.pairs // 30, SHORTEST - 1)
    samples = int(min(wanted, most, longest - 1)) + 1
    why = f"five times the {lag * recording.dt:.3g} s within which the states forget themselves"
    if samples - 1 < wanted:
        why = "so that there are thirty pieces" if most < longest else "the longest trajectory"
    elif wanted == LONGEST - 1:
        why = "the longest that is taken"
    elif wanted == SHORTEST - 1:
        why = "the shortest that is taken"
    return samples, f"pieces have {samples} samples ({(samples - 1) * recording.dt:.3g} s; {why})"


def partition(recording):
    """Two recordings, uncut: one to learn from, and a fifth by which nothing is chosen or fitted.

    With five trials or more these are whole trials, every fifth one. Otherwise it is the end of each trial:
    neighbouring pieces are not independent.

    Returns
    -------
    train, test : Recording
    remark : str

    Raises
    ------
    ValueError
        If there is too little for that.
    """
    if len(recording) >= _FEWEST_TRIALS:
        held = np.arange(len(recording)) % 5 == 2
        remark = f"{held.sum()} of {len(recording)} trajectories are kept for the test, every fifth one"
        return recording[~held], recording[held], remark
    ends = [(len(x), 4 * (len(x) - 1) // 5) for x, _ in recording]
    if max(length - end for length, end in ends) < 10:
        raise ValueError(
            f"the recording has {int(recording.lengths.sum())} samples in {len(recording)} trajectories; to learn from four fifths and test on one it "
            "needs 50 in one trajectory, or five trajectories: record more."
        )
    parts = [(x, u, end) for (x, u), (length, end) in zip(recording, ends) if length - end >= 10]
    rest = [(x, u) for (x, u), (length, end) in zip(recording, ends) if length - end < 10]
    first = [(x[: end + 1], u[: end + 1]) for x, u, end in parts] + rest
    last = [(x[end:], u[end:]) for x, u, end in parts]
    remark = (
        "the last fifth of " + ("the recording" if len(recording) == 1 else "each trajectory") + " is kept for the test"
    )
    train, test = (recording.with_data(*map(list, zip(*part))) for part in (first, last))
    return train, test, remark


def in_pieces(recording, samples, fewest=10):
    """Pieces of so many samples; rests and trajectories of fewer than ``fewest`` are left out, if there are others."""
    pieces = recording.cut_all(samples)
    return pieces[pieces.lengths >= min(fewest, int(pieces.lengths.max()))]


def thinned(pieces, most):
    """Some of the pieces, spread evenly, with about ``most`` snapshot pairs at most."""
    if pieces.pairs <= most:
        return pieces
    count = max(10, int(len(pieces) * most / pieces.pairs))
    return pieces[np.unique(np.linspace(0, len(pieces) - 1, count).astype(int))]


def is_noisy(recording):
    """Whether the states have noise worth smoothing away."""
    if recording.lengths.max() < 10:
        return False
    span = np.ptp(np.concatenate([x for x, _ in recording]), axis=0)
    return bool((noise_level(recording) > _FINE * span).any())


def smoothed(recording, pairs):
    """`tras.smooth` of a recording of any length, in chunks."""
    parts = [recording[i].cut_all(_CHUNK) for i in range(len(recording))]
    whole = smooth(join(parts), pairs)
    states, k = [], 0
    for part in parts:
        pieces = [x for x, _ in whole[k : k + len(part)]]
        states.append(np.concatenate([pieces[0], *(x[1:] for x in pieces[1:])]))
        k += len(part)
    return recording.with_data(states, [u for _, u in recording])


def _and(names):
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
