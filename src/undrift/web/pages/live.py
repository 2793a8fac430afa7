"""Live: what the device reads now, raw against corrected, pitch and temperature; recorded to a file on request."""

import asyncio
import math
from datetime import datetime
from pathlib import Path
from typing import Any

from nicegui import ui

from undrift.errors import UndriftError
from undrift.record import FACES
from undrift.web.bench import Bench
from undrift.web.connect import connect_form
from undrift.web.frame import Field, button, error_line, frame, next_step, redrawn, set_text, text, text_link
from undrift.web.panel import Panel
from undrift.web.source import Source, Status
from undrift.web.uploads import safe_name

LOOK_S = 0.5
NONE = "none: raw readings"


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Live"):
        words = text("p", "", "live-status")
        error_line(lambda: _wrong(bench))
        redrawn(lambda: _state(bench), lambda refresh: _step(bench, refresh))
        Panel()
        redrawn(lambda: (bench.source, bench.calibration, _files(bench)), lambda refresh: _settings(bench, refresh))
        connect_form(bench)

    async def look() -> None:
        source = bench.source
        set_text(words, "" if source is None else status_line(source.status()))
        if source is not None and source.calibration_file != bench.calibration:
            await asyncio.to_thread(source.use, bench.calibration)

    ui.timer(LOOK_S, look)


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


def _wrong(bench: Bench) -> str:
    """Return what is wrong in plain words: the connection, or the correction."""
    if bench.source is None:
        return ""
    status = bench.source.status()
    return f"{status.error}. The bench tries again by itself." if status.error else status.correction


def _state(bench: Bench) -> object:
    source = bench.source
    return source, source and source.status().file, bench.recordings.chosen, bool(bench.connecting)


def _step(bench: Bench, refresh: Any) -> None:
    """Add the one next step: connect, record, or stop."""
    source, chosen = bench.source, bench.recordings.chosen

    async def start() -> None:
        if source is not None:
            await asyncio.to_thread(start_recording, bench, source)
        refresh()

    async def stop() -> None:
        path = None if source is None else await asyncio.to_thread(source.stop_writing)
        if path is not None:
            await bench.recordings.add(path)
        refresh()

    if source is None:
        text("p", "Connect a device below. The practice device is a simulated sensor.")
    elif source.status().file is None:
        next_step("Start recording", start)
    else:
        next_step("Stop recording", stop)
    if chosen is not None and chosen.path.name.startswith("live-"):
        with ui.element("p"):
            text("span", f"Recorded: {chosen.path.name}. ")
            text_link("Download it", bench.link(chosen.path) + "?download=1")
            text("span", " or ")
            text_link("correct it", "/recordings")


def start_recording(bench: Bench, source: Source) -> Path:
    """Begin a file of raw readings in a folder of its own among the recordings."""
    name = f"live-{datetime.now():%Y-%m-%d-%H%M%S}-{safe_name(source.name, 'device')}"
    folder = bench.folder / "uploads" / name
    folder.mkdir(parents=True, exist_ok=True)
    source.write_to(folder / f"{name}.parquet")
    return folder / f"{name}.parquet"


def _files(bench: Bench) -> tuple[Path, ...]:
    """Return the calibrations of the bench, newest first."""
    made = sorted(bench.folder.glob("jobs/*/calibration.json"), reverse=True)
    sent = [one.path for one in bench.recordings.files if one.kind == "calibration"]
    other = [] if bench.calibration is None else [bench.calibration]
    return tuple(dict.fromkeys((*made, *sent, *other)))


def _settings(bench: Bench, refresh: Any) -> None:
    """Add the choice of a calibration, and the axes of the pitch."""
    names = {f"{path.parent.name}/{path.name}": path for path in _files(bench)}
    now = next((name for name, path in names.items() if path == bench.calibration), NONE)
    text("h2", "Correction and pitch")
    with ui.element("div").classes("row"):
        chosen = Field("Calibration", now, options=(NONE, *names))

        def choose(event: Any) -> None:
            bench.calibration = names.get(str(event.args))
            refresh()

        chosen.element.on("change", choose, js_handler="(event) => emit(event.target.value)")
        source = bench.source
        if source is None:
            return
        axes = [
            Field(f"Axis that points {way}", axis, options=FACES)
            for way, axis in zip(("forward", "up"), source.axes, strict=True)
        ]
        wrong = text("p", "", "bench-error").props('role="alert"')

        def turn() -> None:
            forward, up = (next(face for face in FACES if face == axis.value) for axis in axes)
            try:
                source.set_axes(forward, up)
                set_text(wrong, "")
            except UndriftError as error:
                set_text(wrong, str(error))

        button("Set axes", turn)
