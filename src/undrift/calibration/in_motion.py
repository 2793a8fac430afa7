"""Both triads from motion alone: gravity, carried along by the strapdown, must stay one vector of its own length.

::

    w = M (u - o)    f = A (s - p)        readings u and s; matrices M and A, offset p of a device; offset o of a recording
    F(t) = R(t) f(t) = g u + a(t)         R by strapdown of w (fit/carried.py: what disturbs the means of F, and how much)

Nothing else is asked: no rest, no rig, no optics. Where a recording rests, its offset is the mean there, within what it moves by
afterwards. Elements of M and A are near those of the identity, each kind within a size that the device itself widens: what the
motion did not show keeps that prior, and is named with the movement that would show it. Readings in counts or volts are refused:
their map states what one is worth. How both triads lie to each other is seen, how they lie in the case is
not: axes are those that the readings have, within the prior. A magnetic field, corrected beforehand (calibration/magnetometer.py),
is a second direction that R must keep: it shows turns about the vertical.

Gauss-Newton, from short stretches of a recording, over which the first rates err little, to long ones.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from undrift.arrays import FloatArray, bridged
from undrift.calibration.magnetometer import FieldFit
from undrift.errors import Implausible, InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.carried import MEAN_S, CarriedMeans
from undrift.fit.priors import SCALE_FACTOR, SCALE_LIMIT
from undrift.fit.triad import TriadFit, triad_fit
from undrift.model import MATRIX_NAMES, OFFSET_NAMES, Verdict
from undrift.record import Record
from undrift.segments import find_still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

LEAST_S, LEAST_DPS = 20.0, 5.0  # of a recording, and rms of its rates less their mean
BRIDGED_S = 0.05  # the longest gap over which a line is near enough to the readings [assumed]
STAGES_S = (15.0, 15.0, 40.0, 40.0, 300.0, 300.0, 300.0, 300.0, 300.0)  # of a stretch, s, in each step of the descent
# rad/s: from rest to motion, from one recording to another, and a raw device's zero-rate output [assumed]
MOVED, DAILY, RAW_RATE = 0.02 * RADIAN_PER_DEGREE, 0.1 * RADIAN_PER_DEGREE, 1.0 * RADIAN_PER_DEGREE
# Errors over what the equations state: gyroscopes 1.2 simulated and 1.5 in real trials, accelerometers 1.8
WIDENED = {"gyro": 1.5, "accel": 1.8}
ONE_AXIS = 0.1  # share of the rates about the main axis, below which the others are no turns [assumed]
NOT_GRAVITY = 1.0  # m/s2, left in a mean over 5 s: people who walk leave 0.03, hands 0.1 [assumed]
IMPLAUSIBLE = 0.25  # of a scale factor: raw parts are within 0.2
SHOWN = 0.7  # of the prior deviation, below which an element counts as seen
FIELD_SIZE = 0.01  # of a corrected magnetic field: what its size may differ by in the means [assumed]


# ---- what is known about the matrices of a raw device
#
#     t = T (M - I, A - I, p)      t_d ~ N(0, size^2 of each kind)      M and A of a device d, p the offset of its accelerometers
#
# Kinds, three elements each. Sizes are twice what is published of 16 units of one part: scale factors of 0.12 to 0.20 and 0.07 to
# 0.14 %, symmetric cross-axis terms of 0.05 to 2.4 mrad, and 0.3 to 1.2 mrad between the triads. They count as known from a number
# of elements: cross-axis terms from thirty, scale factors and offsets from six, since data sheets allow more [assumed].

KINDS = {  # size, number of elements that it is known from
    "gyro_scale": (0.004, 6.0),
    "gyro_cross": (0.0028, 30.0),  # (m_ij + m_ji) / 2
    "accel_scale": (0.004, 6.0),
    "accel_cross": (0.0028, 30.0),
    "between": (0.004, 30.0),  # rotation of the gyroscopes minus that of the accelerometers, rad
    "case": (0.002, 30.0),  # mean of both rotations, rad
    "accel_offset": (0.3, 6.0),  # m/s2
}
_SIZE, _KNOWN_FROM = np.array(list(KINDS.values())).T


def _elements() -> FloatArray:
    """Return T (21, 21), from both matrices, row by row, and the offset to the kinds."""
    scale, cross, turn = np.zeros((3, 3, 9))
    for k, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
        scale[k, 4 * k] = 1.0
        cross[k, [3 * i + j, 3 * j + i]] = 0.5
        turn[k, [3 * i + j, 3 * j + i]] = 0.5, -0.5
    none = np.zeros((3, 9))
    rows = ((scale, none), (cross, none), (none, scale), (none, cross), (turn, -turn), (0.5 * turn, 0.5 * turn))
    whole = np.eye(21)
    whole[:18, :18] = np.block([list(row) for row in rows])
    return whole


ELEMENTS = _elements()


# ---- fit

_OF_GYRO = np.r_[:9, 21:24]
_DIAGONAL = np.tile(np.eye(3, dtype=bool).reshape(-1), 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InMotion:
    """Both triads of a device, fitted to recordings in motion."""

    gyro: TriadFit
    accel: TriadFit
    offsets: FloatArray  # (R, 3), reading at zero rate, mean over each recording, in its unit
    offset_uncertainty: FloatArray  # (R, 3), standard uncertainty of them
    acceleration: FloatArray  # (R,), what is left of it in a mean over 5 s, rms, m/s2
    rested: tuple[bool, ...]  # (R,), whether a recording has a rest
    field: FieldFit | None = None  # Magnetometer, where it was asked for

    @property
    def units(self) -> tuple[float, float]:
        """Size of a unit of reading, rad/s and m/s2."""
        return si_factor(self.gyro.model.unit_in, "rate"), si_factor(self.accel.model.unit_in, "accel")


@dataclass(frozen=True, slots=True, eq=False)
class _Rest:
    """Mean rate at the first rest, rad/s, and how near the offset in motion is to it: a body that sways is no rest."""

    rate: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, rates: FloatArray, rate_hz: float) -> "_Rest":
        blocks = np.array_split(rates, max(2, min(len(rates), round(len(rates) / (0.25 * rate_hz)))))
        scatter = np.std([block.mean(axis=0) for block in blocks], axis=0, ddof=1)
        return cls(rates.mean(axis=0), np.hypot(MOVED, scatter / np.sqrt(len(blocks))))


@dataclass(eq=False)
class _Unit:
    """A recording, or five minutes of a longer one: readings in rad/s and m/s2, what its offset is expected to be."""

    recording: int
    time: FloatArray
    rate: FloatArray
    force: FloatArray
    moving: FloatArray
    rest: _Rest | None
    offset: FloatArray
    stretches: list[tuple[slice, CarriedMeans, CarriedMeans]]  # of gravity and of the magnetic field
    field: FloatArray | None  # scaled to the size of gravity

    def cut(self, length_s: float) -> None:
        """Cut it into stretches of about a length; their sizes begin as usual."""
        pieces = max(1, round((self.time[-1] - self.time[0]) / length_s))
        if pieces != len(self.stretches):
            edges = np.linspace(0, len(self.time), pieces + 1).astype(int)
            spans = [slice(a, b) for a, b in pairwise(edges)]
            timed = [(self.time[span], self.moving[span]) for span in spans]
            self.stretches = [
                (span, CarriedMeans(*one), CarriedMeans(*one)) for span, one in zip(spans, timed, strict=True)
            ]

    def equations(
        self, model: "_Model", usual: FloatArray, length: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return information (24, 24) and right side (24,) for changes of M, A, p and o."""
        total, towards = np.zeros((24, 24)), np.zeros(24)
        for where, one, other in self.stretches:
            rate, force = self.rate[where] - self.offset, self.force[where] - model.offset
            ones = np.ones((len(rate), 1))
            mean, by_rate, by_force = one.means(
                rate @ model.gyro.T, force @ model.accel.T, np.hstack((rate, ones)), np.hstack((force, ones))
            )
            of_matrix = (each[..., :3].reshape(-1, 3, 9) for each in (by_rate, by_force))
            of_offset = (-by_force[..., 3] @ model.accel, -by_rate[..., 3] @ model.gyro)
            more, right = one.equations(mean, np.concatenate((*of_matrix, *of_offset), axis=2), usual, length)
            total, towards = total + more, towards + right
            if self.field is not None:  # a direction that shows turns about the vertical too; it says nothing of forces
                mean, by_rate, _ = other.means(
                    rate @ model.gyro.T, self.field[where], np.hstack((rate, ones)), np.empty((len(rate), 0))
                )
                design = np.concatenate((by_rate[..., :3].reshape(-1, 3, 9), -by_rate[..., 3] @ model.gyro), axis=2)
                more, right = other.equations(mean, design, usual[_OF_GYRO], (length[0], FIELD_SIZE * length[0]))
                total[np.ix_(_OF_GYRO, _OF_GYRO)] += more
                towards[_OF_GYRO] += right
        return total, towards


@dataclass(eq=False)
class _Model:
    """Parameters of a device that the descent moves, rad/s and m/s2."""

    gyro: FloatArray
    accel: FloatArray
    offset: FloatArray  # p
    usual: FloatArray  # (3,), gyroscopes' offset over its recordings
    sizes: FloatArray  # (7,), deviation of each kind of element

    @property
    def deviation(self) -> FloatArray:
        """M and A minus the identity, row by row, and p, (21,)."""
        return np.append((np.stack((self.gyro, self.accel)) - np.eye(3)).reshape(-1), self.offset)

    @property
    def information(self) -> FloatArray:
        """Information of the prior about these, (21, 21)."""
        return np.asarray((ELEMENTS.T / np.repeat(self.sizes, 3) ** 2) @ ELEMENTS)

    def move(self, step: FloatArray) -> None:
        """Take a step (24,) of M, A, p and the usual offset."""
        self.gyro, self.accel = self.gyro + step[:9].reshape(3, 3), self.accel + step[9:18].reshape(3, 3)
        self.offset, self.usual = self.offset + step[18:21], self.usual + step[21:24]

    def widen(self, covariance: FloatArray) -> None:
        """Let the size of each kind of element follow this device: its deviation, and how uncertain that is."""
        square = (ELEMENTS @ self.deviation) ** 2 + np.diag(ELEMENTS @ covariance[:21, :21] @ ELEMENTS.T)
        self.sizes = np.sqrt((_KNOWN_FROM * _SIZE**2 + square.reshape(7, 3).sum(axis=1)) / (_KNOWN_FROM + 3.0))


def fit_in_motion(
    records: Sequence[Record],
    *,
    gravity_m_s2: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    field: bool = False,
) -> InMotion:
    """Fit both triads of one device to raw recordings of 20 s and more in which it is turned; gravity in m/s2.

    With ``field``, their magnetometer, corrected beforehand, is a second direction that the gyroscopes must carry along.

    Raises InputError for a triad that is missing, counts, gaps, short recordings or several units, NotObservable for a device that
    is not turned.
    """
    scales = _usable(records)
    units = _units([one.in_units("rad/s", "m/s2") for one in records], gravity_m_s2 if field else None)
    rests = [one.rest.rate for one in units if one.rest is not None]
    model = _Model(
        gyro=np.eye(3), accel=np.eye(3), offset=np.zeros(3),
        usual=np.mean(rests, axis=0) if rests else np.zeros(3), sizes=_SIZE,
    )  # fmt: skip
    for one in units:
        one.offset = model.usual if one.rest is None else one.rest.rate
    length = gravity_m_s2, float(np.hypot(gravity_uncertainty, 1e-4 * gravity_m_s2))
    shown: FloatArray = np.eye(0)  # what the recordings add
    for stage in STAGES_S:
        before, towards = _prior(model, units)
        shown = np.zeros_like(before)
        usual = np.append(np.sqrt(np.diag(np.linalg.inv(model.information))), np.full(3, RAW_RATE))
        for k, one in enumerate(units):
            one.cut(stage)
            places = np.r_[:21, 24 + 3 * k : 27 + 3 * k]
            known, seen = one.equations(model, usual, length)
            shown[np.ix_(places, places)] += known
            towards[places] += seen
        covariance: FloatArray = np.linalg.inv(before + shown)
        step = covariance @ towards
        model.move(step[:24])
        for k, one in enumerate(units):
            one.offset = one.offset + step[24 + 3 * k : 27 + 3 * k]
        model.widen(covariance)
    wide = np.full(len(shown), WIDENED["gyro"])
    wide[9:21] = WIDENED["accel"]
    freedom = 3.0 + _KNOWN_FROM
    model.sizes = model.sizes * np.sqrt(freedom / (freedom - 2.0))  # Student's t: sizes are known from few elements
    covariance = np.linalg.inv(_prior(model, units)[0] + shown / wide[:, None] / wide)
    for first, size in ((0, model.sizes[0]), (9, model.sizes[2])):
        scale = first + np.array([0, 4, 8])
        hidden = scale[np.sqrt(np.diag(covariance)[scale]) > SHOWN * size]
        covariance[hidden, hidden] += SCALE_FACTOR**2  # only a data sheet states it
    return _result(records, scales, units, model, covariance)


def without_gaps(record: Record) -> list[Record]:
    """Return the stretches between gaps (NaN, steps of time), of 20 s and more where there are any; short gaps are bridged."""
    if record.gyro is None or record.accel is None:
        return [record]
    seen = np.flatnonzero(np.isfinite(np.hstack((record.gyro, record.accel))).all(axis=1))
    ends = np.flatnonzero(np.diff(record.time[seen]) > max(BRIDGED_S, 1.5 / record.sample_rate_hz))
    spans = zip(seen[np.append(0, ends + 1)], seen[np.append(ends, -1)] + 1, strict=True) if len(seen) else ()
    parts = [record.part(int(a), int(b)) for a, b in spans if record.time[b - 1] - record.time[a] >= LEAST_S]
    if len(parts) == 1 and len(parts[0]) == len(seen) == len(record):
        return [record]
    lines = [bridged(one.time, np.hstack((np.asarray(one.gyro), np.asarray(one.accel)))) for one in parts]
    return [replace(one, gyro=x[:, :3], accel=x[:, 3:]) for one, x in zip(parts, lines, strict=True)] or [record]


def _usable(records: Sequence[Record]) -> tuple[float, float]:
    """Return rad/s and m/s2 per unit of reading; InputError where recordings lack a triad, length or one unit, or have gaps."""
    if not records:
        raise InputError("motion: wanted one recording or more, got none; name them")
    kinds = {(record.gyro_unit, record.accel_unit) for record in records}
    if len(kinds) > 1:
        got = ", ".join(sorted({unit for pair in kinds for unit in pair}))
        raise InputError(
            f"motion: wanted all recordings in one unit of each triad, got {got}; state the scale of their columns"
        )
    (units,) = kinds
    for unit, name in zip(units, ("gyroscopes", "accelerometers"), strict=True):
        if not is_physical(unit):
            raise InputError(
                f"motion: the {name} are in {unit}, and motion alone does not show what one is worth. State the gain of their "
                "columns in the map, from the range that the device was set to: scale = { gyro = { gain = 0.061 } }."
            )
    for number, record in enumerate(records):
        where = f"motion, recording {number + 1}"
        if record.gyro is None or record.accel is None:
            raise InputError(f"{where}: wanted gyroscopes and accelerometers, got one of them; map both")
        gaps = int((~np.isfinite(np.hstack((record.gyro, record.accel)))).any(axis=1).sum())
        if gaps or record.duration_s < LEAST_S:
            got = f"{gaps} gaps (NaN)" if gaps else f"{record.duration_s:.3g} s"
            raise InputError(f"{where}: wanted {LEAST_S:g} s or more without gaps, got {got}; cut it, or leave it out")
    return si_factor(units[0], "rate"), si_factor(units[1], "accel")


def _units(records: Sequence[Record], field_size: float | None) -> list[_Unit]:
    """Return recordings in rad/s and m/s2 as units of the fit."""
    units = []
    for number, record in enumerate(records):
        gyro, accel = np.asarray(record.gyro), np.asarray(record.accel)
        still = find_still(record).stills or find_still(record, over_noise=True).stills
        rest = _Rest.of(gyro[still[0].start : still[0].stop], record.sample_rate_hz) if still else None
        moving = np.ones(len(record))
        for one in still:
            moving[one.start : one.stop] = 0.0
        mag = None
        if field_size is not None and record.mag_ut is not None:
            mag = bridged(record.time, record.mag_ut)  # it may be slower
            mag *= field_size / float(np.median(np.linalg.norm(mag, axis=1)))
        pieces = max(1, round(record.duration_s / STAGES_S[-1]))
        for a, b in pairwise(np.linspace(0, len(record), pieces + 1).astype(int)):
            here = np.asarray(record.time)[a:b]
            own = None if mag is None else mag[a:b]
            units.append(_Unit(number, here, gyro[a:b], accel[a:b], moving[a:b], rest, np.zeros(3), [], own))
    turned_dps = np.degrees(max(float(np.sqrt(unit.rate.var(axis=0).sum())) for unit in units))
    variances = np.linalg.eigvalsh(np.mean([np.cov(unit.rate.T) for unit in units], axis=0))
    across_dps, along_dps = np.degrees(np.sqrt(variances[1:].clip(0.0))).tolist()
    advice = "Turn the device in the hand, slowly, about every axis, for a minute"
    if turned_dps < LEAST_DPS:
        raise NotObservable(
            f"motion: wanted a device that is turned, got rates of {turned_dps:.2g} deg/s rms. {advice}"
        )
    if across_dps < ONE_AXIS * along_dps:
        raise NotObservable(
            f"motion: the device turns about one axis only, {along_dps:.3g} deg/s rms; across it, rates are "
            f"{across_dps:.2g} deg/s rms. Errors of the accelerometers then read as scale of the gyroscope. {advice}",
            along_dps=along_dps,
            across_dps=across_dps,
        )
    return units


def _prior(model: _Model, units: list[_Unit]) -> tuple[FloatArray, FloatArray]:
    """Return information and right side of the priors: of elements, and of the offsets of the device and of its recordings."""
    count, eye = 24 + 3 * len(units), np.eye(3)
    information, towards = np.zeros((count, count)), np.zeros(count)
    information[:21, :21], information[21:24, 21:24] = model.information, eye / RAW_RATE**2
    towards[:24] = -np.append(model.information @ model.deviation, model.usual / RAW_RATE**2)
    for k, unit in enumerate(units):
        own, apart = slice(24 + 3 * k, 27 + 3 * k), np.zeros((3, count))
        apart[:, 21:24], apart[:, own] = -eye, eye
        information += apart.T @ apart / DAILY**2
        towards -= apart.T @ (unit.offset - model.usual) / DAILY**2
        if unit.rest is not None:
            information[own, own] += np.diag(unit.rest.spread**-2.0)
            towards[own] += (unit.rest.rate - unit.offset) / unit.rest.spread**2
    return information, towards


def _result(
    records: Sequence[Record],
    scales: tuple[float, float],
    units: list[_Unit],
    model: _Model,
    covariance: FloatArray,
) -> InMotion:
    """Return the model in the units of the readings, judged."""
    unit_gyro, unit_accel = records[0].gyro_unit, records[0].accel_unit
    verdict = Verdict.of(*_judged(model, covariance))
    fits, force = [], np.concatenate([each.left for one in units for _, each, _ in one.stretches])
    for matrix, offset, rows, factor, unit, out in (
        (model.gyro, model.usual, _OF_GYRO, scales[0], unit_gyro, "rad/s"),
        (model.accel, model.offset, np.r_[9:21], scales[1], unit_accel, "m/s2"),
    ):
        scale = np.repeat((factor, 1.0 / factor), (9, 3))
        readings = [(one.rate - one.offset if out == "rad/s" else one.force - offset) @ matrix.T for one in units]
        fits.append(
            triad_fit(
                force.ravel() if out == "m/s2" else force[:, :2].ravel() / (STANDARD_GRAVITY * MEAN_S),
                verdict,
                method="motion",
                unit_in=unit,
                unit_out=out,
                matrix=factor * matrix,
                offset=offset / factor,
                parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
                covariance=scale[:, None] * covariance[np.ix_(rows, rows)] * scale,
                rank=12,
                condition=float(np.linalg.cond(covariance[np.ix_(rows[:9], rows[:9])])) ** 0.5,
                valid_range=(min(float(each.min()) for each in readings), max(float(each.max()) for each in readings)),
            )
        )
    gravity = np.median([np.median(np.linalg.norm(one.force, axis=1)) for one in units]) / STANDARD_GRAVITY
    gyro_scale = np.linalg.norm(np.linalg.inv(model.gyro), axis=1)
    for triad, scale in (("gyroscope", gyro_scale), ("accelerometer", gravity)):
        if (most := float(np.abs(scale - 1.0).max())) > IMPLAUSIBLE:
            raise Implausible(
                f"motion: a scale of the {triad} is {100.0 * most:.3g} % off its stated unit, and raw parts are within "
                f"{100.0 * IMPLAUSIBLE:g} %. Check unit, gain and sample rate, and that both triads share one clock",
                percent=100.0 * most,
            )
    spread = np.sqrt(np.diag(covariance)[24:].reshape(-1, 3))
    of_each = [[k for k, one in enumerate(units) if one.recording == r] for r in range(len(records))]
    sizes = [[np.exp(each.sizes[0]) for k in places for _, each, _ in units[k].stretches] for places in of_each]
    left = np.sqrt([np.mean(each) for each in sizes])
    if (most := float(left.max())) > NOT_GRAVITY:
        raise Implausible(
            f"motion, recording {int(left.argmax()) + 1}: wanted specific force that stays gravity where the gyroscopes turn "
            f"it, got {most:.2g} m/s2 of acceleration in means over 5 s; check sample rate, units and axes of both triads",
            acceleration_m_s2=most,
        )
    return InMotion(
        gyro=fits[0],
        accel=fits[1],
        offsets=np.array([np.mean([units[k].offset for k in places], axis=0) for places in of_each]) / scales[0],
        offset_uncertainty=np.array([spread[places].max(axis=0) for places in of_each]) / scales[0],
        acceleration=left,
        rested=tuple(units[places[0]].rest is not None for places in of_each),
    )


_ADVICE = {
    "gyroscope": "add ten seconds for each axis: lay it level and turn the device about it by half a turn or more, to and fro",
    "accelerometer": "add ten seconds for each side: hold the device with each of these axes up, then down",
}


def _judged(model: _Model, covariance: FloatArray) -> Iterator[Finding]:
    """Yield scale factors that keep their prior, and how uncertain or implausible the others are."""
    spread = np.sqrt(np.diag(covariance))
    for triad, first, size, matrix in (
        ("gyroscope", 0, model.sizes[0], model.gyro),
        ("accelerometer", 9, model.sizes[2], model.accel),
    ):
        scale = spread[first + np.array([0, 4, 8])]
        if (scale > SHOWN * size).any():
            axes = ", ".join(axis for axis, kept in zip("xyz", scale > SHOWN * size, strict=True) if kept)
            most = 100.0 * float(scale.max())
            yield finding(
                "motion.prior", "warn", triad=triad, axes=axes, uncertainty_percent=most, advice=_ADVICE[triad]
            )
        elif triad == "gyroscope":
            alike = [0.5 * np.sqrt(covariance[np.ix_(pair, pair)].sum()) for pair in ((1, 3), (2, 6), (5, 7))]
            if (most := 100.0 * float(max(*alike, *scale))) > 0.2:
                yield finding("reference.uncertainty", "warn", uncertainty_percent=most)
        if (far := float(np.abs(1.0 / np.diag(matrix) - 1.0).max())) > SCALE_LIMIT:
            yield finding("motion.scale", "warn", triad=triad, percent=100.0 * far)
    yield finding("motion.case", "info", lean_deg=np.degrees(spread[:18][~_DIAGONAL].max()))
