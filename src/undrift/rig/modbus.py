"""A thermal chamber whose controller speaks Modbus, over TCP or a serial line; the registers of each model are in chambers.toml.

    modbus-tcp://host:502?model=watlow-f4&device=1        modbus-rtu:///dev/ttyUSB0?model=eurotherm&baud=9600&parity=N

A controller that sends in Fahrenheit: ``unit=degF``. Numbers of 32 bits come as two registers, in the order that the model's table
states; ``words=low-first`` or ``high-first`` for a controller that was set otherwise. pymodbus carries the messages.
"""

import importlib
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from undrift.base.codec import stored, toml_of, value_of
from undrift.errors import InputError, LinkError, RigFault
from undrift.plugins import split_address
from undrift.rig.chamber import CHAMBERS, GROUP, Chamber, ChamberSetup

OPTIONS = ("model", "device", "unit", "words", "baud", "parity", "stop_bits")
COLDEST_C, HOTTEST_C = -120.0, 400.0  # of any air; beyond, a reading is none
TINIEST = 1e-6  # a number of 32 bits that is nearer 0 has its words the wrong way round


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class Register:
    """One number of a controller."""

    at: int  # Address, from 0
    kind: Literal["int16", "float32"] = "int16"
    value: float = 0.0  # What is written there, or must be found


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """What a controller keeps where."""

    source: str  # Where the registers come from, and what was tried
    reading: Register  # Temperature of the air
    set_point: Register
    words: Literal["low-first", "high-first"] = "high-first"  # Of numbers of 32 bits
    decimals: int | None = None  # Register of the decimal places of whole numbers
    identity: Register | None = None  # What tells the model
    on: tuple[Register, ...] = ()  # Written before a set-point
    off: tuple[Register, ...] = ()  # Written at the end; none: the set-point goes to rest_c
    rest_c: float = 25.0


@cache
def models() -> dict[str, Model]:
    """Return the tables of all models."""
    tables, text = toml_of(Path(__file__).with_name("chambers.toml"))
    return {name: value_of(Model, table, name, text) for name, table in tables.items()}


class ModbusChamber(Chamber):
    """A chamber behind a controller that speaks Modbus."""

    def __init__(self, address: str, settings: ChamberSetup = ChamberSetup()) -> None:
        super().__init__(settings)
        kind, place, pairs = split_address(address, "chamber", CHAMBERS, GROUP, "name how it is connected")
        options = dict(pairs)
        if wrong := [name for name in options if name not in OPTIONS]:
            raise InputError(f"chamber: wanted options out of {', '.join(OPTIONS)}, got '{wrong[0]}'; mend the address")
        model = models().get(options.get("model", ""))
        if model is None:
            raise InputError(
                f"chamber: wanted model={' or '.join(models())}, got '{options.get('model', '')}'; name the controller"
            )
        self._name, self._model = place.removeprefix("//"), model
        self._device = _whole(options, "device", 1)
        self._fahrenheit = _one_of(options, "unit", ("degC", "degF")) == "degF"
        self._high_first = _one_of(options, "words", (model.words, "low-first", "high-first")) == "high-first"
        self._client = _client(kind, self._name, options, settings)
        try:
            self._reconnect()
            self._decimals = 0 if model.decimals is None else self._decimal_places(model.decimals)
            found = None if model.identity is None else self._get(model.identity)
            if model.identity is not None and found != model.identity.value:
                raise LinkError(
                    f"{self._name}: wanted {model.identity.value:g} in register {model.identity.at} of a {options['model']}, "
                    f"got {found:g}; check model, address and device"
                )
        except BaseException:
            self._client.close()
            raise

    def switch_off(self) -> None:
        """Switch its control off, or where the model has no register for that, set it to a temperature that does no harm."""
        model = self._model
        if not model.off:
            if abs(self._put_temp(model.rest_c) - model.rest_c) > 0.1:
                raise RigFault(
                    f"chamber: wanted it at {model.rest_c:g} degC, got another set-point; switch it off by hand"
                )
            return
        for register in model.off:
            self._put(register, register.value)
        if any(self._get(register) != register.value for register in model.off):
            raise RigFault("chamber: wanted its control off, got it on; switch the chamber off by hand")

    def _send(self, temp_c: float) -> float:
        for register in self._model.on:
            self._put(register, register.value)
        return self._put_temp(temp_c)

    def _measure(self) -> float:
        return self._temp(self._model.reading)

    def _put_temp(self, temp_c: float) -> float:
        sent = temp_c * 1.8 + 32.0 if self._fahrenheit else temp_c
        self._put(self._model.set_point, sent * 10.0**self._decimals)
        return self._temp(self._model.set_point)

    def _temp(self, register: Register) -> float:
        value = self._get(register) * 10.0**-self._decimals
        temp_c = (value - 32.0) / 1.8 if self._fahrenheit else value
        swapped = register.kind == "float32" and 0.0 < abs(value) < TINIEST
        if swapped or not COLDEST_C <= temp_c <= HOTTEST_C:
            raise LinkError(
                f"chamber: wanted a temperature in register {register.at}, got {value:.3g}; check its sensor, and the "
                "options words and unit of the address"
            )
        return temp_c

    def _decimal_places(self, register: int) -> int:
        places = self._get(Register(at=register))
        if places not in (0.0, 1.0, 2.0):
            raise LinkError(
                f"chamber: wanted 0 to 2 decimal places in register {register}, got {places:g}; check the model"
            )
        return int(places)

    def _get(self, register: Register) -> float:
        count = 2 if register.kind == "float32" else 1
        held = self._answer("read_holding_registers", register.at, count=count).registers
        if len(held) != count:
            raise LinkError(f"{self._name}: wanted {count} registers, got {len(held)}; check link and chamber")
        if count == 1:
            return float(struct.unpack(">h", struct.pack(">H", held[0]))[0])
        value = float(struct.unpack(">f", struct.pack(">HH", *(held if self._high_first else held[::-1])))[0])
        return value if math.isfinite(value) else math.inf

    def _put(self, register: Register, value: float) -> None:
        if register.kind == "float32":
            words = list(struct.unpack(">HH", struct.pack(">f", value)))
            self._answer("write_registers", register.at, words if self._high_first else words[::-1])
        else:
            self._answer("write_register", register.at, round(value) & 0xFFFF)

    def _answer(self, call: str, *words: Any, **options: Any) -> Any:
        """Return the answer to a message, or raise what went wrong in one line."""
        from pymodbus.exceptions import ModbusException

        try:
            answer = getattr(self._client, call)(*words, device_id=self._device, **options)
        except (ModbusException, OSError) as error:
            raise LinkError(
                f"{self._name}: wanted an answer of the chamber, got '{error}'; check power, cable, address and device number"
            ) from error
        if answer.isError():
            code = getattr(answer, "exception_code", "?")
            raise LinkError(
                f"{self._name}: wanted register {words[0]}, got the controller's refusal {code}; check the model and its set-up"
            )
        return answer

    def _reconnect(self) -> None:
        self._client.close()
        if not self._client.connect():
            raise LinkError(f"{self._name}: wanted a connection, got none; check power, cable and address")

    def _let_go(self) -> None:
        self._client.close()


def open_from(address: str, settings: ChamberSetup, ask: Callable[[str], str] | None) -> ModbusChamber:
    """Open what an address names; nobody is asked."""
    return ModbusChamber(address, settings)


def _client(kind: str, place: str, options: dict[str, str], settings: ChamberSetup) -> Any:
    try:
        made = importlib.import_module("pymodbus.client")
    except ImportError as error:
        raise LinkError("chamber: wanted the package pymodbus, got none; pip install undrift[modbus]") from error
    patience = {"timeout": settings.reply_timeout_s, "retries": 1}
    if kind == "modbus-tcp":
        host, _, port = place.rpartition(":")
        if not host or not port.isdigit():
            raise InputError(f"chamber: wanted modbus-tcp://host:502, got '{place}'; name host and port")
        return made.ModbusTcpClient(host, port=int(port), **patience)
    if not place:
        raise InputError("chamber: wanted modbus-rtu:///dev/name, got no name; name the port")
    line = {"baudrate": _whole(options, "baud", settings.baud), "stopbits": _whole(options, "stop_bits", 1)}
    return made.ModbusSerialClient(place, parity=_one_of(options, "parity", ("N", "E", "O")), **line, **patience)


def _whole(options: dict[str, str], name: str, usual: int) -> int:
    text = options.get(name, str(usual))
    if not text.isdecimal() or int(text) == 0:
        raise InputError(f"chamber: wanted a whole number for {name}, got '{text}'; mend the address")
    return int(text)


def _one_of(options: dict[str, str], name: str, known: tuple[str, ...]) -> str:
    """Return what was chosen of what is known; the first where nothing was."""
    if (text := options.get(name, known[0])) not in known:
        raise InputError(
            f"chamber: wanted {name} out of {', '.join(dict.fromkeys(known))}, got '{text}'; mend the address"
        )
    return text
