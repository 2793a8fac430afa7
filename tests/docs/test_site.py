"""The site builds without warnings, loads nothing from elsewhere, has a row for each thing of the code, and reads in a browser."""

import re
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import Any

import pytest

import undrift
from testkit.pages import PRINTED_PX, SCHEMES, WIDTHS, browser, seen_in
from testkit.remembered import folder_made_once, run_folder
from undrift.cli.app import COMMANDS
from undrift.sim.device.presets import SHEETS

pytest.importorskip("furo")
ROOT = Path(__file__).parents[2]

_CUT_IN_PRINT = """() => [...document.querySelectorAll('article :is(table, pre, img, p, dd, li)')].filter(e => e.offsetParent &&
  (e.getBoundingClientRect().right > document.documentElement.clientWidth + 1 || e.scrollWidth > e.clientWidth + 8 &&
   getComputedStyle(e).display != 'inline')).map(e => e.tagName + ' ' + e.textContent.trim().slice(0, 29))"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site as `make docs` does, once in a run."""

    def build(folder: Path) -> None:
        words = ["-W", "--keep-going", "-q", "-b", "html", "-d", folder / "doctrees", ROOT / "docs", folder / "html"]
        done = subprocess.run([sys.executable, "-m", "sphinx", *words], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-4000:]

    return folder_made_once(run_folder(tmp_path_factory), "site", build) / "html"


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    loads = re.compile(
        r"""<(?:script|img|iframe|source|embed|object|video|audio)\b[^>]*\b(?:src|data|srcset)=["'](?:https?:)?//"""
        r"""|<link\b(?![^>]*rel=["'](?:canonical|license)["'])[^>]*href=["'](?:https?:)?//"""
    )
    style = re.compile(r"""(?:@import|url\()\s*["']?(?:https?:)?//""")
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not loads.search(text), f"{page.name}: {loads.search(text)}"
        assert not style.search(text), page.name
    for sheet in site.rglob("*.css"):
        assert not style.search(sheet.read_text(encoding="utf-8")), sheet.name
    for picture in site.rglob("*.svg"):
        outside = re.findall(r"""(?:xlink:)?href=["'](?!#|data:)[^"']*""", picture.read_text(encoding="utf-8"))
        assert outside == [], picture.name


def pages_of(site: Path, name: str) -> str:
    """Return a reference that is a page a section."""
    return "".join(path.read_text(encoding="utf-8") for path in sorted((site / "_generated").glob(f"{name}*.html")))


@pytest.mark.slow
def test_each_command_and_option_is_in_the_site(site: Path) -> None:
    for name in COMMANDS:
        assert f"undrift {name}" in (site / "_generated" / f"command-{name}.html").read_text(encoding="utf-8")
    assert "--turn-deg" in (site / "_generated" / "command-calibrate.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_each_exported_name_key_and_preset_is_in_the_site(site: Path) -> None:
    api = pages_of(site, "api")
    assert [name for name in undrift.__all__ if f'id="undrift.{name}"' not in api] == []
    keys = pages_of(site, "keys")
    for key in ("turn_rate_step_dps", "gyro_hysteresis", "mount_tilt_deg", "set_points_c", "encoder_lines"):
        assert re.search(f"[>.]{key}<", keys), key
    presets = (site / "_generated" / "presets.html").read_text(encoding="utf-8")
    for name, sides in SHEETS.items():
        for figures in sides.values():
            cells = "".join(f"<td><p>{figure:.4g}</p></td>\n" for figure in figures[:-1])
            assert f"<td><p>{name}</p></td>\n{cells}" in presets


@pytest.mark.slow
def test_every_link_of_the_site_leads_somewhere(site: Path) -> None:
    anchors = {
        page: set(re.findall(r'\bid="([^"]+)"', page.read_text(encoding="utf-8"))) for page in site.rglob("*.html")
    }
    wrong = []
    for page in anchors:
        for target in re.findall(r'<a\b[^>]*href="([^"]+)"', page.read_text(encoding="utf-8")):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = target.partition("#")
            place = (page.parent / path).resolve() if path else page
            if not place.exists() or (anchor and place in anchors and anchor not in anchors[place]):
                wrong.append(f"{page.relative_to(site)}: {target}")
    assert not wrong, "\n".join(sorted(set(wrong))[:20])


@pytest.mark.slow
def test_what_scrolls_can_be_reached_by_keyboard_and_headings_have_a_level(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert "<pre>" not in text, page.name
        assert not re.search(r'<div class="table-wrapper', text), page.name
        assert not re.search(r'role="heading"(?! aria-level)', text), page.name


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


@pytest.mark.slow
def test_every_page_reads_on_wide_and_narrow_screens_light_and_dark_and_on_paper(site: Path, playwright: Any) -> None:
    with browser(playwright) as held:
        pages = sorted(site.rglob("*.html"))
        assert len(pages) > 40
        assert [fault for page in pages for fault in seen_in(held, page, judged=tuple(product(WIDTHS, SCHEMES)))] == []
        assert cut_in_print(held, *(page for page in pages if "decisions" not in page.parts)) == []
