"""What a calibration's tables are worth over a stated motion: the angle error to expect with and without them.

The motion leans by 45 deg and back in 4 s, about each axis in turn, with the device warmer than the calibration's reference::

    angle(t) = A (1 - cos(2 pi t / D)) / 2          A = 45 deg, D = 4 s

The reading u(t) that the tables turn into this rate is found with ``correct`` itself, and is then corrected without the tables: by
the constants ("constant"), and with what these leave at rest subtracted ("rest"). With tables the error is what they state, 95 %:
offset over the time, scale over the angle, dynamic drift over the time. Re-zeroed as well, the noise of the rest takes the
offset's place.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, interpolated
from undrift.correction.correct import correct_whole
from undrift.model import Calibration, DriftTables, ScaleDrift, StaticDrift
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, si_factor

LEAN = 45.0 * RADIAN_PER_DEGREE
MOTION_S = 4.0
EXCURSION_K = 12.5  # what a wearer warms a device by
_FS = 100.0
_ROUNDS = 8
_CLOSE = 1e-9  # rad/s
_NORMAL_95 = 1.96
_WORTH = 0.8  # of the rest's error: above it tables add little


@dataclass(frozen=True, slots=True, kw_only=True)
class TableWorth:
    """Largest angle error over the motion, of the worst axis, deg."""

    temp_c: float
    reference_c: float
    constant_deg: float  # Constant calibration
    rest_deg: float  # Constant calibration, re-zeroed at a rest at the same temperature
    tables_deg: float  # With tables, 95 % of what they state
    both_deg: float  # With tables, re-zeroed, likewise
    turned: bool  # Whether scale or dynamic drift was measured; else the rest's error is unknown beyond noise

    @property
    def motion(self) -> str:
        """The motion that is judged, in words."""
        away = self.temp_c - self.reference_c
        return (
            f"a lean of {LEAN / RADIAN_PER_DEGREE:.0f} deg and back in {MOTION_S:g} s at {self.temp_c:.1f} degC, {abs(away):.1f} K "
            f"{'above' if away >= 0.0 else 'below'} the reference"
        )

    @property
    def answer(self) -> str:
        """What to do."""
        if self.constant_deg <= self.tables_deg:
            return "These tables do not improve on the constant calibration here: record more"
        if not self.turned:
            return "Use the tables, and correct `offset` rest; scale and dynamic drift, which no rest removes, were not measured"
        if self.both_deg > _WORTH * self.rest_deg:
            return "A rest before the motion is as good as these tables here"
        return "Use the tables, and correct `offset` rest"


def expected_errors(calibration: Calibration, *, rest_variance: FloatArray) -> TableWorth | None:
    """Return the errors to expect; None without offset tables of the gyroscopes. rest_variance (3,): of a rest's mean, raw unit."""
    drift, gyro = calibration.drift, calibration.gyro
    static = None if drift is None else drift.static
    if drift is None or gyro is None or static is None or static.gyro_offset is None or static.gyro_uncertainty is None:
        return None
    reference = calibration.reference_temp_c
    temp_c = _warmed(static, reference)
    if not math.isfinite(reference) or temp_c is None:
        return None
    bare = replace(calibration, adc=None, accel=None, gyro=replace(gyro, g_sensitivity=None))
    bare = replace(bare, drift=replace(_gyro_alone(drift), lag_s=0.0, lag_smooth_s=0.0))
    constant = replace(bare, drift=None)
    if gyro.method == "nominal":  # what it reads at the reference temperature is all that it knows
        at = interpolated(np.clip(reference, *static.temp_c[[0, -1]]), static.temp_c, static.gyro_offset)
        constant = replace(constant, gyro=replace(gyro, g_sensitivity=None, offset=at))
    motion, worst = _rate(), np.zeros(2)
    if (at_rest := _reading(bare, np.zeros((2, 3)), temp_c)) is None:
        return None
    left = _corrected(constant, at_rest, temp_c)[0]
    for axis in range(3):
        if (reading := _reading(bare, motion[:, None] * np.eye(3)[axis], temp_c)) is None:
            return None
        error = _corrected(constant, reading, temp_c)[:, axis] - motion
        worst = np.maximum(worst, [_largest(error), _largest(error - left[axis])])
    tables, both = _stated(bare, temp_c, rest_variance)
    return TableWorth(
        temp_c=temp_c,
        reference_c=reference,
        constant_deg=float(worst[0]) / RADIAN_PER_DEGREE,
        rest_deg=float(worst[1]) / RADIAN_PER_DEGREE,
        tables_deg=tables / RADIAN_PER_DEGREE,
        both_deg=both / RADIAN_PER_DEGREE,
        turned=drift.scale is not None or drift.dynamic is not None,
    )


def _warmed(static: StaticDrift, reference: float) -> float | None:
    """Return the node with data that is nearest to where a wearer warms the device."""
    marks = static.gyro_extrapolated
    seen = static.temp_c if marks is None else static.temp_c[~marks]
    return float(seen[np.abs(seen - reference - EXCURSION_K).argmin()]) if len(seen) else None


def _gyro_alone(drift: DriftTables) -> DriftTables:
    static, scale = drift.static, drift.scale
    if static is not None:
        static = replace(static, accel_offset=None, accel_uncertainty=None, accel_extrapolated=None, warm_up=None)
    if scale is not None:
        own = ScaleDrift(temp_c=scale.temp_c, gyro_matrix=scale.gyro_matrix, gyro_uncertainty=scale.gyro_uncertainty)
        scale = None if scale.gyro_matrix is None else own
    return replace(drift, static=static, scale=scale)


def _rate() -> FloatArray:
    time = np.arange(round(MOTION_S * _FS) + 1) / _FS
    return np.asarray(LEAN * np.pi / MOTION_S * np.sin(2.0 * np.pi * time / MOTION_S))


def _largest(error: FloatArray) -> float:
    return float(np.abs(np.cumsum(error)).max() / _FS)


def _corrected(calibration: Calibration, reading: FloatArray, temp_c: float) -> FloatArray:
    unit = "rad/s" if calibration.gyro is None else calibration.gyro.unit_in
    n = len(reading)
    record = Record(time=np.arange(n) / _FS, gyro=reading, gyro_unit=unit, temp_c=np.full(n, temp_c))
    done = correct_whole(record, calibration, policy="hold").record.gyro
    return np.zeros((n, 3)) if done is None else done


def _reading(calibration: Calibration, wanted: FloatArray, temp_c: float) -> FloatArray | None:
    """Return the reading that a calibration turns into wanted rates (N, 3); None where it is not found."""
    if calibration.gyro is None:
        return None
    forward = calibration.gyro.forward_matrix / si_factor(calibration.gyro.unit_out, "rate")
    reading = wanted @ forward.T + calibration.gyro.offset
    for _ in range(_ROUNDS):
        left = wanted - _corrected(calibration, reading, temp_c)
        reading = reading + left @ forward.T
        if np.abs(left).max() < _CLOSE:
            break
    return reading if np.abs(left).max() < 1e3 * _CLOSE else None


def _stated(calibration: Calibration, temp_c: float, rest_variance: FloatArray) -> tuple[float, float]:
    """Return 95 % of the angle that tables leave, and that they leave with a rest, of the worst axis, rad."""
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
        of_rate = interpolated(temp_c, dynamic.temp_c, dynamic.uncertainty)
        inside = np.abs(dynamic.turn_rate) <= np.abs(_rate()).max()
        turning = turning + (MOTION_S * np.median(of_rate[inside] if inside.any() else of_rate, axis=0)) ** 2
    noise = np.nan_to_num(rest_variance) * per_raw**2 * MOTION_S**2
    return (_NORMAL_95 * float(np.sqrt(offset**2 + turning).max()), _NORMAL_95 * float(np.sqrt(noise + turning).max()))
