"""Expected angle error with and without a calibration's tables, for a standard motion.

The motion leans by 45 deg and back in 4 s, about each axis in turn, with the device warmer than the calibration's reference::

    angle(t) = A (1 - cos(2 pi t / D)) / 2          A = 45 deg, D = 4 s

With constants M, o and tables M(T), o(T), e(w, T) of the same device, constants turn a true rate w into::

    w' = M M(T)^-1 (w + e(w, T)) + M (o(T) - o)

The error is the integral of w' - w ("constant"), or of w' - w minus its value at rest ("rest"). With tables the error is their 95 %
uncertainty: offset over the time, scale over the angle, dynamic drift over the time. If a rest is subtracted as well, the noise of
the rest takes the offset's place.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, interpolated
from undrift.model import Calibration, StaticDrift
from undrift.units import RADIAN_PER_DEGREE, si_factor

LEAN = 45.0 * RADIAN_PER_DEGREE
MOTION_S = 4.0
EXCURSION_K = 12.5  # a wearer warms a device by this
SAMPLE_RATE_HZ = 100.0
NORMAL_95 = 1.96
BOTH = "Use the tables, and subtract the offset of a rest (undrift correct --offset rest)"
ADDS_LITTLE = 0.8  # tables with a rest leave more than this share of the error of a rest without tables


@dataclass(frozen=True, slots=True, kw_only=True)
class TableWorth:
    """Largest angle error over the motion, of the worst axis, deg."""

    temp_c: float
    reference_c: float
    constant_deg: float  # constant calibration
    rest_deg: float  # constant calibration, offset of a rest at the same temperature subtracted
    tables_deg: float  # with tables, 95 % uncertainty
    both_deg: float  # with tables and the offset of a rest, 95 % uncertainty
    turned: bool  # True if scale or dynamic drift was measured (otherwise only the noise of a rest is known)

    @property
    def motion(self) -> str:
        """Angle, duration and temperature of the lean that is judged, in words."""
        away = self.temp_c - self.reference_c
        return (
            f"of {LEAN / RADIAN_PER_DEGREE:.0f} deg and back in {MOTION_S:g} s at {self.temp_c:.1f} degC, {abs(away):.1f} K "
            f"{'above' if away >= 0.0 else 'below'} the reference"
        )

    @property
    def answer(self) -> str:
        """What to do."""
        if self.constant_deg <= self.tables_deg:
            return "These tables do not improve on the constant calibration here: record more"
        if not self.turned:
            return f"{BOTH}. Scale and dynamic drift, which a rest cannot remove, were not measured"
        if self.both_deg > ADDS_LITTLE * self.rest_deg:
            return "A rest before the motion is as good as these tables here"
        return BOTH


def expected_errors(calibration: Calibration, *, rest_variance: FloatArray) -> TableWorth | None:
    """Return the expected errors, or None without offset tables of the gyroscopes.

    ``rest_variance`` (3,) is the variance of the mean over a rest, raw unit squared.
    """
    drift, gyro = calibration.drift, calibration.gyro
    static = None if drift is None else drift.static
    if drift is None or gyro is None or static is None or static.gyro_offset is None or static.gyro_uncertainty is None:
        return None
    reference_c, temp_c = calibration.reference_temp_c, _warmed(static, calibration.reference_temp_c)
    if not math.isfinite(reference_c) or temp_c is None:
        return None
    offset, matrix = gyro.offset, gyro.matrix
    if gyro.method == "nominal":  # such a calibration knows the reading at the reference temperature only
        offset = interpolated(np.clip(reference_c, *static.temp_c[[0, -1]]), static.temp_c, static.gyro_offset)
    if drift.scale is not None and drift.scale.gyro_matrix is not None:
        matrix = interpolated(temp_c, drift.scale.temp_c, drift.scale.gyro_matrix)
    moved = interpolated(temp_c, static.temp_c, static.gyro_offset) - offset
    rest_rate = si_factor(gyro.unit_out, "rate") * gyro.matrix @ moved
    gain, rate = np.diag(gyro.matrix @ np.linalg.inv(matrix)), _rate()
    constant, rest = 0.0, 0.0
    for axis in range(3):
        dynamic = np.zeros(len(rate))
        if drift.dynamic is not None:
            errors = interpolated(temp_c, drift.dynamic.temp_c, drift.dynamic.error)[:, axis]
            dynamic = np.interp(rate, drift.dynamic.turn_rate, errors) - np.interp(0.0, drift.dynamic.turn_rate, errors)
        turning = gain[axis] * (rate + dynamic) - rate
        constant, rest = max(constant, _largest(turning + rest_rate[axis])), max(rest, _largest(turning))
    tables, both = _uncertainty(calibration, temp_c, rest_variance)
    return TableWorth(
        temp_c=temp_c,
        reference_c=reference_c,
        constant_deg=constant / RADIAN_PER_DEGREE,
        rest_deg=rest / RADIAN_PER_DEGREE,
        tables_deg=tables / RADIAN_PER_DEGREE,
        both_deg=both / RADIAN_PER_DEGREE,
        turned=drift.scale is not None or drift.dynamic is not None,
    )


def _warmed(static: StaticDrift, reference_c: float) -> float | None:
    """Return the node with data that is nearest to the temperature to which a wearer warms the device."""
    marks = static.gyro_extrapolated
    nodes = static.temp_c if marks is None else static.temp_c[~marks]
    return float(nodes[np.abs(nodes - reference_c - EXCURSION_K).argmin()]) if len(nodes) else None


def _rate() -> FloatArray:
    time = np.arange(round(MOTION_S * SAMPLE_RATE_HZ) + 1) / SAMPLE_RATE_HZ
    return np.asarray(LEAN * np.pi / MOTION_S * np.sin(2.0 * np.pi * time / MOTION_S))


def _largest(error: FloatArray) -> float:
    return float(np.abs(np.cumsum(error)).max() / SAMPLE_RATE_HZ)


def _uncertainty(calibration: Calibration, temp_c: float, rest_variance: FloatArray) -> tuple[float, float]:
    """Return the 95 % uncertainty of the angle with tables, and with tables and a rest, of the worst axis, rad."""
    drift, gyro = calibration.drift, calibration.gyro
    if drift is None or gyro is None or drift.static is None or drift.static.gyro_uncertainty is None:
        return math.nan, math.nan
    per_raw = np.abs(gyro.si_per_reading("rate"))
    offset = interpolated(temp_c, drift.static.temp_c, drift.static.gyro_uncertainty) * per_raw * MOTION_S
    turning = np.zeros(3)
    scale, dynamic = drift.scale, drift.dynamic
    if scale is not None and scale.gyro_uncertainty is not None and scale.gyro_matrix is not None:
        share = np.diag(interpolated(temp_c, scale.temp_c, scale.gyro_uncertainty)) / np.diag(
            interpolated(temp_c, scale.temp_c, scale.gyro_matrix)
        )
        turning = turning + (LEAN * share) ** 2
    if dynamic is not None and dynamic.uncertainty is not None:
        dynamic_uncertainty = interpolated(temp_c, dynamic.temp_c, dynamic.uncertainty)
        inside = np.abs(dynamic.turn_rate) <= np.abs(_rate()).max()
        turning = (
            turning
            + (MOTION_S * np.median(dynamic_uncertainty[inside] if inside.any() else dynamic_uncertainty, axis=0)) ** 2
        )
    noise = np.nan_to_num(rest_variance) * per_raw**2 * MOTION_S**2
    return (NORMAL_95 * float(np.sqrt(offset**2 + turning).max()), NORMAL_95 * float(np.sqrt(noise + turning).max()))
