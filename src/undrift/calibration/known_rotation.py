"""Known rotation: six faces, then one turn by a known angle about each axis; no rate table.

    s = K w + b + G a          forward model of the gyroscopes, a the true specific force

At rest on face p the mean reading is b + G a_p. Over the turn about axis j by the angle t_j the sum of readings is K e_j t_j +
b T + G A_j, T its duration and A_j the integral of the calibrated specific force.

    paper      G from half the difference of opposite faces, b from the mean of all samples at rest, K from the turns [1]_
    affine     K, b and G by weighted least squares over faces, turns and the other rests, whose specific force is measured

What moves more than sample noise is in the weights and in the covariance: noise of block means, temperature creep, flicker, what
rounding leaves, the angle of each turn, jitter of the clock, and the axis of the turns against the case.

.. [1] F. Ferraris, U. Grimaldi, M. Parvis, "Procedure for effortless in-field calibration of three-axial rate gyros and
   accelerometers", Sensors and Materials 7(5), 1995.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration import multi_position
from undrift.calibration.adc import limited_by_codes, mean_rounding
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
from undrift.calibration.creep import (
    PRIOR,
    SIZES,
    WARM_UP,
    Blocks,
    Creep,
    OffsetPrior,
    blocks_within,
    creep_of,
    flicker_about_mean,
    mean_square_size,
    size_unit,
)
from undrift.calibration.observe import Observed, Outcome, spans_of
from undrift.calibration.pieces import unused_stills
from undrift.calibration.six_face import FaceMeans
from undrift.errors import Implausible, InputError, NotObservable, PoorFit
from undrift.findings import Finding, finding
from undrift.fit.equations import (
    Equations,
    Inverse,
    averaged,
    diagonal,
    fading,
    mixed,
    moved_by,
    parameter_order,
    shares,
    solutions,
)
from undrift.fit.least_squares import TriadFit, block_size, noise_of_means, scaled_condition, triad_fit
from undrift.model import AXES, TriadModel, Verdict
from undrift.record import Axis, Record, Still, Turn, TurnAxis
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
    moves = multi_position.cut_moves(records, stills, stills)
    if len(moves.first) < _LEAST_MOVES:
        return
    n = multi_position.gravity_directions(moves, accel)[0]
    miss = _miss_deg(moves, n, gyro.matrix, gyro.offset)
    if miss <= LARGEST_MISS_DEG:
        return
    every = itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3))
    orders = [np.eye(3)[list(order)] * np.array(signs)[:, None] for order, signs in every]
    misses = [_miss_deg(moves, n, order.T @ gyro.matrix, gyro.offset) for order in orders]
    best = int(np.argmin(misses))
    if misses[best] < _CLEARLY * miss and not np.array_equal(orders[best], np.eye(3)):
        raise Implausible(
            f"gyro against accel: wanted gyroscopes that turn gravity from rest to rest, got moves that miss it by {miss:.0f} deg "
            f"rms, and by {misses[best]:.0f} deg were the axes x, y, z of the gyroscopes {order_text(orders[best])} of the "
            f"accelerometer: {cause_by_gravity(orders[best])}; correct the order or the sign of the columns",
            miss_deg=miss,
            seen=order_text(orders[best]),
        )


def _miss_deg(moves: multi_position.Moves, n: FloatArray, matrix: FloatArray, offset: FloatArray) -> float:
    turn, _ = multi_position.turned_in(moves, matrix, offset, np.zeros((len(moves.first), 3)))
    arrived = (turn @ n[moves.before][:, :, None])[:, :, 0]
    cosine = np.clip((arrived * n[moves.before + 1]).sum(axis=1), -1.0, 1.0)
    return float(np.sqrt(np.mean(np.arccos(cosine) ** 2))) / RADIAN_PER_DEGREE


# ---- sums over rests and turns

KnownRotationMode = Literal["paper", "affine"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationData:
    """Sums of readings over still phases and turns."""

    rest: FaceMeans  # Gyroscope means on the faces, ``unit``
    rest_samples: FloatArray  # (P,), samples behind each mean
    angle: FloatArray  # (R,), angle of each turn about +axis, rad
    axis: tuple[TurnAxis, ...]  # Axis of each turn
    reading: FloatArray  # (R, 3), integral of the gyroscope readings over each turn, unit * s
    force: FloatArray  # (R, 3), integral of the calibrated specific force over each turn, m/s
    duration: FloatArray  # (R,), s
    noise: FloatArray | None = None  # (R, 3), standard deviation of ``reading`` from sample noise alone
    slip: FloatArray | None = None  # (R,), what jitter of the clock adds to ``reading`` of the turned axis, unit * s
    free: FaceMeans | None = None  # Means of rests off the faces, with no faces
    rest_force: FloatArray | None = None  # (P + F, 3), specific force on the faces, then in the free rests, m/s2
    span: FloatArray | None = None  # (P + F + R, 2), start and stop of faces, free rests and turns on one clock, s
    rounding: FloatArray | None = None  # (3,), what rounding leaves in a mean at rest, unit
    blocks: Blocks | None = None  # Of the readings within all rests
    pieces: tuple[Still | Turn, ...] = ()  # Faces, free rests and turns, in this order

    @property
    def means(self) -> FloatArray:
        """Means of all rests, shape (P + F, 3)."""
        return self.rest.reading if self.free is None else np.vstack((self.rest.reading, self.free.reading))


def rotation_data(
    records: Sequence[Record], stills: Sequence[Still], turns: Sequence[Turn], *, matrix: FloatArray, offset: FloatArray
) -> RotationData:
    """Sum the readings of a session over its rests and its turns; matrix and offset are the accelerometer's."""
    used = [t for t in turns if t.axis is not None and t.angle is not None]
    rests = [*(s for s in stills if s.face is not None), *(s for s in stills if s.face is None)]
    rests, used = _moved_apart(records, rests, used)
    faces = [s.face for s in rests if s.face is not None]
    gyro, force = [], []
    for still in rests:
        readings = np.hstack([values[still.start : still.stop] for values in _both(records[still.recording])])
        readings = readings[~np.isnan(readings).any(axis=1)]
        gyro.append(readings[:, :3])
        force.append((readings[:, 3:].mean(axis=0) - offset) @ matrix.T if len(readings) else np.full(3, np.nan))
        if still.face is not None and len(readings) < 2:
            raise InputError(
                f"known rotation: wanted readings at rest on face {still.face}, got {len(readings)}; choose another stretch"
            )
    usable = [k for k, window in enumerate(gyro) if len(window) > 1]
    windows, rests = [gyro[k] for k in usable], [rests[k] for k in usable]
    count = np.array([len(w) for w in windows], float)
    sizes = [block_size(records[s.recording].sample_rate_hz) for s in rests]
    white, block = _sample_noise(windows, sizes)
    rest_noise = np.maximum(white, block * np.array(sizes)[:, None] ** 0.5) / count[:, None] ** 0.5
    sums = [_turn_sums(records[t.recording], t, (white, block), matrix, offset) for t in used]
    size, number = len(faces), len(rests)
    unit = records[0].gyro_unit
    means = np.array([w.mean(axis=0) for w in windows]).reshape(-1, 3)
    noise = np.array([one.noise for one in sums]).reshape(-1, 3)
    return RotationData(
        rest=FaceMeans(
            reading=means[:size], faces=tuple(faces), noise=rest_noise[:size] if number else None, unit=unit
        ),
        rest_samples=count[:size],
        angle=np.array([t.angle for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        reading=np.array([one.reading for one in sums]).reshape(-1, 3),
        force=np.array([one.force for one in sums]).reshape(-1, 3),
        duration=np.array([one.duration for one in sums]),
        noise=noise,
        slip=np.array([one.slip for one in sums]),
        free=FaceMeans(reading=means[size:], faces=(), noise=rest_noise[size:], unit=unit) if number > size else None,
        rest_force=np.array(force)[usable].reshape(-1, 3),
        span=spans_of(records, [*rests, *used]),
        blocks=blocks_within(windows, [records[s.recording].sample_rate_hz for s in rests], removed=2),
        rounding=mean_rounding([_both(records[k])[0] for k in {s.recording for s in rests}], windows)
        if number
        else None,
        pieces=(*rests, *used),
    )


def _sample_noise(windows: Sequence[FloatArray], sizes: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviation of a sample at rest, and that of a block mean; 0 where there are too few blocks."""
    if not windows:
        return np.zeros(3), np.zeros(3)
    square = np.sum([((w - w.mean(axis=0)) ** 2).sum(axis=0) for w in windows], axis=0)
    spare = sum(len(w) - 1 for w in windows)
    blocks = noise_of_means(windows, sizes)
    block = np.zeros(3) if blocks is None else blocks[0] * np.sqrt(len(windows[0]) / sizes[0])
    return np.sqrt(square / max(1, spare)), block


class _TurnSums(NamedTuple):
    """Sums over one turn."""

    reading: FloatArray  # (3,), unit * s
    force: FloatArray  # (3,), m/s
    duration: float  # s
    noise: FloatArray  # (3,), unit * s
    slip: float  # unit * s


def _turn_sums(
    record: Record, turn: Turn, noise: tuple[FloatArray, FloatArray], matrix: FloatArray, offset: FloatArray
) -> _TurnSums:
    gyro, accel = (values[turn.start : turn.stop] for values in _both(record))
    if np.isnan(gyro).any() or np.isnan(accel).any():
        raise InputError(f"known rotation: wanted the turn about {turn.axis} without gaps, got some; record it again")
    check_range([gyro], f"gyroscope in the turn about {turn.axis}")
    steps = np.diff(record.time)
    step = np.concatenate((steps[:1], steps))[turn.start : turn.stop]
    white, block = noise
    sample = np.maximum(white, block * block_size(record.sample_rate_hz) ** 0.5)
    # A stamp off by d moves the sum by d times the change of the reading there: jitter of the steps has twice its variance.
    even = steps[steps < _GAP * np.median(steps)]
    axis = AXES.index(turn.axis) if turn.axis is not None else 0
    change = float((np.diff(gyro[:, axis]) ** 2).sum()) - 2.0 * (len(gyro) - 1) * float(white[axis]) ** 2
    return _TurnSums(
        reading=step @ gyro,
        force=step @ ((accel - offset) @ matrix.T),
        duration=float(step.sum()),
        noise=sample * np.sqrt(step @ step),
        slip=float(np.sqrt(0.5 * even.var() * max(change, 0.0))),
    )


# A low-pass delays what the sensor reads: the end of a move then lies in the rest behind it. Where the first or last tenths of a
# second of a rest differ from its middle, they count as part of the turn beside it.

_GAP = 1.5  # median steps: a longer one is a gap, not jitter
_CHUNK_S, _MOST_CHUNKS = 0.1, 5
_MOVES = 5.0  # standard deviations of a chunk's mean within the rest
_BESIDE = 3  # samples between a rest and its turn


def _moved_apart(
    records: Sequence[Record], stills: Sequence[Still], turns: Sequence[Turn]
) -> tuple[list[Still], list[Turn]]:
    rests, moved = [], list(turns)
    for still in stills:
        record = records[still.recording]
        chunk = max(1, round(_CHUNK_S * record.sample_rate_hz))
        rest = _quiet(still, _both(record)[0][still.start : still.stop], chunk)
        for k, turn in enumerate(moved):
            if (
                turn.recording == still.recording
                and 0 <= still.start - turn.stop <= _BESIDE
                and rest.start > still.start
            ):
                moved[k] = replace(moved[k], stop=rest.start)
            if turn.recording == still.recording and 0 <= turn.start - still.stop <= _BESIDE and rest.stop < still.stop:
                moved[k] = replace(moved[k], start=rest.stop)
        rests.append(rest)
    return rests, moved


def _quiet(still: Still, readings: FloatArray, chunk: int) -> Still:
    count = len(readings) // chunk
    if count < 4 * _MOST_CHUNKS:
        return still
    from_start = readings[: count * chunk].reshape(count, chunk, 3).mean(axis=1)
    from_stop = readings[len(readings) - count * chunk :].reshape(count, chunk, 3).mean(axis=1)[::-1]
    middle = from_start[_MOST_CHUNKS:-_MOST_CHUNKS]
    limit = _MOVES * np.nanstd(middle, axis=0)
    cut = []
    for means in (from_start, from_stop):
        apart = (np.abs(means[:_MOST_CHUNKS] - np.nanmean(middle, axis=0)) > limit).any(axis=1)
        cut.append(chunk * (int(np.flatnonzero(apart).max()) + 1 if apart.any() else 0))
    return replace(still, start=still.start + cut[0], stop=still.stop - cut[1])


def _both(record: Record) -> tuple[FloatArray, FloatArray]:
    if record.gyro is None or record.accel is None:
        raise InputError("known rotation: wanted gyroscope and accelerometer, got one of them; map the missing columns")
    return record.gyro, record.accel


# ---- fit
#
# One sensor i has the rows  y = X theta + e,  theta = K_i, b_i, G_i:  a rest (0, 1, f), a turn (u t, T, A).
#
#     V_i(q) = noise + creep + rounding + q^2 F + what the sensors share: the angle of a turn, and its axis
#
# F is flicker (creep.py), over whose size q the parameters are averaged: rests and turns show it, and block means within the rests.

_WARMER_K = 0.3  # what a thermometer shows moves the offset; less is no warm-up of 0.1 deg/s
_DISAGREE = 27.9  # chi-square of nine terms that chance exceeds in one session of a thousand
_ROUNDING = 1e-12  # of the largest reading: no mean is known better than its arithmetic


def _equations(
    data: RotationData,
    unknowns: Mapping[str, FloatArray],
    forward: FloatArray,
    sigma: tuple[float, float],
    creep: Creep | None,
) -> Equations:
    """Return the rows of rests and turns, and what is known of their errors: forward (3, 3), sigma of angle and axis, rad."""
    rests, turns = len(data.means), len(data.angle)
    extent = unknowns["offset"][:, 0]
    covariances = {"noise": diagonal(_noise(data, extent) ** 2)}
    if data.rounding is not None:
        # One code for all rests errs alike in all; a turn's slow parts err by themselves.
        alike = np.zeros((rests + turns, rests + turns))
        alike[:rests, :rests] = 1.0
        covariances["adc"] = (data.rounding**2)[:, None, None] * (alike + np.diag(extent**2))
    if creep is not None:
        gain = np.linalg.norm(forward, axis=1)
        along = unknowns["matrix"] @ (forward / gain[:, None]).T
        covariances["temperature"] = np.stack([creep.covariance(along[:, k], float(gain[k]), extent) for k in range(3)])
    shared = _shared(data, forward, sigma, rests)
    # So that V stays invertible; with flicker, which is the rest of the budget
    covariances["instability"] = 1e-12 * diagonal(sum((columns**2).sum(axis=2).T for columns in shared.values()))
    return Equations(unknowns=unknowns, reading=np.vstack((data.means, data.reading)), own=covariances, shared=shared)


def _noise(data: RotationData, extent: FloatArray) -> FloatArray:
    """Return the standard deviation (E, 3) of each row; of an assumed size, alike in all samples, where it is not known."""
    if data.rest.noise is None or data.noise is None:
        samples = data.rest_samples.mean() / data.rest_samples
        alike = np.ones(len(data.means) - len(samples))
        return np.asarray(np.sqrt(np.concatenate((samples, alike, data.duration)))[:, None] * np.ones(3))
    free = np.zeros((0, 3)) if data.free is None or data.free.noise is None else data.free.noise
    least = _ROUNDING * np.abs(data.means).max() * extent[:, None]
    return np.asarray(np.maximum(np.vstack((data.rest.noise, free, data.noise)), least))


def _shared(data: RotationData, forward: FloatArray, sigma: tuple[float, float], rests: int) -> dict[str, FloatArray]:
    """Return the errors of angle and axis, (3, E, c) each: one deviation of each turn, and of all turns about one axis."""
    turns, leans = [], []
    slip = np.zeros(len(data.angle)) if data.slip is None else data.slip
    for turn, axis in enumerate(data.axis):
        about = AXES.index(axis)
        column = np.zeros((3, rests + len(data.angle)))
        column[:, rests + turn] = forward[:, about] * np.hypot(sigma[0], slip[turn] / forward[about, about])
        turns.append(column)
    for about, name in enumerate(AXES):  # all turns about one axis lean alike, as a fixture or an edge does
        along = np.where(np.array(data.axis) == name, data.angle, 0.0)
        for across in {0, 1, 2} - {about}:
            column = np.zeros((3, rests + len(data.angle)))
            column[:, rests:] = sigma[1] * np.outer(forward[:, across], along)
            leans.append(column)
    return {"angle": np.stack(turns, axis=-1), "axis": np.stack(leans, axis=-1)}


class _Average(NamedTuple):
    """Unknowns over all sizes of flicker and all time constants of a warm-up."""

    theta: FloatArray  # (21,), in the order of a model
    covariance: FloatArray  # (21, 21)
    flicker: FloatArray  # (E, E), covariance of flicker of the mean q^2
    warm_up: float = 0.0  # Probability that the offset settles
    settles_s: float = np.nan  # Its time constant, s


def _averaged(equations: Equations, data: RotationData, scale: FloatArray, creep: Creep | None) -> _Average:
    """Average over sizes of flicker, and over time constants of a warm-up; scale (3,), unit per rad/s.

    A warm-up stands in place of an even creep of the offset that no thermometer shows; what a thermometer shows is none.
    """
    none, rests = np.zeros((len(equations.reading),) * 2), len(data.means)
    if data.span is None:
        theta, covariance, _ = _over_sizes(equations, none[None], 0.0)
        return _Average(theta[0], covariance[0], none)
    extent = equations.unknowns["offset"][:, 0]
    size = size_unit(_noise(data, extent)[:rests], data.span[:rests])
    flicker = flicker_about_mean(data.span, extent)  # the offset is the mean of the session
    within = 0.0 if data.blocks is None else data.blocks.likelihood(size)
    times, settling = fading(data.span, extent)
    if creep is not None and creep.recorded and np.ptp(creep.warmth) > _WARMER_K:
        times, settling = times[:0], settling[:0]
    even = none if creep is None else creep.covariance(0.0 * creep.warmth, 1.0, extent)
    solved, evidence = [], []
    largest = np.minimum(WARM_UP, 1e5 * size / scale.max())  # without noise V stays invertible
    for warm in (none, *(largest**2 * columns @ columns.T - even for columns in settling)):
        more = (scale**2)[:, None, None] * warm
        thetas, covariances, likelihood = _over_sizes(equations, (SIZES[:, None, None] * size) ** 2 * flicker, more)
        solved.append((likelihood + within, thetas, covariances))
        evidence.append(np.logaddexp.reduce(likelihood + within + np.log(np.gradient(SIZES) / PRIOR)))
    share, settles, settles_s = shares(np.array(evidence), times)
    means, spreads = zip(*(averaged(SIZES, *one, (PRIOR, PRIOR)) for one in solved), strict=True)
    theta, covariance = mixed(np.array(means), np.array(spreads), share)
    return _Average(theta, covariance, mean_square_size(solved[0][0]) * size**2 * flicker, settles, settles_s)


def _by_creep(equations: Equations, average: _Average, inverse: Inverse, creep: Creep | None) -> FloatArray:
    """Return what one deviation of each sensor's creep of scale adds to the matrix row by row, (9, 3)."""
    columns = np.zeros((3, len(equations.reading), 3))
    if creep is not None:
        forward = inverse.forward[:, :3]
        for k, gain in enumerate(np.linalg.norm(forward, axis=1)):
            columns[k, :, k] = creep.columns(equations.unknowns["matrix"] @ forward[k] / gain, float(gain))[:, 1]
    moved = moved_by(equations.gains(equations.covariance + average.flicker), columns)
    return np.asarray(inverse.jacobian[:9] @ moved)


def _over_sizes(
    equations: Equations, family: FloatArray, more: FloatArray | float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return theta (T, 21), covariances (T, 21, 21) and log likelihood (T,) of a family (T, E, E) and more beside the stated."""
    root = [np.linalg.cholesky(family + part) for part in equations.covariance + more]
    fits = [solutions(equations.design, reading, own) for reading, own in zip(equations.reading.T, root, strict=True)]
    gains = np.stack([fit.gain for fit in fits], axis=1)
    covariances = [equations.carried(gain, part + more) for gain, part in zip(gains, family, strict=True)]
    thetas = np.hstack([fit.theta for fit in fits])[:, parameter_order(7)]
    return thetas, np.array(covariances), np.sum([fit.likelihood for fit in fits], axis=0)


def fit_known_rotation(
    data: RotationData,
    *,
    gravity: float,
    mode: KnownRotationMode = "affine",
    angle_uncertainty: float = 0.0,
    axis_uncertainty: float = 0.0,
    scale_tolerance: float = 0.25,
    creep: Creep | None = None,
    moves: Callable[
        [Inverse, FloatArray, FloatArray], TriadModel | PoorFit | None
    ] = lambda inverse, covariance, by_creep: None,
) -> TriadFit:
    """Fit gyroscopes, with their g-sensitivity, to rests and turns; angle and axis have standard uncertainties, rad.

    ``moves`` returns what moves between the rests make of the matrix that the turns show, with its covariance and (9, 3) by how
    much it follows creep of each scale.
    """
    _check_complete(data)
    up = face_vectors(data.rest.faces)
    force = gravity * up if data.rest_force is None else data.rest_force
    turns = axis_vectors(data.axis) * data.angle[:, None]
    leak = np.column_stack((data.duration, data.force))
    unknowns = {
        "matrix": np.vstack((np.zeros((len(force), 3)), turns)),
        "offset": np.concatenate((np.ones(len(force)), leak[:, 0]))[:, None],
        "g": np.vstack((force, leak[:, 1:])),
    }
    closed = _closed_form(data, up, gravity, turns, leak, mode)
    reading = np.vstack((data.means, data.reading))
    theta = (closed @ reading).T
    _check_turns(theta[:, :3], data, scale_tolerance)
    equations = _equations(data, unknowns, theta[:, :3], (angle_uncertainty, axis_uncertainty), creep)
    average = _averaged(equations, data, np.linalg.norm(theta[:, :3], axis=1), creep)
    gains, moved = equations.gains(), None
    if mode == "paper":
        gains = np.stack((closed, closed, closed))
        inverse = Inverse.of(theta)
        covariance = inverse.carried(equations.carried(gains, average.flicker))
    else:
        inverse = Inverse.of(average.theta[np.argsort(parameter_order(7))].reshape(3, 7))
        covariance = inverse.carried(average.covariance)
        moved = moves(inverse, covariance, _by_creep(equations, average, inverse, creep))
    inverse, covariance, checked = _with_moves(inverse, covariance, moved)
    theta = inverse.forward
    rank, condition = scaled_condition(np.column_stack((np.ones(len(up)), up)))
    fastest = float(np.abs(data.angle / data.duration).max())
    has_noise = data.rest.noise is not None and data.noise is not None
    return triad_fit(
        (reading - equations.design @ theta.T) @ inverse.matrix.T,
        Verdict.of(checked, *_judged(data, angle_uncertainty, creep, average, np.diag(covariance)[9:12])),
        method=f"known-rotation/{mode}",
        unit_in=data.rest.unit,
        unit_out="rad/s",
        matrix=inverse.matrix,
        offset=inverse.offset,
        g_sensitivity=inverse.g_sensitivity,
        parameters=inverse.parameters,
        covariance=covariance if has_noise else np.full((21, 21), np.nan),
        budget=equations.budget(inverse, covariance, "instability", gains=gains) if has_noise else None,
        rank=3 * rank + 9,
        condition=condition,
        valid_range=(-fastest, fastest),
    )


def _closed_form(
    data: RotationData, up: FloatArray, gravity: float, turns: FloatArray, leak: FloatArray, mode: KnownRotationMode
) -> FloatArray:
    """Return (7, E): K, b and G of one sensor from its means and sums, b and G from the faces alone."""
    samples, count = data.rest_samples, len(data.rest.faces)
    if mode == "paper":  # half differences, repeated faces averaged
        to_rest = np.vstack((samples / samples.sum(), (up / np.abs(up).sum(axis=0) / gravity).T))
    else:
        design = np.column_stack((np.ones(len(up)), gravity * up))
        weighted = design * samples[:, None]
        to_rest = np.linalg.solve(weighted.T @ design, weighted.T)
    per_turn, made = np.linalg.pinv(turns), np.zeros((7, len(data.means) + len(turns)))
    made[:3, :count], made[:3, len(data.means) :] = -per_turn @ leak @ to_rest, per_turn
    made[3:, :count] = to_rest
    return made


# Moves from rest to rest turn gravity (multi_position.py), whatever angle and axis of a turn were. The turns' matrix and its
# covariance C enter their fit, which returns both joined, m and C_m; the other parameters x follow:
#
#     x + B (m - x_M)        B = cov(x, x_M) C^-1        and of errors e of x by the turns alone is left  (1 + B (C_m C^-1 - 1)) e


def _with_moves(
    inverse: Inverse, covariance: FloatArray, moved: TriadModel | PoorFit | None
) -> tuple[Inverse, FloatArray, Finding]:
    """Return model and covariance (21, 21) of rests, turns and moves together, and whether chance makes them differ so."""
    if isinstance(moved, PoorFit):
        return inverse, covariance, finding("known_rotation.moves_contradict", "warn", reason=str(moved))
    if moved is None or inverse.g_sensitivity is None:
        return inverse, covariance, finding("known_rotation.no_spare_equations", "info")
    of_turns, joint, away = covariance[:9, :9], moved.covariance[:9, :9], (moved.matrix - inverse.matrix).ravel()
    gain, change = np.linalg.solve(of_turns, covariance[:9]).T, np.eye(21)
    change[:, :9] += gain @ (np.linalg.solve(of_turns, joint).T - np.eye(9))
    changed = Inverse(
        matrix=moved.matrix,
        offset=inverse.offset + gain[9:12] @ away,
        g_sensitivity=inverse.g_sensitivity + (gain[12:] @ away).reshape(3, 3),
        jacobian=change @ inverse.jacobian,
    )
    shown = {"percent": 100.0 * float(np.abs(away).max() / np.linalg.norm(moved.matrix, 2)), "count": moved.count // 2}
    apart = away @ np.linalg.solve((1.0 + 1e-6) * of_turns - joint, away) > _DISAGREE
    agreement = finding(
        "known_rotation.moves_disagree" if apart else "known_rotation.moves_agree", "warn" if apart else "info", **shown
    )
    return changed, covariance + gain @ (joint - of_turns) @ gain.T, agreement


def _judged(
    data: RotationData, angle: float, creep: Creep | None, average: _Average, variance: FloatArray
) -> Iterator[Finding]:
    if angle == 0.0:
        yield finding("known_rotation.angles_exact", "info")
    if creep is not None:
        yield from creep.findings()
    if average.warm_up > 0.5:
        yield finding("gyro.warm_up", "info", time_constant_s=average.settles_s)
    if data.rounding is not None:
        yield from limited_by_codes("gyroscope", data.rounding**2, variance, data.rest.unit)


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


# ---- from a session

_NEAR_S = 5.0  # between a rest and the turn that it stands beside


def _without_rest(records: Sequence[Record], rests: Sequence[Still], turns: Sequence[Turn]) -> tuple[Axis, ...]:
    """Return the axes of turns without a rest close before and one close after them, whatever face is up in it."""
    lacking = set[TurnAxis | None]()
    for turn in turns:
        time, own = records[turn.recording].time, [s for s in rests if s.recording == turn.recording]
        before = (time[turn.start] - time[s.stop - 1] for s in own if s.start < turn.start)
        after = (time[s.start] - time[turn.stop - 1] for s in own if s.stop > turn.stop)
        if max(min(before, default=np.inf), min(after, default=np.inf)) > _NEAR_S:
            lacking.add(turn.axis)
    return tuple(axis for axis in AXES if axis in lacking)


def _under_flicker(moves: multi_position.Moves, blocks: Blocks | None) -> OffsetPrior:
    """Return what rests show of the offset in each move, under flicker of the size q that they and their blocks show.

    m = o + f + e,  cov f = q^2 F:  o by least squares, f of a move from the rests around it (best linear prediction).
    """
    reading, noise, count = multi_position.still_moments(moves.gyro, *moves.cores)
    number, white = len(reading), np.maximum(noise[:, None] / count, 1e-30)  # (3, K)
    clock = np.concatenate(([0.0], np.cumsum(np.diff(moves.time).clip(0.0))))  # recordings follow each other
    rests, between = np.stack((moves.cores[0], moves.cores[1] - 1)), np.stack((moves.first, moves.last))
    span = clock[np.hstack((rests, between)).T]
    unit, flicker, ones = size_unit(white.T**0.5, span[:number]), flicker_about_mean(span), np.ones((number, 1))
    family = (SIZES[:, None, None] * unit) ** 2 * flicker[:number, :number]
    likelihood = np.zeros(len(SIZES)) if blocks is None else blocks.likelihood(unit)
    for values, own in zip(reading.T, white, strict=True):
        likelihood = likelihood + solutions(ones, values, np.linalg.cholesky(family + np.diag(own))).likelihood
    flicker *= mean_square_size(likelihood) * unit**2
    inverse = np.linalg.inv(flicker[:number, :number] + np.eye(number) * white[:, None, :])  # (3, K, K)
    variance = 1.0 / inverse.sum(axis=(1, 2))
    mean = variance * np.einsum("kij,jk->k", inverse, reading)
    to_moves = flicker[number:, :number] @ inverse
    return OffsetPrior(
        mean=mean,
        variance=variance,
        drift=np.einsum("kij,jk->ik", to_moves, reading - mean),
        drift_covariance=flicker[number:, number:] - to_moves @ flicker[:number, number:],
        noise=noise,
        force=np.zeros(3),
    )


def _by_moves(
    seen: Observed, data: RotationData, accel: TriadModel, shown: tuple[Inverse, FloatArray, FloatArray]
) -> TriadModel | PoorFit | None:
    """Fit the matrix to turns and moves, with readings freed of the g-sensitivity.

    Return None if the moves determine nothing, and the error if no matrix fits turns and moves together.
    """
    inverse, covariance, by_creep = shown
    slope = inverse.forward[:, 4:]
    records = [
        replace(r, gyro=r.gyro - (r.accel - accel.offset) @ accel.matrix.T @ slope.T)
        for r in seen.session.records
        if r.gyro is not None and r.accel is not None
    ]
    stills = sorted((p for p in data.pieces if isinstance(p, Still)), key=lambda still: (still.recording, still.start))
    creep = creep_of(seen, stills, "accel"), creep_of(seen, stills, "gyro")
    by_turns = multi_position.ByTurns(
        inverse.matrix, covariance[:9, :9], by_creep, partial(_under_flicker, blocks=data.blocks)
    )
    try:
        return multi_position.fit_gyro_between_stills(
            records, stills, accel, creep=creep, by_turns=by_turns, scale_tolerance=seen.settings.scale_tolerance
        ).model
    except NotObservable:
        return None
    except PoorFit as error:
        return error


def calibrate_turns(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to its turns by known angles; an entry of FITS."""
    if all(r.accel is None for r in seen.session.records):
        return Outcome(findings=(finding("known_rotation.needs_accel", "warn"),))
    missing = missing_faces([s.face for s in seen.faced if s.face is not None])
    if accel is None or missing:
        return Outcome(findings=(finding("known_rotation.needs_faces", "warn", missing=missing or "none"),))
    turns = tuple(t for t in seen.session.turns if t.angle is not None)
    findings: tuple[Finding, ...] = ()
    if not turns:
        turns = seen.full_turns()
        if not turns:
            return Outcome(findings=(finding("known_rotation.needs_turns", "warn"),))
        taken = tuple(f"{t.axis} {(t.angle or 0.0) / RADIAN_PER_DEGREE:+.0f} deg" for t in turns)
        findings = (finding("known_rotation.turns_found", "warn", turns=taken),)
    rests = seen.stills
    if _without_rest(seen.session.records, rests, turns):
        rests = (*rests, *unused_stills(seen, (*rests, *turns)))
        if len(rests) > len(seen.stills):
            findings = (*findings, finding("known_rotation.rests_found", "info", rests=len(rests) - len(seen.stills)))
    if lacking := _without_rest(seen.session.records, rests, turns):
        findings = (*findings, finding("known_rotation.no_rests", "warn", axes=lacking, within_s=_NEAR_S))
    data = rotation_data(seen.session.records, rests, turns, matrix=accel.model.matrix, offset=accel.model.offset)
    fit = fit_known_rotation(
        data,
        gravity=seen.session.gravity_m_s2,
        mode="paper" if mode == "paper" else "affine",
        angle_uncertainty=seen.settings.angle_uncertainty_deg * RADIAN_PER_DEGREE,
        axis_uncertainty=seen.settings.axis_uncertainty_deg * RADIAN_PER_DEGREE,
        creep=creep_of(seen, data.pieces, "gyro"),
        scale_tolerance=seen.settings.scale_tolerance,
        moves=lambda *shown: _by_moves(seen, data, accel.model, shown),
    )
    check_turns_gravity(seen.session.records, seen.stills, accel.model, fit.model)
    return Outcome(fit=fit, method="known-rotation", findings=findings)
