"""Small simulated stations and what the finder makes of them.

The twin plants a fault and gives its effect exactly; the finder is asked in the words of physics: template, size,
significance, change of C. Only this module of the tests knows the names inside `lbacal_core.discovery` and
`lbacal_core.causes`; the claims stand in the tests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lbacal_core.causes.cable import log_loss_per_metre
from lbacal_core.causes.catalogue import ANTENNA_CAUSES, CAUSES
from lbacal_core.causes.cause import Template, signature, spectral_signature
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.discovery import search
from lbacal_core.discovery.antennas import AntennaScore, compare_antennas, compare_cable_names
from lbacal_core.discovery.findings import change_of_c, find_indistinguishable
from lbacal_core.discovery.hypothesis import Hypothesis, Target, list_targets
from lbacal_core.discovery.noise import split_residuals
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import FittedModel, fit_chain, held_out_fold, held_out_gain, power_ratio, refit
from lbacal_core.discovery.report import describe_station, join
from lbacal_core.discovery.residual_structure import ResidualStructure, find_structure, strongest_structure
from lbacal_core.discovery.scan import Score, group_templates, refine, scan, score_families
from lbacal_core.discovery.station import SkyModes, Station, gather_stations, model_modes
from lbacal_core.discovery.view import SMALLEST_INFORMATION
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import compute_model_differences
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import DrawnStation, draw_stations, expected_power, simulate_campaign
from lbacal_twin.faults.fault import Fault
from lbacal_twin.settings import TwinSettings
from lbacal_twin.view import View

MOVING = tuple(cause.identifier for cause in CAUSES if cause.identifier != "missing_noise")
"""Causes whose effect differs from event to event, on top of a baseline that contains all stages of noise."""
STATIC = tuple(cause.identifier for cause in ANTENNA_CAUSES)
"""Causes seen by comparing antennas."""
QUIET = {"radiometer": 512**-0.5 / 300, "event_gain_common": 1e-4, "event_gain_path": 1e-4}
"""A three-hundredth of the noise: what a fault does stands far above it."""
CALM = {"radiometer": 512**-0.5 / 30, "event_gain_common": 1e-3, "event_gain_path": 1e-3}
"""A thirtieth of it, where a fault a thousand times above the noise would itself be the noise that events share."""
SILENT = dict.fromkeys(QUIET, 0.0)
_NAMED: dict[str, Any] = {cause.identifier: cause for cause in (*CAUSES, *ANTENNA_CAUSES)}


@dataclass(frozen=True)
class World:
    """A station-year as the twin makes it: the same events, weather, hardware and noise with any faults."""

    instrument: Instrument
    sky: SkyPower
    settings: TwinSettings
    view: View
    seed: int = 20140101

    def with_settings(self, **changed: Any) -> World:
        """The same station-year under other settings."""
        return replace(self, settings=replace(self.settings, **changed))

    @cached_property
    def simulation(self) -> Simulation:
        """What the finder believes, which is right."""
        return Simulation(self.instrument, self.sky)

    def spectra(self, *faults: Fault, **options: Any) -> Spectra:
        """What is recorded; `nuisances` and `gains` are options of the twin."""
        rng = np.random.default_rng(self.seed)
        return simulate_campaign(
            self.settings, self.instrument, self.sky, rng, faults, view=self.view, **options
        ).spectra

    @cached_property
    def station(self) -> DrawnStation:
        """The station before its noise."""
        rng = np.random.default_rng(self.seed)
        return draw_stations(self.settings, self.instrument, self.sky, rng, view=self.view)[0][0]

    def effect(self, fault: Fault) -> Floats:
        """Relative change of the expected power per unit of the fault's size, shape (antenna, dipole, event, freq)."""
        above, below = (
            expected_power(self.station.stages, self.station.scene, [replace(fault, size=sign * fault.size)])
            for sign in (1, -1)
        )
        return np.asarray((above - below) / (above + below) / fault.size)

    @cached_property
    def _plain(self) -> Station:
        (data,) = gather_stations(self.spectra(), self.simulation)
        return data

    def look(self, *faults: Fault) -> Look:
        """The station with its chain fitted, and nothing named yet."""
        data = self._plain
        if faults:  # the same events: only the power differs, and the sky need not be computed again
            shape = (-1, len(DIPOLES), *data.power.shape[1:])
            data = replace(data, power=_arrange(data, self.spectra(*faults).power.reshape(shape)))
        return Look(data, fit_chain(data), None)


def look_at(spectra: Spectra, simulation: Simulation, *, with_modes: bool = False) -> Look:
    """One station's spectra with their chains fitted."""
    (data,) = gather_stations(spectra, simulation)
    modes = model_modes(data, compute_model_differences(simulation.instrument)) if with_modes else None
    return Look(data, fit_chain(data, modes), modes)


def look_with_residual(look: Look, residual: Floats) -> Look:
    """The same chains, but other relative residuals, shape (path, event, freq)."""
    model = look.model
    linear = LinearModel(
        look.data, split_residuals(look.data, residual, model.linear.residuals.seeds), model.baseline.terms, look.modes
    )
    return replace(look, model=replace(model, linear=linear))


def _arrange(data: Station, values: Floats) -> Floats:
    row, column = np.searchsorted(np.unique(data.antenna), data.antenna), np.searchsorted(DIPOLES, data.dipole)
    return np.asarray(values[row, column])


@dataclass(frozen=True)
class Match:
    """The template most like a planted effect: their correlation, and planted size per size of the template."""

    template: Template
    correlation: float
    slope: float


@dataclass(frozen=True)
class Fitted:
    """A cause whose size was fitted together with the chain, not linearised."""

    size: float
    sigma: float
    template_sigma: float
    uncertainty: float
    effect: Hypothesis
    model: FittedModel


class CannotBeFittedError(Exception):
    """The data cannot tell the effects of a model apart, or the fit runs away."""


@dataclass(frozen=True)
class Look:
    """One station's data and a fitted model of them."""

    data: Station
    model: FittedModel
    modes: SkyModes | None

    @property
    def paths(self) -> list[tuple[int, str]]:
        """Antenna and dipole of each path, in the order of the data."""
        return [(int(a), str(d)) for a, d in zip(self.data.antenna, self.data.dipole, strict=True)]

    def target(self, label: str) -> Target:
        """The paths called `station`, `antenna 3`, `antenna 3 X` or `cable 80`."""
        return next(target for target in list_targets(self.data) if target.label == label)

    def templates(self, cause: str) -> list[Template]:
        """The templates that a scan tries."""
        return _NAMED[cause].templates(self.data.conditions)

    def template(self, cause: str, **wanted: Any) -> Template:
        """The template whose parameters are those wanted, or nearest to a date."""
        date = wanted.pop("date_unix", None)
        found = [
            template
            for template in self.templates(cause)
            if all(template.parameters.get(k) == v for k, v in wanted.items())
        ]
        if date is not None:
            found = [template for template in found if "date_unix" in template.parameters]
            return min(found, key=lambda template: abs(template.parameters["date_unix"] - date))
        return found[0]

    def signature(self, cause: str, template: Template) -> Floats:
        """Relative change of the recorded power per unit of size, shape (path, event, freq)."""
        conditions = self.data.conditions
        return signature(_NAMED[cause], self.model.baseline.terms, conditions, template)[self.data.class_of]

    def arrange(self, values: Floats) -> Floats:
        """Values of shape (antenna, dipole, ...), as the twin has them, in the order of the paths."""
        return _arrange(self.data, values)

    def best_match(self, cause: str, planted: Floats) -> Match:
        """The template most like a planted effect, shape (antenna, dipole, event, freq), without its mean over time."""
        conditions, terms = self.data.conditions, self.model.baseline.terms
        effect = self.arrange(planted)
        of_class = np.stack([effect[self.data.class_of == c].mean(axis=0) for c in range(len(conditions.dipoles))])
        of_class -= of_class.mean(axis=1, keepdims=True)
        flat = np.moveaxis(of_class, 0, 1).reshape(of_class.shape[1], -1)
        matches = []
        for family in group_templates(conditions, _NAMED[cause], self.templates(cause)):
            change = spectral_signature(family.cause, terms, conditions, family.templates[0])
            change = np.moveaxis(change, 0, 1).reshape(flat.shape)
            profiles = family.profiles
            product = profiles @ np.sum(change * flat, axis=1)
            mean = profiles @ change / len(flat)
            square = profiles**2 @ np.sum(change**2, axis=1) - len(flat) * np.sum(mean**2, axis=1)
            r = product / np.sqrt(square * np.sum(flat**2))
            best = int(np.argmax(np.abs(r)))
            matches.append(Match(family.templates[best], float(r[best]), float(product[best] / square[best])))
        return max(matches, key=lambda match: abs(match.correlation))

    def score(self, cause: str, template: Template, target: str = "station") -> tuple[float, float]:
        """Score in standard deviations and size to first order, as a scan computes them."""
        shapes = group_templates(self.data.conditions, _NAMED[cause], [template])
        ((_, z, size),) = score_families(self.model.linear, shapes, [self.target(target)])
        return float(z[0, 0, 0]), float(size[0, 0, 0])

    def scan(self, causes: Sequence[str] = MOVING, targets: Sequence[str] | None = None) -> list[Score]:
        """The best score of each cause."""
        chosen = list_targets(self.data) if targets is None else [self.target(label) for label in targets]
        return scan(self.model.linear, [_NAMED[cause] for cause in causes], chosen)

    def effects(self, causes: Sequence[str], labels: Sequence[str]) -> list[tuple[str, Template, str]]:
        """Every (cause, template, target) that a scan of some causes and targets scores."""
        return [
            (cause, template, label)
            for cause in causes
            for template in self.templates(cause)
            for label in labels
            if self.target(label).scope in _NAMED[cause].scopes
        ]

    def covariance_of_scores(self, effects: Sequence[tuple[str, Template, str]]) -> Floats:
        """Covariance of the scores of (cause, template, target), each of unit variance, shape (effect, effect)."""
        conditions, terms = self.data.conditions, self.model.baseline.terms
        signatures = [signature(_NAMED[cause], terms, conditions, template) for cause, template, _ in effects]
        _, information = self.model.linear.products(signatures, [self.target(label) for *_, label in effects])
        # The fit leaves constant noise free: the scan gives a template without information no score.
        seen = np.diag(information)
        size = np.where(seen > SMALLEST_INFORMATION, np.sqrt(np.abs(seen)), np.inf)
        return np.asarray(information / np.outer(size, size))

    def fit(self, cause: str, template: Template, target: str = "station") -> Fitted:
        """The cause with the best template about one given, its size fitted with all parameters of the chain."""
        z, size = self.score(cause, template, target)
        events = self.data.event_id.size
        score = Score(_NAMED[cause], template, self.target(target), z, size, events)
        effect = refine(self.model.linear, score, Policy())
        return self._extend(effect)

    def fit_as_is(self, cause: str, template: Template, target: str = "station") -> Fitted:
        """The cause under exactly this template."""
        _, size = self.score(cause, template, target)
        return self._extend(Hypothesis(_NAMED[cause], template, self.target(target), size))

    def _extend(self, effect: Hypothesis) -> Fitted:
        model = refit(self.model, effect)
        if model is None:
            raise CannotBeFittedError
        found = model.hypotheses[-1]
        return Fitted(found.size, found.sigma, found.template_sigma, found.uncertainty, found, model)

    def still_to_move(self, fitted: Fitted) -> Floats:
        """Newton's step from the sizes of a model fitted to this one, in standard deviations, shape (effect,)."""
        model, terms = fitted.model, fitted.model.baseline.terms
        templates = [signature(h.cause, terms, self.data.conditions, h.template, h.size) for h in model.hypotheses]
        weighed = model.linear.with_levels(self.model.linear.residuals.levels)
        score, information = weighed.products(templates, [h.target for h in model.hypotheses])
        return np.asarray(np.linalg.solve(information, score) / np.sqrt(np.diag(np.linalg.inv(information))))

    def with_effect(self, fitted: Fitted, size: float) -> Look:
        """The chains fitted again with the effect at a size."""
        effects = [replace(fitted.effect, size=size)]
        ratio = power_ratio(self.data, fitted.model.baseline.terms, effects)
        return replace(self, model=fit_chain(replace(self.data, power=self.data.power / ratio), self.modes))

    def chi_squared_by_event(self, like: Look) -> Floats:
        """Chi^2 of each event, shape (event,), with the noise levels of another look."""
        linear = self.model.linear.with_levels(like.model.linear.residuals.levels)
        views = (linear.common, *linear.paths)
        return np.sum([np.einsum("mref,mref->e", view.residual, view.weighted_residual) for view in views], axis=0)

    def change_of_c(self, fitted: Fitted) -> Floats:
        """Relative change of C that a finding of this effect claims, shape (path of its target, freq)."""
        return change_of_c(self.model, fitted.model, fitted.effect.target)

    def similar_to(
        self, cause: str, template: Template, significance: float, target: str = "station"
    ) -> dict[str, float]:
        """Causes that the data cannot tell from one found at a significance, with their correlation."""
        z, size = self.score(cause, template, target)
        sigma = size / z
        missing = (significance * sigma - size) * self.signature(cause, template)
        is_there = self.target(target).is_member[:, None, None] & self.data.is_present[:, :, None]
        effect = Hypothesis(_NAMED[cause], template, self.target(target), significance * sigma, sigma)
        return dict(find_indistinguishable(self.model.linear.with_change(missing * is_there), effect, Policy()))

    @property
    def fold(self) -> Any:
        """Fold of each event in the held-out test, shape (event,)."""
        return held_out_fold(self.data)

    def held_out_gain(self, cause: str, templates: Sequence[Template], target: str = "station") -> float:
        """Gain in log-likelihood of held-out events, the template chosen and its size fitted on the others."""
        effect = Hypothesis(_NAMED[cause], templates[0], self.target(target), 0.0)
        return held_out_gain(self.model, effect, templates)

    def only_events(self, is_kept: Any) -> Look:
        """A station that recorded only some of the events."""
        data = self.data.on_events(is_kept)
        return Look(data, fit_chain(data, self.modes), self.modes)

    def residual_structure(self, seed: int = 0, alpha: float | None = None) -> ResidualStructure | None:
        """The most significant structure that no cause is asked for; of any probability unless `alpha` is given."""
        rng = np.random.default_rng(seed)
        if alpha is None:
            return strongest_structure(self.model.linear, rng)
        return find_structure(self.model.linear, rng, alpha)

    def investigate(self, **options: Any) -> search.StationReport:
        """The whole search."""
        return search.search_station(self.data, modes=self.modes, **options)

    def targets(self) -> list[tuple[str, str, list[tuple[int, str]]]]:
        """Scope, label and paths of everything that a cause may touch."""
        return [
            (target.scope, target.label, [path for path, own in zip(self.paths, target.is_member, strict=True) if own])
            for target in list_targets(self.data)
        ]

    def static_scores(self, seed: int = 0) -> list[AntennaScore]:
        """The best score of each static cause, most significant first."""
        return compare_antennas(self.data, self.model.baseline, list_targets(self.data), Policy(), seed)

    def cable_scores(self) -> list[AntennaScore]:
        """Scores of the length of each cable name, most significant first."""
        return compare_cable_names(self.model.baseline, self.model.linear, list_targets(self.data))

    @property
    def residual(self) -> Floats:
        """Relative deviation of the spectra from the fitted chains, shape (path, event, freq); 0 where absent."""
        return self.model.baseline.residual

    def noise_constants(self) -> Floats:
        """N_LNA, N_RCU and N_ADC of each path as fitted, shape (path, constant)."""
        solution = self.model.baseline.solution
        return np.column_stack([solution.n, solution.q])

    def modelled_power(self) -> Floats:
        """Recorded power of the mean path of each class as the fitted chain has it, shape (path, event, freq)."""
        return self.model.baseline.terms.power()[self.data.class_of]

    def slopes(self) -> Floats:
        """Slope of power against sky power, C^-2 up to a constant of the path, shape (path, freq)."""
        return self.model.baseline.solution.x


def static_templates(cause: str, look: Look) -> list[tuple[Mapping[str, float], Floats]]:
    """Parameters of static templates and the change of ln slope that each makes per unit of size, shape (freq,)."""
    conditions = look.data.conditions
    cables = dict(zip(conditions.cables, np.exp(conditions.cable_log_loss), strict=True))
    shapes = _NAMED[cause].templates(conditions.frequency_mhz, log_loss_per_metre(cables))
    return [(shape.parameters, shape.departure) for shape in shapes]


def report_of(*reports: search.StationReport) -> dict[str, Any]:
    """The report of all stations as JSON values."""
    return join([describe_station(one) for one in reports], Provenance({}))


def p_value_of(score: Score, z: float) -> float:
    """Probability by chance that a cause's best score reaches z, corrected as the scan corrected `score`."""
    return replace(score, z=z).p_value
