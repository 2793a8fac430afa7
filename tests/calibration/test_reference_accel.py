"""Accelerometers against a reference: rests at known attitudes, motion with the position, and what neither shows.

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
from undrift.model import TriadModel
from undrift.record import Record, Reference
from undrift.sync import find_lag

G = 9.80665
MATRIX = np.array([[0.985, 0.006, -0.004], [-0.005, 1.012, 0.007], [0.003, -0.006, 0.996]])  # M, readings to force
OFFSET = np.array([0.12, -0.08, 0.2])
STEP, EACH = 2e-3, 8.0  # s: of the grid, of each pose
LEVER = np.array([0.01, -0.02, 0.03])
GYRO = TriadModel(
    method="reference/motion", unit_in="rad/s", unit_out="rad/s", matrix=np.eye(3), offset=np.zeros(3),
    covariance=np.zeros((12, 12)), rms_residual=0.0, count=1, rank=12, condition=1.0, valid_range=(-9.0, 9.0),
)  # fmt: skip


def ramp(t, start, stop):
    x = np.clip((t - start) / (stop - start), 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)  # three derivatives vanish at both ends


def recording(rng, *, poses=6, shake=20.0, noise=0.0, optics=(0.0, 0.0), late_s=0.0, position=True):
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
    turned = q[seen] * Rotation.from_rotvec(optics[0] * rng.normal(size=(len(fine[seen]), 3)))
    place = p[seen] + optics[1] * rng.normal(size=(len(fine[seen]), 3))
    reference = Reference(
        time=fine[seen],
        q_nb=turned.as_quat(scalar_first=True),
        position=place if position else None,
        moving=moving.astype(float),
    )
    return Record(time=t, gyro=gyro, accel=accel), reference


def fitted(pairs):
    records, references = [p[0] for p in pairs], [p[1] for p in pairs]
    none = np.zeros((len(pairs), 3))
    lags_s = np.array([find_lag(*pair).seconds for pair in pairs])
    return fit_reference_accel(records, references, GYRO, mountings=none, gravity_m_s2=G, lags_s=lags_s)


def error_of(fit):
    return np.concatenate(((fit.model.matrix - MATRIX).ravel(), fit.model.offset - OFFSET))


@pytest.mark.slow
def test_rests_and_motion_give_back_scale_cross_axis_and_offset():
    fit = fitted([recording(np.random.default_rng(1), late_s=0.002)])
    error = error_of(fit)
    show(
        "accelerometer without noise: matrix, offset (m/s2)",
        f"{np.abs(error[:9]).max():.1e}, {np.abs(error[9:]).max():.1e}",
    )
    # Budget: readings on a grid of 5 ms lose (2 pi 1.4 Hz 5 ms)^2 / 24 = 8e-5 of the motion's share, poses interpolated alike.
    assert np.abs(error[:9]).max() < 5e-4
    assert np.abs(error[9:]).max() < 5e-3
    assert fit.verdict.status == "good"
    assert fit.model.rank == 12


@pytest.mark.slow
def test_errors_scatter_within_their_stated_uncertainty():
    z = []
    for seed in range(3):
        record, reference = recording(np.random.default_rng(20 + seed), noise=0.02, optics=(1e-3, 3e-4))
        for position in (reference.position, None):
            fit = fitted([(record, replace(reference, position=position))])
            z.append(error_of(fit) / fit.model.standard_uncertainty)
    # The stated uncertainty holds a level error of the reference of 2e-3 rad and as much at each rest, which this bench does not
    # have: stated too large, never too small. 36 squares scatter by 24 % in their mean, 12 % in its root.
    rms = np.sqrt((np.reshape(z, (3, 2, 12)) ** 2).mean(axis=(0, 2)))
    show("errors over stated uncertainty, rms, with and without position", rms.round(2).tolist(), "below 1.3")
    assert (rms < 1.3).all()


@pytest.mark.slow
def test_reference_errors_at_rest_are_inside_the_stated_uncertainty():
    # Each rest's pose off by 2e-3 rad, the whole reference by as much: what the prior states.
    z = []
    for seed in range(5):
        rng = np.random.default_rng(60 + seed)
        record, reference = recording(rng, poses=9, shake=6.0, noise=0.01, position=False)
        error = Rotation.from_rotvec(2e-3 * rng.normal(size=3))
        pieces = np.searchsorted(EACH * np.arange(10) - 1.0, reference.time)
        own = Rotation.from_rotvec(2e-3 * rng.normal(size=(11, 3)))[pieces]
        q = (error * own * Rotation.from_quat(reference.q_nb, scalar_first=True)).as_quat(scalar_first=True)
        fit = fitted([(record, Reference(time=reference.time, q_nb=q, moving=reference.moving))])
        z.append(error_of(fit) / fit.model.standard_uncertainty)
    rms = float(np.sqrt((np.array(z) ** 2).mean()))
    show("with poses off by what is stated, errors over stated uncertainty, rms", f"{rms:.2f}", "0.5 to 1.4")
    # 5 devices of 12 correlated parameters: some 30 independent squares, whose root mean square scatters by 13 %.
    assert 0.5 < rms < 1.4


def test_what_one_pose_does_not_show_is_named_and_keeps_its_prior():
    one = fitted([recording(np.random.default_rng(3), poses=1, position=False)] * 4)
    found = only(one.verdict.findings, "reference.accel_held")
    assert "m_" in found.values["terms"]
    assert one.verdict.status == "marginal"
    assert one.model.rank < 12
    assert one.model.standard_uncertainty[:9].max() > 0.025
    moved = fitted([recording(np.random.default_rng(3), poses=1, position=True)])
    assert moved.model.rank == 12
    assert not any(item.code == "reference.accel_held" for item in moved.verdict.findings)


def test_saturated_readings_of_accelerometers_are_left_out():
    record, reference = recording(np.random.default_rng(3), poses=9, noise=0.01)
    fit = fitted([(replace(record, accel=np.clip(record.accel, -10.5, 10.5)), reference)])
    # without saturation the matrix misses by 2.3e-5, with clipped readings by 1.0e-4
    assert np.abs(fit.model.matrix - MATRIX).max() < 5e-5


def test_counts_take_their_scale_from_the_rests():
    record, reference = recording(np.random.default_rng(5))
    counts = Record(time=record.time, gyro=record.gyro, accel=100.0 * record.accel, accel_unit="count")
    fit = fitted([(counts, reference)])
    assert np.abs(100.0 * fit.model.matrix - MATRIX).max() < 5e-4
    assert fit.model.offset / 100.0 == pytest.approx(OFFSET, abs=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("position", [True, False])
def test_counts_of_a_converter_with_its_zero_at_half_scale_are_fitted_alike(position):
    record, reference = recording(np.random.default_rng(5), poses=12)
    if not position:
        reference = replace(reference, position=None)
    raw = Record(time=record.time, gyro=record.gyro, accel=20.0 * record.accel + 2048.0, accel_unit="count")
    fit, plain = fitted([(raw, reference)]), fitted([(record, reference)])
    assert np.abs(20.0 * fit.model.matrix - plain.model.matrix).max() < 5e-4  # the prior's centre alone differs
    assert (fit.model.offset - 2048.0) / 20.0 == pytest.approx(plain.model.offset, abs=5e-3)
    assert fit.model.rank == 12


def test_too_few_rests_are_refused_and_the_gyroscopes_stay():
    pair = recording(np.random.default_rng(6), poses=1, position=False)
    with pytest.raises(NotObservable, match="wanted four rests or more, or motion with the position"):
        fitted([pair])
    made = calibrate_to_references([pair[0]], [pair[1]])
    assert made.gyro is not None
    assert made.accel is None
    assert only(made.verdict.findings, "reference.accel_failed").level == "info"


@pytest.mark.slow
def test_a_calibration_from_references_holds_both_triads():
    made = calibrate_to_references(*([part] for part in recording(np.random.default_rng(7), noise=0.01)))
    assert made.accel is not None
    assert made.accel.unit_out == "m/s2"
    assert made.accel.offset == pytest.approx(OFFSET, abs=0.03)


@pytest.mark.parametrize("gain", [1.0, 1.02])
def test_rests_that_no_pose_shows_are_compared_with_gravity(gain):
    record, reference = recording(np.random.default_rng(8), poses=9, noise=0.01, position=False)
    hidden = reference.time < 3.0 * EACH - 3.0  # three rests before the markers are seen
    q = np.where(hidden[:, None], np.nan, reference.q_nb)
    factor = np.where(record.time < 3.0 * EACH - 3.0, gain, 1.0)[:, None]
    fit = fitted([(replace(record, accel=factor * record.accel), replace(reference, q_nb=q))])
    assert np.abs(error_of(fit)[:9]).max() < 2e-3
    if gain == 1.0:
        assert fit.verdict.status == "good"
    else:
        found = only(fit.verdict.findings, "accel.unused_stills")
        assert (found.level, found.values["stills"], found.values["beyond"]) == ("fail", 3, 3)
        assert found.values["rms_m_s2"] == pytest.approx(0.02 * G, rel=0.1)
