"""Gaps: readings that never came are counted and marked with rows of NaN, which means a gap everywhere in undrift.

A step of device time of m + 1 periods lacks m readings. A gap longer than a stated span is marked by one row only.
"""

import numpy as np

from undrift.arrays import FloatArray


class GapMarker:
    """Marks what is missing, chunk by chunk.

    Parameters
    ----------
    period_s : float
        Device time from reading to reading, s.
    longest_fill_s : float
        Longest gap that gets a row for each missing reading, s.
    """

    def __init__(self, period_s: float, longest_fill_s: float = 1.0) -> None:
        self._period = period_s
        self._longest = longest_fill_s
        self._last: float | None = None
        self.gaps = 0
        self.missing = 0

    def mark(self, time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return readings with rows of NaN where some are missing.

        Parameters
        ----------
        time : array, shape (N,)
            Device time, s, strictly increasing, also from call to call.
        values : array, shape (N, C)
            Readings.

        Returns
        -------
        time : array, shape (M,)
            s.
        values : array, shape (M, C)
            NaN in the rows that were missing.
        """
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
        gone = before[at] + nth * step[at]
        return np.insert(time, at, gone), np.insert(values, at, np.nan, axis=0)
