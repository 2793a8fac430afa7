"""Fit tuning tables to thermal sessions and a calibration (Figure 2 of the note).

    temperature     checked and smoothed, without the lag that the session gives or ramps determine
    static drift    absolute offset(T) from rests, raw unit                        blocks 2 to 5
    matrix          M(T) from rate steps at two soaks or more
    dynamic drift   e(w, T) that remains, from rate steps at three soaks or more   blocks 6 to 9
    accelerometers  offset(T) and M(T) from poses at several temperatures, otherwise offset(T) from rests

If the calibration knows that codes are truncated, half a step is added first, as in ``correct``. A finding of the verdict names
each part that is not observable, and the recording that would determine it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.quality import check_counted_once
from undrift.calibration.session import ROOM_C
from undrift.drift import observe
from undrift.drift import temperature as thermometer
from undrift.drift import verdict as judge
from undrift.drift.accel import AccelDriftFit, fit_accel_drift
from undrift.drift.observe import RateSteps, RestBlocks, not_observable
from undrift.drift.offset import StaticFit, StaticSettings, felt_by_gyro, fit_static
from undrift.drift.rates import DynamicFit, ScaleFit, fit_dynamic, fit_scale, prepared
from undrift.drift.temperature import LagFit
from undrift.errors import InputError, NotObservable, check_choices
from undrift.findings import Finding
from undrift.fit.gls import determined
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
from undrift.shown import Shown

if TYPE_CHECKING:
    import pandas as pd

RANGE_C = (18.0, 75.0)  # spacing of the note
STEP_C = 0.5
SURE_LAG = 3.0  # standard uncertainties: a smaller lag is not subtracted
OUTLYING = 5.0 * 1.4826  # margin of a table beyond the smooth course, in median absolute deviations of single readings
INPUTS_BEFORE = "drift_inputs_before"  # key of a setting: number of inputs of the calibration before a thermal fit

Tables = Literal["none", "scale", "dynamic", "scale + dynamic"]  # in addition to the offsets
Progress = Callable[[str, float], None]  # next stage, and completed share of the work


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """Settings of a fit over temperature.

    Parameters
    ----------
    step_c : float
        Distance between nodes, K. The nodes span the data. They extend to 18 or 75 degC if the data end within 3 degC of it.
    tables : str
        Tables in addition to the offsets: "none", "scale", "dynamic" or "scale + dynamic".
    static : StaticSettings
        Settings of the offset over temperature.
    """

    step_c: float = STEP_C
    tables: Tables = "scale + dynamic"
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
    scale : ScaleFit or None
        Matrix over temperature, even if its table is not requested, or None without rate steps at two soaks.
    dynamic : DynamicFit or None
        Dynamic drift, or None if it is not requested or not observable.
    accel : AccelDriftFit or None
        Accelerometers from poses, or None without poses at two temperatures.
    lag : LagFit or None
        Lag of the thermometer from ramps at two speeds, or None if the session gives it.
    rests : RestBlocks
        Data of the static tables.
    steps : RateSteps
        Data of the other tables, possibly without rows.
    verdict : Verdict
        Verdict of the thermal fit only. The verdict of ``calibration`` also contains its earlier findings.
    """

    calibration: Calibration
    static: StaticFit
    scale: ScaleFit | None
    dynamic: DynamicFit | None
    accel: AccelDriftFit | None
    lag: LagFit | None
    rests: RestBlocks
    steps: RateSteps
    verdict: Verdict


@determined("drift")
def fit_drift(
    sessions: "Sequence[Session] | pd.DataFrame",
    calibration: Calibration | None = None,
    *,
    settings: DriftSettings = DriftSettings(),
    progress: Progress | None = None,
) -> DriftFit:
    """Fit the tuning tables of a device to thermal sessions.

    Parameters
    ----------
    sessions : sequence of Session, or DataFrame
        One or more sessions of the device. The scatter of several sessions counts as uncertainty. Alternatively, a data frame of
        means over set-points, one per row: temp_c, and readings with undrift's column names (gyro_x_dps). Rows that are not at rest
        have the imposed rate in turn_rate_x_dps, turn_rate_y_dps and turn_rate_z_dps.
    calibration : Calibration, optional
        Calibration of the same device. Without it, readings in a physical unit keep their nominal scale, and counts are refused.
    settings : DriftSettings
        Nodes, lag and tables.
    progress : callable, optional
        Called with a description of the next step and the completed share of the work, 0 to 1.

    Returns
    -------
    DriftFit
        The calibration with its tables, and their data.

    Raises
    ------
    InputError
        There is no session, the device is not that of the calibration, data are repeated, a temperature is missing or implausible,
        or units do not agree.
    NotObservable
        The temperature is constant or its range is too small, there are no rests, or counts have no calibration.
    Implausible
        Turns are about other axes than in the calibration or in the opposite sense, or sessions differ too much for one device.

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
    report, rate_b = progress or (lambda what, share: None), None
    if not isinstance(sessions, Sequence) and hasattr(sessions, "columns"):
        session, rate_b = observe.means_session(sessions)
        sessions = [session]
    if not isinstance(sessions, Sequence) or not all(isinstance(session, Session) for session in sessions):
        kind = type(sessions).__name__
        raise InputError(
            f"drift: expected a list of sessions or a data frame of means, got {kind}. Read each session with read_session."
        )
    sessions = _check_sessions(sessions, calibration)
    device = observe.nominal_models(sessions) if calibration is None else judge.without_tables(calibration)
    sessions = [observe.in_units_of(session, device) for session in sessions]

    def observed(course: observe.Temperatures) -> tuple[RestBlocks, RateSteps]:
        if rate_b is not None:
            return observe.observe_means(sessions[0].records[0], rate_b, course[0][0])
        rests = observe.observe_rests(sessions, temperatures=course)
        return rests, observe.observe_steps(sessions, temperatures=course)

    report("smoothing the temperature", 0.0)
    means = rate_b is not None
    trusted = [[thermometer.trusted_temperature(s, k, means=means) for k in range(len(s.records))] for s in sessions]
    temperatures = [temperature for session_temperatures in trusted for temperature in session_temperatures]
    thermometer.check_span(temperatures)
    report("gathering rests and turns", 0.15)
    course = [[temperature.temp_c for temperature in session_temperatures] for session_temperatures in trusted]
    rests, steps = observed(course)
    lag, lag_s, smooth_s = None, max(session.sensitivity.thermometer_lag_s for session in sessions), 0.0
    if lag_s == 0.0 and any(temperature.source == "column" for temperature in temperatures):
        lag = thermometer.estimate_lag(rests)
        lag_s = lag.lag_s if lag.lag_s > SURE_LAG * lag.uncertainty_s else 0.0
    if lag_s > 0.0:
        smooth_s = max(thermometer.default_smooth_s(lag_s, temperature) for temperature in temperatures)
        rests, steps = observed(
            [
                [thermometer.without_lag_smooth(each, lag_s=lag_s) for each in temperatures_of]
                for temperatures_of in trusted
            ]
        )
    findings = [*judge.check_rests(sessions, rests, steps)]
    report("fitting offsets over temperature", 0.4)
    # single readings, which ``correct`` looks up, reach beyond the smooth course
    lead = lag_s / smooth_s if lag_s > 0.0 else 1.0
    margin_c = OUTLYING * lead * max(temperature.scatter_c for temperature in temperatures)
    seen_c = np.concatenate((rests.temp_c, steps.temp_c))
    nodes = table_nodes(np.array([seen_c.min() - margin_c, seen_c.max() + margin_c]), settings.step_c)
    accel, accel_findings = _accelerometers(rests, device, nodes)
    left_s = 0.0 if lag_s > 0.0 else np.inf
    if lag is not None:
        left_s = np.hypot(lag.uncertainty_s, lag.lag_s - lag_s)
    lag_uncertainty_s = min(float(left_s), settings.static.lag_uncertainty_s)
    static_settings = replace(settings.static, accel=accel is None, lag_uncertainty_s=lag_uncertainty_s)
    static = fit_static(rests, nodes=nodes, calibration=device, settings=static_settings)
    judge.check_sessions(static, device)
    findings += judge.check_offsets(static, device, felt_by_gyro(rests, device).mean(axis=0))
    findings += judge.check_gravity(rests, device)
    report("fitting scale and dynamic drift", 0.5)
    scale, dynamic, rate_findings = _fit_rates(steps, device, static, settings.tables)
    findings += (*judge.check_turns(scale, device), *rate_findings, *accel_findings, *static.findings)
    findings += (*judge.check_temperatures(static, device, temperatures), *judge.check_lag(lag))
    verdict = Verdict.of(*findings)
    scale_table = scale.drift if scale is not None and "scale" in settings.tables else None
    tables = replace(
        _tables(static.table, scale_table, None if dynamic is None else dynamic.drift, accel),
        lag_s=lag_s,
        lag_smooth_s=smooth_s,
    )
    return DriftFit(
        calibration=_build_calibration(device, tables, verdict, sessions, settings),
        static=static,
        scale=scale,
        dynamic=dynamic,
        accel=accel,
        lag=lag,
        rests=rests,
        steps=steps,
        verdict=verdict if calibration is not None else device.verdict.also(verdict),
    )


def _check_sessions(sessions: Sequence[Session], calibration: Calibration | None) -> list[Session]:
    """Return the sessions. Raise if they belong to different devices."""
    if not sessions:
        raise InputError("drift: no session was given. Give its folder.")
    names = {session.serial or session.records[0].device for session in sessions}
    names = (names | {"" if calibration is None else calibration.device}) - {""}
    if len(names) > 1:
        raise InputError(
            f"drift: sessions and calibration are of different devices: {', '.join(sorted(names))}. "
            "Give the sessions of one device."
        )
    check_counted_once([record for session in sessions for record in session.records])
    return list(sessions)


def table_nodes(seen_c: FloatArray, step_c: float) -> FloatArray:
    """Return the nodes of the tables, degC, from all recorded temperatures (k,)."""
    if not 0.0 < step_c < np.inf:
        raise InputError(f"drift tables: the step between nodes must be above 0 K, got {step_c:g}. The note uses 0.5.")
    low, high = step_c * np.floor(np.nanmin(seen_c) / step_c), step_c * np.ceil(np.nanmax(seen_c) / step_c)
    low = RANGE_C[0] if 0.0 < low - RANGE_C[0] <= BEYOND_SEEN_C else low
    high = RANGE_C[1] if 0.0 < RANGE_C[1] - high <= BEYOND_SEEN_C else high
    return np.linspace(low, high, max(1, round((high - low) / step_c)) + 1)


def _fit_rates(
    steps: RateSteps, device: Calibration, static: StaticFit, tables: Tables
) -> tuple[ScaleFit | None, DynamicFit | None, list[Finding]]:
    """Return matrix and dynamic drift with their findings. The matrix is always fitted, because it reveals the turn axes."""
    scale, dynamic, findings, temp_c = None, None, list[Finding](), static.table.temp_c
    try:
        if device.gyro is None or static.gyro is None:
            raise NotObservable("calibration or sessions have no gyroscopes.")
        if not len(steps):
            raise NotObservable("rests do not determine them. Turn the device at known rates at two temperatures.")
        clean = prepared(steps, device.gyro, static=static.table)
        scale = fit_scale(clean, device.gyro, temp_c=temp_c)
        if "dynamic" in tables:
            matrix = scale.drift if "scale" in tables else None
            dynamic = fit_dynamic(clean, device.gyro, span_c=(float(temp_c[0]), float(temp_c[-1])), scale=matrix)
    except NotObservable as error:
        what = "Scale and dynamic drift" if scale is None else "Dynamic drift"
        if tables != "none" and static.gyro is not None:
            findings.append(not_observable("warn" if scale is None else "info", what, str(error)))
    for fit, wanted in ((scale, "scale" in tables), (dynamic, True)):
        findings += fit.findings if fit is not None and wanted else ()
    return scale, dynamic, findings


def _accelerometers(
    rests: RestBlocks, device: Calibration, nodes: FloatArray
) -> tuple[AccelDriftFit | None, tuple[Finding, ...]]:
    """Return the fit of the accelerometers to poses, or None and the reason if the poses do not determine it."""
    if device.accel is None or len(np.unique(rests.pose)) < 2 or np.isnan(rests.accel).all():
        return None, ()
    try:
        return fit_accel_drift(rests, device.accel, gravity=device.gravity_m_s2, temp_c=nodes), ()
    except NotObservable as error:
        return None, (not_observable("info", "Accelerometer matrix over temperature", str(error)),)


def _tables(
    offsets: StaticDrift, scale: ScaleDrift | None, dynamic: DynamicDrift | None, accel: AccelDriftFit | None
) -> DriftTables:
    """Return the tables, including those of the accelerometers from poses."""
    if accel is not None:
        offsets = replace(
            offsets,
            accel_offset=accel.offset,
            accel_uncertainty=accel.offset_uncertainty,
            accel_extrapolated=accel.extrapolated,
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
) -> Calibration:
    """Return a calibration with tuning tables. They replace tables, files and settings of an earlier thermal fit."""
    previous, static, reference_c = device.provenance, tables.static, device.reference_temp_c
    if not np.isfinite(reference_c) and static is not None:
        reference_c = float(np.clip(ROOM_C, *seen_span(static.temp_c, static.gyro_extrapolated)))
    earlier_inputs = previous.inputs[: int(previous.number(INPUTS_BEFORE, len(previous.inputs)))]
    names = [name for name in ("static", "scale", "dynamic") if getattr(tables, name) is not None]
    provenance = replace(
        previous,
        inputs=tuple(dict.fromkeys((*earlier_inputs, *(entry for session in sessions for entry in session.inputs)))),
        settings=(
            *(entry for entry in previous.settings if not entry[0].startswith("drift_")),
            ("drift_spline", "not-a-knot" if settings.static.not_a_knot else "smoothing"),
            ("drift_lag_s", f"{tables.lag_s:.4g}"),
            ("drift_tables", ", ".join(names)),
            ("drift_sessions", f"{len(sessions)}"),
            (INPUTS_BEFORE, f"{len(earlier_inputs)}"),
        ),
        versions=previous.versions or versions_used(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    verdict = device.verdict.also(verdict)
    return replace(device, reference_temp_c=reference_c, drift=tables, verdict=verdict, provenance=provenance)
