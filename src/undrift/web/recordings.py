"""Files on the pages Check, Calibrate and Use: maps are proposed, recordings are calibrated, corrected, oriented and
validated.
"""

import asyncio
import math
import secrets
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from nicegui import background_tasks, ui

from undrift.base.codec import toml_text
from undrift.base.options import asked, stated
from undrift.commands.bench.library import StoredFile
from undrift.commands.bench.trace import trace_of
from undrift.commands.files import Opening
from undrift.commands.mount import Movement, Worn, mounting_of
from undrift.errors import InputError, UndriftError
from undrift.files import write_whole
from undrift.record import FACES
from undrift.web import entries, parts, result
from undrift.web.chart import chart_of
from undrift.web.commands import CommandOutcome, remarks_of
from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.web.bench import Visit

UNITS = {
    "gyro": ("rad/s", "dps", "count", "v"),
    "accel": ("m/s2", "g", "mg", "count", "v"),
    "time": ("s", "ms", "us", "date"),
}
SENSORS = {"gyro": "gyroscopes", "accel": "accelerometers", "time": "time"}
MADE = {  # by command of the page Use: file ending of the result, and the form fields it uses
    "correct": ("-corrected.parquet", ("offset",)),
    "orient": ("-angles.csv", ("offset", "forward", "up")),
}
NO_NUMBER = "sample rate: expected a number above 0, got '{}'. Enter the samples per second."


@dataclass(slots=True, kw_only=True)
class RecordingForm:
    """Input for a recording. "" is not chosen, so that each command uses its default offset."""

    worn: str = asked("--worn", options=("", *get_args(Worn)))
    movement: str = asked("--movement", get_args(Movement)[0], options=get_args(Movement))
    forward: str = asked("--forward", options=("", *FACES))
    up: str = asked("--up", options=("", *FACES))
    offset: str = asked("--offset", options=("", "none", "rest", "motion"))
    markers: str = asked("Markers, commas between")
    reference_up: str = asked("--reference-up", options=("", "y", "z"))
    rate_hz: str = asked("Samples per second, Hz", kind="number")
    turn_deg: str = asked("Angle of its turns, deg (empty: none)", kind="number")
    magnetometer: tuple[str, ...] = ()  # whether calibration from motion calibrates it too


class Recordings:
    """The file that is chosen, and the commands that are run on files."""

    def __init__(self, visit: "Visit") -> None:
        self.visit, self.bench, self.form = visit, visit.bench, RecordingForm()
        self.chosen: StoredFile | None = None
        self.tried, self.trying = 0, asyncio.Lock()  # maps, one at a time
        self.offsets = dict[Path, dict[str, str]]()  # of a recording, what each way to find them gives
        self.draft, self.shown = (
            dict[str, Any](),
            dict[str, Any](),
        )  # a map under construction, and the data read with it

    async def add(self, path: Path) -> StoredFile:
        """Add a stored file, and describe it."""
        stored = self.bench.library.file_at(path)
        await self.choose(stored)
        return stored

    async def choose(self, stored: StoredFile) -> None:
        """Select a file. If it is a calibration, use it."""
        self.chosen, self.form.rate_hz, self.form.turn_deg = stored, "", ""
        if not stored.kind:
            await self.look(stored)
        self.draft, self.shown = draft_of(stored.about.get("map") or ()) if stored.needs_map else {}, {}
        if stored.kind == "calibration":
            self.visit.calibration = stored.path

    async def add_together(self, paths: Sequence[Path]) -> None:
        """Add the files of a folder. Files that form one recording (such as a phone export) are added together, all
        others separately.
        """
        folder = paths[0].parent
        outcome = await self.bench.command("info", folder)
        if outcome.done and outcome.answer.get("kind") == "recording":
            await self.add(folder)
            return
        for path in paths:
            place = folder.parent.with_name(secrets.token_hex(6))  # a folder per file, which also contains the results
            place.mkdir()
            await self.add(path.rename(place / path.name))
        folder.rmdir()
        folder.parent.rmdir()

    async def look(self, stored: StoredFile) -> None:
        """Describe a file, and load its trace if it is a recording."""
        outcome = await self.bench.command("info", stored.path, *stored.options())
        stored.about, stored.error = (outcome.answer if outcome.done else {}), outcome.error
        opening = Opening(column_map=stored.map, sample_rate_hz=stored.sample_rate_hz)
        stored.about |= await self._trace(stored, stored.about, opening)
        stored.serial = stored.serial or str(stored.about.get("device") or "")
        noticed = [remark for remark in remarks_of(stored.about) if remark.text != stored.about.get("summary")]
        stored.remarks = {"info": noticed}
        stored.save()

    async def _trace(self, stored: StoredFile, about: Mapping[str, Any], opening: Opening) -> dict[str, Any]:
        """Return the data of a recording that the page draws, or nothing if it is too short."""
        if about.get("kind") != "recording":
            return {}
        try:
            return {"trace": await asyncio.to_thread(trace_of, stored.path, opening)}
        except UndriftError:  # too short to look for rests
            return {}

    async def state_rate(self, stored: StoredFile, sample_rate_hz: float | None) -> None:
        """Set the sample rate of a file without time."""
        if not (sample_rate_hz and sample_rate_hz > 0.0):
            raise InputError(NO_NUMBER.format(self.form.rate_hz))
        stored.sample_rate_hz = sample_rate_hz
        await self.look(stored)

    async def try_map(self, stored: StoredFile) -> None:
        """Read a table with the columns and units chosen so far. A column without a choice is read as it is named in
        the file.
        """
        self.tried += 1
        mine, path = self.tried, stored.folder / "draft.toml"
        async with self.trying:  # one after the other, and only the last that was chosen
            units = {k: "count" if u == "?" and k != "time" else u for k, u in self.draft.get("units", {}).items()}
            if mine != self.tried or "?" in (self.draft.get("sample_rate_hz"), units.get("time")):
                return
            write_whole(path, toml_text(self.draft | ({"units": units} if units else {})))
            outcome = await self.bench.command("info", stored.path, "--map", path)
            trace = await self._trace(stored, outcome.answer, Opening(column_map=path))
            self.shown = outcome.answer | trace | {"refused": outcome.error}

    async def use_map(self, stored: StoredFile) -> None:
        """Read a table by the columns and units that a person confirmed."""
        for key, unit in self.draft.get("units", {}).items():
            if unit == "?":
                raise InputError(f"unit of the {SENSORS.get(key, key)}: choose the unit of the device.")
        if self.draft.get("sample_rate_hz") == "?":
            raise InputError(NO_NUMBER.format(self.form.rate_hz))
        write_whole(path := stored.folder / "map.toml", toml_text(self.draft))
        stored.map, before = path, stored.about
        await self.look(stored)
        stored.made |= {} if stored.error else {"map": path}
        if stored.error:  # it stays a table
            stored.map, stored.about = None, before
        stored.save()

    async def choose_again(self, stored: StoredFile) -> None:
        """Let the user choose columns and units again for a table that was read."""
        stored.map, stored.made = None, {}
        await self.look(stored)
        await self.choose(stored)

    async def calibrate(self, stored: StoredFile, *, turn_deg: float | None, motion: bool = False) -> bool:
        """Calibrate from the rests and turns of a recording, or from its motion. The result becomes the job of the
        bench.
        """
        if not (serial := stored.serial.strip()):
            raise InputError("serial number: enter the number on the device, or a name of your own.")
        job = self.bench.new_job(serial)
        motion_options = ("--from", "motion", *(("--magnetometer",) if self.form.magnetometer else ()))
        options = motion_options if motion else stated(turn_deg=turn_deg)
        outcome = await self.visit.calibrate(job, stored.path, *stored.options(), *options, *stated(serial=serial))
        stored.error = outcome.error
        return outcome.done

    async def run(self, stored: StoredFile, command: str) -> None:
        """Correct or orient a recording. The output can be downloaded."""
        base, (ending, names) = safe_name(stored.path.name.split(".")[0], "recording"), MADE[command]
        output, report = (stored.path.with_name(f"{base}{end}") for end in (ending, f"-{command}.html"))
        options = *stored.options(), *self._stated(*names), "-o", output, "--report", report
        self._take(stored, command, await self.bench.command(command, stored.path, *options), [output, report])

    async def compare_offsets(self, stored: StoredFile) -> None:
        """Compute the offset of a recording with each method: the subtracted offset, or the reason for refusal."""
        texts, output = dict[str, str](), stored.folder / "offset.parquet"
        for offset in ("none", "rest", "motion"):
            asking = *stored.options(), *stated(calibration=self.visit.calibration, offset=offset)
            outcome = await self.bench.command("correct", stored.path, *asking, "-o", output)
            output.unlink(missing_ok=True)
            texts[offset] = outcome.error or "nothing is subtracted"
            if outcome.done and (rest := outcome.answer["recordings"][0]["rest"]):
                rates, uncertainty = rest["offset_dps"], rest["offset_uncertainty_dps"]
                within = 2.0 * math.hypot(*uncertainty)
                listing = ", ".join(f"{round(rate, 3) + 0.0:.3f}" for rate in rates)  # no -0.000
                texts[offset] = f"{listing} deg/s about x, y, z, within {within:.2g} (95 %)"
        self.offsets = {stored.path: texts}

    async def mount(self, stored: StoredFile) -> None:
        """Determine how the device is worn, and store it in a copy of the calibration, which is then used. Without a
        calibration, set the sides.
        """
        form, calibration = self.form, self.visit.calibration
        if not form.worn:
            raise InputError("mounting: choose the body segment on which the device is worn.")
        copy = stored.path.parent / f"{safe_name(stored.path.name.split('.')[0], 'recording')}-worn.json"
        options = stated(worn=form.worn, movement=form.movement, calibration=calibration)
        options = *stored.options(), *options, *stated(output=calibration and copy)
        outcome = await self.bench.command("mount", stored.path, *options)
        self._take(stored, "mount", outcome, [copy] if outcome.answer.get("written") else [])
        axes = outcome.answer.get("tables", {}).get("body_axes_in_the_device")
        stored.mounting = str(outcome.answer["answer"]) if axes else ""
        if stored.mounting and calibration:
            self.visit.calibration, form.forward, form.up = copy, "", ""
        elif stored.mounting:
            form.forward, form.up = axes[0]["side"], axes[2]["side"]

    async def validate(self, stored: StoredFile, reference: StoredFile) -> None:
        """Compare a recording with its optics, in degrees."""
        place = stored.path.parent / "validation"
        options = *self._optics(stored, reference), *self._stated("offset", "forward", "up"), "-o", place
        self._take(stored, "validate", await self.bench.command("validate", *options), sorted(place.glob("*")))

    async def calibrate_by(self, stored: StoredFile, reference: StoredFile) -> bool:
        """Calibrate from a recording and its optics. The result becomes the job of the bench."""
        job, place = self.bench.new_job(stored.path.stem), self.bench.place
        gravity = place.gravity_m_s2 if place.words() else None
        options = *self._optics(stored, reference), "--calibrate-from", "reference", *stated(gravity_m_s2=gravity)
        outcome = await self.bench.command("validate", *options, "-o", job.folder)
        stored.error = outcome.error
        if outcome.done:
            job.look()
            job.later = [outcome.answer]
            job.save()
            self.visit.shown, self.visit.calibration = job.read(), job.calibration
        return outcome.done

    def _stated(self, *names: str) -> tuple[object, ...]:
        return stated(calibration=self.visit.calibration, **{name: getattr(self.form, name) for name in names})

    def _optics(self, stored: StoredFile, reference: StoredFile) -> tuple[object, ...]:
        other, by = (None, None) if reference is stored else (reference.path, reference.map)
        typed = stated(markers=self.form.markers.strip(), reference_up=self.form.reference_up)
        return stored.path, *stored.options(), *stated(reference=other, reference_map=by), *typed

    def _take(self, stored: StoredFile, command: str, outcome: CommandOutcome, files: list[Path]) -> None:
        stored.error, stored.remarks[command] = outcome.error, remarks_of(outcome.answer)
        if outcome.done:
            stored.made |= {f"{command}: {'report' if path.suffix == '.html' else path.name}": path for path in files}
        stored.save()

    def references(self) -> list[StoredFile]:
        """Return the files that hold optical poses."""
        kinds, files = ("reference", "markers"), self.bench.library.files
        return [file for file in files if file.kind in kinds or "optical" in file.summary]


# ---- The page


def check_page(visit: "Visit") -> None:
    """Build the page that shows the content of files, and asks for missing information."""
    recordings = visit.recordings
    parts.text("p", "Drop a recording, its optical reference or a calibration. Files stay on this computer.")
    entries.drop(visit)
    _listed(visit)
    parts.redrawn(lambda: _state(visit), lambda: _check_part(visit, recordings.chosen))


def calibrate_page(visit: "Visit") -> None:
    """Build the page that calibrates from a recording, and shows results."""
    parts.redrawn(lambda: _state(visit), lambda: _calibration(visit, visit.recordings.chosen))
    result.page(visit)


def use_page(visit: "Visit") -> None:
    """Build the page that corrects and orients recordings."""
    _listed(visit)
    parts.redrawn(lambda: _state(visit), lambda: _use_part(visit, visit.recordings.chosen))


def _listed(visit: "Visit") -> None:
    """List the files of the bench."""
    recordings = visit.recordings
    entries.listing("Files", lambda: visit.library.files, lambda: recordings.chosen, recordings.choose)


def _state(visit: "Visit") -> object:
    """Return the state whose change redraws the part about a file."""
    stored, references = visit.recordings.chosen, [other.path for other in visit.recordings.references()]
    if stored is None:
        return None
    state = (
        stored.path,
        stored.kind,
        stored.map,
        stored.error,
        len(stored.made),
        str(stored.remarks),
        stored.mounting,
        id(stored.about),
    )
    return state, references, visit.calibration, id(visit.recordings.offsets.get(stored.path))


def _heading_part(visit: "Visit", stored: StoredFile) -> None:
    """Add the name of a file, with its errors or missing information."""
    parts.text("h2", stored.name)
    if stored.needs_rate:
        _rate_form(visit.recordings, stored)
    else:
        parts.error_line(stored.error)


def _check_part(visit: "Visit", stored: StoredFile | None) -> None:
    """Add the content of a file, and the information it needs."""
    if stored is None:
        return
    _heading_part(visit, stored)
    if stored.needs_map:
        _map_form(visit.recordings, stored)
    elif stored.kind == "calibration":
        parts.text("p", "Recordings are corrected with this calibration.")
    elif stored.kind == "recording" or (stored.about and not stored.needs_rate):
        parts.text("p", stored.summary)
        parts.remarks_list(stored.remarks["info"])
    if stored.kind == "recording":
        parts.next_step(*(("Use it", "/use") if visit.calibration else ("Calibrate from it", "/calibrate")))
        _trace(stored.about)
        if stored.map is not None:
            parts.button("Choose other columns or units", lambda: visit.recordings.choose_again(stored))


def _use_part(visit: "Visit", stored: StoredFile | None) -> None:
    """Add the actions for a recording, and its results."""
    if stored is None or stored.kind != "recording":
        parts.text("p", "Choose a recording of this list, or drop one.")
        parts.next_step("Check files", "/check")
        return
    _heading_part(visit, stored)
    _actions(visit, stored)
    for command, remarks in stored.remarks.items():
        if remarks and command != "info":
            parts.text("h3", f"What {command} noticed")
            parts.remarks_list(remarks)
    if stored.made:
        parts.text("h3", "Results")
        with ui.element("ul"):
            for label, path in stored.made.items():
                end = "" if (opened := path.suffix in (".html", ".svg")) else "?download=1"
                with ui.element("li"):
                    ui.link(label, visit.bench.link(path) + end, new_tab=opened)


def _rate_form(recordings: Recordings, stored: StoredFile) -> None:
    """Ask for the sample rate of a file without time."""
    if stored.kind == "recording":
        parts.error_line(stored.error)
    else:
        parts.says("no time")
    rate = parts.form(recordings.form, "rate_hz")["rate_hz"]
    parts.next_step("Read the file", lambda: recordings.state_rate(stored, rate.number()))


def draft_of(lines: Sequence[str]) -> dict[str, Any]:
    """Return the map that a description proposes as a tree, "?" where nothing shows a value."""
    return tomllib.loads("\n".join(lines).replace("= ?", '= "?"'))


def _map_form(recordings: Recordings, stored: StoredFile) -> None:
    """Ask for unknown columns and units, and show the data read with them as a check."""
    draft = recordings.draft = recordings.draft or draft_of(stored.about["map"])
    names, units = [str(name) for name in stored.about.get("columns") or ()], draft.get("units", {})

    def take(place: Any, key: Any, value: str) -> None:
        if key == "sample_rate_hz":
            recordings.form.rate_hz, number = value, rate.number()
            place[key] = number if number and number > 0.0 else "?"
        else:
            sign = isinstance(place[key], float)
            place[key] = float(f"{value}1") if sign else type(place[key])(value)  # a name, or a position from 0
        background_tasks.create(recordings.try_map(stored), name="map that is chosen")

    parts.says("units")
    parts.text("p", "; ".join(comment for line in stored.about["map"] if (comment := line.partition("# ")[2])), "soft")
    with parts.row("form"):
        if draft.get("sample_rate_hz") is not None:
            asking: Any = {"kind": "number", "keep": partial(take, draft, "sample_rate_hz")}
            rate = parts.Field("Samples per second, Hz", recordings.form.rate_hz, **asking)
        for key, unit in units.items():
            if (units_for_key := UNITS.get(key)) is not None:
                parts.Field(
                    f"Unit of the {SENSORS[key]}", unit, options=("?", *units_for_key), keep=partial(take, units, key)
                )
    with parts.folded("Columns"), parts.row("form"):
        for key, columns in draft.get("columns", {}).items():
            if key in SENSORS and isinstance(columns, list) and set(map(str, columns)) <= set(names):
                gains = draft.setdefault("scale", {}).setdefault(key, {"gain": [1.0] * len(columns)})["gain"]
                for k, axis in enumerate("xyz"[: len(columns)]):
                    with parts.row("signed"):
                        signs = parts.Field("Sign", "+-"[gains[k] < 0.0], options="+-", keep=partial(take, gains, k))
                        signs.element.props["aria-label"] = f"Sign of {SENSORS[key]} {axis}"
                        label = f"{SENSORS[key].capitalize()}, {axis}"
                        parts.Field(label, str(columns[k]), options=names, keep=partial(take, columns, k))

    def shown() -> None:
        parts.remarks_list(remarks_of(recordings.shown))
        _trace(recordings.shown)

    parts.redrawn(lambda: id(recordings.shown), shown)
    parts.next_step("Read the file", lambda: recordings.use_map(stored))
    if not recordings.shown:
        background_tasks.create(recordings.try_map(stored), name="map that is proposed")


def proof_words(trace: Mapping[str, Any]) -> str:
    """Return the readings of a device at rest. If columns and units are right, gravity is 1 g and rates are zero."""
    rest, units = trace["at_rest"], trace["units"]
    if not rest:
        return "No rest was found: nothing proves columns and units."
    names = {"accel": "|a| at rest", "gyro": "rate at rest"}
    readings = [f"{name} = {rest[key]:.2f} {units[key]}" for key, name in names.items() if key in rest]
    far = units.get("accel") == "g" and abs(rest.get("accel", 1.0) - 1.0) > 0.05
    return ", ".join(readings) + (", but gravity is 1.00 g. Check the columns and the unit." if far else ".")


def _trace(about: Mapping[str, Any]) -> None:
    """Add the chart of a recording, how many rests and turns it has, and the mean readings at rest."""
    parts.error_line(str(about.get("refused") or ""))
    if not (trace := about.get("trace")):
        return
    stretches = trace["stretches"]
    counts = [sum(s[0] == kind for s in stretches) for kind in ("still", "turn")]
    faces = len({label for kind, label, *_ in stretches if kind == "still" and label})
    counts_text = f"{counts[0]} rests on {faces} faces, {counts[1]} turns"
    parts.text("p", proof_words(trace), "proof")
    parts.text("p", f"{trace['time'][-1]:.1f} s: {counts_text}.", "found")
    caption = f"Turn rate and specific force over {trace['time'][-1]:.1f} s: {counts_text}"
    ui.echart(chart_of(trace)).classes("trace").props(f'role="img" aria-label="{caption}"')


def _actions(visit: "Visit", stored: StoredFile) -> None:
    recordings, calibration = visit.recordings, visit.calibration
    if calibration is None:
        parts.text("p", "No calibration chosen: drop one on the page Check, or calibrate the device.", "soft")
    else:
        parts.text("p", f"Calibration: {visit.bench.library.name_of(calibration)}", "soft")
    parts.says("offset")
    parts.form(recordings.form, "offset")
    if calibration is not None:
        for offset, result in recordings.offsets.get(stored.path, {}).items():
            parts.text("p", f"{offset}: {result.rstrip('.')}.", "soft")
        parts.button("How accurate is each sensor here?", lambda: recordings.compare_offsets(stored))
        parts.next_step("Correct", lambda: recordings.run(stored, "correct"))
    _wearing_form(visit, stored)
    parts.button("Orient", lambda: recordings.run(stored, "orient") if _mounting_is_known(recordings, stored) else None)
    if recordings.references():
        _optics_form(recordings, stored)


def _calibration(visit: "Visit", stored: StoredFile | None) -> None:
    """Add what calibrates the device from the recording that is chosen."""
    if stored is None or stored.kind != "recording":
        return
    recordings = visit.recordings
    with parts.section("Calibrate from a recording"):
        parts.text("h2", f"Calibrate from {stored.name}")
        parts.refused(visit, visit.bench.job, stored.error, partial(setattr, stored, "error"))
        parts.says("faces")
        hint = "required to calibrate, or a name of your own"
        parts.Field("Serial number", stored.serial, hint=hint, keep=partial(setattr, stored, "serial"))
        typed = parts.form(recordings.form, "turn_deg")

        async def calibrate(*, motion: bool = False) -> str | None:
            done = await recordings.calibrate(stored, turn_deg=typed["turn_deg"].number(), motion=motion)
            return "/calibrate" if done else None

        parts.button("Calibrate", calibrate, "next" if visit.job is None else "")
        parts.text(
            "p", "Or from motion only: turn the device slowly in your hand about every axis for one minute. Rests help."
        )
        parts.choices("Magnetometer", ("calibrate it too",), recordings.form, "magnetometer")
        parts.button("Calibrate from its motion", lambda: calibrate(motion=True))


def _wearing_form(visit: "Visit", stored: StoredFile) -> None:
    """Show the mounting in use. Offer to determine it, or to choose the sides, which the drawing follows."""
    recordings, form, mounting = visit.recordings, visit.recordings.form, mounting_of(visit.calibration)
    with parts.section("How it is worn"):
        parts.text("h3", "How it is worn")
        if mounting:
            parts.text("p", f"Mounting of the calibration, used for the pitch unless sides are named: {mounting}")
        else:
            why = "" if visit.calibration else " Without a calibration the nearest sides are taken."
            parts.text("p", f"On which part of the body is the device worn? The pitch requires its mounting.{why}")
            if stored.mounting:
                parts.text("p", stored.mounting)
        with parts.folded("Find the mounting from this recording") as find:
            if not mounting:
                find.props("open")
            parts.says("walk")
            parts.form(form, "worn", "movement")
            parts.button("Find the mounting", lambda: recordings.mount(stored))
        with parts.folded("Name the sides of the device") as sides:
            if form.forward or form.up:
                sides.props("open")
            with ui.element("div").classes("worn"):
                parts.drawing("worn", lambda: [form.forward, form.up])
                with ui.element("div"):
                    parts.text("p", "Which sides point forward and up when the wearer is upright?")
                    parts.form(form, "forward", "up")


def _mounting_is_known(recordings: Recordings, stored: StoredFile) -> bool:
    """Return True if the mounting is known, from the calibration or two sides. Otherwise show an error."""
    forward, up = recordings.form.forward, recordings.form.up
    sided = bool(forward and up) and forward[1] != up[1]
    determined = sided or (not (forward or up) and bool(mounting_of(recordings.visit.calibration)))
    got = f"{forward or 'none'} and {up or 'none'}"
    wrong = (
        f"pitch: expected the mounting, or the sides that point forward and up, got {got}. Determine one or the other."
    )
    stored.error = "" if determined else wrong
    return determined


def _optics_form(recordings: Recordings, stored: StoredFile) -> None:
    """Ask for the optics of a recording: its own, or a file of poses or markers."""
    choices = {("its own" if other is stored else other.path.name): other for other in recordings.references()}
    with parts.section("Optics"):
        parts.text("h3", "Compare with optics")
        with parts.row():
            chosen = parts.Field("Optical reference", next(iter(choices)), options=tuple(choices))
        if labels := next((other.about.get("columns") for other in choices.values() if other.kind == "markers"), None):
            first = ", ".join(map(str, labels[:6]))
            parts.text("p", f"Markers (three or more of the same rigid cluster): {first} ...", "soft")
            parts.form(recordings.form, "markers", "reference_up")

        async def validate() -> None:
            if _mounting_is_known(recordings, stored):
                await recordings.validate(stored, choices[chosen.value])

        async def calibrate() -> str | None:
            return "/calibrate" if await recordings.calibrate_by(stored, choices[chosen.value]) else None

        with parts.row():
            parts.button("Validate", validate)
            parts.button("Calibrate by these optics", calibrate)
