"""Six faces: turn each face up; what rests is captured by itself."""

from operator import methodcaller

from nicegui import ui

from undrift.web.bench import Bench
from undrift.web.drawings import box
from undrift.web.frame import button, frame, next_step, redrawn, text
from undrift.web.guided import Guided, begin_anew, guided_of
from undrift.web.pages.guide_parts import (
    guide_part,
    practice_part,
    progress_part,
    readings_part,
    state_of,
    watched,
    without_device,
)
from undrift.web.six_faces import ORDER


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Six faces"):
        redrawn(lambda: state_of(bench), lambda look: _shown(bench))


def _shown(bench: Bench) -> None:
    guided = guided_of(bench)
    if guided is None:
        without_device(
            bench, "Lay the device on each of its six faces. It calibrates the accelerometers. Connect it first."
        )
        return
    guide = guided.faces
    watched(bench, guided, "faces")

    def asked() -> tuple[str, str]:
        wanted = guide.wanted
        words = "All six faces are captured" if wanted is None else f"Turn {wanted} up"
        return box(wanted or guide.light.face or "+z"), words

    guide_part(asked, lambda: guide.light, guided.capture.settings.countdown_s)
    redrawn(lambda: guide.complete, lambda look: _next(guide.complete))
    practice_part(bench, [("Practice device: turn it", [(f"{face} up", methodcaller("lay", face)) for face in ORDER])])
    names = [(face, f"{face} up") for face in ORDER]
    progress_part("Faces", names, lambda: [*guide.capture.faces], lambda: guide.again, lambda face: _redo(guided, face))
    readings_part(bench)
    with ui.element("div").classes("row"):
        button("Start over", lambda: begin_anew(bench))


def _next(complete: bool) -> None:
    if complete:
        next_step("Continue to turns by hand", "/turns")
    else:
        text("p", "In any order. Lay the device down and let go; it is recorded automatically.", "soft")


def _redo(guided: Guided, face: str | None) -> None:
    guided.faces.redo(next((one for one in ORDER if one == face), None))
