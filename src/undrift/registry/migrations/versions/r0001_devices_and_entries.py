"""Devices and entries."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0001", None
TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Make both tables."""
    op.create_table(
        "devices",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("serial", sa.String(200), nullable=False, unique=True),
        sa.Column("added_at", TIME, nullable=False),
        sa.Column("added_by", sa.String(200), nullable=False),
    )
    op.create_table(
        "entries",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("device_id", sa.Integer, sa.ForeignKey("devices.id"), nullable=False, index=True),
        sa.Column("kind", sa.String(20), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("document", sa.JSON, nullable=False),
        sa.Column("verdict", sa.String(20)),
        sa.Column("low_c", sa.Double),
        sa.Column("high_c", sa.Double),
        sa.Column("made_at", TIME, nullable=False),
        sa.Column("due_at", TIME),
        sa.Column("added_at", TIME, nullable=False),
        sa.Column("added_by", sa.String(200), nullable=False),
        sa.Column("station", sa.String(200), nullable=False),
        sa.Column("source", sa.Text, nullable=False),
        sa.Column("supersedes", sa.Integer, sa.ForeignKey("entries.id")),
        sa.Column("note", sa.Text, nullable=False),
        sa.CheckConstraint("kind IN ('session', 'calibration', 'certificate', 'run')", name="known_kind"),
        sqlite_autoincrement=True,
    )
    first = sa.text("supersedes IS NULL")
    op.create_index(
        "one_content", "entries", ["kind", "sha256"], unique=True, sqlite_where=first, postgresql_where=first
    )
    op.create_index("one_correction", "entries", ["supersedes"], unique=True)
