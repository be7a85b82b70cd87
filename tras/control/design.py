"""A controller from settings in words and numbers, and what it does with its own model: behind `tras control`.

A closed loop of a controller with its own model is a prediction and no test: the true system decides.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import linalg

from tras.control.controller import Controller
from tras.control.lqr import LQR
from tras.control.margins import Margins, margins
from tras.control.mpc import MPC
from tras.control.observer import Observer
from tras.control.options import require_known
from tras.control.predictors import predictor
from tras.model import KoopmanModel
from tras.workflow.arguments import did_you_mean, number

_OF_MPC = ("horizon", "rate_weights", "rates", "states", "moves", "iterations")
_OF_LQR = ("input_weights", "state_weights")
_OF_OBSERVER = ("measured", "disturbed", "noise", "process", "drift")
SETTINGS = ("controller", "weights", "limits", "offset_free", "run", *_OF_MPC, *_OF_LQR, *_OF_OBSERVER)
RUN = ("reference", "seconds", "disturbance")
_STEPS = (0.0, 0.3, -0.3)  # half-ranges from the middle: the reference of the predicted run
_DISTURBANCE = 0.1  # half-ranges of each input, over its last quarter
_AT_REST = 1e-3  # half-ranges in a sample
_SHORTEST, _LONGEST = 300, 3000  # samples of a step


class Design(NamedTuple):
    """A controller and its predicted run.

    Attributes
    ----------
    controller : LQR or MPC
    settings : dict
        All of them, also those that were not given; the same controller comes of it.
    run : pandas.DataFrame
        ``time`` (s), ``solved``, every state and input, ``STATE: reference`` of the followed ones.
    parts : list of (str, int, int)
        What each part of the run is, its first sample, and the one after its last.
    margins : list of Margins or str
        At the end of each part; or why there are none.
    outside : pandas.DataFrame
        Per channel: the range of the data, that of the run, the share of samples beyond, and the limits.
    beyond_hull : float
        Share of the samples of the run at which the model is continued beyond the box around its training data.
    """

    controller: Controller
    settings: dict
    run: pd.DataFrame
    parts: list
    margins: list[Margins | str]
    outside: pd.DataFrame
    beyond_hull: float


def design(model: KoopmanModel, settings: Mapping | None = None) -> Design:
    """A controller for a model, from settings as a YAML file holds them, and its predicted run.

    Parameters
    ----------
    model
    settings
        ``controller`` ("mpc" or "lqr"), the options of `tras.MPC` or `tras.LQR` by their names, those of the observer
        (``measured, disturbed, noise, process, drift``), and ``run`` with ``reference`` (state -> values one after the
        other), ``seconds`` of each and ``disturbance`` (input -> value). See docs/control.md.

    Raises
    ------
    ValueError
        On an unknown setting, and as the controllers do.

    Examples
    --------
    >>> import tras
    >>> model = tras.KoopmanModel(tras.Monomials(3), strength=1e-6).fit(tras.example("duffing", noise=0))
    >>> made = design(model, {"horizon": 20, "run": {"reference": {"q": [0, 0.4]}, "seconds": 3}})
    >>> made.controller.followed, bool(abs(made.run["q"].iloc[119] - 0.4) < 1e-3)
    (('q',), True)
    """
    settings = {} if settings is None else settings
    if not isinstance(settings, Mapping):
        raise ValueError(f"the settings are {settings!r}; give names and values, such as horizon: 40.")
    for name in settings:
        if name not in SETTINGS:
            raise ValueError(f"the settings have {name!r}, which is none{did_you_mean(name, SETTINGS)}")
    settings = dict(settings)
    run = settings.pop("run", None) or {}
    if not isinstance(run, Mapping):
        raise ValueError(f"run is {run!r}; give names and values, such as seconds: 5.")
    for name in run:
        if name not in RUN:
            raise ValueError(f"the settings have {name!r} in run, which is none{did_you_mean(name, RUN)}")
    settings = _effective(_controller(model, settings), settings)
    controller = _controller(model, settings)
    settings["run"] = _run_settings(controller, *_plan(controller, run))
    levels, samples, disturbance = _plan(controller, settings["run"])
    table, at_rest = _simulate(controller, levels, samples, disturbance)
    parts = [(f"step {k + 1}", k * samples, (k + 1) * samples) for k in range(len(levels))]
    if disturbance.any():
        parts.append(("disturbance", len(levels) * samples, len(table)))
    outside, beyond = _outside(controller, model, table)
    return Design(controller, settings, table, parts, at_rest, outside, beyond)


def _controller(model, settings):
    kind = settings.get("controller", "mpc")
    if kind not in ("mpc", "lqr"):
        raise ValueError(f"controller is {kind!r}; choose mpc or lqr.")
    others = _OF_LQR if kind == "mpc" else _OF_MPC
    for name in others:
        if name in settings:
            raise ValueError(f"{name} is no setting of controller: {kind}; remove it, or choose the other.")
    given = {name: value for name, value in settings.items() if value is not None}
    options = {name: given[name] for name in (*_OF_MPC, *_OF_LQR, "limits", "weights", "offset_free") if name in given}
    for name in ("limits", "states"):
        if isinstance(options.get(name), Mapping):
            options[name] = {key: _ends(pair) for key, pair in options[name].items()}
    of_observer = {name: given[name] for name in _OF_OBSERVER if name in given}
    if of_observer:
        options["observer"] = Observer(model, **of_observer)
    if "weights" not in options:
        c = predictor(model).channels
        options["weights"] = {c.state_names[i]: float(1 / c.x_scale[i] ** 2) for i in _settable(model)}
    if not isinstance(options["weights"], Mapping):
        raise ValueError(f"weights is {options['weights']!r}; give states and their weights, such as phi: 1.")
    return (MPC if kind == "mpc" else LQR)(model, **options)


def _ends(pair):
    """A pair in which None stands for no limit."""
    if not isinstance(pair, (list, tuple)) or len(pair) != 2:
        return pair
    return [end if limit is None else limit for limit, end in zip(pair, (-np.inf, np.inf))]


def _settable(model):
    """As many states as there are inputs, those that can rest at values of their own: positions rather than rates."""
    p = predictor(model)
    c = p.channels
    z = p.start([c.x_offset], [c.u_offset])
    _, slopes = p.advance_with_slopes(z[:, None], np.zeros((len(c.u_offset), 1)))
    at_rest = np.hstack([np.eye(len(z)), np.zeros((len(z), len(c.u_offset)))]) - slopes[0]
    directions = np.linalg.svd(at_rest)[2][-len(c.u_offset) :]  # in which state and input move from rest to rest
    _, R, order = linalg.qr(directions[:, : len(c.x_offset)], pivoting=True, mode="economic")
    free = np.abs(np.diagonal(R)) > 1e-3 * abs(R[0, 0])
    return sorted(order[: len(free)][free].tolist()) or [0]


def _plan(controller, run):
    """Levels of the followed states (steps, p), samples of each, the disturbance (m,); in physical units."""
    c, rows = controller.channels, controller.rows
    middle, half = c.x_offset[rows], c.x_scale[rows]
    levels = middle + np.outer(_STEPS, half)
    given = run.get("reference") or {}
    if not isinstance(given, Mapping):
        raise ValueError(f"reference is {given!r}; give states and their values, such as phi: [0, 0.2].")
    if given:
        lengths = {len(np.atleast_1d(values)) for values in given.values()}
        if len(lengths) > 1:
            raise ValueError(f"reference has lists of {sorted(lengths)} values; give every state as many.")
        levels = np.tile(middle, (lengths.pop(), 1))
        for name, values in given.items():
            if name not in controller.followed:
                raise ValueError(
                    f"reference names {name!r}, which has no weight{did_you_mean(name, controller.followed)}"
                )
            for value in np.atleast_1d(values).tolist():
                number(f"reference[{name!r}]", value)
            levels[:, controller.followed.index(name)] = values
    seconds = run.get("seconds")
    samples = int(np.clip(10 * controller.horizon, _SHORTEST, _LONGEST))
    if seconds is not None:
        number("seconds", seconds, 2 * c.dt, _LONGEST * c.dt)
        samples = round(seconds / c.dt)
    disturbance = _DISTURBANCE * c.u_scale
    if run.get("disturbance") is not None:
        disturbance = np.zeros(len(c.u_scale))
        if not isinstance(run["disturbance"], Mapping):
            raise ValueError(f"disturbance is {run['disturbance']!r}; give inputs and values, such as force: 0.1.")
        for name, value in run["disturbance"].items():
            require_known("disturbance", name, c.input_names)
            number(f"disturbance[{name!r}]", value)
            disturbance[c.input_names.index(name)] = value
    return levels, samples, disturbance


def _simulate(controller, levels, samples, disturbance):
    """The loop of controller and model, without preview; the table, and the margins at the end of each part."""
    c, p = controller.channels, controller.predictor
    n, m = len(c.state_names), len(c.input_names)
    controller.reset()
    goals = np.repeat(levels, samples, axis=0)
    if disturbance.any():
        goals = np.vstack([goals, np.tile(levels[-1], (samples, 1))])
    z, rows, at_rest = p.start([c.x_offset], [c.u_offset]), [], []
    before = z
    for k, goal in enumerate(goals):
        x = z[:n] * c.x_scale + c.x_offset
        u = controller(x, goal)
        rows.append([k * c.dt, getattr(controller, "status", "solved") == "solved", *x, *u, *goal])
        if (k + 1) % samples == 0:
            wanted = (goal - c.x_offset[controller.rows]) / c.x_scale[controller.rows]
            estimate = z, np.zeros(m), np.zeros(len(z))
            if controller.observer is not None:
                estimate = controller.observer.estimate
            is_at_rest = np.abs(z - before).max() < _AT_REST
            result = margins(controller, *estimate, wanted) if is_at_rest else "still moving"
            at_rest.append("a limit is active" if result is None else result)
        scaled = (u - c.u_offset) / c.u_scale
        acting = scaled + (disturbance / c.u_scale if k >= len(levels) * samples else 0)
        before, z = z, p.advance(z[:, None], acting[:, None])[:, 0]
        if not np.isfinite(z).all() or np.abs(z).max() > 1e3:
            raise ValueError(
                f"the predicted run leaves the range of the data a thousandfold after {k * c.dt:.4g} s; give smaller "
                "steps, a longer horizon, other weights, or a better model."
            )
    references = [f"{name}: reference" for name in controller.followed]
    columns = ["time", "solved", *c.state_names, *c.input_names, *references]
    return pd.DataFrame(rows, columns=columns), at_rest


def _outside(controller, model, run):
    """Where the run goes that the data did not: per channel, and the share of samples beyond the hull."""
    c = controller.channels
    names, units = [*c.state_names, *c.input_names], [*c.state_units, *c.input_units]
    offset, scale = np.concatenate([c.x_offset, c.u_offset]), np.concatenate([c.x_scale, c.u_scale])
    values = run[names].to_numpy()
    beyond = (np.abs((values - offset) / scale) > 1 + 1e-9).mean(axis=0)
    none = np.full((len(c.state_names), 2), np.nan)
    limits = np.vstack([getattr(controller, "state_limits", none), controller.limits])
    table = pd.DataFrame({
        "channel": names, "unit": units, "data from": offset - scale, "to": offset + scale,
        "run from": values.min(axis=0), "run to": values.max(axis=0), "beyond": beyond,
        "limit from": limits[:, 0], "limit to": limits[:, 1],
    })  # fmt: skip
    if model.hull_ is None or c.delays:
        return table, float(np.abs((values - offset) / scale).max(axis=1).__gt__(1 + 1e-9).mean())
    points = ((values - offset) / scale).T
    return table, float((np.abs(model.hull_.nearest(points) - points).max(axis=0) > 1e-12).mean())


def _effective(controller, settings):
    """All settings but the run with the values that they have: plain numbers of a few digits, for YAML."""
    c, is_mpc = controller.channels, isinstance(controller, MPC)
    settings = {"controller": "mpc" if is_mpc else "lqr"} | settings
    settings["weights"] = _by_name(controller.followed, controller.weights[controller.rows])
    settings["limits"] = _pairs(c.input_names, controller.limits)
    if is_mpc:
        settings |= {"horizon": controller.horizon, "rate_weights": _by_name(c.input_names, controller.rate_weights)}
        settings["rates"] = _by_name(c.input_names, controller.rates)
        settings["states"] = _pairs(c.state_names, controller.state_limits)
        settings["iterations"] = controller.iterations
    else:
        settings["input_weights"] = _by_name(c.input_names, controller.input_weights)
    observer = controller.observer
    settings["offset_free"] = observer is not None
    if observer is not None:
        settings |= {"measured": list(observer.measured), "noise": _by_name(observer.measured, observer.noise)}
        settings |= {"disturbed": list(observer.disturbed), "process": _by_name(c.input_names, observer.process)}
        settings["drift"] = _by_name(observer.disturbed, observer.drift)
    return {name: value for name, value in settings.items() if value not in (None, {})}


def _run_settings(controller, levels, samples, disturbance):
    """Those of the run."""
    c = controller.channels
    reference = {name: list(map(_short, levels[:, i])) for i, name in enumerate(controller.followed)}
    return {
        "reference": reference, "seconds": _short(samples * c.dt), "disturbance": _by_name(c.input_names, disturbance),
    }  # fmt: skip


def _by_name(names, values):
    return {name: _short(value) for name, value in zip(names, values) if np.isfinite(value)}


def _pairs(names, values):
    return {
        name: [None if np.isinf(limit) else float(limit) for limit in pair]
        for name, pair in zip(names, values)
        if np.isfinite(pair).any()
    }


def _short(value):
    """A number of six digits."""
    return float(f"{value:.6g}")
