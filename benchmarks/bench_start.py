"""Time until the command answers, each time in a new process."""

import statistics
import subprocess
import sys
import time

from benchmarks.figure import Figure

ROUNDS = 7
HELP = ["-c", "import sys; sys.argv = ['undrift', '--help']; from undrift.cli.app import main; main()"]


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds of wall time.
    """
    commands = {
        "bare": (["-c", "pass"], ""),
        "undrift --help": (HELP, "<= 0.15"),
        "numpy-only work: a record checked and converted": (
            [
                "-c",
                "from undrift.record import Record; Record(time=[0, 1], gyro=[[1, 2, 3]] * 2, gyro_unit='dps').in_si()",
            ],
            "<= 0.3",
        ),
        "compiled work: a strapdown, kernel from the cache": (
            [
                "-c",
                "import numpy as np; from undrift import integrate_strapdown as f; "
                "f(np.ones((9, 3)), np.arange(9.0), np.array([1.0, 0, 0, 0]))",
            ],
            "<= 0.8",
        ),
    }
    return [Figure(f"{name}, whole process", _seconds(args), "s", gate) for name, (args, gate) in commands.items()]


def _seconds(args: list[str]) -> float:
    def once() -> float:
        start = time.perf_counter()
        subprocess.run([sys.executable, *args], check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - start

    once()
    return statistics.median(once() for _ in range(ROUNDS))
