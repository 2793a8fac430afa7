"""Are the rests and turns of a session what it says they are, and do rests that a fit did not use agree with it?

A still is compared with a device at rest by three figures, which do not depend on the offset of its sensors:

    sway    largest standard deviation of the readings, smoothed over 0.1 s, in a window of 1 s; three axes together
    tilt    angle between the mean specific force of its first and of its last third
    rate    mean rate reading minus its median over all stills: a slow turn that no window shows

Each has a limit that a bench keeps. Above the limit the still is a finding; above three times the limit the session is refused.
Readings in counts have no such limit, and a still is then compared with the other stills. Of a turn, r is the reading of the turned
axis minus its offset, smoothed over 0.1 s, and its level is the 90 % quantile of abs(r):

    stop     share of a settled dwell in stretches of 0.2 s or more with abs(r) below a fifth of its level
    spread   standard deviation of the rest of r, relative to its mean
    edge     abs(r) at the start or end of a turn by an angle, relative to its level: part of the angle is missing

A turn is not judged if its level is less than eight times the white noise of r.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from typing import Literal

import numpy as np

from undrift import segments
from undrift.arrays import FloatArray, runs
from undrift.calibration.codes import code_steps, mean_rounding
from undrift.calibration.plausibility import stuck_at_rate, stuck_in_motion
from undrift.errors import Implausible, InputError
from undrift.findings import Finding, finding
from undrift.fit.gls import block_size, noise_of_means
from undrift.model import AXES, TriadModel, level_of
from undrift.record import Record, Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

TILT_LIMIT_DEG = 0.5  # a device that settles on a bench or a cushion stays below it
REFUSED_RATIO = 3.0  # of a figure to its limit: the device does not rest
COUNTS_RATIO = 10.0  # a still in counts may spread this many times the median of all stills
SHARED_LIMIT = 0.1  # of the shorter of two stretches: they count twice
WARMED_K = 10.0  # between stills: offsets may then differ
SMOOTH_S = 0.1


# ---- names and readings of pieces


def piece_name(session: Session, piece: Still | Turn, number: int, *, what: str = "still", stated: bool = True) -> str:
    """Return the name of a still or turn in messages, with its recording and time."""
    time = session.records[piece.recording].time
    name = f"[[{what}]] {number + 1}" if stated else f"{what} found"
    return f"{name} (recording {piece.recording}, {time[piece.start]:.1f}-{time[piece.stop - 1]:.1f} s)"


def whole_readings(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return the readings (n, 3) of a stretch without gaps; empty if the triad is missing."""
    part = np.zeros((0, 3)) if values is None else values[start:stop]
    return part[~np.isnan(part).any(axis=1)]


def mean_reading(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return the mean reading (3,) of a stretch, NaN if there is none."""
    part = whole_readings(values, start, stop)
    return np.asarray(part.mean(axis=0)) if len(part) else np.full(3, np.nan)


def piece_temperatures(session: Session, pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the temperature of each still or turn, as stated or as recorded; NaN if there is none."""
    temps = []
    for piece in pieces:
        column = session.records[piece.recording].temp_c
        part = np.full(1, np.nan) if column is None else column[piece.start : piece.stop]
        recorded = float(np.nanmean(part)) if np.isfinite(part).any() else float("nan")
        temps.append(recorded if piece.temp_c is None else piece.temp_c)
    return np.array(temps)


# ---- stills


def check_stills(session: Session, stills: tuple[Still, ...], *, stated: bool) -> tuple[Finding, ...]:
    """Compare every still with a device at rest; raise if one is far from it."""
    figures = [_rate_figure(session, stills)]
    if stated:
        figures += [_sway_figure(session, stills, rate=True), _sway_figure(session, stills, rate=False)]
        figures.append(_tilt_figure(session, stills))
    findings: list[Finding] = []
    worst_ratio, worst_still = 0.0, 0
    for text, values, limit, unit in figures:
        above = np.flatnonzero(values > limit)  # not where it is NaN
        if not len(above):
            continue
        number = int(above[np.argmax(values[above])])
        value, unit = (values[number] / RADIAN_PER_DEGREE, "deg/s") if unit == "rad/s" else (values[number], unit)
        what = text.format(value=f"{value:.3g} {unit.replace('dps', 'deg/s')}")
        name = piece_name(session, stills[number], number, stated=stated)
        item = finding("still.moving", "warn", still=name, stills=len(above), what=what)
        # Stills that were found in one recording may drift while it warms up; separate recordings may be in different units.
        drifting = not stated and len(session.records) == 1
        ratio = min(values[number] / limit, REFUSED_RATIO if drifting else np.inf)
        findings = [item, *findings] if ratio > worst_ratio else [*findings, item]
        if ratio > worst_ratio:
            worst_ratio, worst_still = ratio, number
    if worst_ratio > REFUSED_RATIO:
        worst = findings[0]
        raise Implausible(
            f"{worst.values['still']}: wanted a device at rest, got {worst.detail}; {worst.action}", still=worst_still
        )
    return tuple(findings)


_Figure = tuple[str, FloatArray, float, str]  # sentence, value of each still, limit, unit


def _sway_figure(session: Session, stills: tuple[Still, ...], *, rate: bool) -> _Figure:
    unit = session.records[0].gyro_unit if rate else session.records[0].accel_unit
    spreads = np.array([_largest_spread(session.records[still.recording], still, rate) for still in stills])
    known, limit = spreads[np.isfinite(spreads)], np.inf
    if is_physical(unit):
        si_limit = segments.BENCH_RATE_LIMIT if rate else segments.BENCH_ACCEL_LIMIT
        limit = si_limit / si_factor(unit, "rate" if rate else "accel")
    elif len(known) > 2:
        limit = max(COUNTS_RATIO * float(np.median(known)), 1e-300)
        if (known > limit).any():  # a reading at rest may toggle between two codes
            limit = max(limit, float(np.nan_to_num(code_steps(session.records, rate=rate)).max()))
    return "readings that sway by up to {value} rms", spreads, limit, unit


def _largest_spread(record: Record, still: Still, rate: bool) -> float:
    values = record.gyro if rate else record.accel
    smooth = max(1, round(SMOOTH_S * record.sample_rate_hz))
    window = min(segments.sample_count(1.0, record.sample_rate_hz), still.stop - still.start - smooth + 1)
    if values is None or window < 2:
        return float("nan")
    spread = segments.sliding_moments(values[still.start : still.stop], window, smooth)[1]
    return float(spread.max(where=np.isfinite(spread), initial=-np.inf)) if np.isfinite(spread).any() else float("nan")


def _tilt_figure(session: Session, stills: tuple[Still, ...]) -> _Figure:
    centre: FloatArray = np.zeros(3)
    limit, text = TILT_LIMIT_DEG, "a tilt of {value} from its first to its last third"
    if not is_physical(session.records[0].accel_unit):  # counts: about the centre of a sphere through enough rests
        means = np.array([mean_reading(session.records[s.recording].accel, s.start, s.stop) for s in stills])
        if len(means) < 6 or not np.isfinite(means).all():
            return text, np.zeros(0), limit, "deg"
        centre, radius = segments.sphere_of(means)
        step = float(np.nan_to_num(code_steps(session.records, rate=False)).max())
        limit += 2.0 * step / radius / RADIAN_PER_DEGREE
    tilts = []
    for still in stills:
        accel, third = session.records[still.recording].accel, (still.stop - still.start) // 3
        first = mean_reading(accel, still.start, still.start + third) - centre
        last = mean_reading(accel, still.stop - third, still.stop) - centre
        tilts.append(float(np.arctan2(np.linalg.norm(np.cross(first, last)), first @ last)) / RADIAN_PER_DEGREE)
    return text, np.array(tilts), limit, "deg"


def _rate_figure(session: Session, stills: tuple[Still, ...]) -> _Figure:
    unit, text = session.records[0].gyro_unit, "a mean rate {value} off that of the other stills"
    temps = piece_temperatures(session, stills)
    warmed = np.isfinite(temps).any() and float(np.nanmax(temps) - np.nanmin(temps)) > WARMED_K
    means = np.array([mean_reading(session.records[s.recording].gyro, s.start, s.stop) for s in stills]).reshape(-1, 3)
    if len(stills) < 3 or not is_physical(unit) or session.kind == "thermal" or warmed or np.isnan(means).all():
        return text, np.zeros(0), np.inf, unit
    away = np.linalg.norm(means - np.nanmedian(means, axis=0), axis=1)
    return text, away, segments.BENCH_RATE_LIMIT / si_factor(unit, "rate"), unit


def check_counted_once(session: Session) -> None:
    """Raise if readings would count twice: the same recording, still or turn is stated again."""
    for (one, first), (two, second) in combinations(enumerate(session.records), 2):
        if _same(first, second):
            raise InputError(
                f"recording {two}: wanted new readings, got those of recording {one} again; take one of the two out"
            )
    pieces: tuple[tuple[str, tuple[Still | Turn, ...]], ...] = (("still", session.stills), ("turn", session.turns))
    for what, stated in pieces:
        order = sorted(range(len(stated)), key=lambda k: (stated[k].recording, stated[k].start))
        for one, two in pairwise(order):
            a, b = stated[one], stated[two]
            shared = min(a.stop, b.stop) - b.start if a.recording == b.recording else 0
            if shared > SHARED_LIMIT * min(a.stop - a.start, b.stop - b.start):
                early, late = min(one, two), max(one, two)
                raise InputError(
                    f"{piece_name(session, stated[late], late, what=what)}: wanted a stretch of its own, got one that "
                    f"shares {100.0 * shared / (stated[late].stop - stated[late].start):.0f} % of its samples with [[{what}]] "
                    f"{early + 1}; take one of the two out or correct its times"
                )


def _same(one: Record, two: Record) -> bool:
    if len(one) != len(two):
        return False
    pairs = ((one.gyro, two.gyro), (one.accel, two.accel))
    equal = all(a is b if a is None or b is None else np.array_equal(a, b, equal_nan=True) for a, b in pairs)
    return equal and any(a is not None and float(np.nanstd(a)) > 0.0 for a, _ in pairs)


# ---- turns

STOPPED_SHARE, STOP_S = 0.2, 0.2  # of the level, and s
MIN_NOISES = 8.0
TurnFault = Literal["stop", "spread", "edge"]
TURN_LIMITS: dict[TurnFault, tuple[float, float]] = {  # warn above the first, fail above the second
    "stop": (0.0, 0.05),
    "spread": (0.05, np.inf),
    "edge": (0.2, 0.5),
}
TURN_FAULTS: dict[TurnFault, str] = {
    "stop": "it overlaps a stop: in {percent} % of it the device turned at less than a fifth of its rate",
    "spread": "its rate varies by {percent} % rms (limit {limit} %)",
    "edge": "it is cut off: at its start or end it still turns at {percent} % of its largest rate (limit {limit} %)",
}


def check_turns(session: Session, stills: tuple[Still, ...], settle_s: float) -> Iterator[Finding]:
    """Compare every stated turn with one that is steady, or from rest to rest; raise if its gyroscope is dead."""
    shares: dict[TurnFault, list[tuple[float, int]]] = {"stop": [], "spread": [], "edge": []}
    saturated = saturated_turns(session, settle_s)
    for k, turn in enumerate(session.turns):
        _check_alive(session, turn, k)
        sample_rate_hz = session.records[turn.recording].sample_rate_hz
        rate = np.abs(_smooth_rate(session, stills, turn, settle_s))
        if not len(rate) or k in saturated:
            continue
        level = float(np.quantile(rate, 0.9))
        if turn.angle is not None:
            shares["edge"].append((float(rate[[0, -1]].max()) / level, k))
            continue
        stopped = rate < STOPPED_SHARE * level
        stops = sum(stop - start for start, stop in runs(stopped) if stop - start >= STOP_S * sample_rate_hz)
        shares["stop"].append((float(stops) / len(rate), k))
        shares["spread"].append((float(rate[~stopped].std() / rate[~stopped].mean()), k))
    for fault, values in shares.items():
        above = [pair for pair in values if pair[0] > TURN_LIMITS[fault][0]]
        if above:
            share, k = max(above)
            what = TURN_FAULTS[fault].format(percent=f"{100.0 * share:.3g}", limit=f"{100.0 * TURN_LIMITS[fault][0]:g}")
            yield finding(
                "turn.unsteady",
                level_of(share, TURN_LIMITS[fault]),
                turn=piece_name(session, session.turns[k], k, what="turn"),
                turns=len(above),
                percent=100.0 * share,
                what=what,
            )


def _check_alive(session: Session, turn: Turn, number: int) -> None:
    gyro = session.records[turn.recording].gyro
    if gyro is None or turn.axis is None or not (turn.turn_rate or turn.angle):
        return
    readings = gyro[turn.start : turn.stop, AXES.index(turn.axis)]
    if len(readings) > 1 and np.isfinite(readings).all() and not np.ptp(gyro[:, AXES.index(turn.axis)]):
        raise Implausible(
            f"gyroscope {turn.axis}: it reads {readings[0]:g} throughout, also in "
            f"{piece_name(session, turn, number, what='turn')} about {turn.axis}: the sensor is dead, or another column is mapped. "
            "Check the map and the device."
        )


def settling(length: int, settle_s: float, rate_hz: float) -> int:
    """Return how many samples at the start of a dwell of so many samples are left out: half of it at most."""
    return min(round(settle_s * rate_hz), length // 2)


def saturated_turns(session: Session, settle_s: float) -> tuple[int, ...]:
    """Return the numbers of the stated turns in which a gyroscope sticks at the end of its range."""
    numbers = []
    for k, turn in enumerate(session.turns):
        record = session.records[turn.recording]
        if record.gyro is not None:
            steady = turn.turn_rate is not None
            skip = settling(turn.stop - turn.start, settle_s, record.sample_rate_hz) if steady else 0
            part = record.gyro[turn.start + skip : turn.stop]
            if stuck_at_rate(part) if steady else stuck_in_motion([part]):
                numbers.append(k)
    return tuple(numbers)


def _smooth_rate(session: Session, stills: tuple[Still, ...], turn: Turn, settle_s: float) -> FloatArray:
    """Return r (N,) of a turn, raw unit; empty if it has no axis, rate or reading, or is near the noise."""
    record = session.records[turn.recording]
    if record.gyro is None or turn.axis is None or not (turn.turn_rate or turn.angle):
        return np.empty(0)
    column = record.gyro[:, AXES.index(turn.axis)]
    rests = [column[s.start : s.stop] for s in stills if s.recording == turn.recording]
    same_axis = [t for t in session.turns if (t.recording, t.axis) == (turn.recording, turn.axis)]
    rates = np.array([t.turn_rate or 0.0 for t in same_axis])
    if not rests and not np.ptp(rates):
        return np.empty(0)  # nothing shows the offset
    means = np.array([np.nanmean(values) for values in rests or [column[t.start : t.stop] for t in same_axis]])
    offset = float(means.mean() if rests else np.polynomial.Polynomial.fit(rates, means, 1)(0.0))
    skip = 0 if turn.turn_rate is None else settling(turn.stop - turn.start, settle_s, record.sample_rate_hz)
    width, values = max(1, round(SMOOTH_S * record.sample_rate_hz)), column[turn.start + skip : turn.stop] - offset
    if len(values) < 2 * width or np.isnan(values).any():
        return np.empty(0)
    rate = np.convolve(values, np.full(width, 1.0 / width), mode="valid")
    noise = float(np.diff(values).std()) / np.sqrt(2.0 * width)
    return rate if np.quantile(np.abs(rate), 0.9) > MIN_NOISES * noise else np.empty(0)


# ---- rests that a fit did not use: the length of their specific force against gravity
#
#     m_p = |f_p| - g,  f_p = M (u_p - o)       u_p the mean reading of still p, in any pose
#     s_p^2 = (M' n)' S_p (M' n) + J_p C J_p'   n = f / |f|, J = d|f| / d(M, o), C the covariance of the fit
#
# Six stills that are no faces may fit twelve parameters well: poses of a sheared cube do. Other poses then miss gravity, though
# their direction is not known. S_p contains the noise of the mean by blocks and the converter's step.

LARGEST_ANGLE_DEG = 5.0  # of a sensor to its axis of the case: parts and boards are within 1 to 3
MISS_M_S2 = (3e-3 * STANDARD_GRAVITY, 20e-3 * STANDARD_GRAVITY)  # rms: marginal above the first, bad above the second
BEYOND_SIGMAS = 4.0  # a still misses gravity by more than its uncertainty: by chance 1 of 16,000
MIN_MISSES = 2  # stills: one may be no rest
SAME_TEMPERATURE_K = 3.0


def check_accel(session: Session, model: TriadModel, unused: Sequence[Still]) -> Iterator[Finding]:
    """Compare a fitted accelerometer with the axes of a case, and with gravity in the stills that it did not use."""
    angles = np.arccos(np.clip(np.diag(model.sensor_axes), -1.0, 1.0)) / RADIAN_PER_DEGREE
    worst = int(np.argmax(angles))
    if angles[worst] > LARGEST_ANGLE_DEG:
        yield finding(
            "accel.cross_axis", "fail", axis=AXES[worst], angle_deg=angles[worst], limit_deg=LARGEST_ANGLE_DEG
        )
    yield from check_gravity_length(session, unused, model)


def unused_stills(session: Session, candidates: Sequence[Still], used: Sequence[Still | Turn]) -> tuple[Still, ...]:
    """Return the stills that share nothing with what a fit used or with a turn, at the temperature of the fit."""
    taken = [(piece.recording, piece.start, piece.stop) for piece in (*used, *session.turns)]
    unused: list[Still] = []
    for still in candidates:
        if not any(r == still.recording and a < still.stop and still.start < b for r, a, b in taken):
            unused.append(still)
            taken.append((still.recording, still.start, still.stop))
    temps, fit_temps = piece_temperatures(session, unused), piece_temperatures(session, used)
    if session.kind == "thermal" and not np.isfinite(temps).all():
        return ()
    middle = float(np.mean(fit_temps[np.isfinite(fit_temps)])) if np.isfinite(fit_temps).any() else np.nan
    return tuple(s for s, temp_c in zip(unused, temps, strict=True) if not abs(temp_c - middle) > SAME_TEMPERATURE_K)


def check_gravity_length(session: Session, stills: Sequence[Still], model: TriadModel) -> Iterator[Finding]:
    """Compare the length of the corrected specific force in stills that a fit did not use with gravity."""
    records = session.records
    readings = {still: whole_readings(records[still.recording].accel, still.start, still.stop) for still in stills}
    stills = [still for still in stills if len(readings[still]) > 1]
    if not stills:
        return
    windows = [readings[still] for still in stills]
    within = np.array([window.std(axis=0) / np.sqrt(len(window)) for window in windows])
    blocks = noise_of_means(windows, [block_size(records[still.recording].sample_rate_hz) for still in stills])
    noise = np.hypot(within if blocks is None else np.maximum(within, blocks), mean_rounding(windows, windows))
    away = np.array([window.mean(axis=0) for window in windows]) - model.offset
    force = away @ model.matrix.T
    length = np.linalg.norm(force, axis=1)
    direction = force / length[:, None]
    by_reading = direction @ model.matrix
    jacobian = np.column_stack(((direction[:, :, None] * away[:, None, :]).reshape(-1, 9), -by_reading))
    covariance = np.nan_to_num(model.covariance[:12, :12])
    variance = (by_reading**2 * noise**2).sum(axis=1) + np.einsum("pi,ij,pj->p", jacobian, covariance, jacobian)
    miss = length - session.gravity_m_s2
    beyond = int((np.abs(miss) > BEYOND_SIGMAS * np.sqrt(variance)).sum())
    rms, worst = float(np.sqrt(np.mean(miss**2))), int(np.argmax(np.abs(miss)))
    level = level_of(rms, MISS_M_S2)
    if level == "info" or not beyond:
        return
    yield finding(
        "accel.unused_stills",
        "fail" if level == "fail" and beyond >= MIN_MISSES else "warn",
        stills=len(stills),
        beyond=beyond,
        rms_m_s2=rms,
        worst_m_s2=miss[worst],
        still=piece_name(session, stills[worst], worst, stated=False),
        tilt_deg=np.arctan2(rms, session.gravity_m_s2) / RADIAN_PER_DEGREE,
    )
