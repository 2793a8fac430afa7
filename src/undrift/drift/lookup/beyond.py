"""Which corrected readings lie beyond the span of inputs that the fit of a triad has seen.

A fit holds where it was made: M and the offset come from values between ``valid_range``, and a reading outside is corrected by
extrapolation, which non-linearity does not follow. A reading counts as beyond where it leaves the span by more than a tenth of
the span's reach, since noise alone carries a device that lies on a face past +-1 g. Nothing is changed by this; it is told.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration, TriadModel
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, si_factor

MARGIN = 0.1  # of the reach, the larger end of the span


@dataclass(frozen=True, slots=True, kw_only=True)
class Beyond:
    """Readings of one triad beyond what its fit has seen; of a record, or of all chunks of a stream so far.

    Parameters
    ----------
    sensor : str
        gyro or accel.
    seen : tuple of float
        Least and greatest value that the fit has seen, SI.
    samples : int
        With a value on any axis that lies beyond by more than a tenth of the reach.
    of : int
        Samples looked at.
    worst : float
        The value that lies furthest beyond, SI; 0 where none does.
    """

    sensor: str
    seen: tuple[float, float]
    samples: int = 0
    of: int = 0
    worst: float = 0.0

    @property
    def share(self) -> float:
        """Share of the samples."""
        return self.samples / self.of if self.of else 0.0

    def joined(self, later: "Beyond") -> "Beyond":
        """Return both.

        Parameters
        ----------
        later : Beyond
            Of the chunk that follows.

        Returns
        -------
        Beyond
            Of the stream with it.
        """
        worst = max(self.worst, later.worst, key=lambda value: _outside(value, self.seen))
        return Beyond(
            sensor=self.sensor, seen=self.seen, samples=self.samples + later.samples, of=self.of + later.of, worst=worst
        )

    @property
    def text(self) -> str:
        """One sentence, empty where nothing lies beyond."""
        if not self.samples:
            return ""
        what, unit, factor = "gyroscope", "deg/s", RADIAN_PER_DEGREE
        if self.sensor == "accel":
            what, unit, factor = "accelerometer", "g", STANDARD_GRAVITY
        low, high, worst = (value / factor for value in (*self.seen, self.worst))
        return (
            f"{what}: {_percent(self.share)} of the samples lie beyond what the calibration has seen, {low:.3g} to {high:.3g} "
            f"{unit}, by more than a tenth; the worst is {worst:.4g} {unit}: the model is extrapolated there"
        )


def find_beyond(record: Record, calibration: Calibration) -> tuple[Beyond, ...]:
    """Find the corrected readings that lie beyond what the fits have seen.

    Parameters
    ----------
    record : Record
        Corrected, rad/s and m/s2.
    calibration : Calibration
        That it was corrected with.

    Returns
    -------
    tuple of Beyond
        One for each triad that has readings and a fit with a span: one of no width (offset alone) or that is not stated has
        none, and its verdict says so.
    """
    triads: tuple[tuple[str, FloatArray | None, TriadModel | None, Quantity], ...] = (
        ("gyro", record.gyro, calibration.gyro, "rate"),
        ("accel", record.accel, calibration.accel, "accel"),
    )
    found = []
    for name, values, model, quantity in triads:
        if values is None or model is None or not model.valid_range[0] < model.valid_range[1]:
            continue
        factor = si_factor(model.unit_out, quantity)
        low, high = (end * factor for end in model.valid_range)
        found.append(_of_triad(name, values, (low, high)))
    return tuple(found)


def _of_triad(name: str, values: FloatArray, seen: tuple[float, float]) -> Beyond:
    room = MARGIN * max(abs(seen[0]), abs(seen[1]))
    low, high = seen[0] - room, seen[1] + room
    least, greatest = float(np.fmin.reduce(values, axis=None)), float(np.fmax.reduce(values, axis=None))
    if not (least < low or greatest > high):  # one pass, and most recordings end here
        return Beyond(sensor=name, seen=seen, of=len(values))
    mask = (values < low) | (values > high)
    worst = max(least, greatest, key=lambda value: _outside(value, seen))
    samples = int(np.count_nonzero(mask[:, 0] | mask[:, 1] | mask[:, 2]))
    return Beyond(sensor=name, seen=seen, samples=samples, of=len(values), worst=worst)


def _outside(value: float, seen: tuple[float, float]) -> float:
    return max(seen[0] - value, value - seen[1], 0.0)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.0995 else f"{100.0 * share:.0f} %"
