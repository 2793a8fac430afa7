"""Text exports of makers: what a row of :mod:`undrift.io.dialects` cannot say, mostly over :mod:`undrift.io.labelled`.

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
BIDS-motion   *_motion.tsv without header; *_channels.tsv and *_motion.json beside it
OpenSim       .sto: cells "w,x,y,z", a column for each sensor
QTM           TSV: markers (3D), or bodies (6D) with Rot[0..8] column by column; mm
set-points    "BIN_DATA: 5, -10.1, 21652, ...": columns without names, read through a map by position

A file of poses may hold several bodies, of which one is named. Quaternions are scalar first and turn the body to the
laboratory; a lost body is zeros, NaN or empty cells. Temperature that comes in a file of its own, at its own rate, is
interpolated onto the samples and held at the ends.
"""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import read_bytes
from undrift.frames import quaternion_product
from undrift.io.columns import (
    AXES,
    READ_SETTINGS,
    ColumnMap,
    ReadResult,
    ReadSettings,
    TempFile,
    TextLayout,
    build_record,
    in_seconds,
    is_number,
)
from undrift.io.containers import chosen
from undrift.io.labelled import (
    Label,
    Sheet,
    as_utf8,
    label_of,
    labelled,
    open_sheet,
    read_sheet,
    unit_for,
)
from undrift.io.mocap import Markers, Up, level_from, markers_of
from undrift.io.reference import ReferenceMap
from undrift.io.text import Text, open_text, parse_text
from undrift.record import Record, Reference
from undrift.units import canonical_unit, si_factor, temp_offset

SI = {"gyro": "rad/s", "accel": "m/s2", "temp": "degC"}
_HALF = 2.0**-0.5
_FROM_Y_UP = np.array([_HALF, _HALF, 0.0, 0.0])  # z up from y up, as level_from turns points
_NEARLY_UNIT = 0.01
OPPOSITE = "acceleration multiplied by -1: iOS reads -1 g along an axis that points up"
_NO_SIGN = "sign of acceleration not stated by the file (iOS and Android differ); rests and turns decide"

# ---- Xsens MT and Movella DOT: packets that may be lost


def xsens_clock(sheet: Sheet, settings: ReadSettings) -> Sheet:
    """Return an MT Manager export with its clock: the packet counter at the stated rate, so that lost packets are gaps."""
    counter = sheet.position(r"^(Packet)?Counter$")
    stated = sheet.stated(r"^// *(?:Update|Sample) rate: *(\d+(?:\.\d+)?) *Hz")
    rate = settings.sample_rate_hz or (float(stated) if stated else None)
    in_name = (re.findall(r"_(00[0-9A-F]{6})\b", sheet.path.name) or [""])[-1]
    sheet = replace(sheet, rate_hz=rate, device=sheet.device or in_name)
    fine = sheet.position(r"^SampleTimeFine$")
    if rate is None and fine is not None and np.isfinite(sheet.array((fine,))).all():

        def ticks(stamps: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
            return 1e-4 * _unwrapped(stamps, 1 << 32), ("time from SampleTimeFine, 10 kHz by the manual of Xsens",)

        return replace(sheet, clock=ticks, counters=(fine,))
    if counter is None or rate is None:
        return sheet
    step_s = 1.0 / rate

    def clock(counts: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        packets = _unwrapped(counts, 1 << 16)
        return packets * step_s, _lost(packets)

    return replace(sheet, clock=clock, counters=(counter,))


def dot_clock(sheet: Sheet, _: ReadSettings = READ_SETTINGS) -> Sheet:
    """Return a DOT export with its clock, SampleTimeFine."""
    fine, counter = sheet.position(r"^SampleTimeFine$"), sheet.position(r"^PacketCounter$")
    if fine is None or counter is None:
        raise FileFormatError(
            f"{sheet.path}: wanted the columns PacketCounter and SampleTimeFine, got {', '.join(sheet.names[:8])}; export "
            "them too"
        )

    def clock(stamps: FloatArray, packets: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        return 1e-6 * (stamps[0] + _unwrapped(stamps, 1 << 32)), _lost(_unwrapped(packets, 1 << 32))

    return replace(sheet, clock=clock, counters=(fine, counter))


def _unwrapped(counts: FloatArray, size: int) -> FloatArray:
    """Return a counter from 0 on, with its overflows undone."""
    return np.concatenate(([0.0], np.cumsum(np.mod(np.diff(counts), size))))


def _lost(packets: FloatArray) -> tuple[str, ...]:
    lost = int(packets[-1]) + 1 - len(packets) if len(packets) else 0
    return (
        (f"{lost} of {int(packets[-1]) + 1} packets lost by PacketCounter, seen as gaps in time",) if lost > 0 else ()
    )


def with_readings(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Refuse an export of orientations only, which is a reference."""
    if any(label and label.channel in ("gyro", "accel", "free") for label in sheet.labels):
        return sheet
    raise FileFormatError(
        f"{sheet.path}: wanted Acc_X or Gyr_X columns, got orientations only; read the file as a reference (--reference)",
        missing="readings",
    )


# ---- Sensor Logger, SensorLog, mobgap


def sensor_logger_labels(sheet: Sheet, _: ReadSettings = READ_SETTINGS) -> Sheet:
    """Label one sensor of the Sensor Logger app, as specific force: iOS writes its opposite unless frames are standardised."""
    path, stem = sheet.path, sheet.path.name.split(".")[0]
    kind = "Linear acceleration" if stem == "Accelerometer" else stem
    names = tuple(f"{kind} {name}" if name in AXES else name for name in sheet.names)
    names = tuple(re.sub("^acceleration(?=[XYZ]$)", "Linear acceleration", name) for name in names)  # watch, headphones
    labels = [label_of(name, "s" if name == "seconds_elapsed" else "", SI) for name in names]
    labels = [None if name == "time" else label for name, label in zip(names, labels, strict=True)]
    notes = ["units by the manual of Sensor Logger, not in the file: accel m/s2, gyro rad/s"]
    in_g, apple = False, _of_ios(path.with_name("Metadata.csv"))
    if stem.startswith("AccelerometerUncalibrated") and (size := _median_size(sheet, names)) is not None:
        in_g = size < 3.0
        if in_g:
            notes = [f"acceleration in g: its median is {size:.3g}; iOS writes this file in g, Android in m/s2"]
        if apple is not None and apple != in_g:
            raise FileFormatError(
                f"{path}: wanted {'g' if apple else 'm/s2'} by platform and standardisation in Metadata.csv, got a median of "
                f"{size:.3g}; the two do not belong together: leave Metadata.csv out"
            )
        apple = in_g
    if any(label and label.channel == "accel" for label in labels):
        notes += [_NO_SIGN] if apple is None else [OPPOSITE] if apple else []
    labels = [
        x._replace(gain=-x.gain if apple else x.gain, unit="g" if in_g else x.unit) if x and x.channel == "accel" else x
        for x in labels
    ]
    return replace(sheet, names=names, labels=tuple(labels), notes=tuple(notes))


def _of_ios(path: Path) -> bool | None:
    """Tell by Metadata.csv whether Sensor Logger kept the signs and units of iOS; None where it does not say."""
    lines = as_utf8(read_bytes(path)).decode().splitlines() if path.is_file() and path.stat().st_size else []
    stated = {key: str(cell).strip().lower() for key, cell in next(csv.DictReader(lines), {}).items()}
    android, ios = (stated.get("platform", "").startswith(name) for name in ("android", "ios"))
    return ios and stated.get("standardisation") != "true" if android or ios else None


def one_gyroscope(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Leave the fused one of two gyroscopes of SensorLog out: the raw one is read."""
    fused = "motionRotationRate" if sheet.position("^gyroRotation") is not None else None
    return replace(sheet, labels=tuple(None if x and x.sensor == fused else x for x in sheet.labels))


def _median_size(sheet: Sheet, names: tuple[str, ...]) -> float | None:
    columns = [k for k, name in enumerate(names) if name[-2:] in (" x", " y", " z")]
    return float(np.nanmedian(np.linalg.norm(sheet.array(columns), axis=1))) if len(columns) == 3 else None


def in_g(sheet: Sheet, _: ReadSettings) -> Sheet:
    """Refuse a mobgap example whose accelerations are not in g, as its manual has them."""
    size = _median_size(sheet, tuple(re.sub(r"^acc_", "acc ", name) for name in sheet.names))
    if size is None or not 0.5 < size < 2.0:
        raise InputError(
            f"{sheet.path}: wanted accelerations in g (median near 1), got a median of {size or 0.0:.3g}; give the units in a map "
            "(--map FILE)"
        )
    return sheet


# ---- the folder of a phone: a file for each sensor, all on one clock

_PHONE_GYRO = ("Gyroscope.csv", "GyroscopeUncalibrated.csv")
_PHONE_ACCEL = ("TotalAcceleration.csv", "AccelerometerUncalibrated.csv", "Accelerometer.csv")


def is_phone(path: Path) -> bool:
    """Tell a folder of Sensor Logger or phyphox."""
    return all(any((path / name).is_file() for name in names) for names in (_PHONE_GYRO, _PHONE_ACCEL))


def read_phone(path: Path, _: ColumnMap | None, settings: ReadSettings) -> ReadResult:
    """Read gyroscope and accelerometer of a phone; the latter is interpolated onto the time stamps of the former."""

    def one(names: tuple[str, ...]) -> tuple[str, ReadResult]:
        name = next(name for name in names if (path / name).is_file())
        sheet = open_sheet(path / name)
        labels = sensor_logger_labels if sheet.names[:2] == ("time", "seconds_elapsed") else labelled
        return name, read_sheet(labels(sheet), settings)

    (name, found), notes = one(_PHONE_GYRO), list[str]()
    try:
        other, held = one(_PHONE_ACCEL)
    except FileFormatError as error:  # without gravity: it is left out
        return replace(found, notes=(*found.notes, str(error).removeprefix(f"{path}/")))
    gyro, accel = found.record, held.record
    if accel.accel is None or gyro.gyro is None:
        raise FileFormatError(f"{path}: wanted a gyroscope in {name} and an accelerometer in {other}, got others")
    inside = np.flatnonzero((gyro.time >= accel.time[0]) & (gyro.time <= accel.time[-1]))
    if len(inside) < 2:
        raise FileFormatError(
            f"{path}: wanted {name} and {other} of the same time, got two times apart; read one of them"
        )
    part = gyro.part(int(inside[0]), int(inside[-1]) + 1)
    values = np.stack([np.interp(part.time, accel.time, column) for column in accel.accel.T], axis=1)
    notes = [f"{other} interpolated onto the time stamps of {name}"]
    record = replace(part, accel=values, accel_unit=accel.accel_unit)
    return replace(found, record=record, notes=tuple(dict.fromkeys((*found.notes, *held.notes, *notes))))


# ---- Delsys Trigno


def trigno_labels(sheet: Sheet, _: ReadSettings) -> Sheet:
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


def trigno_discover_labels(sheet: Sheet, _: ReadSettings) -> Sheet:
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
        if all(name in text.names for name in names):
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


def apdm7_labels(sheet: Sheet, _: ReadSettings) -> Sheet:
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
    for k in range(1, len(sheet.names)):
        if k in starts and starts.index(k) < len(tags):
            sensor = tags[starts.index(k)]
        kind = second[k] if k < len(second) and second[k] else kind
        channel, axis = kinds.get(kind), sheet.names[k].lower()
        labels.append(Label(sensor, channel, axis, *manual[channel]) if channel and axis in AXES else None)
    note = "units by the manual of APDM, not in the file: accel m/s2, gyro rad/s, mag uT"
    return replace(sheet, labels=tuple(labels), preamble=(), notes=(note,))


# ---- a thermometer of its own


def with_temp(record: Record, time: FloatArray, temp_c: FloatArray) -> Record:
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
    try:
        return with_temp(record, time, temp_c)
    except InputError as error:
        raise InputError(f"{thermometer.path}: {error}") from error


# ---- BIDS-motion


def read_bids_motion(path: Path, _: ColumnMap | None, settings: ReadSettings) -> ReadResult:
    """Read one tracked point of a BIDS-motion recording."""
    sheet, channels = _bids(path)
    kinds = {"ACCEL": "accel", "GYRO": "gyro", "MAGN": "mag", "LATENCY": "time"}
    labels: list[Label | None] = []
    for row in channels:
        channel, unit = kinds.get(row.get("type", "").upper()), row.get("units", "")
        known = unit_for(unit, channel) if channel else None
        axis = row.get("component", "").lower() if channel != "time" else ""
        point = row.get("tracked_point", "").replace("n/a", "")
        labels.append(Label(point, channel, axis, *known) if channel and known else None)
    return read_sheet(replace(sheet, labels=tuple(labels)), settings)


def read_bids_positions(path: Path, up: Up | None = None) -> Markers:
    """Read the positions of a BIDS-motion recording as markers."""
    sheet, channels = _bids(path)
    places: dict[str, dict[str, int]] = {}
    for k, row in enumerate(channels):
        if row.get("type", "").upper() == "POS":
            places.setdefault(row.get("tracked_point", ""), {})[row.get("component", "").lower()] = k
    whole = {name: [axes[axis] for axis in AXES] for name, axes in places.items() if set(axes) >= set(AXES)}
    if not whole or sheet.rate_hz is None:
        raise FileFormatError(
            f"{path}: wanted POS channels x, y, z and SamplingFrequency, got none; check the sidecars"
        )
    points = np.stack([sheet.array(columns) for columns in whole.values()], axis=1)
    unit = channels[next(iter(whole.values()))[0]].get("units", "")
    time = np.arange(len(points)) / sheet.rate_hz
    return markers_of(path, tuple(whole), points * si_factor(unit, "length"), time, up=up)


def is_bids(path: Path, *, positions: bool) -> bool:
    """Tell a BIDS-motion table by its name and sidecar: one of positions, or one with inertial sensors."""
    sidecar = _sidecar(path, "_channels.tsv")
    if re.search(r"_motion\.tsv(\.gz)?$", path.name) is None:
        return False
    inertial = sidecar.is_file() and re.search(rb"\t(ACCEL|GYRO)\t", read_bytes(sidecar), re.IGNORECASE) is not None
    return inertial is not positions


def _sidecar(path: Path, ending: str) -> Path:
    return path.with_name(re.sub(r"_motion\.tsv(\.gz)?$", ending, path.name))


def _bids(path: Path) -> tuple[Sheet, list[dict[str, str]]]:
    channels, settings = _sidecar(path, "_channels.tsv"), _sidecar(path, "_motion.json")
    for sidecar in (channels, settings):
        if not sidecar.is_file():
            raise FileFormatError(f"{path}: wanted {sidecar.name} beside it, got none; copy the sidecars too")
    lines = [line.split("\t") for line in as_utf8(read_bytes(channels)).decode().splitlines() if line.strip()]
    rows = [dict(zip(lines[0], (cell.strip() for cell in line), strict=False)) for line in lines[1:]]
    try:
        rate = float(json.loads(read_bytes(settings))["SamplingFrequency"])
    except (ValueError, KeyError, TypeError) as error:
        raise FileFormatError(f"{settings}: wanted SamplingFrequency in Hz, got none; add it") from error
    names = tuple(row.get("name", "") for row in rows)
    content = as_utf8(read_bytes(path))
    width = content.split(b"\n", 1)[0].count(b"\t") + 1
    if width != len(names):
        raise FileFormatError(
            f"{path}: wanted {len(names)} columns as in {channels.name}, got {width}; the two do not belong together"
        )
    layout = TextLayout(delimiter="\t", header=False)
    return Sheet(path=path, names=names, layout=layout, rows=content, rate_hz=rate), rows


# ---- a log of set-points: "BIN_DATA: 5, -10.1, 21652, 0.13, ..."

_SET_POINT = re.compile(rb"^[ \t]*([A-Za-z_]\w*):[ \t]*(?=[-+.\d,]|nan)(.*?)[ \t,]*\r?$", re.MULTILINE | re.IGNORECASE)


def is_set_points(head: bytes) -> bool:
    """Tell whether most lines are one word, a colon and numbers."""
    lines = [line for line in head.splitlines()[:64] if line.strip()]
    rows = [(m.group(1), m.group(2)) for line in lines if (m := _SET_POINT.match(line))]
    numbers = [row for _, row in rows if row.count(b",") >= 2 and re.fullmatch(rb"[-+.\deE, \tnaNA]*", row)]
    return (
        b"\0" not in head and len(numbers) >= 2 and len(numbers) > 0.5 * len(lines) and len({w for w, _ in rows}) == 1
    )


def read_set_points(path: Path, columns: ColumnMap | None, settings: ReadSettings) -> ReadResult:
    """Read a log of set-points, whose columns have no names, through a map by position."""
    lines = [line for line in as_utf8(read_bytes(path)).splitlines() if line.strip()]
    hits = [m.groups() if (m := _SET_POINT.match(line)) else (b"", b"") for line in lines]
    word = next(word for word, _ in hits if word)
    found = [row for own, row in hits if own == word]
    width = found[0].count(b",") + 1
    spoilt = [
        line
        for line, (own, _) in zip(lines, hits, strict=True)
        if own != word and word + b":" in line and line.count(b",") >= width - 1
    ]
    if spoilt and not settings.drop_bad_rows and not (columns and columns.layout.drop_bad_rows):
        shown = spoilt[0][:40].decode("utf-8", "replace")
        raise FileFormatError(
            f"{path}: wanted numbers alone in every line of {word.decode()}, got {len(spoilt)} with other text, the first "
            f"{shown!r}; repair them, or set drop_bad_rows = true in a map (--map FILE)"
        )
    if columns is None:
        raise InputError(
            f"{path}: wanted a map of its {width} columns by position (from 0, after the colon), got none; for example columns = "
            "{ temp = 1, gyro = [3, 4, 5] } with units and sample_rate_hz (--map FILE)",
            missing="columns",
            example=(
                "columns = { temp = 1, gyro = [3, 4, 5] }",
                'units = { temp = "?", gyro = "?" }',
                "sample_rate_hz = ?",
            ),
        )
    layout = replace(columns.layout, header=False, skip_rows=0, delimiter=",")
    names = tuple(str(k) for k in range(width))
    sheet = Sheet(path=path, names=names, layout=layout, rows=b"\n".join(found) + b"\n")
    table = sheet.columns(
        *(int(k) for k in columns.wanted()), drop_bad_rows=layout.drop_bad_rows or settings.drop_bad_rows
    )
    other = len(lines) - len(found) - len(spoilt)
    notes = (f"{other} lines without readings skipped",) if other else ()
    made = build_record(table, columns)
    return replace(made, notes=notes, dropped_rows=made.dropped_rows + len(spoilt))


# ---- poses of bodies


def name_of(path: Path, names: tuple[str, ...], name: str | None) -> str:
    """Return the body to read: the only one, or the one named."""
    if name is None and len(names) == 1:
        return names[0]
    if name not in names:
        got = "none" if name is None else repr(name)
        raise InputError(
            f"{path}: wanted the name of one body, got {got}; the file holds {', '.join(names)}: name one (--markers)",
            names=names,
        )
    return name


def _table(path: Path, rows: bytes, width: int) -> FloatArray:
    """Return rows of tab-separated numbers, (N, width)."""
    layout, names = TextLayout(delimiter="\t", header=False), tuple(str(k) for k in range(width))
    sheet = Sheet(path=path, names=names, layout=layout, rows=rows)
    values = sheet.array(range(width)) if rows.strip() else np.empty((0, width))  # type: ignore[arg-type]
    if len(values) < 2:
        raise FileFormatError(f"{path}: wanted two frames or more, got {len(values)}; the file is cut")
    return values


def _reference(
    path: Path, time: FloatArray, q_nb: FloatArray, *, position: FloatArray | None = None, up: Up | None, name: str
) -> Reference:
    """Return poses in the level frame, lost frames as gaps, time from 0."""
    size = np.linalg.norm(q_nb, axis=1)
    seen = np.abs(size - 1.0) < _NEARLY_UNIT
    if np.isfinite(size).any() and not seen.any():
        raise FileFormatError(f"{path}: wanted unit quaternions, got length {np.nanmedian(size):.3g}; check the export")
    q_nb = np.where(seen[:, None], q_nb / np.where(seen, size, 1.0)[:, None], np.nan)
    try:
        return Reference(
            time=time,
            q_nb=quaternion_product(_FROM_Y_UP, q_nb) if up == "y" else q_nb,
            position=None if position is None else np.where(seen[:, None], level_from(position, up or "z"), np.nan),
            name=f"{path.name} {name}".strip(),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


# ---- OpenSim


def read_sto(path: Path, name: str | None = None, up: Up | None = None) -> Reference:
    """Read one sensor of an OpenSense table: "endheader", names, then cells "w,x,y,z"; z is up unless stated."""
    _, _, body = as_utf8(read_bytes(path)).replace(b"\r\n", b"\n").partition(b"endheader")
    header, _, rows = body.lstrip(b" \t\n").partition(b"\n")
    names = tuple(cell.strip() for cell in header.decode("utf-8", "replace").split("\t") if cell.strip())
    if len(names) < 2 or names[0].lower() != "time":
        raise FileFormatError(
            f"{path}: wanted 'time' and sensor names after endheader, got {header[:40]!r}; check the export"
        )
    chosen = 1 + 4 * names[1:].index(name_of(path, names[1:], name))
    values = _table(path, rows.replace(b",", b"\t"), 4 * len(names) - 3)
    return _reference(path, values[:, 0], values[:, chosen : chosen + 4], up=up, name=names[1 + chosen // 4])


# ---- QTM


def read_qtm_markers(path: Path, up: Up | None = None) -> Markers:
    """Read marker trajectories from a QTM TSV file of 3D data, mm; 0, 0, 0 is a lost marker."""
    labels, values, rate = _qtm(path, "MARKER_NAMES", 3)
    points = values.reshape(len(values), len(labels), 3) * 1e-3
    points[(points == 0.0).all(axis=2) | np.isnan(points).any(axis=2)] = np.nan
    return markers_of(path, labels, points, np.arange(len(points)) / rate, up=up, why="QTM")


def read_qtm_bodies(path: Path, name: str | None = None, up: Up | None = None) -> Reference:
    """Read one rigid body of a QTM TSV file of 6D data: mm, Rot[0..8] column by column; z is up unless stated."""
    from scipy.spatial.transform import Rotation

    labels, values, rate = _qtm(path, "BODY_NAMES", 16)
    block = values.reshape(len(values), len(labels), 16)[:, labels.index(name_of(path, labels, name))]
    turn = block[:, 7:].reshape(-1, 3, 3).transpose(0, 2, 1)
    seen = np.abs(np.linalg.det(np.nan_to_num(turn)) - 1.0) < _NEARLY_UNIT
    if not seen.any():
        raise FileFormatError(f"{path}: wanted rotation matrices Rot[0..8], got none; export 6D data with the matrix")
    q_nb = np.full((len(values), 4), np.nan)
    q_nb[seen] = Rotation.from_matrix(turn[seen]).as_quat(scalar_first=True)
    position = np.where(seen[:, None], block[:, :3] * 1e-3, np.nan)
    time = np.arange(len(values)) / rate
    return _reference(path, time, q_nb, position=position, up=up, name=name_of(path, labels, name))


def _qtm(path: Path, key: str, each: int) -> tuple[tuple[str, ...], FloatArray, float]:
    """Return names, the blocks of all names without frame, time and gap columns, and the frame rate."""
    lines = as_utf8(read_bytes(path)).decode().splitlines()
    head: dict[str, str] = {}
    start = next((k for k, line in enumerate(lines) if not re.match(r"[A-Z_]{4,}(\s|$)", line)), len(lines))
    for line in lines[:start]:
        head[line.split("\t")[0]] = line.partition("\t")[2]
    names = tuple(cell.strip() for cell in head.get(key, "").split("\t") if cell.strip())
    rate = head.get("FREQUENCY", "").strip()
    if not names or not is_number(rate) or not rate:
        raise FileFormatError(
            f"{path}: wanted {key} and FREQUENCY in Hz in the header, got none; export the TSV header too"
        )
    headed = ""
    if start < len(lines) and not all(
        is_number(cell) or cell.strip() in ("", "NULL", "-") for cell in lines[start].split("\t")
    ):
        headed, start = lines[start], start + 1  # a line of column names
    rows = [re.sub(r"\t+$", "", line) for line in lines[start:] if line.strip()]
    width = max((row.count("\t") + 1 for row in rows), default=0)
    bare = len(names) * each
    fits = [gap for gap in (0, 1) if width - bare - (len(names) - 1) * gap in (0, 2)]  # frame and time may stand before
    if not fits:
        raise FileFormatError(
            f"{path}: wanted {each} columns for each of {len(names)} names, got {width} in all; check the export"
        )
    gap = fits[0]
    if len(fits) > 1 and not headed.startswith("Frame"):  # of three names the two gaps are as wide as frame and time
        gap = int(not any(cell.strip() for row in rows for cell in row.split("\t")[each : width : each + 1]))
    bare += (len(names) - 1) * gap
    padded = "".join(f"{row}{chr(9) * (width - row.count(chr(9)) - 1)}\n" for row in rows).encode()
    first = width - bare
    keep = [first + k * (each + gap) + j for k in range(len(names)) for j in range(each)]
    return names, _table(path, padded, width)[:, keep], float(rate)


# ---- Xsens


def read_xsens_poses(path: Path, columns: ReferenceMap | None = None) -> Reference:
    """Read the orientations of an MT Manager export; its rate must stand in the file, or in the map."""
    settings = replace(READ_SETTINGS, sample_rate_hz=None if columns is None else columns.sample_rate_hz)
    return _xsens(xsens_clock(open_sheet(path), settings))


def read_dot_poses(path: Path, _: ReferenceMap | None = None) -> Reference:
    """Read the orientations of a DOT export."""
    return _xsens(dot_clock(open_sheet(path)))


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
        if len(held) == 9 and (np.abs(np.linalg.det(values[seen].reshape(-1, 3, 3)) - 1.0) > _NEARLY_UNIT).any():
            raise FileFormatError(
                f"{sheet.path}: wanted rotation matrices in Mat, got others; export orientations again"
            )
        turn = Rotation.from_matrix(values[seen].reshape(-1, 3, 3)) if len(held) == 9 else None
        turn = turn or Rotation.from_euler("ZYX", values[seen], degrees=True)
        q_nb[seen] = turn.as_quat(scalar_first=True)
    time, notes = sheet.counted(sheet.columns(*sheet.counters))
    return _reference(sheet.path, time, q_nb, up=None, name=", ".join(notes))
