"""DeviceModel: physical model of a device (two sensor chains, a board thermometer and a clock), and its file.

No matrix is inverted here, because the correction that undrift fits uses other equations. device.json contains an object of kind
"undrift.device", format 1. Every key is the name of a field, followed by its unit unless the name contains it. Examples are
offset.constant_rad_s for a gyroscope and offset.constant_m_s2 for an accelerometer. null is an effect that is switched off.
Infinite numbers are "inf" or "-inf", as JSON has no infinity. Numbers are exact to the last bit. A missing or unknown key raises
an error.
"""

import json
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.base import codec
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.sim.device.effects import Effect, Sampling, SensorChain, Thermometer, quantity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeviceModel(Effect):
    """Three gyroscopes, three accelerometers, a thermometer and a clock.

    Parameters
    ----------
    serial : str
        Serial number.
    gyro, accel : SensorChain
        The sensors.
    thermometer : Thermometer
        The board thermometer.
    sampling : Sampling
        The clock.
    reference_temp_c : float
        Temperature of the offsets, degC.
    name : str
        Kind of device.
    source_tag : str
        Reliability of its numbers: note, found, calc, known, known-low, assumed, or "drawn" or "fitted" for a unit.
    """

    serial: str = quantity("")
    gyro: SensorChain = quantity("")
    accel: SensorChain = quantity("")
    thermometer: Thermometer = quantity("", None, Thermometer())
    sampling: Sampling = quantity("", None, Sampling())
    reference_temp_c: float = quantity("", None, 25.0)
    name: str = quantity("", None, "")
    source_tag: str = quantity("", None, "assumed")

    def without_noise(self) -> "DeviceModel":
        """Return the same device without noise, jitter, rounding and range limits."""
        return replace(
            self,
            gyro=self.gyro.without_noise(),
            accel=self.accel.without_noise(),
            thermometer=replace(self.thermometer, noise_c=0.0, step_c=0.0),
            sampling=replace(self.sampling, jitter_s=0.0),
        )


# ---- device.json

KIND = "undrift.device"
FORMAT = 1


def write_device(device: DeviceModel, path: Path | str) -> None:
    """Write a device to a file, in one atomic step."""
    write_whole(Path(path), json.dumps(device_json(device), indent=1, allow_nan=False) + "\n")


def read_device(path: Path | str) -> DeviceModel:
    """Read a device file."""
    return codec.read(DeviceModel, path)


def device_json(device: DeviceModel) -> dict[str, Any]:
    """Return a device as plain values for JSON."""
    return {"kind": KIND, "format": FORMAT, **_plain(device, {})}


def device_from_json(content: object) -> DeviceModel:
    """Return the device of plain values."""
    return codec.value_of(DeviceModel, content, "device")


def _device_of(content: dict[str, Any]) -> DeviceModel:
    """Return the device of the keys of a file."""
    keys = {key: value for key, value in content.items() if key not in ("kind", "format")}
    return typing.cast(DeviceModel, _value(keys, DeviceModel, {}, "device"))


def _units(owner: str, unit_out: str) -> dict[str, str]:
    """Return the values of {x} and {out} for a chain."""
    return {"x": "rad_s" if owner == "gyro" else "m_s2", "out": unit_out}


def _key(field: Any, units: Mapping[str, str]) -> str:
    unit = field.metadata.get("unit", "")
    return str(field.name) + ("_" + unit.format_map(units) if unit else "")


def _out_unit(chain: Mapping[str, Any]) -> str:
    """Return the unit before the converter: volts after an amplifier, otherwise the unit of the reading."""
    return "v" if chain["amplifier"] else str(chain["unit"]).replace("/", "_")


def _plain(value: Any, units: Mapping[str, str]) -> dict[str, Any]:
    if isinstance(value, SensorChain):
        units = {**units, "out": _out_unit({"amplifier": value.amplifier, "unit": value.unit})}
    tree = {}
    for f in fields(value):
        value_of_field = getattr(value, f.name)
        inner = _units(f.name, "") if f.name in ("gyro", "accel") else units
        tree[_key(f, units)] = (
            _plain(value_of_field, inner) if is_dataclass(value_of_field) else _written(value_of_field)
        )
    return tree


def _written(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, float) and math.isinf(value):
        return "inf" if value > 0.0 else "-inf"
    return value.item() if isinstance(value, np.generic) else value


def _value(content: object, kind: type, units: Mapping[str, str], where: str) -> Any:
    if not isinstance(content, dict):
        raise InputError(f"{where}: expected an object, got {type(content).__name__}. Correct the file.")
    if kind is SensorChain and {"amplifier", "unit"} <= content.keys():
        units = {**units, "out": _out_unit(content)}
    keys = {_key(f, units): f for f in fields(kind)}
    for key in (*keys, *content):
        if (key in keys) != (key in content):
            had = "it missing" if key in keys else "an unknown key"
            raise InputError(f"{where}.{key}: expected the keys of format {FORMAT}, got {had}. Correct the file.")
    hints = typing.get_type_hints(kind)
    return kind(**{f.name: _read(content[key], f, hints[f.name], units, f"{where}.{key}") for key, f in keys.items()})


def _read(content: object, field: Any, hint: Any, units: Mapping[str, str], where: str) -> Any:
    allowed = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    if content is None and type(None) in allowed:
        return None
    inner = next((a for a in allowed if isinstance(a, type) and is_dataclass(a)), None)
    if inner is not None:
        return _value(content, inner, _units(field.name, "") if field.name in ("gyro", "accel") else units, where)
    if field.metadata["shape"] is not None:
        return content if isinstance(content, list) else _refuse(content, "an array", where)
    if float in allowed:
        if content in ("inf", "-inf"):
            return float(str(content))
        number = isinstance(content, int | float) and not isinstance(content, bool) and math.isfinite(content)
        return float(typing.cast(float, content)) if number else _refuse(content, "a number", where)
    wanted = next((a for a in (bool, int) if a in allowed), str)
    return content if type(content) is wanted else _refuse(content, wanted.__name__, where)


def _refuse(content: object, expected: str, where: str) -> Any:
    raise InputError(f"{where}: expected {expected}, got {content!r}. Correct the file.")


# its keys depend on the unit of the sensor: they are read and written here, the file is the codec's
codec.stored(kind=KIND, format=FORMAT, form=dict[str, Any], read=_device_of, write=device_json)(DeviceModel)
