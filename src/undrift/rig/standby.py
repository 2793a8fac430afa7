"""Standby: a connection of its own to the table's controller, kept open while a run goes on, so that a stop leaves at once.

The run's own connection waits for answers, and its process may be busy, halted or hung; the standby shouts past it.

    Galil on TCP      a second handle: ST, then MO until the motor is off, AB after half a second
    GRBL on TCP       a second client: 0x85 (end of the jog) until the run has ended, then reset and $SLP
    a serial port     the same device file, opened for the moment: ST, or 0x85; the run's own answers get out of step, and it closes
    gclib, a person   nothing to shout: the run is ended, and it or its guard stops the table

A stop is: shout, mark (so that a run that mounts or soaks does not go on), end the run, and when it has ended, stop the table
once more over a fresh connection, which confirms that it is at rest with its motor off.
"""

import contextlib
import logging
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from undrift.errors import RigError
from undrift.rig.grbl import JOG_CANCEL, reply_end
from undrift.rig.guard import mark_stop, stop_rig
from undrift.rig.link import Link, LinkPort, link_settings
from undrift.rig.rig import parse_address

log = logging.getLogger(__name__)

CHECK_S = 2.0  # between two questions whether the connection stands
AGAIN_S = 0.05  # between two shouts
ABORT_S = 0.5  # that a table is given to slow down
PATIENCE_S = 4.0  # that a run is given to end by itself, before it is killed
LONGEST_S = 10.0  # that its end is waited for
TRIES, PAUSE_S = 4, 1.5  # to confirm the stop: a guard may hold a serial port, a table slows down


class Standby:
    """Ready to stop one table; ``close`` lets go of it. A table that takes no second connection has a reason, in words."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.kind, self._url, self._settings = parse_address(address)
        self.reason = ""
        self._link: Link | None = None
        self._ended = threading.Event()
        self._serial = self._url.removeprefix("serial://") if self._url.startswith(("serial:", "/")) else ""
        if self.kind in ("galil", "grbl") and self._url.startswith("tcp:"):
            self.reason = "connecting"
            self._connect()
            threading.Thread(target=self._keep, name="standby", daemon=True).start()
        elif self._serial:
            self.reason = "a serial port has one owner: a stop is written between the run's own commands"
        else:
            self.reason = "this controller takes no second connection: a stop ends the run, and the run stops the table"

    @property
    def has_motor(self) -> bool:
        """Whether there is anything to stop."""
        return self.kind != "manual"

    def shout(self, times: int = 0, since_s: float = 0.0) -> bool:
        """Send a stop without waiting for an answer; return whether it left. Repeats switch off, and abort what goes on."""
        letter = self._settings.axis or "X"
        words = [f"ST{letter}"] if times == 0 else [f"MO{letter}"]
        words = ["AB", *words] if since_s > ABORT_S else words
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
        self._ended.set()
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

    def _keep(self) -> None:
        """See whether the connection stands, and open it again where it does not."""
        while not self._ended.wait(CHECK_S):
            try:
                if self._link is None or not self._link.is_open:
                    self._connect()
                elif isinstance(self._link, LinkPort):
                    self._link.resynchronise()
            except RigError:
                self._connect()

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

    ``ended`` tells whether that process has gone; a halted one is woken to its end, a hung one killed, and its guard stops the
    table too.
    """
    standby.shout()
    if standby.has_motor:
        mark_stop(standby.address)
    _send(pid, signal.SIGTERM, signal.SIGCONT)
    began, times, killed = time.monotonic(), 0, False
    while not ended() and (since_s := time.monotonic() - began) < LONGEST_S:
        times += 1
        standby.shout(times, since_s)
        if since_s > PATIENCE_S and not killed:
            killed = True
            _send(pid, signal.SIGKILL)
        time.sleep(AGAIN_S)
    if not standby.has_motor:
        return ended()
    for attempt in range(TRIES):
        try:
            stop_rig(standby.address)
            return True
        except RigError as error:
            log.warning("stop: %s", error)
            if attempt < TRIES - 1:
                time.sleep(PAUSE_S)
    return False


def _send(pid: int | None, *numbers: int) -> None:
    for number in numbers if pid is not None else ():
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(pid, number)  # type: ignore[arg-type]
