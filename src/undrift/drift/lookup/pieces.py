"""Cut a long record into pieces, a thread each: the kernels let other threads run, and no sample looks at another."""

import os
from collections.abc import Callable
from itertools import pairwise
from typing import TypeVar

THREADS_FROM = 100_000  # samples; below it a second thread costs more than it saves

T = TypeVar("T")


def in_pieces(work: Callable[[int, int], T], n: int, threads: int | None) -> list[T]:
    """Do the work piece by piece.

    Parameters
    ----------
    work : callable
        Takes the samples [start, stop).
    n : int
        Samples.
    threads : int or None
        Pieces; None for all processors where the record is long, one where it is short.

    Returns
    -------
    list
        What the work returned, in order.
    """
    count = (os.cpu_count() or 1) if threads is None and n >= THREADS_FROM else threads or 1
    bounds = [n * i // count for i in range(count + 1)]
    pieces = [(start, stop) for start, stop in pairwise(bounds) if stop > start]
    if len(pieces) == 1:
        return [work(*pieces[0])]
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(len(pieces)) as pool:
        return list(pool.map(lambda piece: work(*piece), pieces))
