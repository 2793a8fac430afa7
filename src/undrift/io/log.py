"""Logs of a serial port: the text that firmware prints, as a table. The words around the numbers are used as names, and no maker is
assumed.

A line is split into numbers and the text between them, its shape. Shapes that repeat are readings. A reading may consist of several
lines in turn. Lines of other shapes (boot messages, truncated lines) are omitted and counted. A heading without numbers that ends
with a colon belongs to the lines under it. A line may begin with a time stamp::

    12:34:56.789 -> ...      [2026-11-27 12:34:56.789] ...      [00:00:01.234,567] <inf> imu: ...      I (1234) imu: ...

The name of a number is the word before it. Its unit is the word after it or, for three axes, after the last number::

    ax:0.01,ay:...      a/g: -12 34 ...      Acceleration X: 0.12, Y: 0.03, Z: 9.81 m/s^2      {"acc": [0.1, 0.2, 9.8]}
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, groupby, pairwise
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

from undrift.errors import InputError
from undrift.files import read_bytes, read_so_far
from undrift.io.column_map import AXES, ColumnMap, TextLayout
from undrift.io.columns import RawTable, is_date, is_number
from undrift.io.labelled import labelled, sheet_table, states_units
from undrift.io.labels import is_unit, label_of
from undrift.io.text import Text, as_utf8, find_table, parse_text, text_of

_HEAD = 1 << 16
_WATCHED = 1 << 16  # number of lines between two progress messages
_LEAST = 5  # smallest number of readings of a log, and largest number of lines of one reading
_SHARE = 0.5  # a line shape belongs to every reading if it has this share of the lines of the most frequent shape
_MOST_LINES = 24  # largest number of lines of one reading
_NUMBER = re.compile(r"(?<![\w.^])[-+]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|(?:nan|inf)\b)")
_UNSEEN = re.compile(
    r"\x1b\[[0-9;]*[A-Za-z]|[\x01-\x08\x0b\x0c\x0e-\x1f\x7f]|\x00+$"
)  # terminal colours, noise of a port, and the end of a C string; other zeros mean damage
_DAY_S = 86400.0
_STAMPS = (  # time stamps of a monitor or of a system, the latter with level and component
    re.compile(
        r"\[?(?:\d{4}-\d\d-\d\d[ T])?(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d[.,]\d{3})(?:,?(?P<us>\d{3}))?Z?"
        r"(?: ->|\]:?(?: <\w+> [\w./-]+:)?)"
    ),
    re.compile(r"\[ *(?P<s>\d+\.\d+)\]"),
    re.compile(r"[EWIDV] \((?P<ms>\d+)\) [\w./-]+:"),
)
_WORD = re.compile(r"[^\W\d_][^\s:=,;|\"'{}\[\]()]*")
_IN_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_UNITS_BEHIND = tuple(
    re.compile(words + r"(?!\s*[:=\w])") for words in (r"\s*(\S+ [^\s,;|:=\"\]}]+)", r"\s*([^\s,;|:=\"\]}]+)")
)
_BOTH = re.compile(r"(?i)a/g|acc\w*[ /+&]+gyr\w*")  # name before three accelerometer and three gyroscope readings


class LogLine(NamedTuple):
    """The parts of a line with numbers."""

    shape: tuple[str, ...]  # heading above the line, text before each number, and text after the last
    values: tuple[str, ...]
    stamp_s: float | None


@dataclass(frozen=True, slots=True)
class SerialLog:
    """The readings in a log, as a table."""

    names: tuple[str, ...]  # name of each column, or its position
    content: bytes  # the readings as CSV without a header
    before: int  # number of lines with numbers before the first reading
    lost: int  # number of later lines with numbers that do not belong to a reading
    plain: bool  # True if there are only separators of a table between the numbers


# ---- from text to lines to readings


class LineReader:
    """Parser of single lines. A heading belongs to the lines below it, and a time of day continues past midnight."""

    def __init__(self) -> None:
        self._heading, self._day, self._before = "", 0.0, 0.0

    def take(self, raw: str) -> LogLine | None:
        """Return the parts of a line that contains numbers."""
        stamp, line = _stamp(_UNSEEN.sub("", raw.rstrip("\r\n")).strip())
        if stamp is not None:
            self._day += _DAY_S * (stamp + self._day < self._before - 0.5 * _DAY_S)  # past midnight
            self._before = stamp = stamp + self._day
        cells = _NUMBER.split(line)
        if len(cells) > 1:
            shape = (self._heading, *(" ".join(cell.split()) for cell in cells))
            return LogLine(shape, tuple(_NUMBER.findall(line)), stamp)
        if line.endswith(":"):
            self._heading = line.rstrip(":")
        return None


def lines_of(content: bytes, path: Path | None = None) -> Iterator[LogLine]:
    """Yield the lines with numbers of a file, or of its beginning. The last line counts only if it is complete."""
    text, reader = as_utf8(content).decode("utf-8", "replace"), LineReader()
    lines = text[: text.rfind("\n") + 1].splitlines()
    for number, raw in enumerate(lines, 1):
        if (line := reader.take(raw)) is not None:
            yield line
        if path is not None and number % _WATCHED == 0:
            read_so_far(path, number / len(lines))


def _stamp(line: str) -> tuple[float | None, str]:
    """Return the time of a time stamp before a line, s, and the line without the time stamp."""
    for pattern in _STAMPS:
        if match := pattern.match(line):
            clock = {key: float(cell.replace(",", ".")) for key, cell in match.groupdict().items() if cell}
            seconds = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6}
            return sum(seconds[key] * value for key, value in clock.items()), line[match.end() :].strip()
    return None, line


def cycle_of(lines: Sequence[LogLine]) -> list[tuple[str, ...]]:
    """Return the shapes that repeat in turn, or an empty result if there are too few or too many."""
    counts = Counter(line.shape for line in lines)
    most = max(counts.values(), default=0)
    frequent = [line.shape for line in lines if counts[line.shape] >= _SHARE * most]
    cycle = list(dict.fromkeys(frequent[: 4 * _MOST_LINES]))
    return cycle if most >= _LEAST and len(cycle) <= _MOST_LINES else []


def find_readings(content: bytes, path: Path | None = None) -> SerialLog | None:
    """Return the readings of a log, or None if no line shape repeats."""
    every = list(lines_of(content, path))
    cycle = cycle_of(every)
    readings = list(readings_in(every, cycle))
    if len(readings) < _LEAST:
        return None
    names = names_of(*cycle)
    if bare := all(name == "" for name in names):
        names = [str(k) for k in range(len(names))]
    clocks = [label for name in names if (label := label_of(name)) and label.channel == "time"]
    stamped = not clocks and all(lines[0].stamp_s is not None for lines in readings)
    rows = [[value for line in lines for value in line.values] for lines in readings]
    if stamped:
        names = [str(k) for k in range(len(names) + 1)] if bare else ["time (s)", *names]
        rows = [[f"{lines[0].stamp_s:.6f}", *row] for lines, row in zip(readings, rows, strict=True)]
    column_names = tuple(name or f"column {k}" for k, name in enumerate(names))
    before = every.index(readings[0][0])
    lost = len(every) - before - len(readings) * len(cycle) + (not content.endswith(b"\n"))
    plain = not stamped and not "".join(chain.from_iterable(cycle)).strip(" ,;")
    return SerialLog(column_names, "".join(",".join(row) + "\n" for row in rows).encode(), before, lost, plain)


def readings_in(lines: Iterable[LogLine], cycle: Sequence[tuple[str, ...]]) -> Iterator[list[LogLine]]:
    """Yield the lines of each complete reading: every shape of the cycle in turn. Other lines in between are left out."""
    reading: list[LogLine] = []
    for line in (line for line in lines if line.shape in cycle):
        if line.shape != cycle[len(reading)]:
            reading = []
        if line.shape == cycle[len(reading)]:
            reading.append(line)
        if len(reading) == len(cycle):
            yield reading
            reading = []


# ---- from the words around numbers to names with units


class NumberSlot(NamedTuple):
    """Position of a number in a line shape."""

    group: tuple[int, int]  # line, and preceding word in it: numbers after the same word form a group
    word: str
    axis: str
    unit: str


def names_of(*shapes: tuple[str, ...]) -> list[str]:
    """Return a name for each number of the shapes: word, axis and unit for ``label_of``, or "" without a name."""
    slots = list(chain.from_iterable(_slots(line, *shape) for line, shape in enumerate(shapes)))
    names = list[str]()
    for _, members in groupby(slots, key=itemgetter(0)):
        group = list(members)
        word, unit = group[0].word, next((slot.unit for slot in reversed(group) if slot.unit), "")
        axes = [slot.axis for slot in group]
        if not any(axes) and len(group) == 6 and _BOTH.search(word):
            names += [f"{channel} {axis}" for channel in ("acc", "gyr") for axis in AXES]
            continue
        if not any(axes) and len(group) == 3 and word:
            axes = list(AXES)
        nameless = not word or (len(group) > 1 and not all(axes))
        names += ["" if nameless else f"{word} {axis}".strip() + f" ({unit})" * bool(unit) for axis in axes]
    return names


def _slots(line: int, heading: str, *cells: str) -> Iterator[NumberSlot]:
    """Yield the position of each number: the text before it and, for its unit, the text after it."""
    group, word, inner = 0, heading, ""
    for cell, behind in pairwise(cells):
        text = cell if cell is cells[0] else cell[len(_unit_of(cell)[1]) :]
        units = [bracket for bracket in _IN_BRACKETS.findall(text) if is_unit(bracket)]
        name_words = _WORD.findall(_IN_BRACKETS.sub(" ", text))
        axis = name_words.pop().lower() if name_words and name_words[-1].lower() in AXES else ""
        if heading and cell is cells[0] and is_unit(" ".join(name_words)):  # "Degrees C = 25.1" under "Thermometer:"
            units, name_words = [" ".join(name_words)], []
        if name_words or units:
            group, word, inner = group + 1, _quantity(name_words) if name_words else word, units[0] if units else ""
        yield NumberSlot((line, group), word, axis, _unit_of(behind)[0] or inner)


def _unit_of(behind: str) -> tuple[str, str]:
    """Return the unit at the start of the text after a number, and the text of the unit. Return "" if there is no unit."""
    for pattern in _UNITS_BEHIND:
        if (match := pattern.match(behind)) and is_unit(unit := match.group(1)):
            return unit, match.group()
    return "", ""


def _quantity(name_words: Sequence[str]) -> str:
    """Return the last words that name the same quantity as the whole text: "Acc" for "Scaled. Acc"."""

    def channel(some: Sequence[str]) -> str:
        label = label_of(f"{' '.join(some)} x")
        return label.channel if label else ""

    wanted = channel(name_words)
    return " ".join(
        next(
            (name_words[k:] for k in reversed(range(len(name_words))) if wanted and channel(name_words[k:]) == wanted),
            name_words,
        )
    )


# ---- as a format


def is_log(path: Path, head: bytes) -> bool:
    """Return True for a log: words, time stamps, quotes or noise around numbers, and no header with column names."""
    if path.suffix.lower() in (".md", ".rst", ".pdf", ".html", ".toml", ".xml"):
        return False
    head = read_bytes(path, _HEAD)
    head = head[: head.rfind(b"\n") + 1]
    table = find_table(path, head)
    if table is not None and table.layout.header:
        return False
    log = find_readings(head)
    if log is None or len(log.names) < 3 or log.lost > 0.2 * log.content.count(b"\n"):
        return False
    first = head.lstrip().partition(b"\n")[0].decode("utf-8", "replace").split(",")
    return not (
        all(is_number(cell, empty=True) or is_date(cell.strip()) for cell in first) or (log.plain and b"\0" not in head)
    )


def read_readings(path: Path) -> SerialLog:
    """Return the readings of a log."""
    log = _readings_of(path, path.stat().st_size, path.stat().st_mtime_ns)
    if log is None:
        raise InputError(
            f"{path}: expected lines of one shape with numbers, got none. Log only the lines with readings."
        )
    return log


@lru_cache(maxsize=1)  # cached, because a file is described, searched for labels and read
def _readings_of(path: Path, _size: int, _time: int) -> SerialLog | None:
    return find_readings(read_bytes(path), path)


def log_text(path: Path, log: SerialLog | None = None) -> Text:
    """Return the readings of a log as a text table."""
    log = log or read_readings(path)
    return text_of(path, log.content, log.names, TextLayout(header=not log.names[-1].isdecimal()))


def read_log(path: Path, how: ColumnMap) -> RawTable:
    """Read a log with a map, or without a map if the log contains its units."""
    log = read_readings(path)
    text = log_text(path, log)
    if how.columns:
        table = parse_text(text, how.wanted(numeric=True))
    elif states_units(sheet := labelled(text)):
        table = sheet_table(sheet, how)
    else:
        raise InputError(
            f"{path}: expected units in a log, got {', '.join(log.names[:8])} without. Run undrift info FILE "
            "--write-map map.toml to propose a map, and give the map with `column_map`."
        )
    count = log.content.count(b"\n")
    note = f"a log of {count} readings" + f", lines left out before the first: {log.before}" * bool(log.before)
    return replace(table, notes=(note, *table.notes), dropped=table.dropped + log.lost)
