"""ColumnMap: which column of a foreign file is which channel, in which unit. Nothing is guessed.

    value = gain * cell + offset          then the unit is applied; gain 1 and offset 0 unless a Scale is given

A file with undrift's own column names (``time_s``, ``gyro_x_dps``, ``accel_y_m_s2``, ``temp_c``, ``mag_z_ut``, ...) needs no map:
:func:`native_map` recognises exactly those names.
"""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from undrift.errors import InputError
from undrift.frames import Frame
from undrift.record import State
from undrift.units import DEVICE_UNITS, ZERO_CELSIUS_K, Quantity, canonical_unit

Column: TypeAlias = str | int
Channel = Literal["time", "gyro", "accel", "temp", "mag"]
Gaps = Literal["raise", "keep"]
CHANNELS: tuple[Channel, ...] = ("time", "gyro", "accel", "temp", "mag")
QUANTITY: dict[Channel, Quantity] = {"time": "time", "gyro": "rate", "accel": "accel", "temp": "temp", "mag": "mag"}
AXES = ("x", "y", "z")
LM335_RANGE_C = (-40.0, 125.0)  # where the part works
MOST_TRIM_C = 20.0  # an untrimmed part is within 9 K by its data sheet
EXAMPLE = 'gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "T"'

# Ending of a native column name for each unit a channel may have.
GYRO_SUFFIX = {"rad/s": "rad_s", "dps": "dps", "count": "count", "v": "v"}
ACCEL_SUFFIX = {"m/s2": "m_s2", "g": "g", "mg": "mg", "count": "count", "v": "v"}
TEMP_SUFFIX = {"degc": "c", "lm335_v": "lm335_v", "count": "count", "v": "v"}


@dataclass(frozen=True, slots=True)
class Scale:
    """A linear conversion of one channel: value = gain * cell + offset."""

    # Unit of the channel per unit of the file; three for axes that differ in scale or sign
    gain: float | tuple[float, float, float] = 1.0
    offset: float | tuple[float, float, float] = 0.0  # Added afterwards, in the unit of the channel


@dataclass(frozen=True, slots=True, kw_only=True)
class Trim:
    """One-point trim of an LM335: what it said at a temperature known from elsewhere.

    The part's output is a line through 0 K, so that one point sets its slope: T = T_said (true + 273.15) / (reads + 273.15),
    all in K. The potentiometer at the part's third pin does the same.
    """

    reads_c: float  # Temperature that its voltage says, degC
    true_c: float  # Temperature that it had, degC

    def __post_init__(self) -> None:
        for name in ("reads_c", "true_c"):
            value = getattr(self, name)
            if not LM335_RANGE_C[0] <= value <= LM335_RANGE_C[1]:
                raise InputError(
                    f"temp_trim.{name}: wanted {LM335_RANGE_C[0]:g} to {LM335_RANGE_C[1]:g} degC, got {value:g}; state what the "
                    "LM335 said and what was true, both in degC"
                )
        if abs(self.true_c - self.reads_c) > MOST_TRIM_C:
            raise InputError(
                f"temp_trim: wanted a reading within {MOST_TRIM_C:g} K of the truth, got {self.reads_c:g} for {self.true_c:g} "
                "degC; a part that far off is broken or read through another scale"
            )

    @property
    def factor(self) -> float:
        """True over said absolute temperature, 1."""
        return (self.true_c + ZERO_CELSIUS_K) / (self.reads_c + ZERO_CELSIUS_K)


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLayout:
    """How the text of a table is laid out."""

    delimiter: str = ","  # One character; " " means one or more blanks or tabs
    header: bool = True  # True when the first line after the skipped ones names the columns
    skip_rows: int = 0  # Lines before the header, or before the first row where there is none
    decimal: str = "."  # "." or ","
    # Leave out rows with another number of columns, or with text where a number is wanted. They are counted
    drop_bad_rows: bool = False

    def __post_init__(self) -> None:
        if len(self.delimiter) != 1 or self.delimiter in "\r\n":
            raise InputError(
                f"delimiter: wanted one character, got {self.delimiter!r}; ',' ';' '\\t', or ' ' for any number of blanks"
            )
        if self.decimal not in (".", ",") or self.decimal == self.delimiter:
            raise InputError(f"decimal: wanted '.' or ',' and not the delimiter, got {self.decimal!r}")
        if self.skip_rows < 0:
            raise InputError(f"skip_rows: wanted 0 or more, got {self.skip_rows}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMap:
    """Where the channels are in a file, and in which units."""

    time: Column | None = None  # Time column; without it ``sample_rate_hz`` is required
    gyro: tuple[Column, ...] | None = None  # Three columns x, y, z
    accel: tuple[Column, ...] | None = None  # Three columns x, y, z
    temp: Column | None = None  # Temperature column
    mag: tuple[Column, ...] | None = None  # Three columns x, y, z
    time_unit: str = ""  # Unit after the scale is applied; any spelling of :mod:`undrift.units`
    gyro_unit: str = ""  # Unit after the scale is applied; any spelling of :mod:`undrift.units`
    accel_unit: str = ""  # Unit after the scale is applied; any spelling of :mod:`undrift.units`
    temp_unit: str = ""  # Unit after the scale is applied; any spelling of :mod:`undrift.units`
    mag_unit: str = ""  # Unit after the scale is applied; any spelling of :mod:`undrift.units`
    gyro_scale: Scale | None = None  # Conversion from the file's numbers to that unit
    accel_scale: Scale | None = None  # Conversion from the file's numbers to that unit
    temp_scale: Scale | None = None  # Conversion from the file's numbers to that unit
    mag_scale: Scale | None = None  # Conversion from the file's numbers to that unit
    temp_trim: Trim | None = None  # Of an LM335, where ``temp_unit`` is "lm335_v"
    sample_rate_hz: float | None = None  # Hz. Never defaulted; beside a time column it is checked against it
    layout: TextLayout = field(default_factory=TextLayout)  # For text files
    gaps: Gaps = "raise"  # "raise" refuses empty cells and NaN, "keep" keeps them as gaps
    repair_time: bool = False  # Leave out rows whose time does not go forward. They are counted
    frame: Frame = "s"  # "s" or "b"
    state: State = "raw"  # "raw" or "corrected"
    device: str = ""  # Serial number or name

    def __post_init__(self) -> None:
        if self.gyro is None and self.accel is None:
            raise InputError(f"columns: wanted gyro or accel, got neither; for example columns = {{ {EXAMPLE} }}")
        for channel in CHANNELS:
            self._check_channel(channel)
        if self.temp_trim is not None and (self.temp is None or self.unit_of("temp") != "lm335_v"):
            raise InputError(
                f'temp_trim: wanted units.temp = "lm335_v" beside it, got {self.temp_unit or "no temperature"}; a column in degC '
                "is shifted by scale.temp (gain 1, offset in K)"
            )
        if self.time is None and self.sample_rate_hz is None:
            raise InputError("columns: wanted a time column or sample_rate_hz, got neither; the rate is never assumed")
        if self.sample_rate_hz is not None and not 0.0 < self.sample_rate_hz < 1e7:
            raise InputError(f"sample_rate_hz: wanted Hz above 0, got {self.sample_rate_hz:g}")
        if self.gaps not in ("raise", "keep"):
            raise InputError(f"gaps: wanted 'raise' or 'keep', got {self.gaps!r}")

    def columns_of(self, channel: Channel) -> tuple[Column, ...]:
        """Return the columns of a channel, none where it is not mapped."""
        value = getattr(self, channel)
        return () if value is None else value if isinstance(value, tuple) else (value,)

    def unit_of(self, channel: Channel) -> str:
        """Return the unit of a mapped channel in its one spelling."""
        return canonical_unit(getattr(self, f"{channel}_unit"), QUANTITY[channel])

    def scale_of(self, channel: Channel) -> Scale | None:
        """Return the scale of a channel."""
        scale: Scale | None = None if channel == "time" else getattr(self, f"{channel}_scale")
        return scale

    def mapped(self) -> tuple[Channel, ...]:
        """Return the channels that have columns."""
        return tuple(channel for channel in CHANNELS if self.columns_of(channel))

    def _check_channel(self, channel: Channel) -> None:
        columns, unit = self.columns_of(channel), getattr(self, f"{channel}_unit")
        if channel in ("gyro", "accel", "mag") and len(columns) not in (0, 1, 3):
            raise InputError(f"columns.{channel}: wanted three columns x, y, z, got {len(columns)}; name all three")
        if columns and len(set(columns)) != len(columns):
            raise InputError(
                f"columns.{channel}: wanted three different columns, got {list(columns)}; name each axis once"
            )
        if columns and not unit:
            raise InputError(f"units.{channel}: wanted the unit of {channel}, got none; nothing is assumed")
        if columns and canonical_unit(unit, QUANTITY[channel]) in DEVICE_UNITS and channel in ("temp", "mag"):
            wanted = "degC" if channel == "temp" else "uT"
            part = ', or "lm335_v" for an LM335 in V' if channel == "temp" else ""
            raise InputError(
                f"units.{channel}: wanted {wanted}, got {unit}; give scale.{channel} (gain and offset to {wanted}) "
                f'and units.{channel} = "{wanted}"{part}, or leave {channel} out'
            )


def native_map(
    names: tuple[str, ...] | list[str], *, sample_rate_hz: float | None = None, layout: TextLayout | None = None
) -> ColumnMap:
    """Return the map of a file that uses undrift's own column names."""
    gyro, gyro_unit = _native_triple(names, "gyro", GYRO_SUFFIX)
    accel, accel_unit = _native_triple(names, "accel", ACCEL_SUFFIX)
    mag, mag_unit = _native_triple(names, "mag", {"ut": "ut"})
    if gyro is None and accel is None:
        raise InputError(
            f"columns: wanted names such as gyro_x_dps or accel_x_m_s2, got {_listed(names)}; undrift info FILE "
            "proposes a map of them, to be given with --map"
        )
    temps = [(f"temp_{suffix}", unit) for unit, suffix in TEMP_SUFFIX.items() if f"temp_{suffix}" in names]
    if len(temps) > 1:
        raise InputError(f"columns: wanted one temperature, got {temps[0][0]} and {temps[1][0]}; map the one to use")
    return ColumnMap(
        time="time_s" if "time_s" in names else None,
        gyro=gyro,
        accel=accel,
        mag=mag,
        temp=temps[0][0] if temps else None,
        time_unit="s",
        gyro_unit=gyro_unit,
        accel_unit=accel_unit,
        mag_unit=mag_unit,
        temp_unit=temps[0][1] if temps else "",
        sample_rate_hz=sample_rate_hz,
        layout=layout or TextLayout(),
    )


def is_native(names: tuple[str, ...] | list[str]) -> bool:
    """Tell whether a file uses undrift's own names for a gyroscope or an accelerometer."""
    return any(
        f"{channel}_{axis}_{suffix}" in names
        for channel, suffixes in (("gyro", GYRO_SUFFIX), ("accel", ACCEL_SUFFIX))
        for suffix in suffixes.values()
        for axis in AXES
    )


def _native_triple(
    names: tuple[str, ...] | list[str], channel: str, suffixes: dict[str, str]
) -> tuple[tuple[Column, ...] | None, str]:
    found: list[tuple[tuple[Column, ...], str]] = []
    for unit, suffix in suffixes.items():
        triple = tuple(f"{channel}_{axis}_{suffix}" for axis in AXES)
        here = [name for name in triple if name in names]
        if here and len(here) < 3:
            raise InputError(
                f"columns: wanted {', '.join(triple)}, got only {', '.join(here)}; add the missing axes or map the columns"
            )
        if here:
            found.append((triple, unit))
    if len(found) > 1:
        raise InputError(
            f"columns: wanted {channel} in one unit, got {found[0][1]} and {found[1][1]}; map the one to use"
        )
    return found[0] if found else (None, "")


def _listed(names: tuple[str, ...] | list[str]) -> str:
    shown = ", ".join(repr(name) for name in names[:12])
    return f"{shown}, ... ({len(names)} columns)" if len(names) > 12 else shown or "no columns"
