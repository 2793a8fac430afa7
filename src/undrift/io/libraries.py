"""Recordings read with maintained libraries (extra ``formats``). Each reader is a library call and a table of its arrays.

MAT (pymatreader)      named arrays for a map; the field of a struct is ``struct.field``
XDF (pyxdf)            clocks synchronised with the file's clock offsets, time stamps as recorded, not de-jittered
ROS (rosbags)          sensor_msgs/Imu by header.stamp, SI units (REP 103, REP 145), covariance[0] = -1 marks an absent channel
ULog (pyulog)          sensor_gyro and sensor_accel are uncorrected; sensor_combined was corrected by the autopilot
NilsPod (nilspodlib)   factory scale applied, gaps of the counter remain gaps in time
Axivity, GENEActiv, ActiGraph (actfast)   g, deg/s, degC, local time without a zone, counted from the first sample
"""

import contextlib
import io
import logging
import re
import struct
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import first_line, read_bytes, sound
from undrift.io.clock import onto_clock
from undrift.io.column_map import QUANTITY, Column, ColumnMap, naming, native_map
from undrift.io.columns import RawTable, of_channels
from undrift.io.isolated import isolated
from undrift.units import canonical_unit

Arrays = tuple[tuple[str, NDArray[Any]], ...]
Channels = dict[str, tuple[Any, str]]  # array (N,) or (N, 3), and unit


def reader(kind: str, read: Callable[[Path, ColumnMap], Any]) -> Callable[[Path, ColumnMap], Any]:
    """Return a reader that runs in a separate process. Any error of the library means that the file is damaged."""

    def read_file(path: Path, how: ColumnMap) -> Any:
        return isolated(_soundly, path, how, kind, read)

    return read_file


def _soundly(path: Path, how: ColumnMap, kind: str, read: Callable[[Path, ColumnMap], Any]) -> Any:
    with sound(path, kind), naming(path), warnings.catch_warnings(action="ignore"):
        return read(path, how)


def library(module: str) -> Any:
    """Import and return a library of the extra ``formats``."""
    try:
        return import_module(module)
    except ImportError as error:
        name = module.split(".")[0]
        raise InputError(f"the library {name} is required to read it. Run pip install 'undrift[formats]'.") from error


def is_nilspod(head: bytes) -> bool:
    """Return True for a NilsPod header: sizes of header and sample, and a start and an end from 2014 to 2040."""
    if len(head) < 0x30 or not (0x30 <= head[0] <= 0x40 and 6 <= head[1] <= 64):
        return False
    start, end, rows = struct.unpack_from("<III", head, 15)
    return bool(1_388_534_400 < start <= end < start + 100 * 86_400 and end < 2_208_988_800 and rows > 0)


def chosen(kind: str, names: tuple[str, ...], sensor: str | None) -> str:
    """Return the item selected with `sensor`, by its whole name or a unique ending. Without `sensor`, return the only item."""
    if not names:
        raise FileFormatError(f"expected a {kind} with readings, got none. The file contains no recording.")
    hits = names if sensor is None else [name for name in names if name == sensor]
    hits = hits or [name for name in names if name.endswith(f".{sensor}")]
    if len(hits) == 1:
        return hits[0]
    wanted = f"the name of one {kind}" if sensor is None else f"{kind} {sensor!r}"
    raise InputError(
        f"expected {wanted}, got a file with {', '.join(names)}. Choose one with `sensor`.",
        missing="sensor",
        names=names,
    )


_CHANNEL = {"gyro": r"gyr|angular.?(rate|vel)|^w$", "accel": r"acc", "mag": r"mag", "temp": r"temp"}


def _xdf(path: Path, how: ColumnMap) -> RawTable:
    pyxdf, lines, content, at = library("pyxdf"), list[str](), read_bytes(path), 4
    while at < len(content):  # the library reads a truncated last chunk without an error
        width = content[at] if content[at] in (1, 4, 8) else len(content)
        at += 1 + width + int.from_bytes(content[at + 1 : at + 1 + width], "little")
    if at != len(content):
        raise ValueError("its last chunk is truncated, or a chunk is damaged")
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger("pyxdf").addHandler(handler)
    try:
        streams, _header = pyxdf.load_xdf(str(path), synchronize_clocks=True, dejitter_timestamps=False)
    finally:
        logging.getLogger("pyxdf").removeHandler(handler)
    if lines:
        raise ValueError(lines[0].splitlines()[0])
    names = [stream["info"]["name"][0] or "unnamed" for stream in streams]
    named = {
        name if names.count(name) == 1 else f"{name}#{stream['info']['stream_id']}": stream
        for name, stream in zip(names, streams, strict=True)
    }
    full = {n: s for n, s in named.items() if isinstance(s["time_series"], np.ndarray) and len(s["time_stamps"])}
    if how.sensor in named and how.sensor not in full:
        raise InputError(
            f"expected a stream of readings, got text or no samples in {how.sensor!r}. Choose another stream with `sensor`."
        )
    name = chosen("stream", tuple(full), how.sensor)
    info, values = full[name]["info"], np.asarray(full[name]["time_series"], dtype=np.float64)
    listed = [held for desc in info["desc"] or [] if desc for held in desc.get("channels", []) if held]
    described = [channel for held in listed for channel in held.get("channel", [])]
    described = described if len(described) == values.shape[1] else [{}] * values.shape[1]
    label, kind, unit = ([(c.get(key) or [""])[0] or "" for c in described] for key in ("label", "type", "unit"))
    labels = [text or str(k) for k, text in enumerate(label)]
    time, rate_hz = np.asarray(full[name]["time_stamps"], dtype=np.float64), float(info["nominal_srate"][0])
    note = f"stream {name}: clocks synchronised, time stamps as recorded (not de-jittered), nominal rate {rate_hz:g} Hz"
    if how.columns:
        return RawTable(source=str(path), names=(*labels, "time_s"), columns=(*values.T, time), notes=(note,))
    found: Channels = {}
    for channel, pattern in _CHANNEL.items():
        at_ = [k for k in range(len(labels)) if re.search(pattern, f"{label[k]} {kind[k]}", re.IGNORECASE)]
        if len(at_) == (1 if channel == "temp" else 3) and all(unit[k] == unit[at_[0]] != "" for k in at_):
            with contextlib.suppress(InputError):  # not a unit: a map must define it
                stated = canonical_unit(unit[at_[0]], QUANTITY[channel])  # type: ignore[index]
                found[channel] = (values[:, at_[0]] if channel == "temp" else values[:, at_], stated)
    if not found.keys() & {"gyro", "accel"}:
        shown = ", ".join(f"{a}{f' ({b})' if b else ''}" for a, b in zip(labels, unit, strict=True))
        raise InputError(
            f"expected channels of {name} labelled as accelerometer or gyroscope with units, got {shown}. Name them in a "
            'map (`column_map`), for example columns = { time = "time_s", gyro = [0, 1, 2] }, units = { time = "s", gyro = "dps" }',
            missing="columns",
            proposal={"columns": {"time": "time_s", "gyro": [0, 1, 2]}, "units": {"time": "s", "gyro": "?"}},
        )
    return of_channels(path, time, found, how, notes=[note], device=name)


_IMU, _TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"


def _ros(path: Path, how: ColumnMap) -> RawTable:
    stores, any_reader = library("rosbags.typesys"), library("rosbags.highlevel").AnyReader
    with any_reader([path], default_typestore=stores.get_typestore(stores.Stores.LATEST)) as bag:

        def messages(topic: str, kind: str) -> Iterator[tuple[int, Any]]:
            connections = [c for c in bag.connections if c.topic == topic and c.msgtype == kind]
            for connection, _time, raw in bag.messages(connections=connections):
                stamp = (message := bag.deserialize(raw, connection.msgtype)).header.stamp
                yield int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec), message

        topics = sorted({c.topic for c in bag.connections if c.msgtype == _IMU and c.msgcount})
        topic = chosen("topic", tuple(topics), how.sensor)
        rows = list(messages(topic, _IMU))
        stated = sum(c.msgcount for c in bag.connections if c.topic == topic and c.msgtype == _IMU)
        if len(rows) < stated and not how.drop_bad_rows:
            raise ValueError(
                f"{len(rows)} of {stated} messages are present. Set drop_bad_rows = true in a map to read them."
            )
        parent = topic.rpartition("/")[0]
        near = {c.topic for c in bag.connections if c.msgtype == _TEMPERATURE and c.topic.rpartition("/")[0] == parent}
        slow = sorted((s, m.temperature) for t in near if len(near) == 1 for s, m in messages(t, _TEMPERATURE))
    stamps, frame = np.array([stamp for stamp, _ in rows], dtype=np.int64), str(rows[0][1].header.frame_id)
    time, channels = (stamps - stamps[0]) * 1e-9, Channels()
    notes = [
        f"topic {topic}, frame {frame or 'not given'}, time from header.stamp, units as ROS defines them (rad/s, m/s2)",
        f"time 0 is the time stamp {stamps[0] * 1e-9:.6f} s",
    ]
    for channel, name, unit in (("gyro", "angular_velocity", "rad/s"), ("accel", "linear_acceleration", "m/s2")):
        if all(getattr(row, f"{name}_covariance")[0] == -1.0 for _, row in rows):
            notes.append(f"{channel} left out: its covariance marks it as not available (-1)")
        else:
            vectors = [getattr(row, name) for _, row in rows]
            channels[channel] = (np.array([(v.x, v.y, v.z) for v in vectors]), unit)
    if not channels:
        raise InputError(f"expected readings in {topic}, got none (covariance -1). Choose another topic.")
    if slow:
        clock = (np.array([stamp for stamp, _ in slow], dtype=np.int64) - stamps[0]) * 1e-9
        channels["temp"] = (np.interp(time, clock, [temp_c for _, temp_c in slow]), "degC")
        notes.append(f"temperature from {min(near)}, interpolated")
    table = of_channels(path, time, channels, how, notes=notes, device=frame)
    return replace(table, dropped=max(0, stated - len(rows)))


_TOPICS = ["sensor_combined", "sensor_gyro", "sensor_accel"]


def _ulog(path: Path, how: ColumnMap) -> RawTable:
    content, at = read_bytes(path), 16
    while at + 3 <= len(content) and not how.drop_bad_rows:  # the library accepts a log whose last message is truncated
        size, kind = struct.unpack_from("<HB", content, at)
        if kind == ord("B") and struct.unpack_from("<Q", content, at + 19)[0]:
            at = len(content)  # appended data are stored elsewhere
            break
        at += 3 + size
    with contextlib.redirect_stdout(io.StringIO()):  # the library prints errors in the file
        log = library("pyulog").ULog(io.BytesIO(content), _TOPICS)
    if (at != len(content) or log.file_corruption) and not how.drop_bad_rows:
        raise ValueError("messages are truncated or damaged. Set drop_bad_rows = true in a map to read the rest.")
    topics = {(d.name, d.multi_id): d.data for d in log.data_list if len(d.data["timestamp"])}
    numbers = sorted({number for name, number in topics if name in ("sensor_gyro", "sensor_accel")})
    names = (*(["sensor_combined"] if ("sensor_combined", 0) in topics else []), *map(str, numbers))
    sensor, hardware = chosen("sensor", names, how.sensor), str(log.msg_info_dict.get("ver_hw", "")).strip()

    def clock(data: dict[str, Any]) -> FloatArray:
        """Return the sampling time since boot, s, or the logging time if the log does not contain it."""
        return np.asarray(data.get("timestamp_sample", data["timestamp"]), dtype=np.float64) * 1e-6

    notes, channels = ["axes forward, right, down: z reads -9.8 m/s2 if level and at rest"], Channels()
    if sensor == "sensor_combined":
        data = topics["sensor_combined", 0]
        time: FloatArray = np.asarray(data["timestamp"], dtype=np.float64) * 1e-6
        notes.append("already corrected by the autopilot (board rotation, CAL_ parameters): frame b")
        for channel, name, unit in (("gyro", "gyro_rad", "rad/s"), ("accel", "accelerometer_m_s2", "m/s2")):
            channels[channel] = (np.stack([data[f"{name}[{k}]"] for k in range(3)], axis=1), unit)
        return of_channels(path, time, channels, how, notes=notes, device=hardware, frame="b", state="corrected")
    both = {name: topics.get((f"sensor_{name}", int(sensor))) for name in ("gyro", "accel")}
    main = both["gyro"] or both["accel"] or {}
    time = clock(main)
    notes.append("readings of the sensor, before the autopilot's CAL_ parameters (PX4 v1.11 and later)")
    for channel, unit in (("gyro", "rad/s"), ("accel", "m/s2")):
        if (data := both[channel]) is None:
            continue
        values: FloatArray = np.stack([data[axis] for axis in "xyz"], axis=1).astype(np.float64)
        if not np.array_equal(clock(data), time):
            values, missing = onto_clock(time, clock(data), values)
            lost = f", with gaps at {missing} samples in its drop-outs" if missing else ""
            notes.append(f"{channel} interpolated onto the gyroscope's time stamps{lost}")
        channels[channel] = (values, unit)
    if "temperature" in main and np.isfinite(main["temperature"]).all():
        channels["temp"] = (main["temperature"], "degC")
    number = int(main["device_id"][0]) if "device_id" in main else sensor
    return of_channels(path, time, channels, how, notes=notes, device=f"{hardware} {number}".strip(), gaps="keep")


def _nilspod(path: Path, how: ColumnMap) -> RawTable:
    content = read_bytes(path)
    wanted = content[0] + content[1] * struct.unpack_from("<I", content, 23)[0]
    if len(content) != wanted:
        raise ValueError(f"the header gives {wanted} bytes, but the file has {len(content)}")
    nilspodlib, version = library("nilspodlib"), ".".join(map(str, content[content[0] - 3 : content[0]]))
    legacy = "error" if version == "0.17.255" else "resolve"  # older files are converted up to this version
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            data = nilspodlib.Dataset.from_bin_file(str(path), legacy_support=legacy)
        except nilspodlib.exceptions.VersionError as error:
            raise FileFormatError(
                f"expected firmware that nilspodlib supports, got {version}. Export it to CSV."
            ) from error
        rate_hz, counter = float(data.info.sampling_rate_hz), np.asarray(data.counter, dtype=np.float64)
        time, channels = (counter - counter[0]) / rate_hz, Channels()
        for channel, name, unit in (("gyro", "gyro", "dps"), ("accel", "acc", "m/s2"), ("temp", "temperature", "degC")):
            if (stream := getattr(data, name, None)) is not None:
                values = np.asarray(stream.data).reshape(len(counter), -1)
                channels[channel] = (values[:, 0] if channel == "temp" else values, unit)
    start, end = struct.unpack_from("<II", content, 15)
    lasts_s, lost = (counter[-1] - counter[0]) / rate_hz, int(counter[-1] - counter[0]) + 1 - len(counter)
    if abs(end - start - lasts_s) > 2.0 + 0.05 * lasts_s:
        raise ValueError(f"the header gives {end - start} s, but the file has {lasts_s:.4g} s")
    notes = [
        f"firmware {data.info.version_firmware}, {rate_hz:g} Hz, factory scale applied, magnetometer left out (no unit)",
        *[f"{lost} of {len(counter) + lost} samples are missing according to the counter, and become gaps in time"]
        * (lost > 0),
        *(first_line(w.message) for w in caught if isinstance(w.message, UserWarning)),
    ]
    return of_channels(path, time, channels, how, notes=notes, device=f"NilsPod {data.info.sensor_id}")


def _logger(path: Path, how: ColumnMap) -> RawTable:
    """Read an Axivity, GENEActiv or ActiGraph file. Times are interpolated linearly between the time stamps of the blocks."""
    held = library("actfast").read(str(path), lenient=how.drop_bad_rows)
    series, about, kind = held["timeseries"], held["metadata"], held["format"]
    fast = series.get("high_frequency") or series["acceleration"]
    slow, stamps = series.get("low_frequency", {}), np.asarray(fast["datetime"], dtype=np.int64)
    if not len(stamps):
        raise FileFormatError("expected accelerometer readings, got none. Export CSV with the maker's program.")
    if kind.startswith("Axivity") and path.stat().st_size % 512 and not how.drop_bad_rows:
        raise ValueError(
            "the file ends within a sector. Set drop_bad_rows = true in a map to read the complete sectors."
        )
    pages = str(about.get("Memory Status", {}).get("Number of Pages", ""))
    if pages.isdigit() and len(stamps) != 300 * int(pages) and not how.drop_bad_rows:
        what = "missing" if len(stamps) < 300 * int(pages) else "too many"
        raise ValueError(f"samples of {pages} pages are {what}. Set drop_bad_rows = true in a map to read the rest.")
    start = stamps[:1].astype("M8[ns]").astype("M8[ms]")[0]
    notes = [f"time 0 is {start} on the logger's clock (local time)", *map(str, held["warnings"])]
    blocks = np.asarray(slow.get("datetime", stamps[:1]), dtype=np.int64)
    time = _straight(stamps, blocks, fitted=kind.startswith("GeneActiv"))
    channels: Channels = {"accel": (np.asarray(fast["acceleration"], dtype=np.float64), "g")}
    if "gyroscope" in fast:
        channels["gyro"] = (np.asarray(fast["gyroscope"], dtype=np.float64), "dps")
    if "temperature" in slow and np.ptp(time[[0, -1]]):
        temp_c = np.asarray(slow["temperature"], dtype=np.float64)
        at = time[np.minimum(np.searchsorted(stamps, blocks), len(stamps) - 1)]
        channels["temp"] = (np.interp(time, at, temp_c), "degC")
        notes.append("one temperature for each block of samples, interpolated (programs differ in its formula)")
    device, identity = about.get("device", {}), about.get("Device Identity", about.get("info", {}))
    number = device.get("device_id", identity.get("Device Unique Serial Code", identity.get("Serial Number", "")))
    maker = device.get("hardware_type", kind.split()[0].replace("Gene", "GENE"))
    return of_channels(path, time, channels, how, notes=notes, device=f"{maker} {number}")


def _straight(stamps: NDArray[Any], blocks: NDArray[Any], *, fitted: bool) -> FloatArray:
    """Return times in s from 0, linear from block to block. With ``fitted``, each run has a single rate, for coarse time stamps of
    blocks.
    """
    time, starts = (stamps - stamps[0]) * 1e-9, np.searchsorted(stamps, blocks)
    usual = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    count, at = np.diff(np.append(starts, len(time))), time[np.minimum(starts, len(time) - 1)]
    follows = np.abs(np.diff(at) - usual * count[:-1]) < (0.75 if fitted else 0.1 * usual * count[:-1])
    if fitted:
        for run in np.split(np.arange(len(at)), np.flatnonzero(~follows) + 1):
            first = starts[run] - starts[run[0]]
            rate = np.polyfit(first, at[run], 1)[0] if len(run) >= 100 else usual
            at[run] = np.mean(at[run] - rate * first) + rate * first
    step = np.append(np.where(follows, np.diff(at) / np.maximum(count[:-1], 1), usual), usual)
    inside = np.arange(len(time)) - np.repeat(starts, count)
    time = np.repeat(at, count) + inside * np.repeat(step, count)
    return np.asarray(time - time[0], dtype=np.float64)


# ---- MATLAB


def _mat(path: Path, _: ColumnMap) -> Arrays:
    tree = dict(library("pymatreader").read_mat(str(path)))
    objects, arrays = tree.pop("None", None), tuple(_flat("", tree))
    if objects is not None and not arrays:  # objects of classes, which no reader can unpack
        raise FileFormatError(
            "expected arrays, got MATLAB objects, such as the timetables of MATLAB Mobile. In MATLAB, write each as text, "
            'for example writetimetable(Acceleration, "Acceleration.csv"), and read the text files.'
        )
    return arrays


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            if not str(name).startswith(("__", "#")):
                yield from _flat(f"{prefix}.{name}" if prefix else str(name), inner)
        return
    array = np.asarray(value) if isinstance(value, (np.ndarray, int, float)) else np.empty(0, dtype=object)
    if array.dtype.kind in "fiub":
        array = np.atleast_1d(array.squeeze() if array.ndim == 2 and 1 in array.shape else array)
        # axes in rows, as often in MATLAB code, are transposed; rotation matrices (3, 3, N) become rows of nine
        if array.ndim == 3 and array.shape[:2] == (3, 3):
            array = np.moveaxis(array, 2, 0).reshape(-1, 9)
        by_rows = array.ndim == 2 and array.shape[0] in (3, 4, 6) and array.shape[1] >= 16
        yield prefix, array.T if by_rows else array


def mat_arrays(path: Path) -> Arrays:
    """Return the numeric arrays of a MAT file, version 5 to 7.3, with structs flattened to ``struct.field``."""
    arrays: Arrays = reader("MATLAB", _mat)(path, ColumnMap())
    return arrays


def read_mat(path: Path, how: ColumnMap) -> RawTable:
    """Read the arrays of a MAT file."""
    arrays = mat_arrays(path)
    own = None if how.columns else native_map(tuple(name for name, _ in arrays), how, source=str(path))
    return replace(table_of_arrays(arrays, path, (own or how).wanted()), own=own)


def columns_of_arrays(arrays: Arrays, path: str | Path) -> RawTable:
    """Return arrays as columns, whose lengths may differ. An array (N, K) becomes K columns ``name[0]`` ... ."""
    columns: dict[str, NDArray[Any]] = {}
    for name, array in arrays:
        if array.ndim == 1:
            columns[name] = array
        elif array.ndim == 2:
            columns |= {f"{name}[{k}]": column for k, column in enumerate(array.T)}
    return RawTable(source=str(path), names=tuple(columns), columns=tuple(columns.values()))


def table_of_arrays(arrays: Arrays, path: str | Path, wanted: tuple[Column, ...]) -> RawTable:
    """Return the arrays that are as long as the first array of `wanted`, as a table."""
    table = columns_of_arrays(arrays, path)
    lengths = dict(zip(table.names, map(len, table.columns), strict=True))
    lengths |= {name: len(array) for name, array in arrays if array.ndim == 2}
    listed = ", ".join(f"{name} {array.shape}" for name, array in arrays[:16]) or "no arrays"
    for column in wanted:
        if column not in lengths:
            raise InputError(f"{path}: expected array {column!r}, got {listed}. Check the mapping.")
    rows = {str(column): lengths[str(column)] for column in wanted}
    if len(set(rows.values())) != 1:
        row_counts = ", ".join(f"{name} {count}" for name, count in rows.items())
        raise InputError(
            f"{path}: expected arrays of equal length, got {row_counts} rows. Read arrays with different "
            f"clocks into separate records."
        )
    length = next(iter(rows.values()))
    columns = {name: column for name, column in zip(table.names, table.columns, strict=True) if len(column) == length}
    return replace(table, names=tuple(columns), columns=tuple(columns.values()))


read_xdf, read_ros, read_ulog = reader("XDF", _xdf), reader("ROS", _ros), reader("ULog", _ulog)
read_nilspod, read_logger = reader("NilsPod", _nilspod), reader("logger", _logger)
