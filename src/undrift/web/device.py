"""The page Get readings with the ways to connect a device, and the rail Get readings > Check > Calibrate > Use."""

from functools import partial
from typing import TYPE_CHECKING

from nicegui import ui

from undrift.web import entries, parts
from undrift.web.place import place_form

if TYPE_CHECKING:
    from undrift.web.bench import Visit

LINE = 'fill="none" stroke="currentColor" stroke-width="2.5" stroke-linejoin="round" stroke-linecap="round"'
STEPS = {  # title of each step and its pages, with the default page first
    "Get readings": ("/", "/six-faces", "/turns"),
    "Check": ("/check",),
    "Calibrate": ("/calibrate",),
    "Use": ("/use",),
}


def rail(visit: "Visit", path: str) -> None:
    """Add the steps, each with its state."""
    with ui.element("ol"):
        for number, (step, pages) in enumerate(STEPS.items(), 1):
            with ui.element("li"), ui.link("", pages[0]) as link:
                parts.text("span", f"{number} {step}")
                parts.text("span", partial(_state, visit, step), "rail-state")
            if path in pages:
                link.props('aria-current="step"')


def _state(visit: "Visit", step: str) -> str:
    bench, chosen, job = visit.bench, visit.recordings.chosen, visit.job
    if step == "Get readings":
        count = sum(file.kind == "recording" for file in visit.library.files)
        return (
            "receiving"
            if bench.source is not None
            else f"{count} recording{'' if count == 1 else 's'}"
            if count
            else "none yet"
        )
    if step == "Check":
        if chosen is None:
            return "no file chosen"
        return (
            "to confirm"
            if chosen.needs_map or chosen.needs_rate
            else chosen.kind or ("refused" if chosen.error else "reading")
        )
    if step == "Calibrate":
        return "not yet" if job is None else (job.answer.get("verdict") or {}).get("status") or "done"
    return "no calibration" if visit.calibration is None else "calibration chosen"


# ---- The page


def page(visit: "Visit") -> None:
    """Build the page of the first step: readings of the device, and the place."""
    _cards(visit)
    with parts.section("Place"):
        parts.text("h2", "Place")
        parts.text("p", "It gives local gravity. Without it, standard gravity is assumed: up to 0.3 % error of scale.")
        place_form(visit.bench, "Save")
        place = visit.bench
        saved = "Saved: {.gravity_m_s2:.4f} m/s2".format
        parts.status_line(lambda: saved(place.place) if place.place.words() else "Not stated")


def _cards(visit: "Visit") -> None:
    """Add the three sources of readings (files, a device, the practice device) and the guided recording."""
    with ui.element("div").classes("cards"):
        with parts.section("Drop files", "card"):
            parts.text("h3", "Drop files")
            parts.text("p", "A log, a phone's ZIP or a maker's export, and the optical recording.")
            entries.drop(visit, "/check")
        with parts.section("Connect live", "card"):
            parts.text("h3", "Connect live")
            connect_form(visit, practice=False)
        with parts.section("Practice device", "card"):
            parts.text("h3", "Practice device")
            parts.text("p", "A simulated sensor that you turn with buttons.")
            parts.button("Use the practice device", partial(visit.bench.connect, parts.PRACTICE))
    parts.text("h2", "Record with the bench")
    with ui.element("div").classes("cards"):
        for way in parts.texts()["ways"]:  # available devices, their recording, and instructions for making it
            with parts.section(way["have"], "card"):
                drawing = f'<path d="{way["drawing"].strip()}" {LINE}/>'
                ui.html(f'<svg viewBox="0 0 220 100" aria-hidden="true">{drawing}</svg>', sanitize=False)
                parts.text("h3", way["have"])
                parts.text("p", way["record"])
                parts.text("p", way["gives"], "soft")
                parts.next_step(way["next"], way["path"])


def connect_form(visit: "Visit", *, practice: bool = True) -> None:
    """Add the controls for connecting a device: devices found, presets, an address. Show the connected device."""
    bench = visit.bench

    def preset(name: str) -> None:
        visit.address = parts.texts()["presets"].get(name, "")
        address.set(visit.address)

    with parts.section("Device"):
        parts.status_line(lambda: parts.device_line(bench), "")
        parts.button("Look for devices", visit.search)
        parts.redrawn(lambda: visit.ways, lambda: _device_list(visit))
        parts.Field("Kind of device", options=("", *parts.texts()["presets"]), keep=preset)
        address = parts.Field("Address of the device", visit.address, keep=partial(setattr, visit, "address"))
        with parts.row():
            parts.button("Connect", lambda: bench.connect(visit.address))
            if practice:
                parts.button("Use the practice device", partial(visit.bench.connect, parts.PRACTICE))
            parts.shown_if(parts.button("Disconnect", bench.disconnect), lambda: bench.source is not None)
        parts.error_line(lambda: bench.source_error)


def _device_list(visit: "Visit") -> None:
    """List the devices found. A click connects a device."""
    ways = {"serial_ports": "serial://", "lsl_streams": "lsl:"}
    pairs = [(kind, device) for way, kind in ways.items() for device in visit.ways.get(way, ())]
    senders = [(kind + next(iter(device.values())), device["device"]) for kind, device in pairs]
    for address, about in senders:
        parts.button(f"{address.partition(':')[2].lstrip('/')}: {about}", partial(visit.bench.connect, address))
    if visit.ways and not senders:
        parts.text("p", "Nothing was found: connect the device, switch it on, and look again.", "soft")
    for note in visit.ways.get("notes", ()):
        parts.text("p", str(note), "soft")
