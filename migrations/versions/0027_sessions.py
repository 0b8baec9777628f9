"""Who logged in with a browser: a session names its key, and its cookie does not hold it."""

import sqlalchemy as sa
from alembic import op

revision = "0027"
down_revision = "0026"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Nobody is logged in."""
    op.create_table(
        "session",
        sa.Column("sha256", sa.Text(), nullable=False, comment="of what the cookie holds"),
        sa.Column("key", sa.Integer(), nullable=False),
        sa.Column("expires_us", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["key"], ["api_key.id"], name=op.f("fk_session_key_api_key")),
        sa.PrimaryKeyConstraint("sha256", name=op.f("pk_session")),
    )
