"""From a device's bytes to two browsers, step by step on the device's clock: processor time and memory, by no wall clock."""

import asyncio
import binascii
import gc
import struct
import time
import tracemalloc

import numpy as np
import pytest

import undrift
from testkit.data import show
from undrift.commands.bench.source import LiveDevice
from undrift.live.decoder import Chunk, decoder_for
from undrift.web import feed as feeds
from undrift.web.feed import Feed

RATE, PER_READ, PER_FRAME = 200, 4, 13  # readings a second, that come together, and in a frame: fifteen frames a second
CHANNELS = "count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,temp"
ADDRESS = f"tcp://127.0.0.1:9?format=frame&pack=<I7f&checksum=crc16&rate={RATE}&channels={CHANNELS}"


class Reader:
    """A browser that takes all it is sent, and leaves when it is let."""

    def __init__(self) -> None:
        self.query_params = {"plots": "rate,accel,pitch,temp"}
        self.frames = self.bytes = 0
        self.left = asyncio.Event()

    async def accept(self) -> None: ...

    async def send_text(self, data: str) -> None: ...

    async def receive(self) -> dict[str, str]:
        await self.left.wait()
        return {"type": "websocket.disconnect"}

    async def send_bytes(self, data: bytes) -> None:
        self.frames, self.bytes = self.frames + 1, self.bytes + len(data)


class Way:
    """A source that is fed by hand, and a feed with two browsers."""

    def __init__(self) -> None:
        rng = np.random.default_rng(7)
        device = undrift.random_device(rng)
        record = undrift.simulate_trial("sit_to_stand", device, rng=rng).record
        self.rows = np.column_stack((record.gyro, record.accel, np.full(len(record), 25.0))).tolist()
        self.source = LiveDevice(f"{ADDRESS}&gyro_unit={record.gyro_unit}&accel_unit={record.accel_unit}")
        self.source.set_calibration(undrift.calibrate(undrift.simulate_session("bench", device, rng=rng)))
        self.description = self.source.recorder.source.description
        self.decoder = decoder_for(self.description)
        self.feed = Feed(lambda: self.source, lambda socket: True)
        self.readers = [Reader(), Reader()]
        self.count = 0

    def bytes(self, count: int) -> list[bytes]:
        """Return what the device will send, in pieces as they come."""
        made = []
        for k in range(self.count, self.count + count):
            body = struct.pack("<I7f", k, *self.rows[k % len(self.rows)])
            made.append(b"\xaa\x55" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF)))
        return [b"".join(made[k : k + PER_READ]) for k in range(0, count, PER_READ)]

    async def run(self, seconds: float) -> float:
        """Take some seconds of readings, and return the processor time of it, s."""
        pieces, recorder, due = self.bytes(round(seconds * RATE)), self.source.recorder, 0
        start = time.process_time()
        for piece in pieces:
            rows = self.decoder.feed(piece)
            self.count += len(rows)
            due += len(rows)
            counter, values = self.description.split(rows)
            came = Chunk(host_time=np.full(len(rows), self.count / RATE), counter=counter, values=values)
            with recorder._news:
                recorder._keep(recorder.timeline.add(came))
            if due >= PER_FRAME:
                due -= PER_FRAME
                self.source._take()
                for plots, group in self.feed._groups.items():
                    self.feed._tick(plots, group)
                for _ in range(3):
                    await asyncio.sleep(0)
        return time.process_time() - start

    async def play(self, *spans: float) -> list[float]:
        """Take stretches of readings with two browsers connected."""
        await self.run(3.0)  # compile what is compiled
        tasks = [asyncio.create_task(self.feed.serve(one)) for one in self.readers]
        await asyncio.sleep(0)
        used = [await self.run(span) for span in spans]
        for one in self.readers:
            one.left.set()
        await asyncio.gather(*tasks)
        return used


@pytest.fixture(autouse=True)
def steps_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feeds, "PERIOD_S", 1e6)


@pytest.mark.slow
def test_two_hundred_hertz_to_two_browsers_take_little_of_a_core() -> None:
    way = Way()
    (used,) = asyncio.run(way.play(10.0))
    share = 100.0 * used / 10.0
    show("processor time of 200 Hz x 6 channels, raw and corrected, to two browsers, % of a core", share, 10.0)
    assert way.source.status().correction == ""
    assert way.readers[0].frames == way.readers[1].frames > 10 * 15
    assert way.readers[0].bytes > 10 * RATE * 15 * 4  # time and fourteen lines, four bytes each
    assert share < 10.0


@pytest.mark.slow
def test_memory_does_not_grow_once_what_is_kept_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (
        ("commands.bench.source.KEEP_S", 4.0),
        ("commands.bench.source.RATE_OVER_S", 0.0),
        ("live.clock.KEPT_DELAYS", 50),
    ):
        monkeypatch.setattr(f"undrift.{name}", value)
    way = Way()
    object.__setattr__(way.source.recorder.timeline._clock._settings, "memory_s", 4.0)

    async def play() -> tuple[int, int]:
        await way.run(8.0)
        tasks = [asyncio.create_task(way.feed.serve(one)) for one in way.readers]
        await asyncio.sleep(0)
        await way.run(3.0)
        held = []
        for _ in range(2):
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
            await way.run(10.0)
        for one in way.readers:
            one.left.set()
        await asyncio.gather(*tasks)
        return held[0], held[1]

    tracemalloc.start()
    try:
        before, after = asyncio.run(play())
    finally:
        tracemalloc.stop()
    show("growth of memory over 10 s, kB", (after - before) / 1e3, 100.0)  # 10 s kept for ever would be 225 kB and more
    assert after - before < 100e3
