"""Norm equations: poses in which the corrected reading has the length of gravity, for an upper triangular M.

    |M (u - o)| = g

Scaled so that every parameter is near one or of the size of g:

    v = k (u - c)          c, k from the sphere through the readings
    |M' (v - o')| = g      M = k M',  o = c + o' / k

Levenberg-Marquardt on the normal equations with analytic Jacobian: with n the direction of M' (v - o'),
dr/dm'_ij = n_i (v - o')_j and dr/do' = -M'^T n. Each pose weighs by the variance of its length, n^T M S_k M^T n + s2, S_k the
variances of the mean and s2 the excess (fit/least_squares.py): the profile likelihood over unknown directions. Temperature creep
moves lengths by N z, z ~ N(0, 1), a column of N (K, 6) for the offset and the scale of each sensor: W = (diag + N N')^-1. So does a
quadratic term q_j of each sensor, which adds q_j y_j^2 to what it measures, y_j along its own axis, q_j ~ N(0, s_q^2). It is always
there: to leave it out where a test does not show it gives intervals that hold in 72 %. The result stays linear; o is the reading
at zero input.

Poses on the faces alone do not show cross-axis terms. With a prior, each combination c of m'_xy, m'_xz, m'_yz that the poses do
not show gets one equation more, c . m' = 0 +- sd; what they show gets none, and a session that shows all is fitted as without.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.checks import check_gravity, check_own_scale
from undrift.calibration.creep import Creep
from undrift.errors import NotObservable, PoorFit
from undrift.findings import Finding, above, finding
from undrift.fit.equations import Rows, covariance_of, descend, roots, whitened
from undrift.fit.least_squares import TriadFit, excess_variance, parameter_names, scaled_condition, triad_fit
from undrift.model import AXES, Verdict
from undrift.segments import sphere_of
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

ROW, COLUMN = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])  # of the six elements, in the order of p
NAMES = (*(f"m_{AXES[i]}{AXES[j]}" for i, j in zip(ROW, COLUMN, strict=True)), *(f"offset_{axis}" for axis in AXES))
WEAKEST = 0.02  # rms change of length, in g, per unit of a parameter that still counts as seen; random poses show 0.25
CROSS = np.array([1, 2, 4])  # of p: m_xy, m_xz, m_yz
_START = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
PART = 0.3  # of a combination of parameters: a parameter with this part in it belongs to it
QUADRATIC_SD = 2e-4  # s_q, 1/(m/s2): MPU-6050, ICM-20948 and BMI160 state 0.5 % of the range, 2.5e-4 where that is 2 g


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormFit:
    """Scaled solution of the norm equations."""

    center: FloatArray  # (3,), c, raw unit
    scale: float  # k, m/s2 per raw unit
    p: FloatArray  # (9,), m'_xx m'_xy m'_xz m'_yy m'_yz m'_zz (1), o'_x o'_y o'_z (m/s2)
    covariance: FloatArray  # (9, 9), of p; zeros where held, NaN where the equations are singular
    residuals: FloatArray  # (K,), length less gravity and what quadratic terms make, m/s2
    condition: float  # Condition number of the design, columns scaled to one
    # Least rms change of length, in g, that one unit of any combination of parameters makes (1, and g for offsets)
    weakest: float
    unseen: tuple[str, ...]  # The parameters that take part in that weakest combination
    gravity: float  # m/s2
    prior: FloatArray  # (R, 9), combinations of cross-axis terms that are known by the prior alone, unit length
    prior_sd: float  # Standard deviation of each, 1; 0 without a prior
    quadratic: FloatArray  # (3,), q, 1/(m/s2), and its standard uncertainty; zeros where it was held
    quadratic_sd: FloatArray

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
    quadratic_sd: float = 0.0,
) -> NormFit:
    """Solve the norm equations of readings (K, 3) with variances of the mean (K, 3); weights and excess settle together."""
    center, radius = sphere_of(reading)
    scale = gravity / radius
    v = np.ascontiguousarray(scale * (reading - center))
    stated = _Stated(np.zeros_like(v) if variances is None else variances * scale**2, creep, quadratic_sd)
    free = np.arange(9) if cross_axis else np.array([0, 3, 5, 6, 7, 8])
    rounds = 1 if variances is None and prior_sd is None else 6
    prior: FloatArray = np.zeros((0, 9))
    converged, p, variance, q = _settled(v, stated, gravity, free, prior, rounds)
    if prior_sd is not None:
        for at in (_START, p):  # the solution itself may have run away along what nothing shows
            prior = _unseen_cross_axis(_linearised(v, at, gravity)[0], gravity)
            if len(prior):
                converged, p, variance, q = _settled(v, stated, gravity, free, prior / prior_sd, rounds)
                break
    design, residuals = _linearised(v, p, gravity)
    size = np.array([gravity] * 6 + [1.0] * 3)
    seen = np.vstack((design[:, free], (np.sqrt(len(v)) * size * prior)[:, free]))
    _, singular, right = np.linalg.svd(seen / size[free], full_matrices=False)
    weak = np.append(np.flatnonzero(singular < WEAKEST * np.sqrt(len(v))), len(singular) - 1)
    share = np.linalg.norm(right[weak], axis=0)
    weakest = float(singular[-1] / np.sqrt(len(v))) if len(seen) >= len(free) else 0.0
    if not converged and weakest > WEAKEST:
        raise PoorFit(
            f"multi-position: wanted {len(v)} readings of length {gravity:g} m/s2, got none that a linear sensor could give; "
            "check that the device lay still and that the columns are the accelerometer's",
            poses=len(v),
        )
    covariance = np.zeros((9, 9))
    shared = stated.shared(v, p, design, q)
    root = stated.root(variance, shared)
    weighed = np.vstack((whitened(root, design[:, free]), prior[:, free] / (prior_sd or 1.0)))
    covariance[np.ix_(free, free)] = covariance_of(weighed)
    z, variance_of_z = _moved(root, shared, residuals, weighed)
    bent = shared[:, -3:] @ z[-3:] if quadratic_sd else 0.0
    return NormFit(
        center=center,
        scale=scale,
        p=p,
        covariance=covariance,
        residuals=residuals - bent,
        condition=scaled_condition(seen)[1],
        weakest=weakest,
        unseen=tuple(NAMES[i] for i in free[share > PART * share.max()]),
        gravity=gravity,
        prior=prior,
        prior_sd=(prior_sd or 0.0) if len(prior) else 0.0,
        quadratic=q,
        quadratic_sd=quadratic_sd * np.sqrt(variance_of_z[-3:]) if quadratic_sd else q,
    )


class _Stated(NamedTuple):
    """What is stated of readings v (K, 3): variances (K, 3), (m/s2)^2, how far they creep, and s_q."""

    variances: FloatArray
    creep: Creep | None
    quadratic_sd: float

    def shared(self, v: FloatArray, p: FloatArray, design: FloatArray, q: FloatArray) -> FloatArray:
        """Return N (K, 9), m/s2, at p and q and their design (K, 9), quadratic terms last; (K, 3) without creep, or no column."""
        by_reading, d = -design[:, 6:], v - p[6:]
        moved = [np.zeros((len(v), 0))]
        if self.creep is not None and not self.creep.none:
            columns = [self.creep.columns(column) for column in d.T]
            moved += [by_reading[:, [j]] * columns[j] for j in range(3)]
        if self.quadratic_sd:
            gain = np.linalg.norm(np.linalg.inv(_upper(p)), axis=1)  # of each sensor: d = gain (y + q y^2)
            y = d / (gain + q * d)
            moved.append(by_reading * gain * y**2 * self.quadratic_sd)
        return np.hstack(moved)

    def root(self, variance: FloatArray, shared: FloatArray) -> FloatArray:
        """Return what whitens lengths of a variance each, (K,), that N moves together."""
        together = shared @ shared.T if shared.size else np.zeros(1)
        return np.asarray(roots(np.sqrt(variance + 1e-13 * together.max()), together)[0])


def _moved(root: FloatArray, shared: FloatArray, residuals: FloatArray, design: FloatArray) -> tuple[FloatArray, ...]:
    """Return the most likely z and its variance, which the parameters of a whitened design (R, P) share."""
    white = whitened(root, shared)
    rows = np.vstack((white, np.zeros((len(design) - len(white), white.shape[1]))))
    basis = np.linalg.qr(design)[0]
    apart = rows - basis @ (basis.T @ rows)  # cov z = 1 - N' (W - W X (X' W X)^-1 X' W) N
    return white.T @ whitened(root, residuals), 1.0 - np.minimum((apart**2).sum(axis=0), 1.0)


def _settled(
    v: FloatArray, stated: _Stated, gravity: float, free: IntArray, prior: FloatArray, rounds: int
) -> tuple[bool, FloatArray, FloatArray, FloatArray]:
    """Return whether there is a minimum, p, the variance of each length (K,) and q; prior (R, 9) in standard deviations."""
    converged, p, q = True, _START, np.zeros(3)
    # What is stated first: from a large excess the fit would explain quadratic terms by it
    variance = np.asarray(stated.variances.mean(axis=1)) + float(not stated.variances.all())
    for _ in range(rounds):
        before, shared = p, stated.shared(v, p, _linearised(v, p, gravity)[0], q)
        root = stated.root(variance, shared)
        p, converged = _descend(v, root, p, gravity, free, prior)
        design, residuals = _linearised(v, p, gravity)
        z, variance_of_z = _moved(root, shared, residuals, np.vstack((whitened(root, design[:, free]), prior[:, free])))
        moved = shared @ z
        q = np.asarray(stated.quadratic_sd * z[-3:]) if stated.quadratic_sd else q
        spare = len(v) - len(free) + len(prior) - float((1.0 - variance_of_z).sum())  # less what N z takes
        own = (design[:, 6:] ** 2 * stated.variances).sum(axis=1)  # d length / d reading = M'^T n
        variance = own + excess_variance(residuals - moved, own, spare)
        variance = np.maximum(variance, (1e-12 * gravity) ** 2)
        if not converged or float(np.abs(p - before).max()) < 1e-12 * gravity:
            break
    return converged, p, variance, q


def _unseen_cross_axis(design: FloatArray, gravity: float) -> FloatArray:
    """Return the combinations of cross-axis terms (R, 9), unit length, that a design (K, 9) does not show."""
    scaled = design / np.array([gravity] * 6 + [1.0] * 3)
    values, vectors = np.linalg.eigh(scaled.T @ scaled / len(design))
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


def _descend(
    v: FloatArray, root: FloatArray, start: FloatArray, gravity: float, free: IntArray, prior: FloatArray
) -> tuple[FloatArray, bool]:
    """Return the minimum and whether there is one; the start again where the steps run away."""
    p, size = start.copy(), np.array([1.0] * 6 + [gravity] * 3)[free]

    def rows(values: FloatArray) -> Rows:
        p[free] = values
        design, residuals = _linearised(v, p, gravity)
        return Rows(whitened(root, residuals), whitened(root, design[:, free]))

    p[free], _, found = descend(rows, start[free], prior[:, free], tolerance=1e-11, size=size, farthest=30.0, steps=100)
    return p, found


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


def judged(fit: NormFit, reading: FloatArray, unit_in: str, scale_tolerance: float = TOLERANCE) -> TriadFit:
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
        Verdict.of(*_judged(fit, rms_mg, corrected), *quadratic_findings(fit.quadratic, fit.quadratic_sd, fit.gravity)),
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
    check_own_scale(triad.model.scale_factor, unit, "accel", scale_tolerance, "accel")
    return triad


def _judged(fit: NormFit, rms_mg: float, corrected: FloatArray) -> Iterator[Finding]:
    sigma = fit.uncertainty / MG
    yield from above("multi_position.residual", rms_mg, RESIDUAL_MG, rms_mg=rms_mg)
    yield from above("multi_position.uncertainty", sigma, UNCERTAIN_MG, uncertainty_mg=sigma)
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


_UNSEEN = 0.35  # of s_q: with more of it left, the poses do not show the quadratic terms; 18 free poses leave 0.12, 12 leave 0.7


def quadratic_findings(q: FloatArray, sd: FloatArray, gravity: float) -> Iterator[Finding]:
    """Return what is known of quadratic terms (3,) with standard uncertainties, 1/(m/s2)."""
    mg = gravity**2 / MG
    if sd.max() > _UNSEEN * QUADRATIC_SD:
        tilt_deg = float(sd.max()) * gravity / RADIAN_PER_DEGREE
        yield finding("quadratic.unseen", "warn", size_mg=float(sd.max()) * mg, tilt_deg=tilt_deg)
    sure = np.abs(q) > 3.0 * sd
    if sure.any():
        axis = int(np.argmax(np.where(sure, np.abs(q), 0.0)))
        size_mg, uncertainty_mg = q[axis] * mg, 2.0 * sd[axis] * mg
        yield finding("quadratic.fitted", "info", axis=AXES[axis], size_mg=size_mg, uncertainty_mg=uncertainty_mg)
