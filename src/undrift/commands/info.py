"""``undrift info``: describe the content of a file: rates, units, spans, gaps, stills, problems, and the map that it needs."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.base.options import Files, Up, WrittenPath
from undrift.calibration.calibrate import find_pieces
from undrift.calibration.pieces import pieces_of
from undrift.calibration.session import Observed, look
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.triads import check_triads, find_disagreement
from undrift.commands.batch import each_recording
from undrift.commands.files import Opening, Place, named_columns, session_folder, session_of
from undrift.commands.outputs import check_folder, check_output
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.findings import Finding
from undrift.io.inspect import Description, describe, describe_poses
from undrift.io.reference import read_reference_map
from undrift.io.session import NAME, proposed_toml
from undrift.io.store import read_calibration
from undrift.record import Session
from undrift.report import Report, Table
from undrift.report.calibration import calibration_report
from undrift.report.figures import draw_recording
from undrift.report.report import Cell
from undrift.screen import progress, reading
from undrift.sim.device.effects import effects_of
from undrift.sim.device.model import read_device
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

AT_REST: tuple[tuple[str, Quantity, str, str, float], ...] = (
    ("accel", "accel", "acceleration at rest", "g", STANDARD_GRAVITY),
    ("gyro", "rate", "turn rate at rest", "deg/s", RADIAN_PER_DEGREE),
)
POSES = 9  # smallest number of still phases of a recording that may calibrate a device
DATA = (
    "kind",
    "format",
    "rows",
    "sample_rate_hz",
    "usual_rate_hz",
    "duration_s",
    "columns",
    "gaps",
    "temp_c",
    "problems",
)


@each_recording("", together=("write_session", "write_map"))
def info(
    *files: Files,
    opening: Opening = Opening(),
    reference_up: Up = None,
    write_map: WrittenPath = None,
    gyro_unit: str | None = None,
    accel_unit: str | None = None,
    write_session: WrittenPath = None,
    turn_deg: float | None = None,
) -> Report:
    """Describe a recording, session, calibration, reference or device: rates, units, spans, gaps and detected stills.

    Parameters
    ----------
    files : Path
        Any file, or a folder of recordings. With --write-session, recordings of the same device.
    write_map : Path or None
        Map to write for a table with foreign columns, with the reason for each unit: .toml.
    gyro_unit : str or None
        With --write-map: unit of the gyroscopes if the file does not give it: rad/s, dps, count or v.
    accel_unit : str or None
        With --write-map: unit of the accelerometers: m/s2, g, mg, count or v.
    write_session : Path or None
        Folder to write session.toml into, with the rests, faces and turns of bare recordings, ready to edit.
    turn_deg : float or None
        With --write-session: angle of the turns between rests, deg: 360 for full turns.
    """
    units = {"gyro": gyro_unit, "accel": accel_unit}
    for name, unit in units.items():
        if unit is not None and write_map is None:
            raise InputError(f"`{name}_unit`: this option requires `write_map`. Add `write_map` map.toml.")
    if turn_deg is not None and write_session is None:
        raise InputError("`turn_deg` requires `write_session`: add the folder of the session, or omit `turn_deg`")
    if write_session is not None and write_map is not None:
        raise InputError("`write_session` and `write_map` cannot be combined. Run two commands.")
    if write_session is not None:
        return _write_session(files, write_session, opening, turn_deg)
    if len(files) > 1:
        raise InputError(f"info: expected one table for `write_map`, got {len(files)}. Give only one.")
    file = files[0]
    check_output(write_map, endings=(".toml",), reads=(file, opening.column_map))
    with reading(0.8, file):
        description, opening = _describe(file, opening, reference_up)
    return content(description, opening) if write_map is None else _write_map(description, write_map, units, opening)


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """The content of a file, for the page of the bench."""

    kind: str
    summary: str
    serial: str
    columns: tuple[str, ...]
    missing: str  # setting that a reader requires: sample_rate_hz, sensor, or ""
    draft: dict[str, Any]  # proposed map of a table with foreign names
    reasons: dict[str, str]  # reason why a unit is proposed
    report: Report


def look_at(path: Path, opening: Opening) -> Looked:
    """Return the content of a file."""
    progress(f"reading {path.name}", 0.1)
    described = describe(path, opening.how(path))
    progress("looking for rests and turns", 0.6)
    serial = "" if described.session is None else described.session.records[0].device
    if described.kind == "calibration":
        serial = read_calibration(path).device
    missing = [item.values["missing"] for item in described.findings if item.code == "recording.not_read"]
    proposal = described.proposal if described.kind == "table" else None
    return Looked(
        kind=described.kind,
        summary="readings without time"
        if "sample_rate_hz" in missing
        else described.summary.partition("; needs a map")[0],
        serial=serial,
        columns=described.columns,
        missing=str(missing[0]) if missing else "",
        draft={} if proposal is None else tomllib.loads("\n".join(proposal.lines()).replace("= ?", '= "?"')),
        reasons={} if proposal is None else dict(proposal.reasons),
        report=content(described, opening),
    )


def _describe(file: Path, opening: Opening, up: Up) -> tuple[Description, Opening]:
    """Return the content of a file, read with a map of readings or of orientations."""
    poses = None if opening.column_map is None else read_reference_map(opening.column_map)
    if poses is not None:
        return describe_poses(file, poses), replace(opening, column_map=None)
    return describe(file, opening.how(file), up=up), opening


def content(description: Description, opening: Opening) -> Report:
    """Return the content of a file."""
    path, session = Path(description.path), description.session
    answer = f"{path} ({description.kind}, {description.format}): {description.summary}"
    data = {name: getattr(description, name) for name in DATA}
    data |= {"units": dict(description.units), "summary": description.summary, "map": description.example}
    if description.kind == "calibration":
        report = calibration_report(read_calibration(path))
        return replace(report, title=f"Content of {path.name}", answer=f"{answer}. {report.answer}", data=data)
    findings, notes, figures, tables = list(_named(description)), list[str](), [], list[Table]()
    details = [Table(title="Columns", columns=("column",), rows=[(name,) for name in description.columns])]
    stills, at_rest = list[tuple[float, float]](), list[tuple[str, Cell, str]]()
    if session is not None:
        findings += [entry for record in session.records if (entry := find_disagreement(record)) is not None]
        observed, reason = _look(session)
        notes += [reason] if reason else []
        rows = [] if observed is None else _stills(session, observed)
        at_rest = [] if observed is None else _at_rest(observed)
        stills = [(start, stop) for _, start, stop in rows]
        details.append(
            Table(title="Still phases", columns=("recording", "start (s)", "stop (s)"), rows=rows, form=".2f")
        )
        pieces = () if observed is None else pieces_of(observed)
        figures.append(lambda: draw_recording(session.records, pieces, title=path.name))
    tables.append(_facts(description, len(stills), at_rest))
    if description.example:
        tables.append(_proposal(description))
    if description.kind == "device":
        tables.append(_device(path))
    return Report(
        title=f"Content of {path.name}",
        answer=answer,
        tables=tables,
        details=details,
        notes=[*(finding.text for finding in findings if finding.level == "info"), *notes],
        findings=[finding for finding in findings if finding.level != "info"],
        figures=figures,
        data=data | {"stills": stills},
        next_command=_next_command(description, len(stills), opening),
    )


def _named(description: Description) -> Iterator[Finding]:
    """Yield the findings that the answer does not contain, each with the number of its recording in a session."""
    for finding in description.findings:
        if "recording" in finding.values:
            yield replace(finding, sentence=f"Recording {finding.values['recording']}: {finding.sentence}")
        elif finding.text != description.summary:
            yield finding


def _facts(description: Description, stills: int, at_rest: list[tuple[str, Cell, str]]) -> Table:
    rows: list[tuple[str, Cell, str]] = [
        ("samples", description.rows, ""),
        ("sample rate", description.sample_rate_hz, "Hz"),
        ("duration", description.duration_s, "s"),
        ("gaps", description.gaps or None, "samples"),
        ("still phases", stills or None, ""),
        *at_rest,
    ]
    if description.temp_c is not None:
        low, high = description.temp_c
        rows += [("lowest temperature", low, "degC"), ("highest temperature", high, "degC")]
    rows = [row for row in rows if row[1] is not None]
    units = dict(description.units)
    if description.kind in ("recording", "session"):
        units = dict.fromkeys(("gyro", "accel"), "no readings") | units
    rows += [(f"unit of {channel}", unit, "") for channel, unit in units.items()]
    return Table(title="Content", columns=("what", "value", "unit"), rows=rows, form=".6g")


def _at_rest(observed: Observed) -> list[tuple[str, Cell, str]]:
    """Return the median size of the readings at rest. If columns and units are right, it is 1 g and almost no rate."""
    rows = list[tuple[str, Cell, str]]()
    for name, quantity, label, unit, size in AT_REST:
        means = list[float]()
        for still in observed.stills:
            record = observed.session.records[still.recording]
            values, raw_unit = getattr(record, name), getattr(record, f"{name}_unit")
            if values is not None and is_physical(raw_unit):
                mean = values[still.start : still.stop].mean(axis=0) * si_factor(raw_unit, quantity)
                means.append(float(np.linalg.norm(mean)) / size)
        if means:
            rows.append((label, float(f"{np.median(means):.3g}"), unit))
    return rows


def _stills(session: Session, observed: Observed) -> list[tuple[int, float, float]]:
    """Return recording, start and end of each still phase, s."""
    times = [record.time for record in session.records]
    return [
        (still.recording, float(times[still.recording][still.start]), float(times[still.recording][still.stop - 1]))
        for still in observed.stills
    ]


def _look(session: Session) -> tuple[Observed | None, str]:
    """Return the still phases, or the reason why there are none. A recording that is too short is not an error."""
    settings = CalibrateSettings()
    try:
        observed = look(session, settings)
    except InputError:
        shortest, window = min(record.duration_s for record in session.records), settings.still.window_s
        return None, f"No still phase: {shortest:.3g} s are too short to look for one ({window:g} s and more)."
    return observed, "" if observed.stills else next(search.reason for search in observed.searches)


def _proposal(description: Description) -> Table:
    """Return the lines of the map that a table may need."""
    rate = " with `sample_rate_hz`" if "sample_rate_hz = ?" in description.example else ""
    option = "`reference_map`" if _has_poses(description) else "`column_map`"
    note = (
        f"`write_map` map.toml{rate} writes these lines. Check the units, replace each ?, and read the file with "
        f"{option} map.toml."
    )
    return Table(title="Proposed map", columns=("map.toml",), rows=[(line,) for line in description.example], note=note)


def _has_poses(description: Description) -> bool:
    return bool(description.example) and "quaternion = " in description.example[0]


def _device(file: Path) -> Table:
    """Return the active effects of a device model."""
    device = read_device(file)
    rows = [(name, effect) for name in ("gyro", "accel") for effect in effects_of(getattr(device, name))]
    rows += [(name, f"reading in {getattr(device, name).unit}") for name in ("gyro", "accel")]
    return Table(title="Device model", columns=("part", "effect"), rows=[*rows, ("source", device.source_tag)])


def _next_command(description: Description, stills: int, opening: Opening) -> tuple[object, ...]:
    """Return the next command, if one can be suggested."""
    path, kind = description.path, description.kind
    if description.example:
        ready = "sample_rate_hz = ?" not in description.example
        return ("info", path, "--write-map", "map.toml") if ready else ()
    missing = next((item.values.get("missing") for item in description.findings if "missing" in item.values), "")
    if missing == "sensor":
        return ("info", path, "--sensor", description.columns[0])
    if missing == "sample_rate_hz" and description.format == "ximu":
        return ("info", path, "--sample-rate-hz", "256")
    if kind == "markers" and any(item.code == "recording.up_axis" for item in description.findings):
        return ("info", path, "--reference-up", "y")
    if kind == "session" and description.summary.startswith("calibration"):
        return ("calibrate", path, "-o", "calibration.json")
    if kind == "recording" and stills >= POSES:
        return ("calibrate", path, *_options(opening), "-o", "calibration.json")
    return ()


def _options(opening: Opening) -> tuple[object, ...]:
    """Return the options for reading as they were given."""
    values = {"map": opening.column_map, **opening.keys}
    given = ((f"--{name.replace('_', '-')}", value) for name, value in values.items() if value is not None)
    return tuple(word for pair in given for word in pair)


# ---- files that a person edits


def _write_map(description: Description, path: Path, units: dict[str, str | None], opening: Opening) -> Report:
    """Write the proposed map of a table, with the reason for each unit."""
    if description.proposal is None:
        raise InputError(
            f"{description.path}: no map can be proposed for a {description.kind} ({description.format}): "
            f"{description.summary.rstrip('.')}. Omit --write-map."
        )
    text = description.proposal.text(description.path, sample_rate_hz=opening.sample_rate_hz, units=units)
    write_whole(path, text)
    complete = '"?"' not in text
    advice = f"Replace each ? in {path}" + ", or repeat with `gyro_unit` or `accel_unit`" * (
        not _has_poses(description)
    )
    return Report(
        title=f"Map of {Path(description.path).name}",
        answer=f"The map of {description.path} is complete." if complete else f"The map is not complete. {advice}.",
        tables=[Table(title="Map", columns=(path.name,), rows=[(line,) for line in text.splitlines()])],
        written=[path],
        data={"kind": description.kind, "format": description.format, "complete": complete},
        next_command=("info", description.path, "--map", path) if complete else (),
    )


def _write_session(files: tuple[Path, ...], path: Path, opening: Opening, turn_deg: float | None) -> Report:
    """Write a session.toml with the rests, faces and turns of bare recordings."""
    folder = path.parent if path.name == NAME else path
    check_folder(folder)
    if (folder / NAME).exists():
        raise InputError(f"{folder / NAME}: the session already exists. Edit it, or choose another folder.")
    if any(session_folder(file) is not None for file in files):
        raise InputError(f"{files[0]}: expected recordings without a session, got a session. Edit its session.toml.")
    with reading(0.5, *files):
        bare = session_of(files, Place(), opening)
        for file, record in zip(files, bare.records, strict=False):
            with named_columns(file):
                check_triads(record)
    progress("looking for rests and turns", 0.5)
    session, steady = find_pieces(bare, CalibrateSettings(turn_angle_deg=turn_deg))
    text = proposed_toml(session, files, folder, file_map=opening.file_map(), steady=steady)
    folder.mkdir(exist_ok=True)
    write_whole(folder / NAME, text)
    faces = list(dict.fromkeys(still.face for still in session.stills if still.face is not None))
    rows: list[tuple[str, Cell]] = [
        ("recordings", len(session.records)),
        ("still phases", len(session.stills)),
        ("faces", ", ".join(faces) or "not all six, free poses"),
        ("turns by a known angle", len(session.turns)),
        ("steady turns whose rate must be entered", len(steady)),
        (f"gravity (m/s2, {session.gravity_source})", session.gravity_m_s2),
    ]
    return Report(
        title="A session of bare recordings",
        answer=f"{len(session.stills)} still phases and {len(session.turns)} turns by a known angle were found.",
        tables=[Table(title="Content", columns=("what", "value"), rows=rows, form=".5f")],
        written=[folder / NAME],
        next_command=("calibrate", folder, "-o", "calibration.json"),
    )
