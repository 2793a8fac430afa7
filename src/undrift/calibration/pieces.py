"""What recordings hold, piece by piece: stills, faces, turns; and of these what a calibration used, and why not the others."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.calibration.checks import stuck_windows
from undrift.calibration.observe import CalibrateSettings, at_one_temperature, in_one_unit, labelled, saturated_turns
from undrift.findings import told_apart
from undrift.model import Calibration
from undrift.record import Record, Session, Still, Turn
from undrift.segments import LeftOut, StillSearch, find_poses, find_turns, left_out
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

_SATURATED = "gyroscope saturated"
_TURNED_DEG = 5.0  # a move by less is no turn worth a mark


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A stretch of one recording."""

    kind: Literal["still", "turn"]
    start: int  # sample
    stop: int  # sample after the last
    recording: int
    label: str = ""  # face, axis and angle, axis and rate
    why: str = ""  # Why it was left out; "" for what was used or found


def pieces_of(
    session: Session, settings: CalibrateSettings = CalibrateSettings(), made: Calibration | None = None
) -> tuple[tuple[Piece, ...], str]:
    """Return the pieces of a session, stated or found, in order of time, and why there is no still.

    With the calibration that was made of it, pieces that it did not use say why.
    """
    session = in_one_unit(session)
    stills, out, reason = session.stills, list[Piece](), ""
    if not stills:
        searches = find_poses(session.records, settings.still)
        stills = labelled(session, tuple(still for search in searches for still in search.stills))
        reason = next((search.reason for search in searches if search.reason), "")
        out = [
            piece
            for number, pair in enumerate(zip(session.records, searches, strict=True))
            for piece in _left(*pair, number)
        ]
    here = session if made is None else at_one_temperature(session)[0]
    stated: tuple[Still | Turn, ...] = (*here.stills, *here.turns)
    kept = {(piece.recording, piece.start, piece.stop) for piece in stated}
    found = [_of_still(still, made, stated=bool(session.stills)) for still in stills]
    spoilt = () if made is None else saturated_turns(session, settings.settle_s)
    found += [
        replace(_of_turn(turn, made), why=_SATURATED) if k in spoilt else _of_turn(turn, made)
        for k, turn in enumerate(session.turns)
    ]
    found = [
        replace(piece, why="another temperature")
        if (session.stills or piece.kind == "turn") and (piece.recording, piece.start, piece.stop) not in kept
        else piece
        for piece in found
    ]
    if not session.turns:
        for number, record in enumerate(session.records):
            own = [still for still in stills if still.recording == number]
            found += [] if record.gyro is None else list(_turns(record, own, number, made))
    return tuple(sorted((*found, *out), key=lambda piece: (piece.recording, piece.start))), reason if not stills else ""


def _left(record: Record, search: StillSearch, number: int) -> Iterator[Piece]:
    for one in left_out(record, search):
        yield Piece(kind="still", start=one.start, stop=one.stop, recording=number, why=_why(one))


def _why(one: LeftOut) -> str:
    if one.why == "too short":
        return f"too short: {one.value:.2g} s at rest, wanted {one.limit:g} s"
    if one.why == "turning":
        return f"in a steady turn: {one.value:.3g} {one.unit}"
    value, limit = told_apart(one.value, ".3g", one.limit), told_apart(one.limit, ".3g", one.value)
    return f"too restless: {value} {one.unit} rms, {'no gap above it' if np.isnan(one.limit) else f'limit {limit}'}"


def _of_still(still: Still, made: Calibration | None, *, stated: bool) -> Piece:
    six = made is not None and made.accel is not None and made.accel.method.startswith("six-face")
    why = "no face up" if six and still.face is None else ""
    return Piece(
        kind="still", start=still.start, stop=still.stop, recording=still.recording, label=still.face or "", why=why
    )


def _method(made: Calibration) -> str:
    return "none" if made.gyro is None else made.gyro.method.partition("/")[0]


def _of_turn(turn: Turn, made: Calibration | None) -> Piece:
    label: str = turn.axis or ""
    why = ""
    if turn.turn_rate is not None:
        label = f"{label} {turn.turn_rate / RADIAN_PER_DEGREE:.0f} deg/s"
    elif turn.angle is not None:
        label = f"{label} {turn.angle / RADIAN_PER_DEGREE:.0f} deg"
    if made is not None:
        method = _method(made)
        if method == "rate-table" and turn.turn_rate is None:
            why = "no stated rate"
        elif method == "known-rotation" and turn.angle is None:
            why = "no stated angle"
        elif method not in ("rate-table", "known-rotation"):
            why = "not needed"
    return Piece(kind="turn", start=turn.start, stop=turn.stop, recording=turn.recording, label=label, why=why)


def _turns(record: Record, stills: list[Still], number: int, made: Calibration | None) -> Iterator[Piece]:
    """Return the steady turns and the moves between stills that the gyroscope shows."""
    found, method = find_turns(record, stills), "" if made is None else _method(made)
    known = is_physical(record.gyro_unit)
    factor = si_factor(record.gyro_unit, "rate") / RADIAN_PER_DEGREE if known else 1.0
    for turn, rate in zip(found.plateaus, found.plateau_rate * factor, strict=True):
        inside = any(turn.start < other.stop and other.start < turn.stop for other in found.rotations)
        if inside and method in ("", "multi-position", "known-rotation"):
            continue  # part of a move, which is drawn
        unit = "deg/s" if known else record.gyro_unit
        label = f"{turn.axis} {rate['xyz'.index(turn.axis or 'x')]:.0f} {unit}"
        why = "no stated rate" if method else ""
        yield Piece(kind="turn", start=turn.start, stop=turn.stop, recording=number, label=label, why=why)
    windows = () if record.gyro is None else tuple(record.gyro[turn.start : turn.stop] for turn in found.rotations)
    stuck = stuck_windows(windows)
    for turn, angle, spoilt in zip(found.rotations, found.rotation_angle * factor, stuck, strict=True):
        size = float(np.linalg.norm(angle))
        if known and size < _TURNED_DEG:
            continue
        along = angle[np.argmax(np.abs(angle))]
        label = f"{turn.axis} {along:.0f} deg" if turn.axis and known else turn.axis or ""
        why = "" if method in ("", "multi-position") or _whole(method, turn, along) else "not a full turn"
        why = _SATURATED if spoilt and method else why
        yield Piece(kind="turn", start=turn.start, stop=turn.stop, recording=number, label=label, why=why)


def _whole(method: str, turn: Turn, along_deg: float) -> bool:
    """Tell whether a fit by known rotations took a move for a full turn."""
    return method == "known-rotation" and turn.axis is not None and abs(abs(along_deg) / 360.0 - 1.0) < 0.1
