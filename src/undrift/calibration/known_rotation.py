"""Known rotation: rests, and one turn by a known angle about each axis; no rate table.

A turn about axis j by the angle t_j in the time T is a piece at the known mean rate t_j / T about j, whatever the rate was on the
way. Its mean reading u and mean specific force f, and those of the rests, are rows of the same equations as on a rate table:

    paper      G from half the difference of opposite faces, b from the mean of all samples at rest, K from the turns [1]_
    affine     M u - c - G f = w + errors          M (3, 3), c = M o, and G, the g-sensitivity; w = 0 at rest

Without accelerometers G is left out, and what it may do to each piece is a source of error. The errors in the frame of the case:

    noise, adc     M n                    noise and rounding of the mean
    angle          a / T along j          angle of a turn, and jitter of the clock
    axis           (t / T) d_j across j   the axis of the turns about j against the case, in common to them
    temperature    warmth (alpha + beta w)   offset and scale follow the temperature
    instability    flicker of a stated size, and a random walk of each sensor, whose size is an excess variance (fit/gls.py)

Moves between the rests turn gravity, which shows the matrix as well (multi_position.py): its fit joins both.

.. [1] F. Ferraris, U. Grimaldi, M. Parvis, "Procedure for effortless in-field calibration of three-axial rate gyros and
   accelerometers", Sensors and Materials 7(5), 1995.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration import multi_position
from undrift.calibration.codes import limited_by_codes, mean_rounding
from undrift.calibration.creep import Creep, creep_of, flicker_about_mean, in_case, walk_about_mean
from undrift.calibration.plausibility import (
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
from undrift.calibration.session import Observed, Outcome, spans_of
from undrift.calibration.six_face import FaceMeans
from undrift.errors import Implausible, InputError, NotObservable, PoorFit
from undrift.findings import Finding, finding
from undrift.fit.equations import Inverse, offset_of
from undrift.fit.gls import Prior, solve_inverse
from undrift.fit.least_squares import TriadFit, block_size, noise_of_means, scaled_condition, triad_fit
from undrift.fit.priors import G_SENSITIVITY, GYRO_FLICKER
from undrift.model import AXES, G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Budget, TriadModel, Verdict
from undrift.record import Axis, Record, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

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
    moves = multi_position.cut_moves(records, stills)
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
    axis: tuple[Axis, ...]  # Axis of each turn
    reading: FloatArray  # (R, 3), integral of the gyroscope readings over each turn, unit * s
    force: FloatArray | None  # (R, 3), integral of the calibrated specific force over each turn, m/s
    duration: FloatArray  # (R,), s
    noise: FloatArray | None = None  # (R, 3), standard deviation of ``reading`` from sample noise alone
    slip: FloatArray | None = None  # (R,), what jitter of the clock adds to ``reading`` of the turned axis, unit * s
    free: FaceMeans | None = None  # Means of rests off the faces, with no faces
    rest_force: FloatArray | None = None  # (P + F, 3), specific force on the faces, then in the free rests, m/s2
    span: FloatArray | None = None  # (P + F + R, 2), start and stop of faces, free rests and turns on one clock, s
    rounding: FloatArray | None = None  # (3,), what rounding leaves in a mean at rest, unit
    pieces: tuple[Still | Turn, ...] = ()  # Faces, free rests and turns, in this order

    @property
    def means(self) -> FloatArray:
        """Means of all rests, shape (P + F, 3)."""
        return self.rest.reading if self.free is None else np.vstack((self.rest.reading, self.free.reading))


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
    rests = [*(s for s in stills if s.face is not None), *(s for s in stills if s.face is None)]
    rests, used = _moved_apart(records, rests, used)
    windows, force, usable = list[FloatArray](), list[FloatArray](), list[Still]()
    for still in rests:
        window = slice(still.start, still.stop)
        gyro, felt = _gyro(records[still.recording])[window], _force(records[still.recording], accel)[window]
        whole = ~np.isnan(gyro).any(axis=1) & ~np.isnan(felt).any(axis=1)
        if still.face is not None and whole.sum() < 2:
            raise InputError(
                f"known rotation: wanted readings at rest on face {still.face}, got {whole.sum()}; choose another stretch"
            )
        if whole.sum() > 1:
            windows.append(gyro[whole])
            force.append(felt[whole].mean(axis=0))
            usable.append(still)
    size = sum(still.face is not None for still in usable)
    count = np.array([len(w) for w in windows], float)
    sizes = [block_size(records[s.recording].sample_rate_hz) for s in usable]
    white, block = _sample_noise(windows, sizes)
    rest_noise = np.maximum(white, block * np.array(sizes)[:, None] ** 0.5) / count[:, None] ** 0.5
    sums = [_turn_sums(records[t.recording], t, (white, block), accel) for t in used]
    unit = records[0].gyro_unit
    means = np.array([w.mean(axis=0) for w in windows]).reshape(-1, 3)
    return RotationData(
        rest=FaceMeans(
            reading=means[:size],
            faces=tuple(still.face for still in usable if still.face is not None),
            noise=rest_noise[:size] if usable else None,
            unit=unit,
        ),
        rest_samples=count[:size],
        angle=np.array([t.angle for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        reading=np.array([turn.reading for turn in sums]).reshape(-1, 3),
        force=None if accel is None else np.array([turn.force for turn in sums]).reshape(-1, 3),
        duration=np.array([turn.duration for turn in sums]),
        noise=np.array([turn.noise for turn in sums]).reshape(-1, 3),
        slip=np.array([turn.slip for turn in sums]),
        free=FaceMeans(reading=means[size:], faces=(), noise=rest_noise[size:], unit=unit)
        if len(usable) > size
        else None,
        rest_force=None if accel is None else np.array(force).reshape(-1, 3),
        span=spans_of(records, [*usable, *used]),
        rounding=mean_rounding([_gyro(records[k]) for k in {s.recording for s in usable}], windows) if usable else None,
        pieces=(*usable, *used),
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
    record: Record, turn: Turn, noise: tuple[FloatArray, FloatArray], accel: tuple[FloatArray, FloatArray] | None
) -> _TurnSums:
    gyro, force = _gyro(record)[turn.start : turn.stop], _force(record, accel)[turn.start : turn.stop]
    if np.isnan(gyro).any() or np.isnan(force).any():
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
        force=step @ force,
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
        rest = _quiet(still, _gyro(record)[still.start : still.stop], chunk)
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


def _gyro(record: Record) -> FloatArray:
    if record.gyro is None:
        raise InputError("known rotation: expected gyroscope readings in every recording, got none. Map their columns.")
    return record.gyro


def _force(record: Record, accel: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    """Return the specific force (N, 3), m/s2, by matrix and offset of the accelerometer; zeros without them."""
    if accel is None:
        return np.zeros((len(record), 3))
    if record.accel is None:
        raise InputError("known rotation: wanted gyroscope and accelerometer, got one of them; map the missing columns")
    return np.asarray((record.accel - accel[1]) @ accel[0].T)


# ---- fit

CONTRADICTION = 27.9  # chi-square of nine terms that chance exceeds in one session of a thousand
MIN_NOISE = 1e-12  # of the largest reading: no mean is known better than its arithmetic


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
        at_rest = gravity * face_vectors(data.rest.faces) if data.rest_force is None else data.rest_force
        force = np.vstack((at_rest, data.force / duration))
    if data.rest.noise is None or data.noise is None:  # alike in all samples
        samples = data.rest_samples.mean() / data.rest_samples
        others = np.ones(len(data.means) - len(samples))
        noise = np.sqrt(np.concatenate((samples, others, 1.0 / data.duration)))[:, None] * np.ones(3)
    else:
        free = np.zeros((0, 3)) if data.free is None or data.free.noise is None else data.free.noise
        noise = np.vstack((data.rest.noise, free, data.noise / duration))
    reading = np.vstack((data.means, data.reading / duration))
    return _RotationRows(
        reading=reading,
        rate=np.vstack((np.zeros_like(data.means), along * data.angle[:, None] / duration)),
        force=force,
        noise=np.maximum(noise, MIN_NOISE * np.abs(reading).max()),
        duration=data.duration,
        along=along,
    )


def _start(rows: _RotationRows) -> FloatArray:
    """Return a first forward matrix K by least squares, with the g-sensitivity if the rests show it."""
    design = np.column_stack((rows.rate, np.ones(len(rows.rate))))
    if rows.force is not None and scaled_condition(full := np.column_stack((design, rows.force)))[0] == full.shape[1]:
        design = full
    return np.asarray(np.linalg.lstsq(design, rows.reading, rcond=None)[0][:3].T)


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


def _excess(rows: _RotationRows, span: FloatArray | None) -> dict[str, FloatArray]:
    """Return the shapes of errors whose sizes the residuals show: the hand, and a walk of each sensor."""
    shapes: dict[str, FloatArray] = {}
    if len(rows.along) > 3:  # one turn about each axis shows nothing of the hand
        shapes["hand"] = rows.of_turns(np.repeat(rows.duration[:, None] ** -2, 3, axis=1)).ravel()
    if span is not None and np.ptp(middle := span.mean(axis=1)) > 0.0:
        walk = walk_about_mean(middle)
        shapes |= {f"walk {axis}": np.kron(walk, np.diag(np.eye(3)[k])) for k, axis in enumerate(AXES)}
    return shapes


class RotationParameters(NamedTuple):
    """Parameters of the model with their covariance, in its order: M row by row, o, and G row by row if it was fitted."""

    theta: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    parts: dict[str, FloatArray]  # covariance by source
    walk: FloatArray  # (3,), variance of the walk of each sensor, (rad/s)^2 / s

    @property
    def matrix(self) -> FloatArray:
        """M (3, 3)."""
        return self.theta[:9].reshape(3, 3)

    @property
    def g_sensitivity(self) -> FloatArray | None:
        """G (3, 3), or None."""
        return self.theta[12:].reshape(3, 3) if len(self.theta) > 12 else None


def fit_known_rotation(
    data: RotationData,
    *,
    gravity: float,
    mode: KnownRotationMode = "affine",
    angle_uncertainty: float = 0.0,
    axis_uncertainty: float = 0.0,
    scale_tolerance: float = 0.25,
    creep: Creep | None = None,
    moves: Callable[[RotationParameters], TriadModel | PoorFit | None] = lambda fitted: None,
) -> TriadFit:
    """Fit gyroscopes to rests and turns, with their g-sensitivity if there is an accelerometer.

    Angle and axis have standard uncertainties, rad. ``moves`` returns the matrix that turns and moves together determine.
    """
    _check_complete(data, mode)
    rows = _rows(data, gravity)
    start = _start(rows)
    _check_turns(start, data, scale_tolerance)
    matrix = np.linalg.inv(start)
    sources = _sources(rows, data, matrix, (angle_uncertainty, axis_uncertainty), creep)
    if mode == "paper":
        fitted, residuals = _paper(data, rows, sources, gravity)
        checked = finding("known_rotation.no_spare_equations", "info")
    else:
        fitted, residuals = _affine(data, rows, sources, matrix, creep)
        fitted, checked = _with_moves(fitted, moves(fitted))
    g = fitted.g_sensitivity
    at_rest = (
        np.ones((rows.rests, 1))
        if rows.force is None
        else np.column_stack((np.ones(rows.rests), rows.force[: rows.rests]))
    )
    condition = scaled_condition(at_rest)[1]
    fastest = float(np.abs(data.angle / data.duration).max())
    has_noise = data.rest.noise is not None and data.noise is not None
    variances = {name: np.diag(part) for name, part in fitted.parts.items()}
    return triad_fit(
        residuals,
        Verdict.of(checked, *_judged(data, angle_uncertainty, creep, np.diag(fitted.covariance)[9:12])),
        method=f"known-rotation/{mode}",
        unit_in=data.rest.unit,
        unit_out="rad/s",
        matrix=fitted.matrix,
        offset=fitted.theta[9:12],
        g_sensitivity=g,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *(() if g is None else G_NAMES)),
        covariance=fitted.covariance if has_noise else np.full(fitted.covariance.shape, np.nan),
        budget=Budget.of(fitted.covariance, variances, "instability") if has_noise else None,
        rank=len(fitted.theta),
        condition=condition,
        valid_range=(-fastest, fastest),
    )


def _affine(
    data: RotationData, rows: _RotationRows, sources: dict[str, FloatArray], matrix: FloatArray, creep: Creep | None
) -> tuple[RotationParameters, FloatArray]:
    """Return the parameters by generalised least squares, and the residuals (E, 3), rad/s."""
    prior, excess = None, _excess(rows, data.span)
    if rows.force is not None:
        prior = Prior(mean=np.zeros(21), precision=np.diag(np.repeat([0.0, G_SENSITIVITY**-2], [12, 9])))
    fit = solve_inverse(rows.reading, rows.rate, rows.force, matrix, sources, excess=excess, prior=prior)
    offset, jacobian = offset_of(fit.theta[:9].reshape(3, 3), fit.theta[9:12], len(fit.theta))
    parts = dict(fit.budget)
    for kind in excess:
        source = "angle" if kind == "hand" else "instability"
        parts[source] = parts.pop(kind) + parts.get(source, 0.0)
    fitted = RotationParameters(
        theta=np.concatenate((fit.theta[:9], offset, fit.theta[12:])),
        covariance=jacobian @ fit.covariance @ jacobian.T,
        parts={name: jacobian @ part @ jacobian.T for name, part in parts.items()},
        walk=np.array([fit.excess.get(f"walk {axis}", 0.0) for axis in AXES]),
    )
    return fitted, -fit.residuals.reshape(-1, 3)


def _paper(
    data: RotationData, rows: _RotationRows, sources: dict[str, FloatArray], gravity: float
) -> tuple[RotationParameters, FloatArray]:
    """Return the parameters by the closed form, and the residuals (E, 3), rad/s."""
    up, turns = face_vectors(data.rest.faces), rows.along * data.angle[:, None]
    force = np.zeros_like(data.reading) if data.force is None else data.force
    leak = np.column_stack((data.duration, force))
    closed = _closed_form(data, up, gravity, turns, leak)
    inverse = Inverse.of((closed @ np.vstack((data.means, data.reading))).T)
    # errors e of the rows are errors K e of the mean readings, and T K e of the sums over turns
    extent = np.concatenate((np.ones(rows.rests), data.duration))
    each = np.einsum("pe,ik->ipek", closed * extent, inverse.forward[:, :3]).reshape(3, 7, -1)
    gains = inverse.jacobian @ np.vstack((each[:, :3].reshape(9, -1), each[:, 3], each[:, 4:].reshape(9, -1)))
    parts = {name: (gains * s if s.ndim == 1 else gains @ s) @ gains.T for name, s in sources.items()}
    g = np.zeros((3, 3)) if inverse.g_sensitivity is None else inverse.g_sensitivity
    theta = np.concatenate((inverse.matrix.ravel(), inverse.offset, g.ravel()))
    fitted = RotationParameters(
        theta=theta,
        covariance=np.sum([*parts.values()], axis=0),
        parts=parts,
        walk=np.zeros(3),
    )
    corrected = (rows.reading - inverse.offset) @ inverse.matrix.T
    if rows.force is not None:
        corrected = corrected - rows.force @ g.T
    return fitted, corrected - rows.rate


def _closed_form(data: RotationData, up: FloatArray, gravity: float, turns: FloatArray, leak: FloatArray) -> FloatArray:
    """Return (7, E): K, b and G of one sensor from its means and sums, b and G from half differences of the faces."""
    samples, count = data.rest_samples, len(data.rest.faces)
    to_rest = np.vstack((samples / samples.sum(), (up / np.abs(up).sum(axis=0) / gravity).T))
    per_turn, solver = np.linalg.pinv(turns), np.zeros((7, len(data.means) + len(turns)))
    solver[:3, :count], solver[:3, len(data.means) :] = -per_turn @ leak @ to_rest, per_turn
    solver[3:, :count] = to_rest
    return solver


# Moves from rest to rest turn gravity (multi_position.py), whatever angle and axis of a turn were. The turns' matrix and its
# covariance C enter their fit, which returns both joined, m and C_m. The other parameters x follow:
#
#     x + B (m - x_M)        B = cov(x, x_M) C^-1
#
# Of errors e of x by the turns only, (1 + B (C_m C^-1 - 1)) e is left.


def _with_moves(fitted: RotationParameters, moved: TriadModel | PoorFit | None) -> tuple[RotationParameters, Finding]:
    """Return the parameters by rests, turns and moves together, and whether chance makes them differ so."""
    if isinstance(moved, PoorFit):
        return fitted, finding("known_rotation.moves_contradict", "warn", reason=str(moved))
    if moved is None:
        return fitted, finding("known_rotation.no_spare_equations", "info")
    by_turns, joint = fitted.covariance[:9, :9], moved.covariance[:9, :9]
    away = (moved.matrix - fitted.matrix).ravel()
    gain, change = np.linalg.solve(by_turns, fitted.covariance[:9]).T, np.eye(len(fitted.theta))
    change[:, :9] += gain @ (np.linalg.solve(by_turns, joint).T - np.eye(9))
    joined = fitted._replace(
        theta=fitted.theta + gain @ away,
        covariance=fitted.covariance + gain @ (joint - by_turns) @ gain.T,
        parts={name: change @ part @ change.T for name, part in fitted.parts.items()},
    )
    shown = {"percent": 100.0 * float(np.abs(away).max() / np.linalg.norm(moved.matrix, 2)), "count": moved.count // 2}
    apart = away @ np.linalg.solve((1.0 + 1e-6) * by_turns - joint, away) > CONTRADICTION
    agreement = finding(
        "known_rotation.moves_disagree" if apart else "known_rotation.moves_agree", "warn" if apart else "info", **shown
    )
    return joined, agreement


def _judged(data: RotationData, angle: float, creep: Creep | None, variance: FloatArray) -> Iterator[Finding]:
    if angle == 0.0:
        yield finding("known_rotation.angles_exact", "info")
    if creep is not None:
        yield from creep.findings()
    if data.rounding is not None:
        yield from limited_by_codes("gyroscope", data.rounding**2, variance, data.rest.unit)


def _check_complete(data: RotationData, mode: KnownRotationMode) -> None:
    axes = tuple(axis for axis in AXES if axis not in data.axis)
    if axes:
        raise NotObservable(
            f"known rotation: wanted a turn about each axis, got none about {', '.join(axes)}; turn the device about "
            f"{', '.join(axes)} by a known angle",
            missing=axes,
        )
    if not len(data.means):
        raise NotObservable(
            "known rotation: expected a rest for the offset, got none. Rest before and after each turn."
        )
    faces = missing_faces(data.rest.faces)
    if mode == "paper" and (faces or data.force is None):
        raise NotObservable(
            f"known rotation, mode paper: wanted accelerometers and rest on all six faces, got none for "
            f"{', '.join(faces) or 'the accelerometers'}; record the missing faces",
            missing=faces,
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
    lacking = set[Axis | None]()
    for turn in turns:
        time, own = records[turn.recording].time, [s for s in rests if s.recording == turn.recording]
        before = (time[turn.start] - time[s.stop - 1] for s in own if s.start < turn.start)
        after = (time[s.start] - time[turn.stop - 1] for s in own if s.stop > turn.stop)
        if max(min(before, default=np.inf), min(after, default=np.inf)) > _NEAR_S:
            lacking.add(turn.axis)
    return tuple(axis for axis in AXES if axis in lacking)


def _by_moves(
    seen: Observed, data: RotationData, accel: TriadModel, fitted: RotationParameters
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
    # an offset that follows the temperature, or that rests show to drift, is interpolated between the rests as a walk is
    drift = creep[1].offset_per_k * creep[1].span_k
    walk = fitted.walk + drift**2 / max(float(np.ptp(spans_of(seen.session.records, stills))), 1.0)
    offset = partial(multi_position.offsets_in_moves, scale=np.linalg.norm(forward, axis=1), walk=walk)
    by_turns = multi_position.ByTurns(fitted.matrix, fitted.covariance[:9, :9], offset)
    try:
        return multi_position.fit_gyro_between_stills(records, stills, accel, creep=creep, by_turns=by_turns).model
    except NotObservable:
        return None
    except PoorFit as error:
        return error


def calibrate_turns(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to its turns by known angles; an entry of FITS."""
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
        rests = (*rests, *seen.unused_stills((*rests, *turns)))
        if len(rests) > len(seen.stills):
            findings = (*findings, finding("known_rotation.rests_found", "info", rests=len(rests) - len(seen.stills)))
    if lacking := _without_rest(seen.session.records, rests, turns):
        findings = (*findings, finding("known_rotation.no_rests", "warn", axes=lacking, within_s=_NEAR_S))
    model = None if accel is None else accel.model
    matrix, offset = (None, None) if model is None else (model.matrix, model.offset)
    data = rotation_data(seen.session.records, rests, turns, matrix=matrix, offset=offset)
    fit = fit_known_rotation(
        data,
        gravity=seen.session.gravity_m_s2,
        mode="paper" if mode == "paper" else "affine",
        angle_uncertainty=seen.settings.angle_uncertainty_deg * RADIAN_PER_DEGREE,
        axis_uncertainty=seen.settings.axis_uncertainty_deg * RADIAN_PER_DEGREE,
        creep=creep_of(seen, data.pieces, "gyro"),
        moves=lambda fitted: None if model is None else _by_moves(seen, data, model, fitted),
    )
    if model is not None:
        check_turns_gravity(seen.session.records, seen.stills, model, fit.model)
    return Outcome(fit=fit, method="known-rotation", findings=findings)
