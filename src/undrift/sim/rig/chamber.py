"""An emulated thermal chamber on a loopback socket, with faults.

Its language is read here, by a parser of its own: words joined by colons, commands by semicolons, a line ends with LF.
"""

import threading
from collections import deque
from collections.abc import Callable

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.rig.air import Air, AirSettings
from undrift.sim.rig.clock import Clock
from undrift.sim.rig.faults import LINK_FAULTS, FaultyLink
from undrift.sim.rig.server import Server

CHAMBER_FAULTS = {
    "stuck_heater": "the heater no longer follows the set-point; the air creeps up by 0.5 K/min",
    "open_door": "the air goes to the room's temperature with a time constant of 60 s",
}
LOWEST_C, HIGHEST_C, STEEPEST_C_PER_MIN = -40.0, 130.0, 600.0
IDENTITY = "undrift,emulated chamber,0,1.0"
NO_ERROR = '0,"No error"'


class EmulatedChamber:
    """A chamber that listens until closed.

    Parameters
    ----------
    settings : AirSettings
        How its air moves.
    clock : Clock
        Emulated time.
    host : str
        A loopback address.
    port : int
        0 takes a free one.
    """

    def __init__(self, settings: AirSettings, clock: Clock, host: str = "127.0.0.1", port: int = 0) -> None:
        self.air = Air(settings)
        self._clock = clock
        self._lock = threading.RLock()
        self._errors: deque[str] = deque(maxlen=16)
        self._link = FaultyLink()
        self._server = Server(self, self._link, (host, port))
        self.address = f"tcp://{self._server.host}:{self._server.port}"

    def open_session(self, serial: bool) -> "ChamberSession":
        """Return what a new client talks to.

        Parameters
        ----------
        serial : bool
            Makes no difference.

        Returns
        -------
        ChamberSession
            Its end of the link.
        """
        return ChamberSession(self)

    def close_session(self, session: object) -> None:
        """Forget a client; the chamber goes on.

        Parameters
        ----------
        session : object
            Which.
        """

    def tick(self) -> None:
        """Bring the air up to now."""
        with self._lock:
            self.air.advance(self._clock.now())

    def board_temp(self, times: FloatArray) -> FloatArray:
        """Return the temperature of the device's board at moments up to now.

        Parameters
        ----------
        times : array, shape (n,)
            Emulated times, s, rising.

        Returns
        -------
        array, shape (n,)
            degC.
        """
        with self._lock:
            self.air.advance(float(times[-1]))
            return self.air.at(times)[1]

    def inject(self, fault: str, *, answers: int | None = None) -> None:
        """Let a fault begin.

        Parameters
        ----------
        fault : str
            One of CHAMBER_FAULTS, or of the link's faults in faults.py.
        answers : int or None
            How many answers a fault of the link strikes; None until it is cleared.

        Raises
        ------
        InputError
            Not one of the faults.
        """
        if fault in LINK_FAULTS:
            self._link.start(fault, answers)
        else:
            self._set_fault(fault, True)
        self._server.settle()

    def clear(self) -> None:
        """Let all faults end."""
        self._link.stop(None)
        for fault in CHAMBER_FAULTS:
            self._set_fault(fault, False)
        self._server.settle()

    def close(self) -> None:
        """Close every socket and end the thread; harmless when called again."""
        self._server.close()

    def obey(self, line: str) -> str:
        """Do what a line says.

        Parameters
        ----------
        line : str
            Commands joined by semicolons.

        Returns
        -------
        str
            Answers joined by semicolons, "" where nothing was asked.
        """
        with self._lock:
            self.air.advance(self._clock.now())
            answers = [self._obey_one(command.strip().removeprefix(":")) for command in line.split(";")]
        return ";".join(answer for answer in answers if answer)

    def _obey_one(self, command: str) -> str:
        word, _, value = command.upper().partition(" ")
        asked: dict[str, Callable[[], str]] = {
            "*IDN?": lambda: IDENTITY,
            "TEMP:SPO?": lambda: f"{self.air.set_point:.1f}",
            "TEMP:RAMP?": lambda: f"{self.air.ramp_c_per_min:.2f}",
            "MEAS:TEMP?": lambda: f"{self.air.at(np.array([self._clock.now()]))[0][0]:.2f}",
            "OUTP?": lambda: str(int(self.air.on)),
            "SYST:ERR?": lambda: self._errors.popleft() if self._errors else NO_ERROR,
        }
        if word in asked:
            return asked[word]()
        if word == "TEMP:SPO":
            self.air.set_point = self._number(value, LOWEST_C, HIGHEST_C, self.air.set_point)
        elif word == "TEMP:RAMP":
            self.air.ramp_c_per_min = self._number(value, 0.01, STEEPEST_C_PER_MIN, self.air.ramp_c_per_min)
        elif word == "OUTP" and value.strip() in ("ON", "OFF", "1", "0"):
            self.air.on = value.strip() in ("ON", "1")
        elif word:
            self._errors.append('-113,"Undefined header"')
        return ""

    def _number(self, text: str, low: float, high: float, held: float) -> float:
        try:
            value = float(text)
        except ValueError:
            self._errors.append('-104,"Data type error"')
            return held
        if not low <= value <= high:
            self._errors.append('-222,"Data out of range"')
            return held
        return value

    def _set_fault(self, fault: str, on: bool) -> None:
        with self._lock:
            if fault == "stuck_heater":
                self.air.stuck = on
            elif fault == "open_door":
                self.air.door_open = on
            else:
                known = ", ".join((*LINK_FAULTS, *CHAMBER_FAULTS))
                raise InputError(f"chamber fault: wanted one of {known}, got '{fault}'; name one of them")


class ChamberSession:
    """One client of a chamber.

    Parameters
    ----------
    chamber : EmulatedChamber
        Whose.
    """

    def __init__(self, chamber: EmulatedChamber) -> None:
        self._chamber = chamber
        self._held = b""

    def greet(self) -> bytes:
        """Return nothing: a chamber speaks when spoken to.

        Returns
        -------
        bytes
            b"".
        """
        return b""

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes, return answers.

        Parameters
        ----------
        data : bytes
            Any.

        Returns
        -------
        list of bytes
            A line for each line that asked something.
        """
        *lines, self._held = (self._held + data).split(b"\n")
        self._held = self._held[-1024:]
        answers = [self._chamber.obey(line.decode("ascii", errors="replace")) for line in lines]
        return [answer.encode("ascii") + b"\n" for answer in answers if answer]

    def unasked(self) -> bytes:
        """Return nothing.

        Returns
        -------
        bytes
            b"".
        """
        return b""
