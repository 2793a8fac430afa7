"""The pictures of the pages, drawn anew: those in the repository are the ones that the code draws today."""

import re
import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
NAMES = sorted(path.name for path in (DOCS / "pictures").glob("*.svg"))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory, computed_once: None) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    runpy.run_path(str(DOCS / "generate.py"))["draw_all"](folder)
    return folder


def seen(path: Path) -> list[str]:
    """Return the words of a picture; of the certificate, whose letters are outlines, their places on the lines."""
    text = path.read_text(encoding="utf-8")
    return re.findall(r"<text[^>]*>([^<]*)", text) or re.findall(r'<use [^>]*x="([^"]*)"', text)


@pytest.mark.parametrize("name", NAMES)
def test_a_picture_of_the_repository_says_what_is_drawn_today(drawn: Path, name: str) -> None:
    assert len(seen(drawn / name)) > 10
    assert seen(drawn / name) == seen(DOCS / "pictures" / name), "make docs draws it anew: commit it"


def test_no_other_picture_is_drawn(drawn: Path) -> None:
    assert sorted(path.name for path in drawn.iterdir()) == NAMES
