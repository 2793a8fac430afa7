"""Free poses: the corrected reading of each still pose has the length of gravity, for an upper triangular M.

    |M (u - o)| = g + e

Scaled so that every parameter is near one or of the size of g:

    v = k (u - c)          c, k: sphere through the readings
    |M' (v - o')| = g      M = k M',  o = c + o' / k

Gauss-Newton: with n the direction of M' (v - o'), dr/dm'_ij = n_i (v - o')_j and dr/do' = -M'^T n. Each length weighs by the noise
of its mean, n^T M S_k M^T n, and one excess variance for poses in which the device moved (Paule and Mandel). Temperature creep
moves all lengths together, by N_c z with z ~ N(0, 1): z is fitted as well, with prior rows. Poses on the faces do not determine
cross-axis terms: each combination c of m'_xy, m'_xz, m'_yz that the poses do not determine gets a prior row, c . m' = 0 +- sd.

A real sensor also has a quadratic term: it reads q y^2 more, y along its axis, q ~ N(0, s_q^2). The term is a source of
uncertainty. It is not estimated, since a prior for it costs accuracy on a linear sensor. With N the lengths that q changes, G the
gains of the fit, W the weights, and L = N - X G N what the parameters cannot absorb of them, its share is the mean square of G N q
for the residuals r at hand:

    G N (C + m m') N' G'   C = (L' W L + I / s_q^2)^-1,   m = C L' W r

If C + m m' is larger than s_q^2, it replaces s_q^2 (expectation maximisation).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.plausibility import check_gravity, check_own_scale
from undrift.calibration.sources import Creep
from undrift.errors import NotObservable, PoorFit
from undrift.findings import Finding, above, finding
from undrift.fit.gls import excess_variance, student_factor
from undrift.fit.triad import TriadFit, parameter_names, scaled_condition, triad_fit
from undrift.model import AXES, Verdict
from undrift.segments import sphere_of
from undrift.units import STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

ROW, COLUMN = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])  # of the six elements, in the order of p
NAMES = (*(f"m_{AXES[i]}{AXES[j]}" for i, j in zip(ROW, COLUMN, strict=True)), *(f"offset_{axis}" for axis in AXES))
WEAKEST = 0.02  # rms change of length, in g, per unit of a determined parameter; random poses reach 0.25
CROSS = np.array([1, 2, 4])  # of p: m_xy, m_xz, m_yz
PART = 0.3  # of a combination of parameters: a parameter with this share belongs to it
QUADRATIC_SD = 2e-4  # s_q, 1/(m/s2): MPU-6050, ICM-20948 and BMI160 state 0.5 % of the range, 2.5e-4 for 2 g
MOST_STEPS, WHOLE_STEPS = 100, 15  # of the descent; after the second number the excess moves by half of its step
CONVERGED, FARTHEST = 1e-9, 30.0  # relative step; parameters beyond which the descent runs away
SIZE_ROUNDS = 20  # of the size of quadratic terms
_START = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormFit:
    """Scaled solution of the norm equations."""

    center: FloatArray  # (3,), c, raw unit
    scale: float  # k, m/s2 per raw unit
    p: FloatArray  # (9,), m'_xx m'_xy m'_xz m'_yy m'_yz m'_zz (1), o'_x o'_y o'_z (m/s2)
    covariance: FloatArray  # (9, 9), of p; zeros where held, NaN where the equations are singular
    residuals: FloatArray  # (K,), length minus gravity, m/s2
    condition: float  # condition number of the design, columns scaled to one
    weakest: float  # least rms change of length, in g, per unit of any combination of parameters (1, and g for offsets)
    unseen: tuple[str, ...]  # parameters of that weakest combination
    gravity: float  # m/s2
    prior: FloatArray  # (R, 9), combinations of cross-axis terms that only the prior determines, unit length
    prior_sd: float  # standard deviation of each, 1; 0 without a prior
    quadratic: FloatArray  # (9, 9), share of the covariance that quadratic terms contribute

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
        return _of_reading(self.covariance, self.gravity)

    @property
    def quadratic_uncertainty(self) -> float:
        """Part of ``uncertainty`` that quadratic terms contribute, m/s2."""
        return _of_reading(self.quadratic, self.gravity)

    def corrected(self, reading: FloatArray) -> FloatArray:
        """Return readings (K, 3) in m/s2."""
        return np.asarray((reading - self.offset) @ self.matrix.T)


def _of_reading(covariance: FloatArray, gravity: float) -> float:
    variance = np.diag(covariance)
    total = float(gravity**2 / 3.0 * variance[:6].sum() + variance[6:].sum())
    return float(np.sqrt(total)) if np.isfinite(total) else np.inf


def fit_norm(
    reading: FloatArray,
    *,
    gravity: float,
    variances: FloatArray | None = None,
    cross_axis: bool = True,
    prior_sd: float | None = None,
    creep: Creep | None = None,
    quadratic_sd: float = 0.0,
) -> NormFit:
    """Fit matrix and offset to mean readings (K, 3) in still poses.

    ``variances`` (K, 3) are those of the means; without them, the residuals determine the noise. ``cross_axis`` False holds the
    cross-axis terms at zero. ``prior_sd`` is the standard deviation of a cross-axis term that the poses do not determine, 1; None
    leaves it undetermined. ``quadratic_sd`` is s_q. Raises PoorFit if no linear sensor could have given the readings.
    """
    center, radius = sphere_of(reading)
    scale = gravity / radius
    poses = _NormEquations(
        v=np.ascontiguousarray(scale * (reading - center)),
        variances=np.zeros_like(reading) if variances is None else variances * scale**2,
        creep=None if creep is None or creep.none else creep,
        gravity=gravity,
        free=np.arange(9) if cross_axis else np.array([0, 3, 5, 6, 7, 8]),
    )
    prior = np.zeros((0, 9)) if prior_sd is None else poses.undetermined_cross_axis(_START)
    p, variance = poses.descend(prior, prior_sd)
    if prior_sd is not None and not len(prior) and len(prior := poses.undetermined_cross_axis(p)):
        p, variance = poses.descend(prior, prior_sd)
    weakest, unseen, condition = poses.observability(p, prior)
    if variance is None and weakest > WEAKEST:
        raise PoorFit(
            f"multi-position: {len(reading)} readings do not have one length, {gravity:g} m/s2, for any linear sensor. Check that "
            "the device lay still and that the columns are the accelerometer's",
            poses=len(reading),
        )
    covariance, quadratic = np.full((2, 9, 9), np.nan)
    if variance is not None:
        own = np.ix_(poses.free, poses.free)
        covariance, quadratic = np.zeros((2, 9, 9))
        covariance[own], quadratic[own] = poses.covariances(p, variance, prior, prior_sd, quadratic_sd)
    return NormFit(
        center=center,
        scale=scale,
        p=p,
        covariance=covariance,
        residuals=_linearised(poses.v, p, gravity)[1],
        condition=condition,
        weakest=weakest,
        unseen=unseen,
        gravity=gravity,
        prior=prior,
        prior_sd=(prior_sd or 0.0) if len(prior) else 0.0,
        quadratic=quadratic,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _NormEquations:
    v: FloatArray  # (K, 3), scaled readings, m/s2
    variances: FloatArray  # (K, 3), of these, (m/s2)^2
    creep: Creep | None
    gravity: float  # m/s2
    free: IntArray  # numbers of the parameters that are fitted

    def descend(self, prior: FloatArray, prior_sd: float | None) -> tuple[FloatArray, FloatArray | None]:
        """Return p (9,) and the variance of each length; the start and None without a minimum, or with undetermined parameters."""
        p, excess, converged = _START.copy(), 0.0, False
        if self.observability(p, prior)[0] < WEAKEST:
            return p, None
        size = np.array([1.0] * 6 + [self.gravity] * 3)[self.free]
        for number in range(MOST_STEPS):
            design, residuals, noise = self.rows(p)
            if not excess:  # before the first fit, the scatter of the lengths themselves
                excess = excess_variance(residuals, noise, len(residuals))
            deviation = np.sqrt(noise + excess)
            rows, known = self.with_prior(design / deviation[:, None], p, prior, prior_sd)
            step = np.linalg.lstsq(rows, np.concatenate((-residuals / deviation, known)), rcond=None)[0]
            p[self.free] += step[: len(self.free)]
            leverage = float((np.linalg.qr(rows)[0][: len(residuals)] ** 2).sum())
            change = excess_variance(residuals + design @ step, noise, len(residuals) - leverage) - excess
            excess += change if number < WHOLE_STEPS else 0.5 * change  # weights and excess may oscillate
            converged = float(np.abs(step[: len(self.free)] / size).max()) < CONVERGED
            if converged or not float(np.abs(p[self.free] / size).max()) < FARTHEST:
                break
        return (p, noise + excess * student_factor(len(residuals) - leverage)) if converged else (_START, None)

    def rows(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the design (K, F + C) of free parameters and creep, the residuals (K,) and their variances by noise (K,)."""
        design, residuals = _linearised(self.v, p, self.gravity)
        by_reading = -design[:, 6:]  # d length / d reading = M'^T n
        noise = np.maximum((by_reading**2 * self.variances).sum(axis=1), (1e-9 * self.gravity) ** 2)
        moved = [np.zeros((len(self.v), 0))]
        if self.creep is not None:
            moved = [by_reading[:, [j]] * self.creep.columns(d) for j, d in enumerate((self.v - p[6:]).T)]
        return np.hstack([design[:, self.free], *moved]), residuals, noise

    def with_prior(
        self, design: FloatArray, p: FloatArray, prior: FloatArray, prior_sd: float | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return rows in standard deviations with those of the priors, of cross-axis terms and of creep, and their values."""
        creep = design.shape[1] - len(self.free)
        cross_axis = prior[:, self.free] / (prior_sd or 1.0)
        rows = np.vstack(
            (design, np.pad(cross_axis, ((0, 0), (0, creep))), np.eye(creep, design.shape[1], len(self.free)))
        )
        return rows, np.concatenate((-cross_axis @ p[self.free], np.zeros(creep)))

    def covariances(
        self, p: FloatArray, variance: FloatArray, prior: FloatArray, prior_sd: float | None, quadratic_sd: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return the covariance (F, F) of the free parameters at p, and what quadratic terms contribute to it."""
        count, (design, residuals, _) = len(self.free), self.rows(p)
        weight = 1.0 / np.sqrt(variance)[:, None]
        rows, _ = self.with_prior(design * weight, p, prior, prior_sd)
        root = np.linalg.inv(np.linalg.qr(rows, mode="r"))
        total = root @ root.T
        gains = total @ (design * weight**2).T
        gain = np.linalg.norm(np.linalg.inv(_upper(p)), axis=1)  # of each sensor: v - o' = gain y
        by_reading = -_linearised(self.v, p, self.gravity)[0][:, 6:]
        lengths = quadratic_sd * by_reading * (self.v - p[6:]) ** 2 / gain  # (K, 3): N s_q
        left = (lengths - design @ (gains @ lengths)) * weight
        size = 1.0
        for _ in range(SIZE_ROUNDS):  # residuals may show larger terms than stated
            uncertain = np.linalg.inv(left.T @ left + np.eye(3) / size**2)
            mean = uncertain @ (left.T @ (residuals * weight[:, 0]))
            size = max(1.0, float(np.sqrt(np.mean(mean**2 + np.diag(uncertain)))))
        carried = (gains @ lengths)[:count]
        share = carried @ (uncertain + np.outer(mean, mean)) @ carried.T
        return total[:count, :count] + share, share

    def observability(self, p: FloatArray, prior: FloatArray) -> tuple[float, tuple[str, ...], float]:
        """Return the least rms change of length per unit, in g, the parameters that it concerns, and the condition number."""
        size, count = np.array([self.gravity] * 6 + [1.0] * 3), len(self.v)
        design = np.vstack((_linearised(self.v, p, self.gravity)[0], np.sqrt(count) * size * prior))[:, self.free]
        _, singular, right = np.linalg.svd(design / size[self.free], full_matrices=False)
        weak = np.append(np.flatnonzero(singular < WEAKEST * np.sqrt(count)), len(singular) - 1)
        share = np.linalg.norm(right[weak], axis=0)
        weakest = float(singular[-1] / np.sqrt(count)) if len(design) >= len(self.free) else 0.0
        names = tuple(NAMES[i] for i in self.free[share > PART * share.max()])
        return weakest, names, scaled_condition(design)[1]

    def undetermined_cross_axis(self, p: FloatArray) -> FloatArray:
        """Return the combinations of cross-axis terms (R, 9), unit length, that the poses do not determine at p."""
        scaled = _linearised(self.v, p, self.gravity)[0] / np.array([self.gravity] * 6 + [1.0] * 3)
        values, vectors = np.linalg.eigh(scaled.T @ scaled / len(scaled))
        weak = vectors[CROSS][:, values < WEAKEST**2]
        if not weak.size:
            return np.zeros((0, 9))
        combined, part, _ = np.linalg.svd(weak, full_matrices=False)
        rows = combined[:, part > PART].T
        prior = np.zeros((len(rows), 9))
        prior[:, CROSS] = rows
        return prior


def _upper(p: FloatArray) -> FloatArray:
    matrix = np.zeros((3, 3))
    matrix[ROW, COLUMN] = p[:6]
    return matrix


def _linearised(v: FloatArray, p: FloatArray, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return design (K, 9) and residuals (K,) at p."""
    matrix, d = _upper(p), np.ascontiguousarray((v - p[6:]).T)  # rows of K, which numpy takes fastest
    a = matrix @ d
    length = np.sqrt((a * a).sum(axis=0))
    n = a / length
    return np.concatenate((n[ROW] * d[COLUMN], -matrix.T @ n)).T, length - gravity


# ---- is the solution one of free poses? a fit with its verdict, or a refusal

SEEN = np.array([0, 1, 2, 4, 5, 8, 9, 10, 11])  # of m_xx .. m_zz, offset_x ..: those that the length of gravity shows
TOLERANCE = 0.25  # of the sensitivity that the unit states; raw parts are within 0.2
MG = STANDARD_GRAVITY * 1e-3
RESIDUAL_MG = (3.0, 20.0)  # limits of a verdict: marginal above the first, bad above the second
UNCERTAIN_MG = (2.0, 20.0)
QUADRATIC_MG = 0.5  # uncertainty from quadratic terms, above which more poses help


def check_count(reading: FloatArray, *, known_noise: bool) -> None:
    """Raise unless there are enough different poses."""
    wanted = len(NAMES) + (not known_noise)
    different = len(np.unique(reading, axis=0))
    if different < wanted:
        raise NotObservable(
            f"multi-position: wanted {wanted} still poses or more for {parameter_names(NAMES)}, got {different}; record more "
            "poses, each with another side, edge or corner up, and hold each still for two seconds",
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
    triad = triad_fit(
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
    check_own_scale(triad.model.scale_factor, unit, "accel", TOLERANCE, "accel")
    return triad


def _judged(fit: NormFit, rms_mg: float, corrected: FloatArray) -> Iterator[Finding]:
    sigma = fit.uncertainty / MG
    yield from above("multi_position.residual", rms_mg, RESIDUAL_MG, rms_mg=rms_mg)
    yield from above("multi_position.uncertainty", sigma, UNCERTAIN_MG, uncertainty_mg=sigma)
    if (bent := fit.quadratic_uncertainty / MG) > QUADRATIC_MG:
        yield finding("quadratic.unseen", "info", size_mg=bent)
    if len(fit.prior):
        part = np.linalg.norm(fit.prior, axis=0)
        unseen = tuple(NAMES[i] for i in CROSS if part[i] > PART)
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
