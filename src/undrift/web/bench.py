"""State of the bench on the server: connected device, recordings, results, and user input. The pages show it.

commands/bench/library.py describes its folder.
"""

import asyncio
import json
import re
import time
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from undrift.commands.bench.library import Job, Library, read_object
from undrift.commands.bench.source import LiveDevice, PracticeDevice, listened
from undrift.errors import InputError, UndriftError
from undrift.files import write_whole
from undrift.web.commands import CommandOutcome, run_command
from undrift.web.parts import PRACTICE
from undrift.web.place import Site
from undrift.web.recordings import Recordings
from undrift.web.uploads import safe_name

PLACE = "place.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerSettings:
    """Address and folder of the bench."""

    folder: Path  # of everything that it writes
    port: int = 8765  # 0 takes a free one
    token: str | None = None  # required in every request; None for no check on this computer
    upload_mb: float = 500.0  # Largest upload, 1e6 bytes
    practice_seed: int | None = None  # of the practice device; None draws a random seed
    practice_speed: float = 1.0  # of its clock, times real time


@dataclass(slots=True)
class Working:
    """A command that runs now."""

    what: str
    line: str = ""
    began: float = field(default_factory=time.monotonic)
    task: asyncio.Task[CommandOutcome] | None = None

    def words(self) -> str:
        """Return the current task, its duration, and the last line of output."""
        return f"Working: {self.what}, {time.monotonic() - self.began:.0f} s. {self.line}"

    @property
    def share(self) -> float | None:
        """Return the completed share, as reported by the command."""
        percent = re.search(r"\((\d+) %\)$", self.line)
        return percent and float(percent[1]) / 100.0

    def cancel(self) -> None:
        """Cancel the command. Its output is not written."""
        if self.task is not None:
            self.task.cancel()


class Bench:
    """State that all pages share. Its methods run on the server's event loop and never block it."""

    def __init__(self, settings: ServerSettings) -> None:
        self.settings, self.folder = settings, settings.folder
        self.source: LiveDevice | None = None
        self.source_error = ""
        self.connecting = ""  # the address that is being connected
        self.job: Job | None = None  # of the device that is at work
        self.working: list[Working] = []
        self._practice, self.library = PracticeDevice(), Library(self.folder)
        self.place = Site(**read_object(self.folder / PLACE))
        self.visit = Visit(self)

    # ---- The device

    async def connect(self, address: str) -> None:
        """Connect a device in place of the previous device. Errors are stored in ``source_error``."""
        await self.disconnect()
        self.source_error, self.connecting = "", address

        def opened() -> LiveDevice:
            source = LiveDevice(listened(self._address_of(address)))
            source.start()
            return source

        try:
            self.source = await asyncio.to_thread(opened)
        except (UndriftError, OSError) as error:
            self.source_error = str(error)
        finally:
            self.connecting = ""

    async def disconnect(self) -> None:
        """Disconnect the device."""
        await asyncio.to_thread(self._let_go)

    def _let_go(self) -> None:
        source, self.source = self.source, None
        if source is not None:
            source.stop()

    @property
    def practice(self) -> Any:
        """Return the practice device if it is connected."""
        return None if self.source is None else self._practice.device

    def _address_of(self, address: str) -> str:
        """Return an address to connect to. For ``practice``, start the practice device and return its address."""
        s = self.settings
        if address.strip() == PRACTICE:
            return self._practice.start(s.practice_seed, s.practice_speed, self.place.gravity_m_s2)
        self._practice.close()
        return address.strip()

    # ---- The work

    def set_place(self, place: Site) -> None:
        """Set the place of the bench, and store it for the next start."""
        self.place = place
        write_whole(self.folder / PLACE, json.dumps(asdict(place)) + "\n")

    def new_job(self, serial: str = "") -> Job:
        """Create a job with a new folder for another device."""
        stamp, label = datetime.now().strftime("%Y-%m-%d-%H%M%S"), safe_name(serial, "device")
        folder, k = self.folder / "jobs" / f"{stamp}-{label}", 1
        while folder.exists():
            folder, k = self.folder / "jobs" / f"{stamp}-{label}-{k}", k + 1
        folder.mkdir(parents=True)
        self.job = Job(folder=folder, serial=serial)
        self.job.save()
        self.library.jobs.insert(0, self.job)
        return self.job

    async def calibrate(self, job: Job, *words: object) -> CommandOutcome:
        """Run ``undrift calibrate`` for a job: a session, or recordings and options."""
        calibration, report = job.folder / "calibration.json", job.folder / "report.html"
        job.words = self._relative_to_folder(words)
        job.save()
        place = () if _states_gravity(self.folder / job.words[0]) else self.place.words()
        outcome = await self.command("calibrate", *words, *place, "-o", calibration, "--report", report)
        self._take(job, outcome)
        return outcome

    def _take(self, job: Job, outcome: CommandOutcome) -> None:
        job.error = outcome.error
        if outcome.done:
            (job.folder / "certificate.html").unlink(missing_ok=True)  # it was another calibration's
            remarks = {key: outcome.answer.get(key, []) for key in ("findings", "notes")}
            job.answer, job.later = {**outcome.answer["data"], **remarks}, []
            job.look()
        job.save()

    async def command(self, *words: object, folder: Path | None = None) -> CommandOutcome:
        """Run a command of undrift. Pages show its progress."""
        now = Working(str(words[0]))
        self.working.append(now)

        def heard(line: str) -> None:
            now.line = line

        now.task = asyncio.create_task(run_command(self._relative_to_folder(words), folder or self.folder, heard))
        try:
            await asyncio.wait([now.task])
            return CommandOutcome(code=2, error=f"{now.what}: cancelled") if now.task.cancelled() else now.task.result()
        finally:
            now.cancel()
            self.working.remove(now)

    def _relative_to_folder(self, arguments: Sequence[object]) -> tuple[str, ...]:
        """Return the words of a command with files by their paths below the folder, in which it runs."""
        return tuple(str(word).removeprefix(f"{self.folder}/") for word in arguments)

    def inside(self, name: str) -> Path:
        """Return a file of the bench from its path below the folder. Raise InputError for a missing file or a path
        outside.
        """
        root = self.folder.resolve()
        try:
            path = (root / name).resolve()
            exists = path.is_relative_to(root) and path.is_file()
        except (OSError, ValueError, RuntimeError):  # too long, a NUL, a ring of links
            exists = False
        if not exists:
            raise InputError("bench: only files that the bench wrote can be opened. Choose a file on the page Check.")
        return path

    def link(self, path: Path) -> str:
        """Return where the browser finds a file of the bench."""
        return "/files/" + quote(path.resolve().relative_to(self.folder.resolve()).as_posix())

    def close(self) -> None:
        """Close all resources when the server ends."""
        self._let_go()
        self._practice.close()


class Visit:
    """The choices and input of a user. All tabs of a browser share them."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.library = bench, bench.library
        self.address, self.ways = "", dict[str, Any]()  # address entered, and devices found
        self.shown: Job | None = None  # whose result was opened
        self.recordings = Recordings(self)
        self.statement = dict[str, str]()  # of the laboratory, for certificates
        # calibration for correcting files, at first the latest calibration
        self.calibration: Path | None = next((job.calibration for job in self.library.jobs if job.calibration), None)

    async def search(self) -> None:
        """Search for devices and ports."""
        self.ways = (await self.bench.command("record")).answer

    @property
    def job(self) -> Job | None:
        """Return the job whose result is shown: the opened job, or the newest."""
        jobs = (self.shown, *self.library.jobs)
        return next((job.read() for job in jobs if job is not None and job.calibration is not None), None)

    async def calibrate(self, job: Job, *words: object) -> CommandOutcome:
        """Calibrate for a job. Use the result for corrections from now on if it has accelerometers. Otherwise the user
        decides.
        """
        outcome = await self.bench.calibrate(job, *words)
        if outcome.done:
            self.shown = job
            if "accelerometers" not in job.lacks:
                self.calibration = job.calibration
        return outcome


def _states_gravity(path: Path) -> bool:
    """Return True if a session's folder contains local gravity. A recording never does."""
    try:
        head = tomllib.loads((path / "session.toml").read_text(encoding="utf-8"))["session"]
    except (OSError, ValueError, KeyError):
        return False
    return "gravity_m_s2" in head or "latitude_deg" in head
