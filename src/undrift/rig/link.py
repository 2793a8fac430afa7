"""Links to rigs: questions and answers, each with a deadline, over TCP or a serial port, and the procedure of all controllers.

The caller that asks also reads the answer. Bytes that arrive between two exchanges are discarded. After an answer that is too late,
the link is out of step: the late answer would be read as the next one. Such a link raises LinkError until an exchange with `anew`
has resynchronised it.

A link is opened with a URL: ``tcp://host:port``, ``serial:///dev/ttyUSB0`` or a plain path (for example of a pty). The pyserial
URLs ``socket://host:port`` and ``loop://`` are also accepted.

A controller differs from another only in its commands, and in its units of position: counts or degrees.
"""

import contextlib
import logging
import math
import re
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager

from undrift.base.clock import HOST, Clock, Port
from undrift.errors import InputError, LinkError, RigError, RigFault, RigTimeout
from undrift.live.transports import POLL_S, host_and_port, open_port, reason_of
from undrift.rig.rig import Position, RigSettings

LONGEST_REPLY = 65536  # longest reply that is accepted, bytes

log = logging.getLogger(__name__)


def connect(url: str, baud: int, clock: Clock) -> Port:
    """Open the port of a URL."""
    is_tcp, is_serial = url.startswith("tcp://"), url.startswith(("serial://", "socket://", "loop://", "/", "COM"))
    if not (is_tcp and all(host_and_port(url.removeprefix("tcp:")))) and (not is_serial or url == "serial://"):
        raise InputError(
            f"link: expected tcp://host:port, serial:///path, a path, socket://host:port or loop://, got '{url}'. Enter the "
            "connection of the rig."
        )
    try:
        return open_port(url, baud, clock)
    except (OSError, ValueError) as error:  # pyserial's SerialException is an OSError
        raise LinkError(f"{url}: cannot connect ({reason_of(error)}). Check power, cable and address.") from error


class Link(AbstractContextManager["Link"]):
    """A connection that is open from its construction until `close`."""

    terminator = "\n"  # end of a question
    immediate = ""  # questions of one character, which have no terminator
    reply_end = re.compile(rb"\n")  # end of the first whole reply in the received bytes

    def __init__(self, url: str, *, reply_timeout_s: float = 2.0, baud: int = 19200, clock: Clock = HOST) -> None:
        self.name, self.reply_timeout_s, self.clock = url, reply_timeout_s, clock
        self._baud = baud
        self._lost = ""  # reason why the connection is lost
        self._received, self._in_step = bytearray(), True
        self._port = connect(url, baud, clock)

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Return True unless the connection is known to be lost."""
        self._listen(0.0)
        return not self._lost

    def exchange(
        self, text: str, wait_s: float | None = None, *, until: re.Pattern[bytes] | None = None, anew: bool = False
    ) -> str:
        """Send a question and return the answer. With `anew`, the question has a unique answer, so the link is in step again."""
        if not (self._in_step or anew):
            raise LinkError(
                f"{self.name}: cannot send '{text}', the link is out of step with its device. Resynchronise it first."
            )
        self._in_step = False  # stays False if an exception (also Ctrl-C) prevents reading the answer
        while self._listen(0.0) and len(self._received) < LONGEST_REPLY:
            pass
        self._received.clear()
        self.send((text if text in self.immediate else text + self.terminator).encode("latin-1"))
        reply = self._wait_for(text, until or self.reply_end, self.reply_timeout_s if wait_s is None else wait_s)
        self._in_step = True
        try:
            return reply.decode("ascii", errors="backslashreplace" if anew else "strict")
        except UnicodeDecodeError as error:
            raise LinkError(
                f"{self.name}: the answer to '{text}' is not text: {reply[:80]!r}. Check baud rate and cable."
            ) from error

    def send(self, data: bytes) -> None:
        """Send bytes without waiting for an answer."""
        if self._lost:
            raise LinkError(f"{self.name}: the link is lost ({self._lost}). Reconnect it.")
        try:
            self._port.write(data)
        except OSError as error:
            self._lose(reason_of(error))
            raise LinkError(f"{self.name}: cannot send ({error}). Check the cable and reconnect.") from error

    def reconnect(self) -> None:
        """Close the link and open it again, with empty buffers."""
        self.disconnect()
        self._port = connect(self.name, self._baud, self.clock)
        self._lost, self._in_step = "", True
        self._received.clear()

    def close(self) -> None:
        """Close the connection. A second call has no effect."""
        self.disconnect()

    def disconnect(self) -> None:
        """Close the connection."""
        self._lose("closed")
        self._port.close()

    def _lose(self, reason: str) -> None:
        self._lost = self._lost or reason
        log.info("link %s: %s", self.name, reason)

    def _listen(self, wait_s: float) -> bool:
        """Receive the bytes that arrive within a time, and return True if any arrived."""
        if self._lost:
            return False
        try:
            data = self._port.receive(wait_s)
        except (OSError, EOFError) as error:
            self._lose(reason_of(error))
            return False
        self._received.extend(data)
        return bool(data)

    def _wait_for(self, text: str, reply_end: re.Pattern[bytes], wait_s: float) -> bytes:
        """Wait for the whole reply to a question and remove it from the buffer."""
        last = self.clock.now() + wait_s
        while not (match := reply_end.search(self._received)):
            beginning, left_s = bytes(self._received[:80]), last - self.clock.now()
            if len(self._received) > LONGEST_REPLY:
                raise LinkError(
                    f"{self.name}: the answer to '{text}' does not end, it starts with {beginning!r}. Check the baud rate."
                )
            if self._lost:
                raise LinkError(f"{self.name}: no answer to '{text}', the link is lost ({self._lost}). Reconnect it.")
            if left_s <= 0.0:
                received = f"only {beginning!r}" if beginning else "nothing"
                raise RigTimeout(
                    f"{self.name}: no answer to '{text}' within {wait_s:g} s, got {received}. Check power and cable.",
                    deadline_s=wait_s,
                )
            self._listen(min(left_s, POLL_S))
        reply = bytes(self._received[: match.end()])
        self._received = self._received[match.end() :]
        return reply


# ---- A rig with a link. A controller has its own commands, and the procedure is the same for all.

RECONNECTIONS = 4
STOP_MARGIN_S = 2.0  # added to twice the expected stopping time, s


class LinkedRig(Link):
    """A rig with a link. A subclass has the commands of its controller. The unit of positions is a count or a degree."""

    stopped = unconfirmed = ""  # state of the table after a failure, for messages
    halt = b""  # command that ends a move
    last_words: tuple[bytes, ...] = ()  # commands to a controller that does not answer
    unit, rad_per_unit = "", 1.0  # unit of positions, rad
    slack = 0.0  # tolerance of the check of positions, units
    baud, default_axis = 0, ""  # bits per second, and letter
    axes: Sequence[str] = ()  # letters of the axes

    def __init__(self, url: str, settings: RigSettings = RigSettings()) -> None:
        self.limits, self.axis = settings.limits, settings.axis or self.default_axis
        if self.axis not in self.axes:
            letters = ", ".join(self.axes)
            raise InputError(f"rig: axis must be one of {letters}, got '{self.axis}'. Set another axis.")
        self._enabled = False
        self._refused = ""  # reason to refuse all commands
        self._acceleration = math.inf  # acceleration of both ramps, units/s2
        self._fastest = math.inf  # largest rate, units/s
        self._home = 0.0  # position when the rig was opened, units
        self._last = math.nan  # last position, units (NaN until the first one)
        self._asked_s = 0.0  # time of its question, s
        baud = settings.baud or self.baud
        super().__init__(url, reply_timeout_s=settings.reply_timeout_s, baud=baud, clock=settings.clock)
        try:
            self._prepare(settings)
        except RigError:
            self.disconnect()
            raise

    # ---- Commands of a controller

    @abstractmethod
    def _prepare(self, settings: RigSettings) -> None:
        """Check that the table is free, configure the controller and store the initial position."""

    @abstractmethod
    def _switch(self, on: bool) -> bool:
        """Switch the motor on or off, and return True if the controller confirms it."""

    @abstractmethod
    def _set_ramps(self, acceleration: float) -> float:
        """Set the acceleration of both ramps, units/s2, and return the acceleration that was read back."""

    @abstractmethod
    def _plan_move(self, rate: float, seconds: float) -> tuple[float, float]:
        """Return the nearest rate and distance of the controller, units/s and units, or raise LimitError."""

    @abstractmethod
    def _move(self, rate: float, distance: float) -> float:
        """Start a move by a distance, units, and return the magnitude of the rate that the controller has set, units/s."""

    @abstractmethod
    def _is_moving(self) -> bool:
        """Return True if the axis moves."""

    @abstractmethod
    def _halt(self) -> None:
        """End the move with a ramp, without waiting for its end."""

    @abstractmethod
    def _come_to_rest(self) -> None:
        """Put the link in step with a question that has a unique answer. Then stop the axis, with an abort or reset if needed."""

    @abstractmethod
    def _ask_position(self) -> float:
        """Return the position that the controller reports, units."""

    # ---- Procedure

    def enable(self, on: bool) -> None:
        """Stop the axis if it moves, and switch the motor on or off."""
        with self._guarded():
            if self._is_moving():
                self._stop()
                self._read_position()
            if not self._switch(on):
                word = "on" if on else "off"
                raise RigFault(f"{self.name}: the motor did not switch {word}. Check the amplifier.")
            self._enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set the acceleration of both ramps and return the achieved acceleration, rad/s2."""
        self.limits.check_acceleration(acceleration)
        with self._guarded():
            self._acceleration = self._set_ramps(acceleration / self.rad_per_unit)
        return self._acceleration * self.rad_per_unit

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for a time that includes both ramps, as one finite move. Return the rate of the controller."""
        self.limits.check_turn_rate(turn_rate)
        rate, distance = self._plan_move(turn_rate / self.rad_per_unit, seconds)
        self.limits.check_travel((self._last - self._home + distance) * self.rad_per_unit)
        with self._guarded():
            if self._is_moving():
                raise RigFault(f"{self.name}: the axis still moves. Stop it first.")
            actual = self._move(rate, distance)
        return math.copysign(actual, rate) * self.rad_per_unit

    def stop(self) -> None:
        """Slow down and wait until the axis is at rest. The motor stays on."""
        with self._guarded():
            self._stop()
            before = self._read_position()
            for _ in range(50):  # a servo settles after its profile ends
                self.clock.wait(0.02)
                position = self._read_position()
                if abs(position - before) <= 1.0:
                    break
                before = position

    def position(self) -> Position:
        """Return the angle since the rig was opened, rad, timed half-way between question and answer."""
        with self._guarded():
            asked_s = self.clock.now()
            angle = (self._read_position() - self._home) * self.rad_per_unit
            answered_s = self.clock.now()
        return Position(angle=angle, time=0.5 * (asked_s + answered_s), within_s=0.5 * (answered_s - asked_s))

    def close(self) -> None:
        """Stop, switch the motor off and close the link. A second call has no effect."""
        if self._refused == "it is closed":
            return
        try:
            confirmed = self._make_safe()
        finally:
            self._refused = "it is closed"
            self.disconnect()
        if not confirmed:
            raise LinkError(f"{self.name}: no answer when the motor was switched off at the end. {self.unconfirmed}")

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Raise LinkError if the rig is closed or lost. If the link fails within the block, make the table safe first."""
        if self._refused:
            raise LinkError(f"{self.name}: the rig accepts no commands ({self._refused}). Open it again.")
        try:
            yield
        except (LinkError, RigTimeout) as error:
            outcome = self.stopped if self._make_safe() else self.unconfirmed
            raise type(error)(f"{error} {outcome}", **error.numbers) from error

    def _make_safe(self) -> bool:
        """Stop and switch the motor off, and reconnect first if the link is lost. Return True if the controller confirms it."""
        self._enabled = False
        try:
            if not self.is_open:
                self._refused = "the connection was lost, and the controller may have lost its settings"
                self._reconnect()
            self.shout(self.halt)  # at once (the next line discards the answer)
            self._come_to_rest()
            return self._switch(False)
        except RigError as error:
            log.error("%s: not confirmed at rest: %s", self.name, error)
            self._refused = "it could not be brought to rest"
            for command in self.last_words:  # the controller may still receive commands
                self.shout(command)
                self.clock.wait(0.05)
            return False

    def shout(self, command: bytes) -> None:
        """Send without waiting for an answer. The next question reports a lost link."""
        with contextlib.suppress(RigError):
            self.send(command)

    def _reconnect(self) -> None:
        """Reconnect, with repeated attempts, because a controller does not answer immediately after a restart."""
        for _ in range(RECONNECTIONS - 1):
            with contextlib.suppress(LinkError):
                return self.reconnect()
            self.clock.wait(0.3)
        return self.reconnect()

    def _stop(self) -> None:
        """End the move and wait until the axis is at rest."""
        self._halt()
        self._wait_for_rest(self._fastest / self._acceleration)

    def _wait_for_rest(self, expected_s: float = 0.0) -> None:
        """Poll until the axis rests, for at most twice the expected time plus 2 s."""
        allowed_s = 2.0 * expected_s + STOP_MARGIN_S
        if not self.clock.until(lambda: not self._is_moving(), max(allowed_s, 1.0)):
            raise RigTimeout(
                f"{self.name}: the axis is still moving after {allowed_s:.3g} s. Check the table.",
                deadline_s=allowed_s,
            )

    def _read_position(self) -> float:
        """Return the position, units. Raise LinkError for a position that the axis cannot have reached since the last one."""
        before_s, self._asked_s = self._asked_s, self.clock.now()
        position = self._ask_position()
        reach = 1.5 * self._fastest * (self.clock.now() - before_s) + self.slack
        if abs(position - self._last) > reach:
            raise LinkError(
                f"{self.name}: expected a position within {reach:.1f} {self.unit} of {self._last:g}, got {position:g}. "
                "The controller was restarted, or the answer is corrupted.",
                position=position,
            )
        self._last = position
        return position
