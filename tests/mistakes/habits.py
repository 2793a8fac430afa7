"""What a person does to a recording or its map, the same for every command, and the text that names it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mistakes.sound import ACCEL, GYRO, Recording
from undrift.units import STANDARD_GRAVITY as G

DPS = 180.0 / np.pi
GYRO_NAMES, ACCEL_NAMES = "gx gy gz", "ax ay az"

SATURATED_SAYS = r"saturated|stuck at"
OTHER_DEVICE_SAYS = "calibration of another device|not this device's calibration"
ALREADY_SAYS = r"raw readings, got a corrected"
NOT_STILL_SAYS = r"not at rest|device at rest, got"
FAHRENHEIT_SAYS = "degF"
KELVIN_SAYS = r"in K, not degC|up to 300 degc.*(?:kelvin|in K\b)"
TEMP_COUNTS_SAYS = r"up to 300 degc"


def exchanged(triad: str, pair: str) -> str:
    """Return the text that names two exchanged columns."""
    return rf"{triad}\w* columns {pair[0]} and {pair[1]} are exchanged"


def wrong_rate(true_hz: int) -> str:
    """Return the text that names another sample rate, within 5 %."""
    return rf"the file has {true_hz // 10}\d samples a second"


@dataclass(frozen=True, slots=True)
class Habit:
    name: str
    change: Callable[[Recording], Recording]
    says: str


def _mapped(**columns: str) -> Callable[[Recording], Recording]:
    return lambda recording: replace(recording, **{name: tuple(text.split()) for name, text in columns.items()})


def _scaled(names: str, factor: float, **units: str) -> Callable[[Recording], Recording]:
    return lambda recording: recording.scaled(tuple(names.split()), factor).in_units(**units)


def _clipped(names: tuple[str, ...], limit: float) -> Callable[[Recording], Recording]:
    return lambda recording: recording.changed(names, lambda values: np.clip(values, -limit, limit))


def _temperature(change: Callable[[Any], Any]) -> Callable[[Recording], Recording]:
    return lambda recording: recording.with_columns(T=change(recording.columns["T"]))


def _rows_of(recording: Recording, order: Callable[[np.ndarray], np.ndarray]) -> Recording:
    return recording.rows(order(np.arange(len(recording.columns["t"]))))


def _backward(recording: Recording) -> Recording:
    return _rows_of(recording, np.flip)


def _at_rate(
    factor: float, order: Callable[[np.ndarray], np.ndarray] = lambda rows: rows
) -> Callable[[Recording], Recording]:
    """Return the change to a file without time, with a factor of its usual rate in the map."""

    def changed(recording: Recording) -> Recording:
        rate_hz = float(round(1.0 / np.median(np.diff(recording.columns["t"]))))
        return _rows_of(replace(recording, sample_rate_hz=factor * rate_hz), order)

    return changed


def _without_gravity(recording: Recording) -> Recording:
    """Return what an app calls linear acceleration: gravity is removed by the orientation that the app knows."""

    def linear(force: np.ndarray) -> np.ndarray:
        kernel = np.ones(101) / 101.0  # the app's low-pass of gravity
        slow = np.stack([np.convolve(column, kernel, mode="same") for column in force.T], axis=1)
        return force - G * slow / np.linalg.norm(slow, axis=1)[:, None]

    return recording.changed(ACCEL, linear)


def in_gap(recording: Recording, *, with_nan: bool) -> Recording:
    """Return the recording with NaN from 20 to 22 s, or without these rows."""
    inside = (recording.columns["t"] >= 20.0) & (recording.columns["t"] < 22.0)
    if not with_nan:
        return recording.rows(np.flatnonzero(~inside))
    columns = {name: np.where(inside, np.nan, recording.columns[name]) for name in (*GYRO, *ACCEL)}
    return replace(recording.with_columns(**columns), keys={"gaps": "keep"})


# ---- columns

ACCEL_XY = Habit(
    "maps the accelerometer columns x and y exchanged", _mapped(accel="ay ax az"), exchanged("accel", "xy")
)
ACCEL_YZ = Habit(
    "maps the accelerometer columns y and z exchanged", _mapped(accel="ax az ay"), exchanged("accel", "yz")
)
GYRO_XY = Habit("maps the gyroscope columns x and y exchanged", _mapped(gyro="gy gx gz"), exchanged("gyro", "xy"))
GYRO_YZ = Habit("maps the gyroscope columns y and z exchanged", _mapped(gyro="gx gz gy"), exchanged("gyro", "yz"))
ACCEL_RING = Habit("maps the accelerometer columns in a ring, y z x", _mapped(accel="ay az ax"), "exchanged in a ring")
GYRO_RING = Habit("maps the gyroscope columns in a ring, z x y", _mapped(gyro="gz gx gy"), "exchanged in a ring")
SENSORS_SWAPPED = Habit(
    "maps each sensor as the other", _mapped(gyro=ACCEL_NAMES, accel=GYRO_NAMES), "accelerometer columns are exchanged"
)
TEMPERATURE_AS_ACCEL = Habit(
    "maps the temperature as accelerometer z", _mapped(accel="ax ay T"), "accelerometer than for temperature"
)

# ---- signs

GYRO_Y_REVERSED = Habit("logs gyroscope y with the other sign", _scaled("gy", -1.0), "gyroscope column y is reversed")
GYRO_REVERSED = Habit("logs left-handed turns", _scaled(GYRO_NAMES, -1.0), "all gyroscope columns are reversed")
ACCEL_Z_REVERSED = Habit(
    "logs accelerometer z with the other sign", _scaled("az", -1.0), "accelerometer column z is reversed"
)
NEGATED = Habit("logs acceleration of the opposite sign, as iOS does", _scaled(ACCEL_NAMES, -1.0), "opposite sign")
LEFT_HANDED = Habit("has a left-handed frame, with y reversed", _scaled("ay gy", -1.0), "of both (?:triads|sensors)")

# ---- units

DPS_FOR_RAD = Habit("states rad/s of a gyroscope in deg/s", _scaled(GYRO_NAMES, DPS), "gyroscope is in deg/s")
RAD_FOR_DPS = Habit(
    "states deg/s of a gyroscope in rad/s", _scaled(GYRO_NAMES, 1.0, gyro="dps"), "gyroscope is in rad/s"
)
MDPS_FOR_DPS = Habit(
    "states deg/s of a gyroscope in mdeg/s", _scaled(GYRO_NAMES, 1e3 * DPS, gyro="dps"), "gyroscope in mdeg/s"
)
COUNTS_FOR_DPS = Habit(
    "states deg/s of a gyroscope in counts",
    _scaled(GYRO_NAMES, 16.4 * DPS, gyro="dps"),
    "gyroscope is in (?:counts|codes)",
)
G_FOR_SI = Habit("states m/s2 of an accelerometer in g", _scaled(ACCEL_NAMES, 1.0 / G), "is in g, not m/s2")
SI_FOR_G = Habit("states g of an accelerometer in m/s2", _scaled(ACCEL_NAMES, 1.0, accel="g"), "is in m/s2, not g")
MG_FOR_SI = Habit("states m/s2 of an accelerometer in mg", _scaled(ACCEL_NAMES, 1e3 / G), "is in mg, not m/s2")
MG_FOR_G = Habit("states g of an accelerometer in mg", _scaled(ACCEL_NAMES, 1e3 / G, accel="g"), "is in mg, not g")
MS_FOR_S = Habit("states s of a time in ms", _scaled("t", 1e3), "milliseconds")
US_FOR_S = Habit("states s of a time in us", _scaled("t", 1e6), "time is in microseconds")
NS_FOR_S = Habit("states s of a time in ns", _scaled("t", 1e9), "time is in nanoseconds")
S_FOR_MS = Habit("states ms of a time in s", _scaled("", 1.0, time="ms"), "time is in seconds")
FAHRENHEIT = Habit(
    "states degC of a temperature in degF", _temperature(lambda temp: 1.8 * temp + 32.0), FAHRENHEIT_SAYS
)
KELVIN = Habit("states degC of a temperature in K", _temperature(lambda temp: temp + 273.15), KELVIN_SAYS)
TEMP_COUNTS = Habit(
    "states degC of a temperature in counts", _temperature(lambda temp: 340.0 * (temp - 36.53)), TEMP_COUNTS_SAYS
)

# ---- time and range

HALF_RATE = Habit("declares 50 samples a second of a file with 100", _at_rate(0.5), wrong_rate(100))
DOUBLE_RATE = Habit("declares 200 samples a second of a file with 100", _at_rate(2.0), wrong_rate(100))
DOUBLED_ROWS = Habit(
    "has every row twice, without time", _at_rate(1.0, lambda rows: np.repeat(rows, 2)), wrong_rate(200)
)
REVERSED_TIME = Habit(  # played backward, every turn has the other sign: nothing else shows
    "has the rows in reverse order, without time", _at_rate(1.0, np.flip), "all gyroscope columns are reversed"
)
BACKWARD_TIME = Habit("has the rows in reverse order, with their time", _backward, "strictly increasing time")
NO_GRAVITY = Habit("takes the app's linear acceleration, without gravity", _without_gravity, "gravity is missing")
GYRO_CLIPPED = Habit(
    "moves faster than the gyroscope's range of 60 deg/s", _clipped(GYRO, np.radians(60.0)), SATURATED_SAYS
)
ACCEL_CLIPPED = Habit("has an accelerometer whose range ends at 0.8 g", _clipped(ACCEL, 0.8 * G), SATURATED_SAYS)
