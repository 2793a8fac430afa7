"""A folder in place of a recording: the command on each file, one table, and a second call that does what is missing."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from undrift.commands import batch
from undrift.io.formats import read_record, write_record
from undrift.record import Record

NAMES = ["gap.csv", "torn.parquet", "walk.parquet"]


@pytest.fixture
def folder(bench, tmp_path):
    """Two recordings of the bench's device, one with gaps, a damaged one, and what is none."""
    made = tmp_path / "in"
    made.mkdir()
    shutil.copy(bench / "trial.parquet", made / "walk.parquet")
    record = read_record(bench / "trial.parquet").between(0.0, 20.0)
    gyro = np.array(record.gyro)
    gyro[100:107] = np.nan
    write_record(Record(time=record.time, gyro=gyro, accel=record.accel, temp_c=record.temp_c, gyro_unit=record.gyro_unit,
                        accel_unit=record.accel_unit), made / "gap.csv")  # fmt: skip
    (made / "torn.parquet").write_bytes((bench / "trial.parquet").read_bytes()[:500])
    (made / "README.md").write_text("# Trials\n")
    (made / "sub").mkdir()
    (tmp_path / "keep.toml").write_text('gaps = "keep"\n')
    return made


def rows_of(out: Path) -> dict[str, dict[str, str]]:
    with (out / "summary.csv").open(newline="", encoding="utf-8") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


@pytest.mark.slow
def test_a_second_call_does_what_is_missing_what_changed_and_what_failed(undrift, bench, folder, tmp_path, monkeypatch):
    done = []
    row = batch._Job.row

    def watched(self, folder, file, name, earlier, progress):
        made = row(self, folder, file, name, earlier, progress)
        done.extend([file.name] if made is not earlier else [])
        return made

    monkeypatch.setattr(batch._Job, "row", watched)
    out = tmp_path / "out"
    words = ("orient", folder, "--calibration", bench / "calibration.json", "--map", tmp_path / "keep.toml", "-o", out)

    def second(*more):
        done.clear()
        undrift(*words, *more)
        return list(done)

    assert second() == NAMES
    assert second() == [name for name in NAMES if rows_of(out)[name]["error"]]
    shutil.copy(bench / "trial.parquet", folder / "torn.parquet")  # mended
    assert "torn.parquet" in second()
    assert rows_of(out)["torn.parquet"]["error"] == ""
    (out / "walk.parquet").unlink()
    assert "walk.parquet" in second()
    assert "walk.parquet" not in second()
    assert {"torn.parquet", "walk.parquet"} <= set(second("--method", "vqf"))
    record = read_record(folder / "walk.parquet")
    write_record(record.between(0.0, 0.5 * record.duration_s), folder / "walk.parquet")
    assert "walk.parquet" in second("--method", "vqf")
    calibration = json.loads((bench / "calibration.json").read_text())
    (tmp_path / "other.json").write_text(json.dumps(calibration) + "\n")
    again = (
        "orient",
        folder,
        "--calibration",
        tmp_path / "other.json",
        "--map",
        tmp_path / "keep.toml",
        "--method",
        "vqf",
    )
    done.clear()
    undrift(*again, "-o", out)
    assert "walk.parquet" in done  # other bytes of the calibration


def test_what_an_interrupted_call_did_stands(undrift, bench, folder, tmp_path, monkeypatch):
    row = batch._Job.row

    def stopped(self, folder, file, name, earlier, progress):
        if file.name == "walk.parquet":
            raise KeyboardInterrupt
        return row(self, folder, file, name, earlier, progress)

    words = (
        "correct",
        folder,
        "--calibration",
        bench / "calibration.json",
        "--map",
        tmp_path / "keep.toml",
        "-o",
        tmp_path / "out",
    )
    with monkeypatch.context() as patch:
        patch.setattr(batch._Job, "row", stopped)
        assert undrift(*words).code == 130
    held = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [one["name"] for one in held["rows"]] == NAMES[:2]
    assert undrift(*words, "--json").json()["standing"] == 1


@pytest.mark.slow
def test_folders_in_a_folder_are_looked_into_but_for_those_of_results_and_links_back(undrift, bench, folder, tmp_path):
    for person in ("p1", "p2"):
        (folder / "sub" / person).mkdir()
        shutil.copy(bench / "trial.parquet", folder / "sub" / person / "walk.parquet")
    (folder / "sub" / "back").symlink_to(folder)
    out = folder / "results"
    words = ("orient", folder, "--calibration", bench / "calibration.json", "--map", tmp_path / "keep.toml", "-o")
    assert "folder, 3 of 5 done, 2 with an error" in undrift(*words, out).out
    rows = rows_of(out)
    assert list(rows) == ["gap.csv", "sub/p1/walk.parquet", "sub/p2/walk.parquet", "torn.parquet", "walk.parquet"]
    written = [path.relative_to(out).as_posix() for path in sorted(out.rglob("*.parquet"))]
    assert written == ["sub/p1/walk.parquet", "sub/p2/walk.parquet", "summary.parquet", "walk.parquet"]
    assert "3 of 5 done (3 of them before)" in undrift(*words, out).out
    assert (
        "3 of 5 done, 2 with an error" in undrift(*words, tmp_path / "others").out
    )  # those of `out` are no recordings
    undrift.good("correct", folder / "sub", *words[2:4], "-o", tmp_path / "corrected")
    named = undrift.good("orient", tmp_path / "corrected", "-o", tmp_path / "angles").out
    assert "2 of 2 done, 0 with an error" in named  # of what such a call wrote, where it is named


@pytest.mark.parametrize(
    "content", [None, "{", "[]", '{"kind": "undrift.batch"}'], ids=["none", "torn", "a list", "another"]
)
def test_a_wrong_calibration_is_one_error_and_not_one_of_each_file(undrift, folder, tmp_path, content):
    wrong = tmp_path / "wrong.json"
    if content is not None:
        wrong.write_text(content)
    for command in ("orient", "correct"):
        error = undrift.refused(command, folder, "--calibration", wrong, "-o", tmp_path / "out")
        assert f"{wrong}: " in error
        assert not list((tmp_path / "out").glob("*")) or not (tmp_path / "out").exists()


def test_a_map_that_is_none_is_one_error(undrift, bench, folder, tmp_path):
    words = ("orient", folder, "--calibration", bench / "calibration.json", "-o", tmp_path / "out")
    assert "none.toml" in undrift.refused(*words, "--map", tmp_path / "none.toml")


def test_info_lists_every_entry_and_writes_its_table_where_it_is_asked_to(undrift, folder, tmp_path):
    answer = undrift.good("info", folder, "-o", tmp_path / "out")
    assert "folder, 4 entries: 2 damaged, 1 recording, 1 text" in answer.out  # gaps are refused unless they are stated
    rows = rows_of(tmp_path / "out")
    assert rows.keys() == {"README.md", *NAMES}
    assert rows["torn.parquet"]["verdict"] == "error"
    assert (rows["README.md"]["verdict"], rows["walk.parquet"]["verdict"]) == ("", "good")
    assert rows["README.md"]["gaps"] == ""
    again = undrift.good("info", folder, "-o", tmp_path / "out", "--json").json()
    assert again["standing"] >= 2


def test_what_a_folder_refuses(undrift, bench, folder, tmp_path):
    words = ("correct", folder, "--calibration", bench / "calibration.json")
    assert "expected a folder other than" in undrift.refused(*words, "-o", folder)
    assert "expected a folder other than" in undrift.refused(*words, "-o", tmp_path / "out.csv")
    (tmp_path / "empty").mkdir()
    assert "got an empty folder" in undrift.refused("orient", tmp_path / "empty", "-o", tmp_path / "out")
    (tmp_path / "empty" / "SOURCE.md").write_text("# Trials\n")
    assert "got 1 entries that are none" in undrift.refused("orient", tmp_path / "empty", "-o", tmp_path / "out")
    error = undrift.refused("info", folder, "--write-map", "map.toml")
    assert "--write-map: expected a recording or a session, got the folder" in error
    assert "Omit --output" in undrift.refused("info", folder / "walk.parquet", "-o", tmp_path / "out")


def test_an_error_that_nobody_foresaw_is_a_row_too(undrift, folder, monkeypatch):
    from undrift.commands import info as module

    monkeypatch.setattr(module, "_look", lambda *_: [].pop())
    answer = undrift.good("info", folder, "--json").json()
    rows = {row["name"]: row["error"] for row in answer["files"]}
    assert rows["walk.parquet"] == "IndexError: pop from empty list"
