"""Rimu_Test_Jig: two sensors on one axis of a public stepper rate table."""

import numpy as np

from testkit.data import data_path
from undrift.arrays import FloatArray, runs
from undrift.record import Record, Turn
from undrift.sync import LONGEST_STEP, Lag, PoseRates, lag_of

RUNS = ("giro_test_filt", "giro_test_non_filt")
# The stepper swings for about a second after each ramp: that second is left out for the BNO. On the LSM vibration of 10-50 deg/s
# runs through the whole dwell and the longest mean is the best one.
GUARD_S = {"bno": 1.0, "lsm": 0.5}


def find_axis_lag(record: Record, time: FloatArray, angle: FloatArray) -> Lag:
    """Find the lag against the angle (M,), rad."""
    step = np.diff(time)
    valid = np.isfinite(np.diff(angle)) & (step <= LONGEST_STEP * np.median(step))
    rate = np.where(valid, np.diff(angle) / step, 0.0)[:, None]
    rates = PoseRates(start=time[:-1], stop=time[1:], rate=rate, valid=valid)
    return lag_of(record.time, np.asarray(record.gyro), rates, average_s=0.1)


def clock_lag(run, sensor="bno"):
    """Return the lag of the clock. Both sensors share a clock, and the BNO has less noise."""
    d = np.load(data_path("ratetable_jig", f"{run}.npz"))
    record = Record(time=d["t_imu"], gyro=d[f"gyro_{sensor}_dps"], gyro_unit="dps")
    return find_axis_lag(record, d["t_jig"], np.radians(d["top_angle_deg"].astype(float))).seconds


def turned(run, sensor):
    """The sensor's readings, and the turns at the rates the table achieved, on the sensor's clock."""
    d = np.load(data_path("ratetable_jig", f"{run}.npz"))
    record = Record(time=d["t_imu"], gyro=d[f"gyro_{sensor}_dps"], gyro_unit="dps")
    time, angle = d["t_jig"], np.radians(d["top_angle_deg"].astype(float))
    lag = clock_lag(run)
    rate = np.gradient(angle, time)
    turns = []
    for commanded in np.radians(d["cmd_top_speed_dps"].astype(float)):
        steady = runs(np.abs(rate - commanded) < 0.01 * abs(commanded) + 0.01)
        first, last = steady[np.argmax(steady[:, 1] - steady[:, 0])]
        start, stop = time[first] + GUARD_S[sensor], time[last - 1] - GUARD_S[sensor]
        inside = (time >= start) & (time < stop)
        achieved = np.polyfit(time[inside], angle[inside], 1)[0]
        begin, end = np.searchsorted(record.time, (start + lag, stop + lag))
        # the table's angle runs down while the sensor's y axis reads up
        turns.append(Turn(start=int(begin), stop=int(end), axis="y", turn_rate=-float(achieved)))
    return record, tuple(turns)
