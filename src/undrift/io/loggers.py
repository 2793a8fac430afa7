"""Wrist loggers by their makers' documents: Axivity .cwa, GENEActiv .bin, ActiGraph .gt3x.

    Axivity    accel = count / 2^(8 + n) g (packed: 1/256 g)      gyro = count / 32768 * 8000 / 2^n deg/s
               temp_c = raw * 75 / 256 - 50                       Open Movement, Docs/ax3/cwa.h
    GENEActiv  accel = (100 count - offset) / gain g              Activinsights, GENEActiv instructions, section 16.ii
    ActiGraph  accel = count / 341 g, or the scale of the file    github.com/actigraph: NHANES-GT3X-File-Format, GT3X-File-Format

Axivity's temperature is one raw value a sector; other programs convert it by other formulas, up to 9 degC apart, so the raw range
is stated with the formula. These clocks are local time without a zone: time starts at 0, and a note states the date.
A damaged block ends reading; with drop_bad_rows it is left out and counted.
"""

import re
import struct
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import FileFormatError
from undrift.files import read_bytes
from undrift.io.columns import ColumnMap, ReadResult, ReadSettings
from undrift.io.containers import build, chosen, sound

Columns = ColumnMap | None
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

_SECTOR = np.dtype(
    {
        "names": [
            "tag",
            "size",
            "fraction",
            "sequence",
            "stamp",
            "scale",
            "temp",
            "rate",
            "axes",
            "at",
            "count",
            "data",
        ],
        "formats": ["<u2", "<u2", "<u2", "<u4", "<u4", "<u2", "<u2", "u1", "u1", "<i2", "<u2", "(480,)u1"],
        "offsets": [0, 2, 4, 10, 14, 18, 20, 24, 25, 26, 28, 30],
        "itemsize": 512,
    }
)


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
    bits = np.frombuffer(
        bytes.fromhex("".join(line for line, fine in zip(lines, whole, strict=True) if fine)), np.uint8
    )
    b = bits.reshape(-1, 6).astype(np.int64)
    counts = np.stack((b[:, 0] << 4 | b[:, 1] >> 4, (b[:, 1] & 15) << 8 | b[:, 2], b[:, 3] << 4 | b[:, 4] >> 4), axis=1)
    rate_hz = rates.pop()
    starts, fitted = _page_starts((stamps - stamps[0]).astype(np.int64) * 1e-3, number, rate_hz)
    step = np.append(np.where(np.diff(starts) < 330.0 / rate_hz, np.diff(starts) / 300.0, 1.0 / rate_hz), 1.0 / rate_hz)
    time = (starts[:, None] + np.arange(300) * step[:, None]).ravel()
    channels: dict[str, tuple[FloatArray, str]] = {
        "accel": ((100.0 * _signed(counts, 12) - offset) / gain, "g"),
        "temp": (np.interp(time, starts, temp_c), "degC"),
    }
    source = f"page stamps of {len(kept)} pages" if fitted else f"the stated {rate_hz:g} Hz (page stamps have 0.5 s)"
    notes = [_clock(stamps[0]), f"sample times by {source}", "gain and offset of the maker's calibration are applied"]
    notes += [f"{missing} of {announced} pages are missing: the file is cut"] * (missing > 0)
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
        name = next((n for n in ("log.bin", "log.txt", "activity.bin") if n in held.namelist()), "")
        info = _fields(held.read("info.txt").decode("utf-8", "replace").replace("\r\n", "\n"))
        content = held.read(name) if name else b""
    if not content or not _number(info.get("Sample Rate", "")) > 0.0:
        raise FileFormatError(
            f"{path}: wanted activity.bin or log.bin and a Sample Rate, got none; copy the file again"
        )
    return info, name, content


def read_gt3x(path: Path, _: Columns, settings: ReadSettings) -> ReadResult:
    """Read an ActiGraph .gt3x file: sensor "accelerometer" (the primary one), or "imu" of a GT9X Link."""
    info, name, content = _unzipped(path)
    device = info.get("Serial Number", "")
    if name != "activity.bin":
        return _read_log(path, _records(path, content), device, settings)
    rate_hz = _number(info["Sample Rate"])
    accel = _twelve_bit(content) / 341.0
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (accel == 0.0).all(axis=1), [0]))))
    keep = np.ones(len(accel), dtype=np.bool_)
    for start, stop in edges.reshape(-1, 2):
        keep[start:stop] = stop - start < rate_hz
    ticks = info.get("Start Date", "")
    notes = [_clock(np.datetime64((int(ticks) - _TICKS) // 10_000_000, "s"))] if ticks.isdigit() else []
    if not keep.all():
        notes.append(
            f"{int((~keep).sum())} of {len(keep)} samples left out: exactly 0, 0, 0 for a second or more (no data)"
        )
    time = np.flatnonzero(keep) / rate_hz
    return build(path, time, {"accel": (accel[keep], "g")}, settings, notes, device=device)


def _twelve_bit(content: bytes) -> FloatArray:
    """Return x, y, z counts (N, 3) of 12 bits each, stored as y, x, z, high bits first."""
    values = len(content) * 8 // 12 // 3 * 3
    b = np.frombuffer(content + bytes(-len(content) % 3), np.uint8).reshape(-1, 3).astype(np.int64)
    pairs = np.stack((b[:, 0] << 4 | b[:, 1] >> 4, (b[:, 1] & 15) << 8 | b[:, 2]), axis=1).ravel()
    return _signed(pairs[:values], 12).reshape(-1, 3)[:, [1, 0, 2]].astype(np.float64)


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
        found = [(when, _twelve_bit(body)) for when, body in held.get(_ACTIVITY, []) if len(body) > 1]
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
