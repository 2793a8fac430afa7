"""Files on the page Recordings: what each holds, the map it needs, and what the commands made of it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undrift.web.commands import Outcome, Remark, remarks_of
from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.web.bench import Bench, Job

UNITS = {"gyro": ("rad/s", "dps", "count", "v"), "accel": ("m/s2", "g", "mg", "count", "v")}


@dataclass(slots=True, kw_only=True)
class Stored:
    """One file that was sent to the bench."""

    path: Path
    about: dict[str, Any] = field(default_factory=dict)  # what `info` says of it
    map: Path | None = None
    sample_rate_hz: float | None = None  # that a person stated, of a file without time
    picture: Path | None = None
    made: dict[str, Path] = field(default_factory=dict)  # label -> file
    remarks: dict[str, list[Remark]] = field(default_factory=dict)  # what each command noticed
    error: str = ""

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
        rate = () if self.sample_rate_hz is None else ("--sample-rate-hz", self.sample_rate_hz)
        return rate if self.map is None else ("--map", self.map, *rate)


class Recordings:
    """The files of a bench, and the commands that are run on them."""

    def __init__(self, bench: "Bench") -> None:
        self.bench = bench
        self.files: list[Stored] = []
        self.chosen: Stored | None = None
        self.axes = {"forward": "", "up": ""}  # sides of the device on the upright segment; "": not chosen

    async def add(self, path: Path) -> Stored:
        """Take up a file that has been stored, and ask what it holds."""
        held = Stored(path=path)
        self.files.append(held)
        self.chosen = held
        await self.look(held)
        if held.kind == "calibration":
            self.bench.calibration = path
        return held

    async def look(self, held: Stored) -> None:
        """Ask what a file holds; draw it where it is a recording."""
        outcome = await self.bench.command("info", held.path, *held.options())
        held.about, held.error = (outcome.answer, "") if outcome.done else ({}, outcome.error)
        held.remarks = {"info": [one for one in remarks_of(held.about) if one.text != held.about.get("summary")]}
        if held.kind == "recording":
            picture = held.path.parent / "recording.svg"
            drawn = await self.bench.command("info", held.path, *held.options(), "--figure", picture)
            held.picture = picture if drawn.done and picture.exists() else None

    async def state_rate(self, held: Stored, sample_rate_hz: float) -> None:
        """State the sample rate of a file without time."""
        held.sample_rate_hz = sample_rate_hz
        await self.look(held)

    async def write_map(self, held: Stored, *, sample_rate_hz: float | None, units: dict[str, str]) -> None:
        """Write the map of a foreign table, with the units that a person confirmed."""
        path = held.path.parent / "map.toml"
        words: list[object] = ["--write-map", path]
        words += [] if sample_rate_hz is None else ["--sample-rate-hz", sample_rate_hz]
        words += [word for name, unit in units.items() if unit for word in (f"--{name}-unit", unit)]
        outcome = await self.bench.command("info", held.path, *words)
        held.error = "" if outcome.done else outcome.error
        if outcome.done:
            held.map = path
            held.made["map"] = path
            await self.look(held)

    async def calibrate(self, held: Stored, *, turn_deg: float | None, serial: str) -> bool:
        """Calibrate from a recording; the result is the bench's job."""
        job: Job = self.bench.new_job(serial or held.path.stem)
        words: list[object] = [held.path, *held.options()]
        words += [] if turn_deg is None else ["--turn-deg", turn_deg]
        outcome = await self.bench.calibrate(job, *words, *(("--serial", serial) if serial else ()))
        held.error = "" if outcome.done else outcome.error
        return outcome.done

    async def run(self, held: Stored, command: str) -> None:
        """Correct or orient a recording; what is written can be downloaded."""
        base, place = safe_name(held.path.name.split(".")[0], "recording"), held.path.parent
        made = place / f"{base}-{'corrected.parquet' if command == 'correct' else 'angles.csv'}"
        page = place / f"{base}-{command}.html"
        words = [*held.options(), *self._calibrated(), *(self._sides() if command == "orient" else ())]
        outcome = await self.bench.command(command, held.path, *words, "-o", made, "--report", page)
        self._take(held, command, outcome, [made, page])

    async def validate(self, held: Stored, reference: Stored, *, markers: str, up: str) -> None:
        """Compare a recording with its optics, in degrees."""
        place = held.path.parent / "validation"
        words = [*self._optics(held, reference, markers=markers, up=up), *self._calibrated(), *self._sides()]
        outcome = await self.bench.command("validate", *words, "-o", place)
        self._take(held, "validate", outcome, sorted(place.glob("*")))

    async def calibrate_by(self, held: Stored, reference: Stored, *, markers: str, up: str) -> bool:
        """Calibrate from a recording and its optics; the result is the bench's job."""
        job: Job = self.bench.new_job(held.path.stem)
        words = self._optics(held, reference, markers=markers, up=up)
        words += ["--calibrate-from", "reference", *self.bench.place.words()]
        outcome = await self.bench.command("validate", *words, "-o", job.folder)
        held.error = "" if outcome.done else outcome.error
        if outcome.done:
            await self.bench.open_job(job.folder, outcome.answer)
            self.bench.calibration = job.folder / "calibration.json"
        return outcome.done

    def _calibrated(self) -> tuple[object, ...]:
        return () if self.bench.calibration is None else ("--calibration", self.bench.calibration)

    def _sides(self) -> list[object]:
        return [word for name, side in self.axes.items() if side for word in (f"--{name}", side)]

    def _optics(self, held: Stored, reference: Stored, *, markers: str, up: str) -> list[object]:
        words: list[object] = [held.path, *held.options()]
        words += [] if reference is held else ["--reference", reference.path]
        words += ["--markers", markers] if markers else []
        return words + (["--reference-up", up] if up else [])

    def _take(self, held: Stored, command: str, outcome: Outcome, files: list[Path]) -> None:
        held.error = "" if outcome.done else outcome.error
        held.remarks[command] = remarks_of(outcome.answer)
        if outcome.done:
            held.made |= {f"{command}: {'report' if path.suffix == '.html' else path.name}": path for path in files}

    def references(self) -> list[Stored]:
        """Return the files that hold optical poses."""
        return [one for one in self.files if one.kind in ("reference", "markers") or "optical" in one.summary]
