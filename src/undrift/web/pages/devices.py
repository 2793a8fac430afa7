"""Devices: which are known, what is due, what each one's calibrations were, and how it changed."""

from functools import partial
from typing import Any

from nicegui import ui

from undrift.web.bench import Bench
from undrift.web.devices import ENDINGS, Devices
from undrift.web.frame import button, error_line, frame, next_step, redrawn, scrolling, text

SOON_DAYS = 30


def page(bench: Bench) -> None:
    """Build the page."""
    held, client = bench.devices, ui.context.client
    with frame(bench, "Devices"):
        error_line(lambda: held.error)
        redrawn(lambda: (held.changes, bench.calibration), lambda refresh: _shown(bench, held, client))
        ui.timer(0.05, held.load, once=True)


def _shown(bench: Bench, held: Devices, client: Any) -> None:
    if held.rows is None:
        text("p", "Loading ...", "soft")
        return
    if not held.rows:
        text("p", "No device is registered yet. Calibrate one, then register it on the page Result.")
        next_step("Calibrate a device", "/")
        return
    _devices(held)
    if held.chosen is None:
        first = held.rows[0]["serial"]
        next_step(f"Show {first}", partial(held.choose, first))
        return
    _device(bench, held, held.chosen, client)


def state_words(row: dict[str, Any]) -> tuple[str, str]:
    """Return in words whether a device is due, and the class of their colour."""
    days = row.get("days_left")
    if days is None:
        return ("no calibration", "bad") if row["calibration"] is None else ("valid", "good")
    if days < 0:
        return f"overdue by {-days} days", "bad"
    return (f"due in {days} days", "marginal") if days < SOON_DAYS else (f"valid, {days} days left", "good")


def _devices(held: Devices) -> None:
    with _table("Devices, the most urgent first", ("device", "state", "calibrated", "due", "entries")):
        for row in held.rows or ():
            calibration = row["calibration"] or {}
            words, colour = state_words(row)
            with ui.element("tr"):
                with ui.element("td"):
                    made = button(row["serial"], partial(held.choose, row["serial"]))
                    made.props(f'aria-pressed="{"true" if row["serial"] == held.serial else "false"}"')
                text("td", words, colour)
                for cell in (_day(calibration, "made_at"), _day(calibration, "due_at"), str(row["entries"])):
                    text("td", cell)


def _device(bench: Bench, held: Devices, row: dict[str, Any], client: Any) -> None:
    text("h2", f"Device {row['serial']}")
    calibration = row["calibration"]
    if calibration is None or (row.get("days_left") or 0) < 0:
        next_step("Calibrate it", "/")
    elif held.is_used(calibration):
        text("p", f"Live and Recordings use entry {calibration['entry']}.").props('role="status"')
        next_step("Correct recordings", "/recordings")
    else:
        next_step("Use this calibration", partial(held.use, calibration))
    _trend(held)
    text("h2", "Entries")
    heads = ("entry", "file", "made", "due", "valid, °C", "verdict", "by", "note")
    with _table(f"Entries of {row['serial']}, the newest first", heads):
        for entry in reversed(held.entries):
            _entry(bench, held, entry, client)


def _entry(bench: Bench, held: Devices, entry: dict[str, Any], client: Any) -> None:
    span = entry["valid_temp_c"]
    later = entry["superseded_by"]
    note = "; ".join(filter(None, (f"superseded by {later}" if later else "", str(entry["note"]))))
    valid = "–" if span is None else f"{span[0]:.1f} to {span[1]:.1f}"
    with ui.element("tr"):
        text("td", f"{entry['entry']} {entry['kind']}")
        with ui.element("td"):
            if entry["kind"] in ENDINGS:
                made = button("Download", partial(_download, bench, held, entry, client))
                made.props(f'aria-label="Download entry {entry["entry"]}"')
            if entry["kind"] == "calibration" and not later and entry["verdict"] != "bad":
                if held.is_used(entry):
                    text("span", "in use", "good")
                else:
                    made = button("Use", partial(held.use, entry))
                    made.props(f'aria-label="Use entry {entry["entry"]}"')
        for cell in (_day(entry, "made_at"), _day(entry, "due_at"), valid, str(entry["verdict"] or "–")):
            text("td", cell)
        text("td", str(entry["added_by"]))
        text("td", note, "records-note")


async def _download(bench: Bench, held: Devices, entry: dict[str, Any], client: Any) -> None:
    path = await held.fetch(entry)
    if path is not None:
        client.download(bench.link(path) + "?download=1", path.name)


def _trend(held: Devices) -> None:
    text("h2", "Has it changed?")
    if not held.trend:
        compared = held.why_no_trend.partition("wanted two calibrations")[1]
        words = "Two calibrations are needed to compare." if compared else held.why_no_trend
        text("p", words, "soft")
        return
    headline, last = str(held.trend["headline"]), held.trend["steps"][-1]
    text("p", _sentence(headline))
    if others := [words for words in last["sentences"] if words != headline]:
        with ui.element("details"):
            text("summary", f"{len(others)} more")
            with ui.element("ul"):
                for words in others:
                    text("li", _sentence(words))
    if held.picture is not None and held.picture.exists():
        drawn = held.picture.read_text(encoding="utf-8").partition("?>")[2]
        ui.html(drawn, sanitize=False).classes("picture")
    with ui.element("details"):
        text("summary", f"Every parameter since {last['since']['made_at'][:10]}")
        with _table("Changes with their standard uncertainty", ("parameter", "change", "uncertainty", "unit", "sigma")):
            for one in last["changes"]:
                with ui.element("tr"):
                    name = f"{one['sensor']} {one['parameter']}"
                    numbers = f"{one['change']:+.3g}", f"{one['uncertainty']:.2g}", one["unit"], f"{one['sigmas']:.1f}"
                    for cell in (name, *numbers):
                        text("td", cell)
        for words in last["not_compared"]:
            text("p", f"Not compared: {words}.", "soft")


def _table(caption: str, heads: tuple[str, ...]) -> Any:
    """Add a table that scrolls where the screen is narrow; return its body."""
    with scrolling(caption), ui.element("table").classes("records") as table:
        text("caption", caption)
        with ui.element("thead"), ui.element("tr"):
            for head in heads:
                text("th", head).props('scope="col"')
    with table:
        return ui.element("tbody")


def _day(entry: dict[str, Any], name: str) -> str:
    return str(entry.get(name) or "–")[:10]


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."
