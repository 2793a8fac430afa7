"""Calibration without equipment: hold the device still in many poses, turn it by hand between them (Tedaldi et al., ICRA 2014).

    |M_a (u_k - o_a)| = g                over k = 1 .. K still poses; u_k mean raw reading, M_a upper triangular
    C(M_g, o_g) n_before = n_after       gyroscopes, over the moves between     calibration/multi_position_gyro.py

A common rotation of all readings keeps their length, so three of twelve parameters are a choice of axes: the sensor's z axis is the
case's, its y axis lies in the case's y-z plane. A still is where the sliding variance of the accelerometer is below a multiple of
that at rest. Of several multiples, rule ``coverage`` takes, among those that keep nine tenths of the different poses, the one that
leaves a corrected reading least uncertain: a low threshold loses poses, a high one lets motion in. Rule ``published`` takes the
smallest summed cost over the first second of each still, which may keep few poses.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.adc import code_steps, code_variance
from undrift.calibration.checks import check_gravity, check_own_scale, check_range
from undrift.calibration.creep import Creep, Kind, creep_of
from undrift.calibration.multi_position_gyro import fit_gyro_between_stills
from undrift.calibration.norm_equations import CROSS, NAMES, PART, WEAKEST, NormFit, fit_norm
from undrift.calibration.observe import Observed, Outcome
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.findings import Finding, finding
from undrift.fit.least_squares import TriadFit, parameter_names, triad_fit
from undrift.model import AXES, TriadModel, Verdict, level_of
from undrift.record import Record, Still
from undrift.segments import runs
from undrift.units import STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

# ---- accelerometer from free poses

SEEN = np.array([0, 1, 2, 4, 5, 8, 9, 10, 11])  # of m_xx .. m_zz, offset_x ..: those that the length of gravity shows
TOLERANCE = 0.25  # of the sensitivity that the unit states; raw parts are within 0.2
MG = STANDARD_GRAVITY * 1e-3
RESIDUAL_MG = (3.0, 20.0)  # limits of a verdict: marginal above the first, bad above the second
UNCERTAIN_MG = (2.0, 20.0)
FEWEST_POSES = 7  # with a prior on cross-axis terms: scale, offset, and one pose to check them


def check_count(reading: FloatArray, parameters: int, *, known_noise: bool) -> None:
    """Raise unless there are enough different poses."""
    wanted = parameters + (not known_noise)
    names = parameter_names(NAMES if parameters == 9 else [NAMES[i] for i in (0, 3, 5, 6, 7, 8)])
    different = len(np.unique(reading, axis=0))
    if different < wanted:
        raise NotObservable(
            f"multi-position: wanted {wanted} still poses or more for {names}, got {different}; record more poses, "
            "each with another side, edge or corner up, and hold each still for two seconds",
            poses=different,
            wanted=wanted,
        )


def judged(fit: NormFit, reading: FloatArray, unit_in: str) -> TriadFit:
    """Return a solution as a fit with verdict, or refuse it where the poses leave a parameter unobserved."""
    unit = canonical_unit(unit_in, "accel")
    if is_physical(unit):
        check_gravity(reading * si_factor(unit, "accel"), fit.gravity)
    corrected = fit.corrected(reading)
    if fit.weakest < WEAKEST:
        raise NotObservable(
            f"multi-position: wanted poses that change the length by {WEAKEST:g} g or more per unit of every parameter, got "
            f"{fit.weakest:.2g} for {parameter_names(fit.unseen)}; {_advice(corrected, fit.unseen)}",
            weakest=fit.weakest,
            parameters=fit.unseen,
        )
    carry = np.zeros((12, 9))  # d (m_xx .. m_zz, offset) / d p
    carry[SEEN, np.arange(9)] = [fit.scale] * 6 + [1.0 / fit.scale] * 3
    rms_mg = float(np.sqrt(np.mean(fit.residuals**2))) / MG
    made = triad_fit(
        fit.residuals,
        Verdict.of(*_judged(fit, rms_mg, corrected)),
        method="multi-position",
        unit_in=unit,
        unit_out="m/s2",
        matrix=fit.matrix,
        offset=fit.offset,
        covariance=carry @ fit.covariance @ carry.T,
        rank=int((np.diag(fit.covariance) > 0.0).sum()) - len(fit.prior),
        condition=fit.condition,
        valid_range=(float(corrected.min()), float(corrected.max())),
    )
    check_own_scale(made.model.scale_factor, unit, "accel", TOLERANCE, "accel")
    return made


def _judged(fit: NormFit, rms_mg: float, corrected: FloatArray) -> Iterator[Finding]:
    sigma, wanted = fit.uncertainty / MG, UNCERTAIN_MG[0]
    off = finding("multi_position.residual", level_of(rms_mg, RESIDUAL_MG), rms_mg=rms_mg, wanted=RESIDUAL_MG[0])
    unsure = finding("multi_position.uncertainty", level_of(sigma, UNCERTAIN_MG), uncertainty_mg=sigma, wanted=wanted)
    yield from (item for item in (off, unsure) if item.level != "info")
    if not np.triu(fit.matrix, 1).any():
        yield finding("multi_position.cross_axis_fixed", "info")
    if len(fit.prior):
        part = np.linalg.norm(fit.prior, axis=0)
        unseen = tuple(NAMES[i] for i in CROSS if part[i] > PART)
        after = 100.0 * np.sqrt(np.diag(fit.covariance)[[NAMES.index(name) for name in unseen]])
        yield finding(
            "multi_position.cross_axis_prior",
            "warn",
            terms=parameter_names(unseen),
            prior_percent=100.0 * fit.prior_sd,
            uncertainty_percent=after,
            advice=_advice(corrected, unseen),
        )


def _advice(corrected: FloatArray, unseen: tuple[str, ...]) -> str:
    n = corrected / np.linalg.norm(corrected, axis=1)[:, None]
    values, vectors = np.linalg.eigh(n.T @ n / len(n))
    if values[0] < 0.02:
        axis = AXES[int(np.abs(vectors[:, 0]).argmax())]
        return f"all poses lie near one plane: add poses with the {axis} axis up and with it down"
    if set(unseen) <= {"m_xy", "m_xz", "m_yz"}:
        return "add poses between the faces (edges and corners up)"
    return "add poses on the sides, edges and corners that are missing"


# ---- stills: where the sliding variance of the accelerometer is below a threshold
#
#     s2_k = |(var u_x, var u_y, var u_z)| over the window centred at k        sample variances, raw unit squared
#
# A turn about the vertical does not show in an accelerometer: where there are gyroscopes, a still is reduced to its core, in which
# their variance is as low as in most of the stills. Running sums make mean and variance of any stretch cost the same.

QUIETEST = 0.05  # share of all windows that gives the level at rest
CORE = 4.0  # variance of the gyroscopes in the core of a still, in units of their median variance in all stills


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StillVariance:
    """Windowed variance of one record."""

    values: FloatArray  # (N, 3), readings, raw unit
    level: FloatArray  # (N,), s2, raw unit squared; infinite at the ends and next to gaps
    gyro_level: FloatArray | None  # (N,), the same of the gyroscopes, their unit squared; None without gyroscopes
    at_rest: float  # Value of ``level`` at rest, raw unit squared
    sums: FloatArray  # (2, N + 1, 3), running sums of the readings less ``centre``, and of their squares
    centre: FloatArray  # (3,), raw unit
    step: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,), of the codes, raw unit; 0 or NaN for none

    def below(self, threshold: float, least: int) -> list[tuple[int, int]]:
        """Return the stretches [start, stop) below a threshold."""
        found = runs(self.level < threshold)
        return [(int(a), int(b)) for a, b in found[found[:, 1] - found[:, 0] >= least]]


def still_variance(record: Record, *, window_s: float, rest_s: float | None) -> StillVariance:
    """Return the windowed variance of a record's accelerometer and its level at rest."""
    if record.accel is None:
        raise InputError("still variance: wanted accel readings, got none; map the accelerometer columns")
    half = max(5, round(0.5 * window_s * record.sample_rate_hz))
    if len(record) < 2 * half + 2 or (rest_s is not None and record.duration_s < rest_s):
        raise InputError(
            f"still variance: wanted a record longer than its window of {window_s:g} s"
            + ("" if rest_s is None else f" and its opening rest of {rest_s:g} s")
            + f", got {record.duration_s:.2f} s; shorten them"
        )
    level, sums, centre = _windowed(record.accel, half)
    if rest_s is None:
        finite = level[np.isfinite(level)]
        at_rest = float(np.quantile(finite, QUIETEST)) if len(finite) else np.inf
    else:
        rest = int(np.searchsorted(record.time, record.time[0] + rest_s))
        at_rest = float(np.linalg.norm(np.nanvar(record.accel[:rest], axis=0, ddof=1)))
    gyro_level = None if record.gyro is None else _windowed(record.gyro, half)[0]
    return StillVariance(
        values=record.accel, level=level, gyro_level=gyro_level, at_rest=at_rest, sums=sums, centre=centre
    )


def _windowed(values: FloatArray, half: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the level over windows of 2 half + 1 samples, running sums of first and second powers, and their centre."""
    width = 2 * half + 1
    gap: BoolArray = np.asarray(np.isnan(values).any(axis=1))
    centre = values[~gap].mean(axis=0) if not gap.all() else np.zeros(3)
    u, sums = np.where(gap[:, None], 0.0, values - centre), np.zeros((2, len(values) + 1, 3))
    np.cumsum((u, u * u), axis=1, out=sums[:, 1:])
    s, q = sums[:, width:] - sums[:, :-width]
    lost = np.concatenate(([0], np.cumsum(gap)))
    level = np.full(len(u), np.inf)
    level[half:-half] = np.linalg.norm((q - s * s / width) / (width - 1), axis=1)
    level[half:-half][lost[width:] > lost[:-width]] = np.inf
    return level, sums, centre


# ---- the whole method

SAME_POSE_DEG = 10.0  # directions nearer to each other than this count as one pose
Rule = Literal["coverage", "published"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiPositionSettings:
    """How stills are found and what is fitted."""

    window_s: float = 1.0  # Length of the sliding window, s; each end of a still loses half of it
    min_still_s: float = 1.0  # Shortest still, s, after that loss
    # Thresholds to try, in units of the level at rest
    multiples: tuple[float, ...] = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 15.0, 20.0, 30.0, 50.0)
    # Length of an opening rest that gives the level at rest, s; None takes the quietest twentieth of all windows
    rest_s: float | None = None
    rule: Rule = "coverage"  # coverage or published: how the threshold is chosen, and how poses and turns weigh
    cross_axis: bool = True  # False fits the accelerometer's scale and offset alone: for poses on the faces
    # Standard deviation of a cross-axis term that the poses do not show, of the scale; None refuses such poses
    cross_axis_prior: float | None = 0.01
    gyro: bool = True  # Fit the gyroscopes too, where the moves show them

    @classmethod
    def published(cls, rest_s: float = 50.0) -> "MultiPositionSettings":
        """Return the settings of the published demonstration."""
        multiples = tuple(float(m) for m in range(2, 11))
        return cls(multiples=multiples, rest_s=rest_s, rule="published", cross_axis_prior=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdTrial:
    """One threshold and what came of it."""

    multiple: float  # Of the level at rest; NaN where the stills were stated
    stills: int  # Still phases found
    poses: int  # Different poses among them, by direction
    cost: float  # Half the sum of squared residuals, (m/s2)^2; infinite where nothing could be fitted
    uncertainty: float  # Standard uncertainty of a corrected reading of gravity, rms over all directions, m/s2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MultiPositionFit:
    """Accelerometer and, where the moves show them, gyroscopes."""

    accel: TriadFit  # Raw to m/s2
    gyro: TriadFit | None  # Raw to rad/s in the accelerometer's axes
    stills: tuple[Still, ...]  # Those that were used
    # Threshold on the windowed variance, accelerometer unit squared; NaN where the stills were stated; of the first
    # record
    threshold: float
    trials: tuple[ThresholdTrial, ...]  # All thresholds tried
    verdict: Verdict  # Of both
    missing: tuple[Finding, ...] = ()  # Why there are no gyroscopes


_Attempt = tuple[ThresholdTrial, tuple[Still, ...], FloatArray, NormFit | None]  # the third: readings that were fitted


_NO_LENGTH = "multi-position: wanted poses of one length, got none that a linear sensor could give; check the columns"


def fit_multi_position(
    recorded: Record | Sequence[Record],
    *,
    gravity: float,
    stills: Sequence[Still] | None = None,
    settings: MultiPositionSettings = MultiPositionSettings(),
    axes: TriadModel | None = None,
    creep: Callable[[Sequence[Still], Kind], Creep] | None = None,
) -> MultiPositionFit:
    """Calibrate from recordings of free poses and turns between them, all together; a recording may be a single pose.

    ``axes`` is an accelerometer's model from elsewhere, to which the gyroscopes are fitted where the poses do not show its axes;
    ``creep`` tells how far the temperature moves the readings of stills or moves of one triad.
    """
    records = (recorded,) if isinstance(recorded, Record) else tuple(recorded)
    if any(r.accel is None for r in records) or len({r.accel_unit for r in records}) > 1:
        raise InputError(
            "multi-position: wanted accel readings in one unit in every recording, got recordings without or in several units; "
            "map the accelerometer columns and their unit"
        )
    levels = [still_variance(r, window_s=settings.window_s, rest_s=settings.rest_s) for r in records]
    step = code_steps(records, rate=False)
    levels = [replace(level, step=step) for level in levels]
    shortest = [max(2, round(settings.min_still_s * r.sample_rate_hz)) for r in records]
    stated = {} if stills is None else {np.nan: tuple(stills)}
    tried = stated or {m: _stills(levels, m, shortest) for m in settings.multiples}
    plain = replace(settings, cross_axis_prior=None)
    attempts = [_attempt(levels, chosen, m, gravity, plain, shortest) for m, chosen in tried.items()]
    trial, used, reading, fit = _choose(attempts, settings)
    if settings.cross_axis_prior is not None and settings.cross_axis and (fit is None or fit.weakest < WEAKEST):
        known = [_attempt(levels, chosen, m, gravity, settings, shortest) for m, chosen in tried.items()]
        better = _choose(known, settings)
        if better[3] is not None and better[3].weakest >= WEAKEST:
            attempts, (trial, used, reading, fit) = known, better
    if fit is None:
        check_count(reading, 9 if settings.cross_axis else 6, known_noise=True)
        raise PoorFit(_NO_LENGTH)
    if creep is not None and settings.rule != "published" and not (moved := creep(used, "accel")).none:
        held = settings if len(fit.prior) else plain
        trial, used, reading, fit = _attempt(levels, used, trial.multiple, gravity, held, shortest, moved)
        if fit is None:
            raise PoorFit(_NO_LENGTH)
    check_range([levels[s.recording].values[s.start : s.stop] for s in used], "accelerometer in still poses")
    accel = judged(fit, reading, records[0].accel_unit)
    gyro: TriadFit | None = None
    missing: tuple[Finding, ...] = ()
    if settings.gyro and all(r.gyro is not None for r in records):
        cores = used if settings.rule == "published" or stills is not None else _cores(levels, used, shortest)
        try:
            model = axes if axes is not None and len(fit.prior) else accel.model
            gyro = _fit_gyro(records, used, cores, model, settings, creep)
        except NotObservable as error:
            missing = (finding("session.fit_failed", "warn", triad="gyroscope", reason=str(error)),)
    verdict = accel.verdict if gyro is None else accel.verdict.also(gyro.verdict)
    return MultiPositionFit(
        accel=accel,
        gyro=gyro,
        stills=used,
        threshold=trial.multiple * levels[0].at_rest,
        trials=tuple(one[0] for one in attempts),
        verdict=verdict.also(Verdict.of(*missing)),
        missing=missing,
    )


def _fit_gyro(
    records: Sequence[Record],
    used: Sequence[Still],
    cores: Sequence[Still],
    model: TriadModel,
    settings: MultiPositionSettings,
    creep: Callable[[Sequence[Still], Kind], Creep] | None,
) -> TriadFit:
    if settings.rule == "published":
        return fit_gyro_between_stills(records, used, model, cores=cores, equal=True, rest_s=settings.rest_s)
    ordered = sorted(used, key=lambda still: (still.recording, still.start))
    both = None if creep is None else (creep(ordered, "accel"), creep(ordered, "gyro"))
    return fit_gyro_between_stills(records, used, model, cores=cores, creep=both)


def _stills(levels: list[StillVariance], multiple: float, shortest: list[int]) -> tuple[Still, ...]:
    return tuple(
        Still(start=start, stop=stop, recording=number)
        for number, (level, least) in enumerate(zip(levels, shortest, strict=True))
        for start, stop in level.below(multiple * level.at_rest, least)
    )


def _cores(levels: list[StillVariance], stills: tuple[Still, ...], shortest: list[int]) -> tuple[Still, ...]:
    """Return the part of each still in which the gyroscopes are quiet, in the same order."""
    cores: list[Still] = []
    for number, (level, least) in enumerate(zip(levels, shortest, strict=True)):
        own, gyro = [s for s in stills if s.recording == number], level.gyro_level
        if gyro is None or not own:
            cores += own
            continue
        limit = CORE * float(np.median(np.concatenate([gyro[s.start : s.stop] for s in own])))
        for s in own:
            quiet = runs(gyro[s.start : s.stop] <= limit).tolist()
            first, last = max(quiet, key=lambda run: run[1] - run[0], default=(0, 0))
            cores.append(replace(s, start=s.start + first, stop=s.start + last) if last - first >= least else s)
    return tuple(cores)


def _attempt(
    levels: list[StillVariance],
    stills: tuple[Still, ...],
    multiple: float,
    gravity: float,
    settings: MultiPositionSettings,
    shortest: list[int],
    creep: Creep | None = None,
) -> _Attempt:
    means, variances = _poses(levels, stills)
    published = settings.rule == "published"
    reading = means
    if published and stills:
        reading = np.concatenate(
            [levels[s.recording].values[s.start : s.start + shortest[s.recording]] for s in stills]
        )
    fit: NormFit | None = None
    prior_sd = settings.cross_axis_prior
    least = 6 if not settings.cross_axis else 9 if prior_sd is None else FEWEST_POSES
    if len(stills) >= least and np.ptp(reading, axis=0).any():
        with suppress(PoorFit):
            weights = None if published else variances
            fit = fit_norm(
                reading,
                gravity=gravity,
                variances=weights,
                cross_axis=settings.cross_axis,
                prior_sd=prior_sd,
                creep=creep,
            )
    trial = ThresholdTrial(
        multiple=multiple,
        stills=len(stills),
        poses=0 if fit is None else _different(fit.corrected(means)),
        cost=np.inf if fit is None else 0.5 * float(fit.residuals @ fit.residuals),
        uncertainty=np.inf if fit is None else fit.uncertainty,
    )
    return trial, stills, reading, fit


def _poses(levels: list[StillVariance], stills: tuple[Still, ...]) -> tuple[FloatArray, FloatArray]:
    """Return mean readings (K, 3) and their variances, the noise pooled over the stills of a recording."""
    means, variances = np.zeros((2, len(stills), 3))
    for number, level in enumerate(levels):
        rows = [k for k, s in enumerate(stills) if s.recording == number]
        start, stop = np.array([(stills[k].start, stills[k].stop) for k in rows], np.int64).reshape(-1, 2).T
        count = (stop - start)[:, None].astype(float)
        sums, squares = level.sums[:, stop] - level.sums[:, start]
        within = (squares - sums**2 / count).sum(axis=0) / max(1.0, float(count.sum()) - len(rows))
        within = np.maximum(within, 0.0)
        means[rows], variances[rows] = sums / count + level.centre, within / count + code_variance(level.step, within)
    return means, variances


def _different(force: FloatArray) -> int:
    """Return how many directions differ from all earlier ones."""
    n = force / np.linalg.norm(force, axis=1)[:, None]
    kept: list[int] = []
    for k, near in enumerate(n @ n.T > np.cos(np.radians(SAME_POSE_DEG))):
        kept += [] if near[kept].any() else [k]
    return len(kept)


def _choose(attempts: list[_Attempt], settings: MultiPositionSettings) -> _Attempt:
    fitted = [a for a in attempts if a[3] is not None]
    if not fitted:
        return max(attempts, key=lambda a: len(a[1]))
    if settings.rule == "published":
        return min(fitted, key=lambda a: a[0].cost)
    # Thresholds that let motion in are far less certain; their false poses must not set the count to be reached.
    least = min(a[0].uncertainty for a in fitted)
    most = max(a[0].poses for a in fitted if a[0].uncertainty <= 2.0 * least or not np.isfinite(least))
    return min((a for a in fitted if a[0].poses >= 0.9 * most), key=lambda a: a[0].uncertainty)


# ---- from a session


def _of_session(seen: Observed, axes: TriadFit | None = None, *, gyro: bool = True) -> MultiPositionFit:
    session = seen.session
    stills = session.stills or (seen.stills if seen.adapted else None)
    settings = MultiPositionSettings(cross_axis_prior=seen.settings.cross_axis_prior, gyro=gyro)
    model = None if axes is None or axes.model.method.startswith("multi-position") else axes.model
    return fit_multi_position(
        session.records,
        gravity=session.gravity_m_s2,
        stills=stills,
        settings=settings,
        axes=model,
        creep=lambda pieces, kind: creep_of(seen, pieces, kind),
    )


def calibrate_poses(seen: Observed, mode: str | None, accel: TriadFit | None = None) -> Outcome:
    """Fit the accelerometer of a session to its free poses; an entry of FITS."""
    made = _of_session(seen, gyro=False)
    found = creep_of(seen, made.stills, "accel").findings()
    return Outcome(fit=made.accel, method="multi-position", findings=found, used=made.stills)


def calibrate_moves(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes of a session to the moves between its poses; an entry of FITS."""
    try:
        fit = _of_session(seen, accel)
    except NotObservable as error:
        return Outcome(findings=(finding("session.fit_failed", "warn", triad="gyroscope", reason=str(error)),))
    if fit.gyro is None:
        return Outcome(findings=fit.missing)
    return Outcome(fit=fit.gyro, method="multi-position", findings=creep_of(seen, fit.stills, "gyro").findings())
