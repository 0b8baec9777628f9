"""Run by Alembic: migrate the database whose engine `service.storage.migration` hands over, in one transaction."""

from __future__ import annotations

from alembic import context
from sqlalchemy import text

from service.schema.tables import SCHEMA

LOCK = 5_240_122
"""Names the lock of PostgreSQL that lets one upgrade at a time go on; on SQLite the transaction itself is that lock."""

with context.config.attributes["engine"].begin() as connection:
    if connection.dialect.name == "postgresql":
        for limit in ("statement_timeout", "lock_timeout", "idle_in_transaction_session_timeout"):
            connection.execute(text(f"SET LOCAL {limit} = 0"))
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
    context.configure(connection=connection, target_metadata=SCHEMA, render_as_batch=True, compare_type=True)
    context.run_migrations()
