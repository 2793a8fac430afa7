"""Whose is what: tabs choose and type for themselves; files and jobs outlive a bench that is killed; names, deletion, a quota."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import BrowserContext, Page, expect

import undrift
from testkit.bench import BenchServer, bench_process
from undrift.io.parquet import write_parquet
from web_browser.conftest import faults_of, shoot, state_serial, step
from web_browser.test_recordings import COMMAND_MS, phone_files


def test_two_tabs_choose_and_type_for_themselves(open_page: Callable[..., Page], tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    device = undrift.random_device(rng)
    undrift.write_calibration(
        undrift.calibrate(undrift.simulate_session("bench", device, rng=rng)), tmp_path / "calibration.json"
    )
    write_parquet(undrift.simulate_trial("posturography", device, rng=rng).record, tmp_path / "stance.parquet")
    first = open_page("/check")
    first.get_by_label("Choose files").set_input_files(tmp_path / "stance.parquet")
    first.get_by_role("link", name="Calibrate from it").click(timeout=COMMAND_MS)
    angle = first.get_by_label("Angle of its turns, deg")
    angle.press_sequentially("36")
    second = open_page("/check", width=390)
    second.get_by_label("Choose files").set_input_files(tmp_path / "calibration.json")
    expect(second.locator(".bench-main")).to_contain_text("Recordings are corrected with this", timeout=COMMAND_MS)
    angle.press("End")
    angle.press_sequentially("0")
    expect(angle).to_have_value("360")
    expect(first.get_by_role("navigation", name="Stages")).to_contain_text("no calibration")
    expect(second.get_by_role("navigation", name="Stages")).to_contain_text("calibration chosen")
    step(second, "Use")
    second.get_by_role("button", name="stance.parquet", exact=True).click()
    expect(second.get_by_role("button", name="Correct", exact=True)).to_be_visible()
    expect(first.get_by_role("heading", name="Calibrate from stance.parquet")).to_be_visible()
    first.reload()
    expect(angle).to_have_value("360")
    step(first, "Use")
    expect(first.locator(".bench-list .choose")).to_have_text(["calibration.json", "stance.parquet"])
    expect(first.locator(".bench-main")).to_contain_text("No calibration chosen")
    first.close()
    assert faults_of(second) == []


@pytest.mark.slow
def test_files_and_jobs_outlive_a_bench_that_is_killed(
    tmp_path: Path, new_context: Callable[..., BrowserContext]
) -> None:
    (tmp_path / "sent").mkdir()
    names = ["walk.parquet", "Accelerometer, Gyroscope"]
    rng = np.random.default_rng(3)
    session = undrift.simulate_session("six_face", undrift.random_device(rng), rng=rng)
    write_parquet(session.records[0], tmp_path / "walk.parquet")

    def opened(server: BenchServer, path: str) -> Page:
        page = new_context(viewport={"width": 1280, "height": 800}).new_page()
        page.set_default_timeout(COMMAND_MS)
        page.goto(server.address + path)
        return page

    with bench_process(tmp_path / "bench") as server:
        page = opened(server, "check")
        page.get_by_label("Choose files").set_input_files(phone_files(tmp_path / "sent"))
        expect(page.locator(".bench-main")).to_contain_text("60 samples at 50 Hz", timeout=COMMAND_MS)
        page.get_by_label("Choose files").set_input_files(tmp_path / "walk.parquet")
        page.get_by_role("heading", name="walk.parquet").wait_for()
        step(page, "Calibrate")
        state_serial(page)
        page.get_by_role("button", name="Calibrate", exact=True).click()
        page.wait_for_url("**/calibrate")
        page.get_by_role("heading", name="Verdict:").wait_for()
        server.process.kill()
        server.process.join()
    began = time.monotonic()
    with bench_process(tmp_path / "bench") as server:
        page = opened(server, "check")
        files = page.locator(".bench-list .choose")
        expect(files).to_have_text(names)
        print(f"\n2 of 2 files are listed again {time.monotonic() - began:.1f} s after the restart")
        expect(page.locator(".bench-list li").nth(1)).to_contain_text("60 samples at 50 Hz")
        page.get_by_role("button", name="Rename walk.parquet").click()
        page.get_by_label("Name", exact=True).fill("Six faces of imu3")
        page.get_by_role("button", name="Save the name").click()
        expect(files.first).to_have_text("Six faces of imu3")
        files.first.click()
        expect(page.get_by_role("heading", name="Six faces of imu3")).to_be_visible()
        shoot(page, "recordings-listed-1280")
        assert faults_of(page) == []
        page.once("dialog", lambda dialog: dialog.dismiss())
        page.get_by_role("button", name="Delete Six faces of imu3").click()
        expect(files).to_have_count(2)
        page.once("dialog", lambda dialog: dialog.accept())
        page.get_by_role("button", name="Delete Six faces of imu3").click()
        expect(files).to_have_text(names[1:])
        expect(page.get_by_role("heading", name="Six faces of imu3")).to_have_count(0)
        page.goto(server.address + "calibrate")
        expect(page.get_by_role("heading", name="Verdict:")).to_be_visible()
        expect(page.locator(".bench-list li")).to_contain_text("calibrated")
        shoot(page, "result-listed-1280")
        assert faults_of(page) == []


LARGE = (
    "upload: wanted at most 0.05 MB, got more in walk.csv; send a part of it, or ask whoever starts the bench to raise the "
    "largest file that it takes"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "limit", "rows", "refusal"),
    [
        ("--quota-gb", "0.00001", 5000, "wanted at most 1e-05 GB in it, got 3e-05 GB; delete files"),
        ("--upload-mb", "0.05", 10_000, LARGE),
        ("--upload-mb", "0.05", 10_000_000, LARGE),  # which the bench refuses before all of it was sent
    ],
    ids=["folder", "file", "before it was sent"],
)
def test_a_full_folder_and_a_large_file_are_refused_in_one_line(
    tmp_path: Path, new_context: Callable[..., BrowserContext], option: str, limit: str, rows: int, refusal: str
) -> None:
    with bench_process(tmp_path / "bench", option, limit) as server:
        page = new_context(viewport={"width": 390, "height": 844}).new_page()
        page.goto(server.address + "check")
        (tmp_path / "walk.csv").write_text("1,2,3\n" * rows)
        page.get_by_label("Choose files").set_input_files(tmp_path / "walk.csv")
        expect(page.locator(".bench-main")).to_contain_text(refusal)
        shoot(page, f"refused{option}-390")
