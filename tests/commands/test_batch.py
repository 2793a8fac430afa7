"""Many recordings in place of one: the command on each, one table, and a second call that does what is missing."""

import csv
import json
import shutil
from pathlib import Path

import pytest

from undrift.commands import batch
from undrift.io.formats import read_record, write_record


@pytest.fixture
def folder(bench, tmp_path):
    """A recording of the bench's device, one in a subfolder, a damaged one, and a file that is none."""
    made = tmp_path / "in"
    (made / "sub").mkdir(parents=True)
    shutil.copy(bench / "trial.parquet", made / "walk.parquet")
    shutil.copy(bench / "trial.parquet", made / "sub" / "walk.parquet")
    (made / "torn.parquet").write_bytes((bench / "trial.parquet").read_bytes()[:500])
    (made / "README.md").write_text("# Trials\n")
    return made


@pytest.fixture
def words(bench, folder, tmp_path):
    shutil.copy(bench / "calibration.json", tmp_path)
    return "orient", folder, "--calibration", tmp_path / "calibration.json", "-o", tmp_path / "out"


def rows_of(out: Path) -> dict[str, dict[str, str]]:
    with (out / "summary.csv").open(newline="", encoding="utf-8") as file:
        return {row["recording"]: row for row in csv.DictReader(file)}


def test_each_recording_has_its_file_and_its_row(undrift, folder, words, tmp_path):
    (folder / "sub" / "back").symlink_to(folder)
    answer = undrift(*words, "--json")
    told, out = answer.json(), tmp_path / "out"
    assert answer.code == 1
    assert told["answer"] == "2 of 3 recordings are done, and 1 failed."
    assert told["findings"][0]["code"] == "folder.recording"
    assert told["notes"] == ["These files are not recordings: README.md."]
    rows = rows_of(out)
    assert list(rows) == ["sub/walk.parquet", "torn.parquet", "walk.parquet"]
    assert [row["verdict"] for row in told["tables"]["recordings"]] == [row["verdict"] for row in rows.values()]
    assert rows["torn.parquet"]["verdict"] == "error"
    assert "deg" in rows["walk.parquet"]["result"]
    assert [path.relative_to(out).as_posix() for path in sorted(out.rglob("*.parquet"))] == [
        "sub/walk.parquet",
        "walk.parquet",
    ]


def test_a_second_call_does_what_is_missing_what_changed_and_what_failed(undrift, folder, words, tmp_path, monkeypatch):
    done, make = list[str](), batch._row

    def watched(job, **options):
        done.append(job.name)
        return make(job, **options)

    monkeypatch.setattr(batch, "_row", watched)

    def call(*more):
        done.clear()
        undrift(*words, *more)
        return list(done)

    assert call() == ["sub/walk.parquet", "torn.parquet", "walk.parquet"]
    assert call() == ["torn.parquet"]
    (tmp_path / "out" / "walk.parquet").unlink()
    assert call() == ["torn.parquet", "walk.parquet"]
    record = read_record(folder / "walk.parquet")
    write_record(record.between(0.0, 0.5 * record.duration_s), folder / "walk.parquet")
    assert call() == ["torn.parquet", "walk.parquet"]
    assert call("--offset", "rest") == ["sub/walk.parquet", "torn.parquet", "walk.parquet"]
    words[3].write_text(json.dumps(json.loads(words[3].read_text())) + "\n")
    assert "walk.parquet" in call("--offset", "rest")


def test_the_rows_of_an_interrupted_call_stay(undrift, folder, words, tmp_path, monkeypatch):
    make = batch._row

    def stopped(job, **options):
        if job.name == "walk.parquet":
            raise KeyboardInterrupt
        return make(job, **options)

    with monkeypatch.context() as patch:
        patch.setattr(batch, "_row", stopped)
        assert undrift(*words).code == 130
    assert list(rows_of(tmp_path / "out")) == ["sub/walk.parquet", "torn.parquet"]
    assert undrift(*words, "--json").json()["data"]["before"] == 1


def test_results_inside_the_folder_are_not_read_as_recordings(undrift, folder, words):
    (folder / "torn.parquet").unlink()
    words = words[:-1]
    assert "2 of 2 recordings are done" in undrift.good(*words, folder / "results").out
    assert "(2 of them before)" in undrift.good(*words, folder / "results").out
    assert "2 of 2 recordings are done" in undrift.good(*words, folder / "others").out


@pytest.mark.parametrize("content", [None, "{", '{"kind": "other"}'], ids=["none", "torn", "another"])
def test_a_wrong_calibration_is_one_error_and_not_one_of_each_file(undrift, folder, tmp_path, content):
    wrong = tmp_path / "wrong.json"
    if content is not None:
        wrong.write_text(content)
    assert f"{wrong}: " in undrift.refused("orient", folder, "--calibration", wrong, "-o", tmp_path / "out")
    assert not any(path.is_file() for path in (tmp_path / "out").rglob("*"))


def test_what_a_folder_refuses(undrift, folder, words, tmp_path):
    words = words[2:-1]
    assert "none.toml" in undrift.refused("orient", folder, *words, tmp_path / "out", "--map", tmp_path / "none.toml")
    assert "expected a folder other than" in undrift.refused("orient", folder, *words, folder)
    assert "expected a folder other than" in undrift.refused("orient", folder, *words, tmp_path / "out.csv")
    twice = undrift.refused("orient", folder / "walk.parquet", folder / "sub" / "walk.parquet", *words, tmp_path / "o")
    assert "two recordings have the name walk.parquet" in twice
    (tmp_path / "empty").mkdir()
    assert "got an empty folder" in undrift.refused("orient", tmp_path / "empty", "-o", tmp_path / "out")
    (tmp_path / "empty" / "SOURCE.md").write_text("# Trials\n")
    assert "got 1 other files" in undrift.refused("orient", tmp_path / "empty", "-o", tmp_path / "out")
