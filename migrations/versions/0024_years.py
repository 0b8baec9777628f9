"""What is kept of a fit holds what other years are fitted with: it is made anew. And work is found by what was asked."""

from __future__ import annotations

from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forget what older fits kept, a cache."""
    op.execute("DELETE FROM sums WHERE kind <> 'drift'")
    op.create_index("ix_job_work", "job", ["kind", "request"])
