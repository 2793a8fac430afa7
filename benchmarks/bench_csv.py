"""read_record against pyarrow's own reader on the same million rows."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.figure import Figure, stopwatch
from undrift.io.formats import read_record
from undrift.io.text import write_csv
from undrift.record import Record

N = 1_000_000


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds and the ratio.
    """
    import pyarrow.csv

    rng = np.random.default_rng(1)
    record = Record(
        time=np.arange(N) * 0.01,
        gyro=np.round(rng.normal(size=(N, 3)), 6),
        accel=np.round(rng.normal(size=(N, 3)), 6),
        temp_c=np.round(25.0 + rng.normal(size=N), 2),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.csv"
        write_csv(record, path)
        s = stopwatch({"undrift": partial(read_record, path), "pyarrow": partial(pyarrow.csv.read_csv, path)}, rounds=5)
    return [
        Figure("read_record of CSV, a million rows of eight columns", s["undrift"], "s"),
        Figure("read_record of CSV over pyarrow.csv", s["undrift"] / s["pyarrow"], "x", "<= 1.3"),
    ]
