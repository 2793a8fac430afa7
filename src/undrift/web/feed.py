"""Feed: what the device sends, to any number of browsers, over the websocket ``/feed?plots=rate,accel,pitch,temp``.

A text message comes first, and again whenever the device or the lines change: the head, as JSON. The picture begins anew with it::

    {"source": "MTi-1", "rate": 200.0, "plots": [
        {"key": "rate", "title": "Turn rate", "lines": [{"name": "raw x", "unit": "deg/s"}, ...]}, ...]}

Every other message is binary, little-endian; its columns are the lines of the head, in that order::

    at  type                what
    0   4 bytes             "UDF1"
    4   uint8               kind: 0 samples, 1 envelope (least and greatest of a few samples that follow each other)
    5   uint8               0
    6   uint16              columns M
    8   uint32              number of the frame; a step over 1 is what a slow browser missed
    12  uint32              rows N
    16  float64             time of the first row, device s
    24  float32[N]          time of each row after the first, s
    ..  float32[M][N]       values, column by column; NaN is a gap. Of an envelope the least ones
    ..  float32[M][N]       of an envelope alone: the greatest ones

A browser that is slower than the device misses the oldest frames that wait for it; nobody else, and no reader, ever waits.
"""

import asyncio
import json
import math
import struct
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from fastapi import FastAPI
from nicegui.element import Element
from starlette.websockets import WebSocket, WebSocketDisconnect

from undrift.arrays import FloatArray
from undrift.commands.bench.source import LiveDevice, Update
from undrift.errors import InputError
from undrift.record import joined
from undrift.units import RADIAN_PER_DEGREE, Quantity, is_physical, si_factor

PLOTS = {"rate": "Turn rate", "accel": "Specific force", "pitch": "Pitch", "temp": "Temperature"}
PERIOD_S = 1.0 / 15.0  # between frames
HISTORY_S = 60.0  # what a new browser gets at once, device s
MOST_HZ = 250.0  # rows per second of one line; a faster device is sent as an envelope
MOST_WAITING = 30  # frames that wait for a slow browser: two seconds
MOST_BROWSERS = 64
HEADER = struct.Struct("<4sBBHIId")
MAGIC = b"UDF1"
SAMPLES, ENVELOPE = 0, 1
REFUSED, FAULT, FULL = 1008, 1011, 1013  # codes of a websocket's end

Line = tuple[str, str, str]  # plot, name, unit
_SHOWN: dict[Quantity, tuple[str, float]] = {"rate": ("deg/s", RADIAN_PER_DEGREE), "accel": ("m/s²", 1.0)}


@dataclass(slots=True, eq=False)
class _Browser:
    socket: WebSocket
    waiting: deque[bytes | str] = field(default_factory=lambda: deque(maxlen=MOST_WAITING))
    first: deque[bytes | str] = field(default_factory=deque)  # a head and what has been; never left out
    news: asyncio.Event = field(default_factory=asyncio.Event)


@dataclass(slots=True, eq=False)
class _Group:
    """Browsers that show the same plots, and what they were sent."""

    browsers: list[_Browser] = field(default_factory=list)
    head: str = ""
    lines: tuple[Line, ...] = ()
    kind: tuple[object, ...] = ()  # what the lines follow from
    source: LiveDevice | None = None
    update: int = 0  # the last one that was sent
    frames: int = 0


class Feed:
    """Hands a source's readings to browsers; all of it runs on the server's event loop."""

    def __init__(self, source: Callable[[], LiveDevice | None], allowed: Callable[[WebSocket], bool]) -> None:
        self._source, self._allowed = source, allowed
        self._groups: dict[tuple[str, ...], _Group] = {}
        self._pump: asyncio.Task[None] | None = None

    def add_to(self, app: FastAPI) -> None:
        """Serve ``/feed`` in an application."""
        app.add_api_websocket_route("/feed", self.serve)

    @property
    def browsers(self) -> int:
        """How many are connected."""
        return sum(len(group.browsers) for group in self._groups.values())

    async def serve(self, socket: WebSocket) -> None:
        """Serve one browser until it leaves."""
        plots = tuple(socket.query_params.get("plots", ",".join(PLOTS)).split(","))
        if not self._allowed(socket) or not set(plots) <= PLOTS.keys() or len(set(plots)) < len(plots):
            await socket.close(REFUSED)
            return
        if self.browsers >= MOST_BROWSERS:
            await socket.close(FULL)
            return
        await socket.accept()
        browser, group = _Browser(socket), self._groups.setdefault(plots, _Group())
        self._tick(plots, group)
        self._begin(group, [browser], plots)
        group.browsers.append(browser)
        if self._pump is None or self._pump.done():
            self._pump = asyncio.create_task(self._run())
        sender = asyncio.create_task(_send(browser))
        try:
            while (await socket.receive())["type"] != "websocket.disconnect":
                pass
        except (WebSocketDisconnect, RuntimeError):  # the second: it left while it was being received from
            pass
        finally:
            group.browsers.remove(browser)
            sender.cancel()
            with suppress(asyncio.CancelledError):
                await sender

    async def _run(self) -> None:
        """Send what is new, until nobody looks; after a fault browsers are let go of, and connect anew by themselves."""
        try:
            while self.browsers:
                await asyncio.sleep(PERIOD_S)
                for plots, group in self._groups.items():
                    if group.browsers:
                        self._tick(plots, group)
        finally:
            for browser in [each for group in self._groups.values() for each in group.browsers]:
                with suppress(WebSocketDisconnect, RuntimeError):  # it left meanwhile
                    await browser.socket.close(FAULT)

    def _tick(self, plots: tuple[str, ...], group: _Group) -> None:
        source = self._source()
        other = source is not group.source
        if other:
            group.source, group.update = source, 0
        updates = [] if source is None else source.updates(group.update)
        kind = _kind(updates[-1]) if updates else () if other else group.kind
        if updates:
            group.update = updates[-1].number
        if other or kind != group.kind or not group.head:
            group.kind, group.lines = kind, _lines(updates[-1], plots) if updates else ()
            group.head = _head(source, group.lines, plots)
            self._begin(group, group.browsers, plots)
        elif updates and group.browsers:
            group.frames += 1
            frame = _frame(group.frames, updates, group.lines, plots, _bucket(source))
            for browser in group.browsers:
                browser.waiting.append(frame)
                browser.news.set()

    def _begin(self, group: _Group, browsers: Sequence[_Browser], plots: tuple[str, ...]) -> None:
        """Send some browsers the head and what has been."""
        held = [] if group.source is None else [one for one in group.source.updates() if one.number <= group.update]
        held = [one for one in held if one.raw.time[-1] > held[-1].raw.time[-1] - HISTORY_S]
        messages: list[bytes | str] = [group.head]
        if held and browsers:
            messages.append(_frame(group.frames, held, group.lines, plots, _bucket(group.source)))
        for browser in browsers:
            browser.waiting.clear()
            browser.first = deque(messages)
            browser.news.set()


async def _send(browser: _Browser) -> None:
    """Send a browser what waits for it, at its own pace."""
    with suppress(WebSocketDisconnect, RuntimeError, OSError):
        while True:
            while browser.first or browser.waiting:
                message = (browser.first or browser.waiting).popleft()
                send: Any = browser.socket.send_text if isinstance(message, str) else browser.socket.send_bytes
                await send(message)
            browser.news.clear()
            await browser.news.wait()


def _head(source: LiveDevice | None, lines: tuple[Line, ...], plots: tuple[str, ...]) -> str:
    held: dict[str, Any] = {"source": None, "rate": 0.0} if source is None else {}
    if source is not None:
        held = {"source": source.name, "rate": source.nominal_rate_hz}
    of = {key: [{"name": name, "unit": unit} for plot, name, unit in lines if plot == key] for key in plots}
    shown = [{"key": key, "title": PLOTS[key], "lines": each} for key, each in of.items()]
    return json.dumps(held | {"plots": shown})


def _bucket(source: LiveDevice | None) -> int:
    """Return how many samples become one row: 1, or so many that least and greatest together stay below the most."""
    rate = 0.0 if source is None else source.nominal_rate_hz
    return 1 if rate <= MOST_HZ else math.ceil(2.0 * rate / MOST_HZ)


def _parts(update: Update, plot: str) -> list[tuple[str, str, FloatArray]]:
    """Return name, unit and values (N,) of the lines of a plot."""
    if plot == "pitch":
        return [] if update.pitch is None else [("pitch", "deg", update.pitch / RADIAN_PER_DEGREE)]
    if plot == "temp":
        return [] if update.raw.temp_c is None else [("sensor", "°C", update.raw.temp_c)]
    found = []
    quantity: Quantity = "rate" if plot == "rate" else "accel"
    for kind, record in (("raw", update.raw), ("corrected", update.corrected)):
        if record is None:
            continue
        values, unit = (record.gyro, record.gyro_unit) if plot == "rate" else (record.accel, record.accel_unit)
        if values is None:
            continue
        if is_physical(unit):
            shown, factor = _SHOWN[quantity]
            values, unit = values * (si_factor(unit, quantity) / factor), shown
        found += [(f"{kind} {axis}", unit, values[:, k]) for k, axis in enumerate("xyz")]
    return found


def _kind(update: Update) -> tuple[object, ...]:
    """Return what the lines of an update follow from."""
    raw = update.raw
    there = [part is None for part in (raw.gyro, raw.accel, raw.temp_c, update.corrected, update.pitch)]
    return raw.gyro_unit, raw.accel_unit, *there


def _lines(update: Update, plots: tuple[str, ...]) -> tuple[Line, ...]:
    return tuple((plot, name, unit) for plot in plots for name, unit, _ in _parts(update, plot))


def _frame(
    number: int, updates: Sequence[Update], lines: tuple[Line, ...], plots: tuple[str, ...], bucket: int
) -> bytes:
    """Return updates as one frame with the columns of the head."""
    rows = []
    for _, alike in groupby(updates, key=lambda one: (one.corrected is None, one.pitch is None)):
        held = _whole(list(alike))
        parts = {(plot, name): values for plot in plots for name, _, values in _parts(held, plot)}
        gap = np.full(len(held.raw), np.nan)
        rows.append(np.column_stack([held.raw.time, *(parts.get((plot, name), gap) for plot, name, _ in lines)]))
    table = np.vstack(rows)
    return encoded(number, table[:, 0], table[:, 1:], bucket)


def _whole(updates: list[Update]) -> Update:
    """Return updates of one kind that follow each other as one."""
    last = updates[-1]
    if len(updates) == 1:
        return last
    corrected = [one.corrected for one in updates if one.corrected is not None]
    pitch = [one.pitch for one in updates if one.pitch is not None]
    joint = joined(corrected) if corrected else None, np.concatenate(pitch) if pitch else None
    raw = joined([one.raw for one in updates])
    return Update(number=last.number, raw=raw, corrected=joint[0], q_nb=None, pitch=joint[1])


def encoded(number: int, time: FloatArray, values: FloatArray, bucket: int = 1) -> bytes:
    """Return rows as a frame: time (N,) s, values (N, M)."""
    kind, blocks = SAMPLES, [values]
    if bucket > 1:
        kind, starts = ENVELOPE, np.arange(0, len(time), bucket)
        blocks = [np.fmin.reduceat(values, starts, axis=0), np.fmax.reduceat(values, starts, axis=0)]
        time = time[starts]
    head = HEADER.pack(MAGIC, kind, 0, values.shape[1], number, len(time), time[0])
    body = [(time - time[0]), *(block.T for block in blocks)]
    return head + b"".join(np.ascontiguousarray(part, dtype="<f4").tobytes() for part in body)


def trace_frame(path: Path, start: float, stop: float, rows: int) -> bytes:
    """Return a stretch of a trace that ``info`` wrote, s since its first sample, as a frame of at most so many rows; ValueError."""
    table = np.load(path, mmap_mode="r")
    time = np.asarray(table["time"]) - table["time"][0]
    low, high = time.searchsorted((start, stop))
    part, time = table[max(low - 1, 0) : high + 1], time[max(low - 1, 0) : high + 1]
    bucket = max(1, math.ceil(len(part) / max(rows, 2)))
    q_nb = np.repeat(part["q_nb"][::bucket], bucket, axis=0)[: len(part)]  # an orientation has no least one
    return encoded(0, time, np.hstack((part["gyro"], part["accel"], q_nb)), bucket)


# ---- panel: the feed drawn by uPlot in the browser, beside NiceGUI's own socket

STATIC = Path(__file__).parent / "static"
SPANS_S = (10, 30, 60)


class Panel(Element, component="static/panel.js"):
    """Plots of what the bench's device sends, or of a recording (trace) with its stretches; one that is chosen is an event."""

    def __init__(self, plots: Sequence[str] = tuple(PLOTS), *, span_s: int = SPANS_S[0], trace: Any = None) -> None:
        unknown = [plot for plot in plots if plot not in PLOTS]
        if unknown or not plots or len(set(plots)) < len(plots) or span_s not in SPANS_S:
            raise InputError(
                f"panel: wanted plots out of {', '.join(PLOTS)}, each once, over {', '.join(map(str, SPANS_S))} s, got "
                f"'{','.join(plots)}' over {span_s} s; name others"
            )
        super().__init__()
        self._props["plots"] = list(plots)
        self._props["span"] = span_s
        self._props["spans"], self._props["trace"] = list(SPANS_S), trace
        self.add_resource(STATIC)
