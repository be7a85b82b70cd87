"""Measurement noise: add it, measure it, smooth it away, and refine an identified field beneath it (paper, sigma_k in (12)).

Noise on the states biases extended dynamic mode decomposition: it stands on both sides of every snapshot pair, and functions of a
noisy state are wrong on the average too. Two remedies, one after the other: `smooth` takes most of the noise out of the trajectories
before they are lifted; `refine` then fits whole trajectories, as measured, instead of single steps.
"""

import copy
import itertools
import math

import numpy as np
from scipy import linalg, optimize
from tqdm import tqdm

from tras.recording import join

_LEAST = 1e-6  # smallest noise, in half-ranges: exact data stay as they are, and nothing divides by zero
_FEWEST = 10  # samples without which noise and signal cannot be told apart
_SEGMENTS = (1001, 501, 251, 126, 63)  # samples that `refine` follows in one piece: the first that it can
_TRUST = 1e-3  # and in half-ranges: states that are known better count as if they were not, or they would outweigh all others
_BLOCK = 128  # segments followed at once: bounds the memory of their sensitivities


def add_noise(recording, level, rng):
    """The recording with white Gaussian noise on its states, sigma_k of equation (12); inputs stay exact.

    Add it before `Recording.cut`, so that a sample which two pieces share has one value.

    Parameters
    ----------
    recording : Recording
    level : float or (n,) array_like
        Standard deviation as a fraction of each state's range over the recording: 0.01 is 1 %.
    rng : numpy.random.Generator or int
        Generator or seed; the same seed gives the same noise.

    Returns
    -------
    Recording

    Raises
    ------
    ValueError
        If ``level`` is negative, not finite, or neither one number nor one a state, or ``rng`` is neither generator nor seed.
    """
    recording = join(recording)
    fraction = np.asarray(level, dtype=float)
    if fraction.shape not in ((), (recording.n,)) or not (np.isfinite(fraction).all() and (fraction >= 0).all()):
        raise ValueError(f"level is {level!r}; give a fraction of the range, 0 or more (0.01 is 1 %), or {recording.n} of them.")
    if isinstance(rng, bool) or not isinstance(rng, (np.random.Generator, int, np.integer)):
        raise ValueError(f"rng is {rng!r}; give a numpy.random.Generator or a seed, so that the noise can be had again.")
    rng = np.random.default_rng(rng)
    sigma = fraction * np.ptp(np.concatenate([x for x, _ in recording]), axis=0)
    return recording._with([x + sigma * rng.standard_normal(x.shape) for x, _ in recording], [u for _, u in recording])


def noise_level(recording):
    """Standard deviation of the noise on each state, (n,), in the states' own units, from third differences.

    ``x_(k+3) - 3 x_(k+2) + 3 x_(k+1) - x_k`` removes a smooth signal and leaves of white noise 20 times its variance (J. Rice, Ann.
    Statist. 12, 1984, p. 1215; P. Hall, J. W. Kay, D. M. Titterington, Biometrika 77, 1990, p. 521). What moves within four samples
    is counted as noise: the sampling must be fine against the motion.

    Raises
    ------
    ValueError
        If no trajectory has four samples.
    """
    recording = join(recording)
    if recording.lengths.max() < 4:
        raise ValueError(f"the longest trajectory has {recording.lengths.max()} samples; noise can be told from four or more.")
    third = np.concatenate([np.diff(x, n=3, axis=0) for x, _ in recording if len(x) > 3])
    return np.sqrt(np.mean(third**2, axis=0) / 20)


def smooth(recording, pairs=None):
    """The recording with its states smoothed: their expected values given the whole trajectory, what came after included.

    The signal is modelled as white noise integrated three times (a state by itself: two or three times, whichever is likelier), the
    measurement noise as white with the deviation that `noise_level` finds; the intensity of the driving noise is the likeliest one.
    A Kalman filter runs forward and its estimates are corrected backward (H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3, 1965,
    p. 1445); for one state that is a smoothing spline. Inputs stay. Ends are known worse than the middle: smooth before `Recording.cut`.

    Parameters
    ----------
    recording : Recording
        Trajectories may have different lengths.
    pairs : sequence of (str, str), optional
        Names of a position and its velocity, as in ``[("phi", "phidot"), ("psi", "psidot")]``: smoothed together under ``q' = v``, so each
        helps the other. The velocity's unit is the position's per second. All other states are smoothed one by one.

    Returns
    -------
    Recording

    Raises
    ------
    ValueError
        If a name is unknown or stands twice, a pair is no pair, or no trajectory has ten samples.
    """
    recording = join(recording)
    groups = _groups(recording.state_names, pairs)
    if recording.lengths.max() < _FEWEST:
        raise ValueError(f"the longest trajectory has {recording.lengths.max()} samples; smoothing needs {_FEWEST} or more.")
    sigma, whole = noise_level(recording), np.concatenate([x for x, _ in recording])
    middle, half_range = (whole.max(axis=0) + whole.min(axis=0)) / 2, np.ptp(whole, axis=0) / 2
    smoothed = [x.copy() for x, _ in recording]
    for group in groups:
        if not half_range[group].all():
            continue  # constant: nothing to smooth
        # Lengths in half-ranges and times in samples: of order one whatever the units, and still q' = v.
        first, powers = group[0], np.arange(len(group))
        scale, offset = half_range[first] / recording.dt**powers, np.where(powers == 0, middle[first], 0.0)
        deviation = np.maximum(sigma[group], _LEAST * half_range[group]) / scale
        measured = [(x[:, group] - offset) / scale for x, _ in recording]
        _, order, intensity = min(_likeliest(measured, deviation, order) for order in ((2, 3) if len(group) == 1 else (3,)))
        for into, values in zip(smoothed, _smooth(measured, deviation, order, intensity)):
            into[:, group] = values * scale + offset
    return recording._with(smoothed, [u for _, u in recording])


def refine(model, recording, rows=None, iterations=6, segment=None):
    """A copy of the model whose vector field is fitted to whole trajectories instead of single steps.

    The recording is cut into segments; the field's coefficients W and the initial state of each segment are fitted together, so that
    predictions pass through the measured states, each weighted by its noise (`noise_level`): multiple shooting (H. G. Bock, in *Modelling
    of Chemical Reaction Systems*, Springer 1981, p. 102), here without the conditions that tie a segment's end to the next one's start.
    Gauss-Newton steps with Levenberg's damping; one that would raise the cost is not taken.

    Parameters
    ----------
    model : KoopmanModel
        Fitted, ``predictor="vector_field"``, best to the smoothed recording. It is not changed.
    recording : Recording
        As measured, NOT smoothed: the fit averages the noise by itself. Longer trajectories tell more: do not cut them first.
    rows : sequence of str, optional
        The states whose equations are refined. Default: all but kinematics, the equations whose right-hand side is another state itself (to
        5 %, root mean square over the recording) as in ``dphi/dt = phidot``; all, if nothing else is left.
    iterations : int
        Steps at most. It stops earlier when the cost falls by less than 1e-5 of itself.
    segment : int, optional
        Samples of a segment. A long one tells slow motions and small errors of F, but an unstable or chaotic system cannot be predicted far.
        Default: whole trajectories, at most 1001, or half, a quarter, ... of it until the model's predictions are within twice the noise.

    Returns
    -------
    KoopmanModel
        With new ``W_`` and with ``refinement_``: the root mean square distance of prediction and measurement in units of the noise (or of a
        thousandth of the half-range, if that is more), at the start and after each step. It ends near 1 when nothing is left to
        explain, far above when the dictionary is too small or the segments are too long. K and its spectrum are still the first fit's.

    Raises
    ------
    ValueError
        If the model has no vector field, a name is unknown, a count is wrong, or the model's predictions diverge within a segment.
    """
    if getattr(model, "predictor", None) != "vector_field" or not hasattr(model, "W_"):
        raise ValueError("refine needs a model with a vector field; fit KoopmanModel(..., predictor='vector_field') first.")
    for name, value, least in (("iterations", iterations, 1), ("segment", _SEGMENTS[0] if segment is None else segment, 2)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise ValueError(f"{name} is {value!r}; give a whole number, {least} or more.")
    recording = model._same_channels(join(recording))
    model = copy.deepcopy(model)
    rows = _equations(model, recording, rows)
    for samples in _SEGMENTS if segment is None else (segment,):
        shooting = _Shooting(model, recording, rows, samples)
        W, starts = model.W_, shooting.settled_starts(model.W_)
        costs, damping = [shooting.cost(W, starts)], 1e-9
        if costs[0] <= 4 * shooting.numbers:
            break
    if not np.isfinite(costs[0]):
        raise ValueError(f"the model's predictions diverge within {samples} samples; give a shorter segment, or a model that does not.")
    for _ in tqdm(range(iterations), desc="refine", leave=False, disable=None):
        W, starts, cost, damping = _descend(shooting, W, starts, costs[-1], damping)
        costs.append(cost)
        if cost > (1 - 1e-5) * costs[-2]:
            break
    model.W_, model.refinement_ = W, np.sqrt(np.array(costs) / shooting.numbers)
    vars(model).pop("field_disagreement_", None)  # was about the W that is replaced
    return model


def _groups(names, pairs):
    """Columns that are smoothed together: those of each pair, then every other one by itself."""
    groups = []
    for pair in pairs or ():
        if isinstance(pair, str) or len(pair) != 2:
            raise ValueError(f"pairs holds {pair!r}; give pairs of names (position, velocity), for example [('phi', 'phidot')].")
        for name in pair:
            if name not in names:
                raise ValueError(f"pairs: there is no state {name!r}; there are {', '.join(names)}.")
        groups.append([names.index(name) for name in pair])
    paired = list(itertools.chain(*groups))
    for i in paired:
        if paired.count(i) > 1:
            raise ValueError(f"pairs: the state {names[i]!r} stands twice; it can be part of one pair only.")
    return groups + [[i] for i in range(len(names)) if i not in paired]


def _integrated_noise(order):
    """White noise of intensity 1 integrated ``order`` times: transition A and covariance Q over one sample, (order, order) each."""
    f, left = math.factorial, range(order - 1, -1, -1)  # left: how many integrations are still to come
    A = np.array([[1 / f(j - i) if j >= i else 0.0 for j in range(order)] for i in range(order)])
    return A, np.array([[1 / (f(i) * f(j) * (i + j + 1)) for j in left] for i in left])


def _filter(measured, deviation, order, intensity):
    """Kalman filter of many trajectories (samples_i, channels) at once; the first channels of the state are measured.

    Returns the predictions (samples, trajectories, order) before each measurement, the innovations (samples, trajectories, channels), zero
    after a trajectory's end, where those are none (samples, trajectories, 1), and for each sample (P, S, K): the covariances of
    prediction and innovation, and the gain. The latter depend on no data, so all trajectories share them, and they settle.
    """
    channels, lengths = len(deviation), np.array([len(y) for y in measured])
    inside = np.arange(lengths.max())[:, None, None] < lengths[:, None]
    Y = np.zeros((*inside.shape[:2], channels))
    for i, y in enumerate(measured):
        Y[: len(y), i] = y
    A, Q = _integrated_noise(order)
    one = np.eye(order)
    H, R = one[:channels], np.diag(deviation**2)
    x, P = np.zeros((len(measured), order)), 100 * one  # ten half-ranges: nothing is known before the first sample
    predicted, innovation, steps = np.empty((*inside.shape[:2], order)), np.empty_like(Y), []
    settled = False
    for k, y in enumerate(Y):
        if not settled:
            S = H @ P @ H.T + R
            K = np.linalg.solve(S, H @ P).T
            F = one - K @ H
            ahead = A @ (F @ P @ F.T + K @ R @ K.T) @ A.T + intensity * Q  # Joseph's form stays positive definite
            settled = np.allclose(ahead, P, rtol=1e-11, atol=0)
        steps.append((P, S, K))
        predicted[k], innovation[k] = x, (y - x[:, :channels]) * inside[k]
        x = (x + innovation[k] @ K.T) @ A.T
        P = P if settled else ahead
    return predicted, innovation, inside, steps


def _surprise(measured, deviation, order, intensity):
    """-log likelihood a number, up to a constant, without the first samples, which only say where a trajectory begins."""
    _, *parts = _filter(measured, deviation, order, intensity)
    innovation, inside, steps = (part[3:] for part in parts)
    total = sum(
        np.sum(e * np.linalg.solve(S, e.T).T) + np.sum(here) * np.log(np.linalg.det(S))
        for e, here, (_, S, _) in zip(innovation, inside, steps)
    )
    return total / 2 / np.sum(inside)


def _likeliest(measured, deviation, order):
    """(-log likelihood, order, intensity) of the likeliest intensity, judged by some pieces from all over the data."""
    pieces = [y[k : k + 500] for y in measured for k in range(0, len(y), 500)]
    pieces = [piece for piece in pieces if len(piece) >= _FEWEST]
    pieces = pieces[:: max(1, len(pieces) // 20)]

    def intensity(exponent):
        return deviation[0] ** 2 * 10.0**exponent

    def surprise(exponent):
        return _surprise(pieces, deviation, order, intensity(exponent))

    grid = np.arange(-22.0, 7.0, 2.0)  # from almost straight lines to no smoothing at all
    best = min(grid, key=surprise)
    found = optimize.minimize_scalar(surprise, bounds=(best - 2, best + 2), method="bounded", options={"xatol": 0.02})
    return found.fun, order, intensity(found.x)


def _smooth(measured, deviation, order, intensity):
    """Smoothed measurements, list of (samples_i, channels).

    The backward pass is Bryson's and Frazier's (G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation*, 1977,
    Ch. X): the same estimate as Rauch, Tung and Striebel's, without the inverse of a nearly singular covariance.
    """
    predicted, innovation, _, steps = _filter(measured, deviation, order, intensity)
    A, one = _integrated_noise(order)[0], np.eye(order)
    H = one[: len(deviation)]
    smoothed, adjoint = np.empty_like(innovation), np.zeros(predicted.shape[1:])
    for k in range(len(predicted) - 1, -1, -1):
        P, S, K = steps[k]
        adjoint = adjoint @ (one - K @ H) - np.linalg.solve(S, innovation[k].T).T @ H
        smoothed[k] = (predicted[k] - adjoint @ P) @ H.T
        adjoint = adjoint @ A
    return [smoothed[: len(y), i] for i, y in enumerate(measured)]


def _equations(model, recording, rows):
    """Indices of the rows of W to refine."""
    names = model.state_names_
    if rows is not None:
        rows = [rows] if isinstance(rows, str) else list(rows)
        for name in rows or [""]:
            if name not in names:
                raise ValueError(f"rows: there is no state {name!r}; name one or more of {', '.join(names)}.")
        return [i for i, name in enumerate(names) if name in rows]
    z = np.concatenate([np.hstack(pair) for pair in model._scaled(recording)])
    z = z[:: max(1, len(z) // 5000)].T
    rates = (model.W_ @ model.dictionary_.lift(z)).T * model.x_scale_
    x = z[: len(names)].T * model.x_scale_ + model.x_offset_
    apart = np.linalg.norm(rates[:, :, None] - x[:, None], axis=0) / np.linalg.norm(x, axis=0)
    np.fill_diagonal(apart, np.inf)
    kinematic = apart.min(axis=1) <= 0.05
    return [i for i in range(len(names)) if not kinematic[i] or kinematic.all()]


class _Shooting:
    """Predictions over the segments of a recording, in scaled channels, and how they depend on ``W[rows]`` and the initial states.

    Segments of equal length are followed together; p = rows N is the number of coefficients.
    """

    def __init__(self, model, recording, rows, segment):
        self.dictionary, self.rows, self.N = model.dictionary_, rows, model.W_.shape[1]
        self.substeps, self.h = model.substeps_, model.dt_ / model.substeps_
        self.weight = model.x_scale_ / np.maximum(noise_level(recording), _TRUST * model.x_scale_)
        pieces = [(x[k : k + segment], u[k : k + segment]) for x, u in model._scaled(recording) for k in range(0, len(x) - 1, segment)]
        self.blocks = []  # [states (samples, n, segments), inputs (samples, m, segments)]
        for _, alike in itertools.groupby(sorted(pieces, key=_length), key=_length):
            alike = list(alike)
            for k in range(0, len(alike), _BLOCK):
                self.blocks.append([np.stack(part, axis=-1) for part in zip(*alike[k : k + _BLOCK])])
        self.numbers = sum(states.size for states, _ in self.blocks)

    def settled_starts(self, W):
        """Initial states (n, segments) of each block: measured, then fitted to what follows, a little first, so that no noise leads astray."""
        starts, brief = [states[0] for states, _ in self.blocks], copy.copy(self)
        brief.rows = []
        for horizon in (8, 32, 128):
            brief.blocks = [[part[:horizon] for part in block] for block in self.blocks]
            _, starts, _, _ = _descend(brief, W, starts, brief.cost(W, starts), 1e-9)
        return starts

    def cost(self, W, starts):
        """Sum of the squared residuals, each in units of its noise; infinite if a prediction diverges."""
        total = 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            for (states, inputs), z in zip(self.blocks, starts):
                for k, x in enumerate(states):
                    if k:
                        z, _ = self._sample(W, z, inputs[k - 1])
                    total += np.sum(((x - z) * self.weight[:, None]) ** 2)
        return total if np.isfinite(total) else np.inf

    def linearise(self, W, starts):
        """Gauss-Newton's normal equations of each block in (W[rows], initial states): (Hww, Hwx, Hxx, gw, gx).

        (p, p), (segments, p, n), (segments, n, n), (p,), (segments, n); the cost's gradient is -2 (gw, gx).
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return [self._normal_equations(W, z, *block) for block, z in zip(self.blocks, starts)]

    def _normal_equations(self, W, z, states, inputs):
        n, count, p = *z.shape, len(self.rows) * self.N
        S = np.concatenate([np.zeros((count, n, p)), np.broadcast_to(np.eye(n), (count, n, n))], axis=2)  # dz / d(W[rows], start)
        Hww, Hwx, Hxx, gw, gx = (np.zeros(shape) for shape in ((p, p), (count, p, n), (count, n, n), p, (count, n)))
        for k, x in enumerate(states):
            if k:
                z, S = self._sample(W, z, inputs[k - 1], S)
            e = ((x - z) * self.weight[:, None]).T  # (segments, n)
            by_W, by_start = np.split(S * self.weight[:, None], [p], axis=2)
            flat = by_W.reshape(count * n, p)
            Hww += flat.T @ flat
            Hwx += by_W.transpose(0, 2, 1) @ by_start
            Hxx += by_start.transpose(0, 2, 1) @ by_start
            gw += flat.T @ e.ravel()
            gx += (e[:, None] @ by_start)[:, 0]
        return Hww, Hwx, Hxx, gw, gx

    def _sample(self, W, z, u, S=None):
        """One sample ahead: z (n, segments) and, if given, its sensitivities S (segments, n, p + n)."""
        for _ in range(self.substeps):
            z, slopes = self._step(W, z, u, S is not None)
            if slopes:
                by_z, by_W = slopes
                S = by_z @ S
                S[:, :, : by_W.shape[2]] += by_W
        return z, S

    def _step(self, W, z, u, slopes):
        """One classical Runge-Kutta step, as the model takes it, and its exact derivatives by z (segments, n, n) and W[rows] (segments, n, p)."""
        h, n, one = self.h, len(z), np.eye(len(z))
        psi, k, F = [], [], []
        for reach in (0, h / 2, h / 2, h):
            point = np.concatenate([z + reach * k[-1] if k else z, u])
            psi.append(self.dictionary.lift(point))
            k.append(W @ psi[-1])
            if slopes:
                F.append((W @ self.dictionary.lift_slopes(point).reshape(self.N, -1)).reshape(n, n, -1).transpose(2, 0, 1))
        onward = z + h / 6 * (k[0] + 2 * (k[1] + k[2]) + k[3])
        if not slopes:
            return onward, None
        # M_i = d onward / d k_i, last stage first: k_i acts by its own weight and through the stage after it.
        M4 = np.broadcast_to(h / 6 * one, F[0].shape)
        M3 = h / 3 * one + h * M4 @ F[3]
        M2 = h / 3 * one + h / 2 * M3 @ F[2]
        M1 = h / 6 * one + h / 2 * M2 @ F[1]
        M = M1, M2, M3, M4
        by_W = sum(np.einsum("bir,jb->birj", Mi[:, :, self.rows], q) for Mi, q in zip(M, psi))
        return onward, (one + sum(Mi @ Fi for Mi, Fi in zip(M, F)), by_W.reshape(*F[0].shape[:2], len(self.rows) * self.N))


def _length(piece):
    return len(piece[0])


def _descend(shooting, W, starts, cost, damping):
    """One step, damped until the cost falls: new W, initial states, cost and damping; the old ones if none helps."""
    blocks = shooting.linearise(W, starts)
    while damping < 1e8:
        try:
            step, moves = _solve(blocks, damping)
        except linalg.LinAlgError:
            step = None
        if step is not None:
            onward = W.copy()
            onward[shooting.rows] += step.reshape(-1, shooting.N)
            moved = [z + move for z, move in zip(starts, moves)]
            new = shooting.cost(onward, moved)
            if new < cost:
                return onward, moved, new, max(damping / 100, 1e-9)
        damping *= 100
    return W, starts, cost, damping


def _solve(blocks, damping):
    """Solve the normal equations, their diagonal enlarged by ``damping`` of itself: steps (p,) and, for each block, (n, segments).

    Each initial state appears in its own segment alone, so they are eliminated one by one.
    """
    H, g = sum(block[0] for block in blocks), sum(block[3] for block in blocks)
    H[np.diag_indices_from(H)] *= 1 + damping
    inverses = [np.linalg.inv(Hxx * (1 + damping * np.eye(Hxx.shape[-1]))) for _, _, Hxx, _, _ in blocks]
    for inverse, (_, Hwx, _, _, gx) in zip(inverses, blocks):
        H = H - np.einsum("bpi,bqi->pq", Hwx @ inverse, Hwx, optimize=True)
        g = g - np.einsum("bpi,bi->p", Hwx @ inverse, gx)
    if not np.isfinite(H).all():
        raise linalg.LinAlgError("a prediction diverges")
    size = np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
    step = linalg.cho_solve(linalg.cho_factor(H / np.outer(size, size)), g / size) / size if len(g) else g
    moves = [(inverse @ (gx - step @ Hwx)[:, :, None])[:, :, 0].T for inverse, (_, Hwx, _, _, gx) in zip(inverses, blocks)]
    return step, moves
