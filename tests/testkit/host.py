"""A host that stamps readings on arrival: in bursts, late, and some never.

A device sends what it has gathered since its last transmission, every 20 to 70 ms; a transmission takes a moment, some stall, and
some are lost with all that they carry. The host writes the readings of one transmission one after another, a tick apart, each with
its own time of writing, on a clock that runs at another speed than the device's.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.record import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class HostSettings:
    """Timing of transmissions. The defaults are assumed, with steps of 1 to 69 ms at 100 Hz as in a log over Bluetooth."""

    interval_s: tuple[float, float] = (0.02, 0.07)  # Between transmissions, uniform
    latency_s: float = 0.0015  # mean duration of a transmission, exponential
    stall_share: float = 0.005  # share of transmissions that are delayed and sent with the next
    stall_s: tuple[float, float] = (0.1, 0.6)
    lost_share: float = 0.004  # share of transmissions that are lost
    outage_s: tuple[float, float] = (0.3, 2.0)  # Length of an outage, during which none comes
    outages: int = 3  # Of a recording
    tick_s: float = 0.001  # tick of the host's stamps, which separates readings of a transmission
    clock_error: float = 2e-4  # Relative: the device's clock runs slow by it
    counter_bits: int = 8  # of the device's counter of samples


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HostStamped:
    """The host's data of a recording."""

    record: Record  # The readings that came, with the host's stamps
    kept: IntArray  # (M,), which samples of the recording came
    counter: IntArray  # (M,), the device's own counter of samples, wrapped


def stamp_on_host(record: Record, *, rng: np.random.Generator, settings: HostSettings = HostSettings()) -> HostStamped:
    """Return a recording as a host would have written it."""
    own = record.time - record.time[0]
    sent = np.cumsum(rng.uniform(*settings.interval_s, int(own[-1] / settings.interval_s[0]) + 2))
    sent = sent[: int(np.searchsorted(sent, own[-1])) + 1]
    late = np.where(rng.random(len(sent)) < settings.stall_share, rng.uniform(*settings.stall_s, len(sent)), 0.0)
    came = np.maximum.accumulate(sent + late + rng.exponential(settings.latency_s, len(sent)))
    lost = rng.random(len(sent)) < settings.lost_share
    for start, length in zip(
        rng.uniform(0.1 * own[-1], 0.9 * own[-1], settings.outages),
        rng.uniform(*settings.outage_s, settings.outages),
        strict=True,
    ):
        lost |= (sent >= start) & (sent < start + length)
    carried = np.searchsorted(sent, own)  # the transmission of each sample
    kept = np.flatnonzero(~lost[np.minimum(carried, len(sent) - 1)])
    stamps = _written(came[np.minimum(carried[kept], len(sent) - 1)], settings.tick_s)
    time = record.time[0] + stamps * (1.0 + settings.clock_error)
    channels = {name: getattr(record, name) for name in ("gyro", "accel", "temp_c", "mag_ut")}
    here = {name: values[kept] for name, values in channels.items() if values is not None}
    counter = np.arange(len(record))[kept] % (1 << settings.counter_bits)
    return HostStamped(record=replace(record, time=time, **here), kept=kept, counter=counter)


def _written(came: FloatArray, tick: float) -> FloatArray:
    """Return the host's stamps of readings in order: whole ticks, each after the one before."""
    ticks = np.ceil(came / tick)
    order = np.arange(len(ticks))
    return np.asarray((np.maximum.accumulate(ticks - order) + order) * tick)
