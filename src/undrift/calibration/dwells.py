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
from undrift.calibration.codes import code_steps, code_variance
from undrift.calibration.plausibility import axis_vectors, check_saturation
from undrift.calibration.session import middles, spans_of
from undrift.errors import InputError, NotObservable
from undrift.fit.gls import Prior, solve
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.fit.priors import ACCEL_FLICKER, SETTLE_S, TABLE_ARM, TABLE_MOUNTING
from undrift.model import AXES, TriadModel
from undrift.record import Axis, Face, RateTable, Record, Still, Turn
from undrift.units import EARTH_RATE, RADIAN_PER_DEGREE

SHOWS = 3.0  # standard errors by which one scatter must exceed another to count
MOST_SETTLING = 0.5  # of a dwell
FILTER_S = (
    0.3  # in which a second-order filter at 11 Hz settles to 1e-6; gravity takes no more from the start of a dwell
)

# ---- the dwells of a session


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dwells:
    """The dwells of a session as its recordings hold them."""

    records: Sequence[Record]
    turns: Sequence[Turn]  # Those with an axis and a rate
    mounting: IntArray  # (N,), number of the mounting of each
    reading: FloatArray  # (N, 3), mean gyroscope reading of each
    up: FloatArray  # (N,), 1 where +axis points up, -1 down, 0 where it is not vertical
    settle_s: float  # Start of each that is left out, s

    def settled(self, k: int) -> slice:
        """Return the samples of a dwell that are averaged."""
        return steady(self.records[self.turns[k].recording], self.turns[k], self.settle_s)

    def steady_gravity(self, k: int) -> slice:
        """Return the samples of a dwell that show its axis: the rate of the table may still settle."""
        return steady(self.records[self.turns[k].recording], self.turns[k], min(self.settle_s, FILTER_S))

    @property
    def sizes(self) -> list[int]:
        """Samples of a block of each dwell, (N,)."""
        of = {k: block_size(self.records[k].sample_rate_hz) for k in {turn.recording for turn in self.turns}}
        return [of[turn.recording] for turn in self.turns]

    @property
    def own(self) -> IntArray:
        """Number of the axis of each dwell, (N,)."""
        return np.array([AXES.index(turn.axis or "x") for turn in self.turns], int)

    @property
    def turn_rate(self) -> FloatArray:
        """Stated rate of each dwell, (N,), rad/s."""
        return np.array([turn.turn_rate for turn in self.turns], float)

    @property
    def lines(self) -> FloatArray:
        """Scale factor and offset of each sensor by its own dwells, (3, 2); NaN where these do not show them."""
        return np.array([_line(self.turn_rate[self.own == k], self.reading[self.own == k, k]) for k in range(3)])

    def codes(self, *, rate: bool) -> FloatArray:
        """Return the variance that rounding to codes leaves in a mean of each sensor (3,), its unit squared."""
        windows = [
            self.records[turn.recording].gyro if rate else self.records[turn.recording].accel for turn in self.turns
        ]
        parts = [np.asarray(values)[self.settled(n)] for n, values in enumerate(windows) if values is not None]
        scatter = np.nanmedian([np.nanvar(part, axis=0) for part in parts], axis=0) if parts else np.zeros(3)
        return code_variance(code_steps(self.records, rate=rate), scatter)


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


def _line(rate: FloatArray, reading: FloatArray) -> FloatArray:
    if len(np.unique(rate)) < 2:
        return np.full(2, np.nan)
    return np.asarray(np.linalg.lstsq(np.column_stack((rate, np.ones_like(rate))), reading, rcond=None)[0])


def azimuths(dwells: Dwells, rows: list[int], windows: list[slice]) -> list[FloatArray] | None:
    """Return the angle of the table (M,) in windows of dwells of one recording; None if a gap hides it."""
    line = dwells.lines[dwells.own[rows[0]]]
    k, record = int(dwells.own[rows[0]]), dwells.records[dwells.turns[rows[0]].recording]
    begin, end = min(dwells.turns[n].start for n in rows), max(dwells.turns[n].stop for n in rows)
    if record.gyro is None or np.isnan(line).any() or np.isnan(record.gyro[begin:end]).any():
        return None
    rate = (record.gyro[begin:end, k] - line[1]) / line[0]
    step = 0.5 * (rate[1:] + rate[:-1]) * np.diff(record.time[begin:end])
    angle = np.concatenate(([0.0], np.cumsum(step)))
    return [angle[window.start - begin : window.stop - begin] for window in windows]


def block_means(values: FloatArray, size: int) -> FloatArray:
    """Return means (E, C) of whole blocks of values (N, C)."""
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, values.shape[1]).mean(axis=1))


# ---- axis of the table in the case, from gravity as the accelerometers measure it
#
# In one mounting, axis k of the case lies along the axis of the table. During dwell i the device turns about k + d_i, where d_i is
# small and across k. d_i = d + e_i: d is common to the mounting, e_i is the wobble of the dwell. The axis of the table leaves the
# vertical by l_i = l + e'_i, with the same size of wobble. The accelerometers are at a distance r from the axis. Block means of the
# specific force across k, at the rate w_i and the azimuth psi, are
#
#     f / g = d_i + R_k(-psi) l_i - r w_i^2 / g
#
# The sizes of noise and wobble are excess variances (fit/gls.py). With these sizes, the same rows determine each d_i and the joint
# covariance of all d_i. psi is the integral of the gyroscope of axis k within a recording. The errors of the accelerometers are
# common to all mountings: df = dM s - M do. Without accelerometers d is zero, with the stated uncertainty of the mounting, and e_i
# is zero, with the stated wobble.

MIN_TILT_SD = 1e-6  # rad, of block means of the direction of gravity: sound arithmetic


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableAxes:
    """About which axes of the case the dwells turned, and what is not known about them."""

    direction: FloatArray  # (N, 3), axis of each dwell
    columns: FloatArray  # (N, 3, C), errors of ``direction`` by C independent causes of one standard deviation each
    off: FloatArray  # (N, 2), angle between case axis and table axis and its uncertainty, rad; NaN if gravity did not show it
    ripple: FloatArray  # (N, R), change of the rate by R independent ripples, relative, of an amplitude of one each
    rate: float  # standard uncertainty of all stated rates in common, relative
    wobble: FloatArray  # (N,), stated standard uncertainty of the axis from dwell to dwell, rad; 0 if gravity showed the axis


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


def table_axes(dwells: Dwells, table: RateTable, accel: TriadModel | None, gravity_m_s2: float) -> TableAxes:
    """Return the axes about which the dwells turned the case; accelerometers measure them if there are any."""
    axis, count = dwells.own, len(dwells.own)
    groups: dict[tuple[int, int, float], list[int]] = {}
    for n in sorted(range(count), key=lambda n: dwells.turns[n].recording):
        groups.setdefault((int(dwells.mounting[n]), int(axis[n]), float(dwells.up[n])), []).append(n)
    direction, off = np.eye(3)[axis], np.full((count, 2), np.nan)
    wobble = np.full(count, table.wobble_deg * RADIAN_PER_DEGREE)
    own_columns = np.zeros((count, 3, 2 * count + 3 * len(groups)))
    by_accel = np.zeros((count, 3, 12))
    start = 0
    for (_, k, up), rows in groups.items():
        across = [(k + 1) % 3, (k + 2) % 3]
        felt = None
        if accel is not None and up != 0.0:
            felt = _axes_by_gravity(dwells, rows, table, accel, up / gravity_m_s2)
        if felt is None:
            own_columns[np.ix_(rows, across, [start, start + 1])] = table.mount_tilt_deg * RADIAN_PER_DEGREE * np.eye(2)
            start += 2
            continue
        tilt, root, off[rows] = felt
        direction[np.ix_(rows, across)] = tilt
        own_columns[np.ix_(rows, across, range(start, start + root.shape[2]))] = root
        start += root.shape[2]
        wobble[rows] = 0.0
        if accel is not None:
            reading = np.linalg.solve(accel.matrix, np.eye(3)[k])  # in g, minus the offset
            by_accel[np.ix_(rows, across)] = np.hstack(
                (np.kron(np.eye(3), reading), -up / gravity_m_s2 * accel.matrix)
            )[across]
    columns = [own_columns[:, :, :start]]
    if accel is not None:
        variance, vectors = np.linalg.eigh(accel.covariance[:12, :12])
        columns.append(by_accel @ (vectors * np.sqrt(variance.clip(0.0))))
    return TableAxes(
        direction=direction / np.linalg.norm(direction, axis=1)[:, None],
        columns=np.concatenate(columns, axis=2),
        off=off,
        ripple=_ripples(dwells),
        rate=table.rate_uncertainty,
        wobble=wobble,
    )


def _ripples(dwells: Dwells) -> FloatArray:
    """Return the mean cosine and sine of the table's azimuth in each dwell (N, R), for each stretch in which it is known.

    The rate ripples once a turn, by a cos psi + b sin psi. Over whole turns this averages out. Shorter dwells of one mounting start
    where the ones before ended, and err alike.
    """
    columns = list[FloatArray]()
    for key in sorted({(turn.recording, int(n)) for turn, n in zip(dwells.turns, dwells.mounting, strict=True)}):
        of = zip(dwells.turns, dwells.mounting, strict=True)
        rows = [n for n, (turn, mounting) in enumerate(of) if (turn.recording, int(mounting)) == key]
        angles = azimuths(dwells, rows, [dwells.settled(n) for n in rows])
        pair = np.zeros((len(dwells.turns), 2))
        for n, angle in zip(rows, angles or [], strict=bool(angles)):
            if np.ptp(angle) < 0.99 * 2.0 * np.pi:
                pair[n] = np.cos(angle).mean(), np.sin(angle).mean()
        columns.append(pair)
    return np.hstack([np.zeros((len(dwells.turns), 0)), *columns])


def _axes_by_gravity(
    dwells: Dwells, rows: list[int], table: RateTable, accel: TriadModel, gain: float
) -> tuple[FloatArray, FloatArray, tuple[float, float]] | None:
    """Return d_i (R, 2) of the dwells of one mounting, a root of their covariance (R, 2, C), and |d| with its uncertainty.

    Return None if gaps hide the azimuth or the force.
    """
    k = int(dwells.own[rows[0]])
    recordings = sorted({dwells.turns[n].recording for n in rows})
    common = 4 + 2 * len(recordings)  # d, r, and l of each recording; then e_i and e'_i of each dwell
    design, across = list[FloatArray](), list[FloatArray]()
    for number, recording in enumerate(recordings):
        rows_here = [n for n in rows if dwells.turns[n].recording == recording]
        windows = [dwells.steady_gravity(n) for n in rows_here]
        record, angles = dwells.records[recording], azimuths(dwells, rows_here, windows)
        if record.accel is None or angles is None:
            return None
        for n, angle, window in zip(rows_here, angles, windows, strict=True):
            force = gain * (np.asarray(record.accel[window]) - accel.offset) @ accel.matrix.T
            parts = np.column_stack((np.cos(angle), np.sin(angle), force[:, [(k + 1) % 3, (k + 2) % 3]]))
            means = block_means(parts, dwells.sizes[n])
            means = means[~np.isnan(means).any(axis=1)]
            if not len(means):
                return None
            turned = np.stack((means[:, [0, 1]], means[:, [1, 0]] * [-1.0, 1.0]), axis=1)  # R_k(-psi)
            block = np.zeros((len(means), 2, common + 4 * len(rows)))
            block[:, :, :2], block[:, :, 2:4] = np.eye(2), abs(gain) * dwells.turn_rate[n] ** 2 * np.eye(2)
            block[:, :, 4 + 2 * number : 6 + 2 * number] = turned
            wobble = common + 4 * rows.index(n)
            block[:, :, wobble : wobble + 2], block[:, :, wobble + 2 : wobble + 4] = np.eye(2), turned
            design.append(block.reshape(-1, block.shape[2]))
            across.append(means[:, 2:].ravel())
    matrix, felt = np.vstack(design), np.concatenate(across)
    level = max(table.table_level_deg * RADIAN_PER_DEGREE, MIN_TILT_SD)
    sizes = np.array([TABLE_MOUNTING] * 2 + [TABLE_ARM] * 2 + [level] * (2 * len(recordings)))
    stated = (table.wobble_deg * RADIAN_PER_DEGREE) ** 2
    wobbles = matrix[:, common:] @ matrix[:, common:].T
    scatter = solve(
        matrix[:, :common],
        felt,
        {"noise": np.full(len(felt), MIN_TILT_SD**2), "wobble": stated * wobbles},
        excess={"noise": np.ones(len(felt)), "wobble": wobbles},
        prior=Prior(mean=np.zeros(common), precision=np.diag(sizes**-2)),
    )
    # the same rows, with the wobble of each dwell among the parameters
    wobble_sd = max(stated + scatter.excess_bound("wobble"), MIN_TILT_SD**2) ** 0.5
    sizes = np.concatenate((sizes, np.full(4 * len(rows), wobble_sd)))
    fit = solve(
        matrix,
        felt,
        {"noise": np.full(len(felt), MIN_TILT_SD**2 + scatter.excess_bound("noise"))},
        prior=Prior(mean=np.zeros(len(sizes)), precision=np.diag(sizes**-2)),
    )
    to_axes = np.zeros((2 * len(rows), len(sizes)))  # d + e_i
    for number in range(len(rows)):
        own = slice(common + 4 * number, common + 4 * number + 2)
        to_axes[2 * number : 2 * number + 2, :2] = to_axes[2 * number : 2 * number + 2, own] = np.eye(2)
    flicker = (ACCEL_FLICKER * gain) ** 2 * np.eye(2 * len(rows))
    root = np.linalg.cholesky(to_axes @ fit.covariance @ to_axes.T + flicker)
    rounding = accel.matrix[[(k + 1) % 3, (k + 2) % 3]] * gain  # all dwells feel one gravity, and so read one code
    codes = rounding * np.sqrt(np.nan_to_num(dwells.codes(rate=False)))
    return (
        (to_axes @ fit.theta).reshape(-1, 2),
        np.concatenate((root.reshape(len(rows), 2, -1), np.broadcast_to(codes, (len(rows), 2, 3))), axis=2),
        (float(np.hypot(*fit.theta[:2])), float(np.sqrt(fit.covariance[0, 0]))),
    )


# ---- mean readings of the dwells

_LEAST_SAMPLES = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DwellMeans:
    """Mean readings at steady rates."""

    reading: FloatArray  # (N, 3), mean of each dwell, ``unit``
    turn_rate: FloatArray  # (N,), achieved rate about +axis, rad/s
    axis: tuple[Axis, ...]  # Axis of each dwell
    noise: FloatArray | None = None  # (N, 3), standard deviation of each mean; None when it is not known
    # (N,), 1 where +axis points up, -1 where it points down, 0 where it is not vertical; all 1 by default
    up: FloatArray = field(default_factory=lambda: np.ones(1))
    unit: str = "rad/s"  # Unit of the readings
    # (N,), middle of each dwell on one clock, s: recordings follow each other. None when it is not known
    time: FloatArray | None = None
    # (3,), step of the codes, 0 or NaN for none, and the variance that they leave in a mean, which is in ``noise`` too
    step: FloatArray = field(default_factory=lambda: np.zeros(3))
    codes: FloatArray = field(default_factory=lambda: np.zeros(3))
    span: FloatArray | None = None  # (N, 2), start and stop of each dwell, s, on that clock
    mount_tilt: float = 0.0  # stated standard uncertainty of the mounting, rad
    axes: TableAxes | None = None  # about which axes the table turned the case; None takes ``axis`` as exact

    def __post_init__(self) -> None:
        n = len(self.axis)
        if self.reading.shape != (n, 3) or self.turn_rate.shape != (n,):
            raise InputError(
                f"dwells: wanted readings (N, 3) and rates (N,) for {n} axes, got {self.reading.shape} and {self.turn_rate.shape}"
            )


def dwell_means(
    records: Sequence[Record], turns: Sequence[Turn], *, settle_s: float = SETTLE_S, cutoff_hz: float | None = None
) -> DwellMeans:
    """Average the steady turns of a session.

    The first ``settle_s`` of each dwell are left out, but no more than half of it. The note's smoothing spline halves the signal at
    ``cutoff_hz``; None leaves it out, which changes no mean.
    """
    used = [t for t in turns if t.axis is not None and t.turn_rate is not None]
    unit = records[used[0].recording].gyro_unit if used else "rad/s"
    blocks = {k: block_size(records[k].sample_rate_hz) for k in {t.recording for t in used}}
    parts = [_settled(records[t.recording], t, unit, settle_s) for t in used]
    windows = [np.asarray(record.gyro) for record in parts]
    smooth = [
        w if cutoff_hz is None else spline_filter(record.time, w, cutoff_hz)
        for record, w in zip(parts, windows, strict=True)
    ]
    about = [AXES.index(t.axis or "x") for t in used]
    noise = _noise(windows, [blocks[t.recording] for t in used], about)
    step = code_steps([records[k] for k in blocks], rate=True)
    codes = code_variance(step, np.median([w.var(axis=0) for w in windows], axis=0)) if used else np.zeros(3)
    return DwellMeans(
        reading=np.array([w.mean(axis=0) for w in smooth]).reshape(-1, 3),
        turn_rate=np.array([t.turn_rate for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        noise=None if noise is None else np.hypot(noise, np.sqrt(codes)),
        up=np.array([_points_up(record, axis) for record, axis in zip(parts, about, strict=True)]),
        unit=unit,
        time=middles(records, used),
        span=spans_of(records, used),
        step=step,
        codes=codes,
    )


def _noise(windows: list[FloatArray], sizes: list[int], own: list[int]) -> FloatArray | None:
    """Return the noise of each mean; a sensor whose own dwells scatter more, since the rate ripples, by its other dwells."""
    noise = noise_of_means(windows, sizes)
    for k in range(3):
        rows = [n for n, axis in enumerate(own) if axis != k]
        others = noise_of_means([windows[n] for n in rows], [sizes[n] for n in rows])
        if noise is None or others is None:
            continue
        spare = sum(len(windows[n]) // sizes[n] - 1 for n in rows)
        ratio = float((others[:, k] ** 2).sum() / max(float((noise[rows, k] ** 2).sum()), 1e-300))
        if ratio * (1.0 + SHOWS * (2.0 / spare) ** 0.5) < 1.0:
            noise[:, k] *= ratio**0.5
    return noise


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
    if len(dwell) < _LEAST_SAMPLES:
        raise InputError(
            f"dwell [{turn.start}, {turn.stop}): wanted {_LEAST_SAMPLES} samples or more after the start in which the table "
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
