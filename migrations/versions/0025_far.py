"""Spectra whose level is far from that of their path wait until a night has judged them; receipts keep what was said."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Nothing that is stored waits."""
    op.add_column("spectrum", sa.Column("far", sa.Float(), comment="times the path's power at that time; left out of fits until it is known to last"))
    op.create_index("ix_spectrum_far", "spectrum", ["path"], sqlite_where=sa.text("far IS NOT NULL"), postgresql_where=sa.text("far IS NOT NULL"))
    op.add_column("receipt", sa.Column("warnings", sa.Text(), comment="what was said of it, JSON"))
