"""The registry of formats: every row is sound, and another package adds one through an entry point."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import undrift
from undrift.io.column_map import ColumnMap
from undrift.io.formats import FORMATS, detect, iter_record, outside_formats
from undrift.io.inspect import describe
from undrift.record import Reference

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


def test_a_format_of_another_package_never_replaces_one_of_undrift(site, tmp_path):
    install(site, POINTS)
    (tmp_path / "r.csv").write_text("time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n0,1,2,3\n1,1,2,3\n")
    assert detect(tmp_path / "r.csv") == "csv"
    assert undrift.read_record(tmp_path / "r.csv").device == ""


def test_an_entry_point_that_is_no_format_is_skipped_with_a_warning(site, tmp_path):
    install(site, "[undrift.formats]\nbroken = their_logger:NO_FORMAT\n")
    (tmp_path / "a.log").write_text("a\n")
    with pytest.warns(UserWarning, match="the format broken of another package is not used"):
        assert detect(tmp_path / "a.log") == "text"
