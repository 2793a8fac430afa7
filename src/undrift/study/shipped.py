"""Fits of the device presets that come with the package, so that a study of a preset need not make them again.

    key     hash of all that a fit depends on: device, session, errors of the bench, mode of the fit, seed, group, number
    values  gyroscopes M, o, G, then accelerometers M, o
    tables  over temperature: rounded, second differences along the temperature, compressed

The rule: a fit is used if its key agrees, and if the fits of device 0 agree, which every study makes again with the code that runs.
If one of these differs, the file is stale, and the study makes all its fits. ``python -m benchmarks.ship_fits`` makes the file.
The fits have no uncertainties, so a study that finds the offset in motion makes its own.
"""

import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.model import SENSORS, Calibration, DriftTables, DynamicDrift, ScaleDrift, StaticDrift
from undrift.sim.device.model import DeviceModel, device_json
from undrift.study.sessions import CalibrationSession, bare_model
from undrift.units import STANDARD_GRAVITY

FILE = Path(__file__).with_name("fits.parquet")
# of the largest value of a table
ROUNDING = {"temp_c": 1e-6, "turn_rate": 1e-6, "error": 1e-4} | {f"{sensor}_offset": 1e-6 for sensor in SENSORS}
ROUNDING |= {f"{sensor}_matrix": 1e-5 for sensor in SENSORS}
AGREES = 1e-3  # of the largest value: rounding and another processor differ by less

# ---- keys


def device_text(device: DeviceModel) -> str:
    """Return all values of a device."""
    return json.dumps(device_json(device), sort_keys=True)


def key_of(device: str, session: CalibrationSession | str, *words: Any) -> int:
    """Return the hash of a device, a session or rival, and all else that a fit depends on."""
    if isinstance(session, CalibrationSession):
        session = replace(session, name="", protocol=session.protocol and replace(session.protocol, name=""))
    return int.from_bytes(hashlib.blake2b(repr((device, session, words)).encode(), digest_size=8).digest(), "big")


# ---- values

Values = tuple[FloatArray, bytes]
_TABLES = {
    f"{table}.{field}": (table, field)
    for table, fields in (
        ("static", ("temp_c", "gyro_offset", "accel_offset")),
        ("scale", ("temp_c", "gyro_matrix", "accel_matrix")),
        ("dynamic", ("temp_c", "turn_rate", "error")),
    )
    for field in fields
}


def pack(calibration: Calibration | None) -> Values | None:
    """Return the values of a fit, or NaN if it failed. Return None if the file cannot contain all its values."""
    if calibration is None:
        return np.full(33, np.nan), b""
    gyro, accel = calibration.gyro, calibration.accel
    parts = [getattr(triad, name) for triad in (gyro, accel) for name in ("moving_offset", "code_offset")]
    if gyro is None or accel is None or calibration.adc is not None or any(part is not None for part in parts):
        return None
    sensitivity = np.zeros((3, 3)) if gyro.g_sensitivity is None else gyro.g_sensitivity
    values = (gyro.matrix, gyro.offset, sensitivity, accel.matrix, accel.offset)
    return np.concatenate([np.ravel(part) for part in values]), pack_tables(calibration.drift)


def unpack(values: Values, device: DeviceModel, reference_temp_c: float) -> Calibration | None:
    """Return the fit of a device from its values, or None if it failed."""
    numbers, tables = values
    if np.isnan(numbers).all():
        return None
    gyro = bare_model("gyro", device.gyro.unit, numbers[:9].reshape(3, 3), numbers[9:12])
    return Calibration(
        device=device.serial,
        reference_temp_c=reference_temp_c,
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=replace(gyro, g_sensitivity=numbers[12:21].reshape(3, 3)) if numbers[12:21].any() else gyro,
        accel=bare_model("accel", device.accel.unit, numbers[21:30].reshape(3, 3), numbers[30:]),
        drift=unpack_tables(tables),
    )


def pack_tables(drift: DriftTables | None) -> bytes:
    """Return tables over temperature as compressed second differences."""
    if drift is None:
        return b""
    steps, words = dict[str, Any](), list[bytes]()
    for name, (table, field) in _TABLES.items():
        array = getattr(getattr(drift, table), field, None)
        if array is not None:
            step = ROUNDING[field] * float(np.abs(array).max()) or 1.0
            counts = np.round(array / step).astype(np.int64)
            steps[name] = step, array.shape
            words.append(np.diff(counts, n=2, axis=0, prepend=np.zeros_like(counts[:2])).astype("<i4").tobytes())
    head = json.dumps({"lag": (drift.lag_s, drift.lag_smooth_s), "steps": steps}).encode()
    return zlib.compress(len(head).to_bytes(4, "little") + head + b"".join(words), 9)


def unpack_tables(text: bytes) -> DriftTables | None:
    """Return tables over temperature from compressed second differences."""
    if not text:
        return None
    plain = zlib.decompress(text)
    start = 4 + int.from_bytes(plain[:4], "little")
    head, parts = json.loads(plain[4:start]), dict[str, dict[str, FloatArray]]()
    for name, (step, shape) in head["steps"].items():
        differences = np.frombuffer(plain, "<i4", int(np.prod(shape)), start).reshape(shape).astype(np.int64)
        start += 4 * differences.size
        table, field = _TABLES[name]
        parts.setdefault(table, {})[field] = step * differences.cumsum(axis=0).cumsum(axis=0)
    kinds: dict[str, Any] = {"static": StaticDrift, "scale": ScaleDrift, "dynamic": DynamicDrift}
    tables: dict[str, Any] = {table: kinds[table](**fields) for table, fields in parts.items()}
    return DriftTables(lag_s=head["lag"][0], lag_smooth_s=head["lag"][1], **tables)


def agree(fitted: Values | None, shipped: Values) -> bool:
    """Return True if two fits are the same within rounding."""
    if fitted is None or bool(fitted[1]) != bool(shipped[1]):
        return False
    pairs = [(fitted[0][part], shipped[0][part]) for part in map(slice, (0, 9, 12, 21, 30), (9, 12, 21, 30, 33))]
    tables = [_arrays(unpack_tables(each[1])) for each in (fitted, shipped)]
    if [array.shape for array in tables[0]] != [array.shape for array in tables[1]]:
        return False
    pairs += [(tables[0][k], tables[1][k]) for k in range(len(tables[0]))]
    return all(np.allclose(a, b, rtol=0.0, atol=AGREES * np.abs(b).max(), equal_nan=True) for a, b in pairs)


def _arrays(drift: DriftTables | None) -> list[FloatArray]:
    arrays = [getattr(getattr(drift, table, None), field, None) for table, field in _TABLES.values()]
    return [array for array in arrays if array is not None]


# ---- the file


@cache
def shipped_fits() -> Mapping[int, Values]:
    """Return all fits of the file by their key, none if there is no file."""
    import pyarrow.parquet as pq

    if not FILE.exists():
        return {}
    table = pq.read_table(FILE)
    numbers = np.array(table["values"].to_pylist(), dtype=float)
    tables = table["tables"].to_pylist()
    return {key: (numbers[k], tables[k]) for k, key in enumerate(table["key"].to_pylist())}


def write_fits(fits: Mapping[int, Values], notes: Mapping[str, str], path: Path = FILE) -> None:
    """Write fits by their key."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    keys = sorted(fits)
    columns = {
        "key": pa.array(keys, pa.uint64()),
        "values": pa.array([fits[key][0].astype(np.float32) for key in keys], pa.list_(pa.float32())),
        "tables": pa.array([fits[key][1] for key in keys], pa.binary()),
    }
    pq.write_table(pa.table(columns, metadata=dict(notes)), path, compression="zstd", compression_level=19)
