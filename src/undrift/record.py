"""Values of a recording: Record (readings of a device), Reference (poses from optics) and Session (recordings with labels).

A Record contains the readings in the unit of the device, and the name of the unit. NaN always means a gap. Time strictly increases,
which is checked here, once. There is no default sample rate.

Ranges are sample numbers, half-open [start, stop). A face is named after the sensor axis that points up and reads +g.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import BoolArray, FloatArray, Shape, freeze, frozen
from undrift.base.codec import stored
from undrift.errors import InputError
from undrift.frames import Frame
from undrift.shown import Shown
from undrift.units import Quantity, canonical_unit, si_factor

if TYPE_CHECKING:
    import pandas as pd

State = Literal["raw", "corrected"]
CHANNELS = ("time", "gyro", "accel", "temp_c", "mag_ut")  # channels of a record
LARGEST_SPAN_M = 50.0  # largest extent of positions from optics, m


@stored()
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceUncertainty:
    """Uncertainty of the accelerometers of a corrected record. The error of a specific force f is E f + d."""

    covariance: Annotated[FloatArray, Shape(12, 12)]  # covariance of the elements of E, row by row, and of d, m/s2
    # lowest and highest temperature for which offsets and matrix were determined, degC, NaN if unknown
    offset_temp_c: Annotated[FloatArray, Shape(2)]
    matrix_temp_c: Annotated[FloatArray, Shape(2)]
    # standard deviation per kelvin outside this range: offset (m/s2), scale (relative)
    per_k: Annotated[FloatArray, Shape(2)]
    step: Annotated[FloatArray, Shape(3)]  # code step, m/s2, or 0 if unknown
    calibrated: str = ""  # time of the calibration, ISO 8601, UTC, or "" if unknown

    def __post_init__(self) -> None:
        freeze(self)
        if np.isnan([*self.covariance.ravel(), *self.per_k, *self.step]).any() or not isinstance(self.calibrated, str):
            raise InputError("ForceUncertainty: expected finite numbers and a date. Correct the recording again.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record(Shown):
    """Readings of a device.

    Parameters
    ----------
    time : array, shape (N,)
        s, strictly increasing.
    gyro, accel : array, shape (N, 3), or None
        Readings of angular rate and specific force. None if the file has no such triad.
    temp_c : array, shape (N,), or None
        Temperature at the sensor, degC.
    mag_ut : array, shape (N, 3), or None
        Magnetic field, uT.
    gyro_unit, accel_unit : str
        Unit of the gyroscopes: rad/s, dps, count or v. Unit of the accelerometers: m/s2, g, mg, count or v.
    frame, state : str
        Frame: "s" for sensor axes, "b" for the device case. State: "raw" or "corrected".
    device : str
        Serial number or name, or "" if the file does not contain it.
    accel_uncertainty, offset_uncertainty : ForceUncertainty or None, float or None
        For a corrected record only: the uncertainty of the accelerometers, and the standard uncertainty in motion, rad/s, of a
        subtracted offset.

    Raises
    ------
    InputError
        If shapes disagree, time does not increase, or a unit is unknown.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> record = undrift.Record(time=np.arange(3) / 100.0, gyro=np.zeros((3, 3)), gyro_unit="dps")
    >>> len(record), record.sample_rate_hz, record.accel is None
    (3, 100.0, True)
    """

    time: Annotated[FloatArray, Shape("n")]
    gyro: Annotated[FloatArray | None, Shape("n", 3)] = None
    accel: Annotated[FloatArray | None, Shape("n", 3)] = None
    temp_c: Annotated[FloatArray | None, Shape("n")] = None
    mag_ut: Annotated[FloatArray | None, Shape("n", 3)] = None
    gyro_unit: str = "rad/s"
    accel_unit: str = "m/s2"
    frame: Frame = "s"
    state: State = "raw"
    device: str = ""
    accel_uncertainty: ForceUncertainty | None = None
    offset_uncertainty: float | None = None

    def __post_init__(self) -> None:
        freeze(self)
        if self.gyro is None and self.accel is None:
            raise InputError("record: gyro or accel readings are needed, got neither. Map their columns.")
        object.__setattr__(self, "gyro_unit", canonical_unit(self.gyro_unit, "rate"))
        object.__setattr__(self, "accel_unit", canonical_unit(self.accel_unit, "accel"))
        check_time(self.time)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def sample_rate_hz(self) -> float:
        """Samples per second. Drop-outs are excluded from the mean."""
        return sample_rate_of(self.time)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    @classmethod
    def from_arrays(
        cls,
        *,
        gyro: ArrayLike | None = None,
        accel: ArrayLike | None = None,
        gyro_unit: str = "",
        accel_unit: str = "",
        time: ArrayLike | None = None,
        sample_rate_hz: float | None = None,
        temp_c: ArrayLike | None = None,
        device: str = "",
    ) -> "Record":
        """Create a raw record in sensor axes from arrays.

        Readings are (N, 3) in ``gyro_unit`` (rad/s, dps, count or v) and ``accel_unit`` (m/s2, g, mg, count or v). ``temp_c`` is
        (N,), degC. Give ``time`` (N,), s, or the ``sample_rate_hz`` of an even clock. Units and clock are never assumed: InputError
        is raised if either is missing.

        Examples
        --------
        >>> import numpy as np, undrift
        >>> record = undrift.Record.from_arrays(accel=np.ones((200, 3)), accel_unit="g", sample_rate_hz=50.0)
        >>> len(record), record.duration_s
        (200, 3.98)
        """
        triads = (("gyro", gyro, gyro_unit, "dps"), ("accel", accel, accel_unit, "g"))
        clock = _choose_clock([_check_triad(*triad) for triad in triads], time, sample_rate_hz)
        channels: dict[str, Any] = {"time": clock, "gyro": gyro, "accel": accel, "temp_c": temp_c, "device": device}
        return cls(**channels, gyro_unit=gyro_unit or "rad/s", accel_unit=accel_unit or "m/s2")

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        *,
        columns: Mapping[str, str | Sequence[str]] | None = None,
        units: Mapping[str, str] | None = None,
        sample_rate_hz: float | None = None,
        gaps: Literal["raise", "keep"] = "raise",
        device: str = "",
    ) -> "Record":
        """Create a record from a pandas or polars DataFrame, or from a table with the Arrow C stream interface.

        undrift's own column names (gyro_x_dps, accel_z_g, temp_c, time_s) need no other argument. ``columns`` maps channels to
        columns, as in {"time": "t", "gyro": ["gx", "gy", "gz"]}, ``units`` maps channels to units. Time may be the index, in s or
        as dates. With ``gaps="raise"``, NaN is refused. With "keep", it becomes a gap. InputError is raised if a column, unit or
        clock is missing, or for gaps, and FileFormatError if cells are not numbers.

        Examples
        --------
        >>> import pandas as pd, undrift
        >>> frame = pd.DataFrame({"ax": [0.0, 0.0], "ay": [0.0, 0.0], "az": [1.0, 1.0]})
        >>> how = {"columns": {"accel": ["ax", "ay", "az"]}, "units": {"accel": "g"}}
        >>> undrift.Record.from_frame(frame, **how, sample_rate_hz=10.0).accel_unit
        'g'
        """
        from undrift.io.dataframes import read_frame

        return read_frame(frame, columns, units or {}, sample_rate_hz=sample_rate_hz, gaps=gaps, device=device)

    def to_frame(self) -> "pd.DataFrame":
        """Return the record as a pandas DataFrame with undrift's own column names. ``from_frame`` reads it back."""
        from undrift.io.dataframes import frame_of

        return frame_of(self)

    def facts(self) -> dict[str, str]:
        """Return the rows of the table of values: name, and value with unit."""
        triads = (("gyroscope", self.gyro, self.gyro_unit), ("accelerometer", self.accel, self.accel_unit))
        temp, span = self.temp_c, ""
        if temp is not None and not np.isnan(temp).all():
            span = f"{np.nanmin(temp):.1f} to {np.nanmax(temp):.1f} degC"
        rows = {
            "device": self.device,
            "samples": f"{len(self)}, {self.duration_s:.4g} s at {self.sample_rate_hz:.4g} Hz",
            **{name: unit for name, values, unit in triads if values is not None},
            "temperature": span,
            "state": f"{self.state}, {'sensor axes' if self.frame == 's' else 'case axes'}",
        }
        return {name: text for name, text in rows.items() if text}

    def part(self, start: int, stop: int) -> "Record":
        """Return the samples [start, stop)."""
        channels = {name: getattr(self, name) for name in CHANNELS}
        return replace(self, **{name: values[start:stop] for name, values in channels.items() if values is not None})

    def between(self, start_s: float, stop_s: float) -> "Record":
        """Return the samples with start_s <= time < stop_s, on the clock of the record."""
        start, stop = np.searchsorted(self.time, (start_s, stop_s))
        return self.part(int(start), int(stop))

    def computed(self, **fields: Any) -> "Record":
        """Return a copy with other fields, without checks. Use it for readings computed from the record, sample by sample."""
        record = copy(self)
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value = value.view()
                value.flags.writeable = False
            object.__setattr__(record, name, value)
        return record

    def in_si(self) -> "Record":
        """Return the record in rad/s and m/s2. Raise InputError if its readings are counts or volts."""
        return self.in_units("rad/s", "m/s2")

    def in_units(self, gyro_unit: str, accel_unit: str) -> "Record":
        """Return the record in other physical units. Raise InputError if only the old or only the new unit is physical."""
        changes = dict[str, Any]()
        triads: tuple[tuple[str, str, Quantity], ...] = (("gyro", gyro_unit, "rate"), ("accel", accel_unit, "accel"))
        for name, unit, quantity in triads:
            values, old, new = getattr(self, name), getattr(self, f"{name}_unit"), canonical_unit(unit, quantity)
            if values is not None and old != new:
                changes[name] = values * (si_factor(old, quantity) / si_factor(new, quantity))
                changes[f"{name}_unit"] = new
        return replace(self, **changes) if changes else self


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """Poses of a rigid body, measured with an independent instrument.

    Parameters
    ----------
    time : array, shape (N,)
        s, strictly increasing, on the clock of the reference.
    q_nb : array, shape (N, 4)
        Orientation, body to level frame, w-x-y-z. NaN rows are gaps.
    position : array, shape (N, 3), or None
        Position of the body's origin in n, m. NaN rows are gaps.
    moving : array, shape (N,), or None
        1 during motion marked by the author of the recording, otherwise 0.
    name : str
        Source of the poses, such as a file name.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> trial = undrift.simulate_trial("step", undrift.random_device(np.random.default_rng(1)), rng=np.random.default_rng(2))
    >>> trial.reference.q_nb.shape[1]
    4
    """

    time: Annotated[FloatArray, Shape("n")]
    q_nb: Annotated[FloatArray, Shape("n", 4)]
    position: Annotated[FloatArray | None, Shape("n", 3)] = None
    moving: Annotated[FloatArray | None, Shape("n")] = None
    name: str = ""

    def __post_init__(self) -> None:
        freeze(self)
        norm = np.linalg.norm(self.q_nb, axis=1)
        if (np.abs(norm[np.isfinite(norm)] - 1.0) > 1e-3).any():
            raise InputError(
                "q_nb: expected unit quaternions w-x-y-z, got other lengths. Check the columns and their order."
            )
        object.__setattr__(self, "q_nb", frozen(self.q_nb / norm[:, None], (None, 4), "q_nb"))
        if self.position is not None:
            finite = self.position[np.isfinite(self.position).all(axis=1)]
            span = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
            if span > LARGEST_SPAN_M:
                raise InputError(
                    f"position: expected m, within {LARGEST_SPAN_M:g} m, got a span of {span:.0f}: positions are in mm, not m. "
                    "Convert them.",
                    span=span,
                )
        check_time(self.time)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def sample_rate_hz(self) -> float:
        """Poses per second. Drop-outs are excluded from the mean."""
        return sample_rate_of(self.time)

    @property
    def valid(self) -> BoolArray:
        """True for samples with an orientation, shape (N,)."""
        return np.isfinite(self.q_nb[:, 0])


def check_time(time: FloatArray) -> None:
    """Raise InputError unless time strictly increases, without gaps, over two or more samples."""
    if len(time) < 2:
        raise InputError(
            f"time: expected two samples or more, got {len(time)}. The file contains no recording.", samples=len(time)
        )
    if np.isnan(time).any():
        row = int(np.flatnonzero(np.isnan(time))[0])
        raise InputError(f"time: expected a number in every row, got NaN first in row {row}. Repair the file.", row=row)
    steps = np.diff(time)
    if (steps <= 0.0).any():
        row = int(np.flatnonzero(steps <= 0.0)[0]) + 1
        raise InputError(
            f"time: expected strictly increasing seconds, got {int((steps <= 0).sum())} steps that go back or repeat, first in "
            f"row {row} ({time[row - 1]:.6g} s then {time[row]:.6g} s). Repair the time if these rows can be dropped.",
            row=row,
        )


def sample_rate_of(time: FloatArray) -> float:
    """Return samples per second. Drop-outs (steps over 1.5 medians) are excluded from the mean."""
    steps = np.diff(time)
    if len(steps) and steps.max() > 1.5 * steps.min():
        steps = steps[steps <= 1.5 * np.median(steps)]
    return float(1.0 / steps.mean())


def _check_triad(name: str, values: ArrayLike | None, unit: str, example: str) -> int:
    """Return the number of samples of a triad passed to from_arrays. Raise InputError if it has no unit or is transposed."""
    shape = () if values is None else np.shape(values)
    if len(shape) == 2 and shape[0] == 3 and shape[1] != 3:
        raise InputError(f"from_arrays: expected {name} of shape (N, 3), got {shape}. Time is axis 0. Give {name}.T.")
    if values is not None and not unit:
        raise InputError(
            f"from_arrays: {name} has no unit, and none is assumed. Give it, for example {name}_unit={example!r}."
        )
    return shape[0] if shape else 0


def _choose_clock(counts: Sequence[int], time: ArrayLike | None, sample_rate_hz: float | None) -> ArrayLike:
    """Return the time for from_arrays, s: the given time, or an even clock."""
    if (time is None) == (sample_rate_hz is None) or not (sample_rate_hz is None or sample_rate_hz > 0.0):
        got = "both" if time is not None else "neither" if sample_rate_hz is None else f"{sample_rate_hz:g} Hz"
        raise InputError(f"from_arrays: expected time in s or a sample_rate_hz above 0, got {got}. Give one of them.")
    return np.arange(max(counts)) / (sample_rate_hz or np.nan) if time is None else time


# ---- session

Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Axis = Literal["x", "y", "z"]
Kind = Literal["calibration", "thermal", "static"]
Mounting = Literal["each", "one"]
GravitySource = Literal["stated", "latitude and height", "standard"]
FACES: tuple[Face, ...] = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True, slots=True, kw_only=True)
class Still:
    """A range of samples in which the device did not move.

    Parameters
    ----------
    start, stop : int
        Samples [start, stop).
    face : str or None
        Axis that points up. None for a free pose.
    recording, temp_c : int, float or None
        Number of the record in the session. Chamber set-point, degC, if there is no temperature column.

    Examples
    --------
    >>> import undrift
    >>> undrift.Still(start=0, stop=500, face="+z").face
    '+z'
    """

    start: int
    stop: int
    face: Face | None = None
    recording: int = 0
    temp_c: float | None = None

    def __post_init__(self) -> None:
        _check_range(self.start, self.stop, "still")


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """A range of samples in which the device turned: at a steady rate, through a known angle, or freely.

    Parameters
    ----------
    start, stop : int
        Samples [start, stop).
    axis : str or None
        Case axis of the turn. None for a free rotation.
    turn_rate, angle : float or None
        Steady rate achieved about +axis, rad/s (rate table). Angle turned about +axis, rad (known rotation).
    recording, temp_c : int, float or None
        Number of the record in the session. Chamber set-point, degC.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> undrift.Turn(start=0, stop=500, axis="z", turn_rate=np.pi / 2).axis
    'z'
    """

    start: int
    stop: int
    axis: Axis | None = None
    turn_rate: float | None = None
    angle: float | None = None
    recording: int = 0
    temp_c: float | None = None

    def __post_init__(self) -> None:
        _check_range(self.start, self.stop, "turn")


@dataclass(frozen=True, slots=True)
class FileMap:
    """Column map for the files of a device, with the keys described in docs/maps.md."""

    text: str  # text of one JSON object


def _check_settings(settings: "TemperatureSensitivity | RateTable", most: float, **limits: float) -> None:
    for item in fields(settings):
        value, limit = getattr(settings, item.name), limits.get(item.name, most)
        if not 0.0 <= value <= limit:
            raise InputError(f"session: expected {item.name} from 0 to {limit:g}, got {value:g}. Correct it.")


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureSensitivity:
    """Sensitivity of a device to temperature: standard deviations of its coefficients, from data sheets.

    The defaults suit consumer parts. The data sheets of MPU-6050, ICM-20948 and BMI160 specify offset changes of +-0.05 deg/s/K
    and +-0.8 to 1 mg/K, and sensitivity changes of +-0.02 to 0.05 %/K. For accelerometers and scale factors, these bounds count
    as two standard deviations.
    """

    gyro_offset_dps_per_k: float = 0.05  # change of the zero-rate output, deg/s/K
    accel_offset_mg_per_k: float = 0.5  # change of the zero-g offset, mg/K
    gyro_scale_percent_per_k: float = 0.02  # change of the gyroscope scale factor, %/K
    accel_scale_percent_per_k: float = 0.02  # change of the accelerometer scale factor, %/K
    # assumed temperature change, K, if neither a thermometer nor rests in deg/s can determine it
    unrecorded_span_k: float = 1.0
    # lag of the thermometer behind the sensors, s: assumed to be 0 on the same die, and 80 for an LM335 in still air
    thermometer_lag_s: float = 0.0
    span_limit_k: float = 2.0  # temperature change within a session above which a finding is reported, K

    def __post_init__(self) -> None:
        _check_settings(self, 100.0)


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class RateTable:
    """Standard uncertainties of a rate table and of the mounting on it. If gravity determines an axis, its measurement is used."""

    table_level_deg: float = 0.1  # tilt of the table axis from the vertical, about each horizontal axis, deg
    mount_tilt_deg: float = 0.1  # tilt of the device from the table axis, about each perpendicular axis, deg
    rate_uncertainty: float = 1e-4  # common relative error of all rates, from crystal and gear
    wobble_deg: float = 0.01  # tilt of the table axis from dwell to dwell, about each perpendicular axis, deg

    def __post_init__(self) -> None:
        _check_settings(self, 10.0, rate_uncertainty=0.1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Session:
    """Recordings of a device, with labels for rests and turns.

    Parameters
    ----------
    kind : str
        calibration, thermal or static.
    serial, gravity_m_s2 : str, float
        Serial number of the device, and local gravity, m/s2.
    records : tuple of Record
        One or more recordings.
    stills, turns : tuple of Still, tuple of Turn
        Rests and turns listed in the file. If empty, they are detected in the data.
    inputs : tuple of (str, str)
        File name and sha256 of every file that was read.
    file_map : FileMap or None
        Column map for the files, if they need one.
    gravity_source : str
        "stated", "latitude and height" (computed with WGS 84), or "standard" (standard gravity, assumed).
    sensitivity, rate_table : TemperatureSensitivity, RateTable
        Sensitivity to temperature, and uncertainties of the rate table and of the mounting on it.
    mounting : str or None
        For a fit to references: "one" if device and reference body were mounted once for all recordings, "each" if a small
        rotation is fitted for each recording. None if unknown.
    notes : tuple of str
        Notes on the reading of the files.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> session = undrift.simulate_session("six_face", device, rng=rng)
    >>> session.kind, len(session.records), len(session.stills)
    ('calibration', 1, 6)
    """

    kind: Kind
    serial: str
    gravity_m_s2: float
    records: tuple[Record, ...]
    stills: tuple[Still, ...] = ()
    turns: tuple[Turn, ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()
    file_map: FileMap | None = None
    gravity_source: GravitySource = "stated"
    sensitivity: TemperatureSensitivity = TemperatureSensitivity()
    rate_table: RateTable = RateTable()
    mounting: Mounting | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.records:
            raise InputError("session: expected one recording or more, got none. Add a [[recording]] to session.toml.")
        if len(self.serial) > 200 or not self.serial.isprintable():
            raise InputError(
                f"session: expected a serial number of up to 200 printable characters, got {len(self.serial)}. Correct it."
            )
        check_local_gravity(self.gravity_m_s2, "session")
        pieces: tuple[Still | Turn, ...] = (*self.stills, *self.turns)
        for piece in pieces:
            if not 0 <= piece.recording < len(self.records) or piece.stop > len(self.records[piece.recording]):
                raise InputError(
                    f"session: expected samples inside a recording, got [{piece.start}, {piece.stop}) of recording "
                    f"{piece.recording}. Check start_s and stop_s."
                )

    @property
    def begins_s(self) -> FloatArray:
        """Start time of each recording on the clock of the session, (R,), s. Recordings follow each other without a pause."""
        return np.cumsum([0.0, *(record.duration_s for record in self.records[:-1])])


def check_local_gravity(gravity_m_s2: float, what: str) -> None:
    """Raise InputError if a value cannot be gravity on Earth."""
    if not 9.7 < gravity_m_s2 < 9.9:
        raise InputError(
            f"{what}: expected local gravity between 9.7 and 9.9 m/s2, got {gravity_m_s2:g}. "
            "Give `gravity_m_s2`, or `latitude_deg` and `height_m`."
        )


def joined(records: Sequence[Record]) -> Record:
    """Return consecutive records of a device as a single record. A channel that is missing in any record is dropped."""
    first, *later = records
    if not later:
        return first
    columns = dict[str, Any]()
    for name in CHANNELS:
        parts = [getattr(record, name) for record in records]
        columns[name] = None if any(value is None for value in parts) else np.concatenate(parts)
    return replace(first, **columns)


def _check_range(start: int, stop: int, what: str) -> None:
    if not 0 <= start < stop:
        raise InputError(f"{what}: expected samples 0 <= start < stop, got [{start}, {stop}). Check start and stop.")
