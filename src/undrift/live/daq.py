"""Analogue sensors on a data-acquisition board, through the package nidaqmx and the maker's driver.

    daq:Dev1/ai0:6?channels=gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,temp&rate=100&temp_sensor=lm335&range_v=0:5&terminal=diff

The board's own clock takes the samples, so their number is the device's counter. Readings stay in volts (unit v), which is what a
calibration wants: it finds the scale. ``gyro_sensor`` and ``accel_sensor`` name a sensor of sensors.toml instead and make deg/s and
g of its nominal scale; ``gyro_v_per_unit``, ``gyro_zero_v``, ``accel_v_per_unit``, ``accel_zero_v`` state another, behind an
amplifier for example: value = (volts - zero) / volts per unit. ``temp_sensor=lm335``: 10 mV/K from 0 K.
"""

import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, LinkError
from undrift.files import first_line
from undrift.live.decoder import COUNTER, StreamDescription
from undrift.live.transports import Address, ByteSource, Source, number_of, package_of
from undrift.units import ZERO_CELSIUS_K

TERMINALS = {"default": "DEFAULT", "rse": "RSE", "nrse": "NRSE", "diff": "DIFF", "pseudo_diff": "PSEUDO_DIFF"}
TRIADS = ("gyro", "accel")
OWN = (
    "terminal",
    "range_v",
    "temp_sensor",
    *(f"{triad}_{what}" for triad in TRIADS for what in ("sensor", "v_per_unit", "zero_v")),
)
BUFFER_S = 20.0  # what the board keeps while nobody reads
LOOK_S = 0.01
RATE_OFF = 1e-3  # of the rate that the board makes of the one that was asked for


@dataclass(frozen=True, slots=True)
class VoltScale:
    """How volts become a unit."""

    v_per_unit: float = 1.0
    zero_v: float = 0.0


@cache
def sensors() -> dict[str, dict[str, Any]]:
    """Return the sensors that are known by name."""
    return tomllib.loads((files("undrift.live") / "sensors.toml").read_text(encoding="utf-8"))


class DaqSource(ByteSource):
    """A board that samples voltages by its own clock."""

    way = "board"

    def __init__(
        self, name: str, description: StreamDescription, connect: Callable[[], Any], scale: tuple[VoltScale, ...]
    ) -> None:
        counted = replace(description, channels=(COUNTER, *description.channels), tick=0.0, counter_bits=0)
        super().__init__(name, counted, connect)
        self._scale = np.array([[each.v_per_unit, each.zero_v] for each in scale])
        self._next = 0

    def open(self) -> None:
        """Connect and begin to sample."""
        super().open()
        self._next = 0

    def _poll(self, wait_s: float) -> FloatArray:
        try:
            volts = self.port.receive(wait_s)
        except OSError as error:
            raise LinkError(f"{self.name}: wanted readings, got '{error}'; read more often, or reconnect") from error
        count = self._next + np.arange(len(volts))
        self._next += len(volts)
        return np.column_stack((count, (volts - self._scale[:, 1]) / self._scale[:, 0]))


class DaqTask:
    """A running task of the driver; its errors are OSErrors here."""

    def __init__(self, place: str, description: StreamDescription, low_v: float, high_v: float, terminal: str) -> None:
        self._daq = package_of("nidaqmx", "nidaqmx", "daq", "daq")
        constants = package_of("nidaqmx.constants", "nidaqmx", "daq", "daq")
        readers = package_of("nidaqmx.stream_readers", "nidaqmx", "daq", "daq")
        self._error = package_of("nidaqmx.errors", "nidaqmx", "daq", "daq").Error
        self._task: Any = None
        count = len(description.channels)
        try:
            self._task = self._daq.Task()
            self._task.ai_channels.add_ai_voltage_chan(
                place,
                terminal_config=constants.TerminalConfiguration[TERMINALS[terminal]],
                min_val=low_v,
                max_val=high_v,
            )
            if self._task.number_of_channels != count:
                raise LinkError(
                    f"daq: wanted {count} inputs for {count} channels, got {self._task.number_of_channels} in '{place}'; mend the "
                    "address"
                )
            self._task.timing.cfg_samp_clk_timing(
                description.rate,
                sample_mode=constants.AcquisitionType.CONTINUOUS,
                samps_per_chan=int(BUFFER_S * description.rate) + 1,
            )
            made = float(self._task.timing.samp_clk_rate)
            if abs(made / description.rate - 1.0) > RATE_OFF:
                raise InputError(
                    f"daq: wanted {description.rate:g} samples/s, got {made:g} as the nearest of the board; state rate={made:g}"
                )
            self._reader = readers.AnalogMultiChannelReader(self._task.in_stream)
            self._task.start()
        except self._error as error:
            self.close()
            raise OSError(first_line(error)) from error
        except BaseException:
            self.close()
            raise

    def receive(self, wait_s: float) -> FloatArray:
        """Return the samples that wait on the board, (N, K) V; none after a while without one."""
        last = time.monotonic() + wait_s
        try:
            while not (count := int(self._task.in_stream.avail_samp_per_chan)):
                if time.monotonic() >= last:
                    return np.empty((0, self._task.number_of_channels))
                time.sleep(LOOK_S)
            volts = np.empty((self._task.number_of_channels, count))
            self._reader.read_many_sample(volts, count, timeout=wait_s + LOOK_S)
        except self._error as error:
            raise OSError(first_line(error)) from error
        return np.ascontiguousarray(volts.T)

    def close(self) -> None:
        """Stop and let go of the board."""
        if self._task is not None:
            self._task.close()
            self._task = None


def daq_source(address: Address) -> Source:
    """Return a source that reads a board."""
    described = address.describe(*OWN)
    if COUNTER in described.channels:
        raise InputError(
            "daq: wanted the channels of the board, got 'count' among them; the samples are counted by themselves"
        )
    if not address.place:
        raise InputError("daq: wanted daq:Dev1/ai0:6?channels=..., got no input; name the board and its inputs")
    terminal = address.option("terminal", "default")
    if terminal not in TERMINALS:
        raise InputError(f"daq: wanted terminal out of {', '.join(TERMINALS)}, got '{terminal}'; mend the address")
    low_v, high_v = _range(address.option("range_v", "5"))
    scales, units = dict[str, VoltScale](), dict[str, str]()
    for triad, unit in zip(TRIADS, ("dps", "g"), strict=True):
        scale = _scale(address, triad)
        scales[triad] = scale or VoltScale()
        units[f"{triad}_unit"] = unit if scale else "v"
    temp = address.option("temp_sensor", "")
    if temp not in ("", "lm335"):
        raise InputError(f"daq: wanted temp_sensor=lm335, got '{temp}'; state temp_scale and temp_zero for another")
    if temp:
        described = replace(described, temp_scale=100.0, temp_zero=-ZERO_CELSIUS_K)
    elif "temp" in described.channels and described.temp_scale == 1.0:
        raise InputError(
            "daq: wanted the thermometer's scale, got none; state temp_sensor=lm335, or temp_scale and temp_zero"
        )
    described = replace(described, **units)  # type: ignore[arg-type]
    by_channel = tuple(scales.get(name.split("_")[0], VoltScale()) for name in described.channels)

    place = address.place
    return DaqSource(f"daq:{place}", described, lambda: DaqTask(place, described, low_v, high_v, terminal), by_channel)


def _scale(address: Address, triad: str) -> VoltScale | None:
    """Return the stated scale of a triad; None where it stays in volts."""
    name = address.option(f"{triad}_sensor", "")
    known = {key: held for key, held in sensors().items() if held["triad"] == triad}
    if name and name not in known:
        raise InputError(
            f"daq: wanted {triad}_sensor out of {', '.join(known)}, got '{name}'; or state {triad}_v_per_unit"
        )
    stated = {what: address.option(f"{triad}_{what}", "") for what in ("v_per_unit", "zero_v")}
    if not name and not any(stated.values()):
        return None
    if not name and not all(stated.values()):
        raise InputError(f"daq: wanted {triad}_v_per_unit and {triad}_zero_v, got one of them; state both")
    made = [_number(f"{triad}_{what}", text) if text else known[name][what] for what, text in stated.items()]
    if made[0] == 0.0:
        raise InputError(f"daq: wanted {triad}_v_per_unit other than 0, got 0; look into the data sheet")
    return VoltScale(*made)


def _range(text: str) -> tuple[float, float]:
    """Read 5 (either way) or 0:5, volts."""
    low, _, high = text.rpartition(":")
    top = _number("range_v", high)
    bottom = _number("range_v", low) if low else -top
    if not bottom < top:
        raise InputError(f"daq: wanted range_v as 5 or 0:5, the lower first, got '{text}'; mend the address")
    return bottom, top


def _number(name: str, text: str) -> float:
    if not np.isfinite(value := number_of(text)):
        raise InputError(f"daq: wanted a number for {name}, got '{text}'; mend the address")
    return value
