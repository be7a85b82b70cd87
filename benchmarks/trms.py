"""The TRMS of D. Rotondo, F. Nejjari and V. Puig (Control Engineering Practice 21, 2013) as CHRONOS-MPC flies it.

.venv/bin/python benchmarks/trms.py [--seconds 200] [--horizon 10] [--only identified]

The example `TRMS_basic` of `arielmb94/CHRONOS-MPC`: six states, the equations as they are printed, 0.1 s a sample,
sines of 1 rad at 1/31 Hz in yaw and of 0.5 rad at 1/47 Hz in pitch, no preview, commands that change by at most 0.5 V
from sample to sample, limits of the states. Its controller knows the equations; here the model is identified from a
recording of commands, with a PID in the loop and a test signal, and the same controller with the true equations stands
beside it. Printed are root mean square errors in rad after 20 s, samples at which the plan of the sample before was
kept, and CPU milliseconds of a step. No preview leaves two ways to plan: the reference is held over the horizon, or it
goes on as it went over the last sample, which knows no more of what comes.
"""

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np  # noqa: E402

import tras  # noqa: E402
from tras.control.predictors import plant  # noqa: E402
from tras.twin_rotor.rotors import rest_point  # noqa: E402

DT, START = 0.1, 20.0
MIDDLE = -0.6  # rad: the pitch about which the reference swings
RIG = tras.RotorParameters.rotondo(as_printed=True)
REST = rest_point(RIG)


def identified(seconds=600.0):
    """A model of a recording of the rig: a slow PID in the loop, and a test signal on the commands."""
    reference = tras.multisine(seconds, DT, [0.5, 0.8], [0.5, 1.0], 1) + [MIDDLE, 0.0]
    test = tras.multisine(seconds, DT, [8.0, 8.0], [0.4, 0.6], 2)
    log = tras.simulate_motor_loop(reference, DT, RIG, test_signal=test).select(inputs=["u_m", "u_t"])
    return tras.KoopmanModel(tras.Mechanical(actuators=[4, 5]), "one_step").fit(log.cut(101))


class GoesOn:
    """A controller without preview that takes the reference to go on as it went over the last sample."""

    def __init__(self, controller):
        self.controller, self.last = controller, None

    def reset(self):
        self.controller.reset()
        self.last = None

    def __call__(self, x, reference):
        rate = np.zeros_like(reference) if self.last is None else reference - self.last
        self.last = reference
        return self.controller(x, reference + np.arange(self.controller.horizon + 1)[:, None] * rate)


def controller(model, measured, horizon):
    """CHRONOS' limits: volts over those of a full command, 2 and 2.5; states, pitch from its rest on."""
    states = {"phi": (REST[0] - 0.5, REST[0] + 1.0), "phidot": (-0.6, 0.6), "psi": (-1.7, 1.2), "psidot": (-1.0, 1.0)}
    observer = tras.Observer(model, measured) if measured else None
    return tras.MPC(model, horizon=horizon, weights={"phi": 1.0, "psi": 1.0}, rate_weights=1e-4, limits=[(-1, 1)] * 2,
                    rates={"u_m": 0.5 / 2 / DT, "u_t": 0.5 / 2.5 / DT}, states=states, observer=observer)  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=200.0)
    parser.add_argument("--horizon", type=int, default=10)
    parser.add_argument("--only", choices=["identified", "true equations"])
    options = parser.parse_args()
    t = DT * np.arange(round(options.seconds / DT))
    reference = np.column_stack([MIDDLE + 0.5 * np.sin(2 * np.pi * t / 47), np.sin(2 * np.pi * t / 31)])
    models = {"identified": identified, "true equations": lambda: plant(RIG, DT)}
    print(f"{'model':16}{'measured':>12}{'reference':>11}{'yaw':>9}{'pitch':>9}{'kept':>6}{'ms':>7}")
    for name in [options.only] if options.only else models:
        model = models[name]()
        for measured in (None, ["phi", "psi"]):
            for goes_on in (False, True):
                control = controller(model, measured, options.horizon)
                flown, begin = GoesOn(control) if goes_on else control, time.process_time()
                run = tras.simulate_closed_loop(reference, DT, RIG, controllers=flown, x0=REST)
                milliseconds = 1e3 * (time.process_time() - begin) / len(reference)
                errors = (run.states[0][:, [0, 2]] - reference)[t >= START]
                pitch, yaw = np.sqrt((errors**2).mean(axis=0))
                row = f"{'angles' if measured else 'all states':>12}{'goes on' if goes_on else 'held':>11}"
                row += f"{yaw:9.4f}{pitch:9.4f}{control.failures:6}{milliseconds:7.1f}"
                print(f"{name:16}{row}", flush=True)


if __name__ == "__main__":
    main()
