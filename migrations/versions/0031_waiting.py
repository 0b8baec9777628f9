"""Versions that wait for a person are found by their scope: of many paths, others' are not looked at."""

import sqlalchemy as sa
from alembic import op

revision = "0031"
down_revision = "0030"
branch_labels = None
depends_on = None

NAME = "ix_calibration_gated"
IS_GATED = sa.text("gate IS NOT NULL")


def upgrade() -> None:
    """Begin the index with the scope."""
    op.drop_index(NAME, "calibration")
    op.create_index(NAME, "calibration", ["scope", "id"], sqlite_where=IS_GATED, postgresql_where=IS_GATED)
