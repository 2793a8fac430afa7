"""Data given twice are refused; recordings cut from one switch-on are one session."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.drift.observe import check_once
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
