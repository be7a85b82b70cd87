"""The real rig, from its public recording: `make identify` beside other models, blocked five-fold over its 120 s.

    .venv/bin/python benchmarks/real_rig.py TRAS_2dof_exper.mat [--folds 0,1,2,3,4] [--every 20] [--publish]

The user has the file (docs/real_rig.md says from where); nothing of it is kept here. Each fifth of the recording in
turn is the test and all models are fitted to the other four. They predict windows of 3.2 s that begin every 0.8 s, the
first one 3.2 s after the fifth begins, from what was measured in that fifth up to then. Prints the root mean square
errors of both angles; ``--publish`` writes them to ``results/real_rig.csv`` and into the page.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from sklearn.base import clone

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import tras  # noqa: E402
from tras.dictionaries.base import label  # noqa: E402
from tras.solver.threads import one_blas_thread  # noqa: E402
from tras.twin_rotor.rotor_parameters import RotorParameters  # noqa: E402
from tras.twin_rotor.rotors import equations_of_motion  # noqa: E402

PAGE, TABLE = ROOT / "docs" / "real_rig.md", ROOT / "benchmarks" / "results" / "real_rig.csv"
ROLES = {
    "time": "time",
    "states": [
        "rt_AngleReference1.signals1_2",
        "Pitch Angle & Reference2",
        "rt_RPM.signals1_1",
        "rt_RPM.signals1_2",
    ],
    "inputs": ["Azimuth Control", "Pitch Control"],
}
NAMES = {"state_names": ["yaw", "pitch", "tail_rpm", "main_rpm"], "input_names": ["tail", "main"]}
NAMES |= {"state_units": ["rad", "rad", "rpm", "rpm"], "input_units": ["", ""]}
FOLDS, WINDOW, BETWEEN = 5, 320, 80  # samples of 0.01 s
COARSE = 5  # samples of an integration step of the grey box
RECENT = 40  # samples from which it takes angles and rates at the start
ORDERS = (1, 2, 4, 8, 16, 32)
PERSISTENCE, MAKER, REFITTED = "stays where it is", "maker's model", "refitted grey box"
ARX, LINEAR, IDENTIFY, LONGER = "ARX", "linear model of identify", "identify", "identify, DELAYS=8"
METHODS = (PERSISTENCE, MAKER, REFITTED, ARX, LINEAR, IDENTIFY, LONGER)
DELAYS = 8  # of the last: half the window at steps of 0.2 s


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--folds", default="0,1,2,3,4", help="numbers of fifths, separated by commas")
    parser.add_argument("--every", type=int, default=20, help="samples of a step of identify, 0 to let it choose")
    parser.add_argument("--publish", action="store_true", help="write results/real_rig.csv and the page's table")
    options = parser.parse_args(arguments)
    log = tras.Recording.read(options.recording, ROLES)
    log = log.with_data(list(log.states), list(log.inputs), **NAMES)
    rows = []
    for fold in map(int, options.folds.split(",")):
        with one_blas_thread():
            rows += one_fold(log, fold, options.every or None)
        print(pd.DataFrame(rows).query("fold == @fold + 1").to_string(index=False), flush=True)
    table = pd.DataFrame(rows)
    if options.publish:
        table.to_csv(TABLE, index=False, float_format="%.4g")
        publish(table, bounds(log))


def one_fold(log, fold, every):
    """Rows of the table: fold, method, yaw, pitch (root mean squares in rad), model (in words), seconds (to make it).

    ``every`` is the length of the step of `tras.identify` in samples, None if it is to choose.
    """
    x, u = log.states[0], log.inputs[0]
    first, last = np.linspace(0, len(x), FOLDS + 1).astype(int)[[fold, fold + 1]]
    parts = [(x[:first], u[:first]), (x[last:], u[last:])]
    train = log.with_data(*map(list, zip(*[part for part in parts if len(part[0])])))
    test, starts = log.with_data([x[first:last]], [u[first:last]]), np.arange(WINDOW, last - first - WINDOW, BETWEEN)
    rows = []

    def add(method, predict, words, begun):
        miss = np.stack([predict(start) - test.states[0][start : start + WINDOW + 1, :2] for start in starts])[:, 1:]
        yaw, pitch = np.sqrt(np.mean(miss**2, axis=(0, 1)))
        seconds = time.process_time() - begun
        row = {"fold": fold + 1, "method": method, "yaw": yaw, "pitch": pitch, "model": words, "seconds": seconds}
        rows.append(row)

    add(PERSISTENCE, lambda k: np.tile(test.states[0][k, :2], (WINDOW + 1, 1)), "", time.process_time())
    begun, rig = time.process_time(), makers_rig()
    add(MAKER, lambda k: grey_box(rig, test, [k])[:, :, 0], "", begun)
    begun = time.process_time()
    refitted = refit(train)
    add(REFITTED, lambda k: grey_box(refitted, test, [k])[:, :, 0], "", begun)
    begun = time.process_time()
    arx = best_arx(train)
    add(ARX, lambda k: roll_out(arx, test, k), f"{arx.delays + 1} samples, lead {arx.lead}", begun)
    for method, delays in ((IDENTIFY, None), (LONGER, [DELAYS])):
        begun = time.process_time()
        identification = tras.identify(train, horizon=WINDOW * log.dt, every=every, delays=delays, draws=0)
        models = {method: identification.delivered}
        if method == IDENTIFY:  # like the delivered one, the linear one is fitted to all that is no test here
            linear = identification.linear
            linear = clone(linear).set_params(strength=float(linear.strength_)).fit(stepped(train, linear))
            models[LINEAR] = linear
        for name, model in models.items():
            words = f"{label(model)}, {model.predictor}, lead {model.lead}, step {model.dt_:.2g} s"
            add(name, lambda k, model=model: roll_out(model, test, k), words, begun)
    return rows


def stepped(recording, model):
    """The recording at the model's own step."""
    every = round(model.dt_ / recording.dt)
    return recording.decimated(every, model.lead) if every > 1 else recording


def roll_out(model, test, start):
    """Angles (WINDOW + 1, 2) predicted from the samples up to ``start``; between the model's steps a straight line."""
    every = round(model.dt_ / test.dt)
    past, steps = model.delays * every, -(-WINDOW // every) * every
    x, u = test.states[0], test.inputs[0]
    window = slice(start - past, start + steps + 1)
    piece = stepped(test.with_data([x[window]], [u[window]]), model)
    angles = np.asarray(model.predict(piece)[0])[model.delays :, :2]
    times, own = np.arange(WINDOW + 1), np.arange(len(angles)) * every
    return np.stack([np.interp(times, own, angle) for angle in angles.T], axis=1)


def best_arx(train):
    """Linear in so many samples of all states and inputs, by least squares; order and timing by windows held out."""
    held = [x[int(0.8 * len(x)) :] for x, _ in train], [u[int(0.8 * len(x)) :] for x, u in train]
    rest = [x[: int(0.8 * len(x))] for x, _ in train], [u[: int(0.8 * len(x))] for x, u in train]
    rest, held = train.with_data(*rest), train.with_data(*held)
    errors = {}
    for order in ORDERS:
        for lead in (0, 1):
            model = tras.KoopmanModel(
                tras.Monomials(1), "one_step", order - 1, strength=0.0, columns="states", lead=lead
            )
            fitted, miss = clone(model).fit(rest), []
            for x, u in held:
                piece = held.with_data([x], [u])
                for start in range(max(ORDERS), len(x) - WINDOW, BETWEEN):
                    miss.append((roll_out(fitted, piece, start) - x[start : start + WINDOW + 1, :2]) / np.ptp(x[:, :2]))
            errors[order, lead] = (np.nan_to_num(np.mean(np.square(miss)), nan=np.inf), model)
    return clone(min(errors.values(), key=lambda entry: entry[0])[1]).fit(train)


# --- the grey box -----------------------------------------------------------------------------------------------------

RPM = np.pi / 30  # rad/s
# Factors of the maker's parameters, then what is added to both thrusts, in N m.
FACTORS = ("thrust_m", "thrust_t", "hold_m", "hold_t", "I_m", "I_t", "reaction_phi", "reaction_psi")
FACTORS_OF_BODY = ("G_c", "G_s", "C_phi", "C_psi", "K_psi")


def grey_box(rig, recording, starts):
    """Angles (WINDOW + 1, 2, starts) of the six-state plant, from angles and rates of a parabola through the past."""
    x, u = recording.states[0], recording.inputs[0]
    starts = np.asarray(starts)
    ago = np.arange(-RECENT + 1, 1) * recording.dt
    parabola = np.linalg.pinv(np.vander(ago, 3, increasing=True))[:2]
    past = x[starts[:, None] + np.arange(-RECENT + 1, 1)]
    (yaw, pitch), (psidot, phidot) = np.einsum("ij,sjc->ics", parabola, past[:, :, :2])
    tail, main = past[:, -COARSE:, 2:].mean(axis=1).T * RPM
    state, rates = np.stack([pitch, phidot, yaw, psidot, main, tail]), equations_of_motion(rig, np)

    def field(z, commands):
        phi_accelerates, psi_accelerates, main_rate, tail_rate = rates(*z, *commands)
        return np.stack([z[1], phi_accelerates, z[3], psi_accelerates, main_rate, tail_rate])

    angles, h = [np.stack([x[starts, 0], x[starts, 1]])], COARSE * recording.dt
    for k in range(0, WINDOW, COARSE):
        tail, main = u[starts[:, None] + np.arange(k, k + COARSE)].mean(axis=1).T
        commands = main, tail
        k1 = field(state, commands)
        k2 = field(state + h / 2 * k1, commands)
        k3 = field(state + h / 2 * k2, commands)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + field(state + h * k3, commands))
        angles.append(np.stack([state[2], state[0]]))
    own, times = np.arange(0, WINDOW + 1, COARSE), np.arange(WINDOW + 1)
    angles = np.stack(angles)
    fine = [np.interp(times, own, curve) for curve in angles.reshape(len(own), -1).T]
    return np.stack(fine, axis=1).reshape(WINDOW + 1, 2, len(starts))


def makers_rig():
    """The maker's set; but on the rig a main command turns yaw the other way than in the public model."""
    rig = RotorParameters.maker()
    return replace(rig, reaction_psi=-rig.reaction_psi)


def with_factors(theta):
    """The maker's set with factors and thrusts' offsets (15,)."""
    rig, theta = makers_rig(), list(theta)
    values = {}
    for name in FACTORS:
        value, factor = getattr(rig, name), theta.pop(0)
        values[name] = value.times(factor) if hasattr(value, "times") else value * factor
    body = replace(rig.body, **{name: getattr(rig.body, name) * theta.pop(0) for name in FACTORS_OF_BODY})
    for name, offset in zip(("thrust_m", "thrust_t"), theta):
        constant, *others = values[name].polynomial
        values[name] = replace(values[name], polynomial=(constant + offset, *others))
    return replace(rig, body=body, **values)


def refit(train):
    """The maker's set with the factors that predict windows of the training data best: least squares, Huber's loss."""
    theta = np.array([1.0] * (len(FACTORS) + len(FACTORS_OF_BODY)) + [0.0, 0.0])
    windows = []
    for x, u in train:
        starts = np.arange(RECENT, len(x) - WINDOW, 2 * BETWEEN)
        truth = np.stack([x[k : k + WINDOW + 1, :2] for k in starts], axis=2)[::COARSE]
        windows.append((train.with_data([x], [u]), starts, truth))

    def misses(theta):
        rig = with_factors(theta)
        with np.errstate(over="ignore", invalid="ignore"):
            parts = [grey_box(rig, part, starts)[::COARSE] - truth for part, starts, truth in windows]
        scaled = [part / np.array([0.03, 0.01])[:, None] for part in parts]
        return np.concatenate([np.clip(np.nan_to_num(part, nan=1e2), -1e2, 1e2).ravel() for part in scaled])

    low = np.array([0.1] * (len(theta) - 2) + [-0.1, -0.1])
    high = np.array([10.0] * (len(theta) - 2) + [0.1, 0.1])
    scale = np.array([1.0] * (len(theta) - 2) + [0.01, 0.01])
    fit = least_squares(misses, theta, bounds=(low, high), x_scale=scale, loss="huber", max_nfev=12)
    return with_factors(fit.x)


# --- the page ---------------------------------------------------------------------------------------------------------


def publish(table, signals):
    """The tables between their marks in the page."""
    text = PAGE.read_text(encoding="utf-8")
    for name, lines in (("rig", tables(table)), ("bounds", signals)):
        begin, end = f"<!-- {name}: written by `benchmarks/real_rig.py` -->", f"<!-- end of {name} -->"
        before, after = text[: text.index(begin) + len(begin)], text[text.index(end) :]
        text = f"{before}\n\n{lines}\n\n{after}"
    PAGE.write_text(text, encoding="utf-8")


def bounds(log):
    """How much there is to learn from, per fold, and how fine it is: a table and a sentence."""
    x, u = log.states[0], log.inputs[0]
    edges, low, high = np.linspace(0, len(x), FOLDS + 1).astype(int), u.min(axis=0), u.max(axis=0)
    columns = "fold", "range of yaw, rad", "range of pitch, rad", "deviation of pitch, rad", "jumps", "at a limit"
    lines = [f"| {' | '.join(columns)} |", "| --- " * len(columns) + "|"]
    for fold, (a, b) in enumerate(zip(edges[:-1], edges[1:]), 1):
        yaw, pitch, commands = x[a:b, 0], x[a:b, 1], u[a:b]
        jumps = np.mean(np.abs(np.diff(commands, axis=0)) > (high - low) / 4)
        limits = np.mean((commands == low) | (commands == high))
        cells = [f"{np.ptp(yaw):.2f}", f"{np.ptp(pitch):.3f}", f"{pitch.std():.4f}"]
        cells += [f"{100 * jumps:.0f} %", f"{100 * limits:.0f} %"]
        lines.append(f"| {fold} | {' | '.join(cells)} |")
    steps = [np.diff(np.unique(angle.round(9))) for angle in x[:, :2].T]
    yaw, pitch = (np.median(step[step > 1e-6]) for step in steps)
    rates = np.abs(np.diff(x[:, :2], axis=0)).mean(axis=0)
    words = [
        f"The encoders' steps are {yaw:.5f} rad (yaw) and {pitch:.5f} rad (pitch).",
        f"From sample to sample the angles move by {rates[0]:.5f} and {rates[1]:.5f} rad on average.",
        "Jumps are the samples in which a command changes by a quarter of its range or more.",
    ]
    return "\n".join([*lines, "", " ".join(words)])


def tables(table):
    lines = ["| yaw / pitch, rad | " + " | ".join(f"fold {k}" for k in sorted(set(table["fold"]))) + " | all |"]
    lines.append("| --- " * (lines[0].count("|") - 1) + "|")
    for method in METHODS:
        rows = table[table["method"] == method].sort_values("fold")
        cells = [f"{row.yaw:.3f} / {row.pitch:.4f}" for row in rows.itertuples()]
        yaw, pitch = np.sqrt(np.mean(rows[["yaw", "pitch"]] ** 2, axis=0))
        lines.append(f"| {method} | " + " | ".join([*cells, f"{yaw:.3f} / {pitch:.4f}"]) + " |")
    lines += ["", "| fold | what `identify` chose | processor time |", "| --- | --- | --- |"]
    for row in table[table["method"] == IDENTIFY].sort_values("fold").itertuples():
        lines.append(f"| {row.fold} | {row.model} | {row.seconds:.0f} s |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
