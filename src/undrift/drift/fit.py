"""From thermal sessions and a calibration to tuning tables, the note's Figure 2.

    temperature     checked, smoothed; its lag estimated from ramps and subtracted
    static drift    offset(T) from rests, absolute, raw unit                       blocks 2 to 5
    matrix          M(T) from rate steps at two soaks or more
    dynamic drift   e(w, T) of what is left                                        blocks 6 to 9
    accelerometers  offset(T) and M(T) from poses at several temperatures, else offset(T) from rests

Codes that the calibration knows to be truncated get their half step back first, as in ``correct``, so that a table is over the same
numbers that it is subtracted from. What was not observable is a finding of the verdict, with the recording that would show it.

Which tables a device needs: none, scale over temperature, dynamic drift, or both. Each of the four is fitted without a soak (those
between the first and the last) and without some of the rates, and predicts the steps that were held out:
``M(T) (u - offset(T)) - e`` less the imposed rate, all three axes, about the offset of their mounting; with one rate one way round,
about the rest of the same soak (drift/rate_steps.py). The one with the least mean square is best; the simplest whose mean square
lies within one standard error of it is taken [1]_; so is one whose rms is within 5 %, which no table is worth. Where nothing can be
held out the matrix that was fitted is kept.

Tables are cut to the temperatures asked for only after they were fitted and selected over all that was seen: a table holds its ends
beyond them, and the selection would depend on the range. They are linear between nodes, so that cutting changes no value inside.

References
----------
.. [1] L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and Regression Trees", 1984, section 3.4.3.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.base.summary import Shown
from undrift.calibration.session import ROOM_C, in_one_unit
from undrift.drift import checks, observe, rate_steps
from undrift.drift import temperature as thermometer
from undrift.drift.accel import AccelDriftFit, fit_accel_drift
from undrift.drift.observe import ObserveSettings, RateSteps, RestBlocks
from undrift.drift.offset import StaticFit, StaticSettings, TriadDrift, far_from_data, felt_by_gyro, fit_static
from undrift.drift.rate_steps import DynamicFit, ScaleFit, Steps
from undrift.drift.temperature import LagFit, Temperature, TemperatureSettings
from undrift.errors import CalibrationError, InputError, NotObservable, check_choices
from undrift.findings import Finding, finding
from undrift.fit.least_squares import determined
from undrift.model import (
    BEYOND_SEEN_C,
    Calibration,
    DriftTables,
    DynamicDrift,
    Provenance,
    ScaleDrift,
    StaticDrift,
    Verdict,
    seen_span,
    versions_used,
)
from undrift.record import Session
from undrift.units import RADIAN_PER_DEGREE

RANGE_C = (18.0, 75.0)  # the note's
STEP_C = 0.5
_SURE_LAG = 3.0  # standard uncertainties: a lag below is left in
_INPUTS = "drift_inputs_before"  # setting: how many inputs the calibration had before a thermal fit

Alternative = Literal["none", "scale", "dynamic", "scale + dynamic"]
ALTERNATIVES: tuple[Alternative, ...] = ("none", "scale", "dynamic", "scale + dynamic")  # simplest first
T = TypeVar("T", StaticDrift, ScaleDrift, DynamicDrift, TriadDrift)
# Fields of one row a node
_BY_NODE = ("temp_c", "offset", "matrix", "error", "uncertainty", "extrapolated", "unknown_scale")
_RATE_FOLDS = 4
_SAME_C = 1.0  # between soaks, in the order of their temperature: further apart is another set-point
_WORTH = 1.05  # a table more has to reduce the rms by this factor at least

TableChoice = Literal["auto"] | Alternative
Progress = Callable[[str, float], None]  # what is done next, and which share of the work is done


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alternatives:
    """Cross-validated error of each choice of tables, and which was taken."""

    name: tuple[Alternative, ...]
    fitted_rms_dps: FloatArray  # (4,), residual of the fit to all steps, deg/s; NaN where it could not be fitted
    soak_rms_dps: FloatArray  # (4,), of the soaks that were held out; NaN with fewer than three set-points
    rate_rms_dps: FloatArray  # (4,), of the rates that were held out; NaN with fewer than three rates
    left_out_rms_dps: FloatArray  # (4,), of both together: the choice is made by it; NaN where none could be
    standard_error_dps: FloatArray  # (4,), standard error of ``left_out_rms_dps``
    chosen: Alternative
    why: Finding

    @property
    def reason(self) -> str:
        """Why, as a text."""
        return self.why.text


class Fits(NamedTuple):
    """What alternatives predict rates by, fitted to one set of steps; None where not observable."""

    scale: ScaleDrift | None
    dynamic: DynamicFit | None  # with the constant matrix
    both: DynamicFit | None  # on top of ``scale``


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """The fits of all alternatives, whether taken or not, None where not observable; and which were taken."""

    scale: ScaleFit | None
    dynamic: DynamicFit | None  # with the constant matrix
    both: DynamicFit | None  # on top of ``scale``
    alternatives: Alternatives
    verdict: Verdict  # of what was taken
    missing: tuple[Finding, ...] = ()  # reasons why fits are missing

    def taken(self, which: Alternative) -> tuple[ScaleFit | None, DynamicFit | None]:
        """Return the fits that an alternative takes."""
        dynamic = {"dynamic": self.dynamic, "scale + dynamic": self.both}.get(which)
        return self.scale if "scale" in which else None, dynamic

    def verdict_of(self, which: Alternative, why: Finding) -> Verdict:
        """Return why an alternative was taken, and what its fits are worth."""
        verdict = Verdict.of(why, *self.missing)
        for fit in self.taken(which):
            verdict = verdict if fit is None else verdict.also(fit.verdict)
        return verdict

    @property
    def scale_drift(self) -> ScaleDrift | None:
        """The matrix table to use."""
        scale = self.taken(self.alternatives.chosen)[0]
        return None if scale is None else scale.drift

    @property
    def dynamic_drift(self) -> DynamicDrift | None:
        """The dynamic table to use."""
        dynamic = self.taken(self.alternatives.chosen)[1]
        return None if dynamic is None else dynamic.drift


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

    def __post_init__(self) -> None:
        check_choices(self, "drift")


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
    device = observe.nominal_models(sessions) if calibration is None else calibration
    device = replace(device, verdict=checks.verdict_before(device))
    sessions, of_rests = observe.with_rests([observe.in_units_of(session, device) for session in sessions])
    static_settings = replace(settings.static, accel_unit=observe.accel_unit_of(sessions, device))
    report("smoothing the temperature", 0.0)
    checked = partial(thermometer.trusted_temperature, settings=settings.temperature)
    trusted = [[checked(s, k) for k in range(len(s.records))] for s in sessions]
    together = tuple(temperature for of_session in trusted for temperature in of_session)
    thermometer.check_span(together, settings=settings.temperature)
    report("gathering rests and turns", 0.15)
    lag, lags_s, rests, course = _without_lag(sessions, trusted, settings)
    observe.check_at_rest(rests, device)
    steps = observe.observe_steps(sessions, temperatures=course, settings=settings.observe)
    report("fitting offsets over temperature", 0.4)
    seen = np.concatenate([rests.temp_c, steps.temp_c, *thermometer.met_in_use(sessions, trusted, course, *lags_s)])
    nodes = table_nodes(seen, settings)
    wider = widened(nodes, _whole_range(seen, settings.step_c))  # the verdict does not depend on the range asked for
    wide = fit_static(rests, nodes=wider, calibration=device, settings=static_settings)
    checks.check_sessions(wide, device)
    felt = felt_by_gyro(rests, device).mean(axis=0)
    agrees = checks.check_turns(steps, device, wide).also(checks.offsets_verdict(wide, device, felt))
    report("cross-validating scale and dynamic tables", 0.5)
    choice, of_choice = _chosen(steps, device, wide, rests, settings)
    static, choice = cropped_static(wide, nodes), choice and cropped_choice(choice, nodes)
    report("fitting accelerometers over temperature", 0.95)
    accel, of_poses = _accelerometers(rests, device, nodes)
    gyro = checks.summarise_gyro(static, device)
    of_offsets = checks.with_set_points(checks.static_verdict(static, accel), wide, rests, device)
    of_sweep = checks.single_sweep_verdict(gyro, rests, together, warm_up_fitted=static.table.warm_up is not None)
    of_accel = checks.poses_verdict(accel, device).also(accel.verdict if accel else Verdict())
    of_sweep = of_sweep.also(checks.set_point_verdict(sessions))
    verdict = (
        agrees.also(checks.temperature_verdict(together)).also(of_choice).also(of_offsets).also(of_rests).also(of_poses)
    )
    verdict = verdict.also(of_sweep).also(of_accel).also(checks.lag_verdict(lag, lags_s[0]))
    return DriftFit(
        calibration=_calibrated(device, _tables(static, choice, accel, lags_s), verdict, sessions, settings, choice),
        static=static,
        choice=choice,
        accel=accel,
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
    observe.check_once(sessions)
    return [in_one_unit(session) for session in sessions]


def _without_lag(
    sessions: Sequence[Session], trusted: list[list[Temperature]], settings: DriftSettings
) -> tuple[LagFit | None, tuple[float, float], RestBlocks, list[list[FloatArray]]]:
    """Estimate the lag from the rests, and gather them anew without it; lag and the smoothing that it needs in use, s."""

    def rests_at(course: list[list[FloatArray]]) -> RestBlocks:
        return observe.since_power_on(
            observe.observe_rests(sessions, temperatures=course, settings=settings.observe), sessions
        )

    course = [[temperature.temp_c for temperature in of_session] for of_session in trusted]
    rests, lag, lag_s = rests_at(course), None, settings.lag_s or 0.0
    pairs = [
        (t, r)
        for own, session in zip(trusted, sessions, strict=True)
        for t, r in zip(own, session.records, strict=True)
    ]
    if settings.lag_s is None and any(temperature.source == "column" for temperature, _ in pairs):
        lag = thermometer.estimate_lag(rests)
        # One speed alone does not tell lag from hysteresis: then it is reported and left in.
        if lag.observable and lag.lag_s > _SURE_LAG * lag.uncertainty_s:
            lag_s = lag.lag_s
    if lag_s == 0.0:
        return lag, (0.0, 0.0), rests, course
    course = [thermometer.sensor_course(own, session, lag_s) for own, session in zip(trusted, sessions, strict=True)]
    smooth_s = max(  # for the noisiest of the columns
        thermometer.default_smooth_s(
            lag_s, noise_c=t.noise_c, interval_s=float(np.median(np.diff(record.time))), step_c=t.step_c
        )
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
    if device.gyro is None or static.table.gyro_offset is None:  # a device of accelerometers alone
        if settings.tables not in ("auto", "none"):
            raise NotObservable(
                f"tables: {settings.tables} needs gyroscopes, and the calibration or the sessions have none."
            )
        return None, Verdict()
    if not len(steps):
        why = finding("drift.no_turns", "warn")
    else:
        try:
            choice = choose_tables(steps, device, static=static.table, temp_c=static.table.temp_c, rests=rests)
            choice = choice if settings.tables == "auto" else _requested(choice, settings.tables)
            return choice, choice.verdict
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
            + "".join(f"; {item.text}" for item in choice.missing)
        )
    why = finding("drift.tables_requested", "info", tables=tables, automatic=choice.alternatives.chosen)
    if np.isnan(choice.alternatives.left_out_rms_dps).all():
        points = choice.alternatives.why.values["set_points"]
        why = finding("drift.tables_requested_unjudged", "warn", tables=tables, set_points=points)
    asked = replace(choice.alternatives, chosen=tables, why=why)
    return replace(choice, alternatives=asked, verdict=choice.verdict_of(tables, why))


def _accelerometers(rests: RestBlocks, device: Calibration, nodes: FloatArray) -> tuple[AccelDriftFit | None, Verdict]:
    """Return the accelerometers' fit to poses; None if the poses do not determine it, with the reason."""
    if device.accel is None or len(np.unique(rests.pose)) < 2 or np.isnan(rests.accel).all():
        return None, Verdict()
    try:
        return fit_accel_drift(rests, device, temp_c=nodes), Verdict()
    except NotObservable as error:
        return None, Verdict.of(finding("drift.accel_poses_not_observable", "info", problem=str(error)))


def _tables(
    static: StaticFit, choice: Choice | None, accel: AccelDriftFit | None, lags_s: tuple[float, float]
) -> DriftTables:
    scale, dynamic = (None, None) if choice is None else (choice.scale_drift, choice.dynamic_drift)
    offsets = static.table
    if accel is not None:
        offsets = replace(
            offsets,
            accel_offset=accel.offset,
            accel_uncertainty=accel.offset_uncertainty,
            accel_extrapolated=accel.extrapolated,
            accel_visit=None,
        )
        scale = replace(
            scale or ScaleDrift(temp_c=accel.temp_c),
            accel_matrix=accel.matrix,
            accel_uncertainty=accel.matrix_uncertainty,
            accel_extrapolated=accel.extrapolated,
        )
    return DriftTables(static=offsets, scale=scale, dynamic=dynamic, lag_s=lags_s[0], lag_smooth_s=lags_s[1])


def _calibrated(
    device: Calibration,
    tables: DriftTables,
    verdict: Verdict,
    sessions: Sequence[Session],
    settings: DriftSettings,
    choice: Choice | None,
) -> Calibration:
    """Return a calibration with tuning tables; files and settings of an earlier thermal fit go with its tables."""
    previous = device.provenance
    before = previous.inputs[: previous.count(_INPUTS, len(previous.inputs))]
    chosen = "none" if choice is None else choice.alternatives.chosen
    provenance = Provenance(
        inputs=tuple(dict.fromkeys((*before, *(entry for session in sessions for entry in session.inputs)))),
        settings=(
            *(entry for entry in previous.settings if not entry[0].startswith("drift_")),
            ("drift_spline", "not-a-knot" if settings.static.not_a_knot else "smoothing"),
            ("drift_lag_s", f"{tables.lag_s:.4g}"),
            ("drift_tables", "static" if chosen == "none" else f"static, {chosen}"),
            ("drift_sessions", f"{len(sessions)}"),
            (_INPUTS, f"{len(before)}"),
            (checks.STATUS_BEFORE, device.verdict.status),
        ),
        versions=previous.versions or versions_used(),
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


# ---- selection of tables, by cross-validation


def choose_tables(
    steps: RateSteps,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    temp_c: FloatArray,
    rests: RestBlocks | None = None,
) -> Choice:
    """Fit all alternatives, select one by cross-validation; nodes temp_c (n,), degC."""
    low, high = float(temp_c[0]), float(temp_c[-1])  # the dynamic table's: multiples of 5 degC inside, and the ends
    between = rate_steps.DEFAULT_STEP_C * np.arange(
        np.ceil(low / rate_steps.DEFAULT_STEP_C), np.floor(high / rate_steps.DEFAULT_STEP_C) + 1.0
    )
    nodes = np.concatenate(([low], between[(between > low + 1e-9) & (between < high - 1e-9)], [high]))
    clean = rate_steps.with_rest_as_zero(rate_steps.steps_of(steps), rests, calibration, static)
    numbers, point = _set_points(clean)
    if len(numbers) < 2:
        raise NotObservable(
            f"scale and dynamic drift: wanted rate steps at two soaks or more, got one at {clean.temp_c.mean():.1f} degC; "
            "repeat the steps at another temperature, or keep the constant matrix",
            soaks=len(numbers),
        )

    scale = dynamic = both = None
    missing = list[Finding]()
    bent = partial(rate_steps.fit_dynamic, clean, calibration, static=static, rests=rests, temp_c=nodes)
    try:  # the others may be observable
        scale = rate_steps.fit_scale(clean, calibration, static=static, temp_c=temp_c)
    except CalibrationError as error:
        missing.append(finding("drift.scale_not_fitted", "info", problem=str(error)))
    try:
        dynamic = bent(scale=None)
        both = None if scale is None else bent(scale=scale.drift)
    except CalibrationError as error:
        missing.append(finding("drift.dynamic_not_fitted", "info", problem=str(error)))
    if scale is None and dynamic is None:
        raise NotObservable(
            f"scale and dynamic drift: wanted an axis turned at two rates at two soaks, got {len(clean)} steps at {len(numbers)} "
            "soaks without; repeat the same turns at another temperature"
            + "".join(f"; {item.text}" for item in missing),
            soaks=len(numbers),
        )
    every = Fits(None if scale is None else scale.drift, dynamic, both)

    def refitted(rows: Steps) -> Fits:
        """Fit every alternative to some steps, as soft as to all; what the matrices are worth is not asked."""
        matrix = plain = combined = None
        like = partial(rate_steps.fit_dynamic, rows, calibration, static=static, rests=rests, temp_c=nodes)
        with suppress(CalibrationError):
            matrix = rate_steps.scale_matrices(rows, calibration, static=static, temp_c=temp_c)
        with suppress(CalibrationError):
            plain = like(scale=None, like=every.dynamic)
            combined = None if matrix is None else like(scale=matrix, like=every.both)
        return Fits(matrix, plain, combined)

    table = _cross_validated(
        clean, every, refitted, lambda of, which: _residuals(clean, of, which, calibration, static=static)
    )
    choice = Choice(
        scale=scale, dynamic=dynamic, both=both, alternatives=table, verdict=clean.verdict, missing=tuple(missing)
    )
    verdict, points = choice.verdict_of(table.chosen, table.why), int(point.max()) + 1
    if points < 3 and table.why.code != "drift.tables_unjudged":
        verdict = verdict.also(Verdict.of(finding("drift.tables_by_rates", "warn", set_points=points)))
    return replace(choice, verdict=verdict.also(clean.verdict))


def _residuals(
    steps: Steps, fits: Fits, which: Alternative, calibration: Calibration, *, static: StaticDrift | None
) -> FloatArray:
    """What an alternative leaves of all steps, rad/s, shape (n, 3); NaN where it has no fit."""
    matrix = fits.scale if "scale" in which else None
    dynamic = {"dynamic": fits.dynamic, "scale + dynamic": fits.both}.get(which)
    if ("scale" in which and matrix is None) or ("dynamic" in which and dynamic is None):
        return np.full((len(steps), 3), np.nan)
    w = rate_steps.measured_rate(steps.gyro, steps.temp_c, calibration, static=static, scale=matrix)
    for axis, surface in enumerate(dynamic.surfaces if dynamic else ()):
        if surface is not None:
            w[:, axis] -= surface.at(w[:, axis], steps.temp_c)
    return np.asarray(w - steps.rate_b)


def _cross_validated(
    steps: Steps, fits: Fits, refitted: Callable[[Steps], Fits], residuals: Callable[[Fits, Alternative], FloatArray]
) -> Alternatives:
    by_soak, by_rate, everything = _soak_folds(steps), _rate_folds(steps), np.ones(len(steps), bool)
    own_zero = np.where(rate_steps.of_one_rate(steps), -1, steps.mounting)

    def squares(fold: BoolArray, of: Fits, *, whole: bool) -> list[float]:
        return [_mean_square(residuals(of, which), own_zero, fold, whole=whole) for which in ALTERNATIVES]

    in_fit = np.array(squares(everything, fits, whole=True))
    soak, rate = (
        np.array([squares(fold, refitted(steps.taken(~fold)), whole=whole) for fold in folds]).reshape(-1, 4)
        for folds, whole in ((by_soak, True), (by_rate, False))
    )
    every = np.concatenate((soak, rate))
    square = np.where(np.isnan(in_fit), np.nan, every.mean(axis=0) if len(every) else in_fit)
    error = every.std(axis=0, ddof=1) / np.sqrt(len(every)) if len(every) > 1 else np.zeros(len(ALTERNATIVES))
    rms, nothing = np.sqrt(square), np.full((1, len(ALTERNATIVES)), np.nan)
    why = _selected(square, error, steps, (len(by_soak), len(by_rate))) if len(every) else _unjudged(square, steps)
    return Alternatives(
        name=ALTERNATIVES,
        fitted_rms_dps=np.sqrt(in_fit) / RADIAN_PER_DEGREE,
        soak_rms_dps=np.sqrt((soak if len(soak) else nothing).mean(axis=0)) / RADIAN_PER_DEGREE,
        rate_rms_dps=np.sqrt((rate if len(rate) else nothing).mean(axis=0)) / RADIAN_PER_DEGREE,
        left_out_rms_dps=rms / RADIAN_PER_DEGREE if len(every) else nothing[0],
        standard_error_dps=0.5 * error / np.where(rms > 0.0, rms, np.inf) / RADIAN_PER_DEGREE,
        chosen=why.values["tables"],  # type: ignore[arg-type]
        why=why,
    )


def _selected(square: FloatArray, error: FloatArray, steps: Steps, held_out: tuple[int, int]) -> Finding:
    """Take the simplest within one standard error, or 5 % of rms, of the best; held_out counts folds by soak and by rate."""
    best = int(np.nanargmin(square))
    chosen = int(np.flatnonzero(square <= max(square[best] + error[best], square[best] * _WORTH**2))[0])
    dps = np.sqrt(square) / RADIAN_PER_DEGREE
    numbers, point = _set_points(steps)
    of_soaks = f"{held_out[0]} of {len(numbers)} soaks at {int(point.max()) + 1} set-points"
    values = {
        "tables": ALTERNATIVES[chosen],
        "error_dps": dps[chosen],
        "held": "rates" if not held_out[0] else f"{of_soaks}, and rates," if held_out[1] else of_soaks,
        "held_out": held_out[0],
        "soaks": len(numbers),
        "set_points": int(point.max()) + 1,
    }
    if chosen == best:
        return finding("drift.tables_best", "info", **values)
    return finding("drift.tables_simplest", "info", **values, best=ALTERNATIVES[best], best_dps=dps[best])


def _unjudged(square: FloatArray, steps: Steps) -> Finding:
    """Keep the matrix that was fitted: neither soaks nor rates can be held out."""
    chosen = 1 if np.isfinite(square[1]) else int(np.nanargmin(square))
    points = int(_set_points(steps)[1].max()) + 1
    left = np.sqrt(square[[chosen, 0]]) / RADIAN_PER_DEGREE
    values = {"tables": ALTERNATIVES[chosen], "set_points": points, "error_dps": left[0], "constant_dps": left[1]}
    return finding("drift.tables_unjudged", "warn", **values)


def _soak_folds(steps: Steps) -> list[BoolArray]:
    """Return the rows of each soak but those at the coldest and hottest set-point: nothing predicts beyond them."""
    numbers, point = _set_points(steps)
    return [steps.soak == s for s in numbers[(point > 0) & (point < point.max())]]


def _set_points(steps: Steps) -> tuple[IntArray, IntArray]:
    """Return the soaks and which set-point each was at, from the coldest: soaks of one may be many, of each axis or each way."""
    numbers = np.unique(steps.soak)
    middle = np.array([steps.temp_c[steps.soak == s].mean() for s in numbers])
    order = np.argsort(middle, kind="stable")
    point = np.zeros(len(numbers), np.int64)
    point[order[1:]] = np.cumsum(np.diff(middle[order]) > _SAME_C)
    return numbers, point


def _rate_folds(steps: Steps) -> list[BoolArray]:
    """Return the rows of every fourth rate in turn, but for the greatest."""
    size = np.abs(steps.along)
    level = np.unique(np.round(size / (0.01 * size.max())), return_inverse=True)[1].reshape(-1)
    most = int(level.max())
    return [(level % _RATE_FOLDS == k) & (level < most) for k in range(min(_RATE_FOLDS, most))] if most > 1 else []


def _mean_square(residuals: FloatArray, mounting: IntArray, fold: BoolArray, *, whole: bool) -> float:
    """Return the mean square of the fold's residuals about its mountings' own offsets, (rad/s)^2; mounting -1: about zero."""
    about = fold if whole else ~fold
    left = residuals[fold].copy()
    for m in np.unique(mounting[fold & (mounting >= 0)]):
        inside = about & (mounting == m)
        if inside.any():
            left[mounting[fold] == m] -= residuals[inside].mean(axis=0)
    return float(np.mean(left**2))


# ---- tables cut to the temperatures asked for


def widened(nodes: FloatArray, span_c: tuple[float, float]) -> FloatArray:
    """Return nodes continued at the same step until they span a range, degC."""
    step = float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
    below = max(int(np.ceil((nodes[0] - span_c[0]) / step - 1e-9)), 0)
    above = max(int(np.ceil((span_c[1] - nodes[-1]) / step - 1e-9)), 0)
    return np.concatenate(
        (nodes[0] - step * np.arange(below, 0, -1), nodes, nodes[-1] + step * np.arange(1, above + 1))
    )


def cropped_static(fit: StaticFit, nodes: FloatArray) -> StaticFit:
    """Return the offsets at some of their nodes (n,), degC."""
    old = fit.table.temp_c
    gyro, accel = (found and _cropped(found, old, nodes) for found in (fit.gyro, fit.accel))
    kept = [item for item in fit.verdict.findings if item.code != "drift.nodes_extrapolated"]
    kept += [] if gyro is None else far_from_data("gyroscope", gyro)
    kept += [] if accel is None or accel.offset is None else far_from_data("accelerometer", accel)
    verdict = replace(fit.verdict, findings=tuple(kept))
    return StaticFit(table=_cropped(fit.table, old, nodes), gyro=gyro, accel=accel, verdict=verdict)


def cropped_choice(choice: Choice, nodes: FloatArray) -> Choice:
    """Return what was chosen with all its tables cut to nodes (n,), degC; those of the dynamic tables lie further apart."""
    scale = choice.scale
    if scale is not None:
        scale = replace(scale, drift=_cropped(scale.drift, scale.drift.temp_c, nodes))

    def cropped(fit: DynamicFit) -> DynamicFit:
        old, low, high = fit.drift.temp_c, nodes[0], nodes[-1]
        at = np.concatenate(([low], old[(old > low + 1e-9) & (old < high - 1e-9)], [high]))
        return replace(fit, drift=replace(_cropped(fit.drift, old, at), temp_c=at))

    dynamic, both = (fit and cropped(fit) for fit in (choice.dynamic, choice.both))
    return replace(choice, scale=scale, dynamic=dynamic, both=both)


def _cropped(table: T, old: FloatArray, at: FloatArray) -> T:
    """Return a table at temperatures within its own: linear between two nodes, marked where one of them is."""
    right = np.clip(np.searchsorted(old, at - 1e-9), 1, len(old) - 1)
    share = np.clip((at - old[right - 1]) / (old[right] - old[right - 1]), 0.0, 1.0)
    fields: dict[str, Any] = {}
    for name in table.__dataclass_fields__:
        values = getattr(table, name)
        if values is not None and name.removeprefix("gyro_").removeprefix("accel_") in _BY_NODE:
            w, left, over = share.reshape(-1, *[1] * (values.ndim - 1)), values[right - 1], values[right]
            made = np.where(w == 0.0, left, np.where(w == 1.0, over, (1.0 - w) * left + w * over))  # NaN times 0 is NaN
            fields[name] = made > 0.0 if values.dtype == bool else made
    return replace(table, **fields)
