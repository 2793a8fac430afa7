"""What the pages Six faces and Turns by hand share: light, progress, live readings, the strip of the practice device."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from nicegui import ui

from undrift.errors import UndriftError
from undrift.web.bench import Bench
from undrift.web.capture import Light
from undrift.web.drawings import lamp, ring
from undrift.web.frame import REFRESH_S, button, connect_form, disable, error_line, scrolling, set_text, text
from undrift.web.guided import Guided, guided_of

AXES = "xyz"
SAID_AT = (6, 3)  # seconds left that are read out
Move = Callable[[Any], object]  # of the practice device


class Picture:
    """A drawing that is changed only where it is another one."""

    def __init__(self, classes: str = "") -> None:
        self._made, self._drawn = ui.html("", sanitize=False).classes(classes), ""

    def draw(self, svg: str) -> None:
        """Show a drawing."""
        if svg != self._drawn:
            self._drawn = svg
            self._made.set_content(svg)


def without_device(bench: Bench, why: str) -> None:
    """Ask for a device."""
    text("p", why)
    connect_form(bench)


def guide_part(asked: Callable[[], tuple[str, str]], light: Callable[[], Light], countdown_s: float) -> None:
    """Add what is asked for, as a drawing and in words, beside the light."""
    with ui.element("div").classes("guide"):
        drawing = Picture()
        with ui.element("div"):
            words = text("p", "", "asked")
            _light(light, countdown_s)

    def refresh() -> None:
        drawn, wanted = asked()
        drawing.draw(drawn)
        set_text(words, wanted)

    refresh()
    ui.timer(REFRESH_S, refresh)


def _light(light: Callable[[], Light], whole_s: float) -> None:
    """Add the light: shape, words, countdown; what changes is read out."""
    with ui.element("div").classes("light"):
        shape = Picture()
        words = text("p", "", "light-words").props('role="status" aria-live="polite"')
        countdown = Picture()
    spoken = text("p", "", "unseen").props('aria-live="polite"')

    def refresh() -> None:
        now = light()
        shape.draw(lamp(now))
        set_text(words, now.text)
        left = math.ceil(now.left_s) if now.left_s is not None else 0
        countdown.draw(ring(now.left_s, whole_s))
        set_text(spoken, f"{left} seconds" if left in SAID_AT else "")

    refresh()
    ui.timer(REFRESH_S, refresh)


def progress_part(
    title: str,
    names: Sequence[tuple[str, str]],
    done: Callable[[], Sequence[str]],
    again: Callable[[], str | None],
    redo: Callable[[str | None], None],
) -> None:
    """Add a list of what is to be captured, each with its state and a button to record again."""
    count = text("h2", title)
    rows = []
    with ui.element("ol").classes("steps"):
        for key, name in names:
            with ui.element("li"):
                with ui.element("div").classes("step"):
                    text("span", name, "step-name")
                    state = text("span", "", "step-state")

                def pressed(key: str = key) -> None:
                    redo(None if again() == key else key)
                    refresh()

                rows.append((key, state, button("Redo", pressed).props(f'aria-label="Redo {name}"')))

    def refresh() -> None:
        held, now = done(), again()
        set_text(count, f"{title}: {len(held)} of {len(names)}")
        for key, state, press in rows:
            set_text(state, "record again" if key == now else "✓ captured" if key in held else "to do")
            set_text(press, "Cancel" if key == now else "Redo")
            disable(press, key not in held)

    refresh()
    ui.timer(REFRESH_S, refresh)


def readings_part(bench: Bench) -> None:
    """Add the newest readings as numbers, means of 0.2 s in the device's own units."""
    with scrolling("Readings now", "readings"), ui.element("table"):
        text("caption", "Readings now")
        with ui.element("tbody"):
            rows = []
            for name in ("Accelerometer", "Gyroscope"):
                with ui.element("tr"):
                    text("th", name).props('scope="row"')
                    rows.append([text("td", "") for _ in range(4)])

    def refresh() -> None:
        record = None if bench.source is None else bench.source.recent(0.2)
        held = (
            ((None, ""), (None, ""))
            if record is None
            else ((record.accel, record.accel_unit), (record.gyro, record.gyro_unit))
        )
        for cells, (values, unit) in zip(rows, held, strict=True):
            means = None if values is None or np.isnan(values).all(axis=0).any() else np.nanmean(values, axis=0)
            for k, cell in enumerate(cells[:3]):
                set_text(cell, f"{AXES[k]} -" if means is None else f"{AXES[k]} {means[k]:.4g}")
            set_text(cells[3], unit)

    refresh()
    ui.timer(REFRESH_S, refresh)


def practice_part(bench: Bench, rows: Sequence[tuple[str, Sequence[tuple[str, Move]]]]) -> None:
    """Add buttons that move the practice device, where it is connected."""
    error = [""]
    with ui.element("section").props('aria-label="Practice device"').classes("practice") as strip:
        for title, moves in rows:
            text("h2", title)
            with ui.element("div").classes("row"):
                for name, move in moves:

                    def pressed(move: Move = move) -> None:
                        error[0] = ""
                        try:
                            if bench.practice is not None:
                                move(bench.practice)
                        except UndriftError as refused:
                            error[0] = str(refused)

                    button(name, pressed)
        error_line(lambda: error[0])

    def refresh() -> None:
        strip.set_visibility(bench.practice is not None)

    refresh()
    ui.timer(REFRESH_S, refresh)


def state_of(bench: Bench) -> tuple[object, ...]:
    """Return what makes a guided page another one: its device, and its capture."""
    return (bench.source, None if bench.job is None else bench.job.capture)


def watched(bench: Bench, guided: Guided, name: str) -> None:
    """Keep a guide at work while the page is open, and show what goes wrong."""

    def look() -> None:
        if guided_of(bench) is guided:
            guided.look(guided.faces if name == "faces" else guided.turns)

    look()
    ui.timer(REFRESH_S, look)
    error_line(lambda: guided.error)
