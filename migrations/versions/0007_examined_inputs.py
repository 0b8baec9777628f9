"""Scheduled fits that hardly move C leave a row and no version."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    of_inputs = "SHA-256 of the inputs of a fit that moved C too little to be kept"
    of_shift = "largest change of C in any channel, standard deviations"
    op.create_table(
        "examined",
        sa.Column("scope", sa.Text(), nullable=False),
        sa.Column("since_us", sa.BigInteger(), nullable=False),
        sa.Column("until_us", sa.BigInteger(), nullable=False),
        sa.Column("inputs", sa.Text(), nullable=False, comment=of_inputs),
        sa.Column("calibration", sa.Text(), nullable=False, comment="what it confirms"),
        sa.Column("shift", sa.Float(), nullable=False, comment=of_shift),
        sa.Column("made_us", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["calibration"], ["calibration.id"], name="fk_examined_calibration"),
        sa.PrimaryKeyConstraint("scope", "since_us", "until_us", name="pk_examined"),
    )
    op.create_index("ix_examined_calibration", "examined", ["calibration"])


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("examined")
