"""Which words in back-ticks become options: parameters of the running command, and nothing that came from outside."""

import ast
import re
from pathlib import Path

import pytest

import undrift
from undrift.base.spoken import CALLED, NAMED, option_of, showing, spoken
from undrift.cli.app import COMMANDS
from undrift.cli.call import app
from undrift.findings import finding


@pytest.fixture
def calibrating():
    """The command line runs calibrate, as far as texts are concerned."""
    tokens = CALLED.set(("calibrate",)), NAMED.set(frozenset({"gravity_m_s2", "max_lag_s", "column_map"}))
    yield
    CALLED.reset(tokens[0])
    NAMED.reset(tokens[1])


def test_python_has_the_names_of_its_arguments():
    text = "widen `longest_lag_s`, or give `gravity_m_s2`"
    assert spoken(text) == text


def test_parameters_of_the_running_command_are_options_and_no_other_word_is(calibrating):
    text = (
        "widen `longest_lag_s`, map `old`.csv with `column_map`, or give `gravity_m_s2`; `offset` is of another command"
    )
    assert spoken(text) == (
        "widen --max-lag-s, map `old`.csv with --map, or give --gravity-m-s2; `offset` is of another command"
    )


def test_a_finding_names_options_where_it_is_shown_and_arguments_as_data(calibrating):
    found = finding("orient.field", "warn", "It is not calibrated.", "Calibrate with `magnetometer`.")
    assert "`magnetometer`" in found.text
    with showing():
        assert "--magnetometer" in found.text
        assert "`" not in found.text
    assert "`magnetometer`" in found.text


def test_findings_name_options_that_a_command_has():
    commands = app()
    options = {
        option
        for name in COMMANDS.keys() - {"rig", "study"}
        for argument in commands[name].assemble_argument_collection()
        for option in argument.names
    }
    calls = [
        ast.unparse(node)
        for path in Path(undrift.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("finding", "above")
    ]
    named = {name for call in calls for name in re.findall(r"`(\w+)`", call)}
    assert named
    assert {option_of(name) for name in named} <= options
