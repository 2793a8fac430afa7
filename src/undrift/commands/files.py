"""Inputs of commands: recordings with their map and calibration, sessions and references.

Settings for reading are dataclasses marked ``@options``. Each field is an option of the command line. A ``Reader`` reads
the recordings of a command and collects the notes on them.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from undrift.base import codec
from undrift.base.options import Up, options
from undrift.base.spoken import option_of
from undrift.correction.correct import correct_checked
from undrift.errors import Implausible, InputError
from undrift.files import checked_file, sha256_of
from undrift.findings import Finding, Level, finding
from undrift.io.column_map import ColumnMap, file_map_of, map_of, native_map, one_map, read_map
from undrift.io.formats import (
    detect,
    format_of,
    holds_poses,
    is_streamed,
    iter_record,
    read_counted,
    read_reference,
)
from undrift.io.inspect import needs_map
from undrift.io.parquet import parquet_names
from undrift.io.reference import read_reference_map
from undrift.io.session import NAME, SessionFile, gravity_of, read_session, session_from_files
from undrift.io.store import KIND, read_calibration
from undrift.model import BodyMounting, Calibration
from undrift.record import FileMap, GravitySource, Kind, Record, Reference, Session, Still
from undrift.units import STANDARD_GRAVITY, is_physical

NO_DATE = datetime.min.replace(tzinfo=UTC)

# ---- options


@options
@dataclass(frozen=True, kw_only=True)
class Opening:
    """Settings for reading a foreign recording.

    Parameters
    ----------
    column_map : Path or None
        TOML file with columns, units and other properties of a foreign table, as written by undrift info FILE --write-map. For
        undrift's own column names, it contains only sample_rate_hz, gaps, clock, repair_time or drop_bad_rows. It overrides the map
        stored in a calibration.
    sample_rate_hz : float or None
        Samples per second, for a file without time. Overrides the map.
    sensor : str or None
        Sensor, stream or topic, for a file with several.
    """

    column_map: Annotated[Path | None, Parameter(name="--map")] = None
    sample_rate_hz: float | None = None
    sensor: str | None = None

    @property
    def keys(self) -> dict[str, Any]:
        """Return the keys of a map that were given as options."""
        keys = {"sample_rate_hz": self.sample_rate_hz, "sensor": self.sensor}
        return {key: value for key, value in keys.items() if value is not None}

    def file_map(self) -> FileMap | None:
        """Return the given map, overridden with the options, or None without map and options."""
        if self.column_map is not None:
            return file_map_of(read_map(self.column_map, **self.keys))
        return file_map_of(ColumnMap(**self.keys)) if self.keys else None

    def how(self, path: Path, stored: FileMap | None = None) -> ColumnMap:
        """Return the map for a file: the given map, or none if the file needs none, or the map that a calibration stores."""
        if self.column_map is not None:
            return one_map(read_map(self.column_map, **self.keys))
        stored_map = map_of(stored)
        if stored_map.columns is not None and not needs_map(path):
            stored_map = map_of(None)
        return one_map(stored_map.but(**self.keys))


@options
@dataclass(frozen=True, kw_only=True)
class NamedRest:
    """A stretch at rest that replaces the first still phase.

    Parameters
    ----------
    rest_s : str or None
        START:STOP of a rest, s on the recording's clock. By default the first rest is used.
    """

    rest_s: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None

    @property
    def ends_s(self) -> tuple[float, float] | None:
        """Return start and stop of the given stretch, s, or None if none was given."""
        if self.rest_s is None:
            return None
        start, _, stop = self.rest_s.partition(":")
        with suppress(ValueError):
            if float(start) < float(stop):
                return float(start), float(stop)
        raise InputError(f"`rest_s`: expected START:STOP in s, got '{self.rest_s}'. For example, write 15:35.")

    def still_in(self, record: Record) -> Still | None:
        """Return the given stretch of a recording, or None if none was given."""
        if self.ends_s is None:
            return None
        (start_s, stop_s), first, last = self.ends_s, float(record.time[0]), float(record.time[-1])
        if not first <= start_s < stop_s <= last:
            raise InputError(
                f"`rest_s`: expected START:STOP within the recording ({first:.6g} to {last:.6g} s), got {start_s:g} and "
                f"{stop_s:g}. Give the start and the end of a rest."
            )
        start, stop = record.time.searchsorted((start_s, stop_s))
        return Still(start=int(start), stop=max(int(stop), int(start) + 1))


@options
@dataclass(frozen=True, kw_only=True)
class Place:
    """Place and device of recordings without a session.toml.

    Parameters
    ----------
    gravity_m_s2 : float or None
        Local gravity, m/s2. Without it, standard gravity is assumed and reported.
    latitude_deg : float or None
        With --height-m, determines local gravity from WGS 84. For a session, it removes the Earth's rotation from a
        level rate table.
    height_m : float or None
        Height above the ellipsoid, m.
    serial : str
        Serial number of the device, for bare recordings.
    """

    gravity_m_s2: float | None = None
    latitude_deg: float | None = None
    height_m: float | None = None
    serial: str = ""

    @property
    def gravity(self) -> tuple[float, GravitySource]:
        """Return local gravity, m/s2, and its source."""
        return gravity_of(self.gravity_m_s2, self.latitude_deg, self.height_m)


# ---- readings and their calibration


class Reader:
    """Reader of a command's recordings, with its options and with map and constants of the calibration.

    The calibration is a file, or the newest one in a folder with the serial number of the recordings.
    """

    def __init__(self, opening: Opening, calibration: Path | None = None, recordings: Sequence[Path] = ()) -> None:
        self.opening, self.path, self.notes = opening, calibration, list[str]()
        if calibration is not None and calibration.is_dir():
            self.path, note = _newest(calibration, {_serial_of(path, opening) for path in recordings})
            self.notes.append(note)
        self.model = None if self.path is None else read_calibration(self.path)
        self.findings = calibration_findings(self.model)  # problems of the calibration and the readings

    def read(self, path: Path) -> Record:
        """Read a recording. For a session folder, read its only recording."""
        if detect(path) != "session":
            with self._naming_map(path):
                result = read_counted(path, self.how(path))
            self.notes += [item.text for item in result.remarks]
            return result.record
        session = read_session(path)
        if len(session.records) > 1:
            raise InputError(
                f"{path}: expected one recording, got a session of {len(session.records)}. Give one of its files."
            )
        self.notes += session.notes
        return session.records[0]

    def chunks(self, path: Path) -> Iterator[Record]:
        """Read a Parquet file in chunks, for constant memory. Read other recordings whole."""
        with self._naming_map(path):
            how = None if detect(path) == "session" else self.how(path)
        if how is None or not is_streamed(path, how):
            yield self.read(path)
            return
        with self._naming_map(path):
            if not how.columns:
                names = parquet_names(path)
                self.notes += native_map(names, how, source=str(path)).unread(names)
            yield from iter_record(path, how)

    def corrected(self, record: Record, path: Path) -> Record:
        """Return the readings corrected with the calibration. Without a calibration, raise for counts and volts."""
        if self.model is None:
            check_physical(record, path)
            return record
        with named_columns(path):
            corrected = correct_checked(self.calibrated_part(record), self.model)
        self.notes += corrected.notes
        self.findings += [item for item in corrected.findings if item.level == "warn"]
        return corrected.record

    def calibrated_part(self, record: Record) -> Record:
        """Omit, with a note, a triad that remains in counts or volts because the calibration has no model of it."""
        model = self.model
        if model is None or record.gyro is None or record.accel is None or (model.gyro is None and model.accel is None):
            return record
        for name, words, si in (("accel", "accelerometers", "m/s2"), ("gyro", "gyroscopes", "rad/s")):
            unit, removed = getattr(record, f"{name}_unit"), {name: None, f"{name}_unit": si}
            if getattr(model, name) is None and not is_physical(unit):
                self.notes.append(
                    f"The {words} are left out of the result: they are in {unit}, and the calibration has no model of them."
                )
                return replace(record, **removed)  # type: ignore[arg-type]
        return record

    @property
    def calibration(self) -> tuple[Calibration, Path]:
        """Return the calibration and its file, for a command that needs one."""
        if self.model is None or self.path is None:
            raise InputError("expected a calibration, got none. Give it with `calibration`.")
        return self.model, self.path

    def mounting(self, forward: str | None, up: str | None) -> BodyMounting | None:
        """Return the mounting in the calibration, or None if the sides of the device are given instead."""
        return None if self.model is None or forward or up else self.model.mounting

    def how(self, path: Path) -> ColumnMap:
        """Return the map for a file."""
        return self.opening.how(path, None if self.model is None else self.model.file_map)

    @contextmanager
    def _naming_map(self, path: Path) -> Iterator[None]:
        """Add file and calibration to the error about a file that does not match the map of the calibration."""
        try:
            yield
        except InputError as error:
            if self.model is None or self.model.file_map is None or self.opening.column_map is not None:
                raise
            text = str(error).removeprefix(f"{path}: ")
            raise InputError(
                f"{path}: the file does not match the map stored in {self.path} for its device: {text}. Give another map with "
                f"`column_map`.",
                **error.numbers,
            ) from error


def _newest(folder: Path, serials: set[str]) -> tuple[Path, str]:
    """Return the newest calibration of a device in a folder and its subfolders, and a note about the choice."""
    if len(serials) > 1:
        raise InputError(
            f"{folder}: the recordings are of several devices ({', '.join(sorted(serials))}), and one calibration is "
            "applied to all of them. Run the command once for each device."
        )
    (serial,) = serials
    models = {path: read_calibration(path) for path in sorted(folder.rglob("*.json")) if _is_calibration(path)}
    dates = {path: _created(model) for path, model in models.items() if model.device == serial}
    if not dates:
        others = ", ".join(sorted({model.device or "without serial number" for model in models.values()}))
        raise InputError(
            f"{folder}: no calibration of {serial} in this folder. It contains {others or 'no calibration'}. Give the file."
        )
    newest = [path for path, date in dates.items() if date == max(dates.values())]
    if len(newest) > 1:
        names = ", ".join(str(path.relative_to(folder)) for path in newest)
        raise InputError(
            f"{folder}: several newest calibrations of {serial} have the same date: {names}. Give one of these files."
        )
    date = dates[newest[0]]
    origin = "without a date" if date == NO_DATE else f"of {date:%Y-%m-%d}"
    return newest[0], f"The calibration is {newest[0]} {origin}, the newest of {len(dates)} of {serial}."


def _is_calibration(path: Path) -> bool:
    try:
        content = json.loads(path.read_bytes())
    except ValueError as error:
        raise InputError(
            f"{path}: this file is not JSON, so its age cannot be checked. Repair or remove it."
        ) from error
    return isinstance(content, dict) and content.get("kind") == KIND


def _created(model: Calibration) -> datetime:
    try:
        date = datetime.fromisoformat(model.provenance.created)
    except ValueError:
        return NO_DATE
    return date if date.tzinfo else date.replace(tzinfo=UTC)


def _serial_of(recording: Path, opening: Opening) -> str:
    """Return the serial number of a recording or session. Raise an error if it has none."""
    if not recording.is_dir():
        checked_file(recording)
    if detect(recording) == "session":
        serial = read_session(recording).serial
    elif opening.column_map is None and needs_map(recording):
        serial = ""  # a table with foreign columns, whose device only a map could contain
    else:
        serial = next(Reader(opening).chunks(recording)).device
    if not serial:
        raise InputError(
            f"{recording}: the recording does not contain the serial number of its device, so no calibration can be selected from "
            f"a folder. Give the file with `calibration`."
        )
    return serial


def calibration_findings(model: Calibration | None) -> list[Finding]:
    """Return a single finding for a calibration whose verdict is not good."""
    if model is None or model.verdict.status == "good":
        return []
    level: Level = "fail" if model.verdict.status == "bad" else "warn"
    sentence = f"The verdict of the calibration is {model.verdict.status}."
    return [finding("calibration.verdict", level, sentence, "To read its findings, use undrift info.")]


def check_physical(record: Record, path: Path) -> None:
    """Raise for counts and volts that no calibration converts to a physical unit."""
    for name, values, unit in (("gyro", record.gyro, record.gyro_unit), ("accel", record.accel, record.accel_unit)):
        if values is not None and not is_physical(unit):
            raise InputError(
                f"{path}: expected physical units or a calibration of the device, got {name} in {unit}. Add "
                "`calibration` calibration.json."
            )


@contextmanager
def named_columns(path: Path) -> Iterator[None]:
    """Add the file and the remedial option to errors about columns, units or sample rate."""
    try:
        yield
    except Implausible as error:
        rate, message = error.numbers.get("sample_rate_hz"), f"{path}: {str(error).removeprefix(f'{path}: ')}"
        raise Implausible(message + (f": `sample_rate_hz` {rate:.4g}" if rate else ""), **error.numbers) from error


# ---- sessions


def session_folder(path: Path) -> Path | None:
    """Return the folder of a session given as its folder or its session.toml, or None."""
    folder = path.parent if path.name == NAME else path
    return folder if path.name == NAME or (path / NAME).is_file() else None


def session_of(files: tuple[Path, ...], place: Place, opening: Opening, *, kind: Kind = "calibration") -> Session:
    """Read a session folder, or create a session from bare recordings."""
    named = [file for file in files if session_folder(file) is not None]
    if not named:
        for folder in (file for file in files if file.is_dir() and not is_recording(file)):
            read_session(folder)  # raises a message about the content of a session folder
        return session_from_files(files, opening.file_map(), kind=kind, **asdict(place))
    if len(files) > 1:
        raise InputError(
            f"{named[0]}: expected one session, or recordings, got a session and {len(files) - 1} more. Give only the session, or "
            f"list the recordings in its session.toml."
        )
    session = read_session(named[0])
    fixed = asdict(opening) | {"serial": place.serial or None}
    if session.gravity_source != "standard":
        fixed |= {"gravity_m_s2": place.gravity_m_s2, "height_m": place.height_m}
    used = [option_of(name) for name, value in fixed.items() if value is not None]
    if used:
        raise InputError(f"{named[0]}: {', '.join(used)} cannot be used with a session. Set them in its session.toml.")
    if session.gravity_source == "standard":
        # a latitude without a height applies to the rate table
        latitude_deg = None if place.height_m is None else place.latitude_deg
        gravity_m_s2, source = gravity_of(place.gravity_m_s2, latitude_deg, place.height_m)
        session = replace(session, gravity_m_s2=gravity_m_s2, gravity_source=source)
    return session


def states_gravity(path: Path) -> bool:
    """Return True if a session.toml contains local gravity."""
    return read_session(path).gravity_source != "standard"


def thermal_session(path: Path, reader: Reader) -> Session:
    """Read a session. A single recording becomes a session."""
    if detect(path) == "session":
        session = read_session(path)
        reader.notes += session.notes
        return session
    record, file_map = reader.read(path), reader.opening.file_map()
    return Session(
        kind="thermal",
        records=(record,),
        serial=record.device,
        gravity_m_s2=STANDARD_GRAVITY if reader.model is None else reader.model.gravity_m_s2,
        inputs=((path.name, sha256_of(path)),) if path.is_file() else (),
        file_map=file_map and file_map_of(map_of(file_map), without=("leave_out",)),  # stretches of this recording
    )


def is_recording(path: Path) -> bool:
    """Return True if a file or folder is a recording, possibly damaged."""
    with suppress(InputError):
        return format_of(path)[1].record is not None
    return path.is_file()


def recording_of(files: tuple[Path, ...]) -> Path | None:
    """Return the first recording, for the next command, or None if it consists of two files."""
    folder = session_folder(files[0])
    if folder is None:
        return files[0]
    names = names_in(folder)[0]
    return folder / names[0] if len(names) == 1 else None


def recordings_of(files: tuple[Path, ...], opening: Opening) -> tuple[tuple[Path, ...], Session | None]:
    """Return the given recordings, or the recordings of the given session, and the session."""
    folder = session_folder(files[0])
    if folder is None:
        return files, None
    return tuple(folder / names[0] for names in names_in(folder)), session_of(files, Place(), opening)


def names_in(folder: Path) -> list[list[str]]:
    """Return the names of the files of each recording of a session."""
    return [entry.files for entry in codec.read_toml(SessionFile, folder / NAME)[0].recording]


# ---- references


def labels_of(markers: str | None) -> tuple[str, ...] | None:
    """Return the labels of ``--markers A,B,C``."""
    return tuple(label.strip() for label in markers.split(",")) if markers else None


@options
@dataclass(frozen=True, kw_only=True)
class Optics:
    """The reference of each recording.

    Parameters
    ----------
    reference : Path
        The reference of each recording, in the same order. Recordings that contain poses (time_s, q_w ... q_z) do not need a
        reference.
    reference_map : Path or None
        Map of a table of orientations with foreign column names, as proposed by `info`.
    markers : str or None
        Labels of a rigid cluster, separated by commas, for C3D and TRC.
    """

    reference: Annotated[tuple[Path, ...], Parameter(show_default=False)] = ()
    reference_map: Path | None = None
    markers: str | None = None
    reference_up: Up = None

    def pairs(
        self, records: tuple[Path, ...], reader: Reader, *, command: str, session: Session | None = None
    ) -> list[tuple[Record, Reference]]:
        """Read recordings, or use the recordings of a session, and read the reference of each recording."""
        paths = self.reference
        if not paths and all(holds_poses(record) for record in records):
            paths = records
        if len(paths) != len(records):
            raise InputError(
                f"{command}: expected one reference for each recording, got {len(paths)} for {len(records)}. "
                "Repeat `reference` for each recording, in the same order."
            )
        read = [reader.read(record) for record in records] if session is None else session.records
        columns = None if self.reference_map is None else read_reference_map(self.reference_map)
        if self.reference_map is not None and columns is None:
            raise InputError(
                f"{self.reference_map}: expected a map of orientations, got none. Set columns = {{ quaternion = [w, x, y, z] }}."
            )
        labels, up = labels_of(self.markers), self.reference_up
        references = (read_reference(path, columns, labels=labels, up=up) for path in paths)
        return list(zip(read, references, strict=True))

    def of_cluster(self) -> bool:
        """Return True if the poses belong to a cluster of markers, whose axes are arbitrary."""
        return self.markers is not None and any(format_of(path)[1].markers for path in self.reference)
