"""Six faces: accelerometers against gravity, each face of the device up and down on a level plane.

The axis that points up reads +g: face "+x" is the column (g, 0, 0) of L, face "-x" is (-g, 0, 0). S holds the mean readings.

    paper      C = L S^T (S S^T)^-1                                                     eqs. 1-3 of the note; no offset
    affine     s = K a + b by least squares, 12 parameters
    levelled   the same, but the plane is level only to sigma_tilt, which is estimated

A face that is tilted by d reads g d on the two axes that should read nothing and g (1 - d^2 / 2) on its own. So the on-axis
equations keep the sigma of the noise, and the cross-axis ones have hypot(noise, g sigma_tilt), along the axes of the case:
the readings are corrected by an affine fit first. What the spare equations (six of them for six faces) say about sigma_tilt
is not much, so that the fit is averaged over what they allow (tilt.py). Its 95 % intervals hold 93-97 % at any tilt, the
least where tilt and noise are alike and hard to tell apart.

Tilt of the faces: how far from level were they, judged by the spare equations of a six-face fit, and the fit that allows for it.

Equation (p, i) of pose p and axis i of the case has the standard deviation::

    own axis     hypot(noise, g tilt^2)          the cosine of the tilt
    cross axis   hypot(noise, g tilt)            the sine

This holds along the axes of the case. A sensor leans by a per cent against them and sees a per cent of the sine on its own
face, which can be more than the noise. So a plain fit corrects the readings first, and the tilt is judged by those::

    a = M0 (s - b0)              K0, b0 by plain least squares, M0 = K0^-1
    a = K1 up + b1               weighted;  K = K0 K1,  b = K0 b1 + b0

The restricted likelihood of a tilt is that of all rows together::

    log L = -1/2 [ sum log sigma^2 + log det A^T W A + r^T W r ]

It has six spare equations of six faces to go by, so that no single tilt is taken: the parameters are averages over every tilt,
and their covariance is that of the error over every tilt that L allows::

    theta = E1 theta(tilt)       covariance = E0 C(tilt) + E0 (theta(tilt) - theta)(theta(tilt) - theta)'

E0 weighs by L / (tilt + noise / g), which leaves room for a tilt as small as the noise; E1 by L / (tilt + 0.1 noise / g), which
leans toward level faces and so loses nothing on them. Where L is greatest at no tilt at all, the faces count as level, and
the fit is plain least squares, which is then the best there is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.checks import (
    check_faces,
    check_gravity,
    check_handedness,
    check_pose_count,
    check_saturation,
    check_scale_factor,
    face_vectors,
    missing_faces,
)
from undrift.errors import InputError, NotObservable
from undrift.fit.least_squares import (
    ForwardFit,
    TriadFit,
    block_size,
    fit_forward,
    fit_paper,
    noise_of_means,
    offset_warning,
    triad_from_forward,
)
from undrift.model import Verdict
from undrift.record import Face, Record, Still
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

# ---- Tilt of the faces: how far from level were they, judged by the spare equations of a six-face fit, and the fit that
# allows for it.

_EVIDENCE = 2.0  # twice the log-likelihood that a tilt must gain to be told: 8 % false alarms on a level plane
_LARGEST = 0.2  # rad
_GRID = 120
_QUIET = 0.1  # noise / g: the tilt that E1 takes for none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Tilted:
    """Fits at T tilts: theta (T, 12) as K row by row, then b; covariance (T, 12, 12); log L (T,)."""

    tilts: FloatArray
    theta: FloatArray
    covariance: FloatArray
    likelihood: FloatArray


def fit_tilted(up: FloatArray, reading: FloatArray, noise: FloatArray, plain: ForwardFit) -> tuple[ForwardFit, float]:
    """Fit faces whose tilt is not known.

    Arrays: up (P, 3) m/s2, reading (P, 3), noise (P, 3) unit of the readings.
    """
    inverse = np.linalg.inv(plain.matrix)
    level = (reading - plain.offset) @ inverse.T
    sigma = np.sqrt(noise**2 @ (inverse**2).T)
    gravity = float(np.linalg.norm(up, axis=1).max())
    found = _solved(up, level, sigma, np.full(3, gravity))
    if reading.size <= 12 or int(np.argmax(found.likelihood)) == 0:
        return plain, 0.0
    small = float(np.median(sigma)) / gravity
    held, likely = _shares(found, small), _shares(found, _QUIET * small)
    theta = likely @ found.theta
    apart = found.theta - theta
    covariance = np.einsum("t,tij->ij", held, found.covariance) + (held[:, None] * apart).T @ apart
    jacobian = np.zeros((12, 12))
    jacobian[:9, :9], jacobian[9:, 9:] = np.kron(plain.matrix, np.eye(3)), plain.matrix
    matrix = plain.matrix @ theta[:9].reshape(3, 3)
    offset = plain.matrix @ theta[9:] + plain.offset
    fit = ForwardFit(
        matrix=matrix,
        offset=offset,
        covariance=jacobian @ covariance @ jacobian.T,
        residuals=reading - up @ matrix.T - offset,
        rank=plain.rank,
        condition=plain.condition,
    )
    return fit, _told(found)


def estimate_tilt(up: FloatArray, reading: FloatArray, noise: FloatArray, gain: FloatArray) -> float:
    """Estimate the standard deviation of the faces' tilt.

    Arrays: up (P, 3) m/s2, reading (P, 3), noise (P, 3) unit of the readings, gain (3,).
    """
    return 0.0 if reading.size <= 12 else _told(_solved(up, reading, noise, gain))


def tilted_sigma(up: FloatArray, noise: FloatArray, gain: FloatArray, tilt: float) -> FloatArray:
    """Return the standard deviation of every equation for faces tilted by so much.

    Arrays: up (P, 3), noise (P, 3) unit of the readings, gain (3,) -> (P, 3).
    """
    return np.asarray(np.hypot(noise, gain * np.where(up != 0.0, tilt * tilt, tilt)))


def _shares(found: _Tilted, small: float) -> FloatArray:
    step = np.gradient(found.tilts)
    step[[0, -1]] *= 0.5  # trapezoids
    share = np.exp(found.likelihood - found.likelihood.max()) * step / (found.tilts + small)
    return np.asarray(share / share.sum())


def _told(found: _Tilted) -> float:
    tilts, likelihood = found.tilts, found.likelihood
    best = int(np.argmax(likelihood))
    if 2.0 * (likelihood[best] - likelihood[0]) < _EVIDENCE or best == 0:
        return 0.0
    if best == len(tilts) - 1:
        return float(tilts[best])
    left, middle, right = likelihood[best - 1 : best + 2]
    bend = left - 2.0 * middle + right  # parabola through three points of a geometric grid
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(tilts[best] * (tilts[best + 1] / tilts[best]) ** np.clip(shift, -1.0, 1.0))


def _solved(up: FloatArray, reading: FloatArray, noise: FloatArray, gain: FloatArray) -> _Tilted:
    # Weighted least squares of the three rows for every tilt of a grid at once.
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
    return _Tilted(tilts=tilts, theta=theta, covariance=covariance, likelihood=likelihood)


# ---- six face

SixFaceMode = Literal["paper", "affine", "levelled"]

_ROUNDING = 1e-12  # of the largest reading: no mean is known better than its arithmetic, however quiet the device
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

    # Standard deviation of the faces' tilt about each horizontal axis, rad; 0 where it does not show, NaN where the
    # mode does not estimate it
    tilt: float = float("nan")


def fit_six_face(poses: FaceMeans, *, gravity: float, settings: SixFaceSettings = SixFaceSettings()) -> SixFaceFit:
    """Fit accelerometers to mean readings of their faces."""
    _check(poses, gravity, settings)
    up = gravity * face_vectors(poses.faces)
    method = f"six-face/{settings.mode}"
    if settings.mode == "paper":
        fit = fit_paper(up, poses.reading, poses.noise, method=method, unit_in=poses.unit, unit_out="m/s2")
        said = offset_warning(fit, up, poses.reading, poses.noise).also(_untold_tilt(poses, up))
        fit = SixFaceFit(model=fit.model, residuals=fit.residuals, verdict=said)
    else:
        forward, tilt, verdict = _affine(poses, up, gravity, settings)
        plain = triad_from_forward(
            forward,
            method=method,
            unit_in=poses.unit,
            unit_out="m/s2",
            valid_range=(-gravity, gravity),
            verdict=verdict,
        )
        fit = SixFaceFit(model=plain.model, residuals=plain.residuals, verdict=plain.verdict, tilt=tilt)
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
        window = _middle(record, still, settings.window_s)
        if len(window) <= settings.polynomial_degree + 1:
            raise InputError(
                f"six faces: wanted more than {settings.polynomial_degree + 1} readings on face {still.face}, got {len(window)}; "
                "choose another stretch"
            )
        check_saturation(window, f"accelerometer on face {still.face}")
        filtered, wander = polynomial_filter(window, settings.polynomial_degree)
        means.append(filtered.mean(axis=0))
        windows.append(wander)
        sizes.append(block_size(record.sample_rate_hz))
        faces.append(still.face)
    noise = noise_of_means(windows, sizes, removed=settings.polynomial_degree + 1)
    return FaceMeans(reading=np.array(means).reshape(-1, 3), faces=tuple(faces), noise=noise, unit=unit)


def polynomial_filter(values: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Fit a polynomial in time to each column.

    Arrays: values (N, 3) -> (N, 3), (N, 3).
    """
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(values)), degree)
    filtered = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return filtered, values - filtered


def _check(poses: FaceMeans, gravity: float, settings: SixFaceSettings) -> None:
    if poses.reading.shape != (len(poses.faces), 3):
        raise InputError(
            f"six faces: wanted one reading (3,) for each of {len(poses.faces)} faces, got {poses.reading.shape}"
        )
    check_pose_count(len(poses.faces), 5, "labelled faces")
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


def _affine(
    poses: FaceMeans, up: FloatArray, gravity: float, settings: SixFaceSettings
) -> tuple[ForwardFit, float, Verdict]:
    reading, noise = poses.reading, poses.noise
    missing = missing_faces(poses.faces)
    verdict = Verdict()
    if missing:
        verdict = Verdict(
            status="marginal",
            remarks=(f"face {missing[0]} is missing: its axis leans on the offset of the others; record it",),
        )
    if noise is not None:
        noise = np.maximum(noise, _ROUNDING * np.abs(reading).max())
    plain = fit_forward(up, reading, noise)
    if settings.mode == "affine" or noise is None:
        return plain, float("nan"), verdict.also(_excess(plain, noise))
    forward, tilt = fit_tilted(up, reading, noise, plain)
    return forward, tilt, verdict.also(_tilt_verdict(tilt))


def _tilt_verdict(tilt: float) -> Verdict:
    if tilt == 0.0:
        return Verdict()
    degrees = tilt / RADIAN_PER_DEGREE
    if tilt > _LARGE_TILT:
        told = (
            f"the faces are tilted by {degrees:.2f} deg (1 sigma) against the plane or each other; six faces cannot tell that from "
            "misaligned sensors, and the uncertainty of the cross-axis terms holds it: true the box and its seat, or rest in nine "
            "or more free poses instead"
        )
        return Verdict(status="marginal", remarks=(told,))
    told = f"the faces lie level among themselves within {degrees:.1g} deg (1 sigma), which the cross-axis terms' uncertainty holds"
    return Verdict(remarks=(told,))


def _untold_tilt(poses: FaceMeans, up: FloatArray) -> Verdict:
    # The closed form takes the faces for level, and so does its covariance.
    if poses.noise is None:
        return Verdict()
    noise = np.maximum(poses.noise, _ROUNDING * np.abs(poses.reading).max())
    tilt = fit_tilted(up, poses.reading, noise, fit_forward(up, poses.reading, noise))[1]
    if tilt == 0.0:
        return Verdict()
    told = (
        f"mode paper takes the faces for level, and they are tilted by {tilt / RADIAN_PER_DEGREE:.2g} deg (1 sigma) against the "
        f"plane or each other: the off-diagonal terms are uncertain by about {tilt:.2g} of the gain, which their stated "
        "uncertainty leaves out; use mode levelled"
    )
    return Verdict(status="marginal", remarks=(told,))


def _excess(plain: ForwardFit, noise: FloatArray | None) -> Verdict:
    spare = plain.residuals.size - 12
    if noise is None or spare < 1:
        return Verdict()
    ratio = float(np.sqrt(((plain.residuals / noise) ** 2).sum() / spare))
    if ratio < 3.0:
        return Verdict()
    return Verdict(
        status="marginal",
        remarks=(
            f"residuals are {ratio:.1f} times the noise of the means: the faces were not level, and the uncertainty stated leaves "
            "that out; use mode levelled",
        ),
    )


def _middle(record: Record, still: Still, window_s: float) -> FloatArray:
    window = record.accel[still.start : still.stop] if record.accel is not None else np.empty((0, 3))
    wanted = max(2, round(window_s * record.sample_rate_hz))
    skip = max(0, (len(window) - wanted) // 2)
    window = window[skip : skip + wanted]
    return window[~np.isnan(window).any(axis=1)]
