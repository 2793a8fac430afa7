"""Work on several processors: threads, processes of this machine, or workers of a Dask scheduler.

If no thread can be started, as in a browser, the calls run one after another in the caller.
"""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from typing import Any

from undrift.errors import InputError


@cache
def has_threads() -> bool:
    """Return True if this interpreter can start a thread."""
    try:
        threading.Thread(target=bool).start()
    except RuntimeError:
        return False
    return True


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads(count: int) -> Executor:
    """Return a pool of threads, or a pool that makes the calls in the caller."""
    return ThreadPoolExecutor(count) if has_threads() else _Caller()


class _Caller(Executor):
    """Pool without threads."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = Future[Any]()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 (whoever asks for the result gets it)
            future.set_exception(error)
        return future


@contextmanager
def executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Callable[..., Iterator[Any]]]:
    """Return a ``map`` over this process and others of this machine, or over the workers of a Dask scheduler."""
    if scheduler is not None and workers is not None:
        raise InputError("`scheduler` has its own workers. Omit `workers`.")
    if scheduler is not None:
        import distributed

        connect: Any = distributed.Client
        try:
            client = connect(scheduler, timeout=10.0, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"scheduler: no Dask scheduler answers at {scheduler} ({error}). Start one with: dask scheduler."
            ) from error
        with client:
            yield client.get_executor().map
        return
    count = processors() if workers is None else workers
    if count < 1:
        raise InputError(f"`workers` must be 1 or more, got {count}.")
    if count == 1 or not has_threads():
        yield map
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with ProcessPoolExecutor(count - 1, mp_context=get_context("spawn")) as pool:
        yield partial(_shared_map, pool)


def _shared_map(pool: Executor, fn: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
    """Return results in order, as ``pool.map`` does. Until the next is ready, the caller runs the last open calls."""
    items = list(items)
    futures = [pool.submit(fn, item) for item in items]

    def results() -> Iterator[Any]:
        own, last = dict[int, Any](), len(items)
        try:
            for k, future in enumerate(futures):
                while k < last and not future.done():
                    last -= 1
                    if futures[last].cancel():
                        own[last] = fn(items[last])
                yield own.pop(k) if k in own else future.result()
        finally:
            for future in futures:
                future.cancel()

    return results()
