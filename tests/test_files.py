"""A file is there whole, or as it was."""

import errno
import os
from pathlib import Path

import pytest

from undrift import files
from undrift.errors import InputError
from undrift.files import write_together, write_whole


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_whole(tmp_path / "a.txt", "früher")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "früher"

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(InputError, match=r"a\.txt: expected free disk space"):
        write_whole(tmp_path / "a.txt", b"later")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "früher"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a folder to write to, got No such file or directory"):
        write_whole(tmp_path / "none" / "a.txt", "x")


def test_files_that_belong_together_appear_together_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "a.h").write_text("old")
    with pytest.raises(InputError, match=r"c\.c: expected a folder to write to"):
        write_together({tmp_path / "a.h": "new", tmp_path / "none" / "c.c": "new"})
    assert (tmp_path / "a.h").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.h"]
    write_together({tmp_path / "a.h": "new", tmp_path / "a.c": b"new"})
    assert [path.read_text() for path in sorted(tmp_path.iterdir())] == ["new", "new"]


@pytest.mark.parametrize("old", [None, "old"])
def test_a_name_that_is_refused_brings_back_those_before_it(tmp_path: Path, old: str | None) -> None:
    if old is not None:
        (tmp_path / "a.h").write_text(old)
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "a.c").mkdir()
    with pytest.raises(InputError, match=r"a\.c: cannot be written: Is a directory"):
        write_together({tmp_path / "a.h": "new", tmp_path / "a.txt": None, tmp_path / "a.c": "new"})
    (tmp_path / "a.c").rmdir()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.txt": "old"} | (
        {"a.h": old} if old else {}
    )


def test_a_full_disk_is_named_where_no_file_can_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.os, "open", full)
    with pytest.raises(InputError, match=r"a\.txt: expected free disk space"):
        write_whole(tmp_path / "a.txt", b"later")


def test_what_a_function_writes_appears_whole_and_a_file_that_shall_not_be_is_deleted(tmp_path: Path) -> None:
    (tmp_path / "a.csv.json").write_text("of another")
    write_together({tmp_path / "a.csv": lambda part: part.write_text("rows"), tmp_path / "a.csv.json": None})
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.csv": "rows"}
