"""The site as a reader meets it: on a wide and a narrow screen, light and dark, and printed to PDF; axe finds nothing serious."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from testkit.pages import PRINTED_PX, browser, seen_in

pytest.importorskip("furo")
DOCS = Path(__file__).parents[2] / "docs"
SOME = (
    "index",
    "tutorial",
    "files",
    "_generated/command-calibrate",
)  # one of each kind: links, pictures, tables, generated

_CUT_IN_PRINT = """() => [...document.querySelectorAll('article :is(table, pre, img, p, dd, li)')].filter(e => e.offsetParent &&
  (e.getBoundingClientRect().right > document.documentElement.clientWidth + 1 || e.scrollWidth > e.clientWidth + 8 &&
   getComputedStyle(e).display != 'inline')).map(e => e.tagName + ' ' + e.textContent.trim().slice(0, 29))"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site."""
    folder = tmp_path_factory.mktemp("site")
    words = ["-W", "-q", "-b", "html", "-d", str(folder / "doctrees"), str(DOCS), str(folder / "html")]
    subprocess.run([sys.executable, "-m", "sphinx", *words], check=True)
    return folder / "html"


def cut_in_print(held: Any, *pages: Path) -> list[str]:
    """Return what is wider than the printed page; 8 px are those of an indented term."""
    tab = held.new_page(viewport={"width": PRINTED_PX, "height": 1000}, color_scheme="light")
    tab.emulate_media(media="print")
    found = []
    for page in pages:
        tab.goto(page.as_uri())
        found += [f"{page.name} in print: {what}" for what in tab.evaluate(_CUT_IN_PRINT)]
    tab.close()
    return found


def test_pages_read_on_wide_and_narrow_screens_light_and_dark_and_on_paper(site: Path) -> None:
    with browser() as held:
        assert [fault for name in SOME for fault in seen_in(held, site / f"{name}.html")] == []
        pages = sorted(page for page in site.rglob("*.html") if "decisions" not in page.parts)
        assert len(pages) > 40
        assert cut_in_print(held, *pages) == []


def test_what_is_cut_is_noticed(tmp_path: Path) -> None:
    page = tmp_path / "wide.html"
    page.write_text(
        '<html lang="en"><article><pre style="overflow-x: auto">' + "word " * 60 + "</pre></article></html>"
    )
    with browser() as held:
        assert cut_in_print(held, page) == ["wide.html in print: PRE word word word word word word"]


@pytest.mark.long
def test_every_page_reads_on_wide_and_narrow_screens_light_and_dark_and_on_paper(site: Path) -> None:
    with browser() as held:
        assert [fault for page in sorted(site.rglob("*.html")) for fault in seen_in(held, page)] == []
