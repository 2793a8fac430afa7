"""Words that no lab uses stand nowhere that a person reads: messages, help, pages, docs, docstrings, comments."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# STYLE L: what a biomechanist or a firmware engineer would read twice, and the field's word for it.
INSTEAD = {
    r"foretell\w*|foretold": "predict; cross-validated error",
    r"feign\w*": "g-sensitivity; apparent",
    r"\btold\b": "stated, shown, estimated",
    r"\bsaid\b": "reported, stated",
    r"dies away|die away": "transient",
    r"gone on with|goes on with|go on with": "resumed",
    r"held against|hold against|holds against": "checked against, compared with",
    r"\bkinder\b": "better",
    r"\bwander(s|ed|ing)?\b": "drift, random walk",
    r"\btrails?\b|\btrailed\b|\btrailing\b(?! edge| zero| blank| comma| newline| slash| space)": "lags",
    r"half the loop": "hysteresis half-width",
    r"\bis of\b|\bare of\b": "say it with a verb",
    r"square up|true the box": "align the fixture",
    r"taken for nothing": "assumed zero",
    r"cannot rule out": "cannot exclude",
}
EVERY = re.compile("|".join(f"(?:{pattern})" for pattern in INSTEAD), re.I)


def better(word: str) -> str:
    """Return the field's word for a found one."""
    return next(instead for pattern, instead in INSTEAD.items() if re.search(pattern, word, re.I))


READ_BY_PEOPLE = [
    *sorted((ROOT / "src" / "undrift").rglob("*.py")),
    *sorted((ROOT / "src" / "undrift").rglob("*.toml")),
    *sorted((ROOT / "src" / "undrift").rglob("*.j2")),
    *sorted((ROOT / "src" / "undrift").rglob("*.html")),
    *sorted((ROOT / "docs").glob("*.md")),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
]


@pytest.mark.parametrize("path", READ_BY_PEOPLE, ids=lambda p: str(p.relative_to(ROOT)))
def test_the_words_are_the_fields(path: Path) -> None:
    found = [
        f"{path.name}:{number}: '{match.group(0)}' -> {better(match.group(0))}"
        for number, line in enumerate(path.read_text().splitlines(), 1)
        for match in EVERY.finditer(line)
        if not line.endswith("# binding key")  # of files that other programs read
    ]
    assert not found, "\n".join(found)
