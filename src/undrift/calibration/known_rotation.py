"""Known rotation: rests, and one turn by a known angle about each axis; no rate table.

A turn about axis j by the angle t_j in the time T is a piece at the known mean rate t_j / T about j, whatever the rate was on the
way. Its mean reading u and mean specific force f, and those of the rests, are rows of the same equations as on a rate table:

    paper      G from half the difference of opposite faces, b from the mean of all samples at rest, K from the turns [1]_
    affine     M u - c - G f = w + errors          M (3, 3), c = M o, and G, the g-sensitivity; w = 0 at rest

Without accelerometers G is left out, and what it may do to each piece is a source of error. Columns of M of axes about which the
device was not turned keep the nominal scale, as on a rate table. The errors in the frame of the case:

    noise, adc     M n                    noise and rounding of the mean
    angle          a / T along j          angle of a turn, and jitter of the clock
    axis           (t / T) d_j across j   the axis of the turns about j against the case, in common to them
    temperature    warmth (alpha + beta w)   offset and scale follow the temperature
    instability    flicker of a stated size, and a random walk of each sensor, whose size is an excess variance (fit/gls.py)

Moves between the rests turn gravity, which shows the matrix as well (moves.py): its fit joins both.

.. [1] F. Ferraris, U. Grimaldi, M. Parvis, "Procedure for effortless in-field calibration of three-axial rate gyros and
   accelerometers", Sensors and Materials 7(5), 1995.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import limited_by_codes, mean_rounding
from undrift.calibration.moves import fit_moves
from undrift.calibration.plausibility import (
    SCALE_TOLERANCE,
    axis_vectors,
    check_axis_order,
    check_own_scale,
    check_range,
    face_vectors,
    missing_faces,
    nearest_signed_permutation,
)
from undrift.calibration.rate_table import axes_missing, check_reads_positive, first_table_matrix, table_prior
from undrift.calibration.session import Observed, Outcome, spans_of
from undrift.calibration.sources import Creep, creep_of, flicker_about_mean, in_case, walks_of
from undrift.calibration.triads import find_disagreement
from undrift.errors import Implausible, InputError, NotObservable, PoorFit
from undrift.findings import Finding, finding
from undrift.fit.gls import block_size, carried, noise_of_means, solve_inverse
from undrift.fit.priors import G_SENSITIVITY, GYRO_FLICKER
from undrift.fit.triad import TriadFit, TriadParameters, fit_of, inverse_jacobian, parameters_of
from undrift.model import AXES, TriadModel, Verdict
from undrift.record import Axis, Face, Record, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

KnownRotationMode = Literal["paper", "affine"]

CONTRADICTION = 27.9  # chi-square of nine terms that chance exceeds in one session of a thousand
MIN_NOISE = 1e-12  # of the largest reading: no mean is known better than its arithmetic
GAP = 1.5  # median steps of the clock: a longer one is a gap, not jitter

# ---- means over rests and turns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationRows:
    """Means over P rests, then over R turns: E pieces."""

    reading: FloatArray  # (E, 3), of the gyroscopes, ``unit``
    noise: FloatArray  # (E, 3), standard deviation of each mean
    force: FloatArray | None  # (E, 3), calibrated specific force, m/s2; None without accelerometers
    samples: FloatArray  # (P,), samples in each rest
    faces: tuple[Face | None, ...]  # (P,), face that points up; None for a rest in any pose
    duration: FloatArray  # (R,), of each turn, s
    axis: tuple[Axis, ...]  # (R,), of each turn
    angle: FloatArray  # (R,), of each turn about +axis, rad
    slip: FloatArray | None = None  # (R,), what jitter of the clock adds to the integral along the axis, unit * s
    span: FloatArray | None = None  # (E, 2), start and stop of each piece on one clock, s
    rounding: FloatArray | None = None  # (3,), what rounding leaves in a mean at rest, ``unit``
    unit: str = "rad/s"
    pieces: tuple[Still | Turn, ...] = ()  # (E,)

    @property
    def rate(self) -> FloatArray:
        """Known mean rate of each piece, (E, 3), rad/s."""
        return self.of_turns(axis_vectors(self.axis) * (self.angle / self.duration)[:, None])

    def of_turns(self, values: FloatArray) -> FloatArray:
        """Return rows (E, 3, ..) that are zero at rest, from those of the turns (R, 3, ..)."""
        return np.concatenate((np.zeros((len(self.faces), *values.shape[1:])), values))


def rotation_rows(
    records: Sequence[Record],
    stills: Sequence[Still],
    turns: Sequence[Turn],
    *,
    matrix: FloatArray | None,
    offset: FloatArray | None,
) -> RotationRows:
    """Average the readings of a session over its rests and turns; matrix and offset are the accelerometer's, if there is one."""
    used = [turn for turn in turns if turn.axis is not None and turn.angle is not None]
    windows, force, rests = list[FloatArray](), list[FloatArray](), list[Still]()
    for still in stills:
        gyro, felt = (values[still.start : still.stop] for values in _triads(records[still.recording], matrix, offset))
        whole = ~np.isnan(gyro).any(axis=1) & ~np.isnan(felt).any(axis=1)
        if whole.sum() > 1:
            windows.append(gyro[whole])
            force.append(felt[whole].mean(axis=0))
            rests.append(still)
        elif still.face is not None:
            raise InputError(
                f"known rotation: expected readings at rest on face {still.face}, got {whole.sum()}. Choose another stretch."
            )
    samples, noise = np.array([len(window) for window in windows], float), list[FloatArray]()
    white = sample_sd = np.zeros(3)  # by the scatter of samples, and of block means, at rest
    if windows:
        square = np.sum([((w - w.mean(axis=0)) ** 2).sum(axis=0) for w in windows], axis=0)
        white = np.sqrt(square / max(1.0, float(samples.sum()) - len(samples)))
        blocks = noise_of_means(windows, [block_size(records[s.recording].sample_rate_hz) for s in rests])
        sample_sd = white if blocks is None else np.maximum(white, blocks[0] * samples[0] ** 0.5)
        noise = [sample_sd / count**0.5 for count in samples]
    reading, duration, slip = [window.mean(axis=0) for window in windows], list[float](), list[float]()
    for turn in used:
        record, k = records[turn.recording], AXES.index(turn.axis or "x")
        gyro, felt = (values[turn.start : turn.stop] for values in _triads(record, matrix, offset))
        if np.isnan(gyro).any() or np.isnan(felt).any():
            raise InputError(f"known rotation: the turn about {turn.axis} has gaps. Record it again.")
        check_range([gyro], f"gyroscope in the turn about {turn.axis}")
        steps = np.diff(record.time)
        step = np.concatenate((steps[:1], steps))[turn.start : turn.stop]
        duration.append(float(step.sum()))
        reading.append(step @ gyro / duration[-1])
        force.append(step @ felt / duration[-1])
        noise.append(sample_sd * np.sqrt(step @ step) / duration[-1])
        # A stamp off by d moves the integral by d times the change of the reading there: jitter of steps has twice its variance.
        even = steps[steps < GAP * np.median(steps)]
        change = float((np.diff(gyro[:, k]) ** 2).sum()) - 2.0 * (len(gyro) - 1) * float(white[k]) ** 2
        slip.append(float(np.sqrt(0.5 * even.var() * max(change, 0.0))))
    return RotationRows(
        reading=np.array(reading).reshape(-1, 3),
        noise=np.array(noise).reshape(-1, 3),
        force=None if matrix is None else np.array(force).reshape(-1, 3),
        samples=samples,
        faces=tuple(still.face for still in rests),
        duration=np.array(duration),
        axis=tuple(turn.axis for turn in used if turn.axis is not None),
        angle=np.array([turn.angle for turn in used], float),
        slip=np.array(slip),
        span=spans_of(records, [*rests, *used]),
        rounding=mean_rounding([_triads(records[k], None, None)[0] for k in {s.recording for s in rests}], windows)
        if rests
        else None,
        unit=records[0].gyro_unit,
        pieces=(*rests, *used),
    )


def _triads(record: Record, matrix: FloatArray | None, offset: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return rate readings and the specific force (N, 3), m/s2; zeros without matrix and offset of an accelerometer."""
    if record.gyro is None or (matrix is not None and record.accel is None):
        raise InputError(
            "known rotation: expected both sensors in every recording. Map the columns of gyroscope and accelerometer."
        )
    if matrix is None or offset is None or record.accel is None:
        return record.gyro, np.zeros((len(record), 3))
    return record.gyro, np.asarray((record.accel - offset) @ matrix.T)


# ---- sources and fit


def _sources(
    rows: RotationRows, matrix: FloatArray, angle_uncertainty: float, axis_uncertainty: float
) -> dict[str, FloatArray]:
    """Return the stated covariances (3 E, 3 E) of the rows, or their diagonals (3 E,), (rad/s)^2; angle and axis in rad."""
    rests, own, along = len(rows.faces), np.eye(len(rows.reading)), axis_vectors(rows.axis)
    noise = np.maximum(rows.noise, MIN_NOISE * np.abs(rows.reading).max())
    sources = {"noise": in_case(matrix, own[:, :, None] * noise[:, None] ** 2)}
    if rows.rounding is not None:
        alike = own.copy()  # the rests read one code and err alike; a turn errs by itself
        alike[:rests, :rests] = 1.0
        sources["adc"] = in_case(matrix, alike[:, :, None] * rows.rounding**2)
    if rows.span is not None:
        sources["instability"] = GYRO_FLICKER**2 * np.kron(flicker_about_mean(rows.span), np.eye(3))
    slip = 0.0 if rows.slip is None else rows.slip[:, None] * np.diag(matrix)  # rad
    angle = along * (angle_uncertainty**2 + slip**2) / rows.duration[:, None] ** 2
    sources["angle"] = rows.of_turns(angle).ravel()
    # all turns about one axis lean alike, as a fixture or an edge does
    lean = np.einsum("rj,ik->rijk", rows.rate[rests:], np.eye(3)) * (1.0 - np.eye(3))[:, :, None]
    columns = axis_uncertainty * rows.of_turns(lean.reshape(-1, 3, 9)).reshape(-1, 9)
    sources["axis"] = columns @ columns.T
    if rows.force is None:  # the g-sensitivity keeps its prior
        sources["prior"] = np.full(rows.reading.size, (G_SENSITIVITY * STANDARD_GRAVITY) ** 2)
    return sources


def fit_known_rotation(
    rows: RotationRows,
    *,
    gravity: float,
    mode: KnownRotationMode = "affine",
    angle_uncertainty: float = 0.0,
    axis_uncertainty: float = 0.0,
    cross_axis_prior: float = 0.01,
    scale_tolerance: float = SCALE_TOLERANCE,
    creep: Creep | None = None,
    moves: Callable[[TriadParameters], TriadModel | PoorFit | None] = lambda fitted: None,
) -> TriadFit:
    """Fit gyroscopes to rests and turns, with their g-sensitivity if there is an accelerometer.

    Angle and axis have standard uncertainties, rad. ``moves`` takes the parameters and returns the matrix that turns and moves
    together determine. The columns of axes that were not turned keep the nominal scale factor, and cross-axis terms of
    ``cross_axis_prior``.
    """
    turned = _check_complete(rows, mode)
    matrix = first_table_matrix(rows.rate, rows.reading, turned, rows.unit)
    _check_turns(np.linalg.inv(matrix), rows, turned, scale_tolerance)
    sources, findings = _sources(rows, matrix, angle_uncertainty, axis_uncertainty), list[Finding]()
    if creep is not None:
        sources["temperature"] = creep.covariance_in_case(rows.rate)
    if mode == "paper":
        fitted, residuals = _closed_form(rows, sources, gravity)
    else:
        excess = walks_of(rows.span)
        if len(rows.axis) > len(turned):  # one turn about each axis shows nothing of the hand
            excess["angle"] = rows.of_turns(np.repeat(rows.duration[:, None] ** -2, 3, axis=1)).ravel()
        prior = table_prior(matrix, turned, rows.force is not None, rows.unit, cross_axis_prior)
        gls = solve_inverse(rows.reading, rows.rate, rows.force, matrix, sources, excess=excess, prior=prior)
        fitted, residuals = parameters_of(gls), -gls.residuals.reshape(-1, 3)
        if len(turned) == 3:
            fitted, findings = _with_moves(fitted, moves(fitted))
        else:
            findings = [axes_missing([AXES[k] for k in turned], rows.unit, cross_axis_prior)]
    if rows.rounding is not None:
        findings += limited_by_codes("gyroscope", rows.rounding**2, np.diag(fitted.covariance)[9:12], rows.unit)
    names = {"method": f"known-rotation/{mode}", "unit_in": rows.unit, "unit_out": "rad/s"}
    return fit_of(fitted, rows.rate, residuals, Verdict.of(*findings), remainder="instability", **names)


def _closed_form(
    rows: RotationRows, sources: dict[str, FloatArray], gravity: float
) -> tuple[TriadParameters, FloatArray]:
    """Return the parameters of mode paper, and the residuals (E, 3), rad/s.

    K, b and H of s = K w + b + H a are linear in the mean readings; M = K^-1, G = M H: dM = -M dK M, dG = -M dK G + M dH.
    """
    rests, samples = len(rows.faces), rows.samples
    up = np.array([face_vectors([face])[0] if face else np.zeros(3) for face in rows.faces])
    force = np.zeros_like(rows.reading) if rows.force is None else rows.force
    per_turn, closed = np.linalg.pinv(rows.rate[rests:]), np.zeros((7, len(rows.reading)))  # K, b and H of one sensor
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
    each = np.einsum("pe,ik->ipek", closed, forward[:, :3]).reshape(
        3, 7, -1
    )  # errors e of the rows are K e of the readings
    gains = jacobian @ np.vstack((each[:, :3].reshape(9, -1), each[:, 3], each[:, 4:].reshape(9, -1)))
    parts = {name: carried(gains, covariance) for name, covariance in sources.items()}
    theta = np.concatenate((matrix.ravel(), forward[:, 3], g.ravel()))
    residuals = (rows.reading - forward[:, 3]) @ matrix.T - force @ g.T - rows.rate
    return TriadParameters(theta, np.sum([*parts.values()], axis=0), parts), residuals


# Moves from rest to rest turn gravity (moves.py), whatever angle and axis of a turn were. The turns' matrix and its
# covariance C enter their fit, which returns both joined, m and C_m. The other parameters x follow:
#
#     x + B (m - x_M)        B = cov(x, x_M) C^-1
#
# Of errors e of x by the turns only, (1 + B (C_m C^-1 - 1)) e is left.


def _with_moves(fitted: TriadParameters, moved: TriadModel | PoorFit | None) -> tuple[TriadParameters, list[Finding]]:
    """Return the parameters by rests, turns and moves together, and a finding if turns and moves disagree."""
    if isinstance(moved, PoorFit):
        return fitted, [finding("known_rotation.moves_disagree", "warn", what=f"the moves were not used: {moved}")]
    if moved is None:
        return fitted, []
    by_turns, joint = fitted.covariance[:9, :9], moved.covariance[:9, :9]
    away = (moved.matrix - fitted.matrix).ravel()
    gain, change = np.linalg.solve(by_turns, fitted.covariance[:9]).T, np.eye(len(fitted.theta))
    change[:, :9] += gain @ (np.linalg.solve(by_turns, joint).T - np.eye(9))
    joined = TriadParameters(
        theta=fitted.theta + gain @ away,
        covariance=fitted.covariance + gain @ (joint - by_turns) @ gain.T,
        parts={name: change @ part @ change.T for name, part in fitted.parts.items()},
    )
    if away @ np.linalg.solve((1.0 + 1e-6) * by_turns - joint, away) <= CONTRADICTION:
        return joined, []
    percent = 100.0 * float(np.abs(away).max() / np.linalg.norm(moved.matrix, 2))
    what = f"the matrix of the turns is {percent:.2g} % off that of {moved.count // 2} moves, beyond its uncertainty"
    return joined, [finding("known_rotation.moves_disagree", "warn", what=what)]


def _check_complete(rows: RotationRows, mode: KnownRotationMode) -> list[int]:
    """Return the axes of the turns; raise if rests or turns are too few."""
    turned = [k for k, axis in enumerate(AXES) if axis in rows.axis]
    if not turned or not rows.faces:
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
            "known rotation, mode paper: expected accelerometers, rests on all six faces and turns about x, y and z, got none for "
            f"{', '.join(lacking)}. Record them.",
            missing=lacking,
        )
    return turned


def _check_turns(forward: FloatArray, rows: RotationRows, turned: list[int], tolerance: float) -> None:
    """Raise if the axes of gyroscopes and turns disagree, or if a scale is not that of the unit."""
    if len(turned) < 3:
        for k in turned:
            check_reads_positive(forward[:, k], k)
    elif not np.diag(signs := nearest_signed_permutation(forward)).all():
        check_axis_order(forward, "known rotation", against="turns")
    elif reversed_ := tuple(AXES[k] for k in range(3) if signs[k, k] < 0.0):
        angles = ((axis, -rows.angle[rows.axis.index(axis)] / RADIAN_PER_DEGREE) for axis in reversed_)
        raise Implausible(
            f"known rotation: the turn about {', '.join(reversed_)} reads reversed. If the device was turned the other way, give "
            f"its angle as {', '.join(f'{axis} {angle:+g} deg' for axis, angle in angles)}; otherwise reverse that column.",
            reversed=reversed_,
        )
    scale = np.linalg.norm(forward, axis=1)[turned]
    check_own_scale(scale, rows.unit, "rate", tolerance, "gyroscope turned by hand")


# ---- from a session

NEAR_S = 5.0  # between a rest and the turn that it is next to
BESIDE = 3  # samples between a rest and its turn
CHUNK_S, MOST_CHUNKS = 0.1, 5  # of the end of a rest that may belong to a move: a low-pass delays its readings
MOVES = 5.0  # standard deviations of a chunk's mean within the rest


def with_edges(
    records: Sequence[Record], stills: Sequence[Still], turns: Sequence[Turn]
) -> tuple[tuple[Still, ...], tuple[Turn, ...]]:
    """Return rests without the ends in which the device still moves, and turns with those next to them: their angle is the same."""
    rests, longer = [], list(turns)
    for still in stills:
        chunk = max(1, round(CHUNK_S * records[still.recording].sample_rate_hz))
        reading = _triads(records[still.recording], None, None)[0][still.start : still.stop]
        start, stop = still.start + _moving_start(reading, chunk), still.stop - _moving_start(reading[::-1], chunk)
        rests.append(replace(still, start=start, stop=stop))
        for k, turn in enumerate(turns):
            if turn.recording == still.recording and 0 <= still.start - turn.stop <= BESIDE:
                longer[k] = replace(longer[k], stop=max(turn.stop, start))
            if turn.recording == still.recording and 0 <= turn.start - still.stop <= BESIDE:
                longer[k] = replace(longer[k], start=min(turn.start, stop))
    return tuple(rests), tuple(longer)


def _moving_start(reading: FloatArray, chunk: int) -> int:
    """Return the samples at the start of a rest (N, 3) that differ from its middle; 0 if the rest is too short to tell."""
    count = len(reading) // chunk
    if count < 4 * MOST_CHUNKS:
        return 0
    means = reading[: count * chunk].reshape(count, chunk, 3).mean(axis=1)
    middle = means[MOST_CHUNKS:-MOST_CHUNKS]
    away = np.abs(means[:MOST_CHUNKS] - np.nanmean(middle, axis=0)) > MOVES * np.nanstd(middle, axis=0)
    return chunk * int(np.flatnonzero(away.any(axis=1)).max(initial=-1) + 1)


def _without_rest(records: Sequence[Record], rests: Sequence[Still], turns: Sequence[Turn]) -> tuple[Axis, ...]:
    """Return the axes of turns without a rest close before and one close after them, whatever face is up in it."""
    lacking = set[Axis | None]()
    for turn in turns:
        time, own = records[turn.recording].time, [s for s in rests if s.recording == turn.recording]
        before = (time[turn.start] - time[s.stop - 1] for s in own if s.start < turn.start)
        after = (time[s.start] - time[turn.stop - 1] for s in own if s.stop > turn.stop)
        if max(min(before, default=np.inf), min(after, default=np.inf)) > NEAR_S:
            lacking.add(turn.axis)
    return tuple(axis for axis in AXES if axis in lacking)


def _by_moves(
    seen: Observed, rows: RotationRows, accel: TriadModel, fitted: TriadParameters
) -> TriadModel | PoorFit | None:
    """Fit the matrix to turns and moves, with readings freed of the g-sensitivity.

    Return None if the moves determine nothing, and the error if no matrix fits turns and moves together.
    """
    slope = np.zeros((3, 3)) if fitted.g_sensitivity is None else np.linalg.solve(fitted.matrix, fitted.g_sensitivity)
    records = [
        replace(r, gyro=r.gyro - (r.accel - accel.offset) @ accel.matrix.T @ slope.T)
        for r in seen.session.records
        if r.gyro is not None and r.accel is not None
    ]
    stills = sorted((p for p in rows.pieces if isinstance(p, Still)), key=lambda still: (still.recording, still.start))
    creep = creep_of(seen, stills, "accel"), creep_of(seen, stills, "gyro")
    try:
        return fit_moves(records, stills, accel, creep=creep, turns=fitted).model
    except NotObservable:
        return None
    except PoorFit as error:
        return error


def _check_by_gravity(record: Record, gyro: TriadModel, accel: TriadModel) -> tuple[Finding, ...]:
    """Compare the corrected rotation with gravity: a finding if they may disagree, an error if they clearly do.

    The turns determine the scale, whatever the unit of the readings and the sample rate are: only a wrong angle makes it wrong.
    """
    rate, force = (
        (v - m.offset) @ m.matrix.T for v, m in ((np.asarray(record.gyro), gyro), (np.asarray(record.accel), accel))
    )
    conflict = find_disagreement(replace(record, gyro=rate, accel=force, gyro_unit="rad/s", accel_unit="m/s2"))
    if conflict is None:
        return ()
    values = dict(conflict.values)
    if ratio := values["turned_ratio"]:
        values["text"] = f"the angles of the turns are stated {ratio:.3g} times as large as gravity shows"
        values["action"] = "state angles in deg, not rad, and 360 for a full turn"
    else:
        values["text"] = f"{values['text']}, or the turns are stated about other axes"
        values["action"] = "correct the order or the sign of the columns, or the axes of the turns"
    conflict = replace(conflict, values=values)
    if conflict.level == "fail":
        raise Implausible(f"known rotation: {values['text']} ({conflict.detail}). Check: {conflict.action}.", **values)
    return (conflict,)


def calibrate_turns(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to its turns by known angles; an entry of FITS."""
    records, settings = seen.session.records, seen.settings
    turns, findings = tuple(t for t in seen.session.turns if t.angle is not None), list[Finding]()
    if not turns:
        turns = seen.full_turns()
        if not turns:
            return Outcome(findings=(finding("known_rotation.needs_turns", "warn"),))
        taken = tuple(f"{t.axis} {(t.angle or 0.0) / RADIAN_PER_DEGREE:+.0f} deg" for t in turns)
        findings.append(finding("known_rotation.turns_found", "warn", turns=taken))
    rests = seen.stills
    if _without_rest(records, rests, turns):
        rests = (*rests, *seen.unused_stills((*rests, *turns)))
    if lacking := _without_rest(records, rests, turns):
        findings.append(finding("known_rotation.no_rests", "warn", axes=lacking, within_s=NEAR_S))
    model = None if accel is None else accel.model
    matrix, offset = (None, None) if model is None else (model.matrix, model.offset)
    if mode != "paper":
        rests, turns = with_edges(records, rests, turns)
    rows = rotation_rows(records, rests, turns, matrix=matrix, offset=offset)
    creep = creep_of(seen, rows.pieces, "gyro")
    fit = fit_known_rotation(
        rows,
        gravity=seen.session.gravity_m_s2,
        mode="paper" if mode == "paper" else "affine",
        angle_uncertainty=settings.angle_uncertainty_deg * RADIAN_PER_DEGREE,
        axis_uncertainty=settings.axis_uncertainty_deg * RADIAN_PER_DEGREE,
        cross_axis_prior=settings.cross_axis_prior,
        creep=creep,
        moves=lambda fitted: None if model is None else _by_moves(seen, rows, model, fitted),
    )
    if model is not None:
        # full turns bring gravity back whatever the axes are: the moves show axes that are not the accelerometer's
        for record in records:
            findings += _check_by_gravity(record, fit.model, model)
    return Outcome(fit=fit, method="known-rotation", findings=(*findings, *creep.findings()))
