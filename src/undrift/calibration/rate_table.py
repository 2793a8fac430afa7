"""Rate table: gyroscopes against imposed steady rates, each axis up in turn, both signs (eqs. 4-6 of the note).

    paper      C = L S' (S S')^-1              L (3, N) achieved rates, S (3, N) mean readings; offset already removed
    affine     M u - c - G f = w + errors      M (3, 3), c = M o, and G, the g-sensitivity; w = 0 at rest

L holds the rates that the table achieved, never the nominal ones: at 40,000 counts a turn the note's 0.1 deg/s is 0.099. The
Earth's rotation adds its vertical part, Omega sin(latitude), to the axis that points up; the horizontal part averages out
over whole turns. f is the specific force by the accelerometers, without them along the stated faces of the rests.

The errors of dwell or rest i, in the frame of the case, by source:

    noise, adc     M n_i                       noise and rounding of the mean
    rate           w_i r                       stated rates, wrong in common
    mounting       w_i (d_i + e_i)             the table's axis as gravity shows it or as stated, and its wobble beyond that
    ripple         w_i (p_m(psi_i) + u_i)      the rate about the dwell's axis: it ripples with the azimuth psi of the table, if a
                                               dwell is shorter than a turn, and differs from dwell to dwell
    temperature    warmth_i (alpha + beta w_i) offset and scale follow the temperature
    instability    flicker, and q_k B          of the offset; B the covariance of a random walk about its mean over the session

The sizes of e, p, u and q_k, of each sensor, are excess variances of the residuals (fit/gls.py). The offset is that of the session
on average. What the session does not determine keeps its prior: the columns of axes that the table did not turn, and G.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import limited_by_codes
from undrift.calibration.plausibility import SCALE_TOLERANCE, axis_vectors, check_axis_order, check_own_scale
from undrift.calibration.session import Observed, Outcome, spans_of, with_offset
from undrift.calibration.sources import Creep, creep_of, flicker_about_mean, in_case, walk_about_mean
from undrift.calibration.table import (
    DwellMeans,
    Linearity,
    dwell_means,
    imposed_rates,
    linearity,
    mountings,
    table_axes,
    table_turns,
)
from undrift.errors import Implausible, NotObservable
from undrift.findings import Finding, above, finding
from undrift.fit.gls import GlsFit, Prior, block_size, noise_of_means, solve_inverse
from undrift.fit.priors import (
    DRIFT_DPS,
    G_SENSITIVITY,
    GYRO_FLICKER,
    SCALE_FACTOR,
    SCALE_FACTOR_IN_COUNTS,
    SCALE_LIMIT,
    UNCERTAIN_PERCENT,
)
from undrift.fit.triad import (
    TriadFit,
    TriadParameters,
    fit_of,
    fit_paper,
    offset_verdict,
    parameters_of,
    scaled_condition,
)
from undrift.model import AXES, TriadModel, Verdict, level_of
from undrift.record import Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

UNEVEN_PERCENT = (0.1, 2.0)  # standard uncertainty of a scale by uneven rates: marginal, bad
MINUTE_S = 60.0
CHANCE = 1e-3  # of a g-sensitivity that is reported without there being one
UNDETERMINED = 0.9  # of its prior: a g-sensitivity as uncertain as this was not determined
MIN_NOISE = 1e-9  # of the largest reading: a mean is not known better than the filter's arithmetic, whatever its noise
MOUNTED = 2.0  # times the stated size, from which a mounting is a finding
SMALL_ANGLE = 1e-3  # rad: what every case lies off by, however well it is mounted

# ---- fit of dwells and rests

RateTableMode = Literal["paper", "affine"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateTableFit(TriadFit):
    """Gyroscopes fitted to a rate table; ``residuals`` are corrected minus imposed rate, rad/s, one row per dwell or rest."""

    linearity: tuple[Linearity, ...]  # own-axis table, nonlinearity and asymmetry of each turned axis


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMeans:
    """Readings at rest, and the specific force of rests and dwells, by accelerometers or along the stated faces."""

    dwell_force: FloatArray  # (N, 3), mean corrected specific force of each dwell, m/s2, frame b
    reading: FloatArray  # (P, 3), mean gyroscope reading of each rest, unit of the dwells
    force: FloatArray  # (P, 3), mean corrected specific force of each rest, m/s2
    noise: FloatArray  # (P, 3), standard deviation of each mean reading
    span: FloatArray  # (P, 2), start and stop of each rest, s, on the clock of the dwells
    felt: bool = True  # False without accelerometers: a g-sensitivity is then fitted, but cannot be corrected
    stills: tuple[Still, ...] = ()  # the rests in the session


def fit_rate_table(
    dwells: DwellMeans,
    rests: RestMeans | None = None,
    *,
    mode: RateTableMode = "affine",
    latitude_deg: float | None = None,
    scale_tolerance: float = SCALE_TOLERANCE,
    cross_axis_prior: float = 0.01,
    creep: Creep | None = None,
) -> RateTableFit:
    """Fit gyroscopes to the dwells of a rate table and to rests; its latitude adds the Earth's rate to a vertical axis.

    The columns of axes that the table did not turn keep the nominal scale factor; cross-axis terms of ``cross_axis_prior``.
    """
    lines = _check_turned(dwells, scale_tolerance)
    turned = [AXES.index(line.axis) for line in lines]
    rates = imposed_rates(dwells, latitude_deg)
    names: dict[str, Any] = {"method": f"rate-table/{mode}", "unit_in": dwells.unit, "unit_out": "rad/s"}
    if mode == "paper":
        if len(turned) < 3:
            lacking = ", ".join(axis for k, axis in enumerate(AXES) if k not in turned)
            raise NotObservable(
                f"rate table, mode paper: expected turns about x, y and z, got none about {lacking}. Record them."
            )
        fit = fit_paper(rates, dwells.reading, dwells.noise, **names)
        fit = replace(fit, verdict=offset_verdict(fit, rates, dwells.reading, dwells.noise))
    else:
        rows = _rows(dwells, rates, rests, creep)
        matrix = first_table_matrix(rows.rate, rows.reading, turned, dwells.unit)
        check_axis_order(np.linalg.inv(matrix), "rate table", against="turns")
        gls = solve_inverse(
            rows.reading,
            rows.rate,
            rows.force,
            matrix,
            _sources(rows, matrix, dwells),
            excess=_excess(rows, dwells),
            prior=table_prior(matrix, turned, rows.force is not None, dwells.unit, cross_axis_prior),
        )
        parameters, findings = _without_undetermined_g(parameters_of(gls), felt=rests is None or rests.felt)
        fit = fit_of(parameters, rows.rate, -gls.residuals.reshape(-1, 3), **names)
        fit = replace(fit, verdict=Verdict.of(*findings, *_findings(fit.model, gls, dwells)))
    check_own_scale(fit.model.scale_factor, dwells.unit, "rate", scale_tolerance, "gyroscope")
    return RateTableFit(model=fit.model, residuals=fit.residuals, verdict=fit.verdict, linearity=lines)


def _check_turned(dwells: DwellMeans, scale_tolerance: float) -> tuple[Linearity, ...]:
    """Return the own-axis table of each axis that the table turned at two rates or more."""
    lines = []
    for k, axis in enumerate(AXES):
        rows = [n for n, name in enumerate(dwells.axis) if name == axis]
        rate, reading = dwells.turn_rate[rows], dwells.reading[rows]
        if len(np.unique(rate)) < 2:
            continue
        if len(set(dwells.axis)) < 3:  # with three axes the whole matrix shows exchanged columns
            slope = np.linalg.lstsq(np.column_stack((rate, np.ones_like(rate))), reading, rcond=None)[0][0]
            check_reads_positive(slope, k)
            check_own_scale(slope[k], dwells.unit, "rate", scale_tolerance, f"gyroscope {axis}")
        lines.append(linearity(reading[:, k], rate, AXES[k]))
    if not lines:
        raise NotObservable(
            "rate table: expected dwells at two different rates or more about an axis, got none about x, y, z. Record both signs."
        )
    return tuple(lines)


def check_reads_positive(slope: FloatArray, k: int) -> None:
    """Raise if turns about +axis k do not make gyroscope k read + more than the others; slope (3,), reading per rate or angle."""
    most = int(np.abs(slope).argmax())
    if most != k or slope[k] < 0.0:
        reads = f"{'-' if slope[most] < 0.0 else '+'}{AXES[most]}"
        raise Implausible(
            f"turns about {AXES[k]}: expected the {AXES[k]} gyroscope to read + for turns about +{AXES[k]}, got column "
            f"{AXES[most]} that reads them as {reads}. Correct the sign or axis of the turns, or the order or sign of the columns.",
            reads=reads,
        )


# ---- rows and sources


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _TableRows:
    """Dwells, then rests: E pieces, three rows each."""

    reading: FloatArray  # (E, 3), unit of the dwells
    rate: FloatArray  # (E, 3), imposed, rad/s
    force: FloatArray | None  # (E, 3), m/s2
    noise: FloatArray | None  # (E, 3), standard deviation of each mean
    span: FloatArray | None  # (E, 2), s
    creep: Creep | None


def _rows(dwells: DwellMeans, rates: FloatArray, rests: RestMeans | None, creep: Creep | None) -> _TableRows:
    if rests is None:
        return _TableRows(
            reading=dwells.reading, rate=rates, force=None, noise=dwells.noise, span=dwells.span, creep=creep
        )
    return _TableRows(
        reading=np.vstack((dwells.reading, rests.reading)),
        rate=np.vstack((rates, np.zeros_like(rests.reading))),
        force=np.vstack((rests.dwell_force, rests.force)),
        noise=None if dwells.noise is None else np.vstack((dwells.noise, rests.noise)),
        span=None if dwells.span is None else np.vstack((dwells.span, rests.span)),
        creep=creep,
    )


def first_table_matrix(rate: FloatArray, reading: FloatArray, turned: Sequence[int], unit: str) -> FloatArray:
    """Return a first matrix M: least squares for the turned axes, the nominal scale factor for the others."""
    design = np.column_stack((rate[:, turned], np.ones(len(rate))))
    slopes = np.linalg.lstsq(design, reading, rcond=None)[0][:-1]
    forward = np.eye(3) * (
        1.0 / si_factor(unit, "rate") if is_physical(unit) else np.mean([slopes[n, k] for n, k in enumerate(turned)])
    )
    forward[:, turned] = slopes.T
    return np.asarray(np.linalg.inv(forward))


def table_prior(
    matrix: FloatArray, turned: Sequence[int], force: bool, unit: str, cross_axis_prior: float
) -> Prior | None:
    """Return the prior of M, c and G: the nominal scale in the columns of axes that were not turned, and the g-sensitivity."""
    size = 21 if force else 12
    precision, mean = np.zeros((size, size)), np.zeros(size)
    precision[range(12, size), range(12, size)] = G_SENSITIVITY**-2
    scale = SCALE_FACTOR if is_physical(unit) else SCALE_FACTOR_IN_COUNTS
    for column in {0, 1, 2} - {*turned}:
        for row in range(3):
            place = 3 * row + column
            mean[place] = matrix[column, column] if row == column else 0.0
            relative = scale if row == column else cross_axis_prior
            precision[place, place] = (matrix[column, column] * relative) ** -2
    return Prior(mean=mean, precision=precision) if precision.any() else None


def _sources(rows: _TableRows, matrix: FloatArray, dwells: DwellMeans) -> dict[str, FloatArray]:
    """Return the stated covariances (3 E, 3 E) of the rows, (rad/s)^2."""
    count, number = len(rows.rate), len(dwells.turn_rate)
    floor = (MIN_NOISE * float(np.abs(rows.reading).max())) ** 2 + 1e-300
    noise = np.zeros_like(rows.reading) if rows.noise is None else rows.noise**2
    codes = np.minimum(np.broadcast_to(dwells.codes, noise.shape), noise)
    # Equal inputs have equal rounding errors. Inputs a step or more apart have independent ones, since nothing states where between
    # two codes each of them lies; in between the correlation falls linearly.
    place = rows.rate @ np.linalg.inv(matrix).T / np.where(dwells.codes > 0.0, dwells.step, 1.0)
    rounding = np.sqrt(codes[:, None] * codes) * np.maximum(1.0 - np.abs(place[:, None] - place), 0.0)
    sources = {
        "noise": in_case(matrix, np.eye(count)[:, :, None] * np.maximum(noise - codes, floor)[:, None]),
        "adc": in_case(matrix, rounding),
    }
    if rows.span is not None:
        sources["instability"] = GYRO_FLICKER**2 * np.kron(flicker_about_mean(rows.span), np.eye(3))
    if rows.creep is not None:
        sources["temperature"] = rows.creep.covariance_in_case(rows.rate)
    if (axes := dwells.axes) is not None:
        across = _turning(dwells, count)[0]
        across[:number] *= axes.wobble[:, None]
        columns = np.zeros((count, 3, axes.columns.shape[2]))
        columns[:number] = axes.columns * dwells.turn_rate[:, None, None]
        tilts = columns.reshape(3 * count, -1)
        common = axes.rate * rows.rate.ravel()
        sources["rate"] = np.outer(common, common)
        sources["mounting"] = tilts @ tilts.T + np.diag(across.ravel() ** 2)
    return sources


def _excess(rows: _TableRows, dwells: DwellMeans) -> dict[str, FloatArray]:
    """Return the covariance of each error of unknown size, for size 1: (3 E, 3 E), or its diagonal (3 E,)."""
    count = len(rows.rate)
    if rows.noise is None:
        return {"noise": np.ones(3 * count)}
    across, along = _turning(dwells, count)
    shapes = {"mounting wobble": across.ravel() ** 2, "ripple": along.ravel() ** 2}
    if dwells.axes is not None and dwells.axes.ripple.any():
        relative = np.zeros((count, dwells.axes.ripple.shape[1]))
        relative[: len(dwells.turn_rate)] = dwells.axes.ripple
        columns = (along[:, :, None] * relative[:, None]).reshape(3 * count, -1)
        shapes["ripple azimuth"] = columns @ columns.T
    return shapes | walks_of(rows.span)


def walks_of(span: FloatArray | None) -> dict[str, FloatArray]:
    """Return the shapes (3 E, 3 E) of a walk of each sensor's offset, for pieces (E, 2) on one clock, s."""
    if span is None or not np.ptp(middle := span.mean(axis=1)) > 0.0:
        return {}
    walk = walk_about_mean(middle)
    return {f"instability {axis}": np.kron(walk, np.diag(np.eye(3)[k])) for k, axis in enumerate(AXES)}


def _turning(dwells: DwellMeans, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the rate of each dwell in the two rows across its axis, and in the row along it, (E, 3) each; 0 at rest."""
    along, across = np.zeros((count, 3)), np.zeros((count, 3))
    own = np.abs(axis_vectors(dwells.axis)) > 0.5
    along[: len(own)] = np.where(own, dwells.turn_rate[:, None], 0.0)
    across[: len(own)] = np.where(own, 0.0, dwells.turn_rate[:, None])
    return across, along


# ---- findings


def _without_undetermined_g(parameters: TriadParameters, *, felt: bool) -> tuple[TriadParameters, list[Finding]]:
    """Return the parameters without a g-sensitivity that was not determined, or that no accelerometer corrects."""
    if (g := parameters.g_sensitivity) is None:
        return parameters, []
    covariance = parameters.covariance[12:, 12:]
    determined = np.sqrt(np.diag(covariance)).min() <= UNDETERMINED * G_SENSITIVITY
    if determined and felt:
        return parameters, []
    from scipy.special import chdtri

    flat, findings = g.ravel(), []
    if determined and float(flat @ np.linalg.solve(covariance, flat)) > float(chdtri(9, CHANCE)):
        apart = float(np.ptp(g, axis=1).max()) * STANDARD_GRAVITY / RADIAN_PER_DEGREE
        findings = [finding("rate_table.axis_offset", level_of(apart, DRIFT_DPS), offset_dps=apart)]
    return parameters.without_g(), findings


def _findings(model: TriadModel, fit: GlsFit, dwells: DwellMeans) -> Iterator[Finding]:
    walks = [variance for kind, variance in fit.excess.items() if kind.startswith("instability") and fit.shows(kind)]
    dps = max(walks, default=0.0) ** 0.5 * MINUTE_S**0.5 / RADIAN_PER_DEGREE
    yield from above("rate_table.drift", dps, DRIFT_DPS, dps_per_minute=dps)
    yield from limited_by_codes("gyroscope", dwells.codes, np.diag(model.covariance)[9:12], dwells.unit)
    if (axes := dwells.axes) is not None and np.isfinite(axes.off).any():
        off, uncertainty = axes.off[np.nanargmax(axes.off[:, 0])]
        if off - 2.0 * uncertainty > max(MOUNTED * 2.0**0.5 * axes.mount_tilt, SMALL_ANGLE):
            angles = {"angle_deg": off / RADIAN_PER_DEGREE, "stated_deg": axes.mount_tilt / RADIAN_PER_DEGREE}
            yield finding("rate_table.mounting", "warn", **angles)
    uncertain = 100.0 * model.relative_uncertainty
    yield from above("rate_table.uncertainty", uncertain, UNCERTAIN_PERCENT, uncertainty_percent=uncertain)
    if model.budget is not None and "ripple" in model.budget.sources:
        uneven = model.budget.uncertainty[model.budget.sources.index("ripple")][[0, 4, 8]] / np.diag(model.matrix)
        worst, axis = 100.0 * float(uneven.max()), AXES[int(uneven.argmax())]
        yield from above("rate_table.uneven_rate", worst, UNEVEN_PERCENT, axis=axis, uncertainty_percent=worst)


def axes_missing(turned: Sequence[str], unit: str, cross_axis_prior: float) -> Finding:
    """Return the finding of turns about one or two axes: which elements keep their prior, and its size."""
    return finding(
        "rate_table.axes_missing",
        "warn",
        turned=(*turned,),
        missing=tuple(axis for axis in AXES if axis not in turned),
        scale_percent=100.0 * (SCALE_FACTOR if is_physical(unit) else SCALE_FACTOR_IN_COUNTS),
        cross_percent=100.0 * cross_axis_prior,
    )


def scale_verdict(scale_factor: FloatArray, unit: str, axes: str = "xyz") -> Verdict:
    """Return marginal if a scale factor (K,) differs from the stated unit by more than data sheets allow, bad at twice that."""
    if not is_physical(unit):
        return Verdict()
    ratio = np.asarray(scale_factor) * si_factor(unit, "rate")
    worst = int(np.abs(ratio - 1.0).argmax())
    off = float(ratio[worst] - 1.0)
    if abs(off) <= SCALE_LIMIT:
        return Verdict()
    level = level_of(abs(off), (SCALE_LIMIT, 2.0 * SCALE_LIMIT))
    return Verdict.of(finding("gyro.scale_factor", level, axis=axes[worst], off_percent=100.0 * off))


# ---- false dwells: a rate stated with a wrong sign, value or axis
#
# One such dwell moves a least-squares fit, and an offset that may drift follows it. So before either, each sensor is fitted by
# least absolute deviations, which a few false dwells do not move:
#
#     (K, b) = argmin sum_i |s_i - K w_i - b|        e_i = K^-1 (s_i - b) - w_i, rad/s; with rests, + H a_i beside b
#
# A dwell is refused if |e_i| is beyond 8 times the typical |e|, the median over the dwells minus one for every parameter that the
# fit makes exact, and beyond 2 % of the largest rate. The curvature of a sound sensor and the ripple of a table stay below that.

SCATTERS = 8.0  # times the typical error: beyond any tail that noise, wobble or drift makes of a few tens of dwells
SHARE = 0.02  # of the largest rate
LEAST_SPARE = 4  # equations beyond the parameters of a sensor; with fewer, a false dwell does not stand out
MOST_PASSES = 60


def check_dwells(
    dwells: DwellMeans, rates: FloatArray, *, rests: RestMeans | None = None, numbers: tuple[int, ...] | None = None
) -> None:
    """Raise if the reading of a dwell contradicts all the others; rates (N, 3), rad/s."""
    design, reading, count = np.column_stack((rates, np.ones(len(rates)))), dwells.reading, len(rates)
    if rests is not None:
        zero = np.column_stack((np.zeros_like(rests.reading), np.ones(len(rests.reading))))
        design, reading = np.vstack((design, zero)), np.vstack((reading, rests.reading))
        full = np.hstack((design, np.vstack((rests.dwell_force, rests.force))))
        if len(full) - 7 >= LEAST_SPARE and scaled_condition(full)[0] == 7:
            design = full
    if len(design) - design.shape[1] < LEAST_SPARE or np.linalg.matrix_rank(design) < design.shape[1]:
        return
    theta = np.array([_least_deviations(design, column) for column in reading.T])
    if abs(np.linalg.det(theta[:, :3])) < 1e-6 * np.prod(np.linalg.norm(theta[:, :3], axis=1)):
        return  # two columns that read the same; the fit itself reports it
    away = (reading - design @ theta.T) @ np.linalg.inv(theta[:, :3]).T
    error, size = np.linalg.norm(away, axis=1), np.linalg.norm(rates, axis=1)
    typical = float(np.median(np.sort(error)[design.shape[1] :]))
    with_rate = np.median(error[:count] / np.maximum(size, 1e-300)) * size  # a table that wobbles errs with its rate
    limits = np.maximum(SCATTERS * np.maximum(typical, with_rate), SHARE * float(np.abs(rates).max()))
    wrong = np.flatnonzero(error[:count] > limits)
    if len(wrong):
        numbers = tuple(range(1, count + 1)) if numbers is None else numbers
        named = "; ".join(_named(dwells, rates[k] + away[k], k, numbers[k]) for k in wrong[:3])
        rest = f"; and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        raise Implausible(
            f"rate table: expected dwells that agree within {limits[wrong[0]] / RADIAN_PER_DEGREE:.2g} deg/s, got {named}{rest}. "
            "Check its sign, value, axis and times, or leave it out.",
            turns=tuple(numbers[k] for k in wrong),
        )


def _named(dwells: DwellMeans, read: FloatArray, k: int, number: int) -> str:
    own, most = AXES.index(dwells.axis[k]), int(np.abs(read).argmax())
    other = most != own and abs(read[most]) >= 2.0 * abs(read[own])
    value = read[most if other else own] / RADIAN_PER_DEGREE
    return (
        f"turn {number}, {dwells.axis[k]} at {dwells.turn_rate[k] / RADIAN_PER_DEGREE:+.4g} deg/s: reads as {value:+.4g}"
        f"{f' about {AXES[most]}' if other else ''}"
    )


def _least_deviations(design: FloatArray, reading: FloatArray) -> FloatArray:
    # Iteratively reweighted least squares; the floor shrinks until the deviations that remain are the false ones.
    theta: FloatArray = np.linalg.lstsq(design, reading, rcond=None)[0]
    for step in range(MOST_PASSES):
        away = np.abs(reading - design @ theta)
        floor = max(float(np.median(away)) * 0.9**step, 1e-12 * float(np.abs(reading).max()), 1e-300)
        root = 1.0 / np.sqrt(np.maximum(away, floor))
        theta = np.linalg.lstsq(design * root[:, None], reading * root, rcond=None)[0]
    return theta


# ---- from a session


def calibrate_rates(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to its turns at known rates; an entry of FITS."""
    session, settings, turns = seen.session, seen.settings, table_turns(seen.session.turns)
    dwells = dwell_means(session.records, turns, settle_s=settings.settle_s, cutoff_hz=settings.spline_cutoff_hz)
    model = None if accel is None else accel.model
    axes = table_axes(
        session.records,
        turns,
        dwells,
        mountings([*turns, *seen.stills])[: len(turns)],
        table=session.rate_table,
        accel=model,
        gravity_m_s2=session.gravity_m_s2,
        settle_s=settings.settle_s,
    )
    dwells = replace(dwells, axes=axes)
    rests = _rest_means(seen, turns, dwells, model)
    numbers = tuple(k for k, turn in enumerate(session.turns, 1) if turn in turns)
    check_dwells(dwells, imposed_rates(dwells, settings.latitude_deg), rests=rests, numbers=numbers)
    findings, turned = creep_of(seen, turns, "gyro").findings(), tuple(axis for axis in AXES if axis in dwells.axis)
    known: dict[str, Any] = {"latitude_deg": settings.latitude_deg}
    if mode != "paper" or len(turned) < 3:
        pieces: list[Still | Turn] = [*turns, *(() if rests is None else rests.stills)]
        creep = creep_of(seen, pieces, "gyro")
        fit: TriadFit = fit_rate_table(dwells, rests, cross_axis_prior=settings.cross_axis_prior, creep=creep, **known)
        if len(turned) < 3:
            findings = (*findings, axes_missing(turned, dwells.unit, settings.cross_axis_prior))
        return Outcome(fit=fit, method="rate-table", findings=findings)
    if not settings.remove_offset:
        return Outcome(fit=fit_rate_table(dwells, mode="paper", **known), method="rate-table", findings=findings)
    offset, variance = seen.rest_rate()
    if np.isnan(offset).any():
        offset = np.asarray(dwells.reading.mean(axis=0))  # both signs of every rate cancel
        variance = np.full(3, np.nan) if dwells.noise is None else (dwells.noise**2).mean(axis=0) / len(dwells.axis)
    fit = fit_rate_table(replace(dwells, reading=dwells.reading - offset), mode="paper", **known)
    return Outcome(fit=with_offset(fit, offset, variance), method="rate-table", findings=findings)


def _rest_means(
    seen: Observed, turning: Sequence[Turn], dwells: DwellMeans, accel: TriadModel | None
) -> RestMeans | None:
    """Return readings at rest and specific forces; None if a recording lacks a triad or there is no rest.

    Without accelerometers rests on stated faces count, and gravity is along the face.
    """
    records, rests = seen.session.records, sorted(seen.stills, key=lambda still: still.recording)
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
        span=spans_of(records, rests),
        felt=accel is not None,
        stills=tuple(rests),
    )


def _stated_force(rests: Sequence[Still], turning: Sequence[Turn], dwells: DwellMeans) -> FloatArray:
    """Return the direction that points up (N + P, 3) in dwells, by the rests of their mounting, and in rests on faces."""
    faces = [f"{'-' if up < 0.0 else '+'}{axis}" for up, axis in zip(dwells.up, dwells.axis, strict=True)]
    numbers = mountings([*turning, *rests]).tolist()
    known = {number: rest.face for number, rest in zip(numbers[len(turning) :], rests, strict=True) if rest.face}
    faces = [known.get(number, face) for number, face in zip(numbers[: len(turning)], faces, strict=True)]
    faces += [rest.face for rest in rests if rest.face]
    sign = np.array([-1.0 if face[0] == "-" else 1.0 for face in faces])
    return np.asarray(axis_vectors([face[1] for face in faces]) * sign[:, None])
