"""Addresses of devices: ``kind:place?option=value&option=value`` -> an open source of readings.

    tcp://host:port        udp://:port        serial:///dev/ttyUSB0?baud=115200        lsl:name        ble:id?characteristic=uuid

The options are the fields of a StreamDescription, and ``description=FILE`` for a TOML file of them. Adding a kind is one file with
a function ``open_from(address)`` and one row in the table SOURCES.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast
from urllib.parse import parse_qsl

from undrift.errors import InputError
from undrift.live.description import StreamDescription, described, read_description

if TYPE_CHECKING:
    from undrift.live.source import Source

SOURCES = {
    "tcp": "undrift.live.tcp",
    "udp": "undrift.live.udp",
    "serial": "undrift.live.serial_port",
    "lsl": "undrift.live.lsl",
    "ble": "undrift.live.ble",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """An address taken apart.

    Parameters
    ----------
    kind : str
        A row of SOURCES.
    place : str
        What stands between the colon and the question mark.
    options : tuple of (str, str)
        What stands behind it.
    description : StreamDescription or None
        What the options change.
    """

    kind: str
    place: str
    options: tuple[tuple[str, str], ...] = ()
    description: StreamDescription | None = None

    def option(self, name: str, default: str) -> str:
        """Return an option that belongs to the kind of source.

        Parameters
        ----------
        name : str
            Its name.
        default : str
            Where it is not given.

        Returns
        -------
        str
            Its text.
        """
        return dict(self.options).get(name, default)

    def describe(self, *own: str) -> StreamDescription:
        """Return what is sent, by the file and the options.

        Parameters
        ----------
        *own : str
            Options that belong to the kind of source.

        Returns
        -------
        StreamDescription
            Checked.

        Raises
        ------
        InputError
            An option that is not one, or that does not fit.
        """
        file = self.option("description", "")
        base = read_description(file) if file else self.description
        return described(base, tuple(pair for pair in self.options if pair[0] not in (*own, "description")))


def parse_address(text: str, description: StreamDescription | None = None) -> Address:
    """Take an address apart.

    Parameters
    ----------
    text : str
        ``kind:place?option=value``.
    description : StreamDescription or None
        What the options change.

    Returns
    -------
    Address
        Its parts.

    Raises
    ------
    InputError
        Not an address.
    """
    kind, colon, rest = text.partition(":")
    if not colon or kind not in SOURCES:
        raise InputError(
            f"device: wanted one of {', '.join(f'{k}:...' for k in SOURCES)}, got '{text}'; say where it sends"
        )
    place, _, query = rest.partition("?")
    try:
        options = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise InputError(f"device: wanted options as name=value&name=value, got '{query}'; mend the address") from error
    return Address(kind=kind, place=place, options=tuple(options), description=description)


def source_at(text: str, description: StreamDescription | None = None) -> "Source":
    """Return the source of an address, not opened yet.

    Parameters
    ----------
    text : str
        ``kind:place?option=value``.
    description : StreamDescription or None
        What the options change.

    Returns
    -------
    Source
        ``open`` it, or hand it to a Recorder.

    Raises
    ------
    InputError
        Not an address, or options that do not describe a stream.
    """
    address = parse_address(text, description)
    opener = cast(Callable[[Address], "Source"], importlib.import_module(SOURCES[address.kind]).open_from)
    return opener(address)


def open_source(text: str, description: StreamDescription | None = None) -> "Source":
    """Open a source of readings.

    Parameters
    ----------
    text : str
        ``kind:place?option=value``.
    description : StreamDescription or None
        What the options change.

    Returns
    -------
    Source
        Connected; close it.

    Raises
    ------
    InputError
        Not an address, or options that do not describe a stream.
    LinkError
        Nobody is there.
    """
    source = source_at(text, description)
    source.open()
    return source
