"""A change has a shape along frequency, with which it is taken out of a mean."""

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """What is on record has none."""
    op.add_column("change", sa.Column("tilt", sa.Float(), comment="change of ln C as the Legendre polynomial 1 over the band; null where it is none"))
    op.add_column("change", sa.Column("curvature", sa.Float(), comment="the same of the polynomial 2"))
