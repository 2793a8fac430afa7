"""A PostgreSQL server of the tests' own: on loopback, with its data in a temporary folder, as a user that is not root."""

import contextlib
import ctypes
import os
import pwd
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg


def programs() -> Path | None:
    """Return the folder of initdb and postgres; Debian keeps it off the PATH."""
    found = shutil.which("initdb")
    folders = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name))
    return Path(found).resolve().parent if found else folders[-1] if folders else None


class Server:
    """A server that runs."""

    def __init__(self, port: int, password: str) -> None:
        self.port, self._password, self._count = port, password, 0

    def url(self, database: str = "postgres") -> str:
        return f"postgresql://tester:{self._password}@127.0.0.1:{self.port}/{database}"

    def database(self) -> str:
        """Make a database; return its URL."""
        self._count += 1
        with psycopg.connect(self.url(), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE test_{self._count}")
        return self.url(f"test_{self._count}")


@contextlib.contextmanager
def running(folder: Path) -> Iterator[Server]:
    """Start a server; stop it and delete its data at the end."""
    base, password = Path(tempfile.mkdtemp(prefix="undrift-pg-")), secrets.token_hex(16)
    how: dict[str, Any] = {"cwd": base}
    if os.geteuid() == 0:  # it refuses to run as root
        names = [name for name in ("postgres", "nobody") if _known(name)]
        user = pwd.getpwnam(names[0])
        how |= {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
        os.chown(base, user.pw_uid, user.pw_gid)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    given = base / "password"
    given.write_text(password)
    words = ("-D", base / "data", "-U", "tester", "-A", "scram-sha-256", "--pwfile", given, "-E", "UTF8", "--locale=C")
    subprocess.run([folder / "initdb", *words, "--no-sync"], check=True, capture_output=True, **how)
    settings = {"listen_addresses": "127.0.0.1", "unix_socket_directories": "", "timezone": "Asia/Tokyo"}
    settings["fsync"] = "off"  # no test cuts the power
    flags = [word for name, value in settings.items() for word in ("-c", f"{name}={value}")]
    with (base / "log").open("wb") as log:
        server = subprocess.Popen(
            [folder / "postgres", "-D", base / "data", "-p", str(port), *flags],
            stdout=log,
            stderr=log,
            preexec_fn=_ends_with_parent,  # noqa: PLW1509 nothing else is started at the time
            **how,
        )
    try:
        made = Server(port, password)
        _wait(made, server, base / "log")
        yield made
    finally:
        server.send_signal(signal.SIGQUIT)  # at once: its data are deleted
        try:
            server.wait(20.0)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
        shutil.rmtree(base, ignore_errors=True)


def _ends_with_parent() -> None:
    ctypes.CDLL(None).prctl(1, signal.SIGQUIT)  # PR_SET_PDEATHSIG: it stops where the tests are killed


def _known(name: str) -> bool:
    with contextlib.suppress(KeyError):
        return bool(pwd.getpwnam(name))
    return False


def _wait(made: Server, server: "subprocess.Popen[bytes]", log: Path) -> None:
    last = time.monotonic() + 30.0
    while True:
        try:
            psycopg.connect(made.url(), connect_timeout=2).close()
            return
        except psycopg.OperationalError:
            if server.poll() is not None or time.monotonic() > last:
                raise AssertionError(f"PostgreSQL does not start: {log.read_text()[-2000:]}") from None
            time.sleep(0.05)
