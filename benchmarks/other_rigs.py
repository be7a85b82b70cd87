"""A controller of one rig on many others: every parameter drawn within 20 %, the model that of the nominal rig.

.venv/bin/python benchmarks/other_rigs.py [--rigs 1000] [--seconds 4] [--processes 2]

Rigs, reference (fast multisines with preview) and controller are those of `notebooks/11_control.ipynb`, which flies 40.
The controller is its C (`tras.export.controller_to_c`), which is that in Python to 1e-9 and takes a seventh of the
time. Printed are how many rigs diverge (an error beyond 3 rad), and the root mean square errors in rad after 1 s.
"""

import argparse
import ctypes
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np  # noqa: E402

import tras  # noqa: E402
from tras.paper import control  # noqa: E402
from tras.workflow.study import each  # noqa: E402


class Compiled:
    """A controller's C as a controller of `tras.simulate_closed_loop`."""

    def __init__(self, path, horizon):
        self.library, self.horizon, self.kept = ctypes.CDLL(str(path)), horizon, 0

    def reset(self):
        self.library.rig_init()
        self.kept = 0

    def __call__(self, x, reference):
        x, reference, u = np.ascontiguousarray(x), np.ascontiguousarray(np.atleast_2d(reference)), np.empty(2)
        of_x, of_reference, of_u = (array.ctypes.data_as(ctypes.c_void_p) for array in (x, reference, u))
        self.kept += self.library.rig_step(of_x, of_reference, len(reference), of_u)
        return u


def fly(study, reference, path, number):
    """Errors (pitch, yaw) of one rig, its largest one, and how many plans were kept."""
    rig = control.a_rig(study, {"condition": "rig", "level": study.change, "changed": str(number)})
    flown = Compiled(path, study.horizon)
    try:
        log = tras.simulate_closed_loop(reference, study.sampling_time, rig, controllers=flown, preview=True)
    except ValueError:  # the plant's own words where its state has run away
        return np.nan, np.nan, np.inf, flown.kept
    errors = (log.states[0][:, [0, 2]] - reference)[: -study.horizon]
    rms = np.sqrt((errors[study.samples(study.skip) - 1 :] ** 2).mean(axis=0))
    return *rms, np.abs(errors).max(), flown.kept


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise SystemExit("no C compiler (cc, gcc, clang) is installed.")
    study = control.Study(rig_duration=options.seconds)
    excitation = tras.multisine(500, study.sampling_time, [0.2, 0.8], [1.22173, np.pi], 1)
    log = tras.simulate_closed_loop(excitation, study.sampling_time).select(inputs=["u_phi", "u_psi"])
    models = {"mechanical": tras.KoopmanModel(tras.Mechanical()).fit(log.cut(501))}
    reference = control.references(study, excitation)["fast"][: study.samples(options.seconds) + study.horizon]
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "rig.c"
        tras.export.controller_to_c(control.controller(study, models, control.OURS), source)
        library = source.with_suffix(".so")
        command = [compiler, "-std=c99", "-O2", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
        subprocess.run(command, check=True)
        start = time.perf_counter()
        jobs = [(number,) for number in range(options.rigs)]
        pitch, yaw, largest, kept = np.transpose(
            each(fly, jobs, (study, reference, library), processes=options.processes)
        )
    lost = ~(largest <= control.RUNAWAY)
    print(f"{options.rigs} rigs, every parameter within {study.change:g} %, {options.seconds:g} s each")
    print(f"diverged: {lost.sum()}; plans kept: {kept.sum():.0f} of {options.rigs * len(reference)} steps")
    for name, errors in (("yaw", yaw), ("pitch", pitch)):
        errors = errors[~lost]
        print(
            f"{name:6} median {np.median(errors):.2g}  99 % {np.quantile(errors, 0.99):.2g}  worst {errors.max():.2g}"
        )
    print(f"{time.perf_counter() - start:.0f} s by the clock, {options.processes} processes")


if __name__ == "__main__":
    main()
