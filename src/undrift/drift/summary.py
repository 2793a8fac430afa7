"""What a thermal fit comes to, in SI units and per sensor: for a page, a picture, a terminal.

A reading's departure from the constant offset (from zero where none was calibrated), in the physical unit by the sensor's own scale
factor::

    y = (u - offset) / scale_factor        scale_factor = row length of K = M^-1, raw unit per rad/s or m/s2

Accelerometers that were seen in one pose read gravity too: theirs is the change since the reference temperature, or, where none
is known, since the middle of the temperatures seen.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.drift.accel import AccelDriftFit
from undrift.drift.observe import RestBlocks
from undrift.drift.rests import Offsets, accel_offsets, gyro_offsets
from undrift.drift.scale import ScaleFit
from undrift.drift.static import StaticFit, StaticSettings, TriadDrift, cooling
from undrift.findings import Finding
from undrift.model import Calibration, ScaleDrift, StaticDrift, TriadModel
from undrift.units import Quantity, is_physical, si_factor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadSummary:
    """Offset over temperature of three sensors: n nodes, k blocks of rest; values in ``unit``."""

    unit: str  # rad/s or m/s2; the raw unit where the scale factor is not known
    seen_c: tuple[float, float]  # least and greatest temperature seen, degC
    temp_c: FloatArray  # (n,), nodes, degC
    against: str  # what the departure refers to: the constant offset, zero, or the reading at a temperature
    departure: FloatArray  # (n, 3)
    uncertainty: FloatArray  # (n, 3), standard uncertainty
    extrapolated: BoolArray  # (n,), true where no data were near
    in_table: bool  # False where only the change is known, so that no table was made
    slope: FloatArray  # (3,), mean over the temperatures seen, per K
    slope_uncertainty: FloatArray  # (3,)
    left_out_rms: FloatArray  # (3,), cross-validated error; NaN where there are too few temperatures
    half_loop: FloatArray | None  # (3,), hysteresis half-width, cooling less warming; None where it did not show
    half_loop_uncertainty: FloatArray | None  # (3,)
    loop_kept: bool  # whether the loop is significant and part of the table
    turn_on: FloatArray | None  # (3,), standard deviation from session to session; None for one session
    block_temp_c: FloatArray  # (k,), degC; may be empty
    block_departure: FloatArray  # (k, 3)
    block_cooling: FloatArray  # (k,), 1 while cooling, -1 while warming

    @property
    def usual_uncertainty(self) -> FloatArray:
        """Median standard uncertainty of the nodes that data were near, shape (3,), ``unit``; of all where none were."""
        near = self.uncertainty[~self.extrapolated] if not self.extrapolated.all() else self.uncertainty
        return np.asarray(np.median(near, axis=0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleSummary:
    """Scale factors over temperature less the calibration's, %, at n nodes and S soaks."""

    temp_c: FloatArray  # (n,), nodes, degC
    percent: FloatArray  # (n, 3)
    uncertainty: FloatArray  # (n, 3), standard uncertainty
    extrapolated: BoolArray  # (n,), true where no data were near
    soak_temp_c: FloatArray  # (S,), degC
    soak_percent: FloatArray  # (S, 3), of each soak; NaN where it did not turn about the axis
    soak_uncertainty: FloatArray  # (S, 3)


def summarise_gyro(
    static: StaticFit, rests: RestBlocks, device: Calibration, settings: StaticSettings
) -> TriadSummary | None:
    """Return the gyroscopes' offsets over temperature."""
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
    """Return the accelerometers' offsets over temperature: from several poses where possible, else from one."""
    model = device.accel
    factor, unit = _factor(model, "accel", settings.accel_unit)
    if poses is not None and model is not None:
        return _of_poses_summary(poses, model, factor)
    offsets, found = accel_offsets(rests, device, settings.accel_unit), static.accel
    if found is None or isinstance(offsets, Finding):
        return None
    reference = device.reference_temp_c if model is not None else np.nan
    if not np.isfinite(reference):
        reference = 0.5 * (found.span_c[0] + found.span_c[1])
    zero = (found.curve.spline.at(np.array([reference])).value[0], f"that at {reference:.1f} degC")
    value = found.curve.spline.at(static.table.temp_c).value
    return _summary(found, offsets, static.table, value, zero, (factor, unit))


def summarise_scale(fit: ScaleFit, device: Calibration) -> ScaleSummary | None:
    """Return scale factors over temperature against those of the calibration."""
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


def _factor(model: TriadModel | None, quantity: Quantity, unit: str) -> tuple[FloatArray, str]:
    """Return the physical unit per raw unit of each sensor, and its name; the raw unit where no scale factor is known."""
    si = "rad/s" if quantity == "rate" else "m/s2"
    if model is not None:
        return si_factor(model.unit_out, quantity) / model.scale_factor, si
    if is_physical(unit):
        return np.full(3, si_factor(unit, quantity)), si
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


def _of_poses_summary(poses: AccelDriftFit, model: TriadModel, factor: FloatArray) -> TriadSummary:
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
