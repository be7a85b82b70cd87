"""Identified models: fit, simulate, score, report (paper, Algorithm of Sec. IV and "Model Comparison")."""

import contextlib
import copy
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg
from sklearn.base import clone

from tras import model_file, summary
from tras.analysis import linearization
from tras.dictionaries.base import Dictionary
from tras.estimator import Estimator
from tras.hull import over_a_sample
from tras.large import streaming
from tras.large.slices import RecordingFile
from tras.metrics import multi_step_error
from tras.predictors import PREDICTORS, Map
from tras.recording import Recording
from tras.regularization import METHODS, ROUNDS, STRENGTHS, unsettled
from tras.solver.threads import few_blas_threads, one_blas_thread
from tras.workflow import arguments

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OPTIONS = {
    "predictor": tuple(PREDICTORS),
    "field": ("coordinates", "least_squares"),
    "regularization": (*METHODS, None),
    "extrapolation": ("linear", "functions"),
    "columns": ("all", "states"),
    "lead": (0, 1),
}
# What a model is fitted to: a recording or several, or what `tras.large.streaming` reads piece by piece.
Source = Recording | RecordingFile | str | Path | Iterable | Callable[[], Iterable]
_LEARNT = ("koopman_matrix", "generator", "condition_number")  # by a fit, beside what ends in an underscore


class KoopmanModel(Estimator):
    """A model identified by extended dynamic mode decomposition (EDMD).

    Channels are scaled to [-1, 1] over the training data and lifted by the dictionary, and the Koopman matrix K is
    fitted to all snapshot pairs (14). Then, by ``predictor`` (see `tras.predictors`):

    ``"vector_field"``
        The paper's three steps: A = log(K) / dt (15), ``F(x, u) = W psi(x, u)``, and F is integrated while the input is
        held.
    ``"one_step"``
        The states' columns of K give the next state, which is lifted again. Needs no logarithm.
    ``"lifted_linear"``
        The dictionary is of the states alone; they are lifted once and then ``z+ = A z + B u``. Ready for linear
        control, but it cannot represent products of states and inputs.

    Parameters
    ----------
    dictionary : Dictionary
        For example ``Mechanical()`` for a mechanical system whose torques are known, ``Monomials(2)`` or
        ``GaussianRBF(100, width="auto", centres="kmeans")`` for an unknown one. It is cloned, never changed.
    predictor : {"vector_field", "one_step", "lifted_linear"}
    delays : int
        Number of earlier samples of the states that count as states too, for recordings in which not all states are
        measured. The discrete predictors also take the earlier inputs.
    field : {"coordinates", "least_squares"}
        For ``vector_field``: W comes from the states' columns of A, or from equation (18) over all points, as in the
        paper. They agree where the dictionary's span is invariant (``field_disagreement_`` says how far they are
        apart). Elsewhere (18) lets the projection error of all functions leak into F, and it is slow for large N.
    regularization : {"shrink", "tikhonov", "truncated", "sparse", None}
        See `tras.regularization.regularized`; None is plain least squares, as in the paper.
    strength : "auto" or float
        ``"auto"`` tries 0 and six more and keeps the one with the best roll-outs of up to 501 samples on every fifth
        trajectory, not fitted meanwhile. Recordings of fewer than five trajectories are cut for it.
    extrapolation : {"linear", "functions"}
        Beyond the training data the functions are guesswork. ``"linear"`` keeps them at the data's edge and goes on
        linearly and damped, so that predictions stay bounded (`tras.hull.Hull`); ``"functions"`` trusts them.
    stable : bool or float
        With ``lifted_linear``: keep the spectral radius of A at most one, or at most this number
        (`tras.solver.stability`). The response to bounded inputs is bounded below one only; ``1 - dt / tau`` makes
        every mode forget in about the time tau.
    columns : {"all", "states"}
        With ``one_step``: ``"states"`` fits the states' columns of K alone, at half the cost; its predictions need no
        others, but eigenvalues do.
    lead : {0, 1}
        Which recorded input acts from one sample to the next: that of the first of the two (0, a zero-order hold), or
        that of the second (1), as in recordings whose input was measured, filtered or stamped at the end of a sample.
    horizon : int
        With ``one_step``: the samples over which predictions are fitted. 1 is least squares, the fit of single steps;
        with more the states' columns of K go on from there, by Gauss-Newton steps, to those whose predictions over so
        many samples miss least (`tras.solver.prediction_error`). The other columns stay. Of states times functions
        there may be twice ``max_functions``.
    max_functions : int
        More functions are refused before anything is lifted: time grows with their cube, memory with their square, and
        a degree, delays and many channels multiply. A thousand take up to a minute and 0.6 GB. With ``stable`` half as
        many are allowed, with ``"sparse"`` a sixth, whose searches take longer.

    Attributes
    ----------
    koopman_matrix : (N, N) ndarray
        K of (14), in scaled channels; with ``lifted_linear`` the A of ``z+ = A z + B u`` transposed; with
        ``columns="states"`` (N, states).
    generator : (N, N) ndarray
        A of (15) in 1/s; only for ``vector_field``.
    eigenvalues : (N,) complex ndarray
        Of K, largest modulus first; they do not depend on units.
    condition_number : float
        Of the matrix of liftings on scaled channels. Coefficients are good to about this times 1e-16.
    rank_ : int
        Its numerical rank, at most N.
    strength_ : float
        The strength used.
    substeps_ : int
        Runge-Kutta steps per sample, for ``vector_field``: so many that twice as many move no prediction over one
        sample by 1e-8 of a half-range, 64 at most. With more than 128 functions the misfit decides: twice as many move
        99 predictions of 100 by less than a hundredth of it; 8 to 16, or fewer if 1e-8 is met. A larger number may be
        assigned.
    unsettled_ : list of str
        Searches of `fit` that ended by their count of iterations, one sentence each; empty when all came to their end.
    errors_ : dict
        With ``strength="auto"``: strength -> multi-step error (root mean square in half-ranges, a sample counts 10 at
        most).

    Examples
    --------
    >>> import numpy as np, tras
    >>> rng = np.random.default_rng(0)
    >>> u = rng.uniform(-1, 1, (20, 101, 1))
    >>> x = np.zeros((20, 101, 1))
    >>> for k in range(100):  # x' = -x + u, sampled at 0.1 s
    ...     x[:, k + 1] = np.exp(-0.1) * x[:, k] + (1 - np.exp(-0.1)) * u[:, k]
    >>> model = KoopmanModel(tras.Monomials(1)).fit(tras.Recording(x, u, 0.1))
    >>> model.vector_field([0.5], [0.0]).round(6)
    array([-0.5])
    """

    koopman_matrix: np.ndarray
    generator: np.ndarray
    condition_number: float
    rank_: int
    strength_: float
    substeps_: int
    unsettled_: list[str]
    errors_: dict[float, float]
    dictionary_: Dictionary
    names_: list[str]
    pairs_: int

    def __init__(
        self,
        dictionary: Dictionary | None = None,
        predictor: str = "vector_field",
        delays: int = 0,
        *,
        field: str = "coordinates",
        regularization: str | None = "shrink",
        strength: float | str = "auto",
        extrapolation: str = "linear",
        stable: float | bool = False,
        columns: str = "all",
        lead: int = 0,
        horizon: int = 1,
        max_functions: int = 1000,
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
        self.lead = lead
        self.horizon = horizon
        self.max_functions = max_functions

    def fit(self, recording: Source, y: None = None, **streamed) -> "KoopmanModel":
        """Identify from a `Recording`, or a sequence of recordings with the same channels.

        It may be larger than memory: the path of a file, `tras.open_recording(path)`, an `xarray.Dataset` of such a
        file, an iterator of recordings, or a callable that returns one. See `tras.large.streaming.absorb` for these,
        and for the options ``ranges, checkpoint, chunk, progress, every, scheduler, parts, threads``.

        Raises
        ------
        ValueError
            On an unknown option, a constant channel, too few snapshot pairs, more functions than ``max_functions``,
            channels or functions that depend on each other on the data.
        LogarithmError
            (a ValueError) If K has no principal logarithm.
        """
        self.check_options()
        with self._unchanged_on_failure(), one_blas_thread():
            return self._conclude(*streaming.absorb(self, recording, **streamed), streamed.get("threads"))

    def partial_fit(self, recording: Recording, y: None = None) -> "KoopmanModel":
        """Go on with more data: K is then the one of all recordings, scales and centres those of the first.

        If it fails, the model is what it was before, and so are the data that it goes on from.

        Raises
        ------
        ValueError
            With ``field="least_squares"`` or a ``horizon``, which need all data at once, and as for `fit`.
        """
        if not hasattr(self, "koopman_matrix"):
            return self.fit(recording)
        if self.field == "least_squares" and self.predictor == "vector_field":
            raise ValueError("field is 'least_squares', which needs all data at once; use field='coordinates', or fit.")
        if self.horizon > 1:
            raise ValueError(f"horizon is {self.horizon}, which needs all data at once; use horizon=1, or fit.")
        if not hasattr(self, "_fit"):
            raise ValueError("this model comes from a file, which keeps what was found and not the data; fit anew.")
        with self._unchanged_on_failure(), one_blas_thread():
            return self._conclude(*streaming.more(self._fit, self.channels_.matched(recording)))

    @contextlib.contextmanager
    def _unchanged_on_failure(self):
        """Around a fit: no K of one fit is left beside W of another, also when interrupted from the keyboard."""
        model, rows = dict(vars(self)), copy.copy(getattr(self, "_fit", None))
        try:
            yield
        except BaseException as error:
            vars(self).clear()
            vars(self).update(model)
            if rows is not None:
                vars(self._fit).update(vars(rows))
            if isinstance(error, np.linalg.LinAlgError):
                remedy = "a smaller dictionary, a larger strength of regularization or more data may do"
                raise ValueError(f"the linear algebra of this fit failed ({error}); {remedy}.") from error
            raise

    def _conclude(self, fit, scaled, held, threads=None):
        """The strength by ``held``, which was not absorbed yet, if there is any; then the solution of all rows."""
        if fit is not getattr(self, "_fit", None):
            learnt = [name for name in vars(self) if name.endswith("_") or name in _LEARNT]
            for name in learnt:  # by an earlier fit
                delattr(self, name)
        vars(self).pop("refinement_", None)  # of a W that is replaced now (`tras.refine`)
        self._fit, self.fitted_as_ = fit, (self.predictor, self.delays)
        self.channels_, self.dictionary_, self.names_ = fit.channels, fit.dictionary, fit.names
        strength = 0.0 if self.regularization is None or self.strength == "auto" else float(self.strength)
        if held is not None:
            strength = self._choose_strength(scaled, held)
            fit.absorb(held, threads)
        self._solve(strength, scaled)
        if self.horizon > 1:
            self._predictor.settle_over(self, scaled, self.horizon)
        return self

    def _choose_strength(self, scaled, held):
        self.errors_, reason = {}, None
        for strength in STRENGTHS:
            try:
                with np.errstate(over="ignore", invalid="ignore"):  # what runs away is counted, not warned of
                    self._solve(strength, scaled)
                    predicted = self._predictor.roll_out(self, held.states[:, 0].T, held.inputs.transpose(1, 2, 0))
                    self.errors_[strength] = multi_step_error(predicted, held, len(self.state_names_))
            except ValueError as error:  # no logarithm, or functions that depend on each other: a stronger one may do
                self.errors_[strength], reason = math.inf, error
        best = min(self.errors_, key=self.errors_.__getitem__)
        if reason is not None and math.isinf(self.errors_[best]):
            raise reason
        return best

    def _solve(self, strength, scaled):
        """Everything that follows from the rows so far: K, the generator, W, the slopes beyond the hull."""
        least_squares, D = self._fit.solve(self.regularization, strength)
        self.condition_number, self.rank_ = least_squares.condition_number, least_squares.rank
        self.residual_, self.pairs_, self.strength_ = least_squares.residual, least_squares.rows, strength
        self.hull_ = self._fit.hull
        self.outward_ = self.outward_step_ = None
        if self.hull_ is not None:
            self.outward_ = self._fit.outward(least_squares)
            self.outward_step_ = over_a_sample(self.outward_, self.dt_)
        self.unsettled_ = []
        if self.regularization == "sparse" and strength:
            count = unsettled(least_squares.R, least_squares.rotated, strength, D)
            how = f"ended after {ROUNDS} rounds, with terms below the threshold in {count} of {D.shape[1]} columns of K"
            self.unsettled_ += [f"sequential thresholding {how}"] * bool(count)
        with np.errstate(over="ignore", invalid="ignore"):  # a field that runs away is refused, or is NaN
            self._predictor.settle(self, D, least_squares, scaled)

    @property
    def _predictor(self):
        return PREDICTORS[self.predictor]

    @property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of K, largest modulus first."""
        self.require_all_columns()
        eigenvalues = np.asarray(linalg.eigvals(self.koopman_matrix))
        return eigenvalues[np.lexsort((-np.imag(eigenvalues), -np.abs(eigenvalues)))]

    def lift(self, x: ArrayLike, u: ArrayLike | None = None) -> np.ndarray:
        """``psi(x, u)``, or psi(x) with ``lifted_linear``: (..., n) and (..., m) in physical units -> (..., N)."""
        self.require_fitted()
        lifts_inputs = self._predictor.lifts_inputs
        u = np.zeros((*np.shape(x)[:-1], len(self.input_names_))) if u is None and not lifts_inputs else u
        x, u = self.channels_.points(x, u)
        return self.dictionary_(x, u) if lifts_inputs else self.dictionary_(x)

    def vector_field(self, x: ArrayLike, u: ArrayLike | None = None) -> np.ndarray:
        """The identified ``dx/dt = F(x, u)`` in physical units: (..., n), (..., m) -> (..., n).

        With delays ``x`` holds the newest sample first, then the earlier ones: (..., n (delays + 1)).
        """
        self.require_fitted()
        if self.predictor != "vector_field":
            raise ValueError(f"predictor is {self.predictor!r}, which has no vector field; fit with 'vector_field'.")
        x, u = self.channels_.points(x, u)
        z = np.concatenate([x, u], axis=-1).reshape(-1, x.shape[-1] + u.shape[-1])
        with np.errstate(over="ignore", invalid="ignore"):  # far away it may be infinite
            return self.map()(z.T).T.reshape(x.shape) * self.channels_.z_scale

    def map(self) -> Map:
        """The rates, or with ``one_step`` the next states, in scaled channels: a `tras.predictors.Map`."""
        self.require_fitted()
        return self._predictor.map(self)

    def linearize(self, x: ArrayLike | None = None, u: ArrayLike | None = None) -> Any:
        """The model about a point as a discrete linear system of small deviations, in physical units, for control.

        ``dz[k+1] = A dz[k] + B du[k]``, ``dx[k] = C dz[k]``: A and B are the Jacobian of the prediction over one sample
        while the input is held. At an equilibrium of ``vector_field`` that is the zero-order-hold discretisation of the
        field's Jacobian; elsewhere that of the motion from the point, whose drift the deviations do not have. The
        states are the model's, delayed samples of states and inputs behind them. A ``lifted_linear`` model is linear
        everywhere: its states are the liftings but the constant, and the point has no effect.

        With ``lead=1`` a state depends on the input of its own instant: D is not zero, and the system's state is z less
        what this input has moved, ``dz[k] - B du[k]``. A controller that feeds ``x[k]`` back to ``u[k]`` without a
        delay then closes an algebraic loop, which `control.feedback` solves.

        Parameters
        ----------
        x : (n,) or (n',) array_like, optional
            State; with delays also the newest sample first, then the earlier ones, then the earlier inputs. A state
            alone is taken to have been there before. Default: the middle of the data's range.
        u : (m,) array_like, optional
            Input. Default: the middle of its range.

        Returns
        -------
        control.StateSpace or StateSpace
            With python-control the former, with names of states, inputs and outputs (a dot in a name becomes "_");
            otherwise, and for a model without inputs, a named tuple ``(A, B, C, D, dt)``.

        Raises
        ------
        ValueError
            If the model is not fitted, on wrong shapes or values, or where its prediction runs away.

        Examples
        --------
        >>> import numpy as np, tras
        >>> x, u = np.random.default_rng(0).uniform(-1, 1, (2, 5, 20, 1))
        >>> model = tras.KoopmanModel(tras.Monomials(2), "one_step").fit(tras.Recording(x, u, 0.1))
        >>> system = model.linearize([0.2], [0.0])
        >>> system.A.shape, system.B.shape, system.C.shape, system.dt
        ((1, 1), (1, 1), (1, 1), 0.1)
        """
        with np.errstate(over="ignore", invalid="ignore"):  # what runs away is refused
            return linearization.linearize(self, x, u)

    def report(self, recording: Recording | None = None) -> str:
        """The fit in a few lines of text; also how well it predicts a recording, best one that was not fitted."""
        self.require_fitted()
        return summary.describe(self, None if recording is None else self.channels_.matched(recording))

    def _repr_html_(self):
        from tras.display import html

        return html.model_html(self)

    def _repr_mimebundle_(self, **options):
        """The report, in place of scikit-learn's diagram of the options, which is not about this fit."""
        bundle = {"text/plain": repr(self)}
        return bundle | {"text/html": self._repr_html_()} if hasattr(self, "koopman_matrix") else bundle

    def plot_spectrum(self, ax: "Axes | None" = None) -> "Figure":
        """Eigenvalues of K beside the unit circle, all and near one; in an ``ax`` of your own all.

        Raises
        ------
        ValueError
            If the model is not fitted, or was fitted with ``columns="states"``.

        Examples
        --------
        >>> import tras
        >>> recording = tras.Recording([[[0.9**k] for k in range(20)]], dt=0.1)
        >>> figure = KoopmanModel(tras.Monomials(1), "one_step").fit(recording).plot_spectrum()
        >>> [panel.get_title(loc="left") for panel in figure.axes]
        ['all', 'near one']
        """
        from tras.display import plots

        return plots.spectrum_figure(self, ax)

    def save(self, path: str | Path) -> None:
        """Write to ``path`` (.npz: plain arrays and one JSON header, no pickle). Same model, same bytes."""
        self.require_fitted()
        model_file.save(self, path)

    def check_options(self) -> None:
        """A ValueError on an option that does not exist or does not fit the others."""
        for name, allowed in OPTIONS.items():
            value = getattr(self, name)
            if value not in allowed:
                raise ValueError(
                    f"{name} is {arguments.short(repr(value), 60)}; choose one of {', '.join(map(str, allowed))}."
                )
        if not isinstance(self.dictionary, Dictionary):
            raise ValueError(f"dictionary is {self.dictionary!r}; give one, for example tras.Monomials(2).")
        arguments.whole_number("delays", self.delays, 0)
        arguments.whole_number("max_functions", self.max_functions)
        arguments.whole_number("horizon", self.horizon)
        if self.strength != "auto":
            arguments.number("strength", self.strength, 0, give="'auto' or a number that is not negative")
        if not isinstance(self.stable, (bool, int, float)) or not 0 <= self.stable <= 1:
            raise ValueError(
                f"stable is {arguments.short(repr(self.stable), 60)}; "
                "give True, False, or a spectral radius of 0 to 1, such as 0.999."
            )
        if self.columns == "states" and self.predictor != "one_step":
            raise ValueError(f"columns='states' needs predictor='one_step', but it is {self.predictor!r}; use 'all'.")
        if self.horizon > 1 and self.predictor != "one_step":
            raise ValueError(f"horizon={self.horizon} needs predictor='one_step', but it is {self.predictor!r}; use 1.")
        if self.stable and self.predictor != "lifted_linear":
            raise ValueError(f"stable={self.stable!r} needs predictor='lifted_linear', but it is {self.predictor!r}.")

    def require_fitted(self) -> None:
        """A ValueError unless the model is fitted, with the options that it has now."""
        if not hasattr(self, "koopman_matrix"):
            raise ValueError("the model is not fitted; call fit(recording) first.")
        if (self.predictor, self.delays) != self.fitted_as_:
            now = self.predictor, self.delays
            raise ValueError(
                f"predictor and delays are {now} but the model was fitted with {self.fitted_as_}; fit it again."
            )

    @property
    def state_columns(self) -> np.ndarray:
        """The states' columns of K, (N, n')."""
        K = self.koopman_matrix
        return K if self.columns == "states" else K[:, 1 : 1 + len(self.dictionary_.coordinates)]

    def require_all_columns(self) -> None:
        """A ValueError unless the model is fitted and knows all of K."""
        self.require_fitted()
        if self.columns == "states":
            reason = "columns is 'states', so the other columns of K and its eigenvalues are not known"
            raise ValueError(f"{reason}; fit with columns='all'.")

    def roll_out_scaled(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Scaled states (samples, n' or n, batch) from z (n', batch) under inputs (samples, m, batch)."""
        return self._predictor.roll_out(self, z, u)

    def _simulate_scaled(self, x, u):
        d = self.delays
        past = [u[:, :d][:, ::-1].reshape(len(u), -1)] if self.channels_.delayed_inputs else []
        z = np.concatenate([x[:, ::-1].reshape(len(x), -1), *past], axis=1)
        z, u = np.ascontiguousarray(z), np.ascontiguousarray(u[:, d:])  # the layout decides the last bits of products
        with few_blas_threads(len(self.names_)):
            states = self.roll_out_scaled(z.T, u.transpose(1, 2, 0))
        return np.concatenate([x[:, :d], states[:, : len(self.state_names_)].transpose(2, 0, 1)], axis=1)


def load_model(path: str | Path) -> KoopmanModel:
    """Read a model that `KoopmanModel.save` has written; nothing in the file is executed.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no model, is damaged, or is of a version that this release does not know.

    Examples
    --------
    >>> import pathlib, tempfile, tras
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "model.npz"
    >>> x = 0.9 ** tras.Recording([[[k] for k in range(20)]], dt=0.1).states
    >>> tras.KoopmanModel(tras.Monomials(1), "one_step").fit(tras.Recording(x, dt=0.1)).save(path)
    >>> load_model(path).dictionary
    Monomials(degree=1)
    """
    return model_file.load(path, _restored)


def _restored(parameters, dictionary, channels, attributes):
    """The model that fit had made, from what its file holds."""
    unfitted: Any = clone(dictionary)
    model = KoopmanModel(unfitted, **parameters)
    model.dictionary_, model.channels_ = dictionary, channels
    vars(model).update(attributes)
    return model
