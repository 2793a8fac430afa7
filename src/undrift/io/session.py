"""session.toml: the recordings of one calibration and what was done in them.

[session]
kind = "calibration"                # calibration | thermal | static
serial = "MTi-1"
gravity_m_s2 = 9.81                 # or latitude_deg and height_m
[[recording]]
file = "session.csv"                # keys of a map as in undrift.io.mapping; none for undrift's own names and known formats
[[recording]]                       # files side by side, one time base: as many tables of columns as files
file = ["acc.txt", "gyro.txt"]
columns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]
units = { time = "s", accel = "count", gyro = "count" }
[[still]]                           # start_s, stop_s on the recording's own clock; optional face, temp_c
[[turn]]                            # likewise; optional axis, turn_rate_dps or angle_deg, temp_c
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from undrift.arrays import FloatArray
from undrift.earth import gravity_at
from undrift.errors import FileFormatError, InputError
from undrift.io.build import join_records
from undrift.io.columns import ColumnMap
from undrift.io.files import checked_file, sha256_of
from undrift.io.mapping import BESIDE_OWN_NAMES, MapEntry
from undrift.io.parquet import write_parquet
from undrift.io.recording import ReadSettings, read_record
from undrift.io.toml import Entry, entry_name, line_of, read_toml
from undrift.record import Record
from undrift.session import Axis, Face, Kind, Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE

NAME = "session.toml"
Finite = Annotated[float, Field(allow_inf_nan=False)]
Celsius = Annotated[float, Field(ge=-273.15, allow_inf_nan=False)]
Clock = tuple[FloatArray, float]  # times and their step, s
Place = tuple[str | int, ...]
_SLACK = 1e-3  # of a sample: a time written with fewer digits still finds its sample


class HeadEntry(Entry):
    """[session].

    Parameters
    ----------
    kind : str
        calibration, thermal or static.
    serial : str
        Device serial number.
    gravity_m_s2 : float or None
        Local gravity, m/s2; or the next two.
    latitude_deg, height_m : float or None
        Where it was recorded, deg and m.
    """

    kind: Kind
    serial: str
    gravity_m_s2: Finite | None = None
    latitude_deg: Finite | None = None
    height_m: Finite | None = None


class RecordingEntry(MapEntry):
    """[[recording]]: these keys and those of a map.

    Parameters
    ----------
    file : str or list of str
        Beside session.toml; several files are joined side by side.
    sensor : str or None
        Which sensor, in a file of several (APDM).
    """

    file: str | list[str]
    sensor: str | None = None


class PieceEntry(Entry):
    """What [[still]] and [[turn]] share.

    Parameters
    ----------
    start_s, stop_s : float
        s, on the recording's own clock; the stop is left out.
    recording : int
        Which [[recording]], from 0.
    temp_c : float or None
        Chamber set-point, degC.
    """

    start_s: Finite
    stop_s: Finite
    recording: int = 0
    temp_c: Celsius | None = None


class StillEntry(PieceEntry):
    """[[still]].

    Parameters
    ----------
    face : str or None
        Sensor axis that points up: "+x" ... "-z"; none for a free pose.
    """

    face: Face | None = None


class TurnEntry(PieceEntry):
    """[[turn]].

    Parameters
    ----------
    axis : str or None
        "x", "y" or "z"; none for a free rotation.
    turn_rate_dps : float or None
        Achieved steady rate about +axis, deg/s.
    angle_deg : float or None
        Angle turned about +axis, deg.
    """

    axis: Axis | None = None
    turn_rate_dps: Finite | None = None
    angle_deg: Finite | None = None


class SessionFile(Entry):
    """The whole file.

    Parameters
    ----------
    session : HeadEntry
        Of which device, and where.
    recording : list of RecordingEntry
        One or more.
    still : list of StillEntry
        May be left out.
    turn : list of TurnEntry
        May be left out.
    """

    session: HeadEntry
    recording: list[RecordingEntry] = Field(min_length=1)
    still: list[StillEntry] = Field(default_factory=list)
    turn: list[TurnEntry] = Field(default_factory=list)


def read_session(folder: str | Path) -> Session:
    """Read a session from a folder with session.toml.

    Parameters
    ----------
    folder : str or Path
        The folder, or the session.toml in it.

    Returns
    -------
    Session
        Records, stated stills and turns in samples, and the sha256 of every file read.

    Raises
    ------
    InputError
        No such folder or recording; gravity neither given nor computable; a time outside its recording; bad data.
    FileFormatError
        session.toml is not TOML or holds an unknown, missing or wrong entry; names line and entry.
    """
    path = Path(folder)
    path = path / NAME if path.is_dir() else path
    if not path.exists():
        raise InputError(f"{folder}: wanted a folder with {NAME}, got none; write one or check the path")
    held = read_toml(path, SessionFile)
    text = path.read_text(encoding="utf-8")
    inputs = [(path.name, sha256_of(path))]
    records: list[Record] = []
    for number, entry in enumerate(held.recording):
        names = [entry.file] if isinstance(entry.file, str) else entry.file
        try:
            records.append(_read_recording(path.parent, names, entry))
        except InputError as error:
            raise type(error)(f"{_where(path, text, ('recording', number))}: {error}") from error
        inputs += [(name, sha256_of(path.parent / name)) for name in names if (path.parent / name).is_file()]
    clocks = [(record.time, float(np.median(np.diff(record.time)))) for record in records]
    place: Place = ("session",)
    try:
        stills, turns = [], []
        for number, still in enumerate(held.still):
            place = ("still", number)
            stills.append(_still(still, clocks))
        for number, turn in enumerate(held.turn):
            place = ("turn", number)
            turns.append(_turn(turn, clocks))
        place = ("session",)
        return Session(
            kind=held.session.kind,
            serial=held.session.serial,
            gravity_m_s2=_gravity(held.session),
            records=tuple(records),
            stills=tuple(stills),
            turns=tuple(turns),
            inputs=tuple(inputs),
        )
    except InputError as error:
        raise type(error)(f"{_where(path, text, place)}: {error}") from error


def write_session(session: Session, folder: str | Path) -> None:
    """Write a session: session.toml and one Parquet file for each record. It reads back as it was.

    Parameters
    ----------
    session : Session
        Records with what was done in them.
    folder : str or Path
        Made where it is missing.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    folder = Path(folder)
    lines = ["[session]", f'kind = "{session.kind}"', f"serial = {_quoted(session.serial)}"]
    lines += [f"gravity_m_s2 = {_number(session.gravity_m_s2)}"]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number, record in enumerate(session.records):
            name = f"recording_{number}.parquet"
            write_parquet(record, folder / name)
            lines += ["", "[[recording]]", f'file = "{name}"']
        for still in session.stills:
            lines += ["", "[[still]]", *_span(still, session)]
            lines += [] if still.face is None else [f'face = "{still.face}"']
        for turn in session.turns:
            lines += ["", "[[turn]]", *_span(turn, session)]
            lines += [] if turn.axis is None else [f'axis = "{turn.axis}"']
            lines += (
                [] if turn.turn_rate is None else [f"turn_rate_dps = {_number(turn.turn_rate / RADIAN_PER_DEGREE)}"]
            )
            lines += [] if turn.angle is None else [f"angle_deg = {_number(turn.angle / RADIAN_PER_DEGREE)}"]
        (folder / NAME).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written: {error.strerror or error}; check the folder and its rights"
        ) from error


def _read_recording(folder: Path, names: list[str], entry: RecordingEntry) -> Record:
    maps: tuple[ColumnMap | None, ...] = entry.maps()
    if maps and len(maps) != len(names):
        raise InputError(
            f"wanted one table of columns for each file, got {len(maps)} for {len(names)} files; "
            "columns = [{ ... }, { ... }] in the order of the files"
        )
    unused = entry.model_fields_set - {"file", "columns", "sensor"} - BESIDE_OWN_NAMES
    if not maps and unused:
        raise InputError(
            f"wanted columns beside {', '.join(sorted(unused))}, got none; a file without a map needs only its name"
        )
    gaps = entry.gaps if "gaps" in entry.model_fields_set else None
    settings = ReadSettings(sample_rate_hz=entry.sample_rate_hz, sensor=entry.sensor, gaps=gaps)
    if not maps:
        settings = replace(settings, repair_time=entry.repair_time, drop_bad_rows=entry.drop_bad_rows)
    records = tuple(
        read_record(folder / name, columns, settings=settings)
        for name, columns in zip(names, maps or (None,) * len(names), strict=True)
    )
    if not records:
        raise InputError("file: wanted one file or more, got an empty list")
    return join_records(records, tuple(names))


def _gravity(head: HeadEntry) -> float:
    place = (head.latitude_deg, head.height_m)
    if head.gravity_m_s2 is not None and place == (None, None):
        return head.gravity_m_s2
    if head.gravity_m_s2 is None and head.latitude_deg is not None and head.height_m is not None:
        return gravity_at(head.latitude_deg, head.height_m)
    got = (
        "both" if head.gravity_m_s2 is not None else "neither" if place == (None, None) else "only one of the last two"
    )
    raise InputError(f"wanted gravity_m_s2, or latitude_deg and height_m, got {got}; state local gravity once")


def _still(entry: StillEntry, clocks: list[Clock]) -> Still:
    start, stop = _samples(entry, clocks)
    return Still(start=start, stop=stop, face=entry.face, recording=entry.recording, temp_c=entry.temp_c)


def _turn(entry: TurnEntry, clocks: list[Clock]) -> Turn:
    if entry.turn_rate_dps is not None and entry.angle_deg is not None:
        raise FileFormatError("wanted turn_rate_dps or angle_deg, got both; keep the one that was measured")
    if entry.angle_deg == 0.0:
        raise FileFormatError("wanted angle_deg other than 0, got 0; state the angle turned, 360 for a full turn")
    start, stop = _samples(entry, clocks)
    return Turn(
        start=start,
        stop=stop,
        axis=entry.axis,
        turn_rate=None if entry.turn_rate_dps is None else entry.turn_rate_dps * RADIAN_PER_DEGREE,
        angle=None if entry.angle_deg is None else entry.angle_deg * RADIAN_PER_DEGREE,
        recording=entry.recording,
        temp_c=entry.temp_c,
    )


def _samples(entry: PieceEntry, clocks: list[Clock]) -> tuple[int, int]:
    """Return the samples [start, stop) of a stated span of time."""
    if not 0 <= entry.recording < len(clocks):
        raise FileFormatError(f"wanted recording 0 to {len(clocks) - 1}, got {entry.recording}")
    time, step = clocks[entry.recording]
    first, last = float(time[0]), float(time[-1]) + step
    if not first - step <= entry.start_s < entry.stop_s <= last + step:
        raise FileFormatError(
            f"wanted {first:g} <= start_s < stop_s <= {last:g} s as in its recording, got {entry.start_s:g} to {entry.stop_s:g} s"
        )
    start, stop = np.searchsorted(time, (entry.start_s - _SLACK * step, entry.stop_s - _SLACK * step))
    if stop <= start:
        raise FileFormatError(f"wanted a sample or more between {entry.start_s:g} and {entry.stop_s:g} s, got none")
    return int(start), int(stop)


def _span(piece: Still | Turn, session: Session) -> list[str]:
    time = session.records[piece.recording].time
    stop = time[piece.stop] if piece.stop < len(time) else time[-1] + np.median(np.diff(time))
    lines = [f"recording = {piece.recording}", f"start_s = {_number(time[piece.start])}", f"stop_s = {_number(stop)}"]
    return lines if piece.temp_c is None else [*lines, f"temp_c = {_number(piece.temp_c)}"]


def _where(path: Path, text: str, place: Place) -> str:
    return f"{checked_file(path)}: line {line_of(text, place)}: {entry_name(place) or place[0]}"


def _number(value: float) -> str:
    return repr(float(value))


def _quoted(text: str) -> str:
    import json

    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
