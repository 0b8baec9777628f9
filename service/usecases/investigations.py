"""Investigations of stored spectra: what the simulation gets wrong in a station's window.

A report is named by its inputs: the spectra, instrument, sky power, model version and the policy of the search. The
same inputs are investigated once; whoever asks again is told the id of the report that there is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.calibration.windows import leave_out_changed
from lbacal_core.causes.model import Model
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.discovery.policy import Policy
from lbacal_core.errors import write_chance
from lbacal_core.provenance import hash_content
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra
from service.config import Settings
from service.errors import ConflictError
from service.storage.database import Database, Stores
from service.storage.jobs import Order, Part
from service.storage.models import Investigation
from service.storage.spectra import Window
from service.usecases.calibrations import select_paths
from service.usecases.changes import propose
from service.usecases.drift import find_years, split_years
from service.usecases.fits import Fits
from service.usecases.orders import hash_covariates, name_inputs, place_order, read_window
from service.wire.bodies import InvestigationBody

KIND = "investigation"


@dataclass(frozen=True)
class Investigations:
    """Makes reports from stored spectra, and reads them."""

    database: Database
    simulation: Simulation
    fits: Fits
    settings: Settings
    clock: Callable[[], Instant]

    def request(self, body: InvestigationBody, by: str) -> int:
        """Enqueue one part a station and calendar year that hold spectra in the window."""
        since, until = read_window(body.since, body.until)
        select_paths(self.simulation.instrument, body.station, None, None)
        inputs = name_inputs(self.simulation).text
        with self.database.write() as stores:
            years = {window: stores.spectra.contents(*window) for window in split_years(stores, since, until)}
            stations = [body.station] if body.station else stores.spectra.stations()
            parts = [
                describe_part(station, *window)
                for station in stations
                for window, held in years.items()
                if station in held
            ]
            if not parts:
                raise ConflictError("no usable spectra are stored in this window: ingest some, or ask for another one")
            order = Order(KIND, body.model_dump(), parts, body.reason, by, inputs=inputs)
            return place_order(stores, order, self.settings.max_open_parts, self.clock)

    def due(self, stores: Stores) -> Iterator[tuple[dict[str, Any], list[Any]]]:
        """The parts that the stored spectra call for, each with what besides the inputs of fits would change it.

        A station's year with too few events for any fit is not yet due. Parts are those of `describe_part`.
        """
        search = [self.simulation.is_own_sky, Policy().as_dict(), *self.simulation.own_causes.values()]
        for since, until in find_years(stores):
            known = stores.spectra.count_covariates(since, until)
            for station, content in stores.spectra.stations_with(since, until, MIN_EVENTS).items():
                yield describe_part(station, since, until), [content, search, known[station]]

    def run(self, part: Part, worker: str) -> None:
        """Do a part: read, search, and write report and the end of the part in one transaction."""
        station, since, until = (part.request[name] for name in ("station", "since", "until"))
        with self.database.read() as stores:
            spectra = self.fits.load_window(stores, Window(since, until, Scope(station)), with_covariates=True)
            model = stores.models.during(station, since, until)
        whole = leave_out_changed(spectra, self.simulation.instrument)
        if whole is None:
            raise ConflictError(f"every antenna of {station} changed in this window: ask for shorter ones")
        spectra = whole
        inputs = self._inputs(spectra, model, part.request)
        name = hash_content(inputs)
        with self.database.read() as stores:
            made = stores.investigations.find(name)
        if made is None:
            report = self.fits.elsewhere(_investigate, spectra, model)
            made = Investigation(name, station, since, until, inputs, report, self.clock(), part.by, part.reason)
        with self.database.write() as stores:
            stores.investigations.add(made)
            for change, evidence in propose(made, self.fits.simulation.instrument, stores.changes.kept(station)):
                stores.changes.note(change, evidence)
            stores.jobs.complete(part, worker, {"calibrations": [], "results": [name]}, self.clock())

    def _inputs(self, spectra: Spectra, model: Model, request: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "spectra": spectra.digest(),
            "environment": hash_covariates(spectra),
            **self.fits.name_simulation(request["since"], request["until"], Scope(request["station"])),
            "policy": Policy().as_dict(),
            **self.simulation.own_causes,
            **({} if model.is_plain else {"model": model.id}),
        }

    def news(self) -> list[StationNews]:
        """The newest investigation of every station against the one before."""
        with self.database.read() as stores:
            pairs = stores.investigations.newest_pairs()
        return [tell_news(newest, before) for newest, before in pairs]


def _investigate(fits: Fits, spectra: Spectra, model: Model) -> dict[str, Any]:
    from lbacal_core.discovery.left_open import investigate_openly  # a second to import, and only workers need it

    return investigate_openly(spectra, fits.simulation.with_causes(model).smeared(spectra))


def describe_part(station: str, since: Instant, until: Instant) -> dict[str, Any]:
    """A part of an investigation as JSON: `station`, and when its spectra were taken, `since`, `until`, us UTC."""
    return {"station": station, "since": since, "until": until}


# The night's summary: what an investigation of a station says that the one before did not.

STRONGER_SIGMA = 2.0
"""A significance that rises by less is no news: it scatters by 1 from one set of events to the next."""
Key = tuple[Any, ...]


@dataclass(frozen=True)
class StationNews:
    """The newest investigation of a station, and how it differs from the one before.

    Attributes
    ----------
    before
        The id of the one before: of the same window where there is one, else of the window before; None for the first.
    new, stronger
        Sentences about findings that the one before did not have, or that are more significant by `STRONGER_SIGMA`.
    gone
        Sentences about findings that only the one before has.
    """

    newest: Investigation
    before: str | None
    new: Sequence[str]
    stronger: Sequence[str]
    gone: Sequence[str]


def tell_news(newest: Investigation, before: Investigation | None) -> StationNews:
    """Compare two investigations of a station, finding by finding."""
    now = _findings(newest.report)
    then = {} if before is None else _findings(before.report)
    stronger = []
    for key, finding in now.items():
        rise = finding["significance_sigma"] - then[key]["significance_sigma"] if key in then else 0.0
        if rise >= STRONGER_SIGMA:
            was, now_is = then[key]["significance_sigma"], finding["significance_sigma"]
            stronger.append(f"{finding['sentence']} ({was:.1f} -> {now_is:.1f} sigma)")
    return StationNews(
        newest,
        None if before is None else before.id,
        new=[one["sentence"] for key, one in now.items() if key not in then],
        stronger=stronger,
        gone=[one["sentence"] for key, one in then.items() if key not in now],
    )


def _findings(report: Mapping[str, Any]) -> dict[Key, dict[str, Any]]:
    """Findings of a report by cause and target, counted where one target has two; and the structure without a cause."""
    found: dict[Key, dict[str, Any]] = {}
    for finding in report["findings"]:
        where = finding["where"]
        key = (finding["cause"], *where["antennas"], *where["dipoles"])
        found[(*key, sum(other[:-1] == key for other in found))] = finding
    rest = report["unexplained"]
    if rest is not None:
        where = rest["where"]
        sentence = f"{rest['description']} ({write_chance(rest['p_value'])})"
        # where all paths show it together, the one that shows most changes from one set of events to the next
        target = "paths" if rest.get("paths") else where["target"]
        # its significance stays out of the comparison: the p-value of a simulated distribution has a floor
        found["unexplained", where["axis"], target, 0] = {"sentence": sentence, "significance_sigma": 0.0}
    return found
