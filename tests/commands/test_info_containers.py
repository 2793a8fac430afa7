"""undrift info on containers: the next line works, notes are no problems, what is missing is named."""

import re
import shlex

import numpy as np
import pytest

from testkit.command_line import row_of
from testkit.data import data_path
from undrift.io.formats import write_record
from undrift.record import Record

LOG = ("makers", "px4_ulog", "sample_log_small.ulg")


def test_the_line_that_info_prints_for_a_file_of_several_sensors_works(undrift):
    path = data_path(*LOG)
    line = re.search(r"Next: undrift (.*)", undrift.good("info", path).out).group(1)
    told = undrift.good(*shlex.split(line), "--json").data()
    assert told["kind"] == "recording"


def test_how_a_container_was_read_is_a_note_not_a_problem(undrift):
    told = undrift.good("info", data_path(*LOG), "--sensor", "sensor_combined", "--json").json()
    assert any("already corrected by the autopilot" in note for note in told["notes"])
    assert not any("already corrected" in finding["text"] for finding in told["findings"])


def test_a_cut_file_ends_in_one_line_and_a_map_reads_the_rest(undrift, tmp_path):
    path = data_path("makers", "geneactiv_bin", "GENEActiv_testfile.bin")
    said = undrift.refused("info", path)
    assert "222048 pages are missing" in said
    (tmp_path / "map.toml").write_text("drop_bad_rows = true\n")
    told = undrift.good("info", path, "--map", tmp_path / "map.toml", "--json").data()
    assert told["rows"] == 5031
    assert told["temp_c"] == pytest.approx([21.5, 23.1], abs=1e-5)


def test_a_map_adds_a_thermometer_of_its_own(undrift, tmp_path):
    record = Record(time=5 + np.arange(100) / 10, gyro=np.zeros((100, 3)), gyro_unit="dps")
    write_record(record, tmp_path / "r.csv")
    (tmp_path / "t.csv").write_text("time_s,temp_c\n7,20\n11,24\n")
    (tmp_path / "a.toml").write_text('temp_file = { file = "t.csv" }\n')
    told = undrift.good("info", tmp_path / "r.csv", "--map", tmp_path / "a.toml", "--json").json()
    assert row_of(told, "content", "lowest temperature")["value"] == 20.0
    assert row_of(told, "content", "highest temperature")["value"] == 24.0
    assert "temperature of t.csv, interpolated onto the samples" in told["notes"][0]
