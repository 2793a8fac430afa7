"""The guided captures as a person does them: the keyboard alone, the practice device, a reload in the middle."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

from testkit.bench import BenchServer
from testkit.guided import accel_as_six_faces_see_it, joint_factor
from testkit.waiting import eventually
from undrift.commands.bench.guides import ORDER, WAYS
from undrift.errors import FileFormatError
from undrift.io.session import read_session
from undrift.io.store import read_calibration
from undrift.record import Still
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from web_browser.conftest import CAPTURE_MS, faults_of, quick_and_real_time, shoot, turn_until_captured

SEED = 2007  # of the practice device, as bench_server states it
OpenPage = Callable[..., Page]


def press(page: Page, name: str, role: str = "button") -> None:
    """Go to a control with the Tab key alone, and press Enter."""
    target = page.get_by_role(role, name=name, exact=True)
    target.wait_for()
    for _ in range(120):
        page.keyboard.press("Tab")
        if target.evaluate("element => element === document.activeElement"):
            page.keyboard.press("Enter")
            return
    raise AssertionError(f"the Tab key never came to {name}")


def step_of(page: Page, name: str) -> str:
    """Return the state of a face or a turn in the list of what is captured."""
    return page.get_by_role("listitem").filter(has_text=name).locator(".step-state").inner_text()


def wait_for_step(page: Page, name: str) -> None:
    row = page.get_by_role("listitem").filter(has_text=name)
    row.filter(has_text="captured").wait_for(timeout=CAPTURE_MS)


@pytest.mark.slow
@quick_and_real_time
def test_six_faces_and_turns_by_keyboard_end_in_the_hidden_calibration(
    open_page: OpenPage, bench_server: BenchServer
) -> None:
    page, began = open_page("/six-faces"), time.monotonic()
    press(page, "Use the practice device")
    page.get_by_text("Turn +z up", exact=True).or_(page.get_by_text("Turn +x up", exact=True)).wait_for()
    faults = []
    for number, face in enumerate(ORDER):
        if number:
            press(page, f"{face} up")
        wait_for_step(page, f"{face} up")
        if number == 1:
            shoot(page, "six-faces-practice-1200")
            faults += faults_of(page)
        if number == 2:  # in the middle of the next move
            press(page, f"{ORDER[3]} up")
            page.reload()
            page.wait_for_function("window.socket && window.socket.connected")
            assert [step_of(page, f"{one} up") for one in ORDER[:3]] == ["✓ captured"] * 3
    page.get_by_text("All six faces are captured", exact=True).wait_for()
    shoot(page, "six-faces-complete-1200")
    faces_s = time.monotonic() - began
    press(page, "Continue to turns by hand", role="link")
    page.get_by_role("heading", level=1, name="Turns by hand").wait_for()
    for way in WAYS:
        seen = "counter-clockwise" if way[0] == "+" else "clockwise"
        page.get_by_text(f"Lay it with +{way[1]} up. Turn it once {seen}", exact=False).first.wait_for()
        if way[0] == "+":
            press(page, f"+{way[1]} up")
        turn_until_captured(page, way, lambda name=f"{way[1]} {seen}": press(page, name))
        if way == "+x":
            shoot(page, "turns-practice-1200")
            faults += faults_of(page)
    shoot(page, "turns-complete-1200")
    press(page, "Calibrate")
    page.wait_for_url("**/calibrate", timeout=90_000)
    page.get_by_text("Verdict:").wait_for()
    shoot(page, "result-of-turns-1200")
    print(f"\nsix faces {faces_s:.0f} s, with turns and calibration {time.monotonic() - began:.0f} s, by keyboard")
    assert faults == []
    (path,) = bench_server.folder.glob("jobs/*/calibration.json")
    made, device = read_calibration(path), random_device(np.random.default_rng(SEED), grade="consumer")
    assert made.device == device.serial
    matrix, offset = accel_as_six_faces_see_it(device)
    truth = true_calibration(device, temp_c=made.reference_temp_c).gyro
    for model, true_matrix, true_offset in ((made.accel, matrix, offset), (made.gyro, truth.matrix, truth.offset)):
        error = np.concatenate(((model.matrix - true_matrix).ravel(), model.offset - true_offset))
        over = np.abs(error) / np.sqrt(np.diag(model.covariance)[:12])
        print(f"{model.method}: largest error {over.max():.2f} standard uncertainties, limit {joint_factor(12):.2f}")
        assert over.max() < joint_factor(12)


def _stills_of(session: Path) -> tuple[Still, ...]:
    """Return the stills of a session; none while its recording is replaced and session.toml is still the earlier one."""
    try:
        return read_session(session).stills
    except FileFormatError:
        return ()


@quick_and_real_time
def test_a_second_browser_watches_and_a_narrow_one_redoes_a_face(
    open_page: OpenPage, bench_server: BenchServer
) -> None:
    page = open_page("/six-faces", width=390, height=844, color_scheme="dark")
    page.get_by_role("button", name="Use the practice device").click()
    other = open_page("/six-faces")
    wait_for_step(page, "+z up")
    wait_for_step(other, "+z up")
    shoot(page, "six-faces-practice-390-dark")
    assert faults_of(page) == []
    (session,) = bench_server.folder.glob("jobs/*/session")
    eventually((session / "session.toml").exists, "the first face is kept")
    first = read_session(session).stills
    other.get_by_role("button", name="Redo +z up").click()
    eventually(lambda: _stills_of(session) not in ((), first), "the face is captured again")
    again = read_session(session).stills
    assert [still.face for still in again] == ["+z"]
    assert again[0].start > first[0].start
    page.goto(bench_server.address + "turns")
    page.get_by_role("link", name="Go to six faces").wait_for()
    assert faults_of(page) == []
