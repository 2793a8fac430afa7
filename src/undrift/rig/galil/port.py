"""Ports to a Galil card: what carries a command there and its answer back.

A command ends with a carriage return; the answer is ``:``, or text and ``:``, or ``?``. LinkPort speaks that over a Link;
galil_gclib.py has the maker's library do it.
"""

import re
from typing import Protocol

from undrift.errors import LinkError, RigError, RigTimeout
from undrift.rig.link import Link, LinkSettings
from undrift.rig.receiver import ReplyEnd

PROMPT = re.compile(rb"(?:^|\n)[:?]")


def reply_end(received: bytes) -> int:
    """Return where a card's answer ends: at a prompt that opens a line.

    Parameters
    ----------
    received : bytes
        What has come since the command.

    Returns
    -------
    int
        Length with the prompt, 0 while there is none.
    """
    found = PROMPT.search(received)
    return found.end() if found else 0


class GalilPort(Protocol):
    """What carries commands to a card."""

    @property
    def name(self) -> str:
        """Where the card is, for messages."""

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Return the text of the answer ("" for a bare ``:``), None when the card refused.

        Parameters
        ----------
        command : str
            Without the carriage return.
        deadline_s : float or None
            Longest wait, s; the port's own when None.
        """

    def shout(self, command: str) -> None:
        """Send without waiting for an answer; nothing is raised.

        Parameters
        ----------
        command : str
            Without the carriage return.
        """

    def resynchronise(self) -> None:
        """Make sure that the next answer is the next command's."""

    def mask_unsolicited(self) -> None:
        """Keep characters with the high bit set out of the answers from now on."""

    def unsolicited(self) -> str:
        """Return what the card said without being asked, once."""

    @property
    def is_open(self) -> bool:
        """Whether the connection stands."""

    def reconnect(self) -> None:
        """Close and open again."""

    def close(self) -> None:
        """Let go of the connection; harmless when called again."""


class LinkPort:
    """A card on TCP or a serial port.

    Parameters
    ----------
    url : str
        As Link takes it.
    settings : LinkSettings
        Timeouts and baud; terminator and ends of replies are the card's own.

    Raises
    ------
    LinkError
        Nobody answers there.
    """

    def __init__(self, url: str, settings: LinkSettings = LinkSettings()) -> None:
        self._link = Link(
            url,
            LinkSettings(
                terminator="\r",
                reply_end=reply_end,
                reply_timeout_s=settings.reply_timeout_s,
                connect_timeout_s=settings.connect_timeout_s,
                baud=settings.baud,
                hardware_handshake=settings.hardware_handshake,
            ),
        )
        self._token = 41_000

    @property
    def name(self) -> str:
        """The link's URL."""
        return self._link.url

    @property
    def is_open(self) -> bool:
        """Whether the connection stands, as far as is known here."""
        return self._link.is_open

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Send a command and return the text of its answer.

        Parameters
        ----------
        command : str
            Without the carriage return.
        deadline_s : float or None
            Longest wait, s; the link's own when None.

        Returns
        -------
        str or None
            With its CR LF; "" for a bare ``:``; None when the card refused.

        Raises
        ------
        RigTimeout
            No whole answer in time.
        LinkError
            The link is lost, or the answer is no answer.
        """
        reply = self._link.exchange(command, deadline_s)
        if reply == "?":
            return None
        if not reply.endswith(":") or "?" in reply:
            raise LinkError(f"{self.name}: wanted an answer to '{command}', got {reply!r}; check cable and baud")
        return reply[:-1]

    def shout(self, command: str) -> None:
        """Send without waiting for an answer; a lost link is left to whoever asks next.

        Parameters
        ----------
        command : str
            Without the carriage return.
        """
        try:
            self._link.send(f"{command}\r".encode("ascii"))
        except RigError:
            return

    def resynchronise(self) -> None:
        """Ask the card to say a number that it was never asked for before, and throw away all before it.

        Raises
        ------
        RigTimeout
            The card did not say it, asked three times.
        LinkError
            The link is lost.
        """
        for attempt in range(3):
            self._token += 1
            try:
                self._link.resynchronise(f"MG {self._token}", _end_of(self._token))
            except RigTimeout:
                if attempt == 2:
                    raise
            else:
                return

    def mask_unsolicited(self) -> None:
        """Keep characters with the high bit set out of the answers from now on."""
        self._link.mask_high_bit()

    def unsolicited(self) -> str:
        """Return what the card said without being asked, once.

        Returns
        -------
        str
            High bits removed.
        """
        return self._link.unsolicited()

    def reconnect(self) -> None:
        """Close and open again.

        Raises
        ------
        LinkError
            Nobody answers.
        """
        self._link.reconnect()

    def close(self) -> None:
        """Let go of the link; harmless when called again."""
        self._link.close()


def _end_of(token: int) -> ReplyEnd:
    """Return what finds the end of an answer that is this number; leading zeros and decimals are the card's to choose."""
    said = re.compile(rb"(?<!\d)0*%d(?:\.0*)?[ ]*\r?\n:" % token)

    def end(received: bytes) -> int:
        found = said.search(received)
        return found.end() if found else 0

    return end
