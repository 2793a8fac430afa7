"""Text exports of makers: what their manuals state and their files do not.

Xsens MT      // lines, PacketCounter (16 bit) as the only clock; m/s2, rad/s by the manual
Movella DOT   sep=, SampleTimeFine in us (32 bit), lost packets; m/s2, deg/s by the manual; FreeAcc has gravity removed
Shimmer       unit row; Accel_LN and Accel_WR are two accelerometers
Delsys        EMGworks: a time column for each channel; Trigno Discover: a rate for each channel, no time
Noraxon       NAME Accel Sensor X (mG), NAME-Gyroscope-x (deg/s); decimal comma with ";"
APDM          Format=7: a label for each sensor in line 1, us since 1970; m/s2, rad/s, uT by the manual
x-io          NGIMU, x-IMU, x-IMU3: a folder, temperature in a file of its own
ActiGraph     GT9X Link: ten lines, then Timestamp and g, deg/s, uT, degC
Sensor Logger the file's name says which sensor; Accelerometer.csv has gravity removed; a folder holds one file a sensor. On iOS
              acceleration is the opposite of specific force unless Metadata.csv says that units and frames are standardised
SensorLog     iOS: g, the opposite of specific force. (phyphox turns the sign of iOS itself.)
Physics Toolbox  gF in g, w in rad/s; ax, ay, az are the linear accelerometer, without gravity. Arduino Science Journal: ms, m/s2
MATLAB Mobile Timestamp,X,Y,Z, one timetable a file, named by the file

Each is a row of DIALECTS, below: how a file is recognised, and what its manual states but the file does not. A dialect names
its columns (``columns``), or it is labelled: names and unit rows state what each column is (io/labelled.py), and the row adds units
of the manual, what is left out, and what a function of this file finds (``finish``). A new maker is a new row::

    "step_logger": Dialect(
        head=rb"\\A# StepLogger \\d",
        maker="StepLogger",
        units={"gyro": "dps", "accel": "g"},
        device=r"^# unit (\\w+)",
        rate=r"^# rate (\\d+)",
    ),

Temperature that comes in a file of its own, at its own rate, is interpolated onto the samples and held at the ends.
"""

import csv
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import MOST_BYTES, read_bytes, sound, too_large
from undrift.io.clock import onto_clock
from undrift.io.columns import (
    AXES,
    READ_SETTINGS,
    ColumnMap,
    ReadResult,
    ReadSettings,
    TempFile,
    TextLayout,
    build_record,
    chosen,
    date_of,
    in_seconds,
    naming,
)
from undrift.io.labelled import Label, Sheet, as_utf8, label_of, labelled, open_sheet, read_sheet, unit_for, with_manual
from undrift.io.reference import NEARLY_UNIT, ReferenceMap, read_text_poses, reference_of
from undrift.io.text import Text, open_text, parse_text
from undrift.record import Record, Reference
from undrift.units import canonical_unit, si_factor, temp_offset

_SI = {"gyro": "rad/s", "accel": "m/s2", "temp": "degC"}
_OPPOSITE = "acceleration multiplied by -1: iOS reads -1 g along an axis that points up"
_NO_SIGN = "sign of acceleration not stated by the file (iOS and Android differ); rests and turns decide"

# ---- Xsens MT and Movella DOT: packets that may be lost


def _xsens_clock(sheet: Sheet, settings: ReadSettings) -> Sheet:
    """Return an MT Manager export with its clock: the packet counter at the stated rate, so that lost packets are gaps."""
    counter = sheet.position(r"^(Packet)?Counter$")
    stated = sheet.stated(r"^// *(?:Update|Sample) rate: *(\d+(?:\.\d+)?) *Hz")
    rate = settings.sample_rate_hz or (float(stated) if stated else None)
    in_name = (re.findall(r"_(00[0-9A-F]{6})\b", sheet.path.name) or [""])[-1]
    sheet = replace(sheet, rate_hz=rate, device=sheet.device or in_name)
    fine = sheet.position(r"^SampleTimeFine$")
    if rate is None and fine is not None and np.isfinite(sheet.array((fine,))).all():

        def ticks(stamps: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
            seconds = 1e-4 * _unwrapped(sheet, stamps, 1 << 32)
            return seconds, ("time from SampleTimeFine, 10 kHz by the manual of Xsens",)

        return replace(sheet, clock=ticks, counters=(fine,))
    if counter is None or rate is None:
        return sheet
    step_s = 1.0 / rate

    def clock(counts: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        packets = _unwrapped(sheet, counts, 1 << 16)
        return packets * step_s, _lost(packets)

    return replace(sheet, clock=clock, counters=(counter,))


def _dot_clock(sheet: Sheet, _: ReadSettings = READ_SETTINGS) -> Sheet:
    """Return a DOT export with its clock, SampleTimeFine."""
    fine, counter = sheet.position(r"^SampleTimeFine$"), sheet.position(r"^PacketCounter$")
    if fine is None or counter is None:
        raise FileFormatError(
            f"{sheet.path}: wanted the columns PacketCounter and SampleTimeFine, got {', '.join(sheet.names[:8])}; export "
            "them too"
        )

    def clock(stamps: FloatArray, packets: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        return 1e-6 * (stamps[0] + _unwrapped(sheet, stamps, 1 << 32)), _lost(_unwrapped(sheet, packets, 1 << 32))

    return replace(sheet, clock=clock, counters=(fine, counter))


def _unwrapped(sheet: Sheet, counts: FloatArray, size: int) -> FloatArray:
    """Return a counter from 0 on, with its overflows undone; a step of half its range and more is a step back."""
    steps = np.mod(np.diff(counts), size)
    if (back := np.flatnonzero(steps > size // 2)).size:
        raise FileFormatError(
            f"{sheet.path}: wanted a counter that goes forward, got {counts[back[0]]:.10g} and then {counts[back[0] + 1]:.10g} in "
            f"data row {back[0] + 2}; it is damaged, or holds two recordings: cut it there"
        )
    return np.concatenate(([0.0], np.cumsum(steps)))


def _lost(packets: FloatArray, what: str = "packets lost by PacketCounter") -> tuple[str, ...]:
    lost = int(packets[-1]) + 1 - len(packets) if len(packets) else 0
    return (f"{lost} of {int(packets[-1]) + 1} {what}, seen as gaps in time",) if lost > 0 else ()


def _with_readings(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Refuse an export of orientations only, which is a reference."""
    if any(label and label.channel in ("gyro", "accel", "free") for label in sheet.labels):
        return sheet
    raise FileFormatError(
        f"{sheet.path}: wanted Acc_X or Gyr_X columns, got orientations only; read the file as a `reference`",
        missing="readings",
    )


def _numbered(sheet: Sheet, settings: ReadSettings) -> Sheet:
    """Return a table that numbers its samples with a clock by these numbers, so that lost rows are gaps."""
    numbers, rate = sheet.position("^samples$"), settings.sample_rate_hz
    if numbers is None or rate is None:
        return sheet
    what = "samples missing by their numbers"
    return replace(sheet, counters=(numbers,), clock=lambda n: ((n - n[0]) / rate, _lost(n - n[0], what)))


# ---- Sensor Logger, SensorLog, mobgap


def _sensor_logger_labels(sheet: Sheet, _: ReadSettings = READ_SETTINGS) -> Sheet:
    """Label one sensor of the Sensor Logger app, as specific force: iOS writes its opposite unless frames are standardised."""
    path, stem = sheet.path, sheet.path.name.split(".")[0]
    kind = "Linear acceleration" if stem == "Accelerometer" else stem
    names = tuple(f"{kind} {name}" if name in AXES else name for name in sheet.names)
    names = tuple(re.sub("^acceleration(?=[XYZ]$)", "Linear acceleration", name) for name in names)  # watch, headphones
    labels = [label_of(name, "s" if name == "seconds_elapsed" else "", _SI) for name in names]
    labels = [None if name == "time" else label for name, label in zip(names, labels, strict=True)]
    notes = ["units by the manual of Sensor Logger, not in the file: accel m/s2, gyro rad/s"]
    _in_g, apple = False, _of_ios(path.with_name("Metadata.csv"))
    if stem.startswith("AccelerometerUncalibrated") and (size := _median_size(sheet, names)) is not None:
        _in_g = size < 3.0
        if _in_g:
            notes = [f"acceleration in g: its median is {size:.3g}; iOS writes this file in g, Android in m/s2"]
        if apple is not None and apple != _in_g:
            raise FileFormatError(
                f"{path}: wanted {'g' if apple else 'm/s2'} by platform and standardisation in Metadata.csv, got a median of "
                f"{size:.3g}; the two do not belong together: leave Metadata.csv out"
            )
        apple = _in_g
    if any(label and label.channel == "accel" for label in labels):
        notes += [_NO_SIGN] if apple is None else [_OPPOSITE] if apple else []
    labels = [
        x._replace(gain=-x.gain if apple else x.gain, unit="g" if _in_g else x.unit)
        if x and x.channel == "accel"
        else x
        for x in labels
    ]
    return replace(sheet, names=names, labels=tuple(labels), notes=tuple(notes))


def _of_ios(path: Path) -> bool | None:
    """Tell by Metadata.csv whether Sensor Logger kept the signs and units of iOS; None where it does not say."""
    lines = as_utf8(read_bytes(path)).decode().splitlines() if path.is_file() and path.stat().st_size else []
    stated = {key: str(cell).strip().lower() for key, cell in next(csv.DictReader(lines), {}).items()}
    android, ios = (stated.get("platform", "").startswith(name) for name in ("android", "ios"))
    return ios and stated.get("standardisation") != "true" if android or ios else None


def _signed_by_rests(sheet: Sheet, _: ReadSettings) -> Sheet:
    accel = any(label and label.channel == "accel" for label in sheet.labels)
    return replace(sheet, notes=(*sheet.notes, _NO_SIGN)) if accel else sheet


def _without_linear(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Label the linear accelerometer of Physics Toolbox, ax to az, as one without gravity."""
    labels = [
        x and x._replace(channel="free") if re.fullmatch("a[xyz]", name) else x
        for name, x in zip(sheet.names, sheet.labels, strict=True)
    ]
    return replace(sheet, labels=tuple(labels))


def _matlab_labels(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Label one timetable of MATLAB Mobile by the name of its file."""
    kinds = {"angularvelocity": "Gyroscope", "acceleration": "Acceleration", "magneticfield": "Magnetometer"}
    stem = re.sub(r"[^a-z]", "", sheet.path.stem.lower())
    kind = next((kind for key, kind in kinds.items() if key in stem), None)
    if kind is None:
        raise FileFormatError(
            f"{sheet.path}: wanted Acceleration or AngularVelocity in the name of a file of MATLAB Mobile, got another; name it so"
        )
    names = (sheet.names[0], *(f"{kind} {axis}" for axis in "XYZ"))
    sheet = replace(sheet, names=names, notes=())
    return with_manual(sheet, "MATLAB Mobile", {"accel": "m/s2", "gyro": "rad/s", "mag": "uT"})


def _one_gyroscope(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Leave the fused one of two gyroscopes of SensorLog out: the raw one is read."""
    fused = "motionRotationRate" if sheet.position("^gyroRotation") is not None else None
    return replace(sheet, labels=tuple(None if x and x.sensor == fused else x for x in sheet.labels))


def _median_size(sheet: Sheet, names: tuple[str, ...]) -> float | None:
    columns = [k for k, name in enumerate(names) if name[-2:] in (" x", " y", " z")]
    return float(np.nanmedian(np.linalg.norm(sheet.array(columns), axis=1))) if len(columns) == 3 else None


def _in_g(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Refuse a mobgap example whose accelerations are not in g, as its manual has them."""
    size = _median_size(sheet, tuple(re.sub(r"^acc_", "acc ", name) for name in sheet.names))
    if size is None or not 0.5 < size < 2.0:
        raise InputError(
            f"{sheet.path}: wanted accelerations in g (median near 1), got a median of {size or 0.0:.3g}; give the units in a map "
            "(`column_map` FILE)"
        )
    return sheet


# ---- the folder of a phone: a file for each sensor, all on one clock

_PHONE_GYRO = ("Gyroscope.csv", "GyroscopeUncalibrated.csv", "AngularVelocity.csv")
_PHONE_ACCEL = ("TotalAcceleration.csv", "AccelerometerUncalibrated.csv", "Accelerometer.csv", "Acceleration.csv")


def is_phone(path: Path) -> bool:
    """Tell a folder of Sensor Logger or phyphox."""
    return all(any((path / name).is_file() for name in names) for names in (_PHONE_GYRO, _PHONE_ACCEL))


def phone_pair(files: Sequence[Path]) -> tuple[Path, Path] | None:
    """Return gyroscope and accelerometer of two files of a phone that lie side by side; None where the names are others."""
    order = sorted(files, key=lambda file: file.name not in _PHONE_GYRO)
    if len(order) != 2 or order[0].parent != order[1].parent:
        return None
    return (order[0], order[1]) if order[0].name in _PHONE_GYRO and order[1].name in _PHONE_ACCEL else None


def read_phone(path: Path, _: ColumnMap | None, settings: ReadSettings) -> ReadResult:
    """Read the folder of a phone."""
    gyro, accel = (next(path / name for name in n if (path / name).is_file()) for n in (_PHONE_GYRO, _PHONE_ACCEL))
    return read_phone_pair(gyro, accel, settings)


def read_phone_pair(gyro_file: Path, accel_file: Path, settings: ReadSettings) -> ReadResult:
    """Read gyroscope and accelerometer of a phone; the latter is interpolated onto the time stamps of the former."""

    def one(file: Path) -> tuple[ReadResult, np.datetime64]:
        sheet = open_sheet(file)
        own = {"time,seconds_elapsed": "sensor_logger", "Timestamp,X": "matlab_mobile"}.get(",".join(sheet.names[:2]))
        start = date_of(
            sheet.rows[:64].split(b",", 1)[0].decode("utf-8", "replace")
        )  # dates are counted from the first
        return DIALECTS[own].read(file, None, settings) if own else read_sheet(labelled(sheet), settings), start

    path, name, other = gyro_file.parent, gyro_file.name, accel_file.name
    found, start = one(gyro_file)
    try:
        held, later = one(accel_file)
    except FileFormatError as error:
        if not error.numbers.get("gravity_removed"):
            raise
        return replace(found, notes=(*found.notes, str(error).removeprefix(f"{path}/")))
    gyro, accel = found.record, held.record
    if accel.accel is None or gyro.gyro is None:
        raise FileFormatError(f"{path}: wanted a gyroscope in {name} and an accelerometer in {other}, got others")
    accel_time = accel.time + (later - start) / np.timedelta64(10**9, "ns") + held.epoch_s - found.epoch_s
    inside = np.flatnonzero((gyro.time >= accel_time[0]) & (gyro.time <= accel_time[-1]))
    if len(inside) < 2:
        raise FileFormatError(
            f"{path}: wanted {name} and {other} of the same time, got two times apart; read one of them"
        )
    part = gyro.part(int(inside[0]), int(inside[-1]) + 1)
    values, missing = onto_clock(part.time, accel_time, accel.accel)
    notes = [f"{other} interpolated onto the time stamps of {name}"]
    notes += [f"{missing} samples in drop-outs of {other} are gaps"] * bool(missing)
    record = replace(part, accel=values, accel_unit=accel.accel_unit)
    return replace(found, record=record, notes=tuple(dict.fromkeys((*found.notes, *held.notes, *notes))))


def is_phone_zip(path: Path) -> bool:
    """Tell the zip that an app of a phone exports by the files in it."""
    with zipfile.ZipFile(path) as held:
        names = {PurePosixPath(name).name for name in held.namelist()}
    return not (names.isdisjoint(_PHONE_GYRO) or names.isdisjoint(_PHONE_ACCEL))


def read_phone_zip(path: Path, _: ColumnMap | None, settings: ReadSettings) -> ReadResult:
    """Read the zip that an app of a phone exports, as the folder in it."""
    wanted = (*_PHONE_GYRO, *_PHONE_ACCEL, "Metadata.csv")
    with sound(path, "zip"), zipfile.ZipFile(path) as held, TemporaryDirectory() as folder:
        for item in held.infolist():
            name = PurePosixPath(item.filename).name
            if name in wanted and item.file_size > MOST_BYTES:  # zipfile unpacks no more than is stated
                raise too_large(path)
            if name in wanted:
                (Path(folder) / name).write_bytes(held.read(item))
        try:
            return read_phone(Path(folder), None, settings)
        except InputError as error:
            raise type(error)(str(error).replace(folder, str(path)), **error.numbers) from error


# ---- Delsys Trigno


def _trigno_labels(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Label an EMGworks export: "Label: ... Unit: g" lines, then pairs of X[s] and a channel."""
    line = re.compile(
        r"Label: (.*?) Sampling frequency: *(\d+(?:\.\d+)?(?:e[-+]\d+)?)\b.*Unit: *(\S+) Domain Unit: *(\S+)"
    )
    stated = {found.group(1): found.groups() for text in sheet.preamble if (found := line.search(text))}
    labels: list[Label | None] = [None] * len(sheet.names)
    for k, name in enumerate(sheet.names):
        if name in stated and ": " in name and k > 0 and sheet.names[k - 1].startswith("X["):
            rate, unit, domain = stated[name][1:]
            sensor, signal = name.split(": ", 1)
            label = label_of(signal, unit)
            labels[k - 1] = Label("", "own time", unit=(unit_for(domain, "time") or ("s", 1.0))[0])
            labels[k] = label and label._replace(sensor=sensor, rate_hz=float(rate), time=k - 1)
    return replace(sheet, labels=tuple(labels))


def _trigno_discover_labels(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Label a Trigno Discover export: names in line 4, signals in line 6, rates in line 7, no time."""
    lines = [[cell.strip() for cell in text.split(",")] for text in (*sheet.preamble, ",".join(sheet.names))]
    heads = [k for k, cells in enumerate(lines) if cells and re.fullmatch(r"\d+(\.\d+)? Hz", cells[0])]
    if not heads or heads[0] < 3:
        raise FileFormatError(
            f"{sheet.path}: wanted lines of sensors, modes, signals and rates, got none; export them too"
        )
    sensors, signals, rates = lines[heads[0] - 3], lines[heads[0] - 1], lines[heads[0]]
    labels: list[Label | None] = []
    for k in range(len(sheet.names)):
        name = next((sensors[j] for j in range(min(k, len(sensors) - 1), -1, -1) if sensors[j]), "")
        label = label_of(signals[k]) if k < len(signals) else None
        rate = re.match(r"\d+(\.\d+)?(?= Hz)", rates[k]) if k < len(rates) else None
        labels.append(label and rate and label._replace(sensor=name, rate_hz=float(rate.group())))
    names = tuple(signals[: len(sheet.names)]) + ("",) * (len(sheet.names) - len(signals))
    return replace(sheet, names=names, labels=tuple(labels))


# ---- APDM Opal: several sensors in one CSV
#
#     Test Name:, ...
#     Sample Rate:,128,Hz
#     Time,Static/Acceleration/X, ... ,Static/Temperature/Scalar, ...        one group for each sensor
#     s,m/s^2, ... ,deg C, ...                                               the units


def read_apdm(path: str | Path, sensor: str | None = None) -> Record:
    """Read one sensor of an APDM Opal file."""
    text = open_text(path, TextLayout(skip_rows=2))
    sensor = chosen(text.path, "sensor", _opals(text), sensor)
    lines = [line.decode("utf-8", "replace").split(",") for line in text.head.splitlines()[: text.skip + 1]]
    if len(lines) <= text.skip:
        raise FileFormatError(
            f"{text.path}: wanted a row of units under the header, got the end of the file; copy it again"
        )
    try:
        rate = float(lines[1][1])
    except (IndexError, ValueError) as error:
        raise FileFormatError(
            f"{text.path}: wanted 'Sample Rate:,128,Hz' in line 2, got {','.join(lines[1][:3])!r}"
        ) from error
    units = dict(zip(text.names, lines[text.skip], strict=False))

    def unit_of(name: str) -> str:
        if units.get(name):
            return units[name]
        raise FileFormatError(f"{text.path}: wanted the unit of {name} in line 4, got none; correct that line")

    held: dict[str, Any] = {"time": "Time", "time_unit": unit_of("Time")}
    for channel, quantity in (("gyro", "Angular Velocity"), ("accel", "Acceleration"), ("mag", "Magnetic Field")):
        names = tuple(f"{sensor}/{quantity}/{axis.upper()}" for axis in AXES)
        if 0 < sum(name in text.names for name in names) < 3:
            raise FileFormatError(f"{text.path}: wanted all axes of {sensor}/{quantity}, got some; repair the header")
        if names[0] in text.names:
            held |= {channel: names, f"{channel}_unit": unit_of(names[0])}
    if (temp := f"{sensor}/Temperature/Scalar") in text.names:
        held |= {"temp": temp, "temp_unit": unit_of(temp)}
    columns = ColumnMap(**held, device=sensor, sample_rate_hz=rate)
    return build_record(parse_text(replace(text, skip=text.skip + 1), columns.wanted()), columns).record


def apdm_sensors(path: str | Path) -> tuple[str, ...]:
    """Return the names of the sensors in an APDM file."""
    return _opals(open_text(path, TextLayout(skip_rows=2)))


def _opals(text: Text) -> tuple[str, ...]:
    names = [name.split("/")[0] for name in text.names if name.count("/") == 2 and "/Acceleration/" in name]
    if "Time" not in text.names or not names:
        raise FileFormatError(
            f"{text.path}: wanted an APDM header in line 3 (Time, Name/Acceleration/X, ...), got another file"
        )
    return tuple(dict.fromkeys(names))


# ---- APDM, format 7


def _apdm7_labels(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Label an APDM file in format 7; the barometer (the bits of a double as an integer) is left out."""
    if len(sheet.preamble) < 2 or not sheet.names:
        raise FileFormatError(
            f"{sheet.path}: wanted three header lines of APDM format 7, got fewer; copy the file again"
        )
    first, second = (line.split(",") for line in sheet.preamble[-2:])
    kinds = {"Accelerometer": "accel", "Gyroscope": "gyro", "Magnetometer": "mag"}
    manual = {"accel": ("m/s2", 1.0), "gyro": ("rad/s", 1.0), "mag": ("ut", 1.0)}
    labels: list[Label | None] = [Label("", "time", unit="us")]
    sensor, kind = "", ""
    starts = [k for k, cell in enumerate(second) if cell == "Accelerometer"]
    tags = [cell for cell in first[1:] if cell][1::2]
    if len(starts) != len(tags):
        raise FileFormatError(f"{sheet.path}: wanted {len(tags)} accelerometers, got {len(starts)}; repair the header")
    for k in range(1, len(sheet.names)):
        if k in starts:
            sensor = tags[starts.index(k)]
        kind = second[k] if k < len(second) and second[k] else kind
        channel, axis = kinds.get(kind), sheet.names[k].lower()
        labels.append(Label(sensor, channel, axis, *manual[channel]) if channel and axis in AXES else None)
    note = "units by the manual of APDM, not in the file: accel m/s2, gyro rad/s, mag uT"
    return replace(sheet, labels=tuple(labels), preamble=(), notes=(note,))


# ---- a thermometer of its own


def _with_temp(record: Record, time: FloatArray, temp_c: FloatArray) -> Record:
    """Return a record with temperatures (M,), degC, at times (M,), s, interpolated onto its samples and held at the ends."""
    known = np.isfinite(time) & np.isfinite(temp_c)
    if not known.any():
        raise InputError("temperature: wanted one reading or more, got none; leave the temperature file out")
    order = np.argsort(time[known], kind="stable")
    return replace(record, temp_c=np.interp(record.time, time[known][order], temp_c[known][order]))


def with_thermometer(record: Record, thermometer: TempFile) -> Record:
    """Return the record with the temperature of a thermometer's own file."""
    dated = canonical_unit(thermometer.time_unit, "time") == "date"
    wanted = (thermometer.temp,) if dated else (thermometer.time, thermometer.temp)
    table = parse_text(open_text(thermometer.path, thermometer.layout), wanted)
    table = in_seconds(table, thermometer.time) if dated else table
    time = table.numbers(thermometer.time) * si_factor(thermometer.time_unit, "time") + thermometer.shift_s
    unit = canonical_unit(thermometer.temp_unit, "temp")
    temp_c = table.numbers(thermometer.temp) * si_factor(unit, "temp") + temp_offset(unit)
    known = time[np.isfinite(time) & np.isfinite(temp_c)]
    if len(known) and (known.max() < record.time[0] or known.min() > record.time[-1]):
        raise InputError(
            f"{thermometer.path}: wanted temperatures from {record.time[0]:.6g} to {record.time[-1]:.6g} s, the recording's clock, "
            f"got {known.min():.6g} to {known.max():.6g} s; set temp_file.shift_s, in s"
        )
    with naming(thermometer.path):
        return _with_temp(record, time, temp_c)


# ---- Xsens


def _xsens(sheet: Sheet) -> Reference:
    """Return orientations as quaternion, matrix or Euler angles (roll, pitch, yaw; Z-Y-X), sensor to level."""
    from scipy.spatial.transform import Rotation

    if sheet.clock is None:
        raise InputError(
            f"{sheet.path}: wanted the sample rate, got a file without it; give sample_rate_hz in a map",
            missing="sample_rate_hz",
        )
    forms = (
        [r"^Quat_(w|q0)$", r"^Quat_(x|q1)$", r"^Quat_(y|q2)$", r"^Quat_(z|q3)$"],
        [rf"^Mat\[{i}\]\[{j}\]$" for i in (1, 2, 3) for j in (1, 2, 3)],
        [r"^Yaw$", r"^Pitch$", r"^Roll$"],
    )
    found = [[k for pattern in form if (k := sheet.position(pattern)) is not None] for form in forms]
    held = next((columns for columns, form in zip(found, forms, strict=True) if len(columns) == len(form)), None)
    if held is None:
        raise FileFormatError(
            f"{sheet.path}: wanted Quat, Mat or Roll, Pitch, Yaw columns, got none; export orientations"
        )
    values = sheet.array(held)
    q_nb = np.full((len(values), 4), np.nan)
    seen = np.isfinite(values).all(axis=1)
    if len(held) == 4:
        q_nb = values
    else:
        if len(held) == 9 and (np.abs(np.linalg.det(values[seen].reshape(-1, 3, 3)) - 1.0) > NEARLY_UNIT).any():
            raise FileFormatError(
                f"{sheet.path}: wanted rotation matrices in Mat, got others; export orientations again"
            )
        turn = Rotation.from_matrix(values[seen].reshape(-1, 3, 3)) if len(held) == 9 else None
        turn = turn or Rotation.from_euler("ZYX", values[seen], degrees=True)
        q_nb[seen] = turn.as_quat(scalar_first=True)
    time, notes = sheet.counted(sheet.columns(*sheet.counters))
    return reference_of(sheet.path, time, q_nb, up=None, name=", ".join(notes))


# ---- dialects


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """How one maker's software writes a table of text."""

    head: bytes  # Pattern of the first 8 KiB of a file
    folder: str = ""  # Which file of a folder is read: its name, or "*" and its ending
    maker: str = ""  # Whose manual states the units
    units: Mapping[str, str] = field(default_factory=dict)  # By the manual, of channels whose columns state none
    device: str = ""  # Pattern in the lines before the header, whose group is the serial number
    rate: str = ""  # Likewise the sample rate, Hz
    omit: str = ""  # Pattern of columns that are not readings of a sensor
    sensor: tuple[str, str] = ("", "")  # Pattern in a sensor's name, and what takes its place
    opposite: bool = False  # Acceleration is the opposite of specific force
    repair_time: bool = False  # Stamps may repeat: such rows are left out and counted
    header: bool = True  # False where what stands over the readings is no line of names
    finish: tuple[Callable[[Sheet, ReadSettings], Sheet], ...] = ()  # What the keys above do not say
    # Name and unit of each channel, {} for X, Y and Z, where columns are fixed. They stand after so many lines; temperature, degC,
    # may have a file of its own: its name, its columns of time (or packets, as in the table) and of temperature
    columns: Mapping[str, tuple[str, str]] | None = None
    skip_rows: int = 0
    thermometer: tuple[str, str, str] | None = None
    poses: Callable[[Path, ReferenceMap | None], Reference] | None = None  # Who reads a table of orientations

    def read(self, path: Path, _: ColumnMap | None = None, settings: ReadSettings = READ_SETTINGS) -> ReadResult:
        """Read a file, or a folder, of this dialect."""
        if self.columns is not None:
            return ReadResult(record=self._by_columns(self._file(path), settings))
        return read_sheet(self._labelled(open_sheet(self._file(path), header=self.header), settings), settings)

    def _file(self, path: Path) -> Path:
        if not path.is_dir():
            return path
        files = sorted(path.glob(self.folder))
        if not files:
            raise InputError(f"{path}: wanted a folder with {self.folder}, got none there; check the path")
        if len(files) > 1:
            names = ", ".join(file.name for file in files)
            raise InputError(f"{path}: wanted one {self.folder}, got {names}; name the file")
        return files[0]

    def _labelled(self, sheet: Sheet, settings: ReadSettings) -> Sheet:
        """Return a sheet with its labels, clock, device and notes."""
        stated = sheet.stated(self.rate) if self.rate else None
        device = (sheet.stated(self.device) or "").strip(", ") if self.device else ""
        sheet = replace(sheet, device=device, rate_hz=float(stated) if stated else None, repair_time=self.repair_time)
        sheet = with_manual(sheet, self.maker, self.units)
        labels: list[Label | None] = []
        for name, label in zip(sheet.names, sheet.labels, strict=True):
            if label and not (self.omit and re.search(self.omit, name)):
                turned = self.opposite and label.channel == "accel"
                sensor = re.sub(*self.sensor, label.sensor) if self.sensor[0] else label.sensor
                labels.append(label._replace(sensor=sensor, gain=-label.gain if turned else label.gain))
            else:
                labels.append(None)
        sheet = replace(sheet, labels=tuple(labels), notes=(*sheet.notes, *([_OPPOSITE] if self.opposite else [])))
        for finish in self.finish:
            sheet = finish(sheet, settings)
        return sheet

    def _by_columns(self, path: Path, settings: ReadSettings) -> Record:
        """Return the record of fixed columns, with the temperature of a file of its own where there is one."""
        text = open_text(path, TextLayout(skip_rows=self.skip_rows))
        preamble = "\n".join(line.decode("utf-8", "replace") for line in text.head.splitlines()[: self.skip_rows])
        rate, device = (re.search(pattern, preamble) if pattern else None for pattern in (self.rate, self.device))
        keys: dict[str, Any] = {"device": device.group(1) if device else ""}
        for channel, (name, unit) in (self.columns or {}).items():
            three = tuple(name.format(axis) for axis in "XYZ")
            keys |= {channel: three if "{}" in name else name, f"{channel}_unit": unit}
        keys["sample_rate_hz"] = float(rate.group(1)) if rate else None if "time" in keys else settings.sample_rate_hz
        if "time" not in keys and keys["sample_rate_hz"] is None:
            raise InputError(
                f"{path}: wanted the sample rate of this {self.maker} recording, got none; give `sample_rate_hz`"
            )
        columns = ColumnMap(**keys)
        missing = [column for column in columns.wanted() if column not in text.names]
        if missing:
            raise FileFormatError(
                f"{path}: wanted column {missing[0]!r}, got {', '.join(text.names[:12])}; not the expected format of {self.maker}"
            )
        record = build_record(parse_text(text, columns.numeric()), columns).record
        if self.thermometer is None:
            return record
        name, clock, temp = self.thermometer
        slow = path.with_name(name.replace("*", path.name.removesuffix(self.folder.removeprefix("*"))))
        if not slow.is_file():
            return record
        table = parse_text(open_text(slow), (clock, temp))
        time = table.numbers(clock)
        if clock == columns.time:
            time = time * si_factor(columns.time_unit, "time")
        else:  # numbers of packets: their times are those of the samples
            time = np.interp(time, parse_text(text, (clock,)).numbers(clock), record.time)
        return _with_temp(record, time, table.numbers(temp))


_XIO = {"gyro": ("Gyroscope {} (deg/s)", "dps"), "accel": ("Accelerometer {} (g)", "g")}
DIALECTS: dict[str, Dialect] = {
    "actigraph": Dialect(  # its temperature is the chip's: 20 to 30 degC above the room
        head=rb"\A.*Data File Created By ActiGraph",
        maker="ActiGraph",
        rate=r"\A.*?at (\d+(?:\.\d+)?) Hz",
        device=r"Serial Number: *([A-Za-z0-9-]+)",
        skip_rows=10,
        columns={
            "time": ("Timestamp", "date"),
            "gyro": ("Gyroscope {}", "dps"),
            "accel": ("Accelerometer {}", "g"),
            "mag": ("Magnetometer {}", "uT"),
            "temp": ("Temperature", "degC"),
        },
    ),
    "ngimu": Dialect(
        head=rb"\ATime \(s\).*Gyroscope X \(deg/s\)",
        folder="sensors.csv",
        maker="NGIMU",
        columns=_XIO | {"time": ("Time (s)", "s"), "mag": ("Magnetometer {} (uT)", "uT")},
        thermometer=("temperature.csv", "Time (s)", "Gyroscope And Accelerometer (degC)"),
        poses=read_text_poses,
    ),
    "ximu3": Dialect(  # its magnetometer has no unit
        head=rb"\ATimestamp \(us\).*Gyroscope X \(deg/s\)",
        folder="Inertial.csv",
        maker="x-IMU3",
        columns=_XIO | {"time": ("Timestamp (us)", "us")},
        thermometer=("Temperature.csv", "Timestamp (us)", "Temperature (degC)"),
        poses=read_text_poses,
    ),
    "ximu": Dialect(
        head=rb"\APacket number.*Gyroscope X \(deg/s\)",
        folder="*_CalInertialAndMag.csv",
        maker="x-IMU",
        columns=_XIO | {"mag": ("Magnetometer {} (G)", "gauss")},
        thermometer=("*_CalBattAndTherm.csv", "Packet number", "Thermometer (degrees C)"),
    ),
    "xsens": Dialect(
        head=rb"\A(\xef\xbb\xbf)?//[\s\S]*^(Packet)?Counter[\t,; ]",
        maker="Xsens",
        units=_SI,
        device=r"^// *DeviceId: *(\w+)",
        finish=(_xsens_clock, _with_readings),
        # its rate must stand in the file, or in the map
        poses=lambda path, columns: _xsens(
            _xsens_clock(open_sheet(path), ReadSettings(sample_rate_hz=columns.sample_rate_hz if columns else None))
        ),
    ),
    "dot": Dialect(
        head=rb"\A(\xef\xbb\xbf)?sep=[\s\S]*^PacketCounter,",
        maker="Movella DOT",
        units={"gyro": "dps", "accel": "m/s2"},
        device=r"^DeviceTag:, *(.*)$",
        finish=(_dot_clock, _with_readings),
        poses=lambda path, _: _xsens(_dot_clock(open_sheet(path))),
    ),
    "shimmer": Dialect(  # stamps of Consensys are whole ms
        head=rb"\A.*\n?.*Timestamp_\w*(CAL|RAW)\b.*(Accel|Gyro)_\w*(CAL|RAW)\b", repair_time=True
    ),
    "trigno": Dialect(head=rb"\ALabel: .*Sampling frequency:", finish=(_trigno_labels,)),
    "trigno_discover": Dialect(head=rb"\AApplication:.*Trigno", header=False, finish=(_trigno_discover_labels,)),
    "noraxon": Dialect(  # "RT Hand" and "Hand RT" are one sensor
        head=rb"Accel Sensor [XYZ]|Noraxon MyoMotion-",
        maker="Noraxon",
        units={"time": "s"},
        omit=r"(?i)segments-.*-acceleration",
        sensor=(r"^([LR]T) (.+)", r"\2 \1"),
    ),
    "sensor_logger": Dialect(head=rb"\Atime,seconds_elapsed,", finish=(_sensor_logger_labels,)),
    "sensorlog": Dialect(
        head=rb"accelerometerAcceleration[XYZ]\(G\)|gyroRotation[XYZ]\(rad/s\)", opposite=True, finish=(_one_gyroscope,)
    ),
    "physics_toolbox": Dialect(  # the g-force meter holds gravity, the linear accelerometer does not; time in s or of the day
        head=rb"\A\s*time[,;](gFx[,;]gFy|ax[,;]ay[,;]az[,;](aT|wx|gFx))",
        maker="Physics Toolbox",
        units={"time": "s", "accel": "g", "gyro": "rad/s", "mag": "uT"},
        finish=(_without_linear, _signed_by_rests),
    ),
    "science_journal": Dialect(
        head=rb"\A(relative_time|timestamp),.*\bAcc[XYZ]\b",
        maker="Arduino Science Journal",
        units={"time": "ms", "accel": "m/s2", "gyro": "dps"},
        finish=(_signed_by_rests,),
    ),
    "matlab_mobile": Dialect(  # timetables that writetimetable writes; the file's name says which
        head=rb"\ATimestamp,X,Y,Z\r?\n", maker="MATLAB Mobile", finish=(_matlab_labels, _signed_by_rests)
    ),
    "mobgap": Dialect(
        head=rb"\Asamples,acc_x,acc_y,acc_z,gyr_x",
        maker="mobgap",
        units={"accel": "g", "gyro": "dps"},
        finish=(_in_g, _numbered),
    ),
    "apdm7": Dialect(head=rb"\AFormat=7,", finish=(_apdm7_labels,)),
}
