"""Registries to write to: a file of SQLite, and a database on a PostgreSQL server that the tests start."""

import pytest


@pytest.fixture(scope="session")
def server():
    pytest.importorskip("pwd", reason="the tests start PostgreSQL on POSIX systems alone")
    from testkit import postgres

    folder = postgres.programs()
    if folder is None:
        pytest.skip("PostgreSQL is not installed: apt-get install postgresql")
    with postgres.running(folder) as made:
        yield made


@pytest.fixture(params=["sqlite", "postgresql"])
def place(request, tmp_path):
    """The path or URL of a registry that does not exist yet."""
    return (
        str(tmp_path / "registry.sqlite") if request.param == "sqlite" else request.getfixturevalue("server").database()
    )
