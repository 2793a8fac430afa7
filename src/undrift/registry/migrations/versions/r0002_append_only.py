"""The database refuses to change or delete what it holds."""

from alembic import op

revision, down_revision = "0002", "0001"
REFUSAL = "the registry only grows: wanted a new entry that supersedes this one"


def upgrade() -> None:
    """Make the triggers; a later revision that must change rows drops them first and makes them again."""
    lite = op.get_bind().dialect.name == "sqlite"
    if not lite:
        op.execute(
            "CREATE FUNCTION undrift_only_grows() RETURNS trigger LANGUAGE plpgsql AS "
            f"$$ BEGIN RAISE EXCEPTION '{REFUSAL}'; END $$"
        )
    for table in ("devices", "entries"):
        if not lite:
            for name, what, each in (("row", "UPDATE OR DELETE", "ROW"), ("all", "TRUNCATE", "STATEMENT")):
                op.execute(
                    f"CREATE TRIGGER {table}_only_grows_{name} BEFORE {what} ON {table} "
                    f"FOR EACH {each} EXECUTE FUNCTION undrift_only_grows()"
                )
            continue
        for what in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER {table}_no_{what.lower()} BEFORE {what} ON {table} "
                f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
            )
        op.execute(  # INSERT OR REPLACE deletes without the trigger above
            f"CREATE TRIGGER {table}_no_replace BEFORE INSERT ON {table} "
            f"WHEN EXISTS (SELECT 1 FROM {table} WHERE id = NEW.id) BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
        )
