"""Fits of the device presets that come with the package, so that a study of a preset need not make them again.

    key       hash of all that a fit depends on: device, session, errors of the bench, mode of the fit, seed, group, number
    arrays    matrices, offsets and tables over temperature: rounding step, then second differences of the rounded values

A fit is used if its key agrees, and if one session of device 0 agrees. Every study fits this session again with the current code.
If the result differs, the file is outdated, and the study computes all fits itself. A test compares all sessions of device 0.
``python -m benchmarks.ship_fits`` makes the file. The fits have no uncertainties, so a study that determines the offset from motion
computes its own fits.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.model import Calibration, DriftTables, DynamicDrift, ScaleDrift, StaticDrift
from undrift.sim.device.model import DeviceModel, device_json
from undrift.study.sessions import CalibrationSession, bare_model
from undrift.units import STANDARD_GRAVITY

FILE = Path(__file__).with_name("fits.parquet")
AGREES = 1e-3  # tolerance relative to the largest value: rounding on another processor causes smaller differences

Fit = dict[str, FloatArray]  # arrays by name, empty if the session could not calibrate the device

# shape of each array, and its rounding relative to its largest value
ARRAYS: dict[str, tuple[tuple[int, ...], float]] = {
    "gyro.matrix": ((3, 3), 1e-7),
    "gyro.offset": ((3,), 1e-7),
    "gyro.g_sensitivity": ((3, 3), 1e-7),
    "gyro.moving_offset": ((3,), 1e-7),
    "gyro.code_offset": ((3,), 1e-7),
    "accel.matrix": ((3, 3), 1e-7),
    "accel.offset": ((3,), 1e-7),
    "static.temp_c": ((-1,), 1e-6),
    "static.gyro_offset": ((-1, 3), 1e-6),
    "static.accel_offset": ((-1, 3), 1e-6),
    "scale.temp_c": ((-1,), 1e-6),
    "scale.gyro_matrix": ((-1, 3, 3), 1e-5),
    "scale.accel_matrix": ((-1, 3, 3), 1e-5),
    "dynamic.temp_c": ((-1,), 1e-6),
    "dynamic.turn_rate": ((-1,), 1e-6),
    "dynamic.error": ((-1, 3), 1e-4),
    "lag.seconds": ((2,), 1e-6),
}
GYRO_ONLY = ("g_sensitivity", "moving_offset", "code_offset")
TABLES: dict[str, Any] = {"static": StaticDrift, "scale": ScaleDrift, "dynamic": DynamicDrift}


def device_text(device: DeviceModel) -> str:
    """Return all values of a device."""
    return json.dumps(device_json(device), sort_keys=True)


def key_of(device: str, session: CalibrationSession | str, *words: Any) -> int:
    """Return the hash of a device, a session or rival, and everything else on which a fit depends."""
    if isinstance(session, CalibrationSession):
        session = replace(session, name="", protocol=session.protocol and session.protocol.named(""))
    return int.from_bytes(hashlib.blake2b(repr((device, session, words)).encode(), digest_size=8).digest(), "big")


def pack(calibration: Calibration | None) -> Fit | None:
    """Return the arrays of a fit. Return None if the file cannot contain all its values."""
    if calibration is None:
        return {}
    gyro, accel, drift = calibration.gyro, calibration.accel, calibration.drift
    if gyro is None or accel is None or calibration.adc is not None:
        return None
    sources: dict[str, Any] = {"gyro": gyro, "accel": accel} | {table: getattr(drift, table, None) for table in TABLES}
    fit: Fit = {} if drift is None else {"lag.seconds": np.array((drift.lag_s, drift.lag_smooth_s))}
    for name in ARRAYS:
        source, _, field = name.partition(".")
        array = getattr(sources.get(source), field, None)
        if array is not None:
            fit[name] = array
    return fit


def unpack(fit: Fit, device: DeviceModel, reference_temp_c: float) -> Calibration | None:
    """Return the fit of a device from its arrays, or None if it failed."""
    if not fit:
        return None
    parts = dict[str, dict[str, FloatArray]]()
    for name, array in fit.items():
        source, _, field = name.partition(".")
        parts.setdefault(source, {})[field] = array
    more: dict[str, Any] = {name: parts["gyro"].get(name) for name in GYRO_ONLY}
    gyro = bare_model("gyro", device.gyro.unit, parts["gyro"]["matrix"], parts["gyro"]["offset"])
    drift = None
    if "lag" in parts:
        tables = {table: kind(**parts[table]) for table, kind in TABLES.items() if table in parts}
        lag_s, smooth_s = parts["lag"]["seconds"].tolist()
        drift = DriftTables(lag_s=lag_s, lag_smooth_s=smooth_s, **tables)
    return Calibration(
        device=device.serial,
        reference_temp_c=reference_temp_c,
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=replace(gyro, **more),
        accel=bare_model("accel", device.accel.unit, parts["accel"]["matrix"], parts["accel"]["offset"]),
        drift=drift,
    )


def agree(fitted: Fit | None, shipped: Fit) -> bool:
    """Return True if two fits are the same within rounding."""
    if fitted is None or {name: x.shape for name, x in fitted.items()} != {
        name: x.shape for name, x in shipped.items()
    }:
        return False
    return all(np.allclose(fitted[name], x, rtol=0.0, atol=AGREES * np.abs(x).max()) for name, x in shipped.items())


# ---- the file


class ShippedFits(Mapping[int, Fit]):
    """Fits of the file by their key. Each fit is decoded when it is needed."""

    def __init__(self, file: Path) -> None:
        import pyarrow.parquet as pq

        self._table = pq.ParquetFile(file).read()
        self._rows = {key: row for row, key in enumerate(self._table["key"].to_pylist())}

    def __iter__(self) -> Iterator[int]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, key: int) -> Fit:
        fit, row = Fit(), self._rows[key]
        for name, (shape, _) in ARRAYS.items():
            cell = self._table[name][row]
            if cell.is_valid:
                step, *differences = cell.as_py()
                fit[name] = step * np.reshape(differences, shape).cumsum(axis=0).cumsum(axis=0)
        if "dynamic.error" in fit:
            fit["dynamic.error"] = fit["dynamic.error"].reshape(len(fit["dynamic.temp_c"]), -1, 3)
        return fit


@cache
def shipped_fits() -> Mapping[int, Fit]:
    """Return all fits of the file by key, or no fits if there is no file."""
    return ShippedFits(FILE) if FILE.exists() else {}
