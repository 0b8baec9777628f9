"""The tables of drift: caches of what follows from the stored spectra. With them the schema is whole."""

from __future__ import annotations

from sqlalchemy import BigInteger, Column, Float, ForeignKey, Integer, LargeBinary, Table, Text

from service.schema.tables import BigNumber, metadata

monthly_ratio = Table(
    "monthly_ratio",
    metadata,
    Column("path", Integer, ForeignKey("path.id"), primary_key=True),
    Column("month_us", BigInteger, primary_key=True, comment="the month's first instant"),
    Column("reference", Text, ForeignKey("calibration.id"), nullable=False),
    Column("c_ratio", Float, nullable=False, comment="band-mean C of the month over that of the reference"),
    Column("c_ratio_sigma", Float, nullable=False),
    Column("events", Integer, nullable=False),
    Column("tilt", Float, comment="of ln C: coefficient of the Legendre polynomial 1 over the band"),
    Column("tilt_sigma", Float),
    Column("curvature", Float, comment="of ln C: coefficient of the Legendre polynomial 2"),
    Column("curvature_sigma", Float),
)

drift_year = Table(
    "drift_year",
    metadata,
    Column("station", Text, primary_key=True, comment="empty for the array"),
    Column("since_us", BigInteger, primary_key=True, comment="the first instant of the year"),
    Column("inputs", Text, nullable=False, comment="hash of its months; for the array of those of all stations"),
    Column("months", Text, comment="JSON: what all paths together say; null where it is still to be computed"),
    Column("matrix", Text, comment="JSON: every path beside the station's median; null for the array"),
)

drift_source = Table(
    "drift_source",
    metadata,
    Column("station", Text, primary_key=True),
    Column("since_us", BigInteger, primary_key=True, comment="the first instant of the year"),
    Column("inputs", Text, nullable=False, comment="hash of all that its events were measured with but the spectra"),
    Column("spectra", Integer, nullable=False, comment="count of usable spectra"),
    Column("flag", BigInteger, nullable=False, comment="the last flag that was set in the year"),
    Column("event", BigInteger, nullable=False, comment="the newest event"),
    Column("screened", Integer, nullable=False, comment="count of usable spectra when the whole year was read last"),
)

event_modes = Table(
    "event_modes",
    metadata,
    Column("station", Text, primary_key=True),
    Column("dipole", Text, primary_key=True),
    Column("since_us", BigInteger, primary_key=True, comment="the first instant of the year"),
    Column("antennas", Text, nullable=False, comment="JSON"),
    Column("time_us", LargeBinary, nullable=False, comment="little-endian i8, one an event"),
    Column("ln_c", LargeBinary, nullable=False, comment="little-endian f4 (antenna, event, mode)"),
    Column("sha256", Text, nullable=False),
)

window_cut = Table(
    "window_cut",
    metadata,
    Column("id", BigNumber, primary_key=True),
    Column("station", Text, nullable=False),
    Column("antenna", Integer, nullable=False),
    Column("date_us", BigInteger, nullable=False, comment="when the antenna changed, as the watch found it first"),
    Column("sigma_us", BigInteger, nullable=False, comment="standard deviation of the date"),
    Column("made_us", BigInteger, nullable=False),
    Column("lifted_us", BigInteger, comment="when the watch no longer found the change; null while it stands"),
)

cut_decision = Table(
    "cut_decision",
    metadata,
    Column("id", BigNumber, primary_key=True),
    Column("cut", BigNumber, ForeignKey("window_cut.id"), nullable=False, index=True),
    Column("act", Text, nullable=False, comment="lifted or restored"),
    Column("at_us", BigInteger, nullable=False),
    Column("by", Text, nullable=False),
    Column("reason", Text, nullable=False),
)

drift_report = Table(
    "drift_report",
    metadata,
    Column("inputs", Text, primary_key=True, comment="hash of what it was made from"),
    Column("report", Text, nullable=False, comment="JSON"),
    Column("made_us", BigInteger, nullable=False),
)

SCHEMA = metadata
"""All tables."""
