"""Watch over a table: one run at a time, a guard that stops it when its program is gone, and a stop that leaves at once.

What is watched, by whom, with which limit and what follows is one table, ``WATCHED`` in rig/rig.py.

**Guard.** A card that jogs keeps jogging when the program that started it is killed (kill -9, out of memory) or halted (kill -STOP,
a computer that swaps). The guard is a second process that listens at a pipe from that program: a beat every second, "done" when all
ended well. The end of the pipe without "done", or too long a silence, has it open the rig itself and close it again. That needs a
rig that takes a second connection, or a port that is free again: TCP and serial.

**Marks.** ``undrift rig stop`` leaves a mark in the user's temporary folder, so that a run that mounts or soaks, whose motor is
off, does not switch it on again: on the same computer, by the same user and for the same address.

**Lock.** A file in the system's folder for temporary ones that any user may read and lock, named after where the table is: the
spelling of an address, its options and the user do not matter. The system frees it when its process ends, however that happens.
A run on another computer shows by the motor: on, or moving; the controller is asked before anything is set.

**Standby.** A connection of its own to the table's controller, kept open while a run goes on, so that a stop leaves at once. The
run's own connection waits for answers, and its process may be busy, halted or hung; the standby shouts past it.

    Galil on TCP      a second handle: ST, then MO until the motor is off, AB after half a second
    GRBL on TCP       a second client: 0x85 (end of the jog) until the run has ended, then reset and $SLP
    a serial port     the same device file, opened for the moment: ST, or 0x85; the run's own answers get out of step, and it closes
    a person          nothing to shout: the run is ended
"""

import contextlib
import getpass
import hashlib
import ipaddress
import logging
import os
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType, TracebackType
from typing import TextIO

from undrift.base.clock import HOST, Clock, Repeat
from undrift.errors import InputError, RigError, RigFault
from undrift.files import take_lock
from undrift.live.transports import host_and_port
from undrift.rig.chamber import open_chamber
from undrift.rig.galil import read_status
from undrift.rig.grbl import JOG_CANCEL, GrblController, reply_end
from undrift.rig.link import Link, LinkPort, link_settings
from undrift.rig.rig import WATCHED, RigSettings, open_rig, parse_address

log = logging.getLogger(__name__)

# ---- Marks.


def mark_stop(address: str) -> None:
    """Leave a mark; where none can be left that is logged, as the stop itself matters more."""
    path = _mark(address)
    try:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        path.write_text(f"{time.time_ns()} {os.getpid()}\n")
    except OSError as error:
        log.warning("%s: no mark of the stop could be left (%s); end the run by Ctrl-C too", path, error)


class StopWatch:
    """Notices stops that are marked after it was made."""

    def __init__(self, address: str) -> None:
        self._path = _mark(address)
        self._before = self._read()

    def check(self) -> None:
        """Refuse to go on after a stop from elsewhere."""
        if self._read() != self._before:
            raise RigFault("rig: wanted to continue, got it stopped from elsewhere by rig stop; continue with `resume`")

    def _read(self) -> str:
        try:
            return self._path.read_text()
        except OSError:
            return ""


def _mark(address: str) -> Path:
    """Return the mark's path: the spelling and the options of an address do not change which rig it is."""
    name = hashlib.sha256(place_of(address).encode()).hexdigest()[:24]
    return Path(tempfile.gettempdir()) / f"undrift-stops-{getpass.getuser()}" / name


# ---- Ctrl-C, Ctrl-Z and SIGTERM while a rig is driven: an exception first, and no disturbance while the table is stopped.

# as far as the system has them; a halted program leaves a table turning
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


# ---- guard

DONE, READY = "done", "ready"
BEAT_S = 1.0
SILENCE_S = WATCHED["program"].limit
LONGEST_S = 20.0  # that a guard is waited for


class Guard(AbstractContextManager["Guard"]):
    """Stands by while a rig is driven; a context manager."""

    def __init__(self, address: str, chamber: str = "", *, clock: Clock = HOST) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "undrift.rig.watch", address, chamber],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C in the terminal does not reach it
        )
        self._armed, self._clock = False, clock
        self._due: float | None = None
        self._heart: Repeat | None = None
        try:
            self._wait_until_ready()
        except BaseException:
            self.release(well=True)
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release(well=not (self._armed and isinstance(error, RigError)))

    def arm(self) -> None:
        """Say that the rig is open from now on: an error of it has the guard make sure that it is stopped."""
        self._armed = True

    def expect(self, within_s: float | None) -> None:
        """Promise the next call of this; a program that hangs breaks the promise, and its beats end."""
        self._due = None if within_s is None else self._clock.now() + within_s

    def promise_holds(self) -> bool:
        """Return whether the program has not hung, as far as it promised."""
        due = self._due
        return due is None or self._clock.now() < due

    def check(self) -> None:
        """Refuse to continue without a guard."""
        code = self._process.poll()
        if code is not None:
            raise RigFault(
                f"guard: wanted it to stand by while the table is driven, got it ended (code {code}): it was killed, or this "
                "program was halted for too long; continue with `resume`"
            )

    def release(self, *, well: bool) -> None:
        """Send the guard home."""
        if self._heart is not None:
            self._heart.end(LONGEST_S)
        if self._process.stdin is not None and not self._process.stdin.closed:
            if well:
                self._say(DONE)
            with contextlib.suppress(OSError):  # it is gone already
                self._process.stdin.close()
        try:
            self._process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _wait_until_ready(self) -> None:
        lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        output = self._process.stdout
        if output is not None:
            threading.Thread(
                target=lambda: lines.put(output.readline().strip()), name="guard-ready", daemon=True
            ).start()
        try:
            answer = lines.get(timeout=LONGEST_S)
        except queue.Empty:
            self._process.kill()
            answer = ""
        if answer != READY:
            raise RigFault(f"guard: wanted it ready within {LONGEST_S:g} s, got '{answer}'; nothing moved, start again")
        self._heart = self._clock.repeat(self._beat, "guard")

    def _beat(self) -> float:
        if self.promise_holds():
            self._say("")
        return BEAT_S

    def _say(self, word: str) -> None:
        if self._process.stdin is not None:
            with contextlib.suppress(OSError, ValueError):  # it is gone already, or sent home
                self._process.stdin.write(word + "\n")
                self._process.stdin.flush()


def watch(address: str, chamber: str, lines: TextIO, complaints: TextIO, *, silence_s: float = SILENCE_S) -> int:
    """Listen at a pipe until it ends or falls silent, then stop the table and the chamber unless all ended well."""
    if _ended_well(lines, silence_s):
        return 0
    code = 0
    for stop, place in ((stop_rig, address), (stop_chamber, chamber)):
        try:
            if place:
                stop(place)
        except RigError as error:
            complaints.write(f"undrift: guard: {error}\n")
            code = 3
    return code


def stop_rig(address: str, settings: RigSettings = RigSettings()) -> None:
    """Stop the table and switch its motor off, from a connection of its own."""
    open_rig(address, settings).close()


def stop_chamber(address: str) -> None:
    """Switch heater and compressor off, from a connection of its own."""
    with open_chamber(address) as chamber:
        chamber.switch_off()


def _ended_well(lines: TextIO, silence_s: float) -> bool:
    """Return whether "done" came; False at the end of the pipe and after too long a silence."""
    heard: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def listen() -> None:
        for line in lines:
            heard.put(line.strip())
        heard.put(None)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        try:
            word = heard.get(timeout=silence_s)
        except queue.Empty:
            return False
        if word is None or word == DONE:
            return word == DONE


# ---- Lock: one run for one table.

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
            take_lock(handle, WATCHED["lock"].limit)
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


def check_free(address: str, settings: RigSettings = RigSettings(), *, motor_on: bool = False) -> None:
    """Refuse a table that somebody drives, or left so: it moves, or its motor is on where `motor_on` does not allow that.

    Nothing is set and nothing stops.
    """
    kind, url, settings = parse_address(address, settings)
    if kind == "galil":
        found = read_status(address, settings)
        state = "moving" if found.moving else "its motor on" if found.motor_on and not motor_on else ""
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


# ---- Standby.

AGAIN_S = 0.05  # between two shouts
TRIES, PAUSE_S = 4, 1.5  # to confirm the stop: a guard may hold a serial port, a table slows down


class Standby:
    """Ready to stop one table; ``close`` lets go of it. A table that takes no second connection has a reason, in words."""

    def __init__(self, address: str, settings: RigSettings = RigSettings()) -> None:
        self.address, self.settings = address, settings
        self.kind, self._url, self._settings = parse_address(address, settings)
        self.reason = ""
        self._link: Link | None = None
        self._keeper: Repeat | None = None
        self._serial = self._url.removeprefix("serial://") if self._url.startswith(("serial:", "/")) else ""
        if self.kind in ("galil", "grbl") and self._url.startswith("tcp:"):
            self.reason = "connecting"
            self._connect()
            self._keeper = self.clock.repeat(self._keep, "standby")
        elif self._serial:
            self.reason = "a serial port has one owner: a stop is written between the run's own commands"
        else:
            self.reason = "this controller takes no second connection: a stop ends the run, and the run stops the table"

    @property
    def clock(self) -> Clock:
        """The host's, by which it repeats."""
        return self._settings.timing.host

    @property
    def has_motor(self) -> bool:
        """Whether there is anything to stop."""
        return self.kind != "manual"

    def shout(self, times: int = 0, since_s: float = 0.0) -> bool:
        """Send a stop without waiting for an answer; return whether it left. Repeats switch off, and abort what goes on."""
        letter = self._settings.axis or "X"
        words = [f"ST{letter}"] if times == 0 else [f"MO{letter}"]
        words = ["AB", *words] if since_s > WATCHED["slow-down"].limit else words
        data = JOG_CANCEL if self.kind == "grbl" else "".join(f"{word}\r" for word in words).encode()
        if self._serial:
            return times == 0 and self._write_serial(data)
        try:
            if self._link is not None:
                self._link.send(data)
                return True
        except RigError as error:
            log.warning("standby: %s", error)
        return False

    def close(self) -> None:
        """Let go of the connection."""
        if self._keeper is not None:
            self._keeper.end(0.0)
        if self._link is not None:
            self._link.close()

    def _connect(self) -> None:
        settings = link_settings(self._settings, 115_200 if self.kind == "grbl" else 19_200)
        try:
            if self._link is not None:
                self._link.close()
            if self.kind == "grbl":
                self._link = Link(self._url, replace(settings, reply_end=reply_end))
            else:
                self._link = LinkPort(self._url, settings)
                self._link.resynchronise()
            self.reason = ""
        except RigError as error:
            self._link, self.reason = None, str(error)

    def _keep(self) -> float:
        """See whether the connection stands, and open it again where it does not; return when to look again."""
        try:
            if self._link is None or not self._link.is_open:
                self._connect()
            elif isinstance(self._link, LinkPort):
                self._link.resynchronise()
        except RigError:
            self._connect()
        return WATCHED["connection"].limit

    def _write_serial(self, data: bytes) -> bool:
        try:
            handle = os.open(self._serial, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:  # another one holds it for itself
            log.warning("standby: %s: %s", self._serial, error)
            return False
        try:
            return os.write(handle, data) == len(data)
        except OSError:
            return False
        finally:
            os.close(handle)


def stop_now(standby: Standby, ended: Callable[[], bool], pid: int | None) -> bool:
    """Stop the table at once, end the run's process, and return whether the table is confirmed at rest with its motor off.

    Shout, mark, end the run, and stop the table once more over a fresh connection, which confirms it. ``ended`` tells
    whether that process has gone; a halted one is woken to its end, a hung one killed, and its guard stops the table too.
    """
    clock = standby.clock
    standby.shout()
    if standby.has_motor:
        mark_stop(standby.address)
    _send(pid, signal.SIGTERM, signal.SIGCONT)
    began, times, killed = clock.now(), 0, False
    while not ended() and (since_s := clock.now() - began) < WATCHED["ended run"].limit:
        times += 1
        standby.shout(times, since_s)
        if since_s > WATCHED["stopped run"].limit and not killed:
            killed = True
            _send(pid, signal.SIGKILL)
        clock.wait(AGAIN_S)
    if not standby.has_motor:
        return ended()
    for attempt in range(TRIES):
        try:
            stop_rig(standby.address, standby.settings)
            return True
        except RigError as error:
            log.warning("stop: %s", error)
            if attempt < TRIES - 1:
                clock.wait(PAUSE_S)
    return False


def _send(pid: int | None, *numbers: int) -> None:
    for number in numbers if pid is not None else ():
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(pid, number)  # type: ignore[arg-type]


if __name__ == "__main__":
    sys.stdout.write(READY + "\n")
    sys.stdout.flush()
    sys.exit(watch(sys.argv[1], sys.argv[2], sys.stdin, sys.stderr))
