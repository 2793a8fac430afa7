"""Allow one run per table, and stop the table on every signal.

A table turns with finite moves only, and its controller ends each move itself. If a program is killed, its table is at rest within
one dwell. Therefore no second process has to watch a run.

The lock is a file in the system's temporary folder, which every user may read and lock. Its name depends only on the port or host
of the table, not on the spelling of the address, its options or the user. The system releases the lock when its process ends,
however it ends. A run on another computer is detected when the table is opened: its motor is on or moving (RigSettings.accept).
"""

import contextlib
import getpass
import hashlib
import ipaddress
import os
import re
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from undrift.base.clock import HOST
from undrift.errors import InputError, RigFault
from undrift.files import take_lock
from undrift.live.transports import host_and_port
from undrift.rig.rig import RigSettings, open_rig, parse_address

# ---- Ctrl-C, Ctrl-Z and SIGTERM during a run: the first one raises an exception, later ones wait until the table has stopped.

# signals that are handled if the system has them
NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP")


@contextmanager
def stopping_on_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt for SIGTERM, SIGHUP and SIGTSTP (Ctrl-Z) within the block, so that `finally` is reached."""
    received: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) == 1:
            raise KeyboardInterrupt(f"stopped by {signal.Signals(number).name}")

    with _handled(interrupt):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay signals until the end of the block. The first signal then goes to the previous handler."""
    received: list[int] = []
    with _handled(lambda number, frame: received.append(number)):
        yield
    if received:
        signal.raise_signal(received[0])


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    heard = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]  # nohup ignores SIGHUP
    before = {number: signal.signal(number, handler) for number in heard}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


# ---- Lock: one run per table.

LOCK_S = 0.3  # longest wait for a lock, s
END_S = 2.0  # longest wait for a run to end after SIGTERM, s


def place_of(address: str) -> str:
    """Return the IP address and port, or the device path, of a table. The result is the same for every spelling of the address."""
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
    """Lock a table within the block. A second run raises RigFault before anything is sent, with the `what` of this run."""
    if not _has_lock(address):
        yield
        return
    with _lock_file(address) as handle:
        if not _is_locked(handle, LOCK_S):
            holder = os.pread(handle, 300, 0).decode("utf-8", "replace").strip()
            raise RigFault(
                f"rig: the table at {address} is in use by {holder or 'another program'}. Wait until that program has ended."
            )
        with contextlib.suppress(OSError):  # a file of another user can be locked but not written
            os.truncate(handle, 0)
            os.pwrite(handle, f"{what} (process {os.getpid()} of {getpass.getuser()})\n".encode(), 0)
        yield


def stop_rig(address: str, settings: RigSettings = RigSettings()) -> None:
    """End the run of this user that drives a table on this computer, then stop the table and switch its motor off."""
    if _has_lock(address):
        with _lock_file(address) as handle:
            holder = re.search(rb"\(process (\d+) of", os.pread(handle, 300, 0))
            if holder is not None and not _is_locked(handle, LOCK_S):
                with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended, or is another user's
                    os.kill(int(holder[1]), signal.SIGTERM)
                HOST.until(lambda: _is_locked(handle, 0.0), END_S)
    open_rig(address, settings).close()


def _has_lock(address: str) -> bool:
    """Return True unless the table is operated by hand or simulated in this process. Windows has no lock file."""
    return os.name == "posix" and parse_address(address)[0] not in ("manual", "simulated")


@contextmanager
def _lock_file(address: str) -> Iterator[int]:
    """Open the lock file of a table within the block. A file of another user can be read and locked."""
    path = Path("/tmp", f"undrift-rig-{hashlib.sha256(place_of(address).encode()).hexdigest()[:24]}")
    for flags in (os.O_RDWR, os.O_RDONLY, os.O_RDWR | os.O_CREAT):
        with contextlib.suppress(OSError):
            handle = os.open(path, flags | os.O_NOFOLLOW, 0o644)
            break
    else:
        raise InputError(f"{path}: cannot create the lock file of the table. Correct the permissions of the folder.")
    try:
        yield handle
    finally:
        os.close(handle)


def _is_locked(handle: int, wait_s: float) -> bool:
    """Try to lock an open file and return True on success. The lock lasts until the file is closed."""
    try:
        take_lock(handle, wait_s)
    except OSError:
        return False
    return True
