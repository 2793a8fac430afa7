"""Sound input: simulated devices, what was recorded with them, and the truth about it. Made once in a process, 1 s in all."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

import undrift
from undrift.arrays import FloatArray
from undrift.io.text import write_rows
from undrift.sim.device.presets import Grade, grade_of
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.motion.motion import Motion
from undrift.sim.thermal import ThermalSettings
from undrift.units import RADIAN_PER_DEGREE, gravity_at

TEMP_C = 25.0
LATITUDE_DEG = 60.0  # Where all of it was recorded, at the level of the sea
GRAVITY = gravity_at(LATITUDE_DEG, 0.0)
SI = {"time": "s", "gyro": "rad/s", "accel": "m/s2", "temp": "degC"}
GYRO, ACCEL = ("gx", "gy", "gz"), ("ax", "ay", "az")


SET_POINTS_C = (10.0, 17.0, 25.0, 33.0, 41.0)
FACES_AND_TURNS = BenchSettings(gravity_m_s2=GRAVITY)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A file of a foreign logger, and the map that a person wrote for it."""

    columns: Mapping[str, FloatArray]
    gyro: tuple[str, ...] = GYRO  # As the map states them, x, y, z
    accel: tuple[str, ...] = ACCEL
    temp: str = "T"  # "" leaves it out of the map
    units: Mapping[str, str] = field(default_factory=lambda: SI)
    sample_rate_hz: float | None = None  # Stated in place of the column of time
    more: str = ""  # Further lines of the map

    def with_columns(self, **columns: FloatArray) -> "Recording":
        """Return it with other columns in the file."""
        return replace(self, columns={**self.columns, **columns})

    def scaled(self, names: tuple[str, ...], factor: float) -> "Recording":
        """Return it with some columns times a factor in the file."""
        return self.with_columns(**{name: factor * self.columns[name] for name in names})

    def rows(self, chosen: FloatArray) -> "Recording":
        """Return it with the chosen rows alone."""
        return replace(self, columns={name: values[chosen] for name, values in self.columns.items()})

    def in_units(self, **units: str) -> "Recording":
        """Return it with other units stated in the map."""
        return replace(self, units={**self.units, **units})

    def map_text(self) -> str:
        """Return the map as TOML."""
        by_time = self.sample_rate_hz is None
        columns = [*(['time = "t"'] if by_time else []), f"gyro = {list(self.gyro)}", f"accel = {list(self.accel)}"]
        columns += [f'temp = "{self.temp}"'] if self.temp else []
        units = {k: v for k, v in self.units.items() if (k != "time" or by_time) and (k != "temp" or self.temp)}
        stated = ", ".join(f'{name} = "{unit}"' for name, unit in units.items())
        lines = [] if by_time else [f"sample_rate_hz = {self.sample_rate_hz}"]
        return "\n".join((*lines, f"columns = {{ {', '.join(columns)} }}", f"units = {{ {stated} }}", self.more)) + "\n"

    def record(self) -> undrift.Record:
        """Return it as a person makes a Record of arrays."""
        gyro, accel = (np.column_stack([self.columns[k] for k in names]) for names in (self.gyro, self.accel))
        clock = {"sample_rate_hz": self.sample_rate_hz} if self.sample_rate_hz else {"time": self.columns["t"]}
        units = {"gyro_unit": self.units["gyro"], "accel_unit": self.units["accel"]}
        return undrift.Record.from_arrays(gyro=gyro, accel=accel, temp_c=self.columns["T"], **units, **clock)

    def plain(self) -> "Recording":
        """Return it with the names that the map gives its columns: a file whose head says what the map says."""
        names = {"t": "t", **dict(zip((*GYRO, *ACCEL), (*self.gyro, *self.accel), strict=True)), "temperature": "T"}
        columns = {name: self.columns[other] for name, other in names.items()}
        return replace(self, columns=columns, gyro=GYRO, accel=ACCEL, temp="temperature")

    def write(self, folder: Path, name: str) -> Path:
        """Write the file."""
        columns = {key: values for key, values in self.columns.items() if key != "t" or self.sample_rate_hz is None}
        write_rows(folder / name, list(columns), list(columns.values()))
        return folder / name


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """A recording of a worn device with what was true."""

    recording: Recording
    record: undrift.Record
    reference: undrift.Reference
    motion: Motion
    right: undrift.Record  # The record as the true calibration corrects it


def recording_of(record: undrift.Record) -> Recording:
    """Return a record in rad/s and m/s2, or in counts, as a foreign file with its right map."""
    gyro, accel = np.asarray(record.gyro), np.asarray(record.accel)
    temp = np.full(len(record), TEMP_C) if record.temp_c is None else record.temp_c
    columns = {"t": record.time, **dict(zip(GYRO, gyro.T, strict=True)), **dict(zip(ACCEL, accel.T, strict=True))}
    units = SI | {"gyro": record.gyro_unit, "accel": record.accel_unit}
    return Recording(columns=columns | {"T": temp}, units=units)


def _si(grade: Grade) -> Grade:
    """Return a grade whose devices write rad/s and m/s2, as phones do."""
    return replace(
        grade,
        gyro=replace(grade.gyro, unit="rad/s", sensitivity=1.0, adc=None),
        accel=replace(grade.accel, unit="m/s2", sensitivity=1.0, adc=None),
    )


@cache
def phone(seed: int = 11):
    """Return a device that writes rad/s and m/s2; another seed is another device."""
    return undrift.random_device(np.random.default_rng(seed), grade=_si(grade_of("consumer")))


@cache
def counter(seed: int = 12):
    """Return a device that writes counts."""
    return undrift.random_device(np.random.default_rng(seed), grade="consumer")


@cache
def trial(task: str = "free", seed: int = 11) -> Trial:
    """Return a recording of the phone in motion, between two rests."""
    result = undrift.simulate_trial(
        task, phone(seed), rng=np.random.default_rng(21), temp_c=TEMP_C, gravity_m_s2=GRAVITY
    )
    record = replace(result.record, device="")
    right = undrift.correct(record, true_calibration(replace(phone(seed), serial="")))
    return Trial(
        recording=recording_of(record), record=record, reference=result.reference, motion=result.motion, right=right
    )


def _pose_session(seed: int) -> undrift.Session:
    brisk = BenchSettings(gravity_m_s2=GRAVITY, move_s=1.2)
    return undrift.simulate_session(
        "multi_position",
        phone(seed),
        rng=np.random.default_rng(31),
        settings=brisk,
        temp_c=TEMP_C,
        labelled=False,
    )


@cache
def poses(seed: int = 11) -> Recording:
    """Return free poses of a phone, nothing labelled."""
    return recording_of(_pose_session(seed).records[0])


@cache
def calibrated(seed: int = 11, *, remounted_: bool = False) -> undrift.Calibration:
    """Return a sound calibration of a phone, whose files state no serial number."""
    session = _pose_session(seed)
    record = replace(session.records[0], device="")
    if remounted_:
        columns = remounted(recording_of(record)).columns
        gyro, accel = (np.column_stack([columns[name] for name in names]) for names in (GYRO, ACCEL))
        record = replace(record, gyro=gyro, accel=accel)
    return undrift.calibrate(replace(session, serial="", records=(record,)))


def remounted(one: Recording) -> Recording:
    """Return what the device writes with its x where z was, y where x was, z where y was."""
    columns = {"gx": "gz", "gy": "gx", "gz": "gy", "ax": "az", "ay": "ax", "az": "ay"}
    return one.with_columns(**{name: one.columns[other] for name, other in columns.items()})


@cache
def faces_and_turns() -> Recording:
    """Return six faces and a full turn about each axis, nothing labelled."""
    session = undrift.simulate_session(
        "ferraris", phone(), rng=np.random.default_rng(41), settings=FACES_AND_TURNS, temp_c=TEMP_C
    )
    return recording_of(session.records[0])


@cache
def table_session() -> undrift.Session:
    """Return six faces and a rate table, labelled, of a device that writes counts."""
    rates = tuple(rate * RADIAN_PER_DEGREE for rate in (30.0, 60.0, 90.0))
    settings = BenchSettings(gravity_m_s2=GRAVITY, turn_rates=rates, dwell_s=2.0, first_still_s=6.0)
    return undrift.simulate_session("bench", counter(), rng=np.random.default_rng(51), settings=settings, temp_c=TEMP_C)


@cache
def table_alone() -> undrift.Session:
    """Return a rate table, of the device that writes counts."""
    rates = tuple(rate * RADIAN_PER_DEGREE for rate in (30.0, 60.0, 90.0))
    settings = BenchSettings(gravity_m_s2=GRAVITY, turn_rates=rates, dwell_s=4.0)
    return undrift.simulate_session(
        "rate_table", counter(), rng=np.random.default_rng(53), settings=settings, temp_c=TEMP_C
    )


@cache
def hand_session() -> undrift.Session:
    """Return six faces and three full turns by hand, labelled, of a device that writes counts."""
    return undrift.simulate_session(
        "ferraris", counter(), rng=np.random.default_rng(52), settings=FACES_AND_TURNS, temp_c=TEMP_C
    )


@cache
def counted_trial() -> Trial:
    """Return a recording in counts, with the truth, for what a calibration of counts makes of it."""
    result = undrift.simulate_trial(
        "free", counter(), rng=np.random.default_rng(22), temp_c=TEMP_C, gravity_m_s2=GRAVITY
    )
    right = undrift.correct(result.record, true_calibration(counter()))
    return Trial(
        recording=recording_of(result.record),
        record=result.record,
        reference=result.reference,
        motion=result.motion,
        right=right,
    )


@cache
def soak(seed: int = 11) -> undrift.Session:
    """Return rests of a phone at five temperatures; the thermometer is in the file."""
    bench = BenchSettings(gravity_m_s2=GRAVITY, sample_rate_hz=20.0, turn_rates=(), still_s=20.0)
    settings = ThermalSettings(bench=bench, set_points_c=SET_POINTS_C)
    session = undrift.simulate_thermal_session("soak", phone(seed), rng=np.random.default_rng(61), settings=settings)
    return replace(session, serial="", records=tuple(replace(record, device="") for record in session.records))


@cache
def ramp(seed: int = 11) -> Recording:
    """Return a phone at rest in a ramp up and back, at 4 Hz."""
    bench = BenchSettings(gravity_m_s2=GRAVITY, sample_rate_hz=4.0, turn_rates=())
    settings = ThermalSettings(bench=bench, ramp_c=(12.0, 40.0), ramp_c_per_min=2.0, ramp_hold_s=120.0)
    session = undrift.simulate_thermal_session("ramp", phone(seed), rng=np.random.default_rng(62), settings=settings)
    return recording_of(session.records[0])


@cache
def rest() -> Recording:
    """Return a phone at rest for ten minutes, for its noise."""
    bench = BenchSettings(gravity_m_s2=GRAVITY, sample_rate_hz=50.0, turn_rates=())
    settings = ThermalSettings(bench=bench, ramp_c=(25.0, 25.01), ramp_hold_s=300.0)
    session = undrift.simulate_thermal_session("ramp", phone(), rng=np.random.default_rng(63), settings=settings)
    return recording_of(session.records[0])
