"""Files and guided recordings in the folder of a bench. Each has a separate folder, which also contains its results.

::

    uploads/NAME/    a file that was sent
    jobs/NAME/       a guided recording: the folder session
        .bench.json          what is known about it
        map.toml             columns and units, if a person confirmed them
        calibration.json     and other results, each with its report COMMAND.html

Every file is written in a single step, so that no data are lost if the bench is killed. Only one bench can use a folder.
"""

import json
import re
import shutil
import unicodedata
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import IO, Any

from undrift.commands.files import Opening
from undrift.commands.info import Looked
from undrift.errors import InputError
from undrift.files import take_lock, write_whole
from undrift.report import Report

ABOUT, LOCK, ARRIVING = ".bench.json", ".lock", "sent.part"  # name that no upload has
MAP, CALIBRATION = "map.toml", "calibration.json"
RESULTS = {  # files that each command writes
    "info": (),
    "calibrate": (CALIBRATION,),
    "certificate": (),
    "correct": ("*-corrected.csv", "*-corrected.parquet"),
    "orient": ("*-angles.csv", "*-angles.parquet"),
}
SAVED = ("kind", "summary", "serial", "sample_rate_hz", "sensor", "turn_deg", "draft")
KEPT = frozenset(" ._-+=,@()")  # characters allowed in a name, in addition to letters, marks and digits of any script
LONGEST = 200  # longest name, bytes in UTF-8 (file systems accept 255, and results add a suffix)
ENDING = re.compile(r"(\.[A-Za-z0-9]{1,8})?\.gz$|\.[A-Za-z0-9]{1,8}$|$", re.I)
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.I)  # names that Windows gives to devices


@dataclass(slots=True, kw_only=True, eq=False)
class Item:
    """A file, a folder of files that are one recording, or a guided recording."""

    folder: Path
    path: Path
    kind: str = ""  # recording, calibration, table, session ...; "" if it has not been read yet
    summary: str = ""
    serial: str = ""
    sample_rate_hz: float | None = None  # sample rate of a file without time
    sensor: str | None = None  # selected sensor of a file with several sensors
    turn_deg: float | None = None  # angle of the turns of a recording
    draft: dict[str, Any] = field(default_factory=dict)  # proposed map, with "?" for unknown entries
    looked: Looked | None = None  # content, after it has been read
    reports: dict[str, Report] = field(default_factory=dict)  # reports by command, since the bench was started

    @property
    def name(self) -> str:
        """Return the display name."""
        return f"Recording of {self.serial}" if self.kind == "session" else self.path.name

    @property
    def opening(self) -> Opening:
        """Return the settings with which commands read the item."""
        mapped = self.folder / MAP
        column_map = mapped if mapped.is_file() else None
        return Opening(column_map=column_map, sample_rate_hz=self.sample_rate_hz, sensor=self.sensor)

    @property
    def calibration(self) -> Path | None:
        """Return the item itself if it is a calibration, otherwise the calibration made from it."""
        path = self.path if self.kind == "calibration" else self.folder / CALIBRATION
        return path if path.is_file() else None

    @property
    def arrival(self) -> str:
        """Return the date and time at which the item was added."""
        return f"{datetime.fromtimestamp(self.folder.stat().st_ctime):%Y-%m-%d %H:%M}" if self.folder.is_dir() else ""

    def page(self, command: str) -> Path | None:
        """Return the report page of a command, if the command was called."""
        path = self.folder / f"{command}.html"
        return path if path.is_file() else None

    def files(self, command: str) -> list[Path]:
        """Return the files that a command wrote."""
        return [path for pattern in RESULTS[command] for path in sorted(self.folder.glob(pattern)) if path != self.path]

    def save(self) -> None:
        """Save the known properties of the item."""
        values = {name: getattr(self, name) for name in SAVED}
        write_whole(self.folder / ABOUT, json.dumps(values | {"file": self.path.name}) + "\n")


def items_in(folder: Path) -> list[Item]:
    """Return the items of a bench's folder, the newest first. Incomplete uploads are deleted."""
    for group in ("uploads", "jobs"):
        (folder / group).mkdir(parents=True, exist_ok=True)
    places = [place for group in ("uploads", "jobs") for place in (folder / group).iterdir() if place.is_dir()]
    items = [item for place in places if (item := _item_in(place)) is not None]
    return sorted(items, key=lambda item: (item.folder / ABOUT).stat().st_ctime, reverse=True)


def _item_in(place: Path) -> Item | None:
    for fragment in place.glob(f"**/{ARRIVING}"):
        fragment.unlink()
    about = read_object(place / ABOUT)
    name = about.get("file") or next((path.name for path in place.iterdir() if not path.name.startswith(".")), "")
    if not name or not (place / str(name)).exists():
        shutil.rmtree(place, ignore_errors=True)
        return None
    item = Item(folder=place, path=place / str(name))
    for key in SAVED:
        with suppress(KeyError):
            setattr(item, key, about[key])
    if not about:
        item.save()
    return item


def read_object(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file, or nothing if it cannot be read."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def lock_folder(folder: Path) -> IO[str]:
    """Lock a folder until the file is closed or its process ends. The error about another bench contains its address."""
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


def safe_name(text: str, otherwise: str) -> str:
    """Return a text as a file name, in any script, with its endings. The result is never a path, a hidden or a reserved name."""
    name = unicodedata.normalize("NFC", text.replace("\\", "/").rsplit("/", 1)[-1])
    name = re.sub("-+", "-", "".join(c if c in KEPT or unicodedata.category(c)[0] in "LMN" else "-" for c in name))
    ending = ENDING.search(name)[0]  # type: ignore[index]  # it may be empty
    stem = (
        name.removesuffix(ending).strip("-. ").encode()[: LONGEST - len(ending)].decode(errors="ignore").rstrip("-. ")
    )
    return ("_" if RESERVED.match(stem) else "") + (stem or otherwise) + ending
