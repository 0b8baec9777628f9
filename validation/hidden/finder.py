"""The finder as the proofs ask it: the one file of `validation.hidden` that imports `lbacal_core.discovery`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.discovery.adopted import find_members
from lbacal_core.discovery.curve_search import describe_curve, investigate_curve
from lbacal_core.discovery.findings import Finding
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.refit import power_ratio
from lbacal_core.discovery.report import GROWS, investigate
from lbacal_core.discovery.search import StationReport
from lbacal_core.discovery.station import Station, gather_stations
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.lstcurve.curve import LstCurve
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import DifferenceModels
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra


@dataclass(frozen=True)
class Answer:
    """The answer of the finder on one data set.

    Attributes
    ----------
    findings
        As in the report, most significant first.
    scores
        Cause, target and score in standard deviations, of the first scan.
    """

    verdict: str
    findings: Sequence[dict[str, Any]]
    unexplained: dict[str, Any] | None
    scores: Sequence[tuple[str, str, float]]

    @property
    def named(self) -> list[str]:
        """Causes named, most significant first."""
        return [str(finding["cause"]) for finding in self.findings]

    @property
    def sets(self) -> list[list[str]]:
        """Each cause named, with those that the data cannot tell from it."""
        return [[finding["cause"], *finding["indistinguishable"]] for finding in self.findings]

    @property
    def first_target(self) -> str:
        """Target of the first finding, empty if there is none."""
        return str(self.findings[0]["evidence"]["target"]) if self.findings else ""

    @property
    def axis(self) -> str:
        """Axis along which structure is left, empty if none is."""
        return str(self.unexplained["where"]["axis"]) if self.unexplained else ""

    @property
    def target(self) -> str:
        """Target in which structure is left, empty if none is."""
        return str(self.unexplained["where"]["target"]) if self.unexplained else ""

    @property
    def claimed_gain(self) -> float:
        """Gain in log-likelihood on held-out events that the report states, of all findings."""
        return float(sum(finding["gain"]["held_out_log_likelihood_gain"] or 0.0 for finding in self.findings))

    def score(self, cause: str, label: str) -> float:
        """Largest |score| of a cause for a target, 0 where another target scored better."""
        own = [abs(z) for named, target, z in self.scores if (named, target) == (cause, label)]
        return max(own, default=0.0)


@dataclass(frozen=True)
class FittedModel:
    """The model of a station with everything that was found in it."""

    _station: StationReport

    @property
    def places(self) -> list[str]:
        """Place in the chain of each sentence that is said, the likeliest first."""
        return [str(one.template.parameters["place"]) for one, _ in self._said]

    @property
    def _said(self) -> list[tuple[Hypothesis, Finding | None]]:
        """Sentences of what no cause explains; where there is none, those in the place of a finding, with that one."""
        found: list[tuple[Hypothesis, Finding | None]]
        found = [(one.hypothesis, None) for one in self._station.description.sentences]
        return found or [(one, finding) for finding in self._station.findings for one in finding.sentences]

    def ratio(
        self, spectra: Spectra, instrument: Instrument, sky_power: SkyPower, sentence: int | None = None
    ) -> tuple[Floats, list[tuple[int, str]], Floats]:
        """Power with what was found over power without, in other spectra of the station.

        With a `sentence` the findings that stand, and the sentence of that number: beside them, or in the place of one.

        Returns
        -------
        The ratio, shape (path, event, freq); antenna and dipole of the paths; times of the events, shape (event,). Only
        paths that were searched: those that are deaf are in no model.
        """
        searched = zip(self._station.station.antenna, self._station.station.dipole, strict=True)
        names = [f"{antenna} {dipole}" for antenna, dipole in searched]
        paths_of_rows = [f"{antenna} {dipole}" for antenna, dipole in zip(spectra.antenna, spectra.dipole, strict=True)]
        (other,) = gather_stations(spectra.select(np.isin(paths_of_rows, names)), Simulation(instrument, sky_power))
        terms = replace(self._station.last.baseline.terms, sky=other.sky)
        found = self._station.last.hypotheses
        if sentence is not None:
            said, instead = self._said[sentence]
            beside = (one.hypothesis for one in self._station.findings if one is not instead)
            found = [*beside, *self._in_antennas(said)]
        found = [replace(one, target=_target_in(other, one)) for one in found]
        ratio = power_ratio(other, terms, found)
        paths = [(int(antenna), str(dipole)) for antenna, dipole in zip(other.antenna, other.dipole, strict=True)]
        times = other.conditions.time_unix
        shape = (len(paths), times.size, instrument.frequency_mhz.size)
        return np.ones(shape) if ratio is None else ratio, paths, times

    def _in_antennas(self, one: Hypothesis) -> list[Hypothesis]:
        """A sentence, by the amount of each antenna where the report says that these grow with their number."""
        said, growth = self._station.description, self._station.description.grows_with_number
        if growth is None or abs(growth) <= GROWS or one is not said.sentences[0].hypothesis:
            return [one]
        return [
            replace(one, size=size, target=replace(one.target, scope="antenna", label=f"antenna {number}"))
            for number, (size, _) in said.amounts.items()
        ]


def _target_in(station: Station, one: Hypothesis) -> Target:
    return replace(one.target, is_member=find_members(station, one.target.label))


def ask_finder(
    spectra: Spectra,
    instrument: Instrument,
    sky_power: SkyPower,
    *,
    is_own_sky: bool,
    seed: int,
    models: DifferenceModels | None = None,
    without: str = "",
) -> tuple[Answer, FittedModel | None]:
    """Ask what is hidden in the spectra of one station.

    With `models` the differences that are profiled out are those of these models. The cause `without` is taken out of
    the catalogue.

    A finder that breaks down on the data is recorded, and never counts as right.
    """
    try:
        report, stations = investigate(
            spectra,
            Simulation(
                instrument,
                sky_power,
                is_own_sky=is_own_sky,
                models=models,
                catalogue=[one for one in CAUSES if one.identifier != without],
            ),
            seed=seed,
        )
    except (ArithmeticError, LookupError, ValueError) as error:
        return Answer(f"failed: {error}", [], None, []), None
    scores = [
        (score.cause.identifier, score.target.label, float(score.z)) for station in stations for score in station.scores
    ]
    return Answer(report["verdict"], report["findings"], report["unexplained"], scores), FittedModel(stations[0])


def ask_of_curve(curve: LstCurve, sky_power: SkyPower, instrument: Instrument, band_mhz: tuple[float, float]) -> Answer:
    """Ask what is hidden in a band-averaged LST curve; the sky power is given and taken at its word."""
    found = investigate_curve(curve, Simulation(instrument, sky_power, is_own_sky=False), band_mhz)
    report = describe_curve(found, Provenance({}))
    return Answer(report["verdict"], report["findings"], report["unexplained"], [])
