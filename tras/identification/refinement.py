"""Fit an identified vector field to whole measured trajectories: multiple shooting, for data with noise."""

import contextlib
import copy
from collections.abc import Sequence

import numpy as np
from scipy import linalg
from tqdm import tqdm

from tras.identification.noise import noise_level
from tras.model import KoopmanModel
from tras.recording import Recording
from tras.solver.threads import few_blas_threads
from tras.workflow import arguments

_SEGMENTS = (1001, 501, 251, 126, 63)  # samples of a segment, the first of these over which predictions hold
_TRUST = 1e-3  # noise in half-ranges, at least: a state that is known better would outweigh all others
_BLOCK = 128  # segments that are followed at once: bounds the memory of their sensitivities


def refine(
    model: KoopmanModel, recording: Recording, rows: Sequence[str] | None = None, iterations: int = 6,
    segment: int | None = None,
) -> KoopmanModel:  # fmt: skip
    """A copy of the model whose vector field is fitted to whole trajectories instead of single steps.

    The recording is cut into segments; the field's coefficients W and the initial state of each segment are fitted
    together, so that predictions pass through the measured states, each weighted by its noise (`noise_level`): multiple
    shooting (H. G. Bock, in *Modelling of Chemical Reaction Systems*, Springer 1981, p. 102), here without the
    conditions that tie a segment's end to the next one's start. Gauss-Newton steps with Levenberg's damping are taken
    as long as they lower the cost.

    Parameters
    ----------
    model : KoopmanModel
        Fitted, ``predictor="vector_field"``, best to the smoothed recording. It is not changed.
    recording : Recording
        As measured, NOT smoothed: the fit averages the noise itself. Long trajectories tell more: do not cut them
        first.
    rows : sequence of str, optional
        The states whose equations are refined. Default: all but kinematics, the equations whose right-hand side is
        another state (to 5 %, root mean square over the recording) as in ``dphi/dt = phidot``; all, if there are only
        such.
    iterations : int
        Steps, at most. The fit ends earlier when a step lowers the cost by less than 1e-5 of it.
    segment : int, optional
        Samples of a segment. Long ones show slow motions and small errors of F, but an unstable or chaotic system
        cannot be predicted far. Default: whole trajectories of at most 1001, or half, a quarter, ... of that until the
        predictions are within twice the noise.

    Returns
    -------
    KoopmanModel
        With new ``W_`` and with ``refinement_``: the root mean square distance of prediction and measurement in units
        of the noise (or of a thousandth of the half-range, if that is more), at the start and after each step. It ends
        near 1 when everything is explained, far above when the dictionary is too small or the segments are too long. K
        and its spectrum stay those of the first fit.

    Raises
    ------
    ValueError
        If the model has no vector field, a name is unknown, a count is wrong, or predictions diverge within a segment.

    Examples
    --------
    >>> from tras import Monomials
    >>> from tras.identification.examples import example
    >>> log = example("duffing", noise=0.02)[[0]]
    >>> model = KoopmanModel(Monomials(2), strength=0).fit(log)
    >>> misfit = refine(model, log, iterations=1, segment=51).refinement_
    >>> bool(misfit[-1] < misfit[0])
    True
    """
    if getattr(model, "predictor", None) != "vector_field" or not hasattr(model, "W_"):
        raise ValueError("refine needs a model with a vector field; fit KoopmanModel(..., predictor='vector_field').")
    arguments.whole_number("iterations", iterations)
    arguments.whole_number("segment", _SEGMENTS[0] if segment is None else segment, 2)
    recording, model = model.channels_.matched(recording), copy.deepcopy(model)
    with few_blas_threads(len(model.names_)):
        _refine(model, recording, _equations(model, recording, rows), iterations, segment)
    return model


def _refine(model, recording, rows, iterations, segment):
    """New ``W_`` and ``refinement_`` of a model."""
    longest = int(recording.lengths.max())
    for samples in dict.fromkeys(min(each, longest) for each in _SEGMENTS) if segment is None else (segment,):
        shooting = _Shooting(model, recording, rows, samples)
        W, starts = model.W_, shooting.settled_starts(model.W_)
        costs, damping = [shooting.cost(W, starts)], 1e-9
        if costs[0] <= 4 * shooting.numbers:
            break
    if not np.isfinite(costs[0]):
        raise ValueError(
            f"the model's predictions diverge within {samples} samples; give a shorter segment, or another model."
        )
    for _ in tqdm(range(iterations), desc="refine", leave=False, disable=None):
        W, starts, cost, damping = _descend(shooting, W, starts, costs[-1], damping)
        costs.append(cost)
        if cost > (1 - 1e-5) * costs[-2]:
            break
    model.W_, model.refinement_ = W, np.sqrt(np.array(costs) / shooting.numbers)
    vars(model).pop("field_disagreement_", None)  # it belongs to the old W


def _equations(model, recording, rows):
    """The indices of the rows of W to refine; see `refine`."""
    names = model.state_names_
    if rows is not None:
        rows = [rows] if isinstance(rows, str) else list(rows)
        for name in rows or [""]:
            if name not in names:
                raise ValueError(f"rows: there is no state {name!r}; name one or more of {', '.join(names)}.")
        return [i for i, name in enumerate(names) if name in rows]
    z = np.concatenate([np.hstack(pair) for pair in model.channels_.scaled(recording)])
    z = z[:: max(1, len(z) // 5000)].T
    rates = (model.W_ @ model.dictionary_.lift(z)).T * model.x_scale_
    x = z[: len(names)].T * model.x_scale_ + model.x_offset_
    apart = np.linalg.norm(rates[:, :, None] - x[:, None], axis=0) / np.linalg.norm(x, axis=0)
    np.fill_diagonal(apart, np.inf)
    kinematic = apart.min(axis=1) <= 0.05
    return [i for i in range(len(names)) if not kinematic[i] or kinematic.all()]


class _Shooting:
    """Predictions over segments, in scaled channels, and their sensitivities to W[rows] (p coefficients) and starts.

    Segments of equal length are followed together.
    """

    def __init__(self, model, recording, rows, segment):
        self.dictionary, self.rows, self.N = model.dictionary_, rows, model.W_.shape[1]
        self.substeps, self.h = model.substeps_, model.dt_ / model.substeps_
        self.weight = model.x_scale_ / np.maximum(noise_level(recording), _TRUST * model.x_scale_)
        pieces = {}  # length -> segments
        for x, u in model.channels_.scaled(recording):
            for k in range(0, len(x) - 1, segment):
                pieces.setdefault(len(x[k : k + segment]), []).append((x[k : k + segment], u[k : k + segment]))
        self.blocks = []  # [states (samples, n, segments), inputs (samples, m, segments)]
        for _, segments in sorted(pieces.items()):
            for k in range(0, len(segments), _BLOCK):
                self.blocks.append([np.stack(part, axis=-1) for part in zip(*segments[k : k + _BLOCK])])
        self.numbers = sum(states.size for states, _ in self.blocks)

    def settled_starts(self, W):
        """Initial states (n, segments) of each block: as measured, then fitted to longer and longer beginnings."""
        starts, brief = [states[0] for states, _ in self.blocks], copy.copy(self)
        brief.rows = []
        for horizon in (8, 32, 128):
            brief.blocks = [[part[:horizon] for part in block] for block in self.blocks]
            _, starts, _, _ = _descend(brief, W, starts, brief.cost(W, starts), 1e-9)
        return starts

    def cost(self, W, starts):
        """The sum of the squared residuals, each in units of its noise; infinite if a prediction diverges."""
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
        S = np.tile(np.eye(n, p + n, p), (count, 1, 1))  # dz / d(W[rows], start)
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
        """One sample ahead: z (n, segments) and, unless None, its sensitivities S (segments, n, p + n)."""
        for _ in range(self.substeps):
            z, slopes = self._step(W, z, u, S is not None)
            if slopes:
                by_z, by_W = slopes
                S = by_z @ S
                S[:, :, : by_W.shape[2]] += by_W
        return z, S

    def _step(self, W, z, u, slopes):
        """One Runge-Kutta step of the model, and its derivatives by z (segments, n, n) and W[rows] (segments, n, p)."""
        h, n, one = self.h, len(z), np.eye(len(z))
        psi, k, F = [], [], []
        for reach in (0, h / 2, h / 2, h):
            point = np.concatenate([z + reach * k[-1] if k else z, u])
            psi.append(self.dictionary.lift(point))
            k.append(W @ psi[-1])
            if slopes:
                by_point = W @ self.dictionary.lift_slopes(point).reshape(self.N, -1)
                F.append(by_point.reshape(n, n, -1).transpose(2, 0, 1))
        onward = z + h / 6 * (k[0] + 2 * (k[1] + k[2]) + k[3])
        if not slopes:
            return onward, None
        # M_i = d onward / d k_i, last stage first: k_i acts by its weight and through the stage after it.
        M4 = np.broadcast_to(h / 6 * one, F[0].shape)
        M3 = h / 3 * one + h * M4 @ F[3]
        M2 = h / 3 * one + h / 2 * M3 @ F[2]
        M1 = h / 6 * one + h / 2 * M2 @ F[1]
        M = M1, M2, M3, M4
        by_W = sum(np.einsum("bir,jb->birj", Mi[:, :, self.rows], q) for Mi, q in zip(M, psi))
        by_z = one + sum(Mi @ Fi for Mi, Fi in zip(M, F))
        return onward, (by_z, by_W.reshape(*by_z.shape[:2], len(self.rows) * self.N))


def _descend(shooting, W, starts, cost, damping):
    """One step, damped until the cost falls: the new W, initial states, cost and damping, or the old ones."""
    blocks = shooting.linearise(W, starts)
    while damping < 1e8:
        with contextlib.suppress(linalg.LinAlgError):
            step, moves = _solve(blocks, damping)
            onward = W.copy()
            onward[shooting.rows] += step.reshape(-1, shooting.N)
            new_starts = [z + move for z, move in zip(starts, moves)]
            new_cost = shooting.cost(onward, new_starts)
            if new_cost < cost:
                return onward, new_starts, new_cost, max(damping / 100, 1e-9)
        damping *= 100
    return W, starts, cost, damping


def _solve(blocks, damping):
    """Steps (p,) and, per block, (n, segments): the normal equations, their diagonal enlarged by ``damping`` of it.

    Each initial state appears in one segment only, so they are eliminated one by one.
    """
    if not all(np.isfinite(part).all() for block in blocks for part in block):
        raise linalg.LinAlgError("a prediction diverges")
    H, g = sum(block[0] for block in blocks), sum(block[3] for block in blocks)
    H[np.diag_indices_from(H)] *= 1 + damping
    inverses = [np.linalg.inv(Hxx * (1 + damping * np.eye(Hxx.shape[-1]))) for _, _, Hxx, _, _ in blocks]
    for inverse, (_, Hwx, _, _, gx) in zip(inverses, blocks):
        H = H - np.einsum("bpi,bqi->pq", Hwx @ inverse, Hwx, optimize=True)
        g = g - np.einsum("bpi,bi->p", Hwx @ inverse, gx)
    size = np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
    step = linalg.cho_solve(linalg.cho_factor(H / np.outer(size, size)), g / size) / size if len(g) else g
    rests = [gx - step @ Hwx for _, Hwx, _, _, gx in blocks]
    return step, [(inverse @ rest[:, :, None])[:, :, 0].T for inverse, rest in zip(inverses, rests)]
