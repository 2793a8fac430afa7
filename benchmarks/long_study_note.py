"""The note's whole study, 3 tasks x 30 subjects x 410 protocols: time and memory. Minutes long: run by its name alone."""

import shutil
import tempfile
import time
from pathlib import Path

from benchmarks.bench_study import measured, runs_of_the_note
from benchmarks.figure import Figure
from undrift.study.plan import note_study
from undrift.study.run import Dask, Executor, InProcess, Pool, run_study

SUBJECTS = 10


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds and memory of the whole command on all processors; the sessions alone by each executor, for a third of the subjects.
    """
    seconds, peak = measured("--preset", "note")
    runs = float(runs_of_the_note())
    figures = [
        Figure("runs of undrift study --preset note", runs, ""),
        Figure(
            "  whole command on all processors: sessions, split by effect, Figure 3, rivals", seconds, "s", "<= 600"
        ),
        Figure("  its processes together, peak memory", peak / 1e6, "MB", "<= 1000"),
    ]
    seconds, _ = measured("--preset", "note", "--no-rivals")
    figures.append(Figure("  without rivals and the drawn units of Figure 3", seconds, "s"))
    alone = sessions(InProcess())
    figures.append(
        Figure(f"sessions alone, {SUBJECTS} subjects ({runs * SUBJECTS / 30.0:.0f} runs), one process", alone, "s")
    )
    for label, took in (
        ("pool of two processes", sessions(Pool(2))),
        ("Dask, one worker", on_dask(1)),
        ("Dask, two workers", on_dask(2)),
    ):
        figures.append(Figure(f"  {label}", took, "s"))
        figures.append(Figure("    times as fast as one process", alone / took, "x"))
    return figures


def sessions(executor: Executor) -> float:
    """Run the preset's sessions with fewer subjects, once everything is compiled.

    Parameters
    ----------
    executor : Executor
        Of the study.

    Returns
    -------
    float
        Seconds.
    """
    folder = Path(tempfile.mkdtemp(prefix="undrift-study-"))
    run_study(note_study(subjects=3), executor, folder / "compiled")
    start = time.perf_counter()
    run_study(note_study(subjects=SUBJECTS), executor, folder / "measured")
    seconds = time.perf_counter() - start
    shutil.rmtree(folder)
    return seconds


def on_dask(workers: int) -> float:
    """Run them on Dask workers of one thread each, on this machine.

    Parameters
    ----------
    workers : int
        How many.

    Returns
    -------
    float
        Seconds.
    """
    import distributed

    with distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    ) as cluster:
        return sessions(Dask(cluster.scheduler_address))
