"""A stated turn that stops, sways or is cut off is named; sound ones are not."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.findings import codes, only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.observe import check_turns
from undrift.record import Session
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session


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
