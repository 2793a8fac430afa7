"""undrift sample: the recordings of the package come whole, and run through the commands."""

import pytest

from testkit.command_line import contents


def test_sample_writes_all_recordings(undrift, tmp_path):
    answer = undrift.good("sample", tmp_path / "first", "--json").json()
    assert answer["written"] == [str(tmp_path / "first")]
    written = {path.name for path in (tmp_path / "first").iterdir()}
    assert {"bench", "thermal", "rest.parquet", "sit_to_stand.parquet", "sit_to_stand_optics.parquet"} <= written
    assert sum(path.stat().st_size for path in (tmp_path / "first").rglob("*")) < 1_000_000


@pytest.mark.parametrize(
    ("folder", "text"),
    [
        ("here", "the folder exists already"),
        ("nowhere/here", "the folder nowhere does not exist"),
    ],
)
def test_sample_refuses_a_folder_that_it_cannot_make(undrift, tmp_path, monkeypatch, folder, text):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path)
    assert text in undrift.refused("sample", folder)
    assert contents(tmp_path) == {"here": None}
