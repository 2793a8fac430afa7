"""The content of a file, for the step Check: its description, its readings with rests and turns, and the map it needs."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.pieces import pieces_of
from undrift.calibration.session import look
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.triads import find_disagreement
from undrift.commands.files import Opening
from undrift.errors import InputError
from undrift.findings import most_consequential_first
from undrift.io.inspect import Description, describe
from undrift.io.session import read_session
from undrift.io.store import read_calibration
from undrift.record import Session
from undrift.report.calibration import calibration_report
from undrift.report.report import Report
from undrift.screen import progress
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

MOST_BLOCKS = 500  # of a recording that is drawn: the least and the greatest reading of each
SHOWN: tuple[tuple[str, Quantity, str, float], ...] = (
    ("gyro", "rate", "deg/s", RADIAN_PER_DEGREE),
    ("accel", "accel", "g", STANDARD_GRAVITY),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """What a file contains."""

    kind: str
    summary: str
    serial: str
    columns: tuple[str, ...]
    missing: str  # what a reader asks for: sample_rate_hz, sensor, or ""
    findings: list[tuple[str, str, str]]  # level, sentence, action
    draft: dict[str, Any] = field(default_factory=dict)  # map that a table of foreign names seems to need
    reasons: dict[str, str] = field(default_factory=dict)  # why a unit is proposed
    trace: dict[str, Any] = field(default_factory=dict)  # readings of a recording
    report: Report | None = None  # of a calibration


def look_at(path: Path, opening: Opening) -> Looked:
    """Return the content of a file."""
    progress(f"reading {path.name}", 0.1)
    description = describe(path, opening.how(path))
    progress("looking for rests and turns", 0.6)
    session = description.session
    records = () if session is None else session.records
    findings = [*description.findings, *filter(None, map(find_disagreement, records))]
    model = read_calibration(path) if description.kind == "calibration" else None
    missing = [item.values["missing"] for item in findings if item.code == "recording.not_read"]
    return Looked(
        kind=description.kind,
        summary="readings without time"
        if "sample_rate_hz" in missing
        else description.summary.partition("; needs a map")[0],
        serial=records[0].device if records else "" if model is None else model.device,
        columns=description.columns,
        missing=str(missing[0]) if missing else "",
        findings=[
            (item.level, item.sentence, item.action)
            for item in most_consequential_first(findings)
            if item.code not in ("recording.not_read", "recording.how_read")
        ],
        draft=_draft_of(description),
        reasons={} if description.proposal is None else dict(description.proposal.reasons),
        trace={} if session is None or description.kind != "recording" else trace_of(session),
        report=None if model is None else calibration_report(model),
    )


def assumes_gravity(session: Path) -> bool:
    """Return whether a session does not state local gravity."""
    return read_session(session).gravity_source == "standard"


def _draft_of(description: Description) -> dict[str, Any]:
    if description.kind != "table" or description.proposal is None:
        return {}
    return tomllib.loads("\n".join(description.example).replace("= ?", '= "?"'))


def trace_of(session: Session) -> dict[str, Any]:
    """Return what the page draws of a recording: time, readings, rests and turns, and the mean readings at rest.

    Times are in s since the first sample. Readings are [x, y, z] of each sensor, in deg/s and g if the recording has
    physical units.
    """
    try:
        observed = look(session, CalibrateSettings())
    except InputError:  # too short to look for rests
        return {}
    record, pieces = observed.session.records[0], pieces_of(observed)
    time = record.time - record.time[0]
    trace: dict[str, Any] = {"time": _envelope(time[:, None])[0], "readings": {}, "units": {}, "at_rest": {}}
    for name, quantity, unit, size in SHOWN:
        if (values := getattr(record, name)) is None:
            continue
        trace["units"][name] = raw_unit = getattr(record, f"{name}_unit")
        if is_physical(raw_unit):
            values, trace["units"][name] = values * (si_factor(raw_unit, quantity) / size), unit
        trace["readings"][name] = _envelope(values)
        if means := [np.linalg.norm(values[still.start : still.stop].mean(axis=0)) for still in observed.stills]:
            trace["at_rest"][name] = float(np.median(means))
    spans = [(piece.kind, piece.label, float(time[piece.start]), float(time[piece.stop - 1])) for piece in pieces]
    return trace | {"stretches": spans}


def _envelope(values: FloatArray) -> list[list[float | None]]:
    """Return the least and greatest value of each block of samples per column, or all samples of a short recording."""
    width = -(-len(values) // MOST_BLOCKS)
    if width > 2:
        starts = np.arange(0, len(values), width)
        ends = np.stack((np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)), axis=1)
        falling = values[starts] > values[np.append(starts[1:], len(values)) - 1]
        values = np.where(falling[:, None], ends[:, ::-1], ends).reshape(-1, values.shape[1])
    return [[float(f"{value:.5g}") if np.isfinite(value) else None for value in column] for column in values.T]


def proof_of(trace: dict[str, Any]) -> str:
    """Return the readings at rest in words. If columns and units are right, gravity is 1 g and rates are zero."""
    rest, units = trace["at_rest"], trace["units"]
    if not rest:
        return "No rest was found, so nothing proves columns and units."
    names = {"accel": "acceleration", "gyro": "turn rate"}
    text = "At rest: " + ", ".join(f"{name} {rest[key]:.2f} {units[key]}" for key, name in names.items() if key in rest)
    far = units.get("accel") == "g" and abs(rest.get("accel", 1.0) - 1.0) > 0.05
    return text + (". Gravity is 1.00 g: check the columns and the unit." if far else ".")


def found_in(trace: dict[str, Any]) -> str:
    """Return the length of a recording, and its rests and turns, in words."""
    stretches = trace["stretches"]
    rests, turns = (sum(kind == name for kind, *_ in stretches) for name in ("still", "turn"))
    faces = len({label for kind, label, *_ in stretches if kind == "still" and label})
    return f"{trace['time'][-1]:.1f} s: {rests} rests on {faces} faces, {turns} turns."
