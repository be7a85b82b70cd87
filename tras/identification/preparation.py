"""A recording of a rig made ready for its identification: each step once, with sentences on what it leaves out.

`identification.identify` calls them in this order. `Treatments` holds a part of it as measured and smoothed.
"""

import math

import numpy as np
from scipy.stats import norm

from tras.identification.noise import noise_level
from tras.identification.smoothing import smooth
from tras.recording import Recording, join
from tras.workflow import arguments

LONGEST, SHORTEST = 501, 26  # samples of a piece, both ends included
_FEWEST_TRIALS = 5  # from which on whole trials are held back for the test
_CHUNK = 2001  # samples that are smoothed at once
_STILL_MOVES = 0.5  # the same of what is learnt from
_MOVES = 0.2  # standard deviation of a state in the test over that in the whole recording, at least, if it can be had
_RESTS = 0.05  # the same, below which a stretch says nothing of a state
_SPIKE = 0.3  # of the range of the others: how far a lone sample is from both of its neighbours
_RARE = 0.005  # share of such samples, at most
_LOUD = 1 / 30  # noise over what a state moves within a sample, from which on longer steps are tried
_COARSE = 0.3  # what a state moves within a step, in standard deviations, at most
_STEPS = 500  # pairs that longer steps must leave
_FINE = 2e-4  # noise, as a fraction of the range, that is not worth smoothing away


def without_idle_channels(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording without channels that are constant, or linear combinations of those before them; and remarks.

    Raises
    ------
    ValueError
        If no state moves.
    """
    x, u = (np.concatenate(part) for part in zip(*recording))
    names, table = (*recording.state_names, *recording.input_names), np.hstack([x, u])
    active, remarks, basis = [], [], np.ones((len(table), 1)) / np.sqrt(len(table))
    for name, column in zip(names, table.T):
        rest = column - column.mean()
        spread = np.linalg.norm(rest)
        if np.ptp(column) <= 1e-12 * np.abs(column).max() or spread == 0:
            remarks.append(f"{name} is constant ({column[0]:.6g}) and was left out")
            continue
        for _ in range(2):  # twice is enough (Kahan and Parlett)
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) <= 1e-7 * spread:
            others = " and ".join(filter(None, [", ".join(active[:-1]), *active[-1:]]))
            remarks.append(f"{name} is a linear combination of {others} at every sample and was left out")
            continue
        active.append(name)
        if basis.shape[1] <= 200:
            basis = np.hstack([basis, (rest / np.linalg.norm(rest))[:, None]])
    states = [name for name in recording.state_names if name in active]
    if not states:
        remedy = "Give others as states, or record while something happens."
        raise ValueError(f"no state moves: {'; '.join(remarks)}. {remedy}")
    return recording.select(states=states, inputs=[name for name in recording.input_names if name in active]), remarks


def without_spikes(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with the mean of the neighbours in place of a lone sample that is far from both; and remarks.

    A lost byte or a glitch of a sensor: what moves by itself does not leave for one sample and come back to where it
    was. One such sample can outweigh all others in a least-squares fit.
    """
    columns, remarks = [x.copy() for x, _ in recording], []
    for j, name in enumerate(recording.state_names):
        apart = [np.abs(x[1:-1, j] - (x[2:, j] + x[:-2, j]) / 2) for x in columns]
        gaps = [np.abs(x[2:, j] - x[:-2, j]) for x in columns]
        together, values = np.concatenate(apart), np.concatenate([x[1:-1, j] for x in columns])
        lone = together > 5 * np.concatenate(gaps)
        lone &= together > 10 * np.quantile(together, 0.99) if len(together) else False
        rest = values[~lone]
        lone &= together > _SPIKE * np.ptp(rest) if len(rest) else False
        if not lone.any() or lone.sum() > max(1, _RARE * len(lone)) or np.ptp(rest) == 0:
            continue
        i = int(np.abs(together * lone).argmax())
        for x, of_this in zip(columns, np.split(lone, np.cumsum([len(part) for part in apart])[:-1])):
            for k in 1 + np.flatnonzero(of_this):
                x[k, j] = (x[k - 1, j] + x[k + 1, j]) / 2
        count = f"{lone.sum()} lone samples" if lone.sum() > 1 else "a lone sample"
        remarks.append(
            f"{name} has {count} far from both neighbours (the farthest is {values[i]:.4g}), which the means of the "
            "neighbours replace"
        )
    return recording.with_data(columns, [u for _, u in recording]) if remarks else recording, remarks


def steps(recording: Recording, samples: int) -> list[int]:
    """Lengths of a model's step to try, in samples: 1, and longer ones where the recording is finer than it need be.

    A fit of single steps tells the motion from the noise by what the states move within a step. Where that is less than
    thirty times the noise, the longest step is tried over which no state moves by more than 0.3 standard deviations (20
    steps per period of a sine), and a quarter of it. It leaves eight steps to a window of ``samples``.
    """
    if recording.lengths.max() < 10:
        return [1]
    spread = np.concatenate([x for x, _ in recording]).std(axis=0)

    def move(every):
        changes = [x[every:] - x[:-every] for x, _ in recording if len(x) > every]
        return np.sqrt(np.mean(np.concatenate(changes) ** 2, axis=0))

    # A quantile, because what the jumps of an input bend is no noise, though its squares weigh more than all else.
    third = np.concatenate([np.diff(x, n=3, axis=0) for x, _ in recording if len(x) > 3])
    noise = np.quantile(np.abs(third), 0.75, axis=0) / (norm.ppf(0.875) * math.sqrt(20))
    if (noise < _LOUD * move(1)).all():
        return [1]
    longest = 1
    while (
        recording.pairs // (2 * longest) >= _STEPS
        and (samples - 1) // (2 * longest) >= 8
        and (move(2 * longest) <= _COARSE * spread).all()
    ):
        longest *= 2
    return [step for step in sorted({1, longest // 4, longest}) if step]


def partition(recording: Recording) -> tuple[Recording, Recording, str]:
    """Two recordings, uncut: one to learn from, and a fifth by which nothing is chosen or fitted; and a remark.

    The recording's attribute ``test_trajectories`` says which trials are the test. Without it, with five trials or
    more these are whole trials, every fifth one. Otherwise it is the end of each trial: neighbouring pieces are not
    independent.

    Raises
    ------
    ValueError
        If there is too little for that.
    """
    trials = len(recording)
    if held_back := recording.held_back():
        of_test = np.isin(np.arange(trials), held_back)
        if of_test.all():
            raise ValueError("every trajectory is to be kept for the test; leave some to learn from.")
        remark = f"{of_test.sum()} of {trials} trajectories are kept for the test, as the user or the file says"
        return recording[~of_test], recording[of_test], remark
    if trials >= _FEWEST_TRIALS:
        of_test = np.arange(trials) % 5 == 2
        remark = f"{of_test.sum()} of {trials} trajectories are kept for the test, every fifth one"
        return recording[~of_test], recording[of_test], remark
    train, test, which = [], [], None
    for x, u in recording:
        edges = np.linspace(0, len(x) - 1, 6).astype(int)
        if len(x) - edges[4] < 10:
            train.append((x, u))
            continue
        which = _moving_fifth(recording, edges) if trials == 1 else 4
        start, end = edges[which], edges[which + 1]
        test.append((x[start : end + 1], u[start : end + 1]))
        rests = slice(0, start + 1), slice(end, len(x))
        train += [(x[rest], u[rest]) for rest in rests if len(x[rest]) > 1]
    if not test:
        raise ValueError(
            f"the recording has {int(recording.lengths.sum())} samples in {trials} trajectories; to learn from four "
            "fifths and test on one it needs 50 in one trajectory, or five trajectories: record more."
        )
    train, test = (recording.with_data(*map(list, zip(*part))) for part in (train, test))
    whole = "the recording" if trials == 1 else "each trajectory"
    if which == 4:
        return train, test, f"the last fifth of {whole} is kept for the test"
    where = f"{edges[which] * recording.dt:.4g} s to {edges[which + 1] * recording.dt:.4g} s"
    return train, test, f"{where} is kept for the test, the latest fifth in which the states move as they do elsewhere"


def _moving_fifth(recording, edges):
    """The latest fifth of one trajectory in which every state moves, and without which it still does.

    Otherwise the one that comes nearest to that, or the last one if nothing moves in any.
    """
    x = recording.states[0]
    whole, fifths = x.std(axis=0), [slice(a, b + 1) for a, b in zip(edges[:-1], edges[1:])]
    share = [min((x[part].std(axis=0) / whole).min() / _MOVES, 1) for part in fifths]
    left = [min((np.delete(x, part, axis=0).std(axis=0) / whole).min() / _STILL_MOVES, 1) for part in fifths]
    score = np.minimum(share, left)
    return int(np.flatnonzero(score == score.max())[-1]) if score.max() > 0 else 4


def held_out(recording: Recording, fewest: int, grid: int = 1) -> tuple[list, list]:
    """Stretches (trajectory, first, last sample) to learn from, and those to judge a choice by; each pair is in one.

    Of five trajectories or more that have ``fewest`` samples, every fifth one is to judge by. Otherwise it is the third
    and the eighth tenth of each trajectory, or the third fifth where a tenth has fewer than ``fewest`` samples. Where a
    state rests in those of a single trajectory, it is the nearest ones in which all move, but the first: at rest all
    models are alike. Stretches to judge by begin and end at multiples of ``grid``.
    """
    learn, judge = [], []
    long = np.flatnonzero(recording.lengths >= fewest)
    if len(long) >= _FEWEST_TRIALS:
        for i, length in enumerate(map(int, recording.lengths)):
            (judge if i in long[4::5] else learn).append((i, 0, length - 1))
        return learn, judge
    whole = np.concatenate(recording.states).std(axis=0)
    for i, (x, _) in enumerate(recording):
        steps = len(x) - 1
        parts, of_judge = (10, (2, 7)) if steps // 10 >= fewest else (5, (2,))
        if steps // parts < fewest - 1:
            learn.append((i, 0, steps))
            continue
        edges, start = np.linspace(0, steps, parts + 1).astype(int) // grid * grid, 0
        # Of several trajectories others move, where one rests.
        for k in _moving(x, whole, edges, of_judge) if len(recording) == 1 else of_judge:
            learn.append((i, start, int(edges[k])))
            judge.append((i, int(edges[k]), int(edges[k + 1])))
            start = int(edges[k + 1])
        learn.append((i, start, steps))
    return learn, judge


def _moving(x, whole, edges, wanted):
    """Parts of a trajectory between edges, in order: the ``wanted`` ones, or where a state rests in one, the nearest
    in which all move and which leaves motion to learn from, if there is one."""
    parts = [np.arange(a, b + 1) for a, b in zip(edges[:-1], edges[1:])]
    chosen = []

    def moves(k):
        left = np.delete(x, np.concatenate([parts[part] for part in (*chosen, k)]), axis=0)
        enough = left.std(axis=0) >= _STILL_MOVES * whole
        return bool((enough & (x[parts[k]].std(axis=0) >= _MOVES * whole)).all())

    for wish in wanted:
        others = []
        if (x[parts[wish]].std(axis=0) < _RESTS * whole).any():
            others = [k for k in range(1, len(parts)) if k not in (*chosen, *wanted) and moves(k)]  # a start is learnt
        chosen.append(min(others, key=lambda k: abs(k - wish), default=wish))
    return sorted(chosen)


def stretches(recording: Recording, spans: list) -> Recording:
    """The stretches of a recording that `held_out` names, those of one sample left out."""
    trajectories = list(recording)
    parts = [(trajectories[i][0][a : b + 1], trajectories[i][1][a : b + 1]) for i, a, b in spans if b > a]
    return recording.with_data(*map(list, zip(*parts)))


def windows(recording: Recording, samples: int, latest: int, most: float = np.inf) -> Recording:
    """Windows of ``samples`` samples, each with the ``latest`` samples before it, which start a prediction.

    The windows without these follow each other. Shorter rests are left out; ``samples`` is the length of the longest
    trajectory without its start where that is less.
    """
    samples = min(samples, int(recording.lengths.max()) - latest)
    parts = [
        (x[k : k + latest + samples], u[k : k + latest + samples])
        for x, u in recording
        for k in range(0, len(x) - latest - samples + 1, max(1, samples - 1))
    ]
    return thinned(recording.with_data(*map(list, zip(*parts))), most)


def memory(recording: Recording) -> int:
    """The samples over which the states remember: the lag at which the slowest one's autocorrelation falls below 1/e.

    At most half of the longest trajectory.
    """
    slowest = 1
    for x in sorted((x for x, _ in recording if len(x) >= 4), key=len)[-20:]:
        centred = x - x.mean(axis=0)
        power = np.abs(np.fft.rfft(centred, 2 * len(x), axis=0)) ** 2
        correlation = np.fft.irfft(power, axis=0)[: len(x) // 2 + 1]
        below = correlation < np.exp(-1) * correlation[0]
        lags = np.where(below.any(axis=0), below.argmax(axis=0), len(x) // 2)
        slowest = max(slowest, int(lags[centred.any(axis=0)].max(initial=1)))
    return slowest


def window_length(recording: Recording, lag: int, horizon: float | None = None) -> tuple[int, str]:
    """The samples of a window that predictions are judged on, and the sentence that says why.

    The ``horizon`` in s, or five times the states' `memory`, so that a window shows the system forgetting where it
    began; between 26 and 501 samples, and short enough for thirty windows if each still has 26 samples.
    """
    if horizon is not None:
        arguments.number("horizon", horizon, 0, ends=False, give="a time in s, for example 2.0")
        samples = int(round(horizon / recording.dt)) + 1
        return max(2, samples), f"windows are {max(1, samples - 1) * recording.dt:.3g} s long, as the horizon says"
    steps = int(np.clip(5 * lag, SHORTEST - 1, LONGEST - 1))
    longest, most = int(recording.lengths.max()), max(recording.pairs // 30, SHORTEST - 1)
    samples = min(steps, most, longest - 1) + 1
    if samples - 1 < steps:
        why = "so that there are thirty" if most < longest else "the longest trajectory"
    elif steps in (SHORTEST - 1, LONGEST - 1):
        why = f"the {'longest' if steps == LONGEST - 1 else 'shortest'} that is taken"
    else:
        why = f"five times the {lag * recording.dt:.3g} s within which the states forget themselves"
    return samples, f"windows have {samples} samples ({(samples - 1) * recording.dt:.3g} s; {why})"


def velocity_pairs(recording: Recording, lag: int) -> list[tuple[str, str]]:
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
        area = np.vstack([np.zeros(recording.n), np.cumsum((x[1:] + x[:-1]) / 2, axis=0) * recording.dt])
        changes.append((x[span:] - x[:-span])[::every])
        integrals.append((area[span:] - area[:-span])[::every])
    changes, integrals = (part - part.mean(axis=0) for part in map(np.concatenate, (changes, integrals)))
    product, power = changes.T @ integrals, np.sum(integrals**2, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        explained, off = product**2 / power / np.sum(changes**2, axis=0)[:, None], abs(product / power - 1)
    np.fill_diagonal(explained, 0)
    pairs = []
    for i, j in zip(*np.unravel_index(np.argsort(-explained, axis=None), explained.shape)):
        if explained[i, j] > 0.9 and off[i, j] < 0.05 and not {i, j} & {k for pair in pairs for k in pair}:
            pairs.append((i, j))
    return [(recording.state_names[i], recording.state_names[j]) for i, j in sorted(pairs)]


class Treatments:
    """A recording "as measured" and "smoothed", whole trajectories of it, made once, when they are first used.

    Parameters
    ----------
    recording : Recording
        Uncut.
    pairs : list of (str, str)
        Names of positions and their velocities, for the smoother.
    most : int
        Snapshot pairs, about; of a longer recording stretches of 2001 samples are taken, spread evenly.
    """

    def __init__(self, recording: Recording, pairs: list[tuple[str, str]], most: int):
        self.recording, self.pairs = recording, pairs
        used = recording if recording.pairs <= most else thinned(recording.cut_all(_CHUNK), most)
        self._treated = {"as measured": used}

    def at_most(self, most: int) -> "Treatments":
        """These treatments, or new ones of fewer pairs."""
        return self if self.whole("as measured").pairs <= most else Treatments(self.recording, self.pairs, most)

    def whole(self, name: str, every: int = 1, lead: int = 0) -> Recording:
        """All trajectories under one treatment, `Recording.decimated` after it."""
        if name not in self._treated:
            self._treated[name] = smoothed(self._treated["as measured"], self.pairs)
        return self._treated[name].decimated(every, lead)


def thinned(pieces: Recording, most: float) -> Recording:
    """Some of the pieces, spread evenly, with about ``most`` snapshot pairs at most."""
    if pieces.pairs <= most:
        return pieces
    count = max(10, int(len(pieces) * most / pieces.pairs))
    return pieces[np.unique(np.linspace(0, len(pieces) - 1, count).astype(int))]


def is_noisy(recording: Recording, share: float = _FINE) -> bool:
    """Whether a state has more noise than this share of its range; by default, as much as is worth smoothing away."""
    if recording.lengths.max() < 10:
        return False
    span = np.ptp(np.concatenate([x for x, _ in recording]), axis=0)
    return bool((noise_level(recording) > share * span).any())


def smoothed(recording: Recording, pairs: list[tuple[str, str]]) -> Recording:
    """`tras.smooth` of a recording of any length, in chunks."""
    parts = [recording[i].cut_all(_CHUNK) for i in range(len(recording))]
    pieces, states = (x for x, _ in smooth(join(parts), pairs)), []
    for part in parts:
        first, *others = (next(pieces) for _ in part)
        states.append(np.concatenate([first, *(x[1:] for x in others)]))
    return recording.with_data(states, [u for _, u in recording])
