"""DeviceModel: physical model of a device (two sensor chains, a board thermometer and a clock), and its file.

No matrix is inverted here, because the correction that undrift fits uses other equations. device.json contains an object of kind
"undrift.device", format 1. Its keys are the names of the fields, in SI units, and all of them are required. The value null means an
effect that is switched off. Infinite numbers are "inf" or "-inf", as JSON has no infinity. Numbers are exact to the last bit.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from undrift.base import codec
from undrift.files import write_whole
from undrift.sim.device.effects import Effect, Sampling, SensorChain, Thermometer


@codec.stored(kind="undrift.device", whole=True)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeviceModel(Effect):
    """Three gyroscopes, three accelerometers, a thermometer and a clock."""

    serial: str  # serial number
    gyro: SensorChain
    accel: SensorChain
    thermometer: Thermometer = field(default_factory=Thermometer)
    sampling: Sampling = field(default_factory=Sampling)
    reference_temp_c: float = 25.0  # temperature of the offsets, degC
    name: str = ""  # kind of device
    # reliability of its numbers: note, found, calc, known, known-low, assumed, or for a unit "drawn" or "fitted"
    source_tag: str = "assumed"


def write_device(device: DeviceModel, path: Path | str) -> None:
    """Write a device to a file, in one atomic step."""
    write_whole(Path(path), codec.json_text(device, str(path)))


def read_device(path: Path | str) -> DeviceModel:
    """Read a device file."""
    return codec.read_json(DeviceModel, path)


def device_json(device: DeviceModel) -> dict[str, Any]:
    """Return the plain values of a device for JSON."""
    return dict(codec.tree_of(device))


def device_from_json(content: object) -> DeviceModel:
    """Return a device from plain values."""
    return codec.value_of(DeviceModel, content, "device")
