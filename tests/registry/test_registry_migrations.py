"""Tables: made at first use, migrated from the first revision, equal to the models, never those of a later program or another."""

import threading
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from undrift.errors import RegistryError
from undrift.registry import registry as module
from undrift.registry.registry import HEAD, VERSION_TABLE, Base, NewEntry, Registry, open_registry

NEW = NewEntry(kind="run", serial="B2", document={"a": 1}, made_at=datetime(2026, 3, 1, tzinfo=UTC))
OLD = (
    "INSERT INTO devices (serial, added_at, added_by) VALUES ('A17', '2026-06-01 00:00:00', 'a@b')",
    "INSERT INTO entries (device_id, kind, sha256, document, made_at, added_at, added_by, station, source, note) VALUES "
    "(1, 'session', '44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a', '{}', '2026-06-01 00:00:00', "
    "'2026-06-01 00:00:00', 'a@b', 'c', '', '')",
)


def closed_at(place, revision, *words):
    """Make a registry as an earlier program did."""
    held = Registry(module._url_of(place), station="x", wait_s=10.0)
    with held._engine.connect().execution_options(writes=True) as connection, connection.begin():
        module._upgrade(connection, revision)
        for each in words:
            connection.execute(sa.text(each))
    held.close()


def test_a_database_of_the_first_revision_is_upgraded_keeps_its_entries_and_then_refuses_to_change_them(place):
    closed_at(place, "0001", *OLD)
    with open_registry(place) as held:
        (entry, _), *others = held.entries()
        assert others == []
        assert (entry.device.serial, held.entry(entry.id).document, entry.made_at.year) == ("A17", {}, 2026)
        with held._engine.connect() as connection:
            assert connection.execute(sa.text(f"SELECT version_num FROM {VERSION_TABLE}")).scalars().all() == [HEAD]
        with pytest.raises(RegistryError, match="only grows"), held._explained(), held._engine.begin() as connection:
            connection.execute(sa.text("DELETE FROM entries"))
        assert held.add(NEW)[0].new


def test_models_and_migrations_agree(place):
    with open_registry(place) as held, held._engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "version_table": VERSION_TABLE})
        assert compare_metadata(context, Base.metadata) == []
        checks = sa.inspect(connection).get_check_constraints("entries")
    assert [check["name"] for check in checks] == ["known_kind"]


def test_the_head_is_the_last_of_the_scripts():
    folder = module.Path(module.__file__).parent / "migrations"
    assert ScriptDirectory(str(folder)).get_heads() == [HEAD]


def test_a_database_of_a_later_program_is_refused_and_left_alone(place):
    with open_registry(place) as held, held._engine.begin() as connection:
        connection.execute(sa.text(f"UPDATE {VERSION_TABLE} SET version_num = '0999'"))
    with pytest.raises(
        RegistryError, match=f"wanted a registry of revision {HEAD} or earlier, got 0999 of a later undrift; update"
    ) as told:
        open_registry(place)
    assert told.value.revision == "0999"


def test_a_revision_that_never_was_and_an_empty_file_are_refused(tmp_path):
    path = tmp_path / "registry.sqlite"
    with open_registry(str(path)) as held, held._engine.begin() as connection:
        connection.execute(sa.text(f"UPDATE {VERSION_TABLE} SET version_num = '0000'"))
    with pytest.raises(RegistryError, match="got 0000 which none has; restore a backup"):
        open_registry(str(path))
    path.write_bytes(b"")
    with pytest.raises(RegistryError, match="wanted a registry, got an empty file; restore a backup, or delete it"):
        open_registry(str(path))
    assert path.read_bytes() == b""


def test_a_migration_that_breaks_off_leaves_the_database_as_it_was(place, monkeypatch):
    closed_at(place, "0001", *OLD)

    def broken(connection, revision):
        upgrade(connection, revision)
        raise RegistryError("broken off")

    upgrade = module._upgrade
    monkeypatch.setattr(module, "_upgrade", broken)
    with pytest.raises(RegistryError, match="broken off"):
        open_registry(place)
    monkeypatch.undo()
    with open_registry(place) as held:
        assert len(held.entries()) == 1


def test_many_that_open_a_new_registry_at_once_all_find_it_whole(place):
    problems, start = [], threading.Barrier(6)

    def use(k):
        start.wait()
        try:
            with open_registry(place) as held:
                held.add(
                    NewEntry(kind="run", serial="A17", document={"k": k}, made_at=datetime(2026, 3, 1, tzinfo=UTC))
                )
        except Exception as error:  # noqa: BLE001 whatever it is
            problems.append(error)

    threads = [threading.Thread(target=use, args=(k,)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert problems == []
    with open_registry(place) as held:
        assert len(held.entries()) == 6
