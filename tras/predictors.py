"""Three ways to predict with K: integrate the vector field, lift anew each step, stay in the lifted space.

Each is one object. ``lifts_inputs`` says whether the dictionary is of states and inputs, ``delays_inputs`` whether
earlier inputs count as states beside the earlier states.
"""

from typing import NamedTuple

import numpy as np

from tras import generator, koopman, rollout
from tras.dictionaries.base import Dictionary
from tras.hull import Hull
from tras.solver import prediction_error
from tras.solver.stability import stable_change

# Of the choice of steps per sample: values of functions at a time, and the share of a model's misfit over one sample
# that the integration of a dear field may add to it.
_VALUES, _SHARE = 640_000, 0.01


class Map(NamedTuple):
    """``matrix psi(P z) + outward (z - P z)`` in scaled channels, P onto the hull; without a hull ``matrix psi(z)``."""

    matrix: np.ndarray
    dictionary: Dictionary
    hull: Hull | None
    outward: np.ndarray | None

    def __call__(self, point: np.ndarray) -> np.ndarray:
        """Values (rows, points) at (channels, points)."""
        if self.hull is None:
            return self.matrix @ self.dictionary.lift(point)
        near = self.hull.nearest(point)
        values = self.matrix @ self.dictionary.lift(near)
        return values if near is point else values + self.outward @ (point - near)

    def with_slopes(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (rows, points), and their exact derivatives by all channels (points, rows, channels)."""
        near = point if self.hull is None else self.hull.nearest(point)
        psi, slopes = self.dictionary.lift_with_slopes(near, inputs=True)
        values = self.matrix @ psi
        slopes = (self.matrix @ slopes.reshape(len(psi), -1)).reshape(len(values), *slopes.shape[1:])
        slopes = np.ascontiguousarray(slopes.transpose(2, 0, 1))
        if near is not point:
            projection = self.hull.slopes(point)
            values = values + self.outward @ (point - near)
            slopes = slopes @ projection + self.outward @ (np.eye(len(point)) - projection)
        return values, slopes


def _shifted(model, later, z, u):
    """What is known of the earlier samples is shifted, not predicted: ``later`` (n', batch) with those of z and u."""
    n, d = len(model.state_names_), model.delays
    if d:
        later[n : n * (d + 1)] = z[: n * d]
        if model.channels_.delayed_inputs:
            past, m = n * (d + 1), len(u)
            later[past : past + m], later[past + m :] = u, z[past:-m]
    return later


def _shifted_slopes(model, slopes):
    """Its derivatives (batch, n', n' + m)."""
    n, d, count = len(model.state_names_), model.delays, slopes.shape[1]
    if d:
        slopes[:, n:] = 0
        shifts = np.arange(n, n * (d + 1))
        slopes[:, shifts, shifts - n] = 1
        if model.channels_.delayed_inputs:
            m, past = slopes.shape[2] - count, np.arange(n * (d + 1), count)
            slopes[:, past[:m], count + np.arange(m)] = 1
            slopes[:, past[m:], past[m:] - m] = 1
    return slopes


def _segments(scaled, horizon, most):
    """Segments of ``horizon`` samples and shorter rests, stacked by their lengths: (states, inputs) of `improved`."""
    pieces = [piece for piece in scaled.cut_all(horizon + 1) if len(piece[0]) > 1]
    count = max(1, int(len(pieces) * min(1, most / sum(len(x) - 1 for x, _ in pieces))))
    alike = {}
    for k in np.unique(np.linspace(0, len(pieces) - 1, count).astype(int)):
        alike.setdefault(len(pieces[k][0]), []).append(pieces[k])
    return [tuple(np.stack(part, axis=-1) for part in zip(*alike[samples])) for samples in sorted(alike)]


class _Relifting:
    """What integrating and stepping have in common: psi(x, u) is evaluated anew at each predicted state."""

    lifts_inputs = True

    def settle(self, model, D, least_squares, scaled):
        """Everything that follows from D = K - I."""
        n = len(model.dictionary_.coordinates)
        one = np.eye(len(model.names_))
        model.koopman_matrix = (one if model.columns == "all" else one[:, 1 : 1 + n]) + D

    def roll_out(self, model, z, u):
        """Scaled states (samples, n', batch) from z (n', batch) under u (samples, m, batch)."""
        return rollout.roll_out(self.advance(model), z, u)

    def advance(self, model):
        """``(z, u) -> z`` one sample later, (n', batch) and (m, batch) in scaled channels."""
        step = self.stepper(model)
        return lambda z, u: _shifted(model, step(z, u), z, u)

    def advance_with_slopes(self, model):
        """The same with its exact derivatives by z and u: ``(z, u) -> ((n', batch), (batch, n', n' + m))``."""
        step = self.stepper_with_slopes(model)

        def advance(z, u):
            later, slopes = step(z, u)
            return _shifted(model, later, z, u), _shifted_slopes(model, slopes)

        return advance


class VectorField(_Relifting):
    """The paper's three steps: A = log(K) / dt (15), F = W psi, and F is integrated while the input is held.

    Earlier inputs cannot be states here: they would have the eigenvalue zero, which has no logarithm.
    """

    delays_inputs = False

    def rows(self, columns):
        return koopman.rows

    def settle(self, model, D, least_squares, scaled):
        super().settle(model, D, least_squares, scaled)
        R = least_squares.R
        logarithm, model.log_residual_ = generator.principal_logarithm(model.koopman_matrix)
        model.generator = logarithm / model.dt_
        model.W_ = generator.field_by_coordinates(model.generator, model.dictionary_)
        if model.field == "least_squares":
            by_coordinates = model.W_
            model.W_ = generator.field_by_least_squares(model.generator, model.dictionary_, scaled, R)
            # R^T R = Psi_x^T Psi_x, so |W R^T| is the root mean square of W psi over the data, up to a factor.
            size = np.linalg.norm(by_coordinates @ R.T, axis=1)
            apart = np.linalg.norm((model.W_ - by_coordinates) @ R.T, axis=1)
            size[size == 0] = apart[size == 0]  # a state that stands still by its coordinates: all of it, or nothing
            model.field_disagreement_ = np.divide(apart, size, out=np.zeros_like(apart), where=apart > 0)
        self._choose_substeps(model, scaled)

    def _choose_substeps(self, model, scaled):
        """As many steps per sample as move nothing any more; of a dear field, as its own error is worth, 16 at most.

        No mode of log(K) decays by more than 1e-16 per sample, which is what rounding leaves of the norm of K: ``|A|
        dt`` is 37 there, and 16 steps are stable up to 16 x 2.78 = 44. More are for accuracy alone.
        """
        x, u = (np.concatenate(part) for part in zip(*scaled))
        functions, own = len(model.names_), len(model.state_names_)
        sample = np.linspace(0, len(x) - 1, min(len(x), 2000, _VALUES // functions)).astype(int)
        points = x[sample].T, u[sample].T
        if functions <= rollout.CHEAP:
            model.substeps_ = rollout.enough_substeps(self.map(model), *points, model.dt_).count
            return
        tolerable = np.full((x.shape[1], 1), np.inf)  # earlier samples are shifted, not predicted
        tolerable[:own, 0] = _SHARE * model.residual_[1 : 1 + own]
        steps = rollout.enough_substeps(self.map(model), *points, model.dt_, most=16, tolerable=tolerable)
        model.substeps_ = steps.count
        if not steps.enough:
            far = f"by {steps.moved:.1g} half-ranges" if np.isfinite(steps.moved) else "without bounds"
            how = f"ended at {steps.count} per sample; the last doubling moved one prediction in 100 {far} or more"
            model.unsettled_.append(f"the choice of Runge-Kutta steps {how}")

    def map(self, model):
        """The rates of all states in 1/s."""
        return Map(model.W_, model.dictionary_, model.hull_, model.outward_)

    def stepper(self, model):
        field = self.map(model)
        return lambda z, u: rollout.runge_kutta(field, z, u, model.dt_, model.substeps_)

    def stepper_with_slopes(self, model):
        field = self.map(model).with_slopes
        return lambda z, u: rollout.runge_kutta_with_slopes(field, z, u, model.dt_, model.substeps_)


class OneStep(_Relifting):
    """The states' columns of K give the next state, which is lifted again. Needs no logarithm."""

    delays_inputs = True

    def rows(self, columns):
        return koopman.rows if columns == "all" else koopman.state_rows

    def settle_over(self, model, scaled, horizon):
        """The states' columns of K by predictions over ``horizon`` samples, if none runs away."""
        step, n = self.map(model), len(model.state_names_)
        dictionary, hull, outward = step.dictionary, step.hull, step.outward
        most = prediction_error.worth(n, len(model.names_))

        def lift(z, u):
            point = np.concatenate([z, u])
            near = point if hull is None else hull.nearest(point)
            psi = dictionary.lift(near)
            return psi, 0.0 if near is point else outward[:n] @ (point - near)

        def slopes(z, u):
            point = np.concatenate([z, u])
            return dictionary.lift_slopes(point if hull is None else hull.nearest(point))

        def later(states, z, u):
            return _shifted(model, np.concatenate([states, z[n:]]), z, u)

        W = first = step.matrix[:n]
        # Short predictions first: of long ones a few may go astray, and no small step brings them back.
        for steps in sorted({-(-horizon // 9), -(-horizon // 3), horizon}):
            segments = _segments(scaled, steps, most)
            W, errors = prediction_error.improved(W, first, segments, lift, slopes, later, model.delays + 1)
        if np.isfinite(errors[-1]):
            K = model.koopman_matrix.copy()
            K[:, slice(n) if model.columns == "states" else slice(1, 1 + n)] = W.T
            model.koopman_matrix, model.refinement_ = K, np.array(errors)

    def map(self, model):
        """All states one sample later."""
        return Map(model.state_columns.T, model.dictionary_, model.hull_, model.outward_step_)

    def stepper(self, model):
        step = self.map(model)
        return lambda z, u: step(np.concatenate([z, u]))

    def stepper_with_slopes(self, model):
        step = self.map(model).with_slopes
        return lambda z, u: step(np.concatenate([z, u]))


class LiftedLinear:
    """The states are lifted once, then ``z+ = A z + B u`` (M. Korda and I. Mezic, Automatica 93, 2018, 149)."""

    lifts_inputs = False
    delays_inputs = True

    def rows(self, columns):
        return koopman.lifted_linear_rows

    def settle(self, model, D, least_squares, scaled):
        """A, transposed, and B from the change D; the inputs' rows stand behind those of constant and states."""
        n, m = len(model.dictionary_.coordinates), len(model.input_names_)
        if model.stable:

            def unsettled(iterations):
                how = f"ended after {iterations} iterations that still gained"
                model.unsettled_.append(f"the search of a stable matrix {how}: a better one is likely")

            D = stable_change(least_squares, D, n, m, radius=float(model.stable), unsettled=unsettled)
        of_inputs = np.zeros(len(D), dtype=bool)
        of_inputs[1 + n : 1 + n + m] = True
        model.koopman_matrix = np.eye(len(model.names_)) + D[~of_inputs]
        model.B_ = np.ascontiguousarray(D[of_inputs].T)

    def map(self, model):
        raise ValueError(
            "predictor is 'lifted_linear', which steps in the lifted space and has no map of states alone."
        )

    def roll_out(self, model, z, u):
        """As the others', but the lifting is carried on."""
        A, B, rows = model.koopman_matrix.T, model.B_, model.dictionary_.coordinates
        return rollout.roll_out(lambda s, v: A @ s + B @ v, model.dictionary_.lift(z), u, lambda s: s[rows])

    def advance(self, model):
        """One sample from a state that is lifted anew, as the first sample of `roll_out` is."""
        A, B, rows = model.koopman_matrix.T, model.B_, model.dictionary_.coordinates
        return lambda z, u: _shifted(model, A[rows] @ model.dictionary_.lift(z) + B[rows] @ u, z, u)

    def advance_with_slopes(self, model):
        """See `_Relifting.advance_with_slopes`."""
        A, B, rows = model.koopman_matrix.T, model.B_, model.dictionary_.coordinates

        def advance(z, u):
            psi, slopes = model.dictionary_.lift_with_slopes(z)
            by_state = np.einsum("ij,jkp->pik", A[rows], slopes)
            both = np.concatenate([by_state, np.broadcast_to(B[rows], (len(by_state), *B[rows].shape))], axis=2)
            return _shifted(model, A[rows] @ psi + B[rows] @ u, z, u), _shifted_slopes(model, both)

        return advance


PREDICTORS = {"vector_field": VectorField(), "one_step": OneStep(), "lifted_linear": LiftedLinear()}
