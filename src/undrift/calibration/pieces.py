"""Stills, faces and turns of a session, and why a calibration did not use one."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.calibration.plausibility import stuck_windows
from undrift.calibration.quality import saturated_turns
from undrift.calibration.session import FULL_TURN, FULL_TURN_TOLERANCE, Observed, at_one_temperature, look
from undrift.calibration.settings import CalibrateSettings
from undrift.model import Calibration, TriadModel
from undrift.record import Session, Still, Turn
from undrift.segments import LeftOut, left_out
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

NOT_USED, SATURATED = "not used", "gyroscope saturated"
MIN_MOVE_DEG, MIN_MOVE_SHARE = 5.0, 0.02  # smallest move that is drawn, or for counts its share of the largest move


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A stretch of a recording."""

    kind: Literal["still", "turn"]
    start: int  # sample
    stop: int  # sample after the last
    recording: int
    label: str = ""  # face, axis and angle, axis and rate
    why: str = ""  # why it was left out, or "" if it was used or detected


def pieces_of(
    session: Session,
    settings: CalibrateSettings = CalibrateSettings(),
    calibration: Calibration | None = None,
    observed: Observed | None = None,
) -> tuple[tuple[Piece, ...], str]:
    """Return the pieces of a session in order of time, and the reason if there is no still.

    With ``calibration``, unused pieces contain a reason. ``observed`` saves a second search.
    """
    observed = look(session, settings) if observed is None else observed
    stills = session.stills or observed.stills
    selected = session if calibration is None else at_one_temperature(session)[0]
    accel, gyro = ("", "") if calibration is None else (_method(calibration.accel), _method(calibration.gyro))
    pieces = [
        *(
            _list_given_turns(session, selected, gyro, observed.settings)
            if session.turns
            else _list_detected_turns(observed, gyro)
        )
    ]
    for still in stills:
        unused = (session.stills and still not in selected.stills) or (accel == "six-face" and still.face is None)
        pieces.append(_piece(still, still.recording, str(still.face or ""), NOT_USED if unused else ""))
    for number, (record, search) in enumerate(zip(observed.session.records, observed.searches, strict=False)):
        pieces += [_piece(pause, number, why=pause.why) for pause in left_out(record, search)]
    reason = "" if stills else next((search.reason for search in observed.searches if search.reason), "")
    return tuple(sorted(pieces, key=lambda piece: (piece.recording, piece.start))), reason


def _piece(piece: Still | Turn | LeftOut, recording: int, label: str = "", why: str = "") -> Piece:
    kind: Literal["still", "turn"] = "turn" if isinstance(piece, Turn) else "still"
    return Piece(kind=kind, start=piece.start, stop=piece.stop, recording=recording, label=label, why=why)


def _method(model: TriadModel | None) -> str:
    return "none" if model is None else model.method.partition("/")[0]


def _is_used(turn: Turn, method: str) -> bool:
    """Return True if a method uses a turn with this rate or angle, or if no method is given."""
    return method == "" or {"rate-table": turn.turn_rate, "known-rotation": turn.angle}.get(method) is not None


def _list_given_turns(session: Session, selected: Session, method: str, settings: CalibrateSettings) -> Iterator[Piece]:
    saturated = saturated_turns(session, settings.settle_s) if method else ()
    for number, turn in enumerate(session.turns):
        label = str(turn.axis or "")
        if turn.turn_rate is not None:
            label = f"{label} {turn.turn_rate / RADIAN_PER_DEGREE:.0f} deg/s"
        elif turn.angle is not None:
            label = f"{label} {turn.angle / RADIAN_PER_DEGREE:.0f} deg"
        why = "" if turn in selected.turns and _is_used(turn, method) else NOT_USED
        yield _piece(turn, turn.recording, label, SATURATED if number in saturated else why)


def _list_detected_turns(observed: Observed, method: str) -> Iterator[Piece]:
    """Yield the steady turns and the moves between stills, as measured by the gyroscopes."""
    for number, record, search in observed.turn_searches:
        physical = is_physical(record.gyro_unit)
        factor = si_factor(record.gyro_unit, "rate") / RADIAN_PER_DEGREE if physical else 1.0
        for turn, rate in zip(search.plateaus, search.plateau_rate * factor, strict=True):
            rotates = any(turn.start < move.stop and move.start < turn.stop for move in search.rotations)
            if not rotates or method not in ("", "multi-position", "known-rotation"):  # a move is drawn as a whole
                label = (
                    f"{turn.axis} {rate['xyz'.index(turn.axis or 'x')]:.0f} {'deg/s' if physical else record.gyro_unit}"
                )
                yield _piece(turn, number, label, NOT_USED if method else "")
        stuck = stuck_windows([np.asarray(record.gyro)[turn.start : turn.stop] for turn in search.rotations])
        sizes = np.linalg.norm(search.rotation_angle, axis=1) * factor
        large_moves = sizes >= (MIN_MOVE_DEG if physical else MIN_MOVE_SHARE * sizes.max(initial=0.0))
        for k in np.flatnonzero(large_moves):
            turn, angle = search.rotations[k], search.rotation_angle[k] * factor
            main_angle = angle[np.argmax(np.abs(angle))]
            full_turn = turn.axis is not None and abs(abs(main_angle) / 360.0 - 1.0) < FULL_TURN_TOLERANCE
            used = method == "multi-position" or _is_used(replace(turn, angle=FULL_TURN if full_turn else None), method)
            label = f"{turn.axis} {main_angle:.0f} deg" if turn.axis and physical else turn.axis or ""
            yield _piece(turn, number, label, SATURATED if stuck[k] and method else "" if used else NOT_USED)
