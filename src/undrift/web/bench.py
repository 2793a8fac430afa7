"""The bench: what is connected, what is being recorded, what was made. All of it lives on the server; pages show it.

A folder holds everything that the bench writes::

    jobs/2026-11-23-0915-SERIAL/    session.toml and readings, calibration.json, report.html, certificate.pdf
    uploads/                        files that were dropped on the page Recordings, and what was made of them
    registry/                       calibrations, certificates and pictures that the page Devices asked for
"""

import asyncio
import json
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from undrift.base.options import stated
from undrift.commands.bench.rig_run import PracticeDevice, RigRun
from undrift.errors import InputError, UndriftError
from undrift.files import write_whole
from undrift.web.commands import CommandOutcome, run_command
from undrift.web.devices import Devices
from undrift.web.live import MotionCalibration
from undrift.web.rate_table import RateTablePage
from undrift.web.recordings import Recordings
from undrift.web.start import PRACTICE, Site
from undrift.web.temperature import WarmUpRecording
from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.commands.bench.source import LiveDevice

PLACE = "place.json"
SENSORS = {"accel": "accelerometers", "gyro": "gyroscopes"}
CALLED = "calibrate.json"  # the words that a job was calibrated by


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerSettings:
    """Where the bench listens and writes."""

    folder: Path  # of everything that it writes
    host: str = "127.0.0.1"
    port: int = 8765  # 0 takes a free one
    token: str | None = None  # wanted of every request; None: this computer alone
    registry: str | None = None  # None: the user's own
    upload_mb: float = 500.0  # Largest upload, 1e6 bytes
    practice_seed: int | None = None  # of the practice device; None draws one
    practice_speed: float = 1.0  # of its clock, times real time


@dataclass(slots=True, kw_only=True)
class Job:
    """One device being calibrated: its folder, and what has been captured for it."""

    folder: Path
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


@dataclass(slots=True)
class Working:
    """A command that runs now."""

    what: str
    line: str = ""


class Bench:
    """What all pages share. Its methods are called on the server's event loop; none of them blocks it."""

    def __init__(self, settings: ServerSettings) -> None:
        self.settings, self.folder = settings, settings.folder
        self.source: LiveDevice | None = None
        self.source_error = ""
        self.connecting = ""  # the address that is being connected
        self.rig_run: RigRun | None = None
        self.calibration: Path | None = None  # what Live and Recordings correct with
        self.job: Job | None = None
        self.working: list[Working] = []
        self._practice = PracticeDevice()
        self.recordings, self.devices = Recordings(self), Devices(self)
        for name in ("jobs", "uploads"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        self.table = RateTablePage(self)
        if (run := self.table.take_up()) is not None:  # that an earlier bench left
            self.rig_run, self.job = run, Job(folder=run.folder.parent, serial=run.order.serial)
        self.warm_up, self.motion = WarmUpRecording(self), MotionCalibration(self)
        self.place = Site(**_held_in(self.folder / PLACE))

    # ---- The device

    async def connect(self, address: str) -> None:
        """Connect a device in place of the one before; what goes wrong stands in ``source_error``."""
        from undrift.commands.bench.source import LiveDevice

        await self.disconnect()
        self.source_error, self.connecting = "", address

        def opened() -> LiveDevice:
            source = LiveDevice(self._address_of(address))
            source.start()
            return source

        try:
            self.source = await asyncio.to_thread(opened)
        except (UndriftError, OSError) as error:
            self.source_error = str(error)
        finally:
            self.connecting = ""

    async def disconnect(self) -> None:
        """Let go of the device."""
        source, self.source = self.source, None
        if source is not None:
            file = await asyncio.to_thread(source.stop)
            if file is not None:  # what was being recorded
                await self.recordings.add(file)

    @property
    def practice(self) -> Any:
        """Return the practice device, where it is the one that is connected."""
        return None if self.source is None else self._practice.device

    def _address_of(self, address: str) -> str:
        """Return an address to connect to; that of the practice device, which starts with it, for ``emulator``."""
        s = self.settings
        if address.strip() == PRACTICE:
            return self._practice.start(s.practice_seed, s.practice_speed, self.place.gravity_m_s2)
        self._practice.close()
        return address.strip()

    # ---- The work

    def set_place(self, place: Site) -> None:
        """State where the bench stands; it is kept for the next time."""
        self.place = place
        write_whole(self.folder / PLACE, json.dumps(asdict(place)) + "\n")

    def new_job(self, serial: str = "") -> Job:
        """Begin with another device: a new folder."""
        stamp, named = datetime.now().strftime("%Y-%m-%d-%H%M%S"), safe_name(serial, "device")
        folder, k = self.folder / "jobs" / f"{stamp}-{named}", 1
        while folder.exists():
            folder, k = self.folder / "jobs" / f"{stamp}-{named}-{k}", k + 1
        folder.mkdir(parents=True)
        self.job = Job(folder=folder, serial=serial)
        return self.job

    async def open_job(self, folder: Path, *later: dict[str, Any]) -> None:
        """Take up a job of an earlier day: its calibration, report and certificate; and what commands answered."""
        job = Job(folder=folder, calibration=folder / "calibration.json", later=[*later])
        job.answer = await asyncio.to_thread(_held_in, folder / "calibration.json")
        job.words = tuple(_held_in(folder / CALLED).get("words") or ())
        for name, file in (("report", "report.html"), ("certificate", "certificate.pdf")):
            if (folder / file).is_file():
                setattr(job, name, folder / file)
        self.job = job

    async def calibrate(self, job: Job, *words: object) -> CommandOutcome:
        """Run ``undrift calibrate`` for a job: a session, or recordings and options; the calibration is used from then on."""
        made, report = job.folder / "calibration.json", job.folder / "report.html"
        job.words = self._below(words)
        write_whole(job.folder / CALLED, json.dumps({"words": job.words}) + "\n")
        place = () if _states_gravity(self.folder / job.words[0]) else self.place.words()
        outcome = await self.command("calibrate", *words, *place, "-o", made, "--report", report)
        self._take(job, outcome)
        return outcome

    async def fit_drift(self, job: Job, *words: object) -> CommandOutcome:
        """Run ``undrift drift`` for a job, on top of the calibration that is used; the tables are used from then on."""
        made, report = job.folder / "calibration.json", job.folder / "report.html"
        known = stated(calibration=self.calibration)
        (job.folder / CALLED).unlink(missing_ok=True)  # it is made by other words
        job.words = ()
        outcome = await self.command("drift", *words, *known, "-o", made, "--report", report)
        self._take(job, outcome)
        return outcome

    def _take(self, job: Job, outcome: CommandOutcome) -> None:
        job.error = outcome.error
        if outcome.done:
            job.calibration, job.report = job.folder / "calibration.json", job.folder / "report.html"
            job.answer, job.later, job.certificate, job.registered = outcome.answer, [], None, ""
            if "accelerometers" not in job.lacks:  # a person decides about one without
                self.calibration = job.calibration

    async def command(self, *words: object, folder: Path | None = None) -> CommandOutcome:
        """Run a command of undrift; pages show what it does while it runs."""
        now = Working(" ".join(map(str, words[:2] if str(words[0]) in ("registry", "session", "rig") else words[:1])))
        self.working.append(now)

        def heard(line: str) -> None:
            now.line = line

        try:
            return await run_command(self._below(words), folder or self.folder, heard)
        finally:
            self.working.remove(now)

    def _below(self, words: Sequence[object]) -> tuple[str, ...]:
        """Return the words of a command with files by their paths below the folder, in which it runs."""
        return tuple(str(word).removeprefix(f"{self.folder}/") for word in words)

    def inside(self, name: str) -> Path:
        """Return a file of the bench by its path below the folder; InputError for what is not there, or elsewhere."""
        root = self.folder.resolve()
        try:
            path = (root / name).resolve()
            held = path.is_relative_to(root) and path.is_file()
        except (OSError, ValueError, RuntimeError):  # too long, a NUL, a ring of links
            held = False
        if not held:
            raise InputError("bench: wanted a file that it wrote, got another; choose one on the page Recordings")
        return path

    def link(self, path: Path) -> str:
        """Return where the browser finds a file of the bench."""
        return "/files/" + quote(path.resolve().relative_to(self.folder.resolve()).as_posix())

    def close(self) -> None:
        """Let go of everything; the server ends."""
        self.table.close()
        if self.source is not None:
            self.source.stop()
        self._practice.close()


def _held_in(path: Path) -> dict[str, Any]:
    """Return what a calibration file holds; nothing where it cannot be read."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return held if isinstance(held, dict) else {}


def _states_gravity(path: Path) -> bool:
    """Tell whether a session's folder states local gravity; a recording states none."""
    try:
        head = tomllib.loads((path / "session.toml").read_text(encoding="utf-8"))["session"]
    except (OSError, ValueError, KeyError):
        return False
    return "gravity_m_s2" in head or "latitude_deg" in head
