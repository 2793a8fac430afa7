"""One table of units: every spelling has one name, and device units have no SI value."""

import math

import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.units import EARTH_RATE, STANDARD_GRAVITY, canonical_unit, gravity_at, is_physical, si_factor

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


def test_g_is_no_unit_of_rate_and_a_device_unit_no_time():
    with pytest.raises(InputError, match="got 'g'"):
        canonical_unit("g", "rate")
    with pytest.raises(InputError, match="got 'count'"):
        canonical_unit("count", "time")
    with pytest.raises(InputError, match="got count"):
        si_factor("LSB", "rate")
    assert is_physical("dps")
    assert not is_physical("count")
    assert not is_physical("v")


# ---- local gravity, held to published values


def test_normal_gravity_at_equator_and_pole_is_that_of_wgs_84():
    # NIMA TR8350.2, table 3.4: 9.7803253359 and 9.8321849378 m/s2
    show("equator", gravity_at(0.0), 9.7803253359)
    show("pole", gravity_at(90.0), 9.8321849378)
    assert gravity_at(0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert gravity_at(90.0) == pytest.approx(9.8321849378, abs=1e-9)
    assert gravity_at(-45.0) == gravity_at(45.0)


def test_gravity_falls_with_the_square_of_distance():
    # free-air gradient -3.0877e-6 per s2 at 45 deg (Heiskanen and Moritz 1967, eq. 2-215)
    assert (gravity_at(45.0, 100.0) - gravity_at(45.0, 0.0)) / 100.0 == pytest.approx(-3.0866e-6, rel=1e-3)
    # over 10 km: g / (1 + h / R)^2 with R the radius that gives this gradient
    radius = 2 * gravity_at(45.0) / 3.0866e-6
    assert gravity_at(45.0, 10_000.0) == pytest.approx(gravity_at(45.0) / (1 + 10_000.0 / radius) ** 2, rel=2e-6)


def test_the_earth_turns_once_in_a_sidereal_day():
    assert pytest.approx(86164.1, abs=0.1) == 2 * 3.141592653589793 / EARTH_RATE


@pytest.mark.parametrize(
    ("latitude_deg", "height_m", "words"),
    [
        (91.0, 0.0, "latitude_deg.* got 91"),
        (float("nan"), 0.0, "latitude_deg.* got nan"),
        (45.0, 2e5, "height_m.* got 200000"),
        (45.0, float("nan"), "height_m: expected .* got nan"),
    ],
)
def test_a_place_that_is_not_on_earth_is_refused(latitude_deg, height_m, words):
    with pytest.raises(InputError, match=words):
        gravity_at(latitude_deg, height_m)
