"""Calibrate accelerometers on six faces: gravity, with each face of the device up and down on a level plane.

The sensor on the axis that points up reads +g. Face "+x" is the column (g, 0, 0) of L, face "-x" is (-g, 0, 0). S contains the mean
readings.

    paper      C = L S' (S S')^-1                                                       eqs. 1-3 of the note, without an offset
    affine     M s_p - c = g up_p + errors          12 parameters by least squares, o = M^-1 c

Sources of error of pose p, in the frame of the case:

    M n_p                          noise and rounding of the mean
    warmth_p (alpha + beta g up_p) dependence of offset and scale on temperature
    flicker                        flicker of the offset, common to consecutive poses
    g d_p x up_p                   a face tilted by d reads g d across gravity, and g (1 - d^2 / 2) along it

The excess variance of the residuals across gravity is the variance of the tilt (fit/gls.py). Rests in the same placement have the
same tilt. The covariance along gravity includes the cosine error for a tilt of the estimated size.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.codes import limited_by_codes, mean_rounding
from undrift.calibration.plausibility import (
    check_faces,
    check_gravity,
    check_own_scale,
    check_range,
    face_vectors,
    missing_faces,
)
from undrift.calibration.quality import whole_readings
from undrift.calibration.session import Observed, spans_of, with_offset
from undrift.calibration.settings import Mode
from undrift.calibration.sources import Creep, creep_of, flicker_about_mean, noise_and_codes
from undrift.calibration.table import mountings
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.gls import GlsFit, block_size, carried, noise_of_means, solve_inverse, student_factor
from undrift.fit.priors import ACCEL_FLICKER
from undrift.fit.triad import TriadFit, first_matrix, fit_of, fit_paper, parameters_of
from undrift.record import Face, Record, Still
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

# ---- fit of the face means

MIN_NOISE = 1e-12  # relative to the largest reading, the arithmetic error of a mean
TILT_LIMIT = 0.5 * RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaceMeans:
    """Mean readings of a device on its faces."""

    reading: FloatArray  # (P, 3), mean of each pose, ``unit``
    faces: tuple[Face, ...]  # axis that points up in each pose
    noise: FloatArray | None = None  # (P, 3), standard deviation of each mean, ``unit``, or None if unknown
    # (3,), standard deviation of each mean due to the codes, included in ``noise``, ``unit``
    rounding: FloatArray | None = None
    unit: str = "m/s2"  # unit of the readings
    creep: Creep | None = None  # temperature of each pose, degC
    flicker: FloatArray | None = None  # (P, P), covariance of the offset by flicker, (m/s2)^2
    placement: IntArray | None = None  # (P,), number of the placement of each pose, or None if every pose has its own


def fit_six_face(poses: FaceMeans, *, gravity: float, mode: Mode = "affine") -> TriadFit:
    """Fit accelerometers to mean readings of their faces."""
    inputs, gls = gravity * face_vectors(poses.faces), solve_faces(poses, gravity, mode)
    tilt = gls.excess.get("level", 0.0) ** 0.5
    names: dict[str, Any] = {"method": f"six-face/{mode}", "unit_in": poses.unit, "unit_out": "m/s2"}
    findings = list[Finding]()
    if poses.noise is None:
        too_short = (
            "Rests on the faces are too short to estimate their noise: the scatter of the residuals is used instead."
        )
        findings.append(finding("six_face.short_faces", "warn", too_short, "Rest 6 s on each face."))
    elif poses.rounding is not None:
        findings += limited_by_codes("accelerometer", poses.rounding**2, (poses.noise**2).mean(axis=0), poses.unit)
    if tilt > TILT_LIMIT:
        tilt_deg = tilt / RADIAN_PER_DEGREE
        findings.append(
            finding(
                "six_face.tilt",
                "warn",
                f"The faces are tilted by {tilt_deg:.2f} deg (1 sigma). Six faces cannot distinguish this from misaligned sensors.",
                "Align the fixture, or rest in nine or more free poses.",
                tilt_deg=tilt_deg,
            )
        )
    if mode == "paper":
        fit = fit_paper(inputs, poses.reading, gls, **names)
    else:
        fit = fit_of(parameters_of(gls), inputs, -gls.residuals.reshape(-1, 3), **names)
    return fit.also(*findings)


def solve_faces(poses: FaceMeans, gravity: float, mode: Mode = "affine") -> GlsFit:
    """Return the fit of M and c, and the covariances of its rows, (m/s2)^2. Its excess ``level`` is the variance of the tilt."""
    _check(poses, gravity, mode)
    up = face_vectors(poses.faces)
    inputs = gravity * up
    matrix, floor = first_matrix(inputs, poses.reading), MIN_NOISE * float(np.abs(poses.reading).max())
    noise = np.zeros(poses.reading.shape) if poses.noise is None else poses.noise
    rounding = np.minimum(np.zeros(3) if poses.rounding is None else poses.rounding, noise)
    sources = noise_and_codes(matrix, np.maximum(noise**2 - rounding**2, floor**2), rounding**2)
    if poses.creep is not None:
        sources["temperature"] = poses.creep.covariance_in_case(inputs)
    if poses.flicker is not None:
        sources["instability"] = np.kron(poses.flicker, np.eye(3))
    if poses.noise is None:
        return solve_inverse(
            poses.reading, inputs, None, matrix, sources, excess={"noise": np.full(3 * len(up), gravity**2)}
        )
    # g d_p x up_p for a tilt of 1 rad about each horizontal axis
    placement = np.arange(len(up)) if poses.placement is None else poses.placement
    across = gravity * np.sqrt(1.0 - up.ravel() ** 2)
    shape = np.kron(placement[:, None] == placement, np.eye(3)) * np.outer(across, across)
    fit = solve_inverse(poses.reading, inputs, None, matrix, sources, excess={"level": shape})
    tilt_variance = fit.excess["level"] * student_factor(fit.freedom["level"])
    cosine = np.diag((tilt_variance * inputs.ravel()) ** 2)
    budget = {**fit.budget, "level": fit.budget["level"] + carried(fit.gains, cosine)}
    sources = {**fit.sources, "level": fit.sources["level"] + cosine}
    return replace(fit, sources=sources, budget=budget, covariance=np.sum([*budget.values()], axis=0))


def face_means(
    records: Sequence[Record], stills: Sequence[Still], *, window_s: float = 6.0, polynomial_degree: int = 1
) -> FaceMeans:
    """Filter the middle ``window_s`` of each labelled still phase with a polynomial in time, and average it."""
    unit = records[stills[0].recording].accel_unit if stills else "m/s2"
    middles = list[Still]()
    for still in (still for still in stills if still.face is not None):
        wanted = max(2, round(window_s * records[still.recording].sample_rate_hz))
        start = still.start + max(0, (still.stop - still.start - wanted) // 2)
        middles.append(replace(still, start=start, stop=min(still.stop, start + wanted)))
    windows = [_window(records[still.recording], still, polynomial_degree) for still in middles]
    filtered = [polynomial_filter(window, polynomial_degree) for window in windows]
    sizes = [block_size(records[still.recording].sample_rate_hz) for still in middles]
    noise = noise_of_means([rest for _, rest in filtered], sizes, removed=polynomial_degree + 1)
    every = [np.asarray(records[k].accel) for k in {still.recording for still in middles}]
    rounding = mean_rounding(every, [rest for _, rest in filtered]) if middles else np.zeros(3)
    return FaceMeans(
        reading=np.array([smooth.mean(axis=0) for smooth, _ in filtered]).reshape(-1, 3),
        faces=tuple(still.face for still in middles if still.face is not None),
        noise=None if noise is None else np.hypot(noise, rounding),
        rounding=rounding,
        unit=unit,
        flicker=ACCEL_FLICKER**2 * flicker_about_mean(spans_of(records, middles)) if middles else None,
    )


def _window(record: Record, still: Still, degree: int) -> FloatArray:
    window = whole_readings(record.accel, still.start, still.stop)
    if len(window) <= degree + 1:
        raise InputError(
            f"six faces: expected more than {degree + 1} readings on face {still.face}, got {len(window)}. "
            "Choose another stretch."
        )
    check_range([window], f"accelerometer on face {still.face}")
    return window


def polynomial_filter(values: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Fit a polynomial in time to each column: values (N, 3) -> (N, 3), (N, 3)."""
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(values)), degree)
    filtered = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return filtered, values - filtered


def _check(poses: FaceMeans, gravity: float, mode: Mode) -> None:
    missing = missing_faces(poses.faces)
    if len(poses.faces) >= 5:
        if is_physical(poses.unit):
            check_gravity(poses.reading * si_factor(poses.unit, "accel"), gravity)
        check_faces(poses.reading, poses.faces)
    if len(missing) > (0 if mode == "paper" else 1):
        raise NotObservable(
            f"six faces: {', '.join(missing)} missing. Record the missing faces.",
            missing=missing,
        )


# ---- from a session


def calibrate_faces(observed: Observed, mode: Mode, accel: TriadFit | None = None) -> TriadFit:
    """Fit the accelerometer of a session to its faces."""
    settings, gravity = observed.settings, observed.session.gravity_m_s2
    paper, offset = mode == "paper", None
    stills, placement = (observed.faced, None) if paper else _placements(observed)
    poses = face_means(
        observed.session.records, stills, window_s=settings.window_s, polynomial_degree=settings.polynomial_degree
    )
    poses = replace(poses, creep=creep_of(observed, stills, "accel"), placement=placement)
    if paper:
        # The mean over the six faces, each with the same weight, estimates the offset, because opposite faces cancel.
        faces, rows = np.array(poses.faces), solve_faces(poses, gravity, "paper")
        share = np.array([1.0 / (faces == face).sum() for face in faces]) / len(set(poses.faces))
        mean = np.kron(share, np.linalg.inv(rows.theta[:9].reshape(3, 3)))
        variance, offset = np.diag(mean @ np.sum([*rows.sources.values()], axis=0) @ mean.T), share @ poses.reading
        poses = replace(poses, reading=poses.reading - offset)
    fit = fit_six_face(poses, gravity=gravity, mode=mode)
    check_own_scale(fit.model.scale_factor, poses.unit, "accel", "accelerometer")
    if offset is not None:
        fit = with_offset(fit, offset, variance)
    return fit


def _placements(observed: Observed) -> tuple[tuple[Still, ...], IntArray]:
    """Return the rests on faces that are used, and the number of the placement of each.

    Rests on the same face without another rest between them, or in the same mounting on a rate table, are one placement. Rests on a
    rate table are omitted if the other rests cover all six faces, because a mounting on a table is less square than a plate.
    """
    turns = [turn for turn in observed.session.turns if turn.turn_rate is not None]
    table = mountings([*observed.stills, *turns])[: len(observed.stills)]
    faces = [(still.face, still.recording) for still in observed.stills]
    changes = [n > 0 and faces[n] != faces[n - 1] for n in range(len(faces))]
    placement = np.where(table < 0, np.cumsum(changes), -1 - table)
    used = [n for n, still in enumerate(observed.stills) if still.face is not None]
    plate = [n for n in used if table[n] < 0]
    if not missing_faces([face for n in plate if (face := observed.stills[n].face) is not None]):
        used = plate
    return tuple(observed.stills[n] for n in used), placement[used]
