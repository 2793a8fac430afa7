"""What docs say is what the code says."""

import json
import re
import subprocess
from pathlib import Path

import pytest

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


@pytest.mark.parametrize("target", ["demo", "test"])
def test_the_readme_opens_with_the_two_commands_of_the_makefile(target: str) -> None:
    commands = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text(), re.S)[0].split("\n")
    assert f"make {target}" in commands
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M)


def test_make_test_says_what_it_does_and_how_long_before_it_does_anything(tmp_path: Path) -> None:
    words = ["make", "--no-print-directory", "-n", "test", f"VENV={tmp_path / 'none'}"]
    plan = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    assert re.match(r'echo "make test: about [\d,]+ tests, \d+ minutes', plan[0])
    assert not any("pip install" in line or "pytest" in line for line in plan[:2])
    suites = [k for k, line in enumerate(plan) if " -m pytest tests" in line]
    assert plan[suites[0] - 1].startswith('echo "collecting the tests')
    assert len(suites) == 1  # of what computes, what waits and the browser at once
    assert not any(" -qq" in plan[k] for k in suites)  # pytest's dots with the share that is done
