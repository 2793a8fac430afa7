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

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.codes import code_steps, code_variance, limited_by_codes
from undrift.calibration.norm import NAMES, QUADRATIC_SD, TOLERANCE, check_count, fit_norm, judged
from undrift.calibration.plausibility import check_axis_order, check_own_scale, check_range, stuck_windows
from undrift.calibration.session import Observed, Outcome
from undrift.calibration.sources import Creep, Kind, creep_of, flicker_of_means, walk_about_mean
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.findings import Finding, above, finding
from undrift.fit.gls import GlsFit, Prior, solve
from undrift.fit.priors import G_SENSITIVITY, GYRO_FLICKER
from undrift.fit.triad import TriadFit, parameter_names, scaled_condition, triad_fit
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, TriadModel, Verdict
from undrift.record import Record, Still
from undrift.segments import find_poses
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

FEWEST_POSES = 7  # with a prior on cross-axis terms: scale, offset, and one pose to check them

# ---- moves between stills; direction of gravity in the stills
#
# The direction of gravity in still k is n = a / |a|, a = M (u - o) of the mean reading, with
#
#     dn = (1 - n n^T) / |a| da        da = dM (u - o) - M do + M du


# Unit vectors in b (K, 3) of the specific force in each still, their derivative by the accelerometer's m_xx .. m_zz and offset
# (K, 3, 12), and their covariance from the noise of the still itself (K, 3, 3).
Directions = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moves:
    """Readings of all records after one another, and the moves between stills in them."""

    gyro: FloatArray  # (N, 3), raw units
    accel: FloatArray
    time: FloatArray  # (N,), s, each record on its own clock
    first: IntArray  # (J,), last sample of the still before the move
    last: IntArray  # (J,), first sample of the still after it
    before: IntArray  # (J,), number of the still before; the next one is after it
    stills: tuple[IntArray, IntArray]  # (K,), samples [start, stop) of the stills
    duration_s: FloatArray  # (J,), length of each move, s

    @property
    def spans(self) -> FloatArray:
        """Start and end of the stills and the moves (K + J, 2), s, on one clock; recordings follow each other."""
        clock = np.concatenate(([0.0], np.cumsum(np.diff(self.time).clip(0.0))))
        stills = np.stack((self.stills[0], self.stills[1] - 1))
        return np.asarray(clock[np.hstack((stills, np.stack((self.first, self.last)))).T])


def cut_moves(records: Sequence[Record], stills: Sequence[Still]) -> Moves:
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
    ordered = sorted(stills, key=lambda still: (still.recording, still.start))
    begin = base[[still.recording for still in ordered]]
    start, stop = (begin + np.array([getattr(still, end) for still in ordered], np.int64) for end in ("start", "stop"))
    gyro = np.concatenate([gyro for gyro, _ in pairs if gyro is not None])
    time = np.concatenate([r.time for r in records])
    longest = 1.5 / np.array([r.sample_rate_hz for r in records])
    broken = np.isnan(gyro).any(axis=1) | (np.diff(time, prepend=time[0]) > np.repeat(longest, np.diff(base)))
    lost = np.concatenate(([0], np.cumsum(broken)))
    before = np.flatnonzero((begin[:-1] == begin[1:]) & (lost[start[1:] + 1] == lost[stop[:-1]]))
    first, last = stop[before] - 1, start[before + 1]
    return Moves(
        gyro=gyro,
        accel=np.concatenate([accel for _, accel in pairs if accel is not None]),
        time=time,
        first=first,
        last=last,
        before=before,
        stills=(start, stop),
        duration_s=time[last] - time[first],
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


# ---- offset of the gyroscopes in the moves

_LEAST_WITH_G = 8  # rests: three columns more, and four for sway and drift
_LEAST_CHANGE = 0.5  # g, root sum of squares over the rests: poses that differ less do not determine the g-sensitivity
_TURNING = 8.0  # median deviations: a still that reads more turns about the vertical


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OffsetPrior:
    """Offset, g-sensitivity, drift and noise of the gyroscopes from the stills."""

    mean: FloatArray  # (3,), mean offset over the stills, under their mean specific force, raw unit
    variance: FloatArray  # (3,), of the mean, raw unit squared
    drift: FloatArray  # (J, 3), offset of each move minus the mean, raw unit
    drift_covariance: FloatArray  # (3, J, J), of the drift, per axis, raw unit squared
    noise: FloatArray  # (3,), variance of one sample at rest, raw unit squared
    force: FloatArray  # (3,), mean specific force, m/s2
    g: FloatArray | None = None  # (3, 3), H, raw unit per m/s2; None if the stills do not determine it
    g_covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3, 3)))  # of each row


def offsets_in_moves(
    moves: Moves, scale: FloatArray, *, force: FloatArray | None = None, walk: FloatArray | None = None
) -> OffsetPrior:
    """Return the offset in each move from the rests; scale (3,) is raw units per rad/s.

    o and H by least squares, d of a move from the rests around it (best linear prediction). ``force`` (K, 3) is the specific force
    in the rests; without it the readings are free of H. ``walk`` (3,), (rad/s)^2 / s, is the size of the random walk; without it,
    the walk and the sway of the hand are excess variances of the rests. Stills that turn about the vertical are left out.
    """
    reading, noise, count = still_moments(moves.gyro, *moves.stills)
    away = np.abs(reading - np.median(reading, axis=0))
    rest = np.all(away <= _TURNING * np.maximum(np.median(away, axis=0), 1e-12), axis=1)
    force = np.zeros_like(reading) if force is None else force
    middle = (count * rest) @ force / max(1, int((count * rest).sum()))
    felt, number = force - middle, len(reading)
    if rest.sum() < _LEAST_WITH_G or np.linalg.svd(felt[rest], compute_uv=False)[-1] < _LEAST_CHANGE * STANDARD_GRAVITY:
        felt = felt[:, :0]
    about_mean = np.eye(number + len(moves.before))  # d counts from the mean over the rests
    about_mean[:, :number] -= rest / rest.sum()
    flicker = about_mean @ flicker_of_means(moves.spans) @ about_mean.T
    brownian = about_mean @ walk_about_mean(moves.spans.mean(axis=1)) @ about_mean.T
    rests = np.flatnonzero(rest)
    design, columns = np.hstack((np.ones((number, 1)), felt))[rests], felt.shape[1]
    own = np.ix_(rests, rests)
    fits = list[GlsFit]()
    drift: FloatArray = np.zeros((len(moves.before), 3))
    drift_covariance: FloatArray = np.zeros((3, len(moves.before), len(moves.before)))
    for axis in range(3):
        instability = (GYRO_FLICKER * scale[axis]) ** 2
        white = np.maximum(noise[axis] / count[rests], 1e-6 * instability)
        total: FloatArray = instability * flicker
        if walk is not None:
            total = total + walk[axis] * scale[axis] ** 2 * brownian
        fit = solve(
            design,
            reading[rests, axis],
            {"noise": white, "drift": total[own]},
            excess={"walk": brownian[own], "sway": np.ones(len(rests))} if walk is None else {},
            prior=Prior(
                mean=np.zeros(1 + columns),
                precision=np.diag([0.0] + [(G_SENSITIVITY * scale[axis]) ** -2] * columns),
            ),
        )
        total = total + fit.excess.get("walk", 0.0) * brownian
        to_moves = total[number:, rests] @ np.linalg.inv(total[own] + np.diag(white + fit.excess.get("sway", 0.0)))
        drift[:, axis] = to_moves @ fit.residuals
        drift_covariance[axis] = total[number:, number:] - to_moves @ total[rests, number:]
        fits.append(fit)
    return OffsetPrior(
        mean=np.array([fit.theta[0] for fit in fits]),
        variance=np.array([fit.covariance[0, 0] for fit in fits]),
        drift=drift,
        drift_covariance=drift_covariance,
        noise=noise,
        force=middle,
        g=np.array([fit.theta[1:] for fit in fits]) if columns else None,
        g_covariance=np.array([fit.covariance[1:, 1:] for fit in fits]) if columns else np.zeros((3, 3, 3)),
    )


# ---- fit

WEAKEST_TURN = 0.05  # rad rms that one unit of relative gain must turn gravity by; random turns of 90 deg give 0.4
MOST_STEPS, CONVERGED = 30, 1e-6  # of Gauss-Newton; relative change of the matrix
_LEAST_ANGLE = 1e-10  # rad: standard deviation that every angle has at least
_LOOSE = 1e-4  # of the precision of turns by known angles while the excess of the moves is determined
_CONTRADICTS = 0.5  # of the matrix from the turns: moves that change it by more mean other axes or another clock
# Limits of a verdict: marginal above the first, bad above the second.
DRIFT_DPS = (0.2, 5.0)  # over the session: 0.2 deg/s is 12 deg in a minute; no warm-up of a sound part reaches 5 deg/s
MISS_DEG = (2.0, 8.0)
UNCERTAIN_PERCENT = (0.5, 5.0)


class ByTurns(NamedTuple):
    """Matrix of the gyroscopes from turns by known angles, an observation beside the moves."""

    matrix: FloatArray  # (3, 3)
    covariance: FloatArray  # (9, 9), of the matrix row by row
    prior: Callable[[Moves], OffsetPrior]  # offset in each move from the rests


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    """Parameters theta (12,): M row by row, then o minus its mean over the rests, in raw units."""

    moves: Moves
    directions: Directions
    felt: FloatArray  # (J, 3), mean specific force of each move minus that of the stills, m/s2; the moves are freed of its effect
    accel: TriadModel
    offset: OffsetPrior
    codes: FloatArray  # (3,), variance that rounding leaves in the mean offset, raw unit squared
    creep: tuple[Creep, Creep] | None = None  # of accelerometers and gyroscopes in the stills


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
    creep: tuple[Creep, Creep] | None = None,
    by_turns: ByTurns | None = None,
) -> TriadFit:
    """Fit gyroscopes to the moves between still poses; creep of accelerometers and gyroscopes in these, in order of time.

    ``by_turns`` is the result of turns by known angles: an observation beside the moves.
    """
    moves, spoilt = _without_saturated(cut_moves(records, stills))
    if len(moves.first) < (5 if by_turns is None else 1):
        left_out = "".join(f" ({item.text})" for item in spoilt)
        raise NotObservable(
            f"multi-position gyro: wanted 5 moves or more between stills for {parameter_names(MATRIX_NAMES)}, got "
            f"{len(moves.first)}{left_out}; turn the device by 90 deg or more about another axis between still poses of one "
            "recording",
            moves=len(moves.first),
        )
    directions = gravity_directions(moves, accel)
    felt: FloatArray = np.zeros((len(moves.before), 3))
    if by_turns is None:
        reading, _, _ = still_moments(moves.gyro, *moves.stills)
        matrix = rough_matrix(moves, accel, np.median(reading, axis=0))
        size = float(np.cbrt(abs(np.linalg.det(matrix)) + 1e-18 * np.abs(matrix).max() ** 3))
        if not size > 0.0:
            raise NotObservable(
                f"multi-position gyro: in {len(moves.first)} moves between stills the gyroscopes read nothing but their offset. "
                "Check the gyroscope's columns, and turn the device by 90 deg or more about another axis between still poses",
                moves=len(moves.first),
            )
        offset = offsets_in_moves(moves, np.full(3, 1.0 / size), force=STANDARD_GRAVITY * directions[0])
        moves, felt = _without_g(moves, accel, offset)
    else:
        matrix, offset = by_turns.matrix, by_turns.prior(moves)
    codes = code_variance(code_steps(records, rate=True), offset.noise)  # rests lie at one place between two codes
    offset = replace(
        offset, variance=offset.variance + codes, noise=offset.noise + codes
    )  # in motion it is noise again
    problem = _Problem(
        moves=moves, directions=directions, felt=felt, accel=accel, offset=offset, codes=codes, creep=creep
    )
    theta, covariance, missed = _solve(problem, matrix, by_turns)
    if by_turns is None:
        _check_determined(missed, theta)
    elif (
        np.abs(theta[:9] - by_turns.matrix.ravel()).max() > _CONTRADICTS * np.abs(by_turns.matrix).max()
        or _rms_deg(missed) > MISS_DEG[1]
    ):
        raise PoorFit("multi-position gyro: the moves between rests contradict the turns. Check axes and clocks.")
    fit = _as_triad(problem, theta, covariance, missed, records[0].gyro_unit)
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
    cut = {name: getattr(moves, name)[~spoilt] for name in ("first", "last", "before", "duration_s")}
    return replace(moves, **cut), (left,)


def _solve(problem: _Problem, matrix: FloatArray, by_turns: ByTurns | None) -> tuple[FloatArray, FloatArray, _Missed]:
    """Return the parameters, their covariance and the missed angles.

    Turns that contradict the moves shall not enlarge the excess of the moves: it is determined with a loose prior from the turns.
    """
    theta, precision = np.append(matrix, np.zeros(3)), np.diag([0.0] * 9 + (1.0 / problem.offset.variance).tolist())
    ones = np.ones(2 * len(problem.moves.first))
    if by_turns is None:
        fit, missed = _descend(problem, theta, Prior(mean=theta, precision=precision), {"hand": ones}, None)
        return fit.theta, fit.covariance, missed
    turns = np.linalg.inv(by_turns.covariance)
    precision[:9, :9] = _LOOSE * turns
    fit, _ = _descend(problem, theta, Prior(mean=theta, precision=precision), {"hand": ones}, None)
    precision[:9, :9] = turns
    hand = fit.excess_bound("hand") * ones
    fit, missed = _descend(problem, fit.theta, Prior(mean=theta, precision=precision), {}, hand)
    return fit.theta, fit.covariance, missed


def _descend(
    problem: _Problem, theta: FloatArray, prior: Prior, excess: Mapping[str, FloatArray], hand: FloatArray | None
) -> tuple[GlsFit, _Missed]:
    """Return the fit and the missed angles at its parameters: Gauss-Newton, with the covariance of the angles at each step."""
    size = float(np.abs(theta[:9]).max())
    for _ in range(MOST_STEPS):
        missed = _missed(problem, theta)
        sources = _sources(problem, missed, theta) | ({} if hand is None else {"hand": hand})
        try:
            fit = solve(missed.jacobian, missed.jacobian @ theta - missed.angle, sources, excess=excess, prior=prior)
        except np.linalg.LinAlgError:
            _check_determined(missed, theta)
            break
        change, theta = np.abs(fit.theta - theta)[:9].max(), fit.theta
        if change < CONVERGED * size:
            return fit, _missed(problem, theta)
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
    turn, part = turned_in(moves, matrix, problem.offset.mean + theta[9:], problem.offset.drift)
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
    moves, offset, (unit, jacobian, of_still) = problem.moves, problem.offset, problem.directions
    across, count = missed.tangent.transpose(0, 2, 1), len(moves.first)
    leaving = across @ missed.turn
    by_accel = (leaving @ jacobian[moves.before] - across @ jacobian[moves.before + 1]).reshape(-1, 12)
    by_still, each = np.zeros((count, 2, len(unit), 3)), np.arange(count)
    by_still[each, :, moves.before] += leaving
    by_still[each, :, moves.before + 1] -= across
    stills = np.einsum("ejka,kab->ejkb", by_still, of_still).reshape(2 * count, -1) @ by_still.reshape(2 * count, -1).T
    noise = float((theta[:9].reshape(3, 3) ** 2 @ offset.noise).mean())  # (rad/s)^2 of one sample, mean of the axes
    readings = np.repeat(noise * moves.duration_s**2 / (moves.last - moves.first), 2)
    drift, by_offset = np.zeros((2 * count, 2 * count)), missed.jacobian[:, 9:]
    for column, of_drift, of_g in zip(by_offset.T, offset.drift_covariance, offset.g_covariance, strict=True):
        by_g = column[:, None] * np.repeat(problem.felt, 2, axis=0)
        drift += np.outer(column, column) * np.kron(of_drift, np.ones((2, 2))) + by_g @ of_g @ by_g.T
    sources = {
        "noise": stills + np.diag(readings + _LEAST_ANGLE**2),
        "accelerometer": by_accel @ problem.accel.covariance[:12, :12] @ by_accel.T,
        "offset": drift,
    }
    if problem.creep is not None:
        of_accel, of_gyro = problem.creep
        columns = [
            of_accel.columns(STANDARD_GRAVITY * unit[:, j], float(problem.accel.scale_factor[j])) for j in range(3)
        ]
        moved = np.stack(
            [-jacobian[:, :, 9 + j, None] * columns[j][:, None, :] for j in range(3)], axis=2
        )  # (K, 3, 3, 2)
        by_poses = np.einsum("jeka,kabc->jebc", by_still, moved).reshape(2 * count, 6)
        by_scale = (missed.jacobian[:, :9] * theta[:9]).reshape(-1, 3, 3).sum(axis=1)
        by_moves = of_gyro.scale_per_k * np.repeat(_warmth_of_moves(problem, of_gyro), 2)[:, None] * by_scale
        sources["temperature"] = by_poses @ by_poses.T + by_moves @ by_moves.T
    return sources


def _warmth_of_moves(problem: _Problem, creep: Creep) -> FloatArray:
    return np.asarray(0.5 * (creep.warmth[problem.moves.before] + creep.warmth[problem.moves.before + 1]))


def _tangent(n: FloatArray) -> FloatArray:
    """Return two unit vectors across each direction, shape (J, 3, 2)."""
    first = np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack((first, np.cross(n, first)), axis=2)


def _check_determined(missed: _Missed, theta: FloatArray) -> None:
    matrix = theta[:9].reshape(3, 3)
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


def _rms_deg(missed: _Missed) -> float:
    """Return the angle by which the moves miss gravity, rms, deg."""
    return float(np.sqrt(np.mean(missed.angle**2))) / RADIAN_PER_DEGREE


def _as_triad(problem: _Problem, theta: FloatArray, covariance: FloatArray, missed: _Missed, unit_in: str) -> TriadFit:
    moves = problem.moves
    rms_angle = _rms_deg(missed)
    if rms_angle > 20.0:
        raise PoorFit(
            f"multi-position gyro: wanted moves that end within 20 deg rms of gravity, got {rms_angle:.0f} deg; check that gyro "
            "and accel share one clock, that the sample rate is right and that no rate was beyond full scale",
            rms_angle_deg=rms_angle,
        )
    matrix, total = theta[:9].reshape(3, 3), covariance.copy()
    offset: FloatArray = problem.offset.mean + theta[9:]
    residual: FloatArray = problem.offset.drift
    variance: FloatArray = np.zeros(3)
    if problem.creep is not None and not problem.creep[1].none:  # the offset is that at the reference temperature
        warmth = _warmth_of_moves(problem, problem.creep[1])[:, None]
        residual = residual - warmth @ np.linalg.pinv(warmth) @ residual
        variance = np.diagonal(problem.offset.drift_covariance, axis1=1, axis2=2).mean(axis=1)
    # one offset stands for all of the session
    total[9:, 9:] += np.diag(np.maximum((residual**2).mean(axis=0) - variance, 0.0))
    inside = [moves.gyro[a + 1 : b + 1] for a, b in zip(moves.first, moves.last, strict=True)]
    rate = (np.concatenate(inside) - offset) @ matrix.T
    residuals = missed.angle.reshape(-1, 2) / moves.duration_s[:, None]
    check_axis_order(np.linalg.inv(matrix), "gyro against accel", against="accelerometer")
    offset, g, names, total = _with_g(problem.offset, matrix, offset, total)
    size = float(np.cbrt(abs(np.linalg.det(matrix))))
    uncertain = float(np.sqrt(np.diag(covariance)[:9].max())) / size * 100.0
    drift = float(np.abs(np.ptp(problem.offset.drift @ matrix.T, axis=0)).max()) / RADIAN_PER_DEGREE
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
    check_own_scale(fit.model.scale_factor, unit_in, "rate", TOLERANCE, "gyro", sample_rate_hz=rate_hz)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MultiPositionFit:
    """Accelerometer and, if the moves determine them, gyroscopes."""

    accel: TriadFit  # raw to m/s2
    gyro: TriadFit | None  # raw to rad/s in the accelerometer's axes
    stills: tuple[Still, ...]  # in order of time
    missing: tuple[Finding, ...] = ()  # why there are no gyroscopes


def fit_multi_position(
    recorded: Record | Sequence[Record],
    *,
    gravity: float,
    stills: Sequence[Still] | None = None,
    gyro: bool = True,
    cross_axis_prior: float | None = 0.01,
    axes: TriadModel | None = None,
    creep: Callable[[Sequence[Still], Kind], Creep] | None = None,
) -> MultiPositionFit:
    """Calibrate from recordings of free poses and turns between them, all together; a recording may be a single pose.

    ``stills`` are found in the recordings by default. ``cross_axis_prior`` is the standard deviation of a cross-axis term that the
    poses do not determine, of the scale; None refuses such poses. ``axes`` is an accelerometer's model from elsewhere, to which
    the gyroscopes are fitted if the poses do not determine its axes; ``creep`` returns how far the temperature moves the readings
    of stills or moves of one triad.
    """
    records = (recorded,) if isinstance(recorded, Record) else tuple(recorded)
    if any(r.accel is None for r in records) or len({r.accel_unit for r in records}) > 1:
        raise InputError(
            "multi-position: wanted accel readings in one unit in every recording, got recordings without or in several units; "
            "map the accelerometer columns and their unit"
        )
    if stills is None:
        stills = [still for search in find_poses(records) for still in search.stills]
    used = tuple(sorted(stills, key=lambda still: (still.recording, still.start)))
    reading, variances = _pose_means(records, used)
    if len(used) < (FEWEST_POSES if cross_axis_prior else len(NAMES)) or not np.ptp(reading, axis=0).any():
        check_count(reading, known_noise=True)
    moved = None if creep is None else creep(used, "accel")
    fit = fit_norm(
        reading, gravity=gravity, variances=variances, prior_sd=cross_axis_prior, creep=moved, quadratic_sd=QUADRATIC_SD
    )
    values = [np.asarray(records[s.recording].accel)[s.start : s.stop] for s in used]
    check_range(values, "accelerometer in still poses")
    accel = judged(fit, reading, records[0].accel_unit)
    between: TriadFit | None = None
    missing: tuple[Finding, ...] = ()
    if gyro and all(r.gyro is not None for r in records):
        model = axes if axes is not None and len(fit.prior) else accel.model
        both = None if creep is None or moved is None else (moved, creep(used, "gyro"))
        try:
            between = fit_gyro_between_stills(records, used, model, creep=both)
        except NotObservable as error:
            missing = (finding("session.fit_failed", "warn", triad="gyroscope", reason=str(error)),)
    return MultiPositionFit(accel=accel, gyro=between, stills=used, missing=missing)


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


# ---- from a session


def _of_session(seen: Observed, axes: TriadFit | None = None, *, gyro: bool = True) -> MultiPositionFit:
    session = seen.session
    model = None if axes is None or axes.model.method.startswith("multi-position") else axes.model
    return fit_multi_position(
        session.records,
        gravity=session.gravity_m_s2,
        stills=session.stills or seen.stills,
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
