"""Rate table: addresses, protocol with its forecast, the run with pause and emergency stop, then the calibration."""

from collections.abc import Callable, Iterable
from functools import partial

from nicegui import ui

from undrift.rig.programme import Forecast
from undrift.units import RADIAN_PER_DEGREE
from undrift.web.bench import Bench
from undrift.web.frame import REFRESH_S, Field, button, disable, error_line, frame, next_step, redrawn, set_text, text
from undrift.web.protocol_form import FACES, ProtocolForm
from undrift.web.rig_run import View

LOOK_S = 0.4  # between two looks at what was typed
NEXT_STEPS = 4
SPEEDS = ("1", "10", "20", "100")  # of the emulated table
ADDRESSES = (  # name, label, hint
    ("rig", "Address of the table", "galil:tcp://host:23?encoder_lines=10000, grbl:serial:///dev/ttyUSB0"),
    ("device", "Address of the device", "serial:///dev/ttyUSB0?baud=115200&..., tcp://host:port?..."),
    ("chamber", "Address of the chamber", "tcp://host:port, modbus-tcp://host:502?model=..., manual:"),
)
TEMPERATURES = (
    ("temperatures_c", "Temperatures, degC", "rising, such as 18, 30, 45"),
    ("soak_c_per_min", "Stable below, K/min", ""),
)
RATES = (
    ("turn_rate_min_dps", "Lowest rate, deg/s", ""),
    ("turn_rate_max_dps", "Highest rate, deg/s", ""),
    ("turn_rate_step_dps", "Step, deg/s", ""),
    ("dwell_s", "Time at each rate, s", ""),
    ("face_s", "Time on each face, s", ""),
)
MORE = (
    ("bracket_s", "Rest before and after the rates, s", ""),
    ("acceleration_dps2", "Acceleration, deg/s2", ""),
    ("cutoff_hz", "Low-pass of the device, Hz", "sets the settling time"),
)
ENDS = {
    "paused": "Paused: the table is at rest and its motor is off. What was recorded is kept; the interrupted dwell is repeated.",
    "stopped": "Stopped: the table is at rest and its motor is off. What was recorded is kept.",
    "unconfirmed": "The stop is NOT CONFIRMED. Cut the amplifier's power, then look at the table.",
    "failed": "The run ended early. What was recorded is kept.",
    "done": "Complete: all dwells are recorded, the table is at rest and its motor is off.",
}
DOING = {
    "mounting": "waiting until the device is mounted",
    "setting": "waiting until the chamber is set",
    "writing": "writing the readings",
    "closing": "bringing the table to rest",
}


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Rate table"):
        text("p", "The table turns the device at known rates about each axis, and rests on each face.")
        client = ui.context.client  # a button may be drawn anew before its work is done
        redrawn(lambda: run_state(bench), lambda look: _part(bench, look, client.open))


def run_state(bench: Bench) -> tuple[object, ...]:
    """Return what a page is drawn anew for."""
    run = bench.rig_run
    if run is None:
        return ("none", bench.table.filled)
    view = run.view
    return (run.folder, view.state, view.question, view.error, view.confirmed, bool(view.steps), view.standby)


def _part(bench: Bench, look: Callable[[], None], go: Callable[[str], None]) -> None:
    if bench.rig_run is None:
        order_form(bench, bench.table.rates, chamber=False)
    else:
        run_part(bench, look, lambda: _after(bench, go))


def _after(bench: Bench, go: Callable[[str], None]) -> None:
    """Add the next step after a complete run."""

    async def calibrate() -> None:
        if await bench.table.calibrate():
            go("/result")

    if bench.rig_run is not None and len(bench.rig_run.view.set_points()) > 1:
        next_step("Fit the drift over temperature", "/temperature")
    else:
        next_step("Calibrate", calibrate)


# ---- What is asked for


def order_form(bench: Bench, form: ProtocolForm, *, chamber: bool) -> None:
    """Add addresses, protocol, forecast and the start."""
    table = bench.table
    if not table.addresses["device"] and bench.source is not None:
        table.addresses["device"] = bench.source.address
    with ui.element("section").props('aria-label="Table"'):
        text("h2", "Table")
        with ui.element("div").classes("row"):
            emulated = button("Use the emulated table", table.use_emulated)
            speed = Field("Speed of the emulated table", table.speed, options=SPEEDS, hint="times real time")
            speed.element.on("change", lambda: setattr(table, "speed", speed.value))
        with ui.element("div").classes("row form"):
            for name, label, hint in ADDRESSES if chamber else ADDRESSES[:2]:
                _bound(label, table.addresses, name, hint)
            _serial(bench)
        by = "The emulated operator mounts the device."
        you = "You mount the device when this page asks for it; the motor is off then."
        text("p", by if table.addresses["operator"] else you, "soft")
    with ui.element("section").props('aria-label="Protocol"'):
        text("h2", "Protocol")
        _typed(form, *(TEMPERATURES if chamber else ()))
        _chosen("Faces to rest on", FACES, form, "faces")
        _chosen("Axes to turn about", ("x", "y", "z"), form, "axes")
        _typed(form, *RATES)
        with ui.element("details"):
            text("summary", "More")
            _typed(form, *MORE)
    forecast = text("p", "", "forecast").props('role="status"')
    wrong = text("p", "", "bench-error").props('role="alert"')
    error_line(lambda: table.error)
    start = next_step("Start", lambda: table.start(form))
    busy = text("p", "", "soft").props('role="status"')

    async def refresh() -> None:
        found = await table.forecast(form)
        set_text(wrong, found if isinstance(found, str) else "")
        set_text(forecast, "" if isinstance(found, str) else forecast_words(found))
        set_text(busy, table.busy and f"{table.busy} ...")
        disable(start, isinstance(found, str) or bool(table.busy))
        disable(emulated, bool(table.busy))

    ui.timer(LOOK_S, refresh)


def forecast_words(found: Forecast) -> str:
    """Say what a protocol takes."""
    rate = f", up to {found.turn_rate / RADIAN_PER_DEGREE:g} deg/s" if found.turn_rate else ""
    soaking = " and soaking" if found.total_s > found.rig_s + 600.0 else ""
    return (
        f"Forecast: {found.dwells} dwells{rate}, {_minutes(found.rig_s)} of table time; about "
        f"{_minutes(found.total_s)} with {found.mountings} mountings{soaking}."
    )


def _minutes(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def _serial(bench: Bench) -> None:
    field = Field("Serial number of the device", bench.table.serial, hint="empty: as the device states it")
    field.element.on("input", lambda: setattr(bench.table, "serial", field.value))


def _bound(label: str, held: dict[str, str], name: str, hint: str) -> None:
    field = Field(label, held[name], hint=hint)
    field.element.on("input", lambda: held.update({name: field.value}))


def _typed(form: ProtocolForm, *fields: tuple[str, str, str]) -> None:
    with ui.element("div").classes("row form"):
        for name, label, hint in fields:
            made = Field(label, getattr(form, name), hint=hint)
            made.element.on("input", partial(_keep, form, name, made))


def _keep(form: ProtocolForm, name: str, made: Field) -> None:
    setattr(form, name, made.value)


def _chosen(label: str, options: Iterable[str], form: ProtocolForm, name: str) -> None:
    every = tuple(options)
    with ui.element("fieldset").classes("row choices"):
        text("legend", label)
        for option in every:
            with ui.element("label"):
                box = ui.element("input").props(f'type="checkbox" value="{option}"')
                if option in getattr(form, name):
                    box.props("checked")
                text("span", option)

                def take(event: object, option: str = option) -> None:
                    kept = {*getattr(form, name)} - {option} | ({option} if getattr(event, "args", False) else set())
                    setattr(form, name, tuple(one for one in every if one in kept))

                box.on("change", take, js_handler="(event) => emit(event.target.checked)")


# ---- What goes on


def run_part(bench: Bench, look: Callable[[], None], after: Callable[[], None]) -> None:
    """Add the run: what it does, what it asks, how far it is, and what a person may do."""
    run, table = bench.rig_run, bench.table
    if run is None:
        return
    view = run.view
    with ui.element("section").props('aria-label="Run"'):
        if view.question is not None:
            _question(bench, *view.question)
        _progress(bench)
        if run.may_move:
            with ui.element("div").classes("row"):
                if view.state == "running":
                    button("Pause", table.pause)
                text("p", "Emergency stop: the red button, or the key Escape, on any page.", "soft")
            text("p", "The run continues when this page is closed.", "soft")
            if view.standby:
                text("p", f"The stop has no connection of its own: {view.standby}.", "soft")
        else:
            unconfirmed = view.state == "stopped" and view.confirmed is False
            text("p", ENDS["unconfirmed" if unconfirmed else view.state], "run-end")
            if view.error:
                text("p", view.error, "bench-error").props('role="alert"')
    error_line(lambda: table.error)
    if not run.may_move:
        if view.state == "done":
            after()
        else:
            next_step("Continue", table.go_on)

        def forget() -> None:
            table.forget()
            look()

        button("New run", forget)


def _question(bench: Bench, number: int, words: str) -> None:
    with ui.element("section").classes("card question").props('role="alert" aria-label="Your turn"'):
        text("h2", "Your turn")
        text("p", words.split(", then press Enter")[0].split(", then type")[0] + ".")
        turned = (
            Field("Angle turned, deg", "", hint="empty: the angle asked for") if "type the angle" in words else None
        )
        with ui.element("div").classes("row"):
            next_step("Done, continue", lambda: bench.table.answer(number, turned.value if turned else ""))
            button("End the run", lambda: bench.table.answer(number, "q"))


def _progress(bench: Bench) -> None:
    """Add a bar over the dwells, what is done now, the time left and the next steps; they change without a redraw."""
    run = bench.rig_run
    if run is None:
        return
    heading = text("h2", "")
    bar = ui.element("progress").props('aria-label="Dwells on the disk"').classes("bar")
    where = text("p", "").props('role="status"')
    live = text("p", "", "soft readings")
    following = text("p", "", "soft")

    def refresh() -> None:
        view = run.view
        count = len(view.done)
        set_text(heading, heading_of(view))
        if bar.props.get("value") != count or bar.props.get("max") != max(view.dwells, 1):
            bar.props["value"], bar.props["max"] = count, max(view.dwells, 1)
            bar.update()
        set_text(where, progress_words(view))
        set_text(live, view.live if run.may_move else "")
        after = [step["text"] for step in view.steps[view.number + 1 :][:NEXT_STEPS]]
        set_text(following, f"Next: {', '.join(after)}" if after and run.may_move else "")

    refresh()
    ui.timer(REFRESH_S, refresh)


def heading_of(view: View) -> str:
    """Say how a run is."""
    names = {"starting": "Starting", "running": "Running", "pausing": "Pausing", "stopping": "Stopping"}
    return names.get(view.state, view.state.capitalize())


def progress_words(view: View) -> str:
    """Say where a run is."""
    if not view.steps or view.phase == "starting":
        return "Connecting table, device and chamber ..." if view.state in ("starting", "running") else ""
    words = f"{len(view.done)} of {view.dwells} dwells"
    if view.state in ("running", "pausing", "stopping"):
        words += f"; step {view.number + 1} of {len(view.steps)}: {view.step}, {DOING.get(view.phase, view.phase)}"
        words += f"; about {_minutes(60.0 * view.minutes_left)} left"
    return words + "."
