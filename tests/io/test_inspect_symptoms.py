"""Each thing that is wrong in a recording is one finding with its numbers; a sound one has none."""

import numpy as np
import pytest

from undrift.io.columns import ReadResult
from undrift.io.inspect import describe_record, find_symptoms, gaps_of
from undrift.record import Record


def sound(n=2000, **change):
    rng = np.random.default_rng(8)
    keys = {
        "time": np.arange(n) / 100,
        "gyro": rng.normal(0.0, 0.1, (n, 3)),
        "accel": rng.normal([0, 0, 1], 0.002, (n, 3)),
        "temp_c": 25 + 0.1 * rng.normal(size=n),
        "gyro_unit": "dps",
        "accel_unit": "g",
    }
    return Record(**(keys | change))


def test_a_sound_recording_has_no_symptoms():
    assert find_symptoms(sound()) == ()
    counts = sound(accel=sound().accel * 4000, accel_unit="count", gyro=sound().gyro * 131, gyro_unit="count")
    assert find_symptoms(counts) == ()


def spiked(values, row, value):
    out = np.array(values)
    out[row] = value
    return out


CASES = [
    (
        "quarter g", {"accel": sound().accel / 4}, "recording.gravity", {"median_g": 0.25, "direction": "small"},
    ),
    (
        "m/s2 as g", {"accel": sound().accel * 9.81}, "recording.gravity",
        {"median_g": 9.81, "direction": "large"},
    ),
    (
        "rad/s for dps", {"gyro": sound().gyro + np.array([0, 40, 0])}, "recording.rest_rate", {"turn_rate_dps": 40.0},
    ),
    (
        "processor", {"temp_c": sound().temp_c + 28}, "recording.temperature", {"low_c": 52.65, "high_c": 53.35},
    ),
    (
        "jump", {"temp_c": spiked(sound().temp_c, 100, 147.7)}, "recording.temperature",
        {"count": 2, "first_sample": 99},
    ),
    ("no temperature", {"temp_c": np.full(2000, np.nan)}, "recording.temperature", {}),
    (
        "uneven", {"time": np.cumsum(np.random.default_rng(1).uniform(0.008, 0.012, 2000))}, "recording.uneven_sampling",
        {},
    ),
    (
        "drop-out", {"time": np.arange(2000) / 100 + 3.0 * (np.arange(2000) > 700)}, "recording.uneven_sampling",
        {"count": 1, "longest_s": 3.01},
    ),
    (
        "dead axis", {"gyro": sound().gyro * [1, 0, 1]}, "recording.dead_axis", {"channel": "gyro", "axis": "y"},
    ),
    (
        "saturated", {"gyro": spiked(sound().gyro, slice(50, 62), [0, 0, 250.0])}, "recording.saturated",
        {"channel": "gyro", "axis": "z", "count": 12},
    ),
]  # fmt: skip


@pytest.mark.parametrize(("change", "code", "values"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_each_symptom_is_one_finding(change, code, values):
    (found,) = find_symptoms(sound(**change))
    assert found.code == code
    for name, value in values.items():
        assert found.values[name] == (value if isinstance(value, str) else pytest.approx(value, rel=0.02))


def test_rows_left_out_are_counted():
    found = describe_record(ReadResult(record=sound(), dropped_rows=4, repaired_rows=2))
    assert [(item.code, item.values["count"]) for item in found.findings] == [
        ("recording.rows_left_out", 4),
        ("recording.rows_left_out", 2),
    ]


def test_gaps_are_counted_by_sample():
    gyro = np.array(sound().gyro)
    gyro[[3, 7]] = np.nan
    assert gaps_of(sound(gyro=gyro, temp_c=spiked(sound().temp_c, [7, 9], np.nan))) == 3
    assert gaps_of(sound()) == 0
    assert find_symptoms(sound(gyro=np.full((2000, 3), np.nan))) == ()
    assert find_symptoms(sound(n=20, temp_c=None)) == ()
