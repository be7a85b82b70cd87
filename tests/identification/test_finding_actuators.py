"""Which states are actuators, by their numbers or by name; and that the searches use them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tras
from tras.identification.actuators import driven, find_actuators
from tras.identification.folder import open_log
from tras.identification.search import candidates as candidates_of

PAIRS = [("q", "v")]


def motor_and_body(seed=0, lag=0.1, gain=1.0, force=1.0, noise=0.0, samples=3000, dt=0.02):
    """A motor with the given lag that drives a pendulum; ``force=0``: it follows the input, but drives nothing."""
    rng = np.random.default_rng(seed)
    u, x = np.repeat(rng.uniform(-1, 1, (samples // 20 + 1, 1)), 20, axis=0)[:samples], np.zeros((samples, 3))
    for k in range(samples - 1):
        q, v, w = x[k]
        rate = (gain * np.tanh(2 * u[k, 0]) - w - 0.2 * w**3) / lag
        x[k + 1] = q + dt * v, v + dt * (force * w * abs(w) - np.sin(q) - 0.4 * v), w + dt * rate
    x += noise * np.ptp(x, axis=0) * rng.normal(size=x.shape)
    return tras.Recording([x], [u], dt, state_names=["q", "v", "w"], input_names=["u"])


@settings(deadline=None, max_examples=15)
@given(
    st.integers(0, 10**6), st.floats(0.08, 0.6), st.sampled_from([1e-3, 1.0, 1e4]), st.sampled_from([0.0, 1e-3, 5e-3])
)
def test_an_actuator_is_found_whatever_its_lag_unit_and_noise(seed, lag, unit, noise):
    log = motor_and_body(seed, lag, noise=noise)
    log = log.with_data([x * [1.0, 1.0, unit] for x, _ in log], [u for _, u in log])
    assert find_actuators(log, PAIRS) == ["w"]


def test_what_only_follows_or_only_drives_is_none():
    assert find_actuators(motor_and_body(force=0.0), PAIRS) == []
    log = motor_and_body()
    x, u = log.states[0], log.inputs[0]
    slow = np.cumsum(np.random.default_rng(1).normal(size=(len(x), 1)), axis=0) / 50  # drives, but follows nothing
    pushed = x.copy()
    for k in range(len(x) - 1):
        q, v, _ = pushed[k]
        pushed[k + 1, :2] = q + 0.02 * v, v + 0.02 * (slow[k, 0] - np.sin(q) - 0.4 * v)
    pushed[:, 2:] = slow
    assert find_actuators(log.with_data([pushed], [u]), PAIRS) == []
    assert find_actuators(log, []) == []
    assert find_actuators(log.select(inputs=[]), PAIRS) == []
    assert find_actuators(log.select(states=["q", "v"]), PAIRS) == []
    assert find_actuators(log.with_data([x[:9]], [u[:9]]), PAIRS) == []


def test_names_decide_over_numbers():
    log = motor_and_body(force=0.0)
    log.attributes["actuators"] = ["w"]
    assert find_actuators(log, PAIRS) == ["w"] and driven(log, PAIRS, find_actuators(log, PAIRS), 3).actuators == [2]
    log.attributes["actuators"] = []
    assert find_actuators(log, PAIRS) == [] and driven(log, PAIRS, find_actuators(log, PAIRS), 3) is None
    log.attributes["actuators"] = ["v"]
    with pytest.raises(ValueError, match="actuators: 'v' is no state that can be one; these can: w."):
        find_actuators(log, PAIRS)


def test_the_searches_use_them():
    log = motor_and_body()
    candidates = [model.dictionary for model in candidates_of(log)]
    assert [d.actuators for d in candidates if isinstance(d, tras.Mechanical)] == [[2]]
    identification = tras.identify(log, predictor="one_step", smoothing=False, lead=0, draws=0)
    assert identification.model.dictionary.actuators == [2]
    assert (
        "w is an actuator, which follows the inputs and drives the body, by their numbers"
        in (identification.remarks["pairs"])
    )


def test_the_command_takes_names(tmp_path):
    log = motor_and_body(force=0.0, samples=300)
    path = tmp_path / "motor.csv"
    table = np.column_stack([np.arange(300) * log.dt, log.states[0], log.inputs[0]])
    np.savetxt(path, table, delimiter=",", header="time,q,v,w,u", comments="")
    roles = {"states": ["q", "v", "w"], "inputs": ["u"]}
    assert "actuators" not in open_log([path], **roles).attributes
    assert open_log([path], **roles, actuators=["w"]).attributes["actuators"] == ["w"]
    assert open_log([path], **roles, actuators=["none"]).attributes["actuators"] == []
