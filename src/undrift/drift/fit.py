"""From thermal sessions and a calibration to tuning tables, the note's Figure 2.

    temperature     checked, smoothed; its lag estimated from ramps and subtracted
    static drift    offset(T) from rests, absolute, raw unit                       blocks 2 to 5
    matrix          M(T) from rate steps at two soaks or more
    dynamic drift   e(w, T) of what is left                                        blocks 6 to 9
    accelerometers  offset(T) and M(T) from poses at several temperatures, otherwise offset(T) from rests

If the calibration knows that codes are truncated, they get their half step back first, as in ``correct``. A finding of the verdict
names each part that is not observable, and the recording that would determine it.

A device may need none of the tables beside the offsets, scale over temperature, dynamic drift, or both. Each of the four is fitted
without a soak (those between the first and the last), and predicts the steps of that soak: ``M(T) (u - offset(T)) - e`` minus the
imposed rate, all three axes, about the offset of their mounting. The choice is the simplest whose mean square lies within one
standard error of the least [1]_, or whose rms is within 5 % of it. If no soak can be left out, the matrix is kept as fitted.

Tables are fitted and selected over all temperatures seen, and cut to the range asked for afterwards, so that the choice does not
depend on the range.

References
----------
.. [1] L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and Regression Trees", 1984, section 3.4.3.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.base.summary import Shown
from undrift.calibration.session import ROOM_C, in_one_unit
from undrift.drift import observe
from undrift.drift import temperature as thermometer
from undrift.drift import verdict as judge
from undrift.drift.accel import AccelDriftFit, fit_accel_drift
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.offset import StaticFit, StaticSettings, TriadDrift, felt_by_gyro, fit_static
from undrift.drift.rates import DynamicFit, ScaleFit, Steps, fit_dynamic, fit_scale, measured_rate, prepared
from undrift.drift.temperature import LagFit, Temperature
from undrift.errors import CalibrationError, InputError, NotObservable, check_choices
from undrift.findings import Finding, finding
from undrift.fit.gls import determined
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
SURE_LAG = 3.0  # standard uncertainties: a lag below is left in
SAME_C = 1.0  # between soaks, in the order of their temperature: further apart is another set-point
WORTH = 1.05  # an additional table has to reduce the rms by this factor at least
INPUTS_BEFORE = "drift_inputs_before"  # setting: how many inputs the calibration had before a thermal fit

Alternative = Literal["none", "scale", "dynamic", "scale + dynamic"]
ALTERNATIVES: tuple[Alternative, ...] = ("none", "scale", "dynamic", "scale + dynamic")  # simplest first
TableChoice = Literal["auto"] | Alternative
Progress = Callable[[str, float], None]  # next stage, and the share of the work that is done
T = TypeVar("T", StaticDrift, ScaleDrift, TriadDrift)


class Fits(NamedTuple):
    """The matrix and dynamic tables fitted to one set of steps; None if not observable."""

    scale: ScaleFit | None
    dynamic: DynamicFit | None  # with the constant matrix
    both: DynamicFit | None  # on top of ``scale``

    def taken(self, which: Alternative) -> tuple[ScaleFit | None, DynamicFit | None]:
        """Return the fits that an alternative takes."""
        dynamic = {"dynamic": self.dynamic, "scale + dynamic": self.both}.get(which)
        return self.scale if "scale" in which else None, dynamic

    def have(self, which: Alternative) -> bool:
        """Return True if the fits of an alternative are observable."""
        scale, dynamic = self.taken(which)
        return ("scale" not in which or scale is not None) and ("dynamic" not in which or dynamic is not None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alternatives:
    """Cross-validated error of each choice of tables, and which was taken."""

    name: tuple[Alternative, ...]
    fitted_rms_dps: FloatArray  # (4,), residual of the fit to all steps, deg/s; NaN if not observable
    left_out_rms_dps: FloatArray  # (4,), of the soaks that were left out; NaN with fewer than three set-points
    standard_error_dps: FloatArray  # (4,), standard error of ``left_out_rms_dps``
    chosen: Alternative
    why: Finding

    @property
    def reason(self) -> str:
        """Why, as a text."""
        return self.why.text


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """The fits of all alternatives, whether taken or not, and which were taken."""

    fits: Fits
    alternatives: Alternatives
    verdict: Verdict  # of the tables that were taken

    @property
    def scale(self) -> ScaleFit | None:
        """The fit of the matrix, whether taken or not."""
        return self.fits.scale

    @property
    def scale_drift(self) -> ScaleDrift | None:
        """The matrix table to use."""
        scale = self.fits.taken(self.alternatives.chosen)[0]
        return None if scale is None else scale.drift

    @property
    def dynamic_drift(self) -> DynamicDrift | None:
        """The dynamic table to use."""
        dynamic = self.fits.taken(self.alternatives.chosen)[1]
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
    static : StaticSettings
        How offset over temperature is fitted.
    """

    range_c: tuple[float, float] | None = None
    step_c: float = STEP_C
    lag_s: float | None = None
    tables: TableChoice = "auto"
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
        Of the thermometer; None if it was stated.
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
        Of the thermal fit only; that of ``calibration`` has what was known before, too.
    """

    calibration: Calibration
    static: StaticFit
    choice: Choice | None
    accel: AccelDriftFit | None
    lag: LagFit | None
    rests: RestBlocks
    steps: RateSteps
    temperatures: tuple[Temperature, ...]
    gyro_summary: judge.TriadSummary | None
    accel_summary: judge.TriadSummary | None
    scale_summary: judge.ScaleSummary | None
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
    device = replace(device, verdict=judge.verdict_before(device))
    sessions, no_rests = observe.with_rests([observe.in_units_of(session, device) for session in sessions])
    static_settings = replace(settings.static, accel_unit=observe.accel_unit_of(sessions, device))
    report("smoothing the temperature", 0.0)
    trusted = [[thermometer.trusted_temperature(s, k) for k in range(len(s.records))] for s in sessions]
    temperatures = tuple(temperature for of_session in trusted for temperature in of_session)
    thermometer.check_span(temperatures)
    report("gathering rests and turns", 0.15)
    lag, lag_s, smooth_s, rests, course = _without_lag(sessions, trusted, settings)
    observe.check_at_rest(rests, device)
    steps = observe.observe_steps(sessions, temperatures=course)
    report("fitting offsets over temperature", 0.4)
    looked_up = thermometer.looked_up_c(sessions, trusted, course, lag_s, smooth_s)
    nodes, inside = table_nodes(np.concatenate([rests.temp_c, steps.temp_c, looked_up]), settings)
    static = fit_static(rests, nodes=nodes, calibration=device, settings=static_settings)
    judge.check_sessions(static, device)
    felt = felt_by_gyro(rests, device).mean(axis=0)
    agreement = judge.turns_verdict(steps, device, static).also(judge.offsets_verdict(static, device, felt))
    report("cross-validating scale and dynamic tables", 0.5)
    choice, of_choice = _chosen(steps, device, static, rests, settings)
    static = StaticFit(
        table=_cut(static.table, inside),
        gyro=static.gyro and _cut(static.gyro, inside),
        accel=static.accel and _cut(static.accel, inside),
        verdict=static.verdict,
    )
    report("fitting accelerometers over temperature", 0.95)
    accel, of_accel = _accelerometers(rests, device, nodes[inside])
    made = agreement.also(of_choice).also(no_rests).also(of_accel)
    made = made.also(judge.static_verdict(static, accel, device, temperatures))
    if lag is not None and lag_s == 0.0:
        made = made.also(Verdict.of(*lag.findings))
    tables = _tables(static, choice, accel, inside, (lag_s, smooth_s))
    return DriftFit(
        calibration=_calibrated(device, tables, made, sessions, settings, choice),
        static=static,
        choice=choice,
        accel=accel,
        lag=lag,
        rests=rests,
        steps=steps,
        temperatures=temperatures,
        gyro_summary=judge.summarise_gyro(static, device),
        accel_summary=judge.summarise_accel(static, accel, device, static_settings.accel_unit),
        scale_summary=None if choice is None or choice.scale is None else judge.summarise_scale(choice.scale, device),
        verdict=made if calibration is not None else device.verdict.also(made),
    )


def _checked(sessions: Sequence[Session], calibration: Calibration | None, settings: DriftSettings) -> list[Session]:
    """Return sessions of one device, each in one unit."""
    if not sessions:
        raise InputError("drift: no session was given. Name its folder.")
    names = [*(session.serial or session.records[0].device for session in sessions)]
    names = sorted({name for name in (*names, "" if calibration is None else calibration.device) if name})
    if len(names) > 1:
        raise InputError(f"drift: sessions and calibration are of different devices: {', '.join(names)}. Sort them.")
    if settings.lag_s is not None and not 0.0 <= settings.lag_s < np.inf:
        raise InputError(f"drift: the lag must be 0 s or more, got {settings.lag_s:g}. State the thermometer's.")
    observe.check_once(sessions)
    return [in_one_unit(session) for session in sessions]


def _without_lag(
    sessions: Sequence[Session], trusted: list[list[Temperature]], settings: DriftSettings
) -> tuple[LagFit | None, float, float, RestBlocks, list[list[FloatArray]]]:
    """Return the lag and its smoothing in use, s, with rests and temperatures from which the lag is subtracted."""

    def rests_at(course: list[list[FloatArray]]) -> RestBlocks:
        return observe.observe_rests(sessions, temperatures=course)

    course = [[temperature.temp_c for temperature in of_session] for of_session in trusted]
    rests, lag, lag_s = rests_at(course), None, settings.lag_s or 0.0
    if settings.lag_s is None and any(t.source == "column" for of_session in trusted for t in of_session):
        lag = thermometer.estimate_lag(rests)
        if lag.lag_s > SURE_LAG * lag.uncertainty_s:
            lag_s = lag.lag_s
    if lag_s == 0.0:
        return lag, 0.0, 0.0, rests, course
    course = [thermometer.sensor_course(own, session, lag_s) for own, session in zip(trusted, sessions, strict=True)]
    smooth_s = max(  # for the noisiest of the columns
        thermometer.default_smooth_s(
            lag_s, noise_c=t.noise_c, interval_s=float(np.median(np.diff(record.time))), step_c=t.step_c
        )
        for own, session in zip(trusted, sessions, strict=True)
        for t, record in zip(own, session.records, strict=True)
    )
    return lag, lag_s, smooth_s, rests_at(course), course


def table_nodes(seen_c: FloatArray, settings: DriftSettings) -> tuple[FloatArray, slice]:
    """Return nodes over all temperatures seen (k,) and asked for, degC, and which of them the tables hold."""
    step = settings.step_c
    least, greatest = float(np.nanmin(seen_c)), float(np.nanmax(seen_c))
    outward = float(np.floor(least / step) * step), float(np.ceil(greatest / step) * step)
    whole = [
        end if 0.0 < sign * (end - seen) <= BEYOND_SEEN_C else seen
        for end, seen, sign in zip(RANGE_C, outward, (-1, 1), strict=True)
    ]
    low, high = settings.range_c or whole
    count = (high - low) / step if step > 0.0 else 0.0
    if count < 1.0 or abs(count - round(count)) > 1e-6:
        raise InputError(
            f"drift tables: the step must divide the range, got {low:g} to {high:g} degC by {step:g}. Take for example 18 to 75 "
            "by 0.5."
        )
    below = max(int(np.ceil((low - whole[0]) / step - 1e-9)), 0)
    above = max(int(np.ceil((whole[1] - high) / step - 1e-9)), 0)
    inside = np.linspace(low, high, round(count) + 1)
    nodes = np.concatenate((low - step * np.arange(below, 0, -1), inside, high + step * np.arange(1, above + 1)))
    return nodes, slice(below, below + len(inside))


def _cut(table: T, inside: slice) -> T:
    """Return the rows of some nodes of a table."""
    rows: dict[str, Any] = {}
    for name in table.__dataclass_fields__:
        values = getattr(table, name)
        if values is not None and name.endswith(
            ("temp_c", "offset", "matrix", "uncertainty", "extrapolated", "_scale")
        ):
            rows[name] = values[inside]
    rows.pop("slope_uncertainty", None)
    rows.pop("hysteresis_uncertainty", None)
    return replace(table, **rows)


def _chosen(
    steps: RateSteps, device: Calibration, static: StaticFit, rests: RestBlocks, settings: DriftSettings
) -> tuple[Choice | None, Verdict]:
    """Return the choice of tables and what they are worth, or why there is none."""
    auto = settings.tables in ("auto", "none")
    if device.gyro is None or static.table.gyro_offset is None:  # a device without gyroscopes
        if not auto:
            raise NotObservable(f"tables: {settings.tables} needs gyroscopes, but calibration or sessions have none.")
        return None, Verdict()
    if not len(steps):
        why = finding("drift.no_turns", "warn")
    else:
        try:
            choice = choose_tables(
                steps, device, static=static.table, temp_c=static.table.temp_c, rests=rests, tables=settings.tables
            )
            return choice, choice.verdict
        except NotObservable as error:
            why = finding("drift.tables_not_observable", "warn", problem=str(error))
    if not auto:
        raise NotObservable(
            f"tables: {settings.tables} was requested, but the sessions do not determine it: {why.text}"
        )
    return None, Verdict.of(why) if settings.tables == "auto" else Verdict()


def _accelerometers(rests: RestBlocks, device: Calibration, nodes: FloatArray) -> tuple[AccelDriftFit | None, Verdict]:
    """Return the accelerometers' fit to poses; None if the poses do not determine it, with the reason."""
    if device.accel is None or len(np.unique(rests.pose)) < 2 or np.isnan(rests.accel).all():
        return None, Verdict()
    try:
        accel = fit_accel_drift(rests, device, temp_c=nodes)
    except NotObservable as error:
        return None, Verdict.of(finding("drift.accel_not_observable", "info", problem=str(error)))
    return accel, accel.verdict.also(judge.poses_verdict(accel, device))


def _tables(
    static: StaticFit, choice: Choice | None, accel: AccelDriftFit | None, inside: slice, lags_s: tuple[float, float]
) -> DriftTables:
    offsets, scale, dynamic = static.table, None, None
    if choice is not None:
        scale, dynamic = choice.scale_drift and _cut(choice.scale_drift, inside), choice.dynamic_drift
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
    of_fit: Verdict,
    sessions: Sequence[Session],
    settings: DriftSettings,
    choice: Choice | None,
) -> Calibration:
    """Return a calibration with tuning tables; files and settings of an earlier thermal fit go with its tables."""
    previous = device.provenance
    before = previous.inputs[: previous.count(INPUTS_BEFORE, len(previous.inputs))]
    chosen = "none" if choice is None else choice.alternatives.chosen
    provenance = Provenance(
        inputs=tuple(dict.fromkeys((*before, *(entry for session in sessions for entry in session.inputs)))),
        settings=(
            *(entry for entry in previous.settings if not entry[0].startswith("drift_")),
            ("drift_spline", "not-a-knot" if settings.static.not_a_knot else "smoothing"),
            ("drift_lag_s", f"{tables.lag_s:.4g}"),
            ("drift_tables", "static" if chosen == "none" else f"static, {chosen}"),
            ("drift_sessions", f"{len(sessions)}"),
            (INPUTS_BEFORE, f"{len(before)}"),
            (judge.STATUS_BEFORE, device.verdict.status),
        ),
        versions=previous.versions or versions_used(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    return replace(
        device,
        reference_temp_c=_reference_of(device, tables),
        drift=tables,
        verdict=device.verdict.also(of_fit),
        provenance=provenance,
    )


def _reference_of(device: Calibration, tables: DriftTables) -> float:
    """Return the calibration's reference temperature, or the temperature seen that is nearest to 25 degC, degC."""
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
    tables: TableChoice = "auto",
) -> Choice:
    """Fit all alternatives, and select one by cross-validation, or the one requested; nodes temp_c (n,), degC."""
    clean = prepared(steps, calibration, static=static, rests=rests)
    fits, problems = _fit_all(clean, calibration, temp_c)
    if fits.scale is None and fits.dynamic is None:
        raise NotObservable("scale and dynamic drift: " + " ".join(problems))
    soaks, point = _set_points(clean)
    residuals = {which: _residuals(clean, fits, which, calibration) for which in ALTERNATIVES}
    square = np.array([_mean_square(clean, residuals[which]) for which in ALTERNATIVES])
    fitted_dps, nothing = np.sqrt(square) / RADIAN_PER_DEGREE, np.full(len(ALTERNATIVES), np.nan)
    folds = [clean.soak == s for s in soaks[(point > 0) & (point < point.max())]]  # nothing predicts beyond the ends
    values: dict[str, Any] = {"soaks": len(soaks), "set_points": int(point.max()) + 1, "held_out": len(folds)}
    left_dps = error_dps = nothing
    chosen: Alternative = "scale" if fits.scale is not None else "dynamic"
    if folds:
        left = np.array([_left_out_squares(clean, fold, fits, calibration, temp_c) for fold in folds])
        square, error = left.mean(axis=0), np.zeros(len(ALTERNATIVES))
        if len(folds) > 1:
            error = left.std(axis=0, ddof=1) / np.sqrt(len(folds))
        best = int(np.nanargmin(square))
        chosen = ALTERNATIVES[
            int(np.flatnonzero(square <= max(square[best] + error[best], square[best] * WORTH**2))[0])
        ]
        left_dps = np.sqrt(square) / RADIAN_PER_DEGREE
        error_dps = 0.5 * error / np.maximum(square, 1e-300) * left_dps
    if tables != "auto":
        chosen = tables
        if not fits.have(chosen):
            raise NotObservable(f"{chosen} cannot be fitted to these steps. " + " ".join(problems))
    index = ALTERNATIVES.index(chosen)
    values |= {"tables": chosen, "error_dps": float((left_dps if folds else fitted_dps)[index])}
    if folds:
        why = finding(
            "drift.tables_selected", "info", **values, requested="requested" if tables != "auto" else "selected"
        )
    else:
        why = finding("drift.tables_unjudged", "warn", **values, constant_dps=float(fitted_dps[0]))
    missing = [finding("drift.tables_not_observable", "info", problem=problem) for problem in problems[:1]]
    of_tables = Verdict.of(why, *missing)
    for fit in fits.taken(chosen):
        of_tables = of_tables if fit is None else of_tables.also(fit.verdict)
    table = Alternatives(
        name=ALTERNATIVES,
        fitted_rms_dps=fitted_dps,
        left_out_rms_dps=left_dps,
        standard_error_dps=error_dps,
        chosen=chosen,
        why=why,
    )
    return Choice(fits=fits, alternatives=table, verdict=of_tables)


def _fit_all(
    steps: Steps, calibration: Calibration, temp_c: FloatArray, like: Fits | None = None
) -> tuple[Fits, list[str]]:
    """Fit matrix and dynamic drift to some steps, as soft as in earlier fits; return them and why any is missing."""
    problems = list[str]()
    span_c = float(temp_c[0]), float(temp_c[-1])
    scale, dynamic, both = None, None, None
    try:
        scale = fit_scale(steps, calibration, temp_c=temp_c)
    except CalibrationError as error:
        problems.append(str(error))
    try:
        dynamic = fit_dynamic(steps, calibration, span_c=span_c, like=like and like.dynamic)
        if scale is not None:
            both = fit_dynamic(steps, calibration, span_c=span_c, like=like and like.both, scale=scale.drift)
    except CalibrationError as error:
        problems.append(str(error))
    return Fits(scale, dynamic, both), problems


def _left_out_squares(
    steps: Steps, fold: BoolArray, fits: Fits, calibration: Calibration, temp_c: FloatArray
) -> list[float]:
    """Return the mean square that each alternative leaves of a soak to which it was not fitted, (rad/s)^2."""
    others, soak = _fit_all(steps.taken(~fold), calibration, temp_c, like=fits)[0], steps.taken(fold)
    return [_mean_square(soak, _residuals(soak, others, which, calibration)) for which in ALTERNATIVES]


def _residuals(steps: Steps, fits: Fits, which: Alternative, calibration: Calibration) -> FloatArray:
    """Return what an alternative leaves of steps, rad/s, shape (n, 3); NaN if it has no fit."""
    if not fits.have(which):
        return np.full((len(steps), 3), np.nan)
    scale, dynamic = fits.taken(which)
    rate = measured_rate(steps.reading, steps.temp_c, calibration, None if scale is None else scale.drift)
    for axis, surface in enumerate(dynamic.surfaces if dynamic else ()):
        if surface is not None:
            rate[:, axis] -= surface.at(rate[:, axis], steps.temp_c)
    return np.asarray(rate - steps.rate_b)


def _mean_square(steps: Steps, residual: FloatArray) -> float:
    """Return the mean square of residuals (n, 3) about the offset of each mounting, (rad/s)^2."""
    left = residual.copy()
    for m in np.unique(steps.mounting[~steps.one_rate]):
        left[steps.mounting == m] -= residual[steps.mounting == m].mean(axis=0)
    return float(np.mean(left**2))


def _set_points(steps: Steps) -> tuple[IntArray, IntArray]:
    """Return the soaks in the order of their temperature, and which set-point each was at, from the coldest."""
    soaks = np.unique(steps.soak)
    middle = np.array([steps.temp_c[steps.soak == s].mean() for s in soaks])
    order = np.argsort(middle, kind="stable")
    apart = np.concatenate(([0], np.cumsum(np.diff(middle[order]) > SAME_C)))
    return soaks[order], apart
