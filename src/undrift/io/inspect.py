"""describe: the content of a file as a single value. It works for every file that exists and is not damaged.

A recording that reads well may still have a wrong unit, gaps, drop-outs, dead axes or readings stuck at their largest:
``find_symptoms`` looks for them. They are reported, not raised and not repaired.
"""

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs
from undrift.errors import InputError
from undrift.files import read_bytes, read_tree
from undrift.findings import Finding, finding
from undrift.io.clock import host_stamps
from undrift.io.column_map import AXES, READ_SETTINGS, ColumnMap, is_native, read_map
from undrift.io.columns import RawTable, ReadResult, native_columns
from undrift.io.formats import Format, format_of, read_counted, read_markers, read_reference
from undrift.io.guess import MapProposal, foreign_kind, is_poses, propose, sample_of
from undrift.io.imucal import is_imucal
from undrift.io.labelled import labelled, states_units
from undrift.io.libraries import columns_of_arrays, mat_arrays
from undrift.io.log import log_text
from undrift.io.mocap import Markers, Up
from undrift.io.parquet import parquet_names, read_parquet_table
from undrift.io.reference import ReferenceMap, native_reference
from undrift.io.session import read_session
from undrift.io.text import Text, sniff
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
    symptoms = [*check_gravity(record), *_rest(record), *_temperature(record), *_sampling(record.time)]
    for name in ("gyro", "accel"):
        if getattr(record, name) is not None:
            symptoms += _axes(name, getattr(record, name))
    return (*symptoms, *find_saturated(record))


def gaps_of(record: Record) -> int:
    """Return the number of samples with a gap in any channel."""
    channels = (record.gyro, record.accel, record.mag_ut, record.temp_c)
    gaps = [np.isnan(values).reshape(len(record), -1).any(axis=1) for values in channels if values is not None]
    return int(np.any(gaps, axis=0).sum())


def check_gravity(record: Record) -> Iterator[Finding]:
    """Yield a finding if the specific force is far from 1 g at its median."""
    if record.accel is None or not is_physical(record.accel_unit) or not np.isfinite(record.accel).all(axis=1).any():
        return
    size = np.linalg.norm(record.accel, axis=1) * (si_factor(record.accel_unit, "accel") / STANDARD_GRAVITY)
    median = float(np.nanmedian(size))
    if not GRAVITY_RANGE[0] <= median <= GRAVITY_RANGE[1]:
        small = 0.0 < median < 1.0
        factor, direction = (1.0 / median, "small") if small else (median, "large")
        units = "g, not m/s2" if small else "m/s2, not g"
        cause = f": acceleration is in {units}" if abs(factor / STANDARD_GRAVITY - 1.0) < 0.2 else ""
        yield finding(
            "recording.gravity",
            "warn",
            f"The median acceleration is {median:.3g} g where a body at rest reads 1 g ({factor:.3g} times too "
            f"{direction}){cause}.",
            "Correct units.accel or scale.accel in the map.",
            median_g=median,
            direction=direction,
        )


def _rest(record: Record) -> Iterator[Finding]:
    """Return the offset of a gyroscope from the quietest two seconds."""
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
            quiet_s, rate_dps = record.time[best * size], mean / RADIAN_PER_DEGREE
            yield finding(
                "recording.rest_rate",
                "warn",
                f"The gyroscope reads {rate_dps:.3g} deg/s in its quietest two seconds (at {quiet_s:.6g} s): it turns "
                "steadily, or its unit or scale is wrong.",
                "Check units.gyro and scale.gyro in the map.",
                turn_rate_dps=rate_dps,
            )


CHECK_TEMPERATURE = "Check the column, unit and scale of the temperature in the map."


def _temperature(record: Record) -> Iterator[Finding]:
    if record.temp_c is None:
        return
    temp = record.temp_c[np.isfinite(record.temp_c)]
    if not len(temp):
        yield finding("recording.temperature", "info", "The temperature column is empty.", CHECK_TEMPERATURE)
        return
    low, high = float(temp.min()), float(temp.max())
    if low > ROOM_C[1] or high < ROOM_C[0]:
        sentence = f"The temperature is {low:.1f} to {high:.1f} degC: a processor, a chamber, or a wrong scale."
        yield finding("recording.temperature", "warn", sentence, CHECK_TEMPERATURE, low_c=low, high_c=high)
    jumps = np.flatnonzero(np.abs(np.diff(temp)) > JUMP_C)
    if len(jumps):
        sentence = f"The temperature jumps by over {JUMP_C:g} K between samples {len(jumps)} times, first after sample {jumps[0]}."
        values = {"count": len(jumps), "first_sample": jumps[0]}
        yield finding("recording.temperature", "warn", sentence, CHECK_TEMPERATURE, **values)


def _sampling(time: FloatArray) -> Iterator[Finding]:
    stamps = host_stamps(time)
    if stamps is not None:
        fit = stamps.fit
        yield finding(
            "recording.host_clock",
            "warn",
            f"The time stamps are the host's (steps of {stamps.low_ms:.3g} to {stamps.high_ms:.3g} ms). A regular clock of "
            f"{fit.sample_rate_hz:.5g} Hz fits, with stamps up to {1e3 * fit.jitter_s:.3g} ms late and {fit.missing} samples "
            "missing.",
            "Read it with clock = 'regular' in a map.",
            sample_rate_hz=fit.sample_rate_hz,
            jitter_ms=1e3 * fit.jitter_s,
            gaps=fit.gaps,
            missing=fit.missing,
        )
        return
    steps = np.diff(time)
    low, middle, high = np.quantile(steps, 0.25), float(np.median(steps)), np.quantile(steps, 0.75)
    if high - low > UNEVEN * middle:
        sentence = f"The sampling is uneven: half of the steps lie outside {1e3 * low:.4g} to {1e3 * high:.4g} ms."
        yield finding("recording.uneven_sampling", "warn", sentence)
    lost = steps > 1.5 * middle
    if lost.any():
        count, longest_s, longest_start_s = int(lost.sum()), steps.max(), time[int(steps.argmax())]
        sentence = f"The recording has {count} drop-outs, the longest {longest_s:.4g} s at {longest_start_s:.6g} s (median step "
        sentence += f"{1e3 * middle:.4g} ms, mean rate {(len(time) - 1) / (time[-1] - time[0]):.4g} Hz)."
        yield finding("recording.uneven_sampling", "warn", sentence, count=count, longest_s=longest_s)


def _axes(channel: str, values: FloatArray) -> Iterator[Finding]:
    for axis, column in zip(AXES, values.T, strict=True):
        column = column[np.isfinite(column)]
        if len(column) >= 2 * STUCK and column.min() == column.max():
            yield finding(
                "recording.dead_axis",
                "warn",
                f"{channel} {axis} never changes: the axis is dead or not mapped.",
                channel=channel,
                axis=axis,
            )


# ---- readings at the end of the range


def find_saturated(record: Record) -> tuple[Finding, ...]:
    """Return a finding for each end of the range at which an axis of a record sticks."""
    symptoms = []
    for channel, values in (("gyro", record.gyro), ("accel", record.accel)):
        for axis, column in () if values is None else zip(AXES, values.T, strict=True):
            for limit, stuck in saturated_runs(column):
                longest = (stuck[:, 1] - stuck[:, 0]).max()
                sentence = f"{channel} {axis} is saturated: it stays at {limit:.6g} for {longest} samples in a row."
                symptoms.append(
                    finding("recording.saturated", "warn", sentence, channel=channel, axis=axis, count=longest)
                )
    return tuple(symptoms)


def saturated_runs(column: FloatArray) -> Iterator[tuple[float, IntArray]]:
    """Return each limit at which readings (N,) stick, and the stretches (R, 2) in which they do."""
    for end in (np.fmax, np.fmin) if len(column) >= 2 * STUCK else ():
        limit = end.reduce(column)
        at_limit = column == limit
        if np.count_nonzero(at_limit) < STUCK:
            continue
        stuck = runs(at_limit)
        stuck = stuck[stuck[:, 1] - stuck[:, 0] >= STUCK]
        if len(stuck) and np.isfinite(column).sum() >= 2 * STUCK and _ends_range(column, float(limit), stuck):
            yield float(limit), stuck


def _ends_range(column: FloatArray, limit: float, stuck: IntArray) -> bool:
    """Return True if a limit is far from the middle of the readings, or is large and no other values repeat."""
    known = column[np.isfinite(column)]
    middle, codes = np.median(known), np.unique(known)
    usual = np.median(np.abs(known - middle))
    if not usual > 0.0:
        return False
    if codes[0] < 0.0 and abs(limit) < 0.1 * max(-codes[0], codes[-1]):
        return False  # ranges are symmetric about zero: this is the level at rest of a motion to one side
    fine = len(codes) > 10 * STUCK  # coarse codes repeat at an end as inside, but are not got to in a jump
    far = abs(limit - middle) > 10.0 * usual
    if not (fine or far):
        return False
    change = np.abs(np.diff(column))
    jumped = bool((change[np.clip(stuck - 1, 0, len(change) - 1)] > 5.0 * change[change > 0.0].min()).any())
    begins = np.flatnonzero(np.diff(column, prepend=np.nan) != 0.0)
    inside = (column[begins] != codes[0]) & (column[begins] != codes[-1])
    alone = int(np.diff(np.append(begins, len(column)))[inside].max(initial=0)) < STUCK // 2
    large = abs(limit) > 0.5 * max(abs(codes[0]), abs(codes[-1]))  # no rest of a log without noise
    return bool((far and (fine or jumped)) or (large and alone and fine))


# ---- describe

_MISSING = ("sensor", "sample_rate_hz", "columns", "readings")  # facts that an intact file may omit
_TABLES = ("mat", "parquet", "csv", "log")  # kinds of file from which a map makes a recording
_POSES = "a table of orientations, which is read as a reference with a map"
_REGULAR = 0.005  # mean and usual rate that differ by less are one figure


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """Description of the content of a file."""

    path: str
    # recording, reference, markers, session, calibration, device, table (needs a map), settings, text or binary
    kind: str
    format: str  # A name of io.formats.FORMATS, or of another package's
    summary: str  # one line: the kind of file, or the map that it needs
    rows: int | None = None  # Samples or frames
    sample_rate_hz: float | None = None  # samples over time, with lost and uneven samples
    usual_rate_hz: float | None = None  # By the usual step, drop-outs left out
    duration_s: float | None = None
    columns: tuple[str, ...] = ()  # Channels, markers, or column names
    units: tuple[tuple[str, str], ...] = ()  # Channel and unit
    gaps: int = 0  # Samples with a gap
    temp_c: tuple[float, float] | None = None  # Lowest and highest
    findings: tuple[Finding, ...] = ()
    proposal: MapProposal | None = None  # map that a table of foreign names may need
    # result of reading: a session, or a recording as a session of one
    session: Session | None = field(default=None, repr=False)

    @property
    def example(self) -> tuple[str, ...]:
        """Lines of the map that a table of foreign names may need, "?" where a person must state the unit."""
        return () if self.proposal is None else self.proposal.lines()

    @property
    def problems(self) -> tuple[str, ...]:
        """The findings as texts, but how the file was read."""
        return tuple(_told(item) for item in self.findings if item.code != "recording.how_read")


def _told(item: Finding) -> str:
    """Return the text of a finding, with the recording of a session that it is about."""
    return f"recording {item.values['recording']}: {item.text}" if "recording" in item.values else item.text


def describe(path: str | Path, column_map: ColumnMap | None = None, *, up: Up | None = None) -> Description:
    """Return a description of the content of a file."""
    path, how = Path(path), column_map or READ_SETTINGS
    if is_imucal(path):
        summary = "calibration of imucal: constants without uncertainty"
        return Description(path=str(path), kind="calibration", format="imucal", summary=summary)
    name, entry = format_of(path)
    if entry.markers is not None:
        return _markers(path, name, up)
    if name == "session":
        return _session(path, how)
    if name in ("json", "toml"):
        return _settings(path, name, how)
    if entry.record is None and not how.columns:
        return _reference(path, name) if entry.reference or entry.bodies else _unread(path, name, entry)
    needs = None if how.columns else _needs(path, name)
    if needs is not None:
        return needs
    try:
        read = read_counted(path, how)
    except InputError as error:
        missing = error.numbers.get("missing")
        if missing not in _MISSING:
            raise
        columns, proposal = error.numbers.get("names", ()), error.numbers.get("proposal")
        column_names = tuple(map(str, columns)) if isinstance(columns, tuple) else ()
        description = _not_read(path, name, column_names, str(error).removeprefix(f"{path}: "), missing=str(missing))
        in_table = missing == "readings" and not name.startswith("phone")
        if in_table and is_poses(poses := propose(sample_of(text := sniff(path)), text)):
            return replace(description, summary=_POSES, columns=text.names, proposal=poses)
        return replace(description, proposal=MapProposal(**proposal)) if isinstance(proposal, dict) else description
    description = describe_record(read, path=str(path), format_name=name)
    if not how.columns and name in ("csv", "parquet"):
        names = sniff(path).names if name == "csv" else parquet_names(path)
        unread = tuple(other for other in names if other not in description.columns)
        if unread:
            sentence = f"These columns have other names than undrift's and were not read: {', '.join(unread[:12])}."
            unread_finding = finding("recording.how_read", "info", sentence, "Read them with a column map.")
            description = replace(description, findings=(*description.findings, unread_finding))
    return description


def _rows_left_out(count: int, why: str) -> Finding:
    return finding("recording.rows_left_out", "warn", f"{count} rows were left out, because {why}.", count=count)


def describe_record(read: ReadResult, *, path: str = "", format_name: str = "csv") -> Description:
    """Return a description of a record."""
    record, mean, usual = read.record, mean_rate_hz(read.record), read.record.sample_rate_hz
    left_out = [finding("recording.how_read", "info", note) for note in read.notes]
    for count, why in (
        (read.dropped_rows, "they did not parse"),
        (read.repaired_rows, "their time did not go forward"),
    ):
        left_out += [_rows_left_out(count, why)] if count else []
    if read.clock is not None:
        clock, by = read.clock, "the device's counter" if read.clock.counted else "the steps of the stamps"
        sentence = f"A regular clock of {clock.sample_rate_hz:.6g} Hz was fitted to {by}: stamps are up to "
        sentence += f"{1e3 * clock.jitter_s:.3g} ms "
        sentence += (
            f"late, {clock.missing} samples are missing in {clock.gaps} gaps of up to {clock.longest_step_s:.3g} s."
        )
        left_out.append(finding("recording.how_read", "info", sentence))
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
    """Return the description of several records: columns and units of the first, the rest of all."""
    first = records[0]
    channels = {"time": ("s", first.time), "gyro": (first.gyro_unit, first.gyro)}
    channels |= {"accel": (first.accel_unit, first.accel), "temp": ("degC", first.temp_c), "mag": ("uT", first.mag_ut)}
    temperatures = [t[np.isfinite(t)] for t in (record.temp_c for record in records) if t is not None]
    temp_c = np.concatenate(temperatures) if temperatures else np.empty(0)
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
    """Return True if a file is a table that requires a map: it has neither undrift's own names nor units."""
    name, _ = format_of(path)
    return name == "text" or (name in _TABLES and not is_native(_sample(Path(path), name)[0].names))


def _sample(path: Path, name: str) -> tuple[RawTable, Text | None]:
    """Return a table, or the first MiB of a text and how it was opened."""
    if name == "parquet":
        return read_parquet_table(path), None
    if name == "mat":
        return columns_of_arrays(mat_arrays(path), path), None
    text = log_text(path) if name == "log" else sniff(path)
    return sample_of(text), text


def _needs(path: Path, name: str) -> Description | None:
    """Return the description of a file that cannot be read without a map or as a recording, None if it can."""
    if name not in _TABLES or (name == "log" and states_units(labelled(log_text(path)))):
        return None
    table, text = _sample(path, name)
    if is_native(table.names):
        return None
    if native_reference(table.names) is not None:
        return _reference(path, name)
    proposal = propose(table, text)
    if is_poses(proposal):
        return replace(_not_read(path, name, table.names, _POSES), proposal=proposal)
    if (foreign := foreign_kind(table, text)) is not None:
        return _not_read(path, name, table.names, foreign)
    what = "columns" if text is None or text.layout.header else "columns without names"
    needed = f"a table of {len(table.names)} {what}, which needs a map with the true units"
    return replace(_not_read(path, name, table.names, needed), proposal=proposal)


def _not_read(path: Path, name: str, columns: tuple[str, ...], what: str, *, missing: str = "") -> Description:
    findings = (finding("recording.not_read", "warn", what, missing=missing),)
    return Description(path=str(path), kind="table", format=name, summary=what, columns=columns, findings=findings)


def describe_poses(path: Path, columns: ReferenceMap) -> Description:
    """Return the content of a table of orientations, read with its map."""
    return _reference(path, format_of(path)[0], columns)


def _reference(path: Path, name: str, columns: ReferenceMap | None = None) -> Description:
    names: tuple[str, ...] = ()
    try:
        reference = read_reference(path, columns)
    except InputError as error:
        body_names = error.numbers.get("names")
        if not isinstance(body_names, tuple):
            raise
        names = tuple(map(str, body_names))
        reference = read_reference(path, labels=names[:1])
    valid_count = int(reference.valid.sum())
    remark = f" of each of {len(names)} bodies (choose one of {', '.join(names)})" if names else ""
    remark += "" if columns is None else f", {reference.name.removeprefix(path.name).strip()}"
    return Description(
        path=str(path),
        kind="reference",
        format=name,
        summary=f"{len(reference)} poses at {reference.sample_rate_hz:.6g} Hz, {valid_count} valid{remark.rstrip(', ')}",
        columns=names,
        gaps=len(reference) - valid_count,
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
        sentence, action = "The file does not state which axis points up.", "Set `reference_up` to y or z."
        findings.append(finding("recording.up_axis", "warn", sentence, action))
    gap: BoolArray = np.any(np.isnan(markers.points), axis=2)
    never = [label for k, label in enumerate(markers.labels) if gap[:, k].all()]
    if markers.short_rows:
        why = "they end before the last marker, which is read as lost"
        findings.append(_rows_left_out(markers.short_rows, why))
    remark = f" ({', '.join(never)} never seen)" if never else ""
    return Description(
        path=str(path),
        kind="markers",
        format=name,
        summary=f"{len(markers.labels)} markers{remark}, {len(markers)} frames at {markers.sample_rate_hz:.6g} Hz",
        columns=markers.labels,
        units=(("position", SI_UNIT["length"]),),
        gaps=int(gap.any(axis=1).sum()),
        findings=tuple(findings),
        **_of_clock(markers),
    )


def _of_clock(poses: Reference | Markers) -> dict[str, Any]:
    duration_s = float(poses.time[-1] - poses.time[0])
    return {"rows": len(poses), "sample_rate_hz": poses.sample_rate_hz, "duration_s": duration_s}


def _session(path: Path, how: ColumnMap) -> Description:
    session = read_session(path, clock=how.clock if how.clock == "regular" else None)
    counts = ((session.records, "recording"), (session.stills, "still"), (session.turns, "turn"))
    listing = ", ".join(f"{len(items)} {what}{'s' * (len(items) != 1)}" for items, what in counts)
    return Description(
        path=str(path),
        kind="session",
        format="session",
        summary=f"{session.kind} of {session.serial}: {listing}",
        session=session,
        findings=tuple(
            replace(item, values={**item.values, "recording": number})
            for number, record in enumerate(session.records)
            for item in find_symptoms(record)
        ),
        **_of_records(*session.records),
    )


def _settings(path: Path, name: str, how: ColumnMap) -> Description:
    kind = "settings"
    if name == "toml":
        if path.name == "session.toml":
            return _session(path, how)
        summary = "TOML settings, not a column map"
        with suppress(InputError):
            if parts := read_map(path).parts():
                summary = f"a column map of {', '.join(dict.fromkeys(chain.from_iterable(x.mapped() for x in parts)))}"
        return Description(path=str(path), kind=kind, format=name, summary=summary)
    try:
        content = json.loads(read_tree(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected JSON, got something else: {error}. Repair the file.") from error
    keys = content if isinstance(content, dict) else {}
    summary = f"JSON, not a recording: {', '.join(list(keys)[:8]) or type(content).__name__}"
    if str(keys.get("kind")).startswith("undrift."):
        kind = str(keys["kind"]).removeprefix("undrift.")
        device = " ".join(str(keys[key]) for key in ("device", "name", "serial") if keys.get(key))
        summary = f"{kind} of {device or 'a device without a serial number'}, format {keys.get('format')}"
    return Description(path=str(path), kind=kind, format=name, summary=summary)


def _unread(path: Path, name: str, entry: Format) -> Description:
    summary = entry.instead or name
    if name == "text":
        lines = read_bytes(path, 4096).decode("utf-8", "replace").splitlines()
        first = next((line.strip() for line in lines if line.strip()), "")
        summary = f"{summary}: {first[:60]}"
    kind = "binary" if b"\0" in read_bytes(path, 4096) else "text"
    return Description(path=str(path), kind=kind, format=name, summary=summary)
