"""describe: what a file holds, in one value. It answers for every file that exists and is not damaged.

A recording that reads well may still have a wrong unit, gaps, drop-outs, dead axes or readings stuck at their largest:
``find_symptoms`` looks for them. Nothing here raises for what it finds, or repairs it.
"""

import json
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs
from undrift.errors import InputError
from undrift.files import read_bytes, read_tree
from undrift.findings import Finding, finding
from undrift.io.arrays import Arrays, mat_arrays, npz_arrays
from undrift.io.clock import ClockFit, host_stamps
from undrift.io.columns import (
    AXES,
    READ_SETTINGS,
    Clock,
    Column,
    ColumnMap,
    ReadResult,
    ReadSettings,
    TextLayout,
    is_date,
    is_native,
    is_number,
    native_columns,
)
from undrift.io.formats import Format, format_of, read_counted, read_markers, read_reference
from undrift.io.labelled import is_unit, label_of, marks_of, states_units
from undrift.io.log import log_sheet, log_text
from undrift.io.makers import apdm_sensors
from undrift.io.mocap import Markers, Up
from undrift.io.parquet import parquet_names
from undrift.io.reference import NEARLY_UNIT, ReferenceMap, native_reference
from undrift.io.session import read_map, read_session
from undrift.io.text import MARK, Text, open_text, parse_text
from undrift.record import Record, Reference, Session
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, STANDARD_GRAVITY, is_physical, si_factor

# ---- symptoms

GRAVITY_RANGE = (0.8, 1.25)  # g: a worn sensor's median lies inside
ROOM_C = (-10.0, 45.0)
JUMP_C = 5.0  # between two samples
REST_TURN_RATE = 0.35  # rad/s, 20 deg/s: no gyroscope's offset
UNEVEN = 0.1  # of the median step, between quartiles
STUCK = 8  # samples in a row at the largest reading


def find_symptoms(record: Record) -> tuple[Finding, ...]:
    """Return what looks wrong with a recording."""
    found = [*_gravity(record), *_rest(record), *_temperature(record), *_sampling(record.time)]
    for name in ("gyro", "accel"):
        if getattr(record, name) is not None:
            found += _axes(name, getattr(record, name))
    return (*found, *find_saturated(record))


def gaps_of(record: Record) -> int:
    """Return the number of samples with a gap in any channel."""
    gap = np.zeros(len(record), dtype=np.bool_)
    for values in (record.gyro, record.accel, record.mag_ut, record.temp_c):
        if values is not None:
            gap |= np.isnan(values).reshape(len(record), -1).any(axis=1)
    return int(gap.sum())


def median_accel_g(record: Record) -> float:
    """Return the median length of the specific force."""
    if record.accel is None or not is_physical(record.accel_unit):
        return float("nan")
    size = np.linalg.norm(record.accel, axis=1) * (si_factor(record.accel_unit, "accel") / STANDARD_GRAVITY)
    return float(np.nanmedian(size)) if np.isfinite(size).any() else float("nan")


def _gravity(record: Record) -> Iterator[Finding]:
    median = median_accel_g(record)
    if not np.isnan(median) and not GRAVITY_RANGE[0] <= median <= GRAVITY_RANGE[1]:
        small = 0.0 < median < 1.0
        factor, direction = (1.0 / median, "small") if small else (median, "large")
        units = "g, not m/s2" if small else "m/s2, not g"
        cause = f": acceleration is in {units}" if abs(factor / STANDARD_GRAVITY - 1.0) < 0.2 else ""
        yield finding("recording.gravity", "warn", median_g=median, factor=factor, direction=direction, cause=cause)


def _rest(record: Record) -> Iterator[Finding]:
    """Look at the quietest two seconds: a gyroscope reads its offset there."""
    size = max(8, int(2.0 * record.sample_rate_hz))
    count = len(record) // size
    if record.gyro is None or not is_physical(record.gyro_unit) or count < 3:
        return
    rate = record.gyro * si_factor(record.gyro_unit, "rate")
    blocks = rate[: count * size].reshape(count, size, 3)
    spread = blocks.std(axis=1).sum(axis=1)
    if np.isfinite(spread).any():
        best = int(np.nanargmin(spread))
        mean = float(np.linalg.norm(blocks[best].mean(axis=0)))
        if mean >= REST_TURN_RATE and spread[best] <= 0.1 * mean:
            at_s = record.time[best * size]
            yield finding("recording.rest_rate", "warn", turn_rate_dps=mean / RADIAN_PER_DEGREE, at_s=at_s)


def _temperature(record: Record) -> Iterator[Finding]:
    if record.temp_c is None:
        return
    temp = record.temp_c[np.isfinite(record.temp_c)]
    if not len(temp):
        yield finding("recording.no_temperature", "info")
        return
    low, high = float(temp.min()), float(temp.max())
    if low > ROOM_C[1] or high < ROOM_C[0]:
        yield finding("recording.temperature_range", "warn", low_c=low, high_c=high)
    jumps = np.flatnonzero(np.abs(np.diff(temp)) > JUMP_C)
    if len(jumps):
        first = jumps[0]
        yield finding("recording.temperature_jumps", "warn", count=len(jumps), limit_k=JUMP_C, first_sample=first)


def _sampling(time: FloatArray) -> Iterator[Finding]:
    stamps = host_stamps(time)
    if stamps is not None:
        yield finding(
            "recording.host_clock",
            "warn",
            low_ms=stamps.low_ms,
            high_ms=stamps.high_ms,
            jitter_ms=1e3 * stamps.fit.jitter_s,
            **_clock_values(stamps.fit),
        )
        return
    steps = np.diff(time)
    low, middle, high = np.quantile(steps, 0.25), float(np.median(steps)), np.quantile(steps, 0.75)
    if high - low > UNEVEN * middle:
        yield finding("recording.uneven_sampling", "warn", low_ms=1e3 * low, high_ms=1e3 * high)
    lost = steps > 1.5 * middle
    if lost.any():
        yield finding(
            "recording.dropouts",
            "warn",
            count=lost.sum(),
            longest_s=steps.max(),
            at_s=time[int(steps.argmax())],
            step_ms=1e3 * middle,
            mean_rate_hz=(len(time) - 1) / (time[-1] - time[0]),
        )


def _clock_values(fit: ClockFit) -> dict[str, Any]:
    return {
        "sample_rate_hz": fit.sample_rate_hz,
        "gaps": fit.gaps,
        "missing": fit.missing,
        "longest_s": fit.longest_step_s,
    }


def _axes(channel: str, values: FloatArray) -> Iterator[Finding]:
    for axis, column in zip(AXES, values.T, strict=True):
        column = column[np.isfinite(column)]
        if len(column) < 2 * STUCK:
            continue
        if column.min() == column.max():
            yield finding("recording.dead_axis", "warn", channel=channel, axis=axis)


# ---- readings at the end of the range


def find_saturated(record: Record) -> tuple[Finding, ...]:
    """Return a finding for each end of the range at which an axis of a record sticks."""
    found = []
    for channel, values in (("gyro", record.gyro), ("accel", record.accel)):
        for axis, column in () if values is None else zip(AXES, values.T, strict=True):
            if np.isfinite(column).sum() < 2 * STUCK:
                continue
            for limit, stuck in saturated_runs(column):
                longest = (stuck[:, 1] - stuck[:, 0]).max()
                item = {"channel": channel, "axis": axis, "reading": limit, "count": longest}
                found.append(finding("recording.saturated", "warn", **item))
    return tuple(found)


def saturated_runs(column: FloatArray) -> Iterator[tuple[float, IntArray]]:
    """Return each limit at which readings (N,) stick, and the stretches (R, 2) in which they do."""
    for limit in (np.nanmax(column), np.nanmin(column)):
        if np.count_nonzero(column == limit) >= STUCK:
            stuck = runs(column == limit)
            stuck = stuck[stuck[:, 1] - stuck[:, 0] >= STUCK]
            if len(stuck) and _ends_range(column, float(limit), stuck):
                yield float(limit), stuck


def _ends_range(column: FloatArray, limit: float, stuck: IntArray) -> bool:
    """Tell whether a limit lies far from the middle of the readings, or is large where no others repeat."""
    codes, change = np.unique(column[np.isfinite(column)]), np.abs(np.diff(column))
    away = np.abs(column - np.nanmedian(column))
    usual = np.nanmedian(away)
    if not usual > 0.0:
        return False
    fine = len(codes) > 10 * STUCK  # coarse codes repeat at an end as inside, but are not got to in a jump
    jumped = bool((change[np.clip(stuck - 1, 0, len(change) - 1)] > 5.0 * change[change > 0.0].min()).any())
    begins = np.flatnonzero(np.diff(column, prepend=np.nan) != 0.0)
    inside = (column[begins] != codes[0]) & (column[begins] != codes[-1])
    alone = int(np.diff(np.append(begins, len(column)))[inside].max(initial=0)) < STUCK // 2
    large = abs(limit) > 0.5 * max(abs(codes[0]), abs(codes[-1]))  # no rest of a log without noise
    far = away[stuck[0, 0]] > 10.0 * usual
    return bool((far and (fine or jumped)) or (large and alone and fine))


# ---- guesses for a person, never for a reader: what a foreign table might be, and the map that it may need

_FORCE = re.compile(r"GRF|(?<![A-Za-z])COP|FREEMOMENT|^[FM][xyz]\[")
_PLACE = re.compile(r"^(COG|.*[._](ankle|knee|hip))[._ ][xyz]$", re.IGNORECASE)
_QUATERNION = re.compile(
    r"(?i)^(?P<stem>.*?)(?P<part>[wxyz]|[0-3])\]?( element)?$"
)  # w, qw, q0, seg2_quat_w, QUATERNION_0
_TURNS = re.compile(r"(?i)^$|quat|^q[_.\[]*$|[_. ]q[_.\[]*$|orient|rotat")  # what stands before w, x, y, z
_UNITS = {  # what a name may state of its unit; "?" where it states none, which a reader refuses
    "time": (
        ("us", r"\(?\bus\b|_us\b|micros"),
        ("ms", r"\bms\b|_ms\b|millis"),
        ("ns", r"\bns\b|_ns\b|nanos"),
        ("s", r"\bs\b|_s\b|sec"),
    ),
    "gyro": (("rad/s", r"rad[_/ ]?s"), ("dps", r"dps|deg[_/ ]?s"), ("count", r"raw|count|lsb")),
    "accel": (("m/s2", r"m[_/]?s\^?2"), ("mg", r"\bmg\b|_mg\b"), ("g", r"\(g\)|_g\b"), ("count", r"raw|count|lsb")),
    "temp": (("degC", r"deg ?c|celsius|degrees c"), ("count", r"raw|count|lsb")),
}
_RESULTS: dict[str, set[str]] = {  # what undrift writes as plain JSON, and keys that only it has
    "undrift validate": {"trials", "agreement", "offset", "leave_one_out"},
    "undrift study": {"objective", "tasks", "cohorts", "rivals"},
    "undrift demo": {"calibration", "study", "checks"},
}
_NO_SENSOR = re.compile(r"quat|euler|pos|vel|force|moment|angle|roll|pitch|yaw|mat\[", re.IGNORECASE)
# What |a| at rest may be in each unit; an integer sensor of +-2 to +-16 g reads 1,000 to 20,000 counts and more
_AT_REST = {"g": (0.8, 1.25), "m/s2": (7.8, 12.3), "mg": (800.0, 1250.0), "count": (1250.0, 1e7)}
_STEP = {"s": (2e-4, 0.2), "ms": (0.2, 200.0), "us": (200.0, 2e5), "ns": (2e5, 2e8)}  # between samples, 5 Hz to 5 kHz
# The largest rate: 36 rad/s were more than the 2000 deg/s that gyroscopes reach. Below, noise tells: at rest it is 0.03 to
# 0.3 deg/s, or 0.0005 to 0.005 rad/s
_RATE, _SPREAD_RAD_S = {"rad/s": (1.0, 36.0), "dps": (36.0, 4500.0)}, 0.01
_COUNTS = 200.0  # whole numbers beyond this are an integer sensor's
_TEMP_C = (-30.0, 90.0)
_STATED_RATE = re.compile(
    r"(?i)^\W*(?:fs|sampl\w*[ _]?(?:rate|freq\w*)|output ?rate|rate)\b[^\d\n]{0,12}(\d+(?:\.\d+)?)"
)
_STATED_NAME = re.compile(r"(?i)(^|[._])(fs|sampl\w*_?(rate|freq\w*)(_hz)?)$")
_OF_GYRO = re.compile(r"(?i)^(?!.*(acc|imu)).*(gyr|angular)")  # the name of a file of one sensor
_NAMED = {
    "time": re.compile(
        r"(?i)(time|ts?|timestamp|millis|micros|zeit|tempo|temps|tiempo|tijd)([ _\[(].*)?$|时间|時間|時刻"
    ),
    "temp": re.compile(r"(?i)(board |die )?(temp(?!o\b|s\b)|tmp$|thermo|温度)"),
}
_LIKELY = {
    "gyro": re.compile(r"^(g|gyr|gyro|gyroscope|w|omega|rot)[ _.]?([xyz])\b", re.IGNORECASE),
    "accel": re.compile(r"^(a|acc|accel|accelerometer)[ _.]?([xyz])\b", re.IGNORECASE),
}


def sniff(path: object) -> Text:
    """Open a text table with the delimiter, header and skipped lines that most of it suggests."""
    head = read_bytes(str(path), 1 << 16)
    raw = head.decode("utf-8", "replace").splitlines()[:64]
    if head.startswith(MARK) and len(raw) > 1:  # undrift's own first line, which open_text passes over by itself
        raw = raw[1:]
    at = [k for k, line in enumerate(raw) if line.strip()]
    lines = [raw[k] for k in at]
    body = lines[len(lines) // 2 :] or lines
    delimiter, decimal = marks_of(lines)
    width = max(len(_cells(line, delimiter)) for line in body)
    skip = next((k for k, line in zip(at, lines, strict=True) if len(_cells(line, delimiter)) == width), 0)
    header = not all(is_number(cell, empty=True) or is_date(cell) for cell in _cells(raw[skip], delimiter, decimal))
    if header and (names := _grouped([_cells(line, delimiter) for line in raw[skip : skip + 2]])):
        layout = TextLayout(delimiter=delimiter, skip_rows=skip + 2, header=False, decimal=decimal)
        return replace(open_text(str(path), layout), names=names)
    return open_text(str(path), TextLayout(delimiter=delimiter, skip_rows=skip, header=header, decimal=decimal))


def _grouped(rows: list[list[str]]) -> tuple[str, ...]:
    """Return the names of columns under two header rows, groups over axes and units; none where the second is another row."""
    if len(rows) < 2 or len(rows[0]) != len(rows[1]) or "" not in rows[0]:
        return ()
    of_axes = all(cell == "" or re.fullmatch("(?i)[wxyz]", cell) or is_unit(cell) for cell in rows[1])
    named = [k for k, cell in enumerate(rows[0]) if cell]
    groups = [next((rows[0][k] for k in reversed(named) if k <= at), "") for at in range(len(rows[0]))]
    return tuple(f"{group} {cell}".strip() for group, cell in zip(groups, rows[1], strict=True)) if of_axes else ()


def foreign_kind(text: Text) -> str | None:
    """Name a table that is no recording of an inertial sensor."""
    names = [name for name in text.names if name.strip()]
    shown = ", ".join(names[:4])
    for pattern, what in ((_FORCE, "a force plate's table"), (_PLACE, "a table of positions")):
        if any(pattern.search(name) for name in names):
            return f"{what} ({shown}, ...), not a recording of an inertial sensor"
    lines = text.head.decode("utf-8", "replace").splitlines()
    first = lines[text.skip : text.skip + 2]  # one may be of units
    rows = [_cells(line, text.layout.delimiter, text.layout.decimal) for line in first]
    if rows and all(sum(is_number(cell, empty=True) for cell in row) < 0.5 * len(row) for row in rows):
        return f"a table of text ({len(names)} columns: {shown}, ...), not a recording"
    triples = triples_of(text.names)
    if text.layout.header and not triples:
        return f"a table without three axes ({', '.join(names[:8])}), not a recording of an inertial sensor"
    if triples and all(_is_magnetic(name) for triple in triples for name in triple):
        return f"a magnetometer's table ({shown}), without gyroscope or accelerometer"
    return None


def quaternion_of_names(names: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return the names of four columns w, x, y, z of one orientation; numbered ones are taken in their order, w first."""
    parts: dict[str, dict[str, str]] = {}
    for name in names:
        if (found := _QUATERNION.match(name.strip())) and _TURNS.search(found["stem"]):
            parts.setdefault(found["stem"], {})[found["part"].lower()] = name
    fours = (
        tuple(held[part] for part in order)
        for held in parts.values()
        for order in ("wxyz", "0123")
        if {*order} <= held.keys()
    )
    return next(fours, None)


def reference_map(text: Text, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return an example of the map that a table of orientations needs, none where it holds none or a gyroscope too."""
    four, readings = quaternion_of_names(names), partial(_readings, text, {})
    gyro = any(label is not None and label.channel == "gyro" for label in map(label_of, names))
    length = np.linalg.norm(readings(list(four)), axis=1) if four and not gyro else np.empty(0)
    if not four or not len(length) or abs(float(np.median(length)) - 1.0) > NEARLY_UNIT:
        return ()
    clock = next((name for name in names if _NAMED["time"].match(name.strip())), None)
    columns = f"quaternion = {_quoted(four)}"
    if clock is None:
        lines = [f"columns = {{ {columns} }}", f"sample_rate_hz = {_stated_rate(text, ())}"]
    else:
        keys, unit = {"time": _quoted(clock)}, _unit_of("time", clock)
        unit, why = proposed_units(readings, keys, {"time": unit}).get("time", (unit, ""))
        lines = [f"columns = {{ time = {_quoted(clock)}, {columns} }}", f"units = {{ time = {_quoted(unit)} }}"]
        lines[1] += f"  # proposed: time by {why}" * bool(why)
    layout = ", ".join(f"{key} = {json.dumps(value)}" for key, value in stated_layout(text.layout).items())
    return (*lines, *([f"layout = {{ {layout} }}"] if layout else []))


def stated_layout(layout: TextLayout) -> dict[str, Any]:
    """Return what of a layout is not usual."""
    usual = TextLayout()
    return {
        key: held
        for key in ("delimiter", "decimal", "header", "skip_rows")
        if (held := getattr(layout, key)) != getattr(usual, key)
    }


def _is_magnetic(name: str) -> bool:
    label = label_of(name)
    return re.search(r"a\.u\.|uT|gauss|\(G\)", name) is not None or (label is not None and label.channel == "mag")


def triples_of(names: tuple[str, ...]) -> tuple[tuple[str, str, str], ...]:
    """Return names that differ only in an x, y, z: three axes of one quantity."""
    held, found = set(names), []
    for name in names:
        for match in re.finditer("[xX]", name):
            at, (y, z) = match.start(), ("yz" if match.group() == "x" else "YZ")
            triple = (name, f"{name[:at]}{y}{name[at + 1 :]}", f"{name[:at]}{z}{name[at + 1 :]}")
            if triple[1] in held and triple[2] in held:
                found.append(triple)
    return tuple(found)


def example_map(names: tuple[str, ...], text: Text | None, arrays: Arrays) -> tuple[str, ...]:
    """Return an example of the map that a table needs; a unit that nothing states or suggests is "?", for a person to fill in."""
    readings = partial(_readings, text, dict(arrays))
    below = [] if text is None else text.head.decode("utf-8", "replace").splitlines()[text.skip : text.skip + 1]
    cells = [] if text is None or not below else _cells(below[0], text.layout.delimiter, text.layout.decimal)
    row = {} if text is None else dict(zip(text.names, cells, strict=False))
    nameless = text is not None and not text.layout.header and names[-1].isdecimal()
    several = _by_position(text) if text is not None and nameless else [_by_name(names, text, arrays)]
    held = []
    for keys in several:  # gravity tells which three are the accelerometer
        known = {channel: _unit_of(channel, value) for channel, value in keys.items()}
        if known.get("time") == "?" and is_date(row.get(str(_listed(keys["time"])[0]), "")):
            known["time"] = "date"
        held.append((keys, known, proposed_units(readings, keys, known)))
    keys, known, proposed = max(held, key=lambda item: len(item[2]) * ("accel" in item[2]))
    if text is not None and not text.layout.header and not nameless:  # under two header rows, which a map passes over
        keys = {
            channel: json.dumps([names.index(str(name)) for name in _listed(value)]) for channel, value in keys.items()
        }
        keys |= {channel: keys[channel].strip("[]") for channel in ("time", "temp") if channel in keys}
    columns = ", ".join(f"{channel} = {value}" for channel, value in keys.items())
    known |= {channel: unit for channel, (unit, _) in proposed.items()}
    units = ", ".join(f'{channel} = "{unit}"' for channel, unit in known.items())
    why = "; ".join(f"{channel} by {why}" for channel, (_, why) in proposed.items())
    lines = [f"columns = {{ {columns} }}", f"units = {{ {units} }}" + f"  # proposed: {why}" * bool(why)]
    lines += [] if "time" in keys else [f"sample_rate_hz = {_stated_rate(text, arrays)}"]
    if text is not None:
        lines += [f"{key} = {json.dumps(held)}" for key, held in stated_layout(text.layout).items()]
        mapped = [row.get(str(column), "") for value in keys.values() for column in _listed(value)]
        words = any(not is_number(cell, empty=True) and not is_date(cell) for cell in mapped)
        lines += ["drop_bad_rows = true  # the row of units"] if words and text.layout.header else []
    return tuple(lines)


def _by_name(names: tuple[str, ...], text: Text | None, arrays: Arrays) -> dict[str, str]:
    """Return the columns of each channel, as a map writes them."""
    keys: dict[str, str] = {}
    triples = {triple[0]: _quoted(triple) for triple in triples_of(names)}
    threes = {name: _quoted(name) for name, array in arrays if array.ndim == 2 and array.shape[1] == 3}
    quoted = threes or triples
    labels = {name: label_of(name) for name in quoted}
    bare = [name for name, label in labels.items() if label is None and not _NO_SENSOR.search(name)] * (not threes)
    of_gyro = text is not None and _OF_GYRO.search(text.path.name) is not None
    for channel, others in (("gyro", bare if of_gyro else []), ("accel", [] if of_gyro else bare)):
        named = [name for name, label in labels.items() if label is not None and label.channel == channel]
        first = _likely(channel, tuple(quoted if threes else named)) or next(iter([*named, *others]), None)
        if first is not None:
            keys[channel] = quoted[first]
    for channel, pattern in _NAMED.items():
        name = next((n for n in names if pattern.match(n.strip().rpartition(".")[2])), None)
        if name is not None:
            keys = {channel: _quoted(name), **keys} if channel == "time" else {**keys, channel: _quoted(name)}
    return keys or {"gyro": '["gx", "gy", "gz"]', "accel": '["ax", "ay", "az"]'}


def _quoted(columns: object) -> str:
    return json.dumps(columns, ensure_ascii=False)


def _listed(value: str) -> list[Column]:
    columns = json.loads(value)
    return columns if isinstance(columns, list) else [columns]


def proposed_units(
    readings: Callable[[list[Column]], FloatArray], keys: dict[str, str], known: dict[str, str]
) -> dict[str, tuple[str, str]]:
    """Return units of channels that no name states, and the figure that suggests each: never more than a proposal."""
    held = {channel: readings(_listed(keys[channel])) for channel in keys if known[channel] == "?"}
    held = {channel: values for channel, values in held.items() if len(values) > 1}
    found: dict[str, tuple[str, str]] = {}

    def propose(channel: str, value: float, ranges: dict[str, tuple[float, float]], what: str) -> None:
        unit = next((unit for unit, (low, high) in ranges.items() if low <= value < high), None)
        if unit is not None:
            found[channel] = (unit, f"{what} {value:.4g}")

    if "accel" in held and held["accel"].shape[1] == 3:
        propose("accel", float(np.median(np.linalg.norm(held["accel"], axis=1))), _AT_REST, "the median |a|")
    if "gyro" in held:
        largest, whole = float(np.abs(held["gyro"]).max()), np.array_equal(held["gyro"], np.round(held["gyro"]))
        if whole and (largest > _COUNTS or found.get("accel", ("", ""))[0] == "count"):
            found["gyro"] = ("count", f"whole numbers up to {largest:.4g}")
        elif not whole and (largest >= _RATE["dps"][0] or _least_spread(held["gyro"]) < _SPREAD_RAD_S):
            propose("gyro", largest, _RATE, "the largest rate")
    if "time" in held and (step := float(np.median(np.diff(held["time"][:, 0])))) != 1.0:  # of a counter, or 1 ms
        propose("time", step, _STEP, "the median step")
    if "temp" in held and not np.array_equal(held["temp"], np.round(held["temp"])):
        propose("temp", float(np.median(held["temp"])), {"degC": _TEMP_C}, "the median")
    return found


def _least_spread(values: FloatArray) -> float:
    """Return the standard deviation of the quietest 100 samples in a row, the mean of the axes."""
    count = len(values) // 100
    if count == 0:
        return float("inf")
    return float(values[: 100 * count].reshape(count, 100, -1).std(axis=1).mean(axis=1).min())


def _stated_rate(text: Text | None, arrays: Arrays) -> str:
    """Return the sample rate that a line before the header or an array of one number states, "?" where none does."""
    for name, array in arrays:
        if array.size == 1 and _STATED_NAME.search(name) and np.ravel(array)[0] > 0:
            return f"{float(np.ravel(array)[0]):g}  # by {name}"
    for line in [] if text is None else text.head.decode("utf-8", "replace").splitlines()[: text.layout.skip_rows]:
        if found := _STATED_RATE.search(line):
            return f"{float(found.group(1)):g}  # by the line {json.dumps(line.strip()[:40])}"
    return "?"


def _readings(text: Text | None, arrays: dict[str, Any], columns: list[Column]) -> FloatArray:
    """Return columns of the first MiB of text, or of an array, (N, K) without gaps; none where there are none."""
    values = arrays.get(str(columns[0]))
    if text is not None:
        whole = text.content is None and len(text.head) < 1 << 20
        head = text.head if whole else text.head[: text.head.rfind(b"\n") + 1]
        try:
            rows = replace(text, content=head, layout=replace(text.layout, drop_bad_rows=True))
            table = parse_text(rows, tuple(columns))
            values = np.stack([table.numbers(column) for column in columns], axis=1)
        except InputError:
            values = None
    if values is None or values.dtype.kind not in "fiu" or values.ndim > 2 or not values.size:
        return np.empty((0, 1))
    values = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    return values[np.isfinite(values).all(axis=1)]


def _unit_of(channel: str, names: str) -> str:
    stated = [label_of(name) for name in re.findall(r'"([^"]*)"', names)]
    if stated and stated[0] is not None and stated[0].unit and stated[0].gain == 1.0 and stated[0].channel == channel:
        return stated[0].unit
    return next((unit for unit, stated in _UNITS[channel] if re.search(stated, names, re.IGNORECASE)), "?")


def _by_position(text: Text) -> list[dict[str, str]]:
    """Return what a table without names may hold: a growing first column is time, another odd one temperature."""
    width = len(text.names)
    lines = [line for line in text.head.decode("utf-8", "replace").splitlines()[text.skip :] if line.strip()][:8]
    first = [_cells(line, text.layout.delimiter, text.layout.decimal)[0] for line in lines]
    numbers = [float(cell) for cell in first if cell and is_number(cell, empty=True)]
    grows = (all(b > a for a, b in pairwise(numbers)) and len(numbers) > 1) or all(map(is_date, first))
    odd = [{"time": 0}] if grows else [{"temp": 0}, {"temp": width - 1}] if width % 3 == 1 else [{}]
    found = []
    for keys in odd:
        free = [k for k in range(width) if k not in keys.values()]
        threes = [str(free[k : k + 3]) for k in (0, 3) if k + 3 <= len(free)]
        named = ("gyro",) if _OF_GYRO.search(text.path.name) else ("accel", "gyro")
        for order in (named, named[::-1])[: len(threes)]:
            channels = dict(zip(order, threes, strict=False))
            found.append(
                {channel: str(k) for channel, k in keys.items()} | {c: channels[c] for c in named if c in channels}
            )
    return found or [{}]


def _likely(channel: str, names: tuple[str, ...]) -> str | None:
    stem = "gyr" if channel == "gyro" else "acc"
    return next((name for name in names if stem in name.lower() or _LIKELY[channel].match(name.strip())), None)


def _cells(line: str, delimiter: str, decimal: str = ".") -> list[str]:
    line = line.replace(decimal, ".")
    return line.split() if delimiter == " " else line.split(delimiter)


# ---- describe

_MISSING = ("sensor", "sample_rate_hz", "columns", "readings")  # what an intact file may leave unstated
_TABLES = ("npz", "mat", "parquet", "csv", "log", "text")  # what a map makes a recording of
_REGULAR = 0.005  # mean and usual rate that differ by less are one figure


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """What a file holds."""

    path: str
    # recording, set-points, reference, markers, session, calibration, device, table (needs a map), results, settings, text or
    # binary
    kind: str
    format: str  # A name of io.formats.FORMATS, or of another package's
    summary: str  # One line: what it is, or what it needs to be read
    rows: int | None = None  # Samples or frames
    sample_rate_hz: float | None = None  # Samples over time: what is lost or uneven counts
    usual_rate_hz: float | None = None  # By the usual step, drop-outs left out
    duration_s: float | None = None
    columns: tuple[str, ...] = ()  # Channels, markers, or column names
    units: tuple[tuple[str, str], ...] = ()  # Channel and unit
    gaps: int = 0  # Samples with a gap
    temp_c: tuple[float, float] | None = None  # Lowest and highest
    findings: tuple[Finding, ...] = ()
    # Lines of the map that a table of foreign names may need, "?" where a person must state the unit
    example: tuple[str, ...] = ()
    # What was read: a session, or a recording as a session of one
    session: Session | None = field(default=None, repr=False)

    @property
    def problems(self) -> tuple[str, ...]:
        """The findings as texts, but how the file was read."""
        return tuple(_told(item) for item in self.findings if item.code != "recording.how_read")

    def lines(self) -> tuple[str, ...]:
        """Return every finding as a line that says what it is: how the file was read, a note, or a problem."""
        return tuple(
            f"{'read' if item.code == 'recording.how_read' else 'note' if item.level == 'info' else 'problem'}: {_told(item)}"
            for item in self.findings
            if item.text != self.summary
        )


def _told(item: Finding) -> str:
    """Return the text of a finding, with the recording of a session that it is about."""
    return f"recording {item.values['recording']}: {item.text}" if "recording" in item.values else item.text


def describe(
    path: str | Path, columns: ColumnMap | None = None, *, settings: ReadSettings | None = None, up: Up | None = None
) -> Description:
    """Return what a file holds."""
    path, settings = Path(path), settings or READ_SETTINGS
    name, entry = format_of(path)
    if entry.markers is not None:
        return _markers(path, name, up)
    if name == "session":
        return _session(path, settings.clock)
    if name in ("json", "toml"):
        return _settings(path, name, settings.clock)
    if entry.record is None and columns is None:
        return _reference(path, name) if entry.reference or entry.bodies else _unread(path, name, entry)
    needs = None if columns is not None else _needs(path, name, settings)
    if needs is not None:
        return needs
    try:
        read = read_counted(path, columns, settings=settings)
    except InputError as error:
        missing = error.numbers.get("missing")
        if missing not in _MISSING:
            raise
        if missing == "readings" and name in ("xsens", "dot"):
            return _reference(path, name)
        names = error.numbers.get("names")
        shown = tuple(map(str, names)) if isinstance(names, tuple) else ()
        found = _not_read(path, name, shown, str(error).removeprefix(f"{path}: "), missing=str(missing))
        example = error.numbers.get("example")
        return replace(found, example=tuple(map(str, example)) if isinstance(example, tuple) else ())
    found = describe_record(read, path=str(path), format_name=name)
    if columns is None and name in ("csv", "parquet"):
        names = sniff(path).names if name == "csv" else parquet_names(path)
        unread = tuple(other for other in names if other not in found.columns)
        if unread:
            left = finding("recording.other_columns", "info", names=unread[:12])
            found = replace(found, findings=(*found.findings, left))
    if name == "broad":
        seen = 100.0 * float(read_reference(path).valid.mean())
        summary = f"{found.summary}, with optical poses ({seen:.1f} % seen, rest and motion together)"
        found = replace(found, summary=summary)
    return found


def describe_record(read: ReadResult, *, path: str = "", format_name: str = "csv") -> Description:
    """Return what a record holds."""
    record, mean, usual = read.record, mean_rate_hz(read.record), read.record.sample_rate_hz
    left_out = [finding("recording.how_read", "info", what=note) for note in read.notes]
    left_out += [finding("recording.rows_dropped", "warn", count=read.dropped_rows)] if read.dropped_rows else []
    if read.repaired_rows:
        left_out.append(finding("recording.rows_repaired", "warn", count=read.repaired_rows))
    if read.clock is not None:
        by = "the device's counter" if read.clock.counted else "steps of the stamps"
        found = {**_clock_values(read.clock), "jitter_ms": 1e3 * read.clock.jitter_s, "by": by}
        left_out.append(finding("recording.clock_fitted", "info", **found))
    rate = f"{mean:.6g} Hz"
    if abs(mean / usual - 1.0) >= _REGULAR:
        rate = f"{mean:.4g} Hz on average (usual step {1e3 / usual:.4g} ms, {usual:.4g} Hz)"
    return Description(
        path=path,
        kind="recording",
        format=format_name,
        summary=f"{len(record)} samples at {rate}, {record.duration_s:.6g} s"
        + f", {record.device}" * bool(record.device),
        findings=(*left_out, *find_symptoms(record)),
        session=Session(kind="calibration", serial="", gravity_m_s2=STANDARD_GRAVITY, records=(record,)),
        **_of_records(record),
    )


def _of_records(*records: Record) -> dict[str, Any]:
    """Return what a description says of recordings: columns and units of the first, the rest of all."""
    first = records[0]
    channels = {
        "time": ("s", first.time),
        "gyro": (first.gyro_unit, first.gyro),
        "accel": (first.accel_unit, first.accel),
    }
    channels |= {"temp": ("degC", first.temp_c), "mag": ("uT", first.mag_ut)}
    seen = [t[np.isfinite(t)] for t in (record.temp_c for record in records) if t is not None]
    temp_c = np.concatenate(seen) if seen else np.empty(0)
    return {
        "rows": sum(len(record) for record in records),
        "sample_rate_hz": mean_rate_hz(*records),
        "usual_rate_hz": first.sample_rate_hz,
        "duration_s": sum(record.duration_s for record in records),
        "columns": native_columns(first)[0],
        "units": tuple((name, unit) for name, (unit, values) in channels.items() if values is not None),
        "gaps": sum(gaps_of(record) for record in records),
        "temp_c": (float(temp_c.min()), float(temp_c.max())) if len(temp_c) else None,
    }


def mean_rate_hz(*records: Record) -> float:
    """Return samples over time, drop-outs included."""
    return sum(len(record) - 1 for record in records) / sum(record.duration_s for record in records)


def needs_map(path: str | Path) -> bool:
    """Tell whether a file is a table that only a map can read: neither undrift's own names nor a format that states its units."""
    path = Path(path)
    name, _ = format_of(path)
    if name not in _TABLES:
        return False
    return name == "text" or not is_native(_table_names(path, name, _text(path, name))[0])


def _text(path: Path, name: str) -> Text | None:
    """Return the text of a table, None of arrays."""
    return sniff(path) if name == "csv" else log_text(path) if name == "log" else None


def _table_names(path: Path, name: str, text: Text | None) -> tuple[tuple[str, ...], tuple[tuple[str, Any], ...]]:
    """Return the names of a table, and its arrays where it holds arrays."""
    arrays = npz_arrays(path) if name == "npz" else mat_arrays(path) if name == "mat" else ()
    names = text.names if text else parquet_names(path) if name == "parquet" else tuple(key for key, _ in arrays)
    return names, arrays


def _needs(path: Path, name: str, settings: ReadSettings) -> Description | None:
    """Return the description of a file that cannot be read without more settings, None where it can."""
    if name == "ximu" and settings.sample_rate_hz is None:
        what = "an x-IMU recording; needs its sample rate: give sample_rate_hz (256 as delivered)"
        return _not_read(path, name, (), what, missing="sample_rate_hz")
    if name == "apdm" and settings.sensor is None:
        held = apdm_sensors(path)
        what = f"APDM sensors {', '.join(held)}; needs the name of one of them as sensor"
        return _not_read(path, name, held, what, missing="sensor") if len(held) > 1 else None
    if name not in _TABLES or name == "text":
        return None
    if name == "log" and states_units(log_sheet(path)):
        return None
    text = _text(path, name)
    names, arrays = _table_names(path, name, text)
    if native_reference(names) is not None:
        return _reference(path, name)
    if is_native(names):
        return None
    if text is not None and (poses := reference_map(text, names)):
        what = "a table of orientations, to be read as a reference; needs a map"
        return replace(_not_read(path, name, names, what), example=poses)
    foreign = None if text is None else foreign_kind(text)
    if foreign is not None:
        return _not_read(path, name, names, foreign)
    if (
        name in ("npz", "mat")
        and not any(array.ndim == 2 and array.shape[1] == 3 for _, array in arrays)
        and not triples_of(names)
    ):
        what = f"arrays without three axes ({', '.join(names[:4])}), not a recording of an inertial sensor"
        return _not_read(path, name, names, what)
    example = example_map(names, text, arrays)
    what = f"{len(names)} arrays or columns"
    if text is not None:
        what = f"a table of {len(names)} columns" + " without names" * names[-1].isdecimal()
    shown = tuple(f"{key} {array.shape}" for key, array in arrays) or names
    needed = f"{what}; needs a map with the true units, for example {', '.join(example)}"
    return replace(_not_read(path, name, shown, needed), example=example)


def _not_read(path: Path, name: str, columns: tuple[str, ...], what: str, *, missing: str = "") -> Description:
    findings = (finding("recording.not_read", "warn", what=what, missing=missing),)
    return Description(path=str(path), kind="table", format=name, summary=what, columns=columns, findings=findings)


def describe_poses(path: Path, columns: ReferenceMap) -> Description:
    """Return what a table of orientations holds by its map."""
    return _reference(path, format_of(path)[0], columns)


def _reference(path: Path, name: str, columns: ReferenceMap | None = None) -> Description:
    names: tuple[str, ...] = ()
    try:
        reference = read_reference(path, columns)
    except InputError as error:
        held = error.numbers.get("names")
        if error.numbers.get("missing") == "sample_rate_hz":
            return _not_read(path, name, (), str(error).removeprefix(f"{path}: "), missing="sample_rate_hz")
        if not isinstance(held, tuple):
            raise
        names = tuple(map(str, held))
        reference = read_reference(path, labels=names[:1])
    seen = int(reference.valid.sum())
    more = f" of each of {len(names)} bodies ({', '.join(names)}); name one" if names else ""
    more += f", {reference.name.removeprefix(path.name).strip()}" if name in ("xsens", "dot") else ""
    return Description(
        path=str(path),
        kind="reference",
        format=name,
        summary=f"{len(reference)} poses at {reference.sample_rate_hz:.6g} Hz, {seen} seen{more.rstrip(', ')}",
        columns=names,
        gaps=len(reference) - seen,
        findings=tuple(_sampling(reference.time)),
        **_of_clock(reference),
    )


def _markers(path: Path, name: str, up: Up | None) -> Description:
    findings: list[Finding] = []
    try:
        markers = read_markers(path, up=up)
    except InputError as error:
        if error.numbers.get("missing") != "up":
            raise
        markers = read_markers(path, up="z")
        findings.append(finding("recording.up_axis", "warn"))
    gap: BoolArray = np.any(np.isnan(markers.points), axis=2)
    never = [label for k, label in enumerate(markers.labels) if gap[:, k].all()]
    findings += [finding("recording.markers_never_seen", "warn", labels=never)] if never else []
    findings += [finding("recording.short_rows", "warn", count=markers.short_rows)] if markers.short_rows else []
    return Description(
        path=str(path),
        kind="markers",
        format=name,
        summary=f"{len(markers.labels)} markers, {len(markers)} frames at {markers.sample_rate_hz:.6g} Hz",
        columns=markers.labels,
        units=(("position", SI_UNIT["length"]),),
        gaps=int(gap.any(axis=1).sum()),
        findings=tuple(findings),
        **_of_clock(markers),
    )


def _of_clock(held: Reference | Markers) -> dict[str, Any]:
    duration_s = float(held.time[-1] - held.time[0])
    return {"rows": len(held), "sample_rate_hz": held.sample_rate_hz, "duration_s": duration_s}


def _session(path: Path, clock: Clock | None = None) -> Description:
    session = read_session(path, clock=clock)
    counts = ((session.records, "recording"), (session.stills, "still"), (session.turns, "turn"))
    held = ", ".join(f"{len(items)} {what}{'s' * (len(items) != 1)}" for items, what in counts)
    return Description(
        path=str(path),
        kind="session",
        format="session",
        summary=f"{session.kind} of {session.serial}: {held}",
        session=session,
        findings=tuple(
            replace(item, values={**item.values, "recording": number})
            for number, record in enumerate(session.records)
            for item in find_symptoms(record)
        ),
        **_of_records(*session.records),
    )


def _settings(path: Path, name: str, clock: Clock | None) -> Description:
    kind = "settings"
    if name == "toml":
        if path.name == "session.toml":
            return _session(path, clock)
        summary = "TOML settings, not a column map"
        with suppress(InputError):
            columns, _ = read_map(path)
            if columns is not None:
                summary = f"a column map of {', '.join(columns.mapped())}"
        return Description(path=str(path), kind=kind, format=name, summary=summary)
    content = read_tree(path)
    try:
        held = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: wanted JSON, got something else: {error}; repair the file") from error
    keys = held if isinstance(held, dict) else {}
    listed = ", ".join(list(keys)[:8])
    if keys.get("kind") == "undrift.calibration":
        device = keys.get("device") or "a device without a serial number"
        kind, summary = "calibration", f"calibration of {device}, format {keys.get('format')}"
    elif keys.get("kind") == "undrift.prior":
        kind, summary = "prior", f"prior of a part, learnt from {keys.get('devices')} devices"
    elif keys.get("kind") == "undrift.device":
        device = " ".join(str(keys[key]) for key in ("name", "serial") if keys.get(key)) or "without a name"
        kind, summary = "device", f"device model {device}, format {keys.get('format')}"
    elif command := next((command for command, own in _RESULTS.items() if own <= keys.keys()), ""):
        kind, summary = "results", f"results of {command}, not a recording: {listed}"
    else:
        what = listed if isinstance(held, dict) else f"a list of {len(held)}" if isinstance(held, list) else "a value"
        summary = f"JSON, not a recording: {what}"
    return Description(path=str(path), kind=kind, format=name, summary=summary)


def _unread(path: Path, name: str, entry: Format) -> Description:
    summary = entry.instead or name
    if name == "text":
        lines = read_bytes(path, 4096).decode("utf-8", "replace").splitlines()
        first = next((line.strip() for line in lines if line.strip()), "")
        summary = f"{summary}: {first[:60]}"
    kind = "binary" if b"\0" in read_bytes(path, 4096) else "text"
    return Description(path=str(path), kind=kind, format=name, summary=summary)
