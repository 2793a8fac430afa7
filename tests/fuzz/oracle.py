"""What a damaged file is read as, judged beside the sound one: the bytes decide what may differ, never the readers' own logic.

    equal         the readings are those of the sound file
    refused       one clear line, or a description without readings
    finding       other readings, and a new finding that names damage
    own value     only rows whose bytes were touched differ, each as its own cells say, or nothing in the file tells
    header value  a header states something else for all rows, and nothing in the file contradicts it
    SILENT        rows lost, doubled or shifted, columns or units exchanged, or more rows changed than touched, without a word

Text is aligned line by line. Which cells of a line became which value of a row is found in the sound file alone, as the straight
line between a column of cells and a column of readings. In binary files, a changed byte may change the rows of a block.
"""

import difflib
import gzip
import re
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from undrift.errors import UndriftError
from undrift.io.column_map import ColumnMap, read_map
from undrift.io.formats import read_markers, read_reference
from undrift.io.inspect import Description, describe

KINDS = ("equal", "refused", "finding", "own value", "header value", "SILENT")
RATE_HZ = 100.0  # of sound files that state none
SENSOR = {
    "apdm_format7.csv": "Lumbar", "imuData01.csv": "Upper", "opensim_apdm_imuData01.csv.gz": "Upper",
    "discover164_basic_first12rows.csv": "EMG 01 04498 (54717)", "truncated_trigno_sample.csv": "Mini sensor 10",
    "data_lab_HA001.mat": "TimeMeasure1.Test5.Trial1.LowerBack", "read_test_data.csv": "LN", "sample_log_small.ulg": "0",
    "data_lab_missing_sensor_HA001.mat": "TimeMeasure1.Test5.Trial1.LowerBack",
}  # fmt: skip
UNSTATED = {"gyro": "dps", "accel": "g", "temp": "degC", "time": "s"}
COUNTS = (
    "count",
    "longest_s",
    "missing",
    "gaps",
    "first_sample",
)  # values of findings that tell one damage from another
NAMES_DAMAGE = re.compile(r"\b(lost|missing|left out|not read|damaged|cut|jumps?)\b")
NUMBER = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
SLOW = 700  # rows of a block, onto which one reading of a slow thermometer is interpolated
REGULAR = 0.05  # of the median: steps of a time column that a missing row breaks


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    kind: str  # recording, markers, reference
    names: tuple[str, ...]  # of the columns
    values: np.ndarray  # (N, K), time first
    units: tuple[tuple[str, str], ...]
    about: tuple[str, ...]  # device and notes
    found: frozenset[str]  # findings that may name damage


def read(path: Path, how: ColumnMap) -> Reading | str:
    """Return what is read of a file, or why nothing is."""
    try:
        held = describe(path, how, up="z")
        if held.kind == "recording" and held.session is not None:
            return _of_recording(held)
        if held.kind == "markers":
            markers = read_markers(path, up="z")
            points = markers.points.reshape(len(markers), -1)
            return _of_rows(held, markers.labels, markers.time, points)
        if held.kind == "reference":
            poses = read_reference(path, labels=held.columns[:1] or None)
            place = np.empty((len(poses), 0)) if poses.position is None else poses.position
            return _of_rows(held, held.columns, poses.time, np.hstack((poses.q_nb, place)))
    except UndriftError as error:
        return str(error)
    return held.summary


def _of_rows(held: Description, names: tuple[str, ...], time: np.ndarray, values: np.ndarray) -> Reading:
    lost = re.search(r" seen(.*)", held.summary)  # packets, of poses
    told = {lost[1]} if lost and NAMES_DAMAGE.search(lost[1]) else set[str]()
    return Reading(
        kind=held.kind, names=names, values=np.column_stack((time, values)), units=held.units, about=(),
        found=_findings(held) | told,
    )  # fmt: skip


def _of_recording(held: Description) -> Reading:
    record = held.session.records[0]  # type: ignore[union-attr]
    temp = None if record.temp_c is None else record.temp_c[:, None]
    parts = [
        part for part in (record.time[:, None], record.gyro, record.accel, record.mag_ut, temp) if part is not None
    ]
    notes = (item.sentence for item in held.findings if item.code == "recording.how_read")
    return Reading(
        kind=held.kind, names=held.columns, values=np.hstack(parts), units=held.units,
        about=(record.device, record.frame, record.state, *notes), found=_findings(held),
    )  # fmt: skip


def _findings(held: Description) -> frozenset[str]:
    """Return the findings that may name damage, each with the counts that tell it from another of its kind."""
    out = set()
    for item in held.findings:
        if item.code != "recording.how_read":
            counts = {key: f"{item.values[key]:.6g}" for key in COUNTS if key in item.values}
            axis = [str(item.values[key]) for key in ("channel", "axis") if key in item.values]
            out.add(f"{item.code} {axis} {counts}")
        elif NAMES_DAMAGE.search(item.text):
            out.add(item.text)
    return frozenset(out)


def how_read(content: bytes, name: str) -> ColumnMap:
    """Return the arguments by which a sound file is a recording: a sensor, a rate, the map that `info` proposes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        how = ColumnMap(sensor=SENSOR.get(name))
        for _ in range(2):
            try:
                held = describe(path, how)
            except UndriftError:
                break
            if held.example:
                lines = [
                    re.sub(r'(\w+) = "\?"', lambda m: f'{m[1]} = "{UNSTATED[m[1]]}"', line) for line in held.example
                ]
                lines = [line.replace("sample_rate_hz = ?", f"sample_rate_hz = {RATE_HZ}") for line in lines]
                (Path(folder) / "map.toml").write_text("\n".join(lines))
                with suppress(UndriftError):  # a table of orientations, or without readings
                    how = read_map(Path(folder) / "map.toml", sensor=SENSOR.get(name))
            elif any(item.values.get("missing") == "sample_rate_hz" for item in held.findings):
                how = ColumnMap(sensor=SENSOR.get(name), sample_rate_hz=RATE_HZ)
        return how


# ---- the sound file: which bytes are which row


def unpacked(content: bytes) -> bytes | None:
    """Return what a packed file holds, or the content; None where it cannot be unpacked."""
    if content[:2] != b"\x1f\x8b":
        return content
    try:
        return gzip.decompress(content)
    except (OSError, EOFError, ValueError):
        return None
    except Exception:  # noqa: BLE001 - zlib.error
        return None


def lines_of(content: bytes) -> list[bytes]:
    return [line.rstrip(b"\r") for line in content.split(b"\n") if line.strip()]


@dataclass(frozen=True)
class Sound:
    """A sound file and what is read of it."""

    content: bytes
    reading: Reading
    timed: bool = True  # False where the map takes no column as time

    @cached_property
    def plain(self) -> bytes:
        """Its bytes, unpacked."""
        return unpacked(self.content) or b""

    @cached_property
    def is_text(self) -> bool:
        """Tell a table of text, a line for each row."""
        return b"\0" not in self.plain and not self.plain.startswith(b"Device Identity")

    @cached_property
    def lines(self) -> list[bytes]:
        """Its lines, blank ones left out."""
        return lines_of(self.plain)

    @cached_property
    def delimiter(self) -> bytes:
        """What stands between cells."""
        body = self.lines[-min(64, len(self.reading.values)) :]
        return next(
            (mark for mark in (b";", b"\t", b",") if sum(mark in line for line in body) > 0.8 * len(body)), b" "
        )

    def is_unit(self, cells: list[bytes], columns: dict[int, tuple[int, float, float]]) -> bool:
        """Tell whether cells hold a quaternion of nearly length 1."""
        four = [number(cells[columns[k][0]]) for k in range(1, 5) if k in columns]
        return len(four) < 4 or abs(float(np.linalg.norm(four)) - 1.0) < 0.02

    def cells(self, line: bytes) -> list[bytes]:
        """Return the cells of a line as numbers are written."""
        line = re.sub(rb"^[ \t]*[A-Za-z_]\w*:", b"", line)
        if self.delimiter == b" ":
            return line.split()
        if b"endheader" in self.plain and self.delimiter == b"\t":  # w,x,y,z in one cell
            line = line.replace(b",", b"\t")
        parts = [part.strip(b' "\r\t') for part in line.split(self.delimiter)]
        return parts if self.delimiter == b"," else [re.sub(rb"^([-+]?\d+),(\d+)", rb"\1.\2", part) for part in parts]

    @cached_property
    def width(self) -> int:
        """Cells of most lines."""
        counts = [len(self.cells(line)) for line in self.lines[-min(64, len(self.reading.values)) :]]
        return max(set(counts), key=counts.count)

    @cached_property
    def place(self) -> tuple[int, dict[int, tuple[int, float, float]]]:
        """The line of the first row; for columns of readings their cell, gain and offset."""
        table = np.full((len(self.lines), self.width), np.nan)
        for k, line in enumerate(self.lines):
            cells = self.cells(line)
            if len(cells) == self.width:
                table[k] = [number(cell) for cell in cells]
        rows = len(self.reading.values)
        spare, best = len(self.lines) - rows, (len(self.lines) - rows, dict[int, tuple[int, float, float]]())
        for first in (spare, *range(max(0, spare - 1), max(-1, spare - 60), -1)):
            if first < 0:
                continue
            found = _straight(table[first : first + rows], self.reading.values)
            if len(found) > len(best[1]):
                best = (first, found)
            if len(found) > 0.6 * self.reading.values.shape[1]:
                break
        if not self.timed:
            best[1].pop(0, None)
        return best


def number(cell: bytes) -> float:
    """Return a cell as a number, NaN where it is none."""
    return float(cell) if NUMBER.fullmatch(cell) else np.nan


def _straight(cells: np.ndarray, values: np.ndarray) -> dict[int, tuple[int, float, float]]:
    """Return for columns of readings which column of cells is the same up to gain and offset."""
    found = {}
    usable = [k for k in range(cells.shape[1]) if np.isfinite(cells[:, k]).sum() > 2 and np.nanstd(cells[:, k]) > 0.0]
    for k in range(values.shape[1]):
        for j in sorted(usable, key=lambda j: abs(j - k)):
            both = np.isfinite(cells[:, j]) & np.isfinite(values[:, k])
            if both.sum() < 3 or both.sum() < 0.9 * np.isfinite(values[:, k]).sum():
                continue
            x, y = cells[both, j], values[both, k]
            if x.std() == 0.0 or y.std() == 0.0 or abs(abs(np.corrcoef(x, y)[0, 1]) - 1.0) > 1e-6:
                continue
            gain = float(((x - x.mean()) * (y - y.mean())).sum() / ((x - x.mean()) ** 2).sum())
            offset = float(y.mean() - gain * x.mean())
            if np.abs(gain * x + offset - y).max() <= 1e-6 * np.abs(y).max() + 1e-9:
                found[k] = (j, gain, offset)
                break
    return found


# ---- the verdict


def judge(sound: Sound, content: bytes, held: Reading | str) -> tuple[str, str]:
    """Return the kind of outcome, and what differs."""
    if isinstance(held, str):
        return "refused", held
    was = sound.reading
    if held.kind != was.kind:
        return "refused", f"read as {held.kind}"
    named = held.found - was.found
    same = _same(held.values, was.values) and held.names == was.names and held.units == was.units
    if same:
        return ("equal", "") if held.about == was.about else ("header value", _changed_words(was, held))
    if named:
        return "finding", "; ".join(sorted(named))
    plain = unpacked(content)
    if plain is None:
        return "SILENT", "a packed file that does not unpack was read"
    return _of_text(sound, plain, held) if sound.is_text else _of_binary(sound, plain, held)


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and bool(np.array_equal(one, other, equal_nan=True))


def _changed_words(was: Reading, held: Reading) -> str:
    pairs = [(a, b) for a, b in zip(was.about, held.about, strict=False) if a != b] or [(was.about, held.about)]
    return str(pairs[0])[:160]


def matched(sound: list[bytes], damaged: list[bytes]) -> Iterator[tuple[str, int, int, int, int]]:
    """Yield what became of the lines, as difflib names it."""
    head = next(
        (k for k, (a, b) in enumerate(zip(sound, damaged, strict=False)) if a != b), min(len(sound), len(damaged))
    )
    most = min(len(sound), len(damaged)) - head
    tail = next((k for k in range(most) if sound[-1 - k] != damaged[-1 - k]), most)
    middle = difflib.SequenceMatcher(
        None, sound[head : len(sound) - tail], damaged[head : len(damaged) - tail], autojunk=False
    )
    yield ("equal", 0, head, 0, head)
    yield from ((tag, a + head, b + head, c + head, d + head) for tag, a, b, c, d in middle.get_opcodes())
    yield ("equal", len(sound) - tail, len(sound), len(damaged) - tail, len(damaged))


def _of_text(sound: Sound, plain: bytes, held: Reading) -> tuple[str, str]:
    first, columns = sound.place
    lines, was, rows = lines_of(plain), sound.reading, len(sound.reading.values)
    origin: dict[int, int] = {}  # line of the damaged text: the same line of the sound one
    touched, start = False, None
    for tag, a, b, c, d in matched(sound.lines, lines):
        if tag == "equal":
            origin |= dict(zip(range(c, d), range(a, b), strict=True))
        elif a < first or b < first:
            touched = True
        if start is None and b >= first:
            start = c + first - a if tag == "equal" else min(c + max(first - a, 0), d)
    start = len(lines) if start is None else start
    while start < len(lines) and lines[start] in sound.lines[:first]:  # of a header that was doubled
        start += 1
    expected = list(range(start, len(lines)))[: max(0, len(lines) - start - (len(sound.lines) - first - rows))]
    if held.names != was.names or held.units != was.units:
        if not touched:
            return "SILENT", f"columns or units changed: {was.units} to {held.units}, {held.names}"
        moved = _moved(was, held) if was.kind == "recording" else _moved_labels(was, held)
        return (
            ("SILENT", f"columns exchanged: {moved}") if moved else ("header value", f"{held.units} {held.names}"[:200])
        )
    if len(held.values) != len(expected):
        return "SILENT", f"{len(expected)} lines of readings, {len(held.values)} rows"
    problem = _rows_differ(sound, held, [(lines[k], origin.get(k)) for k in expected], columns, first)
    if problem and touched and (scaled := _scaled(was, held)):
        return "header value", f"all rows: {scaled}"
    if problem:
        return "SILENT", problem
    kept = [origin[k] for k in expected if k in origin]
    left_out = rows - len(expected)
    time = held.values[:, 0]
    if 0 in columns and len(time) > 3 and kept and _irregular(was.values[:, 0], time):
        return "SILENT", "a step of time that is not one of the sound file, without a finding"
    return "own value", f"{len(expected) - len(kept)} rows" + f", {left_out} fewer" * bool(left_out)


def _irregular(was: np.ndarray, time: np.ndarray) -> bool:
    steps = np.diff(was)
    usual = np.median(steps)
    return bool(np.abs(steps / usual - 1.0).max() < REGULAR and (np.diff(time) > 1.6 * usual).any())


def _moved(was: Reading, held: Reading) -> str:
    """Return a column that holds what another held."""
    if len(was.values) != len(held.values):
        return ""
    for k in range(1, held.values.shape[1]):
        same = [j for j in range(1, was.values.shape[1]) if _same(was.values[:, j], held.values[:, k])]
        if same and k < len(held.names) and k < len(was.names) and same[0] < len(was.names):
            one, other = was.names[same[0]], held.names[k]
            if one.split("_")[:2] != other.split("_")[:2]:
                return f"{one} read as {other}"
    return ""


def _moved_labels(was: Reading, held: Reading) -> str:
    """Return a label that is at the place of another."""
    pairs = zip(was.names, held.names, strict=False)
    return next((f"{one} read as {other}" for one, other in pairs if one != other and other in was.names), "")


def _scaled(was: Reading, held: Reading) -> str:
    """Return by what all rows differ where it is one gain and offset for each column."""
    if was.values.shape != held.values.shape:
        return ""
    straight = []
    for k in range(was.values.shape[1]):
        x, y = was.values[:, k], held.values[:, k]
        if np.array_equal(x, y, equal_nan=True):
            continue
        both = np.isfinite(x) & np.isfinite(y)
        if both.sum() < 3 or x[both].std() == 0.0:
            continue
        gain, offset = np.polyfit(x[both], y[both], 1)
        if np.median(np.abs(gain * x[both] + offset - y[both])) > 1e-6 * np.abs(y[both]).max() + 1e-9:
            return ""
        straight.append(f"column {k}: {gain:.4g} x + {offset:.4g}")
    return ", ".join(straight[:2])


def _rows_differ(
    sound: Sound,
    held: Reading,
    lines: list[tuple[bytes, int | None]],
    columns: dict[int, tuple[int, float, float]],
    first: int,
) -> str:
    """Return the first row that is not what its own line says."""
    was = sound.reading
    kept = [(k, at - first) for k, (_, at) in enumerate(lines) if at is not None and 0 <= at - first < len(was.values)]
    mine, theirs = held.values[[k for k, _ in kept]], was.values[[k for _, k in kept]]
    shift = np.zeros(was.values.shape[1])
    if len(kept) and kept[0] != (0, 0):
        shift[0] = (
            np.nanmedian(mine[:, 0] - theirs[:, 0]) if 0 in columns or len(held.values) == len(was.values) else np.nan
        )
    away = np.abs(mine - shift - theirs) > 1e-6 * np.abs(theirs) + 1e-9
    away |= np.isnan(mine) != np.isnan(theirs)
    if 0 not in columns:
        away[:, 0] = False  # time by the number of the row, or of dates
    if away.any():
        row, column = np.argwhere(away)[0]
        return f"row {kept[row][0]}, untouched: {theirs[row, column]:.6g} became {mine[row, column]:.6g} in column {column}"
    for k, (line, at) in enumerate(lines):
        if at is not None:
            continue
        cells = sound.cells(line)
        if len(cells) == sound.width - 1 and not sound.cells(sound.lines[-1])[-1]:
            cells = [*cells, b""]  # cut before the delimiter that ends a line
        if len(cells) != sound.width:
            return f"row {k}: {len(cells)} cells of {sound.width} were read: {line[:60]!r}"
        for column, (j, gain, offset) in columns.items():
            value, cell = held.values[k, column], cells[j]
            if (
                np.isnan(value)
                and was.kind != "recording"
                and _is_gap(was.kind, held.values[k], column, cells, columns)
            ):
                continue
            if was.kind == "reference" and column > 0 and abs(value) <= 1.0 and sound.is_unit(cells, columns):
                continue  # made unit by its reader
            wanted = gain * number(cell) + offset + (shift[0] if column == 0 and np.isfinite(shift[0]) else 0.0)
            if np.isnan(wanted) != np.isnan(value) or abs(wanted - value) > 1e-5 * abs(value) + 1e-6:
                return f"row {k}: {cell[:30]!r} was read as {value:.9g} in column {column}, not {wanted:.9g}"
    return ""


def _is_gap(
    kind: str, row: np.ndarray, column: int, cells: list[bytes], columns: dict[int, tuple[int, float, float]]
) -> bool:
    """Tell a pose without a quaternion, and a marker without all three coordinates, or at 0, 0, 0."""
    if kind == "reference":
        return bool(np.isnan(row[1:5]).all())
    three = [3 * ((column - 1) // 3) + k for k in (1, 2, 3)]
    held = [number(cells[columns[k][0]]) for k in three if k in columns]
    return bool(np.isnan(row[three]).all()) and (len(held) < 3 or not np.isfinite(held).all() or not any(held))


def _of_binary(sound: Sound, plain: bytes, held: Reading) -> tuple[str, str]:
    was, size = sound.reading, len(sound.plain)
    if held.names != was.names or held.units != was.units or held.values.shape != was.values.shape:
        if held.units == was.units and _is_part(was.values, held.values):
            return "own value", f"{len(was.values) - len(held.values)} rows fewer at an end"
        kind = "SILENT" if len(held.values) != len(was.values) else "header value"
        return kind, f"{was.values.shape} to {held.values.shape}, {held.units} {held.names}"[:200]
    away = (np.abs(held.values - was.values) > 0.0) | (np.isnan(held.values) != np.isnan(was.values))
    changed, ranges = int(away.any(axis=1).sum()), _changed_ranges(sound.plain, plain)
    if changed <= sum(SLOW + len(was.values) * (stop - start) / size for start, stop in ranges):
        return "own value", f"{changed} rows"
    if scaled := _scaled(was, held):
        return "header value", f"all rows: {scaled}"
    return "SILENT", f"{changed} rows changed, first {int(away.any(axis=1).argmax())}; bytes {ranges[:3]}"


def _is_part(was: np.ndarray, held: np.ndarray) -> bool:
    """Tell readings that are the first or the last of the sound ones: blocks are missing at an end, where nothing counts them."""
    count = len(held)
    if count >= len(was) or held.shape[1] != was.shape[1]:
        return False
    parts = (was[:count], was[-count:])
    return any(
        _same(part[:, 1:4], held[:, 1:4]) and np.allclose(np.diff(part[:-1, 0]), np.diff(held[:-1, 0]), atol=1e-3)
        for part in parts
    )


def _changed_ranges(sound: bytes, damaged: bytes) -> list[tuple[int, int]]:
    """Return the ranges of the sound bytes that differ; from the first to the last of them where the length is another."""
    one, other = np.frombuffer(sound, np.uint8), np.frombuffer(damaged, np.uint8)
    if len(sound) == len(damaged):
        return [(int(k), int(k) + 1) for k in np.flatnonzero(one != other)]
    least = min(len(sound), len(damaged))
    head = next(iter(np.flatnonzero(one[:least] != other[:least])), least)
    tail = next(iter(np.flatnonzero(one[::-1][: least - head] != other[::-1][: least - head])), least - head)
    return [(int(head), max(int(head) + 1, len(sound) - int(tail)))]
