"""Stills, faces and turns of a session, and why each was or was not used."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.calibration.plausibility import stuck_windows
from undrift.calibration.quality import saturated_turns
from undrift.calibration.session import Observed, at_one_temperature, in_one_unit, look
from undrift.calibration.settings import CalibrateSettings
from undrift.model import Calibration
from undrift.record import Record, Session, Still, Turn
from undrift.segments import TurnSearch, left_out
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

SATURATED = "gyroscope saturated"
MIN_MOVE_DEG, MIN_MOVE_SHARE = 5.0, 0.02  # a smaller move is not drawn; in counts: this share of the largest
WHOLE_TURN_SHARE = 0.1  # a move this near to a full turn is one


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A stretch of one recording."""

    kind: Literal["still", "turn"]
    start: int  # sample
    stop: int  # sample after the last
    recording: int
    label: str = ""  # face, axis and angle, axis and rate
    why: str = ""  # reason why it was left out; "" for what was used or found


def pieces_of(
    session: Session,
    settings: CalibrateSettings = CalibrateSettings(),
    calibration: Calibration | None = None,
    seen: Observed | None = None,
) -> tuple[tuple[Piece, ...], str]:
    """Return the pieces of a session, stated or found, in order of time, and why there is no still.

    With the calibration that was made of it, pieces that it did not use say why. ``seen`` saves a second search.
    """
    seen = look(session, settings) if seen is None else seen
    session = in_one_unit(session)
    stills = session.stills or seen.stills
    pieces = [_still_piece(still, calibration) for still in stills]
    if session.turns:
        saturated = () if calibration is None else saturated_turns(session, settings.settle_s)
        turns = [_turn_piece(turn, calibration) for turn in session.turns]
        pieces += [replace(piece, why=SATURATED) if k in saturated else piece for k, piece in enumerate(turns)]
    if calibration is not None:
        kept = at_one_temperature(session)[0]
        stretches: list[Still | Turn] = [*kept.stills, *kept.turns]
        same_temperature = {(stretch.recording, stretch.start, stretch.stop) for stretch in stretches}
        pieces = [
            replace(piece, why="another temperature")
            if (session.stills or piece.kind == "turn")
            and (piece.recording, piece.start, piece.stop) not in same_temperature
            else piece
            for piece in pieces
        ]
    if not session.turns:
        for number, record, search in seen.turn_searches():
            pieces += _found_turns(number, record, search, calibration)
    for number, (record, still_search) in enumerate(zip(seen.session.records, seen.searches, strict=False)):
        pieces += [
            Piece(kind="still", start=pause.start, stop=pause.stop, recording=number, why=pause.why)
            for pause in left_out(record, still_search)
        ]
    reason = "" if stills else next((search.reason for search in seen.searches if search.reason), "")
    return tuple(sorted(pieces, key=lambda piece: (piece.recording, piece.start))), reason


def _still_piece(still: Still, calibration: Calibration | None) -> Piece:
    accel = None if calibration is None else calibration.accel
    why = "no face up" if accel is not None and accel.method.startswith("six-face") and still.face is None else ""
    return Piece(
        kind="still", start=still.start, stop=still.stop, recording=still.recording, label=still.face or "", why=why
    )


def _gyro_method(calibration: Calibration | None) -> str | None:
    """Return the method of the gyroscopes, "none" without one, and None without a calibration."""
    if calibration is None:
        return None
    return "none" if calibration.gyro is None else calibration.gyro.method.partition("/")[0]


def _turn_piece(turn: Turn, calibration: Calibration | None) -> Piece:
    label: str = turn.axis or ""
    if turn.turn_rate is not None:
        label = f"{label} {turn.turn_rate / RADIAN_PER_DEGREE:.0f} deg/s"
    elif turn.angle is not None:
        label = f"{label} {turn.angle / RADIAN_PER_DEGREE:.0f} deg"
    method = _gyro_method(calibration)
    if method == "rate-table":
        why = "no stated rate" if turn.turn_rate is None else ""
    elif method == "known-rotation":
        why = "no stated angle" if turn.angle is None else ""
    else:
        why = "" if method is None else "not needed"
    return Piece(kind="turn", start=turn.start, stop=turn.stop, recording=turn.recording, label=label, why=why)


def _found_turns(number: int, record: Record, search: TurnSearch, calibration: Calibration | None) -> Iterator[Piece]:
    """Yield the steady turns and the moves between stills that the gyroscope shows."""
    method, physical = _gyro_method(calibration), is_physical(record.gyro_unit)
    factor = si_factor(record.gyro_unit, "rate") / RADIAN_PER_DEGREE if physical else 1.0
    for turn, rate in zip(search.plateaus, search.plateau_rate * factor, strict=True):
        inside = any(turn.start < other.stop and other.start < turn.stop for other in search.rotations)
        if inside and method in (None, "multi-position", "known-rotation"):
            continue  # part of a move, which is drawn
        label = f"{turn.axis} {rate['xyz'.index(turn.axis or 'x')]:.0f} {'deg/s' if physical else record.gyro_unit}"
        why = "" if method is None else "no stated rate"
        yield Piece(kind="turn", start=turn.start, stop=turn.stop, recording=number, label=label, why=why)
    angles = search.rotation_angle * factor
    sizes = np.linalg.norm(angles, axis=1)
    least = MIN_MOVE_DEG if physical else MIN_MOVE_SHARE * sizes.max(initial=0.0)
    saturated = stuck_windows([np.asarray(record.gyro)[turn.start : turn.stop] for turn in search.rotations])
    for turn, angle, size, stuck in zip(search.rotations, angles, sizes, saturated, strict=True):
        if size < least:
            continue
        along = angle[np.argmax(np.abs(angle))]
        label = f"{turn.axis} {along:.0f} deg" if turn.axis and physical else turn.axis or ""
        whole = turn.axis is not None and abs(abs(along) / 360.0 - 1.0) < WHOLE_TURN_SHARE
        used = method in (None, "multi-position") or (method == "known-rotation" and whole)
        why = SATURATED if stuck and method is not None else "" if used else "not a full turn"
        yield Piece(kind="turn", start=turn.start, stop=turn.stop, recording=number, label=label, why=why)
