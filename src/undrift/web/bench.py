"""State of the bench on the server: connected device, files, results, choices and entries. The page displays this state."""

import asyncio
import json
import re
import secrets
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

from nicegui.elements.upload_files import FileUpload

from undrift.base.codec import toml_text
from undrift.base.spoken import calling, spoken
from undrift.commands.bench.source import LiveDevice, PracticeDevice, connected, found_devices
from undrift.commands.calibrate import calibrate
from undrift.commands.certificate import Statement, certificate
from undrift.commands.correct import correct
from undrift.commands.files import Place, states_gravity
from undrift.commands.info import Looked, look_at
from undrift.commands.orient import orient
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.record import check_local_gravity
from undrift.report.page import page_text
from undrift.report.report import Report
from undrift.screen import Screen, showing_on
from undrift.web.guided import Guided
from undrift.web.items import ARRIVING, CALIBRATION, MAP, Item, items_in, read_object, safe_name

PLACE, PRACTICE = "place.json", "practice"
INTERNAL = re.compile(r"\b(?:uploads|jobs)/[^/\s\"]+/(?:session/)?")  # folders that are removed from messages
WORDS = {  # words of the page for the parameters of commands
    "column_map": "the columns and units", "sample_rate_hz": "the samples per second", "turn_deg": "the angle of each turn",
    "sensor": "the sensor", "serial": "the serial number", "calibration": "the calibration", "latitude_deg": "the latitude",
    "height_m": "the height", "gravity_m_s2": "the gravity of the place", "calibrate_from": '"Other ways":',
    "offset": '"Gyroscope offset to subtract":', "forward": "the side that points forward", "up": "the side that points up",
}  # fmt: skip
Value = TypeVar("Value")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerSettings:
    """Address and folder of the bench."""

    folder: Path  # folder of everything that the bench writes
    port: int = 8765  # 0 selects a free port
    token: str | None = None  # token required in every request, or None for no check
    upload_mb: float = 500.0  # largest total size of files sent together, 1e6 bytes


class Work(Screen):
    """Progress of a command. A cancelled command ends at its next progress report, and does not write output."""

    def __init__(self, name: str) -> None:
        self.name, self.task, self.share, self.cancelled = name, "starting", 0.0, False
        self._start_s = time.monotonic()

    def progress(self, task: str, share: float) -> None:
        self.task, self.share = task, share
        if self.cancelled:
            raise InputError(f"{self.name}: cancelled. Nothing was written.")

    def ask(self, line: str) -> str:
        raise EOFError

    @property
    def text(self) -> str:
        """Return the task and the duration so far."""
        return f"{self.name}: {self.task}, {time.monotonic() - self._start_s:.0f} s"


class Bench:
    """State that all tabs share. Its methods run on the server's event loop and never block it."""

    def __init__(self, settings: ServerSettings) -> None:
        self.settings, self.folder = settings, settings.folder
        self.items = items_in(self.folder)
        self.chosen: Item | None = None
        self.step = "Readings"
        self.source: LiveDevice | None = None
        self.found = list[tuple[str, str]]()  # addresses of devices, with a description
        self.guided: Guided | None = None
        self.work: Work | None = None
        self.errors = dict[str, str]()  # errors by the button that caused them
        self.version = 0  # number of changes; pages are redrawn after each change
        self.place = Place(**read_object(self.folder / PLACE))
        self.calibration = next((item.calibration for item in self.items if item.calibration), None)
        self.typed: dict[str, Any] = {"address": "", "offset": "none", "format": ".csv", "forward": "", "up": ""}
        self._hand_held: PracticeDevice | None = None  # the practice device, if it was started
        self._one = asyncio.Lock()

    def changed(self) -> None:
        """Redraw all pages."""
        self.version += 1

    def go(self, step: str) -> None:
        """Open a step."""
        if step != self.step:
            self.step = step
            self.changed()

    async def call(self, name: str, function: Callable[..., Value], *values: Any, **options: Any) -> Value:
        """Run a function in a thread, one at a time. Pages show its progress."""
        async with self._one:
            self.work = work = Work(name)
            self.changed()

            def run() -> Value:
                with showing_on(work):
                    return function(*values, **options)

            try:
                return await asyncio.to_thread(run)
            finally:
                self.work = None
                self.changed()

    def plain(self, text: str) -> str:
        """Return a text without folders of the bench, and with parameters in the words of the page."""
        with calling(WORDS):
            return self._without_folders(spoken(text))

    def _without_folders(self, text: str) -> str:
        return INTERNAL.sub("", text.replace(f"{self.folder}/", ""))

    # ---- The device

    async def connect(self, address: str) -> None:
        """Connect a device, which replaces the previous one, and begin a guided recording."""
        await self.disconnect()
        self.source = await self.call("Connecting", lambda: connected(self._address_of(address.strip())))
        self.begin()

    def _address_of(self, address: str) -> str:
        """Return an address. Start the practice device if it is requested, and stop it otherwise."""
        if address != PRACTICE:
            self._stop_practice()
            return address
        if self._hand_held is None:
            self._hand_held = PracticeDevice(self.place.gravity[0])
        return self._hand_held.address

    def _stop_practice(self) -> None:
        if self._hand_held is not None:
            self._hand_held.close()
        self._hand_held = None

    @property
    def practice(self) -> PracticeDevice | None:
        """Return the practice device if it is connected."""
        return None if self.source is None else self._hand_held

    async def search(self) -> None:
        """Search for serial ports and LSL streams."""
        self.found, notes = await self.call("Looking", found_devices)
        if not self.found:
            raise InputError(" ".join(["No device was found. Connect it, switch it on, and look again.", *notes]))

    def begin(self) -> None:
        """Begin a guided recording with the connected device. An earlier recording keeps its folder."""
        if self.source is None:
            return
        stamp = f"{datetime.now():%Y-%m-%d-%H%M%S-%f}-{safe_name(self.source.name, 'device')}"
        (folder := self.folder / "jobs" / stamp).mkdir(parents=True)
        item = Item(folder=folder, path=folder / "session", kind="session", serial=self.source.name)
        self.guided = Guided(self, item)
        self._added(item)

    async def disconnect(self) -> None:
        """Disconnect the device."""
        source, self.source = self.source, None
        if source is not None:
            await asyncio.to_thread(source.stop)
        self.changed()

    def close(self) -> None:
        """Close all resources when the server ends."""
        if self.source is not None:
            self.source.stop()
        self._stop_practice()

    # ---- Files

    async def receive(self, files: Sequence[FileUpload]) -> None:
        """Store files that a browser sent together, and add them. Incomplete files are never kept."""
        paths = list[Path]()
        for file in files:
            name = safe_name(file.name, "recording")
            folder = self.folder / "uploads" / secrets.token_hex(6)  # names may repeat
            await file.save(folder / ARRIVING)
            paths.append((folder / ARRIVING).rename(folder / name))
        await self.add(paths)

    async def add(self, paths: Sequence[Path]) -> None:
        """Add files that were sent together: as one recording if they form one, such as a phone export, otherwise each
        separately."""
        if len(paths) > 1:
            together = paths[0].parent / "files"
            together.mkdir()
            moved = [path.rename(together / path.name) for path in paths if not (together / path.name).exists()]
            with suppress(InputError):
                item = Item(folder=together.parent, path=together)
                await self._look(item)
                if item.kind == "recording":
                    for path in paths[1:]:
                        with suppress(OSError):
                            path.parent.rmdir()
                    self._added(item)
                    return
            for path, source in zip(moved, paths, strict=False):
                path.rename(source)
            together.rmdir()
        for path in paths:
            self._added(Item(folder=path.parent, path=path))
            await self.choose(self.items[0])

    def _added(self, item: Item) -> None:
        item.save()
        self.items.insert(0, item)
        self._show(item, "Check")

    def _show(self, item: Item, step: str) -> None:
        self.chosen, self.step = item, step
        self.errors.clear()
        self.changed()

    async def choose(self, item: Item) -> None:
        """Choose a file, and read it unless it has been read already."""
        self._show(item, "Calibrate" if item.page("calibrate") else "Check")
        if item.looked is None and item.kind != "session":
            try:
                await self._look(item)
            except InputError as error:
                item.summary = self.plain(str(error))
                item.save()
                self.changed()

    async def open_newest(self) -> None:
        """Open the newest file or recording, for example after a restart."""
        if self.items:
            await self.choose(self.items[0])

    async def _look(self, item: Item) -> None:
        def look() -> Looked:
            looked = look_at(item.path, item.opening)
            self._keep(item, "info", looked.report)
            return looked

        item.looked = looked = await self.call("Reading", look)
        item.kind, item.summary = looked.kind, self.plain(looked.summary)
        item.serial = item.serial or looked.serial or item.path.name.partition(".")[0]
        item.draft = looked.draft or item.draft
        if item.kind == "calibration":
            self.calibration = item.path
        item.save()
        self.changed()

    async def read_again(self, item: Item) -> None:
        """Read a file with the columns, units or rate that a person entered."""
        unknown = [key for key, unit in item.draft.get("units", {}).items() if unit == "?"]
        if unknown:
            raise InputError(f"Choose the unit of {' and '.join(unknown)}. The data sheet of the device gives it.")
        if item.draft.get("sample_rate_hz") == "?":
            raise InputError("Enter the samples per second. You find them in its data sheet or settings.")
        if item.draft:
            write_whole(item.folder / MAP, toml_text(item.draft))
        await self._look(item)

    def inside(self, name: str) -> Path:
        """Return a file of the bench from its path below the folder. Raise InputError for any other path."""
        root = self.folder.resolve()
        try:
            path = (root / name).resolve()
            exists = path.is_relative_to(root) and path.is_file()
        except (OSError, ValueError, RuntimeError):  # path too long, NUL character, or circular links
            exists = False
        if not exists:
            raise InputError("bench: only files that the bench wrote can be opened. Choose a file on the page.")
        return path

    def link(self, path: Path) -> str:
        """Return the address of a file of the bench in the browser."""
        return "/files/" + quote(path.resolve().relative_to(self.folder.resolve()).as_posix())

    @property
    def calibrations(self) -> dict[Path, str]:
        """Return the calibrations by file, the newest first."""
        return {item.calibration: f"{item.serial} ({item.arrival})" for item in self.items if item.calibration}

    # ---- Results

    def set_place(self, place: Place) -> None:
        """Set the place of the bench, and store it for the next start."""
        check_local_gravity(place.gravity[0], "place")
        self.place = place
        write_whole(self.folder / PLACE, json.dumps(asdict(place)) + "\n")

    async def calibrate(self, item: Item, *, motion: bool = False, accel_only: bool = False) -> None:
        """Calibrate from the rests and turns of a recording, or from its motion, and use the calibration from now on."""
        place = replace(self.place, serial=item.serial.strip())
        if item.kind == "session":  # a session contains its serial number, and perhaps gravity
            place = Place() if states_gravity(item.path) else self.place
        output = item.folder / CALIBRATION
        options: dict[str, Any] = {"calibrate_from": "motion"} if motion else {"turn_deg": item.turn_deg}
        if accel_only:
            options = {"gyro": "none"}
        await self._run(item, calibrate, item.path, place=place, opening=item.opening, output=output, **options)
        (item.folder / "certificate.html").unlink(missing_ok=True)
        self.calibration = output

    async def certify(self, item: Item, statement: Statement) -> None:
        """Write the certificate with the entries of the laboratory."""
        await self._run(
            item, certificate, item.calibration, output=item.folder / "certificate.html", statement=statement
        )

    async def correct(self, item: Item) -> None:
        """Correct a recording."""
        output = item.folder / f"{self._base(item)}-corrected{self.typed['format']}"
        await self._run(
            item, correct, item.path, calibration=self.calibration, output=output, offset=self.typed["offset"],
            opening=item.opening,
        )  # fmt: skip

    async def orient(self, item: Item) -> None:
        """Compute the orientation of a recording."""
        output = item.folder / f"{self._base(item)}-angles{self.typed['format']}"
        await self._run(
            item, orient, item.path, calibration=self.calibration, output=output, offset=self.typed["offset"],
            forward=self.typed["forward"] or None, up=self.typed["up"] or None, opening=item.opening,
        )  # fmt: skip

    def _base(self, item: Item) -> str:
        return safe_name(item.path.name.split(".")[0], "recording")

    async def _run(self, item: Item, command: Callable[..., Report], *values: Any, **options: Any) -> None:
        """Run a command, and keep its report."""
        item.save()  # keep the entries of the person

        def run() -> None:
            self._keep(item, command.__name__, command(*values, **options))

        await self.call(command.__name__.capitalize(), run)

    def _keep(self, item: Item, command: str, report: Report) -> None:
        """Store the report of a command as a page. A certificate is already a page."""
        item.reports[command] = report
        if command != "certificate":
            with calling(WORDS):
                text = page_text(replace(report, next_command=(), written=()))
            write_whole(item.folder / f"{command}.html", self._without_folders(text))
