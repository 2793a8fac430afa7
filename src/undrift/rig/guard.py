"""Guard: a second process that stops the table, and switches the chamber off, when the first one is gone or silent.

A card that jogs keeps jogging when the program that started it is killed (kill -9, out of memory) or halted (kill -STOP, a computer
that swaps). The guard listens at a pipe from that program: a beat every second, "done" when all ended well. The end of the pipe
without "done", or 5 s of silence, has it open the rig itself and close it again: stop, motor off. That needs a rig that takes a
second connection, or a port that is free again: TCP and serial.

``undrift rig stop`` leaves a mark in the user's temporary folder, so that a run that mounts or soaks, whose motor is off, does not
switch it on again: on the same computer, by the same user and for the same address.
"""

import contextlib
import getpass
import hashlib
import logging
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import TextIO

from undrift.errors import RigError, RigFault
from undrift.rig.chamber import open_chamber
from undrift.rig.lock import place_of
from undrift.rig.rig import RigSettings, open_rig

# ---- Marks that ``undrift rig stop`` leaves on this computer, so that a run that mounts or soaks does not switch the motor
# on again.

log = logging.getLogger(__name__)


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
            raise RigFault("rig: wanted to continue, got it stopped from elsewhere by rig stop; continue with --resume")

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
SILENCE_S = 5.0  # after which the program counts as gone
LONGEST_S = 20.0  # that a guard is waited for


class Guard(AbstractContextManager["Guard"]):
    """Stands by while a rig is driven; a context manager."""

    def __init__(self, address: str, chamber: str = "") -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "undrift.rig.guard", address, chamber],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C in the terminal does not reach it
        )
        self._armed = False
        self._due: float | None = None
        self._ended = threading.Event()
        self._beating = threading.Thread(target=self._beat, name="guard", daemon=True)
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
        self._due = None if within_s is None else time.monotonic() + within_s

    def promise_holds(self) -> bool:
        """Return whether the program has not hung, as far as it promised."""
        due = self._due
        return due is None or time.monotonic() < due

    def check(self) -> None:
        """Refuse to continue without a guard."""
        code = self._process.poll()
        if code is not None:
            raise RigFault(
                f"guard: wanted it to stand by while the table is driven, got it ended (code {code}): it was killed, or this "
                "program was halted for too long; continue with --resume"
            )

    def release(self, *, well: bool) -> None:
        """Send the guard home."""
        self._ended.set()
        if self._beating.is_alive():
            self._beating.join(LONGEST_S)
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
        self._beating.start()

    def _beat(self) -> None:
        while not self._ended.wait(BEAT_S):
            if self.promise_holds():
                self._say("")

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


def stop_rig(address: str) -> None:
    """Stop the table and switch its motor off, from a connection of its own."""
    open_rig(address, RigSettings()).close()


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


if __name__ == "__main__":
    sys.stdout.write(READY + "\n")
    sys.stdout.flush()
    sys.exit(watch(sys.argv[1], sys.argv[2], sys.stdin, sys.stderr))
