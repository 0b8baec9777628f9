"""Tries of due work, inputs of parts, processes that live, and deeds that are done once."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    # columns are added, not tables made anew: jobs are referred to by their parts
    op.add_column("job", sa.Column("due_name", sa.Text(), nullable=True, comment="names scheduled work"))
    op.execute("UPDATE job SET due_name = due_key")
    op.create_index("ix_job_due_name", "job", ["due_name"])
    inputs = "hashes that the worker must have: instrument, sky power, model version; JSON"
    op.add_column("job_part", sa.Column("inputs", sa.Text(), nullable=True, comment=inputs))
    if op.get_bind().dialect.name != "sqlite":
        op.alter_column(
            "job",
            "due_key",
            comment="its name and which try it is, so that each try is enqueued once",
            existing_comment="names scheduled work, so that it is enqueued once",
            existing_type=sa.Text(),
        )
    op.create_table(
        "process",
        sa.Column("name", sa.Text(), nullable=False, comment="host, number and a random part"),
        sa.Column("kind", sa.Text(), nullable=False, comment="api, scheduler or worker"),
        sa.Column("started_us", sa.BigInteger(), nullable=False),
        sa.Column("seen_us", sa.BigInteger(), nullable=False, comment="by the clock of the database"),
        sa.Column(
            "inputs",
            sa.Text(),
            nullable=True,
            comment="hashes of what it works with: instrument, sky power, model version; JSON",
        ),
        sa.PrimaryKeyConstraint("name", name="pk_process"),
    )
    op.create_table(
        "deed",
        sa.Column("by", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False, comment="the Idempotency-Key of a request"),
        sa.Column("request_sha256", sa.Text(), nullable=False),
        sa.Column("answer", sa.Text(), nullable=True, comment="what was answered, JSON"),
        sa.Column("at_us", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("by", "name", name="pk_deed"),
    )
    op.create_index("ix_deed_at_us", "deed", ["at_us"])


def downgrade() -> None:
    """To the revision before."""
    op.drop_index("ix_deed_at_us", "deed")
    op.drop_table("deed")
    op.drop_table("process")
    op.drop_column("job_part", "inputs")
    op.drop_index("ix_job_due_name", "job")
    op.drop_column("job", "due_name")
