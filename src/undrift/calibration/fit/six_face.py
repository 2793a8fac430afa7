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
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.linear import (
    ForwardFit,
    fit_forward,
    fit_paper,
    offset_warning,
    triad_from_forward,
)
from undrift.calibration.fit.noise import block_size, noise_of_means
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.fit.tilt import fit_tilted
from undrift.calibration.model import Verdict
from undrift.calibration.plausibility import (
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
from undrift.record import Record
from undrift.session import Face, Still
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

SixFaceMode = Literal["paper", "affine", "levelled"]

_ROUNDING = 1e-12  # of the largest reading: no mean is known better than its arithmetic, however quiet the device
_LARGE_TILT = 0.5 * RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True)
class SixFaceSettings:
    """How a six-face session is read and fitted.

    Parameters
    ----------
    mode : str
        paper, affine or levelled.
    window_s : float
        Longest stretch used from the middle of each still phase, s. The note takes 6 s.
    polynomial_degree : int
        Degree of the polynomial in time that filters each window before it is averaged.
    stated_scale : float or None
        Sensitivity the maker states, reading per m/s2; None leaves it unchecked.
    scale_tolerance : float
        Relative tolerance of ``stated_scale``.
    """

    mode: SixFaceMode = "levelled"
    window_s: float = 6.0
    polynomial_degree: int = 1
    stated_scale: float | None = None
    scale_tolerance: float = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaceMeans:
    """Mean readings of a device on its faces.

    Parameters
    ----------
    reading : array, shape (P, 3)
        Mean of each pose, ``unit``.
    faces : tuple of str
        Axis that points up in each.
    noise : array, shape (P, 3), or None
        Standard deviation of each mean, ``unit``; None when it is not known.
    unit : str
        Unit of the readings.
    """

    reading: FloatArray
    faces: tuple[Face, ...]
    noise: FloatArray | None = None
    unit: str = "m/s2"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SixFaceFit(TriadFit):
    """A triad fitted to six faces.

    Parameters
    ----------
    tilt : float
        Standard deviation of the faces' tilt about each horizontal axis, rad; 0 where it does not show, NaN where the mode
        does not estimate it.
    """

    tilt: float = float("nan")


def fit_six_face(poses: FaceMeans, *, gravity: float, settings: SixFaceSettings = SixFaceSettings()) -> SixFaceFit:
    """Fit accelerometers to mean readings of their faces.

    Parameters
    ----------
    poses : FaceMeans
        Six faces or more; repeats are welcome, one missing face is allowed except in mode paper.
    gravity : float
        Local gravity, m/s2.
    settings : SixFaceSettings
        Mode and checks.

    Returns
    -------
    SixFaceFit
        Inverse model, counts (or whatever the readings are) to m/s2.

    Raises
    ------
    NotObservable
        Faces are missing.
    Implausible
        Labels that contradict the readings, a wrong unit, a scale factor off its stated sensitivity.
    InputError
        Mode levelled without the noise of the means.
    """
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
    """Filter and average the labelled still phases of a session.

    A polynomial in time is fitted to the middle ``window_s`` of each phase and averaged, as the note says. The mean of a
    least-squares polynomial equals the sample mean, so the filter changes the mean by rounding alone; what it does is to
    keep a slow drift out of the noise estimate, which comes from means of half a second pooled over all phases.

    Parameters
    ----------
    records : sequence of Record
        Recordings of the session, one accelerometer unit.
    stills : sequence of Still
        Phases; those without a face are left out.
    settings : SixFaceSettings
        Window and polynomial degree.

    Returns
    -------
    FaceMeans
        Means with their noise.

    Raises
    ------
    InputError
        No accelerometer, or units that differ between recordings.
    Implausible
        Saturated samples.
    """
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

    Parameters
    ----------
    values : array, shape (N, 3)
        Evenly sampled readings.
    degree : int
        Of the polynomial; 0 is the plain mean.

    Returns
    -------
    filtered : array, shape (N, 3)
        The polynomial at each sample.
    residual : array, shape (N, 3)
        What it leaves.
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
            reasons=(f"face {missing[0]} is missing: its axis leans on the offset of the others; record it",),
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
        return Verdict(status="marginal", reasons=(told,))
    told = f"the faces lie level among themselves within {degrees:.1g} deg (1 sigma), which the cross-axis terms' uncertainty holds"
    return Verdict(reasons=(told,))


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
    return Verdict(status="marginal", reasons=(told,))


def _excess(plain: ForwardFit, noise: FloatArray | None) -> Verdict:
    spare = plain.residuals.size - 12
    if noise is None or spare < 1:
        return Verdict()
    ratio = float(np.sqrt(((plain.residuals / noise) ** 2).sum() / spare))
    if ratio < 3.0:
        return Verdict()
    return Verdict(
        status="marginal",
        reasons=(
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
