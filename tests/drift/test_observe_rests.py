"""Thermal sessions gathered into blocks of rest and dwells."""

import numpy as np
import pytest

from undrift.drift.observe import observe_rests, observe_steps
from undrift.errors import InputError, NotObservable
from undrift.record import Record, Session, Still, Turn

RATE = 20.0


def log(seconds=300.0, *, seed=0, moving=False):
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / RATE) + 5.0
    gyro = rng.normal(size=(len(time), 3)) * 0.1 + [1.0, -2.0, 0.5]
    accel = rng.normal(size=(len(time), 3)) * 0.01 + [0.0, 0.0, 9.8]
    if moving:
        gyro += 40.0 * np.sin(2.0 * time)[:, None]
        accel += 5.0 * np.sin(3.0 * time)[:, None]
    return Record(time=time, gyro=gyro, accel=accel, temp_c=20.0 + time / 60.0, gyro_unit="dps")


def session(*records, **pieces):
    return Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=records, **pieces)


def rests(made):
    return observe_rests([made], temperatures=[[r.temp_c for r in made.records]])


def test_a_log_that_never_moves_is_one_rest_of_ten_second_blocks():
    blocks = rests(session(log()))
    assert len(blocks) == 30
    assert set(blocks.pose) == {0}
    np.testing.assert_allclose(np.diff(blocks.time), 10.0, atol=0.1)
    np.testing.assert_allclose(blocks.ramp_c_per_min, 1.0, atol=1e-6)
    np.testing.assert_allclose(blocks.gyro, np.tile([1.0, -2.0, 0.5], (30, 1)), atol=5 * 0.1 / 200**0.5)
    np.testing.assert_allclose(
        np.sqrt(blocks.gyro_variance), 0.1 / 200**0.5, rtol=0.15
    )  # 300 differences of half seconds


def test_torn_lines_spikes_and_gaps_do_not_reach_the_means():
    clean = log()
    gyro = clean.gyro.copy()
    gyro[50::333] = 4000.0
    gyro[1000:1050] = np.nan
    dirty = Record(time=clean.time, gyro=gyro, accel=clean.accel, temp_c=clean.temp_c, gyro_unit="dps")
    found = rests(session(dirty))
    assert len(found) > 15
    off = np.abs(found.gyro - [1.0, -2.0, 0.5]) / np.sqrt(found.gyro_variance)
    assert off.max() < 5.0
    np.testing.assert_allclose(found.temp_c, 20.0 + (found.time + 5.0) / 60.0, atol=0.01)


def test_stated_stills_serve_whole_or_in_blocks_and_faces_are_poses():
    stills = (
        Still(start=0, stop=160, face="+z"),
        Still(start=1000, stop=2000, face="-z"),
        Still(start=3000, stop=3160, face="+z"),
    )
    blocks = rests(session(log(), stills=stills))
    assert [int((blocks.pose == p).sum()) for p in (0, 1)] == [2, 5]
    assert blocks.power_on_s[0] == pytest.approx(4.0, abs=0.05)


def test_recordings_follow_each_other_on_one_clock_and_sessions_are_counted():
    one = session(log(60.0), log(60.0, seed=1))
    temps = [[r.temp_c for r in one.records]] * 2
    blocks = observe_rests([one, one], temperatures=temps)
    assert list(np.unique(blocks.session)) == [0, 1]
    assert len(np.unique(blocks.pose)) == 4
    assert (np.diff(blocks.time[blocks.session == 0]) > 0.0).all()


def test_no_rest_and_no_temperature_are_refused():
    with pytest.raises(NotObservable, match="no stretch at rest"):
        rests(session(log(moving=True)))
    made = session(log())
    with pytest.raises(NotObservable, match="with a known temperature"):
        observe_rests([made], temperatures=[[np.full(len(made.records[0]), np.nan)]])


def test_dwells_are_numbered_by_soak_and_carry_the_imposed_rate():
    turns = tuple(
        Turn(start=k * 400, stop=k * 400 + 300, axis=axis, turn_rate=rate)
        for k, (axis, rate) in enumerate((("x", 0.5), ("x", -0.5), ("y", 1.0), ("z", 1.0)))
    )
    made = session(log(), turns=turns)
    temp = np.where(np.arange(6000) < 800, 20.0, 30.0)
    steps = observe_steps([made], temperatures=[[temp]])
    np.testing.assert_array_equal(steps.soak, [0, 0, 1, 1])
    np.testing.assert_array_equal(steps.rate_b, [[0.5, 0, 0], [-0.5, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(steps.temp_c, [20.0, 20.0, 30.0, 30.0])
    with pytest.raises(InputError, match="has no temperature"):
        observe_steps([made], temperatures=[[np.full(6000, np.nan)]])
    assert len(observe_steps([session(log())], temperatures=[[temp]])) == 0
