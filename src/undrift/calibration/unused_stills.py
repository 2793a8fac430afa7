"""Unused stills: an accelerometer's fit is compared with gravity in every still that it did not use.

    m_p = |M (u_p - o)| - g                  u_p the mean reading of still p, in any pose
    var m_p = (M' n)' S_p (M' n) + J_p C J_p'        n the direction, J = d|a| / d(M, o), C the covariance of the fit

Six stills that are no faces may fit twelve parameters well: poses of a sheared cube do. Other poses then miss gravity, though their
direction is not known. S_p holds the noise of the mean by blocks and the converter's step.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.adc import mean_rounding
from undrift.calibration.observe import APART_C, Observed, piece_name, piece_temperatures
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.model import TriadModel, level_of
from undrift.record import Record, Session, Still, Turn
from undrift.segments import find_still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

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
    session, found = seen.session, list(seen.stills)
    if not seen.found:
        for number, record in enumerate(session.records):
            with suppress(InputError):  # shorter than a window
                found += find_still(record, replace(seen.settings.still, adapt=False), recording=number).stills
    pieces: tuple[Still | Turn, ...] = (*used, *session.turns)
    taken = [(piece.recording, piece.start, piece.stop) for piece in pieces]
    kept: list[Still] = []
    for still in found:
        shares = any(r == still.recording and a < still.stop and still.start < b for r, a, b in taken)
        if not shares:
            kept.append(still)
            taken.append((still.recording, still.start, still.stop))
    temps, of_fit = piece_temperatures(session, kept), piece_temperatures(session, used)
    if session.kind == "thermal" and not np.isfinite(temps).all():
        return ()
    middle = float(np.mean(of_fit[np.isfinite(of_fit)])) if np.isfinite(of_fit).any() else np.nan
    return tuple(still for still, temp_c in zip(kept, temps, strict=True) if not abs(temp_c - middle) > APART_C)


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
    windows, kept = [], []
    for still in stills:
        record = records[still.recording]
        if record.accel is not None and record.accel_unit == records[stills[0].recording].accel_unit:
            window = record.accel[still.start : still.stop]
            window = window[~np.isnan(window).any(axis=1)]
            if len(window) > 1:
                windows.append(window)
                kept.append(still)
    if not kept:
        return _Lengths(miss=np.zeros(0), noise=np.zeros(0), design=np.zeros((0, 12))), kept
    sizes = [block_size(records[s.recording].sample_rate_hz) for s in kept]
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
    ), kept
