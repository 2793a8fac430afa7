"""A file is there whole, or as it was."""

from pathlib import Path

import pytest

from undrift.errors import InputError
from undrift.files import write_together, write_whole


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_whole(tmp_path / "a.txt", "früher")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "früher"

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(
        InputError, match=r"a\.txt: wanted room for 5 bytes more on the disk, got \d+: a quota is spent; make room"
    ):
        write_whole(tmp_path / "a.txt", b"later")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "früher"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="wanted a folder to write to, got No such file or directory; choose another"):
        write_whole(tmp_path / "none" / "a.txt", "x")


def test_files_that_belong_together_appear_together_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "a.h").write_text("old")
    with pytest.raises(InputError, match=r"c\.c: wanted a folder to write to"):
        write_together({tmp_path / "a.h": "new", tmp_path / "none" / "c.c": "new"})
    assert (tmp_path / "a.h").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.h"]
    write_together({tmp_path / "a.h": "new", tmp_path / "a.c": b"new"})
    assert [path.read_text() for path in sorted(tmp_path.iterdir())] == ["new", "new"]
