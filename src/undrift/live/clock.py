"""The device's clock on the host's: ``host = offset + rate * device + delay`` with a delay that is never negative.

Packets come late, never early: the clock is the line below all points (device, host) that lies closest to them on the whole,
min sum(host - offset - rate device). Its solution is the edge of their lower convex hull that spans the mean device time [1]_, and
the hull is kept up at a few operations a packet. Old points are forgotten, since a clock drifts with temperature. A backlog that
drains shows a clock that is too late, until the first prompt packet: the clock is settled when several packets in turn, over a
while, did not come earlier than those before allow. A constant delay cannot be seen from one side.

.. [1] S. B. Moon, P. Skelly and D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999.
"""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.live.decoder import Arrivals, Chunk, Counter, StreamDescription

Point = tuple[float, float]
KEPT_DELAYS = 2000
SETTLED_PACKETS = 8  # in turn, none of which shows that all before it were late
SETTLED_S = 0.2  # for so long, host s
DRAINING = 0.1  # a stream this much faster than nominal is a backlog, not a clock in error


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockSettings:
    """How the clock is found."""

    memory_s: float = 300.0  # Device time after which a point may be forgotten, s; at most twice as much is used
    # Largest relative error of a device's clock; holds the line before there is much to go by
    rate_tolerance: float = 0.02

    def __post_init__(self) -> None:
        if not (self.memory_s > 0.0 and 0.0 < self.rate_tolerance < 1.0):
            raise InputError(
                f"clock: wanted a memory above 0 s and a tolerance between 0 and 1, got {self.memory_s:g} and "
                f"{self.rate_tolerance:g}; 300 and 0.02 are usual"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockLine:
    """A line between two clocks."""

    device_zero: float  # A point on it, s and s
    host_zero: float
    rate: float  # Host seconds per device second
    rate_error: float  # Relative departure of the device's clock from nominal: positive for one that runs fast
    # 95 of 100 packets come at most so much later than the promptest, host s; those of a backlog left out
    jitter_s: float
    settled: bool  # False while a backlog drains, and while too few packets have come to tell
    count: int  # Packets that it rests on

    def host_time(self, device_time: float) -> float:
        """Return the host's time of a device time, as the promptest packet would come."""
        return self.host_zero + self.rate * (device_time - self.device_zero)

    def device_time(self, host_time: float) -> float:
        """Return the device time of a host time."""
        return self.device_zero + (host_time - self.host_zero) / self.rate


class _Block:
    """Points of one stretch of time: their lower hull, their number and the sum of their device times."""

    def __init__(self, start: float) -> None:
        self.start, self.count, self.total = start, 0, 0.0
        self.hull: list[Point] = []

    def add(self, point: Point) -> None:
        self.count += 1
        self.total += point[0]
        _extend(self.hull, point)


class DeviceClock:
    """Follows a device's clock, packet by packet."""

    def __init__(self, clock_speed: float = 1.0, settings: ClockSettings = ClockSettings()) -> None:
        self._nominal = 1.0 / clock_speed
        self._settings = settings
        self._blocks: deque[_Block] = deque(maxlen=2)
        self._recent: deque[Point] = deque(maxlen=KEPT_DELAYS)
        self._zero: Point | None = None
        self._prompt: Point = (0.0, np.inf)  # shows that all packets before it were late; those are forgotten

    def add(self, device_time: FloatArray, host_time: FloatArray) -> None:
        """Take readings; of those that came at one moment only the last can have been prompt.
        device_time (N,) s, host_time (N,) s."""
        last = np.flatnonzero(np.diff(host_time, append=np.inf) > 0.0)
        for point in zip(device_time[last].tolist(), host_time[last].tolist(), strict=True):
            if self._zero is None:
                self._zero = point
            moved: Point = (point[0] - self._zero[0], point[1] - self._zero[1])  # small numbers, to keep their digits
            earliest = self._prompt[1] + (1.0 - DRAINING) * self._nominal * (moved[0] - self._prompt[0])
            if moved[1] < earliest:
                self._prompt = moved
                self._recent.clear()
                self._blocks.clear()
            if not self._blocks or moved[0] - self._blocks[-1].start > self._settings.memory_s:
                self._blocks.append(_Block(moved[0]))
            self._blocks[-1].add(moved)
            self._recent.append(moved)

    def fit(self) -> ClockLine:
        """Return the line as it is known by now."""
        if self._zero is None:
            raise InputError("clock: wanted one packet or more, got none; wait for the device")
        hull: list[Point] = []
        for block in self._blocks:
            for point in block.hull:
                _extend(hull, point)
        count = sum(block.count for block in self._blocks)
        mean = sum(block.total for block in self._blocks) / count
        low, high = (self._nominal * (1.0 + sign * self._settings.rate_tolerance) for sign in (-1.0, 1.0))
        slope = min(max(_slope_at(hull, mean, self._nominal), low), high)
        offset = min(y - slope * x for x, y in hull)
        x, y = np.array(self._recent).T
        return ClockLine(
            device_zero=self._zero[0],
            host_zero=self._zero[1] + offset,
            rate=slope,
            rate_error=self._nominal / slope - 1.0,
            jitter_s=float(np.quantile(y - offset - slope * x, 0.95)),
            settled=len(y) > SETTLED_PACKETS and bool(y[-1] - self._prompt[1] >= SETTLED_S),
            count=count,
        )


def _extend(hull: list[Point], point: Point) -> None:
    """Add a point to the right of a lower convex hull."""
    if hull and point[0] <= hull[-1][0]:
        if point[1] >= hull[-1][1]:
            return
        hull.pop()
    while len(hull) >= 2:
        (x0, y0), (x1, y1) = hull[-2], hull[-1]
        if (y1 - y0) * (point[0] - x0) < (point[1] - y0) * (x1 - x0):
            break
        hull.pop()
    hull.append(point)


def _slope_at(hull: list[Point], x: float, nominal: float) -> float:
    """Return the slope of the hull's edge above x."""
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x <= x1:
            return (y1 - y0) / (x1 - x0)
    return nominal


# ---- Readings in order, gaps marked.


class GapMarker:
    """Counts what is missing and marks it with rows of NaN, chunk by chunk; a gap beyond a stated span by one row only."""

    def __init__(self, period_s: float, longest_fill_s: float = 1.0) -> None:
        self._period = period_s
        self._longest = longest_fill_s
        self._last: float | None = None
        self.gaps = 0
        self.missing = 0

    def mark(self, time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return readings with rows of NaN where some are missing: time (N,) s, values (N, C) -> (M,) s, (M, C)."""
        if not len(time):
            return time, values
        before = np.concatenate(([time[0] - self._period if self._last is None else self._last], time[:-1]))
        self._last = float(time[-1])
        lacking = np.maximum(np.rint((time - before) / self._period).astype(int) - 1, 0)
        if not lacking.any():
            return time, values
        self.gaps += int((lacking > 0).sum())
        self.missing += int(lacking.sum())
        rows = np.where(lacking * self._period > self._longest, 1, lacking)
        at = np.repeat(np.arange(len(time)), rows)
        step = np.where(rows < lacking, self._period, (time - before) / (lacking + 1))
        nth = np.arange(len(at)) - np.repeat(np.cumsum(rows) - rows, rows) + 1
        return np.insert(time, at, before[at] + nth * step[at]), np.insert(values, at, np.nan, axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Readings on the device's clock."""

    time: FloatArray  # (N,), device time, s, strictly increasing, 0 at the first reading
    values: FloatArray  # (N, C), raw, NaN where a reading is missing


class Timeline:
    """Puts the readings of one connection on the device's own clock, gaps marked, the host's clock beside it."""

    def __init__(self, description: StreamDescription, clock: ClockSettings = ClockSettings()) -> None:
        speed = description.clock_speed
        self.readings = 0
        self.counter = Counter(description.counter_bits, description.tick_s, speed)
        self.marker = GapMarker(1.0 / description.rate)
        self._tick_s = description.tick_s
        self._arrivals = Arrivals(description.rate, speed)
        self._clock = DeviceClock(speed, clock)

    def add(self, chunk: Chunk) -> Block:
        """Take a chunk."""
        if chunk.counter is None:
            count, kept = self._arrivals.count(chunk.host_time), np.ones(len(chunk), dtype=bool)
        else:
            count, kept = self.counter.unwrap(chunk.counter, chunk.host_time)
        time = count[kept] * self._tick_s
        self.readings += len(time)
        self._clock.add(time, chunk.host_time[kept])
        return Block(*self.marker.mark(time, chunk.values[kept]))

    def clock(self) -> ClockLine:
        """Return how the device's clock stands to the host's."""
        return self._clock.fit()
