"""Accelerometer against an orientation reference: rests at known attitudes, and motion where the reference gives the position too.

With R = R_nb the poses, p the position of the reference body's origin and r the sensor in it, the readings a follow::

    R (M (a + d a' + d^2/2 a'') - c) = p'' + (R r)'' + g z     c = M o,   d the delay of the accelerometer against the poses

No pose is ever differentiated: each side is weighed by a bump h(t) of one second whose first three derivatives are zero at its
ends, and the derivatives are moved to it (integration by parts)::

    int h R (M a - c + d M a' + d^2/2 M a'') dt - int h'' R dt r = int h'' p dt + g z int h dt

Readings are means over the step T of the poses, of straight lines between samples a step t apart, which lose
(T^2 / 24 + t^2 / 12) a'': that is added. A rest is one such equation without p and r, from means. M, c, r and d are linear, but
for d M. A rest errs by the pose's tilt, the same throughout, and the level of the reference is a parameter. Windows are weighed by
Huber's rule; their covariance is the jackknife's over blocks of 8 s. What the recordings do not show takes a stated prior: the
matrix 5 % about the mounting that the gyroscopes found, the offset 0.5 m/s2. A rest without a valid pose enters no equation: there
the length of the corrected force is compared with gravity.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.plausibility import without_saturated
from undrift.calibration.quality import check_gravity_length
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.gls import HUBER, huber_weight
from undrift.fit.triad import TriadFit, offset_of, scaled_condition, triad_fit
from undrift.frames import rotation
from undrift.model import MATRIX_NAMES, OFFSET_NAMES, TriadModel, Verdict
from undrift.record import Record, Reference, Session, Still
from undrift.segments import StillSettings, find_still
from undrift.sync import RunningIntegral, native_poses
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

_WINDOW_S, _STRIDE_S = 1.0, 0.5
_POSE_SD = 2e-3  # rad: tilt of the reference at a rest
_LEAST_SD = 1e-3  # m/s2: no window is better than this
_PRIOR_MATRIX, _PRIOR_OFFSET = 0.05, 0.5  # relative; m/s2
_PASSES = 8
_HELD = 0.5  # of the prior: a parameter that keeps more of it was not observed
_WANTED = 0.005  # relative uncertainty
_TURNED, _SPREAD = 12, 20.0  # equations, and their condition, with which counts show scale and null
_CONTRADICTS = 100.0  # condition with which motion tells whether counts read 0 without force
_BLOCK = 16  # windows, of 8 s: what is left out together


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows:
    """Equations of one recording: A x = y."""

    design: FloatArray  # (n, 3, 15): M row by row, c, r
    delayed: FloatArray  # (n, 3, 18), for d and d^2 / 2: each times M row by row
    wanted: FloatArray  # (n, 3), m/s2
    first: IntArray  # (n,), number of each window; -1 of a rest
    forces: FloatArray  # (n, 3), mean readings


_TURNED_ABOVE = 5.0 * RADIAN_PER_DEGREE  # of gyroscopes on the body of the reference


def turned_like(gyro: TriadModel, unit: str) -> TriadModel | None:
    """Return accelerometers that nothing shows, on the body that the gyroscopes were fitted to; None where that is the case."""
    left, _, right = np.linalg.svd(gyro.matrix)
    turn = left @ right
    if not is_physical(unit) or np.trace(turn) > 1.0 + 2.0 * np.cos(_TURNED_ABOVE):
        return None
    factor = si_factor(unit, "accel")
    spread = np.diag([(_PRIOR_MATRIX * factor) ** 2] * 9 + [(_PRIOR_OFFSET / factor) ** 2] * 3)
    return TriadModel(
        method="nominal",
        unit_in=unit,
        unit_out="m/s2",
        matrix=turn * factor,
        offset=np.zeros(3),
        covariance=spread,
        rms_residual=0.0,
        count=0,
        rank=0,
        condition=1.0,
        valid_range=(-np.inf, np.inf),
    )


def fit_reference_accel(
    records: Sequence[Record],
    references: Sequence[Reference],
    gyro: TriadModel,
    *,
    mountings: FloatArray,
    gravity_m_s2: float,
    lags_s: FloatArray,
) -> TriadFit:
    """Fit scale, cross-axis terms and offset of the accelerometers of one device, in the frame of its gyroscopes' fit.

    ``mountings`` (R, 3), rad, and ``lags_s`` (R,) are those that the gyroscopes' fit found.
    """
    unit = records[0].accel_unit
    if any(r.accel is None or r.accel_unit != unit for r in records):
        raise InputError("reference: wanted accelerometers in one unit in all recordings, got none in some; map them")
    left, _, right = np.linalg.svd(gyro.matrix)
    rows, unused = list[_Rows](), list[Still]()
    for number, (record, reference, own, lag_s) in enumerate(zip(records, references, mountings, lags_s, strict=True)):
        made, without_pose = _equations(record, native_poses(reference), own, float(lag_s), gravity_m_s2)
        rows.append(made)
        unused += [replace(still, recording=number) for still in without_pose]
    factor, null = _nominal(rows, unit, gravity_m_s2)
    for number, r in enumerate(rows if null.any() else ()):  # readings less a constant
        own = r.design.copy()
        own[:, :, :9] += (own[:, :, 9:12, None] * null).reshape(len(own), 3, 9)
        rows[number] = replace(r, design=own, forces=r.forces - null)
    fit = _result(rows, _solve(rows, factor * left @ right, factor, gravity_m_s2), unit, factor, null)
    session = Session(kind="calibration", serial="", gravity_m_s2=gravity_m_s2, records=tuple(records))
    return replace(fit, verdict=fit.verdict.also(Verdict.of(*check_gravity_length(session, unused, fit.model))))


def _nominal(rows: Sequence[_Rows], unit: str, gravity: float) -> tuple[float, FloatArray]:
    """Return m/s2 per unit, and the readings at no force, (3,): of a physical unit its own, and none.

    Counts: by readings against what acts in the body, where it was turned enough; else by the mean size of the readings at rest.
    """
    if is_physical(unit):
        return si_factor(unit, "accel"), np.zeros(3)
    acting = np.concatenate([np.einsum("nij,ni->nj", -r.design[:, :, 9:12], r.wanted) for r in rows]) / gravity
    design = np.column_stack((acting, np.ones(len(acting))))
    condition = scaled_condition(design)[1] if len(acting) >= _TURNED else np.inf
    by_motion = np.linalg.lstsq(design, np.concatenate([r.forces for r in rows]), rcond=None)[0]
    size = float(np.linalg.svd(by_motion[:3])[1].mean())
    if condition < _SPREAD:
        return gravity / size, by_motion[3]
    rests = np.concatenate([r.forces[r.first < 0] for r in rows])
    if not len(rests):
        raise NotObservable("reference: wanted a rest for the scale of accelerometers in counts, got none", rests=0)
    at_rest = float(np.linalg.norm(rests, axis=1).mean())
    if condition < _CONTRADICTS and not 0.5 < at_rest / size < 2.0:  # the codes do not read 0 without force
        raise NotObservable(
            "reference: accelerometers in counts were turned too little for their scale. Tilt them more."
        )
    return gravity / at_rest, np.zeros(3)


# ---- equations


def _equations(
    record: Record, poses: Reference, mounting: FloatArray, lag_s: float, gravity: float
) -> tuple[_Rows, list[Still]]:
    """Return the equations of a recording, and its rests without a valid pose."""
    from scipy.spatial.transform import Rotation

    step = float(np.median(np.diff(poses.time)))
    at = poses.time + lag_s
    accel = without_saturated(record)[0].accel
    a, inside = RunningIntegral(record.time, np.asarray(accel)).mean(at - 0.5 * step, at + 0.5 * step)
    lost = 1.0 / 24.0 + (float(np.median(np.diff(record.time))) / step) ** 2 / 12.0
    a[1:-1] -= lost * np.where((inside[2:] & inside[1:-1] & inside[:-2])[:, None], np.diff(a, 2, axis=0), 0.0)
    valid = inside & np.isfinite(a).all(axis=1) & np.isfinite(poses.q_nb).all(axis=1)
    turned = np.zeros((len(at), 3, 3))
    turned[valid] = (rotation(poses.q_nb[valid]) * Rotation.from_rotvec(mounting)).as_matrix()
    posed, unused = list[BoolArray](), list[Still]()
    for still in find_still(record, StillSettings()).stills:
        within = valid & (at >= record.time[still.start]) & (at < record.time[still.stop - 1])
        if within.any():
            posed.append(within)
        else:
            unused.append(still)
    parts = [_rests(posed, np.where(valid[:, None], a, 0.0), turned, gravity)]
    if poses.position is not None:
        seen = valid & np.isfinite(poses.position).all(axis=1)
        force = np.where(seen[:, None], a, 0.0)
        parts.append(_windows(force, turned, np.where(seen[:, None], poses.position, 0.0), seen, step, gravity))
    return _Rows(
        design=np.concatenate([p.design for p in parts]),
        delayed=np.concatenate([p.delayed for p in parts]),
        wanted=np.concatenate([p.wanted for p in parts]),
        first=np.concatenate([p.first for p in parts]),
        forces=np.concatenate([p.forces for p in parts]),
    ), unused


def pose_columns(turned: FloatArray, force: FloatArray) -> FloatArray:
    """Return what R (M a - c) multiplies M by, row by row, and c, (N, 3, 12): rotations (N, 3, 3), readings (N, 3)."""
    matrix = turned[:, :, :, None] * force[:, None, None, :]
    return np.concatenate((matrix.reshape(len(force), 3, 9), -turned), axis=2)


def _rests(posed: Sequence[BoolArray], force: FloatArray, turned: FloatArray, gravity: float) -> _Rows:
    count = len(posed)
    design, forces = np.zeros((count, 3, 15)), np.zeros((count, 3))
    for i, within in enumerate(posed):
        design[i, :, :12] = pose_columns(turned[within], force[within]).mean(axis=0)
        forces[i] = force[within].mean(axis=0)
    wanted = np.tile((0.0, 0.0, gravity), (count, 1))
    return _Rows(
        design=design,
        delayed=np.zeros((count, 3, 18)),
        wanted=wanted,
        first=np.full(count, -1),
        forces=forces,
    )


def _windows(
    force: FloatArray, turned: FloatArray, position: FloatArray, seen: BoolArray, step: float, gravity: float
) -> _Rows:
    width, stride = max(8, round(_WINDOW_S / step)), max(1, round(_STRIDE_S / step))
    phase = np.pi * (np.arange(width) + 0.5) / width
    bump = np.sin(phase) ** 4
    size = bump.sum() * step
    bend = (12.0 * np.sin(phase) ** 2 * np.cos(phase) ** 2 - 4.0 * np.sin(phase) ** 4) * (np.pi / (width * step)) ** 2
    h, second = bump * step / size, bend * step / size
    first = np.arange(0, max(0, len(seen) - width + 1), stride)
    first = first[[bool(seen[k : k + width].all()) for k in first]]
    bent = np.zeros_like(force)
    bent[1:-1] = np.diff(force, 2, axis=0) / step**2
    late = [pose_columns(turned, part)[:, :, :9] for part in (np.gradient(force, step, axis=0), bent)]
    moments = np.concatenate((pose_columns(turned, force), *late), axis=2)
    design, delayed, wanted = (np.zeros((len(first), 3, n)) for n in (15, 18, 1))
    for i, k in enumerate(first):
        part = slice(k, k + width)
        design[i, :, :12] = np.tensordot(h, moments[part, :, :12], axes=1)
        design[i, :, 12:15] = -np.tensordot(second, turned[part], axes=1)
        delayed[i] = np.tensordot(h, moments[part, :, 12:], axes=1)
        wanted[i, :, 0] = second @ (position[part] - position[k]) + (0.0, 0.0, gravity)
    middle = first + width // 2
    return _Rows(design=design, delayed=delayed, wanted=wanted[..., 0], first=first // stride, forces=force[middle])


# ---- least squares: M (9), c (3), d, level of the reference (2), then r of each recording (3 R)

_OWN, _OTHERS = 12, 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solved:
    """The solution and what it is judged by."""

    x: FloatArray  # (12,), M row by row and c
    covariance: FloatArray  # (12, 12)
    prior_sd: FloatArray  # (12,)
    residuals: FloatArray  # (n, 3), m/s2
    condition: float  # Of the design without the prior


def _solve(rows: Sequence[_Rows], nominal: FloatArray, factor: float, gravity: float) -> _Solved:
    size = _OWN + _OTHERS + 3 * len(rows)
    sd = np.concatenate(
        (
            np.full(9, _PRIOR_MATRIX * factor),
            np.full(3, _PRIOR_OFFSET),
            (0.05, _POSE_SD, _POSE_SD),
            np.ones(3 * len(rows)),
        )
    )
    mean = np.concatenate((nominal.reshape(-1), np.zeros(size - 9)))
    wanted = np.concatenate([r.wanted for r in rows])
    rest = np.concatenate([r.first < 0 for r in rows])
    x, weight = mean.copy(), np.ones((len(wanted), 3))
    rest_sd = _POSE_SD * gravity
    if 3 * len(wanted) < _OWN:
        raise NotObservable(
            f"reference: wanted four rests or more, or motion with the position, got {len(wanted)} for the accelerometers; "
            "record rests in several poses",
            rests=int(rest.sum()),
        )
    for _ in range(_PASSES):
        a = _design(rows, x, gravity)
        residual = wanted - a @ x
        scale = rest_sd
        if not rest.all():
            scale = max(_LEAST_SD, 1.4826 * float(np.median(np.abs(residual[~rest]))))
        weight = np.where(rest[:, None], rest_sd**-2.0, huber_weight(np.abs(residual), scale) / scale**2)
        flat = a.reshape(-1, size)
        normal = (flat.T * weight.reshape(-1)) @ flat + np.diag(sd**-2.0)
        x = np.linalg.solve(normal, flat.T @ (weight * wanted).reshape(-1) + mean / sd**2)
    a = _design(rows, x, gravity)
    residual = wanted - a @ x
    bread, rests = np.linalg.inv(normal), a[rest].reshape(-1, size) / rest_sd
    covariance = bread @ (np.diag(sd**-2.0) + rests.T @ rests) @ bread
    # Windows: the jackknife over blocks, x without block less x, whose few rests and turns would make a sandwich too narrow.
    # A residual beyond Huber's bound does not move x: normal equations of the others say how x follows the scores.
    moving = np.where(rest[:, None], weight, (np.abs(residual) <= HUBER * scale) / scale**2)
    normal = (a.reshape(-1, size).T * moving.reshape(-1)) @ a.reshape(-1, size) + np.diag(sd**-2.0)
    block = np.concatenate([np.where(r.first < 0, -1, 100_000 * i + r.first // _BLOCK) for i, r in enumerate(rows)])
    for number in np.unique(block[~rest]):
        chosen = block == number
        own, score = a[chosen].reshape(-1, size), (weight * residual)[chosen].reshape(-1)
        moved = np.linalg.solve(normal - (own.T * moving[chosen].reshape(-1)) @ own, own.T @ score)
        covariance += np.outer(moved, moved)
    seen = a.reshape(-1, size)[:, :_OWN]
    return _Solved(
        x=x[:_OWN],
        covariance=covariance[:_OWN, :_OWN],
        prior_sd=sd[:_OWN],
        residuals=residual,
        condition=scaled_condition(seen)[1],
    )


def _design(rows: Sequence[_Rows], x: FloatArray, gravity: float) -> FloatArray:
    count, parts = len(rows), []
    for i, r in enumerate(rows):
        own = np.zeros((len(r.wanted), 3, _OWN + _OTHERS + 3 * count))
        own[:, :, :_OWN] = r.design[:, :, :_OWN]
        own[:, :, _OWN] = (r.delayed[..., :9] + 0.5 * x[_OWN] * r.delayed[..., 9:]) @ x[:9]
        own[:, 0, _OWN + 1] = own[:, 1, _OWN + 2] = -gravity
        own[:, :, _OWN + _OTHERS + 3 * i : _OWN + _OTHERS + 3 * i + 3] = r.design[:, :, 12:]
        parts.append(own)
    return np.concatenate(parts)


def _result(rows: Sequence[_Rows], solved: _Solved, unit: str, factor: float, null: FloatArray) -> TriadFit:
    matrix = solved.x[:9].reshape(3, 3)
    if not np.linalg.det(matrix) > 0.0:
        raise NotObservable("reference: wanted a right-handed accelerometer matrix, got a reflection; check its axes")
    offset, jacobian = offset_of(matrix, solved.x[9:], 12)
    forces = (np.concatenate([r.forces for r in rows]) - offset) @ matrix.T
    rank = int((np.sqrt(np.diag(solved.covariance)) < _HELD * solved.prior_sd).sum())
    return triad_fit(
        solved.residuals.reshape(-1),
        Verdict.of(*_judged(solved, factor)),
        method="reference",
        unit_in=unit,
        unit_out="m/s2",
        matrix=matrix,
        offset=offset + null,
        covariance=jacobian @ solved.covariance @ jacobian.T,
        rank=rank,
        condition=solved.condition,
        valid_range=(float(forces.min()), float(forces.max())),
    )


def _judged(solved: _Solved, factor: float) -> Iterator[Finding]:
    sigma = np.sqrt(np.diag(solved.covariance))
    held = [n for n, s, p in zip((*MATRIX_NAMES, *OFFSET_NAMES), sigma, solved.prior_sd, strict=True) if s > _HELD * p]
    if held:
        yield finding(
            "reference.accel_held",
            "warn",
            terms=", ".join(held),
            matrix_percent=100.0 * _PRIOR_MATRIX,
            offset_m_s2=_PRIOR_OFFSET,
        )
    seen = sigma[:9][sigma[:9] <= _HELD * solved.prior_sd[:9]] / factor
    if len(seen) and float(seen.max()) > _WANTED:
        yield finding("reference.accel_uncertainty", "warn", uncertainty_percent=100.0 * float(seen.max()))
