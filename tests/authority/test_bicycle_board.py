"""An MPU-6050 on a robot bicycle (robot.bicycle, 2013): eleven recordings, each one still pose, the faces to a degree or so."""

import numpy as np
import pytest

from data import data_path, show
from undrift.calibration.fit.multi_position import MultiPositionSettings, fit_multi_position_session
from undrift.calibration.fit.multi_position_accel import fit_poses
from undrift.errors import NotObservable
from undrift.record import Record
from undrift.session import Session
from undrift.units import STANDARD_GRAVITY

GRAVITY = 9.80  # Davis, California


def recordings() -> tuple[Record, ...]:
    files = sorted(data_path("multipos_mpu6050_bicycle").glob("*.npz"))
    logs = [np.load(file) for file in files]
    return tuple(
        Record(
            time=log["t_s"], accel=log["acc_raw"], gyro=log["gyro_rad_s"], temp_c=log["temp_degC"], accel_unit="count"
        )
        for log in logs
    )


def test_eleven_poses_have_one_length_after_scale_and_offset() -> None:
    session = Session(kind="calibration", serial="bicycle", gravity_m_s2=GRAVITY, records=recordings())
    fit = fit_multi_position_session(session, settings=MultiPositionSettings(cross_axis=False))
    rms_mg = fit.accel.model.rms_residual / STANDARD_GRAVITY * 1e3
    scale = np.diag(fit.accel.model.matrix) * 16384.0 / GRAVITY
    offset_mg = fit.accel.model.offset / 16.384
    show("|a| rms over the 11 recordings, mg", rms_mg, 0.7)
    show("scale", np.round(scale, 3), "1.000 0.996 0.972")
    show("offset, mg", np.round(offset_mg, 1), "58 -6 -123")
    assert len(fit.stills) == 11
    assert rms_mg <= 0.7
    np.testing.assert_allclose(scale, [1.000, 0.996, 0.972], atol=1.5e-3)
    np.testing.assert_allclose(offset_mg, [58.0, -6.0, -123.0], atol=1.0)


def test_poses_given_one_by_one_say_the_same_and_refuse_cross_axis_terms() -> None:
    records = recordings()
    means = [r.accel.mean(axis=0) for r in records if r.accel is not None]
    errors = [r.accel.std(axis=0) / np.sqrt(len(r)) for r in records if r.accel is not None]
    fit = fit_poses(means, gravity=GRAVITY, standard_errors=errors, cross_axis=False)
    show("|a| rms, mg", fit.model.rms_residual / STANDARD_GRAVITY * 1e3, 0.7)
    assert fit.model.rms_residual / STANDARD_GRAVITY * 1e3 <= 0.7
    with pytest.raises(NotObservable, match=r"m_x.*edges and corners up"):
        fit_poses(means, gravity=GRAVITY, standard_errors=errors)
