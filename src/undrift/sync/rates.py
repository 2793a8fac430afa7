"""Mean rates between neighbouring poses, and the readings of a gyroscope averaged over the same stretches.

Between two poses the mean body rate is the rotation vector of their quotient over the time between them::

    w_k = log(q_k^-1 q_(k+1)) / (t_(k+1) - t_k)

Averages of readings come from the running integral of the straight lines between samples: a reading is taken as the
instantaneous rate at its time stamp.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.frames import quaternion_conjugate, quaternion_product, rotation_vector
from undrift.record import Reference

LONGEST_STEP = 1.5  # medians of the pose interval; a longer step is a gap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseRates:
    """Mean body rates between neighbouring poses.

    Parameters
    ----------
    start, stop : array, shape (K,)
        Times of the two poses, s.
    rate : array, shape (K, 3)
        Mean rate, rad/s, frame of the body; zero where not valid.
    valid : array, shape (K,)
        False where a pose is missing or the step is a gap.
    """

    start: FloatArray
    stop: FloatArray
    rate: FloatArray
    valid: BoolArray


def pose_rates(reference: Reference) -> PoseRates:
    """Return the mean rate of the body between neighbouring poses.

    Parameters
    ----------
    reference : Reference
        Poses; gaps allowed.

    Returns
    -------
    PoseRates
        One rate for each pair of neighbours.
    """
    step = np.diff(reference.time)
    turn = rotation_vector(quaternion_product(quaternion_conjugate(reference.q_nb[:-1]), reference.q_nb[1:]))
    valid = np.isfinite(turn[:, 0]) & (step <= LONGEST_STEP * np.median(step))
    rate = np.where(valid[:, None], turn / step[:, None], 0.0)
    return PoseRates(start=reference.time[:-1], stop=reference.time[1:], rate=rate, valid=valid)


class RunningIntegral:
    """Integral of readings from the first sample on, for averages over any stretch.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    values : array, shape (N, C)
        Readings; NaN counts as a gap.
    """

    def __init__(self, time: FloatArray, values: FloatArray) -> None:
        gap: BoolArray = np.asarray(np.isnan(values).any(axis=1))
        self.time = time
        self._values = np.where(gap[:, None], 0.0, values)
        step = np.diff(time)
        late = step > LONGEST_STEP * np.median(step)
        self._gaps: IntArray = np.append(0, np.cumsum(gap[1:] | gap[:-1] | late))
        area = 0.5 * (self._values[1:] + self._values[:-1]) * step[:, None]
        self._sum = np.concatenate((np.zeros((1, values.shape[1])), np.cumsum(area, axis=0)))

    def mean(self, start: FloatArray, stop: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the mean reading of each stretch.

        Parameters
        ----------
        start, stop : array, shape (K,)
            s, on the clock of the readings.

        Returns
        -------
        mean : array, shape (K, C)
            Zero where not valid.
        valid : array, shape (K,)
            False outside the record and where a gap lies within.
        """
        first, at_first = self._at(start)
        last, at_last = self._at(stop)
        valid = (start >= self.time[0]) & (stop <= self.time[-1])
        valid &= self._gaps[np.minimum(last + 1, len(self.time) - 1)] == self._gaps[first]
        mean = (at_last - at_first) / (stop - start)[:, None]
        return np.where(valid[:, None], mean, 0.0), valid

    def _at(self, t: FloatArray) -> tuple[IntArray, FloatArray]:
        k = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 2)
        dt = t - self.time[k]
        slope = (self._values[k + 1] - self._values[k]) / (self.time[k + 1] - self.time[k])[:, None]
        return k, self._sum[k] + self._values[k] * dt[:, None] + 0.5 * slope * (dt * dt)[:, None]


def box_sums(values: FloatArray, width: int) -> FloatArray:
    """Return sums over every run of ``width`` rows.

    Parameters
    ----------
    values : array, shape (K, C)
        Any numbers without gaps.
    width : int
        Rows in a run.

    Returns
    -------
    array, shape (K - width + 1, C)
        Sum of each run.
    """
    total = np.concatenate((np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)))
    sums: FloatArray = total[width:] - total[:-width]
    return sums
