"""Exports of phone apps: one file per sensor, in a folder or a zip archive, all with the same clock.

Apps: Sensor Logger, phyphox. The accelerometer is interpolated onto the time stamps of the gyroscope. Sensor Logger names each file
after its sensor. Accelerometer.csv is without gravity. On iOS, its acceleration has the opposite sign of specific force, unless
Metadata.csv indicates that units and frames are standardised. phyphox already reverses the sign on iOS.
"""

import csv
import re
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

import numpy as np

from undrift.errors import FileFormatError, InputError
from undrift.files import MOST_BYTES, read_bytes, sound, too_large
from undrift.io.clock import onto_clock
from undrift.io.column_map import AXES, ColumnMap, native_map
from undrift.io.columns import RawTable, ReadResult, build_record, date_of, native_columns
from undrift.io.labelled import Sheet, open_sheet, sheet_table
from undrift.io.labels import label_of
from undrift.io.text import as_utf8

OPPOSITE_SIGN = "acceleration multiplied by -1: iOS reads -1 g along an axis that points up"
UNKNOWN_SIGN = "the file does not give the sign of acceleration (iOS and Android differ). Export Metadata.csv too."
_GYRO = ("Gyroscope.csv", "GyroscopeUncalibrated.csv")
_ACCEL = ("TotalAcceleration.csv", "AccelerometerUncalibrated.csv", "Accelerometer.csv")
_UNITS = {"gyro": "rad/s", "accel": "m/s2"}  # from the manual of Sensor Logger
_NO_GRAVITY = 3.0  # limit of an acceleration's median: g below it, m/s2 above it


def is_phone(path: Path) -> bool:
    """Return True if a folder is an export of a phone."""
    return all(any((path / name).is_file() for name in names) for names in (_GYRO, _ACCEL))


def phone_pair(files: Sequence[Path]) -> tuple[Path, Path] | None:
    """Return the paths of gyroscope and accelerometer for two files of a phone in a folder, or None if their names do not match."""
    order = sorted(files, key=lambda file: file.name not in _GYRO)
    if len(order) != 2 or order[0].parent != order[1].parent:
        return None
    return (order[0], order[1]) if order[0].name in _GYRO and order[1].name in _ACCEL else None


def read_phone(path: Path, how: ColumnMap) -> RawTable:
    """Read the folder of a phone."""
    gyro, accel = (next(path / name for name in names if (path / name).is_file()) for names in (_GYRO, _ACCEL))
    return read_phone_pair(gyro, accel, how)


def read_phone_pair(gyro_file: Path, accel_file: Path, how: ColumnMap) -> RawTable:
    """Read gyroscope and accelerometer of a phone. The accelerometer is interpolated onto the time stamps of the gyroscope."""
    path, name, other = gyro_file.parent, gyro_file.name, accel_file.name
    gyro, gyro_start = _read_file(gyro_file, how)
    accel, accel_start = _read_file(accel_file, how)
    if accel.record.accel is None or gyro.record.gyro is None:
        raise FileFormatError(f"{path}: expected a gyroscope in {name} and an accelerometer in {other}, got others")
    later_s = (accel_start - gyro_start) / np.timedelta64(10**9, "ns") + accel.epoch_s - gyro.epoch_s
    accel_time, gyro_time = accel.record.time + later_s, gyro.record.time
    inside = np.flatnonzero((gyro_time >= accel_time[0]) & (gyro_time <= accel_time[-1]))
    if len(inside) < 2:
        raise FileFormatError(f"{path}: {name} and {other} do not overlap in time. Read only one of them.")
    overlap = gyro.record.part(int(inside[0]), int(inside[-1]) + 1)
    values, missing = onto_clock(overlap.time, accel_time, accel.record.accel)
    notes = [f"{other} interpolated onto the time stamps of {name}"]
    notes += [f"{missing} samples in drop-outs of {other} are gaps"] * bool(missing)
    record = replace(overlap, accel=values, accel_unit=accel.record.accel_unit)
    notes = [*dict.fromkeys((*gyro.notes, *accel.notes, *notes))]
    names, columns = native_columns(record)
    own = native_map(names, how).but(gaps="keep", device=record.device)
    return RawTable(source=str(path), names=names, columns=columns, own=own, notes=tuple(notes))


def _read_file(file: Path, how: ColumnMap) -> tuple[ReadResult, np.datetime64]:
    """Return the content of a file, and the date of its first row. Dates are counted from the first row."""
    sheet = open_sheet(file)
    start = date_of(next(iter(sheet.text.cells()), ""))
    sheet = _sensor_logger(sheet) if sheet.text.names[:2] == ("time", "seconds_elapsed") else sheet
    return build_record(sheet_table(sheet, how.but(clock="file"))), start


def is_phone_zip(path: Path) -> bool:
    """Return True if a zip archive is an export of a phone, from the names of its files."""
    with zipfile.ZipFile(path) as archive:
        names = {PurePosixPath(name).name for name in archive.namelist()}
    return not (names.isdisjoint(_GYRO) or names.isdisjoint(_ACCEL))


def read_phone_zip(path: Path, how: ColumnMap) -> RawTable:
    """Read the zip archive that a phone app exports, like the folder in it."""
    wanted = (*_GYRO, *_ACCEL, "Metadata.csv")
    with sound(path, "zip"), zipfile.ZipFile(path) as archive, TemporaryDirectory() as folder:
        for item in archive.infolist():
            name = PurePosixPath(item.filename).name
            if name in wanted and item.file_size > MOST_BYTES:  # zipfile unpacks at most the size in its header
                raise too_large(path)
            if name in wanted:
                (Path(folder) / name).write_bytes(archive.read(item))
        try:
            return read_phone(Path(folder), how)
        except InputError as error:
            raise type(error)(str(error).replace(folder, str(path)), **error.numbers) from error


# ---- Sensor Logger: one file per sensor


def read_sensor_logger(path: Path, how: ColumnMap) -> RawTable:
    """Read one file of Sensor Logger, as specific force."""
    return sheet_table(_sensor_logger(open_sheet(path)), how)


def _sensor_logger(sheet: Sheet) -> Sheet:
    """Label the columns from the file name. Columns of a watch or headphones have their own names."""
    stem = sheet.path.name.split(".")[0]
    kind = "Linear acceleration" if stem == "Accelerometer" else stem
    names = tuple(f"{kind} {name}" if name in AXES else name for name in sheet.text.names)
    names = tuple(re.sub("^acceleration(?=[XYZ]$)", "Linear acceleration", name) for name in names)
    labels = [None if name == "time" else label_of(name, "s" * (name == "seconds_elapsed"), _UNITS) for name in names]
    notes = ["units from the manual of Sensor Logger, not from the file: accel m/s2, gyro rad/s"]
    if any(label and label.channel == "accel" for label in labels):
        unit, sign, accel_notes = _accel_unit_and_sign(sheet)
        labels = [
            label._replace(gain=sign, unit=unit) if label and label.channel == "accel" else label for label in labels
        ]
        notes = (notes if unit == "m/s2" else []) + accel_notes
    return replace(sheet, text=replace(sheet.text, names=names), labels=tuple(labels), notes=tuple(notes))


def _accel_unit_and_sign(sheet: Sheet) -> tuple[str, float, list[str]]:
    """Return the unit of the accelerometer, the factor to specific force, and notes."""
    ios = _follows_ios(sheet.path.with_name("Metadata.csv"))
    if not sheet.path.name.startswith("AccelerometerUncalibrated"):
        return "m/s2", -1.0 if ios else 1.0, [UNKNOWN_SIGN] if ios is None else [OPPOSITE_SIGN] * ios
    columns = [k for k, name in enumerate(sheet.text.names) if name in AXES]
    size = float(np.nanmedian(np.linalg.norm(sheet.array(columns), axis=1))) if len(columns) == 3 else np.nan
    if ios is not None and ios != (size < _NO_GRAVITY):
        raise FileFormatError(
            f"{sheet.path}: expected {'g' if ios else 'm/s2'} by platform and standardisation in Metadata.csv, got a median of "
            f"{size:.3g}. The two files do not belong together. Omit Metadata.csv."
        )
    if size < _NO_GRAVITY:
        how = f"acceleration in g: its median is {size:.3g} (iOS writes this file in g, Android in m/s2)"
        return "g", -1.0, [how, OPPOSITE_SIGN]
    return "m/s2", 1.0, []


def _follows_ios(path: Path) -> bool | None:
    """Return True if, according to Metadata.csv, Sensor Logger kept signs and units of iOS, or None if the file does not contain
    this.
    """
    lines = as_utf8(read_bytes(path)).decode().splitlines() if path.is_file() and path.stat().st_size else []
    row = {key: str(cell).strip().lower() for key, cell in next(csv.DictReader(lines), {}).items()}
    android, ios = (row.get("platform", "").startswith(name) for name in ("android", "ios"))
    return ios and row.get("standardisation") != "true" if android or ios else None
