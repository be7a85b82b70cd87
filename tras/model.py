"""Identified models: fit, simulate, score, save, load (paper, Algorithm of Sec. IV and "Model Comparison")."""

import json
import math
import zipfile
from pathlib import Path

import numpy as np
from scipy import linalg
from sklearn.base import BaseEstimator, clone

import tras
from tras import dictionary as dictionaries
from tras import generator, koopman, metrics
from tras.files import replacing
from tras.recording import Recording, versions

PREDICTORS = ("vector_field", "one_step", "lifted_linear")
FIELDS = ("coordinates", "least_squares")
_FORMAT = "tras model 1"
_LIMIT = 1e3  # half-ranges of the training data; a prediction beyond is abandoned and NaN from there on


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
        For example ``Monomials(2)`` or ``GaussianRBF(2)``. It is cloned, never changed.
    predictor : {"vector_field", "one_step", "lifted_linear"}
    field : {"coordinates", "least_squares"}
        How W is had from A for ``vector_field``: from the states' columns of A, or from equation (18) over all points, as in the
        paper. They agree where the dictionary's span is invariant (with ``least_squares``, ``field_disagreement_`` says how far they are apart). Elsewhere
        (18) asks every function's equation to hold, and the projection error of all of them leaks into F; the states' columns
        carry only their own. For large N (18) also takes several times as long as K itself.

    Attributes
    ----------
    koopman_matrix : (N, N) ndarray
        K of (14), in scaled channels; with ``lifted_linear`` the A of ``z+ = A z + B u`` transposed.
    generator : (N, N) ndarray
        A of (15) in 1/s; only for ``vector_field``.
    eigenvalues : (N,) complex ndarray
        Of K; do not depend on units.
    condition_number : float
        Of the matrix of liftings on scaled channels. Coefficients are good to about this times 1e-16.

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

    def __init__(self, dictionary=None, predictor="vector_field", *, field="coordinates"):
        self.dictionary = dictionary
        self.predictor = predictor
        self.field = field

    def fit(self, recording, y=None):
        """Identify from a `Recording`, or a sequence of recordings with the same channels.

        Raises
        ------
        ValueError
            On an unknown option, a constant channel, too few snapshot pairs, or functions that are linearly dependent on the data.
        LogarithmError
            (a ValueError) If K has no principal logarithm.
        """
        if self.predictor not in PREDICTORS:
            raise ValueError(f"predictor is {self.predictor!r}; choose one of {', '.join(PREDICTORS)}.")
        if self.field not in FIELDS:
            raise ValueError(f"field is {self.field!r}; choose one of {', '.join(FIELDS)}.")
        if not isinstance(self.dictionary, dictionaries.Dictionary):
            raise ValueError(f"dictionary is {self.dictionary!r}; give one, for example tras.Monomials(2).")
        recording = join(recording)
        self._remember(recording)
        scaled = self._scaled(recording)
        lifts_inputs = self.predictor != "lifted_linear"
        x, u = (np.concatenate(part) for part in zip(*scaled))
        self.dictionary_ = clone(self.dictionary).fit(x, u if lifts_inputs else None)
        names = self.dictionary_.feature_names(list(self.state_names_ + (self.input_names_ if lifts_inputs else ())))
        solve = koopman.koopman_matrix if lifts_inputs else koopman.lifted_linear
        fit = solve(self.dictionary_, scaled, names if lifts_inputs else names + list(self.input_names_))
        N = len(names)
        self.koopman_matrix, self.B_ = np.ascontiguousarray(fit.coefficients[:N]), np.ascontiguousarray(fit.coefficients[N:].T)
        self.condition_number, self.residual_, self.pairs_, self.names_ = fit.condition_number, fit.residual, fit.rows, names
        if self.predictor == "vector_field":
            self._identify_field(scaled, fit.R)
        return self

    def _identify_field(self, scaled, R):
        """The second and third step of the method: the generator, then W."""
        self.generator = generator.generator(self.koopman_matrix, self.dt_)
        self.W_ = generator.field_by_coordinates(self.generator, self.dictionary_)
        if self.field == "least_squares":
            by_coordinates, self.W_ = self.W_, generator.field_by_least_squares(self.generator, self.dictionary_, scaled, R)
            # R is a square root of Psi_x^T Psi_x, so |W R^T| is the root mean square of W psi over the data, up to a factor.
            size = np.linalg.norm(by_coordinates @ R.T, axis=1)
            self.field_disagreement_ = np.linalg.norm((self.W_ - by_coordinates) @ R.T, axis=1) / size
        x, u = (np.concatenate(part) for part in zip(*scaled))
        some = np.linspace(0, len(x) - 1, min(len(x), 2000)).astype(int)
        self.substeps_ = self._enough_substeps(x[some].T, u[some].T)

    @property
    def eigenvalues(self):
        """Eigenvalues of K, largest modulus first."""
        eigenvalues = linalg.eigvals(self.koopman_matrix)
        return eigenvalues[np.lexsort((-eigenvalues.imag, -np.abs(eigenvalues)))]

    def vector_field(self, x, u=None):
        """The identified ``dx/dt = F(x, u)`` in physical units: (..., n), (..., m) -> (..., n). Only for ``vector_field``."""
        self._fitted()
        if self.predictor != "vector_field":
            raise ValueError(f"predictor is {self.predictor!r}, which has no vector field; fit with predictor='vector_field'.")
        x = np.asarray(x, dtype=float)
        u = np.empty((*x.shape[:-1], 0)) if u is None else np.asarray(u, dtype=float)
        psi = self.dictionary_((x - self.x_offset_) / self.x_scale_, (u - self.u_offset_) / self.u_scale_)
        return psi @ self.W_.T * self.x_scale_

    def simulate(self, x0, inputs):
        """Roll out from ``x0`` under ``inputs``, one sample of which acts from its own instant to the next.

        Parameters
        ----------
        x0 : (..., n) array_like
        inputs : (..., samples, m) array_like
            ``m = 0`` (autonomous): an empty array of shape (samples, 0).

        Returns
        -------
        (..., samples, n) ndarray
            The first sample is ``x0``. A prediction that leaves the training data's range a thousandfold is abandoned: NaN from there on.

        Raises
        ------
        ValueError
            On wrong shapes or non-finite values.
        """
        self._fitted()
        x0, inputs = np.asarray(x0, dtype=float), np.asarray(inputs, dtype=float)
        n, m = len(self.state_names_), len(self.input_names_)
        if x0.ndim == 0 or x0.shape[-1] != n:
            raise ValueError(f"x0 has shape {x0.shape}; its last axis must hold the {n} states {', '.join(self.state_names_)}.")
        if inputs.ndim < 2 or inputs.shape[-1] != m or inputs.shape[-2] == 0:
            raise ValueError(
                f"inputs has shape {inputs.shape}; give (..., samples, {m}), at least one sample: {', '.join(self.input_names_) or 'no inputs'}."
            )
        if not (np.isfinite(x0).all() and np.isfinite(inputs).all()):
            raise ValueError("x0 or inputs holds NaN or infinity; repair them first.")
        batch = np.broadcast_shapes(x0.shape[:-1], inputs.shape[:-2])
        runs, samples = math.prod(batch), inputs.shape[-2]
        z = np.broadcast_to((x0 - self.x_offset_) / self.x_scale_, (*batch, n)).reshape(runs, n).T
        v = np.broadcast_to((inputs - self.u_offset_) / self.u_scale_, (*batch, samples, m)).reshape(runs, samples, m)
        states = self._roll_out(z, v.transpose(1, 2, 0))
        return (states.transpose(2, 0, 1) * self.x_scale_ + self.x_offset_).reshape(*batch, samples, n)

    def predict(self, recording):
        """Roll out every trajectory from its own first state under its own inputs; shaped like ``recording.states``."""
        recording = self._same_channels(join(recording))
        lengths = recording.lengths
        longest = np.zeros((len(recording), lengths.max(), recording.m))
        for padded, (_, u) in zip(longest, recording):
            padded[: len(u)] = u
        states = self.simulate(np.stack([x[0] for x, _ in recording]), longest)
        return states if np.all(lengths == lengths[0]) else [x[:k] for x, k in zip(states, lengths)]

    def score(self, recording, y=None):
        """``-mean(NRMSE)`` over the states, in percent, of the roll-outs; ``-inf`` if one of them diverges."""
        recording = join(recording)
        predicted = self.predict(recording)
        if metrics.diverged(recording.states, predicted).any():
            return -np.inf
        return -float(np.mean(metrics.nrmse(recording.states, predicted)))

    def report(self):
        """What the fit found, in a few lines of text."""
        self._fitted()
        eigenvalues = self.eigenvalues
        lines = [
            f"{self.predictor} model of {len(self.state_names_)} states, {len(self.input_names_)} inputs at {self.dt_:g} s",
            f"dictionary {self.dictionary_}, N = {len(self.names_)} functions, {self.pairs_} snapshot pairs",
            f"condition number of the liftings {self.condition_number:.2e}",
            f"spectral radius of K {np.abs(eigenvalues).max():.8f}",
        ]
        if self.predictor == "vector_field":
            distance = generator.branch_distance(eigenvalues).min()
            lines += [
                f"distance of the spectrum from the logarithm's branch cut {distance:.3g}",
                f"vector field by {self.field}, {self.substeps_} Runge-Kutta step(s) a sample",
            ]
        if hasattr(self, "field_disagreement_"):
            apart = ", ".join(f"{name} {100 * d:.2g} %" for name, d in zip(self.state_names_, self.field_disagreement_))
            lines.append(f"it differs from the field by coordinates by {apart} (root mean square)")
        return "\n".join(lines)

    def save(self, path):
        """Write to ``path`` (.npz: plain arrays and one JSON header, no pickle). Same model, same bytes."""
        self._fitted()
        header = {
            "format": _FORMAT,
            "versions": versions(),
            "predictor": self.predictor,
            "field": self.field,
            **{key: getattr(self, key + "_") for key in _HEADER},
        }
        arrays = {key: getattr(self, key) for key in _ARRAYS if hasattr(self, key)}
        header["dictionary"] = _pack(self.dictionary_, "dictionary", arrays)
        with replacing(_npz_path(path)) as temporary:
            np.savez(temporary, header=np.array(json.dumps(header)), **arrays)

    def _remember(self, recording):
        """Names, units, sampling time and the scale of each channel: its middle and half-range."""
        self.dt_ = recording.dt
        for role in ("state", "input"):
            for kind in ("names", "units"):
                setattr(self, f"{role}_{kind}_", tuple(getattr(recording, f"{role}_{kind}")))
        x, u = (np.concatenate(part) for part in zip(*recording))
        for letter, values, names in (("x", x, self.state_names_), ("u", u, self.input_names_)):
            low, high = (values.min(axis=0), values.max(axis=0)) if values.size else (np.empty(0), np.empty(0))
            scale = (high - low) / 2
            constant = scale <= 1e-12 * np.maximum(np.abs(low), np.abs(high))
            if constant.any():
                i = int(np.argmax(constant))
                raise ValueError(
                    f"channel {names[i]!r} is constant ({low[i]:g}) over the whole recording: nothing can be learnt about it; leave it out "
                    "with recording.select(...)."
                )
            setattr(self, f"{letter}_offset_", (high + low) / 2)
            setattr(self, f"{letter}_scale_", scale)

    def _scaled(self, recording):
        scaled = [((x - self.x_offset_) / self.x_scale_, (u - self.u_offset_) / self.u_scale_) for x, u in recording]
        return Recording(*map(list, zip(*scaled)), recording.dt)

    def _same_channels(self, recording):
        """The recording with the model's channels in the model's order."""
        recording = recording.select(states=self.state_names_, inputs=self.input_names_)
        if abs(recording.dt - self.dt_) > 1e-9 * self.dt_:
            raise ValueError(f"the recording is sampled at {recording.dt:g} s but the model at {self.dt_:g} s; resample or fit again.")
        return recording

    def _restore(self, header, arrays):
        """Set what `fit` would have set, from a file's header and arrays."""
        for key in _HEADER:
            value = header[key]
            setattr(self, key + "_", tuple(value) if isinstance(value, list) else value)
        for key, value in arrays.items():
            setattr(self, key, value.item() if value.ndim == 0 else value)

    def _fitted(self):
        if not hasattr(self, "koopman_matrix"):
            raise ValueError("the model is not fitted; call fit(recording) first.")

    def _roll_out(self, z, inputs):
        """Scaled states (samples, n, batch) from (n, batch) under (samples, m, batch)."""
        advance, read = self._advance, lambda state: state
        if self.predictor == "lifted_linear":
            z = self.dictionary_(z.T).T
            A, B, rows = self.koopman_matrix.T, self.B_, self.dictionary_.coordinates
            advance, read = lambda state, u: A @ state + B @ u, lambda state: state[rows]
        samples, _, batch = inputs.shape
        states = np.empty((samples, len(self.state_names_), batch))
        states[0] = read(z)
        ends = np.full(batch, samples)  # where each prediction is abandoned
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(1, samples):
                z = advance(z, inputs[k - 1])
                x = states[k] = read(z)
                inside = np.abs(x) <= _LIMIT  # False for NaN
                if not inside.all():
                    outside = ~inside.all(axis=0)
                    ends[outside] = np.minimum(ends[outside], k)
                    if (ends < samples).all():
                        break
                    z = np.where(outside, 0.0, z)
        for i in np.flatnonzero(ends < samples):
            states[ends[i] :, :, i] = np.nan
        return states

    def _advance(self, z, u):
        """One sample: (n, batch), (m, batch) -> (n, batch), scaled."""
        if self.predictor == "one_step":
            return self.koopman_matrix[:, self.dictionary_.coordinates].T @ self.dictionary_.lift(np.concatenate([z, u]))
        return self._integrate(z, u, self.substeps_)

    def _integrate(self, z, u, substeps):
        """Classical Runge-Kutta steps of order 4 of the scaled vector field W psi, the input held."""
        h = self.dt_ / substeps
        n = len(z)
        point = np.concatenate([z, u])
        W, lift = self.W_, self.dictionary_.lift
        for _ in range(substeps):
            k1 = W @ lift(point)
            point[:n] = z + h / 2 * k1
            k2 = W @ lift(point)
            point[:n] = z + h / 2 * k2
            k3 = W @ lift(point)
            point[:n] = z + h * k3
            k4 = W @ lift(point)
            z = z + h / 6 * (k1 + 2 * (k2 + k3) + k4)
            point[:n] = z
        return z

    def _enough_substeps(self, z, u, tolerance=1e-8, most=64):
        """Doubled until halving the step moves no prediction over one sample by more than ``tolerance`` of a half-range."""
        substeps, coarse = 1, self._integrate(z, u, 1)
        while substeps < most:
            fine = self._integrate(z, u, 2 * substeps)
            if np.abs(fine - coarse).max() <= tolerance:
                break
            substeps, coarse = 2 * substeps, fine
        return substeps


_HEADER = ("dt", "state_names", "state_units", "input_names", "input_units", "names", "pairs")
_ARRAYS = (
    "koopman_matrix", "generator", "W_", "B_", "condition_number", "residual_", "field_disagreement_", "substeps_",
    "x_offset_", "x_scale_", "u_offset_", "u_scale_",
)  # fmt: skip


def load_model(path):
    """Read a model that `KoopmanModel.save` has written; nothing in the file is executed.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no model, is damaged, or is of a version that this release does not know.
    """
    path = _npz_path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; fit a model and save it with model.save({str(path)!r}).")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        header = json.loads(str(arrays.pop("header")))
        if header["format"] != _FORMAT:
            raise ValueError(f"its format is {header['format']!r}, this release reads {_FORMAT!r}")
        dictionary = _unpack(header["dictionary"], "dictionary", arrays)
        model = KoopmanModel(clone(dictionary), header["predictor"], field=header["field"])
        model.dictionary_ = dictionary
        model._restore(header, arrays)
    except (OSError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} cannot be read as a model ({error}); save it again with KoopmanModel.save.") from error
    return model


def join(recordings):
    """One recording of a recording, or of a sequence of recordings with the same channels and sampling time.

    Raises
    ------
    ValueError
        If they differ, or there are none.
    """
    if isinstance(recordings, Recording):
        return recordings
    try:
        recordings = list(recordings)
    except TypeError:
        recordings = [recordings]
    if not recordings or not all(isinstance(r, Recording) for r in recordings):
        raise ValueError(f"recording is {type(recordings[0]).__name__ if recordings else 'empty'}; give a tras.Recording or a sequence of them.")
    first = recordings[0]
    for i, other in enumerate(recordings[1:], start=1):
        for label in ("dt", "state_names", "input_names"):
            if getattr(other, label) != getattr(first, label):
                raise ValueError(f"recording {i} has {label} {getattr(other, label)} but the first has {getattr(first, label)}; make them alike.")
    return first._with([x for r in recordings for x, _ in r], [u for r in recordings for _, u in r])


def _pack(dictionary, place, arrays):
    """A fitted dictionary as JSON holds it, its learnt arrays put into ``arrays`` under names that begin with ``place``."""
    header = {"name": type(dictionary).__name__, "parameters": {}, "learnt": {}}
    for key, value in dictionary.get_params(deep=False).items():
        # What the parts, a Generator or an array of centres led to is among the learnt.
        keep = value is None or isinstance(value, (bool, int, float, str)) or key in ("positions", "velocities", "shape")
        header["parameters"][key] = value if keep else None
    for key, value in vars(dictionary).items():
        if key == "parts_":
            header["parts"] = [_pack(part, f"{place}.{i}", arrays) for i, part in enumerate(value)]
        elif key.endswith("_"):
            arrays[f"{place}.{key}"] = value
    return header


def _unpack(header, place, arrays):
    """The dictionary that `_pack` has packed; its arrays are taken out of ``arrays``."""
    kind = getattr(tras, header["name"], None) if header["name"] in tras.__all__ else None
    if not (isinstance(kind, type) and issubclass(kind, dictionaries.Dictionary)):
        raise ValueError(f"its dictionary {header['name']!r} is not one of this release")
    parts = [_unpack(part, f"{place}.{i}", arrays) for i, part in enumerate(header.get("parts", []))]
    dictionary = kind(**(header["parameters"] | ({"parts": [clone(part) for part in parts]} if parts else {})))
    if parts:
        dictionary.parts_ = parts
    for key in [key for key in arrays if key.rpartition(".")[0] == place]:
        value = arrays.pop(key)
        setattr(dictionary, key.rpartition(".")[2], value.item() if value.ndim == 0 else value)
    return dictionary._restore()


def _npz_path(path):
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"path {path} ends in {path.suffix!r}; models are stored with the ending .npz.")
    return path
