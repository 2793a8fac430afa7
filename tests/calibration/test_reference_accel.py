"""Accelerometers against a reference: rests at known attitudes.

The forward model is the test's own: a smooth path and turn in closed form, differentiated twice on a grid of 500 Hz.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from testkit.data import show
from testkit.findings import only
from undrift.calibration.calibrate import calibrate_to_references
from undrift.calibration.reference_accel import fit_reference_accel
from undrift.errors import NotObservable
from undrift.record import Record, Reference
from undrift.sync import find_lag

G = 9.80665
MATRIX = np.array([[0.985, 0.006, -0.004], [-0.005, 1.012, 0.007], [0.003, -0.006, 0.996]])  # M, readings to force
OFFSET = np.array([0.12, -0.08, 0.2])
STEP, EACH = 2e-3, 8.0  # s: of the grid, of each pose
LEVER = np.array([0.01, -0.02, 0.03])


def ramp(t, start, stop):
    x = np.clip((t - start) / (stop - start), 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)  # three derivatives vanish at both ends


def recording(rng, *, poses=9, shake=20.0, noise=0.0, optics=0.0, late_s=0.0):
    """A device that rests in several poses, then is shaken and turned, then rests."""
    fine = np.arange(0.0, EACH * poses + shake + 6.0, STEP)
    turns = Rotation.random(poses, random_state=int(rng.integers(1 << 30)))
    at = EACH * np.arange(poses)
    level = np.zeros(len(fine))
    for k in range(1, poses):
        level += ramp(fine, at[k] - 2.0, at[k])
    q = Slerp(np.arange(poses), turns)(level) if poses > 1 else Rotation.concatenate([turns[0]] * len(fine))
    start = EACH * poses
    gate = ramp(fine, start, start + 1.0) * (1.0 - ramp(fine, start + shake - 1.0, start + shake))
    f, phase = rng.uniform(0.3, 1.4, (6, 4)), rng.uniform(0.0, 6.3, (6, 4))
    waves = np.sin(2.0 * np.pi * f[:, :, None] * fine + phase[:, :, None]).sum(axis=1) * gate
    q = q * Rotation.from_rotvec(0.5 * waves[:3].T)
    p = 0.06 * waves[3:].T + (1.0, 0.5, 1.2)
    sensor = p + q.apply(LEVER)
    above = np.gradient(np.gradient(sensor, STEP, axis=0), STEP, axis=0)
    force = q.inv().apply(above + np.array([0.0, 0.0, G]))
    rate = np.zeros_like(p)
    rate[1:] = (q[:-1].inv() * q[1:]).as_rotvec() / STEP
    t = np.arange(0.5, fine[-1] - 0.5, 0.005)
    reading = np.linalg.solve(MATRIX, force.T).T + OFFSET
    accel = np.stack([np.interp(t - late_s, fine, c) for c in reading.T], axis=1) + noise * rng.normal(size=(len(t), 3))
    gyro = np.stack([np.interp(t, fine, c) for c in rate.T], axis=1) + 1e-4 * rng.normal(size=(len(t), 3))
    seen = slice(None, None, 5)
    moving = (fine[seen] >= EACH - 3.0) & (fine[seen] < start + shake)
    turned = q[seen] * Rotation.from_rotvec(optics * rng.normal(size=(len(fine[seen]), 3)))
    reference = Reference(time=fine[seen], q_nb=turned.as_quat(scalar_first=True), moving=moving.astype(float))
    return Record(time=t, gyro=gyro, accel=accel), reference


def fitted(pairs):
    records, references = [p[0] for p in pairs], [p[1] for p in pairs]
    none = np.zeros((len(pairs), 3))
    lags_s = np.array([find_lag(*pair).seconds for pair in pairs])
    return fit_reference_accel(records, references, mountings=none, gravity_m_s2=G, lags_s=lags_s)


def error_of(fit):
    return np.concatenate(((fit.model.matrix - MATRIX).ravel(), fit.model.offset - OFFSET))


def test_rests_give_back_scale_cross_axis_and_offset():
    fit = fitted([recording(np.random.default_rng(1), late_s=0.002)])
    error = error_of(fit)
    show("accelerometer without noise: matrix, offset (m/s2)", np.abs(error[:9]).max(), np.abs(error[9:]).max())
    # find_still takes the first and last tenths of a second of the turns between rests for rest
    assert np.abs(error[:9]).max() < 1e-4
    assert np.abs(error[9:]).max() < 1e-3
    assert fit.verdict.status == "good"
    assert fit.model.rank == 12


def test_offsets_that_differ_between_rests_widen_the_intervals():
    record, reference = recording(np.random.default_rng(9), shake=6.0, noise=0.01)
    piece = np.searchsorted(EACH * np.arange(10) - 1.0, record.time)
    apart = np.random.default_rng(10).normal(0.0, 3e-3, (11, 3))[piece]  # m/s2: six times the stated flicker
    fits = [fitted([(replace(record, accel=accel), reference)]) for accel in (record.accel, record.accel + apart)]
    scale = [fit.model.standard_uncertainty[[0, 4, 8]].max() for fit in fits]
    show("offsets of rests differ by 3e-3 m/s2, uncertainty of a scale before and with it", *scale)
    assert scale[1] > 5.0 * scale[0]  # with the tilt of poses alone it is 4.4


def test_saturated_readings_of_accelerometers_are_left_out():
    record, reference = recording(np.random.default_rng(3), noise=0.01)
    fit = fitted([(replace(record, accel=np.clip(record.accel, -9.7, 9.7)), reference)])
    # readings of rests reach 9.9 m/s2: clipped to 9.7 they would miss by 0.02
    assert np.abs(fit.model.matrix - MATRIX).max() < 3e-4


@pytest.mark.parametrize("zero", [0.0, 2048.0])
def test_counts_take_scale_and_zero_from_the_rests(zero):
    record, reference = recording(np.random.default_rng(5))
    raw = Record(time=record.time, gyro=record.gyro, accel=20.0 * record.accel + zero, accel_unit="count")
    fit = fitted([(raw, reference)])
    assert np.abs(20.0 * fit.model.matrix - MATRIX).max() < 5e-4
    assert (fit.model.offset - zero) / 20.0 == pytest.approx(OFFSET, abs=5e-3)


@pytest.mark.parametrize("poses", [1, 3])
def test_too_few_rests_are_refused_and_the_gyroscopes_stay(poses):
    pair = recording(np.random.default_rng(6), poses=poses)
    with pytest.raises(NotObservable, match="six sides"):
        fitted([pair])
    calibration = calibrate_to_references([pair[0]], [pair[1]])
    assert calibration.gyro is not None
    assert calibration.accel is None
    assert only(calibration.verdict.findings, "session.not_observable").level == "info"
