"""Six faces: accelerometers against gravity, each face of the device up and down on a level plane.

The axis that points up reads +g: face "+x" is the column (g, 0, 0) of L, face "-x" is (-g, 0, 0). S holds the mean readings.

    paper      C = L S^T (S S^T)^-1                                                     eqs. 1-3 of the note; no offset
    affine     s = K a + b by least squares, 12 parameters
    levelled   the same, but the plane is level only to sigma_tilt, which is estimated

A face that is tilted by d reads g d on the two axes that should read nothing and g (1 - d^2 / 2) on its own. So the on-axis
equations keep the sigma of the noise, and the cross-axis ones have hypot(noise, g sigma_tilt), along the axes of the case:
the readings are corrected by an affine fit first. Six faces leave six spare equations to estimate sigma_tilt, which is few, so
the fit is averaged over all values they allow. Its 95 % intervals cover 93-97 % at any tilt.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.checks import (
    check_faces,
    check_gravity,
    check_handedness,
    check_saturation,
    check_scale_factor,
    face_vectors,
    missing_faces,
)
from undrift.calibration.observe import Observed, Outcome, with_offset
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.least_squares import (
    ForwardFit,
    TriadFit,
    block_size,
    fit_forward,
    fit_paper,
    geometric_peak,
    noise_of_means,
    offset_verdict,
    triad_from_forward,
)
from undrift.model import Verdict
from undrift.record import Face, Record, Still
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

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
#     log L = -1/2 [ sum log sigma^2 + log det A^T W A + r^T W r ]          restricted likelihood of a tilt, all rows together
#
#     theta = E1 theta(tilt)       covariance = E0 C(tilt) + E0 (theta(tilt) - theta)(theta(tilt) - theta)'
#
# E0 weighs by L / (tilt + noise / g), which leaves room for a tilt as small as the noise; E1 by L / (tilt + 0.1 noise / g), which
# favours level faces and so loses nothing on them. Where L is greatest at no tilt at all, the faces count as level, and the fit is
# plain least squares, which is then the best there is.

_EVIDENCE = 2.0  # twice the gain of log-likelihood of a tilt that is reported: 8 % false alarms on a level plane
_LARGEST = 0.2  # rad
_GRID = 120
_SMALL_TILT = 0.1  # of noise / g: the tilt that E1 takes as none


def fit_tilted(up: FloatArray, reading: FloatArray, noise: FloatArray, plain: ForwardFit) -> tuple[ForwardFit, float]:
    """Fit faces whose tilt is not known: up (P, 3) m/s2, reading and noise (P, 3) in one unit; return the tilt too, rad."""
    inverse = np.linalg.inv(plain.matrix)
    level = (reading - plain.offset) @ inverse.T
    sigma = np.sqrt(noise**2 @ (inverse**2).T)
    gravity = float(np.linalg.norm(up, axis=1).max())
    tilts, thetas, covariances, likelihood = _solved(up, level, sigma, np.full(3, gravity))
    if reading.size <= 12 or int(np.argmax(likelihood)) == 0:
        return plain, 0.0
    small = float(np.median(sigma)) / gravity
    step = np.gradient(tilts)
    step[[0, -1]] *= 0.5  # trapezoids
    by_likelihood = np.exp(likelihood - likelihood.max()) * step
    share, likely = by_likelihood / (tilts + small), by_likelihood / (tilts + _SMALL_TILT * small)
    share, likely = share / share.sum(), likely / likely.sum()
    theta = likely @ thetas
    apart = thetas - theta
    covariance = np.einsum("t,tij->ij", share, covariances) + (share[:, None] * apart).T @ apart
    jacobian = np.zeros((12, 12))
    jacobian[:9, :9], jacobian[9:, 9:] = np.kron(plain.matrix, np.eye(3)), plain.matrix
    matrix = plain.matrix @ theta[:9].reshape(3, 3)
    offset = plain.matrix @ theta[9:] + plain.offset
    residuals = reading - up @ matrix.T - offset
    fit = replace(
        plain, matrix=matrix, offset=offset, covariance=jacobian @ covariance @ jacobian.T, residuals=residuals
    )
    return fit, _most_likely_tilt(tilts, likelihood)


def _most_likely_tilt(tilts: FloatArray, likelihood: FloatArray) -> float:
    best = int(np.argmax(likelihood))
    if 2.0 * (likelihood[best] - likelihood[0]) < _EVIDENCE or best == 0:
        return 0.0
    return geometric_peak(tilts, likelihood, best)


def tilted_sigma(up: FloatArray, noise: FloatArray, gain: FloatArray, tilt: float) -> FloatArray:
    """Return the standard deviation (P, 3) of every equation for faces with a tilt, rad: up and noise (P, 3), gain (3,)."""
    return np.asarray(np.hypot(noise, gain * np.where(up != 0.0, tilt * tilt, tilt)))


def _solved(
    up: FloatArray, reading: FloatArray, noise: FloatArray, gain: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a grid of tilts (T,), and for each K row by row then b (T, 12), its covariance (T, 12, 12), and log L (T,)."""
    smallest = 0.02 * float(np.median(noise)) / float(np.median(gain))
    tilts = np.concatenate(([0.0], np.geomspace(max(smallest, 1e-9), _LARGEST, _GRID)))
    length = float(np.linalg.norm(up, axis=1).max())
    design = np.column_stack((up / length, np.ones(len(up))))
    unit = np.array([length, length, length, 1.0])
    sigma = np.stack([tilted_sigma(up, noise, gain, float(t)) for t in tilts])
    theta, covariance, likelihood = np.zeros((len(tilts), 12)), np.zeros((len(tilts), 12, 12)), np.zeros(len(tilts))
    for row in range(3):
        weight = 1.0 / sigma[:, :, row] ** 2
        normal = (design.T * weight[:, None, :]) @ design
        inverse = np.linalg.inv(normal)
        own = np.einsum("tij,tj->ti", inverse, (weight * reading[:, row]) @ design)
        residual = reading[:, row] - own @ design.T
        places = np.array([3 * row, 3 * row + 1, 3 * row + 2, 9 + row])
        theta[:, places] = own / unit
        covariance[:, places[:, None], places] = inverse / np.outer(unit, unit)
        likelihood -= 0.5 * ((weight * residual**2).sum(axis=1) - np.log(weight).sum(axis=1))
        likelihood -= 0.5 * np.linalg.slogdet(normal)[1]
    return tilts, theta, covariance, likelihood


# ---- fit of the face means

SixFaceMode = Literal["paper", "affine", "levelled"]

_ROUNDING = 1e-12  # of the largest reading: no mean is known better than its arithmetic, however low the noise
_LARGE_TILT = 0.5 * RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True)
class SixFaceSettings:
    """How a six-face session is read and fitted."""

    mode: SixFaceMode = "levelled"  # paper, affine or levelled
    window_s: float = 6.0  # Longest stretch used from the middle of each still phase, s. The note takes 6 s
    polynomial_degree: int = 1  # Degree of the polynomial in time that filters each window before it is averaged
    stated_scale: float | None = None  # Sensitivity the maker states, reading per m/s2; None leaves it unchecked
    scale_tolerance: float = 0.1  # Relative tolerance of ``stated_scale``


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaceMeans:
    """Mean readings of a device on its faces."""

    reading: FloatArray  # (P, 3), mean of each pose, ``unit``
    faces: tuple[Face, ...]  # Axis that points up in each
    noise: FloatArray | None = None  # (P, 3), standard deviation of each mean, ``unit``; None when it is not known
    unit: str = "m/s2"  # Unit of the readings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SixFaceFit(TriadFit):
    """A triad fitted to six faces."""

    # Standard deviation of the faces' tilt about each horizontal axis, rad; 0 where not significant, NaN where not estimated
    tilt: float = float("nan")


def fit_six_face(poses: FaceMeans, *, gravity: float, settings: SixFaceSettings = SixFaceSettings()) -> SixFaceFit:
    """Fit accelerometers to mean readings of their faces."""
    _check(poses, gravity, settings)
    up = gravity * face_vectors(poses.faces)
    method = f"six-face/{settings.mode}"
    if settings.mode == "paper":
        plain = fit_paper(up, poses.reading, poses.noise, method=method, unit_in=poses.unit, unit_out="m/s2")
        verdict = offset_verdict(plain, up, poses.reading, poses.noise).also(_tilt_left_out(poses, up))
        tilt = float("nan")
    else:
        forward, tilt, verdict = _affine(poses, up, settings)
        plain = triad_from_forward(
            forward,
            method=method,
            unit_in=poses.unit,
            unit_out="m/s2",
            valid_range=(-gravity, gravity),
            verdict=verdict,
        )
    fit = SixFaceFit(model=plain.model, residuals=plain.residuals, verdict=verdict, tilt=tilt)
    check_handedness(fit.model.forward_matrix, "accelerometer")
    if settings.stated_scale is not None:
        check_scale_factor(fit.model.scale_factor, settings.stated_scale, settings.scale_tolerance, "accelerometer")
    return fit


def face_means(
    records: Sequence[Record], stills: Sequence[Still], settings: SixFaceSettings = SixFaceSettings()
) -> FaceMeans:
    """Filter and average the labelled still phases of a session."""
    means: list[FloatArray] = []
    windows: list[FloatArray] = []
    sizes: list[int] = []
    faces: list[Face] = []
    unit = records[stills[0].recording].accel_unit if stills else "m/s2"
    for still in stills:
        record = records[still.recording]
        if still.face is None:
            continue
        if record.accel is None or record.accel_unit != unit:
            raise InputError(
                f"six faces: wanted accelerometer readings in {unit} in every recording, got "
                f"{'none' if record.accel is None else record.accel_unit} in recording {still.recording}; map the columns alike"
            )
        window = record.accel[still.start : still.stop]
        wanted = max(2, round(settings.window_s * record.sample_rate_hz))
        skip = max(0, (len(window) - wanted) // 2)
        window = window[skip : skip + wanted]
        window = window[~np.isnan(window).any(axis=1)]
        if len(window) <= settings.polynomial_degree + 1:
            raise InputError(
                f"six faces: wanted more than {settings.polynomial_degree + 1} readings on face {still.face}, got {len(window)}; "
                "choose another stretch"
            )
        check_saturation(window, f"accelerometer on face {still.face}")
        filtered, rest = polynomial_filter(window, settings.polynomial_degree)
        means.append(filtered.mean(axis=0))
        windows.append(rest)
        sizes.append(block_size(record.sample_rate_hz))
        faces.append(still.face)
    noise = noise_of_means(windows, sizes, removed=settings.polynomial_degree + 1)
    return FaceMeans(reading=np.array(means).reshape(-1, 3), faces=tuple(faces), noise=noise, unit=unit)


def polynomial_filter(values: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Fit a polynomial in time to each column: values (N, 3) -> (N, 3), (N, 3)."""
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(values)), degree)
    filtered = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return filtered, values - filtered


def _check(poses: FaceMeans, gravity: float, settings: SixFaceSettings) -> None:
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
    if len(missing) > (0 if settings.mode == "paper" else 1):
        raise NotObservable(
            f"six faces: wanted all six, got none for {', '.join(missing)}; record the missing faces", missing=missing
        )
    if settings.mode == "levelled" and poses.noise is None:
        raise InputError(
            "six faces, mode levelled: wanted the noise of each mean, got none; give it, or use mode affine"
        )


def _affine(poses: FaceMeans, up: FloatArray, settings: SixFaceSettings) -> tuple[ForwardFit, float, Verdict]:
    reading, noise = poses.reading, poses.noise
    missing = missing_faces(poses.faces)
    verdict = Verdict.of(*(finding("six_face.face_missing", "warn", face=face) for face in missing))
    if noise is not None:
        noise = np.maximum(noise, _ROUNDING * np.abs(reading).max())
    plain = fit_forward(up, reading, noise)
    if settings.mode == "affine" or noise is None:
        return plain, float("nan"), verdict.also(_scatter_verdict(plain, noise))
    forward, tilt = fit_tilted(up, reading, noise, plain)
    tilt_deg = tilt / RADIAN_PER_DEGREE
    if tilt > _LARGE_TILT:
        verdict = verdict.also(Verdict.of(finding("six_face.tilt_large", "warn", tilt_deg=tilt_deg)))
    elif tilt > 0.0:
        verdict = verdict.also(Verdict.of(finding("six_face.tilt_small", "info", tilt_deg=tilt_deg)))
    return forward, tilt, verdict


def _tilt_left_out(poses: FaceMeans, up: FloatArray) -> Verdict:
    # The closed form assumes level faces, and so does its covariance.
    if poses.noise is None:
        return Verdict()
    noise = np.maximum(poses.noise, _ROUNDING * np.abs(poses.reading).max())
    tilt = fit_tilted(up, poses.reading, noise, fit_forward(up, poses.reading, noise))[1]
    if tilt == 0.0:
        return Verdict()
    return Verdict.of(finding("six_face.tilt_left_out", "warn", tilt_deg=tilt / RADIAN_PER_DEGREE, gain_share=tilt))


def _scatter_verdict(plain: ForwardFit, noise: FloatArray | None) -> Verdict:
    spare = plain.residuals.size - 12
    if noise is None or spare < 1:
        return Verdict()
    ratio = float(np.sqrt(((plain.residuals / noise) ** 2).sum() / spare))
    return Verdict() if ratio < 3.0 else Verdict.of(finding("six_face.scatter", "warn", ratio=ratio))


# ---- from a session


def calibrate_faces(seen: Observed, mode: str | None, accel: TriadFit | None = None) -> Outcome:
    """Fit the accelerometer of a session to its faces; an entry of FITS."""
    settings = SixFaceSettings(
        mode=mode or "levelled",  # type: ignore[arg-type]
        window_s=seen.settings.window_s,
        polynomial_degree=seen.settings.polynomial_degree,
    )
    unit = seen.session.records[0].accel_unit
    if is_physical(unit):
        scale = 1.0 / si_factor(unit, "accel")
        settings = replace(settings, stated_scale=scale, scale_tolerance=seen.settings.scale_tolerance)
    poses = face_means(seen.session.records, seen.stills, settings)
    found: tuple[Finding, ...] = ()
    if settings.mode == "levelled" and poses.noise is None:
        settings = replace(settings, mode="affine")
        found = (finding("six_face.short_faces", "warn"),)
    gravity = seen.session.gravity_m_s2
    if settings.mode != "paper" or not seen.settings.remove_offset:
        return Outcome(fit=fit_six_face(poses, gravity=gravity, settings=settings), method="six-face", findings=found)
    # Opposite faces cancel: the mean over the six, each counted once, is an estimate of the offset.
    faces = np.array(poses.faces)
    offset = np.mean([poses.reading[faces == face].mean(axis=0) for face in sorted(set(poses.faces))], axis=0)
    variance = np.full(3, np.nan) if poses.noise is None else (poses.noise**2).mean(axis=0) / len(faces)
    fit = fit_six_face(replace(poses, reading=poses.reading - offset), gravity=gravity, settings=settings)
    return Outcome(fit=with_offset(fit, offset, variance), method="six-face", findings=found)
