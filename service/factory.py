"""The one place where use cases are put together; API, worker, scheduler, commands and tests all come here.

What computes is imported where it is asked for: an API that only answers loads none of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from lbacal.engine import HERE, Engine
from lbacal.instants import read_clock
from lbacal_core.curves.validity import Instant
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.provenance import Remembered
from lbacal_core.sky.table import read_sky_power
from service.config import Settings
from service.storage.database import Database, Stores
from service.storage.jobs import Order, Part
from service.usecases.alarms import Alarms
from service.usecases.calibrations import Calibrations
from service.usecases.changes import Changes
from service.usecases.drift import Drift
from service.usecases.gate import Gate
from service.usecases.intake import Intake
from service.usecases.keys import Keys
from service.usecases.orders import Inputs, name_inputs
from service.usecases.promotions import Promotions, Tags
from service.usecases.status import Status
from service.usecases.watch import Watch
from service.wire.hdf5_body import FileReader

if TYPE_CHECKING:
    from lbacal_core.simulation.simulation import Simulation
    from service.usecases.drift_measurement import DriftMeasurement
    from service.usecases.due import DueWork
    from service.usecases.fits import Fits
    from service.usecases.investigations import Investigations
    from service.usecases.life import Lives
    from service.usecases.models import Models
    from service.usecases.predictions import Predictions
    from service.usecases.refits import Refits

BLOCKS_REMEMBERED = 16
"""Single fits of stations' years and polarisations that stay in a worker's memory: those of an array's year, 150 MB."""


class Factory:
    """Use cases on one database with one instrument."""

    def __init__(self, settings: Settings, clock: Callable[[], Instant] = read_clock, engine: Engine = HERE) -> None:
        self.settings = settings
        self.clock = clock
        self.engine = engine

    @cached_property
    def database(self) -> Database:
        """The database of the settings."""
        return Database(self.settings.sqlalchemy_url)

    @cached_property
    def instrument(self) -> Instrument:
        """The instrument whose spectra are kept here."""
        return load_instrument(self.settings.instrument)

    @cached_property
    def full_instrument(self) -> Instrument:
        """The instrument with all antennas that ever sent spectra: what was answered for one stays an answer.

        Those that its file has no more have some cable: what reads this asks for names and dates alone.
        """
        own, cable = self.instrument.antennas, next(iter(self.instrument.cables))
        stored = self.database.look(lambda stores: stores.spectra.antennas())
        rest = sorted(stored - {(one.station, one.antenna) for one in own})
        return replace(self.instrument, antennas=(*own, *(AntennaRecord(*one, cable) for one in rest)))

    @cached_property
    def intake(self) -> Intake:
        """Spectra in."""
        return Intake(self.database, self.instrument, self.settings.resistance_ohm, self.clock, FileReader())

    @cached_property
    def calibrations(self) -> Calibrations:
        """In effect on a date, and versions."""
        return Calibrations(self.database, self.full_instrument)

    @cached_property
    def promotions(self) -> Promotions:
        """The ledger."""
        return Promotions(self.database, self.full_instrument, self.clock)

    @cached_property
    def tags(self) -> Tags:
        """Names for instants of the ledger."""
        return Tags(self.database, self.clock)

    @cached_property
    def simulation(self) -> Simulation:
        """The instrument under the package's own sky, or the P_sky of the settings' file."""
        from lbacal_core.causes.catalogue import catalogue_with
        from lbacal_core.simulation.simulation import Simulation  # a second to import, and only fits need it

        given = self.settings.sky_power
        read = None if given is None else read_sky_power(given)
        catalogue = catalogue_with(self.settings.causes)
        return Simulation(self.instrument, read, catalogue=catalogue, most_remembered=BLOCKS_REMEMBERED)

    @cached_property
    def inputs(self) -> Inputs:
        """Instrument, sky power and settings that fits are made with here, besides spectra."""
        return name_inputs(self.simulation)

    @cached_property
    def predictions(self) -> Predictions:
        """Predictions of paths."""
        from service.usecases.predictions import Predictions

        return Predictions(self.calibrations, self.simulation, self.fits)

    @cached_property
    def gate(self) -> Gate:
        """The limits that new versions pass to go into effect."""
        return Gate(*(getattr(self.settings, f"gate_{name}") for name in ("change", "error", "coverage", "band")))

    @cached_property
    def refits(self) -> Refits:
        """New versions."""
        from service.usecases.refits import Refits

        return Refits(self.database, self.simulation, self.fits, self.gate, self.settings, self._name_now, self.clock)

    @cached_property
    def fits(self) -> Fits:
        """Versions from stored spectra."""
        from service.usecases.fits import Fits

        return Fits(self.simulation, self.settings.resistance_ohm, self.clock, engine=self.engine)

    @cached_property
    def models(self) -> Models:
        """Causes that are adopted into the models of stations."""
        from service.usecases.models import Models

        return Models(self.database, self.fits, self.promotions, self.due, Remembered(1), self.clock)

    @cached_property
    def investigations(self) -> Investigations:
        """Investigations of stored spectra."""
        from service.usecases.investigations import Investigations

        return Investigations(self.database, self.simulation, self.fits, self.settings, self.clock)

    @cached_property
    def drift(self) -> Drift:
        """C over time."""
        return Drift(self.database, self.full_instrument, Remembered(8))

    @cached_property
    def drift_measurement(self) -> DriftMeasurement:
        """The measurement of C over time."""
        from service.usecases.drift_measurement import DriftMeasurement

        return DriftMeasurement(self.database, self.fits, self._name_now, self.clock)

    @cached_property
    def changes(self) -> Changes:
        """Changes of paths, and the decisions on them."""
        return Changes(self.database, self.full_instrument, self.promotions, lambda: self.fits, self.gate, self.clock)

    @cached_property
    def lives(self) -> Lives:
        """All that happened to a path."""
        from service.usecases.life import Lives

        return Lives(self.database, self.full_instrument, self.changes, self.models, self.alarms)

    @cached_property
    def watch(self) -> Watch:
        """The search for steps, slopes and lost paths."""
        return Watch(self.database, self.instrument, self.settings.cut_windows, self.clock)

    @cached_property
    def alarms(self) -> Alarms:
        """Alarms: problems that last."""
        return Alarms(
            self.database, self.instrument, self.clock, self.settings.stale_days, lambda: self.models, self.changes
        )

    @cached_property
    def due(self) -> DueWork:
        """Due work for the daily run."""
        from service.usecases.due import DueWork

        searches = self.investigations if self.settings.nightly_investigations else None
        return DueWork(self.database, self.simulation, self.clock, searches, self.watch)

    def _name_now(self, stores: Stores, part: Part) -> Order | None:
        return self.due.name_now(stores, part)

    @cached_property
    def status(self) -> Status:
        """The status of the service, for an operator."""
        return Status(self.database, self.clock)

    @cached_property
    def keys(self) -> Keys:
        """API keys."""
        return Keys(self.database, self.clock, self.settings.open_reads)
