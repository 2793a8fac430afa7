"""Entries: added once, corrected by new ones, never changed; which calibration counts; what goes wrong is one line."""

import os
import sqlite3
import subprocess
import sys
import threading
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest
import sqlalchemy as sa

from undrift.errors import RegistryError
from undrift.io.store import hash_of
from undrift.registry import registry as module
from undrift.registry.registry import NewEntry, default_place, open_registry


def day(text):
    return datetime.fromisoformat(text).replace(tzinfo=UTC)


def calibration(made, *, serial="A17", months=12, **more):
    made_at = day(made)
    given = {"verdict": "good", "temp_c": (18.0, 28.0), "due_at": made_at + timedelta(days=30 * months)} | more
    document = given.pop("document", {"made": made, "serial": serial})
    return NewEntry(kind="calibration", serial=serial, document=document, made_at=made_at, **given)


@pytest.fixture
def held(place):
    with open_registry(place, station="bench 1") as made:
        yield made


def test_an_entry_keeps_what_was_stated_who_when_and_a_hash_in_utc(held):
    tokyo = datetime(2026, 3, 1, 8, 30, tzinfo=timezone(timedelta(hours=9)))
    before = datetime.now(UTC)
    (added,) = held.add(
        NewEntry(
            kind="run", serial="A17", document={"b": 1.5e-300, "a": [0.1, None]}, made_at=tokyo, note="n", source="s"
        )
    )
    assert added.new
    entry = held.entry(added.entry.id)
    assert (entry.kind, entry.device.serial, entry.station, entry.note, entry.source) == (
        "run",
        "A17",
        "bench 1",
        "n",
        "s",
    )
    assert entry.made_at == tokyo
    assert entry.made_at.utcoffset() == timedelta(0)
    assert before - timedelta(seconds=1) <= entry.added_at <= datetime.now(UTC)
    assert "@" in entry.added_by
    assert entry.document == {"b": 1.5e-300, "a": [0.1, None]}
    assert entry.sha256 == hash_of({"a": [0.1, None], "b": 1.5e-300})
    assert (entry.low_c, entry.due_at, entry.verdict, entry.supersedes) == (None, None, None, None)


def test_names_of_files_that_are_no_utf_8_are_kept_readable(held):
    name = os.fsdecode(b"caf\xe9.csv")
    document = {"inputs": [{"file": name, "sha256": "0"}]}
    (added,) = held.add(calibration("2026-03-01", document=document, source=f"/data/{name}"))
    assert added.entry.source == r"/data/caf\udce9.csv"
    assert held.entry(added.entry.id).document == document


def test_the_same_content_is_added_once(held):
    first = held.add(calibration("2026-03-01"))[0]
    again = held.add(calibration("2026-03-01", note="another time"))[0]
    assert (first.new, again.new, again.entry.id) == (True, False, first.entry.id)
    both = held.add(calibration("2026-04-01"), calibration("2026-04-01"))
    assert [one.new for one in both] == [True, False]
    assert len(held.entries()) == 2


def test_what_is_added_together_is_added_whole_or_not_at_all(held):
    with pytest.raises(RegistryError, match=r"wanted the calibration that it corrects, got no entry 77"):
        held.add(calibration("2026-03-01"), calibration("2026-03-02", supersedes=77))
    assert held.entries() == []
    assert held.devices() == []


def test_a_correction_is_a_new_entry_and_the_old_one_stays_and_counts_no_more(held):
    old = held.add(calibration("2026-03-01"))[0].entry
    new = held.add(calibration("2026-03-01", temp_c=(10.0, 40.0), supersedes=old.id, note="wider"))[0]
    assert new.new
    assert new.entry.sha256 == old.sha256  # the same content, corrected beside it
    assert [(entry.id, later) for entry, later in held.entries("A17")] == [(old.id, new.entry.id), (new.entry.id, None)]
    assert held.find("A17", on=day("2026-05-01"), temp_c=35.0).id == new.entry.id
    with pytest.raises(
        RegistryError, match=f"wanted an entry that nothing corrects yet, got {old.id}, which {new.entry.id} supersedes"
    ):
        held.add(calibration("2026-03-02", supersedes=old.id))
    with pytest.raises(RegistryError, match="wanted the run that it corrects, got entry"):
        held.add(NewEntry(kind="run", serial="A17", document={}, made_at=day("2026-03-01"), supersedes=old.id))


def test_the_calibration_that_counts_is_the_newest_valid_at_date_and_temperature(held):
    ids = [one.entry.id for one in held.add(
        calibration("2026-01-10"),
        calibration("2026-06-10", temp_c=(30.0, 45.0)),
        calibration("2026-07-10", verdict="bad"),
        calibration("2026-06-01", serial="B2", temp_c=None),
    )]  # fmt: skip
    assert held.find("A17", on=day("2026-05-01")).id == ids[0]
    assert held.find("A17", on=day("2026-08-01")).id == ids[1]  # the bad one never
    assert held.find("A17", on=day("2026-08-01"), temp_c=20.0).id == ids[0]
    assert held.find("A17", on=day("2026-08-01"), temp_c=30.0).id == ids[1]
    assert held.find("B2", on=day("2026-08-01")).id == ids[3]
    with pytest.raises(
        RegistryError,
        match=r"wanted a calibration valid at 29\.0 degC, got entry \d: 30\.0 to 45\.0 degC, entry \d: 18\.0 to",
    ):
        held.find("A17", on=day("2026-08-01"), temp_c=29.0)
    with pytest.raises(RegistryError, match="got entry 4: temperature not known") as told:
        held.find("B2", on=day("2026-08-01"), temp_c=20.0)
    assert "`valid_temp_c`" in str(told.value)
    with pytest.raises(RegistryError, match="valid on 2025-12-31, got a first one of 2026-01-10"):
        held.find("A17", on=day("2025-12-31"))
    with pytest.raises(RegistryError, match=f"valid on 2028-01-01, got entry {ids[1]}, due on 2027-06-05"):
        held.find("A17", on=day("2028-01-01"))
    with pytest.raises(RegistryError, match="got serial 'C3'; known: A17, B2"):
        held.find("C3")
    held.add(NewEntry(kind="run", serial="D4", document={}, made_at=day("2026-03-01")))
    with pytest.raises(RegistryError, match="got none that counts; calibrate the device"):
        held.find("D4")


def test_what_is_due_the_most_urgent_first(held):
    held.add(
        calibration("2026-01-10", serial="late", months=1),
        calibration("2026-02-10", serial="soon", months=2),
        calibration("2026-02-10", serial="far", months=24),
        calibration("2026-02-10", serial="again", months=1),
        calibration("2026-03-01", serial="again", months=24),
        NewEntry(kind="session", serial="never", document={}, made_at=day("2026-01-01")),
    )  # fmt: skip
    found = held.due(day("2026-06-01"))
    assert [one.serial for one in found] == ["late", "soon", "never"]
    assert [one.calibration and one.calibration.device.serial for one in found] == ["late", "soon", None]
    assert {one.serial: one.entries for one in held.devices()} == {
        "again": 2,
        "far": 1,
        "late": 1,
        "never": 1,
        "soon": 1,
    }


@pytest.mark.parametrize(
    "words",
    ["UPDATE entries SET note = 'x'", "DELETE FROM entries", "UPDATE devices SET serial = 'x'", "DELETE FROM devices"],
)
def test_the_database_itself_refuses_to_change_or_delete(held, words):
    held.add(calibration("2026-03-01"))
    with (
        pytest.raises(RegistryError, match="the registry only grows: wanted a new entry that supersedes this one"),
        held._explained(),
        held._engine.begin() as connection,
    ):
        connection.execute(sa.text(words))
    assert held.find("A17", on=day("2026-05-01")).note == ""


def test_replacing_and_truncating_are_refused_too(held):
    held.add(calibration("2026-03-01"))
    lite = held._engine.dialect.name == "sqlite"
    words = "INSERT OR REPLACE INTO devices VALUES (1, 'x', '2026-01-01', 'y')" if lite else "TRUNCATE entries"
    with pytest.raises(RegistryError, match="only grows"), held._explained(), held._engine.begin() as connection:
        connection.execute(sa.text(words))
    assert held.devices()[0].serial == "A17"


def test_other_content_than_was_added_is_noticed(held):
    number = held.add(calibration("2026-03-01"))[0].entry.id
    lite = held._engine.dialect.name == "sqlite"
    off = ["DROP TRIGGER entries_no_update"] if lite else ["DROP TRIGGER entries_only_grows_row ON entries"]
    with held._engine.begin() as connection:  # as one who wants to could
        for words in (*off, "UPDATE entries SET document = '{\"made\": 1}'"):
            connection.execute(sa.text(words))
    with pytest.raises(
        RegistryError, match=f"wanted entry {number} as it was added, got other content; restore a backup"
    ):
        held.entry(number)
    with pytest.raises(RegistryError, match=f"wanted entry {number} as it was added, got other content"):
        held.add(calibration("2026-03-01"))
    with pytest.raises(RegistryError, match="wanted an entry of the registry, got 99"):
        held.entry(99)


def test_a_registry_that_another_program_holds_is_waited_for_and_then_refused(place):
    with open_registry(place) as first, open_registry(place, wait_s=0.3) as second:
        first.add(calibration("2026-03-01"))
        with first._session(writes=True) as session:
            session.execute(sa.text("SELECT 1"))
            if first._engine.dialect.name != "sqlite":
                session.execute(sa.text("LOCK TABLE entries"))
            with pytest.raises(
                RegistryError, match=r"wanted to write within 0\.3 s, got a registry that another program holds"
            ):
                second.add(calibration("2026-04-01"))
        assert second.add(calibration("2026-04-01"))[0].new  # afterwards


def test_two_that_add_the_same_at_once_get_one_entry(place):
    with open_registry(place) as held:
        found, start = [], threading.Barrier(4)

        def add():
            start.wait()
            found.append(held.add(calibration("2026-03-01"))[0])

        threads = [threading.Thread(target=add) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(one.new for one in found) == [False, False, False, True]
        assert len({one.entry.id for one in found}) == len(held.entries()) == 1


def test_sqlite_is_set_up_for_several_writers(tmp_path):
    with open_registry(str(tmp_path / "r.sqlite"), wait_s=7.0) as held, held._engine.connect() as connection:
        told = {
            name: connection.execute(sa.text(f"PRAGMA {name}")).scalar()
            for name in ("journal_mode", "foreign_keys", "synchronous", "busy_timeout")
        }
    assert told == {"journal_mode": "wal", "foreign_keys": 1, "synchronous": 2, "busy_timeout": 7000}


def test_a_full_disk_is_one_line_and_nothing_is_added(tmp_path):
    with open_registry(str(tmp_path / "r.sqlite")) as held:
        held.add(calibration("2026-03-01"))
        with held._engine.connect() as connection:  # the pool gives the same connection again
            pages = connection.execute(sa.text("PRAGMA page_count")).scalar()
            connection.execute(sa.text(f"PRAGMA max_page_count = {pages}"))
        with pytest.raises(RegistryError, match="wanted room for an entry, got a full disk; make room"):
            held.add(calibration("2026-04-01", document={"large": "x" * 10**6}))
        assert len(held.entries()) == 1


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "mysql://a@b/c",
            "wanted a path, sqlite:///FILE or postgresql://user@host/database, got mysql://; name one of these",
        ),
        ("postgresql://a@b:port/c", "got an address that does not read; correct it"),
        ("sqlite://", "got sqlite://; name one of these"),
        ("{here}/nowhere/r.sqlite", "wanted a file in a folder that exists, got none; make the folder first"),
        (
            "{here}/text",
            "wanted a registry, got a file that is no sound SQLite database; name another, or restore a backup",
        ),
        (
            "{here}/other.sqlite",
            r"wanted an empty database or a registry, got one with other tables \(songs\); name another",
        ),
        (
            "postgresql://lab:secret@127.0.0.1:1/lab",
            "wanted a connection to the server, got none: .*refused.*; check host and port",
        ),
        (
            "postgres://lab:secret@127.0.0.1:1/lab",
            r"^postgresql\+psycopg://lab:\*\*\*@127.0.0.1:1/lab: wanted a connection",
        ),
    ],
)
def test_an_address_that_leads_nowhere_is_one_line_without_the_password(tmp_path, name, text):
    (tmp_path / "text").write_text("no database, but long enough to have a head of its own " * 20)
    with sqlite3.connect(tmp_path / "other.sqlite") as file:
        file.execute("CREATE TABLE songs (id INTEGER)")
    with pytest.raises(RegistryError, match=text) as told:
        open_registry(name.format(here=tmp_path), wait_s=2.0)
    assert "\n" not in str(told.value)
    assert "secret" not in str(told.value)


def test_a_server_that_refuses_is_one_line(server):
    wrong = server.url().replace("tester:", "nobody:")
    with pytest.raises(
        RegistryError, match=r"wanted a user that may log in, got a refusal: .*nobody.*; check user and password"
    ):
        open_registry(wrong)
    with pytest.raises(RegistryError, match="wanted a database, got none of that name; create it on the server first"):
        open_registry(server.url("nowhere"))


@pytest.mark.skipif(os.name == "nt", reason="rights of POSIX")
def test_a_registry_that_may_only_be_read_is_one_line(tmp_path):
    path = tmp_path / "r.sqlite"
    with open_registry(str(path)) as held:
        held.add(calibration("2026-03-01"))
    with pytest.raises(RegistryError, match="wanted to write, got a registry that may only be read; check its rights"):
        open_registry(f"sqlite:///file:{path}?mode=ro&uri=true").add(calibration("2026-04-01"))


def test_without_its_packages_the_registry_names_the_extra():
    code = (
        "import sys; sys.modules['sqlalchemy'] = None\n"
        "from undrift.cli.app import run\n"
        "sys.exit(run(['registry', 'list']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "undrift: registry: wanted the package sqlalchemy, got none; pip install undrift[registry]\n"


def test_without_psycopg_postgresql_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(RegistryError, match=r"wanted the package psycopg, got none; pip install undrift\[registry\]"):
        open_registry("postgresql://lab@127.0.0.1:1/lab")


def test_by_default_the_file_of_this_user(monkeypatch, tmp_path):
    monkeypatch.delenv("UNDRIFT_REGISTRY", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    with open_registry() as held:
        assert Path(held.place) == tmp_path / "data" / "undrift" / "registry.sqlite"
        assert Path(held.place).is_file()
    monkeypatch.delenv("XDG_DATA_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert default_place() == str(tmp_path / "home" / ".local" / "share" / "undrift" / "registry.sqlite")
    monkeypatch.setenv("UNDRIFT_REGISTRY", str(tmp_path / "mine.sqlite"))
    with open_registry() as held:
        assert held.place == str(tmp_path / "mine.sqlite")


def test_a_user_without_a_name_is_a_number(monkeypatch):
    def unknown():
        raise KeyError("uid")

    monkeypatch.setattr(module.getpass, "getuser", unknown)
    assert module._who().partition("@")[0] == str(os.getuid())
