"""Feed: frames say what the device sent, by the test's own decoder; nobody waits for a slow browser; strangers are refused."""

import asyncio
import json
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from testkit.web_server import listening
from undrift.commands.bench.source import Update
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE
from undrift.web.feed import HISTORY_S, MOST_BROWSERS, MOST_WAITING, Feed, encoded, trace_frame


def decoded(data: bytes) -> dict[str, Any]:
    """Take a frame apart as the head of feed.py describes it, byte by byte."""
    assert data[:4] == b"UDF1"
    kind, zero = data[4], data[5]
    columns = int.from_bytes(data[6:8], "little")
    number, rows = int.from_bytes(data[8:12], "little"), int.from_bytes(data[12:16], "little")
    (start,) = struct.unpack_from("<d", data, 16)
    floats = [struct.unpack_from("<f", data, at)[0] for at in range(24, len(data), 4)]
    assert zero == 0
    assert len(floats) == rows * (1 + columns * (1 + kind))
    blocks = [floats[first : first + rows] for first in range(0, len(floats), rows)]
    time, least, most = blocks[0], blocks[1 : 1 + columns], blocks[1 + columns :]
    return {"kind": kind, "number": number, "time": [start + t for t in time], "least": least, "most": most}


class Talk:
    """A source whose readings the test makes."""

    name, nominal_rate_hz = "talk", 100.0

    def __init__(self, corrected: bool = True, unit: str = "rad/s") -> None:
        self.held: list[Update] = []
        self.corrected, self.unit = corrected, unit

    def say(self, count: int = 10) -> None:
        first = self.held[-1].raw.time[-1] + 0.01 if self.held else 5.0
        k = np.arange(count, dtype=float)
        gyro = np.column_stack((k, k + 0.5, -k))
        raw = Record(time=first + 0.01 * k, gyro=gyro, accel=-gyro, gyro_unit=self.unit, temp_c=30.0 + k)
        corrected = Record(time=raw.time, gyro=2.0 * gyro, accel=gyro, state="corrected") if self.corrected else None
        pitch = np.full(count, 0.1) if self.corrected else None
        self.held.append(Update(number=len(self.held) + 1, raw=raw, corrected=corrected, q_nb=None, pitch=pitch))

    def updates(self, after: int = 0) -> list[Update]:
        return self.held[after:]


@contextmanager
def browser_of(source: Callable[[], Talk | None], plots: str, allowed: bool = True) -> Iterator[ClientConnection]:
    """A client of another library, over a real socket."""
    app, feed = FastAPI(), Feed(source, lambda socket: allowed)
    feed.add_to(app)
    with listening(app) as port, connect(f"ws://127.0.0.1:{port}/feed{plots}") as browser:
        yield browser


def text(browser: ClientConnection) -> Any:
    return json.loads(browser.recv(timeout=60, decode=True))


def frame(browser: ClientConnection) -> dict[str, Any]:
    return decoded(browser.recv(timeout=60))


def test_samples_and_envelopes_are_laid_out_as_the_head_of_the_file_says():
    time, values = 3.0 + np.arange(7) * 0.25, np.arange(14.0).reshape(7, 2)
    values[2, 1] = values[6, 0] = np.nan
    plain = decoded(encoded(9, time, values))
    assert (plain["kind"], plain["number"], plain["most"]) == (0, 9, [])
    assert plain["time"] == time.tolist()
    np.testing.assert_array_equal(np.array(plain["least"]).T, values)
    envelope = decoded(encoded(2**32 - 1, time, values, 3))
    assert (envelope["kind"], envelope["number"]) == (1, 2**32 - 1)
    assert envelope["time"] == [3.0, 3.75, 4.5]
    np.testing.assert_array_equal(envelope["least"], [[0.0, 6.0, np.nan], [1.0, 7.0, 13.0]])
    np.testing.assert_array_equal(envelope["most"], [[4.0, 10.0, np.nan], [3.0, 11.0, 13.0]])


def test_a_browser_gets_the_head_what_has_been_and_what_comes_in_the_units_shown():
    source = Talk()
    for _ in range(3):
        source.say()
    with browser_of(lambda: source, "?plots=rate,pitch,temp") as browser:
        head = text(browser)
        assert (head["source"], head["rate"]) == ("talk", 100.0)
        assert [plot["key"] for plot in head["plots"]] == ["rate", "pitch", "temp"]
        lines = [(line["name"], line["unit"]) for plot in head["plots"] for line in plot["lines"]]
        names = [f"{kind} {axis}" for kind in ("raw", "corrected") for axis in "xyz"]
        assert lines == [*((name, "deg/s") for name in names), ("pitch", "deg"), ("sensor", "°C")]
        been = frame(browser)
        np.testing.assert_allclose(been["time"], 5.0 + 0.01 * np.arange(30), atol=1e-6)
        raw, corrected = np.array(been["least"][:3]).T, np.array(been["least"][3:6]).T
        gyro = np.vstack([one.raw.gyro for one in source.held])
        np.testing.assert_allclose(raw * RADIAN_PER_DEGREE, gyro, rtol=1e-6)
        np.testing.assert_allclose(corrected, 2.0 * raw, rtol=1e-6)
        np.testing.assert_allclose(been["least"][6], 0.1 / RADIAN_PER_DEGREE, rtol=1e-6)
        source.say(4)
        new = frame(browser)
        assert new["number"] == been["number"] + 1
        np.testing.assert_allclose(new["time"], 5.3 + 0.01 * np.arange(4), atol=1e-6)
        assert new["least"][7] == [30.0, 31.0, 32.0, 33.0]


def test_counts_stay_counts_and_a_calibration_begins_a_new_picture_with_gaps_before_it():
    source = Talk(corrected=False, unit="count")
    source.say()
    with browser_of(lambda: source, "?plots=rate") as browser:
        (plot,) = text(browser)["plots"]
        assert [line["unit"] for line in plot["lines"]] == ["count"] * 3
        assert len(frame(browser)["least"]) == 3
        source.corrected = True
        source.say()
        (plot,) = text(browser)["plots"]
        assert [line["unit"] for line in plot["lines"]] == ["count"] * 3 + ["deg/s"] * 3
        been = np.array(frame(browser)["least"])
        assert np.isnan(been[3:, :10]).all()
        assert np.isfinite(been[:3]).all()
        assert np.isfinite(been[:, 10:]).all()


def test_a_fast_device_is_sent_as_an_envelope_and_a_minute_is_the_most_that_has_been():
    source = Talk()
    source.nominal_rate_hz = 1000.0
    for _ in range(16):
        source.say(1000)  # 160 s of its clock
    with browser_of(lambda: source, "?plots=rate") as browser:
        text(browser)
        been = frame(browser)
        assert been["kind"] == 1
        assert HISTORY_S - 0.1 <= been["time"][-1] - been["time"][0] <= HISTORY_S + 10.0
        assert np.all(np.array(been["least"][0]) <= np.array(been["most"][0]))
        assert np.diff(been["time"]) == pytest.approx(8 * 0.01, abs=1e-5)  # eight samples a row: 250 rows a second both


def test_no_device_is_a_head_without_lines_and_another_device_begins_anew():
    held: list[Talk | None] = [None]
    with browser_of(lambda: held[0], "?plots=temp") as browser:
        head = text(browser)
        assert head == {
            "source": None,
            "rate": 0.0,
            "plots": [{"key": "temp", "title": "Temperature", "lines": []}],
        }
        for _ in range(2):  # the second is the same device again: its clock begins anew
            other = Talk()
            other.say()
            held[0] = other
            assert text(browser)["source"] == "talk"
            assert frame(browser)["time"][0] == 5.0


def test_after_a_fault_browsers_are_let_go_of_and_the_next_gets_the_picture():
    talk, faults = Talk(), [False]

    def source() -> Talk:
        if faults[0]:
            raise ValueError("a fault of the bench")
        return talk

    app, feed = FastAPI(), Feed(source, lambda socket: True)
    feed.add_to(app)
    with listening(app) as port:
        address = f"ws://127.0.0.1:{port}/feed?plots=temp"
        with connect(address) as one, connect(address) as two:
            assert [text(browser)["source"] for browser in (one, two)] == ["talk", "talk"]
            faults[0] = True
            for browser in (one, two):
                with pytest.raises(ConnectionClosed) as closed:
                    browser.recv(timeout=60)
                assert closed.value.rcvd is not None
                assert closed.value.rcvd.code == 1011
        faults[0] = False
        with connect(address) as browser:
            assert text(browser)["source"] == "talk"
            talk.say()
            assert text(browser)["plots"][0]["lines"]
            assert frame(browser)["time"][0] == 5.0


@pytest.mark.parametrize("plots", ["?plots=rate,secrets", "?plots=", "?plots=rate,rate"])
def test_plots_that_there_are_not_are_refused(plots: str):
    with pytest.raises(InvalidStatus, match="403"), browser_of(Talk, plots):
        pass


def test_who_is_not_allowed_gets_nothing():
    with pytest.raises(InvalidStatus, match="403"), browser_of(Talk, "?plots=rate", allowed=False):
        pass


class Socket:
    """A browser that reads when the test lets it."""

    def __init__(self, plots: str) -> None:
        self.query_params = {"plots": plots}
        self.got: list[bytes | str] = []
        self.reads, self.left = asyncio.Event(), asyncio.Event()
        self.code = 0

    async def accept(self) -> None:
        pass

    async def close(self, code: int) -> None:
        self.code = code

    async def receive(self) -> dict[str, str]:
        await self.left.wait()
        return {"type": "websocket.disconnect"}

    async def send_bytes(self, data: bytes) -> None:
        await self.reads.wait()
        self.got.append(data)

    async def send_text(self, data: str) -> None:
        await self.reads.wait()
        self.got.append(data)


async def until(condition: Any) -> None:
    for _ in range(3000):
        if condition():
            return
        await asyncio.sleep(0.01)
    pytest.fail("never")


def test_a_browser_that_does_not_read_holds_nobody_up_and_misses_the_oldest_frames():
    async def play() -> None:
        source, feed = Talk(), None
        feed = Feed(lambda: source, lambda socket: True)
        source.say()
        slow, quick = Socket("rate"), Socket("rate")
        quick.reads.set()
        tasks = [asyncio.create_task(feed.serve(one)) for one in (slow, quick)]
        await until(lambda: len(quick.got) == 2)
        for said in range(MOST_WAITING + 20):
            source.say()
            await until(lambda said=said: len(quick.got) == 3 + said)
        assert slow.got == []
        assert [decoded(one)["number"] for one in quick.got[1:]] == list(range(MOST_WAITING + 21))
        slow.reads.set()
        await until(lambda: len(slow.got) == 2 + MOST_WAITING)
        assert slow.got[:2] == quick.got[:2], "the head and what had been are never left out"
        assert slow.got[2:] == quick.got[-MOST_WAITING:]
        for one in (slow, quick):
            one.left.set()
        await asyncio.gather(*tasks)
        assert feed.browsers == 0

    asyncio.run(play())


def test_no_more_browsers_than_the_most():
    async def play() -> None:
        feed = Feed(lambda: None, lambda socket: True)
        sockets = [Socket("temp") for _ in range(MOST_BROWSERS)]
        tasks = [asyncio.create_task(feed.serve(one)) for one in sockets]
        await until(lambda: feed.browsers == MOST_BROWSERS)
        late = Socket("temp")
        await feed.serve(late)
        assert late.code == 1013
        for one in sockets:
            one.left.set()
        await asyncio.gather(*tasks)

    asyncio.run(play())


def test_a_trace_is_sent_by_as_many_rows_as_are_asked_for_least_and_greatest_of_each(tmp_path) -> None:
    table = np.zeros(1000, dtype=[("time", "f8"), ("gyro", "f4", 3), ("accel", "f4", 3), ("q_nb", "f4", 4)])
    table["time"] = 1.7e9 + np.arange(1000) / 100.0
    table["gyro"][:, 1], table["accel"][500, 2] = np.sin(np.arange(1000)), 9.0
    table["accel"][:, 0], table["q_nb"][:, 0] = np.nan, np.arange(1000)
    np.save(tmp_path / "trace.npy", table)
    whole = decoded(trace_frame(tmp_path / "trace.npy", 0.0, 99.0, 100))
    assert (whole["kind"], len(whole["time"]), whole["time"][0]) == (1, 100, 0.0)
    assert (whole["least"][5][50], whole["most"][5][50], max(whole["most"][5][:50])) == (0.0, 9.0, 0.0)
    for k in range(100):
        lines = np.sin(np.arange(10 * k, 10 * k + 10)).astype("f4")
        assert (whole["least"][1][k], whole["most"][1][k]) == (lines.min(), lines.max())
    assert whole["least"][6] == whole["most"][6] == [10.0 * k for k in range(100)]  # orientations that there were
    assert np.isnan(whole["least"][3]).all()
    part = decoded(trace_frame(tmp_path / "trace.npy", 5.0, 5.2, 100))
    assert part["kind"] == 0  # every reading
    np.testing.assert_allclose(part["time"], np.arange(4.99, 5.205, 0.01), atol=1e-5)
