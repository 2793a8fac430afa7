"""Stills, faces and turns of a session, and why a calibration did not use one."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.calibration.plausibility import stuck_windows
from undrift.calibration.quality import saturated_turns
from undrift.calibration.session import Observed, at_one_temperature, look
from undrift.calibration.settings import CalibrateSettings
from undrift.model import Calibration, TriadModel
from undrift.record import Session, Still, Turn
from undrift.segments import LeftOut, left_out
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
    stills = session.stills or seen.stills
    pieces = [*_stated(seen, session, calibration)]
    if not session.turns:
        pieces += _found_turns(seen, calibration)
    for number, (record, search) in enumerate(zip(seen.session.records, seen.searches, strict=False)):
        pieces += [_piece(pause, number, why=pause.why) for pause in left_out(record, search)]
    reason = "" if stills else next((search.reason for search in seen.searches if search.reason), "")
    return tuple(sorted(pieces, key=lambda piece: (piece.recording, piece.start))), reason


def _piece(piece: Still | Turn | LeftOut, recording: int, label: str = "", why: str = "") -> Piece:
    kind: Literal["still", "turn"] = "turn" if isinstance(piece, Turn) else "still"
    return Piece(kind=kind, start=piece.start, stop=piece.stop, recording=recording, label=label, why=why)


def _method(model: TriadModel | None) -> str:
    return "none" if model is None else model.method.partition("/")[0]


def _stated(seen: Observed, session: Session, calibration: Calibration | None) -> Iterator[Piece]:
    """Yield the stills, stated or found, and the stated turns."""
    kept = at_one_temperature(session)[0]
    saturated = () if calibration is None else saturated_turns(session, seen.settings.settle_s)
    for still in session.stills or seen.stills:
        why = ""
        if calibration is not None and session.stills and still not in kept.stills:
            why = "another temperature"
        elif calibration is not None and _method(calibration.accel) == "six-face" and still.face is None:
            why = "no face up"
        yield _piece(still, still.recording, str(still.face or ""), why)
    for number, turn in enumerate(session.turns):
        method = "" if calibration is None else _method(calibration.gyro)
        label, why = str(turn.axis or ""), ""
        if turn.turn_rate is not None:
            label = f"{label} {turn.turn_rate / RADIAN_PER_DEGREE:.0f} deg/s"
        elif turn.angle is not None:
            label = f"{label} {turn.angle / RADIAN_PER_DEGREE:.0f} deg"
        if calibration is not None and turn not in kept.turns:
            why = "another temperature"
        elif number in saturated:
            why = SATURATED
        elif method == "rate-table":
            why = "no stated rate" if turn.turn_rate is None else ""
        elif method == "known-rotation":
            why = "no stated angle" if turn.angle is None else ""
        elif method:
            why = "not needed"
        yield _piece(turn, turn.recording, label, why)


def _found_turns(seen: Observed, calibration: Calibration | None) -> Iterator[Piece]:
    """Yield the steady turns and the moves between stills that the gyroscopes show."""
    method = "" if calibration is None else _method(calibration.gyro)
    for number, record, search in seen.turn_searches():
        physical = is_physical(record.gyro_unit)
        factor = si_factor(record.gyro_unit, "rate") / RADIAN_PER_DEGREE if physical else 1.0
        for turn, rate in zip(search.plateaus, search.plateau_rate * factor, strict=True):
            in_move = any(turn.start < move.stop and move.start < turn.stop for move in search.rotations)
            if not in_move or method not in ("", "multi-position", "known-rotation"):  # a move is drawn as a whole
                size = rate["xyz".index(turn.axis or "x")]
                label = f"{turn.axis} {size:.0f} {'deg/s' if physical else record.gyro_unit}"
                yield _piece(turn, number, label, "no stated rate" if method else "")
        sizes = np.linalg.norm(search.rotation_angle, axis=1) * factor
        stuck = stuck_windows([np.asarray(record.gyro)[turn.start : turn.stop] for turn in search.rotations])
        least = MIN_MOVE_DEG if physical else MIN_MOVE_SHARE * sizes.max(initial=0.0)
        for turn, angle, size, saturated in zip(search.rotations, search.rotation_angle, sizes, stuck, strict=True):
            if size < least:
                continue
            along = angle[np.argmax(np.abs(angle))] * factor
            whole = turn.axis is not None and abs(abs(along) / 360.0 - 1.0) < WHOLE_TURN_SHARE
            used = method in ("", "multi-position") or (method == "known-rotation" and whole)
            label = f"{turn.axis} {along:.0f} deg" if turn.axis and physical else turn.axis or ""
            why = SATURATED if saturated and method else "" if used else "not a full turn"
            yield _piece(turn, number, label, why)
