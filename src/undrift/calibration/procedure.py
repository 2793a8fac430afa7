"""Procedure: from a session to a Calibration, with the fits that its recordings allow.

    accelerometer   six-face where faces are labelled, or all six are found; else multi-position, from nine free poses
    gyroscope       see procedure_gyro.py

Codes that are found to be truncated get their half step back before anything is fitted, as ``correct`` does. What was not
observable is a reason in the verdict, with the recording that would show it.
"""

from dataclasses import replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.adc import adc_model, identify_adc, without_truncation
from undrift.calibration.fit.multi_position_accel import HELD_AT_ZERO
from undrift.calibration.fit.six_face import FaceMeans, SixFaceSettings, face_means, fit_six_face
from undrift.calibration.limits import limits_of
from undrift.calibration.model import AdcModel, Calibration, Provenance, Verdict
from undrift.calibration.observed import CalibrateSettings, Observed, in_one_unit, observe
from undrift.calibration.one_temperature import at_one_temperature
from undrift.calibration.outcome import Outcome, said_once, with_offset
from undrift.calibration.plausibility import missing_faces
from undrift.calibration.procedure_gyro import GyroMethod, calibrate_gyro
from undrift.errors import InputError, NotObservable, PoorFit
from undrift.record import Record
from undrift.session import Session
from undrift.units import is_physical, si_factor

AccelMethod = Literal["six-face", "multi-position"]
Mode = Literal["paper", "affine", "levelled"]

_LEAST_POSES = 9  # free poses of a multi-position fit


def calibrate(
    session: Session,
    *,
    accel: AccelMethod | None = None,
    gyro: GyroMethod | None = None,
    mode: Mode | None = None,
    settings: CalibrateSettings = CalibrateSettings(),
) -> Calibration:
    """Calibrate a device from a session.

    Parameters
    ----------
    session : Session
        Recordings; stills and turns as stated in it, else found in the data.
    accel : str, optional
        six-face or multi-position; None chooses.
    gyro : str, optional
        rate-table, known-rotation, multi-position or rest; None chooses.
    mode : str, optional
        paper, affine or levelled; None is levelled for six faces and affine for turns.
    settings : CalibrateSettings
        Further choices.

    Returns
    -------
    Calibration
        What was observable, the verdict, and where it came from.

    Raises
    ------
    NotObservable
        A fit that was asked for lacks recordings, or nothing at all could be fitted.
    Implausible
        Data or results that cannot be this device.
    InputError
        A method or mode that is not one, or a corrected recording.
    """
    _check_choices(accel, gyro, mode, settings.latitude_deg)
    if any(r.state == "corrected" for r in session.records):
        raise InputError(
            "calibrate: wanted raw readings, got a corrected record, whose offsets are gone; calibrate with the device's own "
            "recording"
        )
    session, set_aside = at_one_temperature(in_one_unit(session))
    adc = _adc(session) if settings.identify_adc else None
    seen = observe(_untruncated(session, adc), settings)
    accel_outcome = _calibrate_accel(seen, accel, mode)
    gyro_outcome = _calibrate_gyro(seen, gyro, mode, accel_outcome)
    ignored = _ignored(mode, accel_outcome, gyro_outcome)
    reasons = said_once((*set_aside, *seen.reasons, *accel_outcome.reasons, *gyro_outcome.reasons, *ignored))
    if accel_outcome.fit is None and gyro_outcome.fit is None:
        raise NotObservable(f"calibrate: wanted poses or turns to fit, got none that serve: {'; '.join(reasons)}")
    thermal = session.kind == "thermal" or bool(set_aside)
    limits = limits_of(accel_outcome, gyro_outcome, seen.mean_temperature(), thermal=thermal)
    return Calibration(
        device=session.serial or session.records[0].device,
        reference_temp_c=seen.mean_temperature(),
        gravity_m_s2=session.gravity_m_s2,
        gyro=None if gyro_outcome.fit is None else gyro_outcome.fit.model,
        accel=None if accel_outcome.fit is None else accel_outcome.fit.model,
        adc=adc,
        verdict=_verdict(reasons, accel_outcome, gyro_outcome).also(limits),
        provenance=_provenance(session, settings, accel_outcome.method, gyro_outcome.method, mode),
    )


def _check_choices(accel: str | None, gyro: str | None, mode: str | None, latitude_deg: float | None) -> None:
    if latitude_deg is not None and not -90.0 <= latitude_deg <= 90.0:
        raise InputError(f"calibrate: wanted latitude_deg from -90 to 90, got {latitude_deg:g}; south is negative")
    for value, known, name in (
        (accel, ("six-face", "multi-position"), "accel"),
        (gyro, ("rate-table", "known-rotation", "multi-position", "rest"), "gyro"),
        (mode, ("paper", "affine", "levelled"), "mode"),
    ):
        if value is not None and value not in known:
            raise InputError(f"calibrate: wanted {name} one of {', '.join(known)}, got '{value}'; name one of them")


def _calibrate_accel(seen: Observed, method: AccelMethod | None, mode: Mode | None) -> Outcome:
    if all(r.accel is None for r in seen.session.records):
        if method is not None:
            raise NotObservable(f"accelerometer by {method}: wanted its readings, got none; map the accel columns")
        return Outcome()
    if method == "six-face":
        return _six_face(seen, mode)
    if method == "multi-position":
        return _multi_position(seen)
    missing = missing_faces([s.face for s in seen.faced if s.face is not None])
    faces = not missing or (not seen.found and len(missing) == 1)
    free = len(seen.stills) - len(seen.faced)
    if faces and (not seen.found or free <= 0.1 * len(seen.stills)):
        return _six_face(seen, mode)
    if len(seen.stills) >= _LEAST_POSES:
        try:
            return _multi_position(seen)
        except NotObservable as error:
            return _six_face(seen, mode) if faces else _scale_and_offset(seen, str(error))
    lacking = f" and none with {', '.join(missing)} up" if seen.faced else ""
    return Outcome(
        reasons=(
            f"accelerometer not observable: wanted rests on six faces or {_LEAST_POSES} free poses, "
            f"got {_counted(len(seen.stills))}{lacking}; record the missing ones",
        )
    )


def _calibrate_gyro(seen: Observed, method: GyroMethod | None, mode: Mode | None, accel: Outcome) -> Outcome:
    paper = mode == "paper"
    if method is not None:
        return calibrate_gyro(seen, method, paper=paper, accel=accel.fit)
    try:
        outcome = calibrate_gyro(seen, None, paper=paper, accel=accel.fit)
    except NotObservable as error:
        outcome = _rest_alone(seen).after(f"gyroscope: {error}")
    return (
        outcome if outcome.fit is not None else replace(outcome, reasons=(*outcome.reasons, *_offset_in_counts(seen)))
    )


def _rest_alone(seen: Observed) -> Outcome:
    try:
        return calibrate_gyro(seen, "rest", paper=False, accel=None)
    except NotObservable:
        return Outcome()


def _offset_in_counts(seen: Observed) -> tuple[str, ...]:
    # A model turns readings into rad/s: an offset without a scale has no place in it, and a feigned scale would be used.
    unit = seen.session.records[0].gyro_unit
    offset, variance = seen.rest_rate()
    if is_physical(unit) or np.isnan(offset).any():
        return ()
    told = ", ".join(f"{v:.5g}" for v in offset)
    return (
        f"gyroscope: at rest it reads ({told}) {unit} to within {float(np.sqrt(variance.max())):.2g}; without a scale that offset "
        "cannot be kept in a calibration: give the scale of the columns, or record turns",
    )


def _ignored(mode: Mode | None, accel: Outcome, gyro: Outcome) -> tuple[str, ...]:
    said: list[str] = []
    if mode in ("paper", "levelled") and accel.fit is not None and accel.method != "six-face":
        said.append(
            f"accelerometer: mode {mode} is a mode of six faces and was not used by {accel.method}; rest on all six faces for it"
        )
    if mode == "paper" and gyro.fit is not None and gyro.method == "multi-position":
        said.append(
            f"gyroscope: mode paper was not used by {gyro.method}; record turns by known rates or angles for it"
        )
    return tuple(said)


def _six_face(seen: Observed, mode: Mode | None) -> Outcome:
    settings = SixFaceSettings(mode=mode or "levelled", window_s=seen.settings.window_s)
    unit = seen.session.records[0].accel_unit
    if is_physical(unit):
        scale = 1.0 / si_factor(unit, "accel")
        settings = replace(settings, stated_scale=scale, scale_tolerance=seen.settings.scale_tolerance)
    poses = face_means(seen.session.records, seen.stills, settings)
    said: tuple[str, ...] = ()
    if settings.mode == "levelled" and poses.noise is None:
        settings = replace(settings, mode="affine")
        said = (
            "accelerometer: the faces are too short to tell the noise of their means; mode affine was used: rest 6 s",
        )
    gravity = seen.session.gravity_m_s2
    if settings.mode != "paper" or not seen.settings.remove_offset:
        return Outcome(fit=fit_six_face(poses, gravity=gravity, settings=settings), method="six-face", reasons=said)
    offset, variance = _mean_of_faces(poses)
    fit = fit_six_face(replace(poses, reading=poses.reading - offset), gravity=gravity, settings=settings)
    return Outcome(fit=with_offset(fit, offset, variance), method="six-face", reasons=said)


def _mean_of_faces(poses: FaceMeans) -> tuple[FloatArray, FloatArray]:
    # Opposite faces cancel: the mean over the six, each counted once, is an estimate of the offset.
    faces = np.array(poses.faces)
    offset = np.mean([poses.reading[faces == face].mean(axis=0) for face in sorted(set(poses.faces))], axis=0)
    variance = np.full(3, np.nan) if poses.noise is None else (poses.noise**2).mean(axis=0) / len(faces)
    return offset, variance


def _multi_position(seen: Observed) -> Outcome:
    from undrift.calibration.fit.multi_position import fit_multi_position_session

    return Outcome(fit=fit_multi_position_session(seen.session).accel, method="multi-position")


def _scale_and_offset(seen: Observed, why: str) -> Outcome:
    from undrift.calibration.fit.multi_position import MultiPositionSettings, fit_multi_position_session

    try:
        fit = fit_multi_position_session(
            seen.session, settings=MultiPositionSettings(cross_axis=False, gyro="none")
        ).accel
    except (NotObservable, PoorFit) as error:
        return Outcome(reasons=(f"accelerometer by {error}",))
    other = tuple(reason for reason in fit.verdict.reasons if reason != HELD_AT_ZERO)  # said below, and why
    return Outcome(
        fit=replace(fit, verdict=replace(fit.verdict, reasons=other)),
        method="multi-position",
        reasons=(f"accelerometer: scale and offset alone were fitted, cross-axis terms were not observable: {why}",),
    )


def _counted(rests: int) -> str:
    return "1 rest" if rests == 1 else f"{rests} rests"


def _adc(session: Session) -> AdcModel | None:
    raw = [r for r in session.records if r.state == "raw"]
    gyro = [r.gyro for r in raw if r.gyro is not None]
    accel = [r.accel for r in raw if r.accel is not None]
    return adc_model(
        identify_adc(np.concatenate(gyro)) if gyro else None, identify_adc(np.concatenate(accel)) if accel else None
    )


def _untruncated(session: Session, adc: AdcModel | None) -> Session:
    return session if adc is None else replace(session, records=tuple(_restored(r, adc) for r in session.records))


def _restored(record: Record, adc: AdcModel) -> Record:
    gyro, accel = record.gyro, record.accel
    if gyro is not None and adc.gyro_lsb is not None:
        gyro = without_truncation(gyro, adc.gyro_lsb, adc.gyro_rounding)
    if accel is not None and adc.accel_lsb is not None:
        accel = without_truncation(accel, adc.accel_lsb, adc.accel_rounding)
    return replace(record, gyro=gyro, accel=accel)


def _verdict(reasons: tuple[str, ...], accel: Outcome, gyro: Outcome) -> Verdict:
    verdict = Verdict(status="marginal" if reasons else "good", reasons=reasons)
    for outcome, name in ((accel, "accelerometer"), (gyro, "gyroscope")):
        if outcome.fit is not None:
            own = outcome.fit.verdict
            verdict = verdict.also(
                Verdict(status=own.status, reasons=tuple(f"{name}: {reason}" for reason in own.reasons))
            )
    return verdict


def _provenance(session: Session, settings: CalibrateSettings, accel: str, gyro: str, mode: Mode | None) -> Provenance:
    from importlib.metadata import version

    return Provenance(
        inputs=session.inputs,
        settings=(
            ("accel", accel),
            ("gyro", gyro),
            ("mode", mode or "default"),
            ("window_s", f"{settings.window_s:g}"),
            ("settle_s", f"{settings.settle_s:g}"),
            ("latitude_deg", "none" if settings.latitude_deg is None else f"{settings.latitude_deg:g}"),
            ("angle_uncertainty_deg", f"{settings.angle_uncertainty_deg:g}"),
        ),
        versions=tuple((name, version(name)) for name in ("undrift", "numpy", "scipy")),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
