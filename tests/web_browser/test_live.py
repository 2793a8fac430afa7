"""The page Live in a browser: the practice device drawn, corrected, recorded; a lost server comes back; two see the same."""

import json
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import BrowserContext, Page, expect
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import undrift
from testkit.talking_device import TalkingDevice
from testkit.waiting import eventually
from web_browser.conftest import BenchServer, bench_process, faults_of, shoot

COMMAND_MS = 60_000


def connected(open_page: Callable[..., Page], **options: object) -> Page:
    page = open_page("/live", **{"reduced_motion": "no-preference"} | options)
    page.get_by_role("button", name="Use the practice device").click()
    expect(page.locator(".panel-state")).to_have_text("Live.")
    return page


def values(page: Page, plot: str) -> dict[str, float]:
    """Return what a screen reader hears of a plot: line -> newest value."""
    label = page.get_by_role("img", name=re.compile(plot)).get_attribute("aria-label") or ""
    found = re.findall(r"((?:raw |corrected )?\w+) (-?[\d.]+) (?:count|deg/s|m/s²|deg|°C|v)", label)
    return {name: float(value) for name, value in found}


def drawn(page: Page, plot: str) -> int:
    """Return how many pixels of a plot are not empty."""
    picture = page.get_by_role("img", name=re.compile(plot)).locator("canvas")
    counted = """canvas => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data
        .filter((value, k) => k % 4 === 3 && value > 0).length"""
    return int(picture.evaluate(counted))


def test_the_practice_device_is_drawn_and_its_values_are_said(open_page: Callable[..., Page]) -> None:
    page = connected(open_page)
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    expect(page.locator(".live-status")).to_contain_text(" readings per second (100 stated); 0 lost, 0 damaged")
    eventually(lambda: drawn(page, "Turn rate") > 2000, "lines are drawn")
    force = values(page, "Specific force")
    assert set(force) == {"raw x", "raw y", "raw z"}
    picture = page.get_by_role("img", name=re.compile("Turn rate"))
    expect(picture).not_to_have_attribute("aria-label", picture.get_attribute("aria-label") or "")
    shoot(page, "live-raw")
    assert faults == []


@pytest.mark.slow
def test_pause_holds_the_picture_and_the_time_shown_changes(open_page: Callable[..., Page]) -> None:
    page = connected(open_page)
    page.get_by_role("button", name="Pause").press("Enter")
    expect(page.locator(".panel-state")).to_have_text("Paused.")
    picture = page.get_by_role("img", name=re.compile("Turn rate")).locator("canvas")
    page.wait_for_timeout(300)
    before = picture.evaluate("canvas => canvas.toDataURL()")
    page.wait_for_timeout(600)
    assert picture.evaluate("canvas => canvas.toDataURL()") == before
    page.get_by_role("button", name="Resume").press("Space")
    expect(page.locator(".panel-state")).to_have_text("Live.")
    eventually(lambda: picture.evaluate("canvas => canvas.toDataURL()") != before, "the picture goes on")
    page.get_by_role("button", name="60 s").click()
    expect(page.get_by_role("button", name="60 s")).to_have_attribute("aria-pressed", "true")
    expect(page.get_by_role("button", name="10 s")).to_have_attribute("aria-pressed", "false")
    expect(page.get_by_role("img", name=re.compile("Turn rate over the last 60 s"))).to_be_visible()
    line = page.get_by_role("button", name=re.compile("^raw x"))
    line.first.click()
    expect(line.first).to_have_attribute("aria-pressed", "false")


@pytest.mark.slow
def test_a_calibration_of_the_bench_corrects_and_the_pitch_follows(
    open_page: Callable[..., Page], bench_server: BenchServer
) -> None:
    device = undrift.random_device(np.random.default_rng(2007), grade="consumer")  # the seed of the practice device
    session = undrift.simulate_session("bench", device, rng=np.random.default_rng(1))
    folder = bench_server.folder / "jobs" / "2026-01-01-000000-made"
    folder.mkdir(parents=True)
    undrift.write_calibration(undrift.calibrate(session), folder / "calibration.json")
    page = connected(open_page)
    page.get_by_label("Calibration").select_option("2026-01-01-000000-made")
    expect(page.get_by_role("img", name=re.compile("corrected x"))).to_have_count(2, timeout=COMMAND_MS)
    expect(page.get_by_role("img", name=re.compile("Pitch"))).to_be_visible()
    page.wait_for_timeout(3500)
    force = values(page, "Specific force")
    corrected = np.array([force[f"corrected {axis}"] for axis in "xyz"])
    assert abs(np.linalg.norm(corrected) - 9.81) < 0.15  # one reading with its noise
    assert abs(values(page, "Pitch")["pitch"]) < 5.0  # laid flat by hand
    rates = values(page, "Turn rate")
    assert max(abs(rates[f"corrected {axis}"]) for axis in "xyz") < 1.5
    shoot(page, "live-corrected")
    assert faults_of(page) == []
    page.get_by_label("Axis that points up").select_option("+x")
    page.get_by_role("button", name="Set axes").click()
    expect(page.get_by_role("alert").filter(has_text="two different axes")).to_be_visible()
    page.get_by_label("Axis that points forward").select_option("-z")
    page.get_by_role("button", name="Set axes").click()
    expect(page.get_by_role("alert").filter(has_text="two different axes")).to_have_count(0)
    # +z, which is up, is what points back
    eventually(lambda: abs(values(page, "Pitch").get("pitch", np.nan) - 90.0) < 5.0, "the pitch is 90 deg")
    second = open_page("/live", width=390, color_scheme="dark")
    expect(second.get_by_role("img", name=re.compile("corrected x"))).to_have_count(2)
    second.wait_for_timeout(1500)
    assert faults_of(second) == []
    shoot(second, "live-corrected-390-dark")


@pytest.mark.slow
def test_a_recording_goes_on_without_the_browser_and_is_what_the_device_sent(
    open_page: Callable[..., Page], bench_server: BenchServer, tmp_path: Path
) -> None:
    page = connected(open_page)
    page.get_by_role("button", name="Start recording").dblclick()  # the second click does not end what the first began
    expect(page.get_by_role("button", name="Stop recording")).to_be_visible()
    page.close()
    page = open_page("/live")
    expect(page.locator(".live-status")).to_contain_text(re.compile(r"recording live-.*, [3-9] s"))
    shoot(page, "live-recording")
    page.get_by_role("button", name="Stop recording").click()
    with page.expect_download() as download:
        page.get_by_role("link", name="Download it").click()
    path = tmp_path / "taken.parquet"
    download.value.save_as(path)
    record = undrift.read_record(path)
    assert record.duration_s >= 2.4  # the page rounds
    assert np.diff(record.time).max() < 0.02  # nothing is missing
    assert list(bench_server.folder.glob("uploads/live-*/*.part")) == []


@pytest.mark.slow
def test_a_recording_outlives_a_bench_that_is_killed(
    tmp_path: Path, new_context: Callable[..., BrowserContext]
) -> None:
    def opened(server: BenchServer, path: str, width: int = 1280) -> Page:
        page = new_context(viewport={"width": width, "height": 844 if width < 400 else 800}).new_page()
        page.set_default_timeout(COMMAND_MS)
        page.goto(server.address + path)
        return page

    with TalkingDevice() as device:
        device.leave_out = lambda k: k % 100 == 7
        with bench_process(tmp_path / "bench") as server:
            page = opened(server, "live")
            page.get_by_label("Address of the device").fill(device.address)
            page.get_by_role("button", name="Connect", exact=True).click()
            page.get_by_role("button", name="Start recording").click()
            expect(page.locator(".live-status")).to_contain_text(
                re.compile(r"recording live-.*talker.parquet, [6-9] s")
            )
            page.goto(server.address + "check")
            expect(page.locator(".bench-list li").first).to_contain_text("not finished")
            os.kill(server.process.pid or 0, signal.SIGKILL)
            server.process.join()
    with bench_process(tmp_path / "bench") as server:
        page = opened(server, "check")
        listed = page.locator(".bench-list li")
        expect(listed).to_have_count(1)
        expect(page.get_by_role("heading", name="Files", exact=True)).to_be_visible()  # of the device that it was of
        expect(listed).to_contain_text(re.compile(r"live-.*-talker\.parquet\.csv.*not finished"))
        shoot(page, "live-killed-1280")
        listed.locator(".choose").click()
        expect(page.locator(".bench-main")).to_contain_text("samples at 200 Hz", timeout=COMMAND_MS)
        expect(listed).not_to_contain_text("not finished")
        assert faults_of(page) == []
        shoot(page, "live-killed-read-1280")
        shoot(opened(server, "check", 390), "live-killed-390")
        record = undrift.read_record(*server.folder.glob("uploads/live-*/*.parquet.csv"))
    print(f"\n{record.duration_s:.2f} s of a recording of 6 s or more are there after kill -9")
    assert record.duration_s > 4.5
    numbers = np.round((np.asarray(record.temp_c) - 25.0) * 1e4)  # the device counts in its temperature
    lost = np.isnan(numbers)
    assert np.array_equal(np.diff(np.flatnonzero(lost)), [100] * (lost.sum() - 1))
    assert np.array_equal(numbers[~lost], (numbers[~lost][0] + np.arange(len(record)))[~lost])  # none is doubled


def turned_over(k: int) -> str:
    """Return reading k, 200 a second, of a device that rests with z up for 5 s, then with y up, again and again."""
    seconds = k / 200.0 % 12.0
    turns = seconds % 6.0 >= 5.0
    angle = min(max(seconds - 5.0, 0.0), 1.0) - max(seconds - 11.0, 0.0)  # in quarters of a turn about x
    rate = 90.0 * turns * (1.0 if seconds < 6.0 else -1.0)
    up, other = 9.81 * np.cos(0.5 * np.pi * angle), 9.81 * np.sin(0.5 * np.pi * angle)
    noise = 0.01 * np.sin(k * np.array([1.0, 2.0, 3.0]))
    return f"{rate + noise[0]:.4f},{noise[1]:.4f},{noise[2]:.4f},{noise[2]:.4f},{other:.4f},{up:.4f},25.0"


@pytest.mark.slow
def test_the_device_is_drawn_as_it_lies_once_a_rest_has_shown_it(open_page: Callable[..., Page]) -> None:
    page = open_page("/live", width=390)
    drawn = page.locator("undrift-drawing[kind=body]")
    expect(drawn).to_be_hidden()
    with TalkingDevice(numbers=turned_over) as device:
        page.get_by_label("Address of the device").fill(device.address)
        page.get_by_role("button", name="Connect", exact=True).click()
        for up in ("z", "y", "z"):
            picture = page.get_by_role("img", name=re.compile(rf"Device with \+{up} up, [01] deg off"))
            expect(picture).to_be_visible(timeout=COMMAND_MS)
        shoot(page, "live-body-390")
        assert faults_of(page) == []
        page.set_viewport_size({"width": 1280, "height": 800})
        shoot(page, "live-body-1280")


@pytest.mark.slow
def test_what_is_wrong_is_said_in_plain_words(open_page: Callable[..., Page]) -> None:
    page = open_page("/live")
    expect(page.locator(".panel-state")).to_have_text("No device connected.")
    page.get_by_label("Address of the device").fill("pigeon:loft")
    page.get_by_role("button", name="Connect", exact=True).click()
    alert = page.get_by_role("alert").filter(has_text="wanted")
    expect(alert).to_contain_text("pigeon")
    with TalkingDevice() as device:
        page.get_by_label("Address of the device").fill(device.address)
        page.get_by_role("button", name="Connect", exact=True).click()
        expect(page.locator(".panel-state")).to_have_text("Live.")
        device.silent = True
        expect(page.locator(".panel-state")).to_have_text("No new readings.")
        expect(page.get_by_role("alert").filter(has_text="tries again by itself")).to_be_visible()
        shoot(page, "live-silent")
        device.silent = False
        expect(page.locator(".panel-state")).to_have_text("Live.")
        expect(page.get_by_role("alert").filter(has_text="tries again by itself")).to_have_count(0)


@pytest.mark.slow
def test_the_panel_connects_again_when_its_socket_is_cut(open_page: Callable[..., Page]) -> None:
    page = open_page("/")
    page.add_init_script(
        """const Real = WebSocket; window.feeds = [];
        window.WebSocket = class extends Real {
            constructor(...words) { super(...words); if (/feed/.test(words[0])) feeds.push(this); }
        };"""
    )
    page.goto(page.url + "live")
    page.get_by_role("button", name="Use the practice device").click()
    expect(page.locator(".panel-state")).to_have_text("Live.")
    assert page.evaluate("feeds.length") == 1
    page.evaluate("feeds[0].close()")
    page.wait_for_function("feeds.length === 2")
    expect(page.locator(".panel-state")).to_have_text("Live.")


@pytest.mark.slow
def test_less_motion_is_drawn_once_a_second(open_page: Callable[..., Page]) -> None:
    counts = {}
    for motion in ("no-preference", "reduce"):
        page = connected(open_page, reduced_motion=motion)
        page.wait_for_timeout(1000)
        counts[motion] = page.evaluate(
            """async () => {
                const canvas = document.querySelector('.panel-plot canvas'), seen = new Set(), start = performance.now();
                while (performance.now() - start < 3000) {
                    seen.add(canvas.toDataURL());
                    await new Promise(resolve => setTimeout(resolve, 30));
                }
                return seen.size;
            }"""
        )
    print(f"  pictures in 3 s: {json.dumps(counts)}")
    assert counts["reduce"] <= 5
    assert counts["no-preference"] > 2 * counts["reduce"]


def test_the_feed_wants_the_token_of_the_pages(tmp_path: Path) -> None:
    token = "a-token-of-the-test"
    with bench_process(tmp_path / "bench", "--network", "--token", token) as server:
        address = server.address.partition("?")[0].replace("http", "ws") + "feed?plots=rate"
        host = address.split("/")[2]
        for query, headers in (
            ("", {}),
            ("&token=another-token", {}),
            ("", {"Cookie": f"undrift_token_{server.port}=another-token"}),
            (f"&token={token}", {"Origin": "http://elsewhere.example"}),
        ):
            with pytest.raises(InvalidStatus, match="403"), connect(address + query, additional_headers=headers):
                pass
        for query, headers in (
            (f"&token={token}", {}),
            ("", {"Cookie": f"undrift_token_{server.port}={token}", "Origin": f"http://{host}"}),
        ):
            with connect(address + query, additional_headers=headers) as browser:
                assert json.loads(browser.recv(timeout=20))["source"] is None
