"""What the months of a year say, by station and for the array; indexes of ended parts and new versions."""

from __future__ import annotations

from datetime import UTC, datetime

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None

SETTLED = "state IN ('done', 'cancelled')"


def upgrade() -> None:
    """To this revision."""
    table = op.create_table(
        "drift_year",
        sa.Column("station", sa.Text(), nullable=False, comment="empty for the array"),
        sa.Column("since_us", sa.BigInteger(), nullable=False, comment="the first instant of the year"),
        sa.Column(
            "inputs",
            sa.Text(),
            nullable=False,
            comment="hash of its months; for the array of those of all stations",
        ),
        sa.Column(
            "months", sa.Text(), comment="JSON: what all paths together say; null where it is still to be computed"
        ),
        sa.Column("matrix", sa.Text(), comment="JSON: every path beside the station's median; null for the array"),
        sa.PrimaryKeyConstraint("station", "since_us", name="pk_drift_year"),
    )
    statement = "SELECT DISTINCT path.station, month_us FROM monthly_ratio JOIN path ON path.id = monthly_ratio.path"
    rows = op.get_bind().execute(sa.text(statement))
    years = {(station, datetime.fromtimestamp(month_us / 1e6, UTC).year) for station, month_us in rows}
    if years:
        unknown = {"inputs": "", "months": None, "matrix": None}
        op.bulk_insert(
            table,
            [
                {"station": station, "since_us": round(datetime(year, 1, 1, tzinfo=UTC).timestamp() * 1e6), **unknown}
                for station, year in sorted(years)
            ],
        )
    where = sa.text(SETTLED)
    op.create_index("ix_job_part_settled", "job_part", ["ended_us"], sqlite_where=where, postgresql_where=where)
    op.create_index("ix_calibration_made_us_id", "calibration", ["made_us", "id"])


def downgrade() -> None:
    """To the revision before."""
    op.drop_index("ix_calibration_made_us_id", "calibration")
    op.drop_index("ix_job_part_settled", "job_part")
    op.drop_table("drift_year")
