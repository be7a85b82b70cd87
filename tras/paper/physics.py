"""Physics back from data: the eight lumped parameters of the twin rotor from an identified field (paper, Sec. II).

With torques in N m the equations of motion are linear in the parameters (``J_psi = J cos^2 phi + J_psi0``):

    J psidot^2 sin(2 phi) / 2 + J_phi phiddot + G_c cos phi + G_s sin phi + C_phi phidot = u_phi
    J (cos^2 phi psiddot - psidot phidot sin(2 phi)) + J_psi0 psiddot + C_psi psidot + K_psi psi = u_psi

so with the accelerations that an identified field F gives, they follow by one linear least-squares problem.
"""

from collections.abc import Callable

import numpy as np
import pandas as pd
from sklearn.base import clone

from tras.model import KoopmanModel
from tras.recording import Recording, join
from tras.twin_rotor.plant import STATE_NAMES, STATE_UNITS, TORQUE_NAMES, TORQUE_UNITS
from tras.workflow import arguments
from tras.workflow.study import each

PARAMETER_NAMES = ("J", "J_psi0", "J_phi", "G_c", "G_s", "C_phi", "C_psi", "K_psi")
PARAMETER_UNITS = ("kg m^2", "kg m^2", "kg m^2", "N m", "N m", "N m s/rad", "N m s/rad", "N m/rad")


def torque_balance(x: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """The matrix A of ``A p = u``, p being the eight parameters: (points, 4), (points, 2) -> (2, points, 8).

    Columns in the order of `PARAMETER_NAMES`; the first block is pitch's balance, the second yaw's.
    """
    phi, phidot, psi, psidot = np.moveaxis(np.asarray(x, dtype=float), -1, 0)
    phiddot, psiddot = np.moveaxis(np.asarray(acceleration, dtype=float), -1, 0)
    s2, c, s, none = np.sin(2 * phi), np.cos(phi), np.sin(phi), np.zeros_like(phi)
    pitch = [psidot**2 * s2 / 2, none, phiddot, c, s, phidot, none, none]
    yaw = [c**2 * psiddot - psidot * phidot * s2, psiddot, none, none, none, none, psidot, psi]
    return np.stack([np.stack(pitch, axis=-1), np.stack(yaw, axis=-1)])


def lumped_parameters(model: KoopmanModel, recording: Recording) -> pd.Series:
    """The eight lumped parameters of the plant, by least squares on the torque balance over a recording.

    The identified field gives the accelerations at the recording's states and torques, and the parameters are those
    that fit the torques best. The recording only says where to ask; but noise leads away from the motion on which
    the field was identified, so take the smoothed recording.

    Parameters
    ----------
    model : KoopmanModel
        With a vector field, of the states phi, phidot, psi, psidot (rad, rad/s) and the torques u_phi, u_psi (N m).
    recording : Recording
        With these channels; others are ignored.

    Returns
    -------
    pandas.Series
        ``J, J_psi0, J_phi`` in kg m^2, ``G_c, G_s`` in N m, ``C_phi, C_psi`` in N m s/rad, ``K_psi`` in N m/rad.

    Raises
    ------
    ValueError
        If model or recording have other channels or units, the model has no vector field or gives no finite rate, or
        the motion is too poor to tell the parameters apart.

    Examples
    --------
    >>> import tras
    >>> loop = tras.simulate_closed_loop(tras.multisine(40, 0.01, [1.0, 2.0], [0.8, 2.0], 0), 0.01)
    >>> log = loop.select(inputs=["u_phi", "u_psi"])
    >>> model = tras.KoopmanModel(tras.Mechanical(), strength=0).fit(log)
    >>> lumped_parameters(model, log)[["J", "C_phi"]].round(4).to_dict()
    {'J': 0.0238, 'C_phi': 0.0127}
    >>> tras.PlantParameters().J, tras.PlantParameters().C_phi
    (0.0238, 0.0127)
    """
    return pd.Series(_estimate(model, _plant_channels(join(recording))), index=list(PARAMETER_NAMES), name="value")


def parameter_intervals(
    model: KoopmanModel, recording: Recording, draws: int = 50, level: float = 0.95, seed: int = 0,
    pipeline: Callable[[Recording], KoopmanModel] | None = None, points: Recording | None = None, processes: int = 1,
) -> pd.DataFrame:  # fmt: skip
    """The lumped parameters with confidence intervals, by a bootstrap over trajectories.

    Each draw takes as many trajectories as there are, with replacement, and identifies a model and its parameters. The
    interval lies between the (1 - level)/2 and (1 + level)/2 quantiles of the draws; the standard error is their
    standard deviation (B. Efron and R. J. Tibshirani, *An Introduction to the Bootstrap*, 1993, Ch. 6 and 13).

    The interval shows how far the data scatter. It does NOT see a bias: what all draws get wrong alike, by a dictionary
    that is too small or by noise and smoothing, stays invisible, and the truth may lie outside. 50 draws are enough
    for a standard error; the ends of a 95 % interval want 1000. Trajectories must be many and alike: cut the recording.

    Parameters
    ----------
    model, recording
        As in `lumped_parameters`, whose result is the column ``value``.
    draws : int
    level : float
        Confidence, between 0 and 1.
    seed : int
        Of the draws: the same one gives the same table.
    pipeline : callable, optional
        ``pipeline(recording) -> model``, all that was done to get ``model``: smoothing and refinement belong into it.
        Default: fit a fresh copy of ``model``, with its options.
    points : Recording, optional
        The same trajectories where the fields are to be asked, if not at ``recording`` itself: smoothed, when
        ``recording`` holds noise that ``pipeline`` is to see.
    processes : int
        Draws at the same time; the result does not depend on it.

    Returns
    -------
    pandas.DataFrame
        Index the parameters' names; columns ``value``, ``low``, ``high``, ``standard_error``.

    Raises
    ------
    ValueError
        As `lumped_parameters`; also on a count or level out of range, a single trajectory, ``points`` of other
        trajectories, or a draw that cannot be identified.

    Examples
    --------
    >>> import tras
    >>> loop = tras.simulate_closed_loop(tras.multisine(40, 0.01, [1.0, 2.0], [0.8, 2.0], 0), 0.01)
    >>> log = loop.select(inputs=["u_phi", "u_psi"]).cut(401)
    >>> model = tras.KoopmanModel(tras.Mechanical(), strength=0).fit(log)
    >>> intervals = parameter_intervals(model, log, draws=3)
    >>> list(intervals.columns), bool((intervals["low"] <= intervals["high"]).all())
    (['value', 'low', 'high', 'standard_error'], True)
    """
    arguments.whole_number("draws", draws, 2)
    arguments.number("level", level, 0, 1, ends=False, give="a confidence between 0 and 1, for example 0.95")
    if pipeline is not None and not callable(pipeline):
        raise ValueError(f"pipeline is {pipeline!r}; give a function of a recording that returns a fitted model.")
    recording = _plant_channels(join(recording))
    count = len(recording)
    if count < 2:
        reason = "has one trajectory, and a bootstrap draws among several"
        raise ValueError(f"the recording {reason}; cut it into pieces with recording.cut(samples).")
    points = recording if points is None else _plant_channels(join(points))
    if not np.array_equal(points.lengths, recording.lengths):
        counts = f"points has {len(points)} trajectories, recording {count}"
        raise ValueError(f"{counts}, or their lengths differ; give the same ones, smoothed.")
    identify = pipeline or (lambda resample: clone(model).fit(resample))
    value = _estimate(model, points)
    resamples = np.random.default_rng(seed).integers(count, size=(draws, count)).tolist()
    shared = identify, recording, points
    estimates = np.array(each(_draw, enumerate(resamples), shared, title="bootstrap", processes=processes))
    low, high = np.quantile(estimates, [(1 - level) / 2, (1 + level) / 2], axis=0)
    columns = {"value": value, "low": low, "high": high, "standard_error": estimates.std(axis=0, ddof=1)}
    return pd.DataFrame(columns, index=list(PARAMETER_NAMES))


def _draw(identify, recording, points, k, indices):
    """The parameters from one draw of trajectories."""
    try:
        return _estimate(identify(recording[indices]), points[indices])
    except ValueError as error:
        raise ValueError(f"draw {k} of the bootstrap cannot be identified ({error})") from error


def _estimate(model, recording):
    """The parameters (8,), in the order of `PARAMETER_NAMES`."""
    for role, expected in (("state", STATE_NAMES), ("input", TORQUE_NAMES)):
        names = tuple(getattr(model, f"{role}_names_", expected))
        if names != expected:
            present = f"the model's {role}s are {', '.join(names) or 'none'}"
            raise ValueError(f"{present}; the torque balance needs {', '.join(expected)}, in this order.")
    x, u = (np.concatenate(part) for part in zip(*recording))
    rates = model.vector_field(x, u)
    if not np.isfinite(rates).all():
        raise ValueError("the model's vector field is not finite on this recording; take data like those of the fit.")
    A = torque_balance(x, rates[:, [1, 3]]).reshape(-1, len(PARAMETER_NAMES))
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1
    parameters, _, rank, _ = np.linalg.lstsq(A / size, u.T.ravel(), rcond=1e-10)
    if rank < len(size):
        combinations = f"{rank} combinations of the {len(size)} parameters"
        raise ValueError(f"the recording tells only {combinations} apart; record motion of both angles.")
    return parameters / size


def _plant_channels(recording):
    """The recording with the plant's channels in the plant's order."""
    for role, expected, units in (("state", STATE_NAMES, STATE_UNITS), ("input", TORQUE_NAMES, TORQUE_UNITS)):
        names = getattr(recording, f"{role}_names")
        missing = [name for name in expected if name not in names]
        if missing:
            raise ValueError(
                f"the recording has no {role} {missing[0]!r} among {', '.join(names) or 'none'}; the torque balance "
                f"needs the states {', '.join(STATE_NAMES)} and the inputs {', '.join(TORQUE_NAMES)}."
            )
        known = dict(zip(names, getattr(recording, f"{role}_units")))
        for name, unit in zip(expected, units):
            if known[name] not in ("", unit):
                raise ValueError(f"{role} {name!r} is in {known[name]!r}; convert it to {unit}.")
    return recording.select(states=STATE_NAMES, inputs=TORQUE_NAMES)
