"""undrift info on containers: the next line works, notes are no problems, what is missing is named."""

import re
import shlex

import numpy as np
import pytest

from testkit.data import data_path
from undrift.io.formats import write_record
from undrift.record import Record

LOG = ("makers", "px4_ulog", "sample_log_small.ulg")


def test_the_line_that_info_prints_for_a_file_of_several_sensors_works(undrift):
    path = data_path(*LOG)
    line = re.search(r"Next: undrift (.*)", undrift.good("info", path).out).group(1)
    told = undrift.good(*shlex.split(line), "--json").json()
    assert told["kind"] == "recording"


def test_how_a_container_was_read_is_a_note_not_a_problem(undrift):
    said = undrift.good("info", data_path(*LOG), "--sensor", "sensor_combined").out
    assert "read: already corrected by the autopilot" in said
    assert "problem: already" not in said


def test_a_cut_file_ends_in_one_line_and_a_map_reads_the_rest(undrift, tmp_path):
    path = data_path("makers", "geneactiv_bin", "GENEActiv_testfile.bin")
    said = undrift.refused("info", path)
    assert "222048 pages are missing" in said
    (tmp_path / "map.toml").write_text("drop_bad_rows = true\n")
    told = undrift.good("info", path, "--map", tmp_path / "map.toml", "--json").json()
    assert told["rows"] == 5031
    assert told["temp_c"] == pytest.approx([21.5, 23.1], abs=1e-5)


def test_a_map_adds_a_thermometer_of_its_own(undrift, tmp_path):
    record = Record(time=5 + np.arange(100) / 10, gyro=np.zeros((100, 3)), gyro_unit="dps")
    write_record(record, tmp_path / "r.csv")
    (tmp_path / "t.csv").write_text("time_s,temp_c\n7,20\n11,24\n")
    (tmp_path / "a.toml").write_text('temp_file = { file = "t.csv" }\n')
    said = undrift.good("info", tmp_path / "r.csv", "--map", tmp_path / "a.toml").out
    assert "temperature: 20.00 to 24.00 degC" in said
    assert "read: temperature of t.csv, interpolated onto the samples" in said
