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


def test_equal_readings_are_refused_however_the_clock_was_set():
    later = replace(record(), time=record().time + 1000.0)
    with pytest.raises(InputError, match="the same data"):
        check_once([session(record()), session(later, "b.csv", "1" * 64)])


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
