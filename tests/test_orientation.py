"""orient: the whole way from readings to angles."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_product
from undrift.orientation import OrientSettings, heading_of, inclination_of, orient, sagittal_pitch
from undrift.record import Record, Still

G = 9.81


def moved(n=600, rest=200, *, lead=0, seed=1, noise=0.0, offset=0.0):
    """A record that rests, then turns; lead samples of motion come before the rest. Rates are means over their steps."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) * 0.01
    course = np.concatenate((np.linspace(1.0, 0.0, lead), np.zeros(rest), np.linspace(0.0, 6.0, n - lead - rest)))
    half = 0.5 * course  # one axis, so that the step's mean rate is exact
    axis = np.array([0.48, 0.6, 0.64])
    q = np.column_stack((np.cos(half), np.sin(half)[:, None] * axis))
    rate = np.diff(course, prepend=course[0]) / 0.01
    up = np.stack([quaternion_product(quaternion_product(quaternion_conjugate(p), [0, 0, 0, G]), p)[1:] for p in q])
    gyro = rate[:, None] * axis + offset + noise * rng.normal(size=(n, 3))
    return Record(time=time, gyro=gyro, accel=up + noise * rng.normal(size=(n, 3))), q


def off(q, truth):
    e = quaternion_product(q, quaternion_conjugate(truth))
    return 2.0 * np.arctan2(np.linalg.norm(e[:, 1:], axis=1), np.abs(e[:, 0]))


def test_ideal_readings_give_back_the_motion_after_and_before_the_rest():
    record, truth = moved(lead=120)
    found = orient(record, Still(start=130, stop=310))
    show("noise-free round trip, rad", off(found.q_nb, truth).max(), 1e-12)
    assert off(found.q_nb, truth).max() < 1e-12  # 600 roundings
    np.testing.assert_array_equal(found.inclination, inclination_of(found.q_nb))
    np.testing.assert_array_equal(found.heading, heading_of(found.q_nb))
    np.testing.assert_array_equal(found.pitch, sagittal_pitch(found.q_nb))
    np.testing.assert_array_equal(found.offset, 0.0)


def test_the_rest_offset_is_taken_off_when_asked():
    record, truth = moved(offset=0.02)
    still = Still(start=0, stop=200)
    with_it, without = orient(record, still), orient(record, still, OrientSettings(offset="rest"))
    assert off(with_it.q_nb, truth)[-1] > 0.03
    assert off(without.q_nb, truth)[-1] < 1e-12
    np.testing.assert_allclose(without.offset, 0.02, rtol=1e-12)


def test_a_rest_is_found_when_none_is_given():
    record, truth = moved(noise=1e-4)
    found = orient(record)
    assert (
        0 <= found.still.start < found.still.stop <= 202
    )  # the search may lose half a window, and gain none of the motion
    assert off(found.q_nb, truth).max() < 1e-3  # 600 steps of 1e-4 rad/s noise walk to 2e-5 rad; the tilt errs by 1e-5


def test_heading_and_axes_are_those_of_the_settings():
    record, truth = moved()
    still = Still(start=0, stop=200)
    found = orient(record, still, OrientSettings(heading=0.5, forward="-y", up="+z"))
    assert found.heading[100] == pytest.approx(0.5, abs=1e-12)
    np.testing.assert_allclose(found.pitch, sagittal_pitch(truth, forward="-y", up="+z"), rtol=0, atol=1e-11)


def test_degrees_and_g_are_converted():
    record, _ = moved()
    still = Still(start=0, stop=200)
    a, b = orient(record, still), orient(record.in_units("dps", "g"), still)
    np.testing.assert_allclose(b.q_nb, a.q_nb, rtol=0, atol=1e-13)


def test_what_cannot_be_oriented_is_refused():
    record, _ = moved(noise=1e-4)
    with pytest.raises(InputError, match="wanted gyroscope readings, got none"):
        orient(Record(time=record.time, accel=record.accel))
    rng = np.random.default_rng(2)
    shaken = Record(time=record.time, gyro=rng.normal(size=(600, 3)), accel=record.accel + rng.normal(size=(600, 3)))
    with pytest.raises(
        InputError,
        match=r"orient: wanted a still phase, got none: .*; name a stretch at rest \(--still-start-s, --still-stop-s\), or record",
    ):
        orient(shaken)
    with pytest.raises(InputError, match="rate: wanted a physical unit, got count"):
        orient(Record(time=record.time, gyro=record.gyro, accel=record.accel, gyro_unit="count"))


def test_a_hole_in_time_or_a_dead_axis_is_refused() -> None:
    record, *_ = moved()
    late = np.where(np.arange(len(record)) < 400, record.time, record.time + 5.0)
    with pytest.raises(InputError, match=r"wanted readings without holes over 0.1 s, got 1, the first of 5.0"):
        orient(replace(record, time=late))
    assert record.gyro is not None
    with pytest.raises(InputError, match="wanted three gyroscopes that turn, got x at one value throughout"):
        orient(replace(record, gyro=record.gyro * [0.0, 1.0, 1.0]))
