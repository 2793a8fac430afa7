"""The registry of one place: a file of SQLite, or a database of PostgreSQL.

A write is one short transaction, begun as a write (BEGIN IMMEDIATE) so that it waits for others at its begin, not at its end. What
``add`` has returned is on the disk. Times are UTC. A calibration is valid from the day it was made until it is due, at the
temperatures that it covers; the newest one counts, and never one with a bad verdict or one that a later entry supersedes.
"""

import getpass
import os
import re
import socket
import sqlite3
import tempfile
import time
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from undrift.errors import RegistryError
from undrift.files import data_folder, first_line
from undrift.io.store import hash_of

try:
    import sqlalchemy as sa
    from sqlalchemy.dialects import postgresql, sqlite
    from sqlalchemy.engine import URL, make_url
    from sqlalchemy.exc import ArgumentError, DBAPIError, SQLAlchemyError
    from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column, relationship, undefer
    from sqlalchemy.types import TypeDecorator
except ModuleNotFoundError as error:
    raise RegistryError(
        f"registry: wanted the package {error.name}, got none; pip install undrift[registry]"
    ) from error

WAIT_S = 30.0  # for another writer
_ADDRESS = "a path, sqlite:///FILE or postgresql://user@host/database"
_AS_THEY_ARE = ("kind", "verdict", "made_at", "due_at", "source", "supersedes", "note")  # of a new entry
# advisory locks of PostgreSQL: one program migrates, or adds several; others wait
_MIGRATING, _MANY = 0x756E6472, 0x756E6473


# ---- tables; ``migrations/versions`` makes them in a database, and a test holds both equal

HEAD = "0002"  # revision of migrations/versions that this program needs
VERSION_TABLE = "undrift_registry_version"
KINDS = ("session", "calibration", "certificate", "run")


class UtcTime(TypeDecorator[datetime]):
    """A time in UTC: SQLite keeps it without a zone, PostgreSQL with one; Python always sees UTC."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        """Return what the database keeps."""
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        """Return what was kept, in UTC."""
        if value is None:
            return None
        return value.astimezone(UTC) if value.tzinfo else value.replace(tzinfo=UTC)


class Base(DeclarativeBase):
    """All tables."""


class Device(Base):
    """A device by its serial number."""

    __tablename__ = "devices"

    id: Mapped[int] = mapped_column(primary_key=True)
    serial: Mapped[str] = mapped_column(sa.String(200), unique=True)
    added_at: Mapped[datetime] = mapped_column(UtcTime)
    added_by: Mapped[str] = mapped_column(sa.String(200))


class Entry(Base):
    """One thing that is known of a device; read only."""

    __tablename__ = "entries"

    id: Mapped[int] = mapped_column(primary_key=True)
    device_id: Mapped[int] = mapped_column(sa.ForeignKey("devices.id"), index=True)
    kind: Mapped[str] = mapped_column(sa.String(20))
    sha256: Mapped[str] = mapped_column(sa.String(64))  # of the document: JSON with sorted keys, without spaces, UTF-8
    document: Mapped[dict[str, Any]] = mapped_column(sa.JSON, deferred=True)
    verdict: Mapped[str | None] = mapped_column(sa.String(20))  # good, marginal or bad; None where nothing was judged
    low_c: Mapped[float | None] = mapped_column(sa.Double)  # valid from this temperature, degC; None: not known
    high_c: Mapped[float | None] = mapped_column(sa.Double)  # to this one
    made_at: Mapped[datetime] = mapped_column(UtcTime)
    due_at: Mapped[datetime | None] = mapped_column(UtcTime)  # calibrate again by then
    added_at: Mapped[datetime] = mapped_column(UtcTime)
    added_by: Mapped[str] = mapped_column(sa.String(200))  # user@host
    station: Mapped[str] = mapped_column(sa.String(200))
    source: Mapped[str] = mapped_column(sa.Text)  # file or folder it came from
    supersedes: Mapped[int | None] = mapped_column(sa.ForeignKey("entries.id"))  # the entry that it corrects
    note: Mapped[str] = mapped_column(sa.Text)

    device: Mapped[Device] = relationship(lazy="joined")

    @property
    def serial(self) -> str:
        """Serial number of the device."""
        return self.device.serial

    @property
    def temp_c(self) -> tuple[float, float] | None:
        """Where it is valid, degC; None where that is not known."""
        return None if self.low_c is None or self.high_c is None else (self.low_c, self.high_c)

    __table_args__ = (
        sa.CheckConstraint("kind IN ('session', 'calibration', 'certificate', 'run')", name="known_kind"),
        sa.Index("one_content", "kind", "sha256", unique=True, sqlite_where=sa.text("supersedes IS NULL"),
                 postgresql_where=sa.text("supersedes IS NULL")),
        sa.Index("one_correction", "supersedes", unique=True),
        {"sqlite_autoincrement": True},
    )  # fmt: skip


# ---- what is added, and the registry


@dataclass(frozen=True, slots=True, kw_only=True)
class NewEntry:
    """What is to be added."""

    kind: str
    serial: str
    document: Mapping[str, Any]
    made_at: datetime
    due_at: datetime | None = None
    temp_c: tuple[float, float] | None = None  # where it is valid, degC
    verdict: str | None = None
    source: str = ""
    supersedes: int | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Added:
    """What became of a new entry."""

    entry: Entry
    new: bool  # False where the same content was there


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """A device, and its newest calibration that counts."""

    serial: str
    entries: int
    calibration: Entry | None


def default_place() -> str:
    """Return UNDRIFT_REGISTRY, else the file in the user's data folder."""
    if stated := os.environ.get("UNDRIFT_REGISTRY"):
        return stated
    return str(data_folder() / "registry.sqlite")


def open_registry(place: str | None = None, *, station: str | None = None, wait_s: float = WAIT_S) -> "Registry":
    """Open the registry at a path or URL; a new one is made, an older one is migrated, a newer one is refused."""
    url = _url_of(place or default_place())
    if url.drivername == "sqlite" and place is None and not os.environ.get("UNDRIFT_REGISTRY"):
        try:
            Path(str(url.database)).parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            raise RegistryError(f"{url.database}: wanted a folder for the registry, got {error.strerror}") from error
    registry = Registry(
        url, station=station or os.environ.get("UNDRIFT_STATION") or socket.gethostname(), wait_s=wait_s
    )
    try:
        registry.migrate()
    except BaseException:
        registry.close()
        raise
    return registry


def _url_of(place: str) -> URL:
    if "://" not in place:
        return URL.create("sqlite", database=place)
    try:
        url = make_url(place)
    except (ArgumentError, ValueError) as error:
        raise RegistryError(f"registry: wanted {_ADDRESS}, got an address that does not read; correct it") from error
    if url.drivername in ("postgresql", "postgres", "postgresql+psycopg"):
        return url.set(drivername="postgresql+psycopg")
    if url.drivername != "sqlite" or not url.database:
        raise RegistryError(f"registry: wanted {_ADDRESS}, got {url.drivername}://; name one of these")
    return url


class Registry:
    """An open registry; a context manager that closes it."""

    def __init__(self, url: URL, *, station: str, wait_s: float) -> None:
        self.place = url.database or "" if url.drivername == "sqlite" else url.render_as_string(hide_password=True)
        self._lite, self._station, self._wait_s = url.drivername == "sqlite", station[:200], wait_s
        with self._explained():
            self._engine = _engine(url, wait_s)

    def __enter__(self) -> "Registry":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close its connections."""
        self._engine.dispose()

    # ---- adding

    def add(self, *new: NewEntry) -> list[Added]:
        """Add all entries or none, in their order; the same content again is the entry that exists."""
        hashed, done = [(one, hash_of(one.document)) for one in new], list[Added]()
        with self._session(writes=True) as session:
            if len(new) > 1 and not self._lite:  # two such programs would wait for each other's entries
                session.execute(sa.select(sa.func.pg_advisory_xact_lock(_MANY)))
            now, who = datetime.now(UTC), _who()
            devices = {name: self._device(session, name, now, who) for name in sorted({one.serial for one in new})}
            for one, digest in hashed:
                rest = {"device_id": devices[one.serial].id, "sha256": digest, "added_at": now, "added_by": who}
                done.append(self._add_one(session, one, rest))
                _ = done[-1].entry.device.serial  # known when the transaction is over
        return done

    def _device(self, session: Session, serial: str, now: datetime, who: str) -> Device:
        asked = sa.select(Device).where(Device.serial == serial)
        if session.scalar(asked) is None:
            session.execute(self._insert(Device), {"serial": serial, "added_at": now, "added_by": who})
        return session.scalars(asked).one()

    def _add_one(self, session: Session, one: NewEntry, rest: dict[str, Any]) -> Added:
        asked = Entry.kind == one.kind, Entry.sha256 == rest["sha256"], Entry.supersedes.is_(None)
        same = sa.select(Entry).where(*asked)
        if one.supersedes is not None:
            self._check_correction(session, one)
        elif held := session.scalar(same.options(undefer(Entry.document))):  # first, so that no number is lost
            return Added(entry=_as_added(held, self.place), new=False)
        low, high = one.temp_c or (None, None)
        values = rest | {name: getattr(one, name) for name in _AS_THEY_ARE}
        values |= {name: values[name].encode("utf-8", "backslashreplace").decode() for name in ("source", "note")}
        values |= {"document": dict(one.document), "low_c": low, "high_c": high, "station": self._station}
        made: Entry | None = session.scalar(self._insert(Entry).returning(Entry), values)
        if made is not None:
            return Added(entry=made, new=True)
        if one.supersedes is not None:  # another program was quicker
            self._check_correction(session, one)
        return Added(entry=session.scalars(same).one(), new=False)

    def _check_correction(self, session: Session, one: NewEntry) -> None:
        old = session.get(Entry, one.supersedes)
        if old is None or old.kind != one.kind:
            got = f"no entry {one.supersedes}" if old is None else f"entry {old.id}, a {old.kind}"
            raise RegistryError(
                f"supersedes: wanted the {one.kind} that it corrects, got {got}; see undrift registry list"
            )
        later = session.scalar(sa.select(Entry.id).where(Entry.supersedes == old.id))
        if later is not None:
            raise RegistryError(
                f"supersedes: wanted an entry that nothing corrects yet, got {old.id}, which {later} supersedes; name {later}"
            )

    def _insert(self, table: type[Device] | type[Entry]) -> Any:
        """Return an INSERT that does nothing where another program has added the same."""
        return (sqlite.insert(table) if self._lite else postgresql.insert(table)).on_conflict_do_nothing()

    # ---- reading

    def devices(self) -> list[Known]:
        """Return every device with its newest calibration that counts, by serial."""
        with self._session() as session:
            counted = session.execute(
                sa.select(Device.serial, sa.func.count(Entry.id))
                .outerjoin(Entry)
                .group_by(Device.serial)
                .order_by(Device.serial)
            ).all()
            newest = {entry.device.serial: entry for entry in session.scalars(_newest())}
        return [Known(serial=serial, entries=count, calibration=newest.get(serial)) for serial, count in counted]

    def entries(self, serial: str | None = None, kind: str | None = None) -> list[tuple[Entry, int | None]]:
        """Return entries in order of addition, each with the one that supersedes it."""
        asked = sa.select(Entry).order_by(Entry.id)
        asked = asked if kind is None else asked.where(Entry.kind == kind)
        with self._session() as session:
            if serial is not None:
                self._check_serial(session, serial)
                asked = asked.join(Entry.device).where(Device.serial == serial)
            later = dict(
                session.execute(sa.select(Entry.supersedes, Entry.id).where(Entry.supersedes.is_not(None))).all()
            )
            return [(entry, later.get(entry.id)) for entry in session.scalars(asked)]

    def entry(self, number: int) -> Entry:
        """Return an entry with its document, whose hash is checked."""
        with self._session() as session:
            held = session.scalar(sa.select(Entry).where(Entry.id == number).options(undefer(Entry.document)))
        if held is None:
            raise RegistryError(
                f"{self.place}: wanted an entry of the registry, got {number}; see undrift registry list"
            )
        return _as_added(held, self.place)

    def calibrations(self, serial: str) -> list[Entry]:
        """Return the calibrations of a device that count, in the order in which they were made."""
        with self._session() as session:
            self._check_serial(session, serial)
            return list(session.scalars(_counting().where(Device.serial == serial)))

    def calibration_with(self, digest: str) -> Entry | None:
        """Return the calibration with a content hash, as a certificate states it."""
        asked = sa.select(Entry).where(Entry.kind == "calibration", Entry.sha256 == digest).order_by(Entry.id.desc())
        with self._session() as session:
            return session.scalars(asked).first()

    def valid(self, serial: str, on: datetime) -> list[Entry]:
        """Return the calibrations of a device that are valid on a date, newest first; there is at least one."""
        held = self.calibrations(serial)
        found = [one for one in held if one.made_at <= on and (one.due_at is None or on < one.due_at)]
        if found:
            return found[::-1]
        day = on.date().isoformat()
        wanted = f"{serial}: wanted a calibration valid on {day}, got"
        if not held:
            raise RegistryError(
                f"{wanted} none that counts; calibrate the device and add it: undrift registry add FILE"
            )
        before = [one for one in held if one.made_at <= on]
        if not before:
            raise RegistryError(
                f"{wanted} a first one of {held[0].made_at.date()}; name another date, or add an earlier one"
            )
        last = before[-1]
        raise RegistryError(
            f"{wanted} entry {last.id}, due on {f'{last.due_at:%Y-%m-%d}' if last.due_at else ''}; calibrate the device again, or "
            "name a file with `calibration`"
        )

    def find(self, serial: str, *, on: datetime | None = None, temp_c: float | None = None) -> Entry:
        """Return the calibration of a device that is valid at a date (now) and a temperature (any), with its document."""
        on = on or datetime.now(UTC)
        held = self.valid(serial, on)
        for one in held:
            if temp_c is None or covers(one, temp_c):
                return self.entry(one.id)
        spans = ", ".join(f"entry {one.id}: {span_text(one)}" for one in held)
        raise RegistryError(
            f"{serial}: wanted a calibration valid at {temp_c:.1f} degC, got {spans}; calibrate at that temperature, or state "
            "where one is valid: add its file to the registry again, with `supersedes` and `valid_temp_c` LOW:HIGH"
        )

    def due(self, before: datetime) -> list[Known]:
        """Return the devices to calibrate before a date, the most urgent first; those never calibrated at the end."""
        known = [
            one for one in self.devices() if one.calibration is None or (one.calibration.due_at or before) < before
        ]
        end = datetime.max.replace(tzinfo=UTC)
        return sorted(known, key=lambda one: (one.calibration.due_at if one.calibration else None) or end)

    def _check_serial(self, session: Session, serial: str) -> None:
        if session.scalar(sa.select(Device.id).where(Device.serial == serial)) is None:
            known = list(session.scalars(sa.select(Device.serial).order_by(Device.serial).limit(6)))
            some = ", ".join(known[:5]) + (", ..." if len(known) > 5 else "")
            raise RegistryError(
                f"{self.place}: wanted a device of the registry, got serial '{serial}'; known: {some or 'none yet, add one first'}"
            )

    # ---- the database

    def migrate(self) -> None:
        """Make the tables, or bring those of an earlier version to this one."""
        if self._lite:
            with self._explained():
                _begin(Path(self.place))
        last = time.monotonic() + self._wait_s
        while True:
            try:
                with self._explained(), self._engine.connect() as connection:
                    found = self._revision(connection)
                if found == HEAD:
                    return
                with (
                    self._explained(),
                    self._engine.connect().execution_options(writes=True) as connection,
                    connection.begin(),
                ):
                    if not self._lite:
                        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_MIGRATING)))
                    if self._revision(connection) != HEAD:  # not done meanwhile
                        _upgrade(connection, HEAD)
                return
            except RegistryError as error:  # SQLite does not wait everywhere while a file begins its life
                if not (error.numbers.get("locked") and self._lite and time.monotonic() < last):
                    raise
                time.sleep(0.05)

    def _revision(self, connection: sa.Connection) -> str | None:
        """Return the revision of the tables, None of an empty database; refuse one that is newer, or another program's."""
        names = sa.inspect(connection).get_table_names()
        if VERSION_TABLE not in names:
            if names:
                some = ", ".join(sorted(names)[:3])
                raise RegistryError(
                    f"{self.place}: wanted an empty database or a registry, got one with other tables ({some}); name another"
                )
            return None
        found: str | None = connection.scalar(sa.text(f"SELECT version_num FROM {VERSION_TABLE}"))
        if found is not None and not "0001" <= found <= HEAD:
            what = "of a later undrift; update undrift" if found > HEAD else "which none has; restore a backup"
            raise RegistryError(
                f"{self.place}: wanted a registry of revision {HEAD} or earlier, got {found[:40]} {what}",
                revision=found,
            )
        return found

    @contextmanager
    def _session(self, *, writes: bool = False) -> Iterator[Session]:
        """Begin a transaction that ends with the block."""
        with (
            self._explained(),
            self._engine.connect().execution_options(writes=writes) as connection,
            connection.begin(),
            Session(connection, expire_on_commit=False) as session,
        ):
            yield session

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Turn what the database says into one line."""
        try:
            yield
        except ModuleNotFoundError as error:
            raise RegistryError(
                f"{self.place}: wanted the package {error.name}, got none; pip install undrift[registry]"
            ) from error
        except (DBAPIError, sqlite3.Error, OSError) as error:  # the last two: of the first words to a file
            raise _refusal(getattr(error, "orig", error), self.place, self._wait_s) from error
        except SQLAlchemyError as error:
            raise RegistryError(f"{self.place}: the registry failed: {first_line(error)}; check its address") from error


def _refusal(error: BaseException | None, place: str, wait_s: float) -> RegistryError:
    """Return what to say of an error of the database."""
    answer = " ".join(str(error).split("CONTEXT:")[0].split()).replace("connection failed: ", "")
    state = getattr(error, "sqlstate", None) or ""
    rows = tomllib.loads(Path(__file__).with_name("refusals.toml").read_text(encoding="utf-8"))["refusal"]
    for row in rows:
        if re.search(row["seen"], f"[{state}] {answer}"):
            shown = row["says"].format(wait=f"{wait_s:g}", answer=answer[:300])
            return RegistryError(f"{place}: {shown}", locked="another program" in shown)
    return RegistryError(f"{place}: wanted the registry to answer, got: {answer[:300]}; check the database")


def covers(entry: Entry, temp_c: float) -> bool:
    """Tell whether a calibration is valid at a temperature; one without known temperatures is not."""
    return entry.temp_c is not None and entry.temp_c[0] <= temp_c <= entry.temp_c[1]


def span_text(entry: Entry) -> str:
    """Return where an entry is valid."""
    return "temperature not known" if entry.temp_c is None else "{:.1f} to {:.1f} degC".format(*entry.temp_c)


def _counting() -> Any:
    """Return the query of the calibrations that count: those not superseded, with a verdict that is not bad."""
    later = sa.select(Entry.supersedes).where(Entry.supersedes.is_not(None))
    return (
        sa.select(Entry)
        .join(Entry.device)
        .where(Entry.kind == "calibration", Entry.id.not_in(later), sa.func.coalesce(Entry.verdict, "") != "bad")
        .order_by(Entry.made_at, Entry.id)
    )


def _newest() -> Any:
    """Return the query of the last calibration that counts, one for each device."""
    last = sa.func.row_number().over(partition_by=Entry.device_id, order_by=(Entry.made_at.desc(), Entry.id.desc()))
    ranked = _counting().with_only_columns(Entry.id, last.label("place")).order_by(None).subquery()
    return sa.select(Entry).join(ranked, Entry.id == ranked.c.id).where(ranked.c.place == 1)


def _as_added(entry: Entry, place: str) -> Entry:
    """Return an entry whose document was checked against its hash."""
    if hash_of(entry.document) != entry.sha256:
        raise RegistryError(f"{place}: wanted entry {entry.id} as it was added, got other content; restore a backup")
    return entry


def _begin(file: Path) -> None:
    """Make the file of a new registry, with a head in it before it has its name; refuse one that lost its head."""
    if file.is_file() and not file.stat().st_size:
        raise RegistryError(
            f"{file}: wanted a registry, got an empty file; restore a backup, or delete it to begin a new one"
        )
    if not file.exists() and file.parent.is_dir():
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=".undrift-") as hidden:
            with closing(sqlite3.connect(Path(hidden, file.name))) as connection:
                connection.execute("PRAGMA journal_mode = WAL")
            with suppress(OSError):  # another program was quicker; or a disk that knows no links
                os.link(Path(hidden, file.name), file)


def _engine(url: URL, wait_s: float) -> sa.Engine:
    milliseconds = round(1000.0 * wait_s)
    if url.drivername != "sqlite":
        options = f"-c lock_timeout={milliseconds}"
        return sa.create_engine(
            url, connect_args={"connect_timeout": max(2, round(wait_s)), "options": options}, pool_size=2
        )
    engine = sa.create_engine(url, connect_args={"timeout": wait_s, "isolation_level": None})

    @sa.event.listens_for(engine, "connect")
    def prepare(connection: sqlite3.Connection, _: object) -> None:
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute("PRAGMA synchronous = FULL")  # what was reported as added survives a power cut
        if connection.execute("PRAGMA journal_mode").fetchone()[0] != "wal":
            connection.execute("PRAGMA journal_mode = WAL")

    @sa.event.listens_for(engine, "begin")
    def begin(connection: sa.Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE" if connection.get_execution_options().get("writes") else "BEGIN")

    return engine


def _upgrade(connection: sa.Connection, revision: str) -> None:
    """Run the migrations in the transaction of a connection."""
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations").replace("%", "%%"))
    config.attributes["connection"] = connection
    command.upgrade(config, revision)


def _who() -> str:
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # a number without a name
        user = str(os.getuid()) if hasattr(os, "getuid") else "unknown"
    return f"{user}@{socket.gethostname()}"[:200]
