"""No version in constraints.txt has a vulnerability of the stored, dated list (advisories.toml); nothing is fetched."""

import re
import tomllib
from datetime import date
from pathlib import Path

import pytest
from packaging.version import Version

HERE = Path(__file__).parent
STORED = tomllib.loads((HERE / "advisories.toml").read_text())


def pinned(text: str) -> dict[str, Version]:
    """Return package and version of each line of constraints."""
    rows = re.findall(r"^([\w.-]+)==([^\s;#]+)", text, re.M)
    return {re.sub(r"[-_.]+", "-", name).lower(): Version(version) for name, version in rows}


def affected(versions: dict[str, Version]) -> list[str]:
    """Return what is known of these versions."""
    found = []
    for one in STORED["advisory"]:
        version = versions.get(one["package"])
        if version is not None and Version(one.get("since", "0")) <= version < Version(one["fixed"]):
            found.append(f"{one['package']} {version}: {one['id']}, fixed in {one['fixed']}")
    return found


def test_no_version_that_is_installed_has_a_known_vulnerability():
    versions = pinned((HERE.parents[1] / "constraints.txt").read_text())
    assert len(versions) > 100
    assert affected(versions) == []


def test_no_version_that_an_install_may_take_has_a_known_vulnerability():
    """The least version of each package that pyproject.toml names."""
    text = (HERE.parents[1] / "pyproject.toml").read_text()
    least = re.findall(r'"([\w.-]+)(?:\[[\w,]+\])?>=([\d.]+)', text)
    assert len(least) > 30
    assert affected({name.lower(): Version(version) for name, version in least}) == []


def test_every_entry_of_the_list_is_of_a_package_that_is_installed_and_has_a_name():
    versions = pinned((HERE.parents[1] / "constraints.txt").read_text())
    assert isinstance(STORED["looked_at"], date)
    for one in STORED["advisory"]:
        assert one["package"] in versions
        assert re.fullmatch(r"CVE-\d{4}-\d{4,}", one["id"])
    assert len({one["id"] for one in STORED["advisory"]}) == len(STORED["advisory"])


@pytest.mark.parametrize(
    ("line", "count"),
    [("Pillow==9.5.0", 3), ("pillow==12.2.0", 0), ("starlette==0.38.0", 7), ("pyarrow==0.13.0", 0), ("h11==0.14.0", 1)],
)
def test_a_version_of_the_list_is_found(line, count):
    assert len(affected(pinned(line + "\n"))) == count
