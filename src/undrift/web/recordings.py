"""Files on the pages Check, Calibrate and Use: maps are proposed; recordings are calibrated, corrected, oriented, validated."""

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from nicegui import ui

from undrift.base.options import asked, stated
from undrift.commands.bench.library import StoredFile
from undrift.commands.mount import Movement, Posture, Worn, mounting_of
from undrift.errors import InputError
from undrift.record import FACES
from undrift.web import device, entries, parts, result
from undrift.web.commands import CommandOutcome, remarks_of
from undrift.web.live import motion_controls
from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.web.bench import Visit

UNITS = {"gyro": ("rad/s", "dps", "count", "v"), "accel": ("m/s2", "g", "mg", "count", "v")}


@dataclass(slots=True, kw_only=True)
class WearingForm:
    """Where the device is worn, and what shows its mounting; or its sides on the upright segment. "" is not chosen."""

    worn: str = asked("--worn", options=("", *get_args(Worn)))
    posture: str = asked("--posture", get_args(Posture)[0], options=get_args(Posture))
    movement: str = asked("--movement", get_args(Movement)[0], options=get_args(Movement))
    forward: str = asked("--forward", options=("", *FACES))
    up: str = asked("--up", options=("", *FACES))


@dataclass(slots=True, kw_only=True)
class OffsetForm:
    """What is subtracted of the offset that a calibration leaves; "" is what each command does by itself."""

    offset: str = asked("--offset", options=("", "none", "rest", "motion"))


@dataclass(slots=True, kw_only=True)
class MarkersForm:
    """What is typed of an optical reference of markers."""

    markers: str = asked("Markers, commas between")
    up: str = asked("--reference-up", options=("", "y", "z"))


@dataclass(slots=True, kw_only=True)
class SourceForm:
    """What is typed of the readings in a file."""

    rate_hz: str = asked("Samples per second, Hz", kind="number")
    turn_deg: str = asked("Angle of its turns, deg (empty: none)", kind="number")


class Recordings:
    """What a tab does with the files of the bench: which one it has chosen, and the commands that it runs on them."""

    def __init__(self, visit: "Visit") -> None:
        self.visit, self.bench = visit, visit.bench
        self.chosen: StoredFile | None = None
        self.wearing, self.subtracted, self.optics, self.typed = (
            WearingForm(),
            OffsetForm(),
            MarkersForm(),
            SourceForm(),
        )

    @property
    def files(self) -> list[StoredFile]:
        """Return the files of the bench, the newest first."""
        return self.bench.library.files

    async def add(self, path: Path) -> StoredFile:
        """Take up a file that has been stored, and ask what it holds."""
        device = self.visit.begun()
        stored = self.bench.library.file_at(path, self.visit.key)
        await self.choose(stored)
        if (stated := str(stored.about.get("device") or "")) and stored.kind == "recording" and not device.serial:
            device.serial = stated
            device.save()
        return stored

    async def choose(self, stored: StoredFile) -> None:
        """Look at a file from now on; a calibration is used."""
        self.chosen, self.typed = stored, SourceForm()
        if not stored.about:
            await self.look(stored)
        if stored.kind == "calibration":
            self.visit.calibration = stored.path

    async def add_together(self, paths: Sequence[Path]) -> None:
        """Take up files that lie in one folder: as one recording where they are one, as those of a phone; else each by itself."""
        folder = paths[0].parent
        outcome = await self.bench.command("info", folder)
        if outcome.done and outcome.answer.get("kind") == "recording":
            await self.add(folder)
            return
        for path in paths:
            place = folder.parent.with_name(secrets.token_hex(6))  # one folder a file: results lie beside it
            place.mkdir()
            await self.add(path.rename(place / path.name))
        folder.rmdir()
        folder.parent.rmdir()

    async def look(self, stored: StoredFile) -> None:
        """Ask what a file holds; draw it where it is a recording."""
        outcome = await self.bench.command("info", stored.path, *stored.options())
        stored.about, stored.error = (outcome.answer if outcome.done else {}), outcome.error
        noticed = [one for one in remarks_of(stored.about) if one.text != stored.about.get("summary")]
        stored.remarks = {"info": noticed}
        stored.save()
        if stored.kind == "recording":
            drawing = stored.path.parent / "recording.svg"
            drawn = await self.bench.command("info", stored.path, *stored.options(), "--figure", drawing)
            stored.picture = drawing if drawn.done and drawing.exists() else None
        stored.save()

    async def state_rate(self, stored: StoredFile, sample_rate_hz: float) -> None:
        """State the sample rate of a file without time."""
        stored.sample_rate_hz = sample_rate_hz
        await self.look(stored)

    async def write_map(self, stored: StoredFile, *, sample_rate_hz: float | None, units: Mapping[str, str]) -> None:
        """Write the map of a foreign table, with the units that a person confirmed."""
        path = stored.path.parent / "map.toml"
        words = stated(
            write_map=path, sample_rate_hz=sample_rate_hz, **{f"{name}_unit": unit for name, unit in units.items()}
        )
        outcome = await self.bench.command("info", stored.path, *words)
        stored.error = outcome.error
        if outcome.done:
            stored.map = stored.made["map"] = path
            await self.look(stored)

    async def calibrate(self, stored: StoredFile, *, turn_deg: float | None, motion: bool = False) -> bool:
        """Calibrate from the rests and turns of a recording, or from its motion; the result is the bench's job."""
        if not (serial := self.visit.begun().serial):
            raise InputError("serial number: wanted the one on the device, got none; type it, or a name of your own")
        job = self.bench.new_job(serial, self.visit.key)
        words = (
            *stated(turn_deg=None if motion else turn_deg, serial=serial),
            *(self.visit.motion.words() if motion else ()),
        )
        outcome = await self.visit.calibrate(job, stored.path, *stored.options(), *words)
        stored.error = outcome.error
        return outcome.done

    async def run(self, stored: StoredFile, command: str) -> None:
        """Correct or orient a recording; what is written can be downloaded."""
        base, place = safe_name(stored.path.name.split(".")[0], "recording"), stored.path.parent
        made = place / f"{base}-{'corrected.parquet' if command == 'correct' else 'angles.csv'}"
        report = place / f"{base}-{command}.html"
        words = [*stored.options(), *self._calibrated(), *(self._sides() if command == "orient" else ())]
        outcome = await self.bench.command(command, stored.path, *words, "-o", made, "--report", report)
        self._take(stored, command, outcome, [made, report])

    async def mount(self, stored: StoredFile) -> None:
        """Find how the device is worn: kept in a copy of the calibration, which is used then; without one, sides are chosen."""
        form, calibration = self.wearing, self.visit.calibration
        if not form.worn:
            raise InputError("mounting: wanted the place where the device is worn, got none; choose it")
        copy = stored.path.parent / f"{safe_name(stored.path.name.split('.')[0], 'recording')}-worn.json"
        words = stated(worn=form.worn, posture=form.posture, movement=form.movement, calibration=calibration)
        outcome = await self.bench.command(
            "mount", stored.path, *stored.options(), *words, *stated(output=calibration and copy)
        )
        self._take(stored, "mount", outcome, [copy] if outcome.answer.get("output") else [])
        stored.mounting = str(outcome.answer.get("statement") or "")
        if stored.mounting and calibration:
            self.visit.calibration, form.forward, form.up = copy, "", ""
        elif stored.mounting:
            form.forward, form.up = (outcome.answer["sides"][way] for way in ("forward", "up"))

    async def validate(self, stored: StoredFile, reference: StoredFile, *, markers: str, up: str) -> None:
        """Compare a recording with its optics, in degrees."""
        place = stored.path.parent / "validation"
        words = *_optics(stored, reference, markers, up), *self._calibrated(), *self._sides()
        outcome = await self.bench.command("validate", *words, "-o", place)
        self._take(stored, "validate", outcome, sorted(place.glob("*")))

    async def calibrate_by(self, stored: StoredFile, reference: StoredFile, *, markers: str, up: str) -> bool:
        """Calibrate from a recording and its optics; the result is the bench's job."""
        job = self.bench.new_job(stored.path.stem, self.visit.key)
        words = *_optics(stored, reference, markers, up), "--calibrate-from", "reference", *self.bench.place.words()
        outcome = await self.bench.command("validate", *words, "-o", job.folder)
        stored.error = outcome.error
        if outcome.done:
            job.look()
            job.later = [outcome.answer]
            job.save()
            self.visit.shown, self.visit.calibration = job.read(), job.calibration
        return outcome.done

    def _calibrated(self) -> tuple[object, ...]:
        return stated(calibration=self.visit.calibration, offset=self.subtracted.offset)

    def _sides(self) -> tuple[object, ...]:
        return stated(forward=self.wearing.forward, up=self.wearing.up)

    def _take(self, stored: StoredFile, command: str, outcome: CommandOutcome, files: list[Path]) -> None:
        stored.error, stored.remarks[command] = outcome.error, remarks_of(outcome.answer)
        if outcome.done:
            stored.made |= {f"{command}: {'report' if path.suffix == '.html' else path.name}": path for path in files}
        stored.save()

    def references(self) -> list[StoredFile]:
        """Return the files that hold optical poses."""
        return [one for one in self.files if one.kind in ("reference", "markers") or "optical" in one.summary]


def _optics(stored: StoredFile, reference: StoredFile, markers: str, up: str) -> tuple[object, ...]:
    other, by = (None, None) if reference is stored else (reference.path, reference.map)
    return stored.path, *stored.options(), *stated(reference=other, reference_map=by, markers=markers, reference_up=up)


# ---- The page


def check_page(visit: "Visit") -> None:
    """Build the page that shows what files hold, and asks what they do not say."""
    recordings = visit.recordings
    parts.text("p", "Drop a recording, its optical reference or a calibration. Files stay on this computer.")
    entries.drop(visit)
    _listed(visit)
    parts.redrawn(lambda: _state(visit), lambda: _checked(visit, recordings.chosen))


def calibrate_page(visit: "Visit") -> None:
    """Build the page that calibrates from a recording, and shows results."""
    parts.redrawn(lambda: _state(visit), lambda: _calibration(visit, visit.recordings.chosen))
    result.page(visit)


def use_page(visit: "Visit") -> None:
    """Build the page that corrects and orients recordings."""
    with ui.element("p"):
        parts.text("span", "What the device sends now is corrected on the page ")
        ui.link("Live", "/live")
    _listed(visit)
    parts.redrawn(lambda: _state(visit), lambda: _used(visit, visit.recordings.chosen))


def _listed(visit: "Visit") -> None:
    """List the files of the device, and those of others below a fold."""
    recordings = visit.recordings
    for title, of_it in (("Files", True), ("Files of other devices", False)):
        every = partial(lambda of_it: [one for one in recordings.files if (one.device == visit.key) == of_it], of_it)
        entries.listing(visit, title, every, lambda: recordings.chosen, recordings.choose)


def _state(visit: "Visit") -> object:
    """Return what the part about a file is drawn anew for: nothing that another tab has chosen or typed."""
    one, references = visit.recordings.chosen, [other.path for other in visit.recordings.references()]
    if one is None:
        return None
    known = one.path, one.kind, one.map, one.error, len(one.made), str(one.remarks), one.mounting
    return known, one.title, references, visit.calibration


def _headed(visit: "Visit", one: StoredFile) -> None:
    """Add the name of a file, and what is wrong with it or missing."""
    parts.text("h2", one.name)
    if one.needs_rate:
        _rate_form(visit.recordings, one)
    else:
        parts.error_line(one.error)


def _checked(visit: "Visit", one: StoredFile | None) -> None:
    """Add what a file holds, and what it needs."""
    if one is None:
        return
    _headed(visit, one)
    if one.needs_map:
        _map_form(visit.recordings, one)
    elif one.kind == "calibration":
        parts.text("p", "Recordings are corrected with this calibration.")
    elif one.kind == "recording" or (one.about and not one.needs_rate):
        parts.text("p", one.summary)
        parts.remarks_list(one.remarks["info"])
    if one.kind == "recording":
        parts.next_step(*(("Use it", "/use") if visit.calibration else ("Calibrate from it", "/calibrate")))
        parts.redrawn(lambda: one.picture, lambda: parts.picture(one.picture))  # it comes later


def _used(visit: "Visit", one: StoredFile | None) -> None:
    """Add what may be done with a recording, and what was made of it."""
    if one is None or one.kind != "recording":
        parts.text("p", "Choose a recording of this list, or drop one.")
        parts.next_step("Check files", "/check")
        return
    _headed(visit, one)
    _actions(visit, one)
    for command, remarks in one.remarks.items():
        if remarks and command != "info":
            parts.text("h3", f"What {command} noticed")
            parts.remarks_list(remarks)
    if one.made:
        parts.text("h3", "Results")
        with ui.element("ul"):
            for label, path in one.made.items():
                opened = path.suffix in (".html", ".svg")
                with ui.element("li"):
                    ui.link(label, visit.bench.link(path) + ("" if opened else "?download=1"), new_tab=opened)


def _stated_rate(rate: parts.Field) -> float:
    value = rate.number()
    if value and value > 0.0:
        return value
    raise InputError(f"sample rate: wanted a number above 0, got '{rate.value}'; state the samples per second")


def _rate_form(recordings: Recordings, one: StoredFile) -> None:
    """Ask for the sample rate of a file without time."""
    if one.kind == "recording":
        parts.error_line(one.error)
    else:
        parts.text(
            "p", "This file has no time column. The data sheet or the settings of the device state its sample rate."
        )
    rate = parts.form(recordings.typed, "rate_hz")["rate_hz"]
    parts.next_step("Read the file", lambda: recordings.state_rate(one, _stated_rate(rate)))


def _map_form(recordings: Recordings, one: StoredFile) -> None:
    """Show the proposed map, and ask what nothing in the file shows."""
    lines = [str(line) for line in one.about.get("map") or ()]
    parts.text("p", "This table does not state its units. Check the proposal against the data sheet of the device.")
    parts.text("pre", "\n".join(lines), "scroll").props('tabindex="0"')
    wants_rate = any(line.startswith("sample_rate_hz") for line in lines)
    parts.text("h3", "Confirm")
    with parts.row():
        rate = parts.form(recordings.typed, "rate_hz")["rate_hz"] if wants_rate else None
        chosen: dict[str, parts.Field] = {}
        for name, label in (("gyro", "Unit of the gyroscopes"), ("accel", "Unit of the accelerometers")):
            if any(f"{name} =" in line for line in lines):
                marked = (unit for unit in UNITS[name] if any(f'{name} = "{unit}"' in line for line in lines))
                chosen[name] = parts.Field(label, next(marked, UNITS[name][0]), options=UNITS[name])

    async def write() -> None:
        units = {name: made.value for name, made in chosen.items()}
        sample_rate_hz = None if rate is None else _stated_rate(rate)
        await recordings.write_map(one, sample_rate_hz=sample_rate_hz, units=units)

    parts.next_step("Read the file", write)


def _actions(visit: "Visit", one: StoredFile) -> None:
    recordings, calibration = visit.recordings, visit.calibration
    if calibration is None:
        parts.text("p", "No calibration chosen: drop one on the page Check, or calibrate the device.", "soft")
    else:
        parts.text("p", f"Calibration: {visit.bench.library.name_of(calibration)}", "soft")
    parts.text(
        "p",
        "Gyroscopes keep an offset of each recording: none is subtracted, the mean of the first rest, or what gravity shows "
        "while the device moves, worn or in the hand, for 20 s or more.",
    )
    parts.form(recordings.subtracted, "offset")
    if calibration is not None:
        parts.next_step("Correct", lambda: recordings.run(one, "correct"))
    _wearing_form(visit, one)
    parts.button("Orient", lambda: recordings.run(one, "orient") if _worn(recordings, one) else None)
    if recordings.references():
        _optics_form(recordings, one)


def _calibration(visit: "Visit", one: StoredFile | None) -> None:
    """Add what calibrates the device from the recording that is chosen."""
    if one is None or one.kind != "recording":
        return
    recordings = visit.recordings
    with parts.section("Calibrate from a recording"):
        parts.text("h2", f"Calibrate from {one.name}")
        parts.refused(visit, visit.bench.job, one.error, partial(setattr, one, "error"))
        parts.text(
            "p",
            "It needs six faces or more, each at rest for some seconds; gyroscopes need full turns between rests too.",
        )
        device.identity(visit)
        typed = parts.form(recordings.typed, "turn_deg")

        async def calibrate(*, motion: bool = False) -> str | None:
            done = await recordings.calibrate(one, turn_deg=typed["turn_deg"].number(), motion=motion)
            return "/calibrate" if done else None

        parts.button("Calibrate", calibrate, "next" if visit.job is None else "")
        parts.text("p", "Or from motion alone: a minute in the hand, turned slowly about every axis; rests help.")
        motion_controls(visit)
        parts.button("Calibrate from its motion", lambda: calibrate(motion=True))


def _wearing_form(visit: "Visit", one: StoredFile) -> None:
    """Say which mounting is used; offer to find it, or to name the sides, which the drawing follows."""
    recordings, form, mounting = visit.recordings, visit.recordings.wearing, mounting_of(visit.calibration)
    with parts.section("How it is worn"):
        parts.text("h3", "How it is worn")
        if mounting:
            parts.text("p", f"Mounting of the calibration, used for the pitch unless sides are named: {mounting}.")
        else:
            why = "" if visit.calibration else " Without a calibration the nearest sides are taken."
            parts.text("p", f"Where is the device worn? The pitch needs its mounting.{why}")
            if one.mounting:
                parts.text("p", f"{one.mounting}.")
        with parts.folded("Find the mounting from this recording") as find:
            if not mounting:
                find.props("open")
            parts.text(
                "p",
                "Stand upright for 3 s, walk straight ahead for 8 s and halt, four times; or do one of the movements twice.",
            )
            parts.form(form, "worn", "posture", "movement")
            parts.button("Find the mounting", lambda: recordings.mount(one))
        with parts.folded("Name the sides of the device") as sides:
            if form.forward or form.up:
                sides.props("open")
            with ui.element("div").classes("worn"):
                parts.drawing("worn", lambda: [form.forward, form.up])
                with ui.element("div"):
                    parts.text("p", "Which sides point forward and up when the wearer stands?")
                    parts.form(form, "forward", "up")


def _worn(recordings: Recordings, one: StoredFile) -> bool:
    """Return whether the mounting is known, by the calibration or by two sides; say so where it is not."""
    forward, up = recordings.wearing.forward, recordings.wearing.up
    sided = bool(forward and up) and forward[1] != up[1]
    shown = sided or (not (forward or up) and bool(mounting_of(recordings.visit.calibration)))
    got = f"{forward or 'none'} and {up or 'none'}"
    wrong = f"pitch: wanted the mounting, or a side that points forward and another that points up, got {got}; find it or name both"
    one.error = "" if shown else wrong
    return shown


def _optics_form(recordings: Recordings, one: StoredFile) -> None:
    """Ask for the optics of a recording: its own, or a file of poses or markers."""
    found = {
        ("its own" if reference is one else reference.path.name): reference for reference in recordings.references()
    }
    typed = recordings.optics
    with parts.section("Optics"):
        parts.text("h3", "Compare with optics")
        with parts.row():
            chosen = parts.Field("Optical reference", next(iter(found)), options=tuple(found))
        if labels := next((other.about.get("columns") for other in found.values() if other.kind == "markers"), None):
            parts.text(
                "p", f"Markers: three or more of one rigid cluster: {', '.join(map(str, labels[:6]))} ...", "soft"
            )
            parts.form(typed, "markers", "up")

        async def validate() -> None:
            if _worn(recordings, one):
                await recordings.validate(one, found[chosen.value], markers=typed.markers.strip(), up=typed.up)

        async def calibrate() -> str | None:
            reference, markers = found[chosen.value], typed.markers.strip()
            done = await recordings.calibrate_by(one, reference, markers=markers, up=typed.up)
            return "/calibrate" if done else None

        with parts.row():
            parts.button("Validate", validate)
            parts.button("Calibrate by these optics", calibrate)
