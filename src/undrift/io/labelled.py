"""Tables that contain their units: in lines before the header, in a unit row, or in names. Sensors may be next to each
other.

    A_X [mg]    accX[g]    Gyroscope x (rad/s)    Shimmer_40AC_Accel_LN_X_CAL over m/(s^2)    ACC X (G)

A column becomes a Label from its name and unit. Three labels x, y, z of the same sensor and unit become a channel. A
missing unit is never added here. Only a maker's reader may add it, and a note reports it.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import read_bytes
from undrift.io.column_map import AXES, QUANTITY, ChannelScale, ColumnMap, TextLayout, map_of_channels
from undrift.io.columns import EPOCH_S, RawTable, in_seconds, is_date, is_number
from undrift.io.text import Text, cells_of, packed, parse_text
from undrift.units import DEVICE_UNITS, canonical_unit, si_factor

_HEAD = 1 << 16
_TIME = "(time, s)"  # name of the column of time in s
_NUMERIC = 0.6  # of the filled cells of a row of readings


class Label(NamedTuple):
    """Content of a column."""

    sensor: str  # "" where the file names one sensor only
    channel: str  # time, gyro, accel, mag, temp, or "free": acceleration without gravity
    axis: str = ""  # x, y, z
    unit: str = ""  # canonical unit, or "" if it is not stated or not known
    gain: float = 1.0  # To that unit
    rate_hz: float | None = None  # time of this channel, if channels of several rates are side by side
    time: int | None = None  # Its own time column


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """A text export with its header read, and the additions of a maker's reader."""

    path: Path
    names: tuple[str, ...]
    layout: TextLayout
    rows: bytes  # From the first row of readings on
    preamble: tuple[str, ...] = ()  # Lines before the header
    units: tuple[str, ...] = ()  # From the unit row, "" elsewhere
    unit_row: bool = False
    labels: tuple[Label | None, ...] = ()
    rate_hz: float | None = None  # Hz, as the file states it
    device: str = ""
    notes: tuple[str, ...] = ()
    # time in s and notes from the columns ``counters``, without a column of time
    clock: Callable[..., tuple[FloatArray, tuple[str, ...]]] | None = None
    counters: tuple[int, ...] = ()
    repair_time: bool = False  # Stamps may repeat: such rows are left out and counted

    def position(self, pattern: str) -> int | None:
        """Return the first column whose name matches."""
        return next((k for k, name in enumerate(self.names) if re.search(pattern, name, re.IGNORECASE)), None)

    def stated(self, pattern: str) -> str | None:
        """Return the first group of a pattern in the preamble."""
        match = re.search(pattern, "\n".join(self.preamble), re.IGNORECASE | re.MULTILINE)
        return match.group(1).strip() if match else None

    def columns(self, *positions: int, drop_bad_rows: bool = False) -> RawTable:
        """Parse the rows. The columns with a label contain numbers."""
        layout = self.layout.but(drop_bad_rows=drop_bad_rows)
        head = self.rows[: 1 << 20]
        text = Text(path=self.path, content=self.rows, head=head, names=self.names, layout=layout, skip=0)
        return parse_text(text, positions)

    def counted(self, table: RawTable) -> tuple[FloatArray, tuple[str, ...]]:
        """Return the time from the counters of a parsed table, s, and the notes of the clock."""
        counts = [table.numbers(k) for k in self.counters]
        for k, counter in zip(self.counters, counts, strict=True):
            if not np.isfinite(counter).all():
                raise FileFormatError(
                    f"{self.path}: column {self.names[k]!r}: expected a count in every row, got none in data row "
                    f"{int(np.isfinite(counter).argmin()) + 1}. Repair the file."
                )
        return (np.empty(0), ()) if self.clock is None else self.clock(*counts)

    def array(self, positions: tuple[int, ...] | list[int]) -> FloatArray:
        """Return columns as numbers, (N, K)."""
        table = self.columns(*positions)
        return np.stack([table.numbers(k) for k in positions], axis=1)


# ---- the lines of a text export


def open_sheet(path: str | Path, *, header: bool = True) -> Sheet:
    """Find header, unit row and first row of readings of a text export in UTF-8 or Latin-1."""
    path = Path(path)
    sheet = sheet_of(path, read_bytes(path))
    if sheet is None or (header and not any(sheet.names)):
        raise FileFormatError(f"{path}: expected a header line above rows of numbers, got none. Check the export.")
    first = cells_of(sheet.rows.split(b"\n", 1)[0].decode("utf-8", "replace"), sheet.layout.delimiter)
    if header and not sheet.names[-1] and len(first) == len(sheet.names) and first[-1]:
        raise FileFormatError(
            f"{path}: expected a name for each of {len(first)} columns, got fewer. Repair the header."
        )
    return sheet


def sheet_of(path: Path, content: bytes) -> Sheet | None:
    """Return the sheet in a text, None where it has no rows of numbers."""
    content = as_utf8(content)
    raw = content[:_HEAD].split(b"\n")
    raw = raw[:-1] if len(content) > _HEAD else raw
    lines = [line.decode("utf-8", "replace").rstrip("\r") for line in raw]
    delimiter, decimal = marks_of([line for line in lines if line.strip()])
    table = [cells_of(line, delimiter) for line in lines]
    rows = [k for k, cells in enumerate(table) if _is_row(cells, decimal)]
    start = next((k for k in rows if k + 1 in rows or k + 2 in rows or k == len(table) - 1), None)
    if start is None:
        return None
    above = [k for k in range(start) if lines[k].strip()]
    unit_row = len(above) > 1 and _are_units(table[above[-1]]) and not _are_units(table[above[-2]])
    units = [_bare(cell) for cell in table[above.pop()]] if unit_row else []
    at = above[-1] if above else None
    names = table[at] if at is not None else []
    offset = sum(len(line) + 1 for line in raw[:start])
    width = Counter(len(table[k]) for k in rows if k >= start).most_common(1)[0][0]
    while len(names) > width and not names[-1]:
        names = names[:-1]
    width = max(width, len(names))
    return Sheet(
        path=path,
        preamble=tuple(lines[:at] if at is not None else lines[:start]),
        names=tuple(names) + ("",) * (width - len(names)),
        units=tuple(units[:width]) + ("",) * (width - len(units)),
        layout=TextLayout(delimiter=delimiter, decimal=decimal, header=False),
        rows=packed(content[offset:]) if delimiter == " " else content[offset:],
        unit_row=unit_row,
    )


def as_utf8(content: bytes) -> bytes:
    """Return text as UTF-8 without a byte-order mark. Text that is not UTF-8 is read as Latin-1."""
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        content = content.decode("cp1252", "replace").encode("utf-8")
    return content.removeprefix(b"\xef\xbb\xbf")


def marks_of(lines: list[str]) -> tuple[str, str]:
    """Return delimiter and decimal sign of most lines. A comma is a delimiter only if no other character can be."""
    body = lines[-max(2, len(lines) // 4) :][-32:]
    delimiter = next((mark for mark in ";\t," if sum(mark in line for line in body) > 0.8 * len(body)), " ")
    if delimiter == ",":
        return delimiter, "."
    cells = [cell for line in body for cell in cells_of(line, delimiter)]
    commas = sum(bool(re.fullmatch(r"[-+]?\d+,\d+([eE][-+]?\d+)?", cell)) for cell in cells)
    points = sum(bool(re.fullmatch(r"[-+]?\d*\.\d+([eE][-+]?\d+)?", cell)) for cell in cells)
    return delimiter, "," if commas > points else "."


def _is_row(cells: list[str], decimal: str) -> bool:
    filled = [cell.replace(decimal, ".") for cell in cells if cell]
    numbers = sum(is_number(cell) for cell in filled)
    return numbers >= min(3, len(cells)) > 0 and numbers >= _NUMERIC * len(filled)


def _bare(cell: str) -> str:
    """Return a unit without the brackets around it."""
    return cell[1:-1].strip() if re.fullmatch(r"\([^()]*\)|\[[^\[\]]*\]", cell) else cell


def _are_units(cells: list[str]) -> bool:
    filled = [_bare(cell) for cell in cells if cell]
    return bool(filled) and sum(is_unit(cell) for cell in filled) >= _NUMERIC * len(filled)


# ---- units and names

_SPELLED = {
    "m/(s^2)": "m/s2", "m/s**2": "m/s2", "m.s-2": "m/s2", "m s-2": "m/s2", "degrees celsius": "degc", "deg_c": "degc",
    "degree/s": "dps", "°/sec": "dps", "deg/sec.": "dps", "mdps": "dps", "μt": "ut", "nt": "ut", "μs": "us",
    "no_units": "count", "ga": "gauss", "mga": "mgauss", "tesla": "t",
}  # fmt: skip
_GAIN = {"mdps": 1e-3, "nt": 1e-3}
_OTHER = {
    "mv", "uv", "us", "kohms", "ohm", "local_flux", "kpa", "hpa", "pa", "mbar", "bar", "deg", "rad", "%", "a.u.", "-", "m",
    "mm", "cm", "hz", "lux", "n", "nm", "unixtime", "n/a",
}  # fmt: skip
_KIND = tuple(
    (channel, re.compile(pattern, re.IGNORECASE))
    for channel, pattern in (
        ("free", r"linear|free_?acc|user_? ?acc|lin_acc|without.?g|no.?gravity"),
        (
            "gyro",
            r"gyr|angular.?(velocity|rate|speed)|turn.?rate|rotation.?rate|omega|^(gy|[gw])[ _.]*$",
        ),
        ("mag", r"magn|^mag|[ _.]mag|compass|^[bm][ _.]*$"),
        ("accel", r"acc|specific.?force|^(ac?|gF)[ _.]*$"),
        ("temp", r"temp(?!o\b|s\b)|^tmp$|thermo"),
        ("time", r"^(ts?|millis|micros)\s*$|time|seconds_elapsed"),
    )
)
_NATIVE = {"dps": "dps", "rad_s": "rad/s", "m_s2": "m/s2"} | {unit: unit for unit in ("g", "mg", "ut", "s", "ms", "us")}
_SUFFIX = re.compile(rf"(?i)_({'|'.join(_NATIVE)})$")
_AXIS = (
    re.compile(r"(?i)(?<![a-z])([xyz])(?![a-z])"),
    re.compile(r"(?<=[a-z])([XYZ])(?![A-Za-z])"),
    re.compile(r"(?i)^(?:a|w|g|gF|b|m|acc|accel|gyr|gyro|mag)_?([xyz])$"),
)
_WORDS = re.compile(  # words of a name that do not distinguish sensors
    r"(?i)^(acc\w*|gyr\w*|mag\w*|sensor|angular|velocity|rate|magnetic|field|un|cal|raw|noraxon|myomotion|segments|[agwm]|gf|"
    r"temp\w*|turn|rotation|specific|force|total|uncalibrated|imu)$"
)


def unit_for(text: str, channel: str) -> tuple[str, float] | None:
    """Return a unit in its canonical spelling and the gain to it, or None if the text is not a unit of this channel."""
    name = text.strip().lower()
    gain, name = _GAIN.get(name, 1.0), _SPELLED.get(name, name)
    if channel == "mag":
        name = {"g": "gauss", "mg": "mgauss"}.get(name, name)
    try:
        return canonical_unit(name, QUANTITY["accel" if channel == "free" else channel]), gain  # type: ignore[index]
    except InputError:
        return None


def is_unit(text: str) -> bool:
    """Return True if a cell is a unit."""
    return text.strip().lower() in _OTHER or any(unit_for(text, channel) for channel in QUANTITY)


def split_unit(name: str) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit: "A_X [mg]", "Time (s)", "Accel X,mG", "Time in ms", "acc_x_g"."""
    match = re.fullmatch(r"(.*?)[\s_]*[\[(]([^\[\]()]*(?:\([^()]*\))?)[\])]\s*", name) or re.fullmatch(
        r"(.+?)(?:,| in (?=[mu]?s *$))\s*(\S*)\s*", name
    )
    if match and (is_unit(match.group(2)) or not re.search(r"\d\]$", name)):
        return match.group(1), match.group(2)
    suffix = _SUFFIX.search(name)
    if suffix and any(pattern.search(name) for _, pattern in _KIND):
        return name[: suffix.start()], _NATIVE[suffix.group(1).lower()]
    return name, ""


def label_of(name: str, unit: str = "", assumed: Mapping[str, str] | None = None) -> Label | None:
    """Return the content of a column from its name and unit. The units ``assumed`` come from a maker's manual."""
    base, name_unit = split_unit(name)
    unit, axis, stem = unit or name_unit, "", base
    for pattern in _AXIS:
        if hits := list(pattern.finditer(base)):
            at = hits[-1]
            axis, stem = at.group(1).lower(), base[: at.start(1)] + base[at.end(1) :]
            break
    channel = next((channel for channel, pattern in _KIND if pattern.search(stem)), None)
    if channel is None and axis and unit:
        fits = [other for other in ("gyro", "accel", "mag") if unit_for(unit, other) and (other, unit) != ("mag", "g")]
        channel = fits[0] if len(fits) == 1 else None
    if channel == "time" and stem.strip() == "T" and not unit:
        return None  # it names a temperature as often as a time
    if channel == "time" and unit and not unit_for(unit, "time") and unit_for(unit, "temp"):
        channel = "temp"  # "T" in degC
    if channel is None or (not axis and channel not in ("time", "temp")):
        return None
    scaled_unit = unit_for(unit or (assumed or {}).get(channel, ""), channel)
    if unit and scaled_unit is None and channel in ("gyro", "accel") and is_unit(unit):
        return None  # the unit contradicts the name
    tokens = re.split(r"[\W_]+", stem) if channel not in ("time", "free") else []
    kind = dict(_KIND)[channel]
    tokens = [token for token in tokens if token and not _WORDS.match(token) and not kind.search(token)]
    if scaled_unit and scaled_unit[0] in DEVICE_UNITS and channel in ("mag", "temp"):
        scaled_unit = None  # they need a scale from a map
    return Label(
        " ".join(tokens), channel, axis if channel not in ("time", "temp") else "", *(scaled_unit or ("", 1.0))
    )


def labelled(sheet: Sheet, assumed: Mapping[str, str] | None = None, *, whole_names: bool = False) -> Sheet:
    """Return the sheet with a label for each column, sensors named by what their names do not share, or by whole names."""
    read_labels = [label_of(name, unit, assumed) for name, unit in zip(sheet.names, sheet.units, strict=True)]
    sensor_words = [set(label.sensor.split()) for label in read_labels if label and label.axis]
    shared = set.intersection(*sensor_words) if sensor_words and not whole_names else set()
    labels = tuple(
        label and label._replace(sensor=" ".join(word for word in label.sensor.split() if word not in shared))
        for label in read_labels
    )
    clocks = [k for k, label in enumerate(labels) if label and label.channel == "time"]
    first = cells_of(sheet.rows.split(b"\n", 1)[0].decode("utf-8", "replace"), sheet.layout.delimiter)
    dated = [k for k in clocks if k < len(first) and is_date(first[k])]
    if dated and not any(label.unit for k in clocks if k not in dated and (label := labels[k])):
        labels = tuple(
            label._replace(unit="date") if label and k == dated[0] else label for k, label in enumerate(labels)
        )
    return replace(sheet, labels=labels)


def with_manual(sheet: Sheet, maker: str, assumed: Mapping[str, str], *, whole_names: bool = False) -> Sheet:
    """Return the sheet with labels whose units come from a maker's manual, and a note of those that it supplied."""
    labelled_channels = {label.channel for label in labelled(sheet).labels if label and label.unit}
    sheet = labelled(sheet, assumed, whole_names=whole_names)
    assumed_channels = {label.channel for label in sheet.labels if label and label.unit} - labelled_channels
    units = ", ".join(f"{channel} {unit}" for channel, unit in assumed.items() if channel in assumed_channels)
    note = (f"units by the manual of {maker}, not in the file: {units}",) if units else ()
    return replace(sheet, notes=(*sheet.notes, *note))


# ---- from labels to a record

Triples = dict[str, dict[str, tuple[int, ...]]]  # channel, sensor: the columns x, y, z


def triples_of(sheet: Sheet, channels: tuple[str, ...] = ("gyro", "accel", "mag")) -> Triples:
    """Return the three axes of each channel and sensor. Physical units are preferred to counts."""
    triples: Triples = {}
    for channel in channels:
        groups: dict[tuple[str, str, float], dict[str, int]] = {}
        for k, label in enumerate(sheet.labels):
            if label and label.channel == channel and label.unit:
                groups.setdefault((label.sensor, label.unit, label.gain), {}).setdefault(label.axis, k)
        for (sensor, unit, _), axes in groups.items():
            sensors = triples.setdefault(channel, {})
            if len(axes) == 3 and (sensor not in sensors or unit != "count"):
                sensors[sensor] = tuple(axes[axis] for axis in AXES)
    return {channel: sensors for channel, sensors in triples.items() if sensors}


def sheet_table(sheet: Sheet, how: ColumnMap) -> RawTable:
    """Return the columns of one sensor of a labelled sheet, with the map that its labels state and notes on the reading."""
    triples = triples_of(sheet)
    _check_readings(sheet, triples)
    chosen = _chosen(sheet, triples, how.sensor)
    labels = [label for columns in chosen.values() for k in columns if (label := sheet.labels[k])]
    rates = {label.rate_hz for label in labels}
    if len(rates) > 1:
        listed = ", ".join(f"{rate:g} Hz" for rate in sorted(rate for rate in rates if rate))
        raise InputError(
            f"{sheet.path}: expected one sample rate in one sensor, got {listed}. Export each rate to its own file."
        )
    temp = _temperature(sheet, how.sensor)
    columns = chosen if temp is None else chosen | {"temp": (temp,)}
    stated = next((k for k, label in enumerate(sheet.labels) if label and label.channel == "time" and label.unit), None)
    clock = labels[0].time if labels[0].time is not None else stated
    table, time = _timed(sheet, [k for held in columns.values() for k in held], clock, how)
    stated_hz = how.sample_rate_hz or sheet.rate_hz
    if time is None and (stated_hz := stated_hz or labels[0].rate_hz) is None:
        raise InputError(
            f"{sheet.path}: there is no time column and no sample rate. Set `sample_rate_hz`, or use a map "
            "(`column_map` FILE).",
            missing="sample_rate_hz",
        )
    table, trimmed = (table, ()) if None in rates else _trimmed(table, chosen)
    firsts = {channel: label for channel, held in columns.items() if (label := sheet.labels[held[0]])}
    own = map_of_channels(
        {**chosen, "temp": temp, "time": None if time is None else _TIME},
        {"time": "s"} | {channel: label.unit for channel, label in firsts.items()},
        scale={channel: ChannelScale(gain=label.gain) for channel, label in firsts.items() if label.gain != 1.0},
        sample_rate_hz=stated_hz,
        gaps=how.gaps,
        clock=how.clock,
        repair_time=how.repair_time or sheet.repair_time,
        device=sheet.device or next((label.sensor for label in labels if label.sensor), ""),
    )
    return replace(table, own=own, notes=(*sheet.notes, *table.notes, *_notes(sheet, triples), *trimmed))


def _timed(sheet: Sheet, positions: list[int], clock: int | None, how: ColumnMap) -> tuple[RawTable, FloatArray | None]:
    """Return the parsed columns with a column of time, and the time, s: by counters, by dates, or by a column of numbers."""
    label = None if clock is None else sheet.labels[clock]
    dated = label is not None and label.unit == "date"
    counts = sheet.counters if sheet.clock else () if clock is None or dated else (clock,)
    table = sheet.columns(*positions, *counts, drop_bad_rows=how.drop_bad_rows)
    notes, epoch_s = tuple[str, ...](), 0.0
    if sheet.clock is not None:
        time, notes = sheet.counted(table)
    elif clock is None or label is None:
        return table, None
    else:
        factor = si_factor(label.unit, "time")
        cells = (in_seconds(table, clock) if dated else table).numbers(clock)
        first = float(cells[0]) if len(cells) and cells[0] * factor > EPOCH_S else 0.0
        time, epoch_s = (cells - first) * factor, first * factor
    names, columns = (*table.names, _TIME), (*table.columns, time)
    return replace(table, names=names, columns=columns, notes=notes, epoch_s=epoch_s), time


def _trimmed(table: RawTable, chosen: Mapping[str, tuple[int, ...]]) -> tuple[RawTable, tuple[str, ...]]:
    """Cut the rows that a slower channel does not fill, and the zeros with which it starts."""
    values = np.stack([table.numbers(k) for columns in chosen.values() for k in columns], axis=1)
    filled = np.isfinite(values).any(axis=1)
    live = np.flatnonzero(filled & (values != 0.0).any(axis=1))
    if not len(live):
        return table, ()
    cut = slice(int(live[0]), int(np.flatnonzero(filled)[-1]) + 1)
    notes = (f"{cut.start} rows of zeros at the start left out",) if cut.start else ()
    return replace(table, columns=tuple(column[cut] for column in table.columns)), notes


def _check_readings(sheet: Sheet, triples: Triples) -> None:
    if triples.get("gyro") or triples.get("accel"):
        return
    free = [name for name, label in zip(sheet.names, sheet.labels, strict=True) if label and label.channel == "free"]
    if free:
        raise FileFormatError(
            f"{sheet.path}: expected accelerometer readings with gravity, got {free[0]!r}, acceleration without "
            "gravity. Record or export the acceleration with gravity.",
            missing="readings",
        )
    listing = ", ".join(repr(name) for name in sheet.names[:8] if name)
    raise FileFormatError(
        f"{sheet.path}: expected gyroscope or accelerometer columns x, y, z with a unit, got {listing}. Export them, "
        "or use a map (`column_map` FILE).",
        missing="readings",
    )


def _chosen(sheet: Sheet, triples: Triples, sensor: str | None) -> dict[str, tuple[int, ...]]:
    sensors = [sensor for channel in ("accel", "gyro") for sensor in triples.get(channel, {}) if sensor]
    names = tuple(dict.fromkeys(sensors))
    several = any(len(held) > 1 for channel, held in triples.items() if channel != "mag")
    same = [name for name in names if sensor is not None and name.lower() == sensor.lower()]
    partial_matches = [name for name in names if sensor is not None and sensor.lower() in name.lower()]
    # column of this name, or the only one whose name contains it
    wanted = same[0] if same else partial_matches[0] if len(partial_matches) == 1 else None
    if wanted is None and names and (several or sensor is not None):
        got = "none" if sensor is None else repr(sensor)
        raise InputError(
            f"{sheet.path}: expected the name of one sensor, got {got}. The file contains {', '.join(names)}. "
            f"Choose one with `sensor`.",
            missing="sensor",
            names=names,
        )
    chosen: dict[str, tuple[int, ...]] = {}
    for channel, by_sensor in triples.items():
        if wanted is not None:
            columns = by_sensor.get(wanted) or by_sensor.get("")
        elif channel == "mag" and len(by_sensor) > 1:
            columns = None  # which magnetometer goes with the sensor is not known
        else:
            columns = next(iter(by_sensor.values()))
        if columns is not None:
            chosen[channel] = columns
    return chosen


def _temperature(sheet: Sheet, sensor: str | None) -> int | None:
    thermometers = [
        (label.sensor, k) for k, label in enumerate(sheet.labels) if label and label.channel == "temp" and label.unit
    ]
    mine = [k for name, k in thermometers if sensor is not None and name.lower() == sensor.lower()]
    return mine[0] if mine else thermometers[0][1] if len(thermometers) == 1 else None


def _notes(sheet: Sheet, triples: Triples) -> tuple[str, ...]:
    """Return how a sheet was read and what of it was left out."""
    notes = []
    if lines := sum(bool(line.strip()) for line in sheet.preamble):
        notes.append(f"lines before the header skipped: {lines}")
    if sheet.unit_row:
        notes.append("units from the row under the header")
    free = next((name for name, x in zip(sheet.names, sheet.labels, strict=True) if x and x.channel == "free"), None)
    if free:
        notes.append(f"{free!r} left out: gravity is removed in it")
    for channel, what in (("gyro", "turn rate"), ("accel", "acceleration"), ("mag", "magnetic field")):
        labels = zip(sheet.names, sheet.labels, strict=True)
        bare = next((name for name, x in labels if x and x.channel == channel and not x.unit), None)
        axes = {x.axis for x in sheet.labels if x and x.channel == channel and x.unit}
        if axes and channel not in triples:
            notes.append(f"{what} left out: it has axes {', '.join(sorted(axes))} alone")
        if bare and channel not in triples:
            notes.append(f"{bare!r} left out: it has no unit of {'an' if what[0] == 'a' else 'a'} {what}")
    return tuple(notes)


# ---- any table that states all it needs


def is_labelled(path: Path, head: bytes) -> bool:
    """Return True if a text contains a unit for a gyroscope or an accelerometer, and for its time column, if any."""
    if b"\0" in head or not head or path.suffix.lower() in (".md", ".rst", ".pdf", ".html", ".json", ".toml", ".xml"):
        return False
    sheet = sheet_of(path, head if len(head) < 8192 else head[: head.rfind(b"\n") + 1])
    return sheet is not None and any(sheet.names) and states_units(labelled(sheet))


def states_units(sheet: Sheet) -> bool:
    """Return True if labels contain a unit for a gyroscope or an accelerometer, and for the time column, if any."""
    clocks = [label for label in sheet.labels if label and label.channel == "time"]
    triples = triples_of(sheet, ("gyro", "accel", "free"))
    bare = {label.channel for label in sheet.labels if label and not label.unit and label.channel in ("gyro", "accel")}
    return bool(triples) and bare <= triples.keys() and (not clocks or any(clock.unit for clock in clocks))


def read_labelled(path: Path, how: ColumnMap) -> RawTable:
    """Read a table whose names or unit row state every unit."""
    return sheet_table(labelled(open_sheet(path)), how)
