"""Rate table: gyroscopes against imposed steady rates, each axis up in turn, both signs (eqs. 4-6 of the note).

    paper      C = L S^T (S S^T)^-1            L (3, N) achieved rates, S (3, N) mean readings; offset already removed
    affine     s = K w + b                     12 parameters by least squares
    rests      u = K w + H a + b + walk(t)     with g-sensitivity and an offset that drifts; w = 0 at rest, a specific force

L holds the rates that the table achieved, never the nominal ones: at 40,000 counts a turn the note's 0.1 deg/s is 0.099. The
Earth's rotation adds its vertical part, Omega sin(latitude), to the axis that points up; the horizontal part averages out
over whole turns. Which rates: rig/programme.py.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.adc import limited_by_codes
from undrift.calibration.checks import axis_vectors, check_axis_order, check_own_scale
from undrift.calibration.creep import WARM_UP, creep_of
from undrift.calibration.dwells import (
    SHOWS,
    DwellMeans,
    Dwells,
    Linearity,
    dwell_means,
    imposed_rates,
    linearity,
    mountings,
    table_axes,
    table_errors,
    table_findings,
    with_errors,
)
from undrift.calibration.observe import Observed, Outcome, middles, with_offset
from undrift.calibration.six_face import SixFaceFit
from undrift.errors import Implausible, InputError, NotObservable
from undrift.findings import Finding, Level, above, finding
from undrift.fit.equations import Equations, Inverse, WalkFit, carried_own, diagonal, fit_with_walks, joined
from undrift.fit.least_squares import (
    ForwardFit,
    TriadFit,
    block_size,
    fit_forward,
    fit_paper,
    noise_of_means,
    offset_verdict,
    scaled_condition,
    student_variance,
    triad_from_forward,
)
from undrift.model import AXES, TriadModel, Verdict, level_of
from undrift.record import Axis, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

# ---- fit of the dwells

# A part that is trimmed in the factory is within 1 to 3 % of its sensitivity; no datasheet allows more.
OWN_SCALE = 0.05

RateTableMode = Literal["paper", "affine"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateTableFit(TriadFit):
    """Gyroscopes fitted to a rate table; ``residuals`` are corrected less imposed rate, rad/s, one row a dwell."""

    turn_rate: FloatArray  # (N,), achieved rate of each dwell, rad/s
    linearity: tuple[Linearity, ...]  # Own-axis table, nonlinearity and asymmetry of each axis


def fit_rate_table(
    dwells: DwellMeans,
    *,
    mode: RateTableMode = "affine",
    latitude_deg: float | None = None,
    scale_tolerance: float = 0.25,
) -> RateTableFit:
    """Fit gyroscopes to the dwells of a rate table; its latitude adds the Earth's rate to a vertical axis."""
    lacking = [axis for axis in AXES if axis not in dwells.axis]
    if lacking:
        raise NotObservable(
            f"rate table: wanted dwells about x, y and z, got none about {', '.join(lacking)}; mount the device with "
            f"{', '.join(lacking)} along the table's axis",
            missing=tuple(lacking),
        )
    rates = imposed_rates(dwells, latitude_deg)
    verdict, names = Verdict(), {"method": f"rate-table/{mode}", "unit_in": dwells.unit, "unit_out": "rad/s"}
    if mode == "paper":
        fit = fit_paper(rates, dwells.reading, dwells.noise, None, **names)
        verdict = offset_verdict(fit, rates, dwells.reading, dwells.noise)
    else:
        span = (float(rates.min()), float(rates.max()))
        fit = triad_from_forward(fit_forward(rates, dwells.reading, dwells.noise), valid_range=span, **names)
    check_axis_order(fit.model.forward_matrix, "rate table", against="turns")
    check_own_scale(fit.model.scale_factor, dwells.unit, "rate", scale_tolerance, "gyroscope")
    rows = [np.array(dwells.axis) == axis for axis in AXES]
    return RateTableFit(
        model=with_errors(fit.model, table_errors(fit.model, dwells)),
        residuals=fit.residuals,
        verdict=verdict,
        turn_rate=dwells.turn_rate,
        linearity=tuple(linearity(dwells.reading[rows[k], k], dwells.turn_rate[rows[k]], AXES[k]) for k in range(3)),
    )


def scale_verdict(scale_factor: FloatArray, unit: str, axes: str = "xyz") -> Verdict:
    """Return marginal where a scale factor (K,) is further from the unit's own than any datasheet allows, bad at twice that."""
    if not is_physical(unit):
        return Verdict()
    ratio = np.asarray(scale_factor) * si_factor(unit, "rate")
    worst = int(np.abs(ratio - 1.0).argmax())
    off = float(ratio[worst] - 1.0)
    if abs(off) <= OWN_SCALE:
        return Verdict()
    level = level_of(abs(off), (OWN_SCALE, 2.0 * OWN_SCALE))
    return Verdict.of(finding("gyro.scale_factor", level, axis=axes[worst], off_percent=100.0 * off))


# ---- dwells and rests together: offsets that drift during the session, and g-sensitivity
#
# Each axis of the table turns the device another way up, so a gyroscope with g-sensitivity shows another offset on each, and an
# offset that drifts looks much the same. Dwells and rests together separate them:
#
#     u = K w + H a + b + walk(t)  21 parameters and a walk (fit/least_squares.py); w = 0 at rest, a the corrected specific force
#     w = M (u - b) - G a          M = K^-1, G = M H;      dM = -M dK M,   dG = -M dK G + M dH
#
# b is the offset in the middle of the session. The nine parameters of H are kept where they are larger, by their own covariance,
# than chance makes them once in a thousand (h' C^-1 h, chi-square of 9 degrees of freedom); without them it is the affine model.

CHANCE = 1e-3
# Limits of a verdict, above the first it is marginal, above the second bad:
# of scale, 1 sigma: 0.5 % is 2 deg in a full turn; 5 % is no better than most datasheets;
# in a minute: 0.1 deg/s ends 3 deg off after that minute; no warm-up reaches 2 deg/s;
# rms, of the largest rate: parts are linear within 0.2 %; 3 % is a false rate or a stuck table
UNCERTAIN_PERCENT, DRIFT_DPS, RESIDUAL_PERCENT = (0.5, 5.0), (0.1, 2.0), (0.5, 3.0)
_STAYS = 0.5  # of the walk: what is left of it with an offset for each axis of the table, where it went with the axis
_MINUTE_S = 60.0
_ROUNDING = 1e-9  # of the largest reading: a mean is not known better than the filter's arithmetic, whatever its noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMeans:
    """Readings at rest, and the specific force of rests and dwells, by accelerometers or along the stated faces."""

    dwell_force: FloatArray  # (N, 3), mean corrected specific force of each dwell, m/s2, frame b
    reading: FloatArray  # (P, 3), mean gyroscope reading of each rest, unit of the dwells
    force: FloatArray  # (P, 3), mean corrected specific force of each rest, m/s2
    noise: FloatArray  # (P, 3), standard deviation of each mean reading
    time: FloatArray  # (P,), middle of each rest, s, on the clock of the dwells
    felt: bool = True  # False without accelerometers: a g-sensitivity is then fitted, but cannot be corrected


def fit_with_rests(
    fit: RateTableFit, dwells: DwellMeans, rests: RestMeans | None, *, latitude_deg: float | None = None
) -> RateTableFit:
    """Refine an affine fit: let its offset drift, and add a g-sensitivity where dwells and rests show one."""
    if dwells.noise is None:
        return fit
    rates = imposed_rates(dwells, latitude_deg)
    plain, full, readings = _unknowns(dwells, rates, rests)
    sigma, time = _with_scatter(dwells, rates), dwells.time
    if rests is not None:
        sigma = np.vstack((sigma, rests.noise))
        time = None if time is None else np.concatenate((time, rests.time))
    sigma = np.maximum(sigma, _ROUNDING * np.abs(readings).max(axis=0))
    if full is not None:
        walks = _walks(np.hstack([*full.values()]), readings, sigma, time)
        size = sum(float(f.theta[4:] @ np.linalg.solve(f.covariance[4:, 4:], f.theta[4:])) for f in walks)
        if size > _chance(9) * _excess(walks, readings.size - 21):
            refined = _refined(fit, dwells, full, readings, walks, sigma)
            return refined if rests is None or rests.felt else _without_g(refined)
    walks, by_axis = _walks(np.hstack([*plain.values()]), readings, sigma, time), None
    if full is None and (rests is None or not rests.felt) and any(one.walk > 0.0 for one in walks):
        by_axis = _by_axis(dwells, rates, sigma[: len(rates)])
    return _refined(fit, dwells, plain, readings, walks, sigma, by_axis)


def _sources(dwells: DwellMeans, fitted: FloatArray, sigma: FloatArray) -> dict[str, FloatArray]:
    """Return the sources (3, E, E) of what sigma (E, 3) says of the rows, whose fitted readings are (E, 3); the walk is not in it.

    Means at one place between two codes err alike: apart by a share d of a step, d in [0, 1), errors of rounding correlate by
    1 - 6 d + 6 d^2. Dwells scatter more than noise by an uneven rate about their own axis, and across it by the table's wobble.
    """
    count = len(dwells.reading)
    own = np.array(dwells.axis)[:, None] == np.array(AXES)[None, :]
    excess, along = np.zeros_like(sigma), np.vstack((own, np.zeros((len(sigma) - count, 3), bool)))
    excess[:count] = np.maximum(sigma[:count] ** 2 - np.broadcast_to(np.asarray(dwells.noise), own.shape) ** 2, 0.0)
    rounded = dwells.codes > 0.0
    place = fitted / np.where(rounded, dwells.step, 1.0)
    apart = (place.T[:, :, None] - place.T[:, None, :]) % 1.0
    variance = np.where(rounded, dwells.codes, 0.0)
    return {
        "noise": diagonal(np.maximum(sigma**2 - excess - variance, 0.0)),
        "adc": variance[:, None, None] * (1.0 - 6.0 * apart * (1.0 - apart)),
        "ripple": diagonal(np.where(along, excess, 0.0)),
        "mounting": diagonal(np.where(along, 0.0, excess)),
    }


def _with_scatter(dwells: DwellMeans, rates: FloatArray) -> FloatArray:
    """Return the standard deviation (N, 3) of each mean: noise, and what grows with the rate, wobble or uneven rates.

    A wobble of the axis moves what sensors across it read by (K_kk w)^2 omega^2, an uneven rate its own sensor by (K_kk w)^2 rho^2.
    Both come from the residuals of a fit with an offset for each axis, where they show, and are not less than known of a dwell.
    """
    noise = np.broadcast_to(np.asarray(dwells.noise), dwells.reading.shape)
    if dwells.axes is None:
        return noise
    about = np.array(dwells.axis)[:, None] == np.array(AXES)[None, :]
    design = np.column_stack((rates, about))
    theta = np.linalg.lstsq(design, dwells.reading, rcond=None)[0]
    square = (dwells.reading - design @ theta) ** 2
    drive = (np.abs(np.diag(theta[:3])) * np.abs(dwells.turn_rate)[:, None]) ** 2  # (N, 3), (K_kk w)^2
    variance = noise**2
    for which in (about, ~about):
        share = np.maximum(dwells.axes.apart, _share(drive[which], square[which], square[~which]))
        variance = variance + np.where(which, drive * share, 0.0)
    return np.asarray(np.sqrt(variance))


def _share(drive: FloatArray, square: FloatArray, others: FloatArray) -> float:
    """Return the share of ``drive`` in squared residuals (E,), 0 where it does not show.

    It shows where they grow with it, or where they exceed those of the other sensors, which the same drift of offsets moves.
    The squares of normal residuals scatter by root two of their mean.
    """
    root_two, shares = 2.0**0.5, [0.0]
    more = float(square.mean() - others.mean())
    error = root_two * np.hypot(square.mean() / len(square) ** 0.5, others.mean() / len(others) ** 0.5)
    if more > SHOWS * error:
        shares.append(more / float(drive.mean()))
    design = np.column_stack((drive, np.ones_like(drive)))
    if scaled_condition(design)[0] == 2:
        mean = np.full_like(square, square.mean())
        for _ in range(3):  # the weights follow the fitted mean
            weighted = design / mean[:, None]
            slope, floor = np.linalg.lstsq(weighted, square / mean, rcond=None)[0]
            spread = root_two * float(np.linalg.inv(weighted.T @ weighted)[0, 0]) ** 0.5
            mean = np.maximum(slope * drive + floor, 0.1 * square.mean())
        shares.append(float(slope) if slope > SHOWS * spread else 0.0)
    return max(shares)


def _unknowns(
    dwells: DwellMeans, rates: FloatArray, rests: RestMeans | None
) -> tuple[dict[str, FloatArray], dict[str, FloatArray] | None, FloatArray]:
    """Return what multiplies K and b in dwells, then rests, the same with H, and the readings; no H where w and a do not differ."""
    if rests is None:
        return {"matrix": rates, "offset": np.ones((len(rates), 1))}, None, dwells.reading
    rates = np.vstack((rates, np.zeros_like(rests.reading)))
    plain = {"matrix": rates, "offset": np.ones((len(rates), 1))}
    full = {**plain, "g": np.vstack((rests.dwell_force, rests.force))}
    seen = scaled_condition(np.hstack([*full.values()]))[0] == 7
    return plain, full if seen else None, np.vstack((dwells.reading, rests.reading))


def _walks(design: FloatArray, readings: FloatArray, sigma: FloatArray, time: FloatArray | None) -> list[WalkFit]:
    gain = np.linalg.norm(np.linalg.lstsq(design, readings, rcond=None)[0][:3], axis=0)  # reading per rad/s
    return fit_with_walks(design, readings, sigma, time, WARM_UP * gain)


def _without_g(fit: RateTableFit) -> RateTableFit:
    """Return a fit without its g-sensitivity, which moves the offset from pose to pose where no accelerometer corrects it."""
    model = fit.model
    g = np.zeros((3, 3)) if model.g_sensitivity is None else model.g_sensitivity
    apart = float(np.ptp(g, axis=1).max()) * STANDARD_GRAVITY / RADIAN_PER_DEGREE
    findings = [one for one in fit.verdict.findings if one.code != "rate_table.g_sensitivity"]
    level = level_of(apart, DRIFT_DPS)
    moved = finding("rate_table.axis_offset", level, offset_dps=apart, **_against(level, DRIFT_DPS))
    kept_of = None if model.budget is None else replace(model.budget, uncertainty=model.budget.uncertainty[:, :12])
    plain = replace(
        model,
        g_sensitivity=None,
        parameters=model.parameters[:12],
        covariance=model.covariance[:12, :12],
        budget=kept_of,
    )
    return replace(fit, model=plain, verdict=Verdict.of(*findings, moved))


def _by_axis(dwells: DwellMeans, rates: FloatArray, sigma: FloatArray) -> list[WalkFit] | None:
    """Fit an offset for each axis of the table, parameters 4 to 6, and a trend; None where time explains the offsets."""
    if dwells.time is None:
        return None
    time = dwells.time
    about = (np.array(dwells.axis)[:, None] == np.array(AXES)[None, :]).astype(float)
    away = time - time.mean()
    design = np.column_stack((rates, about, away))
    if scaled_condition(design)[0] < 7:
        return None
    solved = _walks(design, dwells.reading, sigma, time)
    trend = np.array([one.theta[6] for one in solved]) * float(np.ptp(away @ about / about.sum(axis=0)))
    apart = np.array([np.ptp(one.theta[3:6]) for one in solved])
    return None if (np.abs(trend) > _STAYS * apart)[np.argmax(apart)] else solved


def _excess(walks: list[WalkFit], spare: int) -> float:
    # Variance of the residuals over that of the noise; 1 where chance explains it.
    square = sum(one.square for one in walks)
    return square / spare if spare > 0 and square > _chance(spare) else 1.0


def _refined(
    fit: RateTableFit,
    dwells: DwellMeans,
    unknowns: dict[str, FloatArray],
    readings: FloatArray,
    walks: list[WalkFit],
    sigma: FloatArray,
    by_axis: list[WalkFit] | None = None,
) -> RateTableFit:
    theta, design = np.array([one.theta for one in walks]), np.hstack([*unknowns.values()])
    inverse, fitted = Inverse.of(theta), design @ theta.T
    equations = Equations(unknowns=unknowns, reading=readings, own=_sources(dwells, fitted, sigma))
    gains = equations.gains(diagonal(sigma**2))
    widen = _excess(walks, readings.size - theta.size)
    codes = equations.own["adc"]  # their variance is in sigma; what they leave in common is not
    in_common = np.where(np.eye(len(design), dtype=bool), 0.0, codes)
    covariance = joined([one.covariance for one in walks]) + carried_own(gains, in_common)
    residuals = (readings - fitted) @ inverse.matrix.T
    rank, condition = scaled_condition(design)
    model = replace(
        fit.model,
        matrix=inverse.matrix,
        offset=inverse.offset,
        g_sensitivity=inverse.g_sensitivity,
        parameters=inverse.parameters,
        covariance=inverse.carried(widen * covariance),
        budget=None,
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=readings.size,
        rank=3 * rank,
        condition=condition,
    )
    errors = table_errors(model, dwells, sigma[: len(dwells.axis)])
    model = with_errors(model, errors)
    more = [("repeatability", inverse.carried((widen - 1.0) * covariance)), *errors.items()]
    model = replace(model, budget=equations.budget(inverse, model.covariance, "instability", gains=gains, more=more))
    residual = 100.0 * model.rms_residual / float(np.abs(fit.turn_rate).max())
    verdict = fit.verdict.also(Verdict.of(*_judged(dwells, model, walks, by_axis, widen, residual)))
    return replace(fit, model=model, residuals=residuals, verdict=verdict)


def _judged(
    dwells: DwellMeans,
    model: TriadModel,
    walks: list[WalkFit],
    by_axis: list[WalkFit] | None,
    widen: float,
    residual: float,
) -> Iterator[Finding]:
    if model.g_sensitivity is not None:
        size = float(np.abs(model.g_sensitivity).max()) * STANDARD_GRAVITY / RADIAN_PER_DEGREE
        yield finding("rate_table.g_sensitivity", "info", dps_per_g=size)
    gain = float(np.linalg.norm(model.matrix, 2)) / RADIAN_PER_DEGREE
    walk, within = (gain * max(one.walk for one in part) for part in (walks, by_axis or walks))
    if walk > 0.0 and (by_axis is None or within > _STAYS * walk):
        dps = walk * _MINUTE_S**0.5
        level = level_of(dps, DRIFT_DPS)
        yield finding("rate_table.drift", level, dps_per_minute=dps, **_against(level, DRIFT_DPS))
    elif walk > 0.0 and by_axis is not None:
        offsets = np.array([one.theta[3:6] for one in by_axis])  # sensor, axis of the table
        apart = float(np.ptp(model.matrix @ offsets, axis=1).max()) / RADIAN_PER_DEGREE
        level = level_of(apart, DRIFT_DPS)
        yield finding("rate_table.axis_offset", level, offset_dps=apart, **_against(level, DRIFT_DPS))
    settling = max(walks, key=lambda one: one.warm_up)
    if settling.warm_up > 0.5:
        yield finding("gyro.warm_up", "info", time_constant_s=settling.settles_s)
    if widen > 1.0 or residual > RESIDUAL_PERCENT[0]:
        level, shown = level_of(residual, RESIDUAL_PERCENT), {"ratio": widen**0.5, "residual_percent": residual}
        yield finding("rate_table.scatter", level, **shown, **_against(level, RESIDUAL_PERCENT))
    yield from limited_by_codes("gyroscope", dwells.codes, np.diag(model.covariance)[9:12], dwells.unit)
    uncertain = 100.0 * model.relative_uncertainty
    if dwells.axes is not None:
        yield from table_findings(dwells.axes, dwells.mount_tilt)
    yield from above("rate_table.uncertainty", uncertain, UNCERTAIN_PERCENT, uncertainty_percent=uncertain)


def _against(level: Level, limits: tuple[float, float]) -> dict[str, float | str]:
    return {"wanted": limits[0], "against": "within" if level == "info" else "wanted"}


def _chance(degrees_of_freedom: int) -> float:
    from scipy.special import chdtri

    return float(chdtri(degrees_of_freedom, CHANCE))


# ---- false dwells: a rate stated with a wrong sign, value or axis
#
# One such dwell moves a least-squares fit, and an offset that may drift follows it. So before either, each sensor is fitted by
# least absolute deviations, which a few false dwells do not move:
#
#     (K, b) = argmin sum_i |s_i - K w_i - b|        e_i = K^-1 (s_i - b) - w_i, rad/s; with rests, + H a_i beside b
#
# A dwell is refused where |e_i| is beyond both limits: 8 times the typical |e|, the median over the dwells less one for every
# parameter that the fit makes exact; and 0.5 % of the largest rate, which the curvature of a sound sensor stays below.

SCATTERS = 8.0  # times the typical error: beyond any tail that noise, wobble or drift makes of a few tens of dwells
SHARE = 0.005  # of the largest rate
_LEAST_SPARE = 4  # equations beyond the four parameters of a sensor; with fewer, a false dwell does not stand out
_ROUNDS = 60


def check_dwells(
    dwells: DwellMeans, rates: FloatArray, *, rests: RestMeans | None = None, numbers: tuple[int, ...] | None = None
) -> None:
    """Raise when the reading of a dwell contradicts all the others; rates (N, 3), rad/s."""
    plain, full, reading = _unknowns(dwells, rates, rests)
    chosen = plain if full is None or len(reading) - 7 < _LEAST_SPARE else full
    design = np.hstack([*chosen.values()])
    spare = len(design) - design.shape[1]
    if spare < _LEAST_SPARE or np.linalg.matrix_rank(design) < design.shape[1]:
        return
    theta = np.array([_least_deviations(design, column) for column in reading.T])
    if abs(np.linalg.det(theta[:, :3])) < 1e-6 * np.prod(np.linalg.norm(theta[:, :3], axis=1)):
        return  # two columns that read the same; the fit itself reports it
    away = (reading - design @ theta.T) @ np.linalg.inv(theta[:, :3]).T
    error = np.linalg.norm(away, axis=1)
    typical = float(np.median(np.sort(error)[design.shape[1] :]))
    size = np.linalg.norm(rates, axis=1)
    # a table that wobbles errs with its rate
    with_rate = np.median(error[: len(rates)] / np.maximum(size, 1e-300)) * size
    limits = np.maximum(SCATTERS * np.maximum(typical, with_rate), SHARE * float(np.abs(rates).max()))
    wrong = np.flatnonzero(error[: len(rates)] > limits)
    if len(wrong):
        numbers = tuple(range(1, len(rates) + 1)) if numbers is None else numbers
        named = "; ".join(_named(dwells, rates[k] + away[k], k, numbers[k]) for k in wrong[:3])
        more = f"; and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        raise Implausible(
            f"rate table: wanted dwells that agree within {limits[wrong[0]] / RADIAN_PER_DEGREE:.2g} deg/s, "
            f"got {named}{more}; check its sign, value, axis and times, or leave it out",
            turns=tuple(numbers[k] for k in wrong),
        )


def _named(dwells: DwellMeans, read: FloatArray, k: int, number: int) -> str:
    stated = dwells.turn_rate[k] / RADIAN_PER_DEGREE
    own = AXES.index(dwells.axis[k])
    most = int(np.abs(read).argmax())
    about = "" if most == own or abs(read[most]) < 2.0 * abs(read[own]) else f" about {AXES[most]}"
    value = read[most if about else own] / RADIAN_PER_DEGREE
    return f"turn {number}, {dwells.axis[k]} at {stated:+.4g} deg/s: reads as {value:+.4g}{about}"


def _least_deviations(design: FloatArray, reading: FloatArray) -> FloatArray:
    # Iteratively reweighted least squares; the floor shrinks until the deviations that remain are the false ones.
    theta: FloatArray = np.linalg.lstsq(design, reading, rcond=None)[0]
    for step in range(_ROUNDS):
        away = np.abs(reading - design @ theta)
        floor = max(float(np.median(away)) * 0.9**step, 1e-12 * float(np.abs(reading).max()), 1e-300)
        root = 1.0 / np.sqrt(np.maximum(away, floor))
        theta = np.linalg.lstsq(design * root[:, None], reading * root, rcond=None)[0]
    return theta


# ---- turns of a rate table about one or two axes: their columns of K are fitted, the others keep the nominal scale
#
#     s = K_t w_t + b          K_t the columns of the turned axes, with their covariance
#     K_j = S e_j              S the unit's own scale, +- 3 %; of counts the mean scale of the turned axes, +- 20 %
#
# Cross-axis terms of the other columns are 0 +- the stated prior, of the scale.


NOMINAL_SD = {
    True: 0.03,
    False: 0.2,
}  # of a scale that was not measured: physical unit (trimmed in the factory), counts
_MORE = 2  # dwells beyond the parameters of a sensor, for a scatter of their own


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateAxisFit:
    """What turns about one axis alone determine: one column of the forward matrix, and the offsets."""

    axis: Axis  # Axis of the turns
    # (3,), reading of each sensor per rad/s about the axis: scale factor on the axis, cross-axis sensitivity off it
    column: FloatArray
    offset: FloatArray  # (3,), reading of each sensor at zero rate
    covariance: FloatArray  # (6, 6), of column, then offset
    residuals: FloatArray  # (N, 3), reading less model
    linearity: Linearity  # Own-axis table
    unit_in: str  # Unit of the readings
    verdict: Verdict

    @property
    def scale_factor(self) -> float:
        """Reading of the axis' own sensor per rad/s."""
        return float(self.column[AXES.index(self.axis)])


def fit_turned_axes(
    dwells: DwellMeans,
    *,
    latitude_deg: float | None = None,
    scale_tolerance: float = 0.25,
    cross_axis_prior: float = 0.01,
) -> TriadFit:
    """Fit the gyroscopes to turns about one or two axes; what these do not show keeps its nominal value, with its uncertainty."""
    shown = fit_rate_axes(dwells, latitude_deg=latitude_deg, scale_tolerance=scale_tolerance)
    axes = tuple(fit.axis for fit in shown)
    turned = [AXES.index(axis) for axis in axes]
    dwells, whole = _only(dwells, [k for k, axis in enumerate(dwells.axis) if axis in axes]), dwells
    rates = imposed_rates(dwells, latitude_deg)
    design = np.column_stack((rates[:, turned], np.ones(len(rates))))
    if not shown:
        raise NotObservable(
            "rate table: wanted dwells at two different rates about an axis, got one; record both signs"
        )
    theta = np.linalg.lstsq(design, dwells.reading, rcond=None)[0]
    residuals = dwells.reading - design @ theta
    inverse, spare = np.linalg.inv(design.T @ design), len(design) - design.shape[1]
    variance = np.full(3, np.nan) if dwells.noise is None else (dwells.noise**2).mean(axis=0)
    if spare > _MORE:
        variance = np.fmax(variance, [student_variance(column, spare) for column in residuals.T])
    physical = is_physical(dwells.unit)
    nominal = 1.0 / si_factor(dwells.unit, "rate") if physical else float(np.mean([fit.scale_factor for fit in shown]))
    forward, covariance = nominal * np.eye(3), np.zeros((12, 12))
    forward[:, turned] = theta[:-1].T
    for row in range(3):
        places = [3 * row + axis for axis in turned] + [9 + row]
        covariance[np.ix_(places, places)] = variance[row] * inverse
        for axis in {0, 1, 2} - set(turned):
            share = NOMINAL_SD[physical] if axis == row else cross_axis_prior
            covariance[3 * row + axis, 3 * row + axis] = (nominal * share) ** 2
    rank, condition = scaled_condition(design)
    prior = _nominal_kept(axes, cross_axis_prior, physical=physical)
    fit = triad_from_forward(
        ForwardFit(
            inputs=rates,
            matrix=forward,
            offset=theta[-1],
            covariance=covariance,
            residuals=residuals,
            rank=3 * rank,
            condition=condition,
        ),
        valid_range=(float(rates.min()), float(rates.max())),
        method="rate-table/affine",
        unit_in=dwells.unit,
        unit_out="rad/s",
    )
    uneven = () if whole.axes is None else table_findings(whole.axes, whole.mount_tilt)
    verdict = Verdict.of(_axes_missing(axes), prior, *map(axis_finding, shown), *uneven)
    return replace(fit, model=with_errors(fit.model, table_errors(fit.model, whole)), verdict=verdict)


def _nominal_kept(axes: tuple[Axis, ...], cross_axis_prior: float, *, physical: bool) -> Finding:
    return finding(
        "rate_table.nominal_kept",
        "warn",
        axes=[axis for axis in AXES if axis not in axes],
        source="the unit's own" if physical else "that of the turned axes",
        scale_percent=100.0 * NOMINAL_SD[physical],
        cross_percent=100.0 * cross_axis_prior,
    )


def fit_rate_axis(
    dwells: DwellMeans, *, latitude_deg: float | None = None, scale_tolerance: float = 0.25
) -> RateAxisFit:
    """Fit what turns about a single axis show: scale factor, cross-axis column and offsets."""
    axes = sorted(set(dwells.axis))
    if len(axes) != 1:
        raise InputError(f"rate axis: wanted turns about one axis, got {', '.join(axes) or 'none'}; use fit_rate_table")
    axis = AXES[k := AXES.index(dwells.axis[0])]
    table = linearity(dwells.reading[:, k], dwells.turn_rate, axis)
    rate = imposed_rates(dwells, latitude_deg)[:, k]
    design = np.column_stack((rate, np.ones_like(rate)))
    theta = np.linalg.lstsq(design, dwells.reading, rcond=None)[0]
    residuals = dwells.reading - design @ theta
    variance = [student_variance(column, len(rate) - 2) for column in residuals.T]
    most = int(np.abs(theta[0]).argmax())
    if most != k or theta[0, k] < 0.0:
        reads = f"{'-' if theta[0, most] < 0.0 else '+'}{AXES[most]}"
        raise Implausible(
            f"turns about {axis}: wanted the {axis} gyroscope to read + for turns about +{axis}, got column {AXES[most]} "
            f"that reads them as {reads}; correct the sign or axis of the turns, or the order or sign of the columns",
            reads=reads,
        )
    check_own_scale(float(theta[0, k]), dwells.unit, "rate", scale_tolerance, f"gyroscope {axis}")
    return RateAxisFit(
        axis=axis,
        column=theta[0],
        offset=theta[1],
        covariance=np.kron(np.linalg.inv(design.T @ design), np.diag(variance)),
        residuals=residuals,
        linearity=table,
        unit_in=dwells.unit,
        verdict=Verdict.of(_axes_missing((axis,))),
    )


def _axes_missing(turned: tuple[Axis, ...]) -> Finding:
    missing = tuple(axis for axis in AXES if axis not in turned)
    return finding("rate_table.axes_missing", "warn", turned=turned, missing=missing)


def fit_rate_axes(
    dwells: DwellMeans, *, latitude_deg: float | None = None, scale_tolerance: float = 0.25
) -> tuple[RateAxisFit, ...]:
    """Fit each axis that was turned, alone."""
    fits = []
    for axis in AXES:
        rows = [k for k, name in enumerate(dwells.axis) if name == axis]
        if len(np.unique(dwells.turn_rate[rows])) > 1:
            own = _only(dwells, rows)
            fits.append(fit_rate_axis(own, latitude_deg=latitude_deg, scale_tolerance=scale_tolerance))
    return tuple(fits)


def axis_finding(fit: RateAxisFit) -> Finding:
    """Return what the turns about one axis show: scale, its uncertainty, linearity."""
    line, own = fit.linearity, AXES.index(fit.axis)
    sigma = float(np.sqrt(fit.covariance[own, own])) / abs(fit.scale_factor)
    unit = si_factor(fit.unit_in, "rate") if is_physical(fit.unit_in) else RADIAN_PER_DEGREE
    return finding(
        "rate_table.axis",
        "info",
        axis=fit.axis,
        scale=fit.scale_factor * unit,
        unit="of the nominal scale" if is_physical(fit.unit_in) else f"{fit.unit_in} per deg/s",
        uncertainty_percent=100.0 * sigma,
        nonlinearity_dps=line.scale_factor_nonlinearity / RADIAN_PER_DEGREE,
        nonlinearity_percent=line.scale_factor_nonlinearity_percent,
        asymmetry_percent=100.0 * line.scale_factor_asymmetry,
    )


def _only(dwells: DwellMeans, rows: list[int]) -> DwellMeans:
    whole = {name: getattr(dwells, name) for name in ("reading", "turn_rate", "noise", "time")}
    cut: dict[str, Any] = {name: None if values is None else values[rows] for name, values in whole.items()}
    axis, up = tuple(dwells.axis[k] for k in rows), np.broadcast_to(dwells.up, len(dwells.axis))[rows]
    return replace(dwells, axis=axis, up=up, axes=None, **cut)


# ---- from a session


def calibrate_rates(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to its turns at known rates; an entry of FITS."""
    session, own = seen.session, seen.settings
    latitude, tolerance = own.latitude_deg, own.scale_tolerance
    dwells = dwell_means(session.records, session.turns, settle_s=own.settle_s, cutoff_hz=own.spline_cutoff_hz)
    turned = tuple(sorted(set(dwells.axis)))
    if 0 < len(turned) < 3:
        prior = own.cross_axis_prior
        dwells, findings = _on_table(seen, dwells, None)
        part = fit_turned_axes(dwells, latitude_deg=latitude, scale_tolerance=tolerance, cross_axis_prior=prior)
        return Outcome(fit=part, method="rate-table", findings=findings)
    dwells, findings = _on_table(seen, dwells, accel)
    rests = _rest_means(seen, dwells, None if accel is None else accel.model)
    numbers = tuple(k for k, t in enumerate(session.turns, 1) if t.axis is not None and t.turn_rate is not None)
    check_dwells(dwells, imposed_rates(dwells, latitude), rests=rests, numbers=numbers)
    if mode != "paper":
        fit = fit_rate_table(dwells, latitude_deg=latitude, scale_tolerance=tolerance)
        fit = fit_with_rests(fit, dwells, rests, latitude_deg=latitude)
        return Outcome(fit=fit, method="rate-table", findings=findings)
    offset = None
    if own.remove_offset:
        offset, variance = seen.rest_rate()
        if np.isnan(offset).any():
            offset = np.asarray(dwells.reading.mean(axis=0))  # both signs of every rate cancel
            variance = np.full(3, np.nan) if dwells.noise is None else (dwells.noise**2).mean(axis=0) / len(dwells.axis)
        dwells = replace(dwells, reading=dwells.reading - offset)
    paper: TriadFit = fit_rate_table(dwells, mode="paper", latitude_deg=latitude, scale_tolerance=tolerance)
    paper = paper if offset is None else with_offset(paper, offset, variance)
    return Outcome(fit=paper, method="rate-table", findings=findings)


def _on_table(seen: Observed, dwells: DwellMeans, accel: TriadFit | None) -> tuple[DwellMeans, tuple[Finding, ...]]:
    """Return dwells with the axes about which the table turned the case, and what the temperature did."""
    session, table = seen.session, seen.settings.rate_table(seen.session.rate_table)
    turns = [t for t in session.turns if t.axis is not None and t.turn_rate is not None]
    stretches = Dwells(
        records=session.records,
        turns=turns,
        mounting=mountings([*turns, *seen.stills])[: len(turns)],
        reading=dwells.reading,
        up=np.array(dwells.up),
        settle_s=seen.settings.settle_s,
    )
    # Two joints, block on adapter and adapter on table, are no squarer than the block's faces on their plate [assumed]; 0 is exact
    tilt = accel.tilt if isinstance(accel, SixFaceFit) and accel.tilt > 0.0 < table.mount_tilt_deg else 0.0
    likely = replace(table, mount_tilt_deg=float(np.hypot(table.mount_tilt_deg, 2.0**0.5 * tilt / RADIAN_PER_DEGREE)))
    axes = table_axes(stretches, likely, None if accel is None else accel.model, session.gravity_m_s2)
    creep = creep_of(seen, turns, "gyro")
    # Creep of the scale multiplies rates by its slope times the mean warmth of the dwells about an axis
    square = np.where(np.array(dwells.axis)[:, None] == np.array(AXES), dwells.turn_rate[:, None] ** 2, 0.0)
    warmth = creep.warmth @ square / np.maximum(square.sum(axis=0), 1e-300)
    of_creep = np.diag(np.diag(creep.scale_per_k * np.hypot(warmth, creep.reference_k)).reshape(9) ** 2)
    axes = replace(axes, covariance=axes.covariance + of_creep, creep=of_creep)
    return replace(dwells, axes=axes, mount_tilt=table.mount_tilt_deg * RADIAN_PER_DEGREE), creep.findings()


def _rest_means(seen: Observed, dwells: DwellMeans, accel: TriadModel | None) -> RestMeans | None:
    """Return readings at rest and specific forces; None where a recording lacks a triad or there is no rest.

    Without accelerometers rests on stated faces count, and gravity is along the face.
    """
    records, rests = seen.session.records, sorted(seen.stills, key=lambda still: still.recording)
    turning = [t for t in seen.session.turns if t.axis is not None and t.turn_rate is not None]
    if accel is None:
        rests = [rest for rest in rests if rest.face is not None]
    parts = [records[s.recording].part(s.start, s.stop) for s in rests]
    if not parts or not turning or any(r.gyro is None or np.isnan(r.gyro).any() for r in parts):
        return None
    windows = [record.gyro for record in parts if record.gyro is not None]
    noise = noise_of_means(windows, [block_size(record.sample_rate_hz) for record in parts])
    if noise is None:
        return None
    if accel is None:
        force = _stated_force(rests, turning, dwells) * seen.session.gravity_m_s2
    else:
        turns = [records[t.recording].part(t.start, t.stop).accel for t in turning]
        felt = [values for values in (*turns, *(record.accel for record in parts)) if values is not None]
        if len(felt) < len(turns) + len(parts):
            return None
        force = (np.array([np.nanmean(values, axis=0) for values in felt]) - accel.offset) @ accel.matrix.T
    return RestMeans(
        dwell_force=force[: len(turning)],
        reading=np.array([window.mean(axis=0) for window in windows]),
        force=force[len(turning) :],
        noise=np.hypot(noise, np.sqrt(dwells.codes)),
        time=middles(records, rests),
        felt=accel is not None,
    )


def _stated_force(rests: Sequence[Still], turning: Sequence[Turn], dwells: DwellMeans) -> FloatArray:
    """Return the direction that points up (N + P, 3) in dwells, by the rests of their mounting, and in rests on faces."""
    faces = [f"{'-' if up < 0.0 else '+'}{axis}" for up, axis in zip(dwells.up, dwells.axis, strict=True)]
    numbers = mountings([*turning, *rests]).tolist()
    shown = {number: rest.face for number, rest in zip(numbers[len(turning) :], rests, strict=True) if rest.face}
    faces = [shown.get(number, face) for number, face in zip(numbers[: len(turning)], faces, strict=True)]
    faces += [rest.face for rest in rests if rest.face]
    sign = np.array([-1.0 if face[0] == "-" else 1.0 for face in faces])
    return np.asarray(axis_vectors([face[1] for face in faces]) * sign[:, None])
