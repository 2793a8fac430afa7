"""A session of several set-points: the constant model is that of one of them."""

import numpy as np

from testkit.findings import only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.observe import at_one_temperature
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration
from undrift.sim.sessions import simulate_session
from undrift.sim.thermal import ThermalSettings, simulate_thermal_session


def test_a_thermal_session_is_calibrated_at_the_set_point_nearest_to_room_temperature() -> None:
    rng = np.random.default_rng(3)
    device = random_device_of("bmi270", rng)
    session = simulate_thermal_session(
        "soak", device, rng=rng, settings=ThermalSettings(set_points_c=(15.0, 27.0, 45.0), faces="six")
    )
    made = calibrate(session)
    assert abs(made.reference_temp_c - 27.0) < 1.5  # the thermometer's trim and the soak's tolerance
    visited = only(made.verdict.findings, "session.temperatures")
    assert (visited.level, visited.values["groups"]) == ("warn", 3)
    assert "undrift drift" in visited.action
    truth = true_calibration(device, temp_c=27.0)
    assert made.gyro is not None
    assert truth.gyro is not None
    np.testing.assert_allclose(
        made.gyro.matrix / truth.gyro.matrix.max(), truth.gyro.matrix / truth.gyro.matrix.max(), atol=2e-3
    )


def test_a_session_that_warms_a_little_is_left_as_it_is() -> None:
    rng = np.random.default_rng(4)
    session = simulate_session("bench", random_device_of("bmi270", rng), rng=rng, temp_c=(24.0, 29.0))
    kept, findings = at_one_temperature(session)
    assert kept is session
    assert findings == ()
