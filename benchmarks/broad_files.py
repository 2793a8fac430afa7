"""Trials of BROAD. An HDF5 file contains the sensor and the optics on a common clock.

Units are rad/s, m/s2 (specific force), uT and m. Quaternions are w-x-y-z, body to east-north-up. Lost poses are NaN. D.
Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A benchmark for robust inertial orientation estimation", Data 6(7),
72, 2021.
"""

import os
import tempfile
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
from pyarrow import parquet

from undrift.io.columns import native_columns
from undrift.record import Record, Reference

FOLDER = Path(os.environ.get("UNDRIFT_DATA", Path(__file__).parents[2] / "shared" / "data")) / "broad"
_CONVERTED = tempfile.TemporaryDirectory(prefix="undrift-broad-")  # removed at exit


def read_broad(path: str | Path) -> tuple[Record, Reference]:
    """Read the sensor and the optics of a trial."""
    with h5py.File(path, "r") as trial:
        rate_hz = float(trial.attrs["sampling_rate"])
        names = ("imu_gyr", "imu_acc", "imu_mag", "opt_quat", "opt_pos", "movement")
        gyro, accel, mag, quat, position, moving = (np.asarray(trial[name][()], dtype=np.float64) for name in names)
    time = np.arange(len(gyro)) / rate_hz
    quat[np.isnan(quat).any(axis=1)] = np.nan
    record = Record(time=time, gyro=gyro, accel=accel, mag_ut=mag)
    moving = (moving > 0.0).astype(np.float64)
    return record, Reference(time=time, q_nb=quat, position=position, moving=moving, name=Path(path).name)


@cache
def broad_file(name: str) -> Path:
    """Return a trial as a Parquet file with readings and poses, for commands. ``name`` has no ending."""
    record, reference = read_broad(FOLDER / f"{name}.hdf5")
    table = dict(zip(*native_columns(record), strict=True))
    table |= dict(zip(("q_w", "q_x", "q_y", "q_z"), reference.q_nb.T, strict=True))
    if reference.position is not None:
        table |= dict(zip(("pos_x_m", "pos_y_m", "pos_z_m"), reference.position.T, strict=True))
    path = Path(_CONVERTED.name) / f"{name}.parquet"
    parquet.write_table(pa.table({**table, "moving": reference.moving}), path)
    return path
