"""One run for one table: a lock on this computer, and the controller is asked whether it is in use, before anything is set.

The lock is a file in the system's folder for temporary ones that any user may read and lock, named after where the table is: the
spelling of an address, its options and the user do not matter. The system frees it when its process ends, however that happens.
A run on another computer shows by the motor: on, or moving.
"""

import contextlib
import getpass
import hashlib
import ipaddress
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from undrift.errors import InputError, RigError, RigFault
from undrift.files import take_lock
from undrift.live.transports import host_and_port
from undrift.rig.galil import read_status
from undrift.rig.grbl import GrblController
from undrift.rig.link import Clock, Link, link_settings
from undrift.rig.rig import RigSettings, parse_address

_FOLDER = "undrift-rigs"


def place_of(address: str) -> str:
    """Return where a table is, alike for every spelling of its address: an IP address and port, or a device of this computer."""
    _, url, _ = parse_address(address)
    scheme, _, rest = url.partition("://")
    if scheme in ("tcp", "socket"):
        host, port = host_and_port("//" + rest)
        with contextlib.suppress(OSError):
            host = str(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][4][0])
            host = "loopback" if ipaddress.ip_address(host.partition("%")[0]).is_loopback else host
        return f"{host}:{port}"
    return os.path.realpath(rest or url)


@contextmanager
def one_run(address: str, what: str) -> Iterator[None]:
    """Hold the lock of a table; a second run is refused before anything is sent, with `what` this one is."""
    if parse_address(address)[0] == "manual" or os.name != "posix":  # on Windows the controller alone is asked
        yield
        return
    handle = _opened(place_of(address))
    try:
        try:
            take_lock(handle, 0.3)
        except OSError as error:
            holder = os.pread(handle, 300, 0).decode("utf-8", "replace").strip()
            raise RigFault(
                f"rig: wanted the table at {address} for this run alone, got it in use by {holder or 'another program'}; wait "
                "until that has ended"
            ) from error
        with contextlib.suppress(OSError):  # a lock that another user made may be locked but not written
            os.truncate(handle, 0)
            os.pwrite(handle, f"{what} (process {os.getpid()} of {getpass.getuser()})\n".encode(), 0)
        yield
    finally:
        os.close(handle)


def _opened(place: str) -> int:
    """Return the lock's file, made for all users."""
    folder = Path("/tmp" if os.name == "posix" else tempfile.gettempdir()) / _FOLDER
    path = folder / hashlib.sha256(place.encode()).hexdigest()[:24]
    try:
        if not folder.is_dir():
            folder.mkdir(exist_ok=True)
            folder.chmod(0o1777)
        for flags in (os.O_RDWR, os.O_RDONLY):  # the file of another user may be read and locked
            with contextlib.suppress(PermissionError, FileNotFoundError):
                return os.open(path, flags | os.O_NOFOLLOW)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise InputError(
            f"{path}: wanted to lock the table's name, got {error.strerror or error}; mend the rights of that folder"
        ) from error
    return handle


def check_free(address: str, *, motor_on: bool = False) -> None:
    """Refuse a table that somebody drives, or left so: it moves, or its motor is on where `motor_on` does not allow that.

    Nothing is set and nothing stops.
    """
    kind, url, settings = parse_address(address)
    if kind == "galil" and not url.startswith("gclib:"):
        found = read_status(address)
        state = "moving" if found.moving else "its motor on" if found.motor_on and not motor_on else ""
    elif kind == "grbl" and url.startswith("tcp:"):  # opening a serial port resets the board
        state = _grbl_state(url, settings)
    else:
        return
    if state:
        raise RigFault(
            f"rig: wanted the table at {address} at rest with its motor off, got {state}: another program drives it, or left "
            f"it so; wait for that, or say undrift rig stop --rig '{address}'"
        )


def _grbl_state(url: str, settings: RigSettings) -> str:
    link = Link(url, link_settings(settings, 115_200))
    try:
        state = GrblController(link, Clock(speed=settings.clock_speed)).status().state
    finally:
        with contextlib.suppress(RigError):
            link.close()
    return "" if state in ("Idle", "Sleep", "Alarm", "Check") else f"state {state}"
