"""Calibration without equipment: hold the device still in many poses, turn it by hand between them (Tedaldi et al., ICRA 2014).

    |M_a (u_k - o_a)| = g                over k = 1 .. K still poses; u_k mean raw reading, M_a upper triangular (norm.py)
    C_j(M_g, o_j) n_j = n_(j+1)          gyroscopes, over the moves j between the poses

A common rotation of all readings keeps their length, so three of twelve parameters are a choice of axes: the sensor's z axis is the
case's, its y axis lies in the case's y-z plane.

C_j turns the body frame at the end of still j into that at the start of still j + 1, integrated from w = M_g (u - o_j). n_j is the
direction of gravity in still j, from the accelerometer. A move determines two angles; the one about the vertical is not observable.
The angles that a matrix misses are fitted by generalised least squares (fit/gls.py). Their sources of error are the noise of both
stills and of the readings, the calibration of the accelerometer, the offset, temperature, and an excess for the hand.

The offset in a move is interpolated between the rests. With means m_k of the rests under the specific force f_k:

    m_k = o + H f_k + d_k + e_k          d flicker of a stated size and a random walk about their means, e noise and sway
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.codes import code_steps, code_variance, limited_by_codes
from undrift.calibration.norm import NAMES, QUADRATIC_SD, TOLERANCE, check_count, fit_norm, judged
from undrift.calibration.plausibility import check_axis_order, check_own_scale, check_range, stuck_windows
from undrift.calibration.session import Observed, Outcome
from undrift.calibration.sources import Creep, creep_of, flicker_of_means, slip_covariance, walk_about_mean
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.findings import Finding, above, finding
from undrift.fit.gls import GlsFit, Prior, solve
from undrift.fit.priors import G_SENSITIVITY, GYRO_FLICKER, UNCERTAIN_PERCENT
from undrift.fit.triad import TriadFit, parameter_names, scaled_condition, triad_fit
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, TriadModel, Verdict
from undrift.record import Record, Still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- free poses

FEWEST_POSES = 7  # with a prior on cross-axis terms: scale, offset, and one pose to check them
ALIKE = 0.01  # of their length: mean readings that differ by less are those of one pose


def fit_poses(
    records: Sequence[Record],
    stills: Sequence[Still],
    *,
    gravity: float,
    cross_axis_prior: float | None = 0.01,
    creep: Creep | None = None,
) -> TriadFit:
    """Fit accelerometers to still poses of several recordings; a recording may be a single pose.

    ``cross_axis_prior`` is the standard deviation of a cross-axis term before the fit, relative to the scale; None states none, and
    poses that do not determine such a term are refused. ``creep`` is the temperature of the stills.
    """
    if any(r.accel is None for r in records) or len({r.accel_unit for r in records}) > 1:
        raise InputError(
            "multi-position: wanted accel readings in one unit in every recording, got recordings without or in several units; "
            "map the accelerometer columns and their unit"
        )
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
    """Return mean readings (K, 3) and their variances, the noise pooled over the stills of a recording."""
    step = code_steps(records, rate=False)
    means, variances = np.zeros((2, len(stills), 3))
    for number, record in enumerate(records):
        rows = [k for k, still in enumerate(stills) if still.recording == number]
        start, stop = np.array([(stills[k].start, stills[k].stop) for k in rows], np.int64).reshape(-1, 2).T
        mean, within, count = still_moments(np.asarray(record.accel), start, stop)
        means[rows], variances[rows] = mean, within / count[:, None] + code_variance(step, within)
    return means, variances


def still_moments(values: FloatArray, start: IntArray, stop: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the mean (K, 3) of each still, the variance (3,) of one sample pooled over all, and the counts (K,)."""
    mean, square, count = np.zeros((len(start), 3)), np.zeros(3), np.zeros(len(start), np.int64)
    for k, (low, high) in enumerate(zip(start, stop, strict=True)):
        piece = values[low:high]
        piece = piece[np.isfinite(piece).all(axis=1)]
        mean[k], count[k] = piece.mean(axis=0), len(piece)
        square += ((piece - mean[k]) ** 2).sum(axis=0)
    return mean, square / max(1, int(count.sum()) - len(start)), count


# ---- moves between stills; direction of gravity in the stills


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moves:
    """Readings of all records after one another, and the moves between stills in them."""

    gyro: FloatArray  # (N, 3), raw units
    accel: FloatArray  # (N, 3), raw units
    time: FloatArray  # (N,), s, each record on its own clock
    first: IntArray  # (J,), last sample of the still before the move
    last: IntArray  # (J,), first sample of the still after it
    before: IntArray  # (J,), number of the still before; the next one is after it
    stills: tuple[IntArray, IntArray]  # (K,), samples [start, stop) of the stills

    @property
    def duration_s(self) -> FloatArray:
        """Length of each move (J,), s."""
        return np.asarray(self.time[self.last] - self.time[self.first])

    @property
    def slip(self) -> FloatArray:
        """Covariance (J, 3, 3) of the integral of the readings over each move by jitter of its time stamps, (raw unit s)^2."""
        windows = (slice(first, last + 1) for first, last in zip(self.first, self.last, strict=True))
        return np.array([slip_covariance(self.time[window], self.gyro[window]) for window in windows])

    @property
    def spans(self) -> FloatArray:
        """Start and end of the stills and the moves (K + J, 2), s, on one clock; recordings follow each other."""
        clock = np.concatenate(([0.0], np.cumsum(np.diff(self.time).clip(0.0))))
        stills = np.stack((self.stills[0], self.stills[1] - 1))
        return np.asarray(clock[np.hstack((stills, np.stack((self.first, self.last)))).T])


def cut_moves(records: Sequence[Record], stills: Sequence[Still]) -> Moves:
    """Return the moves between neighbouring stills of a record; moves with gaps or drop-outs are left out."""
    pairs = [(r.gyro, r.accel) for r in records if r.gyro is not None and r.accel is not None]
    if len(pairs) < len(records) or len({(r.gyro_unit, r.accel_unit) for r in records}) > 1:
        raise InputError(
            "multi-position gyro: wanted gyro and accel readings in the same units in every recording, got recordings that "
            "differ; fit the recordings that have both"
        )
    base = np.concatenate(([0], np.cumsum([len(r) for r in records])))
    ordered = sorted(stills, key=lambda still: (still.recording, still.start))
    begin = base[[still.recording for still in ordered]]
    start, stop = (begin + np.array([getattr(still, end) for still in ordered], np.int64) for end in ("start", "stop"))
    gyro, accel = (np.concatenate(values) for values in zip(*pairs, strict=True))
    time = np.concatenate([r.time for r in records])
    longest = 1.5 / np.array([r.sample_rate_hz for r in records])
    broken = np.isnan(gyro).any(axis=1) | (np.diff(time, prepend=time[0]) > np.repeat(longest, np.diff(base)))
    lost = np.concatenate(([0], np.cumsum(broken)))
    before = np.flatnonzero((begin[:-1] == begin[1:]) & (lost[start[1:] + 1] == lost[stop[:-1]]))
    return Moves(
        gyro=gyro,
        accel=accel,
        time=time,
        first=stop[before] - 1,
        last=start[before + 1],
        before=before,
        stills=(start, stop),
    )


# Unit vectors (K, 3) along the specific force in each still, their derivative by the accelerometer's m_xx .. m_zz and offset
# (K, 3, 12), and their covariance from the noise of the still itself (K, 3, 3).
Directions = tuple[FloatArray, FloatArray, FloatArray]


def gravity_directions(moves: Moves, accel: TriadModel) -> Directions:
    """Return the direction of gravity in each still with its derivatives and covariance.

    n = a / |a|, a = M (u - o) of the mean reading, so that dn = (1 - n n^T) / |a| da with da = dM (u - o) - M do + M du.
    """
    mean, variance, count = still_moments(moves.accel, *moves.stills)
    d = mean - accel.offset
    a = d @ accel.matrix.T
    length = np.linalg.norm(a, axis=1)
    n = a / length[:, None]
    across = (np.eye(3) - n[:, :, None] * n[:, None, :]) / length[:, None, None]
    by_matrix = (across[:, :, :, None] * d[:, None, None, :]).reshape(len(n), 3, 9)  # column 3 i + j: across e_i d_j
    by_reading = across @ accel.matrix
    covariance = (by_reading * variance / count[:, None, None]) @ by_reading.transpose(0, 2, 1)
    return n, np.concatenate((by_matrix, -by_reading), axis=2), covariance


def rough_matrix(moves: Moves, accel: TriadModel, offset: FloatArray) -> FloatArray:
    """Return a first gyroscope matrix from the slow change of the gravity direction.

    dn/dt = n x w with w = M (u - o), over blocks of 0.2 s while the device is moved: linear in M. The hand's own
    accelerations make it rough, some per cent.
    """
    normal, right = np.zeros((9, 9)), np.zeros(9)
    for first, last in zip(moves.first, moves.last, strict=True):
        step_s = (moves.time[last] - moves.time[first]) / max(1, last - first)
        block = max(2, round(0.2 / step_s))
        low = max(0, first - block)  # into the stills, where the direction is sure
        blocks = (min(last + block, len(moves.time)) - low) // block
        if blocks < 3:
            continue
        cut = slice(low, low + blocks * block)
        force, rate = (values[cut].reshape(blocks, block, 3).mean(axis=1) for values in (moves.accel, moves.gyro))
        n = (force - accel.offset) @ accel.matrix.T
        n /= np.linalg.norm(n, axis=1)[:, None]
        design = (cross_matrix(n[1:-1])[:, :, :, None] * (rate[1:-1] - offset)[:, None, None, :]).reshape(-1, 9)
        turn = ((n[2:] - n[:-2]) / (2.0 * block * step_s)).reshape(-1)
        finite = np.isfinite(design).all(axis=1) & np.isfinite(turn)
        normal += design[finite].T @ design[finite]
        right += design[finite].T @ turn[finite]
    return np.asarray(np.linalg.lstsq(normal, right, rcond=1e-10)[0].reshape(3, 3))


_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(0, 2, 1)  # of each axis


def cross_matrix(n: FloatArray) -> FloatArray:
    """Return the matrices (K, 3, 3) of the cross product with vectors (K, 3)."""
    return np.tensordot(n, _CROSS, axes=1)


def turned_in(moves: Moves, matrix: FloatArray, offset: FloatArray, drift: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotations C (J, 3, 3) of the moves, start to end, and the sums (J, 4, 3, 3) of their derivatives."""
    from undrift.kernels.calibrate import rotations_between

    j = len(moves.first)
    rotation, sums = np.empty(9 * j), np.empty(36 * j)
    gyro, m, d = (np.ascontiguousarray(values).reshape(-1) for values in (moves.gyro, matrix, drift))
    rotations_between(gyro, moves.time, moves.first, moves.last, m, offset, d, rotation, sums)
    return rotation.reshape(j, 3, 3).transpose(0, 2, 1), sums.reshape(j, 4, 3, 3)


# ---- offset of the gyroscopes in the moves

_TURNING = 8.0  # median deviations: a still that reads more turns about the vertical


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestOffsets:
    """Offset, g-sensitivity, drift and noise of the gyroscopes from the stills, raw unit."""

    mean: FloatArray  # (3,), mean offset over the stills, under their mean specific force
    variance: FloatArray  # (3,), of the mean
    drift: FloatArray  # (J, 3), offset of each move minus the mean
    drift_covariance: FloatArray  # (3, J, J), of the drift, per axis
    noise: FloatArray  # (3,), variance of one sample at rest
    force: FloatArray  # (3,), mean specific force, m/s2
    g: FloatArray | None = None  # (3, 3), H, raw unit per m/s2; None if the readings are free of it
    g_covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3, 3)))  # of each row


def offsets_in_moves(
    moves: Moves, scale: FloatArray, *, force: FloatArray | None = None, walk: FloatArray | None = None
) -> RestOffsets:
    """Return the offset in each move from the rests; scale (3,) is raw units per rad/s.

    o and H by least squares, d of a move from the rests around it (best linear prediction). ``force`` (K, 3) is the specific force
    in the rests; without it the readings are free of H. ``walk`` (3,), (rad/s)^2 / s, is the size of the random walk; without it,
    the walk and the sway of the hand are excess variances of the rests. Stills that turn about the vertical are left out.
    """
    reading, noise, count = still_moments(moves.gyro, *moves.stills)
    away = np.abs(reading - np.median(reading, axis=0))
    rest = np.all(away <= _TURNING * np.maximum(np.median(away, axis=0), 1e-12), axis=1)
    rests, number = np.flatnonzero(rest), len(reading)
    middle = np.zeros(3) if force is None else count[rests] @ force[rests] / count[rests].sum()
    felt = np.zeros((len(rests), 0)) if force is None else (force - middle)[rests]
    design = np.column_stack((np.ones(len(rests)), felt))
    about_mean = np.eye(number + len(moves.before))  # d counts from the mean over the rests
    about_mean[:, :number] -= rest / rest.sum()
    flicker = about_mean @ flicker_of_means(moves.spans) @ about_mean.T
    brownian = about_mean @ walk_about_mean(moves.spans.mean(axis=1)) @ about_mean.T
    own = np.ix_(rests, rests)
    fits = list[GlsFit]()
    drift, covariance = np.zeros((3, len(moves.before))), np.zeros((3, len(moves.before), len(moves.before)))
    for axis in range(3):
        instability = (GYRO_FLICKER * scale[axis]) ** 2
        white = np.maximum(noise[axis] / count[rests], 1e-6 * instability)
        total = instability * flicker + (0.0 if walk is None else walk[axis] * scale[axis] ** 2) * brownian
        fit = solve(
            design,
            reading[rests, axis],
            {"noise": white, "drift": total[own]},
            excess={"walk": brownian[own], "sway": np.ones(len(rests))} if walk is None else {},
            prior=Prior(
                mean=np.zeros(design.shape[1]),
                precision=np.diag([0.0] + [(G_SENSITIVITY * scale[axis]) ** -2] * felt.shape[1]),
            ),
        )
        total = total + fit.excess.get("walk", 0.0) * brownian
        to_moves = total[number:, rests] @ np.linalg.inv(total[own] + np.diag(white + fit.excess.get("sway", 0.0)))
        drift[axis] = to_moves @ fit.residuals
        covariance[axis] = total[number:, number:] - to_moves @ total[rests, number:]
        fits.append(fit)
    known = {
        "g": np.array([fit.theta[1:] for fit in fits]),
        "g_covariance": np.array([f.covariance[1:, 1:] for f in fits]),
    }
    return RestOffsets(
        mean=np.array([fit.theta[0] for fit in fits]),
        variance=np.array([fit.covariance[0, 0] for fit in fits]),
        drift=drift.T,
        drift_covariance=covariance,
        noise=noise,
        force=middle,
        **(known if felt.shape[1] else {}),
    )


# ---- fit of the gyroscopes

WEAKEST_TURN = 0.05  # rad rms that one unit of relative gain must turn gravity by; random turns of 90 deg give 0.4
FEWEST_MOVES = 5
MOST_STEPS, CONVERGED = 30, 1e-6  # of Gauss-Newton; relative change of the matrix
_LEAST_ANGLE = 1e-10  # rad: standard deviation that every angle has at least
_LOOSE = 1e-4  # of the precision of turns by known angles while the excess of the moves is determined
_CONTRADICTS = 0.5  # of the matrix from the turns: moves that change it by more mean other axes or another clock
_HOPELESS_DEG = 20.0  # rms: moves that end farther from gravity are not those of this gyroscope
MISS_DEG = (2.0, 8.0)  # limits of a verdict: marginal above the first, bad above the second


class ByTurns(NamedTuple):
    """Matrix of the gyroscopes from turns by known angles, an observation beside the moves."""

    matrix: FloatArray  # (3, 3)
    covariance: FloatArray  # (9, 9), of the matrix row by row
    prior: Callable[[Moves], RestOffsets]  # offset in each move from the rests


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    """Parameters theta (12,): M row by row, then o in raw units."""

    moves: Moves
    directions: Directions
    felt: FloatArray  # (J, 3), mean specific force of each move minus that of the stills, m/s2; the moves are freed of its effect
    accel: TriadModel
    offset: RestOffsets
    creep: tuple[Creep, Creep] | None  # of accelerometers and gyroscopes in the stills

    @property
    def warmth(self) -> FloatArray:
        """Temperature of each move minus the reference (J,), K; zero without a temperature."""
        rests = np.zeros(len(self.directions[0])) if self.creep is None else self.creep[1].warmth
        return np.asarray(0.5 * (rests[self.moves.before] + rests[self.moves.before + 1]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Missed:
    """Missed angles (2 J,), their Jacobian (2 J, 12), rotations C (J, 3, 3) and tangents at the later direction (J, 3, 2)."""

    angle: FloatArray
    jacobian: FloatArray
    turn: FloatArray
    tangent: FloatArray

    @property
    def rms_deg(self) -> float:
        """Angle by which the moves miss gravity, rms, deg."""
        return float(np.sqrt(np.mean(self.angle**2))) / RADIAN_PER_DEGREE


def fit_moves(
    records: Sequence[Record],
    stills: Sequence[Still],
    accel: TriadModel,
    *,
    creep: tuple[Creep, Creep] | None = None,
    by_turns: ByTurns | None = None,
) -> TriadFit:
    """Fit gyroscopes to the moves between still poses; creep of accelerometers and gyroscopes in these, in order of time.

    ``by_turns`` is the result of turns by known angles: an observation beside the moves.
    """
    moves, saturated = _without_saturated(cut_moves(records, stills))
    if len(moves.first) < (FEWEST_MOVES if by_turns is None else 1):
        raise NotObservable(
            f"multi-position gyro: wanted {FEWEST_MOVES} moves or more between stills for {parameter_names(MATRIX_NAMES)}, got "
            f"{len(moves.first)}{''.join(f' ({item.text})' for item in saturated)}; turn the device by 90 deg or more about "
            "another axis between still poses of one recording",
            moves=len(moves.first),
        )
    directions = gravity_directions(moves, accel)
    felt: FloatArray = np.zeros((len(moves.before), 3))
    if by_turns is None:
        matrix = rough_matrix(moves, accel, np.median(still_moments(moves.gyro, *moves.stills)[0], axis=0))
        size = float(np.cbrt(abs(np.linalg.det(matrix)) + 1e-18 * np.abs(matrix).max() ** 3))
        if not size > 0.0:
            raise NotObservable(
                f"multi-position gyro: in {len(moves.first)} moves between stills the gyroscopes read nothing but their offset. "
                "Check the gyroscope's columns, and turn the device by 90 deg or more about another axis between still poses",
                moves=len(moves.first),
            )
        offset = offsets_in_moves(moves, np.full(3, 1.0 / size), force=STANDARD_GRAVITY * directions[0])
        if offset.g is not None:  # the moves under the mean specific force of the stills
            force = np.nan_to_num((moves.accel - accel.offset) @ accel.matrix.T - offset.force)
            felt = np.array([force[a + 1 : b + 1].mean(axis=0) for a, b in zip(moves.first, moves.last, strict=True)])
            moves = replace(moves, gyro=moves.gyro - force @ offset.g.T)
    else:
        matrix, offset = by_turns.matrix, by_turns.prior(moves)
    codes = code_variance(code_steps(records, rate=True), offset.noise)  # rests lie at one place between two codes
    offset = replace(
        offset, variance=offset.variance + codes, noise=offset.noise + codes
    )  # in motion it is noise again
    problem = _Problem(moves=moves, directions=directions, felt=felt, accel=accel, offset=offset, creep=creep)
    fit = _solve(problem, matrix, by_turns)
    missed = _missed(problem, fit.theta)
    if by_turns is None:
        _check_determined(missed, fit.theta)
    elif (
        np.abs(fit.theta[:9] - by_turns.matrix.ravel()).max() > _CONTRADICTS * np.abs(by_turns.matrix).max()
        or missed.rms_deg > MISS_DEG[1]
    ):
        raise PoorFit("multi-position gyro: the moves between rests contradict the turns. Check axes and clocks.")
    return _as_triad(problem, fit, missed, records[0].gyro_unit, codes, saturated)


def _without_saturated(moves: Moves) -> tuple[Moves, tuple[Finding, ...]]:
    """Return the moves without those in which a gyroscope sticks at the end of its range, and the finding that names them."""
    stuck = stuck_windows([moves.gyro[a : b + 1] for a, b in zip(moves.first, moves.last, strict=True)])
    if not stuck.any():
        return moves, ()
    names = tuple(
        f"the move after still {before + 1} ({moves.time[first]:.1f}-{moves.time[last]:.1f} s)"
        for before, first, last in zip(moves.before[stuck], moves.first[stuck], moves.last[stuck], strict=True)
    )
    left = finding("session.saturated", "warn", what="moves", count=int(stuck.sum()), of=len(stuck), pieces=names)
    return replace(moves, first=moves.first[~stuck], last=moves.last[~stuck], before=moves.before[~stuck]), (left,)


def _solve(problem: _Problem, matrix: FloatArray, by_turns: ByTurns | None) -> GlsFit:
    """Return the fit of M and o, from a first matrix.

    Turns that contradict the moves shall not enlarge the excess of the moves: it is determined with a loose prior from the turns.
    """
    mean, turns = np.append(matrix, problem.offset.mean), np.zeros((12, 12))
    known = np.diag(np.append(np.zeros(9), 1.0 / problem.offset.variance))
    if by_turns is None:
        return _descend(problem, mean, Prior(mean=mean, precision=known))
    turns[:9, :9] = np.linalg.inv(by_turns.covariance)
    alone = _descend(problem, mean, Prior(mean=mean, precision=known + _LOOSE * turns))
    return _descend(problem, alone.theta, Prior(mean=mean, precision=known + turns), hand=alone.excess_bound("hand"))


def _descend(problem: _Problem, theta: FloatArray, prior: Prior, hand: float | None = None) -> GlsFit:
    """Return the fit by Gauss-Newton, with the covariance of the angles at each step; ``hand`` is the excess if it is known."""
    size, ones = float(np.abs(theta[:9]).max()), np.ones(2 * len(problem.moves.first))
    for _ in range(MOST_STEPS):
        missed = _missed(problem, theta)
        sources = _sources(problem, missed, theta) | ({} if hand is None else {"hand": hand * ones})
        value = missed.jacobian @ theta - missed.angle
        try:
            fit = solve(missed.jacobian, value, sources, excess={"hand": ones} if hand is None else {}, prior=prior)
        except np.linalg.LinAlgError:
            _check_determined(missed, theta)
            break
        change, theta = np.abs(fit.theta - theta)[:9].max(), fit.theta
        if change < CONVERGED * size:
            return fit
        if not change < 10.0 * size:
            break
    raise PoorFit(
        f"multi-position gyro: wanted a matrix that turns gravity through {len(problem.moves.first)} moves, got no "
        "convergence; check the gyroscope's columns and the time column",
        moves=len(problem.moves.first),
    )


def _missed(problem: _Problem, theta: FloatArray) -> _Missed:
    moves, n = problem.moves, problem.directions[0]
    matrix = theta[:9].reshape(3, 3)
    turn, part = turned_in(moves, matrix, theta[9:], problem.offset.drift)
    arrived = (turn @ n[moves.before][:, :, None])[:, :, 0]
    tangent = _tangent(n[moves.before + 1])
    by_matrix = part[:, 1:].transpose(0, 2, 3, 1).reshape(-1, 3, 9)  # column 3 a + b: sum of R e_a d_b dt
    by_offset = -part[:, 0] @ matrix
    small_turn = turn @ np.concatenate((by_matrix, by_offset), axis=2)  # in the end frame; d(C n) = C n x small turn
    jacobian = tangent.transpose(0, 2, 1) @ cross_matrix(arrived) @ small_turn
    angle = (tangent.transpose(0, 2, 1) @ (arrived - n[moves.before + 1])[:, :, None]).reshape(-1)
    return _Missed(angle=angle, jacobian=jacobian.reshape(-1, 12), turn=turn, tangent=tangent)


def _sources(problem: _Problem, missed: _Missed, theta: FloatArray) -> dict[str, FloatArray]:
    """Return the covariance of the missed angles (2 J, 2 J) by source."""
    moves, offset, (unit, by_model, of_still) = problem.moves, problem.offset, problem.directions
    count, each = len(moves.first), np.arange(len(moves.first))
    by_still = np.zeros((count, 2, len(unit), 3))  # of both angles by each direction of gravity
    by_still[each, :, moves.before] += missed.tangent.transpose(0, 2, 1) @ missed.turn
    by_still[each, :, moves.before + 1] -= missed.tangent.transpose(0, 2, 1)
    flat = by_still.reshape(2 * count, -1)
    stills = np.einsum("ejka,kab->ejkb", by_still, of_still).reshape(2 * count, -1) @ flat.T
    noise = float((theta[:9].reshape(3, 3) ** 2 @ offset.noise).mean())  # (rad/s)^2 of one sample, mean of the axes
    readings = np.repeat(noise * moves.duration_s**2 / (moves.last - moves.first), 2)
    by_accel = flat @ by_model.reshape(-1, 12)
    drift = np.zeros((2 * count, 2 * count))
    for column, of_drift, of_g in zip(
        missed.jacobian[:, 9:].T, offset.drift_covariance, offset.g_covariance, strict=True
    ):
        by_g = column[:, None] * np.repeat(problem.felt, 2, axis=0)
        drift += np.outer(column, column) * np.kron(of_drift, np.ones((2, 2))) + by_g @ of_g @ by_g.T
    turned = missed.tangent.transpose(0, 2, 1) @ cross_matrix(unit[moves.before + 1]) @ theta[:9].reshape(3, 3)
    clock = np.zeros((count, 2, count, 2))
    clock[each, :, each] = turned @ moves.slip @ turned.transpose(0, 2, 1)
    sources = {
        "noise": stills + np.diag(readings + _LEAST_ANGLE**2),
        "clock": clock.reshape(2 * count, 2 * count),
        "accelerometer": by_accel @ problem.accel.covariance[:12, :12] @ by_accel.T,
        "offset": drift,
    }
    if problem.creep is not None:
        of_accel, of_gyro = problem.creep
        force, gain = STANDARD_GRAVITY * unit, problem.accel.scale_factor
        columns = np.stack([of_accel.columns(force[:, j], float(gain[j])) for j in range(3)], axis=1)  # (K, 3, 2)
        moved = (
            -by_model[:, :, 9:, None] * columns[:, None]
        )  # direction of each still by offset and scale of each sensor
        by_poses = flat @ moved.reshape(-1, 6)
        by_scale = (missed.jacobian[:, :9] * theta[:9]).reshape(-1, 3, 3).sum(axis=1)
        by_moves = of_gyro.scale_per_k * np.repeat(problem.warmth, 2)[:, None] * by_scale
        sources["temperature"] = by_poses @ by_poses.T + by_moves @ by_moves.T
    return sources


def _tangent(n: FloatArray) -> FloatArray:
    """Return two unit vectors across each direction, shape (J, 3, 2)."""
    first = np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack((first, np.cross(n, first)), axis=2)


def _check_determined(missed: _Missed, theta: FloatArray) -> None:
    by_matrix = missed.jacobian[:, :9].reshape(-1, 3, 3)
    gain = (by_matrix @ theta[:9].reshape(3, 3).T).reshape(
        -1, 9
    )  # by E of M = (1 + E) M: rad per unit of relative gain
    _, singular, right = np.linalg.svd(gain, full_matrices=False)
    singular = singular / np.sqrt(len(gain))
    if singular[-1] < WEAKEST_TURN:
        share = np.linalg.norm(right[singular < WEAKEST_TURN], axis=0)
        names = tuple(name for name, s in zip(MATRIX_NAMES, share, strict=True) if s > 0.3 * share.max())
        raise NotObservable(
            f"multi-position gyro: wanted moves that turn gravity by {WEAKEST_TURN:g} rad or more per unit of every parameter, got "
            f"{singular[-1]:.2g} for {parameter_names(names)}; turn the device by 90 deg or more about each axis in turn while "
            "that axis lies level",
            weakest=float(singular[-1]),
            parameters=names,
        )


def _as_triad(
    problem: _Problem, fit: GlsFit, missed: _Missed, unit_in: str, codes: FloatArray, saturated: tuple[Finding, ...]
) -> TriadFit:
    if missed.rms_deg > _HOPELESS_DEG:
        raise PoorFit(
            f"multi-position gyro: moves end {missed.rms_deg:.0f} deg rms off gravity, wanted {_HOPELESS_DEG:g} deg or less; "
            "check that gyro and accel share one clock, that the sample rate is right and that no rate was beyond full scale",
            rms_angle_deg=missed.rms_deg,
        )
    moves, rests, matrix, offset = problem.moves, problem.offset, fit.theta[:9].reshape(3, 3), fit.theta[9:]
    check_axis_order(np.linalg.inv(matrix), "gyro against accel", against="accelerometer")
    covariance = fit.covariance.copy()
    covariance[9:, 9:] += np.diag(_change_of_offset(problem))
    inside = [moves.gyro[a + 1 : b + 1] for a, b in zip(moves.first, moves.last, strict=True)]
    rate = (np.concatenate(inside) - offset) @ matrix.T
    offset, g, names, covariance = _with_g(rests, matrix, offset, covariance)
    triad = triad_fit(
        missed.angle.reshape(-1, 2) / moves.duration_s[:, None],
        Verdict.of(
            *_judged(fit, missed),
            *limited_by_codes("gyroscope", codes, np.diag(covariance)[9:12], unit_in),
            *saturated,
        ),
        method="multi-position",
        unit_in=unit_in,
        unit_out="rad/s",
        matrix=matrix,
        offset=offset,
        g_sensitivity=g,
        parameters=names,
        covariance=covariance,
        rank=len(names),
        condition=scaled_condition(missed.jacobian[:, :9])[1],
        valid_range=(float(rate.min()), float(rate.max())),
    )
    rate_hz = float(np.median((moves.last - moves.first) / moves.duration_s))
    check_own_scale(triad.model.scale_factor, unit_in, "rate", TOLERANCE, "gyro", sample_rate_hz=rate_hz)
    return triad


def _change_of_offset(problem: _Problem) -> FloatArray:
    """Return the variance (3,) by which the offset changes over the moves: one offset stands for all of the session."""
    change, known, warmth = problem.offset.drift, np.zeros(3), problem.warmth[:, None]
    if warmth.any():  # the offset is that at the reference temperature
        change = change - warmth @ np.linalg.pinv(warmth) @ change
        known = np.diagonal(problem.offset.drift_covariance, axis1=1, axis2=2).mean(axis=1)
    return np.asarray(np.maximum((change**2).mean(axis=0) - known, 0.0))


def _with_g(
    rests: RestOffsets, matrix: FloatArray, offset: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray | None, tuple[str, ...], FloatArray]:
    """Return the offset under no force, G, the names of all parameters and their covariance; of a fit under the mean force.

    b = b_f - H f, G = M H: db = db_f - dH f, dG = dM H + M dH.
    """
    from scipy.linalg import block_diag

    names = (*MATRIX_NAMES, *OFFSET_NAMES)
    if rests.g is None:
        return offset, None, names, covariance
    jacobian = np.eye(21)
    jacobian[9:12, 12:] = -np.kron(np.eye(3), rests.force)
    jacobian[12:, :9], jacobian[12:, 12:] = np.kron(np.eye(3), rests.g.T), np.kron(matrix, np.eye(3))
    total = jacobian @ block_diag(covariance, *rests.g_covariance) @ jacobian.T
    return offset - rests.g @ rests.force, matrix @ rests.g, (*names, *G_NAMES), total


def _judged(fit: GlsFit, missed: _Missed) -> Iterator[Finding]:
    matrix = fit.theta[:9].reshape(3, 3)
    percent = 100.0 * float(np.sqrt(np.diag(fit.covariance)[:9].max()) / np.cbrt(abs(np.linalg.det(matrix))))
    yield from above("multi_position.moves_miss", missed.rms_deg, MISS_DEG, rms_deg=missed.rms_deg)
    yield from above("multi_position.gyro_uncertainty", percent, UNCERTAIN_PERCENT, uncertainty_percent=percent)


# ---- from a session


def calibrate_poses(seen: Observed, mode: str | None, accel: TriadFit | None = None) -> Outcome:
    """Fit the accelerometer of a session to its free poses; an entry of FITS."""
    stills = _in_order(seen)
    creep = creep_of(seen, stills, "accel")
    fit = _fit_poses_of(seen, stills, creep)
    return Outcome(fit=fit, method="multi-position", findings=creep.findings(), used=stills)


def calibrate_moves(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to the moves between its poses; an entry of FITS."""
    stills = _in_order(seen)
    creep = creep_of(seen, stills, "accel"), creep_of(seen, stills, "gyro")
    model = (accel or _fit_poses_of(seen, stills, creep[0])).model
    fit = fit_moves(seen.session.records, stills, model, creep=creep)
    return Outcome(fit=fit, method="multi-position", findings=creep[1].findings())


def _fit_poses_of(seen: Observed, stills: Sequence[Still], creep: Creep) -> TriadFit:
    session, prior = seen.session, seen.settings.cross_axis_prior
    return fit_poses(session.records, stills, gravity=session.gravity_m_s2, cross_axis_prior=prior, creep=creep)


def _in_order(seen: Observed) -> tuple[Still, ...]:
    stills = seen.session.stills or seen.stills
    return tuple(sorted(stills, key=lambda still: (still.recording, still.start)))
