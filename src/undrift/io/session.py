"""session.toml: the recordings of one calibration and what was done in them. Each class is a table of the file, in its units.

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
unrecorded_span_k = 1.0             # change of temperature where neither a column nor rests in deg/s show it
thermometer_lag_s = 0.0             # of the thermometer behind the sensors: 80 for an LM335 in still air
span_limit_k = 2.0                  # a larger change within the session is a finding
[[recording]]
file = "session.csv"                # and the keys of a map (io/column_map.py); none for undrift's own names and known formats
[[recording]]                       # files side by side, one time base: as many tables of columns as files
file = ["acc.txt", "gyro.txt"]
columns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]
units = { time = "s", accel = "count", gyro = "count" }
[[still]]                           # start_s, stop_s on the recording's own clock; optional face, temp_c
[[turn]]                            # likewise; optional axis, turn_rate_dps or angle_deg, temp_c
"""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, MinLen
from pydantic import Field

from undrift.arrays import FloatArray
from undrift.base import codec
from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, sha256_of, unwritten, write_together
from undrift.io.column_map import (
    NATIVE_KEYS,
    Clock,
    ColumnMap,
    check_parts,
    file_map_of,
    map_of,
)
from undrift.io.columns import ReadResult, build_record
from undrift.io.formats import read_counted, settled
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

NAME = "session.toml"
_SEAL = "# sha256 of all below: "
_SLACK = 1e-3  # of a sample: a time written with fewer digits still finds its sample


class HeadEntry(codec.FileTable):
    """[session]."""

    kind: Kind  # calibration, thermal or static
    serial: str  # Device serial number
    gravity_m_s2: float | None = None  # Local gravity, m/s2; or the next two; standard gravity is assumed without any
    latitude_deg: float | None = None  # latitude and altitude of the recording
    height_m: float | None = None
    mounting: Mounting | None = None  # mounting in a fit to references: "one" for all recordings, or "each"


class RecordingEntry(ColumnMap):
    """A [[recording]]: these keys and the keys of a map."""

    file: str | Sequence[str]  # file next to session.toml, or several files that are joined side by side
    sha256: str = ""  # hash of the file: another content is refused


class PieceEntry(codec.FileTable):
    """What [[still]] and [[turn]] share."""

    recording: int = 0  # number of the [[recording]], from 0
    start_s: float  # on the recording's own clock
    stop_s: float  # on the same clock; the sample at this time is not included
    temp_c: Annotated[float, Ge(-273.15)] | None = None  # Chamber set-point, degC


class StillEntry(PieceEntry):
    """[[still]]."""

    face: Face | None = None  # Sensor axis that points up: "+x" ... "-z"; none for a free pose


class TurnEntry(PieceEntry):
    """[[turn]]."""

    axis: Axis | None = None  # "x", "y" or "z" of the case; none for a free rotation
    turn_rate_dps: float | None = None  # Achieved steady rate about +axis
    angle_deg: float | None = None  # Turned about +axis


class SessionFile(codec.FileTable):
    """The whole file."""

    session: HeadEntry  # device and place
    rate_table: RateTable = RateTable()  # May be left out
    temperature: TemperatureSensitivity = TemperatureSensitivity()  # May be left out
    recording: Annotated[tuple[RecordingEntry, ...], MinLen(1)]  # One or more
    still: tuple[StillEntry, ...] = ()  # May be left out
    turn: tuple[TurnEntry, ...] = ()
    run: dict[str, Any] = Field(default_factory=dict)  # Journal of a rig run (rig/folder.py)


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
    stated, text = codec.read_toml(SessionFile, path)
    _check_seal(path, text)
    inputs = [(path.name, sha256_of(path))]
    read, records, stills, turns = list[ReadResult](), list[Record](), list[Still](), list[Turn]()
    for number, entry in enumerate(stated.recording):
        names = files_of(entry)
        with _at(path, text, "recording", number):
            how = entry.beside(path.parent)
            read.append(_read_recording(path.parent, names, how if clock is None else how.but(clock=clock)))
            records.append(read[-1].record)
            digests = [(name, sha256_of(path.parent / name)) for name in names if (path.parent / name).is_file()]
            if entry.sha256 and entry.sha256 not in (digest for _, digest in digests):
                raise FileFormatError(
                    f"{names[0]}: the readings were changed after they were written (sha256). Restore the file, or record again."
                )
        inputs += digests
    for number, still in enumerate(stated.still):
        with _at(path, text, "still", number):
            stills.append(Still(face=still.face, **_samples(still, records)))
    for number, turn in enumerate(stated.turn):
        with _at(path, text, "turn", number):
            turns.append(_turn(turn, records))
    with _at(path, text, "session"):
        head = stated.session
        gravity_m_s2, source = gravity_of(head.gravity_m_s2, head.latitude_deg, head.height_m)
        return Session(
            kind=head.kind,
            serial=head.serial,
            gravity_m_s2=gravity_m_s2,
            records=tuple(records),
            stills=tuple(stills),
            turns=tuple(turns),
            inputs=tuple(inputs),
            file_map=_shared_map(stated.recording),
            gravity_source=source,
            rate_table=stated.rate_table,
            sensitivity=stated.temperature,
            mounting=head.mounting,
            notes=tuple(note for result in read for note in result.notes),
        )


def files_of(entry: RecordingEntry) -> list[str]:
    """Return the names of the files of a [[recording]]."""
    return [entry.file] if isinstance(entry.file, str) else list(entry.file)


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
    how = map_of(file_map)
    width = 2 if phone_pair(list(map(Path, files))) and not how.columns else max(1, len(how.parts()))
    if not files or len(files) % width:
        wanted = "one recording or more" if width == 1 else f"{width} files for each recording, as the map has tables"
        raise InputError(f"session: expected {wanted}, got {len(files)}. Name them.")
    names = [str(file) for file in files]
    read = [_read_recording(Path(), names[at : at + width], how) for at in range(0, len(files), width)]
    records = [result.record for result in read]
    gravity_m_s2, source = gravity_of(gravity_m_s2, latitude_deg, height_m)
    return Session(
        kind=kind,
        serial=serial or records[0].device,
        gravity_m_s2=gravity_m_s2,
        records=tuple(records),
        inputs=tuple((Path(name).name, sha256_of(name)) for name in names if Path(name).is_file()),
        file_map=_shared_map([how]),
        gravity_source=source,
        notes=tuple(note for result in read for note in result.notes),
    )


@contextmanager
def _at(path: Path, text: str, *place: str | int) -> Iterator[None]:
    """Name the line and the entry in errors."""
    try:
        yield
    except InputError as error:
        where = f"line {codec.line_of(text, place)}: {codec.entry_name(place) or place[0]}"
        raise type(error)(f"{checked_file(path)}: {where}: {error}") from error


def _shared_map(maps: Sequence[ColumnMap]) -> FileMap | None:
    """Return the map that all recordings share, or None if they differ or need none."""
    texts = [file_map_of(how, without=("file", "temp_file", "sha256", "leave_out")) for how in maps]
    return texts[0] if texts[0].text != "{}" and texts.count(texts[0]) == len(texts) else None


def _read_recording(folder: Path, names: list[str], how: ColumnMap) -> ReadResult:
    """Read the file of a recording, or the files side by side that make it."""
    maps = how.parts()
    if maps and len(maps) != len(names):
        raise InputError(
            f"expected one table of columns for each file, got {len(maps)} for {len(names)} files. "
            "Set columns = [{ ... }, { ... }] in the order of the files."
        )
    unused = how.model_fields_set - {"file", "columns", "sha256"} - NATIVE_KEYS
    if not maps and unused:
        raise InputError(
            f"{', '.join(sorted(unused))} cannot be used without columns. Add columns, or omit these keys."
        )
    if not maps and (pair := phone_pair([folder / name for name in names])):
        return settled(build_record(read_phone_pair(*pair, how)), how)
    if not names:
        raise InputError("file: expected one file or more, got an empty list")
    check_parts(how)
    joined: Record | None = None
    for name, part in zip(names, maps or (how,) * len(names), strict=True):
        read = read_counted(folder / name, part if joined is None else part.but(temp_file=None))
        joined = read.record if joined is None else _joined(joined, read.record, names[0], name)
    return replace(read, record=joined or read.record)


def _joined(first: Record, record: Record, first_name: str, name: str) -> Record:
    """Return the first record with the channels of another one on the same time base."""
    if len(record) != len(first) or np.abs(record.time - first.time).max() > 0.1 / first.sample_rate_hz:
        raise InputError(
            f"{name}: expected the {len(first)} samples and times of {first_name}, got {len(record)} samples or other times. "
            "Files that form one recording need one time base."
        )
    added: dict[str, Any] = {}
    for channel in ("gyro", "accel", "temp_c", "mag_ut"):
        before, values = getattr(first, channel), getattr(record, channel)
        if values is None:
            continue
        if before is not None:
            shared = np.isfinite(before).any(axis=0) & np.isfinite(values).any(axis=0)
            if shared.any():
                raise InputError(
                    f"{name}: expected channels that {first_name} lacks, got {channel} again. Map {channel} once."
                )
            values = np.where(np.isnan(before), values, before)  # other axes of the same sensor
        added[channel] = values
        if channel in ("gyro", "accel"):
            added[f"{channel}_unit"] = getattr(record, f"{channel}_unit")
    return replace(first, **added)


def gravity_of(
    gravity_m_s2: float | None = None, latitude_deg: float | None = None, height_m: float | None = None
) -> tuple[float, GravitySource]:
    """Return local gravity, m/s2, and its source. The default is standard gravity."""
    place = (latitude_deg, height_m)
    if gravity_m_s2 is None and latitude_deg is not None and height_m is not None:
        return gravity_at(latitude_deg, height_m), "latitude and height"
    if place == (None, None):
        return (STANDARD_GRAVITY, "standard") if gravity_m_s2 is None else (gravity_m_s2, "stated")
    got = "both" if gravity_m_s2 is not None else "the latitude only" if height_m is None else "the height only"
    raise InputError(f"expected `gravity_m_s2`, or `latitude_deg` and `height_m`, got {got}. Enter local gravity once.")


# ---- stills and turns: seconds and degrees in the file, samples and rad/s in a session


def _turn(entry: TurnEntry, records: Sequence[Record]) -> Turn:
    if entry.turn_rate_dps is not None and entry.angle_deg is not None:
        raise FileFormatError("expected turn_rate_dps or angle_deg, got both. Keep the quantity that was measured.")
    if entry.angle_deg == 0.0:
        raise FileFormatError(
            "expected angle_deg other than 0, got 0. Enter the angle turned, for example 360 for a full turn."
        )
    rate, angle = (x if x is None else x * RADIAN_PER_DEGREE for x in (entry.turn_rate_dps, entry.angle_deg))
    return Turn(axis=entry.axis, turn_rate=rate, angle=angle, **_samples(entry, records))


def _samples(entry: PieceEntry, records: Sequence[Record]) -> dict[str, Any]:
    """Return the samples [start, stop) of a span of time, and the other values that both kinds of phase share."""
    if not 0 <= entry.recording < len(records):
        raise FileFormatError(f"expected recording 0 to {len(records) - 1}, got {entry.recording}")
    time = records[entry.recording].time
    step = float(np.median(np.diff(time)))
    first, last = float(time[0]), float(time[-1]) + step
    if not first - step <= entry.start_s < entry.stop_s <= last + step:
        raise FileFormatError(
            f"expected {first:g} <= start_s < stop_s <= {last:g} s as in its recording, got {entry.start_s:g} to {entry.stop_s:g} s"
        )
    start, stop = np.searchsorted(time, (entry.start_s - _SLACK * step, entry.stop_s - _SLACK * step))
    if stop <= start:
        raise FileFormatError(f"expected a sample or more between {entry.start_s:g} and {entry.stop_s:g} s, got none")
    return {"start": int(start), "stop": int(stop), "recording": entry.recording, "temp_c": entry.temp_c}


def piece_entry(piece: Still | Turn, time: FloatArray) -> PieceEntry:
    """Return a piece as [[still]] or [[turn]] state it: in seconds and degrees."""
    stop = time[piece.stop] if piece.stop < len(time) else time[-1] + np.median(np.diff(time))
    shared: dict[str, Any] = {"recording": piece.recording, "start_s": float(time[piece.start]), "stop_s": float(stop)}
    shared["temp_c"] = None if piece.temp_c is None else float(piece.temp_c)
    if isinstance(piece, Still):
        return StillEntry(face=piece.face, **shared)
    rate, angle = in_degrees(piece.turn_rate), in_degrees(piece.angle)
    return TurnEntry(axis=piece.axis, turn_rate_dps=rate, angle_deg=angle, **shared)


def in_degrees(radians: float | None) -> float | None:
    """Return the number of degrees with the fewest digits that converts back to the same radians."""
    if radians is None:
        return None
    degrees = float(radians) / RADIAN_PER_DEGREE
    short = (float(f"{degrees:.{digits}g}") for digits in range(12, 18))
    return next((number for number in short if number * RADIAN_PER_DEGREE == radians), degrees)


# ---- writing


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
    entries = [piece_entry(piece, session.records[piece.recording].time) for piece in pieces]
    text = session_toml(head, [{"file": file} for file in files], entries, session.rate_table, session.sensitivity)
    written = (partial(write_parquet, record) for record in session.records)
    write_together({**{folder / file: write for file, write in zip(files, written, strict=True)}, folder / NAME: text})


def session_toml(
    head: HeadEntry,
    recordings: Iterable[Mapping[str, Any]],
    pieces: Iterable[PieceEntry],
    rate_table: RateTable = RateTable(),
    sensitivity: TemperatureSensitivity = TemperatureSensitivity(),
) -> str:
    """Return the text of session.toml. The recordings are given by their keys."""
    tables: dict[str, Any] = {"session": head.model_dump()}
    for name, table in (("rate_table", rate_table), ("temperature", sensitivity)):
        tables |= {} if table == type(table)() else {name: codec.tree_of(table)}
    blocks = [codec.toml_block("recording", dict(recording)) for recording in recordings]
    return "\n".join([codec.toml_text(tables), *blocks, *map(piece_toml, pieces)])


def piece_toml(piece: PieceEntry) -> str:
    """Return the text of a [[still]] or [[turn]]."""
    return codec.toml_block("turn" if isinstance(piece, TurnEntry) else "still", piece.model_dump())


def session_text(
    session: Session,
    files: Sequence[Path],
    folder: Path,
    *,
    file_map: FileMap | None,
    steady: Sequence[Turn] = (),
) -> str:
    """Return the session.toml of recordings for a folder. Steady turns are written as comments, because their rate is
    unknown.
    """
    width = len(files) // len(session.records)
    standard = session.gravity_source == "standard"
    head = HeadEntry(kind=session.kind, serial=session.serial, gravity_m_s2=None if standard else session.gravity_m_s2)
    blocks = [
        "# Written by undrift info --write-session from the recordings. Correct anything that is wrong.\n"
        + codec.toml_text({"session": head.model_dump()})
    ]
    if standard:
        blocks[0] += (
            "# gravity_m_s2 = ?   # missing: standard gravity is assumed. Enter yours, or latitude_deg and height_m\n"
        )
    map_keys = {} if file_map is None else json.loads(file_map.text)
    for number in range(len(session.records)):
        names = [os.path.relpath(file, folder) for file in files[number * width : (number + 1) * width]]
        blocks.append(codec.toml_block("recording", {"file": names[0] if width == 1 else names, **map_keys}))
    times = [record.time for record in session.records]
    pieces: list[Still | Turn] = [*session.stills, *session.turns]
    blocks += [piece_toml(piece_entry(piece, times[piece.recording])) for piece in pieces]
    for turn in steady:
        lines = piece_toml(piece_entry(turn, times[turn.recording])).splitlines()
        marked = "".join(f"# {line}\n" for line in [*lines, "turn_rate_dps = ?"])
        blocks.append("# a steady turn: state its achieved rate and take the marks away\n" + marked)
    return "\n".join(blocks)


def sealed(text: str) -> str:
    """Return the text of a file with its checksum in the first line, so that a cut file is noticed too."""
    return f"{_SEAL}{hashlib.sha256(text.encode()).hexdigest()}\n{text}"


def _check_seal(path: Path, text: str) -> None:
    """Refuse a session that a run wrote and that was changed since."""
    if text.startswith(_SEAL) and sealed(text.partition("\n")[2]) != text:
        raise FileFormatError(
            f"{path}: the session was changed after the run wrote it (sha256 in its first line). Restore it. If the "
            "change is intended, delete that line."
        )
