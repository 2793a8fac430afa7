"""Rate table with an axis missing: what the turns about the others show, in words for a verdict.

::

    K_jj of each stated axis j, its departure from a straight line, its asymmetry, and K_jj against the scale of the unit
"""

from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.dwells import DwellMeans
from undrift.calibration.fit.rate_table import RateAxisFit, RateTableSettings, fit_rate_axis
from undrift.calibration.model import AXES, Verdict
from undrift.errors import Implausible
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

OWN_SCALE = 0.05  # a part that is trimmed in the factory is within 1 to 3 % of its sensitivity; no word of its maker allows more


def fit_rate_axes(dwells: DwellMeans, settings: RateTableSettings = RateTableSettings()) -> tuple[RateAxisFit, ...]:
    """Fit each axis that was turned, alone.

    Parameters
    ----------
    dwells : DwellMeans
        Mean readings at achieved rates.
    settings : RateTableSettings
        Earth rate and checks.

    Returns
    -------
    tuple of RateAxisFit
        One for each axis with two rates or more, x first.

    Raises
    ------
    Implausible
        A sensor that reads the turns reversed or not at all, or a scale factor off the stated sensitivity.
    """
    fits = []
    for axis in AXES:
        rows = [k for k, name in enumerate(dwells.axis) if name == axis]
        if len(np.unique(dwells.turn_rate[rows])) > 1:
            fit = fit_rate_axis(_only(dwells, rows), replace(settings, scale_tolerance=float("inf")))
            _check_sees(fit)
            fits.append(fit_rate_axis(_only(dwells, rows), settings))
    return tuple(fits)


def told_axis(fit: RateAxisFit) -> str:
    """Return what the turns about one axis show, as one sentence.

    Parameters
    ----------
    fit : RateAxisFit
        Fit of that axis.

    Returns
    -------
    str
        Scale factor, departure from the line, asymmetry.
    """
    line, own = fit.linearity, AXES.index(fit.axis)
    sigma = float(np.sqrt(fit.covariance[own, own])) / abs(fit.scale_factor)
    bent = "" if np.isnan(line.scale_factor_asymmetry) else f", asymmetry {100.0 * line.scale_factor_asymmetry:.2g} %"
    doubt = "" if np.isnan(sigma) else f" to within {100.0 * sigma:.2g} %"
    if is_physical(fit.unit_in):
        scale = f"{fit.scale_factor * si_factor(fit.unit_in, 'rate'):.4f} of the unit's own"
    else:
        scale = f"{fit.scale_factor * RADIAN_PER_DEGREE:.5g} {fit.unit_in} per deg/s"
    return (
        f"turns about {fit.axis}: scale factor {scale}{doubt}, departure from a straight line up to "
        f"{line.scale_factor_nonlinearity / RADIAN_PER_DEGREE:.2g} deg/s ({line.scale_factor_nonlinearity_percent:.2g} %){bent}"
    )


def scale_verdict(scale_factor: FloatArray, unit: str, axes: str = "xyz") -> Verdict:
    """Return marginal where a scale factor is further from the unit's own than makers allow, good elsewhere.

    Parameters
    ----------
    scale_factor : array, shape (K,)
        Reading per rad/s.
    unit : str
        Unit of the readings; counts and volts have no scale of their own.
    axes : str
        Axis of each.

    Returns
    -------
    Verdict
        With the largest departure in per cent.
    """
    if not is_physical(unit):
        return Verdict()
    ratio = np.asarray(scale_factor) * si_factor(unit, "rate")
    worst = int(np.abs(ratio - 1.0).argmax())
    off = float(ratio[worst] - 1.0)
    if abs(off) <= OWN_SCALE:
        return Verdict()
    return Verdict(
        status="marginal",
        reasons=(
            f"the scale factor of {axes[worst]} is {100.0 * off:+.1f} % off the unit's own scale: implausible for any sensor of a "
            "few per cent; check the conversion from counts, the range setting, the stated rates or angles and the sample rate",
        ),
    )


def _only(dwells: DwellMeans, rows: list[int]) -> DwellMeans:
    up = np.broadcast_to(dwells.up, len(dwells.axis))
    return replace(
        dwells,
        reading=dwells.reading[rows],
        turn_rate=dwells.turn_rate[rows],
        axis=tuple(dwells.axis[k] for k in rows),
        noise=None if dwells.noise is None else dwells.noise[rows],
        up=up[rows],
        time=None if dwells.time is None else dwells.time[rows],
    )


def _check_sees(fit: RateAxisFit) -> None:
    own, most = AXES.index(fit.axis), int(np.abs(fit.column).argmax())
    if most != own or fit.scale_factor < 0.0:
        reads = f"{'-' if fit.column[most] < 0.0 else '+'}{AXES[most]}"
        raise Implausible(
            f"turns about {fit.axis}: wanted the {fit.axis} gyroscope to read + for turns about +{fit.axis}, got column "
            f"{AXES[most]} that reads them as {reads}; correct the sign or axis of the turns, or the order or sign of the columns",
            reads=reads,
        )
