"""Eleven still recordings of an MPU-6050 on a bicycle (robot.bicycle, 2013; BSD): a session of single poses."""

import numpy as np
import pytest

from testkit.data import show
from testkit.faces import still_means
from testkit.recordings import bicycle
from undrift.calibration.calibrate import calibrate
from undrift.calibration.session import observe
from undrift.calibration.settings import CalibrateSettings
from undrift.record import Session
from undrift.units import STANDARD_GRAVITY


@pytest.mark.slow
def test_eleven_recordings_of_one_pose_each_are_one_session():
    bicycle_session = Session(
        kind="calibration", serial="bicycle", gravity_m_s2=STANDARD_GRAVITY, records=tuple(bicycle())
    )
    calibration = calibrate(bicycle_session)
    stills = observe(bicycle_session, CalibrateSettings()).stills
    assert [s.recording for s in stills] == list(range(11))
    means = np.concatenate([still_means(r.accel, [s]) for r, s in zip(bicycle_session.records, stills, strict=True)])
    length = np.linalg.norm((means - calibration.accel.offset) @ calibration.accel.matrix.T, axis=1)
    rms_mg = 1000.0 * float(np.sqrt(np.mean((length / STANDARD_GRAVITY - 1.0) ** 2)))
    scale = 16384.0 / STANDARD_GRAVITY / calibration.accel.scale_factor
    show("bicycle board |a| rms after the fit, mg", f"{rms_mg:.2f}", "0.1; 0.65 without the term yz, SOURCE.md")
    show("bicycle board scale", np.round(1.0 / scale, 3), "1.000/0.996/0.972 within 0.003")
    show("bicycle board offset, mg", np.round(1000.0 * calibration.accel.offset / 16384.0, 0), "+58/-6/-123")
    assert rms_mg <= 0.1
    np.testing.assert_allclose(1000.0 * calibration.accel.offset / 16384.0, [58.0, -6.0, -123.0], atol=2.0)
    assert 21.5 < calibration.reference_temp_c < 24.0
    assert calibration.verdict.status == "marginal"
