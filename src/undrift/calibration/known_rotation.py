"""Calibrate gyroscopes from rests and a turn by a known angle about each axis, without a rate table.

A turn about axis j by the angle t_j in the time T has the known mean rate t_j / T about j, however the rate varied during the turn.
Its mean reading u and mean specific force f give rows of the same equations as a rate table. The means at rest give such rows too.

    paper      G from half the difference of opposite faces, b from the mean of all samples at rest, K from the turns [1]_
    affine     M u - c - G f = w + errors          M (3, 3), c = M o, G the g-sensitivity, w = 0 at rest

Without accelerometers G is not fitted, and its possible effect on each piece is a source of error. If the device was not turned
about an axis, that column of M keeps the nominal scale, as on a rate table. Sources of error in the frame of the case:

    noise, adc     M n                    noise and rounding of the mean
    angle          a / T along j          angle error of a turn, with M u' d / T for jitter d of the time stamps
    axis           (t / T) d_j across j   common tilt of the axis of all turns about j against the case
    temperature    warmth (alpha + beta w)   dependence of offset and scale on temperature
    instability    flicker and a steady drift of known size, and a random walk of each sensor with an excess variance (fit/gls.py)

Moves between the rests turn gravity, and determine the matrix as well (moves.py). Both estimates are combined. The turns give the
parameters x with matrix x_M, the moves give the matrix m. With K = (cov(x, x_M) - cov(x, m)) cov(m - x_M)^-1, the estimate is
x + K (m - x_M). Turns and moves share the slopes of the scale over temperature: cov(x, m) = D_x D_m'.

.. [1] F. Ferraris, U. Grimaldi, M. Parvis, "Procedure for effortless in-field calibration of three-axial rate gyros and
   accelerometers", Sensors and Materials 7(5), 1995.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import limited_by_codes, mean_rounding
from undrift.calibration.moves import matrix_of_moves
from undrift.calibration.plausibility import (
    axis_vectors,
    check_axis_order,
    check_own_scale,
    check_range,
    face_vectors,
    missing_faces,
    nearest_signed_permutation,
)
from undrift.calibration.rate_table import axes_missing, check_reads_positive, first_table_matrix, table_prior
from undrift.calibration.session import Observed, spans_of
from undrift.calibration.settings import Mode
from undrift.calibration.sources import (
    Creep,
    creep_of,
    gyro_drift,
    in_case,
    noise_and_codes,
    offset_drift,
    slip_covariance,
    walks_of,
)
from undrift.calibration.triads import check_agreement
from undrift.errors import Implausible, InputError, NotObservable, PoorFit
from undrift.findings import Finding, finding
from undrift.fit.gls import block_size, carried, noise_of_means, solve_inverse
from undrift.fit.priors import G_SENSITIVITY
from undrift.fit.triad import TriadFit, TriadParameters, fit_of, inverse_jacobian, offset_of, parameters_of
from undrift.model import AXES, TriadModel
from undrift.record import Axis, Face, Record, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

CONTRADICTION = 27.9  # chi-square of nine terms that chance exceeds in one session in a thousand
MIN_NOISE = 1e-12  # arithmetic error of a mean, relative to the largest reading

# ---- means over rests and turns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationRows:
    """Means over P rests, then over R turns: E pieces."""

    reading: FloatArray  # (E, 3), mean gyroscope readings, ``unit``
    noise: FloatArray  # (E, 3), standard deviation of each mean
    force: FloatArray | None  # (E, 3), calibrated specific force, m/s2, or None without accelerometers
    samples: FloatArray  # (P,), number of samples in each rest
    faces: tuple[Face | None, ...]  # (P,), face that points up, or None for a rest in any pose
    duration: FloatArray  # (R,), duration of each turn, s
    axis: tuple[Axis, ...]  # (R,), of each turn
    angle: FloatArray  # (R,), angle of each turn about +axis, rad
    # (R, 3, 3), covariance of the integral due to clock jitter, (unit s)^2
    slip: FloatArray = field(default_factory=lambda: np.zeros((1, 3, 3)))
    span: FloatArray | None = None  # (E, 2), start and stop of each piece on one clock, s
    rounding: FloatArray = field(
        default_factory=lambda: np.zeros(3)
    )  # (3,), rounding error of a mean at rest, ``unit``
    unit: str = "rad/s"
    pieces: tuple[Still | Turn, ...] = ()  # (E,)

    @property
    def rate(self) -> FloatArray:
        """Known mean rate of each piece, (E, 3), rad/s."""
        return self.of_turns(axis_vectors(self.axis) * (self.angle / self.duration)[:, None])

    def of_turns(self, values: FloatArray) -> FloatArray:
        """Return rows (E, ..) for all pieces from rows (R, ..) for the turns, with zeros at rest."""
        return np.concatenate((np.zeros((len(self.faces), *values.shape[1:])), values))


def rotation_rows(
    records: Sequence[Record],
    stills: Sequence[Still],
    turns: Sequence[Turn],
    *,
    matrix: FloatArray | None,
    offset: FloatArray | None,
) -> RotationRows:
    """Average the readings of a session over its rests and turns. Matrix and offset describe the accelerometer, if there is one."""
    used = [turn for turn in turns if turn.axis is not None and turn.angle is not None]
    candidates: tuple[Still | Turn, ...] = (*stills, *used)
    pieces, windows, duration, slip = list[Still | Turn](), list[FloatArray](), list[float](), list[FloatArray]()
    reading, force, spread = list[FloatArray](), list[FloatArray](), list[float]()
    for piece in candidates:
        gyro, specific_force = _readings(records[piece.recording], piece, matrix, offset)
        finite = np.isfinite(gyro).all(axis=1) & np.isfinite(specific_force).all(axis=1)
        if isinstance(piece, Turn):
            if not finite.all():
                raise InputError(f"known rotation: the turn about {piece.axis} has gaps. Record it again.")
            check_range([gyro], f"gyroscope in the turn about {piece.axis}")
            time = records[piece.recording].time
            weight = np.diff(time, prepend=2.0 * time[0] - time[1])[piece.start : piece.stop]
            duration.append(float(weight.sum()))
            slip.append(slip_covariance(time[piece.start : piece.stop], gyro))
        elif finite.sum() > 1:
            weight = np.ones(int(finite.sum()))
            windows.append(gyro[finite])
        elif piece.face is None:
            continue
        else:
            raise InputError(
                f"known rotation: expected readings at rest on face {piece.face}, got {finite.sum()}. Choose another stretch."
            )
        weight = weight / weight.sum()
        pieces.append(piece)
        reading.append(weight @ gyro[finite])
        force.append(weight @ specific_force[finite])
        spread.append(float(np.linalg.norm(weight)))  # standard deviation of the mean for unit readings
    rests = [piece for piece in pieces if isinstance(piece, Still)]
    every = [np.asarray(records[k].gyro) for k in {still.recording for still in rests}]
    return RotationRows(
        reading=np.array(reading).reshape(-1, 3),
        noise=np.outer(spread, _sample_noise(windows, [records[rest.recording].sample_rate_hz for rest in rests])),
        force=None if matrix is None else np.array(force).reshape(-1, 3),
        samples=np.array([len(window) for window in windows], float),
        faces=tuple(still.face for still in rests),
        duration=np.array(duration),
        axis=tuple(turn.axis for turn in used if turn.axis is not None),
        angle=np.array([turn.angle for turn in used], float),
        slip=np.array(slip).reshape(-1, 3, 3),
        span=spans_of(records, pieces),
        rounding=mean_rounding(every, windows) if rests else np.zeros(3),
        unit=records[0].gyro_unit,
        pieces=tuple(pieces),
    )


def _readings(
    record: Record, piece: Still | Turn, matrix: FloatArray | None, offset: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return rate readings and specific force (N, 3), m/s2, of a piece. The force is zero without an accelerometer."""
    gyro = np.asarray(record.gyro)[piece.start : piece.stop]
    if matrix is None or offset is None or record.accel is None:
        return gyro, np.zeros_like(gyro)
    return gyro, np.asarray((record.accel[piece.start : piece.stop] - offset) @ matrix.T)


def _sample_noise(windows: Sequence[FloatArray], sample_rates_hz: Sequence[float]) -> FloatArray:
    """Return the standard deviation (3,) of a sample at rest, from the scatter of samples and of block means."""
    if not windows:
        return np.zeros(3)
    square = np.sum([((window - window.mean(axis=0)) ** 2).sum(axis=0) for window in windows], axis=0)
    white = np.sqrt(square / max(1, sum(map(len, windows)) - len(windows)))
    blocks = noise_of_means(windows, [block_size(rate_hz) for rate_hz in sample_rates_hz])
    return np.asarray(white if blocks is None else np.maximum(white, blocks[0] * len(windows[0]) ** 0.5))


# ---- sources and fit


def _sources(
    rows: RotationRows, matrix: FloatArray, angle_uncertainty: float, axis_uncertainty: float
) -> dict[str, FloatArray]:
    """Return the covariances (3 E, 3 E) of the rows by source, (rad/s)^2, for standard uncertainties of angle and axis in rad."""
    rests, own, axes = len(rows.faces), np.eye(len(rows.reading)), axis_vectors(rows.axis)
    noise = np.maximum(rows.noise, MIN_NOISE * np.abs(rows.reading).max())
    angle = angle_uncertainty**2 * axes[:, :, None] * axes[:, None] + matrix @ rows.slip @ matrix.T
    per_turn = rows.of_turns(angle / rows.duration[:, None, None] ** 2)
    code_groups = own.copy()  # All rests read the same code with the same error. Each turn has its own error.
    code_groups[:rests, :rests] = 1.0
    # all turns about the same axis have a common tilt, due to a fixture or an edge
    leaning = np.einsum("ej,fj,jk->efk", rows.rate, rows.rate, 1.0 - np.eye(3))
    sources = {
        **noise_and_codes(matrix, noise**2, code_groups[:, :, None] * rows.rounding**2),
        "angle": np.einsum("eij,ef->eifj", per_turn, own).reshape(2 * (rows.reading.size,)),
        "axis": axis_uncertainty**2 * in_case(np.eye(3), leaning),
    }
    if rows.span is not None:
        sources["instability"] = gyro_drift(rows.span)
    if rows.force is None:  # the g-sensitivity keeps its prior
        sources["prior"] = np.full(rows.reading.size, (G_SENSITIVITY * STANDARD_GRAVITY) ** 2)
    return sources


def fit_known_rotation(
    rows: RotationRows,
    *,
    gravity: float,
    mode: Mode = "affine",
    angle_uncertainty: float = 0.0,
    axis_uncertainty: float = 0.0,
    cross_axis_prior: float = 0.01,
    creep: Creep | None = None,
    moves: Callable[[TriadParameters], tuple[TriadParameters, FloatArray]] | None = None,
) -> TriadFit:
    """Fit gyroscopes to rests and turns, with their g-sensitivity if there is an accelerometer.

    Uncertainties of angle and axis are in rad. ``moves`` is called with the fit to the turns and returns the matrix from the moves.
    For an axis without a turn, the column of M keeps the nominal scale factor, with cross-axis terms of ``cross_axis_prior``.
    """
    turn_axes = _check_complete(rows, mode)
    matrix = first_table_matrix(rows.rate, rows.reading, turn_axes, rows.unit)
    _check_turns(np.linalg.inv(matrix), rows, turn_axes)
    sources, findings = _sources(rows, matrix, angle_uncertainty, axis_uncertainty), list[Finding]()
    warmth = np.zeros((rows.reading.size, 6)) if creep is None else creep.columns_in_case(rows.rate)
    sources["temperature"] = warmth @ warmth.T
    if mode == "paper":
        fitted, residuals = _closed_form(rows, sources, gravity)
    else:
        excess = walks_of(rows.span)
        if len(rows.axis) > len(turn_axes):  # a single turn per axis does not reveal the scatter of turns by hand
            excess["angle"] = rows.of_turns(np.repeat(rows.duration[:, None] ** -2, 3, axis=1)).ravel()
        prior = table_prior(matrix, turn_axes, rows.force is not None, rows.unit, cross_axis_prior)
        gls = solve_inverse(rows.reading, rows.rate, rows.force, matrix, sources, excess=excess, prior=prior)
        fitted, residuals = parameters_of(gls), -gls.residuals.reshape(-1, 3)
        if len(turn_axes) == 3 and moves is not None:
            _, jacobian = offset_of(fitted.matrix, gls.theta[9:12], len(gls.theta))
            fitted, findings = _combine_with_moves(fitted, jacobian @ gls.gains @ warmth[:, 1::2], moves)
        elif len(turn_axes) < 3:
            findings = [axes_missing([AXES[k] for k in turn_axes], rows.unit, cross_axis_prior)]
        findings = [*findings, *offset_drift(gls)]
    findings += limited_by_codes("gyroscope", rows.rounding**2, np.diag(fitted.covariance)[9:12], rows.unit)
    names = {"method": f"known-rotation/{mode}", "unit_in": rows.unit, "unit_out": "rad/s"}
    return fit_of(fitted, rows.rate, residuals, *findings, remainder="instability", **names)


def _closed_form(
    rows: RotationRows, sources: dict[str, FloatArray], gravity: float
) -> tuple[TriadParameters, FloatArray]:
    """Return the parameters of mode paper, and the residuals (E, 3), rad/s.

    K, b and H of s = K w + b + H a are linear in the mean readings. M = K^-1 and G = M H give dM = -M dK M, dG = -M dK G + M dH.
    """
    rests, samples = len(rows.faces), rows.samples
    up = np.array([face_vectors([face])[0] if face else np.zeros(3) for face in rows.faces])
    force = np.zeros_like(rows.reading) if rows.force is None else rows.force
    per_turn, closed = np.linalg.pinv(rows.rate[rests:]), np.zeros((7, len(rows.reading)))  # K, b and H of a sensor
    # b is the mean of all samples at rest, H the half difference of opposite faces
    closed[3:, :rests] = np.vstack((samples / samples.sum(), (up / np.abs(up).sum(axis=0) / gravity).T))
    closed[:3, :rests] = -per_turn @ np.column_stack((np.ones(len(rows.axis)), force[rests:])) @ closed[3:, :rests]
    closed[:3, rests:] = per_turn
    forward = (closed @ rows.reading).T
    matrix = np.linalg.inv(forward[:, :3])
    g = matrix @ forward[:, 4:]
    jacobian = np.eye(21)
    jacobian[:9, :9], jacobian[12:, :9] = inverse_jacobian(matrix), -np.kron(matrix, g.T)
    jacobian[12:, 12:] = np.kron(matrix, np.eye(3))
    # errors e of the rows correspond to errors K e of the readings
    change = np.einsum("pe,ik->ipek", closed, forward[:, :3]).reshape(3, 7, -1)
    gains = jacobian @ np.vstack((change[:, :3].reshape(9, -1), change[:, 3], change[:, 4:].reshape(9, -1)))
    parts = {name: carried(gains, covariance) for name, covariance in sources.items()}
    theta = np.concatenate((matrix.ravel(), forward[:, 3], g.ravel()))
    residuals = (rows.reading - forward[:, 3]) @ matrix.T - force @ g.T - rows.rate
    return TriadParameters(theta, np.sum([*parts.values()], axis=0), parts), residuals


def _combine_with_moves(
    turns: TriadParameters,
    warmth: FloatArray,
    matrix_of: Callable[[TriadParameters], tuple[TriadParameters, FloatArray]],
) -> tuple[TriadParameters, list[Finding]]:
    """Combine turns and moves, and return a finding if they disagree.

    ``warmth`` (P, 3) is D_x: the change of the parameters by one standard deviation of the slope of each sensor's scale.
    """
    try:
        moves, moves_warmth = matrix_of(turns)
    except NotObservable:
        return turns, []
    except PoorFit as error:
        return turns, [_moves_disagree(f"The moves between rests contradict the turns and were not used: {error}")]
    difference, common = moves.theta - turns.theta[:9], warmth @ moves_warmth.T
    spread = moves.covariance + turns.covariance[:9, :9] - common[:9] - common[:9].T
    gain = np.linalg.solve(spread, (turns.covariance[:, :9] - common).T).T
    change = np.eye(len(turns.theta))
    change[:, :9] -= gain
    joined = TriadParameters(
        theta=turns.theta + gain @ difference,
        covariance=turns.covariance - carried(gain, spread),
        parts={name: carried(change, share) for name, share in turns.parts.items()},
    )
    if difference @ np.linalg.solve(spread, difference) <= CONTRADICTION:
        return joined, []
    percent = 100.0 * float(np.abs(difference).max() / np.linalg.norm(moves.matrix, 2))
    return joined, [
        _moves_disagree(
            f"The matrices of turns and of moves between rests differ by {percent:.2g} %, beyond their uncertainty."
        )
    ]


def _moves_disagree(sentence: str) -> Finding:
    action = "Check the angles, axes and rests in the session, and that both sensors use the same clock."
    return finding("known_rotation.moves_disagree", "warn", sentence, action)


def _check_complete(rows: RotationRows, mode: Mode) -> list[int]:
    """Return the axes of the turns. Raise if rests or turns are missing."""
    turn_axes = [k for k, axis in enumerate(AXES) if axis in rows.axis]
    if not turn_axes or not rows.faces:
        raise NotObservable(
            f"known rotation: expected a turn by a known angle and a rest, got {len(rows.axis)} turns and {len(rows.faces)} rests. "
            "Turn the device about x, y and z, and rest before and after each turn."
        )
    lacking = (
        *missing_faces([face for face in rows.faces if face is not None]),
        *(axis for axis in AXES if axis not in rows.axis),
        *(("the accelerometers",) if rows.force is None else ()),
    )
    if mode == "paper" and lacking:
        raise NotObservable(
            "known rotation, mode paper: accelerometers, rests on all six faces and turns about x, y and z are needed. Missing: "
            f"{', '.join(lacking)}. Record them.",
            missing=lacking,
        )
    return turn_axes


def _check_turns(forward: FloatArray, rows: RotationRows, turn_axes: list[int]) -> None:
    """Raise if gyroscope and turn axes disagree, or if a scale is far from the nominal scale of the unit."""
    if len(turn_axes) < 3:
        for k in turn_axes:
            check_reads_positive(forward[:, k], k)
    elif not np.diag(signs := nearest_signed_permutation(forward)).all():
        check_axis_order(forward, "known rotation", against="turns")
    elif reversed_ := tuple(AXES[k] for k in range(3) if signs[k, k] < 0.0):
        angles = ((axis, -rows.angle[rows.axis.index(axis)] / RADIAN_PER_DEGREE) for axis in reversed_)
        raise Implausible(
            f"known rotation: the turn about {', '.join(reversed_)} reads reversed. Reverse that column. If the device was turned "
            f"the other way, give its angle as {', '.join(f'{axis} {angle:+g} deg' for axis, angle in angles)}.",
            reversed=reversed_,
        )
    scale = np.linalg.norm(forward, axis=1)[turn_axes]
    check_own_scale(scale, rows.unit, "rate", "gyroscope turned by hand")


# ---- from a session


def _check_by_gravity(record: Record, gyro: TriadModel, accel: TriadModel) -> tuple[Finding, ...]:
    """Compare the corrected rotation with gravity. Return a finding or raise an error if they disagree."""
    rate = (np.asarray(record.gyro) - gyro.offset) @ gyro.matrix.T
    force = (np.asarray(record.accel) - accel.offset) @ accel.matrix.T
    try:
        return check_agreement(replace(record, gyro=rate, accel=force, gyro_unit="rad/s", accel_unit="m/s2"))
    except Implausible as error:
        raise Implausible(
            f"known rotation: after the calibration, {error} The turns determine scale and axes, so their angles or axes may be "
            "wrong: give angles in deg, not rad, and 360 for a full turn.",
            **error.numbers,
        ) from error


def calibrate_turns(observed: Observed, mode: Mode, accel: TriadFit | None) -> TriadFit:
    """Fit the gyroscopes of a session to its turns by known angles."""
    records, settings = observed.session.records, observed.settings
    turns, findings = tuple(t for t in observed.session.turns if t.angle is not None), list[Finding]()
    if not turns:
        raise NotObservable(
            "expected turns by known angles, got none. Turn the device about x, y and z between rests, and give angle_deg."
        )
    model = None if accel is None else accel.model
    matrix, offset = (None, None) if model is None else (model.matrix, model.offset)
    # a session may list rests on faces only, but rests next to the turns give moves
    rests = (*observed.stills, *observed.unused_stills((*observed.stills, *turns)))
    rows = rotation_rows(records, rests, turns, matrix=matrix, offset=offset)
    moves: Callable[[TriadParameters], tuple[TriadParameters, FloatArray]] | None = None
    if model is not None:
        used = [piece for piece in rows.pieces if isinstance(piece, Still)]
        stills = sorted(used, key=lambda still: (still.recording, still.start))
        creeps = creep_of(observed, stills, "accel"), creep_of(observed, stills, "gyro")
        moves = partial(matrix_of_moves, records, stills, model, creep=creeps)
    fit = fit_known_rotation(
        rows,
        gravity=observed.session.gravity_m_s2,
        mode=mode,
        angle_uncertainty=settings.angle_uncertainty_deg * RADIAN_PER_DEGREE,
        axis_uncertainty=settings.axis_uncertainty_deg * RADIAN_PER_DEGREE,
        cross_axis_prior=settings.cross_axis_prior,
        creep=creep_of(observed, rows.pieces, "gyro"),
        moves=moves,
    )
    if model is not None:
        # Full turns restore gravity for any axes. Moves reveal gyroscope axes that differ from the accelerometer's axes.
        for record in records:
            findings += _check_by_gravity(record, fit.model, model)
    return fit.also(*findings)
