"""What is kept of a fit so that later events can continue it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

BigNumber = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "kept_fit",
        sa.Column("kind", sa.Text(), nullable=False, comment="scope of its versions: array, station or antenna"),
        sa.Column("scope", sa.Text(), nullable=False, comment="whose spectra it was made from"),
        sa.Column("since_us", sa.BigInteger(), nullable=False),
        sa.Column("until_us", sa.BigInteger(), nullable=False),
        sa.Column("inputs", sa.Text(), nullable=False, comment="hash of all inputs but the spectra"),
        sa.Column("spectra", sa.Integer(), nullable=False, comment="how many usable ones it was made from"),
        sa.Column("flag", BigNumber, nullable=False, comment="the last flag set in the window"),
        sa.Column("event", BigNumber, nullable=False, comment="the newest event"),
        sa.Column("told", sa.Text(), nullable=False, comment="JSON: the pieces of the window, their versions and C"),
        sa.Column("lines", sa.LargeBinary(), nullable=False, comment="NumPy archives one after the other, one a piece"),
        sa.PrimaryKeyConstraint("kind", "scope", "since_us", "until_us", name="pk_kept_fit"),
    )


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("kept_fit")
