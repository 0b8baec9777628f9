"""Tags: names for an instant of the ledger."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "tag",
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("as_of_us", sa.BigInteger(), nullable=False, comment="the instant at which the ledger is frozen"),
        sa.Column("by", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("at_us", sa.BigInteger(), nullable=False, comment="when it was made"),
        sa.PrimaryKeyConstraint("name", name="pk_tag"),
    )
    op.create_index("ix_tag_as_of_us", "tag", ["as_of_us"])


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("tag")
