"""The registry on the page Devices: what the commands ``undrift registry`` answer, and the files that they wrote for it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.web.bench import Bench

FOLDER = "registry"  # of the bench: calibrations, certificates and pictures that were asked for
ENDINGS = {"calibration": ".json", "certificate": ".pdf"}  # of the entries that are files


class Devices:
    """The devices of the registry, and the one that is looked at."""

    def __init__(self, bench: "Bench") -> None:
        self.bench = bench
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
        outcome = await self.bench.command(
            "registry", "trend", f"--serial={serial}", "--figure", picture, *self.bench.registry_words()
        )
        self.serial, self.entries = serial, list(answer.get("entries") or ())
        self.trend = outcome.answer if outcome.done else {}
        self.picture = picture if outcome.done else None
        self.why_no_trend = "" if outcome.done else outcome.error
        self.changes += 1

    async def fetch(self, entry: dict[str, Any]) -> Path | None:
        """Write the file of an entry into the bench's folder."""
        number = int(entry["entry"])
        name = f"{safe_name(str(entry['serial']), 'device')}-{number}{ENDINGS[entry['kind']]}"
        path = self._file(name)
        answer = await self._ask("show", number, "-o", path)
        return None if answer is None else path

    async def use(self, entry: dict[str, Any]) -> None:
        """Let Live and Recordings correct with a calibration."""
        path = await self.fetch(entry)
        if path is not None:
            self.bench.calibration, self.used = path, int(entry["entry"])
        self.changes += 1

    def is_used(self, entry: dict[str, Any]) -> bool:
        """Tell whether the bench corrects with this entry."""
        held = self.bench.calibration
        return self.used == entry["entry"] and held is not None and held.parent.name == FOLDER

    def _file(self, name: str) -> Path:
        folder = self.bench.folder / FOLDER
        folder.mkdir(exist_ok=True)
        return folder / name

    async def _ask(self, *words: object) -> dict[str, Any] | None:
        """Run a command of the registry; what goes wrong stands in ``error``."""
        outcome = await self.bench.command("registry", *words, *self.bench.registry_words())
        self.error = "" if outcome.done else outcome.error
        self.changes += 0 if outcome.done else 1
        return outcome.answer if outcome.done else None


def _urgency(row: dict[str, Any]) -> tuple[int, float, str]:
    """Return what sorts devices: overdue, then by the days that are left, then those without a calibration."""
    days = row.get("days_left")
    return (days is None, 0.0 if days is None else float(days), str(row["serial"]))
