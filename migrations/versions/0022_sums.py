"""One table of what is kept of blocks of spectra in place of four: caches, which the next night makes again."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None

BIG = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def _key(name: str, kind: type[sa.types.TypeEngine[object]]) -> sa.Column[object]:
    return sa.Column(name, kind, primary_key=True)


def _filled(name: str, kind: object) -> sa.Column[object]:
    return sa.Column(name, kind, nullable=False)  # type: ignore[call-overload] # a type or a value of one


def upgrade() -> None:
    """Drop the caches that follow from the stored spectra, and make those in their place."""
    for name in ("kept_fit", "drift_source", "event_modes", "monthly_ratio", "drift_year"):
        op.drop_table(name)
    op.create_table(
        "sums",
        _key("kind", sa.Text), _key("scope", sa.Text), _key("since_us", sa.BigInteger), _key("until_us", sa.BigInteger),
        _filled("inputs", sa.Text), _filled("spectra", sa.Integer), _filled("flag", BIG), _filled("event", BIG),
        _filled("whole", sa.Integer), _filled("arrays", sa.LargeBinary), _filled("sha256", sa.Text),
    )  # fmt: skip
    op.create_table(
        "drift_year",
        _key("station", sa.Text), _key("since_us", sa.BigInteger), _filled("digest", sa.Text),
        _filled("months", sa.Text), sa.Column("matrix", sa.Text), sa.Column("paths", sa.Text),
        sa.Column("ratios", sa.LargeBinary),
    )  # fmt: skip


def downgrade() -> None:
    """Drop the new caches; those of before come back with a backup."""
    for name in ("sums", "drift_year"):
        op.drop_table(name)
