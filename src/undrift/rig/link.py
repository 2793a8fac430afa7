"""Link: questions and answers with a rig or device, each with a deadline.

One thread reads (receiver.py); everything else happens in the caller. Bytes that nobody asked for are kept aside: those that come
between two exchanges, and, where the device marks them, those whose high bit is set (Galil CW1). After an answer that did not come
in time the link is out of step - the answer may still come, and would be taken for the next one - so it refuses to go on until
`resynchronise`.
"""

import threading
from dataclasses import dataclass

from undrift.errors import InputError, LinkError
from undrift.rig.receiver import Receiver, ReplyEnd, line_end
from undrift.rig.transport import Transport, open_transport


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSettings:
    """How to talk.

    Parameters
    ----------
    terminator : str
        Ends every question.
    reply_end : ReplyEnd
        Tells where a reply ends in what has come; 0 while it is not whole.
    reply_timeout_s : float
        Longest wait for a reply, s, unless an exchange says otherwise.
    connect_timeout_s : float
        Longest wait for a connection, s.
    baud : int
        Bits per second of a serial port.
    hardware_handshake : bool
        RTS/CTS of a serial port.
    """

    terminator: str = "\n"
    reply_end: ReplyEnd = line_end
    reply_timeout_s: float = 2.0
    connect_timeout_s: float = 5.0
    baud: int = 19200
    hardware_handshake: bool = False

    def __post_init__(self) -> None:
        for name in ("reply_timeout_s", "connect_timeout_s", "baud"):
            if not getattr(self, name) > 0:
                raise InputError(f"link: wanted {name} above 0, got {getattr(self, name)}; every wait has an end")


class Link:
    """A connection that is open from birth until `close`.

    Parameters
    ----------
    url : str
        ``tcp://host:port``, ``serial:///dev/ttyUSB0``, a path, ``socket://host:port`` or ``loop://``.
    settings : LinkSettings
        How to talk.

    Raises
    ------
    InputError
        Not such a URL.
    LinkError
        Nobody answers there.
    """

    def __init__(self, url: str, settings: LinkSettings = LinkSettings()) -> None:
        self.url = url
        self.settings = settings
        self._one_at_a_time = threading.RLock()
        self._in_step = True
        self._transport, self._receiver = self._connect()

    def __enter__(self) -> "Link":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the connection stands, as far as is known here."""
        return self._receiver.lost is None

    def mask_high_bit(self) -> None:
        """Keep bytes whose high bit is set out of the replies from now on, until the link is opened again."""
        self._receiver.high_bit_is_unsolicited = True

    def exchange(
        self,
        text: str,
        deadline_s: float | None = None,
        *,
        until: ReplyEnd | None = None,
        terminator: str | None = None,
    ) -> str:
        """Ask and return the answer.

        Parameters
        ----------
        text : str
            The question, without its terminator.
        deadline_s : float or None
            Longest wait, s; the settings' when None.
        until : ReplyEnd or None
            Where this reply ends, when otherwise than the settings say.
        terminator : str or None
            What ends this question, when otherwise than the settings say.

        Returns
        -------
        str
            The reply with its end.

        Raises
        ------
        RigTimeout
            No whole reply in time.
        LinkError
            The connection is lost or out of step, or what came is no text.
        """
        with self._one_at_a_time:
            if not self._in_step:
                raise LinkError(
                    f"{self.url}: wanted an answer to '{text}', got a link out of step with its device; resynchronise first"
                )
            return self._decoded(self._ask(text, deadline_s, until, terminator), text)

    def send(self, data: bytes) -> None:
        """Send bytes without waiting for an answer.

        Parameters
        ----------
        data : bytes
            As they go out.

        Raises
        ------
        LinkError
            The connection is lost.
        """
        lost = self._receiver.lost
        if lost is not None:
            raise LinkError(f"{self.url}: wanted an open link, got one lost: {lost}; reconnect")
        try:
            self._transport.write(data)
        except OSError as error:
            self._receiver.lose(str(error) or type(error).__name__)
            raise LinkError(f"{self.url}: wanted to send, got '{error}'; check the cable, reconnect") from error

    def read(self, deadline_s: float | None = None, *, until: ReplyEnd | None = None) -> str:
        """Return the next line that comes by itself.

        Parameters
        ----------
        deadline_s : float or None
            Longest wait, s; the settings' when None.
        until : ReplyEnd or None
            Where it ends, when otherwise than the settings say.

        Returns
        -------
        str
            With its end.

        Raises
        ------
        RigTimeout
            Not whole in time.
        LinkError
            The connection is lost, or what came is no text.
        """
        wait_s = self.settings.reply_timeout_s if deadline_s is None else deadline_s
        with self._one_at_a_time:
            return self._decoded(self._receiver.take(until or self.settings.reply_end, wait_s, ""), "")

    def unsolicited(self) -> str:
        """Return what came without being asked for since the last time.

        Returns
        -------
        str
            High bits removed.
        """
        return self._receiver.unsolicited()

    def resynchronise(
        self, text: str, until: ReplyEnd, deadline_s: float | None = None, *, terminator: str | None = None
    ) -> str:
        """Ask something that only one answer fits, and throw away all before it.

        Parameters
        ----------
        text : str
            The question.
        until : ReplyEnd
            Where its own answer ends, whatever stands before it.
        deadline_s : float or None
            Longest wait, s; the settings' when None.
        terminator : str or None
            What ends this question, when otherwise than the settings say.

        Returns
        -------
        str
            All that came, the answer at its end; what is no text is shown as \\x..

        Raises
        ------
        RigTimeout
            It did not come in time.
        LinkError
            The connection is lost.
        """
        with self._one_at_a_time:
            return self._ask(text, deadline_s, until, terminator).decode("ascii", errors="backslashreplace")

    def reconnect(self) -> None:
        """Close and open again, with nothing left over from before.

        Raises
        ------
        LinkError
            Nobody answers.
        """
        with self._one_at_a_time:
            self.close()
            self._transport, self._receiver = self._connect()
            self._in_step = True

    def close(self) -> None:
        """Let go of the connection and end the reading thread; harmless when called again."""
        self._receiver.stop()
        self._transport.close()

    def _ask(self, text: str, deadline_s: float | None, until: ReplyEnd | None, terminator: str | None) -> bytes:
        wait_s = self.settings.reply_timeout_s if deadline_s is None else deadline_s
        end = self.settings.terminator if terminator is None else terminator
        self._receiver.set_aside()
        self._in_step = False  # and stays so when anything, Ctrl-C included, keeps the answer from being read
        self.send((text + end).encode("latin-1"))
        reply = self._receiver.take(until or self.settings.reply_end, wait_s, text)
        self._in_step = True
        return reply

    def _decoded(self, reply: bytes, question: str) -> str:
        try:
            return reply.decode("ascii")
        except UnicodeDecodeError as error:
            raise LinkError(
                f"{self.url}: wanted text in answer to '{question}', got {reply[:80]!r}; check baud and cable"
            ) from error

    def _connect(self) -> tuple[Transport, Receiver]:
        transport = open_transport(
            self.url,
            baud=self.settings.baud,
            hardware_handshake=self.settings.hardware_handshake,
            connect_timeout_s=self.settings.connect_timeout_s,
        )
        return transport, Receiver(transport, self.url)
