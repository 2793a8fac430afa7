"""StreamDescription: what a device sends: which channels in which order, in which units, how it is framed.

Written in an address, ``tcp://host:port?channels=count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,temp&rate=100&gyro_unit=count``,
or under ``[stream]`` in a TOML file with the same keys, which an address names as ``description=FILE``.
"""

import tomllib
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.live.checksums import CHECKSUMS
from undrift.record import Record
from undrift.units import canonical_unit

Framing = Literal["line", "frame"]
COUNTER, IGNORED = "count", "-"
TRIADS = ("gyro", "accel", "mag")
MEASURED = (*(f"{triad}_{axis}" for triad in TRIADS for axis in "xyz"), "temp")


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamDescription:
    """What a device sends.

    Parameters
    ----------
    channels : tuple of str
        In order: gyro_x .. accel_z, mag_x (uT), temp; ``count`` for the device's own counter, ``-`` for what is left out.
    rate : float
        Nominal readings per second of the device.
    gyro_unit, accel_unit : str
        Units as sent: rad/s, dps, m/s2, g, mg, count or v.
    temp_scale, temp_zero : float
        degC = temp_scale * sent + temp_zero.
    tick : float
        Device seconds a step of the counter; 0 for a counter of readings.
    counter_bits : int
        Width of the counter; 0 for one that never wraps.
    format : str
        line (text) or frame (binary).
    separator : str
        Between the numbers of a line.
    checksum : str
        none, xor, sum, crc16 or crc32: behind a line as ``*hex``, behind a frame as bytes.
    sync : str
        First bytes of a frame, hex.
    pack : str
        Fields of a frame as Python's struct writes them, one for each channel, little (<) or big (>) end first.
    clock_speed : float
        Device seconds per host second: 1 for hardware, an emulator's speed otherwise.
    device : str
        Serial number or name.
    """

    channels: tuple[str, ...] = (COUNTER, *MEASURED[:6])
    rate: float = 0.0
    gyro_unit: str = "count"
    accel_unit: str = "count"
    temp_scale: float = 1.0
    temp_zero: float = 0.0
    tick: float = 0.0
    counter_bits: int = 0
    format: Framing = "line"
    separator: str = ","
    checksum: str = "none"
    sync: str = "aa55"
    pack: str = ""
    clock_speed: float = 1.0
    device: str = ""

    def __post_init__(self) -> None:
        self._check_channels()
        for name in ("rate", "clock_speed"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise InputError(f"stream: wanted {name} above 0, got {getattr(self, name)}; there is no default")
        object.__setattr__(self, "gyro_unit", canonical_unit(self.gyro_unit, "rate"))
        object.__setattr__(self, "accel_unit", canonical_unit(self.accel_unit, "accel"))
        if self.format not in get_args(Framing):
            raise InputError(f"stream: wanted format line or frame, got '{self.format}'; name one of them")
        if self.checksum not in CHECKSUMS:
            raise InputError(f"stream: wanted checksum {', '.join(CHECKSUMS)}, got '{self.checksum}'; name one of them")
        if not 0 <= self.counter_bits <= 53 or self.tick < 0.0:
            raise InputError(
                f"stream: wanted counter_bits 0 to 53 and a tick of 0 or more, got {self.counter_bits} and {self.tick:g}; "
                "look into the device's manual"
            )

    @property
    def measured(self) -> tuple[str, ...]:
        """Channels that are kept, in the order of a chunk's values."""
        return tuple(name for name in self.channels if name not in (COUNTER, IGNORED))

    @property
    def has_counter(self) -> bool:
        """Whether the device counts for itself."""
        return COUNTER in self.channels

    @property
    def tick_s(self) -> float:
        """Device seconds a step of the counter."""
        return self.tick if self.has_counter and self.tick > 0.0 else 1.0 / self.rate

    def record(self, time: FloatArray, values: FloatArray) -> Record:
        """Return readings as a record.

        Parameters
        ----------
        time : array, shape (N,)
            s, strictly increasing.
        values : array, shape (N, C)
            Raw, in the order of ``measured``; NaN rows are gaps.

        Returns
        -------
        Record
            Raw, frame s.
        """
        place = {name: column for column, name in enumerate(self.measured)}

        def triad(name: str) -> FloatArray | None:
            names = [f"{name}_{axis}" for axis in "xyz"]
            return values[:, [place[each] for each in names]] if names[0] in place else None

        temp = values[:, place["temp"]] * self.temp_scale + self.temp_zero if "temp" in place else None
        return Record(
            time=time,
            gyro=triad("gyro"),
            accel=triad("accel"),
            mag_ut=triad("mag"),
            temp_c=temp,
            gyro_unit=self.gyro_unit,
            accel_unit=self.accel_unit,
            device=self.device,
        )

    def split(self, rows: FloatArray) -> tuple[FloatArray | None, FloatArray]:
        """Take decoded rows apart.

        Parameters
        ----------
        rows : array, shape (N, K)
            A column for each of ``channels``.

        Returns
        -------
        array, shape (N,), or None
            The counter.
        array, shape (N, C)
            What is measured.
        """
        kept = [column for column, name in enumerate(self.channels) if name not in (COUNTER, IGNORED)]
        counter = rows[:, self.channels.index(COUNTER)] if self.has_counter else None
        return counter, np.ascontiguousarray(rows[:, kept])

    def _check_channels(self) -> None:
        names = [name for name in self.channels if name != IGNORED]
        known = (COUNTER, IGNORED, *MEASURED)
        wrong = [name for name in names if name not in known]
        if wrong or len(set(names)) < len(names):
            what = wrong[0] if wrong else next(name for name in names if names.count(name) > 1)
            raise InputError(
                f"stream: wanted channels out of {', '.join(known)}, each once, got '{what}'; mend the list"
            )
        for triad in TRIADS:
            held = sum(name.startswith(triad) for name in names)
            if held not in (0, 3):
                raise InputError(f"stream: wanted all three axes of {triad}, got {held}; name x, y and z")
        if not any(name.startswith(("gyro", "accel")) for name in names):
            raise InputError("stream: wanted channels of gyro or accel, got neither; say what the device sends")


def described(base: StreamDescription | None, options: tuple[tuple[str, str], ...]) -> StreamDescription:
    """Return a description with options of an address in it.

    Parameters
    ----------
    base : StreamDescription or None
        What the options change.
    options : tuple of (str, str)
        Names of fields and their values as text.

    Returns
    -------
    StreamDescription
        Checked.

    Raises
    ------
    InputError
        An option that is not one, or a value that does not fit it.
    """
    kinds = {field.name: type(field.default) for field in fields(StreamDescription)}
    given: dict[str, object] = {}
    for name, text in options:
        if name not in kinds:
            raise InputError(f"stream: wanted options out of {', '.join(kinds)}, got '{name}'; mend the address")
        try:
            given[name] = _read(text, kinds[name])
        except ValueError as error:
            raise InputError(f"stream: wanted a number for {name}, got '{text}'; mend the address") from error
    return _made(base, given)


def read_description(path: str | Path) -> StreamDescription:
    """Read a description from a TOML file.

    Parameters
    ----------
    path : str or Path
        With a table ``[stream]``.

    Returns
    -------
    StreamDescription
        Checked.

    Raises
    ------
    FileFormatError
        No such file, not TOML, or not a description.
    """
    try:
        held = tomllib.loads(Path(path).read_text(encoding="utf-8")).get("stream")
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path}: wanted a stream description, got '{error}'; check the file") from error
    kinds = {field.name: type(field.default) for field in fields(StreamDescription)}
    if not isinstance(held, dict) or not held.keys() <= kinds.keys():
        raise FileFormatError(f"{path}: wanted [stream] with keys out of {', '.join(kinds)}, got others; mend the file")
    given = {name: tuple(value) if isinstance(value, list) else value for name, value in held.items()}
    for name, value in given.items():
        number = isinstance(value, int) and not isinstance(value, bool) and kinds[name] is float
        if not number and type(value) is not kinds[name]:
            raise FileFormatError(f"{path}: wanted {kinds[name].__name__} for {name}, got {value!r}; mend the file")
    try:
        return _made(None, given)
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _read(text: str, kind: type) -> object:
    if kind is tuple:
        return tuple(text.split(","))
    return int(text) if kind is int else float(text) if kind is float else text


def _made(base: StreamDescription | None, given: dict[str, object]) -> StreamDescription:
    if base is None:
        return StreamDescription(**given)  # type: ignore[arg-type]
    return replace(base, **given)  # type: ignore[arg-type]
