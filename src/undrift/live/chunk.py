"""Chunk: readings as they came in, with the host's time of arrival; nothing is interpreted yet."""

from dataclasses import dataclass

from undrift.arrays import FloatArray, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chunk:
    """Readings that came together, N of them.

    Parameters
    ----------
    host_time : array, shape (N,)
        When each came, s, the host's monotonic clock.
    counter : array, shape (N,), or None
        What the device's own counter said, ticks; None for a device that sends none.
    values : array, shape (N, C)
        Raw readings in the order of ``StreamDescription.measured``, the device's units.
    """

    host_time: FloatArray
    counter: FloatArray | None
    values: FloatArray

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "host_time", frozen(self.host_time, (None,), "host_time"))
        if self.counter is not None:
            set_(self, "counter", frozen(self.counter, (len(self.host_time),), "counter"))
        set_(self, "values", frozen(self.values, (len(self.host_time), None), "values"))

    def __len__(self) -> int:
        return len(self.host_time)
