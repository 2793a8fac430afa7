"""From a session to a Calibration, with the fits that its recordings allow.

    accelerometer   six-face if faces are labelled or all six are found; otherwise multi-position, from nine free poses
    gyroscope       rate-table        turns with an achieved rate about x, y and z
                    known-rotation    turns with an angle, or three full turns found between rests
                    multi-position    moves between nine still phases or more
                    rest              only the offset, if the readings are in a physical unit

The first that the session allows is used, unless the caller names one. Readings whose codes are found to be truncated are
corrected by half a step before anything is fitted, as ``correct`` does. A parameter that the session does not determine is a
finding, which names the recording that would determine it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import device_adc, restored
from undrift.calibration.in_motion import InMotion, fit_in_motion, without_gaps
from undrift.calibration.known_rotation import calibrate_turns
from undrift.calibration.magnetometer import FieldFit, FieldReadings, fit_magnetometer
from undrift.calibration.moves import FEWEST_POSES, calibrate_moves, calibrate_poses
from undrift.calibration.plausibility import missing_faces, range_in_doubt
from undrift.calibration.quality import check_accel
from undrift.calibration.rate_table import calibrate_rates, scale_verdict
from undrift.calibration.reference import ReferenceFit, ReferenceSettings, fit_reference
from undrift.calibration.reference_accel import fit_reference_accel, turned_like
from undrift.calibration.session import Observed, Outcome, at_one_temperature, in_one_unit, observe
from undrift.calibration.settings import AccelFit, CalibrateSettings, GyroFit, Mode
from undrift.calibration.six_face import calibrate_faces
from undrift.calibration.sources import creep_of, offset_drift
from undrift.calibration.triads import check_triads
from undrift.errors import CalibrationError, Implausible, InputError, NotObservable, PoorFit, check_choice
from undrift.findings import Finding, Level, finding
from undrift.fit.priors import SCALE_FACTOR
from undrift.fit.triad import TriadFit, triad_fit
from undrift.kernels.attitude import filtered_attitude
from undrift.model import AdcModel, Calibration, Provenance, Verdict, versions_used
from undrift.record import FACES, GravitySource, Record, Reference, Session, Turn, check_local_gravity
from undrift.segments import unpadded
from undrift.sync import LagSettings, padding
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

Adc = Literal["auto", "none"]
Fit = Callable[[Observed, Mode | None, TriadFit | None], Outcome]

MIN_FREE_POSES = 9  # of a multi-position fit
LATITUDE_LIKE_RADIANS = (0.4, 1.22)  # as degrees a place at the equator, as radians 23 to 70 deg, where people live
GRAVITY_SPREAD = 0.02  # m/s2: standard gravity against that of any place, 9.78 to 9.83


def calibrate_rest(seen: Observed, mode: Mode | None, accel: TriadFit | None) -> Outcome:
    """Measure the offset of the gyroscopes in rests; the scale factor is nominal."""
    unit = seen.session.records[0].gyro_unit
    # Faces and poses are meant for the accelerometers; full turns were meant for the gyroscopes.
    level: Level = "warn" if accel is None or seen.turns_of(2.0 * np.pi) else "info"
    if not is_physical(unit):  # a model turns readings into rad/s, and the scale of counts is unknown
        return Outcome(findings=(finding("gyro.not_observable", level),))
    factor, creep = si_factor(unit, "rate"), creep_of(seen, seen.stills, "gyro")
    offset, variance = seen.rest_rate(creep.columns(np.zeros(len(seen.stills)), 1.0 / factor)[:, 0])
    if np.isnan(offset).any():
        return Outcome(findings=(finding("gyro.not_observable", "warn"),))
    share = np.where(np.eye(3) > 0.0, SCALE_FACTOR, seen.settings.cross_axis_prior)
    fit = triad_fit(
        (seen.rest_means() - offset) * factor,
        Verdict.of(finding("gyro.offset_alone", level, scale_percent=100.0 * SCALE_FACTOR)),
        method="rest",
        unit_in=unit,
        unit_out="rad/s",
        matrix=factor * np.eye(3),
        offset=offset,
        covariance=np.diag(np.concatenate(((factor * share.ravel()) ** 2, variance))),
        rank=3,
        condition=1.0,
        valid_range=(0.0, 0.0),
    )
    return Outcome(fit=fit, method="rest", findings=creep.findings())


ACCEL_FITS: dict[str, Fit] = {"six-face": calibrate_faces, "multi-position": calibrate_poses}
GYRO_FITS: dict[str, Fit] = {
    "rate-table": calibrate_rates,
    "known-rotation": calibrate_turns,
    "multi-position": calibrate_moves,
    "rest": calibrate_rest,
}


def calibrate(
    session: Session | Record,
    *more: Record,
    accel: AccelFit | None = None,
    gyro: GyroFit | None = None,
    mode: Mode | None = None,
    gravity_m_s2: float | None = None,
    serial: str = "",
    settings: CalibrateSettings = CalibrateSettings(),
) -> Calibration:
    """Calibrate a device from a session, or from recordings of it.

    Parameters
    ----------
    session, more : Session, or recordings of one device
        A session's stills and turns are used as stated; in recordings they are found.
    accel, gyro : str, optional
        Method of each triad; gyro "none" leaves it out. None chooses.
    mode : str, optional
        paper or affine; None is affine.
    gravity_m_s2, serial
        Of recordings: local gravity, m/s2 (None assumes standard gravity, and the verdict says so), and the serial number.
    settings : CalibrateSettings
        Further choices.

    Returns
    -------
    Calibration
        What the recordings determine, the verdict, and where it came from.

    Raises
    ------
    NotObservable, Implausible, InputError
        Recordings do not allow a fit that was asked for, or any; data cannot be this device; a choice is unknown.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> device = undrift.random_device(np.random.default_rng(7))
    >>> session = undrift.simulate_session("bench", device, rng=np.random.default_rng(8))
    >>> made = undrift.calibrate(session)
    >>> made.gyro.method, made.accel.method, made.verdict.status
    ('rate-table/affine', 'six-face/affine', 'good')
    """
    if isinstance(session, Record):
        session = _session_of((session, *more), gravity_m_s2, "stated", serial)
    elif more or gravity_m_s2 is not None or serial:
        raise InputError(
            "calibrate: a Session states its recordings, gravity and serial number. Give the session only."
        )
    return calibrated(session, accel=accel, gyro=gyro, mode=mode, settings=settings)[0]


def _session_of(
    records: Sequence[Record], gravity_m_s2: float | None, source: GravitySource, serial: str = ""
) -> Session:
    """Return recordings as a session; gravity is the standard one if it is not given."""
    return Session(
        kind="calibration",
        serial=serial or records[0].device,
        records=tuple(records),
        gravity_m_s2=STANDARD_GRAVITY if gravity_m_s2 is None else gravity_m_s2,
        gravity_source="standard" if gravity_m_s2 is None else source,
    )


def calibrated(
    session: Session,
    *,
    accel: AccelFit | None = None,
    gyro: GyroFit | None = None,
    mode: Mode | None = None,
    settings: CalibrateSettings = CalibrateSettings(),
) -> tuple[Calibration, Observed]:
    """Calibrate a device from a session, and return the rests and turns that were found in it as well."""
    check_choice(accel, AccelFit | None, "calibrate", "accel")
    check_choice(gyro, GyroFit | None, "calibrate", "gyro")
    check_choice(mode, Mode | None, "calibrate", "mode")
    _check_raw(session.records)
    session, other_temperatures = at_one_temperature(in_one_unit(session))
    adc, seen = _observed(session, settings)
    with_accel, with_gyro = seen.with_triad("accel"), seen.with_triad("gyro")
    accel_outcome = _calibrate_accel(with_accel, accel, mode)
    if accel_outcome.fit is not None:
        unused = with_accel.unused_stills(accel_outcome.used)
        doubts = check_accel(with_accel.session, accel_outcome.fit.model, unused)
        accel_outcome = accel_outcome.after(*doubts)
    together = any(record.accel is not None for record in with_gyro.session.records)
    gyro_outcome = _calibrate_gyro(with_gyro, gyro, mode, accel_outcome if together else Outcome())
    findings = each_once(
        (
            *other_temperatures,
            *_doubts(seen, accel_outcome, gyro_outcome),
            *accel_outcome.findings,
            *gyro_outcome.findings,
            *_mode_not_used(mode, "accelerometer", accel_outcome),
            *_mode_not_used(mode, "gyroscope", gyro_outcome),
        )
    )
    if accel_outcome.fit is None and gyro_outcome.fit is None:
        reasons = "; ".join(item.text for item in findings)
        raise NotObservable(f"calibrate: wanted poses or turns to fit, got none that can be used: {reasons}")
    verdict = Verdict.of(*findings)
    for outcome in (accel_outcome, gyro_outcome):
        verdict = verdict if outcome.fit is None else verdict.also(outcome.fit.verdict)
    thermal = session.kind == "thermal" or bool(other_temperatures)
    limits = limits_of(accel_outcome, gyro_outcome, seen.mean_temperature(), thermal=thermal)
    calibration = Calibration(
        device=session.serial or session.records[0].device,
        reference_temp_c=seen.mean_temperature(),
        gravity_m_s2=session.gravity_m_s2,
        gyro=None if gyro_outcome.fit is None else gyro_outcome.fit.model,
        accel=None if accel_outcome.fit is None else accel_outcome.fit.model,
        adc=adc,
        verdict=verdict.also(Verdict.of(*limits)),
        provenance=_provenance(seen, accel_outcome.method, gyro_outcome.method, mode),
        file_map=session.file_map,
    )
    return calibration, seen


def _doubts(seen: Observed, accel: Outcome, gyro: Outcome) -> Iterator[Finding]:
    """Yield what speaks against what the session states, and how far its rests drift."""
    latitude_deg = seen.settings.latitude_deg
    if latitude_deg is not None and LATITUDE_LIKE_RADIANS[0] < abs(latitude_deg) < LATITUDE_LIKE_RADIANS[1]:
        as_radians_deg = latitude_deg / RADIAN_PER_DEGREE
        yield finding("session.latitude_in_radians", "warn", latitude_deg=latitude_deg, as_radians_deg=as_radians_deg)
    if seen.session.gravity_source == "standard" and accel.fit is not None:
        yield finding("session.gravity_assumed", "warn", gravity_m_s2=seen.session.gravity_m_s2)
    if gyro.fit is not None and gyro.fit.model.unit_in == "count":
        readings = [record.gyro for record in seen.session.records if record.gyro is not None]
        largest = max(float(np.nanmax(np.abs(gyro_counts))) for gyro_counts in readings)
        stated = gyro.method in ("rate-table", "known-rotation")
        yield from range_in_doubt(float(np.median(gyro.fit.model.scale_factor)), largest, stated=stated)
    yield from seen.findings
    if gyro.fit is not None:
        yield from offset_drift(seen, float(np.linalg.norm(gyro.fit.model.matrix, 2)))


def _observed(session: Session, settings: CalibrateSettings) -> tuple[AdcModel | None, Observed]:
    """Return the converter's rounding, and what the session shows once it is corrected."""
    adc = device_adc(session.records) if settings.identify_adc else None
    return adc, observe(replace(session, records=tuple(restored(r, adc) for r in session.records)), settings)


def find_pieces(session: Session, settings: CalibrateSettings) -> tuple[Session, tuple[Turn, ...]]:
    """Return a bare session with the rests and turns found in it, and its steady turns, whose rate only the rig knows.

    Rests carry a face if the accelerometers would be calibrated from faces.
    """
    seen = _observed(in_one_unit(session), settings)[1]
    stills = seen.stills if seen.mostly_faces else tuple(replace(still, face=None) for still in seen.stills)
    turns = seen.session.turns or seen.full_turns()
    return replace(session, stills=stills, turns=turns), () if turns else seen.plateaus()


def each_once(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings, those that differ in their triad alone as one with both triads."""
    merged: dict[tuple[str, str, str], Finding] = {}
    for item in findings:
        key = (item.code, item.level, repr({name: value for name, value in item.values.items() if name != "triad"}))
        first, triad = merged.setdefault(key, item), str(item.values.get("triad", ""))
        if triad not in str(first.values.get("triad", "")):
            merged[key] = replace(first, values={**first.values, "triad": f"{first.values['triad']} and {triad}"})
    return tuple(merged.values())


def _calibrate_accel(seen: Observed, method: AccelFit | None, mode: Mode | None) -> Outcome:
    if all(record.accel is None for record in seen.session.records):
        if method is not None:
            raise NotObservable(f"accelerometer by {method}: wanted its readings, got none; map the accel columns")
        return Outcome()
    if method is not None:
        return _required("accelerometer", method, ACCEL_FITS[method](seen, mode, None))
    missing = missing_faces([still.face for still in seen.faced if still.face is not None])
    faces = not missing or (not seen.found and len(missing) == 1)
    if faces and (not seen.found or seen.mostly_faces):
        return calibrate_faces(seen, mode)
    rests = len(seen.stills)
    too_few = finding("session.too_few_poses", "warn", wanted=MIN_FREE_POSES, rests=rests, missing=missing)
    if rests < FEWEST_POSES:
        return Outcome(findings=(too_few,))
    try:
        return calibrate_poses(seen, mode)
    except (NotObservable, PoorFit) as error:
        if faces:
            return calibrate_faces(seen, mode)
        if rests < MIN_FREE_POSES:
            return Outcome(findings=(too_few,))
        if isinstance(error, PoorFit):
            raise
        failed = finding("session.fit_failed", "warn", triad="accelerometer", reason=str(error))
        return Outcome(findings=(too_few, failed))


def _calibrate_gyro(seen: Observed, method: GyroFit | None, mode: Mode | None, accel: Outcome) -> Outcome:
    if method == "none":
        return Outcome()
    if all(record.gyro is None for record in seen.session.records):
        if method is not None:
            raise NotObservable(f"gyroscope by {method}: wanted gyroscope readings, got none; map their columns")
        return Outcome()
    sound, saturated = seen.without_saturated_turns()
    try:
        if method is not None:
            outcome = _required("gyroscope", method, GYRO_FITS[method](sound, mode, accel.fit))
        elif saturated and not sound.session.turns:
            outcome = calibrate_rest(seen, mode, accel.fit)
        else:
            outcome = _best_gyro(sound, mode, accel.fit)
    except NotObservable as error:
        if method is not None:
            raise NotObservable("; ".join((str(error), *(item.text for item in saturated))), **error.numbers) from error
        outcome = calibrate_rest(seen, mode, accel.fit)
        outcome = replace(outcome, findings=()) if outcome.fit is None else outcome
        outcome = outcome.after(finding("session.fit_failed", "warn", triad="gyroscope", reason=str(error)))
    outcome = outcome.after(*saturated)
    if outcome.fit is None:
        return outcome
    model = outcome.fit.model
    verdict = outcome.fit.verdict.also(scale_verdict(model.scale_factor, model.unit_in))
    return replace(outcome, fit=replace(outcome.fit, verdict=verdict))


def _required(triad: str, method: str, outcome: Outcome) -> Outcome:
    if outcome.fit is None:
        raise NotObservable(f"{triad} by {method}: " + "; ".join(item.text for item in outcome.findings))
    return outcome


def _best_gyro(seen: Observed, mode: Mode | None, accel: TriadFit | None) -> Outcome:
    """Return the first of rate-table, known-rotation and multi-position that gives a fit, otherwise rest."""
    turns, outcome = seen.session.turns, Outcome()
    plateaus: tuple[Turn, ...] = ()
    if any(turn.turn_rate is not None for turn in turns):
        outcome = calibrate_rates(seen, mode, accel)
    elif any(turn.angle is not None for turn in turns) or seen.full_turns():
        outcome = calibrate_turns(seen, mode, accel)
    else:
        plateaus = seen.plateaus()
        with_force = any(record.accel is not None for record in seen.session.records)
        if with_force and len(seen.stills) >= MIN_FREE_POSES:
            # Slow moves between poses are steady too. On a rate table without its rates the poses fail, for any reason.
            by_hand = accel is not None and accel.model.method == "multi-position"
            try:
                outcome = calibrate_moves(seen, mode, accel)
            except CalibrationError:
                if by_hand or not plateaus:
                    raise
            if plateaus and outcome.fit is not None and outcome.fit.verdict.status == "bad":
                outcome = Outcome()  # turns of a table whose rates are not stated, fitted as moves
    if outcome.fit is not None:
        return outcome
    unknown_rates = (finding("rate_table.rates_not_stated", "warn", turns=len(plateaus)),) if plateaus else ()
    return calibrate_rest(seen, mode, accel).after(*(unknown_rates or outcome.findings))


def _mode_not_used(mode: Mode | None, triad: str, outcome: Outcome) -> Iterator[Finding]:
    if outcome.fit is not None and mode == "paper" and outcome.method == "multi-position":
        needs = "rests on all six faces" if triad == "accelerometer" else "turns by known rates or angles"
        yield finding("paper_mode.not_used", "warn", mode=mode, triad=triad, method=outcome.method, needs=needs)


def limits_of(accel: Outcome, gyro: Outcome, temp_c: float, *, thermal: bool) -> Iterator[Finding]:
    """Return what this kind of session never shows, however well it was recorded."""
    if accel.fit is not None and accel.method in ("multi-position", "six-face"):
        yield finding("multi_position.mounting" if accel.method == "multi-position" else "six_face.fixture", "info")
    if gyro.fit is not None and gyro.method in ("rate-table", "known-rotation") and accel.fit is None:
        yield finding("rate_table.no_accel", "info")
    if not thermal:
        unknown = "at the temperature of the session, which was not recorded"
        where = f"near {temp_c:.1f} degC" if np.isfinite(temp_c) else unknown
        yield finding("session.one_temperature", "info", where=where)


def _provenance(seen: Observed, accel: str, gyro: str, mode: Mode | None) -> Provenance:
    """Return the inputs and every setting that a fit used."""
    session, turns = seen.session, seen.session.turns
    if gyro == "known-rotation" and not turns:
        turns = seen.full_turns()
    names = (
        "window_s", "polynomial_degree", "settle_s", "spline_cutoff_hz", "latitude_deg", "angle_uncertainty_deg",
        "axis_uncertainty_deg",
    )  # fmt: skip
    numbers = {name: getattr(seen.settings, name) for name in names}
    for stated in (*((session.rate_table,) if gyro == "rate-table" else ()), session.sensitivity):
        numbers |= {item.name: getattr(stated, item.name) for item in fields(stated)}
    return Provenance(
        inputs=session.inputs,
        settings=(
            *(("accel", accel), ("gyro", gyro), ("mode", mode or "default")),
            *((name, "none" if value is None else f"{value:g}") for name, value in numbers.items()),
            ("gravity", session.gravity_source),
            ("stills", f"{len(seen.stills)} {'found' if seen.found else 'stated'}"),
            ("faces", ", ".join(face for face in FACES if face in {still.face for still in seen.faced}) or "none"),
            ("turns", f"{len(turns)} {'stated' if session.turns else 'found'}" if turns else "none"),
        ),
        versions=versions_used(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )


# ---- calibrate from recordings with an orientation reference: no rig, no poses, only motion


def calibrate_to_references(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    adc: Adc = "auto",
    settings: ReferenceSettings = ReferenceSettings(),
    lag_settings: LagSettings = LagSettings(),
    gravity_m_s2: float | None = None,
    gravity_source: GravitySource = "stated",
) -> Calibration:
    """Calibrate one device from recordings with an orientation reference.

    Accelerometers need rests on all six sides of the device.

    Parameters
    ----------
    records, references : sequence of Record, sequence of Reference
        Raw recordings of one device, best with a rest of 3 s before the motion, and the reference of each.
    adc : str
        "auto" fits what the codes lost if their rounding is identified; "none" leaves the codes.
    settings, lag_settings : ReferenceSettings, LagSettings
        Of the fit, and of the search for the lag between the clocks.
    gravity_m_s2, gravity_source
        Local gravity, m/s2, and where it is from; None assumes standard gravity, and the verdict says so.

    Returns
    -------
    Calibration
        Gyroscopes, and accelerometers if all recordings have them; the verdict names what neither rests nor motion show.

    Raises
    ------
    InputError
        All that ``fit_reference`` raises.
    """
    if gravity_m_s2 is None:
        gravity_m_s2, gravity_source = STANDARD_GRAVITY, "standard"
    check_choice(adc, Adc, "calibrate", "adc")
    check_local_gravity(gravity_m_s2, "reference")
    rounding = device_adc(records) if adc == "auto" else None
    fit = fit_reference(records, references, settings=settings, adc=rounding, lag_settings=lag_settings)
    accel, more = _accel_of(records, references, rounding, fit, gravity_m_s2)
    if accel is not None and gravity_source == "standard":
        more += (finding("session.gravity_assumed", "info", gravity_m_s2=gravity_m_s2),)
    return _calibration(
        records,
        gravity_m_s2=gravity_m_s2,
        gyro=fit.triad.model,
        accel=None if accel is None else accel.model,
        adc=rounding,
        verdict=fit.triad.verdict.also(Verdict.of(*more) if accel is None else Verdict.of(*more).also(accel.verdict)),
        settings=(
            ("gyro", "reference"),
            ("adc", adc),
            ("mounting", settings.mounting),
            ("gravity", gravity_source),
        ),
    )


def _calibration(
    records: Sequence[Record], serial: str = "", *, settings: tuple[tuple[str, str], ...], **fields: Any
) -> Calibration:
    """Return the calibration of whole recordings: at their mean temperature, with where it came from."""
    temps = [float(np.nanmean(record.temp_c)) for record in records if record.temp_c is not None]
    return Calibration(
        device=serial or records[0].device,
        reference_temp_c=float(np.mean(temps)) if temps else float("nan"),
        provenance=Provenance(
            settings=(*settings, ("recordings", f"{len(records)}")),
            versions=versions_used(),
            created=datetime.now(UTC).isoformat(timespec="seconds"),
        ),
        **fields,
    )


# ---- calibrate from recordings in motion: nothing else


def calibrate_from_motion(
    records: Sequence[Record],
    *,
    adc: Adc = "auto",
    gravity_m_s2: float | None = None,
    gravity_source: GravitySource = "stated",
    magnetometer: bool = False,
) -> Calibration:
    """Calibrate one device from recordings in which it is turned: gravity in motion shows both triads.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device in physical units, 20 s and more each, best with a rest somewhere.
    adc, gravity_m_s2, gravity_source
        As for ``calibrate_to_references``.
    magnetometer : bool
        Whether to fit the magnetometer too, by the recordings that have one.

    Returns
    -------
    Calibration
        Both triads; the gyroscopes' offset is that of all recordings. The verdict names what the motion did not show.

    Raises
    ------
    InputError, NotObservable
        As ``fit_in_motion``, or a corrected recording.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> from undrift import frames
    >>> rng = np.random.default_rng(7)
    >>> time = np.arange(3000) / 50.0
    >>> rate = 1.2 * np.sin(np.outer(time, [0.9, 0.7, 0.5]) + [0.0, 1.0, 2.0])  # rad/s, turned about all axes
    >>> q_nb = frames.integrate_strapdown(rate, time, np.array([1.0, 0.0, 0.0, 0.0]))
    >>> force = frames.rotate(frames.quaternion_conjugate(q_nb), np.array([0.0, 0.0, 9.8]))
    >>> gyro = rate * [1.0, 1.01, 1.0] + 1e-3 * rng.standard_normal((3000, 3))
    >>> record = undrift.Record(time=time, gyro=gyro, accel=force + 0.05 * rng.standard_normal((3000, 3)))
    >>> calibration = undrift.calibrate_from_motion([record], gravity_m_s2=9.8)
    >>> [f"{scale:.2f}" for scale in calibration.gyro.scale_factor]
    ['1.00', '1.01', '1.00']
    """
    check_choice(adc, Adc, "calibrate", "adc")
    if gravity_m_s2 is not None:
        check_local_gravity(gravity_m_s2, "motion")
    session = _session_of(records, gravity_m_s2, gravity_source)
    return from_motion(session, identify_adc=adc == "auto", magnetometer=magnetometer)[0]


def from_motion(session: Session, *, identify_adc: bool, magnetometer: bool = False) -> tuple[Calibration, InMotion]:
    """Calibrate from the motion in a session, and return with it the fit: offsets of each recording, what disturbed it."""
    _check_raw(session.records)
    given = in_one_unit(session).records
    stretches = [stretch for record in given for stretch in without_gaps(record)]
    records = [unpadded(stretch) for stretch in stretches]  # rows that fill a file up look like a rest
    findings = [item for pair in zip(stretches, records, strict=True) for item in padding(*pair)]
    missing = sum(map(len, given)) - sum(map(len, stretches))
    if missing:
        findings.append(finding("motion.gaps", "info", missing=missing, stretches=len(stretches)))
    findings += [item for record in records for item in check_triads(record)]
    assumed = session.gravity_source == "standard"
    if assumed:
        findings.append(finding("session.gravity_assumed", "info", gravity_m_s2=session.gravity_m_s2))
    adc = device_adc(records) if identify_adc else None
    readings = [restored(record, adc) for record in records]
    fit_readings = partial(
        fit_in_motion,
        gravity_m_s2=session.gravity_m_s2,
        gravity_uncertainty=GRAVITY_SPREAD if assumed else 0.0,
    )
    fit = fit_readings(readings)
    field = None
    if magnetometer:  # the field is then a second direction beside gravity
        field = _fit_field(readings, fit)
        for number, record in enumerate(readings):
            if record.mag_ut is not None:
                mag_ut = field.magnetometer.corrected(record.mag_ut, _rate_in_motion(record, fit, number))
                readings[number] = replace(record, mag_ut=mag_ut)
        fit = replace(fit_readings(readings, field=True), field=field)
    verdict = fit.gyro.verdict.also(Verdict.of(*each_once(findings)))
    calibration = _calibration(
        records,
        session.serial,
        gravity_m_s2=session.gravity_m_s2,
        gyro=fit.gyro.model,
        accel=fit.accel.model,
        magnetometer=None if field is None else field.magnetometer,
        adc=adc,
        verdict=verdict if field is None else verdict.also(field.verdict),
        settings=(
            ("gyro", "motion"),
            ("accel", "motion"),
            ("adc", "auto" if identify_adc else "none"),
            ("gravity", session.gravity_source),
        ),
        file_map=session.file_map,
    )
    return calibration, fit


def _rate_in_motion(record: Record, fit: InMotion, number: int) -> FloatArray:
    """Return the corrected rate (N, 3), rad/s, of a recording whose offset the fit has found."""
    return np.asarray((np.asarray(record.gyro) - fit.offsets[number]) @ fit.gyro.model.matrix.T)


def _fit_field(records: Sequence[Record], fit: InMotion) -> FieldFit:
    """Fit the magnetometer to the recordings that have one; the gyroscopes and gravity give the attitude."""
    readings: list[FieldReadings | None] = []
    for number, record in enumerate(records):
        if record.mag_ut is None:
            readings.append(None)
            continue
        force = (np.asarray(record.accel) - fit.accel.model.offset) @ fit.accel.model.matrix.T
        offset_sigma = float(fit.offset_uncertainty[number].max()) * fit.units[0]
        attitude = filtered_attitude(
            record.time, _rate_in_motion(record, fit, number), force, offset_sigma=offset_sigma
        )
        readings.append((record.time, record.mag_ut, attitude))
    if not any(readings):
        raise InputError(
            "magnetometer: wanted its readings in a recording, got none; map their columns (mag), or leave the option out"
        )
    return fit_magnetometer(readings)


def _check_raw(records: Sequence[Record]) -> None:
    if any(r.state == "corrected" for r in records):
        raise InputError(
            "calibrate: wanted raw readings, got a corrected record, whose offsets are gone; calibrate with the device's own "
            "recording"
        )


def _accel_of(
    records: Sequence[Record],
    references: Sequence[Reference],
    adc: AdcModel | None,
    fit: ReferenceFit,
    gravity_m_s2: float,
) -> tuple[TriadFit | None, tuple[Finding, ...]]:
    """Return the accelerometers' fit to the references, or why there is none."""
    if any(record.accel is None for record in records):
        return None, ()
    readings = [restored(record, adc) for record in records]
    try:
        accel_fit = fit_reference_accel(
            readings, references, mountings=fit.mountings, gravity_m_s2=gravity_m_s2, lags_s=fit.lags_s
        )
    except (CalibrationError, InputError) as error:
        nominal, why = turned_like(fit.triad.model, records[0].accel_unit), str(error)
        failed = (finding("reference.accel_failed", "info", reason=why),)
        return None if nominal is None else TriadFit(model=nominal, residuals=np.zeros(0), verdict=Verdict()), failed
    if (np.diag(accel_fit.model.matrix) < 0.0).all():
        raise Implausible(
            "reference: wanted accelerometers that read +g on the axis that points up, got -g on all three: acceleration has the "
            "opposite sign; reverse its columns"
        )
    return accel_fit, ()
