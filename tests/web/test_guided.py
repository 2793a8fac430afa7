"""The guided recording on the server: begun with a device, written as it goes, left when another is begun."""

import asyncio

import pytest

from testkit.guided import HandFeed
from undrift.commands.files import Place
from undrift.io.session import read_session
from undrift.web import guided as module
from undrift.web.bench import Bench, ServerSettings


class Fed:
    """A connected source whose device is on a clock that is moved by hand."""

    speed = 1.0

    def __init__(self, feed, name="A17"):
        self.feed, self.name = feed, name

    error = ""

    def stop(self):
        pass

    def recent(self, seconds):
        return self.feed.recent(min(seconds, 30.0))


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.setattr(module.background_tasks, "create", lambda task, name: task.close())
    return Bench(ServerSettings(folder=tmp_path))


@pytest.fixture
def feed():
    with HandFeed(seed=5) as made:
        made.go()
        yield made


def begun(bench, feed):
    bench.source = Fed(feed)
    bench.begin()
    return bench.guided


def step(guided, feed, duration_s):
    guided._taken_s = min(guided._taken_s, feed.clock.now())
    for _ in range(round(duration_s / 0.2)):
        feed.go()
        asyncio.run(guided.step(feed.clock.now()))


def test_without_a_device_nothing_begins(bench):
    bench.begin()
    assert (bench.guided, bench.items) == (None, [])


def test_each_recording_has_a_folder_of_its_own_and_the_next_bench_lists_those_with_captures(bench, feed, tmp_path):
    first = begun(bench, feed)
    step(first, feed, 12.0)
    bench.begin()
    assert bench.guided is not first
    assert len(bench.items) == 2
    (kept,) = Bench(ServerSettings(folder=tmp_path)).items
    assert (kept.kind, kept.serial, kept.summary) == ("session", "A17", "1 faces and 0 turns")


def test_what_is_captured_is_written_at_once_with_the_gravity_of_the_place(bench, feed):
    bench.set_place(Place(latitude_deg=52.0, height_m=40.0))
    guided = begun(bench, feed)
    step(guided, feed, 12.0)
    session = read_session(guided.item.path)
    assert [still.face for still in session.stills] == ["+z"]
    assert session.serial == "A17"
    assert session.gravity_m_s2 == pytest.approx(9.8125, abs=1e-3)
    assert guided.error == ""


def test_a_folder_that_cannot_be_written_is_said_and_tried_again(bench, feed):
    guided = begun(bench, feed)
    guided.item.path.write_text("in the way")
    step(guided, feed, 12.0)
    assert "session: cannot be written" in guided.error
    guided.item.path.unlink()
    step(guided, feed, 0.4)
    assert guided.error == ""
    assert len(read_session(guided.item.path).stills) == 1
