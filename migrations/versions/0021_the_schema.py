"""Where the history begins: an empty database is made whole from `service/schema`, at the newest revision.

What changes the tables later is a migration beside this one, for the databases that there are.
"""

from __future__ import annotations

revision = "0021"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change nothing: `migrations/env.py` has made every table."""
