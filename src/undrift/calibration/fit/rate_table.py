"""Rate table: gyroscopes against imposed steady rates, each axis up in turn, both signs (eqs. 4-6 of the note).

    paper      C = L S^T (S S^T)^-1            L (3, N) achieved rates, S (3, N) mean readings; offset already removed
    affine     s = K w + b                     12 parameters by least squares

L holds the rates that the table achieved, never the nominal ones: at 40,000 counts a turn the note's 0.1 deg/s is 0.099. The
Earth's rotation adds its vertical part, Omega sin(latitude), to the axis that points up; the horizontal part averages out
over whole turns. Which rates: protocol.py.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.axis_order import check_axis_order
from undrift.calibration.fit.dwells import DwellMeans
from undrift.calibration.fit.linear import fit_forward, fit_paper, offset_warning, triad_from_forward
from undrift.calibration.fit.linearity import Linearity, linearity
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.model import AXES, Verdict
from undrift.calibration.plausibility import axis_vectors, check_scale_factor
from undrift.earth import EARTH_RATE
from undrift.errors import InputError, NotObservable
from undrift.session import Axis
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

_AXES: tuple[Axis, ...] = ("x", "y", "z")

RateTableMode = Literal["paper", "affine"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RateTableSettings:
    """How dwells are fitted.

    Parameters
    ----------
    mode : str
        paper or affine.
    latitude_deg : float or None
        Where the table stands, deg, to add the Earth's rate to a vertical axis; None leaves it out.
    stated_scale : float or None
        Sensitivity the maker states, reading per rad/s; None takes the unit's own where it is physical.
    scale_tolerance : float
        Relative tolerance of the sensitivity: 0.03 for a part of +-3 %.
    """

    mode: RateTableMode = "affine"
    latitude_deg: float | None = None
    stated_scale: float | None = None
    scale_tolerance: float = 0.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateTableFit(TriadFit):
    """Gyroscopes fitted to a rate table; ``residuals`` are corrected less imposed rate, rad/s, one row a dwell.

    Parameters
    ----------
    axis : tuple of str
        Axis of each dwell.
    turn_rate : array, shape (N,)
        Achieved rate of each dwell, rad/s.
    linearity : tuple of Linearity
        Own-axis table, nonlinearity and asymmetry of each axis.
    """

    axis: tuple[Axis, ...]
    turn_rate: FloatArray
    linearity: tuple[Linearity, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateAxisFit:
    """What turns about one axis alone determine: one column of the forward matrix, and the offsets.

    Parameters
    ----------
    axis : str
        Axis of the turns.
    column : array, shape (3,)
        Reading of each sensor per rad/s about the axis: scale factor on the axis, cross-axis sensitivity off it.
    offset : array, shape (3,)
        Reading of each sensor at zero rate.
    covariance : array, shape (6, 6)
        Of column, then offset.
    residuals : array, shape (N, 3)
        Reading less model.
    linearity : Linearity
        Own-axis table.
    unit_in : str
        Unit of the readings.
    verdict : Verdict
        Names what was not observable and which recording would show it.
    """

    axis: Axis
    column: FloatArray
    offset: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    linearity: Linearity
    unit_in: str
    verdict: Verdict

    @property
    def scale_factor(self) -> float:
        """Reading of the axis' own sensor per rad/s."""
        return float(self.column[AXES.index(self.axis)])


def fit_rate_table(dwells: DwellMeans, settings: RateTableSettings = RateTableSettings()) -> RateTableFit:
    """Fit gyroscopes to the dwells of a rate table.

    Parameters
    ----------
    dwells : DwellMeans
        Mean readings at achieved rates about three axes.
    settings : RateTableSettings
        Mode, Earth rate and checks.

    Returns
    -------
    RateTableFit
        Inverse model to rad/s, with the table of residuals.

    Raises
    ------
    NotObservable
        An axis without turns.
    Implausible
        A left-handed triad, or a scale factor off the stated sensitivity.
    """
    lacking = [axis for axis in AXES if axis not in dwells.axis]
    if lacking:
        raise NotObservable(
            f"rate table: wanted dwells about x, y and z, got none about {', '.join(lacking)}; mount the device with "
            f"{', '.join(lacking)} along the table's axis",
            missing=tuple(lacking),
        )
    rates = imposed_rates(dwells, settings.latitude_deg)
    method = f"rate-table/{settings.mode}"
    if settings.mode == "paper":
        fit = fit_paper(rates, dwells.reading, dwells.noise, method=method, unit_in=dwells.unit, unit_out="rad/s")
        verdict = offset_warning(fit, rates, dwells.reading, dwells.noise)
    else:
        forward = fit_forward(rates, dwells.reading, dwells.noise)
        span = (float(rates.min()), float(rates.max()))
        fit = triad_from_forward(
            forward, method=method, unit_in=dwells.unit, unit_out="rad/s", valid_range=span, verdict=Verdict()
        )
        verdict = Verdict()
    check_axis_order(fit.model.forward_matrix, "rate table", against="turns")
    _check_scale(fit.model.scale_factor, dwells.unit, settings, "gyroscope")
    return RateTableFit(
        model=fit.model,
        residuals=fit.residuals,
        verdict=verdict,
        axis=dwells.axis,
        turn_rate=dwells.turn_rate,
        linearity=tuple(_own_axis(dwells, axis) for axis in _AXES),
    )


def fit_rate_axis(dwells: DwellMeans, settings: RateTableSettings = RateTableSettings()) -> RateAxisFit:
    """Fit what turns about a single axis show: scale factor, cross-axis column and offsets.

    Parameters
    ----------
    dwells : DwellMeans
        Mean readings at achieved rates, all about one axis.
    settings : RateTableSettings
        Earth rate and checks; the mode is affine.

    Returns
    -------
    RateAxisFit
        One column of K, with words for what is left open.

    Raises
    ------
    InputError
        Turns about more than one axis.
    NotObservable
        Fewer than two rates.
    Implausible
        A scale factor off the stated sensitivity.
    """
    axes = sorted(set(dwells.axis))
    if len(axes) != 1:
        raise InputError(f"rate axis: wanted turns about one axis, got {', '.join(axes) or 'none'}; use fit_rate_table")
    axis, own = dwells.axis[0], AXES.index(dwells.axis[0])
    table = linearity(dwells.reading[:, own], dwells.turn_rate, axis)
    rate = imposed_rates(dwells, settings.latitude_deg)[:, own]
    design = np.column_stack((rate, np.ones_like(rate)))
    theta = np.linalg.lstsq(design, dwells.reading, rcond=None)[0]
    residuals = dwells.reading - design @ theta
    spare = len(rate) - 2
    variance = (residuals**2).sum(axis=0) / (spare - 2 if spare > 2 else np.nan)
    _check_scale(np.abs(theta[0, own : own + 1]), dwells.unit, settings, f"gyroscope {axis}")
    others = " and ".join(a for a in AXES if a != axis)
    return RateAxisFit(
        axis=axis,
        column=theta[0],
        offset=theta[1],
        covariance=np.kron(np.linalg.inv(design.T @ design), np.diag(variance)),
        residuals=residuals,
        linearity=table,
        unit_in=dwells.unit,
        verdict=Verdict(
            status="marginal",
            reasons=(
                f"turns about {axis} alone do not show the scale factors of {others}, nor how they see each other's axis: "
                f"mount the device with {others} along the table's axis and turn again",
            ),
        ),
    )


def imposed_rates(dwells: DwellMeans, latitude_deg: float | None) -> FloatArray:
    """Return the true rate of each dwell in b: L of eq. 4, transposed.

    Parameters
    ----------
    dwells : DwellMeans
        Achieved rates, axes, and which way each axis points.
    latitude_deg : float or None
        deg; None leaves the Earth's rate out.

    Returns
    -------
    array, shape (N, 3)
        rad/s.
    """
    earth = 0.0 if latitude_deg is None else EARTH_RATE * np.sin(latitude_deg * RADIAN_PER_DEGREE)
    rates: FloatArray = axis_vectors(dwells.axis) * (dwells.turn_rate + earth * dwells.up)[:, None]
    return rates


def _own_axis(dwells: DwellMeans, axis: Axis) -> Linearity:
    rows = np.array([a == axis for a in dwells.axis])
    return linearity(dwells.reading[rows, AXES.index(axis)], dwells.turn_rate[rows], axis)


def _check_scale(scale: FloatArray, unit: str, settings: RateTableSettings, what: str) -> None:
    stated = settings.stated_scale
    if stated is None and is_physical(unit):
        stated = 1.0 / si_factor(unit, "rate")
    if stated is not None:
        check_scale_factor(scale, stated, settings.scale_tolerance, what)
