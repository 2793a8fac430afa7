"""Known rotation: six faces, then one turn by a known angle about each axis (Ferraris 1995). No rate table.

Forward model of the gyroscopes, with a the true specific force::

    s = K w + b + G a

At rest on face p (w = 0) the mean reading is b + G a_p. Over the turn about axis j by the angle t_j the sum of readings is
K e_j t_j + b T + G A_j, T its duration and A_j the integral of the calibrated specific force.

    paper      G from half the difference of opposite faces, b from the mean of all samples at rest, K from the turns [1]_
    affine     G and b by least squares over the faces, weighted by their samples: the same for windows of equal length, and
               free of bias for unequal ones
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.axis_order import check_axis_order, nearest_signed_permutation
from undrift.calibration.fit.full_range import check_range
from undrift.calibration.fit.result import TriadFit, inverse_jacobian, scaled_condition
from undrift.calibration.fit.six_face import FaceMeans
from undrift.calibration.model import AXES, G_NAMES, MATRIX_NAMES, OFFSET_NAMES, TriadModel, Verdict
from undrift.calibration.plausibility import axis_vectors, check_scale_factor, face_vectors, missing_faces
from undrift.errors import Implausible, InputError, NotObservable
from undrift.record import Record
from undrift.session import Axis, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

KnownRotationMode = Literal["paper", "affine"]


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownRotationSettings:
    """How the turns are fitted.

    Parameters
    ----------
    mode : str
        paper (Ferraris' closed form) or affine.
    angle_uncertainty : float
        Standard uncertainty of each turn's angle, rad; part of the covariance.
    stated_scale : float or None
        Sensitivity the maker states, reading per rad/s; None leaves it unchecked unless the readings are physical.
    scale_tolerance : float
        Relative tolerance of ``stated_scale``.
    """

    mode: KnownRotationMode = "affine"
    angle_uncertainty: float = 0.0
    stated_scale: float | None = None
    scale_tolerance: float = 0.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationData:
    """Sums of readings over still phases and turns.

    Parameters
    ----------
    rest : FaceMeans
        Gyroscope means on the faces, ``unit``.
    rest_samples : array, shape (P,)
        Samples behind each mean.
    angle : array, shape (R,)
        Angle of each turn about +axis, rad.
    axis : tuple of str
        Axis of each turn.
    reading : array, shape (R, 3)
        Integral of the gyroscope readings over each turn, unit * s.
    force : array, shape (R, 3)
        Integral of the calibrated specific force over each turn, m/s.
    duration : array, shape (R,)
        s.
    noise : array, shape (R, 3), or None
        Standard deviation of ``reading`` from sample noise alone.
    """

    rest: FaceMeans
    rest_samples: FloatArray
    angle: FloatArray
    axis: tuple[Axis, ...]
    reading: FloatArray
    force: FloatArray
    duration: FloatArray
    noise: FloatArray | None = None


def fit_known_rotation(
    data: RotationData, *, gravity: float, settings: KnownRotationSettings = KnownRotationSettings()
) -> TriadFit:
    """Fit gyroscopes, with their g-sensitivity, to six faces and turns by known angles.

    Parameters
    ----------
    data : RotationData
        Means on the faces and sums over the turns.
    gravity : float
        Local gravity, m/s2.
    settings : KnownRotationSettings
        Mode and checks.

    Returns
    -------
    TriadFit
        Inverse model to rad/s with g_sensitivity in rad/s per m/s2; covariance over matrix, offset and g-sensitivity.

    Raises
    ------
    NotObservable
        A face or an axis is missing.
    Implausible
        A reversed turn, or a scale factor that cannot be the sensor's.

    References
    ----------
    .. [1] F. Ferraris, U. Grimaldi, M. Parvis, "Procedure for effortless in-field calibration of three-axial rate gyros and
       accelerometers", Sensors and Materials 7(5), 1995.
    """
    _check_complete(data)
    to_rest = _rest_estimator(data, gravity, settings.mode)  # (4, P): b and the row of G from the means of one sensor
    rest = to_rest @ data.rest.reading
    turned = data.reading - data.duration[:, None] * rest[0] - data.force @ rest[1:]
    turns = axis_vectors(data.axis) * data.angle[:, None]
    forward = (np.linalg.pinv(turns) @ turned).T
    _check_turns(forward, data, settings)
    matrix = np.linalg.inv(forward)
    residuals = np.concatenate((_rest_residuals(data, rest, gravity), turned - turns @ forward.T)) @ matrix.T
    rank, condition = scaled_condition(np.column_stack((np.ones(len(data.rest.faces)), face_vectors(data.rest.faces))))
    model = TriadModel(
        method=f"known-rotation/{settings.mode}",
        unit_in=data.rest.unit,
        unit_out="rad/s",
        matrix=matrix,
        offset=rest[0],
        g_sensitivity=matrix @ rest[1:].T,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *G_NAMES),
        covariance=_covariance(data, to_rest, turns, forward, rest[1:].T, settings),
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=residuals.size,
        rank=3 * rank + 9,
        condition=condition,
        valid_range=_range(data),
    )
    return TriadFit(model=model, residuals=residuals, verdict=_verdict(settings))


def rotation_data(
    records: Sequence[Record], stills: Sequence[Still], turns: Sequence[Turn], *, matrix: FloatArray, offset: FloatArray
) -> RotationData:
    """Sum the readings of a session over its labelled faces and its turns.

    Parameters
    ----------
    records : sequence of Record
        Recordings with gyroscope and accelerometer.
    stills : sequence of Still
        Phases; those without a face are left out.
    turns : sequence of Turn
        Turns with axis and angle; the others are left out.
    matrix : array, shape (3, 3)
        Accelerometer matrix, to m/s2.
    offset : array, shape (3,)
        Accelerometer offset, its raw unit.

    Returns
    -------
    RotationData
        What ``fit_known_rotation`` takes. The reading of sample k holds on (k-1, k].

    Raises
    ------
    InputError
        A recording lacks one of the two triads, or a turn has gaps.
    Implausible
        A gyroscope that sticks at the end of its range in a turn.
    """
    means, samples, faces, square, spare = [], [], [], np.zeros(3), 0
    for still in stills:
        gyro, _ = _both(records[still.recording])
        if still.face is not None:
            window = gyro[still.start : still.stop]
            window = window[~np.isnan(window).any(axis=1)]
            if len(window) < 2:
                raise InputError(
                    f"known rotation: wanted readings at rest on face {still.face}, got {len(window)}; choose another stretch"
                )
            means.append(window.mean(axis=0))
            samples.append(len(window))
            faces.append(still.face)
            square += ((window - window.mean(axis=0)) ** 2).sum(axis=0)
            spare += len(window) - 1
    sigma = np.sqrt(square / max(1, spare))
    used = [t for t in turns if t.axis is not None and t.angle is not None]
    reading, force, duration, noise = [], [], [], []
    for turn in used:
        record = records[turn.recording]
        gyro, accel = _both(record)
        if np.isnan(gyro[turn.start : turn.stop]).any() or np.isnan(accel[turn.start : turn.stop]).any():
            raise InputError(
                f"known rotation: wanted the turn about {turn.axis} without gaps, got some; record it again"
            )
        check_range([gyro[turn.start : turn.stop]], f"gyroscope in the turn about {turn.axis}")
        step = _steps(record.time)[turn.start : turn.stop]
        reading.append(step @ gyro[turn.start : turn.stop])
        force.append(step @ ((accel[turn.start : turn.stop] - offset) @ matrix.T))
        duration.append(step.sum())
        noise.append(sigma * np.sqrt(step @ step))
    count = np.array(samples, float)
    unit = records[0].gyro_unit
    return RotationData(
        rest=FaceMeans(
            reading=np.array(means).reshape(-1, 3),
            faces=tuple(faces),
            noise=sigma / np.sqrt(count)[:, None] if len(count) else None,
            unit=unit,
        ),
        rest_samples=count,
        angle=np.array([t.angle for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        reading=np.array(reading).reshape(-1, 3),
        force=np.array(force).reshape(-1, 3),
        duration=np.array(duration),
        noise=np.array(noise).reshape(-1, 3),
    )


def _both(record: Record) -> tuple[FloatArray, FloatArray]:
    if record.gyro is None or record.accel is None:
        raise InputError("known rotation: wanted gyroscope and accelerometer, got one of them; map the missing columns")
    return record.gyro, record.accel


def _steps(time: FloatArray) -> FloatArray:
    step = np.diff(time)
    return np.concatenate((step[:1], step))


def _check_complete(data: RotationData) -> None:
    missing = missing_faces(data.rest.faces)
    if missing:
        raise NotObservable(
            f"known rotation: wanted rest on all six faces, got none for {', '.join(missing)}; record the missing faces",
            missing=missing,
        )
    lacking = [axis for axis in AXES if axis not in data.axis]
    if lacking:
        raise NotObservable(
            f"known rotation: wanted a turn about each axis, got none about {', '.join(lacking)}; "
            f"turn the device about {', '.join(lacking)} by a known angle",
            missing=tuple(lacking),
        )


def _rest_estimator(data: RotationData, gravity: float, mode: KnownRotationMode) -> FloatArray:
    up, samples = face_vectors(data.rest.faces), data.rest_samples
    if mode == "paper":
        opposite = up / np.abs(up).sum(axis=0) / gravity  # half differences, repeated faces averaged
        return np.vstack((samples / samples.sum(), opposite.T))
    design = np.column_stack((np.ones(len(up)), gravity * up))
    weighted = design * samples[:, None]
    return np.asarray(np.linalg.solve(weighted.T @ design, weighted.T))


def _rest_residuals(data: RotationData, rest: FloatArray, gravity: float) -> FloatArray:
    model: FloatArray = rest[0] + gravity * face_vectors(data.rest.faces) @ rest[1:]
    return data.rest.reading - model


def _check_turns(forward: FloatArray, data: RotationData, settings: KnownRotationSettings) -> None:
    seen = nearest_signed_permutation(forward)
    if not np.diag(seen).all():
        check_axis_order(forward, "known rotation", against="turns")
    reversed_ = [k for k in range(3) if seen[k, k] < 0.0]
    if reversed_:
        axes = ", ".join(AXES[k] for k in reversed_)
        angles = ", ".join(
            f"{AXES[k]} {-data.angle[data.axis.index(AXES[k])] / RADIAN_PER_DEGREE:+g} deg" for k in reversed_
        )
        raise Implausible(
            f"known rotation: wanted gyroscopes that read + for a turn about their +axis, got the turn about {axes} reversed; "
            f"if the device was turned the other way give its angle as {angles}, else change the sign of "
            "that column",
            reversed=tuple(AXES[k] for k in reversed_),
        )
    stated = settings.stated_scale
    if stated is None and is_physical(data.rest.unit):
        stated = 1.0 / si_factor(data.rest.unit, "rate")
    if stated is not None:
        check_scale_factor(
            np.linalg.norm(forward, axis=1), stated, settings.scale_tolerance, "gyroscope turned by hand"
        )


def _covariance(
    data: RotationData,
    to_rest: FloatArray,
    turns: FloatArray,
    forward: FloatArray,
    g_forward: FloatArray,
    settings: KnownRotationSettings,
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
    for turn, axis in enumerate(data.axis):
        shift = np.outer(forward[:, AXES.index(axis)], per_turn[:, turn]).reshape(
            -1
        )  # one wrong angle moves a whole column
        total[:9, :9] += settings.angle_uncertainty**2 * np.outer(shift, shift)
    matrix = np.linalg.inv(forward)
    jacobian = np.eye(21)
    jacobian[:9, :9] = inverse_jacobian(matrix)
    jacobian[12:, :9] = np.kron(np.eye(3), g_forward.T) @ jacobian[:9, :9]
    jacobian[12:, 12:] = np.kron(matrix, np.eye(3))
    covariance: FloatArray = jacobian @ total @ jacobian.T
    return covariance


def _range(data: RotationData) -> tuple[float, float]:
    fastest = float(np.abs(data.angle / data.duration).max())
    return -fastest, fastest


def _verdict(settings: KnownRotationSettings) -> Verdict:
    reason = "each turn is one equation for its column of the matrix: nothing is left over to check the angles against"
    if settings.angle_uncertainty == 0.0:
        reason += (
            "; the uncertainty stated takes them as exact (1 deg of 360 is 0.28 % of scale): give angle_uncertainty"
        )
    return Verdict(reasons=(reason,))
