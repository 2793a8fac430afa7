"""Six faces: accelerometers against gravity, each face of the device up and down on a level plane.

The axis that points up reads +g: face "+x" is the column (g, 0, 0) of L, face "-x" is (-g, 0, 0). S holds the mean readings.

    paper      C = L S^T (S S^T)^-1                                                     eqs. 1-3 of the note; no offset
    affine     s = K a + b by least squares, 12 parameters
    levelled   the same, but the plane is level only to sigma_tilt, which is estimated

A face tilted by d reads g d on the two axes that should read nothing and g (1 - d^2 / 2) on its own: on-axis equations keep the
sigma of the noise, cross-axis ones have hypot(noise, g sigma_tilt). Six spare equations hardly estimate sigma_tilt, so the fit
is averaged over all values they allow; its 95 % intervals cover 93-97 % at any tilt.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.adc import limited_by_codes, mean_rounding
from undrift.calibration.checks import (
    check_faces,
    check_gravity,
    check_handedness,
    check_own_scale,
    check_repeats,
    check_saturation,
    face_vectors,
    missing_faces,
)
from undrift.calibration.creep import (
    Creep,
    blocks_within,
    creep_of,
    flicker_about_mean,
    mean_square_size,
    size_unit,
)
from undrift.calibration.dwells import mountings
from undrift.calibration.norm import MG, QUADRATIC_SD
from undrift.calibration.observe import Observed, Outcome, spans_of, whole_readings, with_offset
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.equations import (
    Equations,
    Solutions,
    averaged,
    diagonal,
    geometric_peak,
    joined,
    parameter_order,
    roots,
    solutions,
)
from undrift.fit.least_squares import (
    ForwardFit,
    TriadFit,
    block_size,
    fit_forward,
    fit_paper,
    noise_of_means,
    offset_verdict,
    triad_from_forward,
)
from undrift.model import Verdict
from undrift.record import MountedFace, Record, Still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

# ---- tilt of the faces
#
# Equation (p, i) of pose p and axis i of the case has the standard deviation
#
#     own axis     hypot(noise, g tilt^2)          the cosine of the tilt
#     cross axis   hypot(noise, g tilt)            the sine
#
# This holds along the axes of the case. A sensor is misaligned to them by a per cent and sees a per cent of the sine on its own
# face, which can be more than the noise. So a plain fit (K0, b0) corrects the readings first:
#
#     a = M0 (s - b0)              M0 = K0^-1
#     a = K1 up + b1               weighted;  K = K0 K1,  b = K0 b1 + b0
#
# and is averaged over the tilt (fit/equations.py), all rows together. E0 weighs by L / (tilt + noise / g), which leaves room for a
# tilt as small as the noise; E1 by L / (tilt + 0.1 noise / g), which favours level faces and so loses nothing on them. Where L is
# greatest at no tilt at all, the faces count as level, and the fit is plain least squares, which is then the best there is.
#
# E0 has the covariance of what the equations of own axes carry to second order. K0's cross-axis terms err by d. A face of axis i
# that stands off by p_j, of which the residuals of cross axes show r_j and the rest is d_ji, reads on its own axis
#
#     -g sum_j r_j (d_ij + d_ji)        alike on both faces: in the offset
#     +-g tilt^2                        of opposite sign: in the scale

_EVIDENCE = 2.0  # twice the gain of log-likelihood of a tilt that is reported: 8 % false alarms on a level plane
_LARGEST = 0.2  # rad
_GRID = 120
_WORST_MOUNTED = 10.0  # times the stated uncertainty of a mounting: 1 deg, beyond what is mounted by hand [assumed]
_SMALL_TILT = 0.1  # of noise / g: the tilt that E1 takes as none


def fit_tilted(
    up: FloatArray,
    reading: FloatArray,
    noise: FloatArray,
    plain: ForwardFit,
    stated: FloatArray | None = None,
    in_common: FloatArray | None = None,
) -> tuple[ForwardFit, float]:
    """Fit faces whose tilt is not known: up (P, 3) m/s2, reading and noise (P, 3) in one unit; return the tilt too, rad.

    A pose has its stated tilt (P,), rad, beside that of all. ``in_common`` (3, P, P) is the covariance of what moves the readings
    of one sensor together, in their unit squared.
    """
    stated = np.zeros(len(up)) if stated is None else stated
    inverse = np.linalg.inv(plain.matrix)
    level = (reading - plain.offset) @ inverse.T
    sigma = np.sqrt(noise**2 @ (inverse**2).T)
    gravity = float(np.linalg.norm(up, axis=1).max())
    along = np.zeros((3, 1, 1)) if in_common is None else np.tensordot(inverse**2, in_common, axes=1)
    tilts, thetas, covariances, likelihood = _solved(up, level, sigma, gravity, stated, along)
    best = int(np.argmax(likelihood))
    if reading.size <= 12 or (best == 0 and not stated.any()):
        return plain, 0.0
    small = float(np.median(sigma)) / gravity
    over = (tilts + small, tilts + _SMALL_TILT * small)
    theta, covariance = thetas[0], covariances[0]
    if best > 0:
        theta, covariance = averaged(tilts, likelihood, thetas, covariances, over)
    jacobian = np.zeros((12, 12))
    jacobian[:9, :9], jacobian[9:, 9:] = np.kron(plain.matrix, np.eye(3)), plain.matrix
    matrix = plain.matrix @ theta[:9].reshape(3, 3)
    offset = plain.matrix @ theta[9:] + plain.offset
    covariance = jacobian @ covariance @ jacobian.T
    fit = replace(
        plain, matrix=matrix, offset=offset, covariance=covariance, residuals=reading - up @ matrix.T - offset
    )
    shows = 2.0 * (likelihood[best] - likelihood[0]) >= _EVIDENCE
    return fit, geometric_peak(tilts, likelihood, best) if shows else 0.0


def tilted_sigma(up: FloatArray, noise: FloatArray, gain: float, tilt: float | FloatArray) -> FloatArray:
    """Return the standard deviation (P, 3) of every equation for faces with a tilt, rad, of all or of each (P, 1).

    up and noise (P, 3), gain per g.
    """
    return np.asarray(np.hypot(noise, gain * np.where(up != 0.0, tilt * tilt, tilt)))


def _solved(
    up: FloatArray, reading: FloatArray, noise: FloatArray, length: float, stated: FloatArray, in_common: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a grid of tilts (T,), and for each K row by row then b (T, 12), its covariance (T, 12, 12), and log L (T,)."""
    smallest = 0.02 * float(np.median(noise)) / length
    tilts = np.concatenate(([0.0], np.geomspace(max(smallest, 1e-9), _LARGEST, _GRID)))
    design = np.column_stack((up, np.ones(len(up))))
    sigma = np.stack([tilted_sigma(up, noise, length, np.hypot(t, stated)[:, None]) for t in tilts])
    fits = [solutions(design, reading[:, k], roots(sigma[:, :, k], in_common[k])) for k in range(3)]
    residuals = np.stack([reading[:, k] - fits[k].theta @ design.T for k in range(3)])
    more = _second_order(up, fits, residuals, length * (tilts[:, None] ** 2 + stated**2))
    thetas = np.hstack([fit.theta for fit in fits])[:, parameter_order(4)]
    covariances = joined([fit.covariance + part for fit, part in zip(fits, more, strict=True)])
    return tilts, thetas, covariances, np.sum([fit.likelihood for fit in fits], axis=0)


def _second_order(
    up: FloatArray, fits: Sequence[Solutions], residuals: FloatArray, square: FloatArray
) -> list[FloatArray]:
    """Return what to add to the covariance (T, 4, 4) of each sensor, which has errors of g tilt^2, ``square`` (T, P), alone."""
    variance = np.stack([np.einsum("tii->ti", fit.covariance)[:, :3] for fit in fits], axis=1)
    more = []
    for row, fit in enumerate(fits):
        faces = up[:, row] != 0.0
        sign = np.sign(up[faces, row])
        alike = np.outer(sign, sign) / max(1, faces.sum()) - np.eye(faces.sum())
        errors = square[:, faces, None] * square[:, None, faces] * alike
        for across in {0, 1, 2} - {row}:
            size = variance[:, row, across] + variance[:, across, row]
            seen = residuals[across][:, faces]
            errors += size[:, None, None] * seen[:, :, None] * seen[:, None, :]
        gain = fit.gain[:, :, faces]
        more.append(gain @ errors @ gain.transpose(0, 2, 1))
    return more


# ---- fit of the face means

SixFaceMode = Literal["paper", "affine", "levelled"]

_ROUNDING = 1e-12  # of the largest reading: no mean is known better than its arithmetic, however low the noise
_LARGE_TILT = 0.5 * RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaceMeans:
    """Mean readings of a device on its faces."""

    reading: FloatArray  # (P, 3), mean of each pose, ``unit``
    faces: tuple[MountedFace, ...]  # Axis that points up in each
    noise: FloatArray | None = None  # (P, 3), standard deviation of each mean, ``unit``; None when it is not known
    rounding: FloatArray | None = None  # (3,), what the codes leave in each mean, in ``noise`` too, ``unit``
    unit: str = "m/s2"  # Unit of the readings
    # (P,), stated standard uncertainty of the tilt of each beside what the readings show, rad; levelled mode alone uses it
    tilt: FloatArray | None = None
    creep: Creep | None = None  # Of the session's temperature
    flicker: FloatArray | None = None  # (P, P), covariance of the offset by flicker, ``unit`` squared

    def in_common(self, gravity: float) -> dict[str, FloatArray]:
        """Return the covariances (3, P, P) of what moves the readings of a sensor together, ``unit`` squared, by source."""
        parts = {} if self.flicker is None else {"instability": np.stack((self.flicker, self.flicker, self.flicker))}
        if self.creep is not None and not self.creep.none:
            up = gravity * face_vectors(self.faces)
            design = np.column_stack((up, np.ones(len(up))))
            gain = np.diag(np.linalg.lstsq(design, self.reading, rcond=None)[0][:3])
            parts["temperature"] = np.stack([self.creep.covariance(up[:, j], float(gain[j])) for j in range(3)])
        return parts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SixFaceFit(TriadFit):
    """A triad fitted to six faces."""

    # Standard deviation of the faces' tilt about each horizontal axis, rad; 0 where not significant, NaN where not estimated
    tilt: float = float("nan")


def fit_six_face(poses: FaceMeans, *, gravity: float, mode: SixFaceMode = "levelled") -> SixFaceFit:
    """Fit accelerometers to mean readings of their faces."""
    _check(poses, gravity, mode)
    up, reading, noise = gravity * face_vectors(poses.faces), poses.reading, poses.noise
    names = {"method": f"six-face/{mode}", "unit_in": poses.unit, "unit_out": "m/s2"}
    sigma = None if noise is None else np.maximum(noise, _ROUNDING * np.abs(reading).max())
    in_common = sum(poses.in_common(gravity).values(), np.zeros((3, len(up), len(up))))
    plain, tilt = fit_forward(up, reading, sigma, in_common), float("nan")
    forward = plain
    if sigma is not None and mode != "affine":
        forward, tilt = fit_tilted(up, reading, sigma, plain, poses.tilt, in_common)
    verdict = Verdict.of(*_judged(poses, plain, sigma, tilt, mode))
    if mode == "paper":
        fit, tilt = fit_paper(up, reading, noise, in_common, **names), float("nan")
        verdict = offset_verdict(fit, up, reading, noise).also(verdict)
    else:
        fit = triad_from_forward(forward, valid_range=(-gravity, gravity), **names)
        if sigma is not None:
            rest = "noise" if forward is plain else "level"  # of level faces the sources are all there is
            budget = _equations(poses, up, sigma).budget(forward.inverse, fit.model.covariance, rest)
            fit = replace(fit, model=replace(fit.model, budget=budget))
    check_handedness(fit.model.forward_matrix, "accelerometer")
    return SixFaceFit(model=fit.model, residuals=fit.residuals, verdict=verdict, tilt=tilt)


def _equations(poses: FaceMeans, up: FloatArray, noise: FloatArray) -> Equations:
    """Return the equations of level faces: up (P, 3) m/s2, and all that is known of the errors of the means."""
    codes = np.minimum(np.zeros(3) if poses.rounding is None else poses.rounding, noise) ** 2
    return Equations(
        unknowns={"matrix": up, "offset": np.ones((len(up), 1))},
        reading=poses.reading,
        own={"noise": diagonal(noise**2 - codes), "adc": diagonal(codes), **poses.in_common(float(np.abs(up).max()))},
    )


def _judged(
    poses: FaceMeans,
    plain: ForwardFit,
    noise: FloatArray | None,
    tilt: float,
    mode: SixFaceMode,
) -> Iterator[Finding]:
    if poses.rounding is not None and poses.noise is not None:
        yield from limited_by_codes("accelerometer", poses.rounding**2, (poses.noise**2).mean(axis=0), poses.unit)
    tilt_deg, spare = tilt / RADIAN_PER_DEGREE, plain.residuals.size - 12
    if mode == "paper":  # the closed form assumes level faces, and so does its covariance
        if tilt > 0.0:
            yield finding("six_face.tilt_left_out", "warn", tilt_deg=tilt_deg, gain_share=tilt)
        return
    for face in missing_faces(poses.faces):
        yield finding("six_face.face_missing", "warn", face=face)
    if tilt > _LARGE_TILT:
        yield finding("six_face.tilt_large", "warn", tilt_deg=tilt_deg)
    elif tilt > 0.0:
        yield finding("six_face.tilt_small", "info", tilt_deg=tilt_deg)
    if mode == "affine" and noise is not None and spare > 0:
        ratio = float(np.sqrt(_equations(poses, plain.inputs, noise).square(plain.residuals) / spare))
        if ratio >= 3.0:
            yield finding("six_face.scatter", "warn", ratio=ratio)


def face_means(
    records: Sequence[Record], stills: Sequence[Still], *, window_s: float = 6.0, polynomial_degree: int = 1
) -> FaceMeans:
    """Filter and average the middle ``window_s`` of each labelled still phase by a polynomial in time."""
    used = [s for s in stills if s.face is not None]
    unit = records[stills[0].recording].accel_unit if stills else "m/s2"
    cut = [_middle(records[s.recording], s, window_s) for s in used]
    windows = [_window(records[s.recording], s, unit, polynomial_degree) for s in cut]
    filtered = [polynomial_filter(window, polynomial_degree) for window in windows]
    sizes = [block_size(records[s.recording].sample_rate_hz) for s in used]
    noise = noise_of_means([rest for _, rest in filtered], sizes, removed=polynomial_degree + 1)
    rounding = flicker = None
    if noise is not None:
        # Of a likely size, by the blocks within the rests
        span, rates_hz = spans_of(records, cut), [records[s.recording].sample_rate_hz for s in cut]
        size = size_unit(noise, span)
        likelihood = blocks_within(windows, rates_hz, polynomial_degree + 1).likelihood(size)
        flicker = mean_square_size(likelihood) * size**2 * flicker_about_mean(span)
        every = [np.asarray(records[k].accel) for k in {s.recording for s in used}]
        rounding = mean_rounding(every, [rest for _, rest in filtered])
        noise = np.hypot(noise, rounding)
    return FaceMeans(
        reading=np.array([smooth.mean(axis=0) for smooth, _ in filtered]).reshape(-1, 3),
        faces=tuple(s.face for s in used if s.face is not None),
        noise=noise,
        rounding=rounding,
        unit=unit,
        flicker=flicker,
    )


def _middle(record: Record, still: Still, window_s: float) -> Still:
    wanted = max(2, round(window_s * record.sample_rate_hz))
    start = still.start + max(0, (still.stop - still.start - wanted) // 2)
    return replace(still, start=start, stop=min(still.stop, start + wanted))


def _window(record: Record, still: Still, unit: str, degree: int) -> FloatArray:
    if record.accel is None or record.accel_unit != unit:
        raise InputError(
            f"six faces: wanted accelerometer readings in {unit} in every recording, got "
            f"{'none' if record.accel is None else record.accel_unit} in recording {still.recording}; map the columns alike"
        )
    window = whole_readings(record.accel, still.start, still.stop)
    if len(window) <= degree + 1:
        raise InputError(
            f"six faces: wanted more than {degree + 1} readings on face {still.face}, got {len(window)}; "
            "choose another stretch"
        )
    check_saturation(window, f"accelerometer on face {still.face}")
    return window


def polynomial_filter(values: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Fit a polynomial in time to each column: values (N, 3) -> (N, 3), (N, 3)."""
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(values)), degree)
    filtered = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return filtered, values - filtered


def _check(poses: FaceMeans, gravity: float, mode: SixFaceMode) -> None:
    if poses.reading.shape != (len(poses.faces), 3):
        raise InputError(
            f"six faces: wanted one reading (3,) for each of {len(poses.faces)} faces, got {poses.reading.shape}"
        )
    if len(poses.faces) < 5:
        count = len(poses.faces)
        raise NotObservable(
            f"wanted 5 labelled faces or more, got {count}; record the missing ones", count=count, needed=5
        )
    if is_physical(poses.unit):
        check_gravity(poses.reading * si_factor(poses.unit, "accel"), gravity)
    check_faces(poses.reading, poses.faces)
    missing = missing_faces(poses.faces)
    if len(missing) > (0 if mode == "paper" else 1):
        raise NotObservable(
            f"six faces: wanted all six, got none for {', '.join(missing)}; record the missing faces", missing=missing
        )
    if mode == "levelled" and poses.noise is None:
        raise InputError(
            "six faces, mode levelled: wanted the noise of each mean, got none; give it, or use mode affine"
        )


# ---- from a session


def calibrate_faces(seen: Observed, mode: str | None, accel: TriadFit | None = None) -> Outcome:
    """Fit the accelerometer of a session to its faces; an entry of FITS."""
    settings, used = seen.settings, mode or "levelled"
    poses = face_means(
        seen.session.records, seen.stills, window_s=settings.window_s, polynomial_degree=settings.polynomial_degree
    )
    if len(poses.faces) > 1:
        check_repeats(poses.reading, poses.faces)
    creep = creep_of(seen, seen.faced, "accel")
    size = QUADRATIC_SD * STANDARD_GRAVITY
    shown = {"size_mg": size * STANDARD_GRAVITY / MG, "tilt_deg": size / RADIAN_PER_DEGREE}
    findings = (*creep.findings(), finding("six_face.quadratic", "info", **shown))
    poses = replace(poses, creep=creep)
    if used == "levelled" and poses.noise is None:
        used, findings = "affine", (*findings, finding("six_face.short_faces", "warn"))
    if used == "levelled":
        poses = _by_mounting(seen, poses)
    offset = None
    if used == "paper" and settings.remove_offset:
        # Opposite faces cancel: the mean over the six, each counted once, is an estimate of the offset.
        faces, moving = np.array(poses.faces), poses.in_common(seen.session.gravity_m_s2).values()
        share = np.array([1.0 / (faces == face).sum() for face in faces]) / len(set(poses.faces))
        offset = share @ poses.reading
        poses = replace(poses, reading=poses.reading - offset)
    fit: TriadFit = fit_six_face(poses, gravity=seen.session.gravity_m_s2, mode=used)  # type: ignore[arg-type]
    check_own_scale(fit.model.scale_factor, poses.unit, "accel", settings.scale_tolerance, "accelerometer")
    if offset is not None:
        variance = np.full(3, np.nan) if poses.noise is None else (poses.noise**2).mean(axis=0) / len(poses.faces)
        variance = variance + sum((part @ share @ share for part in moving), np.zeros(3))
        fit = with_offset(fit, offset, variance)
    return Outcome(fit=fit, method="six-face", findings=findings, used=seen.faced)


def _by_mounting(seen: Observed, poses: FaceMeans) -> FaceMeans:
    """Return poses in which the rests of one mounting are one: on a rate table, or on one face with no other rest between.

    Where the other rests show all six faces by themselves, a mounting counts as far off level, so that what is felt on the table
    is not known from it already; else all show alike how far they are.
    """
    turns = [turn for turn in seen.session.turns if turn.turn_rate is not None]
    of_rest = mountings([*seen.faced, *turns])[: len(poses.faces)]
    laid = [n if one.face is not None else -1 for n, one in enumerate(seen.stills)]
    for n, (before, after) in enumerate(pairwise(seen.stills), 1):
        if laid[n] >= 0 and (before.face, before.recording) == (after.face, after.recording):
            laid[n] = laid[n - 1]
    place = np.where(of_rest < 0, [n for n in laid if n >= 0], -1)
    if poses.noise is None or (not (of_rest >= 0).any() and len(set(place)) == len(place)):
        return poses
    table = seen.settings.rate_table(seen.session.rate_table)
    groups = [list(np.flatnonzero(place == n)) for n in np.unique(place[place >= 0])]
    groups += [list(np.flatnonzero(of_rest == mounting)) for mounting in np.unique(of_rest[of_rest >= 0])]
    weight = 1.0 / np.maximum(poses.noise, 1e-300) ** 2
    to_group = np.zeros((len(groups), len(poses.faces)))  # mean over the rests of a mounting
    for number, rows in enumerate(groups):
        to_group[number, rows] = weight[rows].mean(axis=1) / weight[rows].mean(axis=1).sum()
    alone = not missing_faces([face for face, mounting in zip(poses.faces, of_rest, strict=True) if mounting < 0])
    tilt = float(alone) * np.hypot(_WORST_MOUNTED * table.mount_tilt_deg, table.table_level_deg) * RADIAN_PER_DEGREE
    return replace(
        poses,
        reading=np.array([np.average(poses.reading[rows], axis=0, weights=weight[rows]) for rows in groups]),
        faces=tuple(poses.faces[rows[0]] for rows in groups),
        noise=np.array([weight[rows].sum(axis=0) ** -0.5 for rows in groups]),
        tilt=np.array([tilt if of_rest[rows[0]] >= 0 else 0.0 for rows in groups]),
        creep=poses.creep and replace(poses.creep, warmth=to_group @ poses.creep.warmth),
        flicker=None if poses.flicker is None else to_group @ poses.flicker @ to_group.T,
    )
