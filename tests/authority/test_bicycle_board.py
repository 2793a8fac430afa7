"""Eleven still recordings of an MPU-6050 on a bicycle (robot.bicycle, 2013; BSD): a session of single poses."""

import numpy as np

from testkit.data import data_path, show
from testkit.findings import only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.observe import CalibrateSettings, observe
from undrift.record import Record, Session
from undrift.segments import still_means
from undrift.units import STANDARD_GRAVITY

NAMES = (
    "phi_000_theta_000", "phi_000_theta_090", "phi_000_theta_180", "phi_000_theta_270", "phi_090_theta_000",
    "phi_270_theta_000", "reference", "rsidedown", "rsideup", "sahfd01", "sahfu01",
)  # fmt: skip


def session():
    records = []
    for name in NAMES:
        d = np.load(data_path("multipos_mpu6050_bicycle", f"{name}.npz"))
        records.append(
            Record(time=d["t_s"], gyro=d["gyro_rad_s"], accel=d["acc_raw"], accel_unit="count", temp_c=d["temp_degC"])
        )
    return Session(kind="calibration", serial="bicycle", gravity_m_s2=STANDARD_GRAVITY, records=tuple(records))


def test_eleven_recordings_of_one_pose_each_are_one_session():
    made = session()
    found = calibrate(made)
    stills = observe(made, CalibrateSettings()).stills
    assert [s.recording for s in stills] == list(range(11))
    means = np.concatenate([still_means(r.accel, [s]) for r, s in zip(made.records, stills, strict=True)])
    length = np.linalg.norm((means - found.accel.offset) @ found.accel.matrix.T, axis=1)
    rms_mg = 1000.0 * float(np.sqrt(np.mean((length / STANDARD_GRAVITY - 1.0) ** 2)))
    scale = 16384.0 / STANDARD_GRAVITY / found.accel.scale_factor
    show("bicycle board |a| rms after the fit, mg", f"{rms_mg:.2f}", 0.7)
    show("bicycle board scale", np.round(1.0 / scale, 3), "1.000/0.996/0.972 within 0.003")
    show("bicycle board offset, mg", np.round(1000.0 * found.accel.offset / 16384.0, 0), "+58/-6/-123")
    assert rms_mg <= 0.7
    np.testing.assert_allclose(1000.0 * found.accel.offset / 16384.0, [58.0, -6.0, -123.0], atol=2.0)
    assert 21.5 < found.reference_temp_c < 24.0
    assert found.verdict.status == "marginal"
    assert "multi_position.scale_alone" in [item.code for item in found.verdict.findings]


def test_the_reason_that_stops_both_triads_is_given_once():
    verdict = calibrate(session()).verdict
    failed = only(verdict.findings, "session.fit_failed")
    assert failed.values["triad"] == "accelerometer and gyroscope"
    assert "cross-axis terms xy and xz" in failed.detail
    assert sum(str(failed.values["reason"]) in reason for reason in verdict.reasons) == 1
