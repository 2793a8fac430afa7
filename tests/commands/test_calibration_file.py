"""A calibration named by its file, or selected from a folder by the serial number of the recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import undrift
from undrift.commands.files import Opening, Reader
from undrift.errors import InputError
from undrift.io.formats import write_record

RNG = np.random.default_rng(5)
DEVICE = undrift.random_device(RNG)
SESSION = undrift.simulate_session("six_face", DEVICE, rng=RNG)
CALIBRATION = undrift.calibrate(SESSION)


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """Return a folder with three calibrations of A17 and one of B2, and a JSON file of another kind."""
    folder = tmp_path / "calibrations"
    (folder / "A17").mkdir(parents=True)
    for name, serial, created in (
        ("A17/old.json", "A17", "2025-03-01T08:00:00+00:00"),
        ("A17/a_new.json", "A17", "2026-03-01T08:00:00+00:00"),
        ("A17/undated.json", "A17", ""),
        ("B2.json", "B2", "2026-06-01T08:00:00+00:00"),
    ):
        _write(folder / name, serial, created)
    (folder / "device.json").write_text('{"kind": "undrift.device"}')
    return folder


def _write(path: Path, serial: str, created: str) -> None:
    made = replace(CALIBRATION.provenance, created=created)
    undrift.write_calibration(replace(CALIBRATION, device=serial, provenance=made), path)


def recording(folder: Path, serial: str) -> Path:
    path = folder / f"walk-{serial}.parquet"
    write_record(replace(SESSION.records[0], device=serial), path)
    return path


def test_a_file_is_read_without_a_note(shelf, tmp_path):
    chosen = Reader(Opening(), shelf / "B2.json", (tmp_path / "never-read.csv",))
    assert (chosen.path, chosen.model.device, chosen.notes) == (shelf / "B2.json", "B2", [])


def test_folder_gives_the_newest_of_the_serial_number_and_says_which(shelf, tmp_path):
    chosen = Reader(Opening(), shelf, (recording(tmp_path, "A17"),))
    assert chosen.path == shelf / "A17" / "a_new.json"
    assert chosen.model.provenance.created.startswith("2026-03-01")
    (note,) = chosen.notes
    assert note == f"The calibration is {chosen.path} of 2026-03-01, the newest of 3 of A17."


def test_no_match_is_refused_and_names_the_devices_of_the_folder(shelf, tmp_path):
    with pytest.raises(InputError, match=r"no calibration of C3 .* A17, B2"):
        Reader(Opening(), shelf, (recording(tmp_path, "C3"),))


def test_two_newest_of_one_date_are_refused(shelf, tmp_path):
    _write(shelf / "A17" / "again.json", "A17", "2026-03-01T08:00:00+00:00")
    with pytest.raises(InputError, match=r"a_new\.json, A17/again\.json"):
        Reader(Opening(), shelf, (recording(tmp_path, "A17"),))


def test_recordings_of_two_devices_are_refused(shelf, tmp_path):
    with pytest.raises(InputError, match="several devices"):
        Reader(Opening(), shelf, (recording(tmp_path, "A17"), recording(tmp_path, "B2")))


@pytest.mark.parametrize("name", ["walk-.parquet", "foreign.csv"])
def test_a_recording_without_serial_number_is_refused(shelf, tmp_path, name):
    recording(tmp_path, "")
    (tmp_path / "foreign.csv").write_text("t,gx,gy,gz\n" + "0,1,2,3\n" * 50)
    with pytest.raises(InputError, match="does not contain the serial number"):
        Reader(Opening(), shelf, (tmp_path / name,))


def test_a_damaged_file_is_refused_rather_than_passed_over(shelf, tmp_path):
    (shelf / "A17" / "newest.json").write_text('{"kind": "undrift.cal')
    with pytest.raises(InputError, match=r"newest\.json"):
        Reader(Opening(), shelf, (recording(tmp_path, "A17"),))
