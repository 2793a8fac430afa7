"""Rests and turns of a session: refused or named if they are not what it states."""

import re
from dataclasses import replace

import numpy as np
import pytest

from testkit.findings import codes, only
from testkit.plain_triad import plain_triad
from testkit.recordings import mpu9150
from testkit.strategies import one_line
from undrift.calibration.calibrate import calibrate
from undrift.calibration.quality import check_accel, check_turns
from undrift.calibration.session import observe
from undrift.calibration.settings import CalibrateSettings
from undrift.errors import Implausible, InputError
from undrift.record import FACES, Record, Session, Still
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.sessions import simulate_session
from undrift.units import RADIAN_PER_DEGREE

# ---- stillness: a stated still must rest, and nothing counts twice

RATE = 100.0
HOLD = 600  # samples of each face


def faces(creep_dps=0.0, *, unit="rad/s", accel_unit="m/s2", sway=None):
    """Six faces of 6 s each; every one turns at creep_dps about a horizontal axis."""
    rng = np.random.default_rng(31)
    accel, gyro, stills = [], [], []
    seconds = np.arange(HOLD) / RATE
    for number, face in enumerate(FACES):
        up = np.zeros(3)
        up["xyz".index(face[1])] = 1.0 if face[0] == "+" else -1.0
        side = np.roll(up, 1)
        angle = creep_dps * RADIAN_PER_DEGREE * seconds[:, None]
        accel.append(9.81 * (np.cos(angle) * up + np.sin(angle) * side))
        gyro.append(np.tile(np.cross(side, up) * creep_dps * RADIAN_PER_DEGREE, (HOLD, 1)))
        stills.append(Still(start=number * HOLD, stop=(number + 1) * HOLD, face=face))
    gyro = np.vstack(gyro) + [0.01, -0.02, 0.015] + 0.002 * rng.standard_normal((6 * HOLD, 3))
    accel = np.vstack(accel) + [0.2, -0.1, 0.1] + 0.02 * rng.standard_normal((6 * HOLD, 3))
    if sway is not None:
        number, size = sway
        gyro[number * HOLD : number * HOLD + 200] += size * np.sin(2.0 * np.pi * 2.0 * seconds[:200, None])
    record = Record(
        time=np.arange(6 * HOLD) / RATE,
        gyro=gyro if unit == "rad/s" else gyro / RADIAN_PER_DEGREE * (1.0 if unit == "dps" else 16.4),
        accel=accel * (1.0 if accel_unit == "m/s2" else 400.0),
        gyro_unit=unit,
        accel_unit=accel_unit,
    )
    return Session(kind="calibration", serial="", gravity_m_s2=9.81, records=(record,), stills=tuple(stills))


def test_six_faces_at_rest_pass_without_a_word():
    assert observe(faces(), CalibrateSettings()).findings == ()
    assert observe(faces(unit="count", accel_unit="count"), CalibrateSettings()).findings == ()


def test_stills_that_creep_a_little_are_a_finding():
    calibration = calibrate(faces(0.25))  # 1.5 deg in 6 s, the limit is 1 deg
    assert calibration.verdict.status == "marginal"
    sway = only(calibration.verdict.findings, "session.piece")
    assert sway.values["pieces"] == 6
    size = float(re.search(r"sway by ([\d.]+) m/s2", sway.sentence).group(1))
    assert size == pytest.approx(9.81 * np.radians(1.5) / np.sqrt(12.0), rel=0.05)


@pytest.mark.parametrize(("unit", "accel_unit"), [("rad/s", "m/s2"), ("dps", "m/s2"), ("count", "count")])
def test_still_that_begins_too_early_is_refused_by_its_sway(unit, accel_unit):
    session = faces(unit=unit, accel_unit=accel_unit, sway=(2, 0.5))
    with pytest.raises(Implausible, match=r"12\.0-18\.0 s.* sway by"):
        observe(session, CalibrateSettings())


def test_slow_turn_about_the_vertical_shows_in_the_mean_rate():
    session = faces()
    gyro = np.array(session.records[0].gyro)
    gyro[HOLD : 2 * HOLD, 0] += 3.0 * RADIAN_PER_DEGREE
    turning = replace(session, records=(replace(session.records[0], gyro=gyro),))
    with pytest.raises(Implausible, match="a mean rate 3"):
        observe(turning, CalibrateSettings())
    thermal = replace(turning, kind="thermal")  # offsets differ between temperatures, and that is what it records
    assert observe(thermal, CalibrateSettings()).findings == ()


def test_the_same_recording_twice_is_refused():
    session = faces()
    twice = replace(session, records=session.records * 2)
    with pytest.raises(InputError, match="0 and 1 contain the same data") as caught:
        observe(twice, CalibrateSettings())
    one_line(caught)
    other = replace(session.records[0], gyro=session.records[0].gyro + 1e-4)
    assert len(observe(replace(session, records=(session.records[0], other)), CalibrateSettings()).stills) == 6


# ---- a stated turn that stops, sways or is cut off is named; sound ones are not


def made(kind: str) -> Session:
    return simulate_session(kind, random_device(np.random.default_rng(3)), rng=np.random.default_rng(4))


def shifted(session: Session, samples: int, *, which: int | None = None) -> Session:
    end = len(session.records[0])
    turns = tuple(
        replace(t, start=t.start + samples, stop=min(t.stop + samples, end)) if which in (None, k) else t
        for k, t in enumerate(session.turns)
    )
    return replace(session, turns=turns)


@pytest.mark.parametrize("kind", ["bench", "ferraris"])
def test_sound_turns_with_a_short_ramp_give_no_finding(kind: str) -> None:
    session = made(kind)
    assert list(check_turns(session, session.stills, 0.3)) == []
    assert list(check_turns(shifted(session, 10), session.stills, 0.3)) == []


def test_a_dwell_that_overlaps_a_stop_is_named_with_the_share() -> None:
    session = shifted(made("bench"), 90, which=70)  # 0.9 s late: the table brakes and stands still at its end
    stop = only(check_turns(session, session.stills, 0.3), "session.piece")
    assert stop.level == "fail"
    assert "overlaps a stop" in stop.sentence
    assert str(stop.values["piece"]).startswith("[[turn]] 71 (recording 0, ")
    assert stop.values["pieces"] == 1
    assert 23.0 < float(stop.values["percent"]) < 75.0  # a stop in a third of a dwell, at most, varies by 71 %


def test_a_rate_that_sways_is_named_with_its_spread() -> None:
    session = made("bench")
    record, turn = session.records[0], session.turns[40]
    assert record.gyro is not None
    axis, gyro = "xyz".index(turn.axis or "x"), np.array(record.gyro)
    part = gyro[turn.start : turn.stop, axis]
    level = float(np.abs(part - np.median(gyro[session.stills[0].start : session.stills[0].stop, axis])).mean())
    part += 0.2 * level * np.sin(2.0 * np.pi * 1.5 * np.arange(len(part)) / 100.0)
    shaken = replace(session, records=(replace(record, gyro=gyro),))
    uneven = only(check_turns(shaken, session.stills, 0.3), "session.piece")
    assert (uneven.level, uneven.values["pieces"]) == ("warn", 1)
    assert uneven.values["percent"] == pytest.approx(100.0 * 0.2 / np.sqrt(2.0), rel=0.1)  # 0.1 s take 4 % off


def test_a_turn_by_an_angle_that_is_cut_off_is_named() -> None:
    session = shifted(made("ferraris"), 60, which=1)
    cut = only(check_turns(session, session.stills, 0.3), "session.piece")
    assert cut.level == "fail"
    assert str(cut.values["piece"]).startswith("[[turn]] 2 ")
    assert float(cut.values["percent"]) > 50.0


def test_gyroscope_that_stays_at_one_code_is_named() -> None:
    session = made("ferraris")
    gyro = np.array(session.records[0].gyro)
    gyro[:, 1] = gyro[0, 1]
    dead = replace(session, records=(replace(session.records[0], gyro=gyro),))
    with pytest.raises(Implausible, match=r"gyroscope y: it reads .* dead"):
        observe(dead, CalibrateSettings())


# ---- rests that an accelerometer's fit did not use: real poses stated as faces are refused, and good faces pass

# Poses of two MPU-9150 boards of Mikov et al. (ICINS 2020), turned by hand: pairs of poses whose means share a middle, so that they
# fit six faces to within half a degree. None of them is a face, and the scale factors stay within the unit's tolerance.
NO_FACES = {
    0: ((15008, 15841), (106, 654), (8036, 8377), (4477, 4976), (913, 1222), (14273, 14848)),
    1: ((105, 652), (14972, 15802), (10026, 10513), (6613, 7109), (910, 1219), (14239, 14812)),
}
PLAIN = CalibrateSettings(identify_adc=False)


@pytest.mark.parametrize("unit", NO_FACES)
def test_poses_that_are_no_faces_are_bad(unit):
    order = ("+x", "-x", "+y", "-y", "+z", "-z")
    stills = tuple(Still(start=a, stop=b, face=f) for f, (a, b) in zip(order, NO_FACES[unit], strict=True))
    session = Session(kind="calibration", serial="", gravity_m_s2=9.81, records=(mpu9150(unit),), stills=stills)
    calibration = calibrate(session)
    assert calibration.verdict.status == "bad"
    tilt = [item.values["tilt_deg"] for item in calibration.verdict.findings if item.code.startswith("six_face.tilt")]
    assert max(tilt, default=0.0) < 0.5  # the six faces themselves show nothing
    missed, askew = (item for item in calibration.verdict.findings if item.code == "accel.implausible")
    missed, askew = (missed, askew) if "stills" in missed.values else (askew, missed)
    assert (askew.level, askew.values["angle_deg"] > 30.0) == ("fail", True)
    assert missed.level == "fail"
    assert missed.values["stills"] >= 14  # SOURCE: 17-18 standstills and more short ones; six are the fit's
    assert missed.values["beyond"] >= 0.9 * missed.values["stills"]
    assert missed.values["rms_m_s2"] > 3.0


@pytest.mark.parametrize("unit", [0, 1, 2])
def test_all_poses_of_the_same_boards_are_good(unit):
    calibration = calibrate(Session(kind="calibration", serial="", gravity_m_s2=9.81, records=(mpu9150(unit),)))
    assert calibration.verdict.status == "good"


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


def test_one_rest_that_misses_is_a_warning_and_two_are_a_failure():
    session = faces_then_poses(3)
    own = session.stills[-1].stop
    record = session.records[0]
    for moved, level in ((1, "warn"), (2, "fail")):
        accel = np.array(record.accel)
        for k in range(moved):  # as if the device had fallen or been carried: 0.1 g more in one pose
            start = own + 50 * (2 + 6 * k)
            accel[start - 100 : start + 250] *= 1.1
        findings = calibrate(replace(session, records=(replace(record, accel=accel),)), settings=PLAIN).verdict.findings
        assert only(findings, "accel.implausible").level == level


def test_rests_that_miss_within_the_uncertainty_of_the_fit_pass():
    session = faces()
    for sigma, found in ((0.001, True), (0.2, False)):  # the offset that the model lacks is 0.2, -0.1, 0.1 m/s2
        model = plain_triad("m/s2", "m/s2", "accel", offset_sigma=sigma)
        assert bool([*check_accel(session, model, session.stills)]) == found


def test_rests_at_another_temperature_do_not_count():
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
        findings = calibrate(session, settings=PLAIN).verdict.findings
        assert ("accel.implausible" not in codes(findings)) == status
        if not status:
            assert only(findings, "accel.implausible").values["angle_deg"] == pytest.approx(7.0, abs=0.1)
    assert set(FACES) == {s.face for s in session.stills}
