"""Investigations: what the simulation gets wrong in stored spectra, kept as it was reported."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "investigation",
        sa.Column("id", sa.Text(), nullable=False, comment="hash of the inputs"),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("since_us", sa.BigInteger(), nullable=False),
        sa.Column("until_us", sa.BigInteger(), nullable=False),
        sa.Column("inputs", sa.Text(), nullable=False, comment="JSON"),
        sa.Column("verdict", sa.Text(), nullable=False, comment="consistent, explained or unexplained"),
        sa.Column("report", sa.Text(), nullable=False, comment="JSON, as it was made"),
        sa.Column("made_us", sa.BigInteger(), nullable=False),
        sa.Column("made_by", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_investigation"),
    )
    op.create_index("ix_investigation_made_us", "investigation", ["made_us", "id"])


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("investigation")
