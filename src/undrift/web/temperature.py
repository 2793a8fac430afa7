"""The page Temperature: rests at set-points of a chamber, or one rest during a warm-up: curve, soak, what is left; then the fit."""

import asyncio
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from undrift.commands.bench.rig_run import Point, RigRun, TempCourse, View
from undrift.errors import InputError
from undrift.web import parts
from undrift.web.device import connect_form
from undrift.web.rate_table import order_form, run_part, run_state

if TYPE_CHECKING:
    from undrift.commands.bench.library import Job
    from undrift.commands.bench.source import LiveDevice
    from undrift.web.bench import Bench, Visit

LOOK_S = 0.5  # between two looks at what came
DRAWN = 300  # points of a curve


class WarmUpRecording:
    """One recording, from its start to the fit; its course of temperature grows while it goes on."""

    def __init__(self, bench: "Bench") -> None:
        self._bench = bench
        self.job: Job | None = None
        self.error = ""
        self.recording = False
        self._task: asyncio.Task[None] | None = None
        self.course = TempCourse()

    def start(self) -> None:
        """Begin to record the device that is connected."""
        source = self._bench.source
        if source is None:
            raise InputError("warm-up: wanted a device that sends, got none; connect it first")
        # by what it states to send: a first reading may still be on its way
        if "temp" not in source.recorder.source.description.measured:
            raise InputError("warm-up: wanted a device with a thermometer, got none; use a chamber with one")
        job = self._bench.new_job(source.name)
        source.write_to(job.folder / "warm_up.parquet")
        self.course = TempCourse()
        self.job, self.error, self.recording = job, "", True
        self._task = asyncio.create_task(self._follow(source))

    async def finish(self, visit: "Visit") -> str | None:
        """End the recording and fit the drift over its temperatures; return the page of the result."""
        source, job = self._bench.source, self.job
        self.recording = False
        if job is None or source is None:
            self.error = "warm-up: wanted the device to the end, got it disconnected; record again"
            return None
        path = await asyncio.to_thread(source.stop_writing)
        if path is None:
            self.error = "warm-up: wanted readings, got none; record again"
            return None
        outcome = await self._bench.fit_drift(job, visit.calibration, path, "--warm-up")
        self.error = visit.take(job, outcome).error
        return "/calibrate" if outcome.done else None

    async def _follow(self, source: "LiveDevice") -> None:
        last = max((update.number for update in source.updates()), default=0)
        while self.recording and source is self._bench.source:
            await asyncio.sleep(LOOK_S)
            came = source.updates(last)
            if came:
                last = came[-1].number
                self.course.take(update.raw for update in came)
        self.recording = False


# ---- The page


def page(visit: "Visit") -> None:
    """Build the page."""
    parts.text("p", "The device rests at known temperatures, so that its drift can be fitted and corrected.")
    parts.redrawn(lambda: (run_state(visit), visit.bench.warm_up.recording), lambda: _part(visit))


def _part(visit: "Visit") -> None:
    bench = visit.bench
    run, warm_up = bench.rig_run, bench.warm_up
    if warm_up.recording:
        parts.text("h2", "Recording a warm-up")
        parts.text("p", "Leave the device at rest. The recording continues when this page is closed.")
        course = warm_up.course
        parts.status_line(lambda: steadiness_words(course.slope_c_per_min, course.limit, course.stable_since), "soak")
        parts.drawing("lines", lambda: curve(course.curve), "curve")
        parts.text("p", _corrected(visit), "soft")
        parts.error_line(lambda: warm_up.error)
        parts.next_step("End and fit the drift", lambda: warm_up.finish(visit))
    elif run is None or (run.view.steps and not run.view.set_points() and not run.may_move):
        parts.text("h2", "With a chamber")
        order_form(visit, visit.soaks, chamber=True)
        parts.text("h2", "Without a chamber")
        parts.text("p", "Switch the cold device on, leave it at rest, and record until its temperature is stable.")
        connect_form(visit)
        parts.error_line(lambda: warm_up.error)
        parts.button("Record a warm-up", warm_up.start)
    elif run.view.steps and not run.view.set_points():
        parts.text("p", "A run at room temperature is in progress.")
        parts.next_step("Open the rate table", "/rate-table")
    else:
        run_part(bench, run, lambda: _fit(visit))
        parts.status_line(lambda: soak_words(run.view), "soak")
        parts.drawing("lines", lambda: curve(run.view.curve, run.view.speed), "curve")
        _set_points(run)


def _fit(visit: "Visit") -> None:
    parts.text("p", _corrected(visit), "soft")
    parts.next_step("Fit the drift", lambda: visit.bench.table.fit_drift(visit))


def _corrected(visit: "Visit") -> str:
    if visit.calibration is None:
        return str(parts.texts()["says"]["uncalibrated"])
    return f"The tables are added to the calibration {visit.library.name_of(visit.calibration)}."


def _set_points(run: RigRun) -> None:
    """Add the set-points with what is done and what is left."""

    def rows() -> list[list[str]]:
        states = [
            ("done" if done == count else "begun" if done else "left") for _, done, count in run.view.set_points()
        ]
        points = zip(run.view.set_points(), states, strict=True)
        return [[f"{temp_c:g} degC", f"{done} of {count}", state] for (temp_c, done, count), state in points]

    parts.table("Set-points", ("Temperature", "Dwells recorded", "State"), rows)


# ---- Temperatures in words and drawn


def soak_words(view: View) -> str:
    """Say whether the set-point is reached, by the criterion of the run."""
    soaks = [step for step in view.steps[: view.number + 1] if step["kind"] == "soak"]
    if not soaks or view.state not in ("running", "pausing"):
        return ""
    aim = f"{soaks[-1]['temp_c']:g} degC"
    if view.phase in ("soaking", "setting"):
        return f"Soaking at {aim}: {steadiness_words(view.slope_c_per_min, soaks[-1]['slope_c_per_min'], None)}"
    since = view.stable_since
    return f"Stable at {aim}{'' if since is None else f' since {_clock(since)}'}."


def steadiness_words(slope: float | None, limit: float, since: float | None) -> str:
    """Say how fast a temperature changes, and since when it is stable."""
    if since is not None:
        return f"Stable since {_clock(since)}: it changes by less than {limit:g} K/min."
    if slope is None:
        return f"not stable yet; the slope is known after some minutes. Stable below {limit:g} K/min."
    return f"it changes by {slope:.2f} K/min. Stable below {limit:g} K/min."


def _clock(since: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(since))


def curve(points: Sequence[Point], speed: float = 1.0) -> list[object]:
    """Return the temperatures of device and air over the table's minutes, as a drawing takes them."""
    points = points[:: max(1, len(points) // DRAWN)]
    over = [(p, round((p.time - points[0].time) * speed / 60.0, 3)) for p in points]
    device, air = ([(minutes, getattr(p, name)) for p, minutes in over] for name in ("device_c", "air_c"))
    return ["Temperature", "°C", "min", [("device", "none", device), ("air of the chamber", "6 5", air)]]
