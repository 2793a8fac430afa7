"""Proposals for a person, never for a reader: the kind of a foreign table, and the map that it may need.

Channel and unit come from names or from the readings: gravity has constant length on three axes, a quaternion has
length 1, a counter increases. An unknown entry is "?".
"""

import json
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.files import read_bytes
from undrift.io.arrays import Arrays
from undrift.io.column_map import Column, TextLayout
from undrift.io.columns import is_date, is_number
from undrift.io.labelled import label_of, marks_of
from undrift.io.reference import NEARLY_UNIT
from undrift.io.text import Text, cells_of, open_text, parse_text

_FORCE = re.compile(r"GRF|(?<![A-Za-z])COP|FREEMOMENT|^[FM][xyz]\[")
_QUATERNION = re.compile(
    r"(?i)^(?P<stem>.*?)(?P<part>[wxyz]|[0-3])\]?( element)?$"
)  # w, qw, q0, seg2_quat_w, QUATERNION_0
_TURNS = re.compile(r"(?i)^$|quat|^q[_.\[]*$|[_. ]q[_.\[]*$|orient|rotat")  # text before w, x, y, z
_UNITS = {  # units that a name may state, or "?" for none, which a reader refuses
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
_NO_SENSOR = re.compile(
    r"(?i)quat|euler|pos|vel|force|moment|angle|roll|pitch|yaw|mat\[|COG|ankle|knee|hip|mag|a\.u\.|uT|gauss|\(G\)"
)
# What |a| at rest may be in each unit; an integer sensor of +-2 to +-16 g reads 1,000 to 20,000 counts and more
_AT_REST = {"g": (0.8, 1.25), "m/s2": (7.8, 12.3), "mg": (800.0, 1250.0), "count": (1250.0, 1e7)}
_STEP = {"s": (2e-4, 0.2), "ms": (0.2, 200.0), "us": (200.0, 2e5), "ns": (2e5, 2e8)}  # between samples, 5 Hz to 5 kHz
# The largest rate: 36 rad/s were more than the 2000 deg/s that gyroscopes reach. Below, noise tells: at rest it is 0.03 to
# 0.3 deg/s, or 0.0005 to 0.005 rad/s
_RATE, _SPREAD_RAD_S = {"rad/s": (1.0, 36.0), "dps": (36.0, 4500.0)}, 0.01
_COUNTS = 200.0  # whole numbers beyond this are an integer sensor's
_TEMP_C, _WARM_C = (-30.0, 90.0), 12.0
_STATED_RATE = re.compile(
    r"(?i)^\W*(?:fs|sampl\w*[ _]?(?:rate|freq\w*)|output ?rate|rate)\b[^\d\n]{0,12}(\d+(?:\.\d+)?)"
)
_COUNTER = re.compile(r"(?i)^(packet|sample|frame)?[ _]?counter$")
_STATED_NAME = re.compile(r"(?i)(^|[._])(fs|sampl\w*_?(rate|freq\w*)(_hz)?)$")
_OF_GYRO = re.compile(r"(?i)^(?!.*(acc|imu)).*(gyr|angular)")  # the name of a file of one sensor
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
    skip = next((k for k, line in zip(at, lines, strict=True) if _filled(line, delimiter, width)), 0)
    first = _cells(raw[skip], delimiter, decimal)
    header = not all(is_number(cell, empty=True) or is_date(cell) for cell in first)
    if len(first) > 2 and all(cell.strip().isdecimal() for cell in first) and set(np.diff([*map(int, first)])) == {1}:
        skip += 1  # columns that are numbered, not named
    return open_text(str(path), TextLayout(delimiter=delimiter, skip_rows=skip, header=header, decimal=decimal))


def foreign_kind(text: Text) -> str | None:
    """Return the kind of a table that is not a recording of an inertial sensor."""
    names = [name for name in text.names if name.strip()]
    listing = ", ".join(names[:4])
    if any(_FORCE.search(name) for name in names):
        return f"a force plate's table ({listing}, ...), not a recording of an inertial sensor"
    lines = text.head.decode("utf-8", "replace").splitlines()
    first = lines[text.skip : text.skip + 2]  # one may be of units
    rows = [_cells(line, text.layout.delimiter, text.layout.decimal) for line in first]
    if rows and all(sum(is_number(cell, empty=True) for cell in row) < 0.5 * len(row) for row in rows):
        return f"a table of text ({len(names)} columns: {listing}, ...), not a recording"
    triples = triples_of(text.names)
    if triples and all(_NO_SENSOR.search(name) for triple in triples for name in triple):
        return f"a table of other quantities ({listing}, ...), not a recording of an inertial sensor"
    if text.layout.header and not triples:
        return (
            f"a table without names of three axes ({', '.join(names[:8])}). A recording of an inertial sensor needs "
            "a map by positions."
        )
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


@dataclass(frozen=True, slots=True, kw_only=True)
class MapProposal:
    """The map that a table seems to need. A unit or rate that nothing shows is "?", for a person to fill in."""

    columns: dict[str, Any]  # column or columns of each channel; of orientations: time or counter, quaternion
    units: dict[str, str]
    reasons: dict[str, str] = field(default_factory=dict)  # figure that suggests a unit, if no name states it
    rate: str = ""  # sample rate of a table without time, Hz, with its source; "?" if nothing states it
    layout: dict[str, Any] = field(default_factory=dict)  # what of a text layout is not usual
    others: str = ""  # first columns of other sensors in the file, which are not taken
    clock: str = ""  # key for time stamps that a reader refuses without it

    def lines(self) -> tuple[str, ...]:
        """Return the lines of the map."""
        why = "; ".join(f"{channel} by {reason}" for channel, reason in self.reasons.items())
        lines = [
            f"columns = {{ {_table(self.columns)} }}" + f"  # one sensor; not taken: {self.others}" * bool(self.others)
        ]
        lines += [f"units = {{ {_table(self.units)} }}" + f"  # proposed: {why}" * bool(why)] if self.units else []
        lines += [f"sample_rate_hz = {self.rate}"] if self.rate else []
        lines += [self.clock] if self.clock else []
        layout = {key: value for key, value in self.layout.items() if key != "drop_bad_rows"}
        if "quaternion" in self.columns:
            return (*lines, *([f"layout = {{ {_table(layout)} }}"] if layout else []))
        lines += [f"{key} = {json.dumps(value)}" for key, value in layout.items()]
        lines += ["drop_bad_rows = true  # the row of units"] if "drop_bad_rows" in self.layout else []
        return tuple(lines)


def _table(values: Mapping[str, Any]) -> str:
    """Return the keys of an inline table of TOML."""
    return ", ".join(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in values.items())


def propose_poses(text: Text, names: tuple[str, ...]) -> MapProposal | None:
    """Return the map that a table of quaternions needs; None for a table of readings or without quaternions."""
    four = quaternion_of_names(names)
    if four is None or any(label is not None and label.channel == "gyro" for label in map(label_of, names)):
        return None
    read = partial(_readings, text, {})
    length = np.linalg.norm(read(list(four)), axis=1)
    if not len(length) or abs(float(np.median(length)) - 1.0) > NEARLY_UNIT:
        return None
    layout, quaternion = _unusual(text.layout), {"quaternion": list(four)}
    clock = next((name for name in names if _NAMED["time"].match(name.strip())), None)
    if clock is None:
        counter = next((name for name in names if _COUNTER.search(name)), None)  # it shows the samples that were lost
        columns = quaternion if counter is None else {"counter": counter, **quaternion}
        regular = "" if counter is None else 'clock = "regular"'
        return MapProposal(columns=columns, units={}, rate=_stated_rate(text, ()), layout=layout, clock=regular)
    unit = _unit_of("time", clock)
    proposed = _units_by_size(read, {"time": [clock]}, {"time": unit})
    return MapProposal(
        columns={"time": clock, **quaternion},
        units={"time": proposed.get("time", (unit, ""))[0]},
        reasons={channel: why for channel, (_, why) in proposed.items()},
        layout=layout,
        clock=_order_of(read([clock])),
    )


def _unusual(layout: TextLayout) -> dict[str, Any]:
    """Return what of a layout is not usual."""
    keys = ("delimiter", "decimal", "header", "skip_rows")
    return {key: value for key in keys if (value := getattr(layout, key)) != getattr(TextLayout(), key)}


def _order_of(time: FloatArray) -> str:
    """Return the key of a map for stamps that repeat or step back."""
    steps = np.diff(time[:, 0])
    if (steps < 0.0).any():
        return f"repair_time = true  # {int((steps <= 0.0).sum())} stamps repeat or step back: their rows are left out"
    return (
        f'clock = "regular"  # {int((steps == 0.0).sum())} stamps repeat, as those of a host'
        if (steps == 0.0).any()
        else ""
    )


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


def propose(names: tuple[str, ...], text: Text | None, arrays: Arrays) -> MapProposal:
    """Return the map that a table of readings seems to need."""
    below = [] if text is None else text.head.decode("utf-8", "replace").splitlines()[text.skip : text.skip + 1]
    cells = [] if text is None or not below else _cells(below[0], text.layout.delimiter, text.layout.decimal)
    nameless = text is not None and not text.layout.header and names[-1].isdecimal()
    columns, others = (_by_position(text), "") if text is not None and nameless else _by_name(names, text, arrays)
    listed = {channel: value if isinstance(value, list) else [value] for channel, value in columns.items()}
    units = {channel: _unit_of(channel, *map(str, value)) for channel, value in listed.items()}
    positions = {channel: [_position(names, column) for column in value] for channel, value in listed.items()}
    first = {channel: [cells[k] for k in value if k < len(cells)] for channel, value in positions.items()}
    if units.get("time") == "?" and any(map(is_date, first["time"])):
        units["time"] = "date"
    read = partial(_readings, text, dict(arrays))
    proposed = _units_by_size(read, listed, units)
    layout = {} if text is None else _unusual(text.layout)
    if text is not None and text.layout.header:  # a row of units below the header
        mapped = [cell for value in first.values() for cell in value]
        words = any(not is_number(cell, empty=True) and not is_date(cell) for cell in mapped)
        layout |= {"drop_bad_rows": True} if words else {}
    dated = units.get("time") == "date"
    return MapProposal(
        columns=columns,
        units=units | {channel: unit for channel, (unit, _) in proposed.items()},
        reasons={channel: why for channel, (_, why) in proposed.items()},
        rate="" if "time" in columns else _stated_rate(text, arrays),
        layout=layout,
        others=others,
        clock=_order_of(read(listed["time"])) if "time" in columns and not dated else "",
    )


def _position(names: tuple[str, ...], column: Column) -> int:
    return column if isinstance(column, int) else names.index(column) if column in names else len(names)


def _by_name(names: tuple[str, ...], text: Text | None, arrays: Arrays) -> tuple[dict[str, Any], str]:
    """Return the columns of each channel, and the first columns of other sensors."""
    keys: dict[str, Any] = {}
    threes: dict[str, Any] = {name: name for name, array in arrays if array.ndim == 2 and array.shape[1] == 3}
    if six := [] if threes else [name for name, array in arrays if array.ndim == 2 and array.shape[1] == 6]:
        for channel, start in (("accel", 0), ("gyro", 3)):  # the usual order, to be checked
            keys[channel] = [f"{six[0]}[{k}]" for k in range(start, start + 3)]
    choices = threes or {triple[0]: list(triple) for triple in triples_of(names)}
    labels = {name: label_of(name) or label_of(re.sub(r"\d+$", "", name)) for name in choices}  # ax1 is ax of a sensor
    bare = [name for name, label in labels.items() if label is None and not _NO_SENSOR.search(name)]
    is_gyro_file = text is not None and _OF_GYRO.search(text.path.name) is not None
    for channel, unlabelled in (("gyro", bare if is_gyro_file else []), ("accel", [] if is_gyro_file else bare)):
        labelled = [name for name, label in labels.items() if label is not None and label.channel == channel]
        numbered = [name for name, label in labels.items() if label is None and not name[-1].isalpha()]
        first = _likely(channel, tuple(choices) if threes else (*labelled, *numbered)) or next(
            iter([*labelled, *unlabelled]), None
        )
        if first is not None:
            keys[channel] = choices[first]
    if text is not None and (repeated := [channel for channel, value in keys.items() if names.count(value[0]) > 1]):
        threes_at = _repeated_triples(names, keys[repeated[0]])
        keys = {**keys, repeated[0]: threes_at[next(iter(_gravity_like(text, threes_at)), 0)]}
    for channel, pattern in _NAMED.items():
        name = next((n for n in names if pattern.match(n.strip().rpartition(".")[2])), None)
        if name is not None:
            keys = {channel: name, **keys} if channel == "time" else {**keys, channel: name}
    taken = [value[0] for value in keys.values() if isinstance(value, list)]
    unlabelled = [n for n, x in labels.items() if x is not None and x.channel in ("gyro", "accel") and n not in taken]
    return keys, ", ".join(unlabelled)


def _repeated_triples(names: tuple[str, ...], axes: list[str]) -> list[list[int]]:
    """Return the positions of three names that repeat in a header, such as X, Y, Z below the names of sensors."""
    places = [[k for k, name in enumerate(names) if name == axis] for axis in axes]
    return [list(triple) for triple in zip(*places, strict=False)]


def _gravity_like(text: Text, threes: list[list[int]]) -> dict[int, float]:
    """Return which triples of columns may read gravity, and how far the length of each departs from its median."""
    lengths = [_median_length(_readings(text, {}, [*axes])) for axes in threes]
    at_rest = [any(low <= length < high for low, high in _AT_REST.values()) for length, _ in lengths]
    return {k: spread for k, (_, spread) in enumerate(lengths) if at_rest[k]}


def _units_by_size(
    readings: Callable[[list[Column]], FloatArray], columns: dict[str, list[Column]], units: dict[str, str]
) -> dict[str, tuple[str, str]]:
    """Return proposed units of channels whose names have no unit, and the figure that suggests each."""
    held = {channel: readings(columns[channel]) for channel in columns if units[channel] == "?"}
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
    """Return the sample rate from a line before the header or a single-number array, or "?" if there is none."""
    for name, array in arrays:
        if array.size == 1 and _STATED_NAME.search(name) and np.ravel(array)[0] > 0:
            return f"{float(np.ravel(array)[0]):g}  # by {name}"
    for line in [] if text is None else text.head.decode("utf-8", "replace").splitlines()[: text.layout.skip_rows]:
        if match := _STATED_RATE.search(line):
            return f"{float(match.group(1)):g}  # by the line {json.dumps(line.strip()[:40])}"
    return "?"


def _readings(text: Text | None, arrays: Mapping[str, Any], columns: list[Column]) -> FloatArray:
    """Return columns of the first MiB of text, or of arrays, (N, K), rows with gaps left out; none where there are none."""
    parts: list[Any] = []
    if text is not None:
        is_complete = text.content is None and len(text.head) < 1 << 20
        head = text.head if is_complete else text.head[: text.head.rfind(b"\n") + 1]
        with suppress(InputError):
            table = parse_text(replace(text, content=head, layout=text.layout.but(drop_bad_rows=True)), tuple(columns))
            parts = [table.numbers(column) for column in columns]
    else:
        flat = {f"{name}[{k}]": x[:, k] for name, x in arrays.items() if x.ndim == 2 for k in range(x.shape[1])}
        parts = [x for column in columns if (x := {**flat, **arrays}.get(str(column))) is not None]
    if len(parts) != len(columns) or any(x.dtype.kind not in "fiu" or x.ndim > 2 or not x.size for x in parts):
        return np.empty((0, 1))
    values = np.column_stack(parts).astype(np.float64)
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def _unit_of(channel: str, *names: str) -> str:
    """Return the unit that the names of columns state, "?" if they state none."""
    label = label_of(names[0])
    if label is not None and label.unit and label.gain == 1.0 and label.channel == channel:
        return label.unit
    shown = json.dumps(names, ensure_ascii=False)
    return next((unit for unit, pattern in _UNITS[channel] if re.search(pattern, shown, re.IGNORECASE)), "?")


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


def _by_position(text: Text) -> dict[str, Any]:
    """Return a proposal for a table without names: a growing first column is time, the steadiest three axes read gravity."""
    lines = [line for line in text.head.decode("utf-8", "replace").splitlines()[text.skip :] if line.strip()][:8]
    first = [_cells(line, text.layout.delimiter, text.layout.decimal)[0] for line in lines]
    numbers = [float(cell) for cell in first if cell and is_number(cell, empty=True)]
    rising = len(numbers) > 1 and all(b > a for a, b in pairwise(numbers)) and len(text.names) not in (3, 6)
    grows = rising or all(map(is_date, first))
    columns = {k: _readings(text, {}, [k]) for k in range(grows, len(text.names))}
    free = [k for k, values in columns.items() if len(values) and not _counts(values)]
    keys: dict[str, Any] = {"time": 0} if grows else {}
    if len(free) % 3 == 1:
        keys["temp"] = free.pop(0 if _is_temperature(columns[free[0]]) else -1)
    threes = [free[k : k + 3] for k in (0, 3) if k + 3 <= len(free)]
    if not threes:
        return {}
    if _OF_GYRO.search(text.path.name):
        return keys | {"gyro": threes[0]}
    gravity_like = _gravity_like(text, threes)
    accel = min(gravity_like, key=lambda k: gravity_like[k], default=0)  # the steadiest
    keys["accel"] = threes[accel]
    return keys | ({"gyro": threes[1 - accel]} if len(threes) > 1 else {})


def _likely(channel: str, names: tuple[str, ...]) -> str | None:
    stem = "gyr" if channel == "gyro" else "acc"
    return next((name for name in names if stem in name.lower() or _LIKELY[channel].match(name.strip())), None)


def _filled(line: str, delimiter: str, width: int) -> bool:
    """Return True if a line has as many cells as the table is wide, with content in half of them."""
    cells = _cells(line, delimiter)
    return len(cells) == width and 2 * sum(bool(cell.strip()) for cell in cells) >= width


def _cells(line: str, delimiter: str, decimal: str = ".") -> list[str]:
    return cells_of(line.replace(decimal, "."), delimiter)
