"""One table of changes, their evidence and the decisions about them in place of cuts, each of which becomes a change.

And jobs keep what called for them.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None

BIG = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Make the tables, and carry over cuts and what was decided about them."""
    op.create_table(
        "change",
        sa.Column("id", BIG, primary_key=True),
        sa.Column("station", sa.Text, comment="null for the array"),
        sa.Column("paths", sa.Text, nullable=False, comment="JSON: antenna and dipole (null: both) of each; empty for all"),
        sa.Column("kind", sa.Text, nullable=False, comment="step, ramp, season or course"),
        sa.Column("date_us", sa.BigInteger, nullable=False, comment="when it changed, as it was found first"),
        sa.Column("sigma_us", sa.BigInteger, nullable=False, comment="standard deviation of the date"),
        sa.Column("size", sa.Float, comment="change of C, a fraction"),
        sa.Column("size_sigma", sa.Float),
        sa.Column("made_us", sa.BigInteger, nullable=False),
        comment="what changed in a path, a station or the array, one row whoever found it",
    )
    op.create_table(
        "change_evidence",
        sa.Column("id", BIG, primary_key=True),
        sa.Column("change", BIG, sa.ForeignKey("change.id"), nullable=False),
        sa.Column("source", sa.Text, nullable=False, comment="drift, investigation, record or person"),
        sa.Column("ref", sa.Text, nullable=False, comment="id of the investigation, or who says so"),
        sa.Column("significance", sa.Float, comment="standard deviations"),
        sa.Column("made_us", sa.BigInteger, nullable=False),
        sa.Column("ended_us", sa.BigInteger, comment="when the source no longer said so; null while it does"),
    )
    op.create_table(
        "change_decision",
        sa.Column("id", BIG, primary_key=True),
        sa.Column("change", BIG, sa.ForeignKey("change.id"), nullable=False),
        sa.Column("decision", sa.Text, nullable=False, comment="in_force or dismissed"),
        sa.Column("at_us", sa.BigInteger, nullable=False),
        sa.Column("by", sa.Text, nullable=False),
        sa.Column("reason", sa.Text, nullable=False),
    )
    for table in ("change_evidence", "change_decision"):
        op.create_index(f"ix_{table}_change", table, ["change"])
    op.execute(
        "INSERT INTO change (id, station, paths, kind, date_us, sigma_us, made_us) "
        "SELECT id, station, '[[' || antenna || ', null]]', 'step', date_us, sigma_us, made_us FROM window_cut"
    )
    op.execute(
        "INSERT INTO change_evidence (change, source, ref, made_us, ended_us) "
        "SELECT id, 'drift', '', made_us, lifted_us FROM window_cut"
    )
    op.execute(
        'INSERT INTO change_decision (change, decision, at_us, "by", reason) '
        "SELECT cut, CASE act WHEN 'lifted' THEN 'dismissed' ELSE 'in_force' END, at_us, \"by\", reason "
        "FROM cut_decision ORDER BY id"
    )
    if op.get_bind().dialect.name == "postgresql":  # whose numbers would begin at 1 again
        op.execute("SELECT setval(pg_get_serial_sequence('change', 'id'), max(id)) FROM change HAVING max(id) > 0")
    op.drop_table("cut_decision")
    op.drop_table("window_cut")
    op.add_column("job", sa.Column("called_for", sa.Text, comment="inputs that called for scheduled work, JSON by name"))
