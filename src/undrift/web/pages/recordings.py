"""Recordings: drop a file; its map is proposed, it is corrected, oriented, validated; take the results."""

from functools import partial
from typing import Any

from nicegui import ui

from undrift.record import FACES
from undrift.web.bench import Bench
from undrift.web.drawings import worn
from undrift.web.frame import Field, button, frame, next_step, redrawn, refused, remarks_list, set_text, text
from undrift.web.recordings import UNITS, Recordings, Stored


def page(bench: Bench) -> None:
    """Build the page."""
    held, client = bench.recordings, ui.context.client
    with frame(bench, "Recordings"):
        text("p", "Drop a recording, its optical reference or a calibration. Files stay on this computer.")
        _drop(bench, held)

        def draw(refresh: Any) -> None:
            _files(held, refresh)
            if held.chosen is not None:
                _one(bench, held, held.chosen, refresh, client.open)

        redrawn(lambda: _state(bench), draw)


def _state(bench: Bench) -> object:
    files = tuple(
        (one.path, one.kind, one.map, one.error, one.picture, len(one.made), str(one.remarks))
        for one in bench.recordings.files
    )
    return files, bench.recordings.chosen and bench.recordings.chosen.path, bench.calibration


def _drop(bench: Bench, held: Recordings) -> None:
    """Add the place to drop files on, which is a file chooser too."""
    with ui.element("label").classes("drop bench-file") as drop:
        text("span", "Drop files here, or choose them: ")
        chooser = ui.element("input").props('type="file" multiple aria-label="Choose files"')
    status = text("p", "", "soft").props('role="status"')
    js = "(event) => { event.preventDefault(); benchUpload(event.currentTarget, %s); }"
    chooser.on("change", js_handler=js % "event.target.files")
    drop.on("drop", js_handler=js % "event.dataTransfer.files")
    drop.on("dragover", js_handler="(event) => { event.preventDefault(); event.currentTarget.classList.add('over'); }")
    drop.on("dragleave", js_handler="(event) => event.currentTarget.classList.remove('over')")

    def sending(event: Any) -> None:
        set_text(status, f"Sending {event.args['detail']['name']} ...")

    async def sent(event: Any) -> None:
        detail = event.args["detail"]
        if detail.get("error"):
            set_text(status, str(detail["error"]))
            return
        set_text(status, f"Reading {detail['name']} ...")
        await held.add(bench.inside(str(detail["file"])))
        set_text(status, "")

    for element in (chooser, drop):
        element.on("sending", sending, ["detail"])
        element.on("sent", sent, ["detail"])


def _files(held: Recordings, refresh: Any) -> None:
    if not held.files:
        return

    def choose(one: Stored) -> None:
        held.chosen = one
        refresh()

    text("h2", "Files")
    with ui.element("ul").classes("bench-list"):
        for one in held.files:
            with ui.element("li"):
                made = button(one.path.name, partial(choose, one))
                made.props(f'aria-pressed="{"true" if one is held.chosen else "false"}"')
                text("span", f" {one.summary}", "soft")


def _one(bench: Bench, held: Recordings, one: Stored, refresh: Any, go: Any) -> None:
    text("h2", one.path.name)
    if one.needs_rate:
        _rate_form(held, one, refresh)
    else:
        refused(bench, bench.job, one.error, partial(setattr, one, "error"))
    if one.needs_map:
        _map_form(held, one, refresh)
    elif one.kind == "recording":
        _about(one)
        _actions(bench, held, one, refresh, go)
    elif one.kind == "calibration":
        text("p", "Recordings are corrected with this calibration.")
    elif one.about and not one.needs_rate:
        text("p", one.summary)
        remarks_list(one.remarks["info"])
    for command, remarks in one.remarks.items():
        if remarks and command != "info":
            text("h3", f"What {command} noticed")
            remarks_list(remarks)
    if one.made:
        text("h3", "Results")
        with ui.element("ul"):
            for label, path in one.made.items():
                page = path.suffix in (".html", ".svg")
                with ui.element("li"):
                    ui.link(label, bench.link(path) + ("" if page else "?download=1")).props(
                        'target="_blank"' if page else ""
                    )


def _about(one: Stored) -> None:
    text("p", one.summary)
    remarks_list(one.remarks["info"])
    if one.picture is not None:
        ui.html(one.picture.read_text(encoding="utf-8").partition("?>")[2] or "", sanitize=False).classes("picture")


def _rate_form(held: Recordings, one: Stored, refresh: Any) -> None:
    """Ask for the sample rate of a file without time."""
    if one.kind == "recording":
        refused(held.bench, None, one.error)
    else:
        text("p", "This file has no time column. The data sheet or the settings of the device state its sample rate.")
    rate, wrong = Field("Samples per second, Hz", kind="number"), text("p", "", "bench-error").props('role="alert"')

    async def read() -> None:
        given = rate.number()
        if given and given > 0.0:
            await held.state_rate(one, given)
            refresh()
        else:
            set_text(wrong, f"sample rate: wanted a number above 0, got '{rate.value}'; state the samples per second")

    next_step("Read the file", read)


def _map_form(held: Recordings, one: Stored, refresh: Any) -> None:
    """Show the proposed map, and ask what nothing in the file shows."""
    lines = [str(line) for line in one.about.get("map") or ()]
    text("p", "This table does not state its units. Check the proposal against the data sheet of the device.")
    text("pre", "\n".join(lines), "scroll").props('tabindex="0"')
    wants_rate = any(line.startswith("sample_rate_hz") for line in lines)
    text("h3", "Confirm")
    with ui.element("div").classes("row"):
        rate = Field("Samples per second, Hz", kind="number") if wants_rate else None
        chosen: dict[str, Any] = {}
        for name, label in (("gyro", "Unit of the gyroscopes"), ("accel", "Unit of the accelerometers")):
            if any(f"{name} =" in line for line in lines):
                marked = (unit for unit in UNITS[name] if any(f'{name} = "{unit}"' in line for line in lines))
                chosen[name] = Field(label, next(marked, UNITS[name][0]), options=UNITS[name])

    async def write() -> None:
        given = None if rate is None else rate.number()
        if rate is not None and not (given and given > 0.0):
            one.error = f"sample rate: wanted a number above 0, got '{rate.value}'; state the samples per second"
        else:
            await held.write_map(one, sample_rate_hz=given, units={name: made.value for name, made in chosen.items()})
        refresh()

    next_step("Read the file", write)


def _actions(bench: Bench, held: Recordings, one: Stored, refresh: Any, go: Any) -> None:
    if bench.calibration is None:
        text("p", "No calibration chosen: drop a calibration.json, or calibrate from this recording.", "soft")
    else:
        text("p", f"Calibration: {bench.calibration.parent.name}/{bench.calibration.name}", "soft")

    async def run(command: str) -> None:
        await held.run(one, command)
        refresh()

    if bench.calibration is not None:
        next_step("Correct", partial(run, "correct"))
    _sides(held)
    button("Orient", lambda: run("orient") if _chosen(held, one) else refresh())
    if held.references():
        _optics_form(held, one, refresh, go)
    with ui.element("details") as more:
        if bench.calibration is None:
            more.props("open")
        text("summary", "Calibrate from this recording")
        text(
            "p",
            "It needs six faces or more, each at rest for some seconds; gyroscopes need full turns between rests too.",
        )
        with ui.element("div").classes("row"):
            turn = Field("Angle of its turns, deg (empty: none)", "", kind="number")
            serial = Field("Serial number", "")

        async def calibrate() -> None:
            if await held.calibrate(one, turn_deg=turn.number(), serial=serial.value.strip()):
                go("/result")  # of the client: this button may be drawn anew by then
            else:
                refresh()

        if bench.calibration is None:
            next_step("Calibrate", calibrate)
        else:
            button("Calibrate", calibrate)


def _sides(held: Recordings) -> None:
    """Ask how the device was worn, which defines the pitch; the drawing follows the choice."""
    with ui.element("section").classes("worn").props('aria-label="How it was worn"'):
        drawing = ui.html(worn(held.axes["forward"], held.axes["up"]), sanitize=False)
        with ui.element("div"):
            text("p", "Which sides of the device point forward and up when the wearer stands? They define the pitch.")
            for name in held.axes:
                made = Field(f"Side that points {name}", held.axes[name], options=("", *FACES))

                def take(name: str = name, made: Field = made) -> None:
                    held.axes[name] = made.value
                    drawing.set_content(worn(held.axes["forward"], held.axes["up"]))

                made.element.on("change", take)


def _chosen(held: Recordings, one: Stored) -> bool:
    """Return whether both sides are chosen; say so where they are not."""
    forward, up = held.axes["forward"], held.axes["up"]
    wrong = not (forward and up) or forward[1] == up[1]
    got = f"{forward or 'none'} and {up or 'none'}"
    one.error = f"pitch: wanted a side that points forward and another that points up, got {got}" if wrong else ""
    return not wrong


def _optics_form(held: Recordings, one: Stored, refresh: Any, go: Any) -> None:
    """Ask for the optics of a recording: its own, or a file of poses or markers."""
    found = {("its own" if reference is one else reference.path.name): reference for reference in held.references()}
    with ui.element("section").props('aria-label="Optics"'):
        text("h3", "Compare with optics")
        with ui.element("div").classes("row"):
            chosen = Field("Optical reference", next(iter(found)), options=tuple(found))
            markers = up = None
            if any(reference.kind == "markers" for reference in found.values()):
                labels = next(
                    reference.about.get("columns") for reference in found.values() if reference.kind == "markers"
                )
                hint = f"three or more of one rigid cluster: {', '.join(map(str, list(labels or ())[:6]))} ..."
                markers = Field("Markers, commas between", hint=hint)
                up = Field("Laboratory axis that points up", "", options=("", "y", "z"))

        async def validate() -> None:
            if _chosen(held, one):
                await held.validate(one, found[chosen.value], **given())
            refresh()

        async def calibrate() -> None:
            if await held.calibrate_by(one, found[chosen.value], **given()):
                go("/result")
            else:
                refresh()

        def given() -> dict[str, str]:
            return {"markers": markers.value.strip() if markers else "", "up": up.value if up else ""}

        with ui.element("div").classes("row"):
            button("Validate", validate)
            button("Calibrate by these optics", calibrate)
