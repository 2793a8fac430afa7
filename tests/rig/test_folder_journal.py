"""The journal: whole lines are read, a torn last one is known for what it is, a damaged one in the middle is refused."""

import contextlib
import errno
import os

import pytest

from undrift.errors import FileFormatError
from undrift.rig.folder import Head, Journal, line_of, read_journal, session_text

ENTRIES = ({"a": 1, "text": "née +x"}, {"b": [1.5, None]}, {"c": "last"})


def written(path):
    journal = Journal(path)
    for entry in ENTRIES:
        journal.append(entry)
    journal.close()
    return path


def test_what_is_appended_is_read_again_also_by_the_next_program(tmp_path):
    path = written(tmp_path / "j")
    assert read_journal(path)[:2] == (ENTRIES, path.stat().st_size)
    journal = Journal(path)
    assert journal.entries == ENTRIES
    journal.append({"d": 4})
    journal.close()
    journal.close()
    assert read_journal(path)[0] == (*ENTRIES, {"d": 4})
    assert read_journal(tmp_path / "none")[:2] == ((), 0)


def test_a_line_torn_at_any_byte_costs_that_line_only(tmp_path):
    whole = written(tmp_path / "j").read_bytes()
    start = len(whole) - len(line_of(ENTRIES[2], 0)[0])
    for length in range(start, len(whole)):
        torn = tmp_path / "torn"
        torn.write_bytes(whole[:length])
        assert read_journal(torn)[:2] == (ENTRIES[:2], start)
    journal = Journal(torn)
    journal.append({"after": True})
    journal.close()
    assert read_journal(torn)[0] == (*ENTRIES[:2], {"after": True})


@pytest.mark.parametrize("garbage", [b"\0" * 40, b'{"length":3}\n', b"\xff\xfe\n", b"[]\n"])
def test_what_a_power_cut_leaves_behind_the_last_line_is_cut_away(tmp_path, garbage):
    path = written(tmp_path / "j")
    path.write_bytes(path.read_bytes() + garbage)
    assert read_journal(path)[0] == ENTRIES


def test_a_flipped_bit_in_the_last_line_is_refused_unless_it_looks_torn(tmp_path):
    path = written(tmp_path / "j")
    whole = path.read_bytes()
    start = len(whole) - len(line_of(ENTRIES[2], 0)[0])
    taken = []
    for bit in range(8 * start, 8 * len(whole)):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        with contextlib.suppress(FileFormatError):
            assert read_journal(path)[0] == ENTRIES[:2]  # never another entry
            taken.append(bit // 8 - start)
    head = whole[start:].index(b'"entry":') + len(b'"entry":')
    assert all(
        place < head or place >= len(whole) - start - 2 for place in taken
    )  # the entry itself is never taken as torn


def test_a_changed_byte_in_the_middle_is_refused_with_its_line(tmp_path):
    path = written(tmp_path / "j")
    data = bytearray(path.read_bytes())
    place = data.index(b"1.5")
    data[place] = ord("2")
    path.write_bytes(bytes(data))
    with pytest.raises(FileFormatError, match=r"line 2: .*was changed"):
        Journal(path)


@pytest.mark.parametrize("order", [(0, 0, 1, 2), (0, 2, 1), (0, 2), (1, 2), (0, 1, 2, 2)])
def test_a_line_that_is_twice_missing_or_elsewhere_is_refused(tmp_path, order):
    path = written(tmp_path / "j")
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[i] for i in order))
    with pytest.raises(FileFormatError, match="was changed"):
        Journal(path)


def test_half_a_line_on_a_full_disk_is_taken_back(tmp_path, monkeypatch):
    path = written(tmp_path / "j")
    journal = Journal(path)

    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            journal.append({"lost": True})
    assert read_journal(path)[:2] == (ENTRIES, path.stat().st_size)
    journal.append({"kept": True})
    journal.close()
    assert read_journal(path)[0] == (*ENTRIES, {"kept": True})


@pytest.mark.parametrize(("gravity_m_s2", "written_down"), [(None, False), (9.81, True)])
def test_the_session_of_a_run_states_no_gravity_that_nobody_stated(gravity_m_s2, written_down):
    text = session_text(Head(protocol="p", rig="r", gravity_m_s2=gravity_m_s2), ())
    assert ("gravity_m_s2 = 9.81" in text) is written_down
    assert ("gravity" in text) is written_down
