"""Run by Alembic: migrate the database whose engine `service.storage.migration` hands over."""

from __future__ import annotations

from alembic import context

from service.schema.tables import metadata

with context.config.attributes["engine"].connect() as connection:
    context.configure(connection=connection, target_metadata=metadata, render_as_batch=True, compare_type=True)
    with context.begin_transaction():
        context.run_migrations()
    if connection.in_transaction():
        connection.commit()
