"""The site builds without warnings, loads nothing from elsewhere, and has a page or a row for each thing of the code."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import undrift
from undrift.cli.app import COMMANDS
from undrift.findings import catalogue
from undrift.sim.device.presets import SHEETS

pytest.importorskip("furo")
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site as `make docs` does."""
    folder = tmp_path_factory.mktemp("site")
    words = [
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "html",
        "-d",
        str(folder / "doctrees"),
        str(ROOT / "docs"),
        str(folder / "html"),
    ]
    done = subprocess.run([sys.executable, "-m", "sphinx", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    return folder / "html"


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


def test_each_command_option_and_finding_is_in_the_site(site: Path) -> None:
    for name in COMMANDS:
        assert f"undrift {name}" in (site / "_generated" / f"command-{name}.html").read_text(encoding="utf-8")
    assert "--table-level-deg" in (site / "_generated" / "command-calibrate.html").read_text(encoding="utf-8")
    findings = (site / "_generated" / "findings.html").read_text(encoding="utf-8")
    assert [code for code in catalogue() if f">{code}<" not in findings] == []


def test_each_exported_name_key_and_preset_is_in_the_site(site: Path) -> None:
    api = (site / "_generated" / "api.html").read_text(encoding="utf-8")
    assert [name for name in undrift.__all__ if f'id="undrift.{name}"' not in api] == []
    keys = (site / "_generated" / "keys.html").read_text(encoding="utf-8")
    for key in ("turn_rate_step_dps", "gyro_hysteresis", "mount_tilt_deg", "set_points_c", "encoder_lines"):
        assert f">{key}<" in keys
    presets = (site / "_generated" / "presets.html").read_text(encoding="utf-8")
    for name, sides in SHEETS.items():
        for figures in sides.values():
            cells = "".join(f"<td><p>{figure:.4g}</p></td>\n" for figure in figures[:-1])
            assert f"<td><p>{name}</p></td>\n{cells}" in presets


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


def test_what_scrolls_can_be_reached_by_keyboard_and_headings_have_a_level(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert "<pre>" not in text, page.name
        assert not re.search(r'<div class="table-wrapper', text), page.name
        assert not re.search(r'role="heading"(?! aria-level)', text), page.name
