"""Timeline: chunks as they came in become readings on the device's own clock, gaps marked, the host's clock beside it."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.live.chunk import Chunk
from undrift.live.clock import ClockFit, ClockSettings, DeviceClock
from undrift.live.counter import Arrivals, Counter
from undrift.live.description import StreamDescription
from undrift.live.gaps import GapMarker


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Readings on the device's clock.

    Parameters
    ----------
    time : array, shape (N,)
        Device time, s, strictly increasing, 0 at the first reading.
    values : array, shape (N, C)
        Raw, NaN where a reading is missing.
    """

    time: FloatArray
    values: FloatArray


class Timeline:
    """Puts the readings of one connection in order.

    Parameters
    ----------
    description : StreamDescription
        What the device sends.
    clock : ClockSettings
        How its clock is found.
    """

    def __init__(self, description: StreamDescription, clock: ClockSettings = ClockSettings()) -> None:
        self.description = description
        self.readings = 0
        self._counter = Counter(description.counter_bits, description.tick_s, description.clock_speed)
        self._arrivals = Arrivals(description.rate, description.clock_speed)
        self._clock = DeviceClock(description.clock_speed, clock)
        self._marker = GapMarker(1.0 / description.rate)

    @property
    def missing(self) -> int:
        """Readings that never came."""
        return self._marker.missing

    @property
    def gaps(self) -> int:
        """Stretches of such."""
        return self._marker.gaps

    @property
    def late(self) -> int:
        """Readings that came late or twice and were left out."""
        return self._counter.late

    @property
    def restarts(self) -> int:
        """Times that the device began to count anew."""
        return self._counter.restarts

    def add(self, chunk: Chunk) -> Block:
        """Take a chunk.

        Parameters
        ----------
        chunk : Chunk
            The next of the stream.

        Returns
        -------
        Block
            What it adds; may be empty.
        """
        if chunk.counter is None:
            count, kept = self._arrivals.count(chunk.host_time), np.ones(len(chunk), dtype=bool)
        else:
            count, kept = self._counter.unwrap(chunk.counter, chunk.host_time)
        time = count[kept] * self.description.tick_s
        self.readings += len(time)
        self._clock.add(time, chunk.host_time[kept])
        return Block(*self._marker.mark(time, chunk.values[kept]))

    def clock(self) -> ClockFit:
        """Return how the device's clock stands to the host's.

        Returns
        -------
        ClockFit
            As known by now.
        """
        return self._clock.fit()
