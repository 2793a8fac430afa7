"""Scale and zero of readings in counts or volts, roughly, from motion alone: where a fit from motion begins.

::

    |s - p0| = g / k_f                       a sphere through smoothed specific force: zero p0 and scale k_f of accelerometers
    d/dt f = f x w                           gravity in turning axes; w = M (u - o), integrated over a step: linear in M and M o

Both by least squares with robust weights, over short steps of slow turns; linear acceleration is noise here. M is one scale times
the identity; where a free M is far from that, the columns have another order or sign, or the motion does not show it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.checks import cause_by_gravity
from undrift.errors import Implausible, NotObservable
from undrift.record import Record
from undrift.units import Quantity, is_physical, si_factor

SMOOTHED_S = (0.15, 0.3, 0.6)  # Hann windows; a step is twice as long. The best one is taken [assumed]
ALIKE = 0.3  # of the scale: what axes may seem to differ by, and cross-axis terms be; parts state 1 to 3 % [assumed]
_WEIGHINGS, _LOOKED_AT_S = 4, 600.0


@dataclass(frozen=True, slots=True)
class Nominal:
    """Scale, SI per unit of reading, and zero of a triad; whether the readings themselves say so, as their unit does not."""

    scale: float
    zero: FloatArray  # (3,), in the unit of reading
    sought: bool

    def si(self, readings: FloatArray) -> FloatArray:
        """Return readings (N, 3) in SI."""
        values: FloatArray = self.scale * (readings - self.zero)
        return values


def nominal_scales(records: Sequence[Record], gravity_m_s2: float) -> tuple[Nominal, Nominal]:
    """Return scale and zero of the gyroscopes and of the accelerometers of one device, whose recordings have both and no gaps."""
    records = [one.between(one.time[0], one.time[0] + _LOOKED_AT_S) for one in records]
    units: tuple[tuple[str, Quantity], ...] = ((records[0].gyro_unit, "rate"), (records[0].accel_unit, "accel"))
    gyro, accel = (
        Nominal(si_factor(unit, quantity), np.zeros(3), sought=False) if is_physical(unit) else None
        for unit, quantity in units
    )
    if accel is None:
        points = [_smoothed(np.asarray(one.accel), one.sample_rate_hz, SMOOTHED_S[1]) for one in records]
        accel = _sphere(np.vstack(points), gravity_m_s2)
    return gyro or _turning(records, accel, gravity_m_s2), accel


def in_nominal_units(record: Record, gyro: Nominal, accel: Nominal) -> Record:
    """Return a recording in rad/s and m/s2, by scales and zeros that may be nominal."""
    return replace(
        record, gyro=gyro.si(np.asarray(record.gyro)), gyro_unit="rad/s",
        accel=accel.si(np.asarray(record.accel)), accel_unit="m/s2",
    )  # fmt: skip


def _smoothed(values: FloatArray, rate_hz: float, width_s: float) -> FloatArray:
    weight = np.hanning(max(3, round(width_s * rate_hz)) + 2)[1:-1]
    return np.column_stack([np.convolve(each, weight / weight.sum(), "valid") for each in values.T])


def _weighed(design: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve rows (N, D, P) x = (N, D), rows that fit badly weighed less (Cauchy); also the covariance of x."""
    weight = np.ones(len(right))
    for _ in range(_WEIGHINGS):
        root = np.sqrt(weight)
        rows = (root[:, None, None] * design).reshape(-1, design.shape[2])
        x: FloatArray = np.linalg.lstsq(rows, (root[:, None] * right).ravel(), rcond=None)[0]
        left = np.linalg.norm(right - design @ x, axis=1)
        size = max(1.5 * float(np.median(left)), np.finfo(float).tiny)
        weight = 1.0 / (1.0 + (left / size) ** 2)
    return x, size**2 * np.linalg.pinv(rows.T @ rows)


def _sphere(points: FloatArray, gravity_m_s2: float) -> Nominal:
    middle, size = points.mean(axis=0), float(np.std(points)) or 1.0
    at = (points - middle) / size
    x, covariance = _weighed(np.column_stack((2.0 * at, np.ones(len(at))))[:, None], (at**2).sum(axis=1)[:, None])
    radius = float(np.sqrt(max(x[3] + x[:3] @ x[:3], 1e-12)))
    if np.sqrt(np.diag(covariance)[:3]).max() > 0.1 * radius or np.ptp(at, axis=0).min() < 0.6 * radius:
        raise NotObservable(
            "motion: wanted specific force along and against each axis, to find the scale of the accelerometers, got "
            f"{', '.join(f'{50.0 * span / radius:.0f}' for span in np.ptp(at, axis=0))} % of that range on x, y, z; "
            "hold each side up in turn, or state the scale of the columns"
        )
    return Nominal(gravity_m_s2 / (size * radius), middle + size * x[:3], sought=True)


def _turning(records: Sequence[Record], accel: Nominal, gravity_m_s2: float) -> Nominal:
    """Return scale and zero of the gyroscopes, as the direction of gravity turns."""
    size = float(np.mean([np.std(np.asarray(one.gyro)) for one in records])) or 1.0
    middle = np.mean([np.mean(np.asarray(one.gyro), axis=0) for one in records], axis=0)
    tries = []
    for width in SMOOTHED_S:
        steps = (_steps(one, accel, gravity_m_s2, (np.asarray(one.gyro) - middle) / size, width) for one in records)
        design, change = map(np.concatenate, zip(*steps, strict=True))
        matrix = _weighed(design, change)[0].reshape(3, 4)[:, :3]
        alike = np.concatenate((design[..., [0, 5, 10]].sum(axis=2, keepdims=True), design[..., [3, 7, 11]]), axis=2)
        one, zero = np.split(_weighed(alike, change)[0], [1])
        tries.append((float(np.abs(matrix / one - np.eye(3)).max()), matrix, float(one[0]), zero))
    apart, matrix, scale, zero = min(tries, key=lambda one: one[0])
    if apart > ALIKE:
        raise _mistaken(matrix, apart)
    return Nominal(scale / size, middle - size / scale * zero, sought=True)


def _mistaken(matrix: FloatArray, apart: float) -> Exception:
    """Return what is wrong where gyroscopes do not turn gravity as the accelerometers see it."""
    order = np.sign(matrix) * (np.abs(matrix) == np.abs(matrix).max(axis=1, keepdims=True))
    rest = np.abs(matrix - matrix * np.abs(order)).max(axis=1)
    others = (order != np.eye(3)).any() and (np.abs(order).sum(axis=0) == 1.0).all()
    if others and (rest < ALIKE * np.abs(matrix).max(axis=1)).all():
        return Implausible(
            "motion: wanted gyroscopes and accelerometers along the same axes, got others: "
            f"{cause_by_gravity(order.T)}; correct the order or the sign of the columns"
        )
    return NotObservable(
        "motion: wanted rates that turn gravity alike on all axes, to find the scale of the gyroscopes, got scales that differ "
        f"by {100.0 * apart:.0f} %; turn the device slowly about every axis, or state the scale of the columns"
    )


def _steps(
    record: Record, accel: Nominal, gravity_m_s2: float, turning: FloatArray, width_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return rows (K, 3, 12) and changes (K, 3) of the direction of gravity over steps: those of M and M o, row by row."""
    rate_hz = record.sample_rate_hz
    up = _smoothed(accel.si(np.asarray(record.accel)), rate_hz, width_s) / gravity_m_s2
    rate = _smoothed(turning, rate_hz, width_s)
    regressors = np.column_stack((rate, np.ones(len(rate))))
    turned = np.stack([np.cross(up, axis) for axis in np.eye(3)], axis=2)[..., None] * regressors[:, None, None, :]
    total = np.cumsum(turned.reshape(len(up), 3, 12), axis=0) / rate_hz
    step = max(2, round(2.0 * width_s * rate_hz))
    first = np.arange(0, len(up) - step, step // 2)
    return total[first + step] - total[first], up[first + step] - up[first]
