"""What to mind about an identification, in sentences: rules over the numbers of `checks` and of the test."""

import itertools
import math
from functools import partial
from typing import NamedTuple

import numpy as np

from tras.dictionaries.base import label
from tras.display.html import in_notebook
from tras.identification.checks import beyond
from tras.identification.noise import noise_level
from tras.identification.scores import CONSTANT, HELD
from tras.identification.search import LINEAR_DICTIONARY
from tras.workflow import page
from tras.workflow.arguments import percent, short


class Advice(NamedTuple):
    """``weight`` is "stop" (do not use the model as it is), "warning" or "note"; ``text`` has a sentence or two."""

    weight: str
    about: str
    text: str


class AdviceList(list):
    """All advice on an identification, the gravest first. It prints one line for each."""

    def __repr__(self):
        return "\n".join(f"{weight}: {short(about, 80)}" for weight, about, _ in self) or "no warnings"

    def _repr_html_(self):
        return in_notebook(self.html())

    def html(self) -> str:
        """Each with its weight as a sign, a word and a colour."""
        if not self:
            return "<p>No warnings.</p>\n"
        articles = []
        for weight, about, sentence in self:
            sign, kind, word = _BADGES[weight]
            badge = f'<span class="verdict {kind}"><span aria-hidden="true">{sign}</span> {word}</span>'
            text = f"<p>{page.escape(sentence)}</p>"
            articles.append(f"<article><h3>{badge} {page.escape(about)}</h3>\n{text}</article>\n")
        return "".join(articles)


# Sign, kind (a class of the page's style sheet) and word.
_BADGES = {
    "stop": ("✗", "not", "do not use it so"),
    "warning": ("!", "named", "warning"),
    "note": ("i", "uncheckable", "note"),
}
WEIGHTS = tuple(_BADGES)
stop, warning, note = (partial(Advice, weight) for weight in WEIGHTS)


def of(identification, log) -> AdviceList:
    """All advice on an `Identification` of the recording ``log``, the gravest first."""
    about_data = [*_data(identification, log), *_excitation(identification)]
    advice = [*_verdict(identification), *about_data, *_model(identification), *_reach(identification)]
    return AdviceList(sorted(advice, key=lambda each: WEIGHTS.index(each.weight)))


def verdict(identification) -> str:
    """How well the model predicts the test, started from measured samples, and whether something simpler is better."""
    table = identification.metrics.set_index(["prediction", "state"])
    of_model = table.loc["model"]
    horizon, longest = (float(of_model[column].iloc[0]) for column in ("horizon", "free_horizon"))
    if not np.isfinite(of_model["nrmse"]).any():
        return f"The model is of no use: every test prediction over {horizon:.3g} s ran away."
    moving = of_model["moves"].to_numpy(dtype=bool)
    if not moving.any():
        return (
            f"The test says nothing: no state moves in it. At rest the model stays within "
            f"{of_model['nrmse'].max():.2g} % of the ranges."
        )
    of_model = of_model[moving]
    remark = "; ".join(getattr(identification, "remarks", {}).get("choice", []))
    parts = [f"Over {horizon:.3g} s the model misses the test data by {_range_of(of_model['nrmse'])}, root mean square"]
    if not np.isfinite(of_model["free"]).all():
        parts.append(f"a free run over the whole test ({longest:.3g} s) runs away")
    elif longest > 1.2 * horizon:
        parts.append(f"in a free run over the whole test ({longest:.3g} s) by {_range_of(of_model['free'])}")
    if lost := int(of_model["diverged"].iloc[0]):
        parts.append(f"{lost} of {int(of_model['windows'].iloc[0])} predictions ran away")
    errors, comparison = "; ".join(parts), _comparison(table, moving, identification.model.dictionary, remark)
    if comparison.startswith(_BETTER):  # what decides whether to use it comes first
        return f"{comparison}. {errors}."
    return f"{errors}. {comparison}."


_WORSE = 1.05  # errors beyond this ratio to a linear model's are worse
_BETTER = ("Do not use it", "A linear model is better", "A linear model ran away less")


def _range_of(errors):
    worst = errors.index[int(np.nanargmax(errors))]
    if len(errors) == 1:
        return f"{percent(errors.iloc[0])} of the range"
    return f"{percent(np.nanmin(errors))} to {percent(np.nanmax(errors))} of the ranges, most in {worst}"


def error_of(table, prediction, moving=None) -> float:
    """The error of one prediction in a number: the geometric mean over states, windows and free runs, in %.

    The mean over windows alone where the model's free run, or this one's, ran away.
    """
    rows = table.loc[prediction] if moving is None else table.loc[prediction][moving]
    columns = ["nrmse", "free"] if np.isfinite(table.loc["model"]["free"]).all() else ["nrmse"]
    return float(np.exp(np.nanmean(np.log(np.maximum(rows[columns].to_numpy(dtype=float), 1e-12)))))


def _comparison(table, moving, dictionary, remark):
    """The model beside the linear one and the trivial ones, in both directions."""
    ours = error_of(table, "model", moving)
    trivial = {name: error_of(table, name, moving) for name in (HELD, CONSTANT)}
    better = min(trivial, key=trivial.__getitem__)
    if trivial[better] < ours:
        what = "that nothing changes" if better == HELD else "the mean of the training data"
        return f"Do not use it: to predict {what} is better (its error is {trivial[better] / ours:.2g} times as large)"
    if label(dictionary) == LINEAR_DICTIONARY:
        return f"The model is linear: {remark}" if remark else "The model is linear; no nonlinear one was better"
    lost = {name: table.loc[name, "diverged"].iloc[0] for name in ("model", "linear model")}
    if lost["model"] > lost["linear model"]:
        return "A linear model ran away less often"
    ratio = error_of(table, "linear model", moving) / ours
    if lost["linear model"] > lost["model"] or not math.isfinite(ratio):
        return "The linear model ran away" + (" more often" if lost["model"] else "")
    if ratio < 1 / _WORSE:
        return f"A linear model is better: its error is {ratio:.2g} times as large"
    if ratio < 1.1:
        return "A linear model is about as good"
    return f"The error of a linear model is {ratio:.3g} times as large"


def worse_than_linear(metrics) -> str:
    """Why the test speaks for the linear model and against the chosen one, or nothing."""
    table = metrics.set_index(["prediction", "state"])
    moving = table.loc["model", "moves"].to_numpy(dtype=bool)
    lost, of_linear = (int(table.loc[name, "diverged"].iloc[0]) for name in ("model", "linear model"))
    holds, linear_holds = (np.isfinite(table.loc[name, "free"]).all() for name in ("model", "linear model"))
    if lost > of_linear:
        windows = int(table.loc["model", "windows"].iloc[0])
        return f"it ran away in {lost} of {windows} test windows, a linear model in {of_linear}"
    if lost == of_linear and linear_holds and not holds:
        return "its free run over the test ran away, that of a linear model did not"
    if lost < of_linear or holds and not linear_holds:
        return ""
    moving = moving if moving.any() else ~moving
    ratio = error_of(table, "model", moving) / error_of(table, "linear model", moving)
    return f"its error in the test is {ratio:.3g} times that of a linear model" if ratio > _WORSE else ""


def _verdict(identification):
    table = identification.metrics.set_index(["prediction", "state"])
    for state in identification.test.state_names:
        error = table.loc[("model", state), "nrmse"]
        if not table.loc[("model", state), "moves"]:
            yield warning(
                f"the test says nothing of {state}",
                f"{state} hardly moves in the test (its range there is less than 5 % of that in the training data). "
                "Record longer, or name other trials as the test (TEST=...).",
            )
            continue
        trivial = {name: table.loc[(name, state), "nrmse"] for name in (CONSTANT, HELD)}
        better = min(trivial, key=trivial.__getitem__)
        if not error < 0.95 * trivial[better]:
            missed = f"is missed by {error:.3g} % of its range" if np.isfinite(error) else "is lost"
            what = "its mean alone" if better == CONSTANT else "to say that it stays where it is"
            yield stop(
                f"{state} is not predicted",
                f"Over the test windows {state} {missed}; {what} misses it by {trivial[better]:.3g} %. Do not use the "
                "model for it; if nothing here can move it, leave it out (STATES=...), for it disturbs the choice of "
                "the model for the others.",
            )
    diverged, windows = (int(table.loc["model"][column].iloc[0]) for column in ("diverged", "windows"))
    if diverged:
        kind = stop if diverged > 0.1 * windows else warning
        text = f"{diverged} of {windows} test predictions ran away; they are left out of the errors of all models."
        yield kind("predictions ran away", text)
    # Half-ranges against percent of a range.
    search, test = 50 * identification.remarks["error"], error_of(table, "model")
    if search > 0 and np.isfinite(test) and test > 3 * search and test > 1:
        yield warning(
            "worse in the test than in the search",
            f"The error in the test is {test / search:.2g} times that by which the model was chosen: the test holds "
            "motions that the training data do not, or the choice was luck.",
        )


def _data(identification, log):
    for text in identification.remarks["idle"]:
        yield warning("a channel that says nothing", f"{text}.")
    for text in identification.remarks["spikes"]:
        yield warning("lone samples far off", f"{text}.")
    for row in identification.checks.channels.to_dict("records"):
        yield from _channel(row, row["channel"], row["role"] == "input")
    if log.m == 0:
        text = "There is no input: the model is of the free motion only."
        yield note("no inputs", f"{text} If something drives the rig, name it (INPUTS=...).")


def _channel(row, name, is_input):
    share, span = max(row["at_lowest"], row["at_highest"]), row["highest"] - row["lowest"]
    if share > 0:
        value = row["highest"] if row["at_highest"] >= row["at_lowest"] else row["lowest"]
        cure = "The sensor or a stop limits it; keep away from it"
        if is_input:
            cure = "Record with less, or give the command before the limit and the limit itself"
        where = f"{name} stands at {value:.4g} for {100 * share:.2g} % of the samples"
        yield warning(f"{name} saturates", f"{where}. {cure}: a smooth model cannot know the limit.")
    if row["levels"] <= 10:
        text = f"{name} takes only {row['levels']} different values; what happens between them is not in the data."
        yield (note if is_input else warning)(f"{name} has few values", text)
    elif row["step"] > 0.005 * span:
        percent = f"{100 * row['step'] / span:.2g} %"
        yield note(f"{name} is coarse", f"{name} moves in steps of {row['step']:.3g}, {percent} of its range.")
    jumps = row["jump"] > 0.3 and row["jump"] > 5 * row["usual"]
    if row["glitches"] and (is_input or not jumps):
        several = row["glitches"] > 1
        count = f"{row['glitches']} samples of {name} stand" if several else f"One sample of {name} stands"
        where = f"{'the farthest' if several else 'it'} is {row['glitch_at']:.6g} s after the beginning of trajectory"
        yield warning(
            f"{name} has a glitch",
            f"{count} far from the neighbours on both sides, as nowhere else; {where} {row['glitch_in']}. A single "
            "wrong sample can multiply the error of a model several times: repair it, or cut there. If that is an "
            "impulse that was given, all is well.",
        )
    if is_input:
        return
    if row["wraps"]:
        yield stop(
            f"{name} jumps by a full turn",
            f"{name} jumps by a full turn {row['wraps']} times: an angle that wraps round. "
            "No model can follow that; unwrap it first (numpy.unwrap, MATLAB's unwrap).",
        )
        return
    if row["noise"] > 0.02:
        yield warning(
            f"{name} is noisy",
            f"The noise on {name} is {100 * row['noise']:.2g} % of its range (what moves within four samples is "
            "counted as noise). Noise on the states biases the fit; a better sensor or slower sampling helps more "
            "than any model.",
        )
    if jumps:
        yield warning(
            f"{name} jumps",
            f"{name} changes by {100 * row['jump']:.0f} % of its range within one sample, but by less than "
            f"{100 * row['usual']:.2g} % in 99 of 100: an outlier, or a trial that begins without a column that says "
            "so.",
        )
    if row["shift"] > 1:
        yield warning(
            f"{name} drifts",
            f"The mean of {name} differs between the first and the second half by {row['shift']:.2g} standard "
            "deviations: it drifts, or the halves hold different motions. The test then asks for something that was "
            "not learnt.",
        )


def _excitation(identification):
    facts, correlation = identification.checks.facts, identification.checks.correlation
    train, test, n = identification.train, identification.test, identification.recording.n
    for name, share in facts["feedback"].items():
        if share > 0.9:
            yield warning(
                f"{name} follows the states",
                f"A linear function of the present states explains {100 * share:.3g} % of {name}: a feedback loop, or "
                "an input so slow that the states follow it. What the input does and what the states do by themselves "
                "can hardly be told apart; add a test signal to the input.",
            )
    for a, b in itertools.combinations(correlation, 2):
        if abs(correlation.loc[a, b]) > 0.8:
            yield warning(
                f"{a} and {b} move together",
                f"The correlation of {a} and {b} is {correlation.loc[a, b]:.2f}: their effects can hardly be told "
                "apart. Move them one by one, or by signals of their own.",
            )
    if facts["rank"] < facts["channels"] or facts["condition"] > 300:
        yield warning(
            "too little excitation",
            f"Constant, states and inputs (scaled) have a condition number of {facts['condition']:.3g}: some "
            "combination of channels hardly moves. The model says nothing reliable about it.",
        )
    if facts["order"] is not None and facts["order"] < min(n + 1, 20):
        yield warning(
            "too little excitation",
            f"The inputs are persistently exciting of order {facts['order']} (lags of "
            f"{facts['lag'] * facts['dt']:.3g} s), a linear model of {n} states asks for {n + 1}. Use a signal with "
            "more frequencies or more steps.",
        )
    functions = len(identification.model.names_)
    if train.pairs < 10 * functions:
        yield warning("a short recording", f"{train.pairs} snapshot pairs for {functions} functions: record longer.")
    if test.pairs < 200 or len(test) < 3:
        size = f"{len(test)} windows with {test.pairs} snapshot pairs"
        yield warning("a short test", f"The test has {size}: its numbers are rough.")


def _model(identification):
    table, model, recording = identification.eigenvalues, identification.model, identification.recording
    table = table[table["model"] == "model"]
    # One exactly belongs to the constant, and to functions of inputs alone.
    moving = table.loc[np.hypot(table["real"] - 1, table["imag"]) > 1e-6, "modulus"]
    fastest = moving.max() if len(moving) else 0.0
    duration = float((recording.lengths.max() - 1) * recording.dt)
    if fastest > 1 + recording.dt / duration and _runs_away(identification):
        doubling = recording.dt * math.log(2) / math.log(fastest)
        yield warning(
            "an unstable operator",
            f"The largest modulus of an eigenvalue is {fastest:.6f}: something in the lifted system doubles every "
            f"{doubling:.3g} s, and the free run over the test runs away. Trust predictions no longer than they were "
            "tested.",
        )
    if identification.remarks["treatment"] == "smoothed":
        level = noise_level(recording) / np.ptp(np.concatenate([x for x, _ in recording]), axis=0)
        yield note(
            "smoothed states",
            f"The states were smoothed before the fit (noise {100 * level.max():.2g} % of the range at most); test "
            "predictions start from states as measured.",
        )
    if (every := identification.remarks["every"]) > 1:
        yield note(
            "longer steps",
            f"A step of the model is {every} samples of the recording, {model.dt_:.4g} s: between samples the states "
            "move little, compared with their noise. simulate, the exports and a controller take one input per step; a "
            f"recording is made so by recording.decimated({every}{', lead=1' if model.lead else ''}). EVERY=1 asks for "
            "steps of one sample.",
        )
    if model.lead:
        yield note(
            "inputs of the same instant",
            "A state depends on the input recorded at the same instant (lead=1): simulate, the exports and a "
            "controller take the input at the END of a sample.",
        )
    if model.condition_number > 1e10:
        yield warning(
            "ill-conditioned",
            f"The condition number of the liftings is {model.condition_number:.2g}: coefficients mean little by "
            "themselves, predictions may still be good.",
        )


def _runs_away(identification):
    table = identification.metrics.set_index("prediction").loc[["model"]]
    return not np.isfinite(table["free"]).all()


def _reach(identification):
    for name, share in beyond(identification.train, identification.test).items():
        if share > 0.01:
            yield warning(
                f"{name} beyond the training data",
                f"{100 * share:.2g} % of the test's samples of {name} are outside the range of the training data, "
                "where the model is a guess.",
            )
