"""A person's whole path with the pointer and one number: from the first page to a registered calibration with its certificate."""

import json
import subprocess
import sys
import time
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from testkit.bench import BenchServer, environment_of
from undrift.commands.bench.guides import ORDER, WAYS
from web_browser.conftest import CAPTURE_MS, picture, quick_and_real_time, shoot, turn_until_captured

COMMAND_MS = 90_000


class Pointer:
    """Clicks, and counts them."""

    def __init__(self, page: Page) -> None:
        self.page, self.clicks = page, 0

    def click(self, name: str, role: str = "button", wait_ms: float = CAPTURE_MS) -> None:
        self.page.get_by_role(role, name=name, exact=True).click(timeout=wait_ms)  # type: ignore[arg-type]
        self.clicks += 1


def captured(page: Page, name: str) -> None:
    """Wait until a face is captured."""
    page.get_by_role("listitem").filter(has_text=name).filter(has_text="captured").wait_for(timeout=CAPTURE_MS)


@pytest.mark.slow
@quick_and_real_time
def test_from_start_to_certificate_with_the_pointer_and_the_gravity(
    open_page: Callable[..., Page], bench_server: BenchServer
) -> None:
    page, began = open_page("/", width=1280, height=800), time.monotonic()
    hand, spans, again = Pointer(page), dict[str, float](), 0
    hand.click("Use the practice device")
    expect(page.locator(".bench-device")).to_contain_text("Device: SIM-", timeout=CAPTURE_MS)
    hand.click("Record six faces", "link")
    for number, face in enumerate(ORDER):
        if number:
            hand.click(f"{face} up")
        captured(page, f"{face} up")
    picture(page, "faces")
    spans["six faces"] = time.monotonic() - began
    hand.click("Continue to turns by hand", "link")
    for way in WAYS:
        seen = "counter-clockwise" if way[0] == "+" else "clockwise"
        if way[0] == "+":
            hand.click(f"+{way[1]} up")
        again += turn_until_captured(page, way, lambda name=f"{way[1]} {seen}": hand.click(name)) - 1
    spans["turns"] = time.monotonic() - began
    hand.click("Calibrate")
    page.wait_for_url("**/calibrate", timeout=COMMAND_MS)
    verdict = page.get_by_role("heading", name="Verdict:")
    expect(verdict).to_have_text("Verdict: marginal")
    expect(page.get_by_role("region", name="Verdict")).to_contain_text("Warning: Local gravity assumed")
    shoot(page, "result-gravity-assumed")
    page.get_by_label("Gravity, m/s2").fill("9.80665")  # of the practice device
    hand.click("Calibrate with this gravity")
    expect(verdict).to_have_text("Verdict: good", timeout=COMMAND_MS)
    spans["result"] = time.monotonic() - began
    hand.click("Register the calibration")
    page.get_by_text("Registered as entry").wait_for(timeout=COMMAND_MS)
    page.get_by_text("What the certificate states, and its limits").click()
    page.get_by_label("Laboratory").fill("Lab of room 2")
    page.get_by_label("Decision rule").select_option("guard")
    page.get_by_label("Part, by its preset").fill("mpu6050")
    shoot(page, "certificate-statement")
    hand.click("Make the certificate")
    with page.expect_download(timeout=COMMAND_MS) as download:
        hand.click("Download certificate", "link")
    spans["certificate"] = time.monotonic() - began
    assert download.value.path().read_bytes().startswith(b"%PDF")
    shoot(page, "result-with-certificate")
    picture(page, "result")
    (about,) = bench_server.folder.glob("jobs/*/.bench.json")
    certified = json.loads(about.read_text())["later"][-1]
    assert certified["statement"]["laboratory"] == "Lab of room 2"
    assert certified["conformity"]["rows"]
    print(
        f"\n{hand.clicks} clicks; seconds passed at " + ", ".join(f"{name} {span:.0f}" for name, span in spans.items())
    )
    listed = subprocess.run(
        [sys.executable, "-m", "undrift", "registry", "list", "--json"],
        env=environment_of(bench_server.folder), capture_output=True, text=True, check=True,
    )  # fmt: skip
    (device,) = json.loads(listed.stdout)["devices"]
    assert (device["state"], device["entries"], device["calibration"]["kind"]) == ("valid", 2, "calibration")
    assert hand.clicks - again == 22  # 2 to begin, 5 faces, 1, 3 layings and 6 turns, 5 to the certificate in hand
