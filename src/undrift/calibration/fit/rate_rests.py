"""Rate table with rests: offsets that wander during the session, and gyroscopes that feel specific force.

Each axis of the table turns the device another way up, so a gyroscope that feels gravity shows another offset on each, and an
offset that drifts looks much the same. Dwells and rests together tell them apart::

    u = K w + H a + b + walk(t)  21 parameters and a walk (wandering.py); w = 0 at rest, a the corrected specific force
    w = M (u - b) - G a          M = K^-1, G = M H;      dM = -M dK M,   dG = -M dK G + M dH

b is the offset in the middle of the session. The nine parameters of H are kept where they are larger, by their own covariance,
than chance makes them once in a thousand (h' C^-1 h, chi-square of 9 degrees of freedom); without them it is the affine model.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.dwells import DwellMeans
from undrift.calibration.fit.rate_table import RateTableFit, imposed_rates
from undrift.calibration.fit.result import inverse_jacobian, scaled_condition
from undrift.calibration.fit.wandering import Wandering, fit_wandering
from undrift.calibration.model import AXES, G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Status, TriadModel, Verdict
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

CHANCE = 1e-3
# Limits of a verdict: above the first it is marginal, above the second bad.
DOUBT_PERCENT = (0.5, 5.0)  # of scale, 1 sigma: 0.5 % is 2 deg in a full turn; 5 % is no better than most makers' word
WANDER_DPS = (0.1, 2.0)  # in a minute: 0.1 deg/s ends 3 deg off after that minute; no warm-up reaches 2 deg/s
MISS_PERCENT = (
    0.5,
    3.0,
)  # rms, of the largest rate: parts are linear within 0.2 %; 3 % is a false rate or a stuck table
_STAYS = 0.5  # of the walk: what is left of it with an offset for each axis of the table, where it went with the axis
_MINUTE_S = 60.0
_ROUNDING = 1e-9  # of the largest reading: a mean is not known better than the filter's arithmetic, whatever its noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMeans:
    """Readings at rest, and the specific force of rests and dwells.

    Parameters
    ----------
    dwell_force : array, shape (N, 3)
        Mean corrected specific force of each dwell, m/s2, frame b.
    reading : array, shape (P, 3)
        Mean gyroscope reading of each rest, unit of the dwells.
    force : array, shape (P, 3)
        Mean corrected specific force of each rest, m/s2.
    noise : array, shape (P, 3)
        Standard deviation of each mean reading.
    time : array, shape (P,)
        Middle of each rest, s, on the clock of the dwells.
    """

    dwell_force: FloatArray
    reading: FloatArray
    force: FloatArray
    noise: FloatArray
    time: FloatArray


def fit_with_rests(
    fit: RateTableFit, dwells: DwellMeans, rests: RestMeans | None, *, latitude_deg: float | None = None
) -> RateTableFit:
    """Refine an affine fit: let its offset wander, and add a g-sensitivity where dwells and rests show one.

    Parameters
    ----------
    fit : RateTableFit
        Affine fit to the dwells alone.
    dwells : DwellMeans
        What it was fitted to; without noise there is nothing to weigh by, and the fit is returned as it is.
    rests : RestMeans or None
        None leaves the dwells alone, and gravity out.
    latitude_deg : float or None
        As in the settings of the fit.

    Returns
    -------
    RateTableFit
        12 or 21 parameters, residuals of dwells and then rests, and in the verdict what was found.
    """
    if dwells.noise is None:
        return fit
    rates = imposed_rates(dwells, latitude_deg)
    readings, sigma = dwells.reading, np.broadcast_to(dwells.noise, dwells.reading.shape)
    time, forces = dwells.time, None
    if rests is not None:
        rates = np.vstack((rates, np.zeros_like(rests.reading)))
        readings, sigma = np.vstack((readings, rests.reading)), np.vstack((sigma, rests.noise))
        time = None if time is None else np.concatenate((time, rests.time))
        forces = np.vstack((rests.dwell_force, rests.force))
    sigma = np.maximum(sigma, _ROUNDING * np.abs(readings).max(axis=0))
    if forces is not None:
        full = np.column_stack((rates, forces, np.ones(len(rates))))
        if scaled_condition(full)[0] == 7:
            felt = [fit_wandering(full, readings[:, k], sigma[:, k], time) for k in range(3)]
            if _feels_force(felt, readings.size - 21):
                return _refined(fit, full, readings, felt)
    plain = np.column_stack((rates, np.ones(len(rates))))
    found = [fit_wandering(plain, readings[:, k], sigma[:, k], time) for k in range(3)]
    by_axis = _by_axis(dwells, rates, sigma) if forces is None and any(one.walk > 0.0 for one in found) else None
    return _refined(fit, plain, readings, found, by_axis)


def _by_axis(dwells: DwellMeans, rates: FloatArray, sigma: FloatArray) -> list[Wandering] | None:
    """Solve with an offset of its own for each axis of the table, parameters 4 to 6, and a trend.

    None where it cannot be told, or where the trend within the axes makes half of what differs between them.
    """
    if dwells.time is None:
        return None
    own = (np.array(dwells.axis)[:, None] == np.array(AXES)[None, :]).astype(float)
    away = dwells.time - dwells.time.mean()
    design = np.column_stack((rates, own, away))
    if scaled_condition(design)[0] < 7:
        return None
    solved = [fit_wandering(design, dwells.reading[:, k], sigma[:, k], dwells.time) for k in range(3)]
    trend = np.array([one.theta[6] for one in solved]) * float(np.ptp(away @ own / own.sum(axis=0)))
    apart = np.array([np.ptp(one.theta[3:6]) for one in solved])
    return None if (np.abs(trend) > _STAYS * apart)[np.argmax(apart)] else solved


def _feels_force(felt: list[Wandering], spare: int) -> bool:
    size = sum(float(one.theta[3:6] @ np.linalg.solve(one.covariance[3:6, 3:6], one.theta[3:6])) for one in felt)
    return size > _chance(9) * _excess(felt, spare)


def _excess(found: list[Wandering], spare: int) -> float:
    # Variance of the residuals over that of the noise; 1 where chance explains it.
    square = sum(one.square for one in found)
    return square / spare if spare > 0 and square > _chance(spare) else 1.0


def _refined(
    fit: RateTableFit,
    design: FloatArray,
    readings: FloatArray,
    found: list[Wandering],
    by_axis: list[Wandering] | None = None,
) -> RateTableFit:
    theta = np.array([one.theta for one in found])
    residuals = (readings - design @ theta.T) @ np.linalg.inv(theta[:, :3]).T
    rank, condition = scaled_condition(design)
    widen = _excess(found, readings.size - theta.size)
    covariance = [one.covariance * widen for one in found]
    model = replace(
        _model(fit.model, theta, covariance),
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=readings.size,
        rank=3 * rank,
        condition=condition,
    )
    verdict = fit.verdict.also(_judged(model, (found, by_axis), widen, float(np.abs(fit.turn_rate).max())))
    return replace(fit, model=model, residuals=residuals, verdict=verdict)


def _judged(
    model: TriadModel, solved: tuple[list[Wandering], list[Wandering] | None], widen: float, largest: float
) -> Verdict:
    said, marks = [], []
    found, by_axis = solved
    if model.g_sensitivity is not None:
        felt = float(np.abs(model.g_sensitivity).max()) * STANDARD_GRAVITY / RADIAN_PER_DEGREE
        said.append(
            f"the gyroscopes feel gravity, by up to {felt:.2g} (deg/s)/g: fitted from dwells and rests, and taken off by the "
            "corrected specific force"
        )
    moved, why = _moved(model, found, by_axis)
    if why:
        marks.append(_mark(moved, WANDER_DPS))
        said.append(why)
    misses = 100.0 * model.rms_residual / largest
    marks.append(_mark(misses, MISS_PERCENT))
    if widen > 1.0 or misses > MISS_PERCENT[0]:
        said.append(
            f"the readings scatter {widen**0.5:.1f} times as much about the model as their noise explains, and miss it by "
            f"{misses:.2g} % of the largest rate{_wanted(misses, MISS_PERCENT, ' %', ' (', ')')} (vibration, non-linearity, or a "
            "table that turns unevenly): the uncertainty is widened by that"
        )
    sigma = model.standard_uncertainty[:9].reshape(3, 3)
    doubt = 100.0 * float((sigma @ np.abs(model.forward_matrix)).max())
    marks.append(_mark(doubt, DOUBT_PERCENT))
    if doubt > DOUBT_PERCENT[0]:
        said.append(
            f"an element of the gyroscope matrix is uncertain by {doubt:.2g} % (wanted {DOUBT_PERCENT[0]:g}): turn at more rates, "
            "dwell longer, and look at the residual of each dwell"
        )
    return Verdict(status=max(marks, key=("good", "marginal", "bad").index, default="good"), reasons=tuple(said))


def _moved(model: TriadModel, found: list[Wandering], by_axis: list[Wandering] | None) -> tuple[float, str]:
    """Return how far the offset moved, deg/s, and whether with time or with the axis of the table; nothing where it stayed."""
    gain = float(np.linalg.norm(model.matrix, 2)) / RADIAN_PER_DEGREE
    walk, within = (gain * max(one.walk for one in part) for part in (found, by_axis or found))
    wander = walk * _MINUTE_S**0.5
    if walk == 0.0:
        return 0.0, ""
    if by_axis is None or within > _STAYS * walk:
        return wander, (
            f"the offset wandered during the session, by {wander:.2g} deg/s in a minute "
            f"(1 sigma{_wanted(wander, WANDER_DPS, '')}): "
            "it holds for the middle of the session; warm the device up before, and bracket the dwells with rests"
        )
    offsets = np.array([one.theta[3:6] for one in by_axis])  # sensor, axis of the table
    apart = float(np.ptp(model.matrix @ offsets, axis=1).max()) / RADIAN_PER_DEGREE
    return apart, (
        f"the offset differs between the axes of the table by up to {apart:.2g} deg/s"
        f"{_wanted(apart, WANDER_DPS, '', ' (', ')')} and hardly moves while one of them turns, as it does where gyroscopes feel "
        "gravity: it is a mean over these poses; rest on six faces in the same session, which tells the g-sensitivity apart"
    )


def _mark(value: float, limits: tuple[float, float]) -> Status:
    return "bad" if value > limits[1] else "marginal" if value > limits[0] else "good"


def _wanted(value: float, limits: tuple[float, float], unit: str, before: str = "; ", after: str = "") -> str:
    return f"{before}wanted {limits[0]:g}{unit}{after}" if value > limits[0] else ""


def _chance(degrees_of_freedom: int) -> float:
    from scipy.special import chdtri

    return float(chdtri(degrees_of_freedom, CHANCE))


def _model(plain: TriadModel, theta: FloatArray, own: list[FloatArray]) -> TriadModel:
    """Return the inverse model of forward rows (K_k, H_k, b_k) or (K_k, b_k)."""
    gravity = theta.shape[1] == 7
    matrix, offset = np.linalg.inv(theta[:, :3]), theta[:, -1]
    size = 21 if gravity else 12
    covariance = np.zeros((size, size))  # of K row by row, b, H row by row
    for k in range(3):
        felt = [12 + 3 * k, 13 + 3 * k, 14 + 3 * k] if gravity else []
        places = np.array([3 * k, 3 * k + 1, 3 * k + 2, *felt, 9 + k])
        covariance[np.ix_(places, places)] = own[k]
    jacobian = np.eye(size)
    jacobian[:9, :9] = inverse_jacobian(matrix)
    names, g = (*MATRIX_NAMES, *OFFSET_NAMES), None
    if gravity:
        g = matrix @ theta[:, 3:6]
        jacobian[12:, :9] = -np.kron(matrix, g.T)
        jacobian[12:, 12:] = np.kron(matrix, np.eye(3))
        names = (*names, *G_NAMES)
    return replace(
        plain,
        matrix=matrix,
        offset=offset,
        g_sensitivity=g,
        parameters=names,
        covariance=jacobian @ covariance @ jacobian.T,
    )
