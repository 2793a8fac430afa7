"""The page Live: what the device reads now, raw against corrected, pitch and temperature; recorded to a file on request.

A device may be calibrated from its motion there: ``MotionCalibration`` collects and fits until each element is known well enough.
"""

import asyncio
import math
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui

from undrift.base.options import stated
from undrift.commands.bench.source import LiveDevice, Status
from undrift.commands.files import Place
from undrift.commands.live_motion import LiveMotion, MotionWatch, motion_fit
from undrift.errors import InputError, UndriftError
from undrift.record import FACES, Face
from undrift.web import parts
from undrift.web.commands import Remark, without_folders
from undrift.web.feed import Panel
from undrift.web.start import connect_form
from undrift.web.uploads import safe_name

if TYPE_CHECKING:
    from undrift.web.bench import Bench

NONE = "none: raw readings"


def page(bench: "Bench") -> None:
    """Build the page."""

    async def use() -> None:
        source = bench.source
        if source is not None and source.calibration_file != bench.calibration:
            await asyncio.to_thread(source.use, bench.calibration)

    def label() -> str:
        return "Start recording" if bench.source is None or bench.source.status().file is None else "Stop recording"

    with parts.frame(bench, "Live"):
        parts.text("p", lambda: "" if bench.source is None else status_line(bench.source.status()), "live-status")
        parts.error_line(lambda: " ".join(_wrong(bench)))
        step = parts.next_step(label, lambda: start_or_stop(bench))
        parts.shown_if(step, lambda: bench.source is not None and bench.motion.watch is None)
        hint = parts.text("p", "Connect a device below. The practice device is a simulated sensor.")
        parts.shown_if(hint, lambda: bench.source is None)
        parts.redrawn(lambda: _remarks(bench), lambda: parts.remarks_list(_remarks(bench)))
        parts.redrawn(lambda: bench.recordings.chosen and bench.recordings.chosen.path, lambda: _recorded(bench))
        parts.shown_if(Panel(), lambda: bench.motion.watch is None)  # what to do next is at hand
        _motion(bench)
        parts.redrawn(lambda: _files(bench), lambda: _settings(bench))
        connect_form(bench)
        parts.bound(use)


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


async def start_or_stop(bench: "Bench") -> None:
    """Begin a recording, or finish the one that is going on and add it to the page Recordings."""
    source = bench.source
    if source is None:
        return
    try:
        if source.status().file is None:
            await asyncio.to_thread(start_recording, bench, source)
        elif (path := await asyncio.to_thread(source.stop_writing)) is not None:
            await bench.recordings.add(path)
    except (UndriftError, OSError) as error:
        raise InputError(without_folders(str(error), bench.folder)) from error


def _recorded(bench: "Bench") -> None:
    """Say where the last recording is."""
    chosen = bench.recordings.chosen
    if chosen is not None and chosen.path.name.startswith("live-"):
        with ui.element("p"):
            parts.text("span", f"Recorded: {chosen.path.name}. ")
            ui.link("Download it", bench.link(chosen.path) + "?download=1")
            parts.text("span", " or ")
            ui.link("correct it", "/recordings")


def start_recording(bench: "Bench", source: LiveDevice) -> Path:
    """Begin a file of raw readings in a folder of its own among the recordings."""
    name = f"live-{datetime.now():%Y-%m-%d-%H%M%S}-{safe_name(source.name, 'device')}"
    folder = bench.folder / "uploads" / name
    folder.mkdir(parents=True, exist_ok=True)
    source.write_to(folder / f"{name}.parquet")
    return folder / f"{name}.parquet"


def _files(bench: "Bench") -> tuple[Path, ...]:
    """Return the calibrations of the bench, newest first."""
    made = sorted(bench.folder.glob("jobs/*/calibration.json"), reverse=True)
    sent = [one.path for one in bench.recordings.files if one.kind == "calibration"]
    other = [] if bench.calibration is None else [bench.calibration]
    return tuple(dict.fromkeys((*made, *sent, *other)))


def _name(path: Path | None) -> str:
    return NONE if path is None else f"{path.parent.name}/{path.name}"


def _settings(bench: "Bench") -> None:
    """Add the choice of a calibration, which another browser may change, and the axes of the pitch."""
    paths = {_name(path): path for path in _files(bench)}
    axes: list[Face] = [*(("+x", "+z") if bench.source is None else bench.source.axes)]

    def follow() -> None:
        if chosen.value != (now := _name(bench.calibration)):
            chosen.set(now)

    def turn() -> None:
        if bench.source is None:
            raise InputError("Wanted a device, got none; connect it first")
        bench.source.set_axes(*axes)

    parts.text("h2", "Correction and pitch")
    with parts.row():
        chosen = parts.Field(
            "Calibration",
            _name(bench.calibration),
            options=(NONE, *paths),
            keep=lambda name: setattr(bench, "calibration", paths.get(name)),
        )
        for k, way in enumerate(("forward", "up")):
            parts.Field(
                f"Axis that points {way}",
                axes[k],
                options=FACES,
                keep=lambda axis, k=k: axes.__setitem__(k, axis),  # type: ignore[misc]
            )
        parts.button("Set axes", turn)
    parts.bound(follow)


# ---- Calibration from motion


class MotionCalibration:
    """Calibrates the device that is connected while a person moves it; what it may use holds for recordings too."""

    def __init__(self, bench: "Bench") -> None:
        self._bench, self.error, self.done = bench, "", False
        self.watch: MotionWatch | None = None
        self.prior: Path | None = None
        self.magnetometer: tuple[str, ...] = ()
        self._task: asyncio.Task[None] | None = None

    def words(self) -> tuple[object, ...]:
        """Return the options of the command."""
        return "--from", "motion", *stated(prior=self.prior), *(("--magnetometer",) if self.magnetometer else ())

    def start(self) -> None:
        """Begin to collect readings in a job of their own."""
        source, place = self._bench.source, Place(gravity_m_s2=self._bench.place.gravity_m_s2)
        if source is None:
            raise InputError("motion: wanted a device that sends, got none; connect it first")
        job, fit = (
            self._bench.new_job(source.name),
            motion_fit(self.prior, identify_adc=False, magnetometer=bool(self.magnetometer)),
        )
        self.watch = MotionWatch(source, job.folder / "motion.parquet", fit, place, LiveMotion.enough_percent)
        self.error, self.done, self._task = "", False, asyncio.create_task(self._follow(self.watch))

    async def finish(self) -> str | None:
        """Calibrate from the readings that there are; return the page of the result."""
        watch, self.watch, job = self.watch, None, self._bench.job
        path = None if watch is None else await asyncio.to_thread(watch.source.stop_writing)
        if path is None or job is None:
            self.error = "motion: wanted readings, got none; begin again"
            return None
        self.error = (await self._bench.calibrate(job, path, "--gaps", "keep", *self.words())).error
        self.done = not self.error
        return "/result" if self.done else None

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


def motion_controls(bench: "Bench") -> None:
    """Ask what calibration from motion may use: the prior of a part, dropped on the page Recordings, and the magnetometer."""
    motion, files = bench.motion, [one.path for one in bench.recordings.files if one.kind == "prior"]
    paths = {"published sizes": None} | {path.name: path for path in files}
    now = next(name for name, path in paths.items() if path == motion.prior)
    with parts.row("form"):
        parts.Field("--prior", now, options=tuple(paths), keep=lambda name: setattr(motion, "prior", paths[name]))
        parts.choices("Magnetometer", ("calibrate it too",), motion, "magnetometer")


def _motion(bench: "Bench") -> None:
    """Add what calibrates the device from its motion: how far each element is known, and what to do next."""
    motion = bench.motion
    with parts.section("Calibrate from motion"):
        parts.text("h2", "Calibrate from motion")
        parts.text("p", "Turn the device by hand as the page asks. It ends when every element is known well enough.")
        parts.redrawn(lambda: len(bench.recordings.files), lambda: motion_controls(bench))
        parts.button(
            lambda: "Start to calibrate" if motion.watch is None else "End and calibrate",
            lambda: motion.start() if motion.watch is None else motion.finish(),
        )
        parts.status_line(lambda: "" if motion.watch is None else motion.watch.words.replace("\n", ". "), "asked")
        parts.error_line(lambda: motion.error)
        parts.shown_if(ui.link("See the result", "/result"), lambda: motion.done)
        parts.redrawn(lambda: motion.watch and motion.watch.elements, lambda: _known(motion.watch))


def _known(watch: MotionWatch | None) -> None:
    elements = () if watch is None else watch.elements
    groups = [elements[k : k + 3] for k in range(0, len(elements), 3)]
    if groups:
        rows = [
            [
                (f"{three[0].name}, {three[0].wanted:.2g} {three[0].unit}", "head"),
                *(parts.Parts(partial(_bar, one)) for one in three),
            ]
            for three in groups
        ]
        parts.table("Known to, 95 %; a full bar is enough", ("Element, wanted", "", "", ""), rows)


def _bar(one: Any) -> None:
    share = min(1.0, one.wanted / one.uncertainty)
    parts.text("span", f"{one.axis} {one.uncertainty:.2g}", "good" if one.enough else "").style("white-space: nowrap")
    bar = ui.element("progress").classes("bar").props(f"max=1 value={share:.2f}")
    bar.props["aria-label"] = f"{one.name} {one.axis}"
