"""Surfaces of known errors, for the statistics of a study; and the protocols that a task tries."""

import numpy as np

from undrift.programme import Protocol
from undrift.study.plan import StudyTask
from undrift.study.space import Setting


def errors(error: np.ndarray) -> dict[str, np.ndarray]:
    """All error columns of runs whose root-mean-square is known: a maximum of twice that, alike in both timings."""
    return {
        f"error_{offline}{figure}_deg": factor * error
        for offline in ("", "offline_")
        for figure, factor in (("rms", 1.0), ("max", 2.0), ("end", 1.5))
    }


def candidates(task: StudyTask, cutoff_hz: float) -> tuple[Protocol, ...]:
    """The protocols that a task tries with a cut-off frequency, the device's own gain and Q."""
    return tuple(map(task.protocol_of, task.space.points_at(Setting(cutoff_hz))))
