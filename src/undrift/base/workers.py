"""Work on several processors: processes of this machine, or workers of a Dask scheduler."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from undrift.errors import InputError


@contextmanager
def executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Callable[..., Iterator[Any]]]:
    """Return a ``map`` over processes of this machine, or over the workers of a Dask scheduler."""
    if scheduler is not None and workers is not None:
        raise InputError("`scheduler` has its own workers. Omit `workers`.")
    if scheduler is not None:
        import distributed

        connect: Any = distributed.Client
        try:
            client = connect(scheduler, timeout=10.0, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"scheduler: no Dask scheduler answers at {scheduler} ({error}). Start one: dask scheduler."
            ) from error
        with client:
            yield client.get_executor().map
        return
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count < 1:
        raise InputError(f"`workers` must be 1 or more, got {count}.")
    if count == 1:
        yield map
        return
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        yield pool.map
