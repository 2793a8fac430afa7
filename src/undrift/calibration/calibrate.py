"""Fit a Calibration to a Session with the procedures that its recordings allow.

    accelerometer   six-face         rests on six faces, or on five that are labelled
                    multi-position   nine free poses or more
    gyroscope       rate-table       turns at a known rate about x, y and z
                    known-rotation   turns by a known angle, given or detected between rests
                    multi-position   moves between nine rests or more
                    rest             offset only, if the readings are in a physical unit

The first procedure that the session allows is used, unless the caller names another. Truncated readings are corrected by half a
step before the fit, as ``correct`` does. If the session does not determine a parameter, a finding names a recording that does.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import UTC, datetime
from numbers import Real
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import device_adc, restored
from undrift.calibration.in_motion import InMotion, fit_in_motion, moves_enough, without_gaps
from undrift.calibration.known_rotation import calibrate_turns
from undrift.calibration.moves import FEWEST_POSES, calibrate_moves, calibrate_poses
from undrift.calibration.plausibility import check_gyro_scale, missing_faces
from undrift.calibration.quality import check_accel, mean_reading
from undrift.calibration.rate_table import calibrate_rates
from undrift.calibration.reference import ReferenceFit, fit_reference
from undrift.calibration.reference_accel import fit_reference_accel, turned_like
from undrift.calibration.session import Observed, at_one_temperature, check_alike, observe
from undrift.calibration.settings import AccelFit, CalibrateSettings, GyroFit, Mode
from undrift.calibration.six_face import calibrate_faces
from undrift.calibration.sources import Kind, creep_of, name_stated_sources, temperature_span
from undrift.calibration.triads import check_triads
from undrift.errors import CalibrationError, InputError, NotObservable, check_choice, check_type
from undrift.findings import Finding, Level, finding
from undrift.fit.priors import SCALE_FACTOR
from undrift.fit.triad import TriadFit, triad_fit
from undrift.kernels.attitude import filtered_attitude
from undrift.model import Calibration, Magnetometer, Provenance, TriadModel, Verdict, versions_used
from undrift.record import FACES, Mounting, Record, Reference, Session, Turn
from undrift.segments import unpadded
from undrift.sync import LONGEST_LAG_S, padding
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

Fit = Callable[[Observed, Mode, TriadFit | None], TriadFit]

MIN_FREE_POSES = 9  # smallest number of poses of a multi-position fit
LATITUDE_LIKE_RADIANS = (0.4, 1.22)  # latitudes that may be in radians (23 to 70 deg, where people live)
GRAVITY_SPREAD = (
    0.02  # m/s2: largest difference between standard gravity and local gravity, which ranges from 9.78 to 9.83
)
GIVE_GRAVITY = "Give `gravity_m_s2`, or `latitude_deg` and `height_m`."
FROM_MOTION = (
    "The device turns about several axes, so its motion is enough to calibrate it (command line: --from motion, Python: "
    "calibrate_from_motion, bench: Other ways)."
)
RECORD_TURNS = "Record turns by known rates or angles."


def calibrate_rest(observed: Observed, mode: Mode, accel: TriadFit | None) -> TriadFit:
    """Measure the offset of the gyroscopes at rest, with a nominal scale factor."""
    records, stills, unit = observed.session.records, observed.stills, observed.session.records[0].gyro_unit
    if not stills or not is_physical(unit):  # a model gives rad/s, and the scale of counts is unknown
        raise NotObservable(f"The session does not determine the gyroscope. {RECORD_TURNS}")
    factor, creep = si_factor(unit, "rate"), creep_of(observed, stills, "gyro")
    offset, variance = observed.rest_rate(creep.columns(np.zeros(len(stills)), 1.0 / factor)[:, 0])
    means = np.array([mean_reading(records[still.recording].gyro, still.start, still.stop) for still in stills])
    if np.isnan(offset).any():
        raise NotObservable("The gyroscope has no readings at rest. Record a rest without gaps.")
    share = np.where(np.eye(3) > 0.0, SCALE_FACTOR, observed.settings.cross_axis_prior)
    nominal = f"the nominal scale is used with +- {100.0 * SCALE_FACTOR:g} % (1 sigma)."
    return triad_fit(
        (means[~np.isnan(means).any(axis=1)] - offset) * factor,
        _no_scale(observed, accel, "Gyroscope scale", why=nominal),
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


ACCEL_FITS: dict[str, Fit] = {"six-face": calibrate_faces, "multi-position": calibrate_poses}
GYRO_FITS: dict[str, Fit] = {
    "rate-table": calibrate_rates,
    "known-rotation": calibrate_turns,
    "multi-position": calibrate_moves,
    "rest": calibrate_rest,
}


def calibrate(
    session: Session | Record,
    *further: Record,
    accel: AccelFit | None = None,
    gyro: GyroFit | None = None,
    mode: Mode | None = None,
    gravity_m_s2: float | None = None,
    serial: str = "",
    settings: CalibrateSettings = CalibrateSettings(),
) -> Calibration:
    """Calibrate a device from a session, or from recordings of the device.

    Parameters
    ----------
    session, further : Session, or recordings of one device
        A session's stills and turns are used as given. Recordings have no stills and turns, so these are detected.
    accel, gyro : str, optional
        Method of each triad. None selects the first method that the session allows; gyro "none" omits the gyroscopes.
    mode : str, optional
        "paper" or "affine". None is affine.
    gravity_m_s2 : float, optional
        Local gravity of recordings, m/s2. If None, standard gravity is assumed and the verdict reports it.
    serial : str
        Serial number of the device of recordings.
    settings : CalibrateSettings
        Further choices.

    Returns
    -------
    Calibration
        Models of the triads that the recordings determine, with verdict and provenance.

    Raises
    ------
    NotObservable
        The recordings do not allow the requested fit, or do not allow any fit.
    Implausible
        The data cannot come from this device.
    InputError
        A choice is unknown, or a recording is unusable.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> device = undrift.random_device(np.random.default_rng(7))
    >>> session = undrift.simulate_session("bench", device, rng=np.random.default_rng(8))
    >>> calibration = undrift.calibrate(session)
    >>> calibration.gyro.method, calibration.accel.method, calibration.verdict.status
    ('rate-table/affine', 'six-face/affine', 'good')
    """
    for number, value in enumerate((session, *further)):
        kinds = Record if number else Session | Record
        check_type(value, kinds, "calibrate", "Read a file with read_record, or a folder with read_session.")
    check_type(settings, CalibrateSettings, "calibrate: `settings`", "Write CalibrateSettings(...).")
    if isinstance(session, Record):
        session = _build_session((session, *further), gravity_m_s2, serial)
    elif further or gravity_m_s2 is not None or serial:
        raise InputError(
            "calibrate: a Session already contains its recordings, gravity and serial number. Give the session only."
        )
    return calibrated(session, accel=accel, gyro=gyro, mode=mode, settings=settings)[0]


def _build_session(records: Sequence[Record], gravity_m_s2: float | None, serial: str = "") -> Session:
    """Return recordings as a session, with standard gravity if none is given."""
    check_type(gravity_m_s2, Real | None, "calibrate: `gravity_m_s2`", "Give a number in m/s2.")
    return Session(
        kind="calibration",
        serial=serial or records[0].device,
        records=tuple(records),
        gravity_m_s2=STANDARD_GRAVITY if gravity_m_s2 is None else gravity_m_s2,
        gravity_source="standard" if gravity_m_s2 is None else "stated",
    )


def calibrated(
    session: Session,
    *,
    accel: AccelFit | None = None,
    gyro: GyroFit | None = None,
    mode: Mode | None = None,
    settings: CalibrateSettings = CalibrateSettings(),
) -> tuple[Calibration, Observed]:
    """Calibrate a device from a session, and also return the detected rests and turns."""
    check_choice(accel, AccelFit | None, "calibrate", "accel")
    check_choice(gyro, GyroFit | None, "calibrate", "gyro")
    check_choice(mode, Mode | None, "calibrate", "mode")
    _check_raw(session.records)
    session, other_temperatures = at_one_temperature(session)
    observed = observe(session, settings)
    accel_fit, accel_findings = _calibrate_accel(observed, accel, mode or "affine")
    gyro_fit, gyro_findings = _calibrate_gyro(observed, gyro, mode or "affine", accel_fit)
    if mode == "paper" and "multi-position" in (_method(accel_fit), _method(gyro_fit)):
        raise InputError(
            "calibrate: mode paper requires rests on six faces and known turns. Record them, or use mode affine."
        )
    findings = [*other_temperatures, *_doubts(observed, accel_fit, gyro_fit), *accel_findings, *gyro_findings]
    models = dict[str, TriadModel]()
    kinds: tuple[Kind, Kind] = ("accel", "gyro")
    visible = () if accel_fit is None else ("mounting",)  # gravity measures the g-sensitivity
    for kind, fit in zip(kinds, (accel_fit, gyro_fit), strict=True):
        if fit is not None:
            models[kind] = fit.model
            stated = name_stated_sources(kind, fit.model, observed.session, settings, visible=visible)
            findings += (*fit.findings, *stated)
    if not models:
        reasons = [item.text for item in findings]
        if moves_enough(session.records):
            reasons.append(FROM_MOTION)
        raise NotObservable(f"calibrate: no pose or turn can be used for a fit: {' '.join(reasons)}")
    choices = _choices(observed, _method(accel_fit), _method(gyro_fit), mode)
    temp_c = observed.mean_temperature()
    return _build_calibration(session, choices, temp_c, findings, adc=observed.adc, **models), observed


def _method(fit: TriadFit | None) -> str:
    """Return the name of a fit without its mode."""
    return "none" if fit is None else fit.model.method.partition("/")[0]


def _not_observable(what: str, level: Level, *, record: str, why: str = "") -> Finding:
    sentence = f"The session does not determine the {what[0].lower()}{what[1:]}{f': {why}' if why else '.'}"
    return finding("session.not_observable", level, sentence, record, what=what)


def _gravity_assumed(gravity_m_s2: float, level: Level) -> Finding:
    sentence = f"Standard gravity was assumed, {gravity_m_s2:.5f} m/s2, so the accelerometer scale may be off by 0.3 %."
    return finding("session.gravity", level, sentence, GIVE_GRAVITY)


def _doubts(observed: Observed, accel: TriadFit | None, gyro: TriadFit | None) -> Iterator[Finding]:
    """Yield findings about doubtful settings, about rests and turns, and about quantities that no fit determines."""
    latitude_deg = observed.settings.latitude_deg
    if latitude_deg is not None and LATITUDE_LIKE_RADIANS[0] < abs(latitude_deg) < LATITUDE_LIKE_RADIANS[1]:
        as_degrees = f"{latitude_deg:g} rad is {latitude_deg / RADIAN_PER_DEGREE:.4g} deg"
        yield finding(
            "session.gravity", "warn", f"The latitude {latitude_deg:g} may be in radians: {as_degrees}.", GIVE_GRAVITY
        )
    if observed.session.gravity_source == "standard" and accel is not None:
        yield _gravity_assumed(observed.session.gravity_m_s2, "warn")
    if gyro is not None:
        largest = max(float(np.nanmax(np.abs(r.gyro))) for r in observed.session.records if r.gyro is not None)
        rates_given = _method(gyro) in ("rate-table", "known-rotation")
        yield from check_gyro_scale(gyro.model.scale_factor, gyro.model.unit_in, largest, rates_given=rates_given)
        if accel is None and rates_given:
            record = "Record rests on six faces with accelerometers in the same session."
            yield _not_observable("g-sensitivity of the gyroscopes", "info", record=record)
    yield from observed.findings
    yield from temperature_span(observed) if accel or gyro else ()
    if accel is not None:
        free_poses = _method(accel) == "multi-position"
        if free_poses:
            record = "Rest on six faces of the case, because free poses determine only the length of gravity."
            yield _not_observable("Mounting of the sensors in the case", "info", record=record)
        unused = observed.unused_stills(observed.stills if free_poses else observed.faced)
        yield from check_accel(observed.session, accel.model, unused)


def find_pieces(session: Session, settings: CalibrateSettings) -> tuple[Session, tuple[Turn, ...]]:
    """Return a session with the rests and turns detected in it, and its steady turns, whose rate must come from the rig.

    Rests get a face label if the accelerometers would be calibrated on faces.
    """
    observed = observe(session, settings)
    stills = observed.stills if observed.mostly_faces else tuple(replace(still, face=None) for still in observed.stills)
    turns = observed.session.turns
    return replace(session, stills=stills, turns=turns), () if turns else observed.plateaus()


# ---- one triad: the requested fit, or the first fit that the session allows


def _calibrate_accel(
    observed: Observed, method: AccelFit | None, mode: Mode
) -> tuple[TriadFit | None, tuple[Finding, ...]]:
    """Return the fit of the accelerometers. If there is no fit, a finding gives the reason."""
    if all(record.accel is None for record in observed.session.records):
        if method is not None:
            raise NotObservable(f"accelerometer by {method}: no accelerometer readings. Map the accel columns.")
        return None, ()
    missing = missing_faces([still.face for still in observed.faced if still.face is not None])
    faces = observed.mostly_faces if observed.found else len(missing) < 2
    name = method or ("six-face" if faces else "multi-position")
    try:
        if method is None and not faces and len(observed.stills) < FEWEST_POSES:
            raise NotObservable(
                f"expected rests on six faces or {MIN_FREE_POSES} free poses, got {len(observed.stills)}."
            )
        return ACCEL_FITS[name](observed, mode, None), ()
    except NotObservable as error:
        if method is not None or faces:
            raise
        why = f"{error} Faces without a rest: {', '.join(missing) or 'none'}."
        return None, (_not_observable("Accelerometer", "warn", why=why, record="Record the missing rests."),)


def _calibrate_gyro(
    observed: Observed, method: GyroFit | None, mode: Mode, accel: TriadFit | None
) -> tuple[TriadFit | None, tuple[Finding, ...]]:
    """Fit the gyroscopes, or measure their offset at rest if no fit is possible, and return findings about missing turns."""
    if method == "none" or all(record.gyro is None for record in observed.session.records):
        if method not in (None, "none"):
            raise NotObservable(f"gyroscope by {method}: no gyroscope readings. Map the gyro columns.")
        return None, ()
    sound, findings = observed.without_saturated_turns()
    name = method or _choose_gyro_fit(sound, bool(findings))
    fit: TriadFit | None = None
    try:
        fit = GYRO_FITS[name](sound, mode, accel)
    except NotObservable as error:
        if method is not None:
            reasons = (f"gyroscope by {method}: {error}", *(item.text for item in findings))
            raise NotObservable(" ".join(reasons), **error.numbers) from error
        if name == "rest":
            return None, (*findings, _no_scale(observed, accel, "Gyroscope"))
        findings = (*findings, _not_observable("Gyroscope scale", "warn", why=str(error), record=RECORD_TURNS))
        with suppress(NotObservable):
            fit = calibrate_rest(observed, mode, accel)
    return fit, findings


def _no_scale(observed: Observed, accel: TriadFit | None, what: str, why: str = "") -> Finding:
    """Return a finding about gyroscopes without known turns.

    Faces and poses serve the accelerometers, but full or steady turns were recorded for the gyroscopes.
    """
    steady = 0 if observed.session.turns else len(observed.plateaus())
    full_turns = is_physical(observed.session.records[0].gyro_unit) and observed.turns_of(2.0 * np.pi)
    level: Level = "warn" if accel is None or steady or full_turns else "info"
    record = f"Give turn_rate_dps and axis for each of {steady} steady turns." if steady else RECORD_TURNS
    return _not_observable(what, level, record=record, why=why)


def _choose_gyro_fit(observed: Observed, saturated: bool) -> GyroFit:
    """Return the first fit of the table above that the session allows."""
    turns = observed.session.turns
    if any(turn.turn_rate is not None for turn in turns):
        return "rate-table"
    if saturated and not turns:
        return "rest"
    if any(turn.angle is not None for turn in turns):
        return "known-rotation"
    with_force = observed.session.records[0].accel is not None
    return "multi-position" if with_force and len(observed.stills) >= MIN_FREE_POSES else "rest"


# ---- provenance of a calibration


def _choices(observed: Observed, accel: str, gyro: str, mode: Mode | None) -> dict[str, object]:
    """Return every setting and every part of the session that a fit used."""
    session, settings = observed.session, asdict(observed.settings)
    faces = {still.face for still in observed.faced}
    return {
        "accel": accel,
        "gyro": gyro,
        "mode": mode or "default",
        **{name: value for name, value in settings.items() if name != "still"},
        **(asdict(session.rate_table) if gyro == "rate-table" else {}),
        **asdict(session.sensitivity),
        "stills": f"{len(observed.stills)} {'found' if observed.found else 'stated'}",
        "faces": ", ".join(face for face in FACES if face in faces) or "none",
        "turns": f"{len(session.turns)} stated" if session.turns else "none",
    }


def _check_raw(records: Sequence[Record]) -> None:
    if any(r.state == "corrected" for r in records):
        raise InputError(
            "calibrate: expected raw readings, got a corrected record without its offsets. Calibrate with the recording that the "
            "device wrote."
        )


def _build_calibration(
    session: Session,
    choices: Mapping[str, object],
    temp_c: float,
    findings: Iterable[Finding],
    **of_calibration: Any,
) -> Calibration:
    settings = {**choices, "gravity": session.gravity_source}
    texts = ((n, "none" if v is None else v if isinstance(v, str) else f"{v:g}") for n, v in settings.items())
    return Calibration(
        device=session.serial or session.records[0].device,
        reference_temp_c=temp_c,
        gravity_m_s2=session.gravity_m_s2,
        provenance=Provenance(
            inputs=session.inputs,
            settings=tuple(texts),
            versions=versions_used(),
            created=datetime.now(UTC).isoformat(timespec="seconds"),
        ),
        file_map=session.file_map,
        verdict=Verdict.of(*findings),
        **of_calibration,
    )


def _mean_temperature(records: Sequence[Record]) -> float:
    temps = [float(np.nanmean(record.temp_c)) for record in records if record.temp_c is not None]
    return float(np.mean(temps)) if temps else float("nan")


# ---- recordings with an orientation reference: no rig, no poses, only motion


def calibrate_to_references(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    mounting: Mounting = "each",
    longest_lag_s: float = LONGEST_LAG_S,
    gravity_m_s2: float | None = None,
) -> Calibration:
    """Calibrate one device from recordings with an orientation reference.

    Accelerometers need rests on all six sides of the device.

    Parameters
    ----------
    records, references : sequence of Record, sequence of Reference
        Raw recordings of one device, best with a rest of 3 s before the motion, and one reference per recording.
    mounting : str
        "each" if the device was put on the reference body again for each recording, or "one".
    longest_lag_s : float
        Largest lag between the clocks, s.
    gravity_m_s2 : float, optional
        Local gravity, m/s2. If None, standard gravity is assumed and the verdict reports it.

    Returns
    -------
    Calibration
        Gyroscopes, and accelerometers if all recordings have them. The verdict names parameters that are not observable.

    Raises
    ------
    InputError
        The recordings or references are unusable, as for ``fit_reference``.
    """
    session = _build_session(records, gravity_m_s2)
    adc = device_adc(records)
    fit = fit_reference(records, references, mounting=mounting, adc=adc, longest_lag_s=longest_lag_s)
    findings, accel = [*fit.triad.findings], None
    if all(record.accel is not None for record in records):
        readings = [restored(record, adc) for record in records]
        accel, accel_findings = _accel_by_reference(readings, references, fit, session.gravity_m_s2)
        findings += accel_findings
    if accel is not None:
        findings += name_stated_sources("accel", accel, session, CalibrateSettings(), visible=("instability",))
        findings += [_gravity_assumed(session.gravity_m_s2, "info")] if session.gravity_source == "standard" else []
    choices = {"gyro": "reference", "mounting": mounting, "recordings": len(records)}
    temp_c = _mean_temperature(records)
    return _build_calibration(session, choices, temp_c, findings, gyro=fit.triad.model, accel=accel, adc=adc)


def _accel_by_reference(
    readings: Sequence[Record], references: Sequence[Reference], fit: ReferenceFit, gravity_m_s2: float
) -> tuple[TriadModel | None, tuple[Finding, ...]]:
    """Return the accelerometers fitted to the references. Otherwise, return nominal ones and the reason for it."""
    try:
        accel = fit_reference_accel(
            readings, references, mountings=fit.mountings, gravity_m_s2=gravity_m_s2, lags_s=fit.lags_s
        )
    except (CalibrationError, InputError) as error:
        failed = _not_observable("Accelerometer", "info", why=str(error), record="Record rests on six sides.")
        return turned_like(fit.triad.model, readings[0].accel_unit), (failed,)
    return accel.model, accel.findings


# ---- recordings in motion only


def calibrate_from_motion(
    records: Sequence[Record],
    *,
    gravity_m_s2: float | None = None,
    magnetometer: bool = False,
) -> Calibration:
    """Calibrate both triads of a device from recordings in which it is turned about all axes.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device in physical units, 20 s or more each, best with a rest somewhere.
    gravity_m_s2 : float, optional
        As for ``calibrate_to_references``.
    magnetometer : bool
        If True, also calibrate the magnetometer with the recordings that have one.

    Returns
    -------
    Calibration
        Both triads, with the mean offset of the gyroscopes over all recordings. The verdict names elements that the motion
        did not determine.

    Raises
    ------
    InputError
        A recording is corrected already, or ``fit_in_motion`` cannot use it.
    NotObservable
        The device is not turned about all axes.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng, grade="wearable")
    >>> record = undrift.simulate_trial("free", device, rng=rng).record
    >>> calibration = undrift.calibrate_from_motion([record], gravity_m_s2=9.81)
    >>> calibration.gyro.unit_in, calibration.gyro.method
    ('dps', 'motion')
    """
    return from_motion(_build_session(records, gravity_m_s2), magnetometer=magnetometer)[0]


def from_motion(session: Session, *, magnetometer: bool = False) -> tuple[Calibration, InMotion]:
    """Calibrate from the motion in a session, and also return the fit with the offset of each recording."""
    _check_raw(session.records)
    check_alike(session)
    stretches = [stretch for record in session.records for stretch in without_gaps(record)]
    records = [unpadded(stretch) for stretch in stretches]  # padding rows at the end of a file look like a rest
    findings = [item for pair in zip(stretches, records, strict=True) for item in padding(*pair)]
    findings += [item for record in records for item in check_triads(record)]
    assumed = session.gravity_source == "standard"
    if assumed:
        findings.append(_gravity_assumed(session.gravity_m_s2, "info"))
    adc = device_adc(records)
    readings = [restored(record, adc) for record in records]
    gravity, uncertainty = session.gravity_m_s2, GRAVITY_SPREAD if assumed else 0.0
    fit = fit_in_motion(readings, gravity_m_s2=gravity, gravity_uncertainty=uncertainty)
    field, field_findings = None, tuple[Finding, ...]()
    if magnetometer:  # the magnetic field then is a second reference direction next to gravity
        rates = [
            (np.asarray(record.gyro) - offset / si_factor(record.gyro_unit, "rate")) @ fit.gyro.model.matrix.T
            for record, offset in zip(readings, fit.offsets, strict=True)
        ]
        field, field_findings = _fit_field(readings, rates, fit)
        fields = [
            None if record.mag_ut is None else field.corrected(record.mag_ut, rate)
            for record, rate in zip(readings, rates, strict=True)
        ]
        fit = fit_in_motion(readings, fields=fields, gravity_m_s2=gravity, gravity_uncertainty=uncertainty)
    calibration = _build_calibration(
        session,
        {"gyro": "motion", "accel": "motion", "recordings": len(records)},
        _mean_temperature(records),
        (*fit.gyro.findings, *field_findings, *findings),
        gyro=fit.gyro.model,
        accel=fit.accel.model,
        magnetometer=field,
        adc=adc,
    )
    return calibration, fit


def _fit_field(
    records: Sequence[Record], rates: Sequence[FloatArray], fit: InMotion
) -> tuple[Magnetometer, tuple[Finding, ...]]:
    """Fit the magnetometer with the recordings that have one. Gyroscopes and gravity determine the attitude."""
    from undrift.calibration.magnetometer import FieldReadings, fit_magnetometer  # imports much of scipy

    readings = dict[int, FieldReadings]()
    for number, (record, rate) in enumerate(zip(records, rates, strict=True)):
        if record.mag_ut is not None:
            force = (np.asarray(record.accel) - fit.accel.model.offset) @ fit.accel.model.matrix.T
            offset_sigma = float(fit.offset_uncertainty[number].max())
            attitude, _ = filtered_attitude(record.time, rate, force, offset_sigma=offset_sigma)
            readings[number] = (record.time, record.mag_ut, attitude)
    if not readings:
        raise InputError(
            "magnetometer: no recording has magnetometer readings. Map their columns (mag), or omit the option."
        )
    return fit_magnetometer(readings)
