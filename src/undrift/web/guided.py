"""The guided recording: six faces, then turns by hand. The guides run on the server, and the page shows them.

A recording continues if the page is reloaded, opened twice or closed. Captures are written immediately.
"""

import asyncio
import json
import math
import time
from typing import TYPE_CHECKING, cast

import numpy as np
from nicegui import background_tasks, ui

from undrift.commands.bench.capture import COUNTDOWN_S, Capture
from undrift.commands.bench.guides import ORDER, REST_S, WAYS, Guide, SixFaces, Turns, asked, named
from undrift.errors import UndriftError
from undrift.record import Axis, Face
from undrift.web.items import Item

if TYPE_CHECKING:
    from undrift.web.bench import Bench

PERIOD_S = 0.2
MOST_S = 100.0  # longest stretch of readings that is processed at once, s
SAID_AT = (6, 3)  # remaining seconds that are announced to screen readers
NAMES = {"face": {face: f"{face} up" for face in ORDER}, "turn": {way: named(way).capitalize() for way in WAYS}}


class Guided:
    """Captures of the connected device, which end when another recording begins."""

    def __init__(self, bench: "Bench", item: Item) -> None:
        self._bench, self.item = bench, item
        self.capture = Capture(item.path, item.serial)
        self.faces, self.turns = SixFaces(self.capture), Turns(self.capture)
        self.error, self._taken_s = "", time.monotonic()
        background_tasks.create(self._run(), name="guided recording")

    @property
    def guide(self) -> Guide:
        """Return the active guide: faces first, then turns."""
        return self.faces if self.faces.wanted is not None else self.turns

    async def _run(self) -> None:
        while self._bench.guided is self:
            if self.guide.wanted is not None:
                await self.step(time.monotonic())
            await asyncio.sleep(PERIOD_S)

    async def step(self, now_s: float) -> None:
        """Process the newest readings, and write the captures."""
        source = self._bench.source
        record = None if source is None else source.recent(min((now_s - self._taken_s + 1.0) * source.speed, MOST_S))
        self._taken_s = now_s if record is not None else self._taken_s
        self.error = ""
        try:
            self.guide.update(record, now_s, source)
            if not self.capture.saved and (self.capture.faces or self.capture.turns):
                gravity_m_s2, stated = self._bench.place.gravity
                self.capture.gravity_m_s2 = None if stated == "standard" else gravity_m_s2
                session, self.capture.saved = self.capture.session(), True
                await asyncio.to_thread(self.capture.save, session)
                self.item.summary = f"{len(self.capture.faces)} faces and {len(self.capture.turns)} turns"
                self.item.save()
                self._bench.changed()
        except UndriftError as error:
            self.error, self.capture.saved = str(error), False

    def redo(self, guide: Guide, step: str) -> None:
        """Request a step again, or cancel the request."""
        guide.redo(None if guide.again == step else step)
        self._bench.changed()

    def move(self) -> None:
        """Move the practice device as the guide requests."""
        device, guide = self._bench.practice, self.guide
        wanted, state = guide.wanted, guide.light.state
        if device is None or wanted is None or device.moving:
            return
        face, axis = cast(Face, wanted if guide is self.faces else f"+{wanted[1]}"), cast(Axis, wanted[1])
        if device.face != face or state == "tilted":
            device.lay(face)
        elif guide is self.turns and state in ("still", "captured"):  # wait until the rest is long enough
            device.turn(axis, math.tau if wanted[0] == "+" else -math.tau)


# ---- The page


def guide_part(guided: Guided) -> None:
    """Add the instructions as a drawing and in words, the light with its countdown, and the newest readings."""
    bench = guided._bench
    with ui.element("div").classes("guide"):
        box = drawing("box")
        with ui.element("div"):
            instruction = ui.label().classes("asked")
            with ui.element("div").classes("light"):
                lamp = drawing("lamp")
                words = ui.label().classes("light-words").props('role="status"')
                ring = drawing("ring")
            spoken = ui.label().classes("unseen").props('role="status"')
            readings = ui.label().classes("readings soft")
            error = ui.label().classes("error").props('role="alert"')

    def look() -> None:
        guide, light = guided.guide, guided.guide.light
        wanted, left_s = guide.wanted, light.left_s
        if guide is guided.faces:
            set_drawing(box, wanted)
            instruction.text = f"Turn {wanted} up"
        else:
            set_drawing(box, *((f"+{wanted[1]}", wanted[0]) if wanted else ("+z",)))
            instruction.text = asked(wanted) if wanted else "All faces and turns are recorded"
        set_drawing(lamp, light.state)
        set_drawing(ring, left_s, COUNTDOWN_S if guide is guided.faces else REST_S)
        words.text, error.text = light.text, bench.plain(guided.error or bench.source.error if bench.source else "")
        seconds = math.ceil(left_s or 0.0)
        spoken.text = f"{seconds} seconds" if seconds in SAID_AT else ""
        readings.text = _readings(bench)

    look()
    ui.timer(PERIOD_S, look)


def progress_part(guided: Guided) -> None:
    """Add the steps with their state. A recorded step can be recorded again."""
    for guide in (guided.faces, guided.turns) if guided.faces.complete else (guided.faces,):
        names = NAMES[guide.step]
        ui.label(f"{guide.step.capitalize()}s: {len(guide.done)} of {len(names)}").classes("heading")
        with ui.row():
            for step, name in names.items():
                done, again = step in guide.done, step == guide.again
                icon = "replay" if again else "check_circle" if done else "radio_button_unchecked"
                button = ui.button(name, icon=icon, color=None, on_click=lambda g=guide, s=step: guided.redo(g, s))
                button.props("outline no-caps" if done else "flat no-caps").set_enabled(done)
                state = "record it again, press to cancel" if again else "recorded, press to redo" if done else "to do"
                button.props["aria-label"] = f"{name}: {state}"
    if guided.capture.faces or guided.capture.turns:
        ui.label("Press a recorded step to record it again.").classes("soft")


def drawing(kind: str) -> ui.element:
    """Add a drawing of a kind in static/drawings.js."""
    return ui.element("undrift-drawing").props(f'kind="{kind}"')


def set_drawing(element: ui.element, *what: object) -> None:
    """Change a drawing if its content differs."""
    text = json.dumps(what)
    if element.props.get("what") != text:
        element.props["what"] = text
        element.update()


def _readings(bench: "Bench") -> str:
    """Return the newest readings, means over 0.2 s in the device's units."""
    record = None if bench.source is None else bench.source.recent(0.2)
    return "" if record is None else ". ".join(
        f"{name}: {_three(values)} {unit}"
        for name, values, unit in (
            ("Accelerometer", record.accel, record.accel_unit), ("Gyroscope", record.gyro, record.gyro_unit)
        )
        if values is not None
    )  # fmt: skip


def _three(values: object) -> str:
    means = np.asarray(values, dtype=float)
    if np.isnan(means).all(axis=0).any():
        return "–"
    return ", ".join(f"{axis} {mean:.4g}" for axis, mean in zip("xyz", np.nanmean(means, axis=0), strict=True))
