"""Fit of the device's clock to the host's while packets arrive: ``host = offset + rate * device + delay``, delay >= 0.

The line is below all packets of the last minutes, as for files (io/clock.py), and is evaluated at their middle. The lower hull is
updated with a few operations per packet. Old points are removed, because a clock drifts with temperature. While a backlog drains,
the line is too late until the first prompt packet arrives. The clock is settled when, for some time, several successive packets
arrive no earlier than the line from the previous packets allows.
"""

import itertools
from collections import deque
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.io.clock import Point, extend_hull, slope_at
from undrift.live.decoder import Arrivals, Chunk, Counter, StreamDescription

MEMORY_S = 300.0  # shortest memory of a point, device s (the longest is twice that)
RATE_TOLERANCE = 0.02  # largest relative error of a device's clock, which limits the slope if there are few points
KEPT_DELAYS = 2000
SETTLED_PACKETS = 8  # number of successive packets, without an earlier one, until the clock is settled
SETTLED_S = 0.2  # shortest duration of these packets, host s
DRAINING = 0.1  # relative excess of the rate from which a stream counts as a backlog


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockLine:
    """A line that relates two clocks."""

    device_zero: float  # device time of a point on the line, s
    host_zero: float  # host time of that point, s
    rate: float  # host seconds per device second
    # 95 % quantile of the delay relative to the promptest packet, without a backlog, host s
    jitter_s: float
    settled: bool  # False while a backlog drains, or with too few packets

    def host_time(self, device_time: float) -> float:
        """Return the host time at which the promptest packet of a device time would arrive."""
        return self.host_zero + self.rate * (device_time - self.device_zero)

    def device_time(self, host_time: float) -> float:
        """Return the device time of a host time."""
        return self.device_zero + (host_time - self.host_zero) / self.rate


class DeviceClock:
    """Fit of a device's clock, updated with each packet."""

    def __init__(self, clock_speed: float = 1.0, memory_s: float = MEMORY_S) -> None:
        self._nominal, self._memory_s = 1.0 / clock_speed, memory_s
        self._hulls: deque[list[Point]] = deque(maxlen=2)  # lower hulls of the packets of `memory_s` each
        self._recent: deque[Point] = deque(maxlen=KEPT_DELAYS)
        self._zero: Point | None = None
        self._prompt: Point = (0.0, np.inf)  # earliest packet (earlier points are removed, because they were late)

    def add(self, device_time: float, host_time: float) -> None:
        """Add the last reading of a packet. The others were late."""
        self._zero = self._zero or (device_time, host_time)
        x, y = device_time - self._zero[0], host_time - self._zero[1]  # small numbers keep their digits
        if y < self._prompt[1] + (1.0 - DRAINING) * self._nominal * (x - self._prompt[0]):
            self._prompt = x, y
            self._recent.clear()
            self._hulls.clear()
        if not self._hulls or x - self._hulls[-1][0][0] > self._memory_s:
            self._hulls.append([])
        extend_hull(self._hulls[-1], (x, y))
        self._recent.append((x, y))

    def fit(self) -> ClockLine:
        """Return the line fitted to all packets so far."""
        if self._zero is None:
            raise InputError("clock: no packet has arrived. Wait for the device.")
        hull: list[Point] = []
        for point in itertools.chain(*self._hulls):
            extend_hull(hull, point)
        low, high = self._nominal * (1.0 - RATE_TOLERANCE), self._nominal * (1.0 + RATE_TOLERANCE)
        slope = min(max(slope_at(hull, 0.5 * (hull[0][0] + hull[-1][0]), self._nominal), low), high)
        offset = min(y - slope * x for x, y in hull)
        x, y = np.array(self._recent).T
        return ClockLine(
            device_zero=self._zero[0],
            host_zero=self._zero[1] + offset,
            rate=slope,
            jitter_s=float(np.quantile(y - offset - slope * x, 0.95)),
            settled=len(y) > SETTLED_PACKETS and bool(y[-1] - self._prompt[1] >= SETTLED_S),
        )


# ---- Readings in order, with gaps marked.


class GapMarker:
    """Marker of missing readings, which counts them and inserts rows of NaN. A gap longer than a limit gets only one row."""

    def __init__(self, period_s: float, longest_fill_s: float = 1.0) -> None:
        self._period = period_s
        self._longest = longest_fill_s
        self._last: float | None = None
        self.missing = 0

    def mark(self, time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the readings with rows of NaN in the gaps. Shapes are time (N,), s, and values (N, C) -> (M,), (M, C)."""
        if not len(time):
            return time, values
        before = np.concatenate(([time[0] - self._period if self._last is None else self._last], time[:-1]))
        self._last = float(time[-1])
        lacking = np.maximum(np.rint((time - before) / self._period).astype(int) - 1, 0)
        if not lacking.any():
            return time, values
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
    values: FloatArray  # (N, C), raw, NaN for missing readings


class Timeline:
    """Converter of chunks to device time, with gaps marked and a fit of the device's clock to the host's."""

    def __init__(self, description: StreamDescription) -> None:
        self.readings = 0
        self.marker = GapMarker(1.0 / description.rate)
        self._tick_s = description.tick_s
        self._counter = Counter(description.counter_bits, description.tick_s, description.clock_speed)
        self._arrivals = Arrivals(description.rate, description.clock_speed)
        self._clock = DeviceClock(description.clock_speed)

    def add(self, chunk: Chunk) -> Block:
        """Add a chunk and return its readings on the device's clock."""
        if chunk.counter is None:
            count = self._arrivals.count(len(chunk), chunk.host_time)
        else:
            count = self._counter.unwrap(chunk.counter, chunk.host_time)
        valid = np.isfinite(count)
        time = count[valid] * self._tick_s
        self.readings += len(time)
        if len(time):
            self._clock.add(float(time[-1]), chunk.host_time)
        return Block(*self.marker.mark(time, chunk.values[valid]))

    def clock(self) -> ClockLine:
        """Return the line that relates the device's clock to the host's."""
        return self._clock.fit()
