"""Every planted fault of `make mutants` still finds its text, once."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_fault_finds_its_text_and_its_tests() -> None:
    for fault in tomllib.loads((ROOT / "tests/mutants/faults.toml").read_text())["fault"]:
        assert (ROOT / "src/undrift" / fault["file"]).read_text().count(fault["old"]) == 1, fault["name"]
        assert all((ROOT / "tests" / test.partition("::")[0]).exists() for test in fault["tests"]), fault["name"]
