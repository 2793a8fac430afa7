"""What docs say is what the code says."""

import json
import re
import subprocess
from pathlib import Path

import undrift.io.store  # noqa: F401  (the map of a file is described as the store writes it)
from undrift.base.codec import schema_of
from undrift.io.store import Calibration  # with what a file map holds

ROOT = Path(__file__).parents[2]


def test_the_schema_in_docs_is_the_one_of_the_models() -> None:
    shipped = json.loads((ROOT / "docs" / "calibration.schema.json").read_text())
    assert shipped == json.loads(json.dumps(schema_of(Calibration)))


def test_every_source_file_that_docs_name_exists() -> None:
    for page in (ROOT / "docs").glob("*.md"):
        for name in re.findall(r"[\w/]+\.py\b", page.read_text()):
            places = (ROOT / "src" / "undrift" / name, ROOT / "tests" / name, ROOT / name)
            assert any(place.exists() for place in places), f"{page.name} names {name}"


def test_every_picture_that_a_page_shows_is_part_of_the_repository() -> None:
    shown = set()
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        for name in re.findall(r"!\[[^]]+\]\(([^)]+)\)", page.read_text()):
            picture = (page.parent / name).resolve()
            assert picture.is_file(), f"{page.name} shows {name}"
            assert "_generated" not in picture.parts, f"{page.name} shows {name}, which a clone does not have"
            assert picture.stat().st_size < 300_000, name
            shown.add(picture)
    assert shown >= set((ROOT / "docs" / "pictures").iterdir())
    if (ROOT / ".git").exists():
        words = ["git", "ls-files", "--error-unmatch", *map(str, sorted(shown))]
        assert subprocess.run(words, cwd=ROOT, capture_output=True, check=False).returncode == 0
