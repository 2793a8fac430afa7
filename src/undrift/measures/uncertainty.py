"""What the instrument adds to the error of a measure: each source carried to it, and the smallest change between two visits.

A source is a set of independent changes of the readings or of the mounting, one standard uncertainty each. A measure y is taken
again with each change; to first order::

    u^2(y) = sum over sources of  sum_k (y(theta + e_k) - y(theta))^2

``noise``        white noise of the size that the readings have, added anew: the scatter of a measure over K draws, and its bias by
                 simulation and extrapolation (Cook and Stefanski 1994), 3 d_1 - d_2, d_m its mean change with m times the power,
                 each draw with both signs
``mounting``     a turn of the segment's axes about each axis: the mounting's covariance
``calibration``  E and d of w + E w + d, and of f, by the covariance of the fit (correction/plan.error_covariance)
``offset``       the gyroscopes' offset left at this moment, by a rest or since the calibration; ageing of the accelerometers'
``temperature``  of the accelerometers, beyond the temperatures that their tables or constants are made for
``motion``       accelerations of the body taken for gravity: the filter with twice its time constant, which leaves a third of what
                 they do, by simulated people (0.25 to 0.38)
``sampling``     an instant between samples is interpolated: 0.01 of a step for a time, by simulated people

The covariance of a fit is split along its principal axes; those with less than 1e-4 of the whole are left out.

Between two visits with one calibration its error is the same, and cancels in a difference; the other sources are drawn anew::

    smallest change = 1.96 sqrt(2) u        u of all sources but the calibration                     (95 %, two visits)

That is the instrument alone: how a person varies from day to day comes on top.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.plan import error_covariance
from undrift.correction.rest import ageing, by_temperature, known_rest_offset, moved_by
from undrift.errors import InputError
from undrift.measures.tasks import TaskMeasure, TaskResult, is_time
from undrift.measures.worn import ACC_S, Course, WornReadings, follow, wear
from undrift.model import BodyMounting, Calibration
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

SOURCES = ("noise", "mounting", "calibration", "offset", "temperature", "motion", "sampling")
SHARED = ("calibration",)  # by two visits with one calibration
COVERAGE = 1.96
DRAWS = 6  # of noise, each with both signs so that what is linear leaves no bias
STUDENT = 2.447 / 1.96  # of six degrees of freedom: the scatter of so few draws is known to 30 %
QUIET_S = 3.0  # of the quietest stretch: that of a second is by chance 25 % quieter than the others
# Where nothing is known of them [assumed]: sides of a device by hand; an accelerometer's offset, for 0.3 deg; scale of a gyroscope;
# offset of a gyroscope since its last calibration, each axis
BY_HAND = 5.0 * RADIAN_PER_DEGREE
ACCEL_OFFSET = 0.3 * RADIAN_PER_DEGREE * STANDARD_GRAVITY
GYRO_SCALE = 0.01
GYRO_OFFSET = 0.1 * RADIAN_PER_DEGREE
SAMPLING = 0.01  # of a step
LEAST_REST_S = 2.5  # a body sways more slowly than a shorter rest shows
MOTION = 1.5  # of the change by a time constant twice as long, which leaves a third
_NEGLIGIBLE = 1e-4


Change = Callable[[WornReadings], WornReadings]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Instrument:
    """A worn device: its readings, and what is uncertain of them."""

    worn: WornReadings
    changes: tuple[tuple[str, Change], ...]  # source, and what it changes
    left: tuple[FloatArray, FloatArray]  # (3,), rad/s: of the gyroscopes' offset, in motion and where the person stands
    noise: tuple[FloatArray, FloatArray]  # (2, 3), of a reading, rad/s and m/s2: in motion, and where the person stands
    seeds: tuple[int, ...]  # of its draws
    assumed: tuple[str, ...]  # what is not stated, and assumed
    place: str  # on the body
    sizes: Mapping[str, float]  # of mounting, deg, and offset, deg/s: standard uncertainty of an axis

    def all_changes(self, *, stands: bool) -> tuple[tuple[str, Change], ...]:
        """Return what changes a measure but noise, of a person who stands or moves."""
        offsets = (("offset", _erring("gyro", _offset(size, k))) for k, size in enumerate(self.left[stands]))
        return (*self.changes, *offsets)

    def readings(self, task: TaskMeasure) -> WornReadings:
        """Return the readings as a task takes them: a person who stands keeps the offset that the rest shows.

        A bias that the filter tracks drifts by more than such a person; a constant one moves the mean of an angle alone.
        """
        return replace(self.worn, offset_uncertainty=0.0) if stands_in(task) else self.worn

    def course(self, task: TaskMeasure) -> Course:
        """Return the course that a task is measured on."""
        return follow(self.readings(task))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measure:
    """A measure with its uncertainty; sums over repetitions are means."""

    name: str
    values: FloatArray  # (K,), a repetition each
    columns: FloatArray  # (C, K): what each change does to it
    sources: tuple[str, ...]  # (C,), of the columns

    @property
    def mean(self) -> float:
        """Mean over the repetitions."""
        return float(self.values.mean())

    @property
    def parts(self) -> dict[str, float]:
        """Standard uncertainty of the mean by source, the largest first."""
        mean, named = self.columns.mean(axis=1), np.array(self.sources)
        every = {name: float(np.sqrt((mean[named == name] ** 2).sum())) for name in SOURCES if name in self.sources}
        return dict(sorted(every.items(), key=lambda one: -one[1]))

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of the mean."""
        return math.hypot(*self.parts.values())

    @property
    def uncertainties(self) -> FloatArray:
        """Standard uncertainty of each repetition, (K,)."""
        return np.asarray(np.sqrt((self.columns**2).sum(axis=0)))

    def without(self, source: str) -> float:
        """Standard uncertainty of the mean that the other sources leave."""
        return math.hypot(*(part for name, part in self.parts.items() if name != source))

    def halving(self, source: str) -> float:
        """Share of a source's part at which the uncertainty is half of what it is; 0 where the others leave more."""
        room = 0.25 * self.uncertainty**2 - self.without(source) ** 2
        return math.sqrt(room) / self.parts[source] if room > 0.0 else 0.0

    @property
    def smallest_change(self) -> float:
        """Change of the mean between two visits that exceeds the instrument's error, 95 %."""
        own = [part for name, part in self.parts.items() if name not in SHARED]
        return COVERAGE * math.sqrt(2.0) * math.hypot(*own)


def instrument(record: Record, model: Calibration | None, mounting: BodyMounting | None, seed: int = 0) -> Instrument:
    """Return a worn device by its corrected readings, its calibration and its mounting, as far as they are stated."""
    record = record.in_si()
    assumed = [] if mounting is not None and np.any(mounting.covariance) else ["mounting"]
    worn_as = mounting or BodyMounting(
        place="lower-back", matrix=np.eye(3), covariance=np.zeros((3, 3)), basis="assumed"
    )
    covariance = worn_as.covariance if not assumed else BY_HAND**2 * np.eye(3)
    worn = wear(record, worn_as)
    changes = [("mounting", _turned(turn)) for turn in _columns(covariance)]
    gyro = None if model is None or model.gyro is None else error_covariance(model.gyro, "rate")
    if gyro is None or not np.isfinite(gyro).all() or not gyro.any():
        assumed.append("gyroscope calibration")
        gyro = np.diag([GYRO_SCALE**2 if k in (0, 4, 8) else 0.0 for k in range(12)])
    offset_covariance = gyro[9:, 9:].copy()
    gyro[9:, :], gyro[:, 9:] = 0.0, 0.0  # what is left of the offset at this moment counts as such
    rest = known_rest_offset(record)
    rest = rest if rest is not None and rest.stop_s - rest.start_s > LEAST_REST_S else None
    if rest is not None and record.offset_uncertainty is None:
        worn, left = replace(worn, gyro=worn.gyro - rest.rate), rest.uncertainty / math.sqrt(3.0) * np.ones(3)
        standing = np.sqrt(np.diag(rest.covariance))
    elif record.offset_uncertainty is not None:
        left = record.offset_uncertainty / math.sqrt(3.0) * np.ones(3)
    else:
        assumed.append("gyroscope offset since the calibration")
        moved = moved_by(None if model is None else model.gyro) ** 2 / 3.0
        left = np.sqrt(np.diag(offset_covariance) + GYRO_OFFSET**2 + moved)
    worn = replace(worn, offset_uncertainty=float(np.linalg.norm(left)))
    changes += [("calibration", _erring("gyro", one)) for one in _columns(gyro)]
    force_error = record.accel_uncertainty
    if force_error is None:
        assumed.append("accelerometer calibration")
        changes += [("calibration", _erring("accel", _offset(ACCEL_OFFSET, k))) for k in range(3)]
    else:
        changes += [("calibration", _erring("accel", one)) for one in _columns(force_error.covariance)]
        seen_c = np.empty(0) if record.temp_c is None else record.temp_c[np.isfinite(record.temp_c)]
        offset_k, scale_k = by_temperature(force_error, float(seen_c.mean()) if len(seen_c) else np.nan)
        changes += [("temperature", _erring("accel", _offset(offset_k, k))) for k in range(3) if offset_k]
        changes += [("temperature", _erring("accel", _scale(scale_k, k))) for k in range(3) if scale_k]
    size = ageing("" if force_error is None else force_error.calibrated)
    changes += [("offset", _erring("accel", _offset(size, k))) for k in range(3)]
    changes.append(("motion", lambda one: replace(one, acc_s=2.0 * ACC_S)))
    seeds = np.random.default_rng(seed).integers(2**32, size=DRAWS).tolist()
    return Instrument(
        worn=worn,
        changes=tuple(changes),
        left=(left, left if rest is None or record.offset_uncertainty is not None else standing),
        noise=(_noise_of(worn, model, stands=False), _noise_of(worn, model, stands=True)),
        seeds=tuple(seeds),
        assumed=tuple(assumed),
        place=worn_as.place,
        sizes={
            "mounting": math.sqrt(float(np.trace(covariance)) / 3.0) / RADIAN_PER_DEGREE,
            "offset": float(np.linalg.norm(left)) / math.sqrt(3.0) / RADIAN_PER_DEGREE,
        },
    )


def take(device: Instrument, task: TaskMeasure) -> tuple[TaskResult, tuple[Measure, ...]]:
    """Return what a recording shows of a task, each measure with its uncertainty; a measure that a change undoes is left out."""
    stands, worn = stands_in(task), device.readings(task)
    course = follow(worn)
    shown = task(course)
    undone: dict[str, str] = {}

    def moved(source: str, change: Change) -> dict[str, FloatArray]:
        """Return how each measure changes."""
        try:
            again: Mapping[str, FloatArray] = task(follow(change(worn))).values
        except InputError:
            again = {}
        same: dict[str, FloatArray] = {
            name: (MOTION if source == "motion" else 1.0) * (again[name] - value)
            for name, value in shown.values.items()
            if name in again and again[name].shape == value.shape
        }
        for name in shown.values.keys() - same.keys():
            text = f"the uncertainty of {source} decides whether it is seen: its own cannot be stated"
            undone.setdefault(name, text)
        return same

    changes = device.all_changes(stands=stands)
    every = [moved(source, change) for source, change in changes]
    signed = [(seed, sign) for seed in device.seeds for sign in (1, -1)]
    draws = [
        [moved("noise", noisy(device, seed, sign * math.sqrt(power), stands=stands)) for seed, sign in signed]
        for power in (1.0, 2.0)
    ]
    sources = (*(source for source, _ in changes), "noise", "noise", "sampling")
    between, measures = SAMPLING * course.step, list[Measure]()
    for name, value in shown.values.items():
        if name in undone:
            continue
        once, twice = (np.array([one[name] for one in each]) for each in draws)
        noise = STUDENT * once.std(axis=0), 3.0 * once.mean(axis=0) - twice.mean(axis=0)
        columns = np.array(
            [*(one[name] for one in every), *noise, between * shown.by_time.get(name, is_time(name)) + 0.0 * value]
        )
        measures.append(Measure(name=name, values=value, columns=columns, sources=sources))
    return replace(shown, missing=(*shown.missing, *undone.items())), tuple(measures)


def stands_in(task: TaskMeasure) -> bool:
    """Tell whether the person stands still."""
    from undrift.measures.standing import sway

    return task is sway


def _columns(covariance: FloatArray) -> list[FloatArray]:
    """Return independent changes that have a covariance, one standard uncertainty each."""
    sizes, ways = np.linalg.eigh(covariance)
    return [
        math.sqrt(size) * ways[:, k] for k, size in enumerate(sizes) if size > _NEGLIGIBLE * max(sizes.sum(), 1e-300)
    ]


def _turned(turn: FloatArray) -> Change:
    """Return the change of the mounting by a small rotation about the axes a."""
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return lambda one: replace(one, matrix=(np.eye(3) + cross + 0.5 * cross @ cross) @ one.matrix)


def _erring(triad: str, error: FloatArray) -> Change:
    """Return the change of a triad's readings by E, row by row, and d (12,)."""
    matrix, shift = error[:9].reshape(3, 3), error[9:]

    def changed(one: WornReadings) -> WornReadings:
        readings = one.gyro if triad == "gyro" else one.accel
        other = readings + readings @ matrix.T + shift
        return replace(one, gyro=other) if triad == "gyro" else replace(one, accel=other)

    return changed


def _offset(size: float, axis: int) -> FloatArray:
    return np.asarray(size * np.eye(12)[9 + axis])


def _scale(size: float, axis: int) -> FloatArray:
    return np.asarray(size * np.eye(12)[4 * axis])


def _noise_of(worn: WornReadings, model: Calibration | None, *, stands: bool) -> FloatArray:
    """Return white noise of a reading (2, 3), rad/s and m/s2: by the calibration, else by third differences of a stretch.

    Motion is in these too, though it is smooth: then the quietest stretch; of a person who stands the usual one.
    """
    rate_hz = (len(worn.time) - 1) / float(worn.time[-1] - worn.time[0])
    noise, sizes = None if model is None else model.noise, list[FloatArray]()
    for readings, density in (
        (worn.gyro, None if noise is None else noise.angle_random_walk),
        (worn.accel, None if noise is None else noise.velocity_random_walk),
    ):
        power = np.diff(readings, 3, axis=0) ** 2
        length = min(max(round(QUIET_S * rate_hz), 8), len(power))
        each = power[: len(power) // length * length].reshape(-1, length, 3).mean(axis=1)
        shown = np.sqrt((np.median(each, axis=0) if stands else each[np.argmin(each.sum(axis=1))]) / 20.0)
        stated = np.full(3, np.nan) if density is None else np.asarray(density) * math.sqrt(rate_hz)
        sizes.append(np.where(np.isfinite(stated), stated, shown))
    return np.stack(sizes)


def noisy(device: Instrument, seed: int, times: float, *, stands: bool) -> Change:
    """Return the change by a draw of noise, some times its size, of a person who stands or moves."""

    def changed(one: WornReadings) -> WornReadings:
        draw, shape = np.random.default_rng(seed), one.gyro.shape
        gyro, accel = (times * size * draw.normal(size=shape) for size in device.noise[stands])
        return replace(one, gyro=one.gyro + gyro, accel=one.accel + accel)

    return changed


def ratio(first: Measure, second: Measure) -> tuple[float, float]:
    """Return the ratio of one measure in two recordings of one wearing and its standard uncertainty.

    Mounting and calibration are one for both: their columns are added before they are squared.
    """
    value, total = first.mean / second.mean, 0.0
    both = [one.columns.mean(axis=1) / one.mean for one in (first, second)]
    for name in SOURCES:
        shares = [part[np.array(one.sources) == name] for part, one in zip(both, (first, second), strict=True)]
        same = name in (*SHARED, "mounting") and len(shares[0]) == len(shares[1])
        total += float(((shares[0] - shares[1]) ** 2).sum() if same else sum((one**2).sum() for one in shares))
    return value, abs(value) * math.sqrt(total)
