"""Files on the page Recordings: what each holds, the map it needs, and what the commands made of it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    picture: Path | None = None
    made: dict[str, Path] = field(default_factory=dict)  # label -> file
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
    def summary(self) -> str:
        """Return in one line what it holds."""
        if self.error and not self.about:
            return self.error
        if self.needs_map:
            return f"a table of {len(self.about.get('columns') or ())} columns; confirm its units"
        return str(self.about.get("summary") or self.kind or "not read yet")

    def options(self) -> tuple[object, ...]:
        """Return the options by which commands read it."""
        return () if self.map is None else ("--map", self.map)


class Recordings:
    """The files of a bench, and the commands that are run on them."""

    def __init__(self, bench: "Bench") -> None:
        self.bench = bench
        self.files: list[Stored] = []
        self.chosen: Stored | None = None

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
        if held.kind == "recording":
            picture = held.path.parent / "recording.svg"
            drawn = await self.bench.command("info", held.path, *held.options(), "--figure", picture)
            held.picture = picture if drawn.done and picture.exists() else None

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
        outcome = await self.bench.calibrate(
            job, *words, *self.bench.place.words(), *(("--serial", serial) if serial else ())
        )
        held.error = "" if outcome.done else outcome.error
        return outcome.done

    async def run(self, held: Stored, command: str, *, reference: Stored | None = None) -> None:
        """Correct, orient or validate a recording; what is written can be downloaded."""
        base, place = safe_name(held.path.name.split(".")[0], "recording"), held.path.parent
        output = {
            "correct": f"{base}-corrected.parquet",
            "orient": f"{base}-angles.csv",
            "validate": f"{base}-validation",
        }
        made, page = place / output[command], place / f"{base}-{command}.html"
        words: list[object] = [held.path, *held.options(), "-o", made]
        words += [] if command == "validate" else ["--report", page]  # it has one in its folder
        if self.bench.calibration is not None:
            words += ["--calibration", self.bench.calibration]
        if command == "validate":
            words += [] if reference is None or reference is held else ["--reference", reference.path]
        outcome = await self.bench.command(command, *words)
        held.error = "" if outcome.done else outcome.error
        if outcome.done:
            written = sorted(made.glob("*")) if made.is_dir() else [made, page]
            held.made |= {f"{command}: {'report' if path.suffix == '.html' else path.name}": path for path in written}

    def references(self) -> list[Stored]:
        """Return the files that hold optical poses."""
        return [one for one in self.files if one.kind in ("reference", "markers") or "optical" in one.summary]
