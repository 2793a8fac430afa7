"""Text for a person to check and edit: the map that a foreign file seems to need, and a session.toml of detected
phases.

If no name contains the unit of the gyroscopes, gravity determines it. Its direction g turns in the sensor as dg/dt = -w
x g. Over 0.2 s, the readings in the right unit (rad/s or deg/s) turn the mean of the first accelerations into the mean
of the last. Readers never guess. The map contains each proposal and its reason.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from undrift.base.codec import toml_block, toml_text
from undrift.errors import InputError
from undrift.frames import quaternion_of, rotate
from undrift.io.column_map import map_of_tree
from undrift.io.formats import read_record
from undrift.io.guess import MapProposal
from undrift.io.inspect import Description
from undrift.io.session import HeadEntry, piece_entry, piece_toml
from undrift.record import FileMap, Record, Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE

_WINDOW_S = 0.2
_MOVED = (10.0 * RADIAN_PER_DEGREE, 90.0 * RADIAN_PER_DEGREE)  # of gravity in a window: the device turned
_LEAST_WINDOWS = 20
_CLEARLY = 0.5  # largest ratio of the errors of gravity in the right unit and in another


def map_text(
    found: Description, *, sample_rate_hz: float | None = None, units: Mapping[str, str | None] | None = None
) -> str:
    """Return the text of the map that a description proposes, each unit with its reason, or "?" for an unknown unit."""
    proposal = found.proposal
    if proposal is None:
        raise InputError(
            f"{found.path}: expected a table that needs a map, got {found.kind} ({found.format}): {found.summary}. "
            f"Omit "
            "--write-map."
        )
    if proposal.rate == "?":
        if sample_rate_hz is None:
            raise InputError(f"{found.path}: a table without time needs its sample rate. Add `sample_rate_hz`.")
        proposal = replace(proposal, rate=f"{sample_rate_hz:g}")
    given = {key: unit for key, unit in (units or {}).items() if unit is not None and key in proposal.units}
    why = dict.fromkeys(proposal.units, "by the name of its column")
    why |= {key: f"proposed by {reason}" for key, reason in proposal.reasons.items()}
    known = proposal.units | given
    unsure = "gyro" not in given and (known.get("gyro") == "?" or "gyro" in proposal.reasons)
    # gravity is a better witness than the size of the readings
    if unsure and (turned := _gyro_by_gravity(found.path, replace(proposal, units=known))):
        known["gyro"], why["gyro"] = turned
    why |= dict.fromkeys(given, "as given")
    why |= {key: "not determined by name or readings: enter the unit" for key, unit in known.items() if unit == "?"}
    head = [f"# How {Path(found.path).name} is read. The keys are explained in docs/maps.md. Check each unit."]
    head += [f"# {key}: {unit}, {why[key]}" for key, unit in known.items()]
    return "\n".join([*head, *replace(proposal, units=known, reasons={}).lines()]) + "\n"


def _gyro_by_gravity(path: str, proposal: MapProposal) -> tuple[str, str] | None:
    """Return the unit of the gyroscopes determined from gravity, and the reason, or None if it is not observable."""
    time = {"time": proposal.units["time"]} if "time" in proposal.units else {}
    if "?" in time.values():
        return None
    needed = {key: value for key, value in proposal.columns.items() if key in ("time", "gyro", "accel")}
    counts = {key: "count" for key in ("gyro", "accel") if key in needed}
    rate = {"sample_rate_hz": float(proposal.rate.split()[0])} if proposal.rate else {}
    try:
        how = map_of_tree({"columns": needed, "units": time | counts, "gaps": "keep"} | rate | proposal.layout)
        turned = gyro_unit_of(read_record(path, how))
    except InputError:  # the map names the error when it is used
        return None
    if turned is None:
        return None
    unit, moves, miss_deg, other_deg = turned
    return unit, (
        f"proposed: it turns gravity as the accelerometers read it, to {miss_deg:.1f} deg (median of {moves} moves of "
        f"{_WINDOW_S:g} s); {'dps' if unit == 'rad/s' else 'rad/s'} misses it by {other_deg:.1f} deg"
    )


def gyro_unit_of(record: Record) -> tuple[str, int, float, float] | None:
    """Return the unit (rad/s or dps), the number of moves used, and the gravity error with each unit, deg.

    Return None if the motion does not determine the unit.
    """
    size = max(4, round(_WINDOW_S * record.sample_rate_hz))
    count = len(record) // size
    if record.gyro is None or record.accel is None or count < _LEAST_WINDOWS:
        return None
    gyro, accel = (values[: count * size].reshape(count, size, 3) for values in (record.gyro, record.accel))
    quarter = max(1, size // 4)
    means = (accel[:, cut].mean(axis=1) for cut in (slice(None, quarter), slice(-quarter, None)))
    first, last = (mean / np.linalg.norm(mean, axis=1, keepdims=True) for mean in means)
    moved = np.arccos(np.clip((first * last).sum(axis=1), -1.0, 1.0))
    usable = (moved > _MOVED[0]) & (moved < _MOVED[1])
    if usable.sum() < _LEAST_WINDOWS:
        return None
    rotation = (
        (gyro - np.nanmedian(record.gyro, axis=0)).mean(axis=1)[usable] * (size - quarter) / record.sample_rate_hz
    )
    misses = {}
    for unit, factor in (("rad/s", 1.0), ("dps", RADIAN_PER_DEGREE)):
        expected = rotate(quaternion_of(-factor * rotation), first[usable])
        angle = np.arccos(np.clip((expected * last[usable]).sum(axis=1), -1.0, 1.0))
        misses[unit] = float(np.nanmedian(angle)) / RADIAN_PER_DEGREE
    best, other = sorted(misses, key=lambda unit: misses[unit])
    if not misses[best] < _CLEARLY * misses[other]:
        return None
    return best, int(usable.sum()), misses[best], misses[other]


# ---- session.toml of bare recordings


def session_text(
    session: Session,
    files: Sequence[Path],
    folder: Path,
    *,
    file_map: FileMap | None,
    steady: Sequence[Turn] = (),
) -> str:
    """Return the session.toml of recordings for a folder. Steady turns are written as comments, because their rate is
    unknown.
    """
    width = len(files) // len(session.records)
    standard = session.gravity_source == "standard"
    head = HeadEntry(kind=session.kind, serial=session.serial, gravity_m_s2=None if standard else session.gravity_m_s2)
    blocks = [
        "# Written by undrift info --write-session from the recordings. Correct anything that is wrong.\n"
        + toml_text({"session": head.model_dump()})
    ]
    if standard:
        blocks[0] += (
            "# gravity_m_s2 = ?   # missing: standard gravity is assumed. Enter yours, or latitude_deg and height_m\n"
        )
    map_keys = {} if file_map is None else json.loads(file_map.text)
    for number in range(len(session.records)):
        names = [os.path.relpath(file, folder) for file in files[number * width : (number + 1) * width]]
        blocks.append(toml_block("recording", {"file": names[0] if width == 1 else names, **map_keys}))
    times = [record.time for record in session.records]
    pieces: list[Still | Turn] = [*session.stills, *session.turns]
    blocks += [piece_toml(piece_entry(piece, times[piece.recording])) for piece in pieces]
    for turn in steady:
        lines = piece_toml(piece_entry(turn, times[turn.recording])).splitlines()
        marked = "".join(f"# {line}\n" for line in [*lines, "turn_rate_dps = ?"])
        blocks.append("# a steady turn: state its achieved rate and take the marks away\n" + marked)
    return "\n".join(blocks)
