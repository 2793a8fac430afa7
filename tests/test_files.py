"""A file is there whole, or as it was."""

import errno
import gzip
import hashlib
import os
from pathlib import Path

import pytest

from undrift import files
from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, read_bytes, sha256_of, write_together, write_whole


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
    with pytest.raises(InputError, match="a folder to"):
        write_whole(tmp_path / "none" / "a.txt", "x")


def test_files_that_belong_together_appear_together(tmp_path: Path) -> None:
    (tmp_path / "a.h").write_text("old")
    with pytest.raises(InputError, match="a folder to"):
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
    with pytest.raises(InputError, match="Is a directory"):
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


def test_written_function_output_appears_whole(tmp_path: Path) -> None:
    (tmp_path / "a.csv.json").write_text("of another")
    write_together({tmp_path / "a.csv": lambda part: part.write_text("rows"), tmp_path / "a.csv.json": None})
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.csv": "rows"}


# ---- files: there or not, packed or not, and their checksum


def test_the_checksum_is_of_the_file_as_stored(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    # FIPS 180-4, example of the one-block message
    assert sha256_of(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    packed = gzip.compress(b"abc")
    (tmp_path / "a.gz").write_bytes(packed)
    assert sha256_of(tmp_path / "a.gz") == hashlib.sha256(packed).hexdigest()


def test_packed_content_is_told_by_its_bytes_not_its_name(tmp_path):
    (tmp_path / "a.csv").write_bytes(gzip.compress(b"x" * 100))
    assert read_bytes(tmp_path / "a.csv") == b"x" * 100
    assert read_bytes(tmp_path / "a.csv", 7) == b"x" * 7
    (tmp_path / "b.gz").write_bytes(b"plain")
    assert read_bytes(tmp_path / "b.gz") == b"plain"


def test_missing_folder_and_empty_are_one_line_each(tmp_path):
    for path, kind, words in (
        (tmp_path / "none", InputError, "no file with"),
        (tmp_path, InputError, "got a directory"),
        (tmp_path / ("x" * 300), InputError, "name too long"),
    ):
        with pytest.raises(kind, match=words):
            checked_file(path)
    (tmp_path / "empty").touch()
    with pytest.raises(FileFormatError, match="an empty file"):
        read_bytes(tmp_path / "empty")


PACKED = gzip.compress(bytes(range(256)) * 40, mtime=0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (PACKED[:-9], "truncated"),
        (PACKED[:-6] + b"\x00" + PACKED[-5:], "is damaged"),  # its checksum
        (PACKED[:20] + bytes(100) + PACKED[120:], "is damaged"),
        (gzip.compress(b"", mtime=0), "an empty file inside the gzip"),
    ],
)
def test_damage_inside_a_gzip_is_told_from_a_cut(tmp_path, content, words):
    (tmp_path / "a.gz").write_bytes(content)
    with pytest.raises(FileFormatError, match=words):
        read_bytes(tmp_path / "a.gz")
