"""One table of units: every spelling has one name, and device units have no SI value."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.strategies import few
from undrift.errors import InputError
from undrift.units import STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

RATES = [
    ("rad/s", 1.0),
    ("dps", math.pi / 180),
    ("deg/s", math.pi / 180),
    ("°/s", math.pi / 180),
    (" Deg/Sec ", math.pi / 180),
]


@pytest.mark.parametrize(("unit", "factor"), RATES)
def test_a_rate_in_any_spelling_has_its_factor(unit, factor):
    assert si_factor(unit, "rate") == factor


def test_the_other_quantities_have_theirs():
    assert si_factor("g", "accel") == STANDARD_GRAVITY == 9.80665  # ISO 80000-3
    assert si_factor("mg", "accel") == pytest.approx(9.80665e-3)
    assert si_factor("m/s^2", "accel") == 1.0
    assert si_factor("us", "time") == 1e-6
    assert si_factor("min", "time") == 60.0
    assert si_factor("gauss", "mag") == 100.0
    assert si_factor("mm", "length") == 1e-3
    assert si_factor("°C", "temp") == 1.0


@few
@given(quantity=st.sampled_from(["rate", "accel", "temp", "time", "mag", "length"]), data=st.data())
def test_a_canonical_name_stays_itself(quantity, data):
    from undrift.units import _TO_SI

    unit = data.draw(st.sampled_from(sorted(_TO_SI[quantity])))
    assert canonical_unit(unit.upper(), quantity) == unit
    assert si_factor(unit, quantity) > 0.0


def test_g_is_no_unit_of_rate_and_a_device_unit_no_time():
    with pytest.raises(InputError, match=r"unit of rate: expected one of rad/s, dps, count, v, got 'g'. Name the unit"):
        canonical_unit("g", "rate")
    with pytest.raises(InputError, match=r"unit of time: expected one of s, ms, us, ns, min, date, got 'count'"):
        canonical_unit("count", "time")
    with pytest.raises(InputError, match="rate: expected a physical unit, got count"):
        si_factor("LSB", "rate")
    assert is_physical("dps")
    assert not is_physical("count")
    assert not is_physical("v")
