"""Proposals for a person, never for a reader: the kind of a foreign table, and the map that it may need.

Channel and unit come from names or from the readings: gravity has constant length on three axes, a quaternion has
length 1, a counter increases. An unknown entry is "?".
"""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.files import read_bytes
from undrift.io.arrays import Arrays
from undrift.io.columns import Column, TextLayout, is_date, is_number
from undrift.io.labelled import label_of, marks_of
from undrift.io.reference import NEARLY_UNIT
from undrift.io.text import Text, open_text, parse_text

_FORCE = re.compile(r"GRF|(?<![A-Za-z])COP|FREEMOMENT|^[FM][xyz]\[")
_PLACE = re.compile(r"^(COG|.*[._](ankle|knee|hip))[._ ][xyz]$", re.IGNORECASE)
_QUATERNION = re.compile(
    r"(?i)^(?P<stem>.*?)(?P<part>[wxyz]|[0-3])\]?( element)?$"
)  # w, qw, q0, seg2_quat_w, QUATERNION_0
_TURNS = re.compile(r"(?i)^$|quat|^q[_.\[]*$|[_. ]q[_.\[]*$|orient|rotat")  # the text before w, x, y, z
_UNITS = {  # units in a column name; "?" for an unknown unit, which a reader refuses
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
_NO_SENSOR = re.compile(r"quat|euler|pos|vel|force|moment|angle|roll|pitch|yaw|mat\[", re.IGNORECASE)
# range of |a| at rest in each unit (an integer sensor of +-2 to +-16 g reads 1,000 to 20,000 counts and more)
_AT_REST = {"g": (0.8, 1.25), "m/s2": (7.8, 12.3), "mg": (800.0, 1250.0), "count": (1250.0, 1e7)}
_STEP = {"s": (2e-4, 0.2), "ms": (0.2, 200.0), "us": (200.0, 2e5), "ns": (2e5, 2e8)}  # between samples, 5 Hz to 5 kHz
# The largest rate: 36 rad/s exceeds the 2000 deg/s that gyroscopes reach. Smaller values are judged by the noise at
# rest: it is 0.03 to 0.3 deg/s, or 0.0005 to 0.005 rad/s
_RATE, _SPREAD_RAD_S = {"rad/s": (1.0, 36.0), "dps": (36.0, 4500.0)}, 0.01
_COUNTS = 200.0  # whole numbers beyond this are an integer sensor's
_TEMP_C, _WARM_C = (-30.0, 90.0), 12.0
_STATED_RATE = re.compile(
    r"(?i)^\W*(?:fs|sampl\w*[ _]?(?:rate|freq\w*)|output ?rate|rate)\b[^\d\n]{0,12}(\d+(?:\.\d+)?)"
)
_STATED_NAME = re.compile(r"(?i)(^|[._])(fs|sampl\w*_?(rate|freq\w*)(_hz)?)$")
_OF_GYRO = re.compile(r"(?i)^(?!.*(acc|imu)).*(gyr|angular)")  # the name of a file of a single sensor
_NAMED = {
    "time": re.compile(r"(?i)(\w*time|(?-i:t)|ts|timestamp|millis|micros)([ _\[(].*)?$"),
    "temp": re.compile(r"(?i)(board |die )?(temp(?!o\b|s\b)|tmp$|thermo|(?-i:T)$)"),
}
_LIKELY = {
    "gyro": re.compile(r"^(g|gyr|gyro|gyroscope|w|omega|rot)[ _.]?([xyz])\b", re.IGNORECASE),
    "accel": re.compile(r"^(a|acc|accel|accelerometer)[ _.]?([xyz])\b", re.IGNORECASE),
}


def sniff(path: object) -> Text:
    """Open a text table with the delimiter, header and skipped lines that most of it suggests."""
    head = read_bytes(str(path), 1 << 16)
    raw = head.decode("utf-8", "replace").splitlines()[:64]
    at = [k for k, line in enumerate(raw) if line.strip()]
    lines = [raw[k] for k in at]
    body = lines[len(lines) // 2 :] or lines
    delimiter, decimal = marks_of(lines)
    width = max(len(_cells(line, delimiter)) for line in body)
    # a line that a terminal program puts before the rows may have their commas, and nothing between them
    skip = next((k for k, line in zip(at, lines, strict=True) if _has_cells(line, delimiter, width)), 0)
    first = _cells(raw[skip], delimiter, decimal)
    header = not all(is_number(cell, empty=True) or is_date(cell) for cell in first)
    if len(first) > 2 and all(cell.strip().isdecimal() for cell in first) and set(np.diff([*map(int, first)])) == {1}:
        skip += 1  # columns that are numbered, not named
    return open_text(str(path), TextLayout(delimiter=delimiter, skip_rows=skip, header=header, decimal=decimal))


def foreign_kind(text: Text) -> str | None:
    """Return the kind of a table that is not a recording of an inertial sensor."""
    names = [name for name in text.names if name.strip()]
    listing = ", ".join(names[:4])
    for pattern, what in ((_FORCE, "a force plate's table"), (_PLACE, "a table of positions")):
        if any(pattern.search(name) for name in names):
            return f"{what} ({listing}, ...), not a recording of an inertial sensor"
    lines = text.head.decode("utf-8", "replace").splitlines()
    first = lines[text.skip : text.skip + 2]  # one may be of units
    rows = [_cells(line, text.layout.delimiter, text.layout.decimal) for line in first]
    if rows and all(sum(is_number(cell, empty=True) for cell in row) < 0.5 * len(row) for row in rows):
        return f"a table of text ({len(names)} columns: {listing}, ...), not a recording"
    triples = triples_of(text.names)
    if text.layout.header and not triples:
        return (
            f"a table without names of three axes ({', '.join(names[:8])}). A recording of an inertial sensor needs "
            f"a map by "
            "positions."
        )
    if triples and all(_is_magnetic(name) for triple in triples for name in triple):
        return f"a magnetometer's table ({listing}), without gyroscope or accelerometer"
    return None


def quaternion_of_names(names: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return the names of the four columns w, x, y, z of an orientation. Numbered columns are used in their order, w
    first.
    """
    parts: dict[str, dict[str, str]] = {}
    for name in names:
        match = None if name.strip().isdecimal() else _QUATERNION.match(name.strip())  # positions are not names
        if match and _TURNS.search(match["stem"]):
            parts.setdefault(match["stem"], {})[match["part"].lower()] = name
    fours = (
        tuple(columns[axis] for axis in order)
        for columns in parts.values()
        for order in ("wxyz", "0123")
        if {*order} <= columns.keys()
    )
    return next(fours, None)


def reference_map(text: Text, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return an example of the map that a table of quaternions needs, or an empty list for other tables."""
    four = quaternion_of_names(names)
    if four is None or any(label is not None and label.channel == "gyro" for label in map(label_of, names)):
        return ()
    read = partial(_readings, text, {})
    length = np.linalg.norm(read(list(four)), axis=1)
    if not len(length) or abs(float(np.median(length)) - 1.0) > NEARLY_UNIT:
        return ()
    lines = [f"columns = {{ quaternion = {_quoted(four)} }}", f"sample_rate_hz = {_stated_rate(text, ())}"]
    clock = next((name for name in names if _NAMED["time"].match(name.strip())), None)
    if clock is not None:
        unit = _unit_of("time", clock)
        unit, why = proposed_units(read, {"time": _quoted(clock)}, {"time": unit}).get("time", (unit, ""))
        lines = [f"columns = {{ time = {_quoted(clock)}, quaternion = {_quoted(four)} }}"]
        lines += [f'units = {{ time = "{unit}" }}' + f"  # proposed: time by {why}" * bool(why)]
    layout = ", ".join(f"{key} = {json.dumps(value)}" for key, value in stated_layout(text.layout).items())
    return (*lines, *([f"layout = {{ {layout} }}"] if layout else []))


def stated_layout(layout: TextLayout) -> dict[str, Any]:
    """Return what of a layout is not usual."""
    usual = TextLayout()
    return {
        key: setting
        for key in ("delimiter", "decimal", "header", "skip_rows")
        if (setting := getattr(layout, key)) != getattr(usual, key)
    }


def _is_magnetic(name: str) -> bool:
    label = label_of(name)
    return re.search(r"a\.u\.|uT|gauss|\(G\)", name) is not None or (label is not None and label.channel == "mag")


def triples_of(names: tuple[str, ...]) -> tuple[tuple[str, str, str], ...]:
    """Return names that differ only in an x, y, z, or in a number 0, 1, 2 or 1, 2, 3 at their end. They are three axes
    of a quantity.
    """
    name_set, triples = set(names), []
    for name in names:
        axes = [(match.start(), "xyz" if match.group() == "x" else "XYZ") for match in re.finditer("[xX]", name)]
        if (number := re.search(r"[A-Za-z].*[_ \[](?=[01]\]?$)", name)) is not None:
            first = int(name[number.end()])
            axes += [(number.end(), f"{first}{first + 1}{first + 2}")]
        for at, marks in axes:
            triple = tuple(f"{name[:at]}{mark}{name[at + 1 :]}" for mark in marks)
            numbers = (int(marks[0]) - 1, int(marks[0]) + 3) if marks[0].isdigit() else ()
            numbered = {f"{name[:at]}{number}{name[at + 1 :]}" for number in numbers}  # a fourth one: no three axes
            if name_set.issuperset(triple) and name_set.isdisjoint(numbered):
                triples.append((triple[0], triple[1], triple[2]))
    return tuple(triples)


def example_map(names: tuple[str, ...], text: Text | None, arrays: Arrays) -> tuple[str, ...]:
    """Return an example of the map that a table needs. An unknown unit is "?", for a person to fill in."""
    readings = partial(_readings, text, dict(arrays))
    below = [] if text is None else text.head.decode("utf-8", "replace").splitlines()[text.skip : text.skip + 1]
    cells = [] if text is None or not below else _cells(below[0], text.layout.delimiter, text.layout.decimal)
    row = {} if text is None else dict(zip(text.names, cells, strict=False))
    nameless = text is not None and not text.layout.header and names[-1].isdecimal()
    keys = _columns_from_readings(text) if text is not None and nameless else _columns_from_names(names, text, arrays)
    unit_by_channel = {channel: _unit_of(channel, value) for channel, value in keys.items()}
    if unit_by_channel.get("time") == "?" and is_date(row.get(str(_listed(keys["time"])[0]), "")):
        unit_by_channel["time"] = "date"
    proposed = proposed_units(readings, keys, unit_by_channel)
    columns = ", ".join(f"{channel} = {value}" for channel, value in keys.items())
    unit_by_channel |= {channel: unit for channel, (unit, _) in proposed.items()}
    units = ", ".join(f'{channel} = "{unit}"' for channel, unit in unit_by_channel.items())
    why = "; ".join(f"{channel} by {why}" for channel, (_, why) in proposed.items())
    lines = [f"columns = {{ {columns} }}", f"units = {{ {units} }}" + f"  # proposed: {why}" * bool(why)]
    lines += [] if "time" in keys else [f"sample_rate_hz = {_stated_rate(text, arrays)}"]
    if text is not None:
        lines += [f"{key} = {json.dumps(setting)}" for key, setting in stated_layout(text.layout).items()]
        mapped = [row.get(str(column), "") for value in keys.values() for column in _listed(value)]
        has_text = any(not is_number(cell, empty=True) and not is_date(cell) for cell in mapped)
        lines += ["drop_bad_rows = true  # the row of units"] if has_text and text.layout.header else []
    return tuple(lines)


def _columns_from_names(names: tuple[str, ...], text: Text | None, arrays: Arrays) -> dict[str, str]:
    """Return the columns of each channel, as a map writes them."""
    keys: dict[str, str] = {}
    triples = {triple[0]: _quoted(triple) for triple in triples_of(names)}
    threes = {name: _quoted(name) for name, array in arrays if array.ndim == 2 and array.shape[1] == 3}
    quoted = threes or triples
    labels = {name: label_of(name) for name in quoted}
    bare = [name for name, label in labels.items() if label is None and not _NO_SENSOR.search(name)] * (not threes)
    is_gyro_file = text is not None and _OF_GYRO.search(text.path.name) is not None
    for channel, unlabelled in (("gyro", bare if is_gyro_file else []), ("accel", [] if is_gyro_file else bare)):
        labelled = [name for name, label in labels.items() if label is not None and label.channel == channel]
        numbered = [name for name, label in labels.items() if label is None and not name[-1].isalpha()]
        first = _likely(channel, tuple(quoted) if threes else (*labelled, *numbered)) or next(
            iter([*labelled, *unlabelled]), None
        )
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
    readings: Callable[[list[Column]], FloatArray], keys: dict[str, str], units: dict[str, str]
) -> dict[str, tuple[str, str]]:
    """Return proposed units of channels whose names have no unit, and the figure that suggests each."""
    samples = {channel: readings(_listed(keys[channel])) for channel in keys if units[channel] == "?"}
    samples = {channel: values for channel, values in samples.items() if len(values) > 1}
    proposals: dict[str, tuple[str, str]] = {}

    def propose(channel: str, value: float, ranges: dict[str, tuple[float, float]], what: str) -> None:
        unit = next((unit for unit, (low, high) in ranges.items() if low <= value < high), None)
        if unit is not None:
            proposals[channel] = (unit, f"{what} {value:.4g}")

    if "accel" in samples and samples["accel"].shape[1] == 3:
        propose("accel", float(np.median(np.linalg.norm(samples["accel"], axis=1))), _AT_REST, "the median |a|")
    if "gyro" in samples:
        largest, is_integer = (
            float(np.abs(samples["gyro"]).max()),
            np.array_equal(samples["gyro"], np.round(samples["gyro"])),
        )
        if is_integer and (largest > _COUNTS or proposals.get("accel", ("", ""))[0] == "count"):
            proposals["gyro"] = ("count", f"whole numbers up to {largest:.4g}")
        elif not is_integer and (largest >= _RATE["dps"][0] or _least_spread(samples["gyro"]) < _SPREAD_RAD_S):
            propose("gyro", largest, _RATE, "the largest rate")
    if "time" in samples and (step := float(np.median(np.diff(samples["time"][:, 0])))) != 1.0:  # of a counter, or 1 ms
        propose("time", step, _STEP, "the median step")
    if "temp" in samples and not np.array_equal(samples["temp"], np.round(samples["temp"])):
        propose("temp", float(np.median(samples["temp"])), {"degC": _TEMP_C}, "the median")
    return proposals


def _least_spread(values: FloatArray) -> float:
    """Return the standard deviation of the quietest 100 samples in a row, the mean of the axes."""
    count = len(values) // 100
    if count == 0:
        return float("inf")
    return float(values[: 100 * count].reshape(count, 100, -1).std(axis=1).mean(axis=1).min())


def _stated_rate(text: Text | None, arrays: Arrays) -> str:
    """Return the sample rate from a line before the header or a single-number array, or "?" if there is none."""
    for name, array in arrays:
        if array.size == 1 and _STATED_NAME.search(name) and np.ravel(array)[0] > 0:
            return f"{float(np.ravel(array)[0]):g}  # by {name}"
    for line in [] if text is None else text.head.decode("utf-8", "replace").splitlines()[: text.layout.skip_rows]:
        if match := _STATED_RATE.search(line):
            return f"{float(match.group(1)):g}  # by the line {json.dumps(line.strip()[:40])}"
    return "?"


def _readings(text: Text | None, arrays: dict[str, Any], columns: list[Column]) -> FloatArray:
    """Return columns from the first MiB of text or from an array, (N, K), without rows that have gaps. The result may
    be empty.
    """
    values = arrays.get(str(columns[0]))
    if text is not None:
        is_complete = text.content is None and len(text.head) < 1 << 20
        head = text.head if is_complete else text.head[: text.head.rfind(b"\n") + 1]
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
    labels = [label_of(name) for name in re.findall(r'"([^"]*)"', names)]
    if labels and labels[0] is not None and labels[0].unit and labels[0].gain == 1.0 and labels[0].channel == channel:
        return labels[0].unit
    return next((unit for unit, labels in _UNITS[channel] if re.search(labels, names, re.IGNORECASE)), "?")


def _median_length(values: FloatArray) -> tuple[float, float]:
    """Return the median length of three axes, and how far the length departs from it, relative to it: least for gravity."""
    length = np.linalg.norm(values, axis=1)
    middle = float(np.median(length)) if len(length) else 0.0
    return middle, float(np.median(np.abs(length - middle))) / middle if middle > 0.0 else float("inf")


def _counts(values: FloatArray) -> bool:
    """Return True if a column counts rows: whole numbers that increase by 1 except where they restart."""
    steps = np.diff(values[:, 0])
    return len(steps) > 1 and bool(np.mean(steps == 1.0) > 0.9)


def _is_temperature(values: FloatArray) -> bool:
    """Return whether a column without a name may be a thermometer: fractions, warmer than any reading of gravity in m/s2."""
    middle = float(np.median(values))
    return _WARM_C < middle < _TEMP_C[1] and not np.array_equal(values, np.round(values))


def _columns_from_readings(text: Text) -> dict[str, str]:
    """Return a proposal for a table without names: a growing first column is time, the steadiest three axes read gravity."""
    lines = [line for line in text.head.decode("utf-8", "replace").splitlines()[text.skip :] if line.strip()][:8]
    first = [_cells(line, text.layout.delimiter, text.layout.decimal)[0] for line in lines]
    numbers = [float(cell) for cell in first if cell and is_number(cell, empty=True)]
    grows = (all(b > a for a, b in pairwise(numbers)) and len(numbers) > 1) or all(map(is_date, first))
    columns = {k: _readings(text, {}, [k]) for k in range(grows, len(text.names))}
    free = [k for k, values in columns.items() if len(values) and not _counts(values)]
    keys: dict[str, object] = {"time": 0} if grows else {}
    if len(free) % 3 == 1:
        keys["temp"] = free.pop(0 if _is_temperature(columns[free[0]]) else -1)
    threes = [free[k : k + 3] for k in (0, 3) if k + 3 <= len(free)]
    if not threes:
        return {}
    if _OF_GYRO.search(text.path.name):
        return {channel: str(columns) for channel, columns in (keys | {"gyro": threes[0]}).items()}
    lengths = [_median_length(_readings(text, {}, [*axes])) for axes in threes]
    gravity_like = [
        k for k, (length, _) in enumerate(lengths) if any(low <= length < high for low, high in _AT_REST.values())
    ]
    accel = min(gravity_like, key=lambda k: lengths[k][1], default=0)
    keys["accel"] = threes[accel]
    keys |= {"gyro": threes[1 - accel]} if len(threes) > 1 else {}
    return {channel: str(columns) for channel, columns in keys.items()}


def _likely(channel: str, names: tuple[str, ...]) -> str | None:
    stem = "gyr" if channel == "gyro" else "acc"
    return next((name for name in names if stem in name.lower() or _LIKELY[channel].match(name.strip())), None)


def _has_cells(line: str, delimiter: str, width: int) -> bool:
    """Return True if a line has as many cells as the table is wide, with content in half of them."""
    cells = _cells(line, delimiter)
    return len(cells) == width and 2 * sum(bool(cell.strip()) for cell in cells) >= width


def _cells(line: str, delimiter: str, decimal: str = ".") -> list[str]:
    line = line.replace(decimal, ".")
    return line.split() if delimiter == " " else line.split(delimiter)
