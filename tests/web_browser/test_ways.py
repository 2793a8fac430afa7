"""A physiotherapist with the ZIP of a phone, an engineer with a board at a serial port: clicks and seconds from the first page."""

import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import undrift
from testkit.printing_board import ACCEL_LSB_PER_G, GYRO_LSB_PER_DPS, PrintingBoard, sketch_line
from undrift.record import FACES
from undrift.sim.motion.motion import unit_vector
from web_browser.conftest import faults_of, picture, shoot, state_serial
from web_browser.test_path import Pointer
from web_browser.test_recordings import COMMAND_MS

CLICKS = 8  # at most
REST_S, MOVE_S, RATE_HZ = 4.0, 1.0, 100.0  # of the board on each face


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


@pytest.mark.parametrize(("width", "height", "scheme"), [(1280, 800, "light"), (390, 844, "dark")])
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
    expect(page.locator(".rail-device")).to_have_text("phone of room 2")
    assert problems == []
    assert hand.clicks <= CLICKS


def turned_line(k: int) -> bytes:
    """Return reading k of a board that is laid on one face after the other."""
    rng, (turn, into) = np.random.default_rng(k), divmod(k / RATE_HZ, REST_S + MOVE_S)
    here, there = (unit_vector(FACES[int(turn + more) % 6]) for more in (0, 1))
    share = np.clip((into - REST_S) / MOVE_S, 0.0, 1.0)
    up = here * np.cos(share * np.pi / 2.0) + there * np.sin(share * np.pi / 2.0) + (0.0 < share < 1.0) * 0.1
    gyro = (0.0 < share < 1.0) * 90.0 * GYRO_LSB_PER_DPS * np.array([0.3, 0.5, 0.8]) + np.array([120.0, -60.0, 30.0])
    accel = 1.01 * ACCEL_LSB_PER_G * up + np.array([150.0, -90.0, 60.0])
    return sketch_line(
        k, round(k * 1e6 / RATE_HZ), gyro + rng.normal(0.0, 4.0, 3), accel + rng.normal(0.0, 30.0, 3), 25.0
    )


@pytest.mark.slow
def test_from_a_board_at_a_serial_port_to_a_calibration(open_page: Callable[..., Page]) -> None:
    page, problems = open_page("/", width=1280, height=800), list[str]()
    page.set_default_timeout(COMMAND_MS)
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    hand, began = Pointer(page), time.monotonic()
    with PrintingBoard(patience_s=1.0).print_lines(turned_line, RATE_HZ) as board:
        page.get_by_label("Address of the device").fill(f"serial://{board.port}")
        hand.click("Connect")
        page.wait_for_url("**/readings")
        hand.click("Calibrate from motion", "link")
        hand.click("Start recording")
        page.wait_for_timeout(1000.0 * 6.5 * (REST_S + MOVE_S))  # all faces, wherever it began
        hand.click("Stop recording")
        expect(page.get_by_text("Recorded: live-")).to_be_visible()
    page.get_by_role("navigation", name="Stages").get_by_role("link", name="Calibrate").click()
    state_serial(page, "board of room 2")
    hand.clicks += 1
    hand.click("Calibrate")
    expect(page.get_by_role("heading", name="Verdict:")).to_be_visible()
    expect(page.get_by_role("region", name="Verdict")).to_contain_text(
        "It lacks the gyroscopes"
    )  # it was not turned by known angles
    shoot(page, "board-calibrated-1280")
    page.mouse.move(0, 0)
    problems += faults_of(page)
    print(f"\n{hand.clicks} clicks, {time.monotonic() - began:.0f} s from a serial port to a calibration")
    assert problems == []
    assert hand.clicks == 6


@pytest.mark.slow
def test_from_the_first_page_to_a_calibration_by_the_emulated_table(open_page: Callable[..., Page]) -> None:
    page, problems = open_page("/", width=1280, height=800), list[str]()
    page.set_default_timeout(2.0 * COMMAND_MS)  # of a run of 15 min at 100 times the speed
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    hand, began = Pointer(page), time.monotonic()
    hand.click("Run the rate table", "link")
    state_serial(page, "unit 17")
    page.get_by_label("Speed of the emulated table").select_option("100")
    hand.click("Use the emulated table")
    expect(page.get_by_text("The emulated operator mounts the device.")).to_be_visible()
    hand.click("Start")
    expect(page.get_by_role("button", name="Emergency stop")).to_be_visible()
    expect(page.locator(".bench-main")).to_contain_text("deg/s about x")
    shoot(page, "table-running-1280")
    problems += faults_of(page)
    hand.click("Calibrate", wait_ms=2.0 * COMMAND_MS)
    page.wait_for_url("**/calibrate")
    expect(page.get_by_role("heading", name="Verdict:")).to_be_visible()
    expect(page.get_by_role("region", name="Verdict")).to_contain_text("Device unit 17")
    shoot(page, "table-calibrated-1280")
    page.mouse.move(0, 0)
    problems += faults_of(page)
    hand.clicks += 2  # the list of speeds and its last
    print(f"\n{hand.clicks} clicks, {time.monotonic() - began:.0f} s from the first page to a calibration by the table")
    assert problems == []
    assert hand.clicks == 6
