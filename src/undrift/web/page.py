"""The page: Readings, Check, Calibrate, Use. Each step shows content of the bench's folder."""

import logging
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from functools import partial
from inspect import isawaitable
from typing import Any

from nicegui import events, ui

from undrift.commands.certificate import Statement
from undrift.commands.files import Place
from undrift.errors import InputError, UndriftError
from undrift.record import FACES
from undrift.web.bench import PRACTICE, Bench
from undrift.web.guided import guide_part, progress_part
from undrift.web.items import MAP, Item

REFRESH_S = 0.25
ITEMS = 20  # number of items that are listed first
ADDRESSES = {
    "serial:///dev/ttyUSB0": "a board that prints lines with names on a serial port",
    "udp://:5555": "a device or phone that sends lines over the network",
    "tcp://192.168.0.50:9000": "a device that listens on the network",
    "lsl:NAME": "a stream of the Lab Streaming Layer",
}
UNITS = {
    "gyro": ("rad/s", "dps", "count", "v"),
    "accel": ("m/s2", "g", "mg", "count", "v"),
    "time": ("s", "ms", "us", "date"),
}
SENSORS = {"gyro": "gyroscopes", "accel": "accelerometers", "time": "time"}
WALKED = "Each face must rest for some seconds. Full turns (360 deg) between rests also calibrate the gyroscopes."
OFFSETS = {
    "none": "Nothing",
    "rest": "The mean of the first rest",
    "motion": "Estimated from gravity while the device moves, for 20 s or more",
}
CHOOSER = """<div class="row items-center q-pa-xs"><q-btn flat no-caps icon="add" label="Choose files" @click="props.pickFiles" />
<span>or drop them here</span><div aria-hidden="true" class="picker"><q-uploader-add-trigger /></div></div>"""
FIT = """event => { const frame = event.target, page = frame.contentDocument.documentElement;
new ResizeObserver(() => { frame.style.height = page.offsetHeight + 20 + "px" }).observe(page) }"""  # no inner scroll bar
LOG = logging.getLogger("undrift.bench")
Handler = Callable[[], Awaitable[None] | None]


def build(bench: Bench) -> None:
    """Build the page for a browser."""
    ui.add_head_html(
        '<link rel="stylesheet" href="/static/bench.css"><script src="/static/drawings.js" defer></script>'
    )
    ui.colors(primary="#1f5fa8")
    with ui.header().classes("head"):
        ui.label("undrift bench").classes("name").props('role="heading" aria-level="1"')
        device = ui.label().props('role="status"')
    with ui.element("main"):
        steps(bench)
    with ui.footer().classes("work") as footer:
        task = ui.label().props('role="status"')
        bar = ui.linear_progress(show_value=False).props('aria-label="Completed share"')
        ui.button("Cancel", color=None, on_click=lambda: cancel(bench)).props("flat no-caps")

    def look() -> None:
        source, work = bench.source, bench.work
        device.text = f"Device: {source.name}" if source is not None else "No device connected"
        footer.set_visibility(work is not None)
        if work is not None:
            task.text, bar.value = bench.plain(work.text), work.share

    look()
    ui.timer(REFRESH_S, look)


def cancel(bench: Bench) -> None:
    """Cancel the running command."""
    if bench.work is not None:
        bench.work.cancelled = True


def steps(bench: Bench) -> None:
    """Add the four steps. They are drawn again whenever the bench changes, in this browser or another."""
    version = bench.version

    @ui.refreshable
    def draw() -> None:
        with ui.stepper(value=bench.step, on_value_change=lambda event: bench.go(event.value)) as stepper:
            stepper.props("vertical header-nav flat")
            for number, (name, (title, content)) in enumerate(STEPS.items(), 1):
                with ui.step(name, title).props(f'prefix={number} active-icon="expand_more"'):
                    if name == bench.step:
                        content(bench)

    def look() -> None:
        nonlocal version
        if version != bench.version:
            version = bench.version
            draw.refresh()

    draw()
    ui.timer(REFRESH_S, look)


def action(bench: Bench, label: str, handler: Handler, *, main: bool = False) -> None:
    """Add a button. An error of its handler appears next to it, and stays until the button is pressed again."""
    with ui.row().classes("action"):
        button = ui.button(label, color="primary" if main else None)
        button.props("no-caps unelevated" if main else "no-caps outline")
        button.set_enabled(bench.work is None)
        ui.label(bench.errors.get(label, "")).classes("error").props('role="alert"')

    async def act() -> None:
        button.disable()
        await attempt(bench, label, handler)

    button.on_click(act)


async def attempt(bench: Bench, name: str, handler: Handler) -> None:
    """Call a handler. Its error is stored under a name, for the page."""
    bench.errors.pop(name, None)
    try:
        waited = handler()
        if isawaitable(waited):
            await waited
    except (UndriftError, OSError) as error:
        bench.errors[name] = bench.plain(str(error))
    except Exception as error:  # a bug must not leave the user without a message
        LOG.exception("bench")
        bench.errors[name] = f"Internal error: {type(error).__name__}: {error}. Please report it."
    bench.changed()


def field(label: str, holder: Any, name: str, *, hint: str = "", proposals: Any = None) -> None:
    """Add an input that is stored in a dictionary or an object as it is typed."""
    entry = ui.input(label, autocomplete=proposals).classes("field")
    entry.bind_value(holder, name, forward=lambda text: text or "", backward=lambda text: text or "")
    if hint:
        entry.props["hint"] = hint


def number(label: str, holder: Any, name: str) -> None:
    """Add an input for a number that is stored in a dictionary or an object."""
    ui.number(label).classes("field").bind_value(holder, name)


def choice(label: str, options: Any, holder: Any, name: str) -> None:
    """Add a choice that is stored in a dictionary or an object."""
    ui.select(options, label=label).classes("field").bind_value(holder, name)


def result_part(bench: Bench, item: Item, command: str) -> None:
    """Add the report of a command and its files, if it was called."""
    page = item.page(command)
    if page is None:
        return
    address = f"{bench.link(page)}?{page.stat().st_mtime_ns}"
    with ui.row():
        for file in item.files(command):
            ui.link(f"Download {file.name}", f"{bench.link(file)}?download=1")
        ui.link("Open the report", address, new_tab=True)
    frame = ui.element("iframe").classes("report").on("load", js_handler=FIT)
    frame.props["src"], frame.props["title"] = address, f"Report of {command}"


# ---- Readings


def readings_step(bench: Bench) -> None:
    """Add the three ways to get readings, and the files and recordings so far."""
    with ui.element("div").classes("doors"):
        with ui.card():
            ui.label("Drop files").classes("heading")
            ui.label("A phone's ZIP, a log, a recording, or a calibration. They stay on this computer.")
            uploader(bench)
        with ui.card():
            ui.label("Connect a device").classes("heading")
            if bench.source is not None:
                action(bench, f"Disconnect {bench.source.name}", bench.disconnect)
            action(bench, "Look for devices", bench.search)
            for address, about in bench.found:
                action(bench, f"Connect {address}", partial(bench.connect, address))
                ui.label(about).classes("soft")
            field("Address", bench.typed, "address", proposals=list(ADDRESSES))
            action(bench, "Connect", lambda: connect(bench))
            with ui.expansion("How to write an address"):
                for address, about in ADDRESSES.items():
                    ui.label(f"{address}: {about}")
        with ui.card():
            ui.label("Practice device").classes("heading")
            ui.label("A simulated device. It shows all steps, from the six faces to a certificate.")
            action(bench, "Use the practice device", lambda: bench.connect(PRACTICE))
    if bench.items:
        ui.label("Files and recordings").classes("heading")
        item_list(bench, bench.items[:ITEMS])
        if len(bench.items) > ITEMS:
            with ui.expansion(f"{len(bench.items) - ITEMS} more"):
                item_list(bench, bench.items[ITEMS:])


async def connect(bench: Bench) -> None:
    """Connect the device at the entered address."""
    if not (bench.typed["address"] or "").strip():
        raise InputError("Enter the address of the device, or look for devices.")
    await bench.connect(bench.typed["address"])


def item_list(bench: Bench, items: list[Item]) -> None:
    """List items. A click chooses one."""
    with ui.list().props("bordered separator"):
        for item in items:
            with ui.item(on_click=lambda item=item: bench.choose(item)), ui.item_section():
                ui.item_label(item.name)
                ui.item_label(f"{item.summary} ({item.arrival})").props("caption").classes("soft")


def uploader(bench: Bench) -> None:
    """Add the area for files."""

    async def arrived(event: events.MultiUploadEventArguments) -> None:
        await attempt(bench, "upload", lambda: bench.receive(event.files))

    def refused() -> None:
        bench.errors["upload"] = f"Files that are sent together may have {bench.settings.upload_mb:g} MB in total."
        bench.changed()

    largest = int(bench.settings.upload_mb * 1e6)
    area = ui.upload(
        multiple=True, auto_upload=True, max_total_size=largest, on_multi_upload=arrived, on_rejected=refused
    )
    area.props("flat bordered").add_slot("header", CHOOSER)
    ui.label(bench.errors.get("upload", "")).classes("error").props('role="alert"')


# ---- Check


def check_step(bench: Bench) -> None:
    """Add the content of the chosen file, or the guide of the connected device."""
    item = bench.chosen
    if item is None:
        nothing(bench)
    elif item.kind == "session":
        recording_part(bench, item)
    else:
        file_part(bench, item)


def nothing(bench: Bench) -> None:
    """Add a message that a file is needed."""
    ui.label("Choose a file or recording first.")
    action(bench, "Go to the readings", lambda: bench.go("Readings"), main=True)


def recording_part(bench: Bench, item: Item) -> None:
    """Add a guided recording: its guide if its device is connected, otherwise its content."""
    guided = bench.guided
    if guided is None or guided.item is not item:
        ui.label(f"{item.name}: {item.summary or 'nothing was recorded'}.")
        if item.summary:
            action(bench, "Continue to the calibration", lambda: bench.go("Calibrate"), main=True)
        return
    guide_part(guided)
    if bench.practice is not None:
        action(bench, "Move the practice device as asked", guided.move, main=guided.guide.wanted is not None)
    if guided.turns.enough or guided.faces.complete:
        text = "Continue to the calibration" if guided.turns.enough else "Continue without turns"
        action(bench, text, lambda: bench.go("Calibrate"), main=guided.turns.complete)
    progress_part(guided)
    action(bench, "Start over", bench.begin)


def file_part(bench: Bench, item: Item) -> None:
    """Add the content of a file, and the entries that it needs."""
    ui.label(item.name).classes("heading")
    ui.label(item.summary or "Reading ...")
    looked = item.looked
    if looked is None:
        return
    needs_map = bool(item.draft) and not (item.folder / MAP).is_file()
    if looked.missing == "sample_rate_hz" and not item.draft:
        rate_form(bench, item)
    elif looked.missing == "sensor":
        ui.select(list(looked.columns), label="Sensor").bind_value(item, "sensor")
        action(bench, "Read the file", lambda: bench.read_again(item), main=True)
    elif needs_map:
        map_form(bench, item)
    if item.kind == "calibration":
        action(bench, "Correct recordings with it", lambda: bench.go("Readings"), main=True)
    elif item.kind == "recording":
        action(bench, "Calibrate the device from it", lambda: bench.go("Calibrate"), main=not bench.calibrations)
        if bench.calibrations:
            action(bench, "Correct it", lambda: bench.go("Use"), main=True)
        if item.draft:
            with ui.expansion("Columns and units"):
                map_form(bench, item)
        elif item.sample_rate_hz is not None:
            with ui.expansion("Sample rate"):
                rate_form(bench, item)
    if not (needs_map or looked.missing):
        result_part(bench, item, "info")


def rate_form(bench: Bench, item: Item) -> None:
    """Ask for the sample rate of a file without time."""
    ui.label("This file has no time. You find the sample rate in the data sheet or the settings of the device.")
    number("Samples per second, Hz", item, "sample_rate_hz")
    action(bench, "Read the file at this rate", lambda: bench.read_again(item), main=True)


def map_form(bench: Bench, item: Item) -> None:
    """Ask for the units of a table with foreign names. A person confirms the proposal."""
    draft, reasons = item.draft, item.looked.reasons if item.looked else {}
    ui.label("This table does not contain its units. Check columns and units against the data sheet of the device.")
    for key, columns in draft["columns"].items():
        ui.label(f"Columns of {key}: {columns if isinstance(columns, str) else ', '.join(map(str, columns))}")
    if "sample_rate_hz" in draft:

        def keep(event: events.ValueChangeEventArguments[Any]) -> None:
            draft["sample_rate_hz"] = event.value or "?"

        value = draft["sample_rate_hz"]
        ui.number("Samples per second, Hz", value=None if value == "?" else value, on_change=keep).classes("field")
    for key, unit in draft.get("units", {}).items():
        if key in UNITS:
            options = {known: known for known in (*UNITS[key], unit)} | {"?": "Choose the unit"}
            choice(f"Unit of the {SENSORS[key]}", options, draft["units"], key)
            if key in reasons:
                ui.label(f"Proposed by {reasons[key]}.").classes("soft")
    ui.label("If the columns are wrong, use the command line with your own map.").classes("soft")
    action(bench, "Columns and units are right: read the file", lambda: bench.read_again(item), main=True)


# ---- Calibrate


def calibrate_step(bench: Bench) -> None:
    """Add the controls that calibrate the device from the chosen recording, and the result."""
    item = bench.chosen
    if item is None or item.kind not in ("recording", "session"):
        nothing(bench)
        return
    ui.label(f"Calibrate from {item.name}").classes("heading")
    if item.kind == "recording":
        ui.label(WALKED)
        field("Serial number", item, "serial", hint="from the file; correct it if it is wrong")
        number("Angle of each turn, deg (empty: none)", item, "turn_deg")
    keep_place = place_form(bench)

    async def calibrate(**options: bool) -> None:
        keep_place()
        await bench.calibrate(item, **options)

    done = item.page("calibrate") is not None
    action(bench, "Calibrate", calibrate, main=not done)
    with ui.expansion("Other ways"):
        action(bench, "Calibrate the accelerometers only", lambda: calibrate(accel_only=True))
        if item.kind == "recording":
            ui.label("From motion: turn the device slowly in your hand about every axis for one minute.")
            action(bench, "Calibrate from its motion", lambda: calibrate(motion=True))
    if done:
        action(bench, "Correct recordings with it", lambda: bench.go("Use"), main=True)
        certificate_part(bench, item)
        result_part(bench, item, "calibrate")


def place_form(bench: Bench) -> Callable[[], None]:
    """Ask for the place, which determines local gravity. Return a function that keeps the entries."""
    gravity_m_s2, source = bench.place.gravity
    known = "not known, so standard gravity is assumed" if source == "standard" else f"gravity {gravity_m_s2:.4f} m/s2"
    typed = asdict(bench.place)

    def keep() -> None:
        latitude_deg, height_m = typed["latitude_deg"], typed["height_m"]
        if latitude_deg is not None:
            height_m = height_m or 0.0
        bench.set_place(Place(gravity_m_s2=typed["gravity_m_s2"], latitude_deg=latitude_deg, height_m=height_m))

    with ui.expansion(f"Place: {known}"):
        ui.label("Without it, the scale of the accelerometers may be off by 0.3 %. Enter the latitude, or gravity.")
        number("Latitude, deg north", typed, "latitude_deg")
        number("Height, m (empty: 0)", typed, "height_m")
        number("Or gravity, m/s2", typed, "gravity_m_s2")
    return keep


def certificate_part(bench: Bench, item: Item) -> None:
    """Ask for the statements of the laboratory, and write the certificate."""
    entries = ("number", "laboratory", "operator")
    with ui.expansion("Certificate"):
        for name, label in zip(entries, ("Certificate number", "Laboratory", "Calibrated by"), strict=True):
            bench.typed.setdefault(name, "")
            field(label, bench.typed, name)
        ui.label("Empty entries become lines to fill in by hand.").classes("soft")

        async def certify() -> None:
            await bench.certify(item, Statement(**{name: bench.typed[name] or "" for name in entries}))

        action(bench, "Make the certificate", certify)
    if item.page("certificate") is not None:
        ui.link("Open the certificate", bench.link(item.folder / "certificate.html"), new_tab=True)


# ---- Use


def use_step(bench: Bench) -> None:
    """Add the controls that correct and orient a recording, and the results."""
    item = bench.chosen
    recordings = [each for each in bench.items if each.kind == "recording"]
    if not recordings:
        ui.label("Drop a recording to correct it.")
        uploader(bench)
        return
    chosen = {each: f"{each.name} ({each.arrival})" for each in recordings}
    ui.select(
        chosen, label="Recording", value=item if item in chosen else None, on_change=lambda e: take(bench, e.value)
    ).classes("field")
    if item not in chosen or item is None:
        with ui.expansion("Drop another recording"):
            uploader(bench)
        return
    if not bench.calibrations:
        ui.label("No calibration yet. Drop one, or calibrate the device.")
        action(bench, "Go to the readings", lambda: bench.go("Readings"), main=True)
        return

    choice("Calibration", bench.calibrations, bench, "calibration")
    choice("Gyroscope offset to subtract", OFFSETS, bench.typed, "offset")
    choice("Format", {".csv": "CSV", ".parquet": "Parquet, for long recordings"}, bench.typed, "format")
    action(bench, "Correct", lambda: bench.correct(item), main=True)
    result_part(bench, item, "correct")
    sides = {"": "as calibrated, otherwise +x forward and +z up"} | {face: face for face in FACES}
    with ui.expansion("How the device is worn"):
        choice("Side that points forward", sides, bench.typed, "forward")
        choice("Side that points up", sides, bench.typed, "up")
    action(bench, "Orient: inclination and pitch", lambda: bench.orient(item))
    result_part(bench, item, "orient")


def take(bench: Bench, item: Item) -> None:
    """Choose a recording without leaving the step."""
    bench.chosen = item
    bench.errors.clear()
    bench.changed()


STEPS: dict[str, tuple[str, Callable[[Bench], None]]] = {
    "Readings": ("Get readings", readings_step),
    "Check": ("Check or record", check_step),
    "Calibrate": ("Calibrate", calibrate_step),
    "Use": ("Correct and orient", use_step),
}
