"""Data given twice are refused; recordings cut from one switch-on are one session."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.drift.observe import check_once, one_power_on
from undrift.errors import InputError
from undrift.record import Record, Session


def record(*, seed=0, begin_s=0.0, n=500):
    rng = np.random.default_rng(seed)
    return Record(
        time=begin_s + np.arange(n) / 50.0,
        gyro=rng.normal(size=(n, 3)),
        accel=rng.normal(size=(n, 3)),
        temp_c=np.linspace(20.0, 30.0, n),
    )


def session(made, name="log.csv", digest=None, serial=""):
    inputs = () if digest is None else ((name, digest),)
    return Session(kind="thermal", serial=serial, gravity_m_s2=9.80665, records=(made,), inputs=inputs)


def test_one_file_in_two_sessions_is_refused_and_one_description_is_not():
    with pytest.raises(InputError, match=r"session 1 \(a.csv\) and session 2 \(b.csv\): the same file"):
        check_once([session(record(), "a.csv", "0" * 64), session(record(seed=1), "b.csv", "0" * 64)])
    described = [session(record(seed=k), "session.toml", "0" * 64) for k in range(2)]
    check_once(described)


def test_equal_readings_are_refused_however_the_clock_was_set():
    later = replace(record(), time=record().time + 1000.0)
    with pytest.raises(
        InputError, match=r"session 1 \(recording 0\) and session 2 \(b.csv\): all 500 readings are equal"
    ):
        check_once([session(record()), session(later, "b.csv", "1" * 64)])


def test_logs_cut_so_that_they_overlap_are_refused_and_fifteen_rows_are_chance():
    whole = record()
    with pytest.raises(InputError, match=r"16 readings one after another are equal, from 4\.68 s on"):
        check_once([session(whole.part(0, 250)), session(whole.part(234, 500))])
    check_once([session(whole.part(0, 250)), session(whole.part(235, 500))])


def course(*, shift=0.0, begin_s=0.0, seed=0, n=4000):
    """A warm-up from power-on: offsets follow the temperature, under noise; a second switch-on begins where ``shift`` says."""
    rng, time = np.random.default_rng(seed), begin_s + np.arange(n) / 50.0
    temp = 20.0 + 10.0 * (1.0 - np.exp(-time / 40.0))
    return Record(
        time=time,
        gyro=0.02 * temp[:, None] * [1.0, -1.0, 0.5] + shift + 0.1 * rng.normal(size=(n, 3)),
        accel=np.array([0.0, 0.0, 9.81]) + 0.05 * rng.normal(size=(n, 3)),
        temp_c=temp + 0.05 * rng.normal(size=n),
    )


def rows_of(made, rows):
    parts = {name: getattr(made, name)[rows] for name in ("time", "gyro", "accel", "temp_c")}
    return replace(made, **parts)


@pytest.mark.parametrize("way", ["every second", "every third", "at random"])
def test_rows_of_one_log_dealt_out_to_two_files_are_refused(way):
    whole, number = course(), np.arange(4000)
    mine = {"every second": number % 2 == 0, "every third": number % 3 == 0}.get(
        way, np.random.default_rng(5).random(4000) < 0.5
    )
    pair = [session(rows_of(whole, mine), "a.csv", "0"), session(rows_of(whole, ~mine), "b.csv", "1")]
    for named in (pair, pair[::-1]):
        with pytest.raises(
            InputError, match=r"rows of one log in turn in session 1 \([ab]\.csv\) and session 2 .* put them into"
        ):
            check_once(named)


@pytest.mark.parametrize(("shift", "begin_s"), [(0.02, 0.01), (0.0, 2.01), (0.02, 0.0)])
def test_two_switch_ons_whose_clocks_both_begin_at_zero_are_two(shift, begin_s):
    # Times interleave; offsets differ by a fifth of the noise of a row, or the warm-up is 2 s further by the same clock.
    first = course()
    second = course(shift=shift, seed=1)
    check_once([session(first), session(replace(second, time=second.time + begin_s))])


def test_a_sensor_that_repeats_one_value_is_not_taken_for_a_copy():
    stuck = [replace(record(seed=k), gyro=np.zeros((500, 3)), accel=np.ones((500, 3))) for k in range(2)]
    check_once([session(made) for made in stuck])
    gap = np.where(np.arange(500)[:, None] < 400, np.nan, record().gyro)
    check_once([session(replace(record(seed=k), gyro=gap)) for k in range(2)])  # gaps are equal, accelerations are not


def test_a_clock_that_runs_on_is_one_switch_on_in_whatever_order_the_logs_are_named():
    whole = record()
    first, second = session(whole.part(0, 250), "a", "0"), session(whole.part(250, 500), "b", "1")
    anew = session(record(seed=3), "c", "2")
    made = one_power_on([anew, second, first])
    assert [len(one.records) for one in made] == [1, 2]
    assert made[1].inputs == (("a", "0"), ("b", "1"))
    assert made[1].records[1].time[0] > made[1].records[0].time[-1]


@pytest.mark.parametrize(
    ("begin_s", "serial", "count"), [(69.9, "", 1), (70.1, "", 2), (0.0, "", 2), (9.98, "", 2), (20.0, "other", 2)]
)
def test_a_longer_pause_a_clock_set_anew_or_another_device_is_another_switch_on(begin_s, serial, count):
    pair = [session(record()), session(record(seed=1, begin_s=begin_s), serial=serial)]
    assert len(one_power_on(pair)) == count
