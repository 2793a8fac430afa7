"""Inputs and outputs of commands: recordings with their map or a stored map, sessions, references, and files to write.

Settings for reading are dataclasses marked ``@options``. Each field is an option of the command line.
"""

import json
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from undrift.base import codec
from undrift.base.options import WRITTEN, Policy, Up, options
from undrift.base.spoken import CALLED, option_of
from undrift.correction.correct import correct_checked
from undrift.errors import Implausible, InputError
from undrift.files import sha256_of, write_whole
from undrift.findings import Finding, Level, finding
from undrift.io.column_map import ColumnMap, file_map_of, map_of, one_map, read_map
from undrift.io.formats import (
    detect,
    format_of,
    holds_poses,
    iter_record,
    read_markers,
    read_record,
    read_reference,
)
from undrift.io.inspect import needs_map
from undrift.io.mocap import pose_from_cluster
from undrift.io.reference import ReferenceMap, read_reference_map
from undrift.io.session import NAME, SessionFile, gravity_of, read_session, session_from_files
from undrift.model import BodyMounting, Calibration
from undrift.record import FileMap, GravitySource, Kind, Record, Reference, Session, Still
from undrift.report.page import Origin
from undrift.report.report import plain
from undrift.sim.device.model import DeviceModel, read_device
from undrift.sim.device.presets import PRESETS, preset, random_device
from undrift.units import STANDARD_GRAVITY, is_physical


@dataclass(frozen=True)
class Kept:
    """The map that a calibration keeps of its device."""

    path: Path  # of the calibration
    file_map: FileMap


@options
@dataclass(frozen=True, kw_only=True)
class Opening:
    """Settings for reading a foreign recording.

    Parameters
    ----------
    column_map : Path or None
        TOML file with columns, units and what else a foreign table needs: undrift info FILE --write-map writes it. With
        undrift's own column names only sample_rate_hz, gaps, clock, repair_time or drop_bad_rows, without columns. Overrules the
        map that a calibration keeps.
    sample_rate_hz : float or None
        Samples per second, for a file without time. Overrides the map.
    sensor : str or None
        Which sensor, stream or topic, in a file of several.
    """

    column_map: Annotated[Path | None, Parameter(name="--map")] = None
    sample_rate_hz: float | None = None
    sensor: str | None = None
    kept: Annotated[Kept | None, Parameter(parse=False)] = None

    def like(self, model: Calibration | None, path: Path | None) -> "Opening":
        """Return how to read the recordings of a calibrated device: by the map that its calibration keeps."""
        if model is None or path is None or model.file_map is None:
            return self
        return replace(self, kept=Kept(path, model.file_map))

    def file_map(self) -> FileMap | None:
        """Return the named map with the options over it, or None without any."""
        if self.column_map is not None:
            return file_map_of(read_map(self.column_map, **self._keys))
        return file_map_of(ColumnMap(**self._keys)) if self._keys else None

    def words(self) -> list[object]:
        """Return the options as they were given."""
        values = {"map": self.column_map, **self._keys}
        return [
            word
            for name, value in values.items()
            if value is not None
            for word in (f"--{name.replace('_', '-')}", value)
        ]

    @property
    def _keys(self) -> dict[str, Any]:
        keys = {"sample_rate_hz": self.sample_rate_hz, "sensor": self.sensor}
        return {key: value for key, value in keys.items() if value is not None}

    def how(self, path: Path) -> ColumnMap:
        """Return how to read a file: by the map that was named, else as it is, else by the map that the calibration keeps."""
        if self.column_map is not None:
            return one_map(read_map(self.column_map, **self._keys))
        kept = map_of(None if self.kept is None else self.kept.file_map)
        kept = map_of(None) if kept.columns is not None and not needs_map(path) else kept
        return one_map(kept.but(**self._keys))

    def record(self, path: Path) -> Record:
        """Read one file, or folder of a device."""
        with self._naming_map(path):
            return read_record(path, self.how(path))

    def chunks(self, path: Path) -> Iterator[Record]:
        """Read one file in chunks."""
        with self._naming_map(path):
            yield from iter_record(path, self.how(path))

    def read(self, path: Path) -> Record:
        """Read a recording. For a session folder, read its only recording."""
        if detect(path) != "session":
            return self.record(path)
        records = read_session(path).records
        if len(records) > 1:
            raise InputError(f"{path}: expected one recording, got a session of {len(records)}. Name one of its files.")
        return records[0]

    @contextmanager
    def _naming_map(self, path: Path) -> Iterator[None]:
        """Name file and calibration in the error of a file that does not fit the map of the calibration."""
        try:
            yield
        except InputError as error:
            if self.kept is None or self.column_map is not None:
                raise
            text = str(error).removeprefix(f"{path}: ")
            raise InputError(
                f"{path}: the file does not match the map stored in {self.kept.path} for its device: {text}. Name "
                "another map with `column_map`.",
                **error.numbers,
            ) from error


@options
@dataclass(frozen=True, kw_only=True)
class NamedRest:
    """A stretch at rest that is named in place of the first still phase.

    Parameters
    ----------
    rest_s : str or None
        START:STOP of a rest, s on the recording's clock. By default the first rest is used.
    """

    rest_s: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None

    @property
    def stop_s(self) -> float | None:
        """End of the named stretch, s, or None without a name."""
        return None if self.rest_s is None else ends_of("`rest_s`", self.rest_s, "s")[1]

    def still_in(self, record: Record) -> Still | None:
        """Return the named stretch of a recording, or None if none was named."""
        if self.rest_s is None:
            return None
        start_s, stop_s = ends_of("`rest_s`", self.rest_s, "s")
        first, last = float(record.time[0]), float(record.time[-1])
        if not first <= start_s < stop_s <= last:
            raise InputError(
                f"`rest_s`: expected START:STOP within the recording's {first:.6g} to {last:.6g} s, got {start_s:g} and "
                f"{stop_s:g}. Give the start and the end of a rest."
            )
        start, stop = record.time.searchsorted((start_s, stop_s))
        return Still(start=int(start), stop=max(int(stop), int(start) + 1))


@options
@dataclass(frozen=True, kw_only=True)
class TableUse:
    """Use of the tables of a calibration.

    Parameters
    ----------
    power_on_s : float or None
        Time since power-on at the first sample of each recording, s. Without it, no warm-up is subtracted.
    policy : str
        Temperatures outside a tuning table: refuse (raise), hold the table's end, or leave a gap (nan). Without a
        recorded temperature the result is always a gap, and a warning reports its duration.
    """

    power_on_s: float | None = None
    policy: Policy = "raise"


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


# ---- sessions


def session_folder(path: Path) -> Path | None:
    """Return the folder of a session that is named by its folder or its session.toml, or None."""
    folder = path.parent if path.name == NAME else path
    return folder if path.name == NAME or (path / NAME).is_file() else None


def session_of(files: tuple[Path, ...], place: Place, opening: Opening, *, kind: Kind = "calibration") -> Session:
    """Read a session folder, or make a session of bare recordings."""
    named = [file for file in files if session_folder(file) is not None]
    if not named:
        for folder in (file for file in files if file.is_dir() and not is_recording(file)):
            read_session(folder)  # raises a message about the content of a session folder
        return session_from_files(files, opening.file_map(), kind=kind, **asdict(place))
    if len(files) > 1:
        raise InputError(
            f"{named[0]}: expected one session, or recordings, got a session and {len(files) - 1} more. Name only the "
            "session, or list the recordings in its session.toml."
        )
    session = read_session(named[0])
    fixed = {name: getattr(opening, name) for name in ("column_map", "sample_rate_hz", "sensor")}
    fixed |= {"serial": place.serial or None}
    if session.gravity_source != "standard":
        fixed |= {"gravity_m_s2": place.gravity_m_s2, "height_m": place.height_m}
    used = [option_of(name) for name, value in fixed.items() if value is not None]
    if used:
        raise InputError(f"{named[0]}: {', '.join(used)} cannot be used with a session. Set them in its session.toml.")
    if session.gravity_source == "standard":
        # a latitude without a height is that of the rate table
        latitude_deg = None if place.height_m is None else place.latitude_deg
        gravity_m_s2, source = gravity_of(place.gravity_m_s2, latitude_deg, place.height_m)
        session = replace(session, gravity_m_s2=gravity_m_s2, gravity_source=source)
    return session


def states_gravity(path: Path) -> bool:
    """Return True if a session.toml states local gravity."""
    return read_session(path).gravity_source != "standard"


def thermal_session(path: Path, opening: Opening, model: Calibration | None) -> Session:
    """Read a session. A single recording becomes a session."""
    if detect(path) == "session":
        return read_session(path)
    record, file_map = opening.record(path), opening.file_map()
    return Session(
        kind="thermal",
        records=(record,),
        serial=record.device,
        gravity_m_s2=STANDARD_GRAVITY if model is None else model.gravity_m_s2,
        inputs=((path.name, sha256_of(path)),) if path.is_file() else (),
        file_map=file_map and file_map_of(map_of(file_map), without=("leave_out",)),  # stretches of this recording
    )


def is_recording(path: Path) -> bool:
    """Return True if a file or folder is a recording, possibly damaged."""
    with suppress(InputError):
        return format_of(path)[1].record is not None
    return path.is_file()


def recording_of(files: tuple[Path, ...]) -> Path | None:
    """Return a recording for the next command: the first one. Return None if it consists of two files."""
    folder = session_folder(files[0])
    if folder is None:
        return files[0]
    names = _names_in(folder)[0]
    return folder / names[0] if len(names) == 1 else None


def recordings_of(
    files: tuple[Path, ...], opening: Opening, place: Place = Place()
) -> tuple[tuple[Path, ...], Session | None]:
    """Return the named recordings, or the recordings of the named session and the session."""
    folder = session_folder(files[0])
    if folder is None:
        return files, None
    return tuple(folder / names[0] for names in _names_in(folder)), session_of(files, place, opening)


def _names_in(folder: Path) -> list[list[str]]:
    """Return the names of the files of each recording of a session."""
    return [entry.files for entry in codec.read_toml(SessionFile, folder / NAME)[0].recording]


# ---- readings and their calibration


def check_physical(record: Record, path: Path) -> None:
    """Refuse counts and volts of a recording that no calibration gives a physical unit."""
    for name, values, unit in (("gyro", record.gyro, record.gyro_unit), ("accel", record.accel, record.accel_unit)):
        if values is not None and not is_physical(unit):
            raise InputError(
                f"{path}: expected physical units or a calibration of the device, got {name} in {unit}. Add "
                "`calibration` calibration.json."
            )


def corrected(
    readings: Record, path: Path, model: Calibration | None, applying: TableUse
) -> tuple[Record, tuple[Finding, ...], tuple[str, ...]]:
    """Return the readings by their calibration, if there is one, what speaks against them, and notes."""
    if model is None:
        check_physical(readings, path)
        return readings, (), ()
    done = correct_checked(readings, model, policy=applying.policy, power_on_s=applying.power_on_s)
    return done.record, tuple(item for item in done.findings if item.level == "warn"), done.notes


def calibration_findings(model: Calibration | None) -> tuple[Finding, ...]:
    """Return one finding in place of those of a calibration whose verdict is not good."""
    if model is None or model.verdict.status == "good":
        return ()
    level: Level = "fail" if model.verdict.status == "bad" else "warn"
    sentence = f"The verdict of the calibration is {model.verdict.status}."
    return (finding("calibration.verdict", level, sentence, "Read its findings with undrift info."),)


def worn_by(model: Calibration | None, forward: str | None, up: str | None) -> BodyMounting | None:
    """Return the mounting in a calibration, or None if the sides of the device are given instead."""
    return None if model is None or forward or up else model.mounting


def calibrated_part(record: Record, model: Calibration) -> tuple[Record, tuple[str, ...]]:
    """Leave out, with a note, the triad that stays in counts or volts because the calibration has no model of it."""
    if record.gyro is None or record.accel is None or (model.gyro is None and model.accel is None):
        return record, ()
    for name, words, si in (("accel", "accelerometers", "m/s2"), ("gyro", "gyroscopes", "rad/s")):
        unit = getattr(record, f"{name}_unit")
        if getattr(model, name) is None and not is_physical(unit):
            removed: dict[str, Any] = {name: None, f"{name}_unit": si}
            note = (
                f"The {words} are left out of the result: they are in {unit}, and the calibration has no model of them."
            )
            return replace(record, **removed), (note,)
    return record, ()


@contextmanager
def named_columns(path: Path) -> Iterator[None]:
    """Add the file and the remedial option to errors about columns, units or sample rate."""
    try:
        yield
    except Implausible as error:
        rate, message = error.numbers.get("sample_rate_hz"), f"{path}: {str(error).removeprefix(f'{path}: ')}"
        raise Implausible(message + (f": `sample_rate_hz` {rate:.4g}" if rate else ""), **error.numbers) from error


# ---- references and devices


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
        The reference of each recording, in the same order. Recordings that contain poses (time_s, q_w ... q_z) need
        none.
    reference_map : Path or None
        Map of a table of orientations under other names than undrift's own, as `info` proposes it.
    markers : str or None
        Labels of a rigid cluster, separated by commas, for C3D and TRC.
    """

    reference: Annotated[tuple[Path, ...], Parameter(show_default=False)] = ()
    reference_map: Path | None = None
    markers: str | None = None
    reference_up: Up = None

    def pairs(
        self, records: tuple[Path, ...], opening: Opening, *, command: str, session: Session | None = None
    ) -> list[tuple[Record, Reference]]:
        """Read recordings, or use the recordings of a session, and read the reference of each."""
        paths = self.reference
        if not paths and all(holds_poses(record) for record in records):
            paths = records
        if len(paths) != len(records):
            raise InputError(
                f"{command}: expected one reference for each recording, got {len(paths)} for {len(records)}. "
                "Repeat `reference` for each recording, in the same order."
            )
        read = [opening.read(record) for record in records] if session is None else session.records
        return list(zip(read, self.read(paths), strict=True))

    def of_cluster(self) -> bool:
        """Return True if the poses belong to a cluster of markers, whose axes are arbitrary."""
        return self.markers is not None and any(format_of(path)[1].markers for path in self.reference)

    def read(self, paths: tuple[Path, ...]) -> list[Reference]:
        """Read references with these options."""
        columns = None if self.reference_map is None else read_reference_map(self.reference_map)
        if self.reference_map is not None and columns is None:
            raise InputError(
                f"{self.reference_map}: expected a map of orientations, got none. Set columns = {{ quaternion = [w, x, y, z] }}."
            )
        return [self._poses(path, columns) for path in paths]

    def _poses(self, path: Path, columns: ReferenceMap | None) -> Reference:
        """Read a reference. Errors name the options that a file of markers needs."""
        labels, entry = labels_of(self.markers), format_of(path)[1]
        if entry.markers is None:
            return read_reference(path, columns, labels=labels if entry.bodies else None, up=self.reference_up)
        try:
            markers = read_markers(path, up=self.reference_up)
        except InputError as error:
            if self.reference_up is not None or error.numbers.get("missing") != "up":
                raise
            raise InputError(
                f"{path}: expected the axis that points up, got none. Set `reference_up` y or `reference_up` z."
            ) from error
        if labels is None:
            raise InputError(
                f"{path}: expected the labels of one rigid cluster, got none. Set `markers` to three or more, separated "
                f"by commas, of {', '.join(markers.labels)}."
            )
        return pose_from_cluster(markers, labels)


def device_at(name: str, rng: np.random.Generator, *, draw: bool) -> DeviceModel:
    """Return a preset's typical unit, or one drawn within its tolerances, or the device of a file."""
    if name in PRESETS:
        return random_device(rng, grade=name) if draw else preset(name)
    if not Path(name).exists():
        raise InputError(
            f"device: expected a device.json or one of {', '.join(PRESETS)}, got '{name}'. Choose one of them."
        )
    if draw:
        raise InputError(
            f"`draw`: expected a preset from which a device is drawn, got {name}. Omit `draw` with a device.json."
        )
    return read_device(Path(name))


def ends_of(option: str, text: str, unit: str = "degC") -> tuple[float, float]:
    """Return the two ends of LOW:HIGH, the lower first."""
    low, _, high = text.partition(":")
    try:
        ends = float(low), float(high)
    except ValueError:
        raise InputError(f"{option}: expected LOW:HIGH in {unit}, got '{text}'. Write, for example, 15:35.") from None
    if not ends[0] < ends[1] or (unit == "degC" and not -273.15 < ends[0] < ends[1] < 1000.0):
        raise InputError(f"{option}: expected LOW below HIGH in {unit}, got '{text}'. Write, for example, 15:35.")
    return ends


# ---- Files to write, checked before the work begins: a wrong name costs nothing and loses nothing


def check_output(
    path: Path | None, *, endings: tuple[str, ...], reads: Iterable[Path | None] = (), beside: Iterable[Path] = ()
) -> None:
    """Refuse an output with an unsuitable ending, in a missing folder, or equal to an input or its sidecar file."""
    if path is None:
        return
    if not path.name.lower().endswith(endings):
        either = endings[0] if len(endings) == 1 else ", ".join(endings[:-1]) + " or " + endings[-1]
        raise InputError(f"{path}: expected a name ending in {either}. Change the ending.")
    if path.is_dir():
        raise InputError(f"{path}: expected the name of a file to write, got a folder. Add the name of a file.")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist. Create it first.")
    inputs = [read for read in reads if read is not None]
    for file in (path, *beside):
        if file.exists() and any(_holds(read, file) for read in inputs):
            raise InputError(f"{file}: this file is also read and cannot be written. Choose another name.")


def check_folder(path: Path | None) -> None:
    """Refuse a folder that cannot be written to, nor made in a folder that exists."""
    if path is None:
        return
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: expected a folder to write to, got a file of that name. Choose another name.")
    if not path.exists() and not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist. Create it first.")


def name_of(path: Path) -> str:
    """Return a recording's name without its endings, for rows and files: walk.v2 of walk.v2.csv.gz."""
    name = path.resolve().name if path.name in ("", "..") else path.name
    for ending in (".gz", ".csv", ".txt", ".log", ".parquet", ".npz", ".mat", ".hdf5", ".h5", ".tsv"):
        if len(name) > len(ending):
            name = name.removesuffix(ending)
    return name


def _holds(read: Path, target: Path) -> bool:
    """Return True if a file is the input, or inside the input folder."""
    if not read.is_dir():
        return read.exists() and target.samefile(read)
    if (read / NAME).is_file():
        names = [NAME, *(name for names_of_record in _names_in(read) for name in names_of_record)]
    else:
        names = [file.name for file in read.iterdir()]  # of a device that records into a folder
    return any((read / name).exists() and target.samefile(read / name) for name in names)


def files_in(value: object) -> Iterator[Path]:
    """Yield the files among the values of options, including the fields of settings."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from files_in(item)
    elif is_dataclass(value):
        for item in fields(value):
            if WRITTEN not in getattr(item.type, "__metadata__", ()):
                yield from files_in(getattr(value, item.name))


def save_json(path: Path, value: object) -> None:
    """Write a JSON object to a file, with NaN as null."""
    write_whole(path, json.dumps(plain(value), indent=1, allow_nan=False) + "\n")


def origin_of(*read: Path | None) -> Origin:
    """Return the origin of a page: the command, and its files with their sha256, those of folders separately."""
    paths = [path for path in read if path is not None and path.exists()]
    files = {
        file: str(file.relative_to(path.parent)) if path.is_dir() else path.name
        for path in paths
        for file in (sorted(path.rglob("*")) if path.is_dir() else (path,))
        if file.is_file()
    }
    inputs = tuple((name, sha256_of(file)) for file, name in files.items())
    return Origin(command=shlex.join(("undrift", *CALLED.get())), inputs=inputs)
