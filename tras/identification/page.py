"""The report of an identification: one page of HTML that needs no network."""

import math
from urllib.parse import quote

import pandas as pd

from tras import summary
from tras.dictionaries.base import label
from tras.identification import advice, diagnosis
from tras.io.formats import remarks
from tras.workflow import page
from tras.workflow.arguments import one_line

_TERMS = 12  # of an equation on the page; a longer one is in formulas.txt
_ROWS = 40  # of a table on the page; the files have all


def write_page(identification, diagnosed, log, name, figures, exports, failures, formulas="") -> str:
    """The page as text.

    Parameters
    ----------
    identification : Identification
    diagnosed : Diagnosis
    log : Recording
        As read.
    name : str
        Of the recording.
    figures : dict of str to Path
        Figure -> its picture.
    exports : list of (str, str)
        Files of the folder, and what they are.
    failures : list of str
        One sentence for each export that could not be made.
    formulas : str
        The model as text; shown if it is short.
    """
    contents, parts, step_remarks = [], [], identification.remarks
    convert = page.converter(lambda kind, spec: "", contents)

    def put(heading, *html):
        parts.extend([convert(heading), *html])

    def text(sentence):
        return f"<p>{page.escape(sentence)}</p>\n"

    def picture(key, alt, caption):
        return page.figure(figures[key], alt, page.escape(caption), key) if key in figures else ""

    put(f"# Identification of {_plain(name)}")
    caption = (
        "A free run over the whole test: measured, and simulated from the first measured samples under the inputs "
        "alone. The legend has the fit: 100 % is perfect, 0 % no better than the mean. A triangle marks where a "
        "simulation leaves the frame."
    )
    run = picture("free_run", "Measured and simulated states over the whole test", caption)
    put("## In short", text(advice.verdict(identification)), run, _formulas(formulas), _chosen(identification))
    parts.append(identification.advice.html())
    sentences = _list(remarks(log)), _list(step_remarks["pairs"])
    channels = identification.recording.n + identification.recording.m
    more = f"Six of {channels} channels are shown." if channels > 6 else ""
    caption = f"The recording, trajectories one behind the other (grey lines where one begins). {more}"
    data = picture("data", "All channels over time", caption)
    put("## The recording", text(_size(identification)), *sentences, _channels(identification), data)
    caption = "Where in frequency the channels move, by Welch's method: share of variance per Hz. Means are taken away."
    spectra = picture("spectra", "Spectra of inputs and states", caption)
    put("### Excitation", text(_excitation(identification)), _correlation(identification), spectra)
    caption = _prediction_caption(identification)
    predictions = picture("predictions", "Measured and predicted states over two test windows", caption)
    caption = (
        "Root mean square error of all states over the test windows, each in percent of the state's range, against how "
        "far ahead is predicted."
    )
    growth = picture("growth", "Error against time ahead", caption)
    put("## How well it predicts", text(_test_text(identification)), _metrics(identification), predictions, growth)
    put("### What the errors still hold", *_residuals(diagnosed, picture))
    if diagnosed.responses:
        put("## Step and frequency response", *_responses(identification, diagnosed, picture))
    caption = (
        "Eigenvalues of the Koopman matrices and the unit circle; on the right the neighbourhood of one. One exactly "
        "belongs to the constant and to functions of inputs alone, which are held over a sample."
    )
    description = f"<pre>{page.escape(summary.describe(identification.model))}</pre>\n"
    spectrum = picture("spectrum", "Eigenvalues with the unit circle", caption)
    put("## The operator", description, spectrum)
    put("## Files", _files(exports), _list(failures), _use(identification))
    sentences = _list([*step_remarks["partition"], *step_remarks["search"], *step_remarks["choice"]])
    put("## How the model was chosen", text(_search_text(identification)), sentences, _candidates(identification))
    return page.frame(f"Identification of {name}", "".join(parts), contents)


def _plain(name):
    """A file's name on one line, escaped for Markdown."""
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]<>()#+-.!|$" else letter for letter in one_line(name))


def _chosen(identification):
    model = identification.model
    words, code = model.dictionary.words(model.state_names_), label(model.dictionary)
    delays = f", {model.delays} delay{'s' if model.delays != 1 else ''}" if model.delays else ""
    states = {"smoothed": "smoothed states", "as measured": "states as measured"}[identification.remarks["treatment"]]
    dictionary = f"{page.escape(words)} (<code>{page.escape(code)}</code>, {len(model.names_)} functions)"
    return (
        f"<p>The model: {dictionary}{delays}, predictor <code>{page.escape(model.predictor)}</code>. "
        f"What is tested was fitted to {model.pairs_} snapshot pairs of {states}, without the test; the files have the "
        f"same model fitted to all {identification.delivered.pairs_}.</p>\n"
    )


def summary_html(identification) -> str:
    """The verdict, what to mind and the test, for a notebook."""
    verdict = f"<p>{page.escape(advice.verdict(identification))}</p>\n"
    return verdict + _chosen(identification) + identification.advice.html() + _metrics(identification)


def _size(identification):
    facts = identification.checks.facts
    lengths = " to ".join(map(str, dict.fromkeys((facts["shortest"], facts["longest"]))))
    trajectories = "1 trajectory" if facts["trajectories"] == 1 else f"{facts['trajectories']} trajectories"
    amount = f"{facts['samples']} samples, {facts['pairs']} snapshot pairs, {facts['seconds']:.4g} s in all"
    return f"{trajectories} of {lengths} samples at {facts['dt']:.6g} s: {amount}."


def _channels(identification):
    rows, numbers = [], ["lowest", "highest", "mean", "deviation"]
    for _, row in identification.checks.channels.iterrows():
        limit = 100 * max(row["at_lowest"], row["at_highest"])
        step = f"{row['step']:.3g}" if row["step"] else "–"
        noise = _number(100 * row["noise"], ".2g")
        words, values = [row["channel"], row["role"], row["unit"] or "–"], [f"{row[key]:.4g}" for key in numbers]
        rows.append([page.escape(cell) for cell in (*words, *values, step, f"{limit:.2g}", noise)])
    head = ["channel", "role", "unit", *numbers, "step", "at a limit (%)", "noise (% of range)"]
    caption = (
        "Channels: deviation is the standard deviation, step the usual distance between neighbouring values "
        "if they are few, noise what moves within four samples."
    )
    return page.table(head, rows, caption)


def _excitation(identification):
    facts = identification.checks.facts
    rank, condition = f"rank {facts['rank']} of {facts['channels']}", f"condition number {facts['condition']:.3g}"
    sentences = [f"Constant, states and inputs, each scaled to its range: {rank}, {condition}."]
    if facts["order"] is not None:
        order, lag = f"{facts['order']}{' or more' if facts['order'] == 20 else ''}", facts["lag"] * facts["dt"]
        sentences.append(f"The inputs are persistently exciting of order {order}, lags of {lag:.3g} s.")
    if facts["feedback"]:
        shares = ", ".join(f"{100 * share:.3g} % of {name}" for name, share in facts["feedback"].items())
        sentences.append(f"A linear function of the present states explains {shares} (nearly all would mean feedback).")
    return " ".join(sentences)


def _correlation(identification):
    table = identification.checks.correlation
    if len(table) < 2:
        return ""
    rows = [[page.escape(name), *(f"{value:.2f}" for value in row)] for name, row in zip(table.index, table.to_numpy())]
    return page.table(["", *map(page.escape, table.columns)], rows, "Correlation between inputs.")


def _search_text(identification):
    return (
        f"{len(identification.search)} candidates in three rounds: treatments of noise and numbers of delays first, "
        "with a linear and a nonlinear dictionary; then every dictionary at the best of these, and without delays; "
        "then the best ones fitted to predictions over a window (a horizon above 1), where that is better. The "
        "error is that of whole roll-outs of pieces that were held out from the candidate, against what was measured; "
        "each candidate also chooses its strength of regularization. Errors within 10 % of the least count as equal, "
        "and then the candidate with fewest functions is taken."
    )


def _candidates(identification):
    rows, count = [], len(identification.search)
    for _, row in identification.search.sort_values("error", kind="stable").head(_ROWS).iterrows():
        mark = page.escape(one_line(row["failure"])[:160]) if row["failure"] else ""
        if row["chosen"]:
            mark = "<strong>chosen</strong>"
        words = row["model"].dictionary.words(identification.recording.state_names)
        names = ("predictor", "delays", "lead", "horizon", "states")
        options = [page.escape(each) for each in (words, *(row[name] for name in names))]
        numbers = [
            _number(row[name], digits) for name, digits in (("functions", ".0f"), ("strength", "g"), ("error", ".4g"))
        ]
        numbers += [_number(row[name], digits) for name, digits in (("AIC", ".0f"), ("BIC", ".0f"), ("FPE", ".3g"))]
        rows.append([*options, *numbers, mark])
    more = f" The best {_ROWS} of {count}; all are in tables/search.csv." if count > _ROWS else ""
    head = ["dictionary", "predictor", "delays", "lead", "horizon", "states", "functions", "strength"]
    head += ["error (half-ranges)", "AIC", "BIC", "FPE", ""]
    criteria = (
        " AIC, BIC and FPE are of one-step predictions of what was fitted, as measured: the smaller, the better. They "
        "know nothing of predictions further ahead, and do not choose."
    )
    return page.table(head, rows, f"Candidates, the least error first.{more}{criteria}", kind="short")


def _test_text(identification):
    windows, longest = len(identification.test), int(identification.test.lengths.max())
    return (
        f"{windows} windows of up to {longest} samples that nothing was chosen or fitted by; every prediction starts "
        "from the first samples of its window and sees the inputs only. NRMSE is the root mean square error over the "
        "range of the truth, BFR the best fit ratio (100 is perfect, 0 no better than the mean), Enr the norm of the "
        "error over that of the truth."
    )


def _metrics(identification):
    rows, metrics = [], identification.metrics
    table = pd.concat([metrics[metrics["state"] == state] for state in identification.test.state_names])
    for _, row in table.iterrows():
        formats = {"one_step": ".3g", "nrmse": ".3g", "bfr": ".4g", "enr": ".3g", "free": ".3g", "free_bfr": ".4g"}
        numbers = [_number(row[name], digits) for name, digits in formats.items()]
        names = [page.escape(row["state"]), page.escape(row["prediction"])]
        rows.append([*names, *numbers, f"{row['diverged']} of {row['windows']}"])
    head = [
        "state",
        "prediction",
        "one-step NRMSE (%)",
        "NRMSE (%)",
        "BFR (%)",
        "Enr",
        "free run: NRMSE (%)",
        "BFR (%)",
        "diverged",
    ]
    return page.table(head, rows, "Test.", keys=2)


def _prediction_caption(identification):
    why = identification.remarks["band"].removesuffix(".")
    band, members = f"There is no band: {why}.", len(identification.ensemble)
    if members:
        uncertain = "what is uncertain because the data are few or noisy, not what the dictionary cannot say"
        band = f"The band holds 90 % of {members} models fitted to resampled trajectories: {uncertain}."
    more = " Six states are shown, all are in tables/predictions.csv." if identification.recording.n > 6 else ""
    return f"Two test windows: the one with the median error, and the worst. {band}{more}"


def _number(value, digits):
    return format(value, digits) if math.isfinite(value) else "–"


def _residuals(diagnosed, picture):
    """Tests of the residuals over one sample and over several: sentences and figures."""
    parts = [
        "<p>What a model misses shows in its residuals, measured less predicted: of a good model they are correlated "
        "neither with their own past nor with that of an input.</p>\n"
    ]
    for key, tests in diagnosed.tests.items():
        if isinstance(tests, str):
            parts.append(f"<p>{page.escape(tests)}</p>\n")
            continue
        parts.append(f"<p>{page.escape(f'{tests.verdict} {diagnosis.strongest(tests)}'.strip())}</p>\n")
        reach = "one sample" if tests.steps == 1 else f"{tests.steps} samples"
        caption = (
            f"Correlation of the residuals of predictions over {reach}, and the bounds that a single lag of a right "
            "model leaves in one case of a hundred. The tests above weigh all lags together: where an input is slow, "
            "neighbouring lags say the same."
        )
        parts.append(picture(key, f"Correlations of residuals over {reach} with their bounds", caption))
    return parts


def _responses(identification, diagnosed, picture):
    """The linear model about a point beside the recording's own response: sentences and figures."""
    band = "There is no band, for the reason above."
    if identification.ensemble:
        band = f"The band holds 90 % of {len(identification.ensemble)} models fitted to resampled trajectories."
    pairs = identification.pairs
    more = "" if not pairs else " Velocities are left out, but are in the figures' tables."
    step = f"Response to a step of one unit of each input, of the linearised model. {band}{more}"
    parts = [_list(diagnosed.responses.remarks), picture("step", "Step responses of the linearised model", step)]
    for key in ("bode", "bode_2"):
        caption = (
            "Bode plot of the linearised model (line) beside the recording's own response (dots). Hollow dots are not "
            "to be trusted: the input has too little power there, or the response is uncertain by more than 30 %. "
            f"Coherence is the share of a state's power that is linear in the inputs. {band}"
        )
        parts.append(picture(key, "Bode plot with the recording's own response", caption))
    code = (
        "model.linearize(x, u)  # A, B, C, D about a point, for python-control\nmodel.residuals(log, steps=10).plot()"
    )
    return [*parts, f"<pre>{page.escape(code)}</pre>\n"]


def _formulas(formulas):
    """The equations of up to twelve terms; what the file says beside them stays there."""
    comments = [line[2:] for line in formulas.splitlines() if line.startswith("# ")]
    equations = [line for line in formulas.splitlines() if line and not line.startswith("#")]
    file = '<a href="export/formulas.txt">formulas.txt</a>'
    if not equations:
        return ""
    terms = [1 + line.count(" + ") + line.count(" - ") for line in equations]
    short = [line for line, count in zip(equations, terms) if count <= _TERMS and len(line) <= 400]
    if not short or len(equations) > _TERMS:
        return f"<p>The equations are long ({sum(terms)} terms): see {file}.</p>\n"
    what = comments[0].partition(", by tras")[0].partition(" by tras")[0]
    heading = f"<p>{page.escape(what)}, without terms that change a row by less than 1 % ({file} has the details):</p>"
    rest = [
        f"{line.partition(' = ')[0]} = ...  # {count} terms"
        for line, count in zip(equations, terms)
        if line not in short
    ]
    names = [f"# {line}" for line in comments if line.startswith("Names: ") and len(line) <= 200]
    text = "\n".join([*names, *short, *rest])
    return f"{heading}\n<pre>{page.escape(text)}</pre>\n"


def _files(exports):
    rows = [
        [f'<a href="{page.escape(quote(name))}"><code>{page.escape(name)}</code></a>', page.escape(what)]
        for name, what in exports
    ]
    return page.table(["file", "what it is"], rows, "Beside this page.", kind="short")


def _use(identification):
    model, names = identification.model, ", ".join(identification.recording.state_names)
    first = f"log.states[0][: {model.delays + 1}]" if model.delays else "log.states[0][0]"
    imports, inputs = "import tras", "log.inputs[0]"
    if not identification.recording.m:
        imports, inputs = "import numpy\nimport tras", "numpy.empty((500, 0))"
    code = f'{imports}\n\nmodel = tras.load_model("model.npz")\nstates = model.simulate({first}, {inputs})'
    return f"<pre>{page.escape(code)}  # log: a tras.Recording of {page.escape(names)}</pre>\n"


def _list(sentences):
    whole = [f"{sentence[:1].upper()}{sentence[1:].removesuffix('.')}." for sentence in sentences]
    items = "".join(f"<li>{page.escape(sentence)}</li>\n" for sentence in whole)
    return f"<ul>\n{items}</ul>\n" if items else ""
