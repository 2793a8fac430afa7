"""Convert named columns of a file to a Record: the channel and unit of each column, and all checks of a reader.

    value = gain * cell + offset          then the unit is applied (default gain 1, offset 0)

Nothing is guessed: a foreign file needs a ColumnMap. A file with undrift's own column names (``time_s``, ``gyro_x_dps``,
``accel_y_m_s2``, ``temp_c``, ``mag_z_ut``, ...) needs none: :func:`native_map` recognises exactly those.
"""

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.base.codec import stored, tree_of
from undrift.errors import FileFormatError, InputError, check_choices
from undrift.frames import Frame
from undrift.io.clock import ClockFit, fit_clock, unwrapped
from undrift.record import ForceUncertainty, Record, State, sample_rate_of
from undrift.units import DEVICE_UNITS, Quantity, canonical_unit, si_factor

Column: TypeAlias = str | int
Channel = Literal["time", "gyro", "accel", "temp", "mag"]
Gaps = Literal["raise", "keep"]
Clock = Literal["file", "regular"]
Names: TypeAlias = tuple[str, ...] | list[str]
CHANNELS: tuple[Channel, ...] = ("time", "gyro", "accel", "temp", "mag")
QUANTITY: dict[Channel, Quantity] = {"time": "time", "gyro": "rate", "accel": "accel", "temp": "temp", "mag": "mag"}
AXES = ("x", "y", "z")
EPOCH_S = 1e8  # a clock beyond this counts from 1970: it is shown from its first sample
KIND, FORMAT = "undrift.record", 1  # of undrift's own recordings, in Parquet and next to CSV
_SENSOR = {"time": "time", "gyro": "gyroscope", "accel": "accelerometer", "temp": "temperature", "mag": "magnetometer"}
EXAMPLE = 'gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "T"'

# Ending of a native column name for each unit that a channel may have.
GYRO_SUFFIX = {"rad/s": "rad_s", "dps": "dps", "count": "count", "v": "v"}
ACCEL_SUFFIX = {"m/s2": "m_s2", "g": "g", "mg": "mg", "count": "count", "v": "v"}
NATIVE = {"gyro": GYRO_SUFFIX, "accel": ACCEL_SUFFIX, "mag": {"ut": "ut"}}


@dataclass(frozen=True, slots=True)
class ChannelScale:
    """A linear conversion of a channel: value = gain * cell + offset."""

    # unit of the channel per unit of the file, or three values if the axes differ in scale or sign
    gain: float | tuple[float, float, float] = 1.0
    offset: float | tuple[float, float, float] = 0.0  # Added afterwards, in the unit of the channel

    def applied(self, cells: FloatArray, axis: int) -> FloatArray:
        """Return the converted values of an axis."""
        gain, offset = (x[axis] if isinstance(x, tuple) else x for x in (self.gain, self.offset))
        return cells if (gain, offset) == (1.0, 0.0) else gain * cells + offset


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class TextLayout:
    """Layout of a text table."""

    delimiter: str = ","  # a single character; " " means any number of blanks or tabs
    header: bool = True  # True if the first line after the skipped lines contains the column names
    skip_rows: int = 0  # lines before the header, or before the first row without a header
    decimal: str = "."  # "." or ","
    # drop and count rows with another number of columns, or with text in place of a number
    drop_bad_rows: bool = False

    def __post_init__(self) -> None:
        if len(self.delimiter) != 1 or self.delimiter in "\r\n":
            raise InputError(
                f"delimiter: expected one character, got {self.delimiter!r}. Use ',' ';' '\\t', or ' ' for any number of blanks."
            )
        if self.decimal not in (".", ",") or self.decimal == self.delimiter:
            raise InputError(f"decimal: expected '.' or ',' and not the delimiter, got {self.decimal!r}")
        if self.skip_rows < 0:
            raise InputError(f"skip_rows: expected 0 or more, got {self.skip_rows}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMap:
    """Columns and units of the channels in a file."""

    time: Column | None = None  # time column, required unless ``sample_rate_hz`` is set
    gyro: tuple[Column, ...] | None = None  # Three columns x, y, z
    accel: tuple[Column, ...] | None = None
    temp: Column | None = None  # Temperature column
    mag: tuple[Column, ...] | None = None  # Three columns x, y, z
    counter: Column | None = None  # sample counter of the device for a regular clock; may wrap
    time_unit: str = ""  # units after the scale, any spelling of :mod:`undrift.units`, or "date" for dates, year first
    gyro_unit: str = ""
    accel_unit: str = ""
    temp_unit: str = ""
    mag_unit: str = ""
    gyro_scale: ChannelScale | None = None  # Conversions from the file's numbers to those units
    accel_scale: ChannelScale | None = None
    temp_scale: ChannelScale | None = None
    mag_scale: ChannelScale | None = None
    sample_rate_hz: float | None = None  # Hz, no default, checked against the time column if there is one
    layout: TextLayout = field(default_factory=TextLayout)  # For text files
    gaps: Gaps = "raise"  # "raise" refuses empty cells and NaN, "keep" keeps them as gaps
    repair_time: bool = False  # Leave out rows whose time does not go forward. They are counted
    clock: Clock = "file"  # "file" takes the time column as it is, "regular" fits a rate and an offset to it
    frame: Frame = "s"  # "s" or "b"
    state: State = "raw"  # "raw" or "corrected"
    device: str = ""  # Serial number or name
    accel_uncertainty: ForceUncertainty | None = None  # for a corrected recording that undrift wrote
    offset_uncertainty: float | None = None  # rad/s, for a corrected recording that undrift wrote

    def __post_init__(self) -> None:
        if self.gyro is None and self.accel is None:
            raise InputError(
                f"columns: expected gyro or accel, got neither. Write, for example, columns = {{ {EXAMPLE} }}."
            )
        for channel in CHANNELS:
            self._check_channel(channel)
        for first, other in itertools.combinations(CHANNELS, 2):
            both = [column for column in self.columns_of(first) if column in self.columns_of(other)]
            if both:
                raise InputError(
                    f"columns: expected other columns for {_SENSOR[first]} than for {_SENSOR[other]}, got {both[0]!r} mapped as "
                    "both. Name each column once."
                )
        if self.time is None and self.sample_rate_hz is None:
            raise InputError("columns: expected a time column or sample_rate_hz, got neither. Add one of them.")
        if self.sample_rate_hz is not None and not 0.0 < self.sample_rate_hz < 1e7:
            raise InputError(f"sample_rate_hz: expected Hz above 0, got {self.sample_rate_hz:g}")
        if self.gaps not in ("raise", "keep"):
            raise InputError(f"gaps: expected 'raise' or 'keep', got {self.gaps!r}")
        if self.clock not in ("file", "regular"):
            raise InputError(f"clock: expected 'file' or 'regular', got {self.clock!r}")

    def columns_of(self, channel: Channel) -> tuple[Column, ...]:
        """Return the columns of a channel, none where it is not mapped."""
        value = getattr(self, channel)
        return () if value is None else value if isinstance(value, tuple) else (value,)

    def unit_of(self, channel: Channel) -> str:
        """Return the unit of a mapped channel in its one spelling."""
        return canonical_unit(getattr(self, f"{channel}_unit"), QUANTITY[channel])

    def mapped(self) -> tuple[Channel, ...]:
        """Return the channels that have columns."""
        return tuple(channel for channel in CHANNELS if self.columns_of(channel))

    def wanted(self) -> tuple[Column, ...]:
        """Return the columns of all channels, and the counter's."""
        counter = () if self.counter is None else (self.counter,)
        return (*(column for channel in CHANNELS for column in self.columns_of(channel)), *counter)

    def numeric(self) -> tuple[Column, ...]:
        """Return the columns that hold numbers: all but a time of dates."""
        dates = (self.time,) if self.time is not None and self.unit_of("time") == "date" else ()
        return tuple(column for column in self.wanted() if column not in dates)

    def _check_channel(self, channel: Channel) -> None:
        columns, unit = self.columns_of(channel), getattr(self, f"{channel}_unit")
        if channel in ("gyro", "accel", "mag") and len(columns) not in (0, 1, 3):
            raise InputError(f"columns.{channel}: expected three columns x, y, z, got {len(columns)}. Name all three.")
        if columns and len(set(columns)) != len(columns):
            raise InputError(
                f"columns.{channel}: expected three different columns, got {list(columns)}. Name each axis once."
            )
        scale: ChannelScale | None = None if channel == "time" else getattr(self, f"{channel}_scale")
        if (
            channel == "temp"
            and scale is not None
            and (isinstance(scale.gain, tuple) or isinstance(scale.offset, tuple))
        ):
            raise InputError(
                "scale.temp: expected one number for gain and offset, got three. Use one number, "
                "because a thermometer has one axis."
            )
        if columns and not unit:
            raise InputError(f"units.{channel}: expected the unit of {channel}, got none. Add the unit.")
        if columns and canonical_unit(unit, QUANTITY[channel]) in DEVICE_UNITS and channel in ("temp", "mag"):
            wanted = "degC" if channel == "temp" else "uT"
            raise InputError(
                f"units.{channel}: expected {wanted}, got {unit}. Set scale.{channel} (gain and offset to {wanted}) "
                f'and units.{channel} = "{wanted}", or omit {channel}.'
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class TempFile:
    """Separate text table of a thermometer. Temperatures are interpolated to the samples. The end values are extended."""

    path: Path
    time: Column = "time_s"  # Time column, on the recording's clock after the shift
    temp: Column = "temp_c"
    time_unit: str = "s"
    temp_unit: str = "degC"
    shift_s: float = 0.0  # Added to the thermometer's time, s
    layout: TextLayout = field(default_factory=TextLayout)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadSettings:
    """Settings for information that a file may lack."""

    sample_rate_hz: float | None = None  # Hz, for a file without a time column (undrift's own names, x-IMU)
    sensor: str | None = None  # Which sensor, stream or topic, in a file of several
    # "raise" or "keep", overrides the map. None: as set in the map. Without a map, gaps are refused except in files
    # that undrift wrote (a CSV with its sidecar file).
    gaps: Gaps | None = None
    # For a text or Parquet table with undrift's own names: leave out rows whose time does not go forward
    repair_time: bool = False
    drop_bad_rows: bool = False  # For a text table with undrift's own names: leave out rows that do not parse
    temp_file: TempFile | None = None  # replaces a temperature in the recording
    clock: Clock | None = None  # "file" or "regular", overrides the map; None: as set in the map, else "file"
    # Stretches, s on the recording's clock: cut off at its ends, gaps between
    leave_out: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        check_choices(self, "read_record")


READ_SETTINGS = ReadSettings()


@contextmanager
def naming(source: str | Path) -> Iterator[None]:
    """Name the file in errors."""
    try:
        yield
    except InputError as error:
        raise type(error)(f"{source}: {error}" if source else str(error), **error.numbers) from error


def native_map(names: Names, settings: ReadSettings = READ_SETTINGS, *, source: str = "") -> ColumnMap:
    """Return the map of a file that uses undrift's own column names."""
    columns: dict[str, Any] = {"time": "time_s" if "time_s" in names else None, "time_unit": "s"}
    with naming(source):
        for channel, suffixes in NATIVE.items():
            columns[channel], columns[f"{channel}_unit"] = _native_triple(names, channel, suffixes)
        if columns["gyro"] is None and columns["accel"] is None:
            listing = ", ".join(repr(name) for name in names[:12]) or "no columns"
            remainder = f", ... ({len(names)} columns)" if len(names) > 12 else ""
            raise InputError(
                f"columns: expected names such as gyro_x_dps or accel_x_m_s2, got {listing}{remainder}. Run undrift info "
                f"FILE "
                "--write-map map.toml to propose a map, and name the map with `column_map`."
            )
        columns["temp"], columns["temp_unit"] = ("temp_c", "degc") if "temp_c" in names else (None, "")
        rate, gaps = settings.sample_rate_hz, settings.gaps or "raise"
        clock = settings.clock or "file"
        return ColumnMap(**columns, sample_rate_hz=rate, gaps=gaps, repair_time=settings.repair_time, clock=clock)


def stated(columns: ColumnMap, marks: Mapping[str, Any], otherwise: str) -> ColumnMap:
    """Return a map with the frame, state and device that undrift stored next to a table. Raise an error if there are
    none.
    """
    frames, states = ({name: name for name in get_args(kind)} for kind in (Frame, State))
    frame, state, device = (marks.get(key, "") for key in ("frame", "state", "device"))
    try:
        force = ForceUncertainty(**marks["accel_uncertainty"]) if marks.get("accel_uncertainty") else None
    except (TypeError, InputError) as error:
        raise FileFormatError(f"{otherwise}. Write the file again.") from error
    rate = marks.get("offset_uncertainty")
    known_rate = rate is None or (isinstance(rate, float) and 0.0 <= rate < math.inf)
    if frame not in frames or state not in states or not isinstance(device, str) or not known_rate:
        raise FileFormatError(f"{otherwise}. Write the file again.")
    uncertainties: dict[str, Any] = {"accel_uncertainty": force, "offset_uncertainty": rate}
    return replace(columns, frame=frames[frame], state=states[state], device=device, **uncertainties)


def marks_of(record: Record) -> dict[str, Any]:
    """Return the entries that undrift stores next to the columns of a record, for ``stated``."""
    marks: dict[str, Any] = {"frame": record.frame, "state": record.state, "device": record.device}
    if record.accel_uncertainty is not None:
        marks["accel_uncertainty"] = tree_of(record.accel_uncertainty)
    return marks if record.offset_uncertainty is None else marks | {"offset_uncertainty": record.offset_uncertainty}


def is_native(names: Names) -> bool:
    """Return True if a file uses undrift's own names for a gyroscope or an accelerometer."""
    return any(
        f"{channel}_{axis}_{suffix}" in names
        for channel in ("gyro", "accel")
        for suffix in NATIVE[channel].values()
        for axis in AXES
    )


def _native_triple(names: Names, channel: str, suffixes: dict[str, str]) -> tuple[tuple[Column, ...] | None, str]:
    triples: list[tuple[tuple[Column, ...], str]] = []
    for unit, suffix in suffixes.items():
        triple = tuple(f"{channel}_{axis}_{suffix}" for axis in AXES)
        here = [name for name in triple if name in names]
        if here and len(here) < 3:
            raise InputError(
                f"columns: expected {', '.join(triple)}, got only {', '.join(here)}. Add the missing axes or map the columns."
            )
        if here:
            triples.append((triple, unit))
    if len(triples) > 1:
        raise InputError(
            f"columns: expected {channel} in one unit, got {triples[0][1]} and {triples[1][1]}. Map the columns to use."
        )
    return triples[0] if triples else (None, "")


# ---- a table of named columns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RawTable:
    """Columns of a file."""

    source: str  # file, for error messages
    names: tuple[str, ...]  # column names of the file, or positions as text without a header
    # a numpy array or Arrow column for each name, all of the same length, with text if the cells are not numbers
    columns: tuple[Any, ...]
    # (N,), number of each row in the file, from 0, if rows were left out, otherwise None
    rows: IntArray | None = None
    dropped: int = 0  # Rows left out

    def __len__(self) -> int:
        return len(self.columns[0]) if self.columns else 0

    def position(self, column: Column) -> int:
        """Return the position of a column."""
        return find_column(self.names, column, self.source)

    def numbers(self, column: Column) -> FloatArray:
        """Return a column as float64."""
        position, numeric = self.position(column), "fiub"
        values = self.columns[position]
        if not isinstance(values, np.ndarray):  # Arrow column, in which empty cells become NaN
            values, numeric = np.full(len(values), np.nan) if str(values.type) == "null" else values.to_numpy(), "fiu"
        if values.dtype.kind in numeric:
            return np.asarray(values, dtype=np.float64)
        row = next((k for k, cell in enumerate(values) if not is_number(cell)), 0)
        cell = str(values[row])[:40] if len(values) else ""
        raise FileFormatError(
            f"{self.source}: column {self.names[position]!r}: expected numbers, got {cell!r} in data row {self.row(row)}. "
            "Repair the file, or set drop_bad_rows."
        )

    def row(self, index: int) -> int:
        """Return the number of a row in the file, from 1, the header not counted."""
        return int(index if self.rows is None else self.rows[index]) + 1


_DATE = re.compile(  # 2026-01-31 12:00:00.250, 2026/1/31T12:00:00:250, 12:00:00, with or without a time zone
    r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)[ T_])?"
    r"(\d\d?):(\d\d):(\d\d)(?:[.,:](\d{1,9}))? *(?:Z|[-+]\d\d:?\d\d)?"
)


def is_date(cell: str) -> bool:
    """Return True if a cell is a time of day, with a date (year first) or without."""
    return _DATE.fullmatch(cell.strip().strip('"')) is not None


def in_seconds(table: RawTable, column: Column) -> RawTable:
    """Return the table with a column of dates converted to s from the first. Time zones are ignored. Times of day
    continue past midnight.
    """
    at = table.position(column)
    values = table.columns[at]
    if not isinstance(values, np.ndarray):  # bytes that are not UTF-8 are reported below
        values = (values.cast("binary") if str(values.type) == "string" else values).to_numpy()
    if values.dtype.kind != "M":
        hits = [_DATE.fullmatch(str(_text(cell)).strip()) for cell in values]
        bad = next((k for k, hit in enumerate(hits) if hit is None), None)
        if bad is not None:
            raise FileFormatError(
                f"{table.source}: column {table.names[at]!r}: expected dates such as 2026-01-31 12:00:00.250, got "
                f"{str(_text(values[bad]))[:40]!r} in data row {table.row(bad)}. Repair the file, or set another unit of time."
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


def _text(cell: Any) -> Any:
    return cell.decode("utf-8", "replace") if isinstance(cell, bytes) else cell


def is_number(cell: Any, *, empty: bool = False) -> bool:
    """Return True if a cell is a number, or is empty and ``empty`` is set."""
    try:
        float(cell)
    except (TypeError, ValueError):
        return empty and not cell.strip()
    return True


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

# Largest believable size of a reading, in its own unit: it finds a broken cell, not a wrong scale (io/inspect.py does).
_LARGEST = {
    "rad/s": 500.0, "dps": 30_000.0, "m/s2": 20_000.0, "g": 2_000.0, "mg": 2_000_000.0, "degc": 300.0, "ut": 100_000.0,
    "count": 2.0**24, "v": 1000.0,
}  # fmt: skip
_KELVIN = (200.0, 420.0)  # temperatures of devices
_RATE_AGREES = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadResult:
    """A record and the count of rows left out to make it."""

    record: Record
    dropped_rows: int = 0  # Rows that did not parse
    repaired_rows: int = 0  # Rows whose time did not go forward
    notes: tuple[str, ...] = ()  # notes on the reading: units of a manual, lines skipped, rows left out
    clock: ClockFit | None = None  # the fitted regular clock
    epoch_s: float = 0.0  # Unix time that was taken off the clock, s


def build_record(table: RawTable, columns: ColumnMap) -> ReadResult:
    """Return the record in a table, with every value checked."""
    if len(table) < 2:
        raise FileFormatError(
            f"{table.source}: expected two rows or more, got {len(table)}. The file contains no recording."
        )
    if columns.time is not None and columns.unit_of("time") == "date":
        table = in_seconds(table, columns.time)
    time = _time(table, columns)
    fitted = columns.clock == "regular"
    keep = _never_back(time, columns) if fitted else _forward(table, time, columns)
    values = {channel: _channel(table, columns, channel) for channel in columns.mapped() if channel != "time"}
    if keep is not None:
        time, values = time[keep], {channel: value[keep] for channel, value in values.items()}
    clock = _regular(table, time, keep, columns) if fitted else None
    time = time if clock is None else clock.time
    _check_rate(table, time, columns)
    for array in (time, *values.values()):
        array.flags.writeable = False  # a record takes them as they are
    temp = values.get("temp")
    record = Record(
        time=time,
        gyro=values.get("gyro"),
        accel=values.get("accel"),
        temp_c=None if temp is None else temp[:, 0],
        mag_ut=values.get("mag"),
        gyro_unit=columns.unit_of("gyro") if columns.gyro else "rad/s",
        accel_unit=columns.unit_of("accel") if columns.accel else "m/s2",
        frame=columns.frame,
        state=columns.state,
        device=columns.device,
        accel_uncertainty=columns.accel_uncertainty,
        offset_uncertainty=columns.offset_uncertainty,
    )
    repaired = 0 if keep is None else int((~keep).sum())
    return ReadResult(record=record, dropped_rows=table.dropped, repaired_rows=repaired, clock=clock)


def chosen(path: Path, kind: str, names: tuple[str, ...], sensor: str | None) -> str:
    """Return the item that `sensor` names, by its whole name or a unique ending. Without `sensor`, return the only
    item.
    """
    if not names:
        raise FileFormatError(f"{path}: expected a {kind} with readings, got none. The file contains no recording.")
    hits = names if sensor is None else [name for name in names if name == sensor]
    hits = hits or [name for name in names if name.endswith(f".{sensor}")]
    if len(hits) == 1:
        return hits[0]
    wanted = f"the name of one {kind}" if sensor is None else f"{kind} {sensor!r}"
    raise InputError(
        f"{path}: expected {wanted}, got a file with {', '.join(names)}. Name one of them (`sensor`).",
        missing="sensor",
        names=names,
    )


def build(
    path: Path,
    time: FloatArray,
    channels: Mapping[str, tuple[Any, str]],
    settings: ReadSettings,
    notes: Iterable[str] = (),
    **more: Any,
) -> ReadResult:
    """Return the record of named channels with their units, with every value checked. A Unix clock is counted from its
    start.
    """
    notes, time = tuple(notes), np.asarray(time, dtype=np.float64)
    if len(time) and time[0] > EPOCH_S:
        notes, time = (f"time 0 is {time[0]:.3f} s of the file's clock (Unix time)", *notes), time - time[0]
    arrays, columns = {"time_s": time}, dict(more)
    for channel, (values, unit) in channels.items():
        names = (channel,) if np.ndim(values) == 1 else tuple(f"{channel} {axis}" for axis in AXES)
        arrays |= dict(zip(names, np.asarray(values, dtype=np.float64).reshape(len(time), -1).T, strict=True))
        columns |= {channel: names[0] if channel == "temp" else names, f"{channel}_unit": unit}
    columns |= {"gaps": settings.gaps or "raise", "repair_time": settings.repair_time}
    table = RawTable(source=str(path), names=tuple(arrays), columns=tuple(arrays.values()))
    return replace(build_record(table, ColumnMap(time="time_s", time_unit="s", **columns)), notes=notes)


def _never_back(time: FloatArray, columns: ColumnMap) -> BoolArray | None:
    """Return the rows whose time does not go back, if a repair is requested. Equal stamps, as from a host, remain."""
    keep = time >= np.maximum.accumulate(time)
    return None if keep.all() or not columns.repair_time else keep


def _regular(table: RawTable, time: FloatArray, keep: BoolArray | None, columns: ColumnMap) -> ClockFit | None:
    """Fit a regular clock, with the device's counter if it is mapped. Without a time column, the counter determines the
    gaps.
    """
    counter = None if columns.counter is None else table.numbers(columns.counter)
    counter = counter if counter is None or keep is None else counter[keep]
    with naming(table.source):
        if columns.time is not None:
            return fit_clock(time, counter)
        return None if counter is None else fit_clock(unwrapped(counter) / (columns.sample_rate_hz or np.nan), counter)


def _channel(table: RawTable, columns: ColumnMap, channel: Channel) -> FloatArray:
    """Return the scaled values of a channel, shape (N, 1 or 3), in the unit that Record requires."""
    wanted, unit = columns.columns_of(channel), columns.unit_of(channel)
    scale: ChannelScale = getattr(columns, f"{channel}_scale") or ChannelScale()
    if len(wanted) == 1 and channel != "temp":  # a two-dimensional array of an npz or mat file
        wanted = tuple(f"{wanted[0]}[{k}]" for k in range(3))
        if wanted[2] not in table.names or f"{columns.columns_of(channel)[0]}[3]" in table.names:
            raise InputError(
                f"{table.source}: expected an array {columns.columns_of(channel)[0]!r} of shape (N, 3), got none. "
                f"The file contains "
                f"{', '.join(table.names[:16])}."
            )
    factor = si_factor(unit, QUANTITY[channel]) if channel in ("temp", "mag") else 1.0
    limit = _LARGEST["ut" if channel == "mag" else unit]
    out = np.empty((len(table), len(wanted)))
    for k, column in enumerate(wanted):
        values = scale.applied(table.numbers(column), k)
        values = values if factor == 1.0 else values * factor
        _check_values(table, table.names[table.position(column)], values, limit, unit, columns)
        out[:, k] = values
    return out


def _check_values(table: RawTable, name: str, values: FloatArray, limit: float, unit: str, columns: ColumnMap) -> None:
    low, high = float(values.min()), float(values.max())  # NaN passes through both
    if low >= -limit and high <= limit:
        return
    gap = _check_gaps(table, name, values, columns)
    wild = np.flatnonzero(np.abs(np.where(gap, 0.0, values)) > limit)
    if len(wild):
        row = table.row(int(wild[0]))
        raise FileFormatError(
            f"{table.source}: column {name!r}: expected readings up to {limit:g} {unit}, got {values[wild[0]]:g} in data row {row} "
            f"({len(wild)} such){_other_unit(values[wild], unit)}. Repair the row or check unit and scale.",
            row=row,
        )


def _other_unit(wild: FloatArray, unit: str) -> str:
    """Return which other unit readings beyond the largest of a unit may be in."""
    if unit == "degc" and bool(((wild > _KELVIN[0]) & (wild < _KELVIN[1])).all()):
        return ": is the temperature in K, not degC?"
    return ": is the gyroscope in mdeg/s, not deg/s, or in counts?" if unit == "dps" else ""


def _check_gaps(table: RawTable, name: str, values: FloatArray, columns: ColumnMap) -> BoolArray:
    """Return the gaps of a column. Raise an error if there are gaps and the map refuses them."""
    gap = np.isnan(values)
    if gap.any() and columns.gaps == "raise":
        row, steps = table.row(int(np.flatnonzero(gap)[0])), np.unique(np.diff(np.flatnonzero(~gap)))
        regular = "" if len(steps) != 1 or steps[0] == 1 or len(gap) - gap.sum() < 3 else (
            f" (filled in every {steps[0]}th row only: two rates in one file, export each to its own file)"
        )  # fmt: skip
        raise InputError(
            f"{table.source}: column {name!r}: expected a number in every row, got {int(gap.sum())} empty or NaN cells, first in "
            f'data row {row}{regular}. Set gaps = "keep" in a map (`column_map` FILE) or its [[recording]] to keep them as gaps.',
            row=row,
        )
    return gap


def _time(table: RawTable, columns: ColumnMap) -> FloatArray:
    if columns.time is None:
        rows = np.arange(len(table)) if table.rows is None else table.rows - table.rows[0]
        return rows / (columns.sample_rate_hz or np.nan)  # ColumnMap has seen to it that the rate is there
    time = table.numbers(columns.time)
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        row = table.row(int(bad[0]))
        raise InputError(
            f"{table.source}: time column {columns.time!r}: expected a number in every row, got {len(bad)} empty or NaN cells, "
            f"first in data row {row}. Repair the file.",
            row=row,
        )
    factor = si_factor(columns.unit_of("time"), "time")
    return time if factor == 1.0 else time * factor


def _forward(table: RawTable, time: FloatArray, columns: ColumnMap) -> BoolArray | None:
    """Return the rows whose time goes forward, None when all do."""
    steps = np.diff(time)
    if (steps > 0.0).all():
        return None
    row = int(np.flatnonzero(steps <= 0.0)[0]) + 1
    if columns.repair_time:
        keep = np.concatenate(([True], time[1:] > np.maximum.accumulate(time)[:-1]))
        if keep.sum() >= 0.5 * len(time):
            return keep
        raise InputError(
            f"{table.source}: time column {columns.time!r}: expected time that mostly goes forward, got {int((~keep).sum())} of "
            f"{len(time)} rows to drop. Check that this is the time column."
        )
    kind = "doubled" if steps[row - 1] == 0.0 else "backward"
    raise InputError(
        f"{table.source}: time column {columns.time!r}: expected strictly increasing time, got "
        f"{int((steps <= 0).sum())} steps back "
        f"or doubled, first in data row {table.row(row)} ({kind}: {time[row - 1]:.9g} s then {time[row]:.9g} s). Set repair_time = "
        "true in a map (`column_map` FILE) or its [[recording]] to drop them, or clock = 'regular' if a host "
        "computer stamped them.",
        row=table.row(row),
    )


def _check_rate(table: RawTable, time: FloatArray, columns: ColumnMap) -> None:
    if columns.time is None or len(time) < 2:
        return
    nominal_hz = columns.sample_rate_hz
    if nominal_hz is not None:
        measured_hz, mean = sample_rate_of(time), (len(time) - 1) / float(time[-1] - time[0])
        if min(abs(measured_hz / nominal_hz - 1.0), abs(mean / nominal_hz - 1.0)) > _RATE_AGREES:
            raise InputError(
                f"{table.source}: expected the specified {nominal_hz:g} Hz, got {measured_hz:.4g} Hz from time column "
                f"{columns.time!r}. Correct "
                "sample_rate_hz or units.time."
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
    steps = every[: count * size].reshape(count, size)
    low, middle, high = np.quantile(steps, (0.25, 0.5, 0.75), axis=1)
    steady = np.flatnonzero((high - low) < 0.1 * middle)
    if len(steady) < 4:
        return None
    medians = middle[steady]
    other = np.abs(medians / medians[0] - 1.0) > 0.1
    if other.sum() < 2 or (~other).sum() < 2:
        return None
    first = steady[int(np.flatnonzero(other)[0])]
    return 1.0 / float(medians[0]), 1.0 / float(middle[first]), float(time[first * size])


def native_columns(record: Record) -> tuple[tuple[str, ...], tuple[FloatArray, ...]]:
    """Return a record as named columns, undrift's own names."""
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
