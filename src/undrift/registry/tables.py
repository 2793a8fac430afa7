"""The tables of the registry; ``migrations/versions`` makes them in a database, and a test holds both equal."""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import JSON, CheckConstraint, DateTime, Dialect, Double, ForeignKey, Index, String, Text, text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship
from sqlalchemy.types import TypeDecorator

HEAD = "0002"  # revision of migrations/versions that this program needs
VERSION_TABLE = "undrift_registry_version"
KINDS = ("session", "calibration", "certificate", "run")


class UtcTime(TypeDecorator[datetime]):
    """A time in UTC: SQLite keeps it without a zone, PostgreSQL with one; Python always sees UTC."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Return what the database keeps."""
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
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
    serial: Mapped[str] = mapped_column(String(200), unique=True)
    added_at: Mapped[datetime] = mapped_column(UtcTime)
    added_by: Mapped[str] = mapped_column(String(200))


class Entry(Base):
    """One thing that is known of a device; read only."""

    __tablename__ = "entries"

    id: Mapped[int] = mapped_column(primary_key=True)
    device_id: Mapped[int] = mapped_column(ForeignKey("devices.id"), index=True)
    kind: Mapped[str] = mapped_column(String(20))
    sha256: Mapped[str] = mapped_column(String(64))  # of the document: JSON with sorted keys, without spaces, UTF-8
    document: Mapped[dict[str, Any]] = mapped_column(JSON, deferred=True)
    verdict: Mapped[str | None] = mapped_column(String(20))  # good, marginal or bad; None where nothing was judged
    low_c: Mapped[float | None] = mapped_column(Double)  # valid from this temperature, degC; None where it is not known
    high_c: Mapped[float | None] = mapped_column(Double)  # to this one
    made_at: Mapped[datetime] = mapped_column(UtcTime)
    due_at: Mapped[datetime | None] = mapped_column(UtcTime)  # calibrate again by then
    added_at: Mapped[datetime] = mapped_column(UtcTime)
    added_by: Mapped[str] = mapped_column(String(200))  # user@host
    station: Mapped[str] = mapped_column(String(200))
    source: Mapped[str] = mapped_column(Text)  # file or folder it came from
    supersedes: Mapped[int | None] = mapped_column(ForeignKey("entries.id"))  # the entry that it corrects
    note: Mapped[str] = mapped_column(Text)

    device: Mapped[Device] = relationship(lazy="joined")

    __table_args__ = (
        CheckConstraint("kind IN ('session', 'calibration', 'certificate', 'run')", name="known_kind"),
        Index("one_content", "kind", "sha256", unique=True, sqlite_where=text("supersedes IS NULL"),
              postgresql_where=text("supersedes IS NULL")),
        Index("one_correction", "supersedes", unique=True),
        {"sqlite_autoincrement": True},
    )  # fmt: skip
