"""Budgets of systematic errors, stored once under their hash."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "budget",
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("content", sa.Text(), nullable=False, comment="canonical JSON of the terms that curves share"),
        sa.PrimaryKeyConstraint("sha256", name="pk_budget"),
    )


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("budget")
