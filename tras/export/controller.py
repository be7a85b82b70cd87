"""A controller as C99 for the rig's computer: a header and a source that need only libm and allocate nothing.

The arithmetic is that of `tras.LQR`, `tras.MPC` and `tras.Observer`, in scaled channels; the quadratic programs are
solved by `tras.export.program`.
"""

import copy
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

import tras
from tras.control.lqr import LQR, ROUNDS
from tras.control.mpc import FIRST_ROUNDS, MPC
from tras.export import derivatives, estimator_c, lqr_c, mpc_c
from tras.export.c import HULL, array, lift
from tras.export.common import file_and_name, map_of
from tras.export.program import solver
from tras.workflow.arguments import in_code, whole_number
from tras.workflow.files import replacing

_HEADER = Template("""\
#ifndef ${guard}
#define ${guard}

/*
$vectors
 */
#define ${NAME}_MEASURED $measured
#define ${NAME}_FOLLOWED $followed
#define ${NAME}_INPUTS $inputs
#define ${NAME}_HORIZON $horizon

/* What ${name}_step returns. */
enum {
    ${NAME}_SOLVED,    /* u is the controller's. */
    ${NAME}_SHIFTED,   /* The program was not solved, so u is the next of the last plan, within the limits. */
    ${NAME}_NOT_FINITE /* x or reference holds NaN or infinity: u is the last one, and the step does not count. */
};

#ifdef __cplusplus
extern "C" {
#endif

/* Forget everything about the run so far; to be called first. There is one controller, with a state of its own. */
void ${name}_init(void);
/*
 The input to hold until the next sample. x is what is measured now; reference holds ``samples`` rows of
 ${NAME}_FOLLOWED numbers, from now on: 1 is a constant, more are a preview, whose last row is held beyond its end.
 */
int ${name}_step(const double *x, const double *reference, int samples, double *u);

#ifdef __cplusplus
}
#endif

#endif
""")
_STEP = Template("""\
void ${name}_init(void)
{
    is_first = 1;
    for (int j = 0; j < INPUTS; j++) last_u[j] = 0.0 < lowest[j] ? lowest[j] : 0.0 > highest[j] ? highest[j] : 0.0;
    start_inputs();
}

int ${name}_step(const double *x, const double *reference, int samples, double *u)
{
    static double wanted[(HORIZON + 1) * FOLLOWED];
    double z[STATES], of_inputs[INPUTS], of_states[STATES], scaled[INPUTS];
    int solved, rows = samples < HORIZON + 1 ? samples : HORIZON + 1, finite = rows > 0;
    for (int i = 0; i < MEASURED; i++) finite = finite && fabs(x[i]) < INFINITY;
    for (int i = 0; i < rows * FOLLOWED; i++) {
        int state = followed[i % FOLLOWED];
        finite = finite && fabs(reference[i]) < INFINITY;
        wanted[i] = (reference[i] - x_offset[state]) / x_scale[state];
    }
    for (int j = 0; j < INPUTS; j++) u[j] = last_u[j];
    if (!finite) return ${NAME}_NOT_FINITE;
    estimate(x, z, of_inputs, of_states);
    solved = inputs(z, of_inputs, of_states, wanted, rows, scaled);
    for (int j = 0; j < INPUTS; j++) {
        double unlimited = scaled[j] * u_scale[j] + u_offset[j];
        u[j] = last_u[j] = unlimited < lowest[j] ? lowest[j] : unlimited > highest[j] ? highest[j] : unlimited;
    }
    remember();
    is_first = 0;
    return solved ? ${NAME}_SOLVED : ${NAME}_SHIFTED;
}
""")


def controller_to_c(controller: Any, path: str | Path, *, iterations: int = 1000) -> list[Path]:
    """Write a controller as C99: ``path``, which ends in .c, and a header of the same name; returns both paths.

    ``void NAME_init(void)`` begins a run, ``int NAME_step(const double *x, const double *reference, int samples, double
    *u)`` computes the input for one sample, in physical units, and says whether the program was solved; NAME is the
    file's. Observer, limits, preview and the plan that is kept where a program is not solved are those of the
    controller, which is not changed and whose run so far does not matter.

    Parameters
    ----------
    controller : tras.LQR or tras.MPC
        Of a fitted `tras.KoopmanModel`.
    path
    iterations
        Of one quadratic program, at most: in place of a ``time_limit``, which C without an operating system lacks.

    Raises
    ------
    ValueError
        If it is no controller of a fitted model, the path does not end in .c, or the dictionary cannot be written as
        formulas.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> x, u = np.random.default_rng(0).uniform(-1, 1, (2, 5, 20, 1))
    >>> model = tras.KoopmanModel(tras.Monomials(2), "one_step").fit(tras.Recording(x, u, 0.1))
    >>> [file.name for file in controller_to_c(tras.LQR(model), f"{tempfile.mkdtemp()}/rig.c")]
    ['rig.h', 'rig.c']
    """
    whole_number("iterations", iterations)
    model = controller.predictor.model if isinstance(controller, (LQR, MPC)) else None
    if model is None:
        raise ValueError(
            f"controller is {controller!r}; give a tras.LQR or tras.MPC of a fitted tras.KoopmanModel, whose equations "
            "can be written in C."
        )
    path, name = file_and_name(path, ".c")
    parts = _Parts(controller, model, iterations)
    notes = [f" {line}" for line in _origin(controller, model, path, name)]
    source = f'#include "{path.stem}.h"\n\n#include <math.h>\n#include <stddef.h>\n\n{parts.source(name)}'
    files = {path.with_suffix(".h"): parts.header(name), path: source}
    for file, contents in files.items():
        with replacing(file) as temporary:
            temporary.write_text("\n".join(["/*", *notes, " */", contents]), encoding="utf-8", newline="\n")
    return list(files)


def _origin(controller, model, path, name):
    """Lines of text, safe in a comment."""
    c = controller.channels
    lines = [
        f"A {type(controller).__name__} of a Koopman model; written by tras {tras.__version__}.",
        f"predictor {model.predictor}, dictionary {model.dictionary_!r}, N = {len(model.names_)}",
        f"sampling time {c.dt!r} s, delays {c.delays}, horizon {controller.horizon} samples",
    ]
    if path.stem != name:
        lines.append(f"Functions are called {name}_..., because {path.stem!r} is no name in the language.")
    return [in_code(line) for line in lines]


class _Parts:
    """Sizes, constants and code of one controller."""

    def __init__(self, controller, model, iterations):
        self.controller, self.model, self.iterations = controller, model, iterations
        self.predicts = isinstance(controller, MPC)
        self.lifted = self.predicts and model.predictor == "lifted_linear"
        c = controller.channels
        self.measured = controller.observer.measured if controller.observer else c.state_names

    def header(self, name):
        c, controller = self.controller.channels, self.controller
        units = dict(zip((*c.state_names, *c.input_names), (*c.state_units, *c.input_units)))
        labels = [(f"x[{i}]", state) for i, state in enumerate(self.measured)]
        labels += [(f"reference[{i}]", state) for i, state in enumerate(controller.followed)]
        labels += [(f"u[{i}]", channel) for i, channel in enumerate(c.input_names)]
        texts = [in_code(f"{what}: {label} ({units[label]})" if units[label] else f"{what}: {label}")
                 for what, label in labels]  # fmt: skip
        vectors = "\n".join([" Vectors, in physical units:", *(f" {text}" for text in texts)])
        return _HEADER.substitute(
            name=name, NAME=name.upper(), guard=f"{name.upper()}_H", vectors=vectors, measured=len(self.measured),
            followed=len(controller.followed), inputs=len(c.input_names), horizon=controller.horizon,
        )  # fmt: skip

    def source(self, name):
        c, controller, model = self.controller.channels, self.controller, self.model
        n, m, count = len(c.state_names), len(c.input_names), len(c.z_scale)
        counts = {
            "STATES": count, "INPUTS": m, "CHANNELS": count + m, "FUNCTIONS": len(model.names_), "PRESENT": n,
            "DELAYS": c.delays, "MEASURED": len(self.measured),
            "FOLLOWED": len(controller.followed), "HORIZON": controller.horizon,
        }  # fmt: skip
        arrays = {"x_offset": c.z_offset, "x_scale": c.z_scale, "u_offset": c.u_offset, "u_scale": c.u_scale}
        arrays |= {"lowest": controller.limits[:, 0], "highest": controller.limits[:, 1]}
        arrays["followed"] = controller.rows.tolist()
        code = ""
        if not self.lifted or controller.observer:
            more_counts, more_arrays, code = _advance(model)
            counts, arrays = counts | more_counts, arrays | more_arrays
        if self.lifted:
            code += lift(model)
        for part in (self._estimate, self._plan if self.predicts else self._regulator):
            more_counts, more_arrays, more_code = part()
            counts, arrays, code = counts | more_counts, arrays | more_arrays, code + more_code
        constants = "enum {\n    " + ",\n    ".join(f"{key} = {value}" for key, value in counts.items()) + "\n};\n\n"
        constants += "".join(map(array, arrays, arrays.values())) + "\n"
        return constants + code + _STEP.substitute(name=name, NAME=name.upper())

    def _estimate(self):
        observer, c = self.controller.observer, self.controller.channels
        if observer is None:
            return {}, {}, estimator_c.STATE + estimator_c.WITHOUT_OBSERVER
        fresh = copy.copy(observer)
        fresh.begin(np.zeros(len(observer.measured)))
        count = len(c.z_scale)
        size = max(len(observer.Q), count + 1)  # C has no empty arrays, so at least one, which may do nothing

        def padded(values, *shape):
            result = np.zeros(shape)
            result[tuple(map(slice, values.shape))] = values
            return result

        arrays = {
            "measured": observer.rows.tolist(), "noise": np.diag(observer.R), "gusts": observer.gusts,
            "process": padded(np.diag(observer.Q), size), "first_variance": padded(np.diag(fresh.covariance), size),
            "on_inputs": padded(observer.on_inputs, len(c.u_scale), size - count),
            "on_states": padded(observer.on_states, count, size - count),
        }  # fmt: skip
        return {"ALL": size}, arrays, estimator_c.STATE + estimator_c.OBSERVER

    def _regulator(self):
        lqr = self.controller
        equations = len(lqr.channels.z_scale) + len(lqr.followed)
        size = max(equations, len(lqr.channels.z_scale) + len(lqr.channels.u_scale))
        code = f"#define SMALLEST {float(np.finfo(float).eps * size)!r}\n" + lqr_c.LQR
        return {"EQUATIONS": equations, "ROUNDS": ROUNDS}, {"gain": lqr.K}, code

    def _plan(self):
        mpc, c = self.controller, self.controller.channels
        m, blocks = len(c.input_names), mpc.blocks
        variables = int(blocks[-1] + 1) * m
        rate_limit = mpc.rates * c.dt / c.u_scale
        changed = np.flatnonzero(np.isfinite(np.tile(rate_limit, variables // m)))
        changes = len(changed)
        scaled = (mpc.state_limits - c.x_offset[:, None]) / c.x_scale[:, None]
        limited = np.flatnonzero(np.isfinite(scaled).any(axis=1))
        soft = mpc.horizon * len(limited)
        low, high = ((mpc.limits - c.u_offset[:, None]) / c.u_scale[:, None]).T
        counts = {"CHANGES": changes}
        arrays = {
            "block": blocks.tolist(), "error_weight": (mpc.weights * c.x_scale**2)[mpc.rows],
            "change_weight": mpc.rate_weights * c.u_scale**2, "u_low": low, "u_high": high,
        }  # fmt: skip
        if changes:
            arrays |= {"changed": changed.tolist(), "change_limit": rate_limit[changed % m]}
        if len(limited):
            counts["LIMITED"] = len(limited)
            arrays |= {"z_low": scaled[limited, 0], "z_high": scaled[limited, 1]}
        code = solver(
            variables, changes + soft, soft=soft, linear=mpc.program.linear, quadratic=mpc.program.quadratic,
            iterations=self.iterations,
        )  # fmt: skip
        words = {"changes": mpc_c.CHANGES, "limits": mpc_c.CHANGE_LIMITS} if changes else {"changes": "", "limits": ""}
        code += "\n" + Template(mpc_c.PROGRAM).substitute(words)
        if self.lifted:
            watched = [*mpc.rows.tolist(), *limited.tolist()]
            counts["WATCHED"] = len(watched)
            arrays |= {"watched": watched, "A": self.model.koopman_matrix.T, "B": self.model.B_}
            words = {"limits": mpc_c.LIFTED_LIMITS, "free": mpc_c.LIFTED_FREE} if soft else {"limits": "", "free": ""}
            return counts, arrays, code + Template(mpc_c.LIFTED).substitute(words)
        counts |= {"ITERATIONS": mpc.iterations, "FIRST": FIRST_ROUNDS}
        arrays |= {"limited": limited.tolist()} if soft else {}
        words = {"limits": mpc_c.STATE_LIMITS if soft else ""}
        return counts, arrays, code + Template(mpc_c.ALONG_PLAN).substitute(words)


def _advance(model):
    """Sizes, constants and code of the map over one sample with its slopes, in scaled channels."""
    if model.predictor == "lifted_linear":
        rows = model.dictionary_.coordinates
        arrays, hull = {"matrix": model.koopman_matrix.T[rows], "by_input": model.B_[rows]}, ""
    else:
        matrix, arrays = map_of(model)
        hull = HULL if arrays else ""
        arrays = {"matrix": matrix, **arrays}
    entries, code = derivatives.advance(model, hull)
    return {"ROWS": len(arrays["matrix"]), "SLOPES": len(entries["slope_of"])}, arrays | entries, code + "\n"
