"""One recording judged: definitions of the errors, mounting, and known errors that come out as known figures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.hand_turns import Device, hidden, later, make_recording
from testkit.plain_triad import plain_triad
from undrift.errors import AlignmentError, InputError
from undrift.model import Calibration
from undrift.record import Record, Reference
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_trial
from undrift.validation.align import rotation_by_rates
from undrift.validation.trial import (
    TrialSettings,
    compare_orientations,
    of_finite,
    orientation_at,
    rms,
    validate_trial,
)


def quaternions(r):
    return r.as_quat(scalar_first=True)


def test_a_turn_about_the_vertical_is_heading_alone():
    true = Rotation.random(50, rng=np.random.default_rng(0))
    wrong = Rotation.from_euler("z", -12.0, degrees=True) * true
    error = compare_orientations(quaternions(wrong), quaternions(true))
    assert np.degrees(error.heading) == pytest.approx(np.full(50, -12.0))
    assert np.degrees(error.total) == pytest.approx(np.full(50, 12.0))
    assert np.abs(error.inclination).max() < 1e-7
    assert np.nanmax(np.abs(error.pitch)) < 1e-9


def test_a_turn_about_a_level_axis_is_inclination_alone():
    true = Rotation.random(50, rng=np.random.default_rng(1))
    wrong = Rotation.from_rotvec(np.radians(7.0) * np.array([0.6, -0.8, 0.0])) * true
    error = compare_orientations(quaternions(wrong), quaternions(true))
    assert np.degrees(error.inclination) == pytest.approx(np.full(50, 7.0))
    assert np.abs(error.heading).max() < 1e-7


def test_a_pitch_error_has_its_sign_and_follows_the_axes_given():
    true = Rotation.from_euler("y", [[10.0], [-20.0], [35.0]], degrees=True)
    wrong = Rotation.from_euler("y", [[12.0], [-21.0], [35.5]], degrees=True)
    error = compare_orientations(quaternions(wrong), quaternions(true))
    assert np.degrees(error.pitch) == pytest.approx([2.0, -1.0, 0.5])
    backward = compare_orientations(quaternions(wrong), quaternions(true), forward="-x")
    assert np.degrees(backward.pitch) == pytest.approx([-2.0, 1.0, -0.5])


def test_gaps_count_nowhere():
    assert rms(np.array([3.0, np.nan, 4.0])) == pytest.approx(np.sqrt(12.5))
    assert of_finite(np.median, np.array([1.0, np.nan, 3.0])) == 2.0
    assert np.isnan(rms(np.array([np.nan])))


def test_one_axis_of_turning_does_not_tell_a_mounting():
    t = np.arange(0.0, 30.0, 0.01)
    angle = np.sin(t)
    q = Rotation.from_rotvec(angle[:, None] * (0.0, 1.0, 0.0)).as_quat(scalar_first=True)
    record = Record(time=t, gyro=np.cos(t)[:, None] * np.array([0.0, 1.0, 0.0]))
    with pytest.raises(AlignmentError, match="about one axis only"):
        rotation_by_rates(record, Reference(time=t, q_nb=q), lag_s=0.0)
    device = random_device(np.random.default_rng(1), grade="wearable")
    trial = simulate_trial("sit_to_stand", device, rng=np.random.default_rng(1))
    assert validate_trial(trial.record, trial.reference).mounting is None


def test_a_reversed_axis_is_a_reflection():
    record, reference = make_recording(np.random.default_rng(2), turn_s=20.0)
    mirrored = replace(record, gyro=record.gyro * np.array([1.0, 1.0, -1.0]))
    with pytest.raises(AlignmentError, match="is a reflection"):
        rotation_by_rates(mirrored, reference, lag_s=0.0)


pytestmark = pytest.mark.usefixtures("computed_once")
FORWARD = np.array([[1.012, 0.006, -0.004], [-0.005, 0.991, 0.007], [0.003, -0.006, 1.004]])


@pytest.fixture(scope="module")
def perfect():
    return make_recording(np.random.default_rng(1), turn_s=30.0)


def test_a_perfect_device_has_no_error(perfect):
    figures = validate_trial(*perfect).figures
    # Straight lines between samples of 5 ms: rate steps of 0.03 rad/s leave some 1e-4 rad of coning in 30 s.
    assert figures.end_total_deg < 0.02
    assert (
        validate_trial(perfect[0], later(perfect[1], -1.0)).figures.rmse_total_deg < 0.02
    )  # with the half sample removed
    assert figures.rmse_inclination_deg < 0.5  # half a sample at up to 3 rad/s while moving: the lag is left in
    assert figures.valid_optics == 1.0
    assert figures.motion_s == pytest.approx(30.0, abs=0.02)
    assert figures.lag_ms == pytest.approx(0.0, abs=0.01)


def test_an_offset_shows_as_drift_and_rest_takes_it_out():
    device = Device(offset=np.radians([0.0, 0.0, 0.1]), noise=1e-4)  # without noise nothing tells a rest
    record, reference = make_recording(np.random.default_rng(2), device, turn_s=60.0, speed=0.05, tilt=0.0)
    raw = validate_trial(record, reference).figures
    # 0.1 deg/s about a nearly vertical axis: 6 deg in a minute of motion, and half a second before it.
    assert raw.end_total_deg == pytest.approx(6.2, abs=0.2)
    assert raw.rmse_heading_deg == pytest.approx(6.0 / np.sqrt(3.0), abs=0.2)
    rest = validate_trial(record, reference, settings=TrialSettings(offset="rest")).figures
    assert rest.end_total_deg < 0.02


def test_a_calibration_is_applied():
    offset = np.array([0.01, -0.02, 0.005])
    record, reference = make_recording(np.random.default_rng(3), Device(forward=FORWARD, offset=offset), turn_s=40.0)
    calibration = Calibration(
        device="",
        reference_temp_c=float("nan"),
        gravity_m_s2=9.81,
        gyro=replace(plain_triad("rad/s", "rad/s"), matrix=np.linalg.inv(FORWARD), offset=offset),
    )
    raw, corrected = (validate_trial(record, reference, calibration=c).figures for c in (None, calibration))
    assert raw.end_total_deg > 5.0
    assert corrected.end_total_deg < 0.02


def test_a_long_lag_is_undone_and_a_short_one_is_left_in():
    record, reference = make_recording(np.random.default_rng(4), Device(lag_s=0.006), turn_s=30.0)
    short = validate_trial(record, reference)
    assert not short.lag_undone
    assert short.figures.rmse_total_deg > 0.05
    long = validate_trial(record, later(reference, -1.7))
    assert long.lag_undone
    assert long.figures.rmse_total_deg < 0.05
    assert long.figures.end_total_deg < 0.02


@pytest.mark.parametrize(
    ("angles_deg", "above_deg", "applied"),
    [((90.0, 10.0, -40.0), 5.0, True), ((2.0, 0.0, 0.0), 5.0, False), ((2.0, 0.0, 0.0), 0.0, True)],
)
def test_a_mounting_is_reported_and_removed_if_it_exceeds_the_limit(angles_deg, above_deg, applied):
    mounting = Rotation.from_euler("xyz", angles_deg, degrees=True)
    record, reference = make_recording(np.random.default_rng(5), turn_s=30.0, mounting=mounting)
    trial = validate_trial(record, reference, settings=TrialSettings(align_above=np.radians(above_deg)))
    assert trial.mounting.applied is applied
    assert trial.mounting.angle == pytest.approx(mounting.magnitude(), abs=1e-3)
    assert (trial.figures.end_total_deg < 0.1) is applied


def test_gaps_of_the_optics_count_nowhere_and_are_reported(perfect):
    record, reference = perfect
    figures = validate_trial(record, hidden(reference, 12.0, 18.0)).figures
    assert figures.valid_optics == pytest.approx(0.8, abs=0.001)
    assert np.isfinite(figures.rmse_total_deg)


def test_a_record_without_accelerometer_starts_from_the_optics(perfect):
    record, reference = perfect
    bare = Record(time=record.time, gyro=record.gyro)
    assert validate_trial(bare, reference).figures.end_total_deg < 0.02


def test_what_cannot_be_judged_is_refused(perfect):
    record, reference = perfect
    gyro, accel = np.array(record.gyro), np.array(record.accel)
    gyro[4000:4010], accel[record.time < 9.0] = np.nan, np.nan
    for broken, poses, message in (
        (Record(time=record.time, accel=record.accel), reference, "gyroscope"),
        (replace(record, gyro_unit="count"), reference, "expected a physical unit, got count"),
        (record, hidden(reference, -1.0, 7.6), r"no pose at rest from -2\.0 s to 7\.5 s"),
        (replace(record, gyro=gyro), reference, r"got a gap \(NaN\) at 10 of 7699"),
        (replace(record, accel=accel), reference, r"at rest before .* s has only gaps"),
    ):
        with pytest.raises((InputError, AlignmentError), match=message):
            validate_trial(broken, poses)


def test_a_track_is_read_between_its_samples():
    q = Rotation.from_euler("z", [[0.0], [10.0], [30.0]], degrees=True).as_quat(scalar_first=True)
    at = orientation_at(np.array([0.0, 1.0, 2.0]), q, np.array([-0.1, 0.5, 1.25, 2.0, 2.1]))
    assert np.isnan(at[[0, 4]]).all()
    turned = Rotation.from_quat(at[1:4], scalar_first=True).as_euler("zyx", degrees=True)[:, 0]
    assert turned == pytest.approx([5.0, 15.0, 30.0])


@pytest.mark.parametrize("start_s", [0.0, 3.0])
def test_a_recording_without_a_rest_starts_from_the_reference(start_s):
    record, reference = make_recording(np.random.default_rng(5), Device(noise=1e-4), mark=False)
    found = validate_trial(record.between(9.0, 66.0), later(reference, start_s))
    assert not found.motion.rested
    assert "validate.no_rest" in [one.code for one in found.findings]
    # A poor start would leave 0.3 deg. A lag of 3 s is removed; half a sample is left in.
    assert found.figures.rmse_total_deg < (0.03 if start_s else 0.3)
    assert found.figures.end_total_deg < 0.3  # of the last three seconds of the motion, half a sample late
