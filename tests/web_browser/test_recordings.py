"""The page Recordings: a file dropped, its map proposed, corrected, oriented, validated, downloaded."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from testkit.bench import BenchServer
from web_browser.conftest import shoot

DATA = Path(os.environ.get("UNDRIFT_DATA", Path(__file__).parents[3] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the folder of recordings is absent (UNDRIFT_DATA)")
COMMAND_MS = 40_000


@needs_data
def test_a_table_is_mapped_calibrated_and_corrected_without_a_command_line(
    bench_server: BenchServer, open_page: Callable[..., Page]
) -> None:
    page = open_page("/recordings")
    page.set_default_timeout(COMMAND_MS)
    page.get_by_label("Choose files").set_input_files(DATA / "ferraris_nilspod" / "example_ferraris_session.csv")
    page.get_by_label("Samples per second, Hz").fill("204.8")
    shoot(page, "recordings-map")
    page.get_by_role("button", name="Read the file").click()
    page.get_by_label("Angle of its turns, deg").fill("360")
    shoot(page, "recordings-read")
    page.get_by_role("button", name="Calibrate").click()
    page.wait_for_url("**/result")
    verdict = page.get_by_role("heading", name="Verdict:")
    expect(verdict).to_have_text("Verdict: marginal")
    shoot(page, "result-of-a-recording")
    page.goto(bench_server.address + "recordings")
    page.get_by_role("button", name="Correct").click()
    with page.expect_download() as download:
        page.get_by_role("link", name="correct: example_ferraris_session-corrected.parquet").click()
    assert download.value.path().stat().st_size > 10_000
    shoot(page, "recordings-corrected")


@needs_data
def test_a_recording_with_optics_is_oriented_and_validated(open_page: Callable[..., Page]) -> None:
    page = open_page("/recordings", width=390)
    page.set_default_timeout(COMMAND_MS)
    page.get_by_label("Choose files").set_input_files(DATA / "broad" / "35_disturbed_attached_magnet_4cm.hdf5")
    page.get_by_role("button", name="Validate").click()
    link = page.get_by_role("link", name="validate: report")
    with page.expect_popup() as popup:
        link.click()
    popup.value.wait_for_load_state()
    assert "deg" in popup.value.locator("p.answer").inner_text()
    shoot(page, "recordings-validated-390")
    page.get_by_role("button", name="Calibrate by these optics").click()
    page.wait_for_url("**/result")
    expect(page.get_by_role("heading", name="Verdict:")).to_be_visible()
    shoot(page, "result-by-optics-390")
    page.get_by_label("Serial number of the device").fill("BROAD D")
    page.get_by_role("button", name="Register the calibration").click()
    expect(page.get_by_text("Registered as entry 1")).to_be_visible(timeout=COMMAND_MS)


@needs_data
def test_a_file_without_time_is_read_at_the_rate_that_is_stated(open_page: Callable[..., Page]) -> None:
    page = open_page("/recordings")
    page.get_by_label("Choose files").set_input_files(DATA / "worn_lowback" / "HA_001_Test11.csv.gz")
    rate = page.get_by_label("Samples per second, Hz")
    rate.fill("0", timeout=COMMAND_MS)
    page.get_by_role("button", name="Read the file").click()
    expect(page.locator(".bench-main")).to_contain_text("sample rate: wanted a number above 0, got '0'")
    rate.fill("100")
    page.get_by_role("button", name="Read the file").click()
    expect(page.locator(".bench-main")).to_contain_text("samples at 100 Hz", timeout=COMMAND_MS)


def test_what_is_no_recording_gets_one_line_and_is_not_kept(
    bench_server: BenchServer, open_page: Callable[..., Page], tmp_path: Path
) -> None:
    page = open_page("/recordings")
    for name, content, words in (
        ("virus.exe", b"MZ", "wanted a recording"),
        ("empty.csv", b"", "got an empty file"),
        ("noise.parquet", bytes(range(256)) * 40, "binary data of an unknown kind"),
    ):
        (tmp_path / name).write_bytes(content)
        page.get_by_label("Choose files").set_input_files(tmp_path / name)
        expect(page.locator(".bench-main")).to_contain_text(words, timeout=COMMAND_MS)
    shoot(page, "recordings-refused")
    kept = [path.name for path in (bench_server.folder / "uploads").rglob("*") if path.is_file()]
    assert kept == ["noise.parquet"]
