"""Stills, faces and turns of a session for its drawing, with the reason if a calibration did not use one."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.calibration.plausibility import stuck_windows
from undrift.calibration.quality import saturated_turns
from undrift.calibration.session import Observed
from undrift.model import Calibration, TriadModel
from undrift.record import Still, Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

NOT_USED, SATURATED = "not used", "gyroscope saturated"
MIN_MOVE_SHARE = 0.02  # smallest move that is drawn, relative to the largest move


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A stretch of a recording."""

    kind: Literal["still", "turn"]
    start: int  # sample
    stop: int  # sample after the last
    recording: int
    label: str = ""  # face, axis and angle, axis and rate
    why: str = ""  # reason why it was left out, or "" if it was used or detected


def pieces_of(observed: Observed, calibration: Calibration | None = None) -> tuple[Piece, ...]:
    """Return the pieces of a session in order of time. With ``calibration``, unused pieces contain a reason."""
    accel, gyro = ("", "") if calibration is None else (_method(calibration.accel), _method(calibration.gyro))
    pieces = list(_given_turns(observed, gyro) if observed.session.turns else _moves(observed, gyro))
    for still in observed.stills:
        why = NOT_USED if accel == "six-face" and still.face is None else ""
        pieces.append(_piece("still", still, str(still.face or ""), why))
    return tuple(sorted(pieces, key=lambda piece: (piece.recording, piece.start)))


def _piece(kind: Literal["still", "turn"], piece: Still | Turn, label: str, why: str) -> Piece:
    return Piece(kind=kind, start=piece.start, stop=piece.stop, recording=piece.recording, label=label, why=why)


def _method(model: TriadModel | None) -> str:
    return "none" if model is None else model.method.partition("/")[0]


def _given_turns(observed: Observed, method: str) -> Iterator[Piece]:
    session = observed.session
    saturated = saturated_turns(session, observed.settings.settle_s) if method else ()
    for number, turn in enumerate(session.turns):
        used = not method or {"rate-table": turn.turn_rate, "known-rotation": turn.angle}.get(method) is not None
        yield _piece("turn", turn, _label(turn), SATURATED if number in saturated else "" if used else NOT_USED)


def _label(turn: Turn) -> str:
    label = str(turn.axis or "")
    if turn.turn_rate is not None:
        return f"{label} {turn.turn_rate / RADIAN_PER_DEGREE:.0f} deg/s"
    return label if turn.angle is None else f"{label} {turn.angle / RADIAN_PER_DEGREE:.0f} deg"


def _moves(observed: Observed, method: str) -> Iterator[Piece]:
    """Yield the moves between stills, with the angle that the gyroscopes measured if they have a physical unit."""
    for record, search in observed.turn_searches:
        sizes = np.linalg.norm(search.rotation_angle, axis=1)
        stuck = stuck_windows([np.asarray(record.gyro)[turn.start : turn.stop] for turn in search.rotations])
        for k in np.flatnonzero(sizes >= MIN_MOVE_SHARE * sizes.max(initial=0.0)):
            turn, angle = search.rotations[k], search.rotation_angle[k]
            if turn.axis is not None and is_physical(record.gyro_unit):
                turn = replace(turn, angle=float(angle[np.argmax(np.abs(angle))]) * si_factor(record.gyro_unit, "rate"))
            used = method in ("", "multi-position")
            yield _piece("turn", turn, _label(turn), SATURATED if stuck[k] and method else "" if used else NOT_USED)
