"""DeviceModel: a device as what it physically is: two sensor chains, a board thermometer, a clock; and its file.

No matrix is inverted here; the correction that undrift fits is another set of equations. device.json holds one object, kind
"undrift.device", format 1. Every key is the field's name with its unit behind it, where the name does not carry it:
offset.constant_rad_s of a gyroscope, offset.constant_m_s2 of an accelerometer. null stands for an effect that is switched off;
infinity, which JSON does not know, is "inf" or "-inf". Numbers read back to the last bit; a key that is missing or unknown is
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
        Temperature at which the offsets are stated, degC.
    name : str
        Kind of device.
    source_tag : str
        How far its figures are to be trusted: note, found, calc, known, known-low, assumed; "drawn" or "fitted" for a unit.
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
        """Return the same device with no noise, no jitter, no rounding and no end to its range."""
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
    """Write a device to a file, whole or not at all."""
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
    """Return what {x} and {out} stand for in a chain."""
    return {"x": "rad_s" if owner == "gyro" else "m_s2", "out": unit_out}


def _key(field: Any, units: Mapping[str, str]) -> str:
    unit = field.metadata.get("unit", "")
    return str(field.name) + ("_" + unit.format_map(units) if unit else "")


def _out_unit(chain: Mapping[str, Any]) -> str:
    """Return the unit ahead of the converter: volts where an amplifier stands, else that of the reading."""
    return "v" if chain["amplifier"] else str(chain["unit"]).replace("/", "_")


def _plain(value: Any, units: Mapping[str, str]) -> dict[str, Any]:
    if isinstance(value, SensorChain):
        units = {**units, "out": _out_unit({"amplifier": value.amplifier, "unit": value.unit})}
    made = {}
    for f in fields(value):
        held = getattr(value, f.name)
        inner = _units(f.name, "") if f.name in ("gyro", "accel") else units
        made[_key(f, units)] = _plain(held, inner) if is_dataclass(held) else _written(held)
    return made


def _written(held: Any) -> Any:
    if isinstance(held, np.ndarray):
        return held.tolist()
    if isinstance(held, float) and math.isinf(held):
        return "inf" if held > 0.0 else "-inf"
    return held.item() if isinstance(held, np.generic) else held


def _value(content: object, kind: type, units: Mapping[str, str], where: str) -> Any:
    if not isinstance(content, dict):
        raise InputError(f"{where}: wanted an object, got {type(content).__name__}; repair the file")
    if kind is SensorChain and {"amplifier", "unit"} <= content.keys():
        units = {**units, "out": _out_unit(content)}
    keys = {_key(f, units): f for f in fields(kind)}
    for key in (*keys, *content):
        if (key in keys) != (key in content):
            had = "it missing" if key in keys else "an unknown key"
            raise InputError(f"{where}.{key}: wanted the keys of format {FORMAT}, got {had}; repair the file")
    hints = typing.get_type_hints(kind)
    return kind(**{f.name: _read(content[key], f, hints[f.name], units, f"{where}.{key}") for key, f in keys.items()})


def _read(held: object, field: Any, hint: Any, units: Mapping[str, str], where: str) -> Any:
    allowed = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    if held is None and type(None) in allowed:
        return None
    inner = next((a for a in allowed if isinstance(a, type) and is_dataclass(a)), None)
    if inner is not None:
        return _value(held, inner, _units(field.name, "") if field.name in ("gyro", "accel") else units, where)
    if field.metadata["shape"] is not None:
        return held if isinstance(held, list) else _refuse(held, "an array", where)
    if float in allowed:
        if held in ("inf", "-inf"):
            return float(str(held))
        number = isinstance(held, int | float) and not isinstance(held, bool) and math.isfinite(held)
        return float(typing.cast(float, held)) if number else _refuse(held, "a number", where)
    wanted = next((a for a in (bool, int) if a in allowed), str)
    return held if type(held) is wanted else _refuse(held, wanted.__name__, where)


def _refuse(held: object, wanted: str, where: str) -> Any:
    raise InputError(f"{where}: wanted {wanted}, got {held!r}; repair the file")


# its keys depend on the unit of the sensor: they are read and written here, the file is the codec's
codec.stored(kind=KIND, format=FORMAT, form=dict[str, Any], read=_device_of, write=device_json)(DeviceModel)
