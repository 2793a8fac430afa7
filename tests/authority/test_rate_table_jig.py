"""One axis of a public stepper rate table with two sensors on it (Rimu_Test_Jig, 2018; Apache-2.0).

A Bosch BNO055 whose stated sensitivity is right to 0.4 %, and an ST LSM6 whose readings were converted with the wrong
sensitivity (30.5 instead of 35 mdeg/s a code): the fit must find it, and call it what it is. The clocks are not synchronised.
"""

import numpy as np
import pytest

from testkit.data import show
from testkit.findings import only
from testkit.stepper_jig import RUNS, clock_lag, turned
from undrift.calibration.calibrate import calibrate
from undrift.calibration.rate_table import fit_rate_table
from undrift.calibration.table import dwell_means
from undrift.errors import NotObservable
from undrift.record import Session


def measured(run, sensor):
    """Mean readings at the rates the table achieved, on the sensor's clock; the turns leave out where the table settles."""
    record, turns = turned(run, sensor)
    return dwell_means([record], turns, settle_s=0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("sensor", "status"), [("bno", "marginal"), ("lsm", "bad")])
@pytest.mark.parametrize("run", RUNS)
def test_wrong_stated_scale_of_one_axis_is_a_bad_verdict(run, sensor, status):
    record, turns = turned(run, sensor)
    session = Session(kind="calibration", serial="jig", gravity_m_s2=9.81, records=(record,), turns=turns)
    calibration = calibrate(session)
    scale = calibration.gyro.scale_factor * np.pi / 180.0
    show(f"{run} {sensor} scale x, y, z", np.round(scale, 3), "1, 1.004 or 0.85, 1")
    assert calibration.verdict.status == status
    np.testing.assert_allclose(calibration.gyro.forward_matrix[[0, 2], [0, 2]] * np.pi / 180.0, 1.0, atol=1e-9)
    if sensor == "lsm":
        off = only(calibration.verdict.findings, "gyro.scale_factor")
        assert (off.level, "Gyroscope y" in off.sentence) == ("fail", True)
        assert -15.5 < off.values["off_percent"] < -14.0


@pytest.mark.slow
@pytest.mark.parametrize("run", RUNS)
def test_the_bosch_sensor_is_within_its_line_and_scale(run):
    dwells, lag = measured(run, "bno"), clock_lag(run)
    fit = fit_rate_table(dwells)
    scale, offset = fit.model.forward_matrix[1, 1] * np.pi / 180.0, float(fit.model.offset[1])
    worst = np.degrees(np.abs(fit.residuals[:, 1]).max())
    relative = float(fit.model.standard_uncertainty[4] / fit.model.matrix[1, 1])
    show(f"{run} BNO scale", f"{scale:.5f}", f"1.0035..1.0041 +- {2.0 * relative:.5f}")
    show(f"{run} BNO offset, deg/s", f"{offset:.3f}", "-0.12..0.01 +- 0.07 standard uncertainty")
    show(f"{run} BNO worst departure from the line, deg/s", f"{worst:.3f}", 0.16)
    show(f"{run} clocks apart, s", f"{lag:.3f}", "0.0..0.7")
    assert 1.0035 - 2.0 * relative < scale < 1.0041 + 2.0 * relative
    assert relative < 4e-4  # seven dwells of a few seconds
    assert worst <= 0.16
    uncertainty = float(fit.model.standard_uncertainty[10])
    assert -0.12 - 2.0 * uncertainty < offset < 0.01 + 2.0 * uncertainty
    assert uncertainty < 0.1
    assert 0.0 < abs(lag) < 0.7
    with pytest.raises(NotObservable, match="got none about x, z"):
        fit_rate_table(dwells, mode="paper")


@pytest.mark.parametrize("run", RUNS)
def test_wrong_conversion_of_the_st_sensor_is_measured(run):
    dwells = measured(run, "lsm")
    fit = fit_rate_table(dwells)
    scale = fit.model.forward_matrix[1, 1] * np.pi / 180.0
    show(f"{run} LSM scale", f"{scale:.4f}", "0.848..0.855; 30.5 / 35 = 0.872 of the true sensitivity")
    assert 0.848 <= round(scale, 3) <= 0.855
