"""session.toml: the recordings of one calibration, with their rests and turns. Each class is a table of the file, in its units.

[session]
kind = "calibration"                # calibration | thermal | static
serial = "MTi-1"
gravity_m_s2 = 9.81                 # or latitude_deg and height_m
mounting = "one"                    # for a fit to references: one mounting for all recordings; default: each its own
[rate_table]                        # standard uncertainties (record.RateTable); optional, and so is each key
[temperature]                       # sensitivity of the device to temperature (record.TemperatureSensitivity); likewise
[[recording]]
file = "session.csv"                # and the keys of a map (io/column_map.py); none for undrift's own names and known formats
[[recording]]                       # files side by side with one time base: one table of columns per file
file = ["acc.txt", "gyro.txt"]
columns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]
units = { time = "s", accel = "count", gyro = "count" }
[[still]]                           # start_s, stop_s on the recording's own clock; optional face, temp_c
[[turn]]                            # as for [[still]]; optional axis, turn_rate_dps or angle_deg, temp_c
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

from undrift.base.codec import FileTable, entry_name, line_of, read_toml, toml_block, toml_text, tree_of
from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, sha256_of, unwritten, write_together
from undrift.io.column_map import NATIVE_KEYS, Clock, ColumnMap, check_parts, file_map_of, map_of
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
_SLACK = 1e-3  # share of a sample: a time written with fewer digits still matches its sample


class HeadEntry(FileTable):
    """[session]."""

    kind: Kind  # calibration, thermal or static
    serial: str  # serial number of the device
    gravity_m_s2: float | None = None  # local gravity, m/s2, or the next two keys (default: standard gravity)
    latitude_deg: float | None = None  # latitude and altitude of the recording
    height_m: float | None = None
    mounting: Mounting | None = None  # mounting in a fit to references: "one" for all recordings, or "each"


class RecordingEntry(ColumnMap):
    """A [[recording]]: these keys and the keys of a map."""

    file: str | Sequence[str]  # file next to session.toml, or several files that are joined side by side
    sha256: str = ""  # hash of the file: changed content is refused

    @property
    def files(self) -> list[str]:
        """Return the names of the files."""
        return [self.file] if isinstance(self.file, str) else list(self.file)


class PieceEntry(FileTable):
    """Common keys of [[still]] and [[turn]]."""

    recording: int = 0  # number of the [[recording]], from 0
    start_s: float  # start on the recording's clock, s
    stop_s: float  # end on the same clock, s; the sample at this time is not included
    temp_c: Annotated[float, Ge(-273.15)] | None = None  # set-point of the chamber, degC


class StillEntry(PieceEntry):
    """[[still]]."""

    face: Face | None = None  # sensor axis that points up, "+x" ... "-z"; none for a free pose


class TurnEntry(PieceEntry):
    """[[turn]]."""

    axis: Axis | None = None  # "x", "y" or "z" of the case; none for a free rotation
    turn_rate_dps: float | None = None  # achieved steady rate about +axis
    angle_deg: float | None = None  # angle turned about +axis


class SessionFile(FileTable):
    """The whole file."""

    session: HeadEntry  # device and place
    rate_table: RateTable = RateTable()  # optional
    temperature: TemperatureSensitivity = TemperatureSensitivity()  # optional
    recording: Annotated[tuple[RecordingEntry, ...], MinLen(1)]  # one or more recordings
    still: tuple[StillEntry, ...] = ()  # optional
    turn: tuple[TurnEntry, ...] = ()
    run: dict[str, Any] = Field(default_factory=dict)  # journal of a rig run (rig/folder.py)


def read_session(folder: str | Path, *, clock: Clock | None = None) -> Session:
    """Read a session from a folder with session.toml.

    Parameters
    ----------
    folder : str or Path
        The folder, or the session.toml in it.
    clock : str or None
        "file" or "regular": clock of every recording, which overrides session.toml.

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
        If session.toml is not TOML or has an unknown, missing or wrong entry. The message contains line and entry.

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
    table, text = read_toml(SessionFile, path)
    _check_seal(path, text)
    inputs, results, records = [(path.name, sha256_of(path))], list[ReadResult](), list[Record]()
    pieces = list[Still | Turn]()
    for number, entry in enumerate(table.recording):
        with _at(path, text, "recording", number):
            how = entry.beside(path.parent)
            results.append(_read_recording(path.parent, entry.files, how if clock is None else how.but(clock=clock)))
            records.append(results[-1].record)
            inputs += _digests(path.parent, entry)
    entries: tuple[tuple[str, Sequence[StillEntry | TurnEntry]], ...] = (("still", table.still), ("turn", table.turn))
    for name, number, piece in ((name, k, piece) for name, group in entries for k, piece in enumerate(group)):
        with _at(path, text, name, number):
            pieces.append(_piece(piece, records))
    head = table.session
    with _at(path, text, "session"):
        gravity_m_s2, source = gravity_of(head.gravity_m_s2, head.latitude_deg, head.height_m)
        return Session(
            kind=head.kind,
            serial=head.serial,
            gravity_m_s2=gravity_m_s2,
            records=tuple(records),
            stills=tuple(piece for piece in pieces if isinstance(piece, Still)),
            turns=tuple(piece for piece in pieces if isinstance(piece, Turn)),
            inputs=tuple(inputs),
            file_map=_shared_map(table.recording),
            gravity_source=source,
            rate_table=table.rate_table,
            sensitivity=table.temperature,
            mounting=head.mounting,
            notes=tuple(item.text for result in results for item in result.remarks),
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
    """Return a session of recordings without a session.toml. The session has no stills or turns, and standard gravity is the
    default.

    If the map has several tables of columns, the same number of files form one recording. Gyroscope and accelerometer files of a
    phone need no map.
    """
    how = map_of(file_map)
    width = 2 if phone_pair(list(map(Path, files))) and not how.columns else max(1, len(how.parts()))
    if not files or len(files) % width:
        wanted = "one recording or more" if width == 1 else f"{width} files per recording, one per table"
        raise InputError(f"session: expected {wanted}, got {len(files)}. Name them.")
    names = [str(file) for file in files]
    results = [_read_recording(Path(), names[at : at + width], how) for at in range(0, len(files), width)]
    gravity_m_s2, source = gravity_of(gravity_m_s2, latitude_deg, height_m)
    return Session(
        kind=kind,
        serial=serial or results[0].record.device,
        gravity_m_s2=gravity_m_s2,
        records=tuple(result.record for result in results),
        inputs=tuple((Path(name).name, sha256_of(name)) for name in names if Path(name).is_file()),
        file_map=_shared_map([how]),
        gravity_source=source,
        notes=tuple(item.text for result in results for item in result.remarks),
    )


@contextmanager
def _at(path: Path, text: str, *place: str | int) -> Iterator[None]:
    """Add line and entry to errors."""
    try:
        yield
    except InputError as error:
        where = f"line {line_of(text, place)}: {entry_name(place)}"
        raise type(error)(f"{checked_file(path)}: {where}: {error}") from error


def _digests(folder: Path, entry: RecordingEntry) -> list[tuple[str, str]]:
    """Return the files of a recording with their sha256. A changed file is refused."""
    digests = [(name, sha256_of(folder / name)) for name in entry.files if (folder / name).is_file()]
    if entry.sha256 and entry.sha256 not in (digest for _, digest in digests):
        raise FileFormatError(
            f"{entry.files[0]}: the readings were changed after they were written (sha256). Restore the file, or record again."
        )
    return digests


def _shared_map(maps: Sequence[ColumnMap]) -> FileMap | None:
    """Return the common map of all recordings, or None if they differ or need no map."""
    texts = [file_map_of(how, without=("file", "temp_file", "sha256", "leave_out")) for how in maps]
    return texts[0] if texts[0].text != "{}" and texts.count(texts[0]) == len(texts) else None


def _read_recording(folder: Path, names: list[str], how: ColumnMap) -> ReadResult:
    """Read the file of a recording, or the files side by side that form it."""
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
        result = read_counted(folder / name, part if joined is None else part.but(temp_file=None))
        joined = result.record if joined is None else _joined(joined, result.record, names[0], name)
    return replace(result, record=joined or result.record)


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
            values = np.where(np.isnan(before), values, before)  # these are other axes of the same sensor
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


def _piece(entry: StillEntry | TurnEntry, records: Sequence[Record]) -> Still | Turn:
    """Return start and stop of an entry, in samples of its recording."""
    if not 0 <= entry.recording < len(records):
        raise FileFormatError(f"expected recording 0 to {len(records) - 1}, got {entry.recording}")
    time = records[entry.recording].time
    step = float(np.median(np.diff(time)))
    first, last = float(time[0]), float(time[-1]) + step
    if not first - step <= entry.start_s < entry.stop_s <= last + step:
        raise FileFormatError(
            f"expected {first:g} <= start_s < stop_s <= {last:g} s as in its recording, got {entry.start_s:g} to {entry.stop_s:g} s"
        )
    start, stop = map(int, np.searchsorted(time, (entry.start_s - _SLACK * step, entry.stop_s - _SLACK * step)))
    if stop <= start:
        raise FileFormatError(f"expected a sample between {entry.start_s:g} and {entry.stop_s:g} s, got none")
    shared: dict[str, Any] = {"start": start, "stop": stop, "recording": entry.recording, "temp_c": entry.temp_c}
    if isinstance(entry, StillEntry):
        return Still(face=entry.face, **shared)
    if entry.turn_rate_dps is not None and entry.angle_deg is not None:
        raise FileFormatError("expected turn_rate_dps or angle_deg, got both. Keep the quantity that was measured.")
    if entry.angle_deg == 0.0:
        raise FileFormatError(
            "expected angle_deg other than 0, got 0. Enter the angle turned, for example 360 for a full turn."
        )
    rate, angle = (x if x is None else x * RADIAN_PER_DEGREE for x in (entry.turn_rate_dps, entry.angle_deg))
    return Turn(axis=entry.axis, turn_rate=rate, angle=angle, **shared)


def _entries(session: Session) -> list[StillEntry | TurnEntry]:
    pieces: tuple[Still | Turn, ...] = (*session.stills, *session.turns)
    return [_entry_of(piece, session.records) for piece in pieces]


def _entry_of(piece: Still | Turn, records: Sequence[Record]) -> StillEntry | TurnEntry:
    time = records[piece.recording].time
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
    """Write a session: session.toml and one Parquet file per record. It is read back without loss.

    Parameters
    ----------
    session : Session
        Records with their phases.
    folder : str or Path
        Folder, created if it does not exist.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritten(folder, error) from error
    files = [f"recording_{number}.parquet" for number in range(len(session.records))]
    recordings = [{"file": file} for file in files]
    text = session_toml(_head_of(session), recordings, _entries(session), session.rate_table, session.sensitivity)
    written = (partial(write_parquet, record) for record in session.records)
    write_together({**{folder / file: write for file, write in zip(files, written, strict=True)}, folder / NAME: text})


def _head_of(session: Session) -> HeadEntry:
    gravity_m_s2 = None if session.gravity_source == "standard" else session.gravity_m_s2  # it was not given
    return HeadEntry(kind=session.kind, serial=session.serial, gravity_m_s2=gravity_m_s2, mounting=session.mounting)


def session_toml(
    head: HeadEntry,
    recordings: Iterable[Mapping[str, Any]],
    pieces: Iterable[PieceEntry],
    rate_table: RateTable = RateTable(),
    sensitivity: TemperatureSensitivity = TemperatureSensitivity(),
) -> str:
    """Return the text of session.toml. The recordings are given as their keys."""
    tables: dict[str, Any] = {"session": tree_of(head)}
    for name, table in (("rate_table", rate_table), ("temperature", sensitivity)):
        tables |= {} if table == type(table)() else {name: tree_of(table)}
    blocks = [toml_block("recording", dict(recording)) for recording in recordings]
    return "\n".join([toml_text(tables), *blocks, *map(_piece_toml, pieces)])


def _piece_toml(piece: PieceEntry) -> str:
    return toml_block("turn" if isinstance(piece, TurnEntry) else "still", tree_of(piece))


def proposed_toml(
    session: Session, files: Sequence[Path], folder: Path, *, file_map: FileMap | None, steady: Sequence[Turn] = ()
) -> str:
    """Return the session.toml of recordings for a folder. Steady turns are written as comments, because their rate is unknown."""
    width = len(files) // len(session.records)
    map_keys = {} if file_map is None else json.loads(file_map.text)
    recordings = []
    for number in range(len(session.records)):
        names = [os.path.relpath(file, folder) for file in files[number * width : (number + 1) * width]]
        recordings.append({"file": names[0] if width == 1 else names, **map_keys})
    comments = "# Written by undrift info --write-session from the recordings. Correct anything that is wrong.\n"
    if session.gravity_source == "standard":
        comments += (
            "# gravity_m_s2 is missing: standard gravity is assumed. Enter yours, or latitude_deg and height_m.\n"
        )
    blocks = [comments + session_toml(_head_of(session), recordings, _entries(session))]
    for turn in steady:
        lines = _piece_toml(_entry_of(turn, session.records)).splitlines()
        marked = "".join(f"# {line}\n" for line in [*lines, "turn_rate_dps = ?"])
        blocks.append("# a steady turn: enter its achieved rate and remove the # at the start of each line\n" + marked)
    return "\n".join(blocks)


def sealed(text: str) -> str:
    """Return the text of a file with its checksum in the first line, so that truncation is detected too."""
    return f"{_SEAL}{hashlib.sha256(text.encode()).hexdigest()}\n{text}"


def _check_seal(path: Path, text: str) -> None:
    """Raise for a session that was changed after a run wrote it."""
    if text.startswith(_SEAL) and sealed(text.partition("\n")[2]) != text:
        raise FileFormatError(
            f"{path}: the session was changed after the run wrote it (sha256 in its first line). Restore it. If the "
            "change is intended, delete that line."
        )
