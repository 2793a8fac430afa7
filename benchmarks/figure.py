"""Figure: a measured number and its gate, and a stopwatch for fair measurements.

Absolute times vary on a shared machine, but ratios within a run are stable. Rivals therefore run in alternating rounds,
in a new random order each round, and the medians are compared.
"""

import gc
import random
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple


class Figure(NamedTuple):
    """One line of the table.

    Parameters
    ----------
    label : str
        What was measured, and against what.
    value : float
        The number.
    unit : str
        Its unit: "x" for a ratio, "ns/sample", "ms", "s".
    gate : str
        "" where there is none, else "<= 1.25" or ">= 6".
    """

    label: str
    value: float
    unit: str
    gate: str = ""

    @property
    def passed(self) -> bool:
        """False where the value breaks its gate."""
        if not self.gate:
            return True
        relation, limit = self.gate.split()
        return self.value <= float(limit) if relation == "<=" else self.value >= float(limit)


def stopwatch(rivals: dict[str, Callable[[], object]], *, rounds: int = 15) -> dict[str, float]:
    """Return the median seconds of each rival over shuffled alternating rounds.

    Parameters
    ----------
    rivals : dict of str to callable
        What to time, by name; each is called once beforehand, so that nothing is compiled or paged in on the clock.
    rounds : int
        Calls of each.

    Returns
    -------
    dict of str to float
        s.
    """
    for call in rivals.values():
        call()
    seconds: dict[str, list[float]] = {name: [] for name in rivals}
    order, rng = list(rivals), random.Random(1)
    gc.disable()
    for _ in range(rounds):
        rng.shuffle(order)
        for name in order:
            start = time.perf_counter()
            rivals[name]()
            seconds[name].append(time.perf_counter() - start)
    gc.enable()
    return {name: statistics.median(values) for name, values in seconds.items()}
