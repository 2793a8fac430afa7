"""The page Registry: which are known to the registry, what is due, what each one's calibrations were, and how it changed.

It shows what the commands ``undrift registry`` answer; the files that they wrote for it stand in a folder of the bench.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui

from undrift.base.options import stated
from undrift.web import parts
from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.web.bench import Visit

FOLDER = "registry"  # of the bench: calibrations, certificates and pictures that were asked for
ENDINGS = {"calibration": ".json", "certificate": ".pdf"}  # of the entries that are files
SOON_DAYS = 30


class Devices:
    """The devices of the registry, and the one that is looked at."""

    def __init__(self, visit: "Visit") -> None:
        self.visit, self.bench = visit, visit.bench
        self.rows: list[dict[str, Any]] | None = None  # None: not asked yet
        self.serial = ""  # of the device that is looked at
        self.entries: list[dict[str, Any]] = []
        self.trend: dict[str, Any] = {}
        self.why_no_trend = ""
        self.picture: Path | None = None
        self.error = ""
        self.used: int | None = None  # entry of the calibration that the bench uses
        self.changes = 0  # pages draw anew when it counts on

    @property
    def chosen(self) -> dict[str, Any] | None:
        """Return the row of the device that is looked at."""
        return next((row for row in self.rows or () if row["serial"] == self.serial), None)

    async def load(self) -> None:
        """Ask which devices there are, the most urgent first, and again what is looked at."""
        place = self.bench.settings.registry
        if place is not None and "://" not in place and not Path(place).exists():
            self.rows = []  # made when the first result is registered
        elif (answer := await self._ask("list")) is not None:
            self.rows = sorted(answer.get("devices") or (), key=_urgency)
            if self.chosen is not None:
                await self.choose(self.serial)
        self.changes += 1

    async def choose(self, serial: str) -> None:
        """Look at a device: its entries, and how it changed."""
        answer = await self._ask("list", f"--serial={serial}")
        if answer is None:
            return
        picture = self._file(f"trend-{safe_name(serial, 'device')}.svg")
        words = stated(figure=picture, registry=self.bench.settings.registry)
        outcome = await self.bench.command("registry", "trend", f"--serial={serial}", *words)
        self.serial, self.entries = serial, list(answer.get("entries") or ())
        self.trend = outcome.answer if outcome.done else {}
        self.picture = picture if outcome.done else None
        self.why_no_trend = outcome.error
        self.changes += 1

    async def fetch(self, entry: dict[str, Any]) -> Path | None:
        """Write the file of an entry into the bench's folder."""
        number = int(entry["entry"])
        path = self._file(f"{safe_name(str(entry['serial']), 'device')}-{number}{ENDINGS[entry['kind']]}")
        answer = await self._ask("show", number, "-o", path)
        return None if answer is None else path

    async def use(self, entry: dict[str, Any]) -> None:
        """Correct files and live readings with a calibration."""
        path = await self.fetch(entry)
        if path is not None:
            self.visit.calibration, self.used = path, int(entry["entry"])
        self.changes += 1

    def is_used(self, entry: dict[str, Any]) -> bool:
        """Tell whether the bench corrects with this entry."""
        calibration = self.visit.calibration
        return self.used == entry["entry"] and calibration is not None and calibration.parent.name == FOLDER

    def _file(self, name: str) -> Path:
        folder = self.bench.folder / FOLDER
        folder.mkdir(exist_ok=True)
        return folder / name

    async def _ask(self, *words: object) -> dict[str, Any] | None:
        """Run a command of the registry; what goes wrong stands in ``error``."""
        outcome = await self.bench.command("registry", *words, *stated(registry=self.bench.settings.registry))
        self.error = outcome.error
        self.changes += 0 if outcome.done else 1
        return outcome.answer if outcome.done else None


def _urgency(row: dict[str, Any]) -> tuple[int, float, str]:
    """Return what sorts devices: overdue, then by the days that are left, then those without a calibration."""
    days = row.get("days_left")
    return (days is None, 0.0 if days is None else float(days), str(row["serial"]))


# ---- The page


def page(visit: "Visit") -> None:
    """Build the page."""
    devices, client = visit.devices, ui.context.client
    parts.error_line(lambda: devices.error)
    parts.redrawn(lambda: (devices.changes, visit.calibration), lambda: _shown(devices, client))
    ui.timer(0.05, devices.load, once=True)


def _shown(devices: Devices, client: Any) -> None:
    if devices.rows is None:
        parts.text("p", "Loading ...", "soft")
        return
    if not devices.rows:
        parts.text("p", "No device is registered yet. Calibrate one, then register it on the page Calibrate.")
        parts.next_step("Calibrate a device", "/")
        return
    heads = ("device", "state", "calibrated", "due", "entries")
    rows = [_device_cells(devices, row) for row in devices.rows]
    parts.table("Devices, the most urgent first", heads, lambda: rows, devices.choose)
    if devices.chosen is None:
        first = devices.rows[0]["serial"]
        parts.next_step(f"Show {first}", partial(devices.choose, first))
    else:
        _device(devices, devices.chosen, client)


def state_words(row: dict[str, Any]) -> tuple[str, str]:
    """Return in words whether a device is due, and the class of their colour."""
    days = row.get("days_left")
    if days is None:
        return ("no calibration", "bad") if row["calibration"] is None else ("valid", "good")
    if days < 0:
        return f"overdue by {-days} days", "bad"
    return (f"due in {days} days", "marginal") if days < SOON_DAYS else (f"valid, {days} days left", "good")


def _device_cells(devices: Devices, row: dict[str, Any]) -> Sequence[object]:
    serial, calibration = row["serial"], row["calibration"] or {}
    days = [_day(calibration, name) for name in ("made_at", "due_at")]
    choose = ["", "", [[serial, serial, "", serial == devices.serial]]]
    return [choose, state_words(row), *days, str(row["entries"])]


def _device(devices: Devices, row: dict[str, Any], client: Any) -> None:
    parts.text("h2", f"Device {row['serial']}")
    calibration = row["calibration"]
    if calibration is None or (row.get("days_left") or 0) < 0:
        parts.next_step("Calibrate it", "/")
    elif devices.is_used(calibration):
        parts.status_line(f"Files and live readings use entry {calibration['entry']}.", "")
        parts.next_step("Correct recordings", "/use")
    else:
        parts.next_step("Use this calibration", partial(devices.use, calibration))
    _trend(devices)
    parts.text("h2", "Entries")
    heads = ("entry", "file", "made", "due", "valid, °C", "verdict", "by", "note")
    rows = [_entry_cells(devices, entry) for entry in reversed(devices.entries)]

    async def press(key: str) -> None:
        what, number = key.split()
        entry = next(one for one in devices.entries if str(one["entry"]) == number)
        if what == "use":
            await devices.use(entry)
        elif (path := await devices.fetch(entry)) is not None:
            client.download(devices.bench.link(path) + "?download=1", path.name)

    parts.table(f"Entries of {row['serial']}, the newest first", heads, lambda: rows, press)


def _entry_cells(devices: Devices, entry: dict[str, Any]) -> Sequence[object]:
    span, later, number, kind = (entry[name] for name in ("valid_temp_c", "superseded_by", "entry", "kind"))
    buttons = [["Download", f"download {number}", f"Download entry {number}"]] if kind in ENDINGS else []
    used = devices.is_used(entry)
    if kind == "calibration" and not (later or used) and entry["verdict"] != "bad":
        buttons.append(["Use", f"use {number}", f"Use entry {number}"])
    days, note = [_day(entry, name) for name in ("made_at", "due_at")], f"superseded by {later}" if later else ""
    valid, verdict = "–" if span is None else f"{span[0]:.1f} to {span[1]:.1f}", str(entry["verdict"] or "–")
    notes = ["; ".join(filter(None, (note, str(entry["note"])))), "records-note"]
    made = [f"{number} {kind}", ["in use" if used else "", "good", buttons], *days]
    return [*made, valid, verdict, str(entry["added_by"]), notes]


def _trend(devices: Devices) -> None:
    parts.text("h2", "Has it changed?")
    if not devices.trend:
        compared = devices.why_no_trend.partition("wanted two calibrations")[1]
        parts.text("p", "Two calibrations are needed to compare." if compared else devices.why_no_trend, "soft")
        return
    headline, last = str(devices.trend["headline"]), devices.trend["steps"][-1]
    parts.text("p", _sentence(headline))
    if others := [words for words in last["sentences"] if words != headline]:
        with parts.folded(f"{len(others)} more"), ui.element("ul"):
            for words in others:
                parts.text("li", _sentence(words))
    parts.picture(devices.picture)
    with parts.folded(f"Every parameter since {last['since']['made_at'][:10]}"):
        keys = {"change": "+.3g", "uncertainty": ".2g", "unit": "", "sigmas": ".1f"}
        rows = [
            [f"{one['sensor']} {one['parameter']}", *(format(one[key], how) for key, how in keys.items())]
            for one in last["changes"]
        ]
        heads = ("parameter", "change", "uncertainty", "unit", "sigma")
        parts.table("Changes with their standard uncertainty", heads, lambda: rows)
        for words in last["not_compared"]:
            parts.text("p", f"Not compared: {words}.", "soft")


def _day(entry: dict[str, Any], name: str) -> str:
    return str(entry.get(name) or "–")[:10]


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."
