"""Executor: the one seam between a study and the machines that it runs on.

A study hands over a function and its units of work and takes what comes back, in any order. Three executors do that alike: in
this process, on a pool of processes, on a Dask scheduler. A unit carries its own seed, so the bits of its result depend on
neither the executor, nor the number of workers, nor the order. A worker that is killed loses what it had in hand; that is
done again.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from undrift.errors import InputError, UndriftError

Unit = TypeVar("Unit", contravariant=True)
Result = TypeVar("Result", covariant=True)
U = TypeVar("U")
R = TypeVar("R")

MOST_LOSSES = 5  # times that workers may be lost before the work itself is suspected


class Executor(Protocol):
    """What a study asks of the machines."""

    @property
    def workers(self) -> int:
        """How many units are worked on at a time."""

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work.

        Parameters
        ----------
        work : callable
            A module's function of one unit; it and the units can be pickled.
        units : sequence
            What to do.

        Yields
        ------
        (int, result)
            Place of the unit, and what came of it, as they are done.
        """


@dataclass(frozen=True, slots=True)
class InProcess:
    """One unit after the other, here."""

    @property
    def workers(self) -> int:
        """One."""
        return 1

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work in their order.

        Parameters
        ----------
        work : callable
            Function of one unit.
        units : sequence
            What to do.

        Yields
        ------
        (int, result)
            Place and result.
        """
        for place, unit in enumerate(units):
            yield place, work(unit)


@dataclass(frozen=True, slots=True)
class Pool:
    """Processes of this machine; fresh ones in place of those that are killed.

    Parameters
    ----------
    workers : int
        How many.
    """

    workers: int

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work.

        Parameters
        ----------
        work : callable
            Function of one unit.
        units : sequence
            What to do.

        Yields
        ------
        (int, result)
            Place and result, as they are done.

        Raises
        ------
        UndriftError
            Workers are lost again and again: the work itself kills them.
        """
        from concurrent.futures.process import BrokenProcessPool

        left, losses = dict(enumerate(units)), 0
        while left:
            try:
                yield from self._run(work, left)
            except BrokenProcessPool:
                losses += 1
                if losses > MOST_LOSSES:
                    raise _given_up(losses) from None

    def _run(self, work: Callable[[U], R], left: dict[int, U]) -> Iterator[tuple[int, R]]:
        from concurrent.futures import ProcessPoolExecutor, as_completed
        from multiprocessing import get_context

        with ProcessPoolExecutor(self.workers, mp_context=get_context("spawn")) as pool:
            places = {pool.submit(work, unit): place for place, unit in left.items()}
            try:
                for done in as_completed(places):
                    result = done.result()
                    place = places.pop(done)
                    del left[place]
                    yield place, result
            finally:
                for future in places:
                    future.cancel()


@dataclass(frozen=True, slots=True)
class Dask:
    """Workers of a Dask scheduler.

    Parameters
    ----------
    address : str
        As in ``tcp://host:8786``.
    timeout_s : float
        To wait for the scheduler, s.
    """

    address: str
    timeout_s: float = 10.0

    @property
    def workers(self) -> int:
        """How many threads its workers have together."""
        with self._client() as client:
            return max(1, int(sum(client.nthreads().values())))

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work.

        Parameters
        ----------
        work : callable
            Function of one unit.
        units : sequence
            What to do.

        Yields
        ------
        (int, result)
            Place and result, as they are done.

        Raises
        ------
        InputError
            No scheduler answers there.
        UndriftError
            Workers are lost again and again, or the scheduler is.
        """
        from concurrent.futures import CancelledError

        from distributed import KilledWorker, as_completed

        in_order_of_end: Any = as_completed
        with self._client() as client:
            places: dict[Any, int] = {}
            for place, unit in enumerate(units):
                future = client.submit(work, unit, pure=False)
                places[future] = place
            try:
                for future in in_order_of_end(list(places), loop=client.loop):
                    yield places[future], future.result()
                    future.release()
            except KilledWorker as error:
                raise _given_up(error.allowed_failures + 1) from error
            except CancelledError as error:
                raise UndriftError(
                    f"scheduler: wanted an answer from {self.address}, got none any more; start it again and go on"
                ) from error
            finally:
                with suppress(RuntimeError):
                    client.cancel(list(places))

    def _client(self) -> Any:
        import distributed

        connect: Any = distributed.Client
        try:
            return connect(self.address, timeout=self.timeout_s, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"scheduler: wanted a Dask scheduler at {self.address}, got no answer ({error}); start one with dask scheduler"
            ) from error


def _given_up(losses: int) -> UndriftError:
    return UndriftError(
        f"study: wanted workers that live, got {losses} losses; look at the memory, or run with one worker"
    )


def choose_executor(scheduler: str | None = None, workers: int | None = None) -> Executor:
    """Return the executor that a command line asks for.

    Parameters
    ----------
    scheduler : str, optional
        Address of a Dask scheduler.
    workers : int, optional
        Processes on this machine; all its processors where not given.

    Returns
    -------
    Executor
        In this process where one worker is asked for.

    Raises
    ------
    InputError
        Fewer than one worker, or both a scheduler and workers.
    """
    import os

    if scheduler is not None and workers is not None:
        raise InputError("study: wanted --scheduler or --workers, got both; the scheduler has its own workers")
    if scheduler is not None:
        return Dask(scheduler)
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count < 1:
        raise InputError(f"study: wanted one worker or more, got {count}")
    return InProcess() if count == 1 else Pool(count)
