"""Board: what a stepper board does with its lines and its real-time characters: states, moves, settings, alarms."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from undrift.errors import InputError
from undrift.sim.rig.clock import Clock
from undrift.sim.rig.grbl.axis import Stepper
from undrift.sim.rig.grbl.planner import plan
from undrift.sim.rig.grbl.words import Denied, Move, parse_line, parse_setting

BUFFER = 15  # moves that may wait
EOL = "\r\n"
AT_ONCE = 1e6  # deg/s2: a reset or a limit cuts the pulses


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


class Board:
    """The controller; time is the clock's.

    Parameters
    ----------
    settings : GrblSettings
        Which board.
    clock : Clock
        Emulated time.
    """

    def __init__(self, settings: GrblSettings, clock: Clock) -> None:
        self.settings, self.clock = settings, clock
        self.stepper = Stepper()
        self.limit_pressed = False
        self.values = _defaults(settings)
        self.start()

    def start(self) -> None:
        """Start afresh: idle, nothing waiting, settings kept."""
        self.state = "Idle"
        self.relative = False
        self.feed = 0.0
        self._queue: deque[tuple[float, float]] = deque()  # goal, deg, and feed, deg/s; the first is under way
        self._joints: deque[float] = deque()  # when each is over, s
        self._ends = -1e9  # when the pulses rest

    def of_axis(self, family: int) -> float:
        """Return the axis's own value of a family of settings: 100 steps/deg, 110 deg/min, 120 deg/s2, 130 deg.

        Parameters
        ----------
        family : int
            100, 110, 120 or 130.
        """
        return self.values[family + self.settings.axes.index(self.settings.axis)]

    def advance(self) -> None:
        """Come up to now: moves that are over leave the queue."""
        now = self.clock.now()
        _drop_done(self._queue, self._joints, now)
        if self.state in ("Jog", "Run") and not self._queue and now >= self._ends:
            self.state = "Idle"

    @property
    def full(self) -> bool:
        """Whether another move has to wait: its line is not answered until there is room."""
        return len(self._queue) > BUFFER

    @property
    def moving(self) -> bool:
        """Whether pulses are being sent."""
        return self.clock.now() < self._ends

    @property
    def energised(self) -> bool:
        """Whether the motor has current: always with $1=255, else while it moves and for $1 ms after."""
        if not self.stepper.energised or self.state == "Sleep":
            return False
        now = self.clock.now()
        return now < self._ends or self.values[1] == 255.0 or now - self._ends < self.values[1] * 1e-3

    def do(self, text: str) -> str:
        """Do one line of upper case without blanks; return what it prints, or raise Denied.

        Parameters
        ----------
        text : str
            The line.
        """
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
        if text in _INFORMATION:
            return _INFORMATION[text](self)
        if text == "$X":
            self.state = "Idle" if self.state == "Alarm" else self.state
            return f"[MSG:Caution: Unlocked]{EOL}"
        if text == "$H":
            raise Denied(5)
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
        wanted = move.target.get(self.settings.axis)
        end = self._queue[-1][0] if self._queue else self.stepper.pulses.at(max(self.clock.now(), self._ends))[0]
        relative = self.relative if move.relative is None else move.relative
        goal = end if wanted is None else (end + wanted if relative else wanted)
        if state == "Jog" and self.values[20] == 1.0 and not -self.of_axis(130) <= goal <= 0.0:
            raise Denied(15)
        steps = self.of_axis(100)
        self._queue.append((round(goal * steps) / steps, min(feed, self.of_axis(110)) / 60.0))
        if self.state == "Idle":
            self.state = state
        if self.state == state:
            self._plan()

    def _plan(self) -> None:
        # from where the pulses are now, or from where they will rest after a stop
        now = self.clock.now()
        _drop_done(self._queue, self._joints, now)
        begin = now if self._joints else max(now, self._ends)
        angle, rate = self.stepper.pulses.at(begin)
        moves, at = [], angle
        for goal, feed in self._queue:
            moves.append((goal - at, feed))
            at = goal
        legs, ends = plan(moves, rate, self.of_axis(120))
        self.stepper.ratio = self.of_axis(100) * self.settings.full_step_deg / self.settings.microsteps
        self.stepper.follow(begin, legs)
        self._joints = deque(begin + end for end in ends)
        self._ends = self._joints[-1]

    def _slow(self, deceleration: float) -> None:
        self._queue.clear()
        self._joints.clear()
        self._ends = self.stepper.slow(self.clock.now(), deceleration)

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
        if letter == "?":
            return _report(self)
        if letter in ("!", "\x85") and self.state == "Jog":
            self._slow(self.of_axis(120))
        elif letter == "!" and self.state == "Run":
            waiting = list(self._queue)
            self._slow(self.of_axis(120))
            self._queue.extend(waiting)
            self.state = "Hold"
        elif letter == "~" and self.state == "Hold" and not self.moving:
            self.state = "Run"
            self._plan()
        elif letter == "\x18":
            return self.reset()
        return ""

    def reset(self) -> str:
        """Start afresh; a reset in motion loses the position and locks.

        Returns
        -------
        str
            What it prints.
        """
        lost = self.moving
        if lost:
            self._slow(AT_ONCE)
        self.start()
        if lost:
            self.state = "Alarm"
        return (f"ALARM:3{EOL}" if lost else "") + greeting(self.settings)

    def alarm(self, number: int) -> str:
        """Stop at once and lock.

        Parameters
        ----------
        number : int
            Of the alarm.

        Returns
        -------
        str
            What it prints.
        """
        self._slow(AT_ONCE)
        self.state = "Alarm"
        return f"ALARM:{number}{EOL}[MSG:Reset to continue]{EOL}"


def answer(board: Board, text: str) -> str:
    """Do one line.

    Parameters
    ----------
    board : Board
        The board.
    text : str
        Without its line end.

    Returns
    -------
    str
        What it prints, and `ok` or `error:n`.
    """
    try:
        return board.do(text.strip().upper().replace(" ", "")) + "ok" + EOL
    except Denied as denial:
        return f"error:{denial.code}{EOL}"


def greeting(settings: GrblSettings) -> str:
    """Return what a board prints when it starts.

    Parameters
    ----------
    settings : GrblSettings
        Which board.
    """
    return f"{EOL}Grbl {settings.version} ['$' for help]{EOL}"


def _report(board: Board) -> str:
    now, axis, steps = board.clock.now(), board.settings.axis, board.of_axis(100)
    angle, rate = board.stepper.pulses.at(now)
    places = [round(angle * steps) / steps if letter == axis else 0.0 for letter in board.settings.axes]
    state = f"Hold:{int(board.moving)}" if board.state == "Hold" else board.state
    pins = f"|Pn:{axis}" if board.limit_pressed else ""
    shown = ",".join(f"{place:.3f}" for place in places)
    return f"<{state}|MPos:{shown}|FS:{round(abs(rate) * 60.0)},0{pins}>{EOL}"


def _list_settings(board: Board) -> str:
    decimals = {number: 3 if number >= 100 or number in (11, 12, 24, 25, 27) else 0 for number in board.values}
    return "".join(f"${number}={value:.{decimals[number]}f}{EOL}" for number, value in board.values.items())


_INFORMATION: dict[str, Callable[[Board], str]] = {
    "$$": _list_settings,
    "$": lambda board: f"[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]{EOL}",
    "$I": lambda board: f"[VER:{board.settings.version}.20190825:]{EOL}[OPT:V,15,128]{EOL}",
    "$G": lambda board: (
        f"[GC:G0 G54 G17 G21 {'G91' if board.relative else 'G90'} G94 M5 M9 T0 F{board.feed:g} S0]{EOL}"
    ),
}


def _defaults(s: GrblSettings) -> dict[int, float]:
    values = {0: 10.0, 1: 25.0, 2: 0.0, 3: 0.0, 4: 0.0, 5: 0.0, 6: 0.0, 10: 1.0, 11: 0.01, 12: 0.002, 13: 0.0}
    values |= {20: 0.0, 21: 1.0, 22: 0.0, 23: 0.0, 24: 25.0, 25: 500.0, 26: 250.0, 27: 1.0}
    values |= {30: 1000.0, 31: 0.0, 32: 0.0}
    for place in range(len(s.axes)):
        values[100 + place] = round(s.microsteps / s.full_step_deg, 3)
        values[110 + place] = s.max_rate_deg_per_min
        values[120 + place] = s.acceleration_deg_s2
        values[130 + place] = 360.0
    return dict(sorted(values.items()))


def _drop_done(queue: "deque[tuple[float, float]]", joints: "deque[float]", now: float) -> None:
    """Let moves that are over leave the queue."""
    while queue and joints and now >= joints[0]:
        queue.popleft()
        joints.popleft()
