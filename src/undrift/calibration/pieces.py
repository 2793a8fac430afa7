"""What recordings hold, piece by piece: stills, faces, turns; what a calibration used of them, why not the others, and what
the stills that it did not use show.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import mean_rounding
from undrift.calibration.plausibility import stuck_windows
from undrift.calibration.session import (
    APART_C,
    Observed,
    at_one_temperature,
    in_one_unit,
    look,
    piece_name,
    piece_temperatures,
    saturated_turns,
    whole_readings,
)
from undrift.calibration.settings import CalibrateSettings
from undrift.errors import InputError
from undrift.findings import Finding, finding, told_apart
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.model import Calibration, TriadModel, level_of
from undrift.record import Record, Session, Still, Turn
from undrift.segments import LeftOut, TurnSearch, find_still, left_out
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

_SATURATED = "gyroscope saturated"
_TURNED_DEG, _TURNED_SHARE = 5.0, 0.02  # a move by less is no turn worth a mark; in counts: this share of the largest


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
    session: Session,
    settings: CalibrateSettings = CalibrateSettings(),
    calibration: Calibration | None = None,
    seen: Observed | None = None,
) -> tuple[tuple[Piece, ...], str]:
    """Return the pieces of a session, stated or found, in order of time, and why there is no still.

    With the calibration that was made of it, pieces that it did not use say why; with what it saw, they are not looked for again.
    """
    seen = look(session, settings) if seen is None else seen
    session = in_one_unit(session)
    stills = session.stills or seen.stills
    reason = next((search.reason for search in seen.searches if search.reason), "")
    out = [
        Piece(kind="still", start=one.start, stop=one.stop, recording=number, why=_why(one))
        for number, pair in enumerate(zip(seen.session.records, seen.searches, strict=False))
        for one in left_out(*pair)
    ]
    here = session if calibration is None else at_one_temperature(session)[0]
    stated: tuple[Still | Turn, ...] = (*here.stills, *here.turns)
    spans = {(piece.recording, piece.start, piece.stop) for piece in stated}
    parts = [_of_still(still, calibration) for still in stills]
    spoilt = () if calibration is None else saturated_turns(session, settings.settle_s)
    parts += [
        replace(_of_turn(turn, calibration), why=_SATURATED) if k in spoilt else _of_turn(turn, calibration)
        for k, turn in enumerate(session.turns)
    ]
    parts = [
        replace(piece, why="another temperature")
        if (session.stills or piece.kind == "turn") and (piece.recording, piece.start, piece.stop) not in spans
        else piece
        for piece in parts
    ]
    if not session.turns:
        for each in seen.turn_searches():
            parts += _turns(*each, calibration)
    return tuple(sorted((*parts, *out), key=lambda piece: (piece.recording, piece.start))), reason if not stills else ""


def _why(one: LeftOut) -> str:
    if one.why == "too short":
        return f"too short: {one.value:.2g} s at rest, wanted {one.limit:g} s"
    if one.why == "turning":
        return f"in a steady turn: {one.value:.3g} {one.unit}"
    value, limit = told_apart(one.value, ".3g", one.limit), told_apart(one.limit, ".3g", one.value)
    return f"too restless: {value} {one.unit} rms, {'no gap above it' if np.isnan(one.limit) else f'limit {limit}'}"


def _of_still(s: Still, made: Calibration | None) -> Piece:
    six = made is not None and made.accel is not None and made.accel.method.startswith("six-face")
    why = "no face up" if six and s.face is None else ""
    return Piece(kind="still", start=s.start, stop=s.stop, recording=s.recording, label=s.face or "", why=why)


def _method(made: Calibration) -> str:
    return "none" if made.gyro is None else made.gyro.method.partition("/")[0]


def _of_turn(turn: Turn, calibration: Calibration | None) -> Piece:
    label: str = turn.axis or ""
    why = ""
    if turn.turn_rate is not None:
        label = f"{label} {turn.turn_rate / RADIAN_PER_DEGREE:.0f} deg/s"
    elif turn.angle is not None:
        label = f"{label} {turn.angle / RADIAN_PER_DEGREE:.0f} deg"
    if calibration is not None:
        method = _method(calibration)
        if method == "rate-table" and turn.turn_rate is None:
            why = "no stated rate"
        elif method == "known-rotation" and turn.angle is None:
            why = "no stated angle"
        elif method not in ("rate-table", "known-rotation"):
            why = "not needed"
    return Piece(kind="turn", start=turn.start, stop=turn.stop, recording=turn.recording, label=label, why=why)


def _turns(number: int, record: Record, search: TurnSearch, made: Calibration | None) -> Iterator[Piece]:
    """Return the steady turns and the moves between stills that the gyroscope shows."""
    method = "" if made is None else _method(made)
    physical = is_physical(record.gyro_unit)
    factor = si_factor(record.gyro_unit, "rate") / RADIAN_PER_DEGREE if physical else 1.0
    for turn, rate in zip(search.plateaus, search.plateau_rate * factor, strict=True):
        inside = any(turn.start < other.stop and other.start < turn.stop for other in search.rotations)
        if inside and method in ("", "multi-position", "known-rotation"):
            continue  # part of a move, which is drawn
        about = f"{rate['xyz'.index(turn.axis or 'x')]:.0f} {'deg/s' if physical else record.gyro_unit}"
        label = f"{turn.axis} {about}"
        why = "no stated rate" if method else ""
        yield Piece(kind="turn", start=turn.start, stop=turn.stop, recording=number, label=label, why=why)
    windows = () if record.gyro is None else tuple(record.gyro[turn.start : turn.stop] for turn in search.rotations)
    stuck, sizes = stuck_windows(windows), np.linalg.norm(search.rotation_angle, axis=1) * factor
    least = _TURNED_DEG if physical else _TURNED_SHARE * sizes.max(initial=0.0)
    for turn, angle, spoilt in zip(search.rotations, search.rotation_angle * factor, stuck, strict=True):
        if np.linalg.norm(angle) < least:
            continue
        along = angle[np.argmax(np.abs(angle))]
        label = f"{turn.axis} {along:.0f} deg" if turn.axis and physical else turn.axis or ""
        why = "" if method in ("", "multi-position") or _whole(method, turn, along) else "not a full turn"
        why = _SATURATED if spoilt and method else why
        yield Piece(kind="turn", start=turn.start, stop=turn.stop, recording=number, label=label, why=why)


def _whole(method: str, turn: Turn, along_deg: float) -> bool:
    """Tell whether a fit by known rotations took a move for a full turn."""
    return method == "known-rotation" and turn.axis is not None and abs(abs(along_deg) / 360.0 - 1.0) < 0.1


# ---- unused stills: an accelerometer's fit is compared with gravity in every still that it did not use
#
#     m_p = |M (u_p - o)| - g                  u_p the mean reading of still p, in any pose
#     var m_p = (M' n)' S_p (M' n) + J_p C J_p'        n the direction, J = d|a| / d(M, o), C the covariance of the fit
#
# Six stills that are no faces may fit twelve parameters well: poses of a sheared cube do. Other poses then miss gravity, though
# their direction is not known. S_p holds the noise of the mean by blocks and the converter's step.


LARGEST_ANGLE_DEG = 5.0  # of a sensor to its axis of the case: parts and boards are within 1 to 3
MISS_M_S2 = (3e-3 * STANDARD_GRAVITY, 20e-3 * STANDARD_GRAVITY)  # rms: marginal above the first, bad above the second
_CLEARLY = 3.0  # standard deviations by which a still misses
_CHANCE = 1e-3  # of a finding where only noise and the fit's covariance are at work
_LEAST_MISSES = 2  # stills: one may be no rest


def check_accel(seen: Observed, model: TriadModel, used: Sequence[Still]) -> Iterator[Finding]:
    """Compare a fitted accelerometer with the axes of a case, and with gravity in the stills that it did not use."""
    angles = np.arccos(np.clip(np.diag(model.sensor_axes), -1.0, 1.0)) / RADIAN_PER_DEGREE
    worst = int(np.argmax(angles))
    if angles[worst] > LARGEST_ANGLE_DEG:
        yield finding(
            "accel.cross_axis", "fail", axis="xyz"[worst], angle_deg=angles[worst], limit_deg=LARGEST_ANGLE_DEG
        )
    stills = unused_stills(seen, used)
    if stills:
        yield from check_gravity_length(seen.session, stills, model)


def unused_stills(seen: Observed, used: Sequence[Still | Turn]) -> tuple[Still, ...]:
    """Return the stills of a session, stated or found, that share nothing with what a fit used, at its temperature."""
    session, stills = seen.session, list(seen.stills)
    if not seen.found:
        for number, record in enumerate(session.records):
            with suppress(InputError):  # shorter than a window
                stills += find_still(record, replace(seen.settings.still, adapt=False), recording=number).stills
    pieces: tuple[Still | Turn, ...] = (*used, *session.turns)
    taken = [(piece.recording, piece.start, piece.stop) for piece in pieces]
    unused: list[Still] = []
    for still in stills:
        shares = any(r == still.recording and a < still.stop and still.start < b for r, a, b in taken)
        if not shares:
            unused.append(still)
            taken.append((still.recording, still.start, still.stop))
    temps, of_fit = piece_temperatures(session, unused), piece_temperatures(session, used)
    if session.kind == "thermal" and not np.isfinite(temps).all():
        return ()
    middle = float(np.mean(of_fit[np.isfinite(of_fit)])) if np.isfinite(of_fit).any() else np.nan
    return tuple(still for still, temp_c in zip(unused, temps, strict=True) if not abs(temp_c - middle) > APART_C)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Lengths:
    """Mean specific force of stills: how far its length is from gravity, and why it may be."""

    miss: FloatArray  # (P,), m/s2
    noise: FloatArray  # (P,), standard deviation from the readings, m/s2
    design: FloatArray  # (P, 12), d length / d (M row by row, o)


def check_gravity_length(session: Session, stills: Sequence[Still], model: TriadModel) -> Iterator[Finding]:
    """Compare the length of the corrected specific force in stills that a fit did not use with gravity."""
    from scipy.special import chdtri

    lengths, stills = _lengths(session.records, stills, model, session.gravity_m_s2)
    count = len(stills)
    if not count:
        return
    values, vectors = np.linalg.eigh(np.nan_to_num(model.covariance[:12, :12]))
    carried = lengths.design @ vectors * np.sqrt(values.clip(0.0))
    scaled, miss = carried / lengths.noise[:, None], lengths.miss / lengths.noise
    along = scaled.T @ miss
    square = float(miss @ miss - along @ np.linalg.solve(np.eye(12) + scaled.T @ scaled, along))  # m' V^-1 m
    if square <= chdtri(count, _CHANCE):
        return
    sigma = np.sqrt(lengths.noise**2 + (carried**2).sum(axis=1))
    beyond = int((np.abs(lengths.miss) > _CLEARLY * sigma).sum())
    rms, worst = float(np.sqrt(np.mean(lengths.miss**2))), int(np.argmax(np.abs(lengths.miss)))
    level = level_of(rms, MISS_M_S2)
    if level == "info" or not beyond:
        return
    yield finding(
        "accel.unused_stills",
        "fail" if level == "fail" and beyond >= _LEAST_MISSES else "warn",
        stills=count,
        beyond=beyond,
        rms_m_s2=rms,
        worst_m_s2=lengths.miss[worst],
        still=piece_name(session, stills[worst], worst, stated=False),
        tilt_deg=np.arctan2(rms, session.gravity_m_s2) / RADIAN_PER_DEGREE,
    )


def _lengths(
    records: Sequence[Record], stills: Sequence[Still], model: TriadModel, gravity: float
) -> tuple[_Lengths, list[Still]]:
    windows, usable = [], []
    for still in stills:
        record = records[still.recording]
        window = whole_readings(record.accel, still.start, still.stop)
        if len(window) > 1 and record.accel_unit == records[stills[0].recording].accel_unit:
            windows.append(window)
            usable.append(still)
    if not usable:
        return _Lengths(miss=np.zeros(0), noise=np.zeros(0), design=np.zeros((0, 12))), usable
    sizes = [block_size(records[s.recording].sample_rate_hz) for s in usable]
    within = np.array([w.std(axis=0) / np.sqrt(len(w)) for w in windows])
    blocks = noise_of_means(windows, sizes)
    noise = within if blocks is None else np.maximum(within, blocks)
    noise = np.hypot(noise, mean_rounding(windows, windows))
    apart = np.array([w.mean(axis=0) for w in windows]) - model.offset
    force = apart @ model.matrix.T
    length = np.linalg.norm(force, axis=1)
    n = force / length[:, None]
    by_reading = n @ model.matrix
    return _Lengths(
        miss=length - gravity,
        noise=np.maximum(np.sqrt((by_reading**2 * noise**2).sum(axis=1)), 1e-9 * gravity),
        design=np.column_stack(((n[:, :, None] * apart[:, None, :]).reshape(-1, 9), -by_reading)),
    ), usable
