"""describe: the content of a file as a single value. It works for every file that exists and is not damaged."""

import json
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import BoolArray
from undrift.errors import InputError
from undrift.files import read_bytes, read_tree
from undrift.findings import Finding, finding
from undrift.io.column_map import READ_SETTINGS, ColumnMap, is_native, read_map
from undrift.io.columns import RawTable, ReadResult, native_columns, rows_left_out
from undrift.io.formats import format_of, read_counted, read_markers, read_reference
from undrift.io.guess import MapProposal, foreign_kind, is_poses, propose, sample_of
from undrift.io.imucal import is_imucal
from undrift.io.labelled import labelled, states_units
from undrift.io.libraries import columns_of_arrays, mat_arrays
from undrift.io.log import log_text
from undrift.io.mocap import Markers, Up
from undrift.io.parquet import read_parquet_table
from undrift.io.reference import ReferenceMap, native_reference
from undrift.io.session import read_session
from undrift.io.symptoms import check_sampling, find_symptoms, gaps_of
from undrift.io.text import Text, sniff
from undrift.record import Record, Reference, Session
from undrift.units import SI_UNIT, STANDARD_GRAVITY

_MISSING = ("sensor", "sample_rate_hz", "columns", "readings")  # facts that an intact file may omit
_TABLES = ("mat", "parquet", "csv", "log")  # kinds of file that become a recording with a map
_POSES = "a table of orientations, which is read as a reference with a map"
_REGULAR = 0.005  # mean and usual rate that differ by less than this are printed as one rate


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """Description of the content of a file."""

    path: str = ""
    # recording, reference, markers, session, calibration, device, table (needs a map), settings, text or binary
    kind: str
    format: str = ""  # name from io.formats.FORMATS, or of another package's format
    summary: str  # one line: the kind of file, or the map that it needs
    rows: int | None = None  # number of samples or frames
    sample_rate_hz: float | None = None  # samples over time, with lost and uneven samples
    usual_rate_hz: float | None = None  # rate from the usual step, without drop-outs
    duration_s: float | None = None
    columns: tuple[str, ...] = ()  # channels, markers, or column names
    units: tuple[tuple[str, str], ...] = ()  # unit of each channel
    gaps: int = 0  # number of samples with a gap
    temp_c: tuple[float, float] | None = None  # lowest and highest temperature, degC
    findings: tuple[Finding, ...] = ()
    proposal: MapProposal | None = None  # map that a table with foreign names may need
    # result of reading: a session, or a session with a single recording
    session: Session | None = field(default=None, repr=False)

    @property
    def example(self) -> tuple[str, ...]:
        """Return the lines of the map that a table with foreign names may need, with "?" for a unit that a person must enter."""
        return () if self.proposal is None else self.proposal.lines()

    @property
    def problems(self) -> tuple[str, ...]:
        """Return the texts of the findings, except those about reading the file."""
        return tuple(_told(item) for item in self.findings if item.code != "recording.how_read")


def _told(item: Finding) -> str:
    """Return the text of a finding, with the number of its recording in a session."""
    return f"recording {item.values['recording']}: {item.text}" if "recording" in item.values else item.text


def describe(path: str | Path, column_map: ColumnMap | None = None, *, up: Up | None = None) -> Description:
    """Return a description of the content of a file."""
    path, how = Path(path), column_map or READ_SETTINGS
    if is_imucal(path):
        summary = "calibration of imucal: constants without uncertainty"
        return Description(path=str(path), kind="calibration", format="imucal", summary=summary)
    name, entry = format_of(path)
    if entry.markers is not None:
        description = _markers(path, up)
    elif name == "session" or path.name == "session.toml":
        name, description = "session", _session(path, how)
    elif name in ("json", "toml"):
        description = _settings(path, name)
    elif entry.record is None and not how.columns:
        description = _reference(path) if entry.reference or entry.bodies else _unread(path, entry.instead or name)
    else:
        needs = None if how.columns else _needs(path, name)
        description = _recording(path, name, how) if needs is None else needs
    return replace(description, path=str(path), format=name)


def describe_poses(path: Path, columns: ReferenceMap) -> Description:
    """Return the content of a table of orientations, read with its map."""
    return replace(_reference(path, columns), path=str(path), format=format_of(path)[0])


# ---- recordings and sessions


def _recording(path: Path, name: str, how: ColumnMap) -> Description:
    """Return the content of a recording, or the requirements for reading it."""
    try:
        read = read_counted(path, how)
    except InputError as error:
        missing = error.numbers.get("missing")
        if missing not in _MISSING:
            raise
        names, proposal = error.numbers.get("names"), error.numbers.get("proposal")
        columns = tuple(map(str, names)) if isinstance(names, tuple) else ()
        description = _not_read(columns, str(error).removeprefix(f"{path}: "), missing=str(missing))
        in_table = missing == "readings" and not name.startswith("phone")
        if in_table and is_poses(poses := propose(sample_of(text := sniff(path)), text)):
            return replace(description, summary=_POSES, columns=text.names, proposal=poses)
        return replace(description, proposal=MapProposal(**proposal)) if isinstance(proposal, dict) else description
    return describe_record(read)


def describe_record(read: ReadResult) -> Description:
    """Return a description of a record."""
    record, mean, usual = read.record, mean_rate_hz(read.record), read.record.sample_rate_hz
    rate = f"{mean:.6g} Hz"
    if abs(mean / usual - 1.0) >= _REGULAR:
        rate = f"{mean:.4g} Hz on average (usual step {1e3 / usual:.4g} ms, {usual:.4g} Hz)"
    device = f", {record.device}" if record.device else ""
    return Description(
        kind="recording",
        summary=f"{len(record)} samples at {rate}, {record.duration_s:.6g} s{device}",
        findings=(*read.remarks, *find_symptoms(record)),
        session=Session(kind="calibration", serial="", gravity_m_s2=STANDARD_GRAVITY, records=(record,)),
        **_of_records(record),
    )


def _of_records(*records: Record) -> dict[str, Any]:
    """Return the description of several records: columns and units of the first record, other values of all records."""
    first = records[0]
    channels = {"time": ("s", first.time), "gyro": (first.gyro_unit, first.gyro)}
    channels |= {"accel": (first.accel_unit, first.accel), "temp": ("degC", first.temp_c), "mag": ("uT", first.mag_ut)}
    temp_c = np.concatenate([np.empty(0), *(record.temp_c for record in records if record.temp_c is not None)])
    temp_c = temp_c[np.isfinite(temp_c)]
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
    """Return the number of samples over time, including drop-outs."""
    return sum(len(record) - 1 for record in records) / sum(record.duration_s for record in records)


def _session(path: Path, how: ColumnMap) -> Description:
    session = read_session(path, clock=how.clock if how.clock == "regular" else None)
    counts = ((session.records, "recording"), (session.stills, "still"), (session.turns, "turn"))
    listing = ", ".join(f"{len(items)} {what}{'s' * (len(items) != 1)}" for items, what in counts)
    return Description(
        kind="session",
        summary=f"{session.kind} of {session.serial}: {listing}",
        session=session,
        findings=tuple(finding("recording.how_read", "info", note) for note in session.notes)
        + tuple(
            replace(item, values={**item.values, "recording": number})
            for number, record in enumerate(session.records)
            for item in find_symptoms(record)
        ),
        **_of_records(*session.records),
    )


# ---- tables that need a map


def needs_map(path: str | Path) -> bool:
    """Return True if a file is a table that requires a map: it has neither undrift's own names nor units."""
    name, _ = format_of(path)
    return name == "text" or (name in _TABLES and not is_native(_sample(Path(path), name)[0].names))


def _sample(path: Path, name: str) -> tuple[RawTable, Text | None]:
    """Return a table, or the first MiB of a text and the opened text."""
    if name == "parquet":
        return read_parquet_table(path), None
    if name == "mat":
        return columns_of_arrays(mat_arrays(path), path), None
    text = log_text(path) if name == "log" else sniff(path)
    return sample_of(text), text


def _needs(path: Path, name: str) -> Description | None:
    """Return the description of a file that is not a recording or needs a map, or None for a readable recording."""
    if name not in _TABLES or (name == "log" and states_units(labelled(log_text(path)))):
        return None
    table, text = _sample(path, name)
    if is_native(table.names):
        return None
    if native_reference(table.names) is not None:
        return _reference(path)
    proposal = propose(table, text)
    if is_poses(proposal):
        return replace(_not_read(table.names, _POSES), proposal=proposal)
    if (foreign := foreign_kind(table, text)) is not None:
        return _not_read(table.names, foreign)
    what = "columns" if text is None or text.layout.header else "columns without names"
    needed = f"a table of {len(table.names)} {what}, which needs a map with the true units"
    return replace(_not_read(table.names, needed), proposal=proposal)


def _not_read(columns: tuple[str, ...], what: str, *, missing: str = "") -> Description:
    findings = (finding("recording.not_read", "warn", what, missing=missing),)
    return Description(kind="table", summary=what, columns=columns, findings=findings)


# ---- references and other files


def _reference(path: Path, columns: ReferenceMap | None = None) -> Description:
    names: tuple[str, ...] = ()
    try:
        reference = read_reference(path, columns)
    except InputError as error:
        bodies = error.numbers.get("names")
        if not isinstance(bodies, tuple):
            raise
        names = tuple(map(str, bodies))
        reference = read_reference(path, labels=names[:1])
    valid_count = int(reference.valid.sum())
    remark = f" of each of {len(names)} bodies (choose one of {', '.join(names)})" if names else ""
    remark += "" if columns is None else f", {reference.name.removeprefix(path.name).strip()}"
    return Description(
        kind="reference",
        summary=f"{len(reference)} poses at {reference.sample_rate_hz:.6g} Hz, {valid_count} valid{remark.rstrip(', ')}",
        columns=names,
        gaps=len(reference) - valid_count,
        findings=tuple(check_sampling(reference.time)),
        **_of_clock(reference),
    )


def _markers(path: Path, up: Up | None) -> Description:
    findings: list[Finding] = []
    try:
        markers = read_markers(path, up=up)
    except InputError as error:
        if error.numbers.get("missing") != "up":
            raise
        markers = read_markers(path, up="z")
        sentence, action = "The file does not contain which axis points up.", "Set `reference_up` to y or z."
        findings.append(finding("recording.up_axis", "warn", sentence, action))
    findings += rows_left_out(markers.short_rows, "these end before the last marker, which is read as lost")
    gap: BoolArray = np.any(np.isnan(markers.points), axis=2)
    never = [label for k, label in enumerate(markers.labels) if gap[:, k].all()]
    remark = f" ({', '.join(never)} never seen)" if never else ""
    return Description(
        kind="markers",
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


def _settings(path: Path, name: str) -> Description:
    if name == "toml":
        summary = "TOML settings, not a column map"
        with suppress(InputError):
            if parts := read_map(path).parts():
                summary = f"a column map of {', '.join(dict.fromkeys(chain.from_iterable(x.mapped() for x in parts)))}"
        return Description(kind="settings", summary=summary)
    try:
        content = json.loads(read_tree(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is not valid JSON: {error}. Repair the file.") from error
    keys = content if isinstance(content, dict) else {}
    if str(keys.get("kind")).startswith("undrift."):
        kind = str(keys["kind"]).removeprefix("undrift.")
        device = " ".join(str(keys[key]) for key in ("device", "name", "serial") if keys.get(key))
        summary = f"{kind} of {device or 'a device without a serial number'}, format {keys.get('format')}"
        return Description(kind=kind, summary=summary)
    listing = ", ".join(list(keys)[:8]) or type(content).__name__
    return Description(kind="settings", summary=f"JSON, not a recording: {listing}")


def _unread(path: Path, summary: str) -> Description:
    head = read_bytes(path, 4096)
    if summary.startswith("prose"):
        lines = map(str.strip, head.decode("utf-8", "replace").splitlines())
        summary = f"{summary}: {next(filter(None, lines), '')[:60]}"
    return Description(kind="binary" if b"\0" in head else "text", summary=summary)
