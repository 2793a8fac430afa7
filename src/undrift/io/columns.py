"""Convert the named columns of a file to a Record. Every value, unit and time that a reader returns is checked here, and only here.

    value = gain * cell + offset          then the unit is applied; gain 1 and offset 0 unless a ChannelScale is given

A reader returns a :class:`RawTable`. The map assigns its columns. It is given by the caller or contained in the file.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.base.codec import tree_of
from undrift.errors import FileFormatError, InputError
from undrift.findings import Finding, finding
from undrift.frames import Frame
from undrift.io.arrow import from_arrow
from undrift.io.clock import ClockFit, fit_clock, unwrapped
from undrift.io.column_map import (
    AXES,
    NATIVE,
    QUANTITY,
    Channel,
    Column,
    ColumnMap,
    check_map,
    map_of_channels,
    naming,
)
from undrift.io.labels import label_of
from undrift.record import ForceUncertainty, Record, State, sample_rate_of
from undrift.units import si_factor

EPOCH_S = 1e8  # a larger time counts from 1970 and is printed relative to the first sample
KIND, FORMAT = "undrift.record", 1  # kind and format of undrift's own recordings, in Parquet and next to CSV


# ---- a table of named columns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RawTable:
    """Columns of a file."""

    source: str  # file, for error messages
    names: tuple[str, ...]  # column names as in the file, or positions as text without a header
    # one numpy array or Arrow column for each name, all of the same length (text if the cells are not numbers)
    columns: tuple[Any, ...]
    # (N,), number of each row in the file, from 0, or None if no row was omitted
    rows: IntArray | None = None
    dropped: int = 0  # number of omitted rows
    own: ColumnMap | None = None  # map of the columns, if the file contains it
    marks: Mapping[str, Any] = field(default_factory=dict)  # state and uncertainties from the file, as keys of Record
    notes: tuple[str, ...] = ()  # notes on the reading: units from a manual, skipped lines, omitted rows
    epoch_s: float = 0.0  # Unix time that was subtracted from the clock, s
    # time (M,), s on the recording's clock, and temperature (M,), degC, of a separate thermometer
    thermometer: tuple[FloatArray, FloatArray] | None = None

    def __len__(self) -> int:
        return len(self.columns[0]) if self.columns else 0

    def position(self, column: Column) -> int:
        """Return the position of a column."""
        return find_column(self.names, column, self.source)

    def cells(self, position: int) -> np.ndarray[Any, Any]:
        """Return the cells of a column. Characters that are not UTF-8 are replaced."""
        values = self.columns[position]
        return values if isinstance(values, np.ndarray) else from_arrow(values)

    def numbers(self, column: Column) -> FloatArray:
        """Return a column as float64."""
        position = self.position(column)
        values, is_array = self.cells(position), isinstance(self.columns[position], np.ndarray)
        if values.dtype.kind in ("fiub" if is_array else "fiu") or not len(values):
            return np.asarray(values, dtype=np.float64)
        row = next((k for k, cell in enumerate(values) if not is_number(cell)), 0)
        cell = str(values[row])[:40]
        raise FileFormatError(
            f"{self.source}: column {self.names[position]!r}: expected numbers, got {cell!r} in data row {self.row(row)}. "
            "Repair the file, or set drop_bad_rows."
        )

    def row(self, index: int) -> int:
        """Return the number of a row in the file, from 1, without the header."""
        return int(index if self.rows is None else self.rows[index]) + 1


_DATE = re.compile(  # 2026-01-31 12:00:00.250, 2026/1/31T12:00:00:250, with or without a time zone; 12:00:00
    r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)[ T_])?"
    r"(\d\d?):(\d\d):(\d\d)(?:[.,:](\d{1,9}))? *(?:Z|[-+]\d\d:?\d\d)?"
)


def is_date(cell: str) -> bool:
    """Return True if a cell is a time of day, with a date (year first) or without."""
    return _DATE.fullmatch(cell.strip().strip('"')) is not None


def in_seconds(table: RawTable, column: Column) -> RawTable:
    """Return the table with a column of dates converted to s from the first date. Time zones are ignored. Times of day
    continue past midnight.
    """
    at = table.position(column)
    values = table.cells(at)
    if values.dtype.kind != "M":
        hits = [_DATE.fullmatch(str(cell).strip()) for cell in values]
        bad = next((k for k, hit in enumerate(hits) if hit is None), None)
        if bad is not None:
            raise FileFormatError(
                f"{table.source}: column {table.names[at]!r}: expected dates such as 2026-01-31 12:00:00.250, got "
                f"{str(values[bad])[:40]!r} in data row {table.row(bad)}. Repair the file, or set another unit of time."
            )
        try:
            values = np.array([_iso(hit) for hit in hits if hit], dtype="M8[ns]")
        except ValueError as error:
            raise FileFormatError(
                f"{table.source}: column {table.names[at]!r}: expected dates, got none ({error}). Repair the file."
            ) from error
        if not any(hit and hit[1] for hit in hits):
            midnights = np.concatenate(([0], np.cumsum(np.diff(values) < np.timedelta64(-12, "h"))))
            values = values + midnights * np.timedelta64(1, "D")
    steps = (values - values[0]).astype("m8[ns]") if len(values) else np.empty(0, dtype="m8[ns]")
    seconds = np.where(np.isnat(steps), np.nan, steps.astype(np.int64) * 1e-9)
    return replace(table, columns=(*table.columns[:at], seconds, *table.columns[at + 1 :]))


def date_of(cell: str) -> np.datetime64:
    """Return the date in a cell, or 1 January 1970 if the cell is not a date."""
    hit = _DATE.fullmatch(cell.strip())
    return np.datetime64(0 if hit is None else _iso(hit), "ns")


def _iso(hit: re.Match[str]) -> str:
    """Return a date in ISO 8601. A time of day without a date gets the first day of 1970."""
    y, m, d, hour, minute, second, fraction = hit.groups(default="")
    date = f"{y}-{m:0>2}-{d:0>2}" if y else "1970-01-01"
    return f"{date}T{hour:0>2}:{minute}:{second}.{fraction:0<9}"


def is_number(cell: Any, *, empty: bool = False) -> bool:
    """Return True if a cell is a number, or is empty and ``empty`` is set."""
    try:
        float(cell)
    except (TypeError, ValueError):
        return empty and not cell.strip()
    # Python would parse 1_0 as 10, and remove control characters beside a number
    return "_" not in str(cell) and str(cell).strip(" \t\r\n") == str(cell).strip()


def find_column(names: tuple[str, ...], column: Column, source: str) -> int:
    """Return the position of a column in a header."""
    if isinstance(column, int):
        if 0 <= column < len(names):
            return column
        raise InputError(f"{source}: expected column {column} (from 0), got {len(names)} columns. Check the positions.")
    hits = [i for i, name in enumerate(names) if name == column]
    hits = hits or [i for i, name in enumerate(names) if name.strip() == column.strip()]
    if len(hits) == 1:
        return hits[0]
    listing = ", ".join(repr(name) for name in names[:16]) + (", ..." if len(names) > 16 else "")
    if hits:
        raise InputError(
            f"{source}: expected one column {column!r}, got {len(hits)}. Map the column by its position from 0."
        )
    raise InputError(f"{source}: expected column {column!r}, got {listing or 'no columns'}. Check the mapping.")


# ---- from a table and a map to a Record

# Largest plausible size of a reading, in its unit. It detects damaged cells. A wrong scale is detected by io/symptoms.py.
_LARGEST = {
    "rad/s": 500.0, "dps": 30_000.0, "m/s2": 20_000.0, "g": 2_000.0, "mg": 2_000_000.0, "degc": 300.0, "ut": 100_000.0,
    "count": 2.0**24, "v": 1000.0,
}  # fmt: skip
_KELVIN = (200.0, 420.0)  # temperatures of devices
_RATE_AGREES = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadResult:
    """A record and the number of rows omitted from it."""

    record: Record
    dropped_rows: int = 0  # number of rows that could not be parsed
    repaired_rows: int = 0  # number of rows whose time did not increase
    notes: tuple[str, ...] = ()  # notes on the reading: units from a manual, skipped lines, omitted rows
    clock: ClockFit | None = None  # fit of a regular clock
    epoch_s: float = 0.0  # Unix time that was subtracted from the clock, s

    @property
    def remarks(self) -> tuple[Finding, ...]:
        """Return findings about reading the file: skipped columns, assumed units, omitted rows, a fitted clock."""
        remarks = [finding("recording.how_read", "info", note) for note in self.notes]
        remarks += rows_left_out(self.dropped_rows, "they did not parse")
        remarks += rows_left_out(self.repaired_rows, "their time did not go forward")
        if self.clock is not None:
            clock, by = self.clock, "the device's counter" if self.clock.counted else "the steps of the stamps"
            sentence = (
                f"A regular clock of {clock.sample_rate_hz:.6g} Hz was fitted to {by}: stamps are up to "
                f"{1e3 * clock.jitter_s:.3g} ms late, {clock.missing} samples are missing in {clock.gaps} gaps of up to "
                f"{clock.longest_step_s:.3g} s."
            )
            remarks.append(finding("recording.how_read", "info", sentence))
        return tuple(remarks)


def rows_left_out(count: int, why: str) -> list[Finding]:
    """Return the finding about rows that were left out, if there are any."""
    sentence = f"{count} rows were left out, because {why}."
    return [finding("recording.rows_left_out", "warn", sentence, count=count)] if count else []


def build_record(table: RawTable, column_map: ColumnMap | None = None) -> ReadResult:
    """Return the record in a table by a map, or by the file's own map if the map names no columns. Every value is checked."""
    given = column_map is not None and column_map.columns is not None
    how = column_map if given else table.own
    if how is None:
        raise InputError(f"{table.source}: the columns and units are not known. Name them in a map (`column_map`).")
    check_map(how)
    if len(table) < 2:
        raise FileFormatError(
            f"{table.source}: expected two rows or more, got {len(table)}. The file contains no recording."
        )
    table = in_seconds(table, how.columns_of("time")[0]) if how.is_dated() else table
    time, keep, clock = read_time(table, how)
    values = {channel: _channel(table, how, channel) for channel in how.mapped() if channel != "time"}
    if keep is not None:
        values = {channel: value[keep] for channel, value in values.items()}
    _check_rate(table, time, how)
    for array in (time, *values.values()):
        array.flags.writeable = False  # a record accepts them unchanged
    temp = values.get("temp")
    marks: dict[str, Any] = {"frame": how.frame, "device": how.device} | (dict(table.marks) if not given else {})
    record = Record(
        time=time,
        gyro=values.get("gyro"),
        accel=values.get("accel"),
        temp_c=None if temp is None else temp[:, 0],
        mag_ut=values.get("mag"),
        gyro_unit=how.unit_of("gyro") if "gyro" in values else "rad/s",
        accel_unit=how.unit_of("accel") if "accel" in values else "m/s2",
        **marks,
    )
    return ReadResult(
        record=record if table.thermometer is None else with_temperature(record, *table.thermometer),
        dropped_rows=table.dropped,
        repaired_rows=0 if keep is None else int((~keep).sum()),
        notes=(*table.notes, *(_unused_time(table, how) if given else ())),
        clock=clock,
        epoch_s=table.epoch_s,
    )


def _unused_time(table: RawTable, how: ColumnMap) -> list[str]:
    """Return a note if a map has no time column although the file has one."""
    labels = {k: label_of(name.rpartition(".")[2]) for k, name in enumerate(table.names)}
    times = [k for k, label in labels.items() if label and label.channel == "time"]
    if how.columns_of("time") or not times:
        return []
    by = f"time is counted with sample_rate_hz = {how.sample_rate_hz:g}"
    return [f"{by}: the map does not use the time column {table.names[times[0]]!r} of the file"]


def with_temperature(record: Record, time: FloatArray, temp_c: FloatArray) -> Record:
    """Return a record with temperatures (M,), degC, at times (M,), s, interpolated to its samples and constant beyond the ends."""
    known = np.isfinite(time) & np.isfinite(temp_c)
    if not known.any():
        raise InputError("temperature: expected one reading or more, got none. Omit the temperature file.")
    order = np.argsort(time[known], kind="stable")
    return replace(record, temp_c=np.interp(record.time, time[known][order], temp_c[known][order]))


# ---- time


def read_time(table: RawTable, how: ColumnMap) -> tuple[FloatArray, BoolArray | None, ClockFit | None]:
    """Return the time of the remaining rows, s, the selection of rows (None: all), and the regular clock if one was fitted."""
    time, counter = _time(table, how), how.columns_of("counter")
    if how.clock == "file":
        keep = _forward(table, time, how)
        return (time if keep is None else time[keep]), keep, None
    # equal time stamps are from a host, and are kept
    keep = time >= np.maximum.accumulate(time) if how.repair_time else np.ones(len(time), dtype=np.bool_)
    kept = None if keep.all() else keep
    counts = table.numbers(counter[0])[keep] if counter else None
    with naming(table.source):
        if how.columns_of("time"):
            fit = fit_clock(time[keep], counts)
        elif counts is not None:  # the counter determines the gaps
            fit = fit_clock(unwrapped(counts) / (how.sample_rate_hz or np.nan), counts)
        else:
            return time[keep], kept, None
    return fit.time, kept, fit


def _time(table: RawTable, how: ColumnMap) -> FloatArray:
    """Return the time of every row, s, before rows are left out."""
    if not how.columns_of("time"):
        rows = np.arange(len(table)) if table.rows is None else table.rows - table.rows[0]
        return rows / (how.sample_rate_hz or np.nan)  # check_map has made sure that there is a rate
    (column,) = how.columns_of("time")
    time = table.numbers(column)
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        row = table.row(int(bad[0]))
        raise InputError(
            f"{table.source}: time column {column!r}: expected a number in every row, got {len(bad)} empty or NaN cells, "
            f"first in data row {row}. Repair the file.",
            row=row,
        )
    factor = si_factor(how.unit_of("time"), "time")
    return time if factor == 1.0 else time * factor


def _forward(table: RawTable, time: FloatArray, how: ColumnMap) -> BoolArray | None:
    """Return the rows whose time increases, or None if all do."""
    steps = np.diff(time)
    if (steps > 0.0).all():
        return None
    (column,) = how.columns_of("time")
    row = int(np.flatnonzero(steps <= 0.0)[0]) + 1
    if how.repair_time:
        keep = np.concatenate(([True], time[1:] > np.maximum.accumulate(time)[:-1]))
        if keep.sum() >= 0.5 * len(time):
            return keep
        raise InputError(
            f"{table.source}: time column {column!r}: expected time that mostly increases, got {int((~keep).sum())} of "
            f"{len(time)} rows to drop. Check that this is the time column."
        )
    kind = "repeated" if steps[row - 1] == 0.0 else "backward"
    raise InputError(
        f"{table.source}: time column {column!r}: expected strictly increasing time, got {int((steps <= 0).sum())} steps that "
        f"go back or repeat, first in data row {table.row(row)} ({kind}: {time[row - 1]:.9g} s then {time[row]:.9g} s). Set "
        "repair_time = true in a map (`column_map` FILE) or its [[recording]] to drop them, or clock = 'regular' for host stamps.",
        row=table.row(row),
    )


def _check_rate(table: RawTable, time: FloatArray, how: ColumnMap) -> None:
    if not how.columns_of("time") or len(time) < 2:
        return
    rate_hz = how.sample_rate_hz
    if rate_hz is not None:
        usual, mean = sample_rate_of(time), (len(time) - 1) / float(time[-1] - time[0])
        if min(abs(usual / rate_hz - 1.0), abs(mean / rate_hz - 1.0)) > _RATE_AGREES:
            raise InputError(
                f"{table.source}: expected the specified {rate_hz:g} Hz, got {usual:.4g} Hz from time column "
                f"{how.columns_of('time')[0]!r}. Correct sample_rate_hz or units.time."
            )
    rates = two_rates(time)
    if rates is not None:
        raise InputError(
            f"{table.source}: expected one sample rate, got {rates[0]:.4g} Hz and then {rates[1]:.4g} Hz from {rates[2]:.6g} s on. "
            "Split the file there and read the parts separately."
        )


def two_rates(time: FloatArray) -> tuple[float, float, float] | None:
    """Find a lasting change of the sample rate."""
    size = max(16, (len(time) - 1) // 64)
    count = (len(time) - 1) // size
    every = np.diff(time)
    if count < 4 or every.max() < 1.1 * every.min():
        return None
    low, middle, high = np.quantile(every[: count * size].reshape(count, size), (0.25, 0.5, 0.75), axis=1)
    steady = np.flatnonzero((high - low) < 0.1 * middle)
    if len(steady) < 4:
        return None
    medians = middle[steady]
    other = np.abs(medians / medians[0] - 1.0) > 0.1
    if other.sum() < 2 or (~other).sum() < 2:
        return None
    first = steady[int(np.flatnonzero(other)[0])]
    return 1.0 / float(medians[0]), 1.0 / float(middle[first]), float(time[first * size])


# ---- readings


def _channel(table: RawTable, how: ColumnMap, channel: Channel) -> FloatArray:
    """Return the scaled values of a channel, shape (N, 1 or 3), in the unit that Record requires."""
    columns, unit = how.columns_of(channel), how.unit_of(channel)
    scale, axes = how.scale_of(channel), (0,) if channel == "temp" else how.axes_of(channel)
    if len(columns) < len(axes):  # a two-dimensional array of a mat file
        name, columns = columns[0], tuple(f"{columns[0]}[{k}]" for k in range(3))
        if columns[2] not in table.names or f"{name}[3]" in table.names:
            raise InputError(
                f"{table.source}: expected an array {name!r} of shape (N, 3), got none. "
                f"The file contains {', '.join(table.names[:16])}."
            )
    factor = si_factor(unit, QUANTITY[channel]) if channel in ("temp", "mag") else 1.0
    limit = _LARGEST["ut" if channel == "mag" else unit]
    out = np.full((len(table), 1 if channel == "temp" else 3), np.nan)  # an axis of another file stays NaN
    for k, column in zip(axes, columns, strict=True):
        values = scale.applied(table.numbers(column), k)
        values = values if factor == 1.0 else values * factor
        _check_values(table, table.names[table.position(column)], values, limit, unit, keep_gaps=how.gaps == "keep")
        out[:, k] = values
    return out


def _check_values(table: RawTable, name: str, values: FloatArray, limit: float, unit: str, *, keep_gaps: bool) -> None:
    """Raise for gaps, unless they are kept, and for readings beyond the largest plausible value of a sensor."""
    if float(values.min()) >= -limit and float(values.max()) <= limit:  # NaN fulfils neither condition
        return
    gap = np.isnan(values)
    if gap.any() and not keep_gaps:
        row, steps = table.row(int(np.flatnonzero(gap)[0])), np.unique(np.diff(np.flatnonzero(~gap)))
        regular = "" if len(steps) != 1 or steps[0] == 1 or len(gap) - gap.sum() < 3 else (
            f" (filled in every {steps[0]}th row only: two rates in one file, export each to its own file)"
        )  # fmt: skip
        raise InputError(
            f"{table.source}: column {name!r}: expected a number in every row, got {int(gap.sum())} empty or NaN cells, first in "
            f'data row {row}{regular}. Set gaps = "keep" in a map (`column_map` FILE) or its [[recording]] to keep them as gaps.',
            row=row,
        )
    wild = np.flatnonzero(np.abs(np.where(gap, 0.0, values)) > limit)
    if len(wild):
        row = table.row(int(wild[0]))
        raise FileFormatError(
            f"{table.source}: column {name!r}: expected readings up to {limit:g} {unit}, got {values[wild[0]]:g} in data row {row} "
            f"({len(wild)} such){_other_unit(values[wild], unit)}. Repair the row or check unit and scale.",
            row=row,
        )


def _other_unit(wild: FloatArray, unit: str) -> str:
    """Return, as a question, the unit that readings beyond the largest plausible value may have."""
    if unit == "degc" and bool(((wild > _KELVIN[0]) & (wild < _KELVIN[1])).all()):
        return ": is the temperature in K, not degC?"
    return ": is the gyroscope in mdeg/s, not deg/s, or in counts?" if unit == "dps" else ""


# ---- undrift's own tables


def native_columns(record: Record) -> tuple[tuple[str, ...], tuple[FloatArray, ...]]:
    """Return a record as columns with undrift's own names."""
    names, columns = ["time_s"], [record.time]
    for channel, unit, values in (
        ("gyro", record.gyro_unit, record.gyro),
        ("accel", record.accel_unit, record.accel),
        ("mag", "ut", record.mag_ut),
    ):
        if values is not None:
            names += [f"{channel}_{axis}_{NATIVE[channel][unit]}" for axis in AXES]
            columns += [*np.ascontiguousarray(values.T)]
    if record.temp_c is not None:
        names.append("temp_c")
        columns.append(record.temp_c)
    return tuple(names), tuple(columns)


def marks_of(record: Record) -> dict[str, Any]:
    """Return the properties that undrift writes with the columns of a record, for ``read_marks``."""
    marks: dict[str, Any] = {"frame": record.frame, "state": record.state, "device": record.device}
    if record.accel_uncertainty is not None:
        marks["accel_uncertainty"] = tree_of(record.accel_uncertainty)
    return marks if record.offset_uncertainty is None else marks | {"offset_uncertainty": record.offset_uncertainty}


def read_marks(held: Mapping[str, Any], error: str) -> dict[str, Any]:
    """Return frame, state, device and uncertainties that undrift wrote with a table, checked, as keys of Record."""
    marks = {key: held.get(key, "") for key in ("frame", "state", "device")}
    rate, force = held.get("offset_uncertainty"), held.get("accel_uncertainty")
    sound = marks["frame"] in get_args(Frame) and marks["state"] in get_args(State) and isinstance(marks["device"], str)
    if not sound or not (rate is None or (isinstance(rate, float) and 0.0 <= rate < math.inf)):
        raise FileFormatError(f"{error}; write the file again")
    try:
        uncertainty = ForceUncertainty(**force) if force else None
    except (TypeError, InputError) as cause:
        raise FileFormatError(f"{error}; write the file again") from cause
    return marks | {"accel_uncertainty": uncertainty, "offset_uncertainty": rate}


def of_channels(
    path: Path, time: FloatArray, channels: Mapping[str, tuple[Any, str]], how: ColumnMap, **about: Any
) -> RawTable:
    """Return a table of named channels with their units. A Unix clock is counted from its start."""
    time, notes = np.asarray(time, dtype=np.float64), tuple(about.pop("notes", ()))
    if len(time) and time[0] > EPOCH_S:
        notes, time = (f"time 0 is {time[0]:.3f} s of the file's clock (Unix time)", *notes), time - time[0]
    held, columns, units = {"time_s": time}, dict[str, Any](time="time_s"), {"time": "s"}
    for channel, (values, unit) in channels.items():
        names = (channel,) if np.ndim(values) == 1 else tuple(f"{channel} {axis}" for axis in AXES)
        held |= dict(zip(names, np.asarray(values, dtype=np.float64).reshape(len(time), -1).T, strict=True))
        columns[channel], units[channel] = names[0] if channel == "temp" else names, unit
    own = how.over(map_of_channels(columns, units, gaps=about.pop("gaps", None)))
    return RawTable(
        source=str(path), names=tuple(held), columns=tuple(held.values()), own=own, marks=about, notes=notes
    )
