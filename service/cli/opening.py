"""How every process of the service begins: settings, log, instrument and sky, and a database that answers."""

from __future__ import annotations

import logging
import sys
import time
from typing import TYPE_CHECKING, Any

from lbacal.engine import HERE, Engine

if TYPE_CHECKING:
    from service.factory import Factory
    from service.storage.database import Database

PAUSE_S = 1.0


def open_factory(engine: Engine = HERE) -> Factory:
    """The use cases on the database of the settings; what is wrong with the settings shows here, not in a later run."""
    from service.config import read_settings
    from service.factory import Factory

    settings = read_settings()
    configure_logs(settings.log_level)
    factory = Factory(settings, engine=engine)
    # an instrument or sky file that is missing or wrong is noticed before anything is promised
    _ = factory.instrument if settings.sky_power is None else factory.simulation.sky_power
    wait_for_database(factory.database, settings.wait_s)
    return factory


def wait_for_database(database: Database, wait_s: float) -> None:
    """Wait for a database that is still starting; one that will never answer is refused at once."""
    from service.errors import UnavailableError

    end, is_told = time.monotonic() + wait_s, False
    while True:
        try:
            database.ping()
        except UnavailableError as error:
            if not error.is_passing or time.monotonic() > end:
                raise
            if not is_told:
                print(f"lbacal: {error}; waiting for it up to {wait_s:g} s", file=sys.stderr, flush=True)
                is_told = True
            time.sleep(PAUSE_S)
        else:
            return


TALKATIVE = ("alembic", "apscheduler")
"""Libraries that tell each of their steps."""


def configure_logs(level: str) -> None:
    """Write events of a level, such as `info`, and above as JSON lines, those of libraries included."""
    import structlog

    first: list[Any] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    last: list[Any] = [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    number = logging.getLevelNamesMapping()[level.upper()]
    structlog.configure(
        processors=[*first, *last],
        wrapper_class=structlog.make_filtering_bound_logger(number),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=True,
    )
    foreign = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[*first, structlog.stdlib.add_logger_name],
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(foreign)
    logging.basicConfig(level=number, handlers=[handler], force=True)
    logging.captureWarnings(True)
    for name in TALKATIVE:
        logging.getLogger(name).setLevel(max(number, logging.WARNING))
