"""One recording judged: known errors come out as known figures."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.broad import nominal_calibration
from scipy.spatial.transform import Rotation

from testkit.hand_turns import Device, hidden, later, make_recording
from undrift.errors import AlignmentError, InputError
from undrift.model import Calibration, TriadModel
from undrift.record import Record
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_trial
from undrift.validation.trial import TrialSettings, orientation_at, validate_trial

pytestmark = pytest.mark.usefixtures("computed_once")

FORWARD = np.array([[1.012, 0.006, -0.004], [-0.005, 0.991, 0.007], [0.003, -0.006, 1.004]])


def model(forward, offset):
    return TriadModel(
        method="known",
        unit_in="rad/s",
        unit_out="rad/s",
        matrix=np.linalg.inv(forward),
        offset=offset,
        covariance=np.zeros((12, 12)),
        rms_residual=0.0,
        count=1,
        rank=12,
        condition=1.0,
        valid_range=(-10.0, 10.0),
    )


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
    calibration = Calibration(device="", reference_temp_c=float("nan"), gravity_m_s2=9.81, gyro=model(FORWARD, offset))
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


def test_a_turned_case_is_aligned_and_reported():
    mounting = Rotation.from_euler("xyz", (90.0, 10.0, -40.0), degrees=True)
    record, reference = make_recording(np.random.default_rng(5), turn_s=30.0, mounting=mounting)
    trial = validate_trial(record, reference)
    assert trial.mounting is not None
    assert trial.mounting.applied
    assert trial.mounting.angle == pytest.approx(mounting.magnitude(), abs=1e-3)
    assert trial.figures.end_total_deg < 0.1


def test_a_small_mounting_stays_unless_asked_for():
    mounting = Rotation.from_euler("x", 2.0, degrees=True)
    record, reference = make_recording(np.random.default_rng(6), turn_s=30.0, mounting=mounting)
    trial = validate_trial(record, reference)
    assert trial.mounting is not None
    assert not trial.mounting.applied
    assert np.degrees(trial.mounting.angle) == pytest.approx(2.0, abs=0.05)
    asked = validate_trial(record, reference, settings=TrialSettings(align_above=0.0))
    assert asked.mounting is not None
    assert asked.mounting.applied
    assert asked.figures.end_total_deg < 0.1


def test_gaps_of_the_optics_count_nowhere_and_are_reported(perfect):
    record, reference = perfect
    figures = validate_trial(record, hidden(reference, 12.0, 18.0)).figures
    assert figures.valid_optics == pytest.approx(0.8, abs=0.001)
    assert np.isfinite(figures.rmse_total_deg)


@pytest.mark.slow
def test_truncated_codes_are_given_back_by_the_calibration():
    # Truncation toward zero takes half a step along the sign of the rate: 2.5e-3 rad/s of up to 2 rad/s.
    lsb = 5e-3
    record, reference = make_recording(np.random.default_rng(7), Device(noise=4e-3), turn_s=60.0, sample_rate_hz=400.0)
    codes = replace(record, gyro=np.trunc(record.gyro / lsb) * lsb)
    restored, left = (
        validate_trial(codes, reference, calibration=calibration) for calibration in (nominal_calibration(codes), None)
    )
    assert left.findings == ()
    assert restored.figures.end_total_deg < 0.7 * left.figures.end_total_deg


def test_the_series_of_a_trial_agree_with_its_figures(perfect):
    trial = validate_trial(*perfect, name="by hand")
    moving = trial.moving > 0.0
    assert trial.recording == "by hand"
    total = trial.error.total[moving]
    assert np.degrees(np.sqrt((total**2).mean())) == pytest.approx(trial.figures.rmse_total_deg)
    assert np.degrees(np.nanmax(np.abs(trial.error.pitch[moving]))) == pytest.approx(trial.figures.max_abs_pitch_deg)
    pitch = trial.sensor_pitch - trial.reference_pitch
    good = np.isfinite(pitch) & (np.abs(pitch) < 3.0)
    assert pitch[good] == pytest.approx(trial.error.pitch[good])


def test_a_record_without_accelerometer_starts_from_the_optics(perfect):
    record, reference = perfect
    bare = Record(time=record.time, gyro=record.gyro)
    assert validate_trial(bare, reference).figures.end_total_deg < 0.02


def test_what_cannot_be_judged_is_refused(perfect):
    record, reference = perfect
    with pytest.raises(InputError, match="gyroscope"):
        validate_trial(Record(time=record.time, accel=record.accel), reference)
    with pytest.raises(InputError, match="expected a physical unit, got count"):
        validate_trial(replace(record, gyro_unit="count"), reference)
    with pytest.raises(AlignmentError, match=r"no pose at rest from -2\.0 s to 7\.5 s"):
        validate_trial(record, hidden(reference, -1.0, 7.6))
    gyro = np.array(record.gyro)
    gyro[4000:4010] = np.nan
    with pytest.raises(InputError, match=r"got a gap \(NaN\) at 10 of 7699"):
        validate_trial(replace(record, gyro=gyro), reference)


def test_a_track_is_read_between_its_samples():
    q = Rotation.from_euler("z", [[0.0], [10.0], [30.0]], degrees=True).as_quat(scalar_first=True)
    at = orientation_at(np.array([0.0, 1.0, 2.0]), q, np.array([-0.1, 0.5, 1.25, 2.0, 2.1]))
    assert np.isnan(at[[0, 4]]).all()
    turned = Rotation.from_quat(at[1:4], scalar_first=True).as_euler("zyx", degrees=True)[:, 0]
    assert turned == pytest.approx([5.0, 15.0, 30.0])


def test_turning_about_one_axis_is_judged_without_a_mounting():
    rng = np.random.default_rng(1)
    device = random_device(rng, grade="wearable")
    trial = simulate_trial("sit_to_stand", device, rng=rng)
    assert validate_trial(trial.record, trial.reference).mounting is None


def test_the_share_of_the_samples_in_which_pitch_is_defined_is_told(perfect):
    (record, reference), shares = perfect, []
    for forward, up in (("+x", "+z"), ("+y", "+z"), ("+x", "+y")):
        trial = validate_trial(record, reference, settings=TrialSettings(forward=forward, up=up))
        side = ({"x", "y", "z"} - {forward[1], up[1]}).pop()
        lateral = Rotation.from_quat(reference.q_nb, scalar_first=True).as_matrix()[:, 2, "xyz".index(side)]
        moving, seen = trial.moving > 0.0, np.isfinite(trial.error.total)
        inside = np.abs(lateral) < np.cos(np.radians(5.0))
        share = float(inside[moving & seen].mean())
        # sensor and reference, 0.02 deg apart, need not cross the edge at the very same one of 3000 samples
        assert trial.figures.pitch_defined == pytest.approx(share, abs=1e-3)
        assert trial.figures.pitch_defined == np.isfinite(trial.error.pitch[moving & seen]).mean()
        shares.append(share)
    assert min(shares) < 0.998  # it tumbles: the tolerance does not hide that
    upright = validate_trial(*make_recording(np.random.default_rng(2), turn_s=20.0, speed=0.05, tilt=0.0)).figures
    assert upright.pitch_defined == 1.0


def test_a_rest_without_a_specific_force_is_refused(perfect):
    record, reference = perfect
    start_s = validate_trial(record, reference).motion.start_s
    accel = record.accel.copy()
    accel[record.time < start_s] = np.nan
    with pytest.raises(InputError, match=r"at rest before .* s has only gaps"):
        validate_trial(replace(record, accel=accel), reference)


# ---- recordings that begin and end in motion


@pytest.mark.parametrize("start_s", [0.0, 3.0])
def test_a_recording_without_a_rest_starts_from_the_reference(start_s):
    record, reference = make_recording(np.random.default_rng(5), Device(noise=1e-4), mark=False)
    found = validate_trial(record.between(9.0, 66.0), later(reference, start_s))
    assert not found.motion.rested
    assert "validate.no_rest" in [one.code for one in found.findings]
    # A poor start would leave 0.3 deg. A lag of 3 s is removed; half a sample is left in.
    assert found.figures.rmse_total_deg < (0.03 if start_s else 0.3)
    assert found.figures.end_total_deg < 0.3  # of the last three seconds of the motion, half a sample late
