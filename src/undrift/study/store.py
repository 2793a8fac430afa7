"""Store of a study's runs: one Parquet piece for each finished unit, whole or not there; joined to one surface in the end.

DIR/study.json says which study the pieces belong to; a folder of another study is refused. A study that was cut off goes on
with the units that have no piece.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.study.plan import Study, StudyTask
from undrift.study.unit import COLUMNS, Unit, UnitRuns

PIECES = "runs"
HEAD = "study.json"
SURFACE = "surface.parquet"


class RunStore:
    """Finished units of a study in a folder.

    Parameters
    ----------
    folder : Path
        Made where it is missing.
    study : Study
        Whose runs they are.
    only : tuple of StudyTask
        A part of it, in place of the study's own tasks.
    """

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
        """Return whether a unit is finished.

        Parameters
        ----------
        unit : Unit
            One of the study.

        Returns
        -------
        bool
            True where its piece is there.
        """
        return self._piece(unit).exists()

    def write(self, unit: Unit, runs: UnitRuns) -> None:
        """Keep what came of a unit.

        Parameters
        ----------
        unit : Unit
            One of the study.
        runs : UnitRuns
            Its runs.
        """
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

        Parameters
        ----------
        unit : Unit
            A finished one.

        Returns
        -------
        dict of str to array, shape (P,)
            By the names of ``COLUMNS``.
        """
        import pyarrow.parquet as pq

        table = pq.read_table(self._piece(unit))
        return {name: np.asarray(table.column(name).to_numpy(), float) for name in COLUMNS}

    def join(self, units: tuple[Unit, ...]) -> Path:
        """Join the pieces to one file.

        Parameters
        ----------
        units : tuple of Unit
            All of the study, finished.

        Returns
        -------
        Path
            The surface: a row for each run.
        """
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
