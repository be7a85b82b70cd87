"""One wrong sample multiplies the error of a model: it is found, and what is meant is not taken for one."""

import numpy as np
import pytest

import tras
from tras.identification import advice
from tras.identification.checks import channels
from tras.identification.examples import example

N = 2000


def drawn(kind):
    """An input of 2000 samples as people give them."""
    rng = np.random.default_rng(0)
    return {
        "noise": lambda: rng.normal(size=N),
        "heavy tails": lambda: rng.laplace(size=N),
        "random binary, one sample each": lambda: rng.choice([-1.0, 1.0], N),
        "random binary, five samples each": lambda: np.repeat(rng.choice([-1.0, 1.0], N // 5), 5),
        "steps": lambda: np.repeat(rng.uniform(-1, 1, N // 100), 100),
        "short pulses": lambda: (np.arange(N) % 400 < 2) * 1.0,
        "chirp": lambda: np.sin(2 * np.pi * 0.04 * np.linspace(0, 30, N) ** 2),
        "constant": lambda: np.ones(N),
    }[kind]()


def recording(u):
    return tras.Recording([np.random.default_rng(1).normal(size=(N, 1)).cumsum(axis=0)], [u[:, None]], 0.01)


def told(log):
    """About what `advice` warns, by channel."""
    rows = channels(log).to_dict("records")
    return {
        about: text for row in rows for _, about, text in advice._channel(row, row["channel"], row["role"] == "input")
    }


KINDS = ["noise", "heavy tails", "random binary, one sample each", "random binary, five samples each", "steps",
         "short pulses", "chirp", "constant"]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_meant_is_no_glitch(kind):
    assert channels(recording(drawn(kind)))["glitches"].tolist() == [0, 0]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("samples", [1, 2, 3])
def test_a_glitch_in_an_input_is_found_and_told(kind, samples):
    u = drawn(kind)
    u[700 : 700 + samples] = 10 * np.abs(u).max()
    row = channels(recording(u)).iloc[1]
    assert row["glitches"] == samples and 6.99 < row["glitch_at"] < 7.03 and row["glitch_in"] == 0
    text = told(recording(u))["u1 has a glitch"]
    assert f"{row['glitch_at']:.6g} s after the beginning of trajectory 0" in text and "repair it, or cut there" in text


def test_smooth_inputs_show_small_glitches():
    u = drawn("steps")
    u[700] += 0.3
    assert channels(recording(u)).iloc[1]["glitches"] == 1


@pytest.mark.parametrize("name", ["duffing", "cart_pole"])
def test_the_examples_have_none(name):
    assert not channels(example(name))["glitches"].any()


def test_a_glitch_is_found_in_its_trajectory_and_in_a_state(experiment):
    assert not channels(experiment)["glitches"].any()
    states = experiment.states.copy()
    states[3, 200, 1] += 0.25 * np.ptp(states[..., 1])  # less than what "jumps" is told for
    row = channels(experiment.with_data(list(states), list(experiment.inputs))).iloc[1]
    assert row["glitches"] == 1 and row["glitch_in"] == 3 and row["glitch_at"] == pytest.approx(2.0)


@pytest.mark.parametrize("length", [1, 2, 5, 29])
def test_too_few_samples_say_nothing(length):
    u = np.zeros((length, 1))
    u[-1] = 1
    assert channels(tras.Recording([np.ones((length, 1))], [u], 0.1))["glitches"].tolist() == [0, 0]
