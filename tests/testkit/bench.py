"""A bench in a separate process, on loopback.

It and its commands are forks of a process that has imported all they need, which takes seconds; tests/cli/test_bench.py and
tests/web/test_commands.py have both as they are called.
"""

import asyncio
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

FORKS = get_context("forkserver" if "forkserver" in get_all_start_methods() else "spawn")
COMMANDS = ("calibrate", "certificate", "correct", "info", "orient", "validate")
IMPORTED = ("undrift.web.app", "undrift.cli.bench", "undrift.report.page", "undrift.report.figures", "scipy.stats")
IMPORTED += (
    "undrift.commands.rig",
    "undrift.live.recorder",
    "undrift.rig.run",
    "undrift.rig.galil",
    "undrift.rig.simulated",
)
IMPORTED += ("cyclopts", "rich.console", "undrift.sim.kernels", "undrift.io.parquet", "pyarrow.parquet", "pandas")
IMPORTED += ("undrift.calibration.calibrate", "undrift.correction.correct", "undrift.io.store")
if FORKS.get_start_method() == "forkserver":
    FORKS.set_forkserver_preload([*IMPORTED, *(f"undrift.commands.{name}" for name in COMMANDS)])


@dataclass(frozen=True)
class BenchServer:
    """A bench that serves."""

    address: str  # with a slash at its end
    folder: Path
    process: ForkServerProcess

    @property
    def port(self) -> int:
        """Return its port."""
        return int(self.address.split(":")[2].partition("/")[0])


def _serve(words: list[str], log: Path, out: Connection) -> None:
    """Be ``undrift bench``."""
    from undrift.web import commands

    commands.asyncio = SimpleNamespace(**vars(asyncio) | {"create_subprocess_exec": _ForkedCommand.start})
    with log.open("w") as err:
        _called(["bench", *words], out, err)


def _called(words: list[str], out: Connection, err: Any, folder: Path | None = None) -> None:
    """Be a command."""
    from undrift.cli.app import main

    os.dup2(out.fileno(), 1)
    os.dup2(err.fileno(), 2)
    if folder is not None:
        os.chdir(folder)
    main(words)


class _ForkedCommand:
    """A command of the bench, as `asyncio.create_subprocess_exec` returns one."""

    def __init__(self, process: ForkServerProcess, stdout: asyncio.StreamReader, stderr: asyncio.StreamReader) -> None:
        self.process, self.stdout, self.stderr, self.kill = process, stdout, stderr, process.kill

    @classmethod
    async def start(cls, *called: str, cwd: Path, limit: int, **_: object) -> "_ForkedCommand":
        """Start ``python -m undrift WORDS``."""
        pipes = [FORKS.Pipe(duplex=False) for _ in range(2)]
        process = FORKS.Process(target=_called, args=(list(called[3:]), *(far for _, far in pipes), cwd))
        process.start()
        readers = []
        for near, far in pipes:
            far.close()
            readers.append(asyncio.StreamReader(limit))
            protocol = partial(asyncio.StreamReaderProtocol, readers[-1])
            await asyncio.get_running_loop().connect_read_pipe(protocol, os.fdopen(os.dup(near.fileno()), "rb", 0))
            near.close()
        return cls(process, *readers)

    @property
    def returncode(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        return self.process.exitcode

    async def wait(self) -> int | None:
        """Wait for its end."""
        await asyncio.to_thread(self.process.join)
        return self.process.exitcode


@contextmanager
def bench_process(folder: Path, *words: str) -> Iterator[BenchServer]:
    """Run ``undrift bench`` on a free loopback port until the end of the block. Its log is next to the folder."""
    token = [] if "--token" in words else ["--token", "none"]  # pages and requests of tests name plain addresses
    called = ["--port", "0", "--no-browser", "--json", "--folder", str(folder), *token, *words]
    log = folder.parent / f"{folder.name}.log"
    near, far = FORKS.Pipe(duplex=False)
    process = FORKS.Process(target=_serve, args=(called, log, far))
    process.start()
    far.close()
    try:
        with open(os.dup(near.fileno())) as out:
            near.close()
            line = out.readline()
            assert line, log.read_text()
            yield BenchServer(json.loads(line)["address"], folder, process)
    finally:
        process.terminate()
        process.join(15.0)
        if process.is_alive():
            process.kill()
            process.join()
