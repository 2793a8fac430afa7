"""Run a study: its units on an executor, each kept as it is finished, and the whole error surface in the end.

Executor: the one seam between a study and the machines that it runs on.

A study hands over a function and its units of work and takes what comes back, in any order. Three executors do that alike: in
this process, on a pool of processes, on a Dask scheduler. A unit carries its own seed, so the bits of its result depend on
neither the executor, nor the number of workers, nor the order. A worker that is killed loses what it had in hand; that is
done again.

Store of a study's runs: one Parquet piece for each finished unit, whole or not there; joined to one surface in the end.

DIR/study.json says which study the pieces belong to; a folder of another study is refused. A study that was cut off goes on
with the units that have no piece.

Successive halving: for spaces too wide for every protocol to meet every subject.

All candidates meet a few subjects, the better part goes on to more, and so on; the last few meet all::

    rung r: n_r candidates on s_r subjects;  n_{r+1} = ceil(n_r / keep),  s_{r+1} = min(growth s_r, S)

Subjects are the same for all candidates of a rung, and the errors of earlier rungs are kept: only new subjects cost anything.
A candidate that could not calibrate a device falls out. The winner was also lucky; what it is worth is said by the other
cohort (study/judge.py).
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable, UndriftError
from undrift.files import write_whole
from undrift.rig.programme import Protocol as CalibrationProtocol
from undrift.study.case import COLUMNS, Unit, UnitRuns, run_unit, units_of
from undrift.study.plan import Study, StudyTask

# ---- Executor: the one seam between a study and the machines that it runs on.

Job = TypeVar("Job", contravariant=True)
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
        """Do units of work."""


@dataclass(frozen=True, slots=True)
class InProcess:
    """One unit after the other, here."""

    @property
    def workers(self) -> int:
        """One."""
        return 1

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work in their order."""
        for place, unit in enumerate(units):
            yield place, work(unit)


@dataclass(frozen=True, slots=True)
class Pool:
    """Processes of this machine; fresh ones in place of those that are killed."""

    workers: int  # How many

    def run(self, work: Callable[[U], R], units: Sequence[U]) -> Iterator[tuple[int, R]]:
        """Do units of work."""
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
    """Return the executor that a command line asks for."""
    import os

    if scheduler is not None and workers is not None:
        raise InputError("study: wanted --scheduler or --workers, got both; the scheduler has its own workers")
    if scheduler is not None:
        return Dask(scheduler)
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count < 1:
        raise InputError(f"study: wanted one worker or more, got {count}")
    return InProcess() if count == 1 else Pool(count)


# ---- Store of a study's runs: one Parquet piece for each finished unit, whole or not there; joined to one surface in the end.

PIECES = "runs"
HEAD = "study.json"
SURFACE = "surface.parquet"


class RunStore:
    """Finished units of a study in a folder."""

    def __init__(self, folder: Path, study: Study, *, only: tuple[StudyTask, ...] = ()) -> None:
        self._pieces = folder / PIECES
        self._folder = folder
        try:
            self._pieces.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: wanted a folder to write to, got {error.strerror}; choose another") from error
        held = asdict(study)
        held["tasks"] = [asdict(task) for task in only or study.tasks]
        told = json.dumps(held, sort_keys=True)
        head = folder / HEAD
        if head.exists():
            self._check(head, told)
        else:
            write_whole(
                head, json.dumps({"kind": "undrift.study-runs", "format": 1, "study": json.loads(told)}, indent=1)
            )

    def holds(self, unit: Unit) -> bool:
        """Return whether a unit is finished."""
        return self._piece(unit).exists()

    def write(self, unit: Unit, runs: UnitRuns) -> None:
        """Keep what came of a unit."""
        import io

        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {name: np.asarray(getattr(runs, name)) for name in COLUMNS}
        count = len(runs.error_rms_deg)
        columns = {
            "task": np.full(count, unit.task.name),
            "subject": np.full(count, unit.subject, dtype=np.int32),
            **columns,
        }
        held = io.BytesIO()
        pq.write_table(pa.table(columns), held)
        write_whole(self._piece(unit), held.getvalue())

    def read(self, unit: Unit) -> dict[str, FloatArray]:
        """Read what came of a unit.

        Arrays:  -> (P,).
        """
        import pyarrow.parquet as pq

        table = pq.read_table(self._piece(unit))
        return {name: np.asarray(table.column(name).to_numpy(), float) for name in COLUMNS}

    def join(self, units: tuple[Unit, ...]) -> Path:
        """Join the pieces to one file."""
        import io

        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pa.concat_tables([pq.read_table(self._piece(unit)) for unit in units])
        held = io.BytesIO()
        pq.write_table(table, held, compression="zstd")
        path = self._folder / SURFACE
        write_whole(path, held.getvalue())
        return path

    def _piece(self, unit: Unit) -> Path:
        return self._pieces / f"{unit.key}.parquet"

    def _check(self, head: Path, told: str) -> None:
        try:
            held = json.loads(head.read_text(encoding="utf-8"))
            same = json.dumps(held["study"], sort_keys=True) == told
        except (OSError, ValueError, KeyError, TypeError):
            same = False
        if not same:
            mark = hashlib.sha256(told.encode()).hexdigest()[:8]
            raise InputError(
                f"{head.parent}: wanted an empty folder or one of this study ({mark}), got another's runs; choose another"
            )


# ---- Successive halving: for spaces too wide for every protocol to meet every subject.


@dataclass(frozen=True, slots=True, kw_only=True)
class HalvingSettings:
    """How fast candidates are dropped."""

    first_subjects: int = 3  # Of the first rung; too few, and the best protocol may be dropped by chance
    keep: float = 2.0  # Candidates of a rung over those of the next
    growth: float = 2.0  # Subjects of the next rung over those of a rung
    least: int = 4  # So many candidates meet all subjects

    def __post_init__(self) -> None:
        if self.first_subjects < 1 or not self.keep > 1.0 or not self.growth > 1.0 or self.least < 1:
            raise InputError(
                f"halving: wanted one subject or more, keep and growth above 1 and one last candidate or more, got "
                f"{self.first_subjects}, {self.keep:g}, {self.growth:g} and {self.least}"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rung:
    """A rung."""

    subjects: int  # That its candidates had met at its end
    candidates: IntArray  # Places among all candidates
    # (len(candidates), mean of the objective, deg; infinite where a device was left uncalibrated
    mean_deg: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Halving:
    """Outcome."""

    protocols: tuple[CalibrationProtocol, ...]  # All candidates
    best: int  # Place of the best of the last rung
    rungs: tuple[Rung, ...]  # From all candidates to the last few
    runs: int  # Sessions simulated and fitted
    runs_of_grid: int  # What every candidate on every subject would have cost


def halve(
    study: Study, task: StudyTask, executor: Executor, folder: Path, *, settings: HalvingSettings = HalvingSettings()
) -> Halving:
    """Find the best protocol of a task with a part of the runs."""
    protocols = tuple(p for cutoff in task.space.cutoff_hz for p in task.candidates(cutoff))
    error = np.full((study.subjects, len(protocols)), np.nan)
    left: IntArray = np.arange(len(protocols))
    met, wanted, runs = 0, min(settings.first_subjects, study.subjects), 0
    rungs: list[Rung] = []
    while True:
        block = tuple(range(met, wanted)), left
        error[met:wanted, left] = _run(study, task, block, protocols, executor, folder / f"rung-{len(rungs)}")
        runs += (wanted - met) * len(left)
        mean = error[:wanted, left].mean(axis=0)
        mean = np.where(np.isfinite(mean), mean, np.inf)
        rungs.append(Rung(subjects=wanted, candidates=left, mean_deg=mean))
        if not np.isfinite(mean).any():
            raise NotObservable(
                f"halving: wanted a protocol of {task.name} that calibrates every device, got none; try other rates"
            )
        if wanted == study.subjects:
            best = int(left[np.argmin(mean)])
            break
        kept = max(math.ceil(len(left) / settings.keep), settings.least)
        left = np.sort(left[np.argsort(mean, kind="stable")[:kept]])
        met, wanted = wanted, min(math.ceil(wanted * settings.growth), study.subjects)
        if len(left) <= settings.least:
            wanted = study.subjects
    return Halving(
        protocols=protocols,
        best=best,
        rungs=tuple(rungs),
        runs=runs,
        runs_of_grid=study.subjects * len(protocols),
    )


def _run(
    study: Study,
    task: StudyTask,
    block: tuple[tuple[int, ...], IntArray],
    protocols: tuple[CalibrationProtocol, ...],
    executor: Executor,
    folder: Path,
) -> FloatArray:
    """Return the errors of a block of subjects and candidates: units as a study's, with the candidates that are left."""
    subjects, left = block
    cutoffs = np.array([protocols[place].cutoff_hz for place in left])
    only = {
        cutoff: replace(
            task,
            space=replace(
                task.space,
                cutoff_hz=(cutoff,),
                only=tuple(_grid(protocols[place]) for place in left[cutoffs == cutoff]),
            ),
        )
        for cutoff in dict.fromkeys(cutoffs.tolist())
    }
    units = [Unit(study=study, task=only[cutoff], subject=s, cutoff_hz=cutoff) for s in subjects for cutoff in only]
    store = RunStore(folder, study, only=tuple(only.values()))
    todo = [unit for unit in units if not store.holds(unit)]
    for place, found in executor.run(run_unit, todo):
        store.write(todo[place], found)
    error, wanted = (
        np.empty((len(subjects), len(left))),
        "error_rms_deg" if study.objective == "rms" else "error_max_deg",
    )
    for unit in units:
        error[subjects.index(unit.subject), cutoffs == unit.cutoff_hz] = store.read(unit)[wanted]
    return error


def _grid(protocol: CalibrationProtocol) -> tuple[float, float, float]:
    return protocol.turn_rate_step, protocol.turn_rate_min, protocol.turn_rate_max


# ---- run


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskSurface:
    """All errors of one task: S subjects, P protocols."""

    task: str  # Its name
    cutoff_hz: FloatArray  # (P,), the protocols, Hz and deg/s
    turn_rate_step_dps: FloatArray  # (P,), the protocols, Hz and deg/s
    turn_rate_min_dps: FloatArray  # (P,), the protocols, Hz and deg/s
    turn_rate_max_dps: FloatArray  # (P,), the protocols, Hz and deg/s
    rig_minutes: FloatArray  # (P,), length of a session, min
    # (S, P), pitch error over the motion, deg; NaN where the protocol could not calibrate the device
    error_rms_deg: FloatArray
    # (S, P), pitch error over the motion, deg; NaN where the protocol could not calibrate the device
    error_max_deg: FloatArray
    # Subjects that are not among the S, since no protocol could calibrate their device
    left_out: tuple[int, ...] = ()

    def error(self, objective: str) -> FloatArray:
        """Return the errors that are to be small.

        Arrays:  -> (S, P) deg.
        """
        return self.error_rms_deg if objective == "rms" else self.error_max_deg


def run_study(
    study: Study, executor: Executor, folder: Path, *, advance: Callable[[int, int], None] | None = None
) -> tuple[TaskSurface, ...]:
    """Run a study, or what is left of it."""
    units, store = units_of(study), RunStore(folder, study)
    left = [unit for unit in units if not store.holds(unit)]
    done = len(units) - len(left)
    if advance:
        advance(done, len(units))
    for place, runs in executor.run(run_unit, left):
        store.write(left[place], runs)
        done += 1
        if advance:
            advance(done, len(units))
    return read_surfaces(store.join(units), study)


def read_surfaces(path: Path, study: Study) -> tuple[TaskSurface, ...]:
    """Read the surface of a finished study."""
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    columns = {name: table.column(name).to_numpy(zero_copy_only=False) for name in table.column_names}
    found = []
    for task in study.tasks:
        rows = columns["task"] == task.name
        protocols = sum(len(task.candidates(cutoff)) for cutoff in task.space.cutoff_hz)
        if rows.sum() != study.subjects * protocols:
            raise InputError(
                f"{path}: wanted {study.subjects * protocols} runs of {task.name}, got {rows.sum()}; run the study to its end"
            )
        shaped = {
            name: np.asarray(values[rows], float).reshape(study.subjects, protocols)
            for name, values in columns.items()
            if name not in ("task", "subject")
        }
        found.append(
            TaskSurface(
                task=task.name,
                error_rms_deg=shaped.pop("error_rms_deg"),
                error_max_deg=shaped.pop("error_max_deg"),
                **{name: values[0] for name, values in shaped.items()},
            )
        )
    return tuple(found)


def without_lost(surface: TaskSurface) -> TaskSurface:
    """Leave out the subjects whose device no protocol could calibrate: they say nothing of which protocol is better."""
    there = np.isfinite(surface.error_rms_deg).any(axis=1)
    if there.all() or there.sum() < 3:
        return surface
    return replace(
        surface,
        error_rms_deg=surface.error_rms_deg[there],
        error_max_deg=surface.error_max_deg[there],
        left_out=tuple(int(subject) for subject in np.flatnonzero(~there)),
    )


def count_runs(study: Study) -> int:
    """Return how many sessions a study simulates and fits."""
    return sum(study.subjects * len(task.candidates(cutoff)) for task in study.tasks for cutoff in task.space.cutoff_hz)
