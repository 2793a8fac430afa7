"""Targets of ``undrift export``: files that contain a calibration for firmware and other programs.

    c            C source of the correction in float and double
    arduino      a library folder with the same source and a sketch
    constants    matrix and offset at one temperature, as JSON and as a C header

Input: a ``Calibration``, for readings in the device's unit and frame b. Output: the text of the files, with numbers in rad/s and
m/s2, and the parts of the calibration that they do not contain. Open c first.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from undrift.model import NO_TABLES, Calibration


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Options of the targets.

    Parameters
    ----------
    prefix : str
        Targets c and constants (header): prefix of all names, in lower case.
    temp_c : float or None
        Target constants: temperature at which tables are evaluated, degC. The default is the reference temperature.
    """

    prefix: str = "undrift"
    temp_c: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """Files for another program.

    Parameters
    ----------
    files : mapping
        Text of each file, by its name next to the output. For a library, by its name in the new folder.
    not_carried : tuple of str
        Parts of the calibration that the files do not contain, one sentence each.
    notes : tuple of str
        Requirements for the user of the files.
    """

    files: Mapping[str, str]
    not_carried: tuple[str, ...]
    notes: tuple[str, ...] = ()


def not_in_firmware(calibration: Calibration) -> tuple[str, ...]:
    """Return the parts of a calibration that no target contains."""
    noise = () if calibration.noise is None else ("noise coefficients",)
    return "uncertainties, marks of extrapolation and the verdict", *noise


def not_in_constants(calibration: Calibration) -> tuple[str, ...]:
    """Return the parts of a calibration that constants at one temperature do not contain."""
    return *_beyond_constants(calibration), *not_in_firmware(calibration)


def conversions(calibration: Calibration) -> Iterator[str]:
    """Yield the gains and offsets of the map, which the exported files do not apply."""
    scales = {} if calibration.file_map is None else json.loads(calibration.file_map.text).get("scale", {})
    for name, scale in scales.items():
        if name != "temp":
            yield f"{name}: apply the scale of the map first, gain {scale['gain']} and offset {scale['offset']}"


def _beyond_constants(calibration: Calibration) -> Iterator[str]:
    drift = calibration.drift or NO_TABLES
    codes = [triad.model is not None and triad.model.code_offset is not None for triad in calibration.triads]
    truncated = [triad.lsb is not None and triad.rounding == "toward_zero" for triad in calibration.triads]
    if any(codes) or any(truncated):
        yield "half a code step for codes that are truncated toward zero"
    if calibration.gyro is not None and calibration.gyro.moving_offset is not None:
        yield "the change of the offset from motion to rest, so rates at rest are wrong by this change"
    if calibration.magnetometer is not None:
        yield "hard iron, soft iron, alignment and lag of the magnetometer"
    if drift.static is not None:
        yield "offsets over temperature (the static table)"
        if drift.static.warm_up is not None:
            yield "the extra offset after power-on"
    if drift.scale is not None:
        yield "gains and cross-axis terms over temperature (the scale table)"
    if drift.dynamic is not None:
        yield "error over rate and temperature (the dynamic table)"
    if drift.lag_s > 0.0:
        yield f"the thermometer's lag of {drift.lag_s:.3g} s (remove it from the temperature first)"
