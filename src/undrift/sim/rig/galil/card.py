"""Card: a one-axis motion controller: its settings, its motor, its motions and what ends them.

Time is the axis's; `advance` brings both up to a moment and handles what happened on the way, in order.
"""

import math
from collections import deque
from dataclasses import dataclass

from undrift.kernels import servo as k
from undrift.kernels.servo import Coefficients
from undrift.sim.rig.axis import Axis
from undrift.sim.rig.galil.words import (
    AT_LIMIT,
    BEGIN_RUNNING,
    JOG_ONLY,
    LARGEST,
    MOTOR_OFF,
    OUT_OF_RANGE,
    PERIOD_TIMEOUT,
    RUNNING,
    SETTINGS,
    STOP_ABORTED,
    STOP_ASKED,
    STOP_DONE,
    STOP_ERROR,
    STOP_FORWARD,
    STOP_REVERSE,
    STOP_RUNNING,
    Refused,
)
from undrift.sim.rig.servo import ServoSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class CardSettings:
    """What kind of card it is.

    Parameters
    ----------
    revision : str
        Answer to ^R^V.
    speed_step : int
        Resolution of JG, counts/s: 2 on older cards.
    minimum_sample_us : float
        Shortest TM that the card can keep, us; shorter is error 143.
    speeds_follow_sample_time : bool
        True for old firmware: speeds scale with TM and are not corrected.
    line_length : int
        Longest command, characters; longer is error 5.
    serial_timeout_s : float
        A line begun over a serial link and not ended for so long is dropped with error 131, emulated s.
    switches_deg : tuple of float or None
        Axis angles at which the reverse and the forward limit switch close.
    echo_serial : bool
        EO at power-up on a serial link.
    """

    revision: str = "DMC1415 Rev 1.0u"
    speed_step: int = 1
    minimum_sample_us: float = 62.5
    speeds_follow_sample_time: bool = False
    line_length: int = 80
    serial_timeout_s: float = 5.0
    switches_deg: tuple[float, float] | None = None
    echo_serial: bool = False


@dataclass(slots=True)
class Motion:
    """What the next BG starts, and what the last motion did.

    Parameters
    ----------
    kind : str
        JG, PR or PA: the one commanded last.
    jog : float
        counts/s.
    distance, target : float
        Of PR and PA, counts.
    running : bool
        A motion is in progress.
    reason : int
        Stop code that the present motion will end with.
    stop_code : int
        What SC tells.
    """

    kind: str = "PR"
    jog: float = 25_000.0
    distance: float = 0.0
    target: float = 0.0
    running: bool = False
    reason: int = STOP_DONE
    stop_code: int = STOP_DONE


@dataclass(slots=True)
class Wiring:
    """What is broken or pressed.

    Parameters
    ----------
    amplifier_fault, encoder_lost : bool
        No torque; a count that does not change.
    forward_pressed, reverse_pressed : bool
        Limit switches.
    powered : bool
        False after a power cut.
    """

    amplifier_fault: bool = False
    encoder_lost: bool = False
    forward_pressed: bool = False
    reverse_pressed: bool = False
    powered: bool = True


class Card:
    """The controller's state and what may be done to it; the language stands in galil.py.

    Parameters
    ----------
    servo : ServoSettings
        Loop, motor and encoder.
    settings : CardSettings
        Which card.
    history_s : float
        How far back the axis is remembered, s.
    """

    def __init__(self, servo: ServoSettings, settings: CardSettings, history_s: float = 1200.0) -> None:
        self.servo = servo
        self.settings = settings
        self.axis = Axis(servo, history_s)
        self.wiring = Wiring()
        self.unsolicited: deque[str] = deque(maxlen=1000)
        self.set_up()

    def set_up(self) -> None:
        """Set everything to what it is at power-up: motor off, the burned gains, position zero where the axis stands."""
        self.values = _power_up(self.servo)
        self.motion = Motion()
        self.motor_on = False
        self.variables: dict[str, float] = {}
        self.error_code = 0
        self.auxiliary = 0
        self.time_offset = self.axis.values[k.SAMPLES]
        self.axis.values[k.MODE] = k.REST
        self.axis.change(motor_on=False)
        self.axis.set_period(self.servo.period_s)
        self.apply()
        self.axis.define(0)

    def apply(self) -> None:
        """Hand settings and wiring on to the loop."""
        self.axis.coefficients = _coefficients(self)
        if self.motion.running and self.motion.kind == "JG" and self.axis.values[k.MODE] == k.JOG:
            self.axis.values[k.TARGET] = self.motion.jog * _speed_scale(self)

    @property
    def ticks(self) -> int:
        """Operand TIME: samples since reset in units of TM/1000, which are ms only to 2.4 % on cards that count 1/1024 s."""
        return int((self.axis.values[k.SAMPLES] - self.time_offset) * self.values["TM"] / 1000.0)

    def advance(self, time: float) -> None:
        """Bring the card up to a moment.

        Parameters
        ----------
        time : float
            Emulated time, s.
        """
        self._watch_amplifier()
        while (event := self.axis.advance(time)) != k.NOTHING:
            if event == k.DONE and self.motion.running:
                self._end(self.motion.reason)
            elif event in (k.FORWARD_LIMIT, k.REVERSE_LIMIT):
                self.motion.reason = STOP_FORWARD if event == k.FORWARD_LIMIT else STOP_REVERSE
                if self.values["OE"] >= 2.0:
                    self._off(self.motion.reason)
            elif event == k.ERROR_LIMIT and self.values["OE"] in (1.0, 3.0):
                self._off(STOP_ERROR)

    def motor(self, on: bool) -> None:
        """Switch the servo on where the axis stands, or off.

        Parameters
        ----------
        on : bool
            True for on.

        Raises
        ------
        Refused
            7, MO during a motion.
        """
        if not on:
            if self.motion.running:
                raise Refused(RUNNING)
            self._off(self.motion.stop_code)
            return
        if self.motor_on:
            return
        values = self.axis.values
        values[k.REFERENCE], values[k.SPEED] = self.axis.register, 0.0
        values[k.SUM] = values[k.LAST] = values[k.ERROR] = values[k.OVER] = 0.0
        values[k.MODE] = k.REST
        self.motor_on = True
        self.axis.change(motor_on=True)
        self._watch_amplifier()

    def jog(self, speed: float) -> None:
        """Take a jog speed; a jog that runs takes it at once.

        Parameters
        ----------
        speed : float
            counts/s, signed; truncated to the card's resolution.

        Raises
        ------
        Refused
            13 during a positioning move, 6 out of range.
        """
        if self.motion.running and self.motion.kind != "JG":
            raise Refused(JOG_ONLY)
        if abs(speed) > SETTINGS["SP"].high:
            raise Refused(OUT_OF_RANGE)
        self.motion.jog = float(math.trunc(speed / self.settings.speed_step) * self.settings.speed_step)
        self.motion.kind = "JG"
        self.apply()

    def aim(self, kind: str, counts: float) -> None:
        """Take the target of a positioning move.

        Parameters
        ----------
        kind : str
            PR or PA.
        counts : float
            Distance or position, counts.

        Raises
        ------
        Refused
            7 during a motion, 6 out of range.
        """
        if self.motion.running:
            raise Refused(RUNNING)
        if abs(counts) > LARGEST:
            raise Refused(OUT_OF_RANGE)
        self.motion.kind = kind
        if kind == "PR":
            self.motion.distance = float(math.trunc(counts))
        else:
            self.motion.target = float(math.trunc(counts))

    def begin(self) -> None:
        """Start the motion commanded last.

        Raises
        ------
        Refused
            20 motor off, 21 already running, 22 toward a closed limit switch.
        """
        if not self.motor_on:
            raise Refused(MOTOR_OFF)
        if self.motion.running:
            raise Refused(BEGIN_RUNNING)
        values = self.axis.values
        target = self.motion.target if self.motion.kind == "PA" else values[k.REFERENCE] + self.motion.distance
        way = self.motion.jog if self.motion.kind == "JG" else target - values[k.REFERENCE]
        at_forward, at_reverse = limits_closed(self)
        if (way > 0.0 and at_forward) or (way < 0.0 and at_reverse):
            raise Refused(AT_LIMIT)
        self.motion.running, self.motion.reason, self.motion.stop_code = True, STOP_DONE, STOP_RUNNING
        values[k.MODE] = k.JOG if self.motion.kind == "JG" else k.MOVE
        values[k.TARGET] = target
        self.apply()

    def stop(self) -> None:
        """Slow down to rest; the motor stays on."""
        if self.motion.running:
            self.axis.values[k.MODE] = k.STOPPING
            self.motion.reason = STOP_ASKED

    def abort(self, stop_code: int = STOP_ABORTED) -> None:
        """Stop the profile at once; the motor stays on.

        Parameters
        ----------
        stop_code : int
            What SC tells afterwards.
        """
        self.axis.values[k.MODE], self.axis.values[k.SPEED] = k.REST, 0.0
        if self.motion.running:
            self._end(stop_code)

    def _end(self, stop_code: int) -> None:
        self.motion.running = False
        self.motion.stop_code = stop_code

    def _off(self, stop_code: int) -> None:
        self.motor_on = False
        self.axis.change(motor_on=False)
        self.axis.values[k.MODE], self.axis.values[k.SPEED] = k.REST, 0.0
        self._end(stop_code)

    def _watch_amplifier(self) -> None:
        if self.wiring.amplifier_fault and self.motor_on and self.values["OE"] in (1.0, 3.0):
            self._off(STOP_ERROR)


def set_sample_time(card: Card, microseconds: float) -> None:
    """Change TM. Multiples of 125 us are counted in 1/1024 s: TM 1000 is 976.6 us.

    Parameters
    ----------
    card : Card
        The card.
    microseconds : float
        us.

    Raises
    ------
    Refused
        143, shorter than the card can keep.
    """
    if microseconds < card.settings.minimum_sample_us:
        raise Refused(PERIOD_TIMEOUT)
    ticks = card.ticks
    old_card = microseconds % 125.0 == 0.0
    card.axis.set_period(microseconds * (1e-3 / 1024.0 if old_card else 1e-6))
    card.values["TM"] = microseconds
    card.time_offset = card.axis.values[k.SAMPLES] - ticks * 1000.0 / microseconds
    card.apply()


def limits_closed(card: Card) -> tuple[bool, bool]:
    """Tell whether the card may not go forward, or back: a switch is active, or the reference is beyond FL or BL.

    Parameters
    ----------
    card : Card
        The card.

    Returns
    -------
    tuple of bool
        Forward, reverse.
    """
    c, count, reference = card.axis.coefficients, card.axis.values[k.COUNT], card.axis.values[k.REFERENCE]
    forward = c.forward_closed or count >= c.forward_at or reference > c.forward
    reverse = c.reverse_closed or count <= c.reverse_at or reference < c.reverse
    return bool(forward), bool(reverse)


def _power_up(servo: ServoSettings) -> dict[str, float]:
    values = {name: setting.default for name, setting in SETTINGS.items()}
    values |= dict(zip(("KP", "KD", "KI"), servo.gains, strict=True))
    return values | {"TM": servo.period_s * 1e6, "TL": min(servo.voltage_limit, SETTINGS["TL"].high)}


def _speed_scale(card: Card) -> float:
    period = card.axis.coefficients.period
    return card.servo.period_s / period if card.settings.speeds_follow_sample_time else 1.0


def _coefficients(card: Card) -> Coefficients:
    v, w, scale = card.values, card.wiring, _speed_scale(card)
    low, high = card.settings.switches_deg or (-math.inf, math.inf)
    high_level = v["CN"] == 1.0  # then a switch that is not pressed counts as active
    return card.axis.coefficients._replace(
        proportional=4.0 * v["KP"],
        derivative=4.0 * v["KD"],
        integral=0.5 * v["KI"],
        clip=card.servo.voltage_limit if v["TL"] >= SETTINGS["TL"].high else v["TL"],
        acceleration=v["AC"] * scale**2,
        deceleration=v["DC"] * scale**2,
        slew=max(v["SP"] * scale, 1e-9),
        error_limit=v["ER"] if v["ER"] > 0.0 else math.inf,
        forward=v["FL"],
        reverse=v["BL"],
        powered=w.powered,
        amplifier_good=not w.amplifier_fault,
        encoder_good=not w.encoder_lost,
        forward_closed=w.forward_pressed != high_level,
        reverse_closed=w.reverse_pressed != high_level,
        forward_at=math.radians(high) * card.servo.counts_per_rad,
        reverse_at=math.radians(low) * card.servo.counts_per_rad,
    )
