"""Public recordings that several tests read. The SOURCE.md in the folder of each names origin and licence."""

import numpy as np

from testkit.data import data_path
from undrift.record import Record


def nilspod() -> Record:
    """Return a foot sensor in a person's hands, on six faces and turned about three axes."""
    d = np.loadtxt(data_path("ferraris_nilspod", "example_ferraris_session.csv"), delimiter=",", skiprows=1)
    return Record(time=np.arange(len(d)) / 102.4, gyro=d[:, 1:4], accel=d[:, 4:7], gyro_unit="dps")


def mpu9150(unit: int) -> Record:
    """Return one of three boards, turned by hand from pose to pose."""
    log = np.loadtxt(data_path("multipos_mpu9150", f"imu{unit}.log.gz"))
    return Record(time=np.arange(len(log)) / 100.0, accel=log[:, :3], gyro=log[:, 3:])


def bicycle() -> list[Record]:
    """Return eleven poses of a board on a bicycle."""
    logs = [np.load(path) for path in sorted(data_path("multipos_mpu6050_bicycle").glob("*.npz"))]
    return [
        Record(time=d["t_s"], gyro=d["gyro_rad_s"], accel=d["acc_raw"], accel_unit="count", temp_c=d["temp_degC"])
        for d in logs
    ]
