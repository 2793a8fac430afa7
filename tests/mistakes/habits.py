"""What a person does to a recording or its map, the same for every file; each of them with the words that name it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mistakes import causes
from mistakes.sound import ACCEL, GYRO, Recording

G = 9.80665


@dataclass(frozen=True, slots=True, kw_only=True)
class Habit:
    """One change of recordings."""

    name: str
    change: Callable[[Recording], Recording]
    named: tuple[str, ...]


def _columns(**mapped: tuple[str, ...]) -> Callable[[Recording], Recording]:
    return lambda one: replace(one, **mapped)  # type: ignore[arg-type]


def _times(names: tuple[str, ...], factor: float) -> Callable[[Recording], Recording]:
    return lambda one: one.scaled(names, factor)


def without_time(one: Recording, sample_rate_hz: float) -> Recording:
    """Return it without a column of time."""
    return replace(one, sample_rate_hz=sample_rate_hz)


def usual_rate(one: Recording) -> float:
    """Return its sample rate as a person would state it, Hz."""
    return float(round(1.0 / np.median(np.diff(one.columns["t"]))))


def without_gravity(one: Recording) -> Recording:
    """Return what an app calls linear acceleration: gravity is removed by the orientation that the app knows."""
    force = np.stack([one.columns[name] for name in ACCEL], axis=1)
    window = 101  # the app's low-pass of gravity, in samples
    kernel = np.ones(window) / window
    slow = np.stack([np.convolve(column, kernel, mode="same") for column in force.T], axis=1)
    gravity = G * slow / np.linalg.norm(slow, axis=1)[:, None]
    return one.with_columns(**dict(zip(ACCEL, (force - gravity).T, strict=True)))


def clipped(one: Recording, names: tuple[str, ...], limit: float) -> Recording:
    """Return it as a device of a smaller range writes it."""
    return one.with_columns(**{name: np.clip(one.columns[name], -limit, limit) for name in names})


ACCEL_XY = Habit(
    name="maps the accelerometer columns x and y exchanged",
    change=_columns(accel=("ay", "ax", "az")),
    named=causes.exchanged(causes.ACCEL, "x", "y"),
)
ACCEL_YZ = Habit(
    name="maps the accelerometer columns y and z exchanged",
    change=_columns(accel=("ax", "az", "ay")),
    named=causes.exchanged(causes.ACCEL, "y", "z"),
)
ACCEL_RING = Habit(
    name="maps the accelerometer columns in a ring, y z x",
    change=_columns(accel=("ay", "az", "ax")),
    named=causes.ring(causes.ACCEL),
)
GYRO_XY = Habit(
    name="maps the gyroscope columns x and y exchanged",
    change=_columns(gyro=("gy", "gx", "gz")),
    named=causes.exchanged(causes.GYRO, "x", "y"),
)
GYRO_YZ = Habit(
    name="maps the gyroscope columns y and z exchanged",
    change=_columns(gyro=("gx", "gz", "gy")),
    named=causes.exchanged(causes.GYRO, "y", "z"),
)
GYRO_RING = Habit(
    name="maps the gyroscope columns in a ring, z x y",
    change=_columns(gyro=("gz", "gx", "gy")),
    named=causes.ring(causes.GYRO),
)
GYRO_Y_REVERSED = Habit(
    name="has a logger that writes gyroscope y with the other sign",
    change=_times(("gy",), -1.0),
    named=causes.reversed_(causes.GYRO, "y"),
)
GYRO_REVERSED = Habit(
    name="has a logger that counts turns as left-handed, all gyroscope columns reversed",
    change=_times(GYRO, -1.0),
    named=(r"all gyroscope columns are reversed", rf"{causes.GYRO}[^;]*(?:opposite sign|left-handed)"),
)
ACCEL_Z_REVERSED = Habit(
    name="has a logger that writes accelerometer z with the other sign",
    change=_times(("az",), -1.0),
    named=causes.reversed_(causes.ACCEL, "z"),
)
NEGATED = Habit(
    name="has a logger that writes acceleration with the opposite sign, as iOS does",
    change=_times(ACCEL, -1.0),
    named=causes.NEGATED,
)
LEFT_HANDED = Habit(
    name="has a logger whose frame is left-handed: y of both sensors reversed",
    change=_times(("ay", "gy"), -1.0),
    named=causes.LEFT_HANDED,
)
DPS_FOR_RAD = Habit(
    name="states rad/s of a gyroscope that writes deg/s",
    change=_times(GYRO, 180.0 / np.pi),
    named=causes.DPS_FOR_RAD,
)
RAD_FOR_DPS = Habit(
    name="states deg/s of a gyroscope that writes rad/s",
    change=lambda one: one.in_units(gyro="dps"),
    named=causes.RAD_FOR_DPS,
)
MDPS_FOR_DPS = Habit(
    name="states deg/s of a gyroscope that writes mdeg/s",
    change=lambda one: one.scaled(GYRO, 1e3 * 180.0 / np.pi).in_units(gyro="dps"),
    named=causes.MDPS_FOR_DPS,
)
COUNTS_FOR_DPS = Habit(
    name="states deg/s of a gyroscope that writes counts, 16.4 per deg/s",
    change=lambda one: one.scaled(GYRO, 16.4 * 180.0 / np.pi).in_units(gyro="dps"),
    named=(*causes.COUNTS_FOR_DPS, rf"{causes.GYRO}[^;]*16(?:\.\d+)? times[^;]*"),
)
G_FOR_SI = Habit(
    name="states m/s2 of an accelerometer that writes g", change=_times(ACCEL, 1.0 / G), named=causes.G_FOR_SI
)
SI_FOR_G = Habit(
    name="states g of an accelerometer that writes m/s2",
    change=lambda one: one.in_units(accel="g"),
    named=causes.SI_FOR_G,
)
MG_FOR_SI = Habit(
    name="states m/s2 of an accelerometer that writes mg", change=_times(ACCEL, 1e3 / G), named=causes.MG_FOR_SI
)
MG_FOR_G = Habit(
    name="states g of an accelerometer that writes mg",
    change=lambda one: one.scaled(ACCEL, 1e3 / G).in_units(accel="g"),
    named=causes.MG_FOR_G,
)
MS_FOR_S = Habit(name="states s of a time in ms", change=_times(("t",), 1e3), named=causes.MS)
US_FOR_S = Habit(name="states s of a time in us", change=_times(("t",), 1e6), named=causes.US)
NS_FOR_S = Habit(name="states s of a time in ns", change=_times(("t",), 1e9), named=causes.NS)
S_FOR_MS = Habit(
    name="states ms of a time in s",
    change=lambda one: one.in_units(time="ms"),
    named=causes.time_in("(?:seconds|s)"),
)
HALF_RATE = Habit(
    name="declares 50 samples a second of a file with 100",
    change=lambda one: without_time(one, 0.5 * usual_rate(one)),
    named=causes.rate(100, 50),
)
DOUBLE_RATE = Habit(
    name="declares 200 samples a second of a file with 100",
    change=lambda one: without_time(one, 2.0 * usual_rate(one)),
    named=causes.rate(100, 200),
)
TEMPERATURE_AS_ACCEL = Habit(
    name="maps the temperature as accelerometer z",
    change=_columns(accel=("ax", "ay", "T")),
    named=causes.OTHER_COLUMN,
)
SENSORS_SWAPPED = Habit(
    name="maps the accelerometer as gyroscope and the gyroscope as accelerometer",
    change=_columns(gyro=ACCEL, accel=GYRO),
    named=causes.SWAPPED,
)
NO_GRAVITY = Habit(
    name="takes the app's linear acceleration, without gravity", change=without_gravity, named=causes.NO_GRAVITY
)
DOUBLED_ROWS = Habit(
    name="has every row twice, in a file without time",
    change=lambda one: without_time(one.rows(np.repeat(np.arange(len(one.columns["t"])), 2)), usual_rate(one)),
    named=(*causes.REPEATED, *causes.rate(200, 100)),
)
REVERSED_TIME = Habit(
    name="has the rows in reverse order, in a file without time",
    change=lambda one: without_time(one.rows(np.arange(len(one.columns["t"]))[::-1]), usual_rate(one)),
    # Played backward, every turn has the other sign: nothing else shows
    named=(*causes.BACKWARD, r"all gyroscope columns are reversed"),
)
BACKWARD_TIME = Habit(
    name="has the rows in reverse order, with their time",
    change=lambda one: one.rows(np.arange(len(one.columns["t"]))[::-1]),
    named=causes.BACKWARD,
)
GYRO_CLIPPED = Habit(
    name="moves faster than the gyroscope's range of 60 deg/s",
    change=lambda one: clipped(one, GYRO, np.radians(60.0)),
    named=causes.SATURATED,
)
ACCEL_CLIPPED = Habit(
    name="has an accelerometer whose range ends at 0.8 g",
    change=lambda one: clipped(one, ACCEL, 0.8 * G),
    named=causes.SATURATED,
)
FAHRENHEIT = Habit(
    name="states degC of a temperature in degF",
    change=lambda one: one.with_columns(T=1.8 * one.columns["T"] + 32.0),
    named=causes.FAHRENHEIT,
)
KELVIN = Habit(
    name="states degC of a temperature in K",
    change=lambda one: one.with_columns(T=one.columns["T"] + 273.15),
    named=causes.KELVIN,
)
TEMP_COUNTS = Habit(
    name="states degC of a temperature in counts",
    change=lambda one: one.with_columns(T=340.0 * (one.columns["T"] - 36.53)),
    named=causes.TEMP_COUNTS,
)


def gap(one: Recording, start_s: float, stop_s: float, *, kept: bool) -> Recording:
    """Return it with a stretch of NaN, or without the rows of that stretch."""
    inside = (one.columns["t"] >= start_s) & (one.columns["t"] < stop_s)
    if not kept:
        return one.rows(np.flatnonzero(~inside))
    names = (*GYRO, *ACCEL)
    values = {name: np.where(inside, np.nan, one.columns[name]) for name in names}
    return replace(one.with_columns(**values), more='gaps = "keep"')
