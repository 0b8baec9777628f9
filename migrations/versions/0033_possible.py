"""Covariates that nowhere on Earth has are not known: they were taken in, and the true ones are while none is stored."""

import json

import sqlalchemy as sa
from alembic import op

revision = "0033"
down_revision = "0032"
branch_labels = None
depends_on = None

POSSIBLE = {"temperature_c": (-90.0, 60.0), "rain_mm_h": (0.0, 2300.0)}
"""As `lbacal_core.spectra.spectra` had it then: what was migrated stays."""


def upgrade() -> None:
    """Forget temperatures and rain that are not possible."""
    event = sa.table("event", sa.column("id", sa.BigInteger()), sa.column("env", sa.Text()))
    connection, changes = op.get_bind(), []
    for row in connection.execute(sa.select(event).where(event.c.env.is_not(None))):
        env = json.loads(row.env)
        kept = {name: value for name, value in env.items() if value is None or name not in POSSIBLE or POSSIBLE[name][0] <= value <= POSSIBLE[name][1]}
        if kept != env:
            changes.append({"number": row.id, "kept": json.dumps(kept) if kept else None})
    if changes:
        connection.execute(sa.update(event).where(event.c.id == sa.bindparam("number")).values(env=sa.bindparam("kept")), changes)
