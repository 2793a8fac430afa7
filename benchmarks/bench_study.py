"""``undrift study``: a first look at the note's three tasks as a user starts it, and the cost of one run of the flow."""

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.figure import Figure
from undrift.study.case import run_unit, units_of
from undrift.study.plan import note_study
from undrift.study.run import count_runs

STUDY = "import sys; from undrift.cli.app import main; main(sys.argv[1:])"


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds and memory of the whole command; milliseconds of a run in each task.
    """
    seconds, peak = measured("--preset", "note", "--quick")
    figures = [
        Figure("undrift study --preset note --quick, whole command on all processors", seconds, "s"),
        Figure("  its processes together, peak memory", peak / 1e6, "MB", "<= 1000"),
    ]
    study = note_study(subjects=3)
    for task in study.tasks:
        own = [unit for unit in units_of(study) if unit.task.name == task.name][:3]
        run_unit(own[0])
        took = []
        for unit in own:
            start = time.perf_counter()
            runs = len(run_unit(unit).error_rms_deg)
            took.append((time.perf_counter() - start) / runs)
        label = f"a run of {task.name}: session, fit, tables, correct, orient, compare; one processor"
        figures.append(Figure(label, 1e3 * statistics.median(took), "ms"))
    return figures


def measured(*words: str) -> tuple[float, float]:
    """Run ``undrift study`` in a process of its own, in a fresh folder.

    Parameters
    ----------
    *words : str
        Its arguments.

    Returns
    -------
    seconds, bytes : float
        Wall time, and the peak of the resident memory of it and its workers, shared pages counted in each.
    """
    with tempfile.TemporaryDirectory(prefix="undrift-study-") as held:
        command = [sys.executable, "-c", STUDY, "study", *words, "-o", str(Path(held) / "out")]
        start, peak = time.perf_counter(), 0.0
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None:
                peak = max(peak, _resident(process.pid))
                time.sleep(0.1)
        if process.returncode:
            raise SystemExit(f"study: undrift ended with {process.returncode}")
        return time.perf_counter() - start, peak


def runs_of_the_note() -> int:
    """Return how many runs the note's preset has.

    Returns
    -------
    int
        Sessions simulated and fitted.
    """
    return count_runs(note_study())


def _resident(pid: int) -> float:
    total = 0.0
    try:
        parent = psutil.Process(pid)
        for process in (parent, *parent.children(recursive=True)):
            total += process.memory_info().rss
    except psutil.Error:  # one of them ended just now
        pass
    return total
