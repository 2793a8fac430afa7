"""How far files are read is a share of the work that every command states as it states the rest."""

import numpy as np
import pytest

import undrift
from undrift.commands.correct import correct
from undrift.files import read_so_far
from undrift.io import log, text
from undrift.screen import Screen, part, reading, showing_on
from undrift.sim.device.presets import preset


class Listener(Screen):
    """A screen that keeps what it is told."""

    def __init__(self):
        self.told = []

    def progress(self, task, share):
        self.told.append((task, share))


@pytest.fixture
def shares(monkeypatch):
    """What a command says, with files of text in pieces of some kilobytes."""
    monkeypatch.setattr(text, "_PIECE", 4096)
    monkeypatch.setattr(log, "_WATCHED", 50)
    listener = Listener()
    with showing_on(listener):
        yield listener.told


@pytest.fixture
def table(tmp_path):
    rng, path = np.random.default_rng(3), tmp_path / "rest.csv"
    rows = np.column_stack((np.arange(6000) / 100.0, rng.normal(0.0, 0.1, (6000, 3)), rng.normal(0.0, 0.01, (6000, 3))))
    rows[:, 6] += 9.81
    names = ("time_s", *(f"gyro_{axis}_dps" for axis in "xyz"), *(f"accel_{axis}_m_s2" for axis in "xyz"))
    np.savetxt(path, rows, fmt="%.5f", delimiter=",", header=",".join(names), comments="")
    return path


def rising(shares, path, least):
    """Check that the file is named with growing shares; return the largest."""
    read = [share for what, share in shares if what == f"reading {path.name}"]
    assert len(set(read)) > least
    assert read == sorted(read)
    return read[-1]


def test_files_count_by_their_bytes_and_twice_read_they_count_once(tmp_path, shares):
    small, large, beside = (tmp_path / name for name in ("small", "large", "beside"))
    for path, size in ((small, 100), (large, 300), (beside, 500)):
        path.write_bytes(bytes(size))
    with part(0.2, 1.0), reading(0.5, small, large):
        for path, share in ((small, 1.0), (small, 0.5), (large, 0.5), (large, 1.0), (beside, 1.0)):
            read_so_far(path, share)
    read_so_far(small, 0.0)  # nobody listens any more
    assert [what for what, _ in shares] == [
        "reading",
        *(f"reading {name}" for name in ["small", "small", "large", "large", "beside"]),
    ]
    assert [share for _, share in shares] == pytest.approx([0.2, 0.3, 0.3, 0.45, 0.6, 0.6])


def test_correct_states_how_far_a_table_is_read_in_its_second_thread(table, tmp_path, shares):
    model = undrift.calibrate(undrift.simulate_session("bench", preset("xsens_mti1"), rng=np.random.default_rng(1)))
    undrift.write_calibration(model, tmp_path / "calibration.json")
    for ending in ("parquet", "csv"):
        correct(table, calibration=tmp_path / "calibration.json", output=tmp_path / f"o.{ending}")
        assert rising(shares, table, 50) == pytest.approx(0.8)
        shares.clear()


def test_a_log_is_followed(tmp_path, shares):
    path = tmp_path / "serial.txt"
    path.write_text("".join(f"gyro x: {k} y: 2 z: 3 | acc x: 0.1 y: 0.2 z: 9.8\n" for k in range(500)))
    with reading(1.0, path):
        assert len(log.read_readings(path).names) == 6
    assert rising(shares, path, 8) == 1.0
