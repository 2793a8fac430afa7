"""BROAD trials: one HDF5 file holds the sensor and the optics on one clock.

Datasets imu_gyr (rad/s), imu_acc (m/s2, specific force), imu_mag (uT), opt_quat (w-x-y-z, body to east-north-up), opt_pos
(m), movement (0 or 1), all of the same length; the attribute sampling_rate gives the clock. Where the optics lost the body
its pose is NaN.
"""

from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError
from undrift.io.hdf5 import open_hdf5, read_array
from undrift.record import Record, Reference

WIDTHS = (("imu_gyr", 3), ("imu_acc", 3), ("imu_mag", 3), ("opt_quat", 4), ("opt_pos", 3))


def read_broad(path: str | Path) -> tuple[Record, Reference]:
    """Read one trial of the BROAD data set [1]_.

    Parameters
    ----------
    path : str or Path
        The trial's .hdf5 file.

    Returns
    -------
    Record
        Raw gyro rad/s, accel m/s2, mag uT in sensor axes.
    Reference
        Orientation, position m and the author's motion mark, on the same time.

    Raises
    ------
    InputError
        No such file.
    FileFormatError
        Not HDF5, or without the datasets, shapes or attribute above.

    References
    ----------
    .. [1] D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A benchmark for robust inertial orientation estimation",
       Data 6(7), 72, 2021.
    """
    path = Path(path)
    with open_hdf5(path) as handle:
        if "sampling_rate" not in handle.attrs:
            raise FileFormatError(f"{path}: wanted the attribute sampling_rate, got none; this is not a BROAD trial")
        sample_rate_hz = float(handle.attrs["sampling_rate"])
        gyro, accel, mag, quat, position = (
            _columns(read_array(handle, name, path), name, n, path) for name, n in WIDTHS
        )
        moving = read_array(handle, "movement", path)
    if not sample_rate_hz > 0.0:
        raise FileFormatError(f"{path}: wanted sampling_rate in Hz above 0, got {sample_rate_hz:g}")
    time = np.arange(len(gyro)) / sample_rate_hz
    record = Record(time=time, gyro=gyro, accel=accel, mag_ut=mag)
    reference = Reference(
        time=time, q_nb=_seen(quat), position=position, moving=(moving > 0.0).astype(float), name=path.name
    )
    return record, reference


def _columns(values: FloatArray, name: str, width: int, path: Path) -> FloatArray:
    if values.ndim != 2 or values.shape[1] != width:
        raise FileFormatError(f"{path}: {name}: wanted shape (N, {width}), got {values.shape}; time is axis 0")
    return values


def _seen(quat: FloatArray) -> FloatArray:
    """Return the quaternions with whole NaN rows where any element is missing."""
    seen = np.array(quat)
    seen[np.isnan(quat).any(axis=1)] = np.nan
    return seen
