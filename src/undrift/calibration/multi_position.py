"""Calibration without equipment: hold the device still in many poses, turn it by hand between them (Tedaldi et al., ICRA 2014).

    |M_a (u_k - o_a)| = g                over k = 1 .. K still poses; u_k mean raw reading, M_a upper triangular
    C(M_g, o_g) n_before = n_after       gyroscopes, over the moves between     calibration/multi_position_gyro.py

A common rotation of all readings keeps their length, so three of twelve parameters are a choice of axes: the sensor's z axis is the
case's, its y axis lies in the case's y-z plane. A still is where the sliding variance of the accelerometer is below a multiple of
that at rest. Of several multiples, rule ``coverage`` takes, among those that keep nine tenths of the different poses, the one that
leaves a corrected reading least uncertain: a low threshold loses poses, a high one lets motion in. Rule ``published`` takes the
smallest summed cost over the first second of each still, which may keep few poses.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.adc import code_steps, code_variance
from undrift.calibration.checks import check_gravity, check_own_scale, check_range
from undrift.calibration.creep import Creep, Kind, creep_of
from undrift.calibration.multi_position_gyro import fit_gyro_between_stills
from undrift.calibration.observe import Observed, Outcome
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.findings import Finding, finding
from undrift.fit.least_squares import TriadFit, excess_variance, parameter_names, scaled_condition, triad_fit, whitened
from undrift.model import AXES, TriadModel, Verdict, level_of
from undrift.record import Record, Still
from undrift.segments import runs, sphere_of
from undrift.units import STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

# ---- solve |M (u - o)| = g for an upper triangular M
#
# Scaled so that every parameter is near one or of the size of g:
#
#     v = k (u - c)          c, k from the sphere through the readings
#     |M' (v - o')| = g      M = k M',  o = c + o' / k
#
# Levenberg-Marquardt on the normal equations with analytic Jacobian: with n the direction of M' (v - o'),
# dr/dm'_ij = n_i (v - o')_j and dr/do' = -M'^T n. Each pose weighs by the variance of its length, n^T M S_k M^T n + s2, S_k the
# variances of the mean and s2 the excess (fit/least_squares.py): the profile likelihood over unknown directions. Temperature creep
# moves lengths by N z, z ~ N(0, 1), a column of N (K, 6) for the offset and the scale of each sensor: W = (diag + N N')^-1.
#
# Poses on the faces alone do not show cross-axis terms. With a prior, each combination c of m'_xy, m'_xz, m'_yz that the poses do
# not show gets one equation more, c . m' = 0 +- sd; what they show gets none, and a session that shows all is fitted as without.

ROW, COLUMN = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])  # of the six elements, in the order of p
NAMES = (*(f"m_{AXES[i]}{AXES[j]}" for i, j in zip(ROW, COLUMN, strict=True)), *(f"offset_{axis}" for axis in AXES))
WEAKEST = 0.02  # rms change of length, in g, per unit of a parameter that still counts as seen; random poses show 0.25
CROSS = np.array([1, 2, 4])  # of p: m_xy, m_xz, m_yz
_START = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
_SHARE = 0.3  # of a combination of parameters: a parameter with this part in it belongs to it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormFit:
    """Scaled solution of the norm equations."""

    center: FloatArray  # (3,), c, raw unit
    scale: float  # k, m/s2 per raw unit
    p: FloatArray  # (9,), m'_xx m'_xy m'_xz m'_yy m'_yz m'_zz (1), o'_x o'_y o'_z (m/s2)
    covariance: FloatArray  # (9, 9), of p; zeros where held, NaN where the equations are singular
    residuals: FloatArray  # (K,), length less gravity, m/s2
    condition: float  # Condition number of the design, columns scaled to one
    # Least rms change of length, in g, that one unit of any combination of parameters makes (1, and g for offsets)
    weakest: float
    unseen: tuple[str, ...]  # The parameters that take part in that weakest combination
    gravity: float  # m/s2
    prior: FloatArray  # (R, 9), combinations of cross-axis terms that are known by the prior alone, unit length
    prior_sd: float  # Standard deviation of each, 1; 0 without a prior

    @property
    def matrix(self) -> FloatArray:
        """M, m/s2 per raw unit, shape (3, 3)."""
        return self.scale * _upper(self.p)

    @property
    def offset(self) -> FloatArray:
        """o, raw unit, shape (3,)."""
        return np.asarray(self.center + self.p[6:] / self.scale)

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of a corrected reading of gravity, root mean square over all directions, m/s2."""
        variance = np.diag(self.covariance)
        total = float(self.gravity**2 / 3.0 * variance[:6].sum() + variance[6:].sum())
        return float(np.sqrt(total)) if np.isfinite(total) else np.inf

    def corrected(self, reading: FloatArray) -> FloatArray:
        """Return readings (K, 3) in m/s2."""
        return np.asarray((reading - self.offset) @ self.matrix.T)


def fit_norm(
    reading: FloatArray,
    *,
    gravity: float,
    variances: FloatArray | None = None,
    cross_axis: bool = True,
    prior_sd: float | None = None,
    creep: Creep | None = None,
) -> NormFit:
    """Solve the norm equations of readings (K, 3) with variances of the mean (K, 3); weights and excess settle together."""
    center, radius = sphere_of(reading)
    scale = gravity / radius
    v = np.ascontiguousarray(scale * (reading - center))
    stated = _Stated(np.zeros_like(v) if variances is None else variances * scale**2, creep)
    free = np.arange(9) if cross_axis else np.array([0, 3, 5, 6, 7, 8])
    rounds = 1 if variances is None and prior_sd is None else 6
    prior: FloatArray = np.zeros((0, 9))
    found, p, variance = _settled(v, stated, gravity, free, prior, rounds)
    if prior_sd is not None:
        for at in (_START, p):  # the solution itself may have run away along what nothing shows
            prior = _unseen_cross_axis(_linearised(v, at, gravity)[0], gravity)
            if len(prior):
                found, p, variance = _settled(v, stated, gravity, free, prior / prior_sd, rounds)
                break
    design, residuals = _linearised(v, p, gravity)
    size = np.array([gravity] * 6 + [1.0] * 3)
    seen = _with(design[:, free], (np.sqrt(len(v)) * size * prior)[:, free])
    _, singular, right = np.linalg.svd(seen / size[free], full_matrices=False)
    weak = np.append(np.flatnonzero(singular < WEAKEST * np.sqrt(len(v))), len(singular) - 1)
    share = np.linalg.norm(right[weak], axis=0)
    weakest = float(singular[-1] / np.sqrt(len(v))) if len(seen) >= len(free) else 0.0
    if not found and weakest > WEAKEST:
        raise PoorFit(
            f"multi-position: wanted {len(v)} readings of length {gravity:g} m/s2, got none that a linear sensor could give; "
            "check that the device lay still and that the columns are the accelerometer's",
            poses=len(v),
        )
    covariance = np.zeros((9, 9))
    weighted = whitened(design[:, free], np.sqrt(variance), stated.shared(v, p, design))
    covariance[np.ix_(free, free)] = _inverse(_with(weighted, prior[:, free] / (prior_sd or 1.0)))
    return NormFit(
        center=center,
        scale=scale,
        p=p,
        covariance=covariance,
        residuals=residuals,
        condition=scaled_condition(seen)[1],
        weakest=weakest,
        unseen=tuple(NAMES[i] for i in free[share > _SHARE * share.max()]),
        gravity=gravity,
        prior=prior,
        prior_sd=(prior_sd or 0.0) if len(prior) else 0.0,
    )


def _with(design: FloatArray, prior: FloatArray) -> FloatArray:
    return (
        np.vstack((design, prior)) if len(prior) else design
    )  # without a prior the memory stays, and so does rounding


class _Stated(NamedTuple):
    """What is stated of readings v (K, 3): variances (K, 3), (m/s2)^2, and how far they creep."""

    variances: FloatArray
    creep: Creep | None

    def shared(self, v: FloatArray, p: FloatArray, design: FloatArray) -> FloatArray | None:
        """Return N (K, 6), m/s2, at p and its design (K, 9); None without creep."""
        if self.creep is None or self.creep.none:
            return None
        by_reading, columns = -design[:, 6:], [self.creep.columns(column) for column in (v - p[6:]).T]
        return np.hstack([by_reading[:, [j]] * columns[j] for j in range(3)])


def _settled(
    v: FloatArray, stated: _Stated, gravity: float, free: IntArray, prior: FloatArray, rounds: int
) -> tuple[bool, FloatArray, FloatArray]:
    """Return whether there is a minimum, p, and the variance of each length (K,); prior (R, 9) in standard deviations."""
    found, p, variance = True, _START, np.ones(len(v))
    for _ in range(rounds):
        before, least = p, variance.min()
        shared = stated.shared(v, p, _linearised(v, p, gravity)[0])
        weight = _Weight(least / variance, None if shared is None else shared / np.sqrt(least))
        p, found = _descend(v, weight, p, gravity, free, prior * np.sqrt(least))
        design, residuals = _linearised(v, p, gravity)
        moved, spent = weight.creep(residuals)
        own = (design[:, 6:] ** 2 * stated.variances).sum(axis=1)  # d length / d reading = M'^T n
        variance = own + excess_variance(residuals - moved, own, len(v) - len(free) + len(prior) - spent)
        variance = np.maximum(variance, (1e-12 * gravity) ** 2)
        if not found or float(np.abs(p - before).max()) < 1e-12 * gravity:
            break
    return found, p, variance


def _unseen_cross_axis(design: FloatArray, gravity: float) -> FloatArray:
    """Return the combinations of cross-axis terms (R, 9), unit length, that a design (K, 9) does not show."""
    scaled = design / np.array([gravity] * 6 + [1.0] * 3)
    values, vectors = np.linalg.eigh(scaled.T @ scaled / len(design))
    weak = vectors[CROSS][:, values < WEAKEST**2]
    if not weak.size:
        return np.zeros((0, 9))
    combined, part, _ = np.linalg.svd(weak, full_matrices=False)
    rows = combined[:, part > _SHARE].T
    prior = np.zeros((len(rows), 9))
    prior[:, CROSS] = rows
    return prior


def _upper(p: FloatArray) -> FloatArray:
    matrix = np.zeros((3, 3))
    matrix[ROW, COLUMN] = p[:6]
    return matrix


class _Weight(NamedTuple):
    """W = (diag(1 / each) + N N')^-1 of K lengths."""

    each: FloatArray  # (K,)
    shared: FloatArray | None  # N (K, c)

    def of(self, rows: FloatArray) -> FloatArray:
        """Return rows (P, K) W."""
        weighted = rows * self.each
        if self.shared is None:
            return weighted
        inner = np.eye(self.shared.shape[1]) + (self.shared.T * self.each) @ self.shared
        return np.asarray(weighted - np.linalg.solve(inner, self.shared.T @ weighted.T).T @ (self.shared.T * self.each))

    def creep(self, residuals: FloatArray) -> tuple[FloatArray, float]:
        """Return the most likely N z in residuals (K,), and the degrees of freedom that it takes."""
        if self.shared is None:
            return np.zeros(len(residuals)), 0.0
        taken = self.of(self.shared.T) @ self.shared  # 1 - (1 + N' diag N)^-1
        return self.shared @ (self.shared.T @ self.of(residuals[None])[0]), float(np.trace(taken))


def _descend(
    v: FloatArray, weight: _Weight, start: FloatArray, gravity: float, free: IntArray, prior: FloatArray
) -> tuple[FloatArray, bool]:
    """Return the minimum and whether there is one; the start again where the steps run away."""
    known = prior[:, free]
    size = np.array([1.0] * 6 + [gravity] * 3)

    def equations(p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        design, residuals = _linearised(v, p, gravity)
        rows = design.T[free]
        weighted = weight.of(rows)
        cost = float(weight.each @ residuals**2 if weight.shared is None else weight.of(residuals[None])[0] @ residuals)
        normal, gradient = weighted @ rows.T, weighted @ residuals
        if not len(known):
            return cost, normal, gradient
        away = prior @ p
        return cost + float(away @ away), normal + known.T @ known, gradient + known.T @ away

    p, damping = start, 1e-9
    cost, normal, gradient = equations(p)
    for _ in range(100):
        step = np.zeros(9)
        step[free] = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12 * len(v)), -gradient)
        trial = equations(p + step)
        if trial[0] <= cost:
            p, damping = p + step, max(0.1 * damping, 1e-12)
            cost, normal, gradient = trial
        else:
            damping = max(10.0 * damping, 1e-6)
        if float(np.abs(step / size).max()) < 1e-11 or damping > 1e9:
            return p, True
        if float(np.abs(p / size).max()) > 30.0:
            break
    return start, False


def _linearised(v: FloatArray, p: FloatArray, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return design (K, 9) and residuals (K,) at p."""
    matrix, d = _upper(p), np.ascontiguousarray((v - p[6:]).T)  # rows of K, which numpy takes fastest
    a = matrix @ d
    length = np.sqrt((a * a).sum(axis=0))
    n = a / length
    return np.concatenate((n[ROW] * d[COLUMN], -matrix.T @ n)).T, length - gravity


def _inverse(design: FloatArray) -> FloatArray:
    """Return (J^T J)^-1 by singular values, NaN where they are short of rank."""
    size = np.linalg.norm(design, axis=0)
    _, singular, right = np.linalg.svd(design / np.where(size > 0.0, size, 1.0), full_matrices=False)
    if len(singular) < design.shape[1] or len(design) < design.shape[1] or singular[-1] < 1e-9 * singular[0]:
        return np.full((design.shape[1], design.shape[1]), np.nan)
    root = right.T / singular / size[:, None]
    return np.asarray(root @ root.T)


# ---- accelerometer from free poses

SEEN = np.array([0, 1, 2, 4, 5, 8, 9, 10, 11])  # of m_xx .. m_zz, offset_x ..: those that the length of gravity shows
TOLERANCE = 0.25  # of the sensitivity that the unit states; raw parts are within 0.2
MG = STANDARD_GRAVITY * 1e-3
RESIDUAL_MG = (3.0, 20.0)  # limits of a verdict: marginal above the first, bad above the second
UNCERTAIN_MG = (2.0, 20.0)
FEWEST_POSES = 7  # with a prior on cross-axis terms: scale, offset, and one pose to check them


def check_count(reading: FloatArray, parameters: int, *, known_noise: bool) -> None:
    """Raise unless there are enough different poses."""
    wanted = parameters + (not known_noise)
    names = parameter_names(NAMES if parameters == 9 else [NAMES[i] for i in (0, 3, 5, 6, 7, 8)])
    different = len(np.unique(reading, axis=0))
    if different < wanted:
        raise NotObservable(
            f"multi-position: wanted {wanted} still poses or more for {names}, got {different}; record more poses, "
            "each with another side, edge or corner up, and hold each still for two seconds",
            poses=different,
            wanted=wanted,
        )


def judged(fit: NormFit, reading: FloatArray, unit_in: str) -> TriadFit:
    """Return a solution as a fit with verdict, or refuse it where the poses leave a parameter unobserved."""
    unit = canonical_unit(unit_in, "accel")
    if is_physical(unit):
        check_gravity(reading * si_factor(unit, "accel"), fit.gravity)
    corrected = fit.corrected(reading)
    if fit.weakest < WEAKEST:
        raise NotObservable(
            f"multi-position: wanted poses that change the length by {WEAKEST:g} g or more per unit of every parameter, got "
            f"{fit.weakest:.2g} for {parameter_names(fit.unseen)}; {_advice(corrected, fit.unseen)}",
            weakest=fit.weakest,
            parameters=fit.unseen,
        )
    carry = np.zeros((12, 9))  # d (m_xx .. m_zz, offset) / d p
    carry[SEEN, np.arange(9)] = [fit.scale] * 6 + [1.0 / fit.scale] * 3
    rms_mg = float(np.sqrt(np.mean(fit.residuals**2))) / MG
    made = triad_fit(
        fit.residuals,
        Verdict.of(*_judged(fit, rms_mg, corrected)),
        method="multi-position",
        unit_in=unit,
        unit_out="m/s2",
        matrix=fit.matrix,
        offset=fit.offset,
        covariance=carry @ fit.covariance @ carry.T,
        rank=int((np.diag(fit.covariance) > 0.0).sum()) - len(fit.prior),
        condition=fit.condition,
        valid_range=(float(corrected.min()), float(corrected.max())),
    )
    check_own_scale(made.model.scale_factor, unit, "accel", TOLERANCE, "accel")
    return made


def _judged(fit: NormFit, rms_mg: float, corrected: FloatArray) -> Iterator[Finding]:
    sigma, wanted = fit.uncertainty / MG, UNCERTAIN_MG[0]
    off = finding("multi_position.residual", level_of(rms_mg, RESIDUAL_MG), rms_mg=rms_mg, wanted=RESIDUAL_MG[0])
    unsure = finding("multi_position.uncertainty", level_of(sigma, UNCERTAIN_MG), uncertainty_mg=sigma, wanted=wanted)
    yield from (item for item in (off, unsure) if item.level != "info")
    if not np.triu(fit.matrix, 1).any():
        yield finding("multi_position.cross_axis_fixed", "info")
    if len(fit.prior):
        part = np.linalg.norm(fit.prior, axis=0)
        unseen = tuple(NAMES[i] for i in CROSS if part[i] > _SHARE)
        after = 100.0 * np.sqrt(np.diag(fit.covariance)[[NAMES.index(name) for name in unseen]])
        yield finding(
            "multi_position.cross_axis_prior",
            "warn",
            terms=parameter_names(unseen),
            prior_percent=100.0 * fit.prior_sd,
            uncertainty_percent=after,
            advice=_advice(corrected, unseen),
        )


def _advice(corrected: FloatArray, unseen: tuple[str, ...]) -> str:
    n = corrected / np.linalg.norm(corrected, axis=1)[:, None]
    values, vectors = np.linalg.eigh(n.T @ n / len(n))
    if values[0] < 0.02:
        axis = AXES[int(np.abs(vectors[:, 0]).argmax())]
        return f"all poses lie near one plane: add poses with the {axis} axis up and with it down"
    if set(unseen) <= {"m_xy", "m_xz", "m_yz"}:
        return "add poses between the faces (edges and corners up)"
    return "add poses on the sides, edges and corners that are missing"


# ---- stills: where the sliding variance of the accelerometer is below a threshold
#
#     s2_k = |(var u_x, var u_y, var u_z)| over the window centred at k        sample variances, raw unit squared
#
# A turn about the vertical does not show in an accelerometer: where there are gyroscopes, a still is reduced to its core, in which
# their variance is as low as in most of the stills. Running sums make mean and variance of any stretch cost the same.

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


def still_variance(record: Record, *, window_s: float, rest_s: float | None) -> StillVariance:
    """Return the windowed variance of a record's accelerometer and its level at rest."""
    if record.accel is None:
        raise InputError("still variance: wanted accel readings, got none; map the accelerometer columns")
    half = max(5, round(0.5 * window_s * record.sample_rate_hz))
    if len(record) < 2 * half + 2 or (rest_s is not None and record.duration_s < rest_s):
        raise InputError(
            f"still variance: wanted a record longer than its window of {window_s:g} s"
            + ("" if rest_s is None else f" and its opening rest of {rest_s:g} s")
            + f", got {record.duration_s:.2f} s; shorten them"
        )
    level, sums, centre = _windowed(record.accel, half)
    if rest_s is None:
        finite = level[np.isfinite(level)]
        at_rest = float(np.quantile(finite, QUIETEST)) if len(finite) else np.inf
    else:
        rest = int(np.searchsorted(record.time, record.time[0] + rest_s))
        at_rest = float(np.linalg.norm(np.nanvar(record.accel[:rest], axis=0, ddof=1)))
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


# ---- the whole method

SAME_POSE_DEG = 10.0  # directions nearer to each other than this count as one pose
Rule = Literal["coverage", "published"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiPositionSettings:
    """How stills are found and what is fitted."""

    window_s: float = 1.0  # Length of the sliding window, s; each end of a still loses half of it
    min_still_s: float = 1.0  # Shortest still, s, after that loss
    # Thresholds to try, in units of the level at rest
    multiples: tuple[float, ...] = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 15.0, 20.0, 30.0, 50.0)
    # Length of an opening rest that gives the level at rest, s; None takes the quietest twentieth of all windows
    rest_s: float | None = None
    rule: Rule = "coverage"  # coverage or published: how the threshold is chosen, and how poses and turns weigh
    cross_axis: bool = True  # False fits the accelerometer's scale and offset alone: for poses on the faces
    # Standard deviation of a cross-axis term that the poses do not show, of the scale; None refuses such poses
    cross_axis_prior: float | None = 0.01
    gyro: bool = True  # Fit the gyroscopes too, where the moves show them

    @classmethod
    def published(cls, rest_s: float = 50.0) -> "MultiPositionSettings":
        """Return the settings of the published demonstration."""
        multiples = tuple(float(m) for m in range(2, 11))
        return cls(multiples=multiples, rest_s=rest_s, rule="published", cross_axis_prior=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdTrial:
    """One threshold and what came of it."""

    multiple: float  # Of the level at rest; NaN where the stills were stated
    stills: int  # Still phases found
    poses: int  # Different poses among them, by direction
    cost: float  # Half the sum of squared residuals, (m/s2)^2; infinite where nothing could be fitted
    uncertainty: float  # Standard uncertainty of a corrected reading of gravity, rms over all directions, m/s2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MultiPositionFit:
    """Accelerometer and, where the moves show them, gyroscopes."""

    accel: TriadFit  # Raw to m/s2
    gyro: TriadFit | None  # Raw to rad/s in the accelerometer's axes
    stills: tuple[Still, ...]  # Those that were used
    # Threshold on the windowed variance, accelerometer unit squared; NaN where the stills were stated; of the first
    # record
    threshold: float
    trials: tuple[ThresholdTrial, ...]  # All thresholds tried
    verdict: Verdict  # Of both
    missing: tuple[Finding, ...] = ()  # Why there are no gyroscopes


_Attempt = tuple[ThresholdTrial, tuple[Still, ...], FloatArray, NormFit | None]  # the third: readings that were fitted


_NO_LENGTH = "multi-position: wanted poses of one length, got none that a linear sensor could give; check the columns"


def fit_multi_position(
    recorded: Record | Sequence[Record],
    *,
    gravity: float,
    stills: Sequence[Still] | None = None,
    settings: MultiPositionSettings = MultiPositionSettings(),
    axes: TriadModel | None = None,
    creep: Callable[[Sequence[Still], Kind], Creep] | None = None,
) -> MultiPositionFit:
    """Calibrate from recordings of free poses and turns between them, all together; a recording may be a single pose.

    ``axes`` is an accelerometer's model from elsewhere, to which the gyroscopes are fitted where the poses do not show its axes;
    ``creep`` tells how far the temperature moves the readings of stills or moves of one triad.
    """
    records = (recorded,) if isinstance(recorded, Record) else tuple(recorded)
    if any(r.accel is None for r in records) or len({r.accel_unit for r in records}) > 1:
        raise InputError(
            "multi-position: wanted accel readings in one unit in every recording, got recordings without or in several units; "
            "map the accelerometer columns and their unit"
        )
    levels = [still_variance(r, window_s=settings.window_s, rest_s=settings.rest_s) for r in records]
    step = code_steps(records, rate=False)
    levels = [replace(level, step=step) for level in levels]
    shortest = [max(2, round(settings.min_still_s * r.sample_rate_hz)) for r in records]
    stated = {} if stills is None else {np.nan: tuple(stills)}
    tried = stated or {m: _stills(levels, m, shortest) for m in settings.multiples}
    plain = replace(settings, cross_axis_prior=None)
    attempts = [_attempt(levels, chosen, m, gravity, plain, shortest) for m, chosen in tried.items()]
    trial, used, reading, fit = _choose(attempts, settings)
    if settings.cross_axis_prior is not None and settings.cross_axis and (fit is None or fit.weakest < WEAKEST):
        known = [_attempt(levels, chosen, m, gravity, settings, shortest) for m, chosen in tried.items()]
        better = _choose(known, settings)
        if better[3] is not None and better[3].weakest >= WEAKEST:
            attempts, (trial, used, reading, fit) = known, better
    if fit is None:
        check_count(reading, 9 if settings.cross_axis else 6, known_noise=True)
        raise PoorFit(_NO_LENGTH)
    if creep is not None and settings.rule != "published" and not (moved := creep(used, "accel")).none:
        held = settings if len(fit.prior) else plain
        trial, used, reading, fit = _attempt(levels, used, trial.multiple, gravity, held, shortest, moved)
        if fit is None:
            raise PoorFit(_NO_LENGTH)
    check_range([levels[s.recording].values[s.start : s.stop] for s in used], "accelerometer in still poses")
    accel = judged(fit, reading, records[0].accel_unit)
    gyro: TriadFit | None = None
    missing: tuple[Finding, ...] = ()
    if settings.gyro and all(r.gyro is not None for r in records):
        cores = used if settings.rule == "published" or stills is not None else _cores(levels, used, shortest)
        try:
            model = axes if axes is not None and len(fit.prior) else accel.model
            gyro = _fit_gyro(records, used, cores, model, settings, creep)
        except NotObservable as error:
            missing = (finding("session.fit_failed", "warn", triad="gyroscope", reason=str(error)),)
    verdict = accel.verdict if gyro is None else accel.verdict.also(gyro.verdict)
    return MultiPositionFit(
        accel=accel,
        gyro=gyro,
        stills=used,
        threshold=trial.multiple * levels[0].at_rest,
        trials=tuple(one[0] for one in attempts),
        verdict=verdict.also(Verdict.of(*missing)),
        missing=missing,
    )


def _fit_gyro(
    records: Sequence[Record],
    used: Sequence[Still],
    cores: Sequence[Still],
    model: TriadModel,
    settings: MultiPositionSettings,
    creep: Callable[[Sequence[Still], Kind], Creep] | None,
) -> TriadFit:
    if settings.rule == "published":
        return fit_gyro_between_stills(records, used, model, cores=cores, equal=True, rest_s=settings.rest_s)
    ordered = sorted(used, key=lambda still: (still.recording, still.start))
    both = None if creep is None else (creep(ordered, "accel"), creep(ordered, "gyro"))
    return fit_gyro_between_stills(records, used, model, cores=cores, creep=both)


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
    settings: MultiPositionSettings,
    shortest: list[int],
    creep: Creep | None = None,
) -> _Attempt:
    means, variances = _poses(levels, stills)
    published = settings.rule == "published"
    reading = means
    if published and stills:
        reading = np.concatenate(
            [levels[s.recording].values[s.start : s.start + shortest[s.recording]] for s in stills]
        )
    fit: NormFit | None = None
    prior_sd = settings.cross_axis_prior
    least = 6 if not settings.cross_axis else 9 if prior_sd is None else FEWEST_POSES
    if len(stills) >= least and np.ptp(reading, axis=0).any():
        with suppress(PoorFit):
            weights = None if published else variances
            fit = fit_norm(
                reading,
                gravity=gravity,
                variances=weights,
                cross_axis=settings.cross_axis,
                prior_sd=prior_sd,
                creep=creep,
            )
    trial = ThresholdTrial(
        multiple=multiple,
        stills=len(stills),
        poses=0 if fit is None else _different(fit.corrected(means)),
        cost=np.inf if fit is None else 0.5 * float(fit.residuals @ fit.residuals),
        uncertainty=np.inf if fit is None else fit.uncertainty,
    )
    return trial, stills, reading, fit


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


def _choose(attempts: list[_Attempt], settings: MultiPositionSettings) -> _Attempt:
    fitted = [a for a in attempts if a[3] is not None]
    if not fitted:
        return max(attempts, key=lambda a: len(a[1]))
    if settings.rule == "published":
        return min(fitted, key=lambda a: a[0].cost)
    # Thresholds that let motion in are far less certain; their false poses must not set the count to be reached.
    least = min(a[0].uncertainty for a in fitted)
    most = max(a[0].poses for a in fitted if a[0].uncertainty <= 2.0 * least or not np.isfinite(least))
    return min((a for a in fitted if a[0].poses >= 0.9 * most), key=lambda a: a[0].uncertainty)


# ---- from a session


def _of_session(seen: Observed, axes: TriadFit | None = None) -> MultiPositionFit:
    session = seen.session
    stills = session.stills or (seen.stills if seen.adapted else None)
    settings = MultiPositionSettings(cross_axis_prior=seen.settings.cross_axis_prior)
    model = None if axes is None or axes.model.method.startswith("multi-position") else axes.model
    return fit_multi_position(
        session.records,
        gravity=session.gravity_m_s2,
        stills=stills,
        settings=settings,
        axes=model,
        creep=lambda pieces, kind: creep_of(seen, pieces, kind),
    )


def calibrate_poses(seen: Observed, mode: str | None, accel: TriadFit | None = None) -> Outcome:
    """Fit the accelerometer of a session to its free poses; an entry of FITS."""
    made = _of_session(seen)
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
