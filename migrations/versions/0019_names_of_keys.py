"""Names of keys: who or what uses one."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    op.add_column("api_key", sa.Column("name", sa.Text(), nullable=True, comment="who or what uses it"))


def downgrade() -> None:
    """To the revision before."""
    op.drop_column("api_key", "name")
