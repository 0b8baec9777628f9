"""The tables, the same on SQLite and PostgreSQL. A column `*_us` is an instant: whole microseconds since 1970."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    PrimaryKeyConstraint,
    Table,
    Text,
    UniqueConstraint,
    text,
)

from service.errors import UnavailableError

IS_OPEN = text("state IN ('queued', 'running')")
HAS_FAILED = text("state = 'failed'")
HAS_SETTLED = text("state IN ('done', 'cancelled')")
IS_GATED = text("gate IS NOT NULL")
IS_FAR = text("far IS NOT NULL")
"""Select the few rows that partial indexes hold. A query must use these very words: a parameter does not imply them."""

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _table(name: str, *parts: Any, comment: str | None = None) -> Table:
    return Table(name, metadata, *parts, comment=comment)


BigNumber = BigInteger().with_variant(Integer, "sqlite")  # SQLite counts rows in INTEGER PRIMARY KEY only

event = _table(
    "event",
    Column("id", BigNumber, primary_key=True),
    Column("event_id", Text, nullable=False, unique=True),
    Column("time_us", BigInteger, nullable=False, index=True),
    Column("env", Text, comment="covariates by name, JSON"),
    Column("flag", Text, comment="why the event is left out of fits; its history is in event_flag"),
)

event_flag = _table(
    "event_flag",
    Column("id", BigNumber, primary_key=True),
    Column("event", BigNumber, ForeignKey("event.id"), nullable=False, index=True),
    Column("flag", Text),
    Column("reason", Text, nullable=False),
    Column("by", Text, nullable=False),
    Column("at_us", BigInteger, nullable=False),
)

path = _table(
    "path",
    Column("id", Integer, primary_key=True),
    Column("station", Text, nullable=False),
    Column("antenna", Integer, nullable=False),
    Column("dipole", Text, nullable=False),
    UniqueConstraint("station", "antenna", "dipole"),
)

spectrum = _table(
    "spectrum",
    Column("path", Integer, ForeignKey("path.id"), nullable=False),
    Column("event", BigNumber, ForeignKey("event.id"), nullable=False),
    Column("time_us", BigInteger, nullable=False, comment="within a minute of that of its event"),
    Column("blocks", Integer, nullable=False),
    Column("power", LargeBinary, nullable=False, comment="little-endian f8, one a channel, ADC^2/Ohm/MHz"),
    Column("far", Float, comment="times the path's power at that time; left out of fits until it is known to last"),
    Index("ix_spectrum_far", "path", sqlite_where=IS_FAR, postgresql_where=IS_FAR),
    # by event: what arrives together lies together, and what a window holds is found by its events
    PrimaryKeyConstraint("event", "path"),
)

event_station = _table(
    "event_station",
    Column("event", BigNumber, ForeignKey("event.id"), nullable=False),
    Column("station", Text, nullable=False),
    Column("spectra", Integer, nullable=False, comment="how many are stored, written with them"),
    Column("waiting", Integer, nullable=False, comment="how many of them are far from the usual power of their paths"),
    PrimaryKeyConstraint("event", "station"),
)

receipt = _table(
    "receipt",
    Column("sha256", Text, primary_key=True, comment="of a body whose spectra are all stored"),
    Column("spectra", Integer, nullable=False, comment="how many it holds"),
    Column("warnings", Text, comment="what was said of it, JSON"),
    Column("at_us", BigInteger, nullable=False),
)

calibration = _table(
    "calibration",
    Column("id", Text, primary_key=True, comment="SHA-256 of the inputs"),
    Column("scope", Text, nullable=False, index=True, comment="array, CS002 or CS002/17/X"),
    Column("station", Text),
    Column("antenna", Integer),
    Column("dipole", Text),
    Column("since_us", BigInteger, nullable=False),
    Column("until_us", BigInteger, nullable=False),
    Column("status", Text, nullable=False),
    Column("events", Integer, nullable=False),
    Column("inputs", Text, nullable=False, comment="canonical JSON, hashed into id"),
    Column("curves", Text, nullable=False, comment="canonical JSON, hashed into payload_sha256"),
    Column("payload_sha256", Text, nullable=False),
    Column("reference", Text, comment="the reference chains by dipole, JSON; cables and spreads by hash in chain_part"),
    Column("anomalies", Text, comment="spectra with anomalous power: counts and the worst, JSON; null where none is"),
    Column("gate", Text, comment="why it was not promoted; null where it passed or nobody asked"),
    Column("made_us", BigInteger, nullable=False),
    Column("made_by", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Index(None, "made_us", "id"),
    Index("ix_calibration_gated", "scope", "id", sqlite_where=IS_GATED, postgresql_where=IS_GATED),
)

examined = _table(
    "examined",
    Column("scope", Text, primary_key=True),
    Column("since_us", BigInteger, primary_key=True),
    Column("until_us", BigInteger, primary_key=True),
    Column("inputs", Text, nullable=False, comment="SHA-256 of the inputs of a fit that moved C too little to be kept"),
    Column("calibration", Text, ForeignKey("calibration.id"), nullable=False, index=True, comment="what it confirms"),
    Column("shift", Float, nullable=False, comment="largest change of C in any channel, standard deviations"),
    Column("made_us", BigInteger, nullable=False),
)

sums = _table(
    "sums",
    Column("kind", Text, primary_key=True, comment="calibrations of scope array, station or antenna; or drift"),
    Column("scope", Text, primary_key=True, comment="whose spectra it was made from"),
    Column("since_us", BigInteger, primary_key=True),
    Column("until_us", BigInteger, primary_key=True),
    Column("inputs", Text, nullable=False, comment="hash of all inputs but the spectra"),
    Column("spectra", Integer, nullable=False, comment="how many usable ones it was made from"),
    Column("flag", BigNumber, nullable=False, comment="the last flag set in the window"),
    Column("event", BigNumber, nullable=False, comment="the newest event"),
    Column("whole", Integer, nullable=False, comment="how many usable ones there were when all were read last"),
    Column("arrays", LargeBinary, nullable=False, comment="NumPy archive"),
    Column("sha256", Text, nullable=False, comment="of the archive"),
    comment="what is kept of the spectra of a block of time, so that later events are added to it: a cache",
)

chain_part = _table(
    "chain_part",
    Column("sha256", Text, primary_key=True),
    Column("content", Text, nullable=False, comment="canonical JSON of a cable table or of the spreads of A g"),
)

budget = _table(
    "budget",
    Column("sha256", Text, primary_key=True),
    Column("content", Text, nullable=False, comment="canonical JSON of the terms that curves share"),
)

calibration_mean = _table(
    "calibration_mean",
    Column("calibration", Text, ForeignKey("calibration.id"), primary_key=True),
    Column("dipole", Text, primary_key=True),
    Column("c", Float, nullable=False, comment="mean of C over the band, V per ADC unit"),
    Column("c_sigma", Float, nullable=False, comment="its standard deviation, channels fully correlated"),
)

WITHDRAWS = text("calibration IS NULL")
"""Selects withdrawals, which are few among all promotions."""

promotion = _table(
    "promotion",
    Column("id", BigNumber, primary_key=True),
    Column("scope", Text, nullable=False),
    Column("station", Text),
    Column("antenna", Integer),
    Column("dipole", Text),
    Column("valid_from_us", BigInteger, nullable=False),
    Column("valid_to_us", BigInteger),
    Column("calibration", Text, ForeignKey("calibration.id"), index=True),
    Column("at_us", BigInteger, nullable=False, index=True),
    Column("by", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("undoes_us", BigInteger),
    Index("ix_promotion_newest", "scope", "at_us", "id", "valid_from_us", "valid_to_us"),
    Index("ix_promotion_start", "scope", "valid_from_us", "valid_to_us", "id"),
    Index("ix_promotion_end", "scope", "valid_to_us"),
    Index("ix_promotion_withdrawn_start", "scope", "valid_from_us", sqlite_where=WITHDRAWS, postgresql_where=WITHDRAWS),
    Index("ix_promotion_withdrawn_end", "scope", "valid_to_us", sqlite_where=WITHDRAWS, postgresql_where=WITHDRAWS),
)

standing = _table(
    "standing",
    Column("scope", Text, primary_key=True),
    Column("valid_from_us", BigInteger, primary_key=True),
    Column("valid_to_us", BigInteger, primary_key=True, comment="2^63 - 1 where the interval is open"),
    Column("promotion", BigNumber, ForeignKey("promotion.id"), nullable=False, comment="the newest of the interval"),
    comment="what follows from the ledger: the promotions that can decide as of now",
)

edge = _table(
    "edge",
    Column("station", Text, primary_key=True, comment="empty for the array"),
    Column("at_us", BigInteger, primary_key=True, comment="where an interval begins or ends"),
    Column("known_us", BigInteger, nullable=False, comment="the instant `at` of the first promotion that has it"),
    comment="what follows from the ledger: between two edges every answer about a station is the same",
)

tag = _table(
    "tag",
    Column("name", Text, primary_key=True),
    Column("as_of_us", BigInteger, nullable=False, index=True, comment="the instant at which the ledger is frozen"),
    Column("by", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("at_us", BigInteger, nullable=False, comment="when it was made"),
)

investigation = _table(
    "investigation",
    Column("id", Text, primary_key=True, comment="hash of the inputs"),
    Column("station", Text, nullable=False),
    Column("since_us", BigInteger, nullable=False),
    Column("until_us", BigInteger, nullable=False),
    Column("inputs", Text, nullable=False, comment="JSON"),
    Column("verdict", Text, nullable=False, comment="consistent, explained or unexplained"),
    Column("report", Text, nullable=False, comment="JSON, as it was made"),
    Column("made_us", BigInteger, nullable=False),
    Column("made_by", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Index("ix_investigation_made_us", "made_us", "id"),
    Index("ix_investigation_newest", "station", "until_us", "made_us", "id"),
)

model = _table(
    "model",
    Column("id", Text, primary_key=True, comment="SHA-256 of the content"),
    Column("content", Text, nullable=False, comment="canonical JSON of the adopted causes"),
)

model_change = _table(
    "model_change",
    Column("id", BigNumber, primary_key=True),
    Column("station", Text, nullable=False),
    Column("act", Text, nullable=False, comment="adopted or withdrawn"),
    Column("model", Text, ForeignKey("model.id"), nullable=False, comment="what the station has from now on"),
    Column("before", Text, ForeignKey("model.id"), nullable=False),
    Column("cause", Text, ForeignKey("model.id"), nullable=False, comment="the model that has the one cause alone"),
    Column("since_us", BigInteger, comment="the interval in which the cause acts"),
    Column("until_us", BigInteger),
    Column("known_until_us", BigInteger, comment="the newest event of the investigation"),
    Column("investigation", Text, ForeignKey("investigation.id")),
    Column("finding", Integer, comment="its number in the report"),
    Column("announced", Text, nullable=False, comment="change of mean C and its error by scope and dipole, JSON"),
    Column("promise", Text, comment="gain in log-likelihood and its error, JSON"),
    Column("at_us", BigInteger, nullable=False),
    Column("by", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Index(None, "station", "id"),
)

model_gain = _table(
    "model_gain",
    Column("cause", Text, ForeignKey("model.id"), primary_key=True),
    Column("since_us", BigInteger, primary_key=True),
    Column("until_us", BigInteger, primary_key=True),
    Column("station", Text, nullable=False),
    Column("events", Integer, nullable=False, comment="of the window that the adoption had not seen"),
    Column("gain", Float, nullable=False, comment="log-likelihood with the cause minus without"),
    Column("expected", Float, nullable=False, comment="if its size is as adopted"),
    Column("expected_sigma", Float, nullable=False),
    Column("made_us", BigInteger, nullable=False),
)

job = _table(
    "job",
    Column("id", BigNumber, primary_key=True),
    Column("kind", Text, nullable=False),
    Column("request", Text, nullable=False, comment="JSON"),
    Column("reason", Text, nullable=False),
    Column("by", Text, nullable=False),
    Column("created_us", BigInteger, nullable=False),
    Column("due_name", Text, index=True, comment="names scheduled work"),
    Column("due_key", Text, unique=True, comment="its name and which try it is, so that each try is enqueued once"),
    Column("is_cancelled", Boolean, nullable=False),
    Column("called_for", Text, comment="inputs that called for scheduled work, JSON by name"),
    Index("ix_job_work", "kind", "request"),
)

job_part = _table(
    "job_part",
    Column("id", BigNumber, primary_key=True),
    Column("job", BigNumber, ForeignKey("job.id"), nullable=False, index=True),
    Column("request", Text, nullable=False, comment="JSON"),
    Column("inputs", Text, comment="hashes that the worker must have: instrument, sky power, model version; JSON"),
    Column("state", Text, nullable=False, comment="queued, running, done, failed or cancelled"),
    Column("worker", Text, comment="who holds the lease"),
    Column("lease_until_us", BigInteger),
    Column("attempts", Integer, nullable=False),
    Column("result", Text, comment="JSON"),
    Column("error", Text),
    Column("ended_us", BigInteger),
    Index(None, "state", "id"),
    Index("ix_job_part_open", "id", sqlite_where=IS_OPEN, postgresql_where=IS_OPEN),
    Index("ix_job_part_failed", "ended_us", sqlite_where=HAS_FAILED, postgresql_where=HAS_FAILED),
    Index("ix_job_part_settled", "ended_us", sqlite_where=HAS_SETTLED, postgresql_where=HAS_SETTLED),
)

process = _table(
    "process",
    Column("name", Text, primary_key=True, comment="host, number and a random part"),
    Column("kind", Text, nullable=False, comment="api, scheduler or worker"),
    Column("started_us", BigInteger, nullable=False),
    Column("seen_us", BigInteger, nullable=False, comment="by the clock of the database"),
    Column("inputs", Text, comment="hashes of what it works with: instrument, sky power, model version; JSON"),
)

deed = _table(
    "deed",
    Column("by", Text, primary_key=True),
    Column("name", Text, primary_key=True, comment="the Idempotency-Key of a request"),
    Column("request_sha256", Text, nullable=False),
    Column("answer", Text, comment="what was answered, JSON"),
    Column("at_us", BigInteger, nullable=False, index=True),
)

api_key = _table(
    "api_key",
    Column("id", Integer, primary_key=True),
    Column("sha256", Text, nullable=False, unique=True),
    Column("name", Text, comment="who or what uses it"),
    Column("scopes", Text, nullable=False, comment="JSON"),
    Column("created_us", BigInteger, nullable=False),
    Column("expires_us", BigInteger),
    Column("revoked_us", BigInteger),
)

session = _table(
    "session",
    Column("sha256", Text, primary_key=True, comment="of what the cookie holds"),
    Column("key", Integer, ForeignKey("api_key.id"), nullable=False),
    Column("expires_us", BigInteger, nullable=False),
)

alarm = _table(
    "alarm",
    Column("id", BigNumber, primary_key=True),
    Column("kind", Text, nullable=False),
    Column("scope", Text, nullable=False, comment="array, CS002 or CS002/17/X"),
    Column("station", Text),
    Column("antenna", Integer),
    Column("dipole", Text),
    Column("subject", Text, nullable=False, comment="tells problems of one kind and scope apart"),
    Column("sentence", Text, nullable=False),
    Column("content", Text, nullable=False, comment="JSON"),
    Column("since_us", BigInteger, comment="when the problem began"),
    Column("since_error_us", BigInteger, nullable=False),
    Column("raised_us", BigInteger, nullable=False),
    Column("seen_us", BigInteger, nullable=False, comment="when it was found last"),
    Column("ended_us", BigInteger, comment="null while it lasts"),
    Column("known_by", Text, comment="who acknowledged it last"),
    Column("known_us", BigInteger),
    Column("known_why", Text),
    Column("known_until_us", BigInteger, comment="null is for good"),
    Index(None, "kind", "scope"),
    Index(None, "station", "id"),
)


# What drift tells: caches of what follows from the blocks of drift. With them the schema is whole.

drift_year = _table(
    "drift_year",
    Column("station", Text, primary_key=True, comment="empty for the array"),
    Column("since_us", BigInteger, primary_key=True, comment="the first instant of the year"),
    Column("digest", Text, nullable=False, comment="hash of its months"),
    Column("months", Text, nullable=False, comment="JSON: what all paths together say"),
    Column("matrix", Text, comment="JSON: every path beside the station's median; null for the array"),
    Column("paths", Text, comment="JSON: paths and months of the ratios; null for the array"),
    Column("ratios", LargeBinary, comment="little-endian f8 (path, month, number); null for the array"),
)

change = _table(
    "change",
    Column("id", BigNumber, primary_key=True),
    Column("station", Text, comment="null for the array"),
    Column("paths", Text, nullable=False, comment="JSON: antenna and dipole (null: both) of each; empty for all"),
    Column("kind", Text, nullable=False, comment="step, ramp, season or course"),
    Column("date_us", BigInteger, nullable=False, comment="when it changed"),
    Column("sigma_us", BigInteger, nullable=False, comment="standard deviation of the date"),
    Column("size", Float, comment="change of C, a fraction"),
    Column("size_sigma", Float),
    Column("tilt", Float, comment="change of ln C as the Legendre polynomial 1 over the band; null where it is none"),
    Column("curvature", Float, comment="the same of the polynomial 2"),
    Column("made_us", BigInteger, nullable=False),
    comment="what changed in a path, a station or the array, one row whoever found it",
)

change_evidence = _table(
    "change_evidence",
    Column("id", BigNumber, primary_key=True),
    Column("change", BigNumber, ForeignKey("change.id"), nullable=False, index=True),
    Column("source", Text, nullable=False, comment="drift, investigation, record or person"),
    Column("ref", Text, nullable=False, comment="id of the investigation, or who says so"),
    Column("significance", Float, comment="standard deviations"),
    Column("made_us", BigInteger, nullable=False),
    Column("ended_us", BigInteger, comment="when the source no longer said so; null while it does"),
    Column("date_us", BigInteger, comment="date of the change from then on; null where it kept the one that it had"),
    Column("sigma_us", BigInteger),
    Column("size", Float),
    Column("size_sigma", Float),
    Column("tilt", Float),
    Column("curvature", Float),
)

change_decision = _table(
    "change_decision",
    Column("id", BigNumber, primary_key=True),
    Column("change", BigNumber, ForeignKey("change.id"), nullable=False, index=True),
    Column("decision", Text, nullable=False, comment="in_force or dismissed"),
    Column("at_us", BigInteger, nullable=False),
    Column("by", Text, nullable=False),
    Column("reason", Text, nullable=False),
)

drift_report = _table(
    "drift_report",
    Column("inputs", Text, primary_key=True, comment="hash of what it was made from"),
    Column("report", Text, nullable=False, comment="JSON"),
    Column("made_us", BigInteger, nullable=False),
)


# The revisions of the schema: those that this code knows, and the newest, which it needs.


@cache
def known_revisions() -> tuple[str, ...]:
    """List the revisions that this code knows, oldest first: the numbers with which their files begin."""
    names = (one.name for one in files("migrations").joinpath("versions").iterdir())
    return tuple(sorted(name.partition("_")[0] for name in names if name.endswith(".py")))


def require_known(revision: str | None) -> None:
    """Refuse a schema that a newer version made, or one from before the first that was released."""
    first, newest = known_revisions()[0], known_revisions()[-1]
    if revision is not None and revision not in known_revisions():
        what = f"older than the first that was released ({first}): start a new database"
        if revision > newest:
            what = f"newer than this version of lbacal knows ({newest}): install the newer one"
        raise UnavailableError(f"the database schema is {revision}, {what}")


def require_newest(revision: str | None) -> None:
    """Refuse a schema that is not the one this code needs, and name the cure."""
    needed = known_revisions()[-1]
    if revision != needed:
        require_known(revision)
        raise UnavailableError(
            f"the database schema is {revision or 'empty'}, {needed} is needed: run `lbacal db upgrade`"
        )
