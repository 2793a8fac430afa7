"""Every command answers --help; help needs nothing heavy."""

import importlib
import re
from pathlib import Path

import pytest

from undrift.cli.app import COMMANDS, run
from undrift.cli.call import FUNCTIONS
from undrift.commands.files import Opening

ROOT = Path(__file__).parents[2]


def module_of(name: str) -> str:
    """Return the module of a command. The package commands/bench is shared with record."""
    return "open_bench" if name == "bench" else name


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_answers_help_with_each_of_its_options_explained(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([name, "--help"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith(f"Usage: undrift {name}")
    assert "--json" in out
    assert set(re.findall(r"--no-\w+", out)) <= {
        "--no-browser",
    }  # asked for by name; no flag has an automatic opposite
    home = importlib.import_module(f"undrift.commands.{module_of(name)}")
    places = [place for words, place in FUNCTIONS.items() if words.split()[0] == name]
    for held in (*(getattr(home, place.partition(":")[2]) for place in places), Opening):
        together = re.findall(r"^ *(\w+(?:, \w+)+) : ", held.__doc__ or "", re.M)
        assert together == [], "options that share a paragraph lose their help"


def test_every_command_has_a_file_and_a_test_of_its_own() -> None:
    for name in COMMANDS:
        assert (ROOT / "src" / "undrift" / "commands" / f"{module_of(name)}.py").is_file()
        assert (ROOT / "tests" / "commands" / f"test_{module_of(name)}.py").is_file()
