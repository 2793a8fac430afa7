"""The page Devices: what is due, how a device changed, its calibration in use and as a file; a name is no markup."""

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import undrift
from testkit.bench import BenchServer
from undrift.registry.documents import Stated, of_calibration
from undrift.registry.registry import open_registry
from web_browser.conftest import faults_of, shoot

COMMAND_MS = 40_000
ODD = "B\"2' <b onclick=x>"


@pytest.fixture(scope="module")
def known() -> undrift.Calibration:
    rng = np.random.default_rng(7)
    return undrift.calibrate(undrift.simulate_session("bench", undrift.random_device(rng), rng=rng))


@pytest.fixture
def filled(bench_server: BenchServer, known: undrift.Calibration, tmp_path: Path) -> BenchServer:
    """Fill the registry of the bench: a device with three calibrations, one that is overdue, one with an odd name."""
    now = datetime.now(UTC)
    with open_registry(str(tmp_path / "registry.sqlite"), station="bench") as registry:
        for serial, days_ago, gain in (
            ("A17", 400, 1.0),
            ("A17", 200, 1.0),
            ("A17", 20, 1.004),
            ("late", 500, 1.0),
            (ODD, 345, 1.0),
        ):
            made = replace(
                known.provenance,
                created=(now - timedelta(days=days_ago)).isoformat(),
                inputs=((f"{days_ago}", f"{days_ago}"),),
            )
            model = replace(
                known, device=serial, provenance=made, gyro=replace(known.gyro, matrix=gain * known.gyro.matrix)
            )
            registry.add(of_calibration(model, Stated(note="each year"), source="test"))
    return bench_server


@pytest.mark.slow
def test_a_device_is_chosen_its_trend_read_and_its_calibration_used_and_downloaded(
    filled: BenchServer, open_page: Callable[..., Page]
) -> None:
    page = open_page("/registry")
    page.set_default_timeout(COMMAND_MS)
    rows = page.get_by_role("region", name="Devices, the most urgent first").locator("tbody tr")
    expect(rows).to_have_count(3, timeout=COMMAND_MS)
    assert [row.split("\t")[0] for row in rows.all_inner_texts()] == ["late", ODD, "A17"]
    assert "overdue by" in rows.nth(0).inner_text()
    assert "due in" in rows.nth(1).inner_text()
    expect(page.get_by_role("button", name="Show late")).to_be_visible()
    shoot(page, "devices-list")
    page.get_by_role("button", name="A17", exact=True).click()
    main = page.locator(".bench-main")
    expect(main).to_contain_text("of gyro", timeout=COMMAND_MS)
    expect(main).to_contain_text("sigma since")
    assert page.locator(".picture svg").count() == 1
    shoot(page, "devices-trend")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download entry 3").click()
    held = json.loads(download.value.path().read_text())
    assert (held["kind"], held["device"]) == ("undrift.calibration", "A17")
    page.get_by_role("button", name="Use this calibration").click()
    expect(main).to_contain_text("Files and live readings use entry 3.", timeout=COMMAND_MS)
    expect(page.get_by_role("link", name="Correct recordings")).to_be_visible()
    page.get_by_role("button", name="Use entry 2").click()
    expect(page.get_by_role("button", name="Use this calibration")).to_be_visible(timeout=COMMAND_MS)
    other = open_page("/registry")  # a second browser looks at what it likes
    expect(other.get_by_role("button", name="Show late")).to_be_visible(timeout=COMMAND_MS)
    page.get_by_text("Every parameter since").click()
    assert faults_of(page) == []


@pytest.mark.slow
def test_by_keyboard_on_a_narrow_screen_and_an_odd_name_is_text(
    filled: BenchServer, open_page: Callable[..., Page]
) -> None:
    page = open_page("/registry", width=390)
    odd = page.get_by_role("button", name=ODD)
    odd.wait_for(timeout=COMMAND_MS)
    odd.focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name=f"Device {ODD}")).to_be_visible(timeout=COMMAND_MS)
    expect(page.locator(".bench-main")).to_contain_text("Two calibrations are needed to compare.")
    assert page.locator(".bench-main b").count() == 0
    shoot(page, "devices-390")
    assert faults_of(page) == []
    page.get_by_role("button", name="late", exact=True).click()
    expect(page.get_by_role("link", name="Calibrate it")).to_be_visible(timeout=COMMAND_MS)


def test_an_empty_registry_leads_to_the_first_calibration(open_page: Callable[..., Page]) -> None:
    page = open_page("/registry")
    expect(page.get_by_role("link", name="Calibrate a device")).to_be_visible(timeout=COMMAND_MS)
    expect(page.locator(".bench-main")).to_contain_text("No device is registered yet.")
