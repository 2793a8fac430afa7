"""What the gyroscope fit of the multi-position method works on: moves between stills, and what the stills say.

The direction of gravity in still k is n = a / |a|, a = M (u - o) of the mean reading, with::

    dn = (1 - n n^T) / |a| da        da = dM (u - o) - M do + M du
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.fit.excess import excess_variance
from undrift.calibration.model import TriadModel
from undrift.errors import InputError
from undrift.record import Record
from undrift.session import Still


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Directions:
    """Direction of the specific force in each still.

    Parameters
    ----------
    unit : array, shape (K, 3)
        Unit vectors in b.
    jacobian : array, shape (K, 3, 12)
        Derivative by the accelerometer's m_xx .. m_zz and offset.
    covariance : array, shape (K, 3, 3)
        From the noise of the still itself.
    model_covariance : array, shape (12, 12)
        Of the accelerometer's parameters.
    """

    unit: FloatArray
    jacobian: FloatArray
    covariance: FloatArray
    model_covariance: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OffsetPrior:
    """What the device at rest says of the gyroscopes' offset and noise.

    Parameters
    ----------
    mean : array, shape (3,)
        Mean offset over the stills, raw unit.
    variance : array, shape (3,)
        Of the mean, raw unit squared.
    drift : array, shape (J, 3)
        Offset of each move less the mean, raw unit; zeros where the stills do not show a drift.
    drift_covariance : array, shape (3, J, J)
        Of the drift, per axis, raw unit squared.
    noise : array, shape (3,)
        Variance of one sample at rest, raw unit squared.
    """

    mean: FloatArray
    variance: FloatArray
    drift: FloatArray
    drift_covariance: FloatArray
    noise: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moves:
    """Readings of all records after one another, and the moves between stills in them.

    Parameters
    ----------
    gyro, accel : array, shape (N, 3)
        Raw units.
    time : array, shape (N,)
        s, each record on its own clock.
    first, last : array, shape (J,)
        Last sample of the core before, first sample of the core after.
    before, after : array, shape (J,)
        Numbers of those stills.
    start, stop : array, shape (K,)
        Samples [start, stop) of the stills: where the accelerometer is quiet.
    core_start, core_stop : array, shape (K,)
        Samples of their cores: where the gyroscopes are quiet too.
    """

    gyro: FloatArray
    accel: FloatArray
    time: FloatArray
    first: IntArray
    last: IntArray
    before: IntArray
    after: IntArray
    start: IntArray
    stop: IntArray
    core_start: IntArray
    core_stop: IntArray

    @property
    def duration_s(self) -> FloatArray:
        """Length of each move, s, shape (J,)."""
        length: FloatArray = self.time[self.last] - self.time[self.first]
        return length


def cut_moves(records: Sequence[Record], stills: Sequence[Still], cores: Sequence[Still]) -> Moves:
    """Return the moves between neighbouring stills of a record; moves with gaps or drop-outs are left out.

    Parameters
    ----------
    records : sequence of Record
        With gyro and accel.
    stills : sequence of Still
        Their ``recording`` numbers the records.
    cores : sequence of Still
        The core of each; moves run from core to core.

    Returns
    -------
    Moves
        Readings in one row of samples.

    Raises
    ------
    InputError
        A record without gyro or accel readings, or units that differ between records.
    """
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
    first = base[[still.recording for still, _ in ordered]]
    start, stop = (first + np.array([getattr(still, end) for still, _ in ordered]) for end in ("start", "stop"))
    core_start, core_stop = (first + np.array([getattr(core, end) for _, core in ordered]) for end in ("start", "stop"))
    gyro = np.concatenate([gyro for gyro, _ in pairs if gyro is not None])
    time = np.concatenate([r.time for r in records])
    longest = 1.5 / np.array([r.sample_rate_hz for r in records])
    broken = np.isnan(gyro).any(axis=1) | (np.diff(time, prepend=time[0]) > np.repeat(longest, np.diff(base)))
    lost = np.concatenate(([0], np.cumsum(broken)))
    kept = [
        k
        for k in range(len(ordered) - 1)
        if first[k] == first[k + 1] and lost[core_start[k + 1] + 1] == lost[core_stop[k]]
    ]
    before = np.array(kept, np.int64)
    return Moves(
        gyro=gyro,
        accel=np.concatenate([accel for _, accel in pairs if accel is not None]),
        time=time,
        first=core_stop[before] - 1,
        last=core_start[before + 1],
        before=before,
        after=before + 1,
        start=start,
        stop=stop,
        core_start=core_start,
        core_stop=core_stop,
    )


def gravity_directions(moves: Moves, accel: TriadModel) -> Directions:
    """Return the direction of gravity in each still with its derivatives and covariance.

    Parameters
    ----------
    moves : Moves
        Stills and readings.
    accel : TriadModel
        Raw to m/s2, m_xx .. m_zz and offset first among its parameters.

    Returns
    -------
    Directions
        Unit vectors in b.
    """
    mean, variance, count = still_moments(moves.accel, moves.start, moves.stop)
    d = mean - accel.offset
    a = d @ accel.matrix.T
    length = np.linalg.norm(a, axis=1)
    n = a / length[:, None]
    across = (np.eye(3) - n[:, :, None] * n[:, None, :]) / length[:, None, None]
    by_matrix = (across[:, :, :, None] * d[:, None, None, :]).reshape(len(n), 3, 9)  # column 3 i + j: across e_i d_j
    turned = across @ accel.matrix
    return Directions(
        unit=n,
        jacobian=np.concatenate((by_matrix, -turned), axis=2),
        covariance=(turned * variance / count[:, None, None]) @ turned.transpose(0, 2, 1),
        model_covariance=accel.covariance[:12, :12],
    )


def offset_prior(moves: Moves) -> OffsetPrior:
    """Return offset, drift and noise of the gyroscopes from all stills.

    The mean reading of still k is b_k plus jitter plus the noise within; the offset b_(k+1) = b_k + N(0, q) is a random
    walk. A hand that sways makes jitter, a sensor that warms up walks: the two are told apart by whether neighbours are
    alike (von Neumann's ratio [1]_); where they are not, q = 0 and the offset is one constant. A move has the mean offset of
    its two stills, uncertain by q / 12 more. Stills that turn about the vertical, which an accelerometer cannot see, are
    left out.

    Parameters
    ----------
    moves : Moves
        Stills and readings.

    Returns
    -------
    OffsetPrior
        Per axis.

    References
    ----------
    .. [1] J. von Neumann, "Distribution of the ratio of the mean square successive difference to the variance", Ann. Math.
       Stat. 12, 1941, 367-395.
    """
    reading, noise, count = still_moments(moves.gyro, moves.core_start, moves.core_stop)
    rest = _at_rest(reading)
    stills, each = len(reading), np.arange(len(moves.first))
    to_move = np.zeros((len(each), stills))
    to_move[each, moves.before], to_move[each, moves.after] = 0.5, 0.5
    mean, variance = np.zeros(3), np.zeros(3)
    drift, drift_covariance = np.zeros((len(each), 3)), np.zeros((3, len(each), len(each)))
    for axis in range(3):
        stated = np.maximum(noise[axis] / count, 1e-30)
        walk, jitter = _walk_and_jitter(reading[rest, axis], stated[rest])
        weight = rest / (stated + jitter)
        if walk == 0.0:
            variance[axis] = 1.0 / weight.sum()
            mean[axis] = variance[axis] * (reading[:, axis] * weight).sum()
            continue
        step = np.diff(np.eye(stills), axis=0)
        posterior = np.linalg.inv(step.T @ step / walk + np.diag(weight))
        offset = posterior @ (reading[:, axis] * weight)
        away = to_move - 1.0 / stills
        mean[axis], variance[axis] = offset.mean(), posterior.mean()
        drift[:, axis] = away @ offset
        drift_covariance[axis] = away @ posterior @ away.T + walk / 12.0 * np.eye(len(each))
    return OffsetPrior(mean=mean, variance=variance, drift=drift, drift_covariance=drift_covariance, noise=noise)


def _at_rest(reading: FloatArray) -> BoolArray:
    """Tell the stills whose mean rate is like the others' from those that turn, shape (K,)."""
    away = np.abs(reading - np.median(reading, axis=0))
    alike: BoolArray = np.all(away <= 8.0 * np.maximum(np.median(away, axis=0), 1e-12), axis=1)
    return alike


def _walk_and_jitter(reading: FloatArray, stated: FloatArray) -> tuple[float, float]:
    """Return q and the variance of the jitter."""
    count = len(reading)
    freedom = count - 1
    jitter = 0.0
    mean = float(np.mean(reading))
    for _ in range(4):
        jitter = excess_variance(reading - mean, stated, freedom)
        weight = 1.0 / (stated + jitter)
        mean = float((weight * reading).sum() / weight.sum())
    first = float(np.mean(np.diff(reading) ** 2)) if count > 1 else 0.0
    ratio = first / max(float(np.mean((reading - reading.mean()) ** 2)), 1e-300)
    if jitter == 0.0 or count < 6 or ratio > 2.0 - 2.0 * 2.0 / np.sqrt(count):  # white: 2 with deviation 2 / sqrt(K)
        return 0.0, jitter
    lag = min(5, count // 2)
    walk = max((float(np.mean((reading[lag:] - reading[:-lag]) ** 2)) - first) / (lag - 1), 0.0)
    return walk, max(0.5 * (first - walk) - float(np.median(stated)), 0.0)


def rough_matrix(moves: Moves, accel: TriadModel, offset: FloatArray) -> FloatArray:
    """Return a first gyroscope matrix from the slow change of the gravity direction.

    dn/dt = n x w with w = M (u - o), over blocks of 0.2 s while the device is moved: linear in M. The hand's own
    accelerations make it rough, some per cent.

    Parameters
    ----------
    moves : Moves
        Moves and readings.
    accel : TriadModel
        Raw to m/s2.
    offset : array, shape (3,)
        Gyroscope offset, raw unit.

    Returns
    -------
    array, shape (3, 3)
        rad/s per raw unit; singular where the moves do not show it.
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
    """Return the mean of each still, the variance of one sample pooled over all, and the counts.

    Parameters
    ----------
    values : array, shape (N, 3)
        Readings, gaps left out.
    start, stop : array, shape (K,)
        Samples [start, stop).

    Returns
    -------
    mean : array, shape (K, 3)
        Unit of the readings.
    variance : array, shape (3,)
        Unit squared.
    count : array, shape (K,)
        Samples without gaps.
    """
    mean, square, count = np.zeros((len(start), 3)), np.zeros(3), np.zeros(len(start), np.int64)
    for k, (low, high) in enumerate(zip(start, stop, strict=True)):
        piece = values[low:high]
        piece = piece[np.isfinite(piece).all(axis=1)]
        mean[k], count[k] = piece.mean(axis=0), len(piece)
        square += ((piece - mean[k]) ** 2).sum(axis=0)
    return mean, square / max(1, int(count.sum()) - len(start)), count


def cross_matrix(n: FloatArray) -> FloatArray:
    """Return the matrices of the cross product.

    Parameters
    ----------
    n : array, shape (K, 3)
        Vectors.

    Returns
    -------
    array, shape (K, 3, 3)
        [n]x with [n]x w = n x w.
    """
    matrix = np.zeros((len(n), 3, 3))
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -n[:, 2], n[:, 1], -n[:, 0]
    matrix[:, 1, 0], matrix[:, 2, 0], matrix[:, 2, 1] = n[:, 2], -n[:, 1], n[:, 0]
    return matrix
