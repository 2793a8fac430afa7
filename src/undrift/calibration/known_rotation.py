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

Moves between the rests turn gravity, which shows the matrix as well (multi_position.py): its fit joins both.

.. [1] F. Ferraris, U. Grimaldi, M. Parvis, "Procedure for effortless in-field calibration of three-axial rate gyros and
   accelerometers", Sensors and Materials 7(5), 1995.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration import multi_position
from undrift.calibration.codes import limited_by_codes, mean_rounding
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
from undrift.calibration.rate_table import axes_missing, check_reads_positive, first_table_matrix, table_prior, walks_of
from undrift.calibration.session import Observed, Outcome, spans_of
from undrift.calibration.sources import Creep, creep_of, flicker_about_mean, in_case
from undrift.calibration.triads import find_disagreement
from undrift.errors import Implausible, InputError, NotObservable, PoorFit
from undrift.findings import Finding, finding
from undrift.fit.gls import block_size, noise_of_means, solve_inverse
from undrift.fit.priors import G_SENSITIVITY, GYRO_FLICKER
from undrift.fit.triad import TriadFit, TriadParameters, fit_of, inverse_jacobian, parameters_of, scaled_condition
from undrift.model import AXES, TriadModel, Verdict
from undrift.record import Axis, Face, Record, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

KnownRotationMode = Literal["paper", "affine"]

CONTRADICTION = 27.9  # chi-square of nine terms that chance exceeds in one session of a thousand
MIN_NOISE = 1e-12  # of the largest reading: no mean is known better than its arithmetic
GAP = 1.5  # median steps of the clock: a longer one is a gap, not jitter

# ---- sums over rests and turns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestReadings:
    """Mean gyroscope readings at rest."""

    reading: FloatArray  # (P, 3), ``unit``
    faces: tuple[Face | None, ...]  # face that points up in each; None for a rest in any pose
    noise: FloatArray | None = None  # (P, 3), standard deviation of each mean; None if it is not known
    unit: str = "rad/s"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationData:
    """Sums of readings over still phases and turns."""

    rest: RestReadings
    rest_samples: FloatArray  # (P,), samples behind each mean
    angle: FloatArray  # (R,), angle of each turn about +axis, rad
    axis: tuple[Axis, ...]  # axis of each turn
    reading: FloatArray  # (R, 3), integral of the gyroscope readings over each turn, unit * s
    force: FloatArray | None  # (R, 3), integral of the calibrated specific force over each turn, m/s
    duration: FloatArray  # (R,), s
    noise: FloatArray | None = None  # (R, 3), standard deviation of ``reading`` from sample noise alone
    slip: FloatArray | None = None  # (R,), what jitter of the clock adds to ``reading`` of the turned axis, unit * s
    rest_force: FloatArray | None = None  # (P, 3), specific force at rest, m/s2; None takes gravity along the faces
    span: FloatArray | None = None  # (P + R, 2), start and stop of rests and turns on one clock, s
    rounding: FloatArray | None = None  # (3,), what rounding leaves in a mean at rest, unit
    pieces: tuple[Still | Turn, ...] = ()  # rests and turns, in this order

    @property
    def up(self) -> FloatArray:
        """Direction that points up in each rest, (P, 3); zeros off the faces."""
        up = np.zeros_like(self.rest.reading)
        rows = [n for n, face in enumerate(self.rest.faces) if face is not None]
        up[rows] = face_vectors([face for face in self.rest.faces if face is not None])
        return up


def rotation_data(
    records: Sequence[Record],
    stills: Sequence[Still],
    turns: Sequence[Turn],
    *,
    matrix: FloatArray | None,
    offset: FloatArray | None,
) -> RotationData:
    """Sum the readings of a session over its rests and its turns; matrix and offset are the accelerometer's, if there is one."""
    accel = None if matrix is None or offset is None else (matrix, offset)
    used = [t for t in turns if t.axis is not None and t.angle is not None]
    windows, force, rests = list[FloatArray](), list[FloatArray](), list[Still]()
    for still in sorted(stills, key=lambda still: still.face is None):
        window = slice(still.start, still.stop)
        gyro, felt = _gyro(records[still.recording])[window], _force(records[still.recording], accel)[window]
        whole = ~np.isnan(gyro).any(axis=1) & ~np.isnan(felt).any(axis=1)
        if still.face is not None and whole.sum() < 2:
            raise InputError(
                f"known rotation: expected readings at rest on face {still.face}, got {whole.sum()}. Choose another stretch."
            )
        if whole.sum() > 1:
            windows.append(gyro[whole])
            force.append(felt[whole].mean(axis=0))
            rests.append(still)
    count = np.array([len(window) for window in windows], float)
    sizes = np.array([block_size(records[s.recording].sample_rate_hz) for s in rests])
    white = block = np.zeros(3)  # standard deviation of a sample at rest, and of a block mean
    if windows:
        square = np.sum([((w - w.mean(axis=0)) ** 2).sum(axis=0) for w in windows], axis=0)
        white = np.sqrt(square / max(1.0, float(count.sum()) - len(count)))
        blocks = noise_of_means(windows, sizes.tolist())
        block = block if blocks is None else blocks[0] * np.sqrt(count[0] / sizes[0])
    sums = [_turn_sums(records[t.recording], t, white, block, accel) for t in used]
    return RotationData(
        rest=RestReadings(
            reading=np.array([w.mean(axis=0) for w in windows]).reshape(-1, 3),
            faces=tuple(still.face for still in rests),
            noise=np.maximum(white, block * sizes[:, None] ** 0.5) / count[:, None] ** 0.5 if rests else None,
            unit=records[0].gyro_unit,
        ),
        rest_samples=count,
        angle=np.array([t.angle for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        reading=np.array([turn.reading for turn in sums]).reshape(-1, 3),
        force=None if accel is None else np.array([turn.force for turn in sums]).reshape(-1, 3),
        duration=np.array([turn.duration for turn in sums]),
        noise=np.array([turn.noise for turn in sums]).reshape(-1, 3),
        slip=np.array([turn.slip for turn in sums]),
        rest_force=None if accel is None else np.array(force).reshape(-1, 3),
        span=spans_of(records, [*rests, *used]),
        rounding=mean_rounding([_gyro(records[k]) for k in {s.recording for s in rests}], windows) if rests else None,
        pieces=(*rests, *used),
    )


class _TurnSums(NamedTuple):
    """Sums over one turn."""

    reading: FloatArray  # (3,), unit * s
    force: FloatArray  # (3,), m/s
    duration: float  # s
    noise: FloatArray  # (3,), unit * s
    slip: float  # unit * s


def _turn_sums(
    record: Record, turn: Turn, white: FloatArray, block: FloatArray, accel: tuple[FloatArray, FloatArray] | None
) -> _TurnSums:
    gyro, force = _gyro(record)[turn.start : turn.stop], _force(record, accel)[turn.start : turn.stop]
    if np.isnan(gyro).any() or np.isnan(force).any():
        raise InputError(f"known rotation: the turn about {turn.axis} has gaps. Record it again.")
    check_range([gyro], f"gyroscope in the turn about {turn.axis}")
    steps = np.diff(record.time)
    step = np.concatenate((steps[:1], steps))[turn.start : turn.stop]
    sample = np.maximum(white, block * block_size(record.sample_rate_hz) ** 0.5)
    # A stamp off by d moves the sum by d times the change of the reading there: jitter of the steps has twice its variance.
    even, axis = steps[steps < GAP * np.median(steps)], AXES.index(turn.axis or "x")
    change = float((np.diff(gyro[:, axis]) ** 2).sum()) - 2.0 * (len(gyro) - 1) * float(white[axis]) ** 2
    return _TurnSums(
        reading=step @ gyro,
        force=step @ force,
        duration=float(step.sum()),
        noise=sample * np.sqrt(step @ step),
        slip=float(np.sqrt(0.5 * even.var() * max(change, 0.0))),
    )


def _gyro(record: Record) -> FloatArray:
    if record.gyro is None:
        raise InputError("known rotation: expected gyroscope readings in every recording, got none. Map their columns.")
    return record.gyro


def _force(record: Record, accel: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    """Return the specific force (N, 3), m/s2, by matrix and offset of the accelerometer; zeros without them."""
    if accel is None:
        return np.zeros((len(record), 3))
    if record.accel is None:
        raise InputError(
            "known rotation: expected both sensors in every recording. Map the columns of the accelerometer."
        )
    return np.asarray((record.accel - accel[1]) @ accel[0].T)


# ---- rows and sources


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _RotationRows:
    """Rests, then turns, by their means: E pieces, three rows each."""

    reading: FloatArray  # (E, 3), unit of the readings
    rate: FloatArray  # (E, 3), rad/s
    force: FloatArray | None  # (E, 3), m/s2
    noise: FloatArray  # (E, 3), standard deviation of each mean
    duration: FloatArray  # (R,), of the turns, s
    along: FloatArray  # (R, 3), axis of each turn

    @property
    def rests(self) -> int:
        """Number of rests."""
        return len(self.reading) - len(self.duration)

    def of_turns(self, values: FloatArray) -> FloatArray:
        """Return rows (E, 3, ...) that are zero at rest, from those of the turns (R, 3, ...)."""
        return np.concatenate((np.zeros((self.rests, *values.shape[1:])), values))


def _rows(data: RotationData, gravity: float) -> _RotationRows:
    duration, along = data.duration[:, None], axis_vectors(data.axis)
    force = None
    if data.force is not None:
        at_rest = gravity * data.up if data.rest_force is None else data.rest_force
        force = np.vstack((at_rest, data.force / duration))
    if data.rest.noise is None or data.noise is None:  # alike in all samples
        samples = data.rest_samples.mean() / data.rest_samples
        noise = np.sqrt(np.concatenate((samples, 1.0 / data.duration)))[:, None] * np.ones(3)
    else:
        noise = np.vstack((data.rest.noise, data.noise / duration))
    reading = np.vstack((data.rest.reading, data.reading / duration))
    return _RotationRows(
        reading=reading,
        rate=np.vstack((np.zeros_like(data.rest.reading), along * data.angle[:, None] / duration)),
        force=force,
        noise=np.maximum(noise, MIN_NOISE * np.abs(reading).max()),
        duration=data.duration,
        along=along,
    )


def _sources(
    rows: _RotationRows, data: RotationData, matrix: FloatArray, sigma: tuple[float, float], creep: Creep | None
) -> dict[str, FloatArray]:
    """Return the stated covariances (3 E, 3 E) of the rows, or their diagonals (3 E,), (rad/s)^2; sigma of angle and axis, rad."""
    count, own = len(rows.reading), np.eye(len(rows.reading))
    sources = {"noise": in_case(matrix, own[:, :, None] * rows.noise[:, None] ** 2)}
    if data.rounding is not None:
        alike = own.copy()  # the rests read one code and err alike; a turn errs by itself
        alike[: rows.rests, : rows.rests] = 1.0
        sources["adc"] = in_case(matrix, alike[:, :, None] * data.rounding**2)
    if data.span is not None:
        sources["instability"] = GYRO_FLICKER**2 * np.kron(flicker_about_mean(data.span), np.eye(3))
    if creep is not None:
        sources["temperature"] = creep.covariance_in_case(rows.rate)
    slip = 0.0 if data.slip is None else data.slip[:, None] * np.diag(matrix)  # rad
    angle = rows.along * (sigma[0] ** 2 + slip**2) / rows.duration[:, None] ** 2
    sources["angle"] = rows.of_turns(angle).ravel()
    # all turns about one axis lean alike, as a fixture or an edge does
    rate = rows.rate[rows.rests :].sum(axis=1)
    lean = np.einsum("rj,ik->rijk", rows.along * rate[:, None], np.eye(3)) * (1.0 - np.eye(3))[:, :, None]
    columns = sigma[1] * rows.of_turns(lean.reshape(-1, 3, 9)).reshape(3 * count, 9)
    sources["axis"] = columns @ columns.T
    if rows.force is None:  # the g-sensitivity keeps its prior
        sources["prior"] = np.full(3 * count, (G_SENSITIVITY * STANDARD_GRAVITY) ** 2)
    return sources


# ---- fit


def fit_known_rotation(
    data: RotationData,
    *,
    gravity: float,
    mode: KnownRotationMode = "affine",
    angle_uncertainty: float = 0.0,
    axis_uncertainty: float = 0.0,
    scale_tolerance: float = SCALE_TOLERANCE,
    cross_axis_prior: float = 0.01,
    creep: Creep | None = None,
    moves: Callable[[TriadParameters, FloatArray], TriadModel | PoorFit | None] = lambda fitted, walk: None,
) -> TriadFit:
    """Fit gyroscopes to rests and turns, with their g-sensitivity if there is an accelerometer.

    Angle and axis have standard uncertainties, rad. ``moves`` takes the parameters and the variance (3,) of the walk of each
    offset, (rad/s)^2 / s, and returns the matrix that turns and moves together determine. The columns of axes that were not turned
    keep the nominal scale factor, and cross-axis terms of ``cross_axis_prior``.
    """
    turned = _check_complete(data, mode)
    rows = _rows(data, gravity)
    matrix = first_table_matrix(rows.rate, rows.reading, turned, data.rest.unit)
    if rows.force is not None and len(turned) == 3:
        full = np.column_stack((rows.rate, np.ones(len(rows.rate)), rows.force))
        if scaled_condition(full)[0] == full.shape[1]:  # the rests show the g-sensitivity
            matrix = np.linalg.inv(np.linalg.lstsq(full, rows.reading, rcond=None)[0][:3].T)
    _check_turns(np.linalg.inv(matrix), data, turned, scale_tolerance)
    sources = _sources(rows, data, matrix, (angle_uncertainty, axis_uncertainty), creep)
    findings = list[Finding]()
    if mode == "paper":
        fitted, residuals = _paper(data, rows, sources, gravity)
    else:
        excess = walks_of(data.span)
        if len(rows.along) > len(turned):  # one turn about each axis shows nothing of the hand
            excess["angle"] = rows.of_turns(np.repeat(rows.duration[:, None] ** -2, 3, axis=1)).ravel()
        prior = table_prior(matrix, turned, rows.force is not None, data.rest.unit, cross_axis_prior)
        gls = solve_inverse(rows.reading, rows.rate, rows.force, matrix, sources, excess=excess, prior=prior)
        walk = np.array([gls.excess.get(f"instability {axis}", 0.0) for axis in AXES])
        fitted, residuals = parameters_of(gls), -gls.residuals.reshape(-1, 3)
        if len(turned) == 3:
            fitted, findings = _with_moves(fitted, moves(fitted, walk))
        else:
            names = [AXES[k] for k in turned]
            findings = [axes_missing(names, data.rest.unit, cross_axis_prior)]
    if data.rest.noise is None or data.noise is None:
        fitted = fitted._replace(covariance=np.full(fitted.covariance.shape, np.nan))
    if data.rounding is not None:
        variance = np.diag(fitted.covariance)[9:12]
        findings += limited_by_codes("gyroscope", data.rounding**2, variance, data.rest.unit)
    names_of = {"method": f"known-rotation/{mode}", "unit_in": data.rest.unit, "unit_out": "rad/s"}
    return fit_of(fitted, rows.rate, residuals, Verdict.of(*findings), remainder="instability", **names_of)


def _paper(
    data: RotationData, rows: _RotationRows, sources: dict[str, FloatArray], gravity: float
) -> tuple[TriadParameters, FloatArray]:
    """Return the parameters by the closed form, and the residuals (E, 3), rad/s.

    K, b and H of s = K w + b + H a are linear in the mean readings; M = K^-1, G = M H: dM = -M dK M, dG = -M dK G + M dH.
    """
    duration, force = data.duration, np.zeros_like(data.reading) if data.force is None else data.force
    turns, rests = rows.along * data.angle[:, None], rows.rests
    samples, up = data.rest_samples, data.up
    per_turn, closed = np.linalg.pinv(turns), np.zeros((7, rests + len(turns)))  # K, b and H of one sensor
    # b is the mean of all samples at rest, H the half difference of opposite faces
    closed[3:, :rests] = np.vstack((samples / samples.sum(), (up / np.abs(up).sum(axis=0) / gravity).T))
    closed[:3, :rests] = -per_turn @ np.column_stack((duration, force)) @ closed[3:, :rests]
    closed[:3, rests:] = per_turn
    forward = (closed @ np.vstack((data.rest.reading, data.reading))).T
    matrix = np.linalg.inv(forward[:, :3])
    g = matrix @ forward[:, 4:]
    jacobian = np.eye(21)
    jacobian[:9, :9], jacobian[12:, :9] = inverse_jacobian(matrix), -np.kron(matrix, g.T)
    jacobian[12:, 12:] = np.kron(matrix, np.eye(3))
    # errors e of the rows are errors K e of the mean readings, and T K e of the sums over turns
    extent = np.concatenate((np.ones(rests), duration))
    each = np.einsum("pe,ik->ipek", closed * extent, forward[:, :3]).reshape(3, 7, -1)
    gains = jacobian @ np.vstack((each[:, :3].reshape(9, -1), each[:, 3], each[:, 4:].reshape(9, -1)))
    parts = {name: (gains * s if s.ndim == 1 else gains @ s) @ gains.T for name, s in sources.items()}
    theta = np.concatenate((matrix.ravel(), forward[:, 3], g.ravel()))
    corrected = (rows.reading - forward[:, 3]) @ matrix.T
    if rows.force is not None:
        corrected = corrected - rows.force @ g.T
    return TriadParameters(theta, np.sum([*parts.values()], axis=0), parts), corrected - rows.rate


# Moves from rest to rest turn gravity (multi_position.py), whatever angle and axis of a turn were. The turns' matrix and its
# covariance C enter their fit, which returns both joined, m and C_m. The other parameters x follow:
#
#     x + B (m - x_M)        B = cov(x, x_M) C^-1
#
# Of errors e of x by the turns only, (1 + B (C_m C^-1 - 1)) e is left.


def _with_moves(fitted: TriadParameters, moved: TriadModel | PoorFit | None) -> tuple[TriadParameters, list[Finding]]:
    """Return the parameters by rests, turns and moves together, and a finding if turns and moves disagree."""
    if isinstance(moved, PoorFit):
        return fitted, [finding("known_rotation.moves_contradict", "warn", reason=str(moved))]
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
    return joined, [finding("known_rotation.moves_disagree", "warn", percent=percent, count=moved.count // 2)]


def _check_complete(data: RotationData, mode: KnownRotationMode) -> list[int]:
    """Return the axes of the turns; raise if rests or turns are too few."""
    turned = [k for k, axis in enumerate(AXES) if axis in data.axis]
    if not turned:
        raise NotObservable(
            "known rotation: expected a turn by a known angle, got none. Turn the device about x, y and z."
        )
    if not len(data.rest.reading):
        raise NotObservable(
            "known rotation: expected a rest for the offset, got none. Rest before and after each turn."
        )
    faces = missing_faces([face for face in data.rest.faces if face is not None])
    lacking = tuple(axis for axis in AXES if axis not in data.axis)
    if mode == "paper" and (faces or lacking or data.force is None):
        raise NotObservable(
            "known rotation, mode paper: expected accelerometers, rests on all six faces and turns about x, y and z, got none for "
            f"{', '.join((*faces, *lacking)) or 'the accelerometers'}. Record them.",
            missing=(*faces, *lacking),
        )
    return turned


def _check_turns(forward: FloatArray, data: RotationData, turned: list[int], tolerance: float) -> None:
    """Raise if the axes of gyroscopes and turns disagree, or if a scale is not that of the unit."""
    if len(turned) < 3:
        for k in turned:
            check_reads_positive(forward[:, k], k)
    elif not np.diag(signs := nearest_signed_permutation(forward)).all():
        check_axis_order(forward, "known rotation", against="turns")
    elif reversed_ := tuple(AXES[k] for k in range(3) if signs[k, k] < 0.0):
        angles = ((axis, -data.angle[data.axis.index(axis)] / RADIAN_PER_DEGREE) for axis in reversed_)
        raise Implausible(
            f"known rotation: the turn about {', '.join(reversed_)} reads reversed. If the device was turned the other way, give "
            f"its angle as {', '.join(f'{axis} {angle:+g} deg' for axis, angle in angles)}; otherwise reverse that column.",
            reversed=reversed_,
        )
    scale = np.linalg.norm(forward, axis=1)[turned]
    check_own_scale(scale, data.rest.unit, "rate", tolerance, "gyroscope turned by hand")


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
        reading = _gyro(records[still.recording])[still.start : still.stop]
        start, stop = still.start + _moving_start(reading, chunk), still.stop - _moving_start(reading[::-1], chunk)
        rests.append(replace(still, start=start, stop=stop))
        for k, turn in enumerate(turns):
            if turn.recording == still.recording and 0 <= still.start - turn.stop <= BESIDE and start > still.start:
                longer[k] = replace(longer[k], stop=start)
            if turn.recording == still.recording and 0 <= turn.start - still.stop <= BESIDE and stop < still.stop:
                longer[k] = replace(longer[k], start=stop)
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
    seen: Observed, data: RotationData, accel: TriadModel, fitted: TriadParameters, walk: FloatArray
) -> TriadModel | PoorFit | None:
    """Fit the matrix to turns and moves, with readings freed of the g-sensitivity.

    Return None if the moves determine nothing, and the error if no matrix fits turns and moves together.
    """
    forward = np.linalg.inv(fitted.matrix)
    slope = np.zeros((3, 3)) if fitted.g_sensitivity is None else forward @ fitted.g_sensitivity
    records = [
        replace(r, gyro=r.gyro - (r.accel - accel.offset) @ accel.matrix.T @ slope.T)
        for r in seen.session.records
        if r.gyro is not None and r.accel is not None
    ]
    stills = sorted((p for p in data.pieces if isinstance(p, Still)), key=lambda still: (still.recording, still.start))
    creep = creep_of(seen, stills, "accel"), creep_of(seen, stills, "gyro")
    # an offset that follows the temperature is interpolated between the rests as a walk is
    drift = creep[1].offset_per_k * creep[1].span_k
    walk = walk + drift**2 / max(float(np.ptp(spans_of(seen.session.records, stills))), 1.0)
    offset = partial(multi_position.offsets_in_moves, scale=np.linalg.norm(forward, axis=1), walk=walk)
    by_turns = multi_position.ByTurns(fitted.matrix, fitted.covariance[:9, :9], offset)
    try:
        return multi_position.fit_gyro_between_stills(records, stills, accel, creep=creep, by_turns=by_turns).model
    except NotObservable:
        return None
    except PoorFit as error:
        return error


def _corrected(record: Record, gyro: TriadModel, accel: TriadModel) -> Record:
    """Return a record with both triads corrected."""
    rate, force = ((v - m.offset) @ m.matrix.T for v, m in ((_gyro(record), gyro), (np.asarray(record.accel), accel)))
    return replace(record, gyro=rate, accel=force, gyro_unit="rad/s", accel_unit="m/s2")


def _check_by_gravity(record: Record) -> tuple[Finding, ...]:
    """Compare the rotation of a corrected record with gravity: a finding if they may disagree, an error if they clearly do.

    The turns determine the scale, whatever the unit of the readings and the sample rate are: only a wrong angle makes it wrong.
    """
    conflict = find_disagreement(record)
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
    if settings.angle_uncertainty_deg == 0.0:
        findings.append(finding("known_rotation.angles_exact", "info"))
    model = None if accel is None else accel.model
    matrix, offset = (None, None) if model is None else (model.matrix, model.offset)
    if mode != "paper":
        rests, turns = with_edges(records, rests, turns)
    data = rotation_data(records, rests, turns, matrix=matrix, offset=offset)
    creep = creep_of(seen, data.pieces, "gyro")
    fit = fit_known_rotation(
        data,
        gravity=seen.session.gravity_m_s2,
        mode="paper" if mode == "paper" else "affine",
        angle_uncertainty=settings.angle_uncertainty_deg * RADIAN_PER_DEGREE,
        axis_uncertainty=settings.axis_uncertainty_deg * RADIAN_PER_DEGREE,
        cross_axis_prior=settings.cross_axis_prior,
        creep=creep,
        moves=lambda fitted, walk: None if model is None else _by_moves(seen, data, model, fitted, walk),
    )
    if model is not None:
        # full turns bring gravity back whatever the axes are: the moves show axes that are not the accelerometer's
        for record in records:
            findings += _check_by_gravity(_corrected(record, fit.model, model))
    return Outcome(fit=fit, method="known-rotation", findings=(*findings, *creep.findings()))
