"""The column map: everything that a reader is told about a file. Each class defines a table in TOML, and the only definition of it.

A map is stored in a separate file, as a [[recording]] of session.toml (with the name of the file), or as JSON in a calibration::

    sample_rate_hz = 102.4
    columns = { time = "t", gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "T" }  # names, or positions from 0
    units = { time = "s", gyro = "dps", accel = "m/s2", temp = "degC" }
    columns = [{ time = "t", gyro = { x = "rate" } }, { time = "t", gyro = { y = "rate" } }, ...]    # a file for each axis
    scale = { temp = { gain = 0.00294117647, offset = 36.53 } }                          # value = gain * cell + offset

Nothing is guessed: a foreign file needs columns and units. A file with undrift's own column names (``time_s``, ``gyro_x_dps``,
``accel_y_m_s2``, ``temp_c``, ``mag_z_ut``, ...) needs neither: :func:`native_map` recognises exactly those.
"""

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from annotated_types import Ge
from pydantic import Field

from undrift.arrays import FloatArray
from undrift.base import codec
from undrift.base.codec import FileTable
from undrift.errors import InputError
from undrift.frames import Frame
from undrift.record import FileMap
from undrift.units import DEVICE_UNITS, Quantity, canonical_unit

Column: TypeAlias = str | int
Columns: TypeAlias = tuple[Column, ...]
Channel = Literal["time", "gyro", "accel", "temp", "mag"]
Gaps = Literal["raise", "keep"]
Clock = Literal["file", "regular"]
Names: TypeAlias = tuple[str, ...] | list[str]
CHANNELS: tuple[Channel, ...] = ("time", "gyro", "accel", "temp", "mag")
QUANTITY: dict[Channel, Quantity] = {"time": "time", "gyro": "rate", "accel": "accel", "temp": "temp", "mag": "mag"}
AXES = ("x", "y", "z")
# keys of a map that may be needed for a file with undrift's own names, or with a format that defines the columns
NATIVE_KEYS = {"sample_rate_hz", "sensor", "gaps", "repair_time", "drop_bad_rows", "clock", "temp_file", "leave_out"}
_SENSOR = {"time": "time", "gyro": "gyroscope", "accel": "accelerometer", "temp": "temperature", "mag": "magnetometer"}

# Ending of a native column name, for each unit that a channel may have.
NATIVE = {
    "gyro": {"rad/s": "rad_s", "dps": "dps", "count": "count", "v": "v"},
    "accel": {"m/s2": "m_s2", "g": "g", "mg": "mg", "count": "count", "v": "v"},
    "mag": {"ut": "ut"},
}
QUATERNION, POSITION = ("q_w", "q_x", "q_y", "q_z"), ("pos_x_m", "pos_y_m", "pos_z_m")  # native columns of poses


@dataclass(frozen=True, slots=True)
class ChannelScale:
    """A linear conversion of a channel: value = gain * cell + offset."""

    # unit of the channel per unit of the file, or three values if the axes differ in scale or sign
    gain: float | tuple[float, float, float] = 1.0
    offset: float | tuple[float, float, float] = 0.0  # added after the gain, in the unit of the channel

    def applied(self, cells: FloatArray, axis: int) -> FloatArray:
        """Return the converted values of an axis."""
        gain, offset = (x[axis] if isinstance(x, tuple) else x for x in (self.gain, self.offset))
        return cells if (gain, offset) == (1.0, 0.0) else gain * cells + offset


class TextLayout(FileTable):
    """Layout of a text table."""

    delimiter: Annotated[str, Field(pattern=r"^[^\r\n]$")] = ","  # one character; " " means one or more spaces or tabs
    header: bool = True  # true if the first line after the skipped ones names the columns
    skip_rows: Annotated[int, Ge(0)] = 0  # lines before the header, or before the first row if there is no header
    decimal: Annotated[str, Field(pattern="^[.,]$")] = "."  # decimal sign, "." or ","
    # drop and count rows with another number of columns, or with text instead of a number
    drop_bad_rows: bool = False


class TempFile(TextLayout):
    """A thermometer in a separate text table. Temperatures are interpolated to the samples, and constant beyond its ends."""

    file: str  # text table, next to the map
    time: Column = "time_s"  # time column, on the recording's clock after the shift
    temp: Column = "temp_c"  # temperature column
    time_unit: str = "s"  # unit of the temperature, in any spelling of :mod:`undrift.units`
    temp_unit: str = "degC"
    shift_s: float = 0.0  # added to the thermometer's time, s


class AxisColumns(FileTable):
    """Columns of a channel's axes that are in this file. The other axes are in other files of the recording."""

    x: Column | None = None
    y: Column | None = None
    z: Column | None = None


# columns x, y, z, or the name of one array (mat), or the axes in this file
Triad: TypeAlias = Sequence[Column] | str | AxisColumns


class ChannelColumns(FileTable):
    """Columns of the channels: names in the header, or positions from 0."""

    time: Column | None = None  # time column; without it, ``sample_rate_hz`` is required
    gyro: Triad | None = None
    accel: Triad | None = None
    temp: Column | None = None
    mag: Triad | None = None
    counter: Column | None = None  # sample counter of the device, which may wrap; used by a regular clock


class ColumnMap(TextLayout):
    """Everything that a reader needs to know about a file."""

    sample_rate_hz: float | None = None  # Hz, without a default; checked against the time column if there is one
    columns: ChannelColumns | Sequence[ChannelColumns] | None = None  # one table, or one per file
    # unit of each channel, in any spelling of :mod:`undrift.units`; "date": year first
    units: dict[Channel, str] = Field(default_factory=dict)
    # conversion, if the numbers are not in these units
    scale: dict[Literal["gyro", "accel", "temp", "mag"], ChannelScale] = Field(default_factory=dict)
    # "raise" refuses empty cells and NaN, "keep" keeps them as gaps; by default only files that undrift wrote have gaps
    gaps: Gaps | None = None
    repair_time: bool = False  # omit rows whose time does not increase
    clock: Clock = "file"  # "file", or "regular" for time stamps of a host, to which a rate and an offset are fitted
    # omitted stretches, s on the recording's clock: cut off at its ends, gaps in between
    leave_out: tuple[tuple[float, float], ...] = ()
    frame: Frame = "s"  # "s" or "b"
    device: str = ""  # serial number or name
    temp_file: TempFile | None = None  # replaces a temperature in the recording
    sensor: str | None = None  # sensor, stream or topic, in a file with several

    def parts(self) -> tuple["ColumnMap", ...]:
        """Return one map per table of columns, that is, per file of a recording."""
        tables = () if self.columns is None else self.columns
        return tuple(self.but(columns=table) for table in ([tables] if isinstance(tables, ChannelColumns) else tables))

    def columns_of(self, channel: str) -> Columns:
        """Return the columns of a channel, or an empty tuple if it has none."""
        value = getattr(self.columns, channel, None)
        if isinstance(value, AxisColumns):
            return tuple(column for column in (value.x, value.y, value.z) if column is not None)
        return () if value is None else (value,) if isinstance(value, str | int) else tuple(value)

    def axes_of(self, channel: str) -> tuple[int, ...]:
        """Return the axes of a triad, from 0, that the columns of this map contain. These are all three unless axes are named."""
        value = getattr(self.columns, channel, None)
        if isinstance(value, AxisColumns):
            return tuple(k for k, axis in enumerate(AXES) if getattr(value, axis) is not None)
        return (0, 1, 2) if self.columns_of(channel) else ()

    def unit_of(self, channel: Channel) -> str:
        """Return the unit of a mapped channel in its canonical spelling."""
        return canonical_unit(self.units.get(channel, ""), QUANTITY[channel])

    def scale_of(self, channel: str) -> ChannelScale:
        """Return the conversion of a channel, gain 1 and offset 0 if the map has none."""
        return next((scale for name, scale in self.scale.items() if name == channel), ChannelScale())

    def mapped(self) -> tuple[Channel, ...]:
        """Return the channels that have columns."""
        return tuple(channel for channel in CHANNELS if self.columns_of(channel))

    def wanted(self, *, numeric: bool = False) -> Columns:
        """Return the columns of all channels and the counter. With ``numeric``, a time column of dates is omitted."""
        dated = numeric and self.is_dated()
        channels = [*CHANNELS[dated:], "counter"]
        return tuple(column for channel in channels for column in self.columns_of(channel))

    def unread(self, names: Names) -> tuple[str, ...]:
        """Return a note about the columns of a table that this map omits. Columns of poses are a reference and do not count."""
        left_out = [name for name in names if name not in (*self.wanted(), *QUATERNION, *POSITION, "moving")]
        text = f"These columns have other names than undrift's and were not read: {', '.join(left_out[:12])}."
        return (f"{text} Read them with a column map.",) if left_out else ()

    def is_dated(self) -> bool:
        """Return True if the time column contains dates."""
        return bool(self.columns_of("time")) and self.unit_of("time") == "date"

    def over(self, own: "ColumnMap") -> "ColumnMap":
        """Return the map of a file that defines its columns, overridden with the keys of this map."""
        given = {key: getattr(self, key) for key in self.model_fields_set & {"gaps", "clock", "sample_rate_hz"}}
        return own.but(repair_time=self.repair_time or own.repair_time, **given)

    def beside(self, folder: Path) -> Self:
        """Return the map with the path of the thermometer's file in a folder."""
        held = self.temp_file
        return self if held is None else self.but(temp_file=held.but(file=str((folder / held.file).resolve())))


READ_SETTINGS = ColumnMap.model_construct()  # defaults without validation, which would slow every start


def map_of_channels(columns: Mapping[str, Any], units: Mapping[Any, str], **keys: Any) -> ColumnMap:
    """Return the map of some channels: their columns, their units, and other keys of a map."""
    return ColumnMap(columns=ChannelColumns(**columns), units=dict(units), **keys)


@contextmanager
def naming(source: str | Path) -> Iterator[None]:
    """Add the name of the file to errors."""
    try:
        yield
    except InputError as error:
        is_named = not source or str(error).startswith(f"{source}: ")
        raise type(error)(str(error) if is_named else f"{source}: {error}", **error.numbers) from error


def check_parts(how: ColumnMap) -> None:
    """Raise InputError if the files of a map together do not form a recording."""
    for part in how.parts():
        check_map(part)
    for channel in ("gyro", "accel", "mag"):
        axes = [axis for part in how.parts() for axis in part.axes_of(channel)]
        twice = sorted({AXES[axis] for axis in axes if axes.count(axis) > 1})
        missing = [AXES[axis] for axis in range(3) if axes and axis not in axes]
        if twice:
            raise InputError(
                f"columns: expected each axis of {channel} in one file, got {', '.join(twice)} in several. Map each axis once."
            )
        if missing:
            raise InputError(
                f"columns: expected the axes x, y and z of {channel}, got none of {', '.join(missing)}. Add a table of columns "
                f"for each file, for example {{ time = 0, {channel} = {{ {missing[0]} = 1 }} }}."
            )


def check_map(how: ColumnMap) -> None:
    """Raise InputError if the columns and units of a map do not form a recording, or a part of a recording."""
    if not how.columns_of("gyro") and not how.columns_of("accel"):
        example = 'gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "T"'
        raise InputError(f"columns: expected gyro or accel, got neither. For example, write columns = {{ {example} }}.")
    for channel in how.mapped():
        _check_channel(how, channel)
    for one, other in itertools.combinations(CHANNELS, 2):
        if both := set(how.columns_of(one)) & set(how.columns_of(other)):
            raise InputError(
                f"columns: expected other columns for {_SENSOR[one]} than for {_SENSOR[other]}, got {both.pop()!r} mapped as "
                "both. Name each column once."
            )
    if not how.columns_of("time") and how.sample_rate_hz is None:
        raise InputError("columns: expected a time column or sample_rate_hz, got neither. Add one of them.")
    if how.sample_rate_hz is not None and not 0.0 < how.sample_rate_hz < 1e7:
        raise InputError(f"sample_rate_hz: expected Hz above 0, got {how.sample_rate_hz:g}")
    if how.decimal == how.delimiter:
        raise InputError(f"decimal: expected '.' or ',' and not the delimiter, got {how.decimal!r}")


def _check_channel(how: ColumnMap, channel: Channel) -> None:
    columns, unit, scale = how.columns_of(channel), how.units.get(channel, ""), how.scale_of(channel)
    by_axis = isinstance(getattr(how.columns, channel), AxisColumns)
    if channel in ("gyro", "accel", "mag") and len(columns) not in (1, 3) and not by_axis:
        raise InputError(f"columns.{channel}: expected three columns x, y, z, got {len(columns)}. Name all three.")
    if len(set(columns)) != len(columns):
        raise InputError(
            f"columns.{channel}: expected three different columns, got {list(columns)}. Name each axis once."
        )
    if channel == "temp" and (isinstance(scale.gain, tuple) or isinstance(scale.offset, tuple)):
        raise InputError(
            "scale.temp: expected one number for gain and offset, got three. Use one number, "
            "because a thermometer has one axis."
        )
    if not unit:
        raise InputError(f"units.{channel}: expected the unit of {channel}, got none. Add the unit.")
    if canonical_unit(unit, QUANTITY[channel]) in DEVICE_UNITS and channel in ("temp", "mag"):
        physical = "degC" if channel == "temp" else "uT"
        raise InputError(
            f"units.{channel}: expected {physical}, got {unit}. Set scale.{channel} (gain and offset to {physical}) "
            f'and units.{channel} = "{physical}", or omit {channel}.'
        )


# ---- undrift's own names


def is_native(names: Names) -> bool:
    """Return True if a file uses undrift's own names for a gyroscope or an accelerometer."""
    return any(
        f"{channel}_{axis}_{suffix}" in names
        for channel in ("gyro", "accel")
        for suffix in NATIVE[channel].values()
        for axis in AXES
    )


def native_map(names: Names, how: ColumnMap = READ_SETTINGS, *, source: str = "") -> ColumnMap:
    """Return the map of a file that uses undrift's own column names."""
    columns: dict[str, Any] = {"time": "time_s" if "time_s" in names else None}
    units: dict[Any, str] = {"time": "s"}
    with naming(source):
        for channel, suffixes in NATIVE.items():
            columns[channel], units[channel] = _native_triple(names, channel, suffixes)
        if columns["gyro"] is None and columns["accel"] is None:
            listing = ", ".join(repr(name) for name in names[:12]) or "no columns"
            remainder = f", ... ({len(names)} columns)" if len(names) > 12 else ""
            raise InputError(
                f"columns: expected names such as gyro_x_dps or accel_x_m_s2, got {listing}{remainder}. Run undrift "
                "info FILE --write-map map.toml to propose a map, and name the map with `column_map`."
            )
        columns["temp"], units["temp"] = ("temp_c", "degc") if "temp_c" in names else (None, "")
        native = how.over(map_of_channels(columns, units))
        check_map(native)
        return native


def _native_triple(names: Names, channel: str, suffixes: Mapping[str, str]) -> tuple[Columns | None, str]:
    triples: list[tuple[Columns, str]] = []
    for unit, suffix in suffixes.items():
        triple = tuple(f"{channel}_{axis}_{suffix}" for axis in AXES)
        here = [name for name in triple if name in names]
        if here and len(here) < 3:
            raise InputError(
                f"columns: expected {', '.join(triple)}, got only {', '.join(here)}. Add the missing axes or map the columns."
            )
        triples += [(triple, unit)] if here else []
    if len(triples) > 1:
        raise InputError(
            f"columns: expected {channel} in one unit, got {triples[0][1]} and {triples[1][1]}. Map the columns to use."
        )
    return triples[0] if triples else (None, "")


# ---- maps in files, in calls and in calibrations


def read_map(path: str | Path, **choices: Any) -> ColumnMap:
    """Return a map in TOML, with the choices of a call over it. A map without columns is for undrift's own names."""
    how, _ = codec.read_toml(ColumnMap, path)
    given = how.model_fields_set
    if not how.columns and (not given or given - NATIVE_KEYS):
        got = ", ".join(sorted(given - NATIVE_KEYS)) or "no key"
        raise InputError(
            f"{path}: expected one table of columns, got 0 and {got}. Add columns = {{ ... }}. A file with undrift's "
            f"own names needs only {', '.join(sorted(NATIVE_KEYS))}."
        )
    how = how.beside(Path(path).parent).but(**{key: value for key, value in choices.items() if value is not None})
    with naming(path):
        check_parts(how)
    return how


def file_map_of(how: ColumnMap, *, without: Sequence[str] = ()) -> FileMap:
    """Return the keys of a map as a value that a calibration stores."""
    held = how.model_dump(mode="json", exclude_unset=True, exclude=set(without))
    return FileMap(json.dumps(held, ensure_ascii=False))


def map_of(file_map: FileMap | None) -> ColumnMap:
    """Return the map from the value that a calibration stores."""
    return READ_SETTINGS if file_map is None else ColumnMap.model_validate_json(file_map.text)


def one_map(how: ColumnMap) -> ColumnMap:
    """Return the map of one file. Raise InputError for a map of several files."""
    parts = how.parts()
    if len(parts) > 1:
        raise InputError(
            f"expected {len(parts)} files for one recording, got one. Use a map of one file, or list the files in session.toml."
        )
    return parts[0] if parts else how
