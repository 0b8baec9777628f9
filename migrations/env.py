"""Run by Alembic: migrate the database whose engine `service.storage.migration` hands over, in one transaction.

An empty database gets the tables as the code states them, and the newest revision (Alembic's cookbook, "Building an
Up to Date Database from Scratch"): what they look like today is written once, in `service/schema`.
"""

from __future__ import annotations

from alembic import context
from sqlalchemy import text

from service.schema.tables import metadata

LOCK = 5_240_122
"""Names the lock of PostgreSQL that lets one upgrade at a time go on; on SQLite the transaction itself is that lock."""

with context.config.attributes["engine"].begin() as connection:
    if connection.dialect.name == "postgresql":
        for limit in ("statement_timeout", "lock_timeout", "idle_in_transaction_session_timeout"):
            connection.execute(text(f"SET LOCAL {limit} = 0"))
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
    context.configure(connection=connection, target_metadata=metadata, render_as_batch=True, compare_type=True)
    found = context.get_context().get_current_revision()
    if found is not None and connection.dialect.name == "postgresql":
        # whoever writes has read it, and is waited for; who comes later reads the new one, and is refused
        connection.execute(text("LOCK TABLE alembic_version IN ACCESS EXCLUSIVE MODE"))
    if context.config.attributes.get("may_make") and found is None:
        metadata.create_all(connection, checkfirst=False)
        context.get_context().stamp(context.script, "head")
    context.run_migrations()
