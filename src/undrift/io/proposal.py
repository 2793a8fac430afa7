"""Text for a person to check and edit: the map that a foreign file seems to need, and a session.toml of detected
phases.

Readers never guess. The map contains each proposal and its reason.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from undrift.base.codec import toml_block, toml_text
from undrift.errors import InputError
from undrift.io.inspect import Description
from undrift.io.session import HeadEntry, piece_entry, piece_toml
from undrift.record import FileMap, Session, Still, Turn


def map_text(
    found: Description, *, sample_rate_hz: float | None = None, units: Mapping[str, str | None] | None = None
) -> str:
    """Return the text of the map that a description proposes, each unit with its reason, or "?" for an unknown unit."""
    proposal = found.proposal
    if proposal is None:
        raise InputError(
            f"{found.path}: expected a table that needs a map, got {found.kind} ({found.format}): {found.summary}. "
            "Omit --write-map."
        )
    if proposal.rate == "?":
        if sample_rate_hz is None:
            raise InputError(f"{found.path}: a table without time needs its sample rate. Add `sample_rate_hz`.")
        proposal = replace(proposal, rate=f"{sample_rate_hz:g}")
    given = {key: unit for key, unit in (units or {}).items() if unit is not None and key in proposal.units}
    why = dict.fromkeys(proposal.units, "by the name of its column")
    why |= {key: f"proposed by {reason}" for key, reason in proposal.reasons.items()}
    known = proposal.units | given
    why |= dict.fromkeys(given, "as given")
    why |= {key: "not determined by name or readings: enter the unit" for key, unit in known.items() if unit == "?"}
    head = [f"# How {Path(found.path).name} is read. The keys are explained in docs/maps.md. Check each unit."]
    head += [f"# {key}: {unit}, {why[key]}" for key, unit in known.items()]
    return "\n".join([*head, *replace(proposal, units=known, reasons={}).lines()]) + "\n"


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
