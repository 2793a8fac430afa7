"""Lag of a gyroscope's readings behind the angle of a table with one axis."""

import numpy as np

from undrift.arrays import FloatArray
from undrift.record import Record
from undrift.sync import LONGEST_STEP, Lag, PoseRates, lag_of


def find_axis_lag(record: Record, time: FloatArray, angle: FloatArray) -> Lag:
    """Find the lag against the angle (M,), rad."""
    step = np.diff(time)
    valid = np.isfinite(np.diff(angle)) & (step <= LONGEST_STEP * np.median(step))
    rate = np.where(valid, np.diff(angle) / step, 0.0)[:, None]
    rates = PoseRates(start=time[:-1], stop=time[1:], rate=rate, valid=valid)
    return lag_of(record.time, np.asarray(record.gyro), rates, average_s=0.1)
