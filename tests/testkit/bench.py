"""A bench in a separate process, on loopback.

It is a fork of a process that has imported all it needs, which takes seconds.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from pathlib import Path

FORKS = get_context("forkserver" if "forkserver" in get_all_start_methods() else "spawn")
COMMANDS = ("calibrate", "certificate", "correct", "info", "orient", "validate")
IMPORTED = (
    "undrift.web.app",
    "undrift.commands.open_bench",
    "undrift.report.page",
    "undrift.report.figures",
    "scipy.stats",
)
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
    address: str  # with a slash at its end
    folder: Path
    process: ForkServerProcess

    @property
    def port(self) -> int:
        return int(self.address.split(":")[2].partition("/")[0])


def _serve(words: list[str], log: Path, out: Connection, practice: dict[str, str]) -> None:
    """Be ``undrift bench``."""
    from undrift.cli.app import main

    os.environ.update(practice)
    with log.open("w") as err:
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        main(["bench", *words])


@contextmanager
def bench_process(folder: Path, *words: str, seed: int = 2007, speed: float = 1.0) -> Iterator[BenchServer]:
    """Run ``undrift bench`` on a free loopback port until the end of the block. Its log is next to the folder."""
    token = [] if "--token" in words else ["--token", "none"]  # pages and requests of tests name plain addresses
    called = ["--port", "0", "--no-browser", "--folder", str(folder), *token, *words]
    log = folder.parent / f"{folder.name}.log"
    practice = {"UNDRIFT_PRACTICE_SEED": str(seed), "UNDRIFT_PRACTICE_SPEED": str(speed)}
    near, far = FORKS.Pipe(duplex=False)
    process = FORKS.Process(target=_serve, args=(called, log, far, practice))
    process.start()
    far.close()
    try:
        with open(os.dup(near.fileno())) as out:
            near.close()
            line = out.readline()
            assert line, log.read_text()
            yield BenchServer(re.findall(r"http://\S+", line)[0], folder, process)
    finally:
        process.terminate()
        process.join(15.0)
        if process.is_alive():
            process.kill()
            process.join()
