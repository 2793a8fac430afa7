"""A table of the comparison, and other programs on its readings."""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from undrift.arrays import FloatArray

DATA = Path(os.environ.get("UNDRIFT_DATA", Path(__file__).parents[2] / ".." / "shared" / "data")).resolve()


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """The remaining error of a method for each recording."""

    method: str
    values: list[float]
    tuned: str  # On what its settings were chosen
    program: str = ""  # That made the orientation

    def as_dict(self) -> dict[str, object]:
        """Return it with its mean and the 95 % interval of the mean, Student's t over the recordings."""
        n, mean = len(self.values), float(np.mean(self.values))
        half = float(student.ppf(0.975, n - 1) * np.std(self.values, ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
        low, high = (round(max(mean - half, 0.0), 4), round(mean + half, 4)) if n > 2 else (None, None)
        return {
            "method": self.method, "program": self.program, "tuned": self.tuned, "mean": round(mean, 4), "low": low,
            "high": high, "values": [round(float(value), 4) for value in self.values],
        }  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows in one unit over the same recordings."""

    name: str
    title: str
    unit: str
    what: str  # method of judging
    source: str  # Of the recordings
    recordings: list[str]
    rows: list[Row] = field(default_factory=list)

    def as_dict(self) -> dict[str, object]:
        """Return it as the result file has it."""
        texts = {key: getattr(self, key) for key in ("name", "title", "unit", "what", "source", "recordings")}
        return {**texts, "rows": [row.as_dict() for row in self.rows]}


def by_others(kind: str, **arrays: FloatArray | float) -> dict[str, FloatArray]:
    """Return what other programs make of a job, each by its name and version."""
    python = os.environ.get("UNDRIFT_RIVALS")
    if not python:
        sys.exit(
            "UNDRIFT_RIVALS: wanted the Python of an environment with ahrs, allantools, imucal and vqf, got none; make one"
        )
    with tempfile.TemporaryDirectory() as folder:
        job, out = Path(folder, "job.npz"), Path(folder, "out.npz")
        np.savez(job, kind=kind, **arrays)  # type: ignore[arg-type]
        subprocess.run([python, str(Path(__file__).with_name("rivals.py")), str(job), str(out)], check=True)
        with np.load(out) as content:
            return {name: content[name] for name in content.files}
