"""Every block of README and of the users' pages runs, in the order of its page, in a folder of its own; doc_pages.py says how."""

import re
import time
from pathlib import Path

import pytest

from testkit import doc_pages as pages

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
FOR_DEVELOPERS = {"flow.md", "motions.md", "poses.md", "developers.md"}
PAGES = [ROOT / "README.md", *(page for page in sorted(DOCS.glob("*.md")) if page.name not in FOR_DEVELOPERS)]
SLOW = ("howto-developer.md", "study.md")  # studies, a minute and more


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.slow] * (page.name in SLOW)) for page in PAGES],
    ids=lambda page: page.name,
)
def test_the_blocks_of_a_page_run_and_print_what_it_shows(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = time.perf_counter()
    text = page.read_text()
    ran = pages.run_page(text, tmp_path)
    print(f"  {page.name}: {ran} blocks in {time.perf_counter() - start:.1f} s")
    assert ran == len(re.findall(r"^ *```(?:sh|python)$", text, re.M))


def test_no_block_has_another_language_or_a_comment_that_nobody_reads() -> None:
    for page in PAGES:
        text = page.read_text()
        fences = {kind for kind in re.findall(r"^```(.*)$", text, re.M) if kind}
        assert fences <= {"sh", "python", "toml", "csv", "text", "c", "{toctree}"}, page.name
        used = sum(len(block.marks) for block in pages.blocks_of(text))
        assert used == len(re.findall(r"^<!--", text, re.M)), f"{page.name}: a comment stands apart from its block"


def test_the_line_that_makes_the_data_stands_in_the_tutorial_once() -> None:
    assert (DOCS / "tutorial.md").read_text().count(pages.SAMPLE) == 1


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("```sh\nundrift info none.csv\n```", "ended with 2"),
        ("```sh\nls\n```", "unknown program"),
        ("```sh\nmake test\n```", "mark it as parsed"),
        ("```python\nprint(1)\n```\n```text\n2\n```", "prints"),
        ("```sh\nundrift sample\n```\n```text\nWrote sample, from 2 packages\n```", "not printed"),
        ("<!-- quick: no command -->\n```sh\nundrift demo\n```", "quick wants"),
    ],
)
def test_a_page_that_is_wrong_is_noticed(text: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=why):
        pages.run_page(text + "\n", tmp_path)


def test_arrays_are_calibrated_and_corrected_in_ten_lines() -> None:
    text = re.findall(r"```python\n(.*?)```", (DOCS / "python.md").read_text(), re.S)[1]
    assert len([line for line in text.splitlines() if line.strip()]) <= 10
    assert all(word in text for word in ("from_arrays", "calibrate(", "correct("))


def test_every_page_is_linked_from_the_readme_or_the_index() -> None:
    linked = (ROOT / "README.md").read_text() + (DOCS / "index.md").read_text() + (DOCS / "developers.md").read_text()
    for page in DOCS.glob("*.md"):
        assert page.stem == "index" or re.search(rf"\b{page.stem}\b", linked), f"{page.name} is linked from nowhere"


def test_every_page_of_a_contents_list_exists() -> None:
    for page in DOCS.glob("*.md"):
        for entries in re.findall(r"^```{toctree}\n(.*?)^```", page.read_text(), re.M | re.S):
            names = [line.rpartition("<")[2].rstrip(">") for line in entries.splitlines() if line and line[0] != ":"]
            missing = [name for name in names if not any(DOCS.glob(f"{name}.md")) and "_generated" not in name]
            assert missing == [], page.name
