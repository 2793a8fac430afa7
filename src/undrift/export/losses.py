"""What a target cannot carry, in sentences with figures: the parts of a calibration, and those that a target has a place for."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from undrift.model import Calibration, DriftTables, TriadModel
from undrift.units import RADIAN_PER_DEGREE, Quantity, si_factor

# ---- Exported: a text for another program, and what that program cannot do with the calibration.


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """A file for another program.

    Parameters
    ----------
    text : str
        The file.
    not_carried : tuple of str
        What the calibration holds and the file does not, one sentence each, with its size where it has one.
    notes : tuple of str
        What the reader of the file must know or do.
    more : tuple of str
        Files beside it.
    figures : mapping
        Sizes and error bounds, for ``--json``.
    """

    text: str
    not_carried: tuple[str, ...]
    notes: tuple[str, ...] = ()
    more: tuple[str, ...] = ()
    figures: Mapping[str, object] = field(default_factory=dict)


# ---- losses

Part = Literal[
    "rounding", "static", "scale", "dynamic", "g", "gain", "cross", "accel gain", "accel cross", "hysteresis", "warm-up",
    "lag", "uncertainty", "noise",
]  # fmt: skip


def losses(calibration: Calibration, carried: frozenset[Part]) -> tuple[str, ...]:
    """Return what a target that carries some parts leaves out of this calibration."""
    found: list[tuple[Part, str]] = [*_of_matrix(calibration), *_of_tables(calibration.drift or DriftTables())]
    adc = calibration.adc
    if adc is not None and "toward_zero" in (
        adc.gyro_rounding if adc.gyro_lsb is not None else "",
        adc.accel_rounding if adc.accel_lsb is not None else "",
    ):
        found.insert(0, ("rounding", "half a code step for codes cut off toward zero"))
    found.append(("uncertainty", "uncertainties, marks of extrapolation and the verdict"))
    if calibration.noise is not None:
        found.append(("noise", "noise coefficients"))
    return tuple(text for part, text in found if part not in carried)


def _of_matrix(calibration: Calibration) -> list[tuple[Part, str]]:
    found: list[tuple[Part, str]] = []
    triads: tuple[tuple[TriadModel | None, Quantity, Part, Part, str], ...] = (
        (calibration.gyro, "rate", "gain", "cross", "gyroscopes"),
        (calibration.accel, "accel", "accel gain", "accel cross", "accelerometers"),
    )
    for model, _, gain, cross, what in triads:
        if model is None:
            continue
        diagonal = np.abs(np.diag(model.matrix))
        found.append((gain, f"gains of the {what}"))
        off = model.matrix - np.diag(np.diag(model.matrix))
        least = float(diagonal.min())
        size = float(np.abs(off).max()) / least * 100.0 if least > 0.0 else float("inf")
        if size > 0.0:
            found.append((cross, f"cross-axis terms of the {what}, up to {size:.2g} %"))
    gyro = calibration.gyro
    if gyro is not None and gyro.g_sensitivity is not None:
        rate = np.abs(gyro.g_sensitivity).max() * si_factor(gyro.unit_out, "rate") / RADIAN_PER_DEGREE
        found.append(("g", f"g-sensitivity, up to {rate * si_factor('g', 'accel'):.2g} deg/s per g"))
    return found


def _of_tables(drift: DriftTables) -> list[tuple[Part, str]]:
    found: list[tuple[Part, str]] = []
    static, scale, dynamic = drift.static, drift.scale, drift.dynamic
    if static is not None:
        found.append(("static", "offsets over temperature (the static table)"))
        if static.gyro_hysteresis is not None:
            found.append(("hysteresis", "hysteresis: the table holds the middle of the loop"))
        if static.warm_up is not None:
            found.append(("warm-up", "the extra offset after power-on"))
    if scale is not None:
        found.append(("scale", "gains and cross-axis terms over temperature (the scale table)" + _change(drift)))
    if dynamic is not None:
        worst = float(np.abs(dynamic.error).max()) / RADIAN_PER_DEGREE
        found.append(("dynamic", f"error over rate and temperature (the dynamic table), up to {worst:.2g} deg/s"))
    if drift.lag_s > 0.0:
        found.append(
            ("lag", f"the thermometer's lag of {drift.lag_s:.3g} s: give the temperature with the lag removed")
        )
    return found


def _change(drift: DriftTables) -> str:
    if drift.scale is None or drift.scale.gyro_matrix is None:
        return ""
    diagonal = np.diagonal(drift.scale.gyro_matrix, axis1=1, axis2=2)
    middle = np.abs(diagonal.mean(axis=0))
    if not (middle > 0.0).all():
        return ""
    return f": the gyroscopes' gains change by {float((np.ptp(diagonal, axis=0) / middle).max()) * 100.0:.2g} %"
