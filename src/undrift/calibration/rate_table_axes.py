"""Turns of a rate table about one or two axes: their columns of K are fitted, the others keep the nominal scale.

    s = K_t w_t + b          K_t the columns of the turned axes, with their covariance
    K_j = S e_j              S the unit's own scale, +- 3 %; of counts the mean scale of the turned axes, +- 20 %

Cross-axis terms of the other columns are 0 +- the stated prior, of the scale.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.checks import check_own_scale
from undrift.calibration.dwells import DwellMeans, Linearity, imposed_rates, linearity, with_table_errors
from undrift.calibration.table_axis import table_findings
from undrift.errors import Implausible, InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.least_squares import ForwardFit, TriadFit, scaled_condition, student_variance, triad_from_forward
from undrift.model import AXES, Verdict
from undrift.record import Axis
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

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
    return replace(fit, model=with_table_errors(fit.model, whole), verdict=verdict)


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
    axis, own = dwells.axis[0], AXES.index(dwells.axis[0])
    table = linearity(dwells.reading[:, own], dwells.turn_rate, axis)
    rate = imposed_rates(dwells, latitude_deg)[:, own]
    design = np.column_stack((rate, np.ones_like(rate)))
    theta = np.linalg.lstsq(design, dwells.reading, rcond=None)[0]
    residuals = dwells.reading - design @ theta
    variance = [student_variance(column, len(rate) - 2) for column in residuals.T]
    most = int(np.abs(theta[0]).argmax())
    if most != own or theta[0, own] < 0.0:
        reads = f"{'-' if theta[0, most] < 0.0 else '+'}{AXES[most]}"
        raise Implausible(
            f"turns about {axis}: wanted the {axis} gyroscope to read + for turns about +{axis}, got column {AXES[most]} "
            f"that reads them as {reads}; correct the sign or axis of the turns, or the order or sign of the columns",
            reads=reads,
        )
    check_own_scale(float(theta[0, own]), dwells.unit, "rate", scale_tolerance, f"gyroscope {axis}")
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
