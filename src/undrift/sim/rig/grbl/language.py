"""Grbl: an emulated stepper board behind the bytes of its clients, and the faults it may suffer.

Lines end with a line feed and are answered `ok` or `error:n`; `?` `!` `~` 0x18 0x85 are taken at once, wherever they stand.
"""

import threading
from collections import deque

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.rig.clock import Clock
from undrift.sim.rig.grbl.axis import rippled
from undrift.sim.rig.grbl.board import EOL, Board, GrblSettings, answer, greeting
from undrift.units import RADIAN_PER_DEGREE

LINE_LENGTH = 80


class GrblMachine:
    """A board, its clock and its motor, for any number of clients.

    Parameters
    ----------
    settings : GrblSettings
        Which board.
    clock : Clock
        Emulated time.
    history_s : float
        How far back `history` reaches, s.
    """

    def __init__(self, settings: GrblSettings, clock: Clock, history_s: float = 1200.0) -> None:
        self.settings, self.clock = settings, clock
        self.board = Board(settings, clock)
        self.lock = threading.RLock()
        self._history_s = history_s
        self._sessions: list[GrblSession] = []
        self._broken: set[str] = set()

    def open_session(self, serial: bool) -> "GrblSession":
        """Return what a new client talks to.

        Parameters
        ----------
        serial : bool
            Makes no difference to a board.
        """
        with self.lock:
            session = GrblSession(self)
            self._sessions.append(session)
            return session

    def close_session(self, session: object) -> None:
        """Forget a client; the board goes on.

        Parameters
        ----------
        session : GrblSession
            Which.
        """
        with self.lock:
            self._sessions = [kept for kept in self._sessions if kept is not session]

    def tick(self) -> None:
        """Come up to now."""
        with self.lock:
            self.board.advance()

    @property
    def motor_on(self) -> bool:
        """Whether the motor has current."""
        with self.lock:
            self.tick()
            return self.board.energised

    @property
    def powered(self) -> bool:
        """Whether it has power."""
        return "power_cut" not in self._broken

    def present(self) -> tuple[float, float]:
        """Return angle and rate of the axis now, rad and rad/s."""
        angle, rate = self.states(np.array([self.clock.now()]))
        return float(angle[0]), float(rate[0])

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angle and rate of the axis, rad and rad/s, shape (n,).

        Parameters
        ----------
        times : array, shape (n,)
            Emulated times, s, up to now.

        Raises
        ------
        InputError
            A time to come, or before the start.
        """
        with self.lock:
            now = self.clock.now()
            self.tick()
            t = np.asarray(times, float)
            if t.size and (t.max() > now or t.min() < 0.0):
                raise InputError(
                    f"axis state: wanted times in 0..{now:.4f} s, got {t.min():.4f}..{t.max():.4f} s; ask for the past"
                )
            angle, rate = rippled(
                *self.board.stepper.shaft.many(t), self.settings.ripple_deg, self.settings.full_step_deg
            )
            return angle * RADIAN_PER_DEGREE, rate * RADIAN_PER_DEGREE

    def history(self, last_s: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Return time and angle of the past in 1 ms steps, s and rad, shape (n,).

        Parameters
        ----------
        last_s : float or None
            Only so much of it, s.
        """
        with self.lock:
            now = self.clock.now()
            first = max(0.0, now - (self._history_s if last_s is None else last_s))
            times = np.append(np.arange(first, now, 1e-3), now)
            return times, self.states(times)[0]

    def set_fault(self, name: str, on: bool) -> None:
        """Break or mend a part.

        Parameters
        ----------
        name : str
            One of RIG_FAULTS; a board without encoder does not notice the loss of one.
        on : bool
            True breaks it.
        """
        with self.lock:
            self.tick()
            (self._broken.add if on else self._broken.discard)(name)
            now, board = self.clock.now(), self.board
            if name in ("power_cut", "amplifier_fault"):
                current = not self._broken & {"power_cut", "amplifier_fault"}
                board.stepper.set_current(now, current, self.settings.coast_deg_s2)
                if name == "power_cut":
                    board.stepper.count_from_zero(now)
                    board.start()
            elif name in ("limit_switch", "limit_switch_reverse"):
                board.limit_pressed = bool(self._broken & {"limit_switch", "limit_switch_reverse"})
                if on and board.values[21] == 1.0:
                    self._tell(board.alarm(1))
            elif name == "abort_input" and on:
                self._tell(board.reset())
            elif name == "message" and on:
                self._tell(f"[MSG:Emulated message]{EOL}")

    def _tell(self, text: str) -> None:
        for session in self._sessions:
            session.tell(text)


class GrblSession:
    """One client's bytes.

    Parameters
    ----------
    machine : GrblMachine
        The board behind it.
    """

    def __init__(self, machine: GrblMachine) -> None:
        self._machine = machine
        self._line = ""
        self._lines: deque[str] = deque()  # those that wait for room among the moves
        self._unasked = b""

    def greet(self) -> bytes:
        """Return the greeting, as a board gives it when its port is opened."""
        return greeting(self._machine.settings).encode()

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes from the client.

        Parameters
        ----------
        data : bytes
            Any.

        Returns
        -------
        list of bytes
            Answers.
        """
        machine = self._machine
        with machine.lock:
            machine.tick()
            if not machine.powered:
                return []
            answers = [self._take(letter) for letter in data.decode("latin-1")]
            machine.tick()
            return [answer.encode("latin-1") for answer in answers if answer]

    def unasked(self) -> bytes:
        """Return what the board says without being asked, since the last look."""
        with self._machine.lock:
            data, self._unasked = self._unasked + self._work().encode("latin-1"), b""
            return data

    def tell(self, text: str) -> None:
        """Queue a message.

        Parameters
        ----------
        text : str
            The message.
        """
        self._unasked += text.encode()

    def _take(self, letter: str) -> str:
        if letter in "?!~\x18\x85":
            if letter == "\x18":
                self._line = ""
                self._lines.clear()
            return self._machine.board.at_once(letter)
        if letter in "\r\n":
            line, self._line = self._line, ""
            if letter == "\r" and not line:
                return ""
            self._lines.append(line)
            return self._work()
        if len(self._line) <= LINE_LENGTH:
            self._line += letter
        return ""

    def _work(self) -> str:
        # a full board does not read on
        board, said = self._machine.board, ""
        board.advance()
        while self._lines and not board.full:
            line = self._lines.popleft()
            said += f"error:11{EOL}" if len(line) > LINE_LENGTH else answer(board, line)
        return said
