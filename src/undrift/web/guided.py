"""The pages Six faces and Turns by hand: a guide that runs on the server, its instructions, its light, and the
captures.

A capture continues to read the connected device if a page is reloaded, opened twice or closed. Captures are written
immediately.
"""

import asyncio
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from operator import methodcaller
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import background_tasks, ui

from undrift.commands.bench.capture import COUNTDOWN_S, Capture
from undrift.commands.bench.guides import ORDER, REST_S, WAYS, Guide, SixFaces, Turns, asked, named
from undrift.errors import UndriftError
from undrift.record import Face
from undrift.web import parts
from undrift.web.device import connect_form

if TYPE_CHECKING:
    from undrift.commands.bench.library import Job
    from undrift.web.bench import Bench, Visit

PERIOD_S = 0.2
UNSEEN_S = 600.0  # host s without a page that looks, after which it pauses
DONE_S = 5.0  # the same when all is captured
MOST_S = 100.0  # of readings that are taken at once
SAID_AT = (6, 3)  # seconds left that are read out
UPS: dict[str, Face] = {"x": "+x", "y": "+y", "z": "+z"}
Moves = Sequence[tuple[str, Callable[[Any], object]]]  # of the practice device, by their names


class Guided:
    """One job's capture, and which of its guides is at work."""

    def __init__(self, bench: "Bench", job: "Job") -> None:
        self._bench, self._job = bench, job
        self.capture = Capture(job.session, job.serial)
        self.faces, self.turns = SixFaces(self.capture), Turns(self.capture)
        self.guide: Guide = self.faces
        self.error = self.refused = ""  # errors of the capture and of the last calibration
        self._seen_s, self._taken_s = -UNSEEN_S, time.monotonic()

    def look(self, guide: Guide) -> None:
        """Make the guide of a page the active guide."""
        self.guide, self._seen_s = guide, time.monotonic()

    async def run(self) -> None:
        """Feed the guide until another job is begun."""
        while self._bench.job is self._job:
            now = time.monotonic()
            if now - self._seen_s < (DONE_S if self.guide.wanted is None else UNSEEN_S):
                await self._step(now)
            await asyncio.sleep(PERIOD_S)

    async def _step(self, now: float) -> None:
        source = self._bench.source
        record = None if source is None else source.recent(min((now - self._taken_s + 1.0) * source.speed, MOST_S))
        self._taken_s = now if record is not None else self._taken_s
        self.error = ""
        try:
            self.guide.update(record, now, source)
            if not self.capture.saved and (self.capture.faces or self.capture.turns):
                place = self._bench.place
                self.capture.gravity_m_s2 = place.gravity_m_s2 if place.words() else None
                session, self.capture.saved = self.capture.session(), True
                await asyncio.to_thread(self.capture.save, session)
        except UndriftError as error:
            self.error, self.capture.saved = str(error), False

    async def calibrate(self, visit: "Visit") -> str | None:
        """Calibrate from the captures. Return the page of the result."""
        outcome = await visit.calibrate(self._job, self._job.session)
        self.refused = outcome.error
        return "/calibrate" if outcome.done else None


def guided_of(bench: "Bench") -> Guided | None:
    """Return the guided capture of the connected device. Create it if needed. Return None without a device."""
    job, source = bench.job, bench.source
    if source is None:
        return None if job is None else job.capture
    if job is not None and job.capture is not None and job.serial == source.name:
        guided: Guided = job.capture
        return guided
    if job is None or job.calibration is not None or job.capture is not None or job.serial != source.name:
        job = bench.new_job(source.name)
    job.capture = Guided(bench, job)
    background_tasks.create(job.capture.run(), name="guided capture")
    return job.capture  # type: ignore[no-any-return]


def begin_anew(bench: "Bench") -> None:
    """Keep the previous captures in their folder, and begin with an empty capture."""
    if bench.source is not None:
        bench.job = None
        guided_of(bench)


# ---- The pages


def page(title: str, visit: "Visit") -> None:
    """Build one of the two pages, by its title."""
    bench = visit.bench
    why, show = {
        "Six faces": ("Lay the device on each of its six faces. It calibrates the accelerometers.", _faces),
        "Turns by hand": ("Turn the device once about each axis. It calibrates the gyroscopes.", _turns),
    }[title]

    def draw() -> None:
        guided = guided_of(bench)
        if guided is None:
            parts.text("p", f"{why} Connect it first.")
            connect_form(visit)
        else:
            show(visit, guided)

    parts.redrawn(lambda: (bench.source, None if bench.job is None else bench.job.capture), draw)


def _faces(visit: "Visit", guided: Guided) -> None:
    bench = visit.bench
    guide = guided.faces
    _watch(bench, guided, guide)
    _guide_part(
        guide,
        lambda: [next((face for face in ORDER if face == guide.wanted), guide.light.face or "+z")],
        lambda: f"Turn {guide.wanted} up" if guide.wanted else "All six faces are captured",
        COUNTDOWN_S,
    )
    parts.redrawn(lambda: guide.complete, lambda: _after_faces(guide.complete))
    _practice_part(bench, {"Practice device: turn it": [(f"{face} up", methodcaller("lay", face)) for face in ORDER]})
    _progress_part("Faces", guide, {face: f"{face} up" for face in ORDER})
    _readings_part(bench)
    with parts.row():
        parts.button("Start over", lambda: begin_anew(bench))


def _after_faces(complete: bool) -> None:
    if complete:
        parts.next_step("Continue to turns by hand", "/turns")
    else:
        parts.text("p", "In any order. Lay the device down and let go. It is recorded automatically.", "soft")


def _turns(visit: "Visit", guided: Guided) -> None:
    bench = visit.bench
    if not guided.faces.complete:
        parts.text("p", f"The six faces come first: {len(guided.capture.faces)} of 6 are captured.")
        parts.next_step("Go to six faces", "/six-faces")
        return
    guide = guided.turns
    _watch(bench, guided, guide)
    _guide_part(
        guide,
        lambda: [UPS[guide.wanted[1]], guide.wanted[0]] if guide.wanted else ["+z"],
        lambda: asked(guide.wanted) if guide.wanted else "All turns are captured",
        REST_S,
    )
    parts.redrawn(
        lambda: (guide.complete, guide.enough, bool(bench.working), guided.refused), lambda: _after_turns(visit, guided)
    )
    lays: Moves = [(f"{up} up", methodcaller("lay", up)) for up in UPS.values()]
    ways = [(axis, *way) for axis in UPS for way in (("counter-clockwise", 1.0), ("clockwise", -1.0))]
    turns: Moves = [(f"{axis} {name}", methodcaller("turn", axis, sign * math.tau)) for axis, name, sign in ways]
    _practice_part(bench, {"Practice device: lay it": lays, "Practice device: turn it once about": turns})
    _progress_part("Turns", guide, {way: named(way).capitalize() for way in WAYS})
    _readings_part(bench)


def _after_turns(visit: "Visit", guided: Guided) -> None:
    bench = visit.bench
    if bench.working:
        parts.text("p", "Calibrating. The result opens when it is done.")
        return
    parts.refused(visit, bench.job, guided.refused, partial(setattr, guided, "refused"))
    if guided.turns.complete:
        parts.next_step("Calibrate", lambda: guided.calibrate(visit))
    else:
        parts.text("p", "Leave it at rest, turn it along an edge back to the mark, and leave it at rest again.", "soft")
        if guided.turns.enough:
            parts.button("Calibrate with these turns", lambda: guided.calibrate(visit))


# ---- What both show


def _watch(bench: "Bench", guided: Guided, guide: Guide) -> None:
    """Keep a guide active while the page is open, and show errors."""
    parts.bound(lambda: guided.look(guide) if guided_of(bench) is guided else None)
    parts.error_line(lambda: guided.error)


def _guide_part(guide: Guide, box: Callable[[], Sequence[str]], message: Callable[[], str], countdown_s: float) -> None:
    """Add the instructions as a drawing and in words, next to the light with shape, words and countdown. Changes are
    read aloud.
    """

    def spoken() -> str:
        seconds = math.ceil(guide.light.left_s or 0.0)
        return f"{seconds} seconds" if seconds in SAID_AT else ""

    with ui.element("div").classes("guide"):
        parts.drawing("box", box)
        with ui.element("div"):
            parts.text("p", message, "asked")
            with ui.element("div").classes("light"):
                parts.drawing("lamp", lambda: [guide.light.state])
                parts.status_line(lambda: guide.light.text, "light-words").props('aria-live="polite"')
                parts.drawing("ring", lambda: [guide.light.left_s, countdown_s])
            parts.text("p", spoken, "unseen").props('aria-live="polite"')


def _progress_part(title: str, guide: Guide, names: dict[str, str]) -> None:
    """Add a list of the captures, each with its state and a button to record it again."""

    def state(step: str) -> str:
        return "record again" if step == guide.again else "✓ captured" if step in guide.done else "to do"

    parts.text("h2", lambda: f"{title}: {len(guide.done)} of {len(names)}")
    with ui.element("ol").classes("steps"):
        for step, name in names.items():
            with ui.element("li"):
                with ui.element("div").classes("step"):
                    parts.text("span", name, "step-name")
                    parts.text("span", partial(state, step), "step-state")
                press = parts.button(
                    lambda step=step: "Cancel" if step == guide.again else "Redo",  # type: ignore[misc]
                    lambda step=step: guide.redo(None if step == guide.again else step),  # type: ignore[misc]
                    name=f"Redo {name}",
                )
                parts.disabled_if(press, lambda step=step: step not in guide.done)  # type: ignore[misc]


def _readings_part(bench: "Bench") -> None:
    """Add the newest readings as numbers, means of 0.2 s in the device's own units."""

    def means() -> list[object]:
        record, rows = None if bench.source is None else bench.source.recent(0.2), list[object]()
        for name, kind in (("Accelerometer", "accel"), ("Gyroscope", "gyro")):
            values = None if record is None else getattr(record, kind)
            if values is not None:
                values = None if np.isnan(values).all(axis=0).any() else np.nanmean(values, axis=0).tolist()
            rows.append((name, values, getattr(record, f"{kind}_unit", "")))
        return rows

    parts.drawing("readings", means, "readings")


def _practice_part(bench: "Bench", rows: dict[str, Moves]) -> None:
    """Add buttons that move the practice device if it is connected."""
    with parts.shown_if(parts.section("Practice device", "practice"), lambda: bench.practice is not None):
        for title, moves in rows.items():
            parts.text("h2", title)
            with parts.row():
                for name, move in moves:
                    parts.button(name, partial(_moved, bench, move))


def _moved(bench: "Bench", move: Callable[[Any], object]) -> None:
    if bench.practice is not None:
        move(bench.practice)
