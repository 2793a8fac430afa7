"""Record the sample session of the package again: ``python -m benchmarks.make_sample FOLDER``, about 20 s on an idle
machine.

Table, chamber and device are simulated, as in ``undrift demo``, and the device and the person are drawn by fixed seeds, so a new
recording is the same.
"""

import shutil
import sys
import tempfile
from pathlib import Path

from undrift.io.formats import write_record
from undrift.io.reference import write_reference
from undrift.programme import FacesTable, Protocol, ProtocolTable
from undrift.study.virtual_bench import bench_device, bench_protocols, record_on_bench, worn_trial

FACE_S, DWELL_S, STEP_DPS = 6.0, 3.0, 30.0
REST_S = 240.0


def main(folder: Path) -> None:
    """Write bench/ (six faces and rates), thermal/ (set-points), rest.parquet, and a sit-to-stand task with its optics."""
    (bench, thermal), device = bench_protocols(quick=True), bench_device()
    assert bench.rates is not None
    rates = bench.rates.but(seconds=DWELL_S, turn_rate_min_dps=STEP_DPS, turn_rate_step_dps=STEP_DPS)
    room = bench.but(faces=FacesTable(seconds=FACE_S), rates=rates)
    rest = Protocol(protocol=ProtocolTable(name="rest"), faces=FacesTable(order=("+z",), seconds=REST_S))
    folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as temporary:
        record_on_bench((room, thermal), device, folder, tell=lambda what, share: None)
        recorded = Path(temporary)
        record_on_bench((rest,), device, recorded, tell=lambda what, share: None)
        (piece,) = (recorded / "rest" / "pieces").iterdir()
        shutil.copy(piece, folder / "rest.parquet")
    for lock in folder.rglob("lock"):
        lock.unlink()
    record, reference = worn_trial(device, seed=1)
    write_record(record, folder / "sit_to_stand.parquet")
    write_reference(reference, folder / "sit_to_stand_optics.parquet")
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    print(f"{folder}: {size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
