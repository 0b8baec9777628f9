"""What a source says of a change holds its date and size from then on: later events may move them."""

import sqlalchemy as sa
from alembic import op

revision = "0030"
down_revision = "0029"
branch_labels = None
depends_on = None

COPY = """
UPDATE change_evidence SET (date_us, sigma_us, size, size_sigma, tilt, curvature) =
    (SELECT date_us, sigma_us, size, size_sigma, tilt, curvature FROM "change" WHERE id = change_evidence.change)
WHERE id IN (SELECT min(id) FROM change_evidence GROUP BY change)
"""


def upgrade() -> None:
    """Add the columns, and give the first source of each change the estimate that it has."""
    said = "date of the change from then on; null where it kept the one that it had"
    op.add_column("change_evidence", sa.Column("date_us", sa.BigInteger, comment=said))
    op.add_column("change_evidence", sa.Column("sigma_us", sa.BigInteger))
    for name in ("size", "size_sigma", "tilt", "curvature"):
        op.add_column("change_evidence", sa.Column(name, sa.Float))
    op.execute(COPY)
    if op.get_bind().dialect.name == "postgresql":  # SQLite has no comments
        op.alter_column("change", "date_us", comment="when it changed", existing_type=sa.BigInteger)
