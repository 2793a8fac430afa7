"""Each thing that is wrong in a recording is said in one sentence; a sound one has no symptoms."""

import numpy as np
import pytest

from undrift.io.inspect import find_symptoms, gaps_of
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
        "quarter g",
        {"accel": sound().accel / 4},
        "median |accel| is 0.25 g where a body at rest reads 1 g: wrong unit or scale (4 times",
    ),
    ("m/s2 as g", {"accel": sound().accel * 9.81}, "9.81 times too large"),
    ("rad/s for dps", {"gyro": sound().gyro + np.array([0, 40, 0])}, "gyro reads 40 deg/s in its quietest two seconds"),
    ("processor", {"temp_c": sound().temp_c + 28}, "is not room temperature: processor, chamber, or wrong scale"),
    (
        "jump",
        {"temp_c": spiked(sound().temp_c, 100, 147.7)},
        "temperature jumps by over 5 K between samples 2 times, first after sample 99",
    ),
    ("no temperature", {"temp_c": np.full(2000, np.nan)}, "the temperature column is empty"),
    ("uneven", {"time": np.cumsum(np.random.default_rng(1).uniform(0.008, 0.012, 2000))}, "sampling is uneven"),
    (
        "drop-out",
        {"time": np.arange(2000) / 100 + 3.0 * (np.arange(2000) > 700)},
        "1 drop-outs, the longest 3.01 s at 7 s",
    ),
    ("dead axis", {"gyro": sound().gyro * [1, 0, 1]}, "gyro y never changes"),
    (
        "saturated",
        {"gyro": spiked(sound().gyro, slice(50, 62), [0, 0, 250.0])},
        "gyro z stays at 250 for 12 samples in a row: saturated",
    ),
]


@pytest.mark.parametrize(("change", "words"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_each_symptom_is_one_sentence(change, words):
    found = find_symptoms(sound(**change))
    assert len(found) == 1
    assert words in found[0]


def test_rows_left_out_are_counted():
    assert find_symptoms(sound(), dropped_rows=4, repaired_rows=2) == (
        "4 rows did not parse and were left out",
        "2 rows whose time did not go forward were left out",
    )


def test_gaps_are_counted_by_sample():
    gyro = np.array(sound().gyro)
    gyro[[3, 7]] = np.nan
    assert gaps_of(sound(gyro=gyro, temp_c=spiked(sound().temp_c, [7, 9], np.nan))) == 3
    assert gaps_of(sound()) == 0
    assert find_symptoms(sound(gyro=np.full((2000, 3), np.nan))) == ()
    assert find_symptoms(sound(n=20, temp_c=None)) == ()
