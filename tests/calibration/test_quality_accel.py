"""Rests that an accelerometer's fit did not use: real poses stated as faces are refused, and good faces pass."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from testkit.data import data_path
from testkit.findings import codes, only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.settings import CalibrateSettings
from undrift.record import FACES, Record, Session, Still
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.sessions import simulate_session

# Poses of two MPU-9150 boards of Mikov et al. (ICINS 2020), turned by hand: pairs of poses whose means share a middle, so that they
# fit six faces to within half a degree. None of them is a face, and the scale factors stay within the unit's tolerance.
NO_FACES = {
    0: ((15008, 15841), (106, 654), (8036, 8377), (4477, 4976), (913, 1222), (14273, 14848)),
    1: ((105, 652), (14972, 15802), (10026, 10513), (6613, 7109), (910, 1219), (14239, 14812)),
}
PLAIN = CalibrateSettings(identify_adc=False)


def board(unit: int) -> Record:
    with gzip.open(data_path("multipos_mpu9150", f"imu{unit}.log.gz"), "rt") as file:
        log = np.loadtxt(file)
    return Record(time=np.arange(len(log)) / 100.0, accel=log[:, :3], gyro=log[:, 3:])


@pytest.mark.parametrize("unit", NO_FACES)
def test_poses_that_are_no_faces_are_bad_though_they_fit_as_faces(unit):
    order = ("+x", "-x", "+y", "-y", "+z", "-z")
    stills = tuple(Still(start=a, stop=b, face=f) for f, (a, b) in zip(order, NO_FACES[unit], strict=True))
    session = Session(kind="calibration", serial="", gravity_m_s2=9.81, records=(board(unit),), stills=stills)
    made = calibrate(session)
    assert made.verdict.status == "bad"
    tilt = [item.values["tilt_deg"] for item in made.verdict.findings if item.code.startswith("six_face.tilt")]
    assert max(tilt, default=0.0) < 0.5  # the six faces themselves show nothing
    missed, askew = (item for item in made.verdict.findings if item.code == "accel.implausible")
    missed, askew = (missed, askew) if "stills" in missed.values else (askew, missed)
    assert (askew.level, askew.values["angle_deg"] > 30.0) == ("fail", True)
    assert missed.level == "fail"
    assert missed.values["stills"] >= 14  # SOURCE: 17-18 standstills and more short ones; six are the fit's
    assert missed.values["beyond"] >= 0.9 * missed.values["stills"]
    assert missed.values["rms_m_s2"] > 3.0


@pytest.mark.parametrize("unit", [0, 1, 2])
def test_all_poses_of_the_same_boards_are_good(unit):
    made = calibrate(Session(kind="calibration", serial="", gravity_m_s2=9.81, records=(board(unit),)))
    assert made.verdict.status == "good"


def faces_then_poses(seed: int, **bench) -> Session:
    """Return one recording of six faces, stated, and ten free poses behind them, not stated."""
    rng = np.random.default_rng(seed)
    device = random_device(rng)
    settings = BenchSettings(sample_rate_hz=50.0, still_s=4.0, first_still_s=4.0, poses=10, **bench)
    faces = simulate_session("six_face", device, rng=rng, settings=settings)
    poses = simulate_session("multi_position", device, rng=rng, settings=settings)
    one, two = faces.records[0], poses.records[0]
    joined = Record(
        time=np.arange(len(one) + len(two)) / 50.0,
        gyro=np.vstack((one.gyro, two.gyro)),
        accel=np.vstack((one.accel, two.accel)),
        gyro_unit=one.gyro_unit,
        accel_unit=one.accel_unit,
    )
    return replace(faces, records=(joined,))


@pytest.mark.slow
def test_good_faces_agree_with_poses_that_were_not_stated():
    found = [codes(calibrate(faces_then_poses(seed), settings=PLAIN).verdict.findings) for seed in range(8)]
    assert not [code for one in found for code in one if code.startswith("accel.")]


def test_tilted_faces_agree_with_other_poses_within_their_stated_uncertainty():
    sessions = [faces_then_poses(seed, errors=BenchErrors(face_tilt=np.radians(0.5))) for seed in range(8)]
    found = [codes(calibrate(session, settings=PLAIN).verdict.findings) for session in sessions]
    assert sum("accel.implausible" in one for one in found) == 0  # 1 in 1,000 each by chance


def test_one_rest_that_misses_is_a_warning_and_two_are_a_failure():
    session = faces_then_poses(3)
    own = session.stills[-1].stop
    record = session.records[0]
    for moved, level in ((1, "warn"), (2, "fail")):
        accel = np.array(record.accel)
        for k in range(moved):  # as if the device had fallen or been carried: 0.1 g more in one pose
            start = own + 50 * (2 + 6 * k)
            accel[start - 100 : start + 250] *= 1.1
        found = calibrate(replace(session, records=(replace(record, accel=accel),)), settings=PLAIN).verdict.findings
        assert only(found, "accel.implausible").level == level


def test_rests_at_another_temperature_and_labels_that_are_used_do_not_count():
    session = faces_then_poses(3)
    record, own = session.records[0], session.stills[-1].stop
    accel = np.array(record.accel)
    accel[own:] *= 1.1
    away = replace(record, accel=accel)
    assert "accel.implausible" in codes(calibrate(replace(session, records=(away,)), settings=PLAIN).verdict.findings)
    temp_c = np.where(np.arange(len(record)) < own, 25.0, 35.0)
    warm = replace(session, records=(replace(away, temp_c=temp_c),))
    assert "accel.implausible" not in codes(calibrate(warm, settings=PLAIN).verdict.findings)


def test_an_axis_five_degrees_off_the_case_is_bad():
    rng = np.random.default_rng(4)
    device = random_device(rng)
    for angle_deg, status in ((3.0, True), (7.0, False)):
        angle = np.radians(angle_deg)
        axes = np.eye(3)
        axes[0, :2] = np.cos(angle), np.sin(angle)
        accel = replace(device.accel, scale=replace(device.accel.scale, axes=axes))
        session = simulate_session("six_face", replace(device, accel=accel), rng=rng)
        found = calibrate(session, settings=PLAIN).verdict.findings
        assert ("accel.implausible" not in codes(found)) == status
        if not status:
            assert only(found, "accel.implausible").values["angle_deg"] == pytest.approx(7.0, abs=0.1)
    assert set(FACES) == {s.face for s in session.stills}
