"""describe: what a file holds, in one value. It answers for every file that exists and is not damaged.

Symptoms: what a recording that reads well may still have wrong, in plain sentences. Nothing here raises or repairs.

Looked for: a specific force that is not 1 g (unit or scale), a temperature that is not a room's, a gyroscope that turns while
nothing moves, rows left out, gaps, uneven sampling, drop-outs, axes that never change, and readings stuck at their largest.
"""

import json
import re
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError
from undrift.files import read_bytes
from undrift.io.arrays import Arrays, mat_arrays, npz_arrays
from undrift.io.columns import ColumnMap, TextLayout, is_native
from undrift.io.formats import NOT_RECORDS, Format, ReadSettings, detect, read_built
from undrift.io.mocap import Up, read_broad
from undrift.io.record import Built, native_columns
from undrift.io.reference import native_reference, read_markers, read_reference
from undrift.io.session import read_column_map, read_session
from undrift.io.store import parquet_names
from undrift.io.table import MARK, Text, open_text
from undrift.record import Record, Reference
from undrift.units import SI_UNIT, STANDARD_GRAVITY, is_physical, si_factor

# ---- Symptoms: what a recording that reads well may still have wrong, in plain sentences. Nothing here raises or repairs.

GRAVITY_RANGE = (0.8, 1.25)  # g: a worn sensor's median lies inside
ROOM_C = (-10.0, 45.0)
JUMP_C = 5.0  # between two samples
REST_TURN_RATE = 0.35  # rad/s, 20 deg/s: no gyroscope's offset
UNEVEN = 0.1  # of the median step, between quartiles
STUCK = 8  # samples in a row at the largest reading
_AXES = "xyz"


def find_symptoms(record: Record, *, dropped_rows: int = 0, repaired_rows: int = 0) -> tuple[str, ...]:
    """Return what looks wrong with a recording."""
    found: list[str] = []
    if dropped_rows:
        found.append(f"{dropped_rows} rows did not parse and were left out")
    if repaired_rows:
        found.append(f"{repaired_rows} rows whose time did not go forward were left out")
    found += _gravity(record)
    found += _rest(record)
    found += _temperature(record)
    found += _sampling(record.time)
    for name, values in (("gyro", record.gyro), ("accel", record.accel)):
        if values is not None:
            found += _axes(name, values)
    return tuple(found)


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


def _gravity(record: Record) -> list[str]:
    median = median_accel_g(record)
    if np.isnan(median) or GRAVITY_RANGE[0] <= median <= GRAVITY_RANGE[1]:
        return []
    times = f"{1 / median:.3g} times too small" if 0.0 < median < 1.0 else f"{median:.3g} times too large"
    return [f"median |accel| is {median:.3g} g where a body at rest reads 1 g: wrong unit or scale ({times})"]


def _rest(record: Record) -> list[str]:
    """Look at the quietest two seconds: a gyroscope reads its offset there."""
    if record.gyro is None or not is_physical(record.gyro_unit):
        return []
    rate = record.gyro * si_factor(record.gyro_unit, "rate")
    size = max(8, int(2.0 * record.sample_rate_hz))
    count = len(rate) // size
    if count < 3:
        return []
    blocks = rate[: count * size].reshape(count, size, 3)
    spread = blocks.std(axis=1).sum(axis=1)
    if not np.isfinite(spread).any():
        return []
    best = int(np.nanargmin(spread))
    mean = float(np.linalg.norm(blocks[best].mean(axis=0)))
    if mean < REST_TURN_RATE or spread[best] > 0.1 * mean:
        return []
    return [
        f"gyro reads {np.degrees(mean):.3g} deg/s in its quietest two seconds (at {record.time[best * size]:.6g} s): "
        "a steady turn, or a wrong unit or scale"
    ]


def _temperature(record: Record) -> list[str]:
    if record.temp_c is None:
        return []
    temp = record.temp_c[np.isfinite(record.temp_c)]
    if not len(temp):
        return ["the temperature column is empty"]
    found: list[str] = []
    low, high = float(temp.min()), float(temp.max())
    if low > ROOM_C[1] or high < ROOM_C[0]:
        found.append(
            f"temperature {low:.1f} to {high:.1f} degC is not room temperature: processor, chamber, or wrong scale"
        )
    jumps = np.flatnonzero(np.abs(np.diff(temp)) > JUMP_C)
    if len(jumps):
        found.append(
            f"temperature jumps by over {JUMP_C:g} K between samples {len(jumps)} times, first after sample {jumps[0]}"
        )
    return found


def _sampling(time: FloatArray) -> list[str]:
    steps = np.diff(time)
    middle = float(np.median(steps))
    found: list[str] = []
    low, high = np.quantile(steps, (0.25, 0.75))
    if high - low > UNEVEN * middle:
        found.append(f"sampling is uneven: half of the steps lie outside {1e3 * low:.4g} to {1e3 * high:.4g} ms")
    lost = steps > 1.5 * middle
    if lost.any():
        found.append(
            f"{int(lost.sum())} drop-outs, the longest {steps.max():.4g} s at {time[int(steps.argmax())]:.6g} s "
            f"(median step {1e3 * middle:.4g} ms, mean rate {(len(time) - 1) / (time[-1] - time[0]):.4g} Hz)"
        )
    return found


def _axes(name: str, values: FloatArray) -> list[str]:
    found: list[str] = []
    for k, axis in enumerate(_AXES):
        column = values[:, k][np.isfinite(values[:, k])]
        if len(column) < 2 * STUCK:
            continue
        if column.min() == column.max():
            found.append(f"{name} {axis} never changes: a dead or unmapped axis")
            continue
        for limit in (column.max(), column.min()):
            run = _longest_run(column == limit)
            spread = float(np.median(np.abs(column - np.median(column))))
            if run >= STUCK and abs(limit - np.median(column)) > 10.0 * spread > 0.0:
                found.append(f"{name} {axis} stays at {limit:.6g} for {run} samples in a row: saturated")
    return found


def _longest_run(hit: BoolArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], hit.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if len(edges) else 0


# ---- Guesses for people, never for readers: what a foreign table might be, and an example of the map that it needs.

_FORCE = re.compile(r"GRF|COP|FREEMOMENT|^[FM][xyz]\[")
_PLACE = re.compile(r"^(COG|.*[._](ankle|knee|hip))[._ ][xyz]$", re.IGNORECASE)
_QUATERNION = re.compile(r"^(q_?)?[wxyz]( element)?$", re.IGNORECASE)
_UNITS = {  # what a name may say of its unit; "?" where it says nothing, which a reader refuses
    "time": (("us", r"\(?\bus\b|_us\b"), ("ms", r"\bms\b|_ms\b"), ("s", r"\bs\b|_s\b|sec")),
    "gyro": (("rad/s", r"rad[_/ ]?s"), ("dps", r"dps|deg[_/ ]?s"), ("count", r"raw|count|lsb")),
    "accel": (("m/s2", r"m[_/]?s\^?2"), ("mg", r"\bmg\b|_mg\b"), ("g", r"\(g\)|_g\b"), ("count", r"raw|count|lsb")),
    "temp": (("degC", r"deg ?c|celsius|degrees c"), ("count", r"raw|count|lsb")),
}
_RESULTS: tuple[tuple[str, set[str]], ...] = (  # what undrift writes as plain JSON, and keys that tell it
    ("results of undrift validate", {"trials", "agreement", "offset", "leave_one_out"}),
    ("results of undrift study", {"objective", "tasks", "cohorts", "rivals"}),
    ("results of undrift demo", {"calibration", "study", "checks"}),
)
_LIKELY = {
    "gyro": re.compile(r"^(g|gyr|gyro|gyroscope|w|omega|rot)[ _.]?([xyz])\b", re.IGNORECASE),
    "accel": re.compile(r"^(a|acc|accel|accelerometer)[ _.]?([xyz])\b", re.IGNORECASE),
}


def sniff(path: object) -> Text:
    """Open a text table with the delimiter, header and skipped lines that most of it suggests."""
    head = read_bytes(str(path), 1 << 16)
    lines = [line for line in head.decode("utf-8", "replace").splitlines()[:64] if line.strip()]
    if head.startswith(MARK):  # undrift's own first line, which open_text passes over by itself
        lines = lines[1:] or lines
    body = lines[len(lines) // 2 :] or lines
    delimiter = max(",\t;", key=lambda mark: min(line.count(mark) for line in body[:-1] or body))
    if not any(delimiter in line for line in body):
        delimiter = " "
    width = max(len(_cells(line, delimiter)) for line in body)
    skip = next((k for k, line in enumerate(lines) if len(_cells(line, delimiter)) == width), 0)
    header = not all(_is_number(cell) for cell in _cells(lines[skip], delimiter))
    return open_text(str(path), TextLayout(delimiter=delimiter, skip_rows=skip, header=header))


def foreign_kind(text: Text) -> str | None:
    """Name a table that is no recording of an inertial sensor."""
    names = [name for name in text.names if name.strip()]
    if any(_FORCE.search(name) for name in names):
        return f"a force plate's table ({', '.join(names[:4])}, ...), not a recording of an inertial sensor"
    if any(_PLACE.search(name) for name in names):
        return f"a table of positions ({', '.join(names[:4])}, ...), not a recording of an inertial sensor"
    if sum(bool(_QUATERNION.match(name)) for name in names) >= 4:
        quaternion = ", ".join(f'"{name}"' for name in names if _QUATERNION.match(name))
        return f"a table of orientations; read it as a reference with quaternion=({quaternion})"
    row = _first_row(text)
    if sum(_is_number(cell) for cell in row) < 0.5 * len(row):
        return f"a table of text ({len(names)} columns: {', '.join(names[:4])}, ...), not a recording"
    triples = triples_of(text.names)
    if text.layout.header and not triples:
        return f"a table without three axes ({', '.join(names[:8])}), not a recording of an inertial sensor"
    if triples and all(re.search(r"a\.u\.|uT|gauss|\(G\)", name) for triple in triples for name in triple):
        return f"a magnetometer's table ({', '.join(names[:4])}), without gyroscope or accelerometer"
    return None


def result_of(held: object) -> str:
    """Name what undrift itself wrote as plain JSON, by keys that only it has."""
    if not isinstance(held, dict):
        return ""
    for what, keys in _RESULTS:
        if keys <= held.keys():
            return f"{what}, not a recording: {', '.join(list(held)[:8])}"
    return ""


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


def example_map(names: tuple[str, ...], *, text: Text | None = None, arrays: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return an example of the map that a table needs; a unit that no name tells is "?", for a person to fill in."""
    if text is not None and not text.layout.header:
        keys = _by_position(text)
    elif arrays:
        keys = {channel: f'"{name}"' for channel in _LIKELY if (name := _likely(channel, arrays))}
    else:
        keys = {}
        triples = triples_of(names)
        firsts = tuple(triple[0] for triple in triples)
        gyro = _likely("gyro", firsts)
        accel = _likely("accel", tuple(name for name in firsts if name != gyro)) or next(
            (name for name in firsts if name != gyro), None
        )
        for channel, first in (("gyro", gyro), ("accel", accel)):
            if first is not None:
                keys[channel] = "[" + ", ".join(f'"{name}"' for name in triples[firsts.index(first)]) + "]"
    time = next(
        (name for name in names if re.match(r"^(time|t|timestamp)([ _\[(].*)?$", name.strip(), re.IGNORECASE)), None
    )
    if time is not None:
        keys = {"time": f'"{time}"', **keys}
    temp = next((name for name in names if re.match(r"^(board |die )?temp", name.strip(), re.IGNORECASE)), None)
    if temp is not None:
        keys["temp"] = f'"{temp}"'
    keys = keys or {"gyro": '["gx", "gy", "gz"]', "accel": '["ax", "ay", "az"]'}
    columns = ", ".join(f"{channel} = {value}" for channel, value in keys.items())
    units = ", ".join(f'{channel} = "{_unit_of(channel, value)}"' for channel, value in keys.items())
    lines = [f"columns = {{ {columns} }}", f"units = {{ {units} }}"]
    lines += [] if "time" in keys else ["sample_rate_hz = ?"]
    return (*lines, *_layout_keys(None if text is None else text.layout))


def _unit_of(channel: str, names: str) -> str:
    return next((unit for unit, said in _UNITS[channel] if re.search(said, names, re.IGNORECASE)), "?")


def _by_position(text: Text) -> dict[str, str]:
    """Return positions for a table without names: a growing first column is time, another odd one temperature."""
    width = len(text.names)
    first = [
        _cells(line, text.layout.delimiter)[0]
        for line in text.head.decode("utf-8", "replace").splitlines()[text.skip :][:8]
    ]
    numbers = [float(cell) for cell in first if cell and _is_number(cell)]
    grows = all(b > a for a, b in pairwise(numbers)) and len(numbers) > 1
    keys = {"time": "0"} if grows else {"temp": "0"} if width % 3 == 1 else {}
    start = len(keys)
    for channel in ("accel", "gyro"):
        if start + 3 <= width:
            keys[channel] = f"[{start}, {start + 1}, {start + 2}]"
            start += 3
    return keys


def _likely(channel: str, names: tuple[str, ...]) -> str | None:
    stem = "gyr" if channel == "gyro" else "acc"
    return next((name for name in names if stem in name.lower() or _LIKELY[channel].match(name.strip())), None)


def _layout_keys(layout: TextLayout | None) -> list[str]:
    keys: list[str] = []
    if layout is None:
        return keys
    if layout.delimiter != ",":
        keys.append('delimiter = "\\t"' if layout.delimiter == "\t" else f'delimiter = "{layout.delimiter}"')
    if not layout.header:
        keys.append("header = false")
    if layout.skip_rows:
        keys.append(f"skip_rows = {layout.skip_rows}")
    return keys


def _first_row(text: Text) -> list[str]:
    lines = text.head.decode("utf-8", "replace").splitlines()
    return _cells(lines[text.skip], text.layout.delimiter) if text.skip < len(lines) else []


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else line.split(delimiter)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return not cell.strip()
    return True


# ---- inspect

_REGULAR = 0.005  # mean and usual rate that differ by less are one figure
_NEEDS = "needs a map with the true units, for example"


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """What a file holds."""

    path: str  # The file or folder
    # recording, reference, markers, session, calibration, device, table (needs a map), results, settings, text or
    # binary
    kind: str
    format: Format  # csv, parquet, npz, mat, broad, trc, c3d, apdm,
    summary: str  # One line: what it is, or what it needs to be read
    rows: int | None = None  # Samples or frames
    sample_rate_hz: float | None = None  # Samples over time, Hz: what is lost or uneven counts
    # Rate of the usual step, drop-outs left out, Hz; the same where every step is alike
    usual_rate_hz: float | None = None
    duration_s: float | None = None  # s
    columns: tuple[str, ...] = ()  # Channels, markers, or column names
    units: tuple[tuple[str, str], ...] = ()  # Channel and unit
    gaps: int = 0  # Samples with a gap
    temp_c: tuple[float, float] | None = None  # Lowest and highest temperature, degC
    problems: tuple[str, ...] = ()  # One sentence each
    # Lines of the map that a table of foreign names may need, "?" where a person must say what is true
    example: tuple[str, ...] = ()


def describe(
    path: str | Path, columns: ColumnMap | None = None, *, settings: ReadSettings | None = None, up: Up | None = None
) -> Description:
    """Say what a file holds."""
    path = Path(path)
    kind = detect(path)
    if kind in ("trc", "c3d"):
        return _markers(path, kind, up)
    if kind == "session":
        return _session(path)
    if kind in ("json", "toml"):
        return _settings(path, kind)
    if kind in ("text", "cwa", "nilspod", "binary", "hdf5") and columns is None:
        return _unread(path, kind)
    needs = None if columns is not None else _needs(path, kind, settings or ReadSettings())
    if isinstance(needs, Description):
        return needs
    built = read_built(path, columns, settings=settings)
    found = describe_record(built.record, path=str(path), kind=kind, built=built)
    if columns is None and kind in ("csv", "parquet"):
        names = sniff(path).names if kind == "csv" else parquet_names(path)
        unread = [name for name in names if name not in found.columns]
        if unread:
            problem = f"columns that are not undrift's own names were not read: {', '.join(unread[:12])}"
            found = replace(found, problems=(*found.problems, problem))
    return _with_optics(found, read_broad(path)[1]) if kind == "broad" else found


def describe_record(record: Record, *, path: str = "", kind: Format = "csv", built: Built | None = None) -> Description:
    """Say what a record holds."""
    dropped, repaired = (0, 0) if built is None else (built.dropped_rows, built.repaired_rows)
    mean, usual = mean_rate_hz(record), record.sample_rate_hz
    return Description(
        path=path,
        kind="recording",
        format=kind,
        summary=f"{len(record)} samples at {_told_rate(mean, usual)}, {record.duration_s:.6g} s"
        + (f", {record.device}" if record.device else ""),
        rows=len(record),
        sample_rate_hz=mean,
        usual_rate_hz=usual,
        duration_s=record.duration_s,
        columns=native_columns(record)[0],
        units=_units(record),
        gaps=gaps_of(record),
        temp_c=_temperatures(record),
        problems=find_symptoms(record, dropped_rows=dropped, repaired_rows=repaired),
    )


def mean_rate_hz(*records: Record) -> float:
    """Return samples over time, drop-outs and all."""
    return sum(len(record) - 1 for record in records) / sum(record.duration_s for record in records)


def _told_rate(mean: float, usual: float) -> str:
    if abs(mean / usual - 1.0) < _REGULAR:
        return f"{mean:.6g} Hz"
    return f"{mean:.4g} Hz on average (usual step {1e3 / usual:.4g} ms, {usual:.4g} Hz)"


def _temperatures(*records: Record) -> tuple[float, float] | None:
    """Return the lowest and the highest temperature, None where there is none."""
    seen = [t[np.isfinite(t)] for t in (record.temp_c for record in records) if t is not None]
    every = np.concatenate(seen) if seen else np.empty(0)
    return (float(every.min()), float(every.max())) if len(every) else None


def _units(record: Record) -> tuple[tuple[str, str], ...]:
    units = [("time", "s")]
    units += [] if record.gyro is None else [("gyro", record.gyro_unit)]
    units += [] if record.accel is None else [("accel", record.accel_unit)]
    units += [] if record.temp_c is None else [("temp", "degC")]
    units += [] if record.mag_ut is None else [("mag", "uT")]
    return tuple(units)


def _with_optics(found: Description, reference: Reference) -> Description:
    seen = 100.0 * float(reference.valid.mean())
    return replace(found, summary=f"{found.summary}, with optical poses ({seen:.1f} % seen, rest and motion together)")


def _needs(path: Path, kind: Format, settings: ReadSettings) -> Description | None:
    """Return the description of a file that cannot be read without more words, None where it can."""
    if kind == "ximu" and settings.sample_rate_hz is None:
        return _table(
            path, kind, (), "an x-IMU recording; needs its sample rate: give sample_rate_hz (256 as delivered)"
        )
    if kind == "apdm" and settings.sensor is None:
        from undrift.io.wearables import apdm_sensors

        held = apdm_sensors(path)
        if len(held) > 1:
            return _table(path, kind, held, f"APDM sensors {', '.join(held)}; needs the name of one of them as sensor")
    if kind in ("npz", "mat"):
        arrays = npz_arrays(path) if kind == "npz" else mat_arrays(path)
        return _of_names(path, kind, tuple(name for name, _ in arrays), arrays)
    if kind == "parquet":
        return _of_names(path, kind, parquet_names(path), ())
    return _text_table(path) if kind == "csv" else None


def _of_names(path: Path, kind: Format, names: tuple[str, ...], arrays: Arrays) -> Description | None:
    if native_reference(names) is not None:
        return _reference(path, kind)
    if is_native(names):
        return None
    shown = tuple(f"{name} {array.shape}" for name, array in arrays) or names
    threes = tuple(name for name, array in arrays if array.ndim == 2 and array.shape[1] == 3)
    example = example_map(names, arrays=threes)
    return _mapless(path, kind, shown, f"{len(names)} arrays or columns", example)


def _text_table(path: Path) -> Description | None:
    text = sniff(path)
    if native_reference(text.names) is not None:
        return _reference(path, "csv")
    if is_native(text.names):
        return None
    what = foreign_kind(text)
    if what is not None:
        return _table(path, "csv", text.names, what)
    named = f"{len(text.names)} columns" + ("" if text.layout.header else " without names")
    return _mapless(path, "csv", text.names, f"a table of {named}", example_map(text.names, text=text))


def _mapless(path: Path, kind: Format, names: tuple[str, ...], what: str, example: tuple[str, ...]) -> Description:
    return replace(_table(path, kind, names, f"{what}; {_NEEDS} {', '.join(example)}"), example=example)


def _table(path: Path, kind: Format, names: tuple[str, ...], summary: str) -> Description:
    return Description(path=str(path), kind="table", format=kind, summary=summary, columns=names, problems=(summary,))


def _reference(path: Path, kind: Format) -> Description:
    reference = read_reference(path)
    seen = int(reference.valid.sum())
    return Description(
        path=str(path),
        kind="reference",
        format=kind,
        summary=f"{len(reference)} poses at {reference.sample_rate_hz:.6g} Hz, {seen} seen",
        rows=len(reference),
        sample_rate_hz=reference.sample_rate_hz,
        duration_s=float(reference.time[-1] - reference.time[0]),
        gaps=len(reference) - seen,
    )


def _markers(path: Path, kind: Format, up: Up | None) -> Description:
    problems: tuple[str, ...] = ()
    try:
        markers = read_markers(path, up=up)
    except InputError as error:
        if up is not None or "points up" not in str(error):
            raise
        markers = read_markers(path, up="z")
        problems = ('the file does not say which axis points up: state up = "y" or "z" to read it',)
    gap: BoolArray = np.any(np.isnan(markers.points), axis=2)
    never = [label for k, label in enumerate(markers.labels) if gap[:, k].all()]
    if never:
        problems = (*problems, f"never seen: {', '.join(never)}")
    return Description(
        path=str(path),
        kind="markers",
        format=kind,
        summary=f"{len(markers.labels)} markers, {len(markers)} frames at {markers.sample_rate_hz:.6g} Hz",
        rows=len(markers),
        sample_rate_hz=markers.sample_rate_hz,
        duration_s=float(markers.time[-1] - markers.time[0]),
        columns=markers.labels,
        units=(("position", SI_UNIT["length"]),),
        gaps=int(gap.any(axis=1).sum()),
        problems=problems,
    )


def _session(path: Path) -> Description:
    session = read_session(path)
    problems = tuple(
        f"recording {number}: {problem}"
        for number, record in enumerate(session.records)
        for problem in find_symptoms(record)
    )
    return Description(
        path=str(path),
        kind="session",
        format="session",
        summary=f"{session.kind} of {session.serial}: {_count(session.records, 'recording')}, "
        f"{_count(session.stills, 'still')}, {_count(session.turns, 'turn')}",
        rows=sum(len(record) for record in session.records),
        sample_rate_hz=mean_rate_hz(*session.records),
        usual_rate_hz=session.records[0].sample_rate_hz,
        duration_s=sum(record.duration_s for record in session.records),
        columns=native_columns(session.records[0])[0],
        units=_units(session.records[0]),
        gaps=sum(gaps_of(record) for record in session.records),
        temp_c=_temperatures(*session.records),
        problems=problems,
    )


def _settings(path: Path, kind: Format) -> Description:
    if kind == "toml":
        if path.name == "session.toml":
            return _session(path)
        try:
            columns = read_column_map(path)
        except InputError:
            return Description(path=str(path), kind="settings", format=kind, summary="TOML settings, not a column map")
        mapped = ", ".join(columns.mapped())
        return Description(path=str(path), kind="settings", format=kind, summary=f"a column map of {mapped}")
    try:
        held = json.loads(read_bytes(path))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: wanted JSON, got something else: {error}; repair the file") from error
    if isinstance(held, dict) and held.get("kind") == "undrift.calibration":
        return Description(
            path=str(path),
            kind="calibration",
            format=kind,
            summary=f"calibration of {held.get('device') or 'a device without a serial number'}, format {held.get('format')}",
        )
    if isinstance(held, dict) and held.get("kind") == "undrift.device":
        named = " ".join(str(held[key]) for key in ("name", "serial") if held.get(key)) or "without a name"
        return Description(
            path=str(path), kind="device", format=kind, summary=f"device model {named}, format {held.get('format')}"
        )
    result = result_of(held)
    if result:
        return Description(path=str(path), kind="results", format=kind, summary=result)
    names = (
        ", ".join(list(held)[:8])
        if isinstance(held, dict)
        else f"a list of {len(held)}"
        if isinstance(held, list)
        else "a value"
    )
    return Description(path=str(path), kind="settings", format=kind, summary=f"JSON, not a recording: {names}")


def _count(items: tuple[object, ...], what: str) -> str:
    return f"{len(items)} {what}{'s' * (len(items) != 1)}"


def _unread(path: Path, kind: Format) -> Description:
    what = "text" if kind == "text" else "binary"
    line = ""
    if kind == "text":
        first = next(
            (line for line in read_bytes(path, 4096).decode("utf-8", "replace").splitlines() if line.strip()), ""
        )
        line = f": {first.strip()[:60]}"
    return Description(path=str(path), kind=what, format=kind, summary=NOT_RECORDS[kind] + line)
