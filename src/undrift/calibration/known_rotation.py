"""Known rotation: six faces, then one turn by a known angle about each axis; no rate table.

    s = K w + b + G a          forward model of the gyroscopes, a the true specific force

At rest on face p the mean reading is b + G a_p. Over the turn about axis j by the angle t_j the sum of readings is K e_j t_j +
b T + G A_j, T its duration and A_j the integral of the calibrated specific force.

    paper      G from half the difference of opposite faces, b from the mean of all samples at rest, K from the turns [1]_
    affine     G and b by least squares over the faces, weighted by their samples: free of bias for windows of unequal length

.. [1] F. Ferraris, U. Grimaldi, M. Parvis, "Procedure for effortless in-field calibration of three-axial rate gyros and
   accelerometers", Sensors and Materials 7(5), 1995.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.checks import (
    axis_vectors,
    cause_by_gravity,
    check_axis_order,
    check_own_scale,
    check_range,
    face_vectors,
    missing_faces,
    nearest_signed_permutation,
    order_text,
)
from undrift.calibration.multi_position_gyro import Moves, cut_moves, gravity_directions, turned_in
from undrift.calibration.observe import Observed, Outcome
from undrift.calibration.six_face import FaceMeans
from undrift.errors import Implausible, InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.least_squares import TriadFit, inverse_jacobian, scaled_condition, triad_fit
from undrift.model import AXES, G_NAMES, MATRIX_NAMES, OFFSET_NAMES, TriadModel, Verdict
from undrift.record import Axis, Record, Still, Turn
from undrift.units import RADIAN_PER_DEGREE

# ---- do the fitted gyroscopes turn gravity as the accelerometer measures it?
#
#     C(P^T M (u - o)) n_before = n_after        P one of the 48 signed permutations
#
# The fit is right where P = 1 misses the later direction by least. Full turns bring gravity back whatever the axes are, and so do
# the means on the faces: the moves between the rests show a triad whose axes are not the accelerometer's.

LARGEST_MISS_DEG = 20.0  # rms: hand moves and offset drift miss by a few degrees, an exchanged axis by 60 and more
_CLEARLY = 0.5  # another order must miss by less than this share to be named
_LEAST_MOVES = 3


def check_turns_gravity(
    records: Sequence[Record], stills: Sequence[Still], accel: TriadModel, gyro: TriadModel
) -> None:
    """Raise when fitted gyroscopes turn gravity far better with their axes in another order."""
    moves = cut_moves(records, stills, stills)
    if len(moves.first) < _LEAST_MOVES:
        return
    n = gravity_directions(moves, accel)[0]
    own = _miss_deg(moves, n, gyro.matrix, gyro.offset)
    if own <= LARGEST_MISS_DEG:
        return
    every = itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3))
    orders = [np.eye(3)[list(order)] * np.array(signs)[:, None] for order, signs in every]
    misses = [_miss_deg(moves, n, order.T @ gyro.matrix, gyro.offset) for order in orders]
    best = int(np.argmin(misses))
    if misses[best] < _CLEARLY * own and not np.array_equal(orders[best], np.eye(3)):
        raise Implausible(
            f"gyro against accel: wanted gyroscopes that turn gravity from rest to rest, got moves that miss it by {own:.0f} deg "
            f"rms, and by {misses[best]:.0f} deg were the axes x, y, z of the gyroscopes {order_text(orders[best])} of the "
            f"accelerometer: {cause_by_gravity(orders[best])}; correct the order or the sign of the columns",
            miss_deg=own,
            seen=order_text(orders[best]),
        )


def _miss_deg(moves: Moves, n: FloatArray, matrix: FloatArray, offset: FloatArray) -> float:
    turn, _ = turned_in(moves, matrix, offset, np.zeros((len(moves.first), 3)))
    arrived = (turn @ n[moves.before][:, :, None])[:, :, 0]
    cosine = np.clip((arrived * n[moves.before + 1]).sum(axis=1), -1.0, 1.0)
    return float(np.sqrt(np.mean(np.arccos(cosine) ** 2))) / RADIAN_PER_DEGREE


# ---- sums over faces and turns

KnownRotationMode = Literal["paper", "affine"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationData:
    """Sums of readings over still phases and turns."""

    rest: FaceMeans  # Gyroscope means on the faces, ``unit``
    rest_samples: FloatArray  # (P,), samples behind each mean
    angle: FloatArray  # (R,), angle of each turn about +axis, rad
    axis: tuple[Axis, ...]  # Axis of each turn
    reading: FloatArray  # (R, 3), integral of the gyroscope readings over each turn, unit * s
    force: FloatArray  # (R, 3), integral of the calibrated specific force over each turn, m/s
    duration: FloatArray  # (R,), s
    noise: FloatArray | None = None  # (R, 3), standard deviation of ``reading`` from sample noise alone


def fit_known_rotation(
    data: RotationData,
    *,
    gravity: float,
    mode: KnownRotationMode = "affine",
    angle_uncertainty: float = 0.0,
    scale_tolerance: float = 0.25,
) -> TriadFit:
    """Fit gyroscopes, with their g-sensitivity, to six faces and turns by angles with a standard uncertainty, rad."""
    _check_complete(data)
    up, samples = face_vectors(data.rest.faces), data.rest_samples
    design = np.column_stack((np.ones(len(up)), gravity * up))
    # to_rest (4, P): b and the row of G from the means of one sensor
    if mode == "paper":  # half differences, repeated faces averaged
        to_rest = np.vstack((samples / samples.sum(), (up / np.abs(up).sum(axis=0) / gravity).T))
    else:
        weighted = design * samples[:, None]
        to_rest = np.linalg.solve(weighted.T @ design, weighted.T)
    rest = to_rest @ data.rest.reading
    turned = data.reading - data.duration[:, None] * rest[0] - data.force @ rest[1:]
    turns = axis_vectors(data.axis) * data.angle[:, None]
    forward = (np.linalg.pinv(turns) @ turned).T
    _check_turns(forward, data, scale_tolerance)
    matrix = np.linalg.inv(forward)
    at_rest = data.rest.reading - (rest[0] + gravity * up @ rest[1:])
    residuals = np.concatenate((at_rest, turned - turns @ forward.T)) @ matrix.T
    rank, condition = scaled_condition(np.column_stack((np.ones(len(up)), up)))
    fastest = float(np.abs(data.angle / data.duration).max())
    found = [finding("known_rotation.no_spare_equations", "info")]
    if angle_uncertainty == 0.0:
        found.append(finding("known_rotation.angles_exact", "info"))
    return triad_fit(
        residuals,
        Verdict.of(*found),
        method=f"known-rotation/{mode}",
        unit_in=data.rest.unit,
        unit_out="rad/s",
        matrix=matrix,
        offset=rest[0],
        g_sensitivity=matrix @ rest[1:].T,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *G_NAMES),
        covariance=_covariance(data, to_rest, turns, forward, rest[1:].T, angle_uncertainty),
        rank=3 * rank + 9,
        condition=condition,
        valid_range=(-fastest, fastest),
    )


def rotation_data(
    records: Sequence[Record], stills: Sequence[Still], turns: Sequence[Turn], *, matrix: FloatArray, offset: FloatArray
) -> RotationData:
    """Sum the readings of a session over its labelled faces and its turns; matrix and offset are the accelerometer's."""
    faced, windows = [s for s in stills if s.face is not None], []
    for still in faced:
        gyro, _ = _both(records[still.recording])
        window = gyro[still.start : still.stop]
        windows.append(window[~np.isnan(window).any(axis=1)])
        if len(windows[-1]) < 2:
            raise InputError(
                f"known rotation: wanted readings at rest on face {still.face}, got {len(windows[-1])}; choose another stretch"
            )
    square = sum((((w - w.mean(axis=0)) ** 2).sum(axis=0) for w in windows), np.zeros(3))
    count = np.array([len(w) for w in windows], float)
    sigma = np.sqrt(square / max(1, int(count.sum()) - len(count)))
    used = [t for t in turns if t.axis is not None and t.angle is not None]
    sums, duration, noise = [], [], []
    for turn in used:
        gyro, accel = (values[turn.start : turn.stop] for values in _both(records[turn.recording]))
        if np.isnan(gyro).any() or np.isnan(accel).any():
            raise InputError(
                f"known rotation: wanted the turn about {turn.axis} without gaps, got some; record it again"
            )
        check_range([gyro], f"gyroscope in the turn about {turn.axis}")
        steps = np.diff(records[turn.recording].time)
        step = np.concatenate((steps[:1], steps))[turn.start : turn.stop]
        sums.append((step @ gyro, step @ ((accel - offset) @ matrix.T)))
        duration.append(step.sum())
        noise.append(sigma * np.sqrt(step @ step))
    reading, force = np.array(sums).reshape(-1, 2, 3).swapaxes(0, 1)
    return RotationData(
        rest=FaceMeans(
            reading=np.array([w.mean(axis=0) for w in windows]).reshape(-1, 3),
            faces=tuple(s.face for s in faced if s.face is not None),
            noise=sigma / np.sqrt(count)[:, None] if len(count) else None,
            unit=records[0].gyro_unit,
        ),
        rest_samples=count,
        angle=np.array([t.angle for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        reading=reading,
        force=force,
        duration=np.array(duration),
        noise=np.array(noise).reshape(-1, 3),
    )


def _both(record: Record) -> tuple[FloatArray, FloatArray]:
    if record.gyro is None or record.accel is None:
        raise InputError("known rotation: wanted gyroscope and accelerometer, got one of them; map the missing columns")
    return record.gyro, record.accel


def _check_complete(data: RotationData) -> None:
    faces, axes = missing_faces(data.rest.faces), tuple(axis for axis in AXES if axis not in data.axis)
    for missing, wanted, about, action in (
        (faces, "rest on all six faces", "for", "record the missing faces"),
        (axes, "a turn about each axis", "about", f"turn the device about {', '.join(axes)} by a known angle"),
    ):
        if missing:
            raise NotObservable(
                f"known rotation: wanted {wanted}, got none {about} {', '.join(missing)}; {action}", missing=missing
            )


def _check_turns(forward: FloatArray, data: RotationData, tolerance: float) -> None:
    seen = nearest_signed_permutation(forward)
    if not np.diag(seen).all():
        check_axis_order(forward, "known rotation", against="turns")
    reversed_ = tuple(AXES[k] for k in range(3) if seen[k, k] < 0.0)
    if reversed_:
        turned = ((axis, -data.angle[data.axis.index(axis)] / RADIAN_PER_DEGREE) for axis in reversed_)
        raise Implausible(
            f"known rotation: wanted gyroscopes that read + for a turn about their +axis, got the turn about "
            f"{', '.join(reversed_)} reversed; if the device was turned the other way give its angle as "
            f"{', '.join(f'{axis} {angle:+g} deg' for axis, angle in turned)}, else change the sign of that column",
            reversed=reversed_,
        )
    scale = np.linalg.norm(forward, axis=1)
    check_own_scale(scale, data.rest.unit, "rate", tolerance, "gyroscope turned by hand")


def _covariance(
    data: RotationData,
    to_rest: FloatArray,
    turns: FloatArray,
    forward: FloatArray,
    g_forward: FloatArray,
    angle_uncertainty: float,
) -> FloatArray:
    # Linear propagation, one sensor (row) at a time: means at rest -> b, G; sums over the turns less b T + G A -> K.
    total = np.zeros((21, 21))
    per_turn = np.linalg.pinv(turns)
    leak = np.column_stack((data.duration, data.force))
    if data.rest.noise is None or data.noise is None:
        return np.full((21, 21), np.nan)
    for row in range(3):
        rest = to_rest @ np.diag(data.rest.noise[:, row] ** 2) @ to_rest.T
        k = np.arange(3 * row, 3 * row + 3)
        bg = np.array([9 + row, 12 + 3 * row, 13 + 3 * row, 14 + 3 * row])
        total[np.ix_(k, k)] = per_turn @ (np.diag(data.noise[:, row] ** 2) + leak @ rest @ leak.T) @ per_turn.T
        total[np.ix_(bg, bg)] = rest
        total[np.ix_(k, bg)] = -per_turn @ leak @ rest
        total[np.ix_(bg, k)] = total[np.ix_(k, bg)].T
    for turn, axis in enumerate(data.axis):  # one wrong angle moves a whole column
        shift = np.outer(forward[:, AXES.index(axis)], per_turn[:, turn]).reshape(-1)
        total[:9, :9] += angle_uncertainty**2 * np.outer(shift, shift)
    matrix = np.linalg.inv(forward)
    jacobian = np.eye(21)
    jacobian[:9, :9] = inverse_jacobian(matrix)
    jacobian[12:, :9] = np.kron(np.eye(3), g_forward.T) @ jacobian[:9, :9]
    jacobian[12:, 12:] = np.kron(matrix, np.eye(3))
    return np.asarray(jacobian @ total @ jacobian.T)


# ---- from a session


def calibrate_turns(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to its turns by known angles; an entry of FITS."""
    if all(r.accel is None for r in seen.session.records):
        return Outcome(findings=(finding("known_rotation.needs_accel", "warn"),))
    if accel is None or len({s.face for s in seen.faced}) < 6:
        return Outcome(findings=(finding("known_rotation.needs_faces", "warn"),))
    turns = tuple(t for t in seen.session.turns if t.angle is not None)
    found: tuple[Finding, ...] = ()
    if not turns:
        turns = seen.full_turns()
        if not turns:
            return Outcome(findings=(finding("known_rotation.needs_turns", "warn"),))
        taken = tuple(f"{t.axis} {(t.angle or 0.0) / RADIAN_PER_DEGREE:+.0f} deg" for t in turns)
        found = (finding("known_rotation.turns_found", "warn", turns=taken),)
    data = rotation_data(seen.session.records, seen.stills, turns, matrix=accel.model.matrix, offset=accel.model.offset)
    fit = fit_known_rotation(
        data,
        gravity=seen.session.gravity_m_s2,
        mode="paper" if mode == "paper" else "affine",
        angle_uncertainty=seen.settings.angle_uncertainty_deg * RADIAN_PER_DEGREE,
        scale_tolerance=seen.settings.scale_tolerance,
    )
    check_turns_gravity(seen.session.records, seen.stills, accel.model, fit.model)
    return Outcome(fit=fit, method="known-rotation", findings=found)
