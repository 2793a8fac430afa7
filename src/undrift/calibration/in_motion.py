"""Calibrate both triads from motion only: gravity in the strapdown's level frame must be one constant vector of its length.

::

    w = M (u - o)    f = A (s - p)        readings u and s, matrices M and A, offset p of a device, offset o of a recording
    F(t) = R(t) f(t) = g u + a(t)         R by strapdown of w (errors of the means of F: fit/carried.py)

No rest, rig or optics is needed. If a recording has a rest, its offset is the mean reading there, within the change from rest to
motion. The prior expects elements of M and A near those of the identity. The fit widens each kind of element to suit the device.
Elements that the motion does not determine keep the prior, and a finding names them. The motion determines the rotation between the
triads, but not their rotation in the case. A calibrated magnetic field (calibration/magnetometer.py) is a second direction that R
must keep, and determines turns about the vertical.

Gauss-Newton solves for x = (M, A, p, usual offset, o of each part). It starts with short stretches, which tolerate errors of the
first rates, and ends with long ones. The prior is a set of rows, B x = b with a standard deviation each.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
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

LEAST_S, LEAST_DPS = 20.0, 5.0  # shortest recording, and smallest rms of its rates minus their mean
BRIDGED_S = 0.05  # longest gap over which a line is near enough to the readings. Assumed.
# length of a stretch, s, in each step of the descent
STAGES_S = (15.0, 15.0, 40.0, 40.0, 300.0, 300.0, 300.0, 300.0, 300.0)
# rad/s: from rest to motion, from one recording to another, and zero-rate output of a raw device. Assumed.
MOVED, DAILY, RAW_RATE = 0.02 * RADIAN_PER_DEGREE, 0.1 * RADIAN_PER_DEGREE, 1.0 * RADIAN_PER_DEGREE
# ratio of the actual errors to those of the equations: gyroscopes 1.2 simulated, 1.5 in real trials, accelerometers 1.8
WIDENED = {"gyro": 1.5, "accel": 1.8}
ONE_AXIS = 0.1  # smallest share of the rates about the main axis that counts as a turn about others. Assumed.
NOT_GRAVITY = 1.0  # m/s2, largest acceleration in means over 5 s (walking 0.03, hands 0.1). Assumed.
IMPLAUSIBLE = 0.25  # largest relative error of a scale factor (raw parts are within 0.2)
SHOWN = 0.7  # share of the prior deviation below which an element counts as determined
WANTED_PERCENT = 0.2  # uncertainty of the gyroscope's matrix
FIELD_SIZE = 0.01  # relative, by which the size of a corrected magnetic field may differ between means. Assumed.


# ---- what is known about the matrices of a raw device
#
# t = T (M - I, A - I, p)      t_d ~ N(0, size^2 of each kind)      M, A and accelerometer offset p of a device d
#
# Each kind has three elements. Sizes are twice those published for 16 units of one part: scale factors 0.12 to 0.20 and 0.07 to
# 0.14 %, symmetric cross-axis terms of 0.05 to 2.4 mrad, and 0.3 to 1.2 mrad between the triads. They count as known from a number
# of elements: cross-axis terms from thirty, scale factors and offsets from six, since data sheets allow more. Assumed.

KINDS = {  # size, number of elements that it is known from
    "gyro_scale": (0.004, 6.0),
    "gyro_cross": (0.0028, 30.0),  # (m_ij + m_ji) / 2
    "accel_scale": (0.004, 6.0),
    "accel_cross": (0.0028, 30.0),
    "between": (0.004, 30.0),  # rotation of the gyroscopes relative to the accelerometers, rad
    "case": (0.002, 30.0),  # mean of both rotations, rad
    "accel_offset": (0.3, 6.0),  # m/s2
}
SIZE, KNOWN_FROM = np.array(list(KINDS.values())).T
NOMINAL = np.concatenate((np.eye(3).ravel(), np.eye(3).ravel(), np.zeros(3)))  # M, A, p


def _kinds() -> FloatArray:
    """Return T (21, 21), from both matrices, row by row, and the offset to the kinds."""
    scale, cross, turn = np.zeros((3, 3, 9))
    for k, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
        scale[k, 4 * k] = 1.0
        cross[k, [3 * i + j, 3 * j + i]] = 0.5
        turn[k, [3 * i + j, 3 * j + i]] = 0.5, -0.5
    zero, deviations = np.zeros((3, 9)), np.eye(21)
    deviations[:18, :18] = np.block(
        [[scale, zero], [cross, zero], [zero, scale], [zero, cross], [turn, -turn], [0.5 * turn, 0.5 * turn]]
    )
    return deviations


TO_KINDS = _kinds()


# ---- fit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InMotion:
    """Both triads of a device, fitted to R recordings in motion."""

    gyro: TriadFit
    accel: TriadFit
    offsets: FloatArray  # (R, 3), mean reading at zero rate over each recording, in its unit
    offset_uncertainty: FloatArray  # (R, 3), their standard uncertainty
    acceleration: FloatArray  # (R,), acceleration that a mean over 5 s still contains, rms, m/s2
    rested: tuple[bool, ...]  # (R,), whether a recording has a rest
    field: FieldFit | None = None  # magnetometer, if it was fitted

    @property
    def units(self) -> tuple[float, float]:
        """Size of a unit of reading, rad/s and m/s2."""
        return si_factor(self.gyro.model.unit_in, "rate"), si_factor(self.accel.model.unit_in, "accel")


@dataclass(kw_only=True, eq=False)
class _Part:
    """A recording, or five minutes of a longer one."""

    recording: int
    time: FloatArray  # (N,), s
    rate: FloatArray  # (N, 3), readings, rad/s
    force: FloatArray  # (N, 3), readings, m/s2
    moving: FloatArray  # (N,), 1 in motion and 0 at rest
    rest: FloatArray | None  # (3,), mean rate at the first rest of the recording, rad/s
    rest_spread: (
        FloatArray  # (3,), standard deviation of the change to the offset in motion, larger for a body that sways
    )
    mag: FloatArray | None  # (N, 3), magnetic field, scaled to the size of gravity
    stretches: list[tuple[slice, CarriedMeans, CarriedMeans]] = field(default_factory=list)  # gravity, magnetic field

    def cut(self, length_s: float) -> None:
        """Cut the part into stretches of about a length, with default sizes of their errors."""
        count = max(1, round((self.time[-1] - self.time[0]) / length_s))
        if count != len(self.stretches):
            spans = [slice(*ends) for ends in pairwise(np.linspace(0, len(self.time), count + 1).astype(int))]
            timed = [(self.time[span], self.moving[span]) for span in spans]
            self.stretches = [(span, CarriedMeans(*t), CarriedMeans(*t)) for span, t in zip(spans, timed, strict=True)]

    def equations(
        self, device: FloatArray, offset: FloatArray, usual: FloatArray, length: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return information (24, 24) and right side (24,) for changes of M, A, p and o, at (M, A, p) and o."""
        gyro, accel = device[:18].reshape(2, 3, 3)
        total, right = np.zeros((24, 24)), np.zeros(24)
        for span, gravity, north in self.stretches:
            rate, force = self.rate[span] - offset, self.force[span] - device[18:]
            ones = np.ones((len(rate), 1))
            regressors = np.hstack((rate, ones)), np.hstack((force, ones))
            mean, rate_slopes, force_slopes = gravity.means(rate @ gyro.T, force @ accel.T, *regressors)
            matrices = [slopes[..., :3].reshape(-1, 3, 9) for slopes in (rate_slopes, force_slopes)]
            design = np.concatenate((*matrices, -force_slopes[..., 3] @ accel, -rate_slopes[..., 3] @ gyro), axis=2)
            information, right_part = gravity.equations(mean, design, usual, length)
            total, right = total + information, right + right_part
            if self.mag is not None:
                mean, rate_slopes, _ = north.means(
                    rate @ gyro.T, self.mag[span], regressors[0], np.empty((len(rate), 0))
                )
                design = np.concatenate((rate_slopes[..., :3].reshape(-1, 3, 9), -rate_slopes[..., 3] @ gyro), axis=2)
                gyro_columns = np.r_[:9, 21:24]
                information, right_part = north.equations(
                    mean, design, usual[gyro_columns], (length[0], FIELD_SIZE * length[0])
                )
                total[np.ix_(gyro_columns, gyro_columns)] += information
                right[gyro_columns] += right_part
        return total, right


def fit_in_motion(
    records: Sequence[Record],
    *,
    gravity_m_s2: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    field: bool = False,
) -> InMotion:
    """Fit both triads of one device to raw recordings of 20 s or more in which it is turned, with gravity in m/s2.

    With ``field``, a calibrated magnetometer gives a second direction that the strapdown must keep. Raise InputError for a missing
    triad, counts, gaps, several units or short recordings, and NotObservable for a device that is not turned.
    """
    _check(records)
    parts = _parts([record.in_units("rad/s", "m/s2") for record in records], gravity_m_s2 if field else None)
    rows, value, spread = _prior(parts)
    rests = [stretch.rest for stretch in parts if stretch.rest is not None]
    usual_offset = np.mean(rests, axis=0) if rests else np.zeros(3)
    x = np.concatenate((NOMINAL, usual_offset, *(usual_offset if p.rest is None else p.rest for p in parts)))
    length = gravity_m_s2, float(np.hypot(gravity_uncertainty, 1e-4 * gravity_m_s2))
    sizes = SIZE
    places = [np.r_[:21, 24 + 3 * k : 27 + 3 * k] for k in range(len(parts))]
    for stage_s in STAGES_S:
        spread[:21] = np.repeat(sizes, 3)
        weighted = rows / spread[:, None] ** 2
        motion, right = np.zeros((len(x), len(x))), weighted.T @ (value - rows @ x)
        usual = np.append(np.linalg.norm(np.linalg.inv(TO_KINDS) * spread[:21], axis=1), np.full(3, RAW_RATE))
        for stretch, place in zip(parts, places, strict=True):
            stretch.cut(stage_s)
            information, right_part = stretch.equations(x[:21], x[place[21:]], usual, length)
            motion[np.ix_(place, place)] += information
            right[place] += right_part
        covariance: FloatArray = np.linalg.inv(weighted.T @ rows + motion)
        x = x + covariance @ right
        # the size of each kind of element is adapted to this device: its deviation, and the uncertainty of this
        square = (TO_KINDS @ (x[:21] - NOMINAL)) ** 2 + np.diag(TO_KINDS @ covariance[:21, :21] @ TO_KINDS.T)
        sizes = np.sqrt((KNOWN_FROM * SIZE**2 + square.reshape(7, 3).sum(axis=1)) / (KNOWN_FROM + 3.0))
    wide = np.full(len(x), WIDENED["gyro"])
    wide[9:21] = WIDENED["accel"]
    sizes = sizes * np.sqrt((3.0 + KNOWN_FROM) / (1.0 + KNOWN_FROM))  # Student's t: sizes are known from few elements
    spread[:21] = np.repeat(sizes, 3)
    covariance = np.linalg.inv((rows / spread[:, None] ** 2).T @ rows + motion / np.outer(wide, wide))
    for first, size in ((0, sizes[0]), (9, sizes[2])):
        scale = first + np.array([0, 4, 8])
        hidden = scale[np.sqrt(np.diag(covariance)[scale]) > SHOWN * size]
        covariance[hidden, hidden] += SCALE_FACTOR**2  # only the data sheet gives its scale
    return _result(records, parts, x, covariance, Verdict.of(*_findings(x, covariance, sizes)))


def without_gaps(record: Record) -> list[Record]:
    """Return the stretches of 20 s or more between gaps (NaN, time steps), with short gaps bridged, or the record itself."""
    if record.gyro is None or record.accel is None:
        return [record]
    rows = np.flatnonzero(np.isfinite(np.hstack((record.gyro, record.accel))).all(axis=1))
    ends = np.flatnonzero(np.diff(record.time[rows]) > max(BRIDGED_S, 1.5 / record.sample_rate_hz))
    spans = zip(rows[np.append(0, ends + 1)], rows[np.append(ends, -1)] + 1, strict=True) if len(rows) else ()
    parts = [record.part(int(a), int(b)) for a, b in spans if record.time[b - 1] - record.time[a] >= LEAST_S]
    if len(parts) == 1 and len(parts[0]) == len(rows) == len(record):
        return [record]
    lines = [
        bridged(stretch.time, np.hstack((np.asarray(stretch.gyro), np.asarray(stretch.accel)))) for stretch in parts
    ]
    return [replace(stretch, gyro=x[:, :3], accel=x[:, 3:]) for stretch, x in zip(parts, lines, strict=True)] or [
        record
    ]


def _check(records: Sequence[Record]) -> None:
    """Raise InputError if recordings lack a triad, are too short, differ in units, are not in physical units, or have gaps."""
    if not records:
        raise InputError("motion: one recording or more is needed, got none. Name the recordings.")
    units = sorted({(record.gyro_unit, record.accel_unit) for record in records})
    if len(units) > 1:
        raise InputError(f"motion: the recordings need one unit of each triad, got {units}. Convert their columns.")
    for unit, name in zip(units[0], ("gyroscopes", "accelerometers"), strict=True):
        if not is_physical(unit):
            raise InputError(
                f"motion: the {name} are in {unit}, and motion does not determine the size of this unit. Enter the gain of the "
                "columns in the map. Example for a device with a known range: scale = { gyro = { gain = 0.061 } }."
            )
    for number, record in enumerate(records):
        where = f"motion, recording {number + 1}"
        if record.gyro is None or record.accel is None:
            raise InputError(f"{where}: gyroscopes and accelerometers are needed, got one of them. Map both.")
        gaps = int((~np.isfinite(np.hstack((record.gyro, record.accel)))).any(axis=1).sum())
        if gaps or record.duration_s < LEAST_S:
            got = f"{gaps} gaps (NaN)" if gaps else f"{record.duration_s:.3g} s"
            raise InputError(f"{where}: {LEAST_S:g} s or more without gaps are needed, got {got}. Leave it out.")


def _parts(records: Sequence[Record], field_size: float | None) -> list[_Part]:
    """Return recordings in rad/s and m/s2 as parts of the fit. Raise if the device is not turned about all axes."""
    parts = list[_Part]()
    for number, record in enumerate(records):
        gyro, accel = np.asarray(record.gyro), np.asarray(record.accel)
        stills = find_still(record).stills
        moving, rest, rest_spread = np.ones(len(record)), None, np.zeros(3)
        for still in stills:
            moving[still.start : still.stop] = 0.0
        if stills:
            rates = gyro[stills[0].start : stills[0].stop]
            count = max(2, min(len(rates), round(len(rates) / (0.25 * record.sample_rate_hz))))
            means = [block.mean(axis=0) for block in np.array_split(rates, count)]
            rest, rest_spread = (
                rates.mean(axis=0),
                np.hypot(MOVED, np.std(means, axis=0, ddof=1) / np.sqrt(count)),
            )
        mag = None
        if field_size is not None and record.mag_ut is not None:
            mag = bridged(record.time, record.mag_ut)  # the magnetometer may have a lower sample rate
            mag *= field_size / float(np.median(np.linalg.norm(mag, axis=1)))
        count = max(1, round(record.duration_s / STAGES_S[-1]))
        for a, b in pairwise(np.linspace(0, len(record), count + 1).astype(int)):
            parts.append(
                _Part(
                    recording=number, time=np.asarray(record.time)[a:b], rate=gyro[a:b], force=accel[a:b], moving=moving[a:b],
                    rest=rest, rest_spread=rest_spread, mag=None if mag is None else mag[a:b],
                )
            )  # fmt: skip
    turned_dps = np.degrees(max(float(np.sqrt(stretch.rate.var(axis=0).sum())) for stretch in parts))
    variances = np.linalg.eigvalsh(np.mean([np.cov(stretch.rate.T) for stretch in parts], axis=0))
    across_dps, along_dps = np.degrees(np.sqrt(variances[1:].clip(0.0))).tolist()
    advice = "Turn the device in the hand, slowly, about every axis, for a minute."
    if turned_dps < LEAST_DPS:
        raise NotObservable(f"motion: the device is not turned, with rates of {turned_dps:.2g} deg/s rms. {advice}")
    if across_dps < ONE_AXIS * along_dps:
        raise NotObservable(
            f"motion: the device turns about one axis only. Rates are {along_dps:.3g} deg/s rms about this axis and "
            f"{across_dps:.2g} deg/s rms across it. {advice}",
            along_dps=along_dps,
            across_dps=across_dps,
        )
    return parts


def _prior(parts: Sequence[_Part]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rows (E, P), values (E,) and standard deviations (E,) of the prior, starting with 21 rows for the elements.

    The prior of the device offset is zero. The prior of a part's offset is the device offset and its reading at rest.
    """
    count, eye = 24 + 3 * len(parts), np.eye(3)
    kinds = np.hstack((TO_KINDS, np.zeros((21, count - 21))))
    rows: list[FloatArray] = [kinds, np.eye(3, count, 21)]
    values: list[FloatArray] = [TO_KINDS @ NOMINAL, np.zeros(3)]
    spreads: list[FloatArray] = [np.ones(21), np.full(3, RAW_RATE)]
    for k, stretch in enumerate(parts):
        offset_columns = np.eye(3, count, 24 + 3 * k)
        daily = offset_columns.copy()
        daily[:, 21:24] -= eye
        rows.append(daily)
        values.append(np.zeros(3))
        spreads.append(np.full(3, DAILY))
        if stretch.rest is not None:
            rows.append(offset_columns)
            values.append(stretch.rest)
            spreads.append(stretch.rest_spread)
    return np.vstack(rows), np.concatenate(values), np.concatenate(spreads)


def _result(
    records: Sequence[Record], parts: Sequence[_Part], x: FloatArray, covariance: FloatArray, verdict: Verdict
) -> InMotion:
    """Return the model in the units of the readings. Raise if it cannot describe a device in motion."""
    matrices, offsets = x[:18].reshape(2, 3, 3), x[24:].reshape(-1, 3)
    gravity = np.median([np.median(np.linalg.norm(stretch.force, axis=1)) for stretch in parts]) / STANDARD_GRAVITY
    gyro_scale = np.linalg.norm(np.linalg.inv(matrices[0]), axis=1)
    for triad, scale in (("gyroscope", gyro_scale), ("accelerometer", gravity)):
        if (percent := 100.0 * float(np.abs(scale - 1.0).max())) > 100.0 * IMPLAUSIBLE:
            raise Implausible(
                f"motion: a scale of the {triad} is {percent:.3g} % off its declared unit, but {100.0 * IMPLAUSIBLE:g} % is the "
                "limit for uncalibrated sensors. Check unit, gain and sample rate, and that both triads share one clock.",
                percent=percent,
            )
    stretches_of = [[k for k, stretch in enumerate(parts) if stretch.recording == r] for r in range(len(records))]
    variances = [[np.exp(g.sizes[0]) for k in numbers for _, g, _ in parts[k].stretches] for numbers in stretches_of]
    acceleration = np.sqrt([np.mean(recording_variances) for recording_variances in variances])
    if (most := float(acceleration.max())) > NOT_GRAVITY:
        raise Implausible(
            f"motion, recording {int(acceleration.argmax()) + 1}: after the gyroscopes' rotation, "
            f"{most:.2g} m/s2 of acceleration remain in means over 5 s. Check sample rate, units and axes of both triads.",
            acceleration_m_s2=most,
        )
    all_residuals = np.concatenate([gravity.left for stretch in parts for _, gravity, _ in stretch.stretches])
    gyro_unit, accel_unit = records[0].gyro_unit, records[0].accel_unit
    rates = [(stretch.rate - offset) @ matrices[0].T for stretch, offset in zip(parts, offsets, strict=True)]
    forces = [(stretch.force - x[18:21]) @ matrices[1].T for stretch in parts]
    gyro, accel = (
        _triad(residuals, x, covariance, rows, readings, verdict, unit_in=unit, unit_out=unit_out)
        for residuals, rows, readings, unit, unit_out in (
            (all_residuals[:, :2] / (STANDARD_GRAVITY * MEAN_S), np.r_[:9, 21:24], rates, gyro_unit, "rad/s"),
            (all_residuals, np.r_[9:21], forces, accel_unit, "m/s2"),
        )
    )
    factor, spread = si_factor(gyro_unit, "rate"), np.sqrt(np.diag(covariance)[24:].reshape(-1, 3))
    return InMotion(
        gyro=gyro,
        accel=accel,
        offsets=np.array([offsets[numbers].mean(axis=0) for numbers in stretches_of]) / factor,
        offset_uncertainty=np.array([spread[numbers].max(axis=0) for numbers in stretches_of]) / factor,
        acceleration=acceleration,
        rested=tuple(parts[numbers[0]].rest is not None for numbers in stretches_of),
    )


def _triad(
    residuals: FloatArray, x: FloatArray, covariance: FloatArray, rows: FloatArray, readings: Sequence[FloatArray],
    verdict: Verdict, *, unit_in: str, unit_out: str,
) -> TriadFit:  # fmt: skip
    """Return a triad whose matrix and offset are the elements ``rows`` (12,) of x, in the unit of the readings."""
    factor = si_factor(unit_in, "rate" if unit_out == "rad/s" else "accel")
    scale = np.repeat((factor, 1.0 / factor), (9, 3))
    return triad_fit(
        residuals.ravel(),
        verdict,
        method="motion",
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=(scale * x[rows])[:9].reshape(3, 3),
        offset=(scale * x[rows])[9:],
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        covariance=scale[:, None] * covariance[np.ix_(rows, rows)] * scale,
        rank=12,
        condition=float(np.linalg.cond(covariance[np.ix_(rows[:9], rows[:9])])) ** 0.5,
        valid_range=(min(float(values.min()) for values in readings), max(float(values.max()) for values in readings)),
    )


ADVICE = {
    "gyroscope": "add ten seconds for each axis: lay it level and turn the device about it by half a turn or more, to and fro",
    "accelerometer": "add ten seconds for each side: hold the device with each of these axes up, then down",
}


def _findings(x: FloatArray, covariance: FloatArray, sizes: FloatArray) -> Iterator[Finding]:
    """Yield findings about scale factors that keep their prior, and about uncertain or implausible elements."""
    spread = np.sqrt(np.diag(covariance))
    for triad, first, size in (("gyroscope", 0, sizes[0]), ("accelerometer", 9, sizes[2])):
        scale = spread[first + np.array([0, 4, 8])]
        if (scale > SHOWN * size).any():
            axes = tuple(axis for axis, near_prior in zip("xyz", scale > SHOWN * size, strict=True) if near_prior)
            percent = 100.0 * float(scale.max())
            yield finding(
                "motion.prior", "warn", triad=triad, axes=axes, uncertainty_percent=percent, advice=ADVICE[triad]
            )
        elif triad == "gyroscope":
            rotation_sigmas = [0.5 * np.sqrt(covariance[np.ix_(pair, pair)].sum()) for pair in ((1, 3), (2, 6), (5, 7))]
            if (percent := 100.0 * float(max(*rotation_sigmas, *scale))) > WANTED_PERCENT:
                yield finding("reference.uncertainty", "warn", triad=triad, uncertainty_percent=percent)
        if (deviation := float(np.abs(1.0 / x[first + np.array([0, 4, 8])] - 1.0).max())) > SCALE_LIMIT:
            yield finding("motion.scale", "warn", triad=triad, percent=100.0 * deviation)
