"""Pictures of thermal fits: offset, scale and dynamic drift over temperature.

Warming is red and cooling blue. Ranges without data are hatched.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from undrift.arrays import runs
from undrift.commands.drift import TriadSummary, shown_unit, summarise
from undrift.errors import InputError
from undrift.model import AXES
from undrift.report import figures
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from undrift.arrays import BoolArray, FloatArray
    from undrift.drift.fit import DriftFit
    from undrift.drift.rates import ScaleFit
    from undrift.model import DynamicDrift

# ---- pictures

MOST_POINTS = 3000  # blocks drawn
_MANY = 300  # of them: small marks
NORMAL_95 = 1.96
_CURVES = 5  # temperatures of the dynamic drift that are drawn
_WARM, _COOL = "#c23b3b", "#2b62b3"


def draw_offsets(summary: TriadSummary) -> "Figure":
    """Draw offset over temperature: blocks while warming and cooling, table with its nodes and 95 % band, extrapolated
    ranges.
    """
    figure, panels = figures.new_figure(3, height=1.7, columns=2)
    unit, factor = shown_unit(summary.unit)
    margin = 0.02 * float(np.ptp(summary.temp_c))
    for k, axis in enumerate(AXES):
        for axes, level in zip(panels[2 * k : 2 * k + 2], (summary.departure[:, k], np.zeros(1)), strict=True):
            _draw_level(axes, summary, k, factor, np.broadcast_to(level * factor, summary.temp_c.shape))
            axes.set_xlim(float(summary.temp_c[0]) - margin, float(summary.temp_c[-1]) + margin)
        panels[2 * k].set_ylabel(f"{axis} ({unit})")
    for axes in panels[-2:]:
        axes.set_xlabel("temperature (degC)")
    panels[0].set_title("offset minus the constant offset", loc="left", fontsize=10)
    second = "offset minus the table" if summary.fit else "uncertainty of the table"
    panels[1].set_title(second, loc="left", fontsize=10)
    if summary.fit is None:
        figures.entitle(figure, "All poses together: a pose has no single offset")
    figures.legend_outside(figure, *panels[1].get_legend_handles_labels())
    return figure


def draw_drift(fit: "DriftFit") -> "Figure":
    """Draw the offsets over temperature, of the gyroscopes where they were fitted."""
    summary = summarise(fit, "gyro") or summarise(fit, "accel")
    if summary is None:
        raise InputError("plot: expected offsets over temperature, got none. Fit a static table first.")
    return draw_offsets(summary)


def _draw_blocks(axes: "Axes", summary: TriadSummary, k: int, factor: float, value: "FloatArray") -> "FloatArray":
    """Draw the blocks about a level and return where they lie."""
    if summary.fit is None:
        return np.zeros(0)
    step = max(1, len(summary.block_cooling) // MOST_POINTS)
    offsets, state = summary.fit.offsets, summary.block_cooling[::step]
    temp = offsets.blocks.temp_c[::step]
    reading = (offsets.value - summary.fit.gravity - summary.constant)[::step, k] * summary.factor[k] * factor
    table = np.interp(temp, summary.temp_c, summary.departure[:, k] * factor)
    departure: FloatArray = reading - table + np.interp(temp, summary.temp_c, value)
    marks = (
        (state < 0.0, "^", _WARM, "warming"),
        (state > 0.0, "v", _COOL, "cooling"),
        (state == 0.0, "o", figures.LIMIT, "direction not known"),
    )
    many = len(temp) > _MANY
    style: Any = {"linewidths": 0.0, "s": 9.0 if many else 14.0, "alpha": 0.4 if many else 0.75}
    for which, mark, colour, name in marks:
        if which.any():
            axes.scatter(temp[which], departure[which], marker=mark, color=colour, label=name, **style)
    return departure


def _draw_level(axes: "Axes", summary: TriadSummary, k: int, factor: float, value: "FloatArray") -> None:
    """Draw blocks and table about a level. They fill the panel. A band that is wide outside the data leaves the panel."""
    temp, doubt, near = summary.temp_c, NORMAL_95 * summary.uncertainty[:, k] * factor, ~summary.extrapolated
    _shade(axes, temp, summary.extrapolated)
    departures = _draw_blocks(axes, summary, k, factor, value)
    axes.fill_between(
        temp, value - doubt, value + doubt, color=figures.LIMIT, alpha=0.3, linewidth=0.0, label="95 %", zorder=2
    )
    axes.plot(temp, value, color="black", marker=".", markersize=2.5, linewidth=0.9, label="table", zorder=4)
    spread = np.quantile(departures, (0.002, 0.998)) if len(departures) else departures
    every = np.concatenate((value, (value - doubt)[near], (value + doubt)[near], spread))
    low, high = float(every.min()), float(every.max())
    margin = 0.08 * max(high - low, 1e-12)
    axes.set_ylim(low - margin, high + margin)


def _shade(axes: "Axes", temp_c: "FloatArray", extrapolated: "BoolArray") -> None:
    """Hatch the spans of nodes without data."""
    half = 0.5 * (temp_c[-1] - temp_c[0]) / (len(temp_c) - 1)
    hatched: Any = {"facecolor": "#f1f1ee", "edgecolor": "#cfcfca", "hatch": "///", "linewidth": 0.0, "zorder": 0}
    for k, (start, stop) in enumerate(runs(extrapolated)):
        low, high = max(temp_c[start] - half, temp_c[0]), min(temp_c[stop - 1] + half, temp_c[-1])
        axes.axvspan(float(low), float(high), label="extrapolated" if k == 0 else None, **hatched)


def draw_scale(fit: "ScaleFit") -> "Figure":
    """Draw scale factors over temperature: soaks with 95 % bars, table with its band, extrapolated ranges. Only axes
    that turned are drawn.
    """
    soaks, temp = fit.soaks, fit.drift.temp_c
    scales = soaks.forward.diagonal(axis1=1, axis2=2)
    axes_turned = [k for k in range(3) if np.isfinite(scales[:, k]).any()]
    figure, panels = figures.new_figure(len(axes_turned), height=1.8)
    for k, axes in zip(axes_turned, panels, strict=True):
        per_cent = 100.0 / np.nanmean(scales[:, k])
        value, doubt = fit.forward[:, k, k] * per_cent - 100.0, NORMAL_95 * fit.uncertainty[:, k, k] * abs(per_cent)
        _shade(axes, temp, np.asarray(fit.drift.gyro_extrapolated))
        if np.isfinite(doubt).all():
            axes.fill_between(
                temp, value - doubt, value + doubt, label="95 %", color=figures.LIMIT, alpha=0.3, linewidth=0.0
            )
        axes.plot(temp, value, color="black", marker=".", markersize=2.5, linewidth=0.9, label="table")
        bars = NORMAL_95 * np.sqrt(soaks.variance[:, k, k]) * abs(per_cent)
        style: Any = {"fmt": "o", "markersize": 3.5, "color": figures.DEVICE, "linewidth": 0.9}
        axes.errorbar(soaks.temp_c, scales[:, k] * per_cent - 100.0, yerr=bars, label="soaks, 95 %", **style)
        axes.set_ylabel(f"{AXES[k]} (%)")
        axes.set_xlim(float(temp[0]), float(temp[-1]))
    panels[-1].set_xlabel("temperature (degC)")
    panels[0].set_title("scale factor against its mean", loc="left", fontsize=10)
    figures.legend_outside(figure, *panels[0].get_legend_handles_labels())
    return figure


def draw_dynamic(drift: "DynamicDrift") -> "Figure":
    """Draw dynamic drift over the measured rate for a few temperatures. Only axes that turned are drawn."""
    axes_turned = [k for k in range(3) if drift.error[:, :, k].any()]
    figure, panels = figures.new_figure(len(axes_turned), height=1.7)
    chosen = np.unique(np.linspace(0, len(drift.temp_c) - 1, min(_CURVES, len(drift.temp_c))).round().astype(int))
    rate = drift.turn_rate / RADIAN_PER_DEGREE
    for k, axes in zip(axes_turned, panels, strict=True):
        axis = AXES[k]
        for place, row in enumerate(chosen):
            marker = "ov^sDP"[place % 6]
            share = place / max(len(chosen) - 1, 1)
            colour = (0.17 + 0.59 * share, 0.38 - 0.15 * share, 0.70 - 0.47 * share)
            error = drift.error[row, :, k] / RADIAN_PER_DEGREE
            axes.plot(rate, error, color=colour, linestyle=":", linewidth=1.0)
            near = error if drift.extrapolated is None else np.where(drift.extrapolated[row], np.nan, error)
            name = f"{drift.temp_c[row]:.0f} degC" if k == axes_turned[0] else None
            axes.plot(rate, near, color=colour, marker=marker, markersize=3.0, label=name)
        axes.set_ylabel(f"{axis}: correction (deg/s)")
    panels[-1].set_xlabel("measured rate (deg/s)")
    figures.legend_outside(figure, *panels[0].get_legend_handles_labels())
    return figure
