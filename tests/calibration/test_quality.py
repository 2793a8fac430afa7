"""Rests and turns of a session: refused or named if they are not what it states."""

import re
from dataclasses import replace

import numpy as np
import pytest

from testkit.data import data_path
from testkit.findings import only
from testkit.strategies import one_line
from undrift.calibration.calibrate import calibrate
from undrift.calibration.quality import check_turns
from undrift.calibration.session import observe
from undrift.calibration.settings import CalibrateSettings
from undrift.errors import Implausible, InputError
from undrift.record import FACES, Record, Session, Still
from undrift.sim.device.presets import random_device
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


@pytest.mark.parametrize("creep_dps", [1.0, 3.0])
def test_stills_that_creep_are_refused_by_their_sway(creep_dps):
    with pytest.raises(
        Implausible,
        match=r"\[\[still\]\] \d \(recording 0, .* s\): expected a device at rest, got readings that sway by",
    ) as caught:
        observe(faces(creep_dps), CalibrateSettings())
    one_line(caught)


def test_stills_that_creep_a_little_are_a_finding_and_make_the_verdict_marginal():
    found = calibrate(faces(0.25))  # 1.5 deg in 6 s, the limit is 1 deg
    assert found.verdict.status == "marginal"
    sway = only(found.verdict.findings, "session.piece")
    assert sway.values["pieces"] == 6
    size = float(re.search(r"sway by ([\d.]+) m/s2", sway.sentence).group(1))
    assert size == pytest.approx(9.81 * np.radians(1.5) / np.sqrt(12.0), rel=0.05)


@pytest.mark.parametrize(("unit", "accel_unit"), [("rad/s", "m/s2"), ("dps", "m/s2"), ("count", "count")])
def test_a_still_that_begins_before_the_device_was_put_down_is_refused_by_its_sway(unit, accel_unit):
    session = faces(unit=unit, accel_unit=accel_unit, sway=(2, 0.5))
    with pytest.raises(Implausible, match=r"\[\[still\]\] 3 \(recording 0, 12.0-18.0 s\): .*got readings that sway by"):
        observe(session, CalibrateSettings())


def test_a_slow_turn_about_the_vertical_shows_in_the_mean_rate_alone():
    session = faces()
    gyro = np.array(session.records[0].gyro)
    gyro[HOLD : 2 * HOLD, 0] += 3.0 * RADIAN_PER_DEGREE
    turning = replace(session, records=(replace(session.records[0], gyro=gyro),))
    with pytest.raises(
        Implausible,
        match=r"\[\[still\]\] 2 .*got a mean rate 3(\.0\d)? deg/s off",
    ):
        observe(turning, CalibrateSettings())
    thermal = replace(turning, kind="thermal")  # offsets differ between temperatures, and that is what it records
    assert observe(thermal, CalibrateSettings()).findings == ()


def test_a_recording_in_the_wrong_unit_is_refused_among_found_stills():
    one = faces().records[0]
    rests = tuple(replace(one, time=one.time[:HOLD], gyro=one.gyro[k : k + HOLD], accel=one.accel[k : k + HOLD])
                  for k in range(0, 6 * HOLD, HOLD))  # fmt: skip
    wrong = (replace(rests[0], gyro=rests[0].gyro + np.array([0.12, 0.0, 0.0])), *rests[1:])
    session = Session(kind="calibration", serial="", gravity_m_s2=9.81, records=wrong)
    with pytest.raises(Implausible, match=r"still found \(recording 0, 0.0-6.0 s\): .*wrong unit"):
        observe(session, CalibrateSettings())


def test_the_same_recording_twice_is_refused():
    session = faces()
    twice = replace(session, records=session.records * 2)
    with pytest.raises(InputError, match=r"recording 1: .* recording 0 again") as caught:
        observe(twice, CalibrateSettings())
    one_line(caught)
    other = replace(session.records[0], gyro=session.records[0].gyro + 1e-4)
    assert len(observe(replace(session, records=(session.records[0], other)), CalibrateSettings()).stills) == 6


def test_the_ferraris_recording_is_refused_where_a_still_begins_too_early():
    """The +x face of the shared session lies from 5.3 s on; 1.0 to 14.0 s holds the putting down too."""
    path = data_path("ferraris_nilspod", "example_ferraris_session.csv")
    table = np.genfromtxt(path, delimiter=",", names=True)
    record = Record(
        time=np.arange(len(table)) / 102.4,
        gyro=np.column_stack([table[f"gyr_{a}"] for a in "xyz"]),
        accel=np.column_stack([table[f"acc_{a}"] for a in "xyz"]),
        gyro_unit="dps",
    )
    good = Still(start=540, stop=1271, face="+x")
    session = Session(kind="calibration", serial="", gravity_m_s2=9.81, records=(record,), stills=(good,))
    assert observe(session, CalibrateSettings()).findings == ()
    early = replace(session, stills=(replace(good, start=102, stop=1434),))
    with pytest.raises(Implausible, match=r"\[\[still\]\] 1 .*got readings that sway by 55.3 deg/s rms"):
        observe(early, CalibrateSettings())


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
def test_sound_turns_give_no_finding_and_0_1_s_of_ramp_are_allowed(kind: str) -> None:
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


@pytest.mark.slow
def test_dwells_that_all_end_in_a_stop_make_the_verdict_bad() -> None:
    session = made("bench")
    late = calibrate(shifted(replace(session, turns=session.turns[:-1]), 60))  # the last one has nothing after it
    assert late.verdict.status == "bad"
    stop = next(item for item in late.verdict.findings if item.code == "session.piece")
    assert "overlaps a stop" in stop.sentence
    assert stop.values["pieces"] > 90  # of 102


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


def test_turns_near_the_noise_without_axis_offset_or_readings_are_not_judged() -> None:
    session = shifted(made("bench"), 60)
    record = session.records[0]
    assert record.gyro is not None
    noise = 1e6 * np.random.default_rng(1).normal(size=record.gyro.shape)
    for other in (
        replace(session, records=(replace(record, gyro=record.gyro + noise),)),
        replace(session, records=(replace(record, gyro=None),)),
        replace(session, turns=tuple(replace(t, axis=None) for t in session.turns)),
        replace(session, turns=session.turns[:1], stills=()),
    ):
        assert list(check_turns(other, other.stills, 0.3)) == []


def test_a_gyroscope_that_stays_at_one_code_while_the_device_turns_is_named() -> None:
    session = made("ferraris")
    gyro = np.array(session.records[0].gyro)
    gyro[:, 1] = gyro[0, 1]
    dead = replace(session, records=(replace(session.records[0], gyro=gyro),))
    with pytest.raises(Implausible, match=r"gyroscope y: it reads .* dead"):
        observe(dead, CalibrateSettings())
