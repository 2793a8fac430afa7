"""Expected angle error with and without a calibration's tables, for a standard motion.

The motion leans by 45 deg and back in 4 s, about each axis in turn, with the device warmer than the calibration's reference::

    angle(t) = A (1 - cos(2 pi t / D)) / 2          A = 45 deg, D = 4 s

With constants M, o and tables M(T), o(T), e(w, T) of the same device, constants turn a true rate w into::

    w' = M M(T)^-1 (w + e(w, T)) + M (o(T) - o)

The error is the integral of w' - w ("constant"), or of w' - w minus its value at rest ("rest"). With tables the error is their 95 %
uncertainty: offset over the time, scale over the angle, dynamic drift over the time. If a rest is subtracted as well, the noise of
the rest replaces the offset.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, interpolated
from undrift.model import Calibration
from undrift.units import RADIAN_PER_DEGREE, si_factor

LEAN = 45.0 * RADIAN_PER_DEGREE
MOTION_S = 4.0
EXCURSION_K = 12.5  # temperature rise of a device when worn, K
STEP_S = 0.01
NORMAL_95 = 1.96
BOTH = "Use the tables, and subtract the offset of a rest (undrift correct --offset rest)"
ADDS_LITTLE = 0.8  # share of the error of a rest without tables from which tables with a rest are not worthwhile


@dataclass(frozen=True, slots=True, kw_only=True)
class TableWorth:
    """Largest angle error over the motion, of the worst axis, deg."""

    temp_c: float
    reference_c: float
    constant_deg: float  # constant calibration
    rest_deg: float  # constant calibration, minus the offset of a rest at the same temperature
    tables_deg: float  # tables, 95 % uncertainty
    both_deg: float  # tables and the offset of a rest, 95 % uncertainty
    turned: bool  # True if scale or dynamic drift was measured (otherwise only the noise of a rest is known)

    @property
    def motion(self) -> str:
        """Angle, duration and temperature of the motion, in words."""
        away_k = self.temp_c - self.reference_c
        return (
            f"of {LEAN / RADIAN_PER_DEGREE:.0f} deg and back in {MOTION_S:g} s at {self.temp_c:.1f} degC, {abs(away_k):.1f} K "
            f"{'above' if away_k >= 0.0 else 'below'} the reference"
        )

    @property
    def answer(self) -> str:
        """Return a recommendation."""
        if self.constant_deg <= self.tables_deg:
            return "At this temperature, these tables are no better than the constant calibration: record more"
        if not self.turned:
            return f"{BOTH}. Scale and dynamic drift, which a rest cannot remove, were not measured"
        if self.both_deg > ADDS_LITTLE * self.rest_deg:
            return "A rest before the motion is as good as these tables here"
        return BOTH


def expected_errors(calibration: Calibration, *, rest_variance: FloatArray) -> TableWorth | None:
    """Return the expected errors, or None without offset tables of the gyroscopes.

    ``rest_variance`` (3,) is the variance of the mean over a rest, raw unit squared.
    """
    drift, gyro, reference_c = calibration.drift, calibration.gyro, calibration.reference_temp_c
    static = None if drift is None else drift.static
    if drift is None or gyro is None or static is None or static.gyro_offset is None or static.gyro_uncertainty is None:
        return None
    nodes = static.temp_c if static.gyro_extrapolated is None else static.temp_c[~static.gyro_extrapolated]
    if not math.isfinite(reference_c) or not len(nodes):
        return None
    temp_c = float(nodes[np.abs(nodes - reference_c - EXCURSION_K).argmin()])
    scale, dynamic = drift.scale, drift.dynamic

    def at(table_temp_c: FloatArray, values: FloatArray) -> FloatArray:
        return interpolated(temp_c, table_temp_c, values)

    offset, matrix = gyro.offset, gyro.matrix
    if gyro.method == "nominal":  # such a calibration contains the reading at the reference temperature only
        offset = interpolated(np.clip(reference_c, *static.temp_c[[0, -1]]), static.temp_c, static.gyro_offset)
    phase = 2.0 * np.pi * np.arange(0.0, MOTION_S + 0.5 * STEP_S, STEP_S) / MOTION_S
    rate = np.tile(LEAN * np.pi / MOTION_S * np.sin(phase)[:, None], 3)
    per_raw = np.abs(gyro.si_per_reading("rate"))
    rate_error, variance = np.zeros_like(rate), np.zeros(3)
    if scale is not None and scale.gyro_matrix is not None:
        matrix = at(scale.temp_c, scale.gyro_matrix)
        if scale.gyro_uncertainty is not None:
            variance += (LEAN * np.diag(at(scale.temp_c, scale.gyro_uncertainty)) / np.diag(matrix)) ** 2
    if dynamic is not None:
        for axis, errors in enumerate(at(dynamic.temp_c, dynamic.error).T):
            at_rest, turning = (np.interp(w, dynamic.turn_rate, errors) for w in (0.0, rate[:, axis]))
            rate_error[:, axis] = turning - at_rest
        if dynamic.uncertainty is not None:
            uncertainty, inside = at(dynamic.temp_c, dynamic.uncertainty), np.abs(dynamic.turn_rate) <= rate.max()
            variance += (MOTION_S * np.median(uncertainty[inside] if inside.any() else uncertainty, axis=0)) ** 2
    rest_rate = si_factor(gyro.unit_out, "rate") * (gyro.matrix @ (at(static.temp_c, static.gyro_offset) - offset))
    error = np.diag(gyro.matrix @ np.linalg.inv(matrix)) * (rate + rate_error) - rate
    constant, rest = (float(np.abs(np.cumsum(e, axis=0)).max()) * STEP_S for e in (error + rest_rate, error))
    tables, both = (
        NORMAL_95 * float(np.sqrt(((per_raw * MOTION_S) ** 2 * offset_variance + variance).max()))
        for offset_variance in (at(static.temp_c, static.gyro_uncertainty) ** 2, np.nan_to_num(rest_variance))
    )
    return TableWorth(
        temp_c=temp_c,
        reference_c=reference_c,
        constant_deg=constant / RADIAN_PER_DEGREE,
        rest_deg=rest / RADIAN_PER_DEGREE,
        tables_deg=tables / RADIAN_PER_DEGREE,
        both_deg=both / RADIAN_PER_DEGREE,
        turned=scale is not None or dynamic is not None,
    )
