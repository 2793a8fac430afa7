"""Parts of a calibration that a target does not contain, as sentences with figures."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from undrift.model import NO_TABLES, Calibration, DriftTables
from undrift.units import RADIAN_PER_DEGREE, si_factor


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """A file for another program.

    Parameters
    ----------
    text : str
        The file.
    not_carried : tuple of str
        Parts of the calibration that the file does not contain, one sentence each.
    notes : tuple of str
        Requirements for the user of the file.
    more : tuple of str
        Further files, written next to it.
    tree : mapping
        Files of a folder by their names in it, for a target that writes a folder.
    """

    text: str
    not_carried: tuple[str, ...]
    notes: tuple[str, ...] = ()
    more: tuple[str, ...] = ()
    tree: Mapping[str, str] = field(default_factory=dict)


Part = Literal[
    "rounding", "static", "scale", "dynamic", "g", "gain", "cross", "accel gain", "accel cross", "warm-up",
    "lag", "uncertainty", "noise", "moving", "magnetometer",
]  # fmt: skip


def losses(calibration: Calibration, carried: frozenset[Part]) -> tuple[str, ...]:
    """Return the parts of a calibration that are not in ``carried``, as one sentence each."""
    return tuple(text for name, text in _parts(calibration) if name not in carried)


def _parts(calibration: Calibration) -> Iterator[tuple[Part, str]]:
    fitted_codes = (triad.model is not None and triad.model.code_offset is not None for triad in calibration.triads)
    if any(triad.lsb is not None and triad.rounding == "toward_zero" for triad in calibration.triads) or any(
        fitted_codes
    ):
        yield "rounding", "half a code step for codes that are truncated toward zero"
    parts: tuple[tuple[Part, Part, str], ...] = (
        ("gain", "cross", "gyroscopes"),
        ("accel gain", "accel cross", "accelerometers"),
    )
    for triad, (gain, cross, name) in zip(calibration.triads, parts, strict=True):
        if triad.model is not None:
            yield gain, f"gains of the {name}"
            diagonal = np.diag(triad.model.matrix)
            largest = float(np.abs(triad.model.matrix - np.diag(diagonal)).max())
            if largest > 0.0:
                percent = 100.0 * largest / max(float(np.abs(diagonal).min()), np.finfo(float).tiny)
                yield cross, f"cross-axis terms of the {name}, up to {percent:.2g} %"
    gyro = calibration.gyro
    if gyro is not None:
        dps_per_unit = si_factor(gyro.unit_out, "rate") / RADIAN_PER_DEGREE
        if gyro.g_sensitivity is not None:
            largest = float(np.abs(gyro.g_sensitivity).max()) * dps_per_unit * si_factor("g", "accel")
            yield "g", f"g-sensitivity, up to {largest:.2g} deg/s per g"
        if gyro.moving_offset is not None:
            largest = float(np.abs(gyro.moving_offset).max()) * dps_per_unit
            yield (
                "moving",
                (
                    "the change of the offset from motion to rest (the offsets apply in motion, and rates at rest are wrong by "
                    f"up to {largest:.2g} deg/s)"
                ),
            )
    if calibration.magnetometer is not None:
        yield "magnetometer", "hard iron, soft iron, alignment and lag of the magnetometer"
    yield from _tables(calibration.drift or NO_TABLES)
    yield "uncertainty", "uncertainties, marks of extrapolation and the verdict"
    if calibration.noise is not None:
        yield "noise", "noise coefficients"


def _tables(drift: DriftTables) -> Iterator[tuple[Part, str]]:
    if drift.static is not None:
        yield "static", "offsets over temperature (the static table)"
        if drift.static.warm_up is not None:
            yield "warm-up", "the extra offset after power-on"
    if drift.scale is not None:
        text = "gains and cross-axis terms over temperature (the scale table)"
        if drift.scale.gyro_matrix is not None:
            diagonal = np.diagonal(drift.scale.gyro_matrix, axis1=1, axis2=2)
            change = 100.0 * float((np.ptp(diagonal, axis=0) / np.abs(diagonal.mean(axis=0))).max())
            text += f": the gains of the gyroscopes change by {change:.2g} %"
        yield "scale", text
    if drift.dynamic is not None:
        largest = float(np.abs(drift.dynamic.error).max()) / RADIAN_PER_DEGREE
        yield "dynamic", f"error over rate and temperature (the dynamic table), up to {largest:.2g} deg/s"
    if drift.lag_s > 0.0:
        yield "lag", f"the thermometer's lag of {drift.lag_s:.3g} s (remove it from the temperature first)"
