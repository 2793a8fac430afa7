"""Report of a calibration: its suitability, uncertainty, parameters and figures."""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.expanded import expand, gravity_uncertainty
from undrift.correction.answer import REST_S, TASK_S, WITHIN_K, answer_sentence, pitch_limits
from undrift.errors import InputError
from undrift.io.store import calibration_json
from undrift.model import AXES, Calibration, DriftTables, TriadModel
from undrift.mounting import statement_of
from undrift.report import figures
from undrift.report.report import Cell, Estimate, Report, Table
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {"accel": "accelerometers", "gyro": "gyroscopes"}
BLOCKS = {
    "scale": "scale factor", "cross": "cross-axis sensitivity", "offset": "offset", "g": "g-sensitivity",
    "moving": "offset in motion minus offset at rest", "code": "offset of codes",
}  # fmt: skip
SHOWN_UNIT = {
    "gyro": ("deg/s", 1.0 / RADIAN_PER_DEGREE),
    "accel": ("mg", 1e3 / STANDARD_GRAVITY),
}  # unit, and number of units per SI unit
GRAVITY_SOURCES = {"standard": "standard gravity, assumed", "latitude and height": "by latitude and height"}
PITCH_NOTE = (
    f"95 % limit of the pitch error of a sit-to-stand with a lean of 45 deg, within a year of the calibration. The rest before "
    f"it lasts {REST_S:.0f} s, and its mean rate is subtracted."
)


def calibration_report(calibration: Calibration) -> Report:
    """Return the report of a calibration: its suitability, its parameters and their uncertainty."""
    triads = triads_of(calibration)
    return Report(
        title=f"Calibration of {calibration.device or 'a device'}",
        answer=answer_sentence(calibration),
        tables=[_pitch(calibration), _uncertainty(calibration), _ranges(calibration.drift)],
        details=[_parameters(name, model) for name, model in triads.items()],
        notes=[*_origin(calibration), *_parts(calibration)],
        findings=calibration.verdict.findings,
        judged=True,
        figures=[lambda: draw_calibration(calibration)],
        data=calibration_json(calibration),
    )


def triads_of(calibration: Calibration) -> dict[str, TriadModel]:
    """Return the calibrated triads by their names, accelerometers first."""
    models = {name: getattr(calibration, name) for name in NAMES}
    return {name: model for name, model in models.items() if model is not None}


def _pitch(calibration: Calibration) -> Table:
    """Return the limits of the pitch after a rest, away from the temperature of the calibration, and without a rest."""
    within, note = f"{WITHIN_K:.0f} K", PITCH_NOTE
    cases = [
        ("after a rest", True, 0.0),
        (f"after a rest, {within} warmer", True, WITHIN_K),
        ("without a rest", False, 0.0),
    ]
    if not math.isfinite(calibration.reference_temp_c):
        cases = [
            (f"after a rest, within {within}", True, WITHIN_K),
            (f"without a rest, within {within}", False, WITHIN_K),
        ]
        note += f" The temperature of the calibration was not recorded. The limits apply up to {within} from it."
    rows = list[dict[str, Cell]]()
    for name, rested, away_k in cases if calibration.gyro is not None else ():
        limits = pitch_limits(calibration, rested=rested, away_k=away_k)
        if limits is not None:
            cells = zip(TASK_S, (limits / RADIAN_PER_DEGREE).tolist(), strict=True)
            rows.append({"recording": name} | {f"after {time_s:.0f} s (deg)": limit for time_s, limit in cells})
    return Table.of("Pitch of a sit-to-stand", rows, form=".2f", note=note)


def _uncertainty(calibration: Calibration) -> Table:
    """Return the largest expanded uncertainty of each kind of parameter."""
    rows = list[tuple[Cell, ...]]()
    for name, model in triads_of(calibration).items():
        table, units = expand(model, gravity_uncertainty(calibration, name)), budget_units(name, model)
        for block in ("offset", "scale", "cross"):
            factor, unit = units[block]
            expanded = np.abs(factor * table.expanded[table.of_block(block)])
            largest = float(expanded.max(initial=0.0))
            rows.append((f"{NAMES[name]}: {BLOCKS[block]}", largest if largest > 0.0 else None, unit))
    note = "The largest of the axes, 95 %, at the temperature of the calibration. A dash means not calibrated or not known."
    return Table(title="Expanded uncertainty", columns=("parameter", "U", "unit"), rows=rows, form=".2g", note=note)


def budget_units(name: str, model: TriadModel) -> dict[str, tuple[float, str]]:
    """Return, for each kind of parameter, the factor from the unit of the triad to the unit of the budget, and the latter."""
    scale, (unit, factor) = float(np.diag(model.matrix).mean()), SHOWN_UNIT[name]
    percent, offset = (100.0 / scale, "%"), (abs(scale) * factor, unit)
    return {
        "scale": percent, "cross": percent, "offset": offset, "code": offset, "moving": (factor, unit),
        "g": (factor * STANDARD_GRAVITY, f"{unit} per g"),
    }  # fmt: skip


def _parameters(name: str, model: TriadModel) -> Table:
    """Return matrix, offset and other fitted parameters of a triad, each with its standard uncertainty."""
    low, high = model.valid_range
    rows: list[tuple[Cell, ...]] = [
        (parameter, Estimate(value, sigma) if sigma > 0.0 else value, parameter_unit(parameter, model))
        for parameter, value, sigma in zip(
            model.parameters, model.values.tolist(), model.standard_uncertainty, strict=True
        )
    ]
    rows += [
        (f"scale factor {axis}", value, f"{model.unit_in} per {model.unit_out}")
        for axis, value in zip(AXES, model.scale_factor.tolist(), strict=True)
    ]
    note = (
        f"corrected = m (raw - offset), with standard uncertainties. Method {model.method}: {model.count} equations, residual "
        f"{model.rms_residual:.3g} {model.unit_out} rms, rank {model.rank}, condition {model.condition:.3g}. It is valid "
        f"from {low:.3g} to {high:.3g} {model.unit_out}."
    )
    title = f"{NAMES.get(name, name).capitalize()}: parameters"
    return Table(title=title, columns=("parameter", "value", "unit"), rows=rows, form=".6g", note=note)


def parameter_unit(parameter: str, model: TriadModel) -> str:
    """Return the unit of a parameter of a triad."""
    units = {"m": f"{model.unit_out} per {model.unit_in}", "g": f"{model.unit_out} per m/s2", "moving": model.unit_out}
    return units.get(parameter.partition("_")[0], model.unit_in)


def _origin(calibration: Calibration) -> Iterator[str]:
    """Yield the temperature and gravity of a calibration, the phases that it used, and the steps of the codes."""
    settings = dict(calibration.provenance.settings)
    source = settings.get("gravity", "stated")
    where = f" at {calibration.reference_temp_c:.1f} degC" if math.isfinite(calibration.reference_temp_c) else ""
    methods = " and ".join(f"{NAMES[name]} by {model.method}" for name, model in triads_of(calibration).items())
    methods = methods[:1].upper() + methods[1:]
    yield f"{methods}{where}. Gravity {calibration.gravity_m_s2:.5f} m/s2 ({GRAVITY_SOURCES.get(source, source)})."
    if "stills" in settings:
        yield f"Still phases: {settings['stills']}. Faces: {settings['faces']}. Turns: {settings['turns']}."
    for triad in calibration.triads if calibration.adc is not None else ():
        if triad.lsb is not None and triad.model is not None:
            steps = ", ".join(f"{step:.6g}" for step in triad.lsb)
            how = triad.rounding.replace("_", " ")
            yield f"Codes of the {NAMES[triad.sensor]}: step {steps} {triad.model.unit_in}, rounded {how}."


def _parts(calibration: Calibration) -> Iterator[str]:
    """Yield the magnetometer, the mounting, and the effects other than temperature that the tables contain."""
    if (mag := calibration.magnetometer) is not None:
        offset = ", ".join(
            map(str, map(Estimate, mag.model.offset.tolist(), mag.model.standard_uncertainty[9:12].tolist()))
        )
        lag = Estimate(1e3 * mag.lag_s, 1e3 * mag.lag_uncertainty_s)
        yield f"Magnetometer: in the axes of the gyroscopes, behind which it lags by {lag} ms. Its offset is {offset} uT."
    if calibration.mounting is not None:
        yield f"Mounting: {statement_of(calibration.mounting)}"
    drift = calibration.drift
    if drift is not None and drift.static is not None and drift.static.warm_up is not None:
        yield f"The offset after power-on is stored for {drift.static.warm_up.power_on_s[-1]:.0f} s."
    if drift is not None and drift.lag_s > 0.0:
        yield f"The thermometer lags by {drift.lag_s:.2f} s."


def _ranges(drift: DriftTables | None) -> Table:
    """Return the temperatures of each table."""
    parts = list[tuple[str, FloatArray, int, BoolArray | None]]()
    for part, table in () if drift is None else (("offset", drift.static), ("matrix", drift.scale)):
        for name in ("gyro", "accel"):
            if table is not None and (values := getattr(table, f"{name}_{part}")) is not None:
                parts.append(
                    (f"{part} of the {name}", table.temp_c, len(values), getattr(table, f"{name}_extrapolated"))
                )
    if drift is not None and (dynamic := drift.dynamic) is not None:
        low, high = dynamic.turn_rate[[0, -1]] / RADIAN_PER_DEGREE
        part = f"error of the gyro over {low:.0f} to {high:.0f} deg/s"
        parts.append((part, dynamic.temp_c, dynamic.error.size // 3, dynamic.extrapolated))
    rows: list[dict[str, Cell]] = [
        {
            "table": part,
            "from (degC)": float(temp_c[0]),
            "to (degC)": float(temp_c[-1]),
            "nodes": nodes,
            "extrapolated": 0 if far is None else int(far.sum()),
        }
        for part, temp_c, nodes, far in parts
    ]
    return Table.of("Tables over temperature", rows, form=".2f")


# ---- figures


def draw_calibration(calibration: Calibration) -> "Figure":
    """Draw the departures of each matrix from the ideal, and the offsets. Bars are expanded uncertainties. The ideal matrix has no
    cross-axis terms and the gain of the unit. For counts or volts, it has the mean gain.
    """
    triads = {name: model for name in ("gyro", "accel") if (model := triads_of(calibration).get(name)) is not None}
    if not triads:
        raise InputError("plot: expected a calibrated gyroscope or accelerometer, got neither. Calibrate first.")
    rows = dict[str, tuple[Sequence[str], FloatArray, list[float]]]()
    elements = [row + column for row in AXES for column in AXES]
    for name, triad in triads.items():
        table = expand(triad)
        expanded = dict(zip(table.names, table.expanded, strict=True))
        gain, ideal = float(triad.scale_factor.mean()), "mean scale"
        if is_physical(triad.unit_in):
            gain, ideal = 1.0 / si_factor(triad.unit_in, "rate" if name == "gyro" else "accel"), "unit"
        bars = [100.0 * gain * expanded.get(f"m_{element}", 0.0) for element in elements]
        departures = 100.0 * (gain * triad.matrix - np.eye(3)).ravel()
        rows[f"{name} matrix\nminus {ideal} (%)"] = elements, departures, bars
        bars = [expanded.get(f"offset_{axis}", 0.0) for axis in AXES]
        rows[f"{name} offset\n({triad.unit_in})"] = AXES, triad.offset, bars
    title = "Matrix as departures from ideal, and offsets"
    figure, panels = figures.new_figure(*rows, title=title, height=1.6, sharex=False)
    style: Any = {"fmt": "o", "color": figures.DEVICE, "capsize": 3.0, "markersize": 4.0, "label": "estimate, 95 %"}
    for axes, (names, values, bars) in zip(panels, rows.values(), strict=True):
        axes.errorbar(names, values, yerr=bars, **style)
        axes.margins(0.3 if names is AXES else 0.05)
    for axes in panels[::2]:
        axes.axhline(0.0, color=figures.OPTICS, linewidth=0.6)
    figures.legend_above(panels[0])
    return figure
