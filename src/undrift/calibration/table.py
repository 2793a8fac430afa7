"""Dwells on a rate table: mean readings, about which axis of the case the table really turned, linearity of one axis.

``dwell_means`` averages the steady turns of a session, ``table_axes`` measures by gravity about which axis of the case the table
turned them, and ``imposed_rates`` returns the rates that a fit takes as its input.

The start of a dwell is left out, in which the table settles. Of the rest, whole turns are averaged if there is one, so that a
ripple of the rate and the Earth's level rate average out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.codes import code_steps, code_variance, mean_rounding
from undrift.calibration.plausibility import axis_vectors, check_saturation
from undrift.calibration.session import spans_of
from undrift.errors import InputError, NotObservable
from undrift.fit.gls import Prior, block_size, noise_of_means, solve
from undrift.fit.priors import ACCEL_FLICKER, SETTLE_S, TABLE_ARM, TABLE_MOUNTING
from undrift.model import AXES, TriadModel
from undrift.record import Axis, Face, RateTable, Record, Still, Turn
from undrift.units import EARTH_RATE, RADIAN_PER_DEGREE

MOST_SETTLING = 0.5  # of a dwell
LEAST_SAMPLES = 8
FILTER_S = 0.3  # in which a second-order filter at 11 Hz settles to 1e-6: gravity leaves out no more of a dwell's start
MIN_TILT_SD = 1e-6  # rad, of block means of the direction of gravity: sound arithmetic

# ---- mean readings of the dwells


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableAxes:
    """About which axes of the case the dwells turned, and what is not known about them."""

    direction: FloatArray  # (N, 3), axis of each dwell
    columns: FloatArray  # (N, 3, C), errors of ``direction`` by C independent causes of one standard deviation each
    off: FloatArray  # (N, 2), angle between case axis and table axis and its uncertainty, rad; NaN if gravity did not show it
    ripple: FloatArray  # (N, R), change of the rate by R independent ripples, relative, of an amplitude of one each
    rate: float  # standard uncertainty of all stated rates in common, relative
    wobble: FloatArray  # (N,), stated standard uncertainty of the axis from dwell to dwell, rad; 0 if gravity showed the axis
    mount_tilt: float  # stated standard uncertainty of the mounting, rad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DwellMeans:
    """Mean readings at steady rates."""

    reading: FloatArray  # (N, 3), mean of each dwell, ``unit``
    turn_rate: FloatArray  # (N,), achieved rate about +axis, rad/s
    axis: tuple[Axis, ...]  # axis of each dwell
    noise: FloatArray | None = None  # (N, 3), standard deviation of each mean; None if it is not known
    # (N,), 1 where +axis points up, -1 where it points down, 0 where it is not vertical; all 1 by default
    up: FloatArray = field(default_factory=lambda: np.ones(1))
    unit: str = "rad/s"  # unit of the readings
    span: FloatArray | None = None  # (N, 2), start and stop of each dwell on one clock, s; None if it is not known
    # (3,), step of the codes, 0 or NaN for none, and the variance that they leave in a mean, which is in ``noise`` too
    step: FloatArray = field(default_factory=lambda: np.zeros(3))
    codes: FloatArray = field(default_factory=lambda: np.zeros(3))
    axes: TableAxes | None = None  # about which axes the table turned the case; None takes ``axis`` as exact

    def __post_init__(self) -> None:
        n = len(self.axis)
        if self.reading.shape != (n, 3) or self.turn_rate.shape != (n,):
            raise InputError(
                f"dwells: expected readings (N, 3) and rates (N,) for {n} axes, got {self.reading.shape} and "
                f"{self.turn_rate.shape}"
            )


def table_turns(turns: Sequence[Turn]) -> list[Turn]:
    """Return the turns at stated rates."""
    return [turn for turn in turns if turn.axis is not None and turn.turn_rate is not None]


def dwell_means(
    records: Sequence[Record], turns: Sequence[Turn], *, settle_s: float = SETTLE_S, cutoff_hz: float | None = None
) -> DwellMeans:
    """Average the steady turns of a session.

    The first ``settle_s`` of each dwell are left out, but no more than half of it. The note's smoothing spline halves the signal at
    ``cutoff_hz``; None leaves it out, which changes no mean.
    """
    used = table_turns(turns)
    unit = records[used[0].recording].gyro_unit if used else "rad/s"
    parts = [_settled(records[t.recording], t, unit, settle_s) for t in used]
    windows = [np.asarray(record.gyro) for record in parts]
    smooth = [
        w if cutoff_hz is None else spline_filter(record.time, w, cutoff_hz)
        for record, w in zip(parts, windows, strict=True)
    ]
    noise = noise_of_means(windows, [block_size(records[t.recording].sample_rate_hz) for t in used])
    step = code_steps([records[k] for k in {t.recording for t in used}], rate=True)
    codes = code_variance(step, np.median([w.var(axis=0) for w in windows], axis=0)) if used else np.zeros(3)
    return DwellMeans(
        reading=np.array([w.mean(axis=0) for w in smooth]).reshape(-1, 3),
        turn_rate=np.array([t.turn_rate for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        noise=None if noise is None else np.hypot(noise, np.sqrt(codes)),
        up=np.array([_points_up(record, AXES.index(t.axis or "x")) for record, t in zip(parts, used, strict=True)]),
        unit=unit,
        span=spans_of(records, used),
        step=step,
        codes=codes,
    )


def steady(record: Record, turn: Turn, settle_s: float) -> slice:
    """Return the samples of a dwell that are averaged: without its start, and whole turns if it has one."""
    time = record.time[turn.start : turn.stop]
    length_s = float(time[-1] - time[0])
    start_s = float(time[0]) + min(settle_s, MOST_SETTLING * length_s)
    period_s = 2.0 * np.pi / abs(turn.turn_rate) if turn.turn_rate else np.inf
    turns = int((time[-1] - start_s) / period_s)
    begin = int(np.searchsorted(time, start_s))
    stop = int(np.searchsorted(time, start_s + turns * period_s)) if turns else len(time)
    return slice(turn.start + begin, turn.start + stop)


def spline_filter(time: FloatArray, values: FloatArray, cutoff_hz: float) -> FloatArray:
    """Smooth each column of values (N, 3) with the note's cubic smoothing spline.

    It minimises sum (y - f)^2 + lambda integral f''^2: a low-pass of fourth order that halves the signal at the frequency w with
    lambda dt w^4 = 1. It keeps straight lines, so the mean over its samples is the mean of the readings, to rounding.
    """
    from scipy.interpolate import make_smoothing_spline

    stiffness = 1.0 / (float(np.median(np.diff(time))) * (2.0 * np.pi * cutoff_hz) ** 4)
    own = time - time[0]
    return np.column_stack([make_smoothing_spline(own, column, lam=stiffness)(own) for column in values.T])


def _settled(record: Record, turn: Turn, unit: str, settle_s: float) -> Record:
    if record.gyro is None or record.gyro_unit != unit:
        raise InputError(
            f"rate table: wanted gyroscope readings in {unit} in every recording, got "
            f"{'none' if record.gyro is None else record.gyro_unit} in recording {turn.recording}; map the columns alike"
        )
    used = steady(record, turn, settle_s)
    dwell = record.part(used.start, used.stop)
    if len(dwell) < LEAST_SAMPLES:
        raise InputError(
            f"dwell [{turn.start}, {turn.stop}): wanted {LEAST_SAMPLES} samples or more after the start in which the table "
            f"settles, got {len(dwell)}; dwell longer"
        )
    values = np.asarray(dwell.gyro)
    gaps = int(np.isnan(values).any(axis=1).sum())
    if gaps:
        raise InputError(f"dwell [{turn.start}, {turn.stop}): wanted readings without gaps, got {gaps}; shorten it")
    check_saturation(values, f"gyroscope at {turn.turn_rate:.4g} rad/s about {turn.axis}")
    return dwell


def _points_up(part: Record, axis: int) -> float:
    if part.accel is None or part.accel_unit in ("count", "v"):
        return 1.0
    mean = np.nanmean(part.accel, axis=0)
    share = float(mean[axis] / np.linalg.norm(mean)) if np.linalg.norm(mean) > 0.0 else 0.0
    return float(np.sign(share)) if abs(share) > 0.9 else 0.0


def imposed_rates(dwells: DwellMeans, latitude_deg: float | None) -> FloatArray:
    """Return the true rate of each dwell in b (N, 3), rad/s: L of eq. 4, transposed."""
    earth = 0.0 if latitude_deg is None else EARTH_RATE * np.sin(latitude_deg * RADIAN_PER_DEGREE)
    axis_b = axis_vectors(dwells.axis) if dwells.axes is None else dwells.axes.direction
    return np.asarray(axis_b * (dwells.turn_rate + earth * dwells.up)[:, None])


# ---- axis of the table in the case, from gravity as the accelerometers measure it
#
# In one mounting, axis k of the case lies along the axis of the table. During dwell i the device turns about k + d + e_i: d is
# small, across k and common to the mounting, e_i is the wobble of the dwell. The axis of the table leaves the vertical by l + e'_i,
# and the accelerometers are at a distance r from it. Block means of the specific force across k, at the rate w_i and azimuth psi:
#
#     f / g = d + e_i + R_k(-psi) (l + e'_i) - r w_i^2 / g
#
# All are fitted with their priors; the sizes of noise and wobble are excess variances. psi is the integral of the gyroscope of axis
# k. The errors of the accelerometers are common to all mountings: df = dM s - M do. Without accelerometers d and e_i are zero, with
# the stated uncertainties of mounting and wobble.


def mountings(pieces: Sequence[Still | Turn]) -> IntArray:
    """Return the number of the mounting on a rate table of each piece (P,), -1 off the table.

    Turns about one axis at stated rates and rests with that axis up belong together as long as nothing else comes between.
    """
    runs: list[list[int]] = [[]]
    axis: Axis | None = None
    face: Face | None = None
    for n in sorted(range(len(pieces)), key=lambda n: (pieces[n].recording, pieces[n].start)):
        piece = pieces[n]
        if isinstance(piece, Turn):
            up, about = None, None if piece.turn_rate is None else piece.axis
        elif piece.face is not None:
            up, about = piece.face, AXES["xyz".index(piece.face[-1])]
        else:
            continue  # a rest in any pose
        if about is None or about != axis or (up and face and up != face):
            runs.append([])
            face = None
        axis, face = about, up or face
        runs[-1] += [n] if about else []
    numbers = np.full(len(pieces), -1)
    for number, run in enumerate(runs):
        if any(isinstance(pieces[n], Turn) for n in run):
            numbers[run] = number
    return numbers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Mounting:
    """Dwells of one mounting on the table: R of them, about axis k of the case."""

    records: Sequence[Record]
    turns: Sequence[Turn]  # (R,), in order of their recordings
    k: int
    gravity: float  # specific force along +axis k, m/s2; 0 if the axis is not vertical
    line: FloatArray  # (2,), scale factor and offset of the gyroscope of axis k; NaN if its dwells do not show them
    settle_s: float  # start of each dwell that is left out, s

    @property
    def across(self) -> list[int]:
        """The two axes of the case across the table's."""
        return [(self.k + 1) % 3, (self.k + 2) % 3]

    def azimuth(self, number: int) -> FloatArray | None:
        """Return the angle of the table (N,) at the samples of a recording, from its first dwell to its last; None in a gap."""
        own, record = [turn for turn in self.turns if turn.recording == number], self.records[number]
        begin, end = min(turn.start for turn in own), max(turn.stop for turn in own)
        if record.gyro is None or np.isnan([*self.line, record.gyro[begin:end].sum()]).any():
            return None
        rate = (record.gyro[begin:end, self.k] - self.line[1]) / self.line[0]
        angle = np.full(len(record), np.nan)
        angle[begin:end] = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(record.time[begin:end])))
        return angle


def table_axes(
    records: Sequence[Record],
    turns: Sequence[Turn],
    dwells: DwellMeans,
    mounting: IntArray,
    *,
    table: RateTable,
    accel: TriadModel | None,
    gravity_m_s2: float,
    settle_s: float,
) -> TableAxes:
    """Return the axes about which dwells turned the case; accelerometers measure them if there are any.

    ``turns`` (N,) are those of the dwells, and ``mounting`` (N,) is the number of the mounting of each.
    """
    axis, count = np.array([AXES.index(name) for name in dwells.axis], int), len(dwells.axis)
    lines = [_line(dwells.turn_rate[axis == k], dwells.reading[axis == k, k]) for k in range(3)]
    groups: dict[tuple[int, int, float], list[int]] = {}
    for n in sorted(range(count), key=lambda n: turns[n].recording):
        groups.setdefault((int(mounting[n]), int(axis[n]), float(np.broadcast_to(dwells.up, count)[n])), []).append(n)
    direction: FloatArray = np.eye(3)[axis]
    off: FloatArray = np.full((count, 2), np.nan)
    mount_tilt = table.mount_tilt_deg * RADIAN_PER_DEGREE
    wobble = np.full(count, table.wobble_deg * RADIAN_PER_DEGREE)
    by_accel: FloatArray = np.zeros((count, 3, 12))
    columns = list[FloatArray]()
    for (_, k, up), rows in groups.items():
        group = _Mounting(
            records=records, turns=[turns[n] for n in rows], k=k, gravity=up * gravity_m_s2, line=lines[k], settle_s=settle_s
        )  # fmt: skip
        tilts = None if accel is None or up == 0.0 else _axes_by_gravity(group, table, accel)
        if tilts is None or accel is None:
            root: FloatArray = np.tile(mount_tilt * np.eye(2), (len(rows), 1, 1))
        else:
            direction[np.ix_(rows, group.across)], root, off[rows] = tilts
            wobble[rows] = 0.0
            reading = np.linalg.solve(accel.matrix, np.eye(3)[k])  # in g, minus the offset
            by_matrix, by_offset = np.kron(np.eye(3), reading), accel.matrix / group.gravity
            by_accel[np.ix_(rows, group.across)] = np.hstack((by_matrix, -by_offset))[group.across]
        columns.append(np.zeros((count, 3, root.shape[2])))
        columns[-1][np.ix_(rows, group.across)] = root
    if accel is not None:
        variance, vectors = np.linalg.eigh(accel.covariance[:12, :12])
        columns.append(by_accel @ (vectors * np.sqrt(variance.clip(0.0))))
    return TableAxes(
        direction=direction / np.linalg.norm(direction, axis=1)[:, None],
        columns=np.concatenate(columns, axis=2),
        off=off,
        ripple=_ripples(records, turns, mounting, lines, settle_s),
        rate=table.rate_uncertainty,
        wobble=wobble,
        mount_tilt=mount_tilt,
    )


def _ripples(
    records: Sequence[Record], turns: Sequence[Turn], mounting: IntArray, lines: list[FloatArray], settle_s: float
) -> FloatArray:
    """Return the mean cosine and sine of the table's azimuth in each dwell (N, R), for each stretch in which it is known.

    The rate ripples once a turn, by a cos psi + b sin psi. Over whole turns this averages out. Shorter dwells of one mounting start
    where the ones before ended, and err alike.
    """
    keys = [(turn.recording, int(number)) for turn, number in zip(turns, mounting, strict=True)]
    columns = [np.zeros((len(turns), 0))]
    for key in sorted(set(keys)):
        rows = [n for n, other in enumerate(keys) if other == key]
        k = AXES.index(turns[rows[0]].axis or "x")
        group = _Mounting(
            records=records, turns=[turns[n] for n in rows], k=k, gravity=0.0, line=lines[k], settle_s=settle_s
        )
        angle, pair = group.azimuth(key[0]), np.zeros((len(turns), 2))
        for n in rows if angle is not None else []:
            psi = angle[steady(records[key[0]], turns[n], settle_s)]  # type: ignore[index]
            if np.ptp(psi) < 0.99 * 2.0 * np.pi:
                pair[n] = np.cos(psi).mean(), np.sin(psi).mean()
        columns.append(pair)
    return np.hstack(columns)


def _line(rate: FloatArray, reading: FloatArray) -> FloatArray:
    if len(np.unique(rate)) < 2:
        return np.full(2, np.nan)
    return np.asarray(np.linalg.lstsq(np.column_stack((rate, np.ones_like(rate))), reading, rcond=None)[0])


def _axes_by_gravity(
    group: _Mounting, table: RateTable, accel: TriadModel
) -> tuple[FloatArray, FloatArray, tuple[float, float]] | None:
    """Return d + e_i (R, 2) of the dwells of a mounting, a root of their covariance (R, 2, C), and |d| with its uncertainty.

    Return None if gaps hide the azimuth or the force.
    """
    count, recordings = len(group.turns), sorted({turn.recording for turn in group.turns})
    common = 4 + 2 * len(recordings)  # d, r, and l of each recording; then e_i and e'_i of each dwell
    design, across = list[FloatArray](), list[FloatArray]()
    azimuths = {number: group.azimuth(number) for number in recordings}
    for n, turn in enumerate(group.turns):
        record, azimuth = group.records[turn.recording], azimuths[turn.recording]
        if azimuth is None or record.accel is None:
            return None
        window = steady(record, turn, min(group.settle_s, FILTER_S))
        force = (np.asarray(record.accel)[window] - accel.offset) @ accel.matrix.T / group.gravity
        parts = np.column_stack((np.cos(azimuth[window]), np.sin(azimuth[window]), force[:, group.across]))
        size = block_size(record.sample_rate_hz)
        means = parts[: len(parts) // size * size].reshape(-1, size, 4).mean(axis=1)
        means = means[~np.isnan(means).any(axis=1)]
        if not len(means):
            return None
        turned = np.stack((means[:, [0, 1]], means[:, [1, 0]] * [-1.0, 1.0]), axis=1)  # R_k(-psi)
        level_column, wobble_column = 4 + 2 * recordings.index(turn.recording), common + 2 * n
        block = np.zeros((len(means), 2, common + 4 * count))
        block[:, :, :2] = block[:, :, wobble_column : wobble_column + 2] = np.eye(2)
        block[:, :, 2:4] = (turn.turn_rate or 0.0) ** 2 / group.gravity * np.eye(2)
        block[:, :, level_column : level_column + 2] = turned
        block[:, :, wobble_column + 2 * count : wobble_column + 2 * count + 2] = turned
        design.append(block.reshape(-1, block.shape[2]))
        across.append(means[:, 2:].ravel())
    level, stated = max(table.table_level_deg * RADIAN_PER_DEGREE, MIN_TILT_SD), table.wobble_deg * RADIAN_PER_DEGREE
    sizes = np.repeat([TABLE_MOUNTING, TABLE_ARM, level], [2, 2, 2 * len(recordings)])
    matrix, felt = np.vstack(design), np.concatenate(across)
    noise, wobbles = np.full(len(felt), MIN_TILT_SD**2), matrix[:, common:] @ matrix[:, common:].T
    scatter = solve(
        matrix[:, :common],
        felt,
        {"noise": noise, "wobble": stated**2 * wobbles},
        excess={"noise": np.ones(len(felt)), "wobble": wobbles},
        prior=Prior(mean=np.zeros(common), precision=np.diag(sizes**-2)),
    )
    # the same rows, with the wobble of each dwell among the parameters
    wobble_sd = max(stated**2 + scatter.excess_bound("wobble"), MIN_TILT_SD**2) ** 0.5
    sizes = np.concatenate((sizes, np.full(4 * count, wobble_sd)))
    fit = solve(
        matrix,
        felt,
        {"noise": noise + scatter.excess_bound("noise")},
        prior=Prior(mean=np.zeros(len(sizes)), precision=np.diag(sizes**-2)),
    )
    to_axes = np.zeros((2 * count, len(sizes)))  # d + e_i
    to_axes[:, :2] = np.tile(np.eye(2), (count, 1))
    to_axes[:, common : common + 2 * count] = np.eye(2 * count)
    flicker = (ACCEL_FLICKER / group.gravity) ** 2 * np.eye(2 * count)
    root = np.linalg.cholesky(to_axes @ fit.covariance @ to_axes.T + flicker)
    readings = [np.asarray(record.accel) for record in group.records]
    windows = [readings[turn.recording][turn.start : turn.stop] for turn in group.turns]
    # all dwells feel one gravity, and so read one code
    codes = accel.matrix[group.across] / group.gravity * np.nan_to_num(mean_rounding(readings, windows))
    return (
        (to_axes @ fit.theta).reshape(-1, 2),
        np.concatenate((root.reshape(count, 2, -1), np.broadcast_to(codes, (count, 2, 3))), axis=2),
        (float(np.hypot(*fit.theta[:2])), float(np.sqrt(fit.covariance[0, 0]))),
    )


# ---- linearity of one axis (IEEE Std 1431, clause 12 terms)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearity:
    """Table of one axis: imposed rate, and how far the reading is from the line."""

    axis: Axis  # x, y or z
    turn_rate: FloatArray  # (N,), imposed, rad/s, increasing
    error: FloatArray  # (N,), reading less line, in rad/s of input
    scale_factor: float  # Slope of the line, reading per rad/s
    offset: float  # Reading of the line at zero rate
    scale_factor_nonlinearity: float  # Largest departure from the line, rad/s
    scale_factor_nonlinearity_percent: float  # The same in per cent of the largest imposed rate
    # 2 (S+ - S-) / (S+ + S-) of reading = o + S+ max(w, 0) + S- min(w, 0); NaN for one sign
    scale_factor_asymmetry: float


def linearity(reading: FloatArray, turn_rate: FloatArray, axis: Axis) -> Linearity:
    """Compare readings (N,) of one axis at rates (N,) with their least-squares line, reading = o + S w."""
    if len(np.unique(turn_rate)) < 2:
        raise NotObservable(
            f"rate axis {axis}: wanted dwells at two different rates or more, got {len(np.unique(turn_rate))}; "
            "record both signs of several rates"
        )
    order = np.argsort(turn_rate)
    rate, value = turn_rate[order], reading[order]
    offset, slope = np.linalg.lstsq(np.column_stack((np.ones_like(rate), rate)), value, rcond=None)[0]
    error = (value - offset - slope * rate) / slope
    worst, asymmetry = float(np.abs(error).max()), float("nan")
    if len(np.unique(rate)) > 2 and rate[0] < 0.0 < rate[-1]:
        bent = np.column_stack((np.ones_like(rate), np.maximum(rate, 0.0), np.minimum(rate, 0.0)))
        _, plus, minus = np.linalg.lstsq(bent, value, rcond=None)[0]
        asymmetry = float(2.0 * (plus - minus) / (plus + minus))
    return Linearity(
        axis=axis,
        turn_rate=rate,
        error=error,
        scale_factor=float(slope),
        offset=float(offset),
        scale_factor_nonlinearity=worst,
        scale_factor_nonlinearity_percent=100.0 * worst / float(np.abs(rate).max()),
        scale_factor_asymmetry=asymmetry,
    )
