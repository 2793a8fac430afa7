"""A bench in a process of its own, on loopback."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class BenchServer:
    """A bench that serves."""

    address: str  # with a slash at its end
    folder: Path
    process: subprocess.Popen[str]

    @property
    def port(self) -> int:
        """Return its port."""
        return int(self.address.split(":")[2].partition("/")[0])


def environment_of(folder: Path) -> dict[str, str]:
    """Return the environment of a bench's commands: its registry stands beside its folder."""
    return os.environ | {"UNDRIFT_REGISTRY": str(folder.parent / "registry.sqlite")}


@contextmanager
def bench_process(folder: Path, *words: str) -> Iterator[BenchServer]:
    """Run ``undrift bench`` on a free loopback port until the end of the block; its log stands beside the folder."""
    called = [*(sys.executable, "-m", "undrift", "bench", "--port", "0", "--no-browser", "--json")]
    called += ["--folder", str(folder), *words]
    with (folder.parent / f"{folder.name}.log").open("w") as log:
        process = subprocess.Popen(called, stdout=subprocess.PIPE, stderr=log, text=True, env=environment_of(folder))
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            assert line, Path(log.name).read_text()
            yield BenchServer(json.loads(line)["address"], folder, process)
        finally:
            process.terminate()
            try:
                process.wait(15.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()
