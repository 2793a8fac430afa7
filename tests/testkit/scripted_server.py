"""Servers with scripted answers for the rig's drivers, within a virtual clock. Only the client that waits spends the time."""

from collections.abc import Callable, Iterable

from testkit.virtual_clock import VirtualClock

Answer = Callable[[str], bytes | None]


class Scripted:
    """Server on a free port. A function answers each command that ends with the terminator. None means no answer."""

    def __init__(
        self, answer: Answer, clock: VirtualClock | None = None, terminator: bytes = b"\r", at_once: str = ""
    ) -> None:
        self.heard: list[str] = []
        self.answer, self.clock = answer, clock or VirtualClock()
        self.terminator, self.at_once = terminator, at_once.encode("latin-1")
        self._lines = list[Line]()
        self._port = self.clock.listen("127.0.0.1", 0, self._connect)

    @property
    def url(self) -> str:
        return f"tcp://127.0.0.1:{self._port}"

    @property
    def line(self) -> "Line":
        """Return the line of the latest client."""
        return self._lines[-1]

    def hang_up(self) -> None:
        self.line.cut = True

    def refuse_from_now_on(self) -> None:
        self.clock.forget("127.0.0.1", self._port)
        for line in self._lines:
            line.cut = True

    def accept_again(self) -> None:
        self.clock.listen("127.0.0.1", self._port, self._connect)

    def _connect(self) -> "Line":
        self._lines.append(Line(self))
        return self.line


class Line:
    """One client's way to a scripted server."""

    datagrams = False

    def __init__(self, server: Scripted) -> None:
        self.cut = False
        self._server, self._clock, self._waiting, self._said = server, server.clock, b"", b""

    def say(self, data: bytes) -> None:
        self._said += data

    def receive(self, wait_s: float) -> bytes:
        if not self._said:
            if self.cut:
                raise EOFError("the other side closed the connection")
            self._clock.jump(self._clock.now() + wait_s)
        data, self._said = self._said, b""
        return data

    def write(self, data: bytes) -> None:
        """Answer completed commands and keep the incomplete rest."""
        if self.cut:
            raise BrokenPipeError("Broken pipe")
        self._clock.jump(self._clock.now() + 2e-4)
        for byte in (data[k : k + 1] for k in range(len(data))):
            self._waiting += byte
            if byte in self._server.at_once and self._server.at_once:
                self._do(byte)
                self._waiting = self._waiting[:-1]
            elif self._waiting.endswith(self._server.terminator):
                self._do(self._waiting.removesuffix(self._server.terminator))
                self._waiting = b""

    def close(self) -> None:
        self.cut = True

    def _do(self, command: bytes) -> None:
        text = command.decode("latin-1")
        self._server.heard.append(text)
        self._said += self._server.answer(text) or b""


def transcript(lines: Iterable[tuple[str, bytes]]) -> tuple[Answer, list[str]]:
    """Return an answer that plays a dialogue in its order, and the list of what did not fit it."""
    residual = list(lines)
    wrong: list[str] = []

    def answer(command: str) -> bytes:
        if not residual or residual[0][0] != command:
            wrong.append(f"heard {command!r}, wanted {residual[0][0] if residual else 'nothing'!r}")
            return b"?"
        return residual.pop(0)[1]

    return answer, wrong
