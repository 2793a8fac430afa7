"""Gyroscope against an orientation reference: mocap, a robot arm, anything that gives poses of the same body.

w = M (u + c sign(u) - o) - m(t) d, with w the body rate of the reference. Rates are never differentiated from poses: readings
are integrated over windows and compared with how far the reference turned, so pose noise enters twice a window whatever the rate.
Windows grow from 2 s, where the linearisation is safe for a raw device, by doubling to 16 s: pose errors do not grow with the
window, the rotation that an error of M or o causes does. Recordings of one device are pooled. Long windows suit real optics, whose
errors drift with the pose. Offsets at rest and in motion differ (rounding, vibration, g-sensitivity: 0.01 to 0.05 deg/s), so a
recording's offset is its own mean at rest, and a change d that all recordings share, fitted with M, acts while the device turns,
m = 1: a new recording needs its own rest alone. Where it never rests, its offset is that of all recordings and a change of its own
with a prior.
Where the codes show how they were rounded, c is fitted about half a step, or none, within a third of a step. Each recording has a
small rotation R of its own between device and body, w = R M (u - o), whose mean over the recordings is none: markers are
put on anew, and clusters are defined anew. Where one mounting is stated it is the same for all. Motion that does not show the
matrix leaves it a prior about the rotation that the rates show, and the verdict names the elements that keep it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import undrift.sync as sync
from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.codes import restored_gyro
from undrift.calibration.plausibility import without_saturated
from undrift.calibration.reference_windows import (
    Recording,
    Solution,
    Windows,
    independent_windows,
    solve,
    window_equations,
)
from undrift.errors import AlignmentError, Implausible, InputError, NotObservable, check_choices
from undrift.findings import Finding, finding
from undrift.fit.triad import TriadFit, offset_of
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation_vector
from undrift.model import CODE_NAMES, MATRIX_NAMES, MOVING_NAMES, OFFSET_NAMES, AdcModel, TriadModel, Verdict
from undrift.record import Mounting, Record, Reference
from undrift.segments import StillSettings, find_still, find_turning, unpadded
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

# ---- settings and results


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceSettings:
    """How a device is fitted to a reference."""

    window_s: float = 2.0  # First window, s: the error of the raw readings over it must stay below about 0.5 rad
    # Last window, s. Longer weighs pose noise less and slow changes of the offset more
    longest_window_s: float = 16.0
    stride_s: float = 0.5  # From the start of one window to the next, s
    # d acts while the device turns, beside priors for it and for codes; False: from the first to the last rest
    turning: bool = True
    # "each": device and reference body are turned against each other anew in each recording. "one": by the matrix alone
    mounting: Mounting = "each"

    def __post_init__(self) -> None:
        check_choices(self, "reference")
        if not 0.0 < self.stride_s <= self.window_s <= self.longest_window_s:
            raise InputError(
                "reference: wanted 0 < stride_s <= window_s <= longest_window_s, got "
                f"{self.stride_s:g}, {self.window_s:g}, {self.longest_window_s:g} s"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReferenceFit:
    """A gyroscope fitted to references, pooled over recordings of one device."""

    # Model, residuals of the longest windows (rad, shape (n, 3)), verdict. The model's offset is the recordings' mean at rest
    # where it has a ``moving_offset``, else in motion
    triad: TriadFit
    # (3,), reading while the device turns less reading at rest, at zero rate, raw unit
    motion_offset: FloatArray
    rest_offsets: FloatArray  # (R, 3), mean reading at rest of each recording, raw unit; NaN where it never rests
    lags_s: FloatArray  # (R,), lag of each recording, s
    lag_uncertainties_s: FloatArray  # (R,), its standard uncertainty, s
    turn_rates_rms: FloatArray  # (R,), root-mean-square body rate of each recording in motion, rad/s
    window_s: float  # Length of the longest windows that the recordings were long enough for, s
    window_rms: float  # Robust standard deviation of the residual rotation of the longest windows, rad
    mountings: FloatArray  # (R, 3), rotation vector of each recording from the mean mounting to its own body, rad

    def model_at_rest_offset(self, rest_offset: FloatArray) -> TriadModel:
        """Return the model for a recording that reads ``rest_offset`` (3,), codes corrected, at rest."""
        model = self.triad.model
        if not np.isfinite(rest_offset).all():
            return model
        return replace(model, offset=rest_offset + self.motion_offset * (model.moving_offset is None))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """A recording evaluated by a fit to the others."""

    recording: int  # Its number
    fit: ReferenceFit  # Fit to all others
    # That fit with the held-out recording's own rest offset: nothing in it knows the held-out reference
    model: TriadModel
    # Root-mean-square rotation that remains over windows of ``window_s`` in the held-out recording, rad
    before: float  # with the rest offset alone
    after: float  # with the model
    extrapolation: Finding | None  # Where the held-out rates exceed what the others saw


# ---- recordings

_SHORT_BLOCK_S = 0.2  # whose means count as independent in a rest too short for blocks of a second
MARGIN_S = 0.5  # of rest that belongs to the motion on either side


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aligned:
    """A record and its reference on one clock."""

    record: Record
    gyro: FloatArray  # (N, 3), its readings, corrected for the ADC's rounding where it is known and not fitted
    reference: Reference  # Poses at the frames that the cameras took
    lag: sync.Lag  # Of the gyroscope readings against the poses
    span: sync.MotionSpan  # From the first to the last rest, on the record's clock
    findings: tuple[Finding, ...]  # What was done to bring both on one clock, or cannot be

    @property
    def at_rest(self) -> BoolArray:
        """True where there are readings of the rest before the motion, shape (N,)."""
        before = self.record.time < self.span.start_s - MARGIN_S
        return np.asarray(self.span.rested & before & np.isfinite(self.gyro).all(axis=1))

    def corrected(self, adc: AdcModel | None) -> "Aligned":
        """Return it with readings corrected for the half steps that the rounding took."""
        return replace(self, gyro=restored_gyro(self.gyro, adc))


def align(record: Record, reference: Reference, lag_settings: sync.LagSettings = sync.LagSettings()) -> Aligned:
    """Find lag and motion of one recording."""
    whole, record = record, unpadded(record)
    named = sync.padding(whole, record)
    record, saturated = without_saturated(record)
    record, lag, findings = sync.in_step(record, sync.native_poses(reference), lag_settings)
    poses = sync.seen_poses(record, sync.native_poses(reference), lag)
    span = sync.find_motion(record, poses, lag_s=lag.seconds)
    gyro = np.asarray(record.gyro)
    return Aligned(
        record=record, gyro=gyro, reference=poses, lag=lag, span=span, findings=(*named, *saturated, *findings)
    )


def recording_of(aligned: Aligned, settings: ReferenceSettings) -> Recording:
    """Return the rest of a recording, and its poses at the ends of windows."""
    record, gyro, time, motion = aligned.record, aligned.gyro, aligned.record.time, aligned.span
    poses, lag = aligned.reference, aligned.lag
    gap: BoolArray = np.asarray(np.isnan(gyro).any(axis=1))
    step = np.diff(time)
    late = np.concatenate(([False], step > sync.LONGEST_STEP * np.median(step)))
    rest, rest_uncertainty, rest_sign = rest_reading(aligned)
    turning: FloatArray = np.ones(len(time))
    if settings.turning and np.isfinite(rest).all():
        turning = find_turning((np.where(gap[:, None], np.nan, gyro) - rest) @ lag.matrix.T, time)[0]
    # Strapdown holds each reading over the step before its stamp: half a sample.
    at = poses.time + (lag.seconds - 0.5 * float(np.median(step)))
    inside = (at >= max(motion.start_s - MARGIN_S, time[0])) & (at <= min(motion.stop_s + MARGIN_S, time[-1]))
    chosen = np.flatnonzero(inside)[:: max(1, round(settings.stride_s * poses.sample_rate_hz))]
    return Recording(
        time=time,
        gyro=np.where(gap[:, None], 0.0, gyro),
        gaps=np.cumsum(gap | late),
        lag=lag,
        moving=(time >= motion.start_s) & (time < motion.stop_s),
        turning=turning,
        rest_offset=rest,
        rest_sign=rest_sign,
        rest_uncertainty=rest_uncertainty,
        unit=record.gyro_unit,
        at=np.ascontiguousarray(at[chosen]),
        q_nb=np.ascontiguousarray(poses.q_nb[chosen]),
        findings=aligned.findings,
    )


def rest_reading(aligned: Aligned) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean reading at rest (3,), NaN where a recording never rests, its standard uncertainty and the mean sign."""
    time, at_rest, block_s = aligned.record.time, aligned.at_rest, 1.0
    if not aligned.span.rested:  # a short rest shows the offset, if not the tilt
        at_rest, block_s = np.zeros(len(time), bool), _SHORT_BLOCK_S
        for still in find_still(aligned.record, StillSettings()).stills[:1]:
            at_rest[still.start : still.stop] = np.isfinite(aligned.gyro[still.start : still.stop]).all(axis=1)
        if not at_rest.any():
            return np.full(3, np.nan), np.zeros(3), np.zeros(3)
    readings, second = aligned.gyro[at_rest], np.floor((time[at_rest] - time[0]) / block_s).astype(np.int64)
    if len(readings) < 2 or second[-1] == second[0]:
        raise InputError(
            "reference: wanted two seconds of rest readings before the motion, got fewer; record a rest first"
        )
    blocks = np.flatnonzero(np.concatenate(([True], np.diff(second) > 0)))
    means = np.add.reduceat(readings, blocks) / np.diff(np.append(blocks, len(readings)))[:, None]
    return readings.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(means)), np.sign(readings).mean(axis=0)


# ---- fit

# Rates about the second and the third axis of turning, rms, as a share of those about the first: less does not show the mounting,
# or the matrix
_SECOND_AXIS, _THIRD_AXIS = 0.03, 0.1
_REFINEMENTS = 2  # passes at the longest window
# Where the motion does not show the matrix: each element of it about the rotation that the rates show, relative (data sheets of
# consumer parts: scale factor 1 to 3 %, cross-axis sensitivity 1 to 2 %), and a mounting of its own, rad. A device is raw [assumed]
MATRIX_PRIOR, MOUNTING_PRIOR = 0.03, 0.05
_SHOWN = 1.0 / 3.0  # of the prior: a fit that states more is made again with it
TURN_ON = 0.1 * RADIAN_PER_DEGREE  # rad/s, turn-on repeatability of the offset, of recordings without a rest [assumed]
# rad/s: d of a device, for what rounding, vibration and g-sensitivity do (0.01 to 0.05 deg/s). c, as a share of a code step, about
# half a step where codes were cut off toward zero and none else: 24 trials of four devices show -0.3 to 0.8 of a step
MOVING_PRIOR, CODE_PRIOR = 0.05 * RADIAN_PER_DEGREE, 1.0 / 3.0
_MOUNTING = 0.05  # matrices of single recordings may differ by this share before their mounting is taken to differ


def fit_reference(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: ReferenceSettings = ReferenceSettings(),
    adc: AdcModel | None = None,
    lag_settings: sync.LagSettings = sync.LagSettings(),
) -> ReferenceFit:
    """Fit matrix, offset while it turns and what codes lose of a gyroscope to references."""
    return fit_aligned(align_all(records, references, lag_settings), settings, adc)


def fit_aligned(aligned: Sequence[Aligned], settings: ReferenceSettings, adc: AdcModel | None = None) -> ReferenceFit:
    """Fit the gyroscopes of one device to recordings whose lag and motion are known."""
    prepared = [recording_of(one, settings) for one in aligned]
    try:
        return _fit(prepared, settings, aligned[0].record.gyro_unit, adc)
    except NotObservable as error:
        saturated = [item.text for one in prepared for item in one.findings if item.code == "reference.saturated"]
        if not saturated:
            raise
        raise NotObservable("; ".join((str(error), *saturated)), **error.numbers) from error


def leave_one_out(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: ReferenceSettings = ReferenceSettings(),
    adc: AdcModel | None = None,
    lag_settings: sync.LagSettings = sync.LagSettings(),
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> tuple[HeldOut, ...]:
    """Fit each recording's model to all others of the device, and evaluate it there; progress takes what is done, and 0 to 1."""
    if len(records) < 2:
        raise InputError(
            f"leave one out: wanted two recordings of a device or more, got {len(records)}; add recordings"
        )
    unit, trials = records[0].gyro_unit, list[HeldOut]()
    prepared = [recording_of(one, settings) for one in align_all(records, references, lag_settings)]
    for i in range(len(records)):
        progress(f"fit without recording {i + 1} of {len(records)}", i / len(records))
        fit = _fit([*prepared[:i], *prepared[i + 1 :]], settings, unit, adc)
        trials.append(_held_out(i, prepared[i], fit, settings))
    return tuple(trials)


def align_all(
    records: Sequence[Record], references: Sequence[Reference], lag_settings: sync.LagSettings
) -> list[Aligned]:
    """Find lag and motion of the recordings of one device."""
    if not records or len(records) != len(references):
        raise InputError(
            f"reference: wanted one reference for each record, got {len(records)} records and {len(references)} references"
        )
    units = sorted({r.gyro_unit for r in records})
    if len(units) > 1:
        raise InputError(
            f"reference: wanted one unit for all recordings of a device, got {', '.join(units)}; convert them"
        )
    return [align(*pair, lag_settings) for pair in zip(records, references, strict=True)]


def _fit(
    prepared: Sequence[Recording], settings: ReferenceSettings, unit: str, adc: AdcModel | None = None
) -> ReferenceFit:
    """Fit a device; where the motion does not show the matrix, with a prior for it."""
    if not is_physical(unit):
        return _fitted(_Estimate(prepared, settings, adc), unit)
    factor, fit = si_factor(unit, "rate"), None
    try:
        fit = _fitted(_Estimate(prepared, settings, adc), unit)
        if fit.triad.model.standard_uncertainty[:9].max() < _SHOWN * MATRIX_PRIOR * factor:
            return fit
    except (NotObservable, AlignmentError, Implausible) as error:
        turned, weakest = _rotations(prepared)
        if turned is None or weakest > _THIRD_AXIS or "windows" in error.numbers:
            raise
    turned, _ = _rotations(prepared)
    if turned is not None:
        return _with_prior(_fitted(_Estimate(prepared, settings, adc, turned * factor), unit), turned[0])
    if fit is None or fit.triad.model.standard_uncertainty[:9].max() > MATRIX_PRIOR * factor:
        raise NotObservable(
            "reference: wanted turning about two axes or more, got one; turn the device about another axis"
        )
    return fit


def _rotations(prepared: Sequence[Recording]) -> tuple[FloatArray | None, float]:
    """Return rotations (Kabsch) from readings to bodies, (R, 3, 3), None where one turns about one axis; the third's share."""
    turned, weakest = np.empty((len(prepared), 3, 3)), 1.0
    for k, p in enumerate(prepared):
        turn = rotation_vector(quaternion_product(quaternion_conjugate(p.q_nb[:-1]), p.q_nb[1:]))
        u, inside = sync.RunningIntegral(p.time, p.gyro).mean(p.at[:-1], p.at[1:])
        inside &= np.isfinite(turn).all(axis=1)
        if not inside.any():
            return None, 0.0
        u, w = u[inside], turn[inside] / np.diff(p.at)[inside, None]
        left, singular, right = np.linalg.svd((w - w.mean(axis=0)).T @ (u - u.mean(axis=0)))
        if not singular[1] > _SECOND_AXIS**2 * singular[0]:
            return None, 0.0
        turned[k] = left @ np.diag((1.0, 1.0, np.sign(np.linalg.det(left @ right)))) @ right
        weakest = min(weakest, float(np.sqrt(singular[2] / singular[0])))
    return turned, weakest


class _Estimate:
    """M, d and c; turns of all recordings but the last; a change of the offset of each one without a rest, about the others'."""

    def __init__(
        self,
        prepared: Sequence[Recording],
        settings: ReferenceSettings,
        adc: AdcModel | None,
        nominal: FloatArray | None = None,
    ) -> None:
        """``nominal`` (R, 3, 3) are the matrices that a prior expects, rad/s per unit; None leaves the matrix free."""
        self.prepared, self.settings, self.nominal = prepared, settings, nominal
        rests = [p.rest_offset for p in prepared if p.rested]
        usual = np.mean(rests, axis=0) if rests else np.zeros(3)
        self.offsets = [p.rest_offset if p.rested and rests else usual for p in prepared]
        self.unrested = [i for i, p in enumerate(prepared) if len(prepared) > 1 and not p.rested]
        if nominal is None:
            self.mounted = _first_mountings(prepared, settings)
            self.guess = _first_guess(prepared, self.mounted, self.offsets, settings)
        else:
            size = float(np.linalg.norm(nominal[0], 2))
            each = nominal @ nominal[0].T / size**2
            self.mounted = each if settings.mounting == "each" else np.tile(np.eye(3), (len(prepared), 1, 1))
            self.guess = np.append(nominal[0].reshape(-1), np.zeros(6))
        self.turning = len(prepared) if settings.mounting == "each" else 1
        self.size, self.turns = len(self.guess), np.zeros(3 * (self.turning - 1))
        self.changes = np.zeros((len(self.unrested), 3))  # rad/s
        self.free = np.arange(self.size + len(self.turns) + self.changes.size)
        self.apart = bool(rests) and settings.turning  # d is a change from rest to motion
        step = None if adc is None else adc.gyro_lsb
        self.codes = np.zeros(3) if step is None or adc is None else 0.5 * step * (adc.gyro_rounding == "toward_zero")
        self.guess[12:15], self.code_sd = self.codes, np.zeros(3) if step is None else CODE_PRIOR * step
        fixed = [12, 13, 14] if step is None or not settings.turning else []
        self.free = np.setdiff1d(self.free, fixed)

    def equations(self, reach: int) -> list[Windows]:
        """Return the equations of all recordings at the present values."""
        made = list[Windows]()
        for i, (p, mounted, offset) in enumerate(zip(self.prepared, self.mounted, self.offsets, strict=True)):
            here, change = self.guess.copy(), self.unrested.index(i) if i in self.unrested else None
            if change is not None:
                here[9:12] += self.changes[change]
            windows = _of_device(p, here, mounted, offset, reach, (i, self.turning))
            columns = np.zeros((*windows.turn.shape, self.changes.size))
            if change is not None:
                columns[..., 3 * change : 3 * change + 3] = windows.design[..., 9:12]
            made.append(replace(windows, design=np.concatenate((windows.design, columns), axis=2)))
        return made

    def prior(self) -> tuple[FloatArray, FloatArray] | None:
        """Return how far each parameter is below what is expected, and the standard deviation of that; None without any."""
        if self.nominal is None and not (self.unrested or self.apart or 12 in self.free):
            return None
        most, last = self.size + len(self.turns), self.size
        away, spread = np.zeros(most + self.changes.size), np.full(most + self.changes.size, np.inf)
        away[most:], spread[most:] = -self.changes.reshape(-1), TURN_ON
        if 12 in self.free:
            away[12:15], spread[12:15] = self.codes - self.guess[12:15], self.code_sd
        if self.apart:
            away[9:12], spread[9:12] = -self.guess[9:12], MOVING_PRIOR
        if self.nominal is not None:
            away[:9] = self.nominal[0].reshape(-1) - self.guess[:9]
            spread[:9] = MATRIX_PRIOR * float(np.linalg.norm(self.nominal[0], 2))
            away[last:most], spread[last:most] = -self.turns, MOUNTING_PRIOR
        return away, spread

    def step(self, found: Solution) -> None:
        """Move by one solution."""
        moved = np.zeros(self.size + len(self.turns) + self.changes.size)
        moved[self.free] = found.step
        self.guess += moved[: self.size]
        turns = moved[self.size : self.size + len(self.turns)]
        self.turns += turns
        self.changes += moved[self.size + len(turns) :].reshape(-1, 3)
        turns = turns.reshape(-1, 3)
        for i, turn in enumerate((*turns, -turns.sum(axis=0)) if len(turns) else ()):
            self.mounted[i] = rotate(quaternion_of(turn), self.mounted[i].T).T


def _fitted(estimate: _Estimate, unit: str) -> ReferenceFit:
    """Fit by windows that grow."""
    prepared, settings, free = estimate.prepared, estimate.settings, estimate.free
    solution, used = None, settings.window_s
    for length in _lengths(settings):
        reach = max(1, round(length / settings.stride_s))
        windows = estimate.equations(reach)
        prior = estimate.prior()
        unknowns = len(free) if prior is None else np.isinf(prior[1][free]).sum()
        if solution is not None and independent_windows(windows, reach) <= unknowns / 3.0:
            break  # too short for longer windows: stay with the last ones
        solution, used = solve(prepared, windows, free=free, reach=reach, prior=prior), length
        estimate.step(solution)
    determinant = np.linalg.det(estimate.guess[:9].reshape(3, 3))
    if solution is None or determinant <= 0.0:
        raise Implausible(
            f"reference: wanted a right-handed matrix, got a determinant of {determinant:.3g}; "
            "one axis of the readings or of the reference is reversed"
        )
    return _result(estimate, unit, solution, used)


def _with_prior(fit: ReferenceFit, turned: FloatArray) -> ReferenceFit:
    """Name the elements that keep their prior, in the device's axes: those of R^T M."""
    model = fit.triad.model
    back = np.kron(turned.T, np.eye(3)) / si_factor(model.unit_in, "rate")
    spread = np.sqrt(np.diag(back @ model.covariance[:9, :9] @ back.T))
    unseen = [k for k, one in enumerate(spread) if one > 0.5 * MATRIX_PRIOR]
    if not unseen:
        return fit
    axes = sorted({"xyz"[k % 3] for k in unseen})
    named = finding(
        "reference.prior", "warn", elements=[MATRIX_NAMES[k] for k in unseen], axes=axes, percent=100.0 * MATRIX_PRIOR
    )
    return replace(fit, triad=replace(fit.triad, verdict=fit.triad.verdict.also(Verdict.of(named))))


def _of_device(
    recording: Recording, guess: FloatArray, mounted: FloatArray, offset: FloatArray, reach: int, place: tuple[int, int]
) -> Windows:
    """Return a recording's equations in the device's parameters and, after them, in the turns of all recordings but the last.

    ``place`` is the number of the recording, and how many there are that turn; the last turns back what the others do.
    """
    (number, count), size = place, len(guess)
    to_body = np.stack([_turned(unit, mounted) for unit in np.eye(size)], axis=1)
    windows = window_equations(recording, to_body @ guess, offset, reach)
    if count < 2:
        return replace(windows, design=windows.design @ to_body)
    cross = [np.cross(axis, np.eye(3)).T for axis in np.eye(3)]
    turns = np.stack([_turned(to_body @ guess, each) for each in cross], axis=1)  # (P, 3): by a rotation of the body
    turns[12:15] = 0.0
    columns = np.zeros((size, size + 3 * (count - 1)))
    columns[:, :size] = to_body
    if number < count - 1:
        columns[:, size + 3 * number : size + 3 * number + 3] = turns
    else:
        columns[:, size:] = np.tile(-turns, count - 1)
    return replace(windows, design=windows.design @ columns)


def _turned(parameters: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return M, d and c, one after the other, turned by a matrix (3, 3); c belongs to the sensors."""
    matrix, moving, codes = np.split(parameters, (9, 12))
    return np.concatenate(((rotation @ matrix.reshape(3, 3)).reshape(-1), rotation @ moving, codes))


def _lengths(settings: ReferenceSettings) -> list[float]:
    lengths = [settings.window_s]
    while lengths[-1] < settings.longest_window_s:
        lengths.append(min(2.0 * lengths[-1], settings.longest_window_s))
    return lengths + [lengths[-1]] * _REFINEMENTS


def _first_mountings(prepared: Sequence[Recording], settings: ReferenceSettings) -> FloatArray:
    """Return the rotation from the first recording's body to each one's, (R, 3, 3), where single fits show one; else none."""
    none = np.tile(np.eye(3), (len(prepared), 1, 1))
    matrices = np.array([p.lag.matrix for p in prepared])
    if settings.mounting == "one" or _shared_matrix(prepared, matrices)[1] <= _MOUNTING:
        return none
    left, _, right = np.linalg.svd(matrices @ np.linalg.pinv(matrices[0]))
    turned = left @ right
    return turned if (np.linalg.det(turned) > 0.0).all() else none


def _shared_matrix(prepared: Sequence[Recording], matrices: FloatArray) -> tuple[FloatArray, float]:
    """Return the matrix (3, 3) of all recordings from those of each (R, 3, 3), and the largest relative difference from it.

    A recording weighs by its turns W, the covariance of its rates: M = sum(M_r W_r) (sum W_r)^-1. Its difference is that of the
    corrected rates, |(M_r - M) W_r^(1/2)| / |M W_r^(1/2)|, so that elements which it does not determine count for nothing.
    """
    turns = np.array([np.cov(p.gyro[p.moving].T) for p in prepared])
    shared = np.asarray((matrices @ turns).sum(axis=0) @ np.linalg.pinv(turns.sum(axis=0)))
    away, whole = (
        np.trace(m @ turns @ np.swapaxes(m, -1, -2), axis1=-2, axis2=-1) for m in (matrices - shared, shared)
    )
    return shared, float(np.sqrt((away / whole).max()))


def _first_guess(
    prepared: Sequence[Recording], mounted: FloatArray, offsets: Sequence[FloatArray], settings: ReferenceSettings
) -> FloatArray:
    # The lag search has fitted rate = A u + c for every recording; no errors-in-variables care is needed for a start.
    back = np.swapaxes(mounted, 1, 2)
    matrices = back @ np.array([p.lag.matrix for p in prepared])
    matrix, worst = _shared_matrix(prepared, matrices)
    if worst > _MOUNTING:
        raise AlignmentError(
            f"reference: wanted one {'mounting' if settings.mounting == 'one' else 'device'} for all recordings, got matrices that "
            f"differ by {worst:.0%}{'' if settings.mounting == 'one' else ' apart from a rotation'}; fit recordings with other "
            "marker clusters (`mounting` one) or other sensors apart",
            difference=worst,
        )
    constants = [-r @ p.lag.constant - matrix @ o for p, r, o in zip(prepared, back, offsets, strict=True)]
    return np.concatenate((matrix.reshape(-1), np.mean(constants, axis=0), np.zeros(3)))


def _result(estimate: _Estimate, unit: str, solution: Solution, window_s: float) -> ReferenceFit:
    from scipy.spatial.transform import Rotation

    prepared, guess = estimate.prepared, estimate.guess
    free = estimate.free[estimate.free < estimate.size]
    matrix, moving, codes = guess[:9].reshape(3, 3), guess[9:12], guess[12:]
    rest = np.array([p.rest_offset for p in prepared])
    rested = np.isfinite(rest).all(axis=1)
    signs = np.array([p.rest_sign for p in prepared])[rested].mean(axis=0) if rested.any() else np.zeros(3)
    base = rest[rested].mean(axis=0) + signs * codes if rested.any() else np.zeros(3)
    apart, coded = estimate.apart, bool(estimate.code_sd.any())
    # From (M, d, c) to (M, o, d, c), the last two where the model has them
    motion_offset, to_offset = offset_of(matrix, moving, len(guess))
    to_offset[9:12, : 12 * apart] = 0.0
    to_offset[9:12, 12:15] = np.diag(signs)
    unit_rows = np.eye(len(guess))
    jacobian = np.vstack((to_offset[:12], unit_rows[9 : 9 + 3 * apart], unit_rows[12 : 12 + 3 * coded]))
    covariance = np.zeros((len(guess), len(guess)))
    covariance[np.ix_(free, free)] = solution.covariance()[: len(free), : len(free)]
    covariance = jacobian @ covariance @ jacobian.T
    if rested.any():  # what the mean at rest is off by, d takes back
        spread = np.sqrt((np.array([p.rest_uncertainty for p in prepared]) ** 2).sum(axis=0)) / rested.sum()
        shift = np.zeros((len(covariance), 3))
        shift[9:12] = np.eye(3)
        shift[12 : 12 + 3 * apart] = -matrix[: 3 * apart]
        covariance += (shift * spread**2) @ shift.T
    seen = [(p.gyro[p.moving] - base - motion_offset) @ matrix.T for p in prepared]
    model = TriadModel(
        method="reference/motion",
        unit_in=unit,
        unit_out="rad/s",
        matrix=matrix,
        offset=base if apart else base + motion_offset,
        parameters=(
            *(*MATRIX_NAMES, *OFFSET_NAMES),
            *(*(MOVING_NAMES if apart else ()), *(CODE_NAMES if coded else ())),
        ),
        covariance=covariance,
        rms_residual=float(np.sqrt((solution.residuals**2).mean())) / window_s,
        count=solution.residuals.size,
        rank=len(free),
        condition=solution.condition,
        valid_range=(min(float(w.min()) for w in seen), max(float(w.max()) for w in seen)),
        moving_offset=moving if apart else None,
        code_offset=codes if coded else None,
    )
    verdict = Verdict.of(*_judged(model, rest[rested]), *(one for p in prepared for one in p.findings))
    return ReferenceFit(
        triad=TriadFit(model=model, residuals=solution.residuals, verdict=verdict),
        motion_offset=motion_offset,
        rest_offsets=rest,
        lags_s=np.array([p.lag.seconds for p in prepared]),
        lag_uncertainties_s=np.array([p.lag.standard_uncertainty for p in prepared]),
        turn_rates_rms=np.array([np.sqrt((w**2).sum(axis=1).mean()) for w in seen]),
        window_s=window_s,
        window_rms=solution.scale,
        mountings=Rotation.from_matrix(estimate.mounted).as_rotvec(),
    )


def _judged(model: TriadModel, rest: FloatArray) -> Iterator[Finding]:
    sigma, scale = model.standard_uncertainty, float(np.linalg.norm(model.matrix, 2))
    uncertain = float(sigma[:9].max()) / scale
    if uncertain > 2e-3:
        yield finding("reference.uncertainty", "warn", uncertainty_percent=100.0 * uncertain)
    if len(rest) > 1:
        spread_dps = np.degrees(rest.std(axis=0, ddof=1).max() * scale)
        if spread_dps > 0.03:
            yield finding("reference.rest_offset", "warn", spread_dps=spread_dps)


def _left(
    recording: Recording, model: TriadModel, turn: FloatArray, window_s: float, settings: ReferenceSettings
) -> float:
    """Return the rms rotation that a model leaves over the windows of a recording, rad; ``turn`` leads from the model's body."""
    moving, codes = (np.zeros(3) if part is None else part for part in (model.moving_offset, model.code_offset))
    parameters = _turned(np.concatenate((model.matrix.reshape(-1), moving, codes)), turn)
    offset = model.offset - recording.rest_sign * codes
    windows = window_equations(recording, parameters, offset, max(1, round(window_s / settings.stride_s)))
    return float(np.sqrt((windows.turn**2).sum(axis=1).mean()))


def _held_out(
    number: int,
    recording: Recording,
    fit: ReferenceFit,
    settings: ReferenceSettings,
) -> HeldOut:
    codes = fit.triad.model.code_offset
    model = fit.model_at_rest_offset(recording.rest_offset if codes is None else recording.zero(codes))
    rest = np.nan_to_num(recording.rest_offset)
    plain = replace(model, matrix=_rigid(model.matrix), offset=rest, moving_offset=None, code_offset=None)
    before, after = (_left(recording, one, np.eye(3), settings.window_s, settings) for one in (plain, model))
    rate = np.abs((recording.gyro[recording.moving] - model.offset) @ model.matrix.T)
    limit = max(abs(model.valid_range[0]), abs(model.valid_range[1]))
    beyond = float((rate > limit).any(axis=1).mean())
    rms = float(np.sqrt((rate**2).sum(axis=1).mean()))
    most = float(fit.turn_rates_rms.max())
    extrapolation = None
    if beyond > 0.0 or rms > 1.5 * most:
        names = ("most_dps", "rms_dps", "seen_dps", "seen_rms_dps")
        rates = zip(names, np.degrees((rate.max(), rms, limit, most)), strict=True)
        extrapolation = finding("validate.extrapolated", "warn", **dict(rates))
    return HeldOut(
        recording=number,
        fit=fit,
        model=model,
        before=before,
        after=after,
        extrapolation=extrapolation,
    )


def _rigid(matrix: FloatArray) -> FloatArray:
    # The nearest rotation times the nominal scale: a raw device in that mounting before any calibration.
    left, singular, right = np.linalg.svd(matrix)
    scale = float(np.exp(np.log(singular).mean()))
    nominal = 1.0 if 0.5 < scale < 2.0 else scale
    return np.asarray(nominal * left @ right)
