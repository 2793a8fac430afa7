"""Calibration without equipment: hold the device still in many poses, turn it by hand between them (Tedaldi et al., ICRA 2014).

    |M_a (u_k - o_a)| = g                over k = 1 .. K still poses; u_k mean raw reading, M_a upper triangular
    C(M_g, o_g) n_before = n_after       gyroscopes, over the moves between

A common rotation of all readings keeps their length, so three of twelve parameters are a choice of axes: the sensor's z axis is the
case's, its y axis lies in the case's y-z plane. A still is where the sliding variance of the accelerometer is below a multiple of
that at rest. Of several multiples, that one is taken, among those that keep nine tenths of the different poses, which leaves a
corrected reading least uncertain: a low threshold loses poses, a high one lets motion in.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs
from undrift.calibration.codes import code_steps, code_variance, limited_by_codes
from undrift.calibration.creep import Creep, Kind, OffsetPrior, creep_of, offset_prior
from undrift.calibration.norm import QUADRATIC_SD, TOLERANCE, WEAKEST, NormFit, check_count, fit_norm, judged
from undrift.calibration.plausibility import check_axis_order, check_own_scale, check_range, stuck_windows
from undrift.calibration.session import Observed, Outcome
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.findings import Finding, above, finding
from undrift.fit.equations import Rows, covariance_of, descend
from undrift.fit.least_squares import TriadFit, excess_variance, parameter_names, scaled_condition, triad_fit
from undrift.fit.priors import G_SENSITIVITY
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, TriadModel, Verdict
from undrift.record import Record, Still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- stills: where the sliding variance of the accelerometer is below a threshold
#     s2_k = |(var u_x, var u_y, var u_z)| over the window centred at k        sample variances, raw unit squared
#
# A turn about the vertical does not show in an accelerometer: where there are gyroscopes, a still is reduced to its core, in which
# their variance is as low as in most of the stills. Running sums make mean and variance of any stretch cost the same.

FEWEST_POSES = 7  # with a prior on cross-axis terms: scale, offset, and one pose to check them
WINDOW_S = 1.0  # of the sliding variance; each end of a still loses half of it
MIN_STILL_S = 1.0  # shortest still after that loss
QUIETEST = 0.05  # share of all windows that gives the level at rest
CORE = 4.0  # variance of the gyroscopes in the core of a still, in units of their median variance in all stills


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StillVariance:
    """Windowed variance of one record."""

    values: FloatArray  # (N, 3), readings, raw unit
    level: FloatArray  # (N,), s2, raw unit squared; infinite at the ends and next to gaps
    gyro_level: FloatArray | None  # (N,), the same of the gyroscopes, their unit squared; None without gyroscopes
    at_rest: float  # Value of ``level`` at rest, raw unit squared
    sums: FloatArray  # (2, N + 1, 3), running sums of the readings less ``centre``, and of their squares
    centre: FloatArray  # (3,), raw unit
    step: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,), of the codes, raw unit; 0 or NaN for none

    def below(self, threshold: float, least: int) -> list[tuple[int, int]]:
        """Return the stretches [start, stop) below a threshold."""
        found = runs(self.level < threshold)
        return [(int(a), int(b)) for a, b in found[found[:, 1] - found[:, 0] >= least]]


def still_variance(record: Record, window_s: float = WINDOW_S) -> StillVariance:
    """Return the windowed variance of a record's accelerometer and its level at rest."""
    if record.accel is None:
        raise InputError("still variance: wanted accel readings, got none; map the accelerometer columns")
    half = max(5, round(0.5 * window_s * record.sample_rate_hz))
    if len(record) < 2 * half + 2:
        raise InputError(
            f"still variance: wanted a record longer than its window of {window_s:g} s, got {record.duration_s:.2f} s; "
            "record longer"
        )
    level, sums, centre = _windowed(record.accel, half)
    finite = level[np.isfinite(level)]
    at_rest = float(np.quantile(finite, QUIETEST)) if len(finite) else np.inf
    gyro_level = None if record.gyro is None else _windowed(record.gyro, half)[0]
    return StillVariance(
        values=record.accel, level=level, gyro_level=gyro_level, at_rest=at_rest, sums=sums, centre=centre
    )


def _windowed(values: FloatArray, half: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the level over windows of 2 half + 1 samples, running sums of first and second powers, and their centre."""
    width = 2 * half + 1
    gap: BoolArray = np.asarray(np.isnan(values).any(axis=1))
    centre = values[~gap].mean(axis=0) if not gap.all() else np.zeros(3)
    u, sums = np.where(gap[:, None], 0.0, values - centre), np.zeros((2, len(values) + 1, 3))
    np.cumsum((u, u * u), axis=1, out=sums[:, 1:])
    s, q = sums[:, width:] - sums[:, :-width]
    lost = np.concatenate(([0], np.cumsum(gap)))
    level = np.full(len(u), np.inf)
    level[half:-half] = np.linalg.norm((q - s * s / width) / (width - 1), axis=1)
    level[half:-half][lost[width:] > lost[:-width]] = np.inf
    return level, sums, centre


# ---- gyroscopes from hand turns between still poses: integrate from one gravity direction to the next (Tedaldi et al., ICRA 2014)
#
#     C_j(M, o) n_j = n_(j+1)        C_j turns the body frame at the end of still j into that at the start of still j+1,
#                                    integrated from w = M (u - o); n_j direction of gravity in still j, from the accelerometer
#
# M is a full matrix in the accelerometer's axes. A turn shows two angles; the one about the vertical is not observable. Turns weigh
# by the covariance of the missed angles: noise of both stills (a still between two turns ties them together), uncertainty of the
# accelerometer's calibration, white noise over the turn, drift of the offset between stills, temperature creep (creep.py), and an
# excess that the residuals show; the stills' readings are observations of the offset.


# ---- moves between stills; direction of gravity and offset in the stills
#
# The direction of gravity in still k is n = a / |a|, a = M (u - o) of the mean reading, with
#
#     dn = (1 - n n^T) / |a| da        da = dM (u - o) - M do + M du


# Unit vectors in b (K, 3) of the specific force in each still, their derivative by the accelerometer's m_xx .. m_zz and offset
# (K, 3, 12), and their covariance from the noise of the still itself (K, 3, 3).
Directions = tuple[FloatArray, FloatArray, FloatArray]


class ByTurns(NamedTuple):
    """What turns by known angles show beside the moves."""

    matrix: FloatArray  # (3, 3), of the gyroscopes
    covariance: FloatArray  # (9, 9), of the matrix row by row
    by_creep: FloatArray  # (9, 3), what one deviation of each sensor's creep of scale adds to it
    prior: Callable[["Moves"], OffsetPrior]  # What rests show of the offset in each move

    def rows(self, unit: float) -> Rows:
        """Return the rows (9,), (9, 12) of the matrix at p = 0, and what creep adds to them, (9, 3)."""
        root = np.linalg.inv(np.linalg.cholesky(self.covariance))
        design = np.hstack((root / unit, np.zeros((9, 3))))
        return Rows(-root @ self.matrix.reshape(-1), design, root @ self.by_creep)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moves:
    """Readings of all records after one another, and the moves between stills in them."""

    gyro: FloatArray  # (N, 3), raw units
    accel: FloatArray
    time: FloatArray  # (N,), s, each record on its own clock
    first: IntArray  # (J,), last sample of the core before the move
    last: IntArray  # (J,), first sample of the core after it
    before: IntArray  # (J,), number of the still before; the next one is after it
    stills: tuple[IntArray, IntArray]  # (K,), samples [start, stop) of the stills: the accelerometer is at rest
    cores: tuple[IntArray, IntArray]  # (K,), samples of their cores: the gyroscopes are at rest too
    duration_s: FloatArray  # (J,), length of each move, s
    slip: FloatArray  # (J, 3, 3), covariance of the sum over each move by time stamps that jitter, (raw unit s)^2


def cut_moves(records: Sequence[Record], stills: Sequence[Still], cores: Sequence[Still]) -> Moves:
    """Return the moves between neighbouring stills of a record; moves with gaps or drop-outs are left out."""
    pairs = [(r.gyro, r.accel) for r in records]
    if (
        any(gyro is None or accel is None for gyro, accel in pairs)
        or len({(r.gyro_unit, r.accel_unit) for r in records}) > 1
    ):
        raise InputError(
            "multi-position gyro: wanted gyro and accel readings in the same units in every recording, got recordings that "
            "differ; fit the recordings that have both"
        )
    base = np.concatenate(([0], np.cumsum([len(r) for r in records])))
    ordered = sorted(zip(stills, cores, strict=True), key=lambda pair: (pair[0].recording, pair[0].start))
    begin = base[[still.recording for still, _ in ordered]]
    edges = [
        begin + np.array([getattr(p[k], end) for p in ordered], np.int64) for k in (0, 1) for end in ("start", "stop")
    ]
    core_start, core_stop = edges[2:]
    gyro = np.concatenate([gyro for gyro, _ in pairs if gyro is not None])
    time = np.concatenate([r.time for r in records])
    longest = 1.5 / np.array([r.sample_rate_hz for r in records])
    broken = np.isnan(gyro).any(axis=1) | (np.diff(time, prepend=time[0]) > np.repeat(longest, np.diff(base)))
    lost = np.concatenate(([0], np.cumsum(broken)))
    before = np.flatnonzero((begin[:-1] == begin[1:]) & (lost[core_start[1:] + 1] == lost[core_stop[:-1]]))
    first, last = core_stop[before] - 1, core_start[before + 1]
    slip = np.zeros((len(first), 3, 3))
    for k, (a, b) in enumerate(zip(first, last + 1, strict=True)):
        change = np.diff(gyro[a:b], axis=0)  # a stamp off by d moves the sum by d times that
        slip[k] = 0.5 * np.diff(time[a:b]).var() * (change.T @ change)
    return Moves(
        gyro=gyro,
        accel=np.concatenate([accel for _, accel in pairs if accel is not None]),
        time=time,
        first=first,
        last=last,
        before=before,
        stills=(edges[0], edges[1]),
        cores=(core_start, core_stop),
        duration_s=time[last] - time[first],
        slip=slip,
    )


def gravity_directions(moves: Moves, accel: TriadModel) -> Directions:
    """Return the direction of gravity in each still with its derivatives and covariance."""
    mean, variance, count = still_moments(moves.accel, *moves.stills)
    d = mean - accel.offset
    a = d @ accel.matrix.T
    length = np.linalg.norm(a, axis=1)
    n = a / length[:, None]
    across = (np.eye(3) - n[:, :, None] * n[:, None, :]) / length[:, None, None]
    by_matrix = (across[:, :, :, None] * d[:, None, None, :]).reshape(len(n), 3, 9)  # column 3 i + j: across e_i d_j
    turned = across @ accel.matrix
    covariance = (turned * variance / count[:, None, None]) @ turned.transpose(0, 2, 1)
    return n, np.concatenate((by_matrix, -turned), axis=2), covariance


def rough_matrix(moves: Moves, accel: TriadModel, offset: FloatArray) -> FloatArray:
    """Return a first gyroscope matrix from the slow change of the gravity direction.

    dn/dt = n x w with w = M (u - o), over blocks of 0.2 s while the device is moved: linear in M. The hand's own
    accelerations make it rough, some per cent.
    """
    normal, right = np.zeros((9, 9)), np.zeros(9)
    for first, last in zip(moves.first, moves.last, strict=True):
        step = (moves.time[last] - moves.time[first]) / max(1, last - first)
        block = max(2, round(0.2 / step))
        low, high = max(0, first - block), last + block  # into the stills, where the direction is sure
        blocks = (min(high, len(moves.time)) - low) // block
        if blocks < 3:
            continue
        cut = slice(low, low + blocks * block)
        force = (moves.accel[cut] - accel.offset).reshape(blocks, block, 3).mean(axis=1) @ accel.matrix.T
        rate = (moves.gyro[cut] - offset).reshape(blocks, block, 3).mean(axis=1)[1:-1]
        n = force / np.linalg.norm(force, axis=1)[:, None]
        turn = (n[2:] - n[:-2]) / (2.0 * block * step)
        design = (cross_matrix(n[1:-1])[:, :, :, None] * rate[:, None, None, :]).reshape(-1, 9)
        good = np.isfinite(design).all(axis=1) & np.isfinite(turn.reshape(-1))
        design, turn_flat = design[good], turn.reshape(-1)[good]
        normal += design.T @ design
        right += design.T @ turn_flat
    matrix: FloatArray = np.linalg.lstsq(normal, right, rcond=1e-10)[0].reshape(3, 3)
    return matrix


def still_moments(values: FloatArray, start: IntArray, stop: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the mean (K, 3) of each still, the variance (3,) of one sample pooled over all, and the counts (K,)."""
    mean, square, count = np.zeros((len(start), 3)), np.zeros(3), np.zeros(len(start), np.int64)
    for k, (low, high) in enumerate(zip(start, stop, strict=True)):
        piece = values[low:high]
        piece = piece[np.isfinite(piece).all(axis=1)]
        mean[k], count[k] = piece.mean(axis=0), len(piece)
        square += ((piece - mean[k]) ** 2).sum(axis=0)
    return mean, square / max(1, int(count.sum()) - len(start)), count


_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(0, 2, 1)  # of each axis


def cross_matrix(n: FloatArray) -> FloatArray:
    """Return the matrices (K, 3, 3) of the cross product with vectors (K, 3)."""
    return np.tensordot(n, _CROSS, axes=1)


def turned_in(moves: Moves, matrix: FloatArray, offset: FloatArray, drift: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotations C (J, 3, 3) of the moves, start to end, and the sums (J, 4, 3, 3) of their derivatives."""
    from undrift.kernels.calibrate import rotations_between

    j = len(moves.first)
    rotation, sums = np.empty(9 * j), np.empty(36 * j)
    flat, each = np.ascontiguousarray(matrix).reshape(-1), np.ascontiguousarray(drift).reshape(-1)
    gyro = moves.gyro.reshape(-1)
    rotations_between(gyro, moves.time, moves.first, moves.last, flat, offset, each, rotation, sums)
    return rotation.reshape(j, 3, 3).transpose(0, 2, 1), sums.reshape(j, 4, 3, 3)


# ---- fit

WEAKEST_TURN = 0.05  # rad rms that one unit of relative gain must turn gravity by; random turns of 90 deg give 0.4
_LOOSE = 0.01  # of the weight of turns by known angles while the scatter of the moves is sought
# Limits of a verdict: marginal above the first, bad above the second.
DRIFT_DPS = (0.2, 5.0)  # over the session: 0.2 deg/s is 12 deg in a minute; no warm-up of a sound part reaches 5 deg/s
MISS_DEG = (2.0, 8.0)
UNCERTAIN_PERCENT = (0.5, 5.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    """Parameters p: M times ``unit`` row by row, then (o - prior mean) / ``unit``."""

    moves: Moves
    directions: Directions
    felt: FloatArray  # (J, 3), mean specific force of each move less that of the stills, m/s2; the moves are freed of its effect
    accel: TriadModel
    prior: OffsetPrior
    unit: float
    codes: FloatArray  # (3,), variance that rounding leaves in the mean offset, raw unit squared
    creep: tuple[Creep, Creep] | None = None  # Of accelerometers and gyroscopes in the stills
    turned: Rows | None = None  # By which turns by known angles know the matrix, at p = 0

    @property
    def known(self) -> FloatArray:
        """Rows (3, 12) by which the stills know the offset, in its standard deviations."""
        weight = self.unit / np.sqrt(np.maximum(self.prior.variance, 1e-30))
        return np.hstack((np.zeros((3, 9)), np.diag(weight)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Missed:
    """Missed angles (2 J,), their Jacobian (2 J, 12), rotations C (J, 3, 3) and tangents at the later direction (J, 3, 2)."""

    angle: FloatArray
    jacobian: FloatArray
    turn: FloatArray
    tangent: FloatArray


def fit_gyro_between_stills(
    records: Sequence[Record],
    stills: Sequence[Still],
    accel: TriadModel,
    *,
    cores: Sequence[Still] | None = None,
    creep: tuple[Creep, Creep] | None = None,
    by_turns: ByTurns | None = None,
    scale_tolerance: float = TOLERANCE,
) -> TriadFit:
    """Fit gyroscopes to the moves between still poses; creep of accelerometers and gyroscopes in these, in order of time.

    ``by_turns`` is what turns by known angles show: an observation beside the moves.
    """
    moves, spoilt = _without_saturated(cut_moves(records, stills, stills if cores is None else cores))
    if len(moves.first) < (5 if by_turns is None else 1):
        left_out = "".join(f" ({item.text})" for item in spoilt)
        raise NotObservable(
            f"multi-position gyro: wanted 5 moves or more between stills for {parameter_names(MATRIX_NAMES)}, got "
            f"{len(moves.first)}{left_out}; turn the device by 90 deg or more about another axis between still poses of one "
            "recording",
            moves=len(moves.first),
        )
    directions = gravity_directions(moves, accel)
    rests, force = still_moments(moves.gyro, *moves.cores), STANDARD_GRAVITY * directions[0]
    prior = offset_prior(rests, moves.before, force, 0.0) if by_turns is None else by_turns.prior(moves)
    rough = rough_matrix(moves, accel, prior.mean) if by_turns is None else by_turns.matrix
    felt: FloatArray = np.zeros((len(moves.before), 3))
    if by_turns is None:
        size = float(np.cbrt(abs(np.linalg.det(rough)) + 1e-18 * np.abs(rough).max() ** 3))
        if not size > 0.0:
            raise NotObservable(
                f"multi-position gyro: in {len(moves.first)} moves between stills the gyroscopes read nothing but their offset. "
                "Check the gyroscope's columns, and turn the device by 90 deg or more about another axis between still poses",
                moves=len(moves.first),
            )
        prior = offset_prior(rests, moves.before, force, G_SENSITIVITY / size)
        moves, felt = _without_g(moves, accel, prior)
    within = [moves.gyro[a : b + 1] for a, b in zip(moves.first, moves.last, strict=True)]
    codes = code_variance(code_steps(records, rate=True), prior.noise)  # rests lie at one place between two codes
    prior = replace(prior, variance=prior.variance + codes, noise=prior.noise + codes)  # in motion it is noise again
    unit = float(np.sqrt(np.mean((np.concatenate([part[1:] for part in within]) - prior.mean) ** 2))) or 1.0
    problem = _Problem(
        moves=moves, directions=directions, felt=felt, accel=accel, prior=prior, unit=unit,
        creep=creep, codes=codes, turned=by_turns and by_turns.rows(unit),
    )  # fmt: skip
    p, covariance, missed = _solve(problem, np.concatenate((rough.reshape(-1) * unit, np.zeros(3))))
    if by_turns is None:
        _check_seen(missed, p)
    fit = _as_triad(problem, p, covariance, missed, records[0].gyro_unit, scale_tolerance)
    return replace(fit, verdict=fit.verdict.also(Verdict.of(*spoilt)))


def _without_g(moves: Moves, accel: TriadModel, prior: OffsetPrior) -> tuple[Moves, FloatArray]:
    """Return the moves under the mean specific force of the stills, and that of each move less it, (J, 3)."""
    if prior.g is None:
        return moves, np.zeros((len(moves.before), 3))
    felt = np.nan_to_num((moves.accel - accel.offset) @ accel.matrix.T - prior.force)
    mean = np.array([felt[a + 1 : b + 1].mean(axis=0) for a, b in zip(moves.first, moves.last, strict=True)])
    return replace(moves, gyro=moves.gyro - felt @ prior.g.T), mean


def _without_saturated(moves: Moves) -> tuple[Moves, tuple[Finding, ...]]:
    """Return the moves without those in which a gyroscope sticks at the end of its range, and the finding that names them."""
    spoilt = stuck_windows([moves.gyro[a : b + 1] for a, b in zip(moves.first, moves.last, strict=True)])
    if not spoilt.any():
        return moves, ()
    names = tuple(
        f"the move after still {before + 1} ({moves.time[first]:.1f}-{moves.time[last]:.1f} s)"
        for before, first, last in zip(moves.before[spoilt], moves.first[spoilt], moves.last[spoilt], strict=True)
    )
    left = finding("gyro.saturated", "warn", what="moves", count=int(spoilt.sum()), of=len(spoilt), pieces=names)
    cut = {name: getattr(moves, name)[~spoilt] for name in ("first", "last", "before", "duration_s", "slip")}
    return replace(moves, **cut), (left,)


def _solve(problem: _Problem, p: FloatArray) -> tuple[FloatArray, FloatArray, _Missed]:
    """Return parameters, their covariance and the missed angles; the angles' covariance is renewed until it settles."""
    count = 2 * len(problem.moves.first)
    stated, loose = problem, problem.turned and Rows(_LOOSE * problem.turned.residual, _LOOSE * problem.turned.design)
    # Turns that contradict the moves shall not make these scatter more
    problem, whitener = replace(problem, turned=loose), np.eye(count)
    p, rows = _descend(problem, p, _missed(problem, p), whitener, 1e-3)
    for _ in range(4):
        missed: _Missed = rows.state
        values, vectors = np.linalg.eigh(_covariance_of_angles(problem, missed, p))
        turned = vectors.T @ missed.angle
        variance = np.maximum(values, 0.0) + 1e-24
        variance += excess_variance(turned, variance, count - 9)
        before = p
        whitener = vectors.T / np.sqrt(variance)[:, None]
        p, rows = _descend(problem, p, missed, whitener, 1e-8)
        if float(np.abs(p - before).max()) < 1e-5:
            break
    if stated.turned is not None:
        p, rows = _descend(stated, p, rows.state, whitener, 1e-8)
    covariance = covariance_of(rows.design)
    # A scale creeps in turns and in moves, which may cancel
    if stated.turned is not None and problem.creep is not None:
        gain = covariance @ rows.design.T
        in_moves = -gain[:, :count] @ whitener @ _by_gyro_creep(problem, problem.creep[1], rows.state, p)
        in_turns = gain[:, count : count + 9] @ stated.turned.state
        covariance = covariance + in_moves @ in_turns.T + in_turns @ in_moves.T
    return p, covariance, rows.state


def _descend(
    problem: _Problem, p: FloatArray, missed: _Missed, whitener: FloatArray, tolerance: float
) -> tuple[FloatArray, Rows]:
    """Return the best parameters of fixed weights, and the rows there, from p and what that misses."""

    def white(values: FloatArray, missed: _Missed) -> Rows:
        rows = Rows(whitener @ missed.angle, whitener @ missed.jacobian, missed)
        if (other := problem.turned) is None:
            return rows
        away = other.residual + other.design @ values
        return Rows(np.concatenate((rows.residual, away)), np.vstack((rows.design, other.design)), missed)

    values, best, converged = descend(
        lambda values: white(values, _missed(problem, values)),
        p,
        problem.known,
        first=white(p, missed),
        tolerance=tolerance,
        size=np.ones(12),
    )
    if not converged:
        raise PoorFit(
            f"multi-position gyro: wanted a matrix that turns gravity through {len(problem.moves.first)} moves, got no "
            "convergence; check the gyroscope's columns and the time column",
            moves=len(problem.moves.first),
        )
    return values, best


def _missed(problem: _Problem, p: FloatArray) -> _Missed:
    moves, n = problem.moves, problem.directions[0]
    j = len(moves.first)
    matrix, offset = p[:9].reshape(3, 3) / problem.unit, problem.prior.mean + p[9:] * problem.unit
    turn, part = turned_in(moves, matrix, offset, problem.prior.drift)
    arrived = (turn @ n[moves.before][:, :, None])[:, :, 0]
    tangent = _tangent(n[moves.before + 1])
    by_matrix = part[:, 1:].transpose(0, 2, 3, 1).reshape(j, 3, 9) / problem.unit  # column 3 a + b: sum of R e_a d_b dt
    by_offset = -part[:, 0] @ matrix * problem.unit
    small_turn = turn @ np.concatenate((by_matrix, by_offset), axis=2)  # in the end frame; d(C n) = C n x small turn
    jacobian = tangent.transpose(0, 2, 1) @ cross_matrix(arrived) @ small_turn
    angle = (tangent.transpose(0, 2, 1) @ (arrived - n[moves.before + 1])[:, :, None]).reshape(-1)
    return _Missed(angle=angle, jacobian=jacobian.reshape(-1, 12), turn=turn, tangent=tangent)


def _covariance_of_angles(problem: _Problem, missed: _Missed, p: FloatArray) -> FloatArray:
    moves, prior, (unit, jacobian, of_still) = problem.moves, problem.prior, problem.directions
    across = missed.tangent.transpose(0, 2, 1)
    leaving = across @ missed.turn
    by_accel = (leaving @ jacobian[moves.before] - across @ jacobian[moves.before + 1]).reshape(-1, 12)
    by_still = np.zeros((len(moves.first), 2, len(unit), 3))
    each = np.arange(len(moves.first))
    by_still[each, :, moves.before] += leaving
    by_still[each, :, moves.before + 1] -= across
    spread = np.einsum("ejka,kab->ejkb", by_still, of_still).reshape(2 * len(each), -1)
    total = spread @ by_still.reshape(2 * len(each), -1).T + by_accel @ problem.accel.covariance[:12, :12] @ by_accel.T
    by_offset = missed.jacobian[:, 9:] / problem.unit
    for column, drift in zip(by_offset.T, prior.drift_covariance, strict=True):
        total += np.outer(column, column) * np.kron(drift, np.ones((2, 2)))
    for column, of_g in zip(by_offset.T, prior.g_covariance, strict=True):
        by_g = column[:, None] * np.repeat(problem.felt, 2, axis=0)
        total += by_g @ of_g @ by_g.T
    if problem.creep is not None:
        shared = np.hstack(
            (_by_accel_creep(problem, problem.creep[0], by_still), _by_gyro_creep(problem, problem.creep[1], missed, p))
        )
        total += shared @ shared.T
    matrix = p[:9].reshape(3, 3) / problem.unit
    # Time stamps that jitter turn further about the axis of the move, which is alike in all of it
    further = across @ cross_matrix(unit[moves.before + 1]) @ matrix
    total.reshape(len(each), 2, -1, 2)[each, :, each] += further @ moves.slip @ further.transpose(0, 2, 1)
    noise = float((matrix**2 @ prior.noise).mean())  # (rad/s)^2 of one sample, mean of the axes
    return np.asarray(total + np.diag(np.repeat(noise * moves.duration_s**2 / (moves.last - moves.first), 2)))


def _by_accel_creep(problem: _Problem, creep: Creep, by_still: FloatArray) -> FloatArray:
    """Return how offset and scale of each accelerometer turn the angles (2 J, 6): by_still (J, 2, K, 3) their derivative by n."""
    unit, jacobian, _ = problem.directions
    columns = [creep.columns(STANDARD_GRAVITY * unit[:, j], float(problem.accel.scale_factor[j])) for j in range(3)]
    moved = np.stack([-jacobian[:, :, 9 + j, None] * columns[j][:, None, :] for j in range(3)], axis=2)  # (K, 3, 3, 2)
    return np.asarray(np.einsum("jeka,kabc->jebc", by_still, moved).reshape(2 * len(by_still), 6))


def _by_gyro_creep(problem: _Problem, creep: Creep, missed: _Missed, p: FloatArray) -> FloatArray:
    """Return how the scale of each gyroscope turns the angles (2 J, 3); the stills themselves show how its offset moves."""
    warmth = _warmth_of_moves(problem, creep)
    by_scale = (missed.jacobian[:, :9] * p[:9]).reshape(-1, 3, 3).sum(axis=1)
    return np.asarray(creep.scale_per_k * np.repeat(warmth, 2)[:, None] * by_scale)


def _warmth_of_moves(problem: _Problem, creep: Creep) -> FloatArray:
    return np.asarray(0.5 * (creep.warmth[problem.moves.before] + creep.warmth[problem.moves.before + 1]))


def _tangent(n: FloatArray) -> FloatArray:
    """Return two unit vectors across each direction, shape (J, 3, 2)."""
    first = np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack((first, np.cross(n, first)), axis=2)


def _check_seen(missed: _Missed, p: FloatArray) -> None:
    matrix = p[:9].reshape(3, 3)
    by_matrix = missed.jacobian[:, :9].reshape(-1, 3, 3)
    gain = (by_matrix @ matrix.T).reshape(-1, 9)  # derivative by E of M = (1 + E) M: rad per unit of relative gain
    _, singular, right = np.linalg.svd(gain, full_matrices=False)
    singular = singular / np.sqrt(len(gain))
    share = np.linalg.norm(right[np.append(np.flatnonzero(singular < WEAKEST_TURN), 8)], axis=0)
    names = tuple(name for name, s in zip(MATRIX_NAMES, share, strict=True) if s > 0.3 * share.max())
    if singular[-1] < WEAKEST_TURN:
        raise NotObservable(
            f"multi-position gyro: wanted moves that turn gravity by {WEAKEST_TURN:g} rad or more per unit of every parameter, got "
            f"{singular[-1]:.2g} for {parameter_names(names)}; turn the device by 90 deg or more about each axis in turn while "
            "that axis lies level",
            weakest=float(singular[-1]),
            parameters=names,
        )


def _as_triad(
    problem: _Problem, p: FloatArray, covariance: FloatArray, missed: _Missed, unit_in: str, scale_tolerance: float
) -> TriadFit:
    moves = problem.moves
    rms_angle = float(np.sqrt(np.mean(missed.angle**2))) / RADIAN_PER_DEGREE
    if rms_angle > 20.0:
        raise PoorFit(
            f"multi-position gyro: wanted moves that end within 20 deg rms of gravity, got {rms_angle:.0f} deg; check that gyro "
            "and accel share one clock, that the sample rate is right and that no rate was beyond full scale",
            rms_angle_deg=rms_angle,
        )
    matrix, offset = p[:9].reshape(3, 3) / problem.unit, problem.prior.mean + p[9:] * problem.unit
    carry = np.array([1.0 / problem.unit] * 9 + [problem.unit] * 3)
    total = covariance * np.outer(carry, carry)
    residual, variance = problem.prior.drift, np.zeros(3)
    if problem.creep is not None and not problem.creep[1].none:  # the offset is that at the reference temperature
        warmth = _warmth_of_moves(problem, problem.creep[1])[:, None]
        residual = residual - warmth @ np.linalg.pinv(warmth) @ residual
        variance = np.diagonal(problem.prior.drift_covariance, axis1=1, axis2=2).mean(axis=1)
    # one offset stands for all of the session
    total[9:, 9:] += np.diag(np.maximum((residual**2).mean(axis=0) - variance, 0.0))
    inside = [moves.gyro[a + 1 : b + 1] for a, b in zip(moves.first, moves.last, strict=True)]
    rate = (np.concatenate(inside) - offset) @ matrix.T
    residuals = missed.angle.reshape(-1, 2) / moves.duration_s[:, None]
    check_axis_order(np.linalg.inv(matrix), "gyro against accel", against="accelerometer")
    offset, g, names, total = _with_g(problem.prior, matrix, offset, total)
    size = float(np.cbrt(abs(np.linalg.det(p[:9].reshape(3, 3)))))
    uncertain = float(np.sqrt(np.diag(covariance)[:9].max())) / size * 100.0
    drift = float(np.abs(np.ptp(problem.prior.drift @ matrix.T, axis=0)).max()) / RADIAN_PER_DEGREE
    fit = triad_fit(
        residuals,
        Verdict.of(
            *_judged(rms_angle, uncertain, drift, g),
            *limited_by_codes("gyroscope", problem.codes, np.diag(total)[9:12], unit_in),
        ),
        method="multi-position",
        unit_in=unit_in,
        unit_out="rad/s",
        matrix=matrix,
        offset=offset,
        g_sensitivity=g,
        parameters=names,
        covariance=total,
        rank=12 + (0 if g is None else g.size),
        condition=scaled_condition(missed.jacobian[:, :9])[1],
        valid_range=(float(rate.min()), float(rate.max())),
    )
    rate_hz = float(np.median((moves.last - moves.first) / moves.duration_s))
    check_own_scale(fit.model.scale_factor, unit_in, "rate", scale_tolerance, "gyro", sample_rate_hz=rate_hz)
    return fit


def _with_g(
    prior: OffsetPrior, matrix: FloatArray, offset: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray | None, tuple[str, ...], FloatArray]:
    """Return the offset under no force, G, the names of all parameters and their covariance; of a fit under the mean force.

    b = b_f - H f, G = M H: db = db_f - dH f, dG = dM H + M dH.
    """
    from scipy.linalg import block_diag

    names = (*MATRIX_NAMES, *OFFSET_NAMES)
    if prior.g is None:
        return offset, None, names, covariance
    jacobian = np.eye(21)
    jacobian[9:12, 12:] = -np.kron(np.eye(3), prior.force)
    jacobian[12:, :9], jacobian[12:, 12:] = np.kron(np.eye(3), prior.g.T), np.kron(matrix, np.eye(3))
    total = jacobian @ block_diag(covariance, *prior.g_covariance) @ jacobian.T
    return offset - prior.g @ prior.force, matrix @ prior.g, (*names, *G_NAMES), total


def _judged(rms_deg: float, percent: float, drift_dps: float, g: FloatArray | None) -> Iterator[Finding]:
    if g is not None:
        most = float(np.abs(g).max()) * STANDARD_GRAVITY / RADIAN_PER_DEGREE
        yield finding("multi_position.g_sensitivity_fitted", "info", dps_per_g=most)
    yield from above("multi_position.moves_miss", rms_deg, MISS_DEG, rms_deg=rms_deg)
    yield from above("multi_position.gyro_uncertainty", percent, UNCERTAIN_PERCENT, uncertainty_percent=percent)
    yield from above("multi_position.gyro_drift", drift_dps, DRIFT_DPS, drift_dps=drift_dps)


# ---- the whole method

SAME_POSE_DEG = 10.0  # directions nearer to each other than this count as one pose
# Thresholds to try, in units of the level at rest
MULTIPLES = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 15.0, 20.0, 30.0, 50.0)


class Attempt(NamedTuple):
    """The stills that one threshold finds, and the fit to them."""

    multiple: float  # Of the level at rest; NaN where the stills were stated
    stills: tuple[Still, ...]
    reading: FloatArray  # (K, 3), mean in each, raw unit
    fit: NormFit | None  # None where nothing could be fitted
    poses: int  # Different poses among them, by direction


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MultiPositionFit:
    """Accelerometer and, where the moves show them, gyroscopes."""

    accel: TriadFit  # Raw to m/s2
    gyro: TriadFit | None  # Raw to rad/s in the accelerometer's axes
    stills: tuple[Still, ...]  # Those that were used
    attempts: tuple[Attempt, ...]  # All thresholds tried
    missing: tuple[Finding, ...] = ()  # Why there are no gyroscopes


_NO_LENGTH = "multi-position: wanted poses of one length, got none that a linear sensor could give; check the columns"


def fit_multi_position(
    recorded: Record | Sequence[Record],
    *,
    gravity: float,
    stills: Sequence[Still] | None = None,
    gyro: bool = True,
    cross_axis_prior: float | None = 0.01,
    axes: TriadModel | None = None,
    creep: Callable[[Sequence[Still], Kind], Creep] | None = None,
    scale_tolerance: float = TOLERANCE,
) -> MultiPositionFit:
    """Calibrate from recordings of free poses and turns between them, all together; a recording may be a single pose.

    ``cross_axis_prior`` is the standard deviation of a cross-axis term that the poses do not show, of the scale; None refuses such
    poses. ``axes`` is an accelerometer's model from elsewhere, to which the gyroscopes are fitted where the poses do not show its
    axes; ``creep`` tells how far the temperature moves the readings of stills or moves of one triad.
    """
    records = (recorded,) if isinstance(recorded, Record) else tuple(recorded)
    if any(r.accel is None for r in records) or len({r.accel_unit for r in records}) > 1:
        raise InputError(
            "multi-position: wanted accel readings in one unit in every recording, got recordings without or in several units; "
            "map the accelerometer columns and their unit"
        )
    step = code_steps(records, rate=False)
    levels = [replace(still_variance(r), step=step) for r in records]
    shortest = [max(2, round(MIN_STILL_S * r.sample_rate_hz)) for r in records]
    stated = {} if stills is None else {np.nan: tuple(stills)}
    tried = stated or {m: _stills(levels, m, shortest) for m in MULTIPLES}
    attempts = [_attempt(levels, found, m, gravity, None) for m, found in tried.items()]
    chosen = _choose(attempts)
    if cross_axis_prior is not None and (chosen.fit is None or chosen.fit.weakest < WEAKEST):
        known = [_attempt(levels, found, m, gravity, cross_axis_prior) for m, found in tried.items()]
        better = _choose(known)
        if better.fit is not None and better.fit.weakest >= WEAKEST:
            attempts, chosen = known, better
    multiple, used, reading, fit, _ = chosen
    if fit is None:
        check_count(reading, known_noise=True)
        raise PoorFit(_NO_LENGTH)
    if creep is not None and not (moved := creep(used, "accel")).none:
        fit = _attempt(levels, used, multiple, gravity, cross_axis_prior if len(fit.prior) else None, moved).fit
        if fit is None:
            raise PoorFit(_NO_LENGTH)
    check_range([levels[s.recording].values[s.start : s.stop] for s in used], "accelerometer in still poses")
    accel = judged(fit, reading, records[0].accel_unit, scale_tolerance)
    between: TriadFit | None = None
    missing: tuple[Finding, ...] = ()
    if gyro and all(r.gyro is not None for r in records):
        cores = used if stills is not None else _cores(levels, used, shortest)
        try:
            model = axes if axes is not None and len(fit.prior) else accel.model
            ordered = sorted(used, key=lambda still: (still.recording, still.start))
            both = None if creep is None else (creep(ordered, "accel"), creep(ordered, "gyro"))
            between = fit_gyro_between_stills(
                records, used, model, cores=cores, creep=both, scale_tolerance=scale_tolerance
            )
        except NotObservable as error:
            missing = (finding("session.fit_failed", "warn", triad="gyroscope", reason=str(error)),)
    return MultiPositionFit(accel=accel, gyro=between, stills=used, attempts=tuple(attempts), missing=missing)


def _stills(levels: list[StillVariance], multiple: float, shortest: list[int]) -> tuple[Still, ...]:
    return tuple(
        Still(start=start, stop=stop, recording=number)
        for number, (level, least) in enumerate(zip(levels, shortest, strict=True))
        for start, stop in level.below(multiple * level.at_rest, least)
    )


def _cores(levels: list[StillVariance], stills: tuple[Still, ...], shortest: list[int]) -> tuple[Still, ...]:
    """Return the part of each still in which the gyroscopes are quiet, in the same order."""
    cores: list[Still] = []
    for number, (level, least) in enumerate(zip(levels, shortest, strict=True)):
        own, gyro = [s for s in stills if s.recording == number], level.gyro_level
        if gyro is None or not own:
            cores += own
            continue
        limit = CORE * float(np.median(np.concatenate([gyro[s.start : s.stop] for s in own])))
        for s in own:
            quiet = runs(gyro[s.start : s.stop] <= limit).tolist()
            first, last = max(quiet, key=lambda run: run[1] - run[0], default=(0, 0))
            cores.append(replace(s, start=s.start + first, stop=s.start + last) if last - first >= least else s)
    return tuple(cores)


def _attempt(
    levels: list[StillVariance],
    stills: tuple[Still, ...],
    multiple: float,
    gravity: float,
    prior_sd: float | None,
    creep: Creep | None = None,
) -> Attempt:
    means, variances = _poses(levels, stills)
    fit: NormFit | None = None
    if len(stills) >= (9 if prior_sd is None else FEWEST_POSES) and np.ptp(means, axis=0).any():
        with suppress(PoorFit):
            fit = fit_norm(
                means, gravity=gravity, variances=variances, prior_sd=prior_sd, creep=creep, quadratic_sd=QUADRATIC_SD,
            )  # fmt: skip
    return Attempt(multiple, stills, means, fit, poses=0 if fit is None else _different(fit.corrected(means)))


def _poses(levels: list[StillVariance], stills: tuple[Still, ...]) -> tuple[FloatArray, FloatArray]:
    """Return mean readings (K, 3) and their variances, the noise pooled over the stills of a recording."""
    means, variances = np.zeros((2, len(stills), 3))
    for number, level in enumerate(levels):
        rows = [k for k, s in enumerate(stills) if s.recording == number]
        start, stop = np.array([(stills[k].start, stills[k].stop) for k in rows], np.int64).reshape(-1, 2).T
        count = (stop - start)[:, None].astype(float)
        sums, squares = level.sums[:, stop] - level.sums[:, start]
        within = (squares - sums**2 / count).sum(axis=0) / max(1.0, float(count.sum()) - len(rows))
        within = np.maximum(within, 0.0)
        means[rows], variances[rows] = sums / count + level.centre, within / count + code_variance(level.step, within)
    return means, variances


def _different(force: FloatArray) -> int:
    """Return how many directions differ from all earlier ones."""
    n = force / np.linalg.norm(force, axis=1)[:, None]
    kept: list[int] = []
    for k, near in enumerate(n @ n.T > np.cos(np.radians(SAME_POSE_DEG))):
        kept += [] if near[kept].any() else [k]
    return len(kept)


def _choose(attempts: list[Attempt]) -> Attempt:
    fitted = [(one.fit.linear_uncertainty, one) for one in attempts if one.fit is not None]
    if not fitted:
        return max(attempts, key=lambda one: len(one.stills))
    # Thresholds that let motion in are far less certain; their false poses must not set the count to be reached.
    least = min(uncertainty for uncertainty, _ in fitted)
    most = max(one.poses for uncertainty, one in fitted if uncertainty <= 2.0 * least or not np.isfinite(least))
    enough = [(uncertainty, one) for uncertainty, one in fitted if one.poses >= 0.9 * most]
    return min(enough, key=lambda pair: pair[0])[1]


# ---- from a session


def _of_session(seen: Observed, axes: TriadFit | None = None, *, gyro: bool = True) -> MultiPositionFit:
    session = seen.session
    stills = session.stills or (seen.stills if seen.adapted else None)
    model = None if axes is None or axes.model.method.startswith("multi-position") else axes.model
    return fit_multi_position(
        session.records,
        gravity=session.gravity_m_s2,
        stills=stills,
        gyro=gyro,
        cross_axis_prior=seen.settings.cross_axis_prior,
        axes=model,
        creep=lambda pieces, kind: creep_of(seen, pieces, kind),
    )


def calibrate_poses(seen: Observed, mode: str | None, accel: TriadFit | None = None) -> Outcome:
    """Fit the accelerometer of a session to its free poses; an entry of FITS."""
    made = _of_session(seen, gyro=False)
    found = creep_of(seen, made.stills, "accel").findings()
    return Outcome(fit=made.accel, method="multi-position", findings=found, used=made.stills)


def calibrate_moves(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to the moves between its poses; an entry of FITS."""
    try:
        fit = _of_session(seen, accel)
    except NotObservable as error:
        return Outcome(findings=(finding("session.fit_failed", "warn", triad="gyroscope", reason=str(error)),))
    if fit.gyro is None:
        return Outcome(findings=fit.missing)
    return Outcome(fit=fit.gyro, method="multi-position", findings=creep_of(seen, fit.stills, "gyro").findings())
