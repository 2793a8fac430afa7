"""The bench: what is connected, recorded and made, on the server; pages show it. commands/bench/library.py has its folder."""

import asyncio
import json
import re
import time
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from undrift.base.options import stated
from undrift.commands.bench.library import Entry, Job, KnownDevice, Library, read_object
from undrift.commands.bench.rig_run import PracticeDevice, RigRun
from undrift.errors import InputError, UndriftError
from undrift.files import write_whole
from undrift.web.commands import CommandOutcome, run_command
from undrift.web.devices import Devices
from undrift.web.live import MotionCalibration, MotionForm
from undrift.web.parts import PRACTICE
from undrift.web.place import Site
from undrift.web.rate_table import ProtocolForm, RateTablePage
from undrift.web.recordings import Recordings
from undrift.web.temperature import WarmUpRecording
from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.commands.bench.source import LiveDevice

PLACE = "place.json"
MOST_VISITS = 200  # tabs that are remembered


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerSettings:
    """Where the bench listens and writes."""

    folder: Path  # of everything that it writes
    host: str = "127.0.0.1"
    port: int = 8765  # 0 takes a free one
    token: str | None = None  # wanted of every request; None: of nobody on this computer
    registry: str | None = None  # None: the user's own
    upload_mb: float = 500.0  # Largest upload, 1e6 bytes
    quota_gb: float = 20.0  # Largest folder, 1e9 bytes
    practice_seed: int | None = None  # of the practice device; None draws one
    practice_speed: float = 1.0  # of its clock, times real time


@dataclass(slots=True)
class Working:
    """A command that runs now."""

    what: str
    line: str = ""
    began: float = field(default_factory=time.monotonic)
    task: asyncio.Task[CommandOutcome] | None = None

    def words(self) -> str:
        """Say what is done, for how long, and its last line."""
        return f"Working: {self.what}, {time.monotonic() - self.began:.0f} s. {self.line}"

    @property
    def share(self) -> float | None:
        """Return how much of it is done, as the command states it."""
        percent = re.search(r"\((\d+) %\)$", self.line)
        return percent and float(percent[1]) / 100.0

    def cancel(self) -> None:
        """End it; what it was to write is not there."""
        if self.task is not None:
            self.task.cancel()


class Bench:
    """What all pages share. Its methods are called on the server's event loop; none of them blocks it."""

    def __init__(self, settings: ServerSettings) -> None:
        self.settings, self.folder = settings, settings.folder
        self.source: LiveDevice | None = None
        self.source_error = ""
        self.connecting = ""  # the address that is being connected
        self.rig_run: RigRun | None = None
        self.job: Job | None = None  # of the device or the table that is at work
        self.device = ""  # whose readings come: name of its folder
        self.working: list[Working] = []
        self._practice, self.library = PracticeDevice(), Library(self.folder, settings.quota_gb)
        self.table = RateTablePage(self)
        if (run := self.table.take_up()) is not None:  # that an earlier bench left
            self.rig_run, self.job = run, self.job_in(run.folder.parent)
        self.warm_up, self.motion = WarmUpRecording(self), MotionCalibration(self)
        self.place = Site(**read_object(self.folder / PLACE))
        self._visits: dict[str, Visit] = {}

    def visit(self, tab: str) -> "Visit":
        """Return what a tab of a browser has chosen and typed."""
        visit = self._visits.pop(tab, None) or Visit(self)
        self._visits[tab] = visit  # the last one
        while len(self._visits) > MOST_VISITS:
            del self._visits[next(iter(self._visits))]
        return visit

    # ---- The device

    async def connect(self, address: str) -> None:
        """Connect a device in place of the one before; what goes wrong stands in ``source_error``."""
        from undrift.commands.bench.source import LiveDevice, listened

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
        """Let go of the device."""
        await asyncio.to_thread(self._let_go)

    def _let_go(self) -> None:
        source, self.source = self.source, None
        file = None if source is None else source.stop()
        if file is not None and file.parents[1] == self.folder / "uploads":  # what was being recorded
            self.library.file_at(file, self.device)

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

    def new_job(self, serial: str = "", device: str = "") -> Job:
        """Begin with another device: a new folder."""
        stamp, named = datetime.now().strftime("%Y-%m-%d-%H%M%S"), safe_name(serial, "device")
        folder, k = self.folder / "jobs" / f"{stamp}-{named}", 1
        while folder.exists():
            folder, k = self.folder / "jobs" / f"{stamp}-{named}-{k}", k + 1
        self.library.check_room()
        folder.mkdir(parents=True)
        self.job = Job(folder=folder, serial=serial, device=device or self.device)
        self.job.save()
        self.library.jobs.insert(0, self.job)
        return self.job

    def job_in(self, folder: Path) -> Job | None:
        """Return the job of a folder; None where there is none."""
        return next((job for job in self.library.jobs if job.folder == folder), None)

    def delete(self, entry: Entry) -> None:
        """Delete a file or a job that nothing uses now, and let go of it in every tab."""
        file = None if self.source is None else self.source.status().file
        busy = self.rig_run is not None and self.rig_run.may_move and entry.folder in self.rig_run.folder.parents
        if self.working or busy or (file is not None and entry.folder in file.parents):
            raise InputError(f"{entry.name}: wanted to delete it at rest, got work that goes on; wait for its end")
        self.library.delete(entry)
        self.job = None if self.job is entry else self.job
        for visit in self._visits.values():
            visit.forget(entry)

    async def calibrate(self, job: Job, *words: object) -> CommandOutcome:
        """Run ``undrift calibrate`` for a job: a session, or recordings and options."""
        made, report = job.folder / "calibration.json", job.folder / "report.html"
        job.words = self._below(words)
        job.save()
        place = () if _states_gravity(self.folder / job.words[0]) else self.place.words()
        outcome = await self.command("calibrate", *words, *place, "-o", made, "--report", report)
        self._take(job, outcome)
        return outcome

    async def fit_drift(self, job: Job, known: Path | None, *words: object) -> CommandOutcome:
        """Run ``undrift drift`` for a job, on top of a known calibration."""
        made, report = job.folder / "calibration.json", job.folder / "report.html"
        job.words = ()  # it is made by other words
        outcome = await self.command("drift", *words, *stated(calibration=known), "-o", made, "--report", report)
        self._take(job, outcome)
        return outcome

    def _take(self, job: Job, outcome: CommandOutcome) -> None:
        job.error = outcome.error
        if outcome.done:
            (job.folder / "certificate.pdf").unlink(missing_ok=True)  # it was another calibration's
            job.answer, job.later, job.registered = outcome.answer, [], ""
            job.look()
        job.save()

    async def command(self, *words: object, folder: Path | None = None) -> CommandOutcome:
        """Run a command of undrift; pages show what it does while it runs."""
        now = Working(" ".join(map(str, words[:2] if str(words[0]) in ("registry", "session", "rig") else words[:1])))
        self.working.append(now)

        def heard(line: str) -> None:
            now.line = line

        now.task = asyncio.create_task(run_command(self._below(words), folder or self.folder, heard))
        try:
            await asyncio.wait([now.task])
            return CommandOutcome(code=2, error=f"{now.what}: cancelled") if now.task.cancelled() else now.task.result()
        finally:
            now.cancel()
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
            raise InputError("bench: wanted a file that it wrote, got another; choose one on the page Check")
        return path

    def link(self, path: Path) -> str:
        """Return where the browser finds a file of the bench."""
        return "/files/" + quote(path.resolve().relative_to(self.folder.resolve()).as_posix())

    def close(self) -> None:
        """Let go of everything; the server ends."""
        self.table.close()
        self._let_go()
        self._practice.close()


class Visit:
    """What one tab of a browser has chosen and typed; files, jobs, the device and the table are those of the bench."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.library = bench, bench.library
        self.key, self.at_home = "", True  # of the device's folder; whether it shows the page of all devices
        self.address, self.ways = "", dict[str, Any]()  # typed; what was found that can be connected
        self.calibration: Path | None = None  # that files are corrected with
        self.corrected: tuple[object, object] = (None, None)  # device, and what this tab last corrected it with
        self.shown: Job | None = None  # whose result was opened
        self.recordings, self.devices, self.motion = Recordings(self), Devices(self), MotionForm()
        self.addresses, self.filled = replace(bench.table.addresses), 0  # the latter: how often by other than typing
        self.rates, self.soaks = ProtocolForm(), ProtocolForm(name="temperature", axes=(), temperatures_c="20, 35, 50")
        self.speed = "1"  # of the emulated table
        self.statement = dict[str, str]()  # of the laboratory, for certificates

    @property
    def device(self) -> KnownDevice | None:
        """Return the device whose pages this tab shows."""
        return next((one for one in self.library.devices if one.folder.name == self.key), None)

    def enter(self, device: KnownDevice | None) -> KnownDevice | None:
        """Go to the pages of a device: its files, and the calibration that was made last."""
        key = "" if device is None else device.folder.name
        if key != self.key:
            self.key, self.shown, self.recordings.chosen = key, None, None
            self.calibration = next((job.calibration for job in self.jobs if device and job.calibration), None)
        return device

    def begun(self) -> KnownDevice:
        """Return the device whose pages this tab shows, a new one where there is none."""
        if (device := self.device) is None:
            device = self.library.new_device()
            self.key = device.folder.name
        return device

    async def search(self) -> None:
        """Look for devices and ports that can be connected."""
        self.ways, self.filled = (await self.bench.command("record")).answer, self.filled + 1

    async def connect(self, address: str) -> str | None:
        """Connect the device by an address; its serial number is what it states."""
        device = self.begun()
        self.bench.device = self.key
        await self.bench.connect(address)
        if (source := self.bench.source) is None:
            return None
        if (stated := source.recorder.source.description.device) and not device.serial:
            device.serial = stated
            device.save()
        return "/readings" if self.at_home else None

    @property
    def jobs(self) -> list[Job]:
        """Return the jobs of the device, the newest first, and those of no device."""
        return [job for job in self.library.jobs if job.device in (self.key, "")]

    @property
    def job(self) -> Job | None:
        """Return the job whose result is shown: the one that was opened, or the newest of the device."""
        jobs = (self.shown, *self.jobs)
        return next((job.read() for job in jobs if job is not None and job.calibration is not None), None)

    async def calibrate(self, job: Job, *words: object) -> CommandOutcome:
        """Calibrate for a job, and take the result."""
        return self.take(job, await self.bench.calibrate(job, *words))

    def take(self, job: Job, outcome: CommandOutcome) -> CommandOutcome:
        """Show the result of a job, and correct with it from now on; a person decides about one without accelerometers."""
        if outcome.done:
            self.shown = job
            if "accelerometers" not in job.lacks:
                self.calibration = job.calibration
        return outcome

    def forget(self, entry: Entry) -> None:
        """Let go of what was deleted."""
        if self.calibration is not None and entry.folder in self.calibration.parents:
            self.calibration = None
        self.shown = None if self.shown is entry else self.shown
        if self.recordings.chosen is entry:
            self.recordings.chosen = None


def _states_gravity(path: Path) -> bool:
    """Tell whether a session's folder states local gravity; a recording states none."""
    try:
        head = tomllib.loads((path / "session.toml").read_text(encoding="utf-8"))["session"]
    except (OSError, ValueError, KeyError):
        return False
    return "gravity_m_s2" in head or "latitude_deg" in head
