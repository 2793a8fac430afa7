"""Binary recordings: XDF, ROS bags, PX4 ULog, NilsPod, Mobilise-D, Axivity, GENEActiv, GT3X. ``sensor`` names one of several.

XDF (LSL): clocks are synchronised by the file's clock offsets; time stamps stay as they were recorded, not de-jittered.
ROS: sensor_msgs/Imu by header.stamp, SI units (REP 103, REP 145); covariance[0] = -1 marks a channel that is absent.
PX4: sensor_gyro and sensor_accel are the sensors' own readings; sensor_combined is already corrected by the autopilot. The body
frame is forward-right-down, so that z reads -9.8 m/s2 level and at rest.
Wrist loggers, by their makers' documents:

    Axivity    accel = count / 2^(8 + n) g (packed: 1/256 g)      gyro = count / 32768 * 8000 / 2^n deg/s
               temp_c = raw * 75 / 256 - 50                       Open Movement, Docs/ax3/cwa.h
    GENEActiv  accel = (100 count - offset) / gain g              Activinsights, GENEActiv instructions, section 16.ii
    ActiGraph  accel = count / 341 g, or the scale of the file    github.com/actigraph: NHANES-GT3X-File-Format, GT3X-File-Format

Axivity's temperature is one raw value a sector; other programs convert it by other formulas, up to 9 degC apart, so the raw range
is stated with the formula. These clocks are local time without a zone: time starts at 0, and a note states the date.
A damaged block ends reading; with drop_bad_rows it is left out and counted.
"""

import contextlib
import io
import logging
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import BoolArray, FloatArray, IntArray, runs
from undrift.errors import FileFormatError, InputError
from undrift.files import first_line, read_bytes
from undrift.io.arrays import mat_arrays
from undrift.io.box import boxed, load, sound
from undrift.io.columns import AXES, ColumnMap, RawTable, ReadResult, ReadSettings, build_record
from undrift.io.labelled import EPOCH_S
from undrift.units import canonical_unit

Columns = ColumnMap | None
Channels = dict[str, tuple[Any, str]]


# ---- what these readers share


def chosen(path: Path, kind: str, names: tuple[str, ...], sensor: str | None) -> str:
    """Return the one that `sensor` names, by its whole name or an ending that only it has; the only one where none is named."""
    if not names:
        raise FileFormatError(f"{path}: wanted a {kind} with readings, got none; the file holds no recording")
    hits = names if sensor is None else [name for name in names if name == sensor]
    hits = hits or [name for name in names if name.endswith(f".{sensor}")]
    if len(hits) == 1:
        return hits[0]
    wanted = f"the name of one {kind}" if sensor is None else f"{kind} {sensor!r}"
    raise InputError(
        f"{path}: wanted {wanted}, got a file with {', '.join(names)}; name one of them (`sensor`)",
        missing="sensor",
        names=names,
    )


def build(
    path: Path,
    time: FloatArray,
    channels: Mapping[str, tuple[Any, str]],
    settings: ReadSettings,
    notes: Iterable[str] = (),
    **more: Any,
) -> ReadResult:
    """Return the record of named channels with their units, every value checked; a Unix clock is counted from its start."""
    notes, time = tuple(notes), np.asarray(time, dtype=np.float64)
    if len(time) and time[0] > EPOCH_S:
        notes, time = (f"time 0 is {time[0]:.3f} s of the file's clock (Unix time)", *notes), time - time[0]
    held, columns = {"time_s": time}, dict(more)
    for channel, (values, unit) in channels.items():
        names = (channel,) if np.ndim(values) == 1 else tuple(f"{channel} {axis}" for axis in AXES)
        held |= dict(zip(names, np.asarray(values, dtype=np.float64).reshape(len(time), -1).T, strict=True))
        columns |= {channel: names[0] if channel == "temp" else names, f"{channel}_unit": unit}
    columns |= {"gaps": settings.gaps or "raise", "repair_time": settings.repair_time}
    table = RawTable(source=str(path), names=tuple(held), columns=tuple(held.values()))
    return replace(build_record(table, ColumnMap(time="time_s", time_unit="s", **columns)), notes=notes)


# ---- XDF: chunks of streams, as LabRecorder writes them

_CHANNEL = {"gyro": r"gyr|angular.?(rate|vel)|^w$", "accel": r"acc", "mag": r"mag", "temp": r"temp"}
_QUANTITY = {"gyro": "rate", "accel": "accel", "mag": "mag", "temp": "temp"}


def _xdf(path: Path) -> dict[str, Any]:
    """Return the streams of an XDF file by name; a name that several have gets the stream's number."""
    pyxdf, lines = load("pyxdf", path), list[str]()
    logger, handler = logging.getLogger("pyxdf"), logging.Handler(logging.ERROR)
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    before = logger.propagate
    logger.propagate = False
    logger.addHandler(handler)
    try:
        with sound(path, "XDF"):
            _check_chunks(read_bytes(path))
            streams, _ = pyxdf.load_xdf(str(path), synchronize_clocks=True, dejitter_timestamps=False)
    finally:
        logger.removeHandler(handler)
        logger.propagate = before
    if lines:
        raise FileFormatError(
            f"{path}: wanted a sound XDF file, got a damaged one ({lines[0].splitlines()[0]}); copy it again"
        )
    names = [stream["info"]["name"][0] or "unnamed" for stream in streams]
    return {
        name if names.count(name) == 1 else f"{name}#{stream['info']['stream_id']}": stream
        for name, stream in zip(names, streams, strict=True)
    }


def _check_chunks(content: bytes) -> None:
    """Refuse a file whose last chunk is cut: the library reads it without a word."""
    at = 4
    while at < len(content):
        width = content[at]
        if width not in (1, 4, 8):
            raise ValueError(f"no length of a chunk at byte {at}")
        at += 1 + width + int.from_bytes(content[at + 1 : at + 1 + width], "little")
    if at != len(content):
        raise ValueError(f"the last chunk ends {at - len(content)} bytes behind the file")


def _has_numbers(stream: Any) -> bool:
    return isinstance(stream["time_series"], np.ndarray) and len(stream["time_stamps"]) > 0


@boxed("pyxdf")
def read_xdf(path: Path, columns: Columns, settings: ReadSettings) -> ReadResult:
    """Read one stream; without a map, by its channels' labels (or types) and units."""
    streams = _xdf(path)
    asked = streams.get(settings.sensor or "")
    if asked is not None and not _has_numbers(asked):
        what = "no samples" if len(asked["time_stamps"]) == 0 else "text"
        raise InputError(
            f"{path}: wanted a stream of readings, got {what} in {settings.sensor!r}; name another stream (`sensor`)"
        )
    name = chosen(path, "stream", tuple(n for n, s in streams.items() if _has_numbers(s)), settings.sensor)
    stream = streams[name]
    info, values = stream["info"], np.asarray(stream["time_series"], dtype=np.float64)
    described = [
        c for d in (info["desc"] or [None]) if d for cs in d.get("channels", []) if cs for c in cs.get("channel", [])
    ]
    if len(described) != values.shape[1]:
        described = [{}] * values.shape[1]
    label, kind, unit = ([(c.get(key) or [""])[0] or "" for c in described] for key in ("label", "type", "unit"))
    labels = [text or str(k) for k, text in enumerate(label)]
    time = np.asarray(stream["time_stamps"], dtype=np.float64)
    note = (
        f"stream {name}: clocks synchronised, time stamps as recorded (not de-jittered); stated rate "
        f"{float(info['nominal_srate'][0]):g} Hz"
    )
    if columns is not None:
        table = RawTable(source=str(path), names=(*labels, "time_s"), columns=(*values.T, time))
        return replace(build_record(table, columns), notes=(note,))
    found: Channels = {}
    for channel, pattern in _CHANNEL.items():
        at = [k for k in range(len(labels)) if re.search(pattern, f"{label[k]} {kind[k]}", re.IGNORECASE)]
        if len(at) == (1 if channel == "temp" else 3) and all(unit[k] == unit[at[0]] != "" for k in at):
            with contextlib.suppress(InputError):  # a unit that is not one: a map must state it
                stated = canonical_unit(unit[at[0]], _QUANTITY[channel])  # type: ignore[arg-type]
                found[channel] = (values[:, at[0]] if channel == "temp" else values[:, at], stated)
    if not found.keys() & {"gyro", "accel"}:
        shown = ", ".join(f"{a}{f' ({b})' if b else ''}" for a, b in zip(labels, unit, strict=True))
        raise InputError(
            f"{path}: wanted channels of {name} labelled as accelerometer or gyroscope with units, got {shown}; name them in a "
            'map (`column_map`), for example columns = { time = "time_s", gyro = [0, 1, 2] }, units = { time = "s", gyro = "dps" }',
            missing="columns",
            example=('columns = { time = "time_s", gyro = [0, 1, 2] }', 'units = { time = "s", gyro = "?" }'),
        )
    return build(path, time, found, settings, [note], device=name)


# ---- ROS 1 bag, ROS 2 db3 and MCAP, or the folder of a ROS 2 bag

_IMU, _TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"


@contextlib.contextmanager
def _bag(path: Path) -> Iterator[Any]:
    """Open a bag; message types that the file does not define are those of ROS 2."""
    stores, reader = load("rosbags.typesys", path), load("rosbags.highlevel", path).AnyReader
    with sound(path, "ROS bag"), reader([path], default_typestore=stores.get_typestore(stores.Stores.LATEST)) as held:
        yield held


@boxed("rosbags.highlevel")
def read_ros(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read one topic of sensor_msgs/Imu; a Temperature topic of the same parent goes with it."""
    with _bag(path) as bag:
        topics = sorted({c.topic for c in bag.connections if c.msgtype == _IMU and c.msgcount})
        topic = chosen(path, "topic", tuple(topics), settings.sensor)
        rows = list(_messages(bag, topic, _IMU))
        stated = sum(c.msgcount for c in bag.connections if c.topic == topic and c.msgtype == _IMU)
        if len(rows) < stated and not settings.drop_bad_rows:
            raise FileFormatError(
                f"{path}: wanted {stated} messages of {topic} as the file states, got {len(rows)}; copy the file again, or set "
                "drop_bad_rows = true in a map to read what is there"
            )
        parent = topic.rpartition("/")[0]
        near = {c.topic for c in bag.connections if c.msgtype == _TEMPERATURE and c.topic.rpartition("/")[0] == parent}
        slow = sorted(
            (_stamp(m), m.temperature) for t in near if len(near) == 1 for m in _messages(bag, t, _TEMPERATURE)
        )
    stamps = np.array([_stamp(row) for row in rows], dtype=np.int64)
    time, frame = (stamps - stamps[0]) * 1e-9, str(rows[0].header.frame_id)
    notes = [
        f"topic {topic}, frame {frame or 'not stated'}, time by header.stamp, units as ROS defines them (rad/s, m/s2)",
        f"time 0 is {stamps[0] * 1e-9:.6f} s of the stamps",
    ]
    found: Channels = {}
    for channel, field, unit in (("gyro", "angular_velocity", "rad/s"), ("accel", "linear_acceleration", "m/s2")):
        if all(getattr(row, f"{field}_covariance")[0] == -1.0 for row in rows):
            notes.append(f"{channel} left out: its covariance marks it as not available (-1)")
        else:
            found[channel] = ([(v.x, v.y, v.z) for v in (getattr(row, field) for row in rows)], unit)
    if not found:
        raise InputError(f"{path}: wanted readings in {topic}, got none (covariance -1); name another topic")
    if slow:
        clock = (np.array([stamp for stamp, _ in slow], dtype=np.int64) - stamps[0]) * 1e-9
        found["temp"] = (np.interp(time, clock, [temp_c for _, temp_c in slow]), "degC")
        notes.append(f"temperature of {min(near)}, interpolated")
    made = build(path, time, found, settings, notes, device=frame)
    return replace(made, dropped_rows=made.dropped_rows + max(0, stated - len(rows)))


def _messages(bag: Any, topic: str, kind: str) -> Iterator[Any]:
    connections = [c for c in bag.connections if c.topic == topic and c.msgtype == kind]
    for connection, _, raw in bag.messages(connections=connections):
        yield bag.deserialize(raw, connection.msgtype)


def _stamp(message: Any) -> int:
    """Return header.stamp in ns."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


# ---- PX4 ULog

_TOPICS = ["sensor_combined", "sensor_gyro", "sensor_accel", "sensor_selection"]
_SELECTION = "sensor_selection"
_COMBINED = "sensor_combined"


def _ulog(path: Path, settings: ReadSettings) -> tuple[dict[tuple[str, int], dict[str, FloatArray]], Any]:
    """Return the fields of the sensors' topics by name and instance, and the log."""
    pyulog, content = load("pyulog", path), read_bytes(path)
    with sound(path, "ULog"), contextlib.redirect_stdout(io.StringIO()):  # the library prints what it finds wrong
        if not settings.drop_bad_rows:
            _check_messages(content)
        log = pyulog.ULog(io.BytesIO(content), _TOPICS)
        if log.file_corruption and not settings.drop_bad_rows:
            raise ValueError("messages that are none; drop_bad_rows = true in a map reads what is whole")
    return {(d.name, d.multi_id): d.data for d in log.data_list if len(d.data["timestamp"])}, log


def _check_messages(content: bytes) -> None:
    """Refuse a log whose last message is cut: the library reads it without a word. Appended data has its own place."""
    at = 16
    while at + 3 <= len(content):
        size, kind = struct.unpack_from("<HB", content, at)
        if kind == ord("B") and struct.unpack_from("<Q", content, at + 19)[0]:
            return
        at += 3 + size
    if at != len(content):
        raise ValueError("the last message is cut; drop_bad_rows = true in a map reads what is whole")


@boxed("pyulog")
def read_ulog(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read one IMU of a PX4 log (sensor "0", "1", ...) or the autopilot's own choice (sensor "sensor_combined")."""
    topics, log = _ulog(path, settings)
    numbers = [
        str(number) for number in sorted({number for name, number in topics if name in ("sensor_gyro", "sensor_accel")})
    ]
    names = (*([_COMBINED] if (_COMBINED, 0) in topics else []), *numbers)
    sensor = chosen(path, "sensor", names, settings.sensor)
    hardware = str(log.msg_info_dict.get("ver_hw", "")).strip()
    notes = ["axes forward, right, down: z reads -9.8 m/s2 level and at rest"]
    if sensor == _COMBINED:
        return _combined(path, topics, hardware, notes, settings)
    held = {name: topics.get((f"sensor_{name}", int(sensor))) for name in ("gyro", "accel")}
    main = held["gyro"] or held["accel"] or {}
    clock = _ulog_clock(main)
    notes.append("sensor's own readings, before the autopilot's CAL_ parameters (PX4 v1.11 and later)")
    found: Channels = {}
    for channel, unit in (("gyro", "rad/s"), ("accel", "m/s2")):
        fields = held[channel]
        if fields is None:
            continue
        values = np.stack([fields[axis] for axis in "xyz"], axis=1).astype(np.float64)
        own = _ulog_clock(fields)
        if not np.array_equal(own, clock):
            values = np.stack([np.interp(clock, own, values[:, k]) for k in range(3)], axis=1)
            notes.append(f"{channel} interpolated onto the gyroscope's time stamps")
        found[channel] = (values, unit)
    if "temperature" in main and np.isfinite(main["temperature"]).all():
        found["temp"] = (main["temperature"], "degC")
    number = f"{int(main['device_id'][0])}" if "device_id" in main else sensor
    return build(path, clock, found, settings, notes, device=f"{hardware} {number}".strip())


def _combined(
    path: Path,
    topics: dict[tuple[str, int], dict[str, FloatArray]],
    hardware: str,
    notes: list[str],
    settings: ReadSettings,
) -> ReadResult:
    """Return the autopilot's own choice of readings, with the temperature of the gyroscope that it chose."""
    data = topics[_COMBINED, 0]
    clock = np.asarray(data["timestamp"], dtype=np.float64) * 1e-6
    notes = [*notes, "already corrected by the autopilot (board rotation, CAL_ parameters): state corrected, frame b"]
    found: Channels = {
        "gyro": (np.stack([data[f"gyro_rad[{k}]"] for k in range(3)], axis=1), "rad/s"),
        "accel": (np.stack([data[f"accelerometer_m_s2[{k}]"] for k in range(3)], axis=1), "m/s2"),
    }
    ids = {int(k) for (name, _), held in topics.items() if name == _SELECTION for k in held["gyro_device_id"]}
    gyros = {number: held for (name, number), held in topics.items() if name == "sensor_gyro" and "temperature" in held}
    own = [number for number, held in gyros.items() if {int(k) for k in held.get("device_id", ())} == ids]
    if len(own) == 1 and np.isfinite((slow := gyros[own[0]])["temperature"]).all():
        found["temp"] = (np.interp(clock, _ulog_clock(slow), slow["temperature"]), "degC")
        notes.append(f"temperature of sensor_gyro {own[0]}, which the autopilot chose, interpolated")
    return build(path, clock, found, settings, notes, device=hardware, frame="b", state="corrected")


def _ulog_clock(data: dict[str, FloatArray]) -> FloatArray:
    """Return the time of sampling since boot where the log has it, else of logging, s."""
    stamps: FloatArray = np.asarray(data.get("timestamp_sample", data["timestamp"]), dtype=np.float64) * 1e-6
    return stamps


# ---- NilsPod

_YEAR_2014, _YEAR_2040 = 1_388_534_400, 2_208_988_800  # Unix time, s


def is_nilspod(head: bytes) -> bool:
    """Tell a NilsPod file by its header: sizes of header and sample, and a start and end of these decades."""
    if len(head) < 0x30 or not (0x30 <= head[0] <= 0x40 and 6 <= head[1] <= 64):
        return False
    start, end, rows = struct.unpack_from("<III", head, 15)
    return bool(_YEAR_2014 < start <= end < start + 100 * 86_400 and end < _YEAR_2040 and rows > 0)


@boxed("nilspodlib")
def read_nilspod(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read a NilsPod file with the factory's scale applied; gaps of the counter stay gaps in time."""
    content = read_bytes(path)
    wanted = content[0] + content[1] * struct.unpack_from("<I", content, 23)[0]
    if len(content) != wanted:
        raise FileFormatError(
            f"{path}: wanted {wanted} bytes as its header states, got {len(content)}; the file is damaged, copy it again"
        )
    nilspodlib, version = load("nilspodlib", path, "nilspod"), ".".join(map(str, content[content[0] - 3 : content[0]]))
    legacy = "error" if version == "0.17.255" else "resolve"  # that is what conversion makes of older ones
    with sound(path, "NilsPod"), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            data = nilspodlib.Dataset.from_bin_file(str(path), legacy_support=legacy)
        except nilspodlib.exceptions.VersionError as error:
            raise FileFormatError(
                f"{path}: wanted a NilsPod's firmware that nilspodlib knows, got {version}; export the recording to CSV"
            ) from error
        rate_hz, counter = float(data.info.sampling_rate_hz), np.asarray(data.counter, dtype=np.float64)
        found: Channels = {}
        for channel, name, unit in (("gyro", "gyro", "dps"), ("accel", "acc", "m/s2"), ("temp", "temperature", "degC")):
            stream = getattr(data, name, None)
            if stream is not None:
                found[channel] = (np.asarray(stream.data).reshape(len(counter), -1), unit)
        if "temp" in found:
            found["temp"] = (found["temp"][0][:, 0], "degC")
        device, firmware = str(data.info.sensor_id), str(data.info.version_firmware)
    notes = [
        f"firmware {firmware}, {rate_hz:g} Hz, factory scale applied, no user calibration; magnetometer left out (no unit)"
    ]
    start, end = struct.unpack_from("<II", content, 15)
    lasts_s = (counter[-1] - counter[0]) / rate_hz
    if abs(end - start - lasts_s) > 2.0 + 0.05 * lasts_s:
        raise FileFormatError(
            f"{path}: wanted {end - start} s as its header states, got {lasts_s:.4g} s; it is damaged"
        )
    lost = int(counter[-1] - counter[0]) + 1 - len(counter)
    notes += [f"{lost} of {len(counter) + lost} samples missing by the counter, seen as gaps in time"] * (lost > 0)
    notes += [first_line(w.message) for w in caught if isinstance(w.message, UserWarning)]
    return build(path, (counter - counter[0]) / rate_hz, found, settings, notes, device=f"NilsPod {device}")


# ---- Mobilise-D: data.TimeMeasure1.Test5.Trial1.SU.LowerBack.Acc, .Gyr, .Timestamp, .Fs


def is_mobilised(head: bytes) -> bool:
    """Tell a Mobilise-D file by its first variable: a struct `data` with a field TimeMeasure..."""
    if not head.startswith(b"MATLAB 5.0") or len(head) < 256:
        return False
    with contextlib.suppress(zlib.error):
        head = zlib.decompressobj().decompress(head[136:], 1024)
    return b"\x04\x00data" in head[:1024] and b"TimeMeasure" in head[:1024]


_UNIT = re.compile(r"^data\.(?P<trial>.+)\.(?P<kind>SU\w*)\.(?P<place>\w+)\.(Acc|Gyr)$")


@boxed("pymatreader")
def read_mobilised(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read one sensor of a Mobilise-D file: accel in g and gyro in deg/s, as Mobilise-D defines them."""
    arrays = dict(mat_arrays(path))
    hits = [hit for name in arrays if (hit := _UNIT.match(name)) and arrays[name].ndim == 2]
    paths = {
        ".".join((h["trial"], *([] if h["kind"] == "SU" else [h["kind"]]), h["place"])): h.string.rpartition(".")[0]
        for h in hits
    }
    name = chosen(path, "sensor", tuple(paths), settings.sensor)
    at = paths[name]
    found: Channels = {}
    for channel, key, unit in (("accel", "Acc", "g"), ("gyro", "Gyr", "dps")):
        if f"{at}.{key}" in arrays:
            found[channel] = (arrays[f"{at}.{key}"], unit)
    rows = len(next(iter(found.values()))[0])
    rates = {float(rate) for key in ("Acc", "Gyr") for rate in np.ravel(arrays.get(f"{at}.Fs.{key}", ()))[:1]}
    time = arrays.get(f"{at}.Timestamp")
    if (
        len(rates) != 1
        or any(np.shape(values) != (rows, 3) for values, _ in found.values())
        or (time is not None and len(time) != rows)
    ):
        raise FileFormatError(
            f"{path}: wanted Acc, Gyr and Timestamp of {name} at one rate, got rates {sorted(rates)} Hz; read each part by a map"
        )
    rate_hz = rates.pop()
    notes = ["Acc in g and Gyr in deg/s as Mobilise-D defines them; Mag left out (no unit in the file)"]
    clock = np.arange(rows) / rate_hz if time is None else time
    return build(path, clock, found, settings, notes, device=name, sample_rate_hz=rate_hz)


# ---- wrist loggers

_FIT_PAGES = 100  # page stamps of 0.5 s give a rate only over many pages


def _clock(start: object) -> str:
    return f"time 0 is {str(start).replace('T', ' ')} by the logger's clock (local time, no zone)"


def _signed(values: NDArray[Any], bits: int) -> IntArray:
    """Return two's complement numbers of some bits."""
    wide = values.astype(np.int64)
    return wide - ((wide >> (bits - 1)) << bits)


def _whole(path: Path, good: BoolArray, what: str, settings: ReadSettings) -> int:
    """Return how many blocks are damaged; raise where there are any and they are not to be left out."""
    bad = np.flatnonzero(~good)
    if good.sum() == 0 or (len(bad) and not settings.drop_bad_rows):
        first = f"{len(bad)} of {len(good)} damaged, first {what} {bad[0] + 1}" if len(good) else "none"
        raise FileFormatError(
            f"{path}: wanted whole {what}s, got {first}; copy the file again, or set drop_bad_rows = true in a map to leave "
            "them out"
        )
    return len(bad)


# ---- Axivity AX3 and AX6: a header of 1024 bytes, then sectors of 512

_FIELDS = (  # name, type, byte
    ("tag", "<u2", 0), ("size", "<u2", 2), ("fraction", "<u2", 4), ("sequence", "<u4", 10), ("stamp", "<u4", 14),
    ("scale", "<u2", 18), ("temp", "<u2", 20), ("rate", "u1", 24), ("axes", "u1", 25), ("at", "<i2", 26),
    ("count", "<u2", 28), ("data", "(480,)u1", 30),
)  # fmt: skip
_SECTOR = np.dtype(
    dict(zip(("names", "formats", "offsets"), zip(*_FIELDS, strict=True), strict=True)) | {"itemsize": 512}
)  # type: ignore[call-overload]


@boxed()
def read_cwa(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read an Axivity AX3 or AX6 file."""
    content = read_bytes(path)
    body = content[1024:]
    if len(content) < 1536 or (len(body) % 512 and not settings.drop_bad_rows):
        raise FileFormatError(
            f"{path}: wanted a header of 1024 bytes and whole sectors of 512, got {len(content)} bytes; the file is cut, copy it "
            "again, or set drop_bad_rows = true in a map to read the whole sectors"
        )
    body = body[: len(body) // 512 * 512]
    sectors = np.frombuffer(body, _SECTOR)
    sums = np.frombuffer(body, "<u2").reshape(-1, 256).sum(axis=1, dtype=np.uint16)
    good = (sectors["tag"] == 0x5841) & (sectors["size"] == 508) & (sums == 0) & (sectors["count"] > 0)
    lost = _whole(path, good, "sector", settings)
    sectors = sectors[good]
    kinds = np.unique(sectors[["rate", "axes"]])
    rate, layout = int(kinds["rate"][0]), int(kinds["axes"][0])
    axes, packed = layout >> 4, layout & 15 == 0
    room = 120 if packed else 240 // axes if axes else 0
    if len(kinds) > 1 or (axes, packed) not in ((3, True), (3, False), (6, False), (9, False)):
        shown = ", ".join(f"rate 0x{r:02x} layout 0x{a:02x}" for r, a in kinds.tolist())
        raise FileFormatError(
            f"{path}: wanted sectors of one known layout, got {shown}; cut the file or export it to CSV"
        )
    if int(sectors["count"].max()) > room:
        raise FileFormatError(
            f"{path}: wanted up to {room} samples a sector, got {sectors['count'].max()}; it is damaged"
        )
    there = np.arange(room) < sectors["count"][:, None]
    start, time = _cwa_time(sectors, 3200.0 / 2.0 ** (15 - (rate & 15)), there)
    accel, gyro = _cwa_readings(sectors, axes, packed, there)
    raw = sectors["temp"] & 0x3FF
    temp_c = raw * 75.0 / 256.0 - 50.0
    notes = [
        _clock(start),
        f"temp_c = raw * 75 / 256 - 50 (Open Movement, cwa.h), one value a sector, raw {raw.min()} to {raw.max()}",
    ]
    channels: dict[str, tuple[FloatArray, str]] = {"accel": (accel, "g")}
    if raw.any():
        channels["temp"] = (np.interp(time, time[np.cumsum(sectors["count"]) - sectors["count"]], temp_c), "degC")
    if gyro is not None:
        channels["gyro"] = (gyro, "dps")
    number = int.from_bytes(content[5:7], "little") + (int.from_bytes(content[11:13], "little") % 0xFFFF << 16)
    kind = "AX6" if content[4] == 0x64 else "AX3"
    found = build(path, time, channels, settings, notes, device=f"{kind} {number}")
    return replace(found, dropped_rows=found.dropped_rows + lost * room)


def _cwa_time(sectors: NDArray[Any], rate_hz: float, there: BoolArray) -> tuple[np.datetime64, FloatArray]:
    """Return the date of the first sample and the time of all: straight from sector to sector, at the stated rate into a gap."""
    stamp, fraction = sectors["stamp"].astype(np.int64), sectors["fraction"]
    months = ((stamp >> 26 & 63) + 30) * 12 + (stamp >> 22 & 15) - 1
    days = months.astype("M8[M]").astype("M8[D]") + ((stamp >> 17 & 31) - 1)
    dates = days + ((stamp >> 12 & 31) * 3600 + (stamp >> 6 & 63) * 60 + (stamp & 63)).astype("m8[s]")
    parts = np.where(fraction & 0x8000, (fraction & 0x7FFF) / 32768.0, 0.0)
    # cwa.h: the offset was shifted by the whole samples of the fraction
    seconds = (dates - dates[0]).astype(np.float64) + parts - (sectors["at"] + np.floor(parts * rate_hz)) / rate_hz
    usual = sectors["count"] / rate_hz
    length = np.append(np.diff(seconds), usual[-1])
    run = np.append(np.diff(sectors["sequence"].astype(np.int64)) == 1, False) & (abs(length / usual - 1.0) < 0.1)
    step = (length / sectors["count"])[run]
    length = np.where(run, length, sectors["count"] * (float(np.median(step)) if len(step) else 1.0 / rate_hz))
    inside = np.arange(there.shape[1]) / sectors["count"][:, None] * length[:, None]
    time = (seconds[:, None] + inside)[there]
    return dates[0] + np.timedelta64(round(1e3 * seconds[0]), "ms"), time - time[0]


def _cwa_readings(
    sectors: NDArray[Any], axes: int, packed: bool, there: BoolArray
) -> tuple[FloatArray, FloatArray | None]:
    """Return accel in g and gyro in deg/s, (N, 3)."""
    data = np.ascontiguousarray(sectors["data"])
    if packed:
        words = data.view("<u4")[there]
        threes = np.stack([_signed(words >> shift & 0x3FF, 10) for shift in (0, 10, 20)], axis=1)
        return (threes << (words >> 30)[:, None].astype(np.int64)) / 256.0, None
    values = data.view("<i2")[:, : there.shape[1] * axes].reshape(*there.shape, axes)[there].astype(np.float64)
    scale = np.broadcast_to(sectors["scale"][:, None], there.shape)[there][:, None].astype(np.int64)
    accel = values[:, :3] if axes == 3 else values[:, 3:6]
    return accel / 2.0 ** (8 + (scale >> 13)), None if axes == 3 else values[:, :3] * (
        8000.0 / 32768.0 / 2.0 ** (scale >> 10 & 7)
    )


# ---- GENEActiv: a text header, then pages of 300 samples in hexadecimal; 12 bits an axis

_PAGE = "Recorded Data"


@boxed()
def read_geneactiv(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read a GENEActiv file."""
    head, *texts = read_bytes(path).decode("latin-1").replace("\r\n", "\n").split(_PAGE + "\n")
    fields, pages = _fields(head), [_fields(text) for text in texts]
    lines = [text.rstrip().rsplit("\n", 1)[-1] for text in texts]
    announced = int(fields.get("Number of Pages", "0")) if fields.get("Number of Pages", "0").isdigit() else 0
    whole = [bool(re.fullmatch(r"(?:[0-9A-Fa-f]{12}){300}", line)) for line in lines]
    lost, missing = _whole(path, np.array(whole, dtype=np.bool_), "page", settings), announced - len(whole)
    if missing > 0 and not settings.drop_bad_rows:
        raise FileFormatError(
            f"{path}: wanted {announced} pages as its header states, got {len(whole)}; the file is cut, copy it again, or set "
            "drop_bad_rows = true in a map to read the whole pages"
        )
    kept = [page for page, fine in zip(pages, whole, strict=True) if fine]
    try:
        stamps = np.array([page["Page Time"][:19] + "." + page["Page Time"][20:] for page in kept], dtype="M8[ms]")
        number = np.array([int(page["Sequence Number"]) for page in kept])
        rates = {_number(page["Measurement Frequency"]) for page in kept}
        temp_c = np.array([_number(page["Temperature"]) for page in kept])
        gain, offset = (np.array([_number(fields[f"{axis} {key}"]) for axis in "xyz"]) for key in ("gain", "offset"))
    except (KeyError, ValueError) as error:
        raise FileFormatError(
            f"{path}: wanted GENEActiv's fields (Page Time, Temperature, x gain, ...), got {error}; copy the file again"
        ) from error
    if len(rates) > 1 or not min(rates) > 0.0 or not gain.all():
        raise FileFormatError(
            f"{path}: wanted one sample rate and gains other than 0, got {sorted(rates)} Hz and {gain.tolist()}; it is damaged"
        )
    samples = bytes.fromhex("".join(line for line, fine in zip(lines, whole, strict=True) if fine))
    counts = _twelve_bit(samples).reshape(-1, 4)[:, :3]  # the fourth holds light and button
    rate_hz = rates.pop()
    seconds, leap = (stamps - stamps[0]).astype(np.int64) * 1e-3, np.diff(number)
    away = np.flatnonzero((leap < 1) | (abs(np.diff(seconds) * rate_hz / 300.0 - leap) > 0.5 + 0.02 * leap))
    if len(away):
        got = " and then ".join(f"{number[k]} at {seconds[k]:g} s" for k in (away[0], away[0] + 1))
        raise FileFormatError(f"{path}: wanted pages in order, times as their numbers, got page {got}; it is damaged")
    starts, fitted = _page_starts(seconds, number, rate_hz)
    step = np.append(np.where(np.diff(starts) < 330.0 / rate_hz, np.diff(starts) / 300.0, 1.0 / rate_hz), 1.0 / rate_hz)
    time = (starts[:, None] + np.arange(300) * step[:, None]).ravel()
    channels: dict[str, tuple[FloatArray, str]] = {
        "accel": ((100.0 * counts - offset) / gain, "g"),
        "temp": (np.interp(time, starts, temp_c), "degC"),
    }
    source = f"page stamps of {len(kept)} pages" if fitted else f"the stated {rate_hz:g} Hz (page stamps have 0.5 s)"
    notes = [_clock(stamps[0]), f"sample times by {source}", "gain and offset of the maker's calibration are applied"]
    notes += [f"{missing} of {announced} pages are missing: the file is cut"] * (missing > 0)
    notes += [f"{leap.sum() - len(leap)} pages missing by their numbers, seen as gaps in time"] * bool((leap > 1).any())
    found = build(
        path, time, channels, settings, notes, device=f"GENEActiv {fields.get('Device Unique Serial Code', '')}"
    )
    return replace(found, dropped_rows=found.dropped_rows + 300 * lost)


def _fields(text: str) -> dict[str, str]:
    pairs = (line.split(":", 1) for line in text.split("\n") if ":" in line)
    return {key.strip(): value.strip() for key, value in pairs}


def _number(text: str) -> float:
    return float(text.split()[0].replace(",", ".")) if text.split() else float("nan")


def _page_starts(stamps: FloatArray, number: IntArray, rate_hz: float) -> tuple[FloatArray, bool]:
    """Return the start of each page, on a straight line through the stamps of a run of pages; of a short run at the stated rate."""
    usual = 300.0 / rate_hz
    breaks = np.flatnonzero((np.diff(number) != 1) | (abs(np.diff(stamps) - usual) > 0.75)) + 1
    out, fitted = np.empty(len(stamps)), False
    for run in np.split(np.arange(len(stamps)), breaks):
        pages = run - run[0]
        slope = usual
        if len(run) >= _FIT_PAGES:
            slope, fitted = float(np.polyfit(pages, stamps[run], 1)[0]), True
        out[run] = np.mean(stamps[run] - slope * pages) + slope * pages
    return out - out[0], fitted


# ---- ActiGraph .gt3x: a zip with info.txt and activity.bin (firmware to 2.5), or log.bin (records)

_RECORD = struct.Struct("<BBIH")  # separator 0x1E, type, Unix time, size; the payload and one byte of checksum follow
_ACTIVITY, _PARAMETERS, _SCHEMA, _SENSOR, _ACTIVITY2 = 0, 21, 24, 25, 26
_ACCEL_SCALE, _TEMP_OFFSET = 55, 58  # of the parameters of address space 0
_TICKS = 621_355_968_000_000_000  # of 100 ns from year 1 to 1970
_COLUMN = struct.Struct("<BBBI16s")  # of a schema: flags, bit offset, bits, scale, label


def is_gt3x(path: Path) -> bool:
    """Tell a .gt3x by what is in the zip."""
    with zipfile.ZipFile(path) as held:
        return "info.txt" in held.namelist()


def _unzipped(path: Path) -> tuple[dict[str, str], str, bytes]:
    """Return info.txt, and name and content of the file of readings."""
    with sound(path, ".gt3x"), zipfile.ZipFile(path) as held:
        sizes = {item.filename: item.file_size for item in held.infolist()}
        full = [name for name in ("log.bin", "log.txt", "activity.bin") if sizes.get(name)]
        name = next((n for n in full if n != "log.txt" or held.read(n)[:1] == b"\x1e"), "")  # words beside activity.bin
        info = _fields(held.read("info.txt").decode("utf-8", "replace").replace("\r\n", "\n"))
        content = held.read(name) if name else b""
    if not content or not _number(info.get("Sample Rate", "")) > 0.0:
        raise FileFormatError(
            f"{path}: wanted activity.bin or log.bin and a Sample Rate, got none; copy the file again"
        )
    return info, name, content


@boxed()
def read_gt3x(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read an ActiGraph .gt3x file: sensor "accelerometer" (the primary one), or "imu" of a GT9X Link."""
    info, name, content = _unzipped(path)
    device = info.get("Serial Number", "")
    if name != "activity.bin":
        return _read_log(path, _records(path, content), device, settings)
    rate_hz = _number(info["Sample Rate"])
    accel = _of_actigraph(content) / 341.0
    keep = np.ones(len(accel), dtype=np.bool_)
    for start, stop in runs((accel == 0.0).all(axis=1)):
        keep[start:stop] = stop - start < rate_hz
    ticks = info.get("Start Date", "")
    notes = [_clock(np.datetime64((int(ticks) - _TICKS) // 10_000_000, "s"))] if ticks.isdigit() else []
    if not keep.all():
        notes.append(
            f"{int((~keep).sum())} of {len(keep)} samples left out: exactly 0, 0, 0 for a second or more (no data)"
        )
    time = np.flatnonzero(keep) / rate_hz
    return build(path, time, {"accel": (accel[keep], "g")}, settings, notes, device=device)


def _of_actigraph(content: bytes) -> FloatArray:
    """Return x, y, z counts (N, 3), stored as y, x, z."""
    counts = _twelve_bit(content)
    return counts[: len(counts) // 3 * 3].reshape(-1, 3)[:, [1, 0, 2]].astype(np.float64)


def _twelve_bit(content: bytes) -> IntArray:
    """Return whole counts of 12 bits each, high bits first."""
    b = np.frombuffer(content + bytes(-len(content) % 3), np.uint8).reshape(-1, 3).astype(np.int64)
    pairs = np.stack((b[:, 0] << 4 | b[:, 1] >> 4, (b[:, 1] & 15) << 8 | b[:, 2]), axis=1).ravel()
    return _signed(pairs[: len(content) * 8 // 12], 12)


def _records(path: Path, content: bytes) -> list[tuple[int, int, bytes]]:
    """Return type, Unix time in s and payload of every record of a log, each checked."""
    out: list[tuple[int, int, bytes]] = []
    at, end = 0, len(content)
    while at < end:
        if content[at] == 0:  # allowed between records
            at += 1
            continue
        size = _RECORD.unpack_from(content, at)[3] if at + _RECORD.size <= end else end
        stop = at + _RECORD.size + size
        whole = content[at] == 0x1E and stop < end
        if (
            not whole
            or int(np.bitwise_xor.reduce(np.frombuffer(content, np.uint8, stop - at, at))) ^ 0xFF != content[stop]
        ):
            raise FileFormatError(
                f"{path}: wanted whole records in the log, got a damaged one at byte {at}; copy the file again"
            )
        out.append((content[at + 1], _RECORD.unpack_from(content, at)[2], content[at + _RECORD.size : stop]))
        at = stop + 1
    return out


def _ssp(code: int) -> float:
    """Return a number of a fraction of 24 bits and an exponent of 8, both two's complement."""
    fraction, power = (int(_signed(np.array(value), bits)) for value, bits in ((code & 0xFFFFFF, 24), (code >> 24, 8)))
    return fraction / 8_388_608.0 * 2.0**power


def _read_log(path: Path, records: list[tuple[int, int, bytes]], device: str, settings: ReadSettings) -> ReadResult:
    """Read one sensor of the records."""
    held = {kind: [(when, body) for k, when, body in records if k == kind] for kind in {k for k, _, _ in records}}
    wanted = ("accelerometer",) * bool(held.keys() & {_ACTIVITY, _ACTIVITY2}) + ("imu",) * (_SENSOR in held)
    sensor = chosen(path, "sensor", wanted, settings.sensor)
    parameters = {
        key: value
        for _, body in held.get(_PARAMETERS, [])
        for space, key, value in struct.iter_unpack("<HHI", body[: len(body) // 8 * 8])
        if space == 0
    }
    if sensor == "imu":
        blocks, channels = _imu(path, held, _ssp(parameters[_TEMP_OFFSET]) if _TEMP_OFFSET in parameters else 21.0)
    else:
        maker = {"NEO": 341.0, "CLE": 341.0, "MOS": 256.0}.get(device[:3])
        scale = _ssp(parameters[_ACCEL_SCALE]) if _ACCEL_SCALE in parameters else maker
        if not scale:
            raise FileFormatError(
                f"{path}: wanted ACCEL_SCALE or a serial number NEO, CLE or MOS, got {device!r}; export it to CSV"
            )
        found = [(when, _of_actigraph(body)) for when, body in held.get(_ACTIVITY, []) if len(body) > 1]
        found += [
            (when, np.frombuffer(body, "<i2", len(body) // 6 * 3).reshape(-1, 3).astype(np.float64))
            for when, body in held.get(_ACTIVITY2, [])
            if len(body) > 1  # one byte: plugged in
        ]
        found.sort(key=lambda block: block[0])
        blocks = [(when, len(values)) for when, values in found]
        channels = {"accel": (np.concatenate([values for _, values in found] or [np.empty((0, 3))]) / scale, "g")}
    time = np.concatenate([when - blocks[0][0] + np.arange(count) / count for when, count in blocks] or [np.empty(0)])
    notes = [_clock(np.datetime64(blocks[0][0], "s"))] if blocks else []
    return build(path, time, channels, settings, notes, device=device)


def _imu(
    path: Path, held: Mapping[int, list[tuple[int, bytes]]], offset_c: float
) -> tuple[list[tuple[int, int]], dict[str, tuple[FloatArray, str]]]:
    """Return Unix time and count of each block of the IMU, and its channels."""
    body = next((body for _, body in held.get(_SCHEMA, []) if len(body) >= 6), b"")
    schema, count, samples = struct.unpack_from("<HHH", body) if body else (0, 0, 0)
    if not count or len(body) < 6 + count * _COLUMN.size:
        raise FileFormatError(f"{path}: wanted a schema of the IMU's records, got none; copy the file again")
    kinds: list[tuple[str, str]] = []
    scales: dict[str, float] = {}
    for k in range(count):
        flags, _, bits, scale, label = _COLUMN.unpack_from(body, 6 + k * _COLUMN.size)
        name = label.decode("ascii", "replace").strip(" \0").lower()
        kinds.append((f"{k} {name}", f"{'>' if flags & 1 else '<'}{'i' if flags & 2 else 'u'}{bits // 8}"))
        scales[name] = _ssp(scale) or 1.0
    try:
        row = np.dtype(kinds)
        whole = [(when, y) for when, y in held[_SENSOR] if y[:2] == struct.pack("<H", schema)]
        found = [(when, np.frombuffer(y, row, samples, 2)) for when, y in whole]
        rows = np.concatenate([values for _, values in found])
    except (TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: wanted IMU records as their schema states, got others ({error}); copy the file again"
        ) from error
    named = {kind.split(" ", 1)[1]: kind for kind, _ in kinds}
    channels: dict[str, tuple[FloatArray, str]] = {}
    for channel, label, unit in (
        ("accel", "accelerometer", "g"),
        ("gyro", "gyroscope", "dps"),
        ("mag", "magnetometer", "uT"),
    ):
        axes = [f"{label} {axis}" for axis in "xyz"]
        if all(axis in named for axis in axes):
            channels[channel] = (np.stack([rows[named[a]] / scales[a] for a in axes], axis=1), unit)
    if "temperature" in named:
        channels["temp"] = (rows[named["temperature"]] / scales["temperature"] + offset_c, "degC")
    return [(when, len(values)) for when, values in found], channels
