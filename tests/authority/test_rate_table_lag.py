"""Two-axis stepper jig with two sensors, clocks apart (Rimu_Test_Jig, Apache-2.0, 2018): the lag between the clocks is found."""

import numpy as np
import pytest

from testkit.axis_lag import find_axis_lag
from testkit.data import data_path, show
from undrift.record import Record

RUNS = ("giro_test_filt", "giro_test_non_filt", "slow_range_data")


def lag_of(run, sensor):
    with np.load(data_path("ratetable_jig", f"{run}.npz")) as file:
        record = Record(time=file["t_imu"], gyro=file[f"gyro_{sensor}_dps"], gyro_unit="dps")
        return find_axis_lag(record, file["t_jig"], np.radians(file["top_angle_deg"]))


@pytest.mark.parametrize("run", RUNS)
def test_the_clocks_of_jig_and_sensors_are_brought_together(run):
    bno, lsm = lag_of(run, "bno"), lag_of(run, "lsm")
    for name, lag in (("bno", bno), ("lsm", lsm)):
        show(
            f"{run} {name} lag, s",
            f"{lag.seconds:.3f} +- {lag.standard_uncertainty:.3f}, correlation {lag.correlation:.4f}",
            "0.0-0.7 apart",
        )
        assert 0.2 < abs(lag.seconds) < 0.7  # the recordings' documentation: 0.0 to 0.7 s
        assert lag.correlation > 0.97
    # One logger stamps both sensors; stepper vibration of 10-50 deg/s on the second leaves a few hundredths.
    assert bno.seconds == pytest.approx(lsm.seconds, abs=0.05)


@pytest.mark.slow
def test_the_wrong_scale_of_one_sensor_shows_on_the_way():
    ratio = lag_of("giro_test_filt", "bno").matrix[0, 1] / lag_of("giro_test_filt", "lsm").matrix[0, 1]
    show("lsm reading over bno reading", f"{ratio:.4f}", "0.848-0.855 over 1.0035-1.0041")
    assert 0.840 < ratio < 0.860
