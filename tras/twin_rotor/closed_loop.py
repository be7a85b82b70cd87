"""The simulated experiment: PID in the loop, torques held over each sample (paper, "Data collection").

The paper gives no gains. Ours place the poles of the double integrator ``J qddot = u`` at 4 rad/s with damping 0.9:
fast against the excitation (0.2 and 0.8 rad/s), slow against the sampling time of 0.01 s.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import ArrayLike

from tras.recording import Recording
from tras.twin_rotor import plant, rotors
from tras.twin_rotor.plant import LUMPED, TORQUE_NAMES, PlantParameters, torque_limits
from tras.twin_rotor.rotor_parameters import RotorParameters
from tras.workflow import arguments
from tras.workflow.provenance import versions

REFERENCE_NAMES = ("phi_ref", "psi_ref")
REFERENCE_UNITS = ("rad", "rad")
BATCH = 40  # runs from which arrays are faster than floats
Rig = PlantParameters | RotorParameters
INPUTS = {"reference": REFERENCE_NAMES, "torque": TORQUE_NAMES}  # what a model may take for its inputs


@dataclass(frozen=True)
class PID:
    """Gains of one axis: ``u = P e + I integral(e) - D qdot`` with ``e = reference - q``, limited to ``limits``.

    The derivative acts on the measurement, so a step of the reference gives no kick. The integral stops while the
    torque is at a limit and the error drives it further out (anti-windup by conditional integration; K. J. Astrom and
    T. Hagglund, *Advanced PID Control*, Sec. 3.5).

    Parameters
    ----------
    P, I, D : float
        N m/rad, N m/(rad s), N m s/rad.
    limits : (float, float)
        Lowest and highest torque in N m.

    Raises
    ------
    ValueError
        If a gain is not a finite number or the limits are not two finite torques in order.

    Examples
    --------
    >>> PID.pole_placement(inertia=0.03, limits=(-0.4, 0.4), frequency=2.0)
    PID(P=0.12, I=0.12, D=0.108, limits=(-0.4, 0.4))
    """

    P: float
    I: float  # noqa: E741 the field's own name
    D: float
    limits: tuple[float, float]

    def __post_init__(self):
        for name in "PID":
            arguments.number(name, getattr(self, name), give="a finite gain")
        object.__setattr__(self, "limits", torque_limits("limits", self.limits))

    @classmethod
    def pole_placement(
        cls,
        inertia: float,
        limits: tuple[float, float],
        *,
        frequency: float = 4.0,
        damping: float = 0.9,
        integral_rate: float = 1.0,
    ) -> "PID":
        """``P = J w^2``, ``D = 2 zeta w J``, ``I = P * integral_rate`` for an axis of the given inertia (kg m^2).

        ``frequency`` in rad/s, ``integral_rate`` in 1/s.
        """
        P = inertia * frequency**2
        return cls(P=P, I=P * integral_rate, D=2 * damping * frequency * inertia, limits=limits)

    @classmethod
    def defaults(cls, parameters: PlantParameters, **placement) -> tuple["PID", "PID"]:
        """The project's pair (pitch, yaw). Yaw's inertia is the one at level beam, ``J + J_psi0``.

        ``frequency`` and ``damping`` of `pole_placement` may be given.
        """
        inertia, limits = parameters.J + parameters.J_psi0, parameters.u_psi_limits
        return (
            cls.pole_placement(parameters.J_phi, parameters.u_phi_limits, integral_rate=1.0, **placement),
            cls.pole_placement(inertia, limits, integral_rate=0.5, **placement),
        )


def simulate_closed_loop(
    reference: ArrayLike,
    dt: float,
    parameters: Rig | None = None,
    *,
    controllers: Sequence[PID] | Callable | None = None,
    preview: bool = False,
    x0: ArrayLike | None = None,
    noise: ArrayLike | None = None,
    disturbances: ArrayLike | None = None,
    seed: int = 0,
    step: float = 0.01,
    attributes: dict | None = None,
) -> Recording:
    """Follow references with the PID, or a controller of your own, and record everything.

    At each sample the controller reads state and reference, and its torque is held until the next. By default the rig
    starts at rest ON the first reference with the integrators balanced (bumpless); one with motors starts at rest under
    commands of 0.

    Parameters
    ----------
    reference : (samples, 2) array_like
        Pitch and yaw reference in rad.
    dt : float
        Sampling time in s.
    parameters : PlantParameters or RotorParameters, optional
        With the latter the inputs are motor commands, and ``controllers`` must give these; the PID is in
        `tras.simulate_motor_loop`.
    controllers : (PID, PID) or callable, optional
        Pitch and yaw; default `PID.defaults`. Or one for both, called as ``u = controllers(x, reference)``: a
        `tras.MPC`, a `tras.LQR`, or a function. It is reset first, if it can be.
    preview : bool
        Whether that one sees the reference ahead, as far as its ``horizon``, or its present sample alone. The PID has
        no preview.
    x0 : (n,) array_like, optional
        Initial state; then the integrators start empty.
    noise : float or (n,) array_like, optional
        Standard deviation of the noise that is added to the states that the controller reads, in rad and rad/s. The
        recording holds the true states.
    disturbances : (2,) or (samples, 2) array_like, optional
        Torques in N m from outside that nobody knows of. The recording holds the controller's inputs alone.
    seed : int
        Of the noise.
    step : float
        Longest integration step in s.
    attributes : dict, optional
        Goes into the recording beside the plant's parameters, the gains and limits (seed, kind of excitation, ...).

    Returns
    -------
    Recording
        One trajectory of ``samples`` samples: states phi, phidot, psi, psidot; inputs phi_ref, psi_ref (rad) and
        u_phi, u_psi (N m), or those of the rotors. Sample ``k`` of the torques acts from sample ``k`` to ``k + 1``.

    Raises
    ------
    ValueError
        On wrong shapes or values.

    Examples
    --------
    >>> import tras
    >>> log = tras.simulate_closed_loop(tras.multisine(20, 0.01, [0.5, 1.2], [1.0, 2.5], 0), 0.01)
    >>> log.states.shape, log.input_names
    ((1, 2001, 4), ('phi_ref', 'psi_ref', 'u_phi', 'u_psi'))
    """
    reference = _references("reference", reference, "(samples, 2)", dimensions=(2,))
    rigs = [parameters or PlantParameters()]
    if x0 is not None:
        x0, names = np.asarray(x0, dtype=float), rigs[0].state_names
        if x0.shape != (len(names),) or not np.isfinite(x0).all():
            count = {4: "four", 6: "six"}[len(names)]
            raise ValueError(f"x0 is {x0.tolist()}; give {count} finite numbers {', '.join(names)}.")
    outside = _Outside(preview, noise, disturbances, seed)
    return _simulated(reference[None], dt, rigs, controllers, x0, step, attributes, outside)


def simulate_closed_loops(
    references: ArrayLike,
    dt: float,
    parameters: Rig | Sequence[Rig] | None = None,
    *,
    controllers: Sequence[PID] | Callable | Sequence[Callable] | None = None,
    preview: bool = False,
    x0: ArrayLike | None = None,
    noise: ArrayLike | None = None,
    disturbances: ArrayLike | None = None,
    seed: int = 0,
    step: float = 0.01,
    attributes: dict | None = None,
) -> Recording:
    """Simulate many runs for a Monte Carlo study: other references, initial states or rigs.

    Each run is that of `simulate_closed_loop` to the accuracy of the integration (1e-9 over 6 s). Forty runs or more
    take each step together, about ten times as fast for a thousand runs (`benchmarks/closed_loops.py`).

    Parameters
    ----------
    references : (runs, samples, 2) or (samples, 2) array_like
        Pitch and yaw reference in rad; a single one serves every run.
    parameters : PlantParameters, RotorParameters, or a sequence of either, optional
        One rig for all, or one per run.
    controllers : (PID, PID), callable or sequence of callable, optional
        Pitch and yaw, for every run; default `PID.defaults` of the rigs' mean parameters. Or one for both, as for
        `simulate_closed_loop`: the same for all runs, or a sequence with one per run. The runs are then made one after
        the other, and each begins with the ``reset()`` of its controller; one that remembers without it has to be
        given once per run.
    x0 : (n,) or (runs, n) array_like, optional
        Initial states, one for all or one per run.
    disturbances : (2,), (samples, 2) or (runs, samples, 2) array_like, optional
        Torques in N m that act beside the controller's, the same for all runs or each its own.
    dt, preview, noise, seed, step, attributes
        As for `simulate_closed_loop`; each run has noise of its own.

    Returns
    -------
    Recording
        One trajectory per run, with the channels of `simulate_closed_loop`. Parameters that differ between rigs are
        attributes with a list over the runs.

    Raises
    ------
    ValueError
        On wrong shapes or values, or numbers of runs that do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> rigs = [PlantParameters(K_psi=k) for k in rng.uniform(0.002, 0.004, 30)]
    >>> simulate_closed_loops(np.tile([0.3, 1.0], (101, 1)), 0.01, rigs).states.shape
    (30, 101, 4)
    """
    references = _references("references", references, "(runs, samples, 2)", dimensions=(2, 3))
    if parameters is None or isinstance(parameters, Rig):
        rigs = [parameters or PlantParameters()]
    else:
        rigs = list(parameters)
    x0 = None if x0 is None else np.asarray(x0, dtype=float)
    references = np.broadcast_to(references, (_runs(references, rigs, x0), *references.shape[-2:]))
    outside = _Outside(preview, noise, disturbances, seed)
    return _simulated(references, dt, rigs, controllers, x0, step, attributes, outside)


def saturated(recording: Recording, parameters: PlantParameters) -> np.ndarray:
    """Share of samples with a torque at its limit, (pitch, yaw), as fractions.

    The limits are those of the controllers, which `simulate_closed_loop` records, else those of ``parameters``.
    """
    torques = np.concatenate(recording.select(inputs=TORQUE_NAMES).inputs)
    defaults = {f"pid_{axis}_limits": getattr(parameters, f"u_{axis}_limits") for axis in ("phi", "psi")}
    limits = [recording.attributes.get(name, default) for name, default in defaults.items()]
    low, high = np.array(limits, dtype=float).T
    return ((torques <= low) | (torques >= high)).mean(axis=0)


class _Outside:
    """What reaches the loops from outside beside the references: preview, noise of the measurement, disturbances."""

    def __init__(self, preview, noise, disturbances, seed):
        arguments.seed("seed", seed, "the noise")
        self.preview, self.seed = bool(preview), seed
        self.noise = None if noise is None else _finite("noise", noise, "standard deviations")
        self.disturbances = None if disturbances is None else _finite("disturbances", disturbances, "torques")
        if self.noise is not None and (self.noise < 0).any():
            raise ValueError(f"noise is {np.asarray(noise).tolist()}; give standard deviations, 0 or more.")

    def of(self, runs, samples, n):
        """Noise (runs, samples, n) and disturbances (runs, samples, 2), or None."""
        noise = torques = None
        if self.noise is not None:
            if self.noise.shape not in ((), (n,)):
                raise ValueError(f"noise has shape {self.noise.shape}; give one standard deviation, or {n}.")
            noise = np.random.default_rng(self.seed).normal(size=(runs, samples, n)) * self.noise
        if self.disturbances is not None:
            try:
                torques = np.broadcast_to(self.disturbances, (runs, samples, 2))
            except ValueError:
                shapes = f"(2,), ({samples}, 2)" + (f" or ({runs}, {samples}, 2)" if runs > 1 else "")
                raise ValueError(f"disturbances has shape {self.disturbances.shape}; give {shapes}.") from None
        return noise, torques

    def attributes(self):
        noise = None if self.noise is None else self.noise.tolist()
        said = {"measurement_noise": noise, "noise_seed": None if noise is None else self.seed}
        said["preview"] = self.preview or None
        return {name: value for name, value in said.items() if value is not None}


def _simulated(references, dt, rigs, controllers, x0, step, attributes, outside):
    """A `Recording` of the runs (runs, samples, 2) with everything that made it in its attributes."""
    rig, (runs, samples) = rigs[0], references.shape[:2]
    own = _own_controllers(controllers, runs)
    if isinstance(rig, RotorParameters) and own is None:
        remedy = "give a controller of these, such as a tras.MPC, or use tras.simulate_motor_loop"
        raise ValueError(f"controllers are PIDs of torques, but the rig has motor commands; {remedy}.")
    controllers = PID.defaults(_mean(rigs)) if controllers is None else controllers
    n = len(rig.state_names)
    noise, gusts = outside.of(runs, samples, n)
    if own is not None:
        about = {"controller": _one_or_all([repr(control) for control in own])}
    else:
        pid = dict(zip(("phi", "psi"), controllers))
        about = {f"pid_{axis}_{gain}": getattr(pid[axis], gain) for axis in pid for gain in "PID"}
        about |= {f"pid_{axis}_limits": list(pid[axis].limits) for axis in pid}
    if runs >= BATCH and own is None:
        control = _PIDPair(controllers, references, dt, _stacked(rigs), x0)
        states, torques = _loop(references, dt, _stacked(rigs), control, x0, step, noise, gusts)
    else:
        starts = [None] * runs if x0 is None else np.broadcast_to(x0, (runs, n))
        trajectories = []
        for run, (reference, rig, start) in enumerate(zip(references, rigs * (runs // len(rigs)), starts)):
            start = rotors.rest_point(rig) if start is None and isinstance(rig, RotorParameters) else start
            if own is not None:
                control = _Seeing(own[run], reference, outside.preview)
            else:
                control = _PIDPair(controllers, reference, dt, rig, start)
            parts = (None if part is None else part[run] for part in (noise, gusts))
            trajectories.append(_loop(reference, dt, rig, control, start, step, *parts))
        states, torques = map(np.stack, zip(*trajectories))
    return Recording(
        list(states),
        list(np.concatenate([references, torques], axis=2)),
        dt,
        state_names=rig.state_names,
        state_units=rig.state_units,
        input_names=REFERENCE_NAMES + rig.input_names,
        input_units=REFERENCE_UNITS + rig.input_units,
        attributes={
            **{f"plant_{name}": _one_or_all([rig.as_dict()[name] for rig in rigs]) for name in rigs[0].as_dict()},
            **about,
            **outside.attributes(),
            **{f"version_{name}": version for name, version in versions().items()},
            "integration_step": step,
            **(attributes or {}),
        },
    )


def _own_controllers(controllers, runs):
    """The controller of each run, or None if they are PIDs."""
    if controllers is None:
        return None
    if callable(controllers):
        return [controllers] * runs
    callables = [callable(control) for control in controllers]
    if not any(callables):
        return None
    if len(callables) != runs or not all(callables):
        raise ValueError(
            f"controllers holds {sum(callables)} callables for {runs} run{'s' if runs > 1 else ''}; give one for all, "
            "or one per run."
        )
    return list(controllers)


def _loop(reference, dt, rig, control, x0, step, noise=None, gusts=None):
    """States (..., samples, n) and torques (..., samples, 2) under a reference (..., samples, 2).

    A single run takes plain floats, many runs take arrays and make each step together. ``rig`` is one, or several as
    `_stacked` makes them; ``control(k, x)`` gives the inputs of sample k. ``noise`` (..., samples, n) is added to what
    it reads, ``gusts`` (..., samples, 2) are torques from outside.
    """
    batch = reference.shape[:-2]
    if x0 is None:
        x0 = np.zeros((*batch, 4))
        x0[..., ::2] = reference[..., 0, :]
    x = np.ascontiguousarray(np.moveaxis(np.broadcast_to(x0, (*batch, np.shape(x0)[-1])), -1, 0))
    noise, gusts = (None if part is None else np.moveaxis(part, (-2, -1), (0, 1)) for part in (noise, gusts))
    if not batch:
        x = x.tolist()
        noise, gusts = (None if part is None else part.tolist() for part in (noise, gusts))
    advance = stepper(rig, dt, step=step, functions=np if batch else math, gusts=gusts is not None)
    states, torques = [], []
    with np.errstate(over="ignore", invalid="ignore"):  # `advance` raises
        for k in range(reference.shape[-2]):
            if torques:
                x = advance(x, torques[-1] if gusts is None else (*torques[-1], *gusts[k - 1]))
            states.append(x)
            torques.append(control(k, x if noise is None else [q + e for q, e in zip(x, noise[k])]))
    return tuple(np.moveaxis(np.array(values), (0, 1), (-2, -1)) for values in (states, torques))


def stepper(rig, dt: float, *, step: float = 0.01, functions=math, gusts: bool = False) -> Callable:
    """``advance(x, inputs)`` of either plant; with ``gusts`` two torques from outside follow the inputs."""
    if isinstance(rig, RotorParameters):
        return rotors.stepper(rig, dt, step=step, functions=functions, gusts=gusts)
    advance = plant.stepper(rig, dt, step=step, functions=functions)
    if not gusts:
        return advance
    return lambda x, u: advance(x, (u[0] + u[2], u[1] + u[3]))


class _Seeing:
    """A controller of both axes with a run's reference (samples, 2): the whole horizon of it, or one sample."""

    def __init__(self, controller, reference, preview):
        self.controller, self.reference = controller, reference
        self.ahead = getattr(controller, "horizon", 0) if preview else None
        getattr(controller, "reset", lambda: None)()

    def __call__(self, k, x):
        ahead = self.reference[k] if self.ahead is None else self.reference[k : k + 1 + self.ahead]
        u = np.asarray(self.controller(np.array(x), ahead), dtype=float)
        if u.shape != (2,) or not np.isfinite(u).all():
            raise ValueError(f"controllers returned {u.tolist()} at sample {k}; it must return two finite torques.")
        return tuple(u.tolist())


class _PIDPair:
    """Both PIDs with the reference of a run, or of many at once, their integrators balanced at the start."""

    def __init__(self, pair, reference, dt, rig, x0):
        batch = reference.shape[:-2]
        functions, clip = (np, np.clip) if batch else (math, clip_float)
        reference = np.ascontiguousarray(np.moveaxis(reference, (-2, -1), (0, 1)))
        self.reference = reference if batch else reference.tolist()
        self.integrals = [0.0, 0.0]
        if x0 is None:
            phi, psi = self.reference[0]
            balance = (rig.G_c * functions.cos(phi) + rig.G_s * functions.sin(phi), rig.K_psi * psi)
            self.integrals = [clip(torque, *pid.limits) if pid.I else 0.0 for pid, torque in zip(pair, balance)]
        self.pitch, self.yaw = (control_law(pid, dt, clip) for pid in pair)

    def __call__(self, k, x):
        (r_phi, r_psi), (phi, phidot, psi, psidot) = self.reference[k], x
        of_phi, of_psi = self.integrals
        u_phi, of_phi = self.pitch(r_phi - phi, phidot, of_phi)
        u_psi, of_psi = self.yaw(r_psi - psi, psidot, of_psi)
        self.integrals = of_phi, of_psi
        return u_phi, u_psi


def control_law(pid, dt, clip):
    """``(error, rate, integral) -> (torque, next integral)`` of one axis, torque and integral in N m."""
    P, I, D, (low, high) = pid.P, pid.I, pid.D, pid.limits  # noqa: E741 the field's own name

    def control(error, rate, integral):
        demand = P * error + integral - D * rate
        torque = clip(demand, low, high)
        integrates = (torque == demand) | ((demand - torque) * error < 0)
        return torque, integral + integrates * (I * error * dt)

    return control


def clip_float(value, low, high):
    """`numpy.clip` for a float."""
    return low if value < low else high if value > high else value


def _finite(name, values, what):
    values = np.asarray(values, dtype=float)
    if not np.isfinite(values).all():
        raise ValueError(f"{name} holds NaN or infinity; give finite {what}.")
    return values


def _references(name, values, shape, dimensions):
    values = np.asarray(values, dtype=float)
    if values.ndim not in dimensions or values.shape[-1] != 2 or values.shape[-2] < 2 or values.size == 0:
        raise ValueError(f"{name} has shape {values.shape}; give {shape}: pitch and yaw in rad, two samples or more.")
    if not np.isfinite(values).all():
        raise ValueError(f"{name} holds NaN or infinity; give finite angles in rad.")
    return values


def _runs(references, rigs, x0):
    """Number of runs, on which references, rigs and initial states have to agree."""
    if not all(isinstance(rig, Rig) for rig in rigs) or not rigs:
        raise ValueError(
            "parameters must be a tras.PlantParameters or tras.RotorParameters, or a sequence of them, one per run."
        )
    kinds = sorted({type(rig).__name__ for rig in rigs})
    if len(kinds) > 1:
        raise ValueError(f"parameters mixes {' and '.join(kinds)}, which have other equations; simulate them apart.")
    names = rigs[0].state_names
    counts = {"references": len(references) if references.ndim == 3 else 1, "parameters": len(rigs)}
    if x0 is not None:
        if x0.ndim not in (1, 2) or x0.shape[-1] != len(names) or not np.isfinite(x0).all():
            shapes = f"({len(names)},) or (runs, {len(names)})"
            raise ValueError(f"x0 has shape {x0.shape}; give finite {', '.join(names)}: {shapes}.")
        counts["x0"] = len(x0) if x0.ndim == 2 else 1
    runs = max(counts.values())
    if any(count not in (1, runs) for count in counts.values()):
        numbers = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise ValueError(f"the numbers of runs differ: {numbers}; give one for all, or one per run.")
    return runs


def _stacked(rigs):
    """One rig as it is; several as one whose parameters are arrays, for `tras.twin_rotor.plant.stepper`."""
    if len(rigs) == 1:
        return rigs[0]
    arrays = {name: np.array([getattr(rig, name) for rig in rigs]) for name in LUMPED}
    return SimpleNamespace(velocity_term=rigs[0].velocity_term, **arrays)


def _mean(rigs):
    """The rig of the mean parameters, with the first one's limits."""
    if len(rigs) == 1:
        return rigs[0]
    means = {name: math.fsum(getattr(rig, name) for rig in rigs) / len(rigs) for name in LUMPED}
    return PlantParameters(**means, u_phi_limits=rigs[0].u_phi_limits, u_psi_limits=rigs[0].u_psi_limits)


def _one_or_all(values):
    return values if any(value != values[0] for value in values) else values[0]
