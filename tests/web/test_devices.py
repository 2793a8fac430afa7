"""What the page Devices asks of the registry, and what it keeps where a command refuses."""

import asyncio
from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from undrift.web.bench import Bench, ServerSettings
from undrift.web.commands import CommandOutcome
from undrift.web.devices import state_words


class Answers:
    """Stands for the commands: answers by their first words, and remembers the calls."""

    def __init__(self, **answers):
        self.answers, self.calls = answers, []

    async def __call__(self, *words, folder=None):
        self.calls.append([str(word) for word in words])
        given = self.answers[words[1] if len(words) < 3 or "=" not in str(words[2]) else f"{words[1]}_one"]
        return given if isinstance(given, CommandOutcome) else CommandOutcome(code=0, answer=given)


def row(serial, days):
    return {"serial": serial, "days_left": days, "calibration": None if days is None else {"entry": 1}, "entries": 1}


REFUSED = CommandOutcome(code=2, error="A17: wanted two calibrations to compare, got 1; add another")
ENTRY = {"entry": 3, "serial": "../A 17", "kind": "calibration"}


@pytest.fixture
def bench(tmp_path):
    made = Bench(ServerSettings(folder=tmp_path / "bench", registry="postgresql://lab@host/lab"))
    yield made
    made.close()


def test_devices_come_the_most_urgent_first_and_a_refused_trend_says_why(bench):
    rows = [row("never", None), row("late", -3), row("fresh", 300), row("soon", 5)]
    bench.command = Answers(list={"devices": rows}, list_one={"entries": [ENTRY]}, trend_one=REFUSED)
    held = bench.visit("tab").devices
    asyncio.run(held.load())
    assert [one["serial"] for one in held.rows] == ["late", "soon", "fresh", "never"]
    assert held.chosen is None
    asyncio.run(held.choose("late"))
    assert held.chosen["serial"] == "late"
    assert (held.entries, held.trend, held.picture, held.error) == ([ENTRY], {}, None, "")
    assert held.why_no_trend == REFUSED.error
    assert all(call[-2:] == ["--registry", "postgresql://lab@host/lab"] for call in bench.command.calls)


def test_a_calibration_is_used_from_a_file_in_the_folder_of_the_bench(bench):
    bench.command = Answers(show={})
    held = bench.visit("tab").devices
    asyncio.run(held.use(ENTRY))
    (call,) = bench.command.calls
    path = Path(call[call.index("-o") + 1])
    assert path.parent == bench.folder / "registry"  # whatever the serial number holds
    assert path.name.endswith("-3.json")
    assert bench.visit("tab").calibration == path
    assert held.is_used(ENTRY)
    bench.visit("tab").calibration = bench.folder / "jobs" / "calibration.json"
    assert not held.is_used(ENTRY)


def test_what_a_command_refuses_is_shown_and_nothing_is_used(bench):
    bench.command = Answers(show=REFUSED, list=REFUSED)
    asyncio.run(bench.visit("tab").devices.use(ENTRY))
    assert bench.visit("tab").calibration is None
    assert bench.visit("tab").devices.error == REFUSED.error
    asyncio.run(bench.visit("tab").devices.load())
    assert bench.visit("tab").devices.rows is None


def test_a_registry_file_that_is_not_there_yet_has_no_devices(tmp_path):
    held = Bench(ServerSettings(folder=tmp_path / "bench", registry=str(tmp_path / "new.sqlite")))
    asyncio.run(held.visit("tab").devices.load())
    assert held.visit("tab").devices.rows == []
    held.close()


@pytest.mark.parametrize(
    ("days", "words"),
    [
        (None, ("no calibration", "bad")),
        (-2, ("overdue by 2 days", "bad")),
        (3, ("due in 3 days", "marginal")),
        (90, ("valid, 90 days left", "good")),
    ],
)
def test_a_state_is_words_not_only_a_colour(days, words):
    assert state_words(row("A17", days)) == words
