"""Accelerometers in use: rests of daily recordings update offset and scale, as the length of gravity shows them.

The calibration before makes v = M(T) (u - o(T)) of a reading. In a rest of a recording, D kelvin from the reference temperature::

    |(1 + E + diag(c) D) (v - d - k D - q v^2 - s)| = g + e

    E, d   symmetric errors of scale and across axes, error of the offset: prior the calibration's covariance, or a data sheet's
    k, c   slopes of offset and scale, per K; q quadratic terms: priors of data sheets, always there (calibration/norm.py)
    s      shift of the switch-on, variance t2; d and the scale age by a Wiener process from the date of the calibration
    e      noise of the mean length, codes, what a body's change of speed leaves, and r2: creep, strain, bias instability

A common rotation changes no length: the axes stay those of the calibration, and as uncertain. A Kalman filter over the recordings,
linear about the last solution, gives the likelihood of t, ageing and r on a grid; times a stated prior (log-normal) it weighs the
points. Each point leaves out a rest that a contaminated normal distribution takes for an outlier. Nothing is changed where rests
point less than six ways, where a combination of scale and offset keeps more than half of its variance, or where rests left out, a
direction at a time, are not met better than before, by two standard errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from undrift.arrays import BoolArray, FloatArray, IntArray, interpolated
from undrift.calibration.adc import code_steps, code_variance
from undrift.calibration.norm import MG, PART, QUADRATIC_SD
from undrift.drift.static import near_data
from undrift.findings import Finding, finding
from undrift.model import AXES, Calibration, RestForces, TriadModel
from undrift.record import Session, Still, TemperatureSensitivity
from undrift.units import si_factor

_E, _D, _K, _C, _S = slice(0, 6), slice(6, 9), slice(9, 12), slice(12, 15), slice(18, 21)  # between: q
_ROW, _COLUMN = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])  # of E
_LEVEL = np.array([0, 1, 2, 6, 7, 8])  # scale and offset: all of these must be shown
_NAMES = tuple(f"{what} {axis}" for what in ("scale", "offset") for axis in AXES)
_UNKNOWN = np.array([0.03] * 3 + [0.01] * 3 + [60.0 * MG] * 3)  # MPU-6050: +-3 %, +-2 % across, +-50 and 80 mg
_APART, _DIRECTIONS = np.cos(np.radians(30.0)), 6  # nearer ones count as one
_KEPT = 0.5  # of the variance before: a combination that keeps more is not shown
_OUTLIER, _OUTLIER_SD = 0.01, 0.5  # share and standard deviation of rests that are none, m/s2
_SPEED = 0.02  # change of a quiet body's speed from end to end of a rest, standard deviation, m/s [assumed]
# s of a mean; temperature span of a part of a rest, K; a node further from rests than this is extrapolated, K
_BLOCK_S, _PART_C, _GAP_C = 1.0, 2.0, 5.0
_SURE = 2.0  # standard errors by which rests left out must be met better
_MONTH, _ROUNDS = 30.0, 4
# Medians of t, of ageing in 30 days (ADXL355: 0.3 mg, consumer parts more) and of r, m/s2 [assumed], and one deviation about each
_SIZES, _FACTOR = np.full((3, 1), 0.5 * MG), 2.5
_SCALE_AGES = 0.4  # of the scale at 1 g, in units of the offset's; ADXL355 states 0.14 % beside 3.5 mg
_TABLE = 0.2  # part of the data sheet's slopes that a table over temperature leaves [assumed]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelUseFit:
    """What the rests of daily recordings show of the accelerometers, along the axes of the calibration."""

    changed: bool  # False: the accelerometers stay as they were
    directions: int  # 30 degrees apart or more
    # (15,): E (1, xx yy zz xy xz yz), d (m/s2), k (m/s2 per K), c (1 per K) on the last date
    change: FloatArray
    covariance: FloatArray  # (15, 15), of the same, for a switch-on to come
    before: FloatArray  # (15,), standard uncertainty before, with the ageing since
    held_out: FloatArray  # (2,), rms of length less gravity in rests left out, before and after, m/s2
    reference_c: float  # where D is 0, degC
    temp_c: FloatArray  # (m,), of parts of rests, degC
    findings: tuple[Finding, ...]


def accel_before(calibration: Calibration) -> TriadModel | None:
    """Return the accelerometers' model without what was learnt in use."""
    learnt = None if calibration.drift is None else calibration.drift.learnt
    return calibration.accel if learnt is None or learnt.accel is None else learnt.accel.model


def rest_forces(
    session: Session, stills: Sequence[Still], worn: BoolArray, course: Sequence[FloatArray], base: Calibration
) -> RestForces | None:
    """Return mean direction times mean length of the specific force in parts of rests, by the calibration before."""
    model, triad, forces = base.accel, base.triad("accel"), list[tuple[FloatArray, float, float]]()
    if model is None or any(record.accel is None for record in session.records):
        return None
    step, unit = code_steps(session.records, rate=False), si_factor(model.unit_out, "accel")
    for still, on_body in zip(stills, worn, strict=True):
        record, temps = session.records[still.recording], course[still.recording]
        accel = np.asarray(record.accel)
        inside = np.arange(still.start, still.stop)
        inside = inside[np.isfinite(accel[inside]).all(axis=1) & np.isfinite(temps[inside])]
        parts = max(1, int(np.ceil(np.ptp(temps[inside]) / _PART_C))) if len(inside) else 1
        for rows in np.array_split(inside, parts):
            count = int(np.ptp(record.time[rows]) / _BLOCK_S) if len(rows) else 0
            if count < 2:
                continue
            temp_c = float(temps[rows].mean())
            offset, matrix = (
                held if over is None else interpolated(temp_c, over.temp_c, over.value)
                for held, over in ((model.offset, triad.offsets), (model.matrix, triad.matrices))
            )
            force = (accel[rows] - offset) @ matrix.T * unit
            lengths = np.linalg.norm([block.mean(axis=0) for block in np.array_split(force, count)], axis=1)
            up = force.mean(axis=0) / np.linalg.norm(force.mean(axis=0))
            codes = (up @ matrix * unit) ** 2 @ code_variance(step, accel[rows].var(axis=0))
            speed = (_SPEED / count / _BLOCK_S) ** 2 if on_body else 0.0
            forces.append((up * lengths.mean(), float(lengths.var(ddof=1) / count + codes + speed), temp_c))
    if not forces:
        return None
    force, variance, at_c = (np.array(column) for column in zip(*forces, strict=True))
    return RestForces(force=force, variance=variance, temp_c=at_c, recording=np.zeros(len(at_c), np.int64), model=model)


def learn_accel(base: Calibration, rests: RestForces, days: FloatArray) -> AccelUseFit:
    """Fit the errors of a calibration's accelerometers to rests; days: of each recording since the calibration."""
    group = _directions(rests.force)
    middle_c = base.reference_temp_c if np.isfinite(base.reference_temp_c) else float(np.median(rests.temp_c))
    given = _Given(rests, rests.temp_c - middle_c, base.gravity_m_s2, days, _prior(base, rests.model))
    unit = np.array(np.meshgrid(*[[-2.0, 0.0, 2.0]] * 3)).reshape(3, -1)
    theta, centre, width, used = np.zeros(21), np.zeros((3, 1)), np.ones((3, 1)), np.ones(len(group), bool)
    for _ in range(_ROUNDS):
        z = centre + width * unit
        point = _SIZES * _FACTOR**z
        mean, spread, score, near = given.filtered(theta, point, used)
        weight = np.exp(score - 0.5 * (z**2).sum(axis=0) - (score - 0.5 * (z**2).sum(axis=0)).max())
        weight /= weight.sum()
        theta, centre = weight @ mean, (z @ weight)[:, None]
        width = np.maximum(np.sqrt((z - centre) ** 2 @ weight)[:, None], 0.25 * width)
        miss = given.gravity - _linearised(rests.force, given.warm, theta)[1]  # the first rests met a wide prior alone
        used = _at_rest(miss, rests.variance + (point**2 @ weight).sum())[0]
    used, off = used & (near @ weight >= 0.5), mean - theta
    covariance = np.einsum("g,gij->ij", weight, spread) + (weight * off.T) @ off
    likely = np.exp(np.log(point) @ weight)[:, None]
    aged = given.prior + given.ageing(likely)[0] * days[-1]
    errors = np.zeros((2, int(group.max()) + 1))
    for number in range(errors.shape[1]) if errors.shape[1] >= _DIRECTIONS else ():
        out = used & (group == number)
        without = given.filtered(theta, likely, used & ~out)[0][0]
        for k, at in enumerate((np.zeros(21), without) if out.any() else ()):
            length = _linearised(rests.force[out], given.warm[out], at)[1]
            errors[k, number] = np.mean((length - given.gravity) ** 2)
    changed, note = _judged(covariance, aged, errors, len(group))
    covariance[_D, _D] += np.eye(3) * likely[0] ** 2  # a switch-on to come
    return AccelUseFit(
        changed=changed,
        directions=errors.shape[1],
        change=theta[:15],
        covariance=covariance[:15, :15],
        before=np.sqrt(np.diag(aged)[:15]),
        held_out=np.sqrt(errors.mean(axis=1)),
        reference_c=middle_c,
        temp_c=rests.temp_c,
        findings=(note,),
    )


class _Given(NamedTuple):
    """Rests, their D (m,), gravity, days of the recordings, and the prior covariance (21, 21) of E, d, k, c, q, s."""

    rests: RestForces
    warm: FloatArray
    gravity: float
    days: FloatArray
    prior: FloatArray

    def ageing(self, point: FloatArray) -> FloatArray:
        """Return the variance that a day adds at points (3, G): t, ageing, r; (G, 21, 21)."""
        share = np.array([(_SCALE_AGES / self.gravity) ** 2] * 3 + [0.0] * 3 + [1.0] * 3 + [0.0] * 12)
        return np.asarray(point[1][:, None, None] ** 2 / _MONTH * np.diag(share))

    def filtered(self, theta: FloatArray, point: FloatArray, used: BoolArray) -> tuple[FloatArray, ...]:
        """Return mean (G, 21), covariance, logarithm of the likelihood (G,) and which rests count (m, G), linear about theta."""
        rests, count = self.rests, point.shape[1]
        design, length = _linearised(rests.force, self.warm, theta)
        y = self.gravity - length + design[:, : _S.start] @ theta[: _S.start]
        mean, spread, score = np.zeros((count, 21)), np.repeat(self.prior[None], count, axis=0), np.zeros(count)
        near, today, grown = np.ones((len(used), count)), 0.0, self.ageing(point)
        for number, day in enumerate(self.days.tolist()):
            spread += grown * (day - today)
            today = day
            mean[:, _S] = spread[:, _S, :] = spread[:, :, _S] = 0.0
            spread[:, range(18, 21), range(18, 21)] = point[0][:, None] ** 2
            for row in np.flatnonzero((rests.recording == number) & used):
                gain = spread @ design[row]
                total = gain @ design[row] + rests.variance[row] + point[2] ** 2
                error = y[row] - mean @ design[row]
                near[row], likelihood = _at_rest(error, total)
                score += likelihood
                weight = (near[row] / total)[:, None] * gain
                mean += weight * error[:, None]
                spread -= weight[:, :, None] * gain[:, None, :]
        return mean, spread, score, near


def _at_rest(error: FloatArray, total: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Return which errors of a variance belong to rests of this device, and the logarithm of the likelihood."""
    near = np.log(1.0 - _OUTLIER) - 0.5 * (np.log(total) + error**2 / total)
    other = np.log(_OUTLIER / _OUTLIER_SD) - 0.5 * (error / _OUTLIER_SD) ** 2
    return near > other, np.maximum(near, other)


def _prior(base: Calibration, model: TriadModel) -> FloatArray:
    """Return the covariance (21, 21): that of the calibration where it states one, else that of data sheets."""
    triad, usual, errors = base.triad("accel"), TemperatureSensitivity(), _errors_of(model)
    slopes = usual.accel_offset_mg_per_k * MG, usual.accel_scale_percent_per_k / 100.0
    tables = [1.0 if table is None else _TABLE for table in (triad.offsets, triad.matrices)]
    sd = [np.full(3, size) for size in (slopes[0] * tables[0], slopes[1] * tables[1], QUADRATIC_SD, 0.0)]
    prior = np.diag(np.concatenate((np.zeros(9), *sd)) ** 2)
    prior[:9, :9] = (errors @ np.nan_to_num(model.covariance[:12, :12]) @ errors.T)[:9, :9]
    prior[range(9), range(9)] += np.where(np.diag(prior)[:9] <= 0.0, _UNKNOWN**2, 0.0)
    if triad.offsets is not None and triad.offsets.uncertainty is not None:
        level = np.nanmedian(triad.offsets.uncertainty, axis=0) ** 2 @ errors[_D, 9:].T ** 2
        prior[_D, _D] += np.diag(level)
    return prior


def _linearised(force: FloatArray, warm: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return d length / d parameters (m, 21) and the length (m,), m/s2."""
    d, square = warm[:, None], force**2
    w = force - theta[_D] - theta[_K] * d - theta[15:18] * square
    gain = np.eye(3) + _symmetric(theta[_E]) + np.eye(3) * theta[_C] * d[:, :, None]
    a = np.einsum("mij,mj->mi", gain, w)
    length = np.linalg.norm(a, axis=1)
    n = a / length[:, None]
    by_scale, by_offset, i, j = n * w, -np.einsum("mi,mij->mj", n, gain), _ROW[3:], _COLUMN[3:]
    across = n[:, i] * w[:, j] + n[:, j] * w[:, i]
    return np.hstack((by_scale, across, by_offset, by_offset * d, by_scale * d, by_offset * square, by_offset)), length


def _symmetric(six: FloatArray) -> FloatArray:
    full = np.zeros((3, 3))
    full[_ROW, _COLUMN] = full[_COLUMN, _ROW] = six
    return full


def _directions(force: FloatArray) -> IntArray:
    """Return the number of the direction of each rest (m,): the nearest within 30 degrees, else a new one."""
    distinct, group = list[FloatArray](), np.zeros(len(force), np.int64)
    for k, up in enumerate(force / np.linalg.norm(force, axis=1)[:, None]):
        group[k] = np.argmax([*(n @ up for n in distinct), _APART])
        distinct += [up] if group[k] == len(distinct) else []
    return group


def _errors_of(model: TriadModel) -> FloatArray:
    """Return d (E, d, rotation) / d (m_xx .. m_zz, offset), (12, 12): what an error of a model is in corrected readings."""
    back, carried = np.linalg.inv(model.matrix), np.zeros((12, 12))
    for k in range(9):
        error = np.outer(np.eye(3)[k // 3], back[k % 3])
        carried[_E, k] = 0.5 * (error + error.T)[_ROW, _COLUMN]
        carried[9:, k] = 0.5 * (error - error.T)[_ROW[3:], _COLUMN[3:]]
    carried[_D, 9:] = model.matrix * si_factor(model.unit_out, "accel")
    return carried


def _judged(covariance: FloatArray, aged: FloatArray, errors: FloatArray, rests: int) -> tuple[bool, Finding]:
    """Return whether the accelerometers are updated, and why; errors (2, directions): mean squares of rests left out."""
    level, directions = np.ix_(_LEVEL, _LEVEL), errors.shape[1]
    ratio, combined = eigh(covariance[level], aged[level])
    share = np.abs(combined[:, ratio > _KEPT]).max(axis=1, initial=0.0) * np.sqrt(np.diag(aged)[_LEVEL])
    if directions == 1:
        return False, finding("drift.learn_accel_idle", "info", rests=rests)
    if directions < _DIRECTIONS or share.any():
        names = tuple(_NAMES[k] for k in np.flatnonzero(share >= PART * share.max()))
        return False, finding("drift.learn_accel_sphere", "info", rests=rests, directions=directions, names=names)
    gain, (before_mg, after_mg) = errors[0] - errors[1], np.sqrt(errors.mean(axis=1)) / MG
    where = {"directions": directions, "before_mg": before_mg, "after_mg": after_mg}
    if gain.mean() <= _SURE * gain.std(ddof=1) / directions**0.5:
        return False, finding("drift.learn_accel_kept", "info", **where)
    doubt_mg = np.sqrt(np.trace(covariance[_D, _D]) / 3.0) / MG
    return True, finding("drift.learn_accel_changed", "info", rests=rests, offset_mg=doubt_mg, **where)


def with_accel_in_use(calibration: Calibration, fit: AccelUseFit) -> Calibration:
    """Return a calibration whose accelerometers, and their part of its tables, are updated; its axes stay."""
    model, tables, e, var = calibration.accel, calibration.drift, _symmetric(fit.change[_E]), np.diag(fit.covariance)
    if model is None or not fit.changed:
        return calibration
    errors, across = _errors_of(model), fit.covariance.copy()[:12, :12]
    back = np.linalg.inv(errors[_D, 9:])
    rotation = (errors @ np.nan_to_num(model.covariance[:12, :12]) @ errors.T)[9:, 9:]
    across[9:], across[:, 9:], across[9:, 9:] = 0.0, 0.0, rotation
    made = replace(
        model, matrix=model.matrix + e @ model.matrix, offset=model.offset + back @ fit.change[_D], budget=None
    )
    covariance, carry = np.array(model.covariance), np.linalg.inv(_errors_of(made))
    covariance[:12, :12], covariance[12:, :12], covariance[:12, 12:] = carry @ across @ carry.T, 0.0, 0.0
    calibration = replace(calibration, accel=replace(made, covariance=covariance))
    if tables is None:
        return calibration
    static, scale = tables.static, tables.scale
    shown = (var[_K] < _KEPT * fit.before[_K] ** 2).any()  # slopes of the offset: then there is a table from now on
    if static is not None and (static.accel_offset is not None or shown):
        d = (static.temp_c - fit.reference_c)[:, None]
        spread = var[_D] + 2.0 * d * fit.covariance[range(6, 9), range(9, 12)] + d**2 * var[_K]
        before = model.offset if static.accel_offset is None else static.accel_offset
        static = replace(
            static,
            accel_offset=before + (fit.change[_D] + fit.change[_K] * d) @ back.T,
            accel_uncertainty=np.sqrt(spread @ back.T**2),
            accel_extrapolated=~near_data(static.temp_c, fit.temp_c, gap_c=_GAP_C),
            accel_visit=None,
        )
    if scale is not None and scale.accel_matrix is not None:
        d = (scale.temp_c - fit.reference_c)[:, None, None]
        gain = np.eye(3) * (1.0 + fit.change[_C] * d) + e
        scale = replace(scale, accel_matrix=gain @ scale.accel_matrix)  # no more uncertain than it was
    return replace(calibration, drift=replace(tables, static=static, scale=scale))
