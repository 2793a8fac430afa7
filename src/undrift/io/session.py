"""session.toml: the recordings of a calibration and the actions in them. Column maps in TOML, in a session or in a
separate file.

[session]
kind = "calibration"                # calibration | thermal | static
serial = "MTi-1"
gravity_m_s2 = 9.81                 # or latitude_deg and height_m
mounting = "one"                    # of a fit to references: one mounting for all recordings; each its own without it
[rate_table]                        # standard uncertainties; may be left out, and so may each key: the defaults
table_level_deg = 0.1               # axis of the table against the vertical
mount_tilt_deg = 0.1                # device against that axis, about each axis across
rate_uncertainty = 0.0001           # of all rates in common, relative
wobble_deg = 0.01                   # axis of the table from dwell to dwell
[temperature]                       # how far the device may follow it, standard deviations; the defaults, of consumer parts
gyro_offset_dps_per_k = 0.05
accel_offset_mg_per_k = 0.5
gyro_scale_percent_per_k = 0.02
accel_scale_percent_per_k = 0.02
unrecorded_span_k = 1.0             # change of temperature where neither a column nor rests in deg/s show it
thermometer_lag_s = 0.0             # of the thermometer behind the sensors: 80 for an LM335 in still air
span_limit_k = 2.0                  # a larger change within the session is a finding
[[recording]]
file = "session.csv"                # and the keys of a map; none for undrift's own names and known formats
[[recording]]                       # files side by side, one time base: as many tables of columns as files
file = ["acc.txt", "gyro.txt"]
columns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]
units = { time = "s", accel = "count", gyro = "count" }
[[still]]                           # start_s, stop_s on the recording's own clock; optional face, temp_c
[[turn]]                            # likewise; optional axis, turn_rate_dps or angle_deg, temp_c

A map: the keys of a [[recording]] without its file.

sample_rate_hz = 102.4
columns = { time = "t", gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "T" }     # names, or positions from 0
units = { time = "s", gyro = "dps", accel = "m/s2", temp = "degC" }
scale = { temp = { gain = 0.00294117647, offset = 36.53 } }     # value = gain * cell + offset
delimiter = ","      # " " for any number of blanks          header = true     skip_rows = 0     decimal = "."
gaps = "raise"       # or "keep"         repair_time = false     drop_bad_rows = false     frame = "s"     device = ""
temp_file = { file = "thermometer.csv", time = "t", temp = "T", time_unit = "s", temp_unit = "degC", shift_s = 0.0 }   # of its own
clock = "file"       # or "regular" for stamps of a host; columns.counter names the device's own counter of samples
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, MinLen
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from undrift.arrays import FloatArray
from undrift.base import codec
from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, sha256_of, unwritten, write_together
from undrift.io.columns import Channel, ChannelScale, Clock, ColumnMap, Gaps, ReadSettings, TempFile, TextLayout, naming
from undrift.io.formats import read_record, settled
from undrift.io.parquet import write_parquet
from undrift.io.phone import phone_pair, read_phone_pair
from undrift.record import (
    Axis,
    Face,
    FileMap,
    GravitySource,
    Kind,
    Mounting,
    RateTable,
    Record,
    Session,
    Still,
    TemperatureSensitivity,
    Turn,
)
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, gravity_at

# ---- column maps

Finite = Annotated[float, Field(allow_inf_nan=False)]
# For undrift's own names
NATIVE_KEYS = {"sample_rate_hz", "gaps", "repair_time", "drop_bad_rows", "clock", "temp_file", "leave_out"}
_SEAL = "# sha256 of all below: "
_LAYOUT = {"delimiter", "header", "skip_rows", "decimal"}


class TomlTable(BaseModel):
    """A TOML table: unknown keys are an error, and nothing is converted on the quiet."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class ColumnsEntry(TomlTable):
    """Which column is which channel: a name in the header, or a position from 0."""

    time: str | int | None = None  # Time column
    gyro: list[str | int] | str | None = None  # Columns x, y, z, or one array name (npz, mat)
    accel: list[str | int] | str | None = None
    temp: str | int | None = None  # Temperature column
    mag: list[str | int] | str | None = None  # Columns x, y, z
    counter: str | int | None = None  # The device's own counter of samples, for clock = "regular"


class TempFileEntry(TomlTable):
    """A thermometer's file of its own."""

    file: str  # text table, next to the map
    time: str | int = "time_s"  # Time column
    temp: str | int = "temp_c"  # Temperature column
    time_unit: str = "s"  # Any spelling of :mod:`undrift.units`
    temp_unit: str = "degC"
    shift_s: Finite = 0.0  # Added to its time to give the recording's
    delimiter: str = ","  # a single character; " " for any number of blanks or tabs
    header: bool = True  # Whether a line names the columns
    skip_rows: int = 0  # Lines before the header or the first row
    decimal: str = "."  # "." or ","


class MapEntry(TomlTable):
    """All information that a reader needs about a foreign file. The keys are explained in
    :class:`undrift.io.columns.ColumnMap`.
    """

    sample_rate_hz: float | None = None  # Hz, required without a time column
    # one table, or a table for each of several files that form one recording
    columns: ColumnsEntry | list[ColumnsEntry] | None = None
    units: dict[Channel, str] = {}  # Unit of each mapped channel, in any spelling of :mod:`undrift.units`
    # conversions to those units: value = gain * cell + offset, with one gain or three for x, y, z
    scale: dict[Literal["gyro", "accel", "temp", "mag"], ChannelScale] = {}
    delimiter: str = ","  # a single character; " " for any number of blanks or tabs
    header: bool = True  # Whether a line names the columns
    skip_rows: int = 0  # Lines before the header or the first row
    decimal: str = "."  # "." or ","
    drop_bad_rows: bool = False  # Leave out rows that do not parse
    gaps: Gaps = "raise"  # "raise" or "keep"
    repair_time: bool = False  # Leave out rows whose time does not go forward
    clock: Clock = "file"  # "file", or "regular" for stamps of a host: a rate and an offset are fitted to them
    # Stretches, s on the recording's clock: cut off at its ends, gaps between
    leave_out: tuple[tuple[Finite, Finite], ...] = ()
    frame: Literal["s", "b"] = "s"  # "s" or "b"
    device: str = ""  # Serial number or name
    temp_file: TempFileEntry | None = None  # A thermometer in a file of its own
    sensor: str | None = None  # Which sensor, in a file of several (APDM)

    def thermometer(self, folder: Path) -> TempFile | None:
        """Return the thermometer of its own file."""
        entry = self.temp_file
        if entry is None:
            return None
        layout = TextLayout(**entry.model_dump(include=_LAYOUT))
        return TempFile(path=folder / entry.file, layout=layout, **entry.model_dump(exclude={"file", *_LAYOUT}))

    def maps(self) -> tuple[ColumnMap, ...]:
        """Return one column map for each table of columns."""
        tables = self.columns if isinstance(self.columns, list) else [] if self.columns is None else [self.columns]
        shared: dict[str, Any] = {f"{channel}_unit": unit for channel, unit in self.units.items()}
        shared |= {f"{channel}_scale": scale for channel, scale in self.scale.items()}
        shared |= {
            key: getattr(self, key) for key in ("sample_rate_hz", "gaps", "repair_time", "clock", "frame", "device")
        }
        shared["layout"] = TextLayout(**self.model_dump(include={*_LAYOUT, "drop_bad_rows"}))
        return tuple(ColumnMap(**{key: _columns(key, value) for key, value in table}, **shared) for table in tables)


def entry_of_tree(tree: Mapping[str, Any]) -> MapEntry:
    """Return the keys of a map, checked as JSON: strict, and lists are tuples there."""
    return MapEntry.model_validate_json(json.dumps(tree, default=str))


def _read_map(path: str | Path) -> MapEntry:
    """Read a map."""
    tree, text = codec.toml_of(path)
    try:
        return entry_of_tree(tree)
    except ValidationError as error:
        refused = codec.Refused(list(error.errors()), frozenset(MapEntry.model_fields))
        raise FileFormatError(f"{path}: {refused.explained(codec.Stored(), text)}") from error


def read_map(path: str | Path, **choices: Any) -> tuple[ColumnMap | None, ReadSettings]:
    """Return how a file is read with a TOML map, modified by the arguments of a call. undrift's own names need no
    columns.
    """
    entry = _read_map(path)
    keys = entry.model_fields_set
    if not entry.columns and (not keys or keys - NATIVE_KEYS):
        got = ", ".join(sorted(keys - NATIVE_KEYS)) or "no key"
        raise InputError(
            f"{path}: expected one table of columns, got 0 and {got}. Add columns = {{ ... }}. A file with "
            f"undrift's own "
            f"names needs only {', '.join(sorted(NATIVE_KEYS))}."
        )
    with naming(path):
        return _chosen(entry, choices, Path(path).parent)


def map_and_settings(file_map: FileMap | None, **choices: Any) -> tuple[ColumnMap | None, ReadSettings]:
    """Return how a file is read with a stored map, modified by the arguments of a call. The columns may be missing."""
    return _chosen(entry_of(file_map), choices, Path())


def _chosen(entry: MapEntry, choices: Mapping[str, Any], folder: Path) -> tuple[ColumnMap | None, ReadSettings]:
    entry = entry.model_copy(update={key: value for key, value in choices.items() if value is not None})
    maps = entry.maps()
    if len(maps) > 1:
        raise InputError(
            f"the map describes {len(maps)} files, but only one is named. Use a map of one file, or list the files in session.toml."
        )
    return maps[0] if maps else None, _settings(entry, folder)


def _settings(entry: MapEntry, folder: Path) -> ReadSettings:
    options: dict[str, Any] = {key: getattr(entry, key) for key in ("gaps", "clock") if key in entry.model_fields_set}
    table_options = {
        key: getattr(entry, key) for key in ("sample_rate_hz", "repair_time", "drop_bad_rows", "sensor", "leave_out")
    }
    return ReadSettings(temp_file=entry.thermometer(folder), **options, **table_options)


def _columns(channel: str, value: Any) -> Any:
    """Return the column of time or temperature, and the columns of a triad as a tuple."""
    if isinstance(value, list):
        return tuple(value)
    return value if channel in ("time", "temp", "counter") or value is None else (value,)


# ---- a map as a value: of a file of TOML with the choices of a call, as a session and a calibration keep it


def read_file_map(path: str | Path | None = None, **choices: Any) -> FileMap | None:
    """Return the map of a TOML file, modified by the arguments of a call, or None if there is neither."""
    keys = {} if path is None else _read_map(path).model_dump(exclude_unset=True)
    if path is not None and keys.get("temp_file"):  # next to the map, independent of the folder of the recordings
        keys["temp_file"]["file"] = str((Path(path).parent / keys["temp_file"]["file"]).resolve())
    keys |= {key: value for key, value in choices.items() if value is not None}
    return file_map_of(entry_of_tree(keys)) if keys else None


def file_map_of(entry: MapEntry, *, without: Sequence[str] = ()) -> FileMap:
    """Return the keys that a map sets, as a value."""
    keys = entry.model_dump(mode="json", exclude_unset=True, exclude=set(without))
    return FileMap(json.dumps(keys, ensure_ascii=False))


def entry_of(file_map: FileMap | None) -> MapEntry:
    """Return the keys of a map, checked."""
    return MapEntry() if file_map is None else MapEntry.model_validate_json(file_map.text)


def shared_map(entries: Sequence[MapEntry]) -> FileMap | None:
    """Return the map that all recordings share, or None if they differ or need none."""
    alone = ("file", "temp_file", "sha256", "leave_out")  # keys that no other recording shares
    maps = [file_map_of(entry, without=alone) for entry in entries]
    return maps[0] if maps[0].text != "{}" and maps.count(maps[0]) == len(maps) else None


# ---- session

NAME = "session.toml"
DEFAULT_TABLE, DEFAULT_SENSITIVITY = RateTable(), TemperatureSensitivity()
Times = tuple[FloatArray, float]  # times and their step, s
_SLACK = 1e-3  # of a sample: a time written with fewer digits still finds its sample


@codec.stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class HeadEntry:
    """[session]."""

    kind: Kind  # calibration, thermal or static
    serial: str  # Device serial number
    gravity_m_s2: float | None = None  # local gravity, m/s2, or the next two; default standard gravity
    latitude_deg: float | None = None  # latitude of the place of recording
    height_m: float | None = None
    mounting: Mounting | None = (
        None  # for a fit to references: "one" mounting for all recordings, or "each" recording its own
    )


class RecordingEntry(MapEntry):
    """A [[recording]]: these keys and the keys of a map."""

    file: str | list[str]  # next to session.toml; several files are joined to one recording
    sha256: str = ""  # hash of the file as it was written; a changed file is refused


@codec.stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class StillEntry:
    """[[still]]."""

    recording: int = 0  # Which [[recording]], from 0
    start_s: float  # On the recording's own clock
    stop_s: float  # end, not included
    temp_c: Annotated[float, Ge(-273.15)] | None = None  # Chamber set-point, degC
    # sensor axis that points up, "+x" ... "-z", or None for a free pose
    face: Face | None = None


@codec.stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class TurnEntry:
    """[[turn]]."""

    recording: int = 0  # Which [[recording]], from 0
    start_s: float  # On the recording's own clock
    stop_s: float  # end, not included
    temp_c: Annotated[float, Ge(-273.15)] | None = None  # Chamber set-point, degC
    axis: Axis | None = None  # "x", "y" or "z" of the case, or None for a free rotation
    # Achieved steady rate about +axis
    turn_rate: Annotated[float | None, codec.Key("turn_rate_dps", unit=RADIAN_PER_DEGREE)] = None
    angle: Annotated[float | None, codec.Key("angle_deg", unit=RADIAN_PER_DEGREE)] = None  # Turned about +axis


@codec.stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class SessionFile:
    """The whole file."""

    session: HeadEntry  # device and place
    rate_table: Annotated[RateTable, codec.Key(later=True)] = DEFAULT_TABLE  # May be left out
    sensitivity: Annotated[TemperatureSensitivity, codec.Key("temperature", later=True)] = DEFAULT_SENSITIVITY
    recording: Annotated[tuple[RecordingEntry, ...], MinLen(1)]  # One or more
    still: tuple[StillEntry, ...] = ()  # May be left out
    turn: tuple[TurnEntry, ...] = ()
    run: dict[str, Any] = field(default_factory=dict)  # Journal of a rig run (rig/folder.py)


def read_session(folder: str | Path, *, clock: Clock | None = None) -> Session:
    """Read a session from a folder with session.toml.

    Parameters
    ----------
    folder : str or Path
        The folder, or the session.toml in it.
    clock : str or None
        "file" or "regular": how the time of every recording is read, overruling session.toml.

    Returns
    -------
    Session
        Records, stills and turns in samples, and the sha256 of every file read.

    Raises
    ------
    InputError
        If a folder or recording does not exist, gravity is given twice or incompletely, a time is outside its
        recording, or data are bad.
    FileFormatError
        If session.toml is not TOML or has an unknown, missing or wrong entry. The message names line and entry.

    Examples
    --------
    >>> import numpy as np, tempfile, undrift
    >>> rng = np.random.default_rng(7)
    >>> folder = tempfile.mkdtemp() + "/session"
    >>> undrift.write_session(undrift.simulate_session("six_face", undrift.random_device(rng), rng=rng), folder)
    >>> [still.face for still in undrift.read_session(folder).stills]
    ['+x', '-x', '+y', '-y', '+z', '-z']
    """
    path = Path(folder)
    path = path / NAME if path.is_dir() else path
    if not path.exists():
        raise InputError(f"{folder}: expected a folder with {NAME}, got none. Create {NAME} or check the path.")
    tree, text = codec.toml_of(path)
    content = codec.value_of(SessionFile, tree, str(path), text)
    _check_seal(path, text)
    inputs = [(path.name, sha256_of(path))]
    records, stills, turns, files = list[Record](), list[Still](), list[Turn](), list[list[str]]()
    for number, entry in enumerate(content.recording):
        names = [entry.file] if isinstance(entry.file, str) else entry.file
        files.append(names)
        with _at(path, text, "recording", number):
            records.append(_read_recording(path.parent, names, entry, clock))
            digests = [(name, sha256_of(path.parent / name)) for name in names if (path.parent / name).is_file()]
            if entry.sha256 and entry.sha256 not in (digest for _, digest in digests):
                raise FileFormatError(
                    f"{names[0]}: the readings were changed after they were written (sha256). Restore the file, or record again."
                )
        inputs += digests
    clocks = [(record.time, float(np.median(np.diff(record.time)))) for record in records]
    for number, still in enumerate(content.still):
        with _at(path, text, "still", number):
            stills.append(Still(face=still.face, **_samples(still, clocks)))
    for number, turn in enumerate(content.turn):
        with _at(path, text, "turn", number):
            turns.append(_turn(turn, clocks))
    with _at(path, text, "session"):
        head = content.session
        gravity_m_s2, source = gravity_of(head.gravity_m_s2, head.latitude_deg, head.height_m)
        return Session(
            kind=head.kind,
            serial=head.serial,
            gravity_m_s2=gravity_m_s2,
            records=tuple(records),
            stills=tuple(stills),
            turns=tuple(turns),
            inputs=tuple(inputs),
            file_map=shared_map(content.recording),
            gravity_source=source,
            rate_table=content.rate_table,
            sensitivity=content.sensitivity,
            mounting=head.mounting,
        )


def session_from_files(
    files: Sequence[str | Path],
    file_map: FileMap | None = None,
    *,
    kind: Kind = "calibration",
    serial: str = "",
    gravity_m_s2: float | None = None,
    latitude_deg: float | None = None,
    height_m: float | None = None,
) -> Session:
    """Return a session of recordings without a session.toml. It has no phases, and standard gravity is the default.

    If the map has several tables of columns, that many files form one recording. Gyroscope and accelerometer files of a
    phone need no map.
    """
    entry = entry_of(file_map)
    width = max(1, len(entry.columns)) if isinstance(entry.columns, list) else 1
    width = 2 if phone_pair(list(map(Path, files))) and not entry.columns else width
    if not files or len(files) % width:
        wanted = "one recording or more" if width == 1 else f"{width} files for each recording, as the map has tables"
        raise InputError(f"session: expected {wanted}, got {len(files)}. Name them.")
    records, inputs, groups = [], [], list[list[str]]()
    for start in range(0, len(files), width):
        names = [str(file) for file in files[start : start + width]]
        groups.append(names)
        map_keys = {key: getattr(entry, key) for key in entry.model_fields_set}
        records.append(_read_recording(Path(), names, RecordingEntry(file=names, **map_keys), None))
        inputs += [(Path(name).name, sha256_of(name)) for name in names if Path(name).is_file()]
    gravity_m_s2, source = gravity_of(gravity_m_s2, latitude_deg, height_m)
    return Session(
        kind=kind,
        serial=serial or records[0].device,
        gravity_m_s2=gravity_m_s2,
        records=tuple(records),
        inputs=tuple(inputs),
        file_map=shared_map([entry]),
        gravity_source=source,
    )


@contextmanager
def _at(path: Path, text: str, *place: str | int) -> Iterator[None]:
    """Name the line and the entry in errors."""
    try:
        yield
    except InputError as error:
        where = f"line {codec.line_of(text, place)}: {codec.entry_name(place) or place[0]}"
        raise type(error)(f"{checked_file(path)}: {where}: {error}") from error


def write_session(session: Session, folder: str | Path) -> None:
    """Write a session: session.toml and one Parquet file for each record. It reads back as it was.

    Parameters
    ----------
    session : Session
        Records with their phases.
    folder : str or Path
        Made where it is missing.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    if session.means:
        raise InputError("session: expected recordings, got means of set-points. Write them as a data frame.")
    folder = Path(folder)
    head = HeadEntry(
        kind=session.kind,
        serial=session.serial,
        gravity_m_s2=None if session.gravity_source == "standard" else session.gravity_m_s2,  # nobody stated it
        mounting=session.mounting,
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritten(folder, error) from error
    files = [f"recording_{number}.parquet" for number in range(len(session.records))]
    pieces: tuple[Still | Turn, ...] = (*session.stills, *session.turns)
    phases = [stated_piece(piece, session.records[piece.recording].time) for piece in pieces]
    text = session_toml(head, [{"file": file} for file in files], phases, session.rate_table, session.sensitivity)
    written = (partial(write_parquet, record) for record in session.records)
    write_together({**{folder / file: write for file, write in zip(files, written, strict=True)}, folder / NAME: text})


def _read_recording(folder: Path, names: list[str], entry: RecordingEntry, clock: Clock | None) -> Record:
    maps: tuple[ColumnMap | None, ...] = entry.maps()
    if maps and len(maps) != len(names):
        raise InputError(
            f"expected one table of columns for each file, got {len(maps)} for {len(names)} files. "
            "Set columns = [{ ... }, { ... }] in the order of the files."
        )
    unused = entry.model_fields_set - {"file", "columns", "sensor", "sha256"} - NATIVE_KEYS
    if not maps and unused:
        raise InputError(
            f"{', '.join(sorted(unused))} cannot be used without columns. Add columns, or omit these keys."
        )
    settings = _settings(entry, folder)
    settings = settings if clock is None else replace(settings, clock=clock)
    if not maps and (pair := phone_pair([folder / name for name in names])):
        return settled(read_phone_pair(*pair, settings), settings).record
    records = tuple(
        read_record(folder / name, columns, settings=settings if k == 0 else replace(settings, temp_file=None))
        for k, (name, columns) in enumerate(zip(names, maps or (None,) * len(names), strict=True))
    )
    if not records:
        raise InputError("file: expected one file or more, got an empty list")
    first = joined = records[0]
    for record, name in zip(records[1:], names[1:], strict=True):
        if len(record) != len(first) or np.abs(record.time - first.time).max() > 0.1 / first.sample_rate_hz:
            raise InputError(
                f"{name}: expected the {len(first)} samples and times of {names[0]}, got {len(record)} samples or other times. "
                "Files that form one recording need one time base."
            )
        added: dict[str, Any] = {}
        for channel in ("gyro", "accel", "temp_c", "mag_ut"):
            if getattr(record, channel) is not None:
                if getattr(joined, channel) is not None:
                    raise InputError(
                        f"{name}: expected channels that {names[0]} lacks, got {channel} again. Map {channel} once."
                    )
                keys = (channel, f"{channel}_unit") if channel in ("gyro", "accel") else (channel,)
                added |= {key: getattr(record, key) for key in keys}
        joined = replace(joined, **added)
    return joined


def gravity_of(
    gravity_m_s2: float | None = None, latitude_deg: float | None = None, height_m: float | None = None
) -> tuple[float, GravitySource]:
    """Return local gravity, m/s2, and its source. The default is standard gravity."""
    place = (latitude_deg, height_m)
    if gravity_m_s2 is None and latitude_deg is not None and height_m is not None:
        return gravity_at(latitude_deg, height_m), "latitude and height"
    if place == (None, None):
        return (STANDARD_GRAVITY, "standard") if gravity_m_s2 is None else (gravity_m_s2, "stated")
    got = "only one of the last two" if gravity_m_s2 is None else "both"
    raise InputError(f"expected gravity_m_s2, or latitude_deg and height_m, got {got}. Enter local gravity once.")


def _turn(entry: TurnEntry, clocks: list[Times]) -> Turn:
    if entry.turn_rate is not None and entry.angle is not None:
        raise FileFormatError("expected turn_rate_dps or angle_deg, got both. Keep the quantity that was measured.")
    if entry.angle == 0.0:
        raise FileFormatError(
            "expected angle_deg other than 0, got 0. Enter the angle turned, for example 360 for a full turn."
        )
    return Turn(axis=entry.axis, turn_rate=entry.turn_rate, angle=entry.angle, **_samples(entry, clocks))


def _samples(entry: StillEntry | TurnEntry, clocks: list[Times]) -> dict[str, Any]:
    """Return the samples [start, stop) of a span of time, and the other values that both kinds of phase share."""
    if not 0 <= entry.recording < len(clocks):
        raise FileFormatError(f"expected recording 0 to {len(clocks) - 1}, got {entry.recording}")
    time, step = clocks[entry.recording]
    first, last = float(time[0]), float(time[-1]) + step
    if not first - step <= entry.start_s < entry.stop_s <= last + step:
        raise FileFormatError(
            f"expected {first:g} <= start_s < stop_s <= {last:g} s as in its recording, got {entry.start_s:g} to {entry.stop_s:g} s"
        )
    start, stop = np.searchsorted(time, (entry.start_s - _SLACK * step, entry.stop_s - _SLACK * step))
    if stop <= start:
        raise FileFormatError(f"expected a sample or more between {entry.start_s:g} and {entry.stop_s:g} s, got none")
    return {"start": int(start), "stop": int(stop), "recording": entry.recording, "temp_c": entry.temp_c}


def stated_piece(piece: Still | Turn, time: FloatArray) -> StillEntry | TurnEntry:
    """Return a piece as [[still]] or [[turn]] state it: in seconds."""
    stop = time[piece.stop] if piece.stop < len(time) else time[-1] + np.median(np.diff(time))
    shared: dict[str, Any] = {"recording": piece.recording, "start_s": float(time[piece.start]), "stop_s": float(stop)}
    shared["temp_c"] = None if piece.temp_c is None else float(piece.temp_c)
    if isinstance(piece, Turn):
        return TurnEntry(axis=piece.axis, turn_rate=piece.turn_rate, angle=piece.angle, **shared)
    return StillEntry(face=piece.face, **shared)


def piece_toml(piece: StillEntry | TurnEntry) -> str:
    """Return the text of a [[still]] or [[turn]]."""
    return codec.toml_block("turn" if isinstance(piece, TurnEntry) else "still", codec.tree_of(piece))


def sealed(text: str) -> str:
    """Return the text of a file with its checksum in the first line, so that a cut file is noticed too."""
    return f"{_SEAL}{hashlib.sha256(text.encode()).hexdigest()}\n{text}"


def _check_seal(path: Path, text: str) -> None:
    """Refuse a session that a run wrote and that was changed since."""
    if text.startswith(_SEAL) and sealed(text.partition("\n")[2]) != text:
        raise FileFormatError(
            f"{path}: the session was changed after the run wrote it (sha256 in its first line). Restore it. "
            "If "
            "the change is intended, delete that line."
        )


def session_toml(
    head: HeadEntry,
    recordings: Iterable[Mapping[str, Any]],
    pieces: Iterable[StillEntry | TurnEntry],
    rate_table: RateTable = DEFAULT_TABLE,
    sensitivity: TemperatureSensitivity = DEFAULT_SENSITIVITY,
) -> str:
    """Return the text of session.toml. The recordings are given by their keys."""
    optional_tables = {"rate_table": rate_table, "temperature": sensitivity}
    tables = {"session": head} | {name: table for name, table in optional_tables.items() if table != type(table)()}
    blocks = [codec.toml_block("recording", dict(recording)) for recording in recordings]
    return "\n".join([codec.toml_text(codec.tree_of(tables)), *blocks, *map(piece_toml, pieces)])
