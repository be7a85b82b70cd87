"""A step of model predictive control in Python and in C: the paper's plant, N = 81, horizon 40; CPU time of one core.

.venv/bin/python benchmarks/controllers.py [--samples 1000] [--flags=-O2]

Each case is a run on the plant of fast multisines with preview and 1e-3 rad of noise; both controllers get the same
measurements, one after the other. Times are CPU time of the process: what else the machine does is not in them.
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

LIMITS = {"u_phi": (-0.144, 0.207), "u_psi": (-0.241, 0.14)}
CASES = {
    "torque limits": {},
    "tight torque limits": {"limits": {"u_phi": (-0.02, 0.1), "u_psi": (-0.05, 0.05)}},
    "limits of torque and its rate": {"rates": 0.5},
    "torque limits, soft limits of yaw and pitch rate": {"states": {"psi": (-0.3, 0.3), "phidot": (-0.5, 0.5)}},
}


def compiled(controller, folder, flags):
    files = tras.export.controller_to_c(controller, folder / "rig.c")
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise SystemExit("no C compiler (cc, gcc, clang) is installed.")
    command = [compiler, "-std=c99", *flags, "-shared", "-fPIC", str(files[1]), "-o", str(folder / "rig.so"), "-lm"]
    subprocess.run(command, check=True)
    library = ctypes.CDLL(str(folder / "rig.so"))
    library.rig_init()
    return library


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


def seconds(controller, library, samples):
    """CPU seconds of each step in Python and in C (2, samples), and the largest difference in half-ranges."""
    plant, rng = tras.PlantParameters(), np.random.default_rng(0)
    reference = tras.multisine(max(10.0, samples * 0.01 + 1), 0.01, [3.0, 2.0], [0.5, 1.0], 3)
    x, times, error = np.array([0.1, 0.0, 0.0, 0.0]), np.empty((2, samples)), 0.0
    for k in range(samples):
        y, ahead = x + 1e-3 * rng.normal(size=4), np.ascontiguousarray(reference[k : k + controller.horizon + 1])
        start = time.thread_time()
        u = controller(y, ahead)
        between = time.thread_time()
        times[0, k], in_c = between - start, np.empty(2)
        arguments = pointer(y), pointer(ahead), len(ahead), pointer(in_c)
        start = time.thread_time()
        library.rig_step(*arguments)
        times[1, k] = time.thread_time() - start
        error = max(error, np.abs((u - in_c) / controller.channels.u_scale).max())
        x = tras.simulate_plant(x, np.tile(u, (2, 1)), 0.01, plant)[-1]
    return times, error


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--flags", default="-O2", help="for the C compiler")
    options = parser.parse_args()
    log = tras.simulate_closed_loop(tras.multisine(60, 0.01, [0.5, 1.2], [1.0, 2.5], 0), 0.01)
    model = tras.KoopmanModel(tras.Mechanical(8), strength=1e-6).fit(log.select(inputs=["u_phi", "u_psi"]).cut(101))
    print(f"N = {len(model.names_)}, horizon 40, {options.samples} samples, cc {options.flags}; milliseconds")
    print(f"{'':50}{'Python':>8}{'p99':>8}{'C':>8}{'p99':>8}{'ratio':>8}{'difference':>12}")
    for name, settings in CASES.items():
        controller = tras.MPC(model, horizon=40, weights={"phi": 1, "psi": 1}, **{"limits": LIMITS} | settings)
        with tempfile.TemporaryDirectory() as folder:
            library = compiled(controller, Path(folder), options.flags.split())
            times, error = seconds(controller, library, options.samples)
        (python, c), (python_99, c_99) = 1e3 * np.median(times, axis=1), 1e3 * np.quantile(times, 0.99, axis=1)
        ratio = np.median(times[0] / times[1])
        row = f"{name:50}{python:8.2f}{python_99:8.2f}{c:8.3f}{c_99:8.3f}{ratio:8.1f}{error:12.1e}"
        print(row, flush=True)


if __name__ == "__main__":
    main()
