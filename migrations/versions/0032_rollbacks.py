"""A rollback keeps the instant of the act that it undoes, so that rollbacks in any order give the state without it."""

import sqlalchemy as sa
from alembic import op

revision = "0032"
down_revision = "0031"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; rollbacks of before are promotions as any other."""
    op.add_column("promotion", sa.Column("undoes_us", sa.BigInteger()))
