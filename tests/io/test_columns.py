"""A map says which column is which, states every unit, and guesses nothing."""

import pytest

from undrift.errors import InputError
from undrift.io.columns import ColumnMap, TextLayout, is_native, native_map

GYRO = {"gyro": ("a", "b", "c"), "gyro_unit": "dps"}


def test_native_names_need_no_map():
    names = (
        "time_s",
        "gyro_x_dps",
        "gyro_y_dps",
        "gyro_z_dps",
        "accel_x_m_s2",
        "accel_y_m_s2",
        "accel_z_m_s2",
        "temp_c",
    )
    found = native_map(names)
    assert found.time == "time_s"
    assert found.gyro == names[1:4]
    assert found.accel == names[4:7]
    assert (found.gyro_unit, found.accel_unit, found.temp_unit, found.mag) == ("dps", "m/s2", "degc", None)
    assert found.mapped() == ("time", "gyro", "accel", "temp")


@pytest.mark.parametrize(("suffix", "unit"), [("rad_s", "rad/s"), ("dps", "dps"), ("count", "count"), ("v", "v")])
def test_every_native_gyro_unit_is_recognised(suffix, unit):
    names = ("time_s", *(f"gyro_{axis}_{suffix}" for axis in "xyz"))
    assert native_map(names).unit_of("gyro") == unit


def test_names_that_only_look_native_are_not_guessed():
    assert not is_native(("Time", "gx", "gy", "gz", "gyro_x", "Gyro_X_dps", "accel_x_ms2"))
    with pytest.raises(InputError, match=r"expected names such as gyro_x_dps .* got 'gx'"):
        native_map(("gx", "gy", "gz"))


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("time_s", "gyro_x_dps", "gyro_y_dps"), "got only gyro_x_dps, gyro_y_dps. Add the missing axes"),
        (("time_s", *(f"gyro_{a}_{u}" for u in ("dps", "rad_s") for a in "xyz")), "expected gyro in one unit, got rad/s and dps"),
        (tuple(f"gyro_{a}_dps" for a in "xyz"), "expected a time column or sample_rate_hz, got neither"),
        (tuple(f"c{k}" for k in range(20)), r"... \(20 columns\)"),
        ((), "got no columns"),
    ],
)  # fmt: skip
def test_native_names_that_do_not_add_up_are_refused(names, words):
    with pytest.raises(InputError, match=words):
        native_map(names)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "expected gyro or accel, got neither"),
        ({"gyro": ("a", "b"), "gyro_unit": "dps"}, "columns.gyro: expected three columns x, y, z, got 2"),
        ({"gyro": ("a", "a", "b"), "gyro_unit": "dps"}, "expected three different columns"),
        ({"gyro": ("a", "b", "c")}, "units.gyro: expected the unit of gyro, got none"),
        ({"gyro": ("a", "b", "c"), "gyro_unit": "furlong"}, "unit of rate: expected one of"),
        ({**GYRO, "time": "t"}, "units.time: expected the unit"),
        ({**GYRO, "temp": "T", "temp_unit": "count"}, "expected degC, got count"),
        ({**GYRO, "mag": ("x", "y", "z"), "mag_unit": "count"}, "expected uT, got count"),
        ({**GYRO}, "got neither"),
        ({**GYRO, "sample_rate_hz": -5.0}, "expected Hz above 0, got -5"),
        ({**GYRO, "sample_rate_hz": 50.0, "gaps": "fill"}, "expected 'raise' or 'keep', got 'fill'"),
    ],
)
def test_a_map_that_is_not_complete_is_refused(keys, words):
    with pytest.raises(InputError, match=words):
        ColumnMap(**keys)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"delimiter": ",,"}, "delimiter: expected one character"),
        ({"delimiter": "\n"}, "delimiter: expected one character"),
        ({"decimal": ","}, "not the delimiter"),
        ({"decimal": "x"}, r"expected '\.' or ','"),
        ({"skip_rows": -1}, "skip_rows: expected 0 or more"),
    ],
)
def test_a_layout_that_cannot_be_is_refused(keys, words):
    with pytest.raises(InputError, match=words):
        TextLayout(**keys)
