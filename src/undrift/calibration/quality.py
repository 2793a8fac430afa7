"""Are the rests and turns of a session what it says they are, and do rests that a fit did not use agree with gravity?

A still is compared with a device at rest by three figures, which do not depend on the offset of its sensors:

    sway    largest standard deviation of the readings, smoothed over 0.1 s, in a window of 1 s; three axes together
    tilt    angle between the mean specific force of its first and of its last third
    rate    mean rate reading minus its median over all stills: a slow turn that no window shows

Above the limit of a bench the worst still is a finding; above three times the limit the session is refused. Readings in counts
have no such limit, and a still is then compared with the other stills. A turn is judged by r, the reading of the turned axis minus
its offset, smoothed over 0.1 s, relative to the 90 % quantile of abs(r):

    stop     share of a settled dwell in stretches of 0.2 s or more with abs(r) below a fifth
    spread   standard deviation of the rest of r, relative to its mean
    edge     abs(r) at the start or end of a turn by an angle: part of the angle is missing
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Literal

import numpy as np

from undrift import segments
from undrift.arrays import FloatArray, runs
from undrift.calibration.codes import code_steps, mean_rounding
from undrift.calibration.plausibility import stuck_axis
from undrift.errors import Implausible, InputError
from undrift.findings import Finding, finding
from undrift.fit.gls import block_size, noise_of_means
from undrift.model import AXES, TriadModel
from undrift.record import Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

TILT_LIMIT_DEG = 0.5  # a device that settles on a bench or a cushion stays below it
REFUSED_RATIO = 3.0  # of a figure to its limit: the device does not rest
COUNTS_RATIO = 10.0  # a still in counts may spread this many times the median of all stills
SHARED_LIMIT = 0.1  # of the shorter of two stretches: they count twice
WARMED_K = 10.0  # between stills: offsets may then differ
SAME_TEMPERATURE_K = 3.0
SMOOTH_S = 0.1


# ---- names and readings of pieces


def piece_name(session: Session, piece: Still | Turn, number: int, *, what: str = "still", stated: bool = True) -> str:
    """Return the name of a still or turn in messages, with its recording and time."""
    time = session.records[piece.recording].time
    name = f"[[{what}]] {number + 1}" if stated else f"{what} found"
    return f"{name} (recording {piece.recording}, {time[piece.start]:.1f}-{time[piece.stop - 1]:.1f} s)"


def whole_readings(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return the readings (n, 3) of a stretch without gaps; empty if the triad is missing."""
    readings = np.zeros((0, 3)) if values is None else values[start:stop]
    return readings[~np.isnan(readings).any(axis=1)]


def mean_reading(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return the mean reading (3,) of a stretch, NaN if there is none."""
    readings = whole_readings(values, start, stop)
    return np.asarray(readings.mean(axis=0)) if len(readings) else np.full(3, np.nan)


def piece_temperatures(session: Session, pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the temperature of each still or turn, as stated or as recorded; NaN if there is none."""
    temps = []
    for piece in pieces:
        column = session.records[piece.recording].temp_c
        recorded = np.zeros(0) if column is None else column[piece.start : piece.stop]
        recorded = recorded[np.isfinite(recorded)]
        temps.append(piece.temp_c if piece.temp_c is not None else recorded.mean() if len(recorded) else np.nan)
    return np.array(temps)


# ---- stills


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Figure:
    """One figure of all stills, NaN if a still has none, and its limit in the same unit."""

    text: str
    values: FloatArray
    limit: float
    unit: str


def check_stills(session: Session, stills: tuple[Still, ...], *, stated: bool) -> tuple[Finding, ...]:
    """Compare every still with a device at rest; raise if one is far from it."""
    figures = [_rates(session, stills)]
    if stated:
        figures += [_sway(session, stills, "gyro"), _sway(session, stills, "accel"), _tilts(session, stills)]
    ratios = np.nan_to_num([figure.values / figure.limit for figure in figures])
    if not (ratios > 1.0).any():
        return ()
    which, number = (int(k) for k in np.unravel_index(ratios.argmax(), ratios.shape))
    unit, value = figures[which].unit.replace("dps", "deg/s"), figures[which].values[number]
    if unit == "rad/s":
        unit, value = "deg/s", value / RADIAN_PER_DEGREE
    name = piece_name(session, stills[number], number, stated=stated)
    what = figures[which].text.format(value=f"{value:.3g} {unit}")
    moving = finding("still.moving", "warn", still=name, stills=int((ratios > 1.0).any(axis=0).sum()), what=what)
    # Stills found in one recording may drift while it warms up; separate recordings may be in different units.
    if ratios.max() > REFUSED_RATIO and (stated or len(session.records) > 1):
        raise Implausible(f"{name}: expected a device at rest, got {what}; {moving.action}", still=number)
    return (moving,)


def _sway(session: Session, stills: tuple[Still, ...], triad: Literal["gyro", "accel"]) -> _Figure:
    gyro, unit, values = triad == "gyro", getattr(session.records[0], f"{triad}_unit"), np.full(len(stills), np.nan)
    for number, still in enumerate(stills):
        record = session.records[still.recording]
        readings, smooth = getattr(record, triad), max(1, round(SMOOTH_S * record.sample_rate_hz))
        window = min(segments.sample_count(1.0, record.sample_rate_hz), still.stop - still.start - smooth + 1)
        if readings is not None and window > 1:
            spread = segments.sliding_moments(readings[still.start : still.stop], window, smooth)[1]
            values[number] = np.max(spread[np.isfinite(spread)], initial=0.0)
    known, limit = values[np.isfinite(values)], np.inf
    if is_physical(unit):
        bench_limit = segments.BENCH_RATE_LIMIT if gyro else segments.BENCH_ACCEL_LIMIT
        limit = bench_limit / si_factor(unit, "rate" if gyro else "accel")
    elif len(known) > 2:  # a reading at rest may toggle between two codes
        step = float(np.nan_to_num(code_steps(session.records, rate=gyro)).max())
        limit = max(COUNTS_RATIO * float(np.median(known)), step, 1e-300)
    return _Figure(text="readings that sway by up to {value} rms", values=values, limit=limit, unit=unit)


def _tilts(session: Session, stills: tuple[Still, ...]) -> _Figure:
    text = "a tilt of {value} from its first to its last third"
    tilts: FloatArray = np.full(len(stills), np.nan)
    centre: FloatArray = np.zeros(3)
    limit = TILT_LIMIT_DEG
    if not is_physical(session.records[0].accel_unit):  # counts: about the centre of a sphere through enough rests
        means = np.array([mean_reading(session.records[s.recording].accel, s.start, s.stop) for s in stills])
        if len(means) < 6 or not np.isfinite(means).all():
            return _Figure(text=text, values=tilts, limit=limit, unit="deg")
        centre, radius = segments.sphere_of(means)
        step = float(np.nan_to_num(code_steps(session.records, rate=False)).max())
        limit += 2.0 * step / radius / RADIAN_PER_DEGREE
    for number, still in enumerate(stills):
        accel, third = session.records[still.recording].accel, (still.stop - still.start) // 3
        first = mean_reading(accel, still.start, still.start + third) - centre
        last = mean_reading(accel, still.stop - third, still.stop) - centre
        tilts[number] = np.arctan2(np.linalg.norm(np.cross(first, last)), first @ last) / RADIAN_PER_DEGREE
    return _Figure(text=text, values=tilts, limit=limit, unit="deg")


def _rates(session: Session, stills: tuple[Still, ...]) -> _Figure:
    unit, temps = session.records[0].gyro_unit, piece_temperatures(session, stills)
    means = np.array([mean_reading(session.records[s.recording].gyro, s.start, s.stop) for s in stills]).reshape(-1, 3)
    away, limit = np.full(len(stills), np.nan), np.inf
    warmed = np.isfinite(temps).any() and float(np.nanmax(temps) - np.nanmin(temps)) > WARMED_K
    comparable = len(stills) > 2 and is_physical(unit) and session.kind != "thermal" and not warmed
    if comparable and np.isfinite(means).any():
        away = np.linalg.norm(means - np.nanmedian(means, axis=0), axis=1)
        limit = segments.BENCH_RATE_LIMIT / si_factor(unit, "rate")
    return _Figure(text="a mean rate {value} off that of the other stills", values=away, limit=limit, unit=unit)


def check_counted_once(session: Session) -> None:
    """Raise if readings would count twice: the same recording, still or turn is stated again."""
    for (one, first), (two, second) in combinations(enumerate(session.records), 2):
        if _same(first.gyro, second.gyro) and _same(first.accel, second.accel):
            raise InputError(
                f"recording {two}: it contains the readings of recording {one} again. Remove one of the two."
            )
    pieces: tuple[tuple[str, tuple[Still | Turn, ...]], ...] = (("still", session.stills), ("turn", session.turns))
    for what, stated in pieces:
        order = sorted(range(len(stated)), key=lambda k: (stated[k].recording, stated[k].start))
        for one, two in pairwise(order):
            a, b = stated[one], stated[two]
            shared = min(a.stop, b.stop) - b.start if a.recording == b.recording else 0
            if shared > SHARED_LIMIT * min(a.stop - a.start, b.stop - b.start):
                early, late = min(one, two), max(one, two)
                share = 100.0 * shared / (stated[late].stop - stated[late].start)
                raise InputError(
                    f"{piece_name(session, stated[late], late, what=what)}: it shares {share:.0f} % of its samples with "
                    f"[[{what}]] {early + 1}. Remove one of the two or correct its times."
                )


def _same(one: FloatArray | None, two: FloatArray | None) -> bool:
    return one is two or (one is not None and two is not None and np.array_equal(one, two, equal_nan=True))


# ---- turns

STOPPED_SHARE, STOP_S = 0.2, 0.2  # of the level, and s
MIN_NOISES = 8.0  # the level in white noises of r, below which a turn is not judged
CUT_OFF_SHARE = 0.5  # of the level: a turn that starts or ends so fast is cut off
STOP_LIMITS, SPREAD_LIMITS, EDGE_LIMITS = (0.0, 0.05), (0.05, np.inf), (0.2, CUT_OFF_SHARE)  # warn and fail above them


def check_turns(session: Session, stills: tuple[Still, ...], settle_s: float) -> Iterator[Finding]:
    """Compare every stated turn with one that is steady, or from rest to rest; raise if its gyroscope is dead."""
    faults: list[tuple[bool, float, int, str]] = []  # fail, share, number of the turn, sentence
    saturated = saturated_turns(session, settle_s)
    for number, turn in enumerate(session.turns):
        rate = np.abs(_smooth_rate(session, stills, turn, settle_s))
        if not len(rate) or number in saturated:
            continue
        rate /= np.quantile(rate, 0.9)
        if turn.angle is not None:
            edge = float(rate[[0, -1]].max())
            what = f"it is cut off: at its start or end it still turns at {100.0 * edge:.3g} % of its largest rate"
            shares = [(edge, EDGE_LIMITS, what)]
        else:
            least = STOP_S * session.records[turn.recording].sample_rate_hz
            lengths = np.diff(runs(rate < STOPPED_SHARE))
            stop, steady = float(lengths[lengths >= least].sum()) / len(rate), rate[rate >= STOPPED_SHARE]
            spread = float(steady.std() / steady.mean())
            what = (
                f"it overlaps a stop: in {100.0 * stop:.3g} % of it the device turned at less than a fifth of its rate"
            )
            shares = [
                (stop, STOP_LIMITS, what),
                (spread, SPREAD_LIMITS, f"its rate varies by {100.0 * spread:.3g} % rms"),
            ]
        faults += [(share > fail, share, number, what) for share, (warn, fail), what in shares if share > warn]
    if faults:
        fail, share, number, what = max(faults)
        name = piece_name(session, session.turns[number], number, what="turn")
        count = len({turn for _, _, turn, _ in faults})
        yield finding(
            "turn.unsteady", "fail" if fail else "warn", turn=name, turns=count, percent=100.0 * share, what=what
        )


def settling(length: int, settle_s: float, rate_hz: float) -> int:
    """Return how many samples at the start of a dwell of so many samples are left out: half of it at most."""
    return min(round(settle_s * rate_hz), length // 2)


def saturated_turns(session: Session, settle_s: float) -> tuple[int, ...]:
    """Return the numbers of the stated turns in which a gyroscope sticks at the end of its range."""
    numbers = []
    for number, turn in enumerate(session.turns):
        record, start = session.records[turn.recording], turn.start
        if turn.turn_rate is not None:
            start += settling(turn.stop - turn.start, settle_s, record.sample_rate_hz)
        if record.gyro is not None and stuck_axis([record.gyro[start : turn.stop]]):
            numbers.append(number)
    return tuple(numbers)


def _smooth_rate(session: Session, stills: tuple[Still, ...], turn: Turn, settle_s: float) -> FloatArray:
    """Return r (N,) of a turn, raw unit; empty if it has no axis, rate or reading, or is near the noise."""
    record = session.records[turn.recording]
    if record.gyro is None or turn.axis is None or not (turn.turn_rate or turn.angle):
        return np.empty(0)
    column = record.gyro[:, AXES.index(turn.axis)]
    if len(column) > 1 and np.isfinite(column).all() and not np.ptp(column):
        raise Implausible(
            f"gyroscope {turn.axis}: it reads {column[0]:g} throughout, also while the device turns about {turn.axis}: the sensor "
            "is dead, or another column is mapped. Check the map and the device."
        )
    rests = [column[still.start : still.stop] for still in stills if still.recording == turn.recording]
    if not rests:
        return np.empty(0)  # nothing shows the offset
    offset = float(np.mean([np.nanmean(readings) for readings in rests]))
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
WARN_MISS, FAIL_MISS = 3e-3 * STANDARD_GRAVITY, 20e-3 * STANDARD_GRAVITY  # m/s2 rms
BEYOND_SIGMAS = 4.0  # a still misses gravity by more than its uncertainty: by chance 1 of 16,000
MIN_MISSES = 2  # stills that fail: one may be no rest


def check_accel(session: Session, model: TriadModel, unused: Sequence[Still]) -> Iterator[Finding]:
    """Compare a fitted accelerometer with the axes of a case, and with gravity in the stills that it did not use."""
    angles = np.arccos(np.clip(np.diag(model.sensor_axes), -1.0, 1.0)) / RADIAN_PER_DEGREE
    worst = int(np.argmax(angles))
    if angles[worst] > LARGEST_ANGLE_DEG:
        angle_deg = angles[worst]
        yield finding("accel.cross_axis", "fail", axis=AXES[worst], angle_deg=angle_deg, limit_deg=LARGEST_ANGLE_DEG)
    yield from check_gravity_length(session, unused, model)


def unused_stills(session: Session, candidates: Sequence[Still], used: Sequence[Still | Turn]) -> tuple[Still, ...]:
    """Return the stills that share nothing with what a fit used or with a turn, at the temperature of the fit."""
    taken: list[Still | Turn] = [*used, *session.turns]
    unused: list[Still] = []
    for still in candidates:
        if not any(p.recording == still.recording and p.start < still.stop and still.start < p.stop for p in taken):
            unused.append(still)
            taken.append(still)
    temps, fit_temps = piece_temperatures(session, unused), piece_temperatures(session, used)
    if session.kind == "thermal" and not np.isfinite(temps).all():
        return ()
    middle = float(np.mean(fit_temps[np.isfinite(fit_temps)])) if np.isfinite(fit_temps).any() else np.nan
    return tuple(s for s, temp_c in zip(unused, temps, strict=True) if not abs(temp_c - middle) > SAME_TEMPERATURE_K)


def check_gravity_length(session: Session, stills: Sequence[Still], model: TriadModel) -> Iterator[Finding]:
    """Compare the length of the corrected specific force in stills that a fit did not use with gravity."""
    records = session.records
    readings = [whole_readings(records[still.recording].accel, still.start, still.stop) for still in stills]
    stills = [still for still, window in zip(stills, readings, strict=True) if len(window) > 1]
    windows = [window for window in readings if len(window) > 1]
    if not stills:
        return
    white = np.array([window.std(axis=0) / np.sqrt(len(window)) for window in windows])
    blocks = noise_of_means(windows, [block_size(records[still.recording].sample_rate_hz) for still in stills])
    noise = np.hypot(white if blocks is None else np.maximum(white, blocks), mean_rounding(windows, windows))
    away = np.array([window.mean(axis=0) for window in windows]) - model.offset
    force = away @ model.matrix.T
    direction = force / np.linalg.norm(force, axis=1)[:, None]
    by_reading = direction @ model.matrix
    jacobian = np.column_stack(((direction[:, :, None] * away[:, None, :]).reshape(-1, 9), -by_reading))
    covariance = np.nan_to_num(model.covariance[:12, :12])
    variance = (by_reading**2 * noise**2).sum(axis=1) + np.einsum("pi,ij,pj->p", jacobian, covariance, jacobian)
    miss = np.linalg.norm(force, axis=1) - session.gravity_m_s2
    beyond = int((np.abs(miss) > BEYOND_SIGMAS * np.sqrt(variance)).sum())
    rms, worst = float(np.sqrt(np.mean(miss**2))), int(np.argmax(np.abs(miss)))
    if rms > WARN_MISS and beyond:
        yield finding(
            "accel.unused_stills",
            "fail" if rms > FAIL_MISS and beyond >= MIN_MISSES else "warn",
            stills=len(stills),
            beyond=beyond,
            rms_m_s2=rms,
            worst_m_s2=miss[worst],
            still=piece_name(session, stills[worst], worst, stated=False),
            tilt_deg=np.arctan2(rms, session.gravity_m_s2) / RADIAN_PER_DEGREE,
        )
