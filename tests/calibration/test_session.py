"""What a session shows: is it at rest where it says so, are its turns whole, the mean rate of rests, one temperature."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.cohorts import COHORTS, share_limits
from testkit.data import data_path
from testkit.findings import codes, only
from testkit.strategies import one_line
from undrift.calibration.calibrate import calibrate
from undrift.calibration.session import (
    at_one_temperature,
    check_stills,
    check_turns,
    mean_of_rests,
    observe,
    piece_temperatures,
)
from undrift.calibration.settings import CalibrateSettings
from undrift.errors import Implausible, InputError
from undrift.record import FACES, Record, Session, Still, Turn
from undrift.sim.device.presets import random_device, random_device_of
from undrift.sim.device.truth import true_calibration
from undrift.sim.sessions import simulate_session
from undrift.sim.thermal import ThermalSettings, simulate_thermal_session
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
def test_stills_that_creep_are_refused_by_their_tilt(creep_dps):
    with pytest.raises(
        Implausible, match=r"\[\[still\]\] \d \(recording 0, .* s\): wanted a device at rest, got a tilt of"
    ) as caught:
        observe(faces(creep_dps), CalibrateSettings())
    one_line(caught)


def test_stills_that_creep_a_little_are_a_finding_and_make_the_verdict_marginal():
    found = calibrate(faces(0.25))  # 1 deg from the first to the last third of 6 s, the limit is 0.5
    assert found.verdict.status == "marginal"
    tilt = only(found.verdict.findings, "still.tilt")
    assert tilt.values["stills"] == 6
    assert tilt.values["tilt_deg"] == pytest.approx(1.0, abs=0.05)
    assert tilt.action.startswith("shorten it")


@pytest.mark.parametrize(("unit", "accel_unit"), [("rad/s", "m/s2"), ("dps", "m/s2"), ("count", "count")])
def test_a_still_that_begins_before_the_device_was_put_down_is_refused_by_its_sway(unit, accel_unit):
    session = faces(unit=unit, accel_unit=accel_unit, sway=(2, 0.5))
    with pytest.raises(
        Implausible, match=r"\[\[still\]\] 3 \(recording 0, 12.0-18.0 s\): .*got readings that sway by up to"
    ):
        observe(session, CalibrateSettings())


def test_a_slow_turn_about_the_vertical_shows_in_the_mean_rate_alone():
    session = faces()
    gyro = np.array(session.records[0].gyro)
    gyro[HOLD : 2 * HOLD, 0] += 3.0 * RADIAN_PER_DEGREE
    turning = replace(session, records=(replace(session.records[0], gyro=gyro),))
    with pytest.raises(
        Implausible,
        match=r"\[\[still\]\] 2 .*got a mean rate 3 deg/s off that of the other stills; check for a slow turn",
    ):
        observe(turning, CalibrateSettings())
    thermal = replace(turning, kind="thermal")  # offsets differ between temperatures, and that is what it records
    assert observe(thermal, CalibrateSettings()).findings == ()
    stills = tuple(replace(s, temp_c=20.0 + 10.0 * k) for k, s in enumerate(session.stills))
    assert check_stills(replace(turning, stills=stills), stills, stated=True) == ()


def test_a_recording_in_the_wrong_unit_is_refused_among_found_stills():
    one = faces().records[0]
    rests = tuple(replace(one, time=one.time[:HOLD], gyro=one.gyro[k : k + HOLD], accel=one.accel[k : k + HOLD])
                  for k in range(0, 6 * HOLD, HOLD))  # fmt: skip
    wrong = (replace(rests[0], gyro=rests[0].gyro + np.array([0.12, 0.0, 0.0])), *rests[1:])
    session = Session(kind="calibration", serial="", gravity_m_s2=9.81, records=wrong)
    with pytest.raises(
        Implausible, match=r"still found \(recording 0, 0.0-6.0 s\): .*check for a slow turn, another unit"
    ):
        observe(session, CalibrateSettings())


def test_the_same_recording_twice_is_refused():
    session = faces()
    twice = replace(session, records=session.records * 2)
    with pytest.raises(
        InputError, match="recording 1: wanted new readings, got those of recording 0 again; take one of"
    ) as caught:
        observe(twice, CalibrateSettings())
    one_line(caught)
    other = replace(session.records[0], gyro=session.records[0].gyro + 1e-4, accel=None)
    assert len(observe(replace(session, records=(session.records[0], other)), CalibrateSettings()).stills) == 6


def test_the_same_still_or_turn_twice_is_refused_and_neighbours_pass():
    session = faces()
    again = Still(start=30, stop=HOLD - 10, face="+x")
    with pytest.raises(
        InputError, match=r"\[\[still\]\] 7 .*shares 100 % of its samples with \[\[still\]\] 1; take one"
    ):
        observe(replace(session, stills=(*session.stills, again)), CalibrateSettings())
    turns = tuple(Turn(start=k, stop=k + 50, axis="x", angle=1.0) for k in (0, 100, 101))
    with pytest.raises(InputError, match=r"\[\[turn\]\] 3 .*shares 98 % of its samples with \[\[turn\]\] 2"):
        observe(replace(session, turns=turns), CalibrateSettings())
    assert observe(replace(session, turns=turns[:2]), CalibrateSettings()).findings == ()


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
    with pytest.raises(Implausible, match=r"\[\[still\]\] 1 .*got readings that sway by up to 159 deg/s rms"):
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
    found = list(check_turns(session, session.stills, 0.3))
    stop = only(found, "turn.stop")
    assert stop.level == "fail"
    assert str(stop.values["turn"]).startswith("[[turn]] 71 (recording 0, ")
    assert stop.values["turns"] == 1
    assert 5.0 < float(stop.values["stop_percent"]) < 35.0  # a third of a dwell of 3 s at most
    assert only(found, "turn.unsteady").values["turns"] == 1


@pytest.mark.slow
def test_dwells_that_all_end_in_a_stop_make_the_verdict_bad() -> None:
    session = made("bench")
    late = calibrate(shifted(replace(session, turns=session.turns[:-1]), 60))  # the last one has nothing after it
    assert late.verdict.status == "bad"
    assert {"turn.stop", "turn.unsteady"} <= set(codes(late.verdict.findings))
    assert only(late.verdict.findings, "turn.stop").values["turns"] > 90  # of 102


def test_a_rate_that_sways_is_named_with_its_spread() -> None:
    session = made("bench")
    record, turn = session.records[0], session.turns[40]
    assert record.gyro is not None
    axis, gyro = "xyz".index(turn.axis or "x"), np.array(record.gyro)
    part = gyro[turn.start : turn.stop, axis]
    level = float(np.abs(part - np.median(gyro[session.stills[0].start : session.stills[0].stop, axis])).mean())
    part += 0.2 * level * np.sin(2.0 * np.pi * 1.5 * np.arange(len(part)) / 100.0)
    shaken = replace(session, records=(replace(record, gyro=gyro),))
    uneven = only(check_turns(shaken, session.stills, 0.3), "turn.unsteady")
    assert (uneven.level, uneven.values["turns"]) == ("warn", 1)
    assert uneven.values["spread_percent"] == pytest.approx(100.0 * 0.2 / np.sqrt(2.0), rel=0.1)  # 0.1 s take 4 % off


def test_a_turn_by_an_angle_that_is_cut_off_is_named() -> None:
    session = shifted(made("ferraris"), 60, which=1)
    cut = only(check_turns(session, session.stills, 0.3), "turn.cut")
    assert cut.level == "fail"
    assert str(cut.values["turn"]).startswith("[[turn]] 2 ")
    assert float(cut.values["edge_percent"]) > 50.0


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


# ---- mean of rests: its stated variance is the one that repeated experiments show


def covered(rng, count, between, *, correlated=0.0, length=2000, trials):
    """Return the share of 95 % intervals that hold the truth, here zero."""
    held = 0
    for _ in range(trials):
        windows = []
        for _ in range(count):
            noise = rng.standard_normal((length, 3))
            if correlated:
                noise += correlated * np.repeat(rng.standard_normal((length // 50, 3)), 50, axis=0)
            windows.append(noise + between * rng.standard_normal(3))
        mean, variance = mean_of_rests(windows, [50] * count)
        held += int((np.abs(mean) <= 1.96 * np.sqrt(variance)).sum())
    return held / (3 * trials)


@pytest.mark.parametrize("trials", COHORTS)
@pytest.mark.parametrize(
    ("count", "between", "correlated"),
    [(1, 0.0, 0.0), (1, 0.0, 1.0), (11, 0.0, 0.0), (11, 1.0, 0.0), (4, 1.0, 0.0), (11, 0.1, 1.0)],
)
def test_intervals_hold_whether_rests_scatter_or_not(count, between, correlated, trials):
    share = covered(np.random.default_rng(41), count, between, correlated=correlated, trials=trials)
    print(f"{count} rests, scatter {between}, correlated {correlated}: {100 * share:.1f} % of 95 % intervals hold")
    low, high = share_limits(3 * trials)
    assert low <= share <= max(high, 0.995)  # the larger of two block lengths is a little too wide on white noise


def test_scatter_between_rests_is_not_taken_for_noise_of_samples():
    rng = np.random.default_rng(42)
    windows = [0.01 * rng.standard_normal((2400, 3)) + shift for shift in np.linspace(-0.1, 0.1, 11)]
    variance = mean_of_rests(windows, [50] * 11)[1]
    white = 0.01**2 / (11 * 2400)
    # standard deviation of the shifts 0.066 over sqrt(11), times Student's factor 1.14
    np.testing.assert_allclose(np.sqrt(variance), 0.0663 / np.sqrt(11) * 1.137, rtol=0.02)
    assert (variance > 100.0 * white).all()


def test_readings_without_any_scatter_have_none():
    mean, variance = mean_of_rests([np.ones((200, 3)), np.ones((300, 3))], [50, 50])
    np.testing.assert_array_equal(mean, 1.0)
    np.testing.assert_array_equal(variance, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("warmth", [(-0.6, -0.5, -0.1, 1.2), (0.1, 0.5, 0.9, 1.3)])
def test_offsets_that_creep_with_temperature_cost_what_their_slope_leaves_unknown(warmth):
    rng, held, stated, scatter = np.random.default_rng(43), 0, [], []
    away = np.array(warmth)  # K above the reference, of each rest
    for _ in range(100):
        slope = rng.normal(0.0, 0.5, 3)
        windows = [rng.standard_normal((2000, 3)) + each * slope for each in away]
        mean, variance = mean_of_rests(windows, [50] * 4, 0.5 * away)
        held += int((np.abs(mean) <= 1.96 * np.sqrt(variance)).sum())
        stated.append(variance)
        scatter.append(mean_of_rests(windows, [50] * 4)[1])
    assert share_limits(300)[0] <= held / 300 <= 0.995  # as above
    # Taken for scatter, 0.5 per K over a span near 1 K leaves 0.1 to 0.2; known as a slope little more than noise, 0.01 to 0.03
    assert np.sqrt(np.mean(stated) / np.mean(scatter)) < 0.25


# ---- a session of several set-points: the constant model is that of one of them


@pytest.mark.slow
def test_a_thermal_session_is_calibrated_at_the_set_point_nearest_to_room_temperature() -> None:
    rng = np.random.default_rng(3)
    device = random_device_of("bmi270", rng)
    session = simulate_thermal_session(
        "soak", device, rng=rng, settings=ThermalSettings(set_points_c=(15.0, 27.0, 45.0), faces="six")
    )
    made = calibrate(session)
    assert abs(made.reference_temp_c - 27.0) < 1.5  # the thermometer's trim and the soak's tolerance
    visited = only(made.verdict.findings, "session.temperatures")
    assert (visited.level, visited.values["groups"]) == ("warn", 3)
    assert "undrift drift" in visited.action
    truth = true_calibration(device, temp_c=27.0)
    assert made.gyro is not None
    assert truth.gyro is not None
    np.testing.assert_allclose(
        made.gyro.matrix / truth.gyro.matrix.max(), truth.gyro.matrix / truth.gyro.matrix.max(), atol=2e-3
    )


@pytest.mark.slow
def test_faces_at_room_temperature_go_with_the_rates_at_the_nearest_set_point() -> None:
    rng = np.random.default_rng(3)
    device = random_device_of("bmi270", rng)
    settings = ThermalSettings(set_points_c=(15.0, 22.0, 30.0, 45.0), faces="six")
    whole = simulate_thermal_session("soak", device, rng=rng, settings=settings)
    temps = piece_temperatures(whole, whole.stills)
    session = replace(whole, stills=tuple(s for s, c in zip(whole.stills, temps, strict=True) if abs(c - 22.0) < 2.0))
    turns = piece_temperatures(whole, whole.turns)
    session = replace(session, turns=tuple(t for t, c in zip(whole.turns, turns, strict=True) if abs(c - 22.0) > 2.0))
    kept, _ = at_one_temperature(session)
    assert {still.face for still in kept.stills} == {"+x", "-x", "+y", "-y", "+z", "-z"}
    assert abs(piece_temperatures(kept, kept.turns) - 30.0).max() < 1.5
    made = calibrate(session)
    assert made.accel is not None
    truth = true_calibration(device, temp_c=22.0).accel
    assert truth is not None
    off = np.abs(np.diag(made.accel.matrix @ np.linalg.inv(truth.matrix)) - 1.0)
    assert off.max() < 2e-3
    assert "session.temperature_creep" in {item.code for item in made.verdict.findings}


def test_a_session_that_warms_a_little_is_left_as_it_is() -> None:
    rng = np.random.default_rng(4)
    session = simulate_session("bench", random_device_of("bmi270", rng), rng=rng, temp_c=(24.0, 29.0))
    kept, findings = at_one_temperature(session)
    assert kept is session
    assert findings == ()
