"""The rate table in a browser: a whole run to its calibration, watched by two, reloaded, closed, paused, stopped; temperatures."""

import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import BrowserContext, Page, expect

from testkit.web_run import emulated_bench
from undrift.commands.bench.rig_run import RigRun, find_run
from undrift.io.store import read_calibration
from undrift.sim.device.truth import true_calibration
from web_browser.conftest import BenchServer, bench_process, faults_of, shoot

RUN_MS = 120_000
STOP_S = 1.0  # on a busy machine; `python -m benchmarks stop` has the strict figure, for an idle one
CLICKED = "for (const kind of ['click', 'keydown']) document.addEventListener(kind, () => { window.clicked = Date.now(); }, true)"


@pytest.fixture(scope="module")
def table() -> Iterator[Any]:
    """Emulate a table in this process; yield it with the moments at which it obeyed a stop."""
    with emulated_bench() as started:
        yield started


def fill(page: Page, bench: Any, **typed: str) -> None:
    """Fill in the addresses of an emulated table, whose operator is this test, and a short protocol."""
    page.get_by_label("Address of the table").fill(bench.rig_address)
    page.get_by_label("Address of the device").fill(bench.device_address)
    short = {"Lowest rate": "30", "Highest rate": "90", "Step": "30", "Each rate": "3", "Each face": "3"} | typed
    for label, value in short.items():
        page.get_by_label(label).fill(value)


def mount(page: Page, bench: Any, times: int) -> None:
    """Do what the page asks for."""
    asked = page.locator(".question p").first
    for _ in range(times):
        expect(asked).to_contain_text("Mount the device with", timeout=RUN_MS)
        words = asked.inner_text()
        bench.mount(words.split("with ")[1][:2])
        page.get_by_role("button", name="Done, continue").click()
        expect(page.locator(".question").filter(has_text=words)).to_have_count(0, timeout=RUN_MS)


def running(server: BenchServer) -> RigRun:
    """Return the run that goes on in a bench."""
    last = time.monotonic() + 30.0
    while (found := find_run(server.folder / "jobs")) is None or found.refresh().state != "running":
        assert time.monotonic() < last
        time.sleep(0.05)
    return found


@pytest.mark.slow
def test_a_whole_run_is_mounted_watched_reloaded_closed_and_ends_in_the_true_calibration(
    bench_server: BenchServer, open_page: Callable[..., Page], table: Any
) -> None:
    bench, _ = table
    page = open_page("/rate-table")
    fill(page, bench, Step="7")
    expect(page.locator(".bench-error").first).to_have_text(
        "rate grid: wanted a step that divides 60, got 7; try 6.66667"
    )
    expect(page.get_by_role("button", name="Start")).to_be_disabled()
    page.get_by_label("Step").fill("30")
    expect(page.locator(".forecast")).to_contain_text("Forecast: 30 dwells, up to 90 deg/s")
    shoot(page, "rate-table-form")
    assert faults_of(page) == []
    page.get_by_role("button", name="Start").click()
    mount(page, bench, 1)
    expect(page.get_by_role("button", name="Emergency stop")).to_be_visible()
    expect(page.locator(".bench-main")).to_contain_text(
        re.compile(r"step \d+ of 36: [+-]\d+ deg/s about x"), timeout=RUN_MS
    )
    trace = page.get_by_role("img", name=re.compile("Turn rate of SIM.*, scaled from .* measured .* commanded"))
    expect(trace).to_be_visible(timeout=RUN_MS)
    expect(page.get_by_role("img", name=re.compile(r"Box with \+x up"))).to_be_visible()
    expect(page.get_by_text("check the mounting")).to_have_count(0)
    shoot(page, "rate-table-running")
    assert faults_of(page) == []
    page.reload()
    expect(page.locator(".bench-main")).to_contain_text("of 30 dwells; step")
    watcher = open_page("/rate-table", width=390)
    expect(watcher.locator(".bench-main")).to_contain_text("of 30 dwells; step")
    expect(watcher.get_by_role("button", name="Emergency stop")).to_be_visible()
    expect(watcher.locator(".question")).to_contain_text("-x up", timeout=RUN_MS)
    shoot(watcher, "rate-table-question-390")
    assert faults_of(watcher) == []
    page.context.close()  # the one that began it
    mount(watcher, bench, 2)
    watcher.context.close()
    run = running(bench_server)  # nobody watches
    before = len(run.view.done)
    last = time.monotonic() + 60.0
    while len(run.refresh().done) <= before and run.view.question is None:
        assert time.monotonic() < last
        time.sleep(0.05)
    page = open_page("/rate-table")
    mount(page, bench, 3)
    page.get_by_role("button", name="Calibrate").click(timeout=RUN_MS)
    page.wait_for_url("**/calibrate", timeout=RUN_MS)
    expect(page.get_by_role("heading", name="Verdict:")).to_be_visible()
    shoot(page, "rate-table-result")
    (made,) = bench_server.folder.glob("jobs/*/calibration.json")
    found, true = read_calibration(made), true_calibration(bench.device)
    for name in ("gyro", "accel"):
        ratio = getattr(found, name).matrix @ np.linalg.inv(getattr(true, name).matrix)
        np.testing.assert_allclose(ratio, np.eye(3), atol=3e-3)


@pytest.mark.slow
def test_a_killed_bench_leaves_the_run_to_the_next_which_pauses_it_when_it_ends(
    tmp_path: Path, table: Any, new_context: Callable[..., BrowserContext]
) -> None:
    bench, _ = table
    with bench_process(tmp_path / "bench") as server:
        page = new_context().new_page()
        page.goto(server.address + "rate-table")
        page.wait_for_function("window.socket && window.socket.connected")
        fill(page, bench, **{"Each rate": "100"})
        page.get_by_role("button", name="Start").click()
        mount(page, bench, 1)
        expect(page.locator(".bench-main")).to_contain_text(
            re.compile(r"step \d+ of 36: [+-]\d+ deg/s about x"), timeout=RUN_MS
        )
        server.process.kill()
        server.process.join()
    assert running(server).is_going()
    with bench_process(tmp_path / "bench") as server:
        page = new_context().new_page()
        page.goto(server.address + "rate-table")
        expect(page.locator(".bench-main")).to_contain_text(
            re.compile(r"step \d+ of 36: [+-]\d+ deg/s about x"), timeout=RUN_MS
        )
        assert bench.rig.motor_on
    found = find_run(server.folder / "jobs")
    assert found is not None
    assert (found.view.state, found.is_going(), bench.rig.motor_on) == ("paused", False, False)


@pytest.mark.parametrize("way", ["button", "key", "halted"])
def test_the_emergency_stop_reaches_the_table_at_once(
    way: str, bench_server: BenchServer, open_page: Callable[..., Page], table: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    bench, obeyed = table
    page = open_page("/rate-table")
    fill(page, bench)
    page.evaluate(CLICKED)
    page.get_by_role("button", name="Start").click()
    mount(page, bench, 1)
    expect(page.locator(".bench-main")).to_contain_text("deg/s about x, ", timeout=RUN_MS)  # a busy page skips phases
    if way == "halted":
        os.kill(running(bench_server).view.pid or 0, signal.SIGSTOP)
    obeyed.clear()
    if way == "key":
        page.keyboard.press("Escape")
    else:
        page.get_by_role("button", name="Emergency stop").click()
    page.wait_for_function("window.clicked")
    expect(page.locator(".run-end")).to_contain_text(
        "Stopped: the table is at rest and its motor is off", timeout=RUN_MS
    )
    clicked_s = page.evaluate("window.clicked") / 1e3 - (time.time() - time.monotonic())
    # stops of the run itself come before
    late_s = next(moment - clicked_s for moment in obeyed if moment > clicked_s - 0.005)
    with capsys.disabled():
        print(f"\nstop by {way}: {1e3 * late_s:.0f} ms from the event in the browser to the table")
    assert late_s < STOP_S
    assert not bench.rig.motor_on
    shoot(page, f"rate-table-stopped-{way}")
    if way != "halted":  # what follows does not depend on the way
        return
    page.get_by_role("button", name="Continue").click()
    mount(page, bench, 1)
    page.get_by_role("button", name="Pause").click()
    expect(page.locator(".run-end")).to_contain_text("Paused: the table is at rest", timeout=RUN_MS)
    assert not bench.rig.motor_on
    page.get_by_role("button", name="New run").click()
    expect(page.get_by_label("Address of the table")).to_have_value(bench.rig_address)


@pytest.mark.slow
def test_temperatures_of_the_emulated_chamber_fill_a_table_and_end_in_a_fit(open_page: Callable[..., Page]) -> None:
    page = open_page("/rate-table")
    page.set_default_timeout(RUN_MS)
    page.get_by_label("Speed of the emulated table").select_option("100")
    page.get_by_role("button", name="Use the emulated table").click()
    page.get_by_text("The emulated operator mounts the device.").wait_for()
    page.get_by_label("Lowest rate").fill("30")
    page.get_by_label("Step").fill("60")
    page.get_by_role("button", name="Start").click()
    page.get_by_role("button", name="Calibrate").click()
    page.wait_for_url("**/calibrate")
    page.goto(page.url.replace("calibrate", "rate-table"))
    page.get_by_role("button", name="New run").click()
    page.goto(page.url.replace("rate-table", "temperature"))
    page.get_by_label("Temperatures, degC").fill("25, 30")
    for face in ("+x", "-x", "+y", "-y", "-z"):
        page.get_by_label(face, exact=True).uncheck()
    expect(page.locator(".forecast")).to_contain_text("Forecast: 2 dwells")
    shoot(page, "temperature-form")
    page.get_by_role("button", name="Start").click()
    expect(page.locator(".soak")).to_contain_text("Soaking at 30 degC:", timeout=RUN_MS)
    expect(page.get_by_role("img", name="Temperature from")).to_be_visible()
    rows = page.locator("tbody tr")
    expect(rows).to_have_text(["25 degC1 of 1done", "30 degC0 of 1left"])
    shoot(page, "temperature-soaking")
    assert faults_of(page) == []
    page.get_by_role("button", name="Fit the drift").wait_for()
    expect(rows).to_have_text(["25 degC1 of 1done", "30 degC1 of 1done"])
    shoot(page, "temperature-done")
    page.get_by_role("button", name="Fit the drift").click()
    page.wait_for_url("**/calibrate")
    expect(page.get_by_role("heading", name="Verdict:")).to_be_visible()
    shoot(page, "temperature-result")


@pytest.mark.slow
def test_a_warm_up_is_recorded_from_the_practice_device_and_what_is_missing_is_said(
    open_page: Callable[..., Page],
) -> None:
    page = open_page("/temperature")
    page.get_by_role("button", name="Record a warm-up").click()
    expect(page.locator(".bench-main")).to_contain_text(
        "warm-up: wanted a device that sends, got none; connect it first"
    )
    page.get_by_role("button", name="Use the practice device").click()
    expect(page.locator(".bench-device")).to_contain_text("Device:")
    page.get_by_role("button", name="Record a warm-up").click()
    expect(page.get_by_role("heading", name="Recording a warm-up")).to_be_visible()
    page.wait_for_timeout(1500)
    shoot(page, "temperature-warm-up")
    watcher = open_page("/temperature")
    expect(watcher.get_by_role("heading", name="Recording a warm-up")).to_be_visible()
    watcher.get_by_role("button", name="End and fit the drift").click()
    expect(watcher.locator(".bench-main")).to_contain_text("wanted", timeout=RUN_MS)  # seconds are no warm-up
    shoot(watcher, "temperature-warm-up-refused")
