"""Temperature: rests at set-points of a chamber, or one rest during a warm-up: curve, soak, what is left; then the fit."""

import time
from collections.abc import Callable, Sequence
from functools import partial

from nicegui import ui

from undrift.web.bench import Bench
from undrift.web.frame import button, connect_form, error_line, frame, next_step, redrawn, scrolling, set_text, text
from undrift.web.pages.rate_table import order_form, run_part, run_state
from undrift.web.rig_run import Point, View

DRAW_S = 1.0  # between two drawings of the curve
WIDTH, HEIGHT, LEFT, BOTTOM = 640, 240, 56, 34
DRAWN = 300  # points of a curve


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Temperature"):
        text("p", "The device rests at known temperatures, so that its drift can be fitted and corrected.")
        client = ui.context.client  # a button may be drawn anew before its work is done
        redrawn(lambda: (run_state(bench), bench.warm_up.recording), lambda look: _part(bench, look, client.open))


def _part(bench: Bench, look: Callable[[], None], go: Callable[[str], None]) -> None:
    run, warm_up = bench.rig_run, bench.warm_up
    if warm_up.recording:
        _recording(bench, go)
    elif run is None or (run.view.steps and not run.view.set_points() and not run.may_move):
        text("h2", "With a chamber")
        order_form(bench, bench.table.soaks, chamber=True)
        text("h2", "Without a chamber")
        text("p", "Switch the cold device on, leave it at rest, and record until its temperature is stable.")
        connect_form(bench)
        error_line(lambda: warm_up.error)
        button("Record a warm-up", warm_up.start)
    elif run.view.steps and not run.view.set_points():
        text("p", "A run at room temperature is in progress.")
        next_step("Open the rate table", "/rate-table")
    else:
        run_part(bench, look, lambda: _fit(bench, go))
        _soak(lambda: soak_words(run.view))
        _curve(lambda: run.view.curve, lambda: run.view.speed)
        _set_points(run.view)


def _fit(bench: Bench, go: Callable[[str], None]) -> None:
    async def fit() -> None:
        if await bench.table.fit_drift():
            go("/result")

    text("p", _corrected(bench), "soft")
    next_step("Fit the drift", fit)


def _corrected(bench: Bench) -> str:
    if bench.calibration is None:
        return (
            "No calibration is chosen: a device that sends counts needs one from the rate table, at room temperature."
        )
    return f"The tables are added to the calibration {bench.calibration.parent.name}."


def _recording(bench: Bench, go: Callable[[str], None]) -> None:
    """Add a warm-up that goes on."""
    held = bench.warm_up

    async def finish() -> None:
        if await held.finish():
            go("/result")

    text("h2", "Recording a warm-up")
    text("p", "Leave the device at rest. The recording continues when this page is closed.")
    _soak(lambda: steadiness_words(held.slope_c_per_min, held.settings.slope_c_per_min, held.stable_since))
    _curve(lambda: held.curve)
    text("p", _corrected(bench), "soft")
    error_line(lambda: held.error)
    next_step("End and fit the drift", finish)


# ---- What is shown of temperatures


def _soak(words: Callable[[], str]) -> None:
    made = text("p", words(), "soak").props('role="status"')
    ui.timer(DRAW_S, lambda: set_text(made, words()))


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


def _set_points(view: View) -> None:
    """Add the set-points with what is done and what is left."""
    with scrolling("Set-points"), ui.element("table"):
        text("caption", "Set-points")
        with ui.element("thead"), ui.element("tr"):
            for name in ("Temperature", "Dwells recorded", "State"):
                text("th", name).props('scope="col"')
        with ui.element("tbody"):
            cells = [_row(temp_c) for temp_c, _, _ in view.set_points()]

    def refresh() -> None:
        for (dwells, state), (_, done, count) in zip(cells, view.set_points(), strict=True):
            set_text(dwells, f"{done} of {count}")
            set_text(state, "done" if done == count else "begun" if done else "left")

    refresh()
    ui.timer(DRAW_S, refresh)


def _row(temp_c: float) -> tuple[ui.element, ui.element]:
    with ui.element("tr"):
        text("th", f"{temp_c:g} degC").props('scope="row"')
        return text("td"), text("td")


def _curve(points: Callable[[], Sequence[Point]], speed: Callable[[], float] = lambda: 1.0) -> None:
    made = ui.html("", sanitize=False).classes("curve")

    def refresh() -> None:
        drawn = curve_svg(points(), speed())
        if made.content != drawn:
            made.set_content(drawn)

    refresh()
    ui.timer(DRAW_S, refresh)


def curve_svg(points: Sequence[Point], speed: float = 1.0) -> str:
    """Draw the temperatures of air and device over the table's minutes; the device is the solid line."""
    points = points[:: max(1, len(points) // DRAWN)]
    known = [temp for point in points for temp in (point.air_c, point.device_c) if temp is not None]
    if len(points) < 2 or not known:
        return ""
    start, low, high = points[0].time, min(known) - 0.5, max(known) + 0.5
    span = max(points[-1].time - start, 1e-3)
    at_x = partial(_scaled, low=0.0, high=span, first=LEFT, last=WIDTH - 10)
    at_y = partial(_scaled, low=low, high=high, first=HEIGHT - BOTTOM, last=10)
    lines = []
    for name, dashes in (("air_c", "6 5"), ("device_c", "none")):
        held = [(at_x(p.time - start), at_y(temp)) for p in points if (temp := getattr(p, name)) is not None]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in held)
        lines.append(
            f'<polyline points="{path}" fill="none" stroke="currentColor" stroke-width="2" stroke-dasharray="{dashes}"/>'
        )
    ticks = "".join(
        f'<text x="{LEFT - 8}" y="{at_y(value) + 5:.1f}" text-anchor="end">{value:.1f}</text>' for value in (low, high)
    ) + "".join(
        f'<text x="{at_x(value):.1f}" y="{HEIGHT - 12}" text-anchor="{end}">{value * speed / 60.0:.1f} min</text>'
        for value, end in ((0.0, "start"), (span, "end"))
    )
    frame_ = f'<path d="M{LEFT} 10 V{HEIGHT - BOTTOM} H{WIDTH - 10}" fill="none" stroke="currentColor" opacity=".4"/>'
    now = next((f"{p.device_c:.2f} degC" for p in reversed(points) if p.device_c is not None), "not read")
    label = f"Temperature over time: from {min(known):.1f} to {max(known):.1f} degC; device now {now}"
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}" font-size="14" fill="currentColor">'
        f"{frame_}{''.join(lines)}{ticks}</svg>"
        f"<p class='soft'>Temperature, degC: device solid, air of the chamber dashed. Device: {now}.</p>"
    )


def _scaled(value: float, *, low: float, high: float, first: float, last: float) -> float:
    return first + (value - low) / (high - low) * (last - first)
