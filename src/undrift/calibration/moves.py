"""Calibrate without equipment: rest the device in many poses and turn it by hand between them (Tedaldi et al., ICRA 2014).

    |M_a (u_k - o_a)| = g                still poses k = 1 .. K, mean raw reading u_k, upper triangular M_a (norm.py)
    m_k = o + H f_k + d_k                gyroscopes at rest: mean reading under the specific force f_k
    C_j(M, o + d_j, H) n_j = n_(j+1)     gyroscopes, over the moves j between the poses

A common rotation of all readings keeps their length, so three of the twelve parameters depend on the choice of axes. The z axis of
the sensor is the z axis of the case, and its y axis is in the y-z plane of the case.

C_j turns the body frame at the end of still j into the frame at the start of still j + 1. It is integrated from
w = M (u - o - d_j - H f). n_j is the direction of gravity in still j, from the accelerometer. A move determines two angles. The
angle about the vertical is not observable. Generalised least squares (fit/gls.py) fits M, o and H to rests and moves together.

d is the offset relative to its mean over the rests, and a source of error that rests and moves share. It consists of flicker and a
steady drift of known size, a change with temperature, and a random walk with an excess variance. The offset in a move is therefore
close to the offset of the rests next to it. Other sources are noise, codes, jitter of the clock and the calibration of the
accelerometer. Handling adds one excess variance in rests and another in moves.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.codes import code_steps, code_variance, limited_by_codes
from undrift.calibration.norm import NAMES, QUADRATIC_SD, check_count, fit_norm, judged, misses_gravity
from undrift.calibration.plausibility import check_axis_order, check_own_scale, check_range, saturated, stuck_windows
from undrift.calibration.session import Observed
from undrift.calibration.settings import Mode
from undrift.calibration.sources import (
    Creep,
    creep_of,
    flicker_of_means,
    offset_drift,
    slip_covariance,
    steady_drift,
    uncertain,
    walk_about_mean,
)
from undrift.errors import NotObservable, PoorFit
from undrift.fit.gls import GlsFit, Prior, carried, solve
from undrift.fit.priors import G_SENSITIVITY, GYRO_FLICKER, REST_DRIFT, UNCERTAIN_PERCENT
from undrift.fit.triad import TriadFit, TriadParameters, fit_of, parameter_names, weakest_parameters
from undrift.frames import rotation
from undrift.model import MATRIX_NAMES, TriadModel
from undrift.record import Record, Still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- free poses

FEWEST_POSES = 7  # number of poses with a prior on cross-axis terms: for scale and offset, and one to check them
ALIKE = 0.01  # largest relative difference between mean readings of the same pose


def fit_poses(
    records: Sequence[Record],
    stills: Sequence[Still],
    *,
    gravity: float,
    cross_axis_prior: float | None = 0.01,
    creep: Creep | None = None,
) -> TriadFit:
    """Fit accelerometers to still poses of several recordings. A recording may contain a single pose.

    ``cross_axis_prior`` is the prior standard deviation of a cross-axis term, relative to the scale. If it is None, poses that do
    not determine such a term are refused. ``creep`` is the effect of temperature on the stills.
    """
    reading, variances = _pose_means(records, stills)
    if len(stills) < (FEWEST_POSES if cross_axis_prior else len(NAMES)):
        check_count(reading, len(NAMES))
    elif np.ptp(reading, axis=0).max() <= ALIKE * np.linalg.norm(reading, axis=1).mean():
        check_count(reading[:1], len(NAMES))
    check_range(
        [np.asarray(records[s.recording].accel)[s.start : s.stop] for s in stills], "accelerometer in still poses"
    )
    fit = fit_norm(
        reading, gravity=gravity, variances=variances, prior_sd=cross_axis_prior, creep=creep, quadratic_sd=QUADRATIC_SD
    )
    return judged(fit, reading, records[0].accel_unit)


def _pose_means(records: Sequence[Record], stills: Sequence[Still]) -> tuple[FloatArray, FloatArray]:
    """Return mean readings (K, 3) and their variances, with the noise pooled over the stills of a recording."""
    step = code_steps(records, rate=False)
    means, variances = np.zeros((2, len(stills), 3))
    for number, record in enumerate(records):
        rows = [k for k, still in enumerate(stills) if still.recording == number]
        start, stop = np.array([(stills[k].start, stills[k].stop) for k in rows], np.int64).reshape(-1, 2).T
        mean, scatter, count = still_moments(np.asarray(record.accel), start, stop)
        means[rows], variances[rows] = mean, scatter / count[:, None] + code_variance(step, scatter)
    return means, variances


def still_moments(values: FloatArray, start: IntArray, stop: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the mean (K, C) of each still, the variance (C,) of a sample pooled over all stills, and the counts (K,)."""
    mean, square = np.zeros((len(start), values.shape[1])), np.zeros(values.shape[1])
    count = np.zeros(len(start), np.int64)
    for k, (low, high) in enumerate(zip(start, stop, strict=True)):
        piece = values[low:high]
        piece = piece[np.isfinite(piece).all(axis=1)]
        mean[k], count[k] = piece.mean(axis=0), len(piece)
        square += ((piece - mean[k]) ** 2).sum(axis=0)
    return mean, square / max(1, int(count.sum()) - len(start)), count


# ---- moves between stills; direction of gravity in the stills


class Moves:
    """Readings of all records in sequence, and the moves between neighbouring stills of a record.

    Moves that contain gaps or saturated readings are left out. A finding names the saturated moves.
    """

    def __init__(self, records: Sequence[Record], stills: Sequence[Still]) -> None:
        base = np.concatenate(([0], np.cumsum([len(r) for r in records])))
        ordered = sorted(stills, key=lambda still: (still.recording, still.start))
        begin = base[[still.recording for still in ordered]]
        self.start = begin + np.array([still.start for still in ordered], np.int64)  # (K,), samples of the stills
        self.stop = begin + np.array([still.stop for still in ordered], np.int64)
        self.gyro = np.concatenate([np.asarray(r.gyro) for r in records])  # (N, 3), raw units
        self.accel = np.concatenate([np.asarray(r.accel) for r in records])
        self.time = time = np.concatenate([r.time for r in records])  # (N,), s, each record on its own clock
        longest = 1.5 / np.array([r.sample_rate_hz for r in records])
        gaps = np.diff(time, prepend=time[0]) > np.repeat(longest, np.diff(base))
        lost = np.concatenate(([0], np.cumsum(gaps | np.isnan(self.gyro).any(axis=1))))
        whole = lost[self.start[1:] + 1] == lost[self.stop[:-1]]
        before = np.flatnonzero((begin[:-1] == begin[1:]) & whole)
        first, last = self.stop[before] - 1, self.start[before + 1]
        stuck = stuck_windows([self.gyro[a : b + 1] for a, b in zip(first, last, strict=True)])
        names = tuple(
            f"the move after still {before[k] + 1} ({time[first[k]]:.1f}-{time[last[k]]:.1f} s)"
            for k in np.flatnonzero(stuck)
        )
        self.saturated = (saturated("moves", len(names), len(before), names),) if names else ()
        # (J,), number of the still before each move, its last sample, and the first sample of the still after the move
        self.before, self.first, self.last = before[~stuck], first[~stuck], last[~stuck]
        self.duration_s = time[self.last] - time[self.first]

    def integrate(self, reading: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the rotation of each move, start to end, (J, 3, 3), for readings u (N, 3) without offset and rates M u.

        Also return the sums of R dt and of R u dt, (J, 4, 3, 3), from which the derivative by matrix and offset follows.
        """
        from undrift.kernels.rotation import accumulate

        q, sums = np.empty((len(self.first), 4)), np.zeros((len(self.first), 3, 3, 4))
        for j, (first, last) in enumerate(zip(self.first.tolist(), self.last.tolist(), strict=True)):
            u, time = reading[first : last + 1], self.time[first : last + 1]
            regressors = np.hstack((np.ones((len(u), 1)), u))
            accumulate((u @ matrix.T).reshape(-1), regressors.reshape(-1), time, time[-1:], q[j], sums[j].reshape(-1))
        return rotation(q).as_matrix().transpose(0, 2, 1), sums.transpose(0, 3, 1, 2)


def gravity_directions(moves: Moves, accel: TriadModel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the direction of gravity in each still (K, 3), its derivatives (K, 3, 12), and its covariance (K, 3, 3) due to noise.

    The derivatives are with respect to the accelerometer's m_xx .. m_zz and offset.
    n = a / |a| with a = M (u - o) of the mean reading, so dn = (1 - n n^T) / |a| da with da = dM (u - o) - M do + M du.
    """
    mean, variance, count = still_moments(moves.accel, moves.start, moves.stop)
    d = mean - accel.offset
    a = d @ accel.matrix.T
    length = np.linalg.norm(a, axis=1)
    n = a / length[:, None]
    projector = (np.eye(3) - n[:, :, None] * n[:, None, :]) / length[:, None, None]
    # column 3 i + j: across e_i d_j
    matrix_slopes = (projector[:, :, :, None] * d[:, None, None, :]).reshape(len(n), 3, 9)
    reading_slopes = projector @ accel.matrix
    covariance = (reading_slopes * variance / count[:, None, None]) @ reading_slopes.transpose(0, 2, 1)
    return n, np.concatenate((matrix_slopes, -reading_slopes), axis=2), covariance


def rough_matrix(moves: Moves, accel: TriadModel, offset: FloatArray) -> FloatArray:
    """Return an approximate gyroscope matrix, within a few per cent, from the slow change of the gravity direction.

    dn/dt = n x w with w = M (u - o) is linear in M over blocks of 0.2 s.
    """
    step_s = float(np.median(np.diff(moves.time)))
    block = max(2, round(BLOCK_S / step_s))
    blocks = len(moves.time) // block
    force, rate = (
        values[: blocks * block].reshape(blocks, block, 3).mean(axis=1) for values in (moves.accel, moves.gyro)
    )
    n = (force - accel.offset) @ accel.matrix.T
    n /= np.linalg.norm(n, axis=1)[:, None]
    design = cross_matrix(n[1:-1])[:, :, :, None] * (rate[1:-1] - offset)[:, None, None, :]
    turn = (n[2:] - n[:-2]) / (2.0 * block * step_s)
    finite = np.isfinite(design).all(axis=(1, 2, 3)) & np.isfinite(turn).all(axis=1)
    matrix = np.linalg.lstsq(design[finite].reshape(-1, 9), turn[finite].ravel(), rcond=1e-5)[0]
    return np.asarray(matrix.reshape(3, 3))


def cross_matrix(n: FloatArray) -> FloatArray:
    """Return the matrices (K, 3, 3) of the cross product with vectors (K, 3)."""
    return np.cross(n[:, None], np.eye(3)).transpose(0, 2, 1)


# ---- fit of the gyroscopes
#
# Parameters theta, raw units: M row by row, o, and H row by row. Rows: three per rest, rad/s, then two per move, rad.

BLOCK_S = 0.2  # block length over which gravity turns little and noise averages out
WEAKEST_TURN = 0.05  # smallest rms turn of gravity, rad, per unit of relative gain (random turns of 90 deg give 0.4)
FEWEST_MOVES = 5
MOST_STEPS, WHOLE_STEPS, CONVERGED = 40, 8, 1e-6  # Gauss-Newton steps and relative change of the matrix
TURNING = 8.0  # median deviations: a still with a larger reading turns about the vertical
LEAST_ANGLE = 1e-10  # smallest standard deviation of an angle, rad
LEAST_RATE = 1e-3  # smallest standard deviation of a rest, relative to the flicker
LOOSE = 1e-4  # weight of the turns by known angles in the fit to the moves
CONTRADICTS = 0.5  # largest relative change of the matrix from the turns (more indicates other axes or clocks)
HOPELESS_DEG = 20.0  # rms angle above which the moves do not belong to this gyroscope
MORE_TURNS = "Make more and larger turns between the poses."
MISS_DEG = (2.0, 8.0)  # limits of a verdict: marginal above the first, bad above the second


class _Problem:
    """Data of R rests and J moves, with their sources of error, for a rough matrix."""

    def __init__(
        self,
        moves: Moves,
        accel: TriadModel,
        records: Sequence[Record],
        creep: tuple[Creep, Creep] | None,
        matrix: FloatArray,
    ) -> None:
        self.moves, self.accel, self.directions = moves, accel, gravity_directions(moves, accel)
        self.size = float(np.cbrt(abs(np.linalg.det(matrix)) + 1e-18 * np.abs(matrix).max() ** 3))  # rad/s per raw unit
        if not self.size > 0.0:
            raise NotObservable(
                f"multi-position gyro: in {len(moves.first)} moves between stills the gyroscopes read only their offset. "
                "Check the gyroscope's columns, and turn the device by 90 deg or more about another axis between still poses.",
                moves=len(moves.first),
            )
        reading, self.noise, count = still_moments(moves.gyro, moves.start, moves.stop)
        step = code_steps(records, rate=True)  # (3,), step of the codes, NaN without steps
        distance = np.abs(reading - np.median(reading, axis=0))
        # coarse codes may be equal in most rests, and differ by a step in the others
        limit = np.maximum(TURNING * np.maximum(np.median(distance, axis=0), 1e-12), np.nan_to_num(step))
        rests = np.flatnonzero(np.all(distance <= limit, axis=1))
        self.reading = reading[rests]  # (R, 3), means of the rests, and their variance
        self.variance = np.maximum(self.noise / count[rests, None], (LEAST_RATE * GYRO_FLICKER / self.size) ** 2)
        self.codes = code_variance(step, self.noise)  # (3,), rounding of a mean at rest
        self.force = np.nan_to_num((moves.accel - accel.offset) @ accel.matrix.T)  # (N, 3), of each sample, m/s2
        first, last = np.append(moves.start[rests], moves.first + 1), np.append(moves.stop[rests], moves.last + 1)
        self.felt = still_moments(self.force, first, last)[0]  # (R + J, 3), mean force in each rest and move
        clock = np.concatenate(([0.0], np.cumsum(np.diff(moves.time).clip(0.0))))  # s, with recordings in sequence
        span = clock[np.column_stack((np.append(moves.start[rests], moves.first), last - 1))]
        about_mean = np.eye(len(span)) - (np.arange(len(span)) < len(rests)) / len(rests)
        # (R + J, R + J), covariance of the offset about its mean over the rests, (rad/s)^2, and covariance of a walk of 1
        # rad/s/sqrt(s)
        flicker = GYRO_FLICKER**2 * flicker_of_means(span) + REST_DRIFT**2 * steady_drift(span)
        self.flicker, self.walk = carried(about_mean, flicker), carried(about_mean, walk_about_mean(span.mean(axis=1)))
        windows = [slice(first, last + 1) for first, last in zip(moves.first, moves.last, strict=True)]
        # (J, 3, 3), covariance of the integral of each move due to jitter of its time stamps, (raw unit s)^2
        self.slip = np.array([slip_covariance(moves.time[window], moves.gyro[window]) for window in windows])
        steady = Creep(warmth=np.zeros(len(reading)), offset_per_k=0.0, scale_per_k=0.0)
        self.creep = creep or (steady, steady)  # creep of accelerometers and gyroscopes in the stills
        warmth = self.creep[1].warmth
        of_moves = 0.5 * (warmth[moves.before] + warmth[moves.before + 1])
        self.warmth = np.append(warmth[rests], of_moves)  # (R + J,), temperature minus the reference, K


class _Rows(NamedTuple):
    """Rows (E,) of the fit, linear about given parameters."""

    misfit: FloatArray  # (E,)
    design: FloatArray  # (E, 21)
    by_offset: FloatArray  # (E, 3 R + 3 J), derivative by the offset in each rest and move, rad/s
    by_still: FloatArray  # (E, 3 K), derivative by the direction of gravity in each still
    by_integral: FloatArray  # (E, 3 J), derivative by the integral of the readings in each move


def fit_moves(
    records: Sequence[Record],
    stills: Sequence[Still],
    accel: TriadModel,
    *,
    creep: tuple[Creep, Creep] | None = None,
) -> TriadFit:
    """Fit gyroscopes to the moves between still poses, in order of time. ``creep`` is for accelerometers and gyroscopes."""
    moves = Moves(records, stills)
    if len(moves.first) < FEWEST_MOVES:
        raise NotObservable(
            f"multi-position gyro: expected {FEWEST_MOVES} moves or more between stills for {parameter_names(MATRIX_NAMES)}, got "
            f"{len(moves.first)}{''.join(f'. {item.sentence[:-1]}' for item in moves.saturated)}. Turn the device by 90 deg or "
            "more about another axis between still poses of the same recording.",
            moves=len(moves.first),
        )
    matrix = rough_matrix(moves, accel, np.median(still_moments(moves.gyro, moves.start, moves.stop)[0], axis=0))
    problem = _Problem(moves, accel, records, creep, matrix)
    fit, rows = _descend(problem, matrix)
    _check_determined(rows.design[3 * len(problem.reading) :, :9], fit.theta[:9].reshape(3, 3))
    return _judge_triad(problem, fit, rows, records[0].gyro_unit)


def matrix_of_moves(
    records: Sequence[Record],
    stills: Sequence[Still],
    accel: TriadModel,
    turns: TriadParameters,
    *,
    creep: tuple[Creep, Creep],
) -> tuple[TriadParameters, FloatArray]:
    """Return the matrix that moves between rests determine in addition to turns by known angles.

    The second value (9, 3) is its change by one standard deviation of the slope of each sensor's scale over temperature.
    Turns and moves together give the point of linearisation, because moves by themselves may determine a scale only to second
    order. At that point the turns are a weak prior, so that contradicting turns cannot enlarge the excess of the moves.
    """
    moves = Moves(records, stills)
    if not len(moves.first):
        raise NotObservable(
            "multi-position gyro: no move between rests. Record the rests and the moves in one recording."
        )
    problem = _Problem(moves, accel, records, creep, turns.matrix)
    fit, rows = _descend(problem, turns.matrix, np.linalg.inv(turns.covariance[:9, :9]))
    change = np.abs(fit.theta[:9].reshape(3, 3) - turns.matrix).max()
    if change > CONTRADICTS * np.abs(turns.matrix).max() or _rms_deg(problem, rows) > MISS_DEG[1]:
        raise PoorFit("multi-position gyro: the moves between rests contradict the turns. Check axes and clocks.")
    warmth = fit.gains[:9] @ _scale_slopes(problem, rows, fit.theta)
    return TriadParameters(fit.theta[:9], fit.covariance[:9, :9], {}), warmth


def _descend(problem: _Problem, matrix: FloatArray, turns: FloatArray | None = None) -> tuple[GlsFit, _Rows]:
    """Return the Gauss-Newton fit and its rows, from a first matrix.

    With the precision (9, 9) of a matrix from ``turns``, return the fit of the moves at the solution of both together.
    """
    theta = np.concatenate((matrix.ravel(), problem.reading.mean(axis=0), np.zeros(9)))
    precision = np.zeros((21, 21))
    precision[12:, 12:] = np.eye(9) * (problem.size / G_SENSITIVITY) ** 2
    tight, loose = precision.copy(), precision.copy()
    if turns is not None:
        tight[:9, :9], loose[:9, :9] = turns, LOOSE * turns
    mean, rests = theta, 3 * len(problem.reading)
    for count in range(MOST_STEPS):
        rows = _rows(problem, theta)
        at_rest = np.arange(len(rows.misfit)) < rests
        excess = {
            "instability walk": carried(rows.by_offset, np.kron(problem.walk, np.eye(3))),
            "repeatability sway": np.where(at_rest, 1.0, 0.0),
            "repeatability hand": np.where(at_rest, 0.0, 1.0),
        }
        value, sources = rows.design @ theta - rows.misfit, _sources(problem, rows, theta)
        try:
            fit = solve(rows.design, value, sources, excess=excess, prior=Prior(mean=mean, precision=tight))
        except np.linalg.LinAlgError:
            if np.isfinite(rows.design).all():  # otherwise the descent diverged
                _check_determined(rows.design[rests:, :9], theta[:9].reshape(3, 3))
            break
        change = np.abs(fit.theta - theta)[:9].max()
        if change < CONVERGED * problem.size:
            if turns is not None:
                fit = solve(rows.design, value, sources, excess=excess, prior=Prior(mean=mean, precision=loose))
            return fit, rows
        if not change < 10.0 * problem.size:
            break
        share = 1.0 if count < WHOLE_STEPS else 0.5  # excess variances near zero may exchange their sizes forever
        theta = theta + share * (fit.theta - theta)
    raise PoorFit(
        f"multi-position gyro: the fit found no matrix that explains how gravity turns in {len(problem.moves.first)} moves. "
        "Check the gyroscope's columns and the time column.",
        moves=len(problem.moves.first),
    )


def _rows(problem: _Problem, theta: FloatArray) -> _Rows:
    """Return the rows of rests and moves, linear about parameters."""
    from scipy.linalg import block_diag

    moves, n, size, rests = problem.moves, problem.directions[0], problem.size, len(problem.reading)
    matrix, offset, slope = theta[:9].reshape(3, 3), theta[9:12], theta[12:].reshape(3, 3)
    count = len(moves.first)
    turn, integral = moves.integrate(moves.gyro - problem.force @ slope.T - offset, matrix)
    end = (turn @ n[moves.before][:, :, None])[:, :, 0]
    tangent = _tangent(n[moves.before + 1]).transpose(0, 2, 1)
    angle = (tangent @ (end - n[moves.before + 1])[:, :, None]).ravel()
    # derivative of the angles by a small turn: d(C n) = C n x small turn
    turn_slopes = tangent @ cross_matrix(end) @ turn
    by_offset = block_diag(np.eye(3 * rests), *(-turn_slopes @ integral[:, 0] @ matrix / size))
    still_slopes, numbers = np.zeros((count, 2, len(n), 3)), np.arange(count)
    still_slopes[numbers, :, moves.before] += tangent @ turn
    still_slopes[numbers, :, moves.before + 1] -= tangent
    # column 3 a + b: sum of R e_a d_b dt
    matrix_slopes = turn_slopes @ integral[:, 1:].transpose(0, 2, 3, 1).reshape(-1, 3, 9)
    matrix_columns = np.concatenate((np.zeros((3 * rests, 9)), matrix_slopes.reshape(-1, 9)))
    offset_columns = by_offset @ np.tile(np.eye(3), (len(problem.felt), 1))
    force_columns = by_offset @ np.einsum("ac,pb->pacb", np.eye(3), problem.felt).reshape(-1, 9)
    rest_misfit = size * (offset + problem.felt[:rests] @ slope.T - problem.reading)
    return _Rows(
        misfit=np.append(rest_misfit, angle),
        design=np.hstack((matrix_columns, size * offset_columns, size * force_columns)),
        by_offset=by_offset,
        by_still=np.concatenate((np.zeros((3 * rests, 3 * len(n))), still_slopes.reshape(2 * count, -1))),
        by_integral=np.concatenate(
            (np.zeros((3 * rests, 3 * count)), block_diag(*(tangent @ cross_matrix(end) @ matrix)))
        ),
    )


def _sources(problem: _Problem, rows: _Rows, theta: FloatArray) -> dict[str, FloatArray]:
    """Return the covariance (E, E) of the rows for each known source."""
    from scipy.linalg import block_diag

    moves, (unit, accel_slopes, still_covariance), rests = problem.moves, problem.directions, problem.reading.size
    accel_creep, gyro_creep = problem.creep
    force, gain = STANDARD_GRAVITY * unit, problem.accel.scale_factor
    columns = np.stack([accel_creep.columns(force[:, j], float(gain[j])) for j in range(3)], axis=1)  # (K, 3, 2)
    directions = np.einsum("kaj,kjs->kajs", -accel_slopes[:, :, 9:], columns).reshape(-1, 6)
    offsets = gyro_creep.offset_per_k * np.kron(problem.warmth[:, None], np.eye(3))
    slopes = np.hstack((rows.by_still @ directions, rows.by_offset @ offsets, _scale_slopes(problem, rows, theta)))
    # (rad/s)^2, mean of the axes
    sample = float((theta[:9].reshape(3, 3) ** 2 @ (problem.noise + problem.codes)).mean())
    readings = np.repeat(sample * moves.duration_s**2 / (moves.last - moves.first), 2) + LEAST_ANGLE**2
    # each rest has one rounding error, and in motion rounding becomes noise
    rest_codes = np.zeros((len(rows.misfit), 3))
    rest_codes[:rests] = np.tile(problem.size * np.sqrt(problem.codes) * np.eye(3), (len(problem.reading), 1))
    return {
        "noise": carried(rows.by_still, block_diag(*still_covariance))
        + np.diag(np.append(problem.size**2 * problem.variance, readings)),
        "clock": carried(rows.by_integral, block_diag(*problem.slip)),
        "level": carried(rows.by_still @ accel_slopes.reshape(-1, 12), problem.accel.covariance[:12, :12]),
        "adc": rest_codes @ rest_codes.T,
        "instability": carried(rows.by_offset, np.kron(problem.flicker, np.eye(3))),
        "temperature": slopes @ slopes.T,
    }


def _scale_slopes(problem: _Problem, rows: _Rows, theta: FloatArray) -> FloatArray:
    """Return the change of the rows (E, 3) if the temperature slope of a sensor's scale is one standard deviation."""
    count = len(problem.reading)
    warmth = np.append(np.zeros(problem.reading.size), np.repeat(problem.warmth[count:], 2))
    sensor_rows = (rows.design[:, :9] * theta[:9]).reshape(-1, 3, 3).sum(axis=1)
    return np.asarray(problem.creep[1].scale_per_k * warmth[:, None] * sensor_rows)


def _tangent(n: FloatArray) -> FloatArray:
    """Return two unit vectors across each direction, shape (J, 3, 2)."""
    first = np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack((first, np.cross(n, first)), axis=2)


def _rms_deg(problem: _Problem, rows: _Rows) -> float:
    """Return the rms angle between gravity and its direction after the moves, deg."""
    return float(np.sqrt(np.mean(rows.misfit[problem.reading.size :] ** 2))) / RADIAN_PER_DEGREE


def _check_determined(matrix_slopes: FloatArray, matrix: FloatArray) -> None:
    """Raise if a relative gain E of M = (1 + E) M turns gravity in no move, for the slopes (2 J, 9) of the angles."""
    gain = (matrix_slopes.reshape(-1, 3, 3) @ matrix.T).reshape(-1, 9)
    weakest, names = weakest_parameters(gain, len(gain), WEAKEST_TURN, MATRIX_NAMES)
    if weakest < WEAKEST_TURN:
        raise NotObservable(
            f"multi-position gyro: expected moves that turn gravity by {WEAKEST_TURN:g} rad or more per unit of every parameter, "
            f"got {weakest:.2g} for {parameter_names(names)}. Turn the device by 90 deg or more about each axis in turn while "
            "that axis is level.",
            weakest=weakest,
            parameters=names,
        )


def _judge_triad(problem: _Problem, fit: GlsFit, rows: _Rows, unit_in: str) -> TriadFit:
    """Return the fit with findings. Raise if its parameters cannot describe this gyroscope."""
    moves, rests, theta = problem.moves, problem.reading.size, fit.theta
    rms_deg = _rms_deg(problem, rows)
    if rms_deg > HOPELESS_DEG:
        raise PoorFit(
            f"multi-position gyro: after the moves, gravity is {rms_deg:.0f} deg rms off (limit {HOPELESS_DEG:g} deg). "
            "Check that gyro and accel share one clock, that the sample rate is right and that no rate was beyond full scale.",
            rms_angle_deg=rms_deg,
        )
    matrix, offset, slope = theta[:9].reshape(3, 3), theta[9:12], theta[12:].reshape(3, 3)
    check_axis_order(np.linalg.inv(matrix), "gyro against accel", against="accelerometer")
    jacobian = np.eye(21)  # G = M H: dG = dM H + M dH
    jacobian[12:] = np.hstack((np.kron(np.eye(3), slope.T), np.zeros((9, 3)), np.kron(matrix, np.eye(3))))
    parameters = TriadParameters(
        theta=np.append(theta[:12], matrix @ slope),
        covariance=carried(jacobian, fit.covariance),
        parts={name: carried(jacobian, share) for name, share in fit.budget.items()},
    )
    variance = np.diag(parameters.covariance)
    percent = 100.0 * float(np.sqrt(variance[:9].max()) / np.cbrt(abs(np.linalg.det(matrix))))
    inside = [moves.gyro[first + 1 : last + 1] for first, last in zip(moves.first, moves.last, strict=True)]
    findings = (
        *misses_gravity("Moves", rms_deg, MISS_DEG, "deg"),
        *uncertain("The gyroscope matrix", percent, UNCERTAIN_PERCENT, "%", MORE_TURNS),
        *limited_by_codes("gyroscope", problem.codes, variance[9:12], unit_in),
        *offset_drift(fit),
        *moves.saturated,
    )
    residuals = rows.misfit[rests:].reshape(-1, 2) / moves.duration_s[:, None]
    names = {"method": "multi-position", "unit_in": unit_in, "unit_out": "rad/s"}
    triad = fit_of(parameters, (np.concatenate(inside) - offset) @ matrix.T, residuals, *findings, **names)
    rate_hz = float(np.median((moves.last - moves.first) / moves.duration_s))
    check_own_scale(triad.model.scale_factor, unit_in, "rate", "gyro", sample_rate_hz=rate_hz)
    return triad


# ---- from a session


def calibrate_poses(observed: Observed, mode: Mode = "affine", accel: TriadFit | None = None) -> TriadFit:
    """Fit the accelerometer of a session to its free poses."""
    session, prior, stills = observed.session, observed.settings.cross_axis_prior, observed.sorted_stills
    creep = creep_of(observed, stills, "accel")
    return fit_poses(session.records, stills, gravity=session.gravity_m_s2, cross_axis_prior=prior, creep=creep)


def calibrate_moves(observed: Observed, mode: Mode, accel: TriadFit | None) -> TriadFit:
    """Fit the gyroscopes of a session to the moves between its poses."""
    if observed.session.records[0].accel is None:
        raise NotObservable("multi-position gyro: moves need accelerometer readings. Map the accel columns.")
    stills = observed.sorted_stills
    creep = creep_of(observed, stills, "accel"), creep_of(observed, stills, "gyro")
    return fit_moves(observed.session.records, stills, (accel or calibrate_poses(observed)).model, creep=creep)
