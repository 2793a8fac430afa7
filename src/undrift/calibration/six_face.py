"""Six faces: accelerometers against gravity, each face of the device up and down on a level plane.

The axis that points up reads +g: face "+x" is the column (g, 0, 0) of L, face "-x" is (-g, 0, 0). S holds the mean readings.

    paper      C = L S^T (S S^T)^-1                                                     eqs. 1-3 of the note; no offset
    affine     M s_p - c = g up_p + errors          12 parameters by least squares; o = M^-1 c
    levelled   the same, but the plane is level only to a tilt that is estimated

The errors of pose p, in the frame of the case:

    M n_p                          noise and rounding of the mean
    warmth_p (alpha + beta g up_p) offset and scale follow the temperature
    flicker                        of the offset, in common to poses that follow each other
    g d_p x up_p                   a face tilted by d reads g d across gravity, and g (1 - d^2 / 2) along it

The variance of the tilt is the excess of the residuals across gravity (fit/gls.py). What the cosine takes along gravity is
added to the covariance for a tilt of the estimated size.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import limited_by_codes, mean_rounding
from undrift.calibration.creep import Creep, creep_of, flicker_about_mean, in_case
from undrift.calibration.dwells import mountings
from undrift.calibration.norm import MG, QUADRATIC_SD
from undrift.calibration.plausibility import (
    SCALE_TOLERANCE,
    check_faces,
    check_gravity,
    check_handedness,
    check_own_scale,
    check_repeats,
    check_saturation,
    face_vectors,
    missing_faces,
)
from undrift.calibration.quality import whole_readings
from undrift.calibration.session import Observed, Outcome, spans_of, with_offset
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.equations import offset_of
from undrift.fit.gls import GlsFit, solve_inverse
from undrift.fit.least_squares import TriadFit, block_size, fit_paper, noise_of_means, offset_verdict, scaled_condition
from undrift.fit.priors import ACCEL_FLICKER
from undrift.model import Budget, TriadModel, Verdict
from undrift.record import Face, Record, Still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

# ---- fit of the face means

SixFaceMode = Literal["paper", "affine", "levelled"]

MIN_NOISE = 1e-12  # of the largest reading: no mean is known better than its arithmetic, however low the noise
TILT_LIMIT = 0.5 * RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaceMeans:
    """Mean readings of a device on its faces."""

    reading: FloatArray  # (P, 3), mean of each pose, ``unit``
    faces: tuple[Face, ...]  # axis that points up in each
    noise: FloatArray | None = None  # (P, 3), standard deviation of each mean, ``unit``; None if it is not known
    rounding: FloatArray | None = (
        None  # (3,), standard deviation that the codes leave in each mean, in ``noise`` too, ``unit``
    )
    unit: str = "m/s2"  # unit of the readings
    creep: Creep | None = None  # temperature of each pose
    flicker: FloatArray | None = None  # (P, P), covariance of the offset by flicker, (m/s2)^2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SixFaceFit(TriadFit):
    """A triad fitted to six faces."""

    # standard deviation of the faces' tilt about each horizontal axis, rad; 0 if not significant, NaN if not estimated
    tilt: float = float("nan")


def fit_six_face(poses: FaceMeans, *, gravity: float, mode: SixFaceMode = "levelled") -> SixFaceFit:
    """Fit accelerometers to mean readings of their faces."""
    _check(poses, gravity, mode)
    up = face_vectors(poses.faces)
    rank, condition = scaled_condition(np.column_stack((up, np.ones(len(up)))))
    if rank < 4:
        raise NotObservable(
            f"six faces: expected faces that span three axes and both signs, got rank {rank} of 4. Record the missing faces.",
            rank=rank,
        )
    start = np.linalg.inv(
        np.linalg.lstsq(np.column_stack((gravity * up, np.ones(len(up)))), poses.reading, rcond=None)[0][:3].T
    )
    sources = _sources(poses, up, gravity, start)
    level = _tilt_shape(up, gravity)
    known = poses.noise is not None
    shapes = {} if mode == "affine" else {"level": level}
    if not known:
        shapes = {"noise": np.full(3 * len(up), gravity**2)}
    fit = solve_inverse(poses.reading, gravity * up, None, start, sources, excess=shapes)
    tilt = float("nan")
    if known and mode != "affine":
        tilt = float(np.sqrt(fit.excess["level"])) if fit.shows("level") else 0.0
    verdict = Verdict.of(*_findings(poses, fit, sources, tilt, mode))
    if mode == "paper":
        in_common = _in_common(poses, up, gravity)
        paper = fit_paper(
            gravity * up,
            poses.reading,
            poses.noise,
            in_common,
            method="six-face/paper",
            unit_in=poses.unit,
            unit_out="m/s2",
        )
        verdict = offset_verdict(paper, gravity * up, poses.reading, poses.noise).also(verdict)
        model, residuals, tilt = paper.model, paper.residuals, float("nan")
    else:
        matrix, constant = fit.theta[:9].reshape(3, 3), fit.theta[9:]
        offset, jacobian = offset_of(matrix, constant, 12)
        parts = dict(fit.budget)
        if "level" in shapes:
            cosine = np.diag(np.repeat(fit.excess_bound("level"), 3 * len(up)) * gravity * np.abs(up.ravel())) ** 2
            parts["level"] = parts["level"] + fit.gains @ cosine @ fit.gains.T
        covariance = jacobian @ sum(parts.values()) @ jacobian.T
        variances = {name: np.diag(jacobian @ part @ jacobian.T) for name, part in parts.items()}
        residuals = -fit.residuals.reshape(-1, 3)
        model = TriadModel(
            matrix=matrix,
            offset=offset,
            covariance=covariance,
            budget=Budget.of(covariance, variances, "noise"),
            rms_residual=float(np.sqrt((residuals**2).mean())),
            count=residuals.size,
            rank=3 * rank,
            condition=condition,
            valid_range=(-gravity, gravity),
            method=f"six-face/{mode}",
            unit_in=poses.unit,
            unit_out="m/s2",
        )
    check_handedness(model.forward_matrix, "accelerometer")
    return SixFaceFit(model=model, residuals=residuals, verdict=verdict, tilt=tilt)


def _sources(poses: FaceMeans, up: FloatArray, gravity: float, matrix: FloatArray) -> dict[str, FloatArray]:
    """Return the stated covariances (3 P, 3 P) of the rows, (m/s2)^2; ``matrix`` takes readings to m/s2."""
    floor = MIN_NOISE * float(np.abs(poses.reading).max())
    noise = np.zeros(poses.reading.shape) if poses.noise is None else poses.noise
    rounding = np.minimum(np.zeros(3) if poses.rounding is None else poses.rounding, noise)
    own = np.eye(len(noise))[:, :, None]
    sources = {
        "noise": in_case(matrix, own * np.maximum(noise**2 - rounding**2, floor**2)[:, None]),
        "adc": in_case(matrix, own * np.broadcast_to(rounding**2, noise.shape)[:, None]),
    }
    if poses.creep is not None:
        sources["temperature"] = poses.creep.covariance_in_case(gravity * up)
    if poses.flicker is not None:
        sources["instability"] = np.kron(poses.flicker, np.eye(3))
    return sources


def _tilt_shape(up: FloatArray, gravity: float) -> FloatArray:
    """Return the variance (3 P,) of g d_p x up_p for a tilt d_p of 1 rad about each horizontal axis."""
    return np.asarray(gravity**2 * (1.0 - up.ravel() ** 2))


def _in_common(poses: FaceMeans, up: FloatArray, gravity: float) -> FloatArray:
    """Return the covariance (3, P, P) of what moves the readings of each sensor together, ``unit`` squared."""
    design = np.column_stack((gravity * up, np.ones(len(up))))
    gain = np.diag(np.linalg.lstsq(design, poses.reading, rcond=None)[0][:3])
    covariance = np.zeros((3, len(up), len(up)))
    for axis in range(3):
        if poses.creep is not None:
            covariance[axis] += poses.creep.covariance(gravity * up[:, axis], float(gain[axis]))
        if poses.flicker is not None:
            covariance[axis] += gain[axis] ** 2 * poses.flicker
    return covariance


def _findings(
    poses: FaceMeans, fit: GlsFit, sources: Mapping[str, FloatArray], tilt: float, mode: SixFaceMode
) -> Iterator[Finding]:
    if poses.rounding is not None and poses.noise is not None:
        yield from limited_by_codes("accelerometer", poses.rounding**2, (poses.noise**2).mean(axis=0), poses.unit)
    tilt_deg, spare = tilt / RADIAN_PER_DEGREE, len(fit.residuals) - 12
    if mode == "paper":  # the closed form assumes level faces, and so does its covariance
        if tilt > 0.0:
            yield finding("six_face.tilt_left_out", "warn", tilt_deg=tilt_deg, gain_share=tilt)
        return
    for face in missing_faces(poses.faces):
        yield finding("six_face.face_missing", "warn", face=face)
    if tilt > TILT_LIMIT:
        yield finding("six_face.tilt_large", "warn", tilt_deg=tilt_deg)
    elif tilt > 0.0:
        yield finding("six_face.tilt_small", "info", tilt_deg=tilt_deg)
    if mode == "affine" and poses.noise is not None and spare > 0:
        square = float(fit.residuals @ np.linalg.solve(sum(sources.values()), fit.residuals))
        if square >= 9.0 * spare:
            yield finding("six_face.scatter", "warn", ratio=(square / spare) ** 0.5)


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
        flicker = ACCEL_FLICKER**2 * flicker_about_mean(spans_of(records, cut))
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
        faces = np.array(poses.faces)
        in_common = _in_common(poses, face_vectors(poses.faces), seen.session.gravity_m_s2)
        share = np.array([1.0 / (faces == face).sum() for face in faces]) / len(set(poses.faces))
        offset = share @ poses.reading
        poses = replace(poses, reading=poses.reading - offset)
    fit: TriadFit = fit_six_face(poses, gravity=seen.session.gravity_m_s2, mode=used)  # type: ignore[arg-type]
    check_own_scale(fit.model.scale_factor, poses.unit, "accel", SCALE_TOLERANCE, "accelerometer")
    if offset is not None:
        variance = np.full(3, np.nan) if poses.noise is None else (poses.noise**2).mean(axis=0) / len(poses.faces)
        variance = variance + in_common @ share @ share
        fit = with_offset(fit, offset, variance)
    return Outcome(fit=fit, method="six-face", findings=findings, used=seen.faced)


def _by_mounting(seen: Observed, poses: FaceMeans) -> FaceMeans:
    """Average the rests that were recorded in one mounting: on one face with no other rest between, or on a rate table.

    Rests on a rate table are left out if the other rests show all six faces: a device is mounted on a table less squarely than it
    stands on a plate, and what the accelerometers feel there measures the mounting.
    """
    turns = [turn for turn in seen.session.turns if turn.turn_rate is not None]
    table = mountings([*seen.faced, *turns])[: len(poses.faces)]
    placement = [n if one.face is not None else -1 for n, one in enumerate(seen.stills)]
    for n, (before, after) in enumerate(pairwise(seen.stills), 1):
        if placement[n] >= 0 and (before.face, before.recording) == (after.face, after.recording):
            placement[n] = placement[n - 1]
    plate = np.where(table < 0, [n for n in placement if n >= 0], -1)
    groups = [np.flatnonzero(plate == n) for n in np.unique(plate[plate >= 0])]
    if missing_faces([face for face, mounting in zip(poses.faces, table, strict=True) if mounting < 0]):
        groups += [np.flatnonzero(table == mounting) for mounting in np.unique(table[table >= 0])]
    if poses.noise is None or len(groups) == len(poses.faces):
        return poses
    weight = 1.0 / np.maximum(poses.noise, 1e-300) ** 2
    to_group = np.zeros((len(groups), len(poses.faces)))  # mean over the rests of a mounting
    for number, rows in enumerate(groups):
        to_group[number, rows] = weight[rows].mean(axis=1) / weight[rows].mean(axis=1).sum()
    return replace(
        poses,
        reading=np.array([np.average(poses.reading[rows], axis=0, weights=weight[rows]) for rows in groups]),
        faces=tuple(poses.faces[rows[0]] for rows in groups),
        noise=np.array([weight[rows].sum(axis=0) ** -0.5 for rows in groups]),
        creep=poses.creep and replace(poses.creep, warmth=to_group @ poses.creep.warmth),
        flicker=None if poses.flicker is None else to_group @ poses.flicker @ to_group.T,
    )
