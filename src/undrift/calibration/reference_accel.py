"""Calibrate accelerometers against an orientation reference, from rests at known attitudes.

    M u - c = R' g z + e          mean reading u of a rest, pose R in the body of the gyroscope fit, c = M o

The errors e are noise, codes, flicker and temperature as for six faces, a tilt of the reference's level of known size, and a tilt
of each pose. Flicker and tilt of a pose have excess variances. Motion is not used, so six rests or more must determine M and c. The
offset applies at the mean temperature of the recordings, although the rests may all be at one end of the temperature range.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import limited_by_codes, mean_rounding
from undrift.calibration.plausibility import without_saturated
from undrift.calibration.quality import whole_readings
from undrift.calibration.reference import RECORD_LONGER
from undrift.calibration.session import Observed, spans_of
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.sources import creep_of, flicker_about_mean, noise_and_codes, uncertain
from undrift.errors import InputError, NotObservable
from undrift.fit.gls import block_size, noise_of_means, solve_inverse
from undrift.fit.priors import ACCEL_FLICKER, REFERENCE_LEVEL
from undrift.fit.triad import TriadFit, first_matrix, fit_of, nominal_triad, parameters_of
from undrift.frames import rotation
from undrift.model import TriadModel
from undrift.record import Record, Reference, Session, Still
from undrift.segments import find_still
from undrift.sync import native_poses
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

MIN_RESTS = 6  # smallest number of rests whose residuals determine the tilt of the poses
NOMINAL_SCALE, NOMINAL_OFFSET = 0.05, 0.5  # uncertainty without a fit: relative scale, offset in m/s2. Assumed.
MAX_CONDITION = 20.0  # largest condition number of the design from attitudes and a constant (2 for six faces)
MIN_NOISE = 1e-9  # relative to the largest reading, the arithmetic error of a mean
WANTED_PERCENT = (0.5, np.inf)  # limits of the uncertainty of the matrix
TURNED_ABOVE = 5.0 * RADIAN_PER_DEGREE  # smallest angle between gyroscopes and the body of the reference


def turned_like(gyro: TriadModel, unit: str) -> TriadModel | None:
    """Return nominal accelerometers in the body of the gyroscope fit, or None for counts or if the body is the device itself."""
    u, _, right = np.linalg.svd(gyro.matrix)
    turn = u @ right
    if not is_physical(unit) or np.trace(turn) > 1.0 + 2.0 * np.cos(TURNED_ABOVE):
        return None
    factor = si_factor(unit, "accel")
    covariance = np.diag([(NOMINAL_SCALE * factor) ** 2] * 9 + [(NOMINAL_OFFSET / factor) ** 2] * 3)
    return nominal_triad(unit, "accel", turn=turn, covariance=covariance)


def fit_reference_accel(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    mountings: FloatArray,
    gravity_m_s2: float,
    lags_s: FloatArray,
) -> TriadFit:
    """Fit scale, cross-axis terms and offset of the accelerometers of a device to rests at known attitudes.

    ``mountings`` (R, 3), rad, and ``lags_s`` (R,) come from the gyroscope fit. Raise NotObservable if there are too few attitudes.
    """
    from scipy.linalg import block_diag
    from scipy.spatial.transform import Rotation

    unit = records[0].accel_unit
    if any(record.accel is None or record.accel_unit != unit for record in records):
        raise InputError("reference: all recordings need accelerometers in one unit. Map them.")
    records = [without_saturated(record)[0] for record in records]
    stills, windows, bodies = list[Still](), list[FloatArray](), list[FloatArray]()  # R: mean body to level
    for number, (record, reference) in enumerate(zip(records, references, strict=True)):
        poses_in_view, mounting = native_poses(reference), Rotation.from_rotvec(mountings[number])
        for still in find_still(record, recording=number).stills:
            start_s, stop_s = record.time[[still.start, still.stop - 1]] - lags_s[number]
            during = poses_in_view.valid & (poses_in_view.time >= start_s) & (poses_in_view.time <= stop_s)
            window = whole_readings(record.accel, still.start, still.stop)
            if during.any() and len(window) > 1:
                stills.append(still)
                windows.append(window)
                bodies.append((rotation(poses_in_view.q_nb[during]).mean() * mounting).as_matrix())
    body = np.reshape(bodies, (-1, 3, 3))
    up = body[:, 2]
    if len(stills) < MIN_RESTS or np.linalg.cond(np.column_stack((up, np.ones(len(up))))) > MAX_CONDITION:
        raise NotObservable(
            f"reference: {len(stills)} rests with poses do not determine the accelerometers. Let the device rest for 3 s on each "
            "of its six sides in view of the reference, or calibrate with six faces.",
            rests=len(stills),
        )
    reading, force = np.array([window.mean(axis=0) for window in windows]), gravity_m_s2 * up
    matrix = first_matrix(force, reading)
    sources = _sources(records, stills, windows, matrix, force, gravity_m_s2)
    # effect of a tilt of 1 rad on the force: tilt of each pose, and tilt of the reference's level in all rests together
    tilt = block_diag(*(gravity_m_s2**2 * (np.eye(3) - up[:, :, None] * up[:, None, :])))
    level = REFERENCE_LEVEL * gravity_m_s2 * np.swapaxes(body[:, :2], 1, 2).reshape(-1, 2)
    excess = {"level": tilt, "instability": sources["instability"] / ACCEL_FLICKER**2}
    fit = solve_inverse(reading, force, None, matrix, sources | {"level": level @ level.T}, excess=excess)
    residuals = -fit.residuals.reshape(-1, 3)
    fitted = fit_of(parameters_of(fit), force, residuals, method="reference", unit_in=unit, unit_out="m/s2")
    noise, codes = (np.diag(sources[name]).reshape(-1, 3).mean(axis=0) for name in ("noise", "adc"))
    findings = [*limited_by_codes("accelerometer", codes, noise + codes, "m/s2")]
    percent = 100.0 * float((fitted.model.standard_uncertainty[:9] / np.linalg.norm(fitted.model.matrix, 2)).max())
    findings += uncertain("The accelerometer matrix", percent, WANTED_PERCENT, "%", RECORD_LONGER)
    return fitted.also(*findings)


def _sources(
    records: Sequence[Record], stills: Sequence[Still], windows: Sequence[FloatArray], matrix: FloatArray, force: FloatArray,
    gravity_m_s2: float,
) -> dict[str, FloatArray]:  # fmt: skip
    """Return the covariances (3 P, 3 P), (m/s2)^2, of noise, codes, flicker and temperature in the means of P rests."""
    blocks = noise_of_means(windows, [block_size(records[still.recording].sample_rate_hz) for still in stills])
    noise = np.array([window.std(axis=0) / np.sqrt(len(window)) for window in windows]) if blocks is None else blocks
    noise = np.maximum(noise, MIN_NOISE * max(np.abs(window).max() for window in windows))
    codes = mean_rounding([np.asarray(record.accel) for record in records], windows)
    session = Session(kind="calibration", serial="", gravity_m_s2=gravity_m_s2, records=tuple(records))
    observed = Observed(session=session, settings=CalibrateSettings(), stills=tuple(stills), found=True)
    creep, temps_c = creep_of(observed, stills, "accel"), [r.temp_c for r in records if r.temp_c is not None]
    if temps_c:
        warmer_k = observed.mean_temperature() - np.mean([np.nanmean(temp_c) for temp_c in temps_c])
        creep = replace(creep, warmth=creep.warmth + warmer_k)
    return noise_and_codes(matrix, noise**2, codes**2) | {
        "instability": np.kron(ACCEL_FLICKER**2 * flicker_about_mean(spans_of(records, stills)), np.eye(3)),
        "temperature": creep.covariance_in_case(force),
    }
