"""Calibrate gyroscopes on a rate table: steady known rates, each axis up in turn, in both directions (eqs. 4-6 of the note).

    paper      C = L S' (S S')^-1              achieved rates L (3, N), mean readings S (3, N) without their offset
    affine     M u - c - G f = w + errors      M (3, 3), c = M o, G the g-sensitivity, w = 0 at rest

L contains the rates that the table achieved, not the nominal rates. At 40,000 counts per turn, the note's 0.1 deg/s is 0.099. The
Earth's rotation adds its vertical part, Omega sin(latitude), to the axis that points up. Its horizontal part averages out over
whole turns. f is the specific force from the accelerometers. Without accelerometers it is along the labelled faces of the rests.

Sources of error of dwell or rest i, in the frame of the case:

    noise, adc     M n_i                       noise and rounding of the mean
    rate           w_i r                       common error of all given rates
    mounting       w_i (d_i + e_i)             axis of the table (measured with gravity, or given) and its wobble
    ripple         w_i u_i                     differences of the rate from dwell to dwell, and ripple that whole turns do not
                                               average out
    temperature    warmth_i (alpha + beta w_i) dependence of offset and scale on temperature
    instability    flicker, drift and q_k B    offset, with the covariance B of a random walk about its mean over the session

The sizes of e, u and q_k of each sensor are excess variances of the residuals (fit/gls.py). The offset is the mean over the
session. Parameters that the session does not determine keep their prior: G, and the columns of axes that the table did not turn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import limited_by_codes, rounding_correlation
from undrift.calibration.plausibility import check_axis_order, check_own_scale, face_vectors
from undrift.calibration.quality import steady
from undrift.calibration.session import Observed, spans_of, with_offset
from undrift.calibration.settings import Mode
from undrift.calibration.sources import Creep, creep_of, gyro_drift, noise_and_codes, offset_drift, uncertain, walks_of
from undrift.calibration.table import NOTE_CUTOFF_HZ, DwellMeans, dwell_means, imposed_rates, mountings, table_axes
from undrift.errors import Implausible, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.gls import GlsFit, Prior, block_size, fit_huber, noise_of_means, solve_inverse
from undrift.fit.priors import G_SENSITIVITY, SCALE_FACTOR, SCALE_FACTOR_IN_COUNTS, UNCERTAIN_PERCENT
from undrift.fit.triad import TriadFit, fit_of, fit_paper, parameters_of
from undrift.model import AXES, TriadModel
from undrift.record import Record, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

MIN_NOISE = 1e-9  # relative to the largest reading, the arithmetic error of the filter
WHOLE_TURN = 0.9 * 2.0 * np.pi  # a whole turn minus the last sample, rad
SPREAD = 2.0  # spread of the distance of two inputs, relative to the spread if their rounding errors were independent

# ---- fit of dwells and rests

NO_TURNS = "rate table: expected dwells at two different rates or more about an axis, got none about x, y, z. Record both signs."


def fit_rate_table(
    dwells: DwellMeans,
    *,
    mode: Mode = "affine",
    latitude_deg: float | None = None,
    cross_axis_prior: float = 0.01,
    creep: Creep | None = None,
) -> TriadFit:
    """Fit gyroscopes to the dwells and rests on a rate table, with the Earth's rate on a vertical axis for a latitude in deg.

    Residuals are corrected minus true rates, rad/s. For an axis that the table did not turn, the column keeps the nominal scale
    factor, with cross-axis terms of ``cross_axis_prior``.
    """
    turn_axes, rates = _check_turn_axes(dwells), imposed_rates(dwells, latitude_deg)
    if mode == "paper" and len(turn_axes) < 3:
        missing_axes = ", ".join(axis for k, axis in enumerate(AXES) if k not in turn_axes)
        raise NotObservable(
            f"rate table, mode paper: expected turns about x, y and z, got none about {missing_axes}. Record them."
        )
    matrix = first_table_matrix(rates, dwells.reading, turn_axes, dwells.unit)
    check_axis_order(np.linalg.inv(matrix), "rate table", against="turns")
    sources = _sources(dwells, rates, matrix)
    if creep is not None:
        sources["temperature"] = creep.covariance_in_case(rates)
    prior = table_prior(matrix, turn_axes, dwells.force is not None, dwells.unit, cross_axis_prior)
    gls = solve_inverse(dwells.reading, rates, dwells.force, matrix, sources, excess=_excess(dwells), prior=prior)
    names: dict[str, Any] = {"method": f"rate-table/{mode}", "unit_in": dwells.unit, "unit_out": "rad/s"}
    if mode == "paper":
        fit = fit_paper(rates, dwells.reading, gls, **names)
    else:
        parameters = parameters_of(gls, with_g=dwells.felt)
        fit = fit_of(parameters, rates, -gls.residuals.reshape(-1, 3), **names)
        fit = fit.also(*_findings(fit.model, gls, dwells))
    check_own_scale(fit.model.scale_factor, dwells.unit, "rate", "gyroscope")
    return fit


def _check_turn_axes(dwells: DwellMeans) -> list[int]:
    """Return the axes that the table turned at two rates or more. Raise if an axis has the wrong order, sign or scale."""
    turn_axes = list[int]()
    for k, axis in enumerate(AXES):
        rows = [n for n, name in enumerate(dwells.axis) if name == axis]
        if len(np.unique(dwells.turn_rate[rows])) < 2:
            continue
        turn_axes.append(k)
        if len({*dwells.axis} - {None}) < 3:  # with three axes, the whole matrix reveals exchanged columns
            slope = np.polyfit(dwells.turn_rate[rows], dwells.reading[rows], 1)[0]
            check_reads_positive(slope, k)
            check_own_scale(slope[k], dwells.unit, "rate", f"gyroscope {axis}")
    if not turn_axes:
        raise NotObservable(NO_TURNS)
    return turn_axes


def check_reads_positive(slope: FloatArray, k: int) -> None:
    """Raise if turns about +axis k do not give gyroscope k the largest positive slope. Slope (3,) is reading per rate or angle."""
    most = int(np.abs(slope).argmax())
    if most != k or slope[k] < 0.0:
        reads = f"{'-' if slope[most] < 0.0 else '+'}{AXES[most]}"
        raise Implausible(
            f"turns about {AXES[k]}: expected the {AXES[k]} gyroscope to read + for turns about +{AXES[k]}, got column "
            f"{AXES[most]} that reads them as {reads}. Correct the sign or axis of the turns, or the order or sign of the columns.",
            reads=reads,
        )


# ---- rows and sources


def first_table_matrix(rate: FloatArray, reading: FloatArray, turn_axes: Sequence[int], unit: str) -> FloatArray:
    """Return a first matrix M: least squares for the turned axes, the nominal scale factor for the others."""
    design = np.column_stack((rate[:, turn_axes], np.ones(len(rate))))
    slopes = np.linalg.lstsq(design, reading, rcond=None)[0][:-1]
    forward = np.eye(3) * (
        1.0 / si_factor(unit, "rate") if is_physical(unit) else np.mean([slopes[n, k] for n, k in enumerate(turn_axes)])
    )
    forward[:, turn_axes] = slopes.T
    return np.asarray(np.linalg.inv(forward))


def table_prior(
    matrix: FloatArray, turn_axes: Sequence[int], force: bool, unit: str, cross_axis_prior: float
) -> Prior | None:
    """Return the prior of M, c and G: the nominal scale in the columns of axes that were not turned, and the g-sensitivity."""
    size = 21 if force else 12
    precision, mean = np.zeros((size, size)), np.zeros(size)
    precision[range(12, size), range(12, size)] = G_SENSITIVITY**-2
    scale = SCALE_FACTOR if is_physical(unit) else SCALE_FACTOR_IN_COUNTS
    for column in {0, 1, 2} - {*turn_axes}:
        for row in range(3):
            place = 3 * row + column
            mean[place] = matrix[column, column] if row == column else 0.0
            relative = scale if row == column else cross_axis_prior
            precision[place, place] = (matrix[column, column] * relative) ** -2
    return Prior(mean=mean, precision=precision) if precision.any() else None


def _sources(dwells: DwellMeans, rates: FloatArray, matrix: FloatArray) -> dict[str, FloatArray]:
    """Return the covariances (3 N, 3 N) of the rows by known source, (rad/s)^2."""
    count, axes = len(rates), dwells.axes
    floor = (MIN_NOISE * float(np.abs(dwells.reading).max())) ** 2 + 1e-300
    noise = np.zeros_like(dwells.reading) if dwells.noise is None else dwells.noise**2
    codes = np.minimum(dwells.codes, noise)
    rounding = np.sqrt(codes[:, None] * codes) * _shared_rounding(dwells, rates, matrix, codes, floor)
    sources = noise_and_codes(matrix, np.maximum(noise - codes, floor), rounding)
    if dwells.span is not None:
        sources["instability"] = gyro_drift(dwells.span)
    if axes is not None:
        tilts = (axes.columns * dwells.turn_rate[:, None, None]).reshape(3 * count, -1)
        common = axes.rate * rates.ravel()
        sources["rate"] = np.outer(common, common)
        sources["mounting"] = tilts @ tilts.T
    return sources


def _shared_rounding(
    dwells: DwellMeans, rates: FloatArray, matrix: FloatArray, codes: FloatArray, floor: float
) -> FloatArray:
    """Return the correlation (N, N, 3) of the rounding errors of two rows, for their variance ``codes`` (N, 3).

    Equal inputs have equal errors. A plain fit of the readings gives the distance of two inputs, with its uncertainty. Equal
    readings can have different inputs, because a cross-axis term may be smaller than a step.
    """
    count, step = len(rates), np.where(dwells.codes > 0.0, dwells.step, 1.0)
    force = np.zeros((count, 0)) if dwells.force is None else dwells.force
    known = np.column_stack((np.ones(count), rates, force))
    # wobble of the axis and ripple of the rate move the readings of dwells
    scatter = dwells.reading - known @ np.linalg.lstsq(known, dwells.reading, rcond=None)[0]
    turning = (dwells.turn_rate != 0.0)[:, None]
    noise_of_fit = np.maximum(codes, turning * np.mean(scatter**2, axis=0, where=turning)).clip(floor)
    distance, spread = np.empty((2, count, count, 3))
    for k in range(3):
        noise = noise_of_fit[:, k]
        prior = np.zeros(known.shape[1])
        prior[4:] = (matrix[k, k] / G_SENSITIVITY) ** 2  # share due to the g-sensitivity of the readings
        covariance = np.linalg.pinv(known.T @ (known / noise[:, None]) + np.diag(prior), hermitian=True)
        inputs = known @ (covariance @ (known.T @ (dwells.reading[:, k] / noise)))
        shared = known @ covariance @ known.T
        variance = np.diag(shared)
        distance[:, :, k] = (inputs[:, None] - inputs) / step[k]
        spread[:, :, k] = SPREAD * np.sqrt((variance[:, None] + variance - 2.0 * shared).clip(0.0)) / step[k]
    share = np.sqrt(codes[:, None] * codes) / step**2
    return rounding_correlation(distance, spread, share)


def _excess(dwells: DwellMeans) -> dict[str, FloatArray]:
    """Return the covariance of each error of unknown size, for size 1: (3 N, 3 N), or its diagonal (3 N,)."""
    if dwells.noise is None:
        return {"noise": np.ones(dwells.reading.size)}
    along = (dwells.axis_b * dwells.turn_rate[:, None]).ravel()
    across = ((1.0 - dwells.axis_b) * dwells.turn_rate[:, None]).ravel()
    return {"mounting wobble": across**2, "ripple": along**2} | walks_of(dwells.span)


# ---- findings


def _findings(model: TriadModel, fit: GlsFit, dwells: DwellMeans) -> Iterator[Finding]:
    yield from offset_drift(fit)
    yield from limited_by_codes("gyroscope", dwells.codes, np.diag(model.covariance)[9:12], dwells.unit)
    percent = 100.0 * model.relative_uncertainty
    action = "Turn at more rates, dwell longer, and check the residual of each dwell."
    yield from uncertain("The gyroscope matrix", percent, UNCERTAIN_PERCENT, "%", action)


def _partial_turns(records: Sequence[Record], turns: Sequence[Turn], settle_s: float) -> Iterator[Finding]:
    """Yield a finding if a ripple of the rate does not average out, because fast dwells are shorter than a turn."""
    rates = np.array([abs(turn.turn_rate or 0.0) for turn in turns])
    times = [records[turn.recording].time[steady(records[turn.recording], turn, settle_s)] for turn in turns]
    angles = rates * [float(time[-1] - time[0]) for time in times]
    partial = int(((angles < WHOLE_TURN) & (rates >= 0.5 * rates.max())).sum())
    if partial:
        sentence = f"{partial} fast dwells are shorter than a turn, so a ripple of the table's rate changes the scale."
        yield finding("rate_table.partial_turns", "info", sentence, "Dwell for a whole turn at the fast rates.")


def axes_missing(turn_axes: Sequence[str], unit: str, cross_axis_prior: float) -> Finding:
    """Return a finding if there are only turns about one or two axes: the elements that keep their prior, and its size."""
    missing = tuple(axis for axis in AXES if axis not in turn_axes)
    scale_percent = 100.0 * (SCALE_FACTOR if is_physical(unit) else SCALE_FACTOR_IN_COUNTS)
    return finding(
        "rate_table.axes_missing",
        "warn",
        f"No turns about {', '.join(missing)}: scale (+- {scale_percent:g} %, 1 sigma) and cross-axis terms "
        f"(0 +- {100.0 * cross_axis_prior:g} %) are nominal.",
        f"Turn about {', '.join(missing)} as well.",
        turned=(*turn_axes,),
        missing=missing,
    )


# ---- false dwells: the given rate has a wrong sign, value or axis
#
# One such dwell biases a least-squares fit, and an offset that may drift follows it. Therefore each sensor is first fitted with
# Huber's weights, s = K w + b. Dwell i reads e_i = K^-1 (s_i - s) more than its rate. It is refused if |e_i| is beyond 8 times the
# typical |e|, the median over the rows minus one for every parameter that the fit makes exact, and beyond 2 % of the largest rate.
# The curvature of a sound sensor, its g-sensitivity, and the ripple of a table are smaller.

SCATTERS = 8.0  # limit relative to the typical error, beyond the tails of noise, wobble or drift in tens of dwells
SHARE = 0.02  # relative to the largest rate
LEAST_SPARE = 4  # number of equations in excess of a sensor's parameters, so that a false dwell can be recognised


def check_dwells(dwells: DwellMeans, rates: FloatArray, numbers: Sequence[int]) -> None:
    """Raise if the reading of a dwell contradicts all others at rates (N, 3), rad/s. Messages refer to dwells by ``numbers``."""
    design = np.column_stack((rates, np.ones(len(rates))))
    if len(design) - design.shape[1] < LEAST_SPARE or np.linalg.matrix_rank(design) < design.shape[1]:
        return
    theta = np.array([fit_huber(design, column)[0] for column in dwells.reading.T])
    if abs(np.linalg.det(theta[:, :3])) < 1e-6 * np.prod(np.linalg.norm(theta[:, :3], axis=1)):
        return  # two columns have the same readings; the fit itself reports this
    residual_rate = (dwells.reading - design @ theta.T) @ np.linalg.inv(theta[:, :3]).T
    error = np.linalg.norm(residual_rate, axis=1)
    typical = float(np.median(np.sort(error)[design.shape[1] :]))
    limit = max(SCATTERS * typical, SHARE * float(np.abs(rates).max()))
    wrong: list[int] = np.flatnonzero(error[: len(numbers)] > limit).tolist()
    if wrong:
        read = (rates + residual_rate) / RADIAN_PER_DEGREE
        contradictions = "; ".join(
            f"turn {numbers[k]}, {dwells.axis[k]} at {dwells.turn_rate[k] / RADIAN_PER_DEGREE:+.4g} deg/s: reads as "
            f"({', '.join(f'{value:+.4g}' for value in read[k])})"
            for k in wrong[:3]
        )
        raise Implausible(
            f"rate table: {len(wrong)} dwells contradict the others by more than {limit / RADIAN_PER_DEGREE:.2g} deg/s: "
            f"{contradictions}. Check their sign, value, axis and times, or leave them out.",
            turns=tuple(numbers[k] for k in wrong),
        )


# ---- from a session


def calibrate_rates(observed: Observed, mode: Mode, accel: TriadFit | None) -> TriadFit:
    """Fit the gyroscopes of a session to its turns at known rates."""
    session, settings = observed.session, observed.settings
    turns = [turn for turn in session.turns if turn.axis is not None and turn.turn_rate is not None]
    if not turns:
        raise NotObservable(NO_TURNS)
    cutoff_hz = NOTE_CUTOFF_HZ if mode == "paper" and settings.spline_cutoff_hz is None else settings.spline_cutoff_hz
    dwells = dwell_means(session.records, turns, settle_s=settings.settle_s, cutoff_hz=cutoff_hz)
    turn_axes = tuple(axis for axis in AXES if axis in dwells.axis)
    model = None if accel is None else accel.model
    axes = table_axes(
        session.records,
        turns,
        dwells,
        mountings([*turns, *observed.stills])[: len(turns)],
        table=session.rate_table,
        accel=model,
        gravity_m_s2=session.gravity_m_s2,
        settle_s=settings.settle_s,
    )
    dwells = replace(dwells, axes=axes)
    with_rests, rests = _join_rests(dwells, observed, turns, model)
    numbers = [k for k, turn in enumerate(session.turns, 1) if turn in turns]
    check_dwells(with_rests, imposed_rates(with_rests, settings.latitude_deg), numbers)
    offset = None
    if mode == "paper":
        offset, variance = observed.rest_rate()
        if np.isnan(offset).any():
            offset = np.asarray(dwells.reading.mean(axis=0))  # both signs of every rate cancel
            variance = np.full(3, np.nan) if dwells.noise is None else (dwells.noise**2).mean(axis=0) / len(dwells.axis)
    pieces: list[Still | Turn] = [*turns, *(() if mode == "paper" else rests)]
    findings = [*_partial_turns(session.records, turns, settings.settle_s)]
    if len(turn_axes) < 3:
        findings.append(axes_missing(turn_axes, dwells.unit, settings.cross_axis_prior))
    fit = fit_rate_table(
        with_rests if offset is None else replace(dwells, reading=dwells.reading - offset),
        mode=mode,
        latitude_deg=settings.latitude_deg,
        cross_axis_prior=settings.cross_axis_prior,
        creep=creep_of(observed, pieces, "gyro"),
    )
    fit = fit if offset is None else with_offset(fit, offset, variance)
    return fit.also(*findings)


def _join_rests(
    dwells: DwellMeans, observed: Observed, turning: Sequence[Turn], accel: TriadModel | None
) -> tuple[DwellMeans, list[Still]]:
    """Return dwells and rests with their specific force, and the rests, or only the dwells if there are no whole rests.

    Without accelerometers, only rests on labelled faces count, with gravity along the face.
    """
    records, rests = observed.session.records, sorted(observed.stills, key=lambda still: still.recording)
    if accel is None:
        rests = [rest for rest in rests if rest.face is not None]
    pieces: list[Turn | Still] = [*turning, *rests]
    parts = [records[piece.recording].part(piece.start, piece.stop) for piece in pieces]
    windows = [np.asarray(stretch.gyro, float) for stretch in parts[len(turning) :]]
    if not windows or any(np.isnan(window).any() for window in windows):
        return dwells, []
    noise = noise_of_means(windows, [block_size(records[rest.recording].sample_rate_hz) for rest in rests])
    if noise is None:
        return dwells, []
    if accel is None:
        faces = [rest.face for rest in rests if rest.face is not None]
        up = np.vstack((dwells.axis_b * dwells.up[:, None], face_vectors(faces)))
        force = up * observed.session.gravity_m_s2
    else:
        mean_force = np.array([np.nanmean(np.asarray(stretch.accel), axis=0) for stretch in parts])
        force = (mean_force - accel.offset) @ accel.matrix.T
    joined = dwells.with_rests(
        np.array([window.mean(axis=0) for window in windows]),
        noise=np.hypot(noise, np.sqrt(dwells.codes)),
        span=spans_of(records, rests),
        force=force,
    )
    return replace(joined, felt=accel is not None), rests
