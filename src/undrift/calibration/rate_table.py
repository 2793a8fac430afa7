"""Rate table: gyroscopes against imposed steady rates, each axis up in turn, both signs (eqs. 4-6 of the note).

    paper      C = L S^T (S S^T)^-1            L (3, N) achieved rates, S (3, N) mean readings; offset already removed
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
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import limited_by_codes
from undrift.calibration.creep import Creep, creep_of, flicker_about_mean, in_case, walk_about_mean
from undrift.calibration.dwells import (
    DwellMeans,
    Dwells,
    Linearity,
    dwell_means,
    imposed_rates,
    linearity,
    mountings,
    table_axes,
)
from undrift.calibration.plausibility import axis_vectors, check_axis_order, check_own_scale
from undrift.calibration.session import Observed, Outcome, middles, spans_of, with_offset
from undrift.errors import Implausible, NotObservable
from undrift.findings import Finding, Level, above, finding
from undrift.fit.equations import offset_of
from undrift.fit.gls import GlsFit, Prior, solve_inverse
from undrift.fit.least_squares import (
    TriadFit,
    block_size,
    fit_paper,
    noise_of_means,
    offset_verdict,
    scaled_condition,
)
from undrift.fit.priors import G_SENSITIVITY, GYRO_FLICKER, SCALE_FACTOR, SCALE_FACTOR_IN_COUNTS
from undrift.model import AXES, G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Budget, TriadModel, Verdict, level_of
from undrift.record import Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

# A part that is trimmed in the factory is within 1 to 3 % of its sensitivity; no datasheet allows more.
OWN_SCALE = 0.05
# Limits of a verdict, above the first it is marginal, above the second bad:
# of scale, 1 sigma: 0.5 % is 2 deg in a full turn; 5 % is no better than most datasheets;
# in a minute: 0.1 deg/s ends 3 deg off after that minute; no warm-up reaches 2 deg/s;
# of scale by an uneven rate; rms, of the largest rate: parts are linear within 0.2 %; 3 % is a false rate or a stuck table
UNCERTAIN_PERCENT, DRIFT_DPS, UNEVEN_PERCENT, RESIDUAL_PERCENT = (0.5, 5.0), (0.1, 2.0), (0.1, 2.0), (0.5, 3.0)
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

    turn_rate: FloatArray  # (N,), achieved rate of each dwell, rad/s
    linearity: tuple[Linearity, ...]  # own-axis table, nonlinearity and asymmetry of each turned axis


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMeans:
    """Readings at rest, and the specific force of rests and dwells, by accelerometers or along the stated faces."""

    dwell_force: FloatArray  # (N, 3), mean corrected specific force of each dwell, m/s2, frame b
    reading: FloatArray  # (P, 3), mean gyroscope reading of each rest, unit of the dwells
    force: FloatArray  # (P, 3), mean corrected specific force of each rest, m/s2
    noise: FloatArray  # (P, 3), standard deviation of each mean reading
    time: FloatArray  # (P,), middle of each rest, s, on the clock of the dwells
    felt: bool = True  # False without accelerometers: a g-sensitivity is then fitted, but cannot be corrected
    span: FloatArray | None = None  # (P, 2), start and stop of each rest, s, on the clock of the dwells
    stills: tuple[Still, ...] = ()  # the rests in the session


def fit_rate_table(
    dwells: DwellMeans,
    rests: RestMeans | None = None,
    *,
    mode: RateTableMode = "affine",
    latitude_deg: float | None = None,
    scale_tolerance: float = 0.25,
    cross_axis_prior: float = 0.01,
    creep: Creep | None = None,
) -> RateTableFit:
    """Fit gyroscopes to the dwells of a rate table and to rests; its latitude adds the Earth's rate to a vertical axis.

    The columns of axes that the table did not turn keep the nominal scale factor; cross-axis terms of ``cross_axis_prior``.
    """
    lines = _check_turned(dwells, scale_tolerance)
    turned = [AXES.index(line.axis) for line in lines]
    rates = imposed_rates(dwells, latitude_deg)
    if mode == "paper":
        if len(turned) < 3:
            lacking = ", ".join(axis for k, axis in enumerate(AXES) if k not in turned)
            raise NotObservable(
                f"rate table, mode paper: expected turns about x, y and z, got none about {lacking}. Record them."
            )
        paper = fit_paper(
            rates, dwells.reading, dwells.noise, None, method="rate-table/paper", unit_in=dwells.unit, unit_out="rad/s"
        )
        verdict = offset_verdict(paper, rates, dwells.reading, dwells.noise)
        model, residuals = paper.model, paper.residuals
    else:
        rows = _rows(dwells, rates, rests, creep)
        matrix = _start(rows, turned, dwells.unit)
        check_axis_order(np.linalg.inv(matrix), "rate table", against="turns")
        fit = _solve(rows, matrix, turned, cross_axis_prior, dwells)
        model, residuals, findings = _model(rows, fit, dwells, felt=rests is None or rests.felt)
        verdict = Verdict.of(*findings)
    check_own_scale(model.scale_factor, dwells.unit, "rate", scale_tolerance, "gyroscope")
    return RateTableFit(model=model, residuals=residuals, verdict=verdict, turn_rate=dwells.turn_rate, linearity=lines)


def _check_turned(dwells: DwellMeans, scale_tolerance: float) -> tuple[Linearity, ...]:
    """Return the own-axis table of each axis that the table turned at two rates or more."""
    lines = []
    for k, axis in enumerate(AXES):
        rows = [n for n, name in enumerate(dwells.axis) if name == axis]
        rate, reading = dwells.turn_rate[rows], dwells.reading[rows]
        if len(np.unique(rate)) < 2:
            continue
        slope = np.linalg.lstsq(np.column_stack((rate, np.ones_like(rate))), reading, rcond=None)[0][0]
        most = int(np.abs(slope).argmax())
        if len(set(dwells.axis)) < 3 and (most != k or slope[k] < 0.0):
            reads = f"{'-' if slope[most] < 0.0 else '+'}{AXES[most]}"
            raise Implausible(
                f"turns about {axis}: expected the {axis} gyroscope to read + for turns about +{axis}, got column {AXES[most]} "
                f"that reads them as {reads}. Correct the sign or axis of the turns, or the order or sign of the columns.",
                reads=reads,
            )
        lines.append(linearity(reading[:, k], rate, AXES[k]))
        if len(set(dwells.axis)) < 3:
            check_own_scale(lines[-1].scale_factor, dwells.unit, "rate", scale_tolerance, f"gyroscope {axis}")
    if not lines:
        raise NotObservable(
            "rate table: expected dwells at two different rates or more about an axis, got none about x, y, z. Record both signs."
        )
    return tuple(lines)


# ---- rows and sources


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _TableRows:
    """Dwells, then rests: E pieces, three rows each."""

    reading: FloatArray  # (E, 3), unit of the dwells
    rate: FloatArray  # (E, 3), imposed, rad/s
    force: FloatArray | None  # (E, 3), m/s2
    noise: FloatArray | None  # (E, 3), standard deviation of each mean
    time: FloatArray | None  # (E,), s
    span: FloatArray | None  # (E, 2), s
    creep: Creep | None


def _rows(dwells: DwellMeans, rates: FloatArray, rests: RestMeans | None, creep: Creep | None) -> _TableRows:
    if rests is None:
        return _TableRows(
            reading=dwells.reading, rate=rates, force=None, noise=dwells.noise, time=dwells.time, span=dwells.span, creep=creep
        )  # fmt: skip
    return _TableRows(
        reading=np.vstack((dwells.reading, rests.reading)),
        rate=np.vstack((rates, np.zeros_like(rests.reading))),
        force=np.vstack((rests.dwell_force, rests.force)),
        noise=_joined(dwells.noise, rests.noise),
        time=_joined(dwells.time, rests.time),
        span=_joined(dwells.span, rests.span),
        creep=creep,
    )


def _joined(first: FloatArray | None, second: FloatArray | None) -> FloatArray | None:
    return None if first is None or second is None else np.concatenate((first, second))


def _start(rows: _TableRows, turned: Sequence[int], unit: str) -> FloatArray:
    """Return a first matrix M: least squares for the turned axes, the nominal scale factor for the others."""
    design = np.column_stack((rows.rate[:, turned], np.ones(len(rows.rate))))
    slopes = np.linalg.lstsq(design, rows.reading, rcond=None)[0][:-1]
    forward = np.eye(3) * (
        1.0 / si_factor(unit, "rate") if is_physical(unit) else np.mean([slopes[n, k] for n, k in enumerate(turned)])
    )
    forward[:, turned] = slopes.T
    return np.asarray(np.linalg.inv(forward))


def _solve(
    rows: _TableRows, matrix: FloatArray, turned: Sequence[int], cross_axis_prior: float, dwells: DwellMeans
) -> GlsFit:
    """Fit M, c and G (21 parameters; 12 without a specific force)."""
    size = 12 if rows.force is None else 21
    precision, mean = np.zeros((size, size)), np.zeros(size)
    precision[range(12, size), range(12, size)] = G_SENSITIVITY**-2
    scale = SCALE_FACTOR if is_physical(dwells.unit) else SCALE_FACTOR_IN_COUNTS
    for column in {0, 1, 2} - {*turned}:
        for row in range(3):
            place, own = 3 * row + column, row == column
            mean[place] = matrix[column, column] if own else 0.0
            precision[place, place] = (matrix[column, column] * (scale if own else cross_axis_prior)) ** -2
    return solve_inverse(
        rows.reading,
        rows.rate,
        rows.force,
        matrix,
        _sources(rows, matrix, dwells),
        excess=_excess(rows, dwells),
        prior=Prior(mean=mean, precision=precision) if precision.any() else None,
    )


def _sources(rows: _TableRows, matrix: FloatArray, dwells: DwellMeans) -> dict[str, FloatArray]:
    """Return the stated covariances (3 E, 3 E) of the rows, (rad/s)^2."""
    count = len(rows.rate)
    floor = (MIN_NOISE * np.abs(rows.reading).max(axis=0)) ** 2 + 1e-300
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
    if dwells.axes is not None:
        across, _ = _turning(dwells, count)
        columns = np.zeros((count, 3, dwells.axes.columns.shape[2]))
        columns[: len(dwells.turn_rate)] = dwells.axes.columns * dwells.turn_rate[:, None, None]
        columns = columns.reshape(3 * count, -1)  # type: ignore[assignment]
        common = dwells.axes.rate * rows.rate.ravel()
        sources["rate"] = np.outer(common, common)
        across[: len(dwells.turn_rate)] *= dwells.axes.wobble[:, None]
        sources["mounting"] = columns @ columns.T + np.diag(across.ravel() ** 2)
    return sources


def _excess(rows: _TableRows, dwells: DwellMeans) -> dict[str, FloatArray]:
    """Return the covariance of each error of unknown size, for size 1: (3 E, 3 E), or its diagonal (3 E,)."""
    count = len(rows.rate)
    if rows.noise is None:
        return {"noise": np.ones(3 * count)}
    across, along = _turning(dwells, count)
    shapes = {"wobble": across.ravel() ** 2, "uneven": along.ravel() ** 2}
    if dwells.axes is not None and dwells.axes.ripple.any():
        relative = np.zeros((count, dwells.axes.ripple.shape[1]))
        relative[: len(dwells.turn_rate)] = dwells.axes.ripple
        columns = (along[:, :, None] * relative[:, None]).reshape(3 * count, -1)
        shapes["ripple"] = columns @ columns.T
    if rows.time is not None and np.ptp(rows.time) > 0.0:
        walk = walk_about_mean(rows.time)
        shapes |= {f"walk {axis}": np.kron(walk, np.diag(np.eye(3)[k])) for k, axis in enumerate(AXES)}
    return shapes


def _turning(dwells: DwellMeans, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the rate of each dwell in the two rows across its axis, and in the row along it, (E, 3) each; 0 at rest."""
    along, across = np.zeros((count, 3)), np.zeros((count, 3))
    own = np.abs(axis_vectors(dwells.axis)) > 0.5
    along[: len(own)] = np.where(own, dwells.turn_rate[:, None], 0.0)
    across[: len(own)] = np.where(own, 0.0, dwells.turn_rate[:, None])
    return across, along


# ---- model and findings


def _model(
    rows: _TableRows, fit: GlsFit, dwells: DwellMeans, *, felt: bool
) -> tuple[TriadModel, FloatArray, list[Finding]]:
    matrix, constant = fit.theta[:9].reshape(3, 3), fit.theta[9:12]
    offset, jacobian = offset_of(matrix, constant, len(fit.theta))
    parts = dict(fit.budget)
    for kind, source in (
        ("wobble", "mounting"),
        ("uneven", "ripple"),
        *((f"walk {axis}", "instability") for axis in AXES),
    ):
        if kind in parts:
            parts[source] = parts.pop(kind) + parts.get(source, 0.0)
    g, findings = None, []
    if rows.force is not None:
        g = fit.theta[12:].reshape(3, 3)
        g_covariance = fit.covariance[12:, 12:]
        if np.sqrt(np.diag(g_covariance)).min() > UNDETERMINED * G_SENSITIVITY:
            g = None
        elif float(fit.theta[12:] @ np.linalg.solve(g_covariance, fit.theta[12:])) > _chance(9):
            findings.append(_g_finding(g, felt=felt))
        if not felt:  # no accelerometer corrects it
            g = None
    if g is None:
        jacobian = jacobian[:12]
    residuals = -fit.residuals.reshape(-1, 3)
    rank, condition = scaled_condition(np.column_stack((rows.rate, np.ones(len(rows.rate)))))
    covariance = jacobian @ fit.covariance @ jacobian.T
    model = TriadModel(
        method="rate-table/affine",
        unit_in=dwells.unit,
        unit_out="rad/s",
        matrix=matrix,
        offset=offset,
        g_sensitivity=g,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *(() if g is None else G_NAMES)),
        covariance=covariance,
        budget=Budget.of(
            covariance, {name: np.diag(jacobian @ part @ jacobian.T) for name, part in parts.items()}, "noise"
        ),
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=residuals.size,
        rank=3 * rank + (0 if g is None else 9),
        condition=condition,
        valid_range=(float(rows.rate.min()), float(rows.rate.max())),
    )
    return model, residuals, [*findings, *_findings(model, fit, dwells)]


def _g_finding(g: FloatArray, *, felt: bool) -> Finding:
    if felt:
        size = float(np.abs(g).max()) * STANDARD_GRAVITY / RADIAN_PER_DEGREE
        return finding("rate_table.g_sensitivity", "info", dps_per_g=size)
    apart = float(np.ptp(g, axis=1).max()) * STANDARD_GRAVITY / RADIAN_PER_DEGREE
    level = level_of(apart, DRIFT_DPS)
    return finding("rate_table.axis_offset", level, offset_dps=apart, **_against(level, DRIFT_DPS))


def _findings(model: TriadModel, fit: GlsFit, dwells: DwellMeans) -> Iterator[Finding]:
    walks = [fit.excess[f"walk {axis}"] for axis in AXES if f"walk {axis}" in fit.excess and fit.shows(f"walk {axis}")]
    if walks:
        dps = max(walks) ** 0.5 * MINUTE_S**0.5 / RADIAN_PER_DEGREE
        level = level_of(dps, DRIFT_DPS)
        yield finding("rate_table.drift", level, dps_per_minute=dps, **_against(level, DRIFT_DPS))
    residual = 100.0 * model.rms_residual / float(np.abs(dwells.turn_rate).max())
    if residual > RESIDUAL_PERCENT[0]:
        level = level_of(residual, RESIDUAL_PERCENT)
        yield finding("rate_table.scatter", level, residual_percent=residual, **_against(level, RESIDUAL_PERCENT))
    yield from limited_by_codes("gyroscope", dwells.codes, np.diag(model.covariance)[9:12], dwells.unit)
    if dwells.axes is not None and np.isfinite(dwells.axes.off).any():
        off, uncertainty = dwells.axes.off[np.nanargmax(dwells.axes.off[:, 0])]
        stated = dwells.mount_tilt
        beyond = off - 2.0 * uncertainty > max(MOUNTED * 2.0**0.5 * stated, SMALL_ANGLE)
        yield finding(
            "rate_table.mounting", "warn" if beyond else "info",
            angle_deg=off / RADIAN_PER_DEGREE, stated_deg=stated / RADIAN_PER_DEGREE,
        )  # fmt: skip
    uncertain = 100.0 * model.relative_uncertainty
    yield from above("rate_table.uncertainty", uncertain, UNCERTAIN_PERCENT, uncertainty_percent=uncertain)
    if model.budget is not None and "ripple" in model.budget.sources:
        uneven = model.budget.uncertainty[model.budget.sources.index("ripple")][[0, 4, 8]] / np.diag(model.matrix)
        worst, axis = 100.0 * float(uneven.max()), AXES[int(uneven.argmax())]
        yield from above("rate_table.uneven_rate", worst, UNEVEN_PERCENT, axis=axis, uncertainty_percent=worst)


def _against(level: Level, limits: tuple[float, float]) -> dict[str, float | str]:
    return {"wanted": limits[0], "against": "within" if level == "info" else "wanted"}


def _chance(degrees_of_freedom: int) -> float:
    from scipy.special import chdtri

    return float(chdtri(degrees_of_freedom, CHANCE))


def scale_verdict(scale_factor: FloatArray, unit: str, axes: str = "xyz") -> Verdict:
    """Return marginal if a scale factor (K,) differs from the stated unit by more than data sheets allow, bad at twice that."""
    if not is_physical(unit):
        return Verdict()
    ratio = np.asarray(scale_factor) * si_factor(unit, "rate")
    worst = int(np.abs(ratio - 1.0).argmax())
    off = float(ratio[worst] - 1.0)
    if abs(off) <= OWN_SCALE:
        return Verdict()
    level = level_of(abs(off), (OWN_SCALE, 2.0 * OWN_SCALE))
    return Verdict.of(finding("gyro.scale_factor", level, axis=axes[worst], off_percent=100.0 * off))


# ---- false dwells: a rate stated with a wrong sign, value or axis
#
# One such dwell moves a least-squares fit, and an offset that may drift follows it. So before either, each sensor is fitted by
# least absolute deviations, which a few false dwells do not move:
#
#     (K, b) = argmin sum_i |s_i - K w_i - b|        e_i = K^-1 (s_i - b) - w_i, rad/s; with rests, + H a_i beside b
#
# A dwell is refused where |e_i| is beyond both limits: 8 times the typical |e|, the median over the dwells less one for every
# parameter that the fit makes exact; and 2 % of the largest rate, which the curvature of a sound sensor and
# the ripple of a table stay below.

SCATTERS = 8.0  # times the typical error: beyond any tail that noise, wobble or drift makes of a few tens of dwells
SHARE = 0.02  # of the largest rate
_LEAST_SPARE = 4  # equations beyond the four parameters of a sensor; with fewer, a false dwell does not stand out
_ROUNDS = 60


def check_dwells(
    dwells: DwellMeans, rates: FloatArray, *, rests: RestMeans | None = None, numbers: tuple[int, ...] | None = None
) -> None:
    """Raise when the reading of a dwell contradicts all the others; rates (N, 3), rad/s."""
    design, reading = np.column_stack((rates, np.ones(len(rates)))), dwells.reading
    if rests is not None:
        zero = np.column_stack((np.zeros_like(rests.reading), np.ones(len(rests.reading))))
        design, reading = np.vstack((design, zero)), np.vstack((reading, rests.reading))
        full = np.hstack((design, np.vstack((rests.dwell_force, rests.force))))
        if len(full) - 7 >= _LEAST_SPARE and scaled_condition(full)[0] == 7:
            design = full
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


# ---- from a session


def calibrate_rates(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to its turns at known rates; an entry of FITS."""
    session, own = seen.session, seen.settings
    latitude = own.latitude_deg
    dwells = dwell_means(session.records, session.turns, settle_s=own.settle_s, cutoff_hz=own.spline_cutoff_hz)
    dwells, creep = _on_table(seen, dwells, accel)
    rests = _rest_means(seen, dwells, None if accel is None else accel.model)
    numbers = tuple(k for k, t in enumerate(session.turns, 1) if t.axis is not None and t.turn_rate is not None)
    check_dwells(dwells, imposed_rates(dwells, latitude), rests=rests, numbers=numbers)
    findings = creep.findings()
    turned = {*dwells.axis}
    if mode != "paper" or len(turned) < 3:
        pieces: list[Still | Turn] = [
            *(t for t in session.turns if t.axis is not None and t.turn_rate is not None),
            *(() if rests is None else rests.stills),
        ]
        fit = fit_rate_table(
            dwells,
            rests,
            latitude_deg=latitude,
            cross_axis_prior=own.cross_axis_prior,
            creep=creep_of(seen, pieces, "gyro"),
        )
        if len(turned) < 3:
            verdict = fit.verdict.also(Verdict.of(*_nominal_findings(fit, dwells, own.cross_axis_prior)))
            fit = replace(fit, verdict=verdict)
        return Outcome(fit=fit, method="rate-table", findings=findings)
    offset = None
    if own.remove_offset:
        offset, variance = seen.rest_rate()
        if np.isnan(offset).any():
            offset = np.asarray(dwells.reading.mean(axis=0))  # both signs of every rate cancel
            variance = np.full(3, np.nan) if dwells.noise is None else (dwells.noise**2).mean(axis=0) / len(dwells.axis)
        dwells = replace(dwells, reading=dwells.reading - offset)
    paper: TriadFit = fit_rate_table(dwells, mode="paper", latitude_deg=latitude)
    paper = paper if offset is None else with_offset(paper, offset, variance)
    return Outcome(fit=paper, method="rate-table", findings=findings)


def _nominal_findings(fit: RateTableFit, dwells: DwellMeans, cross_axis_prior: float) -> Iterator[Finding]:
    """Yield the findings of a table that turned about one or two axes: results, and elements that keep their prior."""
    turned = tuple(line.axis for line in fit.linearity)
    missing = tuple(axis for axis in AXES if axis not in turned)
    physical = is_physical(dwells.unit)
    yield finding("rate_table.axes_missing", "warn", turned=turned, missing=missing)
    yield finding(
        "rate_table.nominal_kept",
        "warn",
        axes=[*missing],
        source="the unit's own" if physical else "that of the turned axes",
        scale_percent=100.0 * (SCALE_FACTOR if physical else SCALE_FACTOR_IN_COUNTS),
        cross_percent=100.0 * cross_axis_prior,
    )
    unit = si_factor(dwells.unit, "rate") if physical else RADIAN_PER_DEGREE
    for line in fit.linearity:
        k = AXES.index(line.axis)
        yield finding(
            "rate_table.axis",
            "info",
            axis=line.axis,
            scale=line.scale_factor * unit,
            unit="of the nominal scale" if physical else f"{dwells.unit} per deg/s",
            uncertainty_percent=100.0 * float(fit.model.standard_uncertainty[4 * k] / abs(fit.model.matrix[k, k])),
            nonlinearity_dps=line.scale_factor_nonlinearity / RADIAN_PER_DEGREE,
            nonlinearity_percent=line.scale_factor_nonlinearity_percent,
            asymmetry_percent=100.0 * line.scale_factor_asymmetry,
        )


def _on_table(seen: Observed, dwells: DwellMeans, accel: TriadFit | None) -> tuple[DwellMeans, Creep]:
    """Return the dwells with the axis of each in the case, and the temperature of each."""
    session, table = seen.session, seen.session.rate_table
    turns = [t for t in session.turns if t.axis is not None and t.turn_rate is not None]
    stretches = Dwells(
        records=session.records,
        turns=turns,
        mounting=mountings([*turns, *seen.stills])[: len(turns)],
        reading=dwells.reading,
        up=np.array(dwells.up),
        settle_s=seen.settings.settle_s,
    )
    axes = table_axes(stretches, table, None if accel is None else accel.model, session.gravity_m_s2)
    dwells = replace(dwells, axes=axes, mount_tilt=table.mount_tilt_deg * RADIAN_PER_DEGREE)
    return dwells, creep_of(seen, turns, "gyro")


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
        span=spans_of(records, rests),
        felt=accel is not None,
        stills=tuple(rests),
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
