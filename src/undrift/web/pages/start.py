"""Start: what do you have? Each answer leads to the recording that is needed."""

from dataclasses import dataclass

from nicegui import ui

from undrift.web.bench import Bench
from undrift.web.frame import REFRESH_S, connect_form, frame, next_step, place_form, set_text, text


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """One answer: what a person has, the recording that is needed, and where it is made."""

    have: str
    record: str
    gives: str
    minutes: str
    path: str
    next: str
    drawing: str


_LINE = 'fill="none" stroke="currentColor" stroke-width="2.5" stroke-linejoin="round" stroke-linecap="round"'
_BOX = '<path d="M{x} 46 l22 -11 22 11 -22 11 z M{x} 46 v22 l22 11 22 -11 v-22 M{y} 57 v22"/>'


def _drawn(inside: str) -> str:
    return f'<svg viewBox="0 0 220 100" aria-hidden="true"><g {_LINE}>{inside}</g></svg>'


_ARC = '<path d="M{a} 30 a34 14 0 1 1 58 8 l-9 -1 m9 1 l-1 9"/>'
WAYS = (
    Way(
        have="My hands and a level surface",
        record="Six faces, each at rest for 6 s; then full turns about each axis, back to the mark.",
        gives="Scale, cross-axis and offset of accelerometers and gyroscopes.",
        minutes="5 min",
        path="/six-faces",
        next="Record six faces",
        drawing=_drawn(_BOX.format(x=38, y=60) + _BOX.format(x=138, y=160) + '<path d="M98 54 h24 l-7 -6 m7 6 l-7 6"/>'),
    ),
    Way(
        have="A rate table",
        record="Steps of constant rate about each axis, mounted on three faces or more.",
        gives="Gyroscope scale to 0.01 %, and the drift with rate in a chamber.",
        minutes="20 min and more",
        path="/rate-table",
        next="Run the rate table",
        drawing=_drawn(_BOX.format(x=88, y=110) + '<path d="M70 84 h80 M84 94 h52"/>' + _ARC.format(a=82)),
    ),
    Way(
        have="A chamber, or a device that warms up",
        record="Rests at set-points of temperature, or one rest from cold to warm.",
        gives="Tables of offset over temperature.",
        minutes="30 min to hours",
        path="/temperature",
        next="Record temperatures",
        drawing=_drawn('<path d="M40 86 V14 M40 86 H186 M46 80 C80 78 86 30 120 26 S170 24 182 24"/>'
            '<path d="M196 30 v34 a9 9 0 1 0 10 0 v-34 a5 5 0 0 0 -10 0"/>'),
    ),
    Way(
        have="A recording made already",
        record="Any log with rests, or full turns, or a warm-up; makers' exports too.",
        gives="What the recording allows, and what it does not show.",
        minutes="1 min",
        path="/recordings",
        next="Open a recording",
        drawing=_drawn('<path d="M62 10 h66 l26 26 v54 h-92 z M128 10 v26 h26 M74 66 l12 -14 10 20 14 -34 12 26 10 -8 h12"/>'),
    ),
    Way(
        have="Optical motion capture",
        record="The device and a marker cluster on one rigid plate, moved about all axes for 60 s.",
        gives="Angle errors in degrees, before and after the calibration.",
        minutes="5 min",
        path="/recordings",
        next="Open recording and optics",
        drawing=_drawn('<path d="M24 18 l22 8 -8 18 -22 -8 z M46 34 l36 18 M196 18 l-22 8 8 18 22 -8 z M174 34 l-36 18"/>'
            + _BOX.format(x=88, y=110)),
    ),
)  # fmt: skip


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Start"):
        text("p", "What do you have? Each option names the recording it needs.")
        with ui.element("div").classes("cards"):
            for way in WAYS:
                with ui.element("section").classes("card").props(f'aria-label="{way.have}"'):
                    ui.html(way.drawing, sanitize=False)
                    text("h2", way.have)
                    text("p", way.record)
                    text("p", f"{way.gives} {way.minutes}.", "soft")
                    next_step(way.next, way.path)
        connect_form(bench)
        _place(bench)


def _place(bench: Bench) -> None:
    """Ask where the bench stands, and say what is known."""
    with ui.element("section").props('aria-label="Place"'):
        text("h2", "Place")
        text("p", "It gives local gravity. Without it, standard gravity is assumed: up to 0.3 % error of scale.")
        place_form(bench, "Save")
        state = text("p", "", "soft").props('role="status"')

    def refresh() -> None:
        known = f"Saved: {bench.place.gravity_m_s2:.4f} m/s2" if bench.place.words() else "Not stated"
        set_text(state, known)

    refresh()
    ui.timer(REFRESH_S, refresh)
