"""The magnetometer from motion: intervals hold, disturbed stretches are left out, what motion hides is named, real trials agree."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.broad import DEVICES, trial
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from testkit.data import needs_data, show
from undrift.calibration.calibrate import calibrate_from_motion
from undrift.calibration.magnetometer import fit_magnetometer
from undrift.errors import InputError, NotObservable
from undrift.record import Record
from undrift.sim.motion.tasks import draw_task
from undrift.units import STANDARD_GRAVITY

RATE_HZ, H_UT, DIP, LAG_S = 50.0, 48.0, np.radians(66.0), 0.012
NORTH = H_UT * np.array([0.0, np.cos(DIP), -np.sin(DIP)])


def iron(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return A of soft iron of 5 % and axes 1 deg off, determinant 1, and b of 5 to 50 uT."""
    soft = np.eye(3) + 0.05 / np.sqrt(3.0) * (lambda x: 0.5 * (x + x.T))(rng.standard_normal((3, 3)))
    turn = Rotation.from_rotvec(np.radians(1.0) / np.sqrt(3.0) * rng.standard_normal(3)).as_matrix()
    hard = rng.standard_normal(3)
    return turn @ soft / np.cbrt(np.linalg.det(soft)), rng.uniform(5.0, 50.0) * hard / np.linalg.norm(hard)


def seen(rng: np.random.Generator, time: np.ndarray, q_nb: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return readings (N, 3), uT: a field with a gradient about the hand and a disturbance of seconds, lag, noise, codes."""
    turned = Rotation.from_quat(q_nb, scalar_first=True)
    gradient = (lambda x: x + x.T - 2.0 / 3.0 * np.trace(x) * np.eye(3))(2.0 * rng.standard_normal((3, 3)))  # uT/m
    place = turned.apply(0.1 * rng.standard_normal(3)) @ gradient
    keep, slow = np.exp(-(time[1] - time[0]) / 3.0), np.zeros((len(time), 3))
    for k in range(1, len(time)):
        slow[k] = keep * slow[k - 1] + 0.3 * np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
    field = turned.inv().apply(NORTH + place + slow)
    late = np.stack([np.interp(time - LAG_S, time, axis) for axis in field.T], axis=1)
    reading = late @ np.linalg.inv(a).T + b + 0.5 * rng.standard_normal((len(time), 3))
    return np.asarray(0.15 * np.round(reading / 0.15))


def worn(seed: int) -> tuple[Record, np.ndarray, np.ndarray]:
    """Return two minutes of a device in hands, one that a bench calibrated within what motion leaves; A and b."""
    rng = np.random.default_rng(seed)
    motion = draw_task("free", rng=rng).at(np.arange(round(70 * RATE_HZ)) / RATE_HZ, STANDARD_GRAVITY)
    a, b = iron(rng)
    gyro, accel = motion.mean_rate_b, motion.force_b
    off = np.eye(3) + 2e-3 * (lambda x: 0.5 * (x + x.T))(rng.standard_normal((3, 3)))
    gyro = gyro @ off.T + np.radians(0.02) * rng.standard_normal(3) + np.radians(0.05) * rng.standard_normal(gyro.shape)
    accel = accel @ off.T + 0.05 * rng.standard_normal(3) + 0.05 * rng.standard_normal(accel.shape)
    return Record(time=motion.time, gyro=gyro, accel=accel, mag_ut=seen(rng, motion.time, motion.q_nb, a, b)), a, b


@pytest.mark.slow
@pytest.mark.parametrize("devices", [6, 100])
def test_intervals_hold_iron_turned_by_hand(devices: int) -> None:
    errors, spreads = [], []
    for seed in range(20, 20 + devices):
        record, a, b = worn(seed)
        magnetometer = calibrate_from_motion([record], magnetometer=True).magnetometer
        assert magnetometer is not None
        errors.append(
            np.concatenate(
                ((magnetometer.model.matrix - a).ravel(), magnetometer.model.offset - b, [magnetometer.lag_s - LAG_S])
            )
        )
        spreads.append(np.append(magnetometer.model.standard_uncertainty, magnetometer.lag_uncertainty_s))
    error, spread = np.array(errors), np.array(spreads)
    inside = np.abs(error) < 1.96 * spread
    for name, part, wanted in (("A", slice(0, 9), 0.01), ("b, uT", slice(9, 12), 0.5), ("lag, s", slice(12, 13), 2e-3)):
        rmse = float(np.sqrt((error[:, part] ** 2).mean()))
        ratio = rmse / float(np.sqrt((spread[:, part] ** 2).mean()))
        show(f"{name}: rmse; over stated; inside 95 %", (rmse, ratio, inside[:, part].mean()), wanted)
        assert rmse < wanted
        assert ratio < 1.3
    assert inside.sum() >= binom.ppf(0.001, inside.size, 0.90)


def test_a_magnet_that_comes_near_is_left_out_and_named() -> None:
    record, a, b = worn(30)
    mag = np.array(record.mag_ut)
    mag[1000:1700] += [12.0, -20.0, 9.0]  # 20 to 34 s
    calibration = calibrate_from_motion([replace(record, mag_ut=mag)], magnetometer=True)
    assert calibration.magnetometer is not None
    (finding,) = (item for item in calibration.verdict.findings if item.code == "magnetometer.disturbed")
    show("named", finding.text)
    assert float(finding.values["start_s"]) == pytest.approx(20.0, abs=1.5)
    assert float(finding.values["stop_s"]) == pytest.approx(34.0, abs=1.5)
    assert np.abs(calibration.magnetometer.model.offset - b).max() < 1.0
    assert np.abs(calibration.magnetometer.model.matrix - a).max() < 0.02
    wild = mag + 60.0 * np.sin(np.arange(len(mag))[:, None] ** 1.3 * [0.002, 0.003, 0.005])
    with pytest.raises(NotObservable, match="a field that"):
        calibrate_from_motion([replace(record, mag_ut=wild)], magnetometer=True)


@pytest.mark.slow
def test_recordings_with_a_slow_magnetometer_are_used() -> None:
    record, _, b = worn(30)
    mag = np.array(record.mag_ut)
    mag[1000:1700] += [12.0, -20.0, 9.0]
    mag[1::2] = np.nan
    alone = calibrate_from_motion([replace(worn(32)[0], mag_ut=None), replace(record, mag_ut=mag)], magnetometer=True)
    (finding,) = (item for item in alone.verdict.findings if item.code == "magnetometer.disturbed")
    assert finding.values["recording"] == 2
    assert alone.magnetometer is not None
    assert alone.gyro is not None
    assert np.abs(alone.magnetometer.model.offset - b).max() < 1.5
    plain = calibrate_from_motion([replace(worn(32)[0], mag_ut=None), replace(record, mag_ut=None)]).gyro
    assert plain is not None
    assert np.abs(alone.gyro.matrix - plain.matrix).max() > 1e-6  # the second direction was taken


@pytest.mark.slow
def test_axes_that_lie_otherwise_are_found() -> None:
    record, a, b = worn(31)
    other = np.array(
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
    )  # as in a part with another maker's magnetometer
    calibration = calibrate_from_motion(
        [replace(record, mag_ut=np.asarray(record.mag_ut) @ other.T)], magnetometer=True
    )
    assert calibration.magnetometer is not None
    assert np.abs(calibration.magnetometer.model.matrix @ other - a).max() < 0.02
    assert np.abs(calibration.magnetometer.model.offset - other @ b).max() < 1.0


def test_turns_about_the_vertical_hide_what_lies_along_it() -> None:
    rng, time = np.random.default_rng(3), np.arange(3000) / 50.0
    turn = np.cumsum(np.sin(0.3 * time)) / 50.0
    q = np.stack((np.cos(0.5 * turn), 0.0 * turn, 0.0 * turn, np.sin(0.5 * turn)), axis=1)
    magnetometer, findings = fit_magnetometer({0: (time, seen(rng, time, q, *iron(rng)), q)})
    (finding,) = (item for item in findings if item.code == "magnetometer.heading")
    show("named", finding.text)
    assert finding.values["axes"] == ("z",)
    assert finding.level == "warn"
    assert magnetometer.model.standard_uncertainty[11] > 5.0 * magnetometer.model.standard_uncertainty[9]


def test_recordings_too_short_for_a_magnetometer_are_refused() -> None:
    record, _, _ = worn(20)
    with pytest.raises(InputError, match="no recording has"):
        calibrate_from_motion([replace(record, mag_ut=None)], magnetometer=True)
    gone = np.array(record.mag_ut)
    gone[500:] = np.nan
    with pytest.raises(InputError, match=r"got 9.98 s"):
        calibrate_from_motion([replace(record, mag_ut=gone)], magnetometer=True)


@pytest.mark.slow
@needs_data
def test_two_trials_of_a_real_device_agree() -> None:
    """BROAD: device C twice; a magnet was attached to D for a minute of trial 32."""
    results = [calibrate_from_motion([trial(n)[0]], magnetometer=True).magnetometer for n in DEVICES["C"]]
    models = [result.model for result in results if result is not None]
    apart = [np.abs(models[0].matrix - models[1].matrix).max(), np.abs(models[0].offset - models[1].offset).max()]
    show("03 and 24: A, b (uT), lag (s)", (*apart, *(result.lag_s for result in results if result is not None)))
    assert apart[0] < 0.005
    assert apart[1] < 0.2
    assert all(result is not None and result.lag_s == pytest.approx(0.0128, abs=5e-4) for result in results)
    findings = calibrate_from_motion([trial("32")[0]], magnetometer=True).verdict.findings
    (magnet,) = (item for item in findings if item.code == "magnetometer.disturbed")
    assert float(magnet.values["percent"]) == pytest.approx(36.0, abs=3.0)
