"""``undrift study``: a first look at the note's three tasks as a user starts it, and the cost of one run of the flow."""

import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil

from benchmarks.figure import Figure
from undrift.sim.table_sessions import FACE, RATE, REST, joined
from undrift.study.case import (
    Unit,
    faces_of,
    fit_as_the_note,
    make_case,
    session_of,
    simulate_turns,
    trial_errors,
    units_of,
)
from undrift.study.figure3 import drawn_errors
from undrift.study.plan import DEVICE, Study, note_study
from undrift.study.run import count_runs

STUDY = "import sys; from undrift.cli.app import main; main(sys.argv[1:])"


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds and memory of the whole command; runs in a second and the share of each stage in each task.
    """
    seconds, peak = measured("--preset", "note", "--quick")
    figures = [
        Figure("undrift study --preset note --quick, whole command on all processors", seconds, "s"),
        Figure("  its processes together, peak memory", peak / 1e6, "MB", "<= 1000"),
        Figure("a drawn unit of Figure 3, both devices, one processor", drawn_unit(), "s"),
    ]
    return figures + shares(note_study(subjects=4))


def drawn_unit() -> float:
    """Measure what a drawn unit of Figure 3 costs, once everything is compiled.

    Returns
    -------
    float
        Seconds of the processor, mean of two units.
    """
    drawn_errors(DEVICE, 0, 12.5, 0)
    start = time.process_time()
    for number in (1, 2):
        drawn_errors(DEVICE, 0, 12.5, number)
    return (time.process_time() - start) / 2.0


STAGES = ("device, motion, trial, delay", "lay out", "faces", "rests and rates", "fit", "correct, orient, compare")


def shares(study: Study) -> list[Figure]:
    """Measure what a run costs one processor in each task of a study, by stage.

    Parameters
    ----------
    study : Study
        With four subjects or more: the first compiles, the others are measured.

    Returns
    -------
    list of Figure
        Runs in a second of one processor, and the share of each stage.
    """
    figures = []
    for task in study.tasks:
        units = [unit for unit in units_of(study) if unit.task is task and unit.subject < 4]
        took = np.array([stages_of(unit) for unit in units])[len(task.space.cutoff_hz) :]
        runs = len(took) * len(task.space.rows())
        label = f"{task.name}: runs in a second of one processor"
        figures.append(Figure(label, runs / took.sum(), "1/s"))
        for stage, seconds in zip(STAGES, took.sum(axis=0), strict=True):
            figures.append(Figure(f"  {stage}", 100.0 * seconds / took.sum(), "%"))
    return figures


def stages_of(unit: Unit) -> list[float]:
    """Run a unit stage by stage, as ``run_unit`` does.

    Parameters
    ----------
    unit : Unit
        With its protocols.

    Returns
    -------
    list of float
        Seconds of the processor that each stage took.
    """
    study, subject = unit.study, unit.subject
    protocols = tuple(map(unit.task.protocol_of, unit.task.space.points_at(unit.setting)))
    times = [time.process_time()]
    case = make_case(study, unit.task, subject, unit.setting)
    times.append(time.process_time())
    every = joined([session_of(protocol) for protocol in protocols])
    times.append(time.process_time())
    accel = faces_of(study, case.device, subject, session_of(protocols[0]).chosen(FACE))
    times.append(time.process_time())
    sessions = every.chosen(REST, RATE)
    readings = simulate_turns(study, unit.task.base, case.device, subject, sessions)
    times.append(time.process_time())
    fits = fit_as_the_note(sessions, readings, np.array([(p.turn_rate_max, p.turn_rate_step) for p in protocols]))
    times.append(time.process_time())
    trial_errors(case, [accel] * len(protocols), fits, study.offset)
    times.append(time.process_time())
    return [after - before for before, after in pairwise(times)]


def measured(*words: str) -> tuple[float, float]:
    """Run ``undrift study`` in a process of its own, in a fresh folder.

    Parameters
    ----------
    *words : str
        Its arguments.

    Returns
    -------
    seconds, bytes : float
        Wall time, and the peak of the memory of it and its workers, pages that they share counted once.
    """
    with tempfile.TemporaryDirectory(prefix="undrift-study-") as held:
        command = [sys.executable, "-c", STUDY, "study", *words, "-o", str(Path(held) / "out")]
        start, peak = time.perf_counter(), 0.0
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None:
                peak = max(peak, _memory(process.pid))
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


def _memory(pid: int) -> float:
    total = 0.0
    try:
        parent = psutil.Process(pid)
        for process in (parent, *parent.children(recursive=True)):
            total += process.memory_full_info().pss  # a page that several share counts once
    except psutil.Error:  # one of them ended just now
        pass
    return total
