"""What the folder of a bench holds: files that were sent, and jobs; newest first, by the names that people give them.

Each stands in a folder of its own with a file ABOUT that describes it, written whole: a bench that is killed loses none of them.
What has no such file is listed by its own name. A folder has one bench at a time, which locks LOCK and writes its address there.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from datetime import datetime
from pathlib import Path
from typing import Any

from undrift.base.options import stated
from undrift.errors import InputError
from undrift.files import take_lock, write_whole
from undrift.web.commands import Remark

ABOUT, LOCK = ".bench.json", ".lock"  # no upload is called so
FILES = {"calibration": "calibration.json", "report": "report.html", "certificate": "certificate.pdf"}  # of a job
SENSORS = {"accel": "accelerometers", "gyro": "gyroscopes"}


@dataclass(slots=True, kw_only=True)
class StoredFile:
    """One file that was sent to the bench, or a folder of them that is one recording."""

    path: Path
    title: str = ""  # given by a person; "" is the file's own
    about: dict[str, Any] = field(default_factory=dict)  # what `info` says of it
    map: Path | None = None
    sample_rate_hz: float | None = None  # that a person stated, of a file without time
    picture: Path | None = None
    made: dict[str, Path] = field(default_factory=dict)  # label -> file
    remarks: dict[str, list[Remark]] = field(default_factory=dict)  # what each command noticed
    mounting: str = ""  # that it showed, in a sentence
    error: str = ""

    @property
    def folder(self) -> Path:
        """Return the folder that it stands in, with what was made of it."""
        return self.path.parent

    @property
    def name(self) -> str:
        """Return what it is called."""
        return self.title or self.path.name

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
            return "readings without time; state their sample rate"
        if self.error and not self.about:
            return self.error
        if self.needs_map:
            return f"a table of {len(self.about.get('columns') or ())} columns; confirm its units"
        return str(self.about.get("summary") or self.kind or "not read yet")

    def options(self) -> tuple[object, ...]:
        """Return the options by which commands read it."""
        return stated(map=self.map, sample_rate_hz=self.sample_rate_hz)

    def save(self) -> None:
        """Write what is known of it beside it."""
        if self.folder.is_dir():
            known = json.dumps(asdict(self), default=lambda path: path.relative_to(self.folder).as_posix())
            write_whole(self.folder / ABOUT, known + "\n")


@dataclass(slots=True, kw_only=True)
class Job:
    """One device being calibrated: its folder, and what has been captured for it."""

    folder: Path
    title: str = ""  # given by a person; "" is the folder's name
    serial: str = ""
    capture: Any = None  # web.guided, while its faces and turns are captured
    calibration: Path | None = None
    report: Path | None = None
    certificate: Path | None = None
    words: tuple[str, ...] = ()  # of the call of calibrate, for another try
    answer: dict[str, Any] = field(default_factory=dict)  # of calibrate
    later: list[dict[str, Any]] = field(default_factory=list)  # what the commands after it answered
    registered: str = ""  # what the registry answered
    error: str = ""  # of the last command

    @property
    def name(self) -> str:
        """Return what it is called."""
        return self.title or self.folder.name

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

    def save(self) -> None:
        """Write what is known of it into its folder."""
        if self.folder.is_dir():
            known = {name: getattr(self, name) for name in ("title", "serial", "words", "later", "registered")}
            write_whole(self.folder / ABOUT, json.dumps(known) + "\n")

    def look(self) -> None:
        """Take up what its folder holds: calibration, report, certificate."""
        for name, file in FILES.items():
            setattr(self, name, self.folder / file if (self.folder / file).is_file() else None)

    def read(self) -> "Job":
        """Read the calibration that its folder holds, unless it is known."""
        self.answer = self.answer or read_object(self.folder / "calibration.json")
        return self


Entry = StoredFile | Job


class Library:
    """The files and jobs of one folder, and how much room there is; made once, at the start of a bench."""

    def __init__(self, folder: Path, quota_gb: float) -> None:
        self.folder, self.quota_gb = folder, quota_gb
        for name in ("jobs", "uploads"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        self.files = [made for place in _newest(folder / "uploads") if (made := _file_in(place)) is not None]
        self.jobs: list[Job] = []
        self.find_jobs()

    def find_jobs(self) -> None:
        """Take up the jobs that the folder holds."""
        known = {job.folder: job for job in self.jobs}
        self.jobs = [known.get(place) or _job_in(place) for place in _newest(self.folder / "jobs")]

    def file_at(self, path: Path) -> StoredFile:
        """Return what stands at a path: known already, or new, before all others."""
        stored = next((one for one in self.files if one.path == path), None)
        if stored is None:
            self.files.insert(0, stored := StoredFile(path=path))
            stored.save()
        return stored

    def name_of(self, path: Path) -> str:
        """Return what a calibration is called: by its job, or by the file that was sent."""
        entries: list[Entry] = [*self.jobs, *self.files]
        name = next((one.name for one in entries if one.folder == path.parent), "")
        return name if name and path.name == "calibration.json" else f"{name}: {path.name}".removeprefix(": ")

    def rename(self, entry: Entry, title: str) -> None:
        """Call a file or a job otherwise; "" gives its own name back."""
        entry.title = " ".join(title.split())[:80]
        entry.save()

    def delete(self, entry: Entry) -> None:
        """Delete a file or a job, with what was made of it."""
        shutil.rmtree(entry.folder)
        self.files = [one for one in self.files if one is not entry]
        self.jobs = [one for one in self.jobs if one is not entry]

    def check_room(self, more: float = 0.0) -> None:
        """Refuse what is larger than the room that is left, bytes."""
        used = sum(size_of(self.folder))
        if used + more > 1e9 * self.quota_gb:
            raise InputError(
                f"folder of the bench: wanted at most {self.quota_gb:g} GB in it, got {(used + more) / 1e9:.3g} GB; "
                "delete files or jobs that are no longer needed"
            )


def size_of(folder: Path) -> Iterator[int]:
    """Yield the size of each file below a folder, bytes."""
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):  # deleted meanwhile
                yield (Path(place) / name).stat().st_size


def read_object(path: Path) -> dict[str, Any]:
    """Return what a file of JSON holds; nothing where it cannot be read."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return held if isinstance(held, dict) else {}


def _newest(folder: Path) -> list[Path]:
    """Return the folders in a folder, the newest first; half a file that was being sent or written is deleted."""
    for part in (*folder.glob("*/*.part"), *folder.glob("*/*/*.part"), *folder.glob("*/.undrift-*")):
        if part.is_file():
            part.unlink(missing_ok=True)
    places = [place for place in folder.iterdir() if place.is_dir()]
    return sorted(places, key=lambda place: (_came(place), place.name), reverse=True)


def _came(place: Path) -> float:
    """Return when the first file of a folder came, s since 1970."""
    return min((path.stat().st_mtime for path in place.iterdir() if path.name != ABOUT), default=0.0)


def came_words(entry: Entry) -> str:
    """Say when a file or a job came, and how large it is with what was made of it."""
    if not entry.folder.is_dir():
        return ""
    return f"{datetime.fromtimestamp(_came(entry.folder)):%Y-%m-%d %H:%M}, {sum(size_of(entry.folder)) / 1e6:.3g} MB"


def _file_in(place: Path) -> StoredFile | None:
    about = read_object(place / ABOUT)
    with suppress(TypeError, KeyError, ValueError, AttributeError):  # of another version, or touched by hand
        paths = {name: about[name] and place / about[name] for name in ("path", "map", "picture")}
        made = {label: place / name for label, name in about["made"].items()}
        remarks = {key: [Remark(**one) for one in several] for key, several in about["remarks"].items()}
        stored = StoredFile(**{**about, **paths, "made": made, "remarks": remarks})
        if stored.path.exists():
            return stored
    arrived = [path for path in place.iterdir() if not path.name.startswith(".")]
    if not arrived:
        shutil.rmtree(place, ignore_errors=True)
        return None
    return StoredFile(path=min(arrived, key=lambda path: path.stat().st_mtime))


def _job_in(folder: Path) -> Job:
    names = {one.name for one in fields(Job)}
    job = Job(
        **{"folder": folder, **{key: value for key, value in read_object(folder / ABOUT).items() if key in names}}
    )
    job.words = tuple(job.words or read_object(folder / "calibrate.json").get("words") or ())  # older benches wrote it
    job.look()
    return job


class FolderLock:
    """The lock of a folder, until it is closed; the system opens it where the bench is killed."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = (folder / LOCK).open("a+", encoding="utf-8")
        try:
            take_lock(self._file.fileno())
        except OSError as error:
            self._file.seek(0)
            other = self._file.read().strip()
            self._file.close()
            raise InputError(
                f"bench: wanted {folder} for itself, got it in use by the bench at {other}; open that, or name another folder"
            ) from error

    def write(self, address: str) -> None:
        """State where the bench that has the folder listens."""
        self._file.truncate(0)
        self._file.write(address + "\n")
        self._file.flush()

    def close(self) -> None:
        """Open the lock."""
        self._file.close()
