"""The language of GRBL 1.1 (grblHAL, FluidNC): lines answered by ``ok`` or ``error:n``, and single characters that act at once.

``?`` asks for the status, ``!`` holds, 0x85 ends a jog, 0x18 resets. Alarms come by themselves, between answers.
"""

import re
import threading
import time
from collections.abc import Callable

from undrift.errors import LinkError, RigError, RigFault, RigTimeout
from undrift.rig.clock import Clock
from undrift.rig.grbl import words as grbl_words
from undrift.rig.grbl.words import Status
from undrift.rig.link import Link

JOG_CANCEL = b"\x85"
HOLD = b"!"
RESET = b"\x18"
UNCONFIRMED = "it is NOT CONFIRMED that the table stopped: cut the motor's power"
_KNOWN = re.compile(r"|ok|\[.*\]|<.*>|\$\d{1,3}=.*|Grbl .*|ALARM:\d{1,2}|error:\d{1,3}")


class GrblController:
    """What can be said to the controller.

    Parameters
    ----------
    link : Link
        Open, with line feeds and GRBL's ends of replies.
    clock : Clock
        Hardware's or an emulator's.
    """

    def __init__(self, link: Link, clock: Clock) -> None:
        self.link = link
        self.clock = clock
        self.alarm: str | None = None
        self.broken: LinkError | RigTimeout | None = None  # how the link first failed since it was last in step
        self._one_at_a_time = threading.RLock()

    @property
    def name(self) -> str:
        """The link's URL."""
        return self.link.url

    def do(self, line: str) -> list[str]:
        """Send a line and return what was said before ``ok``.

        Parameters
        ----------
        line : str
            ``$J=G91A360.000F5400.000``, ``$$``, ...

        Returns
        -------
        list of str
            Without blank lines.

        Raises
        ------
        RigFault
            The controller refused; the code in words and as the attribute ``code``.
        LinkError
            It said something that GRBL does not say.
        """
        *said, last = self._ask(line)
        if last.startswith("error:"):
            code = int(last.removeprefix("error:"))
            raise RigFault(
                f"{self.name}: wanted '{line}', got error {code}: {grbl_words.error_in_words(code)}; see the controller's state",
                code=code,
                command=line,
            )
        return said

    def status(self, deadline_s: float | None = None) -> Status:
        """Ask for the status (``?``).

        Parameters
        ----------
        deadline_s : float or None
            Longest wait, s; the link's own when None.

        Returns
        -------
        Status
            State and position.
        """
        *_, last = self._ask("?", deadline_s, until=grbl_words.status_end, terminator="")
        return grbl_words.parse_status(last, self.name)

    def reset(self, deadline_s: float) -> str:
        """Reset (0x18): motion ends at once, whatever was queued is forgotten; back in step when it greets.

        Parameters
        ----------
        deadline_s : float
            Longest wait for the greeting, s.

        Returns
        -------
        str
            Its greeting.
        """
        with self._one_at_a_time:
            said = self.link.resynchronise(RESET.decode("latin-1"), grbl_words.welcome_end, deadline_s, terminator="")
        self.alarm = self.broken = None
        return said.strip().splitlines()[-1]

    def wait_for(self, states: tuple[str, ...], expected_s: float) -> Status:
        """Poll the status until it is one of these: at most twice as long as it should take, and 2 s.

        Parameters
        ----------
        states : tuple of str
            "Idle", ...
        expected_s : float
            How long it should take, s of the clock.

        Returns
        -------
        Status
            The first that is.

        Raises
        ------
        RigFault
            An alarm came instead.
        RigTimeout
            It is still in another state.
        """
        allowed_s = 2.0 * expected_s + 2.0
        last = time.monotonic() + max(allowed_s / self.clock.speed, 1.0)
        while (status := self.status()).state not in states:
            if status.state in ("Alarm", "Door"):
                raise RigFault(
                    f"{self.name}: wanted {' or '.join(states)}, got {self.alarm_text(status)}; look at the table"
                )
            if time.monotonic() > last:
                raise RigTimeout(
                    f"{self.name}: wanted {' or '.join(states)} within {allowed_s:.3g} s, got {status.state}; look at the table",
                    deadline_s=allowed_s,
                )
            time.sleep(min(0.02, 0.05 / self.clock.speed))
        return status

    def alarm_text(self, status: Status) -> str:
        """Say what keeps the controller from moving.

        Parameters
        ----------
        status : Status
            Its state.

        Returns
        -------
        str
            In words.
        """
        if status.state == "Door":
            return "the safety door is open"
        return f"an alarm: {self.alarm}" if self.alarm else "an alarm"

    def make_safe(self) -> bool:
        """Stop, reset, put the motor to sleep, over a new connection where the old one is gone.

        Returns
        -------
        bool
            Whether the controller confirmed it; no RigError is raised.
        """
        try:
            if not self.link.is_open:
                self.link.reconnect()
            self.link.send(JOG_CANCEL)
            self._slow_down()
            self.reset(max(self.link.settings.reply_timeout_s, 3.0))
            self.do("$SLP")
            return self.wait_for(("Sleep",), 0.0).state == "Sleep"
        except RigError:
            try:
                self.link.send(JOG_CANCEL + HOLD + RESET)  # in the dark: it may still listen
            except RigError:
                return False
            return False

    def _slow_down(self) -> None:
        """Give a cancelled jog time to come to rest; a reset in motion would lose the position."""
        with self._one_at_a_time:
            self.link.resynchronise("?", grbl_words.status_end, terminator="")
        try:
            self.wait_for(("Idle", "Sleep"), 10.0)
        except (RigTimeout, RigFault):
            return

    def _ask(
        self,
        question: str,
        deadline_s: float | None = None,
        *,
        until: Callable[[bytes], int] | None = None,
        terminator: str | None = None,
    ) -> list[str]:
        """Ask, one thread at a time; the first failure is kept, since those of other threads only follow from it."""
        with self._one_at_a_time:
            try:
                return self._lines(
                    self.link.exchange(question, deadline_s, until=until, terminator=terminator), question
                )
            except (LinkError, RigTimeout) as error:
                self.broken = self.broken or error
                raise

    def _lines(self, said: str, question: str) -> list[str]:
        """Return the lines of an answer; what GRBL never says is garbage, an alarm is remembered."""
        lines = [line.strip() for line in said.splitlines() if line.strip()]
        for line in lines:
            if not _KNOWN.fullmatch(line):
                raise LinkError(f"{self.name}: wanted an answer to '{question}', got {line!r}; check cable and baud")
            if line.startswith("ALARM:"):
                code = int(line.removeprefix("ALARM:"))
                self.alarm = f"{grbl_words.alarm_in_words(code)} (alarm {code})"
        return lines
