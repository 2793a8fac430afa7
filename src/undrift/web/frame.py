"""What every page has: heading, navigation, what is connected, the emergency stop, one next step; and parts that pages share."""

import json
import re
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from nicegui import ui

from undrift.errors import InputError
from undrift.web.bench import PRACTICE, Bench, Job, place_of, towns
from undrift.web.commands import Remark

PAGES = {  # path -> name, in the order of the navigation
    "/": "Start",
    "/six-faces": "Six faces",
    "/turns": "Turns by hand",
    "/rate-table": "Rate table",
    "/temperature": "Temperature",
    "/result": "Result",
    "/live": "Live",
    "/recordings": "Recordings",
    "/devices": "Devices",
}
REFRESH_S = 0.25
ALONE = "Calibrate the accelerometers alone"
SHOWN_FIRST = 3  # remarks that are open, and every one that is no mere note
LEVEL_NAMES = {"fail": "Failed", "warn": "Warning", "info": "Note"}
CONTROLS = {  # options of the commands that a page offers, and what they are called there
    "--sample-rate-hz": "Samples per second, Hz",
    "--turn-deg": "Angle of its turns, deg",
    "--serial": "Serial number",
    "--forward": "Side that points forward",
    "--up": "Side that points up",
    "--markers": "Markers",
    "--reference-up": "Laboratory axis that points up",
    "--gyro-unit": "Unit of the gyroscopes",
    "--accel-unit": "Unit of the accelerometers",
    "--gyro none": ALONE,
    "--latitude-deg": "Town, or latitude in deg",
    "--height-m": "Height above the sea, m",
    "--gravity-m-s2": "Gravity, m/s2",
}
ADDRESSES = "serial:///dev/ttyUSB0?baud=115200&..., tcp://host:port?..., udp://:port, lsl:name, ble:id"  # examples


def text(tag: str, words: str = "", classes: str = "") -> Any:
    """Add an element with plain text: never markup, whatever the words hold."""
    made = ui.element(tag).classes(classes)
    made._text = words
    return made


def scrolling(label: str, classes: str = "") -> Any:
    """Add a part that scrolls sideways where the screen is narrow, by the keyboard too."""
    made = ui.element("div").classes(f"scroll {classes}").props('tabindex="0" role="region"')
    made.props["aria-label"] = label  # a serial number in it may hold anything
    return made


def set_text(element: Any, words: str) -> None:
    """Change the text of an element, where it is another one."""
    if element._text != words:
        element._text = words
        element.update()


@contextmanager
def frame(bench: Bench, title: str) -> Iterator[None]:
    """Build a page around what the block adds."""
    with ui.element("header").classes("bench-head"):
        ui.link("undrift bench", "/").classes("bench-name")
        with ui.element("nav").props('aria-label="Pages"'):
            for path, name in PAGES.items():
                link = ui.link(name, path)
                if name == title:
                    link.props('aria-current="page"')
        device = text("p", "", "bench-device").props('role="status"')
        _stop_button(bench)
    with ui.element("div").classes("bench-main"):
        text("h1", title)
        yield
        work = text("p", "", "bench-work").props('role="status"')

    def refresh() -> None:
        set_text(device, device_line(bench))
        now = bench.working[-1] if bench.working else None
        set_text(work, "" if now is None else f"Working: {now.what}. {now.line}")

    refresh()
    ui.timer(REFRESH_S, refresh)


def device_line(bench: Bench) -> str:
    """Return in words what is connected."""
    if bench.connecting:
        return f"Connecting {bench.connecting} ..."
    if bench.source is None:
        return (bench.source_error and f"No device: {bench.source_error}") or "No device connected"
    return f"Device: {bench.source.name}" + (f" ({bench.source.error})" if bench.source.error else "")


def _stop_button(bench: Bench) -> None:
    """Add the emergency stop: a form of its own, so that it works beside a page that is busy; shown while a table may move."""
    form = ui.element("form").props('method="post" action="/stop" id="bench-stop"').classes("bench-stop")
    with form:
        label = text("button", "Emergency stop (Esc)", "stop").props('type="submit" aria-keyshortcuts="Escape"')
        label.props('title="Stop the table at once and switch its motor off"')

    def refresh() -> None:
        run = bench.rig_run
        place = "" if run is None else run.stop_url
        if form.props.get("data-place") != place:
            form.props["data-place"] = place
            form.update()
        form.set_visibility(run is not None and run.may_move)

    refresh()
    ui.timer(REFRESH_S, refresh)


def redrawn(state: Callable[[], object], draw: Callable[[Callable[[], None]], None]) -> None:
    """Add a part that is drawn anew whenever the state changes, in this browser or another; ``draw`` gets what looks at once."""
    seen = [state()]

    def look() -> None:
        if (now := state()) != seen[0]:
            seen[0] = now
            part.refresh()

    @ui.refreshable
    def part() -> None:
        draw(look)

    part()
    ui.timer(REFRESH_S, look)


def next_step(label: str, handler: Callable[[], Any] | str) -> Any:
    """Add the one obvious next step of a page: a button that calls, or a link to another page."""
    if isinstance(handler, str):
        return ui.link(label, handler).classes("next")
    return button(label, handler, "next")


def button(label: str, handler: Callable[[], Any | Awaitable[Any]], classes: str = "") -> Any:
    """Add a plain button: label, what it does."""
    made = text("button", label, classes).props('type="button"')
    # the second click of a double click is ignored: it would undo the first
    made.on("click", lambda _: handler(), js_handler="(event) => { if (event.detail < 2) emit() }")
    return made


def disable(element: Any, disabled: bool) -> None:
    """Disable a plain button, or enable it."""
    if bool(element.props.get("disabled")) != disabled:
        if disabled:
            element.props("disabled")
        else:
            element.props(remove="disabled")
        element.update()


class Field:
    """A labelled input, a choice, or (kind list) an input with proposals; ``value`` is what was typed or chosen."""

    def __init__(
        self, label: str, value: str = "", *, hint: str = "", kind: str = "text", options: Sequence[str] = ()
    ) -> None:
        self.value = value
        with ui.element("label").classes("bench-field"):
            text("span", label)
            if options and kind != "list":
                with ui.element("select") as self.element:
                    for option in options:
                        made = text("option", option).props("selected" if option == value else "")
                        made.props["value"] = option
            else:
                self.element = ui.element("input").props(
                    f'type="{kind}" autocomplete="off"' + (' step="any"' if kind == "number" else "")
                )
                # the attribute: the property would undo what is typed at each redraw
                self.element.props["^value"] = value
            if kind == "list":  # to type, or to choose
                with ui.element("datalist") as listed:
                    for option in options:
                        ui.element("option").props["value"] = option
                self.element.props["list"] = listed.html_id
            if hint:
                text("span", hint, "soft")
        self.element.on("input", self._take, js_handler="(event) => emit(event.target.value)")

    def set(self, value: str) -> None:
        """Show another value."""
        self.value = value
        self.element.props["^value"] = value
        self.element.update()
        self.element.client.run_javascript(f"getHtmlElement({self.element.id}).value = {json.dumps(value)}")

    def number(self) -> float | None:
        """Return what was typed as a number; None where it is none."""
        try:
            return float(self.value.replace(",", "."))
        except ValueError:
            return None

    def _take(self, event: Any) -> None:
        self.value = str(event.args)


def error_line(words: Callable[[], str]) -> Any:
    """Add a line for what went wrong; empty while nothing has."""
    made = text("p", "", "bench-error").props('role="alert"')

    def refresh() -> None:
        set_text(made, words())

    refresh()
    ui.timer(REFRESH_S, refresh)
    return made


def remarks_list(remarks: Sequence[Remark]) -> None:
    """List what a command noticed, each with what to do; notes after the first few are folded."""
    count = max(SHOWN_FIRST, sum(one.level != "info" for one in remarks))
    with ui.element("ul").classes("remarks"):
        for one in remarks[:count]:
            with ui.element("li").classes(one.level):
                text("strong", f"{LEVEL_NAMES[one.level]}: ")
                text("span", page_words(one.text).rstrip(".") + ".")
                if action := page_words(one.action):
                    text("p", f"{action[:1].upper()}{action[1:]}.", "soft")
    if len(remarks) > count:
        with ui.element("details"):
            text("summary", f"{len(remarks) - count} more")
            for one in remarks[count:]:
                remarks_list([one])


def page_words(words: str) -> str:
    """Return a text of a command with the options that a page offers called as they are there."""
    for option, label in CONTROLS.items():
        words = re.sub(rf"{option}(?![\w-])", f"“{label}”", words)
    return words


def refused(bench: Bench, job: Job | None, error: str, keep: Callable[[str], object] = bool) -> None:
    """Say what was refused; where gyroscopes, turns or rates spoilt a job's calibration, offer it without them."""
    if error:
        text("p", page_words(error), "bench-error").props('role="alert"')
    if job is None or not job.words or "--gyro" in job.words or error != job.error:
        return
    if not re.search("gyro|turn|rotation|rate", error):
        return
    go = ui.context.client.open  # this button may be drawn anew by then

    async def again() -> None:
        turns = job.words.index("--turn-deg") if "--turn-deg" in job.words else len(job.words)  # not used then
        outcome = await bench.calibrate(job, *job.words[:turns], *job.words[turns + 2 :], "--gyro", "none")
        keep(outcome.error)
        if outcome.done:
            go("/result")

    button(ALONE, again)


def place_form(bench: Bench, label: str, then: Callable[[], Any] = bool) -> None:
    """Ask where the bench stands, as the scale of the accelerometers is known no better than gravity."""
    error, held = [""], bench.place
    shown = ["" if value is None else f"{value:g}" for value in (held.latitude_deg, held.height_m, held.stated_m_s2)]
    with ui.element("div").classes("row form"):
        town = Field("Town, or latitude in deg", shown[0], hint="north is positive", kind="list", options=[*towns()])
        height = Field("Height above the sea, m", shown[1] if shown[0] else "", hint="empty: that of the town")
        gravity = Field("Gravity, m/s2", shown[2], hint="in place of the town")

    async def keep() -> None:
        error[0] = ""
        try:
            bench.set_place(place_of(town.value, height.value, gravity.value))
        except InputError as refused:
            error[0] = str(refused)
            return
        if (work := then()) is not None:
            await work

    button(label, keep)
    error_line(lambda: error[0])


def connect_form(bench: Bench) -> None:
    """Add the form, and say what is connected."""
    with ui.element("section").props('aria-label="Device"'):
        text("h2", "Device")
        state = text("p", "")
        with ui.element("div").classes("row"):
            address = Field("Address of the device", hint=ADDRESSES)
            button("Connect", lambda: bench.connect(address.value))
            button("Use the practice device", lambda: bench.connect(PRACTICE))
            button("Disconnect", bench.disconnect)
        error_line(lambda: bench.source_error)

    def refresh() -> None:
        if bench.connecting:
            words = f"Connecting {bench.connecting} ..."
        elif bench.source is None:
            words = "None connected. Connect yours, or try the practice device, a simulated sensor that you turn with buttons."
        else:
            words = f"Connected: {bench.source.name}"
        set_text(state, words)

    refresh()
    ui.timer(REFRESH_S, refresh)
