"""Indexes by which the ledger finds what is in effect, and its neighbours, without reading all promotions."""

from __future__ import annotations

from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    op.drop_index("ix_promotion_scope_at_us", table_name="promotion")
    op.create_index("ix_promotion_newest", "promotion", ["scope", "at_us", "id", "valid_from_us", "valid_to_us"])
    op.create_index("ix_promotion_start", "promotion", ["scope", "valid_from_us", "valid_to_us", "id"])
    op.create_index("ix_promotion_end", "promotion", ["scope", "valid_to_us"])
    op.create_index("ix_promotion_calibration", "promotion", ["calibration"])


def downgrade() -> None:
    """To the revision before."""
    for name in ("newest", "start", "end", "calibration"):
        op.drop_index(f"ix_promotion_{name}", table_name="promotion")
    op.create_index("ix_promotion_scope_at_us", "promotion", ["scope", "at_us"])
