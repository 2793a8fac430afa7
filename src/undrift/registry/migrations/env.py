"""Run by alembic: migrate over the connection, and in the transaction, of the registry that is being opened."""

from alembic import context

from undrift.registry.registry import VERSION_TABLE, Base

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    version_table=VERSION_TABLE,
    transaction_per_migration=False,
)
context.run_migrations()
