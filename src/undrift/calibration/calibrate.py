"""From a session to a Calibration, with the fits that its recordings allow.

    accelerometer   six-face where faces are labelled, or all six are found; else multi-position, from nine free poses
    gyroscope       rate-table        turns with an achieved rate about x, y and z
                    known-rotation    turns with an angle, or three full turns found between rests
                    multi-position    moves between nine still phases or more
                    rest              the offset alone, where the unit is physical

The first that the session allows is used, unless one is asked for by its name in ``FITS``. Codes that are found to be truncated
are corrected for their half step before anything is fitted, as ``correct`` does. What was not observable is a finding, with the
recording that would show it; so is what a kind of session never shows, however well it was recorded.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from undrift.base.summary import at
from undrift.calibration.codes import identify_record_adc, restored
from undrift.calibration.creep import creep_of, offset_drift
from undrift.calibration.element_prior import PUBLISHED, ElementPrior
from undrift.calibration.in_motion import InMotion, fit_in_motion, without_gaps
from undrift.calibration.known_rotation import calibrate_turns
from undrift.calibration.magnetometer import FieldFit, FieldReadings, fit_magnetometer
from undrift.calibration.multi_position import FEWEST_POSES, calibrate_moves, calibrate_poses
from undrift.calibration.pieces import check_accel
from undrift.calibration.plausibility import missing_faces, range_in_doubt, scale_as_stated
from undrift.calibration.rate_table import calibrate_rates, scale_verdict
from undrift.calibration.reference import ReferenceFit, ReferenceSettings
from undrift.calibration.reference_accel import fit_reference_accel, turned_like
from undrift.calibration.session import CalibrateSettings, Observed, Outcome, at_one_temperature, in_one_unit, observe
from undrift.calibration.settings import FITS, FitMethod
from undrift.calibration.six_face import calibrate_faces
from undrift.errors import CalibrationError, Implausible, InputError, NotObservable, PoorFit, check_choice
from undrift.findings import Finding, Level, finding
from undrift.fit.least_squares import TriadFit, triad_fit
from undrift.fit.priors import SCALE_FACTOR
from undrift.model import AdcModel, Calibration, Provenance, Verdict, versions_used
from undrift.plugins import load_named, names_in
from undrift.record import FACES, GravitySource, Record, Reference, Session, Turn, check_local_gravity
from undrift.segments import unpadded
from undrift.sync import LagSettings, padding
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

if TYPE_CHECKING:
    import pandas as pd

    from undrift.record import ArrowTable

Mode = Literal["paper", "affine", "levelled"]
Triad = Literal["accelerometer", "gyroscope"]
Adc = Literal["auto", "none"]

_LEAST_POSES = 9  # free poses of a multi-position fit
RADIANS = (0.4, 1.22)  # as degrees at the equator, as radians 23 to 70 deg, where people live


# ---- fits by their names


def calibrate_rest(seen: Observed, mode: str | None, accel: TriadFit | None) -> Outcome:
    """Take the offset of the gyroscopes from rests; the scale is the unit's own. An entry of FITS."""
    unit = seen.session.records[0].gyro_unit
    # Faces and poses alone are for the accelerometer; full turns were meant for the gyroscopes.
    level: Level = "warn" if accel is None or seen.turns_of(2.0 * np.pi) else "info"
    if not is_physical(unit):
        return Outcome(findings=(finding("gyro.not_observable", level),))
    factor, creep = si_factor(unit, "rate"), creep_of(seen, seen.stills, "gyro")
    offset, variance = seen.rest_rate(creep.columns(np.zeros(len(seen.stills)), 1.0 / factor)[:, 0])
    if np.isnan(offset).any():
        return Outcome(findings=(finding("gyro.not_observable", "warn"),))
    share = np.where(np.eye(3) > 0.0, SCALE_FACTOR, seen.settings.cross_axis_prior)
    covariance = np.diag(np.concatenate(((factor * share.ravel()) ** 2, variance)))
    residuals = (seen.rest_means() - offset) * factor
    fit = triad_fit(
        residuals,
        Verdict.of(finding("gyro.offset_alone", level, scale_percent=100.0 * SCALE_FACTOR)),
        method="rest",
        unit_in=unit,
        unit_out="rad/s",
        matrix=factor * np.eye(3),
        offset=offset,
        covariance=covariance,
        rank=3,
        condition=1.0,
        valid_range=(0.0, 0.0),
    )
    return Outcome(fit=fit, method="rest", findings=creep.findings())


ASSUMED_GRAVITY = 0.02  # m/s2: standard gravity against that of any place, 9.78 to 9.83
ENTRY_POINTS = "undrift.fits"  # other packages add a FitMethod under this group


def find_fit(name: str, kind: Literal["accel", "gyro", "reference"]) -> Callable[..., Any]:
    """Return the fit of a name from FITS, else from the entry points of other packages."""
    names = [each for each in names_in(FITS, ENTRY_POINTS) if each not in FITS or getattr(FITS[each], kind)]
    method = FITS.get(name) or (load_named(name, {}, ENTRY_POINTS, FitMethod) if name in names else FitMethod())
    if (fit := getattr(method, kind)) is None:
        raise InputError(f"calibrate: wanted {kind} one of {', '.join(names)}, got '{name}'; name one of them")
    return cast(Callable[..., Any], at(f"undrift.calibration.{fit}") if isinstance(fit, str) else fit)


def calibrate(
    session: "Session | Record | str | Path | pd.DataFrame | ArrowTable",
    *more: "Record | str | Path | pd.DataFrame | ArrowTable",
    accel: str | None = None,
    gyro: str | None = None,
    mode: Mode | None = None,
    settings: CalibrateSettings = CalibrateSettings(),
    **reading: Any,
) -> Calibration:
    """Calibrate a device from a session, or from recordings as the command line takes them.

    Parameters
    ----------
    session : Session, Record, str, Path or DataFrame
        Recordings; stills and turns as stated in it, else found in the data. A name is that of a session's folder or of a
        recording; a frame may be of pandas or polars.
    more : Record, str, Path or DataFrame
        Further recordings of the same device.
    accel : str, optional
        six-face, multi-position, or a fit that another package adds; None chooses.
    gyro : str, optional
        Likewise rate-table, known-rotation, multi-position, or rest (the offset alone); "none" for no gyroscope.
    mode : str, optional
        paper, affine or levelled; None is levelled for six faces and affine for turns.
    settings : CalibrateSettings
        Further choices.
    reading : dict
        Of recordings that are no Session: gravity_m_s2, or latitude_deg and height_m, and serial. Of files also column_map,
        sample_rate_hz, sensor, gaps, clock, drop_bad_rows, as the options of the command; of frames columns, units,
        sample_rate_hz, gaps, as ``Record.from_frame`` takes them.

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

    Examples
    --------
    >>> import numpy as np, undrift
    >>> device = undrift.random_device(np.random.default_rng(7))
    >>> session = undrift.simulate_session("bench", device, rng=np.random.default_rng(8))
    >>> made = undrift.calibrate(session)
    >>> made.gyro.method, made.accel.method, made.verdict.status
    ('rate-table/affine', 'six-face/levelled', 'good')
    """
    if not isinstance(session, Session) or more or reading:
        session = cast(Session, at("undrift.commands.files:session_given")(session, *more, **reading))
        settings = replace(settings, latitude_deg=reading.get("latitude_deg", settings.latitude_deg))
    return calibrated(session, accel=accel, gyro=gyro, mode=mode, settings=settings)[0]


def calibrated(
    session: Session, *, accel: str | None, gyro: str | None, mode: Mode | None, settings: CalibrateSettings
) -> tuple[Calibration, Observed]:
    """Calibrate a device from a session, and return with it what was seen of rests and turns."""
    if accel is not None:
        find_fit(accel, "accel")  # an unknown name is an error before anything is fitted
    if gyro not in (None, "none"):
        find_fit(str(gyro), "gyro")
    check_choice(mode, Mode | None, "calibrate", "mode")
    _check_raw(session.records)
    session, other_temperatures = at_one_temperature(in_one_unit(session))
    adc, seen = _observed(session, settings)
    of_accel = _calibrate_accel(seen, accel, mode)
    if of_accel.fit is not None:
        of_accel = of_accel.after(*check_accel(seen, of_accel.fit.model, of_accel.used))
    of_gyro = _calibrate_gyro(seen, gyro, mode, of_accel)
    unused = (*_mode_not_used(mode, "accelerometer", of_accel), *_mode_not_used(mode, "gyroscope", of_gyro))
    of_statements: tuple[Finding, ...] = ()
    if settings.latitude_deg is not None and RADIANS[0] < abs(settings.latitude_deg) < RADIANS[1]:
        shown = {"latitude_deg": settings.latitude_deg, "as_radians_deg": settings.latitude_deg / RADIAN_PER_DEGREE}
        of_statements += (finding("session.latitude_in_radians", "warn", **shown),)
    if session.gravity_source == "standard" and of_accel.fit is not None:
        of_statements += (finding("session.gravity_assumed", "warn", gravity_m_s2=session.gravity_m_s2),)
    if of_gyro.fit is not None and of_gyro.fit.model.unit_in == "count":
        largest = max(float(np.nanmax(np.abs(r.gyro))) for r in session.records if r.gyro is not None)
        scale = float(np.median(of_gyro.fit.model.scale_factor))
        of_statements += range_in_doubt(scale, largest)
        of_statements += (scale_as_stated(scale),) if of_gyro.method in ("rate-table", "known-rotation") else ()
    drifted = () if of_gyro.fit is None else offset_drift(seen, float(np.linalg.norm(of_gyro.fit.model.matrix, 2)))
    of_session = (*other_temperatures, *of_statements, *seen.findings, *drifted)
    found = each_once((*of_session, *of_accel.findings, *of_gyro.findings, *unused))
    if of_accel.fit is None and of_gyro.fit is None:
        reasons = "; ".join(item.text for item in found)
        raise NotObservable(f"calibrate: wanted poses or turns to fit, got none that can be used: {reasons}")
    verdict = Verdict.of(*found)
    for outcome in (of_accel, of_gyro):
        verdict = verdict if outcome.fit is None else verdict.also(outcome.fit.verdict)
    thermal = session.kind == "thermal" or bool(other_temperatures)
    calibration = Calibration(
        device=session.serial or session.records[0].device,
        reference_temp_c=seen.mean_temperature(),
        gravity_m_s2=session.gravity_m_s2,
        gyro=None if of_gyro.fit is None else of_gyro.fit.model,
        accel=None if of_accel.fit is None else of_accel.fit.model,
        adc=adc,
        verdict=verdict.also(Verdict.of(*limits_of(of_accel, of_gyro, seen.mean_temperature(), thermal=thermal))),
        provenance=_provenance(session, seen, of_accel.method, of_gyro.method, mode),
        file_map=session.file_map,
    )
    return calibration, seen


def _observed(session: Session, settings: CalibrateSettings) -> tuple[AdcModel | None, Observed]:
    """Return the converter's rounding, and what the session shows without it."""
    adc = identify_record_adc(*(r for r in session.records if r.state == "raw")) if settings.identify_adc else None
    return adc, observe(replace(session, records=tuple(restored(r, adc) for r in session.records)), settings)


def find_pieces(session: Session, settings: CalibrateSettings) -> tuple[Session, tuple[Turn, ...]]:
    """Return a bare session with what was found in it stated, and its steady turns, whose rate only the rig knows.

    Faces are stated where they are what the accelerometers would be calibrated by.
    """
    seen = _observed(in_one_unit(session), settings)[1]
    stills = seen.stills if seen.mostly_faces else tuple(replace(still, face=None) for still in seen.stills)
    turns = seen.session.turns or seen.full_turns()
    return replace(session, stills=stills, turns=turns), () if turns else seen.plateaus()


def each_once(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings, those that differ in their triad alone as one with both triads."""
    alike: dict[tuple[str, str, str], list[Finding]] = {}
    for item in findings:
        others = {name: value for name, value in item.values.items() if name != "triad"}
        alike.setdefault((item.code, item.level, repr(others)), []).append(item)
    return tuple(
        replace(group[-1], values={**group[-1].values, "triad": " and ".join(names)}) if names else group[-1]
        for group in alike.values()
        for names in ({str(item.values["triad"]): None for item in group if "triad" in item.values},)
    )


def _calibrate_accel(seen: Observed, method: str | None, mode: Mode | None) -> Outcome:
    if all(r.accel is None for r in seen.session.records):
        if method is not None:
            raise NotObservable(f"accelerometer by {method}: wanted its readings, got none; map the accel columns")
        return Outcome()
    if method is not None:
        return _as_asked("accelerometer", method, find_fit(method, "accel")(seen, mode, None))
    missing = missing_faces([s.face for s in seen.faced if s.face is not None])
    faces = not missing or (not seen.found and len(missing) == 1)
    if faces and (not seen.found or seen.mostly_faces):
        return calibrate_faces(seen, mode)
    rests = len(seen.stills)
    lacking = finding("session.too_few_poses", "warn", wanted=_LEAST_POSES, rests=rests, missing=missing)
    if rests < FEWEST_POSES:
        return Outcome(findings=(lacking,))
    try:
        return calibrate_poses(seen, mode)
    except (NotObservable, PoorFit) as error:
        if faces:
            return calibrate_faces(seen, mode)
        if rests < _LEAST_POSES:
            return Outcome(findings=(lacking,))
        if isinstance(error, PoorFit):
            raise
        failed = finding("session.fit_failed", "warn", triad="accelerometer", reason=str(error))
        there = tuple(face for face in FACES if face not in missing) or "none"
        lacking = finding("session.faces_missing", "warn", missing=missing, faces=there, wanted=_LEAST_POSES)
        return Outcome(findings=(lacking, failed))


def _calibrate_gyro(seen: Observed, method: str | None, mode: Mode | None, accel: Outcome) -> Outcome:
    if all(r.gyro is None for r in seen.session.records):
        if method is not None:
            raise NotObservable(f"gyroscope by {method}: wanted gyroscope readings, got none; map their columns")
        return Outcome()
    if method == "none":
        return Outcome(findings=(finding("gyro.left_out", "info"),))
    sound, spoilt = seen.without_saturated_turns()
    try:
        if method is not None:
            outcome = _as_asked("gyroscope", method, find_fit(method, "gyro")(sound, mode, accel.fit))
        elif spoilt and not sound.session.turns:
            outcome = calibrate_rest(seen, mode, accel.fit)
        else:
            outcome = _best_gyro(sound, mode, accel.fit)
    except NotObservable as error:
        if method is not None:
            raise NotObservable("; ".join((str(error), *(item.text for item in spoilt))), **error.numbers) from error
        outcome = calibrate_rest(seen, mode, accel.fit)
        outcome = replace(outcome, findings=()) if outcome.fit is None else outcome
        outcome = outcome.after(finding("session.fit_failed", "warn", triad="gyroscope", reason=str(error)))
    outcome = outcome.after(*spoilt)
    if outcome.fit is None:
        return outcome.after(*_offset_in_counts(seen, Verdict.of(*outcome.findings)))
    model = outcome.fit.model
    verdict = outcome.fit.verdict.also(scale_verdict(model.scale_factor, model.unit_in))
    return replace(outcome, fit=replace(outcome.fit, verdict=verdict))


def _as_asked(triad: Triad, method: str, outcome: Outcome) -> Outcome:
    if outcome.fit is None:
        raise NotObservable(f"{triad} by {method}: " + "; ".join(item.text for item in outcome.findings))
    return outcome


def _best_gyro(seen: Observed, mode: Mode | None, accel: TriadFit | None) -> Outcome:
    """Return the first of rate-table or known-rotation or multi-position, then rest, that gives a fit."""
    turns = seen.session.turns
    plateaus, outcome = 0, Outcome()
    if any(t.turn_rate is not None for t in turns):
        outcome = calibrate_rates(seen, mode, accel)
    elif any(t.angle is not None for t in turns) or seen.full_turns():
        outcome = calibrate_turns(seen, mode, accel)
    else:
        plateaus = len(seen.plateaus())
        if len(seen.stills) >= _LEAST_POSES:
            # Slow moves between poses are steady too; on a rate table without its rates the poses fail, for any reason.
            by_hand = accel is not None and accel.model.method == "multi-position"
            try:
                outcome = calibrate_moves(seen, mode, accel)
            except CalibrationError:
                if by_hand or not plateaus:
                    raise
            if plateaus and outcome.fit is not None and outcome.fit.verdict.status == "bad":
                outcome = Outcome()  # the turns of a table whose rates are not stated, taken for moves
    if outcome.fit is not None:
        return outcome
    steady = (finding("rate_table.rates_not_stated", "warn", turns=plateaus),) if plateaus else outcome.findings
    return calibrate_rest(seen, mode, accel).after(*steady)


def _offset_in_counts(seen: Observed, verdict: Verdict) -> Iterator[Finding]:
    # A model turns readings into rad/s: an offset without a scale has no place in it, and an invented scale would be used.
    unit = seen.session.records[0].gyro_unit
    offset, variance = seen.rest_rate()
    if not is_physical(unit) and not np.isnan(offset).any():
        sigma = np.sqrt(variance.max())
        level: Level = "info" if verdict.status == "good" else "warn"
        yield finding("gyro.offset_in_counts", level, offset=offset, unit=unit, uncertainty=sigma)


def _mode_not_used(mode: Mode | None, triad: Triad, outcome: Outcome) -> Iterator[Finding]:
    accel = triad == "accelerometer"
    without = outcome.method != "six-face" if accel else mode == "paper" and outcome.method == "multi-position"
    if outcome.fit is not None and mode in ("paper", "levelled") and without:
        needs = "rests on all six faces" if accel else "turns by known rates or angles"
        yield finding("paper_mode.not_used", "warn", mode=mode, triad=triad, method=outcome.method, needs=needs)


def limits_of(accel: Outcome, gyro: Outcome, temp_c: float, *, thermal: bool) -> Iterator[Finding]:
    """Return what this kind of session never shows, however well it was recorded."""
    if accel.fit is not None and accel.method in ("multi-position", "six-face"):
        yield finding("multi_position.mounting" if accel.method == "multi-position" else "six_face.fixture", "info")
    if gyro.fit is not None and gyro.method in ("multi-position", "known-rotation"):
        if gyro.method == "known-rotation":
            yield finding("known_rotation.other_rates", "info")
        elif gyro.fit.model.g_sensitivity is None:
            yield finding("multi_position.g_sensitivity", "info")
    if gyro.fit is not None and gyro.method in ("rate-table", "known-rotation") and accel.fit is None:
        # An offset that differs between the axes asks for the same recording.
        shown = any(item.code == "rate_table.axis_offset" for item in gyro.fit.verdict.findings)
        yield from () if shown else (finding("rate_table.no_accel", "info"),)
    if not thermal and np.isfinite(temp_c):
        yield finding("session.one_temperature", "info", temp_c=temp_c)
    elif not thermal:
        yield finding("session.unknown_temperature", "info")


def _provenance(session: Session, seen: Observed, accel: str, gyro: str, mode: Mode | None) -> Provenance:
    settings, turns = seen.settings, seen.session.turns
    if gyro == "known-rotation" and not turns:
        turns = seen.full_turns()
    names = (
        "window_s", "polynomial_degree", "settle_s", "spline_cutoff_hz", "latitude_deg", "angle_uncertainty_deg",
        "axis_uncertainty_deg",
    )  # fmt: skip
    numbers = ((name, getattr(settings, name)) for name in names)
    table = settings.rate_table(session.rate_table)
    of_table = tuple((item.name, f"{getattr(table, item.name):g}") for item in fields(table) if gyro == "rate-table")
    sensitivity = settings.sensitivity(session.sensitivity)
    of_creep = tuple((item.name, f"{getattr(sensitivity, item.name):g}") for item in fields(sensitivity))
    shown = ((name, "none" if value is None else f"{value:g}") for name, value in numbers)
    return Provenance(
        inputs=session.inputs,
        settings=(
            *(("accel", accel), ("gyro", gyro), ("mode", mode or "default"), *shown, *of_table, *of_creep),
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
    method: str = "reference",
    settings: ReferenceSettings = ReferenceSettings(),
    lag_settings: LagSettings = LagSettings(),
    gravity_m_s2: float | None = None,
    gravity_source: GravitySource = "stated",
) -> Calibration:
    """Calibrate one device from recordings with an orientation reference.

    Accelerometers need rests in several poses, or a reference that gives the position too.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device, best with a rest of 3 s before the motion.
    references : sequence of Reference
        One for each record.
    adc : str
        "auto" fits what the codes lost where their rounding is identified; "none" leaves the codes.
    method : str
        reference, or a fit that another package adds.
    settings : ReferenceSettings
        Of the fit.
    lag_settings : LagSettings
        Of the search for the lag between the clocks.
    gravity_m_s2 : float, optional
        Local gravity, m/s2; None assumes standard gravity, and the verdict says so.
    gravity_source : str
        "stated", or "latitude and height" where it was computed from these.

    Returns
    -------
    Calibration
        Gyroscopes, and accelerometers where all recordings have them; the verdict names what neither rests nor motion show.

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
    fit = find_fit(method, "reference")(records, references, settings=settings, adc=rounding, lag_settings=lag_settings)
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
            ("gyro", method),
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
    prior: ElementPrior = PUBLISHED,
    magnetometer: bool = False,
) -> Calibration:
    """Calibrate one device from recordings in which it is turned: gravity in motion shows both triads.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device in physical units, 20 s and more each, best with a rest somewhere.
    adc : str
        "auto" corrects the codes' rounding where they show it; "none" leaves them.
    gravity_m_s2 : float, optional
        Local gravity, m/s2; None assumes standard gravity, and the verdict says so.
    gravity_source : str
        "stated", or "latitude and height" where it was computed from these.
    prior : ElementPrior
        What devices of the part deviate by: published sizes, or those of calibrated devices by ``learn_prior``.
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
    if gravity_m_s2 is None:
        gravity_m_s2, gravity_source = STANDARD_GRAVITY, "standard"
    check_choice(adc, Adc, "calibrate", "adc")
    check_local_gravity(gravity_m_s2, "motion")
    session = Session(
        kind="calibration", serial="", records=tuple(records), gravity_m_s2=gravity_m_s2, gravity_source=gravity_source,
    )  # fmt: skip
    return from_motion(session, identify_adc=adc == "auto", prior=prior, magnetometer=magnetometer)[0]


def from_motion(
    session: Session, *, identify_adc: bool, prior: ElementPrior = PUBLISHED, magnetometer: bool = False
) -> tuple[Calibration, InMotion]:
    """Calibrate from the motion in a session, and return with it the fit: offsets of each recording, what disturbed it."""
    _check_raw(session.records)
    given = in_one_unit(session).records
    whole = [part for record in given for part in without_gaps(record)]
    records = [unpadded(record) for record in whole]  # rows that fill a file up look like a rest
    named = [one for pair in zip(whole, records, strict=True) for one in padding(*pair)]
    missing = sum(map(len, given)) - sum(map(len, whole))
    named += [finding("motion.gaps", "info", missing=missing, stretches=len(whole))] if missing else []
    named += [one for each in records for one in at("undrift.correction.consistency:check_triads")(each)]
    rounding = device_adc(records) if identify_adc else None
    assumed = session.gravity_source == "standard"
    readings = [restored(record, rounding) for record in records]
    gravity_error = ASSUMED_GRAVITY if assumed else 0.0
    fit_them = partial(fit_in_motion, gravity_m_s2=session.gravity_m_s2, gravity_uncertainty=gravity_error, prior=prior)
    fit = fit_them(readings)
    more = (finding("session.gravity_assumed", "info", gravity_m_s2=session.gravity_m_s2),) if assumed else ()
    calibration = _calibration(
        records,
        session.serial,
        gravity_m_s2=session.gravity_m_s2,
        gyro=fit.gyro.model,
        accel=fit.accel.model,
        adc=rounding,
        settings=(
            ("gyro", "motion"),
            ("accel", "motion"),
            ("prior", prior.source),
            ("adc", "auto" if identify_adc else "none"),
            ("gravity", session.gravity_source),
        ),
        file_map=session.file_map,
    )
    of_field = Verdict()
    if magnetometer:  # then once more, with the field as a second direction beside gravity
        field = _field_in(records, calibration)
        made, of_field = replace(calibration, magnetometer=field.magnetometer), field.verdict
        mags = [at("undrift.correction.correct:correct")(record, made).mag_ut for record in records]
        readings = [replace(record, mag_ut=mag) for record, mag in zip(readings, mags, strict=True)]
        fit = replace(fit_them(readings, field=True), field=field)
        calibration = replace(made, gyro=fit.gyro.model, accel=fit.accel.model)
    verdict = fit.gyro.verdict.also(Verdict.of(*each_once(named), *more)).also(of_field)
    return replace(calibration, verdict=verdict), fit


def _field_in(records: Sequence[Record], calibration: Calibration) -> FieldFit:
    """Fit the magnetometer to those recordings that have one, turned by gyroscopes and gravity."""
    readings: list[FieldReadings | None] = [None] * len(records)
    for number, record in enumerate(records):
        if record.mag_ut is None:
            continue
        done = at("undrift.correction.correct:correct")(record, calibration)
        how = at("undrift.orientation:OrientSettings")(method="vqf", offset="motion")
        track = at("undrift.orientation:orient_unchecked")(done, None, how, gyro_model=calibration.gyro)
        readings[number] = (track.time, record.mag_ut[record.time.searchsorted(track.time)], track.q_nb)
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
    try:
        accel_fit = fit_reference_accel(
            [restored(record, adc) for record in records],
            references,
            fit.triad.model,
            mountings=fit.mountings,
            gravity_m_s2=gravity_m_s2,
            lags_s=fit.lags_s,
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


def device_adc(records: Sequence[Record]) -> AdcModel | None:
    """Find how the gyroscope codes of one device were rounded, from all its recordings."""
    models = [model for model in map(identify_record_adc, records) if model is not None and model.gyro_lsb is not None]
    if not models:
        return None
    ranked = Counter(model.gyro_rounding for model in models).most_common()
    if len(ranked) > 1 and ranked[0][1] == ranked[1][1]:
        return None
    chosen = [model for model in models if model.gyro_rounding == ranked[0][0]]
    return min(chosen, key=lambda model: float(np.sum(np.asarray(model.gyro_lsb))))
