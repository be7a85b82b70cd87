"""What to mind about an identification, in plain sentences: rules over the numbers of `tras.datachecks` and of the model's test."""

import math
from typing import NamedTuple

import numpy as np

from tras.datachecks import beyond
from tras.identify_scores import CONSTANT
from tras.noise import noise_level


class Advice(NamedTuple):
    """``weight`` is "stop" (do not use the model as it is), "warning" or "note"; ``about`` a few words, ``text`` a sentence or two."""

    weight: str
    about: str
    text: str


def of(identification, log):
    """All advice on an identification (`tras.identification.Identification`) of the recording ``log``, the gravest first."""
    given = [*_verdict(identification), *_data(identification, log), *_excitation(identification), *_model(identification), *_reach(identification)]
    return sorted(given, key=lambda each: ("stop", "warning", "note").index(each.weight))


def verdict(identification):
    """One sentence: how well the model predicts the test, and whether that is better than a linear one."""
    table = identification.metrics.set_index(["prediction", "state"])["nrmse"]
    ours, linear = table["model"].to_numpy(), table["linear model"].to_numpy()
    horizon = float((identification.test.lengths.max() - 1) * identification.test.dt)
    if not np.isfinite(ours).any():
        return f"The model is of no use: every test prediction over {horizon:.3g} s ran away."
    worst = identification.test.state_names[int(np.nanargmax(ours))]
    size = f"{np.nanmin(ours):.2g} % to {np.nanmax(ours):.2g} % of the ranges, most in {worst}" if len(ours) > 1 else f"{ours[0]:.2g} % of the range"
    ratio = float(np.exp(np.nanmean(np.log(np.maximum(ours, 1e-12) / np.maximum(linear, 1e-12)))))
    if identification.model.dictionary.__class__.__name__ == "Monomials" and identification.model.dictionary.degree == 1:
        beside = "No nonlinear model was better than a linear one"
    elif not math.isfinite(ratio):
        beside = "The linear model ran away"
    elif ratio > 0.9:
        beside = "A linear model is about as good"
    else:
        beside = f"The error of a linear model is {1 / ratio:.3g} times as large"
    return f"Over {horizon:.3g} s the model misses the test data by {size}, root mean square. {beside}."


def _verdict(identification):
    table = identification.metrics.set_index(["prediction", "state"])
    for state in identification.test.state_names:
        row, constant = table.loc[("model", state)], table.loc[(CONSTANT, state)]
        if not row["nrmse"] < 0.95 * constant["nrmse"]:
            yield Advice(
                "stop",
                f"{state} is not predicted",
                f"Over the test windows {state} is missed by {row['nrmse']:.3g} % of its range; its mean alone misses it by {constant['nrmse']:.3g} %. "
                "Do not use the model for it; if nothing here can move it, leave it out (STATES=...), for it disturbs the choice of the model for the "
                "others.",
            )
    row = table.loc["model"].iloc[0]
    if row["diverged"]:
        weight = "stop" if row["diverged"] > 0.1 * row["windows"] else "warning"
        yield Advice(weight, "predictions ran away", f"{row['diverged']} of {row['windows']} test predictions ran away; they are left out of the errors.")


def _data(identification, log):
    channels = identification.checks.channels
    for text in identification.remarks["idle"]:
        yield Advice("warning", "a channel that says nothing", f"{text}.")
    for _, row in channels.iterrows():
        name = row["channel"]
        share = max(row["at_lowest"], row["at_highest"])
        if share > 0:
            value = row["highest"] if row["at_highest"] >= row["at_lowest"] else row["lowest"]
            cure = (
                "Record with less, or give the command before the limit and the limit itself"
                if row["role"] == "input"
                else "The sensor or a stop limits it; keep away from it"
            )
            yield Advice(
                "warning",
                f"{name} saturates",
                f"{name} stands at {value:.4g} for {100 * share:.2g} % of the samples. {cure}: a smooth model cannot know the limit.",
            )
        if row["levels"] <= 10:
            text = f"{name} takes only {row['levels']} different values; what happens between them is not in the data."
            yield Advice("note" if row["role"] == "input" else "warning", f"{name} has few values", text)
        elif row["step"] > 0.005 * (row["highest"] - row["lowest"]):
            yield Advice(
                "note",
                f"{name} is coarse",
                f"{name} moves in steps of {row['step']:.3g}, {100 * row['step'] / (row['highest'] - row['lowest']):.2g} % of its range.",
            )
        if row["wraps"] and row["role"] == "state":
            yield Advice(
                "stop",
                f"{name} jumps by a full turn",
                f"{name} jumps by a full turn {row['wraps']} times: an angle that wraps round. No model can follow that; unwrap it first (numpy.unwrap, "
                "MATLAB's unwrap).",
            )
            continue
        if row["noise"] > 0.02:
            yield Advice(
                "warning",
                f"{name} is noisy",
                f"The noise on {name} is {100 * row['noise']:.2g} % of its range (what moves within four samples is counted as noise). Noise on the "
                "states biases the fit; a better sensor or slower sampling helps more than any model.",
            )
        if row["role"] == "state" and row["jump"] > 0.3 and row["jump"] > 5 * row["usual"]:
            yield Advice(
                "warning",
                f"{name} jumps",
                f"{name} changes by {100 * row['jump']:.0f} % of its range within one sample, but by less than {100 * row['usual']:.2g} % in 99 of 100: "
                "an outlier, or a trial that begins without a column that says so.",
            )
        if row["shift"] > 1 and row["role"] == "state":
            yield Advice(
                "warning",
                f"{name} drifts",
                f"The mean of {name} differs between the first and the second half by {row['shift']:.2g} standard deviations: it drifts, or the halves "
                "hold different motions. The test then asks for something that was not learnt.",
            )
    if log.m == 0:
        yield Advice("note", "no inputs", "There is no input: the model is of the free motion only. If something drives the rig, name it (INPUTS=...).")


def _excitation(identification):
    facts, correlation = identification.checks.facts, identification.checks.correlation
    for name, share in facts["feedback"].items():
        if share > 0.9:
            yield Advice(
                "warning",
                f"{name} follows the states",
                f"A linear function of the present states explains {100 * share:.3g} % of {name}: a feedback loop, or an input so slow that the states "
                "follow it. What the input does and what the states do by themselves can hardly be told apart; add a test signal to the input.",
            )
    names = list(correlation)
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            if abs(correlation.loc[a, b]) > 0.8:
                yield Advice(
                    "warning",
                    f"{a} and {b} move together",
                    f"The correlation of {a} and {b} is {correlation.loc[a, b]:.2f}: their effects can hardly be told apart. Move them one by one, or "
                    "by signals of their own.",
                )
    if facts["rank"] < facts["channels"] or facts["condition"] > 300:
        yield Advice(
            "warning",
            "too little excitation",
            f"Constant, states and inputs (scaled) have a condition number of {facts['condition']:.3g}: some combination of channels hardly moves. The "
            "model says nothing reliable about it.",
        )
    order, needed = facts["order"], identification.recording.n + 1
    if order is not None and order < min(needed, 20):
        yield Advice(
            "warning",
            "too little excitation",
            f"The inputs are persistently exciting of order {order} (lags of {facts['lag'] * facts['dt']:.3g} s), a linear model of {identification.recording.n} "
            f"states asks for {needed}. Use a signal with more frequencies or more steps.",
        )
    pairs, functions = identification.train.pairs, len(identification.model.names_)
    if pairs < 10 * functions:
        yield Advice("warning", "a short recording", f"{pairs} snapshot pairs for {functions} functions: record longer.")
    if identification.test.pairs < 200 or len(identification.test) < 3:
        yield Advice("warning", "a short test", f"The test has {len(identification.test)} windows with {identification.test.pairs} snapshot pairs: its numbers are rough.")


def _model(identification):
    radius_of = identification.eigenvalues[identification.eigenvalues["model"] == "model"]
    moved = radius_of[np.hypot(radius_of["real"] - 1, radius_of["imag"]) > 1e-6]  # one exactly: the constant, and functions of held inputs
    fastest = moved["modulus"].max() if len(moved) else 0.0
    total = float((identification.recording.lengths.max() - 1) * identification.recording.dt)
    if fastest > 1 + identification.recording.dt / total:
        doubling = identification.recording.dt * math.log(2) / math.log(fastest)
        linear = identification.model.predictor == "lifted_linear"
        what = (
            "Trust predictions no longer than they were tested."
            if linear
            else ("Predictions lift the states anew and need not grow with it, but the powers of K do: the functions are not closed under the dynamics.")
        )
        about = f"The largest modulus of an eigenvalue is {fastest:.6f}: something in the lifted system doubles every {doubling:.3g} s."
        yield Advice("warning" if linear else "note", "an unstable operator", f"{about} {what}")
    slow = moved[np.abs(moved["modulus"] - 1) < identification.recording.dt / total]
    if len(slow):
        yield Advice(
            "note",
            "near-unit eigenvalues",
            f"{len(slow)} eigenvalues have a modulus so near to one that they would change by less than a factor e over the longest trajectory "
            f"({total:.3g} s). How such parts go on in the long run is not in the data.",
        )
    if identification.remarks["treatment"] == "smoothed":
        level = noise_level(identification.recording) / np.ptp(np.concatenate([x for x, _ in identification.recording]), axis=0)
        yield Advice(
            "note",
            "smoothed states",
            f"The states were smoothed before the fit, and test predictions start from smoothed states (noise {100 * level.max():.2g} % of the range at "
            "most). The table also has predictions that start from states as measured.",
        )
    if identification.model.condition_number > 1e10:
        yield Advice(
            "warning",
            "ill-conditioned",
            f"The condition number of the liftings is {identification.model.condition_number:.2g}: coefficients mean little by themselves, predictions may still "
            "be good.",
        )


def _reach(identification):
    for name, share in beyond(identification.train, identification.test).items():
        if share > 0.01:
            yield Advice(
                "warning",
                f"{name} beyond the training data",
                f"{100 * share:.2g} % of the test's samples of {name} are outside the range of the training data, where the model is a guess.",
            )
