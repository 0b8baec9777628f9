"""Receipts of bodies whose spectra are all stored."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "receipt",
        sa.Column("sha256", sa.Text(), nullable=False, comment="of a body whose spectra are all stored"),
        sa.Column("spectra", sa.Integer(), nullable=False, comment="how many it holds"),
        sa.Column("at_us", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("sha256", name="pk_receipt"),
    )


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("receipt")
