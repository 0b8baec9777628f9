"""The edges of the ledger's intervals, and indexes of the few rows that somebody waits for."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

FILL = """
INSERT INTO edge (station, at_us, known_us)
SELECT station, at_us, min(known_us) FROM (
    SELECT coalesce(station, '') AS station, valid_from_us AS at_us, at_us AS known_us FROM promotion
    UNION ALL SELECT coalesce(station, ''), valid_to_us, at_us FROM promotion WHERE valid_to_us IS NOT NULL
) AS ends GROUP BY station, at_us
"""
INDEXES = (
    ("ix_job_part_open", "job_part", "id", "state IN ('queued', 'running')"),
    ("ix_job_part_failed", "job_part", "ended_us", "state = 'failed'"),
    ("ix_calibration_gated", "calibration", "id", "gate IS NOT NULL"),
)


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "edge",
        sa.Column("station", sa.Text(), nullable=False, comment="empty for the array"),
        sa.Column("at_us", sa.BigInteger(), nullable=False, comment="where an interval begins or ends"),
        sa.Column(
            "known_us", sa.BigInteger(), nullable=False, comment="the instant `at` of the first promotion that has it"
        ),
        sa.PrimaryKeyConstraint("station", "at_us", name="pk_edge"),
        comment="what follows from the ledger: between two edges every answer about a station is the same",
    )
    op.execute(FILL)
    for name, table, column, where in INDEXES:
        op.create_index(name, table, [column], sqlite_where=sa.text(where), postgresql_where=sa.text(where))


def downgrade() -> None:
    """To the revision before."""
    for name, table, _, _ in INDEXES:
        op.drop_index(name, table)
    op.drop_table("edge")
