"""Kiel's validation set: a person's tasks by many sensors and by optical markers, one MAT file each.

``data/pp001/imu/imu_TASK.mat``       struct data: acc (N, 3, M) g, gyro (N, 3, M) deg/s, magn, fs Hz, imu_location {1, M}
``data/pp001/optical/omc_TASK.mat``   struct data: pos (N, 4, K) mm with the residual, fs Hz, marker_location {1, K}; z is up

E. Warmerdam et al., "Proposed mobility assessments with simultaneous full-body inertial measurement units and optical motion
capture in healthy adults and neurological patients", Sensors 21(17), 5833, 2021. The layout is that of its published description.
"""

import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError
from undrift.files import checked_file
from undrift.io.arrays import hdf5_names, mat_tree
from undrift.io.box import boxed
from undrift.io.columns import ColumnMap, ReadResult, ReadSettings
from undrift.io.containers import build, chosen
from undrift.io.mocap import Markers, Up, markers_of

UP: Up = "z"  # of the laboratory


def is_kiel(path: Path, head: bytes, place: str) -> bool:
    """Tell a file of the set by the field that names its sensors or markers."""
    if head.startswith((b"MATLAB 7.3", b"\x89HDF")):
        return f"data/{place}" in hdf5_names(path)
    if not head.startswith(b"MATLAB 5.0"):
        return False
    with suppress(zlib.error):
        head = head + zlib.decompressobj().decompress(head[136:], 1024)
    return place.encode() in head and b"\x04\x00data" in head


@boxed("pymatreader")
def read_kiel_imu(path: Path, _: ColumnMap | None, settings: ReadSettings) -> ReadResult:
    """Read one sensor, named by where it is worn."""
    data, places = _struct(path, "imu_location", ("acc", "gyro"))
    k = places.index(chosen(path, "sensor", places, settings.sensor))
    channels = {
        channel: (values[:, :, k], unit)
        for channel, name, unit in (("accel", "acc", "g"), ("gyro", "gyro", "dps"))
        if (values := data[name]).shape[1] == 3
    }
    rate_hz = float(data["fs"])
    notes = ["acc in g and gyro in deg/s as the set's description has them; magn left out (no unit)"]
    time = np.arange(len(data["acc"])) / rate_hz
    return build(path, time, channels, settings, notes, device=places[k], sample_rate_hz=rate_hz)


@boxed("pymatreader")
def read_kiel_markers(path: Path, up: Up | None = None) -> Markers:
    """Read the markers; a frame without a residual of 0 or more is a gap."""
    data, labels = _struct(path, "marker_location", ("pos",))
    points = data["pos"].transpose(0, 2, 1)
    lost = (points[:, :, 3:] < 0.0).any(axis=2) if points.shape[2] > 3 else np.zeros(points.shape[:2], np.bool_)
    points = np.where(lost[:, :, None], np.nan, 1e-3 * points[:, :, :3])
    return markers_of(path, labels, points, np.arange(len(points)) / float(data["fs"]), up=up or UP)


def _struct(path: Path, place: str, wanted: tuple[str, ...]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the struct with its arrays (N, axes, M), and where each of the M is."""
    data = mat_tree(checked_file(path)).get("data", {})
    names = data.get(place, ())
    places = (names,) if isinstance(names, str) else tuple(str(name) for name in names)
    rate_hz = data.get("fs")
    if not isinstance(rate_hz, int | float) or not rate_hz > 0.0:
        raise FileFormatError(f"{path}: wanted data.fs in Hz above 0, got {rate_hz!r}; copy the file again")
    for name in wanted:
        array = np.asarray(data.get(name, ()))
        array = array[:, :, None] if array.ndim == 2 and len(places) == 1 else array
        if array.ndim != 3 or array.dtype.kind not in "fiu" or array.shape[1] < 3 or array.shape[2] != len(places):
            raise FileFormatError(
                f"{path}: wanted data.{name} with rows, axes and {len(places)} places of {place}, got shape {array.shape}; copy "
                "the file again"
            )
        data[name] = _floats(array)
    if len({len(data[name]) for name in wanted}) != 1:
        lengths = ", ".join(f"{name} {len(data[name])}" for name in wanted)
        raise FileFormatError(f"{path}: wanted arrays of one length, got {lengths} rows; copy the file again")
    return data, places


def _floats(array: Any) -> FloatArray:
    return np.asarray(array, dtype=np.float64)
