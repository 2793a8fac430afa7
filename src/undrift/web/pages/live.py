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
from undrift.web.commands import Remark, without_folders
from undrift.web.feed import Panel
from undrift.web.frame import (
    Field,
    button,
    connect_form,
    error_line,
    frame,
    next_step,
    redrawn,
    remarks_list,
    set_text,
    text,
)
from undrift.web.source import Source, Status
from undrift.web.uploads import safe_name

LOOK_S = 0.5
NONE = "none: raw readings"
WAYS = ("forward", "up")


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Live"):
        words = text("p", "", "live-status")
        doing: list[str] = []  # what went wrong with the last click
        error_line(lambda: " ".join((*_wrong(bench), *doing)))
        record = next_step("Start recording", lambda: start_or_stop(bench, doing))
        hint = text("p", "Connect a device below. The practice device is a simulated sensor.")
        redrawn(lambda: _remarks(bench), lambda _: remarks_list(_remarks(bench)))
        redrawn(lambda: bench.recordings.chosen and bench.recordings.chosen.path, lambda _: _recorded(bench))
        Panel()
        shown: list[Field] = []  # the choice of a calibration; another browser may change it
        redrawn(lambda: _files(bench), lambda _: _settings(bench, shown))
        connect_form(bench)

    def refresh() -> None:
        status = None if bench.source is None else bench.source.status()
        set_text(words, "" if status is None else status_line(status))
        set_text(record, "Start recording" if status is None or status.file is None else "Stop recording")
        record.set_visibility(status is not None)
        hint.set_visibility(status is None)
        if shown and shown[-1].value != (now := _name(bench.calibration)):
            shown[-1].set(now)

    async def look() -> None:
        refresh()
        source = bench.source
        if source is not None and source.calibration_file != bench.calibration:
            await asyncio.to_thread(source.use, bench.calibration)

    refresh()
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


def _wrong(bench: Bench) -> list[str]:
    """Return what is wrong in plain words: with the connection, the file."""
    if bench.source is None:
        return []
    status = bench.source.status()
    lost = f"{status.error}. The bench tries again by itself." if status.error else ""
    return [words for words in (lost, status.file_error) if words]


def _remarks(bench: Bench) -> list[Remark]:
    """Return what the correction warns of, and what a reader of it should know."""
    status = None if bench.source is None else bench.source.status()
    lines = {} if status is None else {"warn": status.correction, "info": status.notes}
    return [Remark(level=level, text=line) for level, words in lines.items() for line in words.splitlines()]


async def start_or_stop(bench: Bench, wrong: list[str]) -> None:
    """Begin a recording, or finish the one that is going on and add it to the page Recordings."""
    source = bench.source
    wrong.clear()
    if source is None:
        return
    try:
        if source.status().file is None:
            await asyncio.to_thread(start_recording, bench, source)
        elif (path := await asyncio.to_thread(source.stop_writing)) is not None:
            await bench.recordings.add(path)
    except (UndriftError, OSError) as error:
        wrong.append(without_folders(str(error), bench.folder))


def _recorded(bench: Bench) -> None:
    """Say where the last recording is."""
    chosen = bench.recordings.chosen
    if chosen is not None and chosen.path.name.startswith("live-"):
        with ui.element("p"):
            text("span", f"Recorded: {chosen.path.name}. ")
            ui.link("Download it", bench.link(chosen.path) + "?download=1")
            text("span", " or ")
            ui.link("correct it", "/recordings")


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


def _name(path: Path | None) -> str:
    return NONE if path is None else f"{path.parent.name}/{path.name}"


def _settings(bench: Bench, shown: list[Field]) -> None:
    """Add the choice of a calibration, and the axes of the pitch."""
    paths = {_name(path): path for path in _files(bench)}
    text("h2", "Correction and pitch")
    with ui.element("div").classes("row"):
        chosen = Field("Calibration", _name(bench.calibration), options=(NONE, *paths))
        shown[:] = [chosen]

        def choose(event: Any) -> None:
            bench.calibration = paths.get(str(event.args))

        chosen.element.on("change", choose, js_handler="(event) => emit(event.target.value)")
        given = ("+x", "+z") if bench.source is None else bench.source.axes
        axes = [Field(f"Axis that points {way}", axis, options=FACES) for way, axis in zip(WAYS, given, strict=True)]
        button("Set axes", lambda: turn())  # noqa: PLW0108 (defined below, with the line that it writes to)
    wrong = text("p", "", "bench-error").props('role="alert"')

    def turn() -> None:
        forward, up = (next(face for face in FACES if face == axis.value) for axis in axes)
        set_text(wrong, "" if bench.source is not None else "Wanted a device, got none; connect it first")
        try:
            if bench.source is not None:
                bench.source.set_axes(forward, up)
        except UndriftError as error:
            set_text(wrong, str(error))
