"""Procedure: from thermal sessions and a calibration to tuning tables, the note's Figure 2.

    temperature     trusted, smoothed; its lag estimated from ramps and taken off
    static drift    offset(T) from rests, absolute, raw unit                       blocks 2 to 5
    matrix          M(T) from rate steps at two soaks or more
    dynamic drift   e(w, T) of what is left                                        blocks 6 to 9
    accelerometers  offset(T) and M(T) from poses at several temperatures, else offset(T) from rests

Matrix and dynamic table are chosen by what they foretell of steps that were left out. Codes that the calibration knows to be
truncated get their half step back first, as ``correct`` does, so that a table is over the same numbers that it is taken off. What
the sessions cannot tell is a reason in the verdict, with the recording that would.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration, DriftTables, Provenance, Verdict
from undrift.calibration.observed import in_one_unit
from undrift.drift.fit.accel import AccelDriftFit, fit_accel_drift, with_accel
from undrift.drift.fit.asymmetry import Asymmetry, scale_asymmetry
from undrift.drift.fit.choose import Alternative, Choice, choose_tables
from undrift.drift.fit.dynamic import DynamicSettings
from undrift.drift.fit.static import StaticFit, StaticSettings, fit_static
from undrift.drift.lag import default_smooth_s, without_lag_smooth
from undrift.drift.lag_fit import LagFit, estimate_lag
from undrift.drift.observations import RateSteps, RestBlocks
from undrift.drift.observe import ObserveSettings, observe_rests, observe_steps
from undrift.drift.sessions import in_units_of, nominal_models
from undrift.drift.temperature import Temperature, TemperatureSettings, check_span, trusted_temperature
from undrift.errors import InputError, NotObservable
from undrift.session import Session

RANGE_C = (18.0, 75.0)  # the note's
STEP_C = 0.5
_WIDE = 0.5  # of the note's range: sessions that saw less have tables over what they saw
_SURE_LAG = 3.0  # standard uncertainties: a lag below is left in

TableChoice = Literal["auto"] | Alternative


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """Choices that a session does not make.

    Parameters
    ----------
    range_c : (float, float) or None
        First and last node, degC; None takes 18 to 75, widened to what was seen, or, where less than half of that was seen, the
        span seen.
    step_c : float
        From node to node, K.
    lag_s : float or None
        Lag of the thermometer, s; None estimates it from ramps, 0 leaves it in.
    tables : str
        Which of scale and dynamic tables: auto chooses, none, scale, dynamic, scale + dynamic.
    temperature, observe, static : TemperatureSettings, ObserveSettings, StaticSettings
        Of the stages.
    """

    range_c: tuple[float, float] | None = None
    step_c: float = STEP_C
    lag_s: float | None = None
    tables: TableChoice = "auto"
    temperature: TemperatureSettings = field(default_factory=TemperatureSettings)
    observe: ObserveSettings = field(default_factory=ObserveSettings)
    static: StaticSettings = field(default_factory=StaticSettings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftFit:
    """Tuning tables and how they came about.

    Parameters
    ----------
    calibration : Calibration
        The given one with the tables in it.
    static : StaticFit
        Offsets over temperature.
    choice : Choice or None
        Matrix and dynamic drift; None without rate steps at two soaks.
    accel : AccelDriftFit or None
        Accelerometers from poses; None without poses at two temperatures.
    asymmetry : Asymmetry or None
        Of the scale factors for the two ways round; None without rate steps.
    lag : LagFit or None
        Of the thermometer; None where it was stated.
    rests : RestBlocks
        What the static tables rest on.
    steps : RateSteps
        What the others rest on; may have no rows.
    temperatures : tuple of Temperature
        Of each recording, session after session.
    """

    calibration: Calibration
    static: StaticFit
    choice: Choice | None
    accel: AccelDriftFit | None
    asymmetry: Asymmetry | None
    lag: LagFit | None
    rests: RestBlocks
    steps: RateSteps
    temperatures: tuple[Temperature, ...]


def fit_drift(
    sessions: Sequence[Session], calibration: Calibration | None = None, *, settings: DriftSettings = DriftSettings()
) -> DriftFit:
    """Fit the tuning tables of a device.

    Parameters
    ----------
    sessions : sequence of Session
        Of one device, one or several; their scatter then counts as uncertainty.
    calibration : Calibration, optional
        Of the same device. Without one, readings in a physical unit keep their nominal scale; counts are refused.
    settings : DriftSettings
        Nodes, lag, tables.

    Returns
    -------
    DriftFit
        The calibration with its tables, and what they rest on.

    Raises
    ------
    InputError
        No session, another device than the calibration's, temperature missing or on another scale, units that do not agree.
    NotObservable
        A temperature that is constant or spans too little; no rests; counts without a calibration.
    """
    _check(sessions, calibration, settings)
    sessions = [in_one_unit(session) for session in sessions]
    device = calibration or nominal_models(sessions)
    sessions = [in_units_of(session, device) for session in sessions]
    wide = replace(settings.temperature, least_span_c=0.0)
    trusted = [[trusted_temperature(s, k, settings=wide) for k in range(len(s.records))] for s in sessions]
    together = tuple(temperature for of_session in trusted for temperature in of_session)
    check_span(together, settings=settings.temperature)
    lag, lag_s, rests, course = _without_lag(sessions, trusted, settings)
    steps = observe_steps(sessions, temperatures=course, settings=settings.observe)
    nodes = table_nodes(rests, steps, settings)
    static = fit_static(rests, nodes=nodes, calibration=device, settings=settings.static)
    said = list(_temperature_notes(together))
    choice = _chosen(steps, device, static, rests, settings, said)
    accel = _accelerometers(rests, device, nodes, said)
    tables = DriftTables(
        static=static.table,
        scale=None if choice is None else choice.scale_drift,
        dynamic=None if choice is None else choice.dynamic_drift,
        lag_s=lag_s,
        lag_smooth_s=_smooth_s(lag_s, sessions, together),
    )
    asymmetry = scale_asymmetry(steps, device, static=static.table) if len(steps) and device.gyro is not None else None
    verdict = _verdict(device, static, choice, accel, lag, said)
    return DriftFit(
        calibration=replace(
            device,
            drift=tables if accel is None else with_accel(tables, accel),
            verdict=verdict,
            provenance=_provenance(device, sessions, settings, lag_s, choice),
        ),
        static=static,
        choice=choice,
        accel=accel,
        asymmetry=asymmetry,
        lag=lag,
        rests=rests,
        steps=steps,
        temperatures=together,
    )


def table_nodes(rests: RestBlocks, steps: RateSteps, settings: DriftSettings) -> FloatArray:
    """Return the temperatures of the tables.

    Parameters
    ----------
    rests : RestBlocks
        What was seen at rest.
    steps : RateSteps
        What was seen turning.
    settings : DriftSettings
        Range and step.

    Returns
    -------
    array, shape (n,)
        degC; 18 to 75 by 0.5 makes 115.

    Raises
    ------
    InputError
        A range that is not one, or a step that does not divide it.
    """
    step = settings.step_c
    seen = np.concatenate((rests.temp_c, steps.temp_c))
    least, greatest = float(np.nanmin(seen)), float(np.nanmax(seen))
    low, high = settings.range_c or _default_range(least, greatest, step)
    count = (high - low) / step if step > 0.0 else 0.0
    if count < 1.0 or abs(count - round(count)) > 1e-6:
        raise InputError(
            f"drift tables: wanted a range that the step divides, got {low:g} to {high:g} degC by {step:g}; "
            "for example 18 to 75 by 0.5"
        )
    return np.linspace(low, high, round(count) + 1)


def _default_range(least: float, greatest: float, step: float) -> tuple[float, float]:
    outward = (float(np.floor(least / step) * step), float(np.ceil(greatest / step) * step))
    if greatest - least < _WIDE * (RANGE_C[1] - RANGE_C[0]):
        return outward
    return min(outward[0], RANGE_C[0]), max(outward[1], RANGE_C[1])


def _check(sessions: Sequence[Session], calibration: Calibration | None, settings: DriftSettings) -> None:
    if not sessions:
        raise InputError("drift: wanted a session or more, got none; name its folder")
    names = dict.fromkeys(s.serial or s.records[0].device for s in sessions)
    if calibration is not None:
        names[calibration.device] = None
    named = [name for name in names if name]
    if len(named) > 1:
        raise InputError(f"drift: wanted sessions and calibration of one device, got {', '.join(named)}; sort them")
    if settings.lag_s is not None and not 0.0 <= settings.lag_s < np.inf:
        raise InputError(f"drift: wanted a lag of 0 s or more, got {settings.lag_s:g}; state the thermometer's")


def _without_lag(
    sessions: Sequence[Session], trusted: list[list[Temperature]], settings: DriftSettings
) -> tuple[LagFit | None, float, RestBlocks, list[list[FloatArray]]]:
    """Estimate the lag from the rests, and gather them anew without it."""
    course = [[temperature.temp_c for temperature in of_session] for of_session in trusted]
    rests = observe_rests(sessions, temperatures=course, settings=settings.observe)
    lag = estimate_lag(rests) if settings.lag_s is None else None
    lag_s = settings.lag_s or 0.0
    # One speed alone does not tell lag from hysteresis: then it is reported and left in.
    if lag is not None and lag.observable and lag.two_speeds and lag.lag_s > _SURE_LAG * lag.uncertainty_s:
        lag_s = lag.lag_s
    if lag_s == 0.0:
        return lag, 0.0, rests, course
    led = [
        [
            temperature.temp_c
            if temperature.source == "set-points"
            else without_lag_smooth(temperature.temp_c, record.time, lag_s=lag_s)
            for temperature, record in zip(of_session, session.records, strict=True)
        ]
        for of_session, session in zip(trusted, sessions, strict=True)
    ]
    return lag, lag_s, observe_rests(sessions, temperatures=led, settings=settings.observe), led


def _chosen(
    steps: RateSteps,
    device: Calibration,
    static: StaticFit,
    rests: RestBlocks,
    settings: DriftSettings,
    said: list[str],
) -> Choice | None:
    if device.gyro is None or static.table.gyro_offset is None or settings.tables == "none":
        return None
    if not len(steps):
        said.append(
            "gyroscope scale over temperature is not observable from rests; turn the device at known rates at two temperatures"
        )
        return None
    nodes = static.table.temp_c
    try:
        choice = choose_tables(
            steps, device, static=static.table, temp_c=nodes, rests=rests, settings=DynamicSettings(temp_c=None)
        )
    except NotObservable as error:
        said.append(str(error))
        return None
    if settings.tables == "auto":
        return choice
    wanted = replace(
        choice.alternatives,
        chosen=settings.tables,
        reason=f"{settings.tables} was asked for; {choice.alternatives.reason}",
    )
    return replace(choice, alternatives=wanted)


def _accelerometers(rests: RestBlocks, device: Calibration, nodes: FloatArray, said: list[str]) -> AccelDriftFit | None:
    if device.accel is None or len(np.unique(rests.pose)) < 2 or np.isnan(rests.accel).all():
        return None
    try:
        return fit_accel_drift(rests, device, temp_c=nodes)
    except NotObservable as error:
        said.append(str(error))
        return None


def _smooth_s(lag_s: float, sessions: Sequence[Session], temperatures: tuple[Temperature, ...]) -> float:
    """Smoothing that taking the lag off needs in use, for the noisiest of the columns."""
    if lag_s == 0.0:
        return 0.0
    records = [record for session in sessions for record in session.records]
    return max(
        default_smooth_s(
            lag_s, noise_c=seen.noise_c, interval_s=float(np.median(np.diff(record.time))), step_c=seen.step_c
        )
        for record, seen in zip(records, temperatures, strict=True)
    )


def _temperature_notes(temperatures: tuple[Temperature, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(note for temperature in temperatures for note in temperature.notes))


def _verdict(
    device: Calibration,
    static: StaticFit,
    choice: Choice | None,
    accel: AccelDriftFit | None,
    lag: LagFit | None,
    said: list[str],
) -> Verdict:
    verdict = device.verdict.also(Verdict(status="marginal" if said else "good", reasons=tuple(said)))
    verdict = verdict.also(static.verdict)
    if choice is not None:
        verdict = verdict.also(choice.verdict).also(Verdict(reasons=(choice.alternatives.reason,)))
    if accel is not None:
        verdict = verdict.also(accel.verdict)
    return verdict if lag is None else verdict.also(Verdict(reasons=lag.notes))


def _provenance(
    device: Calibration, sessions: Sequence[Session], settings: DriftSettings, lag_s: float, choice: Choice | None
) -> Provenance:
    held = device.provenance
    inputs = dict.fromkeys((*held.inputs, *(entry for session in sessions for entry in session.inputs)))
    return Provenance(
        inputs=tuple(inputs),
        settings=(
            *(entry for entry in held.settings if not entry[0].startswith("drift_")),
            ("drift_spline", "not-a-knot" if settings.static.not_a_knot else "smoothing"),
            ("drift_lag_s", f"{lag_s:.4g}"),
            ("drift_tables", "static" if choice is None else f"static, {choice.alternatives.chosen}"),
            ("drift_sessions", f"{len(sessions)}"),
        ),
        versions=held.versions or _versions(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _versions() -> tuple[tuple[str, str], ...]:
    from importlib.metadata import version

    return tuple((name, version(name)) for name in ("undrift", "numpy", "scipy"))
