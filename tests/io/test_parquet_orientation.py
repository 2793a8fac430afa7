"""Orientation over time as a table: it reads back as a reference."""

import gzip

import numpy as np
import pytest

from testkit.strategies import one_line
from undrift.errors import InputError
from undrift.io.formats import read_reference
from undrift.io.parquet import COLUMNS, write_orientation


def orientation(n=50, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    angles = tuple(rng.uniform(-np.pi, np.pi, n) for _ in range(3))
    return np.arange(n) / 100.0 + 7.0, q, angles


@pytest.mark.parametrize("name", ["a.parquet", "a.csv", "a.csv.gz", "A.CSV"])
def test_quaternions_come_back_as_a_reference(tmp_path, name):
    time, q, angles = orientation()
    write_orientation(time, q, angles, tmp_path / name)
    back = read_reference(tmp_path / name)
    np.testing.assert_array_equal(back.time, time)
    # the reader takes the length to one: a rounding error each
    np.testing.assert_allclose(np.sum(back.q_nb * q, axis=1) ** 2, 1.0, atol=1e-14)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_angles_are_in_degrees_under_their_names(tmp_path):
    time, q, angles = orientation()
    write_orientation(time, q, angles, tmp_path / "a.csv.gz")
    lines = gzip.decompress((tmp_path / "a.csv.gz").read_bytes()).decode().splitlines()
    assert lines[0].replace('"', "") == ",".join(COLUMNS)
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    for k, angle in enumerate(angles):
        np.testing.assert_allclose(table[:, 5 + k], np.degrees(angle), rtol=1e-15)


def test_a_pitch_with_gaps_is_an_empty_or_nan_cell_and_the_poses_still_read(tmp_path):
    time, q, angles = orientation()
    pitch = angles[2].copy()
    pitch[10:20] = np.nan
    write_orientation(time, q, (angles[0], angles[1], pitch), tmp_path / "a.csv")
    cells = [line.split(",")[-1] for line in (tmp_path / "a.csv").read_text().splitlines()[1:]]
    assert all(cell in ("", "nan") for cell in cells[10:20])
    assert read_reference(tmp_path / "a.csv").valid.all()


def test_another_ending_and_a_folder_that_is_not_there_are_refused(tmp_path):
    time, q, angles = orientation()
    with pytest.raises(InputError) as error:
        write_orientation(time, q, angles, tmp_path / "a.xlsx")
    assert "wanted a name ending in .parquet, .csv or .csv.gz, got another" in one_line(error)
    with pytest.raises(InputError) as error:
        write_orientation(time, q, angles, tmp_path / "none" / "a.csv")
    assert "cannot be written" in one_line(error)
    assert list(tmp_path.iterdir()) == []


def test_an_older_table_stays_where_the_new_one_cannot_be_finished(tmp_path, monkeypatch):
    from pathlib import Path

    time, q, angles = orientation()
    (tmp_path / "a.csv").write_text("older")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(InputError, match="No space left"):
        write_orientation(time, q, angles, tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == "older"
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
