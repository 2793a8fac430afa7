"""A person's whole path with the pointer and one number: from the first page to a calibration with its certificate."""

import time
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

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
def test_from_start_to_certificate_with_the_pointer_and_the_gravity(open_page: Callable[..., Page]) -> None:
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
    expect(page.get_by_role("region", name="Verdict")).to_contain_text("Warning: Standard gravity was assumed")
    shoot(page, "result-gravity-assumed")
    page.get_by_label("Gravity, m/s2").fill("9.80665")  # of the practice device
    hand.click("Calibrate with this gravity")
    expect(verdict).to_have_text("Verdict: good", timeout=COMMAND_MS)
    spans["result"] = time.monotonic() - began
    page.get_by_text("Certificate", exact=True).click()
    page.get_by_label("Laboratory").fill("Lab of room 2")
    shoot(page, "certificate-statement")
    hand.click("Make the certificate")
    with page.expect_popup(timeout=COMMAND_MS) as popup:
        hand.click("Open the certificate", "link")
    spans["certificate"] = time.monotonic() - began
    expect(popup.value.get_by_role("heading", level=1)).to_have_text("Calibration certificate")
    expect(popup.value.locator("body")).to_contain_text("Lab of room 2")
    shoot(popup.value, "certificate")
    shoot(page, "result-with-certificate")
    picture(page, "result")
    print(
        f"\n{hand.clicks} clicks; seconds passed at " + ", ".join(f"{name} {span:.0f}" for name, span in spans.items())
    )
    assert hand.clicks - again == 21  # 2 to begin, 5 faces, 1, 3 layings and 6 turns, 4 to the certificate
