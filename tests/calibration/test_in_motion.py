"""Both triads from motion alone: intervals hold on simulated hands, what the motion hides is named, real devices are told right."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.in_motion import pairs
from scipy.stats import binom

from testkit.broad_trials import trial
from testkit.data import needs_data, show
from undrift.calibration.calibrate import calibrate, calibrate_from_motion
from undrift.calibration.in_motion import InMotion, fit_in_motion
from undrift.errors import Implausible, InputError, NotObservable
from undrift.model import Calibration
from undrift.record import Record
from undrift.segments import find_still
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.tasks import draw_task
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.trial import validate_trial

RATE_HZ = 50.0
# by the data sheet of the consumer device: 65.5 or 131 codes per deg/s, 4096 codes per g
NOMINAL_RATES = RADIAN_PER_DEGREE / np.array([16.4, 32.8, 65.5, 131.0])
NOMINAL_FORCES = STANDARD_GRAVITY / np.array([2048.0, 4096.0, 8192.0, 16384.0])


def nearest(values: np.ndarray, one: float) -> float:
    return float(values[np.argmin(np.abs(np.log(values / one)))])


def handled(seed: int, recordings: int = 3) -> tuple[list[Record], Calibration, tuple[float, float]]:
    """Return recordings of a raw device in hands, in units by its data sheet; its true calibration, of codes; these units."""
    rng = np.random.default_rng(seed)
    device = random_device(rng, grade="consumer")
    true = true_calibration(device, temp_c=25.0)
    assert true.gyro is not None
    assert true.accel is not None
    units = (
        nearest(NOMINAL_RATES, float(np.trace(true.gyro.matrix)) / 3.0),
        nearest(NOMINAL_FORCES, float(np.trace(true.accel.matrix)) / 3.0),
    )
    records = []
    for _ in range(recordings):
        task = draw_task("free", rng=rng)
        motion = task.at(np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ, STANDARD_GRAVITY)
        record = simulate_device(device, motion, rng=rng).record
        gyro, accel = np.asarray(record.gyro) * units[0], np.asarray(record.accel) * units[1]
        records.append(replace(record, gyro=gyro, accel=accel, gyro_unit="rad/s", accel_unit="m/s2"))
    return records, true, units


SCALE, PAIRS = [0, 4, 8], [(1, 3), (2, 6), (5, 7)]
SEEN = np.zeros(
    (6, 9)
)  # what the lie of the case does not touch: scale factors, and the symmetric part of the cross-axis terms
SEEN[range(3), SCALE] = 1.0
for _row, _pair in enumerate(PAIRS, 3):
    SEEN[_row, list(_pair)] = 0.5


def errors_of(fit: InMotion, true: Calibration, units: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of what motion shows of both triads and the accelerometers' offsets, and their standard uncertainties."""
    assert true.gyro is not None
    assert true.accel is not None
    errors, spreads = [], []
    for result, right, unit in ((fit.gyro.model, true.gyro, units[0]), (fit.accel.model, true.accel, units[1])):
        errors.append(SEEN @ (result.matrix - right.matrix / unit).ravel())
        spreads.append(np.sqrt(np.diag(SEEN @ result.covariance[:9, :9] @ SEEN.T)))
    errors.append(fit.accel.model.offset - true.accel.offset * units[1])
    spreads.append(fit.accel.model.standard_uncertainty[9:])
    return np.concatenate(errors), np.concatenate(spreads)


@pytest.mark.slow
@pytest.mark.parametrize("devices", [16, 100])
def test_intervals_hold_raw_devices_turned_by_hand(devices: int) -> None:
    results = [
        errors_of(fit_in_motion(records), true, units) for records, true, units in map(handled, range(70, 70 + devices))
    ]
    error, spread = (np.array(item) for item in zip(*results, strict=True))
    inside = np.abs(error) < 1.96 * spread
    kinds = ("gyroscopes' scale", "cross-axis", "accelerometers' scale", "cross-axis", "offset, m/s2")
    for name, part in zip(kinds, np.arange(15).reshape(5, 3), strict=True):
        rms = [float(np.sqrt((item[:, part] ** 2).mean())) for item in (error, spread)]
        show(f"{name}: rmse; over stated; inside 95 %", (rms[0], rms[0] / rms[1], inside[:, part].mean()))
    for name, part, wanted in (("gyroscopes", slice(0, 6), 0.0015), ("accelerometers", slice(6, 12), 0.005)):
        rmse = float(np.sqrt((error[:, part] ** 2).mean()))
        ratio = rmse / float(np.sqrt((spread[:, part] ** 2).mean()))
        show(f"{name}: rmse of the matrix; over stated; inside 95 %", (rmse, ratio, inside[:, part].mean()), wanted)
        assert rmse < wanted
        assert ratio < 1.4
    assert inside.sum() >= binom.ppf(0.001, inside.size, 0.90)


@pytest.mark.slow
def test_the_lie_of_the_case_is_not_seen_and_keeps_its_prior() -> None:
    (records, _, _), turn = handled(70), np.radians(0.2)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    turned = [replace(r, gyro=np.asarray(r.gyro) @ rotation.T, accel=np.asarray(r.accel) @ rotation.T) for r in records]
    one, other = (fit_in_motion(item).gyro.model for item in (records, turned))
    back = one.matrix @ rotation.T  # what fits the turned readings as well
    lean = (other.matrix - back)[0, 1] - (other.matrix - back)[1, 0]
    np.testing.assert_allclose(SEEN @ (other.matrix - back).ravel(), 0.0, atol=3e-4)
    assert lean == pytest.approx(-2.0 * turn, rel=0.15)  # the prior draws the axes back to those of the readings


def test_rest_that_the_motion_contradicts_counts_less() -> None:
    records, _, _ = handled(71, recordings=1)
    gyro = np.array(records[0].gyro)
    for still in find_still(records[0]).stills:
        gyro[still.start : still.stop] += 0.4 * RADIAN_PER_DEGREE
    sound, contradicted = (fit_in_motion([record]) for record in (records[0], replace(records[0], gyro=gyro)))
    wider = contradicted.offset_uncertainty[0] / sound.offset_uncertainty[0]
    show(
        "uncertainty of the offset with a rest that is 0.4 deg/s off, over that with a sound one",
        wider.tolist(),
        "2 or more",
    )
    assert wider.min() > 2.0
    codes = [[item.code for item in fit.gyro.verdict.findings] for fit in (sound, contradicted)]
    assert ["motion.rest" in found for found in codes] == [False, True]


def test_accelerometer_offset_beyond_data_sheets_is_named() -> None:
    records, _, _ = handled(71, recordings=1)
    shifted = replace(records[0], accel=np.asarray(records[0].accel) + np.array([0.0, 0.0, 1.5]))
    codes = [[item.code for item in fit_in_motion([r]).gyro.verdict.findings] for r in (records[0], shifted)]
    assert ["motion.accel_offset" in found for found in codes] == [False, True]


@needs_data
def test_rows_that_pad_a_file_are_no_rest() -> None:
    record = pairs("chain")[0][0].between(3.0, 55.0)  # begins and ends in motion
    time = np.append(record.time, record.time[-1] + np.arange(1, 121) / 40.0)
    gyro, accel = (np.vstack((entry, np.repeat(entry[-1:], 120, axis=0))) for entry in (record.gyro, record.accel))
    plain, filled = (calibrate_from_motion([one]) for one in (record, Record(time=time, gyro=gyro, accel=accel)))
    assert plain.gyro is not None
    assert filled.gyro is not None
    np.testing.assert_allclose(filled.gyro.offset, plain.gyro.offset, rtol=0, atol=1e-9)
    np.testing.assert_allclose(filled.gyro.matrix, plain.gyro.matrix, rtol=0, atol=1e-9)
    assert "recording.padded" in [item.code for item in filled.verdict.findings]


@needs_data
def test_scale_far_from_its_unit_is_named() -> None:
    record, _ = pairs("chain")[0]
    with pytest.raises(Implausible, match="acceleration remain"):
        fit_in_motion([replace(record, gyro=np.asarray(record.gyro)[:, [1, 0, 2]])])
    off = fit_in_motion([replace(record, gyro=1.1 * np.asarray(record.gyro))])
    (finding,) = [item for item in off.gyro.verdict.findings if item.code == "motion.scale"]
    assert "gyroscope scale" in finding.text
    assert off.gyro.verdict.status == "marginal"


@pytest.mark.slow
@needs_data
def test_real_segment_ends_within_two_degrees() -> None:
    trials, ends = pairs("chain"), []
    for record, reference in trials:
        (other,) = [entry for entry, _ in trials if entry is not record]
        calibration = calibrate_from_motion([other])
        judged = [validate_trial(record, reference, calibration=item).figures for item in (None, calibration)]
        ends.append([(item.end_total_deg, item.end_inclination_deg) for item in judged])
    before, after = np.mean(ends, axis=0).round(2)
    show("end total and inclination of 66 s in motion, deg: before, after", (before.tolist(), after.tolist()), 2.0)
    assert before[0] > 40.0
    assert after[0] < 2.0
    assert after[1] < 0.5


def about_y() -> Record:
    """Return a device that turns to and fro about y, with stops."""
    time, rng = np.arange(3000) / 50.0, np.random.default_rng(2)
    angle = 1.5 * np.tanh(4.0 * np.sin(0.35 * time))
    gyro = np.gradient(angle, time)[:, None] * [0.0, 1.0, 0.0] + 1e-3 * rng.standard_normal((3000, 3))
    force = np.column_stack((-np.sin(angle), np.zeros(3000), np.cos(angle))) * STANDARD_GRAVITY
    return Record(time=time, gyro=gyro, accel=force + 0.05 * rng.standard_normal((3000, 3)))


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda record: about_y(), NotObservable, "one axis"),
        (lambda record: replace(record, gyro=1.35 * record.gyro), Implausible, "scale factor"),
        (lambda record: replace(record, accel=1.8 * record.accel), Implausible, "scale factor"),
        (lambda record: replace(record, gyro=None), InputError, "are needed"),
        (lambda record: replace(record, state="corrected"), InputError, "raw readings"),
        (lambda record: replace(record, gyro_unit="count"), InputError, "in count"),
        (lambda record: record.between(0.0, 5.01), InputError, "got 5 s"),
        (lambda record: replace(record, gyro=np.zeros_like(record.gyro)), NotObservable, "not turned"),
    ],
)
def test_recordings_that_motion_cannot_use_are_refused(change, error, words) -> None:
    with pytest.raises(error, match=words):
        calibrate_from_motion([change(handled(70, 1)[0][0])])


@needs_data
def test_calibrate_offers_motion_for_a_recording_without_a_rest() -> None:
    record, _ = trial(7)
    with pytest.raises(NotObservable, match="--from motion"):
        calibrate(record.part(11_440, 20_020))


def test_gap_in_the_rates_is_refused() -> None:
    record = handled(70, 1)[0][0]
    gyro = np.array(record.gyro)
    gyro[7] = np.nan
    with pytest.raises(InputError, match="got 1 gaps"):
        fit_in_motion([replace(record, gyro=gyro)])
