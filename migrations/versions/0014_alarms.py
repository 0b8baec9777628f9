"""Alarms, the events of every path against its reference, and what was found in them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

BigNumber = sa.BigInteger().with_variant(sa.Integer, "sqlite")
SHAPES = {
    "tilt": "of ln C: coefficient of the Legendre polynomial 1 over the band",
    "tilt_sigma": None,
    "curvature": "of ln C: coefficient of the Legendre polynomial 2",
    "curvature_sigma": None,
}


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "alarm",
        sa.Column("id", BigNumber, nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("scope", sa.Text(), nullable=False, comment="array, CS002 or CS002/17/X"),
        sa.Column("station", sa.Text()),
        sa.Column("antenna", sa.Integer()),
        sa.Column("dipole", sa.Text()),
        sa.Column("subject", sa.Text(), nullable=False, comment="tells problems of one kind and scope apart"),
        sa.Column("sentence", sa.Text(), nullable=False),
        sa.Column("content", sa.Text(), nullable=False, comment="JSON"),
        sa.Column("since_us", sa.BigInteger(), comment="when the problem began"),
        sa.Column("since_error_us", sa.BigInteger(), nullable=False),
        sa.Column("raised_us", sa.BigInteger(), nullable=False),
        sa.Column("seen_us", sa.BigInteger(), nullable=False, comment="when it was found last"),
        sa.Column("ended_us", sa.BigInteger(), comment="null while it lasts"),
        sa.Column("known_by", sa.Text(), comment="who acknowledged it last"),
        sa.Column("known_us", sa.BigInteger()),
        sa.Column("known_why", sa.Text()),
        sa.Column("known_until_us", sa.BigInteger(), comment="null is for good"),
        sa.PrimaryKeyConstraint("id", name="pk_alarm"),
    )
    op.create_index("ix_alarm_kind_scope", "alarm", ["kind", "scope"])
    op.create_table(
        "event_modes",
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("dipole", sa.Text(), nullable=False),
        sa.Column("since_us", sa.BigInteger(), nullable=False, comment="the first instant of the year"),
        sa.Column("antennas", sa.Text(), nullable=False, comment="JSON"),
        sa.Column("time_us", sa.LargeBinary(), nullable=False, comment="little-endian i8, one an event"),
        sa.Column("ln_c", sa.LargeBinary(), nullable=False, comment="little-endian f4 (antenna, event, mode)"),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("station", "dipole", "since_us", name="pk_event_modes"),
    )
    op.create_table(
        "drift_report",
        sa.Column("inputs", sa.Text(), nullable=False, comment="hash of what it was made from"),
        sa.Column("report", sa.Text(), nullable=False, comment="JSON"),
        sa.Column("made_us", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("inputs", name="pk_drift_report"),
    )
    with op.batch_alter_table("monthly_ratio") as batch:
        for name, comment in SHAPES.items():
            batch.add_column(sa.Column(name, sa.Float(), comment=comment))


def downgrade() -> None:
    """To the revision before."""
    with op.batch_alter_table("monthly_ratio") as batch:
        for name in SHAPES:
            batch.drop_column(name)
    for table in ("drift_report", "event_modes", "alarm"):
        op.drop_table(table)
