"""Procedure: from a session to a Calibration, with the fits that its recordings allow.

    accelerometer   six-face where faces are labelled, or all six are found; else multi-position, from nine free poses
    gyroscope       see calibration/calibrate.py

Codes that are found to be truncated get their half step back before anything is fitted, as ``correct`` does. What was not
observable is a reason in the verdict, with the recording that would show it.

Which gyroscope fit a session allows, in this order.

rate-table       turns with an achieved rate about x, y and z
known-rotation   turns with an angle, or three full turns found between rests
multi-position   moves between nine still phases or more
rest             the offset alone, where the unit is physical

What a session cannot tell by its kind, however well it was recorded, and which recording would: a remark each, no blame.

===============  ============================================  ==================================================
by               not told                                      told by
===============  ============================================  ==================================================
multi-position   how the sensors sit in the case               rests on six faces
six-face         whether the box is square                     free poses
multi-position   g-sensitivity of the gyroscopes               six faces and turns by known angles, or a rate table
known-rotation   whether the scale holds at other rates        a rate table
rate-table       g-sensitivity, without an accelerometer       its rests on six faces
any              offset and scale at other temperatures        a thermal session, ``undrift drift``
===============  ============================================  ==================================================

What it did not tell because of how it was recorded (faces or turns that are missing) the procedures say themselves.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.adc import adc_model, identify_adc, identify_record_adc, without_truncation
from undrift.calibration.checks import missing_faces
from undrift.calibration.known_rotation import (
    KnownRotationSettings,
    check_turns_gravity,
    fit_known_rotation,
    rotation_data,
)
from undrift.calibration.multi_position import HELD_AT_ZERO
from undrift.calibration.observe import CalibrateSettings, Observed, at_one_temperature, in_one_unit, observe
from undrift.calibration.rate_table import (
    DwellSettings,
    RateTableSettings,
    RestMeans,
    check_dwells,
    dwell_means,
    fit_rate_axes,
    fit_rate_table,
    fit_with_rests,
    imposed_rates,
    middles,
    scale_verdict,
    told_axis,
)
from undrift.calibration.reference import ReferenceSettings, fit_reference
from undrift.calibration.six_face import FaceMeans, SixFaceSettings, face_means, fit_six_face
from undrift.errors import CalibrationError, InputError, NotObservable, PoorFit
from undrift.fit.least_squares import TriadFit, block_size, noise_of_means
from undrift.model import AdcModel, Calibration, Provenance, TriadModel, Verdict
from undrift.record import Record, Reference, Session, Turn
from undrift.sync import LagSettings
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

# ---- Outcome: what a procedure made of one triad, or why it made nothing.

_SHORT = 40  # characters: shorter sentences may well be alike


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """One triad's fit, the method that gave it, and what to say beside it."""

    fit: TriadFit | None = None  # None where the triad was not observable
    method: str = "none"  # Name of the method; "none" without a fit
    reasons: tuple[str, ...] = ()  # Sentences for the verdict

    def after(self, *reasons: str) -> "Outcome":
        """Return the same outcome with sentences put before its own."""
        return replace(self, reasons=(*reasons, *self.reasons))


def said_once(reasons: tuple[str, ...]) -> tuple[str, ...]:
    """Return sentences without doubled heads, and without telling twice what ails both triads."""
    said: list[str] = []
    for reason in reasons:
        parts = reason.split(": ")
        parts = [part for k, part in enumerate(parts) if k == 0 or part != parts[k - 1]]
        head, body = parts[0], ": ".join(parts[1:])
        whole = ": ".join(parts)
        if whole in said:
            continue
        repeated = len(parts) > 1 and len(body) > _SHORT and any(body in earlier for earlier in said)
        said.append(f"{head}: not observable, for the reason said of the accelerometer" if repeated else whole)
    return tuple(said)


def with_offset(fit: TriadFit, offset: FloatArray, variance: FloatArray) -> TriadFit:
    """Give a fit made on readings without their offset that offset back.

    Arrays: offset (3,) unit of the readings, variance (3,).
    """
    covariance = np.array(fit.model.covariance)
    covariance[9:12, 9:12] = np.diag(variance)
    told = "mode paper: the offset was taken off the readings first, as the mean of opposite inputs or of the rests"
    return TriadFit(
        model=replace(fit.model, offset=offset, covariance=covariance),
        residuals=fit.residuals,
        verdict=fit.verdict.also(Verdict(remarks=(told,))),
    )


# ---- Which gyroscope fit a session allows, in this order.

_LEAST_STILLS = 9

GyroMethod = Literal["rate-table", "known-rotation", "multi-position", "rest"]


def calibrate_gyro(seen: Observed, method: GyroMethod | None, *, paper: bool, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes by the method asked for, or by the best that the session allows."""
    if all(r.gyro is None for r in seen.session.records):
        if method is not None:
            raise NotObservable(f"gyroscope by {method}: wanted gyroscope readings, got none; map their columns")
        return Outcome()
    if method is not None:
        outcome = _by(method, seen, paper, accel)
        if outcome.fit is None:
            raise NotObservable(f"gyroscope by {method}: " + "; ".join(outcome.reasons))
        return _held_to_unit(outcome)
    return _held_to_unit(_chosen(seen, paper, accel))


def _held_to_unit(outcome: Outcome) -> Outcome:
    if outcome.fit is None:
        return outcome
    model = outcome.fit.model
    verdict = outcome.fit.verdict.also(scale_verdict(model.scale_factor, model.unit_in))
    return replace(outcome, fit=replace(outcome.fit, verdict=verdict))


def _by(method: GyroMethod, seen: Observed, paper: bool, accel: TriadFit | None) -> Outcome:
    if method == "rate-table":
        return _rate_table(seen, paper, accel)
    if method == "known-rotation":
        return _known_rotation(seen, paper, accel)
    return _multi_position_procedure_gyro(seen) if method == "multi-position" else _rest(seen)


def _chosen(seen: Observed, paper: bool, accel: TriadFit | None) -> Outcome:
    rated = sorted({t.axis or "?" for t in seen.session.turns if t.turn_rate is not None})
    angled = any(t.angle is not None for t in seen.session.turns)
    said: list[str] = []
    if rated:
        outcome = _rate_table(seen, paper, accel)
        if outcome.fit is not None:
            return outcome
        said.extend(outcome.reasons)
    elif angled or seen.full_turns():
        outcome = _known_rotation(seen, paper, accel)
        if outcome.fit is not None:
            return outcome
        said.extend(outcome.reasons)
    else:
        plateaus = seen.plateaus()
        if len(seen.stills) >= _LEAST_STILLS:
            outcome = _multi_position_procedure_gyro(seen) if not plateaus else _despite_plateaus(seen)
            if outcome.fit is not None:
                return outcome
            said.extend(outcome.reasons if not plateaus else ())
        if plateaus:
            said.append(
                f"gyroscope: {plateaus} steady turns were found; state the turn_rate_dps and axis of each to use them"
            )
    return _rest(seen).after(*said)


def _rate_table(seen: Observed, paper: bool, accel: TriadFit | None) -> Outcome:
    settings = RateTableSettings(
        mode="paper" if paper else "affine",
        latitude_deg=seen.settings.latitude_deg,
        scale_tolerance=seen.settings.scale_tolerance,
    )
    dwells = dwell_means(seen.session.records, seen.session.turns, DwellSettings(settle_s=seen.settings.settle_s))
    stated = sorted(set(dwells.axis))
    if 0 < len(stated) < 3:
        shown = fit_rate_axes(dwells, settings)
        odd = [r for fit in shown for r in scale_verdict(np.array([fit.scale_factor]), dwells.unit, fit.axis).reasons]
        alone = (
            f"turns at known rates about {' and '.join(stated)} alone do not show the other axes: mount the device on "
        )
        alone += "each axis in turn"
        return Outcome(reasons=tuple(f"gyroscope: {r}" for r in (alone, *(told_axis(fit) for fit in shown), *odd)))
    rests = None if accel is None else _rest_means(seen, accel.model)
    check_dwells(
        dwells,
        imposed_rates(dwells, settings.latitude_deg),
        rests=rests,
        numbers=tuple(k for k, t in enumerate(seen.session.turns, 1) if t.axis is not None and t.turn_rate is not None),
    )
    if not (paper and seen.settings.remove_offset):
        fit = fit_rate_table(dwells, settings)
        if not paper:
            fit = fit_with_rests(fit, dwells, rests, latitude_deg=settings.latitude_deg)
        return Outcome(fit=fit, method="rate-table")
    offset, variance = seen.rest_rate()
    if np.isnan(offset).any():
        offset = np.asarray(dwells.reading.mean(axis=0))  # both signs of every rate cancel
        variance = np.full(3, np.nan) if dwells.noise is None else (dwells.noise**2).mean(axis=0) / len(dwells.axis)
    fit = fit_rate_table(dwells.less(offset), settings)
    return Outcome(fit=with_offset(fit, offset, variance), method="rate-table")


def _rest_means(seen: Observed, accel: TriadModel) -> RestMeans | None:
    """Return readings at rest and specific forces, None where a recording lacks a triad or there is no rest."""
    records, rests = seen.session.records, sorted(seen.stills, key=lambda still: still.recording)
    parts = [records[s.recording].part(s.start, s.stop) for s in rests]
    if not rests or any(r.accel is None or r.gyro is None or np.isnan(r.gyro).any() for r in parts):
        return None
    windows = [part.gyro for part in parts if part.gyro is not None]
    noise = noise_of_means(windows, [block_size(part.sample_rate_hz) for part in parts])
    turning = [t for t in seen.session.turns if t.axis is not None and t.turn_rate is not None]
    turns = [records[t.recording].part(t.start, t.stop) for t in turning]
    if noise is None or not turns or any(turn.accel is None for turn in turns):
        return None
    dwell_force, force = (
        (np.array([np.nanmean(part.accel, axis=0) for part in group]) - accel.offset) @ accel.matrix.T  # type: ignore[arg-type]
        for group in (turns, parts)
    )
    return RestMeans(
        dwell_force=dwell_force,
        reading=np.array([window.mean(axis=0) for window in windows]),
        force=force,
        noise=noise,
        time=middles(records, rests),
    )


def _known_rotation(seen: Observed, paper: bool, accel: TriadFit | None) -> Outcome:
    if all(r.accel is None for r in seen.session.records):
        return Outcome(
            reasons=(
                "gyroscope: turns by known angles need accelerometer readings at rest on six faces, to tell what gravity adds to "
                "the gyroscopes: map the accel columns, or turn at known rates",
            )
        )
    if accel is None or len({s.face for s in seen.faced}) < 6:
        return Outcome(reasons=("gyroscope: turns by known angles need rests on all six faces too: record them",))
    turns = tuple(t for t in seen.session.turns if t.angle is not None)
    said: tuple[str, ...] = ()
    if not turns:
        turns = seen.full_turns()
        if not turns:
            return Outcome(
                reasons=(
                    "gyroscope: wanted one turn by a known angle about each axis, got none; turn the device once about x, y and z "
                    "between two rests and state angle_deg",
                )
            )
        said = (f"gyroscope: three full turns were found and taken as {_told(turns)}; state angle_deg to be sure",)
    data = rotation_data(seen.session.records, seen.stills, turns, matrix=accel.model.matrix, offset=accel.model.offset)
    settings = KnownRotationSettings(
        mode="paper" if paper else "affine",
        angle_uncertainty=seen.settings.angle_uncertainty_deg * RADIAN_PER_DEGREE,
        scale_tolerance=seen.settings.scale_tolerance,
    )
    fit = fit_known_rotation(data, gravity=seen.session.gravity_m_s2, settings=settings)
    check_turns_gravity(seen.session.records, seen.stills, accel.model, fit.model)
    return Outcome(fit=fit, method="known-rotation", reasons=said)


def _told(turns: tuple[Turn, ...]) -> str:
    return ", ".join(f"{t.axis} {(t.angle or 0.0) / RADIAN_PER_DEGREE:+.0f} deg" for t in turns)


def _multi_position_procedure_gyro(seen: Observed) -> Outcome:
    from undrift.calibration.multi_position import fit_multi_position_session

    try:
        fit = fit_multi_position_session(seen.session)
    except NotObservable as error:
        return Outcome(reasons=(f"gyroscope by {error}",))
    if fit.gyro is None:
        own = fit.accel.verdict.reasons
        return Outcome(reasons=tuple(r for r in fit.verdict.reasons if r not in own))
    return Outcome(fit=fit.gyro, method="multi-position")


def _despite_plateaus(seen: Observed) -> Outcome:
    # Slow moves between poses are steady too; on a rate table without its rates the poses do not serve, for any reason.
    try:
        return _multi_position_procedure_gyro(seen)
    except CalibrationError:
        return Outcome()


def _rest(seen: Observed) -> Outcome:
    offset, variance = seen.rest_rate()
    unit = seen.session.records[0].gyro_unit
    if np.isnan(offset).any() or not is_physical(unit):
        return Outcome(reasons=("gyroscope not observable: record turns by known rates or angles",))
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.diag(variance)
    factor = si_factor(unit, "rate")
    residuals = (seen.rest_means() - offset) * factor
    model = TriadModel(
        method="rest",
        unit_in=unit,
        unit_out="rad/s",
        matrix=factor * np.eye(3),
        offset=offset,
        covariance=covariance,
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=residuals.size,
        rank=3,
        condition=1.0,
        valid_range=(0.0, 0.0),
    )
    reason = "offset alone: the scale is the unit's own and was not checked; record turns by known rates or angles"
    fit = TriadFit(model=model, residuals=residuals, verdict=Verdict(status="marginal", remarks=(reason,)))
    return Outcome(fit=fit, method="rest")


# ---- From recordings with an orientation reference to a Calibration of the gyroscopes: no rig, no poses, only motion.

REFERENCE_SETTINGS = ReferenceSettings()
LAG_SETTINGS = LagSettings()


def calibrate_to_references(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    adc: Literal["auto", "none"] = "auto",
    settings: ReferenceSettings = REFERENCE_SETTINGS,
    lag_settings: LagSettings = LAG_SETTINGS,
) -> Calibration:
    """Calibrate the gyroscopes of one device from its recordings beside a reference.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device in one mounting; each begins with a rest.
    references : sequence of Reference
        One for each record.
    adc : str
        "auto" gives back what the ADC's rounding took, where it shows; "none" leaves the codes.
    settings : ReferenceSettings
        Of the fit.
    lag_settings : LagSettings
        Of the search for the lag between the clocks.

    Returns
    -------
    Calibration
        Gyroscopes only: a reference of orientation does not see specific force.

    Raises
    ------
    InputError
        All that ``fit_reference`` raises.
    """
    rounding = device_adc(records) if adc == "auto" else None
    fit = fit_reference(records, references, settings=settings, adc=rounding, lag_settings=lag_settings)
    temps = [float(np.nanmean(record.temp_c)) for record in records if record.temp_c is not None]
    return Calibration(
        device=records[0].device,
        reference_temp_c=float(np.mean(temps)) if temps else float("nan"),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=fit.triad.model,
        adc=rounding,
        verdict=fit.triad.verdict,
    )


def device_adc(records: Sequence[Record]) -> AdcModel | None:
    """Find how the gyroscope codes of one device were rounded, from all its recordings."""
    found = [model for model in map(identify_record_adc, records) if model is not None and model.gyro_lsb is not None]
    if not found:
        return None
    ranked = Counter(model.gyro_rounding for model in found).most_common()
    if len(ranked) > 1 and ranked[0][1] == ranked[1][1]:
        return None
    chosen = [model for model in found if model.gyro_rounding == ranked[0][0]]
    return min(chosen, key=lambda model: float(np.sum(np.asarray(model.gyro_lsb))))


# ---- What a session cannot tell by its kind, however well it was recorded, and which recording would: a remark each, no blame.

CASE = (
    "how the sensors sit in the case was not told, the axes are the accelerometer's own: free poses show lengths alone; rests on "
    "six faces of the case show it"
)
FACES = (
    "accelerometer: its axes are those of the faces, and a box out of square counts as misaligned sensors; nine or more free poses "
    "tell the angles between the sensors without a box"
)
G_SENSITIVITY = (
    "gyroscope: its g-sensitivity was not told by moves between poses and is taken for nothing; rests on six faces with turns by "
    "known angles about x, y and z show it, or a rate table"
)
OTHER_RATES = "gyroscope: turns by known angles do not tell whether the scale holds at every rate; a rate table does"
NO_ACCEL = (
    "gyroscope: its g-sensitivity was not told, for want of an accelerometer's rests on six faces in the same session; "
    "record them"
)


def limits_of(accel: Outcome, gyro: Outcome, temp_c: float, *, thermal: bool) -> Verdict:
    """Return what the kind of a session leaves untold."""
    said: list[str] = []
    if accel.fit is not None and accel.method == "multi-position":
        said.append(CASE)
    if accel.fit is not None and accel.method == "six-face":
        said.append(FACES)
    if gyro.fit is not None and gyro.method == "multi-position":
        said.append(G_SENSITIVITY)
    if gyro.fit is not None and gyro.method == "known-rotation":
        said.append(OTHER_RATES)
    if gyro.fit is not None and gyro.method == "rate-table" and accel.fit is None:
        told = any("g-sensitivity" in reason for reason in gyro.fit.verdict.reasons)
        said += [] if told else [NO_ACCEL]
    if not thermal:
        said.append(_temperature(temp_c))
    return Verdict(remarks=tuple(said))


def _temperature(temp_c: float) -> str:
    which = f"one temperature, {temp_c:.1f} degC" if np.isfinite(temp_c) else "one temperature, which was not recorded"
    return f"offset and scale were seen at {which}; at others a thermal session tells them, by undrift drift"


# ---- calibrate

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
    from undrift.calibration.multi_position import fit_multi_position_session

    return Outcome(fit=fit_multi_position_session(seen.session).accel, method="multi-position")


def _scale_and_offset(seen: Observed, why: str) -> Outcome:
    from undrift.calibration.multi_position import MultiPositionSettings, fit_multi_position_session

    try:
        fit = fit_multi_position_session(
            seen.session, settings=MultiPositionSettings(cross_axis=False, gyro="none")
        ).accel
    except (NotObservable, PoorFit) as error:
        return Outcome(reasons=(f"accelerometer by {error}",))
    other = tuple(reason for reason in fit.verdict.reasons if reason != HELD_AT_ZERO)  # said below, and why
    return Outcome(
        fit=replace(fit, verdict=replace(fit.verdict, remarks=other)),
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
    verdict = Verdict(status="marginal" if reasons else "good", remarks=reasons)
    for outcome, name in ((accel, "accelerometer"), (gyro, "gyroscope")):
        if outcome.fit is not None:
            own = outcome.fit.verdict
            verdict = verdict.also(
                Verdict(status=own.status, remarks=tuple(f"{name}: {reason}" for reason in own.reasons))
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
