"""One door: each file takes the reader its content calls for, whatever its name."""

import json
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import undrift
from testkit.column_maps import column_map
from testkit.strategies import assert_same, few, one_line, records
from testkit.trc_text import trc
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import ColumnMap
from undrift.io.columns import two_rates
from undrift.io.formats import FORMATS, detect, iter_record, outside_formats, read_counted, read_record, write_record
from undrift.io.inspect import describe
from undrift.record import ForceUncertainty, Record, Reference, joined


def ramp(n=30):
    return Record(time=np.arange(n) / 100, gyro=np.arange(3.0 * n).reshape(n, 3) / 100, accel=np.ones((n, 3)))


@pytest.mark.slow
@few
@given(record=records(), ending=st.sampled_from(["parquet", "csv", "csv.gz"]))
def test_what_is_written_reads_back_under_any_name(tmp_path_factory, record, ending):
    folder = tmp_path_factory.mktemp("door")
    write_record(record, folder / f"r.{ending}")
    assert_same(read_record(folder / f"r.{ending}"), record)
    shutil.move(folder / f"r.{ending}", folder / "renamed.dat")
    if (folder / f"r.{ending}.json").exists():  # frame, state and device of a CSV stand beside it
        shutil.move(folder / f"r.{ending}.json", folder / "renamed.dat.json")
    assert_same(read_record(folder / "renamed.dat"), record)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.trc", trc(np.ones((3, 1, 3)), ("A",)), "got marker trajectories. Read them as a reference"),
        ("a.cwa", b"MD\x00\x01" * 50, "damaged or truncated"),
        ("a.bin", bytes(np.random.default_rng(1).integers(0, 256, 4096, dtype=np.uint8)), "binary data of an unknown kind"),
        ("a.dat", b"\x00\x01\x02" * 50, "got binary data of an unknown kind"),
        ("a.zip", b"PK\x03\x04" + b"\x00" * 40, "damaged"),
        ("a.json", '{"a": 1}', "got JSON, not a recording"),
        ("a.toml", "a = 1", "got settings, not a recording"),
        ("a.md", "# words\n\nand more\n", "got prose, not a table"),
    ],
)  # fmt: skip
def test_what_is_no_recording_says_what_it_is(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(FileFormatError, match=words) as caught:
        read_record(tmp_path / name)
    one_line(caught)


def test_folders_and_missing_files_are_one_line(tmp_path):
    with pytest.raises(InputError, match=r"expected a file, or a folder with session.toml"):
        read_record(tmp_path)
    with pytest.raises(InputError, match="no file with this name"):
        read_record(tmp_path / "none.csv")
    (tmp_path / "session.toml").touch()
    with pytest.raises(FileFormatError, match="got a session of recordings"):
        read_record(tmp_path)
    with pytest.raises(InputError, match=r"expected a name ending in .parquet, .csv or .csv.gz"):
        write_record(ramp(), tmp_path / "r.xlsx")
    write_record(ramp(), tmp_path / "r.csv")
    with pytest.raises(InputError, match="two samples or more in a chunk, got 1"):
        list(iter_record(tmp_path / "r.csv", rows=1))


def calibrated(n=30):
    rng = np.random.default_rng(4)
    known = ForceUncertainty(
        covariance=np.cov(rng.normal(size=(12, 40))),
        offset_temp_c=[20.0, np.nan],
        matrix_temp_c=[25.0, 25.0],
        per_k=[5e-3, 2e-4],
        step=[0.0, 0.01, 0.02],
        calibrated="2026-03-01T08:30:00+00:00",
    )
    return replace(ramp(n), state="corrected", frame="b", accel_uncertainty=known)


@pytest.mark.parametrize("name", ["r.parquet", "r.csv", "r.csv.gz", "frame"])
def test_what_a_calibration_knows_of_the_accelerometers_comes_back_with_the_recording(tmp_path, name):
    record = calibrated()
    if name == "frame":
        back = [Record.from_frame(record.to_frame())]
    else:
        write_record(record, tmp_path / name)
        back = [read_record(tmp_path / name), *iter_record(tmp_path / name, rows=11)]
    assert len(back) != 2
    for one in (*back, record.part(3, 9), record.in_units("dps", "g")):
        for field in fields(ForceUncertainty):
            held, wanted = (getattr(r.accel_uncertainty, field.name) for r in (one, record))
            assert held == wanted if field.name == "calibrated" else np.array_equal(held, wanted, equal_nan=True)


@pytest.mark.parametrize(
    "changes", [{"covariance": [[1.0]]}, {"per_k": [1.0, None]}, {"calibrated": 3}, {"strange": 1}, {"step": "abc"}]
)
def test_what_is_no_uncertainty_of_the_accelerometers_is_refused_in_one_line(tmp_path, changes):
    write_record(calibrated(), tmp_path / "r.csv")
    beside = tmp_path / "r.csv.json"
    held = json.loads(beside.read_text())
    held["accel_uncertainty"] |= changes
    beside.write_text(json.dumps(held))
    with pytest.raises(FileFormatError, match="frame, state and device of a recording, got other") as raised:
        read_record(tmp_path / "r.csv")
    assert one_line(raised)


# ---- Stretches that are left out


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_a_stretch_is_cut_off_at_an_end_and_a_gap_between(tmp_path, ending):
    write_record(ramp(), tmp_path / f"r.{ending}")  # 0 to 0.29 s
    settings = ColumnMap(leave_out=((-1.0, 0.05), (0.1, 0.15), (0.25, 9.0)))
    whole, record = ramp(), read_record(tmp_path / f"r.{ending}", settings)
    np.testing.assert_array_equal(record.time, whole.time[5:25])
    out = (record.time >= 0.1) & (record.time < 0.15)
    assert out.sum() == 5
    for name in ("gyro", "accel"):
        assert np.isnan(getattr(record, name)[out]).all()
        np.testing.assert_array_equal(getattr(record, name)[~out], getattr(whole, name)[5:25][~out])
    chunks = list(iter_record(tmp_path / f"r.{ending}", column_map=settings, rows=4))
    assert_same(joined(chunks), record)
    assert (
        "left out as specified: -1 to 0.05 s, 0.1 to 0.15 s, 0.25 to 9 s"
        in read_counted(tmp_path / f"r.{ending}", settings).notes
    )


@pytest.mark.parametrize(
    ("stretch", "words"),
    [
        ((5.0, 6.0), "expected a stretch within 0 to 0.29 s"),
        ((0.0, 0.285), "expected two remaining samples or more, got 1"),
    ],
)
def test_a_stretch_that_is_not_there_or_leaves_nothing_is_refused(tmp_path, stretch, words):
    write_record(ramp(), tmp_path / "r.parquet")
    with pytest.raises(InputError, match=re.escape(words)):
        read_record(tmp_path / "r.parquet", ColumnMap(leave_out=(stretch,)))


# ---- corners of the readers

XYZ = column_map(time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g")


def test_a_column_of_empty_cells_is_all_gaps(tmp_path):
    (tmp_path / "r.csv").write_text("t,u,v,w,x,y,z\n0,4,5,,1,2,3\n1,4,5,,1,2,3\n")
    assert read_counted(tmp_path / "r.csv", XYZ).record.accel.tolist() == [[1, 2, 3], [1, 2, 3]]
    unmapped = column_map(
        time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g", gyro=("u", "v", "w"), gyro_unit="dps"
    )
    with pytest.raises(InputError, match="a number in every row, got 2 empty"):
        read_counted(tmp_path / "r.csv", unmapped)


def test_a_single_slow_block_is_a_drop_out_and_not_a_second_rate():
    steps = np.full(2000, 0.01)
    steps[500:520] = 0.02
    assert two_rates(np.cumsum(steps)) is None
    steps[500:] = 0.02
    first, second, begins = two_rates(np.cumsum(steps))
    assert (first, second) == pytest.approx((100.0, 50.0))
    assert begins == pytest.approx(5.0, abs=0.7)


# ---- the registry of formats

LOGGER = """
import numpy as np
from undrift.io.formats import Format
from undrift.record import Record, Reference

def readings(path):
    return np.array([[float(x) for x in line.split("|")] for line in path.read_text().splitlines()[1:]])

def read_logger(path, how):
    rows = readings(path)
    rate = how.sample_rate_hz or 100.0
    return Record(time=np.arange(len(rows)) / rate, gyro=rows[:, :3], gyro_unit="dps", device="L1")

def read_poses(path, columns):
    rows = readings(path)
    return Reference(time=np.arange(len(rows)) / 100.0, q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1)))

FORMAT = Format(
    lambda path, head: head.startswith(b"LOGGER|"),
    record=read_logger,
    reference=read_poses,
)
NO_FORMAT = "read_logger"
"""
POINTS = "[undrift.formats]\nlogger = their_logger:FORMAT\ncsv = their_logger:FORMAT\n"


def install(folder: Path, points: str) -> None:
    """Write a package with entry points as Python finds an installed one."""
    (folder / "their_logger.py").write_text(LOGGER)
    (folder / "their_logger-1.0.dist-info").mkdir()
    (folder / "their_logger-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: their-logger\nVersion: 1.0\n"
    )
    (folder / "their_logger-1.0.dist-info" / "entry_points.txt").write_text(points)


@pytest.fixture
def site(tmp_path, monkeypatch) -> Iterator[Path]:
    """A folder on the path of Python, as site-packages is."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    outside_formats.cache_clear()
    yield folder
    outside_formats.cache_clear()
    sys.modules.pop("their_logger", None)


def log(path: Path, n: int = 300) -> np.ndarray:
    rates = np.random.default_rng(3).normal(0.0, 0.5, (n, 3))
    path.write_text("LOGGER|1|x\n" + "\n".join("|".join(map(repr, map(float, row))) for row in rates) + "\n")
    return rates


def test_every_format_reads_something_or_names_what_it_is():
    for name, entry in FORMATS.items():
        readers = (entry.record, entry.markers, entry.reference)
        assert any(readers) or entry.instead, name
        assert entry.record is not None or entry.instead, name


def test_a_format_of_another_package_is_read_and_described(site, tmp_path):
    install(site, POINTS)
    rates = log(tmp_path / "a.log")
    assert "their_logger" not in sys.modules
    assert detect(tmp_path / "a.log") == "logger"
    record = undrift.read_record(tmp_path / "a.log")
    np.testing.assert_array_equal(record.gyro, rates)
    assert (record.device, record.sample_rate_hz) == ("L1", pytest.approx(100.0))
    slower = undrift.read_record(tmp_path / "a.log", ColumnMap(sample_rate_hz=50.0))
    assert slower.sample_rate_hz == pytest.approx(50.0)
    assert isinstance(undrift.read_reference(tmp_path / "a.log"), Reference)
    assert [len(part) for part in iter_record(tmp_path / "a.log", rows=200)] == [200, 100]
    found = describe(tmp_path / "a.log")
    assert (found.kind, found.format, found.rows, found.units[1]) == ("recording", "logger", 300, ("gyro", "dps"))
