"""What people decide about the dates at which windows are cut."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None

BigNumber = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "cut_decision",
        sa.Column("id", BigNumber, nullable=False),
        sa.Column("cut", BigNumber, nullable=False),
        sa.Column("act", sa.Text(), nullable=False, comment="lifted or restored"),
        sa.Column("at_us", sa.BigInteger(), nullable=False),
        sa.Column("by", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["cut"], ["window_cut.id"], name="fk_cut_decision_cut_window_cut"),
        sa.PrimaryKeyConstraint("id", name="pk_cut_decision"),
    )
    op.create_index("ix_cut_decision_cut", "cut_decision", ["cut"])


def downgrade() -> None:
    """To the revision before."""
    op.drop_index("ix_cut_decision_cut", "cut_decision")
    op.drop_table("cut_decision")
