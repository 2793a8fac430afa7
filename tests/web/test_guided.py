"""The guided capture on the server: begun with a device, fed without a page, written as it goes, left with the job."""

import asyncio

import pytest

from testkit.guided import HandFeed
from undrift.io.session import read_session
from undrift.web import guided as module
from undrift.web.bench import Bench, ServerSettings
from undrift.web.guided import UNSEEN_S, begin_anew, guided_of
from undrift.web.place import place_of


class Fed:
    """A connected source whose device is on a clock that is moved by hand."""

    speed = 1.0

    def __init__(self, feed, name="A17"):
        self.feed, self.name = feed, name

    def recent(self, seconds):
        return self.feed.recent(min(seconds, 30.0))


@pytest.fixture
def bench(tmp_path, monkeypatch):
    began = []
    monkeypatch.setattr(module.background_tasks, "create", lambda task, name: (task.close(), began.append(name)))
    made = Bench(ServerSettings(folder=tmp_path))
    made.began = began
    return made


@pytest.fixture
def feed():
    with HandFeed(seed=5) as made:
        made.go()
        yield made


def step(guided, feed, duration_s):
    guided._taken_s = min(guided._taken_s, feed.clock.now())
    for _ in range(round(duration_s / 0.2)):
        feed.go()
        asyncio.run(guided._step(feed.clock.now()))


def test_without_a_device_nothing_begins(bench):
    assert guided_of(bench) is None
    begin_anew(bench)
    assert bench.job is None
    assert list((bench.folder / "jobs").iterdir()) == []


def test_a_device_has_one_capture_until_another_is_connected_or_it_is_begun_anew(bench, feed):
    bench.source = Fed(feed)
    first = guided_of(bench)
    assert guided_of(bench) is first
    assert bench.began == ["guided capture"]
    assert bench.job.serial == "A17"
    bench.source = None  # a lost device: what was captured is still shown
    assert guided_of(bench) is first
    bench.source = Fed(feed, "B2")
    other = guided_of(bench)
    assert other is not first
    begin_anew(bench)
    assert guided_of(bench) is not other
    assert len(list((bench.folder / "jobs").iterdir())) == 3


def test_what_is_captured_is_written_at_once_with_the_gravity_of_the_place(bench, feed):
    bench.source = Fed(feed)
    bench.set_place(place_of("52.0", "40"))
    guided = guided_of(bench)
    step(guided, feed, 12.0)
    session = read_session(bench.job.session)
    assert [still.face for still in session.stills] == ["+z"]
    assert session.serial == "A17"
    assert session.gravity_m_s2 == pytest.approx(9.8125, abs=1e-3)
    assert guided.error == ""


@pytest.mark.slow
def test_without_a_place_no_gravity_is_written_into_the_session(bench, feed):
    bench.source = Fed(feed)
    step(guided_of(bench), feed, 12.0)
    assert "gravity" not in (bench.job.session / "session.toml").read_text()
    assert read_session(bench.job.session).gravity_source == "standard"


def test_a_folder_that_cannot_be_written_is_said_and_tried_again(bench, feed):
    bench.source = Fed(feed)
    guided = guided_of(bench)
    bench.job.session.write_text("in the way")
    step(guided, feed, 12.0)
    assert "session: cannot be written" in guided.error
    bench.job.session.unlink()
    step(guided, feed, 0.4)
    assert guided.error == ""
    assert len(read_session(bench.job.session).stills) == 1


def test_it_works_while_pages_look_and_ends_with_its_job(bench, feed, monkeypatch):
    bench.source = Fed(feed)
    guided, steps, now = guided_of(bench), [], [1000.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])

    async def taken(moment):
        steps.append(moment)

    async def later(seconds):
        now[0] += 60.0
        if now[0] > 3000.0:
            bench.job = None

    monkeypatch.setattr(guided, "_step", taken)
    monkeypatch.setattr(module.asyncio, "sleep", later)
    guided.look(guided.turns)
    assert guided.guide is guided.turns
    asyncio.run(guided.run())  # no page looks again
    assert len(steps) == UNSEEN_S / 60.0
