"""One run at a time on a table, and a run that stops the table on every signal.

A table turns by finite moves only, and its controller ends each by itself: a program that is killed leaves the table at rest within
one dwell. So no second process watches a run.

**Lock.** A file in the system's folder for temporary files, which every user may read and lock. Its name is made from where the
table is, so the spelling of an address, its options and the user do not matter. The system frees the lock when its process ends,
however that happens. A run on another computer shows by a motor that is on, or by the motion: the controller is asked before
anything is set.
"""

import contextlib
import getpass
import hashlib
import ipaddress
import os
import re
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from undrift.base.clock import HOST
from undrift.errors import InputError, RigError, RigFault
from undrift.files import take_lock
from undrift.live.transports import host_and_port
from undrift.rig.galil import axis_state
from undrift.rig.grbl import GrblController
from undrift.rig.link import Link, link_settings
from undrift.rig.rig import RigSettings, open_rig, parse_address

# ---- Ctrl-C, Ctrl-Z and SIGTERM while a rig is driven: an exception first, and no disturbance while the table is stopped.

# as far as the system has them
NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP")


@contextmanager
def stopping_on_signals() -> Iterator[None]:
    """Turn SIGTERM, SIGHUP and SIGTSTP (Ctrl-Z) into the exception of Ctrl-C within the block, so that `finally` is reached."""
    stopped: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        stopped.append(number)
        if len(stopped) == 1:
            raise KeyboardInterrupt(f"stopped by {signal.Signals(number).name}")

    with _handled(interrupt):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let no signal disturb the block; one that came is handed at its end to whoever handled it before."""
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)

    with _handled(note):
        yield
    if came:
        outside = signal.getsignal(came[0])
        if callable(outside):
            outside(came[0], None)
        elif outside != signal.SIG_IGN:
            raise KeyboardInterrupt(f"stopped by {signal.Signals(came[0]).name}")


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, held in before.items():
            signal.signal(number, held)


# ---- Lock: one run for one table.

_FOLDER = "undrift-rigs"
LOCK_S = 0.3  # s, longest wait for a lock
END_S = 2.0  # s, longest wait for a run that was asked to end


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
            take_lock(handle, LOCK_S)
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


def stop_rig(address: str, settings: RigSettings = RigSettings()) -> None:
    """End the run that drives a table on this computer, then stop the table and switch its motor off."""
    if parse_address(address, settings)[0] != "manual" and os.name == "posix":
        _end_run(address)
    open_rig(address, settings).close()


def _end_run(address: str) -> None:
    """Send SIGTERM to the process that holds a table's lock, and wait until it has stopped the table and ended."""
    handle = _opened(place_of(address))
    try:
        holder = re.search(rb"\(process (\d+) of", os.pread(handle, 300, 0))
        if holder is None or HOST.until(lambda: _is_free(handle), LOCK_S):
            return
        with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended, or another user's
            os.kill(int(holder[1]), signal.SIGTERM)
        HOST.until(lambda: _is_free(handle), END_S)
    finally:
        os.close(handle)


def _is_free(handle: int) -> bool:
    """Return whether nobody holds the lock of an open file; it is held from then on until the file is closed."""
    try:
        take_lock(handle, 0.0)
    except OSError:
        return False
    return True


def check_free(address: str, settings: RigSettings = RigSettings(), *, motor_on: bool = False) -> None:
    """Refuse a table that somebody drives, or left so: it moves, or its motor is on where `motor_on` does not allow that.

    Nothing is set and nothing stops.
    """
    kind, url, settings = parse_address(address, settings)
    if kind == "galil":
        state = axis_state(url, settings)
        state = "" if motor_on and state == "its motor on" else state
    elif kind == "grbl" and url.startswith("tcp:"):  # opening a serial port resets the board
        state = _grbl_state(url, settings)
    else:
        return
    if state:
        raise RigFault(
            f"rig: wanted the table at {address} at rest with its motor off, got {state}: another program drives it, or left "
            f"it so; wait for that, or say undrift rig stop with `rig` '{address}'"
        )


def _grbl_state(url: str, settings: RigSettings) -> str:
    link = Link(url, link_settings(settings, 115_200))
    try:
        state = GrblController(link, settings.timing).status().state
    finally:
        with contextlib.suppress(RigError):
            link.close()
    return "" if state in ("Idle", "Sleep", "Alarm", "Check") else f"state {state}"
