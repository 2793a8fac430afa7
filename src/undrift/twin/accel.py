"""Fit of the accelerometers to poses: matrix, offset, delay and lever arm, by least squares on specific force.

The poses give the motion of the optical body's origin: position p, orientation R_nb, rate w and angular acceleration w'. The force
at a sensor with the position r from that origin is::

    f + L r = M u(t + d) - c            f = R_nb^T (p'' + g z),  L = [w']x + [w]x [w]x,  c = M o

The optics are noisy, as they are differentiated twice, and the readings u are not. Therefore f is the dependent variable, and the
regressors have little noise. All terms are turned to n and low-passed there, because a low-pass in n commutes with the second
derivative of the position. The model is linear in M, c and r, and in d through the time derivative of u. Residuals beyond 1.345
robust standard deviations have less weight (Huber). Filtered residuals are correlated, so the covariance is a sandwich estimate
over blocks of a second.

The motion is a spline through the poses (``sim.motion.poses``), evaluated at the record's time minus the gyroscopes' delay.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs
from undrift.calibration.codes import restored_gyro
from undrift.calibration.reference import MARGIN_S, Aligned, align, full_rank, rest_reading
from undrift.errors import InputError, NotObservable
from undrift.fit.gls import fit_huber
from undrift.fit.triad import offset_of, triad_fit
from undrift.frames import rotation
from undrift.model import AdcModel, TriadModel
from undrift.record import Record, Reference
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline, zero_phase

# ---- a recording and the ideal motion of its reference, on one time axis

POSE_CUTOFF_HZ = 30.0
MAX_CUTOFF_SHARE = 0.4  # highest cut-off, relative to the sample rate of poses or readings
MIN_STRETCH_S = 1.0  # shorter stretches are not filtered
EDGE_PERIODS = 1.5  # number of periods of the cut-off that are omitted at each end of a stretch
SAMPLES_PER_PERIOD = 4.0  # number of samples per period of the cut-off
ORDER = 2
SIX_DB = (math.sqrt(2.0) - 1.0) ** (0.5 / ORDER)  # cut-off of ``zero_phase`` for an attenuation by 6 dB at 1 Hz


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Match(Aligned):
    """One recording in rad/s and m/s2, and the motion of its reference."""

    name: str
    spline: PoseSpline  # motion through the poses
    rest_offset: FloatArray  # (3,), mean of ``gyro`` at rest before the motion, rad/s, or NaN without a rest

    def at(self, delay_s: float, gravity_m_s2: float) -> Motion:
        """Return the motion at the times to which readings with a delay belong."""
        return self.spline.at(self.record.time - delay_s, gravity_m_s2)

    @property
    def moving(self) -> BoolArray:
        """Return True within the motion, including half a second of rest on either side, shape (N,)."""
        time = self.record.time
        return np.asarray((time >= self.span.start_s - MARGIN_S) & (time < self.span.stop_s + MARGIN_S))

    @property
    def rest(self) -> Record:
        """Return the readings at rest before the motion, corrected for rounding, because truncation narrows noise about zero."""
        return replace(self.record, gyro=self.gyro).between(float(self.record.time[0]), self.span.start_s - MARGIN_S)

    def stretches(self, motion: Motion, readings: FloatArray) -> Iterator[slice]:
        """Yield stretches of the motion with poses and readings (N, C) that are long enough to be filtered."""
        valid = self.moving & (np.asarray(motion.valid) > 0.0) & np.isfinite(readings).all(axis=1)
        valid &= np.isfinite(motion.force_b).all(axis=1) | np.isnan(motion.force_b).all()
        for start, stop in runs(valid):
            if stop - start >= MIN_STRETCH_S * self.record.sample_rate_hz:
                yield slice(int(start), int(stop))


def match(record: Record, reference: Reference, name: str = "", *, adc: AdcModel | None = None) -> Match:
    """Align a recording and its reference."""
    record = record.in_si()
    if record.gyro is None:
        raise InputError("twin: the record has no gyroscope. Map its columns.")
    aligned = align(record, reference)
    aligned = replace(aligned, gyro=restored_gyro(aligned.gyro, adc))
    return Match(
        **{field.name: getattr(aligned, field.name) for field in fields(aligned)},
        name=name or reference.name,
        spline=pose_spline(aligned.reference, POSE_CUTOFF_HZ),
        rest_offset=rest_reading(aligned)[0],
    )


def pose_spline(reference: Reference, cutoff_hz: float) -> PoseSpline:
    """Return the motion through poses, low-passed as far as their sample rate allows."""
    cutoff_hz = min(cutoff_hz, MAX_CUTOFF_SHARE * reference.sample_rate_hz)
    return fit_pose_spline(reference, PoseSettings(cutoff_hz=cutoff_hz, position_cutoff_hz=cutoff_hz))


def low_passed(values: FloatArray, cutoff_hz: float, sample_rate_hz: float) -> tuple[FloatArray, IntArray]:
    """Return columns (N, C) low-passed without delay, at a few samples per period and without the ends, and their rows."""
    edge = math.ceil(EDGE_PERIODS * sample_rate_hz / cutoff_hz)
    rows: IntArray = np.arange(edge, len(values) - edge, max(1, int(sample_rate_hz / (SAMPLES_PER_PERIOD * cutoff_hz))))
    return zero_phase(values, SIX_DB * cutoff_hz, sample_rate_hz=sample_rate_hz, order=ORDER)[rows], rows


# ---- the fit

CUTOFF_HZ = 10.0  # above this, the second derivative of the poses is noise
BLOCK_S = 1.0
MIN_BLOCKS = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelRows:
    """Equations of a recording, linearised at a delay."""

    design: FloatArray  # (K, 3, 16), matrix row by row, c, lever arm, delay; frame n
    force: FloatArray  # (K, 3), p'' + g z, m/s2
    block: IntArray  # (K,), number of the second that each row belongs to
    delay: float  # delay beyond that of the gyroscopes, s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelFit:
    """An accelerometer fitted to poses."""

    model: TriadModel  # f = M (u - o) with covariance
    lever_arm: FloatArray  # (3,), from the optical body's origin to the sensor, frame of that body, m
    delay: float  # additional delay of the readings after the gyroscopes, s
    covariance: FloatArray  # (16, 16), matrix, offset, lever arm, delay


def lever_matrix(motion: Motion) -> FloatArray:
    """Return the effect of a lever arm on specific force, L = [w']x + [w]x [w]x, (N, 3, 3)."""
    w, spin_up = motion.rate_b, np.asarray(motion.angular_acceleration_b)
    outer = w[:, :, None] * w[:, None, :] - (w * w).sum(axis=1)[:, None, None] * np.eye(3)
    x, y, z = spin_up.T
    zero = np.zeros_like(x)
    return np.asarray(outer + np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3))


def accel_rows(match: Match, *, delay: float, matrix: FloatArray, gravity_m_s2: float, cutoff_hz: float) -> AccelRows:
    """Return the equations of a recording, linearised at a delay beyond the gyroscopes' and at a matrix."""
    readings = match.record.accel
    if readings is None or match.reference.position is None:
        raise InputError("accel fit: accelerometer readings and positions of the reference are needed. One is missing.")
    motion, rate = match.at(match.lag.seconds + delay, gravity_m_s2), match.record.sample_rate_hz
    lever, tables, times = lever_matrix(motion), [], []
    for rows in match.stretches(motion, readings):
        r_nb = rotation(motion.q_nb[rows]).as_matrix()
        slope = np.gradient(readings[rows], axis=0) * rate @ matrix.T
        columns = (
            (r_nb[:, :, :, None] * readings[rows][:, None, None]).reshape(-1, 3, 9),
            -r_nb,
            -(r_nb @ lever[rows]),
            np.einsum("nij,nj->ni", r_nb, slope)[:, :, None],
            np.einsum("nij,nj->ni", r_nb, motion.force_b[rows])[:, :, None],
        )
        table, kept_rows = low_passed(np.concatenate(columns, axis=2).reshape(-1, 51), cutoff_hz, rate)
        tables.append(table.reshape(len(kept_rows), 3, 17))
        times.append(match.record.time[rows][kept_rows])
    if not tables:
        raise NotObservable("accel fit: there is no second of motion with complete poses. Record longer motion.")
    table, block = np.concatenate(tables), np.floor(np.concatenate(times) / BLOCK_S).astype(np.int64)
    return AccelRows(design=table[:, :, :16], force=table[:, :, 16], block=block, delay=delay)


def prepare_accel(matches: Sequence[Match], *, gravity_m_s2: float) -> tuple[AccelRows, ...]:
    """Return the equations of each recording, linearised at the delay that fits all recordings."""
    cutoff_hz = min(CUTOFF_HZ, *(MAX_CUTOFF_SHARE * item.record.sample_rate_hz for item in matches))

    def equations(delay: float, matrix: FloatArray) -> tuple[AccelRows, ...]:
        return tuple(
            accel_rows(item, delay=delay, matrix=matrix, gravity_m_s2=gravity_m_s2, cutoff_hz=cutoff_hz)
            for item in matches
        )

    x = _solve(equations(0.0, np.eye(3)))[0]
    return equations(float(x[15]), x[:9].reshape(3, 3))


def solve_accel(rows: Sequence[AccelRows]) -> AccelFit:
    """Solve the equations of several recordings."""
    x, covariance, condition = _solve(rows)
    matrix = x[:9].reshape(3, 3)
    offset, jacobian = offset_of(matrix, x[9:12], 16)
    covariance = jacobian @ covariance @ jacobian.T
    residuals = np.concatenate([item.force - item.design @ x for item in rows])
    force = np.concatenate([item.force for item in rows])
    fit = triad_fit(
        residuals, method="reference", unit_in="m/s2", unit_out="m/s2", matrix=matrix, offset=offset,
        covariance=covariance[:12, :12], rank=16, condition=condition,
        valid_range=(float(force.min()), float(force.max())),
    )  # fmt: skip
    return AccelFit(
        model=fit.model,
        lever_arm=x[12:15],
        delay=rows[0].delay + float(x[15]),
        covariance=covariance,
    )


def _solve(rows: Sequence[AccelRows]) -> tuple[FloatArray, FloatArray, float]:
    """Return the parameters (16,), their covariance and the condition of the equations."""
    design = np.concatenate([item.design for item in rows]).reshape(-1, 16)
    force = np.concatenate([item.force for item in rows]).reshape(-1)
    blocks = np.flatnonzero(np.concatenate([np.append(True, np.diff(item.block) != 0) for item in rows]))
    if len(blocks) < MIN_BLOCKS:
        raise NotObservable(
            f"accel fit: {MIN_BLOCKS} s or more of motion with poses are needed, got {len(blocks)} s. Record longer.",
            seconds=len(blocks),
        )
    condition = full_rank(design, "accel fit")
    x, weight, _ = fit_huber(design, force, together=3, mad_factor=1.0, passes=10)
    length = np.linalg.norm(design, axis=0)
    weighted = (design / length).T * weight
    bread: FloatArray = np.linalg.inv(weighted @ (design / length))
    scores = (weighted * (force - design @ x)).T.reshape(-1, 3, 16).sum(axis=1)
    sums = np.add.reduceat(scores, blocks)
    covariance: FloatArray = bread @ (sums.T @ sums) @ bread * (len(blocks) / max(len(blocks) - 16 / 3, 1.0))
    return x, covariance / np.outer(length, length), condition
