"""``undrift study``: the note's three tasks as started by a user, and the time per device."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.figure import Figure
from benchmarks.figure3 import drawn_errors
from undrift.study.plan import note_study
from undrift.study.run import run_device

STUDY = "import sys; from undrift.cli.app import main; main(sys.argv[1:])"


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds and memory of the whole command, and seconds of a processor for one device.
    """
    seconds, peak = measured("--preset", "note")
    return [
        Figure("undrift study --preset note, whole command on all processors", seconds, "s"),
        Figure("  its processes together, peak memory", peak / 1e6, "MB", "<= 1000"),
        Figure("a device of the note's preset, one processor", one_device(), "s"),
        Figure("a drawn unit of Figure 3, both devices, one processor", drawn_unit(), "s"),
    ]


def one_device() -> float:
    """Return the time for a device of the note's preset after compilation, s."""
    study = note_study()
    run_device(study, 0)
    start = time.process_time()
    run_device(study, 1)
    return time.process_time() - start


def drawn_unit() -> float:
    """Return the processor time for a drawn unit of Figure 3 after compilation, s, mean of two units."""
    drawn_errors(0, 0)
    start = time.process_time()
    for number in (1, 2):
        drawn_errors(number, 0)
    return (time.process_time() - start) / 2.0


def measured(*words: str) -> tuple[float, float]:
    """Run ``undrift study`` in a separate process, in a new folder. Return wall time, s, and peak memory, bytes."""
    with tempfile.TemporaryDirectory(prefix="undrift-study-") as folder:
        command = [sys.executable, "-c", STUDY, "study", *words, "-o", str(Path(folder) / "out")]
        start, peak = time.perf_counter(), 0.0
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None:
                peak = max(peak, _memory(process.pid))
                time.sleep(0.1)
        if process.returncode:
            raise SystemExit(f"study: undrift ended with {process.returncode}")
        return time.perf_counter() - start, peak


def _memory(pid: int) -> float:
    """Return the memory of a process and its children, pages that they share counted once."""
    try:
        processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
        return float(sum(process.memory_full_info().uss for process in processes))
    except psutil.Error:
        return 0.0
