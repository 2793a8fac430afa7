"""The bench as a person meets it: ``undrift bench`` in a process of its own, pages in Debian's chromium."""

import os
import shutil
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image, ImageOps
from playwright.sync_api import BrowserContext, Page, expect

from testkit.bench import BenchServer, bench_process
from undrift.commands.bench.guides import GAP, named

CHROMIUM = shutil.which("chromium")
SCREENS = os.environ.get("UNDRIFT_SCREENS")  # a folder for pictures of the pages; `make test-browser` names one
PICTURES = os.environ.get("UNDRIFT_PICTURES")  # a folder for those of the manual; `make pictures` names docs/pictures
WAIT_MS = 20_000
expect.set_options(timeout=WAIT_MS)  # a page beside a busy machine answers late
CAPTURE_MS = 40_000  # a face takes 12 s: a move of 2, a window, settling and a countdown of 6
# rests and turns of guided captures, six times as fast; `make test-long` has them in real time
quick_and_real_time = pytest.mark.parametrize("practice_speed", [6.0, pytest.param(1.0, marks=pytest.mark.slow)])
# sizes and schemes of a page; the gate has one of them
wide_and_narrow = pytest.mark.parametrize(
    ("width", "height", "scheme"), [(1280, 800, "light"), pytest.param(390, 844, "dark", marks=pytest.mark.slow)]
)
# what a page must not have whatever its readings are: parts beyond the screen, parts that only a pointer scrolls, small buttons
_MEASURED = """() => {
  const all = kind => [...document.querySelectorAll('.bench-main ' + kind)], page = document.documentElement
  const scrolls = e => ['auto', 'scroll'].includes(getComputedStyle(e).overflowX)
  return {
    'px beyond the screen': Math.max(0, page.scrollWidth - page.clientWidth),
    'parts that the keyboard cannot scroll': all('*').filter(e => scrolls(e) && e.tabIndex < 0).length,
    'small buttons': all('button').filter(e => e.offsetParent && e.offsetHeight < 44).length,
  }
}"""


@pytest.fixture
def practice_speed() -> float:
    """How much faster than real time the practice device is; a test states another as its parameter."""
    return 1.0


@pytest.fixture
def bench_server(tmp_path: Path, practice_speed: float) -> Iterator[BenchServer]:
    """Serve a bench that writes to a folder of its own, with the same practice device each time."""
    words = ("--practice-seed", "2007", "--practice-speed", str(practice_speed))
    with bench_process(tmp_path / "bench", *words) as server:
        yield server


@pytest.fixture(scope="session")
def browser_type_launch_args(browser_type_launch_args: dict[str, Any]) -> dict[str, Any]:
    """Return how the browser is started: Debian's chromium, where pytest-playwright would look for one of its own."""
    if CHROMIUM is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    return {**browser_type_launch_args, "executable_path": CHROMIUM, "args": ["--no-sandbox", "--disable-gpu"]}


@pytest.fixture
def open_page(bench_server: BenchServer, new_context: Callable[..., BrowserContext]) -> Callable[..., Page]:
    """Return what opens a page of the bench by its path, in a browser of its own, and waits until it answers."""

    def make(path: str = "/", *, width: int = 1200, height: int = 900, **options: Any) -> Page:
        still = {"reduced_motion": "reduce"} | options
        page = new_context(viewport={"width": width, "height": height}, **still).new_page()
        page.set_default_timeout(WAIT_MS)
        page.goto(bench_server.address + path.lstrip("/"))
        page.wait_for_function("window.socket && window.socket.connected")
        return page

    return make


def step(page: Page, name: str) -> None:
    """Go to a step of the device by its rail."""
    page.get_by_role("navigation", name="Stages").get_by_role("link", name=name).click()
    page.get_by_role("heading", level=1, name=name).wait_for()


def state_serial(page: Page, serial: str = "A17") -> None:
    """State the serial number, which is required."""
    page.get_by_label("Serial number", exact=False).first.fill(serial)


def shoot(page: Page, name: str) -> None:
    """Keep a screenshot of the whole page, where they are wanted."""
    if SCREENS:
        page.screenshot(path=Path(SCREENS) / f"{name}.png", full_page=True)


def picture(page: Page, name: str, top: int = 66) -> None:
    """Keep what a wide screen shows of a page, from a height on, as a picture of docs/bench.md, where they are wanted."""
    if PICTURES and page.viewport_size == {"width": 1280, "height": 800}:
        page.evaluate("scrollTo(0, 0)")
        whole = Image.open(BytesIO(page.screenshot(full_page=True))).crop((180, top, 1100, top + 720))
        ImageOps.expand(whole, 2, "#9aa0a8").quantize(64, dither=Image.Dither.NONE).save(
            Path(PICTURES) / f"bench-{name}.png", optimize=True
        )


def faults_of(page: Page) -> list[str]:
    """Return what is wrong with a page: serious faults of accessibility, and what is measured of it."""
    options = {
        "resultTypes": ["violations"],
        "preload": False,
    }  # a style sheet asked for again would be seen as loading
    violations = Axe().run(page, options=options).response["violations"]
    found = [one for one in violations if one["impact"] in ("serious", "critical")]
    return [f"{one['id']}: {one['nodes'][0]['html'][:200]}" for one in found] + measured_faults_of(page)


def measured_faults_of(page: Page) -> list[str]:
    """Return what is measured of a page that should not be."""
    return [f"{number} {what}" for what, number in page.evaluate(_MEASURED).items() if number]


def turn_until_captured(page: Page, way: str, turn: Callable[[], object]) -> int:
    """Turn once, and again as the guide asks where the machine was too busy to keep each reading; return how often."""
    captured = page.get_by_role("listitem").filter(has_text=named(way).capitalize()).filter(has_text="captured")
    asked_again = page.locator(".light-words").filter(has_text=GAP)
    for turned in range(1, 6):
        page.locator(".light-words").filter(has_text="Turn it once").wait_for(timeout=CAPTURE_MS)
        refused = asked_again.is_visible()
        turn()
        if refused:  # the words about the turn before
            asked_again.wait_for(state="hidden", timeout=CAPTURE_MS)
        captured.or_(asked_again).first.wait_for(timeout=CAPTURE_MS)
        if captured.is_visible():
            return turned
    raise AssertionError(f"no turn {named(way)} was captured: {page.locator('.light-words').inner_text()}")
