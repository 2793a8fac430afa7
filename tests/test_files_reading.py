"""Files: there or not, packed or not, and their checksum."""

import gzip
import hashlib

import pytest

from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, read_bytes, sha256_of


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
        (tmp_path / "none", InputError, "no file of that name"),
        (tmp_path, InputError, "expected a file, got a directory. Name the file in it"),
        (tmp_path / ("x" * 300), InputError, "cannot be read: File name too long"),
    ):
        with pytest.raises(kind, match=words):
            checked_file(path)
    (tmp_path / "empty").touch()
    with pytest.raises(FileFormatError, match="got an empty file"):
        read_bytes(tmp_path / "empty")


def test_damage_inside_a_gzip_is_told_from_a_cut(tmp_path):
    packed = bytearray(gzip.compress(bytes(range(256)) * 40))
    (tmp_path / "cut.gz").write_bytes(packed[:-9])
    with pytest.raises(FileFormatError, match="truncated"):
        read_bytes(tmp_path / "cut.gz")
    packed[-6] ^= 0xFF
    (tmp_path / "bad.gz").write_bytes(packed)
    with pytest.raises(FileFormatError, match="gzip file is damaged"):
        read_bytes(tmp_path / "bad.gz")
