"""Spectra are keyed by event first: those that arrive together lie together, and one index is kept instead of two."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None

COLUMNS = ("path", "event", "time_us", "blocks", "power")


def upgrade() -> None:
    """To this revision."""
    if op.get_bind().dialect.name == "sqlite":
        _copy(["event", "path"])
        return
    op.drop_index("ix_spectrum_path_time_us", "spectrum")
    _replace_key(["event", "path"])
    op.execute("COMMENT ON COLUMN spectrum.time_us IS 'within a minute of that of its event'")


def downgrade() -> None:
    """To the revision before."""
    if op.get_bind().dialect.name == "sqlite":
        _copy(["path", "event"])
    else:
        _replace_key(["path", "event"])
        op.execute("COMMENT ON COLUMN spectrum.time_us IS NULL")
    op.create_index("ix_spectrum_path_time_us", "spectrum", ["path", "time_us"])


def _replace_key(columns: Sequence[str]) -> None:
    op.drop_constraint("pk_spectrum", "spectrum")
    op.create_primary_key("pk_spectrum", "spectrum", list(columns))


def _copy(key: Sequence[str]) -> None:
    """Write the table anew in order of its key: SQLite cannot change the key of a table."""
    op.create_table(
        "spectrum_by_key",
        sa.Column("path", sa.Integer(), nullable=False),
        sa.Column("event", sa.Integer(), nullable=False),
        sa.Column("time_us", sa.BigInteger(), nullable=False),
        sa.Column("blocks", sa.Integer(), nullable=False),
        sa.Column("power", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["path"], ["path.id"], name="fk_spectrum_path"),
        sa.ForeignKeyConstraint(["event"], ["event.id"], name="fk_spectrum_event"),
        sa.PrimaryKeyConstraint(*key, name="pk_spectrum"),
    )
    old, new = (sa.table(name, *map(sa.column, COLUMNS)) for name in ("spectrum", "spectrum_by_key"))
    op.execute(sa.insert(new).from_select(COLUMNS, sa.select(old).order_by(*(old.c[name] for name in key))))
    op.drop_table("spectrum")
    op.rename_table("spectrum_by_key", "spectrum")
