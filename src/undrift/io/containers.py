"""Containers of several streams: XDF, ROS bags, PX4 ULog, NilsPod, Mobilise-D. ``sensor`` names the stream, topic or place.

XDF (LSL): clocks are synchronised by the file's clock offsets; time stamps stay as they were recorded, not de-jittered.
ROS: sensor_msgs/Imu by header.stamp, SI units (REP 103, REP 145); covariance[0] = -1 marks a channel that is absent.
PX4: sensor_gyro and sensor_accel are the sensors' own readings; sensor_combined is already corrected by the autopilot. The body
frame is forward-right-down, so that z reads -9.8 m/s2 level and at rest.
"""

import contextlib
import io
import logging
import re
import struct
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import first_line, read_bytes
from undrift.io.arrays import mat_arrays
from undrift.io.columns import AXES, ColumnMap, ReadResult, ReadSettings, Table, build_record
from undrift.units import canonical_unit

Columns = ColumnMap | None
Channels = dict[str, tuple[Any, str]]


# ---- what these readers share

EPOCH_S = 1e8  # a clock beyond this counts from 1970: it is shown from its first sample


def load(module: str, path: Path, extra: str = "io") -> Any:
    """Return a library that an extra installs."""
    try:
        return import_module(module)
    except ImportError as error:
        name = module.split(".")[0]
        raise InputError(
            f"{path}: wanted {name} to read it, got no such library; run pip install 'undrift[{extra}]'"
        ) from error


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
        f"{path}: wanted {wanted}, got a file with {', '.join(names)}; name one of them (--sensor)",
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
    table = Table(source=str(path), names=tuple(held), columns=tuple(held.values()))
    return replace(build_record(table, ColumnMap(time="time_s", time_unit="s", **columns)), notes=notes)


@contextlib.contextmanager
def sound(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into one line."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise FileFormatError(
            f"{path}: wanted a sound {kind} file, got a damaged or cut one ({first_line(error)}); copy it again"
        ) from error


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


def read_xdf(path: Path, columns: Columns, settings: ReadSettings) -> ReadResult:
    """Read one stream; without a map, by its channels' labels (or types) and units."""
    streams = _xdf(path)
    asked = streams.get(settings.sensor or "")
    if asked is not None and not _has_numbers(asked):
        what = "no samples" if len(asked["time_stamps"]) == 0 else "text"
        raise InputError(
            f"{path}: wanted a stream of readings, got {what} in {settings.sensor!r}; name another stream (--sensor)"
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
        return _mapped(path, (time, labels, values), columns, note)
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
            'map (--map), for example columns = { time = "time_s", gyro = [0, 1, 2] }, units = { time = "s", gyro = "dps" }',
            missing="columns",
        )
    return build(path, time, found, settings, [note], device=name)


def _mapped(path: Path, held: tuple[FloatArray, list[str], FloatArray], columns: ColumnMap, note: str) -> ReadResult:
    time, labels, values = held
    table = Table(source=str(path), names=(*labels, "time_s"), columns=(*values.T, time))
    return replace(build_record(table, columns), notes=(note,))


# ---- ROS 1 bag, ROS 2 db3 and MCAP, or the folder of a ROS 2 bag

_IMU, _TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"


@contextlib.contextmanager
def _bag(path: Path) -> Iterator[Any]:
    """Open a bag; message types that the file does not define are those of ROS 2."""
    stores, reader = load("rosbags.typesys", path), load("rosbags.highlevel", path).AnyReader
    with sound(path, "ROS bag"), reader([path], default_typestore=stores.get_typestore(stores.Stores.LATEST)) as held:
        yield held


def read_ros(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read one topic of sensor_msgs/Imu; a Temperature topic of the same parent goes with it."""
    with _bag(path) as bag:
        topics = sorted({c.topic for c in bag.connections if c.msgtype == _IMU and c.msgcount})
        topic = chosen(path, "topic", tuple(topics), settings.sensor)
        rows = list(_messages(bag, topic, _IMU))
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
    return build(path, time, found, settings, notes, device=frame)


def _messages(bag: Any, topic: str, kind: str) -> Iterator[Any]:
    connections = [c for c in bag.connections if c.topic == topic and c.msgtype == kind]
    for connection, _, raw in bag.messages(connections=connections):
        yield bag.deserialize(raw, connection.msgtype)


def _stamp(message: Any) -> int:
    """Return header.stamp in ns."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


# ---- PX4 ULog

_TOPICS = ["sensor_combined", "sensor_gyro", "sensor_accel"]
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


def read_ulog(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read one IMU of a PX4 log (sensor "0", "1", ...) or the autopilot's own choice (sensor "sensor_combined")."""
    topics, log = _ulog(path, settings)
    numbers = [str(number) for number in sorted({number for name, number in topics if name != _COMBINED})]
    names = (*([_COMBINED] if (_COMBINED, 0) in topics else []), *numbers)
    sensor = chosen(path, "sensor", names, settings.sensor)
    hardware = str(log.msg_info_dict.get("ver_hw", "")).strip()
    notes = ["axes forward, right, down: z reads -9.8 m/s2 level and at rest"]
    if sensor == _COMBINED:
        data = topics[_COMBINED, 0]
        notes.append("already corrected by the autopilot (board rotation, CAL_ parameters): state corrected, frame b")
        found: Channels = {
            "gyro": (np.stack([data[f"gyro_rad[{k}]"] for k in range(3)], axis=1), "rad/s"),
            "accel": (np.stack([data[f"accelerometer_m_s2[{k}]"] for k in range(3)], axis=1), "m/s2"),
        }
        return build(
            path, data["timestamp"] * 1e-6, found, settings, notes, device=hardware, frame="b", state="corrected"
        )
    held = {name: topics.get((f"sensor_{name}", int(sensor))) for name in ("gyro", "accel")}
    main = held["gyro"] or held["accel"] or {}
    clock = _ulog_clock(main)
    notes.append("sensor's own readings, before the autopilot's CAL_ parameters (PX4 v1.11 and later)")
    found = {}
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


def read_nilspod(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read a NilsPod file with the factory's scale applied; gaps of the counter stay gaps in time."""
    content = read_bytes(path)
    wanted = content[0] + content[1] * struct.unpack_from("<I", content, 23)[0]
    if len(content) < wanted:
        raise FileFormatError(
            f"{path}: wanted {wanted} bytes as its header states, got {len(content)}; the file is cut, copy it again"
        )
    nilspodlib = load("nilspodlib", path, "nilspod")
    with sound(path, "NilsPod"), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = nilspodlib.Dataset.from_bin_file(str(path), legacy_support="resolve")
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


def _mobilised(path: Path) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the sensors' paths by name, and all arrays."""
    arrays = dict(mat_arrays(path))
    hits = [hit for name in arrays if (hit := _UNIT.match(name)) and arrays[name].ndim == 2]
    return {
        ".".join((h["trial"], *([] if h["kind"] == "SU" else [h["kind"]]), h["place"])): h.string.rpartition(".")[0]
        for h in hits
    }, arrays


def read_mobilised(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read one sensor of a Mobilise-D file: accel in g and gyro in deg/s, as Mobilise-D defines them."""
    paths, arrays = _mobilised(path)
    name = chosen(path, "sensor", tuple(paths), settings.sensor)
    at = paths[name]
    found: Channels = {}
    for channel, key, unit in (("accel", "Acc", "g"), ("gyro", "Gyr", "dps")):
        if f"{at}.{key}" in arrays:
            found[channel] = (arrays[f"{at}.{key}"], unit)
    rows = len(next(iter(found.values()))[0])
    rates = {float(arrays[f"{at}.Fs.{key}"][0]) for key in ("Acc", "Gyr") if f"{at}.Fs.{key}" in arrays}
    time = arrays.get(f"{at}.Timestamp")
    if (
        len(rates) != 1
        or any(len(values) != rows for values, _ in found.values())
        or (time is not None and len(time) != rows)
    ):
        raise FileFormatError(
            f"{path}: wanted Acc, Gyr and Timestamp of {name} at one rate, got rates {sorted(rates)} Hz; read each part by a map"
        )
    rate_hz = rates.pop()
    notes = ["Acc in g and Gyr in deg/s as Mobilise-D defines them; Mag left out (no unit in the file)"]
    clock = np.arange(rows) / rate_hz if time is None else time
    return build(path, clock, found, settings, notes, device=name, sample_rate_hz=rate_hz)
