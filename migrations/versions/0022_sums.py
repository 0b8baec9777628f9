"""One table of what is kept of blocks of spectra in place of four: caches, which the next night makes again."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None

Kind = sa.types.TypeEngine[object] | type[sa.types.TypeEngine[object]]
BIG = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def _key(name: str, kind: Kind, comment: str | None = None) -> sa.Column[object]:
    return sa.Column(name, kind, primary_key=True, autoincrement=False, comment=comment)


def _filled(name: str, kind: Kind, comment: str) -> sa.Column[object]:
    return sa.Column(name, kind, nullable=False, comment=comment)


def upgrade() -> None:
    """Drop the caches that follow from the stored spectra, and make those in their place."""
    for name in ("kept_fit", "drift_source", "event_modes", "monthly_ratio", "drift_year"):
        op.drop_table(name)
    op.create_table(
        "sums",
        _key("kind", sa.Text, "calibrations of scope array, station or antenna; or drift"),
        _key("scope", sa.Text, "whose spectra it was made from"),
        _key("since_us", sa.BigInteger),
        _key("until_us", sa.BigInteger),
        _filled("inputs", sa.Text, "hash of all inputs but the spectra"),
        _filled("spectra", sa.Integer, "how many usable ones it was made from"),
        _filled("flag", BIG, "the last flag set in the window"),
        _filled("event", BIG, "the newest event"),
        _filled("whole", sa.Integer, "how many usable ones there were when all were read last"),
        _filled("arrays", sa.LargeBinary, "NumPy archive"),
        _filled("sha256", sa.Text, "of the archive"),
        comment="what is kept of the spectra of a block of time, so that later events are added to it: a cache",
    )
    op.create_table(
        "drift_year",
        _key("station", sa.Text, "empty for the array"),
        _key("since_us", sa.BigInteger, "the first instant of the year"),
        _filled("digest", sa.Text, "hash of its months"),
        _filled("months", sa.Text, "JSON: what all paths together say"),
        sa.Column("matrix", sa.Text, comment="JSON: every path beside the station's median; null for the array"),
        sa.Column("paths", sa.Text, comment="JSON: paths and months of the ratios; null for the array"),
        sa.Column(
            "ratios", sa.LargeBinary, comment="little-endian f8 (path, month, number); null for the array"
        ),
    )
