"""Record and Reference: complete and consistent at birth, read-only, in the device's own unit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.strategies import assert_same, few, records, references
from undrift.errors import InputError
from undrift.record import Record, Reference, Session, Still, Turn, sample_rate_of

T = [0.0, 0.01, 0.02]
XYZ = np.arange(9.0).reshape(3, 3)


@few
@given(record=records(gaps=True), data=st.data())
def test_a_part_is_the_same_channels_with_fewer_samples(record, data):
    start = data.draw(st.integers(0, len(record) - 2))
    stop = data.draw(st.integers(start + 2, len(record)))
    part = record.part(start, stop)
    assert len(part) == stop - start
    np.testing.assert_array_equal(part.time, record.time[start:stop])
    if record.gyro is not None:
        np.testing.assert_array_equal(part.gyro, record.gyro[start:stop])
    between = record.between(record.time[start], record.time[stop - 1] + 1e-9 * abs(record.time[stop - 1]) + 1e-12)
    assert_same(between, part)
    assert_same(record.part(0, len(record)), record)


@few
@given(record=records(gaps=True))
def test_units_go_to_si_and_back(record):
    if {"count", "v"} & {record.gyro_unit, record.accel_unit}:
        with pytest.raises(InputError, match=r"got (count|v)"):
            record.in_si()
        return
    si = record.in_si()
    assert (si.gyro_unit, si.accel_unit) == ("rad/s", "m/s2")
    back = si.in_units(record.gyro_unit, record.accel_unit)
    for channel in ("gyro", "accel"):
        if getattr(record, channel) is not None:
            np.testing.assert_allclose(getattr(back, channel), getattr(record, channel), rtol=1e-15, atol=1e-300)
    assert si.in_si() is si


def test_a_record_is_read_only_and_leaves_its_input_alone():
    gyro = XYZ.copy()
    record = Record(time=T, gyro=gyro)
    with pytest.raises(ValueError, match="read-only"):
        record.gyro[0, 0] = 1.0
    with pytest.raises(AttributeError):
        record.gyro = gyro
    gyro[0, 0] = 99.0
    assert record.gyro[0, 0] == 0.0


def test_rate_and_duration_leave_drop_outs_out_of_the_rate():
    time = np.concatenate((np.arange(100), 1000 + np.arange(100))) / 50.0
    assert sample_rate_of(time) == pytest.approx(50.0)
    record = Record(time=time, gyro=np.zeros((200, 3)))
    assert record.sample_rate_hz == pytest.approx(50.0)
    assert record.duration_s == pytest.approx(1099 / 50)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"time": T, "gyro": XYZ[:2]}, r"got \(2, 3\)"),
        ({"time": T, "gyro": XYZ, "gyro_unit": "g"}, "unit of rate"),
        ({"time": [0.0, 0.02, 0.01], "gyro": XYZ}, "in row 2"),
        ({"time": [0.0, 0.0, 0.01], "gyro": XYZ}, "in row 1"),
        ({"time": [0.0, np.nan, 0.01], "gyro": XYZ}, "NaN first in"),
        ({"time": [0.0], "gyro": XYZ[:1]}, "got 1"),
        ({"time": [0.0, np.inf, 1.0], "gyro": XYZ}, "got infinity"),
    ],
)
def test_what_does_not_fit_together_is_refused(keys, words):
    with pytest.raises(InputError, match=words):
        Record(**keys)


@few
@given(reference=references())
def test_a_reference_knows_its_gaps_and_keeps_unit_quaternions(reference):
    seen = reference.valid
    assert (np.isnan(reference.q_nb[~seen])).all()
    # 1e-15: one rounding each of norm and division
    np.testing.assert_allclose(np.linalg.norm(reference.q_nb[seen], axis=1), 1.0, atol=4e-16)
    assert len(reference) == len(seen)
    assert reference.sample_rate_hz > 0


def test_a_reference_refuses_what_is_no_quaternion():
    with pytest.raises(InputError, match="unit quaternions"):
        Reference(time=T, q_nb=np.ones((3, 4)))
    with pytest.raises(InputError, match=r"got \(3, 3\)"):
        Reference(time=T, q_nb=XYZ)
    with pytest.raises(InputError, match="position"):
        Reference(time=T, q_nb=np.tile([1.0, 0, 0, 0], (3, 1)), position=[[0.0, 0, 0]])
    nearly = Reference(time=T, q_nb=np.tile([1.0005, 0, 0, 0], (3, 1)))
    np.testing.assert_array_equal(nearly.q_nb[:, 0], 1.0)


# ---- from arrays


def test_arrays_with_their_units_and_a_rate_are_a_record():
    gyro, accel = np.arange(12.0).reshape(4, 3), np.ones((4, 3))
    record = Record.from_arrays(
        gyro=gyro, accel=accel, gyro_unit="deg/s", accel_unit="mg", sample_rate_hz=50.0, device="A1"
    )
    np.testing.assert_allclose(record.time, [0.0, 0.02, 0.04, 0.06], atol=1e-15)
    assert (record.gyro_unit, record.accel_unit, record.frame, record.state, record.device) == (
        "dps",
        "mg",
        "s",
        "raw",
        "A1",
    )
    timed = Record.from_arrays(gyro=gyro, gyro_unit="dps", time=[0.0, 0.1, 0.2, 0.4], temp_c=[25.0] * 4)
    np.testing.assert_array_equal(timed.temp_c, 25.0)
    assert timed.accel is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"gyro": np.zeros((5, 3)), "sample_rate_hz": 10.0}, "gyro_unit='dps'"),
        ({"gyro": np.zeros((3, 50)), "gyro_unit": "dps", "sample_rate_hz": 10.0}, r"got \(3, 50\)"),
        ({"gyro": np.zeros((5, 3)), "gyro_unit": "dps"}, "got neither"),
        ({"gyro": np.zeros((5, 3)), "gyro_unit": "dps", "sample_rate_hz": 0.0}, "got 0 Hz"),
        ({"sample_rate_hz": 10.0}, "accel readings"),
    ],
)
def test_arrays_that_leave_something_open_are_refused(given, said):
    with pytest.raises(InputError, match=said):
        Record.from_arrays(**given)


# ---- session, Still and Turn: ranges lie inside their recordings, gravity is a gravity

RECORD = Record(time=np.arange(100) / 100, gyro=np.zeros((100, 3)))
KEYS = {"kind": "calibration", "serial": "A1", "gravity_m_s2": 9.81, "records": (RECORD,)}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"records": ()}, "one recording"),
        ({"gravity_m_s2": 1.0}, "got 1"),
        ({"gravity_m_s2": float("nan")}, "local gravity"),
        (
            {"stills": (Still(start=50, stop=101),)},
            r"\[50, 101\) of recording",
        ),
        ({"turns": (Turn(start=0, stop=5, recording=1),)}, r"got \[0, 5\) of recording 1"),
    ],
)
def test_a_session_that_does_not_fit_together_is_refused(change, words):
    with pytest.raises(InputError, match=words):
        Session(**(KEYS | change))


@pytest.mark.parametrize("piece", [Still, Turn])
@pytest.mark.parametrize(("start", "stop"), [(5, 5), (6, 5), (-1, 5)])
def test_an_empty_or_negative_range_is_refused(piece, start, stop):
    with pytest.raises(InputError, match=rf"got \[{start}, {stop}\)"):
        piece(start=start, stop=stop)
