"""What the drift of a station's year was measured from, so that later events alone are read."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "drift_source",
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("since_us", sa.BigInteger(), nullable=False, comment="the first instant of the year"),
        sa.Column(
            "inputs",
            sa.Text(),
            nullable=False,
            comment="hash of all that its events were measured with but the spectra",
        ),
        sa.Column("spectra", sa.Integer(), nullable=False, comment="count of usable spectra"),
        sa.Column("flag", sa.BigInteger(), nullable=False, comment="the last flag that was set in the year"),
        sa.Column("event", sa.BigInteger(), nullable=False, comment="the newest event"),
        sa.Column(
            "screened",
            sa.Integer(),
            nullable=False,
            comment="count of usable spectra when the whole year was read last",
        ),
        sa.PrimaryKeyConstraint("station", "since_us", name="pk_drift_source"),
    )


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("drift_source")
