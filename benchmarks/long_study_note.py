"""The note's whole study, 3 tasks x 30 subjects x 400 protocols and more: time and memory. Minutes long: run by its name alone."""

from benchmarks.bench_study import measured, runs_of_the_note
from benchmarks.figure import Figure


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Minutes and memory of the whole command on all processors.
    """
    seconds, peak = measured("--preset", "note")
    return [
        Figure("runs of undrift study --preset note", float(runs_of_the_note()), ""),
        Figure("  whole command on all processors (the gate holds for two)", seconds / 60.0, "min", "<= 10"),
        Figure("  its processes together, peak memory", peak / 1e6, "MB", "<= 1000"),
    ]
