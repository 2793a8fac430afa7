"""Sound input: simulated devices and what was recorded with them. Made once in a process."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import tomli_w

import undrift
from undrift.arrays import FloatArray
from undrift.io.text import write_rows
from undrift.sim.device.presets import grade_of
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import ThermalSettings
from undrift.units import RADIAN_PER_DEGREE, gravity_at

TEMP_C = 25.0
LATITUDE_DEG = 60.0  # all recordings were made here, at sea level
GRAVITY = gravity_at(LATITUDE_DEG, 0.0)
SI = {"time": "s", "gyro": "rad/s", "accel": "m/s2", "temp": "degC"}
GYRO, ACCEL = ("gx", "gy", "gz"), ("ax", "ay", "az")
SET_POINTS_C = (10.0, 17.0, 25.0, 33.0, 41.0)
RATES = tuple(rate * RADIAN_PER_DEGREE for rate in (30.0, 60.0, 90.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A file of a foreign logger, and the map that a person wrote for it."""

    columns: Mapping[str, FloatArray]
    gyro: tuple[str, ...] = GYRO  # columns in the map: x, y, z
    accel: tuple[str, ...] = ACCEL
    temp: str = "T"  # "" leaves it out of the map
    units: Mapping[str, str] = field(default_factory=lambda: SI)
    sample_rate_hz: float | None = None  # in the map, in place of the column of time
    keys: Mapping[str, str] = field(default_factory=dict)  # further keys of the map

    def with_columns(self, **columns: FloatArray) -> "Recording":
        return replace(self, columns={**self.columns, **columns})

    def scaled(self, names: tuple[str, ...], factor: float) -> "Recording":
        """Return the recording with some columns times a factor in the file."""
        return self.with_columns(**{name: factor * self.columns[name] for name in names})

    def changed(self, names: tuple[str, ...], change: Callable[[FloatArray], FloatArray]) -> "Recording":
        """Return the recording with a triad (N, 3) of the file changed."""
        values = change(np.stack([self.columns[name] for name in names], axis=1))
        return self.with_columns(**dict(zip(names, values.T, strict=True)))

    def rows(self, chosen: FloatArray) -> "Recording":
        return replace(self, columns={name: values[chosen] for name, values in self.columns.items()})

    def in_units(self, **units: str) -> "Recording":
        return replace(self, units={**self.units, **units})

    def map_text(self) -> str:
        """Return the map as TOML."""
        columns = {"time": "t", "gyro": self.gyro, "accel": self.accel, "temp": self.temp}
        absent = {"time"} if self.sample_rate_hz else set()
        absent |= set() if self.temp else {"temp"}
        columns, units = ({k: v for k, v in part.items() if k not in absent} for part in (columns, self.units))
        rate = {"sample_rate_hz": self.sample_rate_hz} if self.sample_rate_hz else {}
        return tomli_w.dumps({**rate, **self.keys, "columns": columns, "units": units})

    def record(self) -> undrift.Record:
        """Return the record that a person makes of arrays."""
        gyro, accel = (np.column_stack([self.columns[name] for name in names]) for names in (self.gyro, self.accel))
        clock = {"sample_rate_hz": self.sample_rate_hz} if self.sample_rate_hz else {"time": self.columns["t"]}
        units = {"gyro_unit": self.units["gyro"], "accel_unit": self.units["accel"]}
        return undrift.Record.from_arrays(gyro=gyro, accel=accel, temp_c=self.columns["T"], **units, **clock)

    def plain(self) -> "Recording":
        """Return the recording with the names of the map in the file, as the page proposes them."""
        names = {"t": "t", **dict(zip((*GYRO, *ACCEL), (*self.gyro, *self.accel), strict=True)), "temperature": "T"}
        columns = {name: self.columns[other] for name, other in names.items()}
        return replace(self, columns=columns, gyro=GYRO, accel=ACCEL, temp="temperature")

    def write(self, path: Path) -> Path:
        """Write the file."""
        columns = {name: values for name, values in self.columns.items() if name != "t" or not self.sample_rate_hz}
        write_rows(path, list(columns), list(columns.values()))
        return path


def recording_of(record: undrift.Record) -> Recording:
    """Return the file that a logger writes of a record."""
    gyro, accel = np.asarray(record.gyro), np.asarray(record.accel)
    temp = np.full(len(record), TEMP_C) if record.temp_c is None else record.temp_c
    columns = {"t": record.time, **dict(zip(GYRO, gyro.T, strict=True)), **dict(zip(ACCEL, accel.T, strict=True))}
    units = SI | {"gyro": record.gyro_unit, "accel": record.accel_unit}
    return Recording(columns=columns | {"T": temp}, units=units)


@cache
def phone(seed: int = 11) -> undrift.DeviceModel:
    """Return a device that writes rad/s and m/s2; another seed is another device."""
    grade = grade_of("consumer")
    gyro = replace(grade.gyro, unit="rad/s", sensitivity=1.0, adc=None)
    accel = replace(grade.accel, unit="m/s2", sensitivity=1.0, adc=None)
    return undrift.random_device(np.random.default_rng(seed), grade=replace(grade, gyro=gyro, accel=accel))


@cache
def board() -> undrift.DeviceModel:
    """Return a device that writes counts."""
    return undrift.random_device(np.random.default_rng(12), grade="consumer")


@cache
def trial(task: str = "free", seed: int = 11, draw: int = 21, temp_c: float = TEMP_C) -> undrift.SimulatedTrial:
    """Return a recording of the phone in motion, between two rests, and its reference."""
    return undrift.simulate_trial(
        task, phone(seed), rng=np.random.default_rng(draw), temp_c=temp_c, gravity_m_s2=GRAVITY
    )


def session(kind: str, device: undrift.DeviceModel, draw: int, **settings: object) -> undrift.Session:
    """Return a session on the bench; ``labelled`` is one of the settings."""
    labelled = bool(settings.pop("labelled", True))
    bench = BenchSettings(gravity_m_s2=GRAVITY, **settings)  # type: ignore[arg-type]
    return undrift.simulate_session(
        kind,  # type: ignore[arg-type]
        device,
        rng=np.random.default_rng(draw),
        settings=bench,
        temp_c=TEMP_C,
        labelled=labelled,
    )


@cache
def pose_session(seed: int = 11) -> undrift.Session:
    """Return free poses of a phone, nothing labelled."""
    return session("multi_position", phone(seed), 31, move_s=1.2, labelled=False)


def poses(seed: int = 11) -> Recording:
    return recording_of(pose_session(seed).records[0])


@cache
def calibrated(seed: int = 11, *, remounted_axes: bool = False) -> undrift.Calibration:
    """Return a sound calibration of a phone, whose files have no serial number."""
    record = replace(pose_session(seed).records[0], device="")
    if remounted_axes:
        columns = remounted(recording_of(record)).columns
        gyro, accel = (np.column_stack([columns[name] for name in names]) for names in (GYRO, ACCEL))
        record = replace(record, gyro=gyro, accel=accel)
    return undrift.calibrate(replace(pose_session(seed), serial="", records=(record,)))


def remounted(recording: Recording) -> Recording:
    """Return what the device writes with its x where z was, y where x was, z where y was."""
    columns = {"gx": "gz", "gy": "gx", "gz": "gy", "ax": "az", "ay": "ax", "az": "ay"}
    return recording.with_columns(**{name: recording.columns[other] for name, other in columns.items()})


@cache
def faces_and_turns(**settings: float) -> Recording:
    """Return six faces and a full turn about each axis, nothing labelled."""
    return recording_of(session("ferraris", phone(), 41, **settings).records[0])


@cache
def table_session() -> undrift.Session:
    """Return six faces and a rate table, labelled, of a device that writes counts."""
    return session("bench", board(), 51, turn_rates=RATES, dwell_s=2.0, first_still_s=6.0)


@cache
def table_without_faces() -> undrift.Session:
    """Return a rate table, of the device that writes counts."""
    return session("rate_table", board(), 53, turn_rates=RATES, dwell_s=4.0)


@cache
def hand_session() -> undrift.Session:
    """Return six faces and three full turns by hand, labelled, of a device that writes counts."""
    return session("ferraris", board(), 52)


def thermal_session(kind: str, seed: int, draw: int, bench: dict[str, float], **settings: object) -> undrift.Session:
    """Return a session of a phone over temperature, without rates."""
    settings |= {"bench": BenchSettings(gravity_m_s2=GRAVITY, turn_rates=(), **bench)}  # type: ignore[arg-type]
    return undrift.simulate_thermal_session(
        kind,  # type: ignore[arg-type]
        phone(seed),
        rng=np.random.default_rng(draw),
        settings=ThermalSettings(**settings),  # type: ignore[arg-type]
    )


@cache
def soak(seed: int = 11) -> undrift.Session:
    """Return rests of a phone at five temperatures; the thermometer is in the file."""
    bench = {"sample_rate_hz": 20.0, "still_s": 20.0}
    made = thermal_session("soak", seed, 61, bench, set_points_c=SET_POINTS_C)
    return replace(made, serial="", records=tuple(replace(record, device="") for record in made.records))


@cache
def ramp() -> Recording:
    """Return a phone at rest in a ramp up and back, at 4 Hz."""
    course = {"ramp_c": (12.0, 40.0), "ramp_c_per_min": 2.0, "ramp_hold_s": 120.0}
    return recording_of(thermal_session("ramp", 11, 62, {"sample_rate_hz": 4.0}, **course).records[0])


@cache
def rest() -> Recording:
    """Return a phone at rest for ten minutes, for its noise."""
    course = {"ramp_c": (25.0, 25.01), "ramp_hold_s": 300.0}
    return recording_of(thermal_session("ramp", 11, 63, {"sample_rate_hz": 50.0}, **course).records[0])
