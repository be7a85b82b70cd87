"""Many closed loops at once, for Monte Carlo studies: other references, initial states, or rigs (paper, "Data collection", many times)."""

import math
from types import SimpleNamespace

import numpy as np

from tras import closed_loop
from tras.closed_loop import PID, recorded
from tras.plant import PlantParameters, stepper

TOGETHER = 40  # runs from which arrays are faster than floats


def simulate_closed_loops(references, dt, parameters=None, *, controllers=None, x0=None, step=0.01, attributes=None):
    """`simulate_closed_loop` for many runs, which take each step together: some ten times as fast for a thousand (`benchmarks/closed_loops.py`).

    Each run is that of `simulate_closed_loop` to the accuracy of the integration (1e-9 over 6 s); all take the steps of the fastest rig. Fewer
    than forty runs are faster one after the other, and are made so.

    Parameters
    ----------
    references : (runs, samples, 2) or (samples, 2) array_like
        Pitch and yaw reference in rad; a single one is for every run.
    dt : float
        Sampling time in s.
    parameters : PlantParameters or sequence of them, optional
        One rig, or one a run.
    controllers : (PID, PID), optional
        Pitch and yaw, for every run; default `PID.defaults` of one rig, of the rigs' mean parameters if there are several: the loop was
        tuned before anyone knew which rig it would be.
    x0 : (4,) or (runs, 4) array_like, optional
        Initial states; then the integrators start empty. Default: at rest on the first reference, integrators balanced.
    step : float
        Longest integration step in s.
    attributes : dict, optional
        Goes into the recording.

    Returns
    -------
    Recording
        One trajectory a run, channels as of `simulate_closed_loop`. With several rigs their parameters are lists in the attributes.

    Raises
    ------
    ValueError
        On wrong shapes or values, or numbers of runs that do not fit.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> rigs = [PlantParameters(K_psi=k) for k in rng.uniform(0.002, 0.004, 30)]
    >>> simulate_closed_loops(np.tile([0.3, 1.0], (101, 1)), 0.01, rigs).states.shape
    (30, 101, 4)
    """
    references = np.asarray(references, dtype=float)
    if references.ndim not in (2, 3) or references.shape[-1] != 2 or references.shape[-2] < 2 or references.size == 0:
        raise ValueError(f"references has shape {references.shape}; give (runs, samples, 2): pitch and yaw in rad, two samples or more.")
    if not np.isfinite(references).all():
        raise ValueError("references holds NaN or infinity; give finite angles in rad.")
    rigs = [parameters or PlantParameters()] if parameters is None or isinstance(parameters, PlantParameters) else list(parameters)
    x0 = None if x0 is None else np.asarray(x0, dtype=float)
    runs = _runs(references, rigs, x0)
    controllers = controllers or PID.defaults(_mean(rigs))
    references = np.broadcast_to(references, (runs, *references.shape[-2:]))
    loops = _together if runs >= TOGETHER else _one_by_one
    states, torques = loops(references, dt, rigs, controllers, x0, step)
    inputs = np.concatenate([references, torques], axis=2)
    return recorded(list(states), list(inputs), dt, rigs[0], controllers, step, {**_varied(rigs), **(attributes or {})})


def _varied(rigs):
    """What differs between rigs, as lists over the runs."""
    values = {f"plant_{name}": [rig.as_dict()[name] for rig in rigs] for name in rigs[0].as_dict()}
    return {name: value for name, value in values.items() if any(one != value[0] for one in value)}


def _runs(references, rigs, x0):
    """Number of runs, which those of references, rigs and initial states have to agree on."""
    _require_alike(rigs)
    counts = {"references": len(references) if references.ndim == 3 else 1, "parameters": len(rigs)}
    if x0 is not None:
        if x0.ndim not in (1, 2) or x0.shape[-1] != 4 or not np.isfinite(x0).all():
            raise ValueError(f"x0 has shape {x0.shape}; give finite phi, phidot, psi, psidot: (4,) or (runs, 4).")
        counts["x0"] = len(x0) if x0.ndim == 2 else 1
    runs = max(counts.values())
    if any(count not in (1, runs) for count in counts.values()):
        raise ValueError(f"the numbers of runs differ: {', '.join(f'{name} {count}' for name, count in counts.items())}; give one for all, or one a run.")
    return runs


def _require_alike(rigs):
    if not all(isinstance(rig, PlantParameters) for rig in rigs) or not rigs:
        raise ValueError("parameters must be a tras.PlantParameters or a sequence of them, one a run.")
    if len(set(map(type, rigs))) > 1:
        raise ValueError("parameters mixes rigs with the corrected and the printed velocity term; simulate them apart.")


def _stacked(rigs):
    """The rigs as one whose parameters are arrays, for `tras.plant.stepper`."""
    names = [name for name, value in rigs[0].as_dict().items() if isinstance(value, (int, float))]
    term = getattr(rigs[0], "velocity_term", "corrected")
    return SimpleNamespace(velocity_term=term, **{name: np.array([getattr(rig, name) for rig in rigs]) for name in names})


def _mean(rigs):
    """The rig of the mean parameters, with the first one's limits."""
    if len(rigs) == 1:
        return rigs[0]
    first = rigs[0].as_dict()
    means = {name: math.fsum(getattr(rig, name) for rig in rigs) / len(rigs) for name, value in first.items() if isinstance(value, (int, float))}
    limits = {name: first[name] for name in ("u_phi_limits", "u_psi_limits")}
    return PlantParameters(**means, **limits)


def _one_by_one(references, dt, rigs, controllers, x0, step):
    """States (runs, samples, 4) and torques (runs, samples, 2)."""
    runs = len(references)
    starts = [None] * runs if x0 is None else np.broadcast_to(x0, (runs, 4))
    made = [closed_loop._loop(r, dt, rig, controllers, start, step) for r, rig, start in zip(references, rigs * (runs // len(rigs)), starts)]
    return tuple(map(np.stack, zip(*made)))


def _together(references, dt, rigs, controllers, x0, step):
    """The same, a step of all runs at a time; `tras.closed_loop._loop` on arrays."""
    plant = rigs[0] if len(rigs) == 1 else _stacked(rigs)
    pitch, yaw = controllers
    runs, samples, _ = references.shape
    if x0 is None:
        phi, psi = references[:, 0].T.copy()
        x = (phi, np.zeros(runs), psi, np.zeros(runs))
        gravity = plant.G_c * np.cos(phi) + plant.G_s * np.sin(phi)
        integral_phi, integral_psi = _balance(pitch, gravity), _balance(yaw, plant.K_psi * psi)
    else:
        x, integral_phi, integral_psi = tuple(np.broadcast_to(x0, (runs, 4)).T.copy()), np.zeros(runs), np.zeros(runs)
    advance = stepper(plant, dt, step=step, functions=np)
    states, torques = np.empty((samples, 4, runs)), np.empty((samples, 2, runs))
    with np.errstate(over="ignore", invalid="ignore"):  # `advance` says so itself
        for k in range(samples):
            phi, phidot, psi, psidot = states[k] = x
            u_phi, integral_phi = _control(pitch, references[:, k, 0] - phi, phidot, integral_phi, dt)
            u_psi, integral_psi = _control(yaw, references[:, k, 1] - psi, psidot, integral_psi, dt)
            torques[k] = u_phi, u_psi
            if k + 1 < samples:
                x = advance(x, (u_phi, u_psi))
    return states.transpose(2, 0, 1), torques.transpose(2, 0, 1)


def _balance(controller, torque):
    """`tras.closed_loop._balance` for arrays."""
    return np.clip(torque, *controller.limits) if controller.I else np.zeros_like(torque)


def _control(controller, error, rate, integral, dt):
    """`tras.closed_loop._control` for arrays."""
    wanted = controller.P * error + integral - controller.D * rate
    torque = np.clip(wanted, *controller.limits)
    moves = (torque == wanted) | ((wanted - torque) * error < 0)
    return torque, integral + np.where(moves, controller.I * error * dt, 0.0)
