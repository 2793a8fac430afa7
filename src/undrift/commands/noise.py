"""``undrift noise``: noise coefficients of a device at rest."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from undrift.calibration.noise import TERMS, AxisNoise, NoiseCoefficient, NoiseFit, fit_noise
from undrift.calibration.triads import check_force
from undrift.commands.files import NamedRest, Opening, Reader, named_columns
from undrift.report import Report, Table
from undrift.report.figures import draw_allan, draw_allan_fit
from undrift.report.report import Cell
from undrift.screen import progress, reading
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

AFTER_S = 60.0  # durations of the motion, after a rest of the same duration
COVERAGE = 2.0
DEG_PER_H, UG = 3600.0 / RADIAN_PER_DEGREE, 1e6 / STANDARD_GRAVITY  # factors from rad/s and from m/s2
DATA_SHEET = {  # unit of data sheets, and factor; 60 sqrt(s) are 1 sqrt(h)
    "rad/s/sqrt(Hz)": ("deg/sqrt(h)", 60.0 / RADIAN_PER_DEGREE),
    "rad/s": ("deg/h", DEG_PER_H),
    "rad/s/sqrt(s)": ("deg/h/sqrt(h)", 60.0 * DEG_PER_H),
    "m/s2/sqrt(Hz)": ("ug/sqrt(Hz)", UG),
    "m/s2": ("ug", UG),
    "m/s2/sqrt(s)": ("ug/sqrt(h)", 60.0 * UG),
}


def noise(
    record: Path,
    /,
    *,
    calibration: Path | None = None,
    named: NamedRest = NamedRest(),
    opening: Opening = Opening(),
) -> Report:
    """Determine angle random walk, bias instability and rate random walk of a device at rest, with 95 % intervals.

    Parameters
    ----------
    record : Path
        Recording at rest, for hours rather than minutes.
    calibration : Path or None
        calibration.json, which converts counts to rad/s and m/s2 first.
    """
    reader = Reader(opening, calibration, (record,))
    with reading(0.3, record):
        readings = reader.read(record)
    if reader.model is not None:
        readings = reader.corrected(readings, record)
    if rest := named.still_in(readings):
        readings = readings.part(rest.start, rest.stop)
    with named_columns(record):
        check_force(readings)
    progress("fitting", 0.3)
    fit = fit_noise(readings)
    triads = [name for name in ("gyro", "accel") if getattr(fit, name)]
    physical = all(is_physical(getattr(fit, f"{name}_unit")) for name in triads)
    tables = [_coefficients(fit, name) for name in triads]
    if fit.gyro and is_physical(fit.gyro_unit):
        tables.insert(0, _angles(fit.gyro))
    return Report(
        title=f"Noise of {record.name}",
        answer=_answer(fit),
        tables=tables,
        details=[_deviations(fit, name) for name in triads],
        notes=reader.notes,
        findings=[*fit.verdict.findings, *reader.findings],
        judged=True,
        figures=[lambda: draw_allan(fit)],
        data={name: list(map(_axis_data, getattr(fit, name))) for name in triads} | {"duration_s": fit.duration_s},
        next_command=[] if physical else ["noise", record, "--calibration", "calibration.json"],
    )


def _answer(fit: NoiseFit) -> str:
    """Return the effect of the noise on an angle, at 95 % on the worst axis."""
    parts = []
    if fit.gyro and is_physical(fit.gyro_unit):
        angle = max(_total(axis) for axis in fit.gyro)
        if math.isfinite(angle):
            parts.append(
                f"After {AFTER_S:g} s the angle is good to {angle:.2g} deg (95 %), if the offset is the mean of "
                f"{AFTER_S:g} s at rest just before."
            )
    if fit.accel and is_physical(fit.accel_unit):
        walk = max(axis.angle_random_walk.value for axis in fit.accel)
        tilt = COVERAGE * walk / STANDARD_GRAVITY / RADIAN_PER_DEGREE
        parts.append(f"An inclination from 1 s at rest is good to {tilt:.2g} deg (95 %).")
    if parts:
        return " ".join(parts)
    return f"{fit.duration_s:.4g} s at rest determine the noise in the unit of the readings. A calibration converts it to degrees."


def _angle(axis: AxisNoise) -> dict[str, float]:
    return {name: COVERAGE * u / RADIAN_PER_DEGREE for name, u in axis.angle_uncertainty(AFTER_S).items()}


def _total(axis: AxisNoise) -> float:
    return math.hypot(*_angle(axis).values())


def _angles(axes: Sequence[AxisNoise]) -> Table:
    terms = {"white noise (deg)": "angle_random_walk", "bias instability (deg)": "bias_instability"}
    terms |= {"rate random walk (deg)": "rate_random_walk"}
    rows = list[list[Cell]]()
    rows += ([axis.axis, *(_angle(axis)[name] for name in terms.values()), _total(axis)] for axis in axes)
    note = "Uncertainty (95 %). Noise that the recording does not determine counts with its upper limit."
    columns = ("axis", *terms, "all (deg)")
    return Table(title=f"Angle after {AFTER_S:.0f} s", columns=columns, rows=rows, form=".2g", note=note)


def _coefficients(fit: NoiseFit, triad: str) -> Table:
    """Return the coefficients of a triad in the units of data sheets."""
    rows = list[tuple[Cell, ...]]()
    for axis in getattr(fit, triad):
        for name, label in TERMS[triad].items():
            coefficient: NoiseCoefficient = getattr(axis, name)
            unit, factor = DATA_SHEET.get(coefficient.unit, (coefficient.unit, 1.0))
            low, high = (factor * end for end in coefficient.interval)
            rows.append((axis.axis, label, factor * coefficient.value, low, high, unit))
    return Table(
        title={"gyro": "Gyroscopes", "accel": "Accelerometers"}[triad],
        columns=("axis", "coefficient", "value", "95 % from", "to", "unit"),
        rows=rows,
        note="Without a value, the recording determines only the upper limit.",
        figure=lambda: draw_allan_fit(fit, triad, TERMS[triad]),
    )


def _deviations(fit: NoiseFit, triad: str) -> Table:
    axes: Sequence[AxisNoise] = getattr(fit, triad)
    unit = getattr(fit, f"{triad}_unit")
    rows = np.column_stack([axes[0].curve.taus_s, *(axis.curve.deviation for axis in axes)]).tolist()
    columns = ("averaging time (s)", *(f"{axis.axis} ({unit})" for axis in axes))
    return Table(title=f"Allan deviation, {triad}", columns=columns, rows=rows, form=".4g")


def _axis_data(axis: AxisNoise) -> dict[str, object]:
    """Return the coefficients of an axis in SI units, or in the unit of the readings."""
    keys = ("value", "interval", "unit", "reason")
    coefficients = {name: getattr(axis, name) for name in TERMS["gyro"]}
    return {"axis": axis.axis} | {name: {key: getattr(c, key) for key in keys} for name, c in coefficients.items()}
