"""Grbl: an emulated stepper board: jogs, status reports, hold, reset, alarms, `$` settings and its error codes.

Lines end with a line feed and are answered `ok` or `error:n`; `?` `!` `~` 0x18 0x85 are taken at once, wherever they stand.
"""

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.rig.clock import Clock
from undrift.sim.rig.grbl_axis import Path, rippled
from undrift.sim.rig.grbl_words import Denied, Move, parse_line, parse_setting
from undrift.units import RADIAN_PER_DEGREE

BUFFER = 15  # moves that may wait
LINE_LENGTH = 80
EOL = "\r\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblSettings:
    """What kind of board, motor and table it is.

    Parameters
    ----------
    axes : str
        Letters of the board's axes, in the order of its reports.
    axis : str
        The one that turns the table.
    version : str
        In its greeting.
    full_step_deg : float
        Of the table, deg.
    microsteps : int
        In a full step.
    ripple_deg : float
        Detent ripple, amplitude, deg.
    max_rate_deg_per_min, acceleration_deg_s2 : float
        $11n and $12n at power-up.
    coast_deg_s2 : float
        How fast friction stops the table without current, deg/s2.

    Raises
    ------
    InputError
        An axis that the board does not have.
    """

    axes: str = "XYZA"
    axis: str = "A"
    version: str = "1.1h"
    full_step_deg: float = 1.8
    microsteps: int = 16
    ripple_deg: float = 0.02
    max_rate_deg_per_min: float = 21_600.0
    acceleration_deg_s2: float = 500.0
    coast_deg_s2: float = 400.0

    def __post_init__(self) -> None:
        if len(self.axis) != 1 or self.axis not in self.axes:
            raise InputError(f"grbl axis: wanted one of {', '.join(self.axes)}, got '{self.axis}'; name one of them")


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
        self.lock = threading.RLock()
        self._history_s = history_s
        self._sessions: list[GrblSession] = []
        self._pulses, self._shaft = Path(), Path()
        self._broken: set[str] = set()
        self.values = self._defaults()
        self._start()

    def _defaults(self) -> dict[int, float]:
        s = self.settings
        values = {0: 10.0, 1: 25.0, 2: 0.0, 3: 0.0, 4: 0.0, 5: 0.0, 6: 0.0, 10: 1.0, 11: 0.01, 12: 0.002, 13: 0.0}
        values |= {
            20: 0.0,
            21: 1.0,
            22: 0.0,
            23: 0.0,
            24: 25.0,
            25: 500.0,
            26: 250.0,
            27: 1.0,
            30: 1000.0,
            31: 0.0,
            32: 0.0,
        }
        for place in range(len(s.axes)):
            values[100 + place] = round(s.microsteps / s.full_step_deg, 3)
            values[110 + place] = s.max_rate_deg_per_min
            values[120 + place] = s.acceleration_deg_s2
            values[130 + place] = 360.0
        return dict(sorted(values.items()))

    def _start(self) -> None:
        self.state = "Idle"
        self.relative = False
        self.feed = 0.0
        self._queue: deque[tuple[float, float]] = deque()
        self._ends = 0.0
        self._rested = -1e9
        self._target = 0.0

    def of_axis(self, family: int) -> float:
        """Return the axis's own value of a family of settings: 100 steps/deg, 110 deg/min, 120 deg/s2, 130 deg.

        Parameters
        ----------
        family : int
            100, 110, 120 or 130.
        """
        return self.values[family + self.settings.axes.index(self.settings.axis)]

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
            now = self.clock.now()
            if self.state in ("Jog", "Run", "Hold") and now >= self._ends:
                self._rested = self._ends
                if self.state == "Hold":
                    return
                self.state = "Idle" if not self._queue else self.state
                if self._queue:
                    self._launch(max(self._ends, 0.0))
                    self.tick()

    @property
    def motor_on(self) -> bool:
        """Whether the motor has current: always with $1=255, else while it moves and for $1 ms after."""
        with self.lock:
            self.tick()
            if self._broken & {"power_cut", "amplifier_fault"} or self.state == "Sleep":
                return False
            moving = self.state in ("Jog", "Run", "Hold") and self.clock.now() < self._ends
            return moving or self.values[1] == 255.0 or self.clock.now() - self._rested < self.values[1] * 1e-3

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
            angle, rate = rippled(*self._shaft.many(t), self.settings.ripple_deg, self.settings.full_step_deg)
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

    def report(self) -> str:
        """Return the status report, as `?` is answered."""
        angle, rate = self._pulses.at(self.clock.now())
        steps = self.of_axis(100)
        shown = [
            f"{round(angle * steps) / steps if letter == self.settings.axis else 0.0:.3f}"
            for letter in self.settings.axes
        ]
        state = f"Hold:{int(self.clock.now() < self._ends)}" if self.state == "Hold" else self.state
        pins = f"|Pn:{self.settings.axis}" if self._broken & {"limit_switch", "limit_switch_reverse"} else ""
        return f"<{state}|MPos:{','.join(shown)}|FS:{round(abs(rate) * 60.0)},0{pins}>{EOL}"

    def line(self, text: str) -> str:
        """Do one line.

        Parameters
        ----------
        text : str
            Without its line end.

        Returns
        -------
        str
            What it prints, and `ok` or `error:n`.
        """
        try:
            return self._line(text.strip().upper().replace(" ", "")) + "ok" + EOL
        except Denied as denial:
            return f"error:{denial.code}{EOL}"

    def _line(self, text: str) -> str:
        if not text:
            return ""
        if text.startswith("$J="):
            if self.state not in ("Idle", "Jog"):
                raise Denied(9 if self.state in ("Alarm", "Sleep") else 8)
            self._add(parse_line(text[3:], self.settings.axes, jog=True), "Jog")
            return ""
        if text.startswith("$"):
            return self._dollar(text)
        if self.state in ("Alarm", "Sleep", "Jog"):
            raise Denied(9)
        move = parse_line(text, self.settings.axes, jog=False)
        if move.relative is not None:
            self.relative = move.relative
        self.feed = move.feed or self.feed
        if move.target:
            self._add(move, "Run")
        return ""

    def _dollar(self, text: str) -> str:
        if text == "$$":
            return "".join(f"${number}={value:.3f}{EOL}" if number >= 100 or number in (11, 12, 24, 25, 27)
                           else f"${number}={value:.0f}{EOL}" for number, value in self.values.items())  # fmt: skip
        if text == "$X":
            self.state = "Idle" if self.state == "Alarm" else self.state
            return f"[MSG:Caution: Unlocked]{EOL}"
        if text in ("$", "$H"):
            if text == "$H":
                raise Denied(5)
            return f"[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]{EOL}"
        if text == "$I":
            return f"[VER:{self.settings.version}.20190825:]{EOL}[OPT:V,15,128]{EOL}"
        if text == "$G":
            return f"[GC:G0 G54 G17 G21 {'G91' if self.relative else 'G90'} G94 M5 M9 T0 F{self.feed:g} S0]{EOL}"
        if self.state not in ("Idle", "Alarm"):
            raise Denied(8)
        if text == "$SLP":
            self.state = "Sleep"
            return f"[MSG:Sleeping]{EOL}"
        number, value = parse_setting(text, self.values)
        self.values[number] = value
        return ""

    def _add(self, move: Move, state: str) -> None:
        feed = (move.feed or self.feed) if state == "Run" and not move.rapid else move.feed
        if move.rapid:
            feed = self.of_axis(110)
        if not feed:
            raise Denied(22)
        wanted = move.target.get(self.settings.axis, None)
        if len(self._queue) >= BUFFER:
            raise Denied(24)
        end = (
            self._queue[-1][0]
            if self._queue
            else (self._target if self.state in ("Jog", "Run") else self._rest_angle())
        )
        relative = self.relative if move.relative is None else move.relative
        goal = end if wanted is None else (end + wanted if relative else wanted)
        if state == "Jog" and self.values[20] == 1.0 and not -self.of_axis(130) <= goal <= 0.0:
            raise Denied(15)
        steps = self.of_axis(100)
        self._queue.append((round(goal * steps) / steps, min(feed, self.of_axis(110)) / 60.0))
        if self.state == "Idle":
            self.state = state
            self._launch(self.clock.now())

    def _rest_angle(self) -> float:
        return self._pulses.at(self.clock.now())[0]

    def _launch(self, time: float) -> None:
        goal, feed = self._queue.popleft()
        distance = goal - self._pulses.at(time)[0]
        self._target, self._ends = goal, time
        if abs(distance) < 1e-9:
            return
        self._ends = self._pulses.move(time, distance, feed, self.of_axis(120))
        if not self._broken & {"power_cut", "amplifier_fault"}:
            self._shaft.move(time, distance, feed, self.of_axis(120))

    def _slow(self, deceleration: float) -> None:
        now = self.clock.now()
        self._queue.clear()
        self._ends = self._pulses.slow(now, deceleration)
        if not self._broken & {"power_cut", "amplifier_fault"}:
            self._shaft.slow(now, deceleration)

    def at_once(self, letter: str) -> str:
        """Do a real-time character.

        Parameters
        ----------
        letter : str
            One of ? ! ~ 0x18 0x85.

        Returns
        -------
        str
            What it prints.
        """
        moving = self.state in ("Jog", "Run")
        if letter == "?":
            return self.report()
        if letter in ("!", "\x85") and self.state == "Jog":
            self._slow(self.of_axis(120))
        elif letter == "!" and moving:
            left = self._target - self._rest_angle()
            feed = max(abs(self._pulses.at(self.clock.now())[1]), 1e-3)
            self._slow(self.of_axis(120))
            self._queue.appendleft((self._rest_angle() + left, feed))
            self.state = "Hold"
        elif letter == "~" and self.state == "Hold" and self.clock.now() >= self._ends:
            self.state = "Run"
            self._launch(self.clock.now())
        elif letter == "\x18":
            return self._reset()
        return ""

    def _reset(self) -> str:
        lost = self.state in ("Jog", "Run") and self.clock.now() < self._ends
        if lost:
            self._slow(1e6)
        self._start()
        if lost:
            self.state = "Alarm"
        return (f"ALARM:3{EOL}" if lost else "") + self.greeting()

    def greeting(self) -> str:
        """Return what the board prints when it starts."""
        return f"{EOL}Grbl {self.settings.version} ['$' for help]{EOL}"

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
            if name in ("power_cut", "amplifier_fault"):
                self._current(name, on)
            elif name in ("limit_switch", "limit_switch_reverse"):
                (self._broken.add if on else self._broken.discard)(name)
                if on and self.values[21] == 1.0:
                    self._alarm(1)
            elif name == "abort_input" and on:
                self._tell(self._reset())
            elif name == "message" and on:
                self._tell(f"[MSG:Emulated message]{EOL}")

    def _current(self, name: str, on: bool) -> None:
        if on and not self._broken & {"power_cut", "amplifier_fault"}:
            self._shaft.slow(self.clock.now(), self.settings.coast_deg_s2)
        (self._broken.add if on else self._broken.discard)(name)
        if name == "power_cut":
            self._pulses.cut(self.clock.now())
            self._pulses.go(self.clock.now(), 0.0, 0.0, 0.0)  # it counts from zero when it starts again
            self._start()

    def _alarm(self, number: int) -> None:
        self._slow(1e6)
        self._queue.clear()
        self.state = "Alarm"
        self._tell(f"ALARM:{number}{EOL}[MSG:Reset to continue]{EOL}")

    def _tell(self, text: str) -> None:
        for session in self._sessions:
            session.tell(text)

    @property
    def powered(self) -> bool:
        """Whether it has power."""
        return "power_cut" not in self._broken


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
        self._unasked = b""

    def greet(self) -> bytes:
        """Return the greeting, as a board gives it when its port is opened."""
        return self._machine.greeting().encode()

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
            data, self._unasked = self._unasked, b""
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
            return self._machine.at_once(letter)
        if letter in "\r\n":
            line, self._line = self._line, ""
            if letter == "\r" and not line:
                return ""
            return f"error:11{EOL}" if len(line) > LINE_LENGTH else self._machine.line(line)
        if len(self._line) <= LINE_LENGTH:
            self._line += letter
        return ""
