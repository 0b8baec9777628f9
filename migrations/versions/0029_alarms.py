"""Alarms are found by their station: the life of one walks those of no other."""

from alembic import op

revision = "0029"
down_revision = "0028"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the index."""
    op.create_index(op.f("ix_alarm_station_id"), "alarm", ["station", "id"])
