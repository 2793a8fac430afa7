"""Grbl: an emulated stepper board behind the bytes of its clients, its planner, and the faults it may suffer.

Lines end with a line feed and are answered `ok` or `error:n`; `?` `!` 0x18 0x85 are taken at once, wherever they stand. What
the pulses say and what the shaft does are two paths of constant accelerations, since a motor without current loses steps; a ripple
of its detents adds to the shaft. Moves that go the same way follow each other without a rest between. The speed at a joint is the
slower feed of the two moves, or zero where the way turns; no move may be entered faster than it can be left, v_in^2 <= v_out^2 +
2 a d. An axis that is too fast for what is left, or goes the other way, comes to rest first and returns.
"""

import bisect
import math
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from testkit.emulated.server import ClientSession, Machine
from undrift.arrays import FloatArray
from undrift.base.clock import Clock
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

# ---- Words of a stepper board: jogs as a driver sends them, `$n=value`, and the codes of what is wrong with them.

_JOG = re.compile(r"(?:G91|G21)+([A-Z])([-+]?\d+\.?\d*)F(\d+\.?\d*)")
_SETTING = re.compile(r"\$(\d+)=(.*)")


class Denied(Exception):
    """The board answers `error:n`."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error:{code}")
        self.code = code


def deny_if(wrong: object, code: int) -> None:
    """Deny a line where something is wrong."""
    if wrong:
        raise Denied(code)


def parse_jog(text: str, axis: str) -> tuple[float, float]:
    """Read what stands behind `$J=`: a distance, deg, and a feed, deg/min."""
    match = _JOG.fullmatch(text)
    if match is None or match.group(1) != axis:
        raise Denied(20)
    deny_if(not (feed := float(match.group(3))), 22)
    return float(match.group(2)), feed


def parse_setting(text: str, known: dict[int, float]) -> tuple[int, float]:
    """Read `$n=value`."""
    match = _SETTING.fullmatch(text)
    if match is None or len(match.group(1)) > 3 or int(match.group(1)) not in known:
        raise Denied(3)
    try:
        value = float(match.group(2))
    except ValueError:
        raise Denied(2) from None
    deny_if(not value >= 0.0 or value > 1e9, 4)
    number = int(match.group(1))
    deny_if(value == 0.0 and number >= 100, 4)
    return number, value


# ---- Stepper: a shaft that follows a planned path, a ripple of its detents apart.

GRIP = 1e6  # deg/s2: a motor that gets its current back holds at once


class Path:
    """Pieces of constant acceleration: when each begins, s; angle, rate and acceleration at its beginning, deg."""

    def __init__(self) -> None:
        self.start, self.pieces = [0.0], [(0.0, 0.0, 0.0)]

    def at(self, time: float) -> tuple[float, float]:
        """Return angle and rate at a moment."""
        angle, rate = self.many(np.array([time]))
        return float(angle[0]), float(rate[0])

    def many(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angle and rate at many moments: times (n,) s -> (n,) deg."""
        # only what is asked for
        first = max(bisect.bisect_right(self.start, float(times.min(initial=math.inf))) - 1, 0)
        start, (angle, rate, acceleration) = np.array(self.start[first:]), np.array(self.pieces[first:]).T
        i = np.clip(np.searchsorted(start, times, side="right") - 1, 0, None)
        t = times - start[i]
        return angle[i] + t * (rate[i] + 0.5 * acceleration[i] * t), rate[i] + acceleration[i] * t

    def cut(self, time: float) -> None:
        """Forget what was planned after a moment; the move under way there never ends."""
        keep = max(bisect.bisect_right(self.start, time), 1)
        del self.start[keep:], self.pieces[keep:]

    def go(self, time: float, angle: float, rate: float, acceleration: float) -> None:
        """Add a piece at the end."""
        self.start.append(time)
        self.pieces.append((angle, rate, acceleration))

    def slow(self, time: float, deceleration: float) -> float:
        """Come to rest from whatever goes on at a moment."""
        rate = self.at(time)[1]
        return self.follow(time, rate, [(abs(rate) / deceleration, -math.copysign(deceleration, rate))])

    def follow(self, time: float, rate: float, legs: "list[Leg]") -> float:
        """Replace what was planned by legs of constant acceleration, after which the axis rests."""
        angle, _ = self.at(time)
        self.cut(time)
        for duration, acceleration in legs:
            self.go(time, angle, rate, acceleration)
            angle += duration * (rate + 0.5 * acceleration * duration)
            rate += acceleration * duration
            time += duration
        self.go(time, angle, 0.0, 0.0)
        return time


class Stepper:
    """The pulses of a board and the shaft that follows them while its motor has current."""

    def __init__(self) -> None:
        self.pulses, self.shaft = Path(), Path()
        self.energised = True
        # deg of the shaft in a deg of the pulses: what the steps-per-degree setting makes of a true step
        self.ratio = 1.0

    def follow(self, time: float, legs: list[tuple[float, float]]) -> None:
        """Replace what was planned."""
        _, rate = self.pulses.at(time)
        self.pulses.follow(time, rate, legs)
        if self.energised:
            self.shaft.follow(time, self.ratio * rate, [(duration, self.ratio * a) for duration, a in legs])

    def slow(self, time: float, deceleration: float) -> float:
        """Come to rest."""
        if self.energised:
            self.shaft.slow(time, self.ratio * deceleration)
        return self.pulses.slow(time, deceleration)

    def set_current(self, time: float, on: bool, coast: float) -> None:
        """Switch the motor's current; without it the shaft coasts and the pulses go on by themselves."""
        if self.energised != on:
            self.shaft.slow(time, GRIP if on else coast)
        self.energised = on


# ---- Planner: moves that follow each other on one axis without a rest between, where they go the same way.

Leg = tuple[float, float]  # duration, s, and acceleration
DONE = 1e-6  # deg: a move with less to go is over; far less than a step
ROUNDING = 1e-6  # of a speed


def plan(moves: list[tuple[float, float]], rate: float, acceleration: float) -> tuple[list[Leg], list[float]]:
    """Return the legs of constant acceleration that a chain of moves is made of: they end at rest, where the last move ends."""
    todo, part_of = _merged(moves)
    ends = [0.0]
    speeds = _speeds(todo, abs(rate), acceleration)
    allowed = _reach(speeds[1], todo[0][0], acceleration) * (1.0 + ROUNDING)
    legs: list[Leg] = []
    if rate != 0.0 and (rate * todo[0][0] <= 0.0 or abs(rate) > allowed):
        legs.append((abs(rate) / acceleration, -math.copysign(acceleration, rate)))
        todo[0] = (todo[0][0] - 0.5 * rate * abs(rate) / acceleration, todo[0][1])
        speeds = _speeds(todo, 0.0, acceleration)
    time = sum(duration for duration, _ in legs)
    for (distance, feed), enter, leave in zip(todo, speeds[:-1], speeds[1:], strict=True):
        for duration, change in _legs(abs(distance), feed, enter, leave, acceleration):
            legs.append((duration, math.copysign(1.0, distance) * change))
            time += duration
        ends.append(time)
    return legs, [ends[part] for part in part_of]


def _merged(moves: list[tuple[float, float]]) -> tuple[list[tuple[float, float]], list[int]]:
    """Return the chain with moves shorter than a step joined to a neighbour, and how many of the chain end with each move."""
    todo: list[tuple[float, float]] = []
    part_of: list[int] = []
    for distance, feed in moves:
        if todo and abs(todo[-1][0]) < DONE:
            distance, part_of[-1] = distance + todo.pop()[0], len(todo)
        todo.append((distance, feed))
        part_of.append(len(todo))
    if len(todo) > 1 and abs(todo[-1][0]) < DONE:
        left, _ = todo.pop()
        todo[-1], part_of[-1] = (todo[-1][0] + left, todo[-1][1]), len(todo)
    return todo, part_of


def _speeds(moves: list[tuple[float, float]], enter: float, acceleration: float) -> list[float]:
    """Return the speeds at the joints: none that cannot be braked from, none that cannot be reached."""
    count = len(moves)
    joints = [min(one[1], next_[1]) if one[0] * next_[0] > 0.0 else 0.0 for one, next_ in pairwise(moves)]
    speeds = [enter, *joints, 0.0]
    for i in range(count - 1, 0, -1):
        speeds[i] = min(speeds[i], _reach(speeds[i + 1], moves[i][0], acceleration))
    for i in range(count):
        speeds[i + 1] = min(speeds[i + 1], _reach(speeds[i], moves[i][0], acceleration))
    return speeds


def _reach(speed: float, distance: float, acceleration: float) -> float:
    return math.sqrt(speed * speed + 2.0 * acceleration * abs(distance))


def _legs(distance: float, feed: float, enter: float, leave: float, a: float) -> list[Leg]:
    if distance == 0.0:
        return []
    if enter >= _reach(leave, distance, a):  # by rounding: brake that little harder
        duration = 2.0 * distance / (enter + leave)
        return [(duration, (leave - enter) / duration)]
    peak = max(min(feed, math.sqrt(a * distance + 0.5 * (enter * enter + leave * leave))), leave)
    change = abs(peak - enter) / a
    down = (peak - leave) / a
    level = (distance - 0.5 * (enter + peak) * change - 0.5 * (peak + leave) * down) / peak
    legs = ((change, math.copysign(a, peak - enter)), (max(level, 0.0), 0.0), (down, -a))
    return [leg for leg in legs if leg[0] > 0.0]


# ---- Board: what a stepper board does with its lines and its real-time characters: states, moves, settings, alarms.

BUFFER = 15  # moves that may wait
EOL = "\r\n"
AT_ONCE = 1e6  # deg/s2: a reset or a limit cuts the pulses


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblSettings:
    """What kind of board, motor and table it is."""

    axes: str = "XYZA"  # Letters of the board's axes, in the order of its reports
    axis: str = "A"  # The one that turns the table
    version: str = "1.1h"  # In its greeting
    full_step_deg: float = 1.8  # Of the table, deg
    microsteps: int = 16  # In a full step
    ripple_deg: float = 0.02  # Detent ripple, amplitude, deg
    max_rate_deg_per_min: float = 21_600.0  # $11n and $12n at power-up
    acceleration_deg_s2: float = 500.0
    coast_deg_s2: float = 400.0  # How fast friction stops the table without current, deg/s2

    def __post_init__(self) -> None:
        if len(self.axis) != 1 or self.axis not in self.axes:
            raise InputError(f"grbl axis: wanted one of {', '.join(self.axes)}, got '{self.axis}'; name one of them")


class GrblBoard:
    """The controller; time is the clock's."""

    def __init__(self, settings: GrblSettings, clock: Clock) -> None:
        self.settings, self.clock = settings, clock
        self.stepper = Stepper()
        self.limit_pressed = False
        steps_per_deg = round(settings.microsteps / settings.full_step_deg, 3)
        families = (steps_per_deg, settings.max_rate_deg_per_min, settings.acceleration_deg_s2)  # $100, $110, $120 on
        own = {100 + 10 * k + n: value for k, value in enumerate(families) for n in range(len(settings.axes))}
        self.values = {1: 25.0, 21: 1.0} | own  # ms of current after a motion; limit switches count
        self.start()

    def start(self) -> None:
        """Start afresh: idle, nothing waiting, settings kept."""
        self.state = "Idle"
        self._queue: deque[tuple[float, float]] = deque()  # goal, deg, and feed, deg/s; the first is under way
        self._joints: deque[float] = deque()  # when each is over, s
        self._ends = -1e9  # when the pulses rest

    def of_axis(self, family: int) -> float:
        """Return the axis's own value of a family of settings: 100 steps/deg, 110 deg/min, 120 deg/s2."""
        return self.values[family + self.settings.axes.index(self.settings.axis)]

    def advance(self) -> None:
        """Come up to now: moves that are over leave the queue."""
        now = self.clock.now()
        self._drop_done(now)
        if self.state == "Jog" and not self._queue and now >= self._ends:
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

    def answer(self, text: str) -> str:
        """Do one line."""
        try:
            return self.do(text.strip().upper().replace(" ", "")) + "ok" + EOL
        except Denied as denial:
            return f"error:{denial.code}{EOL}"

    def do(self, text: str) -> str:
        """Do one line of upper case without blanks; return what it prints, or raise Denied."""
        if not text:
            return ""
        if text.startswith("$J="):
            if self.state not in ("Idle", "Jog"):
                raise Denied(9 if self.state in ("Alarm", "Sleep") else 8)
            self._add(*parse_jog(text[3:], self.settings.axis))
            return ""
        if text.startswith("$"):
            return self._dollar(text)
        deny_if(self.state in ("Alarm", "Sleep", "Jog"), 9)
        raise Denied(20)  # programs of G-code

    def _dollar(self, text: str) -> str:
        if text in _INFORMATION:
            return _INFORMATION[text](self)
        if text == "$X":
            self.state = "Idle" if self.state == "Alarm" else self.state
            return f"[MSG:Caution: Unlocked]{EOL}"
        deny_if(self.state not in ("Idle", "Alarm"), 8)
        if text == "$SLP":
            self.state = "Sleep"
            return f"[MSG:Sleeping]{EOL}"
        number, value = parse_setting(text, self.values)
        self.values[number] = value
        return ""

    def _add(self, distance: float, feed: float) -> None:
        end = self._queue[-1][0] if self._queue else self.stepper.pulses.at(max(self.clock.now(), self._ends))[0]
        steps = self.of_axis(100)
        self._queue.append((round((end + distance) * steps) / steps, min(feed, self.of_axis(110)) / 60.0))
        self.state = "Jog"
        self._plan()

    def _plan(self) -> None:
        # from where the pulses are now, or from where they will rest after a stop
        now = self.clock.now()
        self._drop_done(now)
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

    def _drop_done(self, now: float) -> None:
        while self._queue and self._joints and now >= self._joints[0]:
            self._queue.popleft()
            self._joints.popleft()

    def _slow(self, deceleration: float) -> None:
        self._queue.clear()
        self._joints.clear()
        self._ends = self.stepper.slow(self.clock.now(), deceleration)

    def at_once(self, letter: str) -> str:
        """Do a real-time character."""
        if letter == "?":
            return _report(self)
        if letter in ("!", "\x85") and self.state == "Jog":
            self._slow(self.of_axis(120))
        elif letter == "\x18":
            return self.reset()
        return ""

    def reset(self) -> str:
        """Start afresh; a reset in motion loses the position and locks."""
        lost = self.moving
        if lost:
            self._slow(AT_ONCE)
        self.start()
        if lost:
            self.state = "Alarm"
        return (f"ALARM:3{EOL}" if lost else "") + greeting(self.settings)

    def alarm(self, number: int) -> str:
        """Stop at once and lock."""
        self._slow(AT_ONCE)
        self.state = "Alarm"
        return f"ALARM:{number}{EOL}[MSG:Reset to continue]{EOL}"


def greeting(settings: GrblSettings) -> str:
    """Return what a board prints when it starts."""
    return f"{EOL}Grbl {settings.version} ['$' for help]{EOL}"


def _report(board: GrblBoard) -> str:
    now, axis, steps = board.clock.now(), board.settings.axis, board.of_axis(100)
    angle, rate = board.stepper.pulses.at(now)
    places = [round(angle * steps) / steps if letter == axis else 0.0 for letter in board.settings.axes]
    pins = f"|Pn:{axis}" if board.limit_pressed else ""
    shown = ",".join(f"{place:.3f}" for place in places)
    return f"<{board.state}|MPos:{shown}|FS:{round(abs(rate) * 60.0)},0{pins}>{EOL}"


_INFORMATION: dict[str, Callable[[GrblBoard], str]] = {
    "$$": lambda board: "".join(f"${n}={value:.{3 if n >= 100 else 0}f}{EOL}" for n, value in board.values.items()),
    "$I": lambda board: f"[VER:{board.settings.version}.20190825:]{EOL}[OPT:V,15,128]{EOL}",
}


# ---- Grbl: an emulated stepper board behind the bytes of its clients, and the faults it may suffer.

LINE_LENGTH = 80


class GrblMachine(Machine):
    """A board, its clock and its motor, for any number of clients."""

    def __init__(self, settings: GrblSettings, clock: Clock, history_s: float = 1200.0) -> None:
        super().__init__(clock)
        self.settings, self._history_s = settings, history_s
        self.board = GrblBoard(settings, clock)
        self._broken: set[str] = set()

    def new_session(self, serial: bool) -> "GrblSession":
        """Make what a client talks to."""
        return GrblSession(self)

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

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angle and rate of the axis, rad and rad/s, shape (n,): times (n,) s."""
        with self.lock:
            now = self.clock.now()
            self.tick()
            t = np.asarray(times, float)
            if t.size and (t.max() > now or t.min() < 0.0):
                raise InputError(
                    f"axis state: wanted times in 0..{now:.4f} s, got {t.min():.4f}..{t.max():.4f} s; ask for the past"
                )
            angle, rate = self.board.stepper.shaft.many(t)
            ripple, turns = self.settings.ripple_deg, 2.0 * math.pi / self.settings.full_step_deg  # of the detents
            rate = rate * (1.0 + ripple * turns * np.cos(turns * angle))
            return (angle + ripple * np.sin(turns * angle)) * RADIAN_PER_DEGREE, rate * RADIAN_PER_DEGREE

    def history(self, last_s: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Return time and angle of the past in 1 ms steps, s and rad, shape (n,)."""
        with self.lock:
            now = self.clock.now()
            first = max(0.0, now - (self._history_s if last_s is None else last_s))
            times = np.append(np.arange(first, now, 1e-3), now)
            return times, self.states(times)[0]

    def set_fault(self, name: str, on: bool) -> None:
        """Break or mend a part."""
        with self.lock:
            self.tick()
            (self._broken.add if on else self._broken.discard)(name)
            now, board = self.clock.now(), self.board
            if name in ("power_cut", "amplifier_fault"):
                current = not self._broken & {"power_cut", "amplifier_fault"}
                board.stepper.set_current(now, current, self.settings.coast_deg_s2)
                if name == "power_cut":
                    board.stepper.pulses.cut(now)  # they count from zero again
                    board.stepper.pulses.go(now, 0.0, 0.0, 0.0)
                    board.start()
            elif name in ("limit_switch", "limit_switch_reverse"):
                board.limit_pressed = bool(self._broken & {"limit_switch", "limit_switch_reverse"})
                if on and board.values[21] == 1.0:
                    self.tell(board.alarm(1))
            elif name == "abort_input" and on:
                self.tell(board.reset())
            elif name == "message" and on:
                self.tell(f"[MSG:Emulated message]{EOL}")


class GrblSession(ClientSession):
    """One client's bytes."""

    def __init__(self, machine: GrblMachine) -> None:
        super().__init__(machine)
        self._board, self._line = machine.board, ""
        self._lines: deque[str] = deque()  # those that wait for room among the moves

    def greet(self) -> bytes:
        """Return the greeting, as a board gives it when its port is opened."""
        return greeting(self._board.settings).encode()

    def unasked(self) -> bytes:
        """Return what the board says without being asked, since the last look."""
        with self._machine.lock:
            return super().unasked() + self._work().encode("latin-1")

    def _take(self, letter: str) -> str:
        if letter in "?!~\x18\x85":
            if letter == "\x18":
                self._line = ""
                self._lines.clear()
            return self._board.at_once(letter)
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
        board, answers = self._board, ""
        board.advance()
        while self._lines and not board.full:
            line = self._lines.popleft()
            answers += f"error:11{EOL}" if len(line) > LINE_LENGTH else board.answer(line)
        return answers
