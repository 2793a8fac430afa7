"""Every command answers --help; help needs nothing heavy."""

import importlib
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import is_dataclass
from inspect import signature
from pathlib import Path
from typing import get_type_hints

import pytest

from undrift.cli.app import COMMANDS, run
from undrift.commands import GROUPS, VERBS
from undrift.commands.files import Opening

ROOT = Path(__file__).parents[2]
HEAVY = {"numpy", "scipy", "pandas", "numba", "matplotlib", "pyarrow", "h5py", "ezc3d", "jinja2"}


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
        "--no-rivals",
        "--no-browser",
    }  # asked for by name; no flag has an automatic opposite
    home = importlib.import_module(f"undrift.{'commands' if name in (*VERBS, *GROUPS) else 'cli'}.{name}")
    for held in (*(getattr(home, function) for function in GROUPS.get(name, {name: name}).values()), Opening):
        together = re.findall(r"^ *(\w+(?:, \w+)+) : ", held.__doc__ or "", re.M)
        assert together == [], "options that share a paragraph lose their help"


def test_every_command_has_a_file_and_a_test_of_its_own() -> None:
    for name in COMMANDS:
        home = "commands" if name in (*VERBS, *GROUPS) else "cli"
        assert (ROOT / "src" / "undrift" / home / f"{name}.py").is_file()
        assert (ROOT / "tests" / home / f"test_{name}.py").is_file()


@pytest.mark.parametrize("words", [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)])
def test_help_imports_nothing_heavy(words: list[str]) -> None:
    code = (
        "import json, sys; from undrift.cli.app import run; "
        f"run({words!r}); print(); print(json.dumps(sorted({{name.split('.')[0] for name in sys.modules}})))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    loaded = set(json.loads(done.stdout.splitlines()[-1]))
    assert not loaded & HEAVY


# Names of what a command is about rather than settings: its files and addresses, each in the command's own words.
NAMED = {"calibration", "device", "figure", "files", "output", "record", "records", "rig", "save_device", "serial"}
SERIAL = {  # declared by three settings: of bare recordings, in place of a calibration's file, of what a file does not state
    ("files", "Place"),
    ("register", "RegistryLookup"),
    ("registry", "About"),
}


def declarations() -> Iterator[tuple[str, str, object, str]]:
    """Yield each option of a command: its name, where it is declared, its annotation, and its words there."""
    for name in (*VERBS, *GROUPS):
        module = importlib.import_module(f"undrift.commands.{name}")
        for function in (getattr(module, word) for word in GROUPS.get(name, {name: name}).values()):
            hints = get_type_hints(function, include_extras=True)
            for holder in (
                function,
                *(hints[key] for key in signature(function).parameters if is_dataclass(hints[key])),
            ):
                kinds = get_type_hints(holder, include_extras=True)
                words = {
                    key: " ".join(text.split())
                    for key, text in re.findall(r"^ +(\w+) : .*\n((?: {8}.*\n)+)", holder.__doc__ or "", re.M)
                }
                for key in kinds if is_dataclass(holder) else signature(holder).parameters:
                    if not is_dataclass(kinds[key]):
                        home = next(
                            (
                                one
                                for one in getattr(holder, "__mro__", ())[::-1]
                                if key in vars(one).get("__annotations__", {})
                            ),
                            holder,
                        )
                        yield key, f"{home.__module__}.{home.__qualname__}", kinds[key], words.get(key, "")


def test_no_setting_is_declared_twice() -> None:
    """One name in two settings, or the same words in two commands, is one declaration too many: share a dataclass or a type."""
    homes: dict[str, set[str]] = {}
    said: dict[tuple[str, str], set[str]] = {}
    for name, home, kind, words in declarations():
        if home.rpartition(".")[2][0].isupper() and not _states_its_help(kind):
            homes.setdefault(name, set()).add(home)
        if words and name not in NAMED:
            said.setdefault((name, words), set()).add(home)
    twice = {name: places for name, places in homes.items() if len(places) > 1}
    assert twice.keys() <= {"serial"}, twice
    assert twice["serial"] == {f"undrift.commands.{module}.{name}" for module, name in SERIAL}
    assert {key: places for key, places in said.items() if len(places) > 1} == {}
    print(f"  {len({name for name, *_ in declarations()})} names of options; declared by two settings: {sorted(twice)}")


def _states_its_help(kind: object) -> bool:
    """Tell whether a type is declared with its words, so that who uses it declares nothing."""
    return any(getattr(mark, "help", None) for mark in getattr(kind, "__metadata__", ()))
