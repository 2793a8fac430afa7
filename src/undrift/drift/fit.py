"""From thermal sessions and a calibration to tuning tables, the note's Figure 2.

    temperature     checked, smoothed; its lag estimated from ramps and subtracted
    static drift    offset(T) from rests, absolute, raw unit                       blocks 2 to 5
    matrix          M(T) from rate steps at two soaks or more
    dynamic drift   e(w, T) of what is left                                        blocks 6 to 9
    accelerometers  offset(T) and M(T) from poses at several temperatures, else offset(T) from rests

Matrix and dynamic table are selected by their cross-validated error. Codes that the calibration knows to be truncated get their
half step back first, as in ``correct``, so that a table is over the same numbers that it is subtracted from. What was not
observable is a finding of the verdict, with the recording that would show it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.summary import Shown
from undrift.calibration.observe import ROOM_C, in_one_unit
from undrift.drift import checks
from undrift.drift.accel import AccelDriftFit, fit_accel_drift, with_accel
from undrift.drift.observe import ObserveSettings, RateSteps, RestBlocks, observe_rests, observe_steps
from undrift.drift.rests import with_g_sensitivity
from undrift.drift.scale import Asymmetry, scale_asymmetry
from undrift.drift.select import Alternative, Choice, choose_tables, cropped_choice, cropped_static, widened
from undrift.drift.sessions import (
    accel_unit_of,
    check_at_rest,
    check_once,
    in_units_of,
    met_in_use,
    nominal_models,
    sensor_course,
    since_power_on,
)
from undrift.drift.static import StaticFit, StaticSettings, fit_static
from undrift.drift.temperature import Temperature, TemperatureSettings, check_span, trusted_temperature
from undrift.drift.thermometer_lag import LagFit, default_smooth_s, estimate_lag
from undrift.errors import InputError, NotObservable
from undrift.findings import finding
from undrift.fit.least_squares import determined
from undrift.model import BEYOND_SEEN_C, Calibration, DriftTables, Provenance, Verdict, seen_span, versions_used
from undrift.record import Session

RANGE_C = (18.0, 75.0)  # the note's
STEP_C = 0.5
_SURE_LAG = 3.0  # standard uncertainties: a lag below is left in
_LAG_BY_LOOPS_S = 15.0  # by which a loop of any shape moves the lag that is found, one standard deviation
_INPUTS = "drift_inputs_before"  # setting: how many inputs the calibration had before a thermal fit

TableChoice = Literal["auto"] | Alternative
Progress = Callable[[str, float], None]  # what is done next, and which share of the work is done


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """Choices that a session does not make.

    Parameters
    ----------
    range_c : tuple of float, optional
        First and last node, degC; may be wider than what was seen. Default: the span seen, to 18 or 75 at an end that is 3 degC
        from these or less.
    step_c : float
        From node to node, K.
    lag_s : float, optional
        Lag of the thermometer, s; None estimates it from ramps, 0 leaves it in.
    tables : str
        Which of scale and dynamic tables: auto selects, or none, scale, dynamic, scale + dynamic.
    temperature : TemperatureSettings
        How temperatures are checked and smoothed.
    observe : ObserveSettings
        How sessions are cut into rests and turns.
    static : StaticSettings
        How offset over temperature is fitted.
    """

    range_c: tuple[float, float] | None = None
    step_c: float = STEP_C
    lag_s: float | None = None
    tables: TableChoice = "auto"
    temperature: TemperatureSettings = field(default_factory=TemperatureSettings)
    observe: ObserveSettings = field(default_factory=ObserveSettings)
    static: StaticSettings = field(default_factory=StaticSettings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftFit(Shown):
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
        What the static tables were fitted to.
    steps : RateSteps
        What the others were fitted to; may have no rows.
    temperatures : tuple of Temperature
        Of each recording, session after session.
    gyro_summary, accel_summary : TriadSummary or None
        Offsets over temperature in SI units, as they are shown.
    scale_summary : ScaleSummary or None
        Scale factors over temperature, whether a table of them was taken or not.
    verdict : Verdict
        Of the thermal fit alone; that of ``calibration`` has what was known before, too.
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
    gyro_summary: checks.TriadSummary | None
    accel_summary: checks.TriadSummary | None
    scale_summary: checks.ScaleSummary | None
    verdict: Verdict


@determined("drift")
def fit_drift(
    sessions: Sequence[Session],
    calibration: Calibration | None = None,
    *,
    settings: DriftSettings = DriftSettings(),
    progress: Progress | None = None,
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
    progress : callable, optional
        Called with what is done next and the share of the work that is done, 0 to 1.

    Returns
    -------
    DriftFit
        The calibration with its tables, and what they were fitted to.

    Raises
    ------
    InputError
        No session, another device than the calibration's, data given twice, temperature missing or on another scale, units that
        do not agree.
    NotObservable
        A temperature that is constant or spans too little; no rests; counts without a calibration; a table that was asked for
        and that the sessions do not show.
    Implausible
        Turns about other axes than the calibration's or the other way round; sessions further apart than one device's.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> heating = undrift.simulate_thermal_session("ramp", device, rng=rng)
    >>> fit = undrift.fit_drift([heating], calibration)
    >>> table = fit.calibration.drift.static
    >>> float(table.temp_c[0]), float(table.temp_c[-1])
    (17.5, 75.0)
    """
    report = progress or (lambda what, share: None)
    sessions = _checked(sessions, calibration, settings)
    device = nominal_models(sessions) if calibration is None else calibration
    device = replace(device, verdict=checks.verdict_before(device))
    sessions = [in_units_of(session, device) for session in sessions]
    static_settings = replace(settings.static, accel_unit=accel_unit_of(sessions, device))
    report("smoothing the temperature", 0.0)
    trusted = [
        [trusted_temperature(s, k, settings=settings.temperature) for k in range(len(s.records))] for s in sessions
    ]
    together = tuple(temperature for of_session in trusted for temperature in of_session)
    check_span(together, settings=settings.temperature)
    report("gathering rests and turns", 0.15)
    lag, lags_s, rests, course = _without_lag(sessions, trusted, settings)
    static_settings = replace(static_settings, lag_doubt_s=_lag_doubt(lag, lags_s[0]))
    check_at_rest(rests, device)
    device, g_estimated = with_g_sensitivity(rests, device)
    steps = observe_steps(sessions, temperatures=course, settings=settings.observe)
    report("fitting offsets over temperature", 0.4)
    seen = np.concatenate([rests.temp_c, steps.temp_c, *met_in_use(sessions, trusted, course, *lags_s)])
    nodes = table_nodes(seen, settings)
    wider = widened(nodes, _whole_range(seen, settings.step_c))  # the verdict does not depend on the range asked for
    wide = fit_static(rests, nodes=wider, calibration=device, settings=static_settings)
    checks.check_sessions(wide, device)
    agrees = checks.check_turns(steps, device, wide).also(checks.offsets_verdict(wide, device))
    report("cross-validating scale and dynamic tables", 0.5)
    choice, of_choice = _chosen(steps, device, wide, rests, settings)
    static, choice = cropped_static(wide, nodes), choice and cropped_choice(choice, nodes)
    report("fitting accelerometers over temperature", 0.95)
    accel = _accelerometers(rests, device, nodes)
    gyro = checks.summarise_gyro(static, device)
    of_offsets = checks.with_set_points(checks.static_verdict(static, accel), wide, rests, device)
    of_sweep = checks.single_sweep_verdict(gyro, rests, together, warm_up_fitted=static.table.warm_up is not None)
    of_accel = checks.poses_verdict(accel, device).also(checks.without_figures(accel.verdict) if accel else Verdict())
    of_sweep = of_sweep.also(checks.set_point_verdict(sessions))
    verdict = agrees.also(checks.temperature_verdict(together)).also(of_choice).also(of_offsets).also(g_estimated)
    verdict = verdict.also(of_sweep).also(of_accel).also(checks.lag_verdict(lag, lags_s[0]))
    return DriftFit(
        calibration=_calibrated(device, _tables(static, choice, accel, lags_s), verdict, sessions, settings, choice),
        static=static,
        choice=choice,
        accel=accel,
        asymmetry=scale_asymmetry(steps, device, static=wide.table) if len(steps) and device.gyro else None,
        lag=lag,
        rests=rests,
        steps=steps,
        temperatures=together,
        gyro_summary=gyro,
        accel_summary=checks.summarise_accel(static, accel, device, static_settings.accel_unit),
        scale_summary=None if choice is None or choice.scale is None else checks.summarise_scale(choice.scale, device),
        verdict=verdict if calibration is not None else device.verdict.also(verdict),
    )


def _checked(sessions: Sequence[Session], calibration: Calibration | None, settings: DriftSettings) -> list[Session]:
    """Return sessions of one device, each in one unit."""
    if not sessions:
        raise InputError("drift: wanted a session or more, got none; name its folder")
    own = "" if calibration is None else calibration.device
    named = [name for name in dict.fromkeys((*(s.serial or s.records[0].device for s in sessions), own)) if name]
    if len(named) > 1:
        raise InputError(f"drift: wanted sessions and calibration of one device, got {', '.join(named)}; sort them")
    if settings.lag_s is not None and not 0.0 <= settings.lag_s < np.inf:
        raise InputError(f"drift: wanted a lag of 0 s or more, got {settings.lag_s:g}; state the thermometer's")
    check_once(sessions)
    return [in_one_unit(session) for session in sessions]


def _lag_doubt(lag: LagFit | None, subtracted_s: float) -> float:
    """Return the standard uncertainty of the lag that is left in temperatures, s; 0 where none was estimated.

    What was found and not subtracted is all of it. Loops of another shape than two straight branches mislead the fit of the lag.
    """
    if lag is None:
        return 0.0
    left, own = 0.0 if subtracted_s else lag.lag_s, lag.uncertainty_s if np.isfinite(lag.uncertainty_s) else 0.0
    return math.hypot(left, own, _LAG_BY_LOOPS_S)


def _without_lag(
    sessions: Sequence[Session], trusted: list[list[Temperature]], settings: DriftSettings
) -> tuple[LagFit | None, tuple[float, float], RestBlocks, list[list[FloatArray]]]:
    """Estimate the lag from the rests, and gather them anew without it; lag and the smoothing that it needs in use, s."""

    def rests_at(course: list[list[FloatArray]]) -> RestBlocks:
        return since_power_on(observe_rests(sessions, temperatures=course, settings=settings.observe), sessions)

    course = [[temperature.temp_c for temperature in of_session] for of_session in trusted]
    rests, lag, lag_s = rests_at(course), None, settings.lag_s or 0.0
    pairs = [
        (t, r)
        for own, session in zip(trusted, sessions, strict=True)
        for t, r in zip(own, session.records, strict=True)
    ]
    if settings.lag_s is None and any(temperature.source == "column" for temperature, _ in pairs):
        lag = estimate_lag(rests)
        # One speed alone does not tell lag from hysteresis: then it is reported and left in.
        if lag.observable and lag.lag_s > _SURE_LAG * lag.uncertainty_s:
            lag_s = lag.lag_s
    if lag_s == 0.0:
        return lag, (0.0, 0.0), rests, course
    course = [sensor_course(own, session, lag_s) for own, session in zip(trusted, sessions, strict=True)]
    smooth_s = max(  # for the noisiest of the columns
        default_smooth_s(lag_s, noise_c=t.noise_c, interval_s=float(np.median(np.diff(record.time))), step_c=t.step_c)
        for t, record in pairs
    )
    return lag, (lag_s, smooth_s), rests_at(course), course


def table_nodes(seen_c: FloatArray, settings: DriftSettings) -> FloatArray:
    """Return the temperatures of the tables, (n,), degC; seen_c (k,)."""
    step = settings.step_c
    low, high = settings.range_c or _whole_range(seen_c, step)
    count = (high - low) / step if step > 0.0 else 0.0
    if count < 1.0 or abs(count - round(count)) > 1e-6:
        raise InputError(
            f"drift tables: wanted a range that the step divides, got {low:g} to {high:g} degC by {step:g}; "
            "for example 18 to 75 by 0.5"
        )
    return np.linspace(low, high, round(count) + 1)


def _whole_range(seen_c: FloatArray, step: float) -> tuple[float, float]:
    """Return the range where none was asked for: what was seen, and the note's ends where they are near."""
    least, greatest = float(np.nanmin(seen_c)), float(np.nanmax(seen_c))
    outward = (float(np.floor(least / step) * step), float(np.ceil(greatest / step) * step))
    low, high = (
        end if 0.0 < sign * (end - seen) <= BEYOND_SEEN_C else seen
        for end, seen, sign in zip(RANGE_C, outward, (-1, 1), strict=True)
    )
    return low, high


def _chosen(
    steps: RateSteps, device: Calibration, static: StaticFit, rests: RestBlocks, settings: DriftSettings
) -> tuple[Choice | None, Verdict]:
    """Return the choice of tables, what they are worth, or why there is none."""
    if device.gyro is None or static.table.gyro_offset is None:
        why = finding("drift.no_gyroscopes", "warn")
    elif not len(steps):
        why = finding("drift.no_turns", "warn")
    else:
        try:
            choice = choose_tables(steps, device, static=static.table, temp_c=static.table.temp_c, rests=rests)
            choice = choice if settings.tables == "auto" else _requested(choice, settings.tables)
            return choice, checks.without_figures(choice.verdict)
        except NotObservable as error:
            why = finding("drift.tables_not_observable", "warn", problem=str(error))
    if settings.tables not in ("auto", "none"):
        raise NotObservable(f"tables: wanted {settings.tables}, got sessions that do not show them: {why.text}")
    return None, Verdict.of(why) if settings.tables == "auto" else Verdict()


def _requested(choice: Choice, tables: Alternative) -> Choice:
    """Return the choice with the tables that were asked for, whatever cross-validation says."""
    scale, dynamic = choice.taken(tables)
    if ("scale" in tables and scale is None) or ("dynamic" in tables and dynamic is None):
        raise NotObservable(
            f"{tables} cannot be fitted to these steps; turn about each axis at three rates at each soak"
        )
    why = finding("drift.tables_requested", "info", tables=tables, automatic=choice.alternatives.chosen)
    if np.isnan(choice.alternatives.left_out_rms_dps).all():
        points = choice.alternatives.why.values["set_points"]
        why = finding("drift.tables_requested_unjudged", "warn", tables=tables, set_points=points)
    asked = replace(choice.alternatives, chosen=tables, why=why)
    return replace(choice, alternatives=asked, verdict=choice.verdict_of(tables, why))


def _accelerometers(rests: RestBlocks, device: Calibration, nodes: FloatArray) -> AccelDriftFit | None:
    """Return the accelerometers' fit to poses; None where the poses do not show it."""
    if device.accel is None or len(np.unique(rests.pose)) < 2 or np.isnan(rests.accel).all():
        return None
    try:
        return fit_accel_drift(rests, device, temp_c=nodes)
    except NotObservable:
        return None


def _tables(
    static: StaticFit, choice: Choice | None, accel: AccelDriftFit | None, lags_s: tuple[float, float]
) -> DriftTables:
    scale, dynamic = (None, None) if choice is None else (choice.scale_drift, choice.dynamic_drift)
    tables = DriftTables(static=static.table, scale=scale, dynamic=dynamic, lag_s=lags_s[0], lag_smooth_s=lags_s[1])
    return tables if accel is None else with_accel(tables, accel)


def _calibrated(
    device: Calibration,
    tables: DriftTables,
    verdict: Verdict,
    sessions: Sequence[Session],
    settings: DriftSettings,
    choice: Choice | None,
) -> Calibration:
    """Return a calibration with tuning tables; files and settings of an earlier thermal fit go with its tables."""
    held = device.provenance
    before = held.inputs[: held.count(_INPUTS, len(held.inputs))]
    chosen = "none" if choice is None else choice.alternatives.chosen
    provenance = Provenance(
        inputs=tuple(dict.fromkeys((*before, *(entry for session in sessions for entry in session.inputs)))),
        settings=(
            *(entry for entry in held.settings if not entry[0].startswith("drift_")),
            ("drift_spline", "not-a-knot" if settings.static.not_a_knot else "smoothing"),
            ("drift_lag_s", f"{tables.lag_s:.4g}"),
            ("drift_tables", "static" if chosen == "none" else f"static, {chosen}"),
            ("drift_sessions", f"{len(sessions)}"),
            (_INPUTS, f"{len(before)}"),
            (checks.STATUS_BEFORE, device.verdict.status),
        ),
        versions=held.versions or versions_used(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    return replace(
        device,
        reference_temp_c=_reference_of(device, tables),
        drift=tables,
        verdict=device.verdict.also(verdict),
        provenance=provenance,
    )


def _reference_of(device: Calibration, tables: DriftTables) -> float:
    """Return the reference temperature: the device's own, or where none is known the one seen that is nearest to a room's, degC."""
    static = tables.static
    if np.isfinite(device.reference_temp_c) or static is None:
        return device.reference_temp_c
    return float(np.clip(ROOM_C, *seen_span(static.temp_c, static.gyro_extrapolated)))
