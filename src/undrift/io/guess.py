"""Proposal of the map that a foreign table may need, for a person to check. Readers never guess.

Channel and unit come from names or from the readings: gravity has a constant length on three axes, a quaternion has length 1, and a
counter increases. An unknown unit is "?".
"""

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.io.column_map import Column, TextLayout
from undrift.io.columns import RawTable, is_date, is_number
from undrift.io.labels import label_of
from undrift.io.reference import NEARLY_UNIT
from undrift.io.text import Text, parse_text

_QUATERNION = re.compile(
    r"(?i)^(?P<stem>.*?)(?P<part>[wxyz]|[0-3])\]?( element)?$"
)  # w, qw, q0, seg2_quat_w, QUATERNION_0
_TURNS = re.compile(r"(?i)^$|quat|^q[_.\[]*$|[_. ]q[_.\[]*$|orient|rotat")  # text before w, x, y, z
_UNITS = {  # units that a name may contain, in addition to those that a reader accepts
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
_FORCE = re.compile(r"GRF|COP|FREEMOMENT|^[FM][xyz]\[")  # columns of a force plate
_NO_SENSOR = re.compile(
    r"(?i)quat|euler|pos|vel|force|moment|angle|roll|pitch|yaw|mat\[|COG|ankle|knee|hip|mag|a\.u\.|uT|gauss|\(G\)"
)
# |a| at rest in each unit. An integer sensor of +-2 to +-16 g reads 1,000 to 20,000 counts and more.
_AT_REST = {"g": (0.8, 1.25), "m/s2": (7.8, 12.3), "mg": (800.0, 1250.0), "count": (1250.0, 1e7)}
_STEP = {"s": (2e-4, 0.2), "ms": (0.2, 200.0), "us": (200.0, 2e5), "ns": (2e5, 2e8)}  # time steps, 5 Hz to 5 kHz
# Limit of the rate: 36 rad/s would exceed the 2000 deg/s that gyroscopes reach. Smaller rates are distinguished by their noise at
# rest, which is 0.03 to 0.3 deg/s, or 0.0005 to 0.005 rad/s
_RATE, _SPREAD_RAD_S = {"rad/s": (1.0, 36.0), "dps": (36.0, 4500.0)}, 0.01
_COUNTS = 200.0  # largest whole number of a sensor in physical units
_TEMP_C, _WARM_C = (-30.0, 90.0), 12.0
_STATED_RATE = re.compile(
    r"(?i)^\W*(?:fs|sampl\w*[ _]?(?:rate|freq\w*)|output ?rate|rate)\b[^\d\n]{0,12}(\d+(?:\.\d+)?)"
)
_STATED_NAME = re.compile(r"(?i)(^|[._])(fs|sampl\w*_?(rate|freq\w*)(_hz)?)$")
_COUNTER = re.compile(r"(?i)^(packet|sample|frame)?[ _]?counter$")
_OF_GYRO = re.compile(r"(?i)^(?!.*(acc|imu)).*(gyr|angular)")  # names of files with one sensor
_NAMED = {
    "time": re.compile(r"(?i)(\w*time|(?-i:t)|ts|timestamp|millis|micros)([ _\[(].*)?$"),
    "temp": re.compile(r"(?i)(board |die )?(temp(?!o\b|s\b)|tmp$|thermo|(?-i:T)$)"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MapProposal:
    """Proposed map of a table. A unit or rate that the table does not determine is "?", for a person to fill in."""

    columns: dict[str, Any]  # column or columns of each channel; for orientations: time or counter, quaternion
    units: dict[str, str]
    reasons: dict[str, str] = field(default_factory=dict)  # number that suggests a unit, if no name contains it
    rate: str = ""  # sample rate of a table without time, Hz, with its source; "?" if it is unknown
    layout: dict[str, Any] = field(default_factory=dict)  # keys of a text layout that differ from the default
    others: str = ""  # first columns of other sensors in the file, which are not used
    clock: str = ""  # key that a reader needs to accept the time stamps

    def lines(self) -> tuple[str, ...]:
        """Return the lines of the map."""
        why = "; ".join(f"{channel} by {reason}" for channel, reason in self.reasons.items())
        lines = [
            f"columns = {{ {_table(self.columns)} }}" + f"  # one sensor; not used: {self.others}" * bool(self.others)
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

    def text(self, path: str, *, sample_rate_hz: float | None = None, units: Mapping[str, str | None] = {}) -> str:
        """Return the map as a file, with a comment for each unit: its reason, or that it must be entered."""
        rate = self.rate
        if rate == "?":
            if sample_rate_hz is None:
                raise InputError(f"{path}: a table without time needs its sample rate. Add `sample_rate_hz`.")
            rate = f"{sample_rate_hz:g}"
        given = {key: unit for key, unit in units.items() if unit is not None and key in self.units}
        all_units = self.units | given
        why = dict.fromkeys(self.units, "from the name of its column")
        why |= {key: f"proposed by {reason}" for key, reason in self.reasons.items()} | dict.fromkeys(given, "as given")
        unknown = "not determined by name or readings: check the channel, and enter the unit"
        why |= {key: unknown for key, x in all_units.items() if x == "?"}
        head = [f"# How {Path(path).name} is read. The keys are explained in docs/maps.md. Check each unit."]
        head += [f"# {key}: {unit}, {why[key]}" for key, unit in all_units.items()]
        return "\n".join([*head, *replace(self, rate=rate, units=all_units, reasons={}).lines()]) + "\n"


def _table(values: Mapping[str, Any]) -> str:
    """Return the keys of an inline table of TOML."""
    return ", ".join(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in values.items())


# ---- a foreign table


def sample_of(text: Text) -> RawTable:
    """Return the first MiB of a text, parsed. Rows that do not parse are left out."""
    is_whole = text.content is None and len(text.head) < 1 << 20
    head = text.head if is_whole else text.head[: text.head.rfind(b"\n") + 1]
    layout, rows = text.layout.but(drop_bad_rows=True), [text.cells(k) for k in range(9)]
    cells = zip(*(row for row in rows if len(row) == len(text.names)), strict=True)
    numeric = [[is_number(cell, empty=True) for cell in column] for column in cells]
    positions = tuple(k for k, flags in enumerate(numeric) if 2 * sum(flags) > len(flags))
    return parse_text(replace(text, content=head, layout=layout), positions)


def readings(table: RawTable, columns: Sequence[Column]) -> FloatArray:
    """Return columns (N, K) without rows with gaps, or (0, 1) if they are not numbers of one length."""
    with suppress(InputError, ValueError):
        values = np.column_stack([table.numbers(column) for column in columns])
        return np.asarray(values[np.isfinite(values).all(axis=1)])
    return np.empty((0, 1))


def foreign_kind(table: RawTable, text: Text | None) -> str | None:
    """Return the kind of a table that is not a recording of an inertial sensor, None if it may be one."""
    names = [name for name in table.names if name.strip()]
    listing, triples = ", ".join(names[:4]), triples_of(table.names)
    rows = [row for row in (text.cells(0), text.cells(1)) if row] if text else []
    if rows and all(sum(is_number(cell, empty=True) for cell in row) < 0.5 * len(row) for row in rows):
        return f"a table of text ({len(names)} columns: {listing}, ...), not a recording"
    is_foreign = bool(triples) and all(_NO_SENSOR.search(name) for triple in triples for name in triple)
    if is_foreign or (text and any(map(_FORCE.search, names))):
        return f"a table of other quantities ({listing}, ...), not a recording of an inertial sensor"
    if not triples and not _sixes(table.names) and not is_nameless(table, text):
        how = "by positions, for example gyro = [1, 2, 3], with header = false and skip_rows"
        how = how if text else 'that names its columns, for example gyro = ["gx", "gy", "gz"]'
        return f"a table without names of three axes ({', '.join(names[:8])}). A recording of an inertial sensor needs a map {how}."
    if len(table.names) < 3:
        return (
            "a table of fewer than three columns. To read the files of three axes as one recording, use a map with a "
            f"table of columns for each file, such as {{ time = 0, gyro = {{ x = {len(table.names) - 1} }} }}"
        )
    return None


def is_nameless(table: RawTable, text: Text | None) -> bool:
    """Return True if columns have positions and no names: in a table without header, or an array that has not 3 or 6 columns."""
    if text is not None:
        return not text.layout.header and text.names[-1].isdecimal()
    name = table.names[0].removesuffix("[0]") if table.names else ""
    return len(table.names) not in (3, 6) and table.names == tuple(f"{name}[{k}]" for k in range(len(table.names)))


def triples_of(names: tuple[str, ...]) -> dict[tuple[str, str, str], str]:
    """Return names that differ only in an x, y, z, or in a number 0, 1, 2 or 1, 2, 3 at their end: three axes of a quantity.

    Each quantity is named after its first axis, with x instead of a number.
    """
    name_set, triples = {name for name in names if names.count(name) == 1}, dict[tuple[str, str, str], str]()
    for name in filter(name_set.__contains__, names):
        axes = [(match.start(), "xyz" if match.group() == "x" else "XYZ") for match in re.finditer("[xX]", name)]
        if (number := re.search(r"[A-Za-z].*[_ \[](?=[01]\]?$)", name)) is not None:
            first = int(name[number.end()])
            axes += [(number.end(), f"{first}{first + 1}{first + 2}")]
        for at, marks in axes:
            x, y, z = (f"{name[:at]}{mark}{name[at + 1 :]}" for mark in marks)
            numbers = (int(marks[0]) - 1, int(marks[0]) + 3) if marks[0].isdigit() else ()
            numbered = {f"{name[:at]}{number}{name[at + 1 :]}" for number in numbers}  # a fourth one: not three axes
            if name_set.issuperset((x, y, z)) and name_set.isdisjoint(numbered):
                triples[x, y, z] = f"{name[:at].strip('_[ ')} x" if numbers else x
    return triples


def _sixes(names: Sequence[str]) -> list[str]:
    """Return the names of arrays of six columns."""
    return [name[:-3] for name in names if name.endswith("[5]") and f"{name[:-3]}[6]" not in names]


# ---- proposals


def propose(table: RawTable, text: Text | None = None) -> MapProposal:
    """Return the map that a table of readings or of orientations probably needs."""
    columns, others = (_by_position(table), "") if is_nameless(table, text) else _by_name(table)
    if text is None and is_nameless(table, text):  # the columns of an array have names with their positions
        columns = {key: np.array(table.names)[value].tolist() for key, value in columns.items()}
    if text and (quaternion := _quaternion(table)):
        columns, others = {"quaternion": quaternion}, ""
        for key, pattern in (("counter", _COUNTER), ("time", _NAMED["time"])):  # the last one is used
            name = next((name for name in table.names if pattern.match(name.strip())), None)
            columns = columns if name is None else {key: name, "quaternion": quaternion}
    listed = {channel: value if isinstance(value, list) else [value] for channel, value in columns.items()}
    units = {channel: _unit_of(channel, *map(str, value)) for channel, value in listed.items() if channel in _UNITS}
    first = text.cells() if text else []
    if units.get("time") == "?" and is_date(dict(enumerate(first)).get(table.position(columns["time"]), "")):
        units["time"] = "date"
    proposed = _units_by_size(table, {channel: listed[channel] for channel, unit in units.items() if unit == "?"})
    layout = {}
    if text is not None:
        keys, usual = ("delimiter", "decimal", "header", "skip_rows"), TextLayout()
        layout = {k: value for k in keys if (value := getattr(text.layout, k)) != getattr(usual, k)}
        layout |= {"drop_bad_rows": True} if text.units else {}
    clock = 'clock = "regular"' if "counter" in columns else ""
    if "time" in columns and units["time"] != "date":
        clock = _order_of(readings(table, listed["time"]))
    return MapProposal(
        columns={channel: _array_of(value, table.names) for channel, value in columns.items()},
        units=units | {channel: unit for channel, (unit, _) in proposed.items()},
        reasons={channel: why for channel, (_, why) in proposed.items()},
        rate="" if "time" in columns else _stated_rate(table, text),
        layout=layout,
        others=others,
        clock=clock,
    )


def is_poses(proposal: MapProposal) -> bool:
    """Return True if a proposal is a map of orientations."""
    return "quaternion" in proposal.columns


def _array_of(columns: Any, names: Sequence[str]) -> Any:
    """Return the name of an array instead of its three columns."""
    name = columns[0].removesuffix("[0]") if isinstance(columns, list) and isinstance(columns[0], str) else ""
    is_array = columns == [f"{name}[{k}]" for k in range(3)] and f"{name}[3]" not in names
    return name if is_array else columns


def _stated_rate(table: RawTable, text: Text | None) -> str:
    """Return the sample rate from a line before the header or a single-number array, or "?" if there is none."""
    for name, column in zip(table.names, table.columns, strict=False):
        if len(column) == 1 and _STATED_NAME.search(name) and (rate := table.numbers(name)[0]) > 0:
            return f"{rate:g}  # by {name}"
    for line in text.preamble if text else ():
        if match := _STATED_RATE.search(line):
            return f"{float(match.group(1)):g}  # by the line {json.dumps(line.strip()[:40])}"
    return "?"


def _quaternion(table: RawTable) -> list[str]:
    """Return the columns w, x, y, z of an orientation in a table without a gyroscope. Numbered columns keep their order."""
    if any(x is not None and x.channel == "gyro" for x in map(label_of, table.names)):
        return []
    parts: dict[str, dict[str, str]] = {}
    for name in table.names:
        match = None if name.strip().isdecimal() else _QUATERNION.match(name.strip())  # positions are not names
        if match and _TURNS.search(match["stem"]):
            parts.setdefault(match["stem"], {})[match["part"].lower()] = name
    for axes in parts.values():
        for order in ("wxyz", "0123"):
            if {*order} <= axes.keys():
                four = [axes[axis] for axis in order]
                length = np.linalg.norm(readings(table, four), axis=1)
                return four if len(length) and abs(float(np.median(length)) - 1.0) <= NEARLY_UNIT else []
    return []


def _by_name(table: RawTable) -> tuple[dict[str, Any], str]:
    """Return the columns of each channel, and the first columns of other sensors."""
    triples, keys = triples_of(table.names), dict[str, Any]()
    if not triples and (six := _sixes(table.names)):  # the usual order, to be checked
        keys = {key: [f"{six[0]}[{k + at}]" for k in range(3)] for key, at in (("accel", 0), ("gyro", 3))}
    labels = {axes: label_of(name) or label_of(re.sub(r"\d+$", "", name)) for axes, name in triples.items()}
    bare = [axes for axes, label in labels.items() if label is None and not _NO_SENSOR.search(axes[0])]
    is_gyro_file = _OF_GYRO.search(Path(table.source).name) is not None
    for channel, unlabelled in (("gyro", bare if is_gyro_file else []), ("accel", [] if is_gyro_file else bare)):
        named = [axes for axes, label in labels.items() if label is not None and label.channel == channel]
        if (axes := next(iter([*named, *unlabelled]), None)) is not None:
            keys[channel] = [*axes]
    for channel, pattern in _NAMED.items():
        name = next((n for n in table.names if pattern.match(n.strip().rpartition(".")[2])), None)
        if name is not None:
            keys = {channel: name, **keys} if channel == "time" else {**keys, channel: name}
    others = [[*axes] for axes, label in labels.items() if label is not None and label.channel in ("gyro", "accel")]
    others = [axes for axes in others if axes not in keys.values()]
    return keys, ", ".join(axes[0] for axes in others if not axes[0].endswith("[0]"))


def _by_position(table: RawTable) -> dict[str, Any]:
    """Return the columns of a table without names: an increasing first column is time, and the three axes with the most constant
    length are accelerometers."""
    width, cells = len(table.names), [str(cell) for cell in table.cells(0)[:8]]
    times = readings(table, [0])[:8, 0]
    grows = (len(times) > 1 and bool((np.diff(times) > 0.0).all()) and width not in (3, 6)) or all(map(is_date, cells))
    columns = {k: readings(table, [k]) for k in range(grows, width)}
    free = [k for k, values in columns.items() if len(values) and not _counts(values)]
    keys: dict[str, Any] = {"time": 0} if grows else {}
    if len(free) % 3 == 1:
        keys["temp"] = free.pop(0 if _is_temperature(columns[free[0]]) else -1)
    threes = [free[k : k + 3] for k in (0, 3) if k + 3 <= len(free)]
    if not threes:
        return {}
    if _OF_GYRO.search(Path(table.source).name):
        return keys | {"gyro": threes[0]}
    lengths = [_median_length(readings(table, axes)) for axes in threes]
    at_rest = [k for k, (x, _) in enumerate(lengths) if any(low <= x < high for low, high in _AT_REST.values())]
    accel = min(at_rest, key=lambda k: lengths[k][1], default=0)  # the most constant length
    keys["accel"] = threes[accel]
    return keys | ({"gyro": threes[1 - accel]} if len(threes) > 1 else {})


def _counts(values: FloatArray) -> bool:
    """Return True if a column counts rows: whole numbers that increase by 1 except when they restart."""
    steps = np.diff(values[:, 0])
    return len(steps) > 1 and bool(np.mean(steps == 1.0) > 0.9)


def _is_temperature(values: FloatArray) -> bool:
    """Return True if a column without a name may be a thermometer: fractions, larger than any reading of gravity in m/s2."""
    middle = float(np.median(values))
    return _WARM_C < middle < _TEMP_C[1] and not np.array_equal(values, np.round(values))


def _median_length(values: FloatArray) -> tuple[float, float]:
    """Return the median length of three axes, and the relative deviation from it, which is smallest for gravity."""
    length = np.linalg.norm(values, axis=1)
    middle = float(np.median(length)) if len(length) else 0.0
    return middle, float(np.median(np.abs(length - middle))) / middle if middle > 0.0 else float("inf")


def _order_of(time: FloatArray) -> str:
    """Return the key of a map for time stamps that repeat or step back."""
    steps = np.diff(time[:, 0])
    if (steps < 0.0).any():
        return f"repair_time = true  # {int((steps <= 0.0).sum())} time stamps repeat or step back: their rows are left out"
    repeated = int((steps == 0.0).sum())
    return f'clock = "regular"  # {repeated} time stamps repeat, as in the clock of a host' if repeated else ""


def _unit_of(channel: str, *names: str) -> str:
    """Return the unit in the names of columns, or "?" without one."""
    label = label_of(names[0])
    if label is not None and label.unit and label.gain == 1.0 and label.channel == channel:
        return label.unit
    listing = json.dumps(names, ensure_ascii=False)
    return next((unit for unit, pattern in _UNITS[channel] if re.search(pattern, listing, re.IGNORECASE)), "?")


def _units_by_size(table: RawTable, columns: dict[str, list[Column]]) -> dict[str, tuple[str, str]]:
    """Return proposed units of channels whose names have no unit, and the figure that suggests each."""
    values_of = {channel: values for channel in columns if len(values := readings(table, columns[channel])) > 1}
    proposed: dict[str, tuple[str, str]] = {}

    def add(channel: str, value: float, ranges: dict[str, tuple[float, float]], figure: str) -> None:
        unit = next((unit for unit, (low, high) in ranges.items() if low <= value < high), None)
        if unit is not None:
            proposed[channel] = (unit, f"{figure} {value:.4g}")

    if "accel" in values_of and values_of["accel"].shape[1] == 3:
        add("accel", _median_length(values_of["accel"])[0], _AT_REST, "the median |a|")
    if "gyro" in values_of:
        gyro = values_of["gyro"]
        largest, whole = float(np.abs(gyro).max()), np.array_equal(gyro, np.round(gyro))
        if whole and (largest > _COUNTS or proposed.get("accel", ("", ""))[0] == "count"):
            proposed["gyro"] = ("count", f"whole numbers up to {largest:.4g}")
        elif not whole and (largest >= _RATE["dps"][0] or _least_spread(gyro) < _SPREAD_RAD_S):
            add("gyro", largest, _RATE, "the largest rate")
    step = float(np.median(np.diff(values_of["time"][:, 0]))) if "time" in values_of else 1.0
    if step != 1.0:  # step of a counter, or 1 ms
        add("time", step, _STEP, "the median step")
    if "temp" in values_of and not np.array_equal(values_of["temp"], np.round(values_of["temp"])):
        add("temp", float(np.median(values_of["temp"])), {"degC": _TEMP_C}, "the median")
    return proposed


def _least_spread(values: FloatArray) -> float:
    """Return the standard deviation of the quietest 100 successive samples, averaged over the axes."""
    count = len(values) // 100
    if count == 0:
        return float("inf")
    return float(values[: 100 * count].reshape(count, 100, -1).std(axis=1).mean(axis=1).min())
