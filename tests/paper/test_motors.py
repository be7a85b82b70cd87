"""The rig with motors, small: the flights are repeatable, and a model of the recording follows better than the PID."""

import numpy as np
import pandas as pd
import pytest

from tras.paper import motors

SMALL = motors.Motors(
    recording=60.0, flight=6.0, flight_frequencies=(1.5, 1.5), gusts=(0.0, 0.02), take_off=2.0, horizon=20
)


@pytest.mark.slow
def test_a_model_of_motor_commands_flies_better_than_the_pid_and_the_study_repeats():
    models = motors.identify(SMALL)
    assert models["mechanical"].input_names_ == ("u_m", "u_t") and len(models["mechanical"].state_names_) == 6
    flights = motors.fly(SMALL, models)
    assert list(flights["controller"].unique()) == list(motors.CONTROLLERS) and set(flights["gust"]) == {0.0, 0.02}
    errors = flights.set_index(["gust", "controller"])
    assert (errors.loc[0.0, "yaw"]["MPC, true plant"] < errors.loc[0.0, "yaw"]["PID"]) and motors.of_pid(flights) < 0.5
    one = motors.fly(motors.Motors(**{**vars(SMALL), "gusts": (0.02,)}), models, processes=2)
    pd.testing.assert_frame_equal(one, flights[flights["gust"] == 0.02].reset_index(drop=True), check_exact=True)


@pytest.mark.slow
def test_flights_do_not_feel_rounding():
    """From rest, with the commands at their limits, one rounding unit of the reference changed the errors by 16 %."""
    models = {"mechanical": motors.identify(SMALL)["mechanical"]}
    nudged = motors.Motors(**{**vars(SMALL), "flight_peaks": tuple(np.nextafter(SMALL.flight_peaks, 1))})
    errors = [motors._flight(case, models, "MPC, mechanical", 0.0) for case in (SMALL, nudged)]
    for angle in ("yaw", "pitch"):
        assert errors[1][angle] == pytest.approx(errors[0][angle], rel=1e-8)


def test_the_share_of_the_pids_error_is_the_worst_one():
    rows = [("PID", 0.01, 0.5, 0.2), (motors.OURS, 0.01, 0.05, 0.03), ("PID", 0.0, 0.1, 0.1), (motors.OURS, 0.0, 9, 9)]
    table = pd.DataFrame(rows, columns=["controller", "gust", "yaw", "pitch"])
    assert motors.of_pid(table) == pytest.approx(0.15)
    assert np.isnan(motors.of_pid(table[table["gust"] == 0])) and np.isnan(motors.of_pid(table.iloc[:1]))
