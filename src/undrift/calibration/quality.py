"""Check that the rests of a session are still, that its turns are steady, and that rests not used by a fit agree with gravity.

A still is compared with a device at rest by two figures, which do not depend on the offset of its sensors:

    sway    standard deviation of the readings, averaged over 0.1 s (three axes combined)
    rate    mean rate reading minus its median over all stills: a slow turn that does not sway

If the worst still exceeds the limit of a bench, it is reported as a finding. At three times the limit the session is refused.
Readings in counts have no such limit, so a still is then compared with the other stills. A turn is checked by r, the reading of the
turned axis minus its offset, smoothed over 0.1 s, relative to the 90 % quantile of abs(r):

    spread   standard deviation of abs(r) over a settled dwell, relative to its mean (a stop in 5 % of it makes 0.23)
    edge     abs(r) at the start or end of a turn by an angle: part of the angle is missing
"""

import hashlib
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from undrift import segments
from undrift.arrays import FloatArray
from undrift.calibration.codes import code_steps, mean_rounding
from undrift.calibration.plausibility import stuck_windows
from undrift.errors import Implausible, InputError
from undrift.findings import Finding, Level, finding, told_apart
from undrift.model import AXES, TriadModel
from undrift.record import Record, Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

ACCEL_SWAY = 0.05  # m/s2: a steady tilt by 1 deg from start to end
REFUSED_RATIO = 3.0  # ratio of a figure to its limit above which the session is refused
COUNTS_RATIO = 10.0  # largest spread of a still in counts, relative to the median of all stills
SAME_TEMPERATURE_K = 3.0
SMOOTH_S = 0.1


# ---- names and readings of pieces


def piece_name(session: Session, piece: Still | Turn, number: int, *, what: str = "still", listed: bool = True) -> str:
    """Return the name of a still or turn in messages, with its recording and time."""
    time = session.records[piece.recording].time
    name = f"[[{what}]] {number + 1}" if listed else f"{what} found"
    return f"{name} (recording {piece.recording}, {time[piece.start]:.1f}-{time[piece.stop - 1]:.1f} s)"


def whole_readings(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return the readings (n, 3) of a stretch without gaps, or an empty array if the triad is missing."""
    readings = np.zeros((0, 3)) if values is None else values[start:stop]
    return readings[~np.isnan(readings).any(axis=1)]


def mean_reading(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return the mean reading (3,) of a stretch, or NaN without readings."""
    readings = whole_readings(values, start, stop)
    return np.asarray(readings.mean(axis=0)) if len(readings) else np.full(3, np.nan)


def piece_temperatures(session: Session, pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the given or recorded temperature of each still or turn, degC, or NaN without one."""
    temps = []
    for piece in pieces:
        column = session.records[piece.recording].temp_c
        recorded = np.zeros(0) if column is None else column[piece.start : piece.stop]
        recorded = recorded[np.isfinite(recorded)]
        temps.append(piece.temp_c if piece.temp_c is not None else recorded.mean() if len(recorded) else np.nan)
    return np.array(temps)


# ---- stills: each figure gives its ratio to the limit of a bench, the number of the still, and a sentence

Fault = tuple[float, int, str]


def check_stills(session: Session, stills: tuple[Still, ...], *, listed: bool) -> tuple[Finding, ...]:
    """Compare every still with a device at rest. Raise if a still is far from rest."""
    figures = [*_rates(session, stills)]
    if listed:
        figures += [*_sway(session, stills, "gyro"), *_sway(session, stills, "accel")]
    faults = [fault for fault in figures if fault[0] > 1.0]
    if not faults:
        return ()
    ratio, number, what = max(faults)
    name = piece_name(session, stills[number], number, listed=listed)
    moving = _piece_differs("warn", name, len({still for _, still, _ in faults}), f"it shows {what}")
    # Stills detected in a single recording may drift during warm-up. Separate recordings may have different units.
    if ratio > REFUSED_RATIO and (listed or len(session.records) > 1):
        raise Implausible(f"{name}: expected a device at rest, got {what}. {moving.action}", still=number)
    return (moving,)


def _piece_differs(level: Level, name: str, pieces: int, what: str, **values: float) -> Finding:
    others = f" ({pieces} such pieces)" if pieces > 1 else ""
    return finding(
        "session.piece",
        level,
        f"{name} differs from its entry in the session{others}: {what}.",
        "Correct its start_s and stop_s, or omit it. Check for a slow turn, a wrong unit, two devices or warm-up.",
        piece=name,
        pieces=pieces,
        **values,
    )


def _sway(session: Session, stills: tuple[Still, ...], triad: Literal["gyro", "accel"]) -> Iterator[Fault]:
    rate, unit = triad == "gyro", getattr(session.records[0], f"{triad}_unit")
    values: FloatArray = np.zeros(len(stills))
    for number, still in enumerate(stills):
        record = session.records[still.recording]
        readings, smooth = getattr(record, triad), max(1, round(SMOOTH_S * record.sample_rate_hz))
        blocks = (still.stop - still.start) // smooth
        if readings is not None and blocks > 1:
            means = readings[still.start : still.start + blocks * smooth].reshape(blocks, smooth, 3).mean(axis=1)
            whole = means[np.isfinite(means).all(axis=1)]
            values[number] = np.linalg.norm(whole.std(axis=0)) if len(whole) else 0.0
    if not is_physical(unit):  # a reading at rest may toggle between two codes
        step = float(np.nan_to_num(code_steps(session.records, rate=rate)).max())
        limit = max(COUNTS_RATIO * float(np.median(values)), step, 1e-300) if len(stills) > 2 else np.inf
    elif rate:
        values, unit = values * si_factor(unit, "rate") / RADIAN_PER_DEGREE, "deg/s"
        limit = segments.BENCH_RATE_LIMIT / RADIAN_PER_DEGREE
    else:
        limit = ACCEL_SWAY / si_factor(unit, "accel")
    for number, value in enumerate(values):
        yield value / limit, number, f"readings that sway by {value:.3g} {unit} rms"


def _rates(session: Session, stills: tuple[Still, ...]) -> Iterator[Fault]:
    unit = session.records[0].gyro_unit
    if len(stills) < 3 or not is_physical(unit) or session.kind == "thermal":
        return
    means = np.array([mean_reading(session.records[s.recording].gyro, s.start, s.stop) for s in stills])
    if np.isfinite(means).any():
        rates = np.linalg.norm(means - np.nanmedian(means, axis=0), axis=1) * si_factor(unit, "rate")
        for number, rate in enumerate(rates):
            what = f"a mean rate {rate / RADIAN_PER_DEGREE:.3g} deg/s off the mean rate of the other stills"
            yield rate / segments.BENCH_RATE_LIMIT, number, what


def check_counted_once(records: Sequence[Record]) -> None:
    """Raise if a recording is repeated. Its readings would count twice, and the uncertainty would be too small."""
    first = dict[bytes, int]()
    for number, record in enumerate(records):
        readings = np.column_stack([values for values in (record.gyro, record.accel) if values is not None])
        if not (np.nanmin(readings, axis=0) < np.nanmax(readings, axis=0)).any():
            continue  # sensors that repeat a single value
        digest = hashlib.sha256(readings.tobytes()).digest()
        if digest in first:
            raise InputError(f"recordings {first[digest]} and {number} contain the same data. Remove one of the two.")
        first[digest] = number


# ---- turns

MIN_NOISES = 8.0  # 90 % quantile, relative to the white noise of r, below which a turn is not judged
MOST_SETTLING = 0.5  # largest share of a dwell that is omitted
CUT_OFF_SHARE = 0.5  # share of the quantile at the start or end of a turn above which the turn is cut off
SPREAD_LIMITS, EDGE_LIMITS = (0.05, 0.23), (0.2, CUT_OFF_SHARE)  # limits for a warning and for a failure


def check_turns(session: Session, stills: tuple[Still, ...], settle_s: float) -> Iterator[Finding]:
    """Check that every turn is steady, or goes from rest to rest. Raise if its gyroscope is dead."""
    faults: list[tuple[bool, float, int, str]] = []  # fail, share, number of the turn, sentence
    saturated, at_rest = saturated_turns(session, settle_s), dict[int, FloatArray]()
    for k, record in enumerate(session.records):
        if record.gyro is not None and (rests := [record.gyro[s.start : s.stop] for s in stills if s.recording == k]):
            at_rest[k] = np.mean([np.nanmean(rest, axis=0) for rest in rests], axis=0)
    for number, turn in enumerate(session.turns):
        rate = np.abs(_smooth_rate(session, at_rest.get(turn.recording), turn, settle_s))
        if not len(rate) or number in saturated:
            continue
        if turn.angle is not None:
            share, (warn, fail) = float(rate[[0, -1]].max() / np.quantile(rate, 0.9)), EDGE_LIMITS
            what = f"it is cut off: at its start or end it still turns at {100.0 * share:.3g} % of its largest rate"
        else:
            share, (warn, fail) = float(rate.std() / rate.mean()), SPREAD_LIMITS
            what = f"its rate varies by {100.0 * share:.3g} % rms{', it overlaps a stop' if share > fail else ''}"
        if share > warn:
            faults.append((share > fail, share, number, what))
    if faults:
        fails, share, number, what = max(faults)
        name = piece_name(session, session.turns[number], number, what="turn")
        level: Level = "fail" if fails else "warn"
        yield _piece_differs(level, name, len(faults), what, percent=100.0 * share)


def steady(record: Record, turn: Turn, settle_s: float) -> slice:
    """Return the samples of a turn that count: for a dwell, those after its start, and whole turns if possible."""
    if not turn.turn_rate:
        return slice(turn.start, turn.stop)
    time = record.time[turn.start : turn.stop]
    length_s, period_s = float(time[-1] - time[0]), 2.0 * np.pi / abs(turn.turn_rate)
    start_s = float(time[0]) + min(settle_s, MOST_SETTLING * length_s)
    turns = int((time[-1] - start_s) / period_s)
    begin = int(np.searchsorted(time, start_s))
    stop = int(np.searchsorted(time, start_s + turns * period_s)) if turns else len(time)
    return slice(turn.start + begin, turn.start + stop)


def _steady_rate(session: Session, turn: Turn, settle_s: float) -> FloatArray:
    """Return the gyroscope readings (n, 3) of the samples of a turn that count, or an empty array without gyroscopes."""
    record = session.records[turn.recording]
    return np.zeros((0, 3)) if record.gyro is None else record.gyro[steady(record, turn, settle_s)]


def saturated_turns(session: Session, settle_s: float) -> tuple[int, ...]:
    """Return the numbers of the turns in which a gyroscope is stuck at the end of its range."""
    windows = [_steady_rate(session, turn, settle_s) for turn in session.turns]
    return tuple(number for number, window in enumerate(windows) if len(window) and stuck_windows([window])[0])


def _smooth_rate(session: Session, at_rest: FloatArray | None, turn: Turn, settle_s: float) -> FloatArray:
    """Return r (N,) of a turn in the raw unit, or an empty array if r cannot be computed or is near the noise."""
    record = session.records[turn.recording]
    if record.gyro is None or turn.axis is None or not (turn.turn_rate or turn.angle):
        return np.empty(0)
    axis = AXES.index(turn.axis)
    column = record.gyro[:, axis]
    if not np.ptp(column[np.isfinite(column)]):
        raise Implausible(
            f"gyroscope {turn.axis}: it reads {column[0]:g} throughout, also while the device turns about {turn.axis}: the sensor "
            "is dead, or another column is mapped. Check the map and the device."
        )
    width = max(1, round(SMOOTH_S * record.sample_rate_hz))
    readings = _steady_rate(session, turn, settle_s)[:, axis]
    if at_rest is None or len(readings) < 2 * width or np.isnan(readings).any():
        return np.empty(0)
    rate = np.convolve(readings, np.full(width, 1.0 / width), mode="valid")
    rate -= at_rest[axis]
    noise = float(np.diff(readings).std()) / np.sqrt(2.0 * width)
    return rate if np.quantile(np.abs(rate), 0.9) > MIN_NOISES * noise else np.empty(0)


# ---- rests that a fit did not use: their specific force compared with gravity
#
# m_p = |f_p| - g,  f_p = M (u_p - o)       mean reading u_p of still p, in any pose
# s_p^2 = (M' n)' S_p (M' n) + J_p C J_p'   n = f / |f|, J = d|f| / d(M, o), covariance C of the fit
#
# Six stills that are not faces may fit twelve parameters well, for example poses of a sheared cube. Other poses then miss
# gravity, even if their direction is unknown. S_p contains the noise of the mean and the converter's step.

LARGEST_ANGLE_DEG = 5.0  # largest angle between a sensor and its axis of the case (parts and boards: 1 to 3)
WARN_MISS, FAIL_MISS = 3e-3 * STANDARD_GRAVITY, 20e-3 * STANDARD_GRAVITY  # m/s2 rms
BEYOND_SIGMAS = 4.0  # limit in standard uncertainties (chance exceeds it in 1 of 16,000)
CHECK_FACES = "Rest on flat faces of the case and check the label of each, or use all rests (`accel` multi-position)."
MIN_MISSES = 2  # number of stills that must fail, because one may not be a rest


def check_accel(session: Session, model: TriadModel, unused: Sequence[Still]) -> Iterator[Finding]:
    """Compare a fitted accelerometer with the axes of a case, and with gravity in the stills that the fit did not use."""
    angles = np.arccos(np.clip(np.diag(model.forward_matrix) / model.scale_factor, -1.0, 1.0)) / RADIAN_PER_DEGREE
    axis = int(np.argmax(angles))
    if angles[axis] > LARGEST_ANGLE_DEG:
        angle = told_apart(angles[axis], ".2g", LARGEST_ANGLE_DEG)
        sentence = (
            f"Accelerometer {AXES[axis]} is {angle} deg off its axis of the case (limit {LARGEST_ANGLE_DEG:g} deg)."
        )
        yield finding("accel.implausible", "fail", sentence, CHECK_FACES, angle_deg=angles[axis])
    readings = [whole_readings(session.records[still.recording].accel, still.start, still.stop) for still in unused]
    stills = [still for still, window in zip(unused, readings, strict=True) if len(window) > 1]
    windows = [window for window in readings if len(window) > 1]
    if not stills:
        return
    white = np.array([window.std(axis=0) / np.sqrt(len(window)) for window in windows])
    noise = np.hypot(white, mean_rounding(windows, windows))
    deviation = np.array([window.mean(axis=0) for window in windows]) - model.offset
    force = deviation @ model.matrix.T
    direction = force / np.linalg.norm(force, axis=1)[:, None]
    reading_slopes = direction @ model.matrix
    jacobian = np.column_stack(((direction[:, :, None] * deviation[:, None, :]).reshape(-1, 9), -reading_slopes))
    covariance = np.nan_to_num(model.covariance[:12, :12])
    variance = (reading_slopes**2 * noise**2).sum(axis=1) + np.einsum("pi,ij,pj->p", jacobian, covariance, jacobian)
    miss = np.linalg.norm(force, axis=1) - session.gravity_m_s2
    misses = int((np.abs(miss) > BEYOND_SIGMAS * np.sqrt(variance)).sum())
    rms, worst = float(np.sqrt(np.mean(miss**2))), int(np.argmax(np.abs(miss)))
    if rms > WARN_MISS and misses:
        name = piece_name(session, stills[worst], worst, listed=False)
        sentence = (
            f"{len(stills)} rests that the fit did not use miss gravity by {rms:.2g} m/s2 rms, {misses} of them significantly. "
            f"The worst is {name} with {miss[worst]:+.2g} m/s2."
        )
        level: Level = "fail" if rms > FAIL_MISS and misses >= MIN_MISSES else "warn"
        values = {"stills": len(stills), "beyond": misses, "rms_m_s2": rms}
        yield finding("accel.implausible", level, sentence, CHECK_FACES, **values)
