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
from playwright.sync_api import BrowserContext, FrameLocator, Page, expect

from testkit.bench import BenchServer, bench_process

CHROMIUM = shutil.which("chromium")
SCREENS = os.environ.get("UNDRIFT_SCREENS")  # a folder for pictures of the pages; `make test-browser` names one
PICTURES = os.environ.get("UNDRIFT_PICTURES")  # a folder for those of the manual; `make pictures` names docs/pictures
WAIT_MS, COMMAND_MS = 20_000, 90_000
expect.set_options(timeout=WAIT_MS)  # a page beside a busy machine answers late
# sizes and schemes of a page; the gate has one of them
wide_and_narrow = pytest.mark.parametrize(
    ("width", "height", "scheme"), [(1280, 800, "light"), pytest.param(390, 844, "dark", marks=pytest.mark.slow)]
)
# what a page must not have whatever its readings are: parts beyond the screen, parts that only a pointer scrolls, small buttons
_MEASURED = """() => {
  const all = kind => [...document.querySelectorAll('main ' + kind)], page = document.documentElement
  const scrolls = e => ['auto', 'scroll'].includes(getComputedStyle(e).overflowX)
  return {
    'px beyond the screen': Math.max(0, page.scrollWidth - page.clientWidth),
    'parts that the keyboard cannot scroll': all('*').filter(e => scrolls(e) && e.tabIndex < 0).length,
    'small buttons': all('button').filter(e => e.offsetParent && e.offsetHeight < 44).length,
  }
}"""


@pytest.fixture
def bench_server(tmp_path: Path) -> Iterator[BenchServer]:
    """Serve a bench that writes to a folder of its own, with the same practice device each time, six times as fast."""
    with bench_process(tmp_path / "bench", speed=6.0) as server:
        yield server


@pytest.fixture(scope="session")
def browser_type_launch_args(browser_type_launch_args: dict[str, Any]) -> dict[str, Any]:
    """Return how the browser is started: Debian's chromium, where pytest-playwright would look for one of its own."""
    if CHROMIUM is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    return {**browser_type_launch_args, "executable_path": CHROMIUM, "args": ["--no-sandbox", "--disable-gpu"]}


@pytest.fixture
def open_page(bench_server: BenchServer, new_context: Callable[..., BrowserContext]) -> Callable[..., Page]:
    """Return what opens the page in a browser of its own, and waits until it answers."""

    def make(*, width: int = 1280, height: int = 800, **options: Any) -> Page:
        still = {"reduced_motion": "reduce"} | options
        page = new_context(viewport={"width": width, "height": height}, **still).new_page()
        page.set_default_timeout(WAIT_MS)
        page.goto(bench_server.address)
        page.wait_for_function("window.socket && window.socket.connected")
        return page

    return make


class Person:
    """A person with a pointer, whose clicks are counted, and what the browser complains of."""

    def __init__(self, page: Page) -> None:
        self.page, self.clicks, self.complaints = page, 0, list[str]()
        page.on("console", lambda line: self.complaints.append(line.text) if line.type == "error" else None)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def click(self, name: str, role: str = "button") -> None:
        self.page.get_by_role(role, name=name, exact=True).click(timeout=COMMAND_MS)  # type: ignore[arg-type]
        self.clicks += 1

    def drop(self, path: Path) -> None:
        """Choose a file, which takes two clicks."""
        self.page.locator("input[type=file]").set_input_files(path)
        self.clicks += 2


def report(page: Page) -> FrameLocator:
    return page.frame_locator("iframe")


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
