"""How every process of the service begins: settings, log, instrument and sky, and a database that answers."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from lbacal.engine import HERE, Engine

if TYPE_CHECKING:
    from service.factory import Factory
    from service.storage.database import Database

PAUSE_S = 1.0


def open_factory(engine: Engine = HERE) -> Factory:
    """The use cases on the database of the settings; what is wrong with the settings shows here, not in a later run."""
    from service.config import read_settings
    from service.factory import Factory
    from service.logs import configure_logs

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
