"""The guided recording with the practice device, a reload and a kill in the middle, to a calibration and its certificate."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from testkit.bench import BenchServer, bench_process
from testkit.guided import accel_as_six_faces_see_it, joint_factor
from undrift.io.store import read_calibration
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from web_browser.conftest import COMMAND_MS, Person, faults_of, picture, report, shoot

SEED = 2007  # of the practice device, as bench_process states it
LONGEST_S = 300.0
MOVE = "Move the practice device as asked"


def record_all(person: Person, folder: Path) -> None:
    """Move the practice device as the page asks, until all faces and turns are recorded."""
    page, began = person.page, time.monotonic()
    done = page.get_by_text("All faces and turns are recorded", exact=True)
    while not done.is_visible():
        assert time.monotonic() - began < LONGEST_S, page.locator(".light-words").inner_text()
        page.get_by_role("button", name=MOVE).click()
        page.wait_for_timeout(500.0)


@pytest.mark.slow
def test_from_six_faces_to_a_certificate_with_a_reload_and_a_kill(
    open_page: Callable[..., Page], bench_server: BenchServer
) -> None:
    page = open_page()
    person, faults = Person(page), list[str]()
    person.click("Use the practice device")
    expect(page.get_by_text("Faces: 1 of 6")).to_be_visible(timeout=COMMAND_MS)
    picture(page, "faces")
    faults += faults_of(page)
    page.reload()
    expect(page.get_by_text("Faces: 1 of 6")).to_be_visible()
    record_all(person, bench_server.folder)
    shoot(page, "practice-recorded-1280")
    faults += faults_of(page)
    person.click("Continue to the calibration")
    person.click("Calibrate")
    expect(report(page).locator(".verdict h2")).to_have_text("Verdict: marginal", timeout=COMMAND_MS)
    expect(report(page).locator(".verdict li").first).to_contain_text("tandard gravity")
    page.get_by_role("button", name="Place").click()
    page.get_by_label("Or gravity, m/s2").fill("9.80665")  # of the practice device
    person.click("Calibrate")
    expect(page.get_by_text("Place: gravity 9.806", exact=False)).to_be_visible(timeout=COMMAND_MS)
    expect(report(page).locator(".verdict h2")).to_have_text("Verdict: good", timeout=COMMAND_MS)
    picture(page, "result")
    faults += faults_of(page)
    page.get_by_role("button", name="Certificate").click()
    page.get_by_label("Laboratory").fill("Lab of room 2")
    person.click("Make the certificate")
    with page.expect_popup(timeout=COMMAND_MS) as popup:
        person.click("Open the certificate", "link")
    expect(popup.value.locator("body")).to_contain_text("Lab of room 2")
    (path,) = bench_server.folder.glob("jobs/*/calibration.json")
    check_against_truth(path)
    assert (faults, person.complaints) == ([], [])
    os.kill(bench_server.process.pid or 0, signal.SIGKILL)
    bench_server.process.join()
    with bench_process(bench_server.folder) as again:
        page.goto(again.address)
        expect(report(page).locator(".verdict h2")).to_have_text("Verdict: good", timeout=COMMAND_MS)
        shoot(page, "practice-after-a-kill-1280")


def check_against_truth(path: Path) -> None:
    """Compare a calibration with the hidden parameters of the practice device."""
    made, device = read_calibration(path), random_device(np.random.default_rng(SEED), grade="consumer")
    assert made.device == device.serial
    matrix, offset = accel_as_six_faces_see_it(device)
    truth = true_calibration(device, temp_c=made.reference_temp_c).gyro
    for model, true_matrix, true_offset in ((made.accel, matrix, offset), (made.gyro, truth.matrix, truth.offset)):
        error = np.concatenate(((model.matrix - true_matrix).ravel(), model.offset - true_offset))
        assert (np.abs(error) / np.sqrt(np.diag(model.covariance)[:12])).max() < joint_factor(12)


@pytest.mark.slow
def test_a_second_browser_watches_and_a_narrow_one_records_a_face_again(
    open_page: Callable[..., Page], bench_server: BenchServer
) -> None:
    page, other = open_page(width=390, height=844, color_scheme="dark"), open_page()
    page.get_by_role("button", name="Use the practice device").click()
    for each in (page, other):
        expect(each.get_by_text("Faces: 1 of 6")).to_be_visible(timeout=COMMAND_MS)
    shoot(page, "practice-390-dark")
    assert faults_of(page) == []
    (session,) = bench_server.folder.glob("jobs/*/session/session.toml")
    first = session.read_text()
    other.get_by_role("button", name="+z up: recorded").click()
    expect(page.get_by_role("button", name="+z up: record it again")).to_be_visible()
    expect(page.get_by_role("button", name="+z up: recorded")).to_be_visible(timeout=COMMAND_MS)
    assert session.read_text() != first
