"""Indexes by which the ledger finds what is in effect, and its neighbours, without reading all promotions."""

from __future__ import annotations

import sqlalchemy as sa
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
    # withdrawals are few among all promotions
    null = sa.text("calibration IS NULL")
    for name, column in (("withdrawn_start", "valid_from_us"), ("withdrawn_end", "valid_to_us")):
        columns = ["scope", column]
        op.create_index(f"ix_promotion_{name}", "promotion", columns, sqlite_where=null, postgresql_where=null)


def downgrade() -> None:
    """To the revision before."""
    for name in ("newest", "start", "end", "calibration", "withdrawn_start", "withdrawn_end"):
        op.drop_index(f"ix_promotion_{name}", table_name="promotion")
    op.create_index("ix_promotion_scope_at_us", "promotion", ["scope", "at_us"])
