"""How many spectra a station has in an event: written with them, so that what is due is asked without walking spectra."""

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Count what is stored, once."""
    op.create_table(
        "event_station",
        sa.Column("event", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("spectra", sa.Integer(), nullable=False, comment="how many are stored, written with them"),
        sa.Column("waiting", sa.Integer(), nullable=False, comment="how many of them are far from the usual power of their paths"),
        sa.ForeignKeyConstraint(["event"], ["event.id"], name=op.f("fk_event_station_event_event")),
        sa.PrimaryKeyConstraint("event", "station", name=op.f("pk_event_station")),
    )
    op.execute(
        "INSERT INTO event_station (event, station, spectra, waiting) "
        "SELECT spectrum.event, path.station, count(*), count(spectrum.far) FROM spectrum JOIN path ON path.id = spectrum.path "
        "GROUP BY spectrum.event, path.station"
    )
