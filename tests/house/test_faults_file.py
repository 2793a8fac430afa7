"""Every planted fault of `make mutants` still finds its text, once."""

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FAULTS = tomllib.loads((ROOT / "tests/mutants/faults.toml").read_text())["fault"]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault["name"])
def test_a_fault_finds_its_text_and_its_tests(fault: dict) -> None:
    assert (ROOT / "src/undrift" / fault["file"]).read_text().count(fault["old"]) == 1
    assert all((ROOT / "tests" / test.partition("::")[0]).exists() for test in fault["tests"])
