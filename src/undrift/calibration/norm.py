"""Fit free poses: the corrected reading of each still pose has the length of gravity, for an upper triangular M.

    |M (u - o)| = g + e

The equation is scaled so that every parameter is near one or of the size of g:

    v = k (u - c)          c, k: sphere through the readings
    |M' (v - o')| = g      M = k M',  o = c + o' / k

Gauss-Newton solves this with generalised least squares in each step (fit/gls.py). With n the direction of M' (v - o'):

    dr/dm'_ij = n_i (v - o')_j        dr/do' = -M'^T n

The sources of error are noise of the mean readings, drift with temperature, and an excess variance for poses in which the device
moved. Poses on the faces do not determine cross-axis terms, so each term has a prior, 0 +- sd.

A real sensor adds q y^2 to its reading, where y is the force along its axis and q ~ N(0, s_q^2). The term is a source of
uncertainty. It is not estimated, because a prior for it costs accuracy on a linear sensor. N are the changes of length by q, and G
the gains of the fit. The parameters cannot absorb L = N - X G N, and the residuals r show q with a mean m and a covariance C::

    C = (L' V^-1 L + I / s_q^2)^-1,   m = C L' V^-1 r

V is the covariance of noise, temperature and excess, estimated together with q so that nothing is counted twice. If the residuals
show more than s_q^2, their value replaces it. Therefore p is wrong by b = G N m, with a variance s^2 that contains G N C N' G'. The
interval that holds for 95 % of such errors is |b| + 1.645 s, or 1.96 u with::

    u = (|b| + 1.645 s) / 1.96            u^2 = s^2 + b^2 for b below s
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.plausibility import check_gravity, check_own_scale
from undrift.calibration.sources import Creep, uncertain
from undrift.errors import NotObservable, PoorFit
from undrift.findings import Finding, above, finding, told_apart
from undrift.fit.gls import NORMAL_95, GlsFit, Prior, carried, solve
from undrift.fit.triad import TriadFit, TriadParameters, fit_of, parameter_names, scaled_condition, weakest_parameters
from undrift.model import AXES
from undrift.segments import sphere_of
from undrift.units import STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

ROW, COLUMN = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])  # indices of the six elements, as in p
NAMES = (*(f"m_{AXES[i]}{AXES[j]}" for i, j in zip(ROW, COLUMN, strict=True)), *(f"offset_{axis}" for axis in AXES))
CROSS = np.array([1, 2, 4])  # indices of m_xy, m_xz, m_yz in p
SEEN = np.array([0, 1, 2, 4, 5, 8, 9, 10, 11])  # position of each p among m_xx .. m_zz, offset_x ..
WEAKEST = 0.02  # smallest rms change of length, in g, per unit of a determined parameter (random poses reach 0.25)
KEPT = 0.3  # share of the prior standard deviation above which a cross-axis term is not determined by the poses
QUADRATIC_SD = 2e-4  # s_q, 1/(m/s2): MPU-6050, ICM-20948 and BMI160 state 0.5 % of the range, 2.5e-4 for 2 g
# descent: number of steps, relative step at convergence, parameters at which it diverges
MOST_STEPS, CONVERGED, FARTHEST = 100, 1e-8, 30.0
ONE_SIDED_95 = 1.6448536269514722  # normal quantile
ROUNDING = 1e-9  # smallest deviation of a length, relative to gravity
MG = STANDARD_GRAVITY * 1e-3
RESIDUAL_MG = (3.0, 20.0)  # limits of a verdict: marginal above the first, bad above the second
UNCERTAIN_MG = (2.0, 20.0)
QUADRATIC_TIMES = (2.0, np.inf)  # times s_q


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormFit:
    """Scaled solution of the norm equations."""

    center: FloatArray  # (3,), c, raw unit
    scale: float  # k, m/s2 per raw unit
    p: FloatArray  # (9,), m'_xx m'_xy m'_xz m'_yy m'_yz m'_zz (1), o'_x o'_y o'_z (m/s2)
    budget: Mapping[str, FloatArray]  # covariance (9, 9) of p by source
    residuals: FloatArray  # (K,), length minus gravity, m/s2
    condition: float  # condition number of the design, columns scaled to one
    gravity: float  # m/s2
    prior_sd: float | None  # standard deviation of each cross-axis term before the fit, 1
    quadratic_times: float  # size of the quadratic terms that the residuals show, in s_q

    @property
    def covariance(self) -> FloatArray:
        """Covariance of p, shape (9, 9)."""
        return np.asarray(np.sum([*self.budget.values()], axis=0))

    @property
    def matrix(self) -> FloatArray:
        """M, m/s2 per raw unit, shape (3, 3)."""
        return self.scale * _upper(self.p)

    @property
    def offset(self) -> FloatArray:
        """o, raw unit, shape (3,)."""
        return np.asarray(self.center + self.p[6:] / self.scale)

    @property
    def kept(self) -> tuple[str, ...]:
        """Return True for each cross-axis term that keeps its prior."""
        least = np.inf if self.prior_sd is None else (KEPT * self.prior_sd) ** 2
        return tuple(NAMES[i] for i in CROSS if self.covariance[i, i] > least)

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of a corrected reading of gravity, root mean square over all directions, m/s2."""
        variance = np.diag(self.covariance)
        return float(np.sqrt(self.gravity**2 / 3.0 * variance[:6].sum() + variance[6:].sum()))


def fit_norm(
    reading: FloatArray,
    *,
    gravity: float,
    variances: FloatArray | None = None,
    prior_sd: float | None = None,
    creep: Creep | None = None,
    quadratic_sd: float = 0.0,
) -> NormFit:
    """Fit matrix and offset to mean readings (K, 3) in still poses.

    ``variances`` (K, 3) are the variances of the means. Without them, the residuals determine the noise. ``prior_sd`` is the prior
    standard deviation of the cross-axis terms, if any. ``quadratic_sd`` is s_q, 1/(m/s2). Raise NotObservable if the poses do not
    determine a parameter, and PoorFit if no linear sensor gives these readings.
    """
    center, radius = sphere_of(reading)
    scale = gravity / radius
    v = np.ascontiguousarray(scale * (reading - center))
    noise = np.zeros_like(v) if variances is None else variances * scale**2
    size, precision = np.array([1.0] * 6 + [gravity] * 3), np.zeros(9)
    precision[CROSS] = 0.0 if prior_sd is None else prior_sd**-2
    prior = Prior(mean=np.zeros(9), precision=np.diag(precision))
    p = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    condition = _check_determined(v, p, gravity, with_prior=prior_sd is not None)
    hand = {"repeatability": np.ones(len(v))}
    for _ in range(MOST_STEPS):
        design, residuals = _linearised(v, p, gravity)
        sources = _sources(v, p, design, noise, creep, gravity)
        try:
            fit = solve(design, design @ p - residuals, sources, excess=hand, prior=prior)
        except (np.linalg.LinAlgError, ValueError):  # the descent diverged
            break
        step = np.abs((fit.theta - p) / size).max()
        p = fit.theta
        if step < CONVERGED:
            budget, quadratic_times = _budget(v, p, design, sources, fit, prior, quadratic_sd)
            return NormFit(
                center=center,
                scale=scale,
                p=p,
                budget=budget,
                residuals=_linearised(v, p, gravity)[1],
                condition=condition,
                gravity=gravity,
                prior_sd=prior_sd,
                quadratic_times=quadratic_times,
            )
        if not np.abs(p / size).max() < FARTHEST:
            break
    raise PoorFit(
        f"multi-position: {len(reading)} readings do not have the length {gravity:g} m/s2 for any linear sensor. Check that the "
        f"device was still and that the columns are the accelerometer's",
        poses=len(reading),
    )


def _sources(
    v: FloatArray, p: FloatArray, design: FloatArray, noise: FloatArray, creep: Creep | None, gravity: float
) -> dict[str, FloatArray]:
    """Return the covariance of the lengths by source for a variance ``noise`` (K, 3) of the scaled readings."""
    reading_slopes = -design[:, 6:]  # d length / d reading = M'^T n
    sources = {"noise": (reading_slopes**2 * noise).sum(axis=1) + (ROUNDING * gravity) ** 2}
    if creep is not None:
        drift_columns = np.hstack([reading_slopes[:, [j]] * creep.columns(d) for j, d in enumerate((v - p[6:]).T)])
        sources["temperature"] = drift_columns @ drift_columns.T
    return sources


def _budget(
    v: FloatArray,
    p: FloatArray,
    design: FloatArray,
    sources: Mapping[str, FloatArray],
    fit: GlsFit,
    prior: Prior,
    sd: float,
) -> tuple[dict[str, FloatArray], float]:
    """Return the covariance (9, 9) of p by source, and the size of the quadratic terms in units of ``sd``, their usual size."""
    gain = np.linalg.norm(np.linalg.inv(_upper(p)), axis=1)  # per sensor: v - o' = gain y
    lengths = -sd * design[:, 6:] * (v - p[6:]) ** 2 / gain  # (K, 3): N s_q
    bent = {"nonlinearity": lengths @ lengths.T}
    errors = solve(
        design, fit.residuals, {**sources, **bent}, excess={"repeatability": np.ones(len(v)), **bent}, prior=prior
    )
    rows = {name: covariance for name, covariance in errors.sources.items() if name != "nonlinearity"}
    absorbed = fit.gains @ lengths
    bows = lengths - design @ absorbed
    weighted = np.linalg.solve(np.sum([*rows.values()], axis=0), bows)
    square = 1.0 + errors.excess["nonlinearity"]
    uncertain = np.linalg.inv(bows.T @ weighted + np.eye(3) / square)
    budget = {name: carried(fit.gains, covariance) for name, covariance in rows.items()}
    budget["prior"] = fit.budget["prior"]
    spread, bias = carried(absorbed, uncertain), absorbed @ uncertain @ (weighted.T @ fit.residuals)
    variance = np.diag(np.sum([*budget.values(), spread], axis=0))
    needed = ((np.abs(bias) + ONE_SIDED_95 * np.sqrt(variance)) / NORMAL_95) ** 2 - variance
    known = np.sign(bias) * np.sqrt(np.clip(needed, 0.0, bias**2))
    return {**budget, "nonlinearity": spread + np.outer(known, known)}, float(np.sqrt(square))


def _check_determined(v: FloatArray, p: FloatArray, gravity: float, *, with_prior: bool) -> float:
    """Return the condition number of the design. Raise if a combination of parameters changes no length."""
    size, count = np.array([gravity] * 6 + [1.0] * 3), len(v)
    prior_rows = np.sqrt(count) * size * np.eye(9)[CROSS[: 3 * with_prior]]
    design = np.vstack((_linearised(v, p, gravity)[0], prior_rows))
    weakest, names = weakest_parameters(design / size, count, WEAKEST, NAMES)
    if weakest < WEAKEST:
        raise NotObservable(
            f"multi-position: expected poses that change the length by {WEAKEST:g} g or more per unit of every parameter, got "
            f"{weakest:.2g} for {parameter_names(names)}. {_advice((v - p[6:]) @ _upper(p).T, names)}",
            weakest=weakest,
            parameters=names,
        )
    return scaled_condition(design)[1]


def _upper(p: FloatArray) -> FloatArray:
    matrix = np.zeros((3, 3))
    matrix[ROW, COLUMN] = p[:6]
    return matrix


def _linearised(v: FloatArray, p: FloatArray, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return design (K, 9) and residuals (K,) at p."""
    matrix, d = _upper(p), np.ascontiguousarray((v - p[6:]).T)  # rows of K, the fastest layout in numpy
    a = matrix @ d
    length = np.sqrt((a * a).sum(axis=0))
    n = a / length
    return np.concatenate((n[ROW] * d[COLUMN], -matrix.T @ n)).T, length - gravity


# ---- a solution as a fit with findings


def check_count(reading: FloatArray, wanted: int) -> None:
    """Raise unless there are enough different poses."""
    different = len(np.unique(reading, axis=0))
    if different < wanted:
        raise NotObservable(
            f"multi-position: expected {wanted} still poses or more for {parameter_names(NAMES)}, got {different}. Record more "
            "poses, each with another side, edge or corner up, and keep the device still for two seconds in each.",
            poses=different,
            wanted=wanted,
        )


def judged(fit: NormFit, reading: FloatArray, unit_in: str) -> TriadFit:
    """Return the fit of a triad from a solution, with findings. Raise if the readings cannot be in the declared unit."""
    unit = canonical_unit(unit_in, "accel")
    if is_physical(unit):
        check_gravity(reading * si_factor(unit, "accel"), fit.gravity)
    corrected = (reading - fit.offset) @ fit.matrix.T
    carry = np.zeros((12, 9))  # d (m_xx .. m_zz, offset) / d p
    carry[SEEN, np.arange(9)] = [fit.scale] * 6 + [1.0 / fit.scale] * 3
    parameters = TriadParameters(
        theta=np.append(fit.matrix, fit.offset),
        covariance=carried(carry, fit.covariance),
        parts={name: carried(carry, share) for name, share in fit.budget.items()},
    )
    names = {"method": "multi-position", "unit_in": unit, "unit_out": "m/s2"}
    triad = fit_of(parameters, corrected, fit.residuals, *_judged(fit, corrected), **names)
    check_own_scale(triad.model.scale_factor, unit, "accel", "accel")
    return replace(triad, model=replace(triad.model, rank=9 - len(fit.kept), condition=fit.condition))


def misses_gravity(what: str, rms: float, limits: tuple[float, float], unit: str) -> tuple[Finding, ...]:
    """Return a finding if poses or moves miss gravity by more than the first of two limits, rms."""
    size = told_apart(rms, ".2g", limits[0])
    return above(
        "multi_position.residual",
        rms,
        limits,
        f"{what} miss gravity by {size} {unit} rms (limit {limits[0]:g} {unit}): the device moved, or its sensors are not linear.",
        "Repeat them, turn more slowly and rest longer.",
        rms=rms,
    )


def _judged(fit: NormFit, corrected: FloatArray) -> Iterator[Finding]:
    rms_mg, sigma = float(np.sqrt(np.mean(fit.residuals**2))) / MG, fit.uncertainty / MG
    yield from misses_gravity("Poses", rms_mg, RESIDUAL_MG, "mg")
    times, limit = fit.quadratic_times, QUADRATIC_TIMES[0]
    yield from above(
        "multi_position.nonlinear",
        times,
        QUADRATIC_TIMES,
        f"The accelerometers are {told_apart(times, '.2g', limit)} times less linear than in data sheets (limit {limit:g}).",
        "Check the offset with six faces on a level plate, and keep the device still in each pose.",
    )
    yield from uncertain(
        "Gravity", sigma, UNCERTAIN_MG, "mg", "Record more poses, and keep the device still for longer in each."
    )
    if fit.prior_sd is not None and fit.kept:
        percent = 100.0 * np.sqrt(max(fit.covariance[i, i] for i in CROSS if NAMES[i] in fit.kept))
        what = f"Accelerometer's {parameter_names(fit.kept)}"
        yield finding(
            "session.not_observable",
            "warn",
            f"The poses do not determine the {what[0].lower()}{what[1:]}. 0 +- {100.0 * fit.prior_sd:g} % of the scale was "
            f"assumed, and +- {percent:.2g} % remains (1 sigma).",
            _advice(corrected, fit.kept),
            what=what,
        )


def _advice(corrected: FloatArray, unseen: tuple[str, ...]) -> str:
    n = corrected / np.linalg.norm(corrected, axis=1)[:, None]
    values, vectors = np.linalg.eigh(n.T @ n / len(n))
    if values[0] < 0.02:
        axis = AXES[int(np.abs(vectors[:, 0]).argmax())]
        return f"All poses lie near one plane. Add poses with the {axis} axis up and with the {axis} axis down."
    if set(unseen) <= {NAMES[i] for i in CROSS}:
        return "Add poses between the faces (edges and corners up)."
    return "Add poses on the sides, edges and corners that are missing."
