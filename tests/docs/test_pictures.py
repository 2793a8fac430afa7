"""The pictures of the pages, drawn anew: those in the repository are the ones that the code draws today."""

import re
import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
NAMES = sorted(path.name for path in (DOCS / "pictures").glob("*.svg"))


def seen(path: Path) -> list[str]:
    """Return the words of a picture; of the certificate, whose letters are outlines, their places on the lines."""
    text = path.read_text(encoding="utf-8")
    return re.findall(r"<text[^>]*>([^<]*)", text) or re.findall(r'<use [^>]*x="([^"]*)"', text)


@pytest.mark.slow
@pytest.mark.usefixtures("computed_once")
def test_pictures_of_the_repository_say_what_is_drawn_today(tmp_path: Path) -> None:
    runpy.run_path(str(DOCS / "generate.py"))["draw_all"](tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == NAMES
    for name in NAMES:
        assert len(seen(tmp_path / name)) > 10, name
        assert seen(tmp_path / name) == seen(DOCS / "pictures" / name), f"{name}: make docs draws it anew: commit it"
