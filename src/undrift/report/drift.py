"""Report of a thermal fit: errors before and after, offset, scale and dynamic drift over temperature, and figures.

Warming is red and cooling blue. Ranges without data are hatched.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, runs
from undrift.drift.fit import DriftFit
from undrift.drift.offset import TriadDrift, cooling
from undrift.drift.rates import ScaleFit
from undrift.errors import InputError
from undrift.io.store import calibration_json
from undrift.model import AXES, DynamicDrift, Sensor
from undrift.report import figures
from undrift.report.report import Cell, Estimate, Report, Table
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, STANDARD_GRAVITY
from undrift.validation.table_worth import TableWorth, expected_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRIADS: tuple[tuple[Literal["Gyroscope", "Accelerometer"], Sensor], ...] = (
    ("Gyroscope", "gyro"),
    ("Accelerometer", "accel"),
)
SHOWN_UNIT = {
    "rad/s": ("deg/s", 1.0 / RADIAN_PER_DEGREE),
    "m/s2": ("mg", 1e3 / STANDARD_GRAVITY),
}  # unit, and number of units per SI unit


def drift_report(fit: DriftFit) -> Report:
    """Return the report of a thermal fit, with its benefit for a standard motion: the largest error before and after."""
    worth = _worth(fit)
    summaries = [(name, triad) for name, sensor in TRIADS if (triad := summarise(fit, sensor)) is not None]
    tables = [*_before_and_after(worth), *(_offsets(name, triad) for name, triad in summaries), *_scale(fit)]
    return Report(
        title=f"Thermal drift of {fit.calibration.device or 'device without a serial number'}",
        answer=_answer(fit, worth),
        tables=tables,
        details=[*_dynamic(fit)],
        findings=fit.verdict.findings,
        judged=True,
        figures=[lambda: draw_drift(fit)] if summaries else [],
        data=calibration_json(fit.calibration),
    )


def _answer(fit: DriftFit, worth: TableWorth | None) -> str:
    data = f"{len(fit.rests)} blocks of rest and {len(fit.steps)} dwells at known rates"
    if worth is None:
        return f"{data} do not determine a table of gyroscope offsets over temperature."
    return (
        f"In a lean {worth.motion}, the error is up to {worth.constant_deg:.2f} deg without tables and "
        f"{worth.tables_deg:.2f} deg with these tables. {worth.answer}."
    )


def _worth(fit: DriftFit) -> TableWorth | None:
    """Return the benefit of the tables, or None without a table of the gyroscopes."""
    finite = np.isfinite(fit.rests.gyro_variance).all(axis=1)
    variance = np.median(fit.rests.gyro_variance[finite], axis=0) if finite.any() else np.zeros(3)
    return expected_errors(fit.calibration, rest_variance=variance)


def _before_and_after(worth: TableWorth | None) -> Iterator[Table]:
    if worth is None:
        return
    rows = [("without tables", worth.constant_deg), ("with these tables, 95 %", worth.tables_deg)]
    if worth.turned:
        rows.insert(1, ("without tables, offset of a rest subtracted", worth.rest_deg))
        rows.append(("with these tables and that rest, 95 %", worth.both_deg))
    note = f"The motion is a lean {worth.motion}, about the worst axis."
    yield Table(
        title="Largest error of a lean", columns=("correction", "error (deg)"), rows=rows, form=".2f", note=note
    )


# ---- offsets over temperature


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadSummary:
    """Offset over temperature of three sensors, with n nodes and k blocks of rest, values in ``unit``."""

    unit: str  # rad/s or m/s2
    seen_c: tuple[float, float]  # lowest and highest temperature of the data, degC
    temp_c: FloatArray  # (n,), nodes, degC
    departure: FloatArray  # (n, 3), difference from the constant offset
    uncertainty: FloatArray  # (n, 3), standard uncertainty
    extrapolated: BoolArray  # (n,), True if there were no data near the node
    fit: TriadDrift | None  # blocks, or None if the table is from several poses
    factor: FloatArray  # (3,), conversion factor, unit per raw unit
    constant: FloatArray  # (3,), offset of the calibration, raw unit
    block_cooling: FloatArray  # (k,), 1 while cooling, -1 while warming


def summarise(fit: DriftFit, sensor: Sensor) -> TriadSummary | None:
    """Return the offsets of a triad over temperature, or None without a table."""
    triad = fit.calibration.triad(sensor)
    table, model = triad.offsets, triad.model
    if table is None or model is None or table.uncertainty is None or table.extrapolated is None:
        return None
    drift = fit.static.gyro if sensor == "gyro" else fit.static.accel
    covered_c = table.temp_c[~table.extrapolated] if not table.extrapolated.all() else table.temp_c
    factor = model.si_per_reading(triad.quantity)
    return TriadSummary(
        unit=SI_UNIT[triad.quantity],
        seen_c=(float(covered_c[0]), float(covered_c[-1])) if drift is None else drift.span_c,
        temp_c=table.temp_c,
        departure=(table.value - model.offset) * factor,
        uncertainty=table.uncertainty * factor,
        extrapolated=table.extrapolated,
        fit=drift,
        factor=factor,
        constant=model.offset,
        block_cooling=np.zeros(0) if drift is None else cooling(drift.offsets.blocks),
    )


def _offsets(name: str, triad: TriadSummary) -> Table:
    """Return a row for each axis: slope, uncertainty of the table, hysteresis, and differences between sessions."""
    (unit, factor), fit = SHOWN_UNIT[triad.unit], triad.fit
    near = np.flatnonzero(~triad.extrapolated | triad.extrapolated.all())
    usual = np.median(triad.uncertainty[near], axis=0) * factor
    raw, ends = triad.factor * factor, near[[0, -1]] if len(near) > 1 else np.array([0, -1])
    span_c = np.diff(triad.temp_c[ends])
    slope = np.diff(triad.departure[ends], axis=0)[0] / span_c * factor
    slope_uncertainty = np.linalg.norm(triad.uncertainty[ends], axis=0) / span_c * factor
    if fit is not None:
        slope, slope_uncertainty = fit.slope * raw, fit.slope_uncertainty * np.abs(raw)
    columns: dict[str, list[Cell]] = {
        "axis": [*AXES],
        f"slope ({unit} per degC)": [*map(Estimate, slope.tolist(), slope_uncertainty.tolist())],
        f"table u ({unit})": usual.tolist(),
    }
    if fit is not None and fit.hysteresis is not None and fit.hysteresis_uncertainty is not None:
        halves = (fit.hysteresis * raw).tolist(), (fit.hysteresis_uncertainty * np.abs(raw)).tolist()
        columns[f"hysteresis half-width ({unit})"] = [*map(Estimate, *halves)]
    if fit is not None and fit.turn_on is not None:
        columns[f"between sessions ({unit})"] = (np.sqrt(fit.turn_on.variance) * np.abs(raw)).tolist()
    (low, high), nodes, count = triad.seen_c, triad.temp_c, int(triad.extrapolated.sum())
    step = (nodes[-1] - nodes[0]) / (len(nodes) - 1)
    note = (
        f"Measured from {low:.1f} to {high:.1f} degC. {len(nodes)} nodes from {nodes[0]:g} to {nodes[-1]:g} degC by {step:g}"
        + (f", {count} of them extrapolated." if count else ".")
    )
    return Table(
        title=f"{name} offset over temperature",
        columns=[*columns],
        rows=[*zip(*columns.values(), strict=True)],
        form=".2g",
        note=note,
        figure=lambda: draw_offsets(triad),
    )


# ---- scale factor and dynamic drift


def _scale(fit: DriftFit) -> Iterator[Table]:
    """Yield the change of the scale factors over the nodes with data, relative to the reference temperature."""
    if (scale := fit.scale) is None:
        return
    temp_c, near = scale.drift.temp_c, np.flatnonzero(~np.asarray(scale.drift.gyro_extrapolated))
    forward, sigma = (table.diagonal(axis1=1, axis2=2) for table in (scale.forward, scale.uncertainty))
    reference = forward[np.abs(temp_c - fit.calibration.reference_temp_c).argmin()]
    percent = 100.0 / (reference * (temp_c[near[-1]] - temp_c[near[0]]))
    slope = np.where(np.isfinite(sigma[0]), (forward[near[-1]] - forward[near[0]]) * percent, np.nan)
    slope_uncertainty = np.hypot(sigma[near[0]], sigma[near[-1]]) * np.abs(percent)
    rows = [*zip(AXES, map(Estimate, slope.tolist(), slope_uncertainty.tolist()), strict=True)]
    title, columns = "Scale factor of the gyroscopes over temperature", ("axis", "slope (% per degC)")
    yield Table(title=title, columns=columns, rows=rows, figure=lambda: draw_scale(scale))


def _dynamic(fit: DriftFit) -> Iterator[Table]:
    dynamic = None if fit.calibration.drift is None else fit.calibration.drift.dynamic
    if dynamic is not None and dynamic.error.any():
        yield Table(title="Dynamic drift", figure=lambda: draw_dynamic(dynamic))


# ---- pictures

MOST_POINTS = 3000  # largest number of blocks that are drawn
_MANY = 300  # number of blocks above which marks are small
NORMAL_95 = 1.96
_CURVES = 5  # number of temperatures of the dynamic drift that are drawn
_COURSES = (  # direction of the temperature change: sign, mark, colour
    ("warming", -1.0, "^", "#c23b3b"),
    ("cooling", 1.0, "v", "#2b62b3"),
    ("direction not known", 0.0, "o", figures.LIMIT),
)


def draw_drift(fit: DriftFit) -> "Figure":
    """Draw the offsets over temperature, those of the gyroscopes if they were fitted."""
    summary = summarise(fit, "gyro") or summarise(fit, "accel")
    if summary is None:
        raise InputError("plot: expected offsets over temperature, got none. Fit a static table first.")
    return draw_offsets(summary)


def draw_offsets(summary: TriadSummary) -> "Figure":
    """Draw offset over temperature: blocks while warming and cooling, table with its nodes and 95 % band, extrapolated ranges."""
    unit, factor = SHOWN_UNIT[summary.unit]
    labels = [f"{axis} ({unit})" for axis in AXES]
    title = "" if summary.fit else "All poses together: a pose has no single offset"
    figure, panels = figures.new_figure(*labels, x="temperature (degC)", title=title, height=1.7, columns=2)
    for k in range(3):
        table, doubt = summary.departure[:, k] * factor, NORMAL_95 * summary.uncertainty[:, k] * factor
        for axes, value in zip(panels[2 * k : 2 * k + 2], (table, 0.0 * table), strict=True):
            _draw_table(axes, summary.temp_c, value, doubt, summary.extrapolated)
            blocks = _draw_blocks(axes, summary, k, factor, value - table)
            # a wide band outside the data may exceed the panel
            near = ~summary.extrapolated
            spread = np.quantile(blocks, (0.002, 0.998)) if len(blocks) else blocks
            seen = np.concatenate((value, (value - doubt)[near], (value + doubt)[near], spread))
            margin = 0.08 * max(float(np.ptp(seen)), 1e-12)
            axes.set_ylim(float(seen.min()) - margin, float(seen.max()) + margin)
    panels[0].set_title("offset minus the constant offset", loc="left", fontsize=10)
    second = "offset minus the table" if summary.fit else "uncertainty of the table"
    panels[1].set_title(second, loc="left", fontsize=10)
    figures.legend_outside(figure, figures.named(panels[1]))
    return figure


def _draw_table(
    axes: "Axes", temp_c: FloatArray, value: FloatArray, doubt: FloatArray, extrapolated: BoolArray
) -> None:
    """Draw a table over temperature (n,) with its 95 % band, and hatch the ranges without data."""
    half = 0.5 * (temp_c[-1] - temp_c[0]) / (len(temp_c) - 1)
    hatched: Any = {"facecolor": "#f1f1ee", "edgecolor": "#cfcfca", "hatch": "///", "linewidth": 0.0, "zorder": 0}
    for start, stop in runs(extrapolated):
        low, high = max(temp_c[start] - half, temp_c[0]), min(temp_c[stop - 1] + half, temp_c[-1])
        axes.axvspan(float(low), float(high), label="extrapolated", **hatched)
    if np.isfinite(doubt).all():
        band: Any = {"color": figures.LIMIT, "alpha": 0.3, "linewidth": 0.0, "zorder": 2}
        axes.fill_between(temp_c, value - doubt, value + doubt, label="95 %", **band)
    axes.plot(temp_c, value, color="black", marker=".", markersize=2.5, linewidth=0.9, label="table", zorder=4)
    axes.margins(x=0.02)


def _draw_blocks(axes: "Axes", summary: TriadSummary, k: int, factor: float, shift: FloatArray) -> FloatArray:
    """Draw the offsets of the blocks, shifted by values at the nodes, and return their positions."""
    if summary.fit is None:
        return np.zeros(0)
    few = slice(None, None, max(1, len(summary.block_cooling) // MOST_POINTS))
    offsets, state = summary.fit.offsets, summary.block_cooling[few]
    temp, many = offsets.blocks.temp_c[few], len(state) > _MANY
    departure = (offsets.value - summary.fit.gravity - summary.constant)[few, k] * summary.factor[k] * factor
    places: FloatArray = departure + np.interp(temp, summary.temp_c, shift)
    style: Any = {"linewidths": 0.0, "s": 9.0 if many else 14.0, "alpha": 0.4 if many else 0.75}
    for name, sign, mark, colour in _COURSES:
        if (which := np.sign(state) == sign).any():
            axes.scatter(temp[which], places[which], marker=mark, color=colour, label=name, **style)
    return places


def draw_scale(fit: ScaleFit) -> "Figure":
    """Draw scale factors over temperature: soaks with 95 % bars, table with its band, extrapolated ranges. Only axes with turns are
    drawn.
    """
    scales = fit.soaks.forward.diagonal(axis1=1, axis2=2)
    turned = [k for k in range(3) if np.isfinite(scales[:, k]).any()]
    labels = [f"{AXES[k]} (%)" for k in turned]
    figure, panels = figures.new_figure(*labels, x="temperature (degC)", height=1.8)
    for k, axes in zip(turned, panels, strict=True):
        percent = 100.0 / np.nanmean(scales[:, k])
        doubt = NORMAL_95 * fit.uncertainty[:, k, k] * abs(percent)
        value = fit.forward[:, k, k] * percent - 100.0
        _draw_table(axes, fit.drift.temp_c, value, doubt, np.asarray(fit.drift.gyro_extrapolated))
        bars = NORMAL_95 * np.sqrt(fit.soaks.variance[:, k, k]) * abs(percent)
        style: Any = {"fmt": "o", "markersize": 3.5, "color": figures.DEVICE, "linewidth": 0.9, "label": "soaks, 95 %"}
        axes.errorbar(fit.soaks.temp_c, scales[:, k] * percent - 100.0, yerr=bars, **style)
    panels[0].set_title("scale factor against its mean", loc="left", fontsize=10)
    figures.legend_outside(figure, figures.named(panels[0]))
    return figure


def draw_dynamic(drift: DynamicDrift) -> "Figure":
    """Draw dynamic drift over the measured rate for a few temperatures. Only axes with turns are drawn."""
    turned = [k for k in range(3) if drift.error[:, :, k].any()]
    labels = [f"{AXES[k]}: correction (deg/s)" for k in turned]
    figure, panels = figures.new_figure(*labels, x="measured rate (deg/s)", height=1.7)
    chosen = np.unique(np.linspace(0, len(drift.temp_c) - 1, min(_CURVES, len(drift.temp_c))).round().astype(int))
    rate = drift.turn_rate / RADIAN_PER_DEGREE
    for k, axes in zip(turned, panels, strict=True):
        for place, row in enumerate(chosen):
            share = place / max(len(chosen) - 1, 1)
            colour = (0.17 + 0.59 * share, 0.38 - 0.15 * share, 0.70 - 0.47 * share)
            error = drift.error[row, :, k] / RADIAN_PER_DEGREE
            near = error if drift.extrapolated is None else np.where(drift.extrapolated[row], np.nan, error)
            axes.plot(rate, error, color=colour, linestyle=":", linewidth=1.0)
            style: Any = {"color": colour, "marker": "ov^sDP"[place % 6], "markersize": 3.0}
            axes.plot(rate, near, label=f"{drift.temp_c[row]:.0f} degC", **style)
    figures.legend_outside(figure, figures.named(panels[0]))
    return figure
