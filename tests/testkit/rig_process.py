"""A simulated bench behind real sockets, and commands in processes of their own that drive it and can be killed.

A command is the fork of a process that has imported all it needs, which takes seconds.
"""

import contextlib
import io
import itertools
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from testkit.bench import FORKS
from testkit.cards import TurningCard
from testkit.rig_bench import RATE_HZ, simulated
from testkit.talking_device import TalkingDevice
from undrift.base.clock import Clock, PacedClock

TOGETHER_S = 0.02  # between two packets of the device, host s


class BenchOnHost:
    """A bench whose clock runs at a multiple of the host's: a card that drives the table, and a sending device, with +z
    up.
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self.bench = simulated(Clock.started(speed))
        self.card = TurningCard(self.bench)
        self.bench.readings[0].start()
        self.device = SendingDevice(self)

    def __enter__(self) -> "BenchOnHost":
        return self

    def __exit__(self, *failure: object) -> None:
        self.device.__exit__()
        self.card.server.close()

    @property
    def address(self) -> str:
        """Return the address of the table."""
        return f"{self.card.address}?clock_speed={self.speed:g}&reply_timeout_s=20"

    def words(self, protocol: Path, path: Path, *more: str) -> list[str]:
        """Return the call of a run."""
        device = f"{self.device.address}&clock_speed={self.speed:g}"
        return ["rig", "run", str(protocol), "--rig", self.address, "--device", device, "-o", str(path), "--yes", *more]

    def turn_rate(self) -> float:
        """Return the true rate of the axis, rad/s."""
        with self.card.lock:
            return self.bench.turn_rate()

    def at_rest(self, *, motor_on: bool = False) -> bool:
        """Wait until the axis is at rest with its motor off, or also on. Return False if this never happens."""
        return until(lambda: abs(self.turn_rate()) <= 2e-3 and (motor_on or not self.bench.servo.powered))

    def turning(self) -> bool:
        """Wait until the axis turns. Return False if this never happens."""
        return until(lambda: abs(self.turn_rate()) > 0.2)


class SendingDevice(TalkingDevice):
    """The device of a bench, sending to all that listen."""

    def __init__(self, host: BenchOnHost) -> None:
        self.host = host
        super().__init__(RATE_HZ)

    def _talk(self) -> None:
        readings = self.host.bench.readings[0]
        while not self._end.wait(TOGETHER_S):
            with self.host.card.lock:
                self.host.bench.advance()
                chunks, readings._kept = readings._kept, []
            rows = ((count, *row) for counts, values in chunks for count, row in zip(counts, values, strict=True))
            lines = "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in rows)
            for client in list(self._clients):
                with contextlib.suppress(OSError):
                    client.sendall(lines.encode())


def until(condition: Callable[[], object], within_s: float = 60.0) -> bool:
    """Wait for a condition, host s."""
    last = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > last:
            return False
        time.sleep(0.005)
    return True


class Command:
    """A command that runs in a process of its own, and finds an Enter whenever it asks.

    With ``killed_at`` it ends by kill -9 in the n-th call of ``fsync`` or, on a simulated bench, of the clock's ``wait``. No
    file may grow beyond ``largest_file`` bytes.
    """

    def __init__(
        self, words: list[str], folder: Path, *, killed_at: tuple[str, int] | None = None, largest_file: int = 0
    ) -> None:
        self._out, self._err = (folder / f"{name} of {time.monotonic_ns()}" for name in ("out", "err"))
        self._process = FORKS.Process(target=_called, args=(words, self._out, self._err, killed_at, largest_file))
        self._process.start()

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self._process.exitcode is not None

    def signal(self, number: int) -> None:
        """Send a signal to the process, if it is still running."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._process.pid, number)

    def kill(self) -> None:
        """End it with kill -9."""
        self.signal(signal.SIGKILL)
        self._process.join(30.0)

    def result(self) -> tuple[int | None, str, str]:
        """Wait for the end. Return the exit code, standard output and standard error."""
        self._process.join(120.0)
        return self._process.exitcode, self._out.read_text(), self._err.read_text()


def _called(words: list[str], out: Path, err: Path, killed_at: tuple[str, int] | None, largest_file: int) -> None:
    """Be the command."""
    from undrift.cli.app import main

    sys.stdin = io.StringIO("\n" * 100)
    for number, path in ((1, out), (2, err)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    if killed_at:
        _kill_in_call(*killed_at)
    if largest_file:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))
    main(words)


def _kill_in_call(name: str, number: int) -> None:
    """Let this process end with kill -9 after a number of calls of a function."""
    owner: Any = {"fsync": os, "wait": PacedClock}[name]
    function, calls = getattr(owner, name), itertools.count(1)

    def counted(*values: Any) -> Any:
        if next(calls) == number:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*values)

    setattr(owner, name, counted)
