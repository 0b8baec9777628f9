"""Versions name the spectra with anomalous power that were left out of their fit."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    comment = "spectra with anomalous power: counts and the worst, JSON; null where none is"
    op.add_column("calibration", sa.Column("anomalies", sa.Text(), comment=comment))


def downgrade() -> None:
    """To the revision before."""
    op.drop_column("calibration", "anomalies")
