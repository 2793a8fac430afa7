"""``undrift noise``: noise coefficients of a device at rest."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.options import verb
from undrift.base.summary import Result, Summary, figure_of, table_section
from undrift.commands import Progress, reading, silent
from undrift.commands.answer import ANSWERED_S
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.expanded import COVERAGE
from undrift.commands.files import NamedRest, Opening, calibrated_part, named_columns
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

if TYPE_CHECKING:
    from undrift.calibration.noise import AxisNoise, NoiseFit
    from undrift.model import Calibration, Verdict
    from undrift.record import Record

_DEG_PER_H, _UG = 3600.0 / RADIAN_PER_DEGREE, 1e6 / STANDARD_GRAVITY  # of a rad/s, of a m/s2
# units of data sheets, by term and SI unit: key in JSON, unit, factor (60 sqrt(s) are 1 sqrt(h))
_WALK, _FLOOR, _RISE = "angle_random_walk", "bias_instability", "rate_random_walk"
DATA_SHEET = {
    (_WALK, "rad/s/sqrt(Hz)"): ("angle_random_walk_deg_per_sqrt_h", "deg/sqrt(h)", 60.0 / RADIAN_PER_DEGREE),
    (_FLOOR, "rad/s"): ("bias_instability_deg_per_h", "deg/h", _DEG_PER_H),
    (_RISE, "rad/s/sqrt(s)"): ("rate_random_walk_deg_per_h_per_sqrt_h", "deg/h/sqrt(h)", 60.0 * _DEG_PER_H),
    (_WALK, "m/s2/sqrt(Hz)"): ("velocity_random_walk_ug_per_sqrt_hz", "ug/sqrt(Hz)", _UG),
    (_FLOOR, "m/s2"): ("bias_instability_ug", "ug", _UG),
    (_RISE, "m/s2/sqrt(s)"): ("acceleration_random_walk_ug_per_sqrt_h", "ug/sqrt(h)", 60.0 * _UG),
}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Noise(Result):
    """Noise coefficients of a recording at rest."""

    record: Path
    fit: "NoiseFit"
    verdict: "Verdict"
    notes: tuple[str, ...]

    def summary(self) -> Summary:
        """Return the effect of the noise on an angle, and the coefficients of each axis with their intervals."""
        from undrift.calibration.noise import TERMS
        from undrift.io.store import verdict_json

        fit, coefficients, sections = self.fit, [], []
        physical = all(is_physical(getattr(fit, f"{one}_unit")) for one in TERMS if getattr(fit, one))
        after = {"angle_after_60_s_deg": [{"axis": axis.axis} | angle_after(axis) for axis in fit.gyro]}
        follows = ("--calibration", "calibration.json")
        for name, triad, axes in (("gyroscopes", "gyro", fit.gyro), ("accelerometers", "accel", fit.accel)):
            if not axes:
                continue
            names, walks = TERMS[triad], [axis.angle_random_walk for axis in axes]
            largest = max((walk.value for walk in walks if math.isfinite(walk.value)), default=math.nan)
            if math.isfinite(largest):
                coefficients.append(f"{names['angle_random_walk']} up to {largest:.2g} {walks[0].unit}")
            drawing = figure_of("figures:draw_allan_fit", fit, triad, names)
            cells: list[tuple[str, Callable[[AxisNoise], str]]] = [("axis", lambda axis: axis.axis)]
            for term, label in names.items():
                cells.append((f"{label} ({getattr(axes[0], term).unit})", partial(_cell, term)))
            if physical and triad == "gyro":
                cells.append(
                    (f"angle after {ANSWERED_S:.0f} s (deg)", lambda axis: f"{angle_after(axis)['angle']:.2g}")
                )
            title = f"{name}, in brackets the 95 % intervals"
            sections.append(
                table_section(title, axes, cells, text=tuple(_usual_units(axes, names)), pictures=(drawing,))
            )
        return Summary(
            title=f"Noise of {self.record.name}",
            answer=_meaning(fit)
            or f"{fit.duration_s:.4g} s at rest determine {' and '.join(coefficients) or 'no coefficient'}. A calibration "
            f"converts them to degrees.",
            data=_data(fit)
            | (after if physical else {})
            | {"verdict": verdict_json(self.verdict), "notes": self.notes},
            pictures=(figure_of("figures:draw_allan", fit),),
            sections=tuple(sections),
            verdict=self.verdict,
            notes=self.notes,
            next=() if physical else ("noise", self.record, *follows),
        )


@verb
def noise(
    record: Path,
    /,
    *,
    calibration: Path | None = None,
    named: NamedRest = NamedRest(),
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Noise:
    """Determine angle random walk, bias instability and rate random walk of a device at rest, with 95 % intervals.

    Parameters
    ----------
    record : Path
        Recording at rest, for hours rather than minutes.
    calibration : Path or None
        calibration.json: turns counts into rad/s and m/s2 first.
    """
    from undrift.calibration.noise import fit_noise
    from undrift.calibration.triads import check_force

    chosen = choose_calibration(calibration, (record,), opening)
    model = chosen.model
    with reading(progress, 0.3, record):
        readings = opening.like(model, chosen.path).read(record)
    with named_columns(record):
        readings, notes = (readings, ()) if model is None else _correct_readings(readings, model)
        if rest := named.still_in(readings):
            readings = readings.part(rest.start, rest.stop)
        check_force(readings)
    progress("fitting", 0.3)
    fit = fit_noise(readings)
    return Noise(record=record, fit=fit, verdict=fit.verdict, notes=(*chosen.notes, *notes))


def angle_after(axis: "AxisNoise") -> dict[str, float]:
    """Return U of an angle after 60 s, deg, by term. The offset is the mean of 60 s at rest just before.

    The two means differ by sqrt(2) sigma(tau) by definition of the Allan deviation, so U = k tau sqrt(2) sigma(tau).
    Terms that the recording does not determine count with their upper limit.
    """
    from undrift.calibration.noise import FLICKER

    tau, uncertainty = ANSWERED_S, dict[str, float]()
    for term, shape in ((_WALK, 1.0 / tau), (_FLOOR, FLICKER), (_RISE, tau / 3.0)):
        coefficient = getattr(axis, term)
        size = coefficient.interval[1] if math.isnan(coefficient.value) else coefficient.value
        uncertainty[term] = COVERAGE * tau * math.sqrt(2.0 * shape) * size / RADIAN_PER_DEGREE
    return uncertainty | {"angle": math.hypot(*uncertainty.values())}


def _meaning(fit: "NoiseFit") -> str:
    """Return the effect of white noise and instability on an angle, at 95 % on the worst axis, or "" for counts or
    volts.
    """
    parts = []
    if fit.gyro and is_physical(fit.gyro_unit):
        axis = max(fit.gyro, key=lambda axis_fit: angle_after(axis_fit)["angle"])
        angles = angle_after(axis)
        labels = ((_WALK, "white noise"), (_FLOOR, "bias instability"), (_RISE, "rate random walk"))
        terms = (
            f"{name} {'under ' * math.isnan(getattr(axis, key).value)}{angles[key]:.2g} deg" for key, name in labels
        )
        if not math.isfinite(angles["angle"]):
            return ""
        parts.append(
            f"After {ANSWERED_S:g} s the angle is good to {angles['angle']:.2g} deg (95 %, offset from {ANSWERED_S:g} s at rest "
            f"before): {', '.join(terms)}."
        )
    if fit.accel and is_physical(fit.accel_unit):
        walk = max(axis_fit.angle_random_walk.value for axis_fit in fit.accel)
        tilt_deg = COVERAGE * walk / STANDARD_GRAVITY / RADIAN_PER_DEGREE
        parts.append(f"White noise leaves an inclination from 1 s at rest good to {tilt_deg:.2g} deg.")
    return " ".join(parts)


def _correct_readings(readings: "Record", model: "Calibration") -> "tuple[Record, tuple[str, ...]]":
    """Return corrected readings and notes about them."""
    from undrift.correction.correct import correct_checked

    readings, left_out = calibrated_part(readings, model)
    result = correct_checked(readings, model)
    return result.record, (*left_out, *result.warnings, *result.notes)


def _data(fit: "NoiseFit") -> dict[str, object]:
    import numpy as np

    triads = {name: axes for name in ("gyro", "accel") if (axes := getattr(fit, name))}
    taus_s = min((axes[0].curve.taus_s for axes in triads.values()), key=len)  # one triad may have more gaps
    return {name: [_axis_json(axis) for axis in getattr(fit, name)] for name in ("gyro", "accel")} | {
        "adev": {
            name: np.column_stack([axis.curve.deviation[: len(taus_s)] for axis in axes])
            for name, axes in triads.items()
        },
        "units": {"gyro": fit.gyro_unit, "accel": fit.accel_unit},
        "taus_s": taus_s,
        "duration_s": fit.duration_s,
    }


def _axis_json(axis: "AxisNoise") -> dict[str, object]:
    names = ("angle_random_walk", "bias_instability", "rate_random_walk", "quantization")
    entry: dict[str, object] = {"axis": axis.axis}
    for name in names:
        entry[name] = {key: getattr(getattr(axis, name), key) for key in ("value", "interval", "unit", "reason")}
    for (term, unit), (key, _, factor) in DATA_SHEET.items():
        if getattr(axis, term).unit == unit:
            entry[key] = factor * getattr(axis, term).value
    return entry


def _cell(term: str, axis: "AxisNoise") -> str:
    """Return a coefficient with its interval, or its upper limit if it is not observable."""
    coefficient = getattr(axis, term)
    if math.isnan(coefficient.value):
        return f"not observable, under {coefficient.interval[1]:.2g}"
    return f"{coefficient.value:.3g} [{coefficient.interval[0]:.3g}, {coefficient.interval[1]:.3g}]"


def _usual_units(axes: tuple["AxisNoise", ...], names: dict[str, str]) -> "Iterator[str]":
    """Yield the coefficients in the units of data sheets, one line a term."""
    for term, name in names.items():
        _, unit, factor = DATA_SHEET.get((term, getattr(axes[0], term).unit), ("", "", 1.0))
        if unit:
            values = ((axis.axis, getattr(axis, term).value) for axis in axes)
            cells = (
                f"{axis} not observable" if math.isnan(value) else f"{axis} {factor * value:.3g}"
                for axis, value in values
            )
            yield f"{name} in {unit}: {', '.join(cells)}"
