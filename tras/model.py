"""Identified models: fit, simulate, score, report (paper, Algorithm of Sec. IV and "Model Comparison")."""

import itertools
import math

import numpy as np
from scipy import linalg
from sklearn.base import BaseEstimator, clone

from tras import dictionary as dictionaries
from tras import export, export_c, export_mat, formulas, generator, koopman, metrics, rollout, scaling, stability, storage, streaming, summary
from tras.leastsquares import StreamingLeastSquares
from tras.recording import Recording, join
from tras.regularization import METHODS, STRENGTHS, regularized
from tras.selection import hold_out, multi_step_error
from tras.threads import processors

OPTIONS = {
    "predictor": ("vector_field", "one_step", "lifted_linear"),
    "field": ("coordinates", "least_squares"),
    "regularization": (*METHODS, None),
    "extrapolation": ("linear", "functions"),
    "columns": ("all", "states"),
}


class KoopmanModel(BaseEstimator):
    """A model identified by extended dynamic mode decomposition (EDMD).

    Channels are scaled to [-1, 1] over the training data, lifted by the dictionary, and the Koopman matrix K is fitted to all
    snapshot pairs (14). Then, by ``predictor``:

    ``"vector_field"``
        The paper's three steps: A = log(K) / dt (15), ``F(x, u) = W psi(x, u)``, and F is integrated, the input held over each
        sample.
    ``"one_step"``
        The states' columns of K give the next state; it is lifted again at each sample. Needs no logarithm.
    ``"lifted_linear"``
        The dictionary is of the states alone; they are lifted once and then ``z+ = A z + B u`` (Korda and Mezic 2018). Linear, so
        ready for linear control, but it cannot represent products of states and inputs.

    Parameters
    ----------
    dictionary : Dictionary
        For example ``Mechanical()`` for a mechanical system whose torques are known, ``Monomials(2)`` or ``GaussianRBF(100, width="auto",
        centres="kmeans")`` for one of which nothing is known. It is cloned, never changed.
    predictor : {"vector_field", "one_step", "lifted_linear"}
    delays : int
        Earlier samples of the states that count as states too, for recordings in which not all states are measured. The discrete
        predictors also take the earlier inputs; with ``vector_field`` they cannot (they would have the eigenvalue zero).
    field : {"coordinates", "least_squares"}
        How W is had from A for ``vector_field``: from the states' columns of A, or from equation (18) over all points, as in the
        paper. They agree where the dictionary's span is invariant (with ``least_squares``, ``field_disagreement_`` says how far they are
        apart). Elsewhere (18) asks every function's equation to hold, and the projection error of all of them leaks into F; the
        states' columns carry only their own. For large N (18) also takes several times as long as K itself.
    regularization : {"shrink", "tikhonov", "truncated", "sparse", None}
        See `tras.regularization.regularized`; None is plain least squares, as in the paper.
    strength : "auto" or float
        ``"auto"`` tries 0 and six more, and keeps the one whose roll-outs of up to 501 samples on every fifth trajectory, not fitted
        meanwhile, are best; one-step errors would not show what runs away. Recordings of fewer than five trajectories are cut for it.
    extrapolation : {"linear", "functions"}
        Beyond the training data the functions of a dictionary are guesswork. ``"linear"`` keeps them at the data's edge and goes on
        linearly and damped, so that predictions stay bounded (`tras.rollout.Hull`; with `Mechanical`, whose functions of inputs and velocities
        are sound anywhere, only in the positions); ``"functions"`` trusts them.
    stable : bool or float
        With ``lifted_linear``: keep the spectral radius of A at most one, or at most this number (`tras.stability`). A radius of one bounds the
        powers of A; the response to bounded inputs is bounded below one only. ``1 - dt / tau`` makes every mode forget in about the time tau.
    columns : {"all", "states"}
        With ``one_step``: ``"states"`` fits the states' columns of K alone, which is all that its predictions need, at half the cost; the
        others, and so eigenvalues, are not known then.

    Attributes
    ----------
    koopman_matrix : (N, N) ndarray
        K of (14), in scaled channels; with ``lifted_linear`` the A of ``z+ = A z + B u`` transposed; with ``columns="states"`` (N, states).
    generator : (N, N) ndarray
        A of (15) in 1/s; only for ``vector_field``.
    eigenvalues : (N,) complex ndarray
        Of K, largest modulus first; do not depend on units.
    condition_number : float
        Of the matrix of liftings on scaled channels. Coefficients are good to about this times 1e-16.
    rank_ : int
        Its numerical rank, at most N.
    strength_ : float
        The strength used.
    errors_ : dict
        With ``strength="auto"``: strength -> multi-step error (root mean square in half-ranges, a sample counts 10 at most).

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> u = rng.uniform(-1, 1, (20, 101, 1))
    >>> x = np.zeros((20, 101, 1))
    >>> for k in range(100):  # x' = -x + u, sampled at 0.1 s
    ...     x[:, k + 1] = np.exp(-0.1) * x[:, k] + (1 - np.exp(-0.1)) * u[:, k]
    >>> model = KoopmanModel(dictionaries.Monomials(1)).fit(Recording(x, u, 0.1))
    >>> model.vector_field([0.5], [0.0]).round(6)
    array([-0.5])
    """

    def __init__(
        self,
        dictionary=None,
        predictor="vector_field",
        delays=0,
        *,
        field="coordinates",
        regularization="shrink",
        strength="auto",
        extrapolation="linear",
        stable=False,
        columns="all",
    ):
        self.dictionary = dictionary
        self.predictor = predictor
        self.delays = delays
        self.field = field
        self.regularization = regularization
        self.strength = strength
        self.extrapolation = extrapolation
        self.stable = stable
        self.columns = columns

    # ------------------------------------------------------------------------------------------------------------ fitting

    def fit(self, recording, y=None, **streamed):
        """Identify from a `Recording`, or a sequence of recordings with the same channels.

        The path of a file, `Recording.open(path)`, an `xarray.Dataset` of such a file, an iterator of recordings, or a callable that returns one: these
        may be larger than memory. See
        `tras.streaming.fit` for them, and for the options ``ranges, checkpoint, chunk, progress, every, scheduler, parts, threads``.

        Raises
        ------
        ValueError
            On an unknown option, a constant channel, too few snapshot pairs, channels or functions that are linearly dependent on the data.
        LogarithmError
            (a ValueError) If K has no principal logarithm.
        """
        self._check_options()
        return streaming.fit(self, recording, **streamed)

    def _begin(self, recording, ranges=None):
        """Scales and dictionary from the recording, or scales from ``ranges``; no rows yet."""
        if recording.pairs == 0:
            raise ValueError("no trajectory has two samples, so there are no snapshot pairs; record more.")
        for name in [name for name in vars(self) if name.endswith("_") or name in ("koopman_matrix", "generator", "condition_number")]:
            delattr(self, name)  # what an earlier fit found
        self._remember(recording, ranges)
        x, u = (np.concatenate(part) for part in zip(*self._scaled(recording)))
        self.dictionary_ = clone(self.dictionary).fit(x, u if self._lifts_inputs else None)
        self.names_ = self.dictionary_.feature_names(self._channels(inputs=self._lifts_inputs))
        self.fitted_as_ = (self.predictor, self.delays)
        held = len(u) < 2 or np.mean((u[1:] == u[:-1]).all(axis=1)) > 0.5
        self._shares = held or not self._lifts_inputs  # whether a pair's second lifting is mostly the next pair's first
        self._solver = StreamingLeastSquares()
        return self

    def partial_fit(self, recording, y=None):
        """Go on with more data: K is then the one of all recordings so far. Scales and centres stay those of the first recording.

        Raises
        ------
        ValueError
            With ``field="least_squares"``, which needs all data at once, and as for `fit`.
        """
        if not hasattr(self, "koopman_matrix"):
            return self.fit(recording)
        if self.field == "least_squares" and self.predictor == "vector_field":
            raise ValueError("field is 'least_squares', which needs all data at once; use field='coordinates', or fit.")
        if not hasattr(self, "_solver"):
            raise ValueError("this model comes from a file, which keeps what was found and not the data; fit anew.")
        return self._learn(self._same_channels(join(recording)))

    def _learn(self, recording, threads=None):
        scaled = self._scaled(recording)
        train, held = hold_out(scaled) if self._chooses else (scaled, None)
        self._absorb(train, threads)
        return self._conclude(scaled, held, threads)

    def _conclude(self, scaled, held, threads=None):
        """The strength by ``held``, which was not absorbed yet, if there is any; then the solution of all rows."""
        strength = 0.0 if self.regularization is None or self.strength == "auto" else float(self.strength)
        if held is not None:
            strength = self._choose_strength(scaled, held)
            self._absorb(held, threads)
        self._solve(strength, scaled)
        return self

    @property
    def _lifts_inputs(self):
        return self.predictor != "lifted_linear"

    @property
    def _chooses(self):
        return self.regularization is not None and self.strength == "auto" and self._tail > 0

    @property
    def _tail(self):
        """Number of functions behind constant, states and inputs."""
        return len(self.names_) - len(self.dictionary_.coordinates) - 1 - self._lifts_inputs * len(self.input_names_)

    def _absorb(self, scaled, threads=None, most=None):
        """All snapshot pairs of scaled trajectories, or the first ``most`` blocks of them."""
        rows = koopman.lifted_linear_rows if not self._lifts_inputs else koopman.rows if self.columns == "all" else koopman.state_rows
        blocks = koopman.snapshot_pairs(scaled, koopman.block_size(self.dictionary_), deal=koopman.SUIT if self._shares else 1)
        blocks = map(self._widen_hull, itertools.islice(blocks, most))
        lift, regressors = koopman.lifting(self.dictionary_, rows), koopman.regressors_alone(self.dictionary_, rows)
        self._solver.update_lifted(blocks, lift, threads or processors(), regressors)

    def _widen_hull(self, block):
        if self.extrapolation == "linear" and self._lifts_inputs and self._tail:
            z = np.hstack(block[:2]).T
            if hasattr(self, "hull_"):
                self.hull_.widen(z)
            else:
                self.hull_ = rollout.Hull(z, self.dictionary_.confined)
        return block

    def _choose_strength(self, scaled, held):
        self.errors_ = {}
        for strength in STRENGTHS:
            try:
                with np.errstate(over="ignore", invalid="ignore"):  # what runs away is counted, not warned of
                    self._solve(strength, scaled)
                    self.errors_[strength] = multi_step_error(self._predict_scaled(held), held, len(self.state_names_))
            except ValueError as error:  # no logarithm, or functions that depend on each other: a stronger one may do
                self.errors_[strength], reason = math.inf, error
        best = min(self.errors_, key=self.errors_.get)
        if math.isinf(self.errors_[best]):
            raise reason
        return best

    def _solve(self, strength, scaled):
        """Everything that follows from the rows so far: K, the generator, W, the slopes beyond the hull."""
        vars(self).pop("refinement_", None)  # of a W that is replaced now (`tras.refine`)
        fit = self._solver.solve(self._regressor_names())
        head = len(fit.R) - self._tail
        koopman.check_head(fit, head)
        if strength == 0:
            fit.require_full_rank()
        D = fit.coefficients if strength == 0 else regularized(self.regularization, fit.R, fit.rotated, head)(strength)
        self.condition_number, self.rank_, self.residual_, self.pairs_ = fit.condition_number, fit.rank, fit.residual, fit.rows
        self.strength_ = strength
        N, n, m = len(self.names_), len(self.dictionary_.coordinates), len(self.input_names_)
        if self._lifts_inputs:
            self.koopman_matrix = (np.eye(N) if self.columns == "all" else np.eye(N)[:, 1 : 1 + n]) + D
        else:
            if self.stable:
                D = stability.stable_change(fit, D, n, m, radius=float(self.stable))
            inputs = np.arange(len(D)) - 1 - n
            of_inputs = (inputs >= 0) & (inputs < m)
            self.koopman_matrix, self.B_ = np.eye(N) + D[~of_inputs], np.ascontiguousarray(D[of_inputs].T)
        if hasattr(self, "hull_"):
            states = slice(1, 1 + n) if self.columns == "all" else slice(None)
            change = np.zeros((head, 1 + n))
            change[:, 1:] = linalg.solve_triangular(fit.R[:head, :head], fit.rotated[:head, states], check_finite=False)
            self.outward_ = rollout.outward_rates(change, n, self.dt_, len(self.state_names_))
            self.outward_step_ = rollout.over_a_sample(self.outward_, self.dt_)
        if self.predictor == "vector_field":
            self._identify_field(scaled, fit.R)

    def _identify_field(self, scaled, R):
        """The second and third step of the method: the generator, then W."""
        logarithm, self.log_residual_ = generator.principal_logarithm(self.koopman_matrix)
        self.generator = logarithm / self.dt_
        self.W_ = generator.field_by_coordinates(self.generator, self.dictionary_)
        if self.field == "least_squares":
            by_coordinates, self.W_ = self.W_, generator.field_by_least_squares(self.generator, self.dictionary_, scaled, R)
            # R is a square root of Psi_x^T Psi_x, so |W R^T| is the root mean square of W psi over the data, up to a factor.
            size = np.linalg.norm(by_coordinates @ R.T, axis=1)
            self.field_disagreement_ = np.linalg.norm((self.W_ - by_coordinates) @ R.T, axis=1) / size
        x, u = (np.concatenate(part) for part in zip(*scaled))
        some = np.linspace(0, len(x) - 1, min(len(x), 2000)).astype(int)
        self.substeps_ = rollout.enough_substeps(self._field, x[some].T, u[some].T, self.dt_)

    # --------------------------------------------------------------------------------------------------------- predicting

    @property
    def eigenvalues(self):
        """Eigenvalues of K, largest modulus first."""
        self._require_all_columns()
        eigenvalues = linalg.eigvals(self.koopman_matrix)
        return eigenvalues[np.lexsort((-eigenvalues.imag, -np.abs(eigenvalues)))]

    def lift(self, x, u=None):
        """``psi(x, u)`` of states (..., n) and inputs (..., m) in physical units -> (..., N); with ``lifted_linear`` of the states alone."""
        self._fitted()
        u = np.zeros((*np.shape(x)[:-1], len(self.input_names_))) if u is None and not self._lifts_inputs else u
        x, u = self._points(x, u)
        return self.dictionary_(x, u) if self._lifts_inputs else self.dictionary_(x)

    def vector_field(self, x, u=None):
        """The identified ``dx/dt = F(x, u)`` in physical units: (..., n), (..., m) -> (..., n). Only for ``vector_field``.

        With delays ``x`` holds the newest sample first, then the earlier ones: (..., n (delays + 1)).
        """
        self._fitted()
        if self.predictor != "vector_field":
            raise ValueError(f"predictor is {self.predictor!r}, which has no vector field; fit with predictor='vector_field'.")
        x, u = self._points(x, u)
        z = np.concatenate([x.reshape(-1, x.shape[-1]), u.reshape(-1, u.shape[-1])] if u.shape[-1] else [x.reshape(-1, x.shape[-1])], axis=1)
        return self._field(z.T).T.reshape(x.shape) * self._z_scale

    def simulate(self, x0, inputs):
        """Roll out from ``x0`` under ``inputs``, one sample of which acts from its own instant to the next.

        Parameters
        ----------
        x0 : (..., n) array_like
            With delays the first ``delays + 1`` samples, (..., delays + 1, n); the prediction starts at the last of them.
        inputs : (..., samples, m) array_like
            From the first sample of ``x0`` on. ``m = 0`` (autonomous): an empty array of shape (samples, 0).

        Returns
        -------
        (..., samples, n) ndarray
            Begins with ``x0``. A prediction that leaves the training data's range a thousandfold is abandoned: NaN from there on.

        Raises
        ------
        ValueError
            On wrong shapes or non-finite values.
        """
        self._fitted()
        x0, inputs = np.asarray(x0, dtype=float), np.asarray(inputs, dtype=float)
        n, m, d = len(self.state_names_), len(self.input_names_), self.delays
        states, wanted = ", ".join(self.state_names_), ", ".join(self.input_names_) or "no inputs"
        x0 = x0[..., None, :] if not d and x0.ndim else x0
        if x0.ndim < 2 or x0.shape[-2:] != (d + 1, n):
            shape = x0.shape if d else x0.shape[:-2] + x0.shape[-1:]
            needed = f"(..., {d + 1}, {n}), the first {d + 1} samples of" if d else f"(..., {n}):"
            raise ValueError(f"x0 has shape {shape}; give {needed} {states}.")
        if inputs.ndim < 2 or inputs.shape[-1] != m or inputs.shape[-2] < d + 1:
            raise ValueError(f"inputs has shape {inputs.shape}; give (..., samples, {m}), {d + 1} samples or more: {wanted}.")
        if not (np.isfinite(x0).all() and np.isfinite(inputs).all()):
            raise ValueError("x0 or inputs holds NaN or infinity; repair them first.")
        batch = np.broadcast_shapes(x0.shape[:-2], inputs.shape[:-2])
        runs, samples = math.prod(batch), inputs.shape[-2]
        x = np.broadcast_to((x0 - self.x_offset_) / self.x_scale_, (*batch, d + 1, n)).reshape(runs, d + 1, n)
        u = np.broadcast_to((inputs - self.u_offset_) / self.u_scale_, (*batch, samples, m)).reshape(runs, samples, m)
        result = self._simulate_scaled(x, u) * self.x_scale_ + self.x_offset_
        result[:, : d + 1] = np.broadcast_to(x0, (*batch, d + 1, n)).reshape(runs, d + 1, n)
        return result.reshape(*batch, samples, n)

    def predict(self, recording):
        """Roll out every trajectory from its own first state under its own inputs; shaped like ``recording.states``."""
        self._fitted()
        recording = self._same_channels(join(recording))
        d = self.delays
        lengths = recording.lengths
        if lengths.min() < d + 1:
            raise ValueError(f"a trajectory has {lengths.min()} samples but {d} delays need {d + 1}; leave it out.")
        longest = np.zeros((len(recording), lengths.max(), recording.m))
        for padded, (_, u) in zip(longest, recording):
            padded[: len(u)] = u
        start = np.stack([x[: d + 1] for x, _ in recording])
        states = self.simulate(start if d else start[:, 0], longest)
        return states if np.all(lengths == lengths[0]) else [x[:k] for x, k in zip(states, lengths)]

    def score(self, recording, y=None):
        """``-mean(NRMSE)`` over the states, in percent, of the roll-outs; ``-inf`` if one of them diverges."""
        recording = join(recording)
        predicted = self.predict(recording)
        true = self._same_channels(recording).states
        if metrics.diverged(true, predicted).any():
            return -np.inf
        return -float(np.mean(metrics.nrmse(true, predicted)))

    def report(self, recording=None):
        """What the fit found, in a few lines of text; with a recording, also how well it predicts that.

        Parameters
        ----------
        recording : Recording, optional
            Best one that was not fitted.
        """
        self._fitted()
        return summary.describe(self, None if recording is None else self._same_channels(join(recording)))

    def save(self, path):
        """Write to ``path`` (.npz: plain arrays and one JSON header, no pickle). Same model, same bytes."""
        self._fitted()
        storage.save(self, path)

    def export_mat(self, path):
        """Write the model to ``path`` (.mat) and functions for MATLAB and GNU Octave beside it; see docs/export.md. Returns all paths."""
        return export_mat.export_mat(self, path)

    def export_c(self, path):
        """Write the one-step predictor as C99 to ``path`` (.c) and a header beside it; see docs/export.md. Returns both paths."""
        return export_c.export_c(self, path)

    def formulas(self, recording=None, *, tolerance=1e-3, latex=False):
        """The vector field, or with ``one_step`` the next states, as formulas in physical units: Python's arithmetic, or LaTeX.

        Terms that change a row, over the recording or else the box around the training data, by less than the tolerance (a fraction of
        its root mean square, with ``one_step`` of the change in a sample) are left out and counted; numbers have as many digits as it takes.
        """
        return formulas.formulas(self, recording, tolerance=tolerance, latex=latex)

    def to_statespace(self):
        """With ``lifted_linear``: ``z+ = A z + B u``, ``x = C z`` with the liftings z as states, z0 = ``lift(x0)``, u and x in physical units.

        The constant function is the first state, with the eigenvalue one; offsets are in its column. A `control.StateSpace` if python-control
        is installed, a named tuple ``(A, B, C, D, dt)`` otherwise.
        """
        return export.to_statespace(self)

    # ------------------------------------------------------------------------------------------------------------- inside

    def _check_options(self):
        for name, allowed in OPTIONS.items():
            value = getattr(self, name)
            if value not in allowed:
                raise ValueError(f"{name} is {value!r}; choose one of {', '.join(map(str, allowed))}.")
        if not isinstance(self.dictionary, dictionaries.Dictionary):
            raise ValueError(f"dictionary is {self.dictionary!r}; give one, for example tras.Monomials(2).")
        if isinstance(self.delays, bool) or not isinstance(self.delays, (int, np.integer)) or self.delays < 0:
            raise ValueError(f"delays is {self.delays!r}; give a whole number, 0 or more.")
        number = isinstance(self.strength, (int, float)) and not isinstance(self.strength, bool)
        if self.strength != "auto" and not (number and 0 <= self.strength < math.inf):
            raise ValueError(f"strength is {self.strength!r}; give 'auto' or a number that is not negative.")
        if not isinstance(self.stable, (bool, int, float)) or not 0 <= self.stable <= 1:
            raise ValueError(f"stable is {self.stable!r}; give True, False, or a spectral radius between 0 and 1, for example 0.999.")
        if self.columns == "states" and self.predictor != "one_step":
            raise ValueError(f"columns='states' needs predictor='one_step', but it is {self.predictor!r}, which needs all of K; use columns='all'.")
        if self.stable and self.predictor != "lifted_linear":
            raise ValueError(f"stable={self.stable!r} needs predictor='lifted_linear', but it is {self.predictor!r}.")

    def _remember(self, recording, ranges=None):
        """Names, units, sampling time and the scale of each channel: its middle and half-range, over the recording or as given."""
        self.dt_ = recording.dt
        for role in ("state", "input"):
            for kind in ("names", "units"):
                setattr(self, f"{role}_{kind}_", tuple(getattr(recording, f"{role}_{kind}")))
        ranges = ranges or scaling.ranges_of(recording)
        self.x_offset_, self.x_scale_ = scaling.middle_and_half(ranges, self.state_names_)
        self.u_offset_, self.u_scale_ = scaling.middle_and_half(ranges, self.input_names_)

    @property
    def _keeps_inputs(self):
        """Whether earlier inputs are among the delayed states."""
        return self.delays > 0 and self.predictor != "vector_field" and len(self.input_names_) > 0

    @property
    def _z_scale(self):
        return self._delayed(self.x_scale_, self.u_scale_)

    def _delayed(self, of_states, of_inputs):
        return np.concatenate([np.tile(of_states, self.delays + 1), np.tile(of_inputs, self.delays * self._keeps_inputs)])

    def _channels(self, inputs):
        names = list(self.state_names_)
        names += [f"{name}[-{k + 1}]" for k in range(self.delays) for name in self.state_names_]
        names += [f"{name}[-{k + 1}]" for k in range(self.delays * self._keeps_inputs) for name in self.input_names_]
        return names + (list(self.input_names_) if inputs else [])

    def _regressor_names(self):
        if self._lifts_inputs:
            return self.names_
        head = 1 + len(self.dictionary_.coordinates)
        return [*self.names_[:head], *self.input_names_, *self.names_[head:]]

    def _points(self, x, u):
        """Scaled copies of states, delayed if need be, and inputs in physical units."""
        x = np.asarray(x, dtype=float)
        u = np.empty((*x.shape[:-1], 0)) if u is None else np.asarray(u, dtype=float)
        offset = self._delayed(self.x_offset_, self.u_offset_)
        if x.ndim == 0 or x.shape[-1] != len(offset) or u.shape != (*x.shape[:-1], len(self.input_names_)):
            raise ValueError(
                f"x has shape {x.shape} and u {u.shape}; give (..., {len(offset)}) and (..., {len(self.input_names_)}) with the same leading axes."
            )
        return (x - offset) / self._z_scale, (u - self.u_offset_) / self.u_scale_

    def _scaled(self, recording):
        """The recording in scaled channels, delayed samples among the states."""
        scaled = [((x - self.x_offset_) / self.x_scale_, (u - self.u_offset_) / self.u_scale_) for x, u in recording]
        return Recording(*map(list, zip(*scaled)), recording.dt).delayed(self.delays, inputs=self._keeps_inputs)

    def _same_channels(self, recording):
        """The recording with the model's channels in the model's order."""
        recording = recording.select(states=self.state_names_, inputs=self.input_names_)
        if abs(recording.dt - self.dt_) > 1e-9 * self.dt_:
            raise ValueError(f"the recording is sampled at {recording.dt:g} s but the model at {self.dt_:g} s; resample or fit again.")
        return recording

    def _fitted(self):
        if not hasattr(self, "koopman_matrix"):
            raise ValueError("the model is not fitted; call fit(recording) first.")
        if (self.predictor, self.delays) != self.fitted_as_:
            raise ValueError(
                f"predictor and delays are {(self.predictor, self.delays)} but the model was fitted with {self.fitted_as_}; fit it again."
            )

    def _field(self, point):
        """Scaled rates (n', points) at (n' + m, points): W psi in the hull, linear beyond."""
        if not hasattr(self, "hull_"):
            return self.W_ @ self.dictionary_.lift(point)
        near = self.hull_.nearest(point)
        rates = self.W_ @ self.dictionary_.lift(near)
        return rates if near is point else rates + self.outward_ @ (point - near)

    def _step(self, point):
        """Scaled states one sample later by the states' columns of K."""
        near = self.hull_.nearest(point) if hasattr(self, "hull_") else point
        later = self._states_columns.T @ self.dictionary_.lift(near)
        return later if near is point else later + self.outward_step_ @ (point - near)

    @property
    def _states_columns(self):
        """(N, n') of K."""
        return self.koopman_matrix if self.columns == "states" else self.koopman_matrix[:, 1 : 1 + len(self.dictionary_.coordinates)]

    def _require_all_columns(self):
        self._fitted()
        if self.columns == "states":
            raise ValueError("columns is 'states', so the other columns of K and its eigenvalues are not known; fit with columns='all'.")

    def _advance(self, z, u):
        """One sample: (n', batch), (m, batch) -> (n', batch), scaled. What is known of the earlier samples is shifted, not predicted."""
        if self.predictor == "one_step":
            later = self._step(np.concatenate([z, u]))
        else:
            later = rollout.runge_kutta(self._field, z, u, self.dt_, self.substeps_)
        if self.delays:
            n, m, d = len(self.state_names_), len(u), self.delays
            later[n : n * (d + 1)] = z[: n * d]
            if self._keeps_inputs:
                past = n * (d + 1)
                later[past : past + m], later[past + m :] = u, z[past:-m]
        return later

    def _predict_scaled(self, delayed):
        """Roll-outs (samples, n', trajectories) of scaled trajectories, delays among the states, all of one length."""
        z, u = delayed.states[:, 0].T, delayed.inputs.transpose(1, 2, 0)
        if self.predictor == "lifted_linear":
            A, B, rows = self.koopman_matrix.T, self.B_, self.dictionary_.coordinates
            return rollout.roll_out(lambda s, v: A @ s + B @ v, self.dictionary_.lift(z), u, lambda s: s[rows])
        return rollout.roll_out(self._advance, z, u)

    def _simulate_scaled(self, x, u):
        """(runs, samples, n) from scaled first samples (runs, delays + 1, n) and inputs (runs, samples, m)."""
        d = self.delays
        parts = [x[:, ::-1].reshape(len(x), -1)] + ([u[:, :d][:, ::-1].reshape(len(u), -1)] if self._keeps_inputs else [])
        z = np.concatenate(parts, axis=1)
        # Only the first state matters; as a recording it would be checked for nothing.
        start = Recording._of_arrays(np.repeat(z[:, None], 1, axis=1), u[:, d:], self.dt_)
        states = self._predict_scaled(start)[:, : len(self.state_names_)]
        return np.concatenate([x[:, :d], states.transpose(2, 0, 1)], axis=1)
