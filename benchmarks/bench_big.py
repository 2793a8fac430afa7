"""``undrift correct`` on a 2 GB Parquet recording, compared with pyarrow reading and writing the same rows unchanged.

Every run is a separate process, as started by a user. pyarrow reads the same batches and writes with the same settings.
The readings are random, so the file cannot be compressed. The calibration has every term: matrices, g-sensitivity, both
tables.
"""

import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.bench_correct import _calibration, _drift
from benchmarks.figure import Figure
from undrift.io.parquet import CHUNK_ROWS, ParquetWriter
from undrift.io.store import write_calibration
from undrift.record import Record

ROWS = 33_500_000  # of eight float64 columns: 2.0 GB
MADE_ROWS = 1 << 20  # a row group, pyarrow's default
FREE = 8e9  # bytes of disk
ROUNDS = 3

CORRECT = "import sys; from undrift.cli.app import main; sys.exit(main())"
UNTOUCHED = """
import sys
import pyarrow as pa
from pyarrow import parquet as pq
source, target, rows = sys.argv[1], sys.argv[2], int(sys.argv[3])
with pq.ParquetFile(source, pre_buffer=False, buffer_size=1 << 20) as handle:
    with pq.ParquetWriter(target, handle.schema_arrow, use_dictionary=False) as writer:
        for batch in handle.iter_batches(batch_size=rows):
            writer.write_table(pa.Table.from_batches([batch]))
"""
# A process inherits the peak memory of its parent, so a small process must start it.
LAUNCHER = """
import resource, subprocess, sys, time
start = time.perf_counter()
subprocess.run([sys.executable, "-c", *sys.argv[1:]], check=True, stdout=subprocess.DEVNULL)
print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds, their ratio, and the peak memory; nothing where the disk is too full.
    """
    with tempfile.TemporaryDirectory(prefix="undrift-big-") as folder_name:
        folder = Path(folder_name)
        if (free := shutil.disk_usage(folder).free) < FREE:
            print(f"big: left out, wants {FREE / 1e9:.0f} GB of free disk in {folder.parent}, got {free / 1e9:.1f}")
            return []
        source, target, model = folder / "raw.parquet", folder / "out.parquet", folder / "calibration.json"
        _make(source)
        write_calibration(_calibration(_drift()), model)
        commands = {
            "correct": [CORRECT, "correct", str(source), "--calibration", str(model), "-o", str(target)],
            "untouched": [UNTOUCHED, str(source), str(target), str(CHUNK_ROWS)],
        }
        seconds: dict[str, list[float]] = {name: [] for name in commands}
        memory = dict.fromkeys(commands, 0.0)
        for k in range(ROUNDS):
            for name in sorted(commands, reverse=bool(k % 2)):
                took, peak = _process(commands[name])
                seconds[name].append(took)
                memory[name] = max(memory[name], peak)
                target.unlink()
        size = source.stat().st_size
    s = {name: statistics.median(values) for name, values in seconds.items()}
    return [
        Figure("size of the recording", size / 1e9, "GB"),
        Figure("undrift correct, every term, whole process", s["correct"], "s"),
        Figure("pyarrow reads and writes it untouched, whole process", s["untouched"], "s"),
        Figure("undrift correct over pyarrow untouched", s["correct"] / s["untouched"], "x", "<= 1.5"),
        Figure("undrift correct, peak memory", memory["correct"], "MB", "<= 500"),
        Figure("pyarrow untouched, peak memory", memory["untouched"], "MB"),
    ]


def _make(path: Path) -> None:
    rng = np.random.default_rng(1)
    with ParquetWriter(path) as writer:
        for start in range(0, ROWS, MADE_ROWS):
            n = min(MADE_ROWS, ROWS - start)
            record = Record(
                time=np.arange(start, start + n) * 0.01,
                gyro=rng.normal(size=(n, 3)) * 0.5,
                accel=rng.normal(size=(n, 3)) * 3.0,
                temp_c=rng.uniform(25.0, 55.0, n),
            )
            writer.write(record)


def _process(arguments: list[str]) -> tuple[float, float]:
    """Run one, and return its wall time, s, and the peak of its resident memory, MB."""
    done = subprocess.run([sys.executable, "-c", LAUNCHER, *arguments], check=True, stdout=subprocess.PIPE, text=True)
    took, peak = done.stdout.split()
    return float(took), float(peak) * (1.0 if sys.platform == "darwin" else 1024.0) / 1e6
