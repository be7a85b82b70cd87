"""Channels and their scales: what every identified model stands on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tras
from tras.estimator import Channels

NUMBERS = st.floats(-1e6, 1e6).filter(lambda value: value == 0 or abs(value) > 1e-6)


def log(seed=0, **labels):
    """Two trajectories of unequal length, two states and one input far from zero."""
    rng = np.random.default_rng(seed)
    x, u = [rng.normal(5, [1, 100], (k, 2)) for k in (30, 20)], [rng.normal(-3, 0.01, (k, 1)) for k in (30, 20)]
    return tras.Recording(x, u, 0.1, state_names=["a", "b"], input_names=["v"], **labels)


@given(middle=NUMBERS, half=st.floats(1e-3, 1e6))
def test_every_channel_spans_minus_one_to_one(middle, half):
    """To rounding of its middle, whatever the unit."""
    values = middle + half * np.linspace(-1, 1, 11)[:, None]
    scaled = Channels.of(tras.Recording([values], [values[::-1]], 0.1)).scaled(tras.Recording([values], [values], 0.1))
    tolerance = 4 * np.finfo(float).eps * (1 + abs(middle) / half)
    assert np.allclose([scaled.states.min(), scaled.inputs.min()], -1, rtol=0, atol=tolerance)
    assert np.allclose([scaled.states.max(), scaled.inputs.max()], 1, rtol=0, atol=tolerance)


@pytest.mark.parametrize("delays, inputs", [(0, False), (2, False), (2, True)])
def test_points_are_scaled_as_recordings_are_delayed_samples_too(delays, inputs):
    recording = log()
    channels = Channels.of(recording, None, delays, inputs)
    late = recording.delayed(delays, inputs=inputs)
    assert channels.z_names == list(late.state_names)
    for (x, u), (z, v) in zip(late, channels.scaled(recording), strict=True):
        points = channels.points(x, u)
        assert np.array_equal(points[0], z) and np.array_equal(points[1], v)
        assert np.allclose(z * channels.z_scale + channels.z_offset, x, rtol=1e-12)


def test_given_ranges_are_the_scale():
    channels = Channels.of(log(), {"a": (0.0, 10.0), "b": (-1.0, 3.0), "v": (2.0, 4.0)})
    assert np.array_equal(channels.x_offset, [5, 1]) and np.array_equal(channels.x_scale, [5, 2])
    assert np.array_equal(channels.u_offset, [3]) and np.array_equal(channels.u_scale, [1])


def test_earlier_inputs_are_delayed_only_where_there_are_inputs_and_delays():
    autonomous = tras.Recording([np.arange(12.0).reshape(6, 2) ** 2], dt=0.1)
    assert (
        not Channels.of(autonomous, None, 2, True).delayed_inputs
        and not Channels.of(log(), None, 0, True).delayed_inputs
    )
    assert Channels.of(log(), None, 2, True).z_names == ["a", "b", "a[-1]", "b[-1]", "a[-2]", "b[-2]", "v[-1]", "v[-2]"]


@pytest.mark.parametrize(
    "recording, message",
    [
        (lambda: log().select(states=["b"]), "there is no channel 'a'"),
        (lambda: tras.Recording(log().states, log().inputs, 0.2), "sampled at 0.2 s but the model at 0.1 s"),
    ],
)
def test_other_channels_or_another_sampling_time_are_refused(recording, message):
    channels, other = Channels.of(log()), recording()
    if message.startswith("sampled"):
        other = other.with_data([x for x, _ in other], [u for _, u in other], state_names=["a", "b"], input_names=["v"])
    with pytest.raises(ValueError, match=message):
        channels.matched(other)


def test_matched_channels_stand_in_the_models_order():
    turned = log().select(states=["b", "a"])
    assert np.array_equal(Channels.of(log()).matched(turned)[0].states, log()[0].states)
