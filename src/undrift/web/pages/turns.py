"""Turns by hand: turn the device once about each axis, both ways; then calibrate."""

import math
from collections.abc import Callable
from functools import partial
from operator import methodcaller

from nicegui import ui

from undrift.record import Face
from undrift.web.bench import Bench
from undrift.web.drawings import box
from undrift.web.frame import button, frame, next_step, redrawn, refused, text
from undrift.web.guided import Guided, guided_of
from undrift.web.pages.guide_parts import (
    guide_part,
    practice_part,
    progress_part,
    readings_part,
    state_of,
    watched,
    without_device,
)
from undrift.web.turns import REST_S, WAYS, asked, named

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

    def what() -> tuple[str, str]:
        way = guide.wanted
        return (box("+z"), "All turns are captured") if way is None else (box(UPS[way[1]], way[0]), asked(way))

    guide_part(what, lambda: guide.light, REST_S)
    redrawn(lambda: (guide.complete, guide.enough, bool(bench.working), guided.refused), lambda _: _next(bench, guided))
    lays = [(f"{up} up", methodcaller("lay", up)) for up in UPS.values()]
    turns = [
        (f"{axis} {name}", methodcaller("turn", axis, sign * 2.0 * math.pi))
        for axis in UPS
        for name, sign in (("counter-clockwise", 1.0), ("clockwise", -1.0))
    ]
    practice_part(bench, [("Practice device: lay it", lays), ("Practice device: turn it once about", turns)])
    names = [(way, named(way).capitalize()) for way in WAYS]
    progress_part("Turns", names, lambda: [*guide.done], lambda: guide.again, guide.redo)
    readings_part(bench)


def _next(bench: Bench, guided: Guided) -> None:
    if bench.working:
        text("p", "Calibrating. The result opens when it is done.")
        return
    refused(bench, bench.job, guided.refused, partial(setattr, guided, "refused"))
    if guided.turns.complete:
        next_step("Calibrate", _calibrating(bench, guided))
    else:
        text("p", "Leave it at rest, turn it along an edge back to the mark, and leave it at rest again.", "soft")
        if guided.turns.enough:
            button("Calibrate with these turns", _calibrating(bench, guided))


def _calibrating(bench: Bench, guided: Guided) -> Callable[[], object]:
    async def calibrate() -> None:
        job = bench.job
        if job is None:
            return
        outcome = await bench.calibrate(job, job.session)
        guided.refused = outcome.error
        if outcome.done:
            ui.navigate.to("/result")

    return calibrate
