"""The newest promotion of each scope and interval, so that nobody reads those that it replaced."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

FILL = """
INSERT INTO standing (scope, valid_from_us, valid_to_us, promotion)
SELECT scope, valid_from_us, coalesce(valid_to_us, 9223372036854775807), max(id) FROM promotion
GROUP BY scope, valid_from_us, coalesce(valid_to_us, 9223372036854775807)
"""


def upgrade() -> None:
    """To this revision."""
    number = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
    of_end, of_promotion = "2^63 - 1 where the interval is open", "the newest of the interval"
    op.create_table(
        "standing",
        sa.Column("scope", sa.Text(), nullable=False),
        sa.Column("valid_from_us", sa.BigInteger(), nullable=False),
        sa.Column("valid_to_us", sa.BigInteger(), nullable=False, comment=of_end),
        sa.Column("promotion", number, nullable=False, comment=of_promotion),
        sa.ForeignKeyConstraint(["promotion"], ["promotion.id"], name="fk_standing_promotion"),
        sa.PrimaryKeyConstraint("scope", "valid_from_us", "valid_to_us", name="pk_standing"),
        comment="what follows from the ledger: the promotions that can decide as of now",
    )
    op.execute(FILL)


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("standing")
