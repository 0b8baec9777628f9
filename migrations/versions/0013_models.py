"""Models that were adopted, what each gained, and the newest investigation of a station by index."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    big_number = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
    op.create_index("ix_investigation_newest", "investigation", ["station", "until_us", "made_us", "id"])
    op.create_table(
        "model",
        sa.Column("id", sa.Text(), nullable=False, comment="SHA-256 of the content"),
        sa.Column("content", sa.Text(), nullable=False, comment="canonical JSON of the adopted causes"),
        sa.PrimaryKeyConstraint("id", name="pk_model"),
    )
    op.create_table(
        "model_change",
        sa.Column("id", big_number, nullable=False),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("act", sa.Text(), nullable=False, comment="adopted or withdrawn"),
        sa.Column("model", sa.Text(), nullable=False, comment="what the station has from now on"),
        sa.Column("before", sa.Text(), nullable=False),
        sa.Column("cause", sa.Text(), nullable=False, comment="the model that has the one cause alone"),
        sa.Column("since_us", sa.BigInteger(), comment="the interval in which the cause acts"),
        sa.Column("until_us", sa.BigInteger()),
        sa.Column("known_until_us", sa.BigInteger(), comment="the newest event of the investigation"),
        sa.Column("investigation", sa.Text()),
        sa.Column("finding", sa.Integer(), comment="its number in the report"),
        sa.Column(
            "announced", sa.Text(), nullable=False, comment="change of mean C and its error by scope and dipole, JSON"
        ),
        sa.Column("promise", sa.Text(), comment="gain in log-likelihood and its error, JSON"),
        sa.Column("at_us", sa.BigInteger(), nullable=False),
        sa.Column("by", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_model_change"),
        sa.ForeignKeyConstraint(["model"], ["model.id"], name="fk_model_change_model"),
        sa.ForeignKeyConstraint(["before"], ["model.id"], name="fk_model_change_before"),
        sa.ForeignKeyConstraint(["cause"], ["model.id"], name="fk_model_change_cause"),
        sa.ForeignKeyConstraint(["investigation"], ["investigation.id"], name="fk_model_change_investigation"),
    )
    op.create_index("ix_model_change_station_id", "model_change", ["station", "id"])
    op.create_table(
        "model_gain",
        sa.Column("cause", sa.Text(), nullable=False),
        sa.Column("since_us", sa.BigInteger(), nullable=False),
        sa.Column("until_us", sa.BigInteger(), nullable=False),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("events", sa.Integer(), nullable=False, comment="of the window that the adoption had not seen"),
        sa.Column("gain", sa.Float(), nullable=False, comment="log-likelihood with the cause minus without"),
        sa.Column("expected", sa.Float(), nullable=False, comment="if its size is as adopted"),
        sa.Column("expected_sigma", sa.Float(), nullable=False),
        sa.Column("made_us", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("cause", "since_us", "until_us", name="pk_model_gain"),
        sa.ForeignKeyConstraint(["cause"], ["model.id"], name="fk_model_gain_cause"),
    )


def downgrade() -> None:
    """To the revision before."""
    op.drop_table("model_gain")
    op.drop_table("model_change")
    op.drop_table("model")
    op.drop_index("ix_investigation_newest", "investigation")
