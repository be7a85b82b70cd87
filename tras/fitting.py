"""What a fit knows while it reads snapshot pairs: scales, dictionary, rows of the least-squares problem, hull.

A `Fit` begins with a first recording and absorbs any number of others; `tras.KoopmanModel` solves it. What it knows of
the rows is a dict of plain arrays (`Fit.state`): a checkpoint stores it, and workers send it to be merged.
"""

import copy
import itertools

import numpy as np
from scipy import linalg
from sklearn.base import clone

from tras import koopman
from tras.dictionaries.base import MARGIN, label
from tras.estimator import Channels
from tras.hull import Hull, outward_rates
from tras.io.npz import MAX_NUMBER, require_numbers
from tras.predictors import PREDICTORS
from tras.recording import join
from tras.regularization import regularized
from tras.solver.least_squares import LeastSquares, StreamingLeastSquares, panel_rows
from tras.solver.threads import processors
from tras.workflow.arguments import short

_MATRICES = 40  # of N by N numbers: the solver's, and those of a logarithm
_SPARSE, _STABLE = 6, 2  # so many times fewer functions are allowed with these searches, which take longer
_AT_ONCE, _AHEAD = 3, 2  # times `max_functions`: coefficients of a field by least squares, and of a horizon above 1
WINDOW = 501  # samples of a roll-out, at most


class Fit:
    """The state of a fit, of size O(N^2) whatever the number of pairs.

    Attributes
    ----------
    channels : Channels
    dictionary : Dictionary
        Fitted to the first recording.
    names : list of str
        Of its functions.
    solver : StreamingLeastSquares
    hull : Hull or None
        None before the first pairs, and for models that do not need one.
    """

    @classmethod
    def begin(cls, options, recording, ranges=None) -> "Fit":
        """Scales and dictionary from a recording, or scales from ``ranges``; no rows yet.

        Parameters
        ----------
        options : KoopmanModel
            Its parameters are read and nothing else of it.
        recording : Recording
        ranges : dict, optional
            Channel -> (lowest, highest).

        Raises
        ------
        ValueError
            If there are no snapshot pairs, a channel is constant, or there would be more than ``max_functions``.
        """
        if recording.pairs == 0:
            raise ValueError("no trajectory has two samples, so there are no snapshot pairs; record more.")
        new, predictor = cls(), PREDICTORS[options.predictor]
        _require_few(options, predictor, recording)
        new.channels = Channels.of(recording, ranges, options.delays, predictor.delays_inputs, options.lead)
        x, u = (np.concatenate(part) for part in zip(*new.channels.scaled(recording)))
        new.lifts_inputs, new.rows = predictor.lifts_inputs, predictor.rows(options.columns)
        origin = new.channels.origin if new.lifts_inputs else new.channels.origin[: x.shape[1]]
        new.dictionary = clone(options.dictionary).fit(x, u if new.lifts_inputs else None, origin)
        _require_at_most(options, new.dictionary.size)  # of those that cannot count before
        lifted = new.channels.z_names + new.lifts_inputs * list(new.channels.input_names)
        new.names = new.dictionary.feature_names(lifted)
        new.confines = options.extrapolation == "linear" and new.lifts_inputs and new.tail > 0
        new.chooses = options.regularization is not None and options.strength == "auto" and new.tail > 0
        held = len(u) < 2 or np.mean((u[1:] == u[:-1]).all(axis=1)) > 0.5
        new.shares = held or not new.lifts_inputs  # whether a pair's second lifting is mostly the next pair's first
        new.solver, new.hull = StreamingLeastSquares(), None
        return new

    def __copy__(self):
        """Another fit of the same rows, at no cost: arrays are replaced, never changed."""
        new = type(self)()
        new.__dict__.update(self.__dict__, solver=copy.copy(self.solver), hull=copy.copy(self.hull))
        return new

    @property
    def tail(self) -> int:
        """Number of functions behind constant, states and inputs."""
        inputs = self.lifts_inputs * len(self.channels.input_names)
        return len(self.names) - 1 - len(self.dictionary.coordinates) - inputs

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of regressors and targets."""
        states_alone = self.rows is koopman.state_rows
        return len(self._regressor_names()), len(self.dictionary.coordinates) if states_alone else len(self.names)

    def absorb(self, scaled, threads=None, most=None):
        """All snapshot pairs of scaled trajectories, or the first ``most`` blocks of them."""
        size, deal = koopman.block_size(self.dictionary), koopman.SUIT if self.shares else 1
        blocks = itertools.islice(koopman.snapshot_pairs(scaled, size, deal), most)
        both = koopman.lifting(self.dictionary, self.rows)
        regressors = koopman.regressors_alone(self.dictionary, self.rows)
        self.solver.update_lifted(map(self._widen_hull, blocks), both, threads or processors(), regressors)

    def _widen_hull(self, block):
        if self.confines:
            z = np.hstack(block[:2]).T
            new = self.hull is None
            self.hull = Hull(z, self.dictionary.confined, self.dictionary.margin) if new else self.hull.widen(z)
        return block

    def emptied(self) -> "Fit":
        """The same basis and hull without rows, for parts that are merged later."""
        new = copy.copy(self)
        new.solver = self.solver.emptied()
        return new

    def state(self) -> dict:
        """What is known of the rows, name -> array, for `restore` and `merge`."""
        arrays = {f"solver.{key}": value for key, value in self.solver.state().items()} if self.solver.rows else {}
        return arrays | {f"hull.{key}": value for key, value in (self.hull.arrays() if self.hull else {}).items()}

    def restore(self, state):
        """Take over the rows of a `state` in place of its own."""
        self.solver, self.hull = rows_and_hull(state, self.dictionary)

    def merge(self, state):
        """Add the rows of a `state` whose fit began with this one's basis."""
        solver, hull = rows_and_hull(state, self.dictionary)
        if solver is not None:
            self.solver.merge(solver)
        if hull is not None:
            self.hull.merge(hull.low, hull.high)

    def solve(self, regularization, strength) -> tuple[LeastSquares, np.ndarray]:
        """The least-squares problem of all rows so far, and its solution D = K - I.

        Raises
        ------
        ValueError
            If channels depend on each other, or functions do and ``strength`` is 0.
        """
        least_squares = self.solver.solve(self._regressor_names())
        koopman.check_head(least_squares, self._head(least_squares))
        if strength == 0:
            least_squares.require_full_rank()
            return least_squares, least_squares.coefficients
        solution = regularized(regularization, least_squares.R, least_squares.rotated, self._head(least_squares))
        return least_squares, solution(strength)

    def outward(self, least_squares) -> np.ndarray:
        """Slopes S (n', n' + m) in 1/s beyond the hull, from the linear model of the same rows."""
        n, head = len(self.dictionary.coordinates), self._head(least_squares)
        states = slice(None) if self.rows is koopman.state_rows else slice(1, 1 + n)
        change = np.zeros((head, 1 + n))
        R, rotated = least_squares.R[:head, :head], least_squares.rotated[:head, states]
        change[:, 1:] = linalg.solve_triangular(R, rotated, check_finite=False)
        return outward_rates(change, n, self.channels.dt, len(self.channels.state_names))

    def _head(self, least_squares):
        return len(least_squares.R) - self.tail

    def _regressor_names(self):
        if self.lifts_inputs:
            return self.names
        head = 1 + len(self.dictionary.coordinates)
        return [*self.names[:head], *self.channels.input_names, *self.names[head:]]


def _require_few(options, predictor, recording):
    """Refuse too many functions while they are a number: nothing is delayed, learnt or lifted yet."""
    if options.delays >= recording.lengths.max():
        return  # that is said elsewhere
    inputs = recording.m if predictor.lifts_inputs else 0
    delayed = recording.n + recording.m * predictor.delays_inputs
    states = recording.n + options.delays * delayed
    if states + inputs < options.max_functions:  # each channel is a function
        functions = options.dictionary.count_of(states, inputs)
        _require_at_most(options, functions)
        if options.field == "least_squares" and options.predictor == "vector_field":
            cause = "field is 'least_squares'", "field='coordinates'"
            _require_few_coefficients(options, states, functions, _AT_ONCE, *cause)
        if options.horizon > 1:
            cause = f"horizon is {options.horizon}", "horizon=1"
            _require_few_coefficients(options, recording.n, functions, _AHEAD, *cause)
    else:
        _require_at_most(options, 1 + states + inputs)


def _require_few_coefficients(options, states, functions, share, cause, remedy):
    if states * functions > share * options.max_functions:
        raise ValueError(
            f"{cause}, which solves for {states} x {functions} coefficients at once, more than {share} times "
            f"max_functions={options.max_functions}; use {remedy}, or a smaller dictionary."
        )


def _require_at_most(options, functions):
    # A sparse K is a search per column, with a problem of least squares per round; a stable one is a search, too.
    share = _SPARSE if options.regularization == "sparse" else _STABLE if options.stable else 1
    if functions * share > options.max_functions:
        gigabytes = memory_needed(functions) / 1e9
        need = f"about {gigabytes:.2g} GB of memory" if gigabytes < 1e4 else "more memory than there is"
        fewer = f", fewer than {options.delays} delays" if options.delays else ""
        number = f"{functions}" if functions < 1e12 else "more than 1e12"
        allow = f", or allow it: KoopmanModel(..., max_functions={functions * share})" if functions < 1e5 else ""
        what = "regularization='sparse'" if options.regularization == "sparse" else f"stable={options.stable!r}"
        shared = f" / {share}, the limit with {what}" if share > 1 else ""
        raise ValueError(
            f"dictionary {short(label(options.dictionary), 80)} has {number} functions of these channels, more than "
            f"max_functions={options.max_functions}{shared}; the fit would need {need}. Take a lower degree or "
            f"order{fewer}, GaussianRBF(200, width='auto', centres='kmeans'){allow}."
        )


def memory_needed(functions: int) -> int:
    """Bytes that a fit of so many functions takes at most, about: panels of each thread, and matrices of all."""
    panels = 3 * processors() * panel_rows(functions) * functions
    return 8 * (panels + _MATRICES * functions**2)


def rows_and_hull(state, dictionary=None) -> tuple[StreamingLeastSquares | None, Hull | None]:
    """Solver and hull of a `Fit.state`, None what is not in it; a ValueError if its arrays are not those of a state."""
    solver, hull = (
        {key.partition(".")[2]: value for key, value in state.items() if key.startswith(f"{kind}.")}
        for kind in ("solver", "hull")
    )
    if solver:
        _check_rows(solver)
    free = Hull.unconfined(len(hull.get("low", ())), dictionary and dictionary.confined)
    box = Hull.restored(hull, free, dictionary.margin if dictionary else MARGIN) if hull else None
    return StreamingLeastSquares.from_state(solver) if solver else None, box


def _check_rows(state):
    """A ValueError unless the arrays are those of `StreamingLeastSquares.state`."""
    x, y = (
        require_numbers(name, state.get(name, ()), (None, None)) for name in ("waiting_regressors", "waiting_targets")
    )
    (waiting, p), q = x.shape, y.shape[1]
    shapes = {"waiting_targets": (waiting, q)}
    if "gram" in state:
        shapes |= {"gram": (p, p), "cross": (p, q), "lengths": (p,), "square": (q,), "examined": (), "T": (p, p)}
        shapes |= {"scale": (p,), "ridge": (p,)}
        for name, most in (("bits", 26), ("exact", p)):
            _require_count(state, name, 0, most)
    _require_count(state, "rows", max(1, waiting), 2**62)
    for name, shape in shapes.items():
        low = 1e-100 if name == "scale" else 0 if name in ("lengths", "square", "ridge", "examined") else -MAX_NUMBER
        require_numbers(name, state.get(name, ()), shape, low)
    if "gram" in state:
        squares = np.diag(state["gram"])
        if (squares < 0).any() or (state["gram"] ** 2 > 1.000001 * np.outer(squares, squares)).any():
            raise ValueError("its gram does not hold products of rows")
        if not (np.diag(state["T"]) != 0).all():
            raise ValueError("its T is no basis")
    if not p or not q or set(state) - set(shapes) - {"rows", "bits", "exact", "waiting_regressors"}:
        raise ValueError("it holds arrays that are no part of a fit")


def _require_count(state, name, low, most):
    value = require_numbers(name, state.get(name, ()), (), low)
    if value.dtype.kind not in "iu" or value > most:
        raise ValueError(f"its {name} is {value}, not a whole number up to {most}")


def hold_out(recording):
    """(The rest, every fifth trajectory cut into windows of equal length); every pair is in one of the two.

    With fewer than five trajectories each is cut first. (recording, None) if there is too little to hold anything out.
    """
    sixth = -(-int(recording.lengths.max() - 1) // 6)
    parts = recording if len(recording) >= 5 else recording.cut_all(max(2, sixth + 1))
    if len(parts) < 5 or np.median(parts.lengths) < 10:
        return recording, None
    fifth = np.arange(len(parts)) % 5 == 4
    lengths = parts.lengths[fifth]
    window = int(min(WINDOW, np.median(lengths)))
    whole, rest = parts[fifth].cut_all(window), parts[~fifth]
    full = whole.lengths == window
    leftover = [whole[~full]] if (~full).any() else []
    return join([rest, *leftover]), whole[full]
