"""The page Rate table: addresses, protocol with its forecast, the run with pause and emergency stop, then the calibration.

A protocol is protocol.toml as fields that a person fills in. It is written as typed and read by undrift's own reader, so that the
page says of a field what the command says of the file.
"""

import asyncio
import math
import re
import tempfile
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui

from undrift.base.codec import toml_text
from undrift.base.options import asked
from undrift.commands.bench.rig_run import GOING, EmulatedTable, RigRun, RunOrder, View, begin_run, find_run
from undrift.commands.rig import forecast
from undrift.errors import InputError, UndriftError
from undrift.record import FACES
from undrift.units import RADIAN_PER_DEGREE
from undrift.web import parts
from undrift.web.commands import CommandOutcome

if TYPE_CHECKING:
    from undrift.rig.programme import Forecast
    from undrift.web.bench import Bench, Visit

NEXT_STEPS = 4
SPEEDS = ("1", "10", "20", "100")  # of the emulated table
CONTROLLERS = ("galil:", "grbl:", "")  # that may listen at a port; without one, a device or a chamber


# ---- What is asked for


@dataclass(slots=True, kw_only=True)
class ProtocolForm:
    """What was typed; numbers are text until they are read."""

    name: str = "rate table"
    cutoff_hz: str = asked("Low-pass of the device, Hz", "11.1", hint="sets the settling time")
    faces: tuple[str, ...] = FACES
    face_s: str = asked("Time on each face, s", "6")
    axes: tuple[str, ...] = ("x", "y", "z")  # none leaves the rates out
    turn_rate_min_dps: str = asked("Lowest rate, deg/s", "15")
    turn_rate_max_dps: str = asked("Highest rate, deg/s", "90")
    turn_rate_step_dps: str = asked("Step, deg/s", "15")
    order: str = "alternating"  # or random
    dwell_s: str = asked("Time at each rate, s", "6")
    bracket_s: str = asked("Rest before and after the rates, s", "6")
    acceleration_dps2: str = asked("Acceleration, deg/s2", "2300")
    temperatures_c: str = asked("Temperatures, degC", hint="rising, such as 18, 30, 45")  # none: room temperature
    soak_c_per_min: str = asked("Stable below, K/min", "0.1")

    def toml(self) -> str:
        """Return protocol.toml."""
        tree: dict[str, Any] = {"protocol": {"name": self.name, "cutoff_hz": _typed(self.cutoff_hz)}}
        if self.faces:
            tree["faces"] = {"order": list(self.faces), "seconds": _typed(self.face_s)}
        if self.axes:
            names = ("turn_rate_min_dps", "turn_rate_max_dps", "turn_rate_step_dps", "bracket_s", "acceleration_dps2")
            typed = {name: _typed(getattr(self, name)) for name in names} | {"seconds": _typed(self.dwell_s)}
            tree["rates"] = {"axes": list(self.axes), "order": self.order, **typed}
        if points := [part for part in re.split(r"[,;\s]+", self.temperatures_c.strip()) if part]:
            soak = _typed(self.soak_c_per_min)
            tree["temperatures"] = {"set_points_c": [*map(_typed, points)], "soak_c_per_min": soak}
        return toml_text(tree)

    def check(self, rig: str) -> "Forecast":
        """Return what it takes on a table, as ``rig run`` states it; InputError says which field is wrong, and why."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "protocol.toml"
            path.write_text(self.toml(), encoding="utf-8")
            try:
                return forecast(path, rig)
            except InputError as error:
                words = str(error).removeprefix(f"{path}: ")
                raise InputError(re.sub(r"^line \d+: ", "", words)) from error  # of a file that nobody sees


def _typed(words: str) -> float | str:
    """Return what was typed as a number where it is one, else as a text, which the reader refuses by name."""
    with suppress(ValueError):
        if math.isfinite(value := float(words.replace(",", "."))):
            return value
    return words.strip()


# ---- What becomes of it


class RateTablePage:
    """What a person has filled in, and what becomes of it. Its methods are called on the event loop and do not block it."""

    def __init__(self, bench: "Bench") -> None:
        self._bench = bench
        self.addresses = RunOrder()  # of the last run: what a tab begins with
        self.busy = ""  # what is being started, in words
        self.error = ""
        self.emulated = EmulatedTable(bench.folder)
        self._forecasts: dict[tuple[str, str], Forecast | str] = {}

    @property
    def run(self) -> RigRun | None:
        """Return the run that goes on, or the last one."""
        return self._bench.rig_run

    async def use_emulated(self, visit: "Visit") -> None:
        """Start the emulated table, chamber, device and operator, and fill in their addresses."""
        await self._doing("Starting the emulated table", lambda: self._use_emulated(visit))

    async def start(self, typed: ProtocolForm, addresses: RunOrder) -> None:
        """Start a run, in a job of its own."""
        await self._doing("Starting the run", lambda: self._start(typed, addresses))

    async def go_on(self) -> None:
        """Continue a run that was paused or stopped, or that failed."""
        run = self.run
        if run is not None:
            await self._doing("Starting the run", lambda: self._launch(run))

    async def pause(self) -> None:
        """End the dwell that is going; the table comes to rest, its motor off."""
        if self.run is not None:
            await asyncio.to_thread(self.run.pause)

    async def answer(self, number: int, words: str = "") -> None:
        """Answer a question of the run."""
        if self.run is not None:
            await asyncio.to_thread(self.run.answer, number, words)

    def forget(self) -> None:
        """Make room for another run; what the last one recorded stays in its folder."""
        if self.run is not None and not self.run.may_move:
            self._bench.rig_run, self._bench.job, self.error = None, None, ""

    async def calibrate(self, visit: "Visit") -> str | None:
        """Calibrate from the run; return the page of the result."""
        return await self._made(visit, self._bench.calibrate)

    async def fit_drift(self, visit: "Visit") -> str | None:
        """Fit the drift over the temperatures of the run; return the page of the result."""
        return await self._made(visit, self._bench.fit_drift, visit.calibration)

    async def _made(
        self, visit: "Visit", make: Callable[..., Awaitable[CommandOutcome]], *known: Path | None
    ) -> str | None:
        if self.run is None:
            return None
        bench = self._bench
        job = bench.job or bench.new_job("" if bench.source is None else bench.source.name)
        outcome = await make(job, *known, self.run.folder, "--trust")  # the bench's own readings need no box
        self.error = visit.take(job, outcome).error
        return "/calibrate" if outcome.done else None

    async def forecast(self, typed: ProtocolForm, rig: str) -> "Forecast | str":
        """Return what a protocol takes on a table, or what is wrong with it."""
        wanted = typed.toml(), rig.strip() or "galil:"
        if wanted not in self._forecasts:
            try:
                self._forecasts = {wanted: await asyncio.to_thread(typed.check, wanted[1])}
            except UndriftError as error:
                self._forecasts = {wanted: str(error)}
        return self._forecasts.get(wanted, "")

    def close(self) -> None:
        """Bring the table to rest and end what the bench started; the bench ends."""
        if self.run is not None:
            self.run.close()
        self.emulated.close()

    def take_up(self) -> RigRun | None:
        """Find the run that an earlier bench left."""
        run = find_run(self._bench.folder / "jobs")
        if run is not None:
            self.addresses = replace(run.order, options=())
            if run.view.state in GOING:
                run.follow()
        return run

    async def _doing(self, what: str, work: Callable[[], Awaitable[None]]) -> None:
        if self.busy:
            return
        self.busy, self.error = what, ""
        try:
            await work()
        except UndriftError as error:
            self.error = str(error)
        finally:
            self.busy = ""

    async def _use_emulated(self, visit: "Visit") -> None:
        self.emulated.words = ("--speed", visit.speed)
        for name, address in (await asyncio.to_thread(self.emulated.start)).items():
            setattr(visit.addresses, name, address)
        visit.filled += 1

    async def _start(self, typed: ProtocolForm, addresses: RunOrder) -> None:
        bench, at_temperatures = self._bench, bool(typed.temperatures_c.strip())
        order = replace(addresses, host=bench.settings.host)
        for name, typed_address in order.named().items():
            setattr(order, name, typed_address.strip())
        for wanted, what, why in (
            (order.rig, "the table", ""),
            (order.device, "the device", ""),
            (order.chamber or not at_temperatures, "a chamber", " for the temperatures"),
        ):
            if not wanted:
                raise InputError(f"rate table: wanted the address of {what}{why}, got none; fill it in")
        if order.rig == self.emulated.addresses.get("rig") and not self.emulated.is_there():
            raise InputError("emulated table: wanted it at work, got it ended after its last run; use it anew")
        await asyncio.to_thread(typed.check, order.rig)
        if self.run is not None and self.run.may_move:
            raise InputError("rate table: wanted a table at rest, got a run that goes on; wait for it, or pause it")
        if bench.source is not None and bench.source.address == order.device:
            await bench.disconnect()  # a serial port has one owner
        job = bench.job
        if job is None or any(job.folder.iterdir()):
            job = bench.new_job(order.serial or "rate-table")
        self.addresses = replace(order)
        order = order if at_temperatures else replace(order, chamber="")
        await self._launch(begin_run(job.session, typed.toml(), order))

    async def _launch(self, run: RigRun) -> None:
        self._bench.rig_run = run
        try:
            await asyncio.to_thread(run.launch)
        finally:
            run.follow()


# ---- The page


def page(visit: "Visit") -> None:
    """Build the page."""
    parts.text("p", "The table turns the device at known rates about each axis, and rests on each face.")
    parts.redrawn(lambda: run_state(visit), lambda: _part(visit))


def run_state(visit: "Visit") -> tuple[object, ...]:
    """Return what a page is drawn anew for."""
    run = visit.bench.rig_run
    if run is None:
        return ("none", visit.filled)
    view = run.view
    return (run.folder, view.state, view.question, view.error, view.confirmed, bool(view.steps), view.standby)


def _part(visit: "Visit") -> None:
    bench = visit.bench
    if bench.rig_run is None:
        order_form(visit, visit.rates, chamber=False)
    else:
        run_part(bench, bench.rig_run, lambda: _after(visit, bench.rig_run))


def _after(visit: "Visit", run: RigRun | None) -> None:
    """Add the next step after a complete run."""
    if run is not None and len(run.view.set_points()) > 1:
        parts.next_step("Fit the drift over temperature", "/temperature")
    else:
        parts.next_step("Calibrate", lambda: visit.bench.table.calibrate(visit))


def order_form(visit: "Visit", typed: ProtocolForm, *, chamber: bool) -> None:
    """Add addresses, protocol, forecast and the start."""
    bench, table, addresses = visit.bench, visit.bench.table, visit.addresses
    if not addresses.device and bench.source is not None:
        addresses.device = bench.source.address
    with parts.section("Table"):
        parts.text("h2", "Table")
        with parts.row():
            use = parts.button("Use the emulated table", lambda: table.use_emulated(visit))
            parts.disabled_if(use, lambda: bool(table.busy))
            keep: Any = partial(setattr, visit, "speed")
            parts.Field("Speed of the emulated table", visit.speed, options=SPEEDS, hint="times real time", keep=keep)
            parts.button("Look for ports", visit.search)
        ports = [f"{way}serial://{one['port']}" for one in visit.ways.get("serial_ports", ()) for way in CONTROLLERS]
        if visit.ways:
            parts.status_line(f"{len(ports) // len(CONTROLLERS)} serial ports found: the addresses below propose them.")
        parts.form(addresses, "rig", "device", *(("chamber",) if chamber else ()), proposed=ports)
        parts.form(addresses, "serial")
        by = "The emulated operator mounts the device."
        you = "You mount the device when this page asks for it; the motor is off then."
        parts.text("p", by if addresses.operator else you, "soft")
    with parts.section("Protocol"):
        parts.text("h2", "Protocol")
        parts.form(typed, *(("temperatures_c", "soak_c_per_min") if chamber else ()))
        parts.choices("Faces to rest on", FACES, typed, "faces")
        parts.choices("Axes to turn about", ("x", "y", "z"), typed, "axes")
        parts.form(typed, "turn_rate_min_dps", "turn_rate_max_dps", "turn_rate_step_dps", "dwell_s", "face_s")
        with parts.folded("More"):
            parts.form(typed, "bracket_s", "acceleration_dps2", "cutoff_hz")
    found: list[Forecast | str] = [""]

    async def look() -> None:
        found[:] = [await table.forecast(typed, addresses.rig)]

    parts.bound(look)
    parts.status_line(lambda: forecast_words(found[0]), "forecast")
    parts.error_line(lambda: found[0] if isinstance(found[0], str) else "")
    parts.error_line(lambda: table.error)
    start = parts.next_step("Start", lambda: table.start(typed, addresses))
    parts.status_line(lambda: table.busy and f"{table.busy} ...")
    parts.disabled_if(start, lambda: isinstance(found[0], str) or bool(table.busy))


def forecast_words(found: "Forecast | str") -> str:
    """Say what a protocol takes."""
    if isinstance(found, str):
        return ""
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


def run_part(bench: "Bench", run: RigRun, after: Callable[[], None]) -> None:
    """Add the run: what it does, what it asks, how far it is, and what a person may do."""
    table, view = bench.table, run.view
    with parts.section("Run"):
        if view.question is not None:
            _question(bench, *view.question)
        _progress(run)
        parts.error_line(lambda: view.wrong if run.may_move else "")
        with ui.element("div").classes("worn"):
            parts.drawing("box", lambda: run.view.pose if run.view.pose[0] else ["+z"])
            parts.drawing("lines", lambda: [*run.view.trace()], "curve")
        if run.may_move:
            with parts.row():
                if view.state == "running":
                    parts.button("Pause", table.pause)
                parts.text("p", "Emergency stop: the red button, or the key Escape, on any page.", "soft")
            parts.text("p", "The run continues when this page is closed.", "soft")
            if view.standby:
                parts.text("p", f"The stop has no connection of its own: {view.standby}.", "soft")
        else:
            unconfirmed = view.state == "stopped" and view.confirmed is False
            parts.text("p", parts.texts()["ends"]["unconfirmed" if unconfirmed else view.state], "run-end")
            if view.error:
                parts.error_line(view.error)
    parts.error_line(lambda: table.error)
    if not run.may_move:
        if view.state == "done":
            after()
        else:
            parts.next_step("Continue", table.go_on)
        parts.button("New run", table.forget)


def _question(bench: "Bench", number: int, words: str) -> None:
    with parts.section("Your turn", "card question").props('role="alert"'):
        parts.text("h2", "Your turn")
        parts.text("p", words.split(", then press Enter")[0].split(", then type")[0] + ".")
        turned = "type the angle" in words
        angle = parts.Field("Angle turned, deg", hint="empty: the angle asked for") if turned else None
        with parts.row():
            parts.next_step("Done, continue", lambda: bench.table.answer(number, angle.value if angle else ""))
            parts.button("End the run", lambda: bench.table.answer(number, "q"))


def _progress(run: RigRun) -> None:
    """Add a bar over the dwells, what is done now, the time left and the next steps; they change without a redraw."""

    def show() -> None:
        parts.set_prop(bar, "max", max(run.view.dwells, 1))
        parts.set_prop(bar, "value", len(run.view.done))

    def following() -> str:
        after = [step["text"] for step in run.view.steps[run.view.number + 1 :][:NEXT_STEPS]]
        return f"Next: {', '.join(after)}" if after and run.may_move else ""

    parts.text("h2", lambda: str.capitalize(run.view.state))
    bar = ui.element("progress").props('aria-label="Dwells on the disk"').classes("bar")
    parts.bound(show)
    parts.status_line(lambda: progress_words(run.view), "")
    parts.text("p", lambda: run.view.live if run.may_move else "", "soft readings")
    parts.text("p", following, "soft")


def progress_words(view: View) -> str:
    """Say where a run is."""
    if not view.steps or view.phase == "starting":
        return "Connecting table, device and chamber ..." if view.state in ("starting", "running") else ""
    words = f"{len(view.done)} of {view.dwells} dwells"
    if view.state in ("running", "pausing", "stopping"):
        phase = parts.texts()["phases"].get(view.phase, view.phase)
        words += f"; step {view.number + 1} of {len(view.steps)}: {view.step}, {phase}"
        words += f"; about {_minutes(60.0 * view.minutes_left)} left"
    return words + "."
