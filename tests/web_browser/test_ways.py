"""A physiotherapist with the ZIP of a phone: clicks and seconds from the first page."""

import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from playwright.sync_api import Page

import undrift
from web_browser.conftest import faults_of, picture, shoot, state_serial, wide_and_narrow
from web_browser.test_path import Pointer
from web_browser.test_recordings import COMMAND_MS

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


@wide_and_narrow
def test_from_the_zip_of_a_phone_to_a_corrected_file(
    open_page: Callable[..., Page], tmp_path: Path, width: int, height: int, scheme: str
) -> None:
    page, problems = open_page("/", width=width, height=height, color_scheme=scheme), list[str]()
    page.set_default_timeout(COMMAND_MS)
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    hand, began = Pointer(page), time.monotonic()
    picture(page, "readings")
    page.get_by_label("Choose files").set_input_files(phone_zip(tmp_path))
    hand.clicks += 2  # the chooser, and the file in it
    page.get_by_text("|a| at rest").wait_for()
    picture(page, "check", top=560)
    hand.click("Calibrate from it", "link")
    state_serial(page, "phone of room 2")
    hand.click("Calibrate")
    page.get_by_role("heading", name="Verdict:").wait_for()
    shoot(page, f"phone-calibrated-{width}-{scheme}")
    page.mouse.move(0, 0)
    problems += faults_of(page)
    page.get_by_role("navigation", name="Stages").get_by_role("link", name="Use").click()
    hand.clicks += 1
    hand.click("Correct")
    with page.expect_download() as download:
        page.get_by_role("link", name="correct: phone-corrected.parquet").click()
    hand.clicks += 1
    assert download.value.path().stat().st_size > 10_000
    shoot(page, f"phone-corrected-{width}-{scheme}")
    picture(page, "use")
    page.mouse.move(0, 0)
    problems += faults_of(page)
    print(
        f"\n{width} px: {hand.clicks} clicks, {time.monotonic() - began:.0f} s from a phone's ZIP to a corrected file"
    )
    assert problems == []
    assert hand.clicks <= CLICKS
