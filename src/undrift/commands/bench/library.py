"""What the folder of a bench holds: files that were sent, and jobs; newest first.

Each is stored in a folder of its own with a file ABOUT that describes it, written whole: a bench that is killed loses none of them.
A folder has one bench at a time, which locks LOCK and writes its address there.
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
    action: str = ""  # what to do about it; may be empty


@dataclass(slots=True, kw_only=True)
class Entry:
    """A file or a job, with the folder that holds it."""

    SAVED: ClassVar[tuple[str, ...]] = ("serial",)
    folder: Path
    serial: str = ""  # of the device; "" until somebody states it, or the file does
    error: str = ""  # of the last command

    @property
    def name(self) -> str:
        """Return what it is called."""
        return self.folder.name

    def save(self) -> None:
        """Write what is known of it into its folder, unless that was deleted."""
        if self.folder.is_dir():
            known = {name: getattr(self, name) for name in self.SAVED}
            write_whole(self.folder / ABOUT, json.dumps(known, default=self._plain) + "\n")

    def _plain(self, value: Any) -> object:
        return value.relative_to(self.folder).as_posix() if isinstance(value, Path) else asdict(value)


@dataclass(slots=True, kw_only=True)
class StoredFile(Entry):
    """One file that was sent to the bench, or a folder of them that is one recording."""

    SAVED = (
        *("serial", "error", "path", "about", "map", "sample_rate_hz"),
        *("made", "remarks", "mounting"),
    )
    folder: Path = Path()  # that of the file, with what was made of it
    path: Path
    about: dict[str, Any] = field(default_factory=dict)  # what `info` says of it
    map: Path | None = None
    sample_rate_hz: float | None = None  # that a person stated, of a file without time
    made: dict[str, Path] = field(default_factory=dict)  # label -> file
    remarks: dict[str, list[Remark]] = field(default_factory=dict)  # what each command noticed
    mounting: str = ""  # that it showed, in a sentence

    def __post_init__(self) -> None:
        self.folder = self.path.parent

    @property
    def name(self) -> str:
        """Return what it is called."""
        return self.path.name

    @property
    def kind(self) -> str:
        """Return what it is: recording, reference, calibration, table (that needs a map) ..."""
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
        """Return in one line what it holds."""
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
    """One device being calibrated: its folder, and what has been captured for it."""

    SAVED = ("serial", "words", "later")
    capture: Any = None  # web.guided, while its faces and turns are captured
    calibration: Path | None = None
    report: Path | None = None
    certificate: Path | None = None
    words: tuple[str, ...] = ()  # of the call of calibrate, for another try
    answer: dict[str, Any] = field(default_factory=dict)  # of calibrate
    later: list[dict[str, Any]] = field(default_factory=list)  # what the commands after it answered

    @property
    def summary(self) -> str:
        """Return in one line what it holds."""
        done = self.calibration is not None
        return "calibrated" if done else "readings" if any(self.folder.rglob("*.parquet")) else "no readings"

    @property
    def session(self) -> Path:
        """Return the folder of its readings."""
        return self.folder / "session"

    @property
    def lacks(self) -> tuple[str, ...]:
        """Return the sensors that its calibration has no model of; those that were recorded, where the command says so."""
        missing = [what for name, what in SENSORS.items() if self.answer.get(name) is None]
        return tuple(self.answer.get("lacking", missing))

    @property
    def gravity_assumed(self) -> bool:
        """Whether the accelerometers' scale stands on a gravity that nobody stated."""
        settings = (self.answer.get("provenance") or {}).get("settings") or {}
        return self.answer.get("accel") is not None and settings.get("gravity", "standard") == "standard"

    def look(self) -> "Job":
        """Take up what its folder holds: calibration, report, certificate."""
        for name, file in FILES.items():
            setattr(self, name, self.folder / file if (self.folder / file).is_file() else None)
        return self

    def read(self) -> "Job":
        """Read the calibration that its folder holds, unless it is known."""
        self.answer = self.answer or read_object(self.folder / "calibration.json")
        return self


class Library:
    """The files and jobs of one folder; made once, at the start of a bench."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files = [stored for place in _newest(folder / "uploads") if (stored := _file_in(place)) is not None]
        self.jobs: list[Job] = []
        self.find_jobs()

    def find_jobs(self) -> None:
        """Take up the jobs that the folder holds."""
        known = {job.folder: job for job in self.jobs}
        self.jobs = [known.get(place) or _job_in(place) for place in _newest(self.folder / "jobs")]

    def file_at(self, path: Path) -> StoredFile:
        """Return the file at a path: a known one, or a new one before all others."""
        stored = next((one for one in self.files if one.path == path), None)
        if stored is None:
            self.files.insert(0, stored := StoredFile(path=path))
        stored.save()
        return stored

    def name_of(self, path: Path) -> str:
        """Return what a calibration is called: by its job, or by the file that was sent."""
        name = next((one.name for one in (*self.jobs, *self.files) if one.folder == path.parent), "")
        return name if name and path.name == "calibration.json" else f"{name}: {path.name}".removeprefix(": ")


def read_object(path: Path) -> dict[str, Any]:
    """Return what a file of JSON holds; nothing where it cannot be read."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def came_words(entry: StoredFile | Job) -> str:
    """Return when something came."""
    return f"{datetime.fromtimestamp(_came(entry.folder)):%Y-%m-%d %H:%M}" if entry.folder.is_dir() else ""


def _newest(folder: Path) -> list[Path]:
    """Return the folders in a folder, made where it is not there, the newest first; half a file that was being sent is deleted."""
    folder.mkdir(parents=True, exist_ok=True)
    for part in folder.glob("*/**/sent.part"):
        part.unlink()
    places = [place for place in folder.iterdir() if place.is_dir()]
    return sorted(places, key=lambda place: (_came(place), place.name), reverse=True)


def _came(place: Path) -> float:
    """Return when the first file of a folder came, s since 1970."""
    return min((path.stat().st_mtime for path in place.iterdir() if path.name != ABOUT), default=place.stat().st_mtime)


def _file_in(place: Path) -> StoredFile | None:
    about = read_object(place / ABOUT)
    with suppress(TypeError, KeyError, ValueError, AttributeError):  # of another version, or touched by hand
        paths = {name: about[name] and place / about[name] for name in ("path", "map")}
        made = {label: place / name for label, name in about["made"].items()}
        remarks = {key: [Remark(**one) for one in several] for key, several in about["remarks"].items()}
        stored = StoredFile(**{**about, **paths, "made": made, "remarks": remarks})
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
    """Lock a folder until the file is closed, or its process killed; where another bench has it, its address is stated."""
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
