"""The whole hand-held calibration on simulated sessions: stills found, threshold chosen, gyroscopes by integration."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.findings import only
from testkit.poses import fit_multi_position
from undrift.calibration.calibrate import calibrate
from undrift.calibration.moves import fit_moves
from undrift.errors import Implausible, InputError, NotObservable, PoorFit
from undrift.record import Record, Still
from undrift.sim.motion.bench import BenchSettings, bench_motion

G = 9.80665
MOTION = bench_motion(
    "multi_position", rng=np.random.default_rng(5), settings=BenchSettings(poses=20, first_still_s=10.0)
)
ACCEL = np.array([[0.99, 0.01, -0.02], [0.0, 1.02, 0.015], [0.0, 0.0, 1.01]])
ACCEL_OFFSET = np.array([0.2, -0.1, 0.3])
GYRO = np.array([[1.01, 0.02, -0.01], [-0.015, 0.98, 0.005], [0.01, -0.02, 1.03]])
GYRO_OFFSET = np.array([0.02, -0.01, 0.005])


def recorded(seed: int = 0, accel_sd: float = 0.02, gyro_sd: float = 0.002) -> Record:
    """A device of known matrices that lies and turns as a hand would make it."""
    rng = np.random.default_rng(seed)
    force = MOTION.force_b @ np.linalg.inv(ACCEL).T + ACCEL_OFFSET
    rate = MOTION.mean_rate_b @ np.linalg.inv(GYRO).T + GYRO_OFFSET
    return Record(
        time=MOTION.time,
        accel=force + accel_sd * rng.normal(size=force.shape),
        gyro=rate + gyro_sd * rng.normal(size=rate.shape),
    )


def test_stills_of_several_recordings_are_pooled() -> None:
    record = recorded(accel_sd=0.0, gyro_sd=0.0)
    pieces = tuple(record.part(s.start, s.stop) for s in MOTION.stills)
    stills = tuple(Still(start=0, stop=len(p), recording=k) for k, p in enumerate(pieces))
    fit = fit_multi_position(pieces, gravity=G, stills=stills)
    np.testing.assert_allclose(fit.accel.model.matrix, ACCEL, atol=1e-9)
    assert fit.gyro is None
    with pytest.raises(NotObservable, match="got 0"):
        fit_moves(pieces, stills, fit.accel.model)


def test_moves_about_one_axis_leave_the_gyroscopes_unseen() -> None:
    time = np.arange(6000) / 100.0
    moving = (np.arange(6000) % 600) >= 300
    rate = np.where(moving, np.pi / 6.0, 0.0)[:, None] * np.array([1.0, 0.0, 0.0])  # 90 deg about x in 3 s
    up = np.array([0.3, 0.2, 0.933])
    q = Rotation.from_rotvec(np.cumsum(rate, axis=0) / 100.0)  # one axis: angles add
    record = Record(time=time, gyro=rate, accel=G * q.inv().apply(up / np.linalg.norm(up)))
    stills = [Still(start=600 * k, stop=600 * k + 300) for k in range(10)]
    accel = fit_multi_position(recorded(), gravity=G).accel.model
    perfect = replace(accel, matrix=np.eye(3), offset=np.zeros(3))
    with pytest.raises(NotObservable, match="terms xy, xz"):
        fit_moves((record,), stills, perfect)


def test_a_move_with_a_gap_is_left_out_and_the_rest_still_fits() -> None:
    record = recorded()
    assert record.gyro is not None
    gyro, accel = np.array(record.gyro), np.array(record.accel)
    middle = MOTION.stills[3].stop + 60
    gyro[middle], accel[MOTION.stills[6].start + 200] = np.nan, np.nan
    fit = fit_multi_position(replace(record, gyro=gyro, accel=accel), gravity=G)
    assert fit.gyro is not None
    assert fit.gyro.model.count < 2 * (len(fit.stills) - 1)
    np.testing.assert_allclose(fit.gyro.model.matrix, GYRO, atol=1e-3)  # five standard uncertainties


def test_turn_about_the_vertical_does_not_bias_the_offset() -> None:
    # An accelerometer cannot see it: twenty seconds of lying pose turn at 3 deg/s about the vertical.
    record = recorded()
    assert record.gyro is not None
    assert record.accel is not None
    gyro, still = np.array(record.gyro), MOTION.stills[4]
    up = MOTION.force_b[still.start + 10] / G
    gyro[still.start : still.stop] += np.linalg.inv(GYRO) @ up * np.radians(3.0)
    fit = fit_multi_position(replace(record, gyro=gyro), gravity=G)
    assert fit.gyro is not None
    np.testing.assert_allclose(
        fit.gyro.model.offset, GYRO_OFFSET, atol=2e-4
    )  # 3 deg/s over one in twenty would be 2.6e-3


def test_drifting_offset_is_stated_as_its_mean_over_the_rests() -> None:
    record = recorded()
    assert record.gyro is not None
    drift = (
        np.radians(1.0) * (record.time - record.time.mean())[:, None] / np.ptp(record.time)
    )  # 1 deg/s in the session
    fit = fit_multi_position(replace(record, gyro=record.gyro + drift), gravity=G, stills=MOTION.stills).gyro
    assert fit is not None
    mean = GYRO_OFFSET + np.mean([drift[still.start : still.stop].mean() for still in MOTION.stills])
    assert (np.abs(fit.model.offset - mean) < 3.0 * fit.model.standard_uncertainty[9:12]).all()
    np.testing.assert_allclose(fit.model.matrix, GYRO, atol=0.005)  # followed, not taken for gain


def test_moves_beyond_the_range_are_left_out_by_number() -> None:
    record = recorded()
    assert record.gyro is not None
    top = 0.9 * float(np.abs(record.gyro).max())
    fit = fit_multi_position(replace(record, gyro=record.gyro.clip(-top, top)), gravity=G, stills=MOTION.stills)
    assert fit.gyro is not None
    left_out = only(fit.gyro.verdict.findings, "session.saturated")
    assert 0 < left_out.values["count"] < left_out.values["of"] == 19
    for name in left_out.values["pieces"]:
        number, first, last = re.fullmatch(r"the move after still (\d+) \((.+)-(.+) s\)", name).groups()
        before, after = sorted(MOTION.stills, key=lambda still: still.start)[int(number) - 1 : int(number) + 1]
        assert float(first) == pytest.approx(record.time[before.stop - 1], abs=0.1)
        assert float(last) == pytest.approx(record.time[after.start], abs=0.1)
    assert fit.gyro is not None
    np.testing.assert_allclose(fit.gyro.model.matrix, GYRO, atol=0.005)


@pytest.mark.slow
def test_rests_show_g_sensitivity() -> None:
    rng, scaled = np.random.default_rng(12), []
    for seed in range(25):
        record, h = recorded(seed), rng.normal(0.0, np.radians(0.1) / G, (3, 3))
        assert record.gyro is not None
        felt = replace(record, gyro=record.gyro + MOTION.force_b @ h.T)
        gyro = fit_multi_position(felt, gravity=G, stills=MOTION.stills).gyro
        assert gyro is not None
        assert gyro.model.g_sensitivity is not None
        sigma = gyro.model.standard_uncertainty
        scaled.append((gyro.model.offset - GYRO_OFFSET) / sigma[9:12])
        np.testing.assert_allclose(gyro.model.g_sensitivity, GYRO @ h, atol=5.0 * sigma[12:].max())
    assert 0.87 < float((np.abs(scaled) < 1.96).mean()) <= 1.0  # 75 offsets: 2.5 % one sigma; 80 % without H
    assert np.degrees(sigma[9:12]).max() < 0.002


@pytest.mark.parametrize(
    ("change", "error", "numbers"),
    [
        (lambda record: replace(record, time=record.time * 2.0), Implausible, {"ratio": pytest.approx(2.0, rel=0.05)}),
        (lambda record: replace(record, gyro=record.gyro * [1.0, -1.0, 1.0]), Implausible, {"order": "+x, -y, +z"}),
        (lambda record: replace(record, accel=record.accel.clip(-8.5, 8.5)), Implausible, {}),
        (lambda record: record.part(0, MOTION.stills[5].stop), NotObservable, {"wanted": 9}),
        (lambda record: record.part(0, 20), InputError, {}),
        (
            lambda record: replace(record, gyro=np.roll(record.gyro, 450, axis=0)),
            (PoorFit, Implausible, NotObservable),
            {},
        ),
    ],
)
def test_recordings_that_moves_cannot_use_are_refused(change, error, numbers) -> None:
    with pytest.raises(error) as caught:
        fit_multi_position(change(recorded()), gravity=G)
    assert numbers.items() <= caught.value.numbers.items()


def test_moves_need_an_accelerometer() -> None:
    with pytest.raises(NotObservable, match="accelerometer readings"):
        calibrate(replace(recorded(), accel=None), gyro="multi-position")


def test_gyroscopes_that_read_nothing_are_refused() -> None:
    silent = replace(recorded(), gyro=np.zeros_like(recorded().accel))
    accel = fit_multi_position(recorded(), gravity=G, stills=MOTION.stills, gyro=False).accel.model
    with pytest.raises(NotObservable) as caught:
        fit_moves([silent], MOTION.stills, accel)
    assert caught.value.moves == 19
