"""Where results may go: never over what is read, never into a folder that is not there, and whole or not at all."""

import shutil
from pathlib import Path

import pytest
import rich.color  # noqa: F401  # an interpreter in a folder of root cannot import more once its rights are gone

from testkit.command_line import contents
from undrift.commands.outputs import name_of

WRITERS = {  # the call, and the ending of what it writes
    "calibrate": (["calibrate", "{bench}/session"], ".json"),
    "correct": (["correct", "{bench}/trial.parquet", "--calibration", "{bench}/calibration.json"], ".csv"),
    "orient": (["orient", "{bench}/corrected.parquet"], ".csv"),
    "validate": (["validate", "{bench}/corrected.parquet", "--reference", "{bench}/reference.parquet"], ""),
}


def words_of(command, bench, output):
    words, _ = WRITERS[command]
    return [*(word.format(bench=bench) for word in words), "-o", output]


@pytest.mark.parametrize("command", WRITERS)
def test_a_folder_that_is_not_there_is_not_made_up(undrift, bench, tmp_path, command):
    ending = WRITERS[command][1]
    line = undrift.refused(*words_of(command, bench, tmp_path / "none" / "deep" / f"result{ending}"))
    assert "Create it first" in line
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("command", [command for command in WRITERS if command != "validate"])
def test_a_folder_of_the_name_of_the_result_is_left(undrift, bench, tmp_path, command):
    output = tmp_path / f"result{WRITERS[command][1]}"
    output.mkdir()
    assert "got a folder" in undrift.refused(*words_of(command, bench, output))
    assert contents(tmp_path) == {output.name: None}


def test_a_link_to_what_is_read_is_what_is_read(undrift, bench, tmp_path):
    shutil.copytree(bench, tmp_path / "b")
    link = tmp_path / "link.parquet"
    link.symlink_to(tmp_path / "b" / "corrected.parquet")
    before = contents(tmp_path)
    assert "this file is an input" in undrift.refused(*words_of("orient", tmp_path / "b", link))
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("walk.csv", "walk"), ("walk.v2.csv.gz", "walk.v2"), ("02_slow.hdf5", "02_slow"), ("a.b", "a.b"), (".csv", ".csv"),
        ("imu0.log.gz", "imu0"), ("folder", "folder"),
    ],
)  # fmt: skip
def test_recordings_are_named_without_their_endings(name, expected):
    assert name_of(Path("some") / name) == expected
