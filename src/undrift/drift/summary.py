"""What a thermal fit comes to, in SI units and per sensor: what a page, a picture and a terminal show.

A reading's departure from the constant offset (from zero where none was calibrated), turned into the physical unit by the sensor's
own scale factor::

    y = (u - offset) / scale_factor        scale_factor = row length of K = M^-1, raw unit per rad/s or m/s2

Accelerometers that were seen in one pose show gravity too: theirs is the change since the reference temperature, or, where none
is known, since the middle of the temperatures seen.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import Calibration, ScaleDrift, StaticDrift, TriadModel
from undrift.drift.fit.accel import AccelDriftFit
from undrift.drift.fit.hysteresis import cooling
from undrift.drift.fit.offsets import Offsets, accel_offsets, gyro_offsets
from undrift.drift.fit.scale import ScaleFit
from undrift.drift.fit.static import StaticFit, StaticSettings, TriadDrift
from undrift.drift.observe.observations import RestBlocks
from undrift.units import is_physical, si_factor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadSummary:
    """Offset over temperature of three sensors: n nodes, k blocks of rest.

    Parameters
    ----------
    unit : str
        rad/s or m/s2; the raw unit where nothing says what it is worth.
    seen_c : tuple of float
        Least and greatest temperature seen, degC.
    temp_c : array, shape (n,)
        Nodes, degC.
    against : str
        What the departure is from: the constant offset, zero, or the reading at a temperature.
    departure, uncertainty : array, shape (n, 3)
        Of each node, ``unit``.
    extrapolated : array of bool, shape (n,)
        True where no data were near.
    in_table : bool
        False where only the change is known, so that no table was made.
    slope, slope_uncertainty : array, shape (3,)
        Mean over the temperatures seen, ``unit`` per K.
    left_out_rms : array, shape (3,)
        Error of temperatures that the others foretell, ``unit``; NaN where there are too few.
    half_loop, half_loop_uncertainty : array, shape (3,), or None
        Cooling minus warming, over two, ``unit``; None where not both directions were seen.
    loop_kept : bool
        Whether the loop is significant and part of the table.
    turn_on : array, shape (3,), or None
        Standard deviation from session to session, ``unit``; None for one session.
    block_temp_c : array, shape (k,)
        Of the blocks, degC; may be empty.
    block_departure : array, shape (k, 3)
        Of the blocks, ``unit``.
    block_cooling : array, shape (k,)
        1 while cooling, -1 while warming.
    """

    unit: str
    seen_c: tuple[float, float]
    temp_c: FloatArray
    against: str
    departure: FloatArray
    uncertainty: FloatArray
    extrapolated: BoolArray
    in_table: bool
    slope: FloatArray
    slope_uncertainty: FloatArray
    left_out_rms: FloatArray
    half_loop: FloatArray | None
    half_loop_uncertainty: FloatArray | None
    loop_kept: bool
    turn_on: FloatArray | None
    block_temp_c: FloatArray
    block_departure: FloatArray
    block_cooling: FloatArray

    @property
    def usual_uncertainty(self) -> FloatArray:
        """Median standard uncertainty of the nodes that data were near, shape (3,), ``unit``; of all where none were."""
        near = self.uncertainty[~self.extrapolated] if not self.extrapolated.all() else self.uncertainty
        return np.asarray(np.median(near, axis=0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleSummary:
    """Scale factors over temperature against the calibration's, n nodes and S soaks.

    Parameters
    ----------
    temp_c : array, shape (n,)
        Nodes, degC.
    percent, uncertainty : array, shape (n, 3)
        Departure of each axis' scale factor from the calibration's, %, with standard uncertainty.
    extrapolated : array of bool, shape (n,)
        True where no data were near.
    soak_temp_c : array, shape (S,)
        degC.
    soak_percent, soak_uncertainty : array, shape (S, 3)
        What each soak says, %; NaN where it did not turn about the axis.
    """

    temp_c: FloatArray
    percent: FloatArray
    uncertainty: FloatArray
    extrapolated: BoolArray
    soak_temp_c: FloatArray
    soak_percent: FloatArray
    soak_uncertainty: FloatArray


def summarise_gyro(
    static: StaticFit, rests: RestBlocks, device: Calibration, settings: StaticSettings
) -> TriadSummary | None:
    """Return what the gyroscopes' offsets come to.

    Parameters
    ----------
    static : StaticFit
        Curves and table.
    rests : RestBlocks
        What they rest on.
    device : Calibration
        With gyroscopes, for a physical unit.
    settings : StaticSettings
        Of the fit.

    Returns
    -------
    TriadSummary or None
        None without gyroscopes.
    """
    found, model = static.gyro, device.gyro
    offsets = gyro_offsets(rests, device, settings.latitude_deg)
    if found is None or found.offset is None or offsets is None:
        return None
    factor, unit = _factor(model, "rate", "")
    constant = model is not None and model.method != "nominal"
    zero = (np.zeros(3) if model is None else model.offset, "the constant offset" if constant else "zero")
    return _summary(found, offsets, static.table, found.offset, zero, (factor, unit))


def summarise_accel(
    static: StaticFit, poses: AccelDriftFit | None, rests: RestBlocks, device: Calibration, settings: StaticSettings
) -> TriadSummary | None:
    """Return what the accelerometers' offsets come to: from poses where these told them, else from one pose.

    Parameters
    ----------
    static : StaticFit
        Curves of one pose.
    poses : AccelDriftFit or None
        From poses at several temperatures.
    rests : RestBlocks
        What they rest on.
    device : Calibration
        With accelerometers, for a physical unit.
    settings : StaticSettings
        Of the fit.

    Returns
    -------
    TriadSummary or None
        None without accelerometers, or where their readings cannot be gravity.
    """
    model = device.accel
    factor, unit = _factor(model, "accel", settings.accel_unit)
    if poses is not None and model is not None:
        return _of_poses(poses, model, factor)
    offsets, found = accel_offsets(rests, device, settings.accel_unit), static.accel
    if found is None or isinstance(offsets, str):
        return None
    reference = device.reference_temp_c if model is not None else np.nan
    if not np.isfinite(reference):
        reference = 0.5 * (found.span_c[0] + found.span_c[1])
    zero = (found.curve.spline.at(np.array([reference])).value[0], f"that at {reference:.1f} degC")
    value = found.curve.spline.at(static.table.temp_c).value
    return _summary(found, offsets, static.table, value, zero, (factor, unit))


def summarise_scale(fit: ScaleFit, device: Calibration) -> ScaleSummary | None:
    """Return scale factors over temperature against those of the calibration.

    Parameters
    ----------
    fit : ScaleFit
        Matrix over temperature.
    device : Calibration
        With gyroscopes.

    Returns
    -------
    ScaleSummary or None
        In percent; None without gyroscopes.
    """
    drift: ScaleDrift = fit.drift
    if device.gyro is None or drift.gyro_matrix is None:
        return None
    kept = device.gyro.forward_matrix.diagonal() / si_factor(device.gyro.unit_out, "rate")
    own = np.linalg.inv(drift.gyro_matrix).diagonal(axis1=1, axis2=2) / si_factor(device.gyro.unit_out, "rate")
    matrix = drift.gyro_matrix.diagonal(axis1=1, axis2=2)
    doubt = drift.gyro_uncertainty
    n = len(drift.temp_c)
    return ScaleSummary(
        temp_c=drift.temp_c,
        percent=100.0 * (own / kept - 1.0),
        uncertainty=np.full((n, 3), np.nan)
        if doubt is None
        else 100.0 * np.abs(doubt.diagonal(axis1=1, axis2=2) / matrix),
        extrapolated=np.zeros(n, bool) if drift.gyro_extrapolated is None else drift.gyro_extrapolated,
        soak_temp_c=fit.soaks.temp_c,
        soak_percent=100.0 * (fit.soaks.forward.diagonal(axis1=1, axis2=2) / kept - 1.0),
        soak_uncertainty=100.0 * np.sqrt(fit.soaks.variance.diagonal(axis1=1, axis2=2)) / np.abs(kept),
    )


def _factor(model: TriadModel | None, quantity: str, unit: str) -> tuple[FloatArray, str]:
    """Return the physical unit per raw unit of each sensor, and its name; the raw unit where nothing tells it."""
    rate = quantity == "rate"
    if model is not None:
        return si_factor(model.unit_out, "rate" if rate else "accel") / model.scale_factor, "rad/s" if rate else "m/s2"
    if is_physical(unit):
        return np.full(3, si_factor(unit, "rate" if rate else "accel")), "rad/s" if rate else "m/s2"
    return np.ones(3), unit or "raw unit"


def _summary(
    found: TriadDrift,
    offsets: Offsets,
    table: StaticDrift,
    value: FloatArray,
    reference: tuple[FloatArray, str],
    units: tuple[FloatArray, str],
) -> TriadSummary:
    zero, factor = reference[0], units[0]
    loop, turn_on = found.curve.loop, found.curve.turn_on
    return TriadSummary(
        unit=units[1],
        seen_c=found.span_c,
        temp_c=table.temp_c,
        against=reference[1],
        departure=(value - zero) * factor,
        uncertainty=found.uncertainty * factor,
        extrapolated=found.extrapolated,
        in_table=found.offset is not None,
        slope=found.slope * factor,
        slope_uncertainty=found.slope_uncertainty * factor,
        left_out_rms=found.leave_out_rms * factor,
        half_loop=None if loop is None else loop.half * factor,
        half_loop_uncertainty=None if loop is None else loop.uncertainty * factor,
        loop_kept=found.curve.kept_loop,
        turn_on=None if turn_on is None else np.sqrt(turn_on.variance) * factor,
        block_temp_c=offsets.blocks.temp_c,
        block_departure=(offsets.value - zero) * factor,
        block_cooling=cooling(offsets.blocks),
    )


def _of_poses(poses: AccelDriftFit, model: TriadModel, factor: FloatArray) -> TriadSummary:
    near = np.flatnonzero(~poses.extrapolated)
    first, last = (near[0], near[-1]) if len(near) > 1 else (0, -1)
    span = poses.temp_c[last] - poses.temp_c[first]
    doubt = poses.offset_uncertainty
    return TriadSummary(
        unit="m/s2",
        seen_c=(float(poses.temp_c[first]), float(poses.temp_c[last])),
        temp_c=poses.temp_c,
        against="the constant offset",
        departure=(poses.offset - model.offset) * factor,
        uncertainty=doubt * factor,
        extrapolated=poses.extrapolated,
        in_table=True,
        slope=(poses.offset[last] - poses.offset[first]) / span * factor,
        slope_uncertainty=np.hypot(doubt[last], doubt[first]) / span * factor,
        left_out_rms=np.full(3, np.nan),
        half_loop=None,
        half_loop_uncertainty=None,
        loop_kept=False,
        turn_on=None,
        block_temp_c=np.zeros(0),
        block_departure=np.zeros((0, 3)),
        block_cooling=np.zeros(0),
    )
