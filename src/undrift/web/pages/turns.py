"""Turns by hand: turn the device once about each axis, both ways; then calibrate."""

import math
from collections.abc import Callable
from functools import partial

from nicegui import ui

from undrift.record import Axis, Face
from undrift.web.bench import Bench
from undrift.web.drawings import box
from undrift.web.frame import REFRESH_S, button, frame, next_step, redrawn, set_text, text
from undrift.web.guided import Guided, guided_of
from undrift.web.pages.guide_parts import (
    Picture,
    light_part,
    practice_part,
    progress_part,
    readings_part,
    state_of,
    watched,
    without_device,
)
from undrift.web.turns import REST_S, WAYS, asked, named

AXES: tuple[Axis, Axis, Axis] = ("x", "y", "z")
UPS: dict[str, Face] = {"x": "+x", "y": "+y", "z": "+z"}


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Turns by hand"):
        redrawn(lambda: state_of(bench), lambda look: _shown(bench))


def _shown(bench: Bench) -> None:
    guided = guided_of(bench)
    if guided is None:
        without_device(bench, "Turn the device once about each axis. It calibrates the gyroscopes. Connect it first.")
        return
    if not guided.faces.complete:
        text("p", f"The six faces come first: {len(guided.capture.faces)} of 6 are captured.")
        next_step("Go to six faces", "/six-faces")
        return
    guide = guided.turns
    watched(bench, guided, "turns")
    with ui.element("div").classes("guide"):
        drawing = Picture()
        with ui.element("div"):
            words = text("p", "", "asked")
            light_part(lambda: guide.light, REST_S)

    def refresh() -> None:
        way = guide.wanted
        drawing.draw(box("+z") if way is None else box(_up(way), way[0]))
        set_text(words, "All turns are captured" if way is None else asked(way))

    refresh()
    ui.timer(REFRESH_S, refresh)
    redrawn(lambda: (guide.complete, guide.enough, bool(bench.working)), lambda look: _next(bench, guided))
    lays = [(f"{UPS[axis]} up", partial(_lay, bench, axis)) for axis in AXES]
    turns = [
        (f"{axis} {name}", partial(_turn, bench, axis, sign))
        for axis in AXES
        for name, sign in (("counter-clockwise", 1.0), ("clockwise", -1.0))
    ]
    practice_part(bench, [("Practice device: lay it", lays), ("Practice device: turn it once about", turns)])
    names = [(way, named(way).capitalize()) for way in WAYS]
    progress_part("Turns", names, lambda: [*guide.done], lambda: guide.again, guide.redo)
    readings_part(bench)


def _next(bench: Bench, guided: Guided) -> None:
    if bench.working:
        text("p", "Calibrating. The result opens when it is done.")
    elif guided.turns.complete:
        next_step("Calibrate", _calibrating(bench))
    else:
        text("p", "Leave it at rest, turn it along an edge back to the mark, and leave it at rest again.", "soft")
        if guided.turns.enough:
            button("Calibrate with these turns", _calibrating(bench))


def _calibrating(bench: Bench) -> Callable[[], object]:
    async def calibrate() -> None:
        job = bench.job
        if job is None:
            return
        outcome = await bench.calibrate(job, job.session)
        if outcome.done:
            ui.navigate.to("/result")
        elif isinstance(job.capture, Guided):
            job.capture.error = outcome.error

    return calibrate


def _up(way: str) -> Face:
    return UPS[way[1]]


def _lay(bench: Bench, axis: Axis) -> None:
    if bench.practice is not None:
        bench.practice.lay(UPS[axis])


def _turn(bench: Bench, axis: Axis, sign: float) -> None:
    if bench.practice is not None:
        bench.practice.turn(axis, sign * 2.0 * math.pi)
