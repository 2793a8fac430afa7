"""Units: one table of names, one constant of gravity, and the only conversions in the package.

A quantity is one of ``rate``, ``accel``, ``temp``, ``time``, ``mag``, ``length``. Inside the package, values are SI
(rad/s, m/s2, s, m), degC and uT. Raw readings keep the unit of the device. ``count`` and ``v`` are device units: they have
no SI value without a calibration. ``lm335_v`` is the voltage of an LM335 thermometer, 10 mV/K from 0 K.
"""

import math
from typing import Literal

from undrift.errors import InputError

# ---- the Earth: rotation rate and local gravity

EARTH_RATE = 7.292115e-5  # rotation rate, rad/s, WGS 84
_LOWEST, _HIGHEST = -5000.0, 100e3  # heights, m: from below the deepest mine to above all aircraft


def gravity_at(latitude_deg: float, height_m: float = 0.0) -> float:
    """Return local gravity, m/s2, on and near the ellipsoid.

    It uses Somigliana's formula with the free-air correction to second order in height, WGS 84 [1]_::

        g0 = 9.7803253359 (1 + 0.00193185265241 s) / sqrt(1 - 0.00669437999014 s),   s = sin^2(latitude)
        g  = g0 (1 - 2/a (1 + f + m - 2 f s) h + 3 h^2 / a^2)

    References
    ----------
    .. [1] NIMA TR8350.2, "World Geodetic System 1984", 3rd ed., 2000, eqs. 4-1 and 4-3.
    """
    if not -90.0 <= latitude_deg <= 90.0:
        raise InputError(f"latitude_deg: expected -90 to 90 deg, got {latitude_deg:g}. South is negative.")
    if not _LOWEST <= height_m <= _HIGHEST:
        raise InputError(
            f"height_m: expected {_LOWEST:.0f} to {_HIGHEST:.0f} m above the ellipsoid, got {height_m:g}. Enter it in metres."
        )
    a, f, m = 6378137.0, 1.0 / 298.257223563, 0.00344978650684
    s = math.sin(math.radians(latitude_deg)) ** 2
    g0 = 9.7803253359 * (1.0 + 0.00193185265241 * s) / math.sqrt(1.0 - 0.00669437999014 * s)
    h = height_m
    return g0 * (1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * s) * h + 3.0 * h * h / (a * a))


# ---- table of units

Quantity = Literal["rate", "accel", "temp", "time", "mag", "length"]

STANDARD_GRAVITY = 9.80665  # standard gravity, m/s2, ISO 80000-3
# range of gravity from equator to pole, m/s2 (uniform distribution: standard uncertainty of 0.15 %)
INHABITED_GRAVITY = (9.780, 9.832)
RADIAN_PER_DEGREE = math.pi / 180.0
ZERO_CELSIUS_K = 273.15  # 0 degC, K

DEVICE_UNITS = ("count", "v")

# SI value = factor * value (+ offset for temperatures). The first unit of a quantity is SI. Names are in lower case.
_TO_SI: dict[Quantity, dict[str, float]] = {
    "rate": {"rad/s": 1.0, "dps": RADIAN_PER_DEGREE},
    "accel": {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY * 1e-3},
    "temp": {"degc": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "date": 1.0},  # date: s from the first date
    "mag": {"ut": 1.0, "gauss": 100.0, "mgauss": 0.1, "t": 1e6},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
}
_TEMP_OFFSET = {"degc": 0.0, "lm335_v": -ZERO_CELSIUS_K}
_SPELLINGS = {
    "deg/s": "dps", "°/s": "dps", "degrees/s": "dps", "rad/sec": "rad/s", "deg/sec": "dps", "rps": "rad/s",
    "m/s^2": "m/s2", "m/s²": "m/s2", "m/s/s": "m/s2", "deg c": "degc", "°c": "degc", "c": "degc", "celsius": "degc",
    "sec": "s", "seconds": "s", "µs": "us", "µt": "ut", "counts": "count", "lsb": "count", "raw": "count",
    "volt": "v", "volts": "v", "gs": "g", "millig": "mg", "degrees c": "degc", "cel": "degc",
    "℃": "degc", "radians/s": "rad/s", "degrees/sec": "dps", "millis": "ms", "micros": "us",
}  # fmt: skip
SI_UNIT = {quantity: next(iter(units)) for quantity, units in _TO_SI.items()}


def canonical_unit(unit: str, quantity: Quantity) -> str:
    """Return the canonical spelling of a unit."""
    name = unit.strip().lower()
    name = _SPELLINGS.get(name, name)
    if name in _TO_SI[quantity] or (name in DEVICE_UNITS and quantity in ("rate", "accel", "temp", "mag")):
        return name
    units = [*_TO_SI[quantity], *(DEVICE_UNITS if quantity in ("rate", "accel", "temp", "mag") else ())]
    raise InputError(
        f"unit of {quantity}: expected one of {', '.join(units)}, got '{unit}'. Correct the unit of the column."
    )


def si_factor(unit: str, quantity: Quantity) -> float:
    """Return the factor that converts a value in ``unit`` to SI (degC for temp, uT for mag)."""
    name = canonical_unit(unit, quantity)
    if name in DEVICE_UNITS:
        raise InputError(
            f"{quantity}: expected a physical unit, got {name}. Calibrate first, or set the scale of the column."
        )
    return _TO_SI[quantity][name]


def temp_offset(unit: str) -> float:
    """Return the offset to add to a temperature in ``unit`` after its factor, degC."""
    si_factor(unit, "temp")
    return _TEMP_OFFSET[canonical_unit(unit, "temp")]


def is_physical(unit: str) -> bool:
    """Return True if a unit has an SI value without a calibration. Counts and volts do not."""
    return unit not in DEVICE_UNITS
