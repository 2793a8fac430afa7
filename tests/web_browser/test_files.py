"""Files in the browser: from a phone's ZIP to a corrected file, and a table whose columns and units a person chooses."""

import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import undrift
from web_browser.conftest import COMMAND_MS, Person, faults_of, picture, report, shoot, wide_and_narrow

CLICKS = 8  # at most


def phone_zip(folder: Path) -> Path:
    """Write six faces as an app of a phone exports them."""
    rng = np.random.default_rng(3)
    (record,) = undrift.simulate_session("six_face", undrift.random_device(rng), rng=rng).records
    path = folder / "phone.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, kind, unit, values in (
            ("Gyroscope", "Gyroscope", "rad/s", np.asarray(record.gyro) / 952.0),
            ("Accelerometer", "Acceleration", "m/s^2", np.asarray(record.accel) * 9.81 / 4096.0),
        ):
            head = ",".join(['"Time (s)"', *(f'"{kind} {x} ({unit})"' for x in "xyz")])
            rows = (",".join(f"{value:.6g}" for value in row) for row in np.column_stack((record.time, values)))
            archive.writestr(f"{name}.csv", "\n".join((head, *rows)) + "\n")
    return path


@pytest.mark.slow
@wide_and_narrow
def test_from_the_zip_of_a_phone_to_a_corrected_file(
    open_page: Callable[..., Page], tmp_path: Path, width: int, height: int, scheme: str
) -> None:
    page = open_page(width=width, height=height, color_scheme=scheme)
    person, faults, began = Person(page), list[str](), time.monotonic()
    faults += faults_of(page)
    picture(page, "readings")
    person.drop(phone_zip(tmp_path))
    expect(report(page).locator("body")).to_contain_text("acceleration at rest", timeout=COMMAND_MS)
    shoot(page, f"phone-checked-{width}")
    picture(page, "check")
    faults += faults_of(page)
    person.click("Calibrate the device from it")
    expect(page.get_by_label("Serial number")).to_have_value("phone")
    person.click("Calibrate")
    expect(report(page).locator(".verdict")).to_contain_text("Verdict:", timeout=COMMAND_MS)
    shoot(page, f"phone-calibrated-{width}")
    faults += faults_of(page)
    person.click("Correct recordings with it")
    person.click("Correct")
    with page.expect_download(timeout=COMMAND_MS) as download:
        person.click("Download phone-corrected.csv", "link")
    spent_s = time.monotonic() - began
    assert download.value.path().stat().st_size > 10_000
    shoot(page, f"phone-corrected-{width}")
    picture(page, "use")
    faults += faults_of(page)
    print(f"\n{width} px: {person.clicks} clicks, {spent_s:.0f} s from a phone's ZIP to a corrected file")
    page.reload()
    expect(page.get_by_role("link", name="Download phone-corrected.csv")).to_be_visible()
    assert (faults, person.complaints) == ([], [])
    assert person.clicks <= CLICKS
