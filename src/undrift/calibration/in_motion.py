"""Calibrate both triads from motion only: in the level frame of the strapdown, gravity must be a constant vector of known length.

::

    w = M (u - o)    f = A (s - p)        readings u and s, matrices M and A, offset p of a device, offset o of a recording
    F(t) = R(t) f(t) = g u + a(t)         R by strapdown of w (errors of the means of F: fit/carried.py)

No rest, rig or optics is needed. If a recording has a rest, its offset is the mean reading at rest, within the change from rest to
motion. The prior expects M and A to be near the identity. The fit widens each kind of element to suit the device.
Elements that the motion does not determine keep the prior. Their uncertainty is that of data sheets, and a finding names them. The
motion determines the rotation between the triads, but not their rotation in the case. A calibrated magnetic field
(calibration/magnetometer.py) is a second direction that R must keep, and determines turns about the vertical.

Gauss-Newton solves for x = (M, A, p, usual offset, o of each part). It starts with short stretches, which tolerate errors of the
first rates, and ends with long ones. The prior is a set of rows, B x = b with a standard deviation each.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from undrift.arrays import FloatArray, bridged
from undrift.calibration.plausibility import check_own_scale
from undrift.calibration.reference import uncertain_scale
from undrift.errors import Implausible, InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.carried import MEAN_S, CarriedMeans, tilted_axes
from undrift.fit.priors import CROSS_AXIS, OFFSET_LIMIT, SCALE_FACTOR, SCALE_LIMIT, UNCERTAIN_PERCENT
from undrift.fit.triad import TriadFit, triad_fit
from undrift.record import Record, Still
from undrift.segments import BENCH_RATE_LIMIT, StillSettings, find_still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

LEAST_S, LEAST_DPS = 20.0, 5.0  # shortest recording, and smallest rms of its rates minus their mean
BRIDGED_S = 0.05  # longest gap over which linear interpolation is accurate enough. Assumed.
# length of a stretch, s, in each step of the descent
STAGES_S = (15.0, 15.0, 40.0, 40.0, 300.0, 300.0, 300.0, 300.0, 300.0)
# rad/s, offset: change from rest to motion, change between recordings, and zero-rate output of a raw device. Assumed.
MOVED, DAILY, RAW_RATE = 0.02 * RADIAN_PER_DEGREE, 0.1 * RADIAN_PER_DEGREE, 1.0 * RADIAN_PER_DEGREE
# Ratio of the actual errors of simulated devices to the computed errors. For gyroscopes it is 1.0, and 0.6 to 0.9
# in ten real trials compared with fits to their optics.
WIDENED_ACCEL, WIDENED_OFFSET = 1.2, 1.5
SCALES = np.array([0, 4, 8])  # indices of the scale factors among the elements of a matrix
QUIET_FLOORS = 3.5  # largest spread of a short rest, relative to the quietest window. Assumed.
CONTRADICTED = 3.0  # change of the offset from rest to motion, in standard deviations, that is reported. Assumed.
ONE_AXIS = 0.1  # smallest share of the rates about the main axis that counts as a turn about other axes. Assumed.
NOT_GRAVITY = 1.0  # m/s2, largest acceleration in means over 5 s (walking 0.03, hands 0.1). Assumed.
FIELD_SIZE = 0.01  # relative difference that the size of a corrected magnetic field may have between means. Assumed.


# ---- prior knowledge about the matrices of a raw device
#
# t = T (M - I, A - I, p)      t_d ~ N(0, size^2 of each kind)      M, A and accelerometer offset p of a device d
#
# Each kind has three elements. Sizes are twice those published for 16 units of one part: scale factors 0.12 to 0.20 and 0.07 to
# 0.14 %, symmetric cross-axis terms of 0.05 to 2.4 mrad, and 0.3 to 1.2 mrad between the triads. A size counts as known from a
# number of elements: thirty for cross-axis terms, six for scale factors and offsets, since data sheets allow more. Assumed. The
# estimate expects these sizes. Its uncertainty allows for the limits in data sheets.

FORCE_OFFSET = 0.3  # m/s2
KINDS = {  # size, number of elements from which it is known, size that data sheets allow
    "gyro_scale": (0.004, 6.0, SCALE_FACTOR),
    "gyro_cross": (0.0028, 30.0, CROSS_AXIS),  # (m_ij + m_ji) / 2
    "accel_scale": (0.004, 6.0, SCALE_FACTOR),
    "accel_cross": (0.0028, 30.0, CROSS_AXIS),
    "between": (0.004, 30.0, 0.0),  # rotation of the gyroscopes relative to the accelerometers, rad
    "case": (0.002, 30.0, 0.0),  # mean of both rotations, rad
    "accel_offset": (FORCE_OFFSET, 6.0, 0.0),
}
SIZE, KNOWN_FROM, ALLOWED = np.array(list(KINDS.values())).T
NOMINAL = np.concatenate((np.eye(3).ravel(), np.eye(3).ravel(), np.zeros(3)))  # M, A, p


def _kinds() -> FloatArray:
    """Return T (21, 21), which maps both matrices (row by row) and the offset to the kinds."""
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
    offsets: FloatArray  # (R, 3), mean reading at zero rate over each recording, rad/s
    offset_uncertainty: FloatArray  # (R, 3), their standard uncertainty
    acceleration: FloatArray  # (R,), acceleration that a mean over 5 s still contains, rms, m/s2


@dataclass(kw_only=True, eq=False)
class _Part:
    """A recording, or five minutes of a longer one."""

    recording: int
    time: FloatArray  # (N,), s
    rate: FloatArray  # (N, 3), readings, rad/s
    force: FloatArray  # (N, 3), readings, m/s2
    moving: FloatArray  # (N,), 1 in motion and 0 at rest
    rest: tuple[FloatArray, FloatArray] | None  # mean rate at rest (3,), rad/s, and expected change in motion
    mag: FloatArray | None  # (N, 3), magnetic field, scaled to the size of gravity
    stretches: list[tuple[slice, CarriedMeans, CarriedMeans]] = field(default_factory=list)  # gravity, field

    def cut(self, length_s: float) -> None:
        """Cut the part into stretches of roughly a given length, with default sizes of their errors."""
        count = max(1, round((self.time[-1] - self.time[0]) / length_s))
        if count != len(self.stretches):
            timed = [(span, self.time[span], self.moving[span]) for span in _spans(len(self.time), count)]
            self.stretches = [(span, CarriedMeans(*t), CarriedMeans(*t)) for span, *t in timed]

    def equations(
        self, device: FloatArray, offset: FloatArray, usual: FloatArray, length: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return information (24, 24) and right side (24,) for changes of M, A, p and o, at (M, A, p) and o."""
        gyro, accel = device[:18].reshape(2, 3, 3)
        total, right = np.zeros((24, 24)), np.zeros(24)
        tilted = tilted_axes(self.time, self.force, FORCE_OFFSET)
        for span, gravity, north in self.stretches:
            rate, force = self.rate[span] - offset, self.force[span] - device[18:]
            ones = np.ones((len(rate), 1))
            turns, pushes = np.hstack((rate, ones)), np.hstack((force, ones))
            mean, rate_slopes, force_slopes = gravity.means(rate @ gyro.T, force @ accel.T, turns, pushes)
            matrices = [slopes[..., :3].reshape(-1, 3, 9) for slopes in (rate_slopes, force_slopes)]
            design = np.concatenate(
                (*matrices, -force_slopes[..., 3] @ accel, -rate_slopes[..., 3] @ tilted @ gyro), axis=2
            )
            information, right_part = gravity.equations(mean, design, usual, length)
            total, right = total + information, right + right_part
            if self.mag is not None:
                mean, rate_slopes, _ = north.means(rate @ gyro.T, self.mag[span], turns, pushes[:, :0])
                design = np.zeros((len(mean), 3, 24))
                design[..., :9], design[..., 21:] = rate_slopes[..., :3].reshape(-1, 3, 9), -rate_slopes[..., 3] @ gyro
                information, right_part = north.equations(mean, design, usual, (length[0], FIELD_SIZE * length[0]))
                total, right = total + information, right + right_part
        return total, right


def _spans(length: int, count: int) -> list[slice]:
    """Return equal slices that together cover the length of an array."""
    return [slice(*ends) for ends in pairwise(np.linspace(0, length, count + 1).astype(int))]


def fit_in_motion(
    records: Sequence[Record],
    *,
    gravity_m_s2: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    fields: Sequence[FloatArray | None] = (),
) -> InMotion:
    """Fit both triads of one device to raw recordings of 20 s or more in which it is turned, with gravity in m/s2.

    The recordings have the same units. ``fields`` are the corrected magnetic fields (N, 3) of all recordings, if there are any.
    Raise InputError for a missing triad, counts, gaps or short recordings, and NotObservable for a device that is not turned.
    """
    for number, record in enumerate(records):
        _check(record, f"motion, recording {number + 1}")
    parts = _parts(
        [record.in_units("rad/s", "m/s2") for record in records], fields or [None] * len(records), gravity_m_s2
    )
    _check_turned([part.rate for part in parts])
    rows, value, spread = _prior(parts)
    rests = [part.rest[0] for part in parts if part.rest is not None]
    usual_offset = np.mean(rests, axis=0) if rests else np.zeros(3)
    offsets = [usual_offset if part.rest is None else part.rest[0] for part in parts]
    x = np.concatenate((NOMINAL, usual_offset, *offsets))
    length = gravity_m_s2, float(np.hypot(gravity_uncertainty, 1e-4 * gravity_m_s2))
    sizes = SIZE
    rest_rows = np.arange(24 + 3 * len(parts), len(rows))
    rest_spread, contradiction = spread[rest_rows], 0.0
    places = [np.r_[:21, 24 + 3 * k : 27 + 3 * k] for k in range(len(parts))]
    for stage_s in STAGES_S:
        spread[:21] = np.repeat(sizes, 3)
        weighted = rows / spread[:, None] ** 2
        motion, right = np.zeros((len(x), len(x))), weighted.T @ (value - rows @ x)
        usual = np.append(np.linalg.norm(np.linalg.inv(TO_KINDS) * spread[:21], axis=1), np.full(3, RAW_RATE))
        for part, place in zip(parts, places, strict=True):
            part.cut(stage_s)
            information, right_part = part.equations(x[:21], x[place[21:]], usual, length)
            motion[np.ix_(place, place)] += information
            right[place] += right_part
        covariance: FloatArray = np.linalg.inv(weighted.T @ rows + motion)
        x = x + covariance @ right
        # the size of each kind of element is adapted to this device: its deviation, and the uncertainty of the deviation
        square = (TO_KINDS @ (x[:21] - NOMINAL)) ** 2 + np.diag(TO_KINDS @ covariance[:21, :21] @ TO_KINDS.T)
        sizes = np.sqrt((KNOWN_FROM * SIZE**2 + square.reshape(7, 3).sum(axis=1)) / (KNOWN_FROM + 3.0))
        # a rest that the motion contradicts gets less weight, by the ratio of its difference to its standard deviation
        if len(rest_spread):
            misses = (rows[rest_rows] @ x - value[rest_rows]) / rest_spread
            contradiction = float(np.sqrt((misses**2).mean()))
            spread[rest_rows] = rest_spread * max(1.0, contradiction)
    wide = np.repeat((1.0, WIDENED_ACCEL, WIDENED_OFFSET), (9, 12, len(x) - 21))
    sizes = sizes * np.sqrt((3.0 + KNOWN_FROM) / (1.0 + KNOWN_FROM))  # Student's t: sizes are known from few elements
    spread[:21] = np.repeat(np.maximum(sizes, ALLOWED), 3)
    covariance = np.linalg.inv((rows / spread[:, None] ** 2).T @ rows + motion / np.outer(wide, wide))
    return _result(records, parts, x, covariance, contradiction)


def without_gaps(record: Record) -> list[Record]:
    """Return the stretches of 20 s or more between gaps (NaN, time steps), with short gaps bridged, or the record itself."""
    if record.gyro is None or record.accel is None:
        return [record]
    readings = np.hstack((record.gyro, record.accel))
    rows = np.flatnonzero(np.isfinite(readings).all(axis=1))
    gaps = np.flatnonzero(np.diff(record.time[rows]) > max(BRIDGED_S, 1.5 / record.sample_rate_hz)) + 1
    if len(rows) == len(record) and not len(gaps):
        return [record]
    stretches = list[Record]()
    for part in np.split(rows, gaps):
        if len(part) and record.time[part[-1]] - record.time[part[0]] >= LEAST_S:
            stretch = record.part(int(part[0]), int(part[-1]) + 1)
            line = bridged(stretch.time, readings[part[0] : part[-1] + 1])
            stretches.append(replace(stretch, gyro=line[:, :3], accel=line[:, 3:]))
    return stretches or [record]


def _check(record: Record, where: str) -> None:
    """Raise InputError if a recording lacks a triad, is too short, is not in physical units, or has gaps."""
    if record.gyro is None or record.accel is None:
        raise InputError(f"{where}: gyroscopes and accelerometers are needed, but one triad is missing. Map both.")
    for unit, name, example in (
        (record.gyro_unit, "gyroscopes", 'gyro = "dps" in units, and scale = { gyro = { gain = 0.061 } }'),
        (record.accel_unit, "accelerometers", 'accel = "g" in units, and scale = { accel = { gain = 0.000061 } }'),
    ):
        if not is_physical(unit):
            raise InputError(
                f"{where}: the {name} are in {unit}, and motion does not determine the size of this unit. Enter unit and gain in "
                f"the map. Example: {example}."
            )
    gaps = int((~np.isfinite(np.hstack((record.gyro, record.accel)))).any(axis=1).sum())
    if gaps or record.duration_s < LEAST_S:
        got = f"{gaps} gaps (NaN)" if gaps else f"{record.duration_s:.3g} s"
        raise InputError(f"{where}: {LEAST_S:g} s or more without gaps are needed, got {got}. Omit this recording.")


def _parts(records: Sequence[Record], fields: Sequence[FloatArray | None], field_size: float) -> list[_Part]:
    """Return recordings in rad/s and m/s2 as parts of the fit. Their magnetic fields get a common size."""
    parts = list[_Part]()
    for number, record in enumerate(records):
        gyro, accel = np.asarray(record.gyro), np.asarray(record.accel)
        stills = find_still(record).stills or _quiet_seconds(record)
        moving, rest = np.ones(len(record)), None
        for still in stills:
            moving[still.start : still.stop] = 0.0
        if stills:  # a swaying body determines its rest offset less well
            rates = gyro[stills[0].start : stills[0].stop]
            count = max(2, min(len(rates), round(len(rates) / (0.25 * record.sample_rate_hz))))
            means = [block.mean(axis=0) for block in np.array_split(rates, count)]
            rest = rates.mean(axis=0), np.hypot(MOVED, np.std(means, axis=0, ddof=1) / np.sqrt(count))
        if (mag := fields[number]) is not None:
            mag = bridged(record.time, mag)  # the magnetometer may have a lower sample rate
            mag *= field_size / float(np.median(np.linalg.norm(mag, axis=1)))
        for span in _spans(len(record), max(1, round(record.duration_s / STAGES_S[-1]))):
            parts.append(
                _Part(
                    recording=number, time=record.time[span], rate=gyro[span], force=accel[span], moving=moving[span],
                    rest=rest, mag=None if mag is None else mag[span],
                )
            )  # fmt: skip
    return parts


def _quiet_seconds(record: Record) -> tuple[Still, ...]:
    """Return stretches nearly as quiet as the quietest one, within the limit of a bench, for a recording without a clear rest."""
    found, rates = find_still(record, StillSettings(threshold_floors=QUIET_FLOORS)).stills, np.asarray(record.gyro)
    return tuple(s for s in found if rates[s.start : s.stop].std(axis=0).max() <= BENCH_RATE_LIMIT)


def moves_enough(records: Sequence[Record]) -> bool:
    """Return True if ``fit_in_motion`` accepts the recordings, apart from their gaps."""
    stretches = [stretch for record in records for stretch in without_gaps(record)]
    try:
        for stretch in stretches:
            _check(stretch, "motion")
        _check_turned([np.asarray(stretch.in_units("rad/s", "m/s2").gyro) for stretch in stretches])
    except (InputError, NotObservable):
        return False
    return True


def _check_turned(rates: Sequence[FloatArray]) -> None:
    """Raise unless the device is turned about several axes, at rates (N, 3), rad/s."""
    turned_dps = np.degrees(max(float(np.sqrt(rate.var(axis=0).sum())) for rate in rates))
    variances = np.linalg.eigvalsh(np.mean([np.cov(rate.T) for rate in rates], axis=0))
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


def _prior(parts: Sequence[_Part]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rows (E, P), values (E,) and standard deviations (E,) of the prior, starting with 21 rows for the elements.

    The prior of the device offset is zero. The prior of a part's offset is the device offset and its reading at rest.
    """
    count, rests = len(parts), [(k, *part.rest) for k, part in enumerate(parts) if part.rest is not None]
    eye = np.eye(24 + 3 * count)
    elements, device, offsets = eye[:21], eye[21:24], eye[24:].reshape(count, 3, -1)
    elements[:, :21] = TO_KINDS
    daily = (offsets - device).reshape(3 * count, -1)
    rows = np.vstack((elements, device, daily, *(offsets[k] for k, _, _ in rests)))
    value = np.concatenate((TO_KINDS @ NOMINAL, np.zeros(3 + 3 * count), *(mean for _, mean, _ in rests)))
    known = np.concatenate((np.ones(21), np.full(3, RAW_RATE), np.full(3 * count, DAILY)))
    return rows, value, np.concatenate((known, *(spread for _, _, spread in rests)))


def _result(
    records: Sequence[Record], parts: Sequence[_Part], x: FloatArray, covariance: FloatArray, contradiction: float
) -> InMotion:
    """Return the model in the units of the readings. Raise if it cannot describe a device in motion."""
    gyro, accel = x[:18].reshape(2, 3, 3)
    numbers_of = [[k for k, part in enumerate(parts) if part.recording == r] for r in range(len(records))]
    variances = [[np.exp(g.sizes[0]) for k in numbers for _, g, _ in parts[k].stretches] for numbers in numbers_of]
    acceleration = np.sqrt([np.mean(recording_variances) for recording_variances in variances])
    if (most := float(acceleration.max())) > NOT_GRAVITY:
        raise Implausible(
            f"motion, recording {int(acceleration.argmax()) + 1}: after the gyroscopes' rotation, "
            f"{most:.2g} m/s2 of acceleration remain in means over 5 s. Check sample rate, units and axes of both triads.",
            acceleration_m_s2=most,
        )
    offsets, spread = x[24:].reshape(-1, 3), np.sqrt(np.diag(covariance)[24:].reshape(-1, 3))
    residuals = np.concatenate([g.left for part in parts for _, g, _ in part.stretches])
    rates = np.concatenate([(part.rate - offset) @ gyro.T for part, offset in zip(parts, offsets, strict=True)])
    forces = np.concatenate([(part.force - x[18:21]) @ accel.T for part in parts])
    gyro_unit, accel_unit = records[0].gyro_unit, records[0].accel_unit
    turned = residuals[:, :2] / (STANDARD_GRAVITY * MEAN_S)
    findings = tuple(_findings(x, covariance, contradiction))
    fit = InMotion(
        gyro=_triad(turned, x, covariance, np.r_[:9, 21:24], rates, findings, units=(gyro_unit, "rad/s")),
        accel=_triad(residuals, x, covariance, np.r_[9:21], forces, findings, units=(accel_unit, "m/s2")),
        offsets=np.array([offsets[numbers].mean(axis=0) for numbers in numbers_of]),
        offset_uncertainty=np.array([spread[numbers].max(axis=0) for numbers in numbers_of]),
        acceleration=acceleration,
    )
    lengths = [np.median(np.linalg.norm(np.asarray(record.accel), axis=1)) for record in records]
    length, rate_hz = np.median(lengths) / STANDARD_GRAVITY, records[0].sample_rate_hz
    check_own_scale(fit.gyro.model.scale_factor, gyro_unit, "rate", "motion, gyroscope", sample_rate_hz=rate_hz)
    check_own_scale(length, accel_unit, "accel", "motion, accelerometer")
    return fit


def _triad(
    residuals: FloatArray,
    x: FloatArray,
    covariance: FloatArray,
    rows: FloatArray,
    corrected: FloatArray,
    findings: Sequence[Finding],
    units: tuple[str, str],
) -> TriadFit:
    """Return a triad whose matrix and offset are the elements ``rows`` (12,) of x, in the unit of the readings."""
    unit_in, unit_out = units
    factor = si_factor(unit_in, "rate" if unit_out == "rad/s" else "accel")
    scale = np.repeat((factor, 1.0 / factor), (9, 3))
    return triad_fit(
        residuals.ravel(),
        *findings,
        method="motion",
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=(scale * x[rows])[:9].reshape(3, 3),
        offset=(scale * x[rows])[9:],
        covariance=scale[:, None] * covariance[np.ix_(rows, rows)] * scale,
        rank=12,
        condition=float(np.linalg.cond(covariance[np.ix_(rows[:9], rows[:9])])) ** 0.5,
        valid_range=(float(corrected.min()), float(corrected.max())),
    )


ADVICE = {
    "gyroscope": "Add ten seconds for each axis: lay it level and turn the device about it by half a turn or more, to and fro.",
    "accelerometer": "Add ten seconds for each side: hold the device with each of these axes up, then down.",
}


def _findings(x: FloatArray, covariance: FloatArray, contradiction: float) -> Iterator[Finding]:
    """Yield findings about a rest that the motion contradicts, and about undetermined or implausible scale factors and offsets."""
    if contradiction > CONTRADICTED:
        yield finding(
            "motion.rest",
            "warn",
            f"The gyroscope offset changes from rest to motion by {contradiction:.1f} times the usual value. The rest counts less.",
            "Begin with 6 s in which the device is at rest, then turn it by hand about all axes.",
            contradiction=contradiction,
        )
    if (offset := float(np.abs(x[18:21]).max())) > OFFSET_LIMIT:
        yield finding(
            "motion.accel_offset",
            "warn",
            f"The accelerometer offset is {offset:.2g} m/s2 (data sheets of consumer parts allow {OFFSET_LIMIT:g} m/s2). The "
            "recording may contradict the equations, so other numbers may be wrong, too.",
            "Check sample rate, unit and axes in the map of the columns, and turn the device slowly about all axes.",
            offset_m_s2=offset,
        )
    for triad, first in (("gyroscope", 0), ("accelerometer", 9)):
        spread = np.sqrt(np.diag(covariance))[first + SCALES]
        if axes := tuple("xyz"[k] for k in np.flatnonzero(100.0 * spread > UNCERTAIN_PERCENT[0])):
            yield uncertain_scale(triad, axes, float(spread.max()), ADVICE[triad])
        if (deviation := float(np.abs(1.0 / x[first + SCALES] - 1.0).max())) > SCALE_LIMIT:
            yield finding(
                "motion.scale",
                "warn",
                f"The {triad} scale is {100.0 * deviation:.2g} % off its unit (data sheets allow 3 %).",
                "Check sample rate and unit in the map of the columns.",
            )
