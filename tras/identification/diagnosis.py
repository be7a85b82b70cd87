"""What a control engineer asks of an identified model: tests of its residuals, its responses beside the recording's."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from tras.analysis import responses
from tras.analysis.linearization import matrices
from tras.analysis.residuals import Residuals
from tras.dictionaries.base import label
from tras.identification import preparation
from tras.identification.search import LINEAR_DICTIONARY
from tras.rollout import predict_coarsely
from tras.solver.threads import one_blas_thread

LEVEL = 0.9  # of the band
_TESTED = 20_000  # residuals, about
_SIMULATED = 20_000  # samples of the simulated response, at most
_STEPS = 25  # samples that a prediction of the second test reaches, at most
_LONGEST = 1000  # samples of a step response
_FREQUENCIES = 80  # of the recording, at most
_GRID = 100  # frequencies of the model
_SETTLED = 0.02
_FED_BACK = 0.5  # share of an input that the present states explain, from which on it may be a controller's


class Responses(NamedTuple):
    """Tables of the responses, and sentences on them."""

    step: pd.DataFrame  # time, input, state, response, lower, upper
    bode: pd.DataFrame  # kind, input, state, frequency, gain, phase, lower, upper, ..., see `_bode`
    remarks: list[str]


class Diagnosis(NamedTuple):
    """From `diagnose`: name of a figure -> tests of residuals, or why there are none; and responses, if any."""

    tests: dict[str, Residuals | str]
    responses: Responses | None


def diagnose(identification) -> Diagnosis:
    """Both for one `Identification`."""
    with one_blas_thread():
        return Diagnosis(residual_tests(identification), of_responses(identification))


def outputs(identification) -> dict[str, str]:
    """States whose responses are worth drawing, with their units: a velocity's is its position's over again."""
    recording = identification.recording
    velocities = {velocity for _, velocity in identification.pairs}
    units = dict(zip(recording.state_names, recording.state_units))
    return {name: unit for name, unit in units.items() if name not in velocities} or units


def residual_tests(identification) -> dict[str, Residuals | str]:
    """Tests of the residuals over one sample and over several, of the whole test; or why there is none."""
    whole, model = identification.whole_test, identification.model
    if whole.pairs > _TESTED:
        whole = preparation.thinned(whole.cut_all(2001), _TESTED)
    steps = int(np.clip(identification.test.lengths.max() // 5, 2, _STEPS))
    tests = {}
    for reach, name in ((1, "residuals"), (steps, "residuals_ahead")):
        try:
            tests[name] = model.residuals(whole, steps=reach)
        except ValueError as error:
            tests[name] = f"The residuals over {reach} sample{'s' if reach > 1 else ''} are not tested: {error}"
    return tests


def strongest(tests: Residuals) -> str:
    """The largest correlation among the tested ones that are outside their bounds, in a sentence; or nothing."""
    table = tests.correlations[tests.correlations["tested"]]
    table = table[np.abs(table["correlation"]) > table["bound"]]
    if tests.white or not len(table):
        return ""
    row = table.loc[table["correlation"].abs().idxmax()]
    other = "itself" if row["against"] == "itself" else row["against"]
    return f"The largest correlation is {row['correlation']:.2f}, of {row['state']} with {other} at lag {row['lag']}."


def of_responses(identification) -> Responses | None:
    """Responses of the linearised model, with the bootstrap's band, and of the recording; None without inputs."""
    if not identification.recording.m:
        return None
    model, recording = identification.model, identification.recording
    x, u, rests = responses.rest_point(model, recording)
    system = matrices(model, x, u)
    members = []
    for member in identification.ensemble:
        try:
            members.append(matrices(member, x, u))
        except ValueError:  # it runs away from there
            continue
    remarks = [_where(model, x, u, rests)]
    reach = int(10 * identification.test.lengths.max())
    step = _step(model, system, members, min(reach, _LONGEST))
    samples = responses.segment_length(recording)
    measured = simulated = None
    if samples:
        later = [(x[model.delays :], u[model.delays :]) for x, u in recording if len(x) > model.delays]
        measured = responses.measured_response(*map(list, zip(*later)), recording.dt, samples)
    if measured is not None and label(model.dictionary) != LINEAR_DICTIONARY:
        simulated = _simulated(model, recording, samples)
    remarks += _trust(identification, measured)
    if simulated is not None:
        remarks.append(
            "the model is not linear: the recording's response is that at the amplitudes of the recording, and what "
            "compares with it is the response of the model's own simulation (dash-dotted), not that of small deviations"
        )
    return Responses(step, _bode(model, recording, system, members, measured, simulated), remarks)


def _where(model, x, u, rests):
    values = zip((*model.state_names_, *model.input_names_), (*x, *u))
    point = ", ".join(f"{name} = {value:.3g}" for name, value in values)
    if model.predictor == "lifted_linear":
        return "the model is linear in its liftings: its responses are the same about every point"
    if not rests:
        return (
            f"linearised about the mean of the recording, {point}: under its mean input the model does not rest there"
        )
    return f"linearised about the point where the model rests under the recording's mean input, {point}"


def _step(model, system, members, samples):
    """Step responses per unit of input until they have settled, and the band."""
    nominal = responses.step_response(system, samples)
    runs = [responses.step_response(each, samples) for each in members]
    low, high = _band(np.stack(runs)) if runs else [np.full_like(nominal, np.nan)] * 2
    with np.errstate(invalid="ignore"):
        moving = np.abs(nominal - nominal[-1]) > _SETTLED * np.ptp(nominal, axis=0)
    settled = int(np.flatnonzero(moving.any(axis=(1, 2))).max(initial=0)) + 1
    samples = int(np.clip(1.5 * settled, min(25, samples), samples))
    time, parts = np.arange(samples) * system.dt, []
    for j, name in enumerate(model.input_names_):
        for i, state in enumerate(model.state_names_):
            values = {"response": nominal, "lower": low, "upper": high}
            values = {key: value[:samples, i, j] for key, value in values.items()}
            parts.append(pd.DataFrame({"time": time, "input": name, "state": state, **values}))
    return pd.concat(parts, ignore_index=True)


def _band(values):
    """Lower and upper edge over the members, which are the first axis."""
    values = np.nan_to_num(values, nan=np.inf, posinf=np.inf, neginf=-np.inf)
    return np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0, method="inverted_cdf")


def _bode(model, recording, system, members, measured, simulated):
    """Gains and phases, long: ``kind`` ("linearised", "recording", "simulated"), ``input, state, frequency`` (Hz),
    ``gain`` (unit of the state per unit of the input), ``phase`` (degrees), ``lower, upper, phase_lower, phase_upper``
    (the bootstrap's band), and of the recording ``deviation`` (of the gain, a fraction), ``coherence, trusted``.
    """
    lowest = measured.frequency[0] if measured is not None else 2.0 / (recording.lengths.max() * recording.dt)
    grid = np.geomspace(lowest, 0.5 / recording.dt, _GRID)
    of_model = responses.frequency_response(system, grid)
    gains, turns = np.abs(of_model), np.unwrap(np.angle(of_model), axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        others = [responses.frequency_response(each, grid) for each in members]
        # Relative to the model's own: a phase has no beginning.
        beside = np.stack([np.angle(other / of_model) for other in others]) if others else None
    if others:
        (low, high), (early, late) = _band(np.abs(np.stack(others))), turns + _band(beside)
    else:
        low = high = early = late = np.full_like(gains, np.nan)
    parts = []
    for j, name in enumerate(model.input_names_):
        for i, state in enumerate(model.state_names_):
            columns = {"lower": low, "upper": high, "phase_lower": np.degrees(early), "phase_upper": np.degrees(late)}
            columns = {"gain": gains, "phase": np.degrees(turns)} | columns
            columns = {key: value[:, i, j] for key, value in columns.items()}
            parts.append(
                pd.DataFrame({"kind": "linearised", "input": name, "state": state, "frequency": grid, **columns})
            )
            for kind, each in (("recording", measured), ("simulated", simulated)):
                if each is not None:
                    parts.append(_rows(each, i, j, of_model, grid).assign(kind=kind, input=name, state=state))
    return pd.concat(parts, ignore_index=True)


def _rows(measured, i, j, of_model, grid):
    """The response of state i to input j, thinned evenly in the logarithm of frequency; its phase near the model's."""
    f = measured.frequency
    some = np.unique(np.searchsorted(f, np.geomspace(f[0], f[-1], _FREQUENCIES)).clip(max=len(f) - 1))
    response = measured.response[some, i, j]
    turns = np.interp(f[some], grid, np.unwrap(np.angle(of_model[:, i, j])))
    phase = turns + np.angle(response * np.exp(-1j * turns))
    columns = {"frequency": f[some], "gain": np.abs(response), "phase": np.degrees(phase)}
    columns |= {"deviation": measured.deviation[some, i, j], "coherence": measured.coherence[some, i]}
    return pd.DataFrame(columns | {"trusted": measured.trusted[some, i, j]})


def _simulated(model, recording, samples):
    """The response of the model's simulations over the same segments, each from the measured samples before it."""
    d, parts = model.delays, []
    for x, u in recording:
        for k in responses.starts(len(x) - d, samples):
            parts.append((x[k : k + d + samples], u[k : k + d + samples]))
    segments = preparation.thinned(recording.with_data(*map(list, zip(*parts))), _SIMULATED)
    with np.errstate(over="ignore", invalid="ignore"):
        runs = predict_coarsely(model, segments)
    alive = [k for k, run in enumerate(runs) if np.isfinite(run).all()]
    if len(alive) < 0.9 * len(runs):
        return None
    states, inputs = ([part[k][d:] for k in alive] for part in (runs, segments.inputs))
    return responses.measured_response(states, inputs, recording.dt, samples)


def _trust(identification, measured):
    """Where the recording's own response tells nothing, and why."""
    if measured is None:
        return ["the recording is too short for a frequency response of its own"]
    recording, dt = identification.recording, identification.recording.dt
    sentences = [
        f"the recording's response is by Welch's method: {measured.segments} segments of "
        f"{measured.samples * dt:.3g} s, so nothing is known below {measured.frequency[0]:.2g} Hz"
    ]
    for j, name in enumerate(recording.input_names):
        excited, trusted = measured.excited[:, j], measured.trusted[:, :, j]
        some = trusted.any(axis=1)
        if not some.any():
            why = "noise, other inputs or what is not linear hide it" if excited.any() else f"{name} has no power"
            sentences.append(f"the response to {name} cannot be trusted at any frequency: {why}")
            continue
        low, high = measured.frequency[np.flatnonzero(some)[[0, -1]]]
        where = f"from {low:.2g} Hz to {high:.2g} Hz" if high > low else f"at {low:.2g} Hz alone"
        sentence = f"the response to {name} can be trusted {where}"
        if not some[(measured.frequency >= low) & (measured.frequency <= high)].all():
            sentence += ", not everywhere between"
        quiet = 1 - excited.mean()
        if quiet > 0.05:
            sentence += f"; at {100 * quiet:.0f} % of the frequencies {name} has too little power"
        sentences.append(sentence)
    loops = {name: share for name, share in identification.checks.facts["feedback"].items() if share > _FED_BACK}
    if loops:
        shares = ", ".join(f"{100 * share:.0f} % of {name}" for name, share in loops.items())
        sentences.append(
            f"a linear function of the present states explains {shares}: if that is a controller (a closed loop), the "
            "recording's response mixes the rig with it and is no judge of the model"
        )
    return sentences
