"""Fit tuning tables to thermal sessions and a calibration (Figure 2 of the note).

    temperature     checked and smoothed, without the lag estimated from ramps
    static drift    absolute offset(T) from rests, raw unit                        blocks 2 to 5
    matrix          M(T) from rate steps at two soaks or more
    dynamic drift   e(w, T) that remains                                           blocks 6 to 9
    accelerometers  offset(T) and M(T) from poses at several temperatures, otherwise offset(T) from rests

If the calibration knows that codes are truncated, half a step is added first, as in ``correct``. A finding of the verdict names
each part that is not observable, and the recording that would determine it.

In addition to the offsets, a device may need no table, scale over temperature, dynamic drift, or both. Each alternative is fitted
without one soak (except the first and the last), and predicts the steps of that soak. The prediction error is
``M(T) (u - offset(T)) - e`` minus the imposed rate on all three axes, about the mean or the rest of their mounting. The simplest
alternative is selected whose mean square is within one standard error of the least [1]_, or whose rms is within 5 % of it. If no
soak can be left out, the matrix is kept.

Offsets are fitted to all rests, the other tables to the steps within the range of the table.

References
----------
.. [1] L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and Regression Trees", 1984, section 3.4.3.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.base.summary import Shown
from undrift.calibration.session import ROOM_C
from undrift.drift import observe
from undrift.drift import temperature as thermometer
from undrift.drift import verdict as judge
from undrift.drift.accel import AccelDriftFit, fit_accel_drift
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.offset import StaticFit, StaticSettings, felt_by_gyro, fit_static
from undrift.drift.rates import DynamicFit, ScaleFit, Steps, fit_dynamic, fit_scale, measured_rate, prepared
from undrift.drift.temperature import LagFit, Temperature
from undrift.errors import CalibrationError, InputError, NotObservable, check_choices
from undrift.findings import Finding, finding
from undrift.fit.gls import determined
from undrift.fit.priors import THERMOMETER_LAG
from undrift.model import (
    BEYOND_SEEN_C,
    Calibration,
    DriftTables,
    DynamicDrift,
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
SURE_LAG = 3.0  # standard uncertainties: a smaller lag is not subtracted
OUTLYING = 5.0 * 1.4826  # median absolute deviations of single readings that a table reaches beyond the smooth course
SAME_C = 1.0  # between soaks, in the order of their temperature: further apart is another set-point
WORTH = 1.05  # an additional table has to reduce the rms by this factor at least
INPUTS_BEFORE = "drift_inputs_before"  # setting: number of inputs of the calibration before a thermal fit

Alternative = Literal["none", "scale", "dynamic", "scale + dynamic"]
ALTERNATIVES: tuple[Alternative, ...] = ("none", "scale", "dynamic", "scale + dynamic")  # simplest first
TableChoice = Literal["auto"] | Alternative
Fits = Mapping[Alternative, tuple[ScaleFit | None, DynamicFit | None]]  # alternatives that the steps determine
Progress = Callable[[str, float], None]  # next stage, and the share of the work that is done


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """Fits of all alternatives, their cross-validated errors, and the selected alternative."""

    fits: Fits
    fitted_rms_dps: FloatArray  # (4,), residual of the fit to all steps, deg/s, or NaN if not observable
    left_out_rms_dps: (
        FloatArray  # (4,), prediction error of the soaks left out, deg/s, or NaN with fewer than three set-points
    )
    standard_error_dps: FloatArray  # (4,), standard error of ``left_out_rms_dps``
    chosen: Alternative
    why: Finding
    verdict: Verdict  # verdict of the selected tables

    @property
    def scale(self) -> ScaleFit | None:
        """The fit of the matrix, even if it is not selected."""
        return self.fits.get("scale", (None, None))[0]

    @property
    def scale_drift(self) -> ScaleDrift | None:
        """The matrix table to use."""
        scale = self.fits[self.chosen][0]
        return None if scale is None else scale.drift

    @property
    def dynamic_drift(self) -> DynamicDrift | None:
        """The dynamic table to use."""
        dynamic = self.fits[self.chosen][1]
        return None if dynamic is None else dynamic.drift


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """Settings of a fit over temperature.

    Parameters
    ----------
    range_c : tuple of float, optional
        First and last node, degC. It may be wider than the data. The default is the range of the data, extended to 18 or 75 degC if
        the end is within 3 degC of these.
    step_c : float
        Distance between nodes, K.
    lag_s : float, optional
        Lag of the thermometer, s. None estimates it from ramps, 0 does not subtract any lag.
    tables : str
        Selection of scale and dynamic tables: "auto" selects them, or "none", "scale", "dynamic", "scale + dynamic".
    static : StaticSettings
        Settings of the offset over temperature.
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
    """Tuning tables with the data and intermediate results of their fit.

    Parameters
    ----------
    calibration : Calibration
        The input calibration with the tables added.
    static : StaticFit
        Offsets over temperature.
    choice : Choice or None
        Matrix and dynamic drift, or None without rate steps at two soaks.
    accel : AccelDriftFit or None
        Accelerometers from poses, or None without poses at two temperatures.
    lag : LagFit or None
        Lag of the thermometer, or None if it was given.
    rests : RestBlocks
        Data of the static tables.
    steps : RateSteps
        Data of the other tables, possibly without rows.
    gyro_summary, accel_summary : TriadSummary or None
        Offsets over temperature in SI units, for display.
    scale_summary : ScaleSummary or None
        Scale factors over temperature, even if no table of them was selected.
    verdict : Verdict
        Verdict of the thermal fit only. The verdict of ``calibration`` also contains its earlier findings.
    """

    calibration: Calibration
    static: StaticFit
    choice: Choice | None
    accel: AccelDriftFit | None
    lag: LagFit | None
    rests: RestBlocks
    steps: RateSteps
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
        One or more sessions of the device. The scatter of several sessions counts as uncertainty.
    calibration : Calibration, optional
        Calibration of the same device. Without it, readings in a physical unit keep their nominal scale, and counts are refused.
    settings : DriftSettings
        Nodes, lag and selection of tables.
    progress : callable, optional
        Called with a description of the next step and the completed share of the work, 0 to 1.

    Returns
    -------
    DriftFit
        The calibration with its tables, and their data.

    Raises
    ------
    InputError
        No session, another device than the calibration's, repeated data, a missing or implausible temperature, or units that
        do not agree.
    NotObservable
        A temperature that is constant or spans too little, no rests, counts without a calibration, or a requested table that
        the sessions do not determine.
    Implausible
        Turns about other axes than the calibration's or in the opposite sense, or sessions that differ too much for one device.

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
    sessions = _check_sessions(sessions, calibration, settings)
    device = observe.nominal_models(sessions) if calibration is None else judge.without_tables(calibration)
    sessions = [observe.in_units_of(session, device) for session in sessions]
    accel_unit = observe.accel_unit_of(sessions, device)
    report("smoothing the temperature", 0.0)
    trusted = [[thermometer.trusted_temperature(s, k) for k in range(len(s.records))] for s in sessions]
    temperatures = [temperature for session_temperatures in trusted for temperature in session_temperatures]
    thermometer.check_span(temperatures)
    report("gathering rests and turns", 0.15)
    course = [[temperature.temp_c for temperature in session_temperatures] for session_temperatures in trusted]
    rests, lag, lag_s, smooth_s = observe.observe_rests(sessions, temperatures=course), None, settings.lag_s or 0.0, 0.0
    if settings.lag_s is None and any(temperature.source == "column" for temperature in temperatures):
        lag = thermometer.estimate_lag(rests)
        lag_s = lag.lag_s if lag.lag_s > SURE_LAG * lag.uncertainty_s else 0.0
    if lag_s > 0.0:
        course, smooth_s = _remove_lag(sessions, trusted, lag_s)
        rests = observe.observe_rests(sessions, temperatures=course)
    steps = observe.observe_steps(sessions, temperatures=course)
    verdict = judge.rests_verdict(sessions, rests, steps)
    report("fitting offsets over temperature", 0.4)
    margin_c = max(
        _noise_in_use(s, session_temperatures, lag_s, smooth_s)
        for s, session_temperatures in zip(sessions, trusted, strict=True)
    )
    seen_c = np.concatenate((rests.temp_c, steps.temp_c))
    nodes = table_nodes(np.array([seen_c.min() - margin_c, seen_c.max() + margin_c]), settings)
    steps = steps.taken((steps.temp_c >= nodes[0]) & (steps.temp_c <= nodes[-1]))
    accel, accel_verdict = _accelerometers(rests, device, nodes)
    static_settings = replace(
        settings.static, accel=accel is None, accel_unit=accel_unit, lag_uncertainty_s=_lag_uncertainty(lag, lag_s)
    )
    static = fit_static(rests, nodes=nodes, calibration=device, settings=static_settings)
    judge.check_sessions(static, device)
    verdict = verdict.also(judge.offsets_verdict(static, device, felt_by_gyro(rests, device).mean(axis=0)))
    verdict = verdict.also(judge.gravity_verdict(rests, device))
    report("cross-validating scale and dynamic tables", 0.5)
    choice, choice_verdict = _choose_rate_tables(steps, device, static, rests, settings)
    scale = None if choice is None else choice.scale
    verdict = verdict.also(judge.turns_verdict(scale, device)).also(choice_verdict)
    verdict = verdict.also(accel_verdict).also(judge.static_verdict(static, device, temperatures))
    if lag is not None and lag_s == 0.0:
        verdict = verdict.also(judge.lag_verdict(lag))
    tables = replace(_tables(static.table, choice, accel), lag_s=lag_s, lag_smooth_s=smooth_s)
    calibrated = _build_calibration(device, tables, verdict, sessions, settings, choice)
    return DriftFit(
        calibration=calibrated,
        static=static,
        choice=choice,
        accel=accel,
        lag=lag,
        rests=rests,
        steps=steps,
        gyro_summary=judge.summarise(calibrated.triad("gyro"), static.gyro),
        accel_summary=judge.summarise(calibrated.triad("accel"), static.accel),
        scale_summary=judge.summarise_scale(scale, device),
        verdict=verdict if calibration is not None else device.verdict.also(verdict),
    )


def _check_sessions(
    sessions: Sequence[Session], calibration: Calibration | None, settings: DriftSettings
) -> list[Session]:
    """Return the sessions. Raise if they belong to different devices."""
    if not sessions:
        raise InputError("drift: no session was given. Name its folder.")
    names = {session.serial or session.records[0].device for session in sessions}
    names = (names | {"" if calibration is None else calibration.device}) - {""}
    if len(names) > 1:
        raise InputError(
            f"drift: sessions and calibration are of different devices: {', '.join(sorted(names))}. "
            "Give the sessions of one device."
        )
    if settings.lag_s is not None and not 0.0 <= settings.lag_s < np.inf:
        raise InputError(
            f"drift: the lag must be 0 s or more, got {settings.lag_s:g}. Give the lag of the thermometer."
        )
    observe.check_once(sessions)
    return list(sessions)


def _lag_uncertainty(lag: LagFit | None, subtracted_s: float) -> float:
    """Return the standard uncertainty of the remaining lag, s, or 0 if a lag was given."""
    if lag is None and subtracted_s > 0.0:
        return 0.0
    left_s = np.inf if lag is None else np.hypot(lag.uncertainty_s, lag.lag_s - subtracted_s)
    return float(min(left_s, THERMOMETER_LAG))


def _remove_lag(
    sessions: Sequence[Session], trusted: Sequence[Sequence[Temperature]], lag_s: float
) -> tuple[list[list[FloatArray]], float]:
    """Return the temperatures of the sensors, and the smoothing with which a correction subtracts the lag, s."""
    course, smooth_s = list[list[FloatArray]](), 0.0
    for session, session_temperatures in zip(sessions, trusted, strict=True):
        course.append([temperature.temp_c for temperature in session_temperatures])
        for k, (record, temperature) in enumerate(zip(session.records, session_temperatures, strict=True)):
            interval_s = float(np.median(np.diff(record.time)))
            noisy_s = thermometer.default_smooth_s(lag_s, noise_c=temperature.noise_c, interval_s=interval_s)
            smooth_s = max(smooth_s, noisy_s)
            if temperature.source == "column":
                course[-1][k] = thermometer.without_lag_smooth(temperature.temp_c, record.time, lag_s=lag_s)
    return course, smooth_s


def _noise_in_use(session: Session, trusted: Sequence[Temperature], lag_s: float, smooth_s: float) -> float:
    """Return the largest difference between single readings, which ``correct`` uses, and the smooth temperature of a session, K."""
    deviations = [
        float(np.nanmedian(np.abs(record.temp_c - temperature.temp_c)))
        for record, temperature in zip(session.records, trusted, strict=True)
        if record.temp_c is not None and temperature.source == "column"
    ]
    return max(deviations, default=0.0) * OUTLYING * (lag_s / smooth_s if lag_s > 0.0 else 1.0)


def table_nodes(seen_c: FloatArray, settings: DriftSettings) -> FloatArray:
    """Return the nodes of the tables, degC, from all recorded temperatures (k,)."""
    step, (low, high) = settings.step_c, RANGE_C
    if settings.range_c is not None:
        low, high = settings.range_c
    elif step > 0.0:
        least, greatest = step * np.floor(np.nanmin(seen_c) / step), step * np.ceil(np.nanmax(seen_c) / step)
        low = low if 0.0 < least - low <= BEYOND_SEEN_C else least
        high = high if 0.0 < high - greatest <= BEYOND_SEEN_C else greatest
    count = (high - low) / step if step > 0.0 else 0.0
    if count < 1.0 or abs(count - round(count)) > 1e-6:
        raise InputError(
            f"drift tables: the step must divide the range, got {low:g} to {high:g} degC by {step:g}. Example: 18 to 75 "
            "by 0.5."
        )
    return np.linspace(low, high, round(count) + 1)


def _choose_rate_tables(
    steps: RateSteps, device: Calibration, static: StaticFit, rests: RestBlocks, settings: DriftSettings
) -> tuple[Choice | None, Verdict]:
    """Return the selected tables with their verdict, or None and the reason why none can be fitted."""
    try:
        if device.gyro is None or static.gyro is None:
            raise NotObservable("calibration or sessions have no gyroscopes.")
        if not len(steps):
            raise NotObservable("rests do not determine them. Turn the device at known rates at two temperatures.")
        nodes = static.table.temp_c
        choice = choose_tables(steps, device, static=static.table, temp_c=nodes, rests=rests, tables=settings.tables)
    except NotObservable as error:
        if settings.tables not in ("auto", "none"):
            raise NotObservable(f"tables: {settings.tables} was requested, but cannot be fitted: {error}") from error
        why = finding("drift.not_observable", "warn", what="Scale and dynamic drift", problem=str(error))
        return None, Verdict.of(why) if settings.tables == "auto" and static.gyro is not None else Verdict()
    return choice, choice.verdict


def _accelerometers(rests: RestBlocks, device: Calibration, nodes: FloatArray) -> tuple[AccelDriftFit | None, Verdict]:
    """Return the accelerometers' fit to poses, or None with the reason if the poses do not determine it."""
    if device.accel is None or len(np.unique(rests.pose)) < 2 or np.isnan(rests.accel).all():
        return None, Verdict()
    try:
        accel = fit_accel_drift(rests, device, temp_c=nodes)
    except NotObservable as error:
        what = "Accelerometer matrix over temperature"
        return None, Verdict.of(finding("drift.not_observable", "info", what=what, problem=str(error)))
    return accel, accel.verdict


def _tables(offsets: StaticDrift, choice: Choice | None, accel: AccelDriftFit | None) -> DriftTables:
    """Return the tables to use."""
    scale, dynamic = (None, None) if choice is None else (choice.scale_drift, choice.dynamic_drift)
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
    return DriftTables(static=offsets, scale=scale, dynamic=dynamic)


def _build_calibration(
    device: Calibration,
    tables: DriftTables,
    verdict: Verdict,
    sessions: Sequence[Session],
    settings: DriftSettings,
    choice: Choice | None,
) -> Calibration:
    """Return a calibration with tuning tables. They replace tables, files and settings of an earlier thermal fit."""
    previous, static, reference_c = device.provenance, tables.static, device.reference_temp_c
    if not np.isfinite(reference_c) and static is not None:
        reference_c = float(np.clip(ROOM_C, *seen_span(static.temp_c, static.gyro_extrapolated)))
    earlier_inputs = previous.inputs[: previous.count(INPUTS_BEFORE, len(previous.inputs))]
    table_choice = "none" if choice is None else choice.chosen
    provenance = replace(
        previous,
        inputs=tuple(dict.fromkeys((*earlier_inputs, *(entry for session in sessions for entry in session.inputs)))),
        settings=(
            *(entry for entry in previous.settings if not entry[0].startswith("drift_")),
            ("drift_spline", "not-a-knot" if settings.static.not_a_knot else "smoothing"),
            ("drift_lag_s", f"{tables.lag_s:.4g}"),
            ("drift_tables", "static" if table_choice == "none" else f"static, {table_choice}"),
            ("drift_sessions", f"{len(sessions)}"),
            (INPUTS_BEFORE, f"{len(earlier_inputs)}"),
        ),
        versions=previous.versions or versions_used(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    verdict = device.verdict.also(verdict)
    return replace(device, reference_temp_c=reference_c, drift=tables, verdict=verdict, provenance=provenance)


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
    """Fit all alternatives and select one by cross-validation, or fit the requested one. Nodes are temp_c (n,), degC."""
    clean = prepared(steps, calibration, static=static, rests=rests)
    fits, problems = _fit_all(clean, calibration, temp_c, tables=tables)
    if len(fits) == 1:
        raise NotObservable("scale and dynamic drift: " + " ".join(problems))
    fitted = _mean_squares(clean, fits, calibration)
    soaks, point = _set_points(clean)
    folds = [clean.soak == s for s in soaks[(point > 0) & (point < point.max())]]  # nothing predicts beyond the ends
    mean_square, error = np.full((2, len(ALTERNATIVES)), np.nan)
    chosen: Alternative = "scale" if "scale" in fits else "dynamic"
    if tables == "auto" and folds:
        without = [_fit_all(clean.taken(~fold), calibration, temp_c, like=fits)[0] for fold in folds]
        squares = [
            _mean_squares(clean.taken(fold), training, calibration)
            for fold, training in zip(folds, without, strict=True)
        ]
        mean_square = np.mean(squares, axis=0)
        error = np.std(squares, axis=0, ddof=1) / np.sqrt(len(folds)) if len(folds) > 1 else np.zeros(len(mean_square))
        best = int(np.nanargmin(mean_square))
        enough = mean_square <= max(mean_square[best] + error[best], mean_square[best] * WORTH**2)
        chosen = ALTERNATIVES[int(np.flatnonzero(enough)[0])]
    chosen = chosen if tables == "auto" else tables
    if chosen not in fits:
        raise NotObservable(f"{chosen} cannot be fitted to these steps. " + " ".join(problems))
    index, left_dps = ALTERNATIVES.index(chosen), np.sqrt(mean_square)
    values = {"tables": chosen, "set_points": int(point.max()) + 1, "soaks": len(soaks), "held_out": len(folds)}
    if tables != "auto":
        why = finding("drift.tables_requested", "info", **values, error_dps=float(np.sqrt(fitted[index])))
    elif folds:
        why = finding("drift.tables_selected", "info", **values, error_dps=float(left_dps[index]))
    else:
        error_dps, constant_dps = float(np.sqrt(fitted[index])), float(np.sqrt(fitted[0]))
        why = finding("drift.tables_unjudged", "warn", **values, error_dps=error_dps, constant_dps=constant_dps)
    missing = [
        finding("drift.not_observable", "info", what="Scale or dynamic drift", problem=problem)
        for problem in problems[:1]
    ]
    verdict = Verdict.of(why, *missing)
    for fit in fits[chosen]:
        verdict = verdict if fit is None else verdict.also(fit.verdict)
    return Choice(
        fits=fits,
        fitted_rms_dps=np.sqrt(fitted),
        left_out_rms_dps=left_dps,
        standard_error_dps=0.5 * error / np.maximum(left_dps, 1e-300),
        chosen=chosen,
        why=why,
        verdict=verdict,
    )


def _fit_all(
    steps: Steps,
    calibration: Calibration,
    temp_c: FloatArray,
    like: Fits | None = None,
    tables: TableChoice = "auto",
) -> tuple[Fits, list[str]]:
    """Fit matrix and dynamic drift to steps, with the softness of earlier fits. Return the fits and the reasons of missing fits.

    The matrix is always fitted, as its change is reported. If tables were requested, dynamic drift is fitted for these only.
    """
    fits: dict[Alternative, tuple[ScaleFit | None, DynamicFit | None]] = {"none": (None, None)}
    problems, scale, span_c = list[str](), None, (float(temp_c[0]), float(temp_c[-1]))
    try:
        scale = fit_scale(steps, calibration, temp_c=temp_c)
        fits["scale"] = scale, None
    except CalibrationError as error:
        problems.append(str(error))
    try:
        alternatives: list[tuple[Alternative, ScaleFit | None]] = [("dynamic", None), ("scale + dynamic", scale)]
        for name, matrix in alternatives[: 1 if scale is None else 2]:
            if tables not in ("auto", name):
                continue
            softness = (like or {}).get(name, (None, None))[1]
            table = None if matrix is None else matrix.drift
            fits[name] = matrix, fit_dynamic(steps, calibration, span_c=span_c, like=softness, scale=table)
    except CalibrationError as error:
        problems.append(str(error))
    return fits, problems


def _mean_squares(steps: Steps, fits: Fits, calibration: Calibration) -> FloatArray:
    """Return the mean square residual of steps for each alternative, (4,), (deg/s)^2, or NaN without a fit.

    Residuals are relative to the mean of a mounting that turned at two rates or more, otherwise to the rests of the mounting.
    """
    squares = np.full(len(ALTERNATIVES), np.nan)
    for k, name in enumerate(ALTERNATIVES):
        if name not in fits:
            continue
        scale, dynamic = fits[name]
        rate = measured_rate(steps.reading, steps.temp_c, calibration, None if scale is None else scale.drift)
        residual = rate - steps.rate_b
        for axis, surface in enumerate(dynamic.surfaces if dynamic else ()):
            if surface is not None:
                residual[:, axis] -= surface.at(rate[:, axis], steps.temp_c)
        for m in np.unique(steps.mounting):
            rows = steps.mounting == m
            turns, rests = rows & steps.turning, rows & ~steps.turning
            level = turns if steps.has_rates(turns) else rests
            if level.any():
                residual[rows] -= residual[level].mean(axis=0)
        squares[k] = np.mean((residual[steps.turning] / RADIAN_PER_DEGREE) ** 2)
    return squares


def _set_points(steps: Steps) -> tuple[IntArray, IntArray]:
    """Return the soaks in the order of their temperature, and which set-point each was at, from the coldest."""
    soaks = np.unique(steps.soak)
    middle = np.array([steps.temp_c[steps.soak == s].mean() for s in soaks])
    order = np.argsort(middle, kind="stable")
    set_point = np.concatenate(([0], np.cumsum(np.diff(middle[order]) > SAME_C)))
    return soaks[order], set_point
