"""Addresses of rigs: ``kind:url?option=value&option=value`` -> an open Rig.

    galil:tcp://host:port?encoder_lines=10000     galil:serial:///dev/ttyUSB0?baud=19200     galil:gclib://host --direct
    grbl:serial:///dev/ttyUSB0?axis=A             grbl:tcp://host:port                       manual:

Adding a rig is one file with a function ``open_from(url, settings)`` and one row in the table RIGS.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import cast
from urllib.parse import parse_qsl

from undrift.errors import InputError
from undrift.rig.rig import Limits, Rig

RIGS = {
    "galil": "undrift.rig.galil.rig",
    "grbl": "undrift.rig.grbl.rig",
    "manual": "undrift.rig.manual",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """What an address does not say; an option of the same name in the address wins.

    Parameters
    ----------
    limits : Limits
        What the rig may be told; never an option, so that no address can widen it.
    encoder_lines : int
        Lines of a servo's encoder, 4 counts each.
    axis : str
        Letter of the axis; "" is the rig's usual one.
    speed_step : int
        Counts/s between two speeds of a Galil card: 1, or 2 on older ones.
    baud : int
        Bits per second of a serial port; 0 is the rig's usual.
    hardware_handshake : bool
        RTS/CTS of a serial port.
    reply_timeout_s : float
        Longest wait for an answer, s.
    clock_speed : float
        Table seconds per host second: 1 for hardware, an emulator's speed otherwise.
    ask : callable or None
        Shows a person a line and returns what they typed; a manual rig needs it.
    """

    limits: Limits = field(default_factory=Limits)
    encoder_lines: int = 10_000
    axis: str = ""
    speed_step: int = 1
    baud: int = 0
    hardware_handshake: bool = False
    reply_timeout_s: float = 2.0
    clock_speed: float = 1.0
    ask: Callable[[str], str] | None = None


Opener = Callable[[str, RigSettings], Rig]
OPTIONS: dict[str, Callable[[str], object]] = {
    "encoder_lines": int,
    "axis": str.upper,
    "speed_step": int,
    "baud": int,
    "hardware_handshake": lambda text: {"yes": True, "no": False}[text],
    "reply_timeout_s": float,
    "clock_speed": float,
}


def open_rig(address: str, settings: RigSettings = RigSettings()) -> Rig:
    """Open a rig; nothing moves.

    Parameters
    ----------
    address : str
        ``kind:url?option=value``.
    settings : RigSettings
        What the address does not say.

    Returns
    -------
    Rig
        Connected; close it.

    Raises
    ------
    InputError
        Not an address, or an option that no rig has.
    LinkError
        Nobody answers there.
    """
    kind, url, settings = parse_address(address, settings)
    opener = cast(Opener, importlib.import_module(RIGS[kind]).open_from)
    return opener(url, settings)


def parse_address(address: str, settings: RigSettings = RigSettings()) -> tuple[str, str, RigSettings]:
    """Take an address apart.

    Parameters
    ----------
    address : str
        ``kind:url?option=value``.
    settings : RigSettings
        What the options change.

    Returns
    -------
    kind : str
        A row of RIGS.
    url : str
        Where it is connected.
    settings : RigSettings
        With the options of the address.

    Raises
    ------
    InputError
        Not an address, or an option that no rig has.
    """
    kind, colon, rest = address.partition(":")
    if not colon or kind not in RIGS:
        raise InputError(
            f"rig: wanted one of {', '.join(f'{k}:...' for k in RIGS)}, got '{address}'; say which rig it is"
        )
    url, _, query = rest.partition("?")
    try:
        given = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise InputError(f"rig: wanted options as name=value&name=value, got '{query}'; mend the address") from error
    for name, text in given:
        settings = replace(settings, **{name: _option(name, text)})  # type: ignore[arg-type]
    return kind, url, settings


def _option(name: str, text: str) -> object:
    if name not in OPTIONS:
        raise InputError(f"rig: wanted options out of {', '.join(OPTIONS)}, got '{name}'; mend the address")
    try:
        return OPTIONS[name](text)
    except (ValueError, KeyError) as error:
        raise InputError(f"rig: wanted a value for {name}, got '{text}'; mend the address") from error
