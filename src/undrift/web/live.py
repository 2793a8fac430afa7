"""The page Live: what the device reads now, raw against corrected, pitch and temperature; recorded to a file on request.

A device may be calibrated from its motion there: ``MotionCalibration`` collects and fits until each element is known well enough.
"""

import asyncio
import math
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from nicegui import ui

from undrift.base.options import stated
from undrift.commands.bench.library import Remark
from undrift.commands.bench.source import LiveDevice, Status
from undrift.commands.files import Place
from undrift.commands.live_motion import LiveMotion, MotionWatch, motion_fit
from undrift.errors import InputError, UndriftError
from undrift.record import FACES, Face
from undrift.web import parts
from undrift.web.commands import without_folders
from undrift.web.device import connect_form
from undrift.web.feed import Panel
from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.web.bench import Bench, Visit

NONE = "none: raw readings"


def page(visit: "Visit") -> None:
    """Build the page."""

    bench, recordings = visit.bench, visit.recordings

    async def use() -> None:  # one device, one correction: what a tab chose last holds for all that look
        source, wanted = bench.source, (bench.source, visit.calibration)
        if source is not None and visit.corrected != wanted:
            if visit.calibration is not None or visit.corrected[0] is source:
                await asyncio.to_thread(source.use, visit.calibration)
            visit.corrected = wanted

    parts.text("p", lambda: "" if bench.source is None else status_line(bench.source.status()), "live-status")
    parts.error_line(lambda: " ".join(_wrong(bench)))
    label = "Start recording", "Stop recording"
    step = parts.next_step(lambda: label[bool(bench.source and bench.source.file)], lambda: start_or_stop(visit))
    parts.shown_if(step, lambda: bench.source is not None and bench.motion.watch is None)
    hint = parts.text("p", "Connect a device below. The practice device is a simulated sensor.")
    parts.shown_if(hint, lambda: bench.source is None)
    parts.redrawn(lambda: _remarks(bench), lambda: parts.remarks_list(_remarks(bench)))
    parts.redrawn(lambda: recordings.chosen and recordings.chosen.path, lambda: _recorded(visit))
    parts.shown_if(Panel(), lambda: bench.motion.watch is None)  # what to do next is at hand
    body = parts.drawing("body", lambda: _lying(bench) or [1, 0, 0, 0], "worn")
    parts.shown_if(body, lambda: bool(_lying(bench)))
    _motion(visit)
    parts.redrawn(lambda: _files(visit), lambda: _settings(visit))
    connect_form(visit)
    parts.bound(use)


def _lying(bench: "Bench") -> list[float]:
    """Return how the device lies now, as a quaternion since its last rest; nothing where that is unknown."""
    updates = [] if bench.source is None else bench.source.updates()
    q = updates[-1].q_nb[-1].tolist() if updates and updates[-1].q_nb is not None else [math.nan]
    return [] if math.isnan(q[0]) else [round(part, 3) for part in q]


def status_line(status: Status) -> str:
    """Return in words how a device is doing."""
    silent = math.isnan(status.sample_rate_hz)
    rate = "No readings now" if silent else f"{status.sample_rate_hz:.0f} readings per second"
    parts = [f"{rate} ({status.nominal_rate_hz:g} stated)", f"{status.lost} lost, {status.garbled} damaged"]
    parts += [] if math.isnan(status.temp_c) else [f"{status.temp_c:.1f} °C"]
    if not status.oriented:
        parts += ["choose a calibration to see the pitch"]
    elif math.isnan(status.rested_s):
        parts += ["hold the device still for two seconds to see the pitch"]
    else:
        since = "at rest" if status.rested_s < 1.0 else f"{status.rested_s:.0f} s since the last rest"
        parts += [f"pitch: {since}"]
    parts += [] if status.file is None else [f"recording {status.file.name}, {status.file_s:.0f} s"]
    return "; ".join(parts) + "."


def _wrong(bench: "Bench") -> list[str]:
    """Return what is wrong in plain words: with the connection, the file."""
    if bench.source is None:
        return []
    status = bench.source.status()
    lost = f"{status.error}. The bench tries again by itself." if status.error else ""
    return [words for words in (lost, status.file_error) if words]


def _remarks(bench: "Bench") -> list[Remark]:
    """Return what the correction warns of, and what a reader of it should know."""
    status = None if bench.source is None else bench.source.status()
    lines = {} if status is None else {"warn": status.correction, "info": status.notes}
    return [Remark(level=level, text=line) for level, words in lines.items() for line in words.splitlines()]


async def start_or_stop(visit: "Visit") -> None:
    """Begin a recording, or finish the one that is going on and add it to the files."""
    bench, source = visit.bench, visit.bench.source
    try:
        if source is not None and source.file is None:
            await asyncio.to_thread(start_recording, bench, source)
        elif source is not None and (path := await asyncio.to_thread(source.stop_writing)) is not None:
            await visit.recordings.add(path)
    except (UndriftError, OSError) as error:
        raise InputError(without_folders(str(error), bench.folder)) from error


def _recorded(visit: "Visit") -> None:
    """Say where the last recording is."""
    chosen = visit.recordings.chosen
    if chosen is not None and chosen.path.name.startswith("live-"):
        with ui.element("p"):
            parts.text("span", f"Recorded: {chosen.path.name}. ")
            ui.link("Download it", visit.bench.link(chosen.path) + "?download=1")
            parts.text("span", " or ")
            ui.link("correct it", "/use")


def start_recording(bench: "Bench", source: LiveDevice) -> None:
    """Begin a file of raw readings in a folder of its own among the recordings, listed from its start."""
    bench.library.check_room()
    name = f"live-{datetime.now():%Y-%m-%d-%H%M%S}-{safe_name(source.name, 'device')}"
    folder = bench.folder / "uploads" / name
    folder.mkdir(parents=True, exist_ok=True)
    stored = bench.library.file_at(source.write_to(folder / f"{name}.parquet"), bench.device)
    stored.about = {"summary": "not finished; choose it to see what it holds"}
    stored.save()


def _files(visit: "Visit") -> tuple[Path, ...]:
    """Return the calibrations of the bench, newest first, and what is used."""
    sent = [one.path for one in visit.library.files if one.kind == "calibration"]
    made = [*(job.calibration for job in visit.library.jobs), *sent]
    source = visit.bench.source
    used = [visit.calibration, None if source is None else source.calibration_file]
    return tuple(dict.fromkeys(path for path in (*made, *used) if path is not None))


def _settings(visit: "Visit") -> None:
    """Add the choice of a calibration, which another browser may change, and the axes of the pitch."""
    bench, paths = visit.bench, dict[str, Path]()
    for path in _files(visit):
        name = visit.library.name_of(path)
        paths[name if name not in paths else f"{name} ({path.parent.name})"] = path
    axes: list[Face] = [*(("+x", "+z") if bench.source is None else bench.source.axes)]

    def now() -> str:
        used = visit.calibration if bench.source is None else bench.source.calibration_file
        return next((name for name, path in paths.items() if path == used), NONE)

    def keep(name: str) -> None:
        visit.calibration, visit.corrected = paths.get(name), (bench.source, "another")

    def turn() -> None:
        if bench.source is None:
            raise InputError("Wanted a device, got none; connect it first")
        bench.source.set_axes(*axes)

    parts.text("h2", "Correction and pitch")
    with parts.row():
        chosen = parts.Field("Calibration", now(), options=(NONE, *paths), keep=keep)
        for k, way in enumerate(("forward", "up")):
            parts.Field(
                f"Axis that points {way}",
                axes[k],
                options=FACES,
                keep=lambda axis, k=k: axes.__setitem__(k, axis),  # type: ignore[misc]
            )
        parts.button("Set axes", turn)
    parts.bound(lambda: None if chosen.value == now() or visit.corrected[1] == "another" else chosen.set(now()))


# ---- Calibration from motion


@dataclass(slots=True, kw_only=True)
class MotionForm:
    """What calibration from motion may use, of the device or of a recording."""

    prior: Path | None = None
    magnetometer: tuple[str, ...] = ()

    def words(self) -> tuple[object, ...]:
        """Return the options of the command."""
        return "--from", "motion", *stated(prior=self.prior), *(("--magnetometer",) if self.magnetometer else ())


class MotionCalibration:
    """Calibrates the device that is connected while a person moves it."""

    def __init__(self, bench: "Bench") -> None:
        self._bench, self.error, self.done, self._form = bench, "", False, MotionForm()
        self.watch: MotionWatch | None = None
        self._task: asyncio.Task[None] | None = None

    def start(self, form: MotionForm) -> None:
        """Begin to collect readings in a job of their own."""
        self._form = replace(form)
        source, place = self._bench.source, Place(gravity_m_s2=self._bench.place.gravity_m_s2)
        if source is None:
            raise InputError("motion: wanted a device that sends, got none; connect it first")
        fit = motion_fit(form.prior, identify_adc=False, magnetometer=bool(form.magnetometer))
        job = self._bench.new_job(source.name)
        self.watch = MotionWatch(source, job.folder / "motion.parquet", fit, place, LiveMotion.enough_percent)
        self.error, self.done, self._task = "", False, asyncio.create_task(self._follow(self.watch))

    async def finish(self) -> str | None:
        """Calibrate from the readings that there are; return the page of the result."""
        watch, self.watch, job = self.watch, None, self._bench.job
        path = None if watch is None else await asyncio.to_thread(watch.source.stop_writing)
        if path is None or job is None:
            self.error = "motion: wanted readings, got none; begin again"
            return None
        self.error = (await self._bench.calibrate(job, path, "--gaps", "keep", *self._form.words())).error
        self.done = not self.error
        return "/calibrate" if self.done else None

    async def _follow(self, watch: MotionWatch) -> None:
        while watch is self.watch and not (watch.enough or watch.lost):
            await asyncio.sleep(watch.pause_s)
            try:
                await asyncio.to_thread(watch.look)
            except UndriftError as error:
                self.watch, self.error = None, str(error)
                await asyncio.to_thread(watch.source.stop_writing)
        if watch is self.watch:
            await self.finish()


def motion_controls(visit: "Visit") -> None:
    """Ask what calibration from motion may use: the prior of a part, dropped on the page Check, and the magnetometer."""
    motion, files = visit.motion, [one.path for one in visit.library.files if one.kind == "prior"]
    paths = {"published sizes": None} | {path.name: path for path in files}
    now = next(name for name, path in paths.items() if path == motion.prior)
    with parts.row("form"):
        parts.Field("--prior", now, options=tuple(paths), keep=lambda name: setattr(motion, "prior", paths[name]))
        parts.choices("Magnetometer", ("calibrate it too",), motion, "magnetometer")


def _motion(visit: "Visit") -> None:
    """Add what calibrates the device from its motion: how far each element is known, and what to do next."""
    bench, motion = visit.bench, visit.bench.motion
    with parts.section("Calibrate from motion"):
        parts.text("h2", "Calibrate from motion")
        parts.text("p", "Turn the device by hand as the page asks. It ends when every element is known well enough.")
        parts.redrawn(lambda: len(visit.library.files), lambda: motion_controls(visit))
        parts.button(
            lambda: "Start to calibrate" if motion.watch is None else "End and calibrate",
            lambda: motion.start(visit.motion) if motion.watch is None else motion.finish(),
        )
        parts.status_line(lambda: "" if motion.watch is None else motion.watch.words.replace("\n", ". "), "asked")
        parts.error_line(lambda: motion.error)
        parts.redrawn(lambda: motion.done and bench.job, lambda: _result_link(bench))
        parts.drawing("bars", lambda: _known(motion.watch))


def _result_link(bench: "Bench") -> None:
    if bench.motion.done:
        ui.link("See the result", "/calibrate" + ("" if bench.job is None else f"?job={quote(bench.job.folder.name)}"))


def _known(watch: MotionWatch | None) -> list[object]:
    elements = () if watch is None else watch.elements
    rows = list[object]()
    for k, first in list(enumerate(elements))[::3]:
        axes = elements[k : k + 3]
        three = [(e.axis, f"{e.uncertainty:.2g}", min(1.0, e.wanted / e.uncertainty), e.name) for e in axes]
        rows.append((f"{first.name}, {first.wanted:.2g} {first.unit}", three))
    return rows
