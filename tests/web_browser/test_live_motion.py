"""Calibration from motion on the bench: a device that is moved, the prior of its part and the magnetometer, at both widths."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from testkit.guided_motion import guided_recording
from undrift.base.codec import write
from undrift.calibration.element_prior import ElementPrior, KindSize
from undrift.io.parquet import write_parquet
from web_browser.conftest import BenchServer, faults_of, shoot, state_serial, step

from commands.test_live_motion import TurnedTalker  # isort: skip

COMMAND_MS = 60_000


@pytest.mark.slow
def test_a_device_that_is_moved_is_calibrated_when_each_element_is_known(
    bench_server: BenchServer, open_page: Callable[..., Page]
) -> None:
    record, _ = guided_recording(0, 5)
    with TurnedTalker(np.hstack((np.degrees(record.gyro), np.asarray(record.accel)))) as device:
        page = open_page("/live")
        page.set_default_timeout(COMMAND_MS)
        motion = page.get_by_role("region", name="Calibrate from motion")
        motion.get_by_role("button", name="Start to calibrate").click()
        expect(motion).to_contain_text("motion: wanted a device that sends, got none; connect it first")
        page.get_by_label("Address of the device").fill(device.address)
        page.get_by_role("button", name="Connect", exact=True).click()
        expect(page.locator(".bench-device")).to_contain_text("talker")
        motion.get_by_role("button", name="Start to calibrate").click()
        bars = motion.get_by_role("progressbar")
        expect(bars).to_have_count(18, timeout=COMMAND_MS)
        expect(motion).to_contain_text("of 18 elements known well enough")
        expect(motion.get_by_role("progressbar", name="gyroscope scale x")).to_be_visible()
        for width in (390, 1280):
            page.set_viewport_size({"width": width, "height": 900})
            shoot(page, f"live-motion-{width}")
            assert faults_of(page) == []
        link = motion.get_by_role("link", name="See the result")
        expect(link).to_be_visible(timeout=3 * COMMAND_MS)
        link.click()
        expect(page.get_by_role("heading", name="Verdict:")).to_be_visible()
    (made,) = bench_server.folder.glob("jobs/*/calibration.json")
    assert json.loads(made.read_text())["gyro"]["method"] == "motion"
    assert made.with_name("motion.parquet").exists()


@pytest.mark.slow
def test_the_prior_of_the_part_and_the_magnetometer_are_options_of_the_page(
    bench_server: BenchServer, open_page: Callable[..., Page], tmp_path: Path
) -> None:
    record, _ = guided_recording(1, 2)
    write_parquet(record, tmp_path / "moved.parquet")
    prior = ElementPrior(source="16 devices of a part", devices=16, gyro_scale=KindSize(size=0.002, as_from=54.0))
    write(prior, tmp_path / "part.json")
    page = open_page("/check", width=390)
    page.set_default_timeout(COMMAND_MS)
    page.get_by_label("Choose files").set_input_files(tmp_path / "part.json")
    expect(page.locator(".bench-main")).to_contain_text("prior of a part, learnt from 16 devices", timeout=COMMAND_MS)
    page.get_by_label("Choose files").set_input_files(tmp_path / "moved.parquet")
    page.get_by_role("heading", name="moved.parquet").wait_for()
    step(page, "Calibrate")
    state_serial(page)
    page.get_by_label("Prior of the part").select_option("part.json")
    page.get_by_label("calibrate it too").check()
    shoot(page, "recordings-motion")
    page.get_by_role("button", name="Calibrate from its motion").click()
    expect(page.locator(".bench-error").first).to_contain_text(
        "magnetometer: wanted its readings in a recording", timeout=COMMAND_MS
    )
    page.get_by_label("calibrate it too").uncheck()
    page.get_by_role("button", name="Calibrate from its motion").click()
    page.wait_for_url("**/calibrate")
    (made,) = bench_server.folder.glob("jobs/*/calibration.json")
    assert json.loads(made.read_text())["provenance"]["settings"]["prior"] == "16 devices of a part"
