"""Files and jobs in the folder of a bench, newest first.

Each is stored in a separate folder with a description in the file ABOUT. The description is written in a single step,
so that a bench that is killed loses nothing. Only one bench can use a folder. It locks the file LOCK and writes its
address there.
"""

import json
import shutil
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import IO, Any, ClassVar

from undrift.base.options import stated
from undrift.errors import InputError
from undrift.files import take_lock, write_whole

ABOUT, LOCK = ".bench.json", ".lock"  # no upload is called so
FILES = {"calibration": "calibration.json", "report": "report.html", "certificate": "certificate.html"}  # of a job
SENSORS = {"accel": "accelerometers", "gyro": "gyroscopes"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Remark:
    """Something that a command noticed."""

    level: str  # fail, warn or info
    text: str
    action: str = ""  # suggested action, may be empty


@dataclass(slots=True, kw_only=True)
class Entry:
    """A file or a job, with its folder."""

    SAVED: ClassVar[tuple[str, ...]] = ("serial",)
    folder: Path
    serial: str = ""  # serial number of the device, or "" until a person or the file provides it
    error: str = ""  # of the last command

    @property
    def name(self) -> str:
        """Return the display name."""
        return self.folder.name

    def save(self) -> None:
        """Save the description into its folder, unless the folder was deleted."""
        if self.folder.is_dir():
            values = {name: getattr(self, name) for name in self.SAVED}
            write_whole(self.folder / ABOUT, json.dumps(values, default=self._plain) + "\n")

    def _plain(self, value: Any) -> object:
        return value.relative_to(self.folder).as_posix() if isinstance(value, Path) else asdict(value)


@dataclass(slots=True, kw_only=True)
class StoredFile(Entry):
    """One file that was sent to the bench, or a folder of them that is one recording."""

    SAVED = (
        *("serial", "error", "path", "about", "map", "sample_rate_hz"),
        *("made", "remarks", "mounting"),
    )
    folder: Path = Path()  # folder of the file and its results
    path: Path
    about: dict[str, Any] = field(default_factory=dict)  # data from `info` about the file
    map: Path | None = None
    sample_rate_hz: float | None = None  # entered by a person, for a file without time
    made: dict[str, Path] = field(default_factory=dict)  # label -> file
    remarks: dict[str, list[Remark]] = field(default_factory=dict)  # what each command noticed
    mounting: str = ""  # that it showed, in a sentence

    def __post_init__(self) -> None:
        self.folder = self.path.parent

    @property
    def name(self) -> str:
        """Return the display name."""
        return self.path.name

    @property
    def kind(self) -> str:
        """Return the kind: recording, reference, calibration, table (that needs a map) ..."""
        return str(self.about.get("kind", ""))

    @property
    def needs_map(self) -> bool:
        """Return whether its columns and units must be confirmed."""
        return self.kind == "table" and bool(self.about.get("map"))

    @property
    def needs_rate(self) -> bool:
        """Return whether a command asked for its sample rate, or for another."""
        return not self.needs_map and "--sample-rate-hz" in f"{self.error} {self.about.get('summary')}"

    @property
    def summary(self) -> str:
        """Return a line about its content."""
        if self.needs_rate and self.kind != "recording":
            return "readings without time. Enter their sample rate."
        if self.error and not self.about:
            return self.error
        if self.needs_map:
            return f"a table of {len(self.about.get('columns') or ())} columns. Confirm its units."
        return str(self.about.get("summary") or self.kind or "not read yet")

    def options(self) -> tuple[object, ...]:
        """Return the options by which commands read it."""
        return stated(map=self.map, sample_rate_hz=self.sample_rate_hz)


@dataclass(slots=True, kw_only=True)
class Job(Entry):
    """The calibration of a device: its folder, and the captured data."""

    SAVED = ("serial", "words", "later")
    capture: Any = None  # web.guided, while its faces and turns are captured
    calibration: Path | None = None
    report: Path | None = None
    certificate: Path | None = None
    words: tuple[str, ...] = ()  # of the call of calibrate, for another try
    answer: dict[str, Any] = field(default_factory=dict)  # of calibrate
    later: list[dict[str, Any]] = field(default_factory=list)  # answers of the later commands

    @property
    def summary(self) -> str:
        """Return a line about its content."""
        done = self.calibration is not None
        return "calibrated" if done else "readings" if any(self.folder.rglob("*.parquet")) else "no readings"

    @property
    def session(self) -> Path:
        """Return the folder of its readings."""
        return self.folder / "session"

    @property
    def lacks(self) -> tuple[str, ...]:
        """Return the recorded sensors without a model in the calibration."""
        return tuple(what for name, what in SENSORS.items() if self.answer.get(name) is None)

    @property
    def gravity_assumed(self) -> bool:
        """Return True if the accelerometers' scale depends on an assumed gravity."""
        settings = (self.answer.get("provenance") or {}).get("settings") or {}
        return self.answer.get("accel") is not None and settings.get("gravity", "standard") == "standard"

    def look(self) -> "Job":
        """Load the content of its folder: calibration, report, certificate."""
        for name, file in FILES.items():
            setattr(self, name, self.folder / file if (self.folder / file).is_file() else None)
        return self

    def read(self) -> "Job":
        """Read the calibration in its folder, unless it is loaded."""
        self.answer = self.answer or read_object(self.folder / "calibration.json")
        return self


class Library:
    """The files and jobs of a folder, created once at the start of a bench."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files = [stored for place in _newest(folder / "uploads") if (stored := _file_in(place)) is not None]
        self.jobs: list[Job] = []
        self.find_jobs()

    def find_jobs(self) -> None:
        """Add the jobs in the folder."""
        loaded = {job.folder: job for job in self.jobs}
        self.jobs = [loaded.get(place) or _job_in(place) for place in _newest(self.folder / "jobs")]

    def file_at(self, path: Path) -> StoredFile:
        """Return the file at a path: a known one, or a new one before all others."""
        stored = next((file for file in self.files if file.path == path), None)
        if stored is None:
            self.files.insert(0, stored := StoredFile(path=path))
        stored.save()
        return stored

    def name_of(self, path: Path) -> str:
        """Return the name of a calibration, from its job or from the uploaded file."""
        name = next((entry.name for entry in (*self.jobs, *self.files) if entry.folder == path.parent), "")
        return name if name and path.name == "calibration.json" else f"{name}: {path.name}".removeprefix(": ")


def read_object(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file, or nothing if it cannot be read."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def came_words(entry: StoredFile | Job) -> str:
    """Return when something came."""
    return f"{datetime.fromtimestamp(_arrival_time(entry.folder)):%Y-%m-%d %H:%M}" if entry.folder.is_dir() else ""


def _newest(folder: Path) -> list[Path]:
    """Return the subfolders of a folder, the newest first. Create the folder if needed, and delete incomplete uploads."""
    folder.mkdir(parents=True, exist_ok=True)
    for upload in folder.glob("*/**/sent.part"):
        upload.unlink()
    places = [place for place in folder.iterdir() if place.is_dir()]
    return sorted(places, key=lambda place: (_arrival_time(place), place.name), reverse=True)


def _arrival_time(place: Path) -> float:
    """Return when the first file of a folder came, s since 1970."""
    return min((path.stat().st_mtime for path in place.iterdir() if path.name != ABOUT), default=place.stat().st_mtime)


def _file_in(place: Path) -> StoredFile | None:
    about = read_object(place / ABOUT)
    with suppress(TypeError, KeyError, ValueError, AttributeError):  # of another version, or touched by hand
        paths = {name: about[name] and place / about[name] for name in ("path", "map")}
        outputs = {label: place / name for label, name in about["made"].items()}
        remarks = {key: [Remark(**remark) for remark in several] for key, several in about["remarks"].items()}
        stored = StoredFile(**{**about, **paths, "made": outputs, "remarks": remarks})
        if stored.path.exists():
            return stored
    if arrived := [path for path in place.iterdir() if not path.name.startswith(".")]:
        return StoredFile(path=min(arrived, key=lambda path: path.stat().st_mtime))
    shutil.rmtree(place, ignore_errors=True)
    return None


def _job_in(folder: Path) -> Job:
    about = {key: value for key, value in read_object(folder / ABOUT).items() if key in Job.SAVED}
    return Job(folder=folder, **{**about, "words": tuple(about.get("words", ()))}).look()


def lock_folder(folder: Path) -> IO[str]:
    """Lock a folder until the file is closed or its process ends. If another bench uses the folder, the error contains
    its address.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = (folder / LOCK).open("a+", encoding="utf-8")
    try:
        take_lock(lock.fileno())
    except OSError as error:
        lock.seek(0)
        other = lock.read().strip()
        lock.close()
        raise InputError(
            f"bench: {folder} is in use by the bench at {other}. Open that bench, or choose another folder."
        ) from error
    lock.truncate(0)
    return lock
