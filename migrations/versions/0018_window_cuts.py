"""Dates at which the watch cuts the windows of antennas."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None

BigNumber = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "window_cut",
        sa.Column("id", BigNumber, nullable=False),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("antenna", sa.Integer(), nullable=False),
        sa.Column(
            "date_us", sa.BigInteger(), nullable=False, comment="when the antenna changed, as the watch found it first"
        ),
        sa.Column("sigma_us", sa.BigInteger(), nullable=False, comment="standard deviation of the date"),
        sa.Column("made_us", sa.BigInteger(), nullable=False),
        sa.Column(
            "lifted_us", sa.BigInteger(), comment="when the watch no longer found the change; null while it stands"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_window_cut"),
    )


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("window_cut")
