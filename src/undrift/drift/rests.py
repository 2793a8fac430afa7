"""Offset readings at rest, gathered into temperature cells, with what rests and sessions of one temperature do not agree on.

Readings::

    gyroscopes       y = u - K (G a + Earth rate)      K = M^-1, a = M_a (u_a - o_a): g-sensitivity is no offset
    accelerometers   y = u, of the one pose that has seen the widest range of temperature, and of one mounting if it has seen most

Of the Earth rate only the part along the vertical is known without a heading, 7.29e-5 rad/s * sin(latitude); the rest,
cos(latitude) in an unknown direction, goes into the uncertainty.

Cells: a warm-up spends most of its blocks at the hot end, and every degree counts alike. Blocks of one session and one direction of
sweep within a narrow range of temperature make one cell: mean, and variance of that mean by the noise inside the blocks. Bias
instability does not average out inside a cell. Its correlation over time is that of flicker noise, a sum of first-order processes
of equal variance with time constants tau_j half a decade apart::

    rho(t) = mean over j of exp(-t / tau_j)        C = mean of rho over the pairs of blocks of two cells, 0 across sessions

Visits: a cell that the device left by 2 degC and came back to is two. Cells that follow each other without a step of temperature
are one leg, a soak or a ramp; a log through five soaks or more counts by its soaks, and the ramps between are left out. What one
leg adds and the next does not (stress, moisture, what the law of the instability lacks over hours) does not average out with its
rows: it has the variance s_v2, found by restricted likelihood over all legs (fit/smooth.py). The instability s2 C is known beside
it; s2 of each axis is drawn towards their mean as far as it is uncertain. One leg alone, a ramp, shows no s_v2; then s2 is found by
restricted likelihood, and what it makes in one visit stands for s_v2.

The size s2 of the instability comes from second differences of neighbouring blocks where the temperature is smooth: a ramp moves
none of them::

    mean (y_(k+1) - 2 y_k + y_(k-1))^2 = 6 v + s2 (6 - 8 rho(h) + 2 rho(2 h))

Where too few blocks follow each other, s2 comes from pairs of blocks of one rest, else of one cell and pose, the usual slope
subtracted: mean (y_j - y_i)^2 = 2 v + 2 s2 (1 - rho(t)).

Rests: blocks of one cell and one pose that follow each other. Their means, the usual slope within a cell subtracted, are ::

    y_r = m_cell + P_pose + E_r + noise and instability          var P = p2, var E = r2

p2 and r2 make the squares of the pose effects, and of what is left, equal their expectation; below zero counts as zero. P averages
out over poses alone and E over rests alone, so that the covariance of two cells gets ::

    p2 k_P sum over poses of s_cell s_cell'          and each cell  r2 k_E sum over its rests of s^2        s the share of blocks

Sessions: y = f(T) + d_s + e, d_s the shift of session s with variance tau2. The shifts are fitted with no prior, their sum zero,
among sessions that share temperatures within 1 degC. tau2 makes their weighted scatter equal its expectation (Paule and Mandel,
fit/least_squares.py), but is no less than the variance of the shifts: sessions that agree by chance do not prove that nothing
moves. Each node gets tau2 k: a session to come has a shift of its own.

Few poses, rests or sessions know a variance badly: k = (t / z)^2 with the 97.5 % points of Student's distribution for that many
degrees of freedom and of the normal; p2 and r2 are drawn towards the mean of the three axes, with weight 2.

"""

from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.checks import check_gravity
from undrift.drift.observe import FAR, ROBUST, RestBlocks
from undrift.errors import Implausible, InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.least_squares import excess_variance
from undrift.fit.smooth import Scatter, fit_smooth, widening_of
from undrift.model import G_NAMES, Calibration
from undrift.units import EARTH_RATE, RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

UNKNOWN_SCALE_PER_K = 2e-4  # of an accelerometer that was seen in one pose: a capacitive one shifts by +-1 % in 50 K
_TIME_CONSTANTS_S = 10.0 ** np.arange(1.0, 4.1, 0.5)
_MOST_PAIRED = 30  # blocks of a cell that its correlation is taken from
_LEAST_TRIPLES = 8
_LEAST_PAIRS = 4
_LEAST_JUDGED = 5  # blocks of a cell and pose: fewer do not show which one is wrong
_SMOOTH_C = 0.5  # second difference of the temperature: above, a new set-point lies between blocks
_STEP_PER_ERROR = 12.0**0.5  # step of a converter over the error that it leaves without noise
_LEAST_WIDTH_C = 0.5  # narrowest cell
_MOST_CELLS = 100  # cells are widened until there are about as many; the fit takes the cube of their number
_LEFT_C = 2.0  # a cell that was left by this much and come back to is two visits; a step by as much begins another leg
_HELD_C = 0.5  # a soak stays within this of its mean
_LONG, _LEAST_SOAKS = 3.0, 5  # times as long as a stretch of a ramp; temperatures from which a log is one of soaks
_MOST_GROUPS = 20  # groups of neighbouring cells that are left out in turn
_APART_S = 60.0  # in one cell and pose: a later block belongs to another rest
_MOST_OF_IT = 0.8  # of a pose's range, that one mounting has seen: the others are left out [assumed]
_NONE = 1e-6  # singular value of shares: poses that no cell compares
_ALIKE = 2.0  # degrees of freedom by which the axes of a triad are taken to be alike
_SHARED_C = 1.0  # cells of two sessions nearer than this share a temperature


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offsets:
    """Offset readings of one triad, n blocks."""

    blocks: RestBlocks
    value: FloatArray  # (n, 3), raw unit
    variance: FloatArray  # (n, 3), of its noise, raw unit squared
    step_error: FloatArray | None  # (n, 3), what the converter's steps leave in each, raw unit
    common_variance: FloatArray  # (3,), of what all of them have in common, raw unit squared
    findings: tuple[Finding, ...] = ()  # what is in them that is no offset


def gyro_offsets(blocks: RestBlocks, calibration: Calibration | None, latitude_deg: float | None) -> Offsets | None:
    """Return the gyroscopes' readings at rest, without g-sensitivity and Earth rate."""
    blocks = blocks.taken(np.isfinite(blocks.gyro).all(axis=1))
    if not len(blocks):
        return None
    model = None if calibration is None else calibration.gyro
    force = specific_force(blocks, calibration)
    value, common, findings = np.array(blocks.gyro), np.zeros(3), list[Finding]()
    if latitude_deg is not None and (model is None or force is None):
        raise InputError(
            "Earth rate: wanted a calibration of both triads, got one of fewer; calibrate them, or give no latitude"
        )
    if model is not None and model.g_sensitivity is not None and force is not None:
        value -= felt_by_gyro(blocks, calibration)
        if G_NAMES[0] in model.parameters:  # the g-sensitivity's own uncertainty, at the mean specific force
            start, k, mean = model.parameters.index(G_NAMES[0]), model.forward_matrix, force.mean(axis=0)
            own = model.covariance[start : start + len(G_NAMES), start : start + len(G_NAMES)].reshape(3, 3, 3, 3)
            common += np.einsum("ka,kb,i,j,aibj->k", k, k, mean, mean, own)
    else:
        findings.append(finding("drift.g_unknown", "info"))
    if latitude_deg is not None and model is not None and force is not None:
        up = force / np.linalg.norm(force, axis=1, keepdims=True)
        latitude = latitude_deg * RADIAN_PER_DEGREE
        value -= EARTH_RATE * np.sin(latitude) * up @ model.forward_matrix.T
        common += (EARTH_RATE * np.cos(latitude)) ** 2 / 2.0 * (model.forward_matrix**2).sum(axis=1)
    return Offsets(
        blocks=blocks,
        value=value,
        variance=known_variance(blocks.gyro_variance),
        step_error=blocks.gyro_step_error,
        common_variance=common,
        findings=tuple(findings),
    )


def accel_offsets(blocks: RestBlocks, calibration: Calibration | None, accel_unit: str) -> Offsets | Finding:
    """Return the accelerometers' readings in the pose with the widest range of temperature, of one mounting that saw most of it."""
    blocks = blocks.taken(np.isfinite(blocks.accel).all(axis=1))
    if not len(blocks):
        return finding("drift.accel_no_readings", "info")
    poses, spans = _spans(blocks.temp_c, blocks.pose)
    force = specific_force(blocks, calibration)
    if force is None and is_physical(accel_unit):
        force = blocks.accel * si_factor(accel_unit, "accel")
    if force is not None:
        try:
            check_gravity(force, STANDARD_GRAVITY if calibration is None else calibration.gravity_m_s2)
        except Implausible as error:
            return finding("drift.accel_gravity", "warn", problem=str(error))
    chosen = blocks.taken(blocks.pose == poses[int(np.argmax(spans))])
    percent, span = 100.0 * UNKNOWN_SCALE_PER_K, max(spans)
    if chosen.mounting is not None:  # mounted anew it is not as level as before: tilt would count as temperature
        mountings, seen = _spans(chosen.temp_c, chosen.mounting)
        if max(seen) >= _MOST_OF_IT * span:
            chosen, span = chosen.taken(chosen.mounting == mountings[int(np.argmax(seen))]), max(seen)
    return Offsets(
        blocks=chosen,
        value=np.array(chosen.accel),
        variance=known_variance(chosen.accel_variance),
        step_error=chosen.accel_step_error,
        common_variance=np.zeros(3),
        findings=(finding("drift.accel_one_pose", "info", poses=len(poses), span_c=span, percent_per_c=percent),),
    )


def _spans(temp_c: FloatArray, number: IntArray) -> tuple[IntArray, list[float]]:
    """Return the numbers there are, and the range of temperature of each, degC."""
    each = np.unique(number)
    return each, [float(np.ptp(temp_c[number == one])) for one in each]


def known_variance(variance: FloatArray) -> FloatArray:
    """Return variances, (n, 3), with the usual one where none is known."""
    usual = np.nanmean(variance, axis=0) if np.isfinite(variance).any() else np.zeros(3)
    return np.where(np.isfinite(variance), variance, usual)


def specific_force(blocks: RestBlocks, calibration: Calibration | None) -> FloatArray | None:
    """Return the corrected specific force of blocks, (n, 3), m/s2."""
    model = None if calibration is None else calibration.accel
    if model is None or not np.isfinite(blocks.accel).all():
        return None
    return np.asarray((blocks.accel - model.offset) @ model.matrix.T)


def felt_by_gyro(blocks: RestBlocks, calibration: Calibration | None) -> FloatArray:
    """Return what specific force adds to the gyroscopes' readings of blocks, (n, 3), raw unit; 0 where that is not known."""
    model, force = None if calibration is None else calibration.gyro, specific_force(blocks, calibration)
    if model is None or model.g_sensitivity is None or force is None:
        return np.zeros((len(blocks), 3))
    return np.asarray(force @ (model.forward_matrix @ model.g_sensitivity).T)


# ---- temperature cells


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestScatter:
    """How rests of one set-point disagree, n cells, N rests."""

    pose: FloatArray  # (3,), standard deviation from pose to pose, the same at every temperature, raw unit
    rest: FloatArray  # (3,), from rest to rest, beyond noise and instability, raw unit
    known: FloatArray  # (3,), uncertainty of one rest by noise and instability, raw unit
    shared: FloatArray  # (3, n, n), covariance that poses give the cells, raw unit squared
    own: FloatArray  # (n, 3), variance that rests give each cell, raw unit squared
    rests: list[IntArray]  # blocks of each
    in_pose: FloatArray  # (N, poses), one where a rest lay in a pose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Cells of one triad, n rows."""

    session: IntArray  # (n,), which session
    temp_c: FloatArray  # (n,), mean temperature, degC
    value: FloatArray  # (n, 3), mean, raw unit
    variance: FloatArray  # (n, 3), of it, from the noise inside the blocks, raw unit squared
    regressors: FloatArray  # (n, p), means of what was given for each block
    visits: FloatArray  # (n, n), correlation of what legs add; 1 within one
    instability: FloatArray  # (3, n, n), covariance by the bias instability where it is significant, raw unit squared
    groups: IntArray  # (n,), neighbours in temperature
    # (3,), standard deviation that bias instability gives a leg, raw unit; 0 where too few blocks follow each other or share a cell
    # and a pose
    expected: FloatArray
    between: RestScatter | None = None  # part of variance; None where no cell has two rests


def gather(
    blocks: RestBlocks,
    value: FloatArray,
    variance: FloatArray,
    *,
    direction: FloatArray,
    regressors: FloatArray,
    step_error: FloatArray | None = None,
    chunk_s: float = np.inf,
) -> Cells:
    """Gather blocks into temperature cells; value, variance, step_error (n, 3), direction (n,), regressors (n, p).

    Cells are cut where the time since power-on passes chunk_s, twice this, four times, ...
    """
    chunk = np.floor(np.log2(np.maximum(blocks.power_on_s / chunk_s, 0.5)))
    labels = np.column_stack((blocks.session, np.round(direction), chunk)).astype(np.int64)
    key = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)
    leg = _legs(blocks)
    parts = [np.flatnonzero((key == k) & (leg >= 0)) for k in np.unique(key[leg >= 0])]
    width = max(_LEAST_WIDTH_C, sum(float(np.ptp(blocks.temp_c[rows])) for rows in parts) / _MOST_CELLS)
    members = _visits(blocks, parts, width)
    if len(members) > 1.5 * _MOST_CELLS:
        width *= len(members) / _MOST_CELLS
        members = _visits(blocks, parts, width)
    members = [rows[_good(value[rows], blocks.pose[rows])] for rows in members]
    temp_c = np.array([blocks.temp_c[rows].mean() for rows in members])
    order = np.argsort(temp_c, kind="stable")
    groups = np.empty(len(members), np.int64)
    groups[order] = bins_of(temp_c[order], max(1.5 * width, float(np.ptp(temp_c)) / _MOST_GROUPS))
    variances = np.array(
        [
            variance_of_mean(value[rows], variance[rows], None if step_error is None else step_error[rows])
            for rows in members
        ]
    )
    middle = np.array([value[rows].mean(axis=0) for rows in members])
    x = temp_c - temp_c.mean()  # the usual slope within a cell is subtracted; 0 for one temperature
    level = value - np.asarray(x @ middle / max(float(x @ x), 1e-9)) * blocks.temp_c[:, None]
    rests, labels = _rests_of(blocks, members)
    seen = instability_of(blocks, value, variance)
    instability = _from_pairs(blocks, rests, labels, level, variance) if seen is None else np.maximum(*seen)
    leg = leg[[rows[0] for rows in members]]
    visits = (leg[:, None] == leg).astype(float)
    within = _correlation(blocks, members)
    usual = float(np.mean(np.diag(within)))
    if visits.all():  # what one leg adds is a constant: the size of the instability within it is found instead
        visits, within = within / usual, np.zeros_like(within)
    size = np.zeros(3) if seen is None else _drawn_together(*seen)
    between = _rest_scatter(blocks, rests, labels, level, variance, instability)
    return Cells(
        session=np.array([blocks.session[rows[0]] for rows in members], np.int64),
        temp_c=temp_c,
        value=middle,
        variance=variances if between is None else variances + between.own,
        regressors=np.array([regressors[rows].mean(axis=0) for rows in members]),
        visits=visits,
        instability=size[:, None, None] * within,
        groups=groups,
        expected=np.sqrt((np.zeros(3) if instability is None else instability) * usual),
        between=between,
    )


def bins_of(temp_c: FloatArray, width: float) -> IntArray:
    """Return numbers of bins, (n,): each begins at a value and holds what lies within a width above it."""
    bins = np.zeros(len(temp_c), np.int64)
    begin = temp_c[0]
    for k in range(1, len(temp_c)):
        new = temp_c[k] - begin > width
        begin = temp_c[k] if new else begin
        bins[k] = bins[k - 1] + new
    return bins


def _visits(blocks: RestBlocks, parts: list[IntArray], width: float) -> list[IntArray]:
    """Return the blocks of each visit to each bin of each part, in the order of temperature."""
    order = np.lexsort((blocks.time, blocks.session))
    place, temp_c = np.argsort(order), blocks.temp_c[order]
    visits: list[IntArray] = []
    for rows in parts:
        rows = rows[np.argsort(blocks.temp_c[rows], kind="stable")]
        for inside in np.split(rows, np.flatnonzero(np.diff(bins_of(blocks.temp_c[rows], width))) + 1):
            inside = inside[np.argsort(place[inside])]
            away = np.cumsum(np.abs(temp_c - blocks.temp_c[inside].mean()) > _LEFT_C + width)[place[inside]]
            visits += np.split(inside, np.flatnonzero(np.diff(away)) + 1)
    return visits


def _legs(blocks: RestBlocks) -> IntArray:
    """Return which leg each block belongs to, (n,); -1 for ramps between the soaks of a log that has many."""
    order = np.lexsort((blocks.time, blocks.session))
    step = (np.abs(np.diff(blocks.temp_c[order])) > _LEFT_C) | (np.diff(blocks.session[order]) != 0)
    number, count = np.empty(len(blocks), np.int64), 0
    for rows in np.split(order, np.flatnonzero(step) + 1):
        own = _soaks_of(blocks.time[rows], blocks.temp_c[rows])
        number[rows] = np.where(own < 0, -1, own + count)
        count += int(own.max()) + 1
    return number


def _soaks_of(time: FloatArray, temp_c: FloatArray) -> IntArray:
    """Return which soak each block of one log belongs to, (n,) in order of time, -1 between two; all 0 where they are few.

    A soak stays near its mean for three times as long as usual stretches do.
    """
    ends, total = [0], 0.0
    for k, temp in enumerate(temp_c.tolist()):
        if k > ends[-1] and abs(temp - total / (k - ends[-1])) > _HELD_C:
            ends.append(k)
            total = 0.0
        total += temp
    stretch = np.repeat(np.arange(len(ends)), np.diff([*ends, len(time)]))
    length = np.bincount(stretch, np.gradient(time)) if len(time) > 1 else np.zeros(1)
    middle = np.array([np.median(part) for part in np.split(temp_c, ends[1:])])
    held = length >= _LONG * np.quantile(length, 0.25)
    if np.count_nonzero(np.diff(np.sort(middle[held])) > _LEFT_C) < _LEAST_SOAKS - 1:
        return np.zeros(len(time), np.int64)
    new = held & ~np.append(False, held[:-1] & (np.abs(np.diff(middle)) <= _LEFT_C))
    soak = np.where(held, np.cumsum(new) - 1, -1)[stretch]
    return np.where(np.abs(temp_c - middle[stretch]) <= 0.5 * _HELD_C, soak, -1)


def instability_of(blocks: RestBlocks, value: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return s2, (3,), as flicker noise from block to block has it, and its uncertainty; None where too few follow each other."""
    step = np.diff(blocks.time)
    usual = float(np.median(step)) if len(step) else 0.0
    follows = (np.abs(step - usual) < 0.2 * usual) & (np.diff(blocks.session) == 0) & (np.diff(blocks.pose) == 0)
    follows &= np.abs(np.diff(blocks.temp_c)) < _LEFT_C  # soaks of one row each follow each other by steps
    smooth = np.abs(np.diff(blocks.temp_c, 2)) < _SMOOTH_C if len(blocks) > 2 else np.zeros(0, bool)
    middle = np.flatnonzero(follows[1:] & follows[:-1] & smooth) + 1
    if len(middle) < _LEAST_TRIPLES:
        return None
    second = (value[middle + 1] - 2.0 * value[middle] + value[middle - 1]) ** 2
    typical = np.median(second, axis=0) / 0.455  # median of chi-square with one degree of freedom
    second = np.minimum(second, FAR**2 * typical)
    noise = 6.0 * variance[middle].mean(axis=0)
    error = noise * np.sqrt(4.0 / len(middle))  # neighbouring differences share blocks
    share = 6.0 - 8.0 * _rho(np.array(usual)) + 2.0 * _rho(np.array(2.0 * usual))
    return (second.mean(axis=0) - noise) / share, error / share


def _drawn_together(size: FloatArray, uncertainty: FloatArray) -> FloatArray:
    """Return s2, (3,), drawn towards the mean of the axes as far as it is uncertain: they are alike by about their own size."""
    mean = max(float(size.mean()), 1e-30)
    return np.asarray(np.maximum(mean + (size - mean) / (1.0 + (uncertainty / mean) ** 2), 0.0))


def _from_pairs(
    blocks: RestBlocks, rests: list[IntArray], labels: IntArray, level: FloatArray, variance: FloatArray
) -> FloatArray | None:
    """Return s2 from neighbouring blocks of one cell and pose."""
    rows, rest = np.concatenate(rests), np.repeat(np.arange(len(rests)), [len(rows) for rows in rests])
    pairs = np.flatnonzero(np.diff(rest) == 0)
    if len(pairs) < _LEAST_PAIRS:  # then what differs from rest to rest counts as instability
        pairs = np.flatnonzero((np.diff(labels[rest], axis=0) == 0).all(axis=1))
    if len(pairs) < _LEAST_PAIRS:
        return None
    one, two = rows[pairs], rows[pairs + 1]
    noise = (variance[one] + variance[two]).mean(axis=0)
    square = ((level[two] - level[one]) ** 2).mean(axis=0) - noise
    share = 2.0 * float(np.mean(1.0 - _rho(np.abs(blocks.time[two] - blocks.time[one]))))
    return np.asarray(np.maximum(square, noise * np.sqrt(2.0 / len(one))) / share)


def variance_of_mean(value: FloatArray, variance: FloatArray, step_error: FloatArray | None) -> FloatArray:
    """Return the variance of a mean over blocks, (3,), by their noise and by what a converter's steps leave."""
    noise: FloatArray = variance.mean(axis=0) / len(value)
    if step_error is None:
        return noise
    left = np.nanmean(step_error, axis=0)
    crossed = np.ptp(value, axis=0) / np.maximum(_STEP_PER_ERROR * left, 1e-300)
    return np.asarray(noise + left**2 / (1.0 + np.where(left > 0.0, crossed, 0.0)))


def _rho(lag_s: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-np.asarray(lag_s)[..., None] / _TIME_CONSTANTS_S).mean(axis=-1))


def _good(value: FloatArray, pose: IntArray) -> BoolArray:
    """Tell which blocks of a cell are near the others of their pose: a whole pose that differs is no outlier."""
    good = np.ones(len(value), bool)
    for number in np.unique(pose):
        own = np.flatnonzero(pose == number)
        off = np.abs(value[own] - np.median(value[own], axis=0))
        near = (off <= FAR * ROBUST * np.median(off, axis=0)).all(axis=1)
        if len(own) >= _LEAST_JUDGED and near.mean() > 0.5:
            good[own] = near
    return good


def _correlation(blocks: RestBlocks, members: list[IntArray]) -> FloatArray:
    sampled = [rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST_PAIRED)).astype(int)] for rows in members]
    ends = np.concatenate(([0], np.cumsum([len(rows) for rows in sampled])))
    time = blocks.time[np.concatenate(sampled)]
    session = np.array([blocks.session[rows[0]] for rows in members])
    correlation = np.zeros((len(members), len(members)))
    for k in range(len(members)):
        pairs = _rho(np.abs(time[ends[k] : ends[k + 1], None] - time[None, :])).mean(axis=0)
        correlation[k] = np.add.reduceat(pairs, ends[:-1]) / np.diff(ends)
    correlation[session[:, None] != session[None, :]] = 0.0
    return 0.5 * (correlation + correlation.T)


# ---- rests of one set-point that disagree


def _rests_of(blocks: RestBlocks, cells: list[IntArray]) -> tuple[list[IntArray], IntArray]:
    """Return the rests that cells are made of, and cell and pose of each, (N, 2)."""
    rests, labels = list[IntArray](), list[tuple[int, int]]()
    for k, members in enumerate(cells):
        for pose in np.unique(blocks.pose[members]):
            own = members[blocks.pose[members] == pose]
            own = own[np.argsort(blocks.time[own], kind="stable")]
            runs = np.split(own, np.flatnonzero(np.diff(blocks.time[own]) > _APART_S) + 1)
            rests += runs
            labels += [(k, pose)] * len(runs)
    return rests, np.array(labels)


def _rest_scatter(
    blocks: RestBlocks,
    rests: list[IntArray],
    labels: IntArray,
    level: FloatArray,
    variance: FloatArray,
    instability: FloatArray | None,
) -> RestScatter | None:
    """Find how rests of one set-point disagree beyond noise and instability."""
    count, mean = len(rests), np.array([level[rows].mean(axis=0) for rows in rests])
    covariance = np.array([variance[rows].mean(axis=0) / len(rows) for rows in rests]).T[:, :, None] * np.eye(count)
    if instability is not None:
        covariance = covariance + instability[:, None, None] * _correlation(blocks, rests)
    in_cell, in_pose = ((number[:, None] == np.unique(number)).astype(float) for number in labels.T)
    centred = np.eye(count) - in_cell @ (in_cell / in_cell.sum(axis=0)).T
    poses = centred @ in_pose
    compared = int(np.linalg.matrix_rank(poses, tol=_NONE))
    inverse = np.linalg.pinv(poses, rcond=_NONE)
    freedom = count - in_cell.shape[1] - compared
    if compared + freedom < 1:
        return None
    rest: FloatArray = np.zeros(3)
    pose: FloatArray = np.zeros(3)
    if freedom > 0:
        left = centred - (poses @ inverse if compared else 0.0)
        rest = pooled(excess(left, float(freedom), mean, covariance), freedom)
    if compared > 0:
        taken = inverse @ centred
        with_rests = covariance + rest[:, None, None] * np.eye(count)
        pose = pooled(excess(taken, float(((taken @ in_pose) ** 2).sum()), mean, with_rests), compared)
    share = np.array([len(rows) for rows in rests], float)[:, None] * in_cell
    share /= share.sum(axis=0)
    by_pose = share.T @ in_pose
    return RestScatter(
        pose=np.sqrt(pose),
        rest=np.sqrt(rest),
        known=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2).mean(axis=1)),
        shared=(pose * widening_of(compared + _ALIKE))[:, None, None] * (by_pose @ by_pose.T),
        own=(share**2).sum(axis=0)[:, None] * rest * widening_of(freedom + _ALIKE),
        rests=rests,
        in_pose=in_pose,
    )


def excess(taken: FloatArray, size: float, mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the variance of an effect, (3,): squares of combinations of the means, less what their covariance explains.
    taken (q, N), size the sum of squares of the effect's coefficients, mean (N, 3), covariance (3, N, N)."""
    square = ((taken @ mean) ** 2).sum(axis=0)
    expected = np.einsum("ij,kjl,il->k", taken, covariance, taken)
    return np.asarray(np.maximum(square - expected, 0.0) / size)


def pooled(variance: FloatArray, freedom: int) -> FloatArray:
    """Return variances of the three axes, (3,), drawn towards their mean: sensors of one triad are alike."""
    return np.asarray((freedom * variance + _ALIKE * variance.mean()) / (freedom + _ALIKE))


# ---- sessions of one device: how much the offset moves from one switch-on to the next


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnOn:
    """Scatter between sessions."""

    sessions: int
    # (s, 3), of each session against the mean of those that share its temperatures, raw unit; NaN where none does
    shift: FloatArray
    # (3,), tau2, or the variance of the shifts where that is more, raw unit squared; NaN where not observable
    variance: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    # (3,), added to a node's variance for a session to come, raw unit squared; 0 where not observable
    variance_to_come: FloatArray = field(default_factory=lambda: np.zeros(3))
    # (3,), whether ``variance`` is only that of the shifts
    bounded: BoolArray = field(default_factory=lambda: np.zeros(3, bool))


def between_sessions(cells: Cells) -> TurnOn:
    """Find how much the offset moves between sessions."""
    numbers = np.unique(cells.session)
    shifts = _shifts(cells, numbers)
    free = shifts.shape[1]
    unknown = TurnOn(sessions=len(numbers), shift=np.full((len(numbers), 3), np.nan))
    if free == 0:
        return unknown
    try:
        fit = fit_smooth(
            cells.temp_c,
            cells.value,
            cells.variance,
            regressors=np.column_stack(((cells.session[:, None] == numbers) @ shifts, cells.regressors)),
            groups=cells.groups,
            scatter=Scatter(correlation=cells.visits, expected=cells.expected, shared=cells.instability),
        )
    except NotObservable:
        return unknown
    part = np.abs(shifts)
    seen = np.asarray(part.any(axis=1))
    shift = np.where(seen[:, None], shifts @ fit.coefficient[:free], np.nan)
    own = part[seen] @ fit.coefficient_uncertainty[:free] ** 2 / part[seen].sum(axis=1, keepdims=True)
    excess = np.array([excess_variance(shift[seen, axis], own[:, axis], free) for axis in range(3)])
    within = own.mean(axis=0)
    variance = np.maximum(excess, within)
    return TurnOn(
        sessions=len(numbers),
        shift=shift,
        variance=variance,
        variance_to_come=widening_of(free) * variance,
        bounded=excess < within,
    )


def _shifts(cells: Cells, numbers: IntArray) -> FloatArray:
    """Return what makes the shifts of s sessions, (s, free), of those of all but the last in each group, so that each sums to zero.

    A group is tied together by shared temperatures, one session to the next; one that shares none has a row of zeros.
    """
    from scipy.linalg import block_diag
    from scipy.sparse.csgraph import connected_components

    temps = [cells.temp_c[cells.session == number] for number in numbers]
    tied = [[np.abs(one[:, None] - two).min() <= _SHARED_C for two in temps] for one in temps]
    count, group = connected_components(np.array(tied))
    sizes = np.bincount(group, minlength=count)
    shifts = np.zeros((len(numbers), len(numbers) - count))
    shifts[np.argsort(group, kind="stable")] = block_diag(*(np.vstack((np.eye(n - 1), -np.ones(n - 1))) for n in sizes))
    return shifts
