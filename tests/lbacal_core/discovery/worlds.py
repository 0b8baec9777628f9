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
from lbacal_core.causes.catalogue import CAUSES, STATIC_CAUSES
from lbacal_core.causes.terms import Law, shape_signature, signature
from lbacal_core.discovery import investigate as search
from lbacal_core.discovery.baseline import StationData, gather_stations, model_modes
from lbacal_core.discovery.chance import p_of
from lbacal_core.discovery.evidence import Evidence
from lbacal_core.discovery.extend import (
    FOLDS,
    Effect,
    Extension,
    fit_extension,
    fit_plain,
    held_out_fold,
    held_out_gain,
    power_ratio,
)
from lbacal_core.discovery.leftover import Leftover, find_leftover
from lbacal_core.discovery.refine import refine
from lbacal_core.discovery.report import describe
from lbacal_core.discovery.scan import Score, group_laws, scan, score_shapes
from lbacal_core.discovery.statics import StaticScore, scan_static
from lbacal_core.discovery.targets import Target, list_targets
from lbacal_core.discovery.whitening import split_residuals
from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES, Instrument
from lbacal_core.provenance import Provenance
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra
from lbacal_core.twin.campaign import DrawnStation, draw_stations, expected_power, simulate_campaign
from lbacal_core.twin.faults.fault import Fault
from lbacal_core.twin.settings import TwinSettings
from lbacal_core.twin.view import View

MOVING = tuple(cause.identifier for cause in CAUSES)
"""Causes whose effect differs from event to event."""
STATIC = tuple(cause.identifier for cause in STATIC_CAUSES)
"""Causes seen by comparing antennas."""
QUIET = {"radiometer": 512**-0.5 / 300, "event_gain_common": 1e-4, "event_gain_path": 1e-4}
"""A three-hundredth of the noise: what a fault does stands far above it."""
SILENT = {"radiometer": 0.0, "event_gain_common": 0.0, "event_gain_path": 0.0}

_NAMED: dict[str, Any] = {cause.identifier: cause for cause in (*CAUSES, *STATIC_CAUSES)}


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

    def spectra(self, *faults: Fault) -> Spectra:
        """What is recorded."""
        rng = np.random.default_rng(self.seed)
        return simulate_campaign(self.settings, self.instrument, self.sky, rng, faults, view=self.view).spectra

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
    def _plain(self) -> StationData:
        (data,) = gather_stations(self.spectra(), self.instrument, self.sky)
        return data

    def look(self, *faults: Fault) -> Look:
        """The station with its chain fitted, and nothing named yet."""
        data = self._plain
        if faults:  # the same events: only the power differs, and the sky need not be computed again
            shape = (-1, len(DIPOLES), *data.power.shape[1:])
            data = replace(data, power=_arrange(data, self.spectra(*faults).power.reshape(shape)))
        return Look(data, fit_plain(data), None)


def look_at(spectra: Spectra, instrument: Instrument, sky: SkyPower, *, with_modes: bool = False) -> Look:
    """One station's spectra with their chains fitted."""
    (data,) = gather_stations(spectra, instrument, sky)
    modes = model_modes(data, instrument) if with_modes else None
    return Look(data, fit_plain(data, modes), modes)


def look_with_residual(look: Look, residual: Floats) -> Look:
    """The same chains, but other relative residuals, shape (path, event, freq)."""
    model = look.model
    evidence = Evidence(look.data, split_residuals(look.data, residual), model.baseline.terms, look.modes)
    return replace(look, model=replace(model, evidence=evidence))


def _arrange(data: StationData, values: Floats) -> Floats:
    row, column = np.searchsorted(np.unique(data.antenna), data.antenna), np.searchsorted(DIPOLES, data.dipole)
    return np.asarray(values[row, column])


@dataclass(frozen=True)
class Match:
    """The template most like a planted effect: their correlation, and planted size per size of the template."""

    template: Law
    correlation: float
    slope: float


@dataclass(frozen=True)
class Fitted:
    """A cause whose size was fitted together with the chain, not linearised."""

    size: float
    sigma: float
    template_sigma: float
    uncertainty: float
    parameters: Mapping[str, Any]
    effect: Effect
    model: Extension


class CannotBeFittedError(Exception):
    """The data cannot tell the effects of a model apart, or the fit runs away."""


@dataclass(frozen=True)
class Look:
    """One station's data and a fitted model of them."""

    data: StationData
    model: Extension
    modes: Floats | None

    @property
    def paths(self) -> list[tuple[int, str]]:
        """Antenna and dipole of each path, in the order of the data."""
        return [(int(a), str(d)) for a, d in zip(self.data.antenna, self.data.dipole, strict=True)]

    def target(self, label: str) -> Target:
        """The paths called `station`, `antenna 3`, `antenna 3 X` or `cable 80`."""
        return next(target for target in list_targets(self.data) if target.label == label)

    def templates(self, cause: str) -> list[Law]:
        """The templates that a scan tries."""
        return _NAMED[cause].laws(self.data.conditions)

    def template(self, cause: str, **wanted: Any) -> Law:
        """The template whose parameters are those wanted, or nearest to a date."""
        date = wanted.pop("date_unix", None)
        found = [law for law in self.templates(cause) if all(law.parameters.get(k) == v for k, v in wanted.items())]
        if date is not None:
            found = [law for law in found if "date_unix" in law.parameters]
            return min(found, key=lambda law: abs(law.parameters["date_unix"] - date))
        return found[0]

    def signature(self, cause: str, template: Law) -> Floats:
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
        for shape in group_laws(conditions, _NAMED[cause], self.templates(cause)):
            change = shape_signature(shape.cause, terms, conditions, shape.laws[0])
            change = np.moveaxis(change, 0, 1).reshape(flat.shape)
            courses = shape.courses.values
            product = courses @ np.sum(change * flat, axis=1)
            mean = courses @ change / len(flat)
            square = courses**2 @ np.sum(change**2, axis=1) - len(flat) * np.sum(mean**2, axis=1)
            r = product / np.sqrt(square * np.sum(flat**2))
            best = int(np.argmax(np.abs(r)))
            matches.append(Match(shape.laws[best], float(r[best]), float(product[best] / square[best])))
        return max(matches, key=lambda match: abs(match.correlation))

    def score(self, cause: str, template: Law, target: str = "station") -> tuple[float, float]:
        """Score in standard deviations and size to first order, as a scan computes them."""
        shapes = group_laws(self.data.conditions, _NAMED[cause], [template])
        ((_, z, size),) = score_shapes(self.model.evidence, shapes, [self.target(target)])
        return float(z[0, 0, 0]), float(size[0, 0, 0])

    def scan(self, causes: Sequence[str] = MOVING, targets: Sequence[str] | None = None) -> list[Score]:
        """The best score of each cause."""
        chosen = list_targets(self.data) if targets is None else [self.target(label) for label in targets]
        return scan(self.model.evidence, [_NAMED[cause] for cause in causes], chosen)

    def effects(self, causes: Sequence[str], labels: Sequence[str]) -> list[tuple[str, Law, str]]:
        """Every (cause, template, target) that a scan of some causes and targets scores."""
        return [
            (cause, law, label)
            for cause in causes
            for law in self.templates(cause)
            for label in labels
            if self.target(label).scope in _NAMED[cause].scopes
        ]

    def covariance_of_scores(self, effects: Sequence[tuple[str, Law, str]]) -> Floats:
        """Covariance of the scores of (cause, template, target), each of unit variance, shape (effect, effect)."""
        conditions, terms = self.data.conditions, self.model.baseline.terms
        signatures = [signature(_NAMED[cause], terms, conditions, law) for cause, law, _ in effects]
        _, information = self.model.evidence.products(signatures, [self.target(label) for *_, label in effects])
        size = np.sqrt(np.maximum(np.diag(information), 1e-300))
        return np.asarray(information / np.outer(size, size))

    def fit(self, cause: str, template: Law, target: str = "station") -> Fitted:
        """The cause with the best template about one given, its size fitted with all parameters of the chain."""
        z, size = self.score(cause, template, target)
        effect = refine(self.model.evidence, Score(_NAMED[cause], template, self.target(target), z, size, 1.0, 1))
        return self._extend(effect)

    def fit_as_is(self, cause: str, template: Law, target: str = "station") -> Fitted:
        """The cause under exactly this template."""
        _, size = self.score(cause, template, target)
        return self._extend(Effect(_NAMED[cause], template, self.target(target), size))

    def _extend(self, effect: Effect) -> Fitted:
        model = fit_extension(self.data, self.model, effect, self.modes)
        if model is None:
            raise CannotBeFittedError
        found = model.effects[-1]
        return Fitted(found.size, found.sigma, found.law_sigma, found.uncertainty, found.law.parameters, found, model)

    def with_effect(self, fitted: Fitted, size: float) -> Look:
        """The chains fitted again with the effect at a size."""
        effects = [replace(fitted.effect, size=size)]
        ratio = power_ratio(self.data, fitted.model.baseline.terms, effects)
        return replace(self, model=fit_plain(replace(self.data, power=self.data.power / ratio), self.modes))

    def chi_squared_by_event(self, like: Look) -> Floats:
        """Chi^2 of each event, shape (event,), with the noise levels of another look."""
        evidence = self.model.evidence.with_levels(like.model.residuals.levels)
        residuals = evidence.residuals
        of_mean = np.einsum("def,def->e", residuals.mean, evidence.mean_dual)
        return np.asarray(of_mean + np.einsum("pef,pef->e", residuals.deviation, evidence.path_dual))

    def change_of_c(self, fitted: Fitted) -> Floats:
        """Relative change of C that a finding of this effect claims, shape (path of its target, freq)."""
        return search._calibration_change(self.model, fitted.model, fitted.effect.target)

    def similar_to(self, cause: str, template: Law, significance: float, target: str = "station") -> dict[str, float]:
        """Causes that the data cannot tell from one found at a significance, with their correlation."""
        effect = Effect(_NAMED[cause], template, self.target(target), significance, sigma=1.0)
        return dict(search.find_similar(self.model.evidence, effect))

    @property
    def fold(self) -> Any:
        """Fold of each event in the held-out test, shape (event,)."""
        return held_out_fold(self.data)

    def held_out_gain(self, cause: str, templates: Sequence[Law], target: str = "station") -> float:
        """Gain in log-likelihood of held-out events, the template chosen and its size fitted on the others."""
        effect = Effect(_NAMED[cause], templates[0], self.target(target), 0.0)
        return held_out_gain(self.model, effect, templates)[0]

    def only_events(self, is_kept: Any) -> Look:
        """A station that recorded only some of the events."""
        excess = np.where(is_kept, self.data.excess, np.inf)
        data = replace(self.data, excess=excess)
        return Look(data, fit_plain(data, self.modes), self.modes)

    def residual_structure(self, seed: int = 0, alpha: float | None = None) -> Leftover | None:
        """The most significant structure that no cause is asked for; of any probability unless `alpha` is given."""
        rng = np.random.default_rng(seed)
        if alpha is None:
            return find_leftover(self.model.evidence, rng, 1.1, misfit=1.0)
        return find_leftover(self.model.evidence, rng, alpha)

    def investigate(self, **options: Any) -> search.StationReport:
        """The whole search."""
        return search.investigate_station(self.data, modes=self.modes, **options)

    def targets(self) -> list[tuple[str, str, list[tuple[int, str]]]]:
        """Scope, label and paths of everything that a cause may touch."""
        return [
            (target.scope, target.label, [path for path, own in zip(self.paths, target.is_member, strict=True) if own])
            for target in list_targets(self.data)
        ]

    def static_scores(self, seed: int = 0) -> list[StaticScore]:
        """The best score of each static cause, most significant first."""
        return scan_static(self.data, self.model.baseline, list_targets(self.data), seed)

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

    def chi_squared(self) -> tuple[float, int]:
        """Chi^2 of what the model leaves, and its degrees of freedom."""
        return self.model.evidence.chi_squared()


def static_templates(cause: str, look: Look) -> list[tuple[Mapping[str, float], Floats]]:
    """Parameters of static templates and the change of ln slope that each makes per unit of size, shape (freq,)."""
    conditions = look.data.conditions
    cables = dict(zip(conditions.cables, np.exp(conditions.cable_log_loss), strict=True))
    shapes = _NAMED[cause].shapes(conditions.frequency_mhz, log_loss_per_metre(cables))
    return [(shape.parameters, shape.departure) for shape in shapes]


def report_of(*reports: search.StationReport) -> dict[str, Any]:
    """The report of all stations as JSON values."""
    return describe(reports, Provenance({}))


def unit_of(cause: str) -> str:
    """Unit of the cause's size."""
    return str(_NAMED[cause].unit)


def thresholds() -> dict[str, float]:
    """Probabilities by chance below which each question has an answer, and their sum as stated."""
    return {
        "catalogue": search.ALPHA_CATALOGUE,
        "static": search.ALPHA_STATIC,
        "structure": search.ALPHA_LEFTOVER,
        "stated": search.FALSE_ALARM_RATE,
    }


def p_value_of(score: Score, z: float) -> float:
    """Probability by chance that a cause's best score reaches z, corrected as the scan corrected `score`."""
    return replace(score, z=z).p_value


def p_of_score(z: float, trials: float) -> float:
    """Probability that the largest of so many independent scores exceeds z."""
    return p_of(z, trials)


FOLD_COUNT = FOLDS
