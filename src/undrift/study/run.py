"""Run a study: its units on an executor, each kept as it is finished, then the error surface of each task.

A unit carries its own seed, so the bits of its result depend on neither the executor, nor the number of workers, nor the order.
The store has one Parquet piece for each finished unit, whole or not there; DIR/study.json says which study the pieces belong to:
a folder of another study is refused, and an interrupted study resumes with the units that have no piece.
"""

import hashlib
import json
import math
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, UndriftError
from undrift.files import no_folder, write_whole
from undrift.sim.bench_errors import OF_TABLE
from undrift.study.case import COLUMNS, Unit, run_units, units_of
from undrift.study.plan import ERRORS, SAMPLE_RATE_HZ, Aim, Objective, Study, StudyTask, Timing, column_of
from undrift.study.space import FURTHER

# ---- executors: where units of work are done

U = TypeVar("U")
R = TypeVar("R")

MOST_LOSSES = 5  # times that workers may be lost before the work itself is suspected


class Executor(Protocol):
    """What a study asks of the machines."""

    @property
    def workers(self) -> int:
        """How many units are worked on at a time."""

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work; yield the place of each and its result, in any order."""


class InProcess:
    """One unit after the other, here."""

    workers = 1

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work in their order."""
        for place, unit in enumerate(units):
            yield place, work(unit)


@dataclass(frozen=True, slots=True)
class Pool:
    """This process and others of this machine, the same in all stages; fresh ones in place of those that are killed."""

    workers: int  # How many; this one is one of several
    _running: list[Any] = field(default_factory=list, init=False, compare=False, repr=False)  # one at most

    def start(self, work: Callable[[], Any]) -> None:
        """Start the others, each with work that loads what they need, while this process does something else."""
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        others = max(self.workers - 1, 1)
        self._running.append(ProcessPoolExecutor(others, mp_context=get_context("spawn")))
        for _ in range(others):
            self._running[0].submit(work)

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work: the others from the first on, this process from the last, if it is one of several."""
        from concurrent.futures.process import BrokenProcessPool

        left, losses = dict(enumerate(units)), 0
        while left:
            if not self._running:
                self.start(int)
            places, ended, coming = dict[Any, int](), SimpleQueue[Any](), deque(left)
            try:
                while coming or places:
                    while coming and len(places) < self.workers:
                        future = self._running[0].submit(work, left[coming[0]])
                        places[future] = coming.popleft()
                        future.add_done_callback(ended.put)
                    if coming and self.workers > 1 and ended.empty():
                        place = coming.pop()
                        result = work(left[place])
                    else:
                        future = ended.get()
                        place, result = places.pop(future), future.result()
                    del left[place]
                    yield place, result
            except BrokenProcessPool:
                self._running.clear()
                losses += 1
                if losses > MOST_LOSSES:
                    raise _given_up(losses) from None
            finally:
                for future in places:
                    future.cancel()


@dataclass(frozen=True, slots=True)
class Dask:
    """Workers of a Dask scheduler."""

    address: str  # As in ``tcp://host:8786``
    timeout_s: float = 10.0  # To wait for the scheduler, s

    @property
    def workers(self) -> int:
        """How many threads its workers have together."""
        with self._client() as client:
            return max(1, int(sum(client.nthreads().values())))

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work."""
        from concurrent.futures import CancelledError

        from distributed import KilledWorker, as_completed

        in_order_of_end: Any = as_completed
        with self._client() as client:
            places: dict[Any, int] = {client.submit(work, unit, pure=False): k for k, unit in enumerate(units)}
            try:
                for future in in_order_of_end(list(places), loop=client.loop):
                    yield places[future], future.result()
                    future.release()
            except KilledWorker as error:
                raise _given_up(error.allowed_failures + 1) from error
            except CancelledError as error:
                raise UndriftError(
                    f"scheduler: wanted an answer from {self.address}, got none any more; start it again and resume"
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
    """Return the executor that a command line asks for."""
    if scheduler is not None and workers is not None:
        raise InputError("study: wanted `scheduler` or `workers`, got both; the scheduler has its own workers")
    if scheduler is not None:
        return Dask(scheduler)
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count < 1:
        raise InputError(f"study: wanted one worker or more, got {count}")
    return InProcess() if count == 1 else Pool(count)


# ---- store: finished units in a folder

FORMAT = 1
PIECES = "runs"
HEAD = "study.json"
SURFACE = "surface.parquet"


class RunStore:
    """Finished units of a study in a folder."""

    def __init__(self, folder: Path, study: Study) -> None:
        self._folder, self._pieces = folder, folder / PIECES
        try:
            self._pieces.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise no_folder(folder, error) from error
        held = asdict(study) | {"tasks": [asdict(task) for task in study.tasks]}
        held["bench"] = {name: held["bench"][name] for name in OF_TABLE}
        for name in ("objective", "timing", "margin_deg", "target_deg", "confidence"):  # only verdicts depend on them
            del held[name]
        text, head = json.dumps(held, sort_keys=True), folder / HEAD
        if not head.exists():
            content = {"kind": "undrift.study-runs", "format": FORMAT, "study": json.loads(text)}
            write_whole(head, json.dumps(content, indent=1))
            return
        version, found = _study_in(head)
        if (version, found) != (FORMAT, text):
            mark = hashlib.sha256(text.encode()).hexdigest()[:8]
            raise InputError(
                f"{folder}: wanted an empty folder or one of this study ({mark}), got another's runs; choose another"
            )

    def holds(self, unit: Unit) -> bool:
        """Return whether a unit is finished."""
        return self._piece(unit).exists()

    def finish(self, units: Sequence[Unit], executor: Executor) -> Iterator[Unit]:
        """Do the units that have no piece yet; yield each as it is finished."""
        left = [unit for unit in units if not self.holds(unit)]
        groups = [tuple(of) for _, of in groupby(left, lambda unit: (unit.task.key, unit.subject))]
        for place, done in executor.run(run_units, groups):
            for unit, runs in zip(groups[place], done, strict=True):
                self.write(unit, runs)
                yield unit

    def write(self, unit: Unit, runs: dict[str, FloatArray]) -> None:
        """Keep the runs of a unit."""
        import pyarrow as pa

        count = len(runs["error_rms_deg"])
        whose = {"task": np.full(count, unit.task.key), "subject": np.full(count, unit.subject, dtype=np.int32)}
        columns = whose | {name: runs[name] for name in (*COLUMNS, *further_of(unit.task))}
        _write_table(self._piece(unit), pa.table(columns), compression="snappy")

    def read(self, unit: Unit) -> dict[str, FloatArray]:
        """Read the runs of a unit, an array (P,) for each column."""
        import pyarrow.parquet as pq

        table = pq.read_table(self._piece(unit))
        return {name: np.asarray(table.column(name).to_numpy(), float) for name in (*COLUMNS, *further_of(unit.task))}

    def join(self, units: Sequence[Unit]) -> Path:
        """Join the pieces to one file."""
        return join_pieces([self._piece(unit) for unit in units], self._folder)

    def _piece(self, unit: Unit) -> Path:
        return self._pieces / f"{unit.key}.parquet"


def further_of(task: StudyTask) -> tuple[str, ...]:
    """Return the columns of a task's further parameters."""
    return task.space.names[4:]


def join_pieces(pieces: Sequence[Path], folder: Path) -> Path:
    """Join pieces to the surface file of a folder."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = folder / SURFACE
    _write_table(
        path,
        pa.concat_tables([pq.read_table(piece) for piece in pieces], promote_options="default"),
        compression="zstd",
    )
    return path


def _write_table(path: Path, table: Any, *, compression: str) -> None:
    import pyarrow.parquet as pq

    write_whole(path, lambda part: pq.write_table(table, str(part), compression=compression))


def _study_in(head: Path) -> tuple[object, str]:
    """Return the format of a folder and the text of its study."""
    try:
        content = json.loads(head.read_text(encoding="utf-8"))
        return content["format"], json.dumps(content["study"], sort_keys=True)
    except (OSError, ValueError, KeyError, TypeError):
        return None, ""


# ---- grid search

# Of the parameters that end by themselves: no cut-off is near the highest frequency that samples can have
ENDS = {"cutoff_hz": (0.0, 0.45 * SAMPLE_RATE_HZ)} | {name: (kind.least, kind.most) for name, kind in FURTHER.items()}
ENDS["poses"] = math.inf, -math.inf  # sets have no order: none is at an end


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskSurface:
    """All errors of one task: S subjects, P protocols."""

    task: str
    cutoff_hz: FloatArray  # (P,)
    turn_rate_step_dps: FloatArray  # (P,), d
    turn_rate_min_dps: FloatArray  # (P,), omega_m
    turn_rate_max_dps: FloatArray  # (P,), omega_M
    rig_minutes: FloatArray  # (P,), length of a session, min
    error_rms_deg: FloatArray  # (S, P), pitch error over the motion, deg; NaN where the device was left uncalibrated
    error_max_deg: FloatArray  # (S, P), as above
    error_end_deg: FloatArray  # (S, P), size of the median over the last half second
    error_offline_rms_deg: FloatArray  # (S, P), the same three with the estimated delay taken out
    error_offline_max_deg: FloatArray
    error_offline_end_deg: FloatArray
    left_out: tuple[int, ...] = ()  # subjects not among the S: no protocol could calibrate their device
    further: Mapping[str, FloatArray] = field(default_factory=dict)  # (P,) each, by names of ``space.FURTHER``

    def error(self, objective: Objective = "rms", timing: Timing = "offline") -> FloatArray:
        """Return the errors (S, P) that are to be small, deg."""
        found: FloatArray = getattr(self, column_of(objective, timing))
        return found

    def aimed(self, aim: Aim) -> FloatArray:
        """Return the errors (S, P) that a study minimises, deg."""
        return self.error(aim.objective, aim.timing)

    @property
    def names(self) -> tuple[str, ...]:
        """The columns of what is varied."""
        return (*COLUMNS[:4], *self.further)

    def column(self, name: str) -> FloatArray:
        """Return what the protocols have of a parameter, (P,)."""
        values: FloatArray = self.further[name] if name in self.further else getattr(self, name)
        return values

    def at_end(self, value: float, name: str) -> bool:
        """Return whether a value of a parameter is the first or last of several that were tried, with more beyond it."""
        column, least, most = self.column(name), *ENDS.get(name, (0.0, math.inf))
        if name == "cutoff_hz" and "sample_rate_hz" in self.further:
            most *= float(self.further["sample_rate_hz"].max()) / SAMPLE_RATE_HZ
        low, high = float(column.min()), float(column.max())
        return low < high and ((value == low and low > least) or (value == high and high < most))

    def line(self, place: int, name: str) -> IntArray:
        """Return the protocols that differ from one in a parameter alone, by its rising values."""
        columns = {other: self.column(other) for other in self.names if other != name}
        same = np.all([np.isclose(column, column[place]) for column in columns.values()], axis=0)
        places: IntArray = np.flatnonzero(same)
        return places[np.argsort(self.column(name)[places])]

    def at(self, places: IntArray) -> "TaskSurface":
        """Return the surface of some of the protocols."""
        further = {name: values[places] for name, values in self.further.items()}
        return replace(self, **{name: getattr(self, name)[..., places] for name in COLUMNS}, further=further)


def run_study(
    study: Study, executor: Executor, folder: Path, *, advance: Callable[[int, int], None] = lambda done, total: None
) -> tuple[TaskSurface, ...]:
    """Run every protocol on every subject, or what is left of that; ``advance`` gets units done and units in all."""
    units, store = units_of(study), RunStore(folder, study)
    done = sum(map(store.holds, units))
    advance(done, len(units))
    for count, _ in enumerate(store.finish(units, executor), done + 1):
        advance(count, len(units))
    return read_surfaces(store.join(units), study)


def count_runs(study: Study) -> int:
    """Return the runs of all tasks."""
    return sum(study.subjects * task.space.count for task in study.tasks)


def read_surfaces(path: Path, study: Study) -> tuple[TaskSurface, ...]:
    """Read the surfaces of a finished grid search."""
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    columns = {name: table.column(name).to_numpy(zero_copy_only=False) for name in table.column_names}
    found = []
    for task in study.tasks:
        rows, shape = columns["task"] == task.key, (study.subjects, task.space.count)
        if rows.sum() != math.prod(shape):
            raise InputError(
                f"{path}: wanted {math.prod(shape)} runs of {task.key}, got {rows.sum()}; run the study to its end"
            )
        shaped = {name: np.asarray(columns[name][rows], float).reshape(shape) for name in COLUMNS}
        own: dict[str, Any] = {n: values if n.startswith("error") else values[0] for n, values in shaped.items()}
        own["further"] = {n: np.asarray(columns[n][rows], float).reshape(shape)[0] for n in further_of(task)}
        found.append(TaskSurface(task=task.key, **own))
    return tuple(found)


def without_lost(surface: TaskSurface) -> TaskSurface:
    """Leave out the subjects whose device no protocol could calibrate: they do not compare protocols."""
    there = np.isfinite(surface.error_rms_deg).any(axis=1)
    if there.all() or there.sum() < 3:
        return surface
    return replace(
        surface,
        **{name: getattr(surface, name)[there] for name in ERRORS},
        left_out=tuple(int(subject) for subject in np.flatnonzero(~there)),
    )
